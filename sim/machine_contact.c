/* What the tool's point meets: a plane that pushes as a spring with Hunt and Crossley's damping (1975), and
 * rubs.
 *
 * In the base's axes, with p the point, v its velocity against the ground, n the normal, r the plane's point:
 * depth = -n.(p - r), N = k depth (1 - damping n.v), never below 0; F = N (n - mu h), h = w / sqrt(w^2 +
 * slip^2), w the part of v along the plane. The generalised force is A' F with A = d v / d nu. */
#include <math.h>
#include <string.h>

#include "sim/machine_internal.h"

/* The point and how it moves, in the base's axes. */
typedef struct touch {
    double point[3], velocity[3], normal[3];
    double by_nu[3][TD_DYNAMICS_MAX]; /* A */
    double depth;
} touch;

/* F, and its derivatives by the depth and by v. */
typedef struct push {
    double force[3], by_depth[3], by_velocity[3][3];
} push;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void place(double point[3], const td_machine *m, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, &m->robot, q);
    td_pose_transform(point, at + m->contact.link, m->contact.point_m);
}

/* The link's origin moves by v_o, the point by v_o + omega x (point - origin). */
static void point_jacobian(double by_nu[3][TD_DYNAMICS_MAX], double point[3], const td_machine *m,
                           const double *q)
{
    const int all = 6 + m->robot.joint_count;
    double link[6 * TD_DYNAMICS_MAX], arm[3];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, &m->robot, q);
    td_pose_transform(point, at + m->contact.link, m->contact.point_m);
    td_dynamics_jacobian(link, m->dynamics, q, m->contact.link);
    for (int i = 0; i < 3; i++) arm[i] = point[i] - at[m->contact.link].t[i];
    for (int c = 0; c < all; c++) {
        const double omega[3] = {link[c], link[all + c], link[2 * all + c]};
        double aside[3];
        td_machine_cross(aside, omega, arm);
        for (int i = 0; i < 3; i++) by_nu[i][c] = link[(3 + i) * all + c] + aside[i];
    }
}

static double depth_of(const td_machine *m, const td_pose *site_from_base, const double point[3])
{
    double site[3], depth = 0;
    td_pose_transform(site, site_from_base, point);
    for (int i = 0; i < 3; i++) depth += m->contact.normal[i] * (m->contact.plane_m[i] - site[i]);
    return depth;
}

static void reach(touch *t, const td_machine *m, const td_machine_view *v)
{
    point_jacobian(t->by_nu, t->point, m, v->q);
    for (int i = 0; i < 3; i++) {
        t->velocity[i] = 0;
        for (int c = 0; c < 6 + m->robot.joint_count; c++) t->velocity[i] += t->by_nu[i][c] * v->nu[c];
    }
    td_base_from_site(t->normal, &v->pose, m->contact.normal);
    t->depth = depth_of(m, &v->pose, t->point);
}

static void press(push *p, const td_machine *m, const touch *t)
{
    const td_machine_contact *c = &m->contact;
    const double *n = t->normal, into = -dot(n, t->velocity), pressed = fmax(1 + c->damping_s_m * into, 0);
    const double normal_n = t->depth > 0 ? c->stiffness_n_m * t->depth * pressed : 0;
    double along[3], h[3], by_n[3];
    *p = (push){0};
    if (!(t->depth > 0)) return;
    for (int i = 0; i < 3; i++) along[i] = t->velocity[i] + into * n[i];
    const double length = sqrt(dot(along, along) + c->slip_m_s * c->slip_m_s);
    for (int i = 0; i < 3; i++) {
        h[i] = along[i] / length;
        by_n[i] = pressed > 0 ? -c->stiffness_n_m * t->depth * c->damping_s_m * n[i] : 0;
    }
    for (int i = 0; i < 3; i++) {
        const double way = n[i] - c->friction * h[i];
        p->force[i] = normal_n * way;
        p->by_depth[i] = c->stiffness_n_m * pressed * way;
        for (int k = 0; k < 3; k++) {
            const double by_h = ((i == k) - n[i] * n[k] - h[i] * h[k]) / length;
            p->by_velocity[i][k] = way * by_n[k] - normal_n * c->friction * by_h;
        }
    }
}

/* A' F. */
static double on(const touch *t, const double force[3], int c)
{
    return t->by_nu[0][c] * force[0] + t->by_nu[1][c] * force[1] + t->by_nu[2][c] * force[2];
}

double td_contact_depth(const td_machine *m, const td_machine_view *v)
{
    double point[3];
    place(point, m, v->q);
    return depth_of(m, &v->pose, point);
}

void td_contact_force(double *force, const td_machine *m, const td_machine_view *v)
{
    touch t;
    push p;
    if (m->contact.link < 0 || !(td_contact_depth(m, v) > 0)) return;
    reach(&t, m, v);
    press(&p, m, &t);
    for (int c = 0; c < 6 + m->robot.joint_count; c++) force[c] += on(&t, p.force, c);
}

/* ---- derivatives ---- */

static void change_of(double force[3], const push *p, double depth, const double velocity[3])
{
    for (int i = 0; i < 3; i++) force[i] = p->by_depth[i] * depth + dot(p->by_velocity[i], velocity);
}

/* By a joint's angle: the point moves, and so does A; its change is a central difference. */
static void by_angle(double *column, const td_machine *m, const td_machine_view *v, const touch *t,
                     const push *p, int joint, double width)
{
    const int all = 6 + m->robot.joint_count;
    double ahead[3][TD_DYNAMICS_MAX], behind[3][TD_DYNAMICS_MAX], q[TD_ROBOT_MAX_JOINTS], unused[3];
    double moved[3], faster[3] = {0}, force[3];
    memcpy(q, v->q, sizeof q);
    q[joint] = v->q[joint] + width;
    point_jacobian(ahead, unused, m, q);
    q[joint] = v->q[joint] - width;
    point_jacobian(behind, unused, m, q);
    for (int i = 0; i < 3; i++) {
        moved[i] = t->by_nu[i][6 + joint];
        for (int c = 0; c < all; c++) {
            ahead[i][c] = (ahead[i][c] - behind[i][c]) / (2 * width);
            faster[i] += ahead[i][c] * v->nu[c];
        }
    }
    change_of(force, p, -dot(t->normal, moved), faster);
    for (int c = 0; c < all; c++)
        column[c] = on(t, force, c) + ahead[0][c] * p->force[0] + ahead[1][c] * p->force[1] +
                    ahead[2][c] * p->force[2];
}

/* By a turn of the base in its own axes: depth changes, v and A do not, and what is fixed to the site, F with
 * it, turns back: F' = dF/d depth depth' + dF/dv (e x v) - e x F. */
static void by_turn(double *column, const td_machine *m, const touch *t, const push *p, int axis)
{
    double e[3] = {0}, moved[3], faster[3], force[3], back[3];
    e[axis] = 1;
    td_machine_cross(moved, e, t->point);
    td_machine_cross(faster, e, t->velocity);
    change_of(force, p, -dot(t->normal, moved), faster);
    td_machine_cross(back, e, p->force);
    for (int i = 0; i < 3; i++) force[i] -= back[i];
    for (int c = 0; c < 6 + m->robot.joint_count; c++) column[c] = on(t, force, c);
}

bool td_contact_slopes(td_contact_slope *slope, const td_machine *m, const td_machine_view *v, double width)
{
    static const double still[3] = {0};
    const int all = 6 + m->robot.joint_count;
    touch t;
    push p;
    if (m->contact.link < 0 || !(td_contact_depth(m, v) > 0)) return false;
    reach(&t, m, v);
    press(&p, m, &t);
    for (int k = 0; k < all; k++) {
        const double faster[3] = {t.by_nu[0][k], t.by_nu[1][k], t.by_nu[2][k]};
        double force[3];
        change_of(force, &p, 0, faster);
        for (int c = 0; c < all; c++) slope->by_nu[k][c] = on(&t, force, c);
    }
    for (int k = 0; k < m->robot.joint_count; k++) by_angle(slope->by_q[k], m, v, &t, &p, k, width);
    for (int k = 0; k < 3; k++) {
        double force[3];
        by_turn(slope->by_turn[k], m, &t, &p, k);
        change_of(force, &p, -m->contact.normal[k], still);
        for (int c = 0; c < all; c++) slope->by_shift[k][c] = on(&t, force, c);
    }
    return true;
}

/* ---- what users see ---- */

static td_status check_contact(td_machine_contact *c, const td_machine *m, td_error *error)
{
    const char *robot = m->robot.name;
    double length = 0;
    bool known = true;
    if (c->link < 0 || c->link >= m->robot.link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': contact of link %d, but it has links 0 to %d",
                       robot, c->link, m->robot.link_count - 1);
    for (int i = 0; i < 3; i++) {
        known = known && isfinite(c->point_m[i]) && isfinite(c->plane_m[i]) && isfinite(c->normal[i]);
        length += c->normal[i] * c->normal[i];
    }
    if (!known || !(length > 1e-12))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': the contact's points are no numbers, or its normal has no length",
                       robot);
    for (int i = 0; i < 3; i++) c->normal[i] /= sqrt(length);
    if (!(c->stiffness_n_m > 0 && c->stiffness_n_m <= 1e12))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': the contact's stiffness %g N/m is not within 0 to 1e12", robot,
                       c->stiffness_n_m);
    if (!(c->damping_s_m >= 0 && c->damping_s_m <= 1e6) || !(c->friction >= 0 && c->friction <= 10) ||
        !(c->slip_m_s > 0 && c->slip_m_s <= 1e3))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "machine '%s': the contact's damping (%g s/m), friction (%g) and slip speed (%g m/s) must "
            "be within 0 to 1e6, 0 to 10, and above 0",
            robot, c->damping_s_m, c->friction, c->slip_m_s);
    return TD_OK;
}

td_machine_contact td_machine_contact_default(void)
{
    return (td_machine_contact){.link = -1,
                                .normal = {0, 0, 1},
                                .stiffness_n_m = 1e7,
                                .damping_s_m = 1,
                                .friction = 0.4,
                                .slip_m_s = 5e-3};
}

td_status td_machine_touch(td_machine *m, const td_machine_contact *contact, td_error *error)
{
    td_machine_contact c = contact ? *contact : td_machine_contact_default();
    if (contact) TD_TRY(check_contact(&c, m, error));
    m->contact = c;
    m->changed = true;
    return TD_OK;
}

double td_machine_contact_force(double force[3], const td_machine *m)
{
    td_machine_view v;
    touch t;
    push p;
    memset(force, 0, 3 * sizeof *force);
    if (m->contact.link < 0) return INFINITY;
    td_machine_open(&v, m, m->y);
    reach(&t, m, &v);
    press(&p, m, &t);
    td_pose_rotate(force, &v.pose, p.force);
    return -t.depth;
}

double td_contact_energy(const td_machine *m, const td_machine_view *v)
{
    if (m->contact.link < 0) return 0;
    const double depth = fmax(td_contact_depth(m, v), 0);
    return m->contact.stiffness_n_m * depth * depth / 2;
}
