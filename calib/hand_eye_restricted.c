/* Restricted maximum likelihood of variance components (Patterson and Thompson 1971) for views that are
 * independent of one another, and Fisher scoring for any.
 *
 * With residuals g + J beta ~ N(0, C(theta)):
 *     -2 log L = log|C| + log|J^T C^-1 J| + g^T P g,   P = C^-1 - C^-1 J (J^T C^-1 J)^-1 J^T C^-1
 *     gradient_k = tr(P C_k) - g^T P C_k P g,  information_kl = 1/2 tr(P C_k P C_l),  C_k = dC/dtheta_k. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

bool td_he_invert(double *inverse, double *log_det, const double *a, int n)
{
    double l[TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS] = {0},
                                    m[TD_HE_MAX_PARAMETERS][TD_HE_MAX_PARAMETERS];
    *log_det = 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k <= i; k++) {
            double sum = a[i * n + k];
            for (int q = 0; q < k; q++) sum -= l[i * n + q] * l[k * n + q];
            if (i == k) {
                if (!(sum > 1e-14 * a[i * n + i]) || !isfinite(sum)) return false;
                l[i * n + i] = sqrt(sum);
                *log_det += log(sum);
            } else {
                l[i * n + k] = sum / l[k * n + k];
            }
        }
    for (int c = 0; c < n; c++) /* m = L^-1 */
        for (int i = 0; i < n; i++) {
            double sum = i == c ? 1 : 0;
            for (int q = c; q < i; q++) sum -= l[i * n + q] * m[q][c];
            m[i][c] = i < c ? 0 : sum / l[i * n + i];
        }
    for (int i = 0; i < n; i++)
        for (int k = 0; k <= i; k++) {
            double sum = 0;
            for (int q = i; q < n; q++) sum += m[q][i] * m[q][k];
            inverse[i * n + k] = inverse[k * n + i] = sum;
        }
    return true;
}

td_status td_he_gls_new(td_he_gls *gls, size_t n, int p, bool field, td_error *error)
{
    *gls = (td_he_gls){.n = n, .p = p};
    size_t rows = 6 * n, square = field ? rows * rows : 0;
    double *all = calloc(rows + 36 * n + rows * (size_t)p + 36 * n, sizeof *all);
    gls->pg = all;
    if (all) {
        gls->block = all + rows;
        gls->cj = gls->block + 36 * n;
        gls->inverse = gls->cj + rows * (size_t)p;
    }
    if (square)
        gls->dense = calloc(square * (1 + TD_HE_MAX_VARIANCES) + 2 * n * n + 2 * rows * (size_t)p + rows,
                            sizeof *gls->dense);
    if (!all || (square && !gls->dense)) {
        td_he_gls_free(gls);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the covariance of %zu views", n);
    }
    if (square) gls->work = gls->dense + square;
    return TD_OK;
}

void td_he_gls_free(td_he_gls *gls)
{
    free(gls->pg);
    free(gls->dense);
    *gls = (td_he_gls){0};
}

bool td_he_finish(td_he_gls *gls, const td_he_linear *linear, double log_det, const double *normal,
                  const double *right, double square)
{
    int p = linear->p;
    double log_normal;
    if (!td_he_invert(gls->cov, &log_normal, normal, p)) return false;
    double explained = 0;
    for (int i = 0; i < p; i++) {
        gls->beta[i] = 0;
        for (int k = 0; k < p; k++) gls->beta[i] -= gls->cov[i * p + k] * right[k];
        explained -= gls->beta[i] * right[i];
    }
    gls->minus_two_log = log_det + log_normal + square - explained;
    return isfinite(gls->minus_two_log);
}

/* One view's C^-1, C^-1 J and what they add to the normal equations. */
static bool add_view(td_he_gls *gls, const td_he_linear *linear, size_t i, const double variance[6],
                     double *log_det, double *normal, double *right, double *square)
{
    size_t p = (size_t)linear->p;
    double c[36], one, *inverse = gls->inverse + 36 * i, *cj = gls->cj + 6 * p * i;
    const double *j = linear->j + 6 * p * i, *g = linear->g + 6 * i;
    memcpy(c, linear->s + 36 * i, sizeof c);
    for (int k = 0; k < 6; k++) c[7 * k] += variance[k];
    if (!td_he_invert(inverse, &one, c, 6)) return false;
    *log_det += one;
    td_multiply(cj, inverse, j, 6, 6, p);
    for (int r = 0; r < 6; r++) {
        double weighted = 0;
        for (int k = 0; k < 6; k++) weighted += inverse[6 * r + k] * g[k];
        *square += g[r] * weighted;
        for (size_t a = 0; a < p; a++) {
            double left = cj[(size_t)r * p + a];
            right[a] += left * g[r];
            for (size_t b = 0; b < p; b++) normal[a * p + b] += left * j[(size_t)r * p + b];
        }
    }
    return true;
}

/* P g and the diagonal block of P of one view. */
static void view_results(td_he_gls *gls, const td_he_linear *linear, size_t i)
{
    size_t p = (size_t)linear->p;
    const double *inverse = gls->inverse + 36 * i, *cj = gls->cj + 6 * p * i, *j = linear->j + 6 * p * i;
    double half[6 * TD_HE_MAX_PARAMETERS], through[36], r[6];
    for (size_t k = 0; k < 6; k++) {
        r[k] = linear->g[6 * i + k];
        for (size_t a = 0; a < p; a++) r[k] += j[k * p + a] * gls->beta[a];
    }
    td_multiply(half, cj, gls->cov, 6, p, p);
    td_multiply_transposed(through, half, cj, 6, p, 6);
    for (size_t k = 0; k < 6; k++) {
        double sum = 0;
        for (size_t q = 0; q < 6; q++) sum += inverse[6 * k + q] * r[q];
        gls->pg[6 * i + k] = sum;
    }
    for (int k = 0; k < 36; k++) gls->block[36 * i + (size_t)k] = inverse[k] - through[k];
}

/* tr(P D P D') summed over views and pairs of views, D and D' selecting rows of rotation (0) or translation
 * (1): P's low-rank part couples the views only through p by p matrices. */
static void fisher_independent(td_he_gls *gls, const td_he_linear *linear, const double scale[2])
{
    size_t p = (size_t)linear->p;
    double own[2][2] = {{0}}, cross[2][2] = {{0}}, t[2][TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS] = {{0}};
    for (size_t i = 0; i < linear->n; i++) {
        const double *inverse = gls->inverse + 36 * i, *cj = gls->cj + 6 * p * i;
        double half[6 * TD_HE_MAX_PARAMETERS], through[36];
        td_multiply(half, cj, gls->cov, 6, p, p);
        td_multiply_transposed(through, half, cj, 6, p, 6);
        for (size_t a = 0; a < 6; a++)
            for (size_t b = 0; b < 6; b++) {
                own[a / 3][b / 3] += inverse[6 * a + b] * inverse[6 * a + b];
                cross[a / 3][b / 3] += inverse[6 * a + b] * through[6 * a + b];
            }
        for (size_t a = 0; a < 6; a++)
            for (size_t u = 0; u < p; u++)
                for (size_t v = 0; v < p; v++) t[a / 3][u * p + v] += cj[a * p + u] * cj[a * p + v];
    }
    double ct[2][TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS];
    for (int k = 0; k < 2; k++) td_multiply(ct[k], gls->cov, t[k], p, p, p);
    for (int k = 0; k < 2; k++)
        for (int l = 0; l < 2; l++) {
            double through = 0;
            for (size_t u = 0; u < p; u++)
                for (size_t v = 0; v < p; v++) through += ct[k][u * p + v] * ct[l][v * p + u];
            gls->fisher[2 * k + l] = 0.5 * scale[k] * scale[l] * (own[k][l] - 2 * cross[k][l] + through);
        }
}

static bool evaluate_independent(td_he_gls *gls, const td_he_linear *linear, const td_he_variance *variance)
{
    double normal[TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS] = {0}, right[TD_HE_MAX_PARAMETERS] = {0};
    double v[6], log_det = 0, square = 0, scale[2];
    for (int k = 0; k < 6; k++)
        v[k] = TD_HE_LEAST_SIGMA * TD_HE_LEAST_SIGMA + (variance->count ? exp(2 * variance->log[k / 3]) : 0);
    for (size_t i = 0; i < linear->n; i++)
        if (!add_view(gls, linear, i, v, &log_det, normal, right, &square)) return false;
    if (!td_he_finish(gls, linear, log_det, normal, right, square)) return false;
    for (size_t i = 0; i < linear->n; i++) view_results(gls, linear, i);
    if (!variance->count) return true;
    for (int k = 0; k < 2; k++) {
        scale[k] = 2 * exp(2 * variance->log[k]);
        double sum = 0;
        for (size_t i = 0; i < linear->n; i++)
            for (int a = 3 * k; a < 3 * k + 3; a++)
                sum += gls->block[36 * i + (size_t)(7 * a)] -
                       gls->pg[6 * i + (size_t)a] * gls->pg[6 * i + (size_t)a];
        gls->gradient[k] = scale[k] * sum;
    }
    fisher_independent(gls, linear, scale);
    return true;
}

/* Of few views the two variances are hardly told apart. A joint's error turns and shifts the hand alike, so
 * rotation and translation are bound weakly, by a normal prior of the logarithm of their ratio: an arm of 0.3
 * m within a factor e^2. From 20 views on it weighs less than a hundredth of the data. */
static void add_prior(td_he_gls *gls, const td_he_variance *variance)
{
    const double arm = 0.3, weight = 0.25;
    int n = variance->count;
    double off = variance->log[1] - variance->log[0] - log(arm);
    gls->minus_two_log += weight * off * off;
    for (int k = 0; k < 2; k++) {
        gls->gradient[k] += 2 * weight * (k ? off : -off);
        for (int l = 0; l < 2; l++) gls->fisher[n * k + l] += k == l ? weight : -weight;
    }
}

bool td_he_evaluate(td_he_gls *gls, const td_he_linear *linear, const td_he_variance *variance)
{
    bool ok = variance->count > 2 ? td_he_evaluate_field(gls, linear, variance)
                                  : evaluate_independent(gls, linear, variance);
    if (ok && variance->count) add_prior(gls, variance);
    return ok;
}

/* Where the logarithms may go: sigma from nothing to a metre or a radian; the field's length within what the
 * hand's positions can show. */
static void bounds(double low[], double high[], const td_he_linear *linear, int count)
{
    double spread = 0, mean[3] = {0};
    for (size_t i = 0; i < linear->n; i++)
        for (int k = 0; k < 3; k++) mean[k] += linear->at[3 * i + (size_t)k] / (double)linear->n;
    for (size_t i = 0; i < linear->n; i++)
        for (int k = 0; k < 3; k++) {
            double off = linear->at[3 * i + (size_t)k] - mean[k];
            spread += off * off / (double)linear->n;
        }
    spread = fmax(sqrt(spread), 1e-3);
    for (int k = 0; k < count; k++) {
        low[k] = k == 4 ? log(0.05 * spread) : log(TD_HE_LEAST_SIGMA);
        high[k] = k == 4 ? log(10 * spread) : 0;
    }
}

/* Step of damped Fisher scoring; logarithms at a bound that the gradient pushes against stay. */
static double scoring_step(double step[], const td_he_gls *gls, const td_he_variance *v, const double low[],
                           const double high[], double damping)
{
    int n = v->count, free_index[TD_HE_MAX_VARIANCES], m = 0;
    for (int k = 0; k < n; k++) {
        step[k] = 0;
        bool held =
            (v->log[k] <= low[k] && gls->gradient[k] > 0) || (v->log[k] >= high[k] && gls->gradient[k] < 0);
        if (!held) free_index[m++] = k;
    }
    double a[TD_HE_MAX_VARIANCES * TD_HE_MAX_VARIANCES], inverse[TD_HE_MAX_VARIANCES * TD_HE_MAX_VARIANCES];
    double log_det, predicted = 0;
    for (int i = 0; i < m; i++)
        for (int k = 0; k < m; k++) {
            double f = 2 * gls->fisher[free_index[i] * n + free_index[k]];
            a[i * m + k] = i == k ? f * (1 + damping) + 1e-3 * damping + 1e-9 : f;
        }
    if (!m || !td_he_invert(inverse, &log_det, a, m)) return 0;
    for (int i = 0; i < m; i++) {
        double s = 0;
        for (int k = 0; k < m; k++) s -= inverse[i * m + k] * gls->gradient[free_index[k]];
        step[free_index[i]] = fmin(fmax(s, -1.5), 1.5);
        predicted -= 0.5 * s * gls->gradient[free_index[i]];
    }
    return predicted;
}

bool td_he_maximise(td_he_gls *gls, const td_he_linear *linear, td_he_variance *variance)
{
    /* What is left to gain in -2 log L; the field's evaluations are dear, and 1e-3 is a thirtieth of a
     * standard deviation. */
    double low[TD_HE_MAX_VARIANCES], high[TD_HE_MAX_VARIANCES], damping = 1e-4;
    double enough = variance->count > 2 ? 1e-3 : 1e-5;
    bounds(low, high, linear, variance->count);
    for (int k = 0; k < variance->count; k++)
        variance->log[k] = fmin(fmax(variance->log[k], low[k]), high[k]);
    if (!td_he_evaluate(gls, linear, variance)) return false;
    bool fresh = true;
    for (int iteration = 0; iteration < 60 && variance->count; iteration++) {
        double step[TD_HE_MAX_VARIANCES];
        td_he_gls kept = *gls; /* the small arrays: derivatives here, should the trial fail */
        if (scoring_step(step, gls, variance, low, high, damping) < enough) break;
        td_he_variance trial = *variance;
        for (int k = 0; k < trial.count; k++)
            trial.log[k] = fmin(fmax(trial.log[k] + step[k], low[k]), high[k]);
        fresh = td_he_evaluate(gls, linear, &trial) && gls->minus_two_log <= kept.minus_two_log;
        if (fresh) {
            *variance = trial;
            damping = fmax(damping / 10, 1e-6);
            if (kept.minus_two_log - gls->minus_two_log < enough / 10) break;
        } else {
            *gls = kept;
            damping = fmax(damping * 10, 1e-2);
            if (damping > 1e8) break;
        }
    }
    return fresh || td_he_evaluate(gls, linear, variance);
}

double td_he_sigma_of(const td_he_gls *gls, const td_he_variance *variance, int k)
{
    int n = variance->count;
    double a[TD_HE_MAX_VARIANCES * TD_HE_MAX_VARIANCES], inverse[TD_HE_MAX_VARIANCES * TD_HE_MAX_VARIANCES];
    double unit[TD_HE_MAX_VARIANCES], log_det;
    /* Information of the variances sigma^2, which stay regular where sigma is 0; of the length, its
     * logarithm. */
    for (int i = 0; i < n; i++) unit[i] = i < 4 ? 2 * exp(2 * variance->log[i]) : 1;
    for (int i = 0; i < n; i++)
        for (int l = 0; l < n; l++) a[i * n + l] = gls->fisher[i * n + l] / (unit[i] * unit[l]);
    double size[TD_HE_MAX_VARIANCES];
    for (int i = 0; i < n; i++) size[i] = sqrt(a[i * n + i]);
    for (int i = 0; i < n; i++)
        for (int l = 0; l < n; l++) a[i * n + l] = a[i * n + l] / (size[i] * size[l]) + (i == l ? 1e-12 : 0);
    if (!td_he_invert(inverse, &log_det, a, n)) return NAN;
    double sigma = exp(variance->log[k]), spread = sqrt(inverse[k * n + k]) / size[k];
    /* Of sigma from that of its square: spread / (2 sigma) where sigma is well away from 0. */
    return k < 4 ? sqrt(sigma * sigma + spread) - sigma : sigma * spread;
}
