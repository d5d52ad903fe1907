/* The result of a simulated task: its document, its schema, the verdict and the table on the terminal. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "core/document.h"

const gate_row task_gate_defaults[] = {
    {"steps_left", 0, 0, "steps that were not done when the simulation ended: it is too short for the task"},
    {"steady_share", 0.5, 1,
     "distance of the tool from where it should be at the end, over the task's tolerance of position"},
    {"deviation_share", 1, INFINITY,
     "largest distance of the tool from where it should be on its way, over that tolerance; pressing apart"},
    {"left_share", 0.05, 0.3,
     "on the ground: what stands above the floors of the trenches at the end, of what was to be dug: where "
     "it "
     "is a third the trench is none"},
    {"deadline_misses", 0, INFINITY,
     "--live: missed deadlines; where one is to stop the session (on_miss: stop), that refuses by itself"},
};
const size_t task_gate_count = sizeof task_gate_defaults / sizeof *task_gate_defaults;

const td_schema_row task_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "simulate"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"scenario", TD_SCHEMA_STRING, true, false, "its name"},
    {"identity", TD_SCHEMA_STRING, true, false,
     "SHA-256 of what decides the motion; --replay wants the same"},
    {"robot", TD_SCHEMA_STRING, true, false, "its name"},
    {"task", TD_SCHEMA_STRING, true, false, "its name"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"phase", TD_SCHEMA_STRING, true, false, "of the session, at its end"},
    {"fault", TD_SCHEMA_STRING, true, true, "what made it fail, the last time; null: nothing did"},
    {"steps", TD_SCHEMA_INT, true, false, "of the task"},
    {"steps_done", TD_SCHEMA_INT, true, false, "in the last run of the task"},
    {"simulation_s", TD_SCHEMA_REAL, true, false, "asked for"},
    {"trajectory_s", TD_SCHEMA_REAL, true, false, "length of the motions planned"},
    {"time_s", TD_SCHEMA_REAL, true, false, "of the session, pauses and all"},
    {"control", TD_SCHEMA_OBJECT, true, false, "of the joints: flows"},
    {"control.period_s", TD_SCHEMA_REAL, true, false, "its period"},
    {"control.gain_1_s", TD_SCHEMA_REAL, true, false, "K"},
    {"steady_error_m", TD_SCHEMA_REAL, true, true,
     "distance of the tool from where it should be when the simulation ends; null: it did not"},
    {"steady_error_xyz_m", TD_SCHEMA_REALS, true, true,
     "the same, actual less desired, in the site; order: x, y, z"},
    {"steady_error_locked_m", TD_SCHEMA_REAL, true, true,
     "the same with the suspension locked; null: there is none, or the simulation did not end"},
    {"joint_error_rad", TD_SCHEMA_REAL, true, true, "largest of the joints at the end (prismatic: m)"},
    {"deviation_max_m", TD_SCHEMA_REAL, true, false,
     "largest distance of the tool from where it should be, on its way, pressing apart"},
    {"cpu_s", TD_SCHEMA_REAL, true, false, "of one processor: planning, control, integration"},
    {"real_time_factor", TD_SCHEMA_REAL, true, true, "simulated over computing time"},
    {"deadline_misses", TD_SCHEMA_INT, true, false, "--live: how many"},
    {"f_calls", TD_SCHEMA_INT, true, false, "calls of the equations"},
    {"method_switches", TD_SCHEMA_INT, true, false, "of the integrator, between Adams and BDF"},
    {"live", TD_SCHEMA_OBJECT, false, false, "--live: ticks on the wall's clock"},
    {"live.on_miss", TD_SCHEMA_STRING, true, false, "stop, catch-up or slip"},
    {"live.tolerance_s", TD_SCHEMA_REAL, true, false, "later than this is missed"},
    {"live.ticks", TD_SCHEMA_INT, true, false, "how many"},
    {"live.overruns", TD_SCHEMA_INT, true, false, "ticks whose work took longer than the period"},
    {"live.late_mean_s", TD_SCHEMA_REAL, true, false, "lateness, mean"},
    {"live.late_p50_s", TD_SCHEMA_REAL, true, false, "half of the ticks are no later"},
    {"live.late_p99_s", TD_SCHEMA_REAL, true, false, "99 % are no later"},
    {"live.late_max_s", TD_SCHEMA_REAL, true, false, "the latest"},
    {"live.slipped_s", TD_SCHEMA_REAL, true, false,
     "by which the session fell behind the wall's clock (slip)"},
    {"live.cpu_share", TD_SCHEMA_REAL, true, false, "computing time over the session's"},
    {"dug_volume_m3", TD_SCHEMA_REAL, false, false,
     "on the ground: what was taken, in the ground, of the cells that the map knew before"},
    {"fill_m3", TD_SCHEMA_REAL, false, false, "by what such cells rose: dumped and spilt, as it lies"},
    {"planned_m3", TD_SCHEMA_REAL, false, false, "of the trenches asked for, in the ground"},
    {"left_m3", TD_SCHEMA_REAL, false, false, "of it above their floors at the end"},
    {"passes", TD_SCHEMA_INT, false, false, "cuts made"},
    {"stalls", TD_SCHEMA_INT, false, false, "cuts that stood still and were given up"},
    {"raised_max_m", TD_SCHEMA_REAL, false, false, "by which the edge was raised, at most, to keep force_n"},
    {"peak_force_n", TD_SCHEMA_REAL, false, false, "the largest force of the soil against a cut"},
    {"load_kg", TD_SCHEMA_REAL, false, false, "of soil in the bucket at the end"},
    {"mass_error_kg", TD_SCHEMA_REAL, false, false, "all soil at the end less all soil at first: 0"},
    {"clearance_min_m", TD_SCHEMA_REAL, false, true,
     "least distance from the ground of what moves, contact that is meant left out; null: nothing was "
     "checked"},
    {"events", TD_SCHEMA_ARRAY, true, false, "orders, reports, messages, phases, faults and steps, in time"},
    {"events[].period", TD_SCHEMA_INT, true, false, "of the control, from 0"},
    {"events[].time_s", TD_SCHEMA_REAL, true, false, "when"},
    {"events[].kind", TD_SCHEMA_STRING, true, false, "order, report, message, phase, fault or step"},
    {"events[].name", TD_SCHEMA_STRING, true, false, "which"},
    {"events[].text", TD_SCHEMA_STRING, true, false, "more of it"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t task_schema_count = sizeof task_schema / sizeof *task_schema;

static double length(const double v[3])
{
    return hypot(hypot(v[0], v[1]), v[2]);
}

double task_steady(const task_run *run)
{
    return run->simulated ? length(run->steady) : NAN;
}

static double deviation_max(const task_run *run)
{
    double most = 0;
    for (size_t i = 0; i < run->count; i++) {
        double off[3];
        for (int k = 0; k < 3; k++) off[k] = run->sample[i].tool.t[k] - run->sample[i].tool_wanted.t[k];
        if (run->sample[i].phase == TD_PHASE_SIMULATING && isnan(run->sample[i].press_n) &&
            !run->sample[i].loose)
            most = fmax(most, length(off));
    }
    return most;
}

static int steps_left(const task_job *j)
{
    return j->scenario->task->task->step_count - j->run.steps_done;
}

/* What the operator is to hear of a fault: the report before it says more than the fault itself. */
static const char *why_failed(const task_run *run)
{
    const char *text = "";
    for (size_t i = 0; i < run->note_count; i++)
        if (run->note[i].kind == NOTE_REPORT && run->note[i].text[0]) text = run->note[i].text;
    return text;
}

void task_judge(task_job *j, const gate_row *rows)
{
    const task_run *run = &j->run;
    gate_result *g = &j->gate;
    const double tolerance = j->scenario->task->task->tolerance.position_m, steady = task_steady(run);
    if (run->phase == TD_PHASE_FAILED)
        gate_add(g, VERDICT_REFUSED, "%s%s%s", td_fault_text(run->fault), *why_failed(run) ? ": " : "",
                 why_failed(run));
    else if (!run->simulated)
        gate_add(g, VERDICT_REFUSED, "the simulation was not run to its end (%s)", td_phase_text(run->phase));
    if (run->simulated) {
        gate_check(g, rows, task_gate_count, "steps_left", steps_left(j),
                   "%d of %d steps were not done in %g s of simulation", steps_left(j),
                   j->scenario->task->task->step_count, j->scenario->duration_s);
        gate_check(g, rows, task_gate_count, "steady_share", steady / tolerance,
                   "the tool ends %.1f mm from where it should be (tolerance %.1f mm)", 1e3 * steady,
                   1e3 * tolerance);
    }
    gate_check(
        g, rows, task_gate_count, "deviation_share", deviation_max(run) / tolerance,
        "on its way the tool was up to %.0f mm from where it should be (tolerance %.0f mm): plan slower, "
        "by duration_s or limits",
        1e3 * deviation_max(run), 1e3 * tolerance);
    const task_dug *d = &run->dug;
    if (run->simulated && d->planned_m3 > 0)
        gate_check(g, rows, task_gate_count, "left_share", d->left_m3 / d->planned_m3,
                   "%.2f of %.2f m3 still stand above the floor of the trench: the soil is too hard for the "
                   "force, or the way was blocked (events)",
                   d->left_m3, d->planned_m3);
    gate_check(g, rows, task_gate_count, "deadline_misses", (double)run->live.counts.misses,
               "%llu of %llu deadlines were missed", (unsigned long long)run->live.counts.misses,
               (unsigned long long)run->live.counts.ticks);
}

/* ---- the document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *live_json(const task_job *j)
{
    const td_clock_counts *c = &j->run.live.counts;
    json_t *o = json_object();
    set(o, "on_miss", json_string(task_miss_names[j->scenario->task->miss]));
    set(o, "tolerance_s", td_json_real(j->scenario->task->tolerance_s));
    set(o, "ticks", json_integer((json_int_t)c->ticks));
    set(o, "overruns", json_integer((json_int_t)c->overruns));
    set(o, "late_mean_s", td_json_real(c->ticks ? 1e-9 * c->late_sum_ns / (double)c->ticks : 0));
    set(o, "late_p50_s", td_json_real(1e-9 * (double)td_clock_late(c, 0.5)));
    set(o, "late_p99_s", td_json_real(1e-9 * (double)td_clock_late(c, 0.99)));
    set(o, "late_max_s", td_json_real(1e-9 * (double)c->late_max_ns));
    set(o, "slipped_s", td_json_real(1e-9 * (double)c->slipped_ns));
    set(o, "cpu_share", td_json_real(j->run.time_s > 0 ? j->run.cpu_s / j->run.time_s : 0));
    return o;
}

static json_t *events_json(const task_run *run)
{
    json_t *list = json_array();
    for (size_t i = 0; i < run->note_count; i++) {
        const task_note *n = run->note + i;
        json_t *o = json_object();
        set(o, "period", json_integer(n->period));
        set(o, "time_s", td_json_real(n->time_s));
        set(o, "kind", json_string(note_kind_name(n->kind)));
        set(o, "name", json_string(n->name));
        set(o, "text", json_string(n->text));
        json_array_append_new(list, o);
    }
    return list;
}

static void set_errors(json_t *root, const task_job *j)
{
    const task_run *run = &j->run;
    const double none[3] = {NAN, NAN, NAN};
    set(root, "steady_error_m", td_json_real(task_steady(run)));
    set(root, "steady_error_xyz_m", td_json_reals(run->simulated ? run->steady : none, 3));
    set(root, "steady_error_locked_m", td_json_real(j->has_locked ? task_steady(&j->locked) : NAN));
    set(root, "joint_error_rad", td_json_real(run->simulated ? run->joint_off : NAN));
    set(root, "deviation_max_m", td_json_real(deviation_max(run)));
    set(root, "cpu_s", td_json_real(run->cpu_s));
    set(root, "real_time_factor", td_json_real(run->cpu_s > 0 ? run->time_s / run->cpu_s : NAN));
    set(root, "deadline_misses", json_integer((json_int_t)run->live.counts.misses));
    set(root, "f_calls", json_integer(run->counters.rates));
    set(root, "method_switches", json_integer(run->counters.to_bdf + run->counters.to_adams));
}

static void set_ground(json_t *root, const task_job *j)
{
    const task_dug *d = &j->run.dug;
    double cut, fill;
    task_volumes(&cut, &fill, j);
    set(root, "dug_volume_m3", td_json_real(cut));
    set(root, "fill_m3", td_json_real(fill));
    set(root, "planned_m3", td_json_real(d->planned_m3));
    set(root, "left_m3", td_json_real(d->left_m3));
    set(root, "passes", json_integer(d->passes));
    set(root, "stalls", json_integer(d->stalls));
    set(root, "raised_max_m", td_json_real(d->raised_m));
    set(root, "peak_force_n", td_json_real(d->peak_n));
    set(root, "load_kg", td_json_real(d->load_kg));
    set(root, "mass_error_kg", td_json_real(d->mass_error_kg));
    set(root, "clearance_min_m", td_json_real(d->clearance_m));
}

static json_t *products_json(const task_job *j)
{
    json_t *o = json_pack("{s:s, s:s, s:s, s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html",
                          "trajectory", "trajectory.csv", "events", "events.csv", "recording",
                          "recording.mcap", "log", "log.jsonl");
    if (!j->run.after) return o;
    set(o, "before", json_string("before.tif"));
    set(o, "after", json_string("after.tif"));
    return o;
}

json_t *task_result(const task_job *j)
{
    const scenario *s = j->scenario;
    const task_run *run = &j->run;
    char identity[TD_HASH_HEX_SIZE] = "";
    json_t *root = json_object(), *reasons = json_array();
    task_identity(identity, s, NULL);
    set(root, "job", json_string("simulate"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "scenario", json_string(s->name));
    set(root, "identity", json_string(identity));
    set(root, "robot", json_string(s->robot->name));
    set(root, "task", json_string(s->task->task->name));
    set(root, "verdict", json_string(verdict_name(j->gate.verdict)));
    for (size_t i = 0; i < j->gate.count; i++) json_array_append_new(reasons, json_string(j->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "phase", json_string(td_phase_text(run->phase)));
    set(root, "fault", run->fault == TD_FAULT_NONE ? json_null() : json_string(td_fault_text(run->fault)));
    set(root, "steps", json_integer(s->task->task->step_count));
    set(root, "steps_done", json_integer(run->steps_done));
    set(root, "simulation_s", td_json_real(s->duration_s));
    set(root, "trajectory_s", td_json_real(run->planned_s));
    set(root, "time_s", td_json_real(run->time_s));
    set(root, "control", json_pack("{s:f, s:f}", "period_s", s->period_s, "gain_1_s", s->gain_1_s));
    set_errors(root, j);
    if (run->live.used) set(root, "live", live_json(j));
    if (run->after) set_ground(root, j);
    set(root, "events", events_json(run));
    set(root, "products", products_json(j));
    return root;
}

/* ---- on the terminal ---- */

void task_table(const void *done)
{
    const task_job *j = done;
    const task_run *run = &j->run;
    printf("%9s  %-8s %-16s %s\n", "time s", "kind", "name", "");
    for (size_t i = 0; i < run->note_count && i < 60; i++) {
        const task_note *n = run->note + i;
        printf("%9.3f  %-8s %-16s %s\n", n->time_s, note_kind_name(n->kind), n->name, n->text);
    }
    if (run->note_count > 60) printf("%9s  and %zu more: events.csv\n", "", run->note_count - 60);
    printf("\n%d of %d steps; off by %.1f mm at most on the way", run->steps_done,
           j->scenario->task->task->step_count, 1e3 * deviation_max(run));
    if (run->simulated)
        printf("; at the end by %.2f mm (x %+.2f, y %+.2f, z %+.2f)", 1e3 * task_steady(run),
               1e3 * run->steady[0], 1e3 * run->steady[1], 1e3 * run->steady[2]);
    if (j->has_locked) printf(", suspension locked %.4f mm", 1e3 * task_steady(&j->locked));
    printf("\n%g s in %.1f ms, %.0f times real time: %ld calls of the equations, %ld switches of method\n",
           run->time_s, 1e3 * run->cpu_s, run->time_s / run->cpu_s, run->counters.rates,
           run->counters.to_bdf + run->counters.to_adams);
    if (run->after) {
        double cut, fill;
        task_volumes(&cut, &fill, j);
        printf("ground: %.3f m3 dug in %d passes, %.3f m3 of fill, %.3f m3 left; at most %.1f kN; clearance "
               "%.2f m; mass off by %g kg\n",
               cut, run->dug.passes, fill, run->dug.left_m3, 1e-3 * run->dug.peak_n, run->dug.clearance_m,
               run->dug.mass_error_kg);
    }
    if (run->live.used) {
        const td_clock_counts *c = &run->live.counts;
        printf("real time: %llu ticks, %llu missed (%s), late by %.3f ms (99 %%), %.3f ms (most); %.1f %% of "
               "the "
               "processor\n",
               (unsigned long long)c->ticks, (unsigned long long)c->misses,
               task_miss_names[j->scenario->task->miss], 1e-6 * (double)td_clock_late(c, 0.99),
               1e-6 * (double)c->late_max_ns, 100 * run->cpu_s / run->time_s);
    }
    printf("\nverdict: %s\n", verdict_name(j->gate.verdict));
    for (size_t i = 0; i < j->gate.count; i++) printf("  - %s\n", j->gate.reason[i]);
}
