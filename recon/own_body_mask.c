/* Which pixels see the grown robot. A grown primitive is convex and so is its image: pixel rows meet it in
 * one piece. Blocks of pixels are tried first, by one ray against the primitive grown so much more that it
 * holds all rays of the block; then the pixels of those that may see it, one by one. */
#include <math.h>
#include <string.h>

#include "recon/own_body.h"
#include "recon/own_body_internal.h"

enum { BLOCK = 8, MOST_PIECES = 8 };
static const double PIECE = 0.5; /* m */

/* A grown primitive and the camera's centre, in the primitive's frame. */
typedef struct target {
    td_primitive_kind kind;
    double half[3]; /* box: half lengths, grown; else: radius, grown, and half the axis */
    double eye[3];  /* the camera */
    double r[9];    /* shape from camera */
    double reach;   /* no point of it is farther from the camera */
    double spread;  /* radius of a block's cone at distance 1 */
} target;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static target target_of(const td_primitive *shape, const td_pose *camera_from_link, double grown,
                        const td_camera *camera)
{
    target t = {.kind = shape->kind};
    const td_pose camera_from_shape = td_pose_compose(camera_from_link, &shape->link_from_shape);
    const td_pose shape_from_camera = td_pose_inverse(&camera_from_shape);
    memcpy(t.eye, shape_from_camera.t, sizeof t.eye);
    td_pose_rotation(t.r, &shape_from_camera);
    double across;
    if (shape->kind == TD_PRIMITIVE_BOX) {
        for (int i = 0; i < 3; i++) t.half[i] = shape->size[i] / 2 + grown;
        across = sqrt(dot(t.half, t.half));
    } else {
        t.half[0] = shape->size[0] + grown;
        t.half[1] = shape->kind == TD_PRIMITIVE_CAPSULE ? shape->size[1] / 2 : 0;
        across = t.half[0] + t.half[1];
    }
    t.reach = sqrt(dot(t.eye, t.eye)) + across;
    t.spread = BLOCK / sqrt(2) / fmin(camera->parameter[0], camera->parameter[1]);
    return t;
}

/* Slabs (Kay and Kajiya 1986). */
static bool meets_box(const target *t, const double ray[3], double more)
{
    double in = 0, out = INFINITY;
    for (int i = 0; i < 3; i++) {
        const double half = t->half[i] + more;
        if (fabs(ray[i]) < 1e-300) {
            if (fabs(t->eye[i]) > half) return false;
            continue;
        }
        const double a = (-half - t->eye[i]) / ray[i], b = (half - t->eye[i]) / ray[i];
        in = fmax(in, fmin(a, b));
        out = fmin(out, fmax(a, b));
    }
    return in <= out;
}

/* Distance of a ray from the axis from -half to half along z (Ericson 2004, 5.1.9). */
static bool meets_capsule(const target *t, const double ray[3], double more)
{
    const double radius = t->half[0] + more, half = t->half[1];
    const double rr = dot(ray, ray), flat = rr - ray[2] * ray[2]; /* |ray|^2 across the axis */
    double s = 0;                                                 /* along the ray */
    if (flat > 1e-12 * rr) s = fmax(-(ray[0] * t->eye[0] + ray[1] * t->eye[1]) / flat, 0);
    const double z = fmin(fmax(t->eye[2] + s * ray[2], -half), half);
    /* Where the axis ends before, the nearest point of the ray to that end. */
    s = fmax(-(ray[0] * t->eye[0] + ray[1] * t->eye[1] + ray[2] * (t->eye[2] - z)) / rr, 0);
    const double p[3] = {t->eye[0] + s * ray[0], t->eye[1] + s * ray[1], t->eye[2] + s * ray[2] - z};
    return dot(p, p) <= radius * radius;
}

/* The ray through a pixel of the image. */
static bool meets(const target *t, const td_camera *camera, double x, double y, double spread)
{
    const double *p = camera->parameter;
    const double seen[3] = {(x - p[2]) / p[0], (y - p[3]) / p[1], 1}, more = spread * t->reach;
    double ray[3];
    for (int i = 0; i < 3; i++) ray[i] = dot(t->r + 3 * i, seen);
    return t->kind == TD_PRIMITIVE_BOX ? meets_box(t, ray, more) : meets_capsule(t, ray, more);
}

static void mask_block(uint8_t *mask, const td_camera *camera, const target *t, int x, int y)
{
    const int right = x + BLOCK < camera->width ? x + BLOCK : camera->width;
    const int low = y + BLOCK < camera->height ? y + BLOCK : camera->height;
    for (int row = y; row < low; row++)
        for (int column = x; column < right; column++) {
            uint8_t *at = mask + (size_t)row * (size_t)camera->width + (size_t)column;
            if (!*at) *at = meets(t, camera, column, row, 0);
        }
}

static void mask_target(uint8_t *mask, const td_camera *camera, const target *t)
{
    for (int y = 0; y < camera->height; y += BLOCK)
        for (int x = 0; x < camera->width; x += BLOCK)
            if (meets(t, camera, x + (BLOCK - 1) / 2., y + (BLOCK - 1) / 2., t->spread))
                mask_block(mask, camera, t, x, y);
}

/* Piece `index` of `count` along the longest side; a capsule's pieces are capsules. */
static td_primitive piece_of(const td_primitive *shape, int axis, int index, int count)
{
    td_primitive piece = *shape;
    double *length = &piece.size[shape->kind == TD_PRIMITIVE_BOX ? axis : 1];
    double centre[3] = {0, 0, 0};
    centre[axis] = *length * ((index + 0.5) / count - 0.5);
    *length /= count;
    td_pose_transform(piece.link_from_shape.t, &shape->link_from_shape, centre);
    return piece;
}

static void mask_shape(uint8_t *mask, const td_camera *camera, const td_own_motion *motion,
                       const td_pose *camera_from_link, int link, const td_primitive *shape)
{
    int axis = 2;
    for (int i = 0; i < 2 && shape->kind == TD_PRIMITIVE_BOX; i++)
        if (shape->size[i] > shape->size[axis]) axis = i;
    const double length = shape->kind == TD_PRIMITIVE_BOX       ? shape->size[axis]
                          : shape->kind == TD_PRIMITIVE_CAPSULE ? shape->size[1]
                                                                : 0;
    const int count = (int)fmin(fmax(ceil(length / PIECE), 1), MOST_PIECES);
    for (int i = 0; i < count; i++) {
        const td_primitive piece = piece_of(shape, axis, i, count);
        const target t =
            target_of(&piece, camera_from_link, td_own_motion_growth(motion, link, &piece), camera);
        mask_target(mask, camera, &t);
    }
}

td_status td_own_body_mask(uint8_t *mask, const td_camera *camera, const td_pose *camera_from_vehicle,
                           const td_robot *robot, const double *q, const td_own_body_options *options,
                           td_error *error)
{
    const td_own_body_options standard = td_own_body_options_default();
    if (!options) options = &standard;
    TD_TRY(td_own_body_check(robot, q, options, error));
    if (camera->model != TD_CAMERA_PINHOLE)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the camera is a %s: masks are of rectified images, pinholes",
                       td_camera_model_name(camera->model));
    td_own_motion motion;
    td_own_motion_begin(&motion, robot, q, options);
    memset(mask, 0, (size_t)camera->width * (size_t)camera->height);
    for (int i = 0; i < robot->link_count; i++) {
        const td_pose camera_from_link = td_pose_compose(camera_from_vehicle, &motion.root_from_link[i]);
        for (int k = 0; td_own_motion_looked_for(&motion, i) && k < robot->link[i].shape_count; k++)
            mask_shape(mask, camera, &motion, &camera_from_link, i, &robot->link[i].shape[k]);
    }
    return TD_OK;
}
