/* What the rig's error does to a dense point.
 *
 * The images are as they were taken; only what the rig says of them is wrong. With the left ray X = L + s u,
 * the right camera at R, its ray w and v the rectified y axis, the point is where the left ray meets the
 * plane of w and v (a disparity says nothing across the rows):
 *
 *   n . (L + s u - R) = 0,   n = w x v.
 *
 * Where the rays meet, v's own change drops out, and to first order
 *
 *   ds = -[(dw x v) . (X - R) + n . (dL + s du - dR)] / (n . u),   dX = dL + s du + ds u.
 *
 * With X = z (a, b, 1) and q = 1/z the errors (da, db, dq) are smooth, nearly linear in q: their covariance
 * is what the grid holds and what is interpolated. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "recon/depth_points_internal.h"

enum {
    MAX_ROW = TD_RIG_MAX_CAMERAS * (TD_CAMERA_MAX_PARAMETERS + 6),
    NODES = TD_DEPTH_GRID_COLUMNS * TD_DEPTH_GRID_ROWS * TD_DEPTH_GRID_LEVELS
};

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

/* A camera's ray to the point, in the left rectified frame, and its derivatives. */
typedef struct sight {
    size_t count;                            /* parameters of the camera */
    double centre[3], ray[3];                /* ray of unit length */
    double d_centre[18], d_ray[3 * MAX_ROW]; /* (3,6) by xi; (3,count+6) by parameters and xi */
} sight;

static bool look(sight *s, const td_rig_camera *camera, const td_pose *rectified_from_rig, const double p[3])
{
    const td_pose rig_from_camera = td_pose_inverse(&camera->camera_from_rig);
    const td_pose to = td_pose_compose(rectified_from_rig, &rig_from_camera), from = td_pose_inverse(&to);
    double seen[3], pixel[2], ray[3], by[3 * TD_CAMERA_MAX_PARAMETERS], r[9];
    td_pose_transform(seen, &from, p);
    if (!td_camera_project(pixel, NULL, NULL, &camera->camera, seen) ||
        !td_camera_unproject(ray, NULL, by, &camera->camera, pixel))
        return false;
    s->count = (size_t)td_camera_parameter_count(camera->camera.model);
    memcpy(s->centre, to.t, sizeof to.t);
    td_pose_rotate(s->ray, &to, ray);
    td_pose_rotation(r, &to);
    const size_t n = s->count + 6;
    memset(s->d_ray, 0, 3 * n * sizeof *s->d_ray);
    for (size_t i = 0; i < 3; i++) {
        for (size_t k = 0; k < s->count; k++)
            for (size_t j = 0; j < 3; j++) s->d_ray[i * n + k] += r[3 * i + j] * by[j * s->count + k];
        /* camera_from_rig becomes Exp(xi) camera_from_rig: the ray turns by -omega, the centre moves by -tau
         * in the camera's frame. */
        for (size_t k = 0; k < 3; k++) {
            const double unit[3] = {k == 0, k == 1, k == 2};
            double turned[3];
            cross(turned, ray, unit);
            s->d_ray[i * n + s->count + k] = dot(r + 3 * i, turned);
            s->d_centre[6 * i + k] = 0;
            s->d_centre[6 * i + 3 + k] = -r[3 * i + k];
        }
    }
    return true;
}

/* Writes the change (da, db, dq) that dX makes into column `column` of j (3,n). */
static void put(double *j, size_t n, size_t column, const double moved[3], const double p[3])
{
    const double q = 1 / p[2];
    j[column] = (moved[0] - p[0] * q * moved[2]) * q;
    j[n + column] = (moved[1] - p[1] * q * moved[2]) * q;
    j[2 * n + column] = -moved[2] * q * q;
}

/* Columns of one camera: parameters, then xi. */
static void camera_columns(double *j, size_t n, size_t first, const sight *s, bool left, const double u[3],
                           const double normal[3], const double right[3], const double p[3])
{
    static const double down[3] = {0, 1, 0};
    const size_t own = s->count + 6;
    const double reach = sqrt(dot(p, p)); /* the left rectified camera is at the origin */
    double behind[3];
    for (int i = 0; i < 3; i++) behind[i] = p[i] - right[i];
    for (size_t k = 0; k < own; k++) {
        double ray[3], centre[3], across[3], moved[3], share[3];
        for (size_t i = 0; i < 3; i++) {
            ray[i] = s->d_ray[i * own + k];
            centre[i] = k < s->count ? 0 : s->d_centre[6 * i + k - s->count];
            share[i] = left ? centre[i] + reach * ray[i] : -centre[i];
        }
        double change = dot(normal, share);
        if (!left) {
            cross(across, ray, down);
            change += dot(across, behind);
        }
        for (int i = 0; i < 3; i++) moved[i] = (left ? share[i] : 0) - change / dot(normal, u) * u[i];
        put(j, n, first + k, moved, p);
    }
}

static bool jacobian(double *j, const td_depth_camera *c, const td_pose *rectified_from_rig,
                     const double p[3])
{
    static const double down[3] = {0, 1, 0};
    const size_t n = td_rig_parameter_count(c->rig);
    sight left, right;
    double normal[3];
    if (!look(&left, &c->rig->camera[c->left], rectified_from_rig, p) ||
        !look(&right, &c->rig->camera[c->right], rectified_from_rig, p))
        return false;
    cross(normal, right.ray, down);
    memset(j, 0, 3 * n * sizeof *j);
    camera_columns(j, n, td_rig_parameter_offset(c->rig, c->left), &left, true, left.ray, normal,
                   right.centre, p);
    camera_columns(j, n, td_rig_parameter_offset(c->rig, c->right), &right, false, left.ray, normal,
                   right.centre, p);
    return true;
}

/* Pixel and inverse depth of a node. */
static void node_at(double at[3], const td_depth_camera *c, int node)
{
    const int column = node % TD_DEPTH_GRID_COLUMNS, row = node / TD_DEPTH_GRID_COLUMNS % TD_DEPTH_GRID_ROWS;
    const int level = node / TD_DEPTH_GRID_COLUMNS / TD_DEPTH_GRID_ROWS;
    at[0] = (c->rectification.camera.width - 1.) * column / (TD_DEPTH_GRID_COLUMNS - 1);
    at[1] = (c->rectification.camera.height - 1.) * row / (TD_DEPTH_GRID_ROWS - 1);
    at[2] = 1 / c->far_m + (1 / c->near_m - 1 / c->far_m) * level / (TD_DEPTH_GRID_LEVELS - 1);
}

td_status td_depth_error_grid(td_depth_camera *c, td_error *error)
{
    const size_t n = td_rig_parameter_count(c->rig);
    const td_pose rectified_from_rig = td_pose_inverse(&c->rig_from_rectified);
    c->error = malloc((size_t)NODES * 6 * sizeof *c->error);
    if (!c->error) return td_fail(error, TD_ERROR_MEMORY, "no memory for the grid of calibration error");
    for (int node = 0; node < NODES; node++) {
        double at[3], j[3 * MAX_ROW], part[3 * MAX_ROW], s[9];
        float *to = c->error + (size_t)node * 6;
        node_at(at, c, node);
        const double p[3] = {(at[0] - c->cx) / c->f / at[2], (at[1] - c->cy) / c->f / at[2], 1 / at[2]};
        for (int i = 0; i < 6; i++) to[i] = NAN; /* a camera has no ray there: nothing is seen either */
        if (!jacobian(j, c, &rectified_from_rig, p)) continue;
        td_multiply(part, j, c->rig->covariance, 3, n, n);
        td_multiply_transposed(s, part, j, 3, n, 3);
        const double upper[6] = {s[0], s[1], s[2], s[4], s[5], s[8]};
        for (int i = 0; i < 6; i++) to[i] = (float)upper[i];
    }
    return TD_OK;
}

/* The grid's cell below coordinate u in 0 … count-1, and the way to the next. */
static int below(double *part, double u, int count)
{
    const double held = fmin(fmax(u, 0), count - 1);
    int first = (int)held;
    if (first > count - 2) first = count - 2;
    *part = held - first;
    return first;
}

/* Sum of the eight nodes around, those without a ray left out. */
static void interpolate(double s[6], const td_depth_camera *c, double x, double y, double depth)
{
    const td_camera *image = &c->rectification.camera;
    double part[3], total = 0;
    const double q = (1 / depth - 1 / c->far_m) / (1 / c->near_m - 1 / c->far_m);
    const int first[3] = {
        below(&part[0], x / (image->width - 1) * (TD_DEPTH_GRID_COLUMNS - 1), TD_DEPTH_GRID_COLUMNS),
        below(&part[1], y / (image->height - 1) * (TD_DEPTH_GRID_ROWS - 1), TD_DEPTH_GRID_ROWS),
        below(&part[2], q * (TD_DEPTH_GRID_LEVELS - 1), TD_DEPTH_GRID_LEVELS)};
    for (int i = 0; i < 6; i++) s[i] = 0;
    for (int k = 0; k < 8; k++) {
        const int d[3] = {k & 1, k >> 1 & 1, k >> 2};
        double weight = 1;
        for (int i = 0; i < 3; i++) weight *= d[i] ? part[i] : 1 - part[i];
        const int node = ((first[2] + d[2]) * TD_DEPTH_GRID_ROWS + first[1] + d[1]) * TD_DEPTH_GRID_COLUMNS +
                         first[0] + d[0];
        const float *at = c->error + (size_t)node * 6;
        if (isnan(at[0])) continue;
        for (int i = 0; i < 6; i++) s[i] += weight * (double)at[i];
        total += weight;
    }
    for (int i = 0; i < 6; i++) s[i] = total > 0 ? s[i] / total : NAN;
}

void td_depth_error_at(double covariance[6], const td_depth_camera *c, double x, double y, double depth)
{
    double s[6], r[9], b[9], part[9], full[9];
    for (int i = 0; i < 6; i++) covariance[i] = NAN;
    if (!c->error) return;
    interpolate(s, c, x, y, depth);
    const double a = (x - c->cx) / c->f, e = (y - c->cy) / c->f, z = depth;
    /* X = z (a, e, 1), dz = -z^2 dq. */
    const double local[9] = {z, 0, -a * z * z, 0, z, -e * z * z, 0, 0, -z * z};
    const double square[9] = {s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]};
    td_pose_rotation(r, &c->rig_from_rectified);
    td_multiply(b, r, local, 3, 3, 3);
    td_multiply(part, b, square, 3, 3, 3);
    td_multiply_transposed(full, part, b, 3, 3, 3);
    const double upper[6] = {full[0], full[1], full[2], full[4], full[5], full[8]};
    memcpy(covariance, upper, sizeof upper);
}
