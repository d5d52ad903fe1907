/* rig.yaml. Written line by line here, so that its order and layout stay as they are in core/rig.h; the
 * covariance and the provenance go through core/document.h. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/document_internal.h"
#include "core/file.h"
#include "core/number.h"
#include "core/rig.h"
#include "core/text_internal.h"

enum { VERSION = 1, INTRINSICS = 4 };

static const char KIND[] = "rig";
/* Far beyond every parameter of a camera; what is too much, td_camera_check says. */
static const double LARGEST_PARAMETER = 1e9;

static const char HEAD[] =
    "# Cameras fixed to one another. Pixels, metres, radians; pixel (0, 0) is the centre of the first "
    "pixel.\n"
    "# camera_from_rig takes coordinates of the rig, which are the first camera's, to those of the camera\n"
    "# (x right, y down, z forward); q is a unit quaternion [w, x, y, z].\n"
    "# covariance: rx ry rz tx ty tz are the left perturbation xi of camera_from_rig, Exp(xi) * "
    "camera_from_rig\n"
    "# with xi = [rotation (rad); translation (m)] in the camera's frame.\n";

/* ---- writing ---- */

static void add_reals(td_text *out, const double *value, int count)
{
    char number[TD_NUMBER_SIZE];
    for (int i = 0; i < count; i++)
        td_text_format(out, "%s%s", i ? ", " : "", td_number_format(number, value[i], 0));
}

static void add_pose(td_text *out, const td_pose *pose)
{
    td_text_format(out, "{q: [");
    add_reals(out, pose->q, 4);
    td_text_format(out, "], t_m: [");
    add_reals(out, pose->t, 3);
    td_text_format(out, "]}\n");
}

/* "    KEY: {fx: 1.0, …}" with the parameters first … last-1. */
static void add_parameters(td_text *out, const char *key, const td_camera *camera, int first, int last)
{
    if (first == last) return;
    char number[TD_NUMBER_SIZE];
    td_text_format(out, "    %s: {", key);
    for (int i = first; i < last; i++)
        td_text_format(out, "%s%s: %s", i > first ? ", " : "", td_camera_parameter_name(camera->model, i),
                       td_number_format(number, camera->parameter[i], 0));
    td_text_format(out, "}\n");
}

static void add_camera(td_text *out, const td_rig_camera *c)
{
    const td_camera *camera = &c->camera;
    td_text_format(out, "  - name: ");
    td_document_add_word(out, c->name);
    td_text_format(out, "\n    model: %s\n    width: %d\n    height: %d\n",
                   td_camera_model_name(camera->model), camera->width, camera->height);
    add_parameters(out, "intrinsics", camera, 0, INTRINSICS);
    add_parameters(out, "distortion", camera, INTRINSICS, td_camera_parameter_count(camera->model));
    td_text_format(out, "    camera_from_rig: ");
    add_pose(out, &c->camera_from_rig);
}

/* {covariance: {order, matrix}, provenance}; NULL: out of memory. */
static json_t *make_tail(const td_rig *rig)
{
    json_t *tail = json_object();
    const size_t n = td_rig_parameter_count(rig);
    int failed = 0;
    if (rig->covariance) {
        json_t *order = json_array(), *covariance = json_object();
        for (size_t i = 0; i < n; i++) {
            char name[TD_NAME_SIZE + 8];
            failed |= json_array_append_new(order, json_string(td_rig_parameter_name(name, rig, i)));
        }
        failed |= json_object_set_new(covariance, "order", order);
        failed |= json_object_set_new(covariance, "matrix", td_json_matrix(rig->covariance, n, n));
        failed |= json_object_set_new(tail, "covariance", covariance);
    }
    if (rig->provenance) failed |= json_object_set(tail, "provenance", rig->provenance);
    if (!failed) return tail;
    json_decref(tail);
    return NULL;
}

static td_status add_tail(td_text *out, const td_rig *rig, td_error *error)
{
    if (!rig->covariance && !rig->provenance) return TD_OK;
    json_t *tail = make_tail(rig);
    if (!tail) return td_fail(error, TD_ERROR_MEMORY, "no memory for the covariance of a rig");
    char *text = NULL;
    td_status status = td_document_to_yaml(&text, tail, 0, error);
    if (status == TD_OK) td_text_add(out, text, strlen(text));
    free(text);
    json_decref(tail);
    return status;
}

td_status td_rig_to_yaml(char **text, const td_rig *rig, td_error *error)
{
    TD_TRY(td_rig_check(rig, error));
    td_text out = {0};
    td_text_format(&out, "%steledimos: %s %d\ncameras:\n", HEAD, KIND, VERSION);
    for (int i = 0; i < rig->count; i++) add_camera(&out, rig->camera + i);
    if (rig->has_vehicle) {
        td_text_format(&out, "vehicle_from_rig: ");
        add_pose(&out, &rig->vehicle_from_rig);
    }
    td_status status = add_tail(&out, rig, error);
    if (status == TD_OK && out.failed)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the text of a rig");
    if (status == TD_OK)
        *text = out.data;
    else
        free(out.data);
    return status;
}

td_status td_rig_write(const td_rig *rig, const char *path, td_error *error)
{
    char *text = NULL;
    td_status status = td_rig_to_yaml(&text, rig, error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s: the rig cannot be written", path);
    status = td_file_write(path, text, strlen(text), error);
    free(text);
    return status;
}

/* ---- reading ---- */

static td_status parse_magic(const td_field *root, td_error *error)
{
    td_field field = td_field_get(root, "teledimos");
    const char *text = NULL;
    char shown[TD_SHOWN_SIZE];
    if (!field.value)
        return td_field_fail(root, error, "is not a rig: 'teledimos: %s %d' is missing at its beginning",
                             KIND, VERSION);
    TD_TRY(td_field_string(&text, &field, error));
    const size_t length = strlen(KIND);
    long long version = 0;
    if (strncmp(text, KIND, length) != 0 || text[length] != ' ')
        return td_field_fail(&field, error, "is '%s', so this is not a rig ('%s %d')",
                             td_text_shown(shown, text), KIND, VERSION);
    if (td_number_parse(&version, NULL, text + length + 1) != TD_NUMBER_INTEGER || version < 1)
        return td_field_fail(&field, error, "is '%s', which is no version of a rig ('%s %d')",
                             td_text_shown(shown, text), KIND, VERSION);
    if (version > VERSION)
        return td_field_fail(
            &field, error,
            "is version %lld of a rig, but this program reads up to version %d; use a newer one", version,
            VERSION);
    return TD_OK;
}

static td_status parse_model(td_camera_model *model, const td_field *field, td_error *error)
{
    const char *name = NULL;
    TD_TRY(td_field_string(&name, field, error));
    *model = td_camera_model_from_name(name);
    if (*model != TD_CAMERA_MODEL_COUNT) return TD_OK;
    char shown[TD_SHOWN_SIZE], list[TD_SHOWN_SIZE] = "";
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++) {
        const size_t used = strlen(list);
        snprintf(list + used, sizeof list - used, "%s%s", i ? ", " : "",
                 td_camera_model_name((td_camera_model)i));
    }
    return td_field_fail(field, error, "is '%s', but must be one of %s", td_text_shown(shown, name), list);
}

/* The parameters first … last-1 of the model, all of them and no others. */
static td_status parse_parameters(td_camera *camera, const td_field *field, int first, int last,
                                  td_error *error)
{
    const char *keys[TD_CAMERA_MAX_PARAMETERS + 1] = {NULL};
    for (int i = first; i < last; i++) keys[i - first] = td_camera_parameter_name(camera->model, i);
    TD_TRY(td_field_check_keys(field, keys, error));
    for (int i = first; i < last; i++) {
        td_field value = td_field_get(field, keys[i - first]);
        TD_TRY(td_field_real(camera->parameter + i, &value, -LARGEST_PARAMETER, LARGEST_PARAMETER, error));
    }
    return TD_OK;
}

/* Reads one camera; `field` is called by the camera's name once that is known. */
static td_status parse_camera(td_rig_camera *c, td_field *field, td_error *error)
{
    static const char *const keys[] = {"name",       "model",      "width",           "height",
                                       "intrinsics", "distortion", "camera_from_rig", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    const char *text = NULL;
    td_field name = td_field_get(field, "name");
    TD_TRY(td_field_string(&text, &name, error));
    if (!td_name_is_plain(text))
        return td_field_fail(&name, error, "must be 1 to %d letters, digits, - and _", TD_NAME_SIZE - 1);
    strcpy(c->name, text);
    field->name = c->name;

    td_camera *camera = &c->camera;
    td_field model = td_field_get(field, "model"), width = td_field_get(field, "width");
    td_field height = td_field_get(field, "height"), pose = td_field_get(field, "camera_from_rig");
    td_field intrinsics = td_field_get(field, "intrinsics"), distortion = td_field_get(field, "distortion");
    TD_TRY(parse_model(&camera->model, &model, error));
    TD_TRY(td_field_int(&camera->width, &width, 1, 1000000, error));
    TD_TRY(td_field_int(&camera->height, &height, 1, 1000000, error));
    const int count = td_camera_parameter_count(camera->model);
    TD_TRY(parse_parameters(camera, &intrinsics, 0, INTRINSICS, error));
    if (count > INTRINSICS || distortion.value)
        TD_TRY(parse_parameters(camera, &distortion, INTRINSICS, count, error));
    return td_field_pose(&c->camera_from_rig, &pose, error);
}

static td_status parse_order(const td_rig *rig, const td_field *field, td_error *error)
{
    size_t size = 0;
    const size_t n = td_rig_parameter_count(rig);
    TD_TRY(td_field_count(&size, field, n, n, error));
    for (size_t i = 0; i < n; i++) {
        char index[TD_FIELD_INDEX_SIZE], expected[TD_NAME_SIZE + 8], shown[TD_SHOWN_SIZE];
        td_field element = td_field_at(field, i, index);
        const char *name = NULL;
        TD_TRY(td_field_string(&name, &element, error));
        td_rig_parameter_name(expected, rig, i);
        if (strcmp(name, expected) != 0)
            return td_field_fail(&element, error, "is '%s', but the cameras above have '%s' here",
                                 td_text_shown(shown, name), expected);
    }
    return TD_OK;
}

static td_status parse_covariance(td_rig *rig, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"order", "matrix", NULL};
    if (!field->value || json_is_null(field->value)) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field order = td_field_get(field, "order"), matrix = td_field_get(field, "matrix");
    TD_TRY(parse_order(rig, &order, error));
    size_t rows = 0;
    const size_t n = td_rig_parameter_count(rig);
    TD_TRY(td_field_count(&rows, &matrix, n, n, error));
    rig->covariance = calloc(n * n, sizeof(double));
    if (!rig->covariance) return td_fail(error, TD_ERROR_MEMORY, "no memory for the covariance of a rig");
    for (size_t i = 0; i < n; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field row = td_field_at(&matrix, i, index);
        TD_TRY(td_field_reals(rig->covariance + i * n, n, &row, -INFINITY, INFINITY, error));
    }
    return TD_OK;
}

static td_status parse_cameras(td_rig *rig, const td_field *field, td_error *error)
{
    size_t count = 0;
    TD_TRY(td_field_count(&count, field, 1, TD_RIG_MAX_CAMERAS, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field camera = td_field_at(field, i, index);
        TD_TRY(parse_camera(rig->camera + i, &camera, error));
        if (td_rig_find(rig, rig->camera[i].name) >= 0)
            return td_field_fail(field, error, "the name '%s' is given twice", rig->camera[i].name);
        rig->count = (int)i + 1;
    }
    return TD_OK;
}

static td_status parse_rig(td_rig *rig, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"teledimos",  "cameras",    "vehicle_from_rig",
                                       "covariance", "provenance", NULL};
    TD_TRY(parse_magic(root, error));
    TD_TRY(td_field_check_keys(root, keys, error));
    td_field cameras = td_field_get(root, "cameras"), vehicle = td_field_get(root, "vehicle_from_rig");
    td_field covariance = td_field_get(root, "covariance"), provenance = td_field_get(root, "provenance");
    TD_TRY(parse_cameras(rig, &cameras, error));
    rig->has_vehicle = vehicle.value && !json_is_null(vehicle.value);
    if (rig->has_vehicle) TD_TRY(td_field_pose(&rig->vehicle_from_rig, &vehicle, error));
    TD_TRY(parse_covariance(rig, &covariance, error));
    if (provenance.value && !json_is_null(provenance.value)) {
        if (!json_is_object(provenance.value)) return td_field_fail(&provenance, error, "must be a mapping");
        rig->provenance = json_incref((json_t *)provenance.value);
    }
    td_error why;
    if (td_rig_check(rig, &why) != TD_OK) return td_field_fail(root, error, "%s", why.message);
    return TD_OK;
}

static td_status rig_of_document(td_rig **rig, const json_t *document, const char *name, td_error *error)
{
    td_rig *made = td_rig_new();
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a rig", name);
    const td_field root = {NULL, name, document};
    td_status status = parse_rig(made, &root, error);
    if (status == TD_OK)
        *rig = made;
    else
        td_rig_free(&made);
    return status;
}

td_status td_rig_parse(td_rig **rig, const char *text, size_t size, const char *name, td_error *error)
{
    json_t *document = NULL;
    TD_TRY(td_document_parse(&document, text, size, name, error));
    td_status status = rig_of_document(rig, document, name, error);
    json_decref(document);
    return status;
}

td_status td_rig_read(td_rig **rig, const char *path, td_error *error)
{
    json_t *document = NULL;
    TD_TRY(td_document_read(&document, path, error));
    td_status status = rig_of_document(rig, document, path, error);
    json_decref(document);
    return status;
}
