/* What views of a board tell of a rig, as linear algebra only: so cheap that hundreds of views that were not
 * taken can be weighed.
 *
 * A board seen at a pose adds, with J = [J_s J_v] the weighted derivatives of its points' images by the
 * shared parameters (cameras, warp) and by the board's own pose, N_ss = J_s^T J_s, N_vs = J_v^T J_s, N_vv =
 * J_v^T J_v, of which the shared parameters keep N_ss - N_sv N_vv^-1 N_vs. The projected uncertainty needs
 * besides how the mean of the boards' poses follows the shared ones: sum N_vv^-1 N_vs, and its own noise, sum
 * N_vv^-1. */
#ifndef TELEDIMOS_CALIB_VIEW_INFORMATION_INTERNAL_H
#define TELEDIMOS_CALIB_VIEW_INFORMATION_INTERNAL_H

#include "calib/bundle_internal.h"

enum { TD_OWN_COLUMNS = TD_CAMERA_MAX_PARAMETERS + 6 + 2 };

/* Columns of the free shared parameters. */
typedef struct td_shared_layout {
    size_t n;
    int count[TD_RIG_MAX_CAMERAS];                  /* parameters of a camera */
    int column[TD_RIG_MAX_CAMERAS][TD_OWN_COLUMNS]; /* of its parameters, pose, the warp; -1: held, none */
} td_shared_layout;

td_shared_layout td_shared_layout_of(const td_bundle *bundle);

typedef struct td_information {
    size_t n;
    double *shared;   /* (n,n) information on the shared parameters */
    double *coupling; /* (6,n) sum N_vv^-1 N_vs */
    double board[36]; /* sum N_vv^-1 */
    size_t boards;
} td_information;

td_status td_information_init(td_information *information, size_t n, td_error *error);
void td_information_copy(td_information *copy, const td_information *from); /* both of the same n */
void td_information_free(td_information *information);

/* One board before its pose is eliminated; cleared to begin with. */
typedef struct td_board_information {
    size_t n;
    double *shared, *coupling; /* N_ss (n,n), N_vs (6,n) */
    double board[36];          /* N_vv */
} td_board_information;

td_status td_board_information_init(td_board_information *board, size_t n, td_error *error);
void td_board_information_clear(td_board_information *board);
void td_board_information_free(td_board_information *board);

/* Adds the image of one point, in the target's frame, with the given weight (1/px^2); `shape` as the warp's
 * shape there (NULL: no warp). False when it has no image. */
bool td_board_information_add(td_board_information *board, const td_shared_layout *layout, const td_rig *rig,
                              int camera, const td_pose *rig_from_target, const double point[3],
                              const double shape[2], double weight);
/* Eliminates the board's pose. False when its points do not determine it: nothing is added. */
bool td_information_add(td_information *information, const td_board_information *board);

/* All that a bundle's used points and its priors tell. */
td_status td_information_of_bundle(td_information *information, const td_shared_layout *layout,
                                   const td_bundle *bundle, td_error *error);

/* Joint covariance (n+6,n+6) of the shared parameters and of the mean of the boards' poses; TD_ERROR_DATA
 * when the views do not determine them. */
td_status td_information_covariance(double *covariance, const td_information *information, td_error *error);

/* Gradient (2,n+6) of the image of a point fixed to the boards (projected_internal.h); false: no ray. */
bool td_information_gradient(double *gradient, const td_shared_layout *layout, const td_rig *rig, int camera,
                             const double pixel[2], double distance_m);

#endif
