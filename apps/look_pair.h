/* A pair of images into disparities, without the machine itself. */
#ifndef TELEDIMOS_APPS_LOOK_PAIR_H
#define TELEDIMOS_APPS_LOOK_PAIR_H

#include "core/robot.h"
#include "recon/depth_points.h"

/* The machine in its cameras' view, as it is believed to stand. */
typedef struct look_body {
    const td_robot *robot; /* NULL: none */
    int mount;             /* link that carries the rig */
    const double *q, *sigma_q;
    td_pose vehicle_from_rig; /* of the robot's root, with the joints at q */
    td_pose left_from_rig;    /* of the rig's left camera */
} look_body;

typedef struct look_shares {
    double matched, masked; /* of the pixels: with a disparity; that see the machine */
} look_shares;

/* Two images of the pair, as taken, into the rectified left one and its matched disparities. */
td_status look_match(td_image **left, td_disparity **disparity, look_shares *shares,
                     const td_depth_camera *depth, td_image *const raw[2], const td_dense_options *dense,
                     const look_body *body, td_error *error);

#endif
