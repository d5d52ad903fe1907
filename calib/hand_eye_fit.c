/* Poses and variances together; and what the fit says of one view from the others. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

td_he_variance td_he_first_variance(const td_he_view *view, size_t n, const td_he_state *state)
{
    td_he_variance variance = {.count = 2};
    double *length = malloc((n ? n : 1) * sizeof *length);
    for (int half = 0; half < 2; half++) {
        double median = 1e-3;
        if (length) {
            for (size_t i = 0; i < n; i++) {
                double d[6];
                td_he_residual(d, &view[i], state);
                length[i] = sqrt(d[3 * half] * d[3 * half] + d[3 * half + 1] * d[3 * half + 1] +
                                 d[3 * half + 2] * d[3 * half + 2]);
            }
            qsort(length, n, sizeof *length, by_size);
            median = length[n / 2];
        }
        /* The median of the length of a normal vector of three components is 1.538 sigma. */
        variance.log[half] = log(fmax(median / 1.538, 10 * TD_HE_LEAST_SIGMA));
    }
    free(length);
    return variance;
}

void td_he_fit_free(td_he_fit *fit)
{
    td_he_linear_free(&fit->linear);
    td_he_gls_free(&fit->gls);
}

/* Whether a step is nothing: against the parameters' standard deviations, or against rounding. */
static bool is_small(const td_he_gls *gls)
{
    for (int k = 0; k < gls->p; k++) {
        double b = fabs(gls->beta[k]);
        if (b > 1e-13 && b > 1e-4 * sqrt(gls->cov[k * gls->p + k])) return false;
    }
    return true;
}

td_status td_he_fit_run(td_he_fit *fit, const td_he_view *view, size_t n, const td_he_state *start,
                        const td_he_variance *variance, bool free_scale, td_error *error)
{
    int p = free_scale ? 13 : 12;
    *fit = (td_he_fit){.state = *start, .variance = *variance};
    TD_TRY(td_he_linear_new(&fit->linear, n, p, error));
    TD_TRY(td_he_gls_new(&fit->gls, n, p, variance->count > 2, error));
    /* From a closed form's poses the variances are not yet to be learned. */
    int rough = variance->count > 2 ? 0 : 2;
    for (int iteration = 0; iteration < 40; iteration++) {
        td_he_linearise(&fit->linear, view, &fit->state);
        bool ok = iteration < rough ? td_he_evaluate(&fit->gls, &fit->linear, &fit->variance)
                                    : td_he_maximise(&fit->gls, &fit->linear, &fit->variance);
        if (!ok)
            return td_fail(error, TD_ERROR_DATA,
                           "the views do not determine the transforms: add views in which the hand is turned "
                           "about other axes");
        double beta[TD_HE_MAX_PARAMETERS], turn = 0;
        for (int k = 0; k < p; k++) beta[k] = fit->gls.beta[k];
        for (int k = 0; k < 12; k++)
            if (k % 6 < 3) turn = fmax(turn, fabs(beta[k]));
        if (turn > 0.3)
            for (int k = 0; k < p; k++) beta[k] *= 0.3 / turn;
        td_he_move(&fit->state, beta, p);
        if (iteration >= rough && is_small(&fit->gls)) break;
    }
    td_he_linearise(&fit->linear, view, &fit->state);
    if (!td_he_evaluate(&fit->gls, &fit->linear, &fit->variance))
        return td_fail(error, TD_ERROR_DATA, "the views do not determine the transforms: add views");
    return TD_OK;
}

/* Leave-one-out residuals of generalised least squares without solving again: P_ii^-1 (P g)_i, with the
 * covariance P_ii^-1 (Dubrule 1983, for kriging). With the field they are conditional on the other views. */
bool td_he_held_out(double r[6], double cov[36], const td_he_fit *fit, size_t i)
{
    double log_det;
    if (!td_he_invert(cov, &log_det, fit->gls.block + 36 * i, 6)) return false;
    for (int a = 0; a < 6; a++) {
        r[a] = 0;
        for (int b = 0; b < 6; b++) r[a] += cov[6 * a + b] * fit->gls.pg[6 * i + (size_t)b];
    }
    return true;
}

/* What the field says at a new place: c (6,6n) its covariance with the used views' residuals. The mean is
 * c P g; the variance changes by - c P c^T - (J Phi (C^-1 J)^T c^T) - (…)^T. */
static void add_field(double r[6], double cov[36], const td_he_fit *fit, const double *j, const double at[3])
{
    const td_he_gls *gls = &fit->gls;
    size_t n = gls->n, rows = 6 * n, p = (size_t)gls->p;
    double length = exp(fit->variance.log[4]);
    double jcov[6 * TD_HE_MAX_PARAMETERS];
    td_multiply(jcov, j, gls->cov, 6, p, p);
    for (size_t a = 0; a < 6; a++) {
        double va = exp(2 * fit->variance.log[2 + a / 3]);
        cov[7 * a] += va;
        for (size_t i = 0; i < n; i++) {
            const double *ai = fit->linear.at + 3 * i;
            double ki = va * td_he_matern(hypot(hypot(at[0] - ai[0], at[1] - ai[1]), at[2] - ai[2]), length);
            r[a] -= ki * gls->pg[6 * i + a];
            for (size_t b = 0; b < 6; b++) {
                double through = 0, vb = exp(2 * fit->variance.log[2 + b / 3]);
                for (size_t k = 0; k < n; k++) {
                    const double *ak = fit->linear.at + 3 * k;
                    double d = hypot(hypot(at[0] - ak[0], at[1] - ak[1]), at[2] - ak[2]);
                    through += gls->dense[(a * n + i) * rows + b * n + k] * vb * td_he_matern(d, length);
                }
                double cross = 0;
                for (size_t q = 0; q < p; q++) cross += jcov[b * p + q] * gls->cj[(6 * i + a) * p + q];
                cov[6 * a + b] -= ki * (through + cross);
                cov[6 * b + a] -= ki * cross;
            }
        }
    }
}

void td_he_predict_new(double r[6], double cov[36], const td_he_fit *fit, const td_he_view *view)
{
    size_t p = (size_t)fit->gls.p;
    double j[6 * TD_HE_MAX_PARAMETERS], half[6 * TD_HE_MAX_PARAMETERS], through[36];
    td_he_linearise_view(r, j, cov, view, &fit->state, (int)p);
    td_multiply(half, j, fit->gls.cov, 6, p, p);
    td_multiply_transposed(through, half, j, 6, p, 6);
    for (int k = 0; k < 36; k++) cov[k] += through[k];
    for (int k = 0; k < 6; k++)
        cov[7 * k] += TD_HE_LEAST_SIGMA * TD_HE_LEAST_SIGMA +
                      (fit->variance.count ? exp(2 * fit->variance.log[k / 3]) : 0);
    if (fit->variance.count > 2) add_field(r, cov, fit, j, view->hand.t);
}

double td_he_distance(const double r[6], const double cov[36])
{
    double inverse[36], log_det, square = 0;
    if (!td_he_invert(inverse, &log_det, cov, 6)) return INFINITY;
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 6; b++) square += r[a] * inverse[6 * a + b] * r[b];
    return square;
}

double td_he_deviate(double square, double freedom)
{
    double tail; /* chi-square of 6, or F of 6 and `freedom`: both in closed form */
    if (freedom <= 0) {
        tail = exp(-square / 2) * (1 + square / 2 + square * square / 8);
    } else {
        double x = freedom / (freedom + square), y = 1 - x, a = freedom / 2;
        tail = pow(x, a) * (1 + a * y + a * (a + 1) / 2 * y * y);
    }
    double low = 0, high = 38;
    for (int k = 0; k < 60; k++) {
        double middle = (low + high) / 2;
        if (erfc(middle / sqrt(2)) > tail)
            low = middle;
        else
            high = middle;
    }
    return (low + high) / 2;
}
