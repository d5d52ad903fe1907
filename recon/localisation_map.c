/* A map made ready for registration: smoothed heights, and slopes by differences over pairs of cells. */
#include <math.h>
#include <stdlib.h>

#include "recon/localisation_internal.h"

enum { SLOPE_RADIUS = 2 }; /* of the map itself: 5 x 5 cells, so that noise does not look like relief */

static float height_at(const td_elevation *map, int column, int row)
{
    if (column < 0 || row < 0 || column >= map->columns || row >= map->rows) return NAN;
    return map->height[(size_t)row * (size_t)map->columns + (size_t)column];
}

/* Sums over the columns and rows before: the sum of any rectangle is four of them. */
typedef struct running {
    double *height; /* (rows + 1, columns + 1) */
    int *known;
    int columns, rows;
} running;

static void release(running *r)
{
    free(r->height);
    free(r->known);
}

static bool sum_up(running *r, const td_elevation *map)
{
    const size_t wide = (size_t)map->columns + 1, size = wide * ((size_t)map->rows + 1);
    *r = (running){calloc(size, sizeof(double)), calloc(size, sizeof(int)), map->columns, map->rows};
    if (!r->height || !r->known) return false;
    for (int row = 0; row < map->rows; row++)
        for (int column = 0; column < map->columns; column++) {
            const size_t at = (size_t)(row + 1) * wide + (size_t)column + 1;
            const float h = height_at(map, column, row);
            r->height[at] = r->height[at - 1] + r->height[at - wide] - r->height[at - wide - 1];
            r->known[at] = r->known[at - 1] + r->known[at - wide] - r->known[at - wide - 1];
            if (isnan(h)) continue;
            r->height[at] += (double)h;
            r->known[at]++;
        }
    return true;
}

/* Mean of the known cells around; NaN where the cell itself or half of them are unknown. */
static float smooth(const running *r, const td_elevation *map, int column, int row, int radius)
{
    if (radius == 0 || isnan(height_at(map, column, row))) return height_at(map, column, row);
    const int x[2] = {column > radius ? column - radius : 0,
                      column + radius + 1 < r->columns ? column + radius + 1 : r->columns};
    const int y[2] = {row > radius ? row - radius : 0,
                      row + radius + 1 < r->rows ? row + radius + 1 : r->rows};
    const size_t wide = (size_t)r->columns + 1;
    double sum = 0;
    int known = 0;
    for (int k = 0; k < 4; k++) {
        const size_t at = (size_t)y[k / 2] * wide + (size_t)x[k % 2];
        const int sign = k == 0 || k == 3 ? 1 : -1;
        sum += sign * r->height[at];
        known += sign * r->known[at];
    }
    return 2 * known > (2 * radius + 1) * (2 * radius + 1) ? (float)(sum / known) : NAN;
}

/* Least-squares slope along an axis from the pairs of cells that lie opposite each other. */
static float slope(const td_elevation *map, int column, int row, int axis)
{
    double sum = 0, square = 0;
    int pairs = 0;
    for (int along = 1; along <= SLOPE_RADIUS; along++)
        for (int across = -SLOPE_RADIUS; across <= SLOPE_RADIUS; across++) {
            const int x = axis == 0 ? along : across, y = axis == 0 ? across : along;
            const int bx = axis == 0 ? -along : across, by = axis == 0 ? across : -along;
            const float a = height_at(map, column + x, row + y), b = height_at(map, column + bx, row + by);
            if (isnan(a) || isnan(b)) continue;
            sum += along * ((double)a - (double)b);
            square += 2.0 * along * along;
            pairs++;
        }
    return 2 * pairs > SLOPE_RADIUS * (2 * SLOPE_RADIUS + 1) ? (float)(sum / (square * map->cell_m)) : NAN;
}

/* The same of smoothed heights, by the two neighbours. */
static float smooth_slope(const td_ground_level *level, int column, int row, int axis)
{
    const td_elevation *map = level->map;
    const int c[2] = {axis == 0 ? column - 1 : column, axis == 0 ? column + 1 : column};
    const int r[2] = {axis == 1 ? row - 1 : row, axis == 1 ? row + 1 : row};
    if (c[0] < 0 || r[0] < 0 || c[1] >= map->columns || r[1] >= map->rows) return NAN;
    const float a = level->height[(size_t)r[0] * (size_t)map->columns + (size_t)c[0]];
    const float b = level->height[(size_t)r[1] * (size_t)map->columns + (size_t)c[1]];
    return (float)(((double)b - (double)a) / (2 * map->cell_m));
}

/* Correlation of the noise of two cells so many apart. */
static double alike(double columns, double rows, double correlation)
{
    return exp(-(columns * columns + rows * rows) / (correlation * correlation));
}

/* Variance of such a slope over that of a height; the correlation is in cells. */
static double slope_noise(int radius, double correlation, double cell_m)
{
    double sum = 0, square = 0;
    for (int x = -radius; x <= radius; x++)
        for (int y = -radius; y <= radius; y++) {
            square += x * x;
            for (int u = -radius; u <= radius; u++)
                for (int v = -radius; v <= radius; v++) sum += x * u * alike(x - u, y - v, correlation);
        }
    return sum / (square * square * cell_m * cell_m);
}

td_status td_ground_level_new(td_ground_level *level, const td_elevation *map, int radius, double map_sigma_m,
                              double correlation_m, td_error *error)
{
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    running sums;
    *level = (td_ground_level){.map = map, .radius = radius, .map_sigma_m = map_sigma_m};
    const double correlation = correlation_m / map->cell_m;
    level->slope_noise = slope_noise(SLOPE_RADIUS, correlation, map->cell_m);
    level->beside = alike(1, 0, correlation);
    level->correlation_m = correlation_m;
    level->height = malloc(cells * sizeof(float));
    for (int k = 0; k < 2; k++) level->slope[k] = malloc(cells * sizeof(float));
    const bool summed = sum_up(&sums, map);
    if (!summed || !level->height || !level->slope[0] || !level->slope[1]) {
        release(&sums);
        td_ground_level_free(level);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a map of %d x %d cells", map->columns,
                       map->rows);
    }
    for (size_t i = 0; i < cells; i++)
        level->height[i] =
            smooth(&sums, map, (int)(i % (size_t)map->columns), (int)(i / (size_t)map->columns), radius);
    release(&sums);
    for (size_t i = 0; i < cells; i++) {
        const int column = (int)(i % (size_t)map->columns), row = (int)(i / (size_t)map->columns);
        for (int k = 0; k < 2; k++) {
            const bool known = !isnan(level->height[i]);
            level->slope[k][i] = !known        ? NAN
                                 : radius == 0 ? slope(map, column, row, k)
                                               : smooth_slope(level, column, row, k);
        }
    }
    return TD_OK;
}

void td_ground_level_free(td_ground_level *level)
{
    free(level->height);
    free(level->slope[0]);
    free(level->slope[1]);
    *level = (td_ground_level){0};
}

bool td_ground_at(double *height, double slope_at[2], double *variance, const td_ground_level *level,
                  double x, double y)
{
    const td_elevation *map = level->map;
    const double u = (x - map->origin[0]) / map->cell_m, v = (y - map->origin[1]) / map->cell_m;
    if (!(u >= 0 && v >= 0 && u < map->columns - 1 && v < map->rows - 1)) return false;
    const int c = (int)u, r = (int)v;
    const double a = u - c, b = v - r, weight[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
    *height = slope_at[0] = slope_at[1] = *variance = 0;
    for (int k = 0; k < 4; k++) {
        const size_t i = (size_t)(r + k / 2) * (size_t)map->columns + (size_t)(c + k % 2);
        const double sigma = isnan(map->sigma[i]) ? level->map_sigma_m : (double)map->sigma[i];
        *height += weight[k] * (double)level->height[i];
        slope_at[0] += weight[k] * (double)level->slope[0][i];
        slope_at[1] += weight[k] * (double)level->slope[1][i];
        *variance += weight[k] * sigma * sigma;
    }
    /* Of a mean of four that are alike: along each side 1 - 2 a (1 - a) (1 - rho). */
    *variance *= (1 - 2 * a * (1 - a) * (1 - level->beside)) * (1 - 2 * b * (1 - b) * (1 - level->beside));
    return !isnan(*height) && !isnan(slope_at[0]) && !isnan(slope_at[1]);
}
