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

typedef struct work {
    const td_disparity *disparity;
    float *along; /* (height,width) largest |b| within reach along the row */
    float *edge;  /* (height,width) the result; before that each row's |b| */
} work;

/* Filled pixels count too: there, it is the background. NaN: none. */
static float at(const td_disparity *d, int x, int y)
{
    if (x < 0 || y < 0 || x >= d->width || y >= d->height) return NAN;
    return d->value[(size_t)y * (size_t)d->width + (size_t)x];
}

static float bulge(const td_disparity *d, int x, int y, int w, int way)
{
    const int dx = w * ACROSS[way], dy = w * DOWN[way];
    return 2 * at(d, x, y) - at(d, x + dx, y + dy) - at(d, x - dx, y - dy);
}

static void look_along(size_t row, void *user)
{
    const work *w = user;
    const td_disparity *d = w->disparity;
    const size_t first = row * (size_t)d->width;
    float *here = w->edge + first, *along = w->along + first;
    for (int x = 0; x < d->width; x++) {
        here[x] = 0;
        for (int way = 0; way < WAYS; way++)
            here[x] = fmaxf(here[x], fabsf(bulge(d, x, (int)row, SHORT, way)));
    }
    for (int x = 0; x < d->width; x++) {
        const int end = x + REACH < d->width ? x + REACH : d->width - 1;
        along[x] = 0;
        for (int u = x < REACH ? 0 : x - REACH; u <= end; u++) along[x] = fmaxf(along[x], here[u]);
    }
}

/* Raises `edge` to the pixel's own bulge; returns the largest of those at the smallest distance of each way
 * that both sides are known at. */
static float own_bulge(float *edge, const td_disparity *d, int x, int y)
{
    const size_t width = (size_t)d->width, here = (size_t)y * width + (size_t)x;
    const float twice = 2 * d->value[here];
    float beside = 0, most = *edge;
    if (isnan(twice)) return 0;
    for (int way = 0; way < WAYS; way++) {
        const int dx = SPAN * ACROSS[way], dy = SPAN * DOWN[way];
        bool first = true;
        for (int k = 1; k <= SPANS; k++) {
            const int u = k * dx, v = abs(k * dy);
            if (x < u || x + u >= d->width || y < v || y + v >= d->height) break;
            const float *to = &d->value[here] + k * dy * d->width + u,
                        *from = &d->value[here] - k * dy * d->width - u;
            const float b = twice - *to - *from;
            if (isnan(b)) continue;
            most = fmaxf(most, b);
            if (first) beside = fmaxf(beside, b);
            first = false;
        }
    }
    *edge = most;
    return beside;
}

static void look_down(size_t row, void *user)
{
    const work *w = user;
    const td_disparity *d = w->disparity;
    const int y = (int)row, end = y + REACH < d->height ? y + REACH : d->height - 1;
    float *edge = w->edge + row * (size_t)d->width;
    for (int x = 0; x < d->width; x++) edge[x] = 0;
    for (int v = y < REACH ? 0 : y - REACH; v <= end; v++) {
        const float *along = w->along + (size_t)v * (size_t)d->width;
        for (int x = 0; x < d->width; x++) edge[x] = fmaxf(edge[x], NEARBY * along[x]);
    }
    for (int x = 0; x < d->width; x++) {
        const float beside = own_bulge(&edge[x], d, x, y);
        const float held = fmaxf(fminf(edge[x], MOST_BULGE), fminf(beside, MOST_BESIDE));
        edge[x] = BY_BULGE * sqrtf(fmaxf(0, held * held - CHANCE * CHANCE));
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
