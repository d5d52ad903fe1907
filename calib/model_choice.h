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
    td_camera_model present, best; /* best: the simplest within one standard error of the least */
    td_model_score score[TD_CAMERA_MODEL_COUNT];
    char
        text[TD_TEXT_SIZE]; /* "left: brown5 is enough: brown8 predicts held-out views no better (0.174 …)" */
} td_model_choice;

/* For one camera, over the views it used, on the points in use. Models that cannot be compared (pinhole to
 * fisheye is allowed) are marked failed. */
TD_API td_status td_model_choice_make(td_model_choice *choice, int camera, const td_calibration *calibration,
                                      const td_observations *observations,
                                      const td_calibrate_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
