/* How late the clock's ticks come, on this machine as loaded as it is: shares and maximum of the lateness
 * against the grid, misses (later than 100 us at 1 kHz, than 5 ms at 20 Hz). Beside it a loop of plain sleeps
 * of one period, whose lateness adds up. At the usual priority and, where it is permitted, as SCHED_FIFO. 60
 * s at 1 kHz with TELEDIMOS_FULL=1, else 5 s. */
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "sim/clock.h"
#include "tests/bench/bench.h"

static const double SECOND = 1e9;

/* Lateness against the grid of sleeps of one period each, in the clock's own buckets: a clock whose sleep
 * does not look at the deadline would be the same. */
static double sleeps_late_us(int64_t period_ns, int ticks, double share)
{
    double *late = calloc((size_t)ticks, sizeof *late);
    const struct timespec period = {.tv_nsec = (long)period_ns};
    const double start = bench_now();
    if (!late) return NAN;
    for (int i = 0; i < ticks; i++) {
        nanosleep(&period, NULL);
        late[i] = 1e6 * (bench_now() - start) - 1e-3 * (double)period_ns * (i + 1);
    }
    bench_median(late, (size_t)ticks); /* sorts */
    const double found = late[(int)ceil(share * ticks) - 1];
    free(late);
    return found;
}

static void rows(const bench *b, const char *name, int64_t period_ns, int64_t tolerance_ns, double seconds)
{
    const int ticks = (int)(seconds * SECOND / (double)period_ns);
    td_clock_options options = td_clock_options_default();
    td_clock clock;
    options.period_ns = period_ns;
    options.tolerance_ns = tolerance_ns;
    options.policy = TD_MISS_CATCH_UP;
    if (td_clock_start(&clock, &options, NULL) != TD_OK) return;
    for (int i = 0; i < ticks; i++) td_clock_wait(&clock, NULL, NULL);
    const td_clock_counts *c = &clock.counts;
    const struct {
        const char *what;
        double ours;
    } row[] = {{"p50", 1e-3 * (double)td_clock_late(c, 0.5)},
               {"p99", 1e-3 * (double)td_clock_late(c, 0.99)},
               {"max", 1e-3 * (double)c->late_max_ns}};
    const double peer = sleeps_late_us(period_ns, ticks < 2000 ? ticks : 2000, 0.99);
    for (int i = 0; i < 3; i++) {
        char text[64];
        snprintf(text, sizeof text, "%s %s", name, row[i].what);
        const bench_row r = {.name = text,
                             .unit = "us",
                             .ours = row[i].ours,
                             .peer = i == 1 ? peer : NAN,
                             .peer_name = i == 1 ? "sleeps of a period" : "none",
                             .runs = ticks};
        bench_print(b, &r);
    }
    char text[64];
    snprintf(text, sizeof text, "%s missed", name);
    const bench_row r = {.name = text,
                         .unit = "-",
                         .ours = (double)c->misses,
                         .peer = NAN,
                         .peer_name = "none",
                         .runs = ticks};
    bench_print(b, &r);
}

void bench_clock(const bench *b)
{
    const char *full = getenv("TELEDIMOS_FULL");
    const double seconds = full && strcmp(full, "1") == 0 ? 60 : 5;
    const struct sched_param usual = {0}, first = {.sched_priority = 10};
    if (!bench_wanted(b, "clock")) return;
    rows(b, "clock 1 kHz", 1000000, 100000, seconds);
    rows(b, "clock 20 Hz", 50000000, 5000000, 5);
    if (sched_setscheduler(0, SCHED_FIFO, &first) != 0) {
        const bench_row r = {.name = "clock 1 kHz FIFO",
                             .unit = "us",
                             .ours = NAN,
                             .peer = NAN,
                             .peer_name = "none",
                             .remark = "SCHED_FIFO is not permitted here"};
        bench_print(b, &r);
        return;
    }
    rows(b, "clock 1 kHz FIFO", 1000000, 100000, seconds);
    sched_setscheduler(0, SCHED_OTHER, &usual);
}
