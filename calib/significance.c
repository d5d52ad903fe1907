#include "calib/significance_internal.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "core/linalg.h"

/* Eigenvalues of the scaled information below this are rounding. */
#define SEEN 1e-11
enum { MOST_TERMS = 10000, MOST_DIRECTIONS = 16 };

/* Upper incomplete gamma function over the complete one: by its series below x = a + 1, by its continued
 * fraction above (Abramowitz and Stegun 6.5.29, 6.5.31; evaluated by Lentz' method). */
static double gamma_tail(double a, double x)
{
    if (!(x > 0)) return x <= 0 ? 1 : NAN;
    double front = exp(a * log(x) - x - lgamma(a));
    if (x < a + 1) {
        double term = 1 / a, sum = term;
        for (int i = 1; i < MOST_TERMS && term > sum * DBL_EPSILON; i++) sum += term *= x / (a + i);
        return fmax(1 - front * sum, 0);
    }
    double b = x + 1 - a, c = 1 / DBL_MIN, d = 1 / b, h = d;
    for (int i = 1; i < MOST_TERMS; i++) {
        double an = -i * (i - a), change;
        b += 2;
        d = an * d + b;
        c = b + an / c;
        d = 1 / (fabs(d) > DBL_MIN ? d : DBL_MIN);
        if (!(fabs(c) > DBL_MIN)) c = DBL_MIN;
        h *= change = c * d;
        if (fabs(change - 1) < DBL_EPSILON) break;
    }
    return front * h;
}

double td_chi2_tail(double x, double k)
{
    return k > 0 ? gamma_tail(k / 2, x / 2) : 1;
}

/* Continued fraction of the incomplete beta function (Abramowitz and Stegun 26.5.8) by Lentz' method. */
static double beta_fraction(double a, double b, double x)
{
    double c = 1, d = 1 / (1 - (a + b) * x / (a + 1)), h = d;
    for (int m = 1; m < MOST_TERMS; m++) {
        double even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
        double odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1));
        d = 1 / (1 + even * d);
        c = 1 + even / c;
        h *= c * d;
        d = 1 / (1 + odd * d);
        c = 1 + odd / c;
        h *= c * d;
        if (fabs(c * d - 1) < DBL_EPSILON) break;
    }
    return h;
}

/* Regularised incomplete beta function I_x(a, b). */
static double beta_share(double a, double b, double x)
{
    if (!(x > 0)) return 0;
    if (x >= 1) return 1;
    double front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log1p(-x));
    return x < (a + 1) / (a + b + 2) ? front * beta_fraction(a, b, x) / a
                                     : 1 - front * beta_fraction(b, a, 1 - x) / b;
}

double td_f_tail(double x, double k, double m)
{
    if (!(k > 0)) return 1;
    if (!(m > 0)) return NAN;
    return beta_share(m / 2, k / 2, m / (m + k * x));
}

double td_sigmas_of(double p)
{
    double low = 0, high = 37;
    if (isnan(p)) return NAN;
    for (int i = 0; i < 100; i++) {
        double middle = (low + high) / 2;
        *(erfc(middle / sqrt(2.0)) > p ? &low : &high) = middle;
    }
    return (low + high) / 2;
}

void td_gradient_test_free(td_gradient_test *test)
{
    free(test->l);
    free(test->z);
    free(test->weight);
    *test = (td_gradient_test){0};
}

/* l, z and the transposed pseudo-inverse of l (n,rank) from the eigenvectors of the information, its rows and
 * columns scaled to typical size 1. */
static td_status factor(td_gradient_test *test, double *inverse, const double *a, const double *g,
                        const double *scale, double *work, td_error *error)
{
    size_t n = test->n;
    double *unit = work, *vector = work + n * n, *value = vector + n * n, *root = value + n;
    for (size_t i = 0; i < n; i++) root[i] = scale[i] > 0 ? sqrt(scale[i]) : 0;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++)
            unit[i * n + k] = root[i] > 0 && root[k] > 0 ? a[i * n + k] / (root[i] * root[k]) : 0;
    TD_TRY(td_eigen_symmetric(value, vector, unit, n, error));
    for (size_t q = n; q-- > 0 && value[q] > SEEN;) test->rank++;
    for (size_t q = 0; q < test->rank; q++) {
        const double *v = vector + (n - 1 - q) * n;
        double lambda = sqrt(value[n - 1 - q]);
        for (size_t i = 0; i < n; i++) {
            test->l[i * test->rank + q] = root[i] * v[i] * lambda;
            double back = root[i] > 0 ? v[i] / (root[i] * lambda) : 0;
            inverse[i * test->rank + q] = back;
            test->z[q] += back * g[i];
        }
    }
    return TD_OK;
}

/* w (r,r) += m^T s m, m (n,r), s (n,n) symmetric */
static void add_through(double *w, const double *m, const double *s, size_t n, size_t r, double *work)
{
    td_multiply(work, s, m, n, n, r);
    for (size_t i = 0; i < r; i++)
        for (size_t k = 0; k <= i; k++) {
            double sum = 0;
            for (size_t j = 0; j < n; j++)
                sum += (m[j * r + i] * work[j * r + k] + m[j * r + k] * work[j * r + i]) / 2;
            w[i * r + k] += sum;
            if (k < i) w[k * r + i] += sum;
        }
}

td_status td_gradient_test_make(td_gradient_test *test, const double *a, const double *g, const double *s,
                                const double *b, const double *scale, size_t n, td_error *error)
{
    *test = (td_gradient_test){.n = n};
    test->l = calloc(n * n + 1, sizeof *test->l);
    test->z = calloc(n + 1, sizeof *test->z);
    test->weight = calloc(n * n + 1, sizeof *test->weight);
    double *work = calloc(3 * n * n + 2 * n + 1, sizeof *work), *inverse = work + 2 * n * n + 2 * n;
    td_status status = test->l && test->z && test->weight && work
                           ? TD_OK
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for a test of %zu parameters", n);
    if (status == TD_OK) status = factor(test, inverse, a, g, scale, work, error);
    size_t r = test->rank;
    if (status == TD_OK && s && r) add_through(test->weight, test->l, s, n, r, work);
    if (status == TD_OK && b && r) add_through(test->weight, inverse, b, n, r, work);
    for (size_t i = 0; i < r && status == TD_OK; i++) test->weight[i * (r + 1)] += 1;
    if (status == TD_OK && r) status = td_invert_spd(test->weight, test->weight, r, error);
    for (size_t i = 0; i < r && status == TD_OK; i++)
        for (size_t k = 0; k < r; k++) test->chi2 += test->z[i] * test->weight[i * r + k] * test->z[k];
    free(work);
    if (status != TD_OK) td_gradient_test_free(test);
    return status;
}

/* With u = L^T e the data expect z = -u amplitude (the gradient points away from the minimum): generalised
 * least squares for the amplitudes. */
size_t td_gradient_test_explain(double *chi2, double *amplitude, double *sigma, const td_gradient_test *test,
                                const double *e, size_t count)
{
    size_t r = test->rank, n = test->n;
    double h[MOST_DIRECTIONS * MOST_DIRECTIONS], b[MOST_DIRECTIONS], value[MOST_DIRECTIONS],
        vector[MOST_DIRECTIONS * MOST_DIRECTIONS];
    double *u = calloc(2 * count * r + 1, sizeof *u), *wu = u + count * r;
    *chi2 = 0;
    for (size_t i = 0; i < count; i++) amplitude[i] = sigma[i] = NAN;
    if (!u || count > MOST_DIRECTIONS || !r) {
        free(u);
        return 0;
    }
    td_multiply(u, e, test->l, count, n, r);
    td_multiply(wu, u, test->weight, count, r, r);
    td_multiply_transposed(h, wu, u, count, r, count);
    double root[MOST_DIRECTIONS];
    for (size_t i = 0; i < count; i++) {
        root[i] = sqrt(h[i * (count + 1)]);
        b[i] = 0;
        for (size_t k = 0; k < r; k++) b[i] -= wu[i * r + k] * test->z[k];
    }
    free(u);
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < count; k++)
            if (root[i] > 0 && root[k] > 0) h[i * count + k] /= root[i] * root[k];
    if (td_eigen_symmetric(value, vector, h, count, NULL) != TD_OK) return 0;
    size_t seen = 0;
    for (size_t i = 0; i < count; i++) amplitude[i] = sigma[i] = 0;
    for (size_t q = 0; q < count; q++) {
        double along = 0;
        if (!(value[q] > SEEN)) continue;
        for (size_t i = 0; i < count; i++) along += root[i] > 0 ? vector[q * count + i] * b[i] / root[i] : 0;
        for (size_t i = 0; i < count; i++) {
            if (!(root[i] > 0)) continue;
            amplitude[i] += vector[q * count + i] * along / (value[q] * root[i]);
            sigma[i] += vector[q * count + i] * vector[q * count + i] / (value[q] * root[i] * root[i]);
        }
        *chi2 += along * along / value[q];
        seen++;
    }
    for (size_t i = 0; i < count; i++) sigma[i] = sqrt(sigma[i]);
    return seen;
}
