#include "recon/localisation.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "recon/depth_points_internal.h"
#include "recon/fusion_internal.h"
#include "recon/localisation_internal.h"

enum { LEVELS = 3, SEARCHED = 600, LEAST_BLOCKS = 60, STARTS = 27 };

static const int RADIUS[LEVELS] = {8, 3, 0};              /* cells */
static const double UNEVENNESS[LEVELS] = {0.06, 0.02, 0}; /* m: of rough ground against its smoothed self */
static const double WORST_SCATTER = 6;                    /* times sigma: no map of this ground */

td_localisation_options td_localisation_options_default(void)
{
    return (td_localisation_options){.search_m = 1,
                                     .search_rad = 0.15,
                                     .correlation_px = 9,
                                     .map_sigma_m = 0.05,
                                     .most_sigma_m = 0.15,
                                     .most_sigma_rad = 0.03,
                                     .least_share = 0.3};
}

td_status td_localisation_options_check(const td_localisation_options *o, td_error *error)
{
    const struct {
        const char *name;
        double value, least, most;
    } number[] = {{"search_m", o->search_m, 0, 1e3},
                  {"search_rad", o->search_rad, 0, 3.2},
                  {"correlation_px", o->correlation_px, 1, 1000},
                  {"map_sigma_m", o->map_sigma_m, 1e-4, 100},
                  {"map_correlation_m", o->map_correlation_m, 0, 1e3},
                  {"most_sigma_m", o->most_sigma_m, 1e-4, 1e3},
                  {"most_sigma_rad", o->most_sigma_rad, 1e-5, 3.2},
                  {"least_share", o->least_share, 0, 1}};
    for (size_t i = 0; i < sizeof number / sizeof *number; i++)
        if (!(number[i].value >= number[i].least && number[i].value <= number[i].most))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: must be %g to %g, not %g", number[i].name,
                           number[i].least, number[i].most, number[i].value);
    return TD_OK;
}

/* ---- blocks ---- */

/* The mean pixel and the mean disparity of a block: on a plane they belong together, as a plane's disparity
 * is linear in the pixel. False: less than half of it is matched, or it holds an edge. */
static bool mean_of(td_block *block, const td_depth_camera *camera, const td_disparity *d, int side)
{
    double n = 0, x = 0, y = 0, sum = 0, variance = 0, low = INFINITY, high = -INFINITY;
    for (int v = block->row * side; v < (block->row + 1) * side && v < d->height; v++)
        for (int u = block->column * side; u < (block->column + 1) * side && u < d->width; u++) {
            const size_t i = (size_t)v * (size_t)d->width + (size_t)u;
            const double value = (double)d->value[i], sigma = (double)d->sigma[i];
            if (d->kind[i] != TD_DENSE_MATCHED || !(value > 0) || !(sigma > 0)) continue;
            n++, x += u, y += v, sum += value, variance += sigma * sigma;
            low = fmin(low, value), high = fmax(high, value);
        }
    if (2 * n < side * side || high - low > side) return false;
    const double disparity = sum / n, depth = camera->base_px_m / disparity;
    if (!(depth >= camera->near_m && depth <= camera->far_m)) return false;
    const double seen[3] = {(x / n - camera->cx) / camera->f * depth,
                            (y / n - camera->cy) / camera->f * depth, depth};
    const double sigma = sqrt(variance / n * td_mean_variance(n, side)) / disparity;
    double axis[3];
    for (int k = 0; k < 3; k++) axis[k] = seen[k] * sigma;
    td_pose_transform(block->p, &camera->rig_from_rectified, seen);
    td_pose_rotate(block->axis, &camera->rig_from_rectified, axis);
    return true;
}

static td_status make_blocks(td_block **blocks, size_t *count, const td_depth_camera *camera,
                             const td_disparity *d, double correlation_px, td_error *error)
{
    const int side = (int)ceil(correlation_px);
    const int columns = (d->width + side - 1) / side, rows = (d->height + side - 1) / side;
    *count = 0;
    *blocks = malloc(((size_t)columns * (size_t)rows + 1) * sizeof **blocks);
    if (!*blocks) return td_fail(error, TD_ERROR_MEMORY, "no memory for the points of a frame");
    for (int row = 0; row < rows; row++)
        for (int column = 0; column < columns; column++) {
            td_block *b = &(*blocks)[*count];
            *b = (td_block){.column = column, .row = row};
            *count += mean_of(b, camera, d, side);
        }
    return TD_OK;
}

/* ---- search ---- */

static td_pose beside(const td_pose *start, const td_localisation_options *o, int index)
{
    const double step[3] = {index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1};
    const double half = 0.5 * 0.6 * o->search_rad * step[2];
    const td_pose turn = {{cos(half), 0, 0, sin(half)}, {0, 0, 0}},
                  still = {{start->q[0], start->q[1], start->q[2], start->q[3]}, {0, 0, 0}};
    td_pose out = td_pose_compose(&turn, &still);
    for (int k = 0; k < 3; k++) out.t[k] = start->t[k] + (k < 2 ? 0.6 * o->search_m * step[k] : 0);
    return out;
}

/* From a smooth level to the map itself. */
static td_status descend(td_pose *pose, td_fit_state *state, td_registration *fit,
                         const td_ground_level *level, int from, int iterations, td_error *error)
{
    for (int k = from; k < LEVELS; k++) {
        fit->level = &level[k];
        fit->unevenness = UNEVENNESS[k];
        TD_TRY(td_register(pose, state, fit, iterations, error));
    }
    return TD_OK;
}

/* The best of the minima around the start, by a part of the blocks. What has changed on the ground may lead a
 * smoothed map astray: so every start is followed to the map itself, and from every level. */
static td_status search(td_pose *best, td_registration *fit, const td_ground_level *level,
                        const td_localisation_options *o, const td_pose *start, td_error *error)
{
    const int starts = o->search_m > 0 || o->search_rad > 0 ? STARTS : 1;
    double least = INFINITY;
    *best = *start;
    for (int i = 0; i < starts * LEVELS; i++) {
        td_pose pose = starts > 1 ? beside(start, o, i / LEVELS) : *start;
        td_fit_state state;
        TD_TRY(descend(&pose, &state, fit, level, i % LEVELS, 8, error));
        if (state.cost < least) {
            least = state.cost;
            *best = pose;
        }
    }
    return TD_OK;
}

static td_status fit_levels(td_localisation *found, td_fit_state *state, td_ground_level level[LEVELS],
                            const td_elevation *map, td_registration *fit, const td_pose *start,
                            const td_localisation_options *o, td_error *error)
{
    td_pose pose = *start;
    const double correlation = o->map_correlation_m > 0 ? o->map_correlation_m : 2 * map->cell_m;
    for (int k = 0; k < LEVELS; k++)
        TD_TRY(td_ground_level_new(&level[k], map, RADIUS[k], o->map_sigma_m, correlation, error));
    fit->step = 1 + fit->count / SEARCHED;
    TD_TRY(search(&pose, fit, level, o, start, error));
    fit->step = 1;
    fit->level = &level[LEVELS - 1];
    fit->unevenness = UNEVENNESS[LEVELS - 1];
    TD_TRY(td_register(&pose, state, fit, 40, error));
    found->site_from_rig = pose;
    found->scatter = state->scatter;
    found->rms_m = state->rms_m;
    found->points = state->used;
    found->share = (double)state->known / (double)fit->count;
    return TD_OK;
}

static td_status judge(const td_localisation *found, const td_fit_state *state, size_t blocks,
                       const td_localisation_options *o, td_error *error)
{
    if (found->share < o->least_share || state->known < LEAST_BLOCKS)
        return td_fail(
            error, TD_ERROR_DATA,
            "only %.0f %% of what the frame sees lies on the map (%.0f %% are needed): give a start "
            "nearer to the truth, or a map of this ground",
            100 * found->share, 100 * fmax(o->least_share, (double)LEAST_BLOCKS / (double)blocks));
    if (found->scatter > WORST_SCATTER || 2 * state->used < state->known)
        return td_fail(error, TD_ERROR_DATA,
                       "the frame's ground does not fit the map anywhere near the start: residuals are %.1f "
                       "times their sigma, and %.0f %% of the points agree",
                       found->scatter, 100 * (double)state->used / fmax((double)state->known, 1));
    return TD_OK;
}

static td_status refuse_weak(unsigned weak, const td_localisation_options *o, td_error *error)
{
    static const char *const name[6] = {"roll", "pitch", "the heading", "x", "y", "z"};
    static const int order[6] = {3, 4, 2, 5, 0, 1};
    char list[80] = "";
    for (int i = 0; i < 6; i++) {
        const size_t used = strlen(list);
        if (weak >> order[i] & 1)
            snprintf(list + used, sizeof list - used, "%s%s", used ? ", " : "", name[order[i]]);
    }
    return td_fail(
        error, TD_ERROR_DATA,
        "the ground seen does not tell %s (to %g m, %g rad): it is too flat there, or the same along "
        "one way; put tags on the site, or give the base's pose",
        list, o->most_sigma_m, o->most_sigma_rad);
}

td_status td_localise(td_localisation *found, const td_elevation *map, const td_depth_camera *camera,
                      const td_disparity *disparity, const td_pose *start,
                      const td_localisation_options *options, td_error *error)
{
    const td_localisation_options o = options ? *options : td_localisation_options_default();
    const td_camera *image = &camera->rectification.camera;
    td_registration fit = {0};
    td_ground_level level[LEVELS] = {0};
    td_fit_state state = {0};
    td_block *blocks = NULL;
    unsigned weak = 0;
    *found = (td_localisation){0};
    TD_TRY(td_localisation_options_check(&o, error));
    if (disparity->width != image->width || disparity->height != image->height)
        return td_fail(error, TD_ERROR_DATA,
                       "the disparities are of %d x %d px, the rectified camera of %d x %d", disparity->width,
                       disparity->height, image->width, image->height);
    td_status status = make_blocks(&blocks, &fit.count, camera, disparity, o.correlation_px, error);
    if (status == TD_OK && fit.count < LEAST_BLOCKS)
        status =
            td_fail(error, TD_ERROR_DATA, "the frame sees too little: %zu patches of %g px, %d are needed",
                    fit.count, o.correlation_px, LEAST_BLOCKS);
    fit.block = blocks;
    if (status == TD_OK) status = fit_levels(found, &state, level, map, &fit, start, &o, error);
    if (status == TD_OK) status = judge(found, &state, fit.count, &o, error);
    if (status == TD_OK) status = td_register_covariance(found, &weak, &fit, &o, error);
    if (status == TD_OK && weak) status = refuse_weak(weak, &o, error);
    for (int k = 0; k < LEVELS; k++) td_ground_level_free(&level[k]);
    free(blocks);
    return status;
}
