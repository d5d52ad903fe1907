#include "calib/observations.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/csv.h"
#include "core/file.h"
#include "core/number.h"
#include "core/parallel.h"

td_status td_observations_new(td_observations **observations, const td_target *target, int camera_count,
                              size_t view_count, td_error *error)
{
    size_t slots = view_count * (size_t)camera_count;
    td_observations *o = calloc(1, sizeof *o);
    *observations = NULL;
    if (!o) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", view_count);
    o->target = *target;
    o->camera_count = camera_count;
    o->view_count = view_count;
    o->view_name = calloc(view_count + 1, sizeof *o->view_name);
    o->height_m = malloc((view_count + 1) * sizeof *o->height_m);
    o->detection = calloc(slots + 1, sizeof *o->detection);
    td_status status = o->view_name && o->height_m && o->detection
                           ? TD_OK
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", view_count);
    for (size_t v = 0; v < view_count && status == TD_OK; v++) o->height_m[v] = NAN;
    for (size_t i = 0; i < slots && status == TD_OK; i++)
        status = td_detection_init(&o->detection[i], td_target_point_count(target), error);
    if (status == TD_OK)
        *observations = o;
    else
        td_observations_free(&o);
    return status;
}

void td_observations_free(td_observations **observations)
{
    if (!observations || !*observations) return;
    td_observations *o = *observations;
    for (size_t i = 0; o->detection && i < o->view_count * (size_t)o->camera_count; i++)
        td_detection_free(&o->detection[i]);
    free(o->detection);
    free(o->view_name);
    free(o->height_m);
    free(o);
    *observations = NULL;
}

td_detection *td_observations_get(const td_observations *observations, size_t view, int camera)
{
    return &observations->detection[view * (size_t)observations->camera_count + (size_t)camera];
}

void td_observations_set(td_observations *observations, size_t view, int camera,
                         const td_detection *detection)
{
    td_detection *to = td_observations_get(observations, view, camera);
    if (!detection->found) return;
    memcpy(to->point, detection->point, 2 * detection->count * sizeof *to->point);
    memcpy(to->sigma, detection->sigma, detection->count * sizeof *to->sigma);
    to->found = true;
    to->blur_px = detection->blur_px;
}

size_t td_observations_seen(const td_observations *observations, size_t view, int camera)
{
    const td_detection *d = td_observations_get(observations, view, camera);
    size_t n = 0;
    for (size_t p = 0; d->found && p < d->count; p++)
        n += isfinite(d->point[2 * p]) && isfinite(d->point[2 * p + 1]);
    return n;
}

/* ---- clicks ---- */

static td_status need_columns(int *index, const td_csv *csv, const char *const *name, size_t count,
                              td_error *error)
{
    for (size_t i = 0; i < count; i++) {
        index[i] = td_csv_column(csv, name[i]);
        if (index[i] < 0)
            return td_fail(error, TD_ERROR_FORMAT, "%s: there is no column %s", csv->name, name[i]);
    }
    return TD_OK;
}

static td_status add_click(td_image_clicks *all, size_t *count, const td_csv *csv, size_t row,
                           const int column[4], td_error *error)
{
    const char *image = td_csv_cell(csv, row, column[0]);
    size_t i = 0;
    while (i < *count && strcmp(all[i].image, image) != 0) i++;
    if (i == *count) {
        if (!*image || strlen(image) >= sizeof all[i].image)
            return td_csv_fail(csv, row, column[0], error, "not the name of an image");
        snprintf(all[i].image, sizeof all[i].image, "%s", image);
        all[i].count = 0;
        ++*count;
    }
    if (all[i].count == TD_MAX_CLICKS)
        return td_csv_fail(csv, row, column[0], error, "more than %d clicks on %s", TD_MAX_CLICKS, image);
    td_click *click = &all[i].click[all[i].count];
    int mark;
    TD_TRY(td_csv_int(&mark, csv, row, column[1], 0, 1000000, error));
    click->index = (size_t)mark;
    for (size_t k = 0; k < all[i].count; k++)
        if (all[i].click[k].index == click->index)
            return td_csv_fail(csv, row, column[1], error, "mark %d of %s is given twice", mark, image);
    all[i].count++;
    TD_TRY(td_csv_real(&click->pixel[0], csv, row, column[2], -1e6, 1e6, error));
    return td_csv_real(&click->pixel[1], csv, row, column[3], -1e6, 1e6, error);
}

static td_status clicks_from_csv(td_image_clicks **clicks, size_t *count, const td_csv *csv, td_error *error)
{
    static const char *const names[] = {"image", "mark", "x_px", "y_px"};
    int column[4];
    TD_TRY(need_columns(column, csv, names, 4, error));
    td_image_clicks *all = calloc(csv->rows + 1, sizeof *all);
    if (!all) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for %zu clicks", csv->name, csv->rows);
    for (size_t row = 0; row < csv->rows; row++) {
        td_status status = add_click(all, count, csv, row, column, error);
        if (status != TD_OK) {
            free(all);
            *count = 0;
            return status;
        }
    }
    *clicks = all;
    return TD_OK;
}

td_status td_clicks_parse(td_image_clicks **clicks, size_t *count, const char *text, size_t size,
                          const char *name, td_error *error)
{
    td_csv *csv;
    *clicks = NULL;
    *count = 0;
    TD_TRY(td_csv_parse(&csv, text, size, name, error));
    td_status status = clicks_from_csv(clicks, count, csv, error);
    td_csv_free(&csv);
    return status;
}

td_status td_clicks_read(td_image_clicks **clicks, size_t *count, const char *path, td_error *error)
{
    td_csv *csv;
    *clicks = NULL;
    *count = 0;
    TD_TRY(td_csv_read(&csv, path, error));
    td_status status = clicks_from_csv(clicks, count, csv, error);
    td_csv_free(&csv);
    return status;
}

/* ---- points as CSV ---- */

enum { FRAME, CAMERA, WIDTH, HEIGHT, POINT, X, Y, SIGMA, POINT_COLUMNS };
static const char *const point_columns[POINT_COLUMNS] = {"frame", "camera", "width_px", "height_px",
                                                         "point", "x_px",   "y_px",     "sigma_px"};

static size_t find_view(const td_observations *o, const char *name, size_t guess)
{
    if (guess < o->view_count && strcmp(o->view_name[guess], name) == 0) return guess;
    for (size_t v = 0; v < o->view_count; v++)
        if (strcmp(o->view_name[v], name) == 0) return v;
    return SIZE_MAX;
}

static int find_camera(const td_observations *o, const char *name)
{
    for (int c = 0; c < o->camera_count; c++)
        if (strcmp(o->camera[c].name, name) == 0) return c;
    return -1;
}

static td_status take_size(td_observed_camera *camera, const td_csv *csv, size_t row, const int *column,
                           td_error *error)
{
    int width, height;
    TD_TRY(td_csv_int(&width, csv, row, column[WIDTH], 1, 65535, error));
    TD_TRY(td_csv_int(&height, csv, row, column[HEIGHT], 1, 65535, error));
    if (!camera->width) camera->width = width, camera->height = height;
    if (camera->width != width || camera->height != height)
        return td_csv_fail(csv, row, column[WIDTH], error, "%dx%d px, but camera %s began with %dx%d", width,
                           height, camera->name, camera->width, camera->height);
    return TD_OK;
}

static td_status take_point(td_observations *o, size_t *view, const td_csv *csv, size_t row,
                            const int *column, td_error *error)
{
    *view = find_view(o, td_csv_cell(csv, row, column[FRAME]), *view);
    if (*view == SIZE_MAX)
        return td_csv_fail(csv, row, column[FRAME], error, "frames.csv has no frame '%s'",
                           td_csv_cell(csv, row, column[FRAME]));
    int camera = find_camera(o, td_csv_cell(csv, row, column[CAMERA])), point;
    if (camera < 0)
        return td_csv_fail(csv, row, column[CAMERA], error, "the dataset has no camera '%s'",
                           td_csv_cell(csv, row, column[CAMERA]));
    TD_TRY(take_size(&o->camera[camera], csv, row, column, error));
    td_detection *d = td_observations_get(o, *view, camera);
    TD_TRY(td_csv_int(&point, csv, row, column[POINT], 0, (int)d->count - 1, error));
    if (isfinite(d->point[2 * point]))
        return td_csv_fail(csv, row, column[POINT], error, "the point is given twice");
    double x, y, sigma;
    TD_TRY(td_csv_real(&x, csv, row, column[X], -1e5, 1e6, error));
    TD_TRY(td_csv_real(&y, csv, row, column[Y], -1e5, 1e6, error));
    TD_TRY(td_csv_real(&sigma, csv, row, column[SIGMA], 0, 1e4, error));
    d->point[2 * point] = x;
    d->point[2 * point + 1] = y;
    d->sigma[point] = sigma;
    return TD_OK;
}

static td_status points_from_csv(td_observations *o, const td_csv *csv, td_error *error)
{
    int column[POINT_COLUMNS];
    TD_TRY(need_columns(column, csv, point_columns, POINT_COLUMNS, error));
    size_t view = 0;
    for (size_t row = 0; row < csv->rows; row++) TD_TRY(take_point(o, &view, csv, row, column, error));
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < o->camera_count; c++) {
            td_detection *d = td_observations_get(o, v, c);
            d->found = true;
            size_t seen = td_observations_seen(o, v, c);
            d->found = seen >= 4;
            if (seen && !d->found)
                snprintf(d->reason, sizeof d->reason, "%zu points given, 4 are needed", seen);
        }
    return TD_OK;
}

td_status td_points_parse(td_observations *o, const char *text, size_t size, const char *name,
                          td_error *error)
{
    td_csv *csv;
    TD_TRY(td_csv_parse(&csv, text, size, name, error));
    td_status status = points_from_csv(o, csv, error);
    td_csv_free(&csv);
    return status;
}

td_status td_points_read(td_observations *o, const char *path, td_error *error)
{
    td_csv *csv;
    TD_TRY(td_csv_read(&csv, path, error));
    td_status status = points_from_csv(o, csv, error);
    td_csv_free(&csv);
    return status;
}

/* A cell as td_csv_parse reads it back: in quotes where the text would be taken apart, trimmed or for a
 * comment. */
static size_t write_cell(char *out, const char *text)
{
    size_t length = strlen(text), n = 0;
    bool plain =
        length && !strpbrk(text, ",\"\r\n") && !strchr("# \t", text[0]) && !strchr(" \t", text[length - 1]);
    if (!plain) out[n++] = '"';
    for (; *text; text++) {
        if (*text == '"') out[n++] = '"';
        out[n++] = *text;
    }
    if (!plain) out[n++] = '"';
    out[n] = 0;
    return n;
}

td_status td_observations_write(const td_observations *o, const char *comment, const char *path,
                                td_error *error)
{
    enum { CELL = 2 * TD_NAME_SIZE + 2, ROW = 2 * CELL + 6 * TD_NUMBER_SIZE };
    size_t points = td_target_point_count(&o->target), length = 0;
    size_t most =
        512 + (comment ? strlen(comment) : 0) + o->view_count * (size_t)o->camera_count * points * ROW;
    char *text = malloc(most), x[TD_NUMBER_SIZE], y[TD_NUMBER_SIZE], s[TD_NUMBER_SIZE];
    if (!text) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the points", path);
    if (comment) length += (size_t)snprintf(text, most, "# %.*s\n", (int)strcspn(comment, "\r\n"), comment);
    for (int i = 0; i < POINT_COLUMNS; i++)
        length += (size_t)snprintf(text + length, most - length, "%s%s", point_columns[i],
                                   i + 1 < POINT_COLUMNS ? "," : "\n");
    for (size_t v = 0; v < o->view_count; v++)
        for (int c = 0; c < o->camera_count; c++) {
            const td_detection *d = td_observations_get(o, v, c);
            for (size_t p = 0; p < points && d->found; p++) {
                if (!isfinite(d->point[2 * p]) || !isfinite(d->point[2 * p + 1])) continue;
                length += write_cell(text + length, o->view_name[v]);
                text[length++] = ',';
                length += write_cell(text + length, o->camera[c].name);
                length += (size_t)snprintf(
                    text + length, most - length, ",%d,%d,%zu,%s,%s,%s\n", o->camera[c].width,
                    o->camera[c].height, p, td_number_format(x, d->point[2 * p], 0),
                    td_number_format(y, d->point[2 * p + 1], 0), td_number_format(s, d->sigma[p], 0));
            }
        }
    td_status status = td_file_write(path, text, length, error);
    free(text);
    return status;
}

/* ---- from images ---- */

typedef struct observe_work {
    td_observations *observations;
    const td_dataset *dataset;
    const td_observe_options *options;
    td_error *error; /* (views,cameras) */
    int (*size)[2];  /* (views,cameras) of each image, 0: none */
} observe_work;

/* Those whose image is the path's end, whole names only: "01.png", or "left/01.png" where folders tell
 * cameras apart. */
static const td_image_clicks *clicks_of(const td_observe_options *options, const char *path)
{
    size_t length = strlen(path);
    for (size_t i = 0; i < options->click_count; i++) {
        const char *image = options->clicks[i].image;
        size_t n = strlen(image);
        if (n > length || strcmp(path + length - n, image) != 0) continue;
        if (n == length || path[length - n - 1] == '/') return &options->clicks[i];
    }
    return NULL;
}

static void observe_one(size_t index, void *user)
{
    observe_work *work = user;
    size_t cameras = (size_t)work->observations->camera_count, view = index / cameras;
    const char *path = work->dataset->frame[view].image[index % cameras];
    td_detection *detection = &work->observations->detection[index];
    td_error *error = &work->error[index];
    td_image *image = NULL;
    if (!path) return;
    const td_target *target = &work->observations->target;
    if (td_image_read(&image, path, 1, error) != TD_OK) return;
    work->size[index][0] = image->width;
    work->size[index][1] = image->height;
    td_detection_free(detection);
    const td_image_clicks *clicks = clicks_of(work->options, path);
    if (clicks && target->kind == TD_TARGET_MARKS)
        td_marks_detect(detection, image, target, clicks->click, clicks->count, error);
    else
        td_detect(detection, image, target, error);
    td_image_free(&image);
}

/* The first failure in the order of the views, whatever thread met it first; then sizes. */
static td_status check_images(const observe_work *work, td_error *error)
{
    td_observations *o = work->observations;
    size_t cameras = (size_t)o->camera_count;
    const char *first[TD_RIG_MAX_CAMERAS] = {0};
    for (size_t i = 0; i < o->view_count * cameras; i++) {
        const char *path = work->dataset->frame[i / cameras].image[i % cameras];
        td_observed_camera *camera = &o->camera[i % cameras];
        if (work->error[i].status != TD_OK) {
            if (error) *error = work->error[i];
            return work->error[i].status;
        }
        if (!path) continue;
        if (!first[i % cameras]) {
            first[i % cameras] = path;
            camera->width = work->size[i][0];
            camera->height = work->size[i][1];
        }
        if (camera->width != work->size[i][0] || camera->height != work->size[i][1])
            return td_fail(error, TD_ERROR_DATA,
                           "%s is %dx%d px, but camera %s began with %dx%d px (%s): all images of a camera "
                           "must be of one "
                           "size",
                           path, work->size[i][0], work->size[i][1], camera->name, camera->width,
                           camera->height, first[i % cameras]);
    }
    for (size_t c = 0; c < cameras; c++)
        if (!first[c])
            return td_fail(error, TD_ERROR_DATA, "camera %s has no image in frames.csv", o->camera[c].name);
    return TD_OK;
}

static td_status observe_images(td_observations *o, const td_dataset *dataset,
                                const td_observe_options *options, td_error *error)
{
    size_t slots = o->view_count * (size_t)o->camera_count;
    observe_work work = {o, dataset, options, calloc(slots + 1, sizeof *work.error),
                         calloc(slots + 1, sizeof *work.size)};
    td_status status;
    if (!work.error || !work.size)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu images", slots);
    else
        status = td_parallel_for(slots, options->threads, observe_one, &work, options->progress,
                                 "finding the target");
    if (status == TD_ERROR_CANCELLED) status = td_fail(error, status, "interrupted while finding the target");
    if (status == TD_OK) status = check_images(&work, error);
    free(work.error);
    free(work.size);
    return status;
}

td_status td_observe(td_observations **observations, const td_dataset *dataset,
                     const td_observe_options *options, td_error *error)
{
    const td_observe_options defaults = {0};
    if (!options) options = &defaults;
    TD_TRY(td_observations_new(observations, &dataset->target, dataset->camera_count, dataset->frame_count,
                               error));
    td_observations *o = *observations;
    for (int c = 0; c < dataset->camera_count; c++) {
        memcpy(o->camera[c].name, dataset->camera[c].name, sizeof o->camera[c].name);
        o->camera[c].model = dataset->camera[c].model;
    }
    for (size_t v = 0; v < dataset->frame_count; v++) {
        memcpy(o->view_name[v], dataset->frame[v].name, sizeof o->view_name[v]);
        o->height_m[v] = dataset->frame[v].height_m;
    }
    td_status status = dataset->corners ? td_points_read(o, dataset->corners, error)
                                        : observe_images(o, dataset, options, error);
    if (status != TD_OK) td_observations_free(observations);
    return status;
}
