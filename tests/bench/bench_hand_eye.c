/* Hand-eye calibration: 30 simulated views of a robot with noise (and, in the second set, a smooth error over
 * its working space), over many robots. Time of a solve; error: RMS distance of X's position from the truth.
 * Peers on the same views: OpenCV's best closed form (the best of its seven, picked as we pick: by scatter)
 * and plain least squares. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "calib/hand_eye_solvers.h"
#include "tests/bench/bench.h"
#include "tests/calib/hand_eye_simulate.h"

enum { VIEWS = 30, ROBOTS = 25 };

typedef struct tally {
    double square_mm, time[ROBOTS];
    int count;
} tally;

static void add(tally *t, const td_pose *x, const hand_eye_scene *s, double seconds)
{
    td_pose back = td_pose_inverse(&s->x), off = td_pose_compose(&back, x);
    t->square_mm += pow(1e3 * td_pose_distance(&off), 2);
    t->time[t->count++] = seconds;
}

static void run_ours(tally *t, const hand_eye_scene *s, td_robot_model model)
{
    td_hand_eye_options o = td_hand_eye_options_default(s->setup);
    td_hand_eye *r = NULL;
    o.model = model;
    o.leave_one_out = false;
    double began = bench_now();
    if (td_hand_eye_solve(&r, s->view, s->count, &o, NULL) == TD_OK) add(t, &r->x, s, bench_now() - began);
    td_hand_eye_free(&r);
}

/* OpenCV's own: ViSP's result, which the same call brings, is passed over. */
static void run_opencv(tally *t, const hand_eye_scene *s)
{
    td_solver_score score[TD_SOLVER_COUNT];
    double began = bench_now();
    if (td_hand_eye_solvers_run(score, s->setup, s->view, s->count, NULL) != TD_OK) return;
    score[TD_SOLVER_VISP].failed = true;
    int best = td_hand_eye_solvers_best(score);
    if (best >= 0) add(t, &score[best].x, s, bench_now() - began);
}

static void print(const bench *b, const char *name, tally *ours, tally *peer, const char *peer_name)
{
    bench_row row = {.name = name,
                     .unit = "ms",
                     .ours = 1e3 * bench_median(ours->time, (size_t)ours->count),
                     .peer = 1e3 * bench_median(peer->time, (size_t)peer->count),
                     .peer_name = peer_name,
                     .error_unit = "mm of X",
                     .error_ours = sqrt(ours->square_mm / ours->count),
                     .error_peer = sqrt(peer->square_mm / peer->count),
                     .runs = ROBOTS};
    bench_print(b, &row);
}

static void set(const bench *b, const char *name, const robot_errors *errors)
{
    tally ours = {0}, plain = {0}, opencv = {0};
    if (!bench_wanted(b, name)) return;
    for (int i = 0; i < ROBOTS; i++) {
        hand_eye_scene s;
        simulate_hand_eye(&s, TD_EYE_IN_HAND, VIEWS, errors, 500 + (uint64_t)i);
        run_ours(&ours, &s, TD_ROBOT_AUTO);
        run_ours(&plain, &s, TD_ROBOT_EXACT);
        run_opencv(&opencv, &s);
    }
    if (!ours.count || !plain.count || !opencv.count) return;
    print(b, name, &ours, &opencv, "OpenCV's best (all run)");
    print(b, name, &ours, &plain, "plain least squares");
}

void bench_hand_eye(const bench *b)
{
    const robot_errors noise = {.robot_rad = 5e-4, .robot_m = 2.5e-4, .sight = 1};
    const robot_errors field = {
        .robot_rad = 3e-4, .robot_m = 6e-5, .sight = 1, .field_rad = 6e-4, .field_m = 3e-4, .length_m = 0.25};
    set(b, "hand-eye 30 views", &noise);
    set(b, "hand-eye 30 views, field", &field);
}
