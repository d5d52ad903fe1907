/* Any bytes as robot poses, in every convention: no crash; what is read is finite, near and a rotation, and
 * can be interpolated; or a sentence that names the file. The first byte chooses convention and options. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/robot_poses.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_pose(const td_pose *pose)
{
    double q = 0;
    for (int k = 0; k < 4; k++) q += pose->q[k] * pose->q[k];
    if (!(fabs(q - 1) < 1e-9) || !(td_pose_distance(pose) <= 1.01e5)) abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (!size) return 0;
    td_error error = {0};
    td_robot_poses *poses = NULL;
    const td_robot_poses_options options = {.convention = (td_pose_convention)(data[0] % 5),
                                            .inverted = data[0] & 64,
                                            .scalar_first = data[0] & 128};
    if (td_robot_poses_parse(&poses, (const char *)data + 1, size - 1, "fuzz", &options, &error) != TD_OK) {
        if (poses || strncmp(error.message, "fuzz:", 5) != 0) abort();
        return 0;
    }
    double before = -INFINITY;
    for (size_t i = 0; i < poses->count; i++) {
        const td_robot_pose *p = &poses->pose[i];
        check_pose(&p->base_from_hand);
        if (p->time_s < before || !memchr(p->name, 0, sizeof p->name)) abort();
        before = p->time_s;
    }
    td_pose at;
    double from = poses->pose[0].time_s, to = poses->pose[poses->count - 1].time_s;
    if (td_robot_poses_at(&at, poses, 0.5 * from + 0.5 * to, 0)) check_pose(&at);
    td_robot_poses_free(&poses);
    return 0;
}
