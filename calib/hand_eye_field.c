/* Restricted likelihood with a smooth error field over the working space: a Gaussian process in the base's
 * axes, a function of the hand's position, with the Matern 3/2 covariance (Rasmussen and Williams 2006, eq.
 * 4.17)
 *     k(d) = (1 + a) e^-a, a = sqrt(3) d / length,    dk/dlog(length) = a^2 e^-a.
 * Rows are ordered components first (row c n + i is component c of view i), so that the field's covariance is
 * a block k for each component. */
#include <math.h>
#include <string.h>

#include <cblas.h>
#include <lapacke.h>

#include "calib/hand_eye_internal.h"

double td_he_matern(double distance, double length)
{
    double a = sqrt(3) * distance / length;
    return (1 + a) * exp(-a);
}

/* kernel (n,n) and its derivative by the logarithm of the length. */
static void kernels(double *kernel, double *slope, const td_he_linear *linear, double length)
{
    size_t n = linear->n;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) {
            double square = 0;
            for (size_t q = 0; q < 3; q++) {
                double d = linear->at[3 * i + q] - linear->at[3 * k + q];
                square += d * d;
            }
            double a = sqrt(3 * square) / length;
            kernel[i * n + k] = (1 + a) * exp(-a);
            slope[i * n + k] = a * a * exp(-a);
        }
}

static void fill_covariance(double *c, const td_he_linear *linear, const td_he_variance *variance,
                            const double *kernel)
{
    size_t n = linear->n, rows = 6 * n;
    memset(c, 0, rows * rows * sizeof *c);
    for (size_t a = 0; a < 6; a++) {
        double noise = exp(2 * variance->log[a / 3]), field = exp(2 * variance->log[2 + a / 3]);
        for (size_t i = 0; i < n; i++) {
            for (size_t k = 0; k < n; k++) c[(a * n + i) * rows + a * n + k] = field * kernel[i * n + k];
            c[(a * n + i) * (rows + 1)] += noise + TD_HE_LEAST_SIGMA * TD_HE_LEAST_SIGMA;
            for (size_t b = 0; b < 6; b++) c[(a * n + i) * rows + b * n + i] += linear->s[36 * i + 6 * a + b];
        }
    }
}

/* c <- c^-1; false when c is not positive definite. */
static bool invert_covariance(double *c, size_t rows, double *log_det)
{
    lapack_int m = (lapack_int)rows;
    if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'U', m, c, m) != 0) return false;
    *log_det = 0;
    for (size_t i = 0; i < rows; i++) *log_det += 2 * log(c[i * (rows + 1)]);
    if (LAPACKE_dpotri(LAPACK_COL_MAJOR, 'U', m, c, m) != 0) return false;
    for (size_t i = 0; i < rows; i++)
        for (size_t k = i + 1; k < rows; k++) c[i * rows + k] = c[k * rows + i];
    return true;
}

/* Normal equations with the dense C^-1; then C^-1 becomes P. */
static bool solve_and_project(td_he_gls *gls, const td_he_linear *linear, double log_det, double *j,
                              double *cj)
{
    size_t n = linear->n, rows = 6 * n, p = (size_t)linear->p;
    double *g = gls->pg, *ordered = cj + rows * p, normal[TD_HE_MAX_PARAMETERS * TD_HE_MAX_PARAMETERS],
           right[TD_HE_MAX_PARAMETERS];
    double square = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 6; c++)
            memcpy(j + (c * n + i) * p, linear->j + (6 * i + c) * p, p * sizeof *j);
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rows, (int)p, (int)rows, 1, gls->dense,
                (int)rows, j, (int)p, 0, cj, (int)p);
    cblas_dgemm(CblasRowMajor, CblasTrans, CblasNoTrans, (int)p, (int)p, (int)rows, 1, j, (int)p, cj, (int)p,
                0, normal, (int)p);
    memset(right, 0, sizeof right);
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 6; c++) ordered[c * n + i] = linear->g[6 * i + c];
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 6; c++) {
            size_t a = c * n + i;
            double weighted = cblas_ddot((int)rows, gls->dense + a * rows, 1, ordered, 1);
            square += ordered[a] * weighted;
            g[6 * i + c] = weighted;
            for (size_t k = 0; k < p; k++) right[k] += cj[a * p + k] * ordered[a];
        }
    if (!td_he_finish(gls, linear, log_det, normal, right, square)) return false;
    for (size_t i = 0; i < n; i++) /* P g = C^-1 g + C^-1 J beta */
        for (size_t c = 0; c < 6; c++) {
            double *row = gls->cj + (6 * i + c) * p;
            memcpy(row, cj + (c * n + i) * p, p * sizeof *row);
            for (size_t k = 0; k < p; k++) g[6 * i + c] += row[k] * gls->beta[k];
        }
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rows, (int)p, (int)p, 1, cj, (int)p, gls->cov,
                (int)p, 0, j, (int)p);
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)rows, (int)rows, (int)p, -1, j, (int)p, cj,
                (int)p, 1, gls->dense, (int)rows);
    for (size_t i = 0; i < n; i++)
        for (size_t a = 0; a < 6; a++)
            for (size_t b = 0; b < 6; b++)
                gls->block[36 * i + 6 * a + b] = gls->dense[(a * n + i) * rows + b * n + i];
    return true;
}

/* q (rows,rows) = P dC/dtheta_k, and the gradient's k-th element. `weight` of each component's block, times
 * `kernel` (NULL: the identity). */
static double derivative(double *q, const td_he_gls *gls, const double weight[6], const double *kernel)
{
    size_t n = gls->n, rows = 6 * n;
    double gradient = 0;
    memset(q, 0, rows * rows * sizeof *q);
    for (size_t c = 0; c < 6; c++) {
        if (weight[c] == 0) continue;
        if (kernel)
            cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rows, (int)n, (int)n, weight[c],
                        gls->dense + c * n, (int)rows, kernel, (int)n, 0, q + c * n, (int)rows);
        else
            for (size_t a = 0; a < rows; a++)
                for (size_t i = 0; i < n; i++)
                    q[a * rows + c * n + i] = weight[c] * gls->dense[a * rows + c * n + i];
        for (size_t i = 0; i < n; i++) {
            gradient += q[(c * n + i) * (rows + 1)];
            double through = 0;
            if (kernel)
                for (size_t k = 0; k < n; k++) through += kernel[i * n + k] * gls->pg[6 * k + c];
            else
                through = gls->pg[6 * i + c];
            gradient -= weight[c] * gls->pg[6 * i + c] * through;
        }
    }
    return gradient;
}

/* Rows that a variance belongs to: those of rotation, of translation, or (the length) all. */
static void rows_of(size_t range[2], int k, size_t n)
{
    range[0] = k < 4 && k % 2 ? 3 * n : 0;
    range[1] = k < 4 && k % 2 == 0 ? 3 * n : 6 * n;
}

/* tr(Q_k Q_l), where columns of Q_k that do not belong to variance k are zero. */
static double trace_of_product(const double *a, const size_t column_a[2], const double *b,
                               const size_t column_b[2], size_t rows)
{
    enum { TILE = 32 };
    double sum = 0;
    for (size_t i0 = column_b[0]; i0 < column_b[1]; i0 += TILE)
        for (size_t k0 = column_a[0]; k0 < column_a[1]; k0 += TILE)
            for (size_t i = i0; i < column_b[1] && i < i0 + TILE; i++)
                for (size_t k = k0; k < column_a[1] && k < k0 + TILE; k++)
                    sum += a[i * rows + k] * b[k * rows + i];
    return sum;
}

bool td_he_evaluate_field(td_he_gls *gls, const td_he_linear *linear, const td_he_variance *variance)
{
    size_t n = linear->n, rows = 6 * n, square = rows * rows;
    double *q = gls->work, *kernel = q + TD_HE_MAX_VARIANCES * square, *slope = kernel + n * n;
    double *j = slope + n * n, *cj = j + rows * (size_t)linear->p, log_det;
    kernels(kernel, slope, linear, exp(variance->log[4]));
    fill_covariance(gls->dense, linear, variance, kernel);
    if (!invert_covariance(gls->dense, rows, &log_det)) return false;
    if (!solve_and_project(gls, linear, log_det, j, cj)) return false;
    for (int k = 0; k < TD_HE_MAX_VARIANCES; k++) {
        double weight[6];
        for (int c = 0; c < 6; c++) {
            weight[c] = k == 4 ? exp(2 * variance->log[2 + c / 3]) : 2 * exp(2 * variance->log[k]);
            if (k < 4 && k % 2 != c / 3) weight[c] = 0;
        }
        const double *through = k < 2 ? NULL : k < 4 ? kernel : slope;
        gls->gradient[k] = derivative(q + (size_t)k * square, gls, weight, through);
    }
    for (int k = 0; k < TD_HE_MAX_VARIANCES; k++)
        for (int l = 0; l <= k; l++) {
            size_t of_k[2], of_l[2];
            rows_of(of_k, k, n);
            rows_of(of_l, l, n);
            double trace = trace_of_product(q + (size_t)k * square, of_k, q + (size_t)l * square, of_l, rows);
            gls->fisher[TD_HE_MAX_VARIANCES * k + l] = gls->fisher[TD_HE_MAX_VARIANCES * l + k] = trace / 2;
        }
    return true;
}
