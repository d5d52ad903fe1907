/* Any bytes as a trajectory's table: no crash; what is read keeps its promises and gives back the same bits.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/trajectory.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void judge(const td_trajectory *t, const td_robot *robot)
{
    double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS], ddq[TD_ROBOT_MAX_JOINTS];
    const double end = td_trajectory_duration(t);
    td_trajectory_shares shares;
    char hash[TD_HASH_HEX_SIZE];
    if (t->count < 1 || t->time_s[0] != 0 || !(end >= 0)) abort();
    for (int i = -1; i < 9; i++) {
        td_trajectory_at(q, dq, ddq, t, end * i / 7);
        for (int k = 0; k < t->joints; k++)
            if (!isfinite(q[k]) || !isfinite(dq[k]) || !isfinite(ddq[k])) abort();
    }
    td_trajectory_check(&shares, t, robot, INFINITY, 0, NULL);
    if (td_trajectory_hash(hash, t, robot, NULL) != TD_OK) abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static td_robot *robot;
    static const char urdf[] =
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='revolute'>"
        "<parent link='a'/><child link='b'/><axis xyz='0 0 1'/>"
        "<limit lower='-2' upper='1' velocity='1.5' effort='1'/></joint></robot>";
    td_error error = {0};
    td_trajectory *t = NULL;
    if (!robot && td_robot_parse(&robot, urdf, sizeof urdf - 1, NULL, 0, "r", &error) != TD_OK) abort();
    if (td_trajectory_parse(&t, (const char *)data, size, "fuzz.csv", robot, &error) != TD_OK) {
        if (t || strncmp(error.message, "fuzz.csv:", 9) != 0) abort();
        return 0;
    }
    judge(t, robot);
    td_trajectory_free(&t);
    return 0;
}
