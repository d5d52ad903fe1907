/* ROS' camera_info YAML (sensor_msgs/CameraInfo; camera_calibration_parsers): a file for each camera.
 *
 * The format has no poses, but a rectification: R_i turns camera i's frame to the rectified one, and
 * P_i = K' [I | t_i] projects points of the FIRST rectified frame, so that
 *   camera_i from rectified first = R_i' [I | t_i],
 * which is the pose. For a pair both are computed here and written (t_2 = (-baseline, 0, 0), as ROS expects);
 * three cameras or more, for which ROS has no such agreement, and pairs that cannot be rectified get R = I
 * and P = [K | 0], and their poses are to be told as transforms (td_pose_to_ros). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/document_internal.h"
#include "core/rig_formats_internal.h"

static const td_rig_shape shapes[] = {
    {"plumb_bob", TD_CAMERA_PINHOLE, 0},
    {"plumb_bob", TD_CAMERA_BROWN5, 0},
    {"rational_polynomial", TD_CAMERA_BROWN8, 0},
    {"equidistant", TD_CAMERA_FISHEYE, 0},
};

/* ---- reading ---- */

static td_status read_distortion(td_camera *camera, const td_field *root, td_error *error)
{
    td_field model = td_field_get(root, "distortion_model"),
             d = td_field_get(root, "distortion_coefficients");
    const char *name = "plumb_bob";
    double value[14] = {0};
    size_t count = 0;
    char shown[TD_SHOWN_SIZE];
    if (model.value) TD_TRY(td_field_string(&name, &model, error));
    TD_TRY(td_rig_read_values(value, &count, 0, 14, &d, error));
    const bool brown = !strcmp(name, "plumb_bob") || !strcmp(name, "rational_polynomial") || !*name;
    if (brown) return td_rig_take_brown(camera, value, count, &d, error);
    if (strcmp(name, "equidistant") != 0)
        return td_field_fail(&model, error,
                             "is '%s', but there are plumb_bob, rational_polynomial and equidistant",
                             td_text_shown(shown, name));
    if (count != 4) return td_field_fail(&d, error, "has %zu coefficients, but equidistant has 4", count);
    camera->model = TD_CAMERA_FISHEYE;
    memcpy(camera->parameter + 4, value, 4 * sizeof(double));
    return TD_OK;
}

/* t of P = K' [I | t]. */
static td_status read_offset(double t[3], const td_field *field, td_error *error)
{
    double p[12];
    TD_TRY(td_rig_read_matrix(p, 3, 4, field, error));
    t[0] = t[1] = t[2] = 0;
    if (p[3] == 0 && p[7] == 0 && p[11] == 0) return TD_OK;
    if (!(fabs(p[0]) > 0) || !(fabs(p[5]) > 0) || p[1] != 0 || p[4] != 0 || p[8] != 0 || p[9] != 0 ||
        p[10] != 1)
        return td_field_fail(field, error, "is no projection matrix [f 0 cx tx; 0 f cy ty; 0 0 1 tz]");
    t[2] = p[11];
    t[0] = (p[3] - p[2] * t[2]) / p[0];
    t[1] = (p[7] - p[6] * t[2]) / p[5];
    return TD_OK;
}

/* Absent: as unrectified cameras are, R = I and t = 0. */
static td_status read_pose(td_pose *pose, bool *apart, const td_field *root, td_error *error)
{
    td_field rectification = td_field_get(root, "rectification_matrix");
    td_field projection = td_field_get(root, "projection_matrix");
    double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, t[3] = {0, 0, 0};
    if (rectification.value) TD_TRY(td_rig_read_matrix(r, 3, 3, &rectification, error));
    if (projection.value) TD_TRY(read_offset(t, &projection, error));
    *apart = t[0] != 0 || t[1] != 0 || t[2] != 0;
    const double transposed[9] = {r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]}, none[3] = {0, 0, 0};
    const td_pose shift = {{1, 0, 0, 0}, {t[0], t[1], t[2]}};
    td_pose turn;
    TD_TRY(td_rig_take_pose(&turn, transposed, none, &rectification, error));
    *pose = td_pose_compose(&turn, &shift);
    return TD_OK;
}

static td_status read_camera(td_rig_reading *reading, bool *apart, const td_field *root, td_error *error)
{
    td_rig_camera *c = NULL;
    TD_TRY(td_rig_next(&c, reading->rig, root->name, error));
    td_field width = td_field_get(root, "image_width"), height = td_field_get(root, "image_height");
    td_field matrix = td_field_get(root, "camera_matrix"), name = td_field_get(root, "camera_name");
    double k[9];
    TD_TRY(td_field_int(&c->camera.width, &width, 0, 1000000, error));
    TD_TRY(td_field_int(&c->camera.height, &height, 0, 1000000, error));
    TD_TRY(td_rig_read_matrix(k, 3, 3, &matrix, error));
    TD_TRY(td_rig_take_matrix(&c->camera, k, &matrix, error));
    TD_TRY(read_distortion(&c->camera, root, error));
    TD_TRY(read_pose(&c->camera_from_rig, apart, root, error));
    char *stem = td_rig_stem(root->name);
    if (!stem) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its content", root->name);
    td_rig_name(reading->rig, c, json_string_value(name.value), stem);
    free(stem);
    return TD_OK;
}

static td_status read_ros(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error)
{
    reading->poses_unknown = true;
    for (size_t i = 0; i < count; i++) {
        json_t *document = NULL;
        bool apart = false;
        TD_TRY(td_document_parse(&document, file[i].text, file[i].size, file[i].name, error));
        const td_field root = {NULL, file[i].name, document};
        const td_status status = read_camera(reading, &apart, &root, error);
        json_decref(document);
        TD_TRY(status);
        if (apart) reading->poses_unknown = false;
    }
    return TD_OK;
}

/* ---- writing ---- */

static void add_matrix(td_text *out, const char *key, const double *value, size_t rows, size_t columns)
{
    td_text_format(out, "%s:\n  rows: %zu\n  cols: %zu\n  data: [", key, rows, columns);
    td_rig_add_reals(out, value, rows * columns);
    td_text_format(out, "]\n");
}

static void add_rectification(td_text *out, const td_rig *rig, int camera)
{
    double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, k[9];
    td_camera_matrix(k, &rig->camera[camera].camera);
    double p[12] = {k[0], k[1], k[2], 0, k[3], k[4], k[5], 0, k[6], k[7], k[8], 0};
    td_rig_pair pair;
    if (rig->count == 2 && td_rig_rectified(&pair, rig)) {
        memcpy(r, pair.r[camera], sizeof r);
        const double t[2] = {camera ? pair.f * pair.t[0] : 0, camera ? pair.f * pair.t[1] : 0};
        const double rectified[12] = {pair.f, 0, pair.c[0], t[0], 0, pair.f, pair.c[1], t[1], 0, 0, 1, 0};
        memcpy(p, rectified, sizeof p);
    }
    add_matrix(out, "rectification_matrix", r, 3, 3);
    add_matrix(out, "projection_matrix", p, 3, 4);
}

static void write_ros(td_text *out, const td_rig *rig, int camera)
{
    const td_rig_camera *c = rig->camera + camera;
    double k[9], d[8];
    const size_t count = td_rig_distortion(d, &c->camera);
    td_camera_matrix(k, &c->camera);
    td_text_format(out, "image_width: %d\nimage_height: %d\ncamera_name: ", c->camera.width,
                   c->camera.height);
    td_document_add_word(out, c->name);
    td_text_format(out, "\n");
    add_matrix(out, "camera_matrix", k, 3, 3);
    td_text_format(out, "distortion_model: %s\n",
                   count == 4   ? "equidistant"
                   : count == 8 ? "rational_polynomial"
                                : "plumb_bob");
    add_matrix(out, "distortion_coefficients", d, 1, count);
    add_rectification(out, rig, camera);
}

static void remark(char *text, size_t size, const td_rig *rig)
{
    td_rig_pair pair;
    if (rig->count > 1 && !(rig->count == 2 && td_rig_rectified(&pair, rig)))
        td_rig_add_remark(text, size,
                          "The poses of the cameras are not held: camera_info can tell those of a pair that "
                          "can be rectified only; publish them as transforms.");
}

const td_rig_room td_rig_room_ros = {.name = "ros",
                                     .title = "ROS' camera_info",
                                     .file = "%s.yaml",
                                     .file_per_camera = true,
                                     .shape = shapes,
                                     .shape_count = sizeof shapes / sizeof *shapes,
                                     .read = read_ros,
                                     .write = write_ros,
                                     .remark = remark};
