/* Loops over the pixels of a row that the compiler turns into vector instructions by itself. Included twice:
 * by dense_loops.c for any processor, by dense_avx2.c for those with AVX2; the same operations, so the same
 * bytes. */
#ifndef TELEDIMOS_RECON_DENSE_LOOPS_INTERNAL_H
#define TELEDIMOS_RECON_DENSE_LOOPS_INTERNAL_H

#include "recon/dense_internal.h"
#include "recon/dense_refine_loops_internal.h"

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

enum {
    LEAST_P2 = 20,
    SAME = 3 * DENSE_ONE / 4, /* neighbours of one surface */
    MOST = 2 * DENSE_ONE
};

/* Coefficients of the regression, px; spread in 1/32 px summed over 8 neighbours. */
static const float BASE = 0.07f, FLAT = 6.6f, ROUND = 20, MISFIT = 0.0005f, EDGE = 0.0016f;
static const float FILLED = 1.5f, FILLED_EDGE = 0.02f;

/* A byte of census: eight neighbours. */
static void census_byte(uint8_t *restrict code, const uint8_t *centre, const uint8_t *const n[8], int width)
{
    const uint8_t *a = n[0], *b = n[1], *c = n[2], *d = n[3], *e = n[4], *f = n[5], *g = n[6], *h = n[7];
    for (int x = 0; x < width; x++) {
        uint8_t m = centre[x];
        uint8_t low =
            (uint8_t)((a[x] < m ? 1 : 0) | (b[x] < m ? 2 : 0) | (c[x] < m ? 4 : 0) | (d[x] < m ? 8 : 0));
        uint8_t high =
            (uint8_t)((e[x] < m ? 16 : 0) | (f[x] < m ? 32 : 0) | (g[x] < m ? 64 : 0) | (h[x] < m ? 128 : 0));
        code[x] = low | high;
    }
}

/* A jump costs less where grey values step: edges of things show. Six a grey value, in bytes alone. */
static void penalties(uint8_t *restrict p2, const uint8_t *a, const uint8_t *b, int count)
{
    const uint8_t most = (DENSE_P2 - LEAST_P2) / 6;
    for (int x = 0; x < count; x++) {
        uint8_t off = (uint8_t)(MAX(a[x], b[x]) - MIN(a[x], b[x]));
        uint8_t cut = MIN(off, most), twice = (uint8_t)(cut + cut);
        uint8_t fall = (uint8_t)((uint8_t)(twice + twice) + twice);
        p2[x] = (uint8_t)(DENSE_P2 - fall);
    }
}

/* Where between the two neighbours' slopes the least lies: DENSE_FRACTIONS in the middle, twice or none of it
 * half a pixel off. */
static void places(uint8_t *restrict place, uint8_t *restrict curvature, const uint8_t *restrict least,
                   const uint8_t *restrict before, const uint8_t *restrict after, int width)
{
    for (int x = 0; x < width; x++) {
        int b = before[x], a = after[x];
        int p = b == 255 ? a : b, q = a == 255 ? b : a;
        int steeper = MAX(MAX(p, q) - least[x], 1), curve = p + q - 2 * least[x];
        float share = (float)(p - q) / (float)steeper;
        place[x] = (uint8_t)((int)(share * DENSE_FRACTIONS + DENSE_FRACTIONS + 0.5f));
        curvature[x] = (uint8_t)MIN(curve, 255);
    }
}

/* Median of 3x3 by sorted columns: the middle of the greatest least, the middle middle, the least greatest.
 */
static void median_row(int16_t *restrict to, const int16_t *restrict up, const int16_t *restrict here,
                       const int16_t *restrict down, int16_t *restrict work, int width)
{
    int16_t *restrict low = work, *restrict middle = work + width, *restrict high = middle + width;
    for (int x = 0; x < width; x++) {
        int16_t a = MIN(up[x], here[x]), b = MAX(up[x], here[x]), c = MAX(a, MIN(b, down[x]));
        low[x] = MIN(a, down[x]), middle[x] = c, high[x] = MAX(b, down[x]);
    }
    to[0] = here[0], to[width - 1] = here[width - 1];
    for (int x = 1; x < width - 1; x++) {
        int16_t a = MAX(MAX(low[x - 1], low[x]), low[x + 1]);
        int16_t p = MIN(middle[x - 1], middle[x]), q = MAX(middle[x - 1], middle[x]);
        int16_t b = MAX(p, MIN(q, middle[x + 1]));
        int16_t c = MIN(MIN(high[x - 1], high[x]), high[x + 1]);
        to[x] = MAX(MIN(a, b), MIN(MAX(a, b), c));
    }
}

/* Four neighbours of each pixel: their difference where they belong to the surface, and the spread. */
static void neighbours(int16_t *restrict sum, int16_t *restrict spread, const int16_t *here,
                       const int16_t *const there[4], int count)
{
    for (int x = 0; x < count; x++) {
        int16_t all = 0, size = 0;
        for (int k = 0; k < 4; k++) {
            int16_t off = (int16_t)(there[k][x] - here[x]), much = (int16_t)(off < 0 ? -off : off);
            all = (int16_t)(all + (much <= SAME ? off : 0));
            size = (int16_t)(size + MIN(much, MOST));
        }
        sum[x] = (int16_t)(sum[x] + all), spread[x] = (int16_t)(spread[x] + size);
    }
}

/* What the row holds, as if each pixel had something. */
static void convert_row(float *restrict value, float *restrict sigma, const int16_t *restrict disparity,
                        const uint8_t *restrict kind, const uint8_t *restrict curvature,
                        const uint8_t *restrict least, const int16_t *restrict sum,
                        const int16_t *restrict spread, float lowest, int width)
{
    const float share = 1.0f / (DENSE_MEAN_OF * DENSE_ONE), unit = 1.0f / DENSE_ONE;
    for (int x = 0; x < width; x++) {
        float wide = spread[x], sharp = (float)curvature[x] + ROUND;
        float matched = BASE + FLAT / sharp + MISFIT * (float)least[x] + EDGE * wide;
        float filled = FILLED + FILLED_EDGE * wide;
        value[x] = (float)disparity[x] * unit + (float)sum[x] * share + lowest;
        sigma[x] = kind[x] == TD_DENSE_FILLED ? filled : matched;
    }
}

static void reverse(uint8_t *restrict to, const uint8_t *restrict from, int count)
{
    for (int x = 0; x < count; x++) to[x] = from[count - 1 - x];
}

#define DENSE_LOOPS                                                                                          \
    {                                                                                                        \
        census_byte, penalties, places, median_row, neighbours, convert_row, reverse, refine_smooth,         \
            DENSE_LOOK, refine_add, refine_across, refine_step, refine_vary, refine_bend, refine_trust       \
    }

#endif
