/* What the files of the world share. */
#ifndef TELEDIMOS_SIM_WORLD_INTERNAL_H
#define TELEDIMOS_SIM_WORLD_INTERNAL_H

#include <ode/ode.h>

#include "sim/machine_internal.h"
#include "sim/world.h"

/* Links that move as one; body 0 is the base. */
typedef struct td_world_body {
    int parent, joint, link;  /* link: whose frame is the body's */
    td_pose parent_from_body; /* at q = 0 */
    double axis[3];
    bool slides;
    double mass, com[3], inertia[9]; /* about the centre of mass, in the body's axes */
    dBodyID ode;                     /* NULL: it cannot move */
    dJointID motor;                  /* hinge or slider to the parent */
    td_pose pose;                    /* site_from_body */
    double turn[9];                  /* its rotation */
    double at[3], way[3];            /* centre of mass, axis of the joint (site) */
    double push[6], step_push[6];    /* force, moment about the centre of mass (site): a call's, a step's */
} td_world_body;

typedef struct td_world_point {
    double at[3]; /* in the base's frame */
    double weight;
    bool right;
    double shear[3]; /* m (site) */
} td_world_point;

typedef struct td_world_stone_body {
    dBodyID ode; /* NULL: it cannot be moved */
    dGeomID geom;
    td_primitive shape;
    double friction;
    bool lost;
} td_world_stone_body;

struct td_world {
    td_world_options options;
    td_machine *machine; /* its hydraulics, joints and checks; no state of it is used */
    const td_elevation *ground;
    dWorldID ode;
    dThreadingImplementationID threading; /* ODE's own is one for all worlds, which may not step at once */
    dJointGroupID contacts;
    dSpaceID machine_space, stone_space; /* made with the first stone */

    int body_count, body_of[TD_ROBOT_MAX_LINKS];
    td_pose body_from_link[TD_ROBOT_MAX_LINKS];
    td_world_body body[1 + TD_ROBOT_MAX_JOINTS];

    /* Velocity [omega, v of the base's centre of mass (site), dq] half a step before the positions, and what
     * brings it up to them. */
    double q[TD_ROBOT_MAX_JOINTS], velocity[TD_DYNAMICS_MAX], ahead[TD_DYNAMICS_MAX];
    double force[TD_ROBOT_MAX_JOINTS], valve[TD_ROBOT_MAX_JOINTS];
    double lever[TD_ROBOT_MAX_JOINTS];
    td_hydraulics_slope slope[TD_ROBOT_MAX_JOINTS];
    double valve_gain_s, belt_gain; /* what their lags let through in a step */
    bool fresh;                     /* velocities are still at the positions' time */
    double begun_s, owed_s;
    long long steps;

    int point_count;
    td_world_point point[TD_WORLD_MAX_POINTS];
    double belt[2], wanted[2];
    double track_force[2][3];
    int touching[2];

    int stone_count;
    td_world_stone_body stone[TD_WORLD_MAX_STONES];
    bool inside_step;
};

/* world_robot.c */
td_status td_world_build_robot(td_world *world, td_error *error);
/* Positions of the bodies from pose of the base and q. */
void td_world_place(td_world *world);
/* Positions and velocities into ODE, and forces of joints and of the velocities' products. */
void td_world_load(td_world *world);
/* Velocities from ODE, then positions, forces and valves at the step's end. */
void td_world_unload(td_world *world);
double td_world_time(const td_world *world);
void td_world_view(td_machine_view *view, const td_world *world);
/* Velocity of a body's point, site's axes. */
void td_world_base_velocity(double velocity[3], const td_world *world, const double at[3]);

/* world_tracks.c */
void td_world_build_tracks(td_world *world);
td_status td_world_check_tracks(const td_world *world, td_error *error);
td_status td_world_tracks_push(td_world *world, td_error *error);
/* Stands the base on the ground below it. */
td_status td_world_stand(td_world *world, td_error *error);
/* Unit normal of the ground; false where there is none. */
bool td_world_normal(double normal[3], double *height, const td_world *world, double x, double y);

/* world_stones.c */
void td_world_touch(td_world *world);
void td_world_free_stones(td_world *world);
/* The deepest corner of the body that is last in its tree, below the ground (m; below 0: above). */
double td_world_buried(const td_world *world, int *link);

#endif
