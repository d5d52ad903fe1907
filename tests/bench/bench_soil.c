/* One update of the soil while a bucket digs, curls, lifts and dumps, on maps of several sizes: the cost must
 * not grow with the map. Median of all updates, and the slowest hundredth. There is no peer in Debian to run
 * beside it; the goal is 0.3 ms at 5 cm. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "sim/soil.h"
#include "tests/bench/bench.h"

enum { CYCLES = 15, DIG = 60, CURL = 25, DUMP = 40, UPDATES = CYCLES * (DIG + CURL + DUMP) };
static const double CELL_M = 0.05, DEGREE = 0.017453292519943295;

static td_soil *make_soil(int size, const char *source, td_error *error)
{
    char path[4096];
    td_elevation *map = NULL;
    td_soil *soil = NULL;
    td_soil_preset preset;
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    const double origin[2] = {-CELL_M * size / 2, -CELL_M * size / 2};
    snprintf(path, sizeof path, "%s/datasets/soils/dirt_1.yaml", source);
    if (td_soil_preset_read(&preset, path, error) != TD_OK) return NULL;
    if (td_elevation_new(&map, size, size, CELL_M, origin, "site", error) != TD_OK) return NULL;
    for (int i = 0; i < size * size; i++)
        map->height[i] =
            (float)(0.1 * sin((i % size - size / 2) * 0.04) + 0.1 * cos((i / size - size / 2) * 0.05));
    td_soil_new(&soil, map, &preset, &bucket, NULL, error);
    td_elevation_free(&map);
    return soil;
}

/* The edge at (x, y, z), the tip pitched below forward. */
static td_pose pose_at(double x, double y, double z, double pitch_deg)
{
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    const double turn[3] = {0, pitch_deg * DEGREE, 0};
    td_pose pose = td_pose_identity();
    double edge[3];
    td_rotation_exp(pose.q, turn);
    td_pose_rotate(edge, &pose, bucket.edge);
    pose.t[0] = x - edge[0], pose.t[1] = y - edge[1], pose.t[2] = z - edge[2];
    return pose;
}

/* A cycle: 1.8 m at 0.35 m of depth, curl and lift, dump 1.6 m to the side. */
static td_pose pose_of(int step, double y)
{
    if (step < DIG) return pose_at(0.9 - 1.8 * step / DIG, y, fmax(-0.35, 0.2 - 0.05 * step), 135);
    if (step < DIG + CURL) {
        const double u = (double)(step - DIG + 1) / CURL;
        return pose_at(-0.9, y, -0.35 + 1.8 * u, 135 + 45 * u);
    }
    const double u = fmin(1, (double)(step - DIG - CURL + 1) / (DUMP / 2));
    return pose_at(-0.9 + 0.8 * u, y + 1.6 * u, 1.45, 180 - 120 * u);
}

/* Of this thread: other work on the machine is no part of the cost. */
static double cpu_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void print_rows(const bench *b, int size)
{
    char name[2][64];
    td_error error = {0};
    double *took = malloc(UPDATES * sizeof *took);
    td_soil *soil = make_soil(size, b->source, &error);
    snprintf(name[0], sizeof name[0], "soil update %d x %d", size, size);
    snprintf(name[1], sizeof name[1], "soil update %d x %d (99 %%)", size, size);
    if (took && soil) {
        int n = 0;
        const int64_t total = td_soil_balance_of(soil).total_mg;
        for (int cycle = 0; cycle < CYCLES; cycle++) {
            const double y = 0.6 * (cycle % 3 - 1) - 0.5;
            for (int step = 0; step < DIG + CURL + DUMP; step++) {
                const td_pose pose = pose_of(step, y);
                if (step == 0) td_soil_place(soil, &pose, &error);
                const double start = cpu_ms();
                if (td_soil_step(soil, &pose, 0.02, &error) == TD_OK) took[n++] = cpu_ms() - start;
            }
        }
        qsort(took, (size_t)n, sizeof *took, ascending);
        const double lost = fabs((double)(td_soil_balance_of(soil).total_mg - total));
        for (int k = 0; k < 2; k++) {
            const bench_row row = {.name = name[k],
                                   .unit = "ms",
                                   .ours = took[k ? n * 99 / 100 : n / 2],
                                   .peer = NAN,
                                   .peer_name = "none",
                                   .error_unit = "mg lost",
                                   .error_ours = lost,
                                   .error_peer = NAN,
                                   .runs = n,
                                   .remark = n == UPDATES ? "no peer; the goal is 0.3 ms" : error.message};
            bench_print(b, &row);
        }
    } else {
        fprintf(stderr, "teledimos-bench: %s\n", error.message);
    }
    td_soil_free(&soil);
    free(took);
}

void bench_soil(const bench *b)
{
    static const int sizes[] = {100, 320, 500, 1000, 2000};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        char name[64];
        snprintf(name, sizeof name, "soil update %d x %d", sizes[i], sizes[i]);
        if (bench_wanted(b, name)) print_rows(b, sizes[i]);
    }
}
