/* A live source, or a pair of them: some ten pictures a second go out as JPEG, with focus and skew; frozen
 * and stored when asked for. Cameras go on while frozen, so that the next picture is a fresh one; videos and
 * folders wait. At the end of a video or folder its last picture stays. */
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "apps/capture_internal.h"
#include "apps/terminal.h"
#include "apps/workbench_internal.h"
#include "core/foxglove.h"
#include "core/source.h"
#include "core/target_words.h"

enum { QUALITY = 80, MOST_WIDTH = 1600 };
static const double WAIT_S = 0.05, STATE_S = 0.5;

static const char *const side_names[] = {"left", "right"};

typedef struct acquisition {
    const workbench_source *o;
    td_source *source[2];
    capture_dataset dataset;
    td_image *image[2]; /* shown; NULL: none yet */
    char name[2][256];
    capture_measure measure[2];
    double best_focus[2], skew_s;
    double time_s, clock_offset_s; /* of the picture; since 1970, less the monotonic clock */
    double taken_s, told_s;        /* by the monotonic clock */
    long seen, stored;
    bool frozen, is_stored, ended, closed; /* closed: whoever asks is gone */
    char trouble[300];                     /* of the last picture; "" */
    char line[WORKBENCH_LINE];
    size_t line_size;
} acquisition;

/* ---- out ---- */

static void tell_state(acquisition *q)
{
    json_t *focus = json_array(), *best = json_array(), *white = json_array(), *names = json_array();
    for (int k = 0; k < q->o->count && q->image[0]; k++) {
        json_array_append_new(focus, td_json_real(q->measure[k].focus));
        json_array_append_new(best, td_json_real(q->best_focus[k]));
        json_array_append_new(white, td_json_real(q->measure[k].saturated_share));
        json_array_append_new(names, json_string(q->name[k]));
    }
    json_t *state =
        json_pack("{s:i, s:I, s:b, s:b, s:I, s:b, s:o, s:o, s:o, s:o, s:o, s:s}", "cameras", q->o->count,
                  "seen", (json_int_t)q->seen, "frozen", q->frozen, "is_stored", q->is_stored, "stored",
                  (json_int_t)(q->stored + (long)(q->dataset.found + q->dataset.adopted)), "ended", q->ended,
                  "focus", focus, "best_focus", best, "saturated_share", white, "names", names, "skew_s",
                  td_json_real(q->skew_s), "trouble", q->trouble);
    char *text = state ? json_dumps(state, JSON_COMPACT | JSON_REAL_PRECISION(6)) : NULL;
    json_decref(state);
    if (text) workbench_message("state", text, strlen(text));
    free(text);
    q->told_s = terminal_now_s();
}

/* A wide picture goes out smaller: it is for the eye, what is stored is whole. */
static void send_picture(const acquisition *q, int side)
{
    td_image *small = NULL;
    const td_image *image = q->image[side];
    uint8_t *jpeg = NULL;
    char *json = NULL;
    size_t jpeg_size = 0, size = 0;
    int times = 0;
    while (image->width >> times > MOST_WIDTH) times++;
    if (times && td_image_shrink(&small, image, times, NULL) == TD_OK) image = small;
    const double time_s = fmax(q->time_s + q->clock_offset_s, 0);
    if (td_image_encode_jpeg(&jpeg, &jpeg_size, image, QUALITY, NULL) == TD_OK &&
        td_foxglove_image(&json, &size, jpeg, jpeg_size, "jpeg", side_names[side], (uint64_t)(1e9 * time_s),
                          NULL) == TD_OK)
        workbench_message(side_names[side], json, size);
    free(json);
    free(jpeg);
    td_image_free(&small);
}

static void show(acquisition *q)
{
    for (int k = 0; k < q->o->count; k++) send_picture(q, k);
    tell_state(q);
}

/* ---- requests ---- */

static td_status freeze(acquisition *q, const td_field *a, td_error *error)
{
    const td_field on = td_field_get(a, "on");
    bool frozen = !q->frozen;
    if (on.value) TD_TRY(td_field_bool(&frozen, &on, error));
    if (frozen && !q->image[0]) return td_fail(error, TD_ERROR_NOT_FOUND, "no picture has come yet");
    q->frozen = frozen;
    return TD_OK;
}

static td_status store(acquisition *q, td_error *error)
{
    if (!q->image[0]) return td_fail(error, TD_ERROR_NOT_FOUND, "no picture has come yet");
    if (q->is_stored) return td_fail(error, TD_ERROR_ARGUMENT, "this picture is stored already");
    TD_TRY(capture_dataset_add(&q->dataset, q->image, q->time_s + q->clock_offset_s, error));
    TD_TRY(capture_dataset_flush(&q->dataset, true, error));
    q->stored++;
    q->is_stored = true;
    return TD_OK;
}

static td_status do_request(acquisition *q, const json_t *request, json_t **answer, td_error *error)
{
    const char *op = json_string_value(json_object_get(request, "op"));
    const td_field a = {NULL, op ? op : "request", request};
    if (op && strcmp(op, "Freeze") == 0) {
        TD_TRY(freeze(q, &a, error));
        *answer = json_pack("{s:b}", "frozen", q->frozen);
    } else if (op && strcmp(op, "Store") == 0) {
        char number[24];
        snprintf(number, sizeof number, "%06ld", q->dataset.next);
        TD_TRY(store(q, error));
        *answer = json_pack("{s:s, s:s, s:I}", "folder", "acquired", "frame", number, "stored",
                            (json_int_t)(q->stored + (long)(q->dataset.found + q->dataset.adopted)));
    } else {
        return td_fail(error, TD_ERROR_ARGUMENT, "there is no operation '%.40s'", op ? op : "");
    }
    return TD_OK;
}

static void take_line(acquisition *q, const char *line, size_t size)
{
    td_error error = {0};
    json_t *answer = NULL, *request = json_loadb(line, size, JSON_REJECT_DUPLICATES, NULL);
    const json_int_t id = json_integer_value(json_object_get(request, "id"));
    if (do_request(q, request, &answer, &error) == TD_OK)
        workbench_answer(id, answer);
    else
        workbench_fail(id, &error);
    json_decref(request);
    tell_state(q);
}

/* What has come on standard input; never waits. */
static void take_requests(acquisition *q)
{
    struct pollfd in = {STDIN_FILENO, POLLIN, 0};
    while (!q->closed && poll(&in, 1, 0) > 0) {
        const ssize_t n = read(STDIN_FILENO, q->line + q->line_size, sizeof q->line - q->line_size);
        if (n <= 0) q->closed = true;
        if (n > 0) q->line_size += (size_t)n;
        for (char *end; (end = memchr(q->line, '\n', q->line_size));) {
            const size_t size = (size_t)(end - q->line);
            take_line(q, q->line, size);
            q->line_size -= size + 1;
            memmove(q->line, end + 1, q->line_size);
        }
        if (q->line_size == sizeof q->line) q->line_size = 0; /* longer than any request */
    }
}

/* ---- pictures ---- */

static void pause_for(double seconds)
{
    if (seconds > 0) nanosleep(&(struct timespec){0, (long)(fmin(seconds, WAIT_S) * 1e9)}, NULL);
}

static void keep_frame(acquisition *q, td_frame *frame, double skew_s)
{
    q->seen++;
    q->skew_s = skew_s;
    for (int k = 0; k < q->o->count; k++) {
        td_image_free(&q->image[k]);
        q->image[k] = frame[k].image;
        snprintf(q->name[k], sizeof q->name[k], "%s", frame[k].name);
        q->measure[k] = capture_measure_image(frame[k].image);
        q->best_focus[k] = fmax(q->best_focus[k], q->measure[k].focus);
    }
    q->time_s = frame[0].time_s;
    q->is_stored = false;
    q->trouble[0] = 0;
    show(q);
}

static void take_picture(acquisition *q)
{
    td_frame frame[2];
    td_error error = {0};
    bool got = false, ended = false;
    double skew_s = NAN;
    const bool camera = td_source_kind_of(q->source[0]) == TD_SOURCE_CAMERA;
    const double early_s = q->taken_s + 1 / q->o->rate_hz - terminal_now_s();
    if (q->ended || (q->frozen && !camera) || (!camera && early_s > 0)) {
        pause_for(q->ended || q->frozen ? WAIT_S : early_s);
        return;
    }
    if (td_source_next_together(frame, &got, &ended, &skew_s, q->source, q->o->count, WAIT_S, &error) !=
        TD_OK) {
        snprintf(q->trouble, sizeof q->trouble, "%.299s", error.message);
        return;
    }
    q->ended = ended;
    if (!got) return;
    q->taken_s = terminal_now_s();
    if (!q->frozen) {
        keep_frame(q, frame, skew_s);
        return;
    }
    for (int k = 0; k < q->o->count; k++) td_image_free(&frame[k].image);
}

/* ---- from the start to the end ---- */

static td_status open_sources(acquisition *q, td_error *error)
{
    td_source_options o = td_source_options_default();
    o.rate_hz = q->o->rate_hz;
    for (int k = 0; k < q->o->count; k++) TD_TRY(td_source_open(&q->source[k], q->o->where[k], &o, error));
    if (q->o->count == 2 && td_source_kind_of(q->source[0]) != td_source_kind_of(q->source[1]))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s and %s: are of different kinds; take two folders, two videos or two cameras",
                       q->o->where[0], q->o->where[1]);
    if (td_source_kind_of(q->source[0]) == TD_SOURCE_CAMERA) {
        struct timespec now;
        clock_gettime(CLOCK_REALTIME, &now);
        q->clock_offset_s = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec - terminal_now_s();
    }
    return TD_OK;
}

static td_status open_dataset(acquisition *q, const char *folder, td_error *error)
{
    td_target target;
    capture_dataset *d = &q->dataset;
    if (q->o->target) TD_TRY(td_target_from_words(&target, &d->target, q->o->target, error));
    snprintf(d->about, sizeof d->about, "Taken by teledimos panel from %.500s%s%.500s", q->o->where[0],
             q->o->count == 2 ? " and " : "", q->o->count == 2 ? q->o->where[1] : "");
    d->folder = folder;
    d->format = "pgm";
    d->model = "brown5";
    d->cameras = q->o->count;
    for (int k = 0; k < q->o->count; k++)
        snprintf(d->name[k], sizeof d->name[k], "%s", q->o->count == 1 ? "camera" : side_names[k]);
    return capture_dataset_open(d, error);
}

static void run(acquisition *q)
{
    tell_state(q);
    while (!q->closed && !terminal_interrupted()) {
        take_requests(q);
        if (q->closed) return;
        take_picture(q);
        if (terminal_now_s() > q->told_s + STATE_S) tell_state(q);
    }
}

td_status workbench_acquire(const workbench_source *source, td_error *error)
{
    char *folder = NULL;
    TD_TRY(workbench_folder(&folder, source->output, "acquired", error));
    acquisition *q = calloc(1, sizeof *q);
    td_status status = q ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (q) {
        q->o = source;
        q->skew_s = NAN;
    }
    if (status == TD_OK) status = open_sources(q, error);
    if (status == TD_OK) status = open_dataset(q, folder, error);
    if (status == TD_OK) {
        run(q);
    } else if (q) { /* whoever asks is told, too */
        snprintf(q->trouble, sizeof q->trouble, "%.299s", error->message);
        tell_state(q);
    }
    for (int k = 0; q && k < 2; k++) {
        td_source_free(&q->source[k]);
        td_image_free(&q->image[k]);
    }
    if (q) capture_dataset_close(&q->dataset);
    free(q);
    free(folder);
    return status;
}
