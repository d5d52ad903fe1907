/* Charucos beside OpenCV's, on views with known corners: sharp and near, small, and blurred. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/charuco.h"
#include "tests/bench/bench.h"
#include "tests/bench/bench_charuco.h"
#include "tests/calib/charuco_scene.h"

enum { VIEWS = 72, RUNS = 1 };

typedef struct views {
    charuco_scene scene;
    td_image *image[VIEWS];
    td_pose pose[VIEWS];
    double *point; /* (VIEWS,corners,2) */
    size_t corners;
} views;

static void ours(void *user)
{
    views *v = user;
    for (int i = 0; i < VIEWS; i++) {
        td_detection d = {0};
        if (td_charuco_detect(&d, v->image[i], &v->scene.target, NULL) == TD_OK)
            memcpy(v->point + 2 * v->corners * (size_t)i, d.point, 2 * v->corners * sizeof *d.point);
        td_detection_free(&d);
    }
}

typedef struct verdict {
    double rms_px, shift_px[2], recall; /* scatter about the mean error; mean error; of the corners in view */
    int wrong;                          /* by more than 2 px */
} verdict;

/* A constant shift is told apart: OpenCV's corners lie half a pixel to the lower right. */
static verdict judge(views *v, const double *point)
{
    verdict j = {0};
    double square = 0;
    size_t found = 0, there = 0;
    for (size_t i = 0; i < VIEWS * v->corners; i++) {
        double truth[2];
        const double *p = point + 2 * i;
        v->scene.camera_from_target = v->pose[i / v->corners];
        const bool inside = charuco_truth(truth, &v->scene, i % v->corners, 5);
        const double x = p[0] - truth[0], y = p[1] - truth[1];
        there += inside;
        if (isnan(x) || !inside) continue;
        if (hypot(x, y) > 2) {
            j.wrong++;
            continue;
        }
        found++;
        square += x * x + y * y;
        j.shift_px[0] += x, j.shift_px[1] += y;
    }
    for (int k = 0; k < 2; k++) {
        j.shift_px[k] /= (double)found;
        square -= (double)found * j.shift_px[k] * j.shift_px[k];
    }
    j.recall = (double)found / (double)there;
    j.rms_px = sqrt(square / 2 / (double)found);
    return j;
}

static bool make_views(views *v, double near_m, double far_m, double blur)
{
    td_random random = td_random_seed(7, 1);
    td_error error = {0};
    *v = (views){.scene = {.target = charuco_target(9, 6, "aruco4x4_50"),
                           .camera = charuco_camera(),
                           .blur = blur,
                           .noise = 2,
                           .dark = 30,
                           .light = 210}};
    v->corners = td_target_point_count(&v->scene.target);
    bool made = charuco_draw(&v->scene, &error) == TD_OK;
    for (int i = 0; made && i < VIEWS; i++) {
        const double distance = near_m + (far_m - near_m) * td_random_uniform(&random);
        v->scene.camera_from_target = v->pose[i] = charuco_pose(&v->scene, distance, 0.8, &random);
        made = charuco_photograph(&v->image[i], &v->scene, &random, &error) == TD_OK;
    }
    v->point = malloc(2 * VIEWS * v->corners * sizeof *v->point);
    if (!made) fprintf(stderr, "teledimos-bench: %s\n", error.message);
    return made && v->point;
}

static void compare(const bench *b, const char *title, views *v)
{
    const unsigned char *data[VIEWS];
    char remark[200];
    double *peer_point = malloc(2 * VIEWS * v->corners * sizeof *peer_point);
    if (!peer_point) return;
    for (int i = 0; i < VIEWS; i++) data[i] = v->image[i]->data;
    bench_charuco_input in = {data, VIEWS,     v->scene.camera.width, v->scene.camera.height, 9, 6, 0,
                              0.75, peer_point};
    bench_row r = {.name = title, .unit = "ms", .peer_name = "OpenCV", .error_unit = "px", .runs = RUNS};
    r.ours = bench_time(ours, v, RUNS) / VIEWS * 1e3;
    r.peer = bench_time(bench_opencv_charuco, &in, RUNS) / VIEWS * 1e3;
    const verdict mine = judge(v, v->point), peers = judge(v, peer_point);
    r.error_ours = mine.rms_px, r.error_peer = peers.rms_px;
    snprintf(remark, sizeof remark,
             "found %.1f %% of the corners, %d wrong, shift %.2f %.2f px; OpenCV %.1f %%, %d wrong, shift "
             "%.2f %.2f px",
             100 * mine.recall, mine.wrong, mine.shift_px[0], mine.shift_px[1], 100 * peers.recall,
             peers.wrong, peers.shift_px[0], peers.shift_px[1]);
    r.remark = remark;
    bench_print(b, &r);
    if (!b->json) printf("    %s\n", remark);
    free(peer_point);
}

static void row(const bench *b, const char *title, double near_m, double far_m, double blur)
{
    views v;
    if (!bench_wanted(b, title)) return;
    if (make_views(&v, near_m, far_m, blur)) compare(b, title, &v);
    for (int i = 0; i < VIEWS; i++) td_image_free(&v.image[i]);
    td_image_free(&v.scene.board);
    free(v.point);
}

void bench_charuco(const bench *b)
{
    row(b, "charuco near", 0.3, 0.6, 0.5);
    row(b, "charuco far", 0.6, 1, 0.5);
    row(b, "charuco blurred", 0.3, 0.5, 1.5);
}
