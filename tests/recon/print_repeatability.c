/* print_repeatability REPORT.html [POINTS]: curves of repeatability beside OpenCV's, over rotation, scale,
 * gamma and the number of points, for a person to look at. */
#include "core/report.h"
#include "tests/recon/repeatability.h"

static void plot(td_report *report, const curve *c)
{
    const double *value[] = {c->ours, c->minimum_eigenvalue, c->harris};
    const char *label[] = {"Teledimos", "OpenCV goodFeaturesToTrack", "OpenCV cornerHarris"};
    td_series series[3];
    for (int i = 0; i < 3; i++) {
        series[i] = (td_series){
            .label = label[i], .shape = TD_SHAPE_LINE, .count = c->count, .x = c->at, .y = value[i]};
        printf("%-10s %-28s mean %.3f:", c->name, label[i], curve_mean(value[i], c->count));
        for (size_t k = 0; k < c->count; k++) printf(" %.3f", value[i][k]);
        printf("\n");
    }
    td_axes axes = {.title = c->name, .x_label = c->unit, .y_label = "repeatability at 1.5 px", .y_max = 1};
    axes.x_min = c->at[0];
    axes.x_max = c->at[c->count - 1];
    td_report_plot(report, &axes, series, 3);
}

static void viewpoint(td_report *report, const pair_of_views *graf, size_t points)
{
    curve c = {.name = "viewpoint", .unit = "points asked for"};
    td_interest_options options = td_interest_options_default();
    for (size_t n = points / 4; n <= 2 * points; n += points / 4) {
        curve one = {.count = 1};
        options.count = n;
        measure_curve(&one, graf, &options);
        c.at[c.count] = (double)n;
        c.ours[c.count] = one.ours[0];
        c.minimum_eigenvalue[c.count] = one.minimum_eigenvalue[0];
        c.harris[c.count++] = one.harris[0];
    }
    plot(report, &c);
}

static void picture(td_report *report, const td_image *image, const td_interest_options *options,
                    const char *caption)
{
    found_points p;
    double x[MOST_POINTS], y[MOST_POINTS];
    find_ours(&p, image, options);
    for (size_t i = 0; i < p.count; i++) x[i] = p.xy[i][0], y[i] = p.xy[i][1];
    td_series series = {
        .label = "interest points", .shape = TD_SHAPE_CROSS, .count = p.count, .x = x, .y = y};
    td_report_picture(report, image, 640, caption, &series, 1);
}

int main(int argc, char **argv)
{
    pair_of_views graf;
    td_error error;
    td_interest_options options = td_interest_options_default();
    if (argc < 2 || !views_graf(&graf)) {
        printf("usage: print_repeatability REPORT.html [POINTS]   (needs Debian's opencv-doc)\n");
        return 2;
    }
    if (argc > 2) options.count = (size_t)strtoul(argv[2], NULL, 10);
    td_report *report = td_report_new("Repeatability of interest points", "graf1 and graf3 of opencv-doc");
    td_report_text(report,
                   "Share of the points seen by both images that are found in both, within 1.5 px of the "
                   "second; %zu points in each image, noise of %g grey levels in the warped one. OpenCV "
                   "with the best of four settings for each curve, and as many points.",
                   options.count, NOISE_GREY);
    td_report_grid_begin(report, 2);
    viewpoint(report, &graf, options.count);
    curve turned = {.name = "rotation", .unit = "rotation (deg)"};
    curve shrunk = {.name = "scale", .unit = "scale"}, gamma = {.name = "gamma", .unit = "gamma"};
    for (double a = 0; a <= 180; a += 10) turned.at[turned.count++] = a;
    for (double s = 1; s <= 2.01; s += 0.1) shrunk.at[shrunk.count++] = s;
    for (double g = -1; g <= 1.01; g += 0.2) gamma.at[gamma.count++] = exp2(g);
    curve *all[] = {&turned, &shrunk, &gamma};
    for (int kind = 0; kind < 3; kind++) {
        measure_change(all[kind], kind, graf.first, &options);
        plot(report, all[kind]);
    }
    td_report_grid_end(report);
    td_report_grid_begin(report, 2);
    picture(report, graf.first, &options, "graf1, by response");
    options.even = true;
    picture(report, graf.first, &options, "graf1, spread evenly");
    td_report_grid_end(report);
    if (td_report_write(report, argv[1], &error) != TD_OK) {
        printf("%s\n", error.message);
        return 1;
    }
    td_report_free(&report);
    views_free(&graf);
    return 0;
}
