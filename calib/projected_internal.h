/* How the image of a point that is fixed to the boards moves with the parameters.
 *
 * The point x of camera c is carried by every board pose i and back: x_i = camera_from_rig rig_from_target_i
 * p_i. At the solution all x_i are x, so the mean of their projections q+ moves by dq = Q dtheta + P [-[x]x,
 * I] dxi_c + P R_cr [-[x_r]x, I] mean_i dxi_i, Q and P the projection's derivatives by its parameters and by
 * the point, x_r the point in the rig's frame: of the boards only their mean perturbation m counts. */
#ifndef TELEDIMOS_CALIB_PROJECTED_INTERNAL_H
#define TELEDIMOS_CALIB_PROJECTED_INTERNAL_H

#include "calib/bundle_internal.h"

/* Columns of the gradient: the camera's parameters, its camera_from_rig (6), the boards' mean (6). */
enum { TD_PROJECTED_MOST = TD_CAMERA_MAX_PARAMETERS + 12 };

/* Gradient (2,count), row-major, of the image of the point seen at `pixel`, `distance_m` away (INFINITY: its
 * direction). False when the pixel has no ray. *count is set in any case. */
bool td_projected_gradient(double gradient[2 * TD_PROJECTED_MOST], size_t *count, const td_rig *rig,
                           int camera, const double pixel[2], double distance_m);

/* Pixel of the grid's column and row: evenly spread from the first pixel to the last, one alone is central.
 */
void td_grid_pixel(double pixel[2], const td_camera *camera, int column, int columns, int row, int rows);

/* Root of the larger eigenvalue of a covariance (2,2). */
double td_worst_sigma(const double s[4]);

/* Distances of the boards' centres from the cameras that saw them: nearest, farthest, median; false: none. */
bool td_board_distances(double *nearest, double *farthest, double *middle, const td_calibration *calibration,
                        const td_observations *observations);

#endif
