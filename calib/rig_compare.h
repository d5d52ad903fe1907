/* Two rigs of the same cameras: how far apart their images of the world are, and whether that is more than
 * their covariances allow. */
#ifndef TELEDIMOS_CALIB_RIG_COMPARE_H
#define TELEDIMOS_CALIB_RIG_COMPARE_H

#include "../core/rig.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_COMPARE_COLUMNS = 24, TD_COMPARE_ROWS = 18 };

/* The difference of one camera's projections after the best common rotation and translation of its frame
 * (mrcal's "projection diff": what a camera's intrinsics mean is fixed only up to those; at infinity rotation
 * only). Where both covariances are known each part of the image counts by how well it is known. */
typedef struct td_compared_camera {
    char name[TD_NAME_SIZE];
    double distance_m;                                             /* at which it is measured */
    double difference_px[TD_COMPARE_ROWS * TD_COMPARE_COLUMNS][2]; /* b minus a; NaN: no ray */
    double expected_px[TD_COMPARE_ROWS *
                       TD_COMPARE_COLUMNS];   /* RMS length, from both covariances; NaN: unknown */
    double rms_px, most_px, rms_mm;           /* mm: at distance_m; NaN at infinity */
    double rotation_rad[3], translation_m[3]; /* a_from_b of the camera's frame */
    double sigma_px;      /* predicted RMS of the difference from both covariances; NaN: unknown */
    double chi2, p_value; /* of the lens parameters (of the projections, where models differ) */
    int degrees;
} td_compared_camera;

/* A pair's relative pose, b against a. */
typedef struct td_compared_pair {
    int first, second;
    double rotation_rad[3], sigma_rotation_rad[3];
    double translation_m[3], sigma_translation_m[3];
    double baseline_m, sigma_baseline_m; /* difference of lengths */
    double p_value;
} td_compared_pair;

typedef struct td_rig_compare {
    int camera_count;
    td_compared_camera camera[TD_RIG_MAX_CAMERAS];
    int pair_count;
    td_compared_pair pair[TD_RIG_MAX_CAMERAS];
    double p_value; /* of all together: joint chi-square over what both rigs determine */
    bool significant;
    char text[320];
} td_rig_compare;

/* Cameras are matched by name (by order when no name is shared). distance_m: the working distance, > 0 or
 * INFINITY. The covariances are taken to be independent. Where all models are equal, p_value is that of the
 * difference of all parameters, joint, in the directions that have a variance; where they differ, of all
 * projections together with how the cameras' frames that explain them best stand to each other. */
TD_API td_status td_rig_compare_run(td_rig_compare *compare, const td_rig *a, const td_rig *b,
                                    double distance_m, double p_limit, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
