#include "core/trajectory.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

td_status td_trajectory_new(td_trajectory **out, int joints, size_t count, td_error *error)
{
    *out = NULL;
    if (joints < 1 || joints > TD_ROBOT_MAX_JOINTS || count < 1 || count > SIZE_MAX / 8 / TD_ROBOT_MAX_JOINTS)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "a trajectory of %d joints and %zu knots: give 1 to %d and 1 up", joints, count,
                       TD_ROBOT_MAX_JOINTS);
    td_trajectory *t = calloc(1, sizeof *t);
    const size_t size = count * (size_t)joints;
    if (t) {
        *t = (td_trajectory){.joints = joints, .count = count};
        t->time_s = calloc(count, sizeof *t->time_s);
        t->q = calloc(size, sizeof *t->q);
        t->dq = calloc(size, sizeof *t->dq);
        t->ddq = calloc(size, sizeof *t->ddq);
    }
    if (!t || !t->time_s || !t->q || !t->dq || !t->ddq) {
        td_trajectory_free(&t);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a trajectory of %zu knots", count);
    }
    *out = t;
    return TD_OK;
}

void td_trajectory_free(td_trajectory **trajectory)
{
    if (!trajectory || !*trajectory) return;
    td_trajectory *t = *trajectory;
    free(t->time_s);
    free(t->q);
    free(t->dq);
    free(t->ddq);
    free(t->event);
    free(t);
    *trajectory = NULL;
}

double td_trajectory_duration(const td_trajectory *trajectory)
{
    return trajectory->time_s[trajectory->count - 1];
}

/* x(t) = x0 + v0 t + a0 t^2/2 + c3 t^3 + c4 t^4 + c5 t^5, by what is missing at h: d of the value, e of the
 * rate, f of the acceleration. */
void td_quintic(double at[3], const double begin[3], const double end[3], double h, double t)
{
    const double a0 = begin[2], d = end[0] - begin[0] - h * (begin[1] + h * a0 / 2),
                 e = h * (end[1] - begin[1] - h * a0), f = h * h * (end[2] - a0);
    const double c3 = 10 * d - 4 * e + f / 2, c4 = -15 * d + 7 * e - f, c5 = 6 * d - 3 * e + f / 2;
    const double u = t / h;
    at[0] = begin[0] + t * (begin[1] + t * a0 / 2) + u * u * u * (c3 + u * (c4 + u * c5));
    at[1] = begin[1] + t * a0 + u * u * (3 * c3 + u * (4 * c4 + u * 5 * c5)) / h;
    at[2] = a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5)) / (h * h);
}

/* The last knot whose time is not after this one; of two that share it, the second. */
static size_t knot_at(const td_trajectory *trajectory, double time_s)
{
    size_t low = 0, high = trajectory->count;
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (trajectory->time_s[middle] <= time_s)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static void stand(double *q, double *dq, double *ddq, const td_trajectory *trajectory, size_t knot)
{
    const size_t n = (size_t)trajectory->joints;
    if (q) memcpy(q, trajectory->q + knot * n, n * sizeof *q);
    for (size_t k = 0; k < n; k++) {
        if (dq) dq[k] = 0;
        if (ddq) ddq[k] = 0;
    }
}

void td_trajectory_at(double *q, double *dq, double *ddq, const td_trajectory *trajectory, double time_s)
{
    const size_t n = (size_t)trajectory->joints, last = trajectory->count - 1,
                 i = knot_at(trajectory, time_s);
    if (!(time_s >= trajectory->time_s[0])) {
        stand(q, dq, ddq, trajectory, 0);
        return;
    }
    if (i == last && time_s > trajectory->time_s[last]) {
        stand(q, dq, ddq, trajectory, last);
        return;
    }
    const double h = i < last ? trajectory->time_s[i + 1] - trajectory->time_s[i] : 1;
    const size_t next = i < last ? i + 1 : i;
    for (size_t k = 0; k < n; k++) {
        const size_t a = i * n + k, b = next * n + k;
        const double begin[3] = {trajectory->q[a], trajectory->dq[a], trajectory->ddq[a]},
                     end[3] = {trajectory->q[b], trajectory->dq[b], trajectory->ddq[b]};
        double at[3];
        td_quintic(at, begin, end, h, time_s - trajectory->time_s[i]);
        if (q) q[k] = at[0];
        if (dq) dq[k] = at[1];
        if (ddq) ddq[k] = at[2];
    }
}

void td_trajectory_stretch(td_trajectory *trajectory, double factor)
{
    const size_t size = trajectory->count * (size_t)trajectory->joints;
    for (size_t i = 0; i < trajectory->count; i++) trajectory->time_s[i] *= factor;
    for (size_t i = 0; i < size; i++) {
        trajectory->dq[i] /= factor;
        trajectory->ddq[i] /= factor * factor;
    }
    for (size_t i = 0; i < trajectory->event_count; i++) {
        trajectory->event[i].from_s *= factor;
        trajectory->event[i].to_s *= factor;
    }
}
