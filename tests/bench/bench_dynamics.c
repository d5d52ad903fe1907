/* Generated dynamics of the zx200, free base and four joints, beside KDL's with the base emulated by six
 * joints, and beside DART's with a free base: the same states in the same run. Errors are against the
 * recursive evaluation, relative. */
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/dynamics.h"
#include "sim/dynamics_generator.h"
#include "tests/bench/bench.h"
#include "tests/sim/dynamics_base.h"
#ifdef TD_BENCH_KDL
#include "tests/sim/dynamics_kdl.h"
#endif
#ifdef TD_BENCH_DART
#include "tests/bench/dynamics_dart.h"
#endif

/* Short runs, so that the median is one that nothing interrupted. */
enum { STATES = 64, RUNS = 499, REPEATS = 4, JOINTS = 4, SIZE = 6 + JOINTS };

enum {
    INVERSE,
    FORWARD,
    MASS,
    INVERSE_STILL,
    FORWARD_STILL,
    THREADS,
    GENERATION,
    INVERSE_DART,
    FORWARD_DART
};
static const char *const NAMES[] = {"dynamics inverse",
                                    "dynamics forward",
                                    "dynamics mass matrix",
                                    "dynamics inverse, no Coriolis",
                                    "dynamics forward, no Coriolis",
                                    "dynamics forward, two threads",
                                    "dynamics generation",
                                    "dynamics inverse (DART)",
                                    "dynamics forward (DART)"};

typedef struct one {
    base_state base;
    double q[JOINTS], nu[SIZE], acceleration[SIZE], force[SIZE], gravity[3];
    double spatial[SIZE]; /* acceleration with nu' of the base in place of its origin's acceleration */
    double peer_q[SIZE], peer_rate[SIZE], peer_change[SIZE], peer_force[SIZE];
} one;

typedef struct work {
    td_robot *robot;
    td_dynamics *made, *plain;
#ifdef TD_BENCH_KDL
    kdl_dynamics *peer;
#endif
#ifdef TD_BENCH_DART
    dart_dynamics *dart;
#endif
    bool coriolis;
    one state[STATES];
    double sink;
} work;

static void make_state(one *s, td_random *random, const td_dynamics *plain)
{
    static const double down[3] = {0, 0, -9.81};
    for (int k = 0; k < 6; k++) {
        s->base.position[k] = 0.5 * td_random_normal(random);
        s->base.rate[k] = 0.5 * td_random_normal(random);
        s->base.change[k] = td_random_normal(random);
    }
    base_complete(&s->base);
    memcpy(s->nu, s->base.nu, sizeof s->base.nu);
    memcpy(s->acceleration, s->base.acceleration, sizeof s->base.acceleration);
    memcpy(s->peer_q, s->base.position, sizeof s->base.position);
    memcpy(s->peer_rate, s->base.rate, sizeof s->base.rate);
    memcpy(s->peer_change, s->base.change, sizeof s->base.change);
    base_turn_back(s->gravity, s->base.rotation, down);
    for (int k = 0; k < JOINTS; k++) {
        s->q[k] = s->peer_q[6 + k] = td_random_normal(random);
        s->nu[6 + k] = s->peer_rate[6 + k] = 0.5 * td_random_normal(random);
        s->acceleration[6 + k] = s->peer_change[6 + k] = td_random_normal(random);
    }
    memcpy(s->spatial, s->acceleration, sizeof s->spatial);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        s->spatial[3 + i] -= s->nu[j] * s->nu[3 + k] - s->nu[k] * s->nu[3 + j];
    }
    td_dynamics_inverse(s->force, plain, s->q, s->nu, s->acceleration, s->gravity, true);
    base_force(s->peer_force, &s->base, s->force);
    memcpy(s->peer_force + 6, s->force + 6, JOINTS * sizeof *s->force);
}

/* ---- what is timed ---- */

static void our_inverse(void *user)
{
    work *w = user;
    double force[SIZE];
    for (int i = 0; i < REPEATS * STATES; i++) {
        const one *s = w->state + i % STATES;
        td_dynamics_inverse(force, w->made, s->q, s->nu, s->acceleration, s->gravity, w->coriolis);
        w->sink += force[0];
    }
}

static void our_forward(void *user)
{
    work *w = user;
    double acceleration[SIZE];
    for (int i = 0; i < REPEATS * STATES; i++) {
        const one *s = w->state + i % STATES;
        td_dynamics_forward(acceleration, w->made, s->q, s->nu, s->force, s->gravity, w->coriolis);
        w->sink += acceleration[0];
    }
}

static void our_mass(void *user)
{
    work *w = user;
    double mass[SIZE * SIZE];
    for (int i = 0; i < REPEATS * STATES; i++) {
        td_dynamics_mass(mass, w->made, w->state[i % STATES].q);
        w->sink += mass[0];
    }
}

#ifdef TD_BENCH_KDL
static void peer_inverse(void *user)
{
    work *w = user;
    double force[SIZE];
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        kdl_dynamics_inverse(force, w->peer, s->peer_q, s->peer_rate, s->peer_change);
    }
}

static void peer_forward(void *user)
{
    work *w = user;
    double change[SIZE];
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        kdl_dynamics_forward(change, w->peer, s->peer_q, s->peer_rate, s->peer_force);
    }
}

static void peer_mass(void *user)
{
    work *w = user;
    double mass[SIZE * SIZE];
    for (int i = 0; i < STATES; i++) kdl_dynamics_mass(mass, w->peer, w->state[i].peer_q);
}
#endif

#ifdef TD_BENCH_DART
static void dart_inverse(void *user)
{
    work *w = user;
    double force[SIZE];
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        dart_dynamics_inverse(force, w->dart, s->base.rotation, s->q, s->nu, s->spatial);
    }
}

static void dart_forward(void *user)
{
    work *w = user;
    double change[SIZE];
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        dart_dynamics_forward(change, w->dart, s->base.rotation, s->q, s->nu, s->force);
    }
}
#endif

/* ---- errors ---- */

static double apart(const double *a, const double *b, int count)
{
    double difference = 0, size = 0;
    for (int i = 0; i < count; i++) {
        difference = fmax(difference, fabs(a[i] - b[i]));
        size = fmax(size, fabs(b[i]));
    }
    return difference / size;
}

/* The forces were made by the recursive evaluation from the accelerations: so the first are the truth of
 * inverse, the second of forward dynamics. */
static void judge(const work *w, bool forward, double *ours, double *peers)
{
    *ours = 0, *peers = NAN;
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        double x[SIZE];
        if (forward)
            td_dynamics_forward(x, w->made, s->q, s->nu, s->force, s->gravity, true);
        else
            td_dynamics_inverse(x, w->made, s->q, s->nu, s->acceleration, s->gravity, true);
        *ours = fmax(*ours, apart(x, forward ? s->acceleration : s->force, SIZE));
#ifdef TD_BENCH_KDL
        if (forward)
            kdl_dynamics_forward(x, w->peer, s->peer_q, s->peer_rate, s->peer_force);
        else
            kdl_dynamics_inverse(x, w->peer, s->peer_q, s->peer_rate, s->peer_change);
        *peers = fmax(*peers, apart(x, forward ? s->peer_change : s->peer_force, SIZE)); /* fmax drops NaN */
#endif
    }
}

static double dart_error(const work *w, bool forward)
{
    double most = NAN;
#ifdef TD_BENCH_DART
    for (int i = 0; i < STATES; i++) {
        const one *s = w->state + i;
        double x[SIZE];
        if (forward)
            dart_dynamics_forward(x, w->dart, s->base.rotation, s->q, s->nu, s->force);
        else
            dart_dynamics_inverse(x, w->dart, s->base.rotation, s->q, s->nu, s->spatial);
        most = fmax(most, apart(x, forward ? s->spatial : s->force, SIZE)); /* fmax drops NaN */
    }
#else
    (void)w, (void)forward;
#endif
    return most;
}

/* ---- rows ---- */

static double time_once(bench_function function, work *w, int calls)
{
    const double start = bench_now();
    function(w);
    return (bench_now() - start) / calls * 1e9;
}

/* In turns, so that both see the same machine. */
static void time_both(bench_row *row, work *w, bench_function ours, bench_function peer)
{
    double mine[RUNS], its[RUNS];
    for (int i = -1; i < RUNS; i++) { /* one to warm up */
        const double first = time_once(ours, w, REPEATS * STATES),
                     second = peer ? time_once(peer, w, STATES) : NAN;
        if (i >= 0) mine[i] = first, its[i] = second;
    }
    row->ours = bench_median(mine, RUNS);
    if (peer) row->peer = bench_median(its, RUNS);
}

static void print_row(const bench *b, work *w, const char *name, bench_function ours, bench_function peer,
                      bool judged)
{
    if (!bench_wanted(b, name)) return;
    bench_row row = {.name = name, .unit = "ns", .peer = NAN, .peer_name = "KDL, 10 joints", .runs = RUNS};
    time_both(&row, w, ours, peer);
    if (!peer) row.remark = "KDL is not installed";
    if (judged) {
        row.error_unit = "relative";
        judge(w, ours == our_forward, &row.error_ours, &row.error_peer);
    }
    bench_print(b, &row);
}

static void print_dart(const bench *b, work *w, bool forward)
{
    const char *name = NAMES[forward ? FORWARD_DART : INVERSE_DART];
    if (!bench_wanted(b, name)) return;
    bench_row row = {.name = name,
                     .unit = "ns",
                     .peer = NAN,
                     .peer_name = "DART, free base",
                     .error_unit = "relative",
                     .runs = RUNS};
    bench_function peer = NULL;
#ifdef TD_BENCH_DART
    peer = forward ? dart_forward : dart_inverse;
#else
    row.remark = "DART is not installed";
#endif
    double kdl;
    time_both(&row, w, forward ? our_forward : our_inverse, peer);
    judge(w, forward, &row.error_ours, &kdl);
    row.error_peer = dart_error(w, forward);
    bench_print(b, &row);
}

static void print_generation(const bench *b, const work *w)
{
    const char *name = NAMES[GENERATION];
    if (!bench_wanted(b, name)) return;
    double times[9];
    for (int i = 0; i < 9; i++) {
        td_generated generated;
        td_error error;
        const double start = bench_now();
        if (td_dynamics_generate(&generated, w->robot, "bench", &error) != TD_OK) return;
        times[i] = (bench_now() - start) * 1e3;
        if (i == 8 && !b->json)
            printf("    operations: inverse %zu, without Coriolis %zu, forward %zu, mass matrix %zu\n",
                   generated.inverse_flops, generated.inverse_no_coriolis_flops, generated.forward_flops,
                   generated.mass_flops);
        td_generated_free(&generated);
    }
    bench_print(b, &(bench_row){.name = name,
                                .unit = "ms",
                                .ours = bench_median(times, 9),
                                .peer = NAN,
                                .peer_name = "none",
                                .remark = "text of all functions; no peer generates",
                                .runs = 9});
}

enum { THREAD_RUNS = 400 };

static void *many_forward(void *user)
{
    for (int i = 0; i < THREAD_RUNS; i++) our_forward(user);
    return NULL;
}

/* Forward dynamics a second on two threads, beside one thread. */
static void print_threads(const bench *b, const work *w)
{
    const char *name = NAMES[THREADS];
    if (!bench_wanted(b, name)) return;
    work *mine = malloc(2 * sizeof *mine);
    if (!mine) return;
    double rate[2] = {0};
    for (int threads = 1; threads <= 2; threads++) {
        pthread_t thread;
        mine[0] = mine[1] = *w;
        const double start = bench_now();
        const bool second = threads == 2 && pthread_create(&thread, NULL, many_forward, mine + 1) == 0;
        many_forward(mine);
        if (second) pthread_join(thread, NULL);
        rate[threads - 1] = threads * THREAD_RUNS * REPEATS * STATES / (bench_now() - start);
    }
    free(mine);
    bench_print(b, &(bench_row){.name = name,
                                .unit = "1/s",
                                .ours = rate[1],
                                .peer = rate[0],
                                .peer_name = "ours, one thread",
                                .runs = 1});
}

static bool any_wanted(const bench *b)
{
    for (size_t i = 0; i < sizeof NAMES / sizeof *NAMES; i++)
        if (bench_wanted(b, NAMES[i])) return true;
    return false;
}

static void print_rows(const bench *b, work *w)
{
#ifdef TD_BENCH_KDL
    bench_function inverse = peer_inverse, forward = peer_forward, mass = peer_mass;
#else
    bench_function inverse = NULL, forward = NULL, mass = NULL;
#endif
    w->coriolis = true;
    print_row(b, w, NAMES[INVERSE], our_inverse, inverse, true);
    print_row(b, w, NAMES[FORWARD], our_forward, forward, true);
    print_row(b, w, NAMES[MASS], our_mass, mass, false);
    print_dart(b, w, false);
    print_dart(b, w, true);
    w->coriolis = false;
    print_row(b, w, NAMES[INVERSE_STILL], our_inverse, inverse, false);
    print_row(b, w, NAMES[FORWARD_STILL], our_forward, forward, false);
    w->coriolis = true;
    print_threads(b, w);
    print_generation(b, w);
}

void bench_dynamics(const bench *b)
{
    char path[4096];
    td_error error = {0};
    if (!any_wanted(b)) return;
    work *w = calloc(1, sizeof *w);
    if (!w) return;
    td_random random = td_random_seed(1, 1);
    snprintf(path, sizeof path, "%s/datasets/zx200/zx200.urdf", b->source);
    bool ready = td_robot_read(&w->robot, path, &error) == TD_OK &&
                 td_dynamics_zx200(&w->made, w->robot, &error) == TD_OK &&
                 td_dynamics_new(&w->plain, w->robot, &error) == TD_OK;
#ifdef TD_BENCH_KDL
    if (ready) ready = (w->peer = kdl_dynamics_read(path)) != NULL;
#endif
#ifdef TD_BENCH_DART
    if (ready) ready = (w->dart = dart_dynamics_read(path)) != NULL;
#endif
    for (int i = 0; ready && i < STATES; i++) make_state(w->state + i, &random, w->plain);
    if (ready)
        print_rows(b, w);
    else
        fprintf(stderr, "teledimos-bench: %s\n", error.message);
#ifdef TD_BENCH_KDL
    kdl_dynamics_free(w->peer);
#endif
#ifdef TD_BENCH_DART
    dart_dynamics_free(w->dart);
#endif
    td_dynamics_free(&w->made);
    td_dynamics_free(&w->plain);
    td_robot_free(&w->robot);
    free(w);
}
