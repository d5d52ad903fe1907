/* Any bytes as a robot, the URDF before the first 0 and the YAML behind it: no crash; what is refused is
 * refused in one sentence with the file's name; and of what is read, poses at any state are unit quaternions,
 * and every cylinder finds the angle again from its length. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/robot.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check_poses(const td_robot *robot)
{
    td_pose pose[TD_ROBOT_MAX_LINKS];
    double q[TD_ROBOT_MAX_JOINTS], jacobian[6 * TD_ROBOT_MAX_JOINTS];
    for (int k = 0; k < robot->joint_count; k++) q[k] = 0.1 * (k + 1);
    td_robot_forward(pose, robot, q);
    for (int i = 0; i < robot->link_count; i++) {
        double square = 0;
        for (int k = 0; k < 4; k++) square += pose[i].q[k] * pose[i].q[k];
        if (!(fabs(square - 1) < 1e-9)) abort();
        if (robot->link[i].parent >= i) abort();
        td_robot_jacobian(jacobian, robot, pose, i);
    }
}

static void check_cylinders(const td_robot *robot)
{
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *c = robot->cylinder + i;
        const td_robot_joint *joint = robot->joint + c->joint;
        const double q = joint->lower + 0.37 * (joint->upper - joint->lower);
        double length = 0, lever = 0, back = 0;
        if (!td_cylinder_length(&length, &lever, robot, c, q)) continue;
        if (fabs(lever) < 1e-3) continue; /* the angle is then hardly known from the length */
        if (td_cylinder_angle(&back, robot, c, length) &&
            !(fabs(back - q) * fabs(lever) < 1e-6 * (1 + length)))
            abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_error error = {0};
    td_robot *robot = NULL;
    const char *text = (const char *)data;
    const char *end = size ? memchr(text, 0, size) : NULL;
    const size_t urdf_size = end ? (size_t)(end - text) : size;
    const size_t yaml_size = end ? size - urdf_size - 1 : 0;
    if (td_robot_parse(&robot, text, urdf_size, end ? end + 1 : NULL, yaml_size, "fuzz", &error) != TD_OK) {
        if (robot || strncmp(error.message, "fuzz:", 5) != 0 || strchr(error.message, '\n')) abort();
        return 0;
    }
    check_poses(robot);
    check_cylinders(robot);
    td_robot_free(&robot);
    return 0;
}
