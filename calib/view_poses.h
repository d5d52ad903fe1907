/* Where the target stands in each view of a known rig, with the covariance that its points give. */
#ifndef TELEDIMOS_CALIB_VIEW_POSES_H
#define TELEDIMOS_CALIB_VIEW_POSES_H

#include "observations.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_view_pose {
    bool seen; /* by enough points for a pose */
    td_pose rig_from_target;
    double covariance[36]; /* of its perturbation (pose.h) */
    double rms_px;         /* sqrt(sum |r|^2 / points) over the points in use of all cameras */
    size_t points, outliers;
} td_view_pose;

/* pose: (views). The rig is taken as exact; outlying points are left out; the noise is each point's own sigma
 * and a common part, estimated from what no change of the cameras could explain. Cameras are matched by name.
 * TD_ERROR_DATA when no view has a pose. */
TD_API td_status td_view_poses(td_view_pose *pose, const td_rig *rig, const td_observations *observations,
                               td_error *error);

/* The same for cameras that are said to have no distortion and may have some after all, as drivers of robots'
 * cameras publish them. The covariance then holds what such a lens could do to each view: two radial terms of
 * which only the size is known, as the views tell it (of 8 views of one tag it remains too small, sigma by up
 * to 1.4; taking the camera as exact, by 3.4). *bend (may be NULL): standard deviation of a term, as the
 * share by which it moves the image's corner; 0: the rig has distortion or a covariance of its own, or views
 * share a pose, and the poses are those of td_view_poses. rms_px is that through the lens that suits the view
 * best. */
TD_API td_status td_view_poses_unsure(td_view_pose *pose, double *bend, const td_rig *rig,
                                      const td_observations *observations, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
