/* The epipolar curve of one left pixel, followed by inverse depth. */
#ifndef TELEDIMOS_RECON_EPIPOLAR_INTERNAL_H
#define TELEDIMOS_RECON_EPIPOLAR_INTERNAL_H

#include "recon/epipolar.h"

/* right(w) = image of origin + w step, w = 1/depth. */
typedef struct td_epipolar_curve {
    const td_camera *camera;   /* the right one */
    double origin[3], step[3]; /* right camera's frame: R (x, y, 1) of the left ray; baseline, m */
} td_epipolar_curve;

/* False: no ray, or none that goes forward. d_origin (3,2), may be NULL: by the left pixel. */
bool td_epipolar_curve_init(td_epipolar_curve *curve, double *d_origin, const td_pair *pair,
                            const double left[2]);
/* False: behind the right camera or past the fold of its distortion. d_inverse_depth (2) and d_point (2,3),
 * each may be NULL. */
bool td_epipolar_curve_at(double right[2], double *d_inverse_depth, double *d_point,
                          const td_epipolar_curve *curve, double inverse_depth);

#endif
