/* What a dataset of camera-to-vehicle calibration says of the arm: robot, points and boards on its links.
 *
 *   robot:
 *     urdf: machine.urdf      # core/robot.h; its cylinders and limits from machine.yaml beside it
 *     joints: angles.csv      # a row for each frame: `frame`, then a column a joint: boom_rad, boom_deg, for
 *                             # one that slides boom_m, boom_mm; or its cylinder's length: boom_cylinder_m
 *     mount: cab              # link that carries the rig
 *     vehicle: undercarriage  # link whose frame is the vehicle's (default: the mount)
 *     tip: bucket_tip         # link whose origin is the tool's tip (default: the last one)
 *     sigma_deg: 0.05         # of one reading; or {boom: 0.05, arm: 0.1}, the others as by default
 *     sigma_mm: 1             # the same of joints that slide
 *     link: stick             # that carries the target of `target_poses` (kinematic calibration)
 *   sights: sights.csv        # points found in images: frame, camera, point, x_px, y_px, optional sigma_px
 *   sigma_px: 0.5             # of sights without their own (default 0.5)
 *   points:
 *     - {name: pin, link: stick, place_m: [0.35, null, 0.1], sigma_m: 0.002}    # null: unknown
 *   boards:                   # found in the images of frames.csv; cameras are then needed
 *     - {name: plate, link: stick, target: {kind: aprilgrid, …},
 *        link_from_target: {q: [w, x, y, z], t_m: [x, y, z]}, sigma_mm: 1, sigma_deg: 0.1}
 *
 * sigma_m of a point is one length or three; without it (or 0) the place is exact. A board without
 * link_from_target may be anywhere on its link; without sigmas its pose is exact. A link that is the robot's
 * root stands on the ground. */
#ifndef TELEDIMOS_CORE_DATASET_ARM_H
#define TELEDIMOS_CORE_DATASET_ARM_H

#include <stdbool.h>

#include "rig.h"
#include "robot.h"
#include "target.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_DATASET_MAX_POINTS = 64, TD_DATASET_MAX_BOARDS = 4 };

typedef struct td_dataset_point {
    char name[TD_NAME_SIZE], link[TD_NAME_SIZE];
    double place_m[3]; /* NaN: unknown */
    double sigma_m[3]; /* 0: exact; INFINITY: unknown */
} td_dataset_point;

typedef struct td_dataset_board {
    char name[TD_NAME_SIZE], link[TD_NAME_SIZE];
    td_target target;
    bool placed; /* link_from_target is given */
    td_pose link_from_target;
    double sigma_rad, sigma_m; /* 0: exact */
} td_dataset_board;

/* Standard deviation of one reading of the joints: of all, and of those that are named. */
typedef struct td_dataset_sigma {
    double all; /* rad or m */
    int count;
    char joint[TD_ROBOT_MAX_JOINTS][TD_NAME_SIZE];
    double sigma[TD_ROBOT_MAX_JOINTS];
} td_dataset_sigma;

typedef struct td_dataset_arm {
    char *urdf, *joints, *sights; /* paths; NULL: not given */
    char mount[TD_NAME_SIZE], vehicle[TD_NAME_SIZE], tip[TD_NAME_SIZE], link[TD_NAME_SIZE]; /* "" */
    td_dataset_sigma angle, slide;
    double sigma_px;
    int point_count, board_count;
    td_dataset_point point[TD_DATASET_MAX_POINTS];
    td_dataset_board board[TD_DATASET_MAX_BOARDS];
} td_dataset_arm;

#ifdef __cplusplus
}
#endif
#endif
