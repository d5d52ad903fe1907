/* The closed loop's cost: what is between a pair of images at 640 x 480 and the next motion known to be
 * clear, on all processors, and simulating ahead with soil.
 *
 *   loop ...            match, fuse, take the map, and check a motion of 10 s against it; the images of
 *                       datasets/site-dig at half their size are rendered before, which is not counted
 *   loop ahead ...      datasets/zx200/dig.yaml as `teledimos simulate` runs it, planning and checks of its
 *                       motions within; the map is made before */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/look.h"
#include "sim/clearance.h"
#include "tests/bench/bench.h"

enum { LOOKS = 9, READINGS = 101, AHEAD_RUNS = 3 };
static const double CELL_M = 0.06;
static const double REGION[4] = {-4, -10, 13, 10}; /* as in dig.yaml */

typedef struct stages {
    double all[LOOKS], match[LOOKS], fuse[LOOKS], map[LOOKS], check[LOOKS];
} stages;

/* Half the pixels each way: pixel (0, 0) is a centre. */
static void halve(td_rig *rig)
{
    for (int i = 0; i < rig->count; i++) {
        td_camera *c = &rig->camera[i].camera;
        c->width /= 2, c->height /= 2;
        c->parameter[0] /= 2, c->parameter[1] /= 2;
        c->parameter[2] = (c->parameter[2] + 0.5) / 2 - 0.5;
        c->parameter[3] = (c->parameter[3] + 0.5) / 2 - 0.5;
    }
}

/* A swing over the ground with a load, 10 readings a second. */
static bool check_motion(const td_elevation *map, const td_scene *scene)
{
    static double time[READINGS], q[READINGS * 4];
    td_clearance_options options = td_clearance_options_default();
    td_clearance_map *pyramid = NULL;
    td_clearance clear;
    for (int i = 0; i < READINGS; i++) {
        const double part = (double)i / (READINGS - 1), ease = 0.5 - 0.5 * cos(3.14159265358979 * part);
        const double at[4] = {-0.8 + 1.6 * ease, -0.5 + 0.05 * sin(6 * part), 1.3, 0.9};
        time[i] = 10 * part;
        memcpy(q + 4 * i, at, sizeof at);
    }
    const td_clearance_motion motion = {.robot = scene->robot,
                                        .site_from_vehicle = scene->site_from_vehicle,
                                        .count = READINGS,
                                        .time_s = time,
                                        .q = q};
    const bool ok = td_clearance_map_new(&pyramid, map, 0.05, NULL) == TD_OK &&
                    td_clearance_check(&clear, pyramid, &motion, &options, NULL) == TD_OK;
    td_clearance_map_free(&pyramid);
    return ok;
}

static bool once(stages *s, int i, look *l, td_scene_file *file)
{
    const td_scene_frame *frame = &file->frame[(size_t)i % file->frame_count];
    td_pose site_from_rig;
    td_elevation *map = NULL;
    look_result seen;
    td_scene_pose(file, (size_t)i % file->frame_count, &site_from_rig);
    if (look_now(&seen, l, &frame->site_from_vehicle, frame->q, NULL, (uint64_t)i, i, NULL) != TD_OK)
        return false;
    const double begun = bench_now();
    if (look_map(&map, l, NULL) != TD_OK) return false;
    const double taken = bench_now();
    const bool ok = check_motion(map, &file->scene);
    td_elevation_free(&map);
    s->match[i] = seen.match_s;
    s->fuse[i] = seen.fuse_s;
    s->map[i] = taken - begun;
    s->check[i] = bench_now() - taken;
    s->all[i] = seen.match_s + seen.fuse_s + s->map[i] + s->check[i];
    return ok;
}

static bool looks(stages *s, const bench *b)
{
    char path[4096];
    td_scene_file *file = NULL;
    look *l = NULL;
    look_options o = look_options_default();
    snprintf(path, sizeof path, "%s/datasets/site-dig", b->source);
    if (td_scene_read(&file, path, NULL) != TD_OK) return false;
    halve(file->rig);
    file->rig->has_vehicle = true;
    file->rig->vehicle_from_rig = file->mount_from_rig;
    o.fusion.cell_m = CELL_M;
    memcpy(o.fusion.region, REGION, sizeof REGION);
    bool ok = look_new(&l, &file->scene, file->rig, file->rig, file->mount_link, &o, NULL) == TD_OK;
    for (int i = 0; i < LOOKS && ok; i++) ok = once(s, i, l, file);
    look_free(&l);
    td_scene_free(&file);
    return ok;
}

static void print_loop(const bench *b)
{
    static const char name[] = "loop at 640x480";
    stages s;
    char remark[160] = "";
    if (!bench_wanted(b, name)) return;
    const bool ok = looks(&s, b);
    if (ok)
        snprintf(remark, sizeof remark, "ms: match %.0f, fuse %.0f, take the map %.1f, check a motion %.1f",
                 1e3 * bench_median(s.match, LOOKS), 1e3 * bench_median(s.fuse, LOOKS),
                 1e3 * bench_median(s.map, LOOKS), 1e3 * bench_median(s.check, LOOKS));
    bench_print(b, &(bench_row){.name = name,
                                .unit = "1/s",
                                .ours = ok ? 1 / bench_median(s.all, LOOKS) : NAN,
                                .peer = NAN,
                                .peer_name = "none",
                                .runs = LOOKS,
                                .remark = remark});
}

/* What the program says of a run. */
static double ahead(const bench *b, const char *folder)
{
    char command[9000];
    snprintf(command, sizeof command, "'%s' simulate '%s/datasets/zx200/dig.yaml' -o '%s' -q --json",
             b->program, b->source, folder);
    FILE *out = popen(command, "r");
    if (!out) return NAN;
    json_t *root = json_loadf(out, 0, NULL);
    const double factor = json_number_value(json_object_get(root, "real_time_factor"));
    json_decref(root);
    return pclose(out) == 0 && factor > 0 ? factor : NAN;
}

static void print_ahead(const bench *b)
{
    static const char name[] = "loop ahead, with soil";
    char folder[] = "/tmp/teledimos-bench-XXXXXX", command[64];
    double factor[AHEAD_RUNS];
    if (!bench_wanted(b, name) || !mkdtemp(folder)) return;
    for (int i = 0; i < AHEAD_RUNS; i++) factor[i] = ahead(b, folder);
    snprintf(command, sizeof command, "rm -r '%s'", folder);
    const bool gone = system(command) == 0;
    bench_print(b, &(bench_row){.name = name,
                                .unit = "1/s",
                                .ours = bench_median(factor, AHEAD_RUNS),
                                .peer = NAN,
                                .peer_name = "none",
                                .runs = AHEAD_RUNS,
                                .remark = gone ? "seconds of a whole session in a second of one processor"
                                               : "its folder is left in /tmp"});
}

void bench_loop(const bench *b)
{
    print_loop(b);
    print_ahead(b);
}
