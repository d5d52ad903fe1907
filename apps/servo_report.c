/* What teledimos servo did, for people: the corners' ways in the image, errors, velocities, the starts. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "core/report.h"

enum { MOST_SERIES = 16 };

typedef double pick(const servo_sample *a, int k);

static double whole(const servo_sample *a, int k)
{
    (void)k;
    return log10(a->whole_px);
}
static double controlled(const servo_sample *a, int k)
{
    (void)k;
    return log10(a->controlled_px);
}
static double tip(const servo_sample *a, int k)
{
    (void)k;
    return log10(1e3 * a->tip_error_m);
}
static double measured_rate(const servo_sample *a, int k)
{
    return a->dq[k];
}
static double commanded_rate(const servo_sample *a, int k)
{
    return a->rate[k];
}
static double time_of(const servo_sample *a, int k)
{
    (void)k;
    return a->time_s;
}
static double now(const servo_sample *a, int k)
{
    return a->now[k];
}

typedef struct picture {
    td_series series[MOST_SERIES];
    double *values;
    size_t count, samples;
} picture;

static bool begin(picture *p, const servo_run *run)
{
    *p = (picture){.samples = run->count};
    p->values = calloc(2 * MOST_SERIES * p->samples + 1, sizeof *p->values);
    return p->values;
}

static void add(picture *p, const servo_run *run, pick *get_x, int x, pick *get_y, int y, const char *label,
                td_tone tone)
{
    if (p->count == MOST_SERIES) return;
    double *at = p->values + 2 * p->count * p->samples, *up = at + p->samples;
    size_t n = 0;
    for (size_t i = 0; i < p->samples; i++) {
        const double a = get_x(run->sample + i, x), b = get_y(run->sample + i, y);
        if (!isfinite(a) || !isfinite(b)) continue;
        at[n] = a, up[n++] = b;
    }
    if (n == 0) return;
    p->series[p->count++] =
        (td_series){.label = label, .shape = TD_SHAPE_LINE, .tone = tone, .count = n, .x = at, .y = up};
}

static void end(td_report *r, picture *p, const char *title, const char *y_label)
{
    const td_axes axes = {.title = title, .x_label = "time (s)", .y_label = y_label};
    if (p->count) td_report_plot(r, &axes, p->series, p->count);
    free(p->values);
}

static void report_paths(td_report *r, const servo_run *run)
{
    picture p;
    double x[4], y[4];
    if (!run->image) return;
    if (run->count == 0) {
        td_report_picture(r, run->image, 640, "the camera's last image", NULL, 0);
        return;
    }
    if (!begin(&p, run)) return;
    const servo_sample *last = run->sample + run->count - 1;
    for (int i = 0; i < 4; i++) {
        x[i] = last->goal[2 * i], y[i] = last->goal[2 * i + 1];
        add(&p, run, now, 2 * i, now, 2 * i + 1, i == 0 ? "the corners' ways" : NULL, TD_TONE_WARN);
    }
    p.series[p.count++] = (td_series){.label = "their goals at the end",
                                      .shape = TD_SHAPE_CROSS,
                                      .tone = TD_TONE_GOOD,
                                      .count = 4,
                                      .x = x,
                                      .y = y};
    td_report_picture(r, run->image, 640, "the camera's last image", p.series, p.count);
    free(p.values);
}

static void report_plots(td_report *r, const servo_job *j)
{
    const td_robot *robot = j->scenario.scene->scene.robot;
    const servo_run *run = &j->run;
    picture p;
    td_report_grid_begin(r, 2);
    if (begin(&p, run)) {
        add(&p, run, time_of, 0, whole, 0, "whole", TD_TONE_PLAIN);
        add(&p, run, time_of, 0, controlled, 0, "in what the arm controls", TD_TONE_PLAIN);
        end(r, &p, "Error in the image", "log10 of px");
    }
    if (begin(&p, run)) {
        add(&p, run, time_of, 0, tip, 0, NULL, TD_TONE_PLAIN);
        end(r, &p, "Error of the tip", "log10 of mm");
    }
    if (begin(&p, run)) {
        for (int k = 0; k < robot->joint_count; k++)
            add(&p, run, time_of, 0, commanded_rate, k, robot->joint[k].name, TD_TONE_PLAIN);
        end(r, &p, "Commanded velocities", "rad/s");
    }
    if (begin(&p, run)) {
        for (int k = 0; k < robot->joint_count; k++)
            add(&p, run, time_of, 0, measured_rate, k, robot->joint[k].name, TD_TONE_PLAIN);
        end(r, &p, "Velocities", "rad/s");
    }
    td_report_grid_end(r);
}

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void report_quantiles(td_report *r, const servo_starts *s)
{
    static const char *const columns[] = {"of those that converged", "median", "9 of 10 within", "largest"};
    const struct {
        const char *name;
        const double *value;
        double scale;
    } row[] = {{"steady error in the image, px", s->steady_px, 1},
               {"error of the tip, mm", s->tip_m, 1e3},
               {"the same by its sigma", s->sigmas, 1}};
    if (s->met == 0) return;
    td_report_table_begin(r, columns, sizeof columns / sizeof *columns);
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        td_report_cell(r, TD_TONE_PLAIN, "%s", row[i].name);
        for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.2f", row[i].scale * row[i].value[k]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void report_starts(td_report *r, const servo_job *j)
{
    static const char *const columns[] = {"start",    "outcome", "time (s)", "steady (px)",
                                          "tip (mm)", "sigmas",  "reason"};
    const servo_starts *s = &j->starts;
    td_report_heading(r, "Starts");
    td_report_text(r,
                   "%d of %zu drawn starts converged. Of those, %d of %d tips are within 3 sigma; the errors "
                   "are %.2f of their sigma (1: sigma is right).",
                   s->met, s->count, s->covered, s->judged, s->rms_sigmas);
    report_quantiles(r, s);
    td_report_table_begin(r, columns, sizeof columns / sizeof *columns);
    for (size_t i = 0; i < s->count; i++) {
        const servo_run *run = s->run + i;
        td_report_cell(r, TD_TONE_PLAIN, "%zu", i + 1);
        td_report_cell(r, servo_met(run) ? TD_TONE_GOOD : TD_TONE_BAD, "%s", td_servo_phase_name(run->phase));
        td_report_cell(r, TD_TONE_PLAIN, "%.1f", run->time_s);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", run->steady_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * length(run->tip_error));
        td_report_cell(r, run->sigmas > 3 ? TD_TONE_WARN : TD_TONE_PLAIN, "%.2f", run->sigmas);
        td_report_cell(r, TD_TONE_PLAIN, "%s", run->reason);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

td_status servo_report(const void *done, const char *path, td_error *error)
{
    const servo_job *j = done;
    const servo_run *run = &j->run;
    td_report *r = td_report_new("Visual servo", j->scenario.name);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "no memory for the report");
    gate_report(r, &j->gate);
    td_report_figures_begin(r);
    td_report_figure(r, "time", TD_TONE_PLAIN, "%.1f s", run->time_s);
    td_report_figure(r, "steady error", TD_TONE_PLAIN, "%.3f px", run->steady_px);
    td_report_figure(r, "tip off by", TD_TONE_PLAIN, "%.2f mm", 1e3 * length(run->tip_error));
    td_report_figure(r, "of its sigma", TD_TONE_PLAIN, "%.2f", run->sigmas);
    if (run->lost_s > 0) td_report_figure(r, "out of sight", TD_TONE_PLAIN, "%.1f s", run->lost_s);
    td_report_figures_end(r);
    if (servo_met(run)) td_report_text(r, "%s: %s", td_servo_phase_name(run->phase), run->reason);
    report_paths(r, run);
    report_plots(r, j);
    if (j->starts.count) report_starts(r, j);
    const td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
