/* A calibration for people: the table on the terminal and the report. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/calibrate_internal.h"
#include "core/report.h"

#define DEGREES 57.29577951308232

/* What the board does wrong, as the end of a sentence. */
static const char *board_text(char *text, size_t size, const td_board_error *b)
{
    snprintf(
        text, size,
        "points are off by %.3f mm RMS; from view to view the sheet bends by %.3f mm, stretches by %.3f mm "
        "and ripples by %.3f mm RMS: every sigma takes it into account",
        1e3 * b->print_m, 1e3 * b->bend_m, 1e3 * b->stretch_m, 1e3 * b->ripple_m);
    return text;
}

void calibrate_table(const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    printf("\n%-10s %7s %8s %19s %19s %19s\n", "camera", "views", "RMS px", "fx px", "cx px", "cy px");
    for (int i = 0; i < c->rig->count; i++) {
        const td_calibrated_camera *k = &c->camera[i];
        const double *p = c->rig->camera[i].camera.parameter;
        printf("%-10s %7zu %8.4f %10.3f ± %-6.3f %10.3f ± %-6.3f %10.3f ± %-6.3f\n", c->rig->camera[i].name,
               k->views, k->rms_px, p[0], k->sigma[0], p[2], k->sigma[2], p[3], k->sigma[3]);
    }
    for (size_t i = 0; i < c->pair_count; i++) {
        const td_calibrated_pair *p = &c->pair[i];
        printf("\n%s–%s: RMS %.4f px over %zu pairs, baseline %.3f ± %.3f mm, rotation %.3f°, epipolar error "
               "%.3f px\n",
               c->rig->camera[p->first].name, c->rig->camera[p->second].name, p->rms_px, p->pairs,
               1e3 * p->baseline_m, 1e3 * p->sigma_baseline_m, p->rotation_rad * DEGREES,
               p->epipolar_error_px);
    }
    const td_leave_one_out *l = &c->leave_one_out;
    if (l->views) {
        printf("left out in turn: RMS %.4f px", l->rms_px);
        if (isfinite(l->scale_error))
            printf(", scale error %+.3f %% (RMS %.3f %%), flatness %.3f mm", 100 * l->scale_error,
                   100 * l->scale_error_rms, 1e3 * l->flatness_m);
        putchar('\n');
    }
    const calibrate_trust *t = job->trust;
    if (isfinite(t->projected_px))
        printf(
            "a point %.2f m away is projected with a standard deviation of %.3f px (median over the image)\n",
            t->middle_distance_m, t->projected_px);
    if (c->has_warp)
        printf("board: bulges by %+.3f ± %.3f mm along its rows, %+.3f ± %.3f mm along its columns\n",
               1e3 * c->warp_m[0], 1e3 * c->sigma_warp_m[0], 1e3 * c->warp_m[1], 1e3 * c->sigma_warp_m[1]);
    char board[TD_TEXT_SIZE];
    if (c->board.significant) printf("board: %s\n", board_text(board, sizeof board, &c->board));
    printf("\nverdict: %s\n", verdict_name(job->gate->verdict));
    for (size_t i = 0; i < job->gate->count; i++) printf("  - %s\n", job->gate->reason[i]);
}

/* A row for each parameter, two columns for each camera. Cameras may be of different models: names join rows.
 */
static void camera_table(td_report *r, const td_calibration *c)
{
    const char *heads[1 + 2 * TD_RIG_MAX_CAMERAS], *rows[64];
    char text[2 * TD_RIG_MAX_CAMERAS][TD_NAME_SIZE + 16];
    size_t n = 0, row_count = 0;
    heads[n++] = "parameter";
    for (int i = 0; i < c->rig->count; i++) {
        snprintf(text[2 * i], sizeof *text, "%s", c->rig->camera[i].name);
        snprintf(text[2 * i + 1], sizeof *text, "σ");
        heads[n++] = text[2 * i];
        heads[n++] = text[2 * i + 1];
        td_camera_model model = c->rig->camera[i].camera.model;
        for (int k = 0; k < td_camera_parameter_count(model); k++) {
            size_t row = 0;
            while (row < row_count && strcmp(rows[row], td_camera_parameter_name(model, k)) != 0) row++;
            if (row == row_count) rows[row_count++] = td_camera_parameter_name(model, k);
        }
    }
    td_report_table_begin(r, heads, n);
    for (size_t row = 0; row < row_count; row++) {
        bool pixels = rows[row][0] == 'f' || rows[row][0] == 'c';
        td_report_cell(r, TD_TONE_PLAIN, "%s%s", rows[row], pixels ? " (px)" : "");
        for (int i = 0; i < c->rig->count; i++) {
            const td_camera *camera = &c->rig->camera[i].camera;
            int k = td_camera_parameter_count(camera->model) - 1;
            while (k >= 0 && strcmp(rows[row], td_camera_parameter_name(camera->model, k)) != 0) k--;
            td_report_cell(r, TD_TONE_PLAIN,
                           k < 0    ? "–"
                           : pixels ? "%.3f"
                                    : "%.6f",
                           k < 0 ? 0 : camera->parameter[k]);
            td_report_cell(r, TD_TONE_PLAIN,
                           k < 0    ? "–"
                           : pixels ? "%.3f"
                                    : "%.6f",
                           k < 0 ? 0 : c->camera[i].sigma[k]);
        }
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void pair_text(td_report *r, const td_calibration *c)
{
    for (size_t i = 0; i < c->pair_count; i++) {
        const td_calibrated_pair *p = &c->pair[i];
        const double *t = p->second_from_first.t;
        td_report_text(
            r,
            "%s from %s: translation (%.3f, %.3f, %.3f) mm, baseline %.3f ± %.3f mm; rotation %.4f° with "
            "σ (%.4f, %.4f, %.4f)° about the camera's x, y, z. Mean distance to both epipolar lines, added: "
            "%.3f px.",
            c->rig->camera[p->second].name, c->rig->camera[p->first].name, 1e3 * t[0], 1e3 * t[1], 1e3 * t[2],
            1e3 * p->baseline_m, 1e3 * p->sigma_baseline_m, p->rotation_rad * DEGREES,
            p->sigma_rotation_rad[0] * DEGREES, p->sigma_rotation_rad[1] * DEGREES,
            p->sigma_rotation_rad[2] * DEGREES, p->epipolar_error_px);
    }
}

static void view_table(td_report *r, const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    const td_observations *o = job->observations;
    const char *heads[3 + 2 * TD_RIG_MAX_CAMERAS];
    char text[2 * TD_RIG_MAX_CAMERAS][TD_NAME_SIZE + 16];
    size_t n = 0;
    heads[n++] = "view";
    for (int k = 0; k < o->camera_count; k++) {
        snprintf(text[2 * k], sizeof *text, "%s: RMS (px)", o->camera[k].name);
        snprintf(text[2 * k + 1], sizeof *text, "%s: points", o->camera[k].name);
        heads[n++] = text[2 * k];
        heads[n++] = text[2 * k + 1];
    }
    heads[n++] = "distance (m)";
    heads[n++] = "remark";
    td_report_table_begin(r, heads, n);
    for (size_t v = 0; v < c->view_count; v++) {
        const td_calibrated_view *view = &c->view[v];
        td_tone tone = view->state == TD_VIEW_OUTLIER ? TD_TONE_BAD
                       : view->state == TD_VIEW_USED  ? TD_TONE_PLAIN
                                                      : TD_TONE_WARN;
        const char *reason = view->remark;
        td_report_cell(r, tone, "%s", o->view_name[v]);
        for (int k = 0; k < o->camera_count; k++) {
            const td_detection *d = td_observations_get(o, v, k);
            if (!*reason && !d->found) reason = d->reason;
            if (view->points[k]) {
                td_report_cell(r, TD_TONE_PLAIN, "%.3f", view->rms_px[k]);
                td_report_cell(r, view->outliers[k] ? TD_TONE_WARN : TD_TONE_PLAIN,
                               view->outliers[k] ? "%zu, %zu out" : "%zu", view->points[k],
                               view->outliers[k]);
            } else {
                td_report_cell(r, TD_TONE_PLAIN, "–");
                td_report_cell(r, TD_TONE_PLAIN, "–");
            }
        }
        if (view->state == TD_VIEW_UNSEEN)
            td_report_cell(r, TD_TONE_PLAIN, "–");
        else
            td_report_cell(r, TD_TONE_PLAIN, "%.3f", td_pose_distance(&view->rig_from_target));
        td_report_cell(r, TD_TONE_PLAIN, "%s", reason);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* Positions and residuals of one camera's points, used and left out. */
typedef struct gathered {
    size_t count[2];
    double *x[2], *y[2], *dx[2], *dy[2];
} gathered;

static bool gather(gathered *g, const calibrate_job *job, int camera, size_t first_view, size_t end_view)
{
    const td_observations *o = job->observations;
    size_t points = td_target_point_count(&o->target), most = (end_view - first_view) * points + 1;
    double *store = malloc(8 * most * sizeof *store);
    *g = (gathered){0};
    if (!store) return false;
    for (size_t k = 0; k < 2; k++) {
        g->x[k] = store + (4 * k) * most;
        g->y[k] = store + (4 * k + 1) * most;
        g->dx[k] = store + (4 * k + 2) * most;
        g->dy[k] = store + (4 * k + 3) * most;
    }
    for (size_t v = first_view; v < end_view; v++)
        for (size_t p = 0; p < points; p++) {
            size_t i = (v * (size_t)o->camera_count + (size_t)camera) * points + p;
            const double *r = job->calibration->residual + 2 * i;
            if (!isfinite(r[0])) continue;
            const double *seen = td_observations_get(o, v, camera)->point + 2 * p;
            int k = !job->calibration->used[i];
            size_t n = g->count[k]++;
            g->x[k][n] = seen[0], g->y[k][n] = seen[1];
            g->dx[k][n] = -r[0], g->dy[k][n] = -r[1]; /* from where it should be to where it was seen */
        }
    return true;
}

static void gathered_free(gathered *g)
{
    free(g->x[0]);
}

/* Vectors that are long enough to see: the RMS residual becomes 2 % of the image's width. */
static double vector_scale(const td_camera *camera, double rms)
{
    double scale = 0.02 * camera->width / fmax(rms, 1e-3), step = pow(10, floor(log10(scale)));
    return floor(scale / step) * step;
}

static void residual_plots(td_report *r, const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    td_report_grid_begin(r, 2);
    for (int k = 0; k < c->rig->count; k++) {
        gathered g;
        const td_camera *camera = &c->rig->camera[k].camera;
        if (!gather(&g, job, k, 0, c->view_count)) continue;
        char title[TD_NAME_SIZE + 32];
        snprintf(title, sizeof title, "%s: residuals over the image", c->rig->camera[k].name);
        double scale = vector_scale(camera, c->camera[k].rms_px);
        const td_series series[2] = {{.label = "used",
                                      .shape = TD_SHAPE_POINT,
                                      .count = g.count[0],
                                      .x = g.x[0],
                                      .y = g.y[0],
                                      .dx = g.dx[0],
                                      .dy = g.dy[0],
                                      .vector_scale = scale},
                                     {.label = "left out",
                                      .shape = TD_SHAPE_CROSS,
                                      .tone = TD_TONE_BAD,
                                      .count = g.count[1],
                                      .x = g.x[1],
                                      .y = g.y[1],
                                      .dx = g.dx[1],
                                      .dy = g.dy[1],
                                      .vector_scale = scale}};
        const td_axes axes = {.title = title,
                              .x_label = "x (px)",
                              .y_label = "y (px)",
                              .x_min = -0.5,
                              .x_max = camera->width - 0.5,
                              .y_min = -0.5,
                              .y_max = camera->height - 0.5,
                              .equal = 1,
                              .y_down = 1};
        td_report_plot(r, &axes, series, g.count[1] ? 2 : 1);
        gathered_free(&g);
    }
    for (int k = 0; k < c->rig->count; k++) {
        gathered g;
        if (!gather(&g, job, k, 0, c->view_count)) continue;
        char title[TD_NAME_SIZE + 32];
        snprintf(title, sizeof title, "%s: residuals (px)", c->rig->camera[k].name);
        const td_series series = {.shape = TD_SHAPE_POINT, .count = g.count[0], .x = g.dx[0], .y = g.dy[0]};
        const td_axes axes = {
            .title = title, .x_label = "dx (px)", .y_label = "dy (px)", .equal = 1, .y_down = 1};
        td_report_plot(r, &axes, &series, 1);
        gathered_free(&g);
    }
    td_report_grid_end(r);
}

static void rms_plot(td_report *r, const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    const char **names = malloc((c->view_count + 1) * sizeof *names);
    double *x = malloc((c->view_count + 1) * sizeof *x * (1 + TD_RIG_MAX_CAMERAS));
    td_series series[TD_RIG_MAX_CAMERAS] = {0};
    for (size_t v = 0; v < c->view_count && names && x; v++) {
        names[v] = job->observations->view_name[v];
        x[v] = (double)v;
        for (int k = 0; k < c->rig->count; k++)
            x[(size_t)(k + 1) * (c->view_count + 1) + v] = c->view[v].rms_px[k];
    }
    for (int k = 0; k < c->rig->count && names && x; k++)
        series[k] = (td_series){.label = c->rig->camera[k].name,
                                .shape = TD_SHAPE_BAR,
                                .count = c->view_count,
                                .x = x,
                                .y = x + (size_t)(k + 1) * (c->view_count + 1)};
    const td_axes axes = {.title = "residual of each view",
                          .x_label = "view",
                          .y_label = "RMS (px)",
                          .x_names = names,
                          .x_name_count = c->view_count};
    if (names && x) td_report_plot(r, &axes, series, (size_t)c->rig->count);
    free(names);
    free(x);
}

/* ---- Trust ---- */

static void uncertainty_plot(td_report *r, const calibrate_job *job, int c, int distance)
{
    const td_uncertainty_map *map = job->trust->map;
    const td_rig_camera *camera = &job->calibration->rig->camera[c];
    char title[TD_NAME_SIZE + 96], label[48];
    /* Corners that no board reached would leave one colour to all the rest. */
    double most, median = calibrate_map_median(map, c, distance, &most), high = fmin(most, 6 * median);
    snprintf(title, sizeof title, "%s at %.2f m: median %.3f px, at most %.1f px", camera->name,
             map->distance_m[distance], median, most);
    snprintf(label, sizeof label, most > high ? "sigma (px), %.2g and more" : "sigma (px)", high);
    const td_heat heat = {.columns = map->columns,
                          .rows = map->rows,
                          .value =
                              map->sigma_px + ((size_t)c * (size_t)map->distance_count + (size_t)distance) *
                                                  (size_t)(map->columns * map->rows),
                          .high = high,
                          .label = label};
    const td_axes axes = {.title = title,
                          .x_label = "x (px)",
                          .y_label = "y (px)",
                          .x_max = camera->camera.width - 1,
                          .y_max = camera->camera.height - 1,
                          .equal = 1,
                          .y_down = 1,
                          .heat = &heat};
    td_report_plot(r, &axes, NULL, 0);
}

static void coverage_table(td_report *r, const calibrate_job *job)
{
    static const char *const heads[] = {"camera",
                                        "views",
                                        "image covered",
                                        "distances (m)",
                                        "largest tilt",
                                        "right / left away",
                                        "lower / upper away"};
    const td_rig *rig = job->calibration->rig;
    td_report_table_begin(r, heads, sizeof heads / sizeof *heads);
    for (int c = 0; c < rig->count; c++) {
        const td_coverage *k = &job->trust->coverage[c];
        td_report_cell(r, TD_TONE_PLAIN, "%s", rig->camera[c].name);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", k->views);
        td_report_cell(r, k->image_share < 0.5 ? TD_TONE_WARN : TD_TONE_PLAIN, "%.0f %%",
                       100 * k->image_share);
        td_report_cell(r, TD_TONE_PLAIN, "%.2f to %.2f", k->nearest_m, k->farthest_m);
        td_report_cell(r, TD_TONE_PLAIN, "%.0f°", k->tilt_rad * DEGREES);
        for (int i = 0; i < TD_COVERAGE_TILTS; i += 2)
            td_report_cell(r, k->tilted[i] && k->tilted[i + 1] ? TD_TONE_PLAIN : TD_TONE_WARN, "%zu / %zu",
                           k->tilted[i], k->tilted[i + 1]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
    for (int c = 0; c < rig->count; c++)
        if (*job->trust->coverage[c].missing) td_report_text(r, "%s.", job->trust->coverage[c].missing);
}

static void model_table(td_report *r, const calibrate_job *job)
{
    const calibrate_trust *t = job->trust;
    const td_rig *rig = job->calibration->rig;
    const char *heads[1 + TD_RIG_MAX_CAMERAS] = {"RMS of held-out views (px)"};
    int camera[TD_RIG_MAX_CAMERAS];
    size_t n = 0;
    for (int c = 0; c < rig->count; c++)
        if (t->has_choice[c]) {
            camera[n] = c;
            heads[++n] = rig->camera[c].name;
        }
    if (!n) return;
    td_report_heading(r, "Lens models");
    td_report_table_begin(r, heads, n + 1);
    for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        td_report_cell(r, TD_TONE_PLAIN, "%s", td_camera_model_name((td_camera_model)m));
        for (size_t i = 0; i < n; i++) {
            const td_model_choice *k = &t->choice[camera[i]];
            td_report_cell(r, (int)k->best == m ? TD_TONE_GOOD : TD_TONE_PLAIN,
                           k->score[m].failed ? "–" : "%.4f", k->score[m].held_out_px);
        }
        td_report_row_end(r);
    }
    td_report_table_end(r);
    for (size_t i = 0; i < n; i++) td_report_text(r, "%s.", t->choice[camera[i]].text);
}

static void trust(td_report *r, const calibrate_job *job)
{
    const td_uncertainty_map *map = job->trust->map;
    td_report_heading(r, "What the views cover");
    coverage_table(r, job);
    if (map) {
        td_report_heading(r, "How far a projected point can be trusted");
        td_report_text(
            r, "Standard deviation of where a point is seen, in the worst direction, from the noise of the "
               "points found: a point as far away as the boards were, and one ten times as far. Where it "
               "is large, add views there. What the lens model cannot follow is not in it.");
        td_report_grid_begin(r, 2);
        for (int c = 0; c < map->camera_count; c++) {
            uncertainty_plot(r, job, c, map->distance_count > 2 ? 1 : 0);
            if (map->distance_count > 1) uncertainty_plot(r, job, c, map->distance_count - 1);
        }
        td_report_grid_end(r);
    }
    model_table(r, job);
}

static void pictures(td_report *r, const calibrate_job *job)
{
    enum { MOST = 60 };
    size_t shown = 0, cameras = (size_t)job->observations->camera_count;
    if (job->dataset->corners) return; /* there are no images */
    td_report_heading(r, "Points over the images");
    td_report_text(
        r,
        "Lines lead from where the calibration puts each point to where it was seen, drawn 50 times longer. "
        "Points that were left out are crosses.");
    td_report_grid_begin(r, cameras > 1 ? 2 : 3);
    for (size_t v = 0; v < job->calibration->view_count; v++)
        for (size_t k = 0; k < cameras && shown < MOST; k++) {
            const char *path = job->dataset->frame[v].image[k];
            td_image *image = NULL;
            gathered g;
            if (!path || td_image_read(&image, path, 1, NULL) != TD_OK) continue;
            if (gather(&g, job, (int)k, v, v + 1)) {
                const td_series series[2] = {{.shape = TD_SHAPE_POINT,
                                              .count = g.count[0],
                                              .x = g.x[0],
                                              .y = g.y[0],
                                              .dx = g.dx[0],
                                              .dy = g.dy[0],
                                              .vector_scale = 50},
                                             {.shape = TD_SHAPE_CROSS,
                                              .tone = TD_TONE_BAD,
                                              .count = g.count[1],
                                              .x = g.x[1],
                                              .y = g.y[1],
                                              .dx = g.dx[1],
                                              .dy = g.dy[1],
                                              .vector_scale = 50}};
                char caption[TD_TEXT_SIZE + TD_NAME_SIZE];
                const td_detection *d = td_observations_get(job->observations, v, (int)k);
                if (d->found)
                    snprintf(caption, sizeof caption, "%s, %s: %.3f px RMS", job->observations->view_name[v],
                             job->observations->camera[k].name, job->calibration->view[v].rms_px[k]);
                else
                    snprintf(caption, sizeof caption, "%s, %s: %s", job->observations->view_name[v],
                             job->observations->camera[k].name, d->reason);
                td_report_picture(r, image, 480, caption, series, g.count[1] ? 2 : 1);
                shown++;
                gathered_free(&g);
            }
            td_image_free(&image);
        }
    td_report_grid_end(r);
}

static void figures(td_report *r, const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    td_report_figures_begin(r);
    td_report_figure(r, "RMS residual", TD_TONE_PLAIN, "%.3f px", c->rms_px);
    if (c->leave_one_out.views)
        td_report_figure(r, "RMS of views left out", TD_TONE_PLAIN, "%.3f px", c->leave_one_out.rms_px);
    if (c->pair_count) {
        td_report_figure(r, "baseline", TD_TONE_PLAIN, "%.2f ± %.2f mm", 1e3 * c->pair[0].baseline_m,
                         1e3 * c->pair[0].sigma_baseline_m);
        td_report_figure(r, "epipolar error", TD_TONE_PLAIN, "%.3f px", c->pair[0].epipolar_error_px);
        if (isfinite(c->leave_one_out.scale_error))
            td_report_figure(r, "scale error of views left out", TD_TONE_PLAIN, "%+.3f %%",
                             100 * c->leave_one_out.scale_error);
    }
    if (isfinite(job->trust->projected_px))
        td_report_figure(r, "sigma of a projected point", TD_TONE_PLAIN, "%.2f px", job->trust->projected_px);
    td_report_figures_end(r);
}

td_status calibrate_report(const calibrate_job *job, const char *path, td_error *error)
{
    const td_calibration *c = job->calibration;
    char target[160], subtitle[400];
    snprintf(subtitle, sizeof subtitle, "%s, %s, %zu views", job->dataset->name,
             td_target_describe(target, sizeof target, &job->dataset->target), c->view_count);
    td_report *r = td_report_new("Calibration", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, job->gate);
    figures(r, job);
    td_report_heading(r, "Cameras");
    camera_table(r, c);
    pair_text(r, c);
    if (c->has_warp)
        td_report_text(
            r, "The board bulges by %+.3f ± %.3f mm along its rows and %+.3f ± %.3f mm along its columns.",
            1e3 * c->warp_m[0], 1e3 * c->sigma_warp_m[0], 1e3 * c->warp_m[1], 1e3 * c->sigma_warp_m[1]);
    char board[TD_TEXT_SIZE];
    if (c->board.significant)
        td_report_text(r, "Of the board %s.", board_text(board, sizeof board, &c->board));
    td_report_heading(r, "Residuals");
    residual_plots(r, job);
    rms_plot(r, job);
    trust(r, job);
    td_report_heading(r, "Views");
    view_table(r, job);
    pictures(r, job);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
