/* ViSP's camera XML (vpXmlParserCamera). Models, with (x, y) = (X, Y) / Z and r the distance from the centre:
 *   perspectiveProjWithoutDistortion    u = u0 + px x
 *   perspectiveProjWithDistortion       u = u0 + px x (1 + kud r^2), our k1; back from pixels ViSP takes
 *                                       x = (u - u0) / px (1 + kdu r_d^2), which only comes near the inverse
 *   ProjWithKannalaBrandtDistortion     our fisheye; a fifth coefficient is written by ViSP but not used
 * A camera may have several models: the one with the most parameters is read. Poses are not held. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/number.h"
#include "core/rig_formats_internal.h"
#include "core/xml_internal.h"

enum { HELD_BUT_K1 = 1 << 5 | 1 << 6 | 1 << 7 | 1 << 8, FIT_POINTS = 200 };

static const td_rig_shape shapes[] = {
    {"perspectiveProjWithoutDistortion", TD_CAMERA_PINHOLE, 0},
    {"perspectiveProjWithDistortion", TD_CAMERA_BROWN5, HELD_BUT_K1},
    {"ProjWithKannalaBrandtDistortion", TD_CAMERA_FISHEYE, 0},
};
enum { SHAPES = sizeof shapes / sizeof *shapes };
static const double LARGEST = 1e9;

/* ---- reading ---- */

/* Element `index` of what is one element or a list of them. */
static td_field element_at(const td_field *field, size_t index, char name[TD_FIELD_INDEX_SIZE])
{
    if (json_is_array(field->value)) return td_field_at(field, index, name);
    return *field;
}

static size_t element_count(const td_field *field)
{
    return json_is_array(field->value) ? json_array_size(field->value) : field->value != NULL;
}

static td_status read_shape(int *shape, const td_field *field, td_error *error)
{
    td_field type = td_field_get(field, "type");
    const char *name = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_string(&name, &type, error));
    for (*shape = 0; *shape < SHAPES; ++*shape)
        if (!strcmp(shapes[*shape].name, name)) return TD_OK;
    return td_field_fail(&type, error, "is '%s', but there are %s, %s and %s", td_text_shown(shown, name),
                         shapes[0].name, shapes[1].name, shapes[2].name);
}

static td_status read_parameters(td_camera *camera, int shape, const td_field *field, td_error *error)
{
    static const char *const intrinsics[] = {"px", "py", "u0", "v0"}, *const k[] = {"k1", "k2", "k3", "k4"};
    camera->model = shapes[shape].model;
    for (int i = 0; i < 4; i++) {
        td_field value = td_field_get(field, intrinsics[i]);
        TD_TRY(td_field_real(camera->parameter + i, &value, -LARGEST, LARGEST, error));
    }
    for (int i = 0; camera->model == TD_CAMERA_FISHEYE && i < 4; i++) {
        td_field value = td_field_get(field, k[i]);
        TD_TRY(td_field_real(camera->parameter + 4 + i, &value, -LARGEST, LARGEST, error));
    }
    if (camera->model != TD_CAMERA_BROWN5) return TD_OK;
    td_field kud = td_field_get(field, "kud"), kdu = td_field_get(field, "kdu");
    double back = 0;
    TD_TRY(td_field_real(camera->parameter + 4, &kud, -LARGEST, LARGEST, error));
    TD_TRY(td_field_real(&back, &kdu, -LARGEST, LARGEST, error));
    if (camera->parameter[4] == 0 && back != 0)
        return td_field_fail(&kud, error,
                             "is 0, but kdu is %g: which holds is not to be told; set kud, near -kdu", back);
    return TD_OK;
}

/* The richest of the camera's models. */
static td_status read_models(td_camera *camera, const td_field *models, td_error *error)
{
    int best = -1;
    if (!element_count(models)) return td_field_fail(models, error, "is missing");
    for (size_t i = 0; i < element_count(models); i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field field = element_at(models, i, index);
        int shape = 0;
        if (!json_is_object(field.value)) return td_field_fail(&field, error, "holds nothing");
        TD_TRY(read_shape(&shape, &field, error));
        if (shape <= best) continue;
        best = shape;
        TD_TRY(read_parameters(camera, shape, &field, error));
    }
    return TD_OK;
}

/* A camera of another size than asked for is passed over: ViSP keeps several under one name. */
static td_status read_camera(td_rig_reading *reading, const td_field *field, const char *file,
                             td_error *error)
{
    const td_rig_import_options *options = reading->options;
    td_rig_camera read = {.camera_from_rig = td_pose_identity()}, *c = NULL;
    td_field width = td_field_get(field, "image_width"), height = td_field_get(field, "image_height");
    td_field name = td_field_get(field, "name"), model = td_field_get(field, "model");
    if (!json_is_object(field->value)) return td_field_fail(field, error, "holds nothing");
    if (width.value) TD_TRY(td_field_int(&read.camera.width, &width, 0, 1000000, error));
    if (height.value) TD_TRY(td_field_int(&read.camera.height, &height, 0, 1000000, error));
    if (options->width && read.camera.width && options->width != read.camera.width) return TD_OK;
    if (options->height && read.camera.height && options->height != read.camera.height) return TD_OK;
    TD_TRY(read_models(&read.camera, &model, error));
    TD_TRY(td_rig_next(&c, reading->rig, file, error));
    *c = read;
    td_rig_name(reading->rig, c, json_string_value(name.value), "camera");
    return TD_OK;
}

static td_status read_document(td_rig_reading *reading, const td_field *root, td_error *error)
{
    td_field cameras = td_field_get(root, "camera");
    if (!element_count(&cameras)) return td_field_fail(&cameras, error, "is missing: no camera is told");
    for (size_t i = 0; i < element_count(&cameras); i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field camera = element_at(&cameras, i, index);
        TD_TRY(read_camera(reading, &camera, root->name, error));
    }
    if (!reading->rig->count)
        return td_field_fail(&cameras, error, "none is of %d x %d px", reading->options->width,
                             reading->options->height);
    return TD_OK;
}

static td_status read_visp(td_rig_reading *reading, const td_rig_text *file, size_t count, td_error *error)
{
    reading->poses_unknown = true;
    for (size_t i = 0; i < count; i++) {
        json_t *document = NULL;
        char name[32];
        TD_TRY(td_xml_parse(&document, name, file[i].text, file[i].size, file[i].name, error));
        const td_field root = {NULL, file[i].name, document};
        td_status status = read_document(reading, &root, error);
        json_decref(document);
        TD_TRY(status);
    }
    return TD_OK;
}

/* ---- writing ---- */

/* kdu by least squares over the image: x_d (1 + kdu r_d^2) = x at x_d = x (1 + kud r^2), weighed in px; and
 * how far ViSP's way back from pixels then is from the truth at worst. */
static double inverse_distortion(double *worst_px, const td_camera *camera)
{
    const double *p = camera->parameter;
    double above = 0, below = 0;
    *worst_px = 0;
    if (p[4] == 0) return 0;
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i <= FIT_POINTS; i++) {
            const double edge[2] = {p[2] + 0.5 > camera->width / 2. ? -0.5 : camera->width - 0.5,
                                    p[3] + 0.5 > camera->height / 2. ? -0.5 : camera->height - 0.5};
            const double pixel[2] = {p[2] + (edge[0] - p[2]) * i / FIT_POINTS,
                                     p[3] + (edge[1] - p[3]) * i / FIT_POINTS};
            double ray[3];
            if (!td_camera_unproject(ray, NULL, NULL, camera, pixel) || !(ray[2] > 0)) continue;
            const double rd = hypot((pixel[0] - p[2]) / p[0], (pixel[1] - p[3]) / p[1]);
            const double r = hypot(ray[0], ray[1]) / ray[2], cube = rd * rd * rd;
            if (pass)
                *worst_px = fmax(*worst_px, fmax(p[0], p[1]) * fabs(rd + above / below * cube - r));
            else {
                above += rd * cube * (r - rd); /* weighed by the ring's circumference */
                below += rd * cube * cube;
            }
        }
    if (!(below > 0)) *worst_px = 0;
    return below > 0 ? above / below : 0;
}

static void add_element(td_text *out, const char *name, double value)
{
    char number[TD_NUMBER_SIZE];
    td_text_format(out, "      <%s>%s</%s>\n", name, td_number_format(number, value, 17), name);
}

static void add_model(td_text *out, const td_camera *camera)
{
    static const char *const intrinsics[] = {"px", "py", "u0", "v0"};
    static const char *const k[] = {"k1", "k2", "k3", "k4", "k5"};
    const double *p = camera->parameter;
    size_t shape = 0;
    while (shapes[shape].model != camera->model) shape++;
    td_text_format(out, "    <model>\n      <type>%s</type>\n", shapes[shape].name);
    for (int i = 0; i < 4; i++) add_element(out, intrinsics[i], p[i]);
    if (camera->model == TD_CAMERA_BROWN5) {
        double worst;
        add_element(out, "kud", p[4]);
        add_element(out, "kdu", inverse_distortion(&worst, camera));
    }
    for (int i = 0; camera->model == TD_CAMERA_FISHEYE && i < 5; i++)
        add_element(out, k[i], i < 4 ? p[4 + i] : 0);
    td_text_format(out, "    </model>\n");
}

static void write_visp(td_text *out, const td_rig *rig, int unused)
{
    (void)unused;
    td_text_format(out, "<?xml version=\"1.0\"?>\n<root>\n");
    for (int i = 0; i < rig->count; i++) {
        const td_camera *camera = &rig->camera[i].camera;
        td_text_format(out,
                       "  <camera>\n    <name>%s</name>\n    <image_width>%d</image_width>\n"
                       "    <image_height>%d</image_height>\n",
                       rig->camera[i].name, camera->width, camera->height);
        add_model(out, camera);
        td_text_format(out, "  </camera>\n");
    }
    td_text_format(out, "</root>\n");
}

static void remark(char *text, size_t size, const td_rig *rig)
{
    if (rig->count > 1) td_rig_add_remark(text, size, "The poses of the cameras are not held.");
    for (int i = 0; i < rig->count; i++) {
        double worst = 0;
        if (rig->camera[i].camera.model != TD_CAMERA_BROWN5) continue;
        inverse_distortion(&worst, &rig->camera[i].camera);
        td_rig_add_remark(text, size, "%s: ViSP's way back from pixels (kdu) is off by up to %.2g px.",
                          rig->camera[i].name, worst);
    }
}

const td_rig_room td_rig_room_visp = {.name = "visp",
                                      .title = "ViSP's XML",
                                      .file = "visp.xml",
                                      .shape = shapes,
                                      .shape_count = SHAPES,
                                      .read = read_visp,
                                      .write = write_visp,
                                      .remark = remark};
