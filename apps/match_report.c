/* What teledimos match found, for people: both images with the matches, the points and the map. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/match_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

/* Above CROWD, points are drawn small, and not over the map. */
enum { CURVE_POINTS = 64, SHOWN_POINTS = 60, TABLE_ROWS = 40, CROWD = 150 };

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Of all that has a sigma: median and largest, mm. False: none has. */
static bool sigmas(double *middle, double *largest, const match_job *m)
{
    size_t n = 0;
    double *s = malloc((m->count + 1) * sizeof *s);
    if (!s) return false;
    for (size_t i = 0; i < m->count; i++) {
        double sigma = match_sigma(m->calibration_known ? m->space[i].covariance : m->space[i].matching);
        if (isfinite(sigma)) s[n++] = 1e3 * sigma;
    }
    qsort(s, n, sizeof *s, by_value);
    if (n) *middle = s[n / 2], *largest = s[n - 1];
    free(s);
    return n > 0;
}

static void figures(td_report *r, const match_job *m)
{
    double middle, largest;
    td_report_figures_begin(r);
    td_report_figure(r, "points in space", m->count ? TD_TONE_GOOD : TD_TONE_BAD, "%zu", m->count);
    if (m->has_gate)
        td_report_figure(r, "off the epipolar curves", TD_TONE_PLAIN, "%.3f px",
                         m->corrected ? m->epipolar.corrected_px : m->epipolar.rms_px);
    if (sigmas(&middle, &largest, m)) {
        const char *of = m->calibration_known ? "" : ", matching alone";
        char label[2][40];
        snprintf(label[0], sizeof label[0], "median sigma%s", of);
        snprintf(label[1], sizeof label[1], "largest sigma%s", of);
        td_report_figure(r, label[0], TD_TONE_PLAIN, "%.1f mm", middle);
        td_report_figure(r, label[1], TD_TONE_PLAIN, "%.1f mm", largest);
    }
    td_report_figures_end(r);
}

static void epipolar_text(td_report *r, const match_job *m)
{
    const td_epipolar_gate *e = &m->epipolar;
    if (!m->has_gate) return;
    td_report_heading(r, "Do the images belong to the rig?");
    td_report_text(
        r,
        "%zu automatic matches lie %.3f px (robust RMS) from the epipolar curves that the rig says, their "
        "median %+.3f px; %zu of them are inliers.",
        e->matches, e->rms_px, e->median_px, e->inliers);
    if (!e->determined) {
        td_report_text(r, "They are too few, or spread too little, to tell how the right camera has turned.");
        return;
    }
    td_report_text(r,
                   "The turn of the right camera that fits them best is (%.4f ± %.4f, %.4f ± %.4f, %.4f ± "
                   "%.4f) degrees; with it they lie at %.3f px.%s",
                   DEGREES * e->rotation[0], DEGREES * sqrt(e->covariance[0]), DEGREES * e->rotation[1],
                   DEGREES * sqrt(e->covariance[4]), DEGREES * e->rotation[2],
                   DEGREES * sqrt(e->covariance[8]), e->corrected_px,
                   m->corrected ? " The points below are with the turned camera."
                   : m->offer   ? " The rig with this turn is rig-corrected.yaml."
                                : " The rig is used as it is.");
}

/* What became of the interest points. */
static void tally_text(td_report *r, const match_job *m)
{
    const td_match_tally *t = &m->tally;
    if (m->mode != MATCH_AUTOMATIC) return;
    td_report_text(r,
                   "Of %zu interest points of the left image %zu were not seen on the right, %zu looked like "
                   "two places, %zu did not lead back, %zu could not be refined and %zu were left out as "
                   "unsure.",
                   t->left_points, t->unseen, t->ambiguous, t->one_sided, t->unrefined, t->unsure);
}

/* The epipolar curve of a left point in the right image. */
static size_t curve_of(double *x, double *y, const match_job *m, const double left[2])
{
    size_t n = 0;
    double near = m->options.near_m, far = m->options.far_m;
    for (int i = 0; i < CURVE_POINTS; i++) {
        double share = i / (CURVE_POINTS - 1.0), inverse = (1 - share) / near + share / far, right[2];
        double depth = inverse > 0 ? 1 / inverse : INFINITY;
        if (!td_pair_transfer(right, NULL, NULL, &m->pair, left, depth)) continue;
        if (right[0] < 0 || right[1] < 0 || right[0] > m->image[1]->width - 1 ||
            right[1] > m->image[1]->height - 1)
            continue;
        x[n] = right[0];
        y[n++] = right[1];
    }
    return n;
}

static void pictures(td_report *r, const match_job *m)
{
    size_t n = m->count;
    double *x = malloc((4 * n + 1) * sizeof *x);
    if (!x) return;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 2; k++) {
            x[k * n + i] = m->match[i].left[k];
            x[(2 + k) * n + i] = m->match[i].right[k];
        }
    td_report_grid_begin(r, 2);
    for (size_t side = 0; side < 2; side++) {
        double curves[2 * CURVE_POINTS * SHOWN_POINTS];
        td_series series[SHOWN_POINTS + 1];
        size_t count = 0, at = 0;
        bool drawn = side == 1 && m->mode != MATCH_AUTOMATIC;
        for (size_t i = 0; drawn && i < m->point_count && i < SHOWN_POINTS; i++) {
            double *cx = curves + at, *cy = cx + CURVE_POINTS;
            size_t length = curve_of(cx, cy, m, m->point[i].left);
            at += 2 * CURVE_POINTS;
            series[count++] = (td_series){.label = i ? NULL : "epipolar curves",
                                          .shape = TD_SHAPE_LINE,
                                          .tone = TD_TONE_WARN,
                                          .count = length,
                                          .x = cx,
                                          .y = cy};
        }
        series[count++] = (td_series){.label = "matches",
                                      .shape = n > CROWD ? TD_SHAPE_POINT : TD_SHAPE_CROSS,
                                      .tone = TD_TONE_GOOD,
                                      .count = n,
                                      .x = x + 2 * side * n,
                                      .y = x + (2 * side + 1) * n};
        td_report_picture(r, m->image[side], 640, side ? "right" : "left", series, count);
    }
    td_report_grid_end(r);
    free(x);
}

/* The map seen from above: a field of the cells as columns to the front and rows to the left. */
static void field(td_report *r, const match_job *m, const float *value, double scale, const char *title,
                  const char *label)
{
    const td_elevation *map = m->map;
    size_t cells = (size_t)map->columns * (size_t)map->rows;
    double *v = malloc((cells + 1) * sizeof *v), *x = malloc((2 * m->count + 1) * sizeof *x);
    if (v && x && map->columns > 1 && map->rows > 1) {
        for (size_t i = 0; i < cells; i++) v[i] = scale * value[i];
        for (size_t i = 0; i < m->count; i++) {
            x[i] = m->space[i].p[0];
            x[m->count + i] = m->space[i].p[1];
        }
        const td_heat heat = {
            .columns = map->columns, .rows = map->rows, .value = v, .low = 0, .high = 0, .label = label};
        const td_axes axes = {.title = title,
                              .x_label = "x (m)",
                              .y_label = "y (m)",
                              .x_min = map->origin[0],
                              .x_max = map->origin[0] + (map->columns - 1) * map->cell_m,
                              .y_min = map->origin[1],
                              .y_max = map->origin[1] + (map->rows - 1) * map->cell_m,
                              .equal = 1,
                              .heat = &heat};
        const td_series series = {
            .label = "points", .shape = TD_SHAPE_POINT, .count = m->count, .x = x, .y = x + m->count};
        td_report_plot(r, &axes, &series, m->count <= CROWD);
    }
    free(v);
    free(x);
}

static void map(td_report *r, const match_job *m)
{
    if (!m->map) return;
    td_report_heading(r, "Coarse elevation map");
    td_report_text(r,
                   "From above, frame %s: x forward, y left. %zu triangles over the points, flat in between: "
                   "sigma is that of the triangles' corners, and knows nothing of what stands between them.",
                   m->frame, m->triangle_count);
    td_report_grid_begin(r, 2);
    field(r, m, m->map->height, 1, "height", "z (m)");
    field(r, m, m->map->sigma, 1e3, "standard deviation of the height", "sigma (mm)");
    td_report_grid_end(r);
}

static void point_table(td_report *r, const match_job *m)
{
    static const char *const heads[] = {"point",         "left (px)",       "right (px)", "ZNCC",
                                        "x (m)",         "y (m)",           "z (m)",      "sigma (mm)",
                                        "matching (mm)", "calibration (mm)"};
    static const char *const alone[] = {"point", "left (px)", "right (px)", "ZNCC",
                                        "x (m)", "y (m)",     "z (m)",      "sigma of matching (mm)"};
    size_t shown = m->count < TABLE_ROWS ? m->count : TABLE_ROWS;
    if (!m->count) return;
    td_report_heading(r, "Points");
    td_report_table_begin(r, m->calibration_known ? heads : alone, m->calibration_known ? 10 : 8);
    for (size_t i = 0; i < shown; i++) {
        const td_match *a = &m->match[i];
        const td_point3 *p = &m->space[i];
        td_report_cell(r, TD_TONE_PLAIN, "%s", m->point[m->index[i]].name);
        td_report_cell(r, TD_TONE_PLAIN, "%.2f, %.2f", a->left[0], a->left[1]);
        td_report_cell(r, TD_TONE_PLAIN, "%.2f, %.2f", a->right[0], a->right[1]);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", a->zncc);
        for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.4f", p->p[k]);
        if (m->calibration_known) td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * match_sigma(p->covariance));
        td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * match_sigma(p->matching));
        if (m->calibration_known) td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * match_sigma(p->calibration));
        td_report_row_end(r);
    }
    td_report_table_end(r);
    if (shown < m->count)
        td_report_text(r, "The first %zu of %zu points; all are in matches.csv.", shown, m->count);
}

td_status match_report(const void *found, const char *path, td_error *error)
{
    static const char *const modes[] = {"automatic", "guided", "chosen"};
    const match_job *m = found;
    char subtitle[700];
    snprintf(subtitle, sizeof subtitle, "%s and %s, %s, frame %s", m->image_path[0], m->image_path[1],
             modes[m->mode], m->frame);
    td_report *r = td_report_new("Matched points", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &m->gate);
    figures(r, m);
    pictures(r, m);
    tally_text(r, m);
    epipolar_text(r, m);
    map(r, m);
    point_table(r, m);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
