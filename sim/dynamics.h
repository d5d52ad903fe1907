/* Equations of motion of a tree of links with a free base (the paper's ROBOTDYN writes them; so does
 * sim/dynamics_generator.h).
 *
 * State: joint positions q (n); velocity nu = [omega, v, dq] (6+n): the base's (root link's) angular velocity
 * and the velocity of its origin, both in the base's own axes, then the joints' rates. Acceleration [alpha,
 * a, ddq]: alpha = d omega/dt, a = the origin's acceleration against the ground, in the base's axes (v' +
 * omega x v). Force [moment, force, tau] (6+n): on the base about its origin, in its axes, then at the
 * joints. `gravity` (3): that vector, m/s^2, in the base's axes.
 *
 *     force = M(q) acceleration + coriolis(q, nu) + gravity term(q)
 *
 * Inertial parameters, 10 a link (mass, mass times centre of mass (3), inertia about the link's origin xx xy
 * xz yy yz zz), enter linearly: force = regressor(q, nu, acceleration) parameters. */
#ifndef TELEDIMOS_SIM_DYNAMICS_H
#define TELEDIMOS_SIM_DYNAMICS_H

#include <stdbool.h>

#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_DYNAMICS_MAX = 6 + TD_ROBOT_MAX_JOINTS };

typedef struct td_dynamics td_dynamics;

/* Evaluated without a compiler, for any robot: recursive Newton-Euler and articulated bodies (Featherstone
 * 2008). Links without a mass have none; refused are a robot without any mass, and a mass or inertia that is
 * negative, not symmetric or not a number, named by its link. */
TD_API td_status td_dynamics_new(td_dynamics **dynamics, const td_robot *robot, td_error *error);
/* The code that the build generated for datasets/zx200. Refused when `robot` is another (its hash tells). */
TD_API td_status td_dynamics_zx200(td_dynamics **dynamics, const td_robot *robot, td_error *error);
/* Generated, compiled with the machine's C compiler ($CC, cc) into `folder` under a hash of the code, and
 * loaded; what was compiled before is loaded at once. No compiler: refused with that. Functions too long to
 * be compiled in seconds (of robots of some dozens of joints) are evaluated as td_dynamics_new does. `folder`
 * must be the user's own: what is in it is run. */
TD_API td_status td_dynamics_compile(td_dynamics **dynamics, const td_robot *robot, const char *folder,
                                     td_error *error);
TD_API void td_dynamics_free(td_dynamics **dynamics);

TD_API int td_dynamics_joints(const td_dynamics *dynamics); /* n */
/* The robot's own parameters (10 links of the robot), as read from its file. */
TD_API int td_dynamics_parameter_count(const td_dynamics *dynamics);
TD_API void td_dynamics_parameters(double *parameter, const td_dynamics *dynamics);

/* Inverse dynamics (6+n). `coriolis` false leaves out centrifugal and Coriolis terms. */
TD_API void td_dynamics_inverse(double *force, const td_dynamics *dynamics, const double *q, const double *nu,
                                const double *acceleration, const double gravity[3], bool coriolis);
/* Forward dynamics (6+n). False: the mass matrix is singular, as for a joint that moves no mass, or the state
 * is no number. */
TD_API bool td_dynamics_forward(double *acceleration, const td_dynamics *dynamics, const double *q,
                                const double *nu, const double *force, const double gravity[3],
                                bool coriolis);
/* M (6+n,6+n), row-major, symmetric. */
TD_API void td_dynamics_mass(double *mass, const td_dynamics *dynamics, const double *q);
/* Gravity term (6+n), and velocity term (6+n): M acceleration + coriolis + gravity = force. */
TD_API void td_dynamics_gravity(double *force, const td_dynamics *dynamics, const double *q,
                                const double gravity[3]);
TD_API void td_dynamics_coriolis(double *force, const td_dynamics *dynamics, const double *q,
                                 const double *nu);
/* Regressor (6+n, parameters), row-major. */
TD_API void td_dynamics_regressor(double *regressor, const td_dynamics *dynamics, const double *q,
                                  const double *nu, const double *acceleration, const double gravity[3]);
/* Jacobian (6,6+n), row-major: [omega; v] of the link's origin, in the base's axes, by nu. */
TD_API void td_dynamics_jacobian(double *jacobian, const td_dynamics *dynamics, const double *q, int link);

#ifdef __cplusplus
}
#endif
#endif
