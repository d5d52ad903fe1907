/* What the files of the machine share. State y:
 *
 *   base, unless fixed: quaternion site_from_vehicle w x y z (need not be of length 1), position, m (site)
 *   q (n), then base, unless fixed: omega, v (its own axes); dq (n); F (n), N outwards; u (n), m/s outwards
 */
#ifndef TELEDIMOS_SIM_MACHINE_INTERNAL_H
#define TELEDIMOS_SIM_MACHINE_INTERNAL_H

#include "sim/dynamics.h"
#include "sim/machine.h"

enum { MACHINE_MAX_EVENTS = 1024 };

/* What drives a joint. [0]: pushing, outwards; [1]: pulling, inwards. */
typedef struct td_actuator {
    const td_cylinder *cylinder; /* NULL: a motor */
    double sign;                 /* of the lever: does the cylinder grow with the angle? */
    double area[2];              /* m^2 of all its cylinders; 1 for a motor */
    double force[2];             /* N; INFINITY: no limit */
    double speed[2];             /* m/s of the piston at its own full flow; INFINITY */
} td_actuator;

struct td_machine {
    td_robot robot;
    td_machine_options options;
    td_dynamics *dynamics;
    td_actuator actuator[TD_ROBOT_MAX_JOINTS];
    double stop_n[TD_ROBOT_MAX_JOINTS]; /* stiffness of the stops */
    td_machine_contact contact;         /* link -1: none */
    double spring[6], damper[6];        /* suspension: turn about x, y, z; shift along x, y, z (anchor) */
    td_plant_command command;
    double slope[TD_ROBOT_MAX_JOINTS], command_s;
    bool changed; /* the integrator has not yet seen the command or the state */
    td_ode ode;
    td_integrator *integrator;
    double t;
    double *y, *absolute; /* (size) */
    double *rows;         /* (6+n,size), of the Jacobian's making */
    int event_joint[TD_ODE_MAX_EVENTS];
    bool event_upper[TD_ODE_MAX_EVENTS];
    td_machine_event event[MACHINE_MAX_EVENTS];
    size_t event_count;
};

/* Where things are in y; -1 where the base is fixed. */
typedef struct td_machine_layout {
    int n, pose, q, nu, dq, force, valve, size;
} td_machine_layout;

static inline td_machine_layout td_machine_layout_of(const td_machine *m)
{
    const int n = m->robot.joint_count, base = m->options.base != TD_MACHINE_FIXED;
    td_machine_layout l = {.n = n, .pose = base ? 0 : -1, .q = base ? 7 : 0};
    l.nu = base ? l.q + n : -1;
    l.dq = l.q + n + (base ? 6 : 0);
    l.force = l.dq + n;
    l.valve = l.force + n;
    l.size = l.valve + n;
    return l;
}

/* A state opened up. */
typedef struct td_machine_view {
    td_pose pose; /* site_from_vehicle */
    double q[TD_ROBOT_MAX_JOINTS], nu[TD_DYNAMICS_MAX];
    const double *force, *valve; /* (n) in y */
    double gravity[3];           /* in the base's axes */
} td_machine_view;
void td_machine_open(td_machine_view *view, const td_machine *machine, const double *y);
/* What a plant reads of the joints. */
void td_machine_joint_readings(td_plant_state *state, const td_machine *machine, double t,
                               const td_machine_view *view);

/* machine_hydraulics.c */
td_status td_actuators_make(td_machine *machine, td_error *error);
/* dx/dq of a joint's cylinder (1 for a motor); *length may be NULL. False: the bars do not reach. */
bool td_actuator_lever(double *lever, const td_machine *machine, int joint, double q);
/* F' and u' of all joints at time t, from levers and rates, and what each cylinder pushes with (n each). */
void td_hydraulics_rate(double *force_rate, double *valve_rate, double *push, const td_machine *machine,
                        double t, const td_machine_view *view, const double *lever);
void td_hydraulics_push(double *push, const td_machine *machine, double t, const td_machine_view *view);
/* Derivatives of F', u' and the push by a joint's own q, dq, F and u. Where the pumps are shared, the share
 * is taken as constant. */
typedef struct td_hydraulics_slope {
    double force[4], valve[4], push[4];
} td_hydraulics_slope;
void td_hydraulics_slopes(td_hydraulics_slope *slope, double *push, const td_machine *machine, double t,
                          const td_machine_view *view, const double *lever, const double *lever_slope);
td_status td_command_check(const td_machine *machine, const td_plant_command *command, td_error *error);
/* What flows, m^3/s, at a piston speed; the sign is the speed's. */
double td_actuator_flow(const td_actuator *actuator, double speed);
double td_actuator_pressure(const td_actuator *actuator, double force);

/* machine_forces.c */
/* On the base [moment, force] in its axes; 0 but on a suspension. */
void td_suspension_wrench(double wrench[6], const td_machine *machine, const td_machine_view *view);
double td_suspension_energy(const td_machine *machine, const td_machine_view *view);
/* Of friction and stops at a joint, and its derivatives (may be NULL). */
double td_joint_torque(double *by_q, double *by_dq, const td_machine *machine, int joint, double q,
                       double dq);
double td_stop_energy(const td_machine *machine, int joint, double q);
td_pose td_machine_sag(const td_machine *machine, const td_machine_view *view); /* anchor_from_base, w >= 0 */
void td_machine_cross(double c[3], const double a[3], const double b[3]);
void td_base_from_site(double in_base[3], const td_pose *site_from_base, const double in_site[3]);
/* a (n,n), symmetric positive definite, becomes its factor (lower part); x = a^-1 x. */
bool td_machine_cholesky(double *a, int n);
void td_machine_cholesky_solve(double *x, const double *factor, int n);
bool td_machine_rate(double *dy, double t, const double *y, void *machine);

/* machine_contact.c */
/* How deep the point is in the plane, m; there must be one. */
double td_contact_depth(const td_machine *machine, const td_machine_view *view);
double td_contact_energy(const td_machine *machine, const td_machine_view *view);
/* Adds the plane's force (6+n). */
void td_contact_force(double *force, const td_machine *machine, const td_machine_view *view);
/* Its derivatives, a column each: by angles, velocities, a turn of the base in its axes and a shift in the
 * site. False: nothing is touched. `width` is that of differences by the angles. */
typedef struct td_contact_slope {
    double by_q[TD_ROBOT_MAX_JOINTS][TD_DYNAMICS_MAX], by_nu[TD_DYNAMICS_MAX][TD_DYNAMICS_MAX];
    double by_turn[3][TD_DYNAMICS_MAX], by_shift[3][TD_DYNAMICS_MAX];
} td_contact_slope;
bool td_contact_slopes(td_contact_slope *slope, const td_machine *machine, const td_machine_view *view,
                       double width);

/* machine_jacobian.c */
bool td_machine_jacobian(double *j, double t, const double *y, const double *dy, void *machine);

/* machine_state.c */
void td_machine_close(double *y, const td_machine *machine, const td_plant_state *state);

#endif
