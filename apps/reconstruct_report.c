/* A reconstruction for people: figures, orthophoto and hillshade, height and sigma, the last frame's pair
 * with its disparities, frames. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/reconstruct_internal.h"
#include "core/report.h"

enum { WIDE_PX = 1100, HALF_PX = 700 };

/* The map's cells that are known: first and last column, first and last row. */
typedef struct window {
    int x0, x1, y0, y1;
} window;

static window known_window(const td_elevation *map)
{
    window w = {map->columns, -1, map->rows, -1};
    for (int y = 0; y < map->rows; y++)
        for (int x = 0; x < map->columns; x++) {
            if (!isfinite(map->height[(size_t)y * (size_t)map->columns + (size_t)x])) continue;
            if (x < w.x0) w.x0 = x;
            if (x > w.x1) w.x1 = x;
            if (y < w.y0) w.y0 = y;
            if (y > w.y1) w.y1 = y;
        }
    return w;
}

static double height_at(const td_elevation *map, int x, int y)
{
    return (double)map->height[(size_t)y * (size_t)map->columns + (size_t)x];
}

/* Slope along one axis between the neighbours that are there. */
static double slope(double before, double here, double after, double cell_m)
{
    if (isfinite(before) && isfinite(after)) return (after - before) / (2 * cell_m);
    if (isfinite(after)) return (after - here) / cell_m;
    return isfinite(before) ? (here - before) / cell_m : 0;
}

/* Lambert's light from the north-west, 45 degrees high: 0 … 1. */
static double light_at(const td_elevation *map, int x, int y)
{
    const double z = height_at(map, x, y);
    const double dx = slope(x > 0 ? height_at(map, x - 1, y) : (double)NAN, z,
                            x + 1 < map->columns ? height_at(map, x + 1, y) : (double)NAN, map->cell_m);
    const double dy = slope(y > 0 ? height_at(map, x, y - 1) : (double)NAN, z,
                            y + 1 < map->rows ? height_at(map, x, y + 1) : (double)NAN, map->cell_m);
    const double light = (0.5 * dx - 0.5 * dy + 0.7071) / sqrt(dx * dx + dy * dy + 1);
    return fmin(fmax(light, 0), 1);
}

/* x to the right, y up; unknown cells are white. */
static td_image *hillshade(const td_elevation *map, const window *w)
{
    td_image *image = NULL;
    const int columns = w->x1 - w->x0 + 1;
    if (td_image_new(&image, columns, w->y1 - w->y0 + 1, 1, NULL) != TD_OK) return NULL;
    uint8_t *to = image->data;
    for (int y = w->y1; y >= w->y0; y--)
        for (int x = w->x0; x <= w->x1; x++)
            *to++ = isfinite(height_at(map, x, y)) ? (uint8_t)lround(20 + 225 * light_at(map, x, y)) : 255;
    return image;
}

static int by_value(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* The value that a share of the finite ones lie below; NaN: there is none. */
static double quantile(const float *value, size_t count, double share)
{
    float *sorted = malloc((count + 1) * sizeof *sorted);
    size_t n = 0;
    double out = NAN;
    for (size_t i = 0; sorted && i < count; i++)
        if (isfinite(value[i])) sorted[n++] = value[i];
    if (n) {
        qsort(sorted, n, sizeof *sorted, by_value);
        out = (double)sorted[(size_t)(share * (double)(n - 1))];
    }
    free(sorted);
    return out;
}

/* A map of a thousand cells across is thinned for a plot. `unit` is what one m is in the scale. */
static void field(td_report *r, const td_elevation *map, const window *w, const float *value, double unit,
                  double low, double high, const char *title, const char *label)
{
    const int across = w->x1 - w->x0 + 1, along = w->y1 - w->y0 + 1;
    const int step = 1 + (across > along ? across : along) / 240;
    const int columns = across / step, rows = along / step;
    if (columns < 2 || rows < 2) return;
    double *v = malloc((size_t)columns * (size_t)rows * sizeof *v);
    if (!v) return;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++)
            v[y * columns + x] =
                unit *
                (double)value[(size_t)(w->y0 + y * step) * (size_t)map->columns + (size_t)(w->x0 + x * step)];
    const td_heat heat = {
        .columns = columns, .rows = rows, .value = v, .low = unit * low, .high = unit * high, .label = label};
    const double x0 = map->origin[0] + w->x0 * map->cell_m, y0 = map->origin[1] + w->y0 * map->cell_m;
    const td_axes axes = {.title = title,
                          .x_label = "x (m)",
                          .y_label = "y (m)",
                          .x_min = x0,
                          .x_max = x0 + (columns - 1) * step * map->cell_m,
                          .y_min = y0,
                          .y_max = y0 + (rows - 1) * step * map->cell_m,
                          .equal = 1,
                          .heat = &heat};
    td_report_plot(r, &axes, NULL, 0);
    free(v);
}

/* From dark blue (0, far) over green to yellow (1, near); as light as it is near, for those who see no
 * colours. */
static void tint(uint8_t rgb[3], double part)
{
    static const double stop[5][3] = {
        {48, 18, 90}, {50, 90, 160}, {40, 150, 140}, {120, 205, 90}, {250, 230, 60}};
    const double at = 4 * fmin(fmax(part, 0), 1);
    const int first = at < 3 ? (int)at : 3;
    for (int k = 0; k < 3; k++)
        rgb[k] = (uint8_t)lround(stop[first][k] + (at - first) * (stop[first + 1][k] - stop[first][k]));
}

static void disparity_picture(td_report *r, const td_disparity *d)
{
    td_image *image = NULL;
    const size_t pixels = (size_t)d->width * (size_t)d->height;
    const double low = quantile(d->value, pixels, 0.005), high = quantile(d->value, pixels, 0.995);
    if (!(high > low) || td_image_new(&image, d->width, d->height, 3, NULL) != TD_OK) return;
    for (size_t i = 0; i < pixels; i++)
        if (isfinite(d->value[i])) tint(&image->data[3 * i], ((double)d->value[i] - low) / (high - low));
    char caption[140];
    snprintf(caption, sizeof caption,
             "disparities, %.0f (blue, far) to %.0f px (yellow, near); black: none, or the machine "
             "itself",
             low, high);
    td_report_picture(r, image, HALF_PX, caption, NULL, 0);
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

static void figures(td_report *r, const reconstruct_job *work)
{
    const td_elevation *map = work->map;
    const size_t all = (size_t)map->columns * (size_t)map->rows;
    size_t cells = 0;
    for (size_t i = 0; i < all; i++) cells += isfinite(map->height[i]);
    td_report_figures_begin(r);
    td_report_figure(r, "m² of ground", TD_TONE_PLAIN, "%.3g", (double)cells * map->cell_m * map->cell_m);
    td_report_figure(r, "cells", TD_TONE_PLAIN, "%zu", cells);
    td_report_figure(r, "mm median sigma", TD_TONE_PLAIN, "%.1f", 1e3 * quantile(map->sigma, all, 0.5));
    td_report_figure(r, "mm RMS of the points", TD_TONE_PLAIN, "%.1f", 1e3 * reconstruct_rms(work));
    td_report_figure(r, "px from the epipolar curves", TD_TONE_PLAIN, "%.3f", work->rms_epipolar_px);
    td_report_figures_end(r);
}

static void photo_picture(td_report *r, const td_orthophoto *photo)
{
    td_image *image = NULL;
    char caption[120];
    if (!photo || td_orthophoto_image(&image, photo, 255, NULL) != TD_OK) return;
    snprintf(caption, sizeof caption, "orthophoto: %d x %d texels of %.4g m", photo->columns, photo->rows,
             photo->texel_m);
    td_report_picture(r, image, HALF_PX, caption, NULL, 0);
    td_image_free(&image);
}

static void map_pictures(td_report *r, const reconstruct_job *work)
{
    const td_elevation *map = work->map;
    const size_t all = (size_t)map->columns * (size_t)map->rows;
    const window w = known_window(map);
    char caption[160];
    if (w.x1 < w.x0) return;
    td_image *shade = hillshade(map, &w);
    snprintf(caption, sizeof caption, "hillshade: %d x %d cells of %g m", w.x1 - w.x0 + 1, w.y1 - w.y0 + 1,
             map->cell_m);
    td_report_grid_begin(r, work->photo ? 2 : 1);
    photo_picture(r, work->photo);
    if (shade) td_report_picture(r, shade, work->photo ? HALF_PX : WIDE_PX, caption, NULL, 0);
    td_report_grid_end(r);
    td_image_free(&shade);
    td_report_text(r, "Seen from above, x to the right, y up; white: not seen. Light from the upper left.");
    td_report_grid_begin(r, 2);
    field(r, map, &w, map->height, 1, quantile(map->height, all, 0.002), quantile(map->height, all, 0.998),
          "height", "z (m)");
    /* A few cells at the edges have a large sigma, and would make all others look alike. */
    field(r, map, &w, map->sigma, 1e3, 0, quantile(map->sigma, all, 0.95),
          "standard deviation (brightest: the worst 5 %)", "sigma (mm)");
    td_report_grid_end(r);
    sigma_histogram(r, map);
}

/* Of the frame that is shown, read again: it may have been measured elsewhere. NULL: it cannot be read. */
static td_image *right_image(const reconstruct_job *work)
{
    td_image *raw[2] = {NULL, NULL}, *left = NULL, *right = NULL;
    reconstruct_video video = {0};
    double time_s;
    for (int side = 0; side < 2; side++)
        if (reconstruct_image_read(&raw[side], &time_s, &video, work->shown_frame->image[side], 1, NULL) !=
            TD_OK)
            break;
    if (raw[1])
        td_depth_camera_rectify(&left, &right, work->depth, raw[0], raw[1], work->how->dense.threads, NULL);
    reconstruct_video_free(&video);
    td_image_free(&raw[0]);
    td_image_free(&raw[1]);
    td_image_free(&left);
    return right;
}

static void pair_pictures(td_report *r, const reconstruct_job *work)
{
    char heading[TD_NAME_SIZE + 40];
    if (!work->shown_left) return;
    td_image *right = right_image(work);
    snprintf(heading, sizeof heading, "The pair of frame %s", work->shown_frame->name);
    td_report_heading(r, heading);
    td_report_grid_begin(r, right ? 3 : 2);
    td_report_picture(r, work->shown_left, HALF_PX, "left image, rectified", NULL, 0);
    if (right) td_report_picture(r, right, HALF_PX, "right image, rectified", NULL, 0);
    if (work->shown) disparity_picture(r, work->shown);
    td_report_grid_end(r);
    td_image_free(&right);
}

static void file_table(td_report *r, const reconstruct_job *work)
{
    static const char *const heads[] = {"file", "what it holds", "opens in"};
    const char *const rows[][3] = {
        {"map.tif", "height, sigma, count, provenance and time of each cell (cloud-optimised GeoTIFF)",
         "QGIS, GDAL"},
        {work->photo ? "orthophoto.tif" : NULL, "colours from above (cloud-optimised GeoTIFF, RGBA)",
         "QGIS, GDAL"},
        {"map.ply", "the cells as points: x, y, z, colour, sigma", "CloudCompare, MeshLab"},
        {"map.las", "the same (LAS 1.4, sigma as an extra dimension)", "PDAL, LAStools, QGIS"},
        {work->has_mesh ? "map.glb" : NULL, "the surface with its colours (glTF 2.0)", "Blender, three.js"},
        {"result.yaml", "the figures of this page", "any text editor"},
    };
    td_report_table_begin(r, heads, 3);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        if (!rows[i][0]) continue;
        for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%s", rows[i][k]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

td_status reconstruct_report(const void *found, const char *path, td_error *error)
{
    const reconstruct_job *work = found;
    char subtitle[TD_NAME_SIZE + 80];
    size_t used = 0;
    for (size_t i = 0; i < work->count; i++) used += !work->frame[i].failed;
    snprintf(subtitle, sizeof subtitle, "%s: %zu of %zu frames, frame %s", work->dataset->name, used,
             work->count, work->map->frame);
    td_report *r = td_report_new("Elevation map", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &work->gate);
    figures(r, work);
    td_report_heading(r, "The map");
    map_pictures(r, work);
    pair_pictures(r, work);
    td_report_heading(r, "Frames");
    frame_table(r, work);
    td_report_heading(r, "Files");
    file_table(r, work);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
