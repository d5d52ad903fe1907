/* Dynamics without a compiler, link by link in each link's own axes: Newton and Euler's recursion, composite
 * bodies, the regressor and Jacobians. It shares nothing with the generator, so that each checks the other.
 *
 * Accelerations are those against the ground, so the velocity v of the base's origin does not appear: laws
 * of motion are the same in a frame that moves along with it. */
#include <string.h>

#include "sim/dynamics_recursive_internal.h"

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static void add_cross(double c[3], const double a[3], const double b[3])
{
    double product[3];
    cross(product, a, b);
    for (int i = 0; i < 3; i++) c[i] += product[i];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void apply(double y[3], const double r[9], const double x[3])
{
    for (int i = 0; i < 3; i++) y[i] = dot(r + 3 * i, x);
}

static void apply_back(double y[3], const double r[9], const double x[3])
{
    for (int i = 0; i < 3; i++) y[i] = r[i] * x[0] + r[3 + i] * x[1] + r[6 + i] * x[2];
}

void td_recursive_place(td_link_place *place, const td_robot *robot, const double *q)
{
    for (int i = 0; i < robot->link_count; i++) {
        const td_robot_link *link = robot->link + i;
        td_pose pose = i == 0 ? td_pose_identity() : link->parent_from_link;
        if (link->joint >= 0) {
            const td_robot_joint *joint = robot->joint + link->joint;
            td_pose motion = td_pose_identity();
            double step[3];
            for (int k = 0; k < 3; k++) step[k] = q[link->joint] * joint->axis[k];
            if (joint->kind == TD_JOINT_PRISMATIC)
                memcpy(motion.t, step, sizeof step);
            else
                td_rotation_exp(motion.q, step);
            pose = td_pose_compose(&pose, &motion);
        }
        td_pose_rotation(place[i].r, &pose);
        memcpy(place[i].t, pose.t, sizeof pose.t);
    }
}

/* ---- inverse dynamics ---- */

typedef struct motion {
    double omega[3], alpha[3], a[3]; /* a: of the link's origin, less gravity */
} motion;

static const td_robot_joint *joint_of(const td_robot *robot, int link)
{
    const int k = robot->link[link].joint;
    return k < 0 ? NULL : robot->joint + k;
}

/* Velocity and acceleration of a link from its parent's, its own joint's rate and its change. */
static void move_link(motion *to, const motion *parent, const td_link_place *place,
                      const td_robot_joint *joint, double rate, double change)
{
    double a[3], inner[3], along[3];
    memcpy(a, parent->a, sizeof a);
    add_cross(a, parent->alpha, place->t);
    cross(inner, parent->omega, place->t);
    add_cross(a, parent->omega, inner);
    apply_back(to->a, place->r, a);
    apply_back(to->omega, place->r, parent->omega);
    apply_back(to->alpha, place->r, parent->alpha);
    if (!joint) return;
    for (int i = 0; i < 3; i++) along[i] = rate * joint->axis[i];
    if (joint->kind == TD_JOINT_PRISMATIC) {
        for (int i = 0; i < 3; i++) along[i] *= 2;
        add_cross(to->a, to->omega, along);
        for (int i = 0; i < 3; i++) to->a[i] += change * joint->axis[i];
        return;
    }
    add_cross(to->alpha, to->omega, along);
    for (int i = 0; i < 3; i++) {
        to->omega[i] += along[i];
        to->alpha[i] += change * joint->axis[i];
    }
}

static void move_links(motion *m, const td_robot *robot, const td_link_place *place, const double *nu,
                       const double *acceleration, const double gravity[3])
{
    for (int k = 0; k < 3; k++) {
        m[0].omega[k] = nu ? nu[k] : 0;
        m[0].alpha[k] = acceleration[k];
        m[0].a[k] = acceleration[3 + k] - gravity[k];
    }
    for (int i = 1; i < robot->link_count; i++) {
        const td_robot_joint *joint = joint_of(robot, i);
        const int k = 6 + robot->link[i].joint;
        move_link(m + i, m + robot->link[i].parent, place + i, joint, joint && nu ? nu[k] : 0,
                  joint ? acceleration[k] : 0);
    }
}

/* Moment about the link's origin and force that give a link its motion. */
static void wrench_of(double wrench[6], const td_robot_link *link, const motion *m)
{
    double inner[3], a[3], spin[3], force[3];
    memcpy(a, m->a, sizeof a);
    add_cross(a, m->alpha, link->com_m);
    cross(inner, m->omega, link->com_m);
    add_cross(a, m->omega, inner);
    for (int i = 0; i < 3; i++) force[i] = link->mass_kg * a[i];
    apply(wrench, link->inertia, m->alpha);
    apply(spin, link->inertia, m->omega);
    add_cross(wrench, m->omega, spin);
    add_cross(wrench, link->com_m, force);
    memcpy(wrench + 3, force, sizeof force);
}

/* A wrench on a link as one on its parent, added there. */
static void add_to_parent(double *parent, const double wrench[6], const td_link_place *place)
{
    double moment[3], force[3];
    apply(moment, place->r, wrench);
    apply(force, place->r, wrench + 3);
    add_cross(moment, place->t, force);
    for (int i = 0; i < 3; i++) {
        parent[i] += moment[i];
        parent[3 + i] += force[i];
    }
}

static double at_joint(const td_robot_joint *joint, const double wrench[6])
{
    return dot(joint->axis, joint->kind == TD_JOINT_PRISMATIC ? wrench + 3 : wrench);
}

void td_recursive_inverse(double *force, const td_robot *robot, const double *q, const double *nu,
                          const double *acceleration, const double gravity[3], bool coriolis)
{
    td_link_place place[TD_ROBOT_MAX_LINKS];
    motion m[TD_ROBOT_MAX_LINKS];
    double wrench[TD_ROBOT_MAX_LINKS][6];
    td_recursive_place(place, robot, q);
    move_links(m, robot, place, coriolis ? nu : NULL, acceleration, gravity);
    for (int i = 0; i < robot->link_count; i++) wrench_of(wrench[i], robot->link + i, m + i);
    for (int i = robot->link_count - 1; i > 0; i--) {
        const td_robot_joint *joint = joint_of(robot, i);
        if (joint) force[6 + robot->link[i].joint] = at_joint(joint, wrench[i]);
        add_to_parent(wrench[robot->link[i].parent], wrench[i], place + i);
    }
    memcpy(force, wrench[0], sizeof wrench[0]);
}

/* ---- mass matrix ---- */

/* Mass, first moment and moment of inertia about the link's origin. */
typedef struct composite {
    double mass, h[3], inertia[9];
} composite;

static void add_point(double inertia[9], const double a[3], const double b[3], double factor)
{
    for (int i = 0; i < 9; i++)
        inertia[i] +=
            factor * ((i % 4 == 0 ? dot(a, b) : 0) - (a[i / 3] * b[i % 3] + b[i / 3] * a[i % 3]) / 2);
}

static composite composite_of(const td_robot_link *link)
{
    composite c = {.mass = link->mass_kg};
    memcpy(c.inertia, link->inertia, sizeof c.inertia);
    for (int i = 0; i < 3; i++) c.h[i] = link->mass_kg * link->com_m[i];
    add_point(c.inertia, link->com_m, link->com_m, link->mass_kg);
    return c;
}

static void join(composite *parent, const composite *child, const td_link_place *place)
{
    double h[3], half[9], turned[9];
    apply(h, place->r, child->h);
    for (int i = 0; i < 3; i++) apply(half + 3 * i, place->r, child->inertia + 3 * i);
    for (int i = 0; i < 9; i++) { /* half = I R^T, turned = R half */
        const double *row = place->r + i / 3 * 3;
        turned[i] = row[0] * half[i % 3] + row[1] * half[3 + i % 3] + row[2] * half[6 + i % 3];
    }
    add_point(turned, h, place->t, 2);
    add_point(turned, place->t, place->t, child->mass);
    for (int i = 0; i < 9; i++) parent->inertia[i] += turned[i];
    for (int i = 0; i < 3; i++) parent->h[i] += h[i] + child->mass * place->t[i];
    parent->mass += child->mass;
}

/* The wrench that gives a composite body this acceleration from rest. */
static void accelerate(double wrench[6], const composite *c, const double alpha[3], const double a[3])
{
    apply(wrench, c->inertia, alpha);
    add_cross(wrench, c->h, a);
    cross(wrench + 3, alpha, c->h);
    for (int i = 0; i < 3; i++) wrench[3 + i] += c->mass * a[i];
}

static void fill_column(double *mass, const td_robot *robot, const td_link_place *place, int link,
                        const composite *c)
{
    static const double none[3] = {0};
    const td_robot_joint *joint = joint_of(robot, link);
    const bool shift = joint->kind == TD_JOINT_PRISMATIC;
    const int n = 6 + robot->joint_count, column = 6 + robot->link[link].joint;
    double wrench[6];
    accelerate(wrench, c, shift ? none : joint->axis, shift ? joint->axis : none);
    for (int at = link; at > 0; at = robot->link[at].parent) {
        double up[6] = {0};
        const td_robot_joint *above = joint_of(robot, at);
        const int row = 6 + robot->link[at].joint;
        if (above) mass[row * n + column] = mass[column * n + row] = at_joint(above, wrench);
        add_to_parent(up, wrench, place + at);
        memcpy(wrench, up, sizeof up);
    }
    for (int row = 0; row < 6; row++) mass[row * n + column] = mass[column * n + row] = wrench[row];
}

void td_recursive_mass(double *mass, const td_robot *robot, const double *q)
{
    const int n = 6 + robot->joint_count;
    td_link_place place[TD_ROBOT_MAX_LINKS];
    composite c[TD_ROBOT_MAX_LINKS];
    td_recursive_place(place, robot, q);
    memset(mass, 0, (size_t)(n * n) * sizeof *mass);
    for (int i = 0; i < robot->link_count; i++) c[i] = composite_of(robot->link + i);
    for (int i = robot->link_count - 1; i > 0; i--) {
        if (robot->link[i].joint >= 0) fill_column(mass, robot, place, i, c + i);
        join(c + robot->link[i].parent, c + i, place + i);
    }
    for (int k = 0; k < 6; k++) {
        double unit[6] = {0}, wrench[6];
        unit[k] = 1;
        accelerate(wrench, c, unit, unit + 3);
        for (int i = 0; i <= k; i++) mass[i * n + k] = mass[k * n + i] = wrench[i];
    }
}

/* ---- regressor and Jacobian ---- */

/* The wrench of one unit of parameter `which` of a link: mass, first moments, moments of inertia. */
static void unit_wrench(double wrench[6], const motion *m, int which)
{
    static const int rows[6] = {0, 0, 0, 1, 1, 2}, columns[6] = {0, 1, 2, 1, 2, 2};
    memset(wrench, 0, 6 * sizeof *wrench);
    if (which == 0) {
        memcpy(wrench + 3, m->a, sizeof m->a);
    } else if (which < 4) {
        double unit[3] = {0}, inner[3];
        unit[which - 1] = 1;
        cross(wrench, unit, m->a);
        cross(wrench + 3, m->alpha, unit);
        cross(inner, m->omega, unit);
        add_cross(wrench + 3, m->omega, inner);
    } else {
        const int i = rows[which - 4], j = columns[which - 4];
        double spin[3] = {0};
        wrench[i] = m->alpha[j], wrench[j] = m->alpha[i];
        spin[i] = m->omega[j], spin[j] = m->omega[i];
        add_cross(wrench, m->omega, spin);
    }
}

void td_recursive_regressor(double *regressor, const td_robot *robot, const double *q, const double *nu,
                            const double *acceleration, const double gravity[3])
{
    const int columns = 10 * robot->link_count;
    td_link_place place[TD_ROBOT_MAX_LINKS];
    motion m[TD_ROBOT_MAX_LINKS];
    td_recursive_place(place, robot, q);
    move_links(m, robot, place, nu, acceleration, gravity);
    memset(regressor, 0, (size_t)((6 + robot->joint_count) * columns) * sizeof *regressor);
    for (int column = 0; column < columns; column++) {
        double wrench[6];
        unit_wrench(wrench, m + column / 10, column % 10);
        for (int at = column / 10; at > 0; at = robot->link[at].parent) {
            const td_robot_joint *joint = joint_of(robot, at);
            double up[6] = {0};
            if (joint) regressor[(6 + robot->link[at].joint) * columns + column] = at_joint(joint, wrench);
            add_to_parent(up, wrench, place + at);
            memcpy(wrench, up, sizeof up);
        }
        for (int row = 0; row < 6; row++) regressor[row * columns + column] = wrench[row];
    }
}

/* The velocity of a link, in its axes, by a unit of element `column` of nu. */
static void velocity_of(double velocity[6], const td_robot *robot, const td_link_place *place, int link,
                        int column)
{
    double chain[TD_ROBOT_MAX_LINKS][6] = {{0}};
    if (column < 6) chain[0][column] = 1;
    for (int i = 1; i <= link; i++) {
        double v[3];
        const double *parent = chain[robot->link[i].parent];
        const td_robot_joint *joint = joint_of(robot, i);
        memcpy(v, parent + 3, sizeof v);
        add_cross(v, parent, place[i].t);
        apply_back(chain[i], place[i].r, parent);
        apply_back(chain[i] + 3, place[i].r, v);
        if (joint && 6 + robot->link[i].joint == column)
            for (int k = 0; k < 3; k++)
                chain[i][k + (joint->kind == TD_JOINT_PRISMATIC ? 3 : 0)] += joint->axis[k];
    }
    memcpy(velocity, chain[link], sizeof chain[link]);
}

static void turn_to_base(double a[3], const td_robot *robot, const td_link_place *place, int link)
{
    for (int at = link; at > 0; at = robot->link[at].parent) {
        double turned[3];
        apply(turned, place[at].r, a);
        memcpy(a, turned, sizeof turned);
    }
}

void td_recursive_jacobian(double *jacobian, const td_robot *robot, const double *q, int link)
{
    const int n = 6 + robot->joint_count;
    td_link_place place[TD_ROBOT_MAX_LINKS];
    td_recursive_place(place, robot, q);
    for (int column = 0; column < n; column++) {
        double velocity[6];
        velocity_of(velocity, robot, place, link, column);
        turn_to_base(velocity, robot, place, link);
        turn_to_base(velocity + 3, robot, place, link);
        for (int i = 0; i < 6; i++) jacobian[i * n + column] = velocity[i];
    }
}
