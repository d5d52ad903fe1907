/* What a task did to its ground: volumes, maps before and after, and pictures of them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "core/file.h"
#include "core/report.h"
#include "sim/stereo_view.h"

/* ---- volumes ---- */

/* Cells that the map knew before; soil that fell elsewhere is not counted, for nobody could see it. */
void task_volumes(double *cut_m3, double *fill_m3, const task_job *j)
{
    const td_elevation *before = j->scenario->map, *after = j->run.after;
    const size_t count = (size_t)before->columns * (size_t)before->rows;
    double cut = 0, fill = 0;
    for (size_t i = 0; i < count; i++) {
        const double lower = (double)before->height[i] - (double)after->height[i];
        if (lower > 0) cut += lower;
        if (lower < 0) fill -= lower;
    }
    *cut_m3 = cut * before->cell_m * before->cell_m;
    *fill_m3 = fill * before->cell_m * before->cell_m;
}

td_status task_write_ground(const task_run *run, const scenario *s, const char *folder, td_error *error)
{
    static const char *const names[] = {"before.tif", "after.tif"};
    if (!run->after) return TD_OK;
    for (int i = 0; i < 2; i++) {
        char *path = td_path_join(folder, names[i]);
        if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
        const td_status status = td_elevation_write(i ? run->after : s->map, path, error);
        free(path);
        TD_TRY(status);
    }
    return TD_OK;
}

/* ---- from above ---- */

enum { SIDE_PX = 640 };
static const double AROUND_M = 11;

typedef struct view {
    double x, y, step_m; /* of the upper left pixel's centre */
    int width, height;
} view;

/* Around the machine, up to the map's edges. */
static view view_of(const td_elevation *map, const td_pose *site_from_vehicle)
{
    view v = {.step_m = 2 * AROUND_M / SIDE_PX};
    double low[2], high[2];
    for (int i = 0; i < 2; i++) {
        const double size = map->cell_m * ((i ? map->rows : map->columns) - 1), at = site_from_vehicle->t[i];
        low[i] = fmax(map->origin[i], at - (i ? AROUND_M : AROUND_M / 2));
        high[i] = fmin(map->origin[i] + size, at + (i ? AROUND_M : 1.5 * AROUND_M));
    }
    v.x = low[0];
    v.y = high[1];
    v.width = (int)fmax(1, (high[0] - low[0]) / v.step_m);
    v.height = (int)fmax(1, (high[1] - low[1]) / v.step_m);
    return v;
}

/* Light from the north-west, 45 degrees high, on slopes drawn twice as steep; unknown ground is black. */
static td_image *shade(const td_elevation *map, const view *v)
{
    static const double sun[3] = {-0.5, 0.5, 0.70710678118654752}, STEEPER = 2;
    td_image *image = NULL;
    if (td_image_new(&image, v->width, v->height, 1, NULL) != TD_OK) return NULL;
    const double h = map->cell_m;
    for (int row = 0; row < v->height; row++)
        for (int c = 0; c < v->width; c++) {
            const double x = v->x + c * v->step_m, y = v->y - row * v->step_m;
            const double dx = STEEPER *
                              (td_elevation_at(map, x + h, y, NULL) - td_elevation_at(map, x - h, y, NULL)) /
                              (2 * h),
                         dy = STEEPER *
                              (td_elevation_at(map, x, y + h, NULL) - td_elevation_at(map, x, y - h, NULL)) /
                              (2 * h);
            const double light = (sun[2] - sun[0] * dx - sun[1] * dy) / sqrt(1 + dx * dx + dy * dy);
            image->data[(size_t)row * (size_t)v->width + (size_t)c] =
                isnan(light) ? 0 : (uint8_t)fmax(24, fmin(255, 24 + 231 * light));
        }
    return image;
}

/* The tracks' outline in the picture, closed. */
static void outline(double x[6], double y[6], const view *v, const td_pose *site_from_vehicle, double aside)
{
    static const double corner[5][2] = {{-2.1, -0.3}, {2.1, -0.3}, {2.1, 0.3}, {-2.1, 0.3}, {-2.1, -0.3}};
    for (int i = 0; i < 5; i++) {
        const double at[3] = {corner[i][0], corner[i][1] + aside, 0};
        double site[3];
        td_pose_transform(site, site_from_vehicle, at);
        x[i] = (site[0] - v->x) / v->step_m;
        y[i] = (v->y - site[1]) / v->step_m;
    }
}

static void from_above(td_report *r, const task_job *j, const td_elevation *map, const task_sample *a,
                       const char *caption)
{
    enum { MOST = 4000 };
    const view v = view_of(j->scenario->map, &j->run.sample[0].state.site_from_vehicle);
    double x[2][6], y[2][6], *way = calloc(2 * MOST, sizeof *way);
    td_image *image = shade(map, &v);
    size_t n = 0;
    const size_t stride = j->run.count / MOST + 1;
    for (size_t i = 0; way && i < j->run.count && n < MOST; i += stride) {
        way[n] = (j->run.sample[i].tool.t[0] - v.x) / v.step_m;
        way[MOST + n++] = (v.y - j->run.sample[i].tool.t[1]) / v.step_m;
    }
    for (int i = 0; i < 2; i++) outline(x[i], y[i], &v, &a->state.site_from_vehicle, i ? -1.095 : 1.095);
    const td_series series[] = {
        {.label = "tracks", .shape = TD_SHAPE_LINE, .tone = TD_TONE_WARN, .count = 5, .x = x[0], .y = y[0]},
        {.shape = TD_SHAPE_LINE, .tone = TD_TONE_WARN, .count = 5, .x = x[1], .y = y[1]},
        {.label = "way of the edge",
         .shape = TD_SHAPE_LINE,
         .count = n,
         .x = way,
         .y = way ? way + MOST : NULL}};
    if (image && way) td_report_picture(r, image, SIDE_PX, caption, series, a == j->run.sample ? 2 : 3);
    td_image_free(&image);
    free(way);
}

/* ---- from the side ---- */

/* site_from_camera: at `eye`, looking at `at`. */
static td_pose looking(const double eye[3], const double at[3])
{
    double z[3], x[3], y[3], m[9];
    for (int i = 0; i < 3; i++) z[i] = at[i] - eye[i];
    const double size = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2]);
    for (int i = 0; i < 3; i++) z[i] /= size;
    const double level = hypot(z[0], z[1]);
    x[0] = z[1] / level, x[1] = -z[0] / level, x[2] = 0;
    for (int i = 0; i < 3; i++) y[i] = z[(i + 1) % 3] * x[(i + 2) % 3] - z[(i + 2) % 3] * x[(i + 1) % 3];
    for (int i = 0; i < 3; i++) m[3 * i] = x[i], m[3 * i + 1] = y[i], m[3 * i + 2] = z[i];
    return td_pose_from_rotation(m, eye);
}

static td_status draw(td_view **picture, td_scene *scene, const td_pose *site_from_camera)
{
    td_rig *rig = td_rig_new();
    td_stereo_view *seen = NULL;
    td_view_options o = td_view_options_default();
    o.read_noise = o.shot_noise = 0;
    o.gain = 1.6;
    if (!rig) return TD_ERROR_MEMORY;
    rig->count = 1;
    rig->camera[0] = (td_rig_camera){.name = "side",
                                     .camera = {.model = TD_CAMERA_PINHOLE,
                                                .width = 960,
                                                .height = 540,
                                                .parameter = {900, 900, 479.5, 269.5}},
                                     .camera_from_rig = td_pose_identity()};
    td_status status = td_stereo_view_new(&seen, scene, NULL);
    if (status == TD_OK) status = td_stereo_view_render(picture, seen, rig, 0, site_from_camera, 0, &o, NULL);
    td_stereo_view_free(&seen);
    td_rig_free(&rig);
    return status;
}

static void from_the_side(td_report *r, const task_job *j)
{
    const task_sample *a = j->run.sample + j->run.count - 1;
    const double *base = a->state.site_from_vehicle.t, *tool = a->tool.t;
    td_scene scene = {
        .ground = j->run.after,
        .ground_surface = {.albedo = 0.4, .contrast = 0.15, .grain_m = 0.5, .octaves = 6, .seed = 3},
        .robot = j->scenario->robot,
        .robot_surface = {.albedo = 0.75},
        .site_from_vehicle = a->state.site_from_vehicle,
        .sun = {0, 0, 0.8},
        .ambient = 0.35};
    td_view *picture = NULL;
    memcpy(scene.q, a->state.q, sizeof scene.q);
    const double ahead[2] = {tool[0] - base[0], tool[1] - base[1]}, far = fmax(1, hypot(ahead[0], ahead[1]));
    const double at[3] = {base[0] + 0.5 * ahead[0], base[1] + 0.5 * ahead[1], base[2] + 1.8};
    /* Light from behind the eye. */
    const double side[2] = {ahead[1] / far, -ahead[0] / far};
    const double eye[3] = {at[0] + 13 * ahead[1] / far + 4 * ahead[0] / far,
                           at[1] - 13 * ahead[0] / far + 4 * ahead[1] / far, base[2] + 6};
    scene.sun[0] = 0.6 * (0.8 * side[0] + 0.6 * side[1]);
    scene.sun[1] = 0.6 * (0.8 * side[1] - 0.6 * side[0]);
    const td_pose site_from_camera = looking(eye, at);
    if (draw(&picture, &scene, &site_from_camera) == TD_OK)
        td_report_picture(r, picture->image, 960, "the machine on the ground as it is at the end", NULL, 0);
    td_view_free(&picture);
}

/* ---- the report ---- */

void task_report_ground(td_report *r, const task_job *j)
{
    const task_run *run = &j->run;
    const task_dug *d = &run->dug;
    double cut, fill;
    if (!run->after || run->count == 0) return;
    task_volumes(&cut, &fill, j);
    td_report_heading(r, "The ground");
    td_report_figures_begin(r);
    td_report_figure(r, "m³ dug, in the ground", TD_TONE_PLAIN, "%.3f", cut);
    td_report_figure(r, "m³ of fill", TD_TONE_PLAIN, "%.3f", fill);
    td_report_figure(r, "passes", TD_TONE_PLAIN, "%d", d->passes);
    td_report_figure(r, "kN, the largest cutting force", TD_TONE_PLAIN, "%.1f", 1e-3 * d->peak_n);
    td_report_figure(r, "m, the least clearance", TD_TONE_PLAIN, "%.2f", d->clearance_m);
    td_report_figure(r, "kg of soil lost or won", d->mass_error_kg == 0 ? TD_TONE_GOOD : TD_TONE_BAD, "%g",
                     d->mass_error_kg);
    td_report_figures_end(r);
    td_report_grid_begin(r, 2);
    from_above(r, j, j->scenario->map, run->sample, "before: the map, light from the upper left");
    from_above(r, j, run->after, run->sample + run->count - 1, "after");
    td_report_grid_end(r);
    from_the_side(r, j);
}
