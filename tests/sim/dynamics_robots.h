/* Robots and states for the tests of the dynamics. */
#ifndef TELEDIMOS_TESTS_DYNAMICS_ROBOTS_H
#define TELEDIMOS_TESTS_DYNAMICS_ROBOTS_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/dynamics.h"

#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

typedef struct robot_kind {
    int joints;
    double prismatic, branch, fixed; /* shares: prismatic joints, links not on the last one, fixed links */
    double aligned;                  /* share of joints along a coordinate axis, with no turn at q = 0 */
} robot_kind;

static inline double spread(td_random *random)
{
    return 2 * td_random_uniform(random) - 1;
}

static inline void random_inertia(td_robot_link *link, td_random *random)
{
    double a[9];
    link->mass_kg = 0.5 + 5 * td_random_uniform(random);
    for (int i = 0; i < 9; i++) a[i] = spread(random);
    for (int i = 0; i < 3; i++) link->com_m[i] = 0.4 * spread(random);
    /* Of points: J = A A^T, I = tr(J) 1 - J. */
    double j[9], trace = 0;
    for (int i = 0; i < 9; i++) {
        j[i] = 0;
        for (int k = 0; k < 3; k++) j[i] += 0.1 * a[3 * (i / 3) + k] * a[3 * (i % 3) + k];
        if (i % 4 == 0) trace += j[i];
    }
    for (int i = 0; i < 9; i++) link->inertia[i] = (i % 4 == 0 ? trace : 0) - j[i];
}

/* To be freed with free(). */
static inline td_robot *random_robot(uint64_t seed, robot_kind kind)
{
    td_random random = td_random_seed(seed, 1);
    td_robot *robot = calloc(1, sizeof *robot);
    if (!robot) abort();
    snprintf(robot->name, sizeof robot->name, "random%d", kind.joints);
    robot->link[0] = (td_robot_link){.name = "base", .parent = -1, .joint = -1};
    robot->link[0].parent_from_link = td_pose_identity();
    random_inertia(robot->link, &random);
    robot->link_count = 1;
    while (robot->joint_count < kind.joints) {
        const int index = robot->link_count++;
        td_robot_link *link = robot->link + index;
        const bool branches = td_random_uniform(&random) < kind.branch;
        const bool aligned = td_random_uniform(&random) < kind.aligned;
        *link = (td_robot_link){
            .parent = branches ? (int)td_random_below(&random, (uint32_t)index) : index - 1, .joint = -1};
        snprintf(link->name, sizeof link->name, "link%d", index);
        double xi[6];
        for (int i = 0; i < 6; i++) xi[i] = i < 3 ? (aligned ? 0 : 2 * spread(&random)) : spread(&random);
        link->parent_from_link = td_pose_exp(xi);
        random_inertia(link, &random);
        if (td_random_uniform(&random) < kind.fixed) continue;
        td_robot_joint *joint = robot->joint + robot->joint_count;
        *joint = (td_robot_joint){.kind = TD_JOINT_REVOLUTE, .link = index};
        snprintf(joint->name, sizeof joint->name, "joint%d", robot->joint_count);
        if (td_random_uniform(&random) < kind.prismatic) joint->kind = TD_JOINT_PRISMATIC;
        double length = 0;
        for (int i = 0; i < 3; i++) joint->axis[i] = aligned ? 0 : spread(&random);
        if (aligned) joint->axis[td_random_below(&random, 3)] = spread(&random) < 0 ? -1 : 1;
        for (int i = 0; i < 3; i++) length += joint->axis[i] * joint->axis[i];
        for (int i = 0; i < 3; i++) joint->axis[i] /= sqrt(length);
        link->joint = robot->joint_count++;
    }
    return robot;
}

typedef struct robot_state {
    double q[TD_ROBOT_MAX_JOINTS], nu[TD_DYNAMICS_MAX], acceleration[TD_DYNAMICS_MAX], force[TD_DYNAMICS_MAX],
        gravity[3];
} robot_state;

static inline robot_state random_state(td_random *random, int joints)
{
    robot_state s;
    for (int k = 0; k < joints; k++) s.q[k] = 3 * spread(random);
    for (int k = 0; k < 6 + joints; k++) {
        s.nu[k] = td_random_normal(random);
        s.acceleration[k] = td_random_normal(random);
        s.force[k] = 100 * td_random_normal(random);
    }
    for (int k = 0; k < 3; k++) s.gravity[k] = 5 * td_random_normal(random);
    return s;
}

/* The largest difference over the largest value of b. */
static inline double apart(const double *a, const double *b, size_t count)
{
    double difference = 0, size = 0;
    for (size_t i = 0; i < count; i++) {
        if (!(fabs(a[i] - b[i]) <= difference)) difference = fabs(a[i] - b[i]); /* NaN stays */
        size = fmax(size, fabs(b[i]));
    }
    return difference == 0 ? 0 : difference / size;
}

#endif
