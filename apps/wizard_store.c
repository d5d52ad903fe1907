/* The wizard's dataset on disk: whole after each picture, so that nothing is lost whenever it ends. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "apps/wizard_internal.h"
#include "core/csv.h"
#include "core/document.h"
#include "core/file.h"
#include "core/number.h"
#include "core/parallel.h"
#include "core/target_words.h"

static td_status no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "out of memory");
}

static td_status write_in_folder(const wizard *w, const char *name, const char *text, td_error *error)
{
    char *path = td_path_join(w->folder, name);
    td_status status = path ? td_file_write(path, text, strlen(text), error) : no_memory(error);
    free(path);
    return status;
}

static td_status write_document(const wizard *w, const char *name, json_t *root, td_error *error)
{
    char *yaml = NULL;
    td_status status = td_document_to_yaml(&yaml, root, 0, error);
    if (status == TD_OK) status = write_in_folder(w, name, yaml, error);
    free(yaml);
    json_decref(root);
    return status;
}

static json_t *cameras(const wizard_answers *a)
{
    json_t *list = json_array();
    for (int c = 0; c < a->camera_count; c++)
        json_array_append_new(
            list, json_pack("{s:s, s:s}", "name", a->name[c], "model", td_camera_model_name(a->model)));
    return list;
}

td_status wizard_write_answers(const wizard *w, td_error *error)
{
    const wizard_answers *a = &w->answers;
    json_t *sources = json_array();
    for (int c = 0; c < a->camera_count; c++)
        json_array_append_new(sources,
                              json_pack("{s:s, s:s}", "source", a->source[c], "names", a->pattern[c]));
    json_t *answers = json_pack("{s:s, s:o, s:o, s:O}", "teledimos", "wizard 1", "sources", sources,
                                "cameras", cameras(a), "target", a->target_mapping);
    TD_TRY(td_folder_make(w->folder, error));
    TD_TRY(write_document(w, "wizard.yaml", answers, error));
    json_t *dataset = json_pack("{s:s, s:s+, s:O, s:o}", "name", "calibration", "about",
                                "Taken by teledimos calibrate from ", a->source[0], "target",
                                a->target_mapping, "cameras", cameras(a));
    return write_document(w, "dataset.yaml", dataset, error);
}

static td_status read_camera(wizard_answers *a, int c, const td_field *sources, const td_field *list,
                             td_error *error)
{
    char index[TD_FIELD_INDEX_SIZE];
    td_field source = td_field_at(sources, (size_t)c, index), camera = td_field_at(list, (size_t)c, index);
    td_field where = td_field_get(&source, "source"), names = td_field_get(&source, "names");
    td_field name = td_field_get(&camera, "name"), model = td_field_get(&camera, "model");
    const char *text;
    TD_TRY(td_field_string(&text, &where, error));
    snprintf(a->source[c], sizeof a->source[c], "%s", text);
    TD_TRY(td_field_string(&text, &names, error));
    snprintf(a->pattern[c], sizeof a->pattern[c], "%s", text);
    TD_TRY(td_field_string(&text, &name, error));
    snprintf(a->name[c], sizeof a->name[c], "%s", text);
    TD_TRY(td_field_string(&text, &model, error));
    a->model = td_camera_model_from_name(text);
    if (a->model == TD_CAMERA_MODEL_COUNT) return td_field_fail(&model, error, "there is no such lens model");
    return TD_OK;
}

static td_status read_answers(wizard *w, json_t *root, const char *path, td_error *error)
{
    wizard_answers *a = &w->answers;
    td_field top = {NULL, path, root}, sources = td_field_get(&top, "sources");
    td_field list = td_field_get(&top, "cameras");
    size_t count, named;
    TD_TRY(td_field_count(&count, &sources, 1, WIZARD_CAMERAS, error));
    TD_TRY(td_field_count(&named, &list, count, count, error));
    a->camera_count = (int)count;
    for (int c = 0; c < a->camera_count; c++) TD_TRY(read_camera(a, c, &sources, &list, error));
    char *words = NULL;
    json_t *target = json_object_get(root, "target");
    if (!target) return td_fail(error, TD_ERROR_FORMAT, "%s: target: is missing", path);
    TD_TRY(td_document_to_json(&words, target, 0, error));
    td_status status = td_target_from_words(&a->target, &a->target_mapping, words, error);
    free(words);
    return status == TD_OK ? TD_OK : td_error_prefix(error, status, "%s", path);
}

td_status wizard_read_answers(wizard *w, td_error *error)
{
    char *path = td_path_join(w->folder, "wizard.yaml");
    json_t *root = NULL;
    struct stat info;
    if (!path) return no_memory(error);
    td_status status = TD_OK;
    if (stat(path, &info) != 0 && errno == ENOENT)
        status =
            td_fail(error, TD_ERROR_NOT_FOUND,
                    "%s: nothing was begun there (no wizard.yaml); leave out --resume to begin", w->folder);
    if (status == TD_OK) status = td_document_read(&root, path, error);
    if (status == TD_OK) status = read_answers(w, root, path, error);
    json_decref(root);
    free(path);
    return status;
}

/* ---- Views ---- */

/* In quotes, as RFC 4180 has it: names of files may hold anything. */
static void put_cell(FILE *out, const char *text)
{
    putc('"', out);
    for (; text && *text; text++) {
        if (*text == '"') putc('"', out);
        putc(*text, out);
    }
    putc('"', out);
}

td_status wizard_write_views(const wizard *w, td_error *error)
{
    char *text = NULL, number[TD_NUMBER_SIZE];
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (!out) return no_memory(error);
    fputs("frame,time_s", out);
    for (int c = 0; c < w->answers.camera_count; c++) fprintf(out, ",%s", w->answers.name[c]);
    putc('\n', out);
    for (size_t v = 0; v < w->count; v++) {
        const wizard_view *view = &w->view[v];
        fprintf(out, "%s,%s", view->name,
                isnan(view->time_s) ? "" : td_number_format(number, view->time_s, 0));
        for (int c = 0; c < w->answers.camera_count; c++) {
            putc(',', out);
            put_cell(out, view->image[c]);
        }
        putc('\n', out);
    }
    td_status status =
        fclose(out) == 0 && text ? write_in_folder(w, "frames.csv", text, error) : no_memory(error);
    free(text);
    return status;
}

static td_status grow(wizard *w, td_error *error)
{
    if (w->count < w->capacity) return TD_OK;
    size_t capacity = w->capacity ? 2 * w->capacity : 32;
    wizard_view *view = realloc(w->view, capacity * sizeof *view);
    if (!view) return no_memory(error);
    w->view = view;
    w->capacity = capacity;
    return TD_OK;
}

char *wizard_image_path(const wizard *w, const wizard_view *view, int camera)
{
    return view->image[camera] ? td_path_join(w->folder, view->image[camera]) : NULL;
}

bool wizard_has(const wizard *w, const char *image)
{
    for (size_t v = w->count; v-- > 0;)
        for (int c = 0; c < w->answers.camera_count; c++)
            if (w->view[v].image[c] && strcmp(w->view[v].image[c], image) == 0) return true;
    return false;
}

static void look_again(size_t index, void *user)
{
    wizard *w = user;
    size_t cameras_of = (size_t)w->answers.camera_count;
    wizard_view *view = &w->view[index / cameras_of];
    int c = (int)(index % cameras_of);
    td_image *image = NULL;
    td_error error;
    char *path = wizard_image_path(w, view, c);
    if (path && td_image_read(&image, path, 1, &error) == TD_OK)
        td_detect(&view->detection[c], image, &w->answers.target, &error);
    else if (path &&
             td_detection_init(&view->detection[c], td_target_point_count(&w->answers.target), NULL) == TD_OK)
        snprintf(view->detection[c].reason, sizeof view->detection[c].reason, "%.230s", error.message);
    if (image) w->width[c] = image->width, w->height[c] = image->height;
    td_image_free(&image);
    free(path);
}

static td_status read_view(wizard *w, const td_csv *csv, size_t row, td_error *error)
{
    TD_TRY(grow(w, error));
    wizard_view *view = &w->view[w->count];
    *view = (wizard_view){.time_s = NAN};
    int name = td_csv_column(csv, "frame"), time = td_csv_column(csv, "time_s");
    if (name < 0) return td_fail(error, TD_ERROR_FORMAT, "%s: there is no column frame", csv->name);
    snprintf(view->name, sizeof view->name, "%s", td_csv_cell(csv, row, name));
    if (time >= 0 && *td_csv_cell(csv, row, time))
        TD_TRY(td_csv_real(&view->time_s, csv, row, time, -1e18, 1e18, error));
    w->count++;
    for (int c = 0; c < w->answers.camera_count; c++) {
        int column = td_csv_column(csv, w->answers.name[c]);
        if (column < 0)
            return td_fail(error, TD_ERROR_FORMAT, "%s: there is no column %s", csv->name,
                           w->answers.name[c]);
        const char *image = td_csv_cell(csv, row, column);
        if (*image && !(view->image[c] = strdup(image))) return no_memory(error);
    }
    return TD_OK;
}

td_status wizard_read_views(wizard *w, td_error *error)
{
    char *path = td_path_join(w->folder, "frames.csv");
    td_csv *csv = NULL;
    struct stat info;
    if (!path) return no_memory(error);
    if (stat(path, &info) != 0 && errno == ENOENT) {
        free(path);
        return TD_OK;
    }
    td_status status = td_csv_read(&csv, path, error);
    for (size_t row = 0; status == TD_OK && row < csv->rows; row++) status = read_view(w, csv, row, error);
    td_csv_free(&csv);
    free(path);
    if (status != TD_OK) return status;
    td_progress progress = terminal_progress(w->term);
    status = td_parallel_for(w->count * (size_t)w->answers.camera_count, w->setup->threads, look_again, w,
                             &progress, "looking at what there is");
    terminal_clear(w->term);
    return status == TD_OK ? TD_OK : td_fail(error, status, "interrupted");
}

/* ---- Taking ---- */

/* A name of its own from the picture's: "left01", or "left01-2" when there is one already. */
static void name_view(wizard *w, wizard_view *view)
{
    char stem[40];
    size_t n = 0;
    const char *end = strrchr(w->frame[0].name, '.');
    size_t length = end ? (size_t)(end - w->frame[0].name) : strlen(w->frame[0].name);
    for (size_t i = 0; i < length && n + 1 < sizeof stem; i++) {
        char ch = w->frame[0].name[i];
        bool plain =
            (ch >= '0' && ch <= '9') || (ch >= 'a' && ch <= 'z') || (ch >= 'A' && ch <= 'Z') || ch == '-';
        stem[n++] = plain ? ch : '_';
    }
    stem[n] = 0;
    snprintf(view->name, sizeof view->name, "%s", n ? stem : "view");
    for (int again = 2;; again++) {
        bool there = false;
        for (size_t v = 0; v < w->count && !there; v++) there = strcmp(w->view[v].name, view->name) == 0;
        if (!there) return;
        snprintf(view->name, sizeof view->name, "%s-%d", n ? stem : "view", again);
    }
}

static td_status store_image(wizard *w, wizard_view *view, int c, td_error *error)
{
    char text[WIZARD_PATH + 300];
    if (td_source_kind_of(w->source[c]) == TD_SOURCE_FOLDER) {
        snprintf(text, sizeof text, "%s/%s", w->answers.source[c], w->frame[c].name);
        view->image[c] = strdup(text);
        return view->image[c] ? TD_OK : no_memory(error);
    }
    char *images = td_path_join(w->folder, "images");
    td_status status = images ? td_folder_make(images, error) : no_memory(error);
    free(images);
    snprintf(text, sizeof text, "images/%s-%s.png", w->answers.name[c], view->name);
    view->image[c] = strdup(text);
    char *path = view->image[c] ? td_path_join(w->folder, text) : NULL;
    if (status == TD_OK) status = path ? td_image_write(path, w->frame[c].image, error) : no_memory(error);
    free(path);
    return status;
}

td_status wizard_take(wizard *w, td_error *error)
{
    TD_TRY(grow(w, error));
    wizard_view *view = &w->view[w->count];
    *view = (wizard_view){.time_s = w->frame[0].time_s};
    name_view(w, view);
    td_status status = TD_OK;
    for (int c = 0; c < w->answers.camera_count; c++) {
        view->detection[c] = w->seen[c];
        w->seen[c] = (td_detection){0};
        if (status == TD_OK && w->frame[c].image) status = store_image(w, view, c, error);
    }
    w->count++;
    return status == TD_OK ? wizard_write_views(w, error) : status;
}
