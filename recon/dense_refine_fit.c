/* What the refinement measures on the whole pair before it trusts a pixel: how differently the cameras are
 * exposed, how far their rows are apart, and the noise of their grey values. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_refine_internal.h"

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

/* left = gain right + offset, over every eighth row: cameras may be exposed differently. */
float dense_fit_gain(const td_image *left, const td_image *right, const td_disparity *result)
{
    const int width = left->width;
    double n = 0, a = 0, b = 0, ab = 0, bb = 0;
    for (int y = 2; y < left->height; y += 8)
        for (int x = 1; x + 1 < width; x++) {
            const size_t at = (size_t)y * (size_t)width + (size_t)x;
            const float to = (float)x - result->value[at];
            if (result->kind[at] != TD_DENSE_MATCHED || !(to >= 0) || to >= (float)(width - 1)) continue;
            const int i = (int)to;
            const uint8_t *row = right->data + at - x + i;
            const float part = to - (float)i;
            const double l = left->data[at], r = (double)((1 - part) * (float)row[0] + part * (float)row[1]);
            n++, a += l, b += r, ab += l * r, bb += r * r;
        }
    const double variance = bb - b * b / n, gain = (ab - a * b / n) / variance;
    return n > 1000 && variance > 4 * n && gain > 0.25 && gain < 4 ? (float)gain : 1;
}

/* ---- rows ---- */

/* Where edges run aslant, rows that do not meet look like a disparity: residuals r over the slopes along (g)
 * and across the rows (v), r = a + b g + c v, tell the two apart. c is of a whole tile, and robust: residuals
 * above three times their median belong to something else. */
typedef struct rows_job {
    const td_image *left;
    const int16_t *slope, *residual, *with;
    int limit; /* of a residual, in eighths */
    float *at; /* (tiles,tiles); NaN: not known */
} rows_job;

enum { ROW_STEP = 3, FEWEST = 300 };

static int median_residual(const td_image *left, const int16_t *residual, const int16_t *with)
{
    size_t count[REFINE_MOST + 1] = {0}, all = 0, below = 0;
    const size_t width = (size_t)left->width;
    for (size_t y = 1; y + 1 < (size_t)left->height; y += ROW_STEP)
        for (size_t i = y * width; i < (y + 1) * width; i++)
            count[abs(residual[i])] += (size_t)with[i], all += (size_t)with[i];
    int median = 0;
    while (median < REFINE_MOST && (below += count[median]) * 2 < all) median++;
    return median;
}

static void fit_tile(size_t index, void *user)
{
    const rows_job *j = user;
    const int width = j->left->width, height = j->left->height;
    const int row = (int)index / REFINE_TILES, column = (int)index % REFINE_TILES;
    double n = 0, g = 0, v = 0, r = 0, gg = 0, gv = 0, vv = 0, gr = 0, vr = 0;
    for (int y = MAX(height * row / REFINE_TILES, 1); y < MIN(height * (row + 1) / REFINE_TILES, height - 1);
         y += ROW_STEP)
        for (int x = width * column / REFINE_TILES; x < width * (column + 1) / REFINE_TILES; x++) {
            const size_t at = (size_t)y * (size_t)width + (size_t)x;
            if (!j->with[at] || abs(j->residual[at]) > j->limit) continue;
            const double a = j->slope[at], c = j->residual[at],
                         b = REFINE_ONE * 0.5 *
                             ((double)j->left->data[at + (size_t)width] -
                              (double)j->left->data[at - (size_t)width]);
            n++, g += a, v += b, r += c, gg += a * a, gv += a * b, vv += b * b, gr += a * c, vr += b * c;
        }
    j->at[index] = NAN;
    if (n < FEWEST) return;
    gg -= g * g / n, gv -= g * v / n, vv -= v * v / n, gr -= g * r / n, vr -= v * r / n;
    const double determinant = gg * vv - gv * gv, one = REFINE_ONE * REFINE_ONE;
    if (!(gg > n * one && determinant > n * one * gg)) return; /* plain, or striped along the slopes */
    j->at[index] = (float)fmin(fmax((gg * vr - gv * gr) / determinant, -1), 1);
}

void dense_fit_lift(dense_lift *lift, const td_image *left, const int16_t *slope, const int16_t *residual,
                    const int16_t *with, int threads)
{
    rows_job job = {left, slope, residual, with, 3 * median_residual(left, residual, with), lift->at};
    float square = 0, known = 0;
    td_parallel_for(REFINE_TILES * REFINE_TILES, threads, fit_tile, &job, NULL, NULL);
    for (int k = 0; k < REFINE_TILES * REFINE_TILES; k++) {
        float *at = lift->at + k;
        if (isnan(*at))
            *at = 0;
        else
            square += *at * *at, known++;
    }
    lift->square = known > 0 ? square / known : 0;
}

/* Linear between the tiles' centres, even beyond the outer ones. */
void dense_lift_row(float *lift, const dense_lift *of, int y, int width, int height)
{
    const float last = REFINE_TILES - 1, down = ((float)y + 0.5f) / (float)height * REFINE_TILES - 0.5f;
    const float v = MIN(MAX(down, 0), last), wide = (float)width / REFINE_TILES;
    const int above = MIN((int)v, REFINE_TILES - 2);
    const float part = v - (float)above;
    float row[REFINE_TILES + 2];
    for (int k = 0; k < REFINE_TILES; k++)
        row[k + 1] =
            (1 - part) * of->at[above * REFINE_TILES + k] + part * of->at[(above + 1) * REFINE_TILES + k];
    row[0] = row[1], row[REFINE_TILES + 1] = row[REFINE_TILES];
    for (int k = 0, x = 0; k <= REFINE_TILES; k++) {
        const float from = ((float)k - 0.5f) * wide, rise = (row[k + 1] - row[k]) / wide;
        const int end = k < REFINE_TILES ? (int)(from + wide) : width;
        for (; x < end; x++) lift[x] = row[k] + rise * ((float)x - from);
    }
}

/* ---- noise ---- */

/* A camera's noise grows with the light (photons are counted): a line over grey. Where windows fit badly
 * their residuals are larger than noise, never smaller, so the line goes through the lowest tenth of each
 * band of grey; a tenth of windows of 81 noisy pixels lie LOW below the mean. */
enum { BANDS = 16, OCTAVE = 8, BINS = 40 * OCTAVE };
static const double LOWEST = 0.1, LOW = 1.44;

/* Eighths of an octave from 2^-20 on. */
static int bin_of(float variance)
{
    uint32_t bits;
    memcpy(&bits, &variance, sizeof bits);
    const int bin = (int)(bits >> 20) - (127 - 20) * OCTAVE;
    return MIN(MAX(bin, 0), BINS - 1);
}

static double value_of(double bin)
{
    const double whole = floor(bin / OCTAVE);
    return ldexp(1 + (bin - whole * OCTAVE) / OCTAVE, (int)whole - 20);
}

static double low_of(const uint32_t count[BINS], double all)
{
    double below = 0;
    int bin = 0;
    while (bin < BINS - 1 && below + count[bin] < LOWEST * all) below += count[bin++];
    return value_of(bin + (LOWEST * all - below) / MAX(count[bin], 1));
}

bool dense_fit_noise(dense_noise *noise, const td_image *left, const float *variance)
{
    uint32_t(*count)[BINS] = calloc(BANDS, sizeof *count);
    const size_t width = (size_t)left->width;
    double n = 0, x = 0, y = 0, xx = 0, xy = 0;
    *noise = (dense_noise){0, 0};
    if (!count) return false;
    for (size_t row = 2; row < (size_t)left->height; row += 4)
        for (size_t i = row * width; i < (row + 1) * width; i++)
            if (variance[i] >= 0) count[left->data[i] * BANDS / 256][bin_of(variance[i])]++;
    for (int band = 0; band < BANDS; band++) {
        double all = 0;
        for (int bin = 0; bin < BINS; bin++) all += count[band][bin];
        if (all < 100) continue;
        const double grey = (band + 0.5) * 256 / BANDS, low = LOW * low_of(count[band], all);
        n += all, x += all * grey, y += all * low, xx += all * grey * grey, xy += all * grey * low;
    }
    free(count);
    if (!(n > 0)) return true;
    const double spread = xx - x * x / n;
    const double rate = spread > n ? (xy - x * y / n) / spread : 0;
    *noise = (dense_noise){(float)((y - rate * x) / n), (float)rate};
    return true;
}
