/* Errors of the board that all cameras see alike, estimated from the residuals, and what they do to a
 * covariance.
 *
 * A point of the board stands off its nominal place, in the board's frame, by s + b_v(x):
 *   s     its own, the same in all views (the print): independent, of equal variance along x, y and z;
 *   b_v   anew in each pose of the board: polynomials of the place on the board. Along z of degree 2 and 3
 *         (the sheet bends; less is the pose); in the plane of degree 1 (it stretches and shears) and of
 *         degree 2 and 3 (it ripples). Coefficients of a component are independent and of equal variance.
 * The residuals are r = J e_p + U u + n with u these displacements, n noise of `noise_share` times the
 * weights' variance. Variances maximise the restricted likelihood, in which the fitted parameters e_p cost
 * their degrees of freedom (Patterson and Thompson 1971), found by MacKay's fixed point (1992) on Henderson's
 * mixed-model equations (1975), each pose eliminated by itself. */
#ifndef TELEDIMOS_CALIB_BOARD_ERROR_INTERNAL_H
#define TELEDIMOS_CALIB_BOARD_ERROR_INTERNAL_H

#include "calib/bundle_internal.h"
#include "calib/drift_internal.h"

enum { TD_BOARD_PRINT, TD_BOARD_BEND, TD_BOARD_STRETCH, TD_BOARD_RIPPLE, TD_BOARD_PARTS };
/* Functions of degree 1 (2 of them), 2 (3) and 3 (4); columns of a pose: bend 7, stretch 2 x 2, ripple 2 x 7.
 */
enum { TD_BOARD_SHAPES = 9, TD_BOARD_COLUMNS = 25 };

/* The functions at each point of the target (points,TD_BOARD_SHAPES), of unit mean square over them. */
td_status td_board_shapes(double **shapes, const td_target *target, td_error *error);
/* A residual's derivative (2,TD_BOARD_COLUMNS) by the displacements of its pose. */
void td_board_columns(double u[2][TD_BOARD_COLUMNS], const td_drift_row *row, const double *shape);
/* The part (TD_BOARD_BEND …) of a column, and the sigma of its coefficient. */
int td_board_part(size_t column);
double td_board_sigma(const td_board_error *board, int part);

/* From the bundle's residuals at its minimum; what the bundle holds of the rig counts as fitted, since its
 * values may be wrong. Boards of several planes, fewer than 3 poses and what is not significant give no
 * error. */
td_status td_board_error_estimate(td_board_error *board, const td_bundle *bundle, td_error *error);

/* Adds their effect to the covariance of the problem that was built from the bundle. */
td_status td_board_error_add(td_covariance *covariance, const td_board_error *board, const td_bundle *bundle,
                             const td_bundle_blocks *blocks, td_error *error);

/* out (n,n): covariance by them of the gradient of a drift check over the cameras whose bit is set. */
td_status td_board_error_gradient(double *out, const td_board_error *board, const td_bundle *bundle,
                                  const td_drift_normal *normal, unsigned cameras, td_error *error);

#endif
