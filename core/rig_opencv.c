/* What OpenCV's samples and their users keep in FileStorage. Three layouts, written by the number of cameras
 * and read under the names that are usual:
 *
 *   one      camera_matrix, distortion_coefficients, image_width, image_height   (the calibration sample)
 *   two      M1 D1 M2 D2; R T: right_from_left; E F; R1 R2 P1 P2 Q               (stereo_calib)
 *   more     camera_matrix_0, camera_distortion_0, camera_pose_0 (4x4, camera i from camera 0), …
 * (multicalib)
 *
 * fisheye_model: 1 (the calibration sample's) says that four coefficients are those of cv::fisheye; without
 * it they are k1 k2 p1 p2. OpenCV has no names for cameras and stereo_calib no size: both are added here. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/rig_formats_internal.h"
#include "core/rig_opencv_internal.h"

static const td_rig_shape shapes[] = {
    {"pinhole", TD_CAMERA_PINHOLE, 0},
    {"5 coefficients", TD_CAMERA_BROWN5, 0},
    {"8 coefficients", TD_CAMERA_BROWN8, 0},
    {"fisheye", TD_CAMERA_FISHEYE, 0},
};

enum { KEY_SIZE = 64 };

/* Names by layout; %d: the camera's number. */
typedef struct layout {
    int first;                             /* number of the first camera */
    const char *matrix[6], *distortion[6]; /* the first ones are written */
    const char *width, *height, *size[2], *fisheye, *name;
} layout;

static const layout one = {
    0,
    {"camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M", "intrinsics"},
    {"distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "D", "dist_coeffs", "distortion"},
    "image_width",
    "image_height",
    {"image_size", "imageSize"},
    "fisheye_model",
    "camera_name"};
static const layout two = {1,
                           {"M%d", "K%d", "cameraMatrix%d", "camera_matrix%d", "camera_matrix_%d", "CM%d"},
                           {"D%d", "distCoeffs%d", "dist_coeffs%d", "distortion_coefficients%d",
                            "distortion_coefficients_%d", "D%d"},
                           "image_width%d",
                           "image_height%d",
                           {"image_size%d", "imageSize%d"},
                           "fisheye_model%d",
                           "camera_name%d"};
static const layout many = {0,
                            {"camera_matrix_%d", "K%d", "M%d", "cameraMatrix%d", "camera_matrix%d", "K_%d"},
                            {"camera_distortion_%d", "D%d", "distCoeffs%d", "distortion_coefficients_%d",
                             "distortion_coefficients%d", "D_%d"},
                            "image_width_%d",
                            "image_height_%d",
                            {"image_size_%d", "imageSize_%d"},
                            "fisheye_model_%d",
                            "camera_name_%d"};

/* ---- reading ---- */

/* `pattern` with its %d, if any, replaced. */
static const char *make_key(char key[KEY_SIZE], const char *pattern, int number)
{
    const char *at = strstr(pattern, "%d");
    if (at)
        snprintf(key, KEY_SIZE, "%.*s%d%s", (int)(at - pattern), pattern, number, at + 2);
    else
        snprintf(key, KEY_SIZE, "%s", pattern);
    return key;
}

/* The first of the names that is there, else the first, absent; `key` keeps the name. */
static td_field find(const td_field *root, char key[KEY_SIZE], const char *const *pattern, size_t count,
                     int number)
{
    for (size_t i = 0; i < count; i++) {
        td_field field = td_field_get(root, make_key(key, pattern[i], number));
        if (field.value) return field;
    }
    return td_field_get(root, make_key(key, pattern[0], number));
}

static td_status read_size(td_camera *camera, const layout *l, const td_field *root, int number,
                           td_error *error)
{
    char key[2][KEY_SIZE];
    const char *const width[] = {l->width, "image_width", "image_Width"};
    const char *const height[] = {l->height, "image_height", "image_Height"};
    const char *const both[] = {l->size[0], l->size[1], "image_size", "imageSize"};
    td_field w = find(root, key[0], width, 3, number), h = find(root, key[1], height, 3, number);
    if (w.value || h.value) {
        TD_TRY(td_field_int(&camera->width, &w, 0, 1000000, error));
        return td_field_int(&camera->height, &h, 0, 1000000, error);
    }
    td_field size = find(root, key[0], both, 4, number);
    double value[2];
    if (!json_is_array(size.value)) return TD_OK;
    TD_TRY(td_field_reals(value, 2, &size, 0, 1e6, error));
    camera->width = (int)value[0];
    camera->height = (int)value[1];
    return TD_OK;
}

static td_status read_distortion(td_camera *camera, const layout *l, const td_field *root, int number,
                                 td_error *error)
{
    char key[KEY_SIZE];
    const char *const flag[] = {l->fisheye, "fisheye_model"};
    td_field is_fisheye = find(root, key, flag, 2, number);
    int fisheye = 0;
    if (is_fisheye.value) TD_TRY(td_field_int(&fisheye, &is_fisheye, 0, 1, error));
    double value[14] = {0};
    size_t count = 0;
    td_field d = find(root, key, l->distortion, 6, number);
    if (d.value || fisheye) TD_TRY(td_rig_read_values(value, &count, 0, 14, &d, error));
    if (!fisheye) return td_rig_take_brown(camera, value, count, &d, error);
    if (count != 4) return td_field_fail(&d, error, "has %zu coefficients, but a fisheye model has 4", count);
    camera->model = TD_CAMERA_FISHEYE;
    memcpy(camera->parameter + 4, value, 4 * sizeof(double));
    return TD_OK;
}

static td_status read_camera(td_rig_reading *reading, const layout *l, const td_field *root, int number,
                             const char *otherwise, td_error *error)
{
    td_rig_camera *c = NULL;
    char key[KEY_SIZE];
    double k[9];
    TD_TRY(td_rig_next(&c, reading->rig, root->name, error));
    td_field matrix = find(root, key, l->matrix, 6, number);
    TD_TRY(td_rig_read_matrix(k, 3, 3, &matrix, error));
    TD_TRY(td_rig_take_matrix(&c->camera, k, &matrix, error));
    TD_TRY(read_size(&c->camera, l, root, number, error));
    TD_TRY(read_distortion(&c->camera, l, root, number, error));
    td_field name = td_field_get(root, make_key(key, l->name, number));
    td_rig_name(reading->rig, c, json_string_value(name.value), otherwise);
    return TD_OK;
}

/* R is a rotation matrix or vector (Rodrigues). */
static td_status read_stereo_pose(td_rig_reading *reading, const td_field *root, td_error *error)
{
    td_field rotation = td_field_get(root, "R"), translation = td_field_get(root, "T");
    td_pose *pose = &reading->rig->camera[1].camera_from_rig;
    double r[9], t[3];
    size_t count = 0;
    if (!rotation.value && !translation.value) {
        reading->poses_unknown = true;
        return TD_OK;
    }
    TD_TRY(td_rig_read_values(r, &count, 3, 9, &rotation, error));
    if (count != 3 && count != 9) return td_field_fail(&rotation, error, "must have 9 values, or 3");
    TD_TRY(td_rig_read_values(t, &count, 3, 3, &translation, error));
    memcpy(pose->t, t, sizeof t);
    if (json_integer_value(json_object_get(rotation.value, "rows")) == 3 &&
        json_integer_value(json_object_get(rotation.value, "cols")) == 3)
        return td_rig_take_pose(pose, r, t, &rotation, error);
    td_rotation_exp(pose->q, r);
    return TD_OK;
}

static td_status read_pose(td_rig_reading *reading, const td_field *root, int number, td_error *error)
{
    char key[KEY_SIZE];
    td_field field = td_field_get(root, make_key(key, "camera_pose_%d", number));
    double m[16];
    if (!field.value && number) reading->poses_unknown = true;
    if (!field.value) return TD_OK;
    TD_TRY(td_rig_read_matrix(m, 4, 4, &field, error));
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1)
        return td_field_fail(&field, error, "must end in the row 0 0 0 1");
    const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, t[3] = {m[3], m[7], m[11]};
    return td_rig_take_pose(&reading->rig->camera[number].camera_from_rig, r, t, &field, error);
}

static td_status read_tree(td_rig_reading *reading, const td_field *root, td_error *error)
{
    char key[KEY_SIZE], name[KEY_SIZE];
    if (find(root, key, one.matrix, 6, 0).value) return read_camera(reading, &one, root, 0, "camera", error);
    if (find(root, key, many.matrix, 6, 0).value) {
        for (int i = 0; find(root, key, many.matrix, 6, i).value; i++) {
            TD_TRY(read_camera(reading, &many, root, i, make_key(name, "camera%d", i), error));
            TD_TRY(read_pose(reading, root, i, error));
        }
        return TD_OK;
    }
    const bool right = find(root, key, two.matrix, 6, 2).value != NULL;
    if (!find(root, key, two.matrix, 6, 1).value && !right)
        return td_field_fail(
            root, error, "holds no camera matrix (camera_matrix, K, M1, cameraMatrix1, camera_matrix_0, …)");
    TD_TRY(read_camera(reading, &two, root, 1, right ? "left" : "camera", error));
    if (!right) return TD_OK;
    TD_TRY(read_camera(reading, &two, root, 2, "right", error));
    return read_stereo_pose(reading, root, error);
}

/* Adds what is new; matrices and sizes that stand in both files must be the same. */
static td_status merge(json_t *all, json_t *more, const td_rig_text *file, const td_rig_text *first,
                       td_error *error)
{
    const char *key;
    json_t *value;
    json_object_foreach(more, key, value)
    {
        const json_t *there = json_object_get(all, key);
        const bool matters = json_is_object(value) || !strncmp(key, "image_", 6);
        char shown[TD_SHOWN_SIZE];
        if (there && matters && !json_equal(there, value))
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: %s differs from that in %s: these files are not parts of one calibration",
                           file->name, td_text_shown(shown, key), first->name);
        if (!there && json_object_set(all, key, value) != 0)
            return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its content", file->name);
    }
    return TD_OK;
}

static td_status read_opencv(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error)
{
    json_t *all = json_object();
    char names[256] = "";
    td_status status = all ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a rig");
    for (size_t i = 0; status == TD_OK && i < count; i++) {
        json_t *tree = NULL;
        const size_t used = strlen(names);
        snprintf(names + used, sizeof names - used, "%s%s", i ? " + " : "", file[i].name);
        status = td_opencv_parse(&tree, file + i, error);
        if (status == TD_OK) status = merge(all, tree, file + i, file, error);
        json_decref(tree);
    }
    const td_field root = {NULL, count > 1 ? names : file->name, all};
    if (status == TD_OK) status = read_tree(reading, &root, error);
    json_decref(all);
    return status;
}

/* ---- writing ---- */

static void add_matrix(td_text *out, const char *pattern, int number, const double *value, size_t rows,
                       size_t columns)
{
    char key[KEY_SIZE];
    td_text_format(out, "%s: !!opencv-matrix\n   rows: %zu\n   cols: %zu\n   dt: d\n   data: [ ",
                   make_key(key, pattern, number), rows, columns);
    for (size_t i = 0; i < rows; i++) {
        td_rig_add_reals(out, value + i * columns, columns);
        if (i + 1 < rows) td_text_format(out, ",\n       ");
    }
    td_text_format(out, " ]\n");
}

static void add_camera(td_text *out, const layout *l, const td_rig_camera *c, int number)
{
    char key[KEY_SIZE];
    double k[9], d[8];
    const size_t count = td_rig_distortion(d, &c->camera);
    td_camera_matrix(k, &c->camera);
    td_text_format(out, "%s: \"%s\"\n", make_key(key, l->name, number), c->name);
    td_text_format(out, "%s: %d\n", make_key(key, l->width, number), c->camera.width);
    td_text_format(out, "%s: %d\n", make_key(key, l->height, number), c->camera.height);
    if (count == 4) td_text_format(out, "%s: 1\n", make_key(key, l->fisheye, number));
    add_matrix(out, l->matrix[0], number, k, 3, 3);
    add_matrix(out, l->distortion[0], number, d, count, 1);
}

/* E = [T]x R and F = K2^-T E K1^-1, of undistorted pixels, its last element 1 as OpenCV leaves it. */
static void add_epipolar(td_text *out, const td_rig *rig, const double r[9], const double t[3])
{
    const double tx[9] = {0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0};
    double e[9], half[9], f[9], inverse[2][9];
    td_multiply(e, tx, r, 3, 3, 3);
    for (int i = 0; i < 2; i++) {
        const double *p = rig->camera[i].camera.parameter;
        const double k[9] = {1 / p[0], 0, -p[2] / p[0], 0, 1 / p[1], -p[3] / p[1], 0, 0, 1};
        memcpy(inverse[i], k, sizeof k);
    }
    td_multiply(half, e, inverse[0], 3, 3, 3);
    const double *k = inverse[1], transposed[9] = {k[0], k[3], k[6], k[1], k[4], k[7], k[2], k[5], k[8]};
    td_multiply(f, transposed, half, 3, 3, 3);
    const double scale = fabs(f[8]) > 0 ? 1 / f[8] : 1;
    for (int i = 0; i < 9; i++) f[i] *= scale;
    add_matrix(out, "E", 0, e, 3, 3);
    add_matrix(out, "F", 0, f, 3, 3);
}

static void add_rectification(td_text *out, const td_rig_pair *pair)
{
    for (int i = 0; i < 2; i++) add_matrix(out, "R%d", i + 1, pair->r[i], 3, 3);
    for (int i = 0; i < 2; i++) {
        const double *t = pair->t, f = pair->f;
        const double p[12] = {f, 0, pair->c[0], i ? f * t[0] : 0, 0, f, pair->c[1], i ? f * t[1] : 0, 0,
                              0, 1, 0};
        add_matrix(out, "P%d", i + 1, p, 3, 4);
    }
    const double along = pair->vertical ? pair->t[1] : pair->t[0];
    const double q[16] = {1, 0, 0, -pair->c[0], 0, 1, 0, -pair->c[1], 0, 0, 0, pair->f, 0, 0, -1 / along, 0};
    add_matrix(out, "Q", 0, q, 4, 4);
}

static void add_stereo(td_text *out, const td_rig *rig)
{
    const td_pose *pose = &rig->camera[1].camera_from_rig;
    double r[9];
    td_rig_pair pair;
    td_pose_rotation(r, pose);
    add_matrix(out, "R", 0, r, 3, 3);
    add_matrix(out, "T", 0, pose->t, 3, 1);
    add_epipolar(out, rig, r, pose->t);
    if (td_rig_rectified(&pair, rig)) add_rectification(out, &pair);
}

static void write_opencv(td_text *out, const td_rig *rig, int unused)
{
    (void)unused;
    const layout *l = rig->count == 1 ? &one : rig->count == 2 ? &two : &many;
    td_text_format(out, "%%YAML:1.0\n---\n");
    if (l == &many) td_text_format(out, "nCameras: %d\n", rig->count);
    for (int i = 0; i < rig->count; i++) {
        double m[16];
        add_camera(out, l, rig->camera + i, l->first + i);
        td_pose_matrix(m, &rig->camera[i].camera_from_rig);
        if (l == &many) add_matrix(out, "camera_pose_%d", i, m, 4, 4);
    }
    if (l == &two) add_stereo(out, rig);
}

const td_rig_room td_rig_room_opencv = {.name = "opencv",
                                        .title = "OpenCV's FileStorage",
                                        .file = "opencv.yml",
                                        .shape = shapes,
                                        .shape_count = sizeof shapes / sizeof *shapes,
                                        .read = read_opencv,
                                        .write = write_opencv};
