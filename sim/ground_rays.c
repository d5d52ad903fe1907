/* Rays against an elevation map, down a pyramid of lowest and highest heights (Tevs, Ihrke and Seidel 2008,
 * "Maximum mipmaps"). The ray is walked in units of cells: over the squares of a level it steps from side to
 * side by whole numbers, so that no square is left out whatever rounding does; a square whose heights the ray
 * passes over or under is skipped whole, else the level below is entered. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sim/stereo_view_internal.h"

/* A crossing may lie this far outside its patch, in cells: rounding at the seams. */
static const double SEAM = 1e-9;

/* Where rays that are known to be clear so far begin: squares of 2 x 2 patches. */
enum { START_LEVEL = 1 };

static const td_span NONE = {INFINITY, -INFINITY};

static inline td_span join(td_span a, td_span b)
{
    return (td_span){a.low < b.low ? a.low : b.low, a.high > b.high ? a.high : b.high};
}

static inline td_span patch_span(const td_elevation *map, int i, int j)
{
    const float *a = map->height + (size_t)j * map->columns + i, *b = a + map->columns;
    const float sum = a[0] + a[1] + b[0] + b[1];
    if (sum != sum) return NONE;
    return join(join((td_span){a[0], a[0]}, (td_span){a[1], a[1]}),
                join((td_span){b[0], b[0]}, (td_span){b[1], b[1]}));
}

static td_span span_of(const td_ground_rays *g, int level, int i, int j)
{
    if (i >= g->width[level] || j >= g->height[level]) return NONE;
    return level ? g->span[level][(size_t)j * g->width[level] + i] : patch_span(g->map, i, j);
}

static void fill_level(td_ground_rays *g, int level, int left, int top, int right, int bottom)
{
    for (int j = top; j <= bottom; j++)
        for (int i = left; i <= right; i++)
            g->span[level][(size_t)j * g->width[level] + i] = join(
                join(span_of(g, level - 1, 2 * i, 2 * j), span_of(g, level - 1, 2 * i + 1, 2 * j)),
                join(span_of(g, level - 1, 2 * i, 2 * j + 1), span_of(g, level - 1, 2 * i + 1, 2 * j + 1)));
}

td_status td_ground_rays_new(td_ground_rays *ground, const td_elevation *map, td_error *error)
{
    *ground = (td_ground_rays){.map = map, .levels = 1};
    ground->width[0] = map->columns - 1;
    ground->height[0] = map->rows - 1;
    if (ground->width[0] < 1 || ground->height[0] < 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the ground: %d x %d cells are no surface; at least 2 x 2 are needed", map->columns,
                       map->rows);
    while (ground->width[ground->levels - 1] > 1 || ground->height[ground->levels - 1] > 1) {
        const int level = ground->levels;
        ground->width[level] = (ground->width[level - 1] + 1) / 2;
        ground->height[level] = (ground->height[level - 1] + 1) / 2;
        ground->span[level] = malloc((size_t)ground->width[level] * ground->height[level] * sizeof(td_span));
        ground->levels++;
        if (!ground->span[level]) {
            td_ground_rays_free(ground);
            return td_fail(error, TD_ERROR_MEMORY, "no memory for the pyramid of a map of %d x %d cells",
                           map->columns, map->rows);
        }
        fill_level(ground, level, 0, 0, ground->width[level] - 1, ground->height[level] - 1);
    }
    return TD_OK;
}

void td_ground_rays_free(td_ground_rays *ground)
{
    for (int level = 1; level < ground->levels; level++) free(ground->span[level]);
    *ground = (td_ground_rays){0};
}

static int clamped(int value, int last)
{
    return value < 0 ? 0 : value > last ? last : value;
}

void td_ground_rays_update(td_ground_rays *ground, int column, int row, int columns, int rows)
{
    if (columns < 1 || rows < 1) return;
    /* A cell is a corner of the patches on both sides of it. */
    int left = clamped(column - 1, ground->width[0] - 1),
        right = clamped(column + columns - 1, ground->width[0] - 1);
    int top = clamped(row - 1, ground->height[0] - 1),
        bottom = clamped(row + rows - 1, ground->height[0] - 1);
    for (int level = 1; level < ground->levels; level++) {
        left /= 2;
        right /= 2;
        top /= 2;
        bottom /= 2;
        fill_level(ground, level, left, top, right, bottom);
    }
}

/* A ray in the map's grid: u, v in cells, z in m; the distance at which a line u = c is crossed is
 * c scale[0] + shift[0]: never, for a ray along it. */
typedef struct grid_ray {
    double o[3], d[3], scale[2], shift[2];
} grid_ray;

static inline double line_at(const grid_ray *r, int axis, double line)
{
    return line * r->scale[axis] + r->shift[axis];
}

static inline grid_ray to_grid(const td_elevation *map, const double origin[3], const double ray[3])
{
    const double scale = 1 / map->cell_m;
    grid_ray r;
    for (int a = 0; a < 2; a++) {
        r.o[a] = (origin[a] - map->origin[a]) * scale;
        r.d[a] = ray[a] * scale;
        const bool crosses = fabs(r.d[a]) > 1e-300;
        if (!crosses) r.d[a] = 0;
        r.scale[a] = crosses ? 1 / r.d[a] : 0;
        r.shift[a] = crosses ? -r.o[a] * r.scale[a] : INFINITY;
    }
    r.o[2] = origin[2];
    r.d[2] = ray[2];
    return r;
}

/* Cuts [*begin, *end] to where the ray is over the map's patches; false: nowhere. */
static inline bool cut(double *begin, double *end, const grid_ray *r, int axis, int size)
{
    if (r->d[axis] == 0) return r->o[axis] >= 0 && r->o[axis] <= size;
    const double a = line_at(r, axis, 0), b = line_at(r, axis, size);
    const double enters = a < b ? a : b, leaves = a < b ? b : a;
    if (enters > *begin) *begin = enters;
    if (leaves < *end) *end = leaves;
    return *begin <= *end;
}

/* First crossing of a bilinear patch in [begin, end], or INFINITY. With s the distance from `begin`, the
 * ray's height over the patch z - (a + b u + c v + e u v) is the quadratic q0 + q1 s + q2 s^2. */
static inline double cross_patch(const td_elevation *map, const grid_ray *r, int i, int j, double begin,
                                 double end)
{
    const float *low = map->height + (size_t)j * map->columns + i, *high = low + map->columns;
    const double a = low[0], b = low[1] - a, c = high[0] - a, e = high[1] - a - b - c;
    const double u = r->o[0] + begin * r->d[0] - i, v = r->o[1] + begin * r->d[1] - j;
    const double q0 = r->o[2] + begin * r->d[2] - (a + b * u + c * v + e * u * v);
    const double q1 = r->d[2] - b * r->d[0] - c * r->d[1] - e * (u * r->d[1] + v * r->d[0]);
    const double q2 = -e * r->d[0] * r->d[1];
    const double slack = SEAM / (fabs(r->d[0]) + fabs(r->d[1]) + 1), last = end - begin + slack;
    double s[2];
    /* Citardauq's form for the small root, so that a nearly plane patch loses no digits. */
    const double discriminant = q1 * q1 - 4 * q2 * q0;
    if (!(discriminant >= 0)) return INFINITY;
    const double half = -0.5 * (q1 + copysign(sqrt(discriminant), q1));
    s[0] = half != 0 ? q0 / half : q0 == 0 ? 0 : INFINITY;
    s[1] = q2 != 0 ? half / q2 : INFINITY;
    if (s[0] > s[1]) {
        const double swap = s[0];
        s[0] = s[1];
        s[1] = swap;
    }
    for (int k = 0; k < 2; k++)
        if (s[k] >= -slack && s[k] <= last) return begin + (s[k] > 0 ? s[k] : 0);
    return INFINITY;
}

/* Which half of a square of `size` cells that begins at `index` size the ray is in at `begin`. */
static inline int half_at(const grid_ray *r, int axis, int index, double half_size, double begin)
{
    const double line = (2 * index + 1) * half_size;
    if (r->d[axis] == 0) return r->o[axis] >= line;
    return (begin >= line_at(r, axis, line)) == (r->d[axis] > 0);
}

/* From a square to the one of its four that holds the ray at `begin`; on the map's far edge, to the last. */
static inline void enter(const td_ground_rays *g, const grid_ray *r, int level, int at[2], double half_size,
                         double begin)
{
    const int last[2] = {g->width[level] - 1, g->height[level] - 1};
    for (int a = 0; a < 2; a++) {
        at[a] = 2 * at[a] + half_at(r, a, at[a], half_size, begin);
        if (at[a] > last[a]) at[a] = last[a];
    }
}

/* The square of START_LEVEL below the ray at `begin`, if it is one of the map's; else the only one of the
 * top. A square too far by rounding does no harm: the ray is inside the map, or well above the ground. */
static inline int start(const td_ground_rays *g, const grid_ray *r, double begin, bool clear, int at[2])
{
    const int *size[2] = {g->width, g->height};
    at[0] = at[1] = 0;
    if (!clear || g->levels <= START_LEVEL) return g->levels - 1;
    for (int a = 0; a < 2; a++) {
        at[a] = (int)(r->o[a] + begin * r->d[a]) >> START_LEVEL;
        if (at[a] < 0) at[a] = 0;
        if (at[a] >= size[a][START_LEVEL]) at[a] = size[a][START_LEVEL] - 1;
    }
    return START_LEVEL;
}

static inline double walk(const td_ground_rays *g, const grid_ray *r, double begin, double end, bool clear)
{
    const int step[2] = {r->d[0] > 0 ? 1 : -1, r->d[1] > 0 ? 1 : -1};
    int at[2], level = start(g, r, begin, clear, at);
    while (begin <= end) {
        const double size = (double)(1 << level);
        const double exit_u = line_at(r, 0, (at[0] + (step[0] > 0)) * size);
        const double exit_v = line_at(r, 1, (at[1] + (step[1] > 0)) * size);
        const double exit = exit_u <= exit_v ? exit_u : exit_v, stop = exit < end ? exit : end;
        const double z0 = r->o[2] + begin * r->d[2], z1 = r->o[2] + stop * r->d[2];
        const td_span span = span_of(g, level, at[0], at[1]);
        const bool meets = (z0 < z1 ? z0 : z1) <= span.high + SEAM && (z0 > z1 ? z0 : z1) >= span.low - SEAM;
        if (meets && level > 0) {
            enter(g, r, --level, at, 0.5 * size, begin);
            continue;
        }
        if (meets) {
            const double found = cross_patch(g->map, r, at[0], at[1], begin, stop);
            if (found < INFINITY) return found;
        }
        if (!(exit < end)) return INFINITY;
        const int axis = exit_u <= exit_v ? 0 : 1;
        const int from = at[axis], *limit = axis ? g->height : g->width;
        at[axis] += step[axis];
        if (at[axis] < 0 || at[axis] >= limit[level]) return INFINITY;
        /* Out of the square above as well: go on there. */
        if (level + 1 < g->levels && (from >> 1) != (at[axis] >> 1)) {
            level++;
            at[0] >>= 1;
            at[1] >>= 1;
        }
        begin = exit > begin ? exit : begin;
    }
    return INFINITY;
}

double td_ground_rays_cast(const td_ground_rays *ground, const double origin[3], const double ray[3],
                           double clear, double end)
{
    const grid_ray r = to_grid(ground->map, origin, ray);
    double begin = clear, stop = end;
    if (!cut(&begin, &stop, &r, 0, ground->width[0]) || !cut(&begin, &stop, &r, 1, ground->height[0]))
        return end;
    const double found = walk(ground, &r, begin, stop, clear > 0);
    return found < end ? found : end;
}

/* ---- beams ---- */

/* Rays from one point: lowest and highest components of their directions, in the grid. */
typedef struct beam {
    double o[3], low[3], high[3];
} beam;

/* Highest ground below a part of the beam, from the level where few squares cover it. */
static float highest_below(const td_ground_rays *g, const beam *b, double begin, double end)
{
    int first[2], last[2], level = 0;
    const int *size[2] = {g->width, g->height};
    for (int a = 0; a < 2; a++) {
        const double low = b->o[a] + fmin(b->low[a] * begin, b->low[a] * end);
        const double high = b->o[a] + fmax(b->high[a] * begin, b->high[a] * end);
        if (high < 0 || low > size[a][0]) return -INFINITY;
        first[a] = low > 0 ? (int)low : 0;
        last[a] = high < size[a][0] - 1 ? (int)high : size[a][0] - 1;
    }
    while (level < g->levels - 1 &&
           ((last[0] >> level) - (first[0] >> level) > 1 || (last[1] >> level) - (first[1] >> level) > 1))
        level++;
    float highest = -INFINITY;
    for (int j = first[1] >> level; j <= last[1] >> level; j++)
        for (int i = first[0] >> level; i <= last[0] >> level; i++) {
            const td_span span = span_of(g, level, i, j);
            if (span.high > highest) highest = span.high;
        }
    return highest;
}

double td_ground_rays_clear(const td_ground_rays *ground, const double origin[3], const double (*ray)[3],
                            int count)
{
    const td_elevation *map = ground->map;
    const double scale[3] = {1 / map->cell_m, 1 / map->cell_m, 1};
    beam b = {.low = {INFINITY, INFINITY, INFINITY}, .high = {-INFINITY, -INFINITY, -INFINITY}};
    for (int a = 0; a < 3; a++) {
        b.o[a] = (origin[a] - (a < 2 ? map->origin[a] : 0)) * scale[a];
        for (int i = 0; i < count; i++) {
            const double d = ray[i][a] * scale[a];
            if (d < b.low[a]) b.low[a] = d;
            if (d > b.high[a]) b.high[a] = d;
        }
    }
    /* Parts of the beam, longer while they are clear, shorter where the ground is near. */
    double clear = 0, step = 16 * map->cell_m;
    const double shortest = map->cell_m, far = 4 * map->cell_m * (map->columns + map->rows);
    while (clear < far && step >= shortest) {
        const double next = clear + step;
        const double lowest = b.o[2] + fmin(b.low[2] * clear, b.low[2] * next);
        if (lowest > highest_below(ground, &b, clear, next) + SEAM) {
            clear = next;
            step *= 2;
        } else {
            step *= 0.5;
        }
    }
    return clear;
}

/* Slopes at a cell; one-sided beside the edge or a hole. */
static void slope_at(const td_elevation *map, int i, int j, double slope[2])
{
    const float *h = map->height + (size_t)j * map->columns + i;
    const float here = h[0];
    const float west = i > 0 ? h[-1] : NAN, east = i + 1 < map->columns ? h[1] : NAN;
    const float south = j > 0 ? h[-map->columns] : NAN, north = j + 1 < map->rows ? h[map->columns] : NAN;
    const float side[2][2] = {{west, east}, {south, north}};
    for (int a = 0; a < 2; a++) {
        const float back = side[a][0], front = side[a][1];
        slope[a] = !isnan(back) && !isnan(front) ? 0.5 * (front - back)
                   : !isnan(front)               ? front - here
                   : !isnan(back)                ? here - back
                                                 : 0;
    }
}

/* Sums of the slopes at the four corners of patch (i, j), weighted. */
static void slope_in(const td_elevation *map, int i, int j, double u, double v, double slope[2])
{
    const float *h = map->height + (size_t)j * map->columns + i;
    const ptrdiff_t row = map->columns;
    if (i > 0 && j > 0 && i + 2 < map->columns && j + 2 < map->rows) {
        const double x0 = (1 - u) * (h[1] - h[-1]) + u * (h[2] - h[0]);
        const double x1 = (1 - u) * (h[row + 1] - h[row - 1]) + u * (h[row + 2] - h[row]);
        const double y0 = (1 - v) * (h[row] - h[-row]) + v * (h[2 * row] - h[0]);
        const double y1 = (1 - v) * (h[row + 1] - h[1 - row]) + v * (h[2 * row + 1] - h[1]);
        slope[0] = 0.5 * ((1 - v) * x0 + v * x1);
        slope[1] = 0.5 * ((1 - u) * y0 + u * y1);
        if (slope[0] == slope[0] && slope[1] == slope[1]) return;
    }
    slope[0] = slope[1] = 0;
    for (int k = 0; k < 4; k++) {
        double corner[2];
        const double weight = (k & 1 ? u : 1 - u) * (k & 2 ? v : 1 - v);
        slope_at(map, i + (k & 1), j + (k >> 1), corner);
        slope[0] += weight * corner[0];
        slope[1] += weight * corner[1];
    }
}

void td_ground_rays_normal(const td_ground_rays *ground, double x, double y, double normal[3])
{
    const td_elevation *map = ground->map;
    const double u = (x - map->origin[0]) / map->cell_m, v = (y - map->origin[1]) / map->cell_m;
    const int i = clamped((int)u, ground->width[0] - 1), j = clamped((int)v, ground->height[0] - 1);
    double slope[2];
    slope_in(map, i, j, u - i, v - j, slope);
    const double scale = 1 / sqrt(slope[0] * slope[0] + slope[1] * slope[1] + map->cell_m * map->cell_m);
    normal[0] = -slope[0] * scale;
    normal[1] = -slope[1] * scale;
    normal[2] = map->cell_m * scale;
}
