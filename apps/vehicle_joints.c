/* Readings of an arm's joints, pose by pose. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"
#include "core/joint_table.h"

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
    bool needed[TD_ROBOT_MAX_JOINTS];
    TD_TRY(td_csv_read(&job->joints, job->dataset->arm->joints, error));
    size_t rows = job->joints->rows;
    if (rows == 0 || rows > 10000)
        return td_fail(error, TD_ERROR_FORMAT, "%s: has %zu lines of readings; 1 to 10000 are accepted",
                       job->joints->name, rows);
    TD_TRY(name_poses(job, error));
    for (int j = 0; j < job->robot->joint_count; j++) needed[j] = is_between(job, j, link, links);
    return td_joint_table_read(&job->data.q, NULL, job->joints, job->robot, needed, error);
}
