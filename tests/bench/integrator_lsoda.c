/* ODEPACK's LSODA, whose address SciPy gives, on the bench's problems: built as a library that Python loads.
 * The very functions that ours integrates, called without Python between. */
#include <time.h>

#include "tests/bench/integrator_problems.h"

/* Fortran's. */
typedef void lsoda_rate(const int *n, const double *t, const double *y, double *dy);
typedef void lsoda_jacobian(const int *n, const double *t, const double *y, const int *ml, const int *mu,
                            double *j, const int *rows);
typedef void lsoda(lsoda_rate *f, const int *n, double *y, double *t, const double *end, const int *itol,
                   const double *relative, const double *absolute, const int *task, int *state,
                   const int *options, double *rwork, const int *lrw, int *iwork, const int *liw,
                   lsoda_jacobian *j, const int *kind);

typedef struct peer_result {
    double seconds; /* the least of the runs */
    double y[BENCH_PROBLEM_STATES];
    long rates, jacobians, steps;
    int state; /* 2: done */
} peer_result;
TD_API void peer_solve(void (*function)(void), int index, double relative, int runs, peer_result *out);

/* LSODA hands nothing on to its functions. */
static bench_problem the_problem;
static long rates, jacobians;

static void rate(const int *n, const double *t, const double *y, double *dy)
{
    (void)n;
    rates++;
    the_problem.ode.rate(dy, *t, y, the_problem.ode.user);
}

/* By columns, and without the rate, which ours is given by CVODE: it is made here, uncounted. */
static void jacobian(const int *n, const double *t, const double *y, const int *ml, const int *mu, double *j,
                     const int *rows)
{
    double dy[BENCH_PROBLEM_STATES], by_rows[BENCH_PROBLEM_STATES * BENCH_PROBLEM_STATES];
    (void)ml, (void)mu;
    jacobians++;
    the_problem.ode.rate(dy, *t, y, the_problem.ode.user);
    the_problem.ode.jacobian(by_rows, *t, y, dy, the_problem.ode.user);
    for (int i = 0; i < *n; i++)
        for (int k = 0; k < *n; k++) j[k * *rows + i] = by_rows[i * *n + k];
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void solve(lsoda *function, double relative, peer_result *out)
{
    enum { LRW = 22 + 16 * BENCH_PROBLEM_STATES + BENCH_PROBLEM_STATES * BENCH_PROBLEM_STATES };
    enum { LIW = 20 + BENCH_PROBLEM_STATES };
    const int n = (int)the_problem.ode.size, itol = 2, task = 1, options = 1, lrw = LRW, liw = LIW, kind = 1;
    double t = 0, absolute[BENCH_PROBLEM_STATES], rwork[LRW] = {0};
    int iwork[LIW] = {0};
    iwork[5] = 100000000; /* steps, at most */
    for (int i = 0; i < n; i++) {
        out->y[i] = the_problem.y0[i];
        absolute[i] = relative * the_problem.absolute[i];
    }
    out->state = 1;
    rates = jacobians = 0;
    function(rate, &n, out->y, &t, &the_problem.t_end, &itol, &relative, absolute, &task, &out->state,
             &options, rwork, &lrw, iwork, &liw, jacobian, &kind);
    out->rates = rates;
    out->jacobians = jacobians;
    out->steps = iwork[10];
}

void peer_solve(void (*function)(void), int index, double relative, int runs, peer_result *out)
{
    td_error error;
    *out = (peer_result){0};
    if (!bench_problem_make(&the_problem, index, &error)) return;
    for (int i = 0; i < runs; i++) {
        const double start = now();
        solve((lsoda *)function, relative, out);
        const double took = now() - start;
        if (i == 0 || took < out->seconds) out->seconds = took;
    }
    bench_problem_free(&the_problem);
}
