/* print_reliability REPORT.html [TRIALS]: the probability of contact that is told, beside the share of trials
 * that touched; 20000 trials (minutes) unless said. */
#include "core/report.h"
#include "tests/sim/clearance_trials.h"

static void diagram(td_report *report, const reliability *r)
{
    double share[BINS], x[2 * BINS], y[2 * BINS];
    const double ends[2] = {0, 1};
    td_series series[2 + BINS] = {
        {.label = "as told", .shape = TD_SHAPE_LINE, .tone = TD_TONE_GOOD, .count = 2, .x = ends, .y = ends},
        {.label = "share that touched", .shape = TD_SHAPE_POINT, .count = BINS, .x = r->mean, .y = share}};
    for (int b = 0; b < BINS; b++) {
        share[b] = (double)r->hits[b] / r->n[b];
        x[2 * b] = x[2 * b + 1] = r->mean[b];
        y[2 * b] = r->interval[b][0];
        y[2 * b + 1] = r->interval[b][1];
        series[2 + b] = (td_series){.label = b ? NULL : "99.9 % of all ten (Clopper and Pearson)",
                                    .shape = TD_SHAPE_LINE,
                                    .tone = TD_TONE_WARN,
                                    .count = 2,
                                    .x = x + 2 * b,
                                    .y = y + 2 * b};
    }
    const td_axes axes = {.title = "Contact",
                          .x_label = "predicted probability",
                          .y_label = "share of trials",
                          .x_max = 1,
                          .y_max = 1,
                          .equal = 1};
    td_report_plot(report, &axes, series, 2 + BINS);
}

static void table(td_report *report, const reliability *r)
{
    const char *const names[] = {"predicted", "trials", "contacts", "mean prediction", "share", "interval"};
    td_report_table_begin(report, names, 6);
    for (int b = 0; b < BINS; b++) {
        td_report_cell(report, TD_TONE_PLAIN, "%.1f to %.1f", (double)b / BINS, (b + 1.0) / BINS);
        td_report_cell(report, TD_TONE_PLAIN, "%d", r->n[b]);
        td_report_cell(report, TD_TONE_PLAIN, "%d", r->hits[b]);
        td_report_cell(report, TD_TONE_PLAIN, "%.4f", r->mean[b]);
        td_report_cell(report, TD_TONE_PLAIN, "%.4f", (double)r->hits[b] / r->n[b]);
        const bool holds = r->mean[b] >= r->interval[b][0] && r->mean[b] <= r->interval[b][1];
        td_report_cell(report, holds ? TD_TONE_GOOD : TD_TONE_BAD, "%.4f to %.4f", r->interval[b][0],
                       r->interval[b][1]);
        td_report_row_end(report);
    }
    td_report_table_end(report);
}

int main(int argc, char **argv)
{
    td_error failure;
    if (argc < 2) {
        printf("usage: print_reliability REPORT.html [TRIALS]\n");
        return 2;
    }
    const reliability r = measure_reliability(argc > 2 ? atoi(argv[2]) : 20000);
    td_report *report =
        td_report_new("Reliability of the probability of contact", "motions over rough ground");
    td_report_text(
        report,
        "%d motions of an arm, each against a truth drawn from the errors it was told of: noise of the map's "
        "cells, one pose of the vehicle and one of the map, zeros and readings of the joints. Contacts "
        "differ "
        "from those predicted by %.2f standard deviations of chance.",
        r.count, r.difference / sqrt(r.variance));
    td_report_grid_begin(report, 2);
    diagram(report, &r);
    td_report_grid_end(report);
    table(report, &r);
    if (td_report_write(report, argv[1], &failure) != TD_OK) {
        printf("%s\n", failure.message);
        return 1;
    }
    td_report_free(&report);
    return 0;
}
