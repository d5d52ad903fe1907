/* What teledimos simulate did, for people: joints, forces, the base, the integrator's steps, the sweeps. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

enum { MOST_SERIES = 16 };

/* One number of a sample. */
typedef double pick(const simulate_job *j, const sample *a, int k);

static double angle(const simulate_job *j, const sample *a, int k)
{
    (void)j;
    return DEGREES * a->state.q[k];
}
static double wanted(const simulate_job *j, const sample *a, int k)
{
    (void)j;
    return DEGREES * a->wanted[k];
}
static double joint_rate(const simulate_job *j, const sample *a, int k)
{
    (void)j;
    return a->state.dq[k];
}
static double force(const simulate_job *j, const sample *a, int k)
{
    (void)j;
    return 1e-3 * a->state.force[k];
}
static double pressure(const simulate_job *j, const sample *a, int k)
{
    return simulate_is_motor(j->scenario.robot, k) ? NAN : 1e-6 * a->state.pressure[k];
}
static double flow(const simulate_job *j, const sample *a, int k)
{
    return simulate_is_motor(j->scenario.robot, k) ? NAN : 6e4 * a->state.flow[k];
}
static double heave(const simulate_job *j, const sample *a, int k)
{
    (void)k;
    return 1e3 * (a->state.site_from_vehicle.t[2] - j->scenario.options.site_from_anchor.t[2]);
}
static double turn(const simulate_job *j, const sample *a, int k)
{
    double rpy[3];
    (void)j;
    simulate_angles(rpy, &a->state.site_from_vehicle);
    return DEGREES * rpy[k];
}
static double energy(const simulate_job *j, const sample *a, int k)
{
    const td_machine_energy *e = &a->energy, *first = &j->run.sample[0].energy;
    const double value[4] = {e->kinetic, e->gravity - first->gravity, e->suspension, e->oil};
    return 1e-3 * value[k];
}
static double step_size(const simulate_job *j, const sample *a, int k)
{
    (void)j;
    const bool bdf = a->count.method == TD_INTEGRATOR_BDF;
    return a->count.step_s > 0 && bdf == (k == 1) ? log10(a->count.step_s) : NAN;
}
static double order(const simulate_job *j, const sample *a, int k)
{
    (void)j, (void)k;
    return a->count.order;
}

/* ---- plots over time ---- */

typedef struct picture {
    td_series series[MOST_SERIES];
    double *values; /* (MOST_SERIES, 2, samples): times and values of each series */
    size_t count, samples;
} picture;

static bool picture_begin(picture *p, const simulate_job *j)
{
    *p = (picture){.samples = j->run.count};
    p->values = calloc(2 * MOST_SERIES * p->samples + 1, sizeof *p->values);
    return p->values;
}

/* Samples for which the number is none are left out. */
static void picture_add(picture *p, const simulate_job *j, pick *get, int k, const char *label,
                        td_shape shape, td_tone tone)
{
    if (p->count == MOST_SERIES) return;
    double *x = p->values + 2 * p->count * p->samples, *y = x + p->samples;
    size_t n = 0;
    for (size_t i = 0; i < p->samples; i++) {
        const double value = get(j, j->run.sample + i, k);
        if (!isfinite(value)) continue;
        x[n] = j->run.sample[i].state.time_s;
        y[n++] = value;
    }
    if (n == 0) return;
    p->series[p->count++] =
        (td_series){.label = label, .shape = shape, .tone = tone, .count = n, .x = x, .y = y};
}

static void picture_end(td_report *r, picture *p, const char *title, const char *y_label)
{
    const td_axes axes = {.title = title, .x_label = "time (s)", .y_label = y_label};
    td_report_plot(r, &axes, p->series, p->count);
    free(p->values);
}

static void plot_joints(td_report *r, const simulate_job *j, pick *get, const char *title,
                        const char *y_label)
{
    picture p;
    if (!picture_begin(&p, j)) return;
    for (int k = 0; k < j->scenario.robot->joint_count; k++)
        picture_add(&p, j, get, k, j->scenario.robot->joint[k].name, TD_SHAPE_LINE, TD_TONE_PLAIN);
    picture_end(r, &p, title, y_label);
}

/* As the paper's figure 5: desired and actual. */
static void plot_each_joint(td_report *r, const simulate_job *j)
{
    const bool planned = j->scenario.motion.command == TD_COMMAND_RATE && j->scenario.options.hydraulics;
    for (int k = 0; k < j->scenario.robot->joint_count && k < 12; k++) {
        picture p;
        if (!picture_begin(&p, j)) return;
        if (planned) picture_add(&p, j, wanted, k, "desired", TD_SHAPE_LINE, TD_TONE_WARN);
        picture_add(&p, j, angle, k, "actual", TD_SHAPE_LINE, TD_TONE_PLAIN);
        picture_end(r, &p, j->scenario.robot->joint[k].name, "position (deg)");
    }
}

static void plot_base(td_report *r, const simulate_job *j)
{
    picture p;
    if (!picture_begin(&p, j)) return;
    picture_add(&p, j, heave, 0, "height", TD_SHAPE_LINE, TD_TONE_PLAIN);
    picture_end(r, &p, "the base, against where it bears nothing", "height (mm)");
    if (!picture_begin(&p, j)) return;
    picture_add(&p, j, turn, 0, "roll", TD_SHAPE_LINE, TD_TONE_PLAIN);
    picture_add(&p, j, turn, 1, "pitch", TD_SHAPE_LINE, TD_TONE_PLAIN);
    picture_end(r, &p, "the base turns", "angle (deg)");
}

static void plot_integrator(td_report *r, const simulate_job *j)
{
    picture p;
    if (!picture_begin(&p, j)) return;
    picture_add(&p, j, step_size, 0, "Adams", TD_SHAPE_POINT, TD_TONE_GOOD);
    picture_add(&p, j, step_size, 1, "BDF", TD_SHAPE_POINT, TD_TONE_WARN);
    picture_end(r, &p, "size of the integrator's step, by method", "log10 of the step (s)");
    if (!picture_begin(&p, j)) return;
    picture_add(&p, j, order, 0, "order", TD_SHAPE_POINT, TD_TONE_PLAIN);
    picture_end(r, &p, "order of the method", "order");
    static const char *const parts[] = {"kinetic", "height (against the start)", "suspension", "oil"};
    if (!picture_begin(&p, j)) return;
    for (int k = 0; k < 4; k++) picture_add(&p, j, energy, k, parts[k], TD_SHAPE_LINE, TD_TONE_PLAIN);
    picture_end(r, &p, "energy", "energy (kJ)");
}

/* ---- tables ---- */

static void figures(td_report *r, const simulate_job *j)
{
    const td_integrator_counters *c = &j->run.counters;
    td_report_figures_begin(r);
    td_report_figure(r, "times real time", TD_TONE_GOOD, "%.0f", j->scenario.duration_s / j->run.cpu_s);
    td_report_figure(r, "calls of the equations", TD_TONE_PLAIN, "%ld", c->rates);
    td_report_figure(r, "steps", TD_TONE_PLAIN, "%ld", c->steps);
    td_report_figure(r, "switches of method", TD_TONE_PLAIN, "%ld", c->to_bdf + c->to_adams);
    td_report_figure(r, "stops met or left", j->run.event_count ? TD_TONE_WARN : TD_TONE_PLAIN, "%zu",
                     j->run.event_count);
    td_report_figures_end(r);
}

static void event_table(td_report *r, const simulate_job *j)
{
    static const char *const heads[] = {"time (s)", "joint", "stop", "what"};
    if (!j->run.event_count) return;
    td_report_heading(r, "Stops");
    td_report_table_begin(r, heads, 4);
    for (size_t i = 0; i < j->run.event_count && i < 200; i++) {
        const td_machine_event *e = j->run.event + i;
        td_report_cell(r, TD_TONE_PLAIN, "%.6f", e->time_s);
        td_report_cell(r, TD_TONE_PLAIN, "%s", j->scenario.robot->joint[e->joint].name);
        td_report_cell(r, TD_TONE_PLAIN, "%s", e->upper ? "upper" : "lower");
        td_report_cell(r, TD_TONE_PLAIN, "%s", e->met ? "met" : "left");
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void sweep_table(td_report *r, const char *head, const sweep_row *row, size_t count)
{
    const char *const heads[] = {head,
                                 "stable",
                                 "error (mrad)",
                                 "swing (mrad)",
                                 "calls of the equations",
                                 "steps",
                                 "share of the processor (%)"};
    td_report_table_begin(r, heads, 7);
    for (size_t i = 0; i < count; i++) {
        if (strncmp(head, "control", 7) == 0)
            td_report_cell(r, TD_TONE_PLAIN, "%g", row[i].period_s);
        else if (strncmp(head, "gain", 4) == 0)
            td_report_cell(r, TD_TONE_PLAIN, "%g", row[i].gain_1_s);
        else if (strncmp(head, "oil", 3) == 0)
            td_report_cell(r, TD_TONE_PLAIN, "%.0e", row[i].oil_n_m);
        else
            td_report_cell(r, TD_TONE_PLAIN, "%s", row[i].coriolis ? "with" : "without");
        td_report_cell(r, row[i].stable ? TD_TONE_GOOD : TD_TONE_BAD, "%s", row[i].stable ? "yes" : "no");
        td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * row[i].error_rad);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", 1e3 * row[i].swing_rad);
        td_report_cell(r, TD_TONE_PLAIN, "%ld", row[i].rates);
        td_report_cell(r, TD_TONE_PLAIN, "%ld", row[i].steps);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", 100 * row[i].cpu_share);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void sweeps(td_report *r, const sweep *w)
{
    td_report_heading(r, "Control period: where the loop loses its stability");
    td_report_text(r, "Positions controlled at that period. Each run is the motion and as long again of "
                      "calming down: stable where what swings in its last quarter is less than half of the "
                      "quarter before, or below 2 mrad.");
    sweep_table(r, "control period (s)", w->period, w->period_count);
    td_report_heading(r, "Gain of the controller: what it costs");
    sweep_table(r, "gain (1/s)", w->gain, w->gain_count);
    td_report_heading(r, "Stiffness of the oil: what it costs");
    td_report_text(
        r, "The stiffer the oil, the faster the machine's fastest time constant. An explicit method's steps "
           "shrink with it; those of an implicit one need not.");
    sweep_table(r, "oil (N/m)", w->oil, w->oil_count);
    td_report_heading(r, "Centrifugal and Coriolis terms");
    sweep_table(r, "terms", w->coriolis, 2);
    td_report_text(r, "Left out, they change the motion by at most %.3f mrad.",
                   1e3 * w->coriolis[0].apart_rad);
}

td_status simulate_report(const void *done, const char *path, td_error *error)
{
    const simulate_job *j = done;
    char subtitle[300];
    snprintf(subtitle, sizeof subtitle, "%s: %s of robot %s, %g s", j->scenario.name, j->scenario.motion.kind,
             j->scenario.robot->name, j->scenario.duration_s);
    td_report *r = td_report_new("Simulated motion", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &j->gate);
    figures(r, j);
    td_report_heading(r, "Joints");
    td_report_grid_begin(r, 2);
    plot_each_joint(r, j);
    td_report_grid_end(r);
    td_report_grid_begin(r, 2);
    plot_joints(r, j, joint_rate, "rates", "rate (rad/s)");
    plot_joints(r, j, force, "forces of the cylinders, torque of motors", "force (kN), torque (kN m)");
    plot_joints(r, j, pressure, "pressures over the pistons", "pressure (MPa)");
    plot_joints(r, j, flow, "flows through the valves", "flow (l/min)");
    td_report_grid_end(r);
    event_table(r, j);
    td_report_heading(r, "The base on its suspension");
    td_report_grid_begin(r, 2);
    plot_base(r, j);
    td_report_grid_end(r);
    td_report_heading(r, "The integrator");
    td_report_grid_begin(r, 2);
    plot_integrator(r, j);
    td_report_grid_end(r);
    if (j->has_sweep) sweeps(r, &j->sweep);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
