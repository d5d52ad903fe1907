/* Forward dynamics without a compiler: articulated bodies (Featherstone 2008, table 7.1 with a free base,
 * section 9.4). Spatial vectors are [omega; v] and [moment; force] about each link's origin, in its axes. The
 * base's origin is taken at rest: laws of motion are the same in a frame that moves along with it. */
#include <math.h>
#include <string.h>

#include "sim/dynamics_recursive_internal.h"

typedef struct articulated {
    double x[36];                /* takes motion of the parent to the link */
    double s[6], v[6], c[6];     /* joint's direction; velocity; v x s rate */
    double inertia[36], bias[6]; /* articulated */
    double u[6], d, rest, a[6];  /* inertia s; s u; joint force less bias; acceleration */
} articulated;

static double dot(const double *a, const double *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++) sum += a[i] * b[i];
    return sum;
}

static void apply(double y[6], const double m[36], const double x[6])
{
    for (int i = 0; i < 6; i++) y[i] = dot(m + 6 * i, x, 6);
}

static void add_cross(double c[3], const double a[3], const double b[3], double sign)
{
    c[0] += sign * (a[1] * b[2] - a[2] * b[1]);
    c[1] += sign * (a[2] * b[0] - a[0] * b[2]);
    c[2] += sign * (a[0] * b[1] - a[1] * b[0]);
}

/* [R^T 0; -R^T [t] R^T]: omega' = R^T omega, v' = R^T (v + omega x t). */
static void set_transform(double x[36], const td_link_place *place)
{
    const double *r = place->r, *t = place->t;
    memset(x, 0, 36 * sizeof *x);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const int k = (j + 1) % 3, l = (j + 2) % 3;
            x[6 * i + j] = x[6 * (3 + i) + 3 + j] = r[3 * j + i];
            /* (omega x t) . column i of r = omega . (t x column) */
            x[6 * (3 + i) + j] = t[k] * r[3 * l + i] - t[l] * r[3 * k + i];
        }
}

static void set_inertia(double m[36], const td_robot_link *link)
{
    const double *c = link->com_m, mass = link->mass_kg;
    memset(m, 0, 36 * sizeof *m);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        m[6 * (3 + i) + 3 + i] = mass;
        m[6 * j + 3 + k] = m[6 * (3 + k) + j] = -mass * c[i];
        m[6 * k + 3 + j] = m[6 * (3 + j) + k] = mass * c[i];
        for (int l = 0; l < 3; l++)
            m[6 * i + l] = link->inertia[3 * i + l] + mass * ((i == l ? dot(c, c, 3) : 0) - c[i] * c[l]);
    }
}

/* v x* f: the rate of a momentum f carried along with v. */
static void carry(double y[6], const double v[6], const double f[6])
{
    memset(y, 0, 6 * sizeof *y);
    add_cross(y, v, f, 1);
    add_cross(y, v + 3, f + 3, 1);
    add_cross(y + 3, v, f + 3, 1);
}

static void start_link(articulated *b, const td_robot *robot, int i, const td_link_place *place,
                       const double *nu)
{
    articulated *link = b + i;
    const int k = robot->link[i].joint;
    double momentum[6];
    memset(link, 0, sizeof *link);
    set_transform(link->x, place + i);
    if (i == 0)
        memcpy(link->v, nu, 3 * sizeof *nu);
    else
        apply(link->v, link->x, b[robot->link[i].parent].v);
    if (k >= 0) {
        const td_robot_joint *joint = robot->joint + k;
        memcpy(link->s + (joint->kind == TD_JOINT_PRISMATIC ? 3 : 0), joint->axis, sizeof joint->axis);
        double step[6];
        for (int l = 0; l < 6; l++) {
            step[l] = nu[6 + k] * link->s[l];
            link->v[l] += step[l];
        }
        add_cross(link->c, link->v, step, 1);
        add_cross(link->c + 3, link->v, step + 3, 1);
        add_cross(link->c + 3, link->v + 3, step, 1);
    }
    set_inertia(link->inertia, robot->link + i);
    apply(momentum, link->inertia, link->v);
    carry(link->bias, link->v, momentum);
}

/* Parent += X^T inertia X, X^T bias. */
static void hand_down(articulated *parent, const articulated *link, const double inertia[36],
                      const double bias[6])
{
    double half[36];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += inertia[6 * i + k] * link->x[6 * k + j];
            half[6 * i + j] = sum;
        }
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 6; k++) {
            const double x = link->x[6 * k + i];
            for (int j = 0; j < 6; j++) parent->inertia[6 * i + j] += x * half[6 * k + j];
            parent->bias[i] += x * bias[k];
        }
}

/* A link's articulated inertia, its own joint giving way, to its parent. False: the joint moves no mass. */
static bool reduce(articulated *b, const td_robot *robot, int i, const double *force)
{
    articulated *link = b + i;
    const int k = robot->link[i].joint;
    double inertia[36], bias[6];
    memcpy(inertia, link->inertia, sizeof inertia);
    memcpy(bias, link->bias, sizeof bias);
    if (k >= 0) {
        double size = 0;
        for (int l = 0; l < 36; l++) size = fmax(size, fabs(inertia[l]));
        apply(link->u, inertia, link->s);
        link->d = dot(link->s, link->u, 6);
        link->rest = force[6 + k] - dot(link->s, bias, 6);
        if (!(link->d > 1e-13 * size)) return false;
        for (int l = 0; l < 36; l++) inertia[l] -= link->u[l / 6] * link->u[l % 6] / link->d;
        for (int l = 0; l < 6; l++)
            bias[l] += dot(inertia + 6 * l, link->c, 6) + link->u[l] * link->rest / link->d;
    }
    hand_down(b + robot->link[i].parent, link, inertia, bias);
    return true;
}

/* m x = x by L D L^T, symmetric positive definite; rows and columns scaled by their diagonal first. */
static bool solve_base(double x[6], const double m[36])
{
    double scale[6], a[36], y[6];
    for (int i = 0; i < 6; i++) {
        if (!(m[7 * i] > 0)) return false;
        scale[i] = 1 / sqrt(m[7 * i]);
        y[i] = x[i] * scale[i];
    }
    for (int i = 0; i < 36; i++) a[i] = m[i] * scale[i / 6] * scale[i % 6];
    for (int k = 0; k < 6; k++) {
        if (!(a[7 * k] > 1e-13)) return false;
        for (int i = k + 1; i < 6; i++) {
            const double factor = a[6 * i + k] / a[7 * k];
            for (int j = k; j < 6; j++) a[6 * i + j] -= factor * a[6 * k + j];
            y[i] -= factor * y[k];
        }
    }
    for (int k = 5; k >= 0; k--) y[k] = (y[k] - dot(a + 6 * k + k + 1, y + k + 1, 5 - k)) / a[7 * k];
    for (int i = 0; i < 6; i++) x[i] = y[i] * scale[i];
    return true;
}

static void answer(double *acceleration, articulated *b, const td_robot *robot, const double gravity[3])
{
    for (int i = 1; i < robot->link_count; i++) {
        articulated *link = b + i;
        const int k = robot->link[i].joint;
        apply(link->a, link->x, b[robot->link[i].parent].a);
        if (k < 0) continue;
        for (int l = 0; l < 6; l++) link->a[l] += link->c[l];
        acceleration[6 + k] = (link->rest - dot(link->u, link->a, 6)) / link->d;
        for (int l = 0; l < 6; l++) link->a[l] += acceleration[6 + k] * link->s[l];
    }
    for (int l = 0; l < 6; l++) acceleration[l] = b[0].a[l] + (l < 3 ? 0 : gravity[l - 3]);
}

bool td_recursive_forward(double *acceleration, const td_robot *robot, const double *q, const double *nu,
                          const double *force, const double gravity[3], bool coriolis)
{
    static const double rest[TD_DYNAMICS_MAX] = {0};
    td_link_place place[TD_ROBOT_MAX_LINKS];
    articulated b[TD_ROBOT_MAX_LINKS];
    td_recursive_place(place, robot, q);
    for (int i = 0; i < robot->link_count; i++) start_link(b, robot, i, place, coriolis ? nu : rest);
    for (int i = robot->link_count - 1; i > 0; i--)
        if (!reduce(b, robot, i, force)) return false;
    for (int l = 0; l < 6; l++) b[0].a[l] = force[l] - b[0].bias[l];
    if (!solve_base(b[0].a, b[0].inertia)) return false;
    answer(acceleration, b, robot, gravity);
    return true;
}
