/* What is done to the map after matching: specks taken out, holes filled from the background's side, medians.
 */
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum {
    NEAR = DENSE_ONE / 2, /* neighbours that differ by no more belong together */
    END = 3,              /* pixels at the end of a hole that tell what it is filled with */
    BAND = 32
};

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

static bool joined(int a, int b)
{
    return a >= 0 && b >= 0 && abs(a - b) <= NEAR;
}

/* Pixels of a row that belong together, from `first` to `last` of the whole image; area: of all runs that are
 * joined, told by the one at the root. */
typedef struct run {
    uint32_t first, last, parent, area;
} run;

static uint32_t find(run *runs, uint32_t k)
{
    while (runs[k].parent != k) k = runs[k].parent = runs[runs[k].parent].parent;
    return k;
}

static void join(run *runs, uint32_t a, uint32_t b)
{
    a = find(runs, a), b = find(runs, b);
    if (a == b) return;
    uint32_t root = MIN(a, b), other = MAX(a, b);
    runs[other].parent = root;
    runs[root].area += runs[other].area;
}

/* Appends the runs of row y; returns how many there are then. */
static uint32_t add_runs(run *runs, uint32_t count, const dense_map *map, int y)
{
    const int16_t *d = map->disparity;
    uint32_t at = (uint32_t)y * (uint32_t)map->width, end = at + (uint32_t)map->width;
    for (; at < end; at++) {
        if (d[at] < 0) continue;
        uint32_t first = at;
        while (at + 1 < end && joined(d[at], d[at + 1])) at++;
        runs[count] = (run){first, at, count, at - first + 1};
        count++;
    }
    return count;
}

/* Joins the runs here .. end-1 of a row to those of the row above, up .. here-1, where they touch. */
static void join_rows(run *runs, uint32_t up, uint32_t here, uint32_t end, const dense_map *map)
{
    uint32_t width = (uint32_t)map->width, limit = here;
    const int16_t *d = map->disparity;
    for (; here < end; here++) {
        while (up < limit && runs[up].last + width < runs[here].first) up++;
        for (uint32_t k = up; k < limit && runs[k].first + width <= runs[here].last; k++) {
            uint32_t at = MAX(runs[k].first + width, runs[here].first);
            uint32_t last = MIN(runs[k].last + width, runs[here].last);
            while (at <= last && !joined(d[at], d[at - width])) at++;
            if (at <= last) join(runs, here, k);
        }
    }
}

td_status dense_remove_specks(dense_map *map, int smallest)
{
    run *runs = malloc((size_t)map->width * (size_t)map->height * sizeof *runs);
    if (!runs) return TD_ERROR_MEMORY;
    uint32_t up = 0, here = 0, count = 0;
    for (int y = 0; y < map->height; y++) {
        up = here, here = count;
        count = add_runs(runs, count, map, y);
        join_rows(runs, up, here, count, map);
    }
    for (uint32_t k = 0; k < count; k++) {
        if (runs[find(runs, k)].area >= (uint32_t)smallest) continue;
        for (uint32_t at = runs[k].first; at <= runs[k].last; at++) map->disparity[at] = DENSE_NONE;
    }
    free(runs);
    return TD_OK;
}

/* The middle one of the nearest pixels from the end of a hole on. */
static int middle(const int16_t *row, int at, int step, int width)
{
    int v[END] = {row[at]}, n = 0;
    for (; at >= 0 && at < width && n < END && row[at] >= 0; at += step) {
        int k = n++;
        for (; k > 0 && v[k - 1] > row[at]; k--) v[k] = v[k - 1];
        v[k] = row[at];
    }
    return v[n / 2];
}

/* A hole of a row takes the farther of what is at its two ends: what one camera alone sees lies behind. */
static bool fill_row(int16_t *restrict to, const int16_t *restrict row, int width)
{
    int last = -1;
    for (int x = 0; x <= width; x++) {
        if (x < width) to[x] = row[x];
        if (x < width && row[x] < 0) continue;
        if (x == width && last < 0) return false;
        if (last + 1 < x) {
            int left = last < 0 ? -1 : middle(row, last, -1, width);
            int right = x == width ? left : middle(row, x, 1, width);
            if (left < 0) left = right;
            for (int k = last + 1; k < x; k++) to[k] = (int16_t)MIN(left, right);
        }
        last = x;
    }
    return true;
}

td_status dense_fill(bool *any, int16_t *disparity, int width, int height)
{
    int first = -1;
    int16_t *work = malloc((size_t)width * sizeof *work);
    if (!work) return TD_ERROR_MEMORY;
    for (int y = 0; y < height; y++) {
        int16_t *row = disparity + (size_t)y * (size_t)width;
        memcpy(work, row, (size_t)width * sizeof *row);
        if (fill_row(row, work, width))
            first = first < 0 ? y : first;
        else if (first >= 0)
            memcpy(row, row - width, (size_t)width * sizeof *row);
    }
    for (int y = first - 1; y >= 0; y--) {
        int16_t *row = disparity + (size_t)y * (size_t)width;
        memcpy(row, row + width, (size_t)width * sizeof *row);
    }
    free(work);
    *any = first >= 0;
    return TD_OK;
}

void dense_fill_from_half(dense_map *map, const dense_map *small, int shift)
{
    for (int y = 0; y < map->height; y++)
        for (int x = 0; x < map->width; x++) {
            int16_t *to = map->disparity + (size_t)y * (size_t)map->width + (size_t)x;
            size_t at = (size_t)MIN(y / 2, small->height - 1) * (size_t)small->width +
                        (size_t)MIN(x / 2, small->width - 1);
            int value = 2 * small->disparity[at] + shift * DENSE_ONE;
            if (*to < 0 && small->kind[at] == TD_DENSE_MATCHED && value >= 0) *to = (int16_t)value;
        }
}

typedef struct median_job {
    int16_t *to;
    const int16_t *from;
    int width, height;
    int16_t *work; /* (bands,3,width) */
    const dense_loops *loops;
} median_job;

static void median_band(size_t index, void *user)
{
    const median_job *job = user;
    int y1 = MIN((int)(index + 1) * BAND, job->height);
    int16_t *work = job->work + 3 * index * (size_t)job->width;
    for (int y = (int)index * BAND; y < y1; y++) {
        const int16_t *here = job->from + (size_t)y * (size_t)job->width;
        const int16_t *up = y ? here - job->width : here,
                      *down = y + 1 < job->height ? here + job->width : here;
        job->loops->median(job->to + (size_t)y * (size_t)job->width, up, here, down, work, job->width);
    }
}

td_status dense_median(int16_t *to, const int16_t *from, int width, int height, const dense_loops *loops,
                       int threads)
{
    size_t bands = (size_t)(height + BAND - 1) / BAND;
    median_job job = {to, from, width, height, malloc(3 * bands * (size_t)width * sizeof(int16_t)), loops};
    if (!job.work) return TD_ERROR_MEMORY;
    td_parallel_for(bands, threads, median_band, &job, NULL, NULL);
    free(job.work);
    return TD_OK;
}
