/* The ring between the session and the server. Against what its header says, counted out by hand, and with
 * two threads that put and take as fast as they can: nothing twice, nothing out of order, and what was put
 * was taken or dropped. Run under ThreadSanitizer it shows that there is no race. Blind to: orders of memory
 * that this processor does not show. */
#include <pthread.h>
#include <sched.h>

#include "apps/panel_ring.h"
#include "tests/check.h"

typedef struct thing {
    panel_numbered head;
    uint64_t value;
    atomic_ulong *freed;
} thing;

static void release(void *t)
{
    atomic_fetch_add(((thing *)t)->freed, 1);
    free(t);
}

static thing *make(uint64_t value, atomic_ulong *freed)
{
    thing *t = malloc(sizeof *t);
    assert_non_null(t);
    t->value = value;
    t->freed = freed;
    return t;
}

static void takes_in_order(panel_ring *ring, uint64_t from, uint64_t to)
{
    for (uint64_t i = from; i < to; i++) {
        thing *t = panel_ring_take(ring);
        assert_non_null(t);
        assert_int_equal(t->value, i);
        release(t);
    }
    assert_null(panel_ring_take(ring));
}

static void the_newest_wins(void **state)
{
    panel_ring ring;
    atomic_ulong freed = 0;
    (void)state;
    assert_true(panel_ring_begin(&ring, 8, release));
    assert_null(panel_ring_take(&ring));
    for (uint64_t i = 0; i < 8; i++) assert_false(panel_ring_put(&ring, make(i, &freed)));
    takes_in_order(&ring, 0, 8);
    for (uint64_t i = 8; i < 30; i++) assert_int_equal(panel_ring_put(&ring, make(i, &freed)), i >= 16);
    assert_int_equal(freed, 8 + 14);
    takes_in_order(&ring, 22, 30);
    panel_ring_put(&ring, make(30, &freed));
    panel_ring_end(&ring);
    assert_int_equal(freed, 31);
}

static void an_offer_is_refused_when_full(void **state)
{
    panel_ring ring;
    atomic_ulong freed = 0;
    (void)state;
    assert_true(panel_ring_begin(&ring, 4, release));
    for (uint64_t i = 0; i < 4; i++) assert_true(panel_ring_offer(&ring, make(i, &freed)));
    thing *more = make(4, &freed);
    assert_false(panel_ring_offer(&ring, more));
    assert_int_equal(freed, 0);
    release(panel_ring_take(&ring));
    assert_true(panel_ring_offer(&ring, more));
    takes_in_order(&ring, 1, 5);
    panel_ring_end(&ring);
}

enum { MANY = 400000 };

typedef struct race {
    panel_ring ring;
    atomic_ulong freed;
    bool offers;
    atomic_bool done;
    unsigned long dropped;
} race;

static void *put_many(void *user)
{
    race *r = user;
    for (uint64_t i = 0; i < MANY; i++) {
        thing *t = make(i, &r->freed);
        if (r->offers)
            while (!panel_ring_offer(&r->ring, t)) sched_yield();
        else
            r->dropped += panel_ring_put(&r->ring, t);
    }
    atomic_store(&r->done, true);
    return NULL;
}

static void race_for(bool offers)
{
    race r = {.offers = offers};
    pthread_t putter;
    uint64_t next = 0, taken = 0;
    assert_true(panel_ring_begin(&r.ring, 64, release));
    assert_int_equal(pthread_create(&putter, NULL, put_many, &r), 0);
    for (;;) {
        const bool done = atomic_load(&r.done);
        thing *t = panel_ring_take(&r.ring);
        if (!t && done) break;
        if (!t) {
            sched_yield();
            continue;
        }
        if (t->value < next || t->head.number != t->value) fail_msg("%lu after %lu", t->value, next);
        if (offers) assert_int_equal(t->value, next);
        next = t->value + 1;
        taken++;
        release(t);
    }
    pthread_join(putter, NULL);
    panel_ring_end(&r.ring);
    assert_int_equal(r.freed, MANY);
    if (offers) assert_int_equal(taken, MANY);
    assert_true(taken + r.dropped <= MANY);
    assert_int_equal(next, MANY); /* the newest came through */
}

static void threads_lose_no_offer(void **state)
{
    (void)state;
    race_for(true);
}

static void threads_keep_the_newest(void **state)
{
    (void)state;
    race_for(false);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_newest_wins),
        cmocka_unit_test(an_offer_is_refused_when_full),
        cmocka_unit_test(threads_lose_no_offer),
        cmocka_unit_test(threads_keep_the_newest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
