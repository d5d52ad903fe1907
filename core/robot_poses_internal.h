/* What the readers of robot poses share. */
#ifndef TELEDIMOS_CORE_ROBOT_POSES_INTERNAL_H
#define TELEDIMOS_CORE_ROBOT_POSES_INTERNAL_H

#include "core/robot_poses.h"

enum { TD_POSES_MAX = 1 << 21, TD_POSES_MAX_BYTES = 64 << 20 };

/* Poses that grow. */
typedef struct td_pose_list {
    td_robot_poses *poses;
    size_t capacity;
} td_pose_list;

td_status td_pose_list_add(td_pose_list *list, const td_robot_pose *pose, const char *name, td_error *error);

/* Fill in q; false when the numbers are no rotation to 1e-3. */
bool td_rotation_from_quaternion(double q[4], const double wxyz[4]);
bool td_rotation_from_matrix(double q[4], const double r[9]);

/* Each fills the list; options are complete (no zero units). */
td_status td_robot_poses_csv(td_pose_list *list, const char *text, size_t size, const char *name,
                             const td_robot_poses_options *options, td_error *error);
td_status td_robot_poses_rows(td_pose_list *list, const char *text, size_t size, const char *name,
                              const td_robot_poses_options *options, td_error *error);
td_status td_robot_poses_visp(td_pose_list *list, const char *text, size_t size, const char *name,
                              const td_robot_poses_options *options, td_error *error);

#endif
