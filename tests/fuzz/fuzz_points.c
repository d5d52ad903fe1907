/* Points as CSV: whatever the bytes, either observations within their bounds or a sentence; what was read can be calibrated or
 * is refused. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "calib/observations.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

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
            for (int c = 0; c < 2; c++)
                if (td_observations_seen(o, v, c) > 12) abort();
    } else if (!error.message[0]) {
        abort();
    }
    td_observations_free(&o);
    return 0;
}
