/* A reconstruction for people: hillshade, sigma, the last frame's image and disparities, frames. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "core/report.h"

/* The map lit from the north-west, 45 degrees high, seen from above; x to the right, y up. Unknown cells are
 * white. */
static td_image *hillshade(const td_elevation *map)
{
    td_image *image = NULL;
    if (td_image_new(&image, map->columns, map->rows, 1, NULL) != TD_OK) return NULL;
    size_t w = (size_t)map->columns;
    for (int r = 0; r < map->rows; r++)
        for (int c = 0; c < map->columns; c++) {
            size_t i = (size_t)r * w + (size_t)c;
            uint8_t *out = &image->data[(size_t)(map->rows - 1 - r) * w + (size_t)c];
            int c0 = c > 0 ? c - 1 : c, c1 = c + 1 < map->columns ? c + 1 : c;
            int r0 = r > 0 ? r - 1 : r, r1 = r + 1 < map->rows ? r + 1 : r;
            double dx = (map->height[(size_t)r * w + (size_t)c1] - map->height[(size_t)r * w + (size_t)c0]) /
                        ((c1 - c0) * map->cell_m);
            double dy = (map->height[(size_t)r1 * w + (size_t)c] - map->height[(size_t)r0 * w + (size_t)c]) /
                        ((r1 - r0) * map->cell_m);
            if (!isfinite(map->height[i])) {
                *out = 255;
                continue;
            }
            if (!isfinite(dx)) dx = 0;
            if (!isfinite(dy)) dy = 0;
            double light = (0.5 * dx - 0.5 * dy + 0.7071) / sqrt(dx * dx + dy * dy + 1);
            *out = (uint8_t)lround(20 + 225 * fmin(fmax(light, 0), 1));
        }
    return image;
}

/* A map of a thousand cells across is thinned for a plot. */
static void field(td_report *r, const td_elevation *map, const float *value, double high, const char *title,
                  const char *label)
{
    int step = 1 + (map->columns > map->rows ? map->columns : map->rows) / 240;
    int columns = map->columns / step, rows = map->rows / step;
    if (columns < 2 || rows < 2) return;
    double *v = malloc((size_t)columns * (size_t)rows * sizeof *v);
    if (!v) return;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++)
            v[y * columns + x] = value[(size_t)(y * step) * (size_t)map->columns + (size_t)(x * step)];
    const td_heat heat = {
        .columns = columns, .rows = rows, .value = v, .low = 0, .high = high, .label = label};
    const td_axes axes = {.title = title,
                          .x_label = "x (m)",
                          .y_label = "y (m)",
                          .x_min = map->origin[0],
                          .x_max = map->origin[0] + (columns - 1) * step * map->cell_m,
                          .y_min = map->origin[1],
                          .y_max = map->origin[1] + (rows - 1) * step * map->cell_m,
                          .equal = 1,
                          .heat = &heat};
    td_report_plot(r, &axes, NULL, 0);
    free(v);
}

static void disparity_picture(td_report *r, const td_disparity *d)
{
    td_image *image = NULL;
    float low = INFINITY, high = -INFINITY;
    size_t pixels = (size_t)d->width * (size_t)d->height;
    for (size_t i = 0; i < pixels; i++)
        if (isfinite(d->value[i])) {
            low = fminf(low, d->value[i]);
            high = fmaxf(high, d->value[i]);
        }
    if (!(high > low) || td_image_new(&image, d->width, d->height, 1, NULL) != TD_OK) return;
    for (size_t i = 0; i < pixels; i++)
        image->data[i] =
            isfinite(d->value[i]) ? (uint8_t)lroundf(30 + 225 * (d->value[i] - low) / (high - low)) : 0;
    char caption[120];
    snprintf(caption, sizeof caption,
             "disparities, %.0f (dark) to %.0f px; black: none, or the machine itself", low, high);
    td_report_picture(r, image, 640, caption, NULL, 0);
    td_image_free(&image);
}

static void sigma_histogram(td_report *r, const td_elevation *map)
{
    enum { BINS = 40 };
    double x[BINS], y[BINS] = {0}, most = 0;
    size_t all = (size_t)map->columns * (size_t)map->rows;
    double mean = 0, n = 0;
    for (size_t i = 0; i < all; i++)
        if (isfinite(map->sigma[i])) mean += map->sigma[i], n++;
    if (n == 0) return;
    most = 4 * mean / n;
    for (int k = 0; k < BINS; k++) x[k] = 1e3 * most * (k + 0.5) / BINS;
    for (size_t i = 0; i < all; i++)
        if (isfinite(map->sigma[i])) y[(int)fmin(BINS - 1, map->sigma[i] / most * BINS)]++;
    const td_series series = {.shape = TD_SHAPE_BAR, .count = BINS, .x = x, .y = y};
    const td_axes axes = {.title = "standard deviations of the cells (the last bar: all above)",
                          .x_label = "sigma (mm)",
                          .y_label = "cells"};
    td_report_plot(r, &axes, &series, 1);
}

static void frame_table(td_report *r, const reconstruct_job *work)
{
    static const char *const heads[] = {"frame", "matched (%)", "the machine (%)", "epipolar (px)", "cells",
                                        "new",   "gated",       "reset",           "cleared",       "remark"};
    td_report_table_begin(r, heads, 10);
    for (size_t i = 0; i < work->count; i++) {
        const reconstruct_frame *f = &work->frame[i];
        td_tone tone = f->failed ? TD_TONE_BAD : TD_TONE_PLAIN;
        td_report_cell(r, tone, "%s", f->name);
        td_report_cell(r, TD_TONE_PLAIN, "%.1f", 100 * f->matched);
        td_report_cell(r, TD_TONE_PLAIN, "%.1f", 100 * f->masked);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", f->epipolar_px);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", f->tally.cells);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", f->tally.new_cells);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", f->tally.gated);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", f->tally.reset);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", f->tally.cleared);
        td_report_cell(r, tone, "%s", f->reason);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void pictures(td_report *r, const reconstruct_job *work)
{
    td_image *shade = hillshade(work->map);
    char caption[160];
    snprintf(caption, sizeof caption,
             "hillshade: %d x %d cells of %g m, x to the right, y up; white: not seen", work->map->columns,
             work->map->rows, work->map->cell_m);
    if (shade) td_report_picture(r, shade, 900, caption, NULL, 0);
    td_image_free(&shade);
    td_report_grid_begin(r, 2);
    field(r, work->map, work->map->height, 0, "height", "z (m)");
    field(r, work->map, work->map->sigma, 0, "standard deviation of the height", "sigma (m)");
    if (work->shown_left)
        td_report_picture(r, work->shown_left, 640, "left image of the last frame, rectified", NULL, 0);
    if (work->shown) disparity_picture(r, work->shown);
    td_report_grid_end(r);
    sigma_histogram(r, work->map);
}

td_status reconstruct_report(const void *found, const char *path, td_error *error)
{
    static const td_tone tones[] = {TD_TONE_GOOD, TD_TONE_WARN, TD_TONE_BAD};
    const reconstruct_job *work = found;
    const char *sentences[GATE_MAX_REASONS];
    char subtitle[TD_NAME_SIZE + 80];
    size_t used = 0;
    for (size_t i = 0; i < work->count; i++) used += !work->frame[i].failed;
    snprintf(subtitle, sizeof subtitle, "%s: %zu of %zu frames, frame %s", work->dataset->name, used,
             work->count, work->map->frame);
    td_report *r = td_report_new("Elevation map", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    for (size_t i = 0; i < work->gate.count; i++) sentences[i] = work->gate.reason[i];
    td_report_verdict(r, tones[work->gate.verdict], verdict_name(work->gate.verdict), sentences,
                      work->gate.count);
    pictures(r, work);
    td_report_heading(r, "Frames");
    frame_table(r, work);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
