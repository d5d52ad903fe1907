/* The readers of robot poses: tables with a header, bare rows of numbers, ViSP's YAML. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/csv.h"
#include "core/document.h"
#include "core/linalg.h"
#include "core/number.h"
#include "core/robot_poses_internal.h"
#include "core/text_internal.h"

static const double SLACK = 1e-3, LARGEST = 1e12, LATEST_S = 1e12, DEGREE = 0.017453292519943295;

/* ---- rotations ---- */

bool td_rotation_from_quaternion(double q[4], const double wxyz[4])
{
    double length = 0;
    for (int k = 0; k < 4; k++) length += wxyz[k] * wxyz[k];
    length = sqrt(length);
    if (!(fabs(length - 1) <= SLACK)) return false;
    for (int k = 0; k < 4; k++) q[k] = wxyz[k] / length;
    return true;
}

bool td_rotation_from_matrix(double q[4], const double r[9])
{
    double square[9], nearest[9];
    td_multiply_transposed(square, r, r, 3, 3, 3);
    for (int k = 0; k < 9; k++)
        if (!(fabs(square[k] - (k % 4 == 0)) <= 2 * SLACK)) return false;
    double determinant = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                         r[2] * (r[3] * r[7] - r[4] * r[6]);
    if (!(fabs(determinant - 1) <= SLACK) || td_nearest_rotation(nearest, r, NULL) != TD_OK) return false;
    td_pose pose = td_pose_from_rotation(nearest, (const double[3]){0});
    memcpy(q, pose.q, sizeof pose.q);
    return true;
}

/* Rz(z) Ry(y) Rx(x). */
static void rotation_from_angles(double q[4], double z, double y, double x)
{
    double part[4];
    const double about_z[3] = {0, 0, z}, about_y[3] = {0, y, 0}, about_x[3] = {x, 0, 0};
    const double *const about[3] = {about_z, about_y, about_x};
    td_pose all = td_pose_identity();
    for (int k = 0; k < 3; k++) {
        td_rotation_exp(part, about[k]);
        td_pose one = {.q = {part[0], part[1], part[2], part[3]}};
        all = td_pose_compose(&all, &one);
    }
    memcpy(q, all.q, sizeof all.q);
}

/* ---- tables ---- */

typedef enum turn_kind { TURN_QUATERNION, TURN_VECTOR, TURN_RPY, TURN_ABC, TURN_COUNT } turn_kind;

static const char *const turn_names[TURN_COUNT][4] = {
    {"qw", "qx", "qy", "qz"}, {"rx", "ry", "rz"}, {"roll", "pitch", "yaw"}, {"a", "b", "c"}};

typedef struct pose_column {
    int column; /* -1: none */
    double unit;
} pose_column;

typedef struct pose_columns {
    int frame, time;
    pose_column place[3], turn[4];
    turn_kind kind;
} pose_columns;

typedef struct unit_name {
    const char *suffix;
    double unit; /* 0: of the options */
} unit_name;

static const unit_name length_units[] = {{"_m", 1}, {"_mm", 1e-3}, {"", 0}};
static const unit_name angle_units[] = {{"_rad", 1}, {"_deg", DEGREE}, {"", 0}};
static const unit_name no_units[] = {{"", 1}};

/* The column NAME with one of the units; two of them contradict one another. */
static td_status find_column(pose_column *found, const td_csv *csv, const char *base, const unit_name *unit,
                             size_t count, double bare, td_error *error)
{
    *found = (pose_column){.column = -1};
    for (size_t i = 0; i < count; i++) {
        char name[32];
        snprintf(name, sizeof name, "%s%s", base, unit[i].suffix);
        int column = td_csv_column(csv, name);
        if (column < 0) continue;
        if (found->column >= 0)
            return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: has %s in two units (%s and %s); leave one out",
                           csv->name, csv->line[0], base, csv->cell[found->column], name);
        *found = (pose_column){column, unit[i].unit > 0 ? unit[i].unit : bare};
    }
    return TD_OK;
}

static td_status find_turn(pose_columns *columns, const td_csv *csv, const td_robot_poses_options *o,
                           td_error *error)
{
    int kinds = 0;
    for (turn_kind kind = 0; kind < TURN_COUNT; kind++) {
        pose_column part[4] = {{0}};
        int found = 0, count = kind == TURN_QUATERNION ? 4 : 3, missing = 0;
        for (int k = 0; k < count; k++) {
            TD_TRY(kind == TURN_QUATERNION
                       ? find_column(&part[k], csv, turn_names[kind][k], no_units, 1, 1, error)
                       : find_column(&part[k], csv, turn_names[kind][k], angle_units, 3, o->radians, error));
            found += part[k].column >= 0;
            if (part[k].column < 0) missing = k;
        }
        if (!found || (kind == TURN_ABC && found < count && kinds)) continue;
        if (found < count)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s:%zu: has %d of the %d columns of a rotation; %s is missing", csv->name,
                           csv->line[0], found, count, turn_names[kind][missing]);
        if (kinds++)
            return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: has two rotations (%s … and %s …); leave one out",
                           csv->name, csv->line[0], turn_names[columns->kind][0], turn_names[kind][0]);
        columns->kind = kind;
        memcpy(columns->turn, part, sizeof part);
    }
    if (!kinds)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s:%zu: has no columns of a rotation: qw qx qy qz, rx_rad ry_rad rz_rad, roll_rad "
                       "pitch_rad yaw_rad or a_deg b_deg c_deg",
                       csv->name, csv->line[0]);
    return TD_OK;
}

static td_status find_columns(pose_columns *columns, const td_csv *csv, const td_robot_poses_options *o,
                              td_error *error)
{
    static const char *const place[] = {"x", "y", "z"};
    columns->frame = td_csv_column(csv, "frame");
    columns->time = td_csv_column(csv, "time_s");
    for (int k = 0; k < 3; k++) {
        TD_TRY(find_column(&columns->place[k], csv, place[k], length_units, 3, o->metres, error));
        if (columns->place[k].column < 0)
            return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: has no column %s_m or %s_mm", csv->name,
                           csv->line[0], place[k], place[k]);
    }
    return find_turn(columns, csv, o, error);
}

static td_status read_turn(double q[4], const td_csv *csv, size_t row, const pose_columns *c, td_error *error)
{
    double v[4] = {0};
    for (int k = 0; k < (c->kind == TURN_QUATERNION ? 4 : 3); k++) {
        TD_TRY(td_csv_real(&v[k], csv, row, c->turn[k].column, -1e6, 1e6, error));
        v[k] *= c->turn[k].unit;
    }
    switch (c->kind) {
    case TURN_VECTOR:
        td_rotation_exp(q, v);
        return TD_OK;
    case TURN_RPY:
        rotation_from_angles(q, v[2], v[1], v[0]);
        return TD_OK;
    case TURN_ABC:
        rotation_from_angles(q, v[0], v[1], v[2]);
        return TD_OK;
    default:
        break;
    }
    if (td_rotation_from_quaternion(q, v)) return TD_OK;
    return td_csv_fail(csv, row, c->turn[0].column, error,
                       "the quaternion's length is %.6g, but a rotation's is 1",
                       sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]));
}

static td_status read_row(td_robot_pose *pose, const td_csv *csv, size_t row, const pose_columns *c,
                          double before_s, td_error *error)
{
    *pose = (td_robot_pose){.time_s = NAN};
    if (c->frame >= 0) {
        const char *name = td_csv_cell(csv, row, c->frame);
        if (strlen(name) >= TD_NAME_SIZE)
            return td_csv_fail(csv, row, c->frame, error, "the name is longer than %d bytes",
                               TD_NAME_SIZE - 1);
        strcpy(pose->name, name);
    }
    if (c->time >= 0) {
        TD_TRY(td_csv_real(&pose->time_s, csv, row, c->time, -LATEST_S, LATEST_S, error));
        if (pose->time_s < before_s)
            return td_csv_fail(csv, row, c->time, error, "the time goes back by %.3g s",
                               before_s - pose->time_s);
    }
    for (int k = 0; k < 3; k++) {
        TD_TRY(
            td_csv_real(&pose->base_from_hand.t[k], csv, row, c->place[k].column, -LARGEST, LARGEST, error));
        pose->base_from_hand.t[k] *= c->place[k].unit;
    }
    return read_turn(pose->base_from_hand.q, csv, row, c, error);
}

td_status td_robot_poses_csv(td_pose_list *list, const char *text, size_t size, const char *name,
                             const td_robot_poses_options *options, td_error *error)
{
    td_csv *csv;
    pose_columns columns = {0};
    TD_TRY(td_csv_parse(&csv, text, size, name, error));
    td_status status = find_columns(&columns, csv, options, error);
    double before_s = -INFINITY;
    for (size_t row = 0; row < csv->rows && status == TD_OK; row++) {
        td_robot_pose pose;
        status = read_row(&pose, csv, row, &columns, before_s, error);
        if (status == TD_OK) status = td_pose_list_add(list, &pose, name, error);
        before_s = pose.time_s;
    }
    td_csv_free(&csv);
    return status;
}

/* ---- rows of numbers ---- */

enum { MAX_NUMBERS = 16 };

typedef struct rows {
    const char *name, *at, *end;
    size_t line; /* of `at`, from 1 */
    td_error *error;
} rows;

/* The next line's numbers; *count 0 at the end of the text. */
static td_status next_row(rows *r, double value[MAX_NUMBERS], size_t *count, size_t *line)
{
    for (*count = 0; r->at < r->end && !*count; r->line++) {
        const char *stop = r->at;
        while (stop < r->end && *stop != '\n' && *stop != '\r') stop++;
        *line = r->line;
        while (r->at < stop) {
            char token[64], shown[TD_SHOWN_SIZE];
            size_t n = 0;
            while (r->at < stop && (*r->at == ' ' || *r->at == '\t' || *r->at == ',' || *r->at == ';'))
                r->at++;
            if (*count == 0 && r->at < stop && *r->at == '#') break;
            while (r->at < stop && *r->at != ' ' && *r->at != '\t' && *r->at != ',' && *r->at != ';' &&
                   n < sizeof token - 1)
                token[n++] = *r->at++;
            token[n] = 0;
            if (!n) break;
            if (*count == MAX_NUMBERS)
                return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: holds more than 16 numbers", r->name,
                               *line);
            if (!td_number_real(&value[*count], token))
                return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: number %zu is '%s', which is no number",
                               r->name, *line, *count + 1, td_text_shown(shown, token));
            ++*count;
        }
        r->at = stop + (stop < r->end);
        if (stop + 1 < r->end && *stop == '\r' && stop[1] == '\n') r->at++;
    }
    return TD_OK;
}

static td_status row_is_no_rotation(const char *name, size_t line, const double m[16], size_t count,
                                    td_error *error)
{
    if (count == 16 && fabs(m[3]) + fabs(m[7]) + fabs(m[11]) < SLACK && fabs(m[15] - 1) < SLACK &&
        fabs(m[12]) + fabs(m[13]) + fabs(m[14]) > SLACK)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s:%zu: its last row holds the translation: written column by column? Transpose it",
                       name, line);
    if (count == 16 && !(fabs(m[12]) + fabs(m[13]) + fabs(m[14]) + fabs(m[15] - 1) < SLACK))
        return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: the last row of a pose is 0 0 0 1, not %g %g %g %g",
                       name, line, m[12], m[13], m[14], m[15]);
    double determinant = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                         m[2] * (m[4] * m[9] - m[5] * m[8]);
    return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: the matrix is no rotation: %s (determinant %.6g)", name,
                   line,
                   fabs(determinant + 1) < 0.1     ? "it mirrors"
                   : fabs(determinant - 1) > SLACK ? "it changes lengths"
                                                   : "its axes are not at right angles",
                   determinant);
}

static td_status pose_from_matrix(td_robot_pose *pose, const double m[16], size_t count, double metres,
                                  const char *name, size_t line, td_error *error)
{
    const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]};
    bool last = count != 16 || fabs(m[12]) + fabs(m[13]) + fabs(m[14]) + fabs(m[15] - 1) < SLACK;
    *pose = (td_robot_pose){.time_s = NAN};
    if (!last || !td_rotation_from_matrix(pose->base_from_hand.q, r))
        return row_is_no_rotation(name, line, m, count, error);
    for (int k = 0; k < 3; k++) pose->base_from_hand.t[k] = metres * m[4 * k + 3];
    return TD_OK;
}

/* t x y z and a quaternion, or without the t. */
static td_status pose_from_seven(td_robot_pose *pose, const double *v, size_t count,
                                 const td_robot_poses_options *o, const char *name, size_t line,
                                 td_error *error)
{
    const double *p = v + (count == 8), *u = p + 3;
    const double first[4] = {u[0], u[1], u[2], u[3]}, last[4] = {u[3], u[0], u[1], u[2]};
    *pose = (td_robot_pose){.time_s = count == 8 ? v[0] : NAN};
    for (int k = 0; k < 3; k++) pose->base_from_hand.t[k] = o->metres * p[k];
    if (count == 8 && fabs(v[0]) > LATEST_S)
        return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: the time %g is not in seconds", name, line, v[0]);
    if (td_rotation_from_quaternion(pose->base_from_hand.q, o->scalar_first ? first : last)) return TD_OK;
    return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: the quaternion's length is %.6g, but a rotation's is 1",
                   name, line, sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2] + u[3] * u[3]));
}

/* Four rows of four are one matrix. */
static td_status gather_block(rows *r, double value[MAX_NUMBERS], size_t *count)
{
    size_t first = r->line, line;
    for (size_t row = 1; row < 4; row++) {
        size_t n;
        double more[MAX_NUMBERS];
        TD_TRY(next_row(r, more, &n, &line));
        if (n != 4)
            return td_fail(r->error, TD_ERROR_FORMAT, "%s:%zu: a matrix of four rows of 4 ends in row %zu",
                           r->name, n ? line : first - 1, row);
        memcpy(value + 4 * row, more, 4 * sizeof *more);
    }
    *count = 16;
    return TD_OK;
}

td_status td_robot_poses_rows(td_pose_list *list, const char *text, size_t size, const char *name,
                              const td_robot_poses_options *o, td_error *error)
{
    rows r = {name, text, text + size, 1, error};
    if (size >= 3 && !memcmp(text, "\xEF\xBB\xBF", 3)) r.at += 3;
    double before_s = -INFINITY;
    size_t numbers = 0;
    for (;;) {
        double v[MAX_NUMBERS];
        size_t count, line;
        td_robot_pose pose;
        TD_TRY(next_row(&r, v, &count, &line));
        if (!count) return TD_OK;
        bool known = o->convention == TD_POSES_ETHZ ? count == 8 || count == 7
                                                    : count == 16 || count == 12 || count == 4;
        if (numbers ? count != numbers : !known)
            return td_fail(
                error, TD_ERROR_FORMAT, "%s:%zu: holds %zu numbers instead of %s", name, line, count,
                numbers == 4    ? "4, as the first row"
                : numbers == 7  ? "7, as the first row"
                : numbers == 8  ? "8, as the first row"
                : numbers == 12 ? "12, as the first row"
                : numbers == 16 ? "16, as the first row"
                : o->convention == TD_POSES_ETHZ
                    ? "8 (t x y z qx qy qz qw) or 7"
                    : "16 or 12 of a matrix or 8 or 7 of a quaternion; name the columns in a header");
        numbers = count;
        if (count == 4) TD_TRY(gather_block(&r, v, &count));
        TD_TRY(count <= 8 ? pose_from_seven(&pose, v, count, o, name, line, error)
                          : pose_from_matrix(&pose, v, count, o->metres, name, line, error));
        if (pose.time_s < before_s)
            return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: the time goes back by %.3g s", name, line,
                           before_s - pose.time_s);
        before_s = pose.time_s;
        TD_TRY(td_pose_list_add(list, &pose, name, error));
    }
}

/* ---- ViSP's YAML ---- */

static td_status visp_values(double value[16], size_t *rows_seen, const td_field *root, td_error *error)
{
    int height, width;
    td_field rows_field = td_field_get(root, "rows"), columns = td_field_get(root, "cols"),
             data = td_field_get(root, "data");
    TD_TRY(td_field_int(&height, &rows_field, 1, 16, error));
    TD_TRY(td_field_int(&width, &columns, 1, 16, error));
    if (!((height == 6 && width == 1) || (height == 4 && width == 4)))
        return td_field_fail(&rows_field, error, "an array of %d x %d is no pose: 6 x 1 or 4 x 4", height,
                             width);
    size_t count;
    TD_TRY(td_field_count(&count, &data, (size_t)height, (size_t)height, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field row = td_field_at(&data, i, index);
        TD_TRY(td_field_reals(value + i * (size_t)width, (size_t)width, &row, -LARGEST, LARGEST, error));
    }
    *rows_seen = (size_t)height;
    return TD_OK;
}

td_status td_robot_poses_visp(td_pose_list *list, const char *text, size_t size, const char *name,
                              const td_robot_poses_options *o, td_error *error)
{
    json_t *root;
    TD_TRY(td_document_parse(&root, text, size, name, error));
    td_field field = {NULL, name, root};
    double v[16];
    size_t height = 0;
    td_robot_pose pose = {.time_s = NAN};
    td_status status = visp_values(v, &height, &field, error);
    if (status == TD_OK && height == 4) status = pose_from_matrix(&pose, v, 16, o->metres, name, 1, error);
    json_decref(root);
    if (status != TD_OK) return status;
    if (height == 6) {
        double w[3];
        for (int k = 0; k < 3; k++) {
            pose.base_from_hand.t[k] = o->metres * v[k];
            w[k] = o->radians * v[3 + k];
        }
        if (!(fabs(w[0]) + fabs(w[1]) + fabs(w[2]) < 1e6))
            return td_fail(error, TD_ERROR_FORMAT, "%s: data: turns by more than 1e6 rad", name);
        td_rotation_exp(pose.base_from_hand.q, w);
    }
    return td_pose_list_add(list, &pose, name, error);
}
