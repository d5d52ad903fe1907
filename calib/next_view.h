/* Which picture to take next: the board's pose that reduces the projected uncertainty most. */
#ifndef TELEDIMOS_CALIB_NEXT_VIEW_H
#define TELEDIMOS_CALIB_NEXT_VIEW_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_next_view_options {
    double nearest_m, farthest_m; /* where the board can be held; 0: from the views so far, or from
                                     its size: filling three quarters, and a quarter, of the image */
    double distance_m;            /* where the projected uncertainty counts; 0: the middle board's */
    double enough_px;             /* projected uncertainty that is wished for; 0: no wish */
    double gain_that_counts;      /* a share by which a view must reduce it; default 0.03 */
    double noise_px;              /* before the first calibration; default 0.2 */
    int skip;                     /* better suggestions passed over: the next that differs in place or tilt */
} td_next_view_options;

TD_API td_next_view_options td_next_view_options_default(void);

typedef struct td_next_view {
    td_pose rig_from_target; /* how to hold the board */
    int camera;              /* in whose words and picture it is told */
    double outline[8];   /* px, the board's four outer corners in that camera's image, from its first point
                            on clockwise as the board is read */
    double sigma_px;     /* projected uncertainty now (root mean square over the images' grids) */
    double predicted_px; /* and with this view */
    bool enough;         /* no view gains what counts, or the wish is fulfilled */
    char text[TD_TEXT_SIZE]; /* "hold the board at the lower left, tilted 30 degrees to the right, closer" */
} td_next_view;

/* `calibration` may be NULL while the views are too few: the first ones are then asked for by rule (in the
 * middle and facing, then tilted to each side). Deterministic. */
TD_API td_status td_next_view_find(td_next_view *view, const td_calibration *calibration,
                                   const td_observations *observations, const td_next_view_options *options,
                                   td_error *error);

#ifdef __cplusplus
}
#endif
#endif
