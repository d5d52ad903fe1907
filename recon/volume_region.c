/* Which cells lie inside a polygon: crossings of each row's line with the sides, sorted. */
#include <math.h>
#include <stdlib.h>

#include "recon/volume_internal.h"

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Where the line y meets the polygon's sides, ascending. A side holds its lower end, not its upper one. */
static size_t crossings(double *x, const double (*p)[2], size_t count, double y)
{
    size_t n = 0;
    for (size_t i = 0; i < count; i++) {
        const double *a = p[i], *b = p[(i + 1) % count];
        if ((a[1] <= y) == (b[1] <= y)) continue;
        x[n++] = a[0] + (b[0] - a[0]) * ((y - a[1]) / (b[1] - a[1]));
    }
    qsort(x, n, sizeof *x, by_value);
    return n;
}

static td_status check_polygon(const double (*p)[2], size_t count, td_error *error)
{
    double twice_area = 0;
    if (count < 3)
        return td_fail(error, TD_ERROR_ARGUMENT, "polygon: %zu corners; it must have at least 3", count);
    for (size_t i = 0; i < count; i++) {
        const double *a = p[i], *b = p[(i + 1) % count];
        if (!isfinite(a[0]) || !isfinite(a[1]))
            return td_fail(error, TD_ERROR_ARGUMENT, "polygon: corner %zu must be finite, not (%g, %g)",
                           i + 1, a[0], a[1]);
        twice_area += (a[0] - p[0][0]) * (b[1] - p[0][1]) - (b[0] - p[0][0]) * (a[1] - p[0][1]);
    }
    if (twice_area == 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "polygon: its %zu corners enclose no area", count);
    return TD_OK;
}

td_status volume_inside(bool *inside, const td_elevation *map, const double (*polygon)[2], size_t count,
                        td_error *error)
{
    TD_TRY(check_polygon(polygon, count, error));
    double *x = malloc(count * sizeof *x);
    if (!x) return td_fail(error, TD_ERROR_MEMORY, "no memory for a polygon of %zu corners", count);
    for (int r = 0; r < map->rows; r++) {
        const size_t n = crossings(x, polygon, count, map->origin[1] + r * map->cell_m);
        bool *row = inside + (size_t)r * (size_t)map->columns;
        for (size_t c = 0, k = 0; c < (size_t)map->columns; c++) {
            while (k < n && x[k] <= map->origin[0] + (double)c * map->cell_m) k++;
            row[c] = k % 2 == 1;
        }
    }
    free(x);
    return TD_OK;
}
