/* teledimos render: what the cameras of a rig see of a scene, as a dataset with its truth. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "apps/cli.h"
#include "apps/terminal.h"
#include "core/csv.h"
#include "core/document.h"
#include "core/file.h"
#include "core/hash.h"
#include "core/linalg.h"
#include "core/scene.h"
#include "core/schema.h"
#include "sim/stereo_view.h"

static const char *scene_path, *range_text;
static cli_common common;

static cli_option options[] = {
    {CLI_STRING, "frames", 0, &range_text, "A..B",
     "only these rows of the scene's frames, from 1; default: all", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common, "folder for the dataset", "noise of the images"),
};

static cli_command command = {
    .name = "render",
    .summary = "draw what a rig's cameras see of a scene",
    .usage = "SCENE -o DATASET [options]",
    .text =
        "Renders the frames of SCENE (a folder with scene.yaml, or that file) with the rig's true "
        "distortion, blur, "
        "vignetting and noise, and writes a dataset that other jobs take: dataset.yaml, frames.csv, "
        "rig.yaml, "
        "CAMERA/FRAME.png; vehicle_from_rig is the scene's mount, in the frame of the link that carries the "
        "rig "
        "or of the vehicle. Beside it the truth: truth/CAMERA/FRAME.pfm (depth along the camera's z axis, m, "
        "of each "
        "pixel's centre; NaN: sky; portable float map, lowest row first), truth/poses.csv (site_from_rig), "
        "truth/ground-NAME.tif (heights, m).\n\n"
        "Run again after an interruption, it goes on where it stopped; frames of another scene are drawn "
        "anew.",
    .examples = "  teledimos render datasets/site-polyhedra -o polyhedra\n"
                "  teledimos render datasets/site-trench -o trench --frames 1..2\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &scene_path,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "render"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"scene", TD_SCHEMA_STRING, true, false, "its name"},
    {"scene_sha256", TD_SCHEMA_STRING, true, false, "of all that the images depend on"},
    {"cameras", TD_SCHEMA_STRINGS, true, false, "names"},
    {"frames", TD_SCHEMA_INT, true, false, "in the dataset"},
    {"frames_rendered", TD_SCHEMA_INT, true, false, "by this run"},
    {"frames_kept", TD_SCHEMA_INT, true, false, "that an earlier run had finished"},
    {"render_s", TD_SCHEMA_REAL, true, false, "wall-clock time of rendering, s, files left out"},
    {"frames_per_s", TD_SCHEMA_REAL, true, true, "all cameras, files left out; null: none rendered"},
    {"seen.*", TD_SCHEMA_REAL, true, false, "share of pixels that see it"},
    {"seen", TD_SCHEMA_OBJECT, true, false, "what this run's pixels see; shares"},
    {"products", TD_SCHEMA_STRINGS, true, false, "files and folders"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

enum { KINDS = TD_SEES_ROBOT + 1, PATH_SIZE = 4 * TD_NAME_SIZE };
static const char *const kind_names[KINDS] = {"sky", "ground", "solid", "picture", "robot"};

typedef struct job {
    td_scene_file *file;
    char sha256[TD_HASH_HEX_SIZE];
    size_t first, last; /* rows to render: [first, last) */
    size_t rendered, kept;
    double render_s;
    double seen[KINDS]; /* pixels */
    td_stereo_view *view[TD_SCENE_MAX_GROUNDS];
} job;

/* ---- files ---- */

static td_status write_file(const char *name, const void *bytes, size_t size, td_error *error)
{
    char *path = td_path_join(common.output, name);
    td_status status =
        path ? td_file_write(path, bytes, size, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

static td_status make_folder(const char *name, td_error *error)
{
    char *path = td_path_join(common.output, name);
    td_status status = path ? td_folder_make(path, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    free(path);
    return status;
}

static bool exists(const char *name)
{
    struct stat status;
    char *path = td_path_join(common.output, name);
    const bool there = path && stat(path, &status) == 0 && S_ISREG(status.st_mode);
    free(path);
    return there;
}

static void image_name(char name[PATH_SIZE], const job *j, size_t frame, int camera)
{
    snprintf(name, PATH_SIZE, "%s/%s.png", j->file->rig->camera[camera].name, j->file->frame[frame].name);
}

static void depth_name(char name[PATH_SIZE], const job *j, size_t frame, int camera)
{
    snprintf(name, PATH_SIZE, "truth/%s/%s.pfm", j->file->rig->camera[camera].name,
             j->file->frame[frame].name);
}

/* The image is written after its depth, so that a frame is whole when all its images are there. */
static bool is_whole(const job *j, size_t frame)
{
    char name[PATH_SIZE];
    for (int c = 0; c < j->file->rig->count; c++) {
        image_name(name, j, frame, c);
        if (!exists(name)) return false;
        depth_name(name, j, frame, c);
        if (!exists(name)) return false;
    }
    return true;
}

static td_status write_depth(const char *name, const td_view *view, td_error *error)
{
    const int width = view->image->width, height = view->image->height;
    const size_t row = (size_t)width * sizeof(float);
    char header[64];
    const int length = snprintf(header, sizeof header, "Pf\n%d %d\n-1.0\n", width, height);
    char *bytes = malloc((size_t)length + row * height);
    if (!bytes) return td_fail(error, TD_ERROR_MEMORY, "no memory for a depth image");
    memcpy(bytes, header, (size_t)length);
    for (int y = 0; y < height; y++)
        memcpy(bytes + length + row * y, view->depth + (size_t)(height - 1 - y) * width, row);
    td_status status = write_file(name, bytes, (size_t)length + row * height, error);
    free(bytes);
    return status;
}

static td_status write_image(const char *name, const td_image *image, td_error *error)
{
    uint8_t *bytes = NULL;
    size_t size = 0;
    TD_TRY(td_image_encode_png(&bytes, &size, image, error));
    td_status status = write_file(name, bytes, size, error);
    free(bytes);
    return status;
}

/* ---- what the images depend on ---- */

static void hash_surface(td_hash *hash, const td_surface *s)
{
    const double numbers[] = {s->albedo, s->contrast, s->grain_m, s->octaves, (double)s->seed};
    td_hash_add(hash, numbers, sizeof numbers);
}

static void hash_pose(td_hash *hash, const td_pose *pose)
{
    td_hash_add(hash, pose->q, sizeof pose->q);
    td_hash_add(hash, pose->t, sizeof pose->t);
}

static void hash_bodies(td_hash *hash, const td_scene *scene)
{
    for (size_t i = 0; i < scene->solid_count; i++) {
        const td_solid *s = scene->solid + i;
        hash_pose(hash, &s->site_from_solid);
        hash_surface(hash, &s->surface);
        td_hash_add(hash, s->corner, s->corner_count * sizeof *s->corner);
        td_hash_add(hash, s->triangle, s->triangle_count * sizeof *s->triangle);
    }
    for (size_t i = 0; i < scene->picture_count; i++) {
        const td_scene_picture *p = scene->picture + i;
        const double numbers[] = {p->width_m, p->link};
        hash_pose(hash, &p->site_from_picture);
        td_hash_add(hash, numbers, sizeof numbers);
        td_hash_add(hash, p->image->data, (size_t)p->image->width * p->image->height);
    }
    for (int l = 0; scene->robot && l < scene->robot->link_count; l++) {
        const td_robot_link *link = scene->robot->link + l;
        hash_pose(hash, &link->parent_from_link);
        for (int k = 0; k < link->shape_count; k++) {
            const double kind = link->shape[k].kind;
            td_hash_add(hash, &kind, sizeof kind);
            hash_pose(hash, &link->shape[k].link_from_shape);
            td_hash_add(hash, link->shape[k].size, sizeof link->shape[k].size);
        }
    }
}

static td_status fingerprint(char hex[TD_HASH_HEX_SIZE], const td_scene_file *f, td_error *error)
{
    td_hash *hash = NULL;
    char *rig = NULL;
    TD_TRY(td_rig_to_yaml(&rig, f->rig, error));
    td_status status = td_hash_new(&hash, error);
    if (status != TD_OK) {
        free(rig);
        return status;
    }
    const td_scene *s = &f->scene;
    const td_scene_image *i = &f->image;
    const double numbers[] = {s->sun[0],     s->sun[1],     s->sun[2],    s->ambient, i->samples,
                              i->blur_px,    i->vignetting, i->gain,      i->offset,  i->read_noise,
                              i->shot_noise, common.seed,   f->mount_link};
    td_hash_add(hash, TD_VERSION, strlen(TD_VERSION));
    td_hash_add(hash, rig, strlen(rig));
    td_hash_add(hash, numbers, sizeof numbers);
    hash_pose(hash, &f->mount_from_rig);
    hash_surface(hash, &s->ground_surface);
    hash_surface(hash, &s->robot_surface);
    hash_bodies(hash, s);
    for (int g = 0; g < f->ground_count; g++) {
        const td_elevation *map = f->ground[g].map;
        const double place[] = {map->columns, map->rows, map->cell_m, map->origin[0], map->origin[1]};
        td_hash_add(hash, place, sizeof place);
        td_hash_add(hash, map->height, (size_t)map->columns * map->rows * sizeof *map->height);
    }
    for (size_t k = 0; k < f->frame_count; k++) {
        const td_scene_frame *frame = f->frame + k;
        const double ground = frame->ground;
        td_hash_add(hash, frame->name, strlen(frame->name) + 1);
        td_hash_add(hash, &ground, sizeof ground);
        hash_pose(hash, &frame->site_from_vehicle);
        td_hash_add(hash, frame->q, sizeof frame->q);
    }
    free(rig);
    return td_hash_finish(hex, &hash, error);
}

static const char HASH_FILE[] = "truth/scene.sha256";

/* True when the folder's frames are of this very scene. */
static bool same_scene(const job *j)
{
    char *path = td_path_join(common.output, HASH_FILE), *bytes = NULL;
    size_t size = 0;
    const bool same = path && td_file_read(&bytes, &size, path, 1024, NULL) == TD_OK &&
                      size >= TD_HASH_HEX_SIZE - 1 && memcmp(bytes, j->sha256, TD_HASH_HEX_SIZE - 1) == 0;
    free(bytes);
    free(path);
    return same;
}

/* Takes away the images of another scene, then says whose the next ones are. */
static td_status claim_folder(const job *j, td_error *error)
{
    char name[PATH_SIZE];
    if (same_scene(j)) return TD_OK;
    for (size_t frame = 0; frame < j->file->frame_count; frame++)
        for (int c = 0; c < j->file->rig->count; c++) {
            image_name(name, j, frame, c);
            char *path = td_path_join(common.output, name);
            if (path) remove(path);
            free(path);
        }
    char text[TD_HASH_HEX_SIZE + 1];
    snprintf(text, sizeof text, "%s\n", j->sha256);
    return write_file(HASH_FILE, text, strlen(text), error);
}

/* ---- rendering ---- */

static td_view_options view_options(const job *j)
{
    td_view_options o = td_view_options_of_scene(&j->file->image);
    o.seed = (uint64_t)common.seed;
    o.threads = common.threads;
    return o;
}

/* The view object of a frame's ground, made when first needed, in the frame's state. */
static td_status take_view(td_stereo_view **view, job *j, size_t frame, td_pose *site_from_rig,
                           td_error *error)
{
    const int ground = j->file->frame[frame].ground;
    td_stereo_view **kept = &j->view[ground < 0 ? 0 : ground];
    td_scene_pose(j->file, frame, site_from_rig);
    if (!*kept) TD_TRY(td_stereo_view_new(kept, &j->file->scene, error));
    *view = *kept;
    return td_stereo_view_move(*view, error);
}

static td_status render_frame(job *j, size_t frame, td_error *error)
{
    td_stereo_view *view;
    td_pose site_from_rig;
    char name[PATH_SIZE];
    const td_view_options how = view_options(j);
    TD_TRY(take_view(&view, j, frame, &site_from_rig, error));
    for (int c = 0; c < j->file->rig->count; c++) {
        td_view *seen = NULL;
        const double start = terminal_now_s();
        TD_TRY(td_stereo_view_render(&seen, view, j->file->rig, c, &site_from_rig, frame, &how, error));
        j->render_s += terminal_now_s() - start;
        const size_t pixels = (size_t)seen->image->width * seen->image->height;
        for (size_t i = 0; i < pixels; i++) j->seen[seen->what[i]]++;
        depth_name(name, j, frame, c);
        td_status status = write_depth(name, seen, error);
        image_name(name, j, frame, c);
        if (status == TD_OK) status = write_image(name, seen->image, error);
        td_view_free(&seen);
        TD_TRY(status);
    }
    return TD_OK;
}

static td_status render_all(job *j, const td_progress *progress, td_error *error)
{
    const size_t total = j->last - j->first;
    for (size_t frame = j->first; frame < j->last; frame++) {
        if (is_whole(j, frame)) {
            j->kept++;
        } else {
            TD_TRY(render_frame(j, frame, error));
            j->rendered++;
        }
        if (!td_progress_report(progress, "rendering", frame + 1 - j->first, total) || terminal_interrupted())
            return td_fail(error, TD_ERROR_CANCELLED,
                           "interrupted after %zu of %zu frames; run again to go on", frame + 1 - j->first,
                           total);
    }
    return TD_OK;
}

/* ---- the dataset ---- */

static void print_pose(FILE *out, const td_pose *p)
{
    for (int i = 0; i < 3; i++) fprintf(out, ",%.17g", p->t[i]);
    for (int i = 0; i < 4; i++) fprintf(out, ",%.17g", p->q[i]);
}

/* frames.csv: images, vehicle's pose, joints. truth/poses.csv: the rig's pose. */
static void print_tables(FILE *frames, FILE *poses, job *j)
{
    const td_scene_file *f = j->file;
    const td_robot *robot = f->scene.robot;
    char name[PATH_SIZE];
    fprintf(frames, "frame,time_s");
    fprintf(poses, "frame,time_s,x_m,y_m,z_m,qw,qx,qy,qz\n");
    for (int c = 0; c < f->rig->count; c++) fprintf(frames, ",%s", f->rig->camera[c].name);
    fprintf(frames, ",x_m,y_m,z_m,qw,qx,qy,qz");
    for (int k = 0; robot && k < robot->joint_count; k++)
        fprintf(frames, ",%s_%s", robot->joint[k].name,
                robot->joint[k].kind == TD_JOINT_PRISMATIC ? "m" : "rad");
    fprintf(frames, "\n");
    for (size_t i = 0; i < f->frame_count; i++) {
        td_pose site_from_rig;
        if (!is_whole(j, i)) continue;
        td_scene_pose(j->file, i, &site_from_rig);
        const double time = isnan(f->frame[i].time_s) ? (double)i : f->frame[i].time_s;
        fprintf(frames, "%s,%.17g", f->frame[i].name, time);
        fprintf(poses, "%s,%.17g", f->frame[i].name, time);
        for (int c = 0; c < f->rig->count; c++) {
            image_name(name, j, i, c);
            fprintf(frames, ",%s", name);
        }
        print_pose(frames, &f->frame[i].site_from_vehicle);
        print_pose(poses, &site_from_rig);
        for (int k = 0; robot && k < robot->joint_count; k++) fprintf(frames, ",%.17g", f->frame[i].q[k]);
        fprintf(frames, "\n");
        fprintf(poses, "\n");
    }
}

static td_status write_tables(job *j, td_error *error)
{
    char *text[2] = {NULL, NULL};
    size_t size[2] = {0, 0};
    FILE *out[2];
    static const char *const name[2] = {"frames.csv", "truth/poses.csv"};
    bool failed = false;
    for (int k = 0; k < 2; k++) failed |= !(out[k] = open_memstream(&text[k], &size[k]));
    if (!failed) print_tables(out[0], out[1], j);
    for (int k = 0; k < 2; k++) failed |= !out[k] || fclose(out[k]) != 0;
    td_status status = failed ? td_fail(error, TD_ERROR_MEMORY, "no memory for the frames' table") : TD_OK;
    for (int k = 0; k < 2; k++) {
        if (status == TD_OK) status = write_file(name[k], text[k], size[k], error);
        free(text[k]);
    }
    return status;
}

/* The robot's files beside the images, so that the dataset can be moved: robot/robot.urdf, robot/robot.yaml.
 */
static td_status copy_robot(const job *j, td_error *error)
{
    static const char *const names[2] = {"robot/robot.urdf", "robot/robot.yaml"};
    const char *urdf = j->file->urdf;
    td_status status = make_folder("robot", error);
    for (int k = 0; k < 2 && status == TD_OK; k++) {
        size_t stem = strlen(urdf), size = 0;
        char *bytes = NULL, *path = malloc(stem + 6);
        if (!path) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
        strcpy(path, urdf);
        char *dot = strrchr(path, '.');
        if (k == 1) strcpy(dot && !strchr(dot, '/') ? dot : path + stem, ".yaml");
        struct stat there;
        if (k == 0 || stat(path, &there) == 0) {
            status = td_file_read(&bytes, &size, path, 1 << 26, error);
            if (status == TD_OK) status = write_file(names[k], bytes, size, error);
        }
        free(bytes);
        free(path);
    }
    return status;
}

static json_t *robot_json(const td_scene_file *f)
{
    const char *mount = f->scene.robot->link[f->mount_link < 0 ? 0 : f->mount_link].name;
    return json_pack("{s:s, s:s, s:s}", "urdf", "robot/robot.urdf", "joints", "frames.csv", "mount", mount);
}

static td_status write_description(const job *j, td_error *error)
{
    const td_scene_file *f = j->file;
    json_t *root = json_object(), *cameras = json_array();
    char *yaml = NULL;
    json_object_set_new(root, "name", json_string(f->name));
    json_object_set_new(root, "about",
                        json_sprintf("rendered by teledimos render; truth/ holds what is true"));
    json_object_set_new(root, "rig", json_string("rig.yaml"));
    if (f->target) json_object_set(root, "target", f->target);
    if (f->urdf) json_object_set_new(root, "robot", robot_json(f));
    for (int c = 0; c < f->rig->count; c++)
        json_array_append_new(cameras, json_pack("{s:s, s:s}", "name", f->rig->camera[c].name, "model",
                                                 td_camera_model_name(f->rig->camera[c].camera.model)));
    json_object_set_new(root, "cameras", cameras);
    td_status status = f->urdf ? copy_robot(j, error) : TD_OK;
    if (status == TD_OK) status = td_document_to_yaml(&yaml, root, 0, error);
    if (status == TD_OK) status = write_file("dataset.yaml", yaml, strlen(yaml), error);
    free(yaml);
    json_decref(root);
    return status;
}

/* The rig with its place on the machine: in the frame of the link that carries it, or of the vehicle. */
static td_status describe_rig(char **yaml, const td_scene_file *f, td_error *error)
{
    td_rig *rig = td_rig_copy(f->rig);
    if (!rig) return td_fail(error, TD_ERROR_MEMORY, "no memory for the rig");
    rig->has_vehicle = true;
    rig->vehicle_from_rig = f->mount_from_rig;
    td_status status = td_rig_to_yaml(yaml, rig, error);
    td_rig_free(&rig);
    return status;
}

static td_status write_truth(const job *j, td_error *error)
{
    char *yaml = NULL;
    TD_TRY(describe_rig(&yaml, j->file, error));
    td_status status = write_file("rig.yaml", yaml, strlen(yaml), error);
    free(yaml);
    for (int g = 0; g < j->file->ground_count && status == TD_OK; g++) {
        char name[PATH_SIZE];
        snprintf(name, sizeof name, "truth/ground-%s.tif", j->file->ground[g].name);
        char *path = td_path_join(common.output, name);
        status = path ? td_elevation_write(j->file->ground[g].map, path, error)
                      : td_fail(error, TD_ERROR_MEMORY, "out of memory");
        free(path);
    }
    return status;
}

static json_t *make_result(const job *j, size_t frames)
{
    const td_rig *rig = j->file->rig;
    json_t *root = json_object(), *cameras = json_array(), *seen = json_object(), *products = json_array();
    static const char *const names[] = {"dataset.yaml", "frames.csv", "rig.yaml", "truth"};
    double pixels = 0;
    for (int k = 0; k < KINDS; k++) pixels += j->seen[k];
    for (int k = 0; k < KINDS; k++)
        json_object_set_new(seen, kind_names[k], td_json_real(pixels > 0 ? j->seen[k] / pixels : 0));
    for (int c = 0; c < rig->count; c++) json_array_append_new(cameras, json_string(rig->camera[c].name));
    for (size_t k = 0; k < sizeof names / sizeof *names; k++)
        json_array_append_new(products, json_string(names[k]));
    for (int c = 0; c < rig->count; c++) json_array_append_new(products, json_string(rig->camera[c].name));
    json_object_set_new(root, "job", json_string("render"));
    json_object_set_new(root, "version", json_string(TD_VERSION));
    json_object_set_new(root, "scene", json_string(j->file->name));
    json_object_set_new(root, "scene_sha256", json_string(j->sha256));
    json_object_set_new(root, "cameras", cameras);
    json_object_set_new(root, "frames", json_integer((json_int_t)frames));
    json_object_set_new(root, "frames_rendered", json_integer((json_int_t)j->rendered));
    json_object_set_new(root, "frames_kept", json_integer((json_int_t)j->kept));
    json_object_set_new(root, "render_s", td_json_real(j->render_s));
    json_object_set_new(root, "frames_per_s",
                        td_json_real(j->rendered ? (double)j->rendered / j->render_s : NAN));
    json_object_set_new(root, "seen", seen);
    json_object_set_new(root, "products", products);
    return root;
}

static td_status finish(const job *j, td_error *error)
{
    size_t frames = 0;
    for (size_t i = 0; i < j->file->frame_count; i++) frames += is_whole(j, i);
    json_t *result = make_result(j, frames);
    char *yaml = NULL, *text = NULL;
    td_status status = td_schema_check(result, schema, SCHEMA_COUNT, error);
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = write_file("result.yaml", yaml, strlen(yaml), error);
    if (status == TD_OK && common.json) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && !text)
        printf("%zu frames rendered, %zu kept, %.2f frames/s: %s holds %zu of %zu\n", j->rendered, j->kept,
               j->rendered ? (double)j->rendered / j->render_s : 0, common.output, frames,
               j->file->frame_count);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    json_decref(result);
    free(yaml);
    free(text);
    return status;
}

static td_status take_range(job *j, td_error *error)
{
    j->first = 0;
    j->last = j->file->frame_count;
    if (!range_text) return TD_OK;
    unsigned long a = 0, b = 0;
    char rest;
    if (sscanf(range_text, "%lu..%lu%c", &a, &b, &rest) != 2 || a < 1 || b < a || b > j->file->frame_count)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--frames %s: write A..B, 1 <= A <= B <= %zu, the scene's frames", range_text,
                       j->file->frame_count);
    j->first = a - 1;
    j->last = b;
    return TD_OK;
}

static td_status run(job *j, td_error *error)
{
    TD_TRY(td_scene_read(&j->file, scene_path, error));
    TD_TRY(take_range(j, error));
    TD_TRY(fingerprint(j->sha256, j->file, error));
    TD_TRY(make_folder("truth", error));
    for (int c = 0; c < j->file->rig->count; c++) {
        char name[PATH_SIZE];
        snprintf(name, sizeof name, "truth/%s", j->file->rig->camera[c].name);
        TD_TRY(make_folder(j->file->rig->camera[c].name, error));
        TD_TRY(make_folder(name, error));
    }
    TD_TRY(claim_folder(j, error));
    terminal term;
    terminal_init(&term, common.quiet, common.verbose);
    td_progress progress = terminal_progress(&term);
    td_status status = render_all(j, &progress, error);
    terminal_clear(&term);
    TD_TRY(status);
    TD_TRY(write_truth(j, error));
    TD_TRY(write_tables(j, error));
    TD_TRY(write_description(j, error));
    return finish(j, error);
}

int main(int argc, char **argv)
{
    int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    if (common.schema) {
        char *text = td_schema_describe(schema, SCHEMA_COUNT);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    if (!scene_path || !common.output || !*common.output) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)",
                     !scene_path ? "SCENE" : "-o DATASET", command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    td_error error = {0};
    job j = {0};
    td_status status = run(&j, &error);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    for (int g = 0; g < TD_SCENE_MAX_GROUNDS; g++) td_stereo_view_free(&j.view[g]);
    td_scene_free(&j.file);
    return status == TD_OK ? EXIT_DONE : status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
