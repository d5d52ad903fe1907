/* Kinematic calibration of a chain of joints from poses: a camera (or tracker) fixed to one link of a robot
 * measures the pose of a target fixed to another, in many states of the joints.
 *
 *   rig_from_target = rig_from_mount  mount_from_link(q + offset, links' origins)  link_from_target
 *
 * Free: mount_from_rig, link_from_target, and the origins of the links between them, each with a prior about
 * what the robot's file says, so that what the chain cannot tell (a shift along a joint's axis against its
 * neighbour's) stays there instead of drifting. The noise of the measured poses is estimated: one sigma of
 * rotation, one of translation. */
#ifndef TELEDIMOS_CALIB_KINEMATIC_H
#define TELEDIMOS_CALIB_KINEMATIC_H

#include "../core/log.h"
#include "../core/progress.h"
#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_kinematic_data {
    const td_robot *robot;
    int mount, link; /* that carry the rig and the target */
    size_t count;
    const double *q;                /* (count, joints) readings, rad or m */
    const td_pose *rig_from_target; /* (count) measured */
} td_kinematic_data;

typedef struct td_kinematic_options {
    /* Priors of the origin of each moving joint between mount and link: what the machine was built to. */
    double sigma_origin_rad, sigma_origin_m; /* default 0.05 rad, 0.05 m; 0: held */
    double outlier_sigma;                    /* default 5 of a pose's residual; 0: none left out */
    const td_progress *progress;
    const td_log *log;
} td_kinematic_options;
TD_API td_kinematic_options td_kinematic_options_default(void);

typedef struct td_kinematic {
    td_pose mount_from_rig, link_from_target;
    double covariance[144]; /* of their perturbations, in this order */
    td_robot *robot;        /* the given one with the corrected origins, so that q + offset is taken up too */
    int joints;             /* of the chain */
    int joint[TD_ROBOT_MAX_JOINTS];
    double correction[TD_ROBOT_MAX_JOINTS][6]; /* (chain) left perturbation of each joint's origin */
    double sigma_correction[TD_ROBOT_MAX_JOINTS][6];
    double sigma_rad, sigma_m; /* noise of a measured pose, each axis */
    size_t used;
    bool *left_out; /* (count) */
} td_kinematic;

/* Refused: fewer than six poses, joints that stand still, a target on the rig's own side of every joint. */
TD_API td_status td_kinematic_solve(td_kinematic **result, const td_kinematic_data *data,
                                    const td_kinematic_options *options, td_error *error);
TD_API void td_kinematic_free(td_kinematic **result);
/* rig_from_target as the calibrated chain says it for readings q. */
TD_API td_pose td_kinematic_predict(const td_kinematic *result, const td_kinematic_data *data,
                                    const double *q);

#ifdef __cplusplus
}
#endif
#endif
