/* Rows of the tool's pose, and how they change with the joints. */
#include <math.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

static const double PI = 3.14159265358979323846;
/* cos(roll): below it the tool's y axis is nearly vertical, and roll, pitch and yaw are not three. */
static const double UPRIGHT = 0.1;

/* R = Rz(yaw) Rx(roll) Ry(pitch): R y = (-sin yaw cos roll, cos yaw cos roll, sin roll), and the last row is
 * (-cos roll sin pitch, sin roll, cos roll cos pitch). */
static void rows_of(double pose[TD_TOOL_ROWS], const td_pose *root_from_tool)
{
    double r[9];
    td_pose_rotation(r, root_from_tool);
    memcpy(pose, root_from_tool->t, sizeof root_from_tool->t);
    pose[TD_TOOL_ROLL] = atan2(r[7], hypot(r[6], r[8]));
    pose[TD_TOOL_PITCH] = atan2(-r[6], r[8]);
    pose[TD_TOOL_YAW] = atan2(-r[1], r[4]);
}

static td_pose tool_at(const td_tool *tool, const td_pose *root_from_link)
{
    return td_pose_compose(root_from_link + tool->link, &tool->link_from_tool);
}

void td_tool_pose(double pose[TD_TOOL_ROWS], const td_robot *robot, const td_tool *tool, const double *q)
{
    td_pose link[TD_ROBOT_MAX_LINKS];
    td_robot_forward(link, robot, q);
    const td_pose at = tool_at(tool, link);
    rows_of(pose, &at);
}

/* All six rows' rates by a joint's twist (omega, velocity of the point at the origin). In axes turned by yaw
 * omega = (roll', pitch' cos roll, yaw' + pitch' sin roll). */
static void rates_of(double rate[TD_TOOL_ROWS], const double twist[6], const double *pose)
{
    const double *w = twist, *p = pose, c = cos(pose[TD_TOOL_YAW]), s = sin(pose[TD_TOOL_YAW]);
    const double across = (c * w[1] - s * w[0]) / cos(pose[TD_TOOL_ROLL]);
    rate[0] = twist[3] + w[1] * p[2] - w[2] * p[1];
    rate[1] = twist[4] + w[2] * p[0] - w[0] * p[2];
    rate[2] = twist[5] + w[0] * p[1] - w[1] * p[0];
    rate[TD_TOOL_ROLL] = c * w[0] + s * w[1];
    rate[TD_TOOL_PITCH] = across;
    rate[TD_TOOL_YAW] = w[2] - across * sin(pose[TD_TOOL_ROLL]);
}

bool td_tool_rows(double *value, double *jacobian, const td_arm *arm, const double *q)
{
    const td_tool *tool = arm->tool;
    const int n = arm->robot->joint_count;
    td_pose link[TD_ROBOT_MAX_LINKS];
    double pose[TD_TOOL_ROWS], twists[6 * TD_ROBOT_MAX_JOINTS];
    td_robot_forward(link, arm->robot, q);
    const td_pose at = tool_at(tool, link);
    rows_of(pose, &at);
    bool angles = false;
    for (int i = 0; i < tool->row_count; i++) {
        value[i] = pose[tool->row[i]];
        angles = angles || tool->row[i] >= TD_TOOL_ROLL;
    }
    if (angles && cos(pose[TD_TOOL_ROLL]) < UPRIGHT) return false;
    if (!jacobian) return true;
    td_robot_jacobian(twists, arm->robot, link, tool->link);
    for (int k = 0; k < n; k++) {
        double twist[6], rate[TD_TOOL_ROWS];
        for (int i = 0; i < 6; i++) twist[i] = twists[i * n + k];
        rates_of(rate, twist, pose);
        for (int i = 0; i < tool->row_count; i++) jacobian[i * n + k] = rate[tool->row[i]];
    }
    return true;
}

void td_tool_joints(bool *moves, const td_arm *arm)
{
    const td_robot *r = arm->robot;
    for (int k = 0; k < r->joint_count; k++) moves[k] = false;
    for (int at = arm->tool->link; at >= 0; at = r->link[at].parent)
        if (r->link[at].joint >= 0) moves[r->link[at].joint] = true;
}

void td_tool_unwrap(double *value, const double *near, const td_tool *tool)
{
    for (int i = 0; i < tool->row_count; i++)
        if (tool->row[i] >= TD_TOOL_ROLL) value[i] -= 2 * PI * round((value[i] - near[i]) / (2 * PI));
}

double td_tool_weight(const td_arm *arm, int row)
{
    return arm->tool->row[row] >= TD_TOOL_ROLL ? arm->options->radius_m : 1;
}

void td_tool_off(double *off_m, double *off_rad, const td_tool *tool, const double *difference)
{
    double square[2] = {0, 0};
    for (int i = 0; i < tool->row_count; i++)
        square[tool->row[i] >= TD_TOOL_ROLL] += difference[i] * difference[i];
    *off_m = sqrt(square[0]);
    *off_rad = sqrt(square[1]);
}
