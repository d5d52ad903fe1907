#include "servo/force_controller.h"

#include <math.h>
#include <string.h>

#include "servo/controller_internal.h"
#include "servo/lag.h"
#include "servo/tool_force.h"

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

td_force_controller_options td_force_controller_options_default(void)
{
    return (td_force_controller_options){.link = -1,
                                         .axis = {0, 0, -1},
                                         .approach_m_s = 0.05,
                                         .most_travel_m = INFINITY,
                                         .stiffness_n_m = 1e6,
                                         .hold_1_s = 3,
                                         .kind = TD_COMMAND_RATE,
                                         .limits = td_motion_limits_default()};
}

static td_status check_positive(const char *name, double value, td_error *error)
{
    if (value > 0) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "force controller: %s is %g, but must be above 0", name, value);
}

static td_status check_numbers(const td_force_controller_options *o, td_error *error)
{
    const double finite = o->force_n + o->approach_m_s + o->stiffness_n_m + o->hold_1_s + o->point_m[0] +
                          o->point_m[1] + o->point_m[2] + dot(o->axis, o->axis);
    TD_TRY(check_positive("the force, N,", o->force_n, error));
    TD_TRY(check_positive("the speed of approach, m/s,", o->approach_m_s, error));
    TD_TRY(check_positive("the most travel, m,", o->most_travel_m, error));
    TD_TRY(check_positive("the stiffness, N/m,", o->stiffness_n_m, error));
    if (!(o->mass_kg >= 0 && o->mass_kg < 1e9))
        return td_fail(error, TD_ERROR_ARGUMENT, "force controller: a mass of %g kg", o->mass_kg);
    TD_TRY(check_positive("the axis' length", dot(o->axis, o->axis), error));
    if (isfinite(finite)) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "force controller: a number of its options is not finite");
}

static td_status check_gains(td_force_controller_options *o, td_error *error)
{
    const double period = o->limits.period_s, lag = o->limits.lag_s, most = td_lag_stable_gain(period, lag),
                 least = td_lag_least_damping(o->stiffness_n_m, o->mass_kg, period, lag),
                 calm = fmax(o->stiffness_n_m / td_lag_calm_gain(period, lag), 2 * least);
    if (o->damping_ns_m == 0) o->damping_ns_m = calm;
    if (!(o->damping_ns_m > least && isfinite(o->damping_ns_m)))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "force controller: a damping of %g N s/m swings up on a stiffness of %g N/m with a mass of %.4g "
            "kg at a period of %g s and a lag of %g s; it must be above %.4g, and is calm from %.4g",
            o->damping_ns_m, o->stiffness_n_m, o->mass_kg, period, lag, least, calm);
    if (!(o->hold_1_s >= 0 && o->hold_1_s < most))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "force controller: a gain across the axis of %g 1/s is not within 0 to %.4g",
                       o->hold_1_s, most);
    return TD_OK;
}

td_status td_force_controller_start(td_force_controller *c, const td_robot *robot,
                                    const td_force_controller_options *options, const td_plant_state *state,
                                    td_error *error)
{
    td_force_controller_options o = *options;
    double jacobian[3 * TD_ROBOT_MAX_JOINTS];
    TD_TRY(td_controller_check(&o.limits, o.kind, robot, error));
    if (o.link < 0 || o.link >= robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "force controller: robot '%s' has no link %d", robot->name,
                       o.link);
    for (int k = 0; k < robot->joint_count; k++)
        if (!isfinite(state->q[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "force controller: joint '%s' stands at no number",
                           robot->joint[k].name);
    TD_TRY(check_numbers(&o, error));
    const double length = sqrt(dot(o.axis, o.axis));
    for (int i = 0; i < 3; i++) o.axis[i] /= length;
    if (o.mass_kg == 0) o.mass_kg = td_tool_mass(robot, state->q, o.link, o.point_m, o.axis);
    TD_TRY(check_gains(&o, error));
    *c = (td_force_controller){.options = o, .robot = robot};
    td_point_motion(c->begin, jacobian, robot, state->q, o.link, o.point_m);
    return TD_OK;
}

/* Along the axis, from the force that the tool pushes with. */
static double along(const td_force_controller *c)
{
    const td_force_controller_options *o = &c->options;
    const double wanted = (o->force_n - c->force_n) / o->damping_ns_m;
    const double speed = fmax(-o->approach_m_s, fmin(o->approach_m_s, wanted));
    return c->at_end ? fmin(speed, 0) : speed;
}

td_status td_force_controller_step(td_plant_command *command, td_force_controller *c,
                                   const td_plant_state *state, const double *statics, td_error *error)
{
    const td_force_controller_options *o = &c->options;
    double force[3], point[3], gone[3], velocity[3], rate[TD_ROBOT_MAX_JOINTS] = {0},
                                                     jacobian[3 * TD_ROBOT_MAX_JOINTS];
    td_status status = td_tool_force(force, c->robot, state, statics, o->link, o->point_m, error);
    if (status == TD_OK) {
        td_point_motion(point, jacobian, c->robot, state->q, o->link, o->point_m);
        for (int i = 0; i < 3; i++) gone[i] = point[i] - c->begin[i];
        c->force_n = -dot(force, o->axis);
        c->travel_m = dot(gone, o->axis);
        c->at_end = c->travel_m >= o->most_travel_m;
        const double speed = along(c);
        for (int i = 0; i < 3; i++) {
            gone[i] -= c->travel_m * o->axis[i];
            velocity[i] = speed * o->axis[i] - o->hold_1_s * gone[i];
        }
        c->across_m = sqrt(dot(gone, gone));
        if (!td_point_rates(rate, c->robot, state->q, o->link, o->point_m, velocity))
            memset(rate, 0, sizeof rate);
    }
    const td_status given = td_controller_give(command, c->rate, rate, &o->limits, o->kind, c->robot, state,
                                               true, status == TD_OK ? error : NULL);
    return status == TD_OK ? given : status;
}
