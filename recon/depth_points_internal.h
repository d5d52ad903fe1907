/* What depth_points.c, depth_error.c and fusion share: the insides of a depth camera. */
#ifndef TELEDIMOS_RECON_DEPTH_POINTS_INTERNAL_H
#define TELEDIMOS_RECON_DEPTH_POINTS_INTERNAL_H

#include "depth_points.h"

/* The grid of calibration error: columns and rows over the rectified left image, levels over inverse depth.
 */
enum { TD_DEPTH_GRID_COLUMNS = 13, TD_DEPTH_GRID_ROWS = 11, TD_DEPTH_GRID_LEVELS = 7 };

/* Where a rectified pixel comes from: the upper left of four neighbours, and the way to the others in 1/256
 * px. */
typedef struct td_depth_source {
    uint32_t first; /* pixel's index; UINT32_MAX: not seen */
    uint16_t right, down;
} td_depth_source;

struct td_depth_camera {
    const td_rig *rig;
    int left, right;
    td_rectification rectification;
    td_pose rig_from_rectified; /* of the left camera */
    double near_m, far_m;
    double f, cx, cy, base_px_m; /* disparity = base_px_m / depth */
    td_depth_source *source[2];  /* (height,width) */
    float *error; /* (levels, rows, columns, 6): covariance of (da, db, dq); NULL: the rig has none */
};

/* Fills camera->error from the rig's covariance. */
td_status td_depth_error_grid(td_depth_camera *camera, td_error *error);

/* Covariance (m^2, xx xy xz yy yz zz, rig's frame) that the calibration gives the point which rectified left
 * pixel (x, y) sees at `depth`. NaN: the rig has none. */
void td_depth_error_at(double covariance[6], const td_depth_camera *camera, double x, double y, double depth);

#endif
