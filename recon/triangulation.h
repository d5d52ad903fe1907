/* The point in space behind a match, and how well it is known.
 *
 * Hartley and Sturm's polynomial method (1997; Hartley and Zisserman 12.5): the nearest pair of points, in
 * undistorted pixels, that meets the epipolar constraint exactly, then the rays' intersection: optimal for
 * equal Gaussian noise in both images. */
#ifndef TELEDIMOS_RECON_TRIANGULATION_H
#define TELEDIMOS_RECON_TRIANGULATION_H

#include "match.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_point3 {
    double p[3];           /* m, in the rig's frame (the first camera's) */
    double covariance[9];  /* m^2, all together: matching + calibration; NaN when either is not known */
    double matching[9];    /* of the match alone */
    double calibration[9]; /* of the rig's joint covariance alone; NaN: the rig has none */
    double residual_px;    /* distance from the epipolar constraint, both images together */
} td_point3;

/* The corrected pair of undistorted pixels for F, as td_pair_fundamental gives it. */
TD_API void td_hartley_sturm(double left_corrected[2], double right_corrected[2], const double f[9],
                             const double left[2], const double right[2]);

/* False: behind a camera, at infinity, or no ray. */
TD_API bool td_triangulate(td_point3 *point, const td_pair *pair, const td_match *match);

/* Joint covariance (3n,3n), row-major, of several points: what the calibration leaves in common included. */
TD_API td_status td_triangulate_joint(double *covariance, const td_pair *pair, const td_match *match,
                                      size_t count, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
