/* Mistakes of convention, recognised by what they do to the motions: a camera and a hand on one body turn by
 * the same angles. */
#ifndef TELEDIMOS_CALIB_HAND_EYE_MISTAKES_H
#define TELEDIMOS_CALIB_HAND_EYE_MISTAKES_H

#include "hand_eye.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_hand_eye_mistake {
    char text[320]; /* "the robot's poses look inverted: …" */
    double better;  /* by how many times the residual falls when it is put right */
} td_hand_eye_mistake;

enum { TD_MAX_MISTAKES = 8 };

/* Tries, one at a time: poses inverted; the other setup; lengths in mm or m; angles in degrees or radians
 * (rotation vectors); quaternion order; the order of the views (shifted by one, reversed, two swapped);
 * mirrored frames. Names those that explain the data far better than what was said. */
TD_API size_t td_hand_eye_mistakes(td_hand_eye_mistake mistake[TD_MAX_MISTAKES], td_hand_eye_setup setup,
                                   const td_hand_eye_view *view, size_t count);

/* Time offset of two streams of poses of one rigid body (robot and camera), by their angular speeds first
 * (cross-correlation), then by least squares over the motions. Add *offset_s to the second's times. */
TD_API td_status td_time_offset(double *offset_s, double *sigma_s, const double *time_a, const td_pose *a,
                                size_t count_a, const double *time_b, const td_pose *b, size_t count_b,
                                td_error *error);

#ifdef __cplusplus
}
#endif
#endif
