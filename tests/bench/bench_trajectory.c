/* Planning of motions of the excavator, per segment from rest to rest or between vias, beside what Ruckig's
 * makers and users measured for four joints with these limits of speed and acceleration: from state to state,
 * without flows, paths or via points (which it leaves to a service in the network). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "servo/trajectory_generator.h"
#include "tests/bench/bench.h"

enum { TASKS = 64, RUNS = 31, JOINTS = 4, VIAS = 5, STEPS = 20000 };
static const double RUCKIG_US = 4.6;

enum { PLAIN, FLOWS, THROUGH, TOOL, DURATION };
static const char *const NAMES[] = {"trajectory joints, no flows", "trajectory joints",
                                    "trajectory joints, 5 vias", "trajectory tool", "trajectory duration"};

typedef struct work {
    td_robot *robot, *plain; /* with and without its cylinders */
    td_tool tool;
    double q[TASKS][JOINTS];
    td_via joints[TASKS][VIAS], near[TASKS]; /* vias of joints; of the tool, near q */
    int failed;
} work;

static void draw(double *q, const td_robot *r, const double *near, double part, td_random *random)
{
    for (int k = 0; k < JOINTS; k++) {
        const bool bounded = isfinite(r->joint[k].lower);
        double low = bounded ? r->joint[k].lower : -1, high = bounded ? r->joint[k].upper : 1;
        const double width = high - low;
        if (near) low = fmax(low, near[k] - part * width), high = fmin(high, near[k] + part * width);
        q[k] = low + (high - low) * td_random_uniform(random);
    }
}

static void make(work *w)
{
    td_random random = td_random_seed(1, 1);
    w->tool = (td_tool){td_robot_find_link(w->robot, "bucket_tip"),
                        td_pose_identity(),
                        4,
                        {TD_TOOL_X, TD_TOOL_Y, TD_TOOL_Z, TD_TOOL_PITCH}};
    for (int i = 0; i < TASKS; i++) {
        td_trajectory *t = NULL;
        draw(w->q[i], w->robot, NULL, 1, &random);
        for (int v = 0; v < VIAS; v++) {
            w->joints[i][v].tolerance_m = w->joints[i][v].tolerance_rad = 0.05;
            draw(w->joints[i][v].value, w->robot, NULL, 1, &random);
        }
        do { /* until the line stays within reach */
            double goal[JOINTS], pose[TD_TOOL_ROWS];
            draw(goal, w->robot, w->q[i], 0.3, &random);
            td_tool_pose(pose, w->robot, &w->tool, goal);
            for (int k = 0; k < JOINTS; k++) w->near[i].value[k] = pose[w->tool.row[k]];
        } while (td_trajectory_plan(&t, NULL, w->robot, &w->tool, w->q[i], w->near + i, 1, NULL, NULL) !=
                 TD_OK);
        td_trajectory_free(&t);
    }
}

static void plan_all(work *w, const td_robot *robot, const td_tool *tool, int vias)
{
    for (int i = 0; i < TASKS; i++) {
        td_trajectory *t = NULL;
        const td_via *via = tool ? w->near + i : w->joints[i];
        w->failed +=
            td_trajectory_plan(&t, NULL, robot, tool, w->q[i], via, (size_t)vias, NULL, NULL) != TD_OK;
        td_trajectory_free(&t);
    }
}

static void plan_plain(void *user)
{
    work *w = user;
    plan_all(w, w->plain, NULL, 1);
}

static void plan_flows(void *user)
{
    work *w = user;
    plan_all(w, w->robot, NULL, 1);
}

static void plan_through(void *user)
{
    work *w = user;
    plan_all(w, w->robot, NULL, VIAS);
}

static void plan_tool(void *user)
{
    work *w = user;
    plan_all(w, w->robot, &w->tool, 1);
}

static void print_time(const bench *b, work *w, int name, bench_function function, int segments)
{
    if (!bench_wanted(b, NAMES[name])) return;
    w->failed = 0;
    const double seconds = bench_time(function, w, RUNS);
    bench_print(b, &(bench_row){.name = NAMES[name],
                                .unit = "us",
                                .ours = seconds * 1e6 / TASKS / segments,
                                .peer = w->failed ? NAN : RUCKIG_US,
                                .peer_name = "Ruckig, published",
                                .remark = "some were refused",
                                .runs = RUNS});
}

/* The shortest time on a straight line of the joints without flows: s'' up to u, s' up to v. */
static double shortest(const td_robot *robot, const double *q, const double *goal)
{
    double u = INFINITY, v = INFINITY;
    for (int k = 0; k < JOINTS; k++) {
        u = fmin(u, robot->joint[k].acceleration / fabs(goal[k] - q[k]));
        v = fmin(v, robot->joint[k].speed / fabs(goal[k] - q[k]));
    }
    return v * v / u < 1 ? 1 / v + v / u : 2 / sqrt(u);
}

static void print_duration(const bench *b, const work *w)
{
    if (!bench_wanted(b, NAMES[DURATION])) return;
    double ours = 0, best = 0, most = 0;
    for (int i = 0; i < TASKS; i++) {
        td_trajectory *t = NULL;
        if (td_trajectory_plan(&t, NULL, w->plain, NULL, w->q[i], w->joints[i], 1, NULL, NULL) != TD_OK)
            return;
        const double bound = shortest(w->plain, w->q[i], w->joints[i][0].value);
        ours += td_trajectory_duration(t);
        best += bound;
        most = fmax(most, td_trajectory_duration(t) / bound - 1);
        td_trajectory_free(&t);
    }
    bench_print(b, &(bench_row){.name = NAMES[DURATION],
                                .unit = "s",
                                .ours = ours / TASKS,
                                .peer = best / TASKS,
                                .peer_name = "the limits' bound",
                                .error_unit = "of it at most",
                                .error_ours = most,
                                .error_peer = 0,
                                .runs = 1});
}

static bool any_wanted(const bench *b)
{
    for (size_t i = 0; i < sizeof NAMES / sizeof *NAMES; i++)
        if (bench_wanted(b, NAMES[i])) return true;
    return false;
}

void bench_trajectory(const bench *b)
{
    char path[4096];
    td_error error = {0};
    if (!any_wanted(b)) return;
    work *w = calloc(1, sizeof *w);
    if (!w) return;
    snprintf(path, sizeof path, "%s/datasets/zx200/zx200.urdf", b->source);
    if (td_robot_read(&w->robot, path, &error) == TD_OK && td_robot_read(&w->plain, path, &error) == TD_OK) {
        w->plain->cylinder_count = 0;
        make(w);
        print_time(b, w, PLAIN, plan_plain, 1);
        print_time(b, w, FLOWS, plan_flows, 1);
        print_time(b, w, THROUGH, plan_through, VIAS);
        print_time(b, w, TOOL, plan_tool, 1);
        print_duration(b, w);
    } else {
        fprintf(stderr, "teledimos-bench: %s\n", error.message);
    }
    td_robot_free(&w->robot);
    td_robot_free(&w->plain);
    free(w);
}
