/* Splines of degree 5 for the motion, noise of a record, and the normal equations that both share. */
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sim/identification_internal.h"

/* ---- splines ---- */

/* Recurrence of Cox and de Boor over uniform knots; u in [0, 1] from the last knot. */
size_t td_id_basis(double weight[3][ID_SPLINE], const td_id_spline *spline, double t)
{
    const double at = (t - spline->first) / spline->step;
    size_t index = at > 0 ? (size_t)at : 0;
    if (index >= spline->intervals) index = spline->intervals - 1;
    const double u = at - (double)index, h = spline->step;
    double level[ID_SPLINE][ID_SPLINE] = {{1}};
    for (int d = 1; d < ID_SPLINE; d++)
        for (int r = 0; r <= d; r++) {
            const double left = r > 0 ? level[d - 1][r - 1] : 0, right = r < d ? level[d - 1][r] : 0;
            level[d][r] = ((u + d - r) * left + (r + 1 - u) * right) / d;
        }
    const double *fourth = level[ID_SPLINE - 2], *third = level[ID_SPLINE - 3];
    for (int r = 0; r < ID_SPLINE; r++) {
        const double a = r > 1 ? third[r - 2] : 0, b = r > 0 && r < ID_SPLINE - 1 ? third[r - 1] : 0,
                     c = r < ID_SPLINE - 2 ? third[r] : 0;
        weight[0][r] = level[ID_SPLINE - 1][r];
        weight[1][r] = ((r > 0 ? fourth[r - 1] : 0) - (r < ID_SPLINE - 1 ? fourth[r] : 0)) / h;
        weight[2][r] = (a - 2 * b + c) / (h * h);
    }
    return index;
}

/* ---- noise ---- */

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Differences of order 5 of white noise have sqrt(252) of its deviation. Their median gives a scale that no
 * jump spoils; from it on, the deviation of those within three scales (0.9733 of the variance are theirs). */
double td_id_noise(const double *value, size_t stride, size_t count, double *work)
{
    static const double binomial[6] = {-1, 5, -10, 10, -5, 1};
    if (count < 12) return 0;
    const size_t differences = count - 5;
    for (size_t i = 0; i < differences; i++) {
        double sum = 0;
        for (size_t k = 0; k < 6; k++) sum += binomial[k] * value[(i + k) * stride];
        work[i] = fabs(sum) / sqrt(252);
    }
    qsort(work, differences, sizeof *work, by_size);
    const double scale = work[differences / 2] / 0.67449;
    double square = 0;
    size_t within = 0;
    while (within < differences && work[within] <= 3 * scale) square += work[within] * work[within], within++;
    return within ? sqrt(square / (double)within / 0.9733) : 0;
}

/* ---- normal equations ---- */

td_status td_arrow_make(td_arrow *a, size_t unknowns, size_t band, int border, td_error *error)
{
    const size_t columns = (size_t)border;
    *a = (td_arrow){.unknowns = unknowns, .band = band, .border = border};
    a->matrix = calloc(unknowns * band, sizeof *a->matrix);
    a->side = calloc(unknowns * (columns + 1), sizeof *a->side);
    a->turned = calloc(unknowns * (columns + 1), sizeof *a->turned);
    a->corner = calloc(columns * columns + 1, sizeof *a->corner);
    a->right = calloc(columns + 1, sizeof *a->right);
    return a->matrix && a->side && a->turned && a->corner && a->right
               ? TD_OK
               : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu coefficients of splines", unknowns);
}

void td_arrow_free(td_arrow *a)
{
    free(a->matrix);
    free(a->side);
    free(a->turned);
    free(a->corner);
    free(a->right);
}

void td_arrow_clear(td_arrow *a)
{
    const size_t columns = (size_t)a->border;
    memset(a->matrix, 0, a->unknowns * a->band * sizeof *a->matrix);
    memset(a->side, 0, a->unknowns * (columns + 1) * sizeof *a->side);
    memset(a->corner, 0, columns * columns * sizeof *a->corner);
    memset(a->right, 0, columns * sizeof *a->right);
}

void td_arrow_add(td_arrow *a, size_t first, const double *weight, size_t length, const double *border,
                  double residual)
{
    const size_t columns = (size_t)a->border;
    for (size_t i = 0; i < length; i++) {
        if (weight[i] == 0) continue;
        double *down = a->matrix + (first + i) * a->band;
        for (size_t k = i; k < length; k++) down[k - i] += weight[i] * weight[k];
        double *side = a->side + (first + i) * (columns + 1);
        for (size_t c = 0; border && c < columns; c++) side[c] += weight[i] * border[c];
        side[columns] -= weight[i] * residual;
    }
    for (size_t c = 0; border && c < columns; c++) {
        for (size_t d = 0; d < columns; d++) a->corner[c * columns + d] += border[c] * border[d];
        a->right[c] -= border[c] * residual;
    }
}

static td_status factor(td_arrow *a, td_error *error)
{
    const lapack_int n = (lapack_int)a->unknowns, band = (lapack_int)a->band;
    if (LAPACKE_dpbtrf(LAPACK_COL_MAJOR, 'L', n, band - 1, a->matrix, band) != 0)
        return td_fail(error, TD_ERROR_DATA, "the splines of the motion are not determined by the log");
    return TD_OK;
}

static td_status forward(td_arrow *a, td_error *error)
{
    const size_t columns = (size_t)a->border + 1;
    for (size_t i = 0; i < a->unknowns; i++)
        for (size_t c = 0; c < columns; c++) a->turned[c * a->unknowns + i] = a->side[i * columns + c];
    const lapack_int n = (lapack_int)a->unknowns, band = (lapack_int)a->band;
    if (LAPACKE_dtbtrs(LAPACK_COL_MAJOR, 'L', 'N', 'N', n, band - 1, (lapack_int)a->border + 1, a->matrix,
                       band, a->turned, n) != 0)
        return td_fail(error, TD_ERROR_DATA, "the splines of the motion are not determined by the log");
    return TD_OK;
}

static double dot(const double *a, const double *b, size_t count)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++) sum += a[i] * b[i];
    return sum;
}

/* Schur complement of the band: corner - side' matrix^-1 side, by turned = L^-1 side. */
td_status td_arrow_reduce(td_arrow *a, td_error *error)
{
    const size_t columns = (size_t)a->border, n = a->unknowns;
    TD_TRY(factor(a, error));
    TD_TRY(forward(a, error));
    for (size_t c = 0; c < columns; c++) {
        for (size_t d = 0; d <= c; d++) {
            a->corner[c * columns + d] -= dot(a->turned + c * n, a->turned + d * n, n);
            a->corner[d * columns + c] = a->corner[c * columns + d];
        }
        a->right[c] -= dot(a->turned + c * n, a->turned + columns * n, n);
    }
    return TD_OK;
}

td_status td_arrow_follow(double *step, const td_arrow *a, const double *border_step, td_error *error)
{
    const size_t columns = (size_t)a->border, n = a->unknowns;
    memcpy(step, a->turned + columns * n, n * sizeof *step);
    for (size_t c = 0; c < columns; c++)
        for (size_t i = 0; i < n; i++) step[i] -= border_step[c] * a->turned[c * n + i];
    if (LAPACKE_dtbtrs(LAPACK_COL_MAJOR, 'L', 'T', 'N', (lapack_int)n, (lapack_int)a->band - 1, 1, a->matrix,
                       (lapack_int)a->band, step, (lapack_int)n) != 0)
        return td_fail(error, TD_ERROR_DATA, "the splines of the motion are not determined by the log");
    return TD_OK;
}
