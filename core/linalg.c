#include "core/linalg.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <cblas.h>
#include <lapacke.h>

void td_linalg_single_thread(void)
{
    openblas_set_num_threads(1);
}

static td_status finish(lapack_int info, const char *what, td_error *error)
{
    if (info == 0) return TD_OK;
    if (info < 0) return td_fail(error, TD_ERROR_DATA, "%s: not a finite matrix", what);
    return td_fail(error, TD_ERROR_CONVERGENCE, "%s did not converge", what);
}

static double *copy_of(const double *a, size_t count)
{
    double *copy = malloc((count ? count : 1) * sizeof *copy);
    if (copy) memcpy(copy, a, count * sizeof *copy);
    return copy;
}

td_status td_eigen_symmetric(double *value, double *vector, const double *a, size_t n, td_error *error)
{
    double *work = copy_of(a, n * n);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu eigenvalues", n);
    /* Column-major on a symmetric matrix: LAPACK's columns come back as our rows, without a transposition. */
    lapack_int info =
        LAPACKE_dsyevd(LAPACK_COL_MAJOR, vector ? 'V' : 'N', 'U', (lapack_int)n, work, (lapack_int)n, value);
    if (vector && info == 0) memcpy(vector, work, n * n * sizeof *vector);
    free(work);
    return finish(info, "eigenvalues", error);
}

td_status td_null_vector(double *x, double *ratio, const double *a, size_t m, size_t n, td_error *error)
{
    /* Pad with zero rows so that V^T is always square. */
    size_t rows = m < n ? n : m;
    double *work = calloc(rows * n + n * n + n + rows, sizeof *work);
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for a %zux%zu decomposition", m, n);
    double *vt = work + rows * n, *s = vt + n * n, *superb = s + n;
    memcpy(work, a, m * n * sizeof *a);
    double unused;
    lapack_int info = LAPACKE_dgesvd(LAPACK_ROW_MAJOR, 'N', 'A', (lapack_int)rows, (lapack_int)n, work,
                                     (lapack_int)n, s, &unused, 1, vt, (lapack_int)n, superb);
    if (info == 0) {
        memcpy(x, vt + (n - 1) * n, n * sizeof *x);
        if (ratio) *ratio = n > 1 && s[0] > 0 ? s[n - 2] / s[0] : 0;
    }
    free(work);
    return finish(info, "singular values", error);
}

td_status td_least_squares_linear(double *x, size_t *rank, const double *a, const double *b, size_t m,
                                  size_t n, td_error *error)
{
    if (m < n || !n)
        return td_fail(error, TD_ERROR_ARGUMENT, "linear least squares: %zu equations for %zu unknowns", m,
                       n);
    double *work = copy_of(a, m * n), *right = copy_of(b, m), *s = malloc(n * sizeof *s);
    lapack_int found = 0, info = 0;
    td_status status = TD_OK;
    if (!work || !right || !s) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zux%zu equations", m, n);
    } else {
        info = LAPACKE_dgelsd(LAPACK_ROW_MAJOR, (lapack_int)m, (lapack_int)n, 1, work, (lapack_int)n, right,
                              1, s, 1e-12, &found);
        if (info == 0) memcpy(x, right, n * sizeof *x);
        if (rank) *rank = (size_t)found;
        status = finish(info, "linear least squares", error);
    }
    free(work);
    free(right);
    free(s);
    return status;
}

td_status td_invert_spd(double *inverse, const double *a, size_t n, td_error *error)
{
    if (inverse != a) memcpy(inverse, a, n * n * sizeof *a);
    lapack_int info = LAPACKE_dpotrf(LAPACK_ROW_MAJOR, 'L', (lapack_int)n, inverse, (lapack_int)n);
    if (info == 0) info = LAPACKE_dpotri(LAPACK_ROW_MAJOR, 'L', (lapack_int)n, inverse, (lapack_int)n);
    if (info) return td_fail(error, TD_ERROR_DATA, "a %zux%zu matrix is not positive definite", n, n);
    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n; j++) inverse[i * n + j] = inverse[j * n + i];
    return TD_OK;
}

td_status td_nearest_rotation(double r[9], const double m[9], td_error *error)
{
    double work[9], u[9], s[3], vt[9], superb[2];
    memcpy(work, m, sizeof work);
    lapack_int info = LAPACKE_dgesvd(LAPACK_ROW_MAJOR, 'A', 'A', 3, 3, work, 3, s, u, 3, vt, 3, superb);
    if (info) return finish(info, "singular values of a rotation", error);
    td_multiply(r, u, vt, 3, 3, 3);
    double det = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                 r[2] * (r[3] * r[7] - r[4] * r[6]);
    if (det < 0) {
        for (int i = 0; i < 3; i++) u[3 * i + 2] = -u[3 * i + 2];
        td_multiply(r, u, vt, 3, 3, 3);
    }
    return TD_OK;
}

void td_multiply(double *c, const double *a, const double *b, size_t m, size_t k, size_t n)
{
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)m, (int)n, (int)k, 1, a, (int)k, b, (int)n, 0,
                c, (int)n);
}

void td_multiply_transposed(double *c, const double *a, const double *b, size_t m, size_t k, size_t n)
{
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)m, (int)n, (int)k, 1, a, (int)k, b, (int)k, 0,
                c, (int)n);
}

td_status td_sandwich(double *s, const double *j, const double *a, size_t m, size_t n, td_error *error)
{
    double *ja = calloc(m * n + 1, sizeof *ja);
    if (!ja) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance");
    td_multiply(ja, j, a, m, n, n);
    td_multiply_transposed(s, ja, j, m, n, m);
    free(ja);
    return TD_OK;
}
