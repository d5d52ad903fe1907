#include "core/stereo.h"

#include <math.h>
#include <string.h>

#include "core/linalg.h"
#include "core/parallel.h"

void td_perspective_matrix(double p[12], const td_camera *camera, const td_pose *camera_from_world)
{
    double k[9], m[16];
    td_camera_matrix(k, camera);
    td_pose_matrix(m, camera_from_world);
    td_multiply(p, k, m, 3, 3, 4);
}

void td_essential_matrix(double e[9], const td_pose *second_from_first)
{
    const double *t = second_from_first->t;
    const double tx[9] = {0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0};
    double r[9];
    td_pose_rotation(r, second_from_first);
    td_multiply(e, tx, r, 3, 3, 3);
}

static void inverse_matrix(double inverse[9], const td_camera *c)
{
    const double *p = c->parameter;
    const double m[9] = {1 / p[0], 0, -p[2] / p[0], 0, 1 / p[1], -p[3] / p[1], 0, 0, 1};
    memcpy(inverse, m, sizeof m);
}

void td_fundamental_matrix(double f[9], const td_camera *first, const td_camera *second,
                           const td_pose *second_from_first)
{
    double e[9], k1[9], k2[9], half[9], norm = 0;
    td_essential_matrix(e, second_from_first);
    inverse_matrix(k1, first);
    inverse_matrix(k2, second);
    td_multiply(half, e, k1, 3, 3, 3);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            f[3 * i + j] = k2[i] * half[j] + k2[3 + i] * half[3 + j] + k2[6 + i] * half[6 + j];
    for (int i = 0; i < 9; i++) norm += f[i] * f[i];
    for (int i = 0; i < 9 && norm > 0; i++) f[i] /= sqrt(norm);
}

void td_epipolar_distances(double distance[2], const double f[9], const double pixel1[2],
                           const double pixel2[2])
{
    double line2[3], line1[3];
    for (int i = 0; i < 3; i++) {
        line2[i] = f[3 * i] * pixel1[0] + f[3 * i + 1] * pixel1[1] + f[3 * i + 2];
        line1[i] = f[i] * pixel2[0] + f[3 + i] * pixel2[1] + f[6 + i];
    }
    distance[0] = fabs(line1[0] * pixel1[0] + line1[1] * pixel1[1] + line1[2]) / hypot(line1[0], line1[1]);
    distance[1] = fabs(line2[0] * pixel2[0] + line2[1] * pixel2[1] + line2[2]) / hypot(line2[0], line2[1]);
}

bool td_undistort_pixel(double out[2], const td_camera *camera, const double pixel[2])
{
    double ray[3];
    if (!td_camera_unproject(ray, NULL, NULL, camera, pixel) || ray[2] < 1e-6) return false;
    const double *p = camera->parameter;
    out[0] = p[0] * ray[0] / ray[2] + p[2];
    out[1] = p[1] * ray[1] / ray[2] + p[3];
    return true;
}

/* The point nearest to both rays, in the first camera's frame. */
static bool midpoint(double point[3], const double ray1[3], const double ray2[3], const double centre2[3])
{
    double a = 0, b = 0, c = 0, d = 0, e = 0;
    for (int i = 0; i < 3; i++) {
        a += ray1[i] * ray1[i];
        b += ray1[i] * ray2[i];
        c += ray2[i] * ray2[i];
        d += ray1[i] * centre2[i];
        e += ray2[i] * centre2[i];
    }
    double det = a * c - b * b;
    if (!(det > 1e-12)) return false;
    double s = (c * d - b * e) / det, u = (b * d - a * e) / det;
    for (int i = 0; i < 3; i++) point[i] = (s * ray1[i] + centre2[i] + u * ray2[i]) / 2;
    return s > 0 && u > 0;
}

/* Gauss-Newton's step from x for the squared reprojection error in both images. */
static bool triangulation_step(double step[3], const double x[3], const td_camera *first,
                               const td_camera *second, const td_pose *second_from_first,
                               const double pixel1[2], const double pixel2[2])
{
    double j[12], r[4], u[2], d[6], y[3], r2[9], normal[9] = {0}, right[3] = {0};
    if (!td_camera_project(u, j, NULL, first, x)) return false;
    r[0] = pixel1[0] - u[0], r[1] = pixel1[1] - u[1];
    td_pose_transform(y, second_from_first, x);
    if (!td_camera_project(u, d, NULL, second, y)) return false;
    r[2] = pixel2[0] - u[0], r[3] = pixel2[1] - u[1];
    td_pose_rotation(r2, second_from_first);
    td_multiply(j + 6, d, r2, 2, 3, 3);
    for (int row = 0; row < 4; row++)
        for (int a = 0; a < 3; a++) {
            right[a] += j[3 * row + a] * r[row];
            for (int b = 0; b < 3; b++) normal[3 * a + b] += j[3 * row + a] * j[3 * row + b];
        }
    if (td_invert_spd(normal, normal, 3, NULL) != TD_OK) return false;
    for (int a = 0; a < 3; a++)
        step[a] = normal[3 * a] * right[0] + normal[3 * a + 1] * right[1] + normal[3 * a + 2] * right[2];
    return true;
}

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

bool td_triangulate_pair(double point[3], const td_camera *first, const td_camera *second,
                         const td_pose *second_from_first, const double pixel1[2], const double pixel2[2])
{
    enum { MOST_STEPS = 20 }; /* 4 are usual; a point so far that the noise reaches its parallax takes more */
    double ray1[3], ray2[3], x[3], step[3], behind[3];
    if (!td_camera_unproject(ray1, NULL, NULL, first, pixel1)) return false;
    if (!td_camera_unproject(ray2, NULL, NULL, second, pixel2)) return false;
    td_pose first_from_second = td_pose_inverse(second_from_first);
    td_pose_rotate(ray2, &first_from_second, ray2);
    if (!midpoint(x, ray1, ray2, first_from_second.t)) return false;
    for (int i = 0; i < MOST_STEPS; i++) {
        if (!triangulation_step(step, x, first, second, second_from_first, pixel1, pixel2)) return false;
        for (int k = 0; k < 3; k++) x[k] += step[k];
        if (dot3(step, step) <= 1e-16 * dot3(x, x)) break;
    }
    for (int k = 0; k < 3; k++) behind[k] = x[k] - first_from_second.t[k];
    if (!(dot3(x, ray1) > 0 && dot3(behind, ray2) > 0)) return false;
    memcpy(point, x, sizeof x);
    return true;
}

/* Turns both cameras half-way towards each other, then the common frame onto the baseline. False when that
 * takes more than 60 degrees: then the cameras look along the baseline rather than across it. */
static bool rectifying_rotations(td_rectification *out, const td_pose *second_from_first)
{
    double omega[3], half[3], t[3];
    td_rotation_log(omega, second_from_first->q);
    for (int i = 0; i < 3; i++) half[i] = omega[i] / 2;
    td_pose turn_first = {{1, 0, 0, 0}, {0, 0, 0}}, turn_second = turn_first, onto = turn_first;
    td_rotation_exp(turn_first.q, half);
    for (int i = 0; i < 3; i++) half[i] = -half[i];
    td_rotation_exp(turn_second.q, half);
    td_pose_rotate(t, &turn_second, second_from_first->t); /* = - position of the second camera */
    out->vertical = fabs(t[1]) > fabs(t[0]);
    /* The axis along which the second camera lies, with its sign, must become the baseline's direction. */
    int axis = out->vertical ? 1 : 0;
    double length = sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]), sign = t[axis] > 0 ? 1 : -1;
    double direction[3] = {sign * t[0] / length, sign * t[1] / length, sign * t[2] / length};
    double to[3] = {axis == 0, axis == 1, 0}, w[3];
    w[0] = direction[1] * to[2] - direction[2] * to[1];
    w[1] = direction[2] * to[0] - direction[0] * to[2];
    w[2] = direction[0] * to[1] - direction[1] * to[0];
    double s = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), angle = atan2(s, direction[axis]);
    for (int i = 0; i < 3; i++) w[i] = s > 0 ? w[i] / s * angle : 0;
    td_rotation_exp(onto.q, w);
    out->rectified_from[0] = td_pose_compose(&onto, &turn_first);
    out->rectified_from[1] = td_pose_compose(&onto, &turn_second);
    out->baseline_m = -sign * length;
    return direction[axis] > 0.5;
}

/* Bounds, in normalised rectified coordinates, of what a camera sees: the largest rectangle inside its
 * border's image and the smallest around it. */
typedef struct bounds {
    double inner[4], outer[4]; /* x min, x max, y min, y max */
} bounds;

static td_status border_bounds(bounds *b, const td_camera *camera, const td_pose *rectified_from_camera,
                               td_error *error)
{
    enum { STEPS = 32 };
    const double big = 1e9;
    *b = (bounds){{-big, big, -big, big}, {big, -big, big, -big}};
    for (int side = 0; side < 4; side++)
        for (int i = 0; i <= STEPS; i++) {
            double along = (double)i / STEPS, ray[3];
            double pixel[2] = {(side < 2 ? along : side - 2) * (camera->width - 1),
                               (side < 2 ? side : along) * (camera->height - 1)};
            if (!td_camera_unproject(ray, NULL, NULL, camera, pixel))
                return td_fail(error, TD_ERROR_DATA,
                               "the lens model has no ray for pixel (%.0f, %.0f) of the image's border, its "
                               "polynomial turns "
                               "back before it: calibrate with views in which the target reaches the corners",
                               pixel[0], pixel[1]);
            td_pose_rotate(ray, rectified_from_camera, ray);
            if (ray[2] < 0.05)
                return td_fail(error, TD_ERROR_DATA,
                               "the field of view is too wide for a rectified (pinhole) image: part of the "
                               "image's border "
                               "lies more than 87 degrees off the rectified axis");
            double x = ray[0] / ray[2], y = ray[1] / ray[2];
            b->outer[0] = fmin(b->outer[0], x), b->outer[1] = fmax(b->outer[1], x);
            b->outer[2] = fmin(b->outer[2], y), b->outer[3] = fmax(b->outer[3], y);
            if (side == 0) b->inner[2] = fmax(b->inner[2], y);
            if (side == 1) b->inner[3] = fmin(b->inner[3], y);
            if (side == 2) b->inner[0] = fmax(b->inner[0], x);
            if (side == 3) b->inner[1] = fmin(b->inner[1], x);
        }
    return TD_OK;
}

td_status td_rectify(td_rectification *out, const td_camera *first, const td_camera *second,
                     const td_pose *second_from_first, double zoom, td_error *error)
{
    if (!(zoom >= 0 && zoom <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "zoom: %g is not between 0 and 1", zoom);
    if (!(td_pose_distance(second_from_first) > 0))
        return td_fail(error, TD_ERROR_DATA, "the two cameras are at one place: nothing to rectify");
    if (!rectifying_rotations(out, second_from_first))
        return td_fail(error, TD_ERROR_DATA,
                       "one camera is ahead of the other: where they look along the line between them there "
                       "is nothing to "
                       "rectify");
    bounds a, b;
    TD_TRY(border_bounds(&a, first, &out->rectified_from[0], error));
    TD_TRY(border_bounds(&b, second, &out->rectified_from[1], error));
    double x[4];
    for (int i = 0; i < 4; i++) {
        double inner = i % 2 ? fmin(a.inner[i], b.inner[i]) : fmax(a.inner[i], b.inner[i]);
        double outer = i % 2 ? fmax(a.outer[i], b.outer[i]) : fmin(a.outer[i], b.outer[i]);
        x[i] = inner + zoom * (outer - inner);
    }
    if (!(x[1] > x[0] && x[3] > x[2]))
        return td_fail(error, TD_ERROR_DATA, "the two cameras see nothing in common after rectification");
    out->camera = (td_camera){.model = TD_CAMERA_PINHOLE, .width = first->width, .height = first->height};
    /* zoom 0: the rectangle fills the image; 1: it fits into it. */
    double fx = (first->width - 1) / (x[1] - x[0]), fy = (first->height - 1) / (x[3] - x[2]);
    double f = fmax(fx, fy) + zoom * (fmin(fx, fy) - fmax(fx, fy));
    out->camera.parameter[0] = out->camera.parameter[1] = f;
    out->camera.parameter[2] = (first->width - 1) / 2.0 - f * (x[0] + x[1]) / 2;
    out->camera.parameter[3] = (first->height - 1) / 2.0 - f * (x[2] + x[3]) / 2;
    return TD_OK;
}

/* Where rectified pixels of a camera lie in the image as taken. */
typedef struct lens {
    const td_camera *camera, *rectified;
    td_pose camera_from_rectified;
    double edge; /* cosine of the largest angle off the axis that the image holds */
} lens;

/* A distortion's polynomial may turn back outside of the image and map directions into it that the lens never
 * saw there; they lie farther off the axis than all of the image's border. */
static double edge_cosine(const td_camera *camera)
{
    enum { STEPS = 32 };
    double least = 1, ray[3];
    for (int side = 0; side < 4; side++)
        for (int i = 0; i <= STEPS; i++) {
            double along = (double)i / STEPS;
            double pixel[2] = {(side < 2 ? along : side - 2) * camera->width - 0.5,
                               (side < 2 ? side : along) * camera->height - 0.5};
            if (td_camera_unproject(ray, NULL, NULL, camera, pixel)) least = fmin(least, ray[2]);
        }
    return least;
}

static lens lens_of(const td_rectification *rectification, int index, const td_camera *camera)
{
    return (lens){camera, &rectification->camera, td_pose_inverse(&rectification->rectified_from[index]),
                  edge_cosine(camera)};
}

/* False: the camera did not see it. */
static bool source_pixel(double pixel[2], const lens *l, double column, double row)
{
    const double *p = l->rectified->parameter;
    double ray[3] = {(column - p[2]) / p[0], (row - p[3]) / p[1], 1};
    double length = sqrt(dot3(ray, ray));
    td_pose_rotate(ray, &l->camera_from_rectified, ray);
    return ray[2] >= l->edge * length && td_camera_project(pixel, NULL, NULL, l->camera, ray) &&
           pixel[0] >= -0.5 && pixel[0] <= l->camera->width - 0.5 && pixel[1] >= -0.5 &&
           pixel[1] <= l->camera->height - 0.5;
}

typedef struct table {
    float *at;
    lens lens;
} table;

static void table_row(size_t row, void *user)
{
    const table *t = user;
    const size_t width = (size_t)t->lens.rectified->width;
    float *at = t->at + 2 * row * width;
    for (size_t column = 0; column < width; column++) {
        double pixel[2];
        bool seen = source_pixel(pixel, &t->lens, (double)column, (double)row);
        for (size_t k = 0; k < 2; k++) at[2 * column + k] = seen ? (float)pixel[k] : NAN;
    }
}

td_status td_rectify_table(float *at, const td_rectification *rectification, int index,
                           const td_camera *camera, int threads)
{
    table t = {at, lens_of(rectification, index, camera)};
    return td_parallel_for((size_t)rectification->camera.height, threads, table_row, &t, NULL, NULL);
}

typedef struct remap {
    td_image *out;
    const td_image *image;
    lens lens;
} remap;

static void remap_row(size_t row, void *user)
{
    const remap *m = user;
    int channels = m->out->channels;
    uint8_t *to = m->out->data + row * (size_t)m->out->width * (size_t)channels;
    for (int column = 0; column < m->out->width; column++, to += channels) {
        double pixel[2];
        if (!source_pixel(pixel, &m->lens, column, (double)row)) continue;
        for (int k = 0; k < channels; k++)
            to[k] = (uint8_t)lrint(td_image_sample(m->image, pixel[0], pixel[1], k));
    }
}

td_status td_rectify_image(td_image **out, const td_image *image, const td_rectification *rectification,
                           int index, const td_camera *camera, int threads, td_error *error)
{
    if (image->width != camera->width || image->height != camera->height)
        return td_fail(error, TD_ERROR_DATA, "the image is %dx%d px, its camera was calibrated at %dx%d",
                       image->width, image->height, camera->width, camera->height);
    TD_TRY(
        td_image_new(out, rectification->camera.width, rectification->camera.height, image->channels, error));
    remap m = {*out, image, lens_of(rectification, index, camera)};
    return td_parallel_for((size_t)(*out)->height, threads, remap_row, &m, NULL, NULL);
}
