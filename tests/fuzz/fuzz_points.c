/* Any bytes as points: no crash; what is read lies within bounds, whole or not at all, and a view counts as
 * found with 4 points; or a sentence that names the file. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "calib/observations.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_view(const td_observations *o, size_t view, int camera)
{
    const td_detection *d = td_observations_get(o, view, camera);
    size_t seen = 0;
    for (size_t i = 0; i < d->count; i++) {
        double x = d->point[2 * i], y = d->point[2 * i + 1];
        if (isnan(x) != isnan(y)) abort();
        if (isnan(x)) continue;
        if (!(fabs(x) <= 1e6 && fabs(y) <= 1e6 && d->sigma[i] >= 0 && d->sigma[i] <= 1e4)) abort();
        if (o->camera[camera].width < 1 || o->camera[camera].height < 1) abort();
        seen++;
    }
    if (d->found != (seen >= 4) || td_observations_seen(o, view, camera) != (d->found ? seen : 0)) abort();
    if ((d->reason[0] != 0) != (seen > 0 && seen < 4)) abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_target target = {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1};
    target.plane[0] = (td_target_plane){4, 3, 0.05, td_pose_identity()};
    td_observations *o = NULL;
    if (td_observations_new(&o, &target, 2, 3, &error) != TD_OK) return 0;
    strcpy(o->camera[0].name, "a");
    strcpy(o->camera[1].name, "b");
    for (size_t v = 0; v < 3; v++) o->view_name[v][0] = (char)('1' + v);
    if (td_points_parse(o, (const char *)data, size, "points.csv", &error) == TD_OK) {
        for (size_t v = 0; v < 3; v++)
            for (int c = 0; c < 2; c++) check_view(o, v, c);
    } else if (strncmp(error.message, "points.csv:", 11) != 0) {
        abort();
    }
    td_observations_free(&o);
    return 0;
}
