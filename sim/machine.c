/* The machine as a whole: made, commanded, stepped. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim/machine_internal.h"

/* How far a stop gives under the joint's whole effort, rad or m; and its stiffness where that is unknown. */
static const double STOP_GIVES = 1e-3, STOP_UNKNOWN_N = 1e8;

td_machine_options td_machine_options_default(const td_robot *robot)
{
    td_machine_options o = {.base = robot->suspension_n_m[0] > 0 ? TD_MACHINE_SUSPENDED : TD_MACHINE_FIXED,
                            .site_from_anchor = td_pose_identity(),
                            .gravity = {0, 0, -9.80665},
                            .coriolis = true,
                            .hydraulics = true,
                            .oil_n_m = 1e8,
                            .oil_s = 0.01,
                            .valve_s = 0.05,
                            .pump_m3_s = td_robot_pump(robot),
                            .slip = 5e-3,
                            .suspension = 1,
                            .stop_damping = 10,
                            .integrator = td_integrator_options_default()};
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        const bool known = isfinite(j->effort) && isfinite(j->speed) && j->speed > 0;
        o.viscous[k] = known ? 0.1 * j->effort / j->speed : 0;
        o.coulomb[k] = known ? 0.02 * j->effort : 0;
    }
    return o;
}

/* ---- making ---- */

static td_status check_number(const td_robot *robot, const char *name, double value, double low, double high,
                              td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': %s %g is not within %g to %g", robot->name, name,
                   value, low, high);
}

static td_status check_suspension(const td_robot *robot, td_error *error)
{
    static const char *const names[3] = {"heave", "pitch", "roll"};
    for (int i = 0; i < 3; i++)
        if (!(robot->suspension_n_m[i] > 0) || !(robot->suspension_ns_m[i] >= 0))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "machine '%s': its suspension has no stiffness of %s; give heave, pitch and roll, or "
                "fix the base",
                robot->name, names[i]);
    return TD_OK;
}

static td_status check_options(const td_robot *robot, const td_machine_options *o, td_error *error)
{
    if ((unsigned)o->base > TD_MACHINE_FLOATING)
        return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': no such base", robot->name);
    if (o->base == TD_MACHINE_SUSPENDED) TD_TRY(check_suspension(robot, error));
    for (int i = 0; i < 3; i++)
        TD_TRY(check_number(robot, "gravity, m/s^2,", o->gravity[i], -1e3, 1e3, error));
    TD_TRY(check_number(robot, "the oil's stiffness, N/m,", o->oil_n_m, 1, 1e14, error));
    TD_TRY(check_number(robot, "the oil's damping, s,", o->oil_s, 0, 10, error));
    TD_TRY(check_number(robot, "the valves' lag, s,", o->valve_s, 1e-6, 1e3, error));
    TD_TRY(check_number(robot, "the pumps' flow, m^3/s,", o->pump_m3_s, 1e-12, INFINITY, error));
    TD_TRY(check_number(robot, "the slip speed of friction", o->slip, 1e-9, 1e3, error));
    TD_TRY(check_number(robot, "the factor of the suspension's dampers", o->suspension, 0, 1e6, error));
    TD_TRY(check_number(robot, "the damping of the stops", o->stop_damping, 0, 1e9, error));
    for (int k = 0; k < robot->joint_count; k++) {
        char name[TD_NAME_SIZE + 40];
        snprintf(name, sizeof name, "viscous friction of joint '%s'", robot->joint[k].name);
        TD_TRY(check_number(robot, name, o->viscous[k], 0, 1e15, error));
        snprintf(name, sizeof name, "Coulomb friction of joint '%s'", robot->joint[k].name);
        TD_TRY(check_number(robot, name, o->coulomb[k], 0, 1e15, error));
    }
    return TD_OK;
}

/* Lateral pitch turns about y, roll about x; x, y and yaw as the header says. */
static void make_suspension(td_machine *m)
{
    static const int from[6] = {2, 1, 1, 0, 0, 0};
    for (int i = 0; i < 6; i++) {
        m->spring[i] = m->robot.suspension_n_m[from[i]];
        m->damper[i] = m->options.suspension * m->robot.suspension_ns_m[from[i]];
    }
}

static void make_stops(td_machine *m)
{
    size_t count = 0;
    for (int k = 0; k < m->robot.joint_count; k++) {
        const td_robot_joint *j = m->robot.joint + k;
        const bool known = isfinite(j->effort) && j->effort > 0;
        m->stop_n[k] = known ? j->effort / STOP_GIVES : STOP_UNKNOWN_N;
        for (int upper = 0; upper < 2 && count < TD_ODE_MAX_EVENTS - 1; upper++)
            if (isfinite(upper ? j->upper : j->lower)) {
                m->event_joint[count] = k;
                m->event_upper[count++] = upper;
            }
    }
    m->event_joint[count] = -1; /* the plane */
    m->ode.event_count = count + 1;
}

/* Above 0: past that stop, in the plane. */
static void find_events(double *g, double t, const double *y, void *machine)
{
    const td_machine *m = machine;
    const td_machine_layout l = td_machine_layout_of(m);
    const size_t stops = m->ode.event_count - 1;
    (void)t;
    g[stops] = -1;
    if (m->contact.link >= 0) {
        td_machine_view v;
        td_machine_open(&v, m, y);
        g[stops] = td_contact_depth(m, &v);
    }
    for (size_t i = 0; i < stops; i++) {
        const td_robot_joint *j = m->robot.joint + m->event_joint[i];
        const double q = y[l.q + m->event_joint[i]];
        g[i] = m->event_upper[i] ? q - j->upper : j->lower - q;
    }
}

/* What is small for each state: a tolerance on states near 0 (rad, m, rad/s, m/s, N, m/s). */
static void make_tolerances(td_machine *m)
{
    const td_machine_layout l = td_machine_layout_of(m);
    for (int i = 0; i < l.size; i++) {
        double small = 1e-2;
        if (i >= l.dq) small = 0.1;
        if (i >= l.force) small = 1e4;
        if (i >= l.valve) small = 0.1;
        if (l.nu >= 0 && i >= l.nu && i < l.nu + 6) small = 0.1;
        m->absolute[i] = m->options.integrator.relative * small;
    }
}

static td_status choose_dynamics(td_machine *m, const char *folder, td_error *error)
{
    if (td_dynamics_zx200(&m->dynamics, &m->robot, NULL) == TD_OK) return TD_OK;
    if (folder) return td_dynamics_compile(&m->dynamics, &m->robot, folder, error);
    return td_dynamics_new(&m->dynamics, &m->robot, error);
}

/* What a joint moves must have inertia about it, or nothing says how fast a force moves it. */
static td_status check_inertia(const td_machine *m, const double *q, td_error *error)
{
    const int n = m->robot.joint_count, all = 6 + n;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX];
    td_dynamics_mass(mass, m->dynamics, q);
    for (int k = 0; k < n; k++)
        if (!(mass[(6 + k) * (all + 1)] > 0))
            return td_fail(
                error, TD_ERROR_DATA,
                "machine '%s': link '%s' and what it carries have no inertia about joint '%s'; give "
                "them an <inertial>",
                m->robot.name, m->robot.link[m->robot.joint[k].link].name, m->robot.joint[k].name);
    return TD_OK;
}

static td_status build(td_machine *m, const char *folder, td_error *error)
{
    TD_TRY(choose_dynamics(m, folder, error));
    TD_TRY(td_actuators_make(m, error));
    if (m->options.base == TD_MACHINE_SUSPENDED) make_suspension(m);
    make_stops(m);
    const size_t size = (size_t)td_machine_layout_of(m).size;
    m->y = calloc(size, sizeof *m->y);
    m->absolute = calloc(size, sizeof *m->absolute);
    m->rows = calloc((size_t)(6 + m->robot.joint_count) * size, sizeof *m->rows);
    if (!m->y || !m->absolute || !m->rows)
        return td_fail(error, TD_ERROR_MEMORY, "machine '%s': no memory for its state", m->robot.name);
    m->ode.size = size;
    m->ode.rate = td_machine_rate;
    m->ode.jacobian = td_machine_jacobian;
    m->ode.events = find_events;
    m->ode.user = m;
    make_tolerances(m);
    if (!m->options.integrator.absolute) m->options.integrator.absolute = m->absolute;
    td_plant_state start = {.site_from_vehicle = m->options.site_from_anchor};
    for (int k = 0; k < m->robot.joint_count; k++)
        start.q[k] = fmax(m->robot.joint[k].lower, fmin(m->robot.joint[k].upper, 0));
    TD_TRY(check_inertia(m, start.q, error));
    td_machine_close(m->y, m, &start);
    return td_integrator_new(&m->integrator, &m->ode, 0, m->y, &m->options.integrator, error);
}

td_status td_machine_new(td_machine **machine, const td_robot *robot, const td_machine_options *options,
                         const char *folder, td_error *error)
{
    const td_machine_options o = options ? *options : td_machine_options_default(robot);
    *machine = NULL;
    TD_TRY(check_options(robot, &o, error));
    td_machine *m = calloc(1, sizeof *m);
    if (!m) return td_fail(error, TD_ERROR_MEMORY, "no memory for machine '%s'", robot->name);
    m->robot = *robot;
    m->options = o;
    m->contact = td_machine_contact_default();
    td_status status = build(m, folder, error);
    if (status != TD_OK)
        td_machine_free(&m);
    else
        *machine = m;
    return status;
}

void td_machine_free(td_machine **machine)
{
    if (!machine || !*machine) return;
    td_integrator_free(&(*machine)->integrator);
    td_dynamics_free(&(*machine)->dynamics);
    free((*machine)->y);
    free((*machine)->absolute);
    free((*machine)->rows);
    free(*machine);
    *machine = NULL;
}

/* ---- commanding and stepping ---- */

td_status td_machine_command(td_machine *m, const td_plant_command *command, const double *slope,
                             td_error *error)
{
    const size_t n = (size_t)m->robot.joint_count;
    TD_TRY(td_command_check(m, command, error));
    for (size_t k = 0; slope && k < n; k++)
        if (!isfinite(slope[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "command to joint '%s': its slope is no number",
                           m->robot.joint[k].name);
    bool same = m->command.kind == command->kind;
    for (size_t k = 0; same && k < n; k++)
        same = m->command.value[k] == command->value[k] && m->slope[k] == 0 && (!slope || slope[k] == 0);
    if (same) return TD_OK;
    m->command = *command;
    for (size_t k = 0; k < n; k++) m->slope[k] = slope ? slope[k] : 0;
    m->command_s = m->t;
    m->changed = true;
    return TD_OK;
}

static void note_event(td_machine *m, int event, int direction)
{
    if (event < 0 || m->event_count == MACHINE_MAX_EVENTS) return;
    m->event[m->event_count++] = (td_machine_event){.time_s = td_integrator_time(m->integrator),
                                                    .joint = m->event_joint[event],
                                                    .upper = m->event_upper[event],
                                                    .met = direction > 0};
}

/* The integrator knows its states by their index: says which one it means. */
static td_status name_state(const td_machine *m, td_status status, td_error *error)
{
    char name[TD_NAME_SIZE + 16];
    unsigned long index = 0;
    const char *word = error ? strstr(error->message, "state ") : NULL;
    if (!word || sscanf(word, "state %lu", &index) != 1 || index >= m->ode.size)
        return td_error_prefix(error, status, "machine '%s'", m->robot.name);
    td_machine_state_name(name, m, index);
    return td_error_prefix(error, status, "machine '%s' (state %lu is the %s)", m->robot.name, index, name);
}

td_status td_machine_step(td_machine *m, double dt_s, td_error *error)
{
    if (!(dt_s >= 0) || !isfinite(dt_s))
        return td_fail(error, TD_ERROR_ARGUMENT, "machine '%s': cannot step by %g s", m->robot.name, dt_s);
    const double end = m->t + dt_s;
    td_status status = TD_OK;
    int event = 0, direction = 0;
    if (m->changed) status = td_integrator_restart(m->integrator, m->t, m->y, error);
    m->changed = m->changed && status != TD_OK;
    while (status == TD_OK && event >= 0) {
        status = td_integrator_advance(m->integrator, end, &event, &direction, error);
        if (status == TD_OK) note_event(m, event, direction);
    }
    if (status != TD_OK) return name_state(m, status, error);
    m->t = end;
    memcpy(m->y, td_integrator_state(m->integrator), m->ode.size * sizeof *m->y);
    return TD_OK;
}

const td_machine_event *td_machine_events(const td_machine *m, size_t *count)
{
    *count = m->event_count;
    return m->event;
}

td_integrator_counters td_machine_count(const td_machine *m)
{
    return td_integrator_count(m->integrator);
}

size_t td_machine_size(const td_machine *m)
{
    return m->ode.size;
}

const td_ode *td_machine_ode(const td_machine *m)
{
    return &m->ode;
}

const double *td_machine_values(const td_machine *m)
{
    return m->y;
}

void td_machine_state_name(char name[TD_NAME_SIZE + 16], const td_machine *m, size_t index)
{
    static const char *const pose[7] = {"quaternion w", "quaternion x", "quaternion y", "quaternion z",
                                        "position x",   "position y",   "position z"};
    static const char *const twist[6] = {"omega x", "omega y", "omega z", "v x", "v y", "v z"};
    const td_machine_layout l = td_machine_layout_of(m);
    const int i = (int)index;
    const char *of = "angle";
    int joint = i - l.q;
    if (l.pose >= 0 && (i < 7 || (i >= l.nu && i < l.nu + 6))) {
        snprintf(name, TD_NAME_SIZE + 16, "%s", i < 7 ? pose[i] : twist[i - l.nu]);
        return;
    }
    if (i >= l.dq) of = "rate", joint = i - l.dq;
    if (i >= l.force) of = "force", joint = i - l.force;
    if (i >= l.valve) of = "valve", joint = i - l.valve;
    snprintf(name, TD_NAME_SIZE + 16, "%s %s", m->robot.joint[joint].name, of);
}

/* ---- the plant ---- */

static td_status plant_command(void *self, const td_plant_command *command, td_error *error)
{
    return td_machine_command(self, command, NULL, error);
}

static td_status plant_step(void *self, double dt_s, td_error *error)
{
    return td_machine_step(self, dt_s, error);
}

static td_status plant_state(void *self, td_plant_state *state, td_error *error)
{
    (void)error;
    td_machine_state(self, state);
    return TD_OK;
}

static td_status plant_reset(void *self, const td_plant_state *state, td_error *error)
{
    return td_machine_reset(self, state, error);
}

static void plant_free(void *self)
{
    td_machine *m = self;
    td_machine_free(&m);
}

td_plant td_machine_plant(td_machine *machine)
{
    return (td_plant){.self = machine,
                      .robot = &machine->robot,
                      .command = plant_command,
                      .step = plant_step,
                      .state = plant_state,
                      .reset = plant_reset,
                      .free = plant_free};
}
