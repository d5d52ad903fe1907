/* Elevation maps into the fusion, as what is known before, and out of it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/fusion_internal.h"

static const double RASTER_SLACK = 1e-6; /* cells */

/* First and last index, within the bounds, of cells whose centres lie from `low` to `high`. */
static void indices(int32_t *first, int32_t *last, double low, double high, double cell,
                    const int32_t *bounds)
{
    const double a = ceil(low / cell - RASTER_SLACK), b = floor(high / cell + RASTER_SLACK);
    *first = (int32_t)fmin(fmax(a, bounds[0]), bounds[1]);
    *last = (int32_t)fmin(fmax(b, bounds[0]), bounds[1]);
    if (b < bounds[0] || a > bounds[1]) *last = *first - 1;
}

static int32_t tile_of(int32_t cell)
{
    return (int32_t)floor((double)cell / TD_TILE_SIDE);
}

/* ---- prior ---- */

typedef struct seed {
    const td_fusion *fusion;
    const td_elevation *prior;
    double sigma_m;
    int32_t cells[4];
    td_tile **tile;
} seed;

static void seed_tile(size_t index, void *user)
{
    const seed *s = user;
    td_tile *tile = s->tile[index];
    const double side = s->fusion->options.cell_m;
    for (int i = 0; i < TD_TILE_CELLS; i++) {
        const int32_t x = tile->x * TD_TILE_SIDE + i % TD_TILE_SIDE,
                      y = tile->y * TD_TILE_SIDE + i / TD_TILE_SIDE;
        if (x < s->cells[0] || x > s->cells[1] || y < s->cells[2] || y > s->cells[3]) continue;
        double sigma;
        const double height = td_elevation_at(s->prior, x * side, y * side, &sigma);
        if (isnan(sigma)) sigma = s->sigma_m;
        td_cell *cell = &tile->cell[i];
        if (isnan(height) || cell->provenance != TD_CELL_UNKNOWN) continue;
        cell->now.height = (float)(height - tile->base);
        cell->now.noise = (float)(sigma * sigma);
        cell->provenance = TD_CELL_PRIOR;
        cell->time_s = NAN;
    }
}

static td_status check_prior(const td_fusion *f, const td_elevation *prior, double sigma_m, td_error *error)
{
    if (f->frames > 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "the prior map must be given before the first frame");
    if (strcmp(prior->frame, f->options.frame) != 0)
        return td_fail(error, TD_ERROR_DATA, "the prior map is in frame '%s', this map in '%s'", prior->frame,
                       f->options.frame);
    const size_t n = (size_t)prior->columns * (size_t)prior->rows;
    bool needed = false;
    for (size_t i = 0; i < n; i++) {
        if (isnan(prior->height[i])) continue;
        needed |= isnan(prior->sigma[i]);
        if (isinf(prior->height[i]) || prior->sigma[i] < 0 || isinf(prior->sigma[i]))
            return td_fail(error, TD_ERROR_DATA,
                           "the prior map's cell (%zu, %zu) has height %g m and sigma %g m",
                           i % (size_t)prior->columns, i / (size_t)prior->columns, (double)prior->height[i],
                           (double)prior->sigma[i]);
    }
    if (needed && !(sigma_m > 0 && isfinite(sigma_m)))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "the prior map has no sigma, and sigma_m is %g: say how well it is known", sigma_m);
    return TD_OK;
}

/* Makes the tiles of columns `x` of one row of tiles and fills them, as many at a time as fit. */
static td_status seed_row(td_fusion *f, seed *s, const int32_t x[2], int32_t y, double base, td_error *error)
{
    for (int32_t from = x[0]; from <= x[1];) {
        size_t n = 0;
        for (; from <= x[1] && n < f->capacity; from++)
            TD_TRY(td_tiles_make(&s->tile[n++], f, from, y, base, error));
        TD_TRY(td_tiles_fetch(f, s->tile, n, error));
        td_parallel_for(n, f->options.threads, seed_tile, s, NULL, NULL);
    }
    return TD_OK;
}

static double mean_height(const td_elevation *prior)
{
    double sum = 0, n = 0;
    for (size_t i = 0; i < (size_t)prior->columns * (size_t)prior->rows; i++)
        if (!isnan(prior->height[i])) sum += (double)prior->height[i], n++;
    return n > 0 ? sum / n : 0;
}

td_status td_fusion_prior(td_fusion *f, const td_elevation *prior, double sigma_m, td_error *error)
{
    TD_TRY(check_prior(f, prior, sigma_m, error));
    seed s = {.fusion = f, .prior = prior, .sigma_m = sigma_m};
    const int count[2] = {prior->columns, prior->rows};
    for (int i = 0; i < 2; i++)
        indices(&s.cells[2 * i], &s.cells[2 * i + 1], prior->origin[i],
                prior->origin[i] + prior->cell_m * (count[i] - 1), f->options.cell_m, f->bounds + 2 * i);
    if (s.cells[1] < s.cells[0] || s.cells[3] < s.cells[2])
        return td_fail(error, TD_ERROR_DATA, "the prior map has no cell in the region");
    const int32_t x[2] = {tile_of(s.cells[0]), tile_of(s.cells[1])};
    const int32_t y[2] = {tile_of(s.cells[2]), tile_of(s.cells[3])};
    TD_TRY(td_tiles_check_room(f, (size_t)(x[1] - x[0] + 1) * (size_t)(y[1] - y[0] + 1), error));
    char *crs = prior->crs ? strdup(prior->crs) : NULL;
    s.tile = malloc((size_t)(x[1] - x[0] + 1) * sizeof(td_tile *));
    td_status status =
        s.tile && (crs || !prior->crs) ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    const double base = round(mean_height(prior));
    for (int32_t row = y[0]; status == TD_OK && row <= y[1]; row++)
        status = seed_row(f, &s, x, row, base, error);
    free(s.tile);
    if (status == TD_OK && crs) {
        free(f->crs);
        f->crs = crs;
        crs = NULL;
    }
    free(crs);
    return status;
}

/* ---- map ---- */

/* Cells from first to last of the tiles. */
static bool extent(int32_t cells[4], const td_fusion *f)
{
    for (size_t i = 0; i < f->tile_count; i++) {
        const int32_t x = f->tile[i]->x * TD_TILE_SIDE, y = f->tile[i]->y * TD_TILE_SIDE;
        if (i == 0 || x < cells[0]) cells[0] = x;
        if (i == 0 || x + TD_TILE_SIDE - 1 > cells[1]) cells[1] = x + TD_TILE_SIDE - 1;
        if (i == 0 || y < cells[2]) cells[2] = y;
        if (i == 0 || y + TD_TILE_SIDE - 1 > cells[3]) cells[3] = y + TD_TILE_SIDE - 1;
    }
    return f->tile_count > 0;
}

/* Copies what of the tile lies in the map. */
static void copy_tile(td_elevation *map, td_elevation *noise, const int32_t cells[4], const td_tile *tile,
                      const td_cell *cell)
{
    for (int i = 0; i < TD_TILE_CELLS; i++) {
        const td_cell *c = &cell[i];
        const int32_t x = tile->x * TD_TILE_SIDE + i % TD_TILE_SIDE,
                      y = tile->y * TD_TILE_SIDE + i / TD_TILE_SIDE;
        if (c->provenance == TD_CELL_UNKNOWN || x < cells[0] || x > cells[1] || y < cells[2] || y > cells[3])
            continue;
        const size_t at = (size_t)(y - cells[2]) * (size_t)map->columns + (size_t)(x - cells[0]);
        map->height[at] = (float)(tile->base + (double)c->now.height);
        map->sigma[at] = (float)td_cell_sigma(c);
        map->count[at] = c->now.count;
        map->provenance[at] = c->provenance;
        map->time_s[at] = c->time_s;
        if (!noise) continue;
        noise->height[at] = map->height[at];
        noise->sigma[at] = sqrtf(c->now.noise);
        noise->count[at] = map->count[at];
        noise->provenance[at] = c->provenance;
        noise->time_s[at] = c->time_s;
    }
}

static td_status make_map(td_elevation **map, const td_fusion *f, const int32_t cells[4], td_error *error)
{
    const double origin[2] = {cells[0] * f->options.cell_m, cells[2] * f->options.cell_m};
    const double columns = (double)cells[1] - cells[0] + 1, rows = (double)cells[3] - cells[2] + 1;
    if (columns * rows > TD_ELEVATION_MAX_CELLS)
        return td_fail(error, TD_ERROR_DATA,
                       "a map of %.0f x %.0f cells is too large for one file, %d are the most: ask for it in "
                       "parts (a region), or take larger cells",
                       columns, rows, TD_ELEVATION_MAX_CELLS);
    TD_TRY(
        td_elevation_new(map, (int)columns, (int)rows, f->options.cell_m, origin, f->options.frame, error));
    if (f->crs && !((*map)->crs = strdup(f->crs)))
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a map");
    return TD_OK;
}

static td_status copy_all(td_elevation *map, td_elevation *noise, const td_fusion *f, const int32_t cells[4],
                          td_error *error)
{
    td_cell *scratch = malloc(TD_TILE_CELLS * sizeof *scratch);
    if (!scratch) return td_fail(error, TD_ERROR_MEMORY, "no memory for a tile");
    td_status status = TD_OK;
    for (size_t i = 0; status == TD_OK && i < f->tile_count; i++) {
        const td_tile *t = f->tile[i];
        const td_cell *cell;
        const int32_t x = t->x * TD_TILE_SIDE, y = t->y * TD_TILE_SIDE;
        if (x > cells[1] || x + TD_TILE_SIDE <= cells[0] || y > cells[3] || y + TD_TILE_SIDE <= cells[2])
            continue;
        status = td_tiles_peek(&cell, scratch, f, t, error);
        if (status == TD_OK) copy_tile(map, noise, cells, t, cell);
    }
    free(scratch);
    return status;
}

/* How much lower, m, the mean over a cell at the rim is, where what it does not show of itself lies as low as
 * the lowest of its known neighbours; 0 where all are known. It does not show what it lacks of the points
 * that a neighbour has. */
static double hidden_drop(const td_elevation *map, int column, int row)
{
    const size_t here = (size_t)row * (size_t)map->columns + (size_t)column;
    float lowest = map->height[here];
    uint32_t most = map->count[here];
    bool rim = false;
    for (int r = row - 1; r <= row + 1; r++)
        for (int c = column - 1; c <= column + 1; c++) {
            if (c < 0 || r < 0 || c >= map->columns || r >= map->rows) continue;
            const size_t at = (size_t)r * (size_t)map->columns + (size_t)c;
            rim |= !isfinite(map->height[at]);
            if (!isfinite(map->height[at])) continue;
            lowest = fminf(lowest, map->height[at]);
            if (map->count[at] > most) most = map->count[at];
        }
    if (!rim || most == 0) return 0;
    return (double)(map->height[here] - lowest) * (1 - (double)map->count[here] / most);
}

/* A cell at the rim of what was seen is seen in part, and nothing beyond it says how the ground goes on. What
 * is hidden lies lower than what hides it (the lip of a trench, a stone's edge): where the mean would be
 * lower by more than noise (2 sigma), 2 sigma reach down to it. */
static void widen_border(td_elevation *map, td_elevation *noise)
{
    for (int r = 0; r < map->rows; r++)
        for (int c = 0; c < map->columns; c++) {
            const size_t at = (size_t)r * (size_t)map->columns + (size_t)c;
            if (map->provenance[at] != TD_CELL_MEASURED && map->provenance[at] != TD_CELL_FUSED) continue;
            const double own = (double)map->sigma[at], drop = hidden_drop(map, c, r);
            const double beyond = sqrt(fmax(0, drop * drop - 4 * own * own)) / 2;
            map->sigma[at] = (float)hypot(own, beyond);
            if (noise) noise->sigma[at] = (float)hypot((double)noise->sigma[at], beyond);
        }
}

static td_status make_maps(td_elevation **map, td_elevation **noise, const td_fusion *f,
                           const int32_t cells[4], td_error *error)
{
    td_status status = make_map(map, f, cells, error);
    if (status == TD_OK && noise) status = make_map(noise, f, cells, error);
    if (status == TD_OK) status = copy_all(*map, noise ? *noise : NULL, f, cells, error);
    if (status == TD_OK) widen_border(*map, noise ? *noise : NULL);
    if (status != TD_OK) {
        td_elevation_free(map);
        if (noise) td_elevation_free(noise);
    }
    return status;
}

td_status td_fusion_map(td_elevation **map, td_elevation **noise, const td_fusion *f, td_error *error)
{
    int32_t cells[4];
    const double *r = f->options.region;
    *map = NULL;
    if (noise) *noise = NULL;
    if (r[0] != r[2]) return td_fusion_map_of(map, noise, f, r, error);
    if (!extent(cells, f))
        return td_fail(error, TD_ERROR_DATA, "nothing has been measured: the map is empty");
    return make_maps(map, noise, f, cells, error);
}

td_status td_fusion_map_of(td_elevation **map, td_elevation **noise, const td_fusion *f,
                           const double region[4], td_error *error)
{
    int32_t cells[4];
    *map = NULL;
    if (noise) *noise = NULL;
    for (int i = 0; i < 4; i++)
        if (!isfinite(region[i]))
            return td_fail(error, TD_ERROR_ARGUMENT, "region: must be of finite numbers");
    for (int i = 0; i < 2; i++)
        indices(&cells[2 * i], &cells[2 * i + 1], region[i], region[2 + i], f->options.cell_m,
                f->bounds + 2 * i);
    if (cells[1] < cells[0] || cells[3] < cells[2])
        return td_fail(error, TD_ERROR_ARGUMENT, "region: %g, %g, %g, %g holds no cell", region[0], region[1],
                       region[2], region[3]);
    return make_maps(map, noise, f, cells, error);
}
