/* The projective map of points on a plane, or in space, to an image: what homographies and Faugeras-Toscani
 * share. */
#ifndef TELEDIMOS_CALIB_PROJECTIVE_INTERNAL_H
#define TELEDIMOS_CALIB_PROJECTIVE_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

typedef struct td_projective {
    double q[12];  /* (3,d+1) row-major, up to its scale: pixel ~ q (point, 1) */
    double spread; /* least over largest standard deviation of the points about their middle; 0: on a line
                      (plane) */
    double gap;    /* 0: other maps explain the points as well, 0.001 or more where they do not */
} td_projective;

/* point (n,d), d 2 or 3; pixel (n,2). False when points or pixels coincide or are not finite. */
bool td_projective_fit(td_projective *fit, const double *point, const double *pixel, size_t n, int d);

#endif
