/* Epipolar geometry of two calibrated cameras with distortion: where in the right image the image of a left
 * point can be. Line of F in undistorted coordinates, a curve in the image as taken. */
#ifndef TELEDIMOS_RECON_EPIPOLAR_H
#define TELEDIMOS_RECON_EPIPOLAR_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/rig.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A pair of a rig's cameras, with what is used again and again. Borrowed from the rig. */
typedef struct td_pair {
    const td_rig *rig;
    int left, right;         /* cameras of the rig */
    td_pose right_from_left; /* camera frames */
    double baseline_m;
} td_pair;
/* Refused: a camera that is not there, both the same, a baseline of nothing. */
TD_API td_status td_pair_init(td_pair *pair, const td_rig *rig, int left, int right, td_error *error);

/* Fundamental matrix (3,3), row-major, of undistorted pixels: right^T F left = 0, |F| = 1. */
TD_API void td_pair_fundamental(double f[9], const td_pair *pair);

/* Right image, px as taken, of the point at distance `depth` (m, along the left camera's z; INFINITY: its
 * vanishing point) behind left pixel `left`; false where there is none. d_inverse_depth (2), px m: its
 * derivative by 1/depth; d_left (2,2); each may be NULL. */
TD_API bool td_pair_transfer(double right[2], double *d_inverse_depth, double *d_left, const td_pair *pair,
                             const double left[2], double depth);

/* Signed distance, px, of `right` from the epipolar curve of `left`, and `along` (may be NULL) unit vector of
 * the curve at its nearest point, towards farther points. Positive on the side of (-along[1], along[0]):
 * below the curve for two cameras side by side, the right one at the right. d_parameter (1,
 * td_rig_parameter_count) its derivative by the rig's parameters in the covariance's order (may be NULL).
 * False where undefined. */
TD_API bool td_pair_residual(double *distance, double along[2], double *d_parameter, const td_pair *pair,
                             const double left[2], const double right[2]);
/* Standard deviation, px, of that distance from the rig's covariance alone; NaN where the rig has none. */
TD_API double td_pair_residual_sigma(const td_pair *pair, const double left[2], const double right[2]);

#ifdef __cplusplus
}
#endif
#endif
