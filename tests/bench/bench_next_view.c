/* Is the guidance worth it? Views that a careless person needs to reach a projected uncertainty: following
 * it, and holding the board at random in any of the same poses. Simulated boards and noise, real
 * calibrations, medians. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tests/bench/bench.h"
#include "tests/calib/guided.h"

static td_camera camera_of(double focal, double dx)
{
    return (td_camera){TD_CAMERA_BROWN5,
                       640,
                       480,
                       {focal, focal * 1.002, 322 + dx, 236 - dx, -0.28, 0.10, 1e-3, -5e-4, -0.02}};
}

static void row(const bench *b, const char *name, int cameras)
{
    enum { SEEDS = 11, RANDOM_VIEWS = 18, VIEWS = 14 };
    if (!bench_wanted(b, name)) return;
    td_rig *rig = td_rig_new();
    if (!rig) return;
    const double xi[6] = {0.005, -0.01, 0.003, -0.083, 0.001, 0.0005};
    rig->count = cameras;
    strcpy(rig->camera[0].name, "left");
    strcpy(rig->camera[1].name, "right");
    rig->camera[0].camera = camera_of(530, 0);
    rig->camera[1].camera = camera_of(540, 5);
    rig->camera[0].camera_from_rig = td_pose_identity();
    rig->camera[1].camera_from_rig = td_pose_exp(xi);
    guided_scene s = {rig, {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1}, 0.3, 0.9, 0.5, 0.1};
    s.target.plane[0] = (td_target_plane){9, 6, 0.025, td_pose_identity()};
    double asked[GUIDED_MOST], any[GUIDED_MOST];
    bench_row r = {.name = name,
                   .unit = "views",
                   .ours = NAN,
                   .peer = RANDOM_VIEWS,
                   .peer_name = "random poses",
                   .runs = SEEDS,
                   .error_unit = "px projected uncertainty"};
    if (guided_curve(asked, &s, VIEWS, GUIDED_ASKED, SEEDS) &&
        guided_curve(any, &s, RANDOM_VIEWS, GUIDED_ANY_POSE, SEEDS)) {
        r.ours = guided_views_to(asked, VIEWS, any[RANDOM_VIEWS - 1]);
        r.error_ours = r.error_peer = any[RANDOM_VIEWS - 1];
    }
    bench_print(b, &r);
    td_rig_free(&rig);
}

void bench_next_view(const bench *b)
{
    row(b, "next view, one camera", 1);
    row(b, "next view, pair", 2);
}
