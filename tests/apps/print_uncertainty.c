/* print_uncertainty DATASET CAMERAS [plain]: calibrates the first CAMERAS cameras of a dataset and prints, as
 * one JSON object, the points, the noise, and the projected uncertainty at nine pixels and four distances of
 * each camera: what tests/apps/test_uncertainty_mrcal.py compares. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/projected_uncertainty.h"
#include "core/linalg.h"

enum { GRID = 9, DISTANCES = 4 };

/* Views of the first cameras only. */
static td_status take_cameras(td_observations **out, const td_observations *from, int cameras,
                              td_error *error)
{
    TD_TRY(td_observations_new(out, &from->target, cameras, from->view_count, error));
    td_observations *o = *out;
    memcpy(o->camera, from->camera, sizeof o->camera);
    memcpy(o->view_name, from->view_name, from->view_count * sizeof *o->view_name);
    memcpy(o->height_m, from->height_m, from->view_count * sizeof *o->height_m);
    for (size_t v = 0; v < from->view_count; v++)
        for (int c = 0; c < cameras; c++) {
            const td_detection *s = td_observations_get(from, v, c);
            td_detection *d = td_observations_get(o, v, c);
            d->found = s->found;
            memcpy(d->point, s->point, 2 * s->count * sizeof *d->point);
            memcpy(d->sigma, s->sigma, s->count * sizeof *d->sigma);
        }
    return TD_OK;
}

static void print_points(const td_observations *o)
{
    printf("\"points\":[");
    const char *comma = "";
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < o->camera_count; c++) {
            const td_detection *d = td_observations_get(o, v, c);
            for (size_t p = 0; p < d->count && d->found; p++) {
                printf("%s[\"%s%s\",%.17g,%.17g]", comma, o->camera[c].name, o->view_name[v], d->point[2 * p],
                       d->point[2 * p + 1]);
                comma = ",";
            }
        }
    printf("],");
}

static td_status print_all(const td_calibration *c, const td_observations *o, td_error *error)
{
    const double distance[DISTANCES] = {0.3, 0.6, 2, INFINITY};
    td_projected_query query[TD_RIG_MAX_CAMERAS * DISTANCES * GRID];
    static double covariance[TD_RIG_MAX_CAMERAS * DISTANCES * GRID * 4];
    size_t count = 0;
    for (int k = 0; k < c->rig->count; k++)
        for (int d = 0; d < DISTANCES; d++)
            for (int i = 0; i < GRID; i++)
                query[count++] =
                    (td_projected_query){k,
                                         {c->rig->camera[k].camera.width * (0.1 + 0.4 * (i % 3)),
                                          c->rig->camera[k].camera.height * (0.1 + 0.4 * (i / 3))},
                                         distance[d]};
    TD_TRY(td_projected_uncertainty(covariance, query, count, c, o, error));
    printf("{");
    print_points(o);
    printf("\"noise_px\":[");
    for (int k = 0; k < c->rig->count; k++) printf("%s%.17g", k ? "," : "", c->camera[k].noise_px);
    printf("],\"queries\":[");
    for (size_t i = 0; i < count; i++) {
        const double *s = covariance + 4 * i;
        printf("%s{\"camera\":%d,\"pixel\":[%.17g,%.17g],\"distance_m\":", i ? "," : "", query[i].camera,
               query[i].pixel[0], query[i].pixel[1]);
        if (isinf(query[i].distance_m))
            printf("null");
        else
            printf("%.17g", query[i].distance_m);
        printf(",\"covariance\":[%.17g,%.17g,%.17g,%.17g]}", s[0], s[1], s[2], s[3]);
    }
    printf("]}\n");
    return TD_OK;
}

int main(int argc, char **argv)
{
    td_linalg_single_thread();
    td_error error = {0};
    td_dataset *dataset = NULL;
    td_observations *all = NULL, *some = NULL;
    td_calibration *calibration = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    if (argc < 3) return 2;
    options.plain = argc > 3 && strcmp(argv[3], "plain") == 0;
    options.leave_one_out = false;
    td_status status = td_dataset_read(&dataset, argv[1], &error);
    if (status == TD_OK) status = td_observe(&all, dataset, NULL, &error);
    if (status == TD_OK) status = take_cameras(&some, all, atoi(argv[2]), &error);
    if (status == TD_OK) status = td_calibrate(&calibration, some, &options, &error);
    if (status == TD_OK) status = print_all(calibration, some, &error);
    if (status != TD_OK) fprintf(stderr, "print_uncertainty: %s\n", error.message);
    td_calibration_free(&calibration);
    td_observations_free(&some);
    td_observations_free(&all);
    td_dataset_free(&dataset);
    return status == TD_OK ? 0 : 1;
}
