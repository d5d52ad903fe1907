/* Which inertias and frictions a machine has, from a recorded motion, and what the record does not tell.
 *
 * Model, as sim/machine.h has it, for each joint k that moves:
 *
 *     |lever_k(q)| force_k = regressor_k(q, nu, acceleration) theta + viscous_k d_k + coulomb_k tanh(d_k /
 * slip)
 *
 * theta: ten inertial parameters of each link (sim/dynamics.h). Only some sums of them enter, the base
 * parameters (Gautier 1991); they are found as the independent columns of the regressor over states drawn at
 * random, the parents' first, so that each is one parameter of a link and what its children add to it.
 *
 * Estimate. Accelerations are not measured, and least squares with differentiated positions is biased by
 * their noise. So splines of degree 5 are fitted to positions, rates and poses; what their noise does to the
 * forces through the model is in the forces' weight R^-1, correlated in time as it is; and the equations are
 * those of instrumental variables (Janot, Vandanjon, Gautier 2014), Z' R^-1 (force - Y theta) = 0, Y being
 * the regressor on those splines and Z that on smoother ones, whose noise is negligible. Noise is taken from
 * the log itself, by differences of order 5, never below a floor. The prior (the robot's own parameters)
 * is given many times their size as its sigma: it holds what the motion does not tell, and nothing else.
 * Where a joint stands still its friction is not known, and its equation is left out.
 *
 * A parameter is told when its sigma is below a share (`told`) of its size. */
#ifndef TELEDIMOS_SIM_IDENTIFICATION_H
#define TELEDIMOS_SIM_IDENTIFICATION_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A recorded motion of a robot with n joints; the arrays are borrowed. */
typedef struct td_motion_log {
    const char *name; /* for messages; NULL: "log" */
    size_t count;
    const double *time_s;       /* (count), rising */
    const double *position;     /* (count,n) rad or m */
    const double *rate;         /* (count,n) rad/s or m/s; NULL: not measured */
    const double *acceleration; /* (count,n) rad/s^2; NULL: derived. Given, it, positions and rates are taken
                                   as exact, and the base stands still */
    const double *force;        /* (count,n) as td_plant_state's: N of cylinders, N m of motors */
    const double *base; /* (count,6) x, y, z (m), roll, pitch, yaw (rad) of site_from_vehicle; NULL: it
                           stands still */
} td_motion_log;

typedef struct td_identification_options {
    td_pose site_from_vehicle; /* of a base that stands still; default identity */
    double gravity[3];         /* m/s^2, site; default (0, 0, -9.80665) */
    double slip;               /* rad/s or m/s, as the machine's; default 5e-3 */
    double viscous[TD_ROBOT_MAX_JOINTS], coulomb[TD_ROBOT_MAX_JOINTS]; /* prior; default: the machine's */
    double knot_s;                 /* between the splines' knots; default 0.05, at least 2.5 samples */
    double smooth_s;               /* of the slow motion whose regressor is the instruments; default 0.25 */
    double floor_rad, floor_m;     /* least noise of positions and poses; default 1e-4 rad, 1e-4 m */
    double floor_rad_s, floor_m_s; /* of rates; default 1e-3 */
    double floor_force; /* of forces, as a share of a joint's limit (none: of the largest in the log); default
                           1e-3 */
    double prior;       /* sigma of the prior over a parameter's size; default 10 */
    double told;        /* default 0.5 */
} td_identification_options;
TD_API td_identification_options td_identification_options_default(const td_robot *robot);

typedef struct td_identified {
    char name[2 * TD_NAME_SIZE]; /* "boom_mass_x", "arm_coulomb": of the first of the parameters in it */
    char *means;                 /* "mass x of boom + 5.648 mass of arm + …" */
    const char *unit;            /* "kg m" */
    double value, sigma, prior;
    double size; /* that one may expect, from the prior: "0.5" of it is too wide to be told */
    bool told;
} td_identified;

/* A direction that the motion does not tell: this sum of parameters, each in its size, may be any. */
typedef struct td_weak_direction {
    double share; /* its sigma over the sizes */
    char *means;
} td_weak_direction;

typedef struct td_identified_joint {
    double sigma_position, sigma_rate, sigma_force; /* noise: rad, rad/s, N (motor: N m) */
    size_t used;                                    /* samples whose force is explained */
    double rms_force;                               /* of measured less predicted, N (N m) */
} td_identified_joint;

/* A link's own parameters: those nearest to the prior's that agree with what was identified and can be. */
typedef struct td_identified_link {
    int link;
    double parameter[10], sigma[10]; /* as sim/dynamics.h orders them */
} td_identified_link;

typedef struct td_identification {
    int count; /* friction's are the last 2 n */
    td_identified *parameter;
    double *covariance; /* (count,count), of all, also of those that are not told */
    int weak_count;
    td_weak_direction *weak;
    int never_count;
    char (*never)[2 * TD_NAME_SIZE]; /* "undercarriage_mass": enters no joint's force in any motion */
    int link_count;
    td_identified_link *link;
    bool feasible;        /* the links' parameters had not to be moved to be those of a body */
    double condition;     /* of the regressor, each parameter in its size; INFINITY */
    double misfit;        /* forces: rms over what noise explains; above 1 the sigmas are widened by it */
    double spline_misfit; /* the same of the splines against positions and rates alone */
    int iterations;
    int joints;
    td_identified_joint joint[TD_ROBOT_MAX_JOINTS];
    double sigma_base[6]; /* noise of x, y, z, roll, pitch, yaw; 0 where the base stands still */
    size_t samples;
    double *predicted; /* (samples,n) force of the model */
    bool *used;        /* (samples,n) */
} td_identification;

/* Refused, naming it: a log that is too short or too long, times that do not rise or leave a gap, numbers
 * that are none, a joint far beyond its stops or its cylinder's reach, forces that are all 0; a robot that
 * td_dynamics refuses; options out of range. `options` NULL: defaults. */
TD_API td_status td_identify(td_identification **identification, const td_motion_log *log,
                             const td_robot *robot, const td_identification_options *options,
                             td_error *error);
TD_API void td_identification_free(td_identification **identification);

/* Base parameters (as many as td_identify names) of `other`, which differs from `robot` in its inertias and
 * frictions alone. `base_moves`: the log has a base;
 * one that stands still does so as `options` (NULL: defaults) say. */
TD_API td_status td_base_parameters_of(double *value, const td_robot *robot, bool base_moves,
                                       const td_robot *other, const double *viscous, const double *coulomb,
                                       const td_identification_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
