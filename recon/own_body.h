/* The machine's own arm in its cameras' view: which pixels see it, from the joint angles, so that it stays
 * out of the map. The robot's primitives are grown by what the joints' and the rig's sigma make of them. */
#ifndef TELEDIMOS_RECON_OWN_BODY_H
#define TELEDIMOS_RECON_OWN_BODY_H

#include <stdint.h>

#include "../core/rig.h"
#include "../core/robot.h"
#include "depth_points.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_own_body_options {
    double margin_m;               /* grown by so much besides; default 0.05 */
    double times_sigma;            /* and by so many sigma of the joints and of vehicle_from_rig; default 3 */
    const double *sigma_q;         /* (joints) rad or m; NULL: 0 */
    const double *pose_covariance; /* (6,6) of vehicle_from_rig; NULL: 0 */
    int mount; /* link that carries the rig: neither its primitives nor those of links fixed to it are looked
                  for, and joints that move it with what it sees cost nothing; -1 (default): none */
} td_own_body_options;
TD_API td_own_body_options td_own_body_options_default(void);
TD_API td_status td_own_body_options_check(const td_own_body_options *options, const td_robot *robot,
                                           td_error *error);

/* mask (height,width): 1 where pixel (x, y) of a pinhole camera (rectified, `camera_from_vehicle`) may see
 * the robot at joints q: its ray meets a primitive grown by what td_own_body_growth says. Refused: cameras
 * that are no pinholes, joints that are no numbers. */
TD_API td_status td_own_body_mask(uint8_t *mask, const td_camera *camera, const td_pose *camera_from_vehicle,
                                  const td_robot *robot, const double *q, const td_own_body_options *options,
                                  td_error *error);
/* Whether a point of the vehicle's frame lies in the grown robot. */
TD_API bool td_own_body_holds(const double p[3], const td_robot *robot,
                              const td_pose *vehicle_from_link, /* (links) */
                              const double *grown_m /* (links) */);
/* What each link is grown by, m (links); NaN: it is not looked for. Every point of a link moves by less while
 * each joint is off by at most times_sigma of its sigma and the rig's pose by times_sigma along its worst
 * direction (first order). */
TD_API void td_own_body_growth(double *grown_m, const td_robot *robot, const double *q,
                               const td_own_body_options *options);
/* Before fusion: disparities whose points lie in the grown robot become NaN; how many were in *removed (may
 * be NULL). */
TD_API td_status td_own_body_remove(td_disparity *disparity, size_t *removed, const td_depth_camera *camera,
                                    const td_pose *vehicle_from_rig, const td_robot *robot, const double *q,
                                    const td_own_body_options *options, int threads, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
