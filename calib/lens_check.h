/* Has a lens that is said to have no distortion some after all? */
#ifndef TELEDIMOS_CALIB_LENS_CHECK_H
#define TELEDIMOS_CALIB_LENS_CHECK_H

#include "../core/rig.h"
#include "observations.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_LENS_TERMS = 2 };

typedef struct td_lens_check {
    int terms;                        /* radial terms that the views tell of: 0, 1 (k1) or 2 (k1, k2) */
    td_camera camera;                 /* as given; with terms, a brown5 that has them */
    double sigma[TD_LENS_TERMS];      /* of k1 and k2: the larger of the residuals' and the jackknife's */
    double rms_px[TD_LENS_TERMS + 1]; /* sqrt(sum |r|^2 / points) with 0, 1, 2 terms; NaN: not fitted */
    double
        held_out_px[TD_LENS_TERMS + 1]; /* of views held out in turn, each in the pose that suits it best */
    char text[320];                     /* what was found, a sentence */
} td_lens_check;

/* For a camera of the rig with known focal lengths and centre but no distortion, as drivers of robots'
 * cameras publish it: estimates k1, then k1 and k2, with the intrinsics held and each view's pose free, and
 * judges both by views held out in turn (at most 10 groups). A lens is taken where it predicts these better
 * than the simpler one by three standard errors over the views. Cameras are matched by name. Terms stay 0 for
 * cameras with distortion of their own and for fewer than 6 views of 4 points or more. TD_ERROR_DATA when no
 * view has a pose. */
TD_API td_status td_lens_check_make(td_lens_check *check, const td_rig *rig, int camera,
                                    const td_observations *observations, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
