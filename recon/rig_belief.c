#include "recon/rig_belief.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

enum { LEAST_MATCHES = 30, ROUNDS = 10 };

static const double LEAST_NOISE_PX = 0.01;
static const double CUT = 3;      /* times the noise: beyond, a match is none */
static const double SEEN = 4;     /* least eigenvalue */
static const double RARE = 3.719; /* standard normal: one in ten thousand above */

struct td_rig_belief {
    const td_pair *pair;
    size_t n;     /* parameters of the rig */
    double *root; /* (n,n) covariance = root root^T */
    size_t count, room;
    double *row; /* (count, n+1) derivative by z; distance, px */
};

void td_rig_belief_free(td_rig_belief **belief)
{
    if (!belief || !*belief) return;
    free((*belief)->root);
    free((*belief)->row);
    free(*belief);
    *belief = NULL;
}

/* Of variances of other units: the correlation's eigenvectors, scaled back. */
static td_status factor(double *root, const double *covariance, size_t n, td_error *error)
{
    double *scaled = malloc((2 * n * n + 2 * n) * sizeof *scaled);
    if (!scaled) return td_fail(error, TD_ERROR_MEMORY, "no memory for a rig's covariance");
    double *vector = scaled + n * n, *value = vector + n * n, *sigma = value + n;
    for (size_t i = 0; i < n; i++) sigma[i] = sqrt(fmax(0, covariance[i * n + i]));
    for (size_t i = 0; i < n * n; i++) {
        const double s = sigma[i / n] * sigma[i % n];
        scaled[i] = s > 0 ? covariance[i] / s : 0;
    }
    const td_status status = td_eigen_symmetric(value, vector, scaled, n, error);
    for (size_t i = 0; i < n && status == TD_OK; i++)
        for (size_t k = 0; k < n; k++)
            root[i * n + k] = sigma[i] * sqrt(fmax(0, value[k])) * vector[k * n + i];
    free(scaled);
    return status;
}

td_status td_rig_belief_new(td_rig_belief **out, const td_pair *pair, td_error *error)
{
    *out = NULL;
    if (!pair->rig->covariance)
        return td_fail(error, TD_ERROR_DATA,
                       "the rig has no covariance: there is nothing to hold it against");
    td_rig_belief *b = calloc(1, sizeof *b);
    if (!b) return td_fail(error, TD_ERROR_MEMORY, "no memory for a rig's matches");
    b->pair = pair;
    b->n = td_rig_parameter_count(pair->rig);
    b->root = malloc(b->n * b->n * sizeof *b->root);
    td_status status = b->root ? factor(b->root, pair->rig->covariance, b->n, error)
                               : td_fail(error, TD_ERROR_MEMORY, "no memory for a rig's covariance");
    if (status != TD_OK) td_rig_belief_free(&b);
    *out = b;
    return status;
}

void td_rig_belief_clear(td_rig_belief *belief)
{
    belief->count = 0;
}

td_status td_rig_belief_add(td_rig_belief *b, const td_match *match, size_t count, td_error *error)
{
    const size_t n = b->n;
    double own[TD_RIG_MAX_CAMERAS * (TD_CAMERA_MAX_PARAMETERS + 6)];
    if (b->count + count > b->room) {
        const size_t room = 2 * (b->count + count);
        double *more = realloc(b->row, room * (n + 1) * sizeof *more);
        if (!more) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu matches", b->count + count);
        b->row = more;
        b->room = room;
    }
    for (size_t i = 0; i < count; i++) {
        double *row = b->row + b->count * (n + 1);
        if (!td_pair_residual(row + n, NULL, own, b->pair, match[i].left, match[i].right)) continue;
        if (!isfinite(row[n])) continue;
        for (size_t k = 0; k < n; k++) {
            row[k] = 0;
            for (size_t j = 0; j < n; j++) row[k] += own[j] * b->root[j * n + k];
        }
        b->count++;
    }
    return TD_OK;
}

/* ---- checked ---- */

typedef struct normal {
    double *m, *b, *z, *work; /* (n,n), (n), (n), (n,n); M, A^T d / s^2, the rig as it is found to be */
    double *off;              /* (count) px: what z does not explain */
    double *size;             /* (count) */
    double noise;
    size_t inliers;
} normal;

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void sum(normal *s, const td_rig_belief *b)
{
    const size_t n = b->n;
    memset(s->m, 0, n * n * sizeof *s->m);
    memset(s->b, 0, n * sizeof *s->b);
    s->inliers = 0;
    const double weight = 1 / (s->noise * s->noise);
    for (size_t i = 0; i < b->count; i++) {
        const double *row = b->row + i * (n + 1);
        if (!(fabs(s->off[i]) <= CUT * s->noise)) continue;
        s->inliers++;
        for (size_t k = 0; k < n; k++) {
            s->b[k] += weight * row[k] * row[n];
            for (size_t j = 0; j <= k; j++) s->m[k * n + j] += weight * row[k] * row[j];
        }
    }
    for (size_t k = 0; k < n; k++)
        for (size_t j = 0; j < k; j++) s->m[j * n + k] = s->m[k * n + j];
}

/* What z leaves, and its robust spread. */
static void find_off(normal *s, const td_rig_belief *b)
{
    const size_t n = b->n;
    for (size_t i = 0; i < b->count; i++) {
        const double *row = b->row + i * (n + 1);
        s->off[i] = row[n];
        for (size_t k = 0; k < n; k++) s->off[i] -= row[k] * s->z[k];
        s->size[i] = fabs(s->off[i]);
    }
    qsort(s->size, b->count, sizeof *s->size, by_value);
    s->noise = fmax(LEAST_NOISE_PX, 1.4826 * s->size[b->count / 2]);
}

/* z of most probability, without a belief in its size; then the noise anew. */
static td_status solve(normal *s, const td_rig_belief *b, td_error *error)
{
    static const double WEAK = 1e-3; /* of the belief: a rig that is far off is not held back */
    const size_t n = b->n;
    memcpy(s->work, s->m, n * n * sizeof *s->work);
    for (size_t k = 0; k < n; k++) s->work[(n + 1) * k] += WEAK;
    TD_TRY(td_invert_spd(s->work, s->work, n, error));
    for (size_t k = 0; k < n; k++) {
        s->z[k] = 0;
        for (size_t j = 0; j < n; j++) s->z[k] += s->work[k * n + j] * s->b[j];
    }
    find_off(s, b);
    return TD_OK;
}

/* Wilson and Hilferty 1931. */
static double chi_square_limit(int freedom)
{
    const double k = 2 / (9.0 * freedom), root = 1 - k + RARE * sqrt(k);
    return freedom * root * root * root;
}

static td_status judge(td_rig_belief_result *result, normal *s, const td_rig_belief *b, td_error *error)
{
    const size_t n = b->n;
    double square = 0;
    TD_TRY(td_eigen_symmetric(s->z, s->work, s->m, n, error));
    for (size_t k = 0; k < n; k++) {
        double along = 0;
        const double mu = s->z[k];
        if (!(mu > SEEN)) continue;
        for (size_t j = 0; j < n; j++) along += s->work[k * n + j] * s->b[j];
        square += along * along / (mu * mu + mu);
        result->freedom++;
    }
    result->inliers = s->inliers;
    result->noise_px = s->noise;
    if (!result->freedom) return TD_OK;
    result->sigmas = sqrt(square / result->freedom);
    result->limit = sqrt(chi_square_limit(result->freedom) / result->freedom);
    return TD_OK;
}

td_status td_rig_belief_check(td_rig_belief_result *result, const td_rig_belief *b, td_error *error)
{
    const size_t n = b->n;
    *result = (td_rig_belief_result){.matches = b->count};
    if (b->count < LEAST_MATCHES)
        return td_fail(error, TD_ERROR_DATA, "%zu matches are too few to check a rig by (%d)", b->count,
                       LEAST_MATCHES);
    double *memory = calloc(2 * n * n + 2 * n + 2 * b->count, sizeof *memory);
    if (!memory) return td_fail(error, TD_ERROR_MEMORY, "no memory to check a rig");
    normal s = {.m = memory,
                .work = memory + n * n,
                .b = memory + 2 * n * n,
                .z = memory + 2 * n * n + n,
                .off = memory + 2 * n * n + 2 * n,
                .size = memory + 2 * n * n + 2 * n + b->count};
    td_status status = TD_OK;
    find_off(&s, b);
    for (int i = 0; i < ROUNDS && status == TD_OK; i++) {
        sum(&s, b);
        status = solve(&s, b, error);
    }
    if (status == TD_OK) {
        sum(&s, b);
        status = judge(result, &s, b, error);
    }
    free(memory);
    return status;
}
