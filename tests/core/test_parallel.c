/* Proves that the loop does every unit once, tells of each, stops when told to, and gives the same bytes at
 * any number of threads. Reference: a plain loop. Blind to data races that neither a wrong count nor a
 * sanitizer shows. */
#include <stdatomic.h>
#include <time.h>

#include "core/parallel.h"
#include "core/random.h"
#include "tests/check.h"

enum { UNITS = 1000 };

typedef struct job {
    atomic_int times[UNITS];
    atomic_int running, most_running;
    int order[UNITS]; /* of the units, in the order they were begun; for one thread */
    int begun;
    int track_order;
    double result[UNITS];
} job;

/* Work of very uneven length, from a stream of the unit's own. */
static void do_unit(size_t index, void *user)
{
    job *j = user;
    int running = atomic_fetch_add(&j->running, 1) + 1, most = atomic_load(&j->most_running);
    while (running > most && !atomic_compare_exchange_weak(&j->most_running, &most, running)) {
    }
    atomic_fetch_add(&j->times[index], 1);
    if (j->track_order) j->order[j->begun++] = (int)index;
    td_random random = td_random_seed(5, index);
    double sum = 0;
    for (size_t i = 0; i < 10 + index % 97 * 20; i++) sum += td_random_normal(&random);
    j->result[index] = sum;
    atomic_fetch_sub(&j->running, 1);
}

typedef struct listener {
    const char *stage;
    size_t calls, last_done, total, cancel_at;
    int orderly;
    atomic_int inside;
} listener;

static bool listen_in(const char *stage, size_t done, size_t total, void *user)
{
    listener *l = user;
    if (atomic_fetch_add(&l->inside, 1) != 0) l->orderly = 0; /* one at a time */
    if (done != l->last_done + 1) l->orderly = 0;
    l->calls++;
    l->last_done = done;
    l->total = total;
    l->stage = stage;
    atomic_fetch_sub(&l->inside, 1);
    return done != l->cancel_at;
}

static void test_every_unit_once(void **state)
{
    (void)state;
    static job reference, j;
    for (size_t i = 0; i < UNITS; i++) do_unit(i, &reference);
    for (int threads = 0; threads <= 8; threads++) {
        listener l = {.orderly = 1};
        const td_progress progress = {listen_in, &l};
        memset(&j, 0, sizeof j);
        assert_int_equal(td_parallel_for(UNITS, threads, do_unit, &j, &progress, "counting"), TD_OK);
        for (int i = 0; i < UNITS; i++) assert_int_equal(atomic_load(&j.times[i]), 1);
        assert_memory_equal(j.result, reference.result, sizeof j.result);
        assert_int_equal(l.calls, UNITS);
        assert_int_equal(l.total, UNITS);
        assert_true(l.orderly);
        assert_string_equal(l.stage, "counting");
        if (threads > 0) assert_in_range(atomic_load(&j.most_running), 1, threads);
    }
}

/* Units wait for one another, which only threads that run at once can do. */
static void meet(size_t index, void *user)
{
    atomic_int *arrived = user;
    (void)index;
    atomic_fetch_add(arrived, 1);
    const time_t begin = time(NULL);
    while (atomic_load(arrived) < 4 && time(NULL) < begin + 20) {
    }
}

static void test_threads_run_at_once(void **state)
{
    (void)state;
    atomic_int arrived = 0;
    const time_t begin = time(NULL);
    assert_int_equal(td_parallel_for(4, 4, meet, &arrived, NULL, NULL), TD_OK);
    assert_true(time(NULL) - begin < 20);
}

static void test_one_thread_goes_in_order(void **state)
{
    (void)state;
    static job j;
    j.track_order = 1;
    assert_int_equal(td_parallel_for(UNITS, 1, do_unit, &j, NULL, "in order"), TD_OK);
    for (int i = 0; i < UNITS; i++) assert_int_equal(j.order[i], i);
}

static void test_odd_counts(void **state)
{
    (void)state;
    static job j;
    const td_progress silent = {0};
    assert_int_equal(td_parallel_for(0, 4, do_unit, &j, NULL, "none"), TD_OK);
    for (int i = 0; i < UNITS; i++) assert_int_equal(atomic_load(&j.times[i]), 0);
    assert_int_equal(td_parallel_for(3, 100000, do_unit, &j, &silent, "more threads than units"), TD_OK);
    for (int i = 0; i < UNITS; i++) assert_int_equal(atomic_load(&j.times[i]), i < 3);
    assert_int_equal(td_parallel_for(1, -3, do_unit, &j, NULL, NULL), TD_OK);
    assert_int_equal(atomic_load(&j.times[0]), 2);
}

static void test_cancel(void **state)
{
    (void)state;
    static job j;
    for (int threads = 1; threads <= 8; threads++) {
        listener l = {.orderly = 1, .cancel_at = 10};
        const td_progress progress = {listen_in, &l};
        memset(&j, 0, sizeof j);
        assert_int_equal(td_parallel_for(UNITS, threads, do_unit, &j, &progress, "short"),
                         TD_ERROR_CANCELLED);
        /* The tenth unit cancels; only those already begun by the other threads are still done, in order. */
        int done = 0;
        while (done < UNITS && atomic_load(&j.times[done]) == 1) done++;
        assert_in_range(done, 10, 10 + threads - 1);
        for (int i = done; i < UNITS; i++) assert_int_equal(atomic_load(&j.times[i]), 0);
        assert_int_equal(l.calls, done);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_unit_once),
        cmocka_unit_test(test_threads_run_at_once),
        cmocka_unit_test(test_one_thread_goes_in_order),
        cmocka_unit_test(test_odd_counts),
        cmocka_unit_test(test_cancel),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
