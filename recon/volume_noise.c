/* The noise of a difference of maps: its spread and correlation where nothing changed, and what sums make of
 * it. */
#include <math.h>
#include <stdlib.h>

#include "recon/volume_internal.h"

enum { LEAST_CELLS = 100, LEAST_PAIRS = 50, MOST_PAIRS = 20000, MOST_LAGS = 100 };

static const double to_sigma = 1.4826022185056018; /* of the median absolute value of a normal variable */
static const double end_of_correlation = 0.05;

/* The k-th smallest, brought to its place (Hoare's selection). */
static double select_value(double *v, size_t count, size_t k)
{
    size_t low = 0, high = count - 1;
    while (low < high) {
        const double pivot = v[low + (high - low) / 2];
        size_t i = low, j = high + 1;
        for (;; i++) {
            while (v[i] < pivot) i++;
            do j--;
            while (v[j] > pivot);
            if (i >= j) break;
            const double t = v[i];
            v[i] = v[j];
            v[j] = t;
        }
        if (k <= j)
            high = j;
        else
            low = j + 1;
    }
    return v[k];
}

double volume_median(double *value, size_t count)
{
    if (!count) return NAN;
    const double upper = select_value(value, count, count / 2);
    return count % 2 ? upper : 0.5 * (upper + select_value(value, count, count / 2 - 1));
}

/* Semivariance of cells `lag` apart along rows and columns, from the median of their differences: what few
 * cells do does not reach it. Evenly thinned to MOST_PAIRS. NaN: too few pairs. */
static double semivariance(double *scratch, const volume_grid *g, const double *z, int lag)
{
    const size_t n = volume_cells(g), stride = 1 + 2 * n / MOST_PAIRS;
    size_t count = 0;
    for (size_t i = 0; i < n; i += stride) {
        if (isnan(z[i])) continue;
        const size_t c = i % (size_t)g->columns, below = i + (size_t)lag * (size_t)g->columns;
        if (c + (size_t)lag < (size_t)g->columns && !isnan(z[i + (size_t)lag]))
            scratch[count++] = fabs(z[i + (size_t)lag] - z[i]);
        if (below < n && !isnan(z[below])) scratch[count++] = fabs(z[below] - z[i]);
    }
    if (count < LEAST_PAIRS) return NAN;
    const double spread = to_sigma * volume_median(scratch, count);
    return 0.5 * spread * spread;
}

/* Sum over the lattice of the correlations (0 .. count - 1, at whole lags; 0 beyond), by their distance. */
static double lattice_sum(const double *correlation, int count)
{
    double sum = 0;
    for (int y = 1 - count; y < count; y++)
        for (int x = 1 - count; x < count; x++) {
            const double r = hypot(x, y);
            const int k = (int)r;
            if (k + 1 < count)
                sum += correlation[k] + (r - k) * (correlation[k + 1] - correlation[k]);
            else if (r == k && k < count)
                sum += correlation[k];
        }
    return sum;
}

/* sum over the lattice of exp(-r^2 / length^2), length in cells. */
static double gaussian_sum(double length)
{
    double line = 1;
    for (int k = 1; k < 8 * length + 2; k++) line += 2 * exp(-k * k / (length * length));
    return line * line;
}

/* The length, in cells, whose Gaussian correlation has this sum. */
static double length_of(double sum)
{
    double low = 1e-3, high = 10 * MOST_LAGS;
    for (int i = 0; i < 60; i++) {
        const double middle = 0.5 * (low + high);
        *(gaussian_sum(middle) < sum ? &low : &high) = middle;
    }
    return low;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* What the semivariance rises to: the median of five lags of the upper half. The spread of all cells would
 * not do: of few patches of noise it differs from this by more than the 5 % that are looked for. */
static double sill_of(double *scratch, const volume_grid *g, const double *z, int most)
{
    double s[5];
    for (int k = 0; k < 5; k++) {
        s[k] = semivariance(scratch, g, z, most / 2 + k * (most - most / 2) / 4);
        if (isnan(s[k])) return NAN;
    }
    qsort(s, 5, sizeof *s, by_value);
    return s[2];
}

static double correlation_of(double *scratch, const volume_grid *g, const double *z)
{
    double correlation[MOST_LAGS] = {1};
    const int shorter = g->columns < g->rows ? g->columns : g->rows;
    const int most = shorter / 4 < MOST_LAGS ? shorter / 4 : MOST_LAGS;
    if (most < 4) return NAN;
    const double sill = sill_of(scratch, g, z, most);
    int count = 1;
    if (!(sill > 0)) return NAN;
    for (; count < most; count++) {
        const double s = semivariance(scratch, g, z, count);
        if (isnan(s)) return NAN;
        correlation[count] = 1 - s / sill;
        if (correlation[count] < end_of_correlation) break;
    }
    /* Cut off at 5 %, a Gaussian lacks 5 % of its area; white noise lacks nothing. */
    const double whole = count > 1 ? 1 / (1 - end_of_correlation) : 1;
    return g->cell_m * length_of(whole * lattice_sum(correlation, count));
}

td_status volume_noise(double *spread, double *correlation_m, const volume_grid *g, double middle,
                       td_error *error)
{
    const size_t n = volume_cells(g);
    double *z = malloc(n * sizeof *z), *scratch = malloc((n + 2 * MOST_PAIRS) * sizeof *scratch);
    *spread = *correlation_m = NAN;
    if (!z || !scratch) {
        free(z);
        free(scratch);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the noise of the difference");
    }
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        const bool quiet = g->base[i] && !g->place[i];
        z[i] = quiet ? (g->d[i] - middle) / (g->sigma[i] > 0 ? g->sigma[i] : 1) : NAN;
        if (quiet) scratch[count++] = z[i];
    }
    if (count >= LEAST_CELLS) {
        for (size_t i = 0; i < count; i++) scratch[i] = fabs(scratch[i]);
        *spread = to_sigma * volume_median(scratch, count);
        if (*spread > 0) *correlation_m = correlation_of(scratch, g, z);
    }
    free(z);
    free(scratch);
    return TD_OK;
}

/* out = in, smoothed by exp(-k^2 / length^2) along a line of `count` values `step` apart. */
static void smooth(double *out, const double *in, int count, size_t step, const double *weight, int reach)
{
    for (int i = 0; i < count; i++) {
        const int first = i - reach < 0 ? 0 : i - reach, last = i + reach < count ? i + reach : count - 1;
        double sum = 0;
        for (int k = first; k <= last; k++) sum += weight[abs(k - i)] * in[(size_t)k * step];
        out[i] = sum;
    }
}

/* The Gaussian of a distance is the product of those along the rows and the columns: two passes do. */
td_status volume_variance(double *variance, const double *ws, const volume_grid *g, double correlation_m,
                          td_error *error)
{
    const double length = correlation_m / g->cell_m;
    const int longer = g->columns > g->rows ? g->columns : g->rows;
    const int reach = 4 * length < longer ? (int)ceil(4 * length) : longer; /* exp(-16) beyond */
    double *rows = malloc(volume_cells(g) * sizeof *rows), *line = malloc((size_t)longer * sizeof *line),
           *weight = malloc(((size_t)reach + 1) * sizeof *weight);
    const bool room = rows && line && weight;
    if (room) {
        const size_t columns = (size_t)g->columns;
        *variance = 0;
        for (int k = 0; k <= reach; k++) weight[k] = k ? exp(-k * k / (length * length)) : 1;
        for (size_t r = 0; r < (size_t)g->rows; r++)
            smooth(rows + r * columns, ws + r * columns, g->columns, 1, weight, reach);
        for (size_t c = 0; c < columns; c++) {
            smooth(line, rows + c, g->rows, columns, weight, reach);
            for (size_t r = 0; r < (size_t)g->rows; r++) *variance += line[r] * ws[r * columns + c];
        }
    }
    free(rows);
    free(line);
    free(weight);
    return room ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the sigma of the volume");
}
