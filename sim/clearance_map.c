#include <math.h>
#include <stdlib.h>

#include "sim/clearance_internal.h"

double clearance_cell_sigma(const td_clearance_map *map, size_t cell)
{
    const double sigma = map->elevation->sigma[cell];
    return isnan(sigma) ? map->sigma_m : sigma;
}

static void fill_tile(td_clearance_map *map, int i, int j)
{
    const td_elevation *e = map->elevation;
    const int size = 1 << CLEARANCE_TILE;
    float top = -INFINITY, highest = -INFINITY;
    bool hole = false;
    for (int row = j * size; row < (j + 1) * size && row < e->rows; row++)
        for (int column = i * size; column < (i + 1) * size && column < e->columns; column++) {
            const size_t cell = (size_t)row * (size_t)e->columns + (size_t)column;
            const double high = e->height[cell] + CLEARANCE_SIGMAS * clearance_cell_sigma(map, cell);
            if (isnan(e->height[cell])) hole = true;
            if (e->height[cell] > highest) highest = e->height[cell];
            if (high > top) top = nextafterf((float)high, INFINITY);
        }
    const size_t at = (size_t)j * (size_t)map->width[0] + (size_t)i;
    map->high[0][at] = highest;
    map->top[0][at] = top;
    map->hole[0][at] = hole;
}

static void fill_node(td_clearance_map *map, int level, int i, int j)
{
    const int below = level - 1;
    float top = -INFINITY, highest = -INFINITY;
    uint8_t hole = 0;
    for (int row = 2 * j; row < 2 * j + 2 && row < map->height[below]; row++)
        for (int column = 2 * i; column < 2 * i + 2 && column < map->width[below]; column++) {
            const size_t at = (size_t)row * (size_t)map->width[below] + (size_t)column;
            if (map->high[below][at] > highest) highest = map->high[below][at];
            if (map->top[below][at] > top) top = map->top[below][at];
            hole |= map->hole[below][at];
        }
    const size_t at = (size_t)j * (size_t)map->width[level] + (size_t)i;
    map->high[level][at] = highest;
    map->top[level][at] = top;
    map->hole[level][at] = hole;
}

static td_status check_cells(const td_clearance_map *map, int left, int bottom, int right, int up,
                             td_error *error)
{
    const td_elevation *e = map->elevation;
    for (int row = bottom; row <= up; row++)
        for (int column = left; column <= right; column++) {
            const size_t cell = (size_t)row * (size_t)e->columns + (size_t)column;
            const double sigma = clearance_cell_sigma(map, cell);
            if (isnan(e->height[cell])) continue;
            if (!isfinite(e->height[cell]) || !(sigma >= 0) || !isfinite(sigma))
                return td_fail(error, TD_ERROR_DATA,
                               "the map's cell (%d, %d) has the height %g and the sigma %g; both must be "
                               "known: give a sigma for cells without one",
                               column, row, e->height[cell], sigma);
        }
    return TD_OK;
}

td_status td_clearance_map_update(td_clearance_map *map, int column, int row, int columns, int rows,
                                  td_error *error)
{
    const td_elevation *e = map->elevation;
    const int last[2] = {e->columns - 1, e->rows - 1};
    if (columns < 1 || rows < 1 || column > last[0] || row > last[1]) return TD_OK;
    int left = column > 0 ? column : 0, bottom = row > 0 ? row : 0;
    int right = columns - 1 < last[0] - column ? column + columns - 1 : last[0];
    int up = rows - 1 < last[1] - row ? row + rows - 1 : last[1];
    TD_TRY(check_cells(map, left, bottom, right, up, error));
    for (int level = 0; level < map->levels; level++) {
        const int shift = level ? 1 : CLEARANCE_TILE;
        left >>= shift;
        bottom >>= shift;
        right >>= shift;
        up >>= shift;
        for (int j = bottom; j <= up; j++)
            for (int i = left; i <= right; i++)
                if (level)
                    fill_node(map, level, i, j);
                else
                    fill_tile(map, i, j);
    }
    return TD_OK;
}

td_status td_clearance_map_new(td_clearance_map **map, const td_elevation *elevation, double sigma_m,
                               td_error *error)
{
    *map = NULL;
    if (!isnan(sigma_m) && (!(sigma_m >= 0) || !isfinite(sigma_m)))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "sigma_m: must be a number of metres from 0, or NaN for none, not %g", sigma_m);
    td_clearance_map *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for the map's pyramid");
    made->elevation = elevation;
    made->sigma_m = sigma_m;
    const int size = 1 << CLEARANCE_TILE;
    int width = (elevation->columns + size - 1) / size, height = (elevation->rows + size - 1) / size;
    for (;; width = (width + 1) / 2, height = (height + 1) / 2) {
        const int level = made->levels++;
        made->width[level] = width;
        made->height[level] = height;
        made->high[level] = malloc((size_t)width * (size_t)height * sizeof *made->high[level]);
        made->top[level] = malloc((size_t)width * (size_t)height * sizeof *made->top[level]);
        made->hole[level] = malloc((size_t)width * (size_t)height * sizeof *made->hole[level]);
        if (!made->high[level] || !made->top[level] || !made->hole[level]) {
            td_clearance_map_free(&made);
            return td_fail(error, TD_ERROR_MEMORY, "no memory for the pyramid of a map of %d x %d cells",
                           elevation->columns, elevation->rows);
        }
        if (width == 1 && height == 1) break;
    }
    const td_status status = td_clearance_map_update(made, 0, 0, elevation->columns, elevation->rows, error);
    if (status != TD_OK) td_clearance_map_free(&made);
    *map = made;
    return status;
}

void td_clearance_map_free(td_clearance_map **map)
{
    if (!map || !*map) return;
    for (int level = 0; level < (*map)->levels; level++) {
        free((*map)->high[level]);
        free((*map)->top[level]);
        free((*map)->hole[level]);
    }
    free(*map);
    *map = NULL;
}

double clearance_top(const td_clearance_map *map, const double low[2], const double high[2])
{
    const td_elevation *e = map->elevation;
    const int size[2] = {e->columns, e->rows};
    int first[2], last[2], level = 0;
    for (int a = 0; a < 2; a++) {
        const double from = floor((low[a] - e->origin[a]) / e->cell_m);
        const double to = ceil((high[a] - e->origin[a]) / e->cell_m);
        if (!(to >= 0 && from <= size[a] - 1)) return -INFINITY;
        first[a] = from > 0 ? (int)from : 0;
        last[a] = to < size[a] - 1 ? (int)to : size[a] - 1;
        first[a] >>= CLEARANCE_TILE;
        last[a] >>= CLEARANCE_TILE;
    }
    while ((last[0] >> level) - (first[0] >> level) > 1 || (last[1] >> level) - (first[1] >> level) > 1)
        level++;
    double top = -INFINITY;
    for (int j = first[1] >> level; j <= last[1] >> level; j++)
        for (int i = first[0] >> level; i <= last[0] >> level; i++) {
            const double one = map->top[level][(size_t)j * (size_t)map->width[level] + (size_t)i];
            if (one > top) top = one;
        }
    return top;
}
