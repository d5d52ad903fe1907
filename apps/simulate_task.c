/* A session: the behaviour decides each period, the step under work says what the joints are to do. */
#include "apps/simulate_task.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "servo/force_controller.h"
#include "servo/jog.h"
#include "servo/joint_controller.h"
#include "sim/dynamics.h"

static const double REST_S = 1;      /* a machine told to stop has come to rest */
static const double JOG_SHARE = 0.3; /* of a joint's speed, by hand */

typedef struct session {
    const scenario *s;
    const task_setup *setup;
    const task_inputs *input;
    task_run *run;
    struct live *live;
    td_machine *machine;
    td_dynamics *dynamics;
    td_plant_state start; /* settled */
    td_behaviour logic;
    td_behaviour_outputs out;
    bool links_open, parameters_read;
    uint32_t task_id, reports; /* reports of the last period, for the next reaction */
    size_t next_input, stops_seen;
    long period, simulated, phase_since; /* counted in periods; simulated: of the run under way */
    size_t log_index;
    int step, steps;
    bool step_begun, broken;
    td_trajectory *motion;
    td_trajectory **ahead;           /* (steps) planned when the run began; NULL: not yet, or taken */
    double along_s, pace, pace_rate; /* on the motion; pace: 1 while it runs, 0 while it is held */
    size_t next_event;
    double step_s;
    td_pose base, link_from_tool;
    int tool_link;
    double wanted[TD_ROBOT_MAX_JOINTS];
    td_joint_controller joints;
    td_force_controller press;
    td_jog jog;
    td_jog_wish wish;
    td_plant_state state;
    td_plant_command command;
} session;

void task_run_free(task_run *run)
{
    free(run->sample);
    free(run->note);
    free(run->input.item);
    *run = (task_run){0};
}

static double cpu_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double time_of(const session *x)
{
    return (double)x->period * x->s->period_s;
}

/* ---- notes ---- */

static td_status note(session *x, note_kind kind, const char *name, const char *text, td_error *error)
{
    task_run *r = x->run;
    if (r->note_count == r->note_room) {
        const size_t room = 2 * r->note_room + 64;
        task_note *more = realloc(r->note, room * sizeof *more);
        if (!more) return td_fail(error, TD_ERROR_MEMORY, "no memory for the events of a session");
        r->note = more;
        r->note_room = room;
    }
    task_note *n = r->note + r->note_count++;
    *n = (task_note){.period = x->period, .time_s = time_of(x), .kind = kind, .name = name, .joint = -1};
    snprintf(n->text, sizeof n->text, "%s", text);
    return TD_OK;
}

/* ---- the behaviour ---- */

static td_status report(session *x, td_event event, const char *text, td_error *error)
{
    x->reports |= TD_EVENT_BIT(event);
    return note(x, NOTE_REPORT, td_event_text(event), text, error);
}

static td_status hand_in(session *x, const task_input *input, uint32_t *events, td_error *error)
{
    const bool order = input->event != TD_EVENT_DEADLINE;
    *events |= TD_EVENT_BIT(input->event);
    TD_TRY(note(x, order ? NOTE_ORDER : NOTE_REPORT, td_event_text(input->event), "", error));
    task_note *n = x->run->note + x->run->note_count - 1;
    n->joint = input->joint;
    n->stick = input->stick;
    if (input->event == TD_EVENT_JOG)
        x->wish = (td_jog_wish){.kind = TD_JOG_JOINT, .joint = input->joint, .stick = input->stick};
    task_input kept = *input;
    kept.period = x->period;
    return inputs_add(&x->run->input, &kept, error);
}

static td_status tell(session *x, td_phase before, uint32_t orders, td_error *error)
{
    for (int e = 0; e < TD_EVENT_COUNT; e++)
        if ((orders & TD_EVENT_BIT(e)) && x->out.answer[e] > TD_ANSWER_ACCEPTED)
            TD_TRY(
                note(x, NOTE_MESSAGE, td_event_text((td_event)e), td_answer_text(x->out.answer[e]), error));
    for (int m = 0; m < TD_MESSAGE_COUNT; m++)
        if (x->out.messages & TD_MESSAGE_BIT(m))
            TD_TRY(note(x, NOTE_MESSAGE, "session", td_message_text((td_message)m), error));
    if (x->out.fault != TD_FAULT_NONE) {
        x->run->fault = x->out.fault;
        TD_TRY(note(x, NOTE_FAULT, "fault", td_fault_text(x->out.fault), error));
    }
    if (x->out.phase == before) return TD_OK;
    x->phase_since = x->period;
    return note(x, NOTE_PHASE, "phase", td_phase_text(x->out.phase), error);
}

/* Back to where the scenario begins; the session's time goes on. */
static td_status prepare(session *x, td_error *error)
{
    x->parameters_read = true;
    if (x->period == 0) return TD_OK;
    td_plant_state again = x->start;
    again.time_s = time_of(x);
    TD_TRY(td_machine_reset(x->machine, &again, error));
    x->stops_seen = 0;
    x->state = again;
    memset(x->jog.rate, 0, sizeof x->jog.rate);
    memcpy(x->wanted, again.q, sizeof x->wanted);
    return TD_OK;
}

static void forget_plans(session *x)
{
    td_trajectory_free(&x->motion);
    for (int i = 0; x->ahead && i < x->steps; i++) td_trajectory_free(x->ahead + i);
}

static td_status plan(session *x, td_trajectory **planned, int step, const double *q, td_error *error)
{
    td_error why = {0};
    char text[400];
    bool unreachable = false;
    const td_status status =
        task_plan(planned, &unreachable, x->s, step, q, &x->state.site_from_vehicle, &why);
    if (status == TD_OK) return TD_OK;
    if (!unreachable) return td_fail(error, status, "%s", why.message);
    snprintf(text, sizeof text, "step %d: %s", step + 1, why.message);
    return report(x, TD_EVENT_UNREACHABLE, text, error);
}

/* Before anything moves, as far as can be foreseen: to the first press, after which the joints stand where
 * the ground lets them, and in the site to the first step, for the base will stand otherwise. So a task that
 * cannot be done fails at once, and no step's beginning costs a deadline. */
static td_status plan_ahead(session *x, td_error *error)
{
    const td_task *task = x->setup->task;
    double q[TD_ROBOT_MAX_JOINTS];
    memcpy(q, x->wanted, sizeof q);
    for (int i = 0; i < x->steps && task->step[i].kind != TD_TASK_PRESS; i++) {
        if (task->step[i].kind != TD_TASK_POSITION) continue;
        TD_TRY(plan(x, x->ahead + i, i, q, error));
        if (!x->ahead[i] || task->frame == TD_TASK_SITE) return TD_OK;
        td_trajectory_at(q, NULL, NULL, x->ahead[i], td_trajectory_duration(x->ahead[i]));
    }
    return TD_OK;
}

static td_status begin_run(session *x, td_error *error)
{
    x->step = 0;
    x->step_begun = false;
    x->simulated = 0;
    x->reports = 0;
    x->run->simulated = false;
    x->run->steps_done = 0;
    x->run->planned_s = 0;
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    forget_plans(x);
    return plan_ahead(x, error);
}

static td_status react(session *x, uint32_t events, td_error *error)
{
    const td_phase before = x->logic.phase;
    const td_behaviour_inputs in = {.events = events,
                                    .links_open = x->links_open,
                                    .parameters_read = x->parameters_read,
                                    .task = x->task_id};
    td_behaviour_react(&x->logic, &in, &x->out);
    TD_TRY(tell(x, before, events, error));
    if (x->out.close_links) x->links_open = false;
    if (x->out.open_links) x->links_open = true;
    if (x->out.read_parameters) TD_TRY(prepare(x, error));
    if (x->out.begin) TD_TRY(begin_run(x, error));
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

static td_status begin_step(session *x, td_error *error)
{
    const td_task_step *step = x->setup->task->step + x->step;
    td_error why = {0};
    char text[300];
    x->step_begun = true;
    x->step_s = 0;
    x->base = x->state.site_from_vehicle;
    snprintf(text, sizeof text, "step %d of %d", x->step + 1, x->steps);
    TD_TRY(note(x, NOTE_STEP, td_task_kind_name(step->kind), text, error));
    if (step->kind == TD_TASK_PRESS) {
        if (begin_press(x, &step->as.press, &why) != TD_OK)
            return report(x, TD_EVENT_UNREACHABLE, why.message, error);
        return TD_OK;
    }
    if (step->kind != TD_TASK_POSITION) return TD_OK;
    td_trajectory_free(&x->motion);
    x->motion = x->ahead[x->step];
    x->ahead[x->step] = NULL;
    if (!x->motion) TD_TRY(plan(x, &x->motion, x->step, x->wanted, error));
    if (!x->motion) return TD_OK;
    x->along_s = 0;
    x->pace = 1;
    x->next_event = 0;
    x->pace_rate = pace_rate_of(x);
    x->run->planned_s += td_trajectory_duration(x->motion);
    return TD_OK;
}

static td_status end_step(session *x)
{
    td_trajectory_free(&x->motion);
    x->step++;
    x->run->steps_done++;
    x->step_begun = false;
    return TD_OK;
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
            TD_TRY(report(x, TD_EVENT_SINGULARITY, text, error));
        } else {
            snprintf(text, sizeof text, "%s comes within %.3g of a limit for %.2f s",
                     x->s->robot->joint[e->joint].name, e->least, e->to_s - e->from_s);
            TD_TRY(note(x, NOTE_MESSAGE, "near a limit", text, error));
        }
    }
    return TD_OK;
}

/* Positions wanted now, and the rate that leads to those of the next period: oil integrates over it. */
static td_status follow(session *x, double to, td_error *error)
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
    if (x->step_s >= p->for_s) return end_step(x);
    if (x->press.at_end)
        return report(x, TD_EVENT_LIMIT, "the tool went its most_travel_m without the force", error);
    return TD_OK;
}

static td_status work(session *x, td_error *error)
{
    const double T = x->s->period_s;
    x->simulated++;
    if (x->motion && x->along_s >= td_trajectory_duration(x->motion)) {
        td_trajectory_at(x->wanted, NULL, NULL, x->motion, x->along_s);
        TD_TRY(end_step(x));
    }
    if (x->step < x->steps && !x->step_begun) TD_TRY(begin_step(x, error));
    const td_task_step *step = x->step < x->steps ? x->setup->task->step + x->step : NULL;
    if (step && step->kind == TD_TASK_PRESS && !(x->reports & TD_EVENT_BIT(TD_EVENT_UNREACHABLE)))
        return push(x, &step->as.press, error);
    TD_TRY(follow(x, 1, error));
    if (step && step->kind == TD_TASK_WAIT && (x->step_s += T) >= step->as.wait_s - T / 2) return end_step(x);
    return TD_OK;
}

/* `brake`: with nothing asked. */
static td_status by_hand(session *x, bool brake, td_error *error)
{
    const td_jog_wish nothing = {.kind = TD_JOG_NOTHING};
    const td_status status = td_jog_step(&x->command, &x->jog, brake ? &nothing : &x->wish, &x->state, error);
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    return status;
}

/* Fails only where the program cannot go on; what a controller cannot is a report. */
static td_status drive(session *x, td_error *error)
{
    td_error why = {0};
    td_status status;
    switch (x->out.drive) {
    case TD_DRIVE_SIMULATE:
        status = work(x, &why);
        break;
    case TD_DRIVE_JOG:
        status = by_hand(x, false, &why);
        break;
    case TD_DRIVE_HOLD:
        status = x->logic.phase == TD_PHASE_MANUAL ? by_hand(x, true, &why) : follow(x, 0, &why);
        break;
    case TD_DRIVE_REST:
        status = x->logic.phase == TD_PHASE_SIMULATED ? follow(x, 0, &why) : by_hand(x, true, &why);
        break;
    default:
        td_trajectory_free(&x->motion);
        status = by_hand(x, true, &why);
        break;
    }
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status != TD_OK) return report(x, TD_EVENT_PART_FAILED, why.message, error);
    return TD_OK;
}

/* ---- the log ---- */

static td_pose tool_at(const session *x, const double *q, const td_pose *base)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, x->s->robot, q);
    const td_pose vehicle = td_pose_compose(at + x->tool_link, &x->link_from_tool);
    return td_pose_compose(base, &vehicle);
}

static td_status take_sample(session *x, td_error *error)
{
    task_run *r = x->run;
    if (r->count == r->room) {
        const size_t room = 2 * r->room + 512;
        task_sample *more = room <= SIMULATE_MAX_ROWS ? realloc(r->sample, room * sizeof *more) : NULL;
        if (!more)
            return td_fail(error, TD_ERROR_MEMORY, "a session of more than %zu rows of the log", r->room);
        r->sample = more;
        r->room = room;
    }
    task_sample *a = r->sample + r->count++;
    double force[3];
    *a = (task_sample){.time_s = time_of(x),
                       .phase = x->logic.phase,
                       .step = x->step < x->steps ? x->step : x->steps - 1,
                       .state = x->state};
    a->state.time_s = a->time_s;
    memcpy(a->wanted, x->wanted, sizeof a->wanted);
    memcpy(a->command, x->command.value, sizeof a->command);
    a->tool_wanted = tool_at(x, x->wanted, &x->base);
    a->tool = tool_at(x, x->state.q, &x->state.site_from_vehicle);
    a->pitch_wanted_rad = task_pitch(&a->tool_wanted);
    a->pitch_rad = task_pitch(&a->tool);
    const bool pressing = x->out.drive == TD_DRIVE_SIMULATE && x->step < x->steps && x->step_begun &&
                          x->setup->task->step[x->step].kind == TD_TASK_PRESS;
    a->press_n = pressing ? x->press.force_n : NAN;
    td_machine_contact_force(force, x->machine);
    a->contact_n = hypot(hypot(force[0], force[1]), force[2]);
    return TD_OK;
}

static void keep_steady(session *x)
{
    task_run *r = x->run;
    const td_pose wanted = tool_at(x, x->wanted, &x->base),
                  is = tool_at(x, x->state.q, &x->state.site_from_vehicle);
    r->simulated = true;
    r->joint_off = 0;
    for (int i = 0; i < 3; i++) r->steady[i] = is.t[i] - wanted.t[i];
    for (int k = 0; k < x->s->robot->joint_count; k++)
        r->joint_off = fmax(r->joint_off, fabs(x->state.q[k] - x->wanted[k]));
}

/* ---- a period ---- */

static td_status take_inputs(session *x, uint32_t *events, td_error *error)
{
    while (x->next_input < x->input->count && x->input->item[x->next_input].period <= x->period)
        TD_TRY(hand_in(x, x->input->item + x->next_input++, events, error));
    if (!x->live) return TD_OK;
    task_inputs keys = {0};
    td_status status = live_inputs(x->live, &keys, x->period, x->logic.phase, error);
    for (size_t i = 0; status == TD_OK && i < keys.count; i++)
        status = hand_in(x, keys.item + i, events, error);
    free(keys.item);
    return status;
}

static td_status see_stops(session *x, td_error *error)
{
    size_t count = 0;
    const td_machine_event *e = td_machine_events(x->machine, &count);
    for (; x->stops_seen < count; x->stops_seen++) {
        const td_machine_event *now = e + x->stops_seen;
        char text[200];
        if (now->joint < 0) {
            snprintf(text, sizeof text, "at %.6f s", now->time_s);
            TD_TRY(note(x, NOTE_MESSAGE, now->met ? "contact met" : "contact left", text, error));
            continue;
        }
        snprintf(text, sizeof text, "%s %s its %s stop at %.6f s", x->s->robot->joint[now->joint].name,
                 now->met ? "met" : "left", now->upper ? "upper" : "lower", now->time_s);
        if (now->met)
            TD_TRY(report(x, TD_EVENT_LIMIT, text, error));
        else
            TD_TRY(note(x, NOTE_MESSAGE, "stop left", text, error));
    }
    return TD_OK;
}

static bool is_over(const session *x)
{
    const td_phase phase = x->logic.phase;
    if (x->broken) return true;
    if (x->input->end >= 0) return x->period >= x->input->end;
    if (x->next_input < x->input->count) return false;
    const bool rested = (double)(x->period - x->phase_since) * x->s->period_s >= REST_S;
    if (phase == TD_PHASE_IDLE) return rested;
    if (phase == TD_PHASE_SIMULATING || (x->live && live_attended(x->live))) return false;
    return phase == TD_PHASE_SIMULATED || rested;
}

static td_status one_period(session *x, td_error *error)
{
    uint32_t events = x->reports;
    x->reports = 0;
    x->wish.kind = TD_JOG_NOTHING;
    td_machine_state(x->machine, &x->state);
    if (x->logic.phase == TD_PHASE_SIMULATING &&
        (double)x->simulated * x->s->period_s >= x->s->duration_s - x->s->period_s / 2)
        events |= TD_EVENT_BIT(TD_EVENT_ENDED);
    TD_TRY(take_inputs(x, &events, error));
    TD_TRY(react(x, events, error));
    if (x->out.messages & TD_MESSAGE_BIT(TD_MESSAGE_SIMULATION_ENDED)) keep_steady(x);
    TD_TRY(drive(x, error));
    if (time_of(x) >= (double)x->log_index * x->s->log_s - 1e-9) {
        x->log_index = (size_t)floor(time_of(x) / x->s->log_s + 1e-6) + 1;
        TD_TRY(take_sample(x, error));
    }
    return TD_OK;
}

/* The machine for a period; what it cannot is a report, and its end. */
static td_status advance(session *x, td_error *error)
{
    td_error why = {0};
    td_status status = td_machine_command(x->machine, &x->command, NULL, &why);
    if (status == TD_OK) status = td_machine_step(x->machine, x->s->period_s, &why);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    x->period++;
    if (status == TD_OK) return see_stops(x, error);
    x->broken = true;
    TD_TRY(report(x, TD_EVENT_PART_FAILED, why.message, error));
    return react(x, x->reports, error);
}

static td_status wait_for_clock(session *x, td_error *error)
{
    bool missed = false;
    if (!x->live) return TD_OK;
    TD_TRY(live_wait(x->live, &missed, error));
    live_show(x->live, x->run, x->logic.phase, x->step, x->steps, time_of(x));
    const task_input input = {.event = TD_EVENT_DEADLINE, .joint = -1};
    uint32_t events = 0;
    if (missed) TD_TRY(hand_in(x, &input, &events, error));
    x->reports |= events;
    return TD_OK;
}

/* ---- from the start to the end ---- */

static td_status begin_machine(session *x, td_machine_base base, td_error *error)
{
    const scenario *s = x->s;
    td_machine_options o = s->options;
    o.base = base;
    TD_TRY(td_machine_new(&x->machine, s->robot, &o, s->compile_folder, error));
    TD_TRY(td_machine_reset(x->machine, &s->start, error));
    TD_TRY(td_machine_settle(x->machine, error));
    if (x->setup->has_contact) TD_TRY(td_machine_touch(x->machine, &x->setup->contact, error));
    td_machine_state(x->machine, &x->start);
    x->state = x->start;
    x->base = x->start.site_from_vehicle;
    memcpy(x->wanted, x->start.q, sizeof x->wanted);
    if (td_dynamics_zx200(&x->dynamics, s->robot, NULL) == TD_OK) return TD_OK;
    return td_dynamics_new(&x->dynamics, s->robot, error);
}

static td_status begin_control(session *x, td_error *error)
{
    const scenario *s = x->s;
    td_joint_controller_options o = td_joint_controller_options_default();
    o.gain_1_s = s->gain_1_s;
    o.kind = TD_COMMAND_FLOW;
    o.limits.period_s = s->period_s;
    o.limits.lag_s = s->options.valve_s;
    o.limits.pump_m3_s = isfinite(s->options.pump_m3_s) ? s->options.pump_m3_s : 0;
    TD_TRY(td_joint_controller_start(&x->joints, s->robot, &o, error));
    td_motion_limits slow = o.limits;
    slow.speed_share = JOG_SHARE;
    return td_jog_start(&x->jog, s->robot, &slow, TD_COMMAND_FLOW, error);
}

/* Prepare, the checks, StartSim: before time begins. */
static td_status begin_session(session *x, td_error *error)
{
    td_behaviour_options o = td_behaviour_options_default();
    char hex[TD_HASH_HEX_SIZE];
    o.singularity = x->setup->singularity;
    o.deadlines_forgiven = x->setup->miss == TD_MISS_STOP ? 0 : UINT32_MAX;
    TD_TRY(td_task_hash(hex, x->setup->task, error));
    hex[8] = 0;
    x->task_id = (uint32_t)strtoul(hex, NULL, 16) | 1;
    x->steps = x->setup->task->step_count;
    x->step = -1;
    x->tool_link = td_task_tool_link(x->setup->task, x->s->robot);
    x->link_from_tool = task_tool(x->setup->task);
    x->command.kind = TD_COMMAND_FLOW;
    x->ahead = calloc((size_t)x->steps, sizeof *x->ahead);
    if (!x->ahead) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    td_behaviour_begin(&x->logic, &o);
    TD_TRY(react(x, TD_EVENT_BIT(TD_EVENT_PREPARE), error));
    TD_TRY(react(x, 0, error));
    return react(x, TD_EVENT_BIT(TD_EVENT_START), error);
}

static td_status all_the_way(session *x, const td_progress *progress, td_error *error)
{
    const size_t total = (size_t)(x->s->duration_s / x->s->period_s);
    for (;;) {
        TD_TRY(one_period(x, error));
        if (is_over(x)) return TD_OK;
        TD_TRY(advance(x, error));
        if (x->broken) return TD_OK;
        TD_TRY(wait_for_clock(x, error));
        const size_t done = (size_t)x->simulated < total ? (size_t)x->simulated : total;
        const bool go_on =
            x->live ? !terminal_interrupted() : td_progress_report(progress, "simulating", done, total);
        if (!go_on) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
}

td_status task_run_session(task_run *run, const scenario *s, td_machine_base base, const task_inputs *inputs,
                           struct live *live, const td_progress *progress, td_error *error)
{
    session *x = calloc(1, sizeof *x);
    *run = (task_run){0};
    if (!x) return td_fail(error, TD_ERROR_MEMORY, "no memory for a session");
    *x = (session){
        .s = s, .setup = s->task, .input = inputs ? inputs : &s->task->orders, .run = run, .live = live};
    td_status status = begin_machine(x, base, error);
    if (status == TD_OK) status = begin_control(x, error);
    if (status == TD_OK) status = begin_session(x, error);
    const double begun = cpu_now();
    if (status == TD_OK && live) status = live_start(live, error);
    if (status == TD_OK) status = all_the_way(x, progress, error);
    run->cpu_s = cpu_now() - begun;
    run->time_s = time_of(x);
    run->input.end = x->period;
    run->phase = x->logic.phase;
    if (x->machine) run->counters = td_machine_count(x->machine);
    if (live) run->live = (task_live){true, live_counts(live), s->period_s};
    forget_plans(x);
    free(x->ahead);
    td_dynamics_free(&x->dynamics);
    td_machine_free(&x->machine);
    free(x);
    return status;
}
