/* Readings of an arm's joints: angles, shifts, or the lengths of the cylinders that drive them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"

#define RADIANS 0.017453292519943295

/* Where a joint's readings stand. */
typedef struct column {
    int at;                      /* -1: there is none */
    double unit;                 /* of the column, in rad or m */
    const td_cylinder *cylinder; /* NULL: the joint itself */
} column;

static void look(column *c, int *found, const td_csv *csv, const char *name, const char *suffix, double unit,
                 const td_cylinder *cylinder)
{
    char head[2 * TD_NAME_SIZE];
    snprintf(head, sizeof head, "%s%s", name, suffix);
    int at = td_csv_column(csv, head);
    if (at < 0) return;
    *c = (column){at, unit, cylinder};
    ++*found;
}

static td_status find_column(column *c, const vehicle_job *job, int j, bool needed, td_error *error)
{
    const td_robot *robot = job->robot;
    const td_robot_joint *joint = &robot->joint[j];
    bool shift = joint->kind == TD_JOINT_PRISMATIC;
    int found = 0;
    *c = (column){.at = -1};
    look(c, &found, job->joints, joint->name, shift ? "_m" : "_rad", 1, NULL);
    look(c, &found, job->joints, joint->name, shift ? "_mm" : "_deg", shift ? 1e-3 : RADIANS, NULL);
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *cylinder = &robot->cylinder[i];
        if (cylinder->joint != j) continue;
        look(c, &found, job->joints, cylinder->name, "_cylinder_m", 1, cylinder);
        look(c, &found, job->joints, cylinder->name, "_cylinder_mm", 1e-3, cylinder);
    }
    if (found > 1)
        return td_fail(error, TD_ERROR_FORMAT, "%s: joint %s has %d columns: leave one of them",
                       job->joints->name, joint->name, found);
    if (found == 0 && needed)
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: no column for joint %s, which lies between the rig's mount and what is seen: name "
            "it %s%s or %s%s%s",
            job->joints->name, joint->name, joint->name, shift ? "_m" : "_deg", joint->name,
            shift ? "_mm" : "_rad",
            robot->cylinder_count ? ", or give its cylinder's length (NAME_cylinder_m)" : "");
    return TD_OK;
}

static td_status read_cell(double *q, const column *c, const vehicle_job *job, size_t row, int j,
                           td_error *error)
{
    const td_robot_joint *joint = &job->robot->joint[j];
    if (c->at < 0) {
        *q = fmin(fmax(0, joint->lower), joint->upper);
        return TD_OK;
    }
    TD_TRY(td_csv_real(q, job->joints, row, c->at, -1e6, 1e6, error));
    *q *= c->unit;
    double length = *q;
    if (c->cylinder && !td_cylinder_angle(q, job->robot, c->cylinder, length))
        return td_csv_fail(job->joints, row, c->at, error,
                           "at %.4g m the cylinder %s is beyond the limits of joint %s, or its bars do not "
                           "reach: check its unit and zero",
                           length, c->cylinder->name, joint->name);
    return TD_OK;
}

static bool is_above(const td_robot *robot, int above, int link)
{
    for (; link >= 0; link = robot->link[link].parent)
        if (link == above) return true;
    return false;
}

/* Whether the joint moves one of the links against the mount. */
static bool is_between(const vehicle_job *job, int j, const int *link, size_t links)
{
    int child = job->robot->joint[j].link;
    for (size_t i = 0; i < links; i++)
        if (is_above(job->robot, child, job->data.mount) != is_above(job->robot, child, link[i])) return true;
    return false;
}

static td_status name_poses(vehicle_job *job, td_error *error)
{
    const td_csv *csv = job->joints;
    int at = td_csv_column(csv, "frame");
    job->pose_name = calloc(csv->rows + 1, sizeof *job->pose_name);
    job->names = calloc(csv->rows + 1, sizeof *job->names);
    if (!job->pose_name || !job->names) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t k = 0; k < csv->rows; k++) {
        snprintf(job->names[k], TD_NAME_SIZE, "%zu", k + 1);
        if (at >= 0) {
            const char *name = td_csv_cell(csv, k, at);
            if (!*name || strlen(name) >= TD_NAME_SIZE)
                return td_csv_fail(csv, k, at, error, "a name of 1 to %d bytes is needed", TD_NAME_SIZE - 1);
            strcpy(job->names[k], name);
        }
        if (vehicle_find_pose(job, job->names[k]) >= 0)
            return td_csv_fail(csv, k, at, error, "'%s' is already the name of another line", job->names[k]);
        job->pose_name[k] = job->names[k];
        job->data.pose_count = k + 1;
    }
    job->data.pose_name = job->pose_name;
    return TD_OK;
}

long vehicle_find_pose(const vehicle_job *job, const char *name)
{
    for (size_t k = 0; k < job->data.pose_count; k++)
        if (!strcmp(job->pose_name[k], name)) return (long)k;
    return -1;
}

td_status vehicle_read_joints(vehicle_job *job, const int *link, size_t links, td_error *error)
{
    column c[TD_ROBOT_MAX_JOINTS];
    int n = job->robot->joint_count;
    TD_TRY(td_csv_read(&job->joints, job->dataset->arm->joints, error));
    size_t rows = job->joints->rows;
    if (rows == 0 || rows > 10000)
        return td_fail(error, TD_ERROR_FORMAT, "%s: has %zu lines of readings; 1 to 10000 are accepted",
                       job->joints->name, rows);
    TD_TRY(name_poses(job, error));
    job->data.q = calloc(rows * (size_t)n + 1, sizeof *job->data.q);
    if (!job->data.q) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (int j = 0; j < n; j++) TD_TRY(find_column(&c[j], job, j, is_between(job, j, link, links), error));
    for (size_t k = 0; k < rows; k++)
        for (int j = 0; j < n; j++)
            TD_TRY(read_cell(&job->data.q[k * (size_t)n + (size_t)j], &c[j], job, k, j, error));
    return TD_OK;
}
