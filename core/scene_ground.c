/* Grounds of a scene: read from a map, or made from a few numbers: hills of gradient noise, stones on them, a
 * trench dug and a mound heaped. The same numbers always make the same ground. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "core/scene_internal.h"

enum { MAX_SIDE = 8192, MAX_CELLS = 1 << 24, MAX_ROCKS = 10000, HILL_OCTAVES = 8 };

static const double FAR_M = 1e5, DEVIATION = 0.215714;

typedef struct recipe {
    int columns, rows, seed, rock_count;
    double cell_m, origin[2], roughness_m, scale_m, slope[2], rock_m[2];
    bool has_trench, has_mound;
    double from[2], to[2], width_m, depth_m;
    double at[2], radius_m, height_m;
} recipe;

/* ---- making ---- */

/* Gradient at a corner of the lattice of octave `octave`. */
static void gradient(double g[2], int seed, int octave, int i, int j)
{
    td_random random = td_random_seed((uint64_t)seed * 64 + (uint64_t)octave,
                                      (uint64_t)(uint32_t)i << 32 | (uint64_t)(uint32_t)j);
    const double angle = 6.283185307179586 * td_random_uniform(&random);
    g[0] = cos(angle);
    g[1] = sin(angle);
}

static double fade(double t)
{
    return t * t * t * (t * (t * 6 - 15) + 10);
}

/* Gradient noise (Perlin 2002) in the plane; its standard deviation is 2 sqrt(A B), A and B the integrals of
 * w^2 and w^2 t^2 over [0, 1], w = 1 - fade(t). */
static double noise(double x, double y, int seed, int octave)
{
    const double fx = floor(x), fy = floor(y), u = x - fx, v = y - fy;
    double value[4];
    for (int k = 0; k < 4; k++) {
        double g[2];
        gradient(g, seed, octave, (int)fx + (k & 1), (int)fy + (k >> 1));
        value[k] = g[0] * (u - (k & 1)) + g[1] * (v - (k >> 1));
    }
    const double a = value[0] + fade(u) * (value[1] - value[0]),
                 b = value[2] + fade(u) * (value[3] - value[2]);
    return a + fade(v) * (b - a);
}

static double hills(const recipe *r, double x, double y)
{
    double sum = 0, amplitude = 1, power = 0, scale = r->scale_m;
    for (int o = 0; o < HILL_OCTAVES && scale > 2 * r->cell_m; o++, amplitude *= 0.45, scale *= 0.5) {
        sum += amplitude * noise(x / scale + 0.37 * o, y / scale + 0.71 * o, r->seed, o);
        power += amplitude * amplitude;
    }
    return power > 0 ? r->roughness_m * sum / (DEVIATION * sqrt(power)) : 0;
}

static double distance_to_line(const double a[2], const double b[2], double x, double y)
{
    const double dx = b[0] - a[0], dy = b[1] - a[1], square = dx * dx + dy * dy;
    double t = square > 0 ? ((x - a[0]) * dx + (y - a[1]) * dy) / square : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return hypot(x - a[0] - t * dx, y - a[1] - t * dy);
}

/* Steep walls, 4 : 1, a flat floor with the ground's roughness. */
static double trench(const recipe *r, double x, double y)
{
    const double outside = distance_to_line(r->from, r->to, x, y) - 0.5 * r->width_m;
    const double depth = -4 * outside;
    return depth < 0 ? 0 : depth < r->depth_m ? -depth : -r->depth_m;
}

/* A smooth heap. */
static double mound(const recipe *r, double x, double y)
{
    const double distance = hypot(x - r->at[0], y - r->at[1]) / r->radius_m;
    if (distance >= 1) return 0;
    const double rough = 1 + 0.25 * noise(3 * x, 3 * y, r->seed, 60);
    return r->height_m * rough * 0.5 * (1 + cos(3.141592653589793 * distance));
}

/* Half-sunk ellipsoids, cut by planes so that they have faces. */
static void add_rock(td_elevation *map, const recipe *r, td_random *random)
{
    const double width = (r->columns - 1) * r->cell_m, height = (r->rows - 1) * r->cell_m;
    const double x = r->origin[0] + width * td_random_uniform(random);
    const double y = r->origin[1] + height * td_random_uniform(random);
    /* Many small ones, few large ones. */
    const double share = td_random_uniform(random);
    const double size = r->rock_m[0] + (r->rock_m[1] - r->rock_m[0]) * share * share * share;
    double plane[5][3];
    for (int k = 0; k < 5; k++) {
        const double angle = 1.2566370614359172 * (k + 0.8 * td_random_uniform(random));
        const double rise = 0.3 + 0.5 * td_random_uniform(random);
        plane[k][0] = cos(angle) / (0.5 * size);
        plane[k][1] = sin(angle) / (0.5 * size);
        plane[k][2] = rise * size;
    }
    const int c0 = (int)ceil((x - size - r->origin[0]) / r->cell_m),
              c1 = (int)((x + size - r->origin[0]) / r->cell_m);
    const int r0 = (int)ceil((y - size - r->origin[1]) / r->cell_m),
              r1 = (int)((y + size - r->origin[1]) / r->cell_m);
    const double base = td_elevation_at(map, x, y, NULL);
    for (int row = r0 < 0 ? 0 : r0; row <= r1 && row < r->rows; row++)
        for (int column = c0 < 0 ? 0 : c0; column <= c1 && column < r->columns; column++) {
            const double dx = r->origin[0] + column * r->cell_m - x, dy = r->origin[1] + row * r->cell_m - y;
            double top = 0.45 * size;
            for (int k = 0; k < 5; k++) {
                const double share_out = plane[k][0] * dx + plane[k][1] * dy;
                const double h = plane[k][2] * 2 * (1 - share_out);
                if (h < top) top = h;
            }
            float *cell = map->height + (size_t)row * map->columns + column;
            if (top > 0 && base + top > *cell) *cell = (float)(base + top);
        }
}

static td_status make(td_elevation **map, const recipe *r, td_error *error)
{
    TD_TRY(td_elevation_new(map, r->columns, r->rows, r->cell_m, r->origin, "site", error));
    td_elevation *m = *map;
    for (int row = 0; row < r->rows; row++)
        for (int column = 0; column < r->columns; column++) {
            const double x = r->origin[0] + column * r->cell_m, y = r->origin[1] + row * r->cell_m;
            const size_t at = (size_t)row * r->columns + column;
            m->height[at] = (float)(hills(r, x, y) + r->slope[0] * x + r->slope[1] * y);
            m->sigma[at] = 0;
            m->provenance[at] = TD_CELL_PRIOR;
        }
    td_random random = td_random_seed((uint64_t)r->seed, 77);
    for (int k = 0; k < r->rock_count; k++) add_rock(m, r, &random);
    for (int row = 0; row < r->rows; row++)
        for (int column = 0; column < r->columns; column++) {
            const double x = r->origin[0] + column * r->cell_m, y = r->origin[1] + row * r->cell_m;
            float *h = m->height + (size_t)row * r->columns + column;
            if (r->has_trench) *h += (float)trench(r, x, y);
            if (r->has_mound) *h += (float)mound(r, x, y);
        }
    return TD_OK;
}

/* ---- reading ---- */

static td_status parse_rocks(recipe *r, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"count", "size_m", NULL};
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field count = td_field_get(field, "count"), size = td_field_get(field, "size_m");
    TD_TRY(td_field_int(&r->rock_count, &count, 0, MAX_ROCKS, error));
    TD_TRY(td_field_reals(r->rock_m, 2, &size, 1e-3, 100, error));
    if (r->rock_m[0] <= r->rock_m[1]) return TD_OK;
    return td_field_fail(&size, error, "the smallest, %g, is above the largest, %g", r->rock_m[0],
                         r->rock_m[1]);
}

static td_status parse_trench(recipe *r, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"from_m", "to_m", "width_m", "depth_m", NULL};
    r->has_trench = field->value != NULL;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field from = td_field_get(field, "from_m"), to = td_field_get(field, "to_m");
    const td_field width = td_field_get(field, "width_m"), depth = td_field_get(field, "depth_m");
    TD_TRY(td_field_reals(r->from, 2, &from, -FAR_M, FAR_M, error));
    TD_TRY(td_field_reals(r->to, 2, &to, -FAR_M, FAR_M, error));
    TD_TRY(td_field_real(&r->width_m, &width, 1e-3, 1e3, error));
    return td_field_real(&r->depth_m, &depth, 0, 1e2, error);
}

static td_status parse_mound(recipe *r, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"at_m", "radius_m", "height_m", NULL};
    r->has_mound = field->value != NULL;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field at = td_field_get(field, "at_m"), radius = td_field_get(field, "radius_m");
    const td_field height = td_field_get(field, "height_m");
    TD_TRY(td_field_reals(r->at, 2, &at, -FAR_M, FAR_M, error));
    TD_TRY(td_field_real(&r->radius_m, &radius, 1e-3, 1e3, error));
    return td_field_real(&r->height_m, &height, 0, 1e2, error);
}

static td_status parse_recipe(recipe *r, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"columns",     "rows",    "cell_m", "origin_m", "seed",  "slope",
                                       "roughness_m", "scale_m", "rocks",  "trench",   "mound", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field columns = td_field_get(field, "columns"), rows = td_field_get(field, "rows");
    const td_field cell = td_field_get(field, "cell_m"), origin = td_field_get(field, "origin_m");
    const td_field slope = td_field_get(field, "slope"), rocks = td_field_get(field, "rocks");
    const td_field dug = td_field_get(field, "trench"), heap = td_field_get(field, "mound");
    *r = (recipe){.scale_m = 4};
    TD_TRY(td_field_int(&r->columns, &columns, 2, MAX_SIDE, error));
    TD_TRY(td_field_int(&r->rows, &rows, 2, MAX_SIDE, error));
    if (r->columns * r->rows > MAX_CELLS)
        return td_field_fail(&columns, error, "%d x %d cells are more than %d", r->columns, r->rows,
                             MAX_CELLS);
    TD_TRY(td_field_real(&r->cell_m, &cell, 1e-3, 10, error));
    TD_TRY(td_field_reals(r->origin, 2, &origin, -FAR_M, FAR_M, error));
    TD_TRY(td_scene_int(&r->seed, field, "seed", 0, 1 << 30, error));
    TD_TRY(td_scene_real(&r->roughness_m, field, "roughness_m", 0, 10, error));
    TD_TRY(td_scene_real(&r->scale_m, field, "scale_m", 1e-2, 1e3, error));
    if (slope.value) TD_TRY(td_field_reals(r->slope, 2, &slope, -2, 2, error));
    TD_TRY(parse_rocks(r, &rocks, error));
    TD_TRY(parse_trench(r, &dug, error));
    return parse_mound(r, &heap, error);
}

td_status td_scene_ground_parse(td_elevation **map, const td_field *field, const char *folder,
                                td_error *error)
{
    static const char *const keys[] = {"name", "map", "generate", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field file = td_field_get(field, "map"), generate = td_field_get(field, "generate");
    recipe r;
    if (!file.value == !generate.value)
        return td_field_fail(field, error, "either 'map: FILE' or 'generate: {…}' is needed");
    if (generate.value) {
        TD_TRY(parse_recipe(&r, &generate, error));
        return folder ? make(map, &r, error) : TD_OK;
    }
    char *path = NULL;
    TD_TRY(td_scene_path(&path, &file, folder, error));
    td_status status = path ? td_elevation_read(map, path, error) : TD_OK;
    free(path);
    return status;
}
