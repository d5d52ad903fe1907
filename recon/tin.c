#include "recon/tin.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "recon/tin_internal.h"

static td_status check_points(const double (*xyz)[3], size_t count, td_error *error)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(xyz[i][0]) || !isfinite(xyz[i][1]) || !isfinite(xyz[i][2]))
            return td_fail(error, TD_ERROR_ARGUMENT, "point %zu: is (%g, %g, %g), but must be finite", i,
                           xyz[i][0], xyz[i][1], xyz[i][2]);
    return TD_OK;
}

/* ---- triangles ---- */

enum { FEW = 32 }; /* so many are sorted by insertion */

/* A point's place in plan, for sorting. */
typedef struct place {
    double x, y;
    uint32_t index;
} place;

static int by_place(const void *a, const void *b)
{
    const place *p = a, *q = b;
    if (p->x != q->x) return p->x < q->x ? -1 : 1;
    if (p->y != q->y) return p->y < q->y ? -1 : 1;
    return p->index < q->index ? -1 : p->index > q->index;
}

static int by_index(const void *a, const void *b)
{
    const uint32_t p = *(const uint32_t *)a, q = *(const uint32_t *)b;
    return p < q ? -1 : p > q;
}

/* index (n): the first point of each place, ascending; *kept: their number. */
static bool first_of_each_place(uint32_t *index, size_t *kept, const double (*xyz)[3], size_t n)
{
    place *sorted = malloc(n * sizeof *sorted);
    if (!sorted) return false;
    for (size_t i = 0; i < n; i++) sorted[i] = (place){xyz[i][0], xyz[i][1], (uint32_t)i};
    qsort(sorted, n, sizeof *sorted, by_place);
    *kept = 0;
    for (size_t i = 0; i < n; i++)
        if (i == 0 || sorted[i].x != sorted[i - 1].x || sorted[i].y != sorted[i - 1].y)
            index[(*kept)++] = sorted[i].index;
    qsort(index, *kept, sizeof *index, by_index);
    free(sorted);
    return true;
}

static bool is_before(const uint32_t a[3], const uint32_t b[3])
{
    if (a[0] != b[0]) return a[0] < b[0];
    if (a[1] != b[1]) return a[1] < b[1];
    return a[2] < b[2];
}

static int by_corners(const void *a, const void *b)
{
    const uint32_t *p = a, *q = b;
    return is_before(p, q) ? -1 : is_before(q, p);
}

/* Each triangle from its least corner on, and all by their corners: counted out by the first, then sorted
 * among those, which are few but for the hub of a fan. */
static bool sort_triangles(uint32_t (*triangle)[3], size_t count, size_t point_count)
{
    size_t *begin = calloc(point_count + 2, sizeof *begin);
    uint32_t(*sorted)[3] = malloc((count + 1) * sizeof *sorted);
    for (size_t i = 0; begin && sorted && i < count; i++) {
        uint32_t *t = triangle[i];
        const int least = t[1] < t[0] ? (t[2] < t[1] ? 2 : 1) : (t[2] < t[0] ? 2 : 0);
        const uint32_t turned[3] = {t[least], t[(least + 1) % 3], t[(least + 2) % 3]};
        memcpy(t, turned, sizeof turned);
        begin[t[0] + 2]++;
    }
    for (size_t i = 2; begin && i < point_count + 2; i++) begin[i] += begin[i - 1];
    for (size_t i = 0; begin && sorted && i < count; i++) {
        memcpy(sorted[begin[triangle[i][0] + 1]++], triangle[i], sizeof *sorted);
    }
    const bool fine = begin && sorted;
    /* begin[i + 1] has come to the end of those of point i. */
    for (size_t i = 0; fine && i < point_count; i++)
        if (begin[i + 1] - begin[i] > FEW)
            qsort(sorted + begin[i], begin[i + 1] - begin[i], sizeof *sorted, by_corners);
    for (size_t i = 1; fine && i < count; i++) {
        uint32_t moving[3];
        size_t at = i;
        memcpy(moving, sorted[i], sizeof moving);
        for (; at > 0 && is_before(moving, sorted[at - 1]); at--)
            memcpy(sorted[at], sorted[at - 1], sizeof moving);
        memcpy(sorted[at], moving, sizeof moving);
    }
    if (fine) memcpy(triangle, sorted, count * sizeof *sorted);
    free(begin);
    free(sorted);
    return fine;
}

/* All points at first; only when some share their place, which is rare, the first of each. */
static bool delaunay(uint32_t (**triangles)[3], size_t *count, const double (*xyz)[3], size_t n)
{
    uint32_t *index = malloc(n * sizeof *index);
    double(*xy)[2] = malloc(n * sizeof *xy);
    size_t vertices = 0, kept = n;
    bool fine = index && xy;
    for (size_t i = 0; fine && i < n; i++) index[i] = (uint32_t)i;
    fine =
        fine && td_tin_order(xy, index, xyz, n) && td_tin_delaunay(triangles, count, &vertices, xy, index, n);
    if (fine && vertices < n) {
        free(*triangles);
        *triangles = NULL;
        fine = first_of_each_place(index, &kept, xyz, n) && td_tin_order(xy, index, xyz, kept) &&
               td_tin_delaunay(triangles, count, &vertices, xy, index, kept);
    }
    free(index);
    free(xy);
    return fine && sort_triangles(*triangles, *count, n);
}

td_status td_tin_triangulate(uint32_t (**triangles)[3], size_t *count, const double (*xyz)[3],
                             size_t point_count, td_error *error)
{
    *triangles = NULL;
    *count = 0;
    if (point_count < 3 || point_count > UINT32_MAX)
        return td_fail(error, TD_ERROR_DATA, "%zu points: triangles need 3 to %u", point_count, UINT32_MAX);
    TD_TRY(check_points(xyz, point_count, error));
    if (!delaunay(triangles, count, xyz, point_count)) {
        free(*triangles);
        *triangles = NULL;
        *count = 0;
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the triangles of %zu points", point_count);
    }
    if (*count > 0) return TD_OK;
    free(*triangles);
    *triangles = NULL;
    return td_fail(error, TD_ERROR_DATA,
                   "all %zu points lie on one line in plan; triangles need points beside it", point_count);
}

/* ---- the grid ---- */

typedef struct grid {
    td_elevation *map;
    const double (*xyz)[3];
    const double *covariance, *sigma_z;
    size_t points;
    uint32_t *inside; /* (rows,columns) points in each cell */
} grid;

/* Twice the area of (a, b, p), coordinates from the map's origin. The corner of lower index comes first, so
 * that both triangles of a side judge a cell's centre by the same number: none falls between them. */
static double side(const grid *g, uint32_t a, uint32_t b, double x, double y)
{
    const bool turned = b < a;
    const double *p = g->xyz[turned ? b : a], *q = g->xyz[turned ? a : b], *o = g->map->origin;
    const double px = p[0] - o[0], py = p[1] - o[1], qx = q[0] - o[0], qy = q[1] - o[1];
    const double twice = (qx - px) * (y - py) - (qy - py) * (x - px);
    return turned ? -twice : twice;
}

/* Standard deviation of the plane's height at weights w of the corners: with its slope s, an error of a
 * corner moves it by w (dz - s_x dx - s_y dy). */
static double sigma_of(const grid *g, const uint32_t t[3], const double w[3], const double slope[2])
{
    const size_t n = 3 * g->points;
    double variance = 0, v[9];
    if (!g->covariance) {
        for (int k = 0; g->sigma_z && k < 3; k++)
            variance += w[k] * w[k] * g->sigma_z[t[k]] * g->sigma_z[t[k]];
        return g->sigma_z ? sqrt(variance) : (double)NAN;
    }
    for (int k = 0; k < 9; k++) v[k] = w[k / 3] * (k % 3 == 2 ? 1 : -slope[k % 3]);
    for (size_t i = 0; i < 9; i++)
        for (size_t k = 0; k < 9; k++)
            variance += v[i] * v[k] * g->covariance[(3 * t[i / 3] + i % 3) * n + 3 * t[k / 3] + k % 3];
    return variance < 0 ? 0 : sqrt(variance); /* NaN stays */
}

static void write_cell(const grid *g, size_t cell, const uint32_t t[3], const double w[3],
                       const double slope[2])
{
    td_elevation *map = g->map;
    double height = 0;
    for (int k = 0; k < 3; k++) height += w[k] * g->xyz[t[k]][2];
    map->height[cell] = (float)height;
    map->sigma[cell] = (float)sigma_of(g, t, w, slope);
    map->count[cell] = g->inside[cell];
    map->provenance[cell] = g->inside[cell] ? TD_CELL_MEASURED : TD_CELL_FILLED;
    map->time_s[cell] = NAN;
}

/* First and last cell of an axis whose centres lie in [low, high] m from the first. */
static void span(int *first, int *last, double low, double high, double cell_m, int count)
{
    *first = (int)fmin(fmax(floor(low / cell_m), 0), count);
    *last = (int)fmax(fmin(ceil(high / cell_m), count - 1), -1);
}

static void fill_triangle(const grid *g, const uint32_t t[3])
{
    const td_elevation *map = g->map;
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    int first[2], last[2];
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 2; i++) {
            const double from_origin = g->xyz[t[k]][i] - map->origin[i];
            low[i] = fmin(low[i], from_origin);
            high[i] = fmax(high[i], from_origin);
        }
    span(first, last, low[0], high[0], map->cell_m, map->columns);
    span(first + 1, last + 1, low[1], high[1], map->cell_m, map->rows);
    const double *a = g->xyz[t[0]], *b = g->xyz[t[1]], *c = g->xyz[t[2]];
    const double ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2];
    const double vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2], area = ux * vy - uy * vx;
    if (!(area > 0)) return;
    const double slope[2] = {(uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area};
    for (int row = first[1]; row <= last[1]; row++)
        for (int column = first[0]; column <= last[0]; column++) {
            const double x = column * map->cell_m, y = row * map->cell_m;
            double w[3];
            for (int k = 0; k < 3; k++) w[k] = side(g, t[(k + 1) % 3], t[(k + 2) % 3], x, y);
            if (w[0] < 0 || w[1] < 0 || w[2] < 0) continue;
            const double sum = w[0] + w[1] + w[2];
            for (int k = 0; k < 3; k++) w[k] /= sum;
            if (sum > 0) write_cell(g, (size_t)row * (size_t)map->columns + (size_t)column, t, w, slope);
        }
}

static void count_points(const grid *g)
{
    const td_elevation *map = g->map;
    for (size_t i = 0; i < g->points; i++) {
        const double column = floor((g->xyz[i][0] - map->origin[0]) / map->cell_m + 0.5);
        const double row = floor((g->xyz[i][1] - map->origin[1]) / map->cell_m + 0.5);
        if (column >= 0 && row >= 0 && column < map->columns && row < map->rows)
            g->inside[(size_t)row * (size_t)map->columns + (size_t)column]++;
    }
}

static bool is_long(const double (*xyz)[3], const uint32_t t[3], double longest_m)
{
    for (int k = 0; k < 3 && longest_m > 0; k++) {
        const double *a = xyz[t[k]], *b = xyz[t[(k + 1) % 3]];
        if (hypot(a[0] - b[0], a[1] - b[1]) > longest_m) return true;
    }
    return false;
}

td_status td_tin_grid(td_elevation *map, const double (*xyz)[3], size_t point_count,
                      const uint32_t (*triangles)[3], size_t triangle_count, const double *covariance,
                      const double *sigma_z, double longest_m, td_error *error)
{
    TD_TRY(check_points(xyz, point_count, error));
    if (!(longest_m >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "longest_m: must be 0 or more, not %g", longest_m);
    for (size_t i = 0; i < triangle_count; i++)
        for (int k = 0; k < 3; k++)
            if (triangles[i][k] >= point_count)
                return td_fail(error, TD_ERROR_ARGUMENT, "triangle %zu: corner %u, but there are %zu points",
                               i, triangles[i][k], point_count);
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    grid g = {map, xyz, covariance, sigma_z, point_count, calloc(cells, sizeof *g.inside)};
    if (!g.inside) return td_fail(error, TD_ERROR_MEMORY, "no memory for a grid of %zu cells", cells);
    count_points(&g);
    for (size_t i = 0; i < triangle_count; i++)
        if (!is_long(xyz, triangles[i], longest_m)) fill_triangle(&g, triangles[i]);
    free(g.inside);
    return TD_OK;
}
