#include <math.h>
#include <string.h>

#include "core/linalg.h"
#include "servo/controller_internal.h"

enum { ROWS = 4 };
static const double DAMPING_M = 0.01;

td_status td_controller_check(const td_motion_limits *limits, td_command_kind kind, const td_robot *robot,
                              td_error *error)
{
    TD_TRY(td_motion_limits_check(limits, robot, error));
    if (kind == TD_COMMAND_RATE || kind == TD_COMMAND_FLOW) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "controller: commands must be rates or flows");
}

td_status td_controller_give(td_plant_command *command, double *last, double *rate,
                             const td_motion_limits *limits, td_command_kind kind, const td_robot *robot,
                             const td_plant_state *state, bool together, td_error *error)
{
    const bool ok = td_motion_limits_apply(rate, limits, robot, state->q, state->dq, last, together) &&
                    td_rates_command(command, kind, robot, state->q, rate);
    memcpy(last, rate, (size_t)robot->joint_count * sizeof *last);
    if (ok) return TD_OK;
    *command = (td_plant_command){.kind = TD_COMMAND_RATE};
    memcpy(command->value, rate, (size_t)robot->joint_count * sizeof *rate);
    return td_fail(
        error, TD_ERROR_ARGUMENT,
        "controller of '%s': a wish or a reading is no number, or a cylinder does not reach; it brakes",
        robot->name);
}

/* root_from_link's Jacobian is of the point at the root's origin: that of p is tau + omega x p. */
static void move_to(double v[3], const double *column, int n, const double point[3])
{
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        v[i] = column[(3 + i) * n] + column[j * n] * point[k] - column[k * n] * point[j];
    }
}

/* Of the link's x axis below the horizon: its axis is level, across the x axis. None where that stands
 * upright. */
static void pitch_row(double *row, const double *jacobian, int n, const td_pose *root_from_link)
{
    static const double ahead[3] = {1, 0, 0};
    double x[3];
    td_pose_rotate(x, root_from_link, ahead);
    const double level = hypot(x[0], x[1]);
    for (int k = 0; k < n; k++)
        row[k] = level > 1e-6 ? (x[0] * jacobian[n + k] - x[1] * jacobian[k]) / level : 0;
}

static void motion(double point[3], double *rows, const td_robot *robot, const double *q, int link,
                   const double point_m[3])
{
    const int n = robot->joint_count;
    double jacobian[6 * TD_ROBOT_MAX_JOINTS];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, robot, q);
    td_robot_jacobian(jacobian, robot, at, link);
    td_pose_transform(point, at + link, point_m);
    for (int k = 0; k < n; k++) {
        double v[3];
        move_to(v, jacobian + k, n, point);
        for (int i = 0; i < 3; i++) rows[i * n + k] = v[i];
    }
    pitch_row(rows + 3 * n, jacobian, n, at + link);
}

void td_point_motion(double point[3], double *jacobian, const td_robot *robot, const double *q, int link,
                     const double point_m[3])
{
    double rows[ROWS * TD_ROBOT_MAX_JOINTS];
    motion(point, rows, robot, q, link, point_m);
    memcpy(jacobian, rows, 3 * (size_t)robot->joint_count * sizeof *jacobian);
}

bool td_point_rates(double *rate, const td_robot *robot, const double *q, int link, const double point_m[3],
                    const double velocity[3])
{
    const int n = robot->joint_count;
    const double wanted[ROWS] = {velocity[0], velocity[1], velocity[2], 0};
    double point[3], rows[ROWS * TD_ROBOT_MAX_JOINTS], square[ROWS * ROWS], part[ROWS] = {0};
    for (int k = 0; k < n; k++)
        if (!isfinite(q[k])) return false;
    motion(point, rows, robot, q, link, point_m);
    td_multiply_transposed(square, rows, rows, ROWS, (size_t)n, ROWS);
    for (int i = 0; i < ROWS; i++) square[i * (ROWS + 1)] += DAMPING_M * DAMPING_M;
    if (td_invert_spd(square, square, ROWS, NULL) != TD_OK) return false;
    for (int i = 0; i < ROWS; i++)
        for (int k = 0; k < ROWS; k++) part[i] += square[i * ROWS + k] * wanted[k];
    for (int k = 0; k < n; k++) {
        rate[k] = 0;
        for (int i = 0; i < ROWS; i++) rate[k] += rows[i * n + k] * part[i];
    }
    return true;
}
