#include "calib/first_estimate.h"

#include <dlfcn.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/faugeras_toscani.h"
#include "calib/first_estimate_internal.h"
#include "calib/homography.h"

const char *td_estimate_method_name(td_estimate_method method)
{
    static const char *const names[] = {"auto", "homography", "visp", "faugeras-toscani"};
    return method < TD_ESTIMATE_COUNT ? names[method] : NULL;
}

td_estimate_method td_estimate_method_from_name(const char *name)
{
    for (td_estimate_method m = 0; m < TD_ESTIMATE_COUNT; m++)
        if (strcmp(name, td_estimate_method_name(m)) == 0) return m;
    return TD_ESTIMATE_COUNT;
}

/* The points that the camera saw of the target, view after view. */
typedef struct seen_points {
    size_t view_count, *first; /* (views+1) */
    double *point, *pixel;     /* (n,3) target frame, heights included; (n,2) */
    size_t *index;             /* (n) number of the point in the target */
} seen_points;

static void seen_free(seen_points *s)
{
    free(s->first);
    free(s->point);
    free(s->pixel);
    free(s->index);
}

static td_status seen_gather(seen_points *s, const td_observations *o, int camera, td_error *error)
{
    size_t points = td_target_point_count(&o->target), most = points * o->view_count + 1;
    *s = (seen_points){.view_count = o->view_count,
                       .first = calloc(o->view_count + 1, sizeof *s->first),
                       .point = malloc(3 * most * sizeof *s->point),
                       .pixel = malloc(2 * most * sizeof *s->pixel),
                       .index = malloc(most * sizeof *s->index)};
    if (!s->first || !s->point || !s->pixel || !s->index) {
        seen_free(s);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", o->view_count);
    }
    size_t n = 0;
    for (size_t v = 0; v < o->view_count; v++) {
        const td_detection *d = td_observations_get(o, v, camera);
        s->first[v] = n;
        for (size_t p = 0; p < points && d->found; p++) {
            if (!isfinite(d->point[2 * p]) || !isfinite(d->point[2 * p + 1])) continue;
            td_target_point(s->point + 3 * n, &o->target, p);
            if (!isnan(o->height_m[v])) s->point[3 * n + 2] -= o->height_m[v];
            memcpy(s->pixel + 2 * n, d->point + 2 * p, 2 * sizeof(double));
            s->index[n++] = p;
        }
    }
    s->first[o->view_count] = n;
    return TD_OK;
}

/* Homography of the plane of which view `v` shows most points. map: pixels in, 2 numbers out; false drops the point. */
typedef bool (*pixel_map)(double out[2], const double pixel[2], const td_camera *camera);

static bool as_it_is(double out[2], const double pixel[2], const td_camera *camera)
{
    (void)camera;
    memcpy(out, pixel, 2 * sizeof *out);
    return true;
}

static bool to_normalised(double out[2], const double pixel[2], const td_camera *camera)
{
    double ray[3];
    if (!td_camera_unproject(ray, NULL, NULL, camera, pixel) || ray[2] < 0.1) return false;
    out[0] = ray[0] / ray[2];
    out[1] = ray[1] / ray[2];
    return true;
}

static bool view_homography(double h[9], int *plane, const seen_points *s, const td_target *target, size_t v,
                            pixel_map map, const td_camera *camera)
{
    size_t votes[TD_TARGET_MAX_PLANES] = {0}, first_of_plane, n = 0;
    for (size_t i = s->first[v]; i < s->first[v + 1]; i++)
        votes[td_target_plane_of(target, s->index[i], &first_of_plane)]++;
    *plane = 0;
    for (int p = 1; p < target->plane_count; p++)
        if (votes[p] > votes[*plane]) *plane = p;
    if (votes[*plane] < 4) return false;
    double *xy = malloc(4 * votes[*plane] * sizeof *xy);
    if (!xy) return false;
    double *uv = xy + 2 * votes[*plane];
    const td_target_plane *grid = &target->plane[*plane];
    for (size_t i = s->first[v]; i < s->first[v + 1]; i++) {
        if (td_target_plane_of(target, s->index[i], &first_of_plane) != *plane) continue;
        size_t k = s->index[i] - first_of_plane;
        xy[2 * n] = (double)(k % (size_t)grid->columns) * grid->spacing_m;
        xy[2 * n + 1] = (double)(k / (size_t)grid->columns) * grid->spacing_m;
        n += map(uv + 2 * n, s->pixel + 2 * i, camera);
    }
    bool found = td_homography(h, xy, uv, n, NULL) == TD_OK;
    free(xy);
    return found;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Poses of all views for a known camera; `cost` (may be NULL) = median over the points of the reprojection error, px. */
static void poses_by_homography(td_pose *pose, bool *has_pose, double *cost, const seen_points *s,
                                const td_observations *o, const td_camera *camera)
{
    size_t total = s->first[s->view_count], n = 0;
    double *errors = malloc((total + 1) * sizeof *errors);
    for (size_t v = 0; v < s->view_count; v++) {
        double h[9];
        int plane;
        td_pose camera_from_plane;
        has_pose[v] = view_homography(h, &plane, s, &o->target, v, to_normalised, camera) &&
                      td_pose_from_homography(&camera_from_plane, h, NULL) == TD_OK;
        if (!has_pose[v]) continue;
        td_pose plane_from_target = td_pose_inverse(&o->target.plane[plane].target_from_plane);
        if (!isnan(o->height_m[v])) plane_from_target.t[2] += o->height_m[v];
        pose[v] = td_pose_compose(&camera_from_plane, &plane_from_target);
        for (size_t i = s->first[v]; i < s->first[v + 1]; i++) {
            double p[3], pixel[2];
            td_pose_transform(p, &pose[v], s->point + 3 * i);
            bool seen = td_camera_project(pixel, NULL, NULL, camera, p);
            if (errors) errors[n++] = seen ? hypot(pixel[0] - s->pixel[2 * i], pixel[1] - s->pixel[2 * i + 1]) : 1e9;
        }
    }
    if (cost) {
        if (n) qsort(errors, n, sizeof *errors, compare_doubles);
        *cost = n ? errors[n / 2] : INFINITY;
    }
    free(errors);
}

static td_camera camera_of_focal(const td_camera *like, double fx, double fy)
{
    td_camera camera = {.model = like->model, .width = like->width, .height = like->height};
    camera.parameter[0] = fx;
    camera.parameter[1] = fy;
    camera.parameter[2] = (like->width - 1) / 2.0;
    camera.parameter[3] = (like->height - 1) / 2.0;
    return camera;
}

/* Tries a focal length; keeps the camera when its poses explain the points clearly better. */
static void try_focal(td_camera *best, double *best_cost, double fx, double fy, td_pose *pose, bool *has_pose,
                      const seen_points *s, const td_observations *o)
{
    double cost;
    td_camera camera = camera_of_focal(best, fx, fy);
    if (!(fx > 0.05 * best->width && fx < 100.0 * best->width && fy > 0.2 * fx && fy < 5 * fx)) return;
    poses_by_homography(pose, has_pose, &cost, s, o, &camera);
    if (cost < 0.99 * *best_cost) {
        *best = camera;
        *best_cost = cost;
    }
}

static td_status camera_by_homography(td_camera *camera, td_pose *pose, bool *has_pose, const seen_points *s,
                                      const td_observations *o, td_error *error)
{
    double *h = malloc((9 * s->view_count + 1) * sizeof *h), focal[2], best_cost = INFINITY;
    if (!h) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", s->view_count);
    const double centre[2] = {(camera->width - 1) / 2.0, (camera->height - 1) / 2.0};
    size_t n = 0;
    int plane;
    for (size_t v = 0; v < s->view_count; v++) n += view_homography(h + 9 * n, &plane, s, &o->target, v, as_it_is, NULL);
    /* All views together, then each alone (one wrong view must not spoil the start), then plain guesses. */
    if (n && td_focal_from_homographies(focal, centre, h, n))
        try_focal(camera, &best_cost, focal[0], focal[1], pose, has_pose, s, o);
    for (size_t i = 0; i < n && i < 30; i++)
        if (td_focal_from_homographies(focal, centre, h + 9 * i, 1)) {
            double mean = sqrt(focal[0] * focal[1]);
            try_focal(camera, &best_cost, mean, mean, pose, has_pose, s, o);
        }
    static const double guesses[] = {1, 0.6, 1.6, 0.4, 2.5, 0.25, 4};
    for (size_t i = 0; i < sizeof guesses / sizeof *guesses; i++)
        try_focal(camera, &best_cost, guesses[i] * camera->width, guesses[i] * camera->width, pose, has_pose, s, o);
    free(h);
    if (!isfinite(best_cost))
        return td_fail(error, TD_ERROR_DATA, "no view shows enough of the target (4 points) for a first estimate");
    poses_by_homography(pose, has_pose, NULL, s, o, camera);
    return TD_OK;
}

/* All views of known heights as one target with depth, or else the view with most points of a target with depth. */
static td_status camera_by_faugeras_toscani(td_camera *camera, const seen_points *s, const td_observations *o,
                                            td_error *error)
{
    size_t total = s->first[s->view_count], n = 0, best = 0;
    double *point = malloc((5 * total + 1) * sizeof *point), intrinsics[4];
    if (!point) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", total);
    double *pixel = point + 3 * total;
    for (size_t v = 1; v < s->view_count; v++)
        if (s->first[v + 1] - s->first[v] > s->first[best + 1] - s->first[best]) best = v;
    for (size_t v = 0; v < s->view_count; v++) {
        bool rail = !isnan(o->height_m[v]);
        if (!rail && (v != best || td_target_is_flat(&o->target))) continue;
        if (!rail && n) continue;
        size_t count = s->first[v + 1] - s->first[v];
        memcpy(point + 3 * n, s->point + 3 * s->first[v], 3 * count * sizeof(double));
        memcpy(pixel + 2 * n, s->pixel + 2 * s->first[v], 2 * count * sizeof(double));
        n += count;
    }
    td_status status = n ? td_faugeras_toscani(NULL, intrinsics, NULL, NULL, point, pixel, n, error)
                         : td_fail(error, TD_ERROR_DATA,
                                   "Faugeras-Toscani needs a target with depth: planes in dataset.yaml, or height_m in "
                                   "frames.csv");
    free(point);
    TD_TRY(status);
    *camera = camera_of_focal(camera, intrinsics[0], intrinsics[1]);
    memcpy(camera->parameter, intrinsics, sizeof intrinsics);
    return td_camera_check(camera, error);
}

static td_status camera_by_visp(td_camera *camera, td_pose *pose, bool *has_pose, const seen_points *s,
                                bool keep_camera, td_error *error)
{
    void *module = dlopen(TD_VISP_MODULE, RTLD_NOW | RTLD_LOCAL);
    if (!module)
        return td_fail(error, TD_ERROR_UNSUPPORTED, "the ViSP module cannot be loaded (%s); use another --method",
                       dlerror());
    td_visp_estimate_function *estimate;
    *(void **)&estimate = dlsym(module, TD_VISP_FUNCTION);
    /* Only the views that have points, and by themselves. */
    size_t *first = malloc((2 * s->view_count + 1) * sizeof *first), *count = first + s->view_count, views = 0;
    double *matrix = malloc((16 * s->view_count + 1) * sizeof *matrix);
    td_status status = TD_OK;
    if (!first || !matrix || !estimate) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", s->view_count);
    } else {
        for (size_t v = 0; v < s->view_count; v++)
            if (has_pose[v]) {
                first[views] = s->first[v];
                count[views++] = s->first[v + 1] - s->first[v];
            }
        status = estimate(camera->parameter, matrix, s->point, s->pixel, first, count, views, keep_camera, error);
    }
    size_t k = 0;
    for (size_t v = 0; v < s->view_count && status == TD_OK; v++) {
        if (!has_pose[v]) continue;
        const double *m = matrix + 16 * k++;
        const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, t[3] = {m[3], m[7], m[11]};
        pose[v] = td_pose_from_rotation(r, t);
    }
    free(first);
    free(matrix);
    dlclose(module);
    return status;
}

/* Views on a rail are one rigid target: the pose of the view with most points serves all. */
static void share_rail_pose(td_pose *pose, bool *has_pose, const seen_points *s, const td_observations *o)
{
    size_t best = SIZE_MAX;
    for (size_t v = 0; v < s->view_count; v++)
        if (has_pose[v] && !isnan(o->height_m[v]) &&
            (best == SIZE_MAX || s->first[v + 1] - s->first[v] > s->first[best + 1] - s->first[best]))
            best = v;
    for (size_t v = 0; v < s->view_count && best != SIZE_MAX; v++)
        if (has_pose[v] && !isnan(o->height_m[v])) pose[v] = pose[best];
}

td_status td_first_estimate(td_camera *camera, td_pose *camera_from_target, bool *has_pose,
                            const td_observations *o, int index, td_estimate_method method, bool keep_camera,
                            td_error *error)
{
    bool rail = false;
    for (size_t v = 0; v < o->view_count; v++) rail = rail || !isnan(o->height_m[v]);
    bool depth = rail || !td_target_is_flat(&o->target);
    if (method == TD_ESTIMATE_AUTO)
        method = depth && !keep_camera ? TD_ESTIMATE_FAUGERAS_TOSCANI : TD_ESTIMATE_HOMOGRAPHY;

    seen_points s;
    TD_TRY(seen_gather(&s, o, index, error));
    td_status status = TD_OK;
    if (method == TD_ESTIMATE_FAUGERAS_TOSCANI && !keep_camera) {
        status = camera_by_faugeras_toscani(camera, &s, o, error);
        keep_camera = true;
    }
    if (status == TD_OK && keep_camera)
        poses_by_homography(camera_from_target, has_pose, NULL, &s, o, camera);
    else if (status == TD_OK)
        status = camera_by_homography(camera, camera_from_target, has_pose, &s, o, error);
    if (status == TD_OK && method == TD_ESTIMATE_VISP)
        status = camera_by_visp(camera, camera_from_target, has_pose, &s, keep_camera, error);
    if (status == TD_OK) share_rail_pose(camera_from_target, has_pose, &s, o);
    seen_free(&s);
    return status;
}
