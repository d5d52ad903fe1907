/* A link's own ten parameters from the base parameters: those nearest to the prior's, and those of a body.
 *
 * A body's pseudo-inertia [Sigma h; h' m], Sigma = tr(I)/2 1 - I, is positive definite (Wensing, Kim,
 * Slotine 2018). Where what was identified is not, the nearest that is, in the estimate's own metric, is
 * found by Newton's method with a barrier -mu log det, mu falling. */
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/identification_internal.h"

enum { MOST_NEWTON = 60 };

/* ---- the pseudo-inertia ---- */

/* Of parameters in the order of sim/dynamics.h; row-major. */
static void pseudo_inertia(double j[16], const double p[10])
{
    const double half = (p[4] + p[7] + p[9]) / 2;
    const double rows[16] = {half - p[4], -p[5], -p[6],       p[1], -p[5], half - p[7], -p[8], p[2],
                             -p[6],       -p[8], half - p[9], p[3], p[1],  p[2],        p[3],  p[0]};
    memcpy(j, rows, sizeof rows);
}

/* Inverse in place and the logarithm of the determinant. False: not positive definite. */
static bool invert_body(double *log_det, double j[16])
{
    *log_det = 0;
    if (LAPACKE_dpotrf(LAPACK_ROW_MAJOR, 'L', 4, j, 4) != 0) return false;
    for (int i = 0; i < 4; i++) *log_det += 2 * log(j[5 * i]);
    if (LAPACKE_dpotri(LAPACK_ROW_MAJOR, 'L', 4, j, 4) != 0) return false;
    for (int i = 0; i < 4; i++)
        for (int k = i + 1; k < 4; k++) j[4 * i + k] = j[4 * k + i];
    return isfinite(*log_det);
}

static double trace_of(const double a[16], const double b[16])
{
    double sum = 0;
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 4; k++) sum += a[4 * i + k] * b[4 * k + i];
    return sum;
}

/* ---- nearest to the prior ---- */

typedef struct bodies {
    const td_id_model *m;
    int count;           /* 10 links */
    double *information; /* (count,count) in sizes */
    double *best;        /* (count) in sizes: where the quadratic is least */
    double *value;       /* (count) in sizes */
    double *gradient, *hessian, *step, *trial;
} bodies;

/* log det of all bodies at x (in sizes); false outside. */
static bool log_determinants(double *sum, const bodies *b, const double *x)
{
    *sum = 0;
    for (int i = 0; i < b->m->links; i++) {
        double p[10], j[16], one = 0;
        for (int k = 0; k < 10; k++) p[k] = x[10 * i + k] * b->m->size[10 * i + k];
        pseudo_inertia(j, p);
        if (!invert_body(&one, j)) return false;
        *sum += one;
    }
    return true;
}

static double distance(const bodies *b, const double *x)
{
    double sum = 0;
    for (int i = 0; i < b->count; i++)
        for (int k = 0; k < b->count; k++)
            sum += (x[i] - b->best[i]) * b->information[i * b->count + k] * (x[k] - b->best[k]);
    return sum / 2;
}

static void add_barrier(bodies *b, int link, double mu)
{
    double p[10], inverse[16], unit[10][16], moved[10][16], one = 0;
    for (int k = 0; k < 10; k++) p[k] = b->value[10 * link + k] * b->m->size[10 * link + k];
    pseudo_inertia(inverse, p);
    invert_body(&one, inverse);
    for (int k = 0; k < 10; k++) {
        double e[10] = {0};
        e[k] = b->m->size[10 * link + k];
        pseudo_inertia(unit[k], e);
        td_multiply(moved[k], inverse, unit[k], 4, 4, 4);
    }
    for (int k = 0; k < 10; k++) {
        b->gradient[10 * link + k] -= mu * trace_of(inverse, unit[k]);
        for (int l = 0; l < 10; l++)
            b->hessian[(10 * link + k) * b->count + 10 * link + l] += mu * trace_of(moved[k], moved[l]);
    }
}

/* One step of Newton; the decrement, or -1. */
static double newton(bodies *b, double mu)
{
    const size_t n = (size_t)b->count;
    double decrement = 0, now = 0, then = 0, length = 1;
    memcpy(b->hessian, b->information, n * n * sizeof *b->hessian);
    for (size_t i = 0; i < n; i++) {
        b->gradient[i] = 0;
        for (size_t k = 0; k < n; k++)
            b->gradient[i] += b->information[i * n + k] * (b->value[k] - b->best[k]);
    }
    for (int i = 0; i < b->m->links; i++) add_barrier(b, i, mu);
    for (size_t i = 0; i < n; i++) b->step[i] = -b->gradient[i];
    if (LAPACKE_dposv(LAPACK_ROW_MAJOR, 'L', (lapack_int)n, 1, b->hessian, (lapack_int)n, b->step, 1) != 0)
        return -1;
    for (size_t i = 0; i < n; i++) decrement -= b->gradient[i] * b->step[i];
    log_determinants(&now, b, b->value);
    const double before = distance(b, b->value) - mu * now;
    for (int round = 0; round < 60; round++, length /= 2) {
        for (size_t i = 0; i < n; i++) b->trial[i] = b->value[i] + length * b->step[i];
        if (log_determinants(&then, b, b->trial) && distance(b, b->trial) - mu * then <= before) {
            memcpy(b->value, b->trial, n * sizeof *b->value);
            return decrement;
        }
    }
    return -1;
}

/* From the prior, when that is of bodies, towards `best`. */
static void into_the_cone(bodies *b)
{
    double unused = 0;
    for (int i = 0; i < b->count; i++) b->value[i] = b->m->prior[i] / b->m->size[i];
    if (!log_determinants(&unused, b, b->value)) {
        memcpy(b->value, b->best, (size_t)b->count * sizeof *b->value);
        return;
    }
    for (double mu = 1; mu > 1e-4; mu /= 10)
        for (int round = 0; round < MOST_NEWTON; round++) {
            const double decrement = newton(b, mu);
            if (decrement < 1e-6 * mu) break;
        }
}

/* Posterior of the standard parameters (in sizes) from base parameters: of unit prior covariance, with
 * y = A x, covariance C: x = x0 + A' (A A' + C)^-1 (y - A x0). `gain` (standard,count). */
static td_status posterior(double *x, double *spread, double *work, const td_identification *id,
                           const td_id_model *m, const double *covariance, td_error *error)
{
    const size_t b = (size_t)m->count, s = (size_t)m->standard;
    double *a = work, *middle = a + b * s, *gain = middle + b * b, *turned = gain + s * b;
    for (size_t i = 0; i < b; i++)
        for (size_t c = 0; c < s; c++) {
            a[i * s + c] = m->group[i * s + c] * m->size[c] / m->base_size[i];
            turned[c * b + i] = a[i * s + c];
        }
    td_multiply_transposed(middle, a, a, b, s, b);
    for (size_t i = 0; i < b; i++)
        for (size_t k = 0; k < b; k++)
            middle[i * b + k] += covariance[i * b + k] / (m->base_size[i] * m->base_size[k]);
    TD_TRY(td_invert_spd(middle, middle, b, error));
    td_multiply(gain, turned, middle, s, b, b);
    for (size_t c = 0; c < s; c++) {
        x[c] = m->prior[c] / m->size[c];
        for (size_t i = 0; i < b; i++)
            x[c] += gain[c * b + i] * (id->parameter[i].value - m->base_prior[i]) / m->base_size[i];
        for (size_t d = 0; d < s; d++) {
            double sum = c == d;
            for (size_t i = 0; i < b; i++) sum -= gain[c * b + i] * a[i * s + d];
            spread[c * s + d] = sum;
        }
    }
    return TD_OK;
}

static void hand_over(td_identification *id, const td_id_model *m, const double *value, const double *spread)
{
    const int s = m->standard;
    id->link_count = m->links;
    for (int i = 0; i < m->links; i++) {
        id->link[i].link = m->link[i];
        for (int k = 0; k < 10; k++) {
            const int c = 10 * i + k;
            id->link[i].parameter[k] = value[c] * m->size[c];
            id->link[i].sigma[k] = sqrt(fmax(spread[c * s + c], 0)) * m->size[c];
        }
    }
}

/* The inertial part of the posterior's information. */
static td_status make_feasible(td_identification *id, const td_id_model *m, const double *x,
                               const double *spread, td_error *error)
{
    const size_t n = 10 * (size_t)m->links, s = (size_t)m->standard;
    double *work = calloc(2 * n * n + 5 * n, sizeof *work), unused = 0;
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for the links' parameters");
    bodies b = {
        .m = m, .count = (int)n, .information = work, .hessian = work + n * n, .best = work + 2 * n * n};
    b.value = b.best + n, b.gradient = b.value + n, b.step = b.gradient + n, b.trial = b.step + n;
    memcpy(b.best, x, n * sizeof *x);
    id->feasible = log_determinants(&unused, &b, b.best);
    td_status status = TD_OK;
    if (!id->feasible) {
        /* What a motion tells exactly has no spread: a little is added so that it can be inverted. */
        for (size_t i = 0; i < n; i++)
            for (size_t k = 0; k < n; k++)
                b.information[i * n + k] = spread[i * s + k] + (i == k ? 1e-10 : 0);
        status = td_invert_spd(b.information, b.information, n, error);
        if (status == TD_OK) into_the_cone(&b);
    }
    if (status == TD_OK) hand_over(id, m, id->feasible ? x : b.value, spread);
    free(work);
    return status;
}

td_status td_id_links(td_identification *id, const td_id_model *m, const double *covariance, td_error *error)
{
    const size_t b = (size_t)m->count, s = (size_t)m->standard;
    double *work = calloc(s + s * s + 3 * b * s + b * b, sizeof *work);
    id->link = calloc((size_t)m->links + 1, sizeof *id->link);
    td_status status =
        work && id->link ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the links' parameters");
    if (status == TD_OK) status = posterior(work, work + s, work + s + s * s, id, m, covariance, error);
    if (status == TD_OK) status = make_feasible(id, m, work, work + s, error);
    free(work);
    return status;
}
