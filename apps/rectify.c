/* teledimos rectify: a dataset's pairs, turned so that rows match rows. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/cli.h"
#include "apps/terminal.h"
#include "core/dataset.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "core/rig.h"
#include "core/schema.h"
#include "core/stereo.h"

static const char *dataset_path;
static cli_common common;
static const char *rig_path, *pair_names;
static double zoom = 0;

static cli_option options[] = {
    {CLI_STRING, "rig", 0, &rig_path, "FILE", "rig.yaml of the cameras (needed)", 0, 0, NULL},
    {CLI_STRING, "pair", 0, &pair_names, "A,B", "which two cameras; default: the rig's first two", 0, 0,
     NULL},
    {CLI_REAL, "zoom", 0, &zoom, "Z", "0 (default): only what both images fill; 1: all of both, black around",
     0, 1, NULL},
    CLI_COMMON_OPTIONS(common, "folder for the images, rig.yaml of the rectified cameras and result.yaml",
                       "this job draws none"),
};

static cli_command command = {
    .name = "rectify",
    .summary = "turn stereo pairs so that rows match rows",
    .usage = "DATASET --rig RIG -o DIR [options]",
    .text = "Writes each pair of DATASET as seen by two distortion-free cameras of one focal length whose "
            "rows are epipolar "
            "lines (columns, for cameras mounted one above the other), as CAMERA-FRAME.png, and a rig.yaml "
            "of these cameras.",
    .examples = "  teledimos calibrate datasets/opencv-stereo -o out\n"
                "  teledimos rectify datasets/opencv-stereo --rig out/rig.yaml -o rectified\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &dataset_path,
};

static const td_schema_row schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "rectify"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"first", TD_SCHEMA_STRING, true, false, "camera"},
    {"second", TD_SCHEMA_STRING, true, false, "camera"},
    {"focal_px", TD_SCHEMA_REAL, true, false, "of both rectified cameras"},
    {"centre_px", TD_SCHEMA_REALS, true, false, "principal point of both, x y"},
    {"baseline_m", TD_SCHEMA_REAL, true, false, "the second camera lies at +x (+y when vertical) by it"},
    {"vertical", TD_SCHEMA_BOOL, true, false, "true: columns match columns"},
    {"pairs", TD_SCHEMA_INT, true, false, "written"},
    {"products", TD_SCHEMA_STRINGS, true, false, "file names"},
};
enum { SCHEMA_COUNT = sizeof schema / sizeof *schema };

typedef struct job {
    const td_dataset *dataset;
    const td_rig *rig;
    int camera[2], column[2]; /* in the rig, in the dataset */
    td_rectification rectification;
    size_t *view, view_count;
    td_error *error; /* (2 view_count) */
} job;

static void image_name(char name[2 * TD_NAME_SIZE + 8], const job *j, size_t view, int side)
{
    snprintf(name, 2 * TD_NAME_SIZE + 8, "%s-%s.png", j->rig->camera[j->camera[side]].name,
             j->dataset->frame[view].name);
}

static void rectify_one(size_t index, void *user)
{
    job *j = user;
    int side = (int)(index % 2);
    size_t view = j->view[index / 2];
    td_error *error = &j->error[index];
    td_image *image = NULL, *out = NULL;
    char name[2 * TD_NAME_SIZE + 8];
    image_name(name, j, view, side);
    char *path = td_path_join(common.output, name);
    const char *from = j->dataset->frame[view].image[j->column[side]];
    td_status status =
        path ? td_image_read(&image, from, 3, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) {
        status = td_rectify_image(&out, image, &j->rectification, side,
                                  &j->rig->camera[j->camera[side]].camera, 1, error);
        if (status != TD_OK) td_error_prefix(error, status, "%s", from);
    }
    if (status == TD_OK) td_image_write(path, out, error);
    td_image_free(&image);
    td_image_free(&out);
    free(path);
}

static td_status choose_pair(job *j, td_error *error)
{
    char a[TD_NAME_SIZE] = "", b[TD_NAME_SIZE] = "";
    if (j->rig->count < 2)
        return td_fail(error, TD_ERROR_DATA, "%s: a rig of one camera has no pair", rig_path);
    snprintf(a, sizeof a, "%s", j->rig->camera[0].name);
    snprintf(b, sizeof b, "%s", j->rig->camera[1].name);
    if (pair_names && sscanf(pair_names, "%63[^,],%63[^,]", a, b) != 2)
        return td_fail(error, TD_ERROR_ARGUMENT, "--pair %s: write two names with a comma between",
                       pair_names);
    const char *name[2] = {a, b};
    for (int side = 0; side < 2; side++) {
        j->camera[side] = td_rig_find(j->rig, name[side]);
        j->column[side] = -1;
        for (int c = 0; c < j->dataset->camera_count; c++)
            if (strcmp(j->dataset->camera[c].name, name[side]) == 0) j->column[side] = c;
        if (j->camera[side] < 0)
            return td_fail(error, TD_ERROR_DATA, "%s has no camera %s", rig_path, name[side]);
        if (j->column[side] < 0)
            return td_fail(error, TD_ERROR_DATA, "dataset %s has no camera %s", j->dataset->name, name[side]);
    }
    return TD_OK;
}

/* second_from_first, with its covariance left out: the rectified pair's geometry is exact by construction. */
static td_pose relative(const job *j)
{
    td_pose rig_from_first = td_pose_inverse(&j->rig->camera[j->camera[0]].camera_from_rig);
    return td_pose_compose(&j->rig->camera[j->camera[1]].camera_from_rig, &rig_from_first);
}

static td_status write_rig(const job *j, td_error *error)
{
    td_rig *rig = td_rig_new();
    char *path = td_path_join(common.output, "rig.yaml");
    if (!rig || !path) {
        td_rig_free(&rig);
        free(path);
        return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    }
    rig->count = 2;
    for (int side = 0; side < 2; side++) {
        td_rig_camera *c = &rig->camera[side];
        memcpy(c->name, j->rig->camera[j->camera[side]].name, sizeof c->name);
        c->camera = j->rectification.camera;
        c->camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[j->rectification.vertical ? 1 : 0] = -j->rectification.baseline_m;
    rig->provenance = json_pack("{s:s, s:s, s:s}", "job", "rectify", "version", TD_VERSION, "rig", rig_path);
    td_status status = td_rig_write(rig, path, error);
    td_rig_free(&rig);
    free(path);
    return status;
}

static json_t *make_result(const job *j)
{
    const double *p = j->rectification.camera.parameter;
    json_t *root = json_object(), *products = json_array();
    json_object_set_new(root, "job", json_string("rectify"));
    json_object_set_new(root, "version", json_string(TD_VERSION));
    json_object_set_new(root, "first", json_string(j->rig->camera[j->camera[0]].name));
    json_object_set_new(root, "second", json_string(j->rig->camera[j->camera[1]].name));
    json_object_set_new(root, "focal_px", td_json_real(p[0]));
    json_object_set_new(root, "centre_px", td_json_reals(p + 2, 2));
    json_object_set_new(root, "baseline_m", td_json_real(j->rectification.baseline_m));
    json_object_set_new(root, "vertical", json_boolean(j->rectification.vertical));
    json_object_set_new(root, "pairs", json_integer((json_int_t)j->view_count));
    json_array_append_new(products, json_string("rig.yaml"));
    for (size_t i = 0; i < 2 * j->view_count; i++) {
        char name[2 * TD_NAME_SIZE + 8];
        image_name(name, j, j->view[i / 2], (int)(i % 2));
        json_array_append_new(products, json_string(name));
    }
    json_object_set_new(root, "products", products);
    return root;
}

static td_status write_result(const job *j, td_error *error)
{
    json_t *result = make_result(j);
    char *yaml = NULL, *text = NULL, *path = td_path_join(common.output, "result.yaml");
    td_status status = td_schema_check(result, schema, SCHEMA_COUNT, error);
    if (status == TD_OK && !path) status = td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK) status = td_file_write(path, yaml, strlen(yaml), error);
    if (status == TD_OK && common.json) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && !text)
        printf("%zu pairs rectified to %dx%d px, focal length %.2f px, baseline %.3f mm%s: %s\n",
               j->view_count, j->rectification.camera.width, j->rectification.camera.height,
               j->rectification.camera.parameter[0], 1e3 * j->rectification.baseline_m,
               j->rectification.vertical ? " (vertical)" : "", common.output);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    json_decref(result);
    free(yaml);
    free(text);
    free(path);
    return status;
}

static td_status run(job *j, td_error *error)
{
    TD_TRY(choose_pair(j, error));
    td_pose second_from_first = relative(j);
    TD_TRY(td_rectify(&j->rectification, &j->rig->camera[j->camera[0]].camera,
                      &j->rig->camera[j->camera[1]].camera, &second_from_first, zoom, error));
    j->view = malloc((j->dataset->frame_count + 1) * sizeof *j->view);
    j->error = calloc(2 * j->dataset->frame_count + 1, sizeof *j->error);
    if (!j->view || !j->error) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t v = 0; v < j->dataset->frame_count; v++)
        if (j->dataset->frame[v].image[j->column[0]] && j->dataset->frame[v].image[j->column[1]])
            j->view[j->view_count++] = v;
    if (!j->view_count)
        return td_fail(error, TD_ERROR_DATA, "dataset %s has no frame with both images", j->dataset->name);
    TD_TRY(td_folder_make(common.output, error));
    terminal term;
    terminal_init(&term, common.quiet, common.verbose);
    td_progress progress = terminal_progress(&term);
    td_status status =
        td_parallel_for(2 * j->view_count, common.threads, rectify_one, j, &progress, "rectifying");
    terminal_clear(&term);
    if (status != TD_OK) return td_fail(error, status, "interrupted; the images written so far are whole");
    for (size_t i = 0; i < 2 * j->view_count; i++)
        if (j->error[i].status != TD_OK) {
            *error = j->error[i];
            return error->status;
        }
    TD_TRY(write_rig(j, error));
    return write_result(j, error);
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
    if (!dataset_path || !rig_path || !common.output || !*common.output) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)",
                     !dataset_path ? "DATASET"
                     : !rig_path   ? "--rig RIG"
                                   : "-o DIR",
                     command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    td_error error = {0};
    td_dataset *dataset = NULL;
    td_rig *rig = NULL;
    job j = {0};
    td_status status = td_dataset_read(&dataset, dataset_path, &error);
    if (status == TD_OK) status = td_rig_read(&rig, rig_path, &error);
    j.dataset = dataset;
    j.rig = rig;
    if (status == TD_OK) status = run(&j, &error);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    free(j.view);
    free(j.error);
    td_rig_free(&rig);
    td_dataset_free(&dataset);
    return status == TD_OK ? EXIT_DONE : status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
