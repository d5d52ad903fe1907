/* Mistakes of convention, recognised by what they do to the motions: a camera and a hand on one body turn by
 * the same angles, and shift along their axes by the same lengths (the invariants of screws: Chen 1991). */
#ifndef TELEDIMOS_CALIB_HAND_EYE_MISTAKES_H
#define TELEDIMOS_CALIB_HAND_EYE_MISTAKES_H

#include "hand_eye.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_hand_eye_mistake {
    char text[320]; /* what it looks like, and by how much it explains the motions better */
    double better;  /* by how many times the residual falls when it is put right */
} td_hand_eye_mistake;

enum { TD_MAX_MISTAKES = 8 };

/* Tries, one at a time: poses inverted (the robot's, the target's, or the other setup: to the motions the
 * same, so one text names all three); lengths in mm or m; rotation vectors in degrees or radians; quaternion
 * order; mirrored frames; the order of the views (reversed, two exchanged, one too many or too few in one
 * list, so that all from there on are shifted by one). Each is judged by a robust closed form over pairs of
 * views (Park and Martin 1994, reweighted). Named, the best first, are those that leave less than a third of
 * the residual, a small part of the motion, and not more than twice what the best leaves. Fewer than 5 views:
 * none. */
TD_API size_t td_hand_eye_mistakes(td_hand_eye_mistake mistake[TD_MAX_MISTAKES], td_hand_eye_setup setup,
                                   const td_hand_eye_view *view, size_t count);

/* Time offset of two streams of poses of one rigid body, hand and camera: each in a fixed frame or the other
 * way round. Times ascend. By their angular speeds first (cross-correlation), then by robust least squares
 * over the rotations between poses of the second stream, the first being interpolated. Add *offset_s to the
 * second's times; *sigma_s (may be NULL) is its standard deviation, from the scatter of the residuals between
 * stretches of the stream, so that errors that last are counted as they are. TD_ERROR_DATA says what is
 * missing: overlap, motion, likeness. */
TD_API td_status td_time_offset(double *offset_s, double *sigma_s, const double *time_a, const td_pose *a,
                                size_t count_a, const double *time_b, const td_pose *b, size_t count_b,
                                td_error *error);

#ifdef __cplusplus
}
#endif
#endif
