/* A camera in another model: the parameters that bring the rays of its image nearest to their pixels, in the
 * sense of least squares, and how far the worst of them stays. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/least_squares.h"
#include "core/rig_formats_internal.h"

enum { COLUMNS = 61, ROWS = 61, LEAST_SAMPLES = 200, INTRINSICS = 4 };

typedef struct sample {
    double ray[3], pixel[2];
    const td_camera *model; /* that is fitted: its model and size */
} sample;

/* ---- exactly ---- */

/* The same projection in another model, where that only adds or leaves out parameters that are 0. */
static bool translate(td_camera *to, const td_camera *from, td_camera_model model)
{
    const bool fisheye = from->model == TD_CAMERA_FISHEYE;
    if (fisheye != (model == TD_CAMERA_FISHEYE)) return false;
    *to = *from;
    to->model = model;
    for (int i = td_camera_parameter_count(model); i < TD_CAMERA_MAX_PARAMETERS; i++)
        if (to->parameter[i] != 0) return false;
    return true;
}

static bool has_shape(const td_camera *camera, const td_rig_shape *shape)
{
    for (int i = 0; i < TD_CAMERA_MAX_PARAMETERS; i++)
        if ((shape->held >> i & 1u) && camera->parameter[i] != 0) return false;
    return true;
}

/* The same model first, so that a camera comes back as what it was. */
static const td_rig_shape *express_exactly(td_camera *to, const td_camera *camera, const td_rig_shape *shapes,
                                           size_t count)
{
    for (int pass = 0; pass < 2; pass++)
        for (size_t i = 0; i < count; i++)
            if ((pass || shapes[i].model == camera->model) && translate(to, camera, shapes[i].model) &&
                has_shape(to, shapes + i))
                return shapes + i;
    return NULL;
}

bool td_rig_holds(const td_camera *camera, const td_rig_shape *shapes, size_t count)
{
    td_camera same;
    return express_exactly(&same, camera, shapes, count) != NULL;
}

/* ---- by least squares ---- */

/* The image, to the outer edges of its border pixels; where the camera has no ray, there is none to keep. */
static size_t take_samples(sample *s, const td_camera *camera)
{
    size_t count = 0;
    for (int j = 0; j < ROWS; j++)
        for (int i = 0; i < COLUMNS; i++) {
            sample *next = s + count;
            next->pixel[0] = (double)camera->width * i / (COLUMNS - 1) - 0.5;
            next->pixel[1] = (double)camera->height * j / (ROWS - 1) - 0.5;
            count += td_camera_unproject(next->ray, NULL, NULL, camera, next->pixel);
        }
    return count;
}

static bool residual(double *r, double *const *jacobian, const double *const *block, const void *user)
{
    const sample *s = user;
    td_camera camera = *s->model;
    const int count = td_camera_parameter_count(camera.model);
    memcpy(camera.parameter, block[0], (size_t)count * sizeof(double));
    double pixel[2];
    if (!td_camera_project(pixel, NULL, jacobian ? jacobian[0] : NULL, &camera, s->ray)) return false;
    r[0] = pixel[0] - s->pixel[0];
    r[1] = pixel[1] - s->pixel[1];
    return true;
}

static td_status add_residuals(td_problem *problem, td_camera *camera, unsigned held, const sample *s,
                               size_t count, td_error *error)
{
    int block = 0;
    TD_TRY(td_problem_add_block(problem, &block, camera->parameter, td_camera_parameter_count(camera->model),
                                TD_VECTOR, false, error));
    for (int i = 0; i < td_camera_parameter_count(camera->model); i++)
        if (held >> i & 1u) TD_TRY(td_problem_hold_component(problem, block, i, error));
    for (size_t i = 0; i < count; i++)
        TD_TRY(td_problem_add_residual(problem, residual, s + i, 2, &block, 1, NULL, error));
    return td_problem_solve(problem, NULL, NULL, error);
}

/* Infinite where the fit folds: a pixel of it that belongs to no ray, or to another. */
static double largest_error(const td_camera *camera, const sample *s, size_t count)
{
    double largest = 0;
    for (size_t i = 0; i < count; i++) {
        double pixel[2], ray[3];
        if (!td_camera_project(pixel, NULL, NULL, camera, s[i].ray)) return INFINITY;
        if (!td_camera_unproject(ray, NULL, NULL, camera, pixel)) return INFINITY;
        double apart = 0;
        for (int k = 0; k < 3; k++) apart = fmax(apart, fabs(ray[k] - s[i].ray[k]));
        if (!(apart < 1e-6)) return INFINITY;
        largest = fmax(largest, hypot(pixel[0] - s[i].pixel[0], pixel[1] - s[i].pixel[1]));
    }
    return largest;
}

/* Infinite *largest: this shape cannot be brought near. */
static td_status fit(td_camera *fitted, double *largest, const td_camera *camera, const td_rig_shape *shape,
                     sample *s, size_t count, td_error *error)
{
    *largest = INFINITY;
    *fitted = (td_camera){.model = shape->model, .width = camera->width, .height = camera->height};
    memcpy(fitted->parameter, camera->parameter, INTRINSICS * sizeof(double));
    const td_camera model = *fitted;
    for (size_t i = 0; i < count; i++) {
        s[i].model = &model;
        /* Perspective models have no image of what lies beside or behind the camera. */
        if (shape->model != TD_CAMERA_FISHEYE && !(s[i].ray[2] > 1e-3)) return TD_OK;
    }
    td_problem *problem = td_problem_new();
    if (!problem) return td_fail(error, TD_ERROR_MEMORY, "no memory to fit a camera model");
    td_error why;
    const td_status status = add_residuals(problem, fitted, shape->held, s, count, &why);
    td_problem_free(&problem);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status == TD_OK && td_camera_check(fitted, NULL) == TD_OK) *largest = largest_error(fitted, s, count);
    return TD_OK;
}

td_status td_rig_express(td_camera *expressed, const td_rig_shape **shape, double *largest_px,
                         const td_camera *camera, const td_rig_shape *shapes, size_t count, td_error *error)
{
    *largest_px = 0;
    *shape = express_exactly(expressed, camera, shapes, count);
    if (*shape) return TD_OK;
    sample *s = malloc(COLUMNS * ROWS * sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory to fit a camera model");
    const size_t samples = take_samples(s, camera);
    td_status status = TD_OK;
    *largest_px = INFINITY;
    for (size_t i = 0; status == TD_OK && samples >= LEAST_SAMPLES && i < count; i++) {
        td_camera fitted;
        double largest = INFINITY;
        status = fit(&fitted, &largest, camera, shapes + i, s, samples, error);
        if (status != TD_OK || !(largest < *largest_px)) continue;
        *largest_px = largest;
        *expressed = fitted;
        *shape = shapes + i;
    }
    free(s);
    return status;
}
