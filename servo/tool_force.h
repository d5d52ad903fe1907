/* What the ground does to the tool, told by the cylinders, and with what mass the arm resists there. */
#ifndef TELEDIMOS_SERVO_TOOL_FORCE_H
#define TELEDIMOS_SERVO_TOOL_FORCE_H

#include "../core/plant.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Force on a link's point (m, in its frame) from outside, N, in the root's axes. Cylinders give the joints'
 * torques t; what holds the arm needs g of them (statics (joints), N m or N: gravity from generated dynamics,
 * with friction where it is known); the rest the ground takes: J' F = g - t, by least squares. What
 * accelerates the arm counts as force too: move slowly. Fails: fewer than 3 joints, a pose in which they do
 * not tell the force, what is no number. */
TD_API td_status td_tool_force(double force[3], const td_robot *robot, const td_plant_state *state,
                               const double *statics, int link, const double point_m[3], td_error *error);
/* Force along an axis (root's frame, length 1) by the acceleration along it, as td_tool_force takes it for
 * one: of the links' masses in this pose, the base at rest, kg. 0 where the joints do not tell it. */
TD_API double td_tool_mass(const td_robot *robot, const double *q, int link, const double point_m[3],
                           const double axis[3]);

#ifdef __cplusplus
}
#endif
#endif
