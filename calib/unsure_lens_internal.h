/* Poses of the target through cameras whose lens is said to have no distortion and is not believed. */
#ifndef TELEDIMOS_CALIB_UNSURE_LENS_INTERNAL_H
#define TELEDIMOS_CALIB_UNSURE_LENS_INTERNAL_H

#include "calib/bundle_internal.h"
#include "calib/view_poses.h"

/* Whether the camera's model has no distortion, or all of it is 0. */
bool td_camera_is_plain(const td_camera *camera);

/* Refines the poses of the bundle's seen views, and their covariances in pose[], with two radial terms of
 * every plain camera free in each view; `noise` is a coordinate's noise beyond the points' own sigma, px, to
 * begin from. *bend: standard deviation of a term, as the share by which it moves the image's corner. Leaves
 * all as it is, with *bend 0, where no camera is plain, views share a pose, or it does not converge. */
td_status td_unsure_lens_refine(td_view_pose *pose, double *bend, td_bundle *bundle, double noise,
                                td_error *error);

#endif
