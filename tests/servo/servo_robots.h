/* Robots and via points for the tests of motions. */
#ifndef TELEDIMOS_TESTS_SERVO_ROBOTS_H
#define TELEDIMOS_TESTS_SERVO_ROBOTS_H

#include "core/random.h"
#include "servo/trajectory_generator.h"

static inline td_robot *excavator(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    return robot;
}

/* Six joints, the last three meet in one point: singular at fifth = 0, and with the wrist over the first
 * axis. */
static inline td_robot *six_joints(void)
{
#define JOINT(name, from, to, origin, axis, range, speed)                                                    \
    "<link name='" to "'/><joint name='" name "' type='revolute'><origin xyz='" origin                       \
    "'/><parent link='" from "'/><child link='" to "'/><axis xyz='" axis "'/><limit lower='-" range          \
    "' upper='" range "' velocity='" speed "' effort='100'/></joint>"
    static const char urdf[] =
        "<robot name='six'><link name='base'/>" JOINT("first", "base", "l1", "0 0 0.4", "0 0 1", "2.9", "2.2")
            JOINT("second", "l1", "l2", "0.15 0 0", "0 1 0", "2.0", "2.0")
                JOINT("third", "l2", "l3", "0.6 0 0", "0 1 0", "2.6", "2.6")
                    JOINT("fourth", "l3", "l4", "0.35 0 0", "1 0 0", "3.0", "3.5")
                        JOINT("fifth", "l4", "l5", "0.25 0 0", "0 1 0", "2.1", "3.5")
                            JOINT("sixth", "l5", "tool", "0 0 0", "1 0 0", "3.1", "5") "</robot>";
#undef JOINT
    static const char yaml[] =
        "teledimos: robot 1\njoints:\n"
        "  - {name: first, acceleration_rad_s2: 6}\n  - {name: second, acceleration_rad_s2: 5}\n"
        "  - {name: third, acceleration_rad_s2: 8}\n  - {name: fourth, acceleration_rad_s2: 12}\n"
        "  - {name: fifth, acceleration_rad_s2: 12}\n  - {name: sixth, acceleration_rad_s2: 20}\n";
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_parse(&robot, urdf, sizeof urdf - 1, yaml, sizeof yaml - 1, "six", &error), error);
    return robot;
}

/* With the first `rows` of x, y, z, pitch, roll, yaw. */
static inline td_tool tool_of(const td_robot *robot, const char *link, int rows, double forward_m)
{
    static const td_tool_row order[] = {TD_TOOL_X,     TD_TOOL_Y,    TD_TOOL_Z,
                                        TD_TOOL_PITCH, TD_TOOL_ROLL, TD_TOOL_YAW};
    td_tool tool = {
        .link = td_robot_find_link(robot, link), .link_from_tool = td_pose_identity(), .row_count = rows};
    memcpy(tool.row, order, (size_t)rows * sizeof *order);
    tool.link_from_tool.t[0] = forward_m;
    return tool;
}

/* Within the limits (without them: one rad to each side), no farther than `part` of the range from `near`
 * (NULL: anywhere). */
static inline void draw_joints(double *q, const td_robot *robot, const double *near, double part,
                               td_random *random)
{
    for (int k = 0; k < robot->joint_count; k++) {
        double low = fmax(robot->joint[k].lower, -1), high = fmin(robot->joint[k].upper, 1);
        if (isfinite(robot->joint[k].lower)) low = robot->joint[k].lower, high = robot->joint[k].upper;
        const double width = high - low;
        if (near) low = fmax(low, near[k] - part * width), high = fmin(high, near[k] + part * width);
        q[k] = low + (high - low) * td_random_uniform(random);
    }
}

/* A via where the arm's q puts the tool (tool NULL: q itself). */
static inline td_via via_at(const td_robot *robot, const td_tool *tool, const double *q)
{
    td_via via = {.tolerance_m = 0.05, .tolerance_rad = 0.05};
    double pose[TD_TOOL_ROWS];
    if (tool) td_tool_pose(pose, robot, tool, q);
    for (int k = 0; k < (tool ? tool->row_count : robot->joint_count); k++)
        via.value[k] = tool ? pose[tool->row[k]] : q[k];
    return via;
}

/* Rows of the tool at q, angles near those of a via. */
static inline void rows_at(double *value, const td_robot *robot, const td_tool *tool, const double *q,
                           const double *near)
{
    const double pi = 3.14159265358979323846;
    double pose[TD_TOOL_ROWS];
    td_tool_pose(pose, robot, tool, q);
    for (int i = 0; i < tool->row_count; i++) {
        value[i] = pose[tool->row[i]];
        if (tool->row[i] >= TD_TOOL_ROLL) value[i] -= 2 * pi * round((value[i] - near[i]) / (2 * pi));
    }
}

#endif
