/* Views that do not belong to the others: the robot still moving, a pose of another moment, a board misread.
 *
 * The fit begins with the two thirds that agree best and takes in the rest as long as they lie where the
 * others say (a forward search: Atkinson and Riani 2000), so that bad views cannot hide one another; then the
 * worst of the used is judged by a fit without it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"

static void swap_fits(td_he_fit *a, td_he_fit *b)
{
    td_he_fit kept = *a;
    *a = *b;
    *b = kept;
}

/* By which share the variance of the best `share` of 6 normal components is too small: F_8(q) / F_6(q) at the
 * quantile q of chi-square of 6. */
static double truncation(double share)
{
    if (share >= 1) return 1;
    double low = 0, high = 60, y = 0;
    for (int k = 0; k < 60; k++) {
        y = (low + high) / 4; /* half of the middle */
        double below = 1 - exp(-y) * (1 + y + y * y / 2);
        if (below < share)
            low = 2 * y;
        else
            high = 2 * y;
    }
    return (1 - exp(-y) * (1 + y + y * y / 2 + y * y * y / 6)) / share;
}

double td_he_freedom(size_t used)
{
    return used > 3 ? 3 * (double)used - 6 : 3;
}

/* Orders by the residuals at `start`, each part over its median: the order is that of the views within the
 * used and the others alike. */
static td_status order_views(td_he_view *view, size_t n, size_t used, const td_he_state *start,
                             td_error *error)
{
    double *key = malloc(n * sizeof *key);
    td_he_view *sorted = malloc(n * sizeof *sorted);
    if (!key || !sorted) {
        free(key);
        free(sorted);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", n);
    }
    td_he_variance v = td_he_first_variance(view, n, start);
    for (size_t i = 0; i < n; i++) {
        double d[6];
        td_he_residual(d, &view[i], start);
        key[i] = 0;
        for (int k = 0; k < 6; k++) key[i] += d[k] * d[k] * exp(-2 * v.log[k / 3]);
    }
    size_t front = 0, back = used;
    for (size_t i = 0; i < n; i++) {
        size_t better = 0;
        for (size_t k = 0; k < n; k++) better += key[k] < key[i] || (key[k] == key[i] && k < i);
        sorted[better < used ? front++ : back++] = view[i];
    }
    memcpy(view, sorted, n * sizeof *view);
    free(key);
    free(sorted);
    return TD_OK;
}

/* Moves view `from` to place `to`, the ones between by one. */
static void move_view(td_he_view *view, size_t from, size_t to)
{
    td_he_view kept = view[from];
    if (from < to)
        memmove(view + from, view + from + 1, (to - from) * sizeof *view);
    else
        memmove(view + to + 1, view + to, (from - to) * sizeof *view);
    view[to] = kept;
}

/* Takes into the used views those others that lie within; tells how many. */
static size_t take_in(const td_he_fit *fit, td_he_view *view, size_t n, size_t *used, double outlier_sigma)
{
    size_t before = *used;
    double shrunk = truncation((double)before / (double)n);
    for (size_t i = before; i < n; i++) {
        double r[6], cov[36];
        td_he_predict_new(r, cov, fit, &view[i]);
        if (td_he_deviate(td_he_distance(r, cov) * shrunk, td_he_freedom(before)) > outlier_sigma) continue;
        size_t to = 0;
        while (to < *used && view[to].index < view[i].index) to++;
        move_view(view, i, to);
        (*used)++;
    }
    return *used - before;
}

td_status td_he_choose_views(td_he_fit *fit, td_he_view *view, size_t n, size_t *used,
                             const td_he_state *start, double outlier_sigma, td_error *error)
{
    *used = n;
    size_t least = n - n / 3;
    if (outlier_sigma > 0 && n > 4 && least < n) {
        *used = least < 4 ? 4 : least;
        TD_TRY(order_views(view, n, *used, start, error));
    }
    td_he_variance v = td_he_first_variance(view, *used, start);
    TD_TRY(td_he_fit_run(fit, view, *used, start, &v, false, error));
    while (*used < n && take_in(fit, view, n, used, outlier_sigma)) {
        td_he_state state = fit->state;
        v = fit->variance;
        td_he_fit_free(fit);
        TD_TRY(td_he_fit_run(fit, view, *used, &state, &v, false, error));
    }
    if (outlier_sigma > 0) td_he_drop_views(fit, view, used, least < 4 ? 4 : least, outlier_sigma);
    return TD_OK;
}

void td_he_drop_views(td_he_fit *fit, td_he_view *view, size_t *used, size_t least, double outlier_sigma)
{
    while (*used > least) {
        size_t worst = 0;
        double most = -1, r[6], cov[36];
        for (size_t i = 0; i < *used; i++) {
            if (!td_he_held_out(r, cov, fit, i)) continue;
            double square = td_he_distance(r, cov);
            if (square > most) {
                most = square;
                worst = i;
            }
        }
        /* Its own part in the variances makes a view's distance smaller, by no more than if it were all in
         * one of them: s for s_without v / (v + s_without). */
        double v = td_he_freedom(*used);
        if (most < v && td_he_deviate(most * v / (v - most), v) < outlier_sigma) return;
        td_he_fit without;
        move_view(view, worst, *used - 1);
        td_status status =
            td_he_fit_run(&without, view, *used - 1, &fit->state, &fit->variance, fit->linear.p > 12, NULL);
        bool outside = false;
        if (status == TD_OK) {
            td_he_predict_new(r, cov, &without, &view[*used - 1]);
            outside = td_he_deviate(td_he_distance(r, cov), td_he_freedom(*used - 1)) > outlier_sigma;
        }
        if (outside) {
            swap_fits(fit, &without);
            (*used)--;
        } else {
            move_view(view, *used - 1, worst);
        }
        td_he_fit_free(&without);
        if (!outside) return; /* what cannot be judged without it stays */
    }
}
