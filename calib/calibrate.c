#include "calib/calibrate.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/calibrate_internal.h"
#include "core/stereo.h"

/* Chi-square with 2 degrees of freedom is larger than this once in a thousand times. */
#define WARP_SIGNIFICANT 13.8
/* px; what is smaller is rounding, not noise. */
#define LEAST_NOISE 1e-4
enum { FEWEST_VIEWS = 3, MOST_ROUNDS = 6 };

td_calibrate_options td_calibrate_options_default(void)
{
    return (td_calibrate_options){.outlier_sigma = 5, .outlier_view = 3, .leave_one_out = true};
}

td_status td_calibrate_options_check(const td_calibrate_options *options, const td_observations *observations,
                                     td_error *error)
{
    if (options->method >= TD_ESTIMATE_COUNT)
        return td_fail(error, TD_ERROR_ARGUMENT, "method: there is no such method");
    if (!(options->outlier_sigma >= 2))
        return td_fail(error, TD_ERROR_ARGUMENT, "outlier_sigma: %g is too small, at least 2",
                       options->outlier_sigma);
    if (!(options->outlier_view > 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "outlier_view: %g must be > 1", options->outlier_view);
    for (int c = 0; observations && c < observations->camera_count; c++) {
        if (!options->hold[c]) continue;
        const char *name = observations->camera[c].name;
        int k = options->known ? td_rig_find(options->known, name) : -1;
        if (k < 0)
            return td_fail(error, TD_ERROR_ARGUMENT, "hold: the given rig has no camera '%s' to hold", name);
        const td_camera *camera = &options->known->camera[k].camera;
        if ((options->hold[c] & (TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION)) &&
            camera->model != observations->camera[c].model)
            return td_fail(
                error, TD_ERROR_ARGUMENT, "hold: camera '%s' is %s in the rig and %s in the dataset", name,
                td_camera_model_name(camera->model), td_camera_model_name(observations->camera[c].model));
    }
    return TD_OK;
}

void td_calibration_free(td_calibration **calibration)
{
    if (!calibration || !*calibration) return;
    td_rig_free(&(*calibration)->rig);
    free((*calibration)->view);
    free((*calibration)->residual);
    free((*calibration)->used);
    free(*calibration);
    *calibration = NULL;
}

/* A private copy, since the numbering of views may be put right. */
static td_status copy_observations(td_observations **copy, const td_observations *from, td_error *error)
{
    TD_TRY(td_observations_new(copy, &from->target, from->camera_count, from->view_count, error));
    td_observations *o = *copy;
    memcpy(o->camera, from->camera, sizeof o->camera);
    memcpy(o->view_name, from->view_name, from->view_count * sizeof *o->view_name);
    memcpy(o->height_m, from->height_m, from->view_count * sizeof *o->height_m);
    for (size_t i = 0; i < from->view_count * (size_t)from->camera_count; i++) {
        td_detection *d = &o->detection[i];
        const td_detection *s = &from->detection[i];
        memcpy(d->point, s->point, 2 * d->count * sizeof *d->point);
        memcpy(d->sigma, s->sigma, d->count * sizeof *d->sigma);
        d->found = s->found;
        d->blur_px = s->blur_px;
    }
    return TD_OK;
}

static td_status check_views(const td_observations *o, td_error *error)
{
    for (int c = 0; c < o->camera_count; c++) {
        size_t seen = 0, images = 0;
        bool rail = false;
        const char *reason = NULL;
        for (size_t v = 0; v < o->view_count; v++) {
            const td_detection *d = td_observations_get(o, v, c);
            images += d->found || d->reason[0];
            seen += d->found;
            if (d->found && !isnan(o->height_m[v])) rail = true;
            if (!d->found && d->reason[0] && !reason) reason = d->reason;
        }
        if (seen >= FEWEST_VIEWS || (rail && seen >= 2) || (seen && !td_target_is_flat(&o->target))) continue;
        return td_fail(error, TD_ERROR_DATA,
                       "camera %s: the target was found in %zu of %zu images, at least %d are needed%s%s",
                       o->camera[c].name, seen, images, FEWEST_VIEWS,
                       reason ? "; the first without it: " : "", reason ? reason : "");
    }
    return TD_OK;
}

/* Values of what is held come from the known rig. */
static void take_known(td_bundle *bundle, const td_calibrate_options *options)
{
    for (int c = 0; c < bundle->rig->count; c++) {
        td_rig_camera *camera = &bundle->rig->camera[c];
        int k = options->known ? td_rig_find(options->known, camera->name) : -1;
        bundle->hold[c] = options->hold[c];
        if (k < 0) continue;
        const td_rig_camera *known = &options->known->camera[k];
        int count = td_camera_parameter_count(camera->camera.model);
        for (int i = 0; i < count; i++)
            if (options->hold[c] & (i < 4 ? TD_HOLD_INTRINSICS : TD_HOLD_DISTORTION))
                camera->camera.parameter[i] = known->camera.parameter[i];
        if (options->hold[c] & TD_HOLD_POSE) {
            int base = td_rig_find(options->known, bundle->rig->camera[0].name);
            td_pose rig_from_base = td_pose_identity();
            if (base >= 0) rig_from_base = td_pose_inverse(&options->known->camera[base].camera_from_rig);
            camera->camera_from_rig = td_pose_compose(&known->camera_from_rig, &rig_from_base);
        }
    }
}

/* The noise common to a camera's points, so that weighted squares add up to their degrees of freedom: the
 * root of sum r^2 / (sigma_i^2 + n^2) = dof in n, found by bisection; 0 when the points' own sigmas explain
 * everything (but at least LEAST_NOISE). */
static double common_noise(const td_bundle *bundle, int camera, double parameters_per_row)
{
    size_t views = bundle->observations->view_count,
           points = td_target_point_count(&bundle->observations->target);
    size_t n = 0;
    double *r2 = malloc((2 * views * points + 1) * sizeof *r2), r[2], low = 0, high = 0;
    if (!r2) return bundle->noise[camera];
    double *s2 = r2 + views * points;
    for (size_t v = 0; v < views; v++)
        for (size_t p = 0; p < points; p++) {
            if (!bundle->used[td_bundle_index(bundle, v, camera, p)]) continue;
            if (!td_bundle_residual(r, bundle, v, camera, p)) continue;
            double s = bundle->own_sigma ? td_observations_get(bundle->observations, v, camera)->sigma[p] : 0;
            r2[n] = r[0] * r[0] + r[1] * r[1];
            s2[n] = s * s;
            high += r2[n++];
        }
    double dof = 2 * (double)n * (1 - parameters_per_row);
    for (int i = 0; i < 60 && n; i++) {
        double middle = (low + high) / 2, sum = 0;
        for (size_t k = 0; k < n; k++) sum += r2[k] / (s2[k] + middle);
        *(sum > dof ? &low : &high) = middle;
    }
    free(r2);
    return fmax(sqrt(high), LEAST_NOISE);
}

static size_t parameter_count(const td_bundle *bundle)
{
    size_t n = 0;
    for (int c = 0; c < bundle->rig->count; c++) {
        unsigned hold = bundle->hold[c];
        size_t count = (size_t)td_camera_parameter_count(bundle->rig->camera[c].camera.model);
        n += (hold & TD_HOLD_INTRINSICS ? 0 : 4) + (hold & TD_HOLD_DISTORTION ? 0 : count - 4);
        n += c > 0 && !(hold & TD_HOLD_POSE) ? 6 : 0;
    }
    bool *seen = calloc(bundle->pose_count + 1, sizeof *seen);
    for (size_t v = 0; v < bundle->observations->view_count && seen; v++)
        for (int c = 0; c < bundle->rig->count; c++)
            if (td_bundle_used(bundle, v, c) && !seen[bundle->pose_of_view[v]]) {
                seen[bundle->pose_of_view[v]] = true;
                n += 6;
            }
    free(seen);
    return n + (bundle->use_warp ? 2 : 0);
}

static void estimate_noise(td_bundle *bundle)
{
    size_t points;
    td_bundle_square_sum(bundle, -1, &points);
    double share = points ? (double)parameter_count(bundle) / (2 * (double)points) : 0;
    for (int c = 0; c < bundle->rig->count; c++) bundle->noise[c] = common_noise(bundle, c, fmin(share, 0.9));
}

/* Where the image of each mark's disc has its centroid, beside the image of its centre; from the present
 * estimate. */
static td_status update_shift(td_bundle *bundle, td_error *error)
{
    const td_observations *o = bundle->observations;
    size_t points = td_target_point_count(&o->target);
    size_t slots = td_bundle_index(bundle, o->view_count, 0, 0);
    if (!bundle->shift) bundle->shift = malloc((2 * slots + 1) * sizeof *bundle->shift);
    if (!bundle->shift) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", slots);
    memset(bundle->shift, 0, 2 * slots * sizeof *bundle->shift);
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < bundle->rig->count; c++) {
            const td_rig_camera *camera = &bundle->rig->camera[c];
            td_pose camera_from_target =
                td_pose_compose(&camera->camera_from_rig, &bundle->rig_from_target[bundle->pose_of_view[v]]);
            for (size_t p = 0; p < points; p++) {
                size_t index = td_bundle_index(bundle, v, c, p), first;
                if (!bundle->used[index]) continue;
                double centre[3], bias[2], normal[3];
                const double z[3] = {0, 0, 1};
                td_bundle_target_point(centre, bundle, v, p);
                td_pose_rotate(
                    normal, &o->target.plane[td_target_plane_of(&o->target, p, &first)].target_from_plane, z);
                if (td_mark_bias(bias, &camera->camera, &camera_from_target, centre, normal,
                                 o->target.diameter_m))
                    memcpy(bundle->shift + 2 * index, bias, sizeof bias);
            }
        }
    return TD_OK;
}

/* A solve, with the marks' shift, which depends slowly on the solution, brought up to date around it. What a
 * later solve starts from need not be `precise`. */
static td_status solve(td_bundle *bundle, const td_loss *loss, bool precise, td_calibration *result,
                       const td_calibrate_options *options, td_error *error)
{
    td_solve_summary summary;
    td_solve_options solve_options = td_solve_options_default();
    solve_options.log = options->log;
    solve_options.progress = options->progress;
    solve_options.function_tolerance = precise ? 1e-12 : 1e-6;
    bool marks = bundle->observations->target.kind == TD_TARGET_MARKS;
    for (int round = 0; round < (marks ? 3 : 1); round++) {
        if (marks) TD_TRY(update_shift(bundle, error));
        TD_TRY(td_bundle_solve(bundle, loss, &summary, &solve_options, error));
        result->iterations += summary.iterations;
    }
    if (!summary.converged)
        td_log_write(options->log, TD_LOG_WARNING, "calibrate", "the refinement stopped early: %s",
                     summary.message);
    return TD_OK;
}

/* Robust pass, then weighted least squares on what is left, until no more outliers turn up. */
static td_status solve_robustly(td_bundle *bundle, td_calibration *result,
                                const td_calibrate_options *options, td_error *error)
{
    for (int c = 0; c < bundle->rig->count; c++)
        bundle->noise[c] = fmax(td_robust_noise(bundle, c), LEAST_NOISE);
    const td_loss loss = {TD_LOSS_CAUCHY, 2.5, 2};
    TD_TRY(solve(bundle, &loss, false, result, options, error));
    bundle->own_sigma = true;
    bool changed = true;
    for (int round = 0; round < MOST_ROUNDS && changed; round++) {
        TD_TRY(td_outliers_mark(&changed, bundle, result, options, error));
        if (round && !changed) break;
        estimate_noise(bundle);
        TD_TRY(solve(bundle, NULL, true, result, options, error));
        changed = true;
    }
    return TD_OK;
}

static bool warp_possible(const td_bundle *bundle)
{
    const td_observations *o = bundle->observations;
    size_t views = 0;
    for (size_t v = 0; v < o->view_count; v++) {
        bool used = false;
        for (int c = 0; c < bundle->rig->count; c++) used |= td_bundle_used(bundle, v, c) > 0;
        views += used;
        if (!isnan(o->height_m[v])) return false;
    }
    return o->target.plane_count == 1 && views >= 4;
}

/* Adds the warp and, on AUTO, goes back to where it was when the warp is not significant. */
static td_status choose_warp(td_bundle *bundle, td_calibration *result, const td_calibrate_options *options,
                             td_error *error)
{
    if (options->warp == TD_WARP_OFF || !warp_possible(bundle)) return TD_OK;
    td_bundle flat;
    double chi2 = INFINITY;
    TD_TRY(td_bundle_copy(&flat, bundle, error));
    bundle->use_warp = true;
    td_status status = solve(bundle, NULL, true, result, options, error);
    if (status == TD_OK) {
        estimate_noise(bundle);
        status = solve(bundle, NULL, true, result, options, error);
    }
    if (status == TD_OK && options->warp == TD_WARP_AUTO) status = td_trust_warp(&chi2, bundle, error);
    if (chi2 < WARP_SIGNIFICANT) {
        td_bundle kept = *bundle;
        *bundle = flat;
        flat = kept;
    }
    td_bundle_free(&flat);
    return status;
}

static void fill_cameras(td_calibration *result, const td_bundle *bundle)
{
    const td_observations *o = bundle->observations;
    size_t points = td_target_point_count(&o->target), total;
    result->rms_px = sqrt(td_bundle_square_sum(bundle, -1, &total) / (double)(total ? total : 1));
    for (int c = 0; c < bundle->rig->count; c++) {
        td_calibrated_camera *camera = &result->camera[c];
        double sum = td_bundle_square_sum(bundle, c, &camera->points);
        camera->rms_px = camera->points ? sqrt(sum / (double)camera->points) : NAN;
        camera->noise_px = bundle->noise[c];
        for (size_t v = 0; v < o->view_count; v++) {
            const td_detection *d = td_observations_get(o, v, c);
            td_calibrated_view *view = &result->view[v];
            double square = 0;
            view->rms_px[c] = NAN;
            camera->views += td_bundle_used(bundle, v, c) > 0;
            for (size_t p = 0; p < points; p++) {
                size_t index = td_bundle_index(bundle, v, c, p);
                double r[2] = {NAN, NAN};
                if (d->found && isfinite(d->point[2 * p]) && td_bundle_residual(r, bundle, v, c, p)) {
                    square += r[0] * r[0] + r[1] * r[1];
                    view->points[c]++;
                    view->outliers[c] += !bundle->used[index];
                }
                memcpy(result->residual + 2 * index, r, sizeof r);
                result->used[index] = bundle->used[index];
            }
            if (view->points[c]) view->rms_px[c] = sqrt(square / (double)view->points[c]);
            camera->outlier_points += view->outliers[c];
        }
    }
}

static void fill_pair(td_calibrated_pair *pair, const td_bundle *bundle, int second)
{
    const td_observations *o = bundle->observations;
    const td_rig_camera *a = &bundle->rig->camera[0], *b = &bundle->rig->camera[second];
    size_t points = td_target_point_count(&o->target), n = 0, na, nb;
    double sum = td_bundle_square_sum(bundle, 0, &na) + td_bundle_square_sum(bundle, second, &nb),
           epipolar = 0;
    *pair = (td_calibrated_pair){.second = second, .second_from_first = b->camera_from_rig};
    pair->rms_px = na + nb ? sqrt(sum / (double)(na + nb)) : NAN;
    pair->baseline_m = td_pose_distance(&pair->second_from_first);
    pair->rotation_rad = td_pose_angle(&pair->second_from_first);
    td_essential_matrix(pair->essential, &pair->second_from_first);
    td_fundamental_matrix(pair->fundamental, &a->camera, &b->camera, &pair->second_from_first);
    for (size_t v = 0; v < o->view_count; v++) {
        bool both = false;
        for (size_t p = 0; p < points; p++) {
            if (!bundle->used[td_bundle_index(bundle, v, 0, p)] ||
                !bundle->used[td_bundle_index(bundle, v, second, p)])
                continue;
            double x[2], y[2], d[2];
            both = true;
            if (!td_undistort_pixel(x, &a->camera, td_observations_get(o, v, 0)->point + 2 * p) ||
                !td_undistort_pixel(y, &b->camera, td_observations_get(o, v, second)->point + 2 * p))
                continue;
            td_epipolar_distances(d, pair->fundamental, x, y);
            epipolar += d[0] + d[1];
            n++;
        }
        pair->pairs += both;
    }
    pair->epipolar_error_px = n ? epipolar / (double)n : NAN;
}

static td_status fill_result(td_calibration *result, td_bundle *bundle, const td_calibrate_options *options,
                             td_error *error)
{
    for (size_t v = 0; v < result->view_count; v++) {
        td_calibrated_view *view = &result->view[v];
        bool used = false;
        for (int c = 0; c < bundle->rig->count; c++) used |= td_bundle_used(bundle, v, c) > 0;
        if (used && view->state == TD_VIEW_UNSEEN) view->state = TD_VIEW_USED;
        view->rig_from_target = bundle->rig_from_target[bundle->pose_of_view[v]];
    }
    fill_cameras(result, bundle);
    for (int c = 1; c < bundle->rig->count; c++) fill_pair(&result->pair[result->pair_count++], bundle, c);
    result->has_warp = bundle->use_warp;
    result->own_sigma = bundle->own_sigma;
    memcpy(result->hold, bundle->hold, sizeof result->hold);
    memcpy(result->warp_m, bundle->warp, sizeof result->warp_m);

    td_rig_free(&result->rig);
    result->rig = td_rig_copy(bundle->rig);
    if (!result->rig) return td_fail(error, TD_ERROR_MEMORY, "no memory for the rig");
    return td_trust_covariance(result, bundle, options, error);
}

static td_status run(td_calibration *result, td_bundle *bundle, td_observations *observations,
                     const td_calibrate_options *options, td_error *error)
{
    take_known(bundle, options);
    TD_TRY(td_rig_start(bundle, observations, result, options, error));
    if (options->plain) {
        TD_TRY(solve(bundle, NULL, true, result, options, error));
        /* One noise for all points leaves the solution as it is and gives the covariance its scale. */
        size_t points;
        double sum = td_bundle_square_sum(bundle, -1, &points);
        double dof = 2 * (double)points - (double)parameter_count(bundle);
        for (int c = 0; c < bundle->rig->count; c++) bundle->noise[c] = dof > 0 ? sqrt(sum / dof) : 1;
    } else {
        TD_TRY(solve_robustly(bundle, result, options, error));
        TD_TRY(choose_warp(bundle, result, options, error));
    }
    for (int c = 0; c < bundle->rig->count; c++) {
        td_status status = td_camera_check(&bundle->rig->camera[c].camera, error);
        if (status != TD_OK)
            return td_error_prefix(error, TD_ERROR_DATA, "camera %s: the views do not determine it",
                                   bundle->rig->camera[c].name);
    }
    if (options->leave_one_out) TD_TRY(td_leave_one_out_run(&result->leave_one_out, bundle, options, error));
    return fill_result(result, bundle, options, error);
}

td_status td_calibrate(td_calibration **calibration, const td_observations *observations,
                       const td_calibrate_options *options, td_error *error)
{
    td_calibrate_options defaults = td_calibrate_options_default();
    if (!options) options = &defaults;
    *calibration = NULL;
    TD_TRY(td_calibrate_options_check(options, observations, error));
    TD_TRY(check_views(observations, error));

    size_t slots = observations->view_count * (size_t)observations->camera_count *
                   td_target_point_count(&observations->target);
    td_calibration *result = calloc(1, sizeof *result);
    td_observations *own = NULL;
    td_bundle bundle = {0};
    td_status status = TD_OK;
    if (result) {
        result->view_count = observations->view_count;
        result->view = calloc(observations->view_count + 1, sizeof *result->view);
        result->residual = malloc((2 * slots + 1) * sizeof *result->residual);
        result->used = calloc(slots + 1, 1);
        result->method = options->method;
    }
    if (!result || !result->view || !result->residual || !result->used)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", observations->view_count);
    if (status == TD_OK) status = copy_observations(&own, observations, error);
    if (status == TD_OK) status = td_bundle_init(&bundle, own, error);
    if (status == TD_OK) status = run(result, &bundle, own, options, error);
    td_bundle_free(&bundle);
    td_observations_free(&own);
    if (status == TD_OK)
        *calibration = result;
    else
        td_calibration_free(&result);
    return status;
}
