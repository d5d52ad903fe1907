/* Straight lines through points, their corners rounded so that the second derivative is continuous. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

static const double SAME = 1e-6; /* m, rad: nearer points are one */

td_status td_polyline_new(td_polyline *line, int size, size_t capacity, td_error *error)
{
    *line = (td_polyline){.size = size};
    line->point = calloc(capacity * (size_t)size, sizeof *line->point);
    line->s = calloc(capacity, sizeof *line->s);
    line->half = calloc(capacity, sizeof *line->half);
    line->via = calloc(capacity, sizeof *line->via);
    if (line->point && line->s && line->half && line->via) return TD_OK;
    td_polyline_free(line);
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a path through %zu points", capacity);
}

void td_polyline_free(td_polyline *line)
{
    free(line->point);
    free(line->s);
    free(line->half);
    free(line->via);
    *line = (td_polyline){0};
}

void td_polyline_add(td_polyline *line, const double *point, const double *weight, size_t via)
{
    const size_t n = (size_t)line->size;
    double square = 0;
    if (line->count > 0) {
        const double *last = line->point + (line->count - 1) * n;
        for (size_t i = 0; i < n; i++)
            square += weight[i] * weight[i] * (point[i] - last[i]) * (point[i] - last[i]);
        if (sqrt(square) < SAME) return;
        line->s[line->count] = line->s[line->count - 1] + sqrt(square);
    }
    memcpy(line->point + line->count * n, point, n * sizeof *point);
    line->via[line->count] = via;
    line->count++;
}

/* dX/ds of the line behind corner i, of value k. */
static double direction(const td_polyline *line, size_t i, size_t k)
{
    const size_t n = (size_t)line->size;
    return (line->point[(i + 1) * n + k] - line->point[i * n + k]) / (line->s[i + 1] - line->s[i]);
}

void td_polyline_round(td_polyline *line, size_t i, const double *tolerance)
{
    double half = fmin(line->s[i] - line->s[i - 1], line->s[i + 1] - line->s[i]) / 2;
    for (size_t k = 0; k < (size_t)line->size; k++) {
        const double turn = fabs(direction(line, i, k) - direction(line, i - 1, k));
        if (3.0 / 16 * half * turn > tolerance[k]) half = tolerance[k] * 16 / (3 * turn);
    }
    line->half[i] = half;
}

void td_polyline_at(double *x, double *d1, double *d2, const td_polyline *line, double s)
{
    const size_t n = (size_t)line->size;
    size_t i = 0; /* the line that s is on */
    while (i + 2 < line->count && s > line->s[i + 1]) i++;
    size_t corner = 0;
    if (i > 0 && s < line->s[i] + line->half[i]) corner = i;
    if (i + 2 < line->count && s > line->s[i + 1] - line->half[i + 1]) corner = i + 1;
    for (size_t k = 0; k < n; k++) {
        if (corner == 0) {
            const double along = direction(line, i, k);
            if (x) x[k] = line->point[i * n + k] + along * (s - line->s[i]);
            if (d1) d1[k] = along;
            if (d2) d2[k] = 0;
            continue;
        }
        const double half = line->half[corner], u = (s - line->s[corner] + half) / (2 * half);
        const double first = direction(line, corner - 1, k), turn = direction(line, corner, k) - first;
        if (x)
            x[k] = line->point[corner * n + k] - half * first +
                   2 * half * (first * u + turn * u * u * u * (1 - u / 2));
        if (d1) d1[k] = first + turn * u * u * (3 - 2 * u);
        if (d2) d2[k] = turn * 3 * u * (1 - u) / half;
    }
}
