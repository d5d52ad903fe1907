#include "calib/drift.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/board_error_internal.h"
#include "calib/drift_internal.h"
#include "calib/significance_internal.h"

#define DEGREES 57.29577951308232
enum { MOST_TOGETHER = TD_CAMERA_MAX_PARAMETERS };

td_drift_options td_drift_options_default(void)
{
    return (td_drift_options){.p_limit = 1e-3};
}

/* ---- what may have moved ---- */

typedef enum cause_kind { TURNED, MOVED, FOCAL, CENTRE, DISTORTION } cause_kind;

/* One way in which a rig changes: directions in its parameters. */
typedef struct cause {
    cause_kind kind;
    int camera, axis;
    size_t count;
    double *direction;                                           /* (count,n) */
    double chi2, amplitude[MOST_TOGETHER], sigma[MOST_TOGETHER]; /* as seen */
} cause;

/* When camera c turns or shifts by xi (its own frame), camera_from_rig becomes Exp(xi) camera_from_rig. When
 * the first does, which carries the rig's frame, all others become camera_from_rig Exp(-xi) = Exp(-Ad xi)
 * camera_from_rig. */
static void motion(double *direction, const td_rig *rig, int camera, int component)
{
    for (int c = 1; c < rig->count; c++) {
        size_t pose =
            td_rig_parameter_offset(rig, c) + (size_t)td_camera_parameter_count(rig->camera[c].camera.model);
        double ad[36];
        td_pose_adjoint(ad, &rig->camera[c].camera_from_rig);
        for (int k = 0; k < 6 && camera == 0; k++) direction[pose + (size_t)k] = -ad[6 * k + component];
        if (c == camera) direction[pose + (size_t)component] = 1;
    }
}

static void lens(cause *f, const td_rig *rig, size_t n)
{
    const td_camera *camera = &rig->camera[f->camera].camera;
    size_t first = td_rig_parameter_offset(rig, f->camera);
    if (f->kind == FOCAL)
        for (size_t k = 0; k < 2; k++) f->direction[first + k] = camera->parameter[k];
    if (f->kind == CENTRE) f->direction[first + 2 + (size_t)f->axis] = 1;
    if (f->kind == DISTORTION)
        for (size_t k = 0; k < f->count; k++) f->direction[k * n + first + 4 + k] = 1;
}

/* Explains as much as it can; Akaike's measure, chi2 less twice the parameters, decides between causes. */
static void weigh(cause *best, cause *f, const td_rig *rig, const td_gradient_test *test)
{
    memset(f->direction, 0, f->count * test->n * sizeof *f->direction);
    if (f->kind == TURNED || f->kind == MOVED)
        motion(f->direction, rig, f->camera, f->axis + (f->kind == MOVED ? 3 : 0));
    else
        lens(f, rig, test->n);
    size_t seen = td_gradient_test_explain(&f->chi2, f->amplitude, f->sigma, test, f->direction, f->count);
    if (!seen || !(f->chi2 - 2.0 * (double)f->count > best->chi2 - 2.0 * (double)best->count)) return;
    double *kept = best->direction;
    *best = *f;
    f->direction = kept;
}

/* The one change that explains most. Of two cameras, a shift of the first is a shift of the second. */
static td_status find_cause(cause *best, const td_rig *rig, const td_gradient_test *test, td_error *error)
{
    double *direction = calloc(2 * MOST_TOGETHER * test->n, sizeof *direction);
    cause f = {.direction = direction};
    if (!direction) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", test->n);
    *best = (cause){.direction = direction + MOST_TOGETHER * test->n};
    for (f.camera = 0; f.camera < rig->count; f.camera++) {
        size_t distortion = (size_t)td_camera_parameter_count(rig->camera[f.camera].camera.model) - 4;
        for (f.kind = TURNED; f.kind <= DISTORTION; f.kind++) {
            f.count = f.kind == DISTORTION ? distortion : 1;
            int axes = f.kind == TURNED || f.kind == MOVED ? 3 : f.kind == CENTRE ? 2 : 1;
            if ((f.kind == MOVED && f.camera == 0 && rig->count < 3) || !f.count) continue;
            for (f.axis = 0; f.axis < axes; f.axis++) weigh(best, &f, rig, test);
        }
    }
    best->direction = NULL;
    free(direction);
    return TD_OK;
}

/* "0.120 ± 0.004": as many digits as the sigma's first. */
static const char *with_sigma(char text[64], double value, double sigma, const char *sign)
{
    int digits = sigma > 0 ? (int)fmax(0, fmin(6, -floor(log10(sigma)))) : 6;
    snprintf(text, 64, *sign ? "%+.*f ± %.*f" : "%.*f ± %.*f", digits, value, digits, sigma);
    return text;
}

static void name_cause(char *text, size_t size, const cause *f, const td_rig *rig)
{
    static const char *const axes[] = {"x", "y", "z"};
    const char *name = rig->camera[f->camera].name;
    double by = f->amplitude[0], sigma = f->sigma[0];
    char by_text[64];
    switch (f->kind) {
    case TURNED:
        snprintf(text, size, "%s has turned by %s degrees about its %s axis", name,
                 with_sigma(by_text, fabs(by) * DEGREES, sigma * DEGREES, ""), axes[f->axis]);
        break;
    case MOVED:
        snprintf(text, size, "%s has moved by %s mm along its %s axis", name,
                 with_sigma(by_text, 1e3 * fabs(by), 1e3 * sigma, ""), axes[f->axis]);
        break;
    case FOCAL:
        snprintf(text, size, "the focal length of %s has changed by %s %%", name,
                 with_sigma(by_text, 100 * by, 100 * sigma, "+"));
        break;
    case CENTRE:
        snprintf(text, size, "the principal point of %s has moved by %s px in %s", name,
                 with_sigma(by_text, by, sigma, "+"), axes[f->axis]);
        break;
    case DISTORTION:
        snprintf(text, size, "the distortion of %s has changed", name);
        break;
    }
}

/* ---- the test ---- */

/* Of the cameras whose bit is set. The board's errors widen what the gradient may be. With a noise taken from
 * the residuals, chi2 over its degrees of freedom is Fisher's F. */
static td_status judge(double *p, td_gradient_test *test, const td_drift_views *views, const td_rig *rig,
                       unsigned cameras, const td_drift_options *options, td_error *error)
{
    td_drift_normal normal;
    td_bundle bundle = views->bundle; /* with the points' own noise alone */
    size_t n = td_rig_parameter_count(rig);
    double *by_board = calloc(n * n + 1, sizeof *by_board);
    *p = NAN;
    if (!by_board) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    bundle.noise_share = views->board.noise_share;
    td_status status = td_drift_normal_make(&normal, &bundle, cameras, error);
    if (status != TD_OK) {
        free(by_board);
        return status;
    }
    status = td_board_error_gradient(by_board, &views->board, &bundle, &normal, cameras, error);
    if (status == TD_OK)
        status = td_gradient_test_make(test, normal.a, normal.g, rig->covariance, by_board, normal.scale, n,
                                       error);
    if (status == TD_OK && test->rank && rig->covariance) {
        double left = (double)normal.rows - (double)normal.nuisances - (double)test->rank;
        *p = options->noise_px > 0 ? td_chi2_tail(test->chi2, (double)test->rank)
                                   : td_f_tail(test->chi2 / (double)test->rank, (double)test->rank, left);
    }
    td_drift_normal_free(&normal);
    free(by_board);
    return status;
}

/* Variance of a residual's two coordinates, added, by noise and by the rig, once its view's pose has
 * followed.
 */
static void expected_square(double *noise, double *by_rig, const td_drift_row *row,
                            const td_drift_normal *normal, size_t pose, const double *covariance, double *j)
{
    const double *inverse = normal->inverse + 36 * pose;
    size_t n = normal->n;
    *noise = 2 * row->variance;
    for (int e = 0; e < 2; e++)
        for (int i = 0; i < 6; i++)
            for (int k = 0; k < 6; k++) *noise -= row->view[e][i] * inverse[6 * i + k] * row->view[e][k];
    *by_rig = 0;
    if (!covariance) return;
    td_drift_row_follow(j, row, normal, pose);
    for (size_t e = 0; e < 2; e++)
        for (size_t i = 0; i < n; i++)
            for (size_t k = 0; k < n; k++) *by_rig += j[e * n + i] * covariance[i * n + k] * j[e * n + k];
}

static void fill_residuals(double *out, const td_bundle *b)
{
    size_t points = td_target_point_count(&b->observations->target), cameras = (size_t)b->rig->count;
    for (size_t i = 0; i < td_bundle_index(b, b->observations->view_count, 0, 0); i++) {
        double r[2] = {NAN, NAN};
        if (b->used[i])
            td_bundle_residual(r, b, i / points / cameras, (int)(i / points % cameras), i % points);
        memcpy(out + 2 * i, r, sizeof r);
    }
}

static td_status measure_cameras(td_drift *drift, const td_drift_views *views, const td_rig *rig,
                                 td_error *error)
{
    const td_bundle *b = &views->bundle;
    td_drift_normal normal;
    td_drift_row row;
    TD_TRY(td_drift_normal_make(&normal, b, ~0u, error));
    double *j = calloc(2 * normal.n + 1, sizeof *j), noise, by_rig;
    for (int c = 0; c < rig->count && j; c++) {
        td_drift_camera *camera = &drift->camera[c];
        double square = 0, by_noise = 0, predicted = 0;
        for (size_t v = 0; v < b->observations->view_count; v++) {
            size_t before = camera->points, pose = b->pose_of_view[v];
            for (size_t p = 0; p < td_target_point_count(&b->observations->target) && normal.seen[pose];
                 p++) {
                if (!td_drift_row_make(&row, b, v, c, p)) continue;
                square += row.r[0] * row.r[0] + row.r[1] * row.r[1];
                expected_square(&noise, &by_rig, &row, &normal, pose, rig->covariance, j);
                by_noise += noise;
                predicted += noise + by_rig;
                camera->points++;
            }
            camera->views += camera->points > before;
        }
        double count = camera->points ? (double)camera->points : NAN;
        camera->rms_px = sqrt(square / count);
        camera->noise_px = sqrt(by_noise / count);
        camera->predicted_px = rig->covariance ? sqrt(predicted / count) : NAN;
    }
    free(j);
    td_drift_normal_free(&normal);
    return j ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

static void write_text(td_drift *drift, const cause *best, const td_gradient_test *test, const td_rig *rig,
                       double p_limit)
{
    double rms = 0, predicted = 0, points = 0;
    for (int c = 0; c < rig->count; c++) {
        const td_drift_camera *camera = &drift->camera[c];
        if (!camera->points) continue;
        double n = (double)camera->points,
               expected = drift->covariance_known ? camera->predicted_px : camera->noise_px;
        points += n;
        rms += n * camera->rms_px * camera->rms_px;
        predicted += n * expected * expected;
    }
    rms = sqrt(rms / points), predicted = sqrt(predicted / points);
    if (!drift->covariance_known) {
        snprintf(drift->text, sizeof drift->text,
                 "cannot be judged: the rig has no covariance; residuals are %.3f px, the points' noise "
                 "alone gives "
                 "%.3f px",
                 rms, predicted);
        return;
    }
    if (!drift->drifted) {
        snprintf(drift->text, sizeof drift->text,
                 "fine: residuals are %.3f px, %.3f px are expected of an unchanged rig (p = %.2g)", rms,
                 predicted, drift->p_value);
        return;
    }
    char what[TD_TEXT_SIZE / 2];
    name_cause(what, sizeof what, best, rig);
    double rest = td_chi2_tail(test->chi2 - best->chi2, (double)test->rank - (double)best->count);
    snprintf(drift->text, sizeof drift->text,
             "drifted: %s%s; residuals are %.3f px, %.3f px are expected of an unchanged rig (%.1f sigma)",
             what, rest < p_limit ? ", and more than that has changed" : "", rms, predicted,
             drift->drift_sigma);
}

static td_status measure(td_drift *drift, td_drift_views *views, const td_rig *rig,
                         const td_drift_options *options, td_error *error)
{
    td_gradient_test test = {0};
    cause best = {0};
    TD_TRY(td_drift_views_settle(views, options, error));
    TD_TRY(measure_cameras(drift, views, rig, error));
    if (options->residual) fill_residuals(options->residual, &views->bundle);
    for (int c = 0; c < rig->count; c++) {
        td_status status = judge(&drift->camera[c].p_value, &test, views, rig, 1u << c, options, error);
        td_gradient_test_free(&test);
        if (status != TD_OK) return status;
    }
    for (int c = 1; c < rig->count; c++) {
        td_drift_pair *pair = &drift->pair[drift->pair_count];
        TD_TRY(td_drift_pair_measure(pair, views, rig, c, error));
        if (!pair->points) continue;
        drift->pair_count++;
        td_status status = judge(&pair->p_value, &test, views, rig, 1u | 1u << c, options, error);
        td_gradient_test_free(&test);
        if (status != TD_OK) return status;
    }
    td_status status = judge(&drift->p_value, &test, views, rig, ~0u, options, error);
    drift->covariance_known = rig->covariance != NULL;
    drift->drift_sigma = td_sigmas_of(drift->p_value);
    drift->drifted = drift->p_value < options->p_limit;
    if (status == TD_OK && drift->drifted) status = find_cause(&best, rig, &test, error);
    if (status == TD_OK) write_text(drift, &best, &test, rig, options->p_limit);
    td_gradient_test_free(&test);
    return status;
}

td_status td_drift_measure(td_drift *drift, const td_rig *rig, const td_observations *observations,
                           const td_drift_options *options, td_error *error)
{
    const td_drift_options defaults = td_drift_options_default();
    td_drift_views views;
    if (!options) options = &defaults;
    *drift = (td_drift){.p_value = NAN, .drift_sigma = NAN};
    if (!(options->p_limit > 0 && options->p_limit < 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "p_limit: %g is not between 0 and 1", options->p_limit);
    if (!(options->noise_px >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "noise_px: %g must be >= 0", options->noise_px);
    td_status status = td_drift_views_make(&views, rig, observations, error);
    if (status == TD_OK) status = measure(drift, &views, rig, options, error);
    td_drift_views_free(&views);
    return status;
}
