/* What teledimos measure found, for people: figures, the difference or slope seen from above, histogram,
 * profile. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/measure_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

enum { HEAT_SIDE = 400, BINS = 60 };

/* The map thinned to at most HEAT_SIDE cells a side, means of blocks. NULL: no memory. */
static double *thinned(int *columns, int *rows, int *block, const td_elevation *map, double scale)
{
    const int longer = map->columns > map->rows ? map->columns : map->rows;
    *block = (longer + HEAT_SIDE - 1) / HEAT_SIDE;
    *columns = (map->columns + *block - 1) / *block;
    *rows = (map->rows + *block - 1) / *block;
    double *value = malloc((size_t)*columns * (size_t)*rows * sizeof *value);
    for (int r = 0; value && r < *rows; r++)
        for (int c = 0; c < *columns; c++) {
            double sum = 0;
            int n = 0;
            for (int y = r * *block; y < (r + 1) * *block && y < map->rows; y++)
                for (int x = c * *block; x < (c + 1) * *block && x < map->columns; x++) {
                    const double v = map->height[(size_t)y * (size_t)map->columns + (size_t)x];
                    if (!isfinite(v)) continue;
                    sum += v;
                    n++;
                }
            value[(size_t)r * (size_t)*columns + (size_t)c] = n ? scale * sum / n : NAN;
        }
    return value;
}

static double largest(const td_elevation *map, double scale)
{
    double most = 0;
    for (size_t i = 0, n = (size_t)map->columns * (size_t)map->rows; i < n; i++)
        if (isfinite(map->height[i])) most = fmax(most, scale * fabs(map->height[i]));
    return most > 0 ? most : 1;
}

/* From above, with the polygon; colours from `low` to `high`. */
static void field(td_report *r, const measure_job *m, double scale, double low, double high,
                  const char *title, const char *label)
{
    const td_elevation *map = m->product;
    int columns, rows, block;
    double *value = thinned(&columns, &rows, &block, map, scale);
    double *x = malloc((2 * m->polygon_count + 2) * sizeof *x), *y = x ? x + m->polygon_count + 1 : NULL;
    if (value && x && columns > 1 && rows > 1) {
        for (size_t i = 0; m->polygon_count && i <= m->polygon_count; i++) {
            x[i] = m->polygon[i % m->polygon_count][0];
            y[i] = m->polygon[i % m->polygon_count][1];
        }
        const double first = 0.5 * (block - 1) * map->cell_m, step = block * map->cell_m;
        const td_heat heat = {
            .columns = columns, .rows = rows, .value = value, .low = low, .high = high, .label = label};
        const td_axes axes = {.title = title,
                              .x_label = "x (m)",
                              .y_label = "y (m)",
                              .x_min = map->origin[0] + first,
                              .x_max = map->origin[0] + first + (columns - 1) * step,
                              .y_min = map->origin[1] + first,
                              .y_max = map->origin[1] + first + (rows - 1) * step,
                              .equal = 1,
                              .heat = &heat};
        const td_series outline = {.label = "polygon",
                                   .shape = TD_SHAPE_LINE,
                                   .tone = TD_TONE_WARN,
                                   .count = m->polygon_count + 1,
                                   .x = x,
                                   .y = y};
        td_report_plot(r, &axes, m->polygon_count ? &outline : NULL, m->polygon_count ? 1 : 0);
    }
    free(value);
    free(x);
}

/* Share of the cells per bin, as a logarithm: what changed is a small part of most maps. */
static void histogram(td_report *r, const td_elevation *map, double scale, double low, double high,
                      const char *title, const char *label)
{
    double x[BINS], y[BINS], count[BINS] = {0};
    for (size_t i = 0, n = (size_t)map->columns * (size_t)map->rows; i < n; i++) {
        const double v = (scale * map->height[i] - low) / (high - low);
        if (!isfinite(v)) continue;
        const int k = (int)(v * BINS);
        count[k < 0 ? 0 : k >= BINS ? BINS - 1 : k]++;
    }
    for (int k = 0; k < BINS; k++) {
        x[k] = low + (k + 0.5) * (high - low) / BINS;
        y[k] = log10(1 + count[k]);
    }
    const td_series bars = {.shape = TD_SHAPE_BAR, .count = BINS, .x = x, .y = y};
    const td_axes axes = {.title = title, .x_label = label, .y_label = "log10 (1 + cells)"};
    td_report_plot(r, &axes, &bars, 1);
}

static void volume_part(td_report *r, const measure_job *m)
{
    const td_volume *v = &m->volume;
    td_report_figures_begin(r);
    td_report_figure(r, "cut", TD_TONE_PLAIN, "%.3f ± %.3f m³", v->cut_m3, v->sigma_cut_m3);
    td_report_figure(r, "fill", TD_TONE_PLAIN, "%.3f ± %.3f m³", v->fill_m3, v->sigma_fill_m3);
    td_report_figure(r, "net", TD_TONE_PLAIN, "%.3f ± %.3f m³", v->net_m3, v->sigma_net_m3);
    td_report_figure(r, "compared", TD_TONE_PLAIN, "%.1f m²", v->area_m2);
    td_report_figure(r, "changed", TD_TONE_PLAIN, "%.1f m²", v->changed_m2);
    td_report_figures_end(r);
    td_report_text(
        r,
        "Standard deviations follow ±. A cell's difference is sure to %.1f mm; this noise is shared "
        "over %.3f m (correlation 1/e). Map shift taken off: %+.1f mm, sigma %.1f mm. Outside of the "
        "places that changed: %+.4f ± %.4f m³. %zu cells are not known in both maps.",
        1e3 * v->noise_m, v->correlation_m, 1e3 * v->shift_m, 1e3 * v->sigma_shift_m, v->rest_m3,
        v->sigma_rest_m3, v->missing);
    const double most = largest(m->product, 1);
    td_report_grid_begin(r, 2);
    field(r, m, 1, -most, most, "after - before", "difference (m)");
    histogram(r, m->product, 1, -most, most, "cells by their difference", "difference (m)");
    td_report_grid_end(r);
}

static void slope_part(td_report *r, const measure_job *m)
{
    td_report_figures_begin(r);
    td_report_figure(r, "median", TD_TONE_PLAIN, "%.1f°", DEGREES * m->slope_rad[0]);
    td_report_figure(r, "a twentieth is above", TD_TONE_PLAIN, "%.1f°", DEGREES * m->slope_rad[1]);
    td_report_figure(r, "steepest", TD_TONE_PLAIN, "%.1f°", DEGREES * m->slope_rad[2]);
    td_report_figures_end(r);
    const double most = largest(m->product, DEGREES);
    td_report_grid_begin(r, 2);
    field(r, m, DEGREES, 0, most, "slope", "slope (degrees)");
    histogram(r, m->product, DEGREES, 0, most, "cells by their slope", "slope (degrees)");
    td_report_grid_end(r);
}

static void profile_part(td_report *r, const measure_job *m)
{
    const size_t n = m->count;
    double *x = malloc(4 * n * sizeof *x);
    if (!x) return;
    for (size_t i = 0; i < n; i++) {
        const td_profile_point *p = &m->profile[i];
        x[i] = p->distance_m;
        x[n + i] = p->height_m;
        x[2 * n + i] = p->height_m - p->sigma_m;
        x[3 * n + i] = p->height_m + p->sigma_m;
    }
    td_series series[3] = {
        {.label = "height", .shape = TD_SHAPE_LINE, .tone = TD_TONE_GOOD, .count = n, .x = x, .y = x + n},
        {.label = "± sigma",
         .shape = TD_SHAPE_LINE,
         .tone = TD_TONE_WARN,
         .count = n,
         .x = x,
         .y = x + 2 * n},
        {.shape = TD_SHAPE_LINE, .tone = TD_TONE_WARN, .count = n, .x = x, .y = x + 3 * n}};
    const td_axes axes = {
        .title = "height along the line", .x_label = "distance (m)", .y_label = "height (m)"};
    td_report_text(r, "From (%g, %g) to (%g, %g), %zu points, %zu of them known.", m->from[0], m->from[1],
                   m->to[0], m->to[1], n, m->known);
    td_report_plot(r, &axes, series, m->has_sigma ? 3 : 1);
    free(x);
}

td_status measure_report(const void *found, const char *path, td_error *error)
{
    static const char *const titles[] = {"Cut and fill", "Profile", "Slope"};
    const measure_job *m = found;
    char subtitle[700];
    snprintf(subtitle, sizeof subtitle, "%s%s%s, frame %s", m->path[0], m->path[1] ? " to " : "",
             m->path[1] ? m->path[1] : "", m->map[0]->frame);
    td_report *r = td_report_new(titles[m->kind], subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &m->gate);
    if (m->kind == MEASURE_VOLUME) volume_part(r, m);
    if (m->kind == MEASURE_PROFILE) profile_part(r, m);
    if (m->kind == MEASURE_SLOPE) slope_part(r, m);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
