/* A simulated task for people: the paper's figures 4 (X and Y of the tool) and 5 (joints 1 and 3), desired
 * and actual, the other joints, what the suspension does to it, the phases, the clock. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

enum { MOST = 4 };

typedef double pick(const task_sample *a, int k);

static double desired(const task_sample *a, int k)
{
    return a->tool_wanted.t[k];
}
static double actual(const task_sample *a, int k)
{
    return a->tool.t[k];
}
static double joint_desired(const task_sample *a, int k)
{
    return DEGREES * a->wanted[k];
}
static double joint_actual(const task_sample *a, int k)
{
    return DEGREES * a->state.q[k];
}
static double off(const task_sample *a, int k)
{
    return 1e3 * (a->tool.t[k] - a->tool_wanted.t[k]);
}
static double pitch(const task_sample *a, int k)
{
    double rpy[3];
    simulate_angles(rpy, &a->state.site_from_vehicle);
    return DEGREES * rpy[k];
}
static double phase(const task_sample *a, int k)
{
    (void)k;
    return a->phase;
}
static double step(const task_sample *a, int k)
{
    (void)k;
    return a->step + 1;
}
static double contact(const task_sample *a, int k)
{
    return 1e-3 * (k ? a->press_n : a->contact_n);
}

static double load(const task_sample *a, int k)
{
    return k ? a->depth_m : a->load_kg;
}

typedef struct line {
    const char *label;
    const task_run *run;
    pick *get;
    int k;
    td_tone tone;
} line;

static void plot(td_report *r, const char *title, const char *y_label, const line *lines, size_t count)
{
    td_series series[MOST] = {0};
    double *values[MOST] = {NULL};
    size_t used = 0;
    for (size_t i = 0; i < count && i < MOST; i++) {
        const task_run *run = lines[i].run;
        double *x = values[i] = calloc(2 * run->count + 1, sizeof *x), *y = x ? x + run->count : NULL;
        size_t n = 0;
        for (size_t k = 0; x && k < run->count; k++) {
            const double value = lines[i].get(run->sample + k, lines[i].k);
            if (isfinite(value)) x[n] = run->sample[k].time_s, y[n++] = value;
        }
        if (n)
            series[used++] = (td_series){.label = lines[i].label,
                                         .shape = TD_SHAPE_LINE,
                                         .tone = lines[i].tone,
                                         .count = n,
                                         .x = x,
                                         .y = y};
    }
    const td_axes axes = {.title = title, .x_label = "time (s)", .y_label = y_label};
    td_report_plot(r, &axes, series, used);
    for (size_t i = 0; i < MOST; i++) free(values[i]);
}

static void figures(td_report *r, const task_job *j)
{
    const task_run *run = &j->run;
    td_report_figures_begin(r);
    td_report_figure(r, "mm off at the end", TD_TONE_PLAIN, "%.2f", 1e3 * task_steady(run));
    if (!run->after)
        td_report_figure(r, "mm, suspension locked", TD_TONE_PLAIN, "%.4f",
                         j->has_locked ? 1e3 * task_steady(&j->locked) : NAN);
    td_report_figure(r, "steps done", TD_TONE_PLAIN, "%d / %d", run->steps_done,
                     j->scenario->task->task->step_count);
    td_report_figure(r, "times real time", TD_TONE_GOOD, "%.0f", run->time_s / run->cpu_s);
    td_report_figure(r, "deadlines missed", run->live.counts.misses ? TD_TONE_WARN : TD_TONE_PLAIN, "%llu",
                     (unsigned long long)run->live.counts.misses);
    if (!run->after) {
        td_report_figure(r, "calls of the equations", TD_TONE_PLAIN, "%ld", run->counters.rates);
        td_report_figure(r, "switches of method", TD_TONE_PLAIN, "%ld",
                         run->counters.to_bdf + run->counters.to_adams);
    }
    td_report_figures_end(r);
}

static void tool(td_report *r, const task_job *j)
{
    static const char *const names[] = {"X", "Y", "Z"};
    const task_run *run = &j->run;
    td_report_heading(r, "The tool in the site, desired and actual");
    td_report_grid_begin(r, 3);
    for (int k = 0; k < 3; k++) {
        const line lines[] = {{"desired", run, desired, k, TD_TONE_WARN},
                              {"actual", run, actual, k, TD_TONE_PLAIN}};
        plot(r, names[k], "position (m)", lines, 2);
    }
    td_report_grid_end(r);
}

static void joints(td_report *r, const task_job *j)
{
    const td_robot *robot = j->scenario->robot;
    td_report_heading(r, "The joints, desired and actual");
    td_report_grid_begin(r, 2);
    for (int k = 0; k < robot->joint_count && k < 12; k++) {
        char title[TD_NAME_SIZE + 24];
        const line lines[] = {{"desired", &j->run, joint_desired, k, TD_TONE_WARN},
                              {"actual", &j->run, joint_actual, k, TD_TONE_PLAIN}};
        snprintf(title, sizeof title, "joint %d: %s", k + 1, robot->joint[k].name);
        plot(r, title, "position (deg)", lines, 2);
    }
    td_report_grid_end(r);
}

static void suspension(td_report *r, const task_job *j)
{
    td_report_heading(r, "Actual less desired, and the suspension");
    if (j->has_locked)
        td_report_text(r,
                       "When the simulation ends the tool is %.2f mm from where it should be; with the "
                       "suspension locked %.4f mm, a share of %.4f. The controller sees the joints, not the "
                       "base that sinks and tilts under them.",
                       1e3 * task_steady(&j->run), 1e3 * task_steady(&j->locked),
                       task_steady(&j->locked) / task_steady(&j->run));
    td_report_grid_begin(r, 3);
    const line free_lines[] = {{"x", &j->run, off, 0, TD_TONE_PLAIN},
                               {"y", &j->run, off, 1, TD_TONE_PLAIN},
                               {"z", &j->run, off, 2, TD_TONE_PLAIN}};
    plot(r, "the tool, on its suspension", "actual less desired (mm)", free_lines, 3);
    if (j->has_locked) {
        const line locked[] = {{"x", &j->locked, off, 0, TD_TONE_PLAIN},
                               {"y", &j->locked, off, 1, TD_TONE_PLAIN},
                               {"z", &j->locked, off, 2, TD_TONE_PLAIN}};
        plot(r, "the tool, suspension locked", "actual less desired (mm)", locked, 3);
    }
    const line base[] = {{"roll", &j->run, pitch, 0, TD_TONE_PLAIN},
                         {"pitch", &j->run, pitch, 1, TD_TONE_PLAIN}};
    plot(r, "the base turns", "angle (deg)", base, 2);
    td_report_grid_end(r);
}

static void press(td_report *r, const task_job *j)
{
    if (!j->scenario->task->has_contact) return;
    const line lines[] = {{"of the plane", &j->run, contact, 0, TD_TONE_PLAIN},
                          {"told by the cylinders", &j->run, contact, 1, TD_TONE_WARN}};
    td_report_heading(r, "Contact");
    plot(r, "force on the tool", "force (kN)", lines, 2);
}

static void digging(td_report *r, const task_job *j)
{
    if (!j->run.after) return;
    const line forces[] = {{"of the soil", &j->run, contact, 0, TD_TONE_PLAIN}},
               loads[] = {{"in the bucket", &j->run, load, 0, TD_TONE_PLAIN}},
               depths[] = {{"of the edge", &j->run, load, 1, TD_TONE_PLAIN}};
    td_report_grid_begin(r, 3);
    plot(r, "cutting force", "force (kN)", forces, 1);
    plot(r, "load", "soil (kg)", loads, 1);
    plot(r, "depth below the ground ahead", "depth (m)", depths, 1);
    td_report_grid_end(r);
}

static void session(td_report *r, const task_job *j)
{
    static const char *const heads[] = {"time (s)", "kind", "name", "text"};
    const line phases[] = {{NULL, &j->run, phase, 0, TD_TONE_PLAIN}},
               steps[] = {{NULL, &j->run, step, 0, TD_TONE_PLAIN}};
    td_report_heading(r, "The session");
    td_report_grid_begin(r, 2);
    plot(r, "phase (2 ready, 3 simulating, 4 paused, 5 simulated, 12 manual, 13 failed)", "phase", phases, 1);
    plot(r, "step of the task", "step", steps, 1);
    td_report_grid_end(r);
    td_report_table_begin(r, heads, 4);
    for (size_t i = 0; i < j->run.note_count && i < 300; i++) {
        const task_note *n = j->run.note + i;
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", n->time_s);
        td_report_cell(r, TD_TONE_PLAIN, "%s", note_kind_name(n->kind));
        td_report_cell(r, n->kind == NOTE_FAULT ? TD_TONE_BAD : TD_TONE_PLAIN, "%s", n->name);
        td_report_cell(r, TD_TONE_PLAIN, "%s", n->text);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* Ticks by lateness, a bar for each that occurred. */
static void clock_plot(td_report *r, const task_job *j)
{
    const td_clock_counts *c = &j->run.live.counts;
    double x[TD_CLOCK_BUCKETS], y[TD_CLOCK_BUCKETS];
    size_t n = 0;
    uint64_t sum = 0;
    if (!j->run.live.used || !c->ticks) return;
    for (int i = 0; i < TD_CLOCK_BUCKETS; i++) {
        if (!c->late_count[i]) continue;
        sum += c->late_count[i];
        x[n] = log10(fmax(1e-3, 1e-3 * (double)td_clock_late(c, (double)sum / (double)c->ticks)));
        y[n++] = 100 * (double)sum / (double)c->ticks;
    }
    td_report_heading(r, "Real time");
    td_report_text(
        r,
        "%llu ticks of %g ms, %llu missed by more than %g ms (%s); late by %.3f ms in the mean, %.3f ms "
        "at most; %.3f s slipped.",
        (unsigned long long)c->ticks, 1e3 * j->run.live.period_s, (unsigned long long)c->misses,
        1e3 * j->scenario->task->tolerance_s, task_miss_names[j->scenario->task->miss],
        1e-6 * c->late_sum_ns / (double)c->ticks, 1e-6 * (double)c->late_max_ns,
        1e-9 * (double)c->slipped_ns);
    const td_series series = {.shape = TD_SHAPE_LINE, .count = n, .x = x, .y = y};
    const td_axes axes = {.title = "lateness of ticks",
                          .x_label = "log10 of the lateness (us)",
                          .y_label = "ticks no later (%)"};
    td_report_plot(r, &axes, &series, 1);
}

td_status task_report(const void *done, const char *path, td_error *error)
{
    const task_job *j = done;
    const scenario *s = j->scenario;
    char subtitle[400];
    snprintf(subtitle, sizeof subtitle, "%s: task %s of robot %s, T_sim = %g s, K = %g", s->name,
             s->task->task->name, s->robot->name, s->duration_s, s->gain_1_s);
    td_report *r = td_report_new("Simulated task", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &j->gate);
    figures(r, j);
    task_report_ground(r, j);
    digging(r, j);
    tool(r, j);
    joints(r, j);
    suspension(r, j);
    press(r, j);
    session(r, j);
    clock_plot(r, j);
    const td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
