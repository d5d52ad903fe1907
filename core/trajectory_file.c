/* A trajectory as a table, and its hash. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/csv.h"
#include "core/file.h"
#include "core/number.h"
#include "core/text_internal.h"
#include "core/trajectory.h"

enum { PARTS = 3 };
static const char *const TURNING[PARTS] = {"_rad", "_rad_s", "_rad_s2"}, *const SLIDING[PARTS] = {
                                                                             "_m", "_m_s", "_m_s2"};
/* Two rows of one time may differ by this in angle and rate: what rounding in other programs' tables takes.
 */
static const double SAME = 1e-9;
/* Closer rows, s, leave no digits to an acceleration between them. */
static const double CLOSEST = 1e-6;

static const char *unit_of(const td_robot *robot, int joint, int part)
{
    return (robot->joint[joint].kind == TD_JOINT_PRISMATIC ? SLIDING : TURNING)[part];
}

static double *part_of(const td_trajectory *trajectory, int part)
{
    return part == 0 ? trajectory->q : part == 1 ? trajectory->dq : trajectory->ddq;
}

/* ---- writing ---- */

static td_status check_joints(const td_trajectory *trajectory, const td_robot *robot, td_error *error)
{
    if (trajectory->joints == robot->joint_count) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "the trajectory is of %d joints, robot '%s' has %d",
                   trajectory->joints, robot->name, robot->joint_count);
}

static void add_number(td_text *text, double value)
{
    char digits[TD_NUMBER_SIZE];
    td_text_format(text, "%s", td_number_format(digits, value, 0));
}

static td_status print(td_text *text, const td_trajectory *trajectory, const td_robot *robot, td_error *error)
{
    TD_TRY(check_joints(trajectory, robot, error));
    const size_t n = (size_t)trajectory->joints;
    td_text_format(text, "time_s");
    for (int k = 0; k < trajectory->joints; k++)
        for (int part = 0; part < PARTS; part++)
            td_text_format(text, ",%s%s", robot->joint[k].name, unit_of(robot, k, part));
    td_text_format(text, "\n");
    for (size_t i = 0; i < trajectory->count; i++) {
        add_number(text, trajectory->time_s[i]);
        for (size_t k = 0; k < n; k++)
            for (int part = 0; part < PARTS; part++) {
                td_text_format(text, ",");
                add_number(text, part_of(trajectory, part)[i * n + k]);
            }
        td_text_format(text, "\n");
    }
    if (text->failed) return td_fail(error, TD_ERROR_MEMORY, "no memory for a trajectory's table");
    return TD_OK;
}

td_status td_trajectory_write(const td_trajectory *trajectory, const char *path, const td_robot *robot,
                              td_error *error)
{
    td_text text = {0};
    td_status status = print(&text, trajectory, robot, error);
    if (status == TD_OK) status = td_file_write(path, text.data, text.size, error);
    free(text.data);
    return status;
}

td_status td_trajectory_hash(char hex[TD_HASH_HEX_SIZE], const td_trajectory *trajectory,
                             const td_robot *robot, td_error *error)
{
    td_text text = {0};
    td_status status = print(&text, trajectory, robot, error);
    if (status == TD_OK) status = td_hash_bytes(hex, text.data, text.size, error);
    free(text.data);
    return status;
}

/* ---- reading ---- */

static td_status find_columns(int column[TD_ROBOT_MAX_JOINTS][PARTS], const td_csv *csv,
                              const td_robot *robot, td_error *error)
{
    if (td_csv_column(csv, "time_s") < 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: it has no column time_s", csv->name);
    for (int k = 0; k < robot->joint_count; k++)
        for (int part = 0; part < PARTS; part++) {
            char name[TD_NAME_SIZE + 8];
            snprintf(name, sizeof name, "%s%s", robot->joint[k].name, unit_of(robot, k, part));
            column[k][part] = td_csv_column(csv, name);
            if (column[k][part] < 0)
                return td_fail(error, TD_ERROR_FORMAT, "%s: it has no column %s", csv->name, name);
        }
    if (csv->columns > 1 + PARTS * (size_t)robot->joint_count)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: it has %zu columns, but time_s and three of each joint of robot '%s' are %d",
                       csv->name, csv->columns, robot->name, 1 + PARTS * robot->joint_count);
    if (csv->rows < 1) return td_fail(error, TD_ERROR_FORMAT, "%s: it has no rows", csv->name);
    return TD_OK;
}

static td_status read_time(td_trajectory *t, const td_csv *csv, size_t i, td_error *error)
{
    const int time = td_csv_column(csv, "time_s");
    TD_TRY(td_csv_real(t->time_s + i, csv, i, time, 0, 1e9, error));
    const double since = i ? t->time_s[i] - t->time_s[i - 1] : t->time_s[0];
    if (since == 0 || (i > 0 && since >= CLOSEST)) return TD_OK;
    return td_csv_fail(csv, i, time, error,
                       "times begin at 0, do not go back, and are the same or at least 1e-6 s apart");
}

static td_status read_row(td_trajectory *t, const td_csv *csv, size_t i,
                          int column[TD_ROBOT_MAX_JOINTS][PARTS], td_error *error)
{
    const size_t n = (size_t)t->joints;
    TD_TRY(read_time(t, csv, i, error));
    const bool shared = i > 0 && t->time_s[i] == t->time_s[i - 1];
    for (size_t k = 0; k < n; k++)
        for (int part = 0; part < PARTS; part++) {
            double *value = part_of(t, part) + i * n + k;
            TD_TRY(td_csv_real(value, csv, i, column[k][part], -1e12, 1e12, error));
            if (shared && part < 2 && fabs(*value - *(value - n)) > SAME)
                return td_csv_fail(csv, i, column[k][part], error,
                                   "it jumps at a time that two rows share: only accelerations may");
        }
    return TD_OK;
}

static td_status take(td_trajectory **out, const td_csv *csv, const td_robot *robot, td_error *error)
{
    int column[TD_ROBOT_MAX_JOINTS][PARTS];
    td_trajectory *t = NULL;
    TD_TRY(find_columns(column, csv, robot, error));
    TD_TRY(td_trajectory_new(&t, robot->joint_count, csv->rows, error));
    td_status status = TD_OK;
    for (size_t i = 0; i < csv->rows && status == TD_OK; i++) status = read_row(t, csv, i, column, error);
    if (status == TD_OK)
        *out = t;
    else
        td_trajectory_free(&t);
    return status;
}

td_status td_trajectory_parse(td_trajectory **trajectory, const char *text, size_t size, const char *name,
                              const td_robot *robot, td_error *error)
{
    td_csv *csv = NULL;
    *trajectory = NULL;
    TD_TRY(td_csv_parse(&csv, text, size, name, error));
    const td_status status = take(trajectory, csv, robot, error);
    td_csv_free(&csv);
    return status;
}

td_status td_trajectory_read(td_trajectory **trajectory, const char *path, const td_robot *robot,
                             td_error *error)
{
    td_csv *csv = NULL;
    *trajectory = NULL;
    TD_TRY(td_csv_read(&csv, path, error));
    const td_status status = take(trajectory, csv, robot, error);
    td_csv_free(&csv);
    return status;
}
