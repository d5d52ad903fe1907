/* Planes from which a cost is read off: the 5x5 census (Zabih & Woodfill 1994), a bit for each of 24
 * neighbours that is darker than the centre, and grey values brought to the left camera's exposure. */
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_internal.h"

enum { REACH = 2, BAND = 32 };

void dense_planes_free(dense_planes *planes)
{
    for (int k = 0; k < DENSE_PLANES; k++) free(planes->plane[k]);
    *planes = (dense_planes){0};
}

static td_status allocate(dense_planes *planes, int height, int stride)
{
    *planes = (dense_planes){.height = height, .stride = stride};
    for (int k = 0; k < DENSE_PLANES; k++) {
        planes->plane[k] = malloc((size_t)height * (size_t)stride);
        if (!planes->plane[k]) {
            dense_planes_free(planes);
            return TD_ERROR_MEMORY;
        }
    }
    return TD_OK;
}

/* The row with its border repeated. */
static void pad_row(uint8_t *padded, const td_image *image, int y)
{
    int width = image->width;
    y = y < 0 ? 0 : y >= image->height ? image->height - 1 : y;
    const uint8_t *row = image->data + (size_t)y * (size_t)width;
    for (int x = 0; x < width; x++) padded[REACH + x] = row[x];
    for (int k = 0; k < REACH; k++) {
        padded[k] = row[0];
        padded[REACH + width + k] = row[width - 1];
    }
}

static void census_row(const dense_loops *loops, uint8_t *const code[3], uint8_t *const line[2 * REACH + 1],
                       int width)
{
    const uint8_t *neighbour[24];
    int count = 0;
    for (int dy = 0; dy <= 2 * REACH; dy++)
        for (int dx = 0; dx <= 2 * REACH; dx++)
            if (dx != REACH || dy != REACH) neighbour[count++] = line[dy] + dx;
    for (int k = 0; k < 3; k++) loops->census(code[k], line[REACH] + REACH, neighbour + 8 * k, width);
}

typedef struct planes_job {
    dense_planes *planes;
    const dense_loops *loops;
    const td_image *image;
    const uint8_t *tone;
    bool reversed;
    bool *failed; /* (bands) */
} planes_job;

static void reverse_row(const dense_loops *loops, uint8_t *to, int stride, const uint8_t *from, int width,
                        int origin)
{
    memset(to, from[width - 1], (size_t)origin);
    loops->reverse(to + origin, from, width);
    memset(to + origin + width, from[0], (size_t)(stride - origin - width));
}

static void planes_rows(const planes_job *job, int y0, int y1, uint8_t *work)
{
    const td_image *image = job->image;
    int width = image->width, padded = width + 2 * REACH;
    uint8_t *line[2 * REACH + 1], *code[DENSE_PLANES];
    for (int k = 0; k <= 2 * REACH; k++) line[k] = work + (size_t)k * (size_t)padded;
    for (int k = 0; k < DENSE_PLANES; k++) code[k] = work + (size_t)(2 * REACH + 1 + k) * (size_t)padded;
    for (int k = 0; k < 2 * REACH; k++) pad_row(line[k + 1], image, y0 - REACH + k);
    for (int y = y0; y < y1; y++) {
        uint8_t *first = line[0];
        memmove(line, line + 1, 2 * REACH * sizeof *line);
        line[2 * REACH] = first;
        pad_row(first, image, y + REACH);
        census_row(job->loops, code, line, width);
        for (int x = 0; x < width; x++) code[3][x] = job->tone[line[REACH][REACH + x]];
        for (int k = 0; k < DENSE_PLANES; k++) {
            uint8_t *to = job->planes->plane[k] + (size_t)y * (size_t)job->planes->stride;
            if (job->reversed)
                reverse_row(job->loops, to, job->planes->stride, code[k], width, job->planes->origin);
            else
                memcpy(to, code[k], (size_t)width);
        }
    }
}

static void planes_band(size_t index, void *user)
{
    const planes_job *job = user;
    int y0 = (int)index * BAND, y1 = y0 + BAND < job->image->height ? y0 + BAND : job->image->height;
    uint8_t *work = malloc((size_t)(2 * REACH + 5) * (size_t)(job->image->width + 2 * REACH));
    job->failed[index] = !work;
    if (work) planes_rows(job, y0, y1, work);
    free(work);
}

static td_status planes_fill(planes_job *job, int threads)
{
    size_t bands = (size_t)(job->image->height + BAND - 1) / BAND;
    bool failed = false;
    job->failed = calloc(bands, sizeof *job->failed);
    if (!job->failed) return TD_ERROR_MEMORY;
    td_parallel_for(bands, threads, planes_band, job, NULL, NULL);
    for (size_t k = 0; k < bands; k++) failed |= job->failed[k];
    free(job->failed);
    return failed ? TD_ERROR_MEMORY : TD_OK;
}

td_status dense_planes_left(dense_planes *planes, const dense_loops *loops, const td_image *image,
                            const uint8_t tone[256], int threads)
{
    TD_TRY(allocate(planes, image->height, image->width));
    planes_job job = {.planes = planes, .loops = loops, .image = image, .tone = tone};
    return planes_fill(&job, threads);
}

td_status dense_planes_right(dense_planes *planes, const dense_loops *loops, const td_image *image,
                             int lowest, int depth, const uint8_t tone[256], int threads)
{
    int before = lowest < 0 ? -lowest : 0, after = lowest > 0 ? lowest : 0;
    TD_TRY(allocate(planes, image->height, before + image->width + after + depth));
    planes->origin = before;
    planes_job job = {.planes = planes, .loops = loops, .image = image, .tone = tone, .reversed = true};
    return planes_fill(&job, threads);
}
