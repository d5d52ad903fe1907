/* A pass as the moves of a task: what is done by the joints, what by the tool along straight lines. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double DEGREE = 0.017453292519943295;
static const double EMPTY_RAD = 5 * 0.017453292519943295; /* more than what empties the bucket */
enum { RAISES = 12 };

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

/* From where the arm stands it may have to rise first. */
static td_status go_above(td_dig_plan *plan, dig_job *job, dig_drag *d, const dig_pass *pass, double *q,
                          td_error *error)
{
    const size_t size = (size_t)job->robot->joint_count * sizeof *q;
    double q_rise[TD_ROBOT_MAX_JOINTS];
    dig_pose start, rise;
    td_dig_reason reason;
    dig_pose_of(&start, job, q);
    memcpy(q_rise, q, size);
    rise = start;
    for (int i = 0; i < RAISES; i++) {
        const double low = dig_too_low(job, q_rise, d->q_above);
        if (low <= 0) {
            if (rise.at[2] > start.at[2])
                TD_TRY(add_line(plan, TD_DIG_RETURN, pass, job, &rise, q_rise, error));
            return add_joints(plan, TD_DIG_RETURN, pass, job, d->q_above, error);
        }
        double trial[TD_ROBOT_MAX_JOINTS];
        dig_pose up = d->above;
        up.at[2] += low + 0.02;
        memcpy(trial, d->q_above, size);
        if (dig_line(trial, job, &d->above, &up, &reason)) {
            d->above = up;
            memcpy(d->q_above, trial, size);
        }
        up = rise;
        up.at[2] += low + 0.02;
        memcpy(trial, q_rise, size);
        if (dig_line(trial, job, &rise, &up, &reason)) {
            rise = up;
            memcpy(q_rise, trial, size);
        }
    }
    return not_clear("way back", pass, error);
}

/* Where the bucket is over the dump with its mouth upright, above the heap; then opened. */
static bool over_dump(dig_pose *over, dig_pose *open, double *q_over, double *q_open, const dig_job *job,
                      double raised)
{
    td_dig_reason reason;
    const size_t size = (size_t)job->robot->joint_count * sizeof *q_over;
    memcpy(over->at, job->dump, sizeof over->at);
    over->pitch = job->upright_rad - 0.25;
    const double ground = dig_highest(job, over->at, job->request->bucket->width_m / 2);
    over->at[2] = fmax(over->at[2], ground + job->o.clear_m + dig_shell(job, over->pitch)) + raised;
    *open = *over;
    open->pitch = job->upright_rad - (90 * DEGREE + job->o.repose_rad + EMPTY_RAD);
    if (!dig_line(q_over, job, over, over, &reason)) return false;
    memcpy(q_open, q_over, size);
    return dig_line(q_open, job, over, open, &reason);
}

static td_status carry(td_dig_plan *plan, dig_job *job, dig_drag *d, const dig_pass *pass, double *q,
                       td_error *error)
{
    const size_t size = (size_t)job->robot->joint_count * sizeof *q;
    double q_over[TD_ROBOT_MAX_JOINTS], q_open[TD_ROBOT_MAX_JOINTS], raised = 0;
    dig_pose over, open;
    td_dig_reason reason;
    for (int i = 0; i < RAISES; i++) {
        memcpy(q_over, d->q_up, size);
        if (!over_dump(&over, &open, q_over, q_open, job, raised))
            return td_fail(
                error, TD_ERROR_DATA,
                "dump: the bucket cannot be emptied %.2f m above (%.2f, %.2f) m, as the ground and "
                "the heap there ask for; take a place that is reached, or a lower one",
                over.at[2] - job->dump_ground, over.at[0], over.at[1]);
        const double low = dig_too_low(job, d->q_up, q_over);
        if (low <= 0) {
            TD_TRY(add_line(plan, TD_DIG_LIFT, pass, job, &d->up, d->q_up, error));
            TD_TRY(add_joints(plan, TD_DIG_CARRY, pass, job, q_over, error));
            memcpy(q, q_open, size);
            return add_line(plan, TD_DIG_DUMP, pass, job, &open, q_open, error);
        }
        double trial[TD_ROBOT_MAX_JOINTS];
        dig_pose up = d->up;
        up.at[2] += low + 0.02;
        memcpy(trial, d->q_up, size);
        if (dig_line(trial, job, &d->up, &up, &reason)) {
            d->up = up;
            memcpy(d->q_up, trial, size);
        }
        raised += low + 0.02;
    }
    return not_clear("way to the dump", pass, error);
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
