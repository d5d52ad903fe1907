/* How far the calibration lets a projected point wander: the standard deviation, in pixels, of the image of a
 * point at a given distance, over the image.
 *
 * The point is fixed to the boards, as they stood, not to the camera's frame, which is itself estimated: it
 * is carried through every board's pose and the mean of the projections is taken (mrcal's "mean-frames"
 * method: Kogan, mrcal 2, "Projection uncertainty"). */
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

/* covariance (count, 2, 2) px^2, NaN where the pixel has no ray. The noise is the calibration's own. */
TD_API td_status td_projected_uncertainty(double *covariance, const td_projected_query *query, size_t count,
                                          const td_calibration *calibration,
                                          const td_observations *observations, td_error *error);

/* The same on a grid over each camera's image and some distances, as the worst direction's sigma. */
typedef struct td_uncertainty_map {
    int columns, rows, distance_count, camera_count;
    double *distance_m; /* (distances) */
    double *sigma_px;   /* (cameras, distances, rows, columns), pixels evenly spread from edge to edge */
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
