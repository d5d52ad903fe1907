#include "core/robot.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <unistd.h>

#include "core/file.h"
#include "core/robot_internal.h"

void td_robot_free(td_robot **robot)
{
    if (!robot) return;
    free(*robot);
    *robot = NULL;
}

int td_robot_find_link(const td_robot *robot, const char *name)
{
    for (int i = 0; i < robot->link_count; i++)
        if (strcmp(robot->link[i].name, name) == 0) return i;
    return -1;
}

int td_robot_find_joint(const td_robot *robot, const char *name)
{
    for (int k = 0; k < robot->joint_count; k++)
        if (strcmp(robot->joint[k].name, name) == 0) return k;
    return -1;
}

/* ---- kinematics ---- */

static td_pose motion(const td_robot_joint *joint, double q)
{
    td_pose pose = td_pose_identity();
    double step[3];
    for (int i = 0; i < 3; i++) step[i] = q * joint->axis[i];
    if (joint->kind == TD_JOINT_PRISMATIC)
        memcpy(pose.t, step, sizeof step);
    else
        td_rotation_exp(pose.q, step);
    return pose;
}

void td_robot_forward(td_pose *root_from_link, const td_robot *robot, const double *q)
{
    for (int i = 0; i < robot->link_count; i++) {
        const td_robot_link *link = robot->link + i;
        td_pose pose = link->parent_from_link;
        if (link->joint >= 0) {
            const td_pose moved = motion(robot->joint + link->joint, q[link->joint]);
            pose = td_pose_compose(&pose, &moved);
        }
        root_from_link[i] = link->parent < 0 ? pose : td_pose_compose(root_from_link + link->parent, &pose);
    }
}

/* The twist of a joint's axis as a left perturbation in the root's frame: a turn about the axis a through the
 * point p moves x by a x (x - p), so omega = a, tau = p x a; a shift has omega = 0, tau = a. */
static void joint_twist(double twist[6], const td_robot_joint *joint, const td_pose *root_from_child)
{
    double a[3];
    const double *p = root_from_child->t;
    td_pose_rotate(a, root_from_child, joint->axis);
    const bool shift = joint->kind == TD_JOINT_PRISMATIC;
    const double moment[3] = {p[1] * a[2] - p[2] * a[1], p[2] * a[0] - p[0] * a[2],
                              p[0] * a[1] - p[1] * a[0]};
    for (int i = 0; i < 3; i++) {
        twist[i] = shift ? 0 : a[i];
        twist[3 + i] = shift ? a[i] : moment[i];
    }
}

void td_robot_jacobian(double *jacobian, const td_robot *robot, const td_pose *root_from_link, int link)
{
    const size_t n = (size_t)robot->joint_count;
    for (size_t i = 0; i < 6 * n; i++) jacobian[i] = 0;
    for (int at = link; at >= 0; at = robot->link[at].parent) {
        const int k = robot->link[at].joint;
        if (k < 0) continue;
        double twist[6];
        joint_twist(twist, robot->joint + k, root_from_link + at);
        for (size_t i = 0; i < 6; i++) jacobian[i * n + (size_t)k] = twist[i];
    }
}

/* root_from_link = root_from_parent Exp(xi) parent_from_moved ... = Exp(Ad(root_from_parent) xi) ... */
void td_robot_link_derivative(double *derivative, const td_robot *robot, const td_pose *root_from_link,
                              int link, int moved)
{
    int at = link;
    while (at >= 0 && at != moved) at = robot->link[at].parent;
    if (at >= 0 && robot->link[at].parent >= 0)
        td_pose_adjoint(derivative, root_from_link + robot->link[at].parent);
    else
        memset(derivative, 0, 36 * sizeof *derivative);
}

bool td_robot_within_limits(const td_robot *robot, const double *q, int *joint)
{
    for (int k = 0; k < robot->joint_count; k++)
        if (!(q[k] >= robot->joint[k].lower && q[k] <= robot->joint[k].upper)) {
            if (joint) *joint = k;
            return false;
        }
    return true;
}

/* ---- reading ---- */

/* Reads the URDF and the YAML, whose messages begin with names of their own. */
static td_status parse(td_robot **robot, const char *urdf, size_t urdf_size, const char *name,
                       const char *yaml, size_t yaml_size, const char *yaml_name, td_error *error)
{
    td_robot *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a robot", name);
    td_status status = td_urdf_parse(made, urdf, urdf_size, name, error);
    if (status == TD_OK && yaml) status = td_robot_parse_yaml(made, yaml, yaml_size, yaml_name, error);
    if (status == TD_OK)
        *robot = made;
    else
        free(made);
    return status;
}

td_status td_robot_parse(td_robot **robot, const char *urdf, size_t urdf_size, const char *yaml,
                         size_t yaml_size, const char *name, td_error *error)
{
    return parse(robot, urdf, urdf_size, name, yaml, yaml_size, name, error);
}

/* "x/zx200.yaml" for "x/zx200.urdf"; NULL: out of memory. */
static char *yaml_beside(const char *path)
{
    const char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    const size_t stem = dot && (!slash || dot > slash + 1) ? (size_t)(dot - path) : strlen(path);
    char *beside = malloc(stem + sizeof ".yaml");
    if (!beside) return NULL;
    memcpy(beside, path, stem);
    memcpy(beside + stem, ".yaml", sizeof ".yaml");
    return beside;
}

td_status td_robot_read(td_robot **robot, const char *path, td_error *error)
{
    char *urdf = NULL, *yaml = NULL, *beside = yaml_beside(path);
    size_t urdf_size = 0, yaml_size = 0;
    if (!beside) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a robot", path);
    td_status status = td_file_read(&urdf, &urdf_size, path, TD_URDF_SIZE, error);
    if (status == TD_OK) {
        /* In an archive there is no telling a missing file from a bad one before it is opened. */
        const bool there = access(beside, F_OK) == 0;
        const td_status found = td_file_read(&yaml, &yaml_size, beside, TD_URDF_SIZE, there ? error : NULL);
        if (there) status = found;
    }
    if (status == TD_OK) status = parse(robot, urdf, urdf_size, path, yaml, yaml_size, beside, error);
    free(urdf);
    free(yaml);
    free(beside);
    return status;
}
