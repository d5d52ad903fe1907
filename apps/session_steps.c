/* What the joints are to do in each step of a task. */
#include "apps/session_internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void session_forget_plans(session *x)
{
    td_trajectory_free(&x->motion);
    for (int i = 0; x->ahead && i < x->steps; i++) td_trajectory_free(x->ahead + i);
}

td_status session_plan(session *x, td_trajectory **planned, const td_task_position *position,
                       td_task_frame frame, const double *q, int step, td_error *error)
{
    td_error why = {0};
    char text[400];
    bool unreachable = false;
    const td_status status =
        task_plan(planned, &unreachable, x->s, position, frame, q, &x->state.site_from_vehicle, &why);
    if (status == TD_OK) return TD_OK;
    if (!unreachable) return td_fail(error, status, "%s", why.message);
    snprintf(text, sizeof text, "step %d: %s", step + 1, why.message);
    return session_report(x, TD_EVENT_UNREACHABLE, text, error);
}

/* After these the joints stand where the ground lets them. */
static bool is_foreseen(const td_task_step *step)
{
    return step->kind == TD_TASK_POSITION || step->kind == TD_TASK_WAIT || step->kind == TD_TASK_DRIVE;
}

/* Before anything moves, as far as can be foreseen, and in the site to the first step, for the base will
 * stand otherwise. So a task that cannot be done fails at once, and no step's beginning costs a deadline. */
td_status session_plan_ahead(session *x, td_error *error)
{
    const td_task *task = x->setup->task;
    double q[TD_ROBOT_MAX_JOINTS];
    memcpy(q, x->wanted, sizeof q);
    for (int i = 0; i < x->steps && is_foreseen(task->step + i); i++) {
        if (task->step[i].kind == TD_TASK_DRIVE && task->frame == TD_TASK_SITE) return TD_OK;
        if (task->step[i].kind != TD_TASK_POSITION) continue;
        TD_TRY(session_plan(x, x->ahead + i, &task->step[i].as.position, task->frame, q, i, error));
        if (!x->ahead[i] || task->frame == TD_TASK_SITE) return TD_OK;
        td_trajectory_at(q, NULL, NULL, x->ahead[i], td_trajectory_duration(x->ahead[i]));
    }
    return TD_OK;
}

/* ---- what the joints are to do ---- */

/* So fast that no joint brakes harder than half of its limit; the path and the controller need the rest. */
static const double PACE_SHARE = 0.5;

static double pace_rate_of(const session *x)
{
    enum { POINTS = 100 };
    const double length = td_trajectory_duration(x->motion);
    double dq[TD_ROBOT_MAX_JOINTS], least = INFINITY;
    for (int i = 0; i <= POINTS; i++) {
        td_trajectory_at(NULL, dq, NULL, x->motion, length * i / POINTS);
        for (int k = 0; k < x->s->robot->joint_count; k++)
            least = fmin(least, PACE_SHARE * x->s->robot->joint[k].acceleration / fmax(1e-9, fabs(dq[k])));
    }
    return fmin(least, 10);
}

static td_status begin_press(session *x, const td_task_press *p, td_error *error)
{
    td_force_controller_options o = td_force_controller_options_default();
    const td_task *task = x->setup->task;
    o.link = x->tool_link;
    memcpy(o.point_m, task->tool.point_m, sizeof o.point_m);
    memcpy(o.axis, p->axis, sizeof o.axis);
    if (task->frame == TD_TASK_SITE) {
        const td_pose back = td_pose_inverse(&x->state.site_from_vehicle);
        td_pose_rotate(o.axis, &back, p->axis);
    }
    o.force_n = p->force_n;
    if (p->approach_speed_m_s > 0) o.approach_m_s = p->approach_speed_m_s;
    o.most_travel_m = p->most_travel_m;
    o.kind = TD_COMMAND_FLOW;
    o.limits = x->joints.options.limits;
    TD_TRY(td_force_controller_start(&x->press, x->s->robot, &o, &x->state, error));
    memcpy(x->press.rate, x->jog.rate, sizeof x->press.rate);
    return TD_OK;
}

/* What is in the way of a motion, by the map as it is; on the generated dynamics there is none. */
static td_status look_ahead(bool *clear, live_plan *plan, session *x, const td_trajectory *planned,
                            bool bucket_may_touch, td_error *error)
{
    enum { MOST = 400 };
    const double length = td_trajectory_duration(planned);
    const size_t n = (size_t)x->s->robot->joint_count,
                 samples = (size_t)fmin(MOST, ceil(length / x->s->period_s) + 2);
    double *q = calloc(samples * (n + 1), sizeof *q), *time = q ? q + samples * n : NULL;
    char words[300], text[400];
    td_clearance found = {0};
    *clear = true;
    if (!x->station) {
        free(q);
        return TD_OK;
    }
    if (!q) return td_fail(error, TD_ERROR_MEMORY, "no memory to check a motion");
    for (size_t i = 0; i < samples; i++) {
        double at[TD_ROBOT_MAX_JOINTS];
        time[i] = length * (double)i / (double)(samples - 1);
        td_trajectory_at(at, NULL, NULL, planned, time[i]);
        memcpy(q + i * n, at, n * sizeof *q);
        if (i && !(time[i] > time[i - 1])) time[i] = time[i - 1] + 1e-6;
    }
    const td_status status = station_check(clear, &found, words, sizeof words, x->station, time, q, samples,
                                           bucket_may_touch, error);
    free(q);
    TD_TRY(status);
    plan->checked = true;
    plan->clearance = found;
    if (found.nearest.link >= 0)
        x->run->dug.clearance_m = fmin(x->run->dug.clearance_m, found.nearest.clearance_m);
    x->run->dug.probability = fmax(x->run->dug.probability, found.probability);
    if (*clear) return TD_OK;
    snprintf(text, sizeof text, "step %d: %s", x->step + 1, words);
    return session_report(x, TD_EVENT_UNREACHABLE, text, error);
}

/* For those who watch: where the tool will go. */
static td_status tell_plan(session *x, live_plan *plan, const td_trajectory *planned, td_error *error)
{
    if (!x->live || !x->live->planned) return TD_OK;
    plan->time_s = session_time(x);
    plan->duration_s = td_trajectory_duration(planned);
    for (int i = 0; i < LIVE_PLAN_POINTS; i++) {
        double q[TD_ROBOT_MAX_JOINTS];
        td_trajectory_at(q, NULL, NULL, planned, plan->duration_s * i / (LIVE_PLAN_POINTS - 1));
        const td_pose tool = session_tool(x, q, &x->state.site_from_vehicle);
        memcpy(plan->point[i], tool.t, sizeof plan->point[i]);
    }
    return x->live->planned(x->live, plan, error);
}

td_status session_begin_motion(session *x, td_trajectory **planned, bool bucket_may_touch, td_error *error)
{
    bool clear = false;
    live_plan plan = {0};
    td_status status = look_ahead(&clear, &plan, x, *planned, bucket_may_touch, error);
    plan.clear = clear;
    if (status == TD_OK) status = tell_plan(x, &plan, *planned, error);
    td_trajectory_free(&x->motion);
    if (status != TD_OK || !clear) {
        td_trajectory_free(planned);
        return status;
    }
    x->motion = *planned;
    *planned = NULL;
    x->base = x->state.site_from_vehicle;
    x->along_s = 0;
    x->pace = 1;
    x->next_event = 0;
    x->motions++;
    x->pace_rate = pace_rate_of(x);
    x->run->planned_s += td_trajectory_duration(x->motion);
    return TD_OK;
}

static td_status begin_position(session *x, const td_task_position *p, td_error *error)
{
    td_trajectory *planned = x->ahead[x->step];
    x->ahead[x->step] = NULL;
    if (!planned) TD_TRY(session_plan(x, &planned, p, x->setup->task->frame, x->wanted, x->step, error));
    return planned ? session_begin_motion(x, &planned, false, error) : TD_OK;
}

static td_status begin_step(session *x, td_error *error)
{
    const td_task_step *step = x->setup->task->step + x->step;
    td_error why = {0};
    char text[300];
    x->step_begun = true;
    x->step_s = 0;
    x->base = x->state.site_from_vehicle;
    snprintf(text, sizeof text, "step %d of %d", x->step + 1, x->steps);
    TD_TRY(session_note(x, NOTE_STEP, td_task_kind_name(step->kind), text, error));
    switch (step->kind) {
    case TD_TASK_POSITION:
        return begin_position(x, &step->as.position, error);
    case TD_TASK_PRESS:
        if (begin_press(x, &step->as.press, &why) == TD_OK) return TD_OK;
        return session_report(x, TD_EVENT_UNREACHABLE, why.message, error);
    case TD_TASK_DIG:
    case TD_TASK_DUMP:
        return session_begin_dig(x, error);
    case TD_TASK_DRIVE:
        return session_begin_drive(x, error);
    default:
        return TD_OK;
    }
}

void session_end_step(session *x)
{
    td_trajectory_free(&x->motion);
    session_end_dig(x);
    x->step++;
    x->run->steps_done++;
    x->step_begun = false;
}

/* What the planner saw ahead, where the motion comes to it. */
static td_status pass_events(session *x, td_error *error)
{
    while (x->next_event < x->motion->event_count && x->motion->event[x->next_event].from_s <= x->along_s) {
        const td_trajectory_event *e = x->motion->event + x->next_event++;
        char text[200];
        if (e->kind == TD_TRAJECTORY_SINGULAR) {
            snprintf(text, sizeof text,
                     "for %.2f s the tool hardly moves some way; off its path by up to %.3g m",
                     e->to_s - e->from_s, e->off_m);
            TD_TRY(session_report(x, TD_EVENT_SINGULARITY, text, error));
        } else {
            snprintf(text, sizeof text, "%s comes within %.3g of a limit for %.2f s",
                     x->s->robot->joint[e->joint].name, e->least, e->to_s - e->from_s);
            TD_TRY(session_note(x, NOTE_MESSAGE, "near a limit", text, error));
        }
    }
    return TD_OK;
}

/* Positions wanted now, and the rate that leads to those of the next period: oil integrates over it. */
td_status session_follow(session *x, double to, td_error *error)
{
    const int n = x->s->robot->joint_count;
    const double T = x->s->period_s;
    double rate[TD_ROBOT_MAX_JOINTS] = {0};
    if (x->motion) {
        const double change = x->pace_rate * T, pace = x->pace + fmax(-change, fmin(change, to - x->pace));
        const double next = x->along_s + (x->pace + pace) / 2 * T;
        double ahead[TD_ROBOT_MAX_JOINTS];
        td_trajectory_at(x->wanted, NULL, NULL, x->motion, x->along_s);
        td_trajectory_at(ahead, NULL, NULL, x->motion, next);
        session_raise(x->wanted, x);
        session_raise(ahead, x);
        for (int k = 0; k < n; k++) rate[k] = (ahead[k] - x->wanted[k]) / T;
        x->along_s = next;
        x->pace = pace;
        TD_TRY(pass_events(x, error));
    }
    memcpy(x->joints.rate, x->jog.rate, sizeof x->joints.rate);
    const td_status status =
        td_joint_controller_step(&x->command, &x->joints, x->wanted, rate, &x->state, error);
    memcpy(x->jog.rate, x->joints.rate, sizeof x->jog.rate);
    return status;
}

static td_status push(session *x, const td_task_press *p, td_error *error)
{
    double statics[TD_DYNAMICS_MAX], gravity[3];
    const td_pose back = td_pose_inverse(&x->state.site_from_vehicle);
    td_pose_rotate(gravity, &back, x->s->options.gravity);
    td_dynamics_gravity(statics, x->dynamics, x->state.q, gravity);
    const td_status status = td_force_controller_step(&x->command, &x->press, &x->state, statics + 6, error);
    memcpy(x->jog.rate, x->press.rate, sizeof x->jog.rate);
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    TD_TRY(status);
    const bool held = fabs(x->press.force_n - p->force_n) <= x->setup->task->tolerance.force_n;
    x->step_s = held ? x->step_s + x->s->period_s : 0;
    if (x->step_s >= p->for_s) {
        session_end_step(x);
        return TD_OK;
    }
    if (x->press.at_end)
        return session_report(x, TD_EVENT_LIMIT, "the tool went its most_travel_m without the force", error);
    return TD_OK;
}

static td_status wait(session *x, double for_s, td_error *error)
{
    TD_TRY(session_follow(x, 1, error));
    if ((x->step_s += x->s->period_s) >= for_s - x->s->period_s / 2) session_end_step(x);
    return TD_OK;
}

td_status session_work(session *x, td_error *error)
{
    x->simulated++;
    if (x->motion && x->along_s >= td_trajectory_duration(x->motion)) {
        td_trajectory_at(x->wanted, NULL, NULL, x->motion, x->along_s);
        if (session_digs(x))
            td_trajectory_free(&x->motion);
        else
            session_end_step(x);
    }
    if (x->step < x->steps && !x->step_begun) TD_TRY(begin_step(x, error));
    if (x->step >= x->steps) x->idle++;
    const td_task_step *step = x->step < x->steps ? x->setup->task->step + x->step : NULL;
    if (!step || (x->reports & TD_EVENT_BIT(TD_EVENT_UNREACHABLE))) return session_follow(x, 1, error);
    switch (step->kind) {
    case TD_TASK_PRESS:
        return push(x, &step->as.press, error);
    case TD_TASK_WAIT:
        return wait(x, step->as.wait_s, error);
    case TD_TASK_DIG:
    case TD_TASK_DUMP:
        return session_dig_on(x, error);
    case TD_TASK_DRIVE:
        return session_drive_on(x, error);
    default:
        return session_follow(x, 1, error);
    }
}
