/* Guided matching (the paper's 3.4): a person's point, ranked candidates on its epipolar curve. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/match_internal.h"
#include "recon/zncc.h"

#define SAME_PLACE_PX 1.0 /* two candidates that refinement brought nearer than this are one */

static td_status check_point(const double point[2], const td_image *left, int k, td_error *error)
{
    const double x = point[0], y = point[1];
    if (!(x >= -0.5 && y >= -0.5 && x < left->width - 0.5 && y < left->height - 0.5))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "point (%g, %g): outside the left image of %d x %d pixels; pick one inside", x, y,
                       left->width, left->height);
    const int i = (int)floor(x + 0.5), j = (int)floor(y + 0.5);
    if (i < k || j < k || i >= left->width - k || j >= left->height - k)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "point (%g, %g): nearer than the window's %d px to the left image's edge; pick one "
                       "further in or make the window smaller",
                       x, y, k);
    return TD_OK;
}

static void set_runner_up(td_match *candidate, size_t count, double next)
{
    for (size_t i = 0; i < count; i++)
        candidate[i].runner_up = i > 0 ? candidate[0].zncc : count > 1 ? candidate[1].zncc : next;
}

/* Refines all; of those that meet at one place the better stays. */
static size_t refine_all(td_match *candidate, size_t count, const td_image *left, const td_image *right,
                         int k)
{
    size_t kept = 0;
    for (size_t i = 0; i < count; i++) {
        bool again = false;
        td_match_refine(&candidate[i], left, right, k);
        for (size_t n = 0; n < kept && !again; n++)
            again = hypot(candidate[i].right[0] - candidate[n].right[0],
                          candidate[i].right[1] - candidate[n].right[1]) < SAME_PLACE_PX;
        if (!again) candidate[kept++] = candidate[i];
    }
    return kept;
}

static size_t from_peaks(td_match *candidate, const td_band_pixel *peak, size_t count, const double point[2],
                         const int pixel[2], double least)
{
    size_t n = 0;
    for (; n < count && peak[n].score >= least; n++) {
        candidate[n] = (td_match){.left = {point[0], point[1]},
                                  .right = {peak[n].x + point[0] - pixel[0], peak[n].y + point[1] - pixel[1]},
                                  .covariance = {NAN, NAN, NAN, NAN},
                                  .zncc = peak[n].score,
                                  .runner_up = NAN};
    }
    return n;
}

/* For one point the paper's formula as it stands is faster than window sums of whole images. */
typedef struct window {
    const td_image *left, *right;
    int i, j, k;
} window;

static double score_window(int x, int y, const void *user)
{
    const window *w = user;
    return td_zncc(w->left, w->i, w->j, w->right, x, y, w->k);
}

static td_status rank(td_match **candidates, size_t *count, const td_band *band, const td_image *left,
                      const td_image *right, const double point[2], const int pixel[2],
                      const td_match_options *o, td_error *error)
{
    td_match *list = malloc((o->candidates + 1) * sizeof *list);
    td_band_pixel *peak = malloc((o->candidates + 1) * sizeof *peak);
    if (!list || !peak) {
        free(list);
        free(peak);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu candidates", o->candidates);
    }
    const size_t peaks = td_band_peaks(peak, o->candidates + 1, band, o->half_window);
    const size_t most = peaks < o->candidates ? peaks : o->candidates;
    const size_t n = from_peaks(list, peak, most, point, pixel, o->least_zncc);
    set_runner_up(list, n, peaks > n ? peak[n].score : NAN);
    *count = refine_all(list, n, left, right, o->half_window);
    *candidates = list;
    free(peak);
    return TD_OK;
}

td_status td_match_guided(td_match **candidates, size_t *count, const td_pair *pair, const td_image *left,
                          const td_image *right, const double point[2], const td_match_options *options,
                          td_error *error)
{
    const td_match_options o = options ? *options : td_match_options_default();
    TD_TRY(td_match_options_check(&o, error));
    TD_TRY(td_match_images_check(pair, left, right, error));
    TD_TRY(check_point(point, left, o.half_window, error));
    const int pixel[2] = {(int)floor(point[0] + 0.5), (int)floor(point[1] + 0.5)};
    const window w = {left, right, pixel[0], pixel[1], o.half_window};
    const td_band_range range = {o.near_m, o.far_m, td_match_band_px(pair, pixel[0], pixel[1], &o)};
    td_band band;
    if (!td_band_search(&band, pair, pixel[0], pixel[1], &range, score_window, &w))
        return td_fail(error, TD_ERROR_MEMORY, "no memory to search along an epipolar curve");
    const td_status status = rank(candidates, count, &band, left, right, point, pixel, &o, error);
    td_band_free(&band);
    return status;
}
