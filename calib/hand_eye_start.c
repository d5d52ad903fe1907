/* Where to begin: closed forms over all views and over small sets of them, judged by the medians of the
 * residuals, so that a few bad views spoil neither (least median of squares: Rousseeuw 1984). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"
#include "core/random.h"

enum { SETS = 60, SET_SIZE = 4, MOST_PARTNERS = 40 };

/* A motion of the hand and of the sight between views i and k: a near = near b. */
static void motion(td_pose *a, td_pose *b, const td_he_view *vi, const td_he_view *vk)
{
    td_pose hand_back = td_pose_inverse(&vk->hand), sight_back = td_pose_inverse(&vi->sight);
    *a = td_pose_compose(&hand_back, &vi->hand);
    *b = td_pose_compose(&vk->sight, &sight_back);
}

/* Rotation of near: the nearest to sum alpha beta^T over the motions' rotation vectors (Park and Martin
 * 1994). Motions near half a turn, whose vectors change sign, are left out. */
static bool closed_rotation(double r[9], const td_he_view *view, const size_t *index, size_t m)
{
    double sum[9] = {0};
    size_t stride = 1 + m / MOST_PARTNERS;
    for (size_t i = 0; i < m; i++)
        for (size_t k = i + 1; k < m; k += stride) {
            td_pose a, b;
            double alpha[3], beta[3];
            motion(&a, &b, &view[index[i]], &view[index[k]]);
            if (td_pose_angle(&a) > 3.0 || td_pose_angle(&b) > 3.0) continue;
            td_rotation_log(alpha, a.q);
            td_rotation_log(beta, b.q);
            for (int u = 0; u < 3; u++)
                for (int v = 0; v < 3; v++) sum[3 * u + v] += alpha[u] * beta[v];
        }
    return td_nearest_rotation(r, sum, NULL) == TD_OK;
}

/* Translation of near: (R_a - I) t = R t_b - t_a over the motions. */
static bool closed_translation(double t[3], const double r[9], const td_he_view *view, const size_t *index,
                               size_t m)
{
    double normal[9] = {0}, right[3] = {0}, inverse[9], log_det;
    size_t stride = 1 + m / MOST_PARTNERS;
    for (size_t i = 0; i < m; i++)
        for (size_t k = i + 1; k < m; k += stride) {
            td_pose a, b;
            double ra[9];
            motion(&a, &b, &view[index[i]], &view[index[k]]);
            td_pose_rotation(ra, &a);
            for (int d = 0; d < 3; d++) ra[4 * d] -= 1;
            for (int u = 0; u < 3; u++) {
                double y = -a.t[u];
                for (int v = 0; v < 3; v++) y += r[3 * u + v] * b.t[v];
                for (int v = 0; v < 3; v++) {
                    right[v] += ra[3 * u + v] * y;
                    for (int w = 0; w < 3; w++) normal[3 * v + w] += ra[3 * u + v] * ra[3 * u + w];
                }
            }
        }
    if (!td_he_invert(inverse, &log_det, normal, 3)) return false;
    for (int u = 0; u < 3; u++)
        t[u] = inverse[3 * u] * right[0] + inverse[3 * u + 1] * right[1] + inverse[3 * u + 2] * right[2];
    return true;
}

/* far: the mean of hand near sight. */
static bool mean_far(td_pose *far, const td_pose *near, const td_he_view *view, const size_t *index, size_t m)
{
    double sum[9] = {0}, t[3] = {0}, r[9];
    for (size_t i = 0; i < m; i++) {
        td_pose a = td_pose_compose(&view[index[i]].hand, near);
        td_pose one = td_pose_compose(&a, &view[index[i]].sight);
        td_pose_rotation(r, &one);
        for (int k = 0; k < 9; k++) sum[k] += r[k];
        for (int k = 0; k < 3; k++) t[k] += one.t[k] / (double)m;
    }
    if (td_nearest_rotation(r, sum, NULL) != TD_OK) return false;
    *far = td_pose_from_rotation(r, t);
    return true;
}

static bool closed_form(td_he_state *state, const td_he_view *view, const size_t *index, size_t m)
{
    double r[9], t[3];
    if (!closed_rotation(r, view, index, m) || !closed_translation(t, r, view, index, m)) return false;
    *state = (td_he_state){.near = td_pose_from_rotation(r, t), .scale = 1};
    return mean_far(&state->far, &state->near, view, index, m);
}

typedef struct ranked {
    double key;
    size_t index;
} ranked;

static int by_key(const void *a, const void *b)
{
    const ranked *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return (x->index > y->index) - (x->index < y->index);
}

/* Sum of the logarithms of the medians of the squared residuals in rotation and in translation; `rank`
 * receives the views, those that fit best first. */
static double score(ranked *rank, double *square, const td_he_view *view, size_t n, const td_he_state *state)
{
    double total = 0, median[2];
    for (size_t i = 0; i < n; i++) {
        double d[6];
        td_he_residual(d, &view[i], state);
        square[2 * i] = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        square[2 * i + 1] = d[3] * d[3] + d[4] * d[4] + d[5] * d[5];
    }
    for (size_t half = 0; half < 2; half++) {
        for (size_t i = 0; i < n; i++) rank[i] = (ranked){square[2 * i + half], i};
        qsort(rank, n, sizeof *rank, by_key);
        median[half] = fmax(rank[n / 2].key, 1e-16);
        total += log(median[half]);
    }
    for (size_t i = 0; i < n; i++)
        rank[i] = (ranked){square[2 * i] / median[0] + square[2 * i + 1] / median[1], i};
    qsort(rank, n, sizeof *rank, by_key);
    return isfinite(total) ? total : INFINITY;
}

/* Takes over a closed form when it scores better. */
static void try_set(td_he_state *best, double *least, ranked *rank, double *square, const td_he_view *view,
                    size_t n, const size_t *index, size_t m)
{
    td_he_state state;
    if (!closed_form(&state, view, index, m)) return;
    double s = score(rank, square, view, n, &state);
    if (s < *least) {
        *least = s;
        *best = state;
    }
}

td_status td_he_start(td_he_state *state, const td_he_view *view, size_t n, td_error *error)
{
    ranked *rank = calloc(n + 1, sizeof *rank + 2 * sizeof(double) + sizeof(size_t));
    if (!rank) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", n);
    double *square = (double *)(rank + n), least = INFINITY;
    size_t *index = (size_t *)(square + 2 * n), m = n < 6 ? 3 : SET_SIZE;
    for (size_t i = 0; i < n; i++) index[i] = i;
    try_set(state, &least, rank, square, view, n, index, n);
    td_random random = td_random_seed(1, 1);
    for (int set = 0; set < SETS && n > 3; set++) {
        for (size_t i = 0; i < m; i++) { /* the first m of a shuffle */
            size_t k = i + td_random_below(&random, (uint32_t)(n - i)), kept = index[i];
            index[i] = index[k];
            index[k] = kept;
        }
        try_set(state, &least, rank, square, view, n, index, m);
    }
    for (int round = 0; round < 3 && isfinite(least); round++) { /* all of the better half */
        (void)score(rank, square, view, n, state);
        size_t half = n / 2 + 2 < n ? n / 2 + 2 : n;
        for (size_t i = 0; i < half; i++) index[i] = rank[i].index;
        try_set(state, &least, rank, square, view, n, index, half);
    }
    free(rank);
    if (!isfinite(least))
        return td_fail(error, TD_ERROR_DATA,
                       "no start is found from %zu views: turn the hand about at least two axes between them",
                       n);
    return TD_OK;
}
