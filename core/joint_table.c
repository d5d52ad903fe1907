#include "core/joint_table.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

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

static td_status find_column(column *c, const td_csv *csv, const td_robot *robot, int j, bool needed,
                             td_error *error)
{
    const td_robot_joint *joint = &robot->joint[j];
    bool shift = joint->kind == TD_JOINT_PRISMATIC;
    int found = 0;
    *c = (column){.at = -1};
    look(c, &found, csv, joint->name, shift ? "_m" : "_rad", 1, NULL);
    look(c, &found, csv, joint->name, shift ? "_mm" : "_deg", shift ? 1e-3 : RADIANS, NULL);
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *cylinder = &robot->cylinder[i];
        if (cylinder->joint != j) continue;
        look(c, &found, csv, cylinder->name, "_cylinder_m", 1, cylinder);
        look(c, &found, csv, cylinder->name, "_cylinder_mm", 1e-3, cylinder);
    }
    if (found > 1)
        return td_fail(error, TD_ERROR_FORMAT, "%s: joint %s has %d columns: leave one of them", csv->name,
                       joint->name, found);
    if (found == 0 && needed)
        return td_fail(
            error, TD_ERROR_FORMAT,
            "%s: no column for joint %s, which lies between the rig's mount and what is seen: name "
            "it %s%s or %s%s%s",
            csv->name, joint->name, joint->name, shift ? "_m" : "_deg", joint->name, shift ? "_mm" : "_rad",
            robot->cylinder_count ? ", or give its cylinder's length (NAME_cylinder_m)" : "");
    return TD_OK;
}

static td_status read_cell(double *q, const column *c, const td_csv *csv, const td_robot *robot, size_t row,
                           int j, td_error *error)
{
    const td_robot_joint *joint = &robot->joint[j];
    if (c->at < 0) {
        *q = fmin(fmax(0, joint->lower), joint->upper);
        return TD_OK;
    }
    TD_TRY(td_csv_real(q, csv, row, c->at, -1e6, 1e6, error));
    *q *= c->unit;
    double length = *q;
    if (c->cylinder && !td_cylinder_angle(q, robot, c->cylinder, length))
        return td_csv_fail(csv, row, c->at, error,
                           "at %.4g m the cylinder %s is beyond the limits of joint %s, or its bars do not "
                           "reach: check its unit and zero",
                           length, c->cylinder->name, joint->name);
    return TD_OK;
}

td_status td_joint_table_read(double **out, int *given, const td_csv *csv, const td_robot *robot,
                              const bool *needed, td_error *error)
{
    column c[TD_ROBOT_MAX_JOINTS];
    int n = robot->joint_count, columns = 0;
    *out = NULL;
    for (int j = 0; j < n; j++) {
        TD_TRY(find_column(&c[j], csv, robot, j, needed && needed[j], error));
        columns += c[j].at >= 0;
    }
    double *q = calloc(csv->rows * (size_t)n + 1, sizeof *q);
    if (!q) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its readings", csv->name);
    td_status status = TD_OK;
    for (size_t k = 0; k < csv->rows && status == TD_OK; k++)
        for (int j = 0; j < n && status == TD_OK; j++)
            status = read_cell(&q[k * (size_t)n + (size_t)j], &c[j], csv, robot, k, j, error);
    if (status != TD_OK) {
        free(q);
        return status;
    }
    if (given) *given = columns;
    *out = q;
    return TD_OK;
}
