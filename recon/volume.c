/* Cut, fill and net between two maps: from the difference on one grid to sums with their sigma. */
#include "recon/volume.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/volume_internal.h"

enum { LEAST_UNCHANGED = 100 };

td_volume_options td_volume_options_default(void)
{
    return (td_volume_options){0};
}

static td_status check_options(const td_volume_options *o, td_error *error)
{
    if (!(o->correlation_m >= 0 && isfinite(o->correlation_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "correlation_m: must be 0 (estimate) or more, not %g",
                       o->correlation_m);
    if (!isnan(o->common_m) && !(o->common_m >= 0 && isfinite(o->common_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "common_m: must be 0 or more, or NaN (estimate), not %g",
                       o->common_m);
    return TD_OK;
}

static td_status check_maps(const td_elevation *before, const td_elevation *after, td_error *error)
{
    if (strcmp(before->frame, after->frame) != 0)
        return td_fail(error, TD_ERROR_DATA,
                       "the maps are in other frames, %s before and %s after: give two of one frame",
                       before->frame, after->frame);
    const char *a = before->crs ? before->crs : "none", *b = after->crs ? after->crs : "none";
    if (strcmp(a, b) != 0)
        return td_fail(
            error, TD_ERROR_DATA,
            "the maps have other coordinate reference systems, %.200s before and %.200s after: bring "
            "one into the other's (gdalwarp)",
            a, b);
    return TD_OK;
}

/* ---- the difference on one grid ---- */

static void release(volume_grid *g)
{
    free(g->d);
    free(g->sigma);
    free(g->shared);
    free(g->guessed);
    free(g->region);
    free(g->base);
    free(g->place);
}

static td_status make_grid(volume_grid *g, const td_elevation *map, td_error *error)
{
    *g = (volume_grid){.columns = map->columns, .rows = map->rows, .cell_m = map->cell_m};
    const size_t n = volume_cells(g);
    g->d = malloc(n * sizeof *g->d);
    g->sigma = malloc(n * sizeof *g->sigma);
    g->shared = malloc(n * sizeof *g->shared);
    g->guessed = calloc(n, sizeof *g->guessed);
    g->region = malloc(n * sizeof *g->region);
    g->base = malloc(n * sizeof *g->base);
    g->place = calloc(n, sizeof *g->place);
    if (g->d && g->sigma && g->shared && g->guessed && g->region && g->base && g->place) return TD_OK;
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the difference of maps of %d x %d cells",
                   map->columns, map->rows);
}

/* How `after` is read at the cells of `before`: by whole cells where the grids coincide, so that nothing is
 * lost to rounding, else between its cells. */
typedef struct reader {
    const td_elevation *before, *after;
    bool aligned;
    long long dc, dr; /* of the cell in `after` */
} reader;

static reader make_reader(const td_elevation *before, const td_elevation *after)
{
    reader r = {.before = before, .after = after};
    const double x = (before->origin[0] - after->origin[0]) / after->cell_m,
                 y = (before->origin[1] - after->origin[1]) / after->cell_m;
    const int most = before->columns > before->rows ? before->columns : before->rows;
    r.aligned = fabs(x - nearbyint(x)) < 1e-6 && fabs(y - nearbyint(y)) < 1e-6 && fabs(x) < 1e9 &&
                fabs(y) < 1e9 && fabs(before->cell_m - after->cell_m) * most < 1e-6 * after->cell_m;
    if (r.aligned) {
        r.dc = llrint(x);
        r.dr = llrint(y);
    }
    return r;
}

static double read_after(double *sigma, const reader *r, int column, int row)
{
    const td_elevation *map = r->after;
    if (!r->aligned)
        return td_elevation_at(map, r->before->origin[0] + column * r->before->cell_m,
                               r->before->origin[1] + row * r->before->cell_m, sigma);
    const long long c = column + r->dc, w = row + r->dr;
    *sigma = NAN;
    if (c < 0 || w < 0 || c >= map->columns || w >= map->rows) return NAN;
    const size_t cell = (size_t)w * (size_t)map->columns + (size_t)c;
    *sigma = map->sigma[cell];
    return map->height[cell];
}

static td_status subtract(volume_grid *g, const td_elevation *before, const td_elevation *after,
                          td_error *error)
{
    const reader r = make_reader(before, after);
    size_t known = 0;
    for (size_t i = 0, n = volume_cells(g); i < n; i++) {
        const int column = (int)(i % (size_t)g->columns), row = (int)(i / (size_t)g->columns);
        double sigma, height = read_after(&sigma, &r, column, row);
        if (sigma < 0 || before->sigma[i] < 0)
            return td_fail(error, TD_ERROR_DATA,
                           "the map %s: the sigma of the height at (%g, %g) is negative, %g",
                           sigma < 0 ? "after" : "before", before->origin[0] + column * g->cell_m,
                           before->origin[1] + row * g->cell_m, sigma < 0 ? sigma : before->sigma[i]);
        g->d[i] = height - before->height[i];
        g->sigma[i] = hypot(sigma, before->sigma[i]);
        if (!isfinite(g->d[i])) g->d[i] = g->sigma[i] = NAN;
        if (!isfinite(g->sigma[i])) g->sigma[i] = NAN;
        known += isfinite(g->d[i]);
    }
    if (known) return TD_OK;
    return td_fail(
        error, TD_ERROR_DATA,
        "the maps have no cell in common: (%g, %g) to (%g, %g) before, (%g, %g) to (%g, %g) after, or "
        "no height where they meet",
        before->origin[0], before->origin[1], before->origin[0] + (before->columns - 1) * before->cell_m,
        before->origin[1] + (before->rows - 1) * before->cell_m, after->origin[0], after->origin[1],
        after->origin[0] + (after->columns - 1) * after->cell_m,
        after->origin[1] + (after->rows - 1) * after->cell_m);
}

/* Region and, where change is not expected, base. */
static td_status set_region(volume_grid *g, const td_elevation *before, const td_volume_options *o,
                            td_error *error)
{
    const size_t n = volume_cells(g);
    size_t outside = 0, compared = 0;
    for (size_t i = 0; i < n; i++) g->region[i] = true;
    if (o->polygon) TD_TRY(volume_inside(g->region, before, o->polygon, o->polygon_count, error));
    for (size_t i = 0; i < n; i++) {
        g->base[i] = isfinite(g->d[i]) && !g->region[i];
        outside += g->base[i];
        compared += isfinite(g->d[i]) && g->region[i];
    }
    if (!compared)
        return td_fail(error, TD_ERROR_DATA, "the polygon holds no cell that is known in both maps");
    if (outside < LEAST_UNCHANGED)
        for (size_t i = 0; i < n; i++) g->base[i] = isfinite(g->d[i]);
    return TD_OK;
}

/* ---- what is noise, what is shift ---- */

static bool unchanged(const volume_grid *g, size_t cell)
{
    return g->base[cell] && !g->place[cell];
}

/* Median of d where nothing changed, as far as `place` knows by now; its spread there becomes the sigma of
 * cells that have none. */
static td_status guess_sigma(double *middle, volume_grid *g, td_error *error)
{
    const size_t n = volume_cells(g);
    size_t count = 0;
    double *d = malloc(n * sizeof *d);
    if (!d) return td_fail(error, TD_ERROR_MEMORY, "no memory for the noise of the difference");
    for (size_t i = 0; i < n; i++)
        if (unchanged(g, i)) d[count++] = g->d[i];
    if (count >= LEAST_UNCHANGED || isnan(*middle)) {
        *middle = volume_median(d, count);
        for (size_t i = 0; i < count; i++) d[i] = fabs(d[i] - *middle);
        const double spread = 1.4826022185056018 * volume_median(d, count);
        for (size_t i = 0; i < n; i++) {
            g->guessed[i] |= isfinite(g->d[i]) && isnan(g->sigma[i]);
            if (g->guessed[i]) g->sigma[i] = spread;
            g->some_guess |= g->guessed[i];
        }
    }
    free(d);
    return TD_OK;
}

enum { AROUND = 6, EACH = 2, MOST_AROUND = 49 }; /* cells to each side, of which each second */

/* Median of sigma around a cell; NaN: none is known. */
static double sigma_around(const volume_grid *g, int column, int row)
{
    double value[MOST_AROUND];
    size_t count = 0;
    for (int y = row - AROUND; y <= row + AROUND; y += EACH)
        for (int x = column - AROUND; x <= column + AROUND; x += EACH) {
            if (x < 0 || y < 0 || x >= g->columns || y >= g->rows) continue;
            const double sigma = g->sigma[(size_t)y * (size_t)g->columns + (size_t)x];
            if (isfinite(sigma)) value[count++] = sigma;
        }
    return volume_median(value, count);
}

/* What neighbours share cannot be more than they have: a sigma above twice the median around is, beyond that,
 * the cell's own, as at the edge of a stone or a trench. */
static void part_sigma(volume_grid *g)
{
    for (int r = 0; r < g->rows; r++)
        for (int c = 0; c < g->columns; c++) {
            const size_t at = (size_t)r * (size_t)g->columns + (size_t)c;
            g->shared[at] = isfinite(g->sigma[at]) ? fmin(g->sigma[at], 2 * sigma_around(g, c, r)) : NAN;
        }
}

/* Variance of the sum of weighted cells; `weight` is used up. */
static td_status variance_of(double *variance, double *weight, const volume_grid *g, double correlation_m,
                             td_error *error)
{
    double own = 0;
    for (size_t i = 0, n = volume_cells(g); i < n; i++) {
        if (weight[i] == 0) continue;
        own += weight[i] * weight[i] * (g->sigma[i] * g->sigma[i] - g->shared[i] * g->shared[i]);
        weight[i] *= g->shared[i];
    }
    TD_TRY(volume_variance(variance, weight, g, correlation_m, error));
    *variance += own;
    return TD_OK;
}

/* The mean of d where nothing changed, with its sigma. */
static td_status find_shift(td_volume *v, double *scratch, const volume_grid *g, td_error *error)
{
    size_t count = 0;
    double sum = 0, variance = 0;
    for (size_t i = 0, n = volume_cells(g); i < n; i++) {
        const bool take = unchanged(g, i);
        scratch[i] = take;
        count += take;
        if (take) sum += g->d[i];
    }
    if (count < LEAST_UNCHANGED)
        return td_fail(
            error, TD_ERROR_DATA,
            "%zu cells are unchanged, %d are needed to find the shift between the maps: give its sigma "
            "(common_m), or a map that goes on beyond the change",
            count, LEAST_UNCHANGED);
    TD_TRY(variance_of(&variance, scratch, g, v->correlation_m, error));
    v->shift_m = sum / (double)count;
    v->sigma_shift_m = sqrt(variance) / (double)count;
    return TD_OK;
}

/* Places need the noise, and the noise the places (where nothing changed): a few rounds, the first with
 * margins of a few cells. */
static td_status understand(td_volume *v, double *scratch, volume_grid *g, const td_volume_options *o,
                            bool has_sigma, td_error *error)
{
    double middle = NAN, found;
    const bool estimate = isnan(o->common_m);
    v->sigma_shift_m = estimate ? 0 : o->common_m;
    v->correlation_m = o->correlation_m > 0 ? o->correlation_m : 2 * g->cell_m;
    /* With sigma and shift given, nothing is learnt by repeating. */
    for (int round = 0; round < (estimate || g->some_guess ? 3 : 1); round++) {
        TD_TRY(guess_sigma(&middle, g, error));
        v->shift_m = estimate ? middle : 0;
        TD_TRY(volume_places(g, v->shift_m, v->sigma_shift_m, v->correlation_m, error));
    }
    part_sigma(g);
    TD_TRY(volume_noise(&v->scatter, &found, g, middle, error));
    if (!has_sigma) v->scatter = NAN;
    if (o->correlation_m == 0 && isfinite(found)) v->correlation_m = found;
    if (estimate) TD_TRY(find_shift(v, scratch, g, error));
    TD_TRY(volume_places(g, v->shift_m, v->sigma_shift_m, v->correlation_m, error));
    return estimate ? find_shift(v, scratch, g, error) : TD_OK;
}

/* ---- the sums ---- */

typedef enum which_cells { CELLS_CUT, CELLS_FILL, CELLS_REST, CELLS_ALL } which_cells;

static bool belongs(const volume_grid *g, size_t cell, which_cells which)
{
    if (!g->region[cell] || isnan(g->d[cell])) return false;
    static const signed char place[] = {-1, 1, 0};
    return which == CELLS_ALL || g->place[cell] == place[which];
}

/* Sum of d over cells, m3, and its sigma. A shift found from cells of the same map is part of the sum's
 * weights: what its cells and the sum's have in common cancels as it should. */
static td_status sum_of(double *sum, double *sigma, double *scratch, const volume_grid *g, const td_volume *v,
                        bool estimated, which_cells which, td_error *error)
{
    const size_t n = volume_cells(g);
    const double area = g->cell_m * g->cell_m;
    double total = 0, members = 0, quiet = 0, variance = 0;
    for (size_t i = 0; i < n; i++) {
        if (belongs(g, i, which)) {
            total += g->d[i] - v->shift_m;
            members++;
        }
        quiet += unchanged(g, i);
    }
    for (size_t i = 0; i < n; i++) {
        double weight = belongs(g, i, which);
        if (estimated && unchanged(g, i)) weight -= members / quiet;
        scratch[i] = weight;
    }
    TD_TRY(variance_of(&variance, scratch, g, v->correlation_m, error));
    if (!estimated) variance += members * members * v->sigma_shift_m * v->sigma_shift_m;
    *sum = area * total;
    *sigma = area * sqrt(fmax(0, variance));
    return TD_OK;
}

static td_status measure(td_volume *v, double *scratch, const volume_grid *g, bool estimated, td_error *error)
{
    TD_TRY(sum_of(&v->cut_m3, &v->sigma_cut_m3, scratch, g, v, estimated, CELLS_CUT, error));
    v->cut_m3 = v->cut_m3 == 0 ? 0 : -v->cut_m3;
    TD_TRY(sum_of(&v->fill_m3, &v->sigma_fill_m3, scratch, g, v, estimated, CELLS_FILL, error));
    TD_TRY(sum_of(&v->rest_m3, &v->sigma_rest_m3, scratch, g, v, estimated, CELLS_REST, error));
    TD_TRY(sum_of(&v->net_m3, &v->sigma_net_m3, scratch, g, v, estimated, CELLS_ALL, error));
    size_t changed = 0;
    for (size_t i = 0, n = volume_cells(g); i < n; i++) {
        if (!g->region[i]) continue;
        if (isnan(g->d[i])) {
            v->missing++;
            continue;
        }
        changed += fabs(g->d[i] - v->shift_m) > 3 * hypot(g->sigma[i], v->sigma_shift_m);
        scratch[v->cells++] = g->sigma[i];
    }
    const double area = g->cell_m * g->cell_m;
    v->area_m2 = area * (double)v->cells;
    v->changed_m2 = area * (double)changed;
    v->noise_m = volume_median(scratch, v->cells);
    return TD_OK;
}

static td_status make_difference(td_elevation **difference, const volume_grid *g, double shift,
                                 const td_elevation *before, td_error *error)
{
    td_elevation *made = NULL;
    TD_TRY(td_elevation_copy(&made, before, error));
    for (size_t i = 0, n = volume_cells(g); i < n; i++) {
        const bool known = isfinite(g->d[i]);
        made->height[i] = known ? (float)(g->d[i] - shift) : NAN;
        made->sigma[i] = known ? (float)g->sigma[i] : NAN;
        made->count[i] = known ? 1 : 0;
        made->provenance[i] = known ? TD_CELL_MEASURED : TD_CELL_UNKNOWN;
        made->time_s[i] = NAN;
    }
    *difference = made;
    return TD_OK;
}

static bool some_sigma(const volume_grid *g)
{
    for (size_t i = 0, n = volume_cells(g); i < n; i++)
        if (g->sigma[i] > 0) return true;
    return false;
}

td_status td_volume_between(td_volume *volume, td_elevation **difference, const td_elevation *before,
                            const td_elevation *after, const td_volume_options *options, td_error *error)
{
    const td_volume_options defaults = td_volume_options_default();
    const td_volume_options *o = options ? options : &defaults;
    volume_grid g;
    *volume = (td_volume){0};
    if (difference) *difference = NULL;
    TD_TRY(check_options(o, error));
    TD_TRY(check_maps(before, after, error));
    td_status status = make_grid(&g, before, error);
    double *scratch = status == TD_OK ? malloc(volume_cells(&g) * sizeof *scratch) : NULL;
    if (status == TD_OK && !scratch)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the sums over the maps");
    if (status == TD_OK) status = subtract(&g, before, after, error);
    if (status == TD_OK) status = set_region(&g, before, o, error);
    if (status == TD_OK) status = understand(volume, scratch, &g, o, some_sigma(&g), error);
    if (status == TD_OK) status = measure(volume, scratch, &g, isnan(o->common_m), error);
    if (status == TD_OK && difference)
        status = make_difference(difference, &g, volume->shift_m, before, error);
    free(scratch);
    release(&g);
    return status;
}
