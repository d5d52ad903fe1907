/* Proves: ticks stay on the grid whatever the work takes; an injected stall does what the policy says, and is
 * counted; the histogram's shares are those of the sorted latenesses. Reference: a clock of the test's own,
 * whose time passes only by work and sleep, so that all is exact. Blind to: how late a real system wakes
 * (tests/bench/bench_clock.c). */
#include <time.h>

#include "core/random.h"
#include "sim/clock.h"
#include "tests/check.h"

enum { MS = 1000000 };

typedef struct fake {
    int64_t now_ns;
    int64_t wakes_late_ns, wakes_early_ns; /* once */
    int sleeps;
} fake;

static int64_t fake_now(void *self)
{
    return ((fake *)self)->now_ns;
}

static void fake_sleep(void *self, int64_t time_ns)
{
    fake *f = self;
    f->sleeps++;
    if (time_ns > f->now_ns) f->now_ns = time_ns;
    f->now_ns += f->wakes_late_ns - f->wakes_early_ns;
    f->wakes_early_ns = 0;
}

typedef struct warnings {
    int count;
    char last[200];
} warnings;

static void warned(td_log_level level, const char *topic, const char *text, void *user)
{
    warnings *w = user;
    assert_int_equal(level, TD_LOG_WARNING);
    assert_string_equal(topic, "clock");
    w->count++;
    snprintf(w->last, sizeof w->last, "%s", text);
}

static td_clock start(fake *f, td_miss_policy policy, warnings *w)
{
    td_error error = {0};
    td_clock clock;
    td_clock_options options = td_clock_options_default();
    assert_int_equal(options.period_ns, 50 * MS); /* the paper's */
    assert_int_equal(options.policy, TD_MISS_STOP);
    options.policy = policy;
    options.source = (td_clock_source){fake_now, fake_sleep, f};
    if (w) options.log = (td_log){warned, w};
    check_ok(td_clock_start(&clock, &options, &error), error);
    return clock;
}

static void test_grid(void **state)
{
    fake f = {.now_ns = 123, .wakes_late_ns = 60000};
    td_error error = {0};
    int64_t late = -1;
    (void)state;
    td_clock clock = start(&f, TD_MISS_STOP, NULL);
    for (int i = 1; i <= 1000; i++) {
        f.now_ns += i % 49 * MS;                    /* work */
        if (i % 10 == 0) f.wakes_early_ns = 1 * MS; /* a signal */
        check_ok(td_clock_wait(&clock, &late, &error), error);
        assert_int_equal(late, 60000);
        assert_int_equal(f.now_ns, 123 + (int64_t)i * 50 * MS + 60000); /* nothing adds up */
    }
    assert_int_equal(f.sleeps, 1100);
    assert_int_equal(clock.counts.ticks, 1000);
    assert_int_equal(clock.counts.misses, 0);
    assert_int_equal(clock.counts.overruns, 0);
    assert_int_equal(clock.counts.late_max_ns, 60000);
    check_near(clock.counts.late_sum_ns / 1000, 60000, 1e-6);
}

static void test_stop(void **state)
{
    fake f = {0};
    td_error error = {0};
    int64_t late;
    (void)state;
    td_clock clock = start(&f, TD_MISS_STOP, NULL);
    f.now_ns += 55 * MS; /* on the tolerance's edge */
    check_ok(td_clock_wait(&clock, &late, &error), error);
    assert_int_equal(late, 5 * MS);
    f.now_ns += 120 * MS; /* due at 100 ms, now 175 */
    check_fails(td_clock_wait(&clock, &late, &error), TD_ERROR_DEADLINE, error,
                "tick 2 of 50 ms came 75 ms after its deadline, more than the 5 ms");
    assert_int_equal(late, 75 * MS);
    assert_int_equal(clock.counts.misses, 1);
    assert_int_equal(clock.counts.overruns, 2);
    check_fails(td_clock_wait(&clock, &late, &error), TD_ERROR_DEADLINE, error, "has stopped at tick 2");
    assert_int_equal(clock.counts.ticks, 2);
}

/* A stall of 230 ms in the third period: due at 150 ms, there at 330. */
static void stall(td_clock *clock, fake *f)
{
    td_error error = {0};
    for (int i = 1; i <= 12; i++) {
        f->now_ns += i == 3 ? 230 * MS : 1 * MS;
        check_ok(td_clock_wait(clock, NULL, &error), error);
    }
}

static void test_catch_up(void **state)
{
    fake f = {0};
    warnings w = {0};
    (void)state;
    td_clock clock = start(&f, TD_MISS_CATCH_UP, &w);
    stall(&clock, &f);
    /* Ticks 3 … 6 (due at 150 … 300 ms) came at 330 … 333 ms; all are on time again after. */
    assert_int_equal(f.now_ns, 12 * 50 * MS);
    assert_int_equal(clock.counts.misses, 4);
    assert_int_equal(clock.counts.overruns, 4);
    assert_int_equal(clock.counts.late_max_ns, 180 * MS);
    assert_int_equal(clock.counts.slipped_ns, 0);
    assert_int_equal(w.count, 3); /* at 1, 2, 4 */
    assert_string_equal(w.last, "4 deadlines missed in 6 ticks, the last by 33 ms");
}

static void test_slip(void **state)
{
    fake f = {0};
    warnings w = {0};
    (void)state;
    td_clock clock = start(&f, TD_MISS_SLIP, &w);
    stall(&clock, &f);
    assert_int_equal(f.now_ns, 12 * 50 * MS + 180 * MS);
    assert_int_equal(clock.counts.misses, 1);
    assert_int_equal(clock.counts.slipped_ns, 180 * MS);
    assert_int_equal(w.count, 1);
}

/* The system, not the work, is late. */
static void test_late_wake(void **state)
{
    fake f = {.wakes_late_ns = 6 * MS};
    td_error error = {0};
    (void)state;
    td_clock clock = start(&f, TD_MISS_STOP, NULL);
    check_fails(td_clock_wait(&clock, NULL, &error), TD_ERROR_DEADLINE, error, "6 ms after");
    assert_int_equal(clock.counts.overruns, 0);
}

static int compare(const void *a, const void *b)
{
    const int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* A bucket's edge is above the true share by less than 1/8. */
static void test_shares(void **state)
{
    enum { COUNT = 20000 };
    static int64_t late[COUNT];
    fake f = {0};
    td_error error = {0};
    td_random random = td_random_seed(3, 0);
    (void)state;
    td_clock clock = start(&f, TD_MISS_CATCH_UP, NULL);
    assert_int_equal(td_clock_late(&clock.counts, 0.5), 0);
    for (int i = 0; i < COUNT; i++) { /* from 1 ns to 40 ms */
        f.wakes_late_ns = (int64_t)exp(td_random_uniform(&random) * log(40.0 * MS));
        check_ok(td_clock_wait(&clock, &late[i], &error), error);
    }
    qsort(late, COUNT, sizeof *late, compare);
    const double share[] = {0.001, 0.1, 0.5, 0.9, 0.99, 0.999, 1};
    for (size_t i = 0; i < sizeof share / sizeof *share; i++) {
        const double exact = (double)late[(int)ceil(share[i] * COUNT) - 1];
        const double found = (double)td_clock_late(&clock.counts, share[i]);
        assert_true(found >= exact && found <= exact * 1.125 + 1e-9);
    }
    assert_int_equal(td_clock_late(&clock.counts, 1), late[COUNT - 1]);
}

/* Every lateness has its bucket, the longest too. */
static void test_extremes(void **state)
{
    const int64_t value[] = {0, 7, 8, 9, 15, 16, 1000, INT64_MAX / 2};
    (void)state;
    for (size_t i = 0; i < sizeof value / sizeof *value; i++) {
        fake f = {0};
        int64_t late;
        td_clock clock = start(&f, TD_MISS_CATCH_UP, NULL);
        f.now_ns = 50 * MS + value[i];
        assert_int_equal(td_clock_wait(&clock, &late, NULL), TD_OK);
        assert_int_equal(late, value[i]);
        assert_int_equal(td_clock_late(&clock.counts, 0.5), value[i]);
    }
}

static void test_refused(void **state)
{
    td_error error = {0};
    td_clock clock;
    td_clock_options options = td_clock_options_default();
    (void)state;
    options.period_ns = 0;
    check_fails(td_clock_start(&clock, &options, &error), TD_ERROR_ARGUMENT, error, "period");
    options = td_clock_options_default();
    options.tolerance_ns = -1;
    check_fails(td_clock_start(&clock, &options, &error), TD_ERROR_ARGUMENT, error, "tolerance");
}

/* The system's own clock: never early, whatever else runs here. */
static void test_real(void **state)
{
    td_error error = {0};
    td_clock clock;
    td_clock_options options = {.period_ns = 1 * MS, .tolerance_ns = INT64_MAX, .policy = TD_MISS_STOP};
    struct timespec from, to;
    (void)state;
    clock_gettime(CLOCK_MONOTONIC, &from);
    check_ok(td_clock_start(&clock, &options, &error), error);
    for (int i = 0; i < 50; i++) check_ok(td_clock_wait(&clock, NULL, &error), error);
    clock_gettime(CLOCK_MONOTONIC, &to);
    check_less(0.05, (double)(to.tv_sec - from.tv_sec) + 1e-9 * (double)(to.tv_nsec - from.tv_nsec));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_grid),     cmocka_unit_test(test_stop),      cmocka_unit_test(test_catch_up),
        cmocka_unit_test(test_slip),     cmocka_unit_test(test_late_wake), cmocka_unit_test(test_shares),
        cmocka_unit_test(test_extremes), cmocka_unit_test(test_refused),   cmocka_unit_test(test_real),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
