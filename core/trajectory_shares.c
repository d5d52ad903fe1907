/* How much of a robot's limits a motion uses. */
#include <math.h>

#include "core/trajectory.h"

typedef struct look {
    td_trajectory_shares *shares;
    const td_trajectory *trajectory;
    const td_robot *robot;
    double pump_m3_s;
} look;

static void keep(td_trajectory_share *most, double share, double time_s, int joint)
{
    if (share > most->share) *most = (td_trajectory_share){share, time_s, joint};
}

/* False: a cylinder does not reach, in *cylinder; or a number is none, with *cylinder -1. */
static bool look_at(const look *l, const double *q, const double *dq, const double *ddq, double time_s,
                    int *cylinder)
{
    const td_robot *r = l->robot;
    double pump = 0;
    *cylinder = -1;
    for (int k = 0; k < r->joint_count; k++) {
        const td_robot_joint *j = r->joint + k;
        if (!isfinite(q[k]) || !isfinite(dq[k]) || !isfinite(ddq[k])) return false;
        if (isfinite(j->lower) && isfinite(j->upper) && j->upper > j->lower)
            keep(&l->shares->position, fabs(2 * q[k] - j->lower - j->upper) / (j->upper - j->lower), time_s,
                 k);
        keep(&l->shares->speed, fabs(dq[k]) / j->speed, time_s, k);
        keep(&l->shares->acceleration, fabs(ddq[k]) / j->acceleration, time_s, k);
    }
    for (int i = 0; i < r->cylinder_count; i++) {
        const td_cylinder *c = r->cylinder + i;
        double flow = 0;
        if (!td_cylinder_flow(&flow, r, c, q[c->joint], dq[c->joint])) {
            *cylinder = i;
            return false;
        }
        keep(&l->shares->flow, fabs(flow) / c->flow_m3_s, time_s, c->joint);
        pump += fabs(flow);
    }
    keep(&l->shares->pump, pump / l->pump_m3_s, time_s, -1);
    return true;
}

static td_status refuse(const look *l, double time_s, int cylinder, td_error *error)
{
    if (cylinder < 0)
        return td_fail(error, TD_ERROR_DATA, "the trajectory is no number at %.6g s: plan it anew", time_s);
    return td_fail(
        error, TD_ERROR_DATA,
        "the trajectory leads joint '%s' to where cylinder '%s' does not reach, at %.6g s: keep within "
        "the joint's limits",
        l->robot->joint[l->robot->cylinder[cylinder].joint].name, l->robot->cylinder[cylinder].name, time_s);
}

static td_status look_between(const look *l, double from_s, double to_s, double rate_hz, td_error *error)
{
    double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS], ddq[TD_ROBOT_MAX_JOINTS];
    const double first = rate_hz > 0 ? floor(from_s * rate_hz) + 1 : 0;
    for (double i = 0;; i++) {
        const double time_s = rate_hz > 0 ? (first + i) / rate_hz : (from_s + to_s) / 2;
        int cylinder = -1;
        if (time_s >= to_s || (rate_hz <= 0 && i > 0)) return TD_OK;
        td_trajectory_at(q, dq, ddq, l->trajectory, time_s);
        if (!look_at(l, q, dq, ddq, time_s, &cylinder)) return refuse(l, time_s, cylinder, error);
    }
}

td_status td_trajectory_check(td_trajectory_shares *shares, const td_trajectory *trajectory,
                              const td_robot *robot, double pump_m3_s, double rate_hz, td_error *error)
{
    const td_trajectory_share none = {0, 0, -1};
    const look l = {shares, trajectory, robot, pump_m3_s};
    const size_t n = (size_t)trajectory->joints;
    *shares = (td_trajectory_shares){none, none, none, none, none};
    if (trajectory->joints != robot->joint_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "the trajectory is of %d joints, robot '%s' has %d",
                       trajectory->joints, robot->name, robot->joint_count);
    if (!(rate_hz >= 0 && rate_hz <= 1e6) || !(pump_m3_s > 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "to look %g times a second at pumps of %g m^3/s: give 0 to 1e6 and more than 0",
                       rate_hz, pump_m3_s);
    for (size_t i = 0; i < trajectory->count; i++) {
        int cylinder = -1;
        const double time_s = trajectory->time_s[i];
        if (!look_at(&l, trajectory->q + i * n, trajectory->dq + i * n, trajectory->ddq + i * n, time_s,
                     &cylinder))
            return refuse(&l, time_s, cylinder, error);
        if (i + 1 < trajectory->count && trajectory->time_s[i + 1] > time_s)
            TD_TRY(look_between(&l, time_s, trajectory->time_s[i + 1], rate_hz, error));
    }
    return TD_OK;
}
