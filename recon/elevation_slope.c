/* The steepest slope of each cell of a map. */
#include <math.h>
#include <string.h>

#include "recon/volume.h"

/* Gradient along an axis, and its variance, from the cells on both sides or this and one. */
static bool gradient(double *slope, double *variance, const td_elevation *map, size_t cell, int at, int count,
                     size_t step)
{
    size_t low = cell, high = cell;
    if (at > 0 && isfinite(map->height[cell - step])) low = cell - step;
    if (at + 1 < count && isfinite(map->height[cell + step])) high = cell + step;
    if (low == high) return false;
    const double run = map->cell_m * (double)((high - low) / step);
    const double a = map->sigma[low], b = map->sigma[high];
    *slope = ((double)map->height[high] - (double)map->height[low]) / run;
    *variance = (a * a + b * b) / (run * run);
    return true;
}

/* sigma of atan |g|: along the direction of g; where there is none, the mean of both. */
static void set_slope(td_elevation *slope, size_t cell, const double g[2], const double v[2])
{
    const double square = g[0] * g[0] + g[1] * g[1];
    const double along =
        square > 0 ? (g[0] * g[0] * v[0] + g[1] * g[1] * v[1]) / square : 0.5 * (v[0] + v[1]);
    slope->height[cell] = (float)atan(sqrt(square));
    slope->sigma[cell] = (float)(sqrt(along) / (1 + square));
}

td_status td_elevation_slope(td_elevation **slope, const td_elevation *map, td_error *error)
{
    td_elevation *made = NULL;
    size_t known = 0;
    *slope = NULL;
    TD_TRY(td_elevation_copy(&made, map, error));
    for (int r = 0; r < map->rows; r++)
        for (int c = 0; c < map->columns; c++) {
            const size_t cell = (size_t)r * (size_t)map->columns + (size_t)c;
            double g[2], v[2];
            if (isfinite(map->height[cell]) && gradient(&g[0], &v[0], map, cell, c, map->columns, 1) &&
                gradient(&g[1], &v[1], map, cell, r, map->rows, (size_t)map->columns)) {
                set_slope(made, cell, g, v);
                known++;
                continue;
            }
            made->height[cell] = made->sigma[cell] = NAN;
            made->time_s[cell] = NAN;
            made->count[cell] = 0;
            made->provenance[cell] = TD_CELL_UNKNOWN;
        }
    if (!known) {
        td_elevation_free(&made);
        return td_fail(error, TD_ERROR_DATA,
                       "slope: no cell of the map has a height and neighbours along x and y");
    }
    *slope = made;
    return TD_OK;
}
