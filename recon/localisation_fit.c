/* The minimum of the registration and how sure it is. Unknowns are [omega; tau] about the rig's place: a
 * point p of the site moves by omega x (p - c) + tau. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "recon/localisation_internal.h"

enum {
    BAND = 10,
    TRIES = 6,
    LEAST_POINTS = 30
}; /* BAND: blocks whose errors are looked at together, each way */

static const double TUKEY = 4.685; /* 95 % efficient for normal errors */
static const double COMPARED = 1;  /* spread at which poses are compared */
static const double LEAST_M2 = 1e-8;
static const double SMALL_M = 1e-5, SMALL_RAD = 1e-6; /* steps that end the iteration */

/* What a block says at a pose. */
typedef struct residual {
    double r; /* m: above the map */
    double variance;
    double j[6];     /* of r by the unknowns */
    double own, map; /* m: its sigma of the point and of the map */
    double slope_variance, arm[3];
} residual;

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static bool look(residual *out, const td_registration *r, const td_block *b, const td_pose *pose)
{
    double p[3], axis[3], h, g[2], variance;
    td_pose_transform(p, pose, b->p);
    if (!td_ground_at(&h, g, &variance, r->level, p[0], p[1])) return false;
    const double v[3] = {-g[0], -g[1], 1};
    td_pose_rotate(axis, pose, b->axis);
    const double own = v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2];
    for (int k = 0; k < 3; k++) out->arm[k] = p[k] - pose->t[k];
    out->r = p[2] - h;
    out->slope_variance = r->level->slope_noise * variance;
    out->own = fabs(own);
    out->map = sqrt(variance);
    out->variance = own * own + variance + r->unevenness * r->unevenness + LEAST_M2;
    cross(out->j, out->arm, v);
    memcpy(out->j + 3, v, sizeof v);
    return true;
}

static double rho(double u)
{
    const double t = u * u / (TUKEY * TUKEY);
    return t < 1 ? 1 - (1 - t) * (1 - t) * (1 - t) : 1;
}

static double weight(double u) /* psi(u) / u */
{
    const double t = u * u / (TUKEY * TUKEY);
    return t < 1 ? (1 - t) * (1 - t) : 0;
}

static double curvature(double u) /* psi'(u) */
{
    const double t = u * u / (TUKEY * TUKEY);
    return t < 1 ? (1 - t) * (1 - 5 * t) : 0;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Spread of r / sigma by the 30 % quantile of its size, so that half of the points may be wrong without
 * widening it much; and how many points are known; `work` (count). */
static double spread(size_t *known, double *work, const td_registration *r, const td_pose *pose)
{
    residual at;
    *known = 0;
    for (size_t i = 0; i < r->count; i += r->step)
        if (look(&at, r, &r->block[i], pose)) work[(*known)++] = fabs(at.r) / sqrt(at.variance);
    if (!*known) return 1;
    qsort(work, *known, sizeof *work, by_value);
    return work[*known * 3 / 10] / 0.385320466407568;
}

/* Mean of rho; a point off the map counts as a wrong one, so that no pose is good that sees nothing. */
static double cost(const td_registration *r, const td_pose *pose, double scatter)
{
    double sum = 0, n = 0;
    residual at;
    for (size_t i = 0; i < r->count; i += r->step, n++)
        sum += look(&at, r, &r->block[i], pose) ? rho(at.r / (scatter * sqrt(at.variance))) : 1;
    return n > 0 ? sum / n : 1;
}

static void normal_equations(double n[36], double b[6], const td_registration *r, const td_pose *pose,
                             double scatter)
{
    residual at;
    memset(n, 0, 36 * sizeof *n);
    memset(b, 0, 6 * sizeof *b);
    for (size_t i = 0; i < r->count; i += r->step) {
        if (!look(&at, r, &r->block[i], pose)) continue;
        const double w = weight(at.r / (scatter * sqrt(at.variance))) / at.variance;
        for (int k = 0; k < 6; k++) {
            b[k] -= w * at.j[k] * at.r;
            for (int l = 0; l < 6; l++) n[6 * k + l] += w * at.j[k] * at.j[l];
        }
    }
}

/* Exp of a perturbation about the rig's own place. */
static td_pose moved(const td_pose *pose, const double x[6])
{
    td_pose out = *pose;
    const double turn[6] = {x[0], x[1], x[2], 0, 0, 0};
    const td_pose by = td_pose_exp(turn),
                  only = {{pose->q[0], pose->q[1], pose->q[2], pose->q[3]}, {0, 0, 0}};
    const td_pose turned = td_pose_compose(&by, &only);
    memcpy(out.q, turned.q, sizeof out.q);
    for (int k = 0; k < 3; k++) out.t[k] += x[3 + k];
    return out;
}

/* One step of Levenberg and Marquardt; false: none goes down. */
static bool go_down(td_pose *pose, double *step_m, double *step_rad, double *lambda, const td_registration *r,
                    double scatter)
{
    double n[36], b[6], inverse[36], x[6];
    const double now = cost(r, pose, scatter);
    normal_equations(n, b, r, pose, scatter);
    for (int k = 0; k < TRIES; k++, *lambda *= 10) {
        double damped[36];
        memcpy(damped, n, sizeof n);
        for (int i = 0; i < 6; i++) damped[7 * i] += *lambda * n[7 * i] + 1e-9;
        if (td_invert_spd(inverse, damped, 6, NULL) != TD_OK) continue;
        td_multiply(x, inverse, b, 6, 6, 1);
        const td_pose next = moved(pose, x);
        if (!(cost(r, &next, scatter) <= now)) continue;
        *pose = next;
        *lambda = fmax(*lambda / 10, 1e-6);
        *step_rad = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
        *step_m = sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5]);
        return true;
    }
    return false;
}

static void describe(td_fit_state *state, double *work, const td_registration *r, const td_pose *pose)
{
    residual at;
    double square = 0;
    state->scatter = spread(&state->known, work, r, pose);
    const double held = fmax(state->scatter, 1);
    state->cost = state->known < LEAST_POINTS ? 1 : cost(r, pose, COMPARED);
    state->used = 0;
    for (size_t i = 0; i < r->count; i += r->step) {
        if (!look(&at, r, &r->block[i], pose) || fabs(at.r) > TUKEY * held * sqrt(at.variance)) continue;
        square += at.r * at.r;
        state->used++;
    }
    state->rms_m = sqrt(square / fmax((double)state->used, 1));
}

td_status td_register(td_pose *pose, td_fit_state *state, const td_registration *r, int iterations,
                      td_error *error)
{
    double *work = malloc((r->count + 1) * sizeof *work), lambda = 1e-3;
    if (!work) return td_fail(error, TD_ERROR_MEMORY, "no memory for a registration");
    for (int i = 0; i < iterations; i++) {
        size_t known;
        double step_m = 0, step_rad = 0;
        const double scatter = fmax(spread(&known, work, r, pose), 1);
        if (known < LEAST_POINTS || !go_down(pose, &step_m, &step_rad, &lambda, r, scatter)) break;
        if (step_m < SMALL_M && step_rad < SMALL_RAD) break;
    }
    describe(state, work, r, pose);
    free(work);
    return TD_OK;
}

/* ---- covariance ---- */

/* What a block's error does to the pose: H^-1 times this times the error. On the blocks' grid; sigma 0: none.
 */
typedef struct score {
    double by[6];
    double own, map; /* m: sigma of its own height and of the map's under it */
    double x, y;     /* m, in the site */
    bool known;
} score;

/* Hessian, what noise of the map's slopes puts into it, and the scores. */
static void hessian(double h[36], double noise[36], score *scores, int columns, const td_registration *r,
                    const td_pose *pose, double scatter)
{
    static const double e[2][3] = {{1, 0, 0}, {0, 1, 0}};
    residual at;
    memset(h, 0, 36 * sizeof *h);
    memset(noise, 0, 36 * sizeof *noise);
    for (size_t i = 0; i < r->count; i++) {
        if (!look(&at, r, &r->block[i], pose)) continue;
        const double u = at.r / (scatter * sqrt(at.variance)), w = curvature(u) / at.variance;
        score *s = &scores[(size_t)r->block[i].row * (size_t)columns + (size_t)r->block[i].column];
        double arm[2][6];
        *s = (score){.known = true,
                     .own = at.own,
                     .map = at.map,
                     .x = pose->t[0] + at.arm[0],
                     .y = pose->t[1] + at.arm[1]};
        for (int k = 0; k < 2; k++) {
            cross(arm[k], at.arm, e[k]);
            memcpy(arm[k] + 3, e[k], sizeof e[k]);
        }
        for (int k = 0; k < 6; k++) {
            s->by[k] = weight(u) / at.variance * at.j[k];
            for (int l = 0; l < 6; l++) {
                h[6 * k + l] += w * at.j[k] * at.j[l];
                noise[6 * k + l] += w * at.slope_variance * (arm[0][k] * arm[0][l] + arm[1][k] * arm[1][l]);
            }
        }
    }
}

/* Covariance of two blocks' residuals. Means of neighbouring squares of white noise that was averaged over
 * such a square have a quarter of their variance in common, across a corner a sixteenth. */
static double shared(const score *a, const score *b, int dx, int dy, double map_correlation_m)
{
    static const double beside[2] = {1, 0.25};
    const double d2 = (a->x - b->x) * (a->x - b->x) + (a->y - b->y) * (a->y - b->y);
    const double own = abs(dx) <= 1 && abs(dy) <= 1 ? a->own * b->own * beside[abs(dx)] * beside[abs(dy)] : 0;
    const double ratio = d2 / (map_correlation_m * map_correlation_m);
    return own + (ratio < 12 ? a->map * b->map * exp(-ratio) : 0);
}

/* Covariance of the sum of the scores' errors. */
static void meat(double m[36], const score *scores, int columns, int rows, double map_correlation_m)
{
    memset(m, 0, 36 * sizeof *m);
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const score *s = &scores[(size_t)y * (size_t)columns + (size_t)x];
            double near[6] = {0};
            if (!s->known) continue;
            for (int v = y > BAND ? y - BAND : 0; v <= y + BAND && v < rows; v++)
                for (int u = x > BAND ? x - BAND : 0; u <= x + BAND && u < columns; u++) {
                    const score *o = &scores[(size_t)v * (size_t)columns + (size_t)u];
                    if (!o->known) continue;
                    const double c = shared(s, o, u - x, v - y, map_correlation_m);
                    for (int k = 0; k < 6; k++) near[k] += c * o->by[k];
                }
            for (int k = 0; k < 6; k++)
                for (int l = 0; l < 6; l++) m[6 * k + l] += 0.5 * (s->by[k] * near[l] + s->by[l] * near[k]);
        }
}

/* What the ground does not tell within the limits, were the slopes' noise twice what it is thought to be:
 * that information with a wide prior, so that a direction without any keeps its width. */
static td_status find_weak(unsigned *weak, const double h[36], const double noise[36], double scatter,
                           const td_localisation_options *o, td_error *error)
{
    double wide[6], scaled[36], value[6], vector[36];
    for (int k = 0; k < 6; k++) wide[k] = 10 * (k < 3 ? o->most_sigma_rad : o->most_sigma_m);
    for (int k = 0; k < 6; k++)
        for (int l = 0; l < 6; l++)
            scaled[6 * k + l] =
                wide[k] * wide[l] * (h[6 * k + l] - 2 * noise[6 * k + l]) / (scatter * scatter);
    TD_TRY(td_eigen_symmetric(value, vector, scaled, 6, error));
    *weak = 0;
    for (int k = 0; k < 6; k++) {
        double variance = 0;
        for (int i = 0; i < 6; i++)
            variance += vector[6 * i + k] * vector[6 * i + k] / (1 + fmax(value[i], 0));
        if (variance > 0.01) *weak |= 1u << k;
    }
    return TD_OK;
}

/* From about the rig's place to the site's origin: omega x (p - c) + tau = omega x p + (tau + c x omega). */
static td_status about_origin(double out[36], const double about_rig[36], const double c[3], td_error *error)
{
    const double a[36] = {1, 0,     0,    0, 0, 0, 0,    1, 0,     0, 0, 0, 0,     0,    1, 0, 0, 0,
                          0, -c[2], c[1], 1, 0, 0, c[2], 0, -c[0], 0, 1, 0, -c[1], c[0], 0, 0, 0, 1};
    return td_sandwich(out, a, about_rig, 6, 6, error);
}

td_status td_register_covariance(td_localisation *found, unsigned *weak, const td_registration *r,
                                 const td_localisation_options *options, td_error *error)
{
    int columns = 1, rows = 1;
    for (size_t i = 0; i < r->count; i++) {
        if (r->block[i].column >= columns) columns = r->block[i].column + 1;
        if (r->block[i].row >= rows) rows = r->block[i].row + 1;
    }
    double h[36], noise[36], m[36], inverse[36], about_rig[36];
    const double scatter = fmax(found->scatter, 1);
    score *scores = calloc((size_t)columns * (size_t)rows, sizeof *scores);
    if (!scores) return td_fail(error, TD_ERROR_MEMORY, "no memory for a registration");
    hessian(h, noise, scores, columns, r, &found->site_from_rig, scatter);
    meat(m, scores, columns, rows, r->level->correlation_m);
    free(scores);
    TD_TRY(find_weak(weak, h, noise, scatter, options, error));
    if (*weak) return TD_OK;
    for (int k = 0; k < 36; k++) h[k] -= noise[k];
    TD_TRY(td_invert_spd(inverse, h, 6, error));
    TD_TRY(td_sandwich(about_rig, inverse, m, 6, 6, error));
    for (int k = 0; k < 6; k++) {
        for (int l = 0; l < 6; l++) about_rig[6 * k + l] *= scatter * scatter;
        found->sigma[k] = sqrt(fmax(about_rig[7 * k], 0));
        if (found->sigma[k] > (k < 3 ? options->most_sigma_rad : options->most_sigma_m)) *weak |= 1u << k;
    }
    return about_origin(found->covariance, about_rig, found->site_from_rig.t, error);
}
