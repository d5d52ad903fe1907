/* The visual servo's law beside vpServo::computeControlLaw: four points, a free camera, features that change
 * every time; from features to the camera's twist.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/linalg.h"
#include "core/random.h"
#include "servo/visual_servo_internal.h"
#include "tests/bench/bench.h"
#include "tests/servo/visual_servo_visp.h"

enum { VIEWS = 64, REPEATS = 20, RUNS = 31, POINTS = 4 };

typedef struct work {
    visp_task task[VIEWS];
    td_servo_features features[VIEWS];
    td_visual_servo_options options;
    visp_servo *theirs;
    double ours_rate[VIEWS][6], visp_rate[VIEWS][6];
} work;

/* The tutorial's goal, seen from somewhere near. */
static void make(work *w)
{
    static const double corner[POINTS][2] = {{-0.1, -0.1}, {0.1, -0.1}, {0.1, 0.1}, {-0.1, 0.1}};
    td_random random = td_random_seed(1, 1);
    memset(w, 0, sizeof *w);
    w->options = td_visual_servo_options_default();
    w->options.gain_zero = 4, w->options.gain_infinity = 0.4, w->options.gain_slope = 30;
    for (int v = 0; v < VIEWS; v++) {
        double xi[6];
        for (int k = 0; k < 6; k++) xi[k] = 0.2 * td_random_normal(&random);
        const td_pose goal = {.q = {1, 0, 0, 0}, .t = {0, 0, 0.75}}, at = td_pose_perturb(&goal, xi);
        visp_task *t = w->task + v;
        *t = (visp_task){.mode = VISP_CAMERA,
                         .interaction = VISP_CURRENT,
                         .points = POINTS,
                         .joints = 6,
                         .gain = {4, 0.4, 30}};
        w->features[v] = (td_servo_features){.count = POINTS, .radius_m = 1};
        for (int i = 0; i < POINTS; i++) {
            const double p[3] = {corner[i][0], corner[i][1], 0};
            double c[3];
            td_pose_transform(c, &at, p);
            const double now[3] = {c[0] / c[2], c[1] / c[2], c[2]},
                         there[3] = {p[0] / 0.75, p[1] / 0.75, 0.75};
            memcpy(t->now[i], now, sizeof now);
            memcpy(t->goal[i], there, sizeof there);
            memcpy(w->features[v].now[i], now, sizeof now);
            memcpy(w->features[v].goal[i], there, sizeof there);
        }
    }
}

static void run_ours(void *user)
{
    work *w = user;
    const td_task_damping damping = {w->options.singular_share, 0};
    for (int r = 0; r < REPEATS; r++)
        for (int v = 0; v < VIEWS; v++) {
            double l[12 * POINTS], e[2 * POINTS];
            td_task_inverse inverse;
            const int rows = td_servo_error_of(e, w->features + v);
            td_servo_interaction(l, w->features + v);
            td_task_invert(&inverse, l, e, rows, 6, NULL, &damping);
            const double gain = td_servo_gain(&w->options, inverse.step, 6);
            for (int k = 0; k < 6; k++) w->ours_rate[v][k] = -gain * inverse.step[k];
        }
}

static void run_visp(void *user)
{
    work *w = user;
    for (int r = 0; r < REPEATS; r++)
        for (int v = 0; v < VIEWS; v++) visp_servo_move(w->theirs, w->visp_rate[v], w->task + v);
}

void bench_servo(const bench *b)
{
    static work w;
    static const char name[] = "servo control law";
    if (!bench_wanted(b, name)) return;
    make(&w);
    w.theirs = visp_servo_new(w.task);
    const double ours = bench_time(run_ours, &w, RUNS), theirs = bench_time(run_visp, &w, RUNS);
    double most = 0;
    for (int v = 0; v < VIEWS; v++)
        for (int k = 0; k < 6; k++) most = fmax(most, fabs(w.ours_rate[v][k] - w.visp_rate[v][(k + 3) % 6]));
    bench_print(b, &(bench_row){.name = name,
                                .unit = "us",
                                .ours = ours * 1e6 / REPEATS / VIEWS,
                                .peer = theirs * 1e6 / REPEATS / VIEWS,
                                .peer_name = "ViSP vpServo",
                                .error_unit = "1/s apart at most",
                                .error_ours = most,
                                .error_peer = 0,
                                .runs = RUNS});
    visp_servo_free(w.theirs);
}
