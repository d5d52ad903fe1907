/* The machine's state: set, settled, read. */
#include <math.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/machine_internal.h"

void td_machine_close(double *y, const td_machine *m, const td_plant_state *s)
{
    const td_machine_layout l = td_machine_layout_of(m);
    memset(y, 0, (size_t)l.size * sizeof *y);
    if (l.pose >= 0) {
        memcpy(y + l.pose, s->site_from_vehicle.q, 4 * sizeof *y);
        memcpy(y + l.pose + 4, s->site_from_vehicle.t, 3 * sizeof *y);
        memcpy(y + l.nu, s->twist, 6 * sizeof *y);
    }
    for (int k = 0; k < l.n; k++) {
        y[l.q + k] = s->q[k];
        y[l.dq + k] = s->dq[k];
        y[l.force + k] = m->actuator[k].sign * s->force[k];
    }
}

/* ---- reset ---- */

static td_status check_joint(const td_machine *m, const td_plant_state *s, int k, td_error *error)
{
    const td_robot_joint *j = m->robot.joint + k;
    const char *robot = m->robot.name;
    if (!isfinite(s->q[k]) || !isfinite(s->dq[k]) || !isfinite(s->force[k]))
        return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': %s of joint '%s' is no number", robot,
                       !isfinite(s->q[k])    ? "the position"
                       : !isfinite(s->dq[k]) ? "the rate"
                                             : "the force",
                       j->name);
    if (s->q[k] < j->lower || s->q[k] > j->upper)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': joint '%s' at %.6g starts beyond its stops, %.6g to %.6g", robot,
                       j->name, s->q[k], j->lower, j->upper);
    double limit[2];
    td_machine_limit(limit, m, TD_COMMAND_FORCE, k);
    if (fabs(s->force[k]) > limit[s->force[k] > 0])
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': joint '%s' starts with a force of %.6g, beyond its limit of %.6g",
                       robot, j->name, s->force[k], limit[s->force[k] > 0]);
    return TD_OK;
}

static td_status check_base(const td_machine *m, const td_plant_state *s, td_error *error)
{
    bool ok = isfinite(s->time_s);
    double square = 0;
    for (int i = 0; i < 4; i++) square += s->site_from_vehicle.q[i] * s->site_from_vehicle.q[i];
    for (int i = 0; i < 3; i++) ok = ok && isfinite(s->site_from_vehicle.t[i]);
    for (int i = 0; i < 6; i++) ok = ok && isfinite(s->twist[i]);
    if (!ok || !(fabs(square - 1) < 1e-6))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': its base starts with a time, pose or twist that is no number, or a "
                       "quaternion not of length 1",
                       m->robot.name);
    return TD_OK;
}

static void take(td_machine *m)
{
    memset(&m->command, 0, sizeof m->command);
    memset(m->slope, 0, sizeof m->slope);
    m->command_s = m->t;
    m->changed = true;
}

td_status td_machine_reset(td_machine *m, const td_plant_state *state, td_error *error)
{
    TD_TRY(check_base(m, state, error));
    for (int k = 0; k < m->robot.joint_count; k++) TD_TRY(check_joint(m, state, k, error));
    td_machine_close(m->y, m, state);
    m->t = state->time_s;
    m->event_count = 0;
    take(m);
    return TD_OK;
}

/* ---- at rest ---- */

/* What is left of the suspension's wrench after gravity's, with the base moved by xi. */
static void unbalance(double wrench[6], const td_machine *m, const td_machine_view *rest, const double xi[6])
{
    td_machine_view v = *rest;
    double weight[TD_DYNAMICS_MAX];
    const td_pose step = td_pose_exp(xi);
    v.pose = td_pose_compose(&rest->pose, &step);
    const td_pose back = td_pose_inverse(&v.pose);
    td_pose_rotate(v.gravity, &back, m->options.gravity);
    td_suspension_wrench(wrench, m, &v);
    td_dynamics_gravity(weight, m->dynamics, v.q, v.gravity);
    for (int i = 0; i < 6; i++) wrench[i] -= weight[i];
}

/* Newton's method; the wrench is nearly linear in a turn of milliradians, so differences serve. */
static td_status sink(td_machine *m, td_machine_view *v, td_error *error)
{
    enum { MOST = 50 };
    static const double zero[6] = {0};
    v->pose = m->options.site_from_anchor;
    for (int round = 0; round < MOST; round++) {
        double wrench[6], jacobian[36], step[6], ahead[6], behind[6];
        unbalance(wrench, m, v, zero);
        for (int k = 0; k < 6; k++) {
            double xi[6] = {0};
            xi[k] = 1e-5;
            unbalance(ahead, m, v, xi);
            xi[k] = -1e-5;
            unbalance(behind, m, v, xi);
            for (int i = 0; i < 6; i++) jacobian[6 * i + k] = (behind[i] - ahead[i]) / 2e-5;
        }
        TD_TRY(td_least_squares_linear(step, NULL, jacobian, wrench, 6, 6, error));
        const td_pose moved = td_pose_exp(step);
        v->pose = td_pose_compose(&v->pose, &moved);
        double most = 0;
        for (int i = 0; i < 6; i++) most = fmax(most, fabs(step[i]));
        if (!isfinite(most) || td_pose_angle(&moved) > 1) break;
        if (most < 1e-13) return TD_OK;
        if (round > 8 && most < 1e-11) return TD_OK;
    }
    return td_fail(error, TD_ERROR_CONVERGENCE,
                   "machine '%s': its suspension finds no rest under its weight; it is too soft",
                   m->robot.name);
}

static td_status bear(td_machine *m, const td_machine_view *v, td_plant_state *s, td_error *error)
{
    double load[TD_DYNAMICS_MAX];
    td_dynamics_gravity(load, m->dynamics, v->q, v->gravity);
    for (int k = 0; k < m->robot.joint_count && m->options.hydraulics; k++) {
        double lever = 0, limit[2];
        if (!td_actuator_lever(&lever, m, k, v->q[k]))
            return td_fail(error, TD_ERROR_DATA, "machine '%s': the cylinder of joint '%s' does not reach",
                           m->robot.name, m->robot.joint[k].name);
        td_machine_limit(limit, m, TD_COMMAND_FORCE, k);
        s->force[k] = load[6 + k] / fabs(lever);
        if (fabs(s->force[k]) > limit[s->force[k] > 0])
            return td_fail(
                error, TD_ERROR_DATA,
                "machine '%s': joint '%s' cannot be held here; it needs %.6g N (N m), its limit is "
                "%.6g",
                m->robot.name, m->robot.joint[k].name, s->force[k], limit[s->force[k] > 0]);
    }
    return TD_OK;
}

td_status td_machine_settle(td_machine *m, td_error *error)
{
    td_machine_view v;
    td_plant_state s;
    td_machine_state(m, &s);
    td_machine_open(&v, m, m->y);
    memset(v.nu, 0, sizeof v.nu);
    memset(s.twist, 0, sizeof s.twist);
    memset(s.dq, 0, sizeof s.dq);
    memset(s.force, 0, sizeof s.force);
    if (m->options.base == TD_MACHINE_SUSPENDED) TD_TRY(sink(m, &v, error));
    const td_pose back = td_pose_inverse(&v.pose);
    td_pose_rotate(v.gravity, &back, m->options.gravity);
    s.site_from_vehicle = v.pose;
    TD_TRY(bear(m, &v, &s, error));
    td_machine_close(m->y, m, &s);
    take(m);
    return TD_OK;
}

/* ---- readings ---- */

void td_machine_joint_readings(td_plant_state *s, const td_machine *m, double t, const td_machine_view *v)
{
    double push[TD_ROBOT_MAX_JOINTS];
    td_hydraulics_push(push, m, t, v);
    for (int k = 0; k < m->robot.joint_count; k++) {
        const td_actuator *a = m->actuator + k;
        const td_robot_joint *j = m->robot.joint + k;
        s->q[k] = v->q[k];
        s->dq[k] = v->nu[6 + k];
        s->force[k] = a->sign * push[k];
        s->pressure[k] = a->sign * td_actuator_pressure(a, push[k]);
        s->flow[k] = a->sign * td_actuator_flow(a, v->valve[k]);
        s->at_stop[k] = v->q[k] <= j->lower || v->q[k] >= j->upper;
    }
}

void td_machine_state(const td_machine *m, td_plant_state *s)
{
    td_machine_view v;
    td_machine_open(&v, m, m->y);
    *s = (td_plant_state){.time_s = m->t, .site_from_vehicle = v.pose};
    memcpy(s->twist, v.nu, sizeof s->twist);
    td_machine_joint_readings(s, m, m->t, &v);
}

td_machine_energy td_machine_energies(const td_machine *m)
{
    td_machine_view v;
    const int n = m->robot.joint_count, all = 6 + n;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX];
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_machine_energy e = {0};
    td_machine_open(&v, m, m->y);
    td_dynamics_mass(mass, m->dynamics, v.q);
    for (int i = 0; i < all; i++)
        for (int k = 0; k < all; k++) e.kinetic += v.nu[i] * mass[i * all + k] * v.nu[k] / 2;
    td_robot_forward(at, &m->robot, v.q);
    for (int i = 0; i < m->robot.link_count; i++) {
        double root[3], site[3];
        td_pose_transform(root, at + i, m->robot.link[i].com_m);
        td_pose_transform(site, &v.pose, root);
        for (int c = 0; c < 3; c++) e.gravity -= m->robot.link[i].mass_kg * m->options.gravity[c] * site[c];
    }
    e.suspension = td_suspension_energy(m, &v);
    for (int k = 0; k < n; k++) {
        e.oil += v.force[k] * v.force[k] / (2 * m->options.oil_n_m);
        e.stops += td_stop_energy(m, k, v.q[k]);
    }
    e.contact = td_contact_energy(m, &v);
    e.total = e.kinetic + e.gravity + e.suspension + e.oil + e.stops + e.contact;
    return e;
}

void td_machine_momentum(double linear[3], double angular[3], const td_machine *m)
{
    td_machine_view v;
    const int all = 6 + m->robot.joint_count;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX], own[6] = {0};
    td_machine_open(&v, m, m->y);
    td_dynamics_mass(mass, m->dynamics, v.q);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < all; k++) own[i] += mass[i * all + k] * v.nu[k];
    const double *t = v.pose.t;
    td_pose_rotate(angular, &v.pose, own);
    td_pose_rotate(linear, &v.pose, own + 3);
    for (int i = 0; i < 3; i++)
        angular[i] += t[(i + 1) % 3] * linear[(i + 2) % 3] - t[(i + 2) % 3] * linear[(i + 1) % 3];
}
