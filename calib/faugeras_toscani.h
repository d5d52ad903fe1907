/* The perspective matrix of a camera from points that do not lie on one plane (Faugeras and Toscani 1986). */
#ifndef TELEDIMOS_CALIB_FAUGERAS_TOSCANI_H
#define TELEDIMOS_CALIB_FAUGERAS_TOSCANI_H

#include <stddef.h>

#include "../core/camera.h"
#include "../core/pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Minimises the algebraic error of s (u, v, 1) = P (X, Y, Z, 1), from which the share that pixel noise has in
 * it is taken off (projective.c), with |third row's direction| = 1, the constraint that does not depend on
 * the target's frame. Outputs, each may be NULL: p, row-major 3x4; intrinsics fx fy cx cy (px) and `skew`
 * (px; near 0 for a real camera), pose. Inputs: point (n,3) m, pixel (n,2) px, n >= 6. TD_ERROR_DATA when the
 * points are too few, lie (nearly) on one plane or are numbered as in a mirror. */
TD_API td_status td_faugeras_toscani(double p[12], double intrinsics[4], double *skew,
                                     td_pose *camera_from_target, const double *point, const double *pixel,
                                     size_t n, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
