/* The parts of a drift check: the new views with their poses, the information they hold on the rig, and the
 * figures of pairs. */
#ifndef TELEDIMOS_CALIB_DRIFT_INTERNAL_H
#define TELEDIMOS_CALIB_DRIFT_INTERNAL_H

#include "calib/bundle_internal.h"
#include "calib/drift.h"

/* New views of a rig that is held; poses and the board's warp are fitted. */
typedef struct td_drift_views {
    td_observations *observations; /* cameras in the rig's order */
    td_bundle bundle;
    td_board_error board; /* as the views show it when the rig may follow them */
} td_drift_views;

/* drift_views.c */
td_status td_drift_views_make(td_drift_views *views, const td_rig *rig, const td_observations *observations,
                              td_error *error);
void td_drift_views_free(td_drift_views *views);
/* Finds outliers and, unless `noise_px` is given, the noise: both from what is left of the residuals when the
 * rig may follow them. */
td_status td_drift_views_settle(td_drift_views *views, const td_drift_options *options, td_error *error);

/* One point's residual by everything it depends on. */
enum { TD_DRIFT_OWN = TD_CAMERA_MAX_PARAMETERS + 6 };
typedef struct td_drift_row {
    double r[2], variance; /* px, px^2 of each coordinate */
    size_t first, count;   /* columns of the rig's parameters: its camera and that camera's pose */
    double own[2][TD_DRIFT_OWN], warp[2][2], view[2][6];
    double point[2][3]; /* by the point in the board's frame */
} td_drift_row;
bool td_drift_row_make(td_drift_row *row, const td_bundle *bundle, size_t view, int camera, size_t point);

/* What the views say of a change delta of the rig's n parameters once poses and warp follow it: -1/2 delta^T
 * a delta - g^T delta. */
typedef struct td_drift_normal {
    size_t n;
    double *a, *g, *scale; /* (n,n), (n), (n) diagonal before poses and warp follow */
    bool *seen;            /* (pose_count) */
    double *inverse;       /* (pose_count,6,6) of a pose's own information */
    double *follow;        /* (pose_count,6,n+2) a pose follows rig and warp by minus this … */
    double *start;         /* (pose_count,6) … from minus this */
    double warp_follow[2 * TD_RIG_MAX_CAMERAS * TD_DRIFT_OWN], warp_start[2];
    size_t rows, nuisances; /* nuisances: parameters of poses and warp */
} td_drift_normal;

/* Over the points in use of the cameras whose bit is set. */
td_status td_drift_normal_make(td_drift_normal *normal, const td_bundle *bundle, unsigned cameras,
                               td_error *error);
void td_drift_normal_free(td_drift_normal *normal);
/* Derivative (2,n) of a residual by the rig's parameters when its pose and the warp follow. */
void td_drift_row_follow(double *j, const td_drift_row *row, const td_drift_normal *normal, size_t pose);

/* drift_pair.c */
td_status td_drift_pair_measure(td_drift_pair *pair, const td_drift_views *views, const td_rig *rig,
                                int second, td_error *error);

#endif
