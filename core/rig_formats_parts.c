/* What the readers and writers of foreign rigs have in common. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/number.h"
#include "core/rig_formats_internal.h"

static const double LARGEST = 1e9, ROTATION_TOLERANCE = 1e-3;

td_status td_rig_next(td_rig_camera **camera, td_rig *rig, const char *file, td_error *error)
{
    if (rig->count >= TD_RIG_MAX_CAMERAS)
        return td_fail(error, TD_ERROR_FORMAT, "%s: holds more cameras than the %d a rig may have", file,
                       TD_RIG_MAX_CAMERAS);
    *camera = rig->camera + rig->count++;
    **camera = (td_rig_camera){.camera_from_rig = td_pose_identity()};
    return TD_OK;
}

static bool is_taken(const td_rig *rig, const td_rig_camera *camera)
{
    for (int i = 0; i < rig->count; i++)
        if (rig->camera + i != camera && !strcmp(rig->camera[i].name, camera->name)) return true;
    return false;
}

void td_rig_name(td_rig *rig, td_rig_camera *camera, const char *text, const char *otherwise)
{
    if (!text || !*text) text = otherwise;
    snprintf(camera->name, sizeof camera->name, "%s", text);
    for (char *c = camera->name; *c; c++) {
        const char letter[2] = {*c, 0};
        if (!td_name_is_plain(letter)) *c = '_';
    }
    for (int n = 2; is_taken(rig, camera); n++) {
        char tail[16];
        const int length = snprintf(tail, sizeof tail, "_%d", n);
        size_t used = strlen(camera->name);
        if (n > 2) used = (size_t)(strrchr(camera->name, '_') - camera->name);
        if (used > sizeof camera->name - 1 - (size_t)length) used = sizeof camera->name - 1 - (size_t)length;
        strcpy(camera->name + used, tail);
    }
}

char *td_rig_stem(const char *path)
{
    const char *slash = strrchr(path, '/');
    const char *base = slash ? slash + 1 : path, *dot = strrchr(base, '.');
    const size_t length = dot && dot > base ? (size_t)(dot - base) : strlen(base);
    char *stem = malloc(length + 1);
    if (!stem) return NULL;
    memcpy(stem, base, length);
    stem[length] = 0;
    return stem;
}

td_status td_rig_read_values(double *value, size_t *count, size_t low, size_t high, const td_field *field,
                             td_error *error)
{
    if (!json_is_object(field->value))
        return td_field_fail(field, error,
                             field->value ? "must be a matrix (rows, cols, data)"
                                          : "is missing; must be a matrix (rows, cols, data)");
    td_field rows = td_field_get(field, "rows"), columns = td_field_get(field, "cols");
    td_field data = td_field_get(field, "data");
    int m = 0, n = 0;
    TD_TRY(td_field_int(&m, &rows, 0, 1000, error));
    TD_TRY(td_field_int(&n, &columns, 0, 1000, error));
    const size_t size = (size_t)m * (size_t)n;
    if (size < low || size > high)
        return td_field_fail(field, error, "is %d x %d, but must have %zu to %zu values", m, n, low, high);
    *count = size;
    return td_field_reals(value, size, &data, -LARGEST, LARGEST, error);
}

td_status td_rig_read_matrix(double *value, size_t rows, size_t columns, const td_field *field,
                             td_error *error)
{
    size_t count = 0;
    TD_TRY(td_rig_read_values(value, &count, rows * columns, rows * columns, field, error));
    td_field m = td_field_get(field, "rows");
    int seen = 0;
    return td_field_int(&seen, &m, (int)rows, (int)rows, error);
}

td_status td_rig_take_matrix(td_camera *camera, const double k[9], const td_field *field, td_error *error)
{
    if (k[1] != 0)
        return td_field_fail(field, error, "has a skew of %g, which no model here has; calibrate without it",
                             k[1]);
    if (k[3] != 0 || k[6] != 0 || k[7] != 0 || k[8] != 1)
        return td_field_fail(field, error, "is no camera matrix [fx 0 cx; 0 fy cy; 0 0 1]");
    const double p[4] = {k[0], k[4], k[2], k[5]};
    memcpy(camera->parameter, p, sizeof p);
    return TD_OK;
}

td_status td_rig_take_pose(td_pose *pose, const double r[9], const double t[3], const td_field *field,
                           td_error *error)
{
    double product[9], nearest[9], apart = 0;
    td_multiply_transposed(product, r, r, 3, 3, 3);
    for (int i = 0; i < 9; i++) apart = fmax(apart, fabs(product[i] - (i % 4 == 0)));
    const double determinant = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                               r[2] * (r[3] * r[7] - r[4] * r[6]);
    if (!(apart <= ROTATION_TOLERANCE && determinant > 0))
        return td_field_fail(field, error, "is no rotation matrix (R R' differs from the identity by %.2g%s)",
                             apart, determinant > 0 ? "" : ", and the determinant is negative");
    if (td_nearest_rotation(nearest, r, error) != TD_OK)
        return td_field_fail(field, error, "is no rotation matrix");
    *pose = td_pose_from_rotation(nearest, t);
    return TD_OK;
}

td_status td_rig_take_brown(td_camera *camera, const double *d, size_t count, const td_field *field,
                            td_error *error)
{
    if (count != 0 && count != 4 && count != 5 && count != 8 && count != 12 && count != 14)
        return td_field_fail(field, error, "has %zu coefficients, but must have 4, 5, 8, 12 or 14", count);
    for (size_t i = 8; i < count; i++)
        if (d[i] != 0)
            return td_field_fail(field, error,
                                 i < 12 ? "holds a thin prism distortion (s%zu = %g), which no model here has"
                                        : "holds a tilted sensor (tau%zu = %g), which no model here has",
                                 i < 12 ? i - 7 : i - 11, d[i]);
    camera->model = count >= 8 ? TD_CAMERA_BROWN8 : count ? TD_CAMERA_BROWN5 : TD_CAMERA_PINHOLE;
    for (size_t i = 0; i < count && i < 8; i++) camera->parameter[4 + i] = d[i];
    return TD_OK;
}

void td_rig_add_reals(td_text *out, const double *value, size_t count)
{
    char number[TD_NUMBER_SIZE];
    for (size_t i = 0; i < count; i++)
        td_text_format(out, "%s%s", i ? ", " : "", td_number_format(number, value[i], 0));
}

size_t td_rig_distortion(double d[8], const td_camera *camera)
{
    memcpy(d, camera->parameter + 4, 8 * sizeof(double));
    return camera->model == TD_CAMERA_BROWN8 ? 8 : camera->model == TD_CAMERA_FISHEYE ? 4 : 5;
}

void td_rig_add_remark(char *remark, size_t size, const char *format, ...)
{
    size_t used = strlen(remark);
    if (used && used + 2 < size) used += (size_t)snprintf(remark + used, size - used, " ");
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(remark + used, size - used, format, arguments);
    va_end(arguments);
}
