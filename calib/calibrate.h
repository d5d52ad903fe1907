/* Calibrates the cameras of a rig and their relative poses from views of a target, and says how far to trust
 * it.
 *
 * First estimates for each camera alone, then one joint least-squares problem over all cameras, views and the
 * board's warp. By default: a robust pass finds outlying corners and views, which are named and left out; the
 * rest is solved by plain least squares weighted by each point's own sigma and a common noise estimated from
 * the residuals; the warp is kept when it is significant; every figure has its covariance. */
#ifndef TELEDIMOS_CALIB_CALIBRATE_H
#define TELEDIMOS_CALIB_CALIBRATE_H

#include "../core/rig.h"
#include "first_estimate.h"
#include "observations.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_TEXT_SIZE = 320 };

/* What may be held of a camera at the values of a known rig, as bits. */
enum { TD_HOLD_INTRINSICS = 1, TD_HOLD_DISTORTION = 2, TD_HOLD_POSE = 4 };

typedef enum td_warp_choice { TD_WARP_AUTO, TD_WARP_OFF, TD_WARP_ON } td_warp_choice;

typedef struct td_calibrate_options {
    td_estimate_method method;
    bool plain;          /* no outlier rejection, no warp, plain pixels: OpenCV's and mrcal's least squares */
    td_warp_choice warp; /* AUTO: kept when significant at 99.9 % */
    double outlier_sigma; /* corners farther out than this many robust standard deviations are left out; 5 */
    double outlier_view;  /* views whose RMS exceeds this many times their camera's median; 3 */
    const td_rig *known;  /* values (and covariance) of what is held; may be NULL */
    unsigned hold[TD_RIG_MAX_CAMERAS]; /* of camera i, TD_HOLD_… */
    bool leave_one_out;                /* default true */
    int threads;                       /* 0: one per processor */
    const td_progress *progress;
    const td_log *log;
} td_calibrate_options;

TD_API td_calibrate_options td_calibrate_options_default(void);
TD_API td_status td_calibrate_options_check(const td_calibrate_options *options,
                                            const td_observations *observations, td_error *error);

typedef enum td_view_state {
    TD_VIEW_UNSEEN, /* no target found in any image */
    TD_VIEW_USED,
    TD_VIEW_OUTLIER,  /* left out whole */
    TD_VIEW_CORRECTED /* used after its numbering was put right */
} td_view_state;

typedef struct td_calibrated_view {
    td_view_state state;
    char remark[TD_TEXT_SIZE]; /* why it is an outlier, what was corrected; "" */
    td_pose rig_from_target;
    double sigma[6];                   /* of the pose, 3 rad then 3 m (pose.h's perturbation); NaN: unknown */
    double rms_px[TD_RIG_MAX_CAMERAS]; /* over all seen points, used or not; NaN: camera saw nothing */
    size_t points[TD_RIG_MAX_CAMERAS], outliers[TD_RIG_MAX_CAMERAS];
} td_calibrated_view;

typedef struct td_calibrated_camera {
    double rms_px;      /* over used points: sqrt(sum |r|^2 / points) */
    double mono_rms_px; /* of the camera calibrated alone */
    size_t views, points, outlier_points;
    double noise_px; /* standard deviation common to its points, beyond their own sigma */
    double sigma[TD_CAMERA_MAX_PARAMETERS]; /* NaN: unknown */
} td_calibrated_camera;

/* Two cameras of the rig: `second` relative to `first`. */
typedef struct td_calibrated_pair {
    int first, second;
    td_pose second_from_first;
    double rms_px; /* over both cameras' used points */
    double baseline_m, sigma_baseline_m;
    double rotation_rad,
        sigma_rotation_rad[3]; /* relative rotation's angle; sigma of its perturbation about x, y, z */
    double essential[9], fundamental[9]; /* row-major; x2^T F x1 = 0 in undistorted pixels */
    double epipolar_error_px; /* mean over point pairs of the distances to both epipolar lines, added (as
                                 OpenCV's stereo_calib sample prints it) */
    size_t pairs;             /* views that both saw */
} td_calibrated_pair;

typedef struct td_leave_one_out {
    size_t views; /* held out in turn; 0: not done */
    size_t folds;
    double rms_px;          /* of held-out views against cameras solved without them */
    double scale_error;     /* mean relative error of triangulated target size; NaN: no pair */
    double scale_error_rms; /* over the views */
    double flatness_m;      /* RMS distance of triangulated points from the target after the best fit */
} td_leave_one_out;

/* What the board does wrong and all cameras see alike, estimated from the residuals: RMS along one axis. */
typedef struct td_board_error {
    bool significant; /* false: nothing is found, and all below are 0 but noise_share */
    double print_m;   /* each point's own place, the same in all views: along x, y and z */
    double bend_m;    /* anew in each view: the sheet bends along its normal, degree 2 and 3 over the board */
    double stretch_m; /* it stretches or shears in its plane, degree 1 */
    double ripple_m;  /* and degree 2 and 3 */
    double noise_share; /* of the points' variance by noise_px and their own sigma, that is theirs alone */
    double gain;        /* twice the log of the likelihood ratio against none */
} td_board_error;

/* A direction in the parameters that the views hardly determine. */
typedef struct td_weak_direction {
    char text[TD_TEXT_SIZE]; /* what cannot be told apart, and what to do */
    double severity;         /* 1: at the limit of what is tolerated */
} td_weak_direction;

enum { TD_MAX_WEAK = 8 };

typedef struct td_calibration {
    td_rig *rig; /* with its joint covariance */
    td_calibrated_camera camera[TD_RIG_MAX_CAMERAS];
    size_t view_count;
    td_calibrated_view *view; /* (views) */
    double *residual;         /* (views,cameras,points,2) px, projected minus seen; NaN: not seen */
    uint8_t *used;            /* (views,cameras,points) */
    size_t pair_count;        /* each camera with the first */
    td_calibrated_pair pair[TD_RIG_MAX_CAMERAS];
    bool has_warp;
    double warp_m[2], sigma_warp_m[2];
    td_board_error board; /* counted in every covariance and sigma; none when plain */
    double chi2_per_dof;  /* weighted residuals */
    double rms_px;        /* over all used points */
    td_leave_one_out leave_one_out;
    size_t weak_count;
    td_weak_direction weak[TD_MAX_WEAK];
    unsigned hold[TD_RIG_MAX_CAMERAS]; /* of camera i, what was held: TD_HOLD_… */
    bool own_sigma;                    /* each point's own sigma counted beside noise_px (not when plain) */
    bool covariance_known;     /* false: something held has no covariance, sigmas are given its value */
    td_estimate_method method; /* what AUTO chose */
    int iterations;
} td_calibration;

/* Calibrates. TD_ERROR_DATA with one sentence when the views do not suffice. */
TD_API td_status td_calibrate(td_calibration **calibration, const td_observations *observations,
                              const td_calibrate_options *options, td_error *error);
TD_API void td_calibration_free(td_calibration **calibration);

#ifdef __cplusplus
}
#endif
#endif
