/* What a calibration's views cover, how far its projections can be trusted, and whether another lens model
 * would do better. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/calibrate_internal.h"
#include "core/file.h"
#include "core/number.h"
#include "core/parallel.h"

enum { COLUMNS = 20, ROWS = 15, MIDDLE = 1 };

typedef struct choosing {
    calibrate_trust *trust;
    const calibrate_job *job;
    td_calibrate_options options;
} choosing;

static void choose(size_t camera, void *user)
{
    choosing *work = user;
    td_error error;
    work->trust->has_choice[camera] =
        td_model_choice_make(&work->trust->choice[camera], (int)camera, work->job->calibration,
                             work->job->observations, &work->options, &error) == TD_OK;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double calibrate_map_median(const td_uncertainty_map *map, int camera, int distance, double *most)
{
    double sorted[COLUMNS * ROWS];
    size_t cells = (size_t)(map->columns * map->rows), n = 0;
    const double *sigma =
        map->sigma_px + ((size_t)camera * (size_t)map->distance_count + (size_t)distance) * cells;
    for (size_t i = 0; i < cells; i++)
        if (isfinite(sigma[i])) sorted[n++] = sigma[i];
    qsort(sorted, n, sizeof *sorted, compare_doubles);
    *most = n ? sorted[n - 1] : NAN;
    return n ? sorted[n / 2] : NAN;
}

td_status calibrate_trust_run(calibrate_trust *trust, const calibrate_job *job, bool models, td_error *error)
{
    const td_calibration *c = job->calibration;
    td_error why;
    trust->projected_px = trust->middle_distance_m = NAN;
    for (int i = 0; i < c->rig->count; i++) td_coverage_measure(&trust->coverage[i], i, c, job->observations);
    /* Views that leave something open have no map: the weak directions say so. */
    if (td_uncertainty_map_new(&trust->map, COLUMNS, ROWS, NULL, 0, c, job->observations, &why) == TD_OK) {
        double most;
        for (int i = 0; i < c->rig->count; i++)
            trust->projected_px =
                fmax(trust->projected_px, calibrate_map_median(trust->map, i, MIDDLE, &most));
        trust->middle_distance_m = trust->map->distance_m[MIDDLE];
    }
    if (!models) return TD_OK;
    choosing work = {trust, job, *job->options};
    work.options.progress = NULL; /* cameras are counted instead */
    td_status status = td_parallel_for((size_t)c->rig->count, job->options->threads, choose, &work,
                                       job->options->progress, "judging lens models");
    return status == TD_OK ? TD_OK : td_fail(error, status, "interrupted while lens models were judged");
}

void calibrate_trust_free(calibrate_trust *trust)
{
    if (trust) td_uncertainty_map_free(&trust->map);
}

td_status calibrate_write_map(const calibrate_job *job, const char *path, td_error *error)
{
    const td_uncertainty_map *map = job->trust->map;
    const td_rig *rig = job->calibration->rig;
    char *text = NULL, number[4][TD_NUMBER_SIZE];
    size_t size, i = 0;
    FILE *out = open_memstream(&text, &size);
    if (!out) return td_fail(error, TD_ERROR_MEMORY, "%s: out of memory", path);
    fputs("camera,distance_m,x_px,y_px,sigma_px\n", out);
    for (int c = 0; c < map->camera_count; c++)
        for (int d = 0; d < map->distance_count; d++)
            for (int row = 0; row < map->rows; row++)
                for (int column = 0; column < map->columns; column++, i++) {
                    const td_camera *k = &rig->camera[c].camera;
                    double x = (double)column / (map->columns - 1) * (k->width - 1);
                    double y = (double)row / (map->rows - 1) * (k->height - 1);
                    if (!isfinite(map->sigma_px[i])) continue;
                    fprintf(out, "%s,%s,%s,%s,%s\n", rig->camera[c].name,
                            td_number_format(number[0], map->distance_m[d], 9),
                            td_number_format(number[1], x, 9), td_number_format(number[2], y, 9),
                            td_number_format(number[3], map->sigma_px[i], 9));
                }
    td_status status = fclose(out) == 0 ? td_file_write(path, text, size, error)
                                        : td_fail(error, TD_ERROR_MEMORY, "%s: out of memory", path);
    free(text);
    return status;
}
