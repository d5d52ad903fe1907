#include "sim/soil_internal.h"

#include <stdlib.h>

static const double MG = 1e-6, LEAP_M = 2, DEGREE = 0.017453292519943295;
/* The grid's gradient is that of the slope along x and y, and up to 2 % more along diagonals: heaps stand off
 * by half of it either way. */
static const double BETWEEN = 1.01;
enum { MAX_SETTLING = 1000000 };

/* ---- what there is ---- */

td_soil_options td_soil_options_default(void)
{
    return (td_soil_options){.period_s = 0.02,
                             .sweeps = 4,
                             .flow_cells = 4000,
                             .floor_m = 5,
                             .gravity = 9.80665,
                             .slip_m_s = 0.01};
}

static td_status check_options(const td_soil_options *o, td_error *error)
{
    const struct {
        const char *name;
        double value, low, high;
    } field[] = {{"period_s", o->period_s, 1e-4, 1},    {"sweeps", o->sweeps, 1, 1000},
                 {"flow_cells", o->flow_cells, 1, 1e9}, {"floor_m", o->floor_m, 0.01, 100},
                 {"gravity", o->gravity, 0.01, 100},    {"slip_m_s", o->slip_m_s, 1e-6, 1}};
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].value >= field[i].low && field[i].value <= field[i].high))
            return td_fail(error, TD_ERROR_ARGUMENT, "soil: %s: must be %g to %g, not %g", field[i].name,
                           field[i].low, field[i].high, field[i].value);
    return TD_OK;
}

static td_status check_map(int64_t *known, const td_elevation *map, td_error *error)
{
    *known = 0;
    if (!map)
        return td_fail(error, TD_ERROR_ARGUMENT, "soil: there is no map to dig in; read or make one first");
    if (map->columns < 1 || map->rows < 1 || map->columns > TD_SOIL_MAX_CELLS / map->rows)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "soil: a map of %d x %d cells: at most %d can be dug in; cut out the work site or take "
            "larger cells",
            map->columns, map->rows, TD_SOIL_MAX_CELLS);
    for (size_t i = 0, n = (size_t)map->columns * (size_t)map->rows; i < n; i++) {
        if (isinf(map->height[i]))
            return td_fail(error, TD_ERROR_DATA, "soil: the map's cell (%d, %d) is infinitely high; mend it",
                           (int)(i % (size_t)map->columns), (int)(i / (size_t)map->columns));
        *known += !isnan(map->height[i]);
    }
    if (*known == 0)
        return td_fail(error, TD_ERROR_DATA,
                       "soil: no cell of the map has a height: it is one hole; give a map of seen ground");
    return TD_OK;
}

static td_status set_units(td_soil *s, td_error *error)
{
    const td_soil_preset *p = &s->preset;
    const double area = s->map->cell_m * s->map->cell_m;
    const double column = s->options.floor_m * area * p->density_kg_m3 / MG;
    s->bank_m = MG / (p->density_kg_m3 * area);
    s->loose_m3 = MG * p->swell / p->density_kg_m3;
    s->loose_m = s->loose_m3 / area;
    s->steep_m = BETWEEN * tan(p->repose_rad) * s->map->cell_m;
    s->stand_m =
        4 * p->cohesion_pa / (p->density_kg_m3 * s->options.gravity) * tan(45 * DEGREE + p->friction_rad / 2);
    if (!(column >= 1000 && column * (double)s->known_cells < 1e18))
        return td_fail(error, TD_ERROR_DATA,
                       "soil: cells of %g m are too %s to count their soil in milligrams; resample the map",
                       s->map->cell_m, column >= 1000 ? "large" : "small");
    s->column_mg = llround(column);
    return TD_OK;
}

td_status td_soil_new(td_soil **soil, const td_elevation *map, const td_soil_preset *preset,
                      const td_soil_bucket *bucket, const td_soil_options *options, td_error *error)
{
    const td_soil_options o = options ? *options : td_soil_options_default();
    int64_t known = 0;
    *soil = NULL;
    TD_TRY(check_options(&o, error));
    TD_TRY(td_soil_preset_check(preset, error));
    if (bucket) TD_TRY(soil_bucket_check(bucket, error));
    TD_TRY(check_map(&known, map, error));
    td_soil *s = calloc(1, sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory for soil");
    const size_t n = (size_t)map->columns * (size_t)map->rows;
    s->preset = *preset;
    s->options = o;
    s->has_bucket = bucket != NULL;
    if (bucket) s->bucket = *bucket;
    s->known_cells = known;
    s->last_ground = NAN;
    s->state.disturbed[2] = s->state.disturbed[3] = -1;
    s->cell = calloc(n, sizeof *s->cell);
    s->surface = malloc(n * sizeof *s->surface);
    s->awake = calloc(n, sizeof *s->awake);
    td_status status = s->cell && s->surface && s->awake
                           ? td_elevation_copy(&s->map, map, error)
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for the soil of %zu cells", n);
    if (status == TD_OK) status = set_units(s, error);
    for (size_t i = 0; status == TD_OK && i < n; i++) s->surface[i] = (double)map->height[i];
    if (status != TD_OK) td_soil_free(&s);
    *soil = s;
    return status;
}

void td_soil_free(td_soil **soil)
{
    if (!soil || !*soil) return;
    td_soil *s = *soil;
    for (int k = 0; k < SOIL_CLASSES; k++) free(s->active[k].place);
    free(s->found.place);
    free(s->parcel);
    free(s->cell);
    free(s->surface);
    free(s->awake);
    td_elevation_free(&s->map);
    free(s);
    *soil = NULL;
}

/* ---- putting soil down ---- */

double soil_ground(const td_soil *s, double x, double y)
{
    const double u = round((x - s->map->origin[0]) / s->map->cell_m);
    const double v = round((y - s->map->origin[1]) / s->map->cell_m);
    if (!(u >= 0 && v >= 0 && u < s->map->columns && v < s->map->rows)) return NAN;
    return s->surface[soil_index(s, (int)u, (int)v)];
}

static void disturb(td_soil *s, soil_place p)
{
    int *d = s->state.disturbed;
    if (d[2] < 0) {
        d[0] = d[2] = p.column;
        d[1] = d[3] = p.row;
        return;
    }
    if (p.column < d[0]) d[0] = p.column;
    if (p.row < d[1]) d[1] = p.row;
    if (p.column > d[2]) d[2] = p.column;
    if (p.row > d[3]) d[3] = p.row;
}

void soil_change(td_soil *s, soil_place p, int64_t taken, int64_t loose)
{
    const size_t i = soil_index(s, p.column, p.row);
    soil_cell *cell = s->cell + i;
    cell->taken += taken;
    cell->loose += loose;
    s->surface[i] = soil_bank(s, i) + (double)cell->loose * s->loose_m;
    disturb(s, p);
}

/* First and last cell whose centres may lie between two coordinates. */
static bool span(int range[2], double low, double high, double origin, double cell, int count)
{
    const double first = ceil((low - origin) / cell - 1e-9), last = floor((high - origin) / cell + 1e-9);
    if (!(last >= 0 && first <= count - 1 && last >= first)) return false;
    range[0] = (int)fmax(first, 0);
    range[1] = (int)fmin(last, count - 1);
    return true;
}

bool soil_span(int box[4], const td_soil *s, const double low[2], const double high[2])
{
    const td_elevation *m = s->map;
    int column[2], row[2];
    if (!span(column, low[0], high[0], m->origin[0], m->cell_m, m->columns) ||
        !span(row, low[1], high[1], m->origin[1], m->cell_m, m->rows))
        return false;
    box[0] = column[0], box[1] = row[0], box[2] = column[1], box[3] = row[1];
    return true;
}

static void add_found(td_soil *s, soil_place p)
{
    if (!soil_list_add(&s->found, p)) s->failed = true;
}

void soil_find(td_soil *s, const soil_strip *strip)
{
    const double *a = strip->along, *b = strip->across, area = a[0] * b[1] - a[1] * b[0];
    double low[2], high[2];
    int box[4];
    s->found.count = 0;
    for (int k = 0; k < 2; k++) {
        low[k] = strip->start[k] + fmin(a[k], 0) + fmin(b[k], 0);
        high[k] = strip->start[k] + fmax(a[k], 0) + fmax(b[k], 0);
    }
    if (!(fabs(area) > 1e-12) || !soil_span(box, s, low, high)) return;
    for (int r = box[1]; r <= box[3]; r++)
        for (int c = box[0]; c <= box[2]; c++) {
            const double x = s->map->origin[0] + c * s->map->cell_m - strip->start[0];
            const double y = s->map->origin[1] + r * s->map->cell_m - strip->start[1];
            const double u = (x * b[1] - y * b[0]) / area, v = (a[0] * y - a[1] * x) / area;
            if (fabs(u - 0.5) <= 0.5 + 1e-9 && fabs(v - 0.5) <= 0.5 + 1e-9) add_found(s, (soil_place){c, r});
        }
}

/* The known ones alone; the cell in the middle when there are none at all. */
static void find_known(td_soil *s, const soil_strip *strip)
{
    size_t kept = 0;
    soil_find(s, strip);
    if (s->found.count == 0) {
        const double x = strip->start[0] + (strip->along[0] + strip->across[0]) / 2;
        const double y = strip->start[1] + (strip->along[1] + strip->across[1]) / 2;
        const double u = round((x - s->map->origin[0]) / s->map->cell_m);
        const double v = round((y - s->map->origin[1]) / s->map->cell_m);
        if (u >= 0 && v >= 0 && u < s->map->columns && v < s->map->rows)
            add_found(s, (soil_place){(int)u, (int)v});
    }
    for (size_t k = 0; k < s->found.count; k++) {
        const soil_place p = s->found.place[k];
        if (!isnan(s->map->height[soil_index(s, p.column, p.row)])) s->found.place[kept++] = p;
    }
    s->found.count = kept;
}

bool soil_can_spread(td_soil *s, const soil_strip *strip)
{
    find_known(s, strip);
    return s->found.count > 0;
}

bool soil_spread(td_soil *s, const soil_strip *strip, int64_t mass)
{
    find_known(s, strip);
    const int64_t count = (int64_t)s->found.count;
    if (count == 0) return false;
    for (int64_t k = 0; k < count; k++) {
        const soil_place p = s->found.place[k];
        const int64_t part = mass / count + (k < mass % count);
        if (part == 0) break;
        soil_change(s, p, 0, part);
        soil_wake(s, p);
    }
    return true;
}

td_status td_soil_pour(td_soil *soil, int column, int row, int64_t mass_mg, td_error *error)
{
    if (!soil_inside(soil, column, row))
        return td_fail(error, TD_ERROR_ARGUMENT, "soil: cell (%d, %d) is not on the map of %d x %d", column,
                       row, soil->map->columns, soil->map->rows);
    if (mass_mg < 0 || mass_mg > 1000000000000000 - soil->poured_mg)
        return td_fail(error, TD_ERROR_ARGUMENT, "soil: mass_mg: must be 0 to 1e15 in all, not %lld",
                       (long long)mass_mg);
    const size_t i = soil_index(soil, column, row);
    if (isnan(soil->map->height[i]))
        return td_fail(error, TD_ERROR_DATA,
                       "soil: cell (%d, %d) is unknown ground: soil cannot be put there; take a cell with a "
                       "height",
                       column, row);
    if (mass_mg == 0) return TD_OK;
    soil->poured_mg += mass_mg;
    soil_change(soil, (soil_place){column, row}, 0, mass_mg);
    soil_wake(soil, (soil_place){column, row});
    return TD_OK;
}

/* ---- going on ---- */

static td_status check_pose(const td_soil *s, const td_pose *pose, td_error *error)
{
    double norm = 0, sum = 0;
    for (int k = 0; k < 4; k++) norm += pose->q[k] * pose->q[k];
    for (int k = 0; k < 3; k++) sum += fabs(pose->t[k]);
    if (!s->has_bucket)
        return td_fail(error, TD_ERROR_ARGUMENT, "soil: it has no bucket to place; give one to td_soil_new");
    if (!(fabs(norm - 1) < 1e-6) || !(sum < 1e7))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "soil: site_from_bucket: must be a unit quaternion and a place within 1e7 m");
    return TD_OK;
}

td_status td_soil_place(td_soil *soil, const td_pose *site_from_bucket, td_error *error)
{
    TD_TRY(check_pose(soil, site_from_bucket, error));
    soil->site_from_bucket = *site_from_bucket;
    soil->placed = true;
    return TD_OK;
}

static td_status check_motion(const td_soil *s, const soil_blade *to, const soil_motion *motion,
                              td_error *error)
{
    double at[2];
    const double depth = soil_edge_depth(s, to, at);
    if (motion->length > LEAP_M)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "soil: the bucket's edge leapt by %.3g m in one update; use td_soil_place to put it "
                       "elsewhere",
                       motion->length);
    /* Soil may have flowed over it: it must be able to come out. */
    if (depth > s->bucket.reach_m && (!s->placed || motion->by[2] < 0))
        return td_fail(
            error, TD_ERROR_DATA,
            "soil: the bucket is buried: its edge is %.3g m below the ground at (%.2f, %.2f), and it "
            "is %.3g m tall; raise it",
            depth, at[0], at[1], s->bucket.reach_m);
    return TD_OK;
}

/* dt: since the last update. */
static td_status update(td_soil *s, const td_pose *pose, double dt, td_error *error)
{
    if (pose) {
        const td_pose last = s->placed ? s->site_from_bucket : *pose;
        const soil_blade from = soil_blade_at(s, &last), to = soil_blade_at(s, pose);
        const soil_motion motion = soil_motion_between(&from, &to, dt);
        TD_TRY(check_motion(s, &to, &motion, error));
        soil_feel(s, &to, &motion);
        soil_dig(s, &from, &to, &motion);
        if (!s->state.in_soil) soil_dump(s, &to);
        soil_wrench(s, &to, &motion, pose);
        s->site_from_bucket = *pose;
        s->placed = true;
    }
    soil_fall(s, dt);
    soil_flow(s);
    s->state.updates++;
    if (!s->failed) return TD_OK;
    s->failed = false;
    return td_fail(error, TD_ERROR_MEMORY, "no memory for soil in motion; free some and go on");
}

td_status td_soil_step(td_soil *soil, const td_pose *site_from_bucket, double dt_s, td_error *error)
{
    if (!(dt_s > 0 && dt_s <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "soil: dt_s: must be above 0 and at most 1 s, not %g", dt_s);
    if (site_from_bucket) TD_TRY(check_pose(soil, site_from_bucket, error));
    const double since = soil->since_s + dt_s;
    if (since >= soil->options.period_s * (1 - 1e-6)) {
        const td_pose *pose = site_from_bucket ? site_from_bucket
                              : soil->placed   ? &soil->site_from_bucket
                                               : NULL;
        const td_pose here = pose ? *pose : td_pose_identity();
        TD_TRY(update(soil, pose ? &here : NULL, since, error));
        soil->since_s = 0;
    } else {
        if (site_from_bucket && !soil->placed) TD_TRY(td_soil_place(soil, site_from_bucket, error));
        soil->since_s = since;
    }
    soil->state.time_s += dt_s;
    return TD_OK;
}

td_status td_soil_settle(td_soil *soil, td_error *error)
{
    for (int n = 0; n < MAX_SETTLING; n++) {
        if (soil->parcel_count == 0 && soil_flowing(soil) == 0) return TD_OK;
        TD_TRY(td_soil_step(soil, NULL, soil->options.period_s, error));
    }
    return td_fail(error, TD_ERROR_CONVERGENCE, "soil: %zu cells still flow after %d updates",
                   soil_flowing(soil), MAX_SETTLING);
}

/* ---- looking at it ---- */

void td_soil_get(td_soil_state *state, const td_soil *soil)
{
    *state = soil->state;
    state->bucket_mg = soil->load;
    state->airborne_mg = soil->airborne;
    state->flowing = soil_flowing(soil);
}

td_soil_balance td_soil_balance_of(const td_soil *soil)
{
    td_soil_balance b = {.bucket_mg = soil->load};
    for (size_t i = 0, n = (size_t)soil->map->columns * (size_t)soil->map->rows; i < n; i++) {
        if (isnan(soil->map->height[i])) continue;
        b.terrain_mg += soil->column_mg - soil->cell[i].taken + soil->cell[i].loose;
        b.loose_mg += soil->cell[i].loose;
    }
    for (size_t k = 0; k < soil->parcel_count; k++) b.airborne_mg += soil->parcel[k].mass;
    b.total_mg = b.terrain_mg + b.bucket_mg + b.airborne_mg;
    return b;
}

double td_soil_height(const td_soil *soil, int column, int row)
{
    return soil_inside(soil, column, row) ? soil->surface[soil_index(soil, column, row)] : NAN;
}

double td_soil_loose_height(const td_soil *soil, int column, int row)
{
    if (isnan(td_soil_height(soil, column, row))) return NAN;
    return (double)soil->cell[soil_index(soil, column, row)].loose * soil->loose_m;
}

double td_soil_height_at(const td_soil *soil, double x, double y)
{
    const td_elevation *m = soil->map;
    const double u = (x - m->origin[0]) / m->cell_m, v = (y - m->origin[1]) / m->cell_m;
    if (!(u >= 0 && v >= 0 && u <= m->columns - 1 && v <= m->rows - 1)) return NAN;
    const int c = (int)u, r = (int)v;
    const double a = u - c, b = v - r, *below = soil->surface + soil_index(soil, c, r),
                 *above = below + m->columns;
    if (a > 0 && b > 0)
        return (1 - b) * ((1 - a) * below[0] + a * below[1]) + b * ((1 - a) * above[0] + a * above[1]);
    if (a > 0) return (1 - a) * below[0] + a * below[1]; /* on the border the others lie outside */
    return b > 0 ? (1 - b) * below[0] + b * above[0] : below[0];
}

td_status td_soil_map(td_elevation **map, const td_soil *soil, td_error *error)
{
    const int *d = soil->state.disturbed;
    TD_TRY(td_elevation_copy(map, soil->map, error));
    for (int r = d[1]; r <= d[3]; r++)
        for (int c = d[0]; c <= d[2]; c++) {
            const size_t i = soil_index(soil, c, r);
            if (soil->cell[i].taken == 0 && soil->cell[i].loose == 0) continue;
            (*map)->height[i] = (float)soil->surface[i];
            (*map)->sigma[i] = NAN;
            (*map)->time_s[i] = NAN;
            (*map)->count[i] = 0;
            (*map)->provenance[i] = TD_CELL_SIMULATED;
        }
    return TD_OK;
}

td_status td_soil_hash(char hex[TD_HASH_HEX_SIZE], const td_soil *soil, td_error *error)
{
    td_hash *hash = NULL;
    const td_soil_state *state = &soil->state;
    const int *d = state->disturbed;
    TD_TRY(td_hash_new(&hash, error));
    td_hash_add(hash, d, sizeof state->disturbed);
    td_hash_add(hash, &state->updates, sizeof state->updates);
    td_hash_add(hash, &state->time_s, sizeof state->time_s);
    td_hash_add(hash, state->force, sizeof state->force);
    td_hash_add(hash, state->torque, sizeof state->torque);
    td_hash_add(hash, &soil->load, sizeof soil->load);
    for (size_t k = 0; k < soil->parcel_count; k++) {
        td_hash_add(hash, &soil->parcel[k].mass, sizeof soil->parcel[k].mass);
        td_hash_add(hash, &soil->parcel[k].left_s, sizeof soil->parcel[k].left_s);
        td_hash_add(hash, &soil->parcel[k].strip, sizeof soil->parcel[k].strip);
    }
    for (int r = d[1]; r <= d[3]; r++)
        td_hash_add(hash, soil->cell + soil_index(soil, d[0], r),
                    (size_t)(d[2] - d[0] + 1) * sizeof *soil->cell);
    return td_hash_finish(hex, &hash, error);
}
