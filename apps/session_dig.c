/* A trench dug pass by pass, or the bucket emptied: moves planned on the map as it is (servo/dig_plan.h),
 * each checked against it, and done as positions. In a cut the motion waits where the cylinders do not
 * follow, and the edge is raised where the soil asks for more than the task's force; a cut that stands still
 * is given up and its soil left to a later pass. So none blocks the task. */
#include "apps/session_internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

static const double LAG_M = 0.08, HELD_M = 0.25; /* the tool behind: from where on slower; where held */
static const double STALL_S = 3, STALL_PACE = 0.05,
                    CREEPS = 0.2; /* out of the ground it never stands still */
static const double RAISE_M_S = 0.4, LOWER_M_S = 0.05, RAISE_MOST_M = 1;
static const double EMPTY_KG = 5, OPEN_SHARE = 0.05; /* of the last joint's range */
static const double BODY_M = 0.72;                   /* of the shell of the zx200's bucket */
/* Of the machine's weight, what it cuts with at most, whatever the task allows: with more it drags or lifts
 * itself, and leaps when the soil gives way. */
static const double HOLDS = 0.4;
enum { ROUNDS = 3 };
static const double WORTH_SHARE = 0.05; /* of the trench: another round is made for it */

#define DEGREES 57.29577951308232

/* ---- moves ---- */

typedef struct move {
    const td_task_position *position;
    td_task_frame frame;
    td_dig_phase phase;
    bool contact;
} move;

static int move_count(const session_dig *d)
{
    return d->plan ? d->plan->move_count : d->dumps ? 2 : 0;
}

static move move_at(const session_dig *d, int index)
{
    if (d->plan) {
        const td_dig_move *m = d->plan->move + index;
        const bool low = m->phase == TD_DIG_APPROACH || m->phase == TD_DIG_CUT || m->phase == TD_DIG_LIFT;
        return (move){&m->position, TD_TASK_SITE, m->phase, m->contact || low};
    }
    return (move){d->emptied + index, d->frame, index ? TD_DIG_DUMP : TD_DIG_CARRY, false};
}

bool session_cuts(const session *x)
{
    return x->dig.busy && x->motion && x->dig.move > 0 &&
           move_at(&x->dig, x->dig.move - 1).phase == TD_DIG_CUT;
}

int session_dig_phase(const session *x)
{
    return x->dig.busy && x->dig.move > 0 ? (int)move_at(&x->dig, x->dig.move - 1).phase : -1;
}

bool session_digs(const session *x)
{
    return x->dig.busy;
}

void session_end_dig(session *x)
{
    td_dig_plan_free(&x->dig.own);
    x->dig = (session_dig){0};
}

/* ---- planned ---- */

/* Where the soil goes: to the next dump of the task. */
static const td_task_point *dump_of(const session *x)
{
    for (int i = x->step; i < x->steps; i++)
        if (x->setup->task->step[i].kind == TD_TASK_DUMP) return &x->setup->task->step[i].as.dump;
    return NULL;
}

static td_status make_plan(session *x, const td_dig_floor *floor, td_error *error)
{
    const td_soil_bucket b = station_bucket(x->station);
    const td_tool tool = {.link = x->tool_link, .link_from_tool = x->link_from_tool};
    td_dig_options o = td_dig_options_default();
    const td_elevation *map = NULL;
    td_dig_bucket bucket = {.link = station_bucket_link(x->station),
                            .width_m = b.width_m,
                            .struck_m3 = b.struck_m3,
                            .heaped_m3 = b.heaped_m3,
                            .body_m = BODY_M};
    memcpy(bucket.edge, b.edge, sizeof bucket.edge);
    memcpy(bucket.heel, b.heel, sizeof bucket.heel);
    memcpy(bucket.opening, b.opening, sizeof bucket.opening);
    o.swell = x->s->ground.soil.swell;
    o.repose_rad = x->s->ground.soil.repose_rad;
    TD_TRY(station_seen(&map, x->station, error));
    const td_dig_request request = {.map = map,
                                    .robot = x->s->robot,
                                    .site_from_vehicle = &x->state.site_from_vehicle,
                                    .q = x->wanted,
                                    .tool = &tool,
                                    .frame = x->setup->task->frame,
                                    .dig = &x->setup->task->step[x->step].as.dig,
                                    .dump = dump_of(x),
                                    .floor = floor,
                                    .bucket = &bucket};
    td_dig_plan_free(&x->dig.own);
    x->dig.plan = NULL;
    x->dig.move = 0;
    const td_status status = td_dig_plan_make(&x->dig.own, &request, &o, error);
    x->dig.plan = x->dig.own;
    return status;
}

static td_status tell_plan(session *x, td_error *error)
{
    const td_dig_plan *p = x->dig.plan;
    char text[300];
    snprintf(text, sizeof text,
             "%.2f m3 in the ground, up to %.2f m deep: %d passes in %d lanes take %.2f m3", p->trench_m3,
             p->depth_m, p->pass_count, p->lane_count, p->cut_m3);
    return session_note(x, NOTE_MESSAGE, x->dig.round ? "trench again" : "trench", text, error);
}

/* The plan that was validated, or one that the world is given. */
static td_status first_plan(session *x, td_error *error)
{
    task_world *w = x->world;
    if (w && w->plan) {
        x->dig.plan = w->plan;
        return TD_OK;
    }
    TD_TRY(make_plan(x, w ? w->floor : NULL, error));
    if (w) {
        td_dig_plan_free(&w->made);
        w->made = x->dig.own;
        x->dig.own = NULL;
    }
    return TD_OK;
}

static td_status begin_trench(session *x, td_error *error)
{
    td_error why = {0};
    char text[600];
    x->dig.busy = true;
    const td_status status = first_plan(x, &why);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status != TD_OK) {
        snprintf(text, sizeof text, "step %d: %s", x->step + 1, why.message);
        return session_report(x, TD_EVENT_UNREACHABLE, text, error);
    }
    x->dig.floor = x->dig.plan->floor;
    x->run->dug.planned_m3 += x->dig.plan->trench_m3;
    return tell_plan(x, error);
}

/* Over the point with the bucket as it is, then open. */
static td_status begin_dump(session *x, td_error *error)
{
    const td_task *task = x->setup->task;
    session_dig *d = &x->dig;
    const int last = x->s->robot->joint_count - 1;
    const td_robot_joint *j = x->s->robot->joint + last;
    const td_pose tool = session_tool(x, x->wanted, &x->base);
    char text[100];
    d->busy = true;
    const double load = 1e-6 * (double)station_soil(x->station).bucket_mg;
    if (load < EMPTY_KG) return session_note(x, NOTE_MESSAGE, "dump", "the bucket is empty", error);
    d->dumps = true;
    d->frame = task->frame;
    d->emptied[0] = (td_task_position){.to = task->step[x->step].as.dump};
    d->emptied[0].to.attitude = TD_TASK_PITCH;
    d->emptied[0].to.pitch_deg = DEGREES * task_pitch(&tool);
    d->opened = (td_task_joint){.value = DEGREES * (j->lower + OPEN_SHARE * (j->upper - j->lower))};
    snprintf(d->opened.name, sizeof d->opened.name, "%s", j->name);
    d->emptied[1] = (td_task_position){.joint_count = 1, .joint = &d->opened};
    snprintf(text, sizeof text, "%.0f kg", load);
    return session_note(x, NOTE_MESSAGE, "dump", text, error);
}

td_status session_begin_dig(session *x, td_error *error)
{
    session_end_dig(x);
    return x->setup->task->step[x->step].kind == TD_TASK_DIG ? begin_trench(x, error) : begin_dump(x, error);
}

/* ---- done ---- */

static td_status begin_move(session *x, td_error *error)
{
    session_dig *d = &x->dig;
    const move m = move_at(d, d->move);
    td_trajectory *planned = NULL;
    char text[200];
    const td_dig_move *c = d->plan ? d->plan->move + d->move : NULL;
    if (c && c->cut_m3 > 0) {
        d->raised = false;
        x->run->dug.passes++;
        snprintf(text, sizeof text, "%d of %d, lane %d: %.2f m3 of the bank, %.2f m deep", c->pass + 1,
                 d->plan->pass_count, c->lane + 1, c->cut_m3, c->depth_m);
        TD_TRY(session_note(x, NOTE_MESSAGE, "pass", text, error));
    }
    /* What begins and ends with a jerk sets the machine rocking on its suspension, the edge by 0.2 m. */
    td_task_position smooth = *m.position;
    if (smooth.law == TD_TASK_FASTEST) smooth.law = TD_TASK_QUINTIC;
    d->raise_m = d->stalled_s = 0;
    d->move++;
    TD_TRY(session_plan(x, &planned, &smooth, m.frame, x->wanted, x->step, error));
    if (!planned) return TD_OK;
    return session_begin_motion(x, &planned, m.contact, error);
}

/* What still stands above the floor; another round where that is worth it. */
static td_status finish(session *x, td_error *error)
{
    session_dig *d = &x->dig;
    if (!d->plan || x->world) {
        session_end_step(x);
        return TD_OK;
    }
    const double before = d->plan->trench_m3;
    const int round = d->round;
    td_error why = {0};
    const td_status status = make_plan(x, &d->floor, &why);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    x->dig.round = round + 1;
    if (status == TD_OK && d->plan->pass_count > 0 && d->round < ROUNDS &&
        d->plan->cut_m3 > WORTH_SHARE * x->run->dug.planned_m3 && d->plan->trench_m3 < 0.8 * before)
        return tell_plan(x, error);
    if (status == TD_OK)
        x->run->dug.left_m3 += d->plan->trench_m3;
    else
        TD_TRY(session_note(x, NOTE_MESSAGE, "trench again", why.message, error));
    session_end_step(x);
    return TD_OK;
}

static double holds(const session *x)
{
    const double *g = x->s->options.gravity;
    double mass = 0;
    for (int i = 0; i < x->s->robot->link_count; i++) mass += x->s->robot->link[i].mass_kg;
    return HOLDS * mass * hypot(hypot(g[0], g[1]), g[2]);
}

/* By how much the edge is raised: up fast where the soil asks for too much, down slowly where it does not. */
static td_status keep_force(session *x, td_error *error)
{
    session_dig *d = &x->dig;
    const double most = fmin(x->setup->task->step[x->step].as.dig.force_n, holds(x)), T = x->s->period_s;
    const double force = station_soil(x->station).cutting_n;
    char text[200];
    if (force > most)
        d->raise_m = fmin(RAISE_MOST_M, d->raise_m + RAISE_M_S * T * fmin(1, 5 * (force / most - 1)));
    else if (force < 0.8 * most)
        d->raise_m = fmax(0, d->raise_m - LOWER_M_S * T);
    x->run->dug.raised_m = fmax(x->run->dug.raised_m, d->raise_m);
    if (!(force > most) || d->raised) return TD_OK;
    d->raised = true;
    snprintf(text, sizeof text, "%.1f kN are more than the %.1f kN that are allowed: the edge is raised",
             1e-3 * force, 1e-3 * most);
    return session_note(x, NOTE_MESSAGE, "force", text, error);
}

static td_status give_up(session *x, double lag, td_error *error)
{
    char text[200];
    x->run->dug.stalls++;
    snprintf(text, sizeof text,
             "the bucket stands still at %.1f kN, %.2f m behind: it is lifted, what it left comes later",
             1e-3 * station_soil(x->station).cutting_n, lag);
    td_trajectory_free(&x->motion);
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    return session_note(x, NOTE_MESSAGE, "stall", text, error);
}

/* How far the tool is behind, and how fast the motion may go on for it. */
static double pace_of(double *lag, const session *x)
{
    const td_pose wanted = session_tool(x, x->wanted, &x->state.site_from_vehicle),
                  is = session_tool(x, x->state.q, &x->state.site_from_vehicle);
    *lag = hypot(hypot(wanted.t[0] - is.t[0], wanted.t[1] - is.t[1]), wanted.t[2] - is.t[2]);
    return fmax(0, fmin(1, 1 - (*lag - LAG_M) / (HELD_M - LAG_M)));
}

static td_status cut_on(session *x, td_error *error)
{
    session_dig *d = &x->dig;
    double lag;
    const double pace = pace_of(&lag, x);
    TD_TRY(keep_force(x, error));
    d->stalled_s = pace < STALL_PACE ? d->stalled_s + x->s->period_s : 0;
    if (d->stalled_s >= STALL_S) {
        TD_TRY(give_up(x, lag, error));
        return session_follow(x, 1, error);
    }
    return session_follow(x, pace, error);
}

/* After a cut the joints stand where the soil let them. */
td_status session_dig_on(session *x, td_error *error)
{
    session_dig *d = &x->dig;
    if (session_cuts(x)) return cut_on(x, error);
    if (!x->motion) {
        const move before = d->move > 0 ? move_at(d, d->move - 1) : (move){.phase = TD_DIG_RETURN};
        if (before.phase == TD_DIG_CUT) memcpy(x->wanted, x->state.q, sizeof x->wanted);
        if (before.phase == TD_DIG_DUMP) TD_TRY(session_keep_ground(x, error));
        if (d->move < move_count(d))
            TD_TRY(begin_move(x, error));
        else
            TD_TRY(finish(x, error));
    }
    double lag;
    return session_follow(x, session_digs(x) && x->motion ? fmax(CREEPS, pace_of(&lag, x)) : 1, error);
}

/* ---- the raised edge ---- */

/* The tool straight up, its attitude kept: damped least squares of the joints. */
void session_raise(double *q, const session *x)
{
    enum { N = TD_ROBOT_MAX_JOINTS, ROWS = 4 };
    static const double y[3] = {0, 1, 0};
    const int n = x->s->robot->joint_count;
    double jacobian[6 * N], row[ROWS * N], square[ROWS * ROWS], across[3];
    td_pose at[TD_ROBOT_MAX_LINKS];
    if (!(x->dig.raise_m > 0)) return;
    td_robot_forward(at, x->s->robot, q);
    td_robot_jacobian(jacobian, x->s->robot, at, x->tool_link);
    const td_pose tool = td_pose_compose(at + x->tool_link, &x->link_from_tool);
    td_pose_rotate(across, &tool, y);
    for (int k = 0; k < n; k++) {
        row[3 * n + k] = 0;
        for (int i = 0; i < 3; i++) {
            const int a = (i + 1) % 3, b = (i + 2) % 3;
            row[i * n + k] =
                jacobian[(3 + i) * n + k] + jacobian[a * n + k] * tool.t[b] - jacobian[b * n + k] * tool.t[a];
            row[3 * n + k] += across[i] * jacobian[i * n + k];
        }
    }
    td_multiply_transposed(square, row, row, ROWS, (size_t)n, ROWS);
    for (int i = 0; i < ROWS; i++) square[(ROWS + 1) * i] += 1e-3;
    if (td_invert_spd(square, square, ROWS, NULL) != TD_OK) return;
    for (int k = 0; k < n; k++) {
        const td_robot_joint *j = x->s->robot->joint + k;
        for (int i = 0; i < ROWS; i++) q[k] += row[i * n + k] * square[ROWS * i + 2] * x->dig.raise_m;
        if (j->upper > j->lower) q[k] = fmax(j->lower, fmin(j->upper, q[k]));
    }
}
