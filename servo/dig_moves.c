/* A pass as the moves of a task: what is done by the joints, what by the tool along straight lines. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double DEGREE = 0.017453292519943295;
static const double EMPTY_RAD = 2 * 0.017453292519943295; /* more than what empties the bucket */
static const double RAISE_M = 0.02, HIGHER_M = 0.15;
enum { RAISES = 20 };

static td_status add_move(td_dig_plan *plan, td_dig_phase phase, const dig_pass *pass, const dig_job *job,
                          const double *q, td_error *error)
{
    if (plan->move_count % 64 == 0) {
        td_dig_move *grown = realloc(plan->move, ((size_t)plan->move_count + 64) * sizeof *grown);
        if (!grown) return td_fail(error, TD_ERROR_MEMORY, "no memory for the moves of a trench");
        plan->move = grown;
    }
    td_dig_move *m = plan->move + plan->move_count++;
    *m = (td_dig_move){.pass = pass->pass, .lane = pass->lane, .phase = phase};
    memcpy(m->q, q, (size_t)job->robot->joint_count * sizeof *q);
    return TD_OK;
}

static td_status add_line(td_dig_plan *plan, td_dig_phase phase, const dig_pass *pass, const dig_job *job,
                          const dig_pose *to, const double *q, td_error *error)
{
    TD_TRY(add_move(plan, phase, pass, job, q, error));
    td_task_point *p = &plan->move[plan->move_count - 1].position.to;
    memcpy(p->at_m, to->at, sizeof p->at_m);
    p->attitude = TD_TASK_PITCH;
    p->pitch_deg = to->pitch / DEGREE;
    return TD_OK;
}

static td_status add_joints(td_dig_plan *plan, td_dig_phase phase, const dig_pass *pass, const dig_job *job,
                            const double *q, td_error *error)
{
    bool moves[TD_ROBOT_MAX_JOINTS];
    TD_TRY(add_move(plan, phase, pass, job, q, error));
    td_task_position *p = &plan->move[plan->move_count - 1].position;
    td_tool_joints(moves, &job->arm);
    p->joint = calloc((size_t)job->robot->joint_count, sizeof *p->joint);
    if (!p->joint) return td_fail(error, TD_ERROR_MEMORY, "no memory for the moves of a trench");
    for (int k = 0; k < job->robot->joint_count; k++) {
        if (!moves[k]) continue;
        td_task_joint *j = p->joint + p->joint_count++;
        strcpy(j->name, job->robot->joint[k].name);
        j->value = q[k] / DEGREE;
    }
    return TD_OK;
}

static td_status not_clear(const char *what, const dig_pass *pass, td_error *error)
{
    return td_fail(error, TD_ERROR_DATA,
                   "dig: pass %d: the %s cannot be made clear of the ground on its way within reach; dump "
                   "elsewhere, or drive",
                   pass->pass + 1, what);
}

/* A posture by so much higher, where that is reached. */
static bool raise(dig_pose *pose, double *q, const dig_job *job, double by)
{
    double trial[TD_ROBOT_MAX_JOINTS];
    dig_pose up = *pose;
    td_dig_reason reason;
    up.at[2] += by;
    memcpy(trial, q, (size_t)job->robot->joint_count * sizeof *q);
    if (!dig_line(trial, job, pose, &up, &reason)) return false;
    *pose = up;
    memcpy(q, trial, (size_t)job->robot->joint_count * sizeof *q);
    return true;
}

/* From where the arm stands it may have to rise first. */
static td_status go_above(td_dig_plan *plan, dig_job *job, dig_drag *d, const dig_pass *pass, double *q,
                          td_error *error)
{
    double q_rise[TD_ROBOT_MAX_JOINTS], where;
    dig_pose start, rise;
    dig_pose_of(&start, job, q);
    memcpy(q_rise, q, (size_t)job->robot->joint_count * sizeof *q);
    rise = start;
    for (int i = 0; i < RAISES; i++) {
        const double low = dig_too_low(&where, job, q_rise, d->q_above);
        if (low <= 0) {
            if (rise.at[2] > start.at[2])
                TD_TRY(add_line(plan, TD_DIG_RETURN, pass, job, &rise, q_rise, error));
            return add_joints(plan, TD_DIG_RETURN, pass, job, d->q_above, error);
        }
        if (!(where > 0.4 && raise(&d->above, d->q_above, job, low + RAISE_M)) &&
            !raise(&rise, q_rise, job, low + RAISE_M))
            break;
    }
    return not_clear("way back", pass, error);
}

/* Where the bucket comes to the dump, `tilt` from upright and `short_m` before the point, above the heap;
 * then opened over the point. */
static bool come_and_open(dig_pose *over, dig_pose *open, double *q_over, double *q_open, const dig_job *job,
                          double tilt, double short_m, double raised)
{
    td_dig_reason reason;
    double edge[3];
    dig_edge(edge, job, open->at);
    const double across = hypot(edge[0], edge[1]);
    over->pitch = job->upright_rad - tilt;
    over->at[0] = open->at[0] - short_m * edge[1] / across; /* the edge lies to the left of the arm */
    over->at[1] = open->at[1] + short_m * edge[0] / across;
    const double ground = dig_below(job, over->at);
    open->at[2] = fmax(open->at[2], ground + job->o.clear_m + dig_shell(job, over->pitch)) + raised;
    over->at[2] = open->at[2];
    if (!dig_line(q_over, job, over, over, &reason)) return false;
    memcpy(q_open, q_over, (size_t)job->robot->joint_count * sizeof *q_open);
    return dig_line(q_open, job, over, open, &reason);
}

/* An arm that holds a full bucket out far enough to empty it there is not always long enough: it then opens
 * on the way out. */
static bool over_dump(dig_pose *over, dig_pose *open, double *q_over, double *q_open, const dig_job *job,
                      const double *q, double raised)
{
    const double ground = dig_below(job, job->dump);
    const double tilt = dig_carry_tilt(job);
    for (int back = 0; back <= 8; back++)
        for (int tilted = 0; tilted <= (tilt > 0 ? 3 : 0); tilted++) {
            memcpy(open->at, job->dump, sizeof open->at);
            open->at[2] = fmax(open->at[2], ground + job->o.clear_m);
            open->pitch = job->upright_rad - (90 * DEGREE + job->o.repose_rad + EMPTY_RAD);
            memcpy(q_over, q, (size_t)job->robot->joint_count * sizeof *q);
            if (come_and_open(over, open, q_over, q_open, job, tilt * tilted / 3, 0.2 * back, raised))
                return true;
        }
    return false;
}

static td_status carry(td_dig_plan *plan, dig_job *job, dig_drag *d, const dig_pass *pass, double *q,
                       td_error *error)
{
    double q_over[TD_ROBOT_MAX_JOINTS], q_open[TD_ROBOT_MAX_JOINTS], raised = 0, where;
    dig_pose over, open;
    bool emptied = false;
    for (int i = 0; i < RAISES; i++) {
        if (!over_dump(&over, &open, q_over, q_open, job, d->q_up, raised)) {
            emptied = false; /* near the machine a bucket opens further the higher it is */
            raised += HIGHER_M;
            continue;
        }
        emptied = true;
        const double low = dig_too_low(&where, job, d->q_up, q_over);
        if (low <= 0) {
            TD_TRY(add_line(plan, TD_DIG_LIFT, pass, job, &d->off, d->q_off, error));
            TD_TRY(add_line(plan, TD_DIG_LIFT, pass, job, &d->up, d->q_up, error));
            TD_TRY(add_joints(plan, TD_DIG_CARRY, pass, job, q_over, error));
            memcpy(q, q_open, (size_t)job->robot->joint_count * sizeof *q);
            return add_line(plan, TD_DIG_DUMP, pass, job, &open, q_open, error);
        }
        if (where > 0.4 || !raise(&d->up, d->q_up, job, low + RAISE_M)) raised += low + RAISE_M;
    }
    if (emptied) return not_clear("way to the dump", pass, error);
    return td_fail(
        error, TD_ERROR_DATA,
        "dump: the bucket cannot be emptied over (%.2f, %.2f) m, clear of the ground and the heap there; "
        "take a place that is reached, or a lower one",
        job->dump[0], job->dump[1]);
}

td_status dig_moves_add(td_dig_plan *plan, dig_job *job, dig_drag *drag, const dig_pass *pass, double *q,
                        td_error *error)
{
    TD_TRY(go_above(plan, job, drag, pass, q, error));
    TD_TRY(add_line(plan, TD_DIG_APPROACH, pass, job, &drag->over, drag->q_over, error));
    TD_TRY(add_line(plan, TD_DIG_CUT, pass, job, &drag->in, drag->q_in, error));
    plan->move[plan->move_count - 1].contact = true;
    TD_TRY(add_line(plan, TD_DIG_CUT, pass, job, &drag->out, drag->q_out, error));
    td_dig_move *cut = plan->move + plan->move_count - 1;
    const double load = pass->cut_m3 * job->o.swell;
    cut->contact = true;
    cut->cut_m3 = pass->cut_m3;
    cut->depth_m = pass->depth_m;
    const int first = plan->move_count - 1;
    job->dumped_m3 += load;
    TD_TRY(carry(plan, job, drag, pass, q, error));
    for (int i = first; i < plan->move_count - 1; i++) plan->move[i].load_m3 = load;
    return TD_OK;
}
