#include "sim/clock.h"

#include <errno.h>
#include <math.h>
#include <time.h>

enum { SUB_BITS = 3, SUBS = 1 << SUB_BITS };
static const int64_t SECOND = 1000000000;

static int64_t monotonic_now(void *self)
{
    struct timespec now;
    (void)self;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * SECOND + now.tv_nsec;
}

static void monotonic_sleep(void *self, int64_t time_ns)
{
    const struct timespec until = {.tv_sec = (time_t)(time_ns / SECOND), .tv_nsec = (long)(time_ns % SECOND)};
    (void)self;
    /* Absolute: what happens between reading the clock and sleeping costs nothing. A signal ends it early. */
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

td_clock_options td_clock_options_default(void)
{
    return (td_clock_options){.period_ns = 50000000, .tolerance_ns = 5000000, .policy = TD_MISS_STOP};
}

td_status td_clock_start(td_clock *clock, const td_clock_options *options, td_error *error)
{
    *clock = (td_clock){.options = options ? *options : td_clock_options_default()};
    td_clock_options *o = &clock->options;
    if (o->period_ns <= 0 || o->tolerance_ns < 0)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "a clock's period must be positive and its tolerance not negative, not %lld and %lld ns",
            (long long)o->period_ns, (long long)o->tolerance_ns);
    if (!o->source.now) o->source.now = monotonic_now;
    if (!o->source.sleep_until) o->source.sleep_until = monotonic_sleep;
    clock->deadline_ns = o->source.now(o->source.self) + o->period_ns;
    return TD_OK;
}

/* The highest bit that is set; value > 0. */
static int top_bit(uint64_t value)
{
    int bit = 0;
    while (value >>= 1) bit++;
    return bit;
}

/* Below 8 ns a bucket each; then 8 to an octave. */
static int bucket_of(int64_t late_ns)
{
    const uint64_t value = (uint64_t)late_ns;
    if (value < SUBS) return (int)value;
    const int shift = top_bit(value) - SUB_BITS;
    return SUBS + shift * SUBS + (int)(value >> shift & (SUBS - 1));
}

static int64_t upper_edge(int bucket)
{
    if (bucket < SUBS) return bucket;
    const int shift = (bucket - SUBS) / SUBS, sub = bucket % SUBS;
    return (int64_t)(((uint64_t)(SUBS + sub + 1) << shift) - 1);
}

int64_t td_clock_late(const td_clock_counts *counts, double share)
{
    const double wanted = fmax(1, ceil(share * (double)counts->ticks));
    uint64_t seen = 0;
    for (int i = 0; i < TD_CLOCK_BUCKETS; i++) {
        seen += counts->late_count[i];
        if (counts->late_count[i] == 0 || (double)seen < wanted) continue;
        const int64_t edge = upper_edge(i);
        return edge < counts->late_max_ns ? edge : counts->late_max_ns;
    }
    return counts->late_max_ns;
}

static void count(td_clock_counts *c, int64_t late_ns)
{
    c->ticks++;
    c->late_sum_ns += (double)late_ns;
    c->late_count[bucket_of(late_ns)]++;
    if (late_ns > c->late_max_ns) c->late_max_ns = late_ns;
}

static td_status stop(const td_clock *clock, int64_t late_ns, td_error *error)
{
    return td_fail(
        error, TD_ERROR_DEADLINE,
        "tick %llu of %.6g ms came %.6g ms after its deadline, more than the %.6g ms tolerated; give the "
        "process a real-time priority, take a longer period, or count misses instead of stopping",
        (unsigned long long)clock->counts.ticks, 1e-6 * (double)clock->options.period_ns,
        1e-6 * (double)late_ns, 1e-6 * (double)clock->options.tolerance_ns);
}

static td_status miss(td_clock *clock, int64_t late_ns, td_error *error)
{
    td_clock_counts *c = &clock->counts;
    c->misses++;
    if (clock->options.policy == TD_MISS_STOP) {
        clock->stopped = true;
        return stop(clock, late_ns, error);
    }
    if ((c->misses & (c->misses - 1)) == 0)
        td_log_write(&clock->options.log, TD_LOG_WARNING, "clock",
                     "%llu deadlines missed in %llu ticks, the last by %.6g ms",
                     (unsigned long long)c->misses, (unsigned long long)c->ticks, 1e-6 * (double)late_ns);
    if (clock->options.policy == TD_MISS_SLIP) {
        clock->deadline_ns += late_ns;
        c->slipped_ns += late_ns;
    }
    return TD_OK;
}

td_status td_clock_wait(td_clock *clock, int64_t *late_ns, td_error *error)
{
    const td_clock_source *source = &clock->options.source;
    const int64_t deadline = clock->deadline_ns;
    if (late_ns) *late_ns = 0;
    if (clock->stopped)
        return td_fail(error, TD_ERROR_DEADLINE,
                       "the clock has stopped at tick %llu, which was missed; start it again",
                       (unsigned long long)clock->counts.ticks);
    int64_t now = source->now(source->self);
    if (now > deadline) clock->counts.overruns++;
    for (; now < deadline; now = source->now(source->self)) source->sleep_until(source->self, deadline);
    const int64_t late = now - deadline;
    if (late_ns) *late_ns = late;
    count(&clock->counts, late);
    clock->deadline_ns += clock->options.period_ns;
    return late > clock->options.tolerance_ns ? miss(clock, late, error) : TD_OK;
}
