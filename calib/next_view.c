#include "calib/next_view.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/placement_internal.h"
#include "calib/projected_internal.h"
#include "calib/view_information_internal.h"

enum {
    GRID_COLUMNS = 8, /* where the uncertainty counts: the middles of cells, so no outermost pixel rules */
    GRID_ROWS = 6,
    CELLS = GRID_COLUMNS * GRID_ROWS,
    MOST_CAMERAS = 4, /* whose images are searched */
    PLACEMENTS = 9 * 3 * 9 * 2,
    WEIGHED_POINTS = 64, /* of a board; more are stood for by every second, third … */
    RULES = 9
};

/* Poses that gain this share of the best one's gain are as good: the simplest of them is asked for. */
#define AS_GOOD 0.98
#define NOMINAL_HALF_ANGLE 0.5235987755982988 /* 30 degrees */

td_next_view_options td_next_view_options_default(void)
{
    return (td_next_view_options){.gain_that_counts = 0.03};
}

td_status td_next_view_options_check(const td_next_view_options *o, td_error *error)
{
    const struct {
        const char *name;
        double value;
    } field[] = {{"nearest_m", o->nearest_m},
                 {"farthest_m", o->farthest_m},
                 {"distance_m", o->distance_m},
                 {"enough_px", o->enough_px},
                 {"gain_that_counts", o->gain_that_counts}};
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].value >= 0))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: %g must not be negative", field[i].name,
                           field[i].value);
    if (o->gain_that_counts >= 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "gain_that_counts: %g must be < 1", o->gain_that_counts);
    if (o->skip < 0) return td_fail(error, TD_ERROR_ARGUMENT, "skip: %d must not be negative", o->skip);
    if (o->nearest_m > 0 && o->farthest_m > 0 && o->nearest_m > o->farthest_m)
        return td_fail(error, TD_ERROR_ARGUMENT, "nearest_m: %g is beyond farthest_m, %g", o->nearest_m,
                       o->farthest_m);
    return TD_OK;
}

/* ---- before the first calibration ---- */

static td_rig_camera nominal_camera(const td_observed_camera *seen)
{
    td_rig_camera c = {.camera_from_rig = td_pose_identity()};
    int width = seen->width > 0 ? seen->width : 640, height = seen->height > 0 ? seen->height : 480;
    double focal = width / 2.0 / tan(NOMINAL_HALF_ANGLE);
    c.camera =
        (td_camera){TD_CAMERA_PINHOLE, width, height, {focal, focal, (width - 1) / 2.0, (height - 1) / 2.0}};
    return c;
}

static td_status by_rule(td_next_view *view, const td_observations *o, const td_next_view_options *options,
                         td_error *error)
{
    static const td_placement rules[RULES] = {{.distance = 1},
                                              {.distance = 1, .tilt = TD_TILT_RIGHT, .tilt_deg = 30},
                                              {.distance = 1, .tilt = TD_TILT_UP, .tilt_deg = 30},
                                              {.distance = 1, .tilt = TD_TILT_LEFT, .tilt_deg = 30},
                                              {.distance = 1, .tilt = TD_TILT_DOWN, .tilt_deg = 30},
                                              {.distance = 1, .across = -1, .down = -1},
                                              {.distance = 1, .across = 1, .down = 1},
                                              {.distance = 1, .across = 1, .down = -1},
                                              {.distance = 1, .across = -1, .down = 1}};
    size_t fewest = SIZE_MAX;
    int camera = 0;
    for (int c = 0; c < o->camera_count; c++) {
        size_t found = 0;
        for (size_t v = 0; v < o->view_count; v++) found += td_observations_get(o, v, c)->found;
        if (found < fewest) {
            fewest = found;
            camera = c;
        }
    }
    td_board_shape shape = td_board_shape_of(&o->target);
    td_rig_camera nominal = nominal_camera(&o->camera[camera]);
    td_placement p = rules[(fewest + (size_t)options->skip) % RULES];
    double nearest =
        options->nearest_m > 0 ? options->nearest_m : td_filling_distance(&shape, &nominal.camera, 0.75);
    double farthest =
        options->farthest_m > 0 ? options->farthest_m : td_filling_distance(&shape, &nominal.camera, 0.25);
    p.camera = camera;
    p.distance_m = sqrt(nearest * fmax(nearest, farthest));
    if (!td_placement_fit(&p, &shape, &nominal))
        return td_fail(
            error, TD_ERROR_DATA,
            "next view: the board does not fit into the image at %.2g m; let it be held farther off",
            p.distance_m);
    view->camera = camera;
    view->rig_from_target = p.rig_from_target;
    view->sigma_px = view->predicted_px = NAN;
    td_placement_outline(view->outline, &shape, &nominal, &p.rig_from_target);
    td_placement_words(view->text, &p, o->camera_count > 1 ? o->camera[camera].name : NULL);
    return TD_OK;
}

/* ---- what a view would tell ---- */

typedef struct search {
    const td_bundle *bundle;
    td_board_shape shape;
    td_shared_layout layout;
    td_information now, with; /* by the views so far; and with one more */
    td_board_information board;
    double *covariance; /* (n+6,n+6) */
    double *weight;     /* (n+6,n+6) the uncertainty's mean square is sum weight * covariance */
    double *gradient;   /* (cameras,CELLS,2,n+6); NaN: no ray */
    double variance[TD_RIG_MAX_CAMERAS]; /* px^2, of a point's coordinate */
    td_placement *placement;             /* (count) */
    double *sigma;                       /* (count) px; root mean square over both directions */
    size_t count;
} search;

static void search_free(search *s)
{
    td_information_free(&s->now);
    td_information_free(&s->with);
    td_board_information_free(&s->board);
    free(s->covariance);
    free(s->weight);
    free(s->gradient);
    free(s->placement);
    free(s->sigma);
}

static td_status search_init(search *s, const td_bundle *bundle, td_error *error)
{
    *s = (search){.bundle = bundle, .shape = td_board_shape_of(&bundle->observations->target)};
    s->layout = td_shared_layout_of(bundle);
    size_t m = s->layout.n + 6, cameras = (size_t)bundle->rig->count;
    size_t searched = cameras < MOST_CAMERAS ? cameras : MOST_CAMERAS;
    s->covariance = malloc(m * m * sizeof *s->covariance);
    s->weight = calloc(m * m, sizeof *s->weight);
    s->gradient = malloc(cameras * CELLS * 2 * m * sizeof *s->gradient);
    s->placement = malloc(searched * PLACEMENTS * sizeof *s->placement);
    s->sigma = malloc(searched * PLACEMENTS * sizeof *s->sigma);
    if (!s->covariance || !s->weight || !s->gradient || !s->placement || !s->sigma)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the search of a view");
    TD_TRY(td_information_init(&s->with, s->layout.n, error));
    TD_TRY(td_board_information_init(&s->board, s->layout.n, error));
    return td_information_of_bundle(&s->now, &s->layout, bundle, error);
}

/* The common noise, and the mean square of what the points' detections say of themselves. */
static void fill_variances(search *s)
{
    const td_observations *o = s->bundle->observations;
    for (int c = 0; c < s->bundle->rig->count; c++) {
        double sum = 0;
        size_t count = 0;
        for (size_t v = 0; v < o->view_count && s->bundle->own_sigma; v++)
            for (size_t p = 0; p < s->shape.points; p++)
                if (s->bundle->used[td_bundle_index(s->bundle, v, c, p)]) {
                    double sigma = td_observations_get(o, v, c)->sigma[p];
                    sum += sigma * sigma;
                    count++;
                }
        s->variance[c] = s->bundle->noise[c] * s->bundle->noise[c] + (count ? sum / (double)count : 0);
    }
}

/* Gradients at the cells' middles, and the mean of their squares. */
static void fill_weight(search *s, double distance_m)
{
    size_t m = s->layout.n + 6, cells = 0;
    for (int c = 0; c < s->bundle->rig->count; c++)
        for (int i = 0; i < CELLS; i++) {
            const td_camera *camera = &s->bundle->rig->camera[c].camera;
            double *g = s->gradient + ((size_t)c * CELLS + (size_t)i) * 2 * m;
            const double pixel[2] = {camera->width * (i % GRID_COLUMNS + 0.5) / GRID_COLUMNS - 0.5,
                                     camera->height * (i / GRID_COLUMNS + 0.5) / GRID_ROWS - 0.5};
            if (!td_information_gradient(g, &s->layout, s->bundle->rig, c, pixel, distance_m)) {
                g[0] = NAN;
                continue;
            }
            cells++;
            for (size_t a = 0; a < m; a++)
                for (size_t b = 0; b < m; b++)
                    s->weight[a * m + b] += (g[a] * g[b] + g[m + a] * g[m + b]) / 2;
        }
    for (size_t i = 0; i < m * m && cells; i++) s->weight[i] /= (double)cells;
}

/* Projected uncertainty, px, root mean square over cells and both directions; INFINITY: not determined. */
static double mean_sigma(search *s, const td_information *information)
{
    size_t m = s->layout.n + 6;
    double sum = 0;
    if (td_information_covariance(s->covariance, information, NULL) != TD_OK) return INFINITY;
    for (size_t i = 0; i < m * m; i++) sum += s->weight[i] * s->covariance[i];
    return sqrt(fmax(sum, 0));
}

/* The same in the worst direction, for one camera or (-1) all. */
static double worst_sigma(search *s, const td_information *information, int camera)
{
    size_t m = s->layout.n + 6, cells = 0;
    double sum = 0;
    if (td_information_covariance(s->covariance, information, NULL) != TD_OK) return INFINITY;
    for (size_t i = 0; i < (size_t)s->bundle->rig->count * CELLS; i++) {
        const double *g = s->gradient + i * 2 * m;
        double out[4] = {0};
        if ((camera >= 0 && i / CELLS != (size_t)camera) || isnan(g[0])) continue;
        for (size_t a = 0; a < m; a++) {
            double u = 0, v = 0;
            for (size_t b = 0; b < m; b++) {
                u += s->covariance[a * m + b] * g[b];
                v += s->covariance[a * m + b] * g[m + b];
            }
            out[0] += g[a] * u;
            out[1] += g[a] * v;
            out[3] += g[m + a] * v;
        }
        out[2] = out[1];
        sum += td_worst_sigma(out) * td_worst_sigma(out);
        cells++;
    }
    return cells ? sqrt(sum / (double)cells) : NAN;
}

/* s->with = s->now and the board at a pose, as the cameras that see it would. False: its pose is not
 * determined.
 */
static bool add_placement(search *s, const td_placement *placement)
{
    const td_rig *rig = s->bundle->rig;
    const td_target *target = s->shape.target;
    size_t step = (s->shape.points + WEIGHED_POINTS - 1) / WEIGHED_POINTS;
    td_board_information_clear(&s->board);
    for (int c = 0; c < rig->count; c++) {
        const td_camera *camera = &rig->camera[c].camera;
        if (c != placement->camera &&
            !td_board_is_seen(&s->shape, &rig->camera[c], &placement->rig_from_target))
            continue;
        for (size_t p = 0; p < s->shape.points; p += step) {
            double x[3], moved[3], pixel[2], bulge[2];
            td_target_point(x, target, p);
            if (s->bundle->use_warp) {
                td_bundle_warp_shape(bulge, target, p);
                x[2] += s->bundle->warp[0] * bulge[0] + s->bundle->warp[1] * bulge[1];
            }
            if (!s->shape.whole) {
                td_pose_transform(moved, &placement->rig_from_target, x);
                td_pose_transform(moved, &rig->camera[c].camera_from_rig, moved);
                if (!td_camera_project(pixel, NULL, NULL, camera, moved) || pixel[0] < 0 || pixel[1] < 0 ||
                    pixel[0] > camera->width - 1 || pixel[1] > camera->height - 1)
                    continue;
            }
            td_board_information_add(&s->board, &s->layout, rig, c, &placement->rig_from_target, x,
                                     s->bundle->use_warp ? bulge : NULL, (double)step / s->variance[c]);
        }
    }
    td_information_copy(&s->with, &s->now);
    return td_information_add(&s->with, &s->board);
}

/* ---- the search ---- */

/* The cameras whose images are searched, the worst first. */
static int searched_cameras(int out[TD_RIG_MAX_CAMERAS], search *s)
{
    double sigma[TD_RIG_MAX_CAMERAS];
    int count = s->bundle->rig->count;
    for (int c = 0; c < count; c++) {
        double own = count > MOST_CAMERAS ? worst_sigma(s, &s->now, c) : 0;
        int at = c;
        for (; at > 0 && sigma[at - 1] < own; at--) {
            sigma[at] = sigma[at - 1];
            out[at] = out[at - 1];
        }
        sigma[at] = own;
        out[at] = c;
    }
    return count < MOST_CAMERAS ? count : MOST_CAMERAS;
}

static void try_placement(search *s, td_placement *p)
{
    if (!td_placement_fit(p, &s->shape, &s->bundle->rig->camera[p->camera])) return;
    if (!add_placement(s, p)) return;
    s->placement[s->count] = *p;
    s->sigma[s->count++] = mean_sigma(s, &s->with);
}

static void try_all(search *s, int camera, const double distance_m[3])
{
    for (int place = 0; place < 9; place++)
        for (int distance = 0; distance < 3; distance++)
            for (int tilt = 0; tilt < 9; tilt++)
                for (int turned = 0; turned < 2; turned++) {
                    td_placement p = {.camera = camera,
                                      .across = place % 3 - 1,
                                      .down = place / 3 - 1,
                                      .distance = distance,
                                      .distance_m = distance_m[distance],
                                      .tilt = tilt ? (td_tilt)((tilt + 1) / 2) : TD_TILT_NONE,
                                      .tilt_deg = tilt ? (tilt % 2 ? 30 : 45) : 0,
                                      .turned = turned};
                    try_placement(s, &p);
                }
}

static int effort(const td_placement *p)
{
    return p->tilt_deg / 15 + (p->turned ? 1 : 0) + abs(p->across) + abs(p->down);
}

/* The best of those not yet passed over; a simpler one if it is as good. s->count: none is left. */
static size_t best_of(const search *s, const bool *passed, double sigma_now)
{
    size_t best = s->count;
    double least = INFINITY;
    for (size_t i = 0; i < s->count; i++)
        if (!passed[i] && s->sigma[i] < least) least = s->sigma[i];
    double as_good = isfinite(sigma_now) ? sigma_now - AS_GOOD * (sigma_now - least) : least * (2 - AS_GOOD);
    for (size_t i = 0; i < s->count; i++) {
        if (passed[i] || !(s->sigma[i] <= fmax(as_good, least))) continue;
        if (best == s->count || effort(&s->placement[i]) < effort(&s->placement[best])) best = i;
    }
    return best;
}

/* Number of the chosen placement; passes over as many different ones as the options say. */
static td_status choose(size_t *chosen, const search *s, double sigma_now, int skip, td_error *error)
{
    bool *passed = calloc(s->count + 1, sizeof *passed);
    if (!passed) return td_fail(error, TD_ERROR_MEMORY, "no memory for the search of a view");
    *chosen = best_of(s, passed, sigma_now);
    for (int k = 0; k < skip && *chosen < s->count; k++) {
        const td_placement *last = &s->placement[*chosen];
        for (size_t i = 0; i < s->count; i++) {
            const td_placement *p = &s->placement[i];
            passed[i] |= p->camera == last->camera && p->across == last->across && p->down == last->down &&
                         p->tilt == last->tilt;
        }
        *chosen = best_of(s, passed, sigma_now);
    }
    free(passed);
    if (*chosen < s->count) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   s->count
                       ? "next view: no other pose is left after passing over %d"
                       : "next view: the board fits into no image between the given distances (passed over: "
                         "%d); let it be held farther off",
                   skip);
}

static td_status search_run(search *s, td_next_view *view, const td_calibration *calibration,
                            const td_observations *observations, const td_next_view_options *options,
                            td_error *error)
{
    const td_rig *rig = s->bundle->rig;
    double nearest, farthest, middle;
    size_t chosen = 0, best = 0;
    int camera[TD_RIG_MAX_CAMERAS];
    if (!td_board_distances(&nearest, &farthest, &middle, calibration, observations))
        return td_fail(error, TD_ERROR_DATA, "next view: no view was used");
    fill_variances(s);
    fill_weight(s, options->distance_m > 0 ? options->distance_m : middle);
    int searched = searched_cameras(camera, s);
    for (int i = 0; i < searched; i++) {
        const td_camera *c = &rig->camera[camera[i]].camera;
        double near = options->nearest_m > 0 ? options->nearest_m
                                             : fmin(nearest, td_filling_distance(&s->shape, c, 0.75));
        double far = options->farthest_m > 0 ? options->farthest_m
                                             : fmax(farthest, td_filling_distance(&s->shape, c, 0.25));
        const double distance_m[3] = {near, sqrt(near * fmax(near, far)), fmax(near, far)};
        try_all(s, camera[i], distance_m);
    }
    double now = mean_sigma(s, &s->now);
    TD_TRY(choose(&best, s, now, 0, error));
    TD_TRY(choose(&chosen, s, now, options->skip, error));

    view->sigma_px = worst_sigma(s, &s->now, -1);
    bool gains = !isfinite(now) || s->sigma[best] <= now * (1 - options->gain_that_counts);
    view->enough = !gains || (options->enough_px > 0 && view->sigma_px <= options->enough_px);
    const td_placement *p = &s->placement[chosen];
    view->camera = p->camera;
    view->rig_from_target = p->rig_from_target;
    add_placement(s, p);
    view->predicted_px = worst_sigma(s, &s->with, -1);
    td_placement_outline(view->outline, &s->shape, &rig->camera[p->camera], &p->rig_from_target);
    td_placement_words(view->text, p, rig->count > 1 ? rig->camera[p->camera].name : NULL);
    return TD_OK;
}

td_status td_next_view_find(td_next_view *view, const td_calibration *calibration,
                            const td_observations *observations, const td_next_view_options *options,
                            td_error *error)
{
    td_next_view_options defaults = td_next_view_options_default();
    if (!options) options = &defaults;
    *view = (td_next_view){.rig_from_target = td_pose_identity()};
    TD_TRY(td_next_view_options_check(options, error));
    if (!calibration) return by_rule(view, observations, options, error);
    td_bundle_result result;
    search s;
    TD_TRY(td_bundle_result_new(&result, calibration, observations, error));
    td_status status = search_init(&s, &result.bundle, error);
    if (status == TD_OK) status = search_run(&s, view, calibration, observations, options, error);
    search_free(&s);
    td_bundle_result_free(&result);
    return status;
}
