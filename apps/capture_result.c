/* What is said in the end: result.yaml, --json. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/capture_internal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/source.h"

const td_schema_row capture_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "capture"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"sources", TD_SCHEMA_STRINGS, false, false, "as given"},
    {"stored_frames", TD_SCHEMA_INT, false, false, "in this run"},
    {"dataset_frames", TD_SCHEMA_INT, false, false, "in the dataset now"},
    {"adopted_frames", TD_SCHEMA_INT, false, false,
     "images of an earlier run that was killed, taken into the table"},
    {"seen_frames", TD_SCHEMA_INT, false, false, "that came, stored or not"},
    {"dropped_frames", TD_SCHEMA_INT, false, false, "moments of the wished rate at which none came"},
    {"unreadable_frames", TD_SCHEMA_INT, false, false, "files that could not be read"},
    {"rate_hz", TD_SCHEMA_REAL, false, true,
     "images a second of those seen, by their own times; null: folders"},
    {"took_s", TD_SCHEMA_REAL, false, false, "the run"},
    {"skew_mean_s", TD_SCHEMA_REAL, false, true, "between the images of a pair; null: not known"},
    {"skew_largest_s", TD_SCHEMA_REAL, false, true, "likewise"},
    {"ended_by", TD_SCHEMA_STRING, false, false, "count, duration, idle, end of source, key or signal"},
    {"cameras", TD_SCHEMA_OBJECT, false, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, ""},
    {"cameras.*.width_px", TD_SCHEMA_INT, true, false, ""},
    {"cameras.*.height_px", TD_SCHEMA_INT, true, false, ""},
    {"cameras.*.focus_mean", TD_SCHEMA_REAL, true, true, "focus measure of the images seen (see --help)"},
    {"cameras.*.focus_last", TD_SCHEMA_REAL, true, true, "of the last"},
    {"cameras.*.brightness_share", TD_SCHEMA_REAL, true, true, "mean grey, of white"},
    {"cameras.*.saturated_share", TD_SCHEMA_REAL, true, true, "of the pixels: at white"},
    {"products", TD_SCHEMA_STRINGS, false, false, "file names"},
    {"image", TD_SCHEMA_OBJECT, false, false, "--open"},
    {"image.path", TD_SCHEMA_STRING, true, false, ""},
    {"image.width_px", TD_SCHEMA_INT, true, false, ""},
    {"image.height_px", TD_SCHEMA_INT, true, false, ""},
    {"image.colour", TD_SCHEMA_BOOL, true, false, ""},
    {"image.focus", TD_SCHEMA_REAL, true, false, ""},
    {"image.brightness_share", TD_SCHEMA_REAL, true, false, ""},
    {"image.saturated_share", TD_SCHEMA_REAL, true, false, ""},
    {"devices", TD_SCHEMA_ARRAY, false, false, "--list"},
    {"devices[].path", TD_SCHEMA_STRING, true, false, ""},
    {"devices[].name", TD_SCHEMA_STRING, true, false, "as the driver calls it"},
    {"devices[].usable", TD_SCHEMA_BOOL, true, false, ""},
    {"devices[].why", TD_SCHEMA_STRING, false, false, "it is not usable"},
};
const size_t capture_schema_count = sizeof capture_schema / sizeof *capture_schema;

double capture_rate(const capture_tally *t)
{
    return t->seen > 1 && t->last_s > t->first_s ? (double)(t->seen - 1) / (t->last_s - t->first_s) : NAN;
}

static json_t *new_result(void)
{
    return json_pack("{s:s, s:s}", "job", "capture", "version", TD_VERSION);
}

static json_t *cameras_json(const capture_dataset *d, const capture_tally *t)
{
    json_t *cameras = json_object();
    for (int i = 0; i < d->cameras; i++) {
        const capture_camera *c = &t->camera[i];
        const double n = c->measured ? (double)c->measured : NAN;
        json_t *camera = json_object();
        json_object_set_new(camera, "width_px", json_integer(c->width));
        json_object_set_new(camera, "height_px", json_integer(c->height));
        json_object_set_new(camera, "focus_mean", td_json_real(c->sum.focus / n));
        json_object_set_new(camera, "focus_last", td_json_real(c->measured ? c->last.focus : NAN));
        json_object_set_new(camera, "brightness_share", td_json_real(c->sum.brightness_share / n));
        json_object_set_new(camera, "saturated_share", td_json_real(c->sum.saturated_share / n));
        json_object_set_new(cameras, d->name[i], camera);
    }
    return cameras;
}

static void set_count(json_t *root, const char *key, size_t count)
{
    json_object_set_new(root, key, json_integer((json_int_t)count));
}

json_t *capture_result(const capture_dataset *d, const capture_tally *t, const char *const *source)
{
    json_t *root = new_result(), *sources = json_array(), *products = json_array();
    for (int i = 0; i < d->cameras; i++) json_array_append_new(sources, json_string(source[i]));
    json_object_set_new(root, "sources", sources);
    set_count(root, "stored_frames", t->stored);
    set_count(root, "dataset_frames", d->found + d->adopted + t->stored);
    set_count(root, "adopted_frames", d->adopted);
    set_count(root, "seen_frames", t->seen);
    set_count(root, "dropped_frames", t->dropped);
    set_count(root, "unreadable_frames", t->unreadable);
    json_object_set_new(root, "rate_hz", td_json_real(capture_rate(t)));
    json_object_set_new(root, "took_s", td_json_real(t->ended_s - t->begun_s));
    json_object_set_new(root, "skew_mean_s", td_json_real(t->skews ? t->skew_sum_s / (double)t->skews : NAN));
    json_object_set_new(root, "skew_largest_s", td_json_real(t->skews ? t->skew_largest_s : NAN));
    json_object_set_new(root, "ended_by", json_string(t->ended_by));
    json_object_set_new(root, "cameras", cameras_json(d, t));
    json_array_append_new(products, json_string("dataset.yaml"));
    json_array_append_new(products, json_string("frames.csv"));
    for (int i = 0; i < d->cameras; i++) json_array_append_new(products, json_string(d->name[i]));
    json_object_set_new(root, "products", products);
    return root;
}

json_t *capture_result_open(const char *path, const td_image *image, const capture_measure *m)
{
    json_t *root = new_result(), *o = json_object();
    json_object_set_new(o, "path", json_string(path));
    json_object_set_new(o, "width_px", json_integer(image->width));
    json_object_set_new(o, "height_px", json_integer(image->height));
    json_object_set_new(o, "colour", json_boolean(image->channels == 3));
    json_object_set_new(o, "focus", td_json_real(m->focus));
    json_object_set_new(o, "brightness_share", td_json_real(m->brightness_share));
    json_object_set_new(o, "saturated_share", td_json_real(m->saturated_share));
    json_object_set_new(root, "image", o);
    return root;
}

json_t *capture_result_list(void)
{
    enum { MOST = 64 };
    td_camera_device device[MOST];
    const size_t count = td_camera_devices(device, MOST);
    json_t *root = new_result(), *devices = json_array();
    for (size_t i = 0; i < count && i < MOST; i++) {
        json_t *o = json_object(), *name = json_string(device[i].name);
        json_object_set_new(o, "path", json_string(device[i].path));
        json_object_set_new(o, "name", name ? name : json_string("?"));
        json_object_set_new(o, "usable", json_boolean(device[i].usable));
        if (!device[i].usable) json_object_set_new(o, "why", json_string(device[i].why));
        json_array_append_new(devices, o);
    }
    json_object_set_new(root, "devices", devices);
    return root;
}

td_status capture_result_put(const json_t *result, const char *path, bool print, td_error *error)
{
    char *yaml = NULL, *text = NULL;
    td_status status = td_schema_check(result, capture_schema, capture_schema_count, error);
    if (status == TD_OK && path) status = td_document_to_yaml(&yaml, result, 15, error);
    if (status == TD_OK && path) status = td_file_write(path, yaml, strlen(yaml), error);
    if (status == TD_OK && print) status = td_document_to_json(&text, result, 15, error);
    if (status == TD_OK && text) fputs(text, stdout);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    free(yaml);
    free(text);
    return status;
}
