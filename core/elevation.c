#include "core/elevation.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/text_internal.h"

static size_t cells_of(const td_elevation *map)
{
    return (size_t)map->columns * (size_t)map->rows;
}

/* Room for the cells, nothing in it. */
static td_elevation *allocate(int columns, int rows)
{
    td_elevation *map = calloc(1, sizeof *map);
    const size_t n = (size_t)columns * (size_t)rows;
    if (!map) return NULL;
    map->columns = columns;
    map->rows = rows;
    map->height = malloc(n * sizeof *map->height);
    map->sigma = malloc(n * sizeof *map->sigma);
    map->count = calloc(n, sizeof *map->count);
    map->provenance = calloc(n, sizeof *map->provenance);
    map->time_s = malloc(n * sizeof *map->time_s);
    if (!map->height || !map->sigma || !map->count || !map->provenance || !map->time_s)
        td_elevation_free(&map);
    return map;
}

td_status td_elevation_new(td_elevation **map, int columns, int rows, double cell_m, const double origin[2],
                           const char *frame, td_error *error)
{
    *map = NULL;
    if (columns < 1 || rows < 1 || columns > TD_ELEVATION_MAX_CELLS / rows)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "an elevation map of %d x %d cells: must have 1 to %d cells; take larger cells or a "
                       "smaller area",
                       columns, rows, TD_ELEVATION_MAX_CELLS);
    if (!(cell_m > 0 && isfinite(cell_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "cell_m: must be above 0, not %g", cell_m);
    if (!isfinite(origin[0]) || !isfinite(origin[1]))
        return td_fail(error, TD_ERROR_ARGUMENT, "origin: must be finite, not (%g, %g)", origin[0],
                       origin[1]);
    if (!td_name_is_plain(frame)) {
        char shown[TD_SHOWN_SIZE];
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "frame: must be a name of 1 to %d letters, digits, - and _, not '%s'",
                       TD_NAME_SIZE - 1, td_text_shown(shown, frame));
    }
    td_elevation *made = allocate(columns, rows);
    if (!made)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for an elevation map of %d x %d cells", columns,
                       rows);
    made->cell_m = cell_m;
    memcpy(made->origin, origin, sizeof made->origin);
    strcpy(made->frame, frame);
    for (size_t i = 0, n = cells_of(made); i < n; i++) {
        made->height[i] = made->sigma[i] = NAN;
        made->time_s[i] = NAN;
    }
    *map = made;
    return TD_OK;
}

td_status td_elevation_copy(td_elevation **copy, const td_elevation *map, td_error *error)
{
    const size_t n = cells_of(map);
    td_elevation *made = allocate(map->columns, map->rows);
    *copy = NULL;
    if (made && map->crs) made->crs = strdup(map->crs);
    if (!made || (map->crs && !made->crs)) {
        td_elevation_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for an elevation map of %d x %d cells",
                       map->columns, map->rows);
    }
    made->cell_m = map->cell_m;
    memcpy(made->origin, map->origin, sizeof made->origin);
    strcpy(made->frame, map->frame);
    memcpy(made->height, map->height, n * sizeof *map->height);
    memcpy(made->sigma, map->sigma, n * sizeof *map->sigma);
    memcpy(made->count, map->count, n * sizeof *map->count);
    memcpy(made->provenance, map->provenance, n * sizeof *map->provenance);
    memcpy(made->time_s, map->time_s, n * sizeof *map->time_s);
    *copy = made;
    return TD_OK;
}

void td_elevation_free(td_elevation **map)
{
    if (!map || !*map) return;
    free((*map)->crs);
    free((*map)->height);
    free((*map)->sigma);
    free((*map)->count);
    free((*map)->provenance);
    free((*map)->time_s);
    free(*map);
    *map = NULL;
}

/* The cell at or below coordinate `u` (in cells), and how far on the way to the next one; false outside. */
static bool bracket(int *first, double *part, double u, int count)
{
    if (!(u >= 0 && u <= count - 1)) return false;
    *first = (int)u;
    *part = u - *first;
    return true;
}

/* Bilinear between four cells that are all inside. */
static double between(const float *cell, int columns, double a, double b)
{
    const double below = (1 - a) * cell[0] + a * cell[1],
                 above = (1 - a) * cell[columns] + a * cell[columns + 1];
    return (1 - b) * below + b * above;
}

double td_elevation_at(const td_elevation *map, double x, double y, double *sigma)
{
    int column, row;
    double a, b, height = 0, worst = 0;
    if (sigma) *sigma = NAN;
    if (!bracket(&column, &a, (x - map->origin[0]) / map->cell_m, map->columns) ||
        !bracket(&row, &b, (y - map->origin[1]) / map->cell_m, map->rows))
        return NAN;
    const size_t first = (size_t)row * (size_t)map->columns + (size_t)column;
    if (!sigma && a > 0 && b > 0) return between(map->height + first, map->columns, a, b);
    for (int k = 0; k < 4; k++) {
        const int dx = k & 1, dy = k >> 1;
        const double weight = (dx ? a : 1 - a) * (dy ? b : 1 - b);
        if (weight == 0) continue; /* on the border it lies outside */
        const size_t cell = first + (size_t)dy * (size_t)map->columns + (size_t)dx;
        height += weight * map->height[cell];
        if (sigma && !(map->sigma[cell] <= worst) && !isnan(worst)) worst = map->sigma[cell];
    }
    if (sigma && !isnan(height)) *sigma = worst;
    return height;
}
