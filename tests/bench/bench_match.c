/* Automatic matching beside OpenCV's corners and template matching, on the Aloe pair of Debian's opencv-doc:
 * the same number of points asked for, the same windows, disparities and threshold, both checked from right
 * to left, one thread each. Error: share of matches farther than 1.5 px from the integer truth. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "recon/match.h"
#include "tests/bench/bench.h"

enum { POINTS = 2000, MOST_DISPARITY = 240, RUNS = 5 };

#define ALOE "/usr/share/doc/opencv-doc/examples/data/aloe"

typedef struct input {
    td_image *left, *right, *truth;
    td_rig *rig;
    td_pair pair;
    td_match *match; /* of the last run */
    size_t count;
    td_match_tally tally;
} input;

static void run_ours(void *user)
{
    input *in = user;
    td_match_options o = td_match_options_default();
    o.near_m = 3740 * 0.16 / MOST_DISPARITY;
    o.interest.count = POINTS;
    o.threads = o.interest.threads = 1;
    free(in->match);
    in->match = NULL;
    in->count = 0;
    if (td_match_automatic(&in->match, &in->count, &in->tally, &in->pair, in->left, in->right, &o, NULL) !=
        TD_OK)
        in->match = NULL;
}

static bool read_pair(input *in)
{
    td_error error;
    if (td_image_read(&in->left, ALOE "L.jpg", 1, &error) != TD_OK ||
        td_image_read(&in->right, ALOE "R.jpg", 1, &error) != TD_OK ||
        td_image_read(&in->truth, ALOE "GT.png", 1, &error) != TD_OK)
        return false;
    in->rig = td_rig_new();
    in->rig->count = 2;
    for (int i = 0; i < 2; i++) {
        strcpy(in->rig->camera[i].name, i ? "right" : "left");
        in->rig->camera[i].camera =
            (td_camera){TD_CAMERA_PINHOLE, in->left->width, in->left->height, {3740, 3740, 640, 555}};
        in->rig->camera[i].camera_from_rig = td_pose_identity();
    }
    in->rig->camera[1].camera_from_rig.t[0] = -0.16;
    return td_pair_init(&in->pair, in->rig, 0, 1, &error) == TD_OK;
}

/* Adds one match to the count of those with truth and of those that are wrong. */
static void judge(size_t *known, size_t *wrong, const input *in, double x, double y, double right_x)
{
    const int d = in->truth->data[(size_t)lrint(y) * (size_t)in->truth->width + (size_t)lrint(x)];
    if (d == 0) return;
    ++*known;
    *wrong += fabs(x - right_x - d) > 1.5;
}

static void print_rows(const bench *b, const input *in, const bench_match_pair *peer, double ours_s,
                       double peer_s)
{
    size_t known[2] = {0}, wrong[2] = {0};
    for (size_t i = 0; i < in->count; i++)
        judge(&known[0], &wrong[0], in, in->match[i].left[0], in->match[i].left[1], in->match[i].right[0]);
    for (int i = 0; i < peer->matched; i++)
        judge(&known[1], &wrong[1], in, peer->match[4 * i], peer->match[4 * i + 1], peer->match[4 * i + 2]);
    bench_row row = {.name = "match points (Aloe)",
                     .unit = "1/s",
                     .ours = (double)in->tally.left_points / ours_s,
                     .peer = peer->found / peer_s,
                     .peer_name = "OpenCV matchTemplate",
                     .error_unit = "% wrong",
                     .error_ours = 100. * (double)wrong[0] / (double)known[0],
                     .error_peer = 100. * (double)wrong[1] / (double)known[1],
                     .runs = RUNS};
    bench_print(b, &row);
    row.name = "match matches (Aloe)";
    row.ours = (double)in->count / ours_s;
    row.peer = peer->matched / peer_s;
    bench_print(b, &row);
}

void bench_match(const bench *b)
{
    input in = {0};
    double match[4 * POINTS];
    if (!bench_wanted(b, "match points (Aloe)") && !bench_wanted(b, "match matches (Aloe)")) return;
    if (read_pair(&in)) {
        const td_match_options o = td_match_options_default();
        bench_match_pair peer = {in.left->data,
                                 in.right->data,
                                 in.left->width,
                                 in.left->height,
                                 POINTS,
                                 o.half_window,
                                 MOST_DISPARITY,
                                 o.least_zncc,
                                 match,
                                 0,
                                 0};
        const double ours_s = bench_time(run_ours, &in, RUNS);
        const double peer_s = bench_time(bench_opencv_match, &peer, RUNS);
        print_rows(b, &in, &peer, ours_s, peer_s);
    } else {
        const bench_row row = {.name = "match points (Aloe)",
                               .unit = "1/s",
                               .ours = NAN,
                               .peer = NAN,
                               .peer_name = "OpenCV matchTemplate",
                               .remark = "no Aloe pair: install opencv-doc"};
        bench_print(b, &row);
    }
    free(in.match);
    td_image_free(&in.left);
    td_image_free(&in.right);
    td_image_free(&in.truth);
    td_rig_free(&in.rig);
}
