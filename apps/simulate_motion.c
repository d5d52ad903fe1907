/* Commands over time: built-in motions and tables, all as straight lines between rows. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_internal.h"
#include "core/csv.h"
#include "core/document.h"
#include "core/file.h"

enum { SINE_ROWS = 48 }; /* of a period: a straight line between two misses by 0.2 % of the amplitude */
static const double PI = 3.14159265358979323846;

static const char *const kinds[] = {"hold", "trapezoid", "step", "sine", "table", NULL};
static const char *const commands[] = {"flow", "force", "rate", NULL};
enum { HOLD, TRAPEZOID, STEP, SINE, TABLE };

void motion_free(motion *m)
{
    free(m->time_s);
    free(m->value);
}

static td_status make_rows(motion *m, size_t count, int joints, td_error *error)
{
    m->count = count;
    m->time_s = calloc(count, sizeof *m->time_s);
    m->value = calloc(count * (size_t)joints + 1, sizeof *m->value);
    if (!m->time_s || !m->value) return td_fail(error, TD_ERROR_MEMORY, "no memory for a motion");
    return TD_OK;
}

/* {boom: 0.2, …}: joints that are not named get 0. */
static td_status read_values(double *value, const td_field *field, const td_robot *robot, td_error *error)
{
    memset(value, 0, (size_t)robot->joint_count * sizeof *value);
    const char *keys[TD_ROBOT_MAX_JOINTS + 1] = {NULL};
    for (int k = 0; k < robot->joint_count; k++) keys[k] = robot->joint[k].name;
    TD_TRY(td_field_check_keys(field, keys, error));
    for (int k = 0; k < robot->joint_count; k++) {
        const td_field one = td_field_get(field, robot->joint[k].name);
        if (one.value) TD_TRY(td_field_real(value + k, &one, -1e9, 1e9, error));
    }
    return TD_OK;
}

static void scale_row(motion *m, size_t row, double time_s, const double *value, double by, int joints)
{
    m->time_s[row] = time_s;
    for (int k = 0; k < joints; k++) m->value[row * (size_t)joints + (size_t)k] = by * value[k];
}

static td_status trapezoid(motion *m, const td_field *field, const double *value, double duration, int joints,
                           td_error *error)
{
    const td_field ramp = td_field_get(field, "ramp_s");
    double up = duration / 6;
    if (ramp.value) TD_TRY(td_field_real(&up, &ramp, 1e-6, duration / 2, error));
    TD_TRY(make_rows(m, 4, joints, error));
    const double at[4] = {0, up, duration - up, duration};
    for (size_t i = 0; i < 4; i++) scale_row(m, i, at[i], value, i == 1 || i == 2, joints);
    return TD_OK;
}

static td_status a_step(motion *m, const td_field *field, const double *value, double duration, int joints,
                        td_error *error)
{
    const td_field when = td_field_get(field, "at_s");
    double at = 0;
    if (when.value) TD_TRY(td_field_real(&at, &when, 0, duration, error));
    TD_TRY(make_rows(m, 3, joints, error));
    scale_row(m, 0, 0, value, 0, joints);
    scale_row(m, 1, at, value, 0, joints);
    scale_row(m, 2, at, value, 1, joints);
    return TD_OK;
}

static td_status sine(motion *m, const td_field *field, const double *value, double duration, int joints,
                      td_error *error)
{
    const td_field frequency = td_field_get(field, "frequency_hz");
    double hz = 0;
    TD_TRY(td_field_real(&hz, &frequency, 1e-6, 1e4, error));
    const double rows = ceil(duration * hz * SINE_ROWS) + 1;
    if (rows > SIMULATE_MAX_ROWS)
        return td_field_fail(&frequency, error, "%g Hz over %g s are too many periods", hz, duration);
    TD_TRY(make_rows(m, (size_t)rows, joints, error));
    for (size_t i = 0; i < m->count; i++) {
        const double t = (double)i / (hz * SINE_ROWS);
        scale_row(m, i, t, value, sin(2 * PI * hz * t), joints);
    }
    return TD_OK;
}

/* ---- a table ---- */

static bool is_motor(const td_robot *robot, int joint)
{
    for (int i = 0; i < robot->cylinder_count; i++)
        if (robot->cylinder[i].joint == joint) return false;
    return true;
}

bool simulate_is_motor(const td_robot *robot, int joint)
{
    return is_motor(robot, joint);
}

/* "boom_rad_s", "boom_m3_s", "boom_n"; a motor's torque "swing_nm", its flow its rate. */
static const char *unit_of(const td_robot *robot, int joint, td_command_kind kind)
{
    const bool motor = is_motor(robot, joint), slides = robot->joint[joint].kind == TD_JOINT_PRISMATIC;
    if (kind == TD_COMMAND_FORCE) return motor && !slides ? "nm" : "n";
    if (kind == TD_COMMAND_FLOW && !motor) return "m3_s";
    return slides ? "m_s" : "rad_s";
}

static td_status find_columns(int column[TD_ROBOT_MAX_JOINTS], const td_csv *csv, const td_robot *robot,
                              td_command_kind kind, td_error *error)
{
    size_t used = 1;
    if (td_csv_column(csv, "time_s") < 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: it has no column time_s", csv->name);
    for (int k = 0; k < robot->joint_count; k++) {
        char name[TD_NAME_SIZE + 8];
        snprintf(name, sizeof name, "%s_%s", robot->joint[k].name, unit_of(robot, k, kind));
        column[k] = td_csv_column(csv, name);
        used += column[k] >= 0;
    }
    for (size_t c = 0; used < csv->columns && c < csv->columns; c++) {
        bool known = (int)c == td_csv_column(csv, "time_s");
        int like = 0; /* the joint that was meant */
        for (int k = 0; k < robot->joint_count; k++) {
            known = known || column[k] == (int)c;
            if (strncmp(csv->cell[c], robot->joint[k].name, strlen(robot->joint[k].name)) == 0) like = k;
        }
        if (!known)
            return td_fail(
                error, TD_ERROR_FORMAT,
                "%s: column '%s' is no joint of the robot with the unit of a %s command, as %s_%s is",
                csv->name, csv->cell[c], commands[kind], robot->joint[like].name, unit_of(robot, like, kind));
    }
    return TD_OK;
}

static td_status fill(motion *m, const td_csv *csv, const int *column, int joints, td_error *error)
{
    TD_TRY(make_rows(m, csv->rows, joints, error));
    const int time = td_csv_column(csv, "time_s");
    for (size_t i = 0; i < csv->rows; i++) {
        const double least = i ? m->time_s[i - 1] : 0;
        TD_TRY(td_csv_real(m->time_s + i, csv, i, time, -1e9, 1e9, error));
        if (m->time_s[i] < least || (i == 0 && m->time_s[i] != 0))
            return td_csv_fail(csv, i, time, error, "times begin at 0 and do not go back");
        for (int k = 0; k < joints; k++)
            if (column[k] >= 0)
                TD_TRY(td_csv_real(m->value + i * (size_t)joints + (size_t)k, csv, i, column[k], -1e9, 1e9,
                                   error));
    }
    return TD_OK;
}

static td_status table(motion *m, const td_field *field, const td_robot *robot, const char *folder,
                       td_error *error)
{
    const td_field file = td_field_get(field, "file");
    const char *name = NULL;
    TD_TRY(td_field_string(&name, &file, error));
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    td_csv *csv = NULL;
    int column[TD_ROBOT_MAX_JOINTS];
    td_status status = td_csv_read(&csv, path, error);
    free(path);
    if (status == TD_OK && csv->rows < 1)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: it has no rows", csv->name);
    if (status == TD_OK) status = find_columns(column, csv, robot, m->command, error);
    if (status == TD_OK) status = fill(m, csv, column, robot->joint_count, error);
    td_csv_free(&csv);
    return status;
}

td_status motion_read(motion *m, const td_field *field, const td_robot *robot, double duration,
                      const char *folder, td_error *error)
{
    static const char *const keys[] = {"kind", "command",      "joints", "ramp_s",
                                       "at_s", "frequency_hz", "file",   NULL};
    const td_field kind_field = td_field_get(field, "kind"), command = td_field_get(field, "command"),
                   joints = td_field_get(field, "joints");
    double value[TD_ROBOT_MAX_JOINTS] = {0};
    int kind = 0, which = TD_COMMAND_RATE;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_field_choice(&kind, &kind_field, kinds, "hold, trapezoid, step, sine or table", error));
    if (command.value) TD_TRY(td_field_choice(&which, &command, commands, "flow, force or rate", error));
    m->command = (td_command_kind)which;
    snprintf(m->kind, sizeof m->kind, "%s", kinds[kind]);
    if (kind != HOLD && kind != TABLE) TD_TRY(read_values(value, &joints, robot, error));
    const int n = robot->joint_count;
    switch (kind) {
    case TRAPEZOID:
        return trapezoid(m, field, value, duration, n, error);
    case STEP:
        return a_step(m, field, value, duration, n, error);
    case SINE:
        return sine(m, field, value, duration, n, error);
    case TABLE:
        return table(m, field, robot, folder, error);
    default:
        return make_rows(m, 1, n, error);
    }
}

td_status motion_none(motion *m, const td_robot *robot, td_error *error)
{
    m->command = TD_COMMAND_RATE;
    snprintf(m->kind, sizeof m->kind, "free");
    return make_rows(m, 1, robot->joint_count, error);
}

/* ---- over time ---- */

/* The last row that is not after `time_s`. */
static size_t row_at(const motion *m, double time_s)
{
    size_t low = 0, high = m->count;
    while (high - low > 1) {
        const size_t middle = (low + high) / 2;
        if (m->time_s[middle] <= time_s)
            low = middle;
        else
            high = middle;
    }
    return low;
}

void motion_at(double *value, double *slope, double *next_s, const motion *m, double time_s, int joints)
{
    const size_t n = (size_t)joints, i = row_at(m, time_s), last = i + 1 == m->count;
    const double *v = m->value + i * n;
    *next_s = last ? INFINITY : m->time_s[i + 1];
    for (size_t k = 0; k < n; k++) {
        slope[k] = last ? 0 : (v[n + k] - v[k]) / (m->time_s[i + 1] - m->time_s[i]);
        value[k] = v[k] + slope[k] * (time_s - m->time_s[i]);
    }
}

void motion_integral(double *sum, const motion *m, double time_s, int joints)
{
    const size_t n = (size_t)joints;
    memset(sum, 0, n * sizeof *sum);
    double value[TD_ROBOT_MAX_JOINTS], slope[TD_ROBOT_MAX_JOINTS], next = 0;
    const size_t end = row_at(m, time_s);
    for (size_t i = 0; i < end; i++)
        for (size_t k = 0; k < n; k++)
            sum[k] +=
                (m->value[i * n + k] + m->value[(i + 1) * n + k]) / 2 * (m->time_s[i + 1] - m->time_s[i]);
    motion_at(value, slope, &next, m, time_s, joints);
    for (size_t k = 0; k < n; k++)
        sum[k] += (m->value[end * n + k] + value[k]) / 2 * (time_s - m->time_s[end]);
}
