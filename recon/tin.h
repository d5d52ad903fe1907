/* A coarse elevation map from few points: Delaunay triangles over them (CGAL, behind its wall), and a grid
 * cut out of the triangles (paper, section 4). */
#ifndef TELEDIMOS_RECON_TIN_H
#define TELEDIMOS_RECON_TIN_H

#include "../core/cloud.h"
#include "../core/elevation.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Delaunay triangles (counter-clockwise seen from above) over the points' x, y; sorted, so that they do not
 * depend on the library's order. Exact at any coordinates (UTM's included). Of points with the same x, y the
 * first counts. *triangles is (count,3), to be freed with free(). Fewer than three points, all on a line, or
 * numbers that are none: refused. */
TD_API td_status td_tin_triangulate(uint32_t (**triangles)[3], size_t *count, const double (*xyz)[3],
                                    size_t point_count, td_error *error);

/* Cells whose centre lies in a triangle get its height, linear between the corners, and its sigma: from the
 * corners' joint covariance (3n,3n) of x, y, z when given (slope included), else from `sigma_z` (n) taken as
 * independent, else NaN. Others stay as they are. Triangles with a side longer than `longest_m` in plan (0:
 * any) are left out. Provenance: TD_CELL_MEASURED where points lie in the cell (their number in `count`),
 * else TD_CELL_FILLED. Time: NaN. Refused: corners that are no points, numbers that are none. */
TD_API td_status td_tin_grid(td_elevation *map, const double (*xyz)[3], size_t point_count,
                             const uint32_t (*triangles)[3], size_t triangle_count, const double *covariance,
                             const double *sigma_z, double longest_m, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
