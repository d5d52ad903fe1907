/* The integrator beside LSODA, which is SciPy's Fortran, on the same functions with the same Jacobian and the
 * same tolerances: calls of the rate with the error at the end, calls of the Jacobian, time (the least of the
 * runs, nothing but the two languages between). The truth is LSODA's at 1e-12; ours at 1e-11 must agree with
 * it to a hundredth of the tolerance that is judged by, or the row says so. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "tests/bench/bench.h"
#include "tests/bench/integrator_problems.h"

enum { RUNS = 5 };
static const double RELATIVE = 1e-6;

typedef struct answer {
    double y[BENCH_PROBLEM_STATES], seconds;
    double rates, jacobians;
    bool done;
} answer;

static void solve(answer *a, const bench_problem *p, double relative)
{
    double absolute[BENCH_PROBLEM_STATES];
    td_integrator_options o = td_integrator_options_default();
    td_integrator *g = NULL;
    int event;
    for (size_t i = 0; i < p->ode.size; i++) absolute[i] = relative * p->absolute[i];
    o.relative = relative;
    o.absolute = absolute;
    const double start = bench_now();
    a->done = td_integrator_new(&g, &p->ode, 0, p->y0, &o, NULL) == TD_OK &&
              td_integrator_advance(g, p->t_end, &event, NULL, NULL) == TD_OK;
    const double took = bench_now() - start;
    if (a->done) {
        const td_integrator_counters c = td_integrator_count(g);
        memcpy(a->y, td_integrator_state(g), p->ode.size * sizeof *a->y);
        if (!(took > a->seconds)) a->seconds = took;
        a->rates = (double)c.rates;
        a->jacobians = (double)c.jacobians;
    }
    td_integrator_free(&g);
}

/* A line of JSON from integrator_scipy.py. */
static void solve_peer(answer *a, const bench *b, int index, double relative, int runs)
{
    char command[8192];
    snprintf(command, sizeof command,
             "/usr/bin/python3 '%s/tests/bench/integrator_scipy.py' '%s' %d %g %d 2>/dev/null", b->source,
             TD_BENCH_LSODA, index, relative, runs);
    *a = (answer){.seconds = NAN, .rates = NAN, .jacobians = NAN};
    FILE *f = popen(command, "r");
    if (!f) return;
    json_t *line = json_loadf(f, 0, NULL), *y = json_object_get(line, "y");
    if (pclose(f) == 0 && json_array_size(y) == BENCH_PROBLEM_STATES) {
        for (size_t i = 0; i < BENCH_PROBLEM_STATES; i++) a->y[i] = json_number_value(json_array_get(y, i));
        a->seconds = json_number_value(json_object_get(line, "seconds"));
        a->rates = json_number_value(json_object_get(line, "rates"));
        a->jacobians = json_number_value(json_object_get(line, "jacobians"));
        a->done = true;
    }
    json_decref(line);
}

static void print_rows(const bench *b, const bench_problem *p, int index)
{
    char name[3][64];
    static const char *const what[3] = {"", " (J)", " (time)"};
    answer ours = {.seconds = NAN}, fine = {.seconds = NAN}, peer, truth;
    for (int i = 0; i < 3; i++) snprintf(name[i], sizeof name[i], "integrator %s%s", p->name, what[i]);
    if (!bench_wanted(b, name[0]) && !bench_wanted(b, name[1]) && !bench_wanted(b, name[2])) return;
    for (int i = 0; i < RUNS; i++) solve(&ours, p, RELATIVE);
    solve(&fine, p, 1e-11);
    solve_peer(&peer, b, index, RELATIVE, RUNS);
    solve_peer(&truth, b, index, 1e-12, 1);
    const double *end = truth.done ? truth.y : fine.y;
    bench_row row = {.name = name[0],
                     .unit = "calls",
                     .ours = ours.done ? ours.rates : NAN,
                     .peer = peer.rates,
                     .peer_name = "LSODA (SciPy)",
                     .error_unit = "tolerances",
                     .error_ours = NAN,
                     .error_peer = NAN,
                     .runs = RUNS};
    if (ours.done) row.error_ours = bench_problem_error(p, ours.y, end, RELATIVE);
    if (peer.done) row.error_peer = bench_problem_error(p, peer.y, end, RELATIVE);
    if (!peer.done) row.remark = "SciPy is not installed";
    if (truth.done && !(bench_problem_error(p, fine.y, truth.y, RELATIVE) < 0.01))
        row.remark = "no two agree on the truth";
    bench_print(b, &row);
    row.error_unit = NULL;
    row.name = name[1], row.ours = ours.jacobians, row.peer = peer.jacobians;
    bench_print(b, &row);
    row.name = name[2], row.unit = "ms", row.ours = 1e3 * ours.seconds, row.peer = 1e3 * peer.seconds;
    bench_print(b, &row);
}

void bench_integrator(const bench *b)
{
    bench_problem *p = calloc(1, sizeof *p);
    td_error error = {0};
    for (int i = 0; p && i < BENCH_PROBLEMS; i++) {
        if (b->filter && !strstr("integrator", b->filter) && !strstr(b->filter, "integrator")) break;
        if (bench_problem_make(p, i, &error))
            print_rows(b, p, i);
        else
            fprintf(stderr, "teledimos-bench: %s\n", error.message);
        bench_problem_free(p);
    }
    free(p);
}
