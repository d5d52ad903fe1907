/* How far the disparities around a pixel lie off their plane.
 *
 * A window that sees two surfaces, or one that bends within it, gives its pixels something between; the wrong
 * values look smooth, and the sigma of the matching knows nothing of them. But no disparity in a window is
 * farther off than what the window sees lies apart. With R the standard deviation of the disparities off
 * their plane over 20 x 20 px (a window of 9 and half of one around it), on rendered ground, at 2 to 15 m,
 *
 *     68 % of the errors are below 1.1 R and 99.9 % below 4.5 R wherever R is at most 1.3 sigma;
 *     99.9 % below 5 R where it is larger, to any size.
 *
 * So a disparity's standard deviation is at least R. Sums are of blocks of 4 x 4 px; filled pixels count
 * too: there, it is the background. */
#include <math.h>
#include <stdlib.h>

#include "core/parallel.h"
#include "recon/fusion_internal.h"

enum { REACH = 2, FEWEST = 10 };         /* blocks to each side; pixels that tell of a plane */
static const double LEAST_SPREAD = 1e-3; /* of the pixels across their longer direction, squared */

typedef struct sums {
    double n, x, y, z, xx, xy, yy, xz, yz, zz;
} sums;

typedef struct work {
    const td_disparity *disparity;
    sums *block; /* (rows,columns) */
    float *relief;
    int columns, rows;
} work;

/* Adds a column of blocks, or takes it off again. */
static void add_column(sums *to, const work *w, int x, int top, int end, double sign)
{
    if (x < 0 || x >= w->columns) return;
    for (int y = top; y <= end; y++) {
        const sums *b = &w->block[(size_t)y * (size_t)w->columns + (size_t)x];
        to->n += sign * b->n;
        to->x += sign * b->x, to->y += sign * b->y, to->z += sign * b->z;
        to->xx += sign * b->xx, to->xy += sign * b->xy, to->yy += sign * b->yy;
        to->xz += sign * b->xz, to->yz += sign * b->yz, to->zz += sign * b->zz;
    }
}

static void sum_blocks(size_t row, void *user)
{
    const work *w = user;
    const td_disparity *d = w->disparity;
    const int first = (int)row * TD_RELIEF_BLOCK, end = first + TD_RELIEF_BLOCK;
    for (int y = first; y < end && y < d->height; y++)
        for (int x = 0; x < d->width; x++) {
            const double z = (double)d->value[(size_t)y * (size_t)d->width + (size_t)x];
            sums *to = &w->block[row * (size_t)w->columns + (size_t)(x / TD_RELIEF_BLOCK)];
            if (isnan(z)) continue;
            to->n++;
            to->x += x, to->y += y, to->z += z;
            to->xx += (double)x * x, to->xy += (double)x * y, to->yy += (double)y * y;
            to->xz += x * z, to->yz += y * z, to->zz += z * z;
        }
}

/* Standard deviation off the plane through them; 0: they tell of none. */
static double off_plane(const sums *s)
{
    if (s->n < FEWEST) return 0;
    const double xx = s->xx - s->x * s->x / s->n, xy = s->xy - s->x * s->y / s->n,
                 yy = s->yy - s->y * s->y / s->n, xz = s->xz - s->x * s->z / s->n,
                 yz = s->yz - s->y * s->z / s->n, zz = s->zz - s->z * s->z / s->n;
    const double det = xx * yy - xy * xy;
    if (!(det > LEAST_SPREAD * xx * yy)) return 0;
    const double a = (yy * xz - xy * yz) / det, b = (xx * yz - xy * xz) / det;
    return sqrt(fmax(0, zz - a * xz - b * yz) / s->n);
}

static void find_relief(size_t row, void *user)
{
    const work *w = user;
    const int y = (int)row, top = y < REACH ? 0 : y - REACH;
    const int end = y + REACH < w->rows ? y + REACH : w->rows - 1;
    sums all = {0};
    for (int x = 0; x < REACH; x++) add_column(&all, w, x, top, end, 1);
    for (int x = 0; x < w->columns; x++) {
        add_column(&all, w, x + REACH, top, end, 1);
        add_column(&all, w, x - REACH - 1, top, end, -1);
        w->relief[row * (size_t)w->columns + (size_t)x] = (float)off_plane(&all);
    }
}

td_status td_frame_relief(float **relief, const td_disparity *d, int threads, td_error *error)
{
    work w = {.disparity = d,
              .columns = (d->width + TD_RELIEF_BLOCK - 1) / TD_RELIEF_BLOCK,
              .rows = (d->height + TD_RELIEF_BLOCK - 1) / TD_RELIEF_BLOCK};
    const size_t n = (size_t)w.columns * (size_t)w.rows;
    w.block = calloc(n, sizeof *w.block);
    *relief = w.relief = malloc(n * sizeof *w.relief);
    const bool fine = w.block && w.relief;
    if (fine) {
        td_parallel_for((size_t)w.rows, threads, sum_blocks, &w, NULL, NULL);
        td_parallel_for((size_t)w.rows, threads, find_relief, &w, NULL, NULL);
    } else {
        free(w.relief);
        *relief = NULL;
    }
    free(w.block);
    return fine ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the relief of a frame");
}
