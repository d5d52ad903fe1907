/* A lens is said to have no distortion, but not how well that is known. In each view its two radial terms are
 * random numbers of mean 0 and one variance, which is estimated beside the points' common noise by restricted
 * maximum likelihood (Patterson and Thompson 1971), by expectation and maximisation (Dempster, Laird and
 * Rubin 1977): a term's expected square is its estimate's square and its variance, a residual's likewise. Of
 * a lens that truly has none the variance tends to nothing, and the poses to those of the exact camera. What
 * all views have in common about the lens is not used: that is lens_check's. */
#include "calib/unsure_lens_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

enum { TERMS = 2, FIRST_TERM = 4, ROW = 6 + TERMS, MOST_UNKNOWNS = 6 + TERMS * TD_RIG_MAX_CAMERAS };
enum { MOST_ROUNDS = 100, LAST_STEPS = 20 };

static const double FIRST_BEND = 0.03, MOST_BEND = 0.1, LEAST_BEND = 1e-5; /* share of the corner's radius */
static const double LEAST_NOISE = 1e-3;                                    /* px: rounding */
static const double SAME = 1e-4;  /* of the two standard deviations, at which the rounds end */
static const double STILL = 1e-9; /* a step of the poses, at which these rest */

typedef struct camera_lens {
    td_camera camera; /* brown5 where it is plain */
    double corner;    /* square of the image corner's distance from the axis, at a depth of 1 */
    int column;       /* of its first term among a view's unknowns; 0: it is not plain */
} camera_lens;

typedef struct unsure {
    const td_bundle *bundle;
    camera_lens *lens;  /* (cameras) */
    td_view_pose *out;  /* (views) */
    int unknowns;       /* of a view */
    td_pose *pose;      /* (views) in the bundle's frame */
    double *term;       /* (views,unknowns) the first six unused */
    double *covariance; /* (views,unknowns,unknowns) */
    double noise, bend;
} unsure;

bool td_camera_is_plain(const td_camera *camera)
{
    if (camera->model == TD_CAMERA_PINHOLE) return true;
    if (camera->model != TD_CAMERA_BROWN5) return false;
    for (int k = FIRST_TERM; k < td_camera_parameter_count(camera->model); k++)
        if (camera->parameter[k] != 0) return false;
    return true;
}

static double corner_square(const td_camera *c)
{
    const double *p = c->parameter;
    double x = fmax(p[2], c->width - 1 - p[2]) / p[0], y = fmax(p[3], c->height - 1 - p[3]) / p[1];
    return x * x + y * y;
}

static int take_lenses(camera_lens *lens, const td_bundle *b)
{
    int unknowns = 6;
    for (int c = 0; c < b->rig->count; c++) {
        lens[c] = (camera_lens){.camera = b->rig->camera[c].camera};
        if (!td_camera_is_plain(&lens[c].camera)) continue;
        lens[c].corner = corner_square(&lens[c].camera);
        lens[c].camera.model = TD_CAMERA_BROWN5;
        memset(lens[c].camera.parameter + FIRST_TERM, 0, 5 * sizeof(double));
        lens[c].column = unknowns;
        unknowns += TERMS;
    }
    return unknowns;
}

/* The camera with the terms of a view. */
static td_camera bent(const camera_lens *lens, const double *term)
{
    td_camera camera = lens->camera;
    for (int k = 0; k < TERMS && lens->column; k++)
        camera.parameter[FIRST_TERM + k] = term[lens->column + k] / pow(lens->corner, k + 1);
    return camera;
}

/* Residual of a point, px, and its derivatives by the pose and by its camera's terms. */
static bool point_rows(double r[2], double j[2 * ROW], const unsure *u, size_t v, int c,
                       const td_camera *camera, size_t k)
{
    const td_bundle *b = u->bundle;
    const td_detection *d = td_observations_get(b->observations, v, c);
    const td_pose *from_rig = &b->rig->camera[c].camera_from_rig;
    double p[3], x[3], y[3], pixel[2], by_y[6], by_x[6], turn[9], by_pose[18], jp[12];
    double by_camera[2 * TD_CAMERA_MAX_PARAMETERS];
    const int parameters = td_camera_parameter_count(camera->model);
    td_bundle_target_point(p, b, v, k);
    td_pose_transform(x, &u->pose[v], p);
    td_pose_transform(y, from_rig, x);
    if (!td_camera_project(pixel, by_y, by_camera, camera, y)) return false;
    td_pose_rotation(turn, from_rig);
    td_multiply(by_x, by_y, turn, 2, 3, 3);
    td_pose_transform_jacobian(by_pose, x);
    td_multiply(jp, by_x, by_pose, 2, 3, 6);
    for (int a = 0; a < 2; a++) {
        r[a] = pixel[a] - d->point[2 * k + (size_t)a];
        memcpy(j + ROW * a, jp + 6 * a, 6 * sizeof *j);
        for (int t = 0; t < TERMS; t++)
            j[ROW * a + 6 + t] =
                u->lens[c].column ? by_camera[parameters * a + FIRST_TERM + t] / pow(u->lens[c].corner, t + 1)
                                  : 0;
    }
    return true;
}

/* Number among a view's unknowns of a row's entry. */
static int column_of(const camera_lens *lens, int entry)
{
    return entry < 6 ? entry : lens->column + entry - 6;
}

static double own_variance(const unsure *u, size_t v, int c, size_t k)
{
    double s = td_observations_get(u->bundle->observations, v, c)->sigma[k];
    return s * s;
}

/* Normal equations of a view, the terms' prior included. False where a point has no image. */
static bool view_equations(double *normal, double *right, const unsure *u, size_t v)
{
    const td_bundle *b = u->bundle;
    const int n = u->unknowns;
    const size_t points = td_target_point_count(&b->observations->target);
    const double *term = u->term + v * (size_t)n;
    memset(normal, 0, (size_t)(n * n) * sizeof *normal);
    for (int a = 0; a < n; a++) right[a] = a < 6 ? 0 : -term[a] / (u->bend * u->bend);
    for (int a = 6; a < n; a++) normal[(n + 1) * a] = 1 / (u->bend * u->bend);
    for (int c = 0; c < b->rig->count; c++) {
        const camera_lens *lens = &u->lens[c];
        const td_camera camera = bent(lens, term);
        const int row = lens->column ? ROW : 6;
        for (size_t k = 0; k < points; k++) {
            double r[2], j[2 * ROW];
            if (!b->used[td_bundle_index(b, v, c, k)]) continue;
            if (!point_rows(r, j, u, v, c, &camera, k)) return false;
            const double weight = 1 / (own_variance(u, v, c, k) + u->noise * u->noise);
            for (int i = 0; i < 2; i++)
                for (int a = 0; a < row; a++) {
                    double left = weight * j[ROW * i + a];
                    right[column_of(lens, a)] -= left * r[i];
                    for (int e = 0; e < row; e++)
                        normal[n * column_of(lens, a) + column_of(lens, e)] += left * j[ROW * i + e];
                }
        }
    }
    return true;
}

/* A Gauss-Newton step of a view; its length goes to *moved. */
static bool step_view(double *moved, unsure *u, size_t v)
{
    const size_t n = (size_t)u->unknowns;
    double normal[MOST_UNKNOWNS * MOST_UNKNOWNS], right[MOST_UNKNOWNS], step[MOST_UNKNOWNS];
    double *covariance = u->covariance + v * n * n;
    if (!view_equations(normal, right, u, v) || td_invert_spd(covariance, normal, n, NULL) != TD_OK)
        return false;
    td_multiply(step, covariance, right, n, n, 1);
    *moved = 0;
    for (size_t a = 0; a < n; a++) {
        if (a >= 6) u->term[v * n + a] += step[a];
        *moved = fmax(*moved, fabs(step[a]));
    }
    u->pose[v] = td_pose_perturb(&u->pose[v], step);
    return isfinite(*moved);
}

/* Sums of the expected squares of the common noise and of the terms, their numbers, and of residuals. */
typedef struct moments {
    double noise, rows, bend, terms, square, points;
} moments;

static bool add_moments(moments *m, const unsure *u, size_t v)
{
    const td_bundle *b = u->bundle;
    const size_t n = (size_t)u->unknowns, points = td_target_point_count(&b->observations->target);
    const double *term = u->term + v * n, *covariance = u->covariance + v * n * n;
    const double common = u->noise * u->noise;
    for (int c = 0; c < b->rig->count; c++) {
        const camera_lens *lens = &u->lens[c];
        const td_camera camera = bent(lens, term);
        const int row = lens->column ? ROW : 6;
        for (size_t k = 0; k < points; k++) {
            double r[2], j[2 * ROW];
            if (!b->used[td_bundle_index(b, v, c, k)]) continue;
            if (!point_rows(r, j, u, v, c, &camera, k)) return false;
            const double share = common / (own_variance(u, v, c, k) + common);
            for (int i = 0; i < 2; i++) {
                double spread = 0;
                for (int a = 0; a < row; a++)
                    for (int e = 0; e < row; e++)
                        spread += j[ROW * i + a] * j[ROW * i + e] *
                                  covariance[n * (size_t)column_of(lens, a) + (size_t)column_of(lens, e)];
                m->noise += share * share * (r[i] * r[i] + spread) + common * (1 - share);
                m->square += r[i] * r[i];
                m->rows++;
            }
            m->points++;
        }
    }
    for (size_t a = 6; a < n; a++, m->terms++) m->bend += term[a] * term[a] + covariance[(n + 1) * a];
    return true;
}

/* One step of all views and of the two variances; *change is the larger of these' changes, as a share. */
static bool one_round(double *change, unsure *u)
{
    moments m = {0};
    double moved;
    for (size_t v = 0; v < u->bundle->observations->view_count; v++)
        if (u->out[v].seen && (!step_view(&moved, u, v) || !add_moments(&m, u, v))) return false;
    if (!(m.rows > 0)) return false;
    const double noise = fmax(sqrt(m.noise / m.rows), LEAST_NOISE);
    const double bend = fmin(fmax(sqrt(m.bend / m.terms), LEAST_BEND), MOST_BEND);
    *change = fmax(fabs(noise / u->noise - 1), fabs(bend / u->bend - 1));
    u->noise = noise;
    u->bend = bend;
    return true;
}

/* The poses at rest at the variances found, with what is told of them. */
static bool finish(unsure *u)
{
    const size_t n = (size_t)u->unknowns;
    for (size_t v = 0; v < u->bundle->observations->view_count; v++) {
        moments m = {0};
        double moved = INFINITY;
        if (!u->out[v].seen) continue;
        for (int i = 0; i < LAST_STEPS && moved > STILL; i++)
            if (!step_view(&moved, u, v)) return false;
        if (moved > STILL || !add_moments(&m, u, v)) return false;
        u->out[v].rms_px = sqrt(m.square / m.points);
        for (size_t a = 0; a < 6; a++)
            for (size_t e = 0; e < 6; e++)
                u->out[v].covariance[6 * a + e] = u->covariance[n * n * v + n * a + e];
    }
    return true;
}

static bool estimate(unsure *u)
{
    double change = INFINITY;
    for (int i = 0; i < MOST_ROUNDS && change > SAME; i++)
        if (!one_round(&change, u)) return false;
    return finish(u);
}

td_status td_unsure_lens_refine(td_view_pose *pose, double *bend, td_bundle *b, double noise, td_error *error)
{
    const size_t views = b->observations->view_count;
    camera_lens lens[TD_RIG_MAX_CAMERAS];
    unsure u = {
        .bundle = b, .lens = lens, .unknowns = take_lenses(lens, b), .noise = noise, .bend = FIRST_BEND};
    const size_t n = (size_t)u.unknowns;
    *bend = 0;
    if (n == 6 || b->pose_count != views) return TD_OK;
    u.out = malloc((views + 1) * sizeof *u.out);
    u.pose = malloc((views + 1) * sizeof *u.pose);
    u.term = calloc((views + 1) * n, sizeof *u.term);
    u.covariance = calloc((views + 1) * n * n, sizeof *u.covariance);
    td_status status = u.out && u.pose && u.term && u.covariance
                           ? TD_OK
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
    if (status == TD_OK) {
        memcpy(u.out, pose, views * sizeof *pose);
        for (size_t v = 0; v < views; v++) u.pose[v] = b->rig_from_target[b->pose_of_view[v]];
        if (estimate(&u)) {
            memcpy(pose, u.out, views * sizeof *pose);
            for (size_t v = 0; v < views; v++) b->rig_from_target[b->pose_of_view[v]] = u.pose[v];
            *bend = u.bend;
        }
    }
    free(u.out);
    free(u.pose);
    free(u.term);
    free(u.covariance);
    return status;
}
