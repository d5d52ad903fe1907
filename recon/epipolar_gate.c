/* The right camera turns about its own centre by a small rotation omega, in its own frame: a pixel's ray v
 * moves by omega x v, and with it the epipolar curve. At the curve's foot, n its normal and J the
 * projection's Jacobian,
 *
 *   d(distance)/d(omega) = -n^T J (omega x v) = n^T J [v]x omega
 *
 * The start is the least median of squares (Rousseeuw 1984) over rotations that three matches determine; then
 * least squares over the matches within 3 sigma, both determined anew until neither changes. */
#include "recon/epipolar_gate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/random.h"
#include "recon/epipolar_gate_internal.h"

enum { LEAST_MATCHES = 8, LEAST_INLIERS = 20, DRAWS = 300, STEPS = 30 };

static const double CUT = 3;             /* sigmas from its curve at which a match is none */
static const double LEAST_SIGMA = 0.01;  /* px: rounding, not noise, is below */
static const double LEAST_SPREAD = 0.08; /* of the image's width and height: standard deviation of matches */
static const double LARGEST = 0.2;       /* rad: what turns farther is another rig */
static const double SIGNIFICANT = 16.27; /* chi-squared with 3 degrees of freedom, 99.9 % */
/* Of a normal distribution cut at CUT sigmas: its variance, and the variance of a location estimated by
 * averaging what is left, times the share that is left (Huber's skipped mean). */
static const double CUT_VARIANCE = 0.97334, CUT_LOSS = 1.0274;

/* ---- residuals ---- */

typedef struct work {
    const td_pair *pair;
    const td_match *match;
    size_t count;
    double *distance; /* (count) px; NaN: no curve */
    double (*row)[3]; /* (count) px/rad, its derivative by the rotation */
    double *scratch;  /* (count) */
    bool *inlier;     /* (count) */
} work;

/* The pair with its right camera turned. */
static td_pair turn(const td_pair *pair, const double rotation[3])
{
    td_pair out = *pair;
    const double xi[6] = {rotation[0], rotation[1], rotation[2], 0, 0, 0};
    out.right_from_left = td_pose_perturb(&pair->right_from_left, xi);
    return out;
}

bool td_epipolar_gate_residual(double *distance, double row[3], const td_pair *pair, const td_match *match)
{
    const td_camera *camera = &pair->rig->camera[pair->right].camera;
    double along[2], v[3], pixel[2], j[6];
    if (!td_pair_residual(distance, along, NULL, pair, match->left, match->right) || !isfinite(*distance))
        return false;
    const double n[2] = {-along[1], along[0]};
    const double foot[2] = {match->right[0] - *distance * n[0], match->right[1] - *distance * n[1]};
    if (!td_camera_unproject(v, NULL, NULL, camera, foot) || !td_camera_project(pixel, j, NULL, camera, v))
        return false;
    const double g[3] = {n[0] * j[0] + n[1] * j[3], n[0] * j[1] + n[1] * j[4], n[0] * j[2] + n[1] * j[5]};
    row[0] = g[1] * v[2] - g[2] * v[1];
    row[1] = g[2] * v[0] - g[0] * v[2];
    row[2] = g[0] * v[1] - g[1] * v[0];
    return true;
}

static void evaluate(work *w, const double rotation[3])
{
    const td_pair pair = turn(w->pair, rotation);
    for (size_t i = 0; i < w->count; i++)
        if (!td_epipolar_gate_residual(w->distance + i, w->row[i], &pair, w->match + i)) w->distance[i] = NAN;
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *x, size_t count)
{
    if (count == 0) return NAN;
    qsort(x, count, sizeof *x, compare);
    return count % 2 ? x[count / 2] : (x[count / 2 - 1] + x[count / 2]) / 2;
}

/* ---- start ---- */

/* Median of the absolute distances after a rotation, to first order. */
static double median_after(work *w, const double rotation[3])
{
    size_t n = 0;
    for (size_t i = 0; i < w->count; i++) {
        const double *r = w->row[i];
        if (isfinite(w->distance[i]))
            w->scratch[n++] =
                fabs(w->distance[i] + r[0] * rotation[0] + r[1] * rotation[1] + r[2] * rotation[2]);
    }
    return median(w->scratch, n);
}

/* The rotation that puts three matches on their curves; false: they do not determine it. */
static bool solve_three(double rotation[3], const work *w, const size_t index[3])
{
    const double *a = w->row[index[0]], *b = w->row[index[1]], *c = w->row[index[2]];
    const double d[3] = {w->distance[index[0]], w->distance[index[1]], w->distance[index[2]]};
    double bc[3], ca[3], ab[3], norm = 0;
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        bc[i] = b[j] * c[k] - b[k] * c[j];
        ca[i] = c[j] * a[k] - c[k] * a[j];
        ab[i] = a[j] * b[k] - a[k] * b[j];
    }
    const double det = a[0] * bc[0] + a[1] * bc[1] + a[2] * bc[2];
    for (int i = 0; i < 3; i++) {
        rotation[i] = -(d[0] * bc[i] + d[1] * ca[i] + d[2] * ab[i]) / det;
        norm += rotation[i] * rotation[i];
    }
    return norm < LARGEST * LARGEST; /* false for NaN */
}

/* Best of DRAWS, the rig as it is included; returns the robust sigma there. */
static double start(double rotation[3], work *w)
{
    td_random random = td_random_seed(1, 0);
    double least;
    memset(rotation, 0, 3 * sizeof *rotation);
    least = median_after(w, rotation);
    for (int draw = 0; draw < DRAWS; draw++) {
        size_t index[3];
        double candidate[3];
        for (int i = 0; i < 3; i++) index[i] = td_random_below(&random, (uint32_t)w->count);
        if (!solve_three(candidate, w, index)) continue;
        const double m = median_after(w, candidate);
        if (!(m < least)) continue;
        least = m;
        memcpy(rotation, candidate, sizeof candidate);
    }
    return 1.4826 * least;
}

/* ---- least squares ---- */

static size_t select_inliers(work *w, double sigma)
{
    size_t n = 0;
    for (size_t i = 0; i < w->count; i++) n += w->inlier[i] = fabs(w->distance[i]) < CUT * sigma;
    return n;
}

/* One step of Gauss and Newton over the inliers. *sigma: of their distances before it, made good for the cut.
 * False: they do not determine a rotation. */
static bool step(double rotation[3], double inverse[9], double *sigma, const work *w, size_t inliers)
{
    double normal[9] = {0}, gradient[3] = {0}, squares = 0;
    for (size_t i = 0; i < w->count; i++) {
        if (!w->inlier[i]) continue;
        squares += w->distance[i] * w->distance[i];
        for (int r = 0; r < 3; r++) {
            gradient[r] += w->row[i][r] * w->distance[i];
            for (int c = 0; c < 3; c++) normal[3 * r + c] += w->row[i][r] * w->row[i][c];
        }
    }
    if (inliers <= 3 || td_invert_spd(inverse, normal, 3, NULL) != TD_OK) return false;
    double delta[6] = {0}, moved[3];
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) delta[r] -= inverse[3 * r + c] * gradient[c];
    const td_pose now = td_pose_exp((double[6]){rotation[0], rotation[1], rotation[2], 0, 0, 0});
    const td_pose next = td_pose_perturb(&now, delta);
    td_rotation_log(moved, next.q);
    memcpy(rotation, moved, sizeof moved);
    *sigma = fmax(LEAST_SIGMA, sqrt(squares / ((double)(inliers - 3) * CUT_VARIANCE)));
    return moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2] < LARGEST * LARGEST;
}

/* Rotation, its covariance and the inliers; false: not determined. */
static bool estimate(double rotation[3], double covariance[9], work *w)
{
    double inverse[9], sigma, last[3];
    sigma = fmax(LEAST_SIGMA, start(rotation, w));
    for (int i = 0; i < STEPS; i++) {
        evaluate(w, rotation);
        memcpy(last, rotation, sizeof last);
        const double before = sigma;
        if (!step(rotation, inverse, &sigma, w, select_inliers(w, sigma))) return false;
        if (fabs(sigma / before - 1) < 1e-9 &&
            hypot(hypot(rotation[0] - last[0], rotation[1] - last[1]), rotation[2] - last[2]) < 1e-12)
            break;
    }
    for (int i = 0; i < 9; i++) covariance[i] = sigma * sigma * CUT_LOSS * inverse[i];
    return true;
}

/* ---- the gate ---- */

static bool is_spread(const work *w)
{
    const td_camera *camera = &w->pair->rig->camera[w->pair->right].camera;
    const double size[2] = {camera->width, camera->height};
    for (int c = 0; c < 2; c++) {
        double n = 0, sum = 0, squares = 0;
        for (size_t i = 0; i < w->count; i++) {
            if (!w->inlier[i]) continue;
            const double x = w->match[i].right[c] / size[c];
            n++, sum += x, squares += x * x;
        }
        if (!(n >= LEAST_INLIERS && squares / n - sum / n * (sum / n) > LEAST_SPREAD * LEAST_SPREAD))
            return false;
    }
    return true;
}

/* Over the inliers: 1.4826 times the median of |distance| and, where asked for, the median of the distance.
 */
static double robust_rms(double *middle, work *w)
{
    size_t n = 0;
    for (size_t i = 0; i < w->count; i++)
        if (w->inlier[i] && isfinite(w->distance[i])) w->scratch[n++] = w->distance[i];
    if (middle) *middle = median(w->scratch, n);
    for (size_t i = 0; i < n; i++) w->scratch[i] = fabs(w->scratch[i]);
    return 1.4826 * median(w->scratch, n);
}

/* The rig as it is: inliers within 3 robust sigmas of their curves. */
static void judge_as_is(td_epipolar_gate *gate, work *w)
{
    evaluate(w, (double[3]){0, 0, 0});
    gate->inliers = select_inliers(w, fmax(LEAST_SIGMA, 1.4826 * median_after(w, (double[3]){0, 0, 0})));
    gate->rms_px = gate->corrected_px = robust_rms(&gate->median_px, w);
    memset(gate->rotation, 0, sizeof gate->rotation);
}

static void judge(td_epipolar_gate *gate, work *w)
{
    evaluate(w, (double[3]){0, 0, 0});
    gate->determined = estimate(gate->rotation, gate->covariance, w) && is_spread(w);
    if (gate->determined) {
        evaluate(w, gate->rotation);
        gate->corrected_px = robust_rms(NULL, w);
        evaluate(w, (double[3]){0, 0, 0});
        gate->rms_px = robust_rms(&gate->median_px, w);
        gate->inliers = 0;
        for (size_t i = 0; i < w->count; i++) gate->inliers += w->inlier[i];
        if (gate->corrected_px < gate->rms_px) return;
        judge_as_is(gate, w);
        return;
    }
    judge_as_is(gate, w);
    for (int i = 0; i < 9; i++) gate->covariance[i] = NAN;
}

td_status td_epipolar_gate_check(td_epipolar_gate *gate, const td_pair *pair, const td_match *match,
                                 size_t count, td_error *error)
{
    work w = {pair, match, 0, NULL, NULL, NULL, NULL};
    size_t valid = 0;
    *gate = (td_epipolar_gate){.matches = count};
    td_match *kept = malloc((count + 1) * sizeof *kept);
    for (size_t i = 0; kept && i < count; i++) {
        double distance, row[3];
        if (td_epipolar_gate_residual(&distance, row, pair, match + i)) kept[valid++] = match[i];
    }
    w.match = kept;
    w.count = valid;
    w.distance = malloc((valid + 1) * sizeof *w.distance);
    w.row = malloc((valid + 1) * sizeof *w.row);
    w.scratch = malloc((valid + 1) * sizeof *w.scratch);
    w.inlier = malloc((valid + 1) * sizeof *w.inlier);
    td_status status = TD_OK;
    if (!kept || !w.distance || !w.row || !w.scratch || !w.inlier)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu matches", count);
    else if (valid < LEAST_MATCHES)
        status = td_fail(error, TD_ERROR_DATA,
                         "%zu of %zu matches have an epipolar curve, but %d are needed to tell whether the "
                         "images belong to the rig; match more points",
                         valid, count, LEAST_MATCHES);
    else
        judge(gate, &w);
    free(kept);
    free(w.distance);
    free(w.row);
    free(w.scratch);
    free(w.inlier);
    return status;
}

/* ---- the correction ---- */

static bool is_significant(const td_epipolar_gate *gate)
{
    double inverse[9], chi2 = 0;
    if (td_invert_spd(inverse, gate->covariance, 3, NULL) != TD_OK) return false;
    for (int i = 0; i < 9; i++) chi2 += gate->rotation[i / 3] * inverse[i] * gate->rotation[i % 3];
    return chi2 > SIGNIFICANT;
}

td_status td_epipolar_gate_correct(td_rig **corrected, const td_epipolar_gate *gate, const td_pair *pair,
                                   td_error *error)
{
    *corrected = NULL;
    if (!gate->determined)
        return td_fail(
            error, TD_ERROR_DATA,
            "%zu matches do not determine how the cameras have turned; they must be %d or more, and "
            "spread over the image",
            gate->inliers, LEAST_INLIERS);
    if (pair->right == 0)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "camera %s: is the rig's frame and cannot be turned in it; give it as the left one",
                       pair->rig->camera[0].name);
    td_rig *rig = td_rig_copy(pair->rig);
    if (!rig) return td_fail(error, TD_ERROR_MEMORY, "no memory for a copy of the rig");
    *corrected = rig;
    if (!is_significant(gate)) return TD_OK;
    td_rig_camera *camera = &rig->camera[pair->right];
    const double xi[6] = {gate->rotation[0], gate->rotation[1], gate->rotation[2], 0, 0, 0};
    camera->camera_from_rig = td_pose_perturb(&camera->camera_from_rig, xi);
    const size_t n = td_rig_parameter_count(rig);
    const size_t at =
        td_rig_parameter_offset(rig, pair->right) + (size_t)td_camera_parameter_count(camera->camera.model);
    for (size_t i = 0; rig->covariance && i < 9; i++)
        rig->covariance[(at + i / 3) * n + at + i % 3] += gate->covariance[i];
    return TD_OK;
}
