/* Kalibr's camchain.yaml: cam0, cam1, …; T_cn_cnm1 of each but the first is camN_from_camN-1. Kalibr names
 * cameras by their topic: /NAME/image_raw gives and takes the name. */
#include <stdio.h>
#include <string.h>

#include "core/rig_formats_internal.h"

enum { K3_HELD = 1 << 8 };

static const td_rig_shape shapes[] = {
    {"pinhole-none", TD_CAMERA_PINHOLE, 0},
    {"pinhole-radtan", TD_CAMERA_BROWN5, K3_HELD},
    {"pinhole-equidistant", TD_CAMERA_FISHEYE, 0},
};
static const char TOPIC_END[] = "/image_raw";
static const double LARGEST = 1e9;

/* ---- reading ---- */

static td_status read_model(td_camera *camera, const td_field *field, td_error *error)
{
    td_field model = td_field_get(field, "camera_model"),
             distortion = td_field_get(field, "distortion_model");
    td_field intrinsics = td_field_get(field, "intrinsics"), d = td_field_get(field, "distortion_coeffs");
    const char *name = NULL, *kind = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_string(&name, &model, error));
    if (strcmp(name, "pinhole") != 0)
        return td_field_fail(&model, error, "is '%s', which no model here holds; only pinhole is read",
                             td_text_shown(shown, name));
    TD_TRY(td_field_string(&kind, &distortion, error));
    TD_TRY(td_field_reals(camera->parameter, 4, &intrinsics, -LARGEST, LARGEST, error));
    camera->model = TD_CAMERA_PINHOLE;
    if (!strcmp(kind, "none")) return TD_OK;
    if (strcmp(kind, "radtan") != 0 && strcmp(kind, "equidistant") != 0)
        return td_field_fail(&distortion, error,
                             "is '%s', which no model here holds; radtan, equidistant and none are read",
                             td_text_shown(shown, kind));
    camera->model = *kind == 'r' ? TD_CAMERA_BROWN5 : TD_CAMERA_FISHEYE;
    return td_field_reals(camera->parameter + 4, 4, &d, -LARGEST, LARGEST, error);
}

/* T_cn_cnm1, four rows of four. */
static td_status read_transform(td_pose *pose, const td_field *field, td_error *error)
{
    size_t rows = 0;
    double m[16];
    TD_TRY(td_field_count(&rows, field, 4, 4, error));
    for (size_t i = 0; i < rows; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field row = td_field_at(field, i, index);
        TD_TRY(td_field_reals(m + 4 * i, 4, &row, -LARGEST, LARGEST, error));
    }
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1)
        return td_field_fail(field, error, "must end in the row [0, 0, 0, 1]");
    const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, t[3] = {m[3], m[7], m[11]};
    return td_rig_take_pose(pose, r, t, field, error);
}

/* The name in /NAME/image_raw; "" for other topics. */
static void name_of_topic(char name[TD_NAME_SIZE], const json_t *topic)
{
    const char *text = json_is_string(topic) ? json_string_value(topic) : "";
    const size_t length = strlen(text), end = strlen(TOPIC_END);
    name[0] = 0;
    if (length <= end + 1 || *text != '/' || strcmp(text + length - end, TOPIC_END) != 0) return;
    snprintf(name, TD_NAME_SIZE, "%.*s", (int)(length - end - 1), text + 1);
    if (!td_name_is_plain(name)) name[0] = 0;
}

static td_status read_camera(td_rig_reading *reading, const td_field *field, td_error *error)
{
    td_rig_camera *c = NULL;
    const int index = reading->rig->count;
    TD_TRY(td_rig_next(&c, reading->rig, field->parent->name, error));
    TD_TRY(read_model(&c->camera, field, error));
    td_field resolution = td_field_get(field, "resolution"), topic = td_field_get(field, "rostopic");
    td_field transform = td_field_get(field, "T_cn_cnm1");
    double size[2];
    TD_TRY(td_field_reals(size, 2, &resolution, 1, 1e6, error));
    c->camera.width = (int)size[0];
    c->camera.height = (int)size[1];
    if (index && !transform.value && !reading->options->camera)
        return td_field_fail(&transform, error, "is missing; must be the pose to the camera before");
    if (index && !transform.value) reading->poses_unknown = true;
    if (index && transform.value) {
        td_pose step;
        TD_TRY(read_transform(&step, &transform, error));
        c->camera_from_rig = td_pose_compose(&step, &c[-1].camera_from_rig);
    }
    char name[TD_NAME_SIZE];
    name_of_topic(name, topic.value);
    td_rig_name(reading->rig, c, name, field->name);
    return TD_OK;
}

static td_status read_document(td_rig_reading *reading, const td_field *root, td_error *error)
{
    for (int i = 0; i <= TD_RIG_MAX_CAMERAS; i++) {
        char key[16];
        snprintf(key, sizeof key, "cam%d", i);
        td_field field = td_field_get(root, key);
        if (!field.value && i) return TD_OK;
        if (!json_is_object(field.value))
            return td_field_fail(&field, error,
                                 field.value ? "must be a mapping"
                                             : "is missing: this is no camchain of Kalibr's");
        TD_TRY(read_camera(reading, &field, error));
    }
    return TD_OK;
}

static td_status read_kalibr(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error)
{
    if (count != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: a camchain holds all its cameras; give one file, not %zu", file->name, count);
    json_t *document = NULL;
    TD_TRY(td_document_parse(&document, file->text, file->size, file->name, error));
    const td_field root = {NULL, file->name, document};
    const td_status status = read_document(reading, &root, error);
    json_decref(document);
    return status;
}

/* ---- writing ---- */

static void add_transform(td_text *out, const td_rig *rig, int camera)
{
    const td_pose rig_from_last = td_pose_inverse(&rig->camera[camera - 1].camera_from_rig);
    const td_pose step = td_pose_compose(&rig->camera[camera].camera_from_rig, &rig_from_last);
    double m[16];
    td_pose_matrix(m, &step);
    td_text_format(out, "  T_cn_cnm1:\n");
    for (int i = 0; i < 4; i++) {
        td_text_format(out, "  - [");
        td_rig_add_reals(out, m + 4 * i, 4);
        td_text_format(out, "]\n");
    }
}

static void add_overlaps(td_text *out, const td_rig *rig, int camera)
{
    const char *comma = "";
    td_text_format(out, "  cam_overlaps: [");
    for (int i = 0; i < rig->count; i++)
        if (i != camera) {
            td_text_format(out, "%s%d", comma, i);
            comma = ", ";
        }
    td_text_format(out, "]\n");
}

static void write_kalibr(td_text *out, const td_rig *rig, int unused)
{
    (void)unused;
    for (int i = 0; i < rig->count; i++) {
        const td_camera *camera = &rig->camera[i].camera;
        const bool none = camera->model == TD_CAMERA_PINHOLE;
        td_text_format(out, "cam%d:\n", i);
        if (i) add_transform(out, rig, i);
        add_overlaps(out, rig, i);
        td_text_format(out, "  camera_model: pinhole\n  distortion_coeffs: [");
        td_rig_add_reals(out, camera->parameter + 4, none ? 0 : 4);
        td_text_format(out, "]\n  distortion_model: %s\n  intrinsics: [",
                       none                                 ? "none"
                       : camera->model == TD_CAMERA_FISHEYE ? "equidistant"
                                                            : "radtan");
        td_rig_add_reals(out, camera->parameter, 4);
        td_text_format(out, "]\n  resolution: [%d, %d]\n  rostopic: /%s%s\n", camera->width, camera->height,
                       rig->camera[i].name, TOPIC_END);
    }
}

const td_rig_room td_rig_room_kalibr = {.name = "kalibr",
                                        .title = "Kalibr's camchain",
                                        .file = "camchain.yaml",
                                        .shape = shapes,
                                        .shape_count = sizeof shapes / sizeof *shapes,
                                        .read = read_kalibr,
                                        .write = write_kalibr};
