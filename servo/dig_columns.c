/* The columns of the map that a trench is counted by: its floor, its lanes, what stands above a plane. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double ON_EDGE = 1e-6; /* of a lane: cells whose centres lie on its rim are in it */
static const double STANDS_M = 0.01;
static const double OFF_GROUND_M = 0.5;

void dig_place(double at[3], const dig_job *job, double a, double t, double g)
{
    const td_dig_floor *f = &job->floor;
    at[0] = f->start[0] + a * job->heading[0] - t * job->heading[1];
    at[1] = f->start[1] + a * job->heading[1] + t * job->heading[0];
    at[2] = f->start[2] + a * f->along + t * f->across + g;
}

double dig_ground(const td_elevation *map, double x, double y)
{
    const double u = round((x - map->origin[0]) / map->cell_m), v = round((y - map->origin[1]) / map->cell_m);
    if (!(u >= 0 && v >= 0 && u < map->columns && v < map->rows)) return NAN;
    return (double)map->height[(size_t)v * (size_t)map->columns + (size_t)u];
}

/* The place of a cell in the trench's axes. */
static dig_cell cell_of(const dig_job *job, int column, int row)
{
    const td_elevation *m = job->map;
    const td_dig_floor *f = &job->floor;
    const double x = m->origin[0] + column * m->cell_m - f->start[0];
    const double y = m->origin[1] + row * m->cell_m - f->start[1];
    dig_cell c = {.index = (size_t)row * (size_t)m->columns + (size_t)column};
    c.a = x * job->heading[0] + y * job->heading[1];
    c.t = y * job->heading[0] - x * job->heading[1];
    c.floor = f->start[2] + c.a * f->along + c.t * f->across;
    c.inside = c.a >= -ON_EDGE && c.a <= f->length_m + ON_EDGE && fabs(c.t) <= f->width_m / 2 + ON_EDGE;
    return c;
}

/* First and last column and row of the cells that may lie in a rectangle of the plan; an empty span where
 * there are none. */
static void span(int box[4], const td_elevation *m, const double low[2], const double high[2])
{
    const int size[2] = {m->columns, m->rows};
    for (int k = 0; k < 2; k++) {
        const double first = ceil((low[k] - m->origin[k]) / m->cell_m - 1e-9);
        const double last = floor((high[k] - m->origin[k]) / m->cell_m + 1e-9);
        box[k] = (int)fmin(fmax(first, 0), size[k]);
        box[k + 2] = (int)fmin(fmax(last, -1), size[k] - 1);
    }
}

static void trench_span(int box[4], const dig_job *job)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, p[3];
    for (int corner = 0; corner < 4; corner++) {
        dig_place(p, job, corner & 1 ? job->floor.length_m : 0,
                  (corner & 2 ? 0.5 : -0.5) * job->floor.width_m, 0);
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], p[k]);
            high[k] = fmax(high[k], p[k]);
        }
    }
    span(box, job->map, low, high);
}

td_status dig_check_trench(const dig_job *job, td_error *error)
{
    const td_elevation *m = job->map;
    int box[4];
    size_t unknown = 0, known = 0;
    double at[2] = {0, 0}, p[3];
    for (int corner = 0; corner < 4; corner++) {
        dig_place(p, job, corner & 1 ? job->floor.length_m : 0,
                  (corner & 2 ? 0.5 : -0.5) * job->floor.width_m, 0);
        for (int k = 0; k < 2; k++)
            if (!(p[k] >= m->origin[k] - m->cell_m / 2 &&
                  p[k] <= m->origin[k] + m->cell_m * ((k ? m->rows : m->columns) - 0.5)))
                return td_fail(
                    error, TD_ERROR_DATA,
                    "dig: the trench's corner at (%.2f, %.2f) m is beside the map; map more ground", p[0],
                    p[1]);
    }
    trench_span(box, job);
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const dig_cell c = cell_of(job, column, row);
            if (!c.inside) continue;
            known++;
            if (!isnan(m->height[c.index])) continue;
            if (unknown++ == 0) {
                at[0] = m->origin[0] + column * m->cell_m;
                at[1] = m->origin[1] + row * m->cell_m;
            }
        }
    if (unknown > 0)
        return td_fail(error, TD_ERROR_DATA,
                       "dig: the ground at (%.2f, %.2f) m is unknown, as are %zu of the trench's %zu cells: "
                       "nobody knows what is there; look at it again, or fill the map",
                       at[0], at[1], unknown, known);
    if (known < 4)
        return td_fail(error, TD_ERROR_DATA,
                       "dig: only %zu of the map's cells of %g m lie in the trench; take a finer map", known,
                       m->cell_m);
    return TD_OK;
}

/* The line along the heading that fits the ground less what it rises across, by least squares. */
static void fit_line(double *at_start, double *along, const dig_job *job)
{
    int box[4];
    double n = 0, sa = 0, sz = 0, saa = 0, saz = 0;
    trench_span(box, job);
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const dig_cell c = cell_of(job, column, row);
            if (!c.inside) continue;
            const double a = c.a - job->floor.length_m / 2;
            const double z = (double)job->map->height[c.index] - c.t * job->floor.across;
            n++, sa += a, sz += z, saa += a * a, saz += a * z;
        }
    const double spread = saa - sa * sa / n;
    *along = spread > 0 ? (saz - sa * sz / n) / spread : 0;
    *at_start = (sz - *along * sa) / n - *along * job->floor.length_m / 2;
}

td_status dig_fit_floor(dig_job *job, double depth_m, td_error *error)
{
    double middle[3], edge[3], start;
    TD_TRY(dig_check_trench(job, error));
    for (int round = 0; round < 3; round++) { /* the edge lies in the floor, whose slope it decides */
        fit_line(&start, &job->floor.along, job);
        job->floor.start[2] = start - depth_m;
        dig_place(middle, job, job->floor.length_m / 2, 0, 0);
        dig_edge(edge, job, middle);
        const double a = edge[0] * job->heading[0] + edge[1] * job->heading[1];
        const double t = edge[1] * job->heading[0] - edge[0] * job->heading[1];
        job->floor.across = (edge[2] - job->floor.along * a) / t;
    }
    fit_line(&start, &job->floor.along, job);
    job->floor.start[2] = start - depth_m;
    const td_task_dig *dig = job->request->dig;
    const double said = job->request->frame == TD_TASK_SITE ? dig->from.at_m[2] : NAN;
    if (fabs(said - start) > OFF_GROUND_M)
        return td_fail(error, TD_ERROR_DATA,
                       "dig: from: z_m %.2f is not on the ground, which the map has at %.2f m there; mend it",
                       said, start);
    return TD_OK;
}

double dig_trench_volume(const dig_job *job, double *depth_m)
{
    int box[4];
    double sum = 0, deepest = 0;
    trench_span(box, job);
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const dig_cell c = cell_of(job, column, row);
            const double above = (double)job->map->height[c.index] - c.floor;
            if (!c.inside || !(above > 0)) continue;
            sum += above;
            deepest = fmax(deepest, above);
        }
    if (depth_m) *depth_m = deepest;
    return sum * job->map->cell_m * job->map->cell_m;
}

/* ---- lanes ---- */

/* Marks cells whose centres are in a triangle of the plan. */
static void mark_triangle(uint8_t *mark, const td_elevation *m, const double a[3], const double b[3],
                          const double c[3])
{
    const double ab[2] = {b[0] - a[0], b[1] - a[1]}, ac[2] = {c[0] - a[0], c[1] - a[1]};
    const double area = ab[0] * ac[1] - ab[1] * ac[0];
    const double low[2] = {fmin(a[0], fmin(b[0], c[0])), fmin(a[1], fmin(b[1], c[1]))};
    const double high[2] = {fmax(a[0], fmax(b[0], c[0])), fmax(a[1], fmax(b[1], c[1]))};
    int box[4];
    if (!(fabs(area) > 1e-12)) return;
    span(box, m, low, high);
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const double x = m->origin[0] + column * m->cell_m - a[0];
            const double y = m->origin[1] + row * m->cell_m - a[1];
            const double u = (x * ac[1] - y * ac[0]) / area, v = (ab[0] * y - ab[1] * x) / area;
            if (u >= -1e-9 && v >= -1e-9 && u + v <= 1 + 1e-9)
                mark[(size_t)row * (size_t)m->columns + (size_t)column] = 1;
        }
}

static void edge_ends(double end[2][3], const dig_job *job, const dig_lane *lane, double a)
{
    double at[3], edge[3];
    dig_place(at, job, a, lane->t, 0);
    dig_edge(edge, job, at);
    for (int e = 0; e < 2; e++)
        for (int k = 0; k < 3; k++) end[e][k] = at[k] + (e - 0.5) * job->request->bucket->width_m * edge[k];
}

/* The edge is askew to the lane, the more so the further the lane is from pointing at the machine. */
static double met_at(const dig_job *job, const dig_lane *lane, const dig_cell *c)
{
    double at[3], edge[3], met = c->a;
    for (int round = 0; round < 3; round++) {
        dig_place(at, job, met, lane->t, 0);
        dig_edge(edge, job, at);
        const double a = edge[0] * job->heading[0] + edge[1] * job->heading[1];
        const double t = edge[1] * job->heading[0] - edge[0] * job->heading[1];
        met = c->a - (c->t - lane->t) * a / t;
    }
    return met;
}

td_status dig_sweep_lane(dig_lane *lane, const dig_job *job, td_error *error)
{
    enum { STRETCHES = 64 };
    const td_elevation *m = job->map;
    const size_t n = (size_t)m->columns * (size_t)m->rows;
    uint8_t *mark = calloc(n, 1);
    double end[2][3], next[2][3];
    if (!mark) return td_fail(error, TD_ERROR_MEMORY, "no memory for a lane of the trench");
    edge_ends(end, job, lane, lane->first);
    for (int i = 1; i <= STRETCHES; i++) {
        edge_ends(next, job, lane, lane->first + (lane->last - lane->first) * i / STRETCHES);
        mark_triangle(mark, m, end[0], end[1], next[1]);
        mark_triangle(mark, m, end[0], next[1], next[0]);
        memcpy(end, next, sizeof end);
    }
    lane->count = 0;
    for (size_t i = 0; i < n; i++) lane->count += mark[i] && !isnan(m->height[i]);
    lane->cell = malloc((lane->count + 1) * sizeof *lane->cell);
    if (lane->cell) {
        size_t k = 0;
        for (size_t i = 0; i < n; i++) {
            if (!mark[i] || isnan(m->height[i])) continue;
            dig_cell *c = lane->cell + k++;
            *c = cell_of(job, (int)(i % (size_t)m->columns), (int)(i / (size_t)m->columns));
            c->met = met_at(job, lane, c);
        }
    }
    free(mark);
    return lane->cell ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a lane of the trench");
}

/* How far a cell stands above the plane; at most 0: not, or beyond what is reached. */
static double stands(const dig_job *job, const dig_lane *lane, const dig_cell *c, double g)
{
    if (c->met < lane->from - ON_EDGE || c->met > lane->to + ON_EDGE) return 0;
    return (double)job->map->height[c->index] - c->floor - g;
}

double dig_above(const dig_job *job, const dig_lane *lane, double g)
{
    double sum = 0;
    for (size_t i = 0; i < lane->count; i++) sum += fmax(0, stands(job, lane, lane->cell + i, g));
    return sum * job->map->cell_m * job->map->cell_m;
}

bool dig_extent(double *from, double *to, const dig_job *job, const dig_lane *lane, double g)
{
    const double half = job->map->cell_m / 2;
    *from = INFINITY, *to = -INFINITY;
    for (size_t i = 0; i < lane->count; i++) {
        if (!(stands(job, lane, lane->cell + i, g) > STANDS_M)) continue;
        *from = fmin(*from, lane->cell[i].met - half);
        *to = fmax(*to, lane->cell[i].met + half);
    }
    const bool any = *to > *from;
    *from = fmax(*from, lane->from), *to = fmin(*to, lane->to);
    return any;
}

double dig_plane_of(const dig_job *job, const dig_lane *lane, double volume)
{
    double low = lane->g, high = low;
    for (size_t i = 0; i < lane->count; i++)
        high = fmax(high, (double)job->map->height[lane->cell[i].index] - lane->cell[i].floor);
    for (int i = 0; i < 50; i++) {
        const double g = (low + high) / 2;
        if (dig_above(job, lane, g) > volume)
            low = g;
        else
            high = g;
    }
    return high;
}

double dig_cut(dig_job *job, const dig_lane *lane, double from, double to, double g, double *depth_m)
{
    double sum = 0;
    *depth_m = 0;
    for (size_t i = 0; i < lane->count; i++) {
        const dig_cell *c = lane->cell + i;
        const double above = (double)job->map->height[c->index] - c->floor - g;
        if (!(above > 0) || c->met < from - ON_EDGE || c->met > to + ON_EDGE) continue;
        sum += above;
        *depth_m = fmax(*depth_m, above);
        job->map->height[c->index] = (float)(c->floor + g);
        job->map->sigma[c->index] = NAN;
        job->map->count[c->index] = 0;
        job->map->provenance[c->index] = TD_CELL_SIMULATED;
        job->map->time_s[c->index] = NAN;
    }
    return sum * job->map->cell_m * job->map->cell_m;
}

/* ---- what a bucket passes over ---- */

/* The heap as a cone at its angle of repose. */
static double heap_at(const dig_job *job, const double at[2])
{
    const double slope = tan(job->o.repose_rad), pi = 3.14159265358979323846;
    const double tall = cbrt(3 * job->dumped_m3 * slope * slope / pi);
    return job->dump_ground + tall - slope * hypot(at[0] - job->dump[0], at[1] - job->dump[1]);
}

double dig_highest(const dig_job *job, const double at[2], double radius)
{
    const td_elevation *m = job->map;
    const double low[2] = {at[0] - radius, at[1] - radius}, high[2] = {at[0] + radius, at[1] + radius};
    double highest = -INFINITY;
    int box[4];
    span(box, m, low, high);
    for (int row = box[1]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[2]; column++) {
            const double z = (double)m->height[(size_t)row * (size_t)m->columns + (size_t)column];
            if (z > highest) highest = z;
        }
    if (job->dumped_m3 > 0) {
        const double away = hypot(at[0] - job->dump[0], at[1] - job->dump[1]);
        const double part = away > radius ? 1 - radius / away : 0;
        const double nearest[2] = {job->dump[0] + part * (at[0] - job->dump[0]),
                                   job->dump[1] + part * (at[1] - job->dump[1])};
        highest = fmax(highest, heap_at(job, nearest));
    }
    return highest;
}

double dig_below(const dig_job *job, const double at[2])
{
    return dig_highest(job, at, (job->request->bucket->width_m + job->heel_m) / 2);
}
