/* Ways in which a person can hold a board before a camera. */
#ifndef TELEDIMOS_CALIB_PLACEMENT_INTERNAL_H
#define TELEDIMOS_CALIB_PLACEMENT_INTERNAL_H

#include "calib/calibrate.h"

typedef enum td_tilt { TD_TILT_NONE, TD_TILT_RIGHT, TD_TILT_LEFT, TD_TILT_UP, TD_TILT_DOWN } td_tilt;
enum { TD_TILT_COUNT = 5 };

typedef struct td_placement {
    int camera;
    int across, down; /* -1, 0, 1: left, middle, right; top, middle, bottom of the image */
    int distance;     /* 0, 1, 2: close by, between, far off */
    double distance_m;
    td_tilt tilt;
    int tilt_deg;
    bool turned; /* by a quarter */
    td_pose rig_from_target;
} td_placement;

/* Where a camera sees a board: the board's extent in its own frame. */
typedef struct td_board_shape {
    const td_target *target;
    double lower[3], upper[3]; /* over its points, m */
    double edge_m;             /* from the outermost points to the board's edge */
    bool whole;                /* is found only as a whole */
    size_t points, step;       /* every step-th point stands for all where many poses are tried */
} td_board_shape;

td_board_shape td_board_shape_of(const td_target *target);

/* Whether a camera would find the board: all of a chessboard with half a square around, or 60 % of the
 * points. */
bool td_board_is_seen(const td_board_shape *shape, const td_rig_camera *camera,
                      const td_pose *rig_from_target);

/* Board facing, tilted and turned as told, its centre on the camera's ray through `pixel`. False: no ray. */
bool td_placement_at(td_pose *rig_from_target, const td_board_shape *shape, const td_rig_camera *camera,
                     const td_placement *placement, const double pixel[2]);

/* Fills rig_from_target: the board pushed as far to its place as the camera still sees it. False when it does
 * not fit there. */
bool td_placement_fit(td_placement *placement, const td_board_shape *shape, const td_rig_camera *camera);

/* Distance at which the board fills a share of the image, in the direction that it fills first, m. */
double td_filling_distance(const td_board_shape *shape, const td_camera *camera, double share);

/* The board's outer corners in the camera's image. */
void td_placement_outline(double outline[8], const td_board_shape *shape, const td_rig_camera *camera,
                          const td_pose *rig_from_target);

/* The sentence; `camera_name` may be NULL when there is only one. */
void td_placement_words(char text[TD_TEXT_SIZE], const td_placement *placement, const char *camera_name);

#endif
