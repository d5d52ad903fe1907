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

/* ---- lenses ---- */

/* The distortion must be near before focal lengths and poses mean much: with k1 = -0.3 left out the focal
 * length is off by 15 % and up to half. So a few lenses straighten the pixels first, and the one that
 * explains them best stays. */
typedef struct lens {
    double focal, k1; /* in image widths; first radial coefficient */
} lens;

static size_t lenses_of(const lens **list, td_camera_model model)
{
    static const lens brown[] = {{1, 0},     {1, -0.075}, {1, -0.15}, {1, -0.225}, {1, -0.3}, {1, -0.375},
                                 {1, -0.45}, {1, -0.525}, {1, -0.6},  {1, 0.075},  {1, 0.15}};
    static const lens fisheye[] = {{1, 0}, {0.7, 0}, {0.5, 0}, {0.35, 0}, {0.25, 0}};
    *list = model == TD_CAMERA_FISHEYE ? fisheye : brown;
    if (model == TD_CAMERA_PINHOLE) return 1;
    return model == TD_CAMERA_FISHEYE ? sizeof fisheye / sizeof *fisheye : sizeof brown / sizeof *brown;
}

static td_camera camera_of_lens(const td_camera *like, const lens *l)
{
    td_camera camera = {.model = like->model, .width = like->width, .height = like->height};
    camera.parameter[0] = camera.parameter[1] = l->focal * like->width;
    camera.parameter[2] = (like->width - 1) / 2.0;
    camera.parameter[3] = (like->height - 1) / 2.0;
    if (like->model != TD_CAMERA_PINHOLE) camera.parameter[4] = l->k1;
    return camera;
}

/* The camera with the intrinsics k (fx fy cx cy) that were found in the normalised coordinates of `through`.
 * Brown's curve r (1 + k1 r^2) stays the same pixels when k1 goes with the square of the focal length. */
static td_camera camera_through_lens(const td_camera *through, const double k[4])
{
    td_camera camera = *through;
    for (int i = 0; i < 2; i++) {
        camera.parameter[i] = through->parameter[i] * k[i];
        camera.parameter[2 + i] = through->parameter[2 + i] + through->parameter[i] * k[2 + i];
    }
    if (camera.model == TD_CAMERA_BROWN5 || camera.model == TD_CAMERA_BROWN8)
        camera.parameter[4] *= k[0] * k[1];
    return camera;
}

static bool to_normalised(double out[2], const double pixel[2], const td_camera *camera)
{
    double ray[3];
    if (!td_camera_unproject(ray, NULL, NULL, camera, pixel) || ray[2] < 0.1) return false;
    out[0] = ray[0] / ray[2];
    out[1] = ray[1] / ray[2];
    return true;
}

/* ---- poses for a given camera ---- */

/* Homography to normalised coordinates of the plane of which view `v` shows most points. */
static bool view_homography(double h[9], int *plane, const seen_points *s, const td_target *target, size_t v,
                            const td_camera *camera)
{
    size_t votes[TD_TARGET_MAX_TAGS] = {0}, n = 0;
    const int planes = target->kind == TD_TARGET_TAGS ? target->tag_count : target->plane_count;
    for (size_t i = s->first[v]; i < s->first[v + 1]; i++)
        votes[td_target_plane_of(target, s->index[i], NULL)]++;
    *plane = 0;
    for (int p = 1; p < planes; p++)
        if (votes[p] > votes[*plane]) *plane = p;
    if (votes[*plane] < 4) return false;
    double *xy = malloc(4 * votes[*plane] * sizeof *xy);
    if (!xy) return false;
    double *uv = xy + 2 * votes[*plane];
    for (size_t i = s->first[v]; i < s->first[v + 1]; i++) {
        if (td_target_plane_of(target, s->index[i], NULL) != *plane) continue;
        td_target_point_on_plane(xy + 2 * n, target, s->index[i]);
        n += to_normalised(uv + 2 * n, s->pixel + 2 * i, camera);
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

static double quantile(double *x, size_t n, double share)
{
    if (!n) return INFINITY;
    qsort(x, n, sizeof *x, compare_doubles);
    return x[(size_t)(share * (double)(n - 1))];
}

/* Reprojection errors (px) of the points of view `v`; returns their number. */
static size_t view_errors(double *out, const seen_points *s, size_t v, const td_camera *camera,
                          const td_pose *pose)
{
    const double lost = 1e9; /* worse than any */
    for (size_t i = s->first[v]; i < s->first[v + 1]; i++) {
        double p[3], u[2];
        if (pose) td_pose_transform(p, pose, s->point + 3 * i);
        bool seen = pose && td_camera_project(u, NULL, NULL, camera, p);
        *out++ = seen ? hypot(u[0] - s->pixel[2 * i], u[1] - s->pixel[2 * i + 1]) : lost;
    }
    return s->first[v + 1] - s->first[v];
}

static bool on_rail(const td_observations *o, size_t v)
{
    return !isnan(o->height_m[v]);
}

/* Views on a rail are one rigid target: of their poses, and of `rail` (may be NULL), the one that explains
 * most serves all. work: room for an error per point. */
static void share_rail_pose(td_pose *pose, const bool *has_pose, const td_pose *rail, const seen_points *s,
                            const td_observations *o, const td_camera *camera, double *work)
{
    enum { MOST_CANDIDATES = 12 };
    double least = INFINITY;
    td_pose best = td_pose_identity();
    size_t candidates = 0;
    for (size_t c = s->view_count + 1; c-- > 0 && candidates < MOST_CANDIDATES;) {
        const td_pose *candidate = c < s->view_count ? &pose[c] : rail;
        if (c < s->view_count ? !has_pose[c] || !on_rail(o, c) : !rail) continue;
        size_t n = 0;
        candidates++;
        for (size_t v = 0; v < s->view_count; v++)
            if (on_rail(o, v)) n += view_errors(work + n, s, v, camera, candidate);
        double cost = quantile(work, n, 0.5);
        if (cost < least) {
            least = cost;
            best = *candidate;
        }
    }
    for (size_t v = 0; v < s->view_count; v++)
        if (has_pose[v] && on_rail(o, v)) pose[v] = best;
}

/* The error (px) by which poses are judged: the median; but a higher quantile on a target with depth, of
 * which a homography explains one plane whatever the camera, and on a rail, whose views can outvote the free
 * ones. */
static double judge(double *errors, size_t n, const td_observations *o)
{
    bool higher = !td_target_is_flat(&o->target);
    for (size_t v = 0; v < o->view_count; v++) higher = higher || on_rail(o, v);
    return quantile(errors, n, higher ? 0.7 : 0.5);
}

/* Poses of all views for a known camera. Returns what it costs: the error (px) by which all points are
 * judged. */
static double poses_by_homography(td_pose *pose, bool *has_pose, const td_pose *rail, const seen_points *s,
                                  const td_observations *o, const td_camera *camera, double *work)
{
    size_t n = 0;
    for (size_t v = 0; v < s->view_count; v++) {
        double h[9];
        int plane;
        td_pose camera_from_plane;
        has_pose[v] = view_homography(h, &plane, s, &o->target, v, camera) &&
                      td_pose_from_homography(&camera_from_plane, h, NULL) == TD_OK;
        if (!has_pose[v]) continue;
        td_pose target_from_plane = td_target_plane_pose(&o->target, plane);
        td_pose plane_from_target = td_pose_inverse(&target_from_plane);
        if (on_rail(o, v)) plane_from_target.t[2] += o->height_m[v];
        pose[v] = td_pose_compose(&camera_from_plane, &plane_from_target);
    }
    share_rail_pose(pose, has_pose, rail, s, o, camera, work);
    for (size_t v = 0; v < s->view_count; v++)
        n += view_errors(work + n, s, v, camera, has_pose[v] ? &pose[v] : NULL);
    return judge(work, n, o);
}

/* ---- cameras ---- */

/* A search for the camera whose poses explain the points best. */
typedef struct search {
    const seen_points *s;
    const td_observations *o;
    td_pose *pose; /* (views) room to work in, as the next two */
    bool *has_pose;
    double *work; /* (points) */
    td_camera best;
    double cost;
    bool has_rail; /* `rail` comes with the camera */
    td_pose rail;
} search;

/* Keeps the camera when it is clearly better. */
static void try_camera(search *f, const td_camera *camera, const td_pose *rail)
{
    const double *p = camera->parameter, width = camera->width;
    if (!(p[0] > 0.05 * width && p[0] < 100 * width && p[1] > 0.2 * p[0] && p[1] < 5 * p[0])) return;
    if (td_camera_check(camera, NULL) != TD_OK) return;
    double cost = poses_by_homography(f->pose, f->has_pose, rail, f->s, f->o, camera, f->work);
    if (!(cost < 0.99 * f->cost)) return;
    f->best = *camera;
    f->cost = cost;
    f->has_rail = rail;
    if (rail) f->rail = *rail;
}

/* With the intrinsics k that were found through a lens: as they are, and with the lens's centre, which one
 * view alone hardly tells. */
static void try_intrinsics(search *f, const td_camera *through, const double k[4], const td_pose *rail)
{
    const double centred[4] = {k[0], k[1], 0, 0};
    td_camera camera = camera_through_lens(through, k);
    try_camera(f, &camera, rail);
    camera = camera_through_lens(through, centred);
    try_camera(f, &camera, NULL);
}

/* Median, apart, of each of the four intrinsics in k (n,4). */
static void median_intrinsics(double median[4], const double *k, size_t n, double *work)
{
    for (int j = 0; j < 4; j++) {
        for (size_t i = 0; i < n; i++) work[i] = k[4 * i + j];
        median[j] = quantile(work, n, 0.5);
    }
}

/* Focal lengths from all views together, and as the median of each view's own (one wrong view must not spoil
 * them). h: room for (views,9), k for (views,4). Of a fisheye the straightened pixels depend on the focal
 * length: again with it. */
static void try_lens_by_homography(search *f, const td_camera *start, double *h, double *k)
{
    const double centre[2] = {0, 0};
    td_camera through = *start;
    for (int round = 0; round < (start->model == TD_CAMERA_FISHEYE ? 3 : 1); round++) {
        size_t n = 0, singles = 0;
        double all[4] = {0}, median[4] = {0}, focal[2];
        int plane;
        for (size_t v = 0; v < f->s->view_count; v++)
            n += view_homography(h + 9 * n, &plane, f->s, &f->o->target, v, &through);
        if (!n) return;
        if (td_focal_from_homographies(all, centre, h, n)) {
            td_camera camera = camera_through_lens(&through, all);
            try_camera(f, &camera, NULL);
        }
        for (size_t i = 0; i < n; i++)
            if (td_focal_from_homographies(focal, centre, h + 9 * i, 1)) {
                double mean = sqrt(focal[0] * focal[1]), own[4] = {mean, mean, 0, 0};
                memcpy(k + 4 * singles++, own, sizeof own);
            }
        if (!singles) return;
        median_intrinsics(median, k, singles, f->work);
        through = camera_through_lens(&through, median);
        try_camera(f, &through, NULL);
    }
}

static td_status camera_by_homography(search *f, td_error *error)
{
    double *h = malloc((13 * f->s->view_count + 1) * sizeof *h);
    if (!h) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", f->s->view_count);
    const lens *list;
    size_t lenses = lenses_of(&list, f->best.model);
    td_camera like = f->best;
    for (size_t i = 0; i < lenses; i++) {
        td_camera through = camera_of_lens(&like, &list[i]);
        try_lens_by_homography(f, &through, h, h + 9 * f->s->view_count);
    }
    free(h);
    static const double guesses[] = {1, 0.6, 1.6, 0.4, 2.5, 0.25, 4};
    for (size_t i = 0; i < sizeof guesses / sizeof *guesses; i++) {
        td_camera camera = camera_of_lens(&like, &(lens){guesses[i], 0});
        try_camera(f, &camera, NULL);
    }
    if (!isfinite(f->cost))
        return td_fail(error, TD_ERROR_DATA,
                       "no view shows enough of the target (4 points) for a first estimate");
    return TD_OK;
}

/* Faugeras-Toscani on the points of the views to `take`, straightened. room: for 5 numbers a point. */
static td_status faugeras_toscani_of(double k[4], td_pose *pose, const seen_points *s, const bool *take,
                                     const td_camera *through, double *room, td_error *error)
{
    size_t n = 0;
    double *point = room, *xy = room + 3 * s->first[s->view_count];
    for (size_t v = 0; v < s->view_count; v++)
        for (size_t i = s->first[v]; i < s->first[v + 1] && take[v]; i++) {
            memcpy(point + 3 * n, s->point + 3 * i, 3 * sizeof *point);
            n += to_normalised(xy + 2 * n, s->pixel + 2 * i, through);
        }
    return td_faugeras_toscani(NULL, k, NULL, pose, point, xy, n, error);
}

/* All views of known heights as one target with depth, but for view `without` (the number of views: none). */
static td_status try_rail_without(search *f, size_t without, const td_camera *through, bool *take,
                                  double *room, td_error *error)
{
    double k[4];
    td_pose pose;
    for (size_t v = 0; v < f->s->view_count; v++) take[v] = on_rail(f->o, v) && v != without;
    TD_TRY(faugeras_toscani_of(k, &pose, f->s, take, through, room, error));
    try_intrinsics(f, through, k, &pose);
    return TD_OK;
}

/* One wrong view spoils them all; it shows when it is left out. */
static td_status try_rail(search *f, const td_camera *through, bool *take, double *room, td_error *error)
{
    size_t views = f->s->view_count;
    td_status status = try_rail_without(f, views, through, take, room, error);
    for (size_t v = 0; v < views && f->cost > 0.005 * through->width; v++)
        if (on_rail(f->o, v)) (void)try_rail_without(f, v, through, take, room, NULL);
    return status;
}

/* Each view of a target with depth by itself, and the median of what they say. */
static td_status try_free_views(search *f, const td_camera *through, bool *take, double *room,
                                td_error *error)
{
    size_t n = 0, views = f->s->view_count;
    double *k = room + 5 * f->s->first[views], median[4];
    td_status status = TD_OK;
    memset(take, 0, views * sizeof *take);
    for (size_t v = 0; v < views; v++) {
        take[v] = true;
        if (f->s->first[v + 1] > f->s->first[v]) {
            td_status own =
                faugeras_toscani_of(k + 4 * n, NULL, f->s, take, through, room, status ? NULL : error);
            if (own == TD_OK) n++;
            if (status == TD_OK) status = own;
        }
        take[v] = false;
    }
    if (!n) return status;
    median_intrinsics(median, k, n, f->work);
    try_intrinsics(f, through, median, NULL);
    return TD_OK;
}

static td_status camera_by_faugeras_toscani(search *f, bool rail, td_error *error)
{
    size_t views = f->s->view_count, total = f->s->first[views];
    bool *take = calloc(views + 1, sizeof *take);
    double *room = malloc((5 * total + 4 * views + 1) * sizeof *room);
    td_status status = TD_OK;
    const lens *list;
    td_camera like = f->best;
    size_t lenses = lenses_of(&list, like.model);
    if (!take || !room) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", total);
        lenses = 0;
    } else if (!total || (!rail && td_target_is_flat(&f->o->target))) {
        status = td_fail(
            error, TD_ERROR_DATA,
            "Faugeras-Toscani needs a target with depth: planes in dataset.yaml, or height_m in frames.csv");
        lenses = 0;
    }
    for (size_t i = 0; i < lenses; i++) {
        td_camera through = camera_of_lens(&like, &list[i]);
        td_error *first = i ? NULL : error;
        td_status own =
            rail ? try_rail(f, &through, take, room, first) : try_free_views(f, &through, take, room, first);
        if (!i) status = own;
    }
    free(take);
    free(room);
    if (isfinite(f->cost)) return TD_OK;
    return status != TD_OK
               ? status
               : td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the points agree with no camera");
}

/* What ViSP is given: rigid targets, which are the free views and, as one, those on the rail. ViSP knows no
 * distortion, so the pixels are straightened; and no outliers, so views that fit far worse than the others
 * are left out. */
typedef struct visp_input {
    size_t count, *first, *points, *target_of; /* targets; (targets); (targets); (views), SIZE_MAX: none */
    double *point, *pixel, *matrix;            /* (points,3), (points,2), (targets,16) */
} visp_input;

static void visp_free(visp_input *in)
{
    free(in->first);
    free(in->points);
    free(in->target_of);
    free(in->point);
    free(in->pixel);
    free(in->matrix);
}

static td_status visp_allocate(visp_input *in, size_t views, size_t points, td_error *error)
{
    *in = (visp_input){.first = calloc(views + 1, sizeof *in->first),
                       .points = calloc(views + 1, sizeof *in->points),
                       .target_of = calloc(views + 1, sizeof *in->target_of),
                       .point = malloc((3 * points + 1) * sizeof *in->point),
                       .pixel = malloc((2 * points + 1) * sizeof *in->pixel),
                       .matrix = malloc((16 * views + 1) * sizeof *in->matrix)};
    if (in->first && in->points && in->target_of && in->point && in->pixel && in->matrix) return TD_OK;
    visp_free(in);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
}

/* Appends the view's points to the target that is last. */
static void visp_add(visp_input *in, const search *f, size_t v)
{
    const double *k = f->best.parameter;
    size_t target = in->count - 1;
    for (size_t i = f->s->first[v]; i < f->s->first[v + 1]; i++) {
        size_t n = in->first[target] + in->points[target];
        double xy[2];
        if (!to_normalised(xy, f->s->pixel + 2 * i, &f->best)) continue;
        memcpy(in->point + 3 * n, f->s->point + 3 * i, 3 * sizeof(double));
        for (int j = 0; j < 2; j++) in->pixel[2 * n + j] = k[j] * xy[j] + k[2 + j];
        in->points[target]++;
    }
    in->target_of[v] = target;
    td_pose_matrix(in->matrix + 16 * target, &f->pose[v]);
}

static void visp_new_target(visp_input *in)
{
    in->first[in->count] = in->count ? in->first[in->count - 1] + in->points[in->count - 1] : 0;
    in->points[in->count++] = 0;
}

static double view_error(const search *f, size_t v)
{
    return judge(f->work, view_errors(f->work, f->s, v, &f->best, &f->pose[v]), f->o);
}

static void visp_gather(visp_input *in, const search *f)
{
    size_t views = f->s->view_count, n = 0;
    double *error = f->work + f->s->first[views], usual;
    for (size_t v = 0; v < views; v++)
        if (f->has_pose[v]) error[n++] = view_error(f, v);
    usual = quantile(error, n, 0.5);
    for (int rail = 1; rail >= 0; rail--) {
        bool begun = false;
        for (size_t v = 0; v < views; v++) {
            if (on_rail(f->o, v) != rail) continue;
            in->target_of[v] = SIZE_MAX;
            if (!f->has_pose[v] || view_error(f, v) > 5 * usual + 1) continue;
            if (!rail || !begun) visp_new_target(in);
            begun = true;
            visp_add(in, f, v);
        }
    }
}

static td_status camera_by_visp(search *f, bool keep_camera, td_error *error)
{
    void *module = dlopen(TD_VISP_MODULE, RTLD_NOW | RTLD_LOCAL);
    if (!module)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "the ViSP module cannot be loaded (%s); use another --method", dlerror());
    td_visp_estimate_function *estimate;
    *(void **)&estimate = dlsym(module, TD_VISP_FUNCTION);
    visp_input in;
    double k[4] = {0};
    memcpy(k, f->best.parameter, sizeof k);
    td_status status = visp_allocate(&in, f->s->view_count, f->s->first[f->s->view_count], error);
    if (status != TD_OK) {
        dlclose(module);
        return status;
    }
    visp_gather(&in, f);
    status =
        estimate
            ? estimate(k, in.matrix, in.point, in.pixel, in.first, in.points, in.count, keep_camera, error)
            : td_fail(error, TD_ERROR_UNSUPPORTED, "%s has no %s", TD_VISP_MODULE, TD_VISP_FUNCTION);
    td_camera camera = f->best;
    if (status == TD_OK && !keep_camera) {
        const double *p = f->best.parameter;
        const double seen[4] = {k[0] / p[0], k[1] / p[1], (k[2] - p[2]) / p[0], (k[3] - p[3]) / p[1]};
        camera = camera_through_lens(&f->best, seen);
        if (td_camera_check(&camera, NULL) != TD_OK)
            status = td_fail(error, TD_ERROR_CONVERGENCE,
                             "ViSP finds no camera for these views; use another --method");
    }
    for (size_t v = 0; v < f->s->view_count && status == TD_OK; v++) {
        if (!f->has_pose[v] || in.target_of[v] == SIZE_MAX) continue;
        const double *m = in.matrix + 16 * in.target_of[v];
        const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]},
                     t[3] = {m[3], m[7], m[11]};
        f->pose[v] = td_pose_from_rotation(r, t);
    }
    f->best = camera;
    visp_free(&in);
    dlclose(module);
    return status;
}

/* AUTO: Faugeras-Toscani wants heights that differ, or planes that do. */
static bool has_depth(const td_observations *o, bool *rail)
{
    double low = INFINITY, high = -INFINITY;
    for (size_t v = 0; v < o->view_count; v++)
        if (on_rail(o, v)) {
            low = fmin(low, o->height_m[v]);
            high = fmax(high, o->height_m[v]);
        }
    *rail = low <= high;
    return high > low || !td_target_is_flat(&o->target);
}

td_status td_first_estimate(td_camera *camera, td_pose *camera_from_target, bool *has_pose,
                            const td_observations *o, int index, td_estimate_method method, bool keep_camera,
                            td_error *error)
{
    bool rail, depth = has_depth(o, &rail);
    if (method == TD_ESTIMATE_AUTO)
        method = depth && !keep_camera ? TD_ESTIMATE_FAUGERAS_TOSCANI : TD_ESTIMATE_HOMOGRAPHY;

    seen_points s;
    TD_TRY(seen_gather(&s, o, index, error));
    search f = {
        .s = &s, .o = o, .pose = camera_from_target, .has_pose = has_pose, .best = *camera, .cost = INFINITY};
    f.work = malloc((s.first[o->view_count] + o->view_count + 1) * sizeof *f.work);
    td_status status =
        f.work ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", o->view_count);
    if (status == TD_OK && !keep_camera)
        status = method == TD_ESTIMATE_FAUGERAS_TOSCANI ? camera_by_faugeras_toscani(&f, rail, error)
                                                        : camera_by_homography(&f, error);
    if (status == TD_OK)
        poses_by_homography(f.pose, f.has_pose, f.has_rail ? &f.rail : NULL, &s, o, &f.best, f.work);
    if (status == TD_OK && method == TD_ESTIMATE_VISP) status = camera_by_visp(&f, keep_camera, error);
    if (status == TD_OK) *camera = f.best;
    free(f.work);
    seen_free(&s);
    return status;
}
