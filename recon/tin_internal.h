/* What tin.c needs of CGAL. */
#ifndef TELEDIMOS_RECON_TIN_INTERNAL_H
#define TELEDIMOS_RECON_TIN_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Delaunay triangles of x, y of the points `index` (n) of xyz, counter-clockwise, in any order. *triangles is
 * (count,3), to be freed with free(); of points at the same place only one is used. *vertices: those used.
 * None when all lie on a line. False: out of memory, or CGAL's own failure. */
bool td_tin_delaunay(uint32_t (**triangles)[3], size_t *count, size_t *vertices, const double (*xyz)[3],
                     const uint32_t *index, size_t n);

#ifdef __cplusplus
}
#endif
#endif
