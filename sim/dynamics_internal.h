/* What the rooms of the dynamics share: the moving tree that code is generated from, the recursive
 * evaluation, and the table of functions that generated code offers. */
#ifndef TELEDIMOS_SIM_DYNAMICS_INTERNAL_H
#define TELEDIMOS_SIM_DYNAMICS_INTERNAL_H

#include "sim/dynamics.h"

enum { TD_DYNAMICS_HASH_SIZE = 65 };

/* ---- the robot as it is (dynamics_robot.c) ---- */

/* Refuses a robot that has no mass at all, or a link whose inertia is none. */
td_status td_dynamics_check(const td_robot *robot, td_error *error);
/* 64 digits that tell robots of different dynamics apart. */
td_status td_dynamics_hash(char hash[TD_DYNAMICS_HASH_SIZE], const td_robot *robot, td_error *error);

/* ---- evaluated without a compiler (dynamics_recursive.c, dynamics_articulated.c) ---- */

void td_recursive_inverse(double *force, const td_robot *robot, const double *q, const double *nu,
                          const double *acceleration, const double gravity[3], bool coriolis);
bool td_recursive_forward(double *acceleration, const td_robot *robot, const double *q, const double *nu,
                          const double *force, const double gravity[3], bool coriolis);
void td_recursive_mass(double *mass, const td_robot *robot, const double *q);
void td_recursive_regressor(double *regressor, const td_robot *robot, const double *q, const double *nu,
                            const double *acceleration, const double gravity[3]);
void td_recursive_jacobian(double *jacobian, const td_robot *robot, const double *q, int link);

/* ---- the moving tree (dynamics_tree.c) ---- */

/* What moves as one, with its joint; body 0 is the base. Vectors are in the body's working axes with all the
 * turns since those axes began at 0.
 *
 * Working axes: those of the base, or of a body that turns (`turned`); bodies between use their parent's, in
 * which they turn about the coordinate axis `spin` (-1: not at all) by the sum of the joint angles since the
 * axes began. A body is `turned` where a child's axis would not stand still otherwise. Its own axes follow
 * from its parent's by before * Turn(spin angle) * after.
 *
 * Origins are slid along the joint's axis until their offset is across it. Inertia that its parent may carry
 * as well without changing any force is given to the parent: of a revolute joint the mass, the first and the
 * second moment along the axis; of a prismatic one all second moments (the regrouping of Gautier and Khalil
 * 1990). */
typedef struct td_body {
    int parent, frame; /* frame: the body whose working axes are used */
    td_joint_kind kind;
    bool turned;
    int spin;                   /* of the parent's working axes after `before`; coordinate axis, or -1 */
    double sign;                /* revolute: of the joint's angle in the spin */
    double axis[3];             /* of the joint, in the parent's working axes */
    double offset[3];           /* of the origin from the parent's, in the parent's working axes */
    double before[9], after[9]; /* constant rotations of a turned body */
    bool is_before, is_after;   /* they are not the identity */
    int inertia_axis;           /* about which its second moments are best split */
    double mass, h[3], moment[9];
} td_body;

typedef struct td_body_link {
    int body;
    double offset[3], rotation[9]; /* origin and axes of the link in the body's working axes */
} td_body_link;

typedef struct td_tree {
    int body_count, link_count;
    td_body body[TD_DYNAMICS_MAX]; /* body k + 1: that of joint k */
    td_body_link link[TD_ROBOT_MAX_LINKS];
} td_tree;

/* `spare_base`: the base is given no mass and first moment, which pays where its own inertia is simple. */
void td_tree_build(td_tree *tree, const td_robot *robot, bool spare_base);

/* ---- generated code ---- */

/* Generated code exports PREFIX_functions, an array of these in this order, NULL where a function was too
 * long to be written, and PREFIX_hash, the robot's. */
typedef void (*td_function)(void);
enum {
    TD_FUNCTION_INVERSE,
    TD_FUNCTION_INVERSE_STILL, /* without Coriolis */
    TD_FUNCTION_FORWARD,
    TD_FUNCTION_FORWARD_STILL,
    TD_FUNCTION_MASS,
    TD_FUNCTION_GRAVITY,
    TD_FUNCTION_CORIOLIS,
    TD_FUNCTION_REGRESSOR,
    TD_FUNCTION_JACOBIAN,
    TD_FUNCTION_COUNT
};

struct td_dynamics {
    td_robot robot;
    td_function function[TD_FUNCTION_COUNT]; /* NULL: evaluated recursively */
    void *library;                           /* dlopen's; NULL */
};

/* A copy of the robot, checked. */
td_status td_dynamics_begin(td_dynamics **dynamics, const td_robot *robot, td_error *error);

#endif
