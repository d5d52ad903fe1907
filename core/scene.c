#include "core/scene.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/csv.h"
#include "core/file.h"
#include "core/scene_internal.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

enum { MAX_FRAMES = 10000 };

static const char KIND[] = "scene 1";
static const double FAR_M = 1e5, LARGEST_TIME_S = 1e12, DEGREE = 0.017453292519943295;

static td_status out_of_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a scene");
}

void td_scene_free(td_scene_file **file)
{
    if (!file || !*file) return;
    td_scene_file *f = *file;
    for (int i = 0; i < f->ground_count; i++) td_elevation_free(&f->ground[i].map);
    for (size_t i = 0; i < f->scene.solid_count; i++) {
        free(f->scene.solid[i].corner);
        free(f->scene.solid[i].triangle);
    }
    for (size_t i = 0; i < f->scene.picture_count; i++) td_image_free(&f->scene.picture[i].image);
    free(f->scene.solid);
    free(f->scene.picture);
    td_robot_free(&f->scene.robot);
    free(f->urdf);
    td_rig_free(&f->rig);
    json_decref(f->target);
    free(f->frame);
    free(f);
    *file = NULL;
}

/* ---- parts that others use ---- */

td_status td_scene_path(char **path, const td_field *field, const char *folder, td_error *error)
{
    const char *text = NULL;
    *path = NULL;
    TD_TRY(td_field_string(&text, field, error));
    if (!*text) return td_field_fail(field, error, "is empty");
    if (!folder) return TD_OK;
    *path = td_path_join(folder, text);
    return *path ? TD_OK : out_of_memory(error);
}

td_status td_scene_name(char name[TD_NAME_SIZE], const td_field *parent, td_error *error)
{
    const td_field field = td_field_get(parent, "name");
    const char *text = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_string(&text, &field, error));
    if (!td_name_is_plain(text))
        return td_field_fail(&field, error, "'%s' must be 1 to %d letters, digits, - and _",
                             td_text_shown(shown, text), TD_NAME_SIZE - 1);
    strcpy(name, text);
    return TD_OK;
}

td_status td_scene_real(double *value, const td_field *parent, const char *key, double low, double high,
                        td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

td_status td_scene_int(int *value, const td_field *parent, const char *key, int low, int high,
                       td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_int(value, &field, low, high, error) : TD_OK;
}

td_status td_scene_surface(td_surface *surface, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"albedo", "contrast", "grain_m", "octaves", "seed", NULL};
    *surface = (td_surface){.albedo = 0.4, .contrast = 0.25, .grain_m = 0.4, .octaves = 8, .seed = 1};
    if (!field->value) return TD_OK;
    int seed = 1;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_scene_real(&surface->albedo, field, "albedo", 0.01, 1, error));
    TD_TRY(td_scene_real(&surface->contrast, field, "contrast", 0, 1, error));
    TD_TRY(td_scene_real(&surface->grain_m, field, "grain_m", 1e-3, 100, error));
    TD_TRY(td_scene_int(&surface->octaves, field, "octaves", 0, 12, error));
    TD_TRY(td_scene_int(&seed, field, "seed", 0, 1 << 30, error));
    surface->seed = (uint64_t)seed;
    return TD_OK;
}

/* ---- scene.yaml ---- */

static td_status check_kind(const td_field *root, td_error *error)
{
    const td_field field = td_field_get(root, "teledimos");
    const char *text = NULL;
    char shown[TD_SHOWN_SIZE];
    if (!field.value)
        return td_field_fail(root, error, "is no scene: 'teledimos: %s' is missing at its beginning", KIND);
    TD_TRY(td_field_string(&text, &field, error));
    if (strcmp(text, KIND) == 0) return TD_OK;
    return td_field_fail(&field, error, "is '%s', but must be '%s'", td_text_shown(shown, text), KIND);
}

static td_status parse_grounds(td_scene_file *f, const td_field *field, const char *folder, td_error *error)
{
    size_t count = 0;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_count(&count, field, 1, TD_SCENE_MAX_GROUNDS, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field at = td_field_at(field, i, index);
        td_scene_ground *ground = f->ground + i;
        TD_TRY(td_scene_ground_parse(&ground->map, &at, folder, error));
        f->ground_count++;
        TD_TRY(td_scene_name(ground->name, &at, error));
        for (size_t k = 0; k < i; k++)
            if (strcmp(f->ground[k].name, ground->name) == 0)
                return td_field_fail(&at, error, "a ground of the name '%s' is there already", ground->name);
    }
    f->scene.ground = f->ground[0].map;
    return TD_OK;
}

static td_status parse_robot(td_scene_file *f, const td_field *field, const char *folder, td_error *error)
{
    static const char *const keys[] = {"urdf", "surface", NULL};
    char *path = NULL;
    const td_field surface = td_field_get(field, "surface"), urdf = td_field_get(field, "urdf");
    TD_TRY(td_scene_surface(&f->scene.robot_surface, &surface, error));
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_scene_path(&path, &urdf, folder, error));
    f->urdf = path;
    return path ? td_robot_read(&f->scene.robot, path, error) : TD_OK;
}

static td_status parse_mount(td_scene_file *f, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"link", "pose", NULL};
    f->mount_link = -1;
    f->mount_from_rig = f->rig && f->rig->has_vehicle ? f->rig->vehicle_from_rig : td_pose_identity();
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field link = td_field_get(field, "link"), pose = td_field_get(field, "pose");
    const char *name = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_pose(&f->mount_from_rig, &pose, error));
    if (!link.value) return TD_OK;
    TD_TRY(td_field_string(&name, &link, error));
    if (f->scene.robot) f->mount_link = td_robot_find_link(f->scene.robot, name);
    if (f->mount_link >= 0 || !f->rig) return TD_OK;
    return td_field_fail(&link, error, "the robot has no link '%s'", td_text_shown(shown, name));
}

static td_status parse_light(td_scene *scene, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"azimuth_deg", "elevation_deg", "ambient", NULL};
    double azimuth = 120, elevation = 50;
    scene->ambient = 0.3;
    if (field->value) {
        TD_TRY(td_field_check_keys(field, keys, error));
        TD_TRY(td_scene_real(&azimuth, field, "azimuth_deg", -360, 360, error));
        TD_TRY(td_scene_real(&elevation, field, "elevation_deg", 0, 90, error));
        TD_TRY(td_scene_real(&scene->ambient, field, "ambient", 0, 1, error));
    }
    scene->sun[0] = cos(elevation * DEGREE) * cos(azimuth * DEGREE);
    scene->sun[1] = cos(elevation * DEGREE) * sin(azimuth * DEGREE);
    scene->sun[2] = sin(elevation * DEGREE);
    return TD_OK;
}

static td_status parse_image(td_scene_image *image, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"samples", "blur_px",    "vignetting", "gain",
                                       "offset",  "read_noise", "shot_noise", NULL};
    *image = (td_scene_image){
        .samples = 3, .blur_px = 0.6, .vignetting = 0.5, .gain = 1, .read_noise = 1, .shot_noise = 0.02};
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_scene_int(&image->samples, field, "samples", 1, 8, error));
    TD_TRY(td_scene_real(&image->blur_px, field, "blur_px", 0, 10, error));
    TD_TRY(td_scene_real(&image->vignetting, field, "vignetting", 0, 1, error));
    TD_TRY(td_scene_real(&image->gain, field, "gain", 1e-3, 1e3, error));
    TD_TRY(td_scene_real(&image->offset, field, "offset", -255, 255, error));
    TD_TRY(td_scene_real(&image->read_noise, field, "read_noise", 0, 255, error));
    return td_scene_real(&image->shot_noise, field, "shot_noise", 0, 255, error);
}

static td_status parse_rig(td_scene_file *f, const td_field *field, const char *folder, td_error *error)
{
    char *path = NULL;
    TD_TRY(td_scene_path(&path, field, folder, error));
    td_status status = path ? td_rig_read(&f->rig, path, error) : TD_OK;
    free(path);
    return status;
}

static td_status parse_target(td_scene_file *f, const td_field *field, td_error *error)
{
    td_target target;
    if (!field->value) return TD_OK;
    TD_TRY(td_target_parse(&target, field, error));
    f->target = json_deep_copy(field->value);
    return f->target ? TD_OK : out_of_memory(error);
}

static td_status parse_description(td_scene_file *f, const td_field *root, const char *folder,
                                   td_error *error)
{
    static const char *const keys[] = {"teledimos", "name",    "about",  "rig",      "frames",
                                       "grounds",   "surface", "solids", "pictures", "robot",
                                       "mount",     "light",   "image",  "target",   NULL};
    TD_TRY(check_kind(root, error));
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(td_scene_name(f->name, root, error));
    const td_field about = td_field_get(root, "about"), rig = td_field_get(root, "rig");
    const td_field grounds = td_field_get(root, "grounds"), surface = td_field_get(root, "surface");
    const td_field solids = td_field_get(root, "solids"), pictures = td_field_get(root, "pictures");
    const td_field robot = td_field_get(root, "robot"), mount = td_field_get(root, "mount");
    const td_field light = td_field_get(root, "light"), image = td_field_get(root, "image");
    const td_field target = td_field_get(root, "target");
    const char *text = NULL;
    if (about.value) TD_TRY(td_field_string(&text, &about, error));
    TD_TRY(parse_target(f, &target, error));
    TD_TRY(parse_light(&f->scene, &light, error));
    TD_TRY(parse_image(&f->image, &image, error));
    TD_TRY(td_scene_surface(&f->scene.ground_surface, &surface, error));
    TD_TRY(parse_rig(f, &rig, folder, error));
    TD_TRY(parse_robot(f, &robot, folder, error));
    TD_TRY(parse_mount(f, &mount, error));
    TD_TRY(parse_grounds(f, &grounds, folder, error));
    TD_TRY(td_scene_solids_parse(&f->scene, &solids, folder, error));
    return td_scene_pictures_parse(&f->scene, &pictures, folder, error);
}

/* ---- frames.csv ---- */

static const char *const pose_columns[] = {"x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"};
enum { POSE_COLUMNS = 7 };

typedef struct columns {
    int frame, time, ground, pose[POSE_COLUMNS], joint[TD_ROBOT_MAX_JOINTS];
} columns;

static td_status find_columns(columns *at, const td_scene_file *f, const td_csv *csv, td_error *error)
{
    at->frame = td_csv_column(csv, "frame");
    at->time = td_csv_column(csv, "time_s");
    at->ground = td_csv_column(csv, "ground");
    int found = 0;
    for (int k = 0; k < POSE_COLUMNS; k++) {
        at->pose[k] = td_csv_column(csv, pose_columns[k]);
        found += at->pose[k] >= 0;
    }
    if (found && found < POSE_COLUMNS)
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: only %d of the pose's columns x_m y_m z_m qw qx qy qz are there", csv->name,
                       found);
    const td_robot *robot = f->scene.robot;
    for (int k = 0; robot && k < robot->joint_count; k++) {
        char name[TD_NAME_SIZE + 8];
        snprintf(name, sizeof name, "%s_%s", robot->joint[k].name,
                 robot->joint[k].kind == TD_JOINT_PRISMATIC ? "m" : "rad");
        at->joint[k] = td_csv_column(csv, name);
    }
    return TD_OK;
}

static td_status read_pose(td_pose *pose, const td_csv *csv, size_t row, const columns *at, td_error *error)
{
    double square = 0;
    *pose = td_pose_identity();
    if (at->pose[0] < 0) return TD_OK;
    for (int k = 0; k < 3; k++) TD_TRY(td_csv_real(&pose->t[k], csv, row, at->pose[k], -FAR_M, FAR_M, error));
    for (int k = 0; k < 4; k++) {
        TD_TRY(td_csv_real(&pose->q[k], csv, row, at->pose[3 + k], -1.001, 1.001, error));
        square += pose->q[k] * pose->q[k];
    }
    if (!(fabs(sqrt(square) - 1) < 1e-3))
        return td_csv_fail(csv, row, at->pose[3], error, "the quaternion's length is %g, but must be 1",
                           sqrt(square));
    for (int k = 0; k < 4; k++) pose->q[k] /= sqrt(square);
    return TD_OK;
}

static td_status read_ground(int *ground, const td_scene_file *f, const td_csv *csv, size_t row, int column,
                             td_error *error)
{
    char shown[TD_SHOWN_SIZE];
    *ground = f->ground_count ? 0 : -1;
    if (column < 0 || !f->ground_count) return TD_OK;
    const char *name = td_csv_cell(csv, row, column);
    for (int i = 0; i < f->ground_count; i++)
        if (strcmp(f->ground[i].name, name) == 0) {
            *ground = i;
            return TD_OK;
        }
    return td_csv_fail(csv, row, column, error, "the scene has no ground '%s'", td_text_shown(shown, name));
}

static td_status read_frame(td_scene_file *f, const td_csv *csv, size_t row, const columns *at,
                            td_error *error)
{
    td_scene_frame *frame = f->frame + row;
    const td_robot *robot = f->scene.robot;
    snprintf(frame->name, sizeof frame->name, "%04zu", row + 1);
    if (at->frame >= 0) {
        char shown[TD_SHOWN_SIZE];
        const char *name = td_csv_cell(csv, row, at->frame);
        if (!td_name_is_plain(name))
            return td_csv_fail(csv, row, at->frame, error, "'%s' must be 1 to %d letters, digits, - and _",
                               td_text_shown(shown, name), TD_NAME_SIZE - 1);
        strcpy(frame->name, name);
    }
    for (size_t k = 0; k < row; k++)
        if (strcmp(f->frame[k].name, frame->name) == 0)
            return td_csv_fail(csv, row, at->frame, error, "a frame '%s' is there already", frame->name);
    frame->time_s = NAN;
    if (at->time >= 0)
        TD_TRY(td_csv_real(&frame->time_s, csv, row, at->time, -LARGEST_TIME_S, LARGEST_TIME_S, error));
    TD_TRY(read_ground(&frame->ground, f, csv, row, at->ground, error));
    for (int k = 0; robot && k < robot->joint_count; k++)
        if (at->joint[k] >= 0) TD_TRY(td_csv_real(&frame->q[k], csv, row, at->joint[k], -1e3, 1e3, error));
    return read_pose(&frame->site_from_vehicle, csv, row, at, error);
}

static td_status read_frames(td_scene_file *f, const td_csv *csv, td_error *error)
{
    columns at;
    TD_TRY(find_columns(&at, f, csv, error));
    if (!csv->rows || csv->rows > MAX_FRAMES)
        return td_fail(error, TD_ERROR_FORMAT, "%s: has %zu frames; 1 to %d are accepted", csv->name,
                       csv->rows, MAX_FRAMES);
    f->frame = calloc(csv->rows, sizeof *f->frame);
    if (!f->frame) return out_of_memory(error);
    f->frame_count = csv->rows;
    for (size_t row = 0; row < csv->rows; row++) TD_TRY(read_frame(f, csv, row, &at, error));
    return TD_OK;
}

/* ---- both ---- */

void td_scene_pose(td_scene_file *file, size_t frame, td_pose *site_from_rig)
{
    const td_scene_frame *state = file->frame + frame;
    td_scene *scene = &file->scene;
    scene->ground = state->ground >= 0 ? file->ground[state->ground].map : NULL;
    scene->site_from_vehicle = state->site_from_vehicle;
    memcpy(scene->q, state->q, sizeof scene->q);
    td_pose site_from_mount = state->site_from_vehicle;
    if (scene->robot && file->mount_link >= 0) {
        td_pose root_from_link[TD_ROBOT_MAX_LINKS];
        td_robot_forward(root_from_link, scene->robot, scene->q);
        site_from_mount = td_pose_compose(&state->site_from_vehicle, root_from_link + file->mount_link);
    }
    *site_from_rig = td_pose_compose(&site_from_mount, &file->mount_from_rig);
}

/* The table from its text, or, when that is NULL, from the file that the description names. */
static td_status parse_both(td_scene_file *f, json_t *document, const char *name, const char *csv_text,
                            size_t csv_size, const char *folder, td_error *error)
{
    const td_field root = {NULL, name, document}, frames = td_field_get(&root, "frames");
    td_csv *csv = NULL;
    char *path = NULL;
    TD_TRY(parse_description(f, &root, folder, error));
    TD_TRY(td_scene_path(&path, &frames, folder, error));
    td_status status = csv_text ? td_csv_parse(&csv, csv_text, csv_size, "frames.csv", error)
                       : path   ? td_csv_read(&csv, path, error)
                                : td_fail(error, TD_ERROR_ARGUMENT, "the frames' table is missing");
    free(path);
    if (status == TD_OK) status = read_frames(f, csv, error);
    td_csv_free(&csv);
    if (status != TD_OK) return status;
    td_pose unused;
    td_scene_pose(f, 0, &unused);
    return TD_OK;
}

static td_status make(td_scene_file **file, json_t *document, const char *name, const char *csv,
                      size_t csv_size, const char *folder, td_error *error)
{
    td_scene_file *made = calloc(1, sizeof *made);
    td_status status =
        made ? parse_both(made, document, name, csv, csv_size, folder, error) : out_of_memory(error);
    if (status == TD_OK)
        *file = made;
    else
        td_scene_free(&made);
    json_decref(document);
    return status;
}

td_status td_scene_parse(td_scene_file **file, const char *yaml, size_t yaml_size, const char *csv,
                         size_t csv_size, const char *folder, td_error *error)
{
    json_t *document = NULL;
    *file = NULL;
    TD_TRY(td_document_parse(&document, yaml, yaml_size, "scene.yaml", error));
    return make(file, document, "scene.yaml", csv ? csv : "", csv_size, folder, error);
}

td_status td_scene_read(td_scene_file **file, const char *path, td_error *error)
{
    json_t *document = NULL;
    *file = NULL;
    const size_t length = strlen(path);
    const bool is_file = length > 5 && strcmp(path + length - 5, ".yaml") == 0;
    char *whole = is_file ? strdup(path) : td_path_join(path, "scene.yaml");
    char *folder = is_file ? td_path_folder(path) : strdup(path);
    td_status status = whole && folder ? td_document_read(&document, whole, error) : out_of_memory(error);
    if (status == TD_OK) status = make(file, document, whole, NULL, 0, folder, error);
    free(whole);
    free(folder);
    return status;
}
