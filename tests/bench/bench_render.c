/* Stereo frames rendered per second against the size of the map: hills of 20 x 20 m in cells of 8 cm to 1 cm,
 * seen from 3.5 m above, default options, all processors; files left out. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "sim/stereo_view.h"
#include "tests/bench/bench.h"

typedef struct setting {
    td_stereo_view *view;
    td_rig *rig;
    td_pose pose;
    uint64_t frame;
    bool failed;
} setting;

static void render_pair(void *user)
{
    setting *s = user;
    for (int k = 0; k < 2; k++) {
        td_view *out = NULL;
        if (td_stereo_view_render(&out, s->view, s->rig, k, &s->pose, s->frame, NULL, NULL) != TD_OK)
            s->failed = true;
        td_view_free(&out);
    }
    s->frame++;
}

static td_rig *make_rig(int width, int height)
{
    td_rig *rig = td_rig_new();
    if (!rig) return NULL;
    rig->count = 2;
    for (int k = 0; k < 2; k++) {
        rig->camera[k].camera = (td_camera){.model = TD_CAMERA_BROWN5,
                                            .width = width,
                                            .height = height,
                                            .parameter = {width, width, 0.5 * width, 0.5 * height, -0.1}};
        rig->camera[k].camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[0] = -0.4;
    return rig;
}

static td_elevation *make_hills(int n)
{
    td_elevation *map = NULL;
    const double origin[2] = {-5, -10};
    if (td_elevation_new(&map, n, n, 20.0 / n, origin, "site", NULL) != TD_OK) return NULL;
    for (int r = 0; r < n; r++)
        for (int c = 0; c < n; c++) {
            const double x = 20.0 * c / n, y = 20.0 * r / n;
            map->height[(size_t)r * n + c] =
                (float)(0.3 * sin(x) * cos(0.8 * y) + 0.1 * sin(4 * x + y) + 0.03 * sin(15 * y + 3 * x));
        }
    return map;
}

static void row(const bench *b, int cells, int width, int height)
{
    char name[64];
    snprintf(name, sizeof name, "render %dx%d, %d^2 cells", width, height, cells);
    if (!bench_wanted(b, name)) return;
    enum { RUNS = 7 };
    const double pitch = 0.7, r[9] = {0, -sin(pitch), cos(pitch), -1, 0, 0, 0, -cos(pitch), -sin(pitch)};
    const double t[3] = {-4, 0, 3.5};
    td_scene scene = {
        .ground = make_hills(cells),
        .ground_surface = {.albedo = 0.4, .contrast = 0.3, .grain_m = 0.5, .octaves = 9, .seed = 1},
        .site_from_vehicle = td_pose_identity(),
        .sun = {0.6, 0, 0.8},
        .ambient = 0.3};
    setting s = {.rig = make_rig(width, height), .pose = td_pose_from_rotation(r, t)};
    if (scene.ground && s.rig && td_stereo_view_new(&s.view, &scene, NULL) == TD_OK) {
        const double time = bench_time(render_pair, &s, RUNS);
        const bench_row line = {.name = name,
                                .unit = "1/s",
                                .ours = s.failed ? NAN : 1 / time,
                                .peer = NAN,
                                .peer_name = "OpenGL ES on llvmpipe",
                                .runs = RUNS,
                                .remark = "not run here: its vertex work grows with the map"};
        bench_print(b, &line);
    }
    td_stereo_view_free(&s.view);
    td_rig_free(&s.rig);
    td_elevation_free(&scene.ground);
}

void bench_render(const bench *b)
{
    static const int cells[] = {250, 500, 1000, 2000};
    for (size_t i = 0; i < sizeof cells / sizeof *cells; i++) {
        row(b, cells[i], 640, 480);
        row(b, cells[i], 1280, 960);
    }
}
