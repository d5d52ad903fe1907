/* What the bucket does to the soil: cutting, filling, spilling, pressing, dumping. */
#include "sim/soil_internal.h"

#include <stdlib.h>

static const double PI = 3.14159265358979323846, DEGREE = 0.017453292519943295;
static const double STRIP_M = 0.2; /* thickness of what falls or is pushed on, or two cells */
enum { SAMPLES = 7 };

td_soil_bucket td_soil_bucket_zx200(void)
{
    return (td_soil_bucket){.edge = {1.562, 0, 0},
                            .heel = {1.05, 0, 0.06},
                            .opening = {0, 0, -1},
                            .centre = {0.75, 0, 0.25},
                            .width_m = 1.1,
                            .edge_m = 0.03,
                            .struck_m3 = 0.58,
                            .heaped_m3 = 0.8,
                            .reach_m = 1.562};
}

/* ---- geometry ---- */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void scale(double v[3], double by)
{
    for (int k = 0; k < 3; k++) v[k] *= by;
}

static void cross(double c[3], const double a[3], const double b[3])
{
    for (int k = 0; k < 3; k++) c[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

td_status soil_bucket_check(const td_soil_bucket *b, td_error *error)
{
    const struct {
        const char *name;
        double value;
    } size[] = {{"width_m", b->width_m},
                {"edge_m", b->edge_m},
                {"struck_m3", b->struck_m3},
                {"heaped_m3", b->heaped_m3},
                {"reach_m", b->reach_m}};
    double floor[3], out[3], sum = 0;
    for (size_t i = 0; i < sizeof size / sizeof *size; i++)
        if (!(size[i].value > 0 && size[i].value <= 100))
            return td_fail(error, TD_ERROR_ARGUMENT, "bucket: %s: must be above 0 and at most 100, not %g",
                           size[i].name, size[i].value);
    if (b->heaped_m3 < b->struck_m3)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "bucket: heaped_m3: %g is less than struck_m3, %g; swap or mend them", b->heaped_m3,
                       b->struck_m3);
    for (int k = 0; k < 3; k++) {
        floor[k] = b->heel[k] - b->edge[k];
        sum += fabs(b->edge[k]) + fabs(b->heel[k]) + fabs(b->opening[k]) + fabs(b->centre[k]);
    }
    cross(out, b->opening, floor);
    if (!(sum < 1000) || !(dot(out, out) > 1e-4 * dot(floor, floor) * dot(b->opening, b->opening)))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "bucket: heel, opening: the floor, from edge to heel, and the opening's direction must "
            "have a length and differ");
    return TD_OK;
}

soil_blade soil_blade_at(const td_soil *s, const td_pose *pose)
{
    const td_soil_bucket *b = &s->bucket;
    soil_blade blade;
    double side[3];
    td_pose_transform(blade.edge, pose, b->edge);
    td_pose_transform(blade.heel, pose, b->heel);
    td_pose_rotate(blade.opening, pose, b->opening);
    scale(blade.opening, 1 / sqrt(dot(blade.opening, blade.opening)));
    for (int k = 0; k < 3; k++) blade.point[k] = blade.edge[k] - blade.heel[k];
    scale(blade.point, 1 / sqrt(dot(blade.point, blade.point)));
    const double along = dot(blade.opening, blade.point);
    for (int k = 0; k < 3; k++) blade.face[k] = blade.opening[k] - along * blade.point[k];
    scale(blade.face, 1 / sqrt(dot(blade.face, blade.face)));
    cross(side, blade.face, blade.point);
    for (int k = 0; k < 3; k++) {
        blade.end[0][k] = blade.edge[k] - side[k] * b->width_m / 2;
        blade.end[1][k] = blade.edge[k] + side[k] * b->width_m / 2;
    }
    return blade;
}

soil_motion soil_motion_between(const soil_blade *from, const soil_blade *to, double dt_s)
{
    soil_motion m = {.cuts = false};
    for (int k = 0; k < 3; k++) m.by[k] = to->edge[k] - from->edge[k];
    m.length = sqrt(dot(m.by, m.by));
    m.speed = m.length / dt_s;
    if (m.length < 1e-9) return m;
    m.rake = atan2(dot(m.by, to->face), dot(m.by, to->point));
    m.cuts = m.rake >= -5 * DEGREE && m.rake <= 175 * DEGREE;
    return m;
}

double soil_edge_depth(const td_soil *s, const soil_blade *blade, double at[2])
{
    double deepest = -INFINITY;
    at[0] = at[1] = NAN;
    for (int n = 0; n < SAMPLES; n++) {
        double p[3];
        for (int k = 0; k < 3; k++)
            p[k] = blade->end[0][k] + (blade->end[1][k] - blade->end[0][k]) * n / (SAMPLES - 1);
        const double depth = soil_ground(s, p[0], p[1]) - p[2];
        if (depth > deepest) {
            deepest = depth;
            at[0] = p[0];
            at[1] = p[1];
        }
    }
    return deepest;
}

/* ---- cells under a surface ---- */

typedef void (*cell_action)(td_soil *s, soil_place p, double z, int64_t *sum);

/* Soil above z is taken off, loose first; the bank down to the floor. */
static void cut_cell(td_soil *s, soil_place p, double z, int64_t *sum)
{
    const size_t i = soil_index(s, p.column, p.row);
    const soil_cell *cell = s->cell + i;
    const double above = s->surface[i] - z, bank_above = soil_bank(s, i) - z;
    if (!(above > 0)) return;
    int64_t loose = bank_above > 0 ? cell->loose : llround(above / s->loose_m);
    int64_t bank = bank_above > 0 ? llround(bank_above / s->bank_m) : 0;
    if (loose > cell->loose) loose = cell->loose;
    if (bank > s->column_mg - cell->taken) {
        bank = s->column_mg - cell->taken;
        if (!s->told_floor)
            td_log_write(
                &s->options.log, TD_LOG_WARNING, "soil",
                "at cell (%d, %d) the bucket is %g m below the map's surface, deeper than floor_m; it "
                "cuts nothing there",
                p.column, p.row, s->options.floor_m);
        s->told_floor = true;
    }
    if (loose == 0 && bank == 0) return;
    soil_change(s, p, bank, -loose);
    *sum += loose + bank;
    soil_wake(s, p);
}

/* Loose soil that reaches above z is pressed to the bank's density until it does not, or all of it is. */
static void press_cell(td_soil *s, soil_place p, double z, int64_t *sum)
{
    const size_t i = soil_index(s, p.column, p.row);
    const soil_cell *cell = s->cell + i;
    const double above = s->surface[i] - z, gain = s->loose_m - s->bank_m;
    if (!(above > 0) || !(gain > 0) || cell->loose == 0) return;
    const double wanted = ceil(above / gain);
    const int64_t mass = wanted < (double)cell->loose ? (int64_t)wanted : cell->loose;
    soil_change(s, p, -mass, -mass);
    *sum += mass;
    soil_wake(s, p);
}

static void meet_unknown(td_soil *s, soil_place p, double z)
{
    if (!(z < s->last_ground)) return;
    s->state.unknown_cells++;
    if (!s->told_unknown)
        td_log_write(&s->options.log, TD_LOG_WARNING, "soil",
                     "the bucket digs at cell (%d, %d), which has no height: unknown ground stays as it is",
                     p.column, p.row);
    s->told_unknown = true;
}

/* The action on each cell whose centre is in the triangle (in plan), with the triangle's height there. */
static void over_triangle(td_soil *s, const double a[3], const double b[3], const double c[3],
                          cell_action action, int64_t *sum)
{
    const double ab[2] = {b[0] - a[0], b[1] - a[1]}, ac[2] = {c[0] - a[0], c[1] - a[1]};
    const double area = ab[0] * ac[1] - ab[1] * ac[0];
    const double low[2] = {fmin(a[0], fmin(b[0], c[0])), fmin(a[1], fmin(b[1], c[1]))};
    const double high[2] = {fmax(a[0], fmax(b[0], c[0])), fmax(a[1], fmax(b[1], c[1]))};
    int box[4];
    if (!(fabs(area) > 1e-12) || !soil_span(box, s, low, high)) return;
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const double x = s->map->origin[0] + column * s->map->cell_m - a[0];
            const double y = s->map->origin[1] + row * s->map->cell_m - a[1];
            const double u = (x * ac[1] - y * ac[0]) / area, v = (ab[0] * y - ab[1] * x) / area;
            if (u < -1e-9 || v < -1e-9 || u + v > 1 + 1e-9) continue;
            const double z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]);
            const soil_place p = {column, row};
            if (isnan(s->map->height[soil_index(s, column, row)]))
                meet_unknown(s, p, z);
            else
                action(s, p, z, sum);
        }
}

/* ---- cutting and pressing ---- */

static double strip_width(const td_soil *s)
{
    return fmax(STRIP_M, 2 * s->map->cell_m);
}

/* What the bucket cannot hold goes ahead of the edge; where no ground is known there it heaps on. */
static void push_on(td_soil *s, const soil_blade *to, const soil_motion *motion, int64_t mass)
{
    const double *way = hypot(motion->by[0], motion->by[1]) > 1e-9 ? motion->by : to->face;
    const double length = hypot(way[0], way[1]), cell = s->map->cell_m;
    soil_strip strip = {.across = {0, 0}};
    for (int k = 0; k < 2; k++) {
        const double ahead = length > 0 ? way[k] / length : 0;
        strip.start[k] = to->end[0][k] + ahead * cell / 2;
        strip.along[k] = to->end[1][k] - to->end[0][k];
        strip.across[k] = ahead * strip_width(s);
    }
    if (!soil_spread(s, &strip, mass)) s->load += mass;
}

static void press_floor(td_soil *s, const soil_blade *to)
{
    double rear[2][3];
    int64_t pressed = 0;
    for (int e = 0; e < 2; e++)
        for (int k = 0; k < 3; k++) rear[e][k] = to->end[e][k] + to->heel[k] - to->edge[k];
    over_triangle(s, to->end[0], to->end[1], rear[1], press_cell, &pressed);
    over_triangle(s, to->end[0], rear[1], rear[0], press_cell, &pressed);
}

void soil_dig(td_soil *s, const soil_blade *from, const soil_blade *to, const soil_motion *motion)
{
    int64_t cut = 0;
    if (!(motion->length > 0)) return;
    if (!motion->cuts) {
        press_floor(s, to);
        return;
    }
    over_triangle(s, from->end[0], from->end[1], to->end[1], cut_cell, &cut);
    over_triangle(s, from->end[0], to->end[1], to->end[0], cut_cell, &cut);
    const int64_t heaped = (int64_t)(s->bucket.heaped_m3 / s->loose_m3);
    const int64_t room = heaped > s->load ? heaped - s->load : 0;
    s->load += cut < room ? cut : room;
    if (cut > room) push_on(s, to, motion, cut - room);
}

/* ---- dumping ---- */

/* What the bucket holds at a tilt (soil.h). */
static int64_t held_at(const td_soil *s, const soil_blade *blade)
{
    const double tilt = acos(fmin(fmax(blade->opening[2], -1), 1)), repose = s->preset.repose_rad;
    const td_soil_bucket *b = &s->bucket;
    double volume;
    if (tilt < repose)
        volume = b->struck_m3 + (b->heaped_m3 - b->struck_m3) * (1 - tilt / repose);
    else
        volume = b->struck_m3 * fmax(0, fmin(1, (repose + PI / 2 - tilt) / (PI / 2)));
    return (int64_t)(volume / s->loose_m3);
}

static bool add_parcel(td_soil *s, const soil_parcel *parcel)
{
    if (s->parcel_count == s->parcel_capacity) {
        const size_t capacity = s->parcel_capacity ? 2 * s->parcel_capacity : 64;
        soil_parcel *grown = realloc(s->parcel, capacity * sizeof *grown);
        if (!grown) return false;
        s->parcel = grown;
        s->parcel_capacity = capacity;
    }
    s->parcel[s->parcel_count++] = *parcel;
    return true;
}

void soil_dump(td_soil *s, const soil_blade *blade)
{
    const int64_t held = held_at(s, blade);
    if (s->load <= held) return;
    soil_parcel parcel = {.mass = s->load - held};
    const double along[2] = {blade->end[1][0] - blade->end[0][0], blade->end[1][1] - blade->end[0][1]};
    const double length = hypot(along[0], along[1]), thick = strip_width(s);
    for (int k = 0; k < 2; k++) {
        const double side = length > 1e-9 ? (k == 0 ? -along[1] : along[0]) / length : 0;
        parcel.strip.along[k] = along[k];
        parcel.strip.across[k] = side * thick;
        parcel.strip.start[k] = blade->end[0][k] - side * thick / 2;
    }
    if (!soil_can_spread(s, &parcel.strip)) return;
    const double drop = blade->edge[2] - soil_ground(s, blade->edge[0], blade->edge[1]);
    parcel.left_s = drop > 0 ? sqrt(2 * drop / s->options.gravity) : 0;
    if (!add_parcel(s, &parcel)) {
        s->failed = true;
        return;
    }
    s->load -= parcel.mass;
    s->airborne += parcel.mass;
}

void soil_fall(td_soil *s, double dt_s)
{
    size_t kept = 0;
    for (size_t n = 0; n < s->parcel_count; n++) {
        soil_parcel parcel = s->parcel[n];
        parcel.left_s -= dt_s;
        if (parcel.left_s <= 0 && soil_spread(s, &parcel.strip, parcel.mass))
            s->airborne -= parcel.mass;
        else
            s->parcel[kept++] = parcel;
    }
    s->parcel_count = kept;
}
