/* What stands behind CVODE: the rate, Newton's matrix made from our own Jacobian, the test of its
 * convergence, the weights of errors. */
#include "sim/integrator_internal.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <sunmatrix/sunmatrix_dense.h>
#include <sunnonlinsol/sunnonlinsol_fixedpoint.h>
#include <sunnonlinsol/sunnonlinsol_newton.h>

#include "sim/dense_solver_internal.h"

/* Errors of steps gather. At order 5 the number of steps grows as tolerance^(-1/6), and with it what has
 * gathered at the end, in tolerances; steps held to tolerance^(6/5) keep that about the same at every
 * tolerance: within 10 on the problems of tests/bench, where LSODA comes to 20 … 100. */
double td_integrator_share(double relative)
{
    return 0.8 * pow(relative, 0.2);
}

/* Steps that the Jacobian is kept for: twice as long where it has changed Newton's matrix by less than
 * 0.3 since the last time (in the norm of the errors), else half as long. Old ones cost more than calls of
 * the rate: what the corrector leaves over disturbs the estimate of the error, and steps get shorter
 * (Robertson: 920 steps with CVODE's constant 51, 590 with this). The matrix is made anew from it where h has
 * changed by 2 %. */
enum { LEAST_KEPT = 4, MOST_KEPT = 12 };
static const double MATRIX_CHANGE = 0.02;
/* A step grows where it could by this, not only by CVODE's 1.5: with the matrix at hand that costs nothing.
 */
static const double LEAST_GROWTH = 1.1;

static void keep_message(int code, const char *module, const char *function, char *message, void *user)
{
    td_integrator *g = user;
    (void)code, (void)module, (void)function;
    snprintf(g->message, sizeof g->message, "%s", message);
}

double td_integrator_norm(const double *v, const double *weight, size_t n)
{
    double most = 0;
    for (size_t i = 0; i < n; i++) most = fmax(most, fabs(v[i]) * weight[i]);
    return most;
}

/* Within a step the corrector calls at one t with y closing in: |change of rate| / |change of y| is a
 * Lipschitz constant in the direction that matters, for nothing. */
static void watch_lipschitz(td_integrator *g, double t, const double *y, const double *dy)
{
    size_t n = g->ode.size;
    const double *w = N_VGetArrayPointer(g->weight);
    if (g->last_valid && t == g->last_t) {
        double of_y = 0, of_rate = 0;
        for (size_t i = 0; i < n; i++) {
            of_y = fmax(of_y, fabs(y[i] - g->last_y[i]) * w[i]);
            of_rate = fmax(of_rate, fabs(dy[i] - g->last_rate[i]) * w[i]);
        }
        if (of_y > 100 * DBL_EPSILON * td_integrator_norm(y, w, n))
            g->lipschitz = fmax(g->lipschitz, of_rate / of_y);
    }
    memcpy(g->last_y, y, n * sizeof *y);
    memcpy(g->last_rate, dy, n * sizeof *dy);
    g->last_t = t;
    g->last_valid = true;
}

bool td_integrator_rate(td_integrator *g, double t, const double *y, double *dy)
{
    g->count.rates++;
    if (!g->ode.rate(dy, t, y, g->ode.user)) return false;
    for (size_t i = 0; i < g->ode.size; i++)
        if (!isfinite(dy[i])) return false;
    return true;
}

static int rate(realtype t, N_Vector y, N_Vector dy, void *user)
{
    td_integrator *g = user;
    double *in = N_VGetArrayPointer(y), *out = N_VGetArrayPointer(dy);
    if (!td_integrator_rate(g, t, in, out)) return 1;
    if (g->now == ADAMS) watch_lipschitz(g, t, in, out);
    return 0;
}

/* One column after the other by forward differences; the least increment is where the rate's rounding is an
 * error of a thousandth of a step's tolerance (as CVODE's own does it), before the first step one tolerance.
 */
static bool differences(td_integrator *g, double *j, double t, double *y, const double *dy, double *changed)
{
    size_t n = g->ode.size;
    const double *w = N_VGetArrayPointer(g->weight);
    double h = fabs(g->count.step_s),
           least = 1000 * h * DBL_EPSILON * (double)n * td_integrator_norm(dy, w, n);
    if (!(least > 0)) least = 1;
    for (size_t k = 0; k < n; k++) {
        double keep = y[k];
        y[k] += fmax(sqrt(DBL_EPSILON) * fabs(keep), least / w[k]);
        double by = y[k] - keep;
        bool ok = td_integrator_rate(g, t, y, changed);
        y[k] = keep;
        if (!ok) return false;
        for (size_t i = 0; i < n; i++) j[i * n + k] = (changed[i] - dy[i]) / by;
    }
    return true;
}

/* Into g->jacobian, its norm and how far it is from the last. */
static bool make_jacobian(td_integrator *g, double t, double *y, const double *dy, double *changed)
{
    size_t n = g->ode.size;
    const double *w = N_VGetArrayPointer(g->weight);
    double norm = 0, change = 0, *j = calloc(n * n, sizeof *j);
    if (!j) return false;
    g->count.jacobians++;
    bool ok =
        g->ode.jacobian ? g->ode.jacobian(j, t, y, dy, g->ode.user) : differences(g, j, t, y, dy, changed);
    for (size_t i = 0; ok && i < n; i++) {
        double sum = 0, off = 0; /* of row i, in the norm in which errors are weighed */
        for (size_t k = 0; k < n; k++) {
            const double one = j[i * n + k];
            sum += fabs(one) / w[k];
            off += fabs(one - g->jacobian[k * n + i]) / w[k];
            g->jacobian[k * n + i] = one;
        }
        norm = fmax(norm, sum * w[i]);
        change = fmax(change, off * w[i]);
    }
    free(j);
    g->lipschitz = norm;
    g->jacobian_change = change;
    return ok && isfinite(norm);
}

static void choose_kept(td_integrator *g, double gamma)
{
    if (fabs(gamma) * g->jacobian_change < 0.3)
        g->kept = g->kept < MOST_KEPT / 2 ? 2 * g->kept : MOST_KEPT;
    else
        g->kept = g->kept / 2 > LEAST_KEPT ? g->kept / 2 : LEAST_KEPT;
}

/* Newton's matrix I - gamma J. J stays while it is young, after a start from a new state too. Where CVODE
 * asks a second time in a step, the corrector or the step's error has failed with it, and it is not trusted;
 * a third time, nor is what is remembered of the contraction. */
static int newton_matrix(realtype t, N_Vector y, N_Vector dy, SUNMatrix matrix, booleantype keep,
                         booleantype *made, realtype gamma, void *user, N_Vector t1, N_Vector t2, N_Vector t3)
{
    td_integrator *g = user;
    const size_t n = g->ode.size;
    const bool again = g->matrix_step == g->count.steps, first = g->jacobian_step < 0;
    (void)t2, (void)t3;
    g->matrix_step = g->count.steps;
    *made = first || again || (!keep && g->count.steps - g->jacobian_step >= g->kept);
    g->again = again ? g->again + 1 : 0;
    if (g->again > 1) g->contraction = 1;
    if (*made) {
        if (!make_jacobian(g, t, N_VGetArrayPointer(y), N_VGetArrayPointer(dy), N_VGetArrayPointer(t1)))
            return 1;
        if (!first && !again) choose_kept(g, gamma);
        g->jacobian_step = g->count.steps;
    }
    double *const a = SM_DATA_D(matrix);
    for (size_t i = 0; i < n * n; i++) a[i] = -gamma * g->jacobian[i];
    for (size_t i = 0; i < n; i++) a[i * (n + 1)] += 1;
    return 0;
}

/* Newton has converged where the next change would be within `tolerance`: the last one times the contraction.
 * CVODE forgets the contraction with each new matrix, and so asks for a second iteration, a rate each, in
 * every step; here what was seen last holds, also for the steps to come. */
static int newton_converged(SUNNonlinearSolver solver, N_Vector y, N_Vector change, realtype tolerance,
                            N_Vector weight, void *user)
{
    td_integrator *g = user;
    const double size = N_VWrmsNorm(change, weight);
    int iteration = 0;
    (void)y;
    SUNNonlinSolGetCurIter(solver, &iteration);
    if (iteration > 0) {
        g->contraction = fmax(0.2 * g->contraction, size / g->last_change);
        if (size > 2 * g->last_change) {
            g->contraction = 1;
            return SUN_NLS_CONV_RECVR;
        }
    }
    g->last_change = size;
    return size * fmin(1, g->contraction) > tolerance ? SUN_NLS_CONTINUE : SUN_NLS_SUCCESS;
}

/* The Euclidean norm of errors over tolerances, CVODE's being their mean square's root: one state that errs
 * among twenty that do not must not hide behind them. */
static int weigh(N_Vector y, N_Vector weight, void *user)
{
    td_integrator *g = user;
    const double *at = N_VGetArrayPointer(y), *absolute = N_VGetArrayPointer(g->absolute);
    double *w = N_VGetArrayPointer(weight);
    for (size_t i = 0; i < g->ode.size; i++) w[i] = g->root_size / (g->relative * fabs(at[i]) + absolute[i]);
    return 0;
}

/* ---- making ---- */

bool td_integrator_vectors(td_integrator *g, const td_integrator_options *o, const double *y)
{
    size_t n = g->ode.size;
    N_Vector *vectors[8] = {&g->absolute, &g->y,       &g->step_end, &g->weight,
                            &g->error,    &g->event_y, &g->probe,    &g->probe_rate};
    for (int k = 0; k < 8; k++)
        if (!(*vectors[k] = N_VNew_Serial((sunindextype)n, g->context))) return false;
    g->last_y = malloc(n * sizeof *g->last_y);
    g->last_rate = malloc(n * sizeof *g->last_rate);
    if (!g->last_y || !g->last_rate) return false;
    for (size_t i = 0; i < n; i++) {
        const double a = o->absolute ? o->absolute[i] : 1e-9;
        N_VGetArrayPointer(g->absolute)[i] = td_integrator_share(o->relative) * a;
    }
    memcpy(N_VGetArrayPointer(g->y), y, n * sizeof *y);
    return weigh(g->y, g->weight, g) == 0;
}

static bool make_adams(td_integrator *g, void *memory)
{
    g->fixed_point = SUNNonlinSol_FixedPoint(g->y, 0, g->context);
    return g->fixed_point && CVodeSetNonlinearSolver(memory, g->fixed_point) == CV_SUCCESS;
}

static bool make_bdf(td_integrator *g, void *memory)
{
    const sunindextype n = (sunindextype)g->ode.size;
    g->contraction = 1;
    g->jacobian_step = g->matrix_step = -1;
    g->kept = LEAST_KEPT;
    g->jacobian = calloc(g->ode.size * g->ode.size, sizeof *g->jacobian);
    g->matrix = SUNDenseMatrix(n, n, g->context);
    g->linear = g->matrix ? td_dense_solver(n, g->context) : NULL;
    g->newton = SUNNonlinSol_Newton(g->y, g->context);
    return g->jacobian && g->linear && g->newton &&
           CVodeSetNonlinearSolver(memory, g->newton) == CV_SUCCESS &&
           SUNNonlinSolSetConvTestFn(g->newton, newton_converged, g) == SUN_NLS_SUCCESS &&
           CVodeSetLinearSolver(memory, g->linear, g->matrix) == CV_SUCCESS &&
           CVodeSetLinSysFn(memory, newton_matrix) == CV_SUCCESS &&
           CVodeSetJacEvalFrequency(memory, LEAST_KEPT) == CV_SUCCESS &&
           CVodeSetLSetupFrequency(memory, LEAST_KEPT) == CV_SUCCESS &&
           CVodeSetDeltaGammaMaxLSetup(memory, MATRIX_CHANGE) == CV_SUCCESS;
}

bool td_integrator_memory(td_integrator *g, int which)
{
    void *m = g->memory[which] = CVodeCreate(which == ADAMS ? CV_ADAMS : CV_BDF, g->context);
    if (!m || CVodeSetErrHandlerFn(m, keep_message, g) != CV_SUCCESS) return false;
    bool ok = CVodeInit(m, rate, g->t, g->y) == CV_SUCCESS && CVodeWFtolerances(m, weigh) == CV_SUCCESS &&
              CVodeSetUserData(m, g) == CV_SUCCESS &&
              CVodeSetEtaFixedStepBounds(m, 0, LEAST_GROWTH) == CV_SUCCESS &&
              (which == ADAMS ? make_adams(g, m) : make_bdf(g, m));
    if (g->max_step_s > 0) ok = ok && CVodeSetMaxStep(m, g->max_step_s) == CV_SUCCESS;
    return ok;
}
