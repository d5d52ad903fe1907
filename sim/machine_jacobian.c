/* d y' / d y of the machine.
 *
 * With M a + h = f, h the velocity and gravity terms and f the forces, a' = M^-1 (f' - (M a + h)' at fixed
 * a). M a + h is inverse dynamics: quadratic in the velocities and linear in gravity, so differences over any
 * width are exact there; by the angles they are central differences. All else is written out. */
#include <math.h>
#include <string.h>

#include "sim/machine_internal.h"

/* By the angles, rad: an error of 1e-10 of the second derivative's size, and of rounding. */
static const double WIDTH = 1e-5;

/* What the columns of f' - (M a + h)' are built from. `rows` (6+n, size). */
typedef struct work {
    const td_machine *m;
    td_machine_layout l;
    td_machine_view v;
    double acceleration[TD_DYNAMICS_MAX];
    double by_quaternion[12]; /* (3,4) turn in the base's axes by the quaternion's parts */
    double *rows;
} work;

static double *at(work *w, int row, int column)
{
    return w->rows + row * w->l.size + column;
}

static void inverse(double *force, const work *w, const td_machine_view *v)
{
    td_dynamics_inverse(force, w->m->dynamics, v->q, v->nu, w->acceleration, v->gravity,
                        w->m->options.coriolis);
}

static void subtract_difference(work *w, int column, const double *ahead, const double *behind, double width)
{
    for (int i = 0; i < 6 + w->l.n; i++) *at(w, i, column) -= (ahead[i] - behind[i]) / width;
}

/* Inverse dynamics by angles and velocities. */
static void by_motion(work *w)
{
    double ahead[TD_DYNAMICS_MAX], behind[TD_DYNAMICS_MAX];
    td_machine_view v = w->v;
    for (int k = 0; k < w->l.n; k++) {
        v.q[k] = w->v.q[k] + WIDTH;
        inverse(ahead, w, &v);
        v.q[k] = w->v.q[k] - WIDTH;
        inverse(behind, w, &v);
        v.q[k] = w->v.q[k];
        subtract_difference(w, w->l.q + k, ahead, behind, 2 * WIDTH);
    }
    for (int k = w->l.nu < 0 ? 6 : 0; k < 6 + w->l.n && w->m->options.coriolis; k++) {
        v.nu[k] = w->v.nu[k] + 1;
        inverse(ahead, w, &v);
        v.nu[k] = w->v.nu[k] - 1;
        inverse(behind, w, &v);
        v.nu[k] = w->v.nu[k];
        subtract_difference(w, k < 6 ? w->l.nu + k : w->l.dq + k - 6, ahead, behind, 2);
    }
}

/* ---- the base ---- */

static void add_turn_column(work *w, int row, int turn, double value)
{
    for (int c = 0; c < 4; c++) *at(w, row, w->l.pose + c) += value * w->by_quaternion[4 * turn + c];
}

/* turn = 2 vec(conj(q) d) / |q|. */
static void make_by_quaternion(work *w, const double *y)
{
    const double *q = y + w->l.pose;
    const double square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        double *row = w->by_quaternion + 4 * i;
        row[0] = -2 * q[1 + i] / square;
        row[1 + i] = 2 * q[0] / square;
        row[1 + j] = 2 * q[1 + k] / square;
        row[1 + k] = -2 * q[1 + j] / square;
    }
}

/* Gravity turns against the base: d g = g x turn. */
static void by_gravity(work *w)
{
    static const double rest[TD_DYNAMICS_MAX] = {0};
    double unit[3][TD_DYNAMICS_MAX];
    for (int c = 0; c < 3; c++) {
        double e[3] = {0};
        e[c] = 1;
        td_dynamics_inverse(unit[c], w->m->dynamics, w->v.q, rest, rest, e, false);
    }
    for (int turn = 0; turn < 3; turn++) {
        double e[3] = {0}, change[3];
        e[turn] = 1;
        td_machine_cross(change, w->v.gravity, e);
        for (int i = 0; i < 6 + w->l.n; i++)
            add_turn_column(w, i, turn,
                            -(unit[0][i] * change[0] + unit[1][i] * change[1] + unit[2][i] * change[2]));
    }
}

/* By a unit turn in the base's axes; the notation of td_suspension_wrench. */
static void suspension_turn(work *w, const td_pose *d, const double *wrench, int turn)
{
    const double *k = w->m->spring, *damper = w->m->damper, *v = d->q + 1;
    double e[3] = {0}, aside[3], dv[3], bent[3], dbent[3], one[3], two[3], moved[3], speed[3], push[3],
           out[3];
    e[turn] = 1;
    td_machine_cross(aside, v, e);
    const double dw = -v[turn] / 2;
    for (int i = 0; i < 3; i++) {
        dv[i] = (d->q[0] * e[i] + aside[i]) / 2;
        bent[i] = k[i] * v[i];
        dbent[i] = k[i] * dv[i];
    }
    td_machine_cross(one, dbent, v);
    td_machine_cross(two, bent, dv);
    for (int i = 0; i < 3; i++)
        add_turn_column(w, i, turn, -2 * (dw * bent[i] + d->q[0] * dbent[i] + one[i] + two[i]));
    td_machine_cross(moved, e, w->v.nu + 3);
    td_pose_rotate(speed, d, moved);
    for (int i = 0; i < 3; i++) push[i] = -damper[3 + i] * speed[i];
    td_base_from_site(out, d, push);
    td_machine_cross(aside, e, wrench + 3);
    for (int i = 0; i < 3; i++) add_turn_column(w, 3 + i, turn, out[i] - aside[i]);
}

static void by_suspension(work *w)
{
    const td_machine *m = w->m;
    const td_pose d = td_machine_sag(m, &w->v);
    double wrench[6];
    if (m->options.base != TD_MACHINE_SUSPENDED) return;
    td_suspension_wrench(wrench, m, &w->v);
    for (int c = 0; c < 3; c++) {
        double e[3] = {0}, shift[3], speed[3], out[3], damped[3];
        e[c] = 1;
        suspension_turn(w, &d, wrench, c);
        *at(w, c, w->l.nu + c) -= m->damper[c];
        td_base_from_site(shift, &m->options.site_from_anchor, e);
        td_pose_rotate(speed, &d, e);
        for (int i = 0; i < 3; i++) {
            shift[i] *= -m->spring[3 + i];
            speed[i] *= -m->damper[3 + i];
        }
        td_base_from_site(out, &d, shift);
        td_base_from_site(damped, &d, speed);
        for (int i = 0; i < 3; i++) {
            *at(w, 3 + i, w->l.pose + 4 + c) += out[i];
            *at(w, 3 + i, w->l.nu + 3 + c) += damped[i];
        }
    }
}

/* ---- joints ---- */

static bool by_joints(work *w, double *j, double t)
{
    const td_machine *m = w->m;
    const td_machine_layout *l = &w->l;
    const bool oil = m->options.hydraulics;
    double lever[TD_ROBOT_MAX_JOINTS], slope[TD_ROBOT_MAX_JOINTS], push[TD_ROBOT_MAX_JOINTS];
    td_hydraulics_slope h[TD_ROBOT_MAX_JOINTS];
    for (int k = 0; k < l->n && oil; k++) {
        double ahead, behind;
        if (!td_actuator_lever(lever + k, m, k, w->v.q[k]) ||
            !td_actuator_lever(&ahead, m, k, w->v.q[k] + WIDTH) ||
            !td_actuator_lever(&behind, m, k, w->v.q[k] - WIDTH))
            return false;
        slope[k] = (ahead - behind) / (2 * WIDTH);
    }
    if (oil) td_hydraulics_slopes(h, push, m, t, &w->v, lever, slope);
    for (int k = 0; k < l->n; k++) {
        const int column[4] = {l->q + k, l->dq + k, l->force + k, l->valve + k};
        double by_q, by_dq;
        td_joint_torque(&by_q, &by_dq, m, k, w->v.q[k], w->v.nu[6 + k]);
        *at(w, 6 + k, column[0]) += by_q;
        *at(w, 6 + k, column[1]) += by_dq;
        for (int i = 0; i < 4 && oil; i++) {
            *at(w, 6 + k, column[i]) += lever[k] * h[k].push[i] + (i == 0 ? slope[k] * push[k] : 0);
            j[(l->force + k) * l->size + column[i]] = h[k].force[i];
            j[(l->valve + k) * l->size + column[i]] = h[k].valve[i];
        }
    }
    return true;
}

static void by_contact(work *w)
{
    const td_machine_layout *l = &w->l;
    td_contact_slope s;
    if (!td_contact_slopes(&s, w->m, &w->v, WIDTH)) return;
    for (int i = 0; i < 6 + l->n; i++) {
        for (int k = 0; k < l->n; k++) {
            *at(w, i, l->q + k) += s.by_q[k][i];
            *at(w, i, l->dq + k) += s.by_nu[6 + k][i];
        }
        for (int k = 0; k < 6 && l->nu >= 0; k++) *at(w, i, l->nu + k) += s.by_nu[k][i];
        for (int k = 0; k < 3 && l->pose >= 0; k++) {
            add_turn_column(w, i, k, s.by_turn[k][i]);
            *at(w, i, l->pose + 4 + k) += s.by_shift[k][i];
        }
    }
}

/* ---- all together ---- */

/* Rows of the accelerations: M^-1 times the columns. */
static bool accelerations(work *w, double *j)
{
    const td_machine_layout *l = &w->l;
    const int all = 6 + l->n, first = l->pose < 0 ? 6 : 0, n = all - first;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX], own[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX];
    td_dynamics_mass(mass, w->m->dynamics, w->v.q);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) own[i * n + k] = mass[(first + i) * all + first + k];
    if (!td_machine_cholesky(own, n)) return false;
    for (int c = 0; c < l->size; c++) {
        double x[TD_DYNAMICS_MAX];
        for (int i = 0; i < n; i++) x[i] = *at(w, first + i, c);
        td_machine_cholesky_solve(x, own, n);
        for (int i = 0; i < n; i++) {
            const int row = first + i;
            j[(row < 6 ? l->nu + row : l->dq + row - 6) * l->size + c] = x[i];
        }
    }
    return true;
}

/* Rows of the pose, and what v' has besides the acceleration: - omega x v. */
static void kinematics(work *w, double *j, const double *y)
{
    const td_machine_layout *l = &w->l;
    const double *quat = y + l->pose, *o = w->v.nu, *speed = w->v.nu + 3;
    const int size = l->size;
    for (int c = 0; c < 3; c++) {
        double e[3] = {0}, aside[3], turned[3], moved[3];
        e[c] = 1;
        double *const row = j + (l->pose + 1 + c) * size;
        j[l->pose * size + l->pose + 1 + c] = -o[c] / 2;
        row[l->pose] = o[c] / 2;
        td_machine_cross(aside, e, o); /* of v x omega by v */
        for (int i = 0; i < 3; i++) j[(l->pose + 1 + i) * size + l->pose + 1 + c] += aside[i] / 2;
        j[l->pose * size + l->nu + c] = -quat[1 + c] / 2;
        td_machine_cross(aside, quat + 1, e);
        for (int i = 0; i < 3; i++)
            j[(l->pose + 1 + i) * size + l->nu + c] = (aside[i] + (i == c) * quat[0]) / 2;
        td_pose_rotate(turned, &w->v.pose, e);
        td_machine_cross(aside, e, speed);
        td_pose_rotate(moved, &w->v.pose, aside);
        for (int i = 0; i < 3; i++) {
            j[(l->pose + 4 + i) * size + l->nu + 3 + c] = turned[i];
            for (int p = 0; p < 4; p++)
                j[(l->pose + 4 + i) * size + l->pose + p] += moved[i] * w->by_quaternion[4 * c + p];
        }
        for (int i = 0; i < 3; i++) j[(l->nu + 3 + i) * size + l->nu + c] -= aside[i];
        td_machine_cross(aside, o, e);
        for (int i = 0; i < 3; i++) j[(l->nu + 3 + i) * size + l->nu + 3 + c] -= aside[i];
    }
}

bool td_machine_jacobian(double *j, double t, const double *y, const double *dy, void *machine)
{
    td_machine *m = machine;
    work w = {.m = m, .l = td_machine_layout_of(m), .rows = m->rows};
    const td_machine_layout *l = &w.l;
    const size_t size = (size_t)l->size;
    td_machine_open(&w.v, m, y);
    memset(j, 0, size * size * sizeof *j);
    memset(w.rows, 0, (size_t)(6 + l->n) * size * sizeof *w.rows);
    if (l->pose >= 0) {
        double spin[3];
        td_machine_cross(spin, w.v.nu, w.v.nu + 3);
        for (int i = 0; i < 6; i++) w.acceleration[i] = dy[l->nu + i] + (i < 3 ? 0 : spin[i - 3]);
        make_by_quaternion(&w, y);
        by_gravity(&w);
        by_suspension(&w);
    }
    memcpy(w.acceleration + 6, dy + l->dq, (size_t)l->n * sizeof *dy);
    by_motion(&w);
    by_contact(&w);
    if (!by_joints(&w, j, t) || !accelerations(&w, j)) return false;
    for (int k = 0; k < l->n; k++) j[(l->q + k) * l->size + l->dq + k] = 1;
    if (l->pose >= 0) kinematics(&w, j, y);
    return true;
}
