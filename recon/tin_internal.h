/* What tin.c needs of CGAL. */
#ifndef TELEDIMOS_RECON_TIN_INTERNAL_H
#define TELEDIMOS_RECON_TIN_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Puts `index` (n), numbers of points of xyz, into an order in which they are quickly inserted, and their x,
 * y into xy: tin_order.c. False: out of memory. */
bool td_tin_order(double (*xy)[2], uint32_t *index, const double (*xyz)[3], size_t n);

/* Delaunay triangles of the points xy (n), inserted in this order; their corners are called by `index` (n).
 * Counter-clockwise, in any order. *triangles is (count,3), to be freed with free(); of points at the same
 * place only one is used. *vertices: those used. None when all lie on a line. False: out of memory, or CGAL's
 * own failure. */
bool td_tin_delaunay(uint32_t (**triangles)[3], size_t *count, size_t *vertices, const double (*xy)[2],
                     const uint32_t *index, size_t n);

#ifdef __cplusplus
}
#endif
#endif
