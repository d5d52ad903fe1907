/* The map's own parts on a frame of 1280 x 960 px seen from 3 m (f 1600 px, baseline 0.4 m), one thread.
 *
 *   map fusion      disparities into cells of 5 cm: points of a second, one core
 *   map rectify     both images by tables, against rectifying each pixel anew
 *   map memory      tiles of 1 km^2 at 5 cm when all of it is known */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "recon/fusion.h"
#include "tests/bench/bench.h"

typedef struct scene {
    td_rig *rig;
    td_depth_camera *camera;
    td_fusion *fusion;
    td_fusion_frame frame;
    td_disparity disparity;
    td_image *raw, *out[2];
    size_t points;
    bool failed;
} scene;

static void report(scene *s, td_status status, const td_error *error)
{
    if (status == TD_OK) return;
    fprintf(stderr, "%s\n", error->message);
    s->failed = true;
}

static void make_rig(scene *s)
{
    td_error error = {0};
    s->rig = td_rig_new();
    s->rig->count = 2;
    for (int c = 0; c < 2; c++) {
        td_rig_camera *camera = &s->rig->camera[c];
        snprintf(camera->name, sizeof camera->name, c ? "right" : "left");
        camera->camera =
            (td_camera){TD_CAMERA_BROWN5, 1280, 960, {1600, 1600, 639.5, 479.5, -0.1, 0.02, 1e-4, 1e-4, 0}};
        camera->camera_from_rig = td_pose_identity();
    }
    s->rig->camera[1].camera_from_rig.t[0] = -0.4;
    const size_t n = td_rig_parameter_count(s->rig);
    s->rig->covariance = calloc(n * n, sizeof(double));
    for (size_t i = 0; i < n; i++) s->rig->covariance[i * n + i] = i < 24 ? 1e-6 : 1e-8;
    report(s, td_depth_camera_new(&s->camera, s->rig, 0, 1, 1, 20, &error), &error);
}

/* Flat ground 3 m below a camera that looks down by 60 degrees, with noise of 0.1 px. */
static void make_disparity(scene *s)
{
    const td_rectification *r = td_depth_camera_rectification(s->camera);
    const double *k = r->camera.parameter, down = 1.0472;
    const size_t n = (size_t)r->camera.width * (size_t)r->camera.height;
    td_random random = td_random_seed(1, 0);
    s->disparity = (td_disparity){r->camera.width, r->camera.height, malloc(n * sizeof(float)),
                                  malloc(n * sizeof(float)), malloc(n)};
    for (size_t i = 0; i < n; i++) {
        const double y = ((double)(i / (size_t)r->camera.width) - k[3]) / k[0];
        const double depth = 3 / (sin(down) + y * cos(down));
        s->disparity.value[i] = (float)(k[0] * r->baseline_m / depth + 0.1 * td_random_normal(&random));
        s->disparity.sigma[i] = 0.1f;
        s->disparity.kind[i] = TD_DENSE_MATCHED;
    }
    const double m[9] = {0, -sin(down), cos(down), -1, 0, 0, 0, -cos(down), -sin(down)}, t[3] = {0, 0, 3};
    s->frame = (td_fusion_frame){s->camera, &s->disparity, td_pose_from_rotation(m, t), NULL, 0};
}

static void fuse(void *user)
{
    scene *s = user;
    td_error error = {0};
    td_fusion_tally tally;
    report(s, td_fusion_add(s->fusion, &s->frame, &tally, &error), &error);
    s->points = tally.points;
}

static void rectify_ours(void *user)
{
    scene *s = user;
    td_error error = {0};
    report(s, td_depth_camera_rectify(&s->out[0], &s->out[1], s->camera, s->raw, s->raw, 1, &error), &error);
    td_image_free(&s->out[0]);
    td_image_free(&s->out[1]);
}

static void rectify_exactly(void *user)
{
    scene *s = user;
    td_error error = {0};
    for (int c = 0; c < 2; c++) {
        report(s,
               td_rectify_image(&s->out[c], s->raw, td_depth_camera_rectification(s->camera), c,
                                &s->rig->camera[c].camera, 1, &error),
               &error);
        td_image_free(&s->out[c]);
    }
}

static void fusion_row(const bench *b, scene *s)
{
    td_error error = {0};
    td_fusion_options options = td_fusion_options_default();
    options.threads = 1;
    make_disparity(s);
    report(s, td_fusion_new(&s->fusion, &options, &error), &error);
    if (s->failed) return;
    const double seconds = bench_time(fuse, s, 7);
    bench_row r = {.name = "map fusion",
                   .unit = "1/s",
                   .ours = (double)s->points / seconds,
                   .peer = NAN,
                   .peer_name = "none",
                   .runs = 7,
                   .remark = "points; no peer keeps sigma apart"};
    if (!s->failed) bench_print(b, &r);
    td_fusion_free(&s->fusion);
    free(s->disparity.value);
    free(s->disparity.sigma);
    free(s->disparity.kind);
}

static void rectify_row(const bench *b, scene *s)
{
    td_error error = {0};
    td_random random = td_random_seed(2, 0);
    report(s, td_image_new(&s->raw, 1280, 960, 1, &error), &error);
    for (int i = 0; s->raw && i < 1280 * 960; i++) s->raw->data[i] = (uint8_t)td_random_below(&random, 256);
    bench_row r = {.name = "map rectify", .unit = "ms", .peer_name = "each pixel anew", .runs = 5};
    r.ours = 1e3 * bench_time(rectify_ours, s, 5);
    r.peer = 1e3 * bench_time(rectify_exactly, s, 5);
    if (!s->failed) bench_print(b, &r);
    td_image_free(&s->raw);
}

void bench_map(const bench *b)
{
    scene s = {0};
    const bool fusion = bench_wanted(b, "map fusion"), rectify = bench_wanted(b, "map rectify");
    if (fusion || rectify) make_rig(&s);
    if (fusion && !s.failed) fusion_row(b, &s);
    if (rectify && !s.failed) rectify_row(b, &s);
    td_depth_camera_free(&s.camera);
    td_rig_free(&s.rig);
    bench_row r = {.name = "map memory 1 km2 at 5 cm",
                   .unit = "MB",
                   .ours = td_fusion_memory_of(1000, 1000, 0.05) / 1e6,
                   .peer = NAN,
                   .peer_name = "none",
                   .runs = 1,
                   .remark = "if all is known; in memory at most memory_bytes (1 GiB)"};
    if (bench_wanted(b, r.name)) bench_print(b, &r);
}
