/* What dynamics asks of a robot before it computes, and how it tells robots apart. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "core/hash.h"
#include "core/linalg.h"
#include "sim/dynamics_internal.h"

static bool are_finite(const double *x, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i])) return false;
    return true;
}

static td_status check_link(const td_robot_link *link, td_error *error)
{
    if (!are_finite(&link->mass_kg, 1) || !are_finite(link->com_m, 3) || !are_finite(link->inertia, 9))
        return td_fail(error, TD_ERROR_DATA, "link '%s': its mass, centre or inertia is not a finite number",
                       link->name);
    if (link->mass_kg < 0)
        return td_fail(error, TD_ERROR_DATA, "link '%s': its mass, %g kg, is negative", link->name,
                       link->mass_kg);
    double largest = 0, skew = 0, moment[3];
    for (int i = 0; i < 9; i++) {
        largest = fmax(largest, fabs(link->inertia[i]));
        skew = fmax(skew, fabs(link->inertia[i] - link->inertia[3 * (i % 3) + i / 3]));
    }
    if (skew > 1e-9 * largest)
        return td_fail(error, TD_ERROR_DATA, "link '%s': its inertia is not symmetric", link->name);
    TD_TRY(td_eigen_symmetric(moment, NULL, link->inertia, 3, error));
    if (moment[0] < -1e-9 * largest)
        return td_fail(
            error, TD_ERROR_DATA,
            "link '%s': its inertia has a negative principal moment, %g kg m^2; check the signs of "
            "its products",
            link->name, moment[0]);
    return TD_OK;
}

td_status td_dynamics_check(const td_robot *robot, td_error *error)
{
    double mass = 0;
    for (int i = 0; i < robot->link_count; i++) {
        TD_TRY(check_link(robot->link + i, error));
        mass += robot->link[i].mass_kg;
    }
    if (mass > 0) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "robot '%s' has no mass, so it has no dynamics; give its links an <inertial>",
                   robot->name);
}

/* ---- the hash ---- */

static void add_numbers(td_hash *hash, const double *x, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const double value = x[i] == 0 ? 0 : x[i]; /* -0 is 0 */
        unsigned char bytes[sizeof(uint64_t)];
        uint64_t bits;
        memcpy(&bits, &value, sizeof bits);
        for (size_t k = 0; k < sizeof bytes; k++) bytes[k] = (unsigned char)(bits >> 8 * k);
        td_hash_add(hash, bytes, sizeof bytes);
    }
}

td_status td_dynamics_hash(char hash[TD_DYNAMICS_HASH_SIZE], const td_robot *robot, td_error *error)
{
    td_hash *made;
    TD_TRY(td_hash_new(&made, error));
    add_numbers(made, (double[]){robot->link_count, robot->joint_count}, 2);
    for (int i = 0; i < robot->link_count; i++) {
        const td_robot_link *link = robot->link + i;
        add_numbers(made, (double[]){link->parent, link->joint, link->mass_kg}, 3);
        add_numbers(made, link->parent_from_link.q, 4);
        add_numbers(made, link->parent_from_link.t, 3);
        add_numbers(made, link->com_m, 3);
        add_numbers(made, link->inertia, 9);
    }
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *joint = robot->joint + k;
        add_numbers(made, (double[]){joint->link, joint->kind == TD_JOINT_PRISMATIC}, 2);
        add_numbers(made, joint->axis, 3);
    }
    return td_hash_finish(hash, &made, error);
}
