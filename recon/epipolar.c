/* With u, v the unit rays of the left and the right pixel and x_right = R x_left + t, the three vectors t,
 * a = R u and v lie in one plane:
 *
 *   e = t . (a x v) = 0                                    (Hartley and Zisserman, 9.6, for rays of any
 * model)
 *
 * As a function of the right pixel e vanishes on the epipolar curve; its gradient is the curve's normal. */
#include "recon/epipolar.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/epipolar_internal.h"

enum { FOOT_STEPS = 30 };

#define FOOT_TOLERANCE 1e-10 /* px */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* ---- The pair ---- */

td_status td_pair_init(td_pair *pair, const td_rig *rig, int left, int right, td_error *error)
{
    const int index[2] = {left, right};
    for (int i = 0; i < 2; i++)
        if (index[i] < 0 || index[i] >= rig->count)
            return td_fail(error, TD_ERROR_ARGUMENT, "camera %d: the rig has %d, counted from 0", index[i],
                           rig->count);
    const td_rig_camera *l = &rig->camera[left], *r = &rig->camera[right];
    if (left == right)
        return td_fail(error, TD_ERROR_ARGUMENT, "camera %s: given as left and as right; a pair needs two",
                       l->name);
    const td_pose rig_from_left = td_pose_inverse(&l->camera_from_rig);
    const td_pose right_from_left = td_pose_compose(&r->camera_from_rig, &rig_from_left);
    const double baseline = sqrt(dot(right_from_left.t, right_from_left.t));
    if (!(baseline > 1e-9))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "cameras %s and %s: %g m apart; without a baseline there is no depth", l->name,
                       r->name, baseline);
    *pair = (td_pair){rig, left, right, right_from_left, baseline};
    return TD_OK;
}

/* m = K^-1 for K = [fx 0 cx; 0 fy cy; 0 0 1]. */
static void inverse_matrix(double m[9], const td_camera *camera)
{
    const double *p = camera->parameter;
    const double inverse[9] = {1 / p[0], 0, -p[2] / p[0], 0, 1 / p[1], -p[3] / p[1], 0, 0, 1};
    memcpy(m, inverse, sizeof inverse);
}

/* F = K_r^-T [t]x R K_l^-1. */
void td_pair_fundamental(double f[9], const td_pair *pair)
{
    const double *t = pair->right_from_left.t;
    const double skew[9] = {0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0};
    double r[9], kl[9], kr[9], part[9] = {0}, middle[9] = {0}, norm = 0;
    td_pose_rotation(r, &pair->right_from_left);
    inverse_matrix(kl, &pair->rig->camera[pair->left].camera);
    inverse_matrix(kr, &pair->rig->camera[pair->right].camera);
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++) part[i] += r[i / 3 * 3 + k] * kl[k * 3 + i % 3];
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++) middle[i] += skew[i / 3 * 3 + k] * part[k * 3 + i % 3];
    for (int i = 0; i < 9; i++) {
        f[i] = 0;
        for (int k = 0; k < 3; k++) f[i] += kr[k * 3 + i / 3] * middle[k * 3 + i % 3];
        norm += f[i] * f[i];
    }
    for (int i = 0; i < 9; i++) f[i] /= sqrt(norm);
}

/* ---- The curve, followed by inverse depth ---- */

bool td_epipolar_curve_init(td_epipolar_curve *curve, double *d_origin, const td_pair *pair,
                            const double left[2])
{
    const td_camera *camera = &pair->rig->camera[pair->left].camera;
    double ray[3], d_ray[6], r[9];
    if (!td_camera_unproject(ray, d_ray, NULL, camera, left) || !(ray[2] > 1e-9)) return false;
    const double forward[3] = {ray[0] / ray[2], ray[1] / ray[2], 1};
    td_pose_rotation(r, &pair->right_from_left);
    for (int i = 0; i < 3; i++) {
        curve->origin[i] = dot(r + 3 * i, forward);
        curve->step[i] = pair->right_from_left.t[i];
    }
    for (int i = 0; d_origin && i < 3; i++)
        for (int c = 0; c < 2; c++)
            d_origin[2 * i + c] = (r[3 * i] * (d_ray[c] - forward[0] * d_ray[4 + c]) +
                                   r[3 * i + 1] * (d_ray[2 + c] - forward[1] * d_ray[4 + c])) /
                                  ray[2];
    curve->camera = &pair->rig->camera[pair->right].camera;
    return true;
}

/* Past the fold of its distortion a Brown model images directions far outside the field into it: the pixel's
 * own ray is then another one. */
static bool is_seen(const td_camera *camera, const double pixel[2], const double point[3])
{
    double ray[3];
    if (camera->model == TD_CAMERA_PINHOLE) return true;
    return td_camera_unproject(ray, NULL, NULL, camera, pixel) &&
           dot(ray, point) > (1 - 1e-9) * sqrt(dot(point, point));
}

bool td_epipolar_curve_at(double right[2], double *d_inverse_depth, double *d_point,
                          const td_epipolar_curve *curve, double inverse_depth)
{
    double point[3], pixel[2], d[6];
    for (int i = 0; i < 3; i++) point[i] = curve->origin[i] + inverse_depth * curve->step[i];
    if (!td_camera_project(pixel, d, NULL, curve->camera, point) || !is_seen(curve->camera, pixel, point))
        return false;
    memcpy(right, pixel, sizeof pixel);
    for (int i = 0; d_inverse_depth && i < 2; i++) d_inverse_depth[i] = dot(d + 3 * i, curve->step);
    if (d_point) memcpy(d_point, d, sizeof d);
    return true;
}

bool td_pair_transfer(double right[2], double *d_inverse_depth, double *d_left, const td_pair *pair,
                      const double left[2], double depth)
{
    td_epipolar_curve curve;
    double d_origin[6], d_point[6];
    if (!(depth > 0) || !td_epipolar_curve_init(&curve, d_origin, pair, left) ||
        !td_epipolar_curve_at(right, d_inverse_depth, d_point, &curve, 1 / depth))
        return false;
    for (int i = 0; d_left && i < 2; i++)
        for (int c = 0; c < 2; c++)
            d_left[2 * i + c] = d_point[3 * i] * d_origin[c] + d_point[3 * i + 1] * d_origin[2 + c] +
                                d_point[3 * i + 2] * d_origin[4 + c];
    return true;
}

/* ---- Distance from the curve ---- */

/* e of a right pixel, `g` (2) its gradient by the pixel, `v` the pixel's ray. */
static bool constraint(double *e, double g[2], double v[3], double *d_camera, const td_camera *camera,
                       const double normal[3], const double pixel[2])
{
    double d_pixel[6];
    if (!td_camera_unproject(v, d_pixel, d_camera, camera, pixel)) return false;
    *e = dot(normal, v);
    for (int c = 0; c < 2; c++)
        g[c] = normal[0] * d_pixel[c] + normal[1] * d_pixel[2 + c] + normal[2] * d_pixel[4 + c];
    return g[0] * g[0] + g[1] * g[1] > 0;
}

/* The curve's nearest point `foot`: on the line through `right` along the curve's normal there. */
static bool find_foot(double foot[2], double g[2], double v[3], const td_camera *camera,
                      const double normal[3], const double right[2])
{
    memcpy(foot, right, 2 * sizeof *foot);
    for (int step = 0; step < FOOT_STEPS; step++) {
        double e;
        if (!constraint(&e, g, v, NULL, camera, normal, foot)) return false;
        const double scale =
            (e + g[0] * (right[0] - foot[0]) + g[1] * (right[1] - foot[1])) / (g[0] * g[0] + g[1] * g[1]);
        const double next[2] = {right[0] - scale * g[0], right[1] - scale * g[1]};
        const double moved = hypot(next[0] - foot[0], next[1] - foot[1]);
        memcpy(foot, next, sizeof next);
        if (moved < FOOT_TOLERANCE) return true;
    }
    return false;
}

/* Columns of one camera's parameters: e's gradient by a ray, through the ray's Jacobian. */
static void add_intrinsics(double *row, const double by_ray[3], const double *d_ray, int count, double scale)
{
    for (int k = 0; k < count; k++)
        row[k] =
            scale * (by_ray[0] * d_ray[k] + by_ray[1] * d_ray[count + k] + by_ray[2] * d_ray[2 * count + k]);
}

/* de/d(parameter) times `scale`: by t, a x v; by a, v x t; by v, t x a. The right pose's perturbation gives
 * dt = omega x t + tau, da = omega x a; the left one's dt = -R tau, da = -R (omega x u). */
static bool parameter_row(double *row, const td_pair *pair, const double left[2], const double foot[2],
                          double scale)
{
    const td_rig *rig = pair->rig;
    const td_camera *l = &rig->camera[pair->left].camera, *r = &rig->camera[pair->right].camera;
    const int nl = td_camera_parameter_count(l->model), nr = td_camera_parameter_count(r->model);
    double u[3], v[3], a[3], du[3 * TD_CAMERA_MAX_PARAMETERS], dv[3 * TD_CAMERA_MAX_PARAMETERS];
    double by_t[3], by_a[3], by_v[3], left_t[3], left_a[3], one[3], other[3];
    const double *t = pair->right_from_left.t;
    if (!td_camera_unproject(u, NULL, du, l, left) || !td_camera_unproject(v, NULL, dv, r, foot))
        return false;
    const td_pose left_from_right = td_pose_inverse(&pair->right_from_left);
    td_pose_rotate(a, &pair->right_from_left, u);
    cross(by_t, a, v);
    cross(by_a, v, t);
    cross(by_v, t, a);
    td_pose_rotate(left_t, &left_from_right, by_t);
    td_pose_rotate(left_a, &left_from_right, by_a);
    memset(row, 0, td_rig_parameter_count(rig) * sizeof *row);
    double *row_l = row + td_rig_parameter_offset(rig, pair->left);
    double *row_r = row + td_rig_parameter_offset(rig, pair->right);
    add_intrinsics(row_l, left_a, du, nl, scale);
    add_intrinsics(row_r, by_v, dv, nr, scale);
    cross(one, left_a, u);
    for (int i = 0; i < 3; i++) {
        row_l[nl + i] = scale * one[i];
        row_l[nl + 3 + i] = -scale * left_t[i];
    }
    cross(one, t, by_t);
    cross(other, a, by_a);
    for (int i = 0; i < 3; i++) {
        row_r[nr + i] = scale * (one[i] + other[i]);
        row_r[nr + 3 + i] = scale * by_t[i];
    }
    return true;
}

bool td_pair_residual(double *distance, double along[2], double *d_parameter, const td_pair *pair,
                      const double left[2], const double right[2])
{
    const td_camera *camera = &pair->rig->camera[pair->right].camera;
    double u[3], a[3], v[3], normal[3], foot[2], g[2], point[2], j[6];
    if (!td_camera_unproject(u, NULL, NULL, &pair->rig->camera[pair->left].camera, left)) return false;
    td_pose_rotate(a, &pair->right_from_left, u);
    cross(normal, pair->right_from_left.t, a);
    if (!find_foot(foot, g, v, camera, normal, right) || !td_camera_project(point, j, NULL, camera, v))
        return false;
    const double size = hypot(g[0], g[1]);
    double tangent[2] = {g[1] / size, -g[0] / size};
    /* Nearer points move along the image of the baseline: the other way is farther. */
    const double nearer[2] = {dot(j, pair->right_from_left.t), dot(j + 3, pair->right_from_left.t)};
    const double sign = tangent[0] * nearer[0] + tangent[1] * nearer[1] > 0 ? -1 : 1;
    /* The distance is least at the foot, which may move along the curve without changing it: the derivative
     * is that of e at a fixed foot over the gradient's length. */
    if (d_parameter && !parameter_row(d_parameter, pair, left, foot, sign / size)) return false;
    for (int i = 0; along && i < 2; i++) along[i] = sign * tangent[i];
    *distance = sign * (g[0] * (right[0] - foot[0]) + g[1] * (right[1] - foot[1])) / size;
    return true;
}

double td_pair_residual_sigma(const td_pair *pair, const double left[2], const double right[2])
{
    const td_rig *rig = pair->rig;
    const size_t n = td_rig_parameter_count(rig);
    double distance, variance = 0, row[TD_RIG_MAX_CAMERAS * (TD_CAMERA_MAX_PARAMETERS + 6)];
    if (!rig->covariance || !td_pair_residual(&distance, NULL, row, pair, left, right)) return NAN;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; row[i] != 0 && k < n; k++)
            variance += row[i] * row[k] * rig->covariance[i * n + k];
    return sqrt(fmax(variance, 0));
}
