/* A rehearsal for people: what the cameras saw, the ground before and after, predicted against actual. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/rehearse_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

static void figures(td_report *r, const rehearse *x)
{
    td_report_figures_begin(r);
    td_report_figure(r, "m³ dug, in truth", TD_TONE_PLAIN, "%.3f", x->dug_m3);
    td_report_figure(r, "m³ measured", TD_TONE_PLAIN, "%.3f", x->measured_m3);
    td_report_figure(r, "m³, its sigma", TD_TONE_PLAIN, "%.3f", x->sigma_measured_m3);
    td_report_figure(r, "m³ of it not seen, taken as predicted", TD_TONE_PLAIN, "%.3f",
                     x->predicted_unseen_m3);
    td_report_figure(r, "m³ predicted", TD_TONE_PLAIN, "%.3f", x->predicted_m3);
    td_report_figure(r, "m³ left of the trench", TD_TONE_PLAIN, "%.3f", x->left_m3);
    td_report_figure(r, "m, the map's rms error", TD_TONE_PLAIN, "%.3f", x->map_rms_m);
    td_report_figure(r, "m, the least clearance", TD_TONE_PLAIN, "%.2f", x->clearance_m);
    td_report_figure(r, "of its sigma the rig is off", TD_TONE_PLAIN, "%.1f", x->rig_sigmas);
    td_report_figure(r, "looks", TD_TONE_PLAIN, "%d", x->looks);
    td_report_figures_end(r);
}

static void rounds(td_report *r, const rehearse *x)
{
    static const char *const columns[] = {"round",  "executed", "passes",         "above m³", "done s",
                                          "tool m", "sigma m",  "peak kN, ahead", "in sigma"};
    td_report_table_begin(r, columns, sizeof columns / sizeof *columns);
    for (int i = 0; i < x->round_count; i++) {
        const rehearse_round *o = x->round + i;
        double most = 0;
        for (int k = 0; k < MONITOR_MOST; k++) most = fmax(most, o->monitor.ratio[k]);
        td_report_cell(r, TD_TONE_PLAIN, "%d", i + 1);
        td_report_cell(r, TD_TONE_PLAIN, "%s", o->executed ? "yes" : "no");
        td_report_cell(r, TD_TONE_PLAIN, "%d", o->plan ? o->plan->pass_count : 0);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", o->plan ? o->plan->trench_m3 : 0);
        td_report_cell(r, TD_TONE_PLAIN, "%.1f", o->executed ? o->done.time_s : NAN);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f",
                       o->tip_count ? sqrt(o->tip_square / (double)o->tip_count) : NAN);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", o->executed ? o->monitor.sigma_tip_m : NAN);
        td_report_cell(r, TD_TONE_PLAIN, "%.1f, %.1f", 1e-3 * o->done.dug.peak_n, 1e-3 * o->ahead.dug.peak_n);
        td_report_cell(r, most > 6 ? TD_TONE_BAD : TD_TONE_PLAIN, "%.2f", most);
        td_report_row_end(r);
    }
    td_report_table_end(r);
    td_report_text(r, "above: what stood above the floor before the round; tool: its true place less the "
                      "predicted, rms, above the ground, and its sigma as predicted; in sigma: the largest "
                      "deviation that the monitor saw, which stops the machine from 6 on.");
}

/* ---- predicted against actual ---- */

static double pick(const task_sample *a, int what, int k)
{
    return what == 0 ? DEGREES * a->state.q[k] : what == 1 ? 1e-3 * a->state.force[k] : a->tool.t[k];
}

/* The prediction over the time of the execution, for it is along the same motions. */
static void plot(td_report *r, const rehearse_round *o, int joints, int what, int k, const char *title,
                 const char *unit)
{
    const size_t n = o->done.count;
    double *v = calloc(3 * n + 1, sizeof *v), d[MONITOR_MOST], tip[3], place[3];
    const double scale = what == 0 ? DEGREES : what == 1 ? 1e-3 : 1;
    if (!v) return;
    for (size_t i = 0; i < n; i++) {
        const task_sample *a = o->done.sample + i;
        v[i] = a->time_s;
        v[n + i] = pick(a, what, k);
        v[2 * n + i] = monitor_compare(d, tip, place, &o->ahead, a, joints)
                           ? v[n + i] - scale * d[what * joints + k]
                           : NAN;
    }
    const td_series series[] = {
        {.label = "predicted", .shape = TD_SHAPE_LINE, .count = n, .x = v, .y = v + 2 * n},
        {.label = "actual", .shape = TD_SHAPE_LINE, .count = n, .x = v, .y = v + n}};
    const td_axes axes = {.title = title, .x_label = "time (s)", .y_label = unit};
    td_report_plot(r, &axes, series, 2);
    free(v);
}

static void motions(td_report *r, const rehearse *x)
{
    char title[160];
    const td_robot *robot = x->scenario.robot;
    for (int i = 0; i < x->round_count; i++) {
        const rehearse_round *o = x->round + i;
        if (!o->executed) continue;
        snprintf(title, sizeof title, "Round %d: predicted and actual", i + 1);
        td_report_heading(r, title);
        td_report_grid_begin(r, 2);
        for (int k = 0; k < robot->joint_count; k++) {
            snprintf(title, sizeof title, "joint %s", robot->joint[k].name);
            plot(r, o, robot->joint_count, 0, k, title, "angle (deg)");
            snprintf(title, sizeof title, "force of %s", robot->joint[k].name);
            plot(r, o, robot->joint_count, 1, k, title, "force (kN)");
        }
        for (int k = 0; k < 3; k++) {
            snprintf(title, sizeof title, "the tool's %c", "xyz"[k]);
            plot(r, o, robot->joint_count, 2, k, title, "place (m)");
        }
        td_report_grid_end(r);
    }
}

/* ---- pictures ---- */

/* Light from the north-west, 45 degrees high, on slopes drawn twice as steep; unknown ground is black. */
static void shade(td_report *r, const td_elevation *map, const char *caption)
{
    static const double sun[3] = {-0.5, 0.5, 0.70710678118654752}, STEEPER = 2;
    td_image *image = NULL;
    const double h = map->cell_m;
    const int n = map->columns, m = map->rows;
    if (td_image_new(&image, n, m, 1, NULL) != TD_OK) return;
    for (int row = 1; row < m - 1; row++)
        for (int c = 1; c < n - 1; c++) {
            const float *z = map->height + (size_t)row * (size_t)n + (size_t)c;
            const double dx = STEEPER * (double)(z[1] - z[-1]) / (2 * h),
                         dy = STEEPER * (double)(z[n] - z[-n]) / (2 * h);
            const double light = (sun[2] - sun[0] * dx - sun[1] * dy) / sqrt(1 + dx * dx + dy * dy);
            image->data[(size_t)(m - 1 - row) * (size_t)n + (size_t)c] =
                isnan(light) ? 0 : (uint8_t)fmax(24, fmin(255, 24 + 231 * light));
        }
    td_report_picture(r, image, 640, caption, NULL, 0);
    td_image_free(&image);
}

/* The truth over the cells of the map. */
static void shade_truth(td_report *r, const td_elevation *truth, const td_elevation *map, const char *caption)
{
    td_elevation *part = NULL;
    if (!truth || td_elevation_copy(&part, map, NULL) != TD_OK) return;
    for (int row = 0; row < map->rows; row++)
        for (int c = 0; c < map->columns; c++)
            part->height[(size_t)row * (size_t)map->columns + (size_t)c] = (float)td_elevation_at(
                truth, map->origin[0] + c * map->cell_m, map->origin[1] + row * map->cell_m, NULL);
    shade(r, part, caption);
    td_elevation_free(&part);
}

/* What the map is off: grey 0, white 0.1 m too high, black too low; where it is only predicted a chequer. */
static void show_error(td_report *r, const td_elevation *map, const td_elevation *truth)
{
    static const double MOST_M = 0.1;
    td_image *image = NULL;
    if (!truth || td_image_new(&image, map->columns, map->rows, 1, NULL) != TD_OK) return;
    for (int row = 0; row < map->rows; row++)
        for (int c = 0; c < map->columns; c++) {
            const size_t i = (size_t)row * (size_t)map->columns + (size_t)c;
            const double off =
                (double)map->height[i] - td_elevation_at(truth, map->origin[0] + c * map->cell_m,
                                                         map->origin[1] + row * map->cell_m, NULL);
            double grey = 128 + 127 * fmax(-1, fmin(1, off / MOST_M));
            if (map->provenance[i] == TD_CELL_SIMULATED) grey += (c + row) % 2 ? 40 : -40;
            image->data[(size_t)(map->rows - 1 - row) * (size_t)map->columns + (size_t)c] =
                isnan(off) ? 0 : (uint8_t)fmax(0, fmin(255, grey));
        }
    td_report_picture(r, image, 640, "the map less the truth: grey 0, white 0.1 m; chequered: predicted",
                      NULL, 0);
    td_image_free(&image);
}

static void pictures(td_report *r, const rehearse *x)
{
    if (x->film_count) {
        td_report_heading(r, "What the left camera saw");
        td_report_grid_begin(r, 4);
        for (int i = 0; i < x->film_count; i++) {
            char caption[40];
            snprintf(caption, sizeof caption, "place %d", i + 1);
            td_report_picture(r, x->film[i], 320, caption, NULL, 0);
        }
        td_report_grid_end(r);
    }
    if (!x->map_before) return;
    td_report_heading(r, "The ground");
    td_report_grid_begin(r, 2);
    shade(r, x->map_before, "the map before: x to the right, y up");
    if (x->map) shade(r, x->map, "the map after");
    shade_truth(r, x->true_before, x->map_before, "in truth before");
    shade_truth(r, x->true_after, x->map_before, "in truth after");
    if (x->map) show_error(r, x->map, x->true_after);
    td_report_grid_end(r);
}

td_status rehearse_report(const void *done, const char *path, td_error *error)
{
    const rehearse *x = done;
    char title[200];
    snprintf(title, sizeof title, "Rehearsal %s", x->setup->name);
    td_report *r = td_report_new(title, "look, plan, simulate ahead, execute, look again");
    gate_report(r, &x->gate);
    figures(r, x);
    rounds(r, x);
    pictures(r, x);
    motions(r, x);
    const td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
