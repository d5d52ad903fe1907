/* Pacing by real time: a tick each period on the monotonic clock, each deadline checked (the paper: 50 ms for
 * the display, 1 ms for the control; a missed deadline ends the run).
 *
 *   td_clock_start(&clock, &options, &error);
 *   while (running) { work(); if (td_clock_wait(&clock, &late_ns, &error) != TD_OK) break; }
 *
 * Deadlines lie on a grid, start + k period, so that lateness does not add up. Tick k is missed when
 * td_clock_wait returns later than its deadline by more than the tolerance: the work took too long (an
 * overrun), or the system woke the process late. */
#ifndef TELEDIMOS_SIM_CLOCK_H
#define TELEDIMOS_SIM_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/log.h"
#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Nanoseconds since some start. NULL functions: CLOCK_MONOTONIC. A test gives its own. */
typedef struct td_clock_source {
    int64_t (*now)(void *self);
    void (*sleep_until)(void *self, int64_t time_ns); /* may return early */
    void *self;
} td_clock_source;

typedef enum td_miss_policy {
    TD_MISS_STOP,     /* td_clock_wait fails, from then on */
    TD_MISS_CATCH_UP, /* counted; the grid stays, so that late ticks follow at once until it is reached again
                       */
    TD_MISS_SLIP      /* counted; the grid moves by the lateness: the run falls behind the wall's clock */
} td_miss_policy;

typedef struct td_clock_options {
    int64_t period_ns;    /* 50 ms */
    int64_t tolerance_ns; /* 5 ms */
    td_miss_policy policy;
    td_clock_source source;
    td_log log; /* warned at the 1st, 2nd, 4th, 8th … miss */
} td_clock_options;
TD_API td_clock_options td_clock_options_default(void);

/* Lateness in buckets that are 1/8 octave wide: exact to 12.5 %. */
enum { TD_CLOCK_BUCKETS = 488 };

typedef struct td_clock_counts {
    uint64_t ticks, misses;
    uint64_t overruns;                     /* ticks whose work ended after the deadline, however little */
    int64_t late_max_ns, slipped_ns;       /* slipped: by how much the grid was moved */
    double late_sum_ns;                    /* mean: over ticks */
    uint64_t late_count[TD_CLOCK_BUCKETS]; /* ticks by lateness */
} td_clock_counts;

typedef struct td_clock {
    td_clock_options options;
    td_clock_counts counts;
    int64_t deadline_ns; /* the next one */
    bool stopped;
} td_clock;

/* The first deadline is a period from now. Refused: periods and tolerances that are not positive (a tolerance
 * may be 0). Options NULL: defaults. */
TD_API td_status td_clock_start(td_clock *clock, const td_clock_options *options, td_error *error);
/* Sleeps until the next deadline. *late_ns (may be NULL): by how much it is missed, never negative. Fails
 * with TD_ERROR_DEADLINE when the policy is to stop. */
TD_API td_status td_clock_wait(td_clock *clock, int64_t *late_ns, td_error *error);
/* The lateness that a share (0 … 1) of the ticks does not exceed, ns: a bucket's upper edge; 0 without ticks.
 */
TD_API int64_t td_clock_late(const td_clock_counts *counts, double share);

#ifdef __cplusplus
}
#endif
#endif
