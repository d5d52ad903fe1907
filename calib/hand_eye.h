/* Hand-eye calibration: where the cameras sit (X) and where the target stands (Z), from robot poses and what
 * the cameras saw.
 *
 *   eye-in-hand, robot-world:
 *       base_from_hand X rig_from_target = Z,    X = hand_from_rig, Z = base_from_target
 *   eye-to-hand:
 *       X rig_from_target = base_from_hand Z,    X = base_from_rig, Z = hand_from_target
 *
 * Both sides are measured: the target's pose in the rig with the covariance that its points give it, and the
 * robot's pose with noise at the hand, base_from_hand (true) = base_from_hand (said) Exp(d), whose standard
 * deviations in rotation and translation are estimated with X and Z (restricted maximum likelihood: Patterson
 * and Thompson 1971; of few views with a weak prior that binds one to the other by an arm of 0.3 m within a
 * factor e^2). To them a smooth error field over the working space may be added: a Gaussian process (Matern
 * 3/2) in the base's axes, a function of the hand's position. Plain least squares, which takes the robot to
 * be exact, bends X where the robot is not.
 *
 * Views that do not belong to the others are left out, a third at most, and named. */
#ifndef TELEDIMOS_CALIB_HAND_EYE_H
#define TELEDIMOS_CALIB_HAND_EYE_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/log.h"
#include "../core/pose.h"
#include "../core/progress.h"
#include "../core/rig.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_hand_eye_setup {
    TD_EYE_IN_HAND,
    TD_EYE_TO_HAND,
    TD_ROBOT_WORLD,
    TD_HAND_EYE_SETUP_COUNT
} td_hand_eye_setup;

/* "eye-in-hand", …; the names of X and Z: "hand_from_rig", "base_from_target", … */
TD_API const char *td_hand_eye_setup_name(td_hand_eye_setup setup);
TD_API const char *td_hand_eye_x_name(td_hand_eye_setup setup);
TD_API const char *td_hand_eye_z_name(td_hand_eye_setup setup);

typedef enum td_robot_model {
    TD_ROBOT_EXACT,       /* plain least squares, weighted by what the cameras saw alone: sigmas are too
                             small by far where the robot is not exact */
    TD_ROBOT_INDEPENDENT, /* independent noise at the hand */
    TD_ROBOT_FIELD,       /* and a smooth error field; above 200 views as INDEPENDENT, with a warning */
    /* INDEPENDENT, or from 10 views on FIELD, when it lowers the restricted -2 log L by more than Schwarz's
     * 3 log(6 n - 12): noise alone does so once in hundreds. */
    TD_ROBOT_AUTO
} td_robot_model;

typedef struct td_hand_eye_view {
    char name[TD_NAME_SIZE];
    td_pose base_from_hand;  /* as the robot said */
    td_pose rig_from_target; /* as the cameras saw */
    double covariance[36];   /* of rig_from_target (pose.h's perturbation) */
} td_hand_eye_view;

typedef struct td_hand_eye_options {
    td_hand_eye_setup setup;
    td_robot_model model; /* default AUTO */
    bool free_scale;      /* also estimate the target's scale (told anyway when it is off) */
    double outlier_sigma; /* views farther out than this, as the equivalent of a normal deviate; 0: none left
                             out; default 4 */
    bool leave_one_out;   /* default true */
    const td_pose *start; /* (2) X, Z to begin from; NULL: a closed form */
    int threads;          /* not used so far: a solve takes milliseconds */
    const td_progress *progress;
    const td_log *log;
} td_hand_eye_options;
TD_API td_hand_eye_options td_hand_eye_options_default(td_hand_eye_setup setup);

/* What became of one view. */
typedef struct td_hand_eye_fit {
    bool used;
    char remark[320];   /* why it was left out; "" */
    double residual[6]; /* at the hand: rad, m; what the robot would have to be wrong by */
    double target_mm,
        target_deg; /* of the predicted pose against the seen one: the target's origin, its turn */
    double deviate; /* the view's distance from where the others put it, as a normal deviate */
    /* rig_from_target predicted from the robot's pose, with X and Z of all used views. Predictions are in the
     * target's given size, as what was seen, even when the scale is free. */
    td_pose predicted;
    td_pose held_out; /* the same from X and Z of the other views (with the field: conditional on them) */
    double held_out_mm, held_out_deg;
} td_hand_eye_fit;

typedef struct td_hand_eye {
    td_hand_eye_setup setup;
    td_robot_model model; /* that was used */
    td_pose x, z;
    double covariance[144];                                  /* (12,12) of the perturbations of X, then Z */
    double sigma_x_mm, sigma_x_deg, sigma_z_mm, sigma_z_deg; /* of the origin's and the turn's worst axis */
    double robot_m, robot_rad;                 /* sigma per axis of the robot's noise at the hand; 0: exact */
    double sigma_robot_m, sigma_robot_rad;     /* and how well they are known */
    double field_m, field_rad, field_length_m; /* sigma per axis of the field and its correlation length; 0 */
    double log_likelihood[3]; /* restricted, the prior's term included, of each model that was tried; NaN */
    /* Of the target: true size over given size, estimated beside X and Z; NaN: 3 views. Bound to X along the
     * line of sight where the motions are small, as its sigma tells. */
    double scale, sigma_scale;
    size_t view_count, used;
    td_hand_eye_fit *view;            /* (views) */
    double held_out_mm, held_out_deg; /* RMS over the used views; NaN */
    size_t weak_count;
    char weak[8][320]; /* directions of X and Z that the motion leaves open, in words, and what to do */
} td_hand_eye;

/* TD_ERROR_DATA with one sentence when the motion determines nothing: too few views, no rotation, parallel
 * axes, repeated poses. */
TD_API td_status td_hand_eye_solve(td_hand_eye **result, const td_hand_eye_view *view, size_t count,
                                   const td_hand_eye_options *options, td_error *error);
TD_API void td_hand_eye_free(td_hand_eye **result);

/* rig_from_target as X, Z and the robot's pose say. */
TD_API td_pose td_hand_eye_predict(td_hand_eye_setup setup, const td_pose *x, const td_pose *z,
                                   const td_pose *base_from_hand);

/* The robot's pose that would help most: of the candidates (hand poses reached so far, turned about the
 * hand's axes by up to 40 degrees), the one that reduces the uncertainty of X most. */
typedef struct td_hand_eye_advice {
    td_pose base_from_hand;
    double sigma_x_mm, sigma_x_deg; /* predicted with it */
    char text[320];                 /* "from view 3 turn the hand by 35 degrees about its x axis" */
} td_hand_eye_advice;
TD_API td_status td_hand_eye_advise(td_hand_eye_advice *advice, const td_hand_eye *result,
                                    const td_hand_eye_view *view, size_t count, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
