/* Camera to vehicle: the excavator of datasets/zx200, 20 poses of the arm, six known points on the stick,
 * 0.2 px and 0.05 degrees of noise, over many draws. Time of a solve with its covariance and the tip's sigma
 * over the working space; error: RMS distance of the rig's position from the truth. Peer on the same sights:
 * the closed way of the TELEDIMOS paper (section 4), the mean over the poses. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "tests/bench/bench.h"
#include "tests/calib/vehicle_scene.h"

enum { DRAWS = 25, POSES = 20 };

typedef struct tally {
    double square_mm, time[DRAWS];
    int count;
} tally;

static void run_one(tally *t, const scene *s, bool closed)
{
    td_vehicle_options o = td_vehicle_options_default();
    td_vehicle *v = NULL;
    o.closed_only = closed;
    double began = bench_now();
    td_status status = td_vehicle_solve(&v, &s->data, &o, NULL);
    double took = bench_now() - began;
    if (status != TD_OK) return;
    td_pose back = td_pose_inverse(&s->mount_from_rig), off = td_pose_compose(&back, &v->vehicle_from_rig);
    t->square_mm += pow(1e3 * td_pose_distance(&off), 2);
    t->time[t->count++] = took;
    td_vehicle_free(&v);
}

void bench_vehicle(const bench *b)
{
    scene s;
    tally ours = {0}, closed = {0};
    const char *name = "vehicle 20 poses, 6 points";
    if (!bench_wanted(b, name)) return;
    scene_make(&s, true);
    scene_poses(&s, POSES, 0.15, 3);
    for (int i = 0; i < DRAWS; i++) {
        scene_measure(&s, 1, 900 + (uint64_t)i);
        run_one(&ours, &s, false);
        run_one(&closed, &s, true);
    }
    scene_drop(&s);
    if (!ours.count || !closed.count) return;
    bench_row row = {.name = name,
                     .unit = "ms",
                     .ours = 1e3 * bench_median(ours.time, (size_t)ours.count),
                     .peer = 1e3 * bench_median(closed.time, (size_t)closed.count),
                     .peer_name = "the closed way",
                     .error_unit = "mm of the rig",
                     .error_ours = sqrt(ours.square_mm / ours.count),
                     .error_peer = sqrt(closed.square_mm / closed.count),
                     .runs = DRAWS};
    bench_print(b, &row);
}
