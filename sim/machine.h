/* The machine: a robot on its suspension, its joints moved by oil, its equations integrated as y' = f(t, y).
 *
 * Base. Heave, pitch and roll stand on the robot file's springs and dampers, at the root link's origin and in
 * the anchor's axes. x and y are held by heave's spring and damper and yaw by pitch's: there is no figure for
 * the ground's shear, and its stiffness is of that size. The turn's potential is 2 v' K v, v the vector part
 * of the unit quaternion (theta' K theta / 2 for small theta), so nothing is lost or won in a cycle.
 *
 * Cylinders. x(q) is the length, lever = dx/dq. The valve lets u m/s of piston speed through, which follows
 * the command with a first-order lag; the oil between valve and piston is a spring with a damper beside it:
 * F' = oil_n_m (u - x' - relief), the cylinder pushes with F + oil_s F', never beyond its limit. A relief
 * valve opens at 97 % of the pressure limit and passes the full flow at 100 %. Areas are the bore's on the
 * pushing side and the annulus' on the pulling side. Cylinders share the pumps: where they ask for more than
 * pump_m3_s, each gets the same share of what it asked for. A joint without a cylinder is a motor: the same
 * with a lever of 1 (m), torque for force, rad/s for flow, effort and speed of the URDF as limits, and no
 * share of the pumps.
 *
 * Joints. Friction is viscous d + coulomb tanh(d / slip) of the rate d. Stops are springs with Hunt and
 * Crossley's damping (1975): they give 1 mrad (mm) under the joint's effort. Where a joint meets a stop or
 * leaves it is an event, located in time.
 *
 * Contact. A point of a link may meet one plane that stands in the site: a spring with Hunt and Crossley's
 * damping and friction, of which machine_contact.c gives the formula. Touching and leaving are events. */
#ifndef TELEDIMOS_SIM_MACHINE_H
#define TELEDIMOS_SIM_MACHINE_H

#include <stdbool.h>

#include "../core/plant.h"
#include "integrator.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_machine_base {
    TD_MACHINE_SUSPENDED, /* the robot file must have heave, pitch and roll */
    TD_MACHINE_FIXED,
    TD_MACHINE_FLOATING /* nothing holds it */
} td_machine_base;

typedef struct td_machine_options {
    td_machine_base base;     /* default: suspended where the robot has a suspension, else fixed */
    td_pose site_from_anchor; /* where the root link stands while the suspension bears nothing */
    double gravity[3];        /* m/s^2, in the site's axes; default (0, 0, -9.80665) */
    bool coriolis;            /* false: without centrifugal and Coriolis terms */
    bool hydraulics;          /* false: the joints turn freely, commands are refused */
    double oil_n_m;   /* N/m of each joint's cylinders together (motor: N m/rad); default 1e8, what oil
                         of 1.4 GPa gives in the cylinders of a 20 t excavator */
    double oil_s;     /* the damper over the spring: losses of flow; default 0.01 */
    double valve_s;   /* lag; default 0.05 */
    double pump_m3_s; /* all the pumps; default: the largest of the cylinders' limits */
    double viscous[TD_ROBOT_MAX_JOINTS]; /* N m s/rad or N s/m; default: 10 % of effort at the speed limit */
    double coulomb[TD_ROBOT_MAX_JOINTS]; /* N m or N; default: 2 % of effort */
    double slip;         /* rad/s or m/s at which Coulomb friction is nearly whole; default 5e-3 */
    double suspension;   /* by which the robot file's dampers are multiplied; default 1 */
    double stop_damping; /* s/rad or s/m; 0: elastic stops; default 10 */
    td_integrator_options integrator; /* `absolute` is of td_machine_size states; NULL: for each state
                                         `relative` times what is small for it */
} td_machine_options;
/* Friction's defaults are 0 where the URDF has no effort or no speed. */
TD_API td_machine_options td_machine_options_default(const td_robot *robot);

typedef struct td_machine td_machine;
/* Generated dynamics where the build has them (td_dynamics_zx200), else recursive ones; or those compiled
 * into `folder` (may be NULL) by td_dynamics_compile. It stands at q = 0, or at the stop nearest to it, on
 * the anchor, and nothing bears its weight yet: td_machine_reset and td_machine_settle come next. `robot` is
 * copied. Options NULL: defaults. Refused by name: what td_dynamics refuses, options that are no numbers or
 * negative, a suspension without all of heave, pitch and roll. */
TD_API td_status td_machine_new(td_machine **machine, const td_robot *robot,
                                const td_machine_options *options, const char *folder, td_error *error);
TD_API void td_machine_free(td_machine **machine);

/* Pose, twist, q, dq and force are taken as they are given; the valves are shut. Refused by name: numbers
 * that are none, a joint beyond its limits, a force beyond its cylinder's. */
TD_API td_status td_machine_reset(td_machine *machine, const td_plant_state *state, td_error *error);
/* At rest where it stands: the base sinks into its suspension, and the cylinders carry the joints' loads.
 * Refused, naming the joint, where they cannot. */
TD_API td_status td_machine_settle(td_machine *machine, td_error *error);

/* From now on the value, changing by `slope` (joints; NULL: constant) a second. Refused, naming joint, value
 * and limit: a value beyond the limits of cylinder, motor or joint. On its way along a slope it is held at
 * the limit. */
TD_API td_status td_machine_command(td_machine *machine, const td_plant_command *command, const double *slope,
                                    td_error *error);
/* Goes on by dt. The integrator starts anew where a command came in between, else not. */
TD_API td_status td_machine_step(td_machine *machine, double dt_s, td_error *error);
TD_API void td_machine_state(const td_machine *machine, td_plant_state *state);
/* The largest value of a command of that kind: [0] as the angle falls, [1] as it grows;
 * what td_machine_command refuses above. */
TD_API void td_machine_limit(double limit[2], const td_machine *machine, td_command_kind kind, int joint);

/* A plane that a point of a link meets. The ground under a bucket tip, a wall before it. */
typedef struct td_machine_contact {
    int link;
    double point_m[3];            /* of the link, in its frame */
    double plane_m[3], normal[3]; /* a point of the plane, and its direction out of the ground, in the site */
    double stiffness_n_m;         /* default 1e7 */
    double damping_s_m;           /* of Hunt and Crossley; default 1 */
    double friction, slip_m_s;    /* coefficient, and speed at which friction is nearly whole; 0.4, 5e-3 */
} td_machine_contact;
TD_API td_machine_contact td_machine_contact_default(void); /* of no link: name one */
/* From now on; NULL: nothing is met (as after td_machine_new). td_machine_settle counts no contact: settle
 * above the plane. Refused by name: no such link, what is no number, a normal of no length, no stiffness. */
TD_API td_status td_machine_touch(td_machine *machine, const td_machine_contact *contact, td_error *error);
/* The plane's force on the tool, N, in the site's axes (0 where it is not touched); returns how far the point
 * is above the plane, m (INFINITY: there is none). */
TD_API double td_machine_contact_force(double force[3], const td_machine *machine);

typedef struct td_machine_energy {
    double kinetic, gravity, suspension, oil, stops, contact; /* J; gravity: against the site's origin */
    double total;
} td_machine_energy;
TD_API td_machine_energy td_machine_energies(const td_machine *machine);
/* Linear (N s) and angular (N m s, about the site's origin) momentum, in the site's axes. */
TD_API void td_machine_momentum(double linear[3], double angular[3], const td_machine *machine);

/* Where joints met (rising) or left their stops, or the tool the plane, in the order of time; the first 1024
 * are kept. */
typedef struct td_machine_event {
    double time_s;
    int joint; /* -1: the plane was met or left */
    bool upper, met;
} td_machine_event;
TD_API const td_machine_event *td_machine_events(const td_machine *machine, size_t *count);
TD_API td_integrator_counters td_machine_count(const td_machine *machine);

/* Its equations as the integrator sees them, for those who bring an integrator of their own: y (size). The
 * names of the states are "quaternion w", "boom angle" …; lives as long as the machine. */
TD_API size_t td_machine_size(const td_machine *machine);
TD_API const td_ode *td_machine_ode(const td_machine *machine);
TD_API const double *td_machine_values(const td_machine *machine);
TD_API void td_machine_state_name(char name[TD_NAME_SIZE + 16], const td_machine *machine, size_t index);

/* A plant over it. The plant's free frees the machine. */
TD_API td_plant td_machine_plant(td_machine *machine);

#ifdef __cplusplus
}
#endif
#endif
