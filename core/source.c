#include "core/source.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <time.h>

#include "core/file.h"
#include "core/source_internal.h"

td_source_options td_source_options_default(void)
{
    return (td_source_options){.channels = 1};
}

/* ---- small helpers ---- */

double td_monotonic_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void td_pause_s(double seconds)
{
    if (!(seconds > 0)) return;
    const time_t whole = (time_t)seconds;
    struct timespec pause = {whole, (long)((seconds - (double)whole) * 1e9)};
    nanosleep(&pause, NULL);
}

static size_t digits_of(const char *text)
{
    size_t n = 0;
    while (isdigit((unsigned char)text[n])) n++;
    return n;
}

int td_natural_compare(const char *a, const char *b)
{
    const char *x = a, *y = b;
    while (*x && *y) {
        size_t m = digits_of(x), n = digits_of(y);
        if (m && n) {
            for (; m > 1 && *x == '0'; m--) x++;
            for (; n > 1 && *y == '0'; n--) y++;
            if (m != n) return m < n ? -1 : 1;
            const int order = memcmp(x, y, m);
            if (order) return order;
            x += m;
            y += n;
        } else {
            if (*x != *y) return (unsigned char)*x < (unsigned char)*y ? -1 : 1;
            x++;
            y++;
        }
    }
    if (*x || *y) return *x ? 1 : -1;
    return strcmp(a, b);
}

bool td_is_image_name(const char *name)
{
    static const char *const endings[] = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", NULL};
    const char *dot = strrchr(name, '.');
    for (int i = 0; dot && endings[i]; i++)
        if (!strcasecmp(dot, endings[i])) return true;
    return false;
}

/* ---- opening ---- */

static td_status check_options(const td_source_options *o, td_error *error)
{
    if (o->channels != 1 && o->channels != 3)
        return td_fail(error, TD_ERROR_ARGUMENT, "channels: is %d, but must be 1 or 3", o->channels);
    if (o->width < 0 || o->height < 0 || o->width > 65535 || o->height > 65535 ||
        (o->width == 0) != (o->height == 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "width and height: are %d and %d, but must be 1 to 65535, or both 0", o->width,
                       o->height);
    if (!(o->rate_hz >= 0 && o->rate_hz <= 1e4))
        return td_fail(error, TD_ERROR_ARGUMENT, "rate_hz: is %g, but must lie between 0 and 10000",
                       o->rate_hz);
    return TD_OK;
}

/* "DIR/left*.png": the images of a folder whose names match. */
static td_status open_pattern(td_source *source, const char *where, const td_source_options *o,
                              td_error *error)
{
    char *folder = td_path_folder(where);
    const char *slash = strrchr(where, '/');
    if (!folder) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its name", where);
    td_status status = td_folder_open(source, folder, slash ? slash + 1 : where, o->channels, error);
    free(folder);
    return status;
}

static bool has_wildcard(const char *where)
{
    const char *slash = strrchr(where, '/');
    return strpbrk(slash ? slash + 1 : where, "*?[") != NULL;
}

static td_status open_folder(td_source *source, const char *where, const td_source_options *o,
                             td_error *error)
{
    struct stat seen;
    if (!o->pattern && has_wildcard(where) && stat(where, &seen) != 0)
        return open_pattern(source, where, o, error);
    return td_folder_open(source, where, o->pattern, o->channels, error);
}

static td_status open_by_kind(td_source *source, const char *where, const td_source_options *o,
                              td_error *error)
{
    struct stat seen;
    if (!strncmp(where, "folder:", 7)) return open_folder(source, where + 7, o, error);
    if (!strncmp(where, "camera:", 7)) {
        char path[64];
        TD_TRY(td_camera_find(path, where + 7, error));
        return td_camera_open(source, path, o, error);
    }
    if (!strncmp(where, "/dev/video", 10)) return td_camera_open(source, where, o, error);
    if (stat(where, &seen) != 0) {
        if (errno == ENOENT && has_wildcard(where)) return open_folder(source, where, o, error);
        return td_fail(error, TD_ERROR_IO,
                       "%s: %s; a source is a folder, a video file, /dev/video0 or camera:NAME", where,
                       errno == ENOENT ? "there is no such folder, file or device" : strerror(errno));
    }
    if (S_ISDIR(seen.st_mode)) return open_folder(source, where, o, error);
    if (S_ISCHR(seen.st_mode)) return td_camera_open(source, where, o, error);
    if (!S_ISREG(seen.st_mode))
        return td_fail(error, TD_ERROR_IO,
                       "%s: is a pipe or socket; a source is a folder, a video file or a camera", where);
    if (td_is_image_name(where))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: is a single image; give the folder it lies in", where);
    return td_video_open(source, where, o, error);
}

td_status td_source_open(td_source **source, const char *where, const td_source_options *options,
                         td_error *error)
{
    const td_source_options usual = td_source_options_default(), *o = options ? options : &usual;
    *source = NULL;
    if (!where || !*where) return td_fail(error, TD_ERROR_ARGUMENT, "the name of a source is empty");
    TD_TRY(check_options(o, error));
    td_source *made = calloc(1, sizeof *made);
    if (made) made->where = strdup(where);
    td_status status = made && made->where ? open_by_kind(made, where, o, error)
                                           : td_fail(error, TD_ERROR_MEMORY, "no memory for a source");
    if (status != TD_OK) {
        td_source_free(&made);
        return status;
    }
    made->rate_hz = made->kind == TD_SOURCE_FOLDER ? 0 : o->rate_hz;
    made->due_s = NAN;
    *source = made;
    return TD_OK;
}

void td_source_free(td_source **source)
{
    if (!source || !*source) return;
    if ((*source)->driver) (*source)->driver->free((*source)->state);
    free((*source)->where);
    free(*source);
    *source = NULL;
}

td_source_kind td_source_kind_of(const td_source *source)
{
    return source->kind;
}

double td_source_period_s(const td_source *source)
{
    return source->period_s;
}

/* ---- taking pictures ---- */

/* The next picture, whatever its time; it is held. */
static td_status grab_any(td_source *s, double wait_s, td_error *error)
{
    bool got = false;
    s->grabbed = false;
    if (s->ended) return TD_OK;
    TD_TRY(s->driver->grab(&got, &s->ended, &s->time_s, s->state, wait_s, error));
    s->grabbed = got;
    return TD_OK;
}

/* The next picture that is due by the wished rate: the one nearest to its moment. */
static td_status grab_due(td_source *s, double until_s, td_error *error)
{
    while (!s->grabbed && !s->ended) {
        TD_TRY(grab_any(s, fmax(0, until_s - td_monotonic_s()), error));
        if (!s->grabbed) return TD_OK;
        if (s->owed > 0) {
            s->owed--;
            s->grabbed = false;
            continue;
        }
        if (s->rate_hz <= 0) return TD_OK;
        if (isnan(s->due_s)) s->due_s = s->time_s;
        if (s->time_s < s->due_s - s->period_s / 2 - 1e-6) s->grabbed = false;
    }
    return TD_OK;
}

/* Sets the moment of the next picture: on the same raster, beyond this one. */
static void move_due(td_source *s)
{
    if (s->rate_hz <= 0 || isnan(s->due_s)) return;
    const double period = 1 / s->rate_hz;
    const double passed = floor((s->time_s + s->period_s / 2 - s->due_s) / period + 1e-6);
    s->due_s += period * (fmax(passed, 0) + 1);
}

static td_status retrieve(td_frame *frame, td_source *s, td_error *error)
{
    *frame = (td_frame){.time_s = s->time_s, .number = s->number};
    s->grabbed = false;
    move_due(s);
    TD_TRY(s->driver->retrieve(&frame->image, frame->name, s->state, error));
    if (!frame->name[0]) snprintf(frame->name, sizeof frame->name, "%06ld", s->number);
    s->number++;
    return TD_OK;
}

td_status td_source_next(td_frame *frame, bool *got, bool *ended, td_source *source, double wait_s,
                         td_error *error)
{
    double skew;
    return td_source_next_together(frame, got, ended, &skew, &source, 1, wait_s, error);
}

/* The picture of source `failed` cannot be read: those that belong to it are dropped, now or when they come.
 */
static td_status drop_partners(td_source *const *source, int count, int failed, td_status status)
{
    for (int i = 0; i < count; i++) {
        if (i == failed || source[i]->kind != TD_SOURCE_FOLDER) continue;
        if (source[i]->grabbed)
            source[i]->grabbed = false;
        else
            source[i]->owed++;
    }
    return status;
}

static bool all_grabbed(td_source *const *source, int count)
{
    for (int i = 0; i < count; i++)
        if (!source[i]->grabbed) return false;
    return true;
}

/* Moves those that lie more than half their period behind the latest on by single pictures: the next is
 * nearer. */
static td_status align(td_source *const *source, int count, double until_s, td_error *error)
{
    for (bool moved = true; moved;) {
        double latest = -INFINITY;
        moved = false;
        for (int i = 0; i < count; i++) latest = fmax(latest, source[i]->time_s);
        for (int i = 0; i < count; i++) {
            td_source *s = source[i];
            if (!(s->time_s < latest - s->period_s / 2 - 1e-6) || s->period_s <= 0) continue;
            TD_TRY(grab_any(s, fmax(0, until_s - td_monotonic_s()), error));
            if (!s->grabbed) return TD_OK;
            moved = true;
        }
    }
    return TD_OK;
}

static double skew_of(td_source *const *source, int count)
{
    double low = INFINITY, high = -INFINITY;
    if (source[0]->kind == TD_SOURCE_FOLDER) return NAN;
    for (int i = 0; i < count; i++) {
        low = fmin(low, source[i]->time_s);
        high = fmax(high, source[i]->time_s);
    }
    return high - low;
}

/* Waits until folders have files that belong together. A pair that is begun is left as it is. */
static td_status align_folders(bool *aligned, td_source *const *source, int count, double until_s,
                               td_error *error)
{
    *aligned = false;
    for (int i = 0; i < count; i++) *aligned |= source[i]->grabbed || source[i]->owed > 0;
    while (!*aligned) {
        td_status status = td_folders_align(aligned, source, count, error);
        for (int i = 0; i < count && status != TD_OK; i++) source[i]->ended = true;
        if (status != TD_OK || *aligned || td_monotonic_s() >= until_s) return status;
        td_pause_s(0.02);
    }
    return TD_OK;
}

td_status td_source_next_together(td_frame *frame, bool *got, bool *ended, double *skew_s,
                                  td_source *const *source, int count, double wait_s, td_error *error)
{
    const double until_s = td_monotonic_s() + fmax(wait_s, 0);
    *got = *ended = false;
    *skew_s = NAN;
    for (int i = 0; i < count; i++) frame[i] = (td_frame){0};
    for (int i = 1; i < count; i++)
        if (source[i]->kind != source[0]->kind)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "%s and %s: are of different kinds; take two folders, two videos or two cameras",
                           source[0]->where, source[i]->where);
    if (count > 1 && source[0]->kind == TD_SOURCE_FOLDER) {
        bool aligned;
        TD_TRY(align_folders(&aligned, source, count, until_s, error));
        if (!aligned) return TD_OK;
    }
    for (int i = 0; i < count; i++) {
        td_status status = grab_due(source[i], until_s, error);
        if (status != TD_OK) return drop_partners(source, count, i, status);
    }
    if (count > 1 && all_grabbed(source, count) && source[0]->kind != TD_SOURCE_FOLDER)
        TD_TRY(align(source, count, until_s, error));
    for (int i = 0; i < count; i++)
        if (source[i]->ended) *ended = true;
    if (!all_grabbed(source, count)) return TD_OK;
    *ended = false;
    *skew_s = skew_of(source, count);
    /* All are taken from their sources even when one fails, so that pairs stay pairs. */
    td_status status = TD_OK;
    for (int i = 0; i < count; i++) {
        td_status one = retrieve(frame + i, source[i], status == TD_OK ? error : NULL);
        if (status == TD_OK) status = one;
    }
    for (int i = 0; status != TD_OK && i < count; i++) td_image_free(&frame[i].image);
    *got = status == TD_OK;
    return status;
}
