#include "servo/joint_controller.h"

#include <math.h>
#include <string.h>

#include "servo/controller_internal.h"
#include "servo/lag.h"

td_joint_controller_options td_joint_controller_options_default(void)
{
    return (td_joint_controller_options){
        .gain_1_s = 3, .kind = TD_COMMAND_RATE, .limits = td_motion_limits_default()};
}

td_status td_joint_controller_start(td_joint_controller *c, const td_robot *robot,
                                    const td_joint_controller_options *options, td_error *error)
{
    const td_joint_controller_options o = options ? *options : td_joint_controller_options_default();
    TD_TRY(td_controller_check(&o.limits, o.kind, robot, error));
    const double most = td_lag_stable_gain(o.limits.period_s, o.limits.lag_s);
    if (!(o.gain_1_s > 0 && o.gain_1_s < most))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "joint controller: a gain of %g 1/s is not between 0 and %.4g, above which it swings up at "
            "a period of %g s and a lag of %g s",
            o.gain_1_s, most, o.limits.period_s, o.limits.lag_s);
    *c = (td_joint_controller){.options = o, .robot = robot};
    return TD_OK;
}

td_status td_joint_controller_step(td_plant_command *command, td_joint_controller *c, const double *q_wanted,
                                   const double *dq_wanted, const td_plant_state *state, td_error *error)
{
    double rate[TD_ROBOT_MAX_JOINTS];
    for (int k = 0; k < c->robot->joint_count; k++)
        rate[k] = dq_wanted[k] + c->options.gain_1_s * (q_wanted[k] - state->q[k]);
    return td_controller_give(command, c->rate, rate, &c->options.limits, c->options.kind, c->robot, state,
                              false, error);
}
