/* The paper's laws: r from 0 to 1 over u = t / T from 0 to 1, at rest at both ends; s = r times the path. */
#include <math.h>
#include <stdlib.h>

#include "servo/trajectory_generator_internal.h"

enum { LEAST_NODES = 48 };
static const double CLOSEST = 1e-4; /* of T: nodes nearer to one another are one */

td_status td_timing_new(td_timing *timing, size_t count, td_error *error)
{
    *timing = (td_timing){.count = count};
    timing->t = calloc(count, sizeof *timing->t);
    timing->s = calloc(count, sizeof *timing->s);
    timing->ds = calloc(count, sizeof *timing->ds);
    timing->before = calloc(count, sizeof *timing->before);
    timing->after = calloc(count, sizeof *timing->after);
    if (timing->t && timing->s && timing->ds && timing->before && timing->after) return TD_OK;
    td_timing_free(timing);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the timing of %zu points", count);
}

void td_timing_free(td_timing *timing)
{
    free(timing->t);
    free(timing->s);
    free(timing->ds);
    free(timing->before);
    free(timing->after);
    *timing = (td_timing){0};
}

/* Ramps of length p: r'' = +-1 / (p (1 - p)), r' = 1 / (1 - p) in between. p = 1/2: constant acceleration. */
static void trapezoid(double r[3], double u, double p, bool after)
{
    const double v = 1 / (1 - p), a = v / p;
    const bool up = after ? u < p : u <= p, down = after ? u >= 1 - p : u > 1 - p;
    if (up) {
        r[0] = a * u * u / 2, r[1] = a * u, r[2] = a;
    } else if (down) {
        r[0] = 1 - a * (1 - u) * (1 - u) / 2, r[1] = a * (1 - u), r[2] = -a;
    } else {
        r[0] = v * (u - p / 2), r[1] = v, r[2] = 0;
    }
}

/* r, r', r'' at u; where r'' jumps, its value after u, or before. */
static void law_at(double r[3], td_timing_law law, double ramp, double u, bool after)
{
    switch (law) {
    case TD_LAW_CUBIC:
        r[0] = u * u * (3 - 2 * u), r[1] = 6 * u * (1 - u), r[2] = 6 - 12 * u;
        return;
    case TD_LAW_CONSTANT_VELOCITY:
        trapezoid(r, u, ramp, after);
        return;
    case TD_LAW_CONSTANT_ACCELERATION:
        trapezoid(r, u, 0.5, after);
        return;
    default:
        r[0] = u * u * u * (10 + u * (-15 + 6 * u));
        r[1] = 30 * u * u * (1 - u) * (1 - u);
        r[2] = 60 * u * (1 - u) * (1 - 2 * u);
    }
}

/* u at which r is so large: r grows, so halving finds it. */
static double law_inverse(td_timing_law law, double ramp, double wanted)
{
    double low = 0, high = 1, r[3];
    for (int i = 0; i < 60; i++) {
        const double middle = (low + high) / 2;
        law_at(r, law, ramp, middle, true);
        if (r[0] < wanted)
            low = middle;
        else
            high = middle;
    }
    return (low + high) / 2;
}

/* Where r'' jumps. */
static int jumps_of(double jump[2], td_timing_law law, double ramp)
{
    if (law == TD_LAW_CONSTANT_ACCELERATION) {
        jump[0] = 0.5;
        return 1;
    }
    if (law != TD_LAW_CONSTANT_VELOCITY) return 0;
    jump[0] = ramp;
    jump[1] = 1 - ramp;
    return ramp < 0.5 ? 2 : 1;
}

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Nodes of time where the path has its points, where the law jumps, and as many besides; sorted, distinct. */
static size_t nodes_of(double *u, const td_path *path, td_timing_law law, double ramp)
{
    const double all = path->s[path->count - 1];
    double jump[2];
    const int jumps = jumps_of(jump, law, ramp);
    size_t count = 0, kept = 1;
    for (int i = 0; i < jumps; i++) u[count++] = jump[i];
    for (size_t i = 0; i + 1 < path->count; i++)
        u[count++] = i ? law_inverse(law, ramp, path->s[i] / all) : 0;
    for (int i = 1; i < LEAST_NODES; i++) u[count++] = (double)i / LEAST_NODES;
    qsort(u, count, sizeof *u, compare);
    for (size_t i = 1; i < count; i++) {
        bool near = u[i] - u[kept - 1] < CLOSEST || 1 - u[i] < CLOSEST;
        for (int k = 0; k < jumps; k++) {
            near = near || (u[i] != jump[k] && fabs(u[i] - jump[k]) < CLOSEST);
            if (u[i] == jump[k]) near = u[kept - 1] == jump[k];
            if (u[i] == jump[k]) break;
        }
        if (!near) u[kept++] = u[i];
    }
    u[kept++] = 1;
    return kept;
}

td_status td_timing_of_law(td_timing *timing, const td_path *path, td_timing_law law, double ramp_share,
                           td_error *error)
{
    const double all = path->s[path->count - 1];
    double *u = calloc(path->count + LEAST_NODES + 4, sizeof *u);
    if (!u) return td_fail(error, TD_ERROR_MEMORY, "no memory for the timing of %zu points", path->count);
    const size_t count = nodes_of(u, path, law, ramp_share);
    const td_status status = td_timing_new(timing, count, error);
    for (size_t i = 0; status == TD_OK && i < count; i++) {
        double r[3];
        timing->t[i] = u[i];
        law_at(r, law, ramp_share, u[i], false);
        timing->before[i] = all * r[2];
        law_at(r, law, ramp_share, u[i], true);
        timing->s[i] = all * r[0];
        timing->ds[i] = all * r[1];
        timing->after[i] = all * r[2];
    }
    free(u);
    return status;
}
