/* The robot as ODE's bodies and joints: its place, its drives, and the step in its own coordinates. */
#include <math.h>
#include <string.h>

#include "sim/world_internal.h"

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- from links to bodies ---- */

/* Adds a link's mass, mass times centre and second moments about the body's origin (xx xy xz yy yz zz as a
 * full matrix) to the sums. */
static void add_link(double sum[13], const td_robot_link *link, const td_pose *body_from_link)
{
    double r[9], c[3], turned[9] = {0};
    td_pose_rotation(r, body_from_link);
    td_pose_transform(c, body_from_link, link->com_m);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    turned[3 * i + k] += r[3 * i + a] * link->inertia[3 * a + b] * r[3 * k + b];
    sum[0] += link->mass_kg;
    for (int i = 0; i < 3; i++) sum[1 + i] += link->mass_kg * c[i];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            sum[4 + 3 * i + k] += turned[3 * i + k] + link->mass_kg * ((i == k) * dot(c, c) - c[i] * c[k]);
}

static void centre(td_world_body *b, const double sum[13])
{
    b->mass = sum[0];
    for (int i = 0; i < 3 && sum[0] > 0; i++) b->com[i] = sum[1 + i] / sum[0];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            b->inertia[3 * i + k] =
                sum[4 + 3 * i + k] - b->mass * ((i == k) * dot(b->com, b->com) - b->com[i] * b->com[k]);
}

/* Links fixed to one another become one body. */
static void group_links(td_world *w, double sum[][13])
{
    const td_robot *r = &w->machine->robot;
    for (int i = 0; i < r->link_count; i++) {
        const td_robot_link *link = r->link + i;
        const int above = link->parent < 0 ? -1 : w->body_of[link->parent];
        if (link->parent >= 0 && link->joint < 0) {
            w->body_of[i] = above;
            w->body_from_link[i] = td_pose_compose(w->body_from_link + link->parent, &link->parent_from_link);
        } else {
            td_world_body *b = w->body + w->body_count;
            w->body_of[i] = w->body_count++;
            w->body_from_link[i] = td_pose_identity();
            *b =
                (td_world_body){.parent = above, .joint = link->joint, .link = i, .pose = td_pose_identity()};
            if (above >= 0) {
                const td_robot_joint *j = r->joint + link->joint;
                b->parent_from_body =
                    td_pose_compose(w->body_from_link + link->parent, &link->parent_from_link);
                memcpy(b->axis, j->axis, sizeof b->axis);
                b->slides = j->kind == TD_JOINT_PRISMATIC;
            }
        }
        add_link(sum[w->body_of[i]], link, w->body_from_link + i);
    }
}

static td_status make_body(td_world *w, td_world_body *b, td_error *error)
{
    const td_robot *r = &w->machine->robot;
    double factor[9];
    dMass mass;
    memcpy(factor, b->inertia, sizeof factor);
    if (!(b->mass > 0) || !td_machine_cholesky(factor, 3))
        return td_fail(error, TD_ERROR_DATA,
                       "world: link '%s' of machine '%s' has no mass, or no inertia about each axis; give it "
                       "an <inertial>",
                       r->link[b->link].name, r->name);
    b->ode = dBodyCreate(w->ode);
    dMassSetParameters(&mass, b->mass, 0, 0, 0, b->inertia[0], b->inertia[4], b->inertia[8], b->inertia[1],
                       b->inertia[2], b->inertia[5]);
    dBodySetMass(b->ode, &mass);
    dBodySetGyroscopicMode(b->ode, 0); /* with the other products of velocities, in td_world_load */
    return TD_OK;
}

static void make_joint(td_world *w, td_world_body *b)
{
    const dBodyID parent = w->body[b->parent].ode;
    if (b->slides) {
        b->motor = dJointCreateSlider(w->ode, NULL);
        dJointAttach(b->motor, b->ode, parent);
        dJointSetSliderAxis(b->motor, b->way[0], b->way[1], b->way[2]);
        dJointSetSliderParam(b->motor, dParamFMax, dInfinity);
    } else {
        b->motor = dJointCreateHinge(w->ode, NULL);
        dJointAttach(b->motor, b->ode, parent);
        dJointSetHingeAnchor(b->motor, b->pose.t[0], b->pose.t[1], b->pose.t[2]);
        dJointSetHingeAxis(b->motor, b->way[0], b->way[1], b->way[2]);
        dJointSetHingeParam(b->motor, dParamFMax, dInfinity);
    }
}

static void put_body(td_world_body *b)
{
    dBodySetPosition(b->ode, b->at[0], b->at[1], b->at[2]);
    dBodySetQuaternion(b->ode, b->pose.q);
}

td_status td_world_build_robot(td_world *w, td_error *error)
{
    double sum[1 + TD_ROBOT_MAX_JOINTS][13] = {{0}};
    const bool fixed = w->options.machine.base == TD_MACHINE_FIXED;
    group_links(w, sum);
    for (int i = 0; i < w->body_count; i++) {
        centre(w->body + i, sum[i]);
        if (i > 0 || !fixed) TD_TRY(make_body(w, w->body + i, error));
    }
    w->body[0].pose = w->options.machine.site_from_anchor;
    td_world_place(w);
    for (int i = 0; i < w->body_count; i++)
        if (w->body[i].ode) put_body(w->body + i);
    for (int i = 1; i < w->body_count; i++) make_joint(w, w->body + i);
    return TD_OK;
}

/* ---- kinematics ---- */

static void to_site(double out[3], const td_world_body *b, const double v[3])
{
    for (int i = 0; i < 3; i++) out[i] = dot(b->turn + 3 * i, v);
}

static void from_site(double out[3], const td_world_body *b, const double v[3])
{
    for (int i = 0; i < 3; i++) out[i] = b->turn[i] * v[0] + b->turn[3 + i] * v[1] + b->turn[6 + i] * v[2];
}

void td_world_place(td_world *w)
{
    for (int i = 0; i < w->body_count; i++) {
        td_world_body *b = w->body + i;
        if (i > 0) {
            td_pose motion = td_pose_identity();
            const double q = w->q[b->joint], s = b->slides ? 0 : sin(q / 2);
            if (!b->slides) motion.q[0] = cos(q / 2);
            for (int c = 0; c < 3; c++) {
                motion.q[1 + c] = s * b->axis[c];
                motion.t[c] = b->slides ? q * b->axis[c] : 0;
            }
            const td_pose at = td_pose_compose(&w->body[b->parent].pose, &b->parent_from_body);
            b->pose = td_pose_compose(&at, &motion);
        }
        td_pose_rotation(b->turn, &b->pose);
        to_site(b->way, b, b->axis);
        to_site(b->at, b, b->com);
        for (int c = 0; c < 3; c++) b->at[c] += b->pose.t[c];
    }
}

double td_world_time(const td_world *w)
{
    return w->begun_s + (double)w->steps * w->options.step_s;
}

void td_world_view(td_machine_view *v, const td_world *w)
{
    const size_t n = (size_t)w->machine->robot.joint_count;
    memcpy(v->q, w->q, n * sizeof *v->q);
    for (size_t k = 0; k < n; k++) v->nu[6 + k] = w->velocity[6 + k] + w->ahead[6 + k];
    v->force = w->force;
    v->valve = w->valve;
}

/* Motion of a body: of its centre of mass, and the accelerations that the products of velocities make. */
typedef struct body_motion {
    double omega[3], v[3], alpha[3], a[3];
} body_motion;

static void turn_point(double v[3], double a[3], const body_motion *m, const double r[3])
{
    double first[3], second[3], slow[3];
    td_machine_cross(first, m->omega, r);
    td_machine_cross(second, m->omega, first);
    td_machine_cross(slow, m->alpha, r);
    for (int c = 0; c < 3; c++) {
        v[c] = m->v[c] + first[c];
        a[c] = m->a[c] + second[c] + slow[c];
    }
}

/* From parent to child: over the child's origin to its centre of mass. */
static void carry(body_motion *m, const body_motion *parent, const td_world_body *above,
                  const td_world_body *b, double rate)
{
    double r[3], d[3], cross[3];
    body_motion o = *parent;
    for (int c = 0; c < 3; c++) r[c] = b->pose.t[c] - above->at[c], d[c] = b->at[c] - b->pose.t[c];
    turn_point(o.v, o.a, parent, r);
    td_machine_cross(cross, parent->omega, b->way);
    for (int c = 0; c < 3; c++)
        if (b->slides) {
            o.v[c] += rate * b->way[c];
            o.a[c] += 2 * rate * cross[c];
        } else {
            o.omega[c] += rate * b->way[c];
            o.alpha[c] += rate * cross[c];
        }
    *m = o;
    turn_point(m->v, m->a, &o, d);
}

static void move_all(body_motion *motion, const td_world *w, const double *velocity)
{
    memset(motion, 0, sizeof *motion);
    memcpy(motion[0].omega, velocity, 3 * sizeof *velocity);
    memcpy(motion[0].v, velocity + 3, 3 * sizeof *velocity);
    for (int i = 1; i < w->body_count; i++) {
        const td_world_body *b = w->body + i;
        carry(motion + i, motion + b->parent, w->body + b->parent, b, velocity[6 + b->joint]);
    }
}

void td_world_base_velocity(double v[3], const td_world *w, const double at[3])
{
    double r[3], turn[3];
    for (int c = 0; c < 3; c++) r[c] = at[c] - w->body[0].at[c];
    td_machine_cross(turn, w->velocity, r);
    for (int c = 0; c < 3; c++) v[c] = w->velocity[3 + c] + turn[c];
}

/* ---- a step ---- */

/* -m a, and -(I alpha + omega x I omega): what ODE's bodies, whose joints it holds by velocity, lack. */
static void push_products(const td_world_body *b, const body_motion *m)
{
    double own_w[3], own_a[3], spin[3], moment[3], out[3], h[3];
    from_site(own_w, b, m->omega);
    from_site(own_a, b, m->alpha);
    for (int i = 0; i < 3; i++) {
        h[i] = dot(b->inertia + 3 * i, own_w);
        moment[i] = dot(b->inertia + 3 * i, own_a);
    }
    td_machine_cross(spin, own_w, h);
    for (int i = 0; i < 3; i++) moment[i] += spin[i];
    to_site(out, b, moment);
    dBodyAddForce(b->ode, -b->mass * m->a[0], -b->mass * m->a[1], -b->mass * m->a[2]);
    dBodyAddTorque(b->ode, -out[0], -out[1], -out[2]);
}

/* A joint's force is lambda = now + slope (rate' - ahead) / 2 + h stiffness (rate' - rate) / 4 of the rate'
 * that is sought: trapezoidal in what damps, Newmark's average acceleration in what springs; stable however
 * stiff. As a motor: rate' = a / b - lambda / b with lambda = a - b rate'. */
static void drive(td_world *w, const td_world_body *b, double torque, double slope, double stiffness)
{
    const double h = w->options.step_s, rate = w->velocity[6 + b->joint],
                 straight = rate + 2 * w->ahead[6 + b->joint];
    slope = fmin(slope, 0) / 2;
    stiffness = h * fmin(stiffness, 0) / 4;
    const double soft = -slope - stiffness, force = torque - slope * straight - stiffness * rate;
    const bool motor = soft > 1e-9;
    if (b->slides) {
        dJointSetSliderParam(b->motor, dParamFMax, motor ? dInfinity : 0);
        if (motor) {
            dJointSetSliderParam(b->motor, dParamVel, force / soft);
            dJointSetSliderParam(b->motor, dParamCFM, 1 / soft);
        } else if (force != 0)
            dJointAddSliderForce(b->motor, force);
    } else {
        dJointSetHingeParam(b->motor, dParamFMax, motor ? dInfinity : 0);
        if (motor) {
            dJointSetHingeParam(b->motor, dParamVel, force / soft);
            dJointSetHingeParam(b->motor, dParamCFM, 1 / soft);
        } else if (force != 0)
            dJointAddHingeTorque(b->motor, force);
    }
}

static void drive_all(td_world *w)
{
    static const double level[TD_ROBOT_MAX_JOINTS] = {
        0}; /* what the lever's change does is small within a step */
    const td_machine *m = w->machine;
    double push[TD_ROBOT_MAX_JOINTS] = {0};
    td_machine_view v;
    td_world_view(&v, w);
    if (m->options.hydraulics) {
        for (int k = 0; k < m->robot.joint_count; k++)
            if (!td_actuator_lever(w->lever + k, m, k, w->q[k])) w->lever[k] = 0;
        td_hydraulics_slopes(w->slope, push, m, td_world_time(w), &v, w->lever, level);
    }
    for (int i = 1; i < w->body_count; i++) {
        const int k = w->body[i].joint;
        const td_hydraulics_slope *s = w->slope + k;
        double by_q = 0, by_dq = 0;
        double torque = td_joint_torque(&by_q, &by_dq, m, k, v.q[k], v.nu[6 + k]);
        if (m->options.hydraulics) {
            torque += w->lever[k] * push[k];
            by_dq += w->lever[k] * s->push[1];
            by_q += w->lever[k] * s->push[2] * s->force[1];
        }
        drive(w, w->body + i, torque, by_dq, by_q);
    }
}

void td_world_load(td_world *w)
{
    body_motion set[1 + TD_ROBOT_MAX_JOINTS], now[1 + TD_ROBOT_MAX_JOINTS];
    double velocity[TD_DYNAMICS_MAX];
    const int all = 6 + w->machine->robot.joint_count;
    for (int i = 0; i < all; i++) velocity[i] = w->velocity[i] + w->ahead[i];
    move_all(set, w, w->velocity);
    move_all(now, w, velocity);
    for (int i = 0; i < w->body_count; i++) {
        td_world_body *b = w->body + i;
        if (!b->ode) continue;
        put_body(b);
        dBodySetLinearVel(b->ode, set[i].v[0], set[i].v[1], set[i].v[2]);
        dBodySetAngularVel(b->ode, set[i].omega[0], set[i].omega[1], set[i].omega[2]);
        dBodySetForce(b->ode, 0, 0, 0); /* of a step that failed */
        dBodySetTorque(b->ode, 0, 0, 0);
        push_products(b, now + i);
        const double *p = b->push, *s = b->step_push;
        dBodyAddForce(b->ode, p[0] + s[0], p[1] + s[1], p[2] + s[2]);
        dBodyAddTorque(b->ode, p[3] + s[3], p[4] + s[4], p[5] + s[5]);
    }
    drive_all(w);
}

/* Velocity in the robot's coordinates. */
static void read_velocity(double *velocity, const td_world *w)
{
    static const dReal still[3] = {0};
    const dBodyID base = w->body[0].ode;
    for (int c = 0; c < 3 && base; c++) {
        velocity[c] = dBodyGetAngularVel(base)[c];
        velocity[3 + c] = dBodyGetLinearVel(base)[c];
    }
    for (int i = 1; i < w->body_count; i++) {
        const td_world_body *b = w->body + i, *above = w->body + b->parent;
        const dReal *mine = dBodyGetAngularVel(b->ode),
                    *its = above->ode ? dBodyGetAngularVel(above->ode) : still;
        double apart[3];
        if (b->slides) {
            double r[3], turn[3];
            for (int c = 0; c < 3; c++) r[c] = b->at[c] - above->at[c];
            td_machine_cross(turn, its, r);
            const dReal *v = above->ode ? dBodyGetLinearVel(above->ode) : still;
            for (int c = 0; c < 3; c++) apart[c] = dBodyGetLinearVel(b->ode)[c] - v[c] - turn[c];
        } else
            for (int c = 0; c < 3; c++) apart[c] = mine[c] - its[c];
        velocity[6 + b->joint] = dot(apart, b->way);
    }
}

static void move_base(td_world *w)
{
    td_world_body *b = w->body;
    const double h = w->options.step_s;
    double turn[3], off[3];
    td_pose spin = {.t = {0}}, old = b->pose;
    if (!b->ode) return;
    for (int c = 0; c < 3; c++) turn[c] = h * w->velocity[c], old.t[c] = 0;
    td_rotation_exp(spin.q, turn);
    b->pose = td_pose_compose(&spin, &old);
    td_pose_rotate(off, &b->pose, b->com);
    for (int c = 0; c < 3; c++) b->pose.t[c] = b->at[c] + h * w->velocity[3 + c] - off[c];
}

/* Oil and valves by the exponential of their own slope: exact where they lag, stable where relief opens. */
static void advance_hydraulics(td_world *w)
{
    const td_machine *m = w->machine;
    const double h = w->options.step_s;
    double force_rate[TD_ROBOT_MAX_JOINTS], valve_rate[TD_ROBOT_MAX_JOINTS], push[TD_ROBOT_MAX_JOINTS];
    td_machine_view v;
    td_world_view(&v, w);
    memcpy(v.nu + 6, w->velocity + 6, (size_t)m->robot.joint_count * sizeof *v.nu);
    td_hydraulics_rate(force_rate, valve_rate, push, m, td_world_time(w), &v, w->lever);
    for (int k = 0; k < m->robot.joint_count; k++) {
        const double own = w->slope[k].force[2];
        w->force[k] += force_rate[k] * (own < 0 ? expm1(h * own) / own : h);
        w->valve[k] += valve_rate[k] * w->valve_gain_s;
    }
}

void td_world_unload(td_world *w)
{
    const int n = w->machine->robot.joint_count;
    const double h = w->options.step_s;
    double velocity[TD_DYNAMICS_MAX] = {0};
    read_velocity(velocity, w);
    for (int i = 0; i < 6 + n; i++) {
        /* The first step brings velocities from the positions' time to half a step behind it. */
        const double change = (velocity[i] - w->velocity[i]) / 2;
        w->velocity[i] = w->fresh ? w->velocity[i] + change : velocity[i];
        w->ahead[i] = change;
    }
    w->fresh = false;
    if (w->machine->options.hydraulics) advance_hydraulics(w);
    for (int k = 0; k < n; k++) w->q[k] += h * w->velocity[6 + k];
    move_base(w);
    td_world_place(w);
}
