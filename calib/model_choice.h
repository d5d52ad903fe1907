/* Is another lens model worth it: each is judged by views that it has not seen. */
#ifndef TELEDIMOS_CALIB_MODEL_CHOICE_H
#define TELEDIMOS_CALIB_MODEL_CHOICE_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_model_score {
    td_camera_model model;
    bool failed;        /* no calibration with this model */
    double rms_px;      /* over the views used to fit */
    double held_out_px; /* over views held out in turn */
    double sigma_px;    /* standard error of held_out_px less the chosen model's, over the views */
} td_model_score;

typedef struct td_model_choice {
    int camera;
    /* best: the simplest within one standard error of the least, in the order pinhole; brown5 and fisheye
     * (the better one); brown8 */
    td_camera_model present, best;
    td_model_score score[TD_CAMERA_MODEL_COUNT];
    /* "left: brown5 is enough: brown8 predicts held-out views no better (0.174 …)" */
    char text[TD_TEXT_SIZE];
} td_model_choice;

/* For one camera alone, over the views and points it used in `calibration` (which were chosen under the
 * present model: a few points that only another model would explain may be among its outliers). Every model
 * is fitted anew without each of at most 10 groups of views; every second point of a view held out then gives
 * it its pose and the others judge it, and the other way round. Models that cannot be fitted are marked
 * failed. TD_ERROR_DATA below 4 views of 12 points. `options` (NULL: defaults): what the calibration was made
 * with. */
TD_API td_status td_model_choice_make(td_model_choice *choice, int camera, const td_calibration *calibration,
                                      const td_observations *observations,
                                      const td_calibrate_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
