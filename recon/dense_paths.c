/* Semi-global sums (Hirschmueller 2008, eq. 13) along three paths: from the left, from the right and from
 * above. Along a path
 *   L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q),   q the pixel before p,
 * with P2 lower where grey values step. Sums that pass a byte are cut
 * off at 255: no winner has them. */
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum {
    STRIPE = 160, /* rows, at least */
    RUN_IN = 8    /* rows above a stripe */
};

#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define MIN(a, b) ((a) < (b) ? (a) : (b))

static uint8_t add(int a, int b)
{
    return (uint8_t)(a + b > 255 ? 255 : a + b);
}

static int bits(unsigned x)
{
    int n = 0;
    for (; x; x &= x - 1) n++;
    return n;
}

/* Cost of the disparities of a pixel: bits of the census that differ, and the difference of grey values, cut
 * off where it says only "different". */
static void cost_pixel(uint8_t *cost, const dense_row *row, int x, dense_range range)
{
    const uint8_t *right[DENSE_PLANES];
    uint8_t left[DENSE_PLANES];
    for (int k = 0; k < DENSE_PLANES; k++) {
        left[k] = row->left[k][x];
        right[k] = row->right[k] + row->width - 1 - x;
    }
    for (int d = range.first; d < range.end; d++) {
        int n = bits((unsigned)((left[0] ^ right[0][d]) | (left[1] ^ right[1][d]) << 8 |
                                (left[2] ^ right[2][d]) << 16));
        int difference = abs(left[3] - right[3][d]);
        n += MIN(difference, DENSE_CUT);
        cost[d] = (uint8_t)(n | row->veil[d]);
    }
}

/* A step along a path, from values `from` whose least is `least`, to `to`, which may be the same. Returns the
 * least of the new ones. */
static uint8_t step(uint8_t *to, const uint8_t *from, uint8_t least, const uint8_t *cost, int p2,
                    dense_range range)
{
    uint8_t lowest = 255, below = from[range.first - 1];
    uint8_t jump = add(least, p2);
    for (int d = range.first; d < range.end; d++) {
        uint8_t here = from[d], beside = add(MIN(below, from[d + 1]), DENSE_P1);
        uint8_t best = MIN(MIN(here, beside), jump);
        below = here;
        to[d] = add(best - least, cost[d]);
        lowest = MIN(lowest, to[d]);
    }
    return lowest;
}

/* Values that no path has reached. */
void dense_forget(uint8_t *values, dense_range known, dense_range range)
{
    int below = MIN(known.first, range.end + 1);
    for (int d = range.first - 1; d < below; d++) values[d] = 255;
    for (int d = MAX(known.end, range.first - 1); d <= range.end; d++) values[d] = 255;
}

static void forward_portable(const dense_row *row)
{
    uint8_t *run = row->run, least = 0;
    memset(run - 1, 0, (size_t)row->stride - 2 * DENSE_LANES + 2);
    for (int x = 0; x < row->width; x++) {
        size_t at = (size_t)x * (size_t)row->stride;
        dense_range range = row->range[x / DENSE_TILE];
        uint8_t *cost = row->cost + at, *sum = row->sum + at, *above = row->above + at;
        if (x % DENSE_TILE == 0) dense_forget(run, row->range[x ? x / DENSE_TILE - 1 : 0], range);
        cost_pixel(cost, row, x, range);
        least = step(run, run, least, cost, row->across[x], range);
        row->above_least[x] = step(above, above, row->above_least[x], cost, row->down[x], range);
        for (int d = range.first; d < range.end; d++) sum[d] = add(run[d], above[d]);
    }
}

static void backward_portable(const dense_row *row)
{
    uint8_t *run = row->run, least = 0;
    memset(run - 1, 0, (size_t)row->stride - 2 * DENSE_LANES + 2);
    for (int x = row->width - 1; x >= 0; x--) {
        dense_range range = row->range[x / DENSE_TILE];
        uint8_t *cost = row->cost + (size_t)x * (size_t)row->stride;
        uint8_t *sum = row->sum + (size_t)x * (size_t)row->stride;
        int next = x + 1 < row->width ? x + 1 : x, best = range.first;
        if (next % DENSE_TILE == 0 || next == x) dense_forget(run, row->range[next / DENSE_TILE], range);
        least = step(run, run, least, cost, row->across[next], range);
        for (int d = range.first; d < range.end; d++) {
            sum[d] = add(sum[d], run[d]);
            if (sum[d] < sum[best]) best = d;
        }
        row->level[x] = (uint16_t)best;
        row->least[x] = sum[best];
        row->before[x] = best > range.first ? sum[best - 1] : 255;
        row->after[x] = best + 1 < range.end ? sum[best + 1] : 255;
    }
}

const dense_kernel dense_kernel_portable = {forward_portable, backward_portable, &dense_loops_portable};

typedef struct paths_job {
    dense_map *map;
    const td_image *image;
    const dense_planes *left, *right;
    const dense_range *range; /* (tile rows, tile columns) */
    int levels, stride, tile_columns, stripes;
    const dense_kernel *kernel;
    const td_dense_options *options;
    int8_t fraction[2 * DENSE_FRACTIONS + 1];
    bool *failed; /* (stripes) */
} paths_job;

/* Memory of a stripe: three volumes of a row, and what goes with a row. */
typedef struct stripe {
    uint8_t *block;
    uint8_t *across, *down, *veil, *place;
    uint16_t *level;
    uint32_t *meeting;
    dense_row row;
} stripe;

static size_t round_up(size_t n)
{
    return (n + DENSE_LANES - 1) / DENSE_LANES * DENSE_LANES;
}

static size_t stripe_bytes(int width, int stride)
{
    return (size_t)stride * (3 * (size_t)width + 3) + 13 * round_up((size_t)width + 1) + 4 * (size_t)stride +
           2 * DENSE_LANES;
}

size_t dense_stripe_bytes(int width, int levels)
{
    return stripe_bytes(width, (int)round_up((size_t)levels) + 2 * DENSE_LANES);
}

int dense_stripes(int height)
{
    return height > STRIPE ? height / STRIPE : 1;
}

static bool stripe_new(stripe *s, const paths_job *job)
{
    size_t width = (size_t)job->map->width, stride = (size_t)job->stride, line = round_up(width + 1);
    uint8_t *at = s->block = calloc(1, stripe_bytes(job->map->width, job->stride));
    if (!at) return false;
    at += DENSE_LANES - (uintptr_t)at % DENSE_LANES;
    uint8_t **const volume[] = {&s->row.cost, &s->row.sum, &s->row.above};
    for (int k = 0; k < 3; k++, at += stride * width) *volume[k] = at + DENSE_LANES;
    s->row.run = at + DENSE_LANES, at += 2 * stride;
    s->veil = at + DENSE_LANES, at += stride;
    uint8_t **const lines[] = {&s->across,    &s->down, &s->row.above_least, &s->row.least, &s->row.before,
                               &s->row.after, &s->place};
    for (size_t k = 0; k < sizeof lines / sizeof *lines; k++, at += line) *lines[k] = at;
    s->level = (uint16_t *)(void *)at, at += 2 * line;
    s->meeting = (uint32_t *)(void *)at;
    for (int d = job->levels; d < job->stride - DENSE_LANES; d++) s->veil[d] = 255;
    s->row.width = job->map->width, s->row.stride = job->stride;
    s->row.across = s->across, s->row.down = s->down, s->row.veil = s->veil, s->row.level = s->level;
    return true;
}

static void begin_row(stripe *s, const paths_job *job, int y, bool first)
{
    const td_image *image = job->image;
    int width = image->width;
    const uint8_t *grey = image->data + (size_t)y * (size_t)width, *over = y ? grey - width : grey;
    dense_row *row = &s->row;
    row->range = job->range + (size_t)(y / DENSE_TILE) * (size_t)job->tile_columns;
    for (int k = 0; k < DENSE_PLANES; k++) {
        row->left[k] = job->left->plane[k] + (size_t)y * (size_t)job->left->stride;
        row->right[k] = job->right->plane[k] + (size_t)y * (size_t)job->right->stride + job->right->origin +
                        job->options->lowest;
    }
    job->kernel->loops->penalties(s->across + 1, grey + 1, grey, width - 1);
    job->kernel->loops->penalties(s->down, grey, over, width);
    if (!first && y % DENSE_TILE) return;
    const dense_range *known = first ? row->range : row->range - job->tile_columns;
    for (int x = 0; x < width; x++)
        dense_forget(row->above + (size_t)x * (size_t)row->stride, known[x / DENSE_TILE],
                     row->range[x / DENSE_TILE]);
}

/* A stripe begins some rows early, so that the path from above has run in when it counts. Stripes depend on
 * the image's height alone, so the result does not depend on who works on them. */
static void stripe_rows(size_t index, void *user)
{
    const paths_job *job = user;
    dense_map *map = job->map;
    int y0 = (int)((size_t)map->height * index / (size_t)job->stripes);
    int y1 = (int)((size_t)map->height * (index + 1) / (size_t)job->stripes);
    int begin = y0 > RUN_IN ? y0 - RUN_IN : 0;
    stripe s = {0};
    job->failed[index] = !stripe_new(&s, job);
    for (int y = begin; y < y1 && s.block; y++) {
        size_t at = (size_t)y * (size_t)map->width;
        begin_row(&s, job, y, y == begin);
        job->kernel->forward(&s.row);
        if (y < y0) continue;
        job->kernel->backward(&s.row);
        dense_winner_row(job->kernel->loops, map->disparity + at, map->curvature + at, &s.row, job->fraction,
                         job->options->lowest, job->options->left_check, s.meeting, s.place);
        memcpy(map->least + at, s.row.least, (size_t)map->width);
    }
    free(s.block);
}

td_status dense_paths(dense_map *map, const td_image *image, const dense_planes *left,
                      const dense_planes *right, const dense_range *ranges, int levels,
                      const dense_kernel *kernel, const td_dense_options *options)
{
    int depth = (levels + DENSE_LANES - 1) / DENSE_LANES * DENSE_LANES;
    paths_job job = {.map = map,
                     .image = image,
                     .left = left,
                     .right = right,
                     .range = ranges,
                     .levels = levels,
                     .stride = depth + 2 * DENSE_LANES,
                     .kernel = kernel,
                     .options = options};
    job.tile_columns = (map->width + DENSE_TILE - 1) / DENSE_TILE;
    job.stripes = dense_stripes(map->height);
    dense_winner_fractions(job.fraction);
    job.failed = calloc((size_t)job.stripes, sizeof *job.failed);
    if (!job.failed) return TD_ERROR_MEMORY;
    td_status status = td_parallel_for((size_t)job.stripes, options->threads, stripe_rows, &job,
                                       options->progress, "matching");
    for (int k = 0; k < job.stripes && status == TD_OK; k++)
        if (job.failed[k]) status = TD_ERROR_MEMORY;
    free(job.failed);
    return status;
}
