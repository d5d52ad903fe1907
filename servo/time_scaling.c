/* How fast a path can be followed: with x = s'^2 and u = s'', joint k has the rate q' s' and the acceleration
 * q' u + q'' x; u is constant between points, so x is a straight line over s. From the end backwards: the
 * largest x at each point from which the next one's can be met. From the start forwards: the largest x that
 * the one before lets. (H. Pham and Q.-C. Pham, A new approach to time-optimal path parameterization based on
 * reachability analysis, IEEE Trans. Robotics 34, 2018.) */
#include <math.h>
#include <stdlib.h>

#include "servo/trajectory_generator_internal.h"

static const double MARGIN = 1e-3;  /* of limits: what points leave out of the way between them */
static const double LARGEST = 1e12; /* of x */
enum { CUTS = 64 };

/* |a x + b y| <= c, x here and y at the next point. */
typedef struct band {
    double a, b, c;
} band;

/* What holds over one step. */
typedef struct bands {
    int count;
    band band[2 * TD_ROBOT_MAX_JOINTS];
    double most; /* of y */
} bands;

/* s'^2 that rates and flows let, at point i. */
static td_status most_at(double *most, const td_arm *arm, const td_path *path, size_t i, td_error *error)
{
    const td_robot *r = arm->robot;
    const double *q = path->q + i * (size_t)path->n, *d1 = path->d1 + i * (size_t)path->n;
    const double share = arm->options->share * (1 - MARGIN);
    double pump = 0, slowest = sqrt(LARGEST);
    for (int k = 0; k < path->n; k++)
        if (d1[k] != 0) slowest = fmin(slowest, share * r->joint[k].speed / fabs(d1[k]));
    for (int c = 0; c < r->cylinder_count; c++) {
        const td_cylinder *cylinder = r->cylinder + c;
        double flow = 0;
        if (d1[cylinder->joint] == 0) continue;
        if (!td_cylinder_flow(&flow, r, cylinder, q[cylinder->joint], d1[cylinder->joint]))
            return td_fail(error, TD_ERROR_DATA, "cylinder '%s' does not reach joint '%s' at %.4g rad",
                           cylinder->name, r->joint[cylinder->joint].name, q[cylinder->joint]);
        slowest = fmin(slowest, share * cylinder->flow_m3_s / fabs(flow));
        pump += fabs(flow);
    }
    if (pump > 0) slowest = fmin(slowest, share * arm->pump_m3_s / pump);
    *most = slowest * slowest;
    return TD_OK;
}

static void add_band(bands *all, double a, double b, double c)
{
    if (a != 0 || b != 0) all->band[all->count++] = (band){a, b, c};
}

/* The accelerations at both ends of the step from i, with u = (y - x) / (2 ds). */
static void bands_of(bands *all, const td_arm *arm, const td_path *path, size_t i, double most)
{
    const size_t n = (size_t)path->n;
    const double half = 0.5 / (path->s[i + 1] - path->s[i]);
    all->count = 0;
    all->most = most;
    for (size_t k = 0; k < n; k++) {
        const double here = path->d1[i * n + k], there = path->d1[(i + 1) * n + k];
        const double limit = arm->options->share * (1 - MARGIN) * arm->robot->joint[k].acceleration;
        if (!isfinite(limit)) continue;
        add_band(all, path->d2[i * n + k] - here * half, here * half, limit);
        add_band(all, -there * half, path->d2[(i + 1) * n + k] + there * half, limit);
    }
}

static bool is_level(const band *b)
{
    return fabs(b->b) <= 1e-12 * fabs(b->a);
}

/* The range of y at x, and how its ends change with x. */
static void range(double y[2], double slope[2], const bands *all, double x)
{
    y[0] = 0, y[1] = all->most;
    slope[0] = slope[1] = 0;
    for (int i = 0; i < all->count; i++) {
        const band *b = all->band + i;
        if (is_level(b)) continue;
        const double middle = -b->a / b->b, wide = b->c / fabs(b->b);
        if (middle * x - wide > y[0]) y[0] = middle * x - wide, slope[0] = middle;
        if (middle * x + wide < y[1]) y[1] = middle * x + wide, slope[1] = middle;
    }
}

/* The largest x up to `most` that has a y. The least y is convex, the largest concave over x, and at 0 there
 * is one: so Newton's method on their difference goes down to it without passing it. */
static double largest_x(const bands *all, double most)
{
    double x = most, y[2], slope[2];
    for (int i = 0; i < all->count; i++)
        if (is_level(all->band + i)) x = fmin(x, all->band[i].c / fabs(all->band[i].a));
    for (int i = 0; i < CUTS; i++) {
        range(y, slope, all, x);
        const double over = y[0] - y[1], fall = slope[0] - slope[1];
        if (!(over > 1e-12 * (fabs(y[0]) + fabs(y[1])))) return x;
        if (!(fall > 0)) return 0;
        x = fmax(x - over / fall, 0);
    }
    return x;
}

static td_status fill(td_timing *t, const td_path *path, const double *x, td_error *error)
{
    for (size_t i = 0; i < path->count; i++) {
        t->s[i] = path->s[i];
        t->ds[i] = sqrt(x[i]);
    }
    for (size_t i = 0; i + 1 < path->count; i++) {
        const double ds = path->s[i + 1] - path->s[i], speed = t->ds[i] + t->ds[i + 1];
        if (!(speed > 0))
            return td_fail(error, TD_ERROR_CONVERGENCE,
                           "the path comes to rest at %.3g of its length %.3g: add a stop there", path->s[i],
                           path->s[path->count - 1]);
        t->t[i + 1] = t->t[i] + 2 * ds / speed;
        t->after[i] = t->before[i + 1] = (x[i + 1] - x[i]) / (2 * ds);
    }
    t->before[0] = t->after[0];
    t->after[path->count - 1] = t->before[path->count - 1];
    return TD_OK;
}

static td_status solve(double *x, const td_arm *arm, const td_path *path, td_error *error)
{
    const size_t last = path->count - 1;
    bands all;
    for (size_t i = 0; i <= last; i++) TD_TRY(most_at(x + i, arm, path, i, error));
    x[last] = 0;
    for (size_t i = last; i-- > 0;) {
        bands_of(&all, arm, path, i, x[i + 1]);
        x[i] = largest_x(&all, x[i]);
    }
    x[0] = 0;
    for (size_t i = 0; i < last; i++) {
        double y[2], slope[2];
        bands_of(&all, arm, path, i, x[i + 1]);
        range(y, slope, &all, x[i]);
        x[i + 1] = fmax(y[1], 0);
    }
    return TD_OK;
}

td_status td_timing_fastest(td_timing *timing, const td_arm *arm, const td_path *path, td_error *error)
{
    double *x = calloc(path->count, sizeof *x);
    if (!x) return td_fail(error, TD_ERROR_MEMORY, "no memory for the timing of %zu points", path->count);
    td_status status = solve(x, arm, path, error);
    if (status == TD_OK) status = td_timing_new(timing, path->count, error);
    if (status == TD_OK) status = fill(timing, path, x, error);
    if (status != TD_OK) td_timing_free(timing);
    free(x);
    return status;
}
