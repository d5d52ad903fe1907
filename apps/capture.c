/* teledimos capture: images from cameras, videos or folders into a dataset, with a live picture. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "apps/capture_internal.h"
#include "apps/cli.h"
#include "apps/terminal.h"
#include "core/file.h"
#include "core/source.h"
#include "core/target_words.h"

enum { DEFAULT_PORT = 7040, LINE_SIZE = 512, FACTS_SIZE = 1024 };
static const double WAIT_S = 0.05, REFRESH_S = 0.5;

static const char *positional[CAPTURE_CAMERAS];
static cli_common common;
static double rate_hz = 10, duration_s = INFINITY, idle_s = INFINITY;
static int count_wanted = 0, port = -1;
static const char *format = "pgm", *names_text, *target_text, *model = "brown5", *live_choice = "auto",
                  *store = "all", *size_text, *open_path;
static bool in_colour, list_only;

static const char *const formats[] = {"pgm", "png", NULL};
static const char *const models[] = {"pinhole", "brown5", "brown8", "fisheye", NULL};
static const char *const lives[] = {"auto", "page", "text", "none", NULL};
static const char *const stores[] = {"all", "keys", NULL};

static cli_option options[] = {
    {CLI_REAL, "rate", 0, &rate_hz, "HZ",
     "images a second, default 10; 0: as many as come. Of folders every image is taken", 0, 1000, NULL},
    {CLI_INT, "count", 0, &count_wanted, "N", "end when so many are stored", 1, 1000000, NULL},
    {CLI_REAL, "duration", 0, &duration_s, "S", "end after so many seconds", 0, 1e7, NULL},
    {CLI_REAL, "idle", 0, &idle_s, "S",
     "end when no image came for so many seconds (a folder never ends by itself)", 0.05, 1e7, NULL},
    {CLI_STRING, "store", 0, &store, "WHAT",
     "all (default): every image; keys: those for which space, enter or the page's button is pressed", 0, 0,
     stores},
    {CLI_STRING, "names", 0, &names_text, "A,B", "names of the cameras; default: camera, or left,right", 0, 0,
     NULL},
    {CLI_STRING, "target", 0, &target_text, "TARGET",
     "what is seen, for dataset.yaml: 'chessboard 9x6 25mm', 'marks 7x5 30mm diameter 12mm', or a "
     "mapping as '{kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}'",
     0, 0, NULL},
    {CLI_STRING, "model", 0, &model, "MODEL",
     "of the cameras, for dataset.yaml: pinhole, brown5 (default), brown8, fisheye", 0, 0, models},
    {CLI_STRING, "format", 0, &format, "FORMAT", "pgm (default) or png; pgm is ppm with --colour", 0, 0,
     formats},
    {CLI_FLAG, "colour", 0, &in_colour, NULL, "store colour; default: grey", 0, 0, NULL},
    {CLI_STRING, "size", 0, &size_text, "WxH", "size asked of the cameras, px; default: their own", 0, 0,
     NULL},
    {CLI_STRING, "live", 0, &live_choice, "HOW",
     "the live picture: page (in the browser of this machine), text (characters in the terminal), none. "
     "Default: "
     "page on a terminal, text over ssh, none elsewhere",
     0, 0, lives},
    {CLI_INT, "port", 0, &port, "N", "of the page; default 7040, or any when it is taken; 0: any", 0, 65535,
     NULL},
    {CLI_FLAG, "list", 0, &list_only, NULL, "list the cameras of this machine, and end", 0, 0, NULL},
    {CLI_STRING, "open", 0, &open_path, "IMAGE", "show a stored image with its measures, and end", 0, 0,
     NULL},
    CLI_COMMON_OPTIONS(common, "folder of the dataset; made, or gone on with", "this job draws none"),
};

static cli_command command = {
    .name = "capture",
    .summary = "take images from cameras, videos or folders into a dataset",
    .usage = "SOURCE [SOURCE2] -o DATASET [options]",
    .text =
        "Takes images from SOURCE, or pairs from two, shows them live, and stores them with dataset.yaml and "
        "frames.csv, so that 'teledimos calibrate DATASET' can follow. A source is a camera (/dev/video0, "
        "camera:0, "
        "camera:NAME), a video file, a folder that fills, or a folder's images by pattern ('DIR/left*.png'). "
        "Two "
        "cameras are grabbed together, videos paired by time, folders by the order of their names (natural "
        "order: "
        "img2 before img10).\n"
        "\n"
        "Keys, on a terminal and on the page: f freezes the picture and lets it go on; q ends; with --store "
        "keys, "
        "space or enter stores the picture that is shown. Ctrl-C ends with what was stored. Run again with "
        "the same "
        "-o, it goes on with the next number; images that a kill left out of frames.csv are taken in, "
        "without their "
        "times. time_s is the time since 1970 (cameras, and folders: the file's last change), of videos the "
        "time "
        "from their start.\n"
        "\n"
        "Focus is the root mean square of the image's Laplacian over its standard deviation, times 100, "
        "after "
        "smoothing by 3x3: higher is sharper. It does not change with exposure or contrast, but with what is "
        "seen: "
        "turn the lens while the scene stays, until it is largest. Skew is the largest difference between "
        "the times "
        "of a pair's images; dropped are moments of the wished rate for which no image came.",
    .examples =
        "  teledimos capture '/usr/share/doc/opencv-doc/examples/data/left??.jpg' -o taken --idle 0.5\n"
        "  teledimos capture '/usr/share/doc/opencv-doc/examples/data/left??.jpg' "
        "'/usr/share/doc/opencv-doc/examples/data/right??.jpg' -o pairs --idle 0.5 --target 'chessboard 9x6 "
        "25mm'\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = CAPTURE_CAMERAS,
    .positional = positional,
};

typedef struct job {
    td_source *source[CAPTURE_CAMERAS];
    int count;
    int width, height; /* asked of the cameras */
    capture_dataset dataset;
    capture_tally tally;
    capture_screen screen;
    terminal term;
    live *page;
    td_image *image[CAPTURE_CAMERAS]; /* shown; NULL: none yet */
    double time_s;                    /* of it */
    double clock_offset_s;            /* since 1970, less the monotonic clock */
    double best_focus[CAPTURE_CAMERAS];
    double took_s;  /* by the monotonic clock: when the last image came */
    double shown_s; /* likewise: the page */
    bool fresh;     /* something came since */
    bool frozen, image_stored;
    bool keys, paced; /* one for each press; not faster than the rate */
    td_error failure;
} job;

/* ---- what is asked for ---- */

static td_status parse_size(job *j, td_error *error)
{
    char rest;
    if (!size_text) return TD_OK;
    if (sscanf(size_text, "%5dx%5d%c", &j->width, &j->height, &rest) == 2 && j->width > 0 && j->height > 0)
        return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "--size: '%.40s' is no size; write for example 1280x720",
                   size_text);
}

static bool is_good_name(const char *name, size_t length)
{
    static const char *const taken[] = {"frame", "time_s", "height_m"};
    for (size_t i = 0; i < sizeof taken / sizeof *taken; i++)
        if (strlen(taken[i]) == length && !strncmp(taken[i], name, length)) return false;
    return length > 0 && length < CAPTURE_NAME_SIZE &&
           strspn(name, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_") >= length;
}

static td_status parse_names(job *j, td_error *error)
{
    const char *text = names_text ? names_text : j->count == 1 ? "camera" : "left,right";
    j->dataset.cameras = j->count;
    for (int i = 0; i < j->count; i++) {
        const size_t length = strcspn(text, ",");
        const bool last = text[length] == 0;
        if (!is_good_name(text, length) || last != (i == j->count - 1))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "--names: '%.80s' must be %d names, with a comma between, of letters, digits, - and _ "
                "(not frame, time_s, height_m)",
                names_text, j->count);
        snprintf(j->dataset.name[i], CAPTURE_NAME_SIZE, "%.*s", (int)length, text);
        text += length + !last;
    }
    if (j->count == 2 && !strcmp(j->dataset.name[0], j->dataset.name[1]))
        return td_fail(error, TD_ERROR_ARGUMENT, "--names: '%.80s' gives one name twice", names_text);
    return TD_OK;
}

static td_status open_sources(job *j, td_error *error)
{
    td_source_options o = td_source_options_default();
    o.channels = in_colour ? 3 : 1;
    o.rate_hz = rate_hz;
    o.width = j->width;
    o.height = j->height;
    for (int i = 0; i < j->count; i++) TD_TRY(td_source_open(&j->source[i], positional[i], &o, error));
    if (j->count == 2 && td_source_kind_of(j->source[0]) != td_source_kind_of(j->source[1]))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s and %s: are of different kinds; take two folders, two videos or two cameras",
                       positional[0], positional[1]);
    return TD_OK;
}

static td_status open_dataset(job *j, td_error *error)
{
    capture_dataset *d = &j->dataset;
    snprintf(d->about, sizeof d->about, "Taken by teledimos capture from %.500s%s%.500s", positional[0],
             j->count == 2 ? " and " : "", j->count == 2 ? positional[1] : "");
    d->folder = common.output;
    d->format = format;
    d->colour = in_colour;
    d->model = model;
    return capture_dataset_open(d, error);
}

/* ---- the live picture ---- */

/* "page", "text" or "none". */
static const char *choose_live(const char *otherwise)
{
    const char *ssh = getenv("SSH_CONNECTION");
    if (strcmp(live_choice, "auto") != 0) return live_choice;
    if (!isatty(STDERR_FILENO) || common.quiet) return "none";
    return ssh && *ssh ? "text" : otherwise;
}

/* The usual port, so that a page left open goes on; any, when it is taken. */
static td_status open_page(live **page, td_error *error)
{
    if (port >= 0) {
        TD_TRY(live_open(page, port, error));
    } else if (live_open(page, DEFAULT_PORT, NULL) != TD_OK) {
        TD_TRY(live_open(page, 0, error));
    }
    if (!common.quiet) fprintf(stderr, "live picture: %s\n", live_url(*page));
    return TD_OK;
}

static td_status check_keys(const job *j, td_error *error)
{
    if (!j->keys || isatty(STDIN_FILENO) || !strcmp(choose_live("page"), "page")) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "--store keys: needs a terminal, or --live page");
}

static td_status open_live(job *j, td_error *error)
{
    const char *how = choose_live("page");
    if (!strcmp(how, "page")) TD_TRY(open_page(&j->page, error));
    capture_screen_open(&j->screen, isatty(STDIN_FILENO), !strcmp(how, "text"), common.quiet);
    return TD_OK;
}

static void status_line(char line[LINE_SIZE], const job *j)
{
    const capture_tally *t = &j->tally;
    size_t used = (size_t)snprintf(line, LINE_SIZE, "%s%zu stored", j->frozen ? "frozen · " : "", t->stored);
    const double rate = capture_rate(t);
    if (isfinite(rate)) used += (size_t)snprintf(line + used, LINE_SIZE - used, " · %.1f/s", rate);
    for (int i = 0; i < j->count && t->seen; i++) {
        const capture_measure *m = &t->camera[i].last;
        used += (size_t)snprintf(line + used, LINE_SIZE - used, " · %s focus %.1f (best %.1f)",
                                 j->dataset.name[i], m->focus, j->best_focus[i]);
        if (m->saturated_share > 0.001)
            used +=
                (size_t)snprintf(line + used, LINE_SIZE - used, ", %.1f %% white", 100 * m->saturated_share);
    }
    if (t->skews)
        used += (size_t)snprintf(line + used, LINE_SIZE - used, " · skew %.1f, at most %.1f ms",
                                 1e3 * t->skew_sum_s / (double)t->skews, 1e3 * t->skew_largest_s);
    if (t->dropped) snprintf(line + used, LINE_SIZE - used, " · %zu dropped", t->dropped);
}

/* Adds a line to the facts. */
static void fact(char facts[FACTS_SIZE], const char *text, ...) TD_PRINTF(2, 3);
static void fact(char facts[FACTS_SIZE], const char *text, ...)
{
    const size_t used = strlen(facts);
    va_list arguments;
    va_start(arguments, text);
    vsnprintf(facts + used, FACTS_SIZE - used, text, arguments);
    va_end(arguments);
}

static void page_facts(char facts[FACTS_SIZE], const job *j)
{
    const capture_tally *t = &j->tally;
    const capture_camera *c = t->camera;
    const bool two = j->count == 2;
    const size_t before = j->dataset.found + j->dataset.adopted;
    facts[0] = 0;
    fact(facts, "Stored: %zu\n", t->stored);
    if (before) fact(facts, "In the dataset: %zu\n", before + t->stored);
    if (t->seen) {
        if (two) fact(facts, ": %s\t%s\n", j->dataset.name[0], j->dataset.name[1]);
        fact(facts, two ? "Focus: %.1f\t%.1f\n" : "Focus: %.1f\n", c[0].last.focus, c[1].last.focus);
        fact(facts, two ? "Best so far: %.1f\t%.1f\n" : "Best so far: %.1f\n", j->best_focus[0],
             j->best_focus[1]);
        fact(facts, two ? "Brightness: %.0f %%\t%.0f %%\n" : "Brightness: %.0f %%\n",
             100 * c[0].last.brightness_share, 100 * c[1].last.brightness_share);
        fact(facts, two ? "At white: %.1f %%\t%.1f %%\n" : "At white: %.1f %%\n",
             100 * c[0].last.saturated_share, 100 * c[1].last.saturated_share);
    }
    if (isfinite(capture_rate(t))) fact(facts, "Rate: %.1f a second\n", capture_rate(t));
    if (t->skews)
        fact(facts, "Skew, mean: %.1f ms\nSkew, largest: %.1f ms\n", 1e3 * t->skew_sum_s / (double)t->skews,
             1e3 * t->skew_largest_s);
    if (t->dropped) fact(facts, "Dropped: %zu\n", t->dropped);
    if (t->unreadable) fact(facts, "Unreadable: %zu\n", t->unreadable);
}

static const char *headline(const job *j)
{
    if (!j->image[0]) return "Waiting for the first picture";
    if (j->keys && j->image_stored) return j->frozen ? "Frozen, and stored" : "Stored";
    if (j->keys) return j->frozen ? "Frozen: store it, or let it go on" : "Store the pictures you want";
    return j->frozen ? "Frozen: nothing is stored until it goes on" : "Storing every picture";
}

static void show_page(const job *j)
{
    char facts[FACTS_SIZE];
    page_facts(facts, j);
    live_view view = {.count = j->count,
                      .headline = headline(j),
                      .facts = facts,
                      .done = count_wanted ? (double)j->tally.stored / count_wanted : NAN,
                      .frozen = j->frozen,
                      .buttons = j->keys ? "freeze store done" : "freeze done"};
    for (int i = 0; i < j->count; i++) {
        view.image[i] = j->image[i];
        view.label[i] = j->dataset.name[i];
    }
    live_show(j->page, &view, NULL); /* a picture less is no reason to stop */
}

static void show(job *j, bool now)
{
    char line[LINE_SIZE];
    const double now_s = terminal_now_s();
    if (j->page && (now || j->fresh || now_s - j->shown_s > REFRESH_S)) {
        show_page(j);
        j->shown_s = now_s;
        j->fresh = false;
    }
    status_line(line, j);
    capture_screen_draw(&j->screen, (const td_image *const *)j->image, j->image[0] ? j->count : 0, line, now);
}

/* ---- taking and storing ---- */

static td_status keep(job *j, td_error *error)
{
    const bool clock = td_source_kind_of(j->source[0]) == TD_SOURCE_CAMERA;
    if (!j->image[0] || j->image_stored) return TD_OK;
    TD_TRY(capture_dataset_add(&j->dataset, j->image, j->time_s + (clock ? j->clock_offset_s : 0), error));
    j->tally.stored++;
    j->image_stored = true;
    return TD_OK;
}

/* Moments of the raster between the last image and this. */
static void count_dropped(job *j, double time_s)
{
    const double period = fmax(rate_hz > 0 ? 1 / rate_hz : 0, td_source_period_s(j->source[0]));
    if (td_source_kind_of(j->source[0]) == TD_SOURCE_FOLDER || !j->tally.seen || period <= 0) return;
    const double missing = round((time_s - j->tally.last_s) / period) - 1;
    if (missing > 0) j->tally.dropped += (size_t)missing;
}

static void note(job *j, const td_frame *frame, double skew_s)
{
    capture_tally *t = &j->tally;
    count_dropped(j, frame[0].time_s);
    j->fresh = true;
    /* A file's last change tells when it was written, or copied: no rate. */
    const double time_s = td_source_kind_of(j->source[0]) == TD_SOURCE_FOLDER ? NAN : frame[0].time_s;
    if (!t->seen) t->first_s = time_s;
    t->last_s = time_s;
    t->seen++;
    if (isfinite(skew_s) && j->count > 1) {
        t->skews++;
        t->skew_sum_s += skew_s;
        t->skew_largest_s = fmax(t->skew_largest_s, skew_s);
    }
    for (int i = 0; i < j->count; i++) {
        capture_camera *c = &t->camera[i];
        c->last = capture_measure_image(frame[i].image);
        c->sum.focus += c->last.focus;
        c->sum.brightness_share += c->last.brightness_share;
        c->sum.saturated_share += c->last.saturated_share;
        c->measured++;
        c->width = frame[i].image->width;
        c->height = frame[i].image->height;
        j->best_focus[i] = fmax(j->best_focus[i], c->last.focus);
    }
}

/* A file that cannot be read is told, counted and passed over; a source that cannot go on ends the run. */
static void complain(job *j, const td_error *error)
{
    j->failure = *error;
    j->tally.unreadable++;
    capture_screen_clear(&j->screen);
    if (!common.quiet) fprintf(stderr, "warning: %s\n", error->message);
}

/* A calibration needs images of one size for each camera. */
static td_status check_sizes(const job *j, const td_frame *frame, td_error *error)
{
    for (int i = 0; i < j->count && j->tally.seen; i++) {
        const capture_camera *c = &j->tally.camera[i];
        if (frame[i].image->width != c->width || frame[i].image->height != c->height)
            return td_fail(error, TD_ERROR_DATA,
                           "%s: %s is %dx%d px, but the first was %dx%d px; it is left out", positional[i],
                           frame[i].name, frame[i].image->width, frame[i].image->height, c->width, c->height);
    }
    return TD_OK;
}

/* Takes the next image, and stores it when all are. Cameras go on while frozen, so that the next picture is a
 * fresh one; videos and folders wait. */
static td_status take(job *j, td_error *error)
{
    td_frame frame[CAPTURE_CAMERAS];
    bool got, ended;
    double skew_s;
    const double now_s = terminal_now_s();
    const bool camera = td_source_kind_of(j->source[0]) == TD_SOURCE_CAMERA;
    const double pause_s = j->paced && j->took_s > 0 ? j->took_s + 1 / rate_hz - now_s : 0;
    if ((j->frozen && !camera) || pause_s > 0) {
        const double wait_s = j->frozen ? WAIT_S : fmin(pause_s, WAIT_S);
        nanosleep(&(struct timespec){0, (long)(wait_s * 1e9)}, NULL);
        return TD_OK;
    }
    if (td_source_next_together(frame, &got, &ended, &skew_s, j->source, j->count, WAIT_S, error) != TD_OK) {
        complain(j, error);
        return TD_OK;
    }
    if (ended) j->tally.ended_by = "end of source";
    if (!got) return TD_OK;
    if (check_sizes(j, frame, error) != TD_OK) {
        complain(j, error);
        for (int i = 0; i < j->count; i++) td_image_free(&frame[i].image);
        return TD_OK;
    }
    j->failure = (td_error){0};
    j->took_s = terminal_now_s();
    note(j, frame, skew_s);
    for (int i = 0; i < j->count; i++) {
        if (!j->frozen) {
            td_image_free(&j->image[i]);
            j->image[i] = frame[i].image;
        } else {
            td_image_free(&frame[i].image);
        }
    }
    if (j->frozen) return TD_OK;
    j->time_s = frame[0].time_s;
    j->image_stored = false;
    return j->keys ? TD_OK : keep(j, error);
}

static td_status answer(job *j, const char *pressed, td_error *error)
{
    if (!strcmp(pressed, "freeze")) j->frozen = !j->frozen && j->image[0];
    if (!strcmp(pressed, "done")) j->tally.ended_by = "key";
    if (!strcmp(pressed, "store") && j->keys) TD_TRY(keep(j, error));
    show(j, true);
    return TD_OK;
}

static td_status answer_all(job *j, td_error *error)
{
    const char *pressed;
    while (!j->tally.ended_by && (pressed = capture_screen_pressed(&j->screen)))
        TD_TRY(answer(j, pressed, error));
    while (!j->tally.ended_by && j->page && (pressed = live_pressed(j->page)))
        TD_TRY(answer(j, pressed, error));
    return TD_OK;
}

static void check_end(job *j)
{
    capture_tally *t = &j->tally;
    const double now_s = terminal_now_s();
    const double quiet_s = now_s - (j->took_s > 0 ? j->took_s : t->begun_s);
    if (t->ended_by) return;
    if (terminal_interrupted()) t->ended_by = "signal";
    if (count_wanted && t->stored >= (size_t)count_wanted) t->ended_by = "count";
    if (now_s - t->begun_s >= duration_s) t->ended_by = "duration";
    if (quiet_s >= idle_s && !j->frozen) t->ended_by = "idle";
}

static td_status run(job *j, td_error *error)
{
    td_status status = TD_OK;
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    j->tally.begun_s = terminal_now_s();
    j->clock_offset_s = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec - j->tally.begun_s;
    show(j, true);
    while (status == TD_OK && !j->tally.ended_by) {
        status = take(j, error);
        if (status == TD_OK) status = answer_all(j, error);
        if (status == TD_OK) status = capture_dataset_flush(&j->dataset, false, error);
        show(j, false);
        check_end(j);
    }
    j->tally.ended_s = terminal_now_s();
    td_status last = capture_dataset_flush(&j->dataset, true, status == TD_OK ? error : NULL);
    return status == TD_OK ? last : status;
}

/* ---- the end ---- */

static void say(const job *j)
{
    const capture_tally *t = &j->tally;
    const size_t all = j->dataset.found + j->dataset.adopted + t->stored;
    printf("%zu %s stored in %s", t->stored, j->count == 2 ? "pairs" : "images", common.output);
    if (all > t->stored) printf(" (%zu in all)", all);
    if (isfinite(capture_rate(t))) printf(", %.1f a second", capture_rate(t));
    if (t->skews)
        printf(", skew %.1f ms in the mean, %.1f ms at most", 1e3 * t->skew_sum_s / (double)t->skews,
               1e3 * t->skew_largest_s);
    if (t->dropped) printf(", %zu dropped", t->dropped);
    if (t->unreadable) printf(", %zu unreadable", t->unreadable);
    printf("\n");
    for (int i = 0; i < j->count && t->seen; i++) {
        const capture_camera *c = &t->camera[i];
        const double n = (double)c->measured;
        printf("%s: %dx%d px, focus %.1f, brightness %.2f, %.4f at white\n", j->dataset.name[i], c->width,
               c->height, c->sum.focus / n, c->sum.brightness_share / n, c->sum.saturated_share / n);
    }
    if (!j->dataset.has_target && !common.quiet)
        fprintf(stderr,
                "before 'teledimos calibrate', say in %s/dataset.yaml what target is seen, or run again with "
                "--target\n",
                common.output);
}

static td_status finish(job *j, td_error *error)
{
    if (j->failure.status != TD_OK && !strcmp(j->tally.ended_by, "end of source")) {
        *error = j->failure;
        return error->status;
    }
    if (j->dataset.found + j->dataset.adopted + j->tally.stored == 0)
        return td_fail(error, TD_ERROR_NOT_FOUND, "%s: %s", positional[0],
                       j->tally.seen ? "no image was stored" : "no image came");
    char *path = td_path_join(common.output, "result.yaml");
    json_t *result = capture_result(&j->dataset, &j->tally, positional);
    td_status status = path ? capture_result_put(result, path, common.json, error)
                            : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK && !common.json) say(j);
    json_decref(result);
    free(path);
    if (status == TD_OK && (fflush(stdout) != 0 || ferror(stdout)))
        return td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    return status;
}

static void greet(const job *j)
{
    if (common.quiet) return;
    if (j->dataset.found || j->dataset.adopted)
        fprintf(stderr, "%s: has %zu frames; goes on with number %ld\n", common.output,
                j->dataset.found + j->dataset.adopted, j->dataset.next);
    if (j->dataset.adopted)
        fprintf(stderr,
                "%s: %zu of them were stored before an earlier run was stopped, and are now in frames.csv\n",
                common.output, j->dataset.adopted);
    if (j->screen.keys && j->screen.tty)
        fprintf(stderr, "keys: %sf freezes, q ends\n", j->keys ? "space or enter stores, " : "");
}

/* Everything that can be wrong is found before anything is written. */
static td_status parse_target(json_t **mapping, td_error *error)
{
    td_target target;
    td_status status = td_target_from_words(&target, mapping, target_text, error);
    if (status == TD_OK) return TD_OK;
    td_error_prefix(error, status, "--target");
    return TD_ERROR_ARGUMENT;
}

static td_status prepare(job *j, td_error *error)
{
    TD_TRY(parse_size(j, error));
    TD_TRY(parse_names(j, error));
    if (target_text) TD_TRY(parse_target(&j->dataset.target, error));
    TD_TRY(check_keys(j, error));
    TD_TRY(open_sources(j, error));
    TD_TRY(open_dataset(j, error));
    j->paced = rate_hz > 0 && j->keys && td_source_kind_of(j->source[0]) != TD_SOURCE_CAMERA;
    return open_live(j, error);
}

static td_status capture(td_error *error)
{
    job j = {.count = (int)command.positional_count, .keys = !strcmp(store, "keys")};
    td_status status = prepare(&j, error);
    if (status == TD_OK) {
        greet(&j);
        status = run(&j, error);
        capture_screen_close(&j.screen);
    }
    if (status == TD_OK) status = finish(&j, error);
    live_close(&j.page);
    for (int i = 0; i < j.count; i++) {
        td_source_free(&j.source[i]);
        td_image_free(&j.image[i]);
    }
    capture_dataset_close(&j.dataset);
    return status;
}

/* ---- --list and --open ---- */

static td_status list(td_error *error)
{
    json_t *result = capture_result_list(), *devices = json_object_get(result, "devices"), *device;
    size_t i;
    td_status status = capture_result_put(result, NULL, common.json, error);
    if (status == TD_OK && !common.json) {
        json_array_foreach(devices, i, device)
        {
            const char *why = json_string_value(json_object_get(device, "why"));
            printf("%-14s %-32s %s\n", json_string_value(json_object_get(device, "path")),
                   json_string_value(json_object_get(device, "name")), why ? why : "");
        }
        if (json_array_size(devices) == 0)
            printf("no camera: this machine has no /dev/video0 or the like; is one plugged in?\n");
    }
    json_decref(result);
    return status;
}

/* The page shows it until the person ends that. */
static td_status show_opened(const td_image *image, const char *facts, td_error *error)
{
    live *page = NULL;
    const char *pressed = NULL;
    TD_TRY(open_page(&page, error));
    const live_view view = {.count = 1,
                            .image = {image},
                            .label = {open_path},
                            .headline = "A stored image",
                            .facts = facts,
                            .done = NAN,
                            .buttons = "done"};
    td_status status = live_show(page, &view, error);
    while (status == TD_OK && !terminal_interrupted() && !(pressed && !strcmp(pressed, "done"))) {
        nanosleep(&(struct timespec){0, 50000000}, NULL);
        pressed = live_pressed(page);
    }
    live_close(&page);
    return status;
}

static td_status open_image(td_error *error)
{
    td_image *image = NULL, *grey = NULL;
    char facts[FACTS_SIZE];
    TD_TRY(td_image_read(&image, open_path, 3, error));
    if (!capture_has_colour(image) && td_image_read(&grey, open_path, 1, error) == TD_OK) {
        td_image_free(&image);
        image = grey;
    }
    const capture_measure m = capture_measure_image(image);
    snprintf(facts, sizeof facts, "Size: %d × %d px, %s\nFocus: %.1f\nBrightness: %.2f\nAt white: %.4f\n",
             image->width, image->height, image->channels == 3 ? "colour" : "grey", m.focus,
             m.brightness_share, m.saturated_share);
    json_t *result = capture_result_open(open_path, image, &m);
    td_status status = capture_result_put(result, NULL, common.json, error);
    const char *how = choose_live("text");
    if (status == TD_OK && !strcmp(how, "text")) {
        capture_screen screen;
        capture_screen_open(&screen, false, false, true);
        capture_screen_print(&screen, image);
    }
    if (status == TD_OK && !common.json) fputs(facts, stdout);
    if (status == TD_OK && !strcmp(how, "page")) status = show_opened(image, facts, error);
    json_decref(result);
    td_image_free(&image);
    return status;
}

int main(int argc, char **argv)
{
    int code = cli_parse(&command, argc, argv);
    if (code >= 0) return code;
    if (common.schema) {
        char *text = td_schema_describe(capture_schema, capture_schema_count);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    const bool asks = list_only || open_path;
    if (!asks && (!command.positional_count || !common.output || !*common.output)) {
        cli_complain(command.name, "%s is missing (usage: teledimos %s %s)",
                     !command.positional_count ? "SOURCE" : "-o DATASET", command.name, command.usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_error error = {0};
    td_status status = list_only ? list(&error) : open_path ? open_image(&error) : capture(&error);
    if (status != TD_OK) cli_complain(command.name, "%s", error.message);
    return status == TD_OK ? EXIT_DONE : status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
}
