/* The least-squares problem of kinematic calibration. */
#ifndef TELEDIMOS_CALIB_KINEMATIC_INTERNAL_H
#define TELEDIMOS_CALIB_KINEMATIC_INTERNAL_H

#include "calib/kinematic.h"
#include "core/least_squares.h"

/* Corrections of five joints' origins, 6 numbers each, share a block. */
enum {
    TD_KIN_OF_JOINT = 6,
    TD_KIN_IN_CHUNK = 5,
    TD_KIN_CHUNKS = 6,
    TD_KIN_JOINTS = TD_KIN_IN_CHUNK * TD_KIN_CHUNKS
};

typedef struct td_kin_model {
    const td_kinematic_data *data;
    int joints, joint[TD_KIN_JOINTS];
    td_pose mount_from_rig, link_from_target;
    double correction[TD_KIN_OF_JOINT * TD_KIN_JOINTS];
    double sigma_rad, sigma_m;
    bool *used;
} td_kin_model;

typedef struct td_kin_term {
    const td_kin_model *model;
    size_t index;
} td_kin_term;

typedef struct td_kin_problem {
    td_problem *problem;
    td_kin_term *term;
    int mount, target, chunks, chunk[TD_KIN_CHUNKS], size[TD_KIN_CHUNKS];
} td_kin_problem;

/* To be freed even when it fails. */
td_status td_kin_problem_new(td_kin_problem *p, td_kin_model *m, const td_kinematic_options *options,
                             td_error *error);
void td_kin_problem_free(td_kin_problem *p);
#endif
