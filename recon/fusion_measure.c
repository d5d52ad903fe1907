/* What a frame's points in a cell say of the height at its centre, and how sure that is.
 *
 * Height: the weighted mean of the points, carried to the centre along the slope g, which is a plane's
 * through the means of the 3 x 3 cells around. With v = (-g, 1) an error e of a point (3) moves the height by
 * v . e:
 *
 * - matching: v . r dz for a ray r = X / z: variance (v . r)^2 var(z), averaged over the points as far as
 * their errors differ (td_mean_variance);
 * - pose: v^T [-[X]x, I] S [-[X]x, I]^T v;
 * - calibration: v^T C v, C the point's covariance by the rig;
 * - scatter: where the points lie off the plane by far more than matching explains, the cell holds an edge or
 * a stone, of which another view may see another part: the rest of their variance counts whole;
 * - relief: where the means around lie off their plane by more than matching explains, the ground is no plane
 * there: the slope is known as badly, and what the points do not show of the cell counts. (Points that show
 * all but a strip h of the cell have their mean h / 2 of the cell away from its centre; the strip's part in
 * the mean is h, and it lies the farther off the wider it is: h^2 relief^0.5 together. Points in rows, n of
 * them, miss relief^0.5 / n.) Without it, cells at the upper edge of a stone would take a slope along the
 * ray, and a sigma of nothing;
 * - edges: the variance that fusion_edge.c gives the points besides. They are wrong together in patches of
 * half a window's side, and most are not wrong at all: of n points one patch is taken to be, which moves the
 * mean by its share, EDGE_PATCH / n. So a cell of a few pixels has all of it, where one that holds hundreds
 * keeps the sigma that its other points give it;
 * They move along their rays: behind a stone's edge the slope is what the wrong points make of it, and the
 * height is at least as unsure as on level ground;
 * - smear: what the camera sees is turned towards it. Where the plane around is turned less than LEAST_FACING
 * of what level ground is, or away, the points hang in the air between an edge and what lies behind it: a
 * slope along the ray once more. The variance of the heights around counts whole, and where it is clearly
 * more than noise the slope is taken as not known. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "recon/fusion_internal.h"

static const double STEEPEST = 4;           /* slopes beyond are steps, and their sigma is their scatter's */
static const double UNKNOWN_SLOPE = 0.5;    /* standard deviation of a slope that is not known */
static const double EXPECTED_SCATTER = 4;   /* times its variance: chance, and matching's tails */
static const double LEAST_FACING = 0.6;     /* of the sine at which level ground is seen */
static const double LEAST_VARIANCE = 1e-10; /* m^2: (10 um)^2 */
static const double LEAST_SEEN = 0.4;       /* of the points that a neighbour has, */
static const double WHOLLY_SEEN = 0.8;      /* or of those that level ground has there */
static const double EDGE_PATCH = 12;        /* px: under half of a window's 9, squared */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- sums of each tile ---- */

typedef struct job {
    td_frame_cells *cells;
    bool *failed; /* (tiles) */
} job;

static td_frame_cell *cell_for(td_frame_tile *tile, uint32_t at)
{
    if (!tile->slot[at]) {
        tile->cell[tile->cells] = (td_frame_cell){.cell = (uint16_t)at};
        tile->slot[at] = (uint16_t)++tile->cells;
    }
    return &tile->cell[tile->slot[at] - 1];
}

static void sum_tile(size_t index, void *user)
{
    const job *j = user;
    td_frame_tile *tile = &j->cells->tile[index];
    const size_t most = tile->points < TD_TILE_CELLS ? tile->points : TD_TILE_CELLS;
    tile->slot = calloc(TD_TILE_CELLS, sizeof *tile->slot);
    tile->cell = malloc(most * sizeof *tile->cell);
    tile->measure = malloc(most * sizeof *tile->measure);
    j->failed[index] = !tile->slot || !tile->cell || !tile->measure;
    if (j->failed[index]) return;
    for (const td_frame_run *run = tile->run; run < tile->run + tile->runs; run++)
        for (const td_frame_point *p = run->point; p < run->point + run->count; p++) {
            td_frame_cell *c = cell_for(tile, p->cell);
            const double w = (double)p->weight;
            c->weight += w;
            c->weight2 += w * w;
            c->x += w * (double)p->x;
            c->y += w * (double)p->y;
            c->z += w * (double)p->z;
            c->edge += w * (double)p->edge;
            c->count++;
        }
    for (size_t i = 0; i < tile->cells; i++) {
        td_frame_cell *c = &tile->cell[i];
        c->x /= c->weight;
        c->y /= c->weight;
        c->z /= c->weight;
        c->edge /= c->weight;
    }
}

/* ---- slopes ---- */

/* The cell (column, row) from the tile's first, which may lie in a neighbour; NULL: not measured. */
static const td_frame_cell *neighbour(const td_frame_cells *c, const td_frame_tile *tile, int column, int row)
{
    const int dx = column < 0 ? -1 : column >= TD_TILE_SIDE, dy = row < 0 ? -1 : row >= TD_TILE_SIDE;
    if (dx || dy) {
        const int32_t x = tile->x + dx, y = tile->y + dy;
        if (x < c->box[0] || x > c->box[1] || y < c->box[2] || y > c->box[3]) return NULL;
        const size_t columns = (size_t)(c->box[1] - c->box[0] + 1);
        const int32_t at = c->at[(size_t)(y - c->box[2]) * columns + (size_t)(x - c->box[0])];
        if (at < 0) return NULL;
        tile = &c->tile[at];
    }
    const int slot = tile->slot[(row - dy * TD_TILE_SIDE) * TD_TILE_SIDE + column - dx * TD_TILE_SIDE];
    return slot ? &tile->cell[slot - 1] : NULL;
}

/* From the camera (site's axes, m) to the cell's mean, and the same as the camera sees it. */
static void way_to(double way[3], double seen[3], const td_frame_cell *cell, const td_frame_cells *c,
                   const td_frame_tile *tile)
{
    const double side = c->fusion->options.cell_m, *from = c->site_from_camera.t;
    way[0] = (tile->x * TD_TILE_SIDE + cell->cell % TD_TILE_SIDE) * side + cell->x - from[0];
    way[1] = (tile->y * TD_TILE_SIDE + cell->cell / TD_TILE_SIDE) * side + cell->y - from[1];
    way[2] = cell->z;
    for (int i = 0; i < 3; i++)
        seen[i] = c->to_site[i] * way[0] + c->to_site[3 + i] * way[1] + c->to_site[6 + i] * way[2];
}

/* Share of a point's variance that its cell's mean has. */
static double averaged(const td_frame_cell *cell, const td_frame_cells *c)
{
    return td_mean_variance(cell->weight * cell->weight / cell->weight2, c->fusion->options.correlation_px);
}

/* Variance of the means' heights, on level ground, against one another: cells nearer in the image than the
 * errors' correlation share the more of them the nearer they are. */
static double mean_variance(const td_frame_cell *cell, const td_frame_cells *c, const td_frame_tile *tile)
{
    double way[3], seen[3];
    way_to(way, seen, cell, c, tile);
    const double along = way[2] / seen[2], apart = sqrt(cell->count) / c->fusion->options.correlation_px;
    return along * along * cell->count / cell->weight * averaged(cell, c) * fmin(1, apart);
}

/* The plane of slope g is seen at less than LEAST_FACING of the sine at which level ground is, or from
 * behind. */
static bool faces_away(const double g[2], const td_frame_cell *cell, const td_frame_cells *c,
                       const td_frame_tile *tile)
{
    double way[3], seen[3];
    way_to(way, seen, cell, c, tile);
    return way[0] * g[0] + way[1] * g[1] - way[2] <
           -LEAST_FACING * way[2] * sqrt(1 + g[0] * g[0] + g[1] * g[1]);
}

/* Of the map. One cell more is summed to each side, for how much of the map's own is seen; the rest is worked
 * out from what lies in the map alone. */
static bool outside(const td_frame_cells *c, const td_frame_tile *tile, int column, int row)
{
    const int32_t x = tile->x * TD_TILE_SIDE + column, y = tile->y * TD_TILE_SIDE + row;
    const int32_t *b = c->fusion->bounds;
    return x < b[0] || x > b[1] || y < b[2] || y > b[3];
}

static void find_slope(td_frame_cell *cell, const td_frame_cells *c, const td_frame_tile *tile)
{
    const int column = cell->cell % TD_TILE_SIDE, row = cell->cell / TD_TILE_SIDE;
    const double side = c->fusion->options.cell_m;
    double n = 0, x = 0, y = 0, z = 0, xx = 0, xy = 0, yy = 0, xz = 0, yz = 0, zz = 0;
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            const td_frame_cell *other = neighbour(c, tile, column + dx, row + dy);
            if (!other || outside(c, tile, column + dx, row + dy)) continue;
            const double u = dx * side + other->x, v = dy * side + other->y, h = other->z - cell->z;
            n++;
            x += u, y += v, z += h;
            xx += u * u, xy += u * v, yy += v * v;
            xz += u * h, yz += v * h, zz += h * h;
        }
    xx -= x * x / n, xy -= x * y / n, yy -= y * y / n;
    xz -= x * z / n, yz -= y * z / n, zz -= z * z / n;
    const double det = xx * yy - xy * xy;
    const double ground = UNKNOWN_SLOPE * UNKNOWN_SLOPE;
    double g[2] = {0, 0}, noise = INFINITY;
    cell->relief = cell->smear = 0;
    if (n >= 5 && det > 0.05 * side * side * side * side) {
        const double matching = mean_variance(cell, c, tile);
        g[0] = (yy * xz - xy * yz) / det;
        g[1] = (xx * yz - xy * xz) / det;
        cell->relief = fmax(0, (zz - g[0] * xz - g[1] * yz) / fmax(n - 3, 1) - matching);
        noise = (matching + cell->relief) * fmax(xx, yy) / det;
        const double sure = ground / (ground + noise), held[2] = {sure * g[0], sure * g[1]};
        if (faces_away(held, cell, c, tile)) {
            cell->smear = fmax(0, zz / n - matching);
            if (cell->smear > EXPECTED_SCATTER * matching) noise = INFINITY;
        }
    }
    const double trust = ground / (ground + noise), length = trust * hypot(g[0], g[1]);
    const double held = trust * (length > STEEPEST ? STEEPEST / length : 1);
    for (int i = 0; i < 2; i++) cell->slope[i] = held * g[i];
    cell->slope_variance = ground * (1 - trust);
}

/* ---- measurements ---- */

double td_frame_pose_variance(const td_frame_cells *c, const double p[3], const double up[3])
{
    const double *s = c->frame->pose_covariance;
    if (!s) return 0;
    /* v . (omega x p + tau) = omega . (p x v) + v . tau */
    const double j[6] = {p[1] * up[2] - p[2] * up[1],
                         p[2] * up[0] - p[0] * up[2],
                         p[0] * up[1] - p[1] * up[0],
                         up[0],
                         up[1],
                         up[2]};
    double variance = 0;
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 6; b++) variance += j[a] * s[6 * a + b] * j[b];
    return fmax(variance, 0);
}

static double form(const double s[6], const double v[3])
{
    return v[0] * v[0] * s[0] + v[1] * v[1] * s[3] + v[2] * v[2] * s[5] +
           2 * (v[0] * v[1] * s[1] + v[0] * v[2] * s[2] + v[1] * v[2] * s[4]);
}

/* Standard deviation of the height by the calibration, what is not known of the slope included; 0 where the
 * rig has no covariance. */
static double calibration(const td_frame_cells *c, const double seen[3], const double up[3],
                          double slope_variance)
{
    const td_depth_camera *camera = c->frame->camera;
    double s[6], v[3], vertical[3];
    td_depth_error_at(s, camera, camera->cx + camera->f * seen[0] / seen[2],
                      camera->cy + camera->f * seen[1] / seen[2], seen[2]);
    if (isnan(s[0])) return 0;
    for (int i = 0; i < 3; i++) {
        v[i] = dot(c->rig_from_site + 3 * i, up);
        vertical[i] = c->rig_from_site[3 * i + 2];
    }
    const double level = s[0] + s[3] + s[5] - form(s, vertical); /* variances along x and y of the site */
    return sqrt(fmax(form(s, v) + slope_variance * level, 0));
}

static td_measure measure(const td_frame_cells *c, const td_frame_tile *tile, const td_frame_cell *cell)
{
    const double *from = c->site_from_camera.t, up[3] = {-cell->slope[0], -cell->slope[1], 1};
    double way[3], seen[3];
    way_to(way, seen, cell, c, tile);
    const double p[3] = {from[0] + way[0], from[1] + way[1], from[2] + way[2]};
    const double along = dot(up, way) / seen[2], depth = cell->count / cell->weight;
    const double sideways = cell->slope_variance * (way[0] * way[0] + way[1] * way[1]) / (seen[2] * seen[2]);
    const double one = (along * along + sideways) * depth; /* variance of one point's height */
    const double matching = one * averaged(cell, c) + LEAST_VARIANCE;
    const double patch = fmin(1, EDGE_PATCH / cell->count);
    const double level = way[2] / seen[2];
    const double edges =
        (fmax(along * along, level * level) + sideways) * cell->edge * patch * patch + cell->smear;
    const double scatter = fmax(0, cell->residual / cell->weight - EXPECTED_SCATTER * one);
    const double away = hypot(cell->x, cell->y);
    const double hidden = fmin(1, 2 * away / c->fusion->options.cell_m);
    const double off =
        cell->slope_variance * away * away + (pow(hidden, 4) + pow(cell->count, -2)) * cell->relief;
    const double pose = td_frame_pose_variance(c, p, up);
    return (td_measure){.height = from[2] + cell->z - cell->slope[0] * cell->x - cell->slope[1] * cell->y,
                        .noise = matching + scatter + off + pose + edges,
                        .repeated = c->fusion->options.repeat_share * matching + scatter + off + pose + edges,
                        .anywhere = c->fusion->options.elsewhere_share * matching + edges,
                        .common = calibration(c, seen, up, cell->slope_variance),
                        .place = c->place,
                        .count = cell->count,
                        .time_s = c->frame->time_s};
}

/* Pixels of a cell of level ground there: f^2 h / depth^3 of its area, seen from a height h (the determinant
 * of d(u,v)/d(x,y)). */
static double level_count(const td_frame_cells *c, const td_frame_tile *tile, const td_frame_cell *cell)
{
    const double px = c->fusion->options.cell_m * c->frame->camera->f;
    double way[3], seen[3];
    way_to(way, seen, cell, c, tile);
    return px * px * fmax(0, -way[2]) / (seen[2] * seen[2] * seen[2]);
}

/* A neighbour is not measured, and the cell has far fewer points than another has: most of it is hidden, and
 * what is hidden may lie anywhere below. It is left for a look from elsewhere. Beside a wall, whose cells
 * hold many points each, level ground has far fewer too, and is seen nevertheless. */
static bool seen_in_part(const td_frame_cells *c, const td_frame_tile *tile, const td_frame_cell *cell)
{
    const int column = cell->cell % TD_TILE_SIDE, row = cell->cell / TD_TILE_SIDE;
    uint32_t most = 0;
    bool rim = false;
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            const td_frame_cell *other = neighbour(c, tile, column + dx, row + dy);
            rim |= !other;
            if (other && other->count > most) most = other->count;
        }
    return rim && cell->count < LEAST_SEEN * most && cell->count < WHOLLY_SEEN * level_count(c, tile, cell);
}

static void measure_tile(size_t index, void *user)
{
    const job *j = user;
    const td_frame_cells *c = j->cells;
    td_frame_tile *tile = &c->tile[index];
    for (size_t i = 0; i < tile->cells; i++) find_slope(&tile->cell[i], c, tile);
    for (const td_frame_run *run = tile->run; run < tile->run + tile->runs; run++)
        for (const td_frame_point *p = run->point; p < run->point + run->count; p++) {
            td_frame_cell *cell = &tile->cell[tile->slot[p->cell] - 1];
            const double off = (double)p->z - cell->z - cell->slope[0] * ((double)p->x - cell->x) -
                               cell->slope[1] * ((double)p->y - cell->y);
            cell->residual += (double)p->weight * off * off;
        }
    for (size_t i = 0; i < tile->cells; i++) {
        tile->measure[i] = measure(c, tile, &tile->cell[i]);
        tile->measure[i].in_part = seen_in_part(c, tile, &tile->cell[i]);
        const int at = tile->cell[i].cell;
        if (outside(c, tile, at % TD_TILE_SIDE, at / TD_TILE_SIDE)) tile->measure[i].count = 0;
    }
}

td_status td_frame_measure(td_frame_cells *cells, td_error *error)
{
    job j = {cells, calloc(cells->tile_count + 1, sizeof(bool))};
    bool failed = !j.failed;
    if (!failed) td_parallel_for(cells->tile_count, cells->threads, sum_tile, &j, NULL, NULL);
    for (size_t i = 0; !failed && i < cells->tile_count; i++) failed = j.failed[i];
    free(j.failed);
    if (failed) return td_fail(error, TD_ERROR_MEMORY, "no memory for the cells of a frame");
    td_parallel_for(cells->tile_count, cells->threads, measure_tile, &j, NULL, NULL);
    return TD_OK;
}
