/* Joints follow a trajectory (TELEDIMOS, 2.1): rate = dq_wanted + K (q_wanted - q), within limits of speed,
 * acceleration, range and oil.
 *
 * There is no integral, so nothing winds up: behind a valve of lag tau the error at a constant rate is dq tau
 * short of what dq_wanted feeds forward, and none at rest. K is stable below td_lag_stable_gain and calm up
 * to td_lag_calm_gain (servo/lag.h): 3.9 1/s at a period of 50 ms and a lag of 50 ms; the paper's K is 3. */
#ifndef TELEDIMOS_SERVO_JOINT_CONTROLLER_H
#define TELEDIMOS_SERVO_JOINT_CONTROLLER_H

#include "motion_limits.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_joint_controller_options {
    double gain_1_s;      /* K; default 3 */
    td_command_kind kind; /* rates (default) or flows */
    td_motion_limits limits;
} td_joint_controller_options;
TD_API td_joint_controller_options td_joint_controller_options_default(void);

typedef struct td_joint_controller {
    td_joint_controller_options options;
    const td_robot *robot;            /* borrowed */
    double rate[TD_ROBOT_MAX_JOINTS]; /* commanded last */
} td_joint_controller;

/* At rest. Options NULL: defaults. Refused by name: a gain that is not stable at that period and lag, forces,
 * and what td_motion_limits_check refuses. */
TD_API td_status td_joint_controller_start(td_joint_controller *controller, const td_robot *robot,
                                           const td_joint_controller_options *options, td_error *error);
/* Once a period. Wanted q and dq (joints). Fails, with a command that brakes all joints, where a number is
 * none or a cylinder does not reach. */
TD_API td_status td_joint_controller_step(td_plant_command *command, td_joint_controller *controller,
                                          const double *q_wanted, const double *dq_wanted,
                                          const td_plant_state *state, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
