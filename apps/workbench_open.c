/* The datasets and folders that the command line allows, and their pictures. Names of clients are only ever
 * compared with names that are known: no path is made of them. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "apps/capture_internal.h"
#include "apps/workbench_internal.h"
#include "core/file.h"

enum { MOST_PICTURES = 2000, MOST_WIDTH = 4096 };

td_status workbench_folder(char **path, const char *output, const char *name, td_error *error)
{
    *path = td_path_join(output, name);
    return *path ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
}

const workbench_place *workbench_find(const workbench *w, const char *name)
{
    for (size_t i = 0; i < w->places; i++)
        if (strcmp(w->place[i].name, name) == 0) return w->place + i;
    return NULL;
}

static bool exists(const char *folder, const char *name)
{
    char *path = td_path_join(folder, name);
    const bool there = path && access(path, R_OK) == 0;
    free(path);
    return there;
}

/* ---- datasets ---- */

static int by_name(const struct dirent **a, const struct dirent **b)
{
    return strcmp((*a)->d_name, (*b)->d_name);
}

static int is_picture(const struct dirent *entry)
{
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".pgm", ".ppm"};
    const char *ending = strrchr(entry->d_name, '.');
    for (size_t i = 0; ending && i < sizeof endings / sizeof *endings; i++)
        if (strcasecmp(ending, endings[i]) == 0)
            return !strpbrk(entry->d_name, ",\"#\n") && ending < entry->d_name + 60;
    return 0;
}

/* A table of a folder's pictures, each a frame of its own. */
static td_status table_of(char **text, size_t *size, const char *folder, td_error *error)
{
    struct dirent **entry = NULL;
    const int count = scandir(folder, &entry, is_picture, by_name);
    FILE *out = count > 0 ? open_memstream(text, size) : NULL;
    if (out) fputs("frame,picture\n", out);
    for (int i = 0; i < count; i++) {
        const char *name = entry[i]->d_name;
        if (out && i < MOST_PICTURES) fprintf(out, "%.*s,%s\n", (int)(strrchr(name, '.') - name), name, name);
        free(entry[i]);
    }
    free(entry);
    if (!out) return td_fail(error, TD_ERROR_NOT_FOUND, "%s: has neither dataset.yaml nor pictures", folder);
    return fclose(out) == 0 ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a table");
}

/* Without a target there is nothing to calibrate; its pictures can be looked at. `yaml` is added to. */
static td_status parse_bare(td_dataset **dataset, const char *yaml, const char *table, size_t table_size,
                            const char *folder, td_error *error)
{
    static const char calibrated[] = "\nrig: none\n"; /* lets the target be missing */
    char *whole = malloc(strlen(yaml) + sizeof calibrated);
    if (!whole) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    sprintf(whole, "%s%s", yaml, calibrated);
    const td_status status =
        td_dataset_parse(dataset, whole, strlen(whole), table, table_size, folder, error);
    free(whole);
    if (status != TD_OK) return status;
    free((*dataset)->rig);
    (*dataset)->rig = NULL;
    return TD_OK;
}

static td_status open_folder(td_dataset **dataset, const char *folder, td_error *error)
{
    char *table = NULL;
    size_t size = 0;
    TD_TRY(table_of(&table, &size, folder, error));
    const td_status status = parse_bare(dataset, "name: pictures\ncameras: [{name: picture, model: pinhole}]",
                                        table, size, folder, error);
    free(table);
    return status;
}

/* As teledimos capture leaves it when no target was named. */
static td_status open_untargeted(td_dataset **dataset, const char *folder, td_error *error)
{
    char *yaml_path = td_path_join(folder, "dataset.yaml"), *table_path = td_path_join(folder, "frames.csv");
    char *yaml = NULL, *table = NULL;
    size_t yaml_size = 0, size = 0;
    td_status status =
        yaml_path && table_path ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (status == TD_OK) status = td_file_read(&yaml, &yaml_size, yaml_path, 1 << 20, error);
    if (status == TD_OK) status = td_file_read(&table, &size, table_path, 64 << 20, error);
    if (status == TD_OK) status = parse_bare(dataset, yaml, table, size, folder, error);
    free(yaml);
    free(table);
    free(yaml_path);
    free(table_path);
    return status;
}

static bool names_target(const char *folder)
{
    char *path = td_path_join(folder, "dataset.yaml");
    json_t *root = NULL;
    const bool read = path && td_document_read(&root, path, NULL) == TD_OK;
    const bool named = read && (json_object_get(root, "target") || json_object_get(root, "rig"));
    json_decref(root);
    free(path);
    return named || !read;
}

td_status workbench_dataset(td_dataset **dataset, bool *has_target, const workbench_place *place,
                            td_error *error)
{
    td_status status;
    if (!exists(place->path, "dataset.yaml") && !exists(place->path, "mav0") &&
        !exists(place->path, "calib.txt"))
        status = open_folder(dataset, place->path, error);
    else if (!names_target(place->path))
        status = open_untargeted(dataset, place->path, error);
    else
        status = td_dataset_read(dataset, place->path, error);
    *has_target = status == TD_OK && td_target_point_count(&(*dataset)->target) > 0;
    return status;
}

char *workbench_rig(const workbench *w, const workbench_place *place, const td_dataset *dataset,
                    bool *calibrated)
{
    char name[TD_NAME_SIZE + 32];
    snprintf(name, sizeof name, "calibrated/%s/rig.yaml", place->name);
    char *path = td_path_join(w->output, name);
    *calibrated = path && access(path, R_OK) == 0;
    if (*calibrated) return path;
    free(path);
    return dataset->rig && !dataset->rig_text ? strdup(dataset->rig) : NULL;
}

/* ---- what there is ---- */

static json_t *cameras_json(const td_dataset *d)
{
    json_t *list = json_array();
    for (int c = 0; c < d->camera_count; c++) json_array_append_new(list, json_string(d->camera[c].name));
    return list;
}

static json_t *place_json(const workbench *w, const workbench_place *place)
{
    td_dataset *d = NULL;
    td_error error = {0};
    bool has_target, calibrated = false;
    char text[120] = "";
    if (workbench_dataset(&d, &has_target, place, &error) != TD_OK)
        return json_pack("{s:s, s:s}", "bench", place->name, "trouble", error.message);
    char *rig = workbench_rig(w, place, d, &calibrated);
    if (has_target) td_target_describe(text, sizeof text, &d->target);
    json_t *one = json_pack("{s:s, s:I, s:o, s:s, s:s}", "bench", place->name, "frames",
                            (json_int_t)d->frame_count, "cameras", cameras_json(d), "target", text, "rig",
                            !rig         ? ""
                            : calibrated ? "calibrated"
                                         : "own");
    free(rig);
    td_dataset_free(&d);
    return one;
}

td_status workbench_benches(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    (void)a, (void)error;
    json_t *list = json_array();
    for (size_t i = 0; i < w->places; i++) {
        const bool acquired = i == 0;
        if (acquired && !exists(w->place[i].path, "dataset.yaml")) continue; /* nothing is stored yet */
        json_array_append_new(list, place_json(w, w->place + i));
    }
    *answer = json_pack("{s:o}", "benches", list);
    return TD_OK;
}

static void close_one(workbench *w, workbench_use use)
{
    workbench_open_place *o = w->open + use;
    if (use == WORKBENCH_CALIBRATE) {
        for (size_t i = 0; o->dataset && i < o->dataset->frame_count * (size_t)o->dataset->camera_count; i++)
            td_detection_free(&w->view[i].detection);
        free(w->view);
        w->view = NULL;
        memset(w->width, 0, sizeof w->width);
        memset(w->height, 0, sizeof w->height);
    } else {
        workbench_unpair(w);
    }
    td_dataset_free(&o->dataset);
    *o = (workbench_open_place){0};
}

void workbench_close(workbench *w)
{
    close_one(w, WORKBENCH_CALIBRATE);
    close_one(w, WORKBENCH_MATCH);
}

static json_t *frames_json(const td_dataset *d)
{
    json_t *list = json_array();
    for (size_t v = 0; v < d->frame_count; v++) {
        json_t *images = json_array();
        for (int c = 0; c < d->camera_count; c++)
            json_array_append_new(images, json_boolean(d->frame[v].image[c] != NULL));
        json_array_append_new(list, json_pack("{s:s, s:o}", "frame", d->frame[v].name, "images", images));
    }
    return list;
}

static json_t *target_json(const workbench_open_place *o)
{
    const td_target *t = &o->dataset->target;
    char text[120];
    if (!o->has_target) return json_null();
    return json_pack("{s:s, s:s, s:i, s:i, s:I, s:b}", "text", td_target_describe(text, sizeof text, t),
                     "kind", td_target_kind_name(t->kind), "columns", t->plane[0].columns, "rows",
                     t->plane[0].rows, "points", (json_int_t)td_target_point_count(t), "clickable",
                     t->kind == TD_TARGET_MARKS);
}

static td_status open_one(workbench *w, workbench_use use, const workbench_place *place, td_error *error)
{
    workbench_open_place o = {.place = place};
    workbench_view *view = NULL;
    TD_TRY(workbench_dataset(&o.dataset, &o.has_target, place, error));
    if (use == WORKBENCH_CALIBRATE) {
        view = calloc(o.dataset->frame_count * (size_t)o.dataset->camera_count + 1, sizeof *view);
        if (!view) {
            td_dataset_free(&o.dataset);
            return td_fail(error, TD_ERROR_MEMORY, "no memory for %s", place->name);
        }
    }
    close_one(w, use);
    w->open[use] = o;
    if (view) w->view = view;
    return TD_OK;
}

static const char *const uses[] = {"calibrate", "match", NULL};

td_status workbench_open(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    const td_field bench = td_field_get(a, "bench"), use = td_field_get(a, "for");
    const char *name;
    int only = -1;
    bool calibrated;
    TD_TRY(td_field_string(&name, &bench, error));
    if (use.value) TD_TRY(td_field_choice(&only, &use, uses, "calibrate or match", error));
    const workbench_place *place = workbench_find(w, name);
    if (!place) return td_field_fail(&bench, error, "there is no bench of that name; Benches lists them");
    for (int k = 0; k < WORKBENCH_USES; k++)
        if (only < 0 || only == k) TD_TRY(open_one(w, (workbench_use)k, place, error));
    const workbench_open_place *o = w->open + (only < 0 ? 0 : only);
    char *rig = workbench_rig(w, place, o->dataset, &calibrated);
    *answer =
        json_pack("{s:s, s:o, s:o, s:o, s:s}", "bench", place->name, "cameras", cameras_json(o->dataset),
                  "frames", frames_json(o->dataset), "target", target_json(o), "rig",
                  !rig         ? ""
                  : calibrated ? "calibrated"
                               : "own");
    free(rig);
    return TD_OK;
}

/* ---- a picture ---- */

td_status workbench_frame(size_t *frame, const workbench_open_place *o, const td_field *a, td_error *error)
{
    const td_field f = td_field_get(a, "frame");
    const char *name;
    if (!o->place) return td_fail(error, TD_ERROR_ARGUMENT, "no bench is open: OpenBench first");
    TD_TRY(td_field_string(&name, &f, error));
    for (*frame = 0; *frame < o->dataset->frame_count; ++*frame)
        if (strcmp(o->dataset->frame[*frame].name, name) == 0) return TD_OK;
    return td_field_fail(&f, error, "%s has no frame of that name", o->place->name);
}

td_status workbench_image(size_t *frame, int *camera, const char **path, const workbench_open_place *o,
                          const td_field *a, td_error *error)
{
    const td_field c = td_field_get(a, "camera");
    const char *name;
    TD_TRY(workbench_frame(frame, o, a, error));
    const td_dataset *d = o->dataset;
    TD_TRY(td_field_string(&name, &c, error));
    for (*camera = 0; *camera < d->camera_count; ++*camera)
        if (strcmp(d->camera[*camera].name, name) == 0) break;
    if (*camera == d->camera_count)
        return td_field_fail(&c, error, "%s has no camera of that name", o->place->name);
    *path = d->frame[*frame].image[*camera];
    if (!*path)
        return td_fail(error, TD_ERROR_NOT_FOUND, "frame %s has no image of camera %s", d->frame[*frame].name,
                       name);
    return TD_OK;
}

td_status workbench_pixel(double pixel[2], const td_field *a, td_error *error)
{
    const td_field x = td_field_get(a, "x"), y = td_field_get(a, "y");
    TD_TRY(td_field_real(&pixel[0], &x, -0.5, 65535, error));
    return td_field_real(&pixel[1], &y, -0.5, 65535, error);
}

static char *base64(const uint8_t *bytes, size_t size)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char *text = malloc(4 * (size / 3 + 1) + 1), *at = text;
    for (size_t i = 0; text && i < size; i += 3) {
        const size_t left = size - i;
        const uint32_t three = (uint32_t)bytes[i] << 16 | (left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0) |
                               (left > 2 ? bytes[i + 2] : 0u);
        *at++ = digit[three >> 18];
        *at++ = digit[three >> 12 & 63];
        *at++ = left > 1 ? digit[three >> 6 & 63] : '=';
        *at++ = left > 2 ? digit[three & 63] : '=';
    }
    if (text) *at = 0;
    return text;
}

td_status workbench_jpeg(json_t **picture, const td_image *image, int quality, td_error *error)
{
    uint8_t *jpeg = NULL;
    size_t size = 0;
    TD_TRY(td_image_encode_jpeg(&jpeg, &size, image, quality, error));
    char *text = base64(jpeg, size);
    free(jpeg);
    *picture = text ? json_pack("{s:s, s:i, s:i, s:s}", "format", "jpeg", "width", image->width, "height",
                                image->height, "data", text)
                    : NULL;
    free(text);
    return *picture ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a picture");
}

td_status workbench_picture(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    enum { QUALITY = 92 };
    const td_field of = td_field_get(a, "for");
    size_t frame;
    int camera, use = WORKBENCH_CALIBRATE;
    const char *path;
    td_image *image = NULL, *grey = NULL;
    if (of.value) TD_TRY(td_field_choice(&use, &of, uses, "calibrate or match", error));
    TD_TRY(workbench_image(&frame, &camera, &path, w->open + use, a, error));
    TD_TRY(td_image_read(&image, path, 3, error));
    td_status status =
        image->width > MOST_WIDTH || image->height > MOST_WIDTH
            ? td_fail(error, TD_ERROR_UNSUPPORTED, "%s: %d x %d px are more than is shown here", path,
                      image->width, image->height)
            : TD_OK;
    if (status == TD_OK && !capture_has_colour(image)) status = td_image_read(&grey, path, 1, error);
    const td_image *shown = grey ? grey : image;
    if (status == TD_OK) status = workbench_jpeg(answer, shown, QUALITY, error);
    if (status == TD_OK) {
        const capture_measure m = capture_measure_image(shown);
        json_object_set_new(*answer, "focus", td_json_real(m.focus));
        json_object_set_new(*answer, "brightness_share", td_json_real(m.brightness_share));
        json_object_set_new(*answer, "saturated_share", td_json_real(m.saturated_share));
    }
    td_image_free(&image);
    td_image_free(&grey);
    return status;
}
