/* Cylinders, motors, valves and pumps: from a command to the forces at the joints. */
#include <math.h>
#include <string.h>

#include "sim/machine_internal.h"

/* Of the force limit: where the relief valve opens. At the limit it passes the full flow. */
static const double RELIEF_OPENS = 0.97;

/* ---- what drives each joint ---- */

static void make_motor(td_actuator *a, const td_robot_joint *joint)
{
    *a = (td_actuator){.sign = 1, .area = {1, 1}};
    for (int side = 0; side < 2; side++) {
        a->force[side] = joint->effort > 0 ? joint->effort : INFINITY;
        a->speed[side] = joint->speed > 0 ? joint->speed : INFINITY;
    }
}

static void make_cylinder(td_actuator *a, const td_cylinder *c)
{
    a->cylinder = c;
    a->area[0] = td_cylinder_area(c, true);
    a->area[1] = td_cylinder_area(c, false);
    for (int side = 0; side < 2; side++) {
        a->force[side] = c->pressure_pa * a->area[side];
        a->speed[side] = c->flow_m3_s / a->area[side];
    }
}

td_status td_actuators_make(td_machine *m, td_error *error)
{
    const td_robot *r = &m->robot;
    for (int k = 0; k < r->joint_count; k++) make_motor(m->actuator + k, r->joint + k);
    for (int i = 0; i < r->cylinder_count; i++) {
        const td_cylinder *c = r->cylinder + i;
        const td_robot_joint *joint = r->joint + c->joint;
        td_actuator *a = m->actuator + c->joint;
        double lever = 0;
        if (a->cylinder)
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "machine '%s': joint '%s' has the cylinders '%s' and '%s'; give one entry with count",
                r->name, joint->name, a->cylinder->name, c->name);
        if (!td_cylinder_length(NULL, &lever, r, c, (joint->lower + joint->upper) / 2))
            return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': cylinder '%s' does not reach its eye",
                           r->name, c->name);
        make_cylinder(a, c);
        a->sign = lever < 0 ? -1 : 1;
    }
    return TD_OK;
}

bool td_actuator_lever(double *lever, const td_machine *m, int joint, double q)
{
    const td_cylinder *c = m->actuator[joint].cylinder;
    *lever = 1;
    return !c || td_cylinder_length(NULL, lever, &m->robot, c, q);
}

double td_actuator_flow(const td_actuator *a, double speed)
{
    return speed * a->area[speed < 0];
}

double td_actuator_pressure(const td_actuator *a, double force)
{
    return a->cylinder ? force / a->area[force < 0] : 0;
}

/* ---- commands ---- */

void td_machine_limit(double limit[2], const td_machine *m, td_command_kind kind, int joint)
{
    const td_actuator *a = m->actuator + joint;
    for (int grows = 0; grows < 2; grows++) {
        const int side = (grows ? a->sign : -a->sign) > 0 ? 0 : 1;
        if (kind == TD_COMMAND_FLOW)
            limit[grows] = a->speed[side] * a->area[side];
        else
            limit[grows] = kind == TD_COMMAND_FORCE ? a->force[side] : m->robot.joint[joint].speed;
    }
}

td_status td_command_check(const td_machine *m, const td_plant_command *command, td_error *error)
{
    static const char *const what[] = {"flow", "force", "rate"}, *const unit[] = {"m^3/s", "N",
                                                                                  "rad/s (m/s)"};
    static const char *const motor_what[] = {"rate", "torque", "rate"}, *const motor_unit[] = {"rad/s (m/s)",
                                                                                               "N m (N)",
                                                                                               "rad/s (m/s)"};
    if (!m->options.hydraulics)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "machine '%s': its hydraulics are off, nothing takes commands", m->robot.name);
    if ((unsigned)command->kind > TD_COMMAND_RATE)
        return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': a command of no known kind", m->robot.name);
    for (int k = 0; k < m->robot.joint_count; k++) {
        const double value = command->value[k];
        const bool motor = !m->actuator[k].cylinder;
        const char *noun = (motor ? motor_what : what)[command->kind];
        double limit[2];
        td_machine_limit(limit, m, command->kind, k);
        if (!isfinite(value))
            return td_fail(error, TD_ERROR_ARGUMENT, "command to joint '%s': its %s is no number",
                           m->robot.joint[k].name, noun);
        if (fabs(value) > limit[value > 0] * (1 + 1e-12))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "command to joint '%s': a %s of %.6g %s is beyond its limit of %.6g",
                           m->robot.joint[k].name, noun, value, (motor ? motor_unit : unit)[command->kind],
                           value < 0 ? -limit[0] : limit[1]);
    }
    return TD_OK;
}

static double held(double value, const double limit[2])
{
    return fmax(-limit[0], fmin(limit[1], value));
}

/* Piston speed (outwards) that a command asks for, within the actuator's own flow. */
static double asked(const td_machine *m, int joint, double value, double lever)
{
    const td_actuator *a = m->actuator + joint;
    double limit[2], speed = 0;
    td_machine_limit(limit, m, m->command.kind, joint);
    value = held(value, limit);
    if (m->command.kind == TD_COMMAND_RATE)
        speed = lever * value;
    else
        speed = a->sign * value / a->area[a->sign * value < 0];
    return fmax(-a->speed[1], fmin(a->speed[0], speed));
}

/* What each cylinder gets of what it asks for, so that together they take no more than the pumps give. */
static double share(const td_machine *m, const double *speed)
{
    double flow = 0;
    for (int k = 0; k < m->robot.joint_count; k++)
        if (m->actuator[k].cylinder) flow += fabs(td_actuator_flow(m->actuator + k, speed[k]));
    return flow > m->options.pump_m3_s ? m->options.pump_m3_s / flow : 1;
}

/* Piston speed that the relief valve lets past; *slope (may be NULL) its derivative by the force. */
static double relief(double *slope, const td_actuator *a, double force)
{
    const int side = force < 0;
    const double limit = a->force[side], over = fabs(force) - RELIEF_OPENS * limit;
    if (slope) *slope = 0;
    if (!(over > 0)) return 0;
    const double full = isfinite(a->speed[side]) ? a->speed[side] : 1,
                 each = full / ((1 - RELIEF_OPENS) * limit);
    if (slope) *slope = each;
    return side ? -each * over : each * over;
}

/* The commands as they stand at t, and the piston speeds that the valves are set to (0 for forces). */
static void wanted(double *value, double *given, const td_machine *m, double t, const double *lever)
{
    const int n = m->robot.joint_count;
    for (int k = 0; k < n; k++) {
        value[k] = m->command.value[k] + m->slope[k] * (t - m->command_s);
        given[k] = m->command.kind == TD_COMMAND_FORCE ? 0 : asked(m, k, value[k], lever[k]);
    }
    const double part = share(m, given);
    for (int k = 0; k < n; k++)
        if (m->actuator[k].cylinder) given[k] *= part;
}

/* Rates at commands `value` whose valves are set to `given`. */
static void rate(double *force_rate, double *valve_rate, double *push, const td_machine *m,
                 const td_machine_view *view, const double *lever, const double *value, const double *given)
{
    const int n = m->robot.joint_count;
    const double lag = m->options.valve_s, *dq = view->nu + 6;
    const bool by_force = m->command.kind == TD_COMMAND_FORCE;
    for (int k = 0; k < n; k++) {
        const td_actuator *a = m->actuator + k;
        valve_rate[k] = (given[k] - view->valve[k]) / lag;
        double limit[2];
        td_machine_limit(limit, m, TD_COMMAND_FORCE, k);
        if (by_force) {
            force_rate[k] = (a->sign * held(value[k], limit) - view->force[k]) / lag;
            push[k] = view->force[k];
        } else {
            force_rate[k] =
                m->options.oil_n_m * (view->valve[k] - lever[k] * dq[k] - relief(NULL, a, view->force[k]));
            push[k] = a->sign * held(a->sign * (view->force[k] + m->options.oil_s * force_rate[k]), limit);
        }
    }
}

void td_hydraulics_rate(double *force_rate, double *valve_rate, double *push, const td_machine *m, double t,
                        const td_machine_view *view, const double *lever)
{
    double value[TD_ROBOT_MAX_JOINTS], given[TD_ROBOT_MAX_JOINTS];
    wanted(value, given, m, t, lever);
    rate(force_rate, valve_rate, push, m, view, lever, value, given);
}

/* How a joint's valve setting changes with its lever: only a rate within its limits goes through it. */
static double given_by_lever(const td_machine *m, int joint, double value, double given, double lever)
{
    if (m->command.kind != TD_COMMAND_RATE || lever == 0) return 0;
    const td_actuator *a = m->actuator + joint;
    double limit[2];
    td_machine_limit(limit, m, TD_COMMAND_RATE, joint);
    const double speed = lever * held(value, limit);
    return speed >= a->speed[0] || speed <= -a->speed[1] ? 0 : given / lever;
}

void td_hydraulics_slopes(td_hydraulics_slope *slope, double *push, const td_machine *m, double t,
                          const td_machine_view *view, const double *lever, const double *lever_slope)
{
    const td_machine_options *o = &m->options;
    double value[TD_ROBOT_MAX_JOINTS], given[TD_ROBOT_MAX_JOINTS], force_rate[TD_ROBOT_MAX_JOINTS],
        valve_rate[TD_ROBOT_MAX_JOINTS];
    wanted(value, given, m, t, lever);
    rate(force_rate, valve_rate, push, m, view, lever, value, given);
    for (int k = 0; k < m->robot.joint_count; k++) {
        const double free = view->force[k] + o->oil_s * force_rate[k];
        td_hydraulics_slope s = {.valve = {0, 0, 0, -1 / o->valve_s}};
        s.valve[0] = given_by_lever(m, k, value[k], given[k], lever[k]) * lever_slope[k] / o->valve_s;
        if (m->command.kind == TD_COMMAND_FORCE) {
            s.force[2] = -1 / o->valve_s;
            s.push[2] = 1;
        } else {
            double open = 0;
            relief(&open, m->actuator + k, view->force[k]);
            s.force[0] = -o->oil_n_m * lever_slope[k] * view->nu[6 + k];
            s.force[1] = -o->oil_n_m * lever[k];
            s.force[2] = -o->oil_n_m * open;
            s.force[3] = o->oil_n_m;
            for (int i = 0; i < 4 && free == push[k]; i++) s.push[i] = o->oil_s * s.force[i] + (i == 2);
        }
        slope[k] = s;
    }
}

void td_hydraulics_push(double *push, const td_machine *m, double t, const td_machine_view *view)
{
    double lever[TD_ROBOT_MAX_JOINTS], force_rate[TD_ROBOT_MAX_JOINTS], valve_rate[TD_ROBOT_MAX_JOINTS];
    memset(push, 0, (size_t)m->robot.joint_count * sizeof *push);
    if (!m->options.hydraulics) return;
    for (int k = 0; k < m->robot.joint_count; k++)
        if (!td_actuator_lever(lever + k, m, k, view->q[k])) lever[k] = 0;
    td_hydraulics_rate(force_rate, valve_rate, push, m, t, view, lever);
}
