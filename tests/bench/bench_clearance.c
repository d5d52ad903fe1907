/* A motion of the excavator checked against the map: 10 s, readings at 10 Hz, over 24 x 24 m in cells of 24
 * cm to 1.2 cm, with sigma of map, rig, vehicle and joints.
 *
 *   clearance carry    a swing with a load: 0.4 m above the ground at the lowest
 *   clearance skim     the same a little above the ground: contact is possible at many places
 *   clearance update   the pyramid after 1 x 1 m has been dug */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "sim/clearance.h"
#include "tests/bench/bench.h"

enum { READINGS = 101, RUNS = 9 };

typedef struct setting {
    td_robot *robot;
    td_elevation *ground;
    td_clearance_map *map;
    td_clearance_motion motion;
    td_clearance result;
    double time[READINGS], q[READINGS * 4];
    double vehicle[36], calibration[36];
    bool failed;
} setting;

static void check(void *user)
{
    setting *s = user;
    td_clearance_options options = td_clearance_options_default();
    options.correlation_m = 0.1;
    options.step_m = 0.1;
    if (td_clearance_check(&s->result, s->map, &s->motion, &options, NULL) != TD_OK) s->failed = true;
}

static void update(void *user)
{
    setting *s = user;
    const int cells = (int)ceil(1 / s->ground->cell_m), middle = s->ground->columns / 2;
    if (td_clearance_map_update(s->map, middle, middle, cells, cells, NULL) != TD_OK) s->failed = true;
}

static bool make_ground(setting *s, int n)
{
    const double origin[2] = {-12, -12};
    if (td_elevation_new(&s->ground, n, n, 24.0 / n, origin, "site", NULL) != TD_OK) return false;
    for (int r = 0; r < n; r++)
        for (int c = 0; c < n; c++) {
            const double x = 24.0 * c / n, y = 24.0 * r / n;
            s->ground->height[(size_t)r * n + c] =
                (float)(0.1 * sin(0.7 * x) * cos(0.5 * y) + 0.03 * sin(4 * x + y) - 0.13);
            s->ground->sigma[(size_t)r * n + c] = 0.02F;
        }
    return td_clearance_map_new(&s->map, s->ground, NAN, NULL) == TD_OK;
}

static void make_motion(setting *s)
{
    static const double zero[4] = {2e-3, 2e-3, 2e-3, 2e-3};
    for (int i = 0; i < READINGS; i++) {
        const double part = (double)i / (READINGS - 1), ease = 0.5 - 0.5 * cos(3.14159265358979 * part);
        const double q[4] = {-0.8 + 1.6 * ease, -0.42 + 0.05 * sin(6 * part), 1.5, 0.9};
        s->time[i] = 10 * part;
        for (int j = 0; j < 4; j++) s->q[4 * i + j] = q[j];
    }
    for (int k = 0; k < 6; k++) {
        s->vehicle[7 * k] = k < 3 ? 4e-6 : 4e-4;
        s->calibration[7 * k] = k < 3 ? 1e-6 : 1e-4;
    }
    s->motion = (td_clearance_motion){.robot = s->robot,
                                      .site_from_vehicle = td_pose_identity(),
                                      .vehicle_covariance = s->vehicle,
                                      .map_covariance = s->calibration,
                                      .sigma_zero = zero,
                                      .count = READINGS,
                                      .time_s = s->time,
                                      .q = s->q};
}

static const char *const rows[3] = {"carry", "skim", "update"};

static void print_row(const bench *b, setting *s, int what, int n)
{
    char name[96], remark[192];
    snprintf(name, sizeof name, "clearance %s, %d^2 cells", rows[what], n);
    if (!bench_wanted(b, name)) return;
    const double time = bench_time(what == 2 ? update : check, s, RUNS);
    const td_clearance *c = &s->result;
    snprintf(remark, sizeof remark,
             "%zu samples, %zu points near, clearance %.2f m, probability %.2g +- %.1g", c->samples,
             c->points, c->nearest.clearance_m, c->probability, c->sigma_probability);
    const bench_row row = {.name = name,
                           .unit = "ms",
                           .ours = s->failed ? NAN : 1e3 * time,
                           .peer = NAN,
                           .peer_name = "none",
                           .runs = RUNS,
                           .remark = what == 2 ? NULL : remark};
    bench_print(b, &row);
}

/* All rows of one size. The vehicle's height makes the clearance. */
static void print_size(const bench *b, setting *s, int n)
{
    static const double clearance[2] = {0.4, 0.08};
    if (make_ground(s, n)) {
        s->motion.site_from_vehicle = td_pose_identity();
        check(s);
        const double level = s->result.nearest.clearance_m;
        for (int what = 0; what < 3; what++) {
            if (what < 2) s->motion.site_from_vehicle.t[2] = clearance[what] - level;
            print_row(b, s, what, n);
        }
    }
    td_clearance_map_free(&s->map);
    td_elevation_free(&s->ground);
}

static bool size_wanted(const bench *b, int n)
{
    bool wanted = false;
    for (int what = 0; what < 3; what++) {
        char name[96];
        snprintf(name, sizeof name, "clearance %s, %d^2 cells", rows[what], n);
        wanted |= bench_wanted(b, name);
    }
    return wanted;
}

void bench_clearance(const bench *b)
{
    static const int cells[] = {100, 250, 500, 1000, 2000};
    setting *s = calloc(1, sizeof *s);
    char path[1024];
    if (!s) return;
    snprintf(path, sizeof path, "%s/datasets/zx200/zx200.urdf", b->source);
    for (size_t i = 0; i < sizeof cells / sizeof *cells; i++) {
        if (!size_wanted(b, cells[i])) continue;
        if (!s->robot && td_robot_read(&s->robot, path, NULL) != TD_OK) break;
        make_motion(s);
        print_size(b, s, cells[i]);
    }
    td_robot_free(&s->robot);
    free(s);
}
