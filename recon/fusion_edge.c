/* Where a disparity may be of another surface than its pixel's.
 *
 * A window that sees two surfaces gives one of them to all of its pixels, mostly the nearer ("foreground
 * fattening"; Scharstein & Szeliski 2002), or a value between: behind a stone's upper edge the stone seems to
 * go on, in steps too small for the check from the right image. The sigma of such a disparity knows nothing
 * of it. What shows it, in the disparities d, is the bulge at a distance of w pixels,
 *
 *     b_w(p) = 2 d(p) - d(p + w) - d(p - w),
 *
 * which is nothing on a plane however aslant, along rows, columns and both diagonals:
 *
 *     b_w(p) itself, w up to a window and a half: the pixel is nearer than what lies around it;
 *     |b_5| of any pixel within a window: an edge or a fold is near, on whichever side.
 *
 * The larger of the two, the second times NEARBY, held to MOST_BULGE (of large steps most are matched well,
 * for they are found out; right beside one, or beside the hole at one, MOST_BESIDE), bounds the error: on
 * rendered ground 68 % of them are below a fifth of it, 99 % below 0.7 of it. Below CHANCE it is noise and
 * roughness, which sigma holds.
 *
 * So few are wrong by so much that sigma would be far too large for the rest: but they are wrong in patches
 * of half a window's side, and how much such a patch is of a cell fusion_measure.c knows. */
#include <math.h>
#include <stdlib.h>

#include "core/parallel.h"
#include "recon/fusion_internal.h"

/* px. A window of the matching has 9; its sums reach farther. */
enum { REACH = 8, SHORT = 5, SPAN = 4, SPANS = 3, WAYS = 4 };
static const float NEARBY = 0.45f, MOST_BULGE = 3, MOST_BESIDE = 20, CHANCE = 1.35f; /* the last three px */
static const float BY_BULGE = 0.45f;
static const int ACROSS[WAYS] = {1, 0, 1, 1}, DOWN[WAYS] = {0, 1, 1, -1};

enum { BLOCK = 256 }; /* columns that are worked on at a time */

typedef struct work {
    const td_disparity *disparity;
    float *along; /* (height,width) largest |b| within reach along the row */
    float *edge;  /* (height,width) the result; before that each row's |b| */
} work;

/* As fmaxf and fminf for a first that is a number, but without a call. */
static float larger(float a, float b)
{
    return b > a ? b : a;
}

static float smaller(float a, float b)
{
    return b < a ? b : a;
}

/* The columns, of first <= x < end, that have both neighbours dx away. */
static void clip(int *first, int *end, int dx, int width)
{
    if (*first < dx) *first = dx;
    if (*end > width - dx) *end = width - dx;
}

/* Of a row its |b_5|, filled pixels too: there, it is the background. */
static void find_bulges(float *most, const td_disparity *d, int y)
{
    for (int x = 0; x < d->width; x++) most[x] = 0;
    for (int way = 0; way < WAYS; way++) {
        const int dx = SHORT * ACROSS[way], dy = SHORT * DOWN[way], v = abs(dy);
        int first = 0, end = d->width;
        if (y < v || y + v >= d->height) continue;
        clip(&first, &end, dx, d->width);
        const float *here = d->value + (size_t)y * (size_t)d->width;
        const float *to = here + dy * d->width + dx, *from = here - dy * d->width - dx;
        for (int x = first; x < end; x++) most[x] = larger(most[x], fabsf(2 * here[x] - to[x] - from[x]));
    }
}

/* The largest within REACH, in five steps: of 2, 4, 8, 16 and 17 pixels. */
static void spread(float *to, const float *from, int first, int count, int width)
{
    float m[BLOCK + 2 * REACH];
    for (int i = 0; i < count + 2 * REACH; i++) {
        const int x = first + i - REACH;
        m[i] = x < 0 || x >= width ? 0 : from[x];
    }
    for (int i = 0; i < count; i++) to[i] = m[i + 2 * REACH];
    for (int step = 1, n = count + 2 * REACH; step < 2 * REACH; step *= 2) {
        n -= step;
        for (int i = 0; i < n; i++) m[i] = larger(m[i], m[i + step]);
    }
    for (int i = 0; i < count; i++) to[i] = larger(to[i], m[i]);
}

static void look_along(size_t row, void *user)
{
    const work *w = user;
    const int width = w->disparity->width;
    float *here = w->edge + row * (size_t)width, *along = w->along + row * (size_t)width;
    find_bulges(here, w->disparity, (int)row);
    for (int x = 0; x < width; x += BLOCK)
        spread(along + x, here, x, width - x < BLOCK ? width - x : BLOCK, width);
}

/* Raises `most` to the pixels' own bulges, and `beside` to the largest of those at the smallest distance of
 * each way that both sides are known at. */
static void add_own(float *most, float *beside, const td_disparity *d, int y, int start, int stop)
{
    const float *here = d->value + (size_t)y * (size_t)d->width;
    for (int way = 0; way < WAYS; way++) {
        float nearest[BLOCK];
        for (int i = 0; i < stop - start; i++) nearest[i] = NAN;
        for (int k = 1; k <= SPANS; k++) {
            const int dx = k * SPAN * ACROSS[way], dy = k * SPAN * DOWN[way], v = abs(dy);
            int first = start, end = stop;
            if (y < v || y + v >= d->height) break;
            clip(&first, &end, dx, d->width);
            const float *to = here + dy * d->width + dx, *from = here - dy * d->width - dx;
            for (int x = first; x < end; x++) {
                const float b = 2 * here[x] - to[x] - from[x], old = nearest[x - start];
                most[x - start] = larger(most[x - start], b);
                nearest[x - start] = old == old ? old : b;
            }
        }
        for (int i = 0; i < stop - start; i++) beside[i] = larger(beside[i], nearest[i]);
    }
}

static void look_down(size_t row, void *user)
{
    const work *w = user;
    const td_disparity *d = w->disparity;
    const int y = (int)row, last = y + REACH < d->height ? y + REACH : d->height - 1;
    for (int start = 0; start < d->width; start += BLOCK) {
        const int count = d->width - start < BLOCK ? d->width - start : BLOCK;
        float most[BLOCK] = {0}, beside[BLOCK] = {0}, *edge = w->edge + row * (size_t)d->width + start;
        for (int v = y < REACH ? 0 : y - REACH; v <= last; v++) {
            const float *along = w->along + (size_t)v * (size_t)d->width + start;
            for (int i = 0; i < count; i++) most[i] = larger(most[i], along[i]);
        }
        for (int i = 0; i < count; i++) most[i] *= NEARBY;
        add_own(most, beside, d, y, start, start + count);
        for (int i = 0; i < count; i++) {
            const float held = larger(smaller(most[i], MOST_BULGE), smaller(beside[i], MOST_BESIDE));
            edge[i] = BY_BULGE * sqrtf(larger(0, held * held - CHANCE * CHANCE));
        }
    }
}

td_status td_frame_edges(float **edge, const td_disparity *d, int threads, td_error *error)
{
    const size_t n = (size_t)d->width * (size_t)d->height;
    work w = {d, malloc(n * sizeof(float)), malloc(n * sizeof(float))};
    const bool fine = w.along && w.edge;
    if (fine) {
        td_parallel_for((size_t)d->height, threads, look_along, &w, NULL, NULL);
        td_parallel_for((size_t)d->height, threads, look_down, &w, NULL, NULL);
    } else {
        free(w.edge);
        w.edge = NULL;
    }
    free(w.along);
    *edge = w.edge;
    return fine ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the edges of a frame");
}
