/* mrcal's .cameramodel (mrcal.cameramodel): a file for each camera, a Python dictionary. `extrinsics` is
 * rt_cam_ref, the rotation vector and translation of camera_from_reference; the reference is any frame that
 * the files share. */
#include <stdlib.h>
#include <string.h>

#include "core/python_literal_internal.h"
#include "core/rig_formats_internal.h"

static const td_rig_shape shapes[] = {
    {"LENSMODEL_PINHOLE", TD_CAMERA_PINHOLE, 0},
    {"LENSMODEL_OPENCV5", TD_CAMERA_BROWN5, 0},
    {"LENSMODEL_OPENCV8", TD_CAMERA_BROWN8, 0},
};
static const double LARGEST = 1e9;

/* ---- reading ---- */

static td_status read_intrinsics(td_camera *camera, const td_field *root, td_error *error)
{
    static const struct {
        const char *name;
        size_t distortion;
    } models[] = {{"LENSMODEL_PINHOLE", 0},
                  {"LENSMODEL_OPENCV4", 4},
                  {"LENSMODEL_OPENCV5", 5},
                  {"LENSMODEL_OPENCV8", 8},
                  {"LENSMODEL_OPENCV12", 12}};
    td_field model = td_field_get(root, "lensmodel"), intrinsics = td_field_get(root, "intrinsics");
    const char *name = NULL;
    char shown[TD_SHOWN_SIZE];
    double value[16];
    TD_TRY(td_field_string(&name, &model, error));
    for (size_t i = 0; i < sizeof models / sizeof *models; i++) {
        if (strcmp(name, models[i].name) != 0) continue;
        TD_TRY(td_field_reals(value, 4 + models[i].distortion, &intrinsics, -LARGEST, LARGEST, error));
        memcpy(camera->parameter, value, 4 * sizeof(double));
        return td_rig_take_brown(camera, value + 4, models[i].distortion, &intrinsics, error);
    }
    return td_field_fail(
        &model, error,
        "is '%s', which no model here holds; fit LENSMODEL_OPENCV8 to it with mrcal-convert-lensmodel "
        "and convert that",
        td_text_shown(shown, name));
}

static td_status read_camera(td_rig_reading *reading, const td_field *root, td_error *error)
{
    td_rig_camera *c = NULL;
    double size[2], rt[6];
    if (!json_is_object(root->value)) return td_field_fail(root, error, "is no dictionary");
    TD_TRY(td_rig_next(&c, reading->rig, root->name, error));
    td_field imager = td_field_get(root, "imagersize"), extrinsics = td_field_get(root, "extrinsics");
    if (!extrinsics.value) extrinsics = td_field_get(root, "rt_cam_ref");
    TD_TRY(read_intrinsics(&c->camera, root, error));
    TD_TRY(td_field_reals(size, 2, &imager, 1, 1e6, error));
    c->camera.width = (int)size[0];
    c->camera.height = (int)size[1];
    TD_TRY(td_field_reals(rt, 6, &extrinsics, -1e6, 1e6, error));
    td_rotation_exp(c->camera_from_rig.q, rt);
    memcpy(c->camera_from_rig.t, rt + 3, 3 * sizeof(double));
    char *stem = td_rig_stem(root->name);
    if (!stem) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its content", root->name);
    td_rig_name(reading->rig, c, stem, "camera");
    free(stem);
    return TD_OK;
}

static td_status read_mrcal(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error)
{
    for (size_t i = 0; i < count; i++) {
        json_t *tree = NULL;
        TD_TRY(td_python_parse(&tree, file[i].text, file[i].size, file[i].name, error));
        const td_field root = {NULL, file[i].name, tree};
        const td_status status = read_camera(reading, &root, error);
        json_decref(tree);
        TD_TRY(status);
    }
    return TD_OK;
}

/* ---- writing ---- */

static void write_mrcal(td_text *out, const td_rig *rig, int camera)
{
    const td_rig_camera *c = rig->camera + camera;
    double rt[6];
    td_rotation_log(rt, c->camera_from_rig.q);
    memcpy(rt + 3, c->camera_from_rig.t, 3 * sizeof(double));
    size_t shape = 0;
    while (shapes[shape].model != c->camera.model) shape++;
    td_text_format(out, "{\n    'lensmodel': '%s',\n\n    'intrinsics': [ ", shapes[shape].name);
    td_rig_add_reals(out, c->camera.parameter, (size_t)td_camera_parameter_count(c->camera.model));
    td_text_format(out,
                   " ],\n\n    # rt_cam_ref: the reference is the rig's first camera\n    'extrinsics': [ ");
    td_rig_add_reals(out, rt, 6);
    td_text_format(out, " ],\n\n    'imagersize': [ %d, %d ],\n}\n", c->camera.width, c->camera.height);
}

const td_rig_room td_rig_room_mrcal = {.name = "mrcal",
                                       .title = "mrcal's cameramodel",
                                       .file = "%s.cameramodel",
                                       .file_per_camera = true,
                                       .shape = shapes,
                                       .shape_count = sizeof shapes / sizeof *shapes,
                                       .read = read_mrcal,
                                       .write = write_mrcal};
