/* Automatic matching: each left interest point against every pixel of its epipolar band, best against
 * runner-up, and back from the right image. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/match_internal.h"

#define BACK_PX 2 /* a better left place nearer than this is the same one */

typedef enum outcome { MATCHED, UNSEEN, AMBIGUOUS, ONE_SIDED, UNREFINED, UNSURE, NO_MEMORY } outcome;

typedef struct work {
    const td_pair *pair;
    td_pair back;
    const td_image *left, *right;
    const td_zncc_plane *a, *b;
    const td_match_options *options;
    const td_interest_point *point; /* (count) */
    td_match *match;                /* (count) */
    outcome *verdict;               /* (count) */
} work;

/* All of the band around the curve of pixel (i, j) of plane `a` in plane `b`. */
static bool search(td_band *band, const work *w, const td_pair *pair, const td_zncc_plane *a,
                   const td_zncc_plane *b, int i, int j, double near_m, double far_m)
{
    td_zncc_window window;
    const td_band_range range = {near_m, far_m, td_match_band_px(pair, i, j, w->options)};
    const bool done = td_zncc_window_cut(&window, a, i, j, b) &&
                      td_band_search(band, pair, i, j, &range, td_zncc_window_score, &window);
    td_zncc_window_free(&window);
    return done;
}

static outcome find_best(td_band_pixel *best, double *runner_up, const work *w, int i, int j)
{
    const td_match_options *o = w->options;
    td_band band;
    td_band_pixel peak[2];
    if (!search(&band, w, w->pair, w->a, w->b, i, j, o->near_m, o->far_m)) return NO_MEMORY;
    const size_t found = td_band_peaks(peak, 2, &band, o->half_window);
    td_band_free(&band);
    if (found == 0 || !(peak[0].score >= o->least_zncc)) return UNSEEN;
    *best = peak[0];
    *runner_up = found > 1 ? peak[1].score : NAN;
    return found > 1 && !(peak[1].score < o->uniqueness * peak[0].score) ? AMBIGUOUS : MATCHED;
}

/* Back from the right place no other left place may be better. The right camera's depths differ a little from
 * the left one's. */
static outcome check_back(const td_band_pixel *best, const work *w, int i, int j)
{
    const td_match_options *o = w->options;
    td_band band;
    bool other = false;
    if (!search(&band, w, &w->back, w->b, w->a, best->x, best->y, 0.8 * o->near_m, 1.25 * o->far_m))
        return NO_MEMORY;
    for (size_t n = 0; n < band.count && !other; n++)
        other = band.pixel[n].score > best->score &&
                (abs(band.pixel[n].x - i) > BACK_PX || abs(band.pixel[n].y - j) > BACK_PX);
    td_band_free(&band);
    return other ? ONE_SIDED : MATCHED;
}

static void match_point(size_t index, void *user)
{
    const work *w = user;
    const td_interest_point *p = &w->point[index];
    const int i = (int)floor(p->x + 0.5), j = (int)floor(p->y + 0.5);
    td_band_pixel best = {0, 0, 0};
    double runner_up = NAN;
    outcome v = find_best(&best, &runner_up, w, i, j);
    if (v == MATCHED) v = check_back(&best, w, i, j);
    if (v == MATCHED) {
        td_match *m = &w->match[index];
        *m = (td_match){.left = {p->x, p->y},
                        .right = {best.x + p->x - i, best.y + p->y - j},
                        .zncc = best.score,
                        .runner_up = runner_up};
        const double most = w->options->most_sigma_px;
        if (!td_match_refine(m, w->left, w->right, w->options->half_window))
            v = UNREFINED;
        else if (most > 0 && !(sqrt(m->covariance[0] + m->covariance[3]) <= most))
            v = UNSURE;
    }
    w->verdict[index] = v;
}

/* Moves the matches together and counts the rest. */
static td_status collect(td_match *match, size_t *count, td_match_tally *tally, const outcome *verdict,
                         size_t points, td_error *error)
{
    size_t n[NO_MEMORY + 1] = {0};
    for (size_t i = 0; i < points; i++) {
        if (verdict[i] == MATCHED) match[n[MATCHED]] = match[i];
        n[verdict[i]]++;
    }
    if (n[NO_MEMORY]) return td_fail(error, TD_ERROR_MEMORY, "no memory to match %zu points", points);
    *count = n[MATCHED];
    tally->unseen = n[UNSEEN];
    tally->ambiguous = n[AMBIGUOUS];
    tally->one_sided = n[ONE_SIDED];
    tally->unrefined = n[UNREFINED];
    tally->unsure = n[UNSURE];
    return TD_OK;
}

static void say_why_few(const td_log *log, size_t matches, const td_match_tally *t)
{
    if (t->left_points < 20)
        td_log_write(
            log, TD_LOG_WARNING, "match",
            "%zu interest points in the left image: is it in focus, lit and of something with texture?",
            t->left_points);
    else if (matches < t->left_points / 10)
        td_log_write(
            log, TD_LOG_WARNING, "match",
            "%zu of %zu points matched (%zu not found, %zu ambiguous): are left and right swapped, or the "
            "images of another rig or moment?",
            matches, t->left_points, t->unseen, t->ambiguous);
}

static td_status match_points(td_match **matches, size_t *count, td_match_tally *tally, work *w,
                              size_t points, td_error *error)
{
    w->match = calloc(points + 1, sizeof *w->match);
    w->verdict = calloc(points + 1, sizeof *w->verdict);
    td_status status = w->match && w->verdict
                           ? td_parallel_for(points, w->options->threads, match_point, w,
                                             w->options->progress, "matching points")
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu matches", points);
    if (status == TD_ERROR_CANCELLED) td_fail(error, status, "matching was cancelled");
    if (status == TD_OK) status = collect(w->match, count, tally, w->verdict, points, error);
    if (status == TD_OK)
        *matches = w->match;
    else
        free(w->match);
    free(w->verdict);
    return status;
}

td_status td_match_automatic(td_match **matches, size_t *count, td_match_tally *tally, const td_pair *pair,
                             const td_image *left, const td_image *right, const td_match_options *options,
                             td_error *error)
{
    td_match_options o = options ? *options : td_match_options_default();
    td_match_tally t = {0};
    td_interest_point *point = NULL;
    td_zncc_plane *a = NULL, *b = NULL;
    work w = {.pair = pair, .left = left, .right = right, .options = &o};
    TD_TRY(td_match_options_check(&o, error));
    TD_TRY(td_match_images_check(pair, left, right, error));
    TD_TRY(td_pair_init(&w.back, pair->rig, pair->right, pair->left, error));
    o.interest.threads = o.threads;
    td_status status = td_interest_points(&point, &t.left_points, left, &o.interest, error);
    if (status == TD_OK) status = td_zncc_plane_new(&a, left, o.half_window, error);
    if (status == TD_OK) status = td_zncc_plane_new(&b, right, o.half_window, error);
    w.a = a;
    w.b = b;
    w.point = point;
    if (status == TD_OK) status = match_points(matches, count, &t, &w, t.left_points, error);
    if (status == TD_OK) {
        say_why_few(o.log, *count, &t);
        if (tally) *tally = t;
    }
    td_zncc_plane_free(&a);
    td_zncc_plane_free(&b);
    free(point);
    return status;
}
