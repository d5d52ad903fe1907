/* Marks in pictures, numbered by clicks where a person must say which is which; what the views cover and
 * which one is missing; and the solve, by the command itself, so that its figures are the command's. */
#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "apps/cli.h"
#include "apps/workbench_internal.h"
#include "calib/coverage.h"
#include "calib/next_view.h"
#include "core/file.h"

static const workbench_open_place *open_of(const workbench *w)
{
    return w->open + WORKBENCH_CALIBRATE;
}

static td_status need_target(const workbench *w, td_error *error)
{
    if (!open_of(w)->place) return td_fail(error, TD_ERROR_ARGUMENT, "no bench is open: OpenBench first");
    if (open_of(w)->has_target) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "%s: its dataset.yaml does not say what target is seen, so there is nothing to find",
                   open_of(w)->place->name);
}

static workbench_view *view_of(const workbench *w, size_t frame, int camera)
{
    return w->view + frame * (size_t)open_of(w)->dataset->camera_count + (size_t)camera;
}

/* ---- marks ---- */

static td_status read_click(td_click *click, const td_field *item, const td_image *image, size_t points,
                            td_error *error)
{
    static const char *const keys[] = {"mark", "x", "y", NULL};
    const td_field mark = td_field_get(item, "mark"), x = td_field_get(item, "x"),
                   y = td_field_get(item, "y");
    int index = 0;
    TD_TRY(td_field_check_keys(item, keys, error));
    TD_TRY(td_field_int(&index, &mark, 0, (int)points - 1, error));
    click->index = (size_t)index;
    TD_TRY(td_field_real(&click->pixel[0], &x, -0.5, image->width - 0.5, error));
    return td_field_real(&click->pixel[1], &y, -0.5, image->height - 0.5, error);
}

static td_status read_clicks(td_click click[TD_MAX_CLICKS], size_t *count, const td_field *a,
                             const workbench *w, const td_image *image, td_error *error)
{
    const td_field list = td_field_get(a, "clicks");
    const td_target *target = &open_of(w)->dataset->target;
    *count = 0;
    if (!list.value) return TD_OK;
    TD_TRY(td_field_count(count, &list, 0, TD_MAX_CLICKS, error));
    if (*count && target->kind != TD_TARGET_MARKS)
        return td_field_fail(&list, error, "only marks are numbered by clicks; this target is a %s",
                             td_target_kind_name(target->kind));
    for (size_t i = 0; i < *count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field item = td_field_at(&list, i, index);
        TD_TRY(read_click(click + i, &item, image, td_target_point_count(target), error));
    }
    return TD_OK;
}

static json_t *view_json(const workbench_view *v)
{
    const td_detection *d = &v->detection;
    json_t *points = json_array(), *sigma = json_array(), *clicks = json_array();
    size_t seen = 0;
    for (size_t i = 0; i < d->count; i++) {
        const bool there = isfinite(d->point[2 * i]);
        seen += there;
        json_array_append_new(points, there ? td_json_reals(d->point + 2 * i, 2) : json_null());
        json_array_append_new(sigma, td_json_real(there ? d->sigma[i] : NAN));
    }
    for (size_t i = 0; i < v->clicks; i++)
        json_array_append_new(clicks, json_pack("{s:I, s:f, s:f}", "mark", (json_int_t)v->click[i].index, "x",
                                                v->click[i].pixel[0], "y", v->click[i].pixel[1]));
    return json_pack("{s:b, s:s, s:I, s:o, s:o, s:o}", "found", d->found, "reason", d->reason, "seen",
                     (json_int_t)seen, "points", points, "sigma_px", sigma, "clicks", clicks);
}

/* All images of a camera are of one size; the dataset's calibration would refuse others. */
static td_status check_size(workbench *w, int camera, const td_image *image, const char *path,
                            td_error *error)
{
    if (!w->width[camera]) w->width[camera] = image->width, w->height[camera] = image->height;
    if (w->width[camera] == image->width && w->height[camera] == image->height) return TD_OK;
    return td_fail(error, TD_ERROR_DATA, "%s: is of %d x %d px, another image of camera %s of %d x %d px",
                   path, image->width, image->height, open_of(w)->dataset->camera[camera].name,
                   w->width[camera], w->height[camera]);
}

static td_status look(workbench *w, size_t frame, int camera, const td_image *image, const td_click *click,
                      size_t clicks, td_error *error)
{
    workbench_view *v = view_of(w, frame, camera);
    td_detection seen = {0};
    const td_status status =
        clicks ? td_marks_detect(&seen, image, &open_of(w)->dataset->target, click, clicks, error)
               : td_detect(&seen, image, &open_of(w)->dataset->target, error);
    if (status != TD_OK) {
        td_detection_free(&seen);
        return status;
    }
    td_detection_free(&v->detection);
    v->detection = seen;
    v->looked = true;
    v->clicks = seen.found ? clicks : 0; /* what numbers nothing is not kept */
    memcpy(v->click, click, clicks * sizeof *click);
    return TD_OK;
}

td_status workbench_marks(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    size_t frame, clicks = 0;
    int camera;
    const char *path;
    td_click click[TD_MAX_CLICKS] = {{0}};
    td_image *image = NULL;
    TD_TRY(need_target(w, error));
    TD_TRY(workbench_image(&frame, &camera, &path, open_of(w), a, error));
    TD_TRY(td_image_read(&image, path, 1, error));
    td_status status = check_size(w, camera, image, path, error);
    if (status == TD_OK) status = read_clicks(click, &clicks, a, w, image, error);
    if (status == TD_OK) status = look(w, frame, camera, image, click, clicks, error);
    td_image_free(&image);
    if (status == TD_OK) *answer = view_json(view_of(w, frame, camera));
    return status;
}

/* ---- coverage, and what is wished for ---- */

static td_status look_at_rest(workbench *w, td_error *error)
{
    const td_dataset *d = open_of(w)->dataset;
    for (size_t f = 0; f < d->frame_count; f++)
        for (int c = 0; c < d->camera_count; c++) {
            td_image *image = NULL;
            if (view_of(w, f, c)->looked || !d->frame[f].image[c]) continue;
            TD_TRY(td_image_read(&image, d->frame[f].image[c], 1, error));
            td_status status = check_size(w, c, image, d->frame[f].image[c], error);
            if (status == TD_OK) status = look(w, f, c, image, view_of(w, f, c)->click, 0, error);
            td_image_free(&image);
            TD_TRY(status);
        }
    return TD_OK;
}

static td_status gather(td_observations **made, const workbench *w, td_error *error)
{
    const td_dataset *d = open_of(w)->dataset;
    TD_TRY(td_observations_new(made, &d->target, d->camera_count, d->frame_count, error));
    td_observations *o = *made;
    for (int c = 0; c < d->camera_count; c++) {
        snprintf(o->camera[c].name, sizeof o->camera[c].name, "%s", d->camera[c].name);
        o->camera[c].model = d->camera[c].model;
        o->camera[c].width = w->width[c];
        o->camera[c].height = w->height[c];
    }
    for (size_t f = 0; f < d->frame_count; f++) {
        snprintf(o->view_name[f], sizeof o->view_name[f], "%s", d->frame[f].name);
        o->height_m[f] = d->frame[f].height_m;
        for (int c = 0; c < d->camera_count; c++) td_observations_set(o, f, c, &view_of(w, f, c)->detection);
    }
    return TD_OK;
}

static json_t *coverage_json(const td_dataset *d, int camera, const td_calibration *k,
                             const td_observations *o)
{
    td_coverage v;
    json_t *cells = json_array();
    td_coverage_measure(&v, camera, k, o);
    for (int i = 0; i < TD_COVERAGE_ROWS * TD_COVERAGE_COLUMNS; i++)
        json_array_append_new(cells, json_integer((json_int_t)v.points[i]));
    return json_pack("{s:s, s:I, s:i, s:i, s:i, s:i, s:o, s:o, s:o, s:o, s:o, s:s}", "camera",
                     d->camera[camera].name, "views", (json_int_t)v.views, "width", o->camera[camera].width,
                     "height", o->camera[camera].height, "columns", TD_COVERAGE_COLUMNS, "rows",
                     TD_COVERAGE_ROWS, "cells", cells, "image_share", td_json_real(v.image_share),
                     "nearest_m", td_json_real(v.nearest_m), "farthest_m", td_json_real(v.farthest_m),
                     "tilt_rad", td_json_real(v.tilt_rad), "missing", v.missing);
}

static json_t *wish_json(const td_dataset *d, const td_calibration *k, const td_observations *o)
{
    td_next_view n;
    if (td_next_view_find(&n, k, o, NULL, NULL) != TD_OK) return json_null();
    return json_pack("{s:s, s:s, s:o, s:b, s:o, s:o}", "camera", d->camera[n.camera].name, "text", n.text,
                     "outline", td_json_matrix(n.outline, 4, 2), "enough", n.enough, "sigma_px",
                     td_json_real(n.sigma_px), "predicted_px", td_json_real(n.predicted_px));
}

static json_t *views_json(const workbench *w)
{
    const td_dataset *d = open_of(w)->dataset;
    json_t *list = json_array();
    for (size_t f = 0; f < d->frame_count; f++)
        for (int c = 0; c < d->camera_count; c++) {
            const workbench_view *v = view_of(w, f, c);
            if (!d->frame[f].image[c]) continue;
            json_array_append_new(list,
                                  json_pack("{s:s, s:s, s:b, s:s, s:I}", "frame", d->frame[f].name, "camera",
                                            d->camera[c].name, "found", v->detection.found, "reason",
                                            v->detection.reason, "clicks", (json_int_t)v->clicks));
        }
    return list;
}

static json_t *coverage_answer(const workbench *w, const td_observations *o, const td_calibration *k,
                               const char *trouble)
{
    const td_dataset *d = open_of(w)->dataset;
    json_t *cameras = json_array();
    for (int c = 0; c < d->camera_count; c++) json_array_append_new(cameras, coverage_json(d, c, k, o));
    return json_pack("{s:o, s:o, s:o, s:o, s:s}", "cameras", cameras, "views", views_json(w), "next",
                     wish_json(d, k, o), "rms_px", td_json_real(k ? k->rms_px : NAN), "trouble", trouble);
}

td_status workbench_coverage(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    (void)a;
    td_observations *o = NULL;
    td_calibration *k = NULL;
    td_error trouble = {0};
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    options.threads = 1;
    TD_TRY(need_target(w, error));
    TD_TRY(look_at_rest(w, error));
    td_status status = gather(&o, w, error);
    if (status == TD_OK) {
        (void)td_calibrate(&k, o, &options, &trouble); /* too few views yet: told */
        *answer = coverage_answer(w, o, k, trouble.message);
    }
    td_calibration_free(&k);
    td_observations_free(&o);
    return status;
}

/* ---- the solve ---- */

static td_status write_clicks(const workbench *w, const char *path, size_t *count, td_error *error)
{
    const td_dataset *d = open_of(w)->dataset;
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    *count = 0;
    if (!out) return td_fail(error, TD_ERROR_MEMORY, "no memory for clicks");
    fputs("image,mark,x_px,y_px\n", out);
    for (size_t f = 0; f < d->frame_count; f++)
        for (int c = 0; c < d->camera_count; c++) {
            const workbench_view *v = view_of(w, f, c);
            for (size_t i = 0; i < v->clicks; i++, ++*count)
                fprintf(out, "%s,%zu,%.3f,%.3f\n", d->frame[f].image[c], v->click[i].index,
                        v->click[i].pixel[0], v->click[i].pixel[1]);
        }
    const td_status status = fclose(out) == 0 ? td_file_write(path, text, size, error)
                                              : td_fail(error, TD_ERROR_MEMORY, "no memory for clicks");
    free(text);
    return status;
}

static void become(const char *program, char *const argv[], int out, int err)
{
    (void)prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (dup2(out, STDOUT_FILENO) < 0 || dup2(err, STDERR_FILENO) < 0) _exit(127);
    for (int fd = 3; fd < 64; fd++) close(fd);
    execv(program, argv);
    _exit(127);
}

/* What a program says on standard output, and its last words on standard error. */
static td_status run_program(char **said, size_t *size, int *code, char last[400], const char *program,
                             char *const argv[], td_error *error)
{
    FILE *err = tmpfile();
    int ends[2], status = -1;
    char piece[4096];
    if (!err || pipe(ends) != 0) {
        if (err) fclose(err);
        return td_fail(error, TD_ERROR_IO, "a pipe: %s", strerror(errno));
    }
    fflush(NULL);
    const pid_t child = fork();
    if (child == 0) become(program, argv, ends[1], fileno(err));
    close(ends[1]);
    FILE *out = open_memstream(said, size);
    for (ssize_t n;
         child > 0 && out && ((n = read(ends[0], piece, sizeof piece)) > 0 || (n < 0 && errno == EINTR));)
        if (n > 0) fwrite(piece, 1, (size_t)n, out);
    close(ends[0]);
    while (child > 0 && waitpid(child, &status, 0) < 0 && errno == EINTR) continue;
    const bool fine = out && fclose(out) == 0 && child > 0;
    last[0] = 0;
    rewind(err);
    while (fgets(last, 400, err)) continue;
    last[strcspn(last, "\n")] = 0;
    fclose(err);
    *code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    return fine ? TD_OK : td_fail(error, TD_ERROR_EXTERNAL, "%s cannot be run", program);
}

/* Of the command's result, what a person at the bench looks at. */
static td_status pick_result(json_t **answer, const char *text, size_t size, const char *folder,
                             td_error *error)
{
    static const char *const keys[] = {"verdict", "reasons",       "rms_px",          "cameras",
                                       "stereo",  "leave_one_out", "weak_directions", "outlier_views"};
    json_t *result = json_loadb(text, size, 0, NULL);
    if (!json_is_object(result)) {
        json_decref(result);
        return td_fail(error, TD_ERROR_EXTERNAL, "the calibration's result cannot be read");
    }
    *answer = json_pack("{s:s}", "folder", folder);
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++)
        if (json_object_get(result, keys[i]))
            json_object_set(*answer, keys[i], json_object_get(result, keys[i]));
    json_decref(result);
    return TD_OK;
}

static td_status solve(json_t **answer, const workbench *w, const char *name, char *folder, char *clicks,
                       td_error *error)
{
    char *program = td_path_join(w->self, "calibrate"), *said = NULL, last[400],
         *dataset = strdup(open_of(w)->place->path);
    size_t count = 0, size = 0;
    int code = 0;
    td_status status =
        program && dataset ? td_folder_make(folder, error) : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = write_clicks(w, clicks, &count, error);
    char *argv[] = {(char[]){"calibrate"},
                    dataset,
                    (char[]){"-o"},
                    folder,
                    (char[]){"--json"},
                    (char[]){"--quiet"},
                    count ? (char[]){"--clicks"} : NULL,
                    clicks,
                    NULL};
    if (status == TD_OK) status = run_program(&said, &size, &code, last, program, argv, error);
    if (status == TD_OK && code != EXIT_DONE && code != EXIT_REFUSED) {
        static const char ours[] = "teledimos calibrate: ";
        const char *words = strncmp(last, ours, sizeof ours - 1) == 0 ? last + sizeof ours - 1 : last;
        status = td_fail(error, TD_ERROR_DATA, "%s", *words ? words : "the calibration was ended");
    }
    if (status == TD_OK) status = pick_result(answer, said, size, name, error);
    free(program);
    free(dataset);
    free(said);
    return status;
}

td_status workbench_calibrate(json_t **answer, workbench *w, const td_field *a, td_error *error)
{
    char name[TD_NAME_SIZE + 16], *folder = NULL, *clicks = NULL;
    (void)a;
    TD_TRY(need_target(w, error));
    snprintf(name, sizeof name, "calibrated/%s", open_of(w)->place->name);
    TD_TRY(workbench_folder(&folder, w->output, name, error));
    td_status status = workbench_folder(&clicks, folder, "clicks.csv", error);
    if (status == TD_OK) status = solve(answer, w, name, folder, clicks, error);
    free(folder);
    free(clicks);
    return status;
}
