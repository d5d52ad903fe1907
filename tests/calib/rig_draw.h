/* Rigs drawn from a covariance, and whether p values are uniform. */
#ifndef TELEDIMOS_TESTS_CALIB_RIG_DRAW_H
#define TELEDIMOS_TESTS_CALIB_RIG_DRAW_H

#include "core/rig_draw.h"
#include "tests/calib/simulate.h"

/* Lower triangular l (n,n) with s = l l^T; rows without variance are zero. */
static inline double *cholesky(const double *s, size_t n)
{
    double *l = calloc(n * n, sizeof *l);
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k <= i; k++) {
            double sum = s[i * n + k];
            for (size_t j = 0; j < k; j++) sum -= l[i * n + j] * l[k * n + j];
            if (i == k)
                l[i * n + i] = sum > 1e-13 * s[i * n + i] ? sqrt(sum) : 0;
            else if (l[k * n + k] > 0)
                l[i * n + k] = sum / l[k * n + k];
        }
    return l;
}

/* `truth` moved by times a draw from `covariance`; of Mahalanobis length 1 when `unit`. Carries the
 * covariance.
 */
static inline td_rig *rig_draw(const td_rig *truth, const double *covariance, double times, int unit,
                               td_random *random)
{
    td_rig *rig = td_rig_copy(truth);
    size_t n = td_rig_parameter_count(rig);
    double *l = cholesky(covariance, n), *z = calloc(2 * n, sizeof *z), *d = z + n, square = 0;
    for (size_t i = 0; i < n; i++) {
        z[i] = l[i * n + i] > 0 ? td_random_normal(random) : 0;
        square += z[i] * z[i];
    }
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k <= i; k++) d[i] += times * l[i * n + k] * z[k] / (unit ? sqrt(square) : 1);
    td_rig_move(rig, d);
    free(rig->covariance);
    rig->covariance = malloc(n * n * sizeof *rig->covariance);
    memcpy(rig->covariance, covariance, n * n * sizeof *covariance);
    free(l);
    free(z);
    return rig;
}

static inline int compare_p(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Kolmogorov and Smirnov: the largest distance of n values' distribution from the uniform, times sqrt(n), is
 * above 1.95 once in a thousand times. Sorts p. */
static inline double uniform_distance(double *p, size_t n)
{
    double worst = 0;
    qsort(p, n, sizeof *p, compare_p);
    for (size_t i = 0; i < n; i++) {
        worst = fmax(worst, fabs(p[i] - (double)i / (double)n));
        worst = fmax(worst, fabs(p[i] - (double)(i + 1) / (double)n));
    }
    return worst * sqrt((double)n);
}

static inline void check_uniform(const char *what, double *p, size_t n)
{
    double distance = uniform_distance(p, n);
    size_t below = 0;
    while (below < n && p[below] < 0.05) below++;
    printf("  %-34s %zu values, Kolmogorov-Smirnov %.3f (bound 1.95), %.1f %% below 0.05\n", what, n,
           distance, 100.0 * (double)below / (double)n);
    check_less(distance, 1.95);
    /* Binomial: 3.3 standard deviations. */
    check_near((double)below / (double)n, 0.05, 3.3 * sqrt(0.05 * 0.95 / (double)n));
}

#endif
