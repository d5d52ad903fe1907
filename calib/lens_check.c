/* Bundle adjustment of a few radial terms and the views' poses by Gauss-Newton, the poses eliminated (Schur
 * complement). Which terms there are is told by cross-validation, as residuals of one view are not
 * independent: a tag of wrong size or a bent board leaves the same in each of its points. */
#include "calib/lens_check.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/unsure_lens_internal.h"
#include "core/linalg.h"

enum { MOST_GROUPS = 10, LEAST_VIEWS = 6, LEAST_POINTS = 4, MOST_ITERATIONS = 30, FIRST_TERM = 4 };

static const double ENOUGH = 1e-8; /* a step of k1 and k2, at which a fit ends */
static const double SURE = 3;      /* standard errors by which a lens must be better than a simpler one */
static const double TINY = 1e-12;  /* px^2: rounding */
static const double WILD = 2;      /* no lens has terms beyond */

typedef struct lens {
    const td_observations *observations;
    int index;        /* of the camera among the observations' */
    td_camera camera; /* with the terms of the last fit */
    size_t views;
    size_t *view;                 /* (views) number among the observations' */
    td_pose *pose;                /* (views) camera_from_target */
    double across[TD_LENS_TERMS]; /* of the last fit: variances of the terms at a residual of 1 px */
} lens;

/* A view's share of the normal equations: pose, terms, and both. */
typedef struct equations {
    double cost, points;
    double pose[36], both[6 * TD_LENS_TERMS], terms[TD_LENS_TERMS * TD_LENS_TERMS];
    double right_pose[6], right_terms[TD_LENS_TERMS];
} equations;

static void add_row(equations *e, const double jp[6], const double *jk, int terms, double r)
{
    for (int a = 0; a < 6; a++) {
        e->right_pose[a] -= jp[a] * r;
        for (int b = 0; b < 6; b++) e->pose[6 * a + b] += jp[a] * jp[b];
        for (int b = 0; b < terms; b++) e->both[terms * a + b] += jp[a] * jk[b];
    }
    for (int a = 0; a < terms; a++) {
        e->right_terms[a] -= jk[a] * r;
        for (int b = 0; b < terms; b++) e->terms[terms * a + b] += jk[a] * jk[b];
    }
}

/* False when a point has no image. */
static bool view_equations(equations *e, const lens *l, size_t v, int terms)
{
    const td_detection *d = td_observations_get(l->observations, l->view[v], l->index);
    const int parameters = td_camera_parameter_count(l->camera.model);
    *e = (equations){0};
    for (size_t k = 0; k < d->count; k++) {
        double p[3], q[3], pixel[2], by_q[6], by_pose[18], jp[12], by_camera[2 * TD_CAMERA_MAX_PARAMETERS];
        if (!isfinite(d->point[2 * k])) continue;
        td_target_point(p, &l->observations->target, k);
        td_pose_transform(q, &l->pose[v], p);
        if (!td_camera_project(pixel, by_q, by_camera, &l->camera, q)) return false;
        td_pose_transform_jacobian(by_pose, q);
        td_multiply(jp, by_q, by_pose, 2, 3, 6);
        for (int c = 0; c < 2; c++) {
            double r = pixel[c] - d->point[2 * k + (size_t)c];
            add_row(e, jp + 6 * c, by_camera + parameters * c + FIRST_TERM, terms, r);
            e->cost += r * r;
        }
        e->points++;
    }
    return isfinite(e->cost);
}

/* Takes the pose out of a view's equations and adds what is left to those of the terms. */
static bool eliminate(double *normal, double *right, double inverse[36], const equations *e, int terms)
{
    double weighed[6 * TD_LENS_TERMS];
    if (td_invert_spd(inverse, e->pose, 6, NULL) != TD_OK) return false;
    td_multiply(weighed, inverse, e->both, 6, 6, (size_t)terms);
    for (int a = 0; a < terms; a++) {
        right[a] += e->right_terms[a];
        for (int k = 0; k < 6; k++) right[a] -= weighed[terms * k + a] * e->right_pose[k];
        for (int b = 0; b < terms; b++) {
            normal[terms * a + b] += e->terms[terms * a + b];
            for (int k = 0; k < 6; k++)
                normal[terms * a + b] -= weighed[terms * k + a] * e->both[terms * k + b];
        }
    }
    return true;
}

static void move_pose(td_pose *pose, const equations *e, const double inverse[36], const double *step,
                      int terms)
{
    double right[6], move[6];
    for (int a = 0; a < 6; a++) {
        right[a] = e->right_pose[a];
        for (int b = 0; b < terms; b++) right[a] -= e->both[terms * a + b] * step[b];
    }
    td_multiply(move, inverse, right, 6, 6, 1);
    *pose = td_pose_perturb(pose, move);
}

/* Fits the terms to the views of other groups than `without` (-1: to all); the poses move with them. */
static bool fit_terms(lens *l, int terms, int without, int groups)
{
    for (int i = 0; i < MOST_ITERATIONS; i++) {
        double normal[TD_LENS_TERMS * TD_LENS_TERMS] = {0}, right[TD_LENS_TERMS] = {0}, inverse[36],
                                      across[TD_LENS_TERMS * TD_LENS_TERMS], step[TD_LENS_TERMS], longest = 0;
        equations e;
        for (size_t v = 0; v < l->views; v++) {
            if ((int)(v % (size_t)groups) == without) continue;
            if (!view_equations(&e, l, v, terms) || !eliminate(normal, right, inverse, &e, terms))
                return false;
        }
        if (td_invert_spd(across, normal, (size_t)terms, NULL) != TD_OK) return false;
        td_multiply(step, across, right, (size_t)terms, (size_t)terms, 1);
        for (size_t v = 0; v < l->views; v++) {
            if ((int)(v % (size_t)groups) == without) continue;
            if (!view_equations(&e, l, v, terms) || td_invert_spd(inverse, e.pose, 6, NULL) != TD_OK)
                return false;
            move_pose(&l->pose[v], &e, inverse, step, terms);
        }
        for (int k = 0; k < terms; k++) {
            l->camera.parameter[FIRST_TERM + k] += step[k];
            l->across[k] = across[(terms + 1) * k];
            longest = fmax(longest, fabs(step[k]));
            if (!(fabs(l->camera.parameter[FIRST_TERM + k]) < WILD)) return false;
        }
        if (longest < ENOUGH) return true;
    }
    return false;
}

/* Sum of squares of a view in the pose that suits it best; infinite where there is none. */
static double view_cost(lens *l, size_t v, double *points)
{
    equations e;
    double inverse[36];
    for (int i = 0; i < MOST_ITERATIONS; i++) {
        double before = i ? e.cost : INFINITY;
        if (!view_equations(&e, l, v, 0)) return INFINITY;
        *points = e.points;
        if (before - e.cost <= 1e-9 * e.cost) break;
        if (td_invert_spd(inverse, e.pose, 6, NULL) != TD_OK) return INFINITY;
        move_pose(&l->pose[v], &e, inverse, NULL, 0);
    }
    return e.cost;
}

/* What the views say of a lens of so many terms. */
typedef struct verdict {
    bool fitted;
    double term[TD_LENS_TERMS], sigma[TD_LENS_TERMS];
    double rms_px, held_out_px;
    double *cost; /* (views) held out */
} verdict;

static double rms_of(const double *cost, size_t views, double points)
{
    double sum = 0;
    for (size_t v = 0; v < views; v++) sum += cost[v];
    return sqrt(sum / points);
}

/* Variance of a term, of its values without each group. */
static double jackknife(double fold[][TD_LENS_TERMS], int term, int groups)
{
    double mean = 0, square = 0;
    for (int g = 0; g < groups; g++) mean += fold[g][term] / groups;
    for (int g = 0; g < groups; g++) square += (fold[g][term] - mean) * (fold[g][term] - mean);
    return square * (groups - 1) / groups;
}

/* Fits all views, then all but each group, which is judged; `start` holds the poses to begin from. */
static void judge(verdict *out, lens *l, int terms, const td_pose *start)
{
    const int groups = l->views < MOST_GROUPS ? (int)l->views : MOST_GROUPS;
    const size_t size = l->views * sizeof *start;
    double fold[MOST_GROUPS][TD_LENS_TERMS], across[TD_LENS_TERMS], points = 0, n, sum = 0;
    memset(l->camera.parameter + FIRST_TERM, 0, TD_LENS_TERMS * sizeof(double));
    memcpy(l->pose, start, size);
    out->rms_px = out->held_out_px = NAN;
    if (terms && !fit_terms(l, terms, -1, groups)) return;
    memcpy(out->term, l->camera.parameter + FIRST_TERM, sizeof out->term);
    memcpy(across, l->across, sizeof across);
    for (size_t v = 0; v < l->views; v++) {
        sum += view_cost(l, v, &n);
        points += n;
    }
    for (int g = 0; g < groups; g++) {
        memcpy(l->camera.parameter + FIRST_TERM, out->term, sizeof out->term);
        memcpy(l->pose, start, size);
        if (terms && !fit_terms(l, terms, g, groups)) return;
        memcpy(fold[g], l->camera.parameter + FIRST_TERM, sizeof fold[g]);
        for (size_t v = (size_t)g; v < l->views; v += (size_t)groups) out->cost[v] = view_cost(l, v, &n);
    }
    const double freedom = 2 * points - 6 * (double)l->views - terms;
    for (int k = 0; k < terms; k++)
        out->sigma[k] = sqrt(fmax(across[k] * sum / freedom, jackknife(fold, k, groups)));
    out->rms_px = sqrt(sum / points);
    out->held_out_px = rms_of(out->cost, l->views, points);
    out->fitted = isfinite(out->held_out_px) && isfinite(out->rms_px);
}

/* By how many standard errors over the views b is better than a: of the logarithms of the views' sums of
 * squares, as a distant view has little to tell and a near one much. */
static double gain(const verdict *a, const verdict *b, size_t views)
{
    double mean = 0, square = 0, n = (double)views;
    if (!b->fitted || !a->fitted) return 0;
    for (size_t v = 0; v < views; v++) mean += log((a->cost[v] + TINY) / (b->cost[v] + TINY)) / n;
    for (size_t v = 0; v < views; v++) {
        double off = log((a->cost[v] + TINY) / (b->cost[v] + TINY)) - mean;
        square += off * off;
    }
    return mean > 0 ? mean / sqrt(square / (n * (n - 1))) : 0;
}

/* Takes the terms that earn their place and says so. */
static void write_down(td_lens_check *check, const verdict model[TD_LENS_TERMS + 1], size_t views)
{
    for (int t = 1; t <= TD_LENS_TERMS; t++)
        if (gain(&model[check->terms], &model[t], views) > SURE) check->terms = t;
    for (int t = 0; t <= TD_LENS_TERMS; t++) {
        check->rms_px[t] = model[t].rms_px;
        check->held_out_px[t] = model[t].held_out_px;
    }
    if (!check->terms) {
        snprintf(check->text, sizeof check->text, "the views tell of no distortion");
        return;
    }
    const verdict *m = &model[check->terms];
    char second[64] = "";
    check->camera.model = TD_CAMERA_BROWN5;
    memset(check->camera.parameter + FIRST_TERM, 0, 5 * sizeof(double));
    memcpy(check->camera.parameter + FIRST_TERM, m->term, (size_t)check->terms * sizeof(double));
    memcpy(check->sigma, m->sigma, sizeof check->sigma);
    if (check->terms == 2) snprintf(second, sizeof second, ", k2 = %.3f ± %.3f", m->term[1], m->sigma[1]);
    snprintf(check->text, sizeof check->text,
             "said to have no distortion, but the views tell of k1 = %.3f ± %.3f%s: views held out leave "
             "%.3f px RMS with it, %.3f px without",
             m->term[0], m->sigma[0], second, m->held_out_px, model[0].held_out_px);
}

/* The views that the camera sees, and where; l->view and l->pose hold all views. */
static td_status find_views(lens *l, const td_rig *rig, const td_rig_camera *camera, td_error *error)
{
    const td_observations *o = l->observations;
    td_view_pose *seen = calloc(o->view_count + 1, sizeof *seen);
    td_status status =
        seen ? td_view_poses(seen, rig, o, error) : td_fail(error, TD_ERROR_MEMORY, "no memory");
    for (size_t v = 0; v < o->view_count && status == TD_OK; v++) {
        const td_detection *d = td_observations_get(o, v, l->index);
        size_t points = 0;
        for (size_t k = 0; k < d->count; k++) points += d->found && isfinite(d->point[2 * k]);
        if (!seen[v].seen || points < LEAST_POINTS) continue;
        l->view[l->views] = v;
        l->pose[l->views++] = td_pose_compose(&camera->camera_from_rig, &seen[v].rig_from_target);
    }
    free(seen);
    return status;
}

static td_status check_views(td_lens_check *check, lens *l, td_error *error)
{
    verdict model[TD_LENS_TERMS + 1] = {{0}};
    td_pose *start = malloc(l->views * sizeof *start);
    double *cost = malloc((TD_LENS_TERMS + 1) * l->views * sizeof *cost);
    td_status status = start && cost ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory");
    if (status == TD_OK) {
        memcpy(start, l->pose, l->views * sizeof *start);
        for (int t = 0; t <= TD_LENS_TERMS; t++) {
            model[t].cost = cost + (size_t)t * l->views;
            judge(&model[t], l, t, start);
        }
        write_down(check, model, l->views);
    }
    free(start);
    free(cost);
    return status;
}

td_status td_lens_check_make(td_lens_check *check, const td_rig *rig, int camera,
                             const td_observations *observations, td_error *error)
{
    const int k = td_rig_find(rig, observations->camera[camera].name);
    *check = (td_lens_check){.rms_px = {NAN, NAN, NAN}, .held_out_px = {NAN, NAN, NAN}};
    if (k < 0)
        return td_fail(error, TD_ERROR_DATA, "the rig has no camera %s: names must agree",
                       observations->camera[camera].name);
    check->camera = rig->camera[k].camera;
    if (!td_camera_is_plain(&check->camera)) {
        snprintf(check->text, sizeof check->text, "the camera has distortion of its own");
        return TD_OK;
    }
    lens l = {.observations = observations, .index = camera, .camera = check->camera};
    l.camera.model = TD_CAMERA_BROWN5;
    l.view = malloc((observations->view_count + 1) * sizeof *l.view);
    l.pose = malloc((observations->view_count + 1) * sizeof *l.pose);
    td_status status = l.view && l.pose ? find_views(&l, rig, &rig->camera[k], error)
                                        : td_fail(error, TD_ERROR_MEMORY, "no memory");
    if (status == TD_OK && l.views < LEAST_VIEWS)
        snprintf(check->text, sizeof check->text, "%zu views are too few to tell of distortion", l.views);
    else if (status == TD_OK)
        status = check_views(check, &l, error);
    free(l.view);
    free(l.pose);
    return status;
}
