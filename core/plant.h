/* A machine, whatever stands behind it: generated dynamics, the ODE world, a machine at the other end of a
 * link, a user's driver. It is commanded, stepped, and read.
 *
 * Commands and readings are by the robot's joints (core/robot.h). A plant that has no cylinders takes torques
 * for forces and rates for flows. */
#ifndef TELEDIMOS_CORE_PLANT_H
#define TELEDIMOS_CORE_PLANT_H

#include <stdbool.h>

#include "pose.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_command_kind {
    TD_COMMAND_FLOW,  /* m^3/s into each joint's cylinders (positive: the joint's angle grows); the piston
                         integrates */
    TD_COMMAND_FORCE, /* N of each joint's cylinders together (positive: the joint's angle grows) */
    TD_COMMAND_RATE   /* rad/s or m/s of each joint: the machine's own controller follows */
} td_command_kind;

typedef struct td_plant_command {
    td_command_kind kind;
    double value[TD_ROBOT_MAX_JOINTS]; /* (joints) */
} td_plant_command;

typedef struct td_plant_state {
    double time_s;
    td_pose site_from_vehicle; /* of the robot's root link */
    double twist[6];           /* omega (rad/s), v (m/s) of its origin, in its own axes */
    double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS];
    double
        force[TD_ROBOT_MAX_JOINTS]; /* N of each joint's cylinders together; torque, N m, where it has none */
    double pressure[TD_ROBOT_MAX_JOINTS]; /* Pa, difference over the piston; 0 where there is none */
    double flow[TD_ROBOT_MAX_JOINTS];     /* m^3/s taken */
    bool at_stop[TD_ROBOT_MAX_JOINTS];
} td_plant_state;

/* What a plant is made of. Functions take the plant's own data. */
typedef struct td_plant {
    void *self;
    const td_robot *robot;
    td_status (*command)(void *self, const td_plant_command *command, td_error *error);
    /* Goes on by dt seconds of its time (a real machine: waits for it). */
    td_status (*step)(void *self, double dt_s, td_error *error);
    td_status (*state)(void *self, td_plant_state *state, td_error *error);
    td_status (*reset)(void *self, const td_plant_state *state, td_error *error); /* NULL: cannot be set */
    void (*free)(void *self);
} td_plant;

#ifdef __cplusplus
}
#endif
#endif
