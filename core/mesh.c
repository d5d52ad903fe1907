#include "core/mesh.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

static const uint32_t NONE = UINT32_MAX;

/* The grid thinned: vertex (column, row) is cell (step column, step row). */
typedef struct thinned {
    const td_elevation *map;
    int step, columns, rows;
    uint32_t *vertex; /* (rows, columns) number; NONE: no triangle has it */
} thinned;

static size_t cell_of(const thinned *t, int column, int row)
{
    return (size_t)(row * t->step) * (size_t)t->map->columns + (size_t)(column * t->step);
}

/* No cell within the square is unknown; of a square of neighbours one may be. */
static bool is_whole(const thinned *t, int column, int row)
{
    for (int y = row * t->step; y <= (row + 1) * t->step; y++)
        for (int x = column * t->step; x <= (column + 1) * t->step; x++)
            if (!isfinite(t->map->height[(size_t)y * (size_t)t->map->columns + (size_t)x])) return false;
    return true;
}

/* Corners of a square, counter-clockwise, and those that its triangles take. The diagonal joins the two whose
 * heights differ less: it does not cut through an edge. */
static int triangles_of(int corner[2][3], const thinned *t, int column, int row)
{
    static const int dx[4] = {0, 1, 1, 0}, dy[4] = {0, 0, 1, 1};
    double z[4];
    int missing = -1, count = 0;
    for (int k = 0; k < 4; k++) {
        z[k] = (double)t->map->height[cell_of(t, column + dx[k], row + dy[k])];
        if (isfinite(z[k]))
            count++;
        else
            missing = k;
    }
    if (count < 3 || (t->step > 1 && !is_whole(t, column, row))) return 0;
    if (count == 3) {
        for (int k = 0; k < 3; k++) corner[0][k] = (missing + 1 + k) % 4;
        return 1;
    }
    const int first = fabs(z[0] - z[2]) <= fabs(z[1] - z[3]) ? 0 : 1;
    for (int k = 0; k < 3; k++) {
        corner[0][k] = (first + k) % 4;
        corner[1][k] = (first + 2 + k) % 4;
    }
    return 2;
}

/* Marks the vertices that triangles have, counts both; with `mesh` fills the triangles. */
static void visit(thinned *t, size_t *triangles, td_cloud *mesh)
{
    static const int dx[4] = {0, 1, 1, 0}, dy[4] = {0, 0, 1, 1};
    *triangles = 0;
    for (int row = 0; row + 1 < t->rows; row++)
        for (int column = 0; column + 1 < t->columns; column++) {
            int corner[2][3];
            const int count = triangles_of(corner, t, column, row);
            for (int i = 0; i < count; i++, ++*triangles)
                for (int k = 0; k < 3; k++) {
                    uint32_t *v = &t->vertex[(size_t)(row + dy[corner[i][k]]) * (size_t)t->columns +
                                             (size_t)(column + dx[corner[i][k]])];
                    if (mesh)
                        mesh->triangle[*triangles][k] = *v;
                    else
                        *v = 0;
                }
        }
}

static size_t number(thinned *t)
{
    size_t count = 0, all = (size_t)t->columns * (size_t)t->rows;
    for (size_t i = 0; i < all; i++)
        if (t->vertex[i] != NONE) t->vertex[i] = (uint32_t)count++;
    return count;
}

static void fill(td_cloud *mesh, const thinned *t)
{
    const td_elevation *map = t->map;
    for (int row = 0; row < t->rows; row++)
        for (int column = 0; column < t->columns; column++) {
            const uint32_t v = t->vertex[(size_t)row * (size_t)t->columns + (size_t)column];
            if (v == NONE) continue;
            const size_t cell = cell_of(t, column, row);
            td_cloud_point *p = &mesh->point[v];
            p->p[0] = map->origin[0] + column * t->step * map->cell_m;
            p->p[1] = map->origin[1] + row * t->step * map->cell_m;
            p->p[2] = (double)map->height[cell];
            p->sigma = map->sigma[cell];
        }
}

static int step_for(const td_elevation *map, size_t most)
{
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    size_t count = 0;
    for (size_t i = 0; i < cells; i++) count += isfinite(map->height[i]);
    int step = 1;
    while (most && count / ((size_t)step * (size_t)step) > most) step++;
    return step;
}

td_status td_mesh_from_elevation(td_cloud **mesh, const td_elevation *map, size_t most, td_error *error)
{
    thinned t = {.map = map, .step = step_for(map, most)};
    size_t triangles = 0;
    *mesh = NULL;
    t.columns = (map->columns - 1) / t.step + 1;
    t.rows = (map->rows - 1) / t.step + 1;
    const size_t all = (size_t)t.columns * (size_t)t.rows;
    t.vertex = malloc(all * sizeof *t.vertex);
    if (!t.vertex) return td_fail(error, TD_ERROR_MEMORY, "no memory for a mesh of %zu cells", all);
    for (size_t i = 0; i < all; i++) t.vertex[i] = NONE;
    visit(&t, &triangles, NULL);
    const size_t vertices = number(&t);
    td_status status = triangles ? td_cloud_new(mesh, vertices, triangles, error)
                                 : td_fail(error, TD_ERROR_DATA,
                                           "the map has no three known cells side by side: there is no "
                                           "surface to make a mesh of");
    if (status == TD_OK) {
        fill(*mesh, &t);
        visit(&t, &triangles, *mesh);
    }
    free(t.vertex);
    return status;
}
