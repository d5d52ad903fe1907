/* The closed forms behind the walls. All solve A_i X B_i = Z for views i; matrices are 4x4, row-major. */
#ifndef TELEDIMOS_CALIB_HAND_EYE_SOLVERS_INTERNAL_H
#define TELEDIMOS_CALIB_HAND_EYE_SOLVERS_INTERNAL_H

#include <stddef.h>

#include "calib/hand_eye_solvers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* cv::calibrateHandEye: a (n,16) base_from_gripper, b (n,16) camera_from_target; x: gripper_from_camera. */
td_status td_opencv_hand_eye(double x[16], td_hand_eye_solver solver, const double *a, const double *b,
                             size_t count, td_error *error);
/* cv::calibrateRobotWorldHandEye: camera_from_world_i world_from_base = camera_from_gripper
 * gripper_from_base_i. camera_from_world and gripper_from_base (n,16). */
td_status td_opencv_robot_world(double world_from_base[16], double camera_from_gripper[16],
                                td_hand_eye_solver solver, const double *camera_from_world,
                                const double *gripper_from_base, size_t count, td_error *error);

/* vpHandEyeCalibration, in the ViSP module (first_estimate_internal.h); a and b as above. */
#define TD_VISP_HAND_EYE_FUNCTION "td_visp_hand_eye"
typedef td_status td_visp_hand_eye_function(double x[16], const double *a, const double *b, size_t count,
                                            td_error *error);

#ifdef __cplusplus
}
#endif
#endif
