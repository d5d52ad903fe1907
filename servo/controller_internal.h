/* What the controllers share. */
#ifndef TELEDIMOS_SERVO_CONTROLLER_INTERNAL_H
#define TELEDIMOS_SERVO_CONTROLLER_INTERNAL_H

#include "servo/motion_limits.h"

/* Limits as td_motion_limits_check; kind: no forces. */
td_status td_controller_check(const td_motion_limits *limits, td_command_kind kind, const td_robot *robot,
                              td_error *error);

/* Rates through the limits into a command; `last` becomes what was given. */
td_status td_controller_give(td_plant_command *command, double *last, double *rate,
                             const td_motion_limits *limits, td_command_kind kind, const td_robot *robot,
                             const td_plant_state *state, bool together, td_error *error);

/* A point of a link: where it is in the root's frame, and its Jacobian (3,joints) there. */
void td_point_motion(double point[3], double *jacobian, const td_robot *robot, const double *q, int link,
                     const double point_m[3]);

/* Rates that move the point by `velocity` (root's frame) and keep the angle of the link's x axis to the
 * horizon where the arm can: J' (J J' + lambda^2)^-1 with a row for the angle, a radian of which weighs as
 * much as a metre. Damped (lambda 0.01 m), so an arm that is stretched out goes slow. False: no number. */
bool td_point_rates(double *rate, const td_robot *robot, const double *q, int link, const double point_m[3],
                    const double velocity[3]);

#endif
