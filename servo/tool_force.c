#include "servo/tool_force.h"

#include <math.h>
#include <string.h>

#include "core/linalg.h"
#include "servo/controller_internal.h"

/* What each joint's cylinders turn it with. */
static bool joint_torques(double *torque, const td_robot *robot, const td_plant_state *state)
{
    memcpy(torque, state->force, (size_t)robot->joint_count * sizeof *torque);
    for (int i = 0; i < robot->cylinder_count; i++) {
        const int k = robot->cylinder[i].joint;
        double lever = 0;
        if (!td_cylinder_length(NULL, &lever, robot, robot->cylinder + i, state->q[k])) return false;
        torque[k] = fabs(lever) * state->force[k];
    }
    return true;
}

/* J' F = torque. */
static td_status push_of(double force[3], size_t *rank, const td_robot *robot, const double *q,
                         const double *torque, int link, const double point_m[3], td_error *error)
{
    const int n = robot->joint_count;
    double jacobian[3 * TD_ROBOT_MAX_JOINTS], turned[3 * TD_ROBOT_MAX_JOINTS], point[3];
    td_point_motion(point, jacobian, robot, q, link, point_m);
    for (int k = 0; k < n; k++)
        for (int i = 0; i < 3; i++) turned[3 * k + i] = jacobian[i * n + k];
    return td_least_squares_linear(force, rank, turned, torque, (size_t)n, 3, error);
}

td_status td_tool_force(double force[3], const td_robot *robot, const td_plant_state *state,
                        const double *statics, int link, const double point_m[3], td_error *error)
{
    const int n = robot->joint_count;
    double torque[TD_ROBOT_MAX_JOINTS];
    size_t rank = 0;
    bool known = n >= 3;
    for (int k = 0; k < n; k++)
        known = known && isfinite(state->q[k]) && isfinite(state->force[k] + statics[k]);
    if (!known || !joint_torques(torque, robot, state))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "force at the tool of '%s': it has fewer than 3 joints, a reading is no number, or a "
                       "cylinder does not reach",
                       robot->name);
    for (int k = 0; k < n; k++) torque[k] = statics[k] - torque[k];
    TD_TRY(push_of(force, &rank, robot, state->q, torque, link, point_m, error));
    if (rank == 3) return TD_OK;
    return td_fail(
        error, TD_ERROR_DATA,
        "force at the tool of '%s': in this pose its joints do not tell all three directions; bend the "
        "arm",
        robot->name);
}

/* Torques that accelerate the joints by ddq from rest: sum over the links of Jv' m Jv + Jw' I Jw. */
static void inertia_torques(double *torque, const td_robot *robot, const double *q, const double *ddq)
{
    const int n = robot->joint_count;
    double jacobian[6 * TD_ROBOT_MAX_JOINTS], moving[3 * TD_ROBOT_MAX_JOINTS], com[3];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, robot, q);
    memset(torque, 0, (size_t)n * sizeof *torque);
    for (int l = 0; l < robot->link_count; l++) {
        const td_robot_link *link = robot->link + l;
        if (!(link->mass_kg > 0)) continue;
        double force[3] = {0}, turn[3] = {0}, own[3], moment[3] = {0};
        td_point_motion(com, moving, robot, q, l, link->com_m);
        td_robot_jacobian(jacobian, robot, at, l);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < n; k++) {
                force[i] += link->mass_kg * moving[i * n + k] * ddq[k];
                turn[i] += jacobian[i * n + k] * ddq[k];
            }
        const td_pose back = td_pose_inverse(at + l);
        td_pose_rotate(own, &back, turn);
        for (int i = 0; i < 9; i++) moment[i / 3] += link->inertia[i] * own[i % 3];
        td_pose_rotate(turn, at + l, moment);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < n; k++)
                torque[k] += moving[i * n + k] * force[i] + jacobian[i * n + k] * turn[i];
    }
}

double td_tool_mass(const td_robot *robot, const double *q, int link, const double point_m[3],
                    const double axis[3])
{
    double ddq[TD_ROBOT_MAX_JOINTS], torque[TD_ROBOT_MAX_JOINTS], force[3];
    size_t rank = 0;
    if (robot->joint_count < 3 || !td_point_rates(ddq, robot, q, link, point_m, axis)) return 0;
    inertia_torques(torque, robot, q, ddq);
    if (push_of(force, &rank, robot, q, torque, link, point_m, NULL) != TD_OK || rank < 3) return 0;
    return fmax(force[0] * axis[0] + force[1] * axis[1] + force[2] * axis[2], 0);
}
