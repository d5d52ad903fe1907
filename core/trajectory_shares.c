/* How much of a robot's limits a motion uses. */
#include <math.h>

#include "core/trajectory.h"

typedef struct look {
    td_trajectory_shares *shares;
    const td_trajectory *trajectory;
    const td_robot *robot;
    double pump_m3_s;
    double *pump; /* its share where it was last looked */
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
    *l->pump = pump / l->pump_m3_s;
    keep(&l->shares->pump, *l->pump, time_s, -1);
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

static td_status look_when(const look *l, double time_s, double *ddq, td_error *error)
{
    double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS];
    int cylinder = -1;
    td_trajectory_at(q, dq, ddq, l->trajectory, time_s);
    return look_at(l, q, dq, ddq, time_s, &cylinder) ? TD_OK : refuse(l, time_s, cylinder, error);
}

static td_status look_often(const look *l, double from_s, double to_s, double rate_hz, td_error *error)
{
    double ddq[TD_ROBOT_MAX_JOINTS];
    for (double i = floor(from_s * rate_hz) + 1; i / rate_hz < to_s; i++)
        TD_TRY(look_when(l, i / rate_hz, ddq, error));
    return TD_OK;
}

/* The cubic through f at 0, 1, 2, 3: where between them it is largest or smallest, in at; how many such
 * places. */
static int turns(double at[2], double value[2], const double f[4])
{
    const double a = (-11 * f[0] + 18 * f[1] - 9 * f[2] + 2 * f[3]) / 6,
                 b = (2 * f[0] - 5 * f[1] + 4 * f[2] - f[3]) / 2,
                 c = (-f[0] + 3 * f[1] - 3 * f[2] + f[3]) / 6;
    const double inner = b * b - 3 * a * c, sum = -(b + copysign(sqrt(fmax(inner, 0)), b));
    const double root[2] = {sum / (3 * c), a / sum};
    int count = 0;
    for (int i = 0; i < 2 && inner >= 0; i++)
        if (root[i] > 0 && root[i] < 3) { /* not where it is none or infinite */
            at[count] = root[i];
            value[count++] = f[0] + root[i] * (a + root[i] * (b + root[i] * c));
        }
    return count;
}

static td_status look_at_knot(const look *l, size_t knot, td_error *error)
{
    const td_trajectory *t = l->trajectory;
    const size_t at = knot * (size_t)t->joints;
    int cylinder = -1;
    return look_at(l, t->q + at, t->dq + at, t->ddq + at, t->time_s[knot], &cylinder)
               ? TD_OK
               : refuse(l, t->time_s[knot], cylinder, error);
}

/* Between two knots an acceleration is a cubic, so its extremes are exact from four places; a rate has its
 * own where the acceleration passes 0; the pumps' flow is near enough to a cubic. The first knot has just
 * been looked at; so is the other one here. */
static td_status look_exactly(const look *l, size_t knot, double from_s, double to_s, td_error *error)
{
    const size_t n = (size_t)l->trajectory->joints;
    const double third = (to_s - from_s) / 3;
    double all[2][TD_ROBOT_MAX_JOINTS], unused[TD_ROBOT_MAX_JOINTS], pump[4] = {*l->pump}, at[2], value[2];
    for (int i = 1; i < 3; i++) {
        TD_TRY(look_when(l, from_s + i * third, all[i - 1], error));
        pump[i] = *l->pump;
    }
    TD_TRY(look_at_knot(l, knot + 1, error));
    pump[3] = *l->pump;
    for (int i = turns(at, value, pump); i-- > 0;)
        keep(&l->shares->pump, value[i], from_s + at[i] * third, -1);
    for (size_t k = 0; k < n; k++) {
        const double *ddq = l->trajectory->ddq + knot * n + k, f[4] = {ddq[0], all[0][k], all[1][k], ddq[n]};
        for (int i = turns(at, value, f); i-- > 0;)
            keep(&l->shares->acceleration, fabs(value[i]) / l->robot->joint[k].acceleration,
                 from_s + at[i] * third, (int)k);
        for (int i = 0; i < 3; i++)
            if (f[i] * f[i + 1] < 0)
                TD_TRY(look_when(l, from_s + (i + f[i] / (f[i] - f[i + 1])) * third, unused, error));
    }
    return TD_OK;
}

static td_status look_along(const look *l, double rate_hz, td_error *error)
{
    const td_trajectory *t = l->trajectory;
    bool seen = false;
    for (size_t i = 0; i < t->count; i++) {
        const bool last = i + 1 == t->count || t->time_s[i + 1] == t->time_s[i];
        if (!seen) TD_TRY(look_at_knot(l, i, error));
        seen = !last && rate_hz == 0;
        if (seen)
            TD_TRY(look_exactly(l, i, t->time_s[i], t->time_s[i + 1], error));
        else if (!last)
            TD_TRY(look_often(l, t->time_s[i], t->time_s[i + 1], rate_hz, error));
    }
    return TD_OK;
}

td_status td_trajectory_check(td_trajectory_shares *shares, const td_trajectory *trajectory,
                              const td_robot *robot, double pump_m3_s, double rate_hz, td_error *error)
{
    const td_trajectory_share none = {0, 0, -1};
    double pump = 0;
    const look l = {shares, trajectory, robot, pump_m3_s, &pump};
    *shares = (td_trajectory_shares){none, none, none, none, none};
    if (trajectory->joints != robot->joint_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "the trajectory is of %d joints, robot '%s' has %d",
                       trajectory->joints, robot->name, robot->joint_count);
    if (!(rate_hz >= 0 && rate_hz <= 1e6) || !(pump_m3_s > 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "to look %g times a second at pumps of %g m^3/s: give 0 to 1e6 and more than 0",
                       rate_hz, pump_m3_s);
    return look_along(&l, rate_hz, error);
}
