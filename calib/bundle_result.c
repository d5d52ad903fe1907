/* A calibration taken up where it ended.
 *
 * The calibration holds what it solved for, the residuals and which points were used. The points as it
 * numbered them, with the bias of marks taken off, are the projections less the residuals. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/board_error_internal.h"
#include "calib/calibrate_internal.h"

static td_status check_same(const td_calibration *calibration, const td_observations *o, td_error *error)
{
    const td_rig *rig = calibration->rig;
    bool same = calibration->view_count == o->view_count && rig->count == o->camera_count;
    for (int c = 0; c < o->camera_count && same; c++)
        same = strcmp(rig->camera[c].name, o->camera[c].name) == 0 &&
               rig->camera[c].camera.model == o->camera[c].model;
    if (!same)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "observations: they are not those that were calibrated (%zu views of %d cameras, "
                       "calibrated were %zu of %d)",
                       o->view_count, o->camera_count, calibration->view_count, rig->count);
    return TD_OK;
}

/* Sigma of the seen point that lies nearest to `point`: the one that the calibration gave another number. */
static double sigma_of_nearest(const td_detection *from, const double point[2])
{
    double best = INFINITY, sigma = 0;
    for (size_t k = 0; k < from->count; k++) {
        double d = hypot(from->point[2 * k] - point[0], from->point[2 * k + 1] - point[1]);
        if (d < best) {
            best = d;
            sigma = from->sigma[k];
        }
    }
    return sigma;
}

/* `out` is numbered as the calibration was, and its points need no shift. */
static void take_detection(td_detection *out, const td_detection *from, const td_bundle *bundle,
                           const td_calibration *calibration, size_t view, int camera)
{
    bool renumbered = calibration->view[view].state == TD_VIEW_CORRECTED;
    out->found = from->found;
    for (size_t p = 0; p < out->count; p++) {
        const double *residual = calibration->residual + 2 * td_bundle_index(bundle, view, camera, p);
        double r[2];
        out->point[2 * p] = out->point[2 * p + 1] = 0;
        out->sigma[p] = 0;
        if (isnan(residual[0]) || !td_bundle_residual(r, bundle, view, camera, p)) continue;
        for (int i = 0; i < 2; i++) out->point[2 * p + i] = r[i] - residual[i];
        out->sigma[p] = renumbered ? sigma_of_nearest(from, out->point + 2 * p) : from->sigma[p];
    }
}

static td_status rebuild(td_bundle_result *result, const td_calibration *calibration,
                         const td_observations *from, td_error *error)
{
    TD_TRY(td_observations_new(&result->observations, &from->target, from->camera_count, from->view_count,
                               error));
    td_observations *o = result->observations;
    td_bundle *bundle = &result->bundle;
    memcpy(o->camera, from->camera, sizeof o->camera);
    memcpy(o->view_name, from->view_name, from->view_count * sizeof *o->view_name);
    memcpy(o->height_m, from->height_m, from->view_count * sizeof *o->height_m);
    TD_TRY(td_bundle_init(bundle, o, error));
    td_rig_free(&bundle->rig);
    bundle->rig = td_rig_copy(calibration->rig);
    if (!bundle->rig) return td_fail(error, TD_ERROR_MEMORY, "no memory for a rig");
    for (size_t v = 0; v < o->view_count; v++)
        bundle->rig_from_target[bundle->pose_of_view[v]] = calibration->view[v].rig_from_target;
    bundle->use_warp = calibration->has_warp;
    bundle->own_sigma = calibration->own_sigma;
    bundle->noise_share = calibration->board.noise_share;
    memcpy(bundle->warp, calibration->warp_m, sizeof bundle->warp);
    memcpy(bundle->hold, calibration->hold, sizeof bundle->hold);
    memcpy(bundle->used, calibration->used, td_bundle_index(bundle, o->view_count, 0, 0));
    for (int c = 0; c < o->camera_count; c++) bundle->noise[c] = calibration->camera[c].noise_px;
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < o->camera_count; c++) {
            td_detection *d = td_observations_get(o, v, c);
            memset(d->point, 0, 2 * d->count * sizeof *d->point);
            take_detection(d, td_observations_get(from, v, c), bundle, calibration, v, c);
        }
    return TD_OK;
}

static td_status find_boards(td_bundle_result *result, td_error *error)
{
    const td_bundle *bundle = &result->bundle;
    bool *seen = calloc(bundle->pose_count + 1, sizeof *seen);
    result->board = calloc(bundle->pose_count + 1, sizeof *result->board);
    if (!seen || !result->board) {
        free(seen);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", bundle->pose_count);
    }
    for (size_t v = 0; v < result->observations->view_count; v++)
        for (int c = 0; c < bundle->rig->count; c++)
            if (td_bundle_used(bundle, v, c)) seen[bundle->pose_of_view[v]] = true;
    for (size_t i = 0; i < bundle->pose_count; i++)
        if (seen[i]) result->board[result->board_count++] = result->problem.blocks.view[i];
    free(seen);
    return TD_OK;
}

td_status td_bundle_result_new(td_bundle_result *result, const td_calibration *calibration,
                               const td_observations *observations, td_error *error)
{
    *result = (td_bundle_result){0};
    TD_TRY(check_same(calibration, observations, error));
    double *store =
        calloc((size_t)2 * TD_RIG_MAX_CAMERAS * TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE, sizeof *store);
    if (!store) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    td_consider consider[2 * TD_RIG_MAX_CAMERAS];
    bool known;
    td_status status = rebuild(result, calibration, observations, error);
    if (status == TD_OK) status = td_bundle_problem_new(&result->problem, &result->bundle, NULL, error);
    if (status == TD_OK) status = find_boards(result, error);
    if (status == TD_OK) {
        size_t count = td_trust_considered(consider, store, &known, &result->bundle, &result->problem.blocks,
                                           calibration->rig);
        status = td_problem_covariance(&result->covariance, result->problem.problem, consider, count, error);
    }
    if (status == TD_OK)
        status = td_board_error_add(result->covariance, &calibration->board, &result->bundle,
                                    &result->problem.blocks, error);
    free(store);
    if (status != TD_OK) td_bundle_result_free(result);
    return status;
}

void td_bundle_result_free(td_bundle_result *result)
{
    td_covariance_free(&result->covariance);
    td_bundle_problem_free(&result->problem);
    td_bundle_free(&result->bundle);
    td_observations_free(&result->observations);
    free(result->board);
    *result = (td_bundle_result){0};
}
