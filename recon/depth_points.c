#include "recon/depth_points.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/depth_points_internal.h"

static const uint32_t UNSEEN = UINT32_MAX;

/* ---- a camera made ready ---- */

static td_status check_arguments(const td_rig *rig, int left, int right, double near_m, double far_m,
                                 td_error *error)
{
    if (left < 0 || left >= rig->count || right < 0 || right >= rig->count || left == right)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the rig has no pair of cameras %d and %d, it has %d cameras", left, right,
                       rig->count);
    if (!(near_m > 0 && far_m > near_m && isfinite(far_m)))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "near_m, far_m: must be finite with 0 < near_m < far_m, not %g and %g", near_m, far_m);
    const td_camera *camera[2] = {&rig->camera[left].camera, &rig->camera[right].camera};
    for (int i = 0; i < 2; i++)
        if (camera[i]->width < 2 || camera[i]->height < 2)
            return td_fail(error, TD_ERROR_DATA, "camera '%s': images of %dx%d px are too small for a map",
                           rig->camera[i ? right : left].name, camera[i]->width, camera[i]->height);
    return TD_OK;
}

static td_status rectify(td_depth_camera *c, td_error *error)
{
    const td_rig_camera *left = &c->rig->camera[c->left], *right = &c->rig->camera[c->right];
    const td_pose rig_from_left = td_pose_inverse(&left->camera_from_rig);
    const td_pose right_from_left = td_pose_compose(&right->camera_from_rig, &rig_from_left);
    td_rectification *r = &c->rectification;
    td_status status = td_rectify(r, &left->camera, &right->camera, &right_from_left, 0, error);
    if (status != TD_OK)
        return td_error_prefix(error, status, "cameras '%s' and '%s'", left->name, right->name);
    if (r->vertical)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "cameras '%s' and '%s' are one above the other: dense maps need two side by side",
                       left->name, right->name);
    if (r->baseline_m < 0)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "camera '%s' stands to the right of camera '%s': give them the other way round",
                       left->name, right->name);
    const td_pose left_from_rectified = td_pose_inverse(&r->rectified_from[0]);
    c->rig_from_rectified = td_pose_compose(&rig_from_left, &left_from_rectified);
    c->f = r->camera.parameter[0];
    c->cx = r->camera.parameter[2];
    c->cy = r->camera.parameter[3];
    c->base_px_m = c->f * r->baseline_m;
    return TD_OK;
}

/* One coordinate of a source pixel: index of the first of two neighbours and the way to the second in 1/256;
 * the border is repeated outside. */
static uint32_t split(uint16_t *part, double u, int size)
{
    const double held = fmin(fmax(u, 0), size - 1);
    const long whole = lrint(held * 256);
    long first = whole / 256;
    if (first > size - 2) first = size - 2;
    *part = (uint16_t)(whole - 256 * first);
    return (uint32_t)first;
}

static td_status make_table(td_depth_source **out, const td_depth_camera *c, int index, td_error *error)
{
    const td_camera *rectified = &c->rectification.camera;
    const td_camera *camera = &c->rig->camera[index ? c->right : c->left].camera;
    const size_t n = (size_t)rectified->width * (size_t)rectified->height;
    float *at = malloc(2 * n * sizeof *at);
    td_depth_source *table = malloc(n * sizeof *table);
    *out = table;
    td_status status = at && table ? td_rectify_table(at, &c->rectification, index, camera, 0)
                                   : td_fail(error, TD_ERROR_MEMORY, "no memory for a table of %dx%d px",
                                             rectified->width, rectified->height);
    for (size_t i = 0; status == TD_OK && i < n; i++) {
        table[i] = (td_depth_source){UNSEEN, 0, 0};
        if (isnan(at[2 * i])) continue;
        const uint32_t column = split(&table[i].right, at[2 * i], camera->width);
        const uint32_t row = split(&table[i].down, at[2 * i + 1], camera->height);
        table[i].first = row * (uint32_t)camera->width + column;
    }
    free(at);
    return status;
}

td_status td_depth_camera_new(td_depth_camera **camera, const td_rig *rig, int left, int right, double near_m,
                              double far_m, td_error *error)
{
    *camera = NULL;
    TD_TRY(check_arguments(rig, left, right, near_m, far_m, error));
    td_depth_camera *c = calloc(1, sizeof *c);
    if (!c) return td_fail(error, TD_ERROR_MEMORY, "no memory for a depth camera");
    *c = (td_depth_camera){.rig = rig, .left = left, .right = right, .near_m = near_m, .far_m = far_m};
    td_status status = rectify(c, error);
    for (int i = 0; status == TD_OK && i < 2; i++) status = make_table(&c->source[i], c, i, error);
    if (status == TD_OK && rig->covariance) status = td_depth_error_grid(c, error);
    if (status != TD_OK) td_depth_camera_free(&c);
    *camera = c;
    return status;
}

void td_depth_camera_free(td_depth_camera **camera)
{
    if (!camera || !*camera) return;
    free((*camera)->source[0]);
    free((*camera)->source[1]);
    free((*camera)->error);
    free(*camera);
    *camera = NULL;
}

const td_rectification *td_depth_camera_rectification(const td_depth_camera *camera)
{
    return &camera->rectification;
}

td_pose td_depth_camera_pose(const td_depth_camera *camera)
{
    return camera->rig_from_rectified;
}

void td_depth_camera_range(int *lowest, int *levels, const td_depth_camera *camera)
{
    *lowest = (int)floor(camera->base_px_m / camera->far_m);
    *levels = (int)ceil(camera->base_px_m / camera->near_m) - *lowest + 1;
}

/* ---- both images by the tables ---- */

typedef struct remap {
    td_image *out;
    const td_image *image;
    const td_depth_source *source;
} remap;

/* Bilinear in 1/65536, rounded once. */
static void remap_row(size_t row, void *user)
{
    const remap *m = user;
    const size_t width = (size_t)m->out->width, channels = (size_t)m->out->channels;
    const size_t step = (size_t)m->image->width * channels;
    const td_depth_source *source = m->source + row * width;
    uint8_t *to = m->out->data + row * width * channels;
    for (size_t column = 0; column < width; column++) {
        const td_depth_source s = source[column];
        if (s.first == UNSEEN) continue;
        const uint8_t *from = m->image->data + s.first * channels;
        for (size_t k = 0; k < channels; k++) {
            const uint32_t above = (256u - s.right) * from[k] + s.right * (uint32_t)from[channels + k];
            const uint32_t below =
                (256u - s.right) * from[step + k] + s.right * (uint32_t)from[step + channels + k];
            to[column * channels + k] = (uint8_t)(((256u - s.down) * above + s.down * below + 32768u) >> 16);
        }
    }
}

static td_status rectify_one(td_image **out, const td_depth_camera *c, int index, const td_image *image,
                             int threads, td_error *error)
{
    const td_rig_camera *camera = &c->rig->camera[index ? c->right : c->left];
    if (image->width != camera->camera.width || image->height != camera->camera.height)
        return td_fail(
            error, TD_ERROR_DATA,
            "camera '%s': the image is %dx%d px, the rig was calibrated at %dx%d: give the rig that "
            "took it",
            camera->name, image->width, image->height, camera->camera.width, camera->camera.height);
    const td_camera *rectified = &c->rectification.camera;
    TD_TRY(td_image_new(out, rectified->width, rectified->height, image->channels, error));
    remap m = {*out, image, c->source[index]};
    return td_parallel_for((size_t)rectified->height, threads, remap_row, &m, NULL, NULL);
}

td_status td_depth_camera_rectify(td_image **left, td_image **right, const td_depth_camera *camera,
                                  const td_image *raw_left, const td_image *raw_right, int threads,
                                  td_error *error)
{
    *left = NULL;
    if (right) *right = NULL;
    td_status status = rectify_one(left, camera, 0, raw_left, threads, error);
    if (status == TD_OK && right) status = rectify_one(right, camera, 1, raw_right, threads, error);
    if (status != TD_OK) {
        td_image_free(left);
        if (right) td_image_free(right);
    }
    return status;
}

/* ---- points ---- */

bool td_depth_camera_point(td_depth_point *point, const td_depth_camera *camera, int x, int y,
                           float disparity, float sigma)
{
    if (!(disparity > 0)) return false;
    const double depth = camera->base_px_m / (double)disparity;
    if (!(depth >= camera->near_m && depth <= camera->far_m)) return false;
    double seen[3] = {(x - camera->cx) / camera->f * depth, (y - camera->cy) / camera->f * depth, depth},
           p[3];
    td_pose_transform(p, &camera->rig_from_rectified, seen);
    /* depth = base / d: by d, the point moves towards the camera by itself / d. */
    for (int i = 0; i < 3; i++) seen[i] *= (double)sigma / (double)disparity;
    double axis[3], covariance[6];
    td_pose_rotate(axis, &camera->rig_from_rectified, seen);
    td_depth_error_at(covariance, camera, x, y, depth);
    for (int i = 0; i < 3; i++) point->p[i] = (float)p[i], point->axis[i] = (float)axis[i];
    for (int i = 0; i < 6; i++) point->calibration[i] = (float)covariance[i];
    return true;
}
