/* From the disparities of a rectified pair to points in space, and what calibration adds to their error.
 *
 * Matching: the disparity's own sigma. Calibration: the rig's joint covariance passed through each point; it
 * changes slowly over the image and with inverse depth, so it is worked out once on a grid of both and
 * interpolated. */
#ifndef TELEDIMOS_RECON_DEPTH_POINTS_H
#define TELEDIMOS_RECON_DEPTH_POINTS_H

#include "../core/rig.h"
#include "../core/stereo.h"
#include "dense.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A pair made ready for dense matching: rectification, its tables for both images, and the grid of
 * calibration error. Borrows the rig. */
typedef struct td_depth_camera td_depth_camera;
/* left, right: cameras of the rig, side by side. near_m, far_m: depths that are measured, finite. Refused: a
 * vertical pair, and a left camera that stands at the right. */
TD_API td_status td_depth_camera_new(td_depth_camera **camera, const td_rig *rig, int left, int right,
                                     double near_m, double far_m, td_error *error);
TD_API void td_depth_camera_free(td_depth_camera **camera);
TD_API const td_rectification *td_depth_camera_rectification(const td_depth_camera *camera);
/* rig_from_rectified of the left camera. */
TD_API td_pose td_depth_camera_pose(const td_depth_camera *camera);
/* Smallest disparity and number of levels, px, of depths from near_m to far_m. */
TD_API void td_depth_camera_range(int *lowest, int *levels, const td_depth_camera *camera);

/* Both images rectified, by tables made once; `right` NULL: the left one alone. */
TD_API td_status td_depth_camera_rectify(td_image **left, td_image **right, const td_depth_camera *camera,
                                         const td_image *raw_left, const td_image *raw_right, int threads,
                                         td_error *error);

typedef struct td_depth_point {
    float p[3];           /* m, in the rig's frame */
    float axis[3];        /* m: one standard deviation of matching, along the left ray (first order) */
    float calibration[6]; /* m^2: xx xy xz yy yz zz, from the rig's covariance; NaN: the rig has none */
} td_depth_point;

/* The point of rectified left pixel (x, y) with disparity d and its sigma. False: no depth, or one out of
 * near_m to far_m. */
TD_API bool td_depth_camera_point(td_depth_point *point, const td_depth_camera *camera, int x, int y,
                                  float disparity, float sigma);

#ifdef __cplusplus
}
#endif
#endif
