/* The wizard's loop: look, take, solve, say what is next. */
#include "apps/wizard.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/keys.h"
#include "apps/wizard_internal.h"
#include "core/parallel.h"

/* Of a moving source, a picture is taken when the board is still, and elsewhere than in those taken: RMS
 * movement of its points, as shares of the image's width. */
#define STILL 0.004
#define ELSEWHERE 0.04
/* A solve that takes longer waits for this many further views. */
#define SLOW_S 1.0
#define SLOW_VIEWS 5

/* ---- Looking ---- */

static void look_at(size_t index, void *user)
{
    wizard *w = user;
    td_error error;
    if (!w->frame[index].image) return;
    w->width[index] = w->frame[index].image->width;
    w->height[index] = w->frame[index].image->height;
    if (td_detect(&w->seen[index], w->frame[index].image, &w->answers.target, &error) != TD_OK)
        snprintf(w->seen[index].reason, sizeof w->seen[index].reason, "%.230s", error.message);
}

/* RMS distance of the points that both saw as a share of the width; infinity: none in common. */
static double movement(const td_detection *a, const td_detection *b, int width)
{
    double sum = 0;
    size_t n = 0;
    if (!a->found || !b->found) return INFINITY;
    for (size_t i = 0; i < a->count; i++) {
        double dx = a->point[2 * i] - b->point[2 * i], dy = a->point[2 * i + 1] - b->point[2 * i + 1];
        if (!isfinite(dx) || !isfinite(dy)) continue;
        sum += dx * dx + dy * dy;
        n++;
    }
    return n ? sqrt(sum / (double)n) / width : INFINITY;
}

static bool all_found(const wizard *w)
{
    for (int c = 0; c < w->answers.camera_count; c++)
        if (!w->seen[c].found) return false;
    return true;
}

static bool is_elsewhere(const wizard *w)
{
    for (size_t v = 0; v < w->count; v++) {
        bool near = true;
        for (int c = 0; c < w->answers.camera_count; c++)
            near &= movement(&w->seen[c], &w->view[v].detection[c], w->width[c]) < ELSEWHERE;
        if (near) return false;
    }
    return true;
}

/* Whether what is seen goes into the dataset: of a folder everything does. */
static bool wanted(const wizard *w, const td_detection *before)
{
    if (td_source_kind_of(w->source[0]) == TD_SOURCE_FOLDER || w->take) return true;
    if (!all_found(w) || !is_elsewhere(w)) return false;
    if (td_source_kind_of(w->source[0]) == TD_SOURCE_VIDEO)
        return true; /* a video cannot be asked to hold still */
    for (int c = 0; c < w->answers.camera_count; c++)
        if (!(movement(&w->seen[c], &before[c], w->width[c]) < STILL)) return false;
    return true;
}

static void say_what_was_seen(wizard *w, const wizard_view *view)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    if (!out) return;
    for (int c = 0; c < w->answers.camera_count; c++) {
        const td_detection *d = &view->detection[c];
        size_t seen = 0;
        for (size_t i = 0; i < d->count; i++) seen += isfinite(d->point[2 * i]);
        fprintf(out, "%s%s: ", c ? "; " : "", w->answers.name[c]);
        if (d->found)
            fprintf(out, "found, %zu of %zu points%s%s", seen, d->count, *d->reason ? ", " : "", d->reason);
        else
            fprintf(out, "not found: %s", *d->reason ? d->reason : "no picture");
    }
    if (fclose(out) == 0) wizard_say(w, "%-12s %s", view->name, text);
    free(text);
}

/* ---- Solving ---- */

static td_status gather(wizard *w, td_error *error)
{
    const wizard_answers *a = &w->answers;
    td_observations_free(&w->observations);
    TD_TRY(td_observations_new(&w->observations, &a->target, a->camera_count, w->count, error));
    td_observations *o = w->observations;
    for (int c = 0; c < a->camera_count; c++) {
        snprintf(o->camera[c].name, sizeof o->camera[c].name, "%s", a->name[c]);
        o->camera[c].model = a->model;
        o->camera[c].width = w->width[c];
        o->camera[c].height = w->height[c];
    }
    for (size_t v = 0; v < w->count; v++) {
        snprintf(o->view_name[v], sizeof o->view_name[v], "%s", w->view[v].name);
        for (int c = 0; c < a->camera_count; c++) td_observations_set(o, v, c, &w->view[v].detection[c]);
    }
    return TD_OK;
}

static void tell_outliers(wizard *w)
{
    const td_calibration *k = w->calibration;
    for (size_t v = 0; v < k->view_count; v++) {
        bool out = k->view[v].state == TD_VIEW_OUTLIER || k->view[v].state == TD_VIEW_CORRECTED;
        if (out && !w->view[v].told)
            wizard_say(w, "  %s %s: %s", w->view[v].name,
                       k->view[v].state == TD_VIEW_OUTLIER ? "is left out" : "was put right",
                       k->view[v].remark);
        w->view[v].told = out;
    }
}

static void solve(wizard *w)
{
    td_error error = {0};
    td_calibrate_options o = td_calibrate_options_default();
    o.leave_one_out = false;
    o.threads = w->setup->threads;
    td_calibration *k = NULL;
    double began = terminal_now_s();
    td_status status = td_calibrate(&k, w->observations, &o, &error);
    w->solve_s = terminal_now_s() - began;
    w->solved = w->count;
    snprintf(w->trouble, sizeof w->trouble, "%.500s", status == TD_OK ? "" : error.message);
    if (status != TD_OK) return;
    td_calibration_free(&w->calibration);
    w->calibration = k;
    tell_outliers(w);
}

static void suggest(wizard *w)
{
    td_next_view_options o = td_next_view_options_default();
    td_error error;
    o.skip = w->skip;
    bool current = w->calibration && w->calibration->view_count == w->count;
    if (w->calibration && !current) return; /* until the next solve */
    w->has_next = td_next_view_find(&w->next, w->calibration, w->observations, &o, &error) == TD_OK;
}

/* Everything that follows from the views; `now`: even when a solve is slow and few views are new. */
static td_status conclude(wizard *w, bool now, td_error *error)
{
    TD_TRY(gather(w, error));
    size_t found = 0;
    for (size_t v = 0; v < w->count; v++) found += w->view[v].detection[0].found;
    bool due = now || !w->calibration || w->solve_s < SLOW_S || w->count >= w->solved + SLOW_VIEWS;
    if (found >= 3 && due)
        solve(w);
    else if (found < 3)
        snprintf(w->trouble, sizeof w->trouble, "%zu of the 3 pictures that a first calibration needs",
                 found);
    const td_calibration *k =
        w->calibration && w->calibration->view_count == w->count ? w->calibration : NULL;
    for (int c = 0; c < w->answers.camera_count; c++)
        td_coverage_measure(&w->coverage[c], c, k, w->observations);
    suggest(w);
    return TD_OK;
}

/* ---- One round ---- */

static void forget_frame(wizard *w)
{
    for (int c = 0; c < WIZARD_CAMERAS; c++) td_image_free(&w->frame[c].image);
}

/* Of a source that is gone on with: what is there already. */
static bool known(const wizard *w, const td_frame *frame)
{
    char path[WIZARD_PATH + 300];
    td_source_kind kind = td_source_kind_of(w->source[0]);
    if (kind == TD_SOURCE_FOLDER) {
        snprintf(path, sizeof path, "%s/%s", w->answers.source[0], frame[0].name);
        return wizard_has(w, path);
    }
    return kind == TD_SOURCE_VIDEO && w->count && frame[0].time_s <= w->view[w->count - 1].time_s;
}

static td_status look(wizard *w, td_error *error)
{
    td_detection before[WIZARD_CAMERAS];
    memcpy(before, w->seen, sizeof before);
    memset(w->seen, 0, sizeof w->seen);
    td_status status =
        td_parallel_for((size_t)w->answers.camera_count, w->setup->threads, look_at, w, NULL, "looking");
    bool take = status == TD_OK && wanted(w, before);
    for (int c = 0; c < WIZARD_CAMERAS; c++) td_detection_free(&before[c]);
    if (!take) {
        wizard_show_live(w);
        return status;
    }
    w->take = false;
    w->skip = 0;
    TD_TRY(wizard_take(w, error));
    say_what_was_seen(w, &w->view[w->count - 1]);
    return conclude(w, false, error);
}

/* Takes the next pictures; *got whether there were any. An unreadable one is told and passed over. */
static td_status next_frames(wizard *w, bool *got, td_error *error)
{
    td_frame frame[WIZARD_CAMERAS] = {0};
    td_error why = {0};
    *got = false;
    td_status status = td_source_next_together(frame, got, &w->ended, &w->skew_s, w->source,
                                               w->answers.camera_count, 0.05, &why);
    if (status == TD_ERROR_IO || status == TD_ERROR_FORMAT) {
        wizard_say(w, "%s", why.message);
        return TD_OK;
    }
    if (status != TD_OK) {
        if (error) *error = why;
        return status;
    }
    if (!*got) return TD_OK;
    if (known(w, frame)) {
        for (int c = 0; c < WIZARD_CAMERAS; c++) td_image_free(&frame[c].image);
        return TD_OK;
    }
    forget_frame(w);
    memcpy(w->frame, frame, sizeof frame);
    return look(w, error);
}

typedef enum wizard_wish { GO_ON, FINISH, LEAVE } wizard_wish;

static bool can_finish(wizard *w)
{
    if (w->calibration) return true;
    wizard_say(w, "there is no result yet: %s", *w->trouble ? w->trouble : "no picture shows the target");
    return false;
}

static wizard_wish obey(wizard *w, int key)
{
    switch (key) {
    case '\r':
    case '\n':
    case 'f':
        return can_finish(w) ? FINISH : GO_ON;
    case ' ':
        w->take = true;
        break;
    case 'z':
        w->frozen = !w->frozen;
        break;
    case 's':
    case 'n':
        w->skip++;
        suggest(w);
        break;
    case 'q':
    case -1:
        return LEAVE;
    default:
        break;
    }
    return GO_ON;
}

static int key_of_page(wizard *w)
{
    static const struct {
        const char *word;
        int key;
    } keys[] = {{"freeze", 'z'}, {"store", ' '}, {"done", '\n'}, {"skip", 's'}};
    const char *word = w->page ? live_pressed(w->page) : NULL;
    for (size_t i = 0; word && i < sizeof keys / sizeof *keys; i++)
        if (strcmp(word, keys[i].word) == 0) return keys[i].key;
    return 0;
}

static td_status round_once(wizard *w, wizard_wish *wish, td_error *error)
{
    bool got = false, was_ended = w->ended;
    if (!w->frozen && !w->ended) TD_TRY(next_frames(w, &got, error));
    if (!got && w->solved && w->solved < w->count) { /* there is time for what was put off */
        TD_TRY(conclude(w, true, error));
        w->solved = w->count;
        wizard_draw(w);
    }
    int key = keys_next(got ? 0 : 0.05);
    if (!key) key = key_of_page(w);
    *wish = key ? obey(w, key) : GO_ON;
    if (w->ended && !was_ended) {
        wizard_say(w, "no more pictures come");
        if (w->calibration) *wish = FINISH;
    }
    if (*wish == GO_ON && (got || key)) wizard_draw(w);
    return TD_OK;
}

/* ---- Beginning and end ---- */

static td_status begin(wizard *w, td_error *error)
{
    const wizard_setup *s = w->setup;
    if (s->resume) {
        w->folder = strdup(s->folder);
        if (!w->folder) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
        TD_TRY(wizard_read_answers(w, error));
        for (int c = 0; c < w->answers.camera_count; c++) {
            td_source_options options = td_source_options_default();
            if (*w->answers.pattern[c]) options.pattern = w->answers.pattern[c];
            TD_TRY(td_source_open(&w->source[c], w->answers.source[c], &options, error));
        }
        TD_TRY(wizard_read_views(w, error));
    } else {
        TD_TRY(wizard_ask(w, error));
        TD_TRY(wizard_write_answers(w, error));
    }
    bool ssh = getenv("SSH_CONNECTION") != NULL;
    const char *term_name = getenv("TERM");
    w->colour = !getenv("NO_COLOR") && term_name && strcmp(term_name, "dumb") != 0;
    w->text_picture = s->live ? strcmp(s->live, "text") == 0 : ssh;
    td_error why;
    if (s->live ? strcmp(s->live, "page") == 0 : !ssh)
        if (live_open(&w->page, 0, &why) != TD_OK) wizard_say(w, "no live page: %s", why.message);
    return TD_OK;
}

static td_status watch(wizard *w, td_error *error)
{
    wizard_wish wish = GO_ON;
    if (w->count) wizard_say(w, "going on with %zu pictures", w->count);
    if (td_source_kind_of(w->source[0]) == TD_SOURCE_FOLDER)
        wizard_say(w, "watching %s", w->answers.source[0]);
    TD_TRY(conclude(w, true, error));
    wizard_draw(w);
    while (wish == GO_ON && !terminal_interrupted()) TD_TRY(round_once(w, &wish, error));
    wizard_clear(w);
    if (wish == FINISH) return TD_OK;
    return td_fail(error, TD_ERROR_CANCELLED,
                   "%zu pictures are kept; go on with: teledimos calibrate --resume -o %s", w->count,
                   w->folder);
}

static void end(wizard *w)
{
    keys_close();
    live_close(&w->page);
    forget_frame(w);
    for (int c = 0; c < WIZARD_CAMERAS; c++) {
        td_source_free(&w->source[c]);
        td_detection_free(&w->seen[c]);
    }
    for (size_t v = 0; v < w->count; v++)
        for (int c = 0; c < WIZARD_CAMERAS; c++) {
            td_detection_free(&w->view[v].detection[c]);
            free(w->view[v].image[c]);
        }
    free(w->view);
    td_observations_free(&w->observations);
    td_calibration_free(&w->calibration);
    json_decref(w->answers.target_mapping);
    free(w->folder);
    free(w);
}

td_status wizard_run(char **folder, const wizard_setup *setup, terminal *term, td_error *error)
{
    wizard *w = calloc(1, sizeof *w);
    *folder = NULL;
    if (!w) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    w->setup = setup;
    w->term = term;
    td_status status = begin(w, error);
    if (status == TD_OK && !keys_open())
        status = td_fail(error, TD_ERROR_ARGUMENT, "standard input is no terminal: name a DATASET");
    if (status == TD_OK) status = watch(w, error);
    if (status == TD_OK) *folder = strdup(w->folder);
    if (status == TD_OK && !*folder) status = td_fail(error, TD_ERROR_MEMORY, "out of memory");
    end(w);
    return status;
}
