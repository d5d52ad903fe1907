/* The joints along a path: points with derivatives, quintics in between. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

enum { LINE_STEPS = 36, CORNER_STEPS = 12 };

void td_path_free(td_path *path)
{
    free(path->s);
    free(path->q);
    free(path->d1);
    free(path->d2);
    *path = (td_path){0};
}

static bool grow(double **array, size_t size)
{
    double *bigger = realloc(*array, size * sizeof **array);
    if (bigger) *array = bigger;
    return bigger != NULL;
}

td_status td_path_add(td_path *path, double s, const double *q, td_error *error)
{
    const size_t n = (size_t)path->n;
    if (path->count == path->capacity) {
        const size_t capacity = path->capacity ? 2 * path->capacity : 64;
        if (!grow(&path->s, capacity) || !grow(&path->q, capacity * n) || !grow(&path->d1, capacity * n) ||
            !grow(&path->d2, capacity * n))
            return td_fail(error, TD_ERROR_MEMORY, "no memory for a path of %zu points", capacity);
        path->capacity = capacity;
    }
    path->s[path->count] = s;
    memcpy(path->q + path->count * n, q, n * sizeof *q);
    path->count++;
    return TD_OK;
}

void td_path_at(double *q, double *d1, double *d2, const td_path *path, size_t interval, double s)
{
    const size_t n = (size_t)path->n;
    const double h = path->s[interval + 1] - path->s[interval];
    for (size_t k = 0; k < n; k++) {
        const size_t a = interval * n + k, b = a + n;
        const double begin[3] = {path->q[a], path->d1[a], path->d2[a]},
                     end[3] = {path->q[b], path->d1[b], path->d2[b]};
        double at[3];
        td_quintic(at, begin, end, h, s - path->s[interval]);
        q[k] = at[0];
        d1[k] = at[1];
        d2[k] = at[2];
    }
}

static td_status add_joints(td_path *path, const td_polyline *line, double s, td_error *error)
{
    double q[TD_ROBOT_MAX_JOINTS];
    const size_t at = path->count * (size_t)path->n;
    td_polyline_at(q, NULL, NULL, line, s);
    TD_TRY(td_path_add(path, s, q, error));
    td_polyline_at(NULL, path->d1 + at, path->d2 + at, line, s);
    return TD_OK;
}

static td_status add_evenly(td_path *path, const td_polyline *line, double from, double to, int steps,
                            td_error *error)
{
    for (int i = 1; i < steps; i++) TD_TRY(add_joints(path, line, from + (to - from) * i / steps, error));
    return add_joints(path, line, to, error);
}

/* Is there a flow to limit? */
static bool flows(const td_arm *arm, const double *d1)
{
    for (int i = 0; i < arm->robot->cylinder_count; i++) {
        const td_cylinder *c = arm->robot->cylinder + i;
        if (d1[c->joint] != 0 && (isfinite(c->flow_m3_s) || isfinite(arm->pump_m3_s))) return true;
    }
    return false;
}

/* One line from rest to rest on which limits are the same everywhere: the fastest motion's acceleration jumps
 * only where s' reaches its largest, after v^2 / (2 u), and as far from the end. */
static td_status add_plain_line(td_path *path, const td_arm *arm, const td_polyline *line, td_error *error)
{
    double v = INFINITY, u = INFINITY;
    for (int k = 0; k < path->n; k++) {
        const double part = fabs(path->d1[k]);
        if (part > 0) v = fmin(v, arm->robot->joint[k].speed / part);
        if (part > 0) u = fmin(u, arm->robot->joint[k].acceleration / part);
    }
    const double all = line->s[1], ramp = arm->options->share * v * v / (2 * u);
    if (2 * ramp < all && ramp > 0) {
        TD_TRY(add_joints(path, line, ramp, error));
        TD_TRY(add_joints(path, line, all - ramp, error));
    } else {
        TD_TRY(add_joints(path, line, all / 2, error));
    }
    return add_joints(path, line, all, error);
}

td_status td_path_of_joints(td_path *path, const td_arm *arm, const td_polyline *line, td_error *error)
{
    path->n = line->size;
    TD_TRY(add_joints(path, line, 0, error));
    if (line->count == 2 && !flows(arm, path->d1)) return add_plain_line(path, arm, line, error);
    for (size_t i = 0; i + 1 < line->count; i++) {
        const double corner = line->s[i + 1], half = line->half[i + 1], from = line->s[i] + line->half[i],
                     to = corner - half;
        if (to - from > 1e-9 * corner) TD_TRY(add_evenly(path, line, from, to, LINE_STEPS, error));
        if (half > 0) TD_TRY(add_evenly(path, line, to, corner + half, CORNER_STEPS, error));
    }
    return TD_OK;
}

/* Second derivatives of the cubics between points, at both ends of each. */
static void fill_seconds(td_path *path)
{
    const size_t n = (size_t)path->n, last = path->count - 1;
    for (size_t i = 0; i <= last; i++)
        for (size_t k = 0; k < n; k++) {
            const size_t b = i < last ? i : last - 1;
            const double h = path->s[b + 1] - path->s[b],
                         rise = path->q[(b + 1) * n + k] - path->q[b * n + k];
            const double m0 = path->d1[b * n + k], m1 = path->d1[(b + 1) * n + k];
            path->d2[i * n + k] =
                i < last ? (6 * rise / h - 4 * m0 - 2 * m1) / h : (-6 * rise / h + 2 * m0 + 4 * m1) / h;
        }
}

/* Slopes m of a C2 cubic spline: m[i-1]/a + 2 m[i] (1/a + 1/b) + m[i+1]/b = 3 (rise_a/a^2 + rise_b/b^2), a
 * and b the steps before and behind; tridiagonal and diagonally dominant, so eliminated without pivots. */
td_status td_path_spline(td_path *path, const double *first, const double *last, td_error *error)
{
    const size_t n = (size_t)path->n, end = path->count - 1;
    double *factor = calloc(path->count, sizeof *factor);
    if (!factor) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path of %zu points", path->count);
    memcpy(path->d1, first, n * sizeof *first);
    memcpy(path->d1 + end * n, last, n * sizeof *last);
    for (size_t i = 1; i < end; i++) {
        const double a = path->s[i] - path->s[i - 1], b = path->s[i + 1] - path->s[i];
        const double pivot = 2 * (1 / a + 1 / b) - factor[i - 1] / a;
        factor[i] = 1 / (b * pivot);
        for (size_t k = 0; k < n; k++) {
            const double *q = path->q + i * n + k;
            const double right = 3 * ((q[0] - *(q - n)) / (a * a) + (q[n] - q[0]) / (b * b));
            path->d1[i * n + k] = (right - path->d1[(i - 1) * n + k] / a) / pivot;
        }
    }
    for (size_t i = end; i-- > 1;)
        for (size_t k = 0; k < n; k++) path->d1[i * n + k] -= factor[i] * path->d1[(i + 1) * n + k];
    fill_seconds(path);
    free(factor);
    return TD_OK;
}
