/* The problems that the integrator and its peer are both given: the same functions, counted. */
#ifndef TELEDIMOS_TESTS_BENCH_INTEGRATOR_PROBLEMS_H
#define TELEDIMOS_TESTS_BENCH_INTEGRATOR_PROBLEMS_H

#include "sim/machine.h"
#include "tests/sim/problems.h"

enum { BENCH_PROBLEMS = 13, BENCH_PROBLEM_STATES = 32 };

typedef struct bench_problem {
    const char *name;
    td_ode ode;
    double y0[BENCH_PROBLEM_STATES], t_end;
    double absolute[BENCH_PROBLEM_STATES]; /* as shares of the relative tolerance */
    problem standard;
    td_machine *machine;
} bench_problem;

/* `p` must stay where it is. False: `error` says why. */
bool bench_problem_make(bench_problem *p, int index, td_error *error);
void bench_problem_free(bench_problem *p);
/* max |end - truth| / (relative (|truth| + absolute)) */
double bench_problem_error(const bench_problem *p, const double *end, const double *truth, double relative);

#endif
