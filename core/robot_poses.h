/* Robot poses in everyone's files and conventions.
 *
 *   csv      a header, then base_from_hand; columns by convention (one of the four), `time_s` and `frame` if
 *            there are any, others are kept out:
 *              quaternion       x_m y_m z_m qw qx qy qz                   (by name, so in either order)
 *              rotation vector  x_m y_m z_m rx_rad ry_rad rz_rad          (axis times angle)
 *              roll-pitch-yaw   x_m y_m z_m roll_rad pitch_rad yaw_rad    (fixed x, y, z: R = Rz Ry Rx)
 *              KUKA             x_mm y_mm z_mm a_deg b_deg c_deg          (R = Rz(A) Ry(B) Rx(C))
 *            units stand in the names: _m _mm, _rad _deg; bare names take them from the options
 *   matrix   rows of 16 numbers (4x4, row-major), of 12 (its upper three rows), or four rows of 4
 *   ethz     rows of t x y z qx qy qz qw, or without the t, and without a header
 *   visp     YAML of an array: 6x1 (x y z, then the rotation vector) or 4x4
 *
 * Numbers stand between commas, semicolons, blanks or tabs (csv: commas); lines that begin with '#' are left
 * out. A pose a file: a folder (all its .yaml and .yml in natural order) or a pattern (set_%d.yaml, %02d). */
#ifndef TELEDIMOS_CORE_ROBOT_POSES_H
#define TELEDIMOS_CORE_ROBOT_POSES_H

#include <stdbool.h>
#include <stddef.h>

#include "pose.h"
#include "rig.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_pose_convention {
    TD_POSES_AUTO, /* by the header, or the look of the file */
    TD_POSES_CSV,
    TD_POSES_MATRIX,
    TD_POSES_VISP,
    TD_POSES_ETHZ,
    TD_POSES_CONVENTION_COUNT
} td_pose_convention;

typedef struct td_robot_pose {
    char name[TD_NAME_SIZE]; /* "" when the file has none */
    double time_s;           /* NaN: none */
    td_pose base_from_hand;
} td_robot_pose;

typedef struct td_robot_poses {
    size_t count;
    td_robot_pose *pose; /* (count) */
} td_robot_poses;

typedef struct td_robot_poses_options {
    td_pose_convention convention;
    bool inverted;     /* the file holds hand_from_base */
    double metres;     /* of the file's unit of length where its names do not say: 1, 0.001; 0: 1 */
    double radians;    /* of its unit of angle: 1, pi/180; 0: 1 */
    bool scalar_first; /* quaternions without names are w x y z; default x y z w */
} td_robot_poses_options;

/* Reads a file, a folder or a pattern; poses of a pattern or folder are named after their files, without the
 * ending. NULL options: defaults. Rotations are checked (orthogonal, determinant 1, length 1: to 1e-3) and
 * made exact; NaN, half a row, a matrix that is no rotation, times that go back are errors that name file and
 * line. A pose more than 1e5 m away is refused. */
TD_API td_status td_robot_poses_read(td_robot_poses **poses, const char *path,
                                     const td_robot_poses_options *options, td_error *error);
/* One file from memory; `name` is for messages. */
TD_API td_status td_robot_poses_parse(td_robot_poses **poses, const char *text, size_t size, const char *name,
                                      const td_robot_poses_options *options, td_error *error);
TD_API void td_robot_poses_free(td_robot_poses **poses);

/* The pose at a time: linear in translation, on the shortest arc in rotation. False outside the stream, in a
 * gap longer than `gap_s` (0: any), or where the poses have no times. */
TD_API bool td_robot_poses_at(td_pose *base_from_hand, const td_robot_poses *poses, double time_s,
                              double gap_s);
/* The same between two poses: `share` 0 is a, 1 is b. */
TD_API td_pose td_pose_between(const td_pose *a, const td_pose *b, double share);

#ifdef __cplusplus
}
#endif
#endif
