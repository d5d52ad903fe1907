/* The dataset that grows: each image whole, then the table that names it.
 *
 * After a kill at any moment an image may be there that the table does not name yet: the next run finds it by
 * its number and adds it, without a time. Nothing that was stored is lost, and no number is given twice. */
#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "apps/capture_internal.h"
#include "apps/terminal.h"
#include "core/csv.h"
#include "core/document.h"
#include "core/file.h"
#include "core/number.h"

enum { NUMBER_DIGITS = 6, COLUMN_FRAME = 0, COLUMN_TIME = 1, COLUMN_IMAGE = 2, IMAGE_NAME_SIZE = 128 };
static const long LARGEST_NUMBER = 99999999;
/* At most this share of the time goes into writing the table, which grows. */
static const double TABLE_SHARE = 0.1;

static td_status out_of_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "out of memory for the dataset");
}

static td_status append(capture_dataset *d, const char *text, size_t size, td_error *error)
{
    if (d->table_size + size + 1 > d->table_capacity) {
        const size_t capacity = 2 * (d->table_size + size) + 4096;
        char *larger = realloc(d->table, capacity);
        if (!larger) return out_of_memory(error);
        d->table = larger;
        d->table_capacity = capacity;
    }
    memcpy(d->table + d->table_size, text, size);
    d->table_size += size;
    d->table[d->table_size] = 0;
    return TD_OK;
}

/* "left/000012.pgm" */
static void image_name(char name[IMAGE_NAME_SIZE], const capture_dataset *d, int camera, long number,
                       const char *format)
{
    snprintf(name, IMAGE_NAME_SIZE, "%s/%0*ld.%s", d->name[camera], NUMBER_DIGITS, number, format);
}

static const char *ending_of(const capture_dataset *d)
{
    return d->colour && !strcmp(d->format, "pgm") ? "ppm" : d->format;
}

/* A row of the table, with empty cells for columns that are not ours. */
static td_status append_row(capture_dataset *d, long number, double time_s, char (*image)[IMAGE_NAME_SIZE],
                            td_error *error)
{
    char row[1024], time_text[TD_NUMBER_SIZE] = "", cell[IMAGE_NAME_SIZE];
    size_t used = 0;
    /* To the microsecond: sixteen digits of the time since 1970. */
    if (isfinite(time_s)) snprintf(time_text, sizeof time_text, "%.6f", time_s);
    for (int c = 0; c < d->columns; c++) {
        cell[0] = 0;
        if (c == d->column_of[COLUMN_FRAME]) snprintf(cell, sizeof cell, "%0*ld", NUMBER_DIGITS, number);
        if (c == d->column_of[COLUMN_TIME]) snprintf(cell, sizeof cell, "%s", time_text);
        for (int i = 0; i < d->cameras; i++)
            if (c == d->column_of[COLUMN_IMAGE + i]) snprintf(cell, sizeof cell, "%s", image[i]);
        if (used + strlen(cell) + 2 >= sizeof row)
            return td_fail(error, TD_ERROR_FORMAT, "%s/frames.csv: has too many columns", d->folder);
        used += (size_t)sprintf(row + used, "%s%s", c ? "," : "", cell);
    }
    row[used++] = '\n';
    d->unwritten = true;
    return append(d, row, used, error);
}

static td_status write_file(const capture_dataset *d, const char *name, const char *text, size_t size,
                            td_error *error)
{
    char *path = td_path_join(d->folder, name);
    td_status status = path ? td_file_write(path, text, size, error) : out_of_memory(error);
    free(path);
    return status;
}

static bool exists(const capture_dataset *d, const char *name)
{
    struct stat seen;
    char *path = td_path_join(d->folder, name);
    const bool found = path && stat(path, &seen) == 0;
    free(path);
    return found;
}

/* ---- dataset.yaml ---- */

/* The folder's name, as far as it can be a dataset's. */
static void title_of(char title[CAPTURE_NAME_SIZE], const char *folder)
{
    size_t end = strlen(folder), begin;
    while (end > 1 && folder[end - 1] == '/') end--;
    for (begin = end; begin > 0 && folder[begin - 1] != '/'; begin--) {
    }
    size_t used = 0;
    for (size_t i = begin; i < end && used < CAPTURE_NAME_SIZE - 1; i++)
        title[used++] = (unsigned char)folder[i] > ' ' && (unsigned char)folder[i] < 127 ? folder[i] : '-';
    title[used] = 0;
    if (!used || !strcmp(title, ".") || !strcmp(title, "..")) strcpy(title, "capture");
}

static td_status write_description(const capture_dataset *d, const json_t *root, td_error *error)
{
    char *yaml = NULL;
    TD_TRY(td_document_to_yaml(&yaml, root, 0, error));
    td_status status = write_file(d, "dataset.yaml", yaml, strlen(yaml), error);
    free(yaml);
    return status;
}

static td_status new_description(const capture_dataset *d, td_error *error)
{
    char title[CAPTURE_NAME_SIZE];
    title_of(title, d->folder);
    json_t *root = json_pack("{s:s}", "name", title), *cameras = json_array();
    json_t *note = json_string(d->about);
    if (note) json_object_set_new(root, "about", note);
    if (d->target) json_object_set(root, "target", d->target);
    for (int i = 0; i < d->cameras; i++)
        json_array_append_new(cameras, json_pack("{s:s, s:s}", "name", d->name[i], "model", d->model));
    json_object_set_new(root, "cameras", cameras);
    td_status status = root ? write_description(d, root, error) : out_of_memory(error);
    json_decref(root);
    return status;
}

/* The cameras of a dataset that is there must be ours. */
static td_status check_cameras(const capture_dataset *d, const td_field *root, td_error *error)
{
    td_field cameras = td_field_get(root, "cameras");
    size_t count = 0;
    TD_TRY(td_field_count(&count, &cameras, 1, 64, error));
    bool same = count == (size_t)d->cameras;
    for (size_t i = 0; same && i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        td_field camera = td_field_at(&cameras, i, index), name = td_field_get(&camera, "name");
        const char *text = NULL;
        TD_TRY(td_field_string(&text, &name, error));
        same = !strcmp(text, d->name[i]);
    }
    if (same) return TD_OK;
    return td_field_fail(&cameras, error,
                         "this dataset has %zu cameras, other than %s%s%s; give their names by --names, or "
                         "another folder",
                         count, d->name[0], d->cameras > 1 ? ", " : "", d->cameras > 1 ? d->name[1] : "");
}

static td_status old_description(capture_dataset *d, const char *path, td_error *error)
{
    json_t *root = NULL;
    TD_TRY(td_document_read(&root, path, error));
    const td_field field = {NULL, path, root};
    td_status status = check_cameras(d, &field, error);
    td_field images = td_field_get(&field, "root"), frames = td_field_get(&field, "frames");
    if (status == TD_OK && (images.value || frames.value))
        status = td_field_fail(images.value ? &images : &frames, error,
                               "a dataset whose images lie elsewhere is not added to; give another folder");
    json_t *target = d->target;
    const json_t *old = json_object_get(root, "target");
    if (status == TD_OK && target && old && !json_equal(old, target))
        status =
            td_fail(error, TD_ERROR_ARGUMENT,
                    "%s: has another target than --target; leave --target out, or give another folder", path);
    if (status == TD_OK && target && !old) {
        json_object_set(root, "target", target);
        status = write_description(d, root, error);
    }
    d->has_target = old || target;
    json_decref(root);
    return status;
}

/* ---- frames.csv ---- */

static td_status new_table(capture_dataset *d, td_error *error)
{
    char header[2 * CAPTURE_NAME_SIZE + 32];
    size_t used = (size_t)sprintf(header, "frame,time_s");
    for (int i = 0; i < d->cameras; i++) used += (size_t)sprintf(header + used, ",%s", d->name[i]);
    header[used++] = '\n';
    d->columns = 2 + d->cameras;
    for (int i = 0; i < d->columns; i++) d->column_of[i] = i;
    return append(d, header, used, error);
}

static td_status read_table(capture_dataset *d, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    td_csv *csv = NULL;
    TD_TRY(td_file_read(&text, &size, path, (size_t)64 << 20, error));
    td_status status = td_csv_parse(&csv, text, size, path, error);
    if (status == TD_OK) status = append(d, text, size, error);
    if (status == TD_OK && size && text[size - 1] != '\n') status = append(d, "\n", 1, error);
    free(text);
    if (status != TD_OK) {
        td_csv_free(&csv);
        return status;
    }
    d->columns = (int)csv->columns;
    d->column_of[COLUMN_FRAME] = td_csv_column(csv, "frame");
    d->column_of[COLUMN_TIME] = td_csv_column(csv, "time_s");
    for (int i = 0; i < d->cameras; i++) {
        d->column_of[COLUMN_IMAGE + i] = td_csv_column(csv, d->name[i]);
        if (d->column_of[COLUMN_IMAGE + i] < 0 || d->column_of[COLUMN_FRAME] < 0)
            status = td_fail(error, TD_ERROR_FORMAT, "%s: has no column '%s'; give another folder", path,
                             d->column_of[COLUMN_FRAME] < 0 ? "frame" : d->name[i]);
    }
    for (size_t row = 0; status == TD_OK && row < csv->rows; row++) {
        long long number = 0;
        const char *name = td_csv_cell(csv, row, d->column_of[COLUMN_FRAME]);
        name += strspn(name, "0");
        if (td_number_parse(&number, NULL, *name ? name : "0") == TD_NUMBER_INTEGER &&
            number < LARGEST_NUMBER && number >= d->next)
            d->next = (long)number + 1;
    }
    d->found = csv->rows;
    td_csv_free(&csv);
    return status;
}

/* The largest number among a camera's images, -1: none. */
static long largest_image(const capture_dataset *d, int camera)
{
    char *path = td_path_join(d->folder, d->name[camera]);
    DIR *stream = path ? opendir(path) : NULL;
    long largest = -1;
    for (struct dirent *entry; stream && (entry = readdir(stream));) {
        char *end;
        const size_t digits = strspn(entry->d_name, "0123456789");
        if (digits < NUMBER_DIGITS || digits > 8 || entry->d_name[digits] != '.') continue;
        const long number = strtol(entry->d_name, &end, 10);
        if (number > largest) largest = number;
    }
    if (stream) closedir(stream);
    free(path);
    return largest;
}

/* The image of this number, whatever its format. */
static bool find_image(char name[IMAGE_NAME_SIZE], const capture_dataset *d, int camera, long number)
{
    static const char *const formats[] = {"pgm", "ppm", "png", NULL};
    for (int i = 0; formats[i]; i++) {
        image_name(name, d, camera, number, formats[i]);
        if (exists(d, name)) return true;
    }
    return false;
}

/* Takes up images that no row names: written just before a kill. */
static td_status adopt(capture_dataset *d, td_error *error)
{
    long last = -1;
    for (int i = 0; i < d->cameras; i++) {
        const long largest = largest_image(d, i);
        last = largest > last ? largest : last;
    }
    for (; d->next <= last; d->next++) {
        char image[CAPTURE_CAMERAS][IMAGE_NAME_SIZE];
        bool whole = true;
        for (int i = 0; i < d->cameras; i++) whole = find_image(image[i], d, i, d->next) && whole;
        if (!whole) continue;
        TD_TRY(append_row(d, d->next, NAN, image, error));
        d->adopted++;
    }
    return TD_OK;
}

/* The folders, and dataset.yaml of a new one. */
static td_status begin(capture_dataset *d, td_error *error)
{
    if (d->begun) return TD_OK;
    TD_TRY(td_folder_make(d->folder, error));
    if (!exists(d, "dataset.yaml")) TD_TRY(new_description(d, error));
    for (int i = 0; i < d->cameras; i++) {
        char *path = td_path_join(d->folder, d->name[i]);
        td_status status = path ? td_folder_make(path, error) : out_of_memory(error);
        free(path);
        TD_TRY(status);
    }
    d->begun = true;
    return TD_OK;
}

td_status capture_dataset_open(capture_dataset *d, td_error *error)
{
    char *yaml = td_path_join(d->folder, "dataset.yaml"), *table = td_path_join(d->folder, "frames.csv");
    td_status status = yaml && table ? TD_OK : out_of_memory(error);
    d->has_target = d->target != NULL;
    if (status == TD_OK && exists(d, "dataset.yaml")) status = old_description(d, yaml, error);
    if (status == TD_OK) status = exists(d, "frames.csv") ? read_table(d, table, error) : new_table(d, error);
    if (status == TD_OK) status = adopt(d, error);
    if (status == TD_OK && d->adopted) status = begin(d, error);
    if (status == TD_OK) status = capture_dataset_flush(d, true, error);
    free(yaml);
    free(table);
    return status;
}

td_status capture_dataset_add(capture_dataset *d, td_image *const *image, double time_s, td_error *error)
{
    char name[CAPTURE_CAMERAS][IMAGE_NAME_SIZE];
    TD_TRY(begin(d, error));
    for (int i = 0; i < d->cameras; i++) {
        image_name(name[i], d, i, d->next, ending_of(d));
        char *path = td_path_join(d->folder, name[i]);
        td_status status = path ? td_image_write(path, image[i], error) : out_of_memory(error);
        free(path);
        TD_TRY(status);
    }
    TD_TRY(append_row(d, d->next, time_s, name, error));
    d->next++;
    return capture_dataset_flush(d, false, error);
}

td_status capture_dataset_flush(capture_dataset *d, bool now, td_error *error)
{
    const double begun_s = terminal_now_s();
    if (!d->unwritten || (!now && begun_s < d->written_s + d->write_took_s / TABLE_SHARE)) return TD_OK;
    TD_TRY(write_file(d, "frames.csv", d->table, d->table_size, error));
    d->written_s = terminal_now_s();
    d->write_took_s = d->written_s - begun_s;
    d->unwritten = false;
    return TD_OK;
}

void capture_dataset_close(capture_dataset *d)
{
    free(d->table);
    d->table = NULL;
    json_decref(d->target);
    d->target = NULL;
}
