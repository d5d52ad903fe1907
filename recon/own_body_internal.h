/* What own_body.c and own_body_mask.c share. */
#ifndef TELEDIMOS_RECON_OWN_BODY_INTERNAL_H
#define TELEDIMOS_RECON_OWN_BODY_INTERNAL_H

#include "own_body.h"

/* Both checks at once, for the functions that can fail. */
td_status td_own_body_check(const td_robot *robot, const double *q, const td_own_body_options *options,
                            td_error *error);

/* How the joints and the rig's pose, off by their sigmas, move the robot as the rig sees it. */
typedef struct td_own_motion {
    const td_robot *robot;
    const td_own_body_options *options;
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    double mount[6 * TD_ROBOT_MAX_JOINTS]; /* Jacobian of the link that carries the rig */
    int carrier;                           /* the link that it hangs on; -1: none */
} td_own_motion;
void td_own_motion_begin(td_own_motion *motion, const td_robot *robot, const double *q,
                         const td_own_body_options *options);
bool td_own_motion_looked_for(const td_own_motion *motion, int link);
/* What a shape of the link is grown by, m, the margin included. */
double td_own_motion_growth(const td_own_motion *motion, int link, const td_primitive *shape);

#endif
