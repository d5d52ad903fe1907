/* The result of teledimos simulate: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_internal.h"
#include "core/document.h"

#define DEGREES 57.29577951308232

const gate_row simulate_gate_defaults[] = {
    {"stops", 0, INFINITY, "how often a joint met a stop: what is commanded runs into them"},
    {"force_share", 0.97, INFINITY,
     "largest force or torque over its limit: above 0.97 a relief valve is open, and the motion is not the "
     "commanded one"},
    {"tilt_deg", 2, 10,
     "largest pitch or roll against the start: above 2 degrees the machine rocks, above 10 it tips (the "
     "model's "
     "suspension pulls, the ground does not)"},
    {"cpu_share", 0.5, INFINITY, "computing time over simulated time: above 1 it is slower than the machine"},
};
const size_t simulate_gate_count = sizeof simulate_gate_defaults / sizeof *simulate_gate_defaults;

#define SWEEP_ROWS(path)                                                                                     \
    {path "[].period_s", TD_SCHEMA_REAL, true, false, "control period"},                                     \
        {path "[].gain_1_s", TD_SCHEMA_REAL, true, false, "gain of the controller"},                         \
        {path "[].oil_n_m", TD_SCHEMA_REAL, true, false, "stiffness of the oil"},                            \
        {path "[].coriolis", TD_SCHEMA_BOOL, true, false, "with centrifugal and Coriolis terms"},            \
        {path "[].stable", TD_SCHEMA_BOOL, true, false, "after the motion its swinging dies away"},          \
        {path "[].error_rad", TD_SCHEMA_REAL, true, true,                                                    \
         "largest distance from what was wanted (prismatic: m)"},                                            \
        {path "[].swing_rad", TD_SCHEMA_REAL, true, true, "what still swings long after the motion"},        \
        {path "[].rates", TD_SCHEMA_INT, true, false, "calls of the equations"},                             \
        {path "[].steps", TD_SCHEMA_INT, true, false, "of the integrator"},                                  \
    {                                                                                                        \
        path "[].cpu_share", TD_SCHEMA_REAL, true, false, "computing time over simulated time"               \
    }

const td_schema_row simulate_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "simulate"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"robot", TD_SCHEMA_STRING, true, false, "its name"},
    {"motion", TD_SCHEMA_STRING, true, false, "hold, trapezoid, step, sine, table or free"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"duration_s", TD_SCHEMA_REAL, true, false, "simulated"},
    {"cpu_s", TD_SCHEMA_REAL, true, false, "of one processor, for the integration"},
    {"real_time_factor", TD_SCHEMA_REAL, true, true, "simulated over computing time"},
    {"coriolis", TD_SCHEMA_BOOL, true, false, "with centrifugal and Coriolis terms"},
    {"oil_n_m", TD_SCHEMA_REAL, true, false, "stiffness of the oil"},
    {"control", TD_SCHEMA_OBJECT, false, false, "controller of positions"},
    {"control.period_s", TD_SCHEMA_REAL, true, false, "its period"},
    {"control.gain_1_s", TD_SCHEMA_REAL, true, false, "its gain"},
    {"integrator", TD_SCHEMA_OBJECT, true, false, "what it cost"},
    {"integrator.method", TD_SCHEMA_STRING, true, false, "asked for: auto, adams or bdf"},
    {"integrator.relative", TD_SCHEMA_REAL, true, false, "tolerance"},
    {"integrator.rates", TD_SCHEMA_INT, true, false, "calls of the equations"},
    {"integrator.jacobians", TD_SCHEMA_INT, true, false, "Jacobians"},
    {"integrator.steps", TD_SCHEMA_INT, true, false, "steps"},
    {"integrator.rejected", TD_SCHEMA_INT, true, false, "of them tried again smaller"},
    {"integrator.newton_iterations", TD_SCHEMA_INT, true, false, "of BDF"},
    {"integrator.switches_to_bdf", TD_SCHEMA_INT, true, false, "stiff from there on"},
    {"integrator.switches_to_adams", TD_SCHEMA_INT, true, false, "easy from there on"},
    {"integrator.events", TD_SCHEMA_INT, true, false, "located: stops met or left"},
    {"joints", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"joints.*", TD_SCHEMA_OBJECT, true, false, "a joint; rad are m for one that slides"},
    {"joints.*.start_rad", TD_SCHEMA_REAL, true, false, "at first"},
    {"joints.*.end_rad", TD_SCHEMA_REAL, true, false, "at the end"},
    {"joints.*.rate_max_rad_s", TD_SCHEMA_REAL, true, false, "fastest"},
    {"joints.*.wanted_rad", TD_SCHEMA_REAL, false, false, "where a motion of rates leads to"},
    {"joints.*.error_rad", TD_SCHEMA_REAL, false, false, "end less wanted"},
    {"joints.*.force_max_n", TD_SCHEMA_REAL, true, false,
     "largest, of all its cylinders; a motor: torque, N m"},
    {"joints.*.force_limit_n", TD_SCHEMA_REAL, true, true, "where the largest was; null: none"},
    {"joints.*.force_share", TD_SCHEMA_REAL, true, false, "largest of force over limit"},
    {"base", TD_SCHEMA_OBJECT, true, false, "the undercarriage"},
    {"base.sag_mm", TD_SCHEMA_REAL, true, false, "at rest, below where it bears nothing"},
    {"base.heave_mm", TD_SCHEMA_REAL, true, false, "largest motion up or down against the start"},
    {"base.pitch_deg", TD_SCHEMA_REAL, true, false, "largest pitch against the start"},
    {"base.roll_deg", TD_SCHEMA_REAL, true, false, "largest roll against the start"},
    {"events", TD_SCHEMA_ARRAY, true, false, "stops met or left, in time"},
    {"events[].time_s", TD_SCHEMA_REAL, true, false, "when"},
    {"events[].joint", TD_SCHEMA_STRING, true, false, "which"},
    {"events[].stop", TD_SCHEMA_STRING, true, false, "lower or upper"},
    {"events[].what", TD_SCHEMA_STRING, true, false, "met or left"},
    {"sweep", TD_SCHEMA_OBJECT, false, false, "--sweep; the controller's loop closed in all of them"},
    {"sweep.stable_period_s", TD_SCHEMA_REAL, true, true,
     "longest control period that is stable, as are all "
     "shorter ones"},
    {"sweep.coriolis_apart_rad", TD_SCHEMA_REAL, true, false,
     "largest distance of the motions with and without Coriolis terms"},
    {"sweep.period", TD_SCHEMA_ARRAY, true, false, "over the control period"},
    SWEEP_ROWS("sweep.period"),
    {"sweep.gain", TD_SCHEMA_ARRAY, true, false, "over the gain"},
    SWEEP_ROWS("sweep.gain"),
    {"sweep.oil", TD_SCHEMA_ARRAY, true, false, "over the oil's stiffness"},
    SWEEP_ROWS("sweep.oil"),
    {"sweep.coriolis", TD_SCHEMA_ARRAY, true, false, "without and with"},
    SWEEP_ROWS("sweep.coriolis"),
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t simulate_schema_count = sizeof simulate_schema / sizeof *simulate_schema;

/* ---- extremes ---- */

typedef struct joint_extremes {
    double rate, force, limit, share;
} joint_extremes;

static double limit_of(const td_robot *robot, int joint, double force)
{
    for (int i = 0; i < robot->cylinder_count; i++) {
        const td_cylinder *c = robot->cylinder + i;
        double lever = 1;
        if (c->joint != joint) continue;
        td_cylinder_length(NULL, &lever, robot, c,
                           (robot->joint[joint].lower + robot->joint[joint].upper) / 2);
        const double rod = lever * force > 0 ? 0 : c->rod_m;
        return c->pressure_pa * c->count * 0.785398163397448 * (c->bore_m * c->bore_m - rod * rod);
    }
    return robot->joint[joint].effort > 0 ? robot->joint[joint].effort : INFINITY;
}

static joint_extremes extremes_of(const simulate_job *j, int joint)
{
    joint_extremes e = {.limit = INFINITY};
    for (size_t i = 0; i < j->run.count; i++) {
        const td_plant_state *s = &j->run.sample[i].state;
        const double force = s->force[joint], limit = limit_of(j->scenario.robot, joint, force);
        e.rate = fmax(e.rate, fabs(s->dq[joint]));
        e.share = fmax(e.share, fabs(force) / limit);
        if (i == 0 || fabs(force) > e.force) e.force = fabs(force), e.limit = limit;
    }
    return e;
}

/* [0] heave, m; [1] roll, [2] pitch, rad: largest against the start. */
static void base_extremes(double most[3], const simulate_job *j)
{
    double first[3], now[3];
    memset(most, 0, 3 * sizeof *most);
    const sample *a = j->run.sample;
    simulate_angles(first, &a->state.site_from_vehicle);
    for (size_t i = 0; i < j->run.count; i++) {
        const td_pose *p = &j->run.sample[i].state.site_from_vehicle;
        simulate_angles(now, p);
        most[0] = fmax(most[0], fabs(p->t[2] - a->state.site_from_vehicle.t[2]));
        for (int k = 0; k < 2; k++) most[1 + k] = fmax(most[1 + k], fabs(now[k] - first[k]));
    }
}

static double sag_of(const simulate_job *j)
{
    const td_pose back = td_pose_inverse(&j->scenario.options.site_from_anchor);
    const td_pose d = td_pose_compose(&back, &j->run.sample[0].state.site_from_vehicle);
    return -d.t[2];
}

void simulate_judge(simulate_job *j, const gate_row *rows)
{
    gate_result *g = &j->gate;
    const size_t count = simulate_gate_count;
    const td_robot *r = j->scenario.robot;
    size_t met = 0, first = 0;
    for (size_t i = j->run.event_count; i-- > 0;)
        if (j->run.event[i].met) met++, first = i;
    const td_machine_event *e = j->run.event + first;
    gate_check(g, rows, count, "stops", (double)met,
               "joints met their stops %zu times, first %s its %s one at %.3f s", met,
               met ? r->joint[e->joint].name : "", met && e->upper ? "upper" : "lower", met ? e->time_s : 0);
    for (int k = 0; k < r->joint_count; k++) {
        const joint_extremes x = extremes_of(j, k);
        gate_check(g, rows, count, "force_share", x.share, "%s reached %.0f %% of its limit (%.4g %s)",
                   r->joint[k].name, 100 * x.share, x.force, simulate_is_motor(r, k) ? "N m" : "N");
    }
    double base[3];
    base_extremes(base, j);
    const double tilt = DEGREES * fmax(base[1], base[2]);
    if (j->scenario.options.base == TD_MACHINE_SUSPENDED)
        gate_check(g, rows, count, "tilt_deg", tilt, "the base tilts by %.2f degrees", tilt);
    gate_check(g, rows, count, "cpu_share", j->run.cpu_s / j->scenario.duration_s,
               "computing took %.2f times what was simulated", j->run.cpu_s / j->scenario.duration_s);
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *joint_json(const simulate_job *j, int k)
{
    const sample *first = j->run.sample, *last = first + j->run.count - 1;
    const joint_extremes e = extremes_of(j, k);
    json_t *o = json_object();
    set(o, "start_rad", td_json_real(first->state.q[k]));
    set(o, "end_rad", td_json_real(last->state.q[k]));
    set(o, "rate_max_rad_s", td_json_real(e.rate));
    if (j->scenario.motion.command == TD_COMMAND_RATE && j->scenario.options.hydraulics) {
        set(o, "wanted_rad", td_json_real(last->wanted[k]));
        set(o, "error_rad", td_json_real(last->state.q[k] - last->wanted[k]));
    }
    set(o, "force_max_n", td_json_real(e.force));
    set(o, "force_limit_n", td_json_real(e.limit));
    set(o, "force_share", td_json_real(e.share));
    return o;
}

static json_t *integrator_json(const simulate_job *j)
{
    static const char *const methods[] = {"auto", "adams", "bdf"};
    const td_integrator_counters *c = &j->run.counters;
    const td_integrator_options *i = &j->scenario.options.integrator;
    json_t *o = json_object();
    set(o, "method", json_string(methods[i->method]));
    set(o, "relative", td_json_real(i->relative));
    set(o, "rates", json_integer(c->rates));
    set(o, "jacobians", json_integer(c->jacobians));
    set(o, "steps", json_integer(c->steps));
    set(o, "rejected", json_integer(c->rejected));
    set(o, "newton_iterations", json_integer(c->newton_iterations));
    set(o, "switches_to_bdf", json_integer(c->to_bdf));
    set(o, "switches_to_adams", json_integer(c->to_adams));
    set(o, "events", json_integer(c->events));
    return o;
}

static json_t *base_json(const simulate_job *j)
{
    double most[3];
    base_extremes(most, j);
    json_t *o = json_object();
    set(o, "sag_mm", td_json_real(1e3 * sag_of(j)));
    set(o, "heave_mm", td_json_real(1e3 * most[0]));
    set(o, "pitch_deg", td_json_real(DEGREES * most[2]));
    set(o, "roll_deg", td_json_real(DEGREES * most[1]));
    return o;
}

static json_t *events_json(const simulate_job *j)
{
    json_t *list = json_array();
    for (size_t i = 0; i < j->run.event_count; i++) {
        const td_machine_event *e = j->run.event + i;
        json_t *o = json_object();
        set(o, "time_s", td_json_real(e->time_s));
        set(o, "joint", json_string(j->scenario.robot->joint[e->joint].name));
        set(o, "stop", json_string(e->upper ? "upper" : "lower"));
        set(o, "what", json_string(e->met ? "met" : "left"));
        json_array_append_new(list, o);
    }
    return list;
}

static json_t *rows_json(const sweep_row *row, size_t count)
{
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) {
        json_t *o = json_object();
        set(o, "period_s", td_json_real(row[i].period_s));
        set(o, "gain_1_s", td_json_real(row[i].gain_1_s));
        set(o, "oil_n_m", td_json_real(row[i].oil_n_m));
        set(o, "coriolis", json_boolean(row[i].coriolis));
        set(o, "stable", json_boolean(row[i].stable));
        set(o, "error_rad", td_json_real(row[i].error_rad));
        set(o, "swing_rad", td_json_real(row[i].swing_rad));
        set(o, "rates", json_integer(row[i].rates));
        set(o, "steps", json_integer(row[i].steps));
        set(o, "cpu_share", td_json_real(row[i].cpu_share));
        json_array_append_new(list, o);
    }
    return list;
}

static json_t *sweep_json(const sweep *w)
{
    json_t *o = json_object();
    set(o, "stable_period_s", td_json_real(w->limit_s > 0 ? w->limit_s : NAN));
    set(o, "coriolis_apart_rad", td_json_real(w->coriolis[0].apart_rad));
    set(o, "period", rows_json(w->period, w->period_count));
    set(o, "gain", rows_json(w->gain, w->gain_count));
    set(o, "oil", rows_json(w->oil, w->oil_count));
    set(o, "coriolis", rows_json(w->coriolis, 2));
    return o;
}

json_t *simulate_result(const simulate_job *j)
{
    const scenario *s = &j->scenario;
    json_t *root = json_object(), *reasons = json_array(), *joints = json_object();
    set(root, "job", json_string("simulate"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "scenario", json_string(s->name));
    set(root, "robot", json_string(s->robot->name));
    set(root, "motion", json_string(s->motion.kind));
    set(root, "verdict", json_string(verdict_name(j->gate.verdict)));
    for (size_t i = 0; i < j->gate.count; i++) json_array_append_new(reasons, json_string(j->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "duration_s", td_json_real(s->duration_s));
    set(root, "cpu_s", td_json_real(j->run.cpu_s));
    set(root, "real_time_factor", td_json_real(j->run.cpu_s > 0 ? s->duration_s / j->run.cpu_s : NAN));
    set(root, "coriolis", json_boolean(s->options.coriolis));
    set(root, "oil_n_m", td_json_real(s->options.oil_n_m));
    if (s->period_s > 0)
        set(root, "control", json_pack("{s:f, s:f}", "period_s", s->period_s, "gain_1_s", s->gain_1_s));
    set(root, "integrator", integrator_json(j));
    for (int k = 0; k < s->robot->joint_count; k++) set(joints, s->robot->joint[k].name, joint_json(j, k));
    set(root, "joints", joints);
    set(root, "base", base_json(j));
    set(root, "events", events_json(j));
    if (j->has_sweep) set(root, "sweep", sweep_json(&j->sweep));
    set(root, "products",
        json_pack("{s:s, s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "motion",
                  "log.csv", "log", "log.jsonl"));
    return root;
}

/* ---- on the terminal ---- */

static void print_sweep(const char *head, const sweep_row *row, size_t count)
{
    printf("\n%-22s %8s %10s %10s %8s %8s %8s\n", head, "stable", "error mrad", "swing mrad", "rates",
           "steps", "cpu %");
    for (size_t i = 0; i < count; i++) {
        char name[64];
        snprintf(name, sizeof name, "%g s, K %g, %.0e N/m%s", row[i].period_s, row[i].gain_1_s,
                 row[i].oil_n_m, row[i].coriolis ? "" : " -C");
        printf("%-22s %8s %10.2f %10.3f %8ld %8ld %8.3f\n", name, row[i].stable ? "yes" : "NO",
               1e3 * row[i].error_rad, 1e3 * row[i].swing_rad, row[i].rates, row[i].steps,
               100 * row[i].cpu_share);
    }
}

void simulate_table(const void *done)
{
    const simulate_job *j = done;
    const scenario *s = &j->scenario;
    const sample *first = j->run.sample, *last = first + j->run.count - 1;
    double most[3];
    printf("%-12s %10s %10s %10s %12s %8s\n", "joint", "from rad", "to rad", "most rad/s", "most N (N m)",
           "of limit");
    for (int k = 0; k < s->robot->joint_count; k++) {
        const joint_extremes e = extremes_of(j, k);
        printf("%-12s %10.4f %10.4f %10.4f %12.0f %7.0f%%\n", s->robot->joint[k].name, first->state.q[k],
               last->state.q[k], e.rate, e.force, 100 * e.share);
    }
    base_extremes(most, j);
    printf("\nbase: sag %.1f mm, heaves by %.1f mm, rolls by %.2f and pitches by %.2f deg\n", 1e3 * sag_of(j),
           1e3 * most[0], DEGREES * most[1], DEGREES * most[2]);
    const td_integrator_counters *c = &j->run.counters;
    printf("%g s in %.1f ms, %.0f times real time: %ld steps, %ld calls of the equations, %ld Jacobians, "
           "%ld switches, %ld events\n",
           s->duration_s, 1e3 * j->run.cpu_s, s->duration_s / j->run.cpu_s, c->steps, c->rates, c->jacobians,
           c->to_bdf + c->to_adams, c->events);
    if (j->has_sweep) {
        print_sweep("control period", j->sweep.period, j->sweep.period_count);
        print_sweep("gain", j->sweep.gain, j->sweep.gain_count);
        print_sweep("oil", j->sweep.oil, j->sweep.oil_count);
        print_sweep("Coriolis", j->sweep.coriolis, 2);
        printf("apart without Coriolis terms: %.3f mrad at most\n", 1e3 * j->sweep.coriolis[0].apart_rad);
    }
    printf("\nverdict: %s\n", verdict_name(j->gate.verdict));
    for (size_t i = 0; i < j->gate.count; i++) printf("  - %s\n", j->gate.reason[i]);
}
