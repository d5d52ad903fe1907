/* Forces on the base and at the joints, and with them the machine's equations y' = f(t, y). */
#include <math.h>
#include <string.h>

#include "sim/machine_internal.h"

void td_machine_cross(double c[3], const double a[3], const double b[3])
{
    for (int i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

void td_base_from_site(double in_base[3], const td_pose *site_from_base, const double in_site[3])
{
    const td_pose back = {
        .q = {site_from_base->q[0], -site_from_base->q[1], -site_from_base->q[2], -site_from_base->q[3]}};
    td_pose_rotate(in_base, &back, in_site);
}

void td_machine_open(td_machine_view *v, const td_machine *m, const double *y)
{
    const td_machine_layout l = td_machine_layout_of(m);
    const double *at = l.pose < 0 ? NULL : y + l.pose;
    v->pose = m->options.site_from_anchor;
    memset(v->nu, 0, 6 * sizeof *v->nu);
    if (at) {
        const double length = sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2] + at[3] * at[3]);
        for (int i = 0; i < 4; i++) v->pose.q[i] = at[i] / length;
        memcpy(v->pose.t, at + 4, sizeof v->pose.t);
        memcpy(v->nu, y + l.nu, 6 * sizeof *v->nu);
    }
    memcpy(v->q, y + l.q, (size_t)l.n * sizeof *v->q);
    memcpy(v->nu + 6, y + l.dq, (size_t)l.n * sizeof *v->nu);
    v->force = y + l.force;
    v->valve = y + l.valve;
    td_base_from_site(v->gravity, &v->pose, m->options.gravity);
}

/* ---- suspension ---- */

/* anchor_from_base, its quaternion on the side of the small turn. */
td_pose td_machine_sag(const td_machine *m, const td_machine_view *v)
{
    const td_pose back = td_pose_inverse(&m->options.site_from_anchor);
    td_pose d = td_pose_compose(&back, &v->pose);
    if (d.q[0] < 0)
        for (int i = 0; i < 4; i++) d.q[i] = -d.q[i];
    return d;
}

/* The moment is minus the gradient of 2 v' K v along omega, with v' = (w omega + v x omega) / 2. */
void td_suspension_wrench(double wrench[6], const td_machine *m, const td_machine_view *v)
{
    memset(wrench, 0, 6 * sizeof *wrench);
    if (m->options.base != TD_MACHINE_SUSPENDED) return;
    const td_pose d = td_machine_sag(m, v);
    double bent[3], aside[3], speed[3], push[3];
    for (int i = 0; i < 3; i++) bent[i] = m->spring[i] * d.q[1 + i];
    td_machine_cross(aside, bent, d.q + 1);
    for (int i = 0; i < 3; i++) wrench[i] = -2 * (d.q[0] * bent[i] + aside[i]) - m->damper[i] * v->nu[i];
    td_pose_rotate(speed, &d, v->nu + 3);
    for (int i = 0; i < 3; i++) push[i] = -m->spring[3 + i] * d.t[i] - m->damper[3 + i] * speed[i];
    td_base_from_site(wrench + 3, &d, push);
}

double td_suspension_energy(const td_machine *m, const td_machine_view *v)
{
    if (m->options.base != TD_MACHINE_SUSPENDED) return 0;
    const td_pose d = td_machine_sag(m, v);
    double energy = 0;
    for (int i = 0; i < 3; i++)
        energy += 2 * m->spring[i] * d.q[1 + i] * d.q[1 + i] + m->spring[3 + i] * d.t[i] * d.t[i] / 2;
    return energy;
}

/* ---- joints ---- */

/* How far a joint is beyond its stop: above 0 past the upper, below 0 past the lower one. */
static double beyond(const td_machine *m, int joint, double q)
{
    const td_robot_joint *j = m->robot.joint + joint;
    return q > j->upper ? q - j->upper : q < j->lower ? q - j->lower : 0;
}

double td_joint_torque(double *by_q, double *by_dq, const td_machine *m, int joint, double q, double dq)
{
    const td_machine_options *o = &m->options;
    const double slipping = tanh(dq / o->slip), past = beyond(m, joint, q), k = m->stop_n[joint];
    /* A stop pushes only: leaving fast, the joint is not pulled back. */
    const double damping = past > 0 ? o->stop_damping : -o->stop_damping,
                 pressed = past == 0 ? 0 : fmax(1 + damping * dq, 0);
    if (by_q) *by_q = -k * pressed;
    if (by_dq)
        *by_dq = -o->viscous[joint] - o->coulomb[joint] * (1 - slipping * slipping) / o->slip -
                 (pressed > 0 ? k * past * damping : 0);
    return -o->viscous[joint] * dq - o->coulomb[joint] * slipping - k * past * pressed;
}

double td_stop_energy(const td_machine *m, int joint, double q)
{
    const double past = beyond(m, joint, q);
    return m->stop_n[joint] * past * past / 2;
}

/* ---- equations of motion ---- */

bool td_machine_cholesky(double *a, int n)
{
    for (int i = 0; i < n; i++)
        for (int k = 0; k <= i; k++) {
            double sum = a[i * n + k];
            for (int j = 0; j < k; j++) sum -= a[i * n + j] * a[k * n + j];
            if (k < i)
                a[i * n + k] = sum / a[k * n + k];
            else if (sum > 0)
                a[i * n + i] = sqrt(sum);
            else
                return false;
        }
    return true;
}

void td_machine_cholesky_solve(double *x, const double *a, int n)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++) x[i] -= a[i * n + j] * x[j];
        x[i] /= a[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) x[i] -= a[j * n + i] * x[j];
        x[i] /= a[i * n + i];
    }
}

/* The base stands still: the joints' rows alone. */
static bool accelerate_fixed(double *acceleration, const td_machine *m, const td_machine_view *v,
                             const double *force)
{
    static const double rest[TD_DYNAMICS_MAX] = {0};
    const int n = m->robot.joint_count, all = 6 + n;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX], own[TD_ROBOT_MAX_JOINTS * TD_ROBOT_MAX_JOINTS];
    double bias[TD_DYNAMICS_MAX];
    td_dynamics_mass(mass, m->dynamics, v->q);
    td_dynamics_inverse(bias, m->dynamics, v->q, v->nu, rest, v->gravity, m->options.coriolis);
    memset(acceleration, 0, 6 * sizeof *acceleration);
    for (int i = 0; i < n; i++) {
        acceleration[6 + i] = force[6 + i] - bias[6 + i];
        for (int k = 0; k < n; k++) own[i * n + k] = mass[(6 + i) * all + 6 + k];
    }
    if (!td_machine_cholesky(own, n)) return false;
    td_machine_cholesky_solve(acceleration + 6, own, n);
    return true;
}

static void close_base(double *dy, const td_machine_layout *l, const double *y, const td_machine_view *v,
                       const double *acceleration)
{
    const double *quat = y + l->pose, *w = v->nu;
    double aside[3], spin[3];
    td_machine_cross(aside, quat + 1, w);
    dy[l->pose] = -(quat[1] * w[0] + quat[2] * w[1] + quat[3] * w[2]) / 2;
    for (int i = 0; i < 3; i++) dy[l->pose + 1 + i] = (quat[0] * w[i] + aside[i]) / 2;
    td_pose_rotate(dy + l->pose + 4, &v->pose, v->nu + 3);
    td_machine_cross(spin, w, v->nu + 3);
    for (int i = 0; i < 3; i++) {
        dy[l->nu + i] = acceleration[i];
        dy[l->nu + 3 + i] = acceleration[3 + i] - spin[i];
    }
}

/* Rates of force and valve into dy, and the joints' torques. */
static bool drive(double *dy, double *torque, const td_machine *m, double t, const td_machine_view *v)
{
    const td_machine_layout l = td_machine_layout_of(m);
    double lever[TD_ROBOT_MAX_JOINTS], push[TD_ROBOT_MAX_JOINTS];
    for (int k = 0; k < l.n; k++) {
        torque[k] = td_joint_torque(NULL, NULL, m, k, v->q[k], v->nu[6 + k]);
        if (m->options.hydraulics && !td_actuator_lever(lever + k, m, k, v->q[k])) return false;
    }
    memset(dy + l.force, 0, 2 * (size_t)l.n * sizeof *dy);
    if (!m->options.hydraulics) return true;
    td_hydraulics_rate(dy + l.force, dy + l.valve, push, m, t, v, lever);
    for (int k = 0; k < l.n; k++) torque[k] += lever[k] * push[k];
    return true;
}

bool td_machine_rate(double *dy, double t, const double *y, void *machine)
{
    const td_machine *m = machine;
    const td_machine_layout l = td_machine_layout_of(m);
    td_machine_view v;
    double force[TD_DYNAMICS_MAX], acceleration[TD_DYNAMICS_MAX];
    td_machine_open(&v, m, y);
    td_suspension_wrench(force, m, &v);
    if (!drive(dy, force + 6, m, t, &v)) return false;
    td_contact_force(force, m, &v);
    const bool ok = l.pose < 0 ? accelerate_fixed(acceleration, m, &v, force)
                               : td_dynamics_forward(acceleration, m->dynamics, v.q, v.nu, force, v.gravity,
                                                     m->options.coriolis);
    if (!ok) return false;
    if (l.pose >= 0) close_base(dy, &l, y, &v, acceleration);
    memcpy(dy + l.q, v.nu + 6, (size_t)l.n * sizeof *dy);
    memcpy(dy + l.dq, acceleration + 6, (size_t)l.n * sizeof *dy);
    return true;
}
