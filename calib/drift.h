/* Has a calibrated rig drifted? New views of a target against what the rig's covariance predicts; no solve of
 * the cameras, only each view's pose. */
#ifndef TELEDIMOS_CALIB_DRIFT_H
#define TELEDIMOS_CALIB_DRIFT_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_drift_camera {
    size_t views, points;
    double rms_px;       /* sqrt(sum |r|^2 / points), every view at its own pose */
    double noise_px;     /* the same as the points' noise alone would give it */
    double predicted_px; /* noise and the rig's covariance together; NaN without covariance */
    double p_value;      /* of residuals this large were the rig unchanged; NaN without covariance */
} td_drift_camera;

typedef struct td_drift_pair {
    int first, second;
    size_t views, points;
    double epipolar_px, predicted_epipolar_px; /* RMS distance from the epipolar line in the second image */
    double vertical_px, sigma_vertical_px;     /* its mean with sign: what a turned camera shows first */
    double scale_error, sigma_scale_error;     /* of the triangulated target; fraction */
    double p_value;
} td_drift_pair;

typedef struct td_drift {
    td_drift_camera camera[TD_RIG_MAX_CAMERAS];
    size_t pair_count;
    td_drift_pair pair[TD_RIG_MAX_CAMERAS]; /* each camera with the first */
    double p_value; /* of all together: of the generalised chi-square of the part of the residuals that the
                       rig's parameters can explain */
    double drift_sigma; /* the same as a number of standard deviations */
    bool drifted;       /* p_value below the limit */
    bool covariance_known;
    char text[TD_TEXT_SIZE]; /* "fine: …", or "drifted: right has turned by 0.12 ± 0.01 degrees about y …" */
} td_drift;

typedef struct td_drift_options {
    double p_limit;   /* default 1e-3 */
    double noise_px;  /* of every coordinate; 0: the points' own sigmas and, common to a camera, what the
                         residuals that no rig can explain show beside them */
    double *residual; /* out: (views, cameras of the rig, points, 2) px, projected minus seen; NaN: not seen
                         or left out; NULL: not wanted */
    const td_progress *progress;
} td_drift_options;

TD_API td_drift_options td_drift_options_default(void);
/* Cameras are matched by name. Outlying points and views are left out, judged by what remains when the rig
 * may follow the views. A bulge of the board is fitted along with the poses. The views must not be those that
 * the rig was calibrated from: their errors are in the rig too, and it would pass too easily. */
TD_API td_status td_drift_measure(td_drift *drift, const td_rig *rig, const td_observations *observations,
                                  const td_drift_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
