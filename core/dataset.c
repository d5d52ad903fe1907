#include "core/dataset.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/csv.h"
#include "core/dataset_internal.h"
#include "core/dataset_layout_internal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/target_internal.h"
#include "core/text_internal.h"

enum { MAX_FRAMES = 100000, MAX_PATH = 4095, LIST_SIZE = 400 };

static const double SMALLEST_BASELINE_M = 1e-4, LARGEST_LENGTH_M = 1e3, LARGEST_TIME_S = 1e12;

static const char DESCRIPTION[] = "dataset.yaml", FRAMES[] = "frames.csv";
/* Columns of the table that are no cameras. */
static const char *const reserved[] = {"frame", "time_s", "height_m", NULL};

static const char EXAMPLE[] = "a dataset is a folder with dataset.yaml, for example\n"
                              "  name: my-stereo\n"
                              "  target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
                              "  cameras: [{name: left, model: brown5}, {name: right, model: brown5}]\n"
                              "and frames.csv, for example\n"
                              "  frame,left,right\n"
                              "  01,left01.png,right01.png\n"
                              "See 'teledimos calibrate --help'.";

/* What dataset.yaml says of other files. */
typedef struct places {
    char *root;   /* folder of the images */
    char *frames; /* path of the table */
} places;

static td_status out_of_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a dataset");
}

void td_dataset_free(td_dataset **dataset)
{
    if (!dataset || !*dataset) return;
    td_dataset *d = *dataset;
    for (size_t i = 0; i < d->frame_count; i++)
        for (int c = 0; c < d->camera_count; c++) free(d->frame[i].image[c]);
    free(d->frame);
    free(d->folder);
    free(d->table);
    free(d->corners);
    free(d->robot.path);
    free(d->target_poses.path);
    free(d->rig);
    free(d->table_text);
    free(d->rig_text);
    td_dataset_arm_free(&d->arm);
    free(d);
    *dataset = NULL;
}

/* ---- dataset.yaml ---- */

/* The text with every ${NAME} replaced by that environment variable. */
static td_status expand(char **expanded, const td_field *field, const char *text, td_error *error)
{
    td_text out = {0};
    td_status status = TD_OK;
    td_text_add(&out, "", 0);
    while (*text && status == TD_OK) {
        const char *dollar = strstr(text, "${");
        td_text_add(&out, text, dollar ? (size_t)(dollar - text) : strlen(text));
        if (!dollar) break;
        char name[TD_NAME_SIZE] = "", shown[TD_SHOWN_SIZE];
        const size_t length = strcspn(dollar + 2, "}");
        if (dollar[2 + length] == 0 || length == 0 || length >= sizeof name) {
            status = td_field_fail(field, error, "'%s' is no ${NAME} of an environment variable",
                                   td_text_shown(shown, dollar));
            break;
        }
        memcpy(name, dollar + 2, length);
        const char *value = getenv(name);
        if (!value || !*value)
            status =
                td_field_fail(field, error,
                              "the environment variable %s is not set; set it to the folder it stands for "
                              "and run again",
                              td_text_shown(shown, name));
        else
            td_text_add(&out, value, strlen(value));
        text = dollar + 2 + length + 1;
    }
    if (status == TD_OK && out.failed) status = out_of_memory(error);
    if (status == TD_OK)
        *expanded = out.data;
    else
        free(out.data);
    return status;
}

/* A path of dataset.yaml: variables replaced, below the dataset's folder when it is relative. */
static td_status parse_path(char **path, const td_field *field, const char *folder, td_error *error)
{
    const char *text = NULL;
    char *expanded = NULL;
    TD_TRY(td_field_string(&text, field, error));
    if (!*text) return td_field_fail(field, error, "is empty");
    TD_TRY(expand(&expanded, field, text, error));
    *path = td_path_join(folder, expanded);
    free(expanded);
    return *path ? TD_OK : out_of_memory(error);
}

static bool is_reserved(const char *name)
{
    for (size_t i = 0; reserved[i]; i++)
        if (!strcmp(reserved[i], name)) return true;
    return false;
}

static td_status parse_camera(td_dataset *d, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"name", "model", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field name = td_field_get(field, "name"), model = td_field_get(field, "model");
    const char *text = NULL, *model_text = NULL;
    char shown[TD_SHOWN_SIZE];
    TD_TRY(td_field_string(&text, &name, error));
    TD_TRY(td_field_string(&model_text, &model, error));
    if (!td_name_is_plain(text))
        return td_field_fail(&name, error, "'%s' must be 1 to %d letters, digits, - and _",
                             td_text_shown(shown, text), TD_NAME_SIZE - 1);
    if (is_reserved(text))
        return td_field_fail(&name, error, "'%s' is the name of another column of the frames' table", text);
    for (int i = 0; i < d->camera_count; i++)
        if (!strcmp(d->camera[i].name, text)) return td_field_fail(&name, error, "'%s' is given twice", text);
    td_dataset_camera *camera = d->camera + d->camera_count;
    camera->model = td_camera_model_from_name(model_text);
    if (camera->model == TD_CAMERA_MODEL_COUNT)
        return td_field_fail(&model, error, "is '%s', but must be one of pinhole, brown5, brown8, fisheye",
                             td_text_shown(shown, model_text));
    strcpy(camera->name, text);
    d->camera_count++;
    return TD_OK;
}

static td_status parse_cameras(td_dataset *d, const td_field *field, td_error *error)
{
    size_t count = 0;
    TD_TRY(td_field_count(&count, field, 1, TD_RIG_MAX_CAMERAS, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field camera = td_field_at(field, i, index);
        TD_TRY(parse_camera(d, &camera, error));
    }
    return TD_OK;
}

static td_status parse_expectation(td_dataset *d, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"baseline_m", "tolerance_m", NULL};
    d->expected_baseline_m = d->expected_tolerance_m = NAN;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field baseline = td_field_get(field, "baseline_m"), tolerance = td_field_get(field, "tolerance_m");
    TD_TRY(td_field_real(&d->expected_baseline_m, &baseline, SMALLEST_BASELINE_M, LARGEST_LENGTH_M, error));
    TD_TRY(td_field_real(&d->expected_tolerance_m, &tolerance, 0, LARGEST_LENGTH_M, error));
    if (d->expected_tolerance_m == 0) return td_field_fail(&tolerance, error, "must be more than 0");
    return TD_OK;
}

/* True for 1 … TD_NAME_SIZE-1 bytes without controls. */
static bool is_title(const char *text)
{
    for (const char *c = text; *c; c++)
        if ((unsigned char)*c < 0x20 || *c == 0x7F) return false;
    return *text && strlen(text) < TD_NAME_SIZE;
}

static td_status parse_name(td_dataset *d, const td_field *root, td_error *error)
{
    td_field name = td_field_get(root, "name"), about = td_field_get(root, "about");
    const char *text = NULL;
    if (about.value) TD_TRY(td_field_string(&text, &about, error));
    TD_TRY(td_field_string(&text, &name, error));
    if (!is_title(text))
        return td_field_fail(&name, error, "must be one line of 1 to %d bytes", TD_NAME_SIZE - 1);
    strcpy(d->name, text);
    return TD_OK;
}

td_status td_dataset_parse_near(char **path, const td_field *field, const char *folder, const char *root,
                                td_error *error)
{
    struct stat status;
    TD_TRY(parse_path(path, field, folder, error));
    if (stat(*path, &status) == 0) return TD_OK;
    free(*path);
    *path = NULL;
    return parse_path(path, field, root, error);
}

/* Where poses are and how they are meant. */
static td_status parse_poses(td_dataset_poses *poses, const td_field *field, const char *folder,
                             const char *root, td_error *error)
{
    static const char *const keys[] = {"poses",      "convention",   "inverted", "length_unit",
                                       "angle_unit", "scalar_first", NULL};
    static const char *const conventions[] = {"auto", "csv", "matrix", "visp", "ethz", NULL};
    static const char *const lengths[] = {"m", "mm", NULL}, *const angles[] = {"rad", "deg", NULL};
    int choice = 0;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field path = td_field_get(field, "poses"), convention = td_field_get(field, "convention");
    td_field inverted = td_field_get(field, "inverted"), first = td_field_get(field, "scalar_first");
    td_field length = td_field_get(field, "length_unit"), angle = td_field_get(field, "angle_unit");
    TD_TRY(td_dataset_parse_near(&poses->path, &path, folder, root, error));
    if (convention.value)
        TD_TRY(td_field_choice(&choice, &convention, conventions, "auto, csv, matrix, visp or ethz", error));
    poses->how.convention = (td_pose_convention)choice;
    if (inverted.value) TD_TRY(td_field_bool(&poses->how.inverted, &inverted, error));
    if (first.value) TD_TRY(td_field_bool(&poses->how.scalar_first, &first, error));
    choice = 0;
    if (length.value) TD_TRY(td_field_choice(&choice, &length, lengths, "m or mm", error));
    poses->how.metres = choice ? 1e-3 : 1;
    choice = 0;
    if (angle.value) TD_TRY(td_field_choice(&choice, &angle, angles, "rad or deg", error));
    poses->how.radians = choice ? 0.017453292519943295 : 1;
    return TD_OK;
}

static td_status parse_hand_eye(td_dataset *d, const td_field *top, const char *root, td_error *error)
{
    static const char *const setups[] = {"eye-in-hand", "eye-to-hand", "robot-world", NULL};
    td_field robot = td_field_get(top, "robot"), target = td_field_get(top, "target_poses");
    td_field rig = td_field_get(top, "rig"), setup = td_field_get(top, "setup");
    int choice;
    if (!d->arm) TD_TRY(parse_poses(&d->robot, &robot, d->folder, root, error));
    TD_TRY(parse_poses(&d->target_poses, &target, d->folder, root, error));
    if (rig.value) TD_TRY(td_dataset_parse_near(&d->rig, &rig, d->folder, root, error));
    if (!setup.value) return TD_OK;
    TD_TRY(td_field_choice(&choice, &setup, setups, "eye-in-hand, eye-to-hand or robot-world", error));
    strcpy(d->setup, setups[choice]);
    return TD_OK;
}

static td_status parse_site_tags(td_dataset *d, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"target", "sigma_mm", "sigma_deg", NULL};
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    td_field target = td_field_get(field, "target");
    td_field mm = td_field_get(field, "sigma_mm"), deg = td_field_get(field, "sigma_deg");
    TD_TRY(td_target_parse(&d->site_tags, &target, error));
    if (d->site_tags.kind != TD_TARGET_TAGS)
        return td_field_fail(&target, error,
                             "must be of kind tags: {kind: tags, tags: [{id: …, size_m: …, "
                             "target_from_tag: …}]}");
    if (mm.value) TD_TRY(td_field_real(&d->site_tags_sigma_m, &mm, 0, 1e6, error));
    if (deg.value) TD_TRY(td_field_real(&d->site_tags_sigma_rad, &deg, 0, 180, error));
    d->site_tags_sigma_m *= 1e-3;
    d->site_tags_sigma_rad *= 0.017453292519943295;
    return TD_OK;
}

/* Everything of dataset.yaml; d->folder is known. */
static td_status parse_description(td_dataset *d, places *p, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"name",   "about",   "root",   "target",       "cameras",   "frames",
                                       "expect", "corners", "robot",  "target_poses", "rig",       "setup",
                                       "points", "boards",  "sights", "sigma_px",     "site_tags", NULL};
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(parse_name(d, root, error));
    td_field target = td_field_get(root, "target"), cameras = td_field_get(root, "cameras");
    td_field expect = td_field_get(root, "expect"), folder = td_field_get(root, "root");
    td_field frames = td_field_get(root, "frames"), corners = td_field_get(root, "corners");
    if (folder.value)
        TD_TRY(parse_path(&p->root, &folder, d->folder, error));
    else if (!(p->root = strdup(d->folder)))
        return out_of_memory(error);
    TD_TRY(td_dataset_parse_arm(&d->arm, root, d->folder, p->root, error));
    /* Without images neither target nor cameras are needed; boards on an arm have targets of their own; what
     * is calibrated already can be looked at without a target. */
    bool boards = d->arm && d->arm->board_count, calibrated = td_field_get(root, "rig").value != NULL;
    bool poses_only = td_field_get(root, "target_poses").value || (d->arm && !boards);
    if (target.value || !(poses_only || boards || calibrated))
        TD_TRY(td_target_parse(&d->target, &target, error));
    if (cameras.value || !poses_only) TD_TRY(parse_cameras(d, &cameras, error));
    TD_TRY(parse_expectation(d, &expect, error));
    const char *table = FRAMES;
    if (frames.value) TD_TRY(td_field_string(&table, &frames, error));
    p->frames = td_path_join(d->folder, table);
    if (!p->frames) return out_of_memory(error);
    td_field site_tags = td_field_get(root, "site_tags");
    TD_TRY(parse_site_tags(d, &site_tags, error));
    if (corners.value) TD_TRY(parse_path(&d->corners, &corners, d->folder, error));
    return parse_hand_eye(d, root, p->root, error);
}

/* ---- frames.csv ---- */

/* Where the columns are; -1: there is none. */
typedef struct columns {
    int frame, time, height, image[TD_RIG_MAX_CAMERAS];
} columns;

static void add_to_list(char list[LIST_SIZE], const char *name)
{
    char shown[TD_SHOWN_SIZE];
    const size_t used = strlen(list);
    snprintf(list + used, LIST_SIZE - used, "%s%s", used ? ", " : "", td_text_shown(shown, name));
}

static td_status find_columns(columns *at, const td_dataset *d, const td_csv *csv, td_error *error)
{
    at->frame = td_csv_column(csv, "frame");
    at->time = td_csv_column(csv, "time_s");
    at->height = td_csv_column(csv, "height_m");
    for (int c = 0; c < d->camera_count; c++) {
        at->image[c] = td_csv_column(csv, d->camera[c].name);
        if (at->image[c] >= 0) continue;
        char cameras[LIST_SIZE] = "", found[LIST_SIZE] = "";
        for (int i = 0; i < d->camera_count; i++) add_to_list(cameras, d->camera[i].name);
        for (size_t i = 0; i < csv->columns; i++) add_to_list(found, csv->cell[i]);
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: no column for the camera '%s': the cameras of %s are %s; the columns are %s",
                       csv->name, d->camera[c].name, DESCRIPTION, cameras, found);
    }
    return TD_OK;
}

/* NaN for a missing column or an empty cell. */
static td_status read_optional(double *value, const td_csv *csv, size_t row, int column, double limit,
                               td_error *error)
{
    *value = NAN;
    if (column < 0 || !*td_csv_cell(csv, row, column)) return TD_OK;
    return td_csv_real(value, csv, row, column, -limit, limit, error);
}

static td_status read_frame(td_dataset *d, size_t row, const columns *at, const td_csv *csv, const char *root,
                            td_error *error)
{
    td_dataset_frame *frame = d->frame + row;
    if (at->frame < 0)
        snprintf(frame->name, sizeof frame->name, "%zu", row + 1);
    else {
        const char *name = td_csv_cell(csv, row, at->frame);
        if (!is_title(name))
            return td_csv_fail(csv, row, at->frame, error, "a name of 1 to %d bytes on one line is needed",
                               TD_NAME_SIZE - 1);
        strcpy(frame->name, name);
    }
    TD_TRY(read_optional(&frame->time_s, csv, row, at->time, LARGEST_TIME_S, error));
    TD_TRY(read_optional(&frame->height_m, csv, row, at->height, LARGEST_LENGTH_M, error));
    for (int c = 0; c < d->camera_count; c++) {
        const char *image = td_csv_cell(csv, row, at->image[c]);
        if (!*image) continue;
        if (strlen(image) > MAX_PATH)
            return td_csv_fail(csv, row, at->image[c], error, "a name of %zu bytes is no file's; at most %d",
                               strlen(image), MAX_PATH);
        frame->image[c] = td_path_join(root, image);
        if (!frame->image[c]) return out_of_memory(error);
    }
    return TD_OK;
}

static int compare_names(const void *a, const void *b)
{
    const td_dataset_frame *x = *(const td_dataset_frame *const *)a, *y = *(const td_dataset_frame *const *)b;
    const int order = strcmp(x->name, y->name);
    return order ? order : (x > y) - (x < y);
}

/* Two views of one name could not be told apart in a result. */
static td_status check_frame_names(const td_dataset *d, const columns *at, const td_csv *csv, td_error *error)
{
    const td_dataset_frame **sorted = calloc(d->frame_count, sizeof *sorted);
    if (!sorted) return out_of_memory(error);
    for (size_t i = 0; i < d->frame_count; i++) sorted[i] = d->frame + i;
    qsort(sorted, d->frame_count, sizeof *sorted, compare_names);
    td_status status = TD_OK;
    for (size_t i = 1; i < d->frame_count && status == TD_OK; i++) {
        if (strcmp(sorted[i - 1]->name, sorted[i]->name) != 0) continue;
        status = td_csv_fail(csv, (size_t)(sorted[i] - d->frame), at->frame, error,
                             "'%s' is already the name of line %zu", sorted[i]->name,
                             csv->line[1 + (size_t)(sorted[i - 1] - d->frame)]);
    }
    free(sorted);
    return status;
}

/* A camera that saw nothing is a slip in the table, unless the points come from elsewhere. */
static td_status check_cameras_see(const td_dataset *d, const td_csv *csv, td_error *error)
{
    for (int c = 0; c < d->camera_count && !d->corners; c++) {
        size_t i = 0;
        while (i < d->frame_count && !d->frame[i].image[c]) i++;
        if (i == d->frame_count)
            return td_fail(error, TD_ERROR_FORMAT, "%s: column %s: has no image at all", csv->name,
                           d->camera[c].name);
    }
    return TD_OK;
}

static td_status read_frames(td_dataset *d, const td_csv *csv, const char *root, td_error *error)
{
    columns at;
    TD_TRY(find_columns(&at, d, csv, error));
    if (csv->rows == 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: has a header but no frames below it", csv->name);
    if (csv->rows > MAX_FRAMES)
        return td_fail(error, TD_ERROR_FORMAT, "%s: has %zu frames; at most %d are accepted", csv->name,
                       csv->rows, MAX_FRAMES);
    d->frame = calloc(csv->rows, sizeof *d->frame);
    if (!d->frame) return out_of_memory(error);
    d->frame_count = csv->rows;
    for (size_t row = 0; row < csv->rows; row++) TD_TRY(read_frame(d, row, &at, csv, root, error));
    TD_TRY(check_frame_names(d, &at, csv, error));
    return check_cameras_see(d, csv, error);
}

/* ---- both ---- */

/* The text of frames.csv, when it is not to be read from its file. */
typedef struct given_table {
    const char *text;
    size_t size;
} given_table;

static td_status fill(td_dataset *d, const json_t *document, const char *name, const given_table *given,
                      td_error *error)
{
    const td_field root = {NULL, name, document};
    places p = {NULL, NULL};
    td_csv *csv = NULL;
    td_status status = parse_description(d, &p, &root, error);
    bool wanted = d->camera_count > 0 || !(d->target_poses.path || d->arm);
    if (status == TD_OK && wanted)
        status = given ? td_csv_parse(&csv, given->text, given->size, p.frames, error)
                       : td_csv_read(&csv, p.frames, error);
    if (status == TD_OK && wanted) status = read_frames(d, csv, p.root, error);
    td_csv_free(&csv);
    free(p.root);
    if (status == TD_OK)
        d->table = p.frames;
    else
        free(p.frames);
    return status;
}

/* Takes the document over. */
static td_status make_dataset(td_dataset **dataset, json_t *document, const char *name, const char *folder,
                              const given_table *given, td_error *error)
{
    td_dataset *made = calloc(1, sizeof *made);
    if (made) made->folder = strdup(folder);
    td_status status = made && made->folder ? fill(made, document, name, given, error) : out_of_memory(error);
    json_decref(document);
    if (status == TD_OK)
        *dataset = made;
    else
        td_dataset_free(&made);
    return status;
}

td_status td_dataset_parse(td_dataset **dataset, const char *yaml, size_t yaml_size, const char *csv,
                           size_t csv_size, const char *folder, td_error *error)
{
    const given_table given = {csv, csv_size};
    json_t *document = NULL;
    char *name = td_path_join(folder, DESCRIPTION);
    if (!name) return out_of_memory(error);
    td_status status = td_document_parse(&document, yaml, yaml_size, name, error);
    if (status == TD_OK) status = make_dataset(dataset, document, name, folder, &given, error);
    free(name);
    return status;
}

static bool is_folder(const char *path)
{
    struct stat status;
    return stat(path, &status) == 0 && S_ISDIR(status.st_mode);
}

static bool exists(const char *path)
{
    struct stat status;
    return stat(path, &status) == 0;
}

/* The path of the description, when a folder or the file itself is given. */
static td_status find_description(char **file, const char *path, td_error *error)
{
    if (!exists(path))
        return td_fail(error, TD_ERROR_IO, "%s: there is no such folder or file; %s", path, EXAMPLE);
    char *found = is_folder(path) ? td_path_join(path, DESCRIPTION) : strdup(path);
    if (!found) return out_of_memory(error);
    if (!exists(found)) {
        free(found);
        return td_fail(error, TD_ERROR_IO, "%s: the folder has no %s; %s", path, DESCRIPTION, EXAMPLE);
    }
    *file = found;
    return TD_OK;
}

/* ---- folders of others ---- */

void td_dataset_layout_free(td_dataset_layout *layout)
{
    free(layout->yaml);
    free(layout->table);
    free(layout->rig);
    *layout = (td_dataset_layout){0};
}

bool td_dataset_has_file(const char *folder, const char *name)
{
    struct stat status;
    char *path = td_path_join(folder, name);
    const bool there = path && stat(path, &status) == 0 && S_ISREG(status.st_mode);
    free(path);
    return there;
}

void td_dataset_layout_name(char name[TD_NAME_SIZE], const char *folder)
{
    size_t end = strlen(folder), n = 0;
    while (end > 0 && folder[end - 1] == '/') end--;
    size_t first = end;
    while (first > 0 && folder[first - 1] != '/') first--;
    for (; first < end && n + 1 < TD_NAME_SIZE; first++) {
        const char c = folder[first];
        const bool plain =
            (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-';
        name[n++] = plain ? c : '_';
    }
    name[n] = 0;
    if (strspn(name, "_") == n) strcpy(name, "dataset");
}

typedef td_status (*read_layout)(td_dataset_layout *layout, const char *folder, td_error *error);

/* NULL: in no layout that is known. */
static read_layout layout_of(const char *folder)
{
    if (!is_folder(folder) || td_dataset_has_file(folder, DESCRIPTION)) return NULL;
    if (td_dataset_is_euroc(folder)) return td_dataset_euroc;
    return td_dataset_is_middlebury(folder) ? td_dataset_middlebury : NULL;
}

static td_status read_foreign(td_dataset **dataset, const char *folder, read_layout read, td_error *error)
{
    td_dataset_layout layout;
    TD_TRY(read(&layout, folder, error));
    td_status status = td_dataset_parse(dataset, layout.yaml, strlen(layout.yaml), layout.table,
                                        strlen(layout.table), folder, error);
    if (status == TD_OK) {
        td_dataset *d = *dataset;
        d->table_text = layout.table;
        d->rig_text = layout.rig;
        layout.table = layout.rig = NULL;
        if (!d->rig_text) {
            free(d->rig);
            d->rig = NULL;
        }
    }
    td_dataset_layout_free(&layout);
    return status;
}

td_status td_dataset_read(td_dataset **dataset, const char *path, td_error *error)
{
    char *file = NULL;
    const read_layout foreign = layout_of(path);
    if (foreign) return read_foreign(dataset, path, foreign, error);
    TD_TRY(find_description(&file, path, error));
    char *folder = td_path_folder(file);
    json_t *document = NULL;
    td_status status = folder ? td_document_read(&document, file, error) : out_of_memory(error);
    if (status == TD_OK) status = make_dataset(dataset, document, file, folder, NULL, error);
    free(folder);
    free(file);
    return status;
}
