/* Dispatch: the generated function where there is one, else the recursive evaluation. */
#include "sim/dynamics.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#include "sim/dynamics_internal.h"

/* Written by the build (sim/CMakeLists.txt). */
extern void (*const td_zx200_functions[])(void);
extern const char td_zx200_hash[];

typedef void inverse_function(double *, const double *, const double *, const double *, const double *);
typedef int forward_function(double *, const double *, const double *, const double *, const double *);
typedef void mass_function(double *, const double *);
typedef void gravity_function(double *, const double *, const double *);
typedef void jacobian_function(double *, const double *, int);

/* ---- making ---- */

td_status td_dynamics_begin(td_dynamics **dynamics, const td_robot *robot, td_error *error)
{
    TD_TRY(td_dynamics_check(robot, error));
    td_dynamics *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for the dynamics of '%s'", robot->name);
    made->robot = *robot;
    *dynamics = made;
    return TD_OK;
}

td_status td_dynamics_new(td_dynamics **dynamics, const td_robot *robot, td_error *error)
{
    return td_dynamics_begin(dynamics, robot, error);
}

td_status td_dynamics_zx200(td_dynamics **dynamics, const td_robot *robot, td_error *error)
{
    char hash[TD_DYNAMICS_HASH_SIZE];
    TD_TRY(td_dynamics_hash(hash, robot, error));
    if (strcmp(hash, td_zx200_hash) != 0)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "robot '%s' is not the zx200 that this library was built with; use td_dynamics_compile "
            "or td_dynamics_new",
            robot->name);
    TD_TRY(td_dynamics_begin(dynamics, robot, error));
    memcpy((*dynamics)->function, td_zx200_functions, sizeof(*dynamics)->function);
    return TD_OK;
}

void td_dynamics_free(td_dynamics **dynamics)
{
    if (!*dynamics) return;
    if ((*dynamics)->library) dlclose((*dynamics)->library);
    free(*dynamics);
    *dynamics = NULL;
}

int td_dynamics_joints(const td_dynamics *dynamics)
{
    return dynamics->robot.joint_count;
}

/* ---- parameters ---- */

int td_dynamics_parameter_count(const td_dynamics *dynamics)
{
    return 10 * dynamics->robot.link_count;
}

void td_dynamics_parameters(double *parameter, const td_dynamics *dynamics)
{
    for (int i = 0; i < dynamics->robot.link_count; i++) {
        static const int rows[6] = {0, 0, 0, 1, 1, 2}, columns[6] = {0, 1, 2, 1, 2, 2};
        const td_robot_link *link = dynamics->robot.link + i;
        const double *c = link->com_m, square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
        double *p = parameter + 10 * i;
        p[0] = link->mass_kg;
        for (int k = 0; k < 3; k++) p[1 + k] = link->mass_kg * c[k];
        for (int k = 0; k < 6; k++) {
            const int row = rows[k], column = columns[k];
            p[4 + k] = link->inertia[3 * row + column] +
                       link->mass_kg * ((row == column ? square : 0) - c[row] * c[column]);
        }
    }
}

/* ---- evaluating ---- */

void td_dynamics_inverse(double *force, const td_dynamics *dynamics, const double *q, const double *nu,
                         const double *acceleration, const double gravity[3], bool coriolis)
{
    const td_function made = dynamics->function[coriolis ? TD_FUNCTION_INVERSE : TD_FUNCTION_INVERSE_STILL];
    if (made)
        ((inverse_function *)made)(force, q, nu, acceleration, gravity);
    else
        td_recursive_inverse(force, &dynamics->robot, q, nu, acceleration, gravity, coriolis);
}

bool td_dynamics_forward(double *acceleration, const td_dynamics *dynamics, const double *q, const double *nu,
                         const double *force, const double gravity[3], bool coriolis)
{
    const td_function made = dynamics->function[coriolis ? TD_FUNCTION_FORWARD : TD_FUNCTION_FORWARD_STILL];
    if (made) return ((forward_function *)made)(acceleration, q, nu, force, gravity);
    return td_recursive_forward(acceleration, &dynamics->robot, q, nu, force, gravity, coriolis);
}

void td_dynamics_mass(double *mass, const td_dynamics *dynamics, const double *q)
{
    const td_function made = dynamics->function[TD_FUNCTION_MASS];
    if (made)
        ((mass_function *)made)(mass, q);
    else
        td_recursive_mass(mass, &dynamics->robot, q);
}

void td_dynamics_gravity(double *force, const td_dynamics *dynamics, const double *q, const double gravity[3])
{
    static const double rest[TD_DYNAMICS_MAX] = {0};
    const td_function made = dynamics->function[TD_FUNCTION_GRAVITY];
    if (made)
        ((gravity_function *)made)(force, q, gravity);
    else
        td_recursive_inverse(force, &dynamics->robot, q, rest, rest, gravity, false);
}

void td_dynamics_coriolis(double *force, const td_dynamics *dynamics, const double *q, const double *nu)
{
    static const double rest[TD_DYNAMICS_MAX] = {0};
    const td_function made = dynamics->function[TD_FUNCTION_CORIOLIS];
    if (made)
        ((gravity_function *)made)(force, q, nu);
    else
        td_recursive_inverse(force, &dynamics->robot, q, nu, rest, rest, true);
}

void td_dynamics_regressor(double *regressor, const td_dynamics *dynamics, const double *q, const double *nu,
                           const double *acceleration, const double gravity[3])
{
    const td_function made = dynamics->function[TD_FUNCTION_REGRESSOR];
    if (made)
        ((inverse_function *)made)(regressor, q, nu, acceleration, gravity);
    else
        td_recursive_regressor(regressor, &dynamics->robot, q, nu, acceleration, gravity);
}

void td_dynamics_jacobian(double *jacobian, const td_dynamics *dynamics, const double *q, int link)
{
    const td_function made = dynamics->function[TD_FUNCTION_JACOBIAN];
    if (made)
        ((jacobian_function *)made)(jacobian, q, link);
    else
        td_recursive_jacobian(jacobian, &dynamics->robot, q, link);
}
