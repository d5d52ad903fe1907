/* Robot poses in everyone's files and conventions.
 *
 *   base_from_hand as CSV (time_s optional, frame optional), columns by convention:
 *     quaternion      x_m y_m z_m qw qx qy qz    (by name, so in either order)
 *     rotation-vector x_m y_m z_m rx_rad ry_rad rz_rad     (axis times angle)
 *     rpy             x_m y_m z_m roll_rad pitch_rad yaw_rad      (fixed x, y, z: R = Rz Ry Rx)
 *     abc             x_mm y_mm z_mm a_deg b_deg c_deg     (KUKA: R = Rz(A) Ry(B) Rx(C))
 *   units stand in the names: _m _mm, _rad _deg.
 *     matrix          rows of 16 numbers (4x4, row-major), or of 12, blanks or commas between
 *     visp            a folder or pattern of ViSP's YAML poses (x y z, then the rotation vector)
 *     ethz            t, x, y, z, qx, qy, qz, qw without a header */
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
    bool inverted;    /* the file holds hand_from_base */
    double metres;    /* of the file's unit of length where its names do not say: 1, 0.001; 0: 1 */
    double radians;   /* of its unit of angle: 1, pi/180; 0: 1 */
    bool scalar_last; /* quaternions without names are x y z w */
} td_robot_poses_options;

/* `path` may hold %d or %0Nd for a file each (ViSP). Rotations are checked (determinant 1 to 1e-3) and made
 * exact; NaN, half a row, a matrix that is no rotation are errors that name file and line. */
TD_API td_status td_robot_poses_read(td_robot_poses **poses, const char *path,
                                     const td_robot_poses_options *options, td_error *error);
TD_API td_status td_robot_poses_parse(td_robot_poses **poses, const char *text, size_t size, const char *name,
                                      const td_robot_poses_options *options, td_error *error);
TD_API void td_robot_poses_free(td_robot_poses **poses);

/* The pose at a time: linear in translation, on the shortest arc in rotation. False outside the stream, or in
 * a gap longer than `gap_s`. */
TD_API bool td_robot_poses_at(td_pose *base_from_hand, const td_robot_poses *poses, double time_s,
                              double gap_s);

#ifdef __cplusplus
}
#endif
#endif
