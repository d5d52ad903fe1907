#include "servo/motion_limits.h"

#include <math.h>
#include <string.h>

td_motion_limits td_motion_limits_default(void)
{
    return (td_motion_limits){
        .period_s = 0.02, .lag_s = 0.05, .speed_share = 1, .acceleration_share = 1, .margin = 0.01};
}

static td_status check_number(const char *name, double value, double low, double high, td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "limits of motion: %s is %g, but must lie between %g and %g",
                   name, value, low, high);
}

td_status td_motion_limits_check(const td_motion_limits *l, const td_robot *robot, td_error *error)
{
    TD_TRY(check_number("the period, s,", l->period_s, 1e-4, 10, error));
    TD_TRY(check_number("the lag, s,", l->lag_s, 0, 100, error));
    TD_TRY(check_number("the share of speed", l->speed_share, 1e-6, 1, error));
    TD_TRY(check_number("the share of acceleration", l->acceleration_share, 1e-6, 1, error));
    TD_TRY(check_number("the pumps' flow, m^3/s,", l->pump_m3_s, 0, INFINITY, error));
    TD_TRY(check_number("the margin before stops", l->margin, 0, 1e3, error));
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        if (!(j->speed > 0 && isfinite(j->speed)) || !(j->acceleration > 0 && isfinite(j->acceleration)))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "robot '%s': joint '%s' has no limit of speed (URDF) or acceleration (the YAML beside "
                "it); give both",
                robot->name, j->name);
    }
    return TD_OK;
}

double td_stopping_speed(double distance, double acceleration, double period_s)
{
    if (!(distance > 0)) return 0;
    const double change = acceleration * period_s, periods = distance / (change * period_s),
                 m = floor((sqrt(1 + 8 * periods) - 1) / 2);
    return change * (m / 2 + periods / (m + 1));
}

/* ---- oil ---- */

/* m^3/s for each rad/s of a joint that turns that way; 0 for motors. */
typedef struct oil {
    double each[TD_ROBOT_MAX_JOINTS][2]; /* [1]: as the angle grows */
    double most[TD_ROBOT_MAX_JOINTS], pump;
} oil;

static bool fill_oil(oil *o, const td_motion_limits *l, const td_robot *robot, const double *q)
{
    memset(o, 0, sizeof *o);
    o->pump = l->pump_m3_s > 0 ? l->pump_m3_s : td_robot_pump(robot);
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *c = robot->cylinder + i;
        for (int grows = 0; grows < 2; grows++) {
            double flow = 0;
            if (!td_cylinder_flow(&flow, robot, c, q[c->joint], grows ? 1 : -1)) return false;
            o->each[c->joint][grows] = fabs(flow);
        }
        o->most[c->joint] = c->flow_m3_s;
    }
    return true;
}

static double taken(const oil *o, const double *rate, int n)
{
    double sum = 0;
    for (int k = 0; k < n; k++) sum += o->each[k][rate[k] > 0] * fabs(rate[k]);
    return sum;
}

/* ---- rates ---- */

/* What each joint may do, whatever it did before. */
static void find_bounds(double *low, double *high, const td_motion_limits *l, const td_robot *robot,
                        const oil *o, const double *q, const double *dq)
{
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        const double a = j->acceleration * l->acceleration_share, rest = q[k] + l->lag_s * dq[k];
        const double speed = j->speed * l->speed_share;
        double bound[2] = {fmin(speed, td_stopping_speed(rest - j->lower - l->margin, a, l->period_s)),
                           fmin(speed, td_stopping_speed(j->upper - l->margin - rest, a, l->period_s))};
        for (int grows = 0; grows < 2; grows++)
            if (o->each[k][grows] > 0) bound[grows] = fmin(bound[grows], o->most[k] / o->each[k][grows]);
        low[k] = -bound[0];
        high[k] = bound[1];
    }
}

static double held(double value, double low, double high)
{
    return fmax(low, fmin(high, value));
}

/* The share of wanted rates that is within the bounds, which hold 0 between them. */
static double share_within(const double *rate, const double *low, const double *high, int n)
{
    double share = 1;
    for (int k = 0; k < n; k++) {
        if (rate[k] > high[k]) share = fmin(share, high[k] / rate[k]);
        if (rate[k] < low[k]) share = fmin(share, low[k] / rate[k]);
    }
    return share;
}

/* From the last rates towards the target as far as accelerations allow. */
static void accelerate(double *rate, const double *step, const double *low, const double *high,
                       const double *last, int n, bool together)
{
    double part = 1;
    for (int k = 0; k < n && together; k++) {
        const double change = fabs(rate[k] - last[k]);
        if (change > step[k]) part = fmin(part, step[k] / change);
    }
    for (int k = 0; k < n; k++) {
        const double target = last[k] + part * (rate[k] - last[k]);
        rate[k] = held(held(target, low[k], high[k]), last[k] - step[k], last[k] + step[k]);
    }
}

/* Joints that speed up wait for oil that others, braking, still take. */
static void wait_for_oil(double *rate, const oil *o, const double *last, int n)
{
    enum { HALVINGS = 40 };
    double tried[TD_ROBOT_MAX_JOINTS], low = 0, high = 1;
    if (taken(o, rate, n) <= o->pump) return;
    for (int i = 0; i <= HALVINGS; i++) {
        const double part = i < HALVINGS ? (low + high) / 2 : low;
        for (int k = 0; k < n; k++) {
            const bool faster = fabs(rate[k]) > fabs(last[k]);
            tried[k] = faster ? last[k] + part * (rate[k] - last[k]) : rate[k];
        }
        *(taken(o, tried, n) <= o->pump ? &low : &high) = part;
    }
    memcpy(rate, tried, (size_t)n * sizeof *rate);
}

static bool all_known(const double *value, int n)
{
    for (int k = 0; k < n; k++)
        if (!isfinite(value[k])) return false;
    return true;
}

bool td_motion_limits_apply(double *rate, const td_motion_limits *l, const td_robot *robot, const double *q,
                            const double *dq, const double *last, bool together)
{
    const int n = robot->joint_count;
    double low[TD_ROBOT_MAX_JOINTS], high[TD_ROBOT_MAX_JOINTS], step[TD_ROBOT_MAX_JOINTS];
    oil o;
    for (int k = 0; k < n; k++) step[k] = robot->joint[k].acceleration * l->acceleration_share * l->period_s;
    if (!all_known(rate, n) || !all_known(q, n) || !all_known(dq, n) || !fill_oil(&o, l, robot, q)) {
        for (int k = 0; k < n; k++) rate[k] = last[k] - held(last[k], -step[k], step[k]);
        return false;
    }
    find_bounds(low, high, l, robot, &o, q, dq);
    const double share = together ? share_within(rate, low, high, n) : 1;
    for (int k = 0; k < n; k++) rate[k] = held(share * rate[k], low[k], high[k]);
    const double flow = taken(&o, rate, n);
    for (int k = 0; k < n && flow > o.pump; k++) rate[k] *= o.pump / flow;
    accelerate(rate, step, low, high, last, n, together);
    wait_for_oil(rate, &o, last, n);
    return true;
}

bool td_rates_command(td_plant_command *command, td_command_kind kind, const td_robot *robot, const double *q,
                      const double *rate)
{
    *command = (td_plant_command){.kind = kind};
    memcpy(command->value, rate, (size_t)robot->joint_count * sizeof *rate);
    if (kind != TD_COMMAND_FLOW) return kind == TD_COMMAND_RATE;
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *c = robot->cylinder + i;
        double flow = 0;
        if (!td_cylinder_flow(&flow, robot, c, q[c->joint], rate[c->joint])) return false;
        command->value[c->joint] = copysign(flow, rate[c->joint]);
    }
    return true;
}
