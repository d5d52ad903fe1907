/* Plane homographies: from point pairs, and to focal lengths and poses. */
#ifndef TELEDIMOS_CALIB_HOMOGRAPHY_H
#define TELEDIMOS_CALIB_HOMOGRAPHY_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/camera.h"
#include "../core/pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* image ~ h * plane: linear least squares of the algebraic error, normalised and with the noise's share taken
 * off (projective.c; Hartley and Zisserman 2004, alg. 4.2 without its bias). plane, image: (n,2), n >= 4; h:
 * row-major 3x3, unit Frobenius norm. TD_ERROR_DATA when points are too few or (nearly) on a line. */
TD_API td_status td_homography(double h[9], const double *plane, const double *image, size_t n,
                               td_error *error);

/* Focal lengths (px) from >= 1 homographies of a plane in metres, for a principal point that is given: each
 * homography says that two directions of the plane are orthogonal and of one length, linear in 1/fx^2 and
 * 1/fy^2 (Zhang 2000, sect. 3.1, with known centre). h: (n,9). False when the views do not tell (all parallel
 * to the image). */
TD_API bool td_focal_from_homographies(double focal[2], const double centre[2], const double *h, size_t n);

/* Pose of the plane (camera_from_plane) from a homography to NORMALISED image coordinates (Zhang 2000,
 * sect. 3.1). */
TD_API td_status td_pose_from_homography(td_pose *camera_from_plane, const double h[9], td_error *error);

#ifdef __cplusplus
}
#endif
#endif
