/* What --identify found, for people: parameters, what is not told, measured against predicted force, and the
 * proposed motion. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/simulate_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

static int told_of(const td_identification *id)
{
    int told = 0;
    for (int a = 0; a < id->count; a++) told += id->parameter[a].told;
    return told;
}

static void figures(td_report *r, const identify_job *j)
{
    const td_identification *id = j->id;
    td_report_figures_begin(r);
    td_report_figure(r, "parameters told", TD_TONE_PLAIN, "%d / %d", told_of(id), id->count);
    td_report_figure(r, "force error over its noise", id->misfit < 1.2 ? TD_TONE_GOOD : TD_TONE_WARN, "%.2f",
                     id->misfit);
    td_report_figure(r, "condition", TD_TONE_PLAIN, "%.0f", id->condition);
    if (j->then) {
        td_report_figure(r, "told by the proposed motion", TD_TONE_GOOD, "%d / %d", told_of(j->then),
                         id->count);
        td_report_figure(r, "its condition", TD_TONE_PLAIN, "%.0f", j->then->condition);
    }
    td_report_figures_end(r);
}

/* So that a sigma has two digits at least. */
static int decimals(double sigma)
{
    const double places = 1 - floor(log10(sigma));
    return places > 0 ? (int)fmin(places, 9) : 0;
}

static void parameter_table(td_report *r, const identify_job *j)
{
    static const char *const heads[] = {"parameter",  "value",         "unit",
                                        "robot file", "apart (sigma)", "sigma, proposed"};
    td_report_table_begin(r, heads, 6);
    for (int a = 0; a < j->id->count; a++) {
        const td_identified *p = j->id->parameter + a;
        const double apart = (p->value - p->prior) / p->sigma;
        td_report_cell(r, TD_TONE_PLAIN, "%s", p->name);
        if (p->told)
            td_report_cell(r, TD_TONE_GOOD, "%.*f ± %.*f", decimals(p->sigma), p->value, decimals(p->sigma),
                           p->sigma);
        else
            td_report_cell(r, TD_TONE_WARN, "not told");
        td_report_cell(r, TD_TONE_PLAIN, "%s", p->unit);
        td_report_cell(r, TD_TONE_PLAIN, "%.5g", p->prior);
        td_report_cell(r, p->told && fabs(apart) > 3 ? TD_TONE_WARN : TD_TONE_PLAIN, "%.1f",
                       p->told ? round(10 * apart) / 10 + 0.0 : NAN);
        td_report_cell(r, TD_TONE_PLAIN, "%.2g", j->then ? j->then->parameter[a].sigma : NAN);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void meaning_table(td_report *r, const td_identification *id)
{
    static const char *const heads[] = {"parameter", "what it is the sum of"};
    td_report_table_begin(r, heads, 2);
    for (int a = 0; a < id->count; a++) {
        td_report_cell(r, TD_TONE_PLAIN, "%s", id->parameter[a].name);
        td_report_cell(r, TD_TONE_PLAIN, "%s", id->parameter[a].means);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void weak_table(td_report *r, const td_identification *id)
{
    static const char *const heads[] = {"sigma, in the parameters' sizes", "sum of parameters"};
    if (!id->weak_count) return;
    td_report_text(
        r, "Sums that the motion tells least, each parameter in the size that one may expect of it. A "
           "sigma near ten is what was assumed before: nothing was learnt.");
    td_report_table_begin(r, heads, 2);
    for (int i = 0; i < id->weak_count; i++) {
        td_report_cell(r, TD_TONE_PLAIN, "%.2f", id->weak[i].share);
        td_report_cell(r, TD_TONE_PLAIN, "%s", id->weak[i].means);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* Sigma over size, of the log and of the proposed motion. */
static void sigma_plot(td_report *r, const identify_job *j)
{
    const size_t count = (size_t)j->id->count;
    double *x = calloc(3 * count, sizeof *x), *now = x + count, *then = now + count;
    const char **names = calloc(count, sizeof *names);
    for (size_t a = 0; x && names && a < count; a++) {
        const td_identified *p = j->id->parameter + a;
        x[a] = (double)a;
        now[a] = log10(p->sigma / p->size);
        then[a] = j->then ? log10(j->then->parameter[a].sigma / p->size) : NAN;
        names[a] = p->name;
    }
    if (x && names) {
        const td_series series[2] = {{.label = "this log",
                                      .shape = TD_SHAPE_POINT,
                                      .tone = TD_TONE_WARN,
                                      .count = count,
                                      .x = x,
                                      .y = now},
                                     {.label = "proposed motion",
                                      .shape = TD_SHAPE_CROSS,
                                      .tone = TD_TONE_GOOD,
                                      .count = count,
                                      .x = x,
                                      .y = then}};
        const td_axes axes = {.title = "sigma over size: below -0.3 a parameter is told",
                              .x_label = "parameter",
                              .y_label = "log10 of sigma over size",
                              .x_names = names,
                              .x_name_count = count};
        td_report_plot(r, &axes, series, j->then ? 2 : 1);
    }
    free(x);
    free(names);
}

/* Measured and predicted force of each joint, where it moves. */
static void force_plots(td_report *r, const identify_job *j)
{
    const size_t n = (size_t)j->id->joints;
    double *x = calloc(4 * j->count, sizeof *x), *measured = x + j->count, *predicted = measured + j->count,
           *left = predicted + j->count;
    for (size_t k = 0; x && k < n && k < 12; k++) {
        size_t count = 0;
        for (size_t i = 0; i < j->count; i++) {
            if (!j->id->used[i * n + k]) continue;
            x[count] = j->time_s[i];
            measured[count] = 1e-3 * j->force[i * n + k];
            predicted[count] = 1e-3 * j->id->predicted[i * n + k];
            left[count] = measured[count] - predicted[count];
            count++;
        }
        const bool motor = simulate_is_motor(j->scenario->robot, (int)k);
        const char *name = j->scenario->robot->joint[k].name, *unit = motor ? "torque (kN m)" : "force (kN)";
        if (!count) {
            td_report_text(r, "%s does not move; its force is not used.", name);
            continue;
        }
        char title[TD_NAME_SIZE + 40];
        snprintf(title, sizeof title, "%s: measured less predicted", name);
        const td_series both[2] = {{.label = "measured",
                                    .shape = TD_SHAPE_CROSS,
                                    .tone = TD_TONE_WARN,
                                    .count = count,
                                    .x = x,
                                    .y = measured},
                                   {.label = "predicted",
                                    .shape = TD_SHAPE_POINT,
                                    .tone = TD_TONE_GOOD,
                                    .count = count,
                                    .x = x,
                                    .y = predicted}};
        const td_series rest = {.shape = TD_SHAPE_POINT, .count = count, .x = x, .y = left};
        const td_axes axes = {.title = name, .x_label = "time (s)", .y_label = unit},
                      rest_axes = {.title = title, .x_label = "time (s)", .y_label = unit};
        td_report_plot(r, &axes, both, 2);
        td_report_plot(r, &rest_axes, &rest, 1);
    }
    free(x);
}

static void proposed_plots(td_report *r, const identify_job *j)
{
    enum { POINTS = 400 };
    const int n = j->proposed.joints < 12 ? j->proposed.joints : 12;
    double *x = calloc(POINTS * 25, sizeof *x);
    td_series angle[12], rate[12];
    for (int i = 0; x && i < POINTS; i++) {
        double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS];
        x[i] = j->proposed.duration_s * i / (POINTS - 1);
        td_excitation_at(q, dq, NULL, &j->proposed, x[i]);
        for (int k = 0; k < n; k++) {
            x[(1 + k) * POINTS + i] = DEGREES * q[k];
            x[(13 + k) * POINTS + i] = dq[k];
        }
    }
    for (int k = 0; x && k < n; k++) {
        angle[k] = (td_series){.label = j->scenario->robot->joint[k].name,
                               .shape = TD_SHAPE_LINE,
                               .count = POINTS,
                               .x = x,
                               .y = x + (1 + k) * POINTS};
        rate[k] = angle[k];
        rate[k].y = x + (13 + k) * POINTS;
    }
    if (x) {
        const td_axes angles = {.title = "positions", .x_label = "time (s)", .y_label = "position (deg)"},
                      rates = {.title = "rates", .x_label = "time (s)", .y_label = "rate (rad/s)"};
        td_report_plot(r, &angles, angle, (size_t)n);
        td_report_plot(r, &rates, rate, (size_t)n);
    }
    free(x);
}

static void link_table(td_report *r, const identify_job *j)
{
    static const char *const heads[] = {"link", "mass (kg)", "robot file (kg)", "centre of mass x, y, z (m)"};
    td_report_table_begin(r, heads, 4);
    for (int i = 0; i < j->id->link_count; i++) {
        const td_identified_link *l = j->id->link + i;
        const td_robot_link *file = j->scenario->robot->link + l->link;
        const double *p = l->parameter;
        td_report_cell(r, TD_TONE_PLAIN, "%s", file->name);
        td_report_cell(r, TD_TONE_PLAIN, "%.0f ± %.0f", p[0], l->sigma[0]);
        td_report_cell(r, TD_TONE_PLAIN, "%.0f", file->mass_kg);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f, %.3f, %.3f", p[1] / p[0], p[2] / p[0], p[3] / p[0]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void fill(td_report *r, const identify_job *j)
{
    figures(r, j);
    td_report_heading(r, "Parameters");
    td_report_text(r,
                   "Only sums of the links' inertias enter the joints' forces; each is named after the first "
                   "of them. Values are ± one sigma, from the noise that the log itself shows.");
    parameter_table(r, j);
    sigma_plot(r, j);
    td_report_heading(r, "What the motion does not tell");
    weak_table(r, j->id);
    td_report_text(
        r, "%d of the links' own parameters enter no joint's force in any motion; result.yaml lists them.",
        j->id->never_count);
    td_report_heading(r, "Forces, where the joints move");
    td_report_grid_begin(r, 2);
    force_plots(r, j);
    td_report_grid_end(r);
    td_report_heading(r, "The proposed motion");
    td_report_text(
        r,
        "%g s; teledimos simulate takes it as proposed.yaml. It keeps the robot's limits; that nothing "
        "is in its way is for the user to see.",
        j->proposed.duration_s);
    td_report_grid_begin(r, 2);
    proposed_plots(r, j);
    td_report_grid_end(r);
    td_report_heading(r, "Links");
    td_report_text(
        r, "Bodies nearest to the robot file's that agree with what was identified%s.",
        j->id->feasible ? "" : "; those that no body could have were moved the least that makes them one");
    link_table(r, j);
    td_report_heading(r, "What each parameter is the sum of");
    meaning_table(r, j->id);
}

td_status identify_report(const void *done, const char *path, td_error *error)
{
    const identify_job *j = done;
    char subtitle[400];
    snprintf(subtitle, sizeof subtitle, "robot %s, %zu samples of %.1f s", j->scenario->robot->name, j->count,
             j->time_s[j->count - 1] - j->time_s[0]);
    td_report *r = td_report_new("Identified parameters", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &j->gate);
    fill(r, j);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
