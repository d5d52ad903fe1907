/* Disparities to a small fraction of a pixel, by the grey values themselves.
 *
 * Summed costs are biased on slopes (paths come from above and from the sides, not from below, so that a
 * disparity lags behind its plane by about a row) and pulled towards fractions of their own. Here each
 * matched pixel q is looked up in the right image at its own disparity; over the window around p the
 * residuals r and the slopes g say by how much all of them are off (least squares with a free offset of grey;
 * Lucas and Kanade 1981, the slope from both images):
 *
 *     delta(p) = - (sum g r - sum g sum r / n) / (sum g^2 - (sum g)^2 / n)
 *
 * Every pixel of the window brings its own disparity, so slanted and curved surfaces stay as they are. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum { WINDOW = 4, SIDE = 2 * WINDOW + 1, BAND = 16, FEWEST = 20, ROUNDS = 2 };

/* Grey levels a pixel: below it, a window's slope is noise. */
static const float LEAST_SLOPE = 0.5f;
static const float MOST_STEP = 0.5f;
/* Standard deviation: the 68 % quantile of errors on pixels that both cameras see, of Motorcycle and of
 * rendered sites. The last step, which should be nothing, tells how unsettled a place is; noise and contrast
 * of the window add nothing to it. */
static const float FLOOR = 0.115f, UNSETTLED = 1.35f;
static const float SAME = 0.75f; /* px: neighbours that differ by more belong to another surface */

typedef struct refinement {
    const td_image *left, *right;
    td_disparity *result;
    float *value;            /* (height,width) after this round */
    float *slope, *residual; /* (height,width); slope NaN-free, 0 with `with` 0 */
    float *with;             /* (height,width) 1 where the pixel takes part */
    float gain;              /* right to left */
    bool last;               /* round: sigmas are written too */
    bool *failed;            /* (bands) */
} refinement;

/* Keys' cubic (a = -1/2) at `at` pixels of a row, and its derivative; the row is not left: 1 <= at < width
 * - 2. */
static float look_up(float *slope, const uint8_t *row, float at)
{
    int i = (int)at;
    float t = at - (float)i, a = row[i - 1], b = row[i], c = row[i + 1], d = row[i + 2];
    float p = c - a, q = 2 * a - 5 * b + 4 * c - d, s = 3 * (b - c) + d - a;
    *slope = 0.5f * (p + t * (2 * q + 3 * t * s));
    return b + 0.5f * t * (p + t * (q + t * s));
}

/* The mean of neighbours that belong to the same surface, in pairs left and right (or above and below), so
 * that slopes stay as they are. `apart`: elements from one neighbour to the next. */
static void smooth_row(float *restrict out, const float *restrict value, size_t begin, size_t end,
                       ptrdiff_t apart, int reach)
{
    for (size_t x = begin; x < end; x++) {
        const float *here = value + x;
        float sum = 0, n = 1;
        for (int k = 1; k <= reach; k++) {
            const float a = here[-k * apart] - *here, b = here[k * apart] - *here;
            const bool same = fabsf(a) < SAME && fabsf(b) < SAME; /* false for NaN */
            sum += same ? a + b : 0;
            n += same ? 2 : 0;
        }
        out[x] = *here + sum / n;
    }
}

/* Along the rows into `value`, then down the columns back into the result. */
static void smooth_along(size_t index, void *user)
{
    const refinement *w = user;
    const size_t width = (size_t)w->left->width;
    const int end = (int)(index + 1) * BAND;
    for (int y = (int)index * BAND; y < end && y < w->left->height; y++) {
        float *to = w->value + (size_t)y * width;
        const float *from = w->result->value + (size_t)y * width;
        memcpy(to, from, width * sizeof *to);
        smooth_row(to, from, WINDOW, width - WINDOW, 1, WINDOW);
    }
}

static void smooth_down(size_t index, void *user)
{
    const refinement *w = user;
    const size_t width = (size_t)w->left->width;
    const int end = (int)(index + 1) * BAND, height = w->left->height;
    for (int y = (int)index * BAND; y < end && y < height; y++) {
        const int room = y < height - 1 - y ? y : height - 1 - y;
        smooth_row(w->result->value + (size_t)y * width, w->value + (size_t)y * width, 0, width,
                   (ptrdiff_t)width, room < WINDOW ? room : WINDOW);
    }
}

/* left = gain right + offset, over every fourth row: cameras may be exposed differently. */
static float fit_gain(const refinement *w)
{
    const int width = w->left->width;
    double n = 0, a = 0, b = 0, ab = 0, bb = 0;
    for (int y = 2; y < w->left->height; y += 4)
        for (int x = 1; x + 1 < width; x++) {
            const size_t at = (size_t)y * (size_t)width + (size_t)x;
            const float to = (float)x - w->result->value[at];
            float slope;
            if (w->result->kind[at] != TD_DENSE_MATCHED || !(to >= 1) || to >= (float)(width - 2)) continue;
            const double l = w->left->data[at], r = look_up(&slope, w->right->data + at - x, to);
            n++, a += l, b += r, ab += l * r, bb += r * r;
        }
    const double variance = bb - b * b / n, gain = (ab - a * b / n) / variance;
    return n > 1000 && variance > 4 * n && gain > 0.25 && gain < 4 ? (float)gain : 1;
}

static void look_band(size_t index, void *user)
{
    const refinement *w = user;
    const int width = w->left->width, end = (int)(index + 1) * BAND;
    for (int y = (int)index * BAND; y < end && y < w->left->height; y++) {
        const size_t at = (size_t)y * (size_t)width;
        const uint8_t *l = w->left->data + at, *r = w->right->data + at;
        for (int x = 0; x < width; x++) {
            const float to = (float)x - w->result->value[at + (size_t)x];
            float slope = 0, residual = 0;
            const bool with = w->result->kind[at + (size_t)x] == TD_DENSE_MATCHED && to >= 1 &&
                              to < (float)(width - 2) && x > 0 && x + 1 < width;
            if (with) {
                residual = (float)l[x] - w->gain * look_up(&slope, r, to);
                slope = 0.5f * (w->gain * slope + 0.5f * (float)(l[x + 1] - l[x - 1]));
            }
            w->slope[at + (size_t)x] = slope;
            w->residual[at + (size_t)x] = residual;
            w->with[at + (size_t)x] = with;
        }
    }
}

/* Sums over a column of the window: n, g, r, gg, gr (5,width). */
static void sum_columns(float *restrict sum, const refinement *w, int y)
{
    const size_t width = (size_t)w->left->width;
    memset(sum, 0, 5 * width * sizeof *sum);
    for (int k = -WINDOW; k <= WINDOW; k++) {
        if (y + k < 0 || y + k >= w->left->height) continue;
        const size_t at = (size_t)(y + k) * width;
        const float *restrict g = w->slope + at, *restrict r = w->residual + at, *restrict n = w->with + at;
        for (size_t x = 0; x < width; x++) {
            sum[x] += n[x];
            sum[width + x] += g[x];
            sum[2 * width + x] += r[x];
            sum[3 * width + x] += g[x] * g[x];
            sum[4 * width + x] += g[x] * r[x];
        }
    }
}

static void sum_rows(float *restrict sum, const float *restrict column, size_t width)
{
    for (size_t q = 0; q < 5; q++) {
        const float *from = column + q * width;
        float *to = sum + q * width;
        memset(to, 0, width * sizeof *to);
        for (size_t x = WINDOW; x + WINDOW < width; x++) {
            float all = 0;
            for (size_t k = 0; k < SIDE; k++) all += from[x + k - WINDOW];
            to[x] = all;
        }
    }
}

static void step_row(const refinement *w, const float *sum, int y)
{
    const size_t width = (size_t)w->left->width, at = (size_t)y * width;
    for (size_t x = 0; x < width; x++) {
        const float n = sum[x], value = w->result->value[at + x];
        w->value[at + x] = value;
        if (n < FEWEST || w->with[at + x] == 0) continue;
        const float g = sum[width + x] / n, r = sum[2 * width + x] / n;
        const float gg = sum[3 * width + x] - n * g * g, gr = sum[4 * width + x] - n * g * r;
        if (!(gg > n * LEAST_SLOPE * LEAST_SLOPE)) continue;
        const float step = -gr / gg;
        w->value[at + x] = value + fminf(fmaxf(step, -MOST_STEP), MOST_STEP);
        if (!w->last) continue;
        w->result->sigma[at + x] = sqrtf(FLOOR * FLOOR + UNSETTLED * UNSETTLED * step * step);
    }
}

static void step_band(size_t index, void *user)
{
    const refinement *w = user;
    const size_t width = (size_t)w->left->width;
    float *sum = malloc(10 * width * sizeof *sum);
    w->failed[index] = !sum;
    const int end = (int)(index + 1) * BAND;
    for (int y = (int)index * BAND; y < end && y < w->left->height && sum; y++) {
        sum_columns(sum + 5 * width, w, y);
        sum_rows(sum, sum + 5 * width, width);
        step_row(w, sum, y);
    }
    free(sum);
}

td_status dense_refine(td_disparity *result, const td_image *left, const td_image *right, int threads)
{
    const size_t pixels = (size_t)left->width * (size_t)left->height,
                 bands = ((size_t)left->height + BAND - 1) / BAND;
    refinement w = {.left = left, .right = right, .result = result};
    bool failed = false;
    if (left->width <= SIDE) return TD_OK;
    float *planes = malloc(4 * pixels * sizeof *planes);
    w.failed = calloc(bands, sizeof *w.failed);
    if (planes && w.failed) {
        w.value = planes, w.slope = planes + pixels, w.residual = planes + 2 * pixels,
        w.with = planes + 3 * pixels;
        w.gain = fit_gain(&w);
        for (int k = 0; k < ROUNDS && !failed; k++) {
            w.last = k + 1 == ROUNDS;
            td_parallel_for(bands, threads, smooth_along, &w, NULL, NULL);
            td_parallel_for(bands, threads, smooth_down, &w, NULL, NULL);
            td_parallel_for(bands, threads, look_band, &w, NULL, NULL);
            td_parallel_for(bands, threads, step_band, &w, NULL, NULL);
            for (size_t b = 0; b < bands; b++) failed |= w.failed[b];
            if (!failed) memcpy(result->value, w.value, pixels * sizeof *w.value);
        }
    }
    const bool none = !planes || !w.failed;
    free(planes);
    free(w.failed);
    return none || failed ? TD_ERROR_MEMORY : TD_OK;
}
