/* A dataset: which cameras, which target, which images, in a folder with dataset.yaml and frames.csv.
 *
 *   dataset.yaml                                          frames.csv
 *     name: opencv-stereo                                   frame,left,right
 *     root: ${TELEDIMOS_DATA}/set    # folder of images,    01,left01.jpg,right01.jpg
 *                                    # default: this one    02,left02.jpg,
 *     target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}
 *     cameras:
 *       - {name: left, model: brown5}
 *       - {name: right, model: brown5}
 *     expect: {baseline_m: 0.083, tolerance_m: 0.002}     # optional: what a tape measure says
 *
 * Optional besides: about (free text), frames (name of the table, default frames.csv), corners (a CSV of
 * points found elsewhere). ${NAME} in root and corners is replaced by that environment variable; relative
 * paths begin at the dataset's folder. The target is described in README; core/target.h says what may be in
 * it.
 *
 * Of hand-eye sets besides (poses belong to the frames in their order, or by time when both have times):
 *   robot: {poses: poses.csv, convention: auto, inverted: false, length_unit: m, angle_unit: rad,
 *           scalar_first: false}        # base_from_hand; core/robot_poses.h
 *   rig: camera.xml                     # the cameras' calibration in any format of core/rig_formats.h; with
 * it # the target may be missing: images of a site setup: eye-in-hand                  # or eye-to-hand,
 * robot-world target_poses: {poses: …}            # poses of the target in the rig (rig_from_target) instead
 * of images; # target, cameras and frames.csv are then not needed Of camera-to-vehicle sets: robot: {urdf: …,
 * joints: …}, points, boards, sights; core/dataset_arm.h. Their files are looked for in the dataset's folder,
 * then at root. A file in a zip archive is "set.zip/folder/name".
 *
 * Of reconstructions besides: frames.csv may hold the base's pose (x_m, y_m, z_m, qw, qx, qy, qz:
 * site_from_vehicle; a row without it, or a table without these columns, is located by
 *   site_tags: {target: {kind: tags, …}, sigma_mm: 2, sigma_deg: 0.2}    # tags on the site; target_from_tag
 * is # site_from_tag here or by the ground that it sees).
 *
 * Folders of others are read as they are: EuRoC's (mav0/cam0/…) and Middlebury's pairs (im0, im1, calib.txt).
 *
 * frames.csv: a header; `frame` names the view (optional: else the row's number), a column for each camera
 * (an empty cell: no image), optional `time_s`, optional `height_m` (the board, moved along its own normal to
 * known heights while the cameras stand still: Faugeras-Toscani's target with depth). Other columns are kept
 * out. `teledimos reconstruct` also takes pictures of videos: "left.mp4#120" is the one after 120 others. */
#ifndef TELEDIMOS_CORE_DATASET_H
#define TELEDIMOS_CORE_DATASET_H

#include <stdbool.h>
#include <stddef.h>

#include "camera.h"
#include "dataset_arm.h"
#include "rig.h"
#include "robot_poses.h"
#include "target.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_dataset_camera {
    char name[TD_NAME_SIZE];
    td_camera_model model;
} td_dataset_camera;

typedef struct td_dataset_frame {
    char name[TD_NAME_SIZE];
    double time_s;                   /* NaN: not given */
    double height_m;                 /* NaN: the board was free */
    char *image[TD_RIG_MAX_CAMERAS]; /* whole path of each camera's image; NULL: none */
} td_dataset_frame;

/* Poses in a file; path NULL: there are none. */
typedef struct td_dataset_poses {
    char *path;
    td_robot_poses_options how;
} td_dataset_poses;

typedef struct td_dataset {
    char name[TD_NAME_SIZE];
    char *folder; /* where dataset.yaml lies */
    char *table;  /* path of the frames' table; its rows are the frames */
    td_target target;
    int camera_count;
    td_dataset_camera camera[TD_RIG_MAX_CAMERAS];
    size_t frame_count;
    td_dataset_frame *frame;    /* (frame_count) */
    double expected_baseline_m; /* NaN: not given */
    double expected_tolerance_m;
    char *corners; /* path of a CSV of points found elsewhere (calib/observations.h); NULL: detect */
    td_dataset_poses robot, target_poses;
    char *rig;                                     /* path of the cameras' calibration; NULL: none */
    char setup[16];                                /* "eye-in-hand", …; "": not said */
    td_dataset_arm *arm;                           /* NULL: no arm whose joints are read */
    td_target site_tags;                           /* tags on the site, in its frame; tag_count 0: none */
    double site_tags_sigma_rad, site_tags_sigma_m; /* of each tag's pose */
    /* Of a folder in another's layout: the text that its frames.csv and rig.yaml would hold; else NULL.
     * `table` and `rig` are then names for messages. */
    char *table_text, *rig_text;
} td_dataset;

/* Reads DATASET/dataset.yaml (or the file itself when a path to a .yaml is given) and its frames. Everything
 * is checked, sizes and numbers bounded; images are not opened. */
TD_API td_status td_dataset_read(td_dataset **dataset, const char *path, td_error *error);
/* The same from the text of both files, as if they lay in `folder`. */
TD_API td_status td_dataset_parse(td_dataset **dataset, const char *yaml, size_t yaml_size, const char *csv,
                                  size_t csv_size, const char *folder, td_error *error);
TD_API void td_dataset_free(td_dataset **dataset);

#ifdef __cplusplus
}
#endif
#endif
