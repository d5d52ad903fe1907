/* Pressing with a force along an axis (the paper's "end effector motion / force coordinates"), and digging no
 * harder than a force: admittance along the axis, position across it.
 *
 * Along the axis v = (f_wanted - f) / d, no faster than the approach, f as servo/tool_force.h tells it. It
 * needs no switch at the touch: in the air the tool approaches (at f_wanted / d where that is slower),
 * against the ground it slows down until it stands and presses, or goes on where the ground gives way: so
 * digs it. Across the axis v = K (where it began - where it is).
 *
 * How small d may be. Ground, oil and frame are springs in series: 1/k is the sum of theirs, so k is less
 * than the softest, and the machine's own bounds it whatever the ground: 20 t excavators give 1 mm under less
 * than 1 kN. With k, the mass m of the arm at the tool, the period and the machine's lag, servo/lag.h has the
 * loop: it is stable above d = td_lag_least_damping, and without overshoot from k / td_lag_calm_gain (0.22 k
 * at 20 ms and a lag of 50 ms). Softer ground is slower, not less stable: the force settles with about d / k.
 * The default d is calm, and at least twice the least. Not in this: what swings between oil and ground; there
 * it holds where that is quicker than the loop, or damped, as friction in the joints damps it. */
#ifndef TELEDIMOS_SERVO_FORCE_CONTROLLER_H
#define TELEDIMOS_SERVO_FORCE_CONTROLLER_H

#include "motion_limits.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_force_controller_options {
    int link; /* the tool: a point of a link, m in its frame */
    double point_m[3];
    double axis[3];       /* along which it pushes, in the root's frame (any length) */
    double force_n;       /* wanted, > 0 */
    double approach_m_s;  /* the fastest along the axis; default 0.05 */
    double most_travel_m; /* along the axis; further on it stays where it is; default INFINITY */
    double stiffness_n_m; /* the stiffest that ground, oil and frame are together; default 1e6 */
    double mass_kg;       /* m; 0 (default): td_tool_mass where it starts */
    double damping_ns_m;  /* d; 0 (default): as said above */
    double hold_1_s;      /* K across the axis; default 3 */
    td_command_kind kind; /* rates (default) or flows */
    td_motion_limits limits;
} td_force_controller_options;
TD_API td_force_controller_options td_force_controller_options_default(void);

typedef struct td_force_controller {
    td_force_controller_options options; /* d filled in, the axis of length 1 */
    const td_robot *robot;               /* borrowed */
    double begin[3];                     /* where the point was, in the root's frame */
    double rate[TD_ROBOT_MAX_JOINTS];    /* commanded last */
    double force_n;                      /* with which the tool pushes along the axis, as last measured */
    double travel_m;                     /* along the axis since the start */
    double across_m;                     /* off the axis */
    bool at_end;                         /* most_travel_m is reached */
} td_force_controller;

/* At rest where the robot stands. Refused by name: no such link, an axis of no length, a damping that is not
 * stable at the stated stiffness (it says the least), a K that is not, what is no number or not above 0. */
TD_API td_status td_force_controller_start(td_force_controller *controller, const td_robot *robot,
                                           const td_force_controller_options *options,
                                           const td_plant_state *state, td_error *error);
/* Once a period. Fails, with a command that brakes all joints, as td_tool_force does. */
TD_API td_status td_force_controller_step(td_plant_command *command, td_force_controller *controller,
                                          const td_plant_state *state, const double *statics,
                                          td_error *error);

#ifdef __cplusplus
}
#endif
#endif
