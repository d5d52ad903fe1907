/* What the camera shows, its error, and how it moves. */
#include <math.h>
#include <string.h>

#include "servo/visual_servo_internal.h"

int td_servo_error_of(double *e, const td_servo_features *f)
{
    if (f->kind == TD_SERVO_POSE) {
        td_rotation_log(e, f->goal_from_camera.q);
        for (int i = 0; i < 3; i++) {
            e[i] *= f->radius_m;
            e[3 + i] = f->goal_from_camera.t[i];
        }
        return 6;
    }
    for (int i = 0; i < f->count; i++)
        for (int k = 0; k < 2; k++) e[2 * i + k] = f->now[i][k] - f->goal[i][k];
    return 2 * f->count;
}

/* Chaumette and Hutchinson 2006, (11), with the columns of omega first. */
void td_servo_point_rows(double rows[12], double x, double y, double depth)
{
    const double row[12] = {x * y,     -(1 + x * x), y,  -1 / depth, 0,          x / depth,
                            1 + y * y, -x * y,       -x, 0,          -1 / depth, y / depth};
    memcpy(rows, row, sizeof row);
}

static void add_point(double *rows, const double s[3], double share)
{
    double one[12];
    td_servo_point_rows(one, s[0], s[1], s[2]);
    for (int i = 0; i < 12; i++) rows[i] += share * one[i];
}

/* theta u of R turns by the camera's own omega through the inverse of SO(3)'s right Jacobian, the transposed
 * left one's; t by R v. */
static void add_pose(double *l, const td_pose *goal_from_camera, double radius_m, double share)
{
    double omega[3], turn[9], r[9];
    td_rotation_log(omega, goal_from_camera->q);
    td_rotation_left_jacobian_inverse(turn, omega);
    td_pose_rotation(r, goal_from_camera);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            l[i * 6 + k] += share * radius_m * turn[3 * k + i];
            l[(3 + i) * 6 + 3 + k] += share * r[3 * i + k];
        }
}

int td_servo_interaction(double *l, const td_servo_features *f)
{
    const int rows = f->kind == TD_SERVO_POSE ? 6 : 2 * f->count;
    const double now = f->interaction == TD_INTERACTION_CURRENT ? 1
                       : f->interaction == TD_INTERACTION_MEAN  ? 0.5
                                                                : 0;
    const td_pose there = td_pose_identity();
    memset(l, 0, 6 * (size_t)rows * sizeof *l);
    if (f->kind == TD_SERVO_POSE) {
        if (now > 0) add_pose(l, &f->goal_from_camera, f->radius_m, now);
        if (now < 1) add_pose(l, &there, f->radius_m, 1 - now);
        return rows;
    }
    for (int i = 0; i < f->count; i++) {
        if (now > 0) add_point(l + 12 * i, f->now[i], now);
        if (now < 1) add_point(l + 12 * i, f->goal[i], 1 - now);
    }
    return rows;
}

void td_servo_jacobian(double *jacobian, td_pose *root_from_camera, const td_servo_eye *eye, const double *q)
{
    if (root_from_camera) *root_from_camera = td_pose_identity();
    if (!eye->robot) {
        for (int i = 0; i < 36; i++) jacobian[i] = i % 7 == 0;
        return;
    }
    const int n = eye->robot->joint_count;
    double camera[6 * TD_ROBOT_MAX_JOINTS], target[6 * TD_ROBOT_MAX_JOINTS], ad[36];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, eye->robot, q);
    td_robot_jacobian(camera, eye->robot, at, eye->camera_link);
    td_robot_jacobian(target, eye->robot, at, eye->target_link);
    const td_pose from = td_pose_compose(at + eye->camera_link, &eye->link_from_camera);
    const td_pose to = td_pose_inverse(&from);
    td_pose_adjoint(ad, &to);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < n; k++) {
            double sum = 0;
            for (int j = 0; j < 6; j++) sum += ad[6 * i + j] * (camera[j * n + k] - target[j * n + k]);
            jacobian[i * n + k] = sum;
        }
    if (root_from_camera) *root_from_camera = from;
}
