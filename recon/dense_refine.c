/* Disparities to a small fraction of a pixel, by the grey values themselves, and how sure they are.
 *
 * Summed costs are biased on slopes (paths come from above and from the sides, not from below, so that a
 * disparity lags behind its plane by about a row) and pulled towards fractions of their own. Here each
 * matched pixel q is looked up in the right image at its own disparity; over the window around p the
 * residuals r and the slopes g say by how much all of them are off (least squares with a free offset of grey;
 * Lucas and Kanade 1981, the slope from both images):
 *
 *     delta(p) = - G_gr / G_gg,   G_ab = sum a b - sum a sum b / n.
 *
 * Every pixel of the window brings its own disparity, so slanted and curved surfaces stay as they are. Rows
 * that do not quite meet are measured first and allowed for (dense_refine_fit.c).
 *
 * Sigma's square is the sum of what the normal equation says and of what it cannot know, each times the
 * square of a factor (BY_NOISE … in dense_refine_loops_internal.h):
 *
 *     noise   s^2 / G_gg, s^2 the variance of the window's residuals; G_gg less what noise itself adds to it
 *     misfit  max(0, s^2 - 1.5 N) 81 / G_gg: residuals beyond the images' noise N, a line over grey that the
 *             pair itself gives, are of one piece (another surface, a reflection, sampling): no average over
 *             the window helps
 *     rows    the mean square of the rows' offset: along the rows, where it cannot be seen, a rectification
 *             is as wrong as across them
 *     bend    how far the pixel lies off the middle of its neighbours: an edge or a fold in the window
 *
 * The factors make sigma the 68 % quantile of the errors (quantile regression, Koenker & Bassett 1978) on two
 * real pairs (Teddy, Cones, their truth's rounding allowed for) and two rendered ones
 * (datasets/site-polyhedra, site-trench). On others it holds 67 % (Motorcycle), 68 and 69 % (rough ground
 * with much and little noise); where contrast is no more than noise it is too small. The factor of noise is
 * above 1, for rectification has made neighbours' noise alike. */
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/dense_refine_internal.h"

enum { BAND = 32, ROUNDS = 2 };

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

typedef struct refinement {
    const td_image *left, *right;
    td_disparity *result;
    const dense_loops *loops;
    float *value;                     /* (height,width) after this round */
    int16_t *slope, *residual, *with; /* (height,width) of dense_look */
    float *variance, *weight, *bend;  /* (height,width) of dense_trust, after the last round */
    float gain;
    dense_lift lift;
    dense_noise noise;
    bool last;    /* round: what sigma is made of is written too */
    bool *failed; /* (bands) */
} refinement;

static void band_of(int *begin, int *end, const refinement *w, size_t index)
{
    *begin = (int)index * BAND;
    *end = MIN(*begin + BAND, w->left->height);
}

static size_t row_of(const refinement *w, int y)
{
    return (size_t)y * (size_t)w->left->width;
}

/* Along the rows into `value`, then down the columns back into the result. */
static void smooth_along(size_t index, void *user)
{
    const refinement *w = user;
    const int width = w->left->width, side = REFINE_WINDOW;
    int y, end;
    for (band_of(&y, &end, w, index); y < end; y++) {
        float *to = w->value + row_of(w, y);
        const float *from = w->result->value + row_of(w, y);
        memcpy(to, from, (size_t)width * sizeof *to);
        w->loops->smooth(to, from, side, width - side, 1, side);
    }
}

static void smooth_down(size_t index, void *user)
{
    const refinement *w = user;
    const int width = w->left->width, last = w->left->height - 1;
    int y, end;
    for (band_of(&y, &end, w, index); y < end; y++)
        w->loops->smooth(w->result->value + row_of(w, y), w->value + row_of(w, y), 0, width, width,
                         MIN(MIN(y, last - y), REFINE_WINDOW));
}

static void look_band(size_t index, void *user)
{
    const refinement *w = user;
    const int width = w->left->width, last = w->left->height - 1;
    float *lift = malloc((size_t)width * sizeof *lift);
    int y, end;
    w->failed[index] = !lift;
    for (band_of(&y, &end, w, index); y < end && lift; y++) {
        const size_t at = row_of(w, y);
        const dense_look row = {.width = width,
                                .value = w->result->value + at,
                                .kind = w->result->kind + at,
                                .left = w->left->data + at,
                                .right = w->right->data + at,
                                .above = w->left->data + row_of(w, MAX(y - 1, 0)),
                                .below = w->left->data + row_of(w, MIN(y + 1, last)),
                                .lift = lift,
                                .gain = w->gain,
                                .slope = w->slope + at,
                                .residual = w->residual + at,
                                .with = w->with + at};
        dense_lift_row(lift, &w->lift, y, width, last + 1);
        for (int x = 0; x < width; x += width - 1) row.slope[x] = row.residual[x] = row.with[x] = 0;
        w->loops->look(&row);
    }
    free(lift);
}

static void add_row(int32_t *column, const refinement *w, int y, int sign)
{
    if (y < 0 || y >= w->left->height) return;
    const size_t at = row_of(w, y);
    w->loops->add(column, w->slope + at, w->residual + at, w->with + at, sign, w->left->width);
}

static void bend_row(const refinement *w, int y)
{
    const int width = w->left->width, last = w->left->height - 1;
    const float *value = w->result->value, *here = value + row_of(w, y), *side[8] = {NULL};
    float *bend = w->bend + row_of(w, y);
    for (int k = 0; k < 2; k++) {
        const int reach = 2 * k + 2, room = MIN(MIN(y, last - y), reach);
        side[4 * k] = here - reach, side[4 * k + 1] = here + reach;
        side[4 * k + 2] = value + row_of(w, y - room), side[4 * k + 3] = value + row_of(w, y + room);
    }
    memset(bend, 0, (size_t)width * sizeof *bend); /* no window reaches the border */
    w->loops->bend(bend, here, side, REFINE_WINDOW, width - REFINE_WINDOW);
}

static void step_band(size_t index, void *user)
{
    const refinement *w = user;
    const int width = w->left->width;
    const size_t sums = REFINE_SUMS * (size_t)width;
    int32_t *column = calloc(2 * sums + 2 * (size_t)width, sizeof *column), *sum = column + sums;
    int y, end;
    w->failed[index] = !column;
    if (!column) return;
    band_of(&y, &end, w, index);
    for (int k = y - REFINE_WINDOW; k < y + REFINE_WINDOW; k++) add_row(column, w, k, 1);
    for (; y < end; y++) {
        const size_t at = row_of(w, y);
        add_row(column, w, y + REFINE_WINDOW, 1);
        for (int k = 0; k < REFINE_SUMS; k++)
            w->loops->across(sum + k * width, column + k * width, sum + REFINE_SUMS * width, width);
        add_row(column, w, y - REFINE_WINDOW, -1);
        w->loops->step(w->value + at, w->result->value + at, sum, w->with + at, width);
        if (!w->last) continue;
        w->loops->vary(w->variance + at, w->weight + at, sum, w->with + at, width);
        bend_row(w, y);
    }
    free(column);
}

static void trust_band(size_t index, void *user)
{
    const refinement *w = user;
    int y, end;
    for (band_of(&y, &end, w, index); y < end; y++) {
        const size_t at = row_of(w, y);
        const dense_trust row = {.variance = w->variance + at,
                                 .weight = w->weight + at,
                                 .bend = w->bend + at,
                                 .grey = w->left->data + at,
                                 .base = w->noise.base,
                                 .rate = w->noise.rate,
                                 .rows = w->lift.square};
        w->loops->trust(w->result->sigma + at, &row, w->left->width);
    }
}

/* Runs `task` over all bands; false: no memory. */
static bool run(refinement *w, void (*task)(size_t, void *), int threads)
{
    const size_t bands = ((size_t)w->left->height + BAND - 1) / BAND;
    bool fine = true;
    td_parallel_for(bands, threads, task, w, NULL, NULL);
    for (size_t k = 0; k < bands; k++) fine &= !w->failed[k];
    return fine;
}

static bool refine(refinement *w, int threads)
{
    const size_t pixels = (size_t)w->left->width * (size_t)w->left->height;
    w->gain = dense_fit_gain(w->left, w->right, w->result);
    for (int k = 0; k < ROUNDS; k++) {
        w->last = k + 1 == ROUNDS;
        run(w, smooth_along, threads);
        run(w, smooth_down, threads);
        if (!run(w, look_band, threads)) return false;
        if (k == 0) dense_fit_lift(&w->lift, w->left, w->slope, w->residual, w->with, threads);
        if (!run(w, step_band, threads)) return false;
        memcpy(w->result->value, w->value, pixels * sizeof *w->value);
    }
    if (!dense_fit_noise(&w->noise, w->left, w->variance)) return false;
    return run(w, trust_band, threads);
}

td_status dense_refine(td_disparity *result, const td_image *left, const td_image *right,
                       const dense_loops *loops, int threads)
{
    const size_t pixels = (size_t)left->width * (size_t)left->height,
                 bands = ((size_t)left->height + BAND - 1) / BAND;
    refinement w = {.left = left, .right = right, .result = result, .loops = loops};
    if (left->width <= REFINE_SIDE) return TD_OK;
    float *planes = malloc(pixels * DENSE_REFINE_BYTES);
    w.failed = calloc(bands, sizeof *w.failed);
    bool fine = planes && w.failed;
    if (fine) {
        w.value = planes, w.variance = planes + pixels, w.weight = planes + 2 * pixels;
        w.bend = planes + 3 * pixels;
        w.slope = (int16_t *)(planes + 4 * pixels);
        w.residual = w.slope + pixels, w.with = w.residual + pixels;
        fine = refine(&w, threads);
    }
    free(planes);
    free(w.failed);
    return fine ? TD_OK : TD_ERROR_MEMORY;
}
