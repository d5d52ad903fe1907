/* How far to trust a calibration: covariance of everything, and the directions that the views leave open, in
 * words. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/board_error_internal.h"
#include "calib/calibrate_internal.h"
#include "core/linalg.h"

/* Above these relative (or absolute) sigmas a quantity counts as not determined. */
#define WEAK_FOCAL 0.02      /* of the focal length */
#define WEAK_CENTRE 0.02     /* of the image's width */
#define WEAK_BASELINE 0.02   /* of the baseline */
#define WEAK_ROTATION 0.0035 /* rad: 0.2 degrees */
/* Boards tilted less than this say nothing on the focal length. */
#define TILT_NEEDED_DEG 15.0

#define DEGREES 57.29577951308232

/* Row of the rig's covariance at which a block of the problem begins. */
typedef struct placed_block {
    int block, size;
    size_t row;
} placed_block;

static size_t place_blocks(placed_block *out, const td_bundle *bundle, const td_bundle_blocks *blocks)
{
    size_t n = 0;
    for (int c = 0; c < bundle->rig->count; c++) {
        int count = td_camera_parameter_count(bundle->rig->camera[c].camera.model);
        size_t row = td_rig_parameter_offset(bundle->rig, c);
        out[n++] = (placed_block){blocks->camera[c], count, row};
        if (c > 0) out[n++] = (placed_block){blocks->pose[c], 6, row + (size_t)count};
    }
    return n;
}

static td_status fill_rig_covariance(td_rig *rig, const td_covariance *covariance, const placed_block *placed,
                                     size_t count, td_error *error)
{
    size_t n = td_rig_parameter_count(rig);
    free(rig->covariance);
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    if (!rig->covariance)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu parameters", n);
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < count; k++) {
            double block[TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE];
            TD_TRY(td_covariance_get(block, covariance, placed[i].block, placed[k].block, error));
            for (int r = 0; r < placed[i].size; r++)
                memcpy(rig->covariance + (placed[i].row + (size_t)r) * n + placed[k].row,
                       block + r * placed[k].size, (size_t)placed[k].size * sizeof(double));
        }
    /* Products of matrices are symmetric only up to rounding. */
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < i; k++) {
            double mean = (rig->covariance[i * n + k] + rig->covariance[k * n + i]) / 2;
            rig->covariance[i * n + k] = rig->covariance[k * n + i] = mean;
        }
    return TD_OK;
}

/* What is held at a known rig's values brings that rig's covariance with it. The whole camera is considered
 * when all of its parameters are held; a rig without covariance leaves it unknown. */
size_t td_trust_considered(td_consider *out, double *store, bool *known, const td_bundle *bundle,
                           const td_bundle_blocks *blocks, const td_rig *from)
{
    size_t n = 0;
    *known = true;
    for (int c = 0; c < bundle->rig->count; c++) {
        unsigned hold = bundle->hold[c];
        int other = from ? td_rig_find(from, bundle->rig->camera[c].name) : -1;
        bool whole = (hold & TD_HOLD_INTRINSICS) && (hold & TD_HOLD_DISTORTION);
        if (!hold) continue;
        if (other < 0 || !from->covariance ||
            (!whole && (hold & (TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION)))) {
            *known = false;
            continue;
        }
        size_t width = td_rig_parameter_count(from), row = td_rig_parameter_offset(from, other);
        int count = td_camera_parameter_count(bundle->rig->camera[c].camera.model);
        if (whole) {
            double *s = store + n * TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE;
            for (int i = 0; i < count * count; i++)
                s[i] = from->covariance[(row + (size_t)(i / count)) * width + row + (size_t)(i % count)];
            out[n++] = (td_consider){blocks->camera[c], s};
        }
        if ((hold & TD_HOLD_POSE) && c > 0) {
            double *s = store + n * TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE;
            row += (size_t)count;
            for (int i = 0; i < 36; i++)
                s[i] = from->covariance[(row + (size_t)(i / 6)) * width + row + (size_t)(i % 6)];
            out[n++] = (td_consider){blocks->pose[c], s};
        }
    }
    return n;
}

static void camera_sigmas(td_calibration *result)
{
    const td_rig *rig = result->rig;
    size_t n = td_rig_parameter_count(rig);
    for (int c = 0; c < rig->count; c++) {
        size_t row = td_rig_parameter_offset(rig, c);
        int count = td_camera_parameter_count(rig->camera[c].camera.model);
        for (int i = 0; i < count; i++)
            result->camera[c].sigma[i] = sqrt(fmax(rig->covariance[(row + (size_t)i) * (n + 1)], 0));
    }
}

/* t <- t + tau + omega x t: the length changes by tau along t only. */
static void pair_sigmas(td_calibration *result)
{
    const td_rig *rig = result->rig;
    size_t n = td_rig_parameter_count(rig);
    for (size_t k = 0; k < result->pair_count; k++) {
        td_calibrated_pair *p = &result->pair[k];
        if (p->first != 0) continue;
        const td_camera *c = &rig->camera[p->second].camera;
        size_t row = td_rig_parameter_offset(rig, p->second) + (size_t)td_camera_parameter_count(c->model);
        const double *t = p->second_from_first.t;
        double variance = 0;
        for (size_t i = 0; i < 3; i++) {
            p->sigma_rotation_rad[i] = sqrt(fmax(rig->covariance[(row + i) * (n + 1)], 0));
            for (size_t j = 0; j < 3; j++)
                variance += t[i] * t[j] * rig->covariance[(row + 3 + i) * n + row + 3 + j] /
                            (p->baseline_m * p->baseline_m);
        }
        p->sigma_baseline_m = p->baseline_m > 0 ? sqrt(fmax(variance, 0)) : NAN;
    }
}

static TD_PRINTF(3, 4) void add_weak(td_calibration *result, double severity, const char *format, ...)
{
    if (result->weak_count == TD_MAX_WEAK) return;
    td_weak_direction *w = &result->weak[result->weak_count++];
    w->severity = severity;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(w->text, sizeof w->text, format, arguments);
    va_end(arguments);
}

/* Largest angle, deg, between the board's normal and a camera's axis over its used views; NaN: none. */
static double largest_tilt(const td_bundle *bundle, int camera)
{
    double largest = NAN;
    for (size_t v = 0; v < bundle->observations->view_count; v++) {
        if (!td_bundle_used(bundle, v, camera)) continue;
        const double normal[3] = {0, 0, 1};
        double n[3];
        td_pose_rotate(n, &bundle->rig_from_target[bundle->pose_of_view[v]], normal);
        td_pose_rotate(n, &bundle->rig->camera[camera].camera_from_rig, n);
        largest = fmax(isnan(largest) ? 0 : largest, acos(fmin(fabs(n[2]), 1)) * DEGREES);
    }
    return largest;
}

static void weak_camera(td_calibration *result, const td_bundle *bundle, int c)
{
    const td_rig_camera *camera = &bundle->rig->camera[c];
    const double *p = camera->camera.parameter, *s = result->camera[c].sigma;
    if (bundle->hold[c] & TD_HOLD_INTRINSICS) return;
    bool flat = td_target_is_flat(&bundle->observations->target);
    bool rail = false;
    for (size_t v = 0; v < bundle->observations->view_count; v++)
        rail |= !isnan(bundle->observations->height_m[v]);
    double focal = fmax(s[0] / p[0], s[1] / p[1]), tilt = largest_tilt(bundle, c);
    double centre = fmax(s[2], s[3]) / camera->camera.width;
    if (flat && !rail && tilt < TILT_NEEDED_DEG)
        add_weak(result, fmax(2, focal / WEAK_FOCAL),
                 "%s: all views are nearly parallel to the image (tilt at most %.0f degrees), so focal "
                 "length and distance "
                 "cannot be told apart; tilt the board by 30 to 45 degrees, to all four sides",
                 camera->name, tilt);
    else if (!(focal < WEAK_FOCAL))
        add_weak(result, focal / WEAK_FOCAL,
                 "%s: the focal length is known to %.1f %% only, it can hardly be told from the distance; "
                 "add views with "
                 "the board tilted by 30 to 45 degrees, and nearer ones",
                 camera->name, 100 * focal);
    if (!(centre < WEAK_CENTRE) && !(flat && tilt < TILT_NEEDED_DEG))
        add_weak(result, centre / WEAK_CENTRE,
                 "%s: the principal point is known to %.1f px only, it can hardly be told from a turn of the "
                 "camera; turn "
                 "the board by a quarter about its normal between views, and tilt it both ways",
                 camera->name, centre * camera->camera.width);
}

static void weak_pairs(td_calibration *result)
{
    for (size_t k = 0; k < result->pair_count; k++) {
        const td_calibrated_pair *p = &result->pair[k];
        const char *a = result->rig->camera[p->first].name, *b = result->rig->camera[p->second].name;
        if (!(p->sigma_baseline_m < WEAK_BASELINE * p->baseline_m))
            add_weak(result, p->sigma_baseline_m / p->baseline_m / WEAK_BASELINE,
                     "%s and %s: the baseline is known to %.1f %% only; add views in which both see the "
                     "board, near by and "
                     "tilted",
                     a, b, 100 * p->sigma_baseline_m / p->baseline_m);
        double worst =
            fmax(fmax(p->sigma_rotation_rad[0], p->sigma_rotation_rad[1]), p->sigma_rotation_rad[2]);
        if (!(worst < WEAK_ROTATION))
            add_weak(result, worst / WEAK_ROTATION,
                     "%s and %s: their relative rotation is known to %.2f degrees only; add views that fill "
                     "both images",
                     a, b, worst * DEGREES);
    }
}

static td_status view_sigmas(td_calibration *result, const td_bundle *bundle, const td_covariance *covariance,
                             const td_bundle_blocks *blocks, td_error *error)
{
    for (size_t v = 0; v < result->view_count; v++) {
        int block = blocks->view[bundle->pose_of_view[v]];
        double s[36];
        bool used = false;
        for (int c = 0; c < bundle->rig->count; c++) used |= td_bundle_used(bundle, v, c) > 0;
        if (used) TD_TRY(td_covariance_get(s, covariance, block, block, error));
        for (int i = 0; i < 6; i++) result->view[v].sigma[i] = used ? sqrt(fmax(s[7 * i], 0)) : NAN;
    }
    return TD_OK;
}

td_status td_trust_covariance(td_calibration *result, td_bundle *bundle, const td_calibrate_options *options,
                              td_error *error)
{
    td_bundle_problem bp;
    placed_block placed[2 * TD_RIG_MAX_CAMERAS];
    td_consider consider[2 * TD_RIG_MAX_CAMERAS];
    double *store =
        calloc((size_t)2 * TD_RIG_MAX_CAMERAS * TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE, sizeof *store);
    if (!store) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    td_covariance *covariance = NULL;
    td_status status = TD_OK;
    result->board = (td_board_error){.noise_share = 1};
    if (!options->plain) status = td_board_error_estimate(&result->board, bundle, error);
    bundle->noise_share = result->board.noise_share;
    if (status == TD_OK) status = td_bundle_problem_new(&bp, bundle, NULL, error);
    if (status != TD_OK) {
        free(store);
        return status;
    }
    size_t considered =
        td_trust_considered(consider, store, &result->covariance_known, bundle, &bp.blocks, options->known);
    status = td_problem_covariance(&covariance, bp.problem, consider, considered, error);
    if (status == TD_OK) {
        size_t count = place_blocks(placed, bundle, &bp.blocks);
        double dof =
            (double)td_covariance_rows(covariance) - (double)td_covariance_free_parameters(covariance);
        result->chi2_per_dof = dof > 0 ? td_covariance_chi2(covariance) * bundle->noise_share / dof : NAN;
        status = td_board_error_add(covariance, &result->board, bundle, &bp.blocks, error);
        if (status == TD_OK) status = fill_rig_covariance(result->rig, covariance, placed, count, error);
        if (status == TD_OK) {
            camera_sigmas(result);
            pair_sigmas(result);
            status = view_sigmas(result, bundle, covariance, &bp.blocks, error);
        }
        if (status == TD_OK && bundle->use_warp) {
            double s[4];
            status = td_covariance_get(s, covariance, bp.blocks.warp, bp.blocks.warp, error);
            result->sigma_warp_m[0] = sqrt(fmax(s[0], 0));
            result->sigma_warp_m[1] = sqrt(fmax(s[3], 0));
        }
        if (status == TD_OK && td_covariance_null_count(covariance))
            add_weak(result, INFINITY,
                     "%zu combination%s of the cameras' parameters cannot be found from these views at all; "
                     "add views of "
                     "other tilts and distances, or hold parameters (--fix)",
                     td_covariance_null_count(covariance),
                     td_covariance_null_count(covariance) > 1 ? "s" : "");
    }
    for (int c = 0; c < bundle->rig->count && status == TD_OK; c++) weak_camera(result, bundle, c);
    if (status == TD_OK) weak_pairs(result);
    if (status == TD_OK && !result->covariance_known) {
        free(result->rig->covariance);
        result->rig->covariance = NULL;
    }
    td_covariance_free(&covariance);
    td_bundle_problem_free(&bp);
    free(store);
    return status;
}

td_status td_trust_warp(double *chi2, td_bundle *bundle, td_error *error)
{
    td_bundle_problem bp;
    td_covariance *covariance = NULL;
    double s[4];
    TD_TRY(td_bundle_problem_new(&bp, bundle, NULL, error));
    td_status status = td_problem_covariance(&covariance, bp.problem, NULL, 0, error);
    if (status == TD_OK) status = td_covariance_get(s, covariance, bp.blocks.warp, bp.blocks.warp, error);
    if (status == TD_OK) {
        const double *w = bundle->warp;
        double det = s[0] * s[3] - s[1] * s[2];
        *chi2 = det > 0 ? (w[0] * w[0] * s[3] - 2 * w[0] * w[1] * s[1] + w[1] * w[1] * s[0]) / det : 0;
    }
    td_covariance_free(&covariance);
    td_bundle_problem_free(&bp);
    return status;
}
