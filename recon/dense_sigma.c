/* The last smoothing, and how sure each disparity is.
 *
 * Smoothing: within 3/4 px neighbours belong to one surface; the mean over five in a row and five in a column
 * leaves planes as they are, and what is left of the pull to whole pixels averages out on slopes.
 *
 * Standard deviation of a matched pixel, px: the 68 % quantile of the error's size, by linear quantile
 * regression (Koenker & Bassett 1978) over pixels that both cameras see of pairs with known disparities, on
 *   1 / (curvature + 20)   how sharply the summed cost rises beside the winner: texture against noise,
 *   least                  the winner's summed cost: how badly even the best fits,
 *   spread                 mean difference to the neighbours, each at most 2 px: edges and slopes.
 * A filled pixel was not seen; what its neighbours spread is all that is known, and holes err by whole steps.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum { REACH = 2, BAND = 32 };

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

typedef struct hand_over_job {
    td_disparity *result;
    const dense_map *map;
    const dense_loops *loops;
    const td_dense_options *options;
    bool *failed; /* (bands) */
} hand_over_job;

/* At the border, the pixel itself stands for what is not there. */
static void sum_row(const dense_loops *loops, int16_t *sum, int16_t *spread, const dense_map *map, int y)
{
    int width = map->width, last = map->height - 1;
    const int16_t *here = map->disparity + (size_t)y * (size_t)width, *up[4];
    static const int step[4] = {-2, -1, 1, 2};
    for (int k = 0; k < 4; k++)
        up[k] = map->disparity + (size_t)MIN(MAX(y + step[k], 0), last) * (size_t)width;
    memset(sum, 0, (size_t)width * sizeof *sum);
    memset(spread, 0, (size_t)width * sizeof *spread);
    loops->neighbours(sum, spread, here, up, width);
    if (width <= 2 * REACH) return;
    const int16_t *beside[4] = {here, here + 1, here + 3, here + 4};
    loops->neighbours(sum + REACH, spread + REACH, here + REACH, beside, width - 2 * REACH);
}

static void finish_row(const hand_over_job *job, int y, const int16_t *sum, const int16_t *spread)
{
    const dense_map *map = job->map;
    td_disparity *result = job->result;
    size_t at = (size_t)y * (size_t)map->width;
    job->loops->convert(result->value + at, result->sigma + at, map->disparity + at, map->kind + at,
                        map->curvature + at, map->least + at, sum, spread, (float)job->options->lowest,
                        map->width);
    for (int x = 0; x < map->width; x++, at++) {
        result->kind[at] = map->kind[at];
        if (map->kind[at] != TD_DENSE_NONE && (map->kind[at] != TD_DENSE_FILLED || job->options->fill))
            continue;
        result->value[at] = result->sigma[at] = NAN;
        result->kind[at] = TD_DENSE_NONE;
    }
}

static void hand_over_band(size_t index, void *user)
{
    const hand_over_job *job = user;
    size_t width = (size_t)job->map->width;
    int16_t *work = malloc(2 * width * sizeof *work);
    job->failed[index] = !work;
    int y1 = MIN((int)(index + 1) * BAND, job->map->height);
    for (int y = (int)index * BAND; y < y1 && work; y++) {
        sum_row(job->loops, work, work + width, job->map, y);
        finish_row(job, y, work, work + width);
    }
    free(work);
}

td_status dense_hand_over(td_disparity *result, const dense_map *map, const dense_loops *loops,
                          const td_dense_options *options)
{
    size_t bands = (size_t)(map->height + BAND - 1) / BAND;
    hand_over_job job = {.result = result, .map = map, .loops = loops, .options = options};
    bool failed = false;
    job.failed = calloc(bands, sizeof *job.failed);
    if (!job.failed) return TD_ERROR_MEMORY;
    td_parallel_for(bands, options->threads, hand_over_band, &job, NULL, NULL);
    for (size_t k = 0; k < bands; k++) failed |= job.failed[k];
    free(job.failed);
    return failed ? TD_ERROR_MEMORY : TD_OK;
}
