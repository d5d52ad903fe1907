/* Two calibrated cameras: essential and fundamental matrix, epipolar error, rectification. */
#ifndef TELEDIMOS_CORE_STEREO_H
#define TELEDIMOS_CORE_STEREO_H

#include <stdbool.h>
#include <stddef.h>

#include "camera.h"
#include "image.h"
#include "pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* P = K [R t], row-major 3x4: the perspective matrix of undistorted pixels. */
TD_API void td_perspective_matrix(double p[12], const td_camera *camera, const td_pose *camera_from_world);

/* e = [t]x R, so that y2^T e y1 = 0 for normalised image coordinates; row-major. */
TD_API void td_essential_matrix(double e[9], const td_pose *second_from_first);

/* f = K2^-T e K1^-1, so that x2^T f x1 = 0 for undistorted pixels; unit Frobenius norm; row-major. */
TD_API void td_fundamental_matrix(double f[9], const td_camera *first, const td_camera *second,
                                  const td_pose *second_from_first);

/* Distances (px) of a pair of undistorted pixels from each other's epipolar line, in the first and the second
 * image. */
TD_API void td_epipolar_distances(double distance[2], const double f[9], const double pixel1[2],
                                  const double pixel2[2]);

/* The pixel that the distortion-free camera with the same K would see. False where the model cannot be
 * inverted. */
TD_API bool td_undistort_pixel(double out[2], const td_camera *camera, const double pixel[2]);

/* Point (first camera's frame, m) that minimises the squared reprojection error in both images (Gauss-Newton
 * from the midpoint of the rays). False when the rays are parallel or the point falls behind a camera. */
TD_API bool td_triangulate_pair(double point[3], const td_camera *first, const td_camera *second,
                                const td_pose *second_from_first, const double pixel1[2],
                                const double pixel2[2]);

typedef struct td_rectification {
    td_camera camera;          /* the pinhole camera that both become */
    td_pose rectified_from[2]; /* rotations: rectified first and second camera from the given ones */
    double baseline_m; /* second camera at +x (side by side) or +y (one above the other) of the first */
    bool vertical;     /* rows of one are not rows of the other: columns are */
} td_rectification;

/* Epipolar lines become rows (or, for cameras one above the other, columns): each camera is turned by half of
 * their relative rotation, then both so that x (y) lies along the baseline. `zoom` 0: only pixels that both
 * images fill; 1: all pixels of both; the focal length follows. The size stays the first camera's. Refused
 * where the field is too wide for a pinhole, or where one camera is ahead of the other. */
TD_API td_status td_rectify(td_rectification *rectification, const td_camera *first, const td_camera *second,
                            const td_pose *second_from_first, double zoom, td_error *error);

/* at (height,width,2) px: where each rectified pixel of camera `index` (0, 1) lies in the image as taken;
 * NaN: not seen. */
TD_API td_status td_rectify_table(float *at, const td_rectification *rectification, int index,
                                  const td_camera *camera, int threads);

/* The rectified image of camera `index` (0, 1) by bilinear interpolation; black where nothing was seen. */
TD_API td_status td_rectify_image(td_image **out, const td_image *image,
                                  const td_rectification *rectification, int index, const td_camera *camera,
                                  int threads, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
