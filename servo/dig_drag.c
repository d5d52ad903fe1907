/* One drag of the bucket through a lane: the longest that the machine reaches, with what comes before and
 * after it. */
#include <math.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double PI = 3.14159265358979323846, DEGREE = 0.017453292519943295;
static const double STEP_M = 0.1;
static const double OVER_M = 0.1; /* above the ground where the approach ends */
static const double OFF_WALL_M = 0.2;
static const double SPARE_RAD = 3 * 0.017453292519943295; /* less than the tilt at which it spills */
static const double TURN = 5 * 0.017453292519943295;      /* between two tries of a pitch */

/* Direction of the drag, as a pitch. */
static double way_of(const dig_job *job)
{
    return PI + atan(job->floor.along);
}

/* Highest ground of the lane about a place. */
static double top_at(const dig_job *job, const dig_lane *lane, double a)
{
    double at[3];
    dig_place(at, job, a, lane->t, 0);
    return fmax(at[2], dig_highest(job, at, job->request->bucket->width_m / 2));
}

/* The far end: down beside a face of the trench, so that the bucket's floor is upright or leans from it, and
 * what the rake allows when the drag begins. */
static bool enter(dig_drag *d, const dig_job *job, const dig_lane *lane, td_dig_reason *reason)
{
    const double least = way_of(job) - job->o.rake_most_deg * DEGREE - job->floor_rad;
    d->top = top_at(job, lane, d->from);
    for (double pitch = PI / 2 - job->floor_rad; pitch >= least - 1e-9; pitch -= TURN) {
        dig_place(d->in.at, job, d->from, lane->t, d->g);
        d->in.pitch = pitch;
        d->over = d->above = d->in;
        d->over.at[2] = d->top + OVER_M;
        d->above.at[2] = d->top + job->o.clear_m + dig_shell(job, pitch);
        if (!dig_line(d->q_above, job, &d->above, &d->above, reason)) continue;
        memcpy(d->q_over, d->q_above, sizeof d->q_over);
        if (!dig_line(d->q_over, job, &d->above, &d->over, reason)) continue;
        memcpy(d->q_in, d->q_over, sizeof d->q_in);
        if (dig_line(d->q_in, job, &d->over, &d->in, reason)) return true;
    }
    return false;
}

double dig_carry_tilt(const dig_job *job)
{
    return fmax(0, fmin(job->o.tilt_deg * DEGREE, job->o.repose_rad) - SPARE_RAD);
}

/* Off the wall, which would be cut on the way up, and up; the mouth upright when it is up, or tilted where
 * the bucket cannot be curled so far. */
static bool lift(dig_drag *d, const dig_job *job, const dig_lane *lane, td_dig_reason *reason)
{
    const double back = fmin(OFF_WALL_M, 0.4 * (d->to - d->from));
    const double top = fmax(d->top, top_at(job, lane, d->to)) + job->o.clear_m;
    for (int tilted = 0; tilted <= 3; tilted++) {
        const double upright = fmax(job->upright_rad - dig_carry_tilt(job) * tilted / 3, d->out.pitch);
        dig_place(d->off.at, job, d->to - back, lane->t, d->g + back);
        d->off.pitch = d->out.pitch;
        d->up = d->off;
        d->up.pitch = upright;
        d->up.at[2] = top + dig_shell(job, upright);
        memcpy(d->q_off, d->q_out, sizeof d->q_off);
        if (!dig_line(d->q_off, job, &d->out, &d->off, reason)) continue;
        memcpy(d->q_up, d->q_off, sizeof d->q_up);
        if (dig_line(d->q_up, job, &d->off, &d->up, reason)) return true;
    }
    return false;
}

/* The near end: the mouth as far from upright as is allowed and does not spill, or less. */
static bool leave(dig_drag *d, const dig_job *job, const dig_lane *lane, td_dig_reason *reason)
{
    const double most = way_of(job) - job->o.rake_least_deg * DEGREE - job->floor_rad;
    const double first = job->upright_rad - fmin(job->o.tilt_deg * DEGREE, job->o.repose_rad);
    memcpy(d->q_out, d->q_in, sizeof d->q_out);
    for (double pitch = fmin(first, most); pitch <= most + 1e-9; pitch += TURN) {
        dig_place(d->out.at, job, d->to, lane->t, d->g);
        d->out.pitch = pitch;
        if (dig_line(d->q_out, job, &d->out, &d->out, reason) && lift(d, job, lane, reason)) return true;
    }
    return false;
}

/* Where between the ends the way is not reached; INFINITY: nowhere. */
static double drag_fails(dig_drag *d, const dig_job *job, td_dig_reason *reason)
{
    const int parts = (int)ceil((d->to - d->from) / STEP_M);
    dig_pose last = d->in;
    memcpy(d->q_out, d->q_in, sizeof d->q_out);
    for (int i = 1; i <= parts; i++) {
        const double u = (double)i / parts;
        dig_pose p;
        for (int k = 0; k < 3; k++) p.at[k] = d->in.at[k] + u * (d->out.at[k] - d->in.at[k]);
        p.pitch = d->in.pitch + u * (d->out.pitch - d->in.pitch);
        if (!dig_line(d->q_out, job, &last, &p, reason)) return d->from + u * (d->to - d->from);
        last = p;
    }
    return INFINITY;
}

bool dig_drag_whole(dig_drag *drag, const dig_job *job, const dig_lane *lane, td_dig_reason *reason,
                    double *fails)
{
    *fails = drag->from;
    if (!enter(drag, job, lane, reason)) return false;
    *fails = drag->to;
    if (!leave(drag, job, lane, reason)) return false;
    *fails = drag_fails(drag, job, reason);
    return isinf(*fails);
}

bool dig_drag_make(dig_drag *drag, const dig_job *job, const dig_lane *lane, td_dig_reason *reason)
{
    while (drag->to - drag->from >= DIG_LEAST_M) {
        double fails;
        if (dig_drag_whole(drag, job, lane, reason, &fails)) return true;
        if (fails - drag->from <= drag->to - fails)
            drag->from = fmax(fails, drag->from + STEP_M);
        else
            drag->to = fmin(fails, drag->to) - STEP_M;
    }
    return false;
}
