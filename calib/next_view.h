/* Which picture to take next: the board's pose that reduces the projected uncertainty most.
 *
 * Each way in which a person might hold the board (where in the image, how far, tilted, turned) adds what its
 * points would tell, its own unknown pose eliminated, to what the views so far tell; the one that leaves the
 * least projected uncertainty (projected_uncertainty.h) over all cameras' images is asked for. Linear algebra
 * only, about the present estimate: what is held of the cameras is taken as exact.
 *
 * The words are about the camera's image, as it shows the board: "tilted to the right" is turned so that its
 * right side is farther from the camera ("up": its upper side), "turned by a quarter" is turned clockwise in
 * the image. A tilt is measured against the image's plane, the distance along the camera's axis. */
#ifndef TELEDIMOS_CALIB_NEXT_VIEW_H
#define TELEDIMOS_CALIB_NEXT_VIEW_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_next_view_options {
    double nearest_m, farthest_m; /* where the board can be held; 0: filling three quarters, and a quarter, of
                                     the image, or as near and as far as the views so far if that is more */
    double distance_m;            /* where the projected uncertainty counts; 0: the middle board's */
    double enough_px;             /* projected uncertainty that is wished for; 0: no wish */
    double gain_that_counts;      /* a share by which a view must reduce it; default 0.03 */
    int skip; /* 0: the best; k: the best that differs in place or tilt from the k better ones, for a person
                 who cannot hold the board so */
} td_next_view_options;

TD_API td_next_view_options td_next_view_options_default(void);
TD_API td_status td_next_view_options_check(const td_next_view_options *options, td_error *error);

typedef struct td_next_view {
    td_pose rig_from_target; /* how to hold the board */
    int camera;              /* in whose words and picture it is told */
    double outline[8];   /* px, the board's four outer corners in that camera's image, from its first point
                            on clockwise as the board is read; NaN where a corner has no image */
    double sigma_px;     /* projected uncertainty now (worst direction, root mean square over a grid on all
                            images); INFINITY: the views leave the cameras open; NaN: no calibration yet */
    double predicted_px; /* and with this view */
    bool enough;         /* no view gains what counts, or the wish is fulfilled */
    char text[TD_TEXT_SIZE]; /* "hold the board at the lower left, tilted 30 degrees to the right, close by
                                (0.35 m)" */
} td_next_view;

/* `observations` are those that were calibrated. `calibration` may be NULL while the views are too few: the
 * first ones are then asked for by rule (in the middle and facing, then tilted to each side, then in the
 * corners) from the images' size and a camera of 60 degrees across, in the frame of the camera named; the
 * number of views in which the target was found says which. Deterministic. A chessboard is asked for whole in
 * the image, of other targets at least 60 % of the points. `options` may be NULL. Of rigs of many cameras,
 * the images of the four worst are searched. */
TD_API td_status td_next_view_find(td_next_view *view, const td_calibration *calibration,
                                   const td_observations *observations, const td_next_view_options *options,
                                   td_error *error);

#ifdef __cplusplus
}
#endif
#endif
