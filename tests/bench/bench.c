/* teledimos-bench [--json] [FILTER]: runs the rows whose names hold FILTER. */
#include "tests/bench/bench.h"

#include <fcntl.h>
#include <math.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <jansson.h>

#include "core/linalg.h"

extern char **environ;
pid_t wait4(pid_t, int *, int, struct rusage *);

double bench_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double bench_median(double *x, size_t n)
{
    qsort(x, n, sizeof *x, compare_doubles);
    return n % 2 ? x[n / 2] : (x[n / 2 - 1] + x[n / 2]) / 2;
}

double bench_time(bench_function function, void *user, int runs)
{
    double times[100];
    function(user);
    for (int i = 0; i < runs; i++) {
        double start = bench_now();
        function(user);
        times[i] = bench_now() - start;
    }
    return bench_median(times, (size_t)runs);
}

static bool run_command(const char *const *argv, double *peak_mb)
{
    posix_spawn_file_actions_t actions;
    pid_t child;
    int status;
    struct rusage usage;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
    posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
    int failed = posix_spawnp(&child, argv[0], &actions, NULL, (char *const *)(const void *)argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    if (failed || wait4(child, &status, 0, &usage) != child) return false;
    if (peak_mb) *peak_mb = fmax(*peak_mb, (double)usage.ru_maxrss / 1024);
    return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

double bench_command(const char *const *argv, int runs, double *peak_mb)
{
    double times[100];
    if (!run_command(argv, peak_mb)) return -1;
    for (int i = 0; i < runs; i++) {
        double start = bench_now();
        if (!run_command(argv, peak_mb)) return -1;
        times[i] = bench_now() - start;
    }
    return bench_median(times, (size_t)runs);
}

bool bench_wanted(const bench *b, const char *name)
{
    return !b->filter || strstr(name, b->filter);
}

static json_t *number(double x)
{
    return isfinite(x) ? json_real(x) : json_null();
}

void bench_print(const bench *b, const bench_row *row)
{
    double ratio = strcmp(row->unit, "1/s") == 0 ? row->ours / row->peer : row->peer / row->ours;
    if (b->json) {
        json_t *line = json_object();
        json_object_set_new(line, "name", json_string(row->name));
        json_object_set_new(line, "unit", json_string(row->unit));
        json_object_set_new(line, "ours", number(row->ours));
        json_object_set_new(line, "peer", number(row->peer));
        json_object_set_new(line, "peer_name", json_string(row->peer_name));
        json_object_set_new(line, "ratio", number(ratio));
        json_object_set_new(line, "error_unit", row->error_unit ? json_string(row->error_unit) : json_null());
        json_object_set_new(line, "error_ours", row->error_unit ? number(row->error_ours) : json_null());
        json_object_set_new(line, "error_peer", row->error_unit ? number(row->error_peer) : json_null());
        json_object_set_new(line, "runs", json_integer(row->runs));
        if (row->remark) json_object_set_new(line, "remark", json_string(row->remark));
        json_dumpf(line, stdout, JSON_COMPACT | JSON_REAL_PRECISION(6));
        putchar('\n');
        json_decref(line);
    } else {
        printf("%-30s %10.4g %-5s", row->name, row->ours, row->unit);
        if (isfinite(row->peer))
            printf("  %10.4g %-26s ratio %6.2f", row->peer, row->peer_name, ratio);
        else
            printf("  %10s %-26s %s", "–", row->peer_name, row->remark ? row->remark : "");
        if (row->error_unit)
            printf("   error %.4g against %.4g %s", row->error_ours, row->error_peer, row->error_unit);
        printf("   (%d runs)\n", row->runs);
    }
    fflush(stdout);
}

int main(int argc, char **argv)
{
    bench b = {.program = TD_BENCH_PROGRAM, .source = TD_SOURCE_DIR};
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--json") == 0) {
            b.json = true;
        } else if (strcmp(argv[i], "--help") == 0) {
            printf("teledimos-bench [--json] [FILTER]\nRuns the benchmark rows whose names hold FILTER; "
                   "ratio above 1: ours is "
                   "better.\n");
            return 0;
        } else {
            b.filter = argv[i];
        }
    }
    td_linalg_single_thread();
    bench_calibrate(&b);
    bench_boards(&b);
    bench_render(&b);
    bench_clearance(&b);
    bench_charuco(&b);
    bench_dense(&b);
    bench_hand_eye(&b);
    bench_interest(&b);
    bench_map(&b);
    bench_next_view(&b);
    bench_tags(&b);
    bench_vehicle(&b);
    bench_match(&b);
    bench_tin(&b);
    bench_dynamics(&b);
    bench_integrator(&b);
    bench_clock(&b);
    bench_world(&b);
    bench_loop(&b);
    bench_soil(&b);
    bench_servo(&b);
    bench_trajectory(&b);
    bench_panel(&b);
    return 0;
}
