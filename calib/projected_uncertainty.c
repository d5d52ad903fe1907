#include "calib/projected_uncertainty.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/projected_internal.h"
#include "core/linalg.h"

enum { MOST_SIDE = 10000, MOST_DISTANCES = 1000, MOST = TD_PROJECTED_MOST };

/* out (2,6) of a gradient of `width` columns = a (2,3) [-[x]x, I], without the translation when `far`. */
static void by_motion(double *out, size_t width, const double a[6], const double x[3], bool far)
{
    double move[18];
    td_pose_transform_jacobian(move, x);
    for (size_t i = 0; i < 2; i++)
        for (size_t k = 0; k < 6; k++) {
            double sum = 0;
            for (size_t j = 0; j < 3; j++) sum += a[3 * i + j] * move[6 * j + k];
            out[i * width + k] = far && k >= 3 ? 0 : sum;
        }
}

bool td_projected_gradient(double gradient[2 * TD_PROJECTED_MOST], size_t *count, const td_rig *rig,
                           int camera, const double pixel[2], double distance_m)
{
    const td_rig_camera *c = &rig->camera[camera];
    size_t parameters = (size_t)td_camera_parameter_count(c->camera.model), width = parameters + 12;
    bool far = isinf(distance_m);
    double x[3], x_rig[3], again[2], by_point[6], by_parameter[2 * TD_CAMERA_MAX_PARAMETERS], r[9], by_rig[6];
    *count = width;
    if (!td_camera_unproject(x, NULL, NULL, &c->camera, pixel)) return false;
    for (int i = 0; i < 3 && !far; i++) x[i] *= distance_m;
    if (!td_camera_project(again, by_point, by_parameter, &c->camera, x)) return false;

    td_pose rig_from_camera = td_pose_inverse(&c->camera_from_rig);
    if (far)
        td_pose_rotate(x_rig, &rig_from_camera, x);
    else
        td_pose_transform(x_rig, &rig_from_camera, x);
    td_pose_rotation(r, &c->camera_from_rig);
    td_multiply(by_rig, by_point, r, 2, 3, 3);
    for (size_t i = 0; i < 2; i++)
        memcpy(gradient + i * width, by_parameter + i * parameters, parameters * sizeof *gradient);
    by_motion(gradient + parameters, width, by_point, x, far);
    by_motion(gradient + parameters + 6, width, by_rig, x_rig, far);
    return true;
}

void td_grid_pixel(double pixel[2], const td_camera *camera, int column, int columns, int row, int rows)
{
    pixel[0] = (camera->width - 1) * (columns > 1 ? (double)column / (columns - 1) : 0.5);
    pixel[1] = (camera->height - 1) * (rows > 1 ? (double)row / (rows - 1) : 0.5);
}

double td_worst_sigma(const double s[4])
{
    double middle = (s[0] + s[3]) / 2;
    return sqrt(fmax(middle + hypot((s[0] - s[3]) / 2, (s[1] + s[2]) / 2), 0));
}

/* Joint covariance (n,n) of what moves the images of one camera, in the order of td_projected_gradient; NaN
 * when the camera saw nothing. */
static td_status camera_covariance(double *out, const td_bundle_result *result, int camera, td_error *error)
{
    const td_bundle_blocks *blocks = &result->problem.blocks;
    size_t parameters = (size_t)td_camera_parameter_count(result->bundle.rig->camera[camera].camera.model);
    size_t n = parameters + 12, used = 0, parts = 0;
    for (size_t v = 0; v < result->observations->view_count; v++)
        used += td_bundle_used(&result->bundle, v, camera);
    for (size_t i = 0; i < n * n && !used; i++) out[i] = NAN;
    if (!used) return TD_OK;

    double own[MOST * MOST] = {0}, pose[MOST * 6] = {0}, board[MOST * 6] = {0};
    for (size_t i = 0; i < parameters; i++) own[i * parameters + i] = 1;
    for (size_t i = 0; i < 6; i++) {
        pose[(parameters + i) * 6 + i] = 1;
        board[(parameters + 6 + i) * 6 + i] = 1 / (double)result->board_count;
    }
    td_linear_part *part = malloc((result->board_count + 2) * sizeof *part);
    if (!part) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu boards", result->board_count);
    part[parts++] = (td_linear_part){blocks->camera[camera], own};
    if (camera > 0) part[parts++] = (td_linear_part){blocks->pose[camera], pose};
    for (size_t i = 0; i < result->board_count; i++)
        part[parts++] = (td_linear_part){result->board[i], board};
    td_status status = td_covariance_propagate(out, n, result->covariance, part, parts, error);
    free(part);
    return status;
}

/* The covariances of all cameras, (MOST,MOST) apart. *covariances: free(). */
static td_status all_covariances(double **covariances, const td_calibration *calibration,
                                 const td_observations *observations, td_error *error)
{
    td_bundle_result result;
    *covariances = malloc((size_t)calibration->rig->count * MOST * MOST * sizeof **covariances);
    if (!*covariances) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    td_status status = td_bundle_result_new(&result, calibration, observations, error);
    if (status == TD_OK) {
        size_t null = td_covariance_null_count(result.covariance);
        if (null)
            status =
                td_fail(error, TD_ERROR_DATA,
                        "projected uncertainty: %zu combination%s of the cameras' parameters cannot be "
                        "found from these views, so it has no bound; add views of other tilts and distances",
                        null, null > 1 ? "s" : "");
        for (int c = 0; c < calibration->rig->count && status == TD_OK; c++)
            status = camera_covariance(*covariances + c * MOST * MOST, &result, c, error);
        td_bundle_result_free(&result);
    }
    if (status != TD_OK) {
        free(*covariances);
        *covariances = NULL;
    }
    return status;
}

/* out (2,2) = G C G^T; NaN when the pixel has no ray. */
static void propagate(double out[4], const td_rig *rig, int camera, const double pixel[2], double distance_m,
                      const double *covariances)
{
    double g[2 * MOST], gc[2 * MOST];
    size_t n;
    for (int i = 0; i < 4; i++) out[i] = NAN;
    if (!td_projected_gradient(g, &n, rig, camera, pixel, distance_m)) return;
    td_multiply(gc, g, covariances + camera * MOST * MOST, 2, n, n);
    td_multiply_transposed(out, gc, g, 2, n, 2);
    out[1] = out[2] = (out[1] + out[2]) / 2;
}

td_status td_projected_uncertainty(double *covariance, const td_projected_query *query, size_t count,
                                   const td_calibration *calibration, const td_observations *observations,
                                   td_error *error)
{
    double *covariances;
    for (size_t i = 0; i < count; i++) {
        if (query[i].camera < 0 || query[i].camera >= calibration->rig->count)
            return td_fail(error, TD_ERROR_ARGUMENT, "query %zu: there is no camera %d", i, query[i].camera);
        if (!(query[i].distance_m > 0))
            return td_fail(error, TD_ERROR_ARGUMENT, "query %zu: distance_m: %g must be > 0", i,
                           query[i].distance_m);
    }
    TD_TRY(all_covariances(&covariances, calibration, observations, error));
    for (size_t i = 0; i < count; i++)
        propagate(covariance + 4 * i, calibration->rig, query[i].camera, query[i].pixel, query[i].distance_m,
                  covariances);
    free(covariances);
    return TD_OK;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

bool td_board_distances(double *nearest, double *farthest, double *middle, const td_calibration *calibration,
                        const td_observations *observations)
{
    const td_target *target = &observations->target;
    size_t cameras = (size_t)observations->camera_count, points = td_target_point_count(target), n = 0;
    double *distance = malloc((observations->view_count * cameras + 1) * sizeof *distance), centre[3] = {0};
    if (!distance) return false;
    for (size_t p = 0; p < points; p++) {
        double x[3];
        td_target_point(x, target, p);
        for (int i = 0; i < 3; i++) centre[i] += x[i] / (double)points;
    }
    for (size_t v = 0; v < observations->view_count; v++)
        for (size_t c = 0; c < cameras; c++) {
            const td_calibrated_view *view = &calibration->view[v];
            double x[3] = {centre[0], centre[1], centre[2]};
            if (view->points[c] == view->outliers[c]) continue;
            if (!isnan(observations->height_m[v])) x[2] -= observations->height_m[v];
            td_pose_transform(x, &view->rig_from_target, x);
            td_pose_transform(x, &calibration->rig->camera[c].camera_from_rig, x);
            distance[n++] = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
        }
    qsort(distance, n, sizeof *distance, compare_doubles);
    if (n) {
        *nearest = distance[0];
        *farthest = distance[n - 1];
        *middle = distance[n / 2];
    }
    free(distance);
    return n > 0;
}

/* The given distances, or the default ones. */
static td_status fill_distances(td_uncertainty_map *map, const double *distance_m,
                                const td_calibration *calibration, const td_observations *observations,
                                td_error *error)
{
    double nearest, farthest, median;
    if (distance_m) {
        memcpy(map->distance_m, distance_m, (size_t)map->distance_count * sizeof *distance_m);
        return TD_OK;
    }
    if (!td_board_distances(&nearest, &farthest, &median, calibration, observations))
        return td_fail(error, TD_ERROR_DATA, "uncertainty map: no view was used");
    const double d[4] = {nearest, (nearest + farthest) / 2, farthest, 10 * farthest};
    memcpy(map->distance_m, d, sizeof d);
    return TD_OK;
}

static void fill_map(td_uncertainty_map *map, const td_rig *rig, const double *covariances)
{
    double *out = map->sigma_px;
    for (int c = 0; c < map->camera_count; c++)
        for (int d = 0; d < map->distance_count; d++)
            for (int row = 0; row < map->rows; row++)
                for (int column = 0; column < map->columns; column++) {
                    double pixel[2], s[4];
                    td_grid_pixel(pixel, &rig->camera[c].camera, column, map->columns, row, map->rows);
                    propagate(s, rig, c, pixel, map->distance_m[d], covariances);
                    *out++ = isnan(s[0]) ? NAN : td_worst_sigma(s);
                }
}

static td_status check_map(int columns, int rows, const double *distance_m, int distance_count,
                           td_error *error)
{
    if (columns < 1 || rows < 1 || columns > MOST_SIDE || rows > MOST_SIDE)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "uncertainty map: a grid of %d x %d, at least 1 x 1 and at most "
                       "%d x %d",
                       columns, rows, MOST_SIDE, MOST_SIDE);
    if (distance_m && (distance_count < 1 || distance_count > MOST_DISTANCES))
        return td_fail(error, TD_ERROR_ARGUMENT, "distance_count: %d, must be 1 to %d", distance_count,
                       MOST_DISTANCES);
    for (int i = 0; distance_m && i < distance_count; i++)
        if (!(distance_m[i] > 0))
            return td_fail(error, TD_ERROR_ARGUMENT, "distance_m[%d]: %g must be > 0", i, distance_m[i]);
    return TD_OK;
}

td_status td_uncertainty_map_new(td_uncertainty_map **map, int columns, int rows, const double *distance_m,
                                 int distance_count, const td_calibration *calibration,
                                 const td_observations *observations, td_error *error)
{
    *map = NULL;
    TD_TRY(check_map(columns, rows, distance_m, distance_count, error));
    if (!distance_m) distance_count = 4;
    double *covariances;
    TD_TRY(all_covariances(&covariances, calibration, observations, error));
    td_uncertainty_map *m = calloc(1, sizeof *m);
    td_status status = m ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for an uncertainty map");
    if (status == TD_OK) {
        *m = (td_uncertainty_map){columns, rows, distance_count, calibration->rig->count, NULL, NULL};
        size_t size = (size_t)columns * (size_t)rows * (size_t)distance_count * (size_t)m->camera_count;
        m->distance_m = malloc((size_t)distance_count * sizeof *m->distance_m);
        m->sigma_px = malloc(size * sizeof *m->sigma_px);
        if (!m->distance_m || !m->sigma_px)
            status = td_fail(error, TD_ERROR_MEMORY, "no memory for an uncertainty map of %zu numbers", size);
    }
    if (status == TD_OK) status = fill_distances(m, distance_m, calibration, observations, error);
    if (status == TD_OK) fill_map(m, calibration->rig, covariances);
    free(covariances);
    if (status == TD_OK)
        *map = m;
    else
        td_uncertainty_map_free(&m);
    return status;
}

void td_uncertainty_map_free(td_uncertainty_map **map)
{
    if (!map || !*map) return;
    free((*map)->distance_m);
    free((*map)->sigma_px);
    free(*map);
    *map = NULL;
}
