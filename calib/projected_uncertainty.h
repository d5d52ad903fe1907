/* How far the calibration lets a projected point wander: the standard deviation, in pixels, of the image of a
 * point at a given distance, over the image.
 *
 * The point is fixed to the boards, as they stood, not to the camera's frame, which is itself estimated: it
 * is carried through every board's pose and the mean of the projections is taken (mrcal's "mean-frames"
 * method: Kogan, mrcal 2, "Projection uncertainty"). Its covariance is G C G^T with G the derivatives of that
 * mean by the camera's parameters, its pose in the rig and the boards' poses, and C their joint covariance.
 * Views of a board on a rail share one pose and count as one board.
 *
 * It is what the noise of the points does to the result, no more. It is blind to what the model lacks: a lens
 * that the camera model cannot follow, a board that is not as described, an image that was distorted twice.
 * Where no board was seen it is right only if the model holds there too. What was held of the cameras counts
 * with the covariance that it was given, or, lacking one, as exact. */
#ifndef TELEDIMOS_CALIB_PROJECTED_UNCERTAINTY_H
#define TELEDIMOS_CALIB_PROJECTED_UNCERTAINTY_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What is asked about: one point seen at `pixel` of camera `camera`, `distance_m` from it. */
typedef struct td_projected_query {
    int camera;
    double pixel[2];
    double distance_m; /* along the ray; INFINITY is allowed */
} td_projected_query;

/* covariance (count, 2, 2) px^2, NaN where the pixel has no ray and where the camera saw nothing. The noise
 * is the calibration's own. `observations` are those that were calibrated. TD_ERROR_DATA when the views leave
 * some of the cameras' parameters open. Many queries in one call cost little more than one. */
TD_API td_status td_projected_uncertainty(double *covariance, const td_projected_query *query, size_t count,
                                          const td_calibration *calibration,
                                          const td_observations *observations, td_error *error);

/* The same on a grid over each camera's image and some distances, as the worst direction's sigma. */
typedef struct td_uncertainty_map {
    int columns, rows, distance_count, camera_count;
    double *distance_m; /* (distances) */
    double *sigma_px;   /* (cameras, distances, rows, columns), pixels evenly spread from the first column
                         and row to the last; NaN as above */
} td_uncertainty_map;

/* Distances: NULL, 0 for the nearest and the farthest board, the middle between them, and ten times the
 * farthest. */
TD_API td_status td_uncertainty_map_new(td_uncertainty_map **map, int columns, int rows,
                                        const double *distance_m, int distance_count,
                                        const td_calibration *calibration,
                                        const td_observations *observations, td_error *error);
TD_API void td_uncertainty_map_free(td_uncertainty_map **map);

#ifdef __cplusplus
}
#endif
#endif
