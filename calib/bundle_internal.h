/* The joint problem over all cameras, views and the board's warp. */
#ifndef TELEDIMOS_CALIB_BUNDLE_INTERNAL_H
#define TELEDIMOS_CALIB_BUNDLE_INTERNAL_H

#include <stdint.h>

#include "calib/calibrate.h"
#include "core/least_squares.h"
#include "core/rig.h"

/* State and selection; the numbers that a solve changes are rig, rig_from_target and warp. Arrays are owned.
 */
typedef struct td_bundle {
    const td_observations *observations;
    td_rig *rig;
    size_t pose_count;
    size_t *pose_of_view;     /* (views) views of known heights share one pose */
    td_pose *rig_from_target; /* (pose_count) */
    bool use_warp;
    double warp[2]; /* m: bulge along x and y, see td_bundle_target_point */
    uint8_t *used;  /* (views,cameras,points) */
    double *shift;  /* (views,cameras,points,2) px, added to the projection: bias of marks; NULL: none */
    double noise[TD_RIG_MAX_CAMERAS]; /* px; a residual is divided by it, starts as 1 */
    bool own_sigma;                   /* each point's own sigma is added to the noise in quadrature */
    double noise_share; /* of each point's variance, that is its own; the rest is the board's (board_error) */
    unsigned hold[TD_RIG_MAX_CAMERAS];
} td_bundle;

/* Every point seen of every view is used; poses are identities; nothing is held; noise is 1 px. */
td_status td_bundle_init(td_bundle *bundle, const td_observations *observations, td_error *error);
td_status td_bundle_copy(td_bundle *copy, const td_bundle *bundle, td_error *error);
void td_bundle_free(td_bundle *bundle);

static inline size_t td_bundle_index(const td_bundle *b, size_t view, int camera, size_t point)
{
    return (view * (size_t)b->observations->camera_count + (size_t)camera) *
               td_target_point_count(&b->observations->target) +
           point;
}

/* Point of the board as it stands in a view: nominal, warped by w0 (1 - x'^2) + w1 (1 - y'^2) along z with
 * x', y' from -1 to 1 over the board (mrcal's model), and moved by the view's height. */
void td_bundle_target_point(double p[3], const td_bundle *bundle, size_t view, size_t point);

/* 1 - x'^2 and 1 - y'^2 of a point of a flat target. */
void td_bundle_warp_shape(double shape[2], const td_target *target, size_t point);

/* Residual (2) px, projected minus seen; false when the point has no projection. */
bool td_bundle_residual(double r[2], const td_bundle *bundle, size_t view, int camera, size_t point);
/* Used points of a camera in a view; of a view in all cameras. */
size_t td_bundle_used(const td_bundle *bundle, size_t view, int camera);
/* Takes a camera's points of a view out of use. */
void td_bundle_drop(td_bundle *bundle, size_t view, int camera);
/* Sum of squared pixel residuals over used points of one camera (-1: all), and their number. */
double td_bundle_square_sum(const td_bundle *bundle, int camera, size_t *points);

/* The numbers of the blocks in the problem that td_bundle_problem built; -1 where there is none. */
typedef struct td_bundle_blocks {
    int camera[TD_RIG_MAX_CAMERAS];
    int pose[TD_RIG_MAX_CAMERAS]; /* camera_from_rig; -1 for the first */
    int warp;
    int *view; /* (pose_count) */
} td_bundle_blocks;

typedef struct td_bundle_problem {
    td_problem *problem;
    td_bundle_blocks blocks;
    void *terms;
} td_bundle_problem;

/* `loss` may be NULL; its scale is in residuals, that is in pixels over noise. */
td_status td_bundle_problem_new(td_bundle_problem *problem, td_bundle *bundle, const td_loss *loss,
                                td_error *error);
void td_bundle_problem_free(td_bundle_problem *problem);
/* Builds, solves, frees. */
td_status td_bundle_solve(td_bundle *bundle, const td_loss *loss, td_solve_summary *summary,
                          const td_solve_options *options, td_error *error);
/* Refines the pose of one view alone, all else held. */
td_status td_bundle_solve_view(td_bundle *bundle, size_t view, const td_loss *loss, td_error *error);

/* A calibration taken up where it ended: its last problem and that problem's covariance. Must not be moved.
 */
typedef struct td_bundle_result {
    td_observations
        *observations; /* as the calibration numbered them, the marks' shift taken off the points */
    td_bundle bundle;
    td_bundle_problem problem;
    td_covariance *covariance;
    size_t board_count; /* poses of boards that were solved for */
    int *board;         /* (board_count) their blocks */
} td_bundle_result;

/* `observations` are those that were calibrated. What was held brings the covariance that it was given. */
td_status td_bundle_result_new(td_bundle_result *result, const td_calibration *calibration,
                               const td_observations *observations, td_error *error);
void td_bundle_result_free(td_bundle_result *result);

#endif
