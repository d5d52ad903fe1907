#include <math.h>
#include <string.h>

#include "sim/clearance_internal.h"

/* Between four cells: the surface's height, slopes, and what each cell has to do with it. */
typedef struct patch {
    int32_t cell;
    double height, slope[2], weight[4];
} patch;

/* False beside unknown cells and outside. */
static bool patch_at(patch *at, const td_elevation *e, double x, double y)
{
    const double u = (x - e->origin[0]) / e->cell_m, v = (y - e->origin[1]) / e->cell_m;
    if (!(u >= 0 && v >= 0 && u <= e->columns - 1 && v <= e->rows - 1) || e->columns < 2 || e->rows < 2)
        return false;
    const int i = u < e->columns - 1 ? (int)u : e->columns - 2, j = v < e->rows - 1 ? (int)v : e->rows - 2;
    const size_t cell = (size_t)j * (size_t)e->columns + (size_t)i;
    const float *low = e->height + cell, *high = low + e->columns;
    const double a = u - i, b = v - j;
    at->cell = (int32_t)cell;
    at->weight[0] = (1 - a) * (1 - b);
    at->weight[1] = a * (1 - b);
    at->weight[2] = (1 - a) * b;
    at->weight[3] = a * b;
    at->height =
        at->weight[0] * low[0] + at->weight[1] * low[1] + at->weight[2] * high[0] + at->weight[3] * high[1];
    at->slope[0] = ((1 - b) * (low[1] - low[0]) + b * (high[1] - high[0])) / e->cell_m;
    at->slope[1] = ((1 - a) * (high[0] - low[0]) + a * (high[1] - low[1])) / e->cell_m;
    return !isnan(at->height);
}

double clearance_surface(const td_elevation *ground, double x, double y)
{
    patch at;
    return patch_at(&at, ground, x, y) ? at.height : NAN;
}

/* Upwards from the ground. Steeper than 45 degrees it is taken as 45: such a side is a cell wide at most, and
 * the cell on top of it is met as a point of its own. */
static void normal_of(double n[3], const patch *at)
{
    const double square = at->slope[0] * at->slope[0] + at->slope[1] * at->slope[1];
    const double less = square > 1 ? 1 / sqrt(square) : 1, scale = 1 / sqrt(1 + fmin(square, 1));
    n[0] = -at->slope[0] * less * scale;
    n[1] = -at->slope[1] * less * scale;
    n[2] = scale;
}

static void visit_cells(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape,
                        int tile_i, int tile_j)
{
    const td_elevation *e = map->elevation;
    const int size = 1 << CLEARANCE_TILE;
    for (int row = tile_j * size; row < (tile_j + 1) * size && row < e->rows; row++)
        for (int column = tile_i * size; column < (tile_i + 1) * size && column < e->columns; column++) {
            const size_t cell = (size_t)row * (size_t)e->columns + (size_t)column;
            if (isnan(e->height[cell])) continue;
            clearance_point point = {
                .cell = (int32_t)cell,
                .p = {e->origin[0] + column * e->cell_m, e->origin[1] + row * e->cell_m, e->height[cell]},
                .weight = {1}};
            double g[3];
            point.distance = point.margin = clearance_distance(g, shape, point.p);
            if (point.distance > visit->limit &&
                point.distance - CLEARANCE_SIGMAS * clearance_cell_sigma(map, cell) > visit->reach)
                continue;
            for (int a = 0; a < 3; a++) point.n[a] = -g[a];
            visit->point(visit, &point);
        }
}

/* No ground in the node, a rectangle and all that is not above `top`, is nearer than this. */
static double node_distance(const clearance_shape *s, const double low[2], const double high[2], double top)
{
    double square = 0;
    for (int a = 0; a < 3; a++) {
        const double below = a < 2 ? s->low[a] - high[a] : s->low[a] - top;
        const double above = a < 2 ? low[a] - s->high[a] : -1;
        const double out = below > above ? below : above;
        if (out > 0) square += out * out;
    }
    /* The distance is convex along the vertical: where it grows downwards, all that is lower is further. */
    double g[3];
    const double p[3] = {0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), top};
    const double distance = clearance_distance(g, s, p), x = high[0] - low[0], y = high[1] - low[1];
    const double least = g[2] <= 0 ? distance - 0.5 * sqrt(x * x + y * y) : -INFINITY;
    return square > 0 ? fmax(least, sqrt(square)) : least;
}

static void descend(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape,
                    int level, int i, int j)
{
    const td_elevation *e = map->elevation;
    const size_t node = (size_t)j * (size_t)map->width[level] + (size_t)i;
    const double highest = map->high[level][node], noise = map->top[level][node] - highest;
    const int size = 1 << (CLEARANCE_TILE + level), at[2] = {i, j}, cells[2] = {e->columns, e->rows};
    double low[2], high[2];
    if (highest == -INFINITY) return;
    for (int a = 0; a < 2; a++) {
        const int last = at[a] < (cells[a] - 1) / size ? (at[a] + 1) * size - 1 : cells[a] - 1;
        low[a] = e->origin[a] + at[a] * size * e->cell_m;
        high[a] = e->origin[a] + last * e->cell_m;
    }
    const double least = node_distance(shape, low, high, highest);
    if (least > visit->limit && least - noise > visit->reach) return;
    if (level == 0) {
        visit_cells(visit, map, shape, i, j);
        return;
    }
    for (int k = 0; k < 4; k++) {
        const int child[2] = {2 * i + (k & 1), 2 * j + (k >> 1)};
        if (child[0] < map->width[level - 1] && child[1] < map->height[level - 1])
            descend(visit, map, shape, level - 1, child[0], child[1]);
    }
}

/* The surface of a shape around a point of one of its lines, against the patch below. Touching is decided
 * by the plane of the patch (margin); the distance is that of the surface's point straight below. */
static void visit_line_point(clearance_visit *visit, const td_clearance_map *map,
                             const clearance_shape *shape, const double q[3], double round)
{
    clearance_point point = {.patch = true};
    double p[3] = {q[0], q[1], q[2]}, g[3];
    patch at;
    if (!patch_at(&at, map->elevation, q[0], q[1])) return;
    if (round > 0) {
        normal_of(point.n, &at);
        for (int a = 0; a < 3; a++) p[a] -= round * point.n[a];
        if (!patch_at(&at, map->elevation, p[0], p[1])) return;
    }
    const double gap = p[2] - at.height;
    normal_of(point.n, &at);
    point.margin = point.distance = gap * point.n[2];
    const double noise = CLEARANCE_SIGMAS * clearance_cell_sigma(map, (size_t)at.cell);
    if (point.margin > visit->limit && point.margin - noise > visit->reach) return;
    point.cell = at.cell;
    memcpy(point.weight, at.weight, sizeof point.weight);
    memcpy(point.p, p, sizeof p);
    point.p[2] = at.height;
    if (gap > 0) point.distance = clearance_distance(g, shape, point.p);
    visit->point(visit, &point);
}

static void visit_line(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape,
                       double end[2][3], double round)
{
    enum { CHUNK = 8 };
    double d[3];
    for (int a = 0; a < 3; a++) d[a] = end[1][a] - end[0][a];
    const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    const int steps = (int)ceil(length / map->elevation->cell_m);
    for (int first = 0; first <= steps; first += CHUNK + 1) {
        const int last = first + CHUNK < steps ? first + CHUNK : steps;
        const double from = steps ? (double)first / steps : 0, to = steps ? (double)last / steps : 0;
        double low[3], high[3];
        for (int a = 0; a < 3; a++) {
            const double u = end[0][a] + from * d[a], v = end[0][a] + to * d[a];
            low[a] = fmin(u, v) - round;
            high[a] = fmax(u, v) + round;
        }
        /* The plane of a patch is nearer than straight below by cos 45 at most. */
        if (0.7 * (low[2] - clearance_top(map, low, high)) > fmax(visit->limit, visit->reach)) continue;
        for (int k = first; k <= last; k++) {
            const double part = steps ? (double)k / steps : 0;
            const double q[3] = {end[0][0] + part * d[0], end[0][1] + part * d[1], end[0][2] + part * d[2]};
            visit_line_point(visit, map, shape, q, round);
        }
    }
}

/* The ground straight below the centre: a first limit. */
static void visit_below(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape)
{
    clearance_point point = {.patch = true};
    patch at;
    double g[3];
    if (!patch_at(&at, map->elevation, shape->t[0], shape->t[1])) return;
    point.p[0] = shape->t[0];
    point.p[1] = shape->t[1];
    point.p[2] = at.height;
    point.cell = at.cell;
    memcpy(point.weight, at.weight, sizeof point.weight);
    point.distance = clearance_distance(g, shape, point.p);
    point.margin = INFINITY;
    visit->point(visit, &point);
}

void clearance_near(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape)
{
    double line[CLEARANCE_LINES][2][3], round;
    const int lines = clearance_lines(line, &round, shape);
    if (isinf(visit->limit)) visit_below(visit, map, shape);
    descend(visit, map, shape, map->levels - 1, 0, 0);
    if (0.7 * (shape->low[2] - clearance_top(map, shape->low, shape->high)) >
        fmax(visit->limit, visit->reach))
        return;
    for (int k = 0; k < lines; k++) visit_line(visit, map, shape, line[k], round);
}

/* ---- unknown ground ---- */

static bool hole_reached(double at[3], const td_clearance_map *map, const clearance_shape *s, int cell_i,
                         int cell_j, double top)
{
    const td_elevation *e = map->elevation;
    double g[3];
    if (!isnan(e->height[(size_t)cell_j * (size_t)e->columns + (size_t)cell_i])) return false;
    at[0] = e->origin[0] + cell_i * e->cell_m;
    at[1] = e->origin[1] + cell_j * e->cell_m;
    const double z[2] = {fmin(top, s->t[2]), fmin(top, s->low[2])};
    for (int k = 0; k < 2; k++) {
        at[2] = z[k];
        if (clearance_distance(g, s, at) <= e->cell_m) break;
        if (k == 1) return false;
    }
    at[2] = top;
    return true;
}

static bool descend_holes(double at[3], const td_clearance_map *map, const clearance_shape *s, int level,
                          int i, int j, double top)
{
    const td_elevation *e = map->elevation;
    const int size = 1 << (CLEARANCE_TILE + level), first[2] = {i * size, j * size};
    if (!map->hole[level][(size_t)j * (size_t)map->width[level] + (size_t)i]) return false;
    for (int a = 0; a < 2; a++) {
        const double low = e->origin[a] + (first[a] - 1) * e->cell_m, high = low + (size + 1) * e->cell_m;
        if (s->high[a] < low || s->low[a] > high) return false;
    }
    if (level == 0) {
        for (int row = first[1]; row < first[1] + size && row < e->rows; row++)
            for (int column = first[0]; column < first[0] + size && column < e->columns; column++)
                if (hole_reached(at, map, s, column, row, top)) return true;
        return false;
    }
    for (int k = 0; k < 4; k++) {
        const int child[2] = {2 * i + (k & 1), 2 * j + (k >> 1)};
        if (child[0] < map->width[level - 1] && child[1] < map->height[level - 1] &&
            descend_holes(at, map, s, level - 1, child[0], child[1], top))
            return true;
    }
    return false;
}

bool clearance_unseen(double at[3], const td_clearance_map *map, const clearance_shape *s, double top)
{
    const td_elevation *e = map->elevation;
    const int cells[2] = {e->columns, e->rows};
    if (s->low[2] > top) return false;
    memcpy(at, s->t, 2 * sizeof *at);
    at[2] = top;
    for (int a = 0; a < 2; a++) {
        const double last = e->origin[a] + (cells[a] - 1) * e->cell_m;
        if (s->low[a] < e->origin[a])
            at[a] = s->low[a];
        else if (s->high[a] > last)
            at[a] = s->high[a];
        else
            continue;
        return true;
    }
    return descend_holes(at, map, s, map->levels - 1, 0, 0, top);
}
