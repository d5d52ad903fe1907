/* How far the tool is from where the servo was to bring it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "servo/controller_internal.h"
#include "servo/visual_servo_internal.h"

enum { N = TD_ROBOT_MAX_JOINTS };

/* Where the servo rests, J dq + de = 0 in what J reaches, so the tool is off by G de, G = -J_tool J+. */
typedef struct effect {
    int rows, parameters; /* of e; camera's + 12 */
    double *g;            /* (3,rows) */
    double *image;        /* (rows,rows): covariance of de by one image's noise */
    double *common;       /* (rows,parameters): derivative of de by what is common */
} effect;

static void effect_free(effect *f)
{
    free(f->g);
    free(f->image);
    free(f->common);
}

static td_status effect_allocate(effect *f, int rows, int parameters, td_error *error)
{
    const size_t m = (size_t)rows;
    *f = (effect){.rows = rows,
                  .parameters = parameters,
                  .g = calloc(3 * m, sizeof *f->g),
                  .image = calloc(m * m, sizeof *f->image),
                  .common = calloc(m * (size_t)parameters, sizeof *f->common)};
    if (f->g && f->image && f->common) return TD_OK;
    effect_free(f);
    return td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

/* Errors of the transforms on either side turn into a twist of the camera against the target: Ad of
 * camera_from_link by the camera's, against that by the target's. */
static void add_transforms(effect *f, const double *l, const td_servo_eye *eye, const double *q)
{
    double of_camera[36], of_target[36];
    td_pose camera_from_link = td_pose_identity(), camera_from_target_link = td_pose_identity();
    if (eye->robot) {
        td_pose at[TD_ROBOT_MAX_LINKS];
        td_robot_forward(at, eye->robot, q);
        camera_from_link = td_pose_inverse(&eye->link_from_camera);
        const td_pose link_from_root = td_pose_inverse(at + eye->camera_link);
        const td_pose camera_from_root = td_pose_compose(&camera_from_link, &link_from_root);
        camera_from_target_link = td_pose_compose(&camera_from_root, at + eye->target_link);
    }
    td_pose_adjoint(of_camera, &camera_from_link);
    td_pose_adjoint(of_target, &camera_from_target_link);
    const int first = f->parameters - 12;
    for (int i = 0; i < f->rows; i++)
        for (int k = 0; k < 6; k++)
            for (int j = 0; j < 6; j++) {
                if (eye->robot)
                    f->common[i * f->parameters + first + k] += l[6 * i + j] * of_camera[6 * j + k];
                f->common[i * f->parameters + first + 6 + k] -= l[6 * i + j] * of_target[6 * j + k];
            }
}

/* d(x, y) / d pixel, and what wrong parameters do to x, y: the pixel that shows (x, y) is taken back by them.
 */
static td_status add_lens(effect *f, int point, const td_camera *camera, const double s[3], double sigma_px,
                          td_error *error)
{
    const int count = f->parameters - 12;
    const double p[3] = {s[0], s[1], 1};
    double pixel[2], d[6], by[2 * TD_CAMERA_MAX_PARAMETERS];
    if (!td_camera_project(pixel, d, by, camera, p))
        return td_fail(error, TD_ERROR_DATA, "visual servo: point %d has no image", point);
    const double det = d[0] * d[4] - d[1] * d[3];
    const double back[4] = {d[4] / det, -d[1] / det, -d[3] / det, d[0] / det};
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < count; k++)
            f->common[(2 * point + i) * f->parameters + k] =
                back[2 * i] * by[k] + back[2 * i + 1] * by[count + k];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            f->image[(2 * point + i) * f->rows + 2 * point + j] =
                sigma_px * sigma_px * (back[2 * i] * back[2 * j] + back[2 * i + 1] * back[2 * j + 1]);
    return TD_OK;
}

/* A pose's left perturbation takes goal_from_camera the other way: de = -[radius omega; tau] at e = 0. */
static void add_pose_noise(effect *f, const double *covariance, double radius_m)
{
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            f->image[6 * i + j] = covariance[6 * i + j] * (i < 3 ? radius_m : 1) * (j < 3 ? radius_m : 1);
}

/* G of above. */
static void find_gain(effect *f, const double *jacobian, int n, const td_servo_eye *eye, const double *q,
                      int link, const double point_m[3], double share, double *plus)
{
    double tool[3 * N], at[3];
    if (eye->robot) {
        td_point_motion(at, tool, eye->robot, q, link, point_m);
    } else {
        double whole[18];
        td_pose_transform_jacobian(whole, point_m);
        memcpy(tool, whole, sizeof whole);
    }
    td_task_pseudo_inverse(plus, jacobian, f->rows, n, share);
    for (int i = 0; i < 3; i++)
        for (int r = 0; r < f->rows; r++)
            for (int k = 0; k < n; k++) f->g[i * f->rows + r] -= tool[i * n + k] * plus[k * f->rows + r];
}

/* Variance of what the loop leaves of noise of variance 1 that is new each period T. With E = exp(-T/tau), s
 * = 1 - E, a = T - tau s (lag.h), the joint's place x and rate w follow v = -K (x + n): x+ = (1 - K a) x +
 * tau s w - K a n, w+ = E w - K s (x + n). Its covariance P = F P F' + g g' has three unknowns. */
static double loop_factor(double gain, double period_s, double lag_s)
{
    const double left = lag_s > 0 ? exp(-period_s / lag_s) : 0, s = 1 - left, a = period_s - lag_s * s;
    const double f[2][2] = {{1 - gain * a, lag_s * s}, {-gain * s, left}}, g[2] = {-gain * a, -gain * s};
    /* Unknowns xx, xw, ww. */
    const double m[3][3] = {
        {1 - f[0][0] * f[0][0], -2 * f[0][0] * f[0][1], -f[0][1] * f[0][1]},
        {-f[0][0] * f[1][0], 1 - f[0][0] * f[1][1] - f[0][1] * f[1][0], -f[0][1] * f[1][1]},
        {-f[1][0] * f[1][0], -2 * f[1][0] * f[1][1], 1 - f[1][1] * f[1][1]}};
    const double b[3] = {g[0] * g[0], g[0] * g[1], g[1] * g[1]};
    const double minor[3] = {m[1][1] * m[2][2] - m[1][2] * m[2][1], m[0][1] * m[2][2] - m[0][2] * m[2][1],
                             m[0][1] * m[1][2] - m[0][2] * m[1][1]};
    return (b[0] * minor[0] - b[1] * minor[1] + b[2] * minor[2]) /
           (m[0][0] * minor[0] - m[1][0] * minor[1] + m[2][0] * minor[2]);
}

static td_status combine(td_servo_sigma *sigma, const effect *f, const td_visual_servo *servo,
                         const double *common, td_error *error)
{
    const td_visual_servo_options *o = &servo->options;
    const size_t m = (size_t)f->rows, p = (size_t)f->parameters;
    const double factor =
        loop_factor(o->gain_zero, o->limits.period_s, servo->eye.robot ? o->limits.lag_s : 0);
    TD_TRY(td_sandwich(sigma->image, f->g, f->image, 3, m, error));
    for (int i = 0; i < 9; i++) sigma->loop[i] = factor * sigma->image[i];
    if (!common) return TD_OK;
    double *moved = malloc(3 * p * sizeof *moved);
    if (!moved) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_multiply(moved, f->g, f->common, 3, m, p);
    const td_status status = td_sandwich(sigma->common, moved, common, 3, p, error);
    free(moved);
    return status;
}

static td_status find_effect(effect *f, const td_servo_features *s, const td_servo_sight *sight,
                             const int *index, const double *l, const td_visual_servo *servo, const double *q,
                             td_error *error)
{
    add_transforms(f, l, &servo->eye, q);
    if (s->kind == TD_SERVO_POSE) add_pose_noise(f, sight->covariance, s->radius_m);
    for (int i = 0; i < s->count && s->kind == TD_SERVO_POINTS; i++)
        TD_TRY(add_lens(f, i, &servo->eye.camera, s->now[i], sight->point[index[i]].sigma_px, error));
    return TD_OK;
}

td_status td_visual_servo_sigma(td_servo_sigma *sigma, const td_visual_servo *servo, const double *q,
                                const td_servo_sight *sight, int link, const double point_m[3],
                                const double *common, td_error *error)
{
    const td_servo_eye *eye = &servo->eye;
    const int n = eye->robot ? eye->robot->joint_count : 6;
    td_servo_features s;
    int index[TD_SERVO_MAX_POINTS];
    double l[TD_SERVO_ROWS * 6], twist[6 * N];
    memset(sigma, 0, sizeof *sigma);
    if (eye->robot && (link < 0 || link >= eye->robot->link_count))
        return td_fail(error, TD_ERROR_ARGUMENT, "visual servo: robot '%s' has no link %d", eye->robot->name,
                       link);
    TD_TRY(td_servo_gather(&s, index, servo, sight, error));
    const int rows = td_servo_interaction(l, &s);
    td_servo_jacobian(twist, NULL, eye, q);
    effect f;
    TD_TRY(effect_allocate(&f, rows, td_camera_parameter_count(eye->camera.model) + 12, error));
    double *j = calloc(2 * (size_t)rows * (size_t)n, sizeof *j);
    td_status status = j ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) {
        td_multiply(j, l, twist, (size_t)rows, 6, (size_t)n);
        find_gain(&f, j, n, eye, q, link, point_m, servo->options.singular_share, j + rows * n);
        status = find_effect(&f, &s, sight, index, l, servo, q, error);
    }
    if (status == TD_OK) status = combine(sigma, &f, servo, common, error);
    free(j);
    effect_free(&f);
    return status;
}
