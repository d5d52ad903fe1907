/* The refinement's loops over a row, included where dense_loops_internal.h is, and for the same reason. */
#ifndef TELEDIMOS_RECON_DENSE_REFINE_LOOPS_INTERNAL_H
#define TELEDIMOS_RECON_DENSE_REFINE_LOOPS_INTERNAL_H

#include <math.h>

#include "recon/dense_refine_internal.h"

/* px: neighbours that differ by more belong to another surface. */
static const float SAME_SURFACE = 0.75f;
static const float MOST_STEP = 0.5f, FEWEST = 20;
/* Grey levels a pixel: below it, a window's slope is nothing to go by. */
static const float LEAST_SLOPE = 0.5f;
/* Of a residual's noise, what a slope has: two differences over two pixels each, halved, of two images. */
static const float SLOPE_NOISE = 0.125f;
/* The model of sigma (dense_refine.c). */
static const float BY_NOISE = 1.8f, BY_MISFIT = 0.3f, BY_ROWS = 2.4f, BY_BEND = 0.4f;
static const float PIXELS = REFINE_SIDE * REFINE_SIDE;
static const float LEAST_NOISE = 0.1f; /* grey levels^2: rounding */
static const float CHANCE = 1.5f;      /* noise's variance in a window may be so many times the mean */
static const float MOST_BEND = 2;      /* px */

/* The mean of neighbours that belong to the same surface, in pairs left and right (or above and below), so
 * that slopes stay as they are. `apart`: elements from one neighbour to the next. `reach` is a constant where
 * it is called, so that the loop over it is unrolled. */
static inline void refine_mean(float *restrict out, const float *restrict value, int begin, int end,
                               ptrdiff_t apart, int reach)
{
    for (int x = begin; x < end; x++) {
        const float *here = value + x;
        float sum = 0, n = 1;
        for (int k = 1; k <= reach; k++) {
            const float a = here[-k * apart] - *here, b = here[k * apart] - *here;
            const float mine = fabsf(a) < SAME_SURFACE ? 1.0f : 0.0f; /* 0 for NaN */
            const float same = fabsf(b) < SAME_SURFACE ? mine : 0.0f;
            sum += same > 0 ? a + b : 0.0f;
            n += 2 * same;
        }
        out[x] = *here + sum / n;
    }
}

static void refine_smooth(float *restrict out, const float *restrict value, int begin, int end,
                          ptrdiff_t apart, int reach)
{
    if (reach == REFINE_WINDOW)
        refine_mean(out, value, begin, end, apart, REFINE_WINDOW);
    else
        refine_mean(out, value, begin, end, apart, reach);
}

static inline int16_t refine_eighths(float grey)
{
    const float most = REFINE_MOST, up = grey * REFINE_ONE;
    const float held = up < -most ? -most : up > most ? most : up;
    return (int16_t)((int)(held + (most + 0.5f)) - REFINE_MOST);
}

/* Keys' cubic (a = -1/2) through the right image's pixels, and its derivative. */
static void refine_look_span(const dense_look *w, int begin, int end)
{
    for (int x = begin; x < end; x++) {
        const float to = (float)x - w->value[x];
        const bool with = w->kind[x] == TD_DENSE_MATCHED && to >= 1 && to < (float)(w->width - 2);
        const float at = with ? to : 1;
        const int i = (int)at;
        const uint8_t *row = w->right + i;
        const float t = at - (float)i, a = row[-1], b = row[0], c = row[1], d = row[2];
        const float p = c - a, q = 2 * a - 5 * b + 4 * c - d, s = 3 * (b - c) + d - a;
        const float grey = b + 0.5f * t * (p + t * (q + t * s));
        const float slope = 0.5f * (p + t * (2 * q + 3 * t * s));
        const float beside = 0.5f * ((float)w->left[x + 1] - (float)w->left[x - 1]);
        const float down = 0.5f * ((float)w->below[x] - (float)w->above[x]);
        const float residual = (float)w->left[x] - w->gain * grey - w->lift[x] * down;
        const int16_t g = refine_eighths(0.5f * (w->gain * slope + beside)), r = refine_eighths(residual);
        w->slope[x] = with ? g : 0;
        w->residual[x] = with ? r : 0;
        w->with[x] = with;
    }
}

/* Adds a term of a row to its sums over columns, or takes it off. */
static inline void refine_add_one(int32_t *restrict sum, const int16_t *restrict a, int sign, int width)
{
    for (int x = 0; x < width; x++) sum[x] += sign * a[x];
}

static inline void refine_add_product(int32_t *restrict sum, const int16_t *a, const int16_t *b, int sign,
                                      int width)
{
    for (int x = 0; x < width; x++) sum[x] += sign * (a[x] * b[x]);
}

/* sum (6,width): n, g, r, gg, gr, rr. */
static void refine_add(int32_t *sum, const int16_t *slope, const int16_t *residual, const int16_t *with,
                       int sign, int width)
{
    refine_add_one(sum, with, sign, width);
    refine_add_one(sum + width, slope, sign, width);
    refine_add_one(sum + 2 * width, residual, sign, width);
    refine_add_product(sum + 3 * width, slope, slope, sign, width);
    refine_add_product(sum + 4 * width, slope, residual, sign, width);
    refine_add_product(sum + 5 * width, residual, residual, sign, width);
}

/* Sums over windows of nine, by twos, fours and eights; `work` (2,width). */
static void refine_across(int32_t *restrict sum, const int32_t *restrict column, int32_t *restrict work,
                          int width)
{
    int32_t *restrict four = work + width;
    for (int x = 0; x < width - 1; x++) work[x] = column[x] + column[x + 1];
    for (int x = 0; x < width - 3; x++) four[x] = work[x] + work[x + 2];
    for (int x = 0; x < REFINE_WINDOW; x++) sum[x] = sum[width - 1 - x] = 0;
    for (int x = 0; x < width - 2 * REFINE_WINDOW; x++)
        sum[x + REFINE_WINDOW] = four[x] + four[x + 4] + column[x + 8];
}

/* What the windows' sums say of a pixel. */
typedef struct window_fit {
    float step, variance, weight; /* px; of a residual; 1 / G_gg, noise taken off */
    bool good;
} window_fit;

static inline window_fit refine_fit(const int32_t *restrict sums, const int16_t *restrict with, int x,
                                    int width)
{
    const float unit = 1.0f / (REFINE_ONE * REFINE_ONE);
    const float n = (float)sums[x], g = (float)sums[width + x], r = (float)sums[2 * width + x];
    const float share = 1 / (n > 1 ? n : 1);
    const float gg = unit * ((float)sums[3 * width + x] - g * g * share);
    const float gr = unit * ((float)sums[4 * width + x] - g * r * share);
    const float rr = unit * ((float)sums[5 * width + x] - r * r * share);
    const float safe = gg > 1e-3f ? gg : 1e-3f, slope = gr / safe, left = rr - slope * gr;
    const float variance = (left > 0 ? left : 0) / (n > 3 ? n - 2 : 1);
    const float known = gg - n * SLOPE_NOISE * variance, enough = n * (LEAST_SLOPE * LEAST_SLOPE);
    const bool good = (n >= FEWEST) & (with[x] != 0) & (known > enough);
    const float held = slope < -MOST_STEP ? -MOST_STEP : slope > MOST_STEP ? MOST_STEP : slope;
    return (window_fit){-held, variance, 1 / (good ? known : 1), good};
}

static void refine_step(float *restrict to, const float *restrict value, const int32_t *restrict sums,
                        const int16_t *restrict with, int width)
{
    for (int x = 0; x < width; x++) {
        const window_fit f = refine_fit(sums, with, x, width);
        to[x] = value[x] + (f.good ? f.step : 0);
    }
}

/* What sigma is made of; the pixels without a fit keep the matching's. */
static void refine_vary(float *restrict variance, float *restrict weight, const int32_t *restrict sums,
                        const int16_t *restrict with, int width)
{
    for (int x = 0; x < width; x++) {
        const window_fit f = refine_fit(sums, with, x, width);
        variance[x] = f.good ? f.variance : -1;
        weight[x] = f.weight;
    }
}

/* Mean square of how far a pixel lies off the middle of neighbours on both sides, 2 and 4 px away. */
static void refine_bend(float *restrict bend, const float *here, const float *const side[8], int begin,
                        int end)
{
    for (int x = begin; x < end; x++) {
        float sum = 0;
        for (int k = 0; k < 8; k += 2) {
            const float off = fabsf(side[k][x] + side[k + 1][x] - 2 * here[x]);
            const float held = off < MOST_BEND ? off : MOST_BEND; /* also for NaN */
            sum += held * held;
        }
        bend[x] = 0.25f * sum;
    }
}

/* sigma (px): of a pixel without a fit it stays the matching's. */
static void refine_trust(float *restrict sigma, const dense_trust *of, int width)
{
    const float *restrict variance = of->variance, *restrict weight = of->weight, *restrict bend = of->bend;
    const uint8_t *restrict grey = of->grey;
    const float base = of->base, rate = of->rate, rows = BY_ROWS * BY_ROWS * of->rows;
    for (int x = 0; x < width; x++) {
        const float line = base + rate * (float)grey[x], noise = line > LEAST_NOISE ? line : LEAST_NOISE;
        const float over = variance[x] - CHANCE * noise, misfit = over > 0 ? over : 0;
        const float by_window = BY_NOISE * BY_NOISE * variance[x] + PIXELS * BY_MISFIT * BY_MISFIT * misfit;
        const float all = by_window * weight[x] + BY_BEND * BY_BEND * bend[x] + rows;
        const float root = sqrtf(all > 0 ? all : 0);
        sigma[x] = variance[x] >= 0 ? root : sigma[x];
    }
}

#endif
