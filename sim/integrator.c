/* Petzold's rule (SIAM J. Sci. Stat. Comput. 4, 1983, 136; as in LSODA) over CVODE: at each step, from the
 * twentieth after a start or a switch on, what step could either method take?
 *
 *   by accuracy    r = 1 / (1.2 d^(1/(q+1)) + 1.2e-6),   d the local error over its tolerance at order q; the
 * other method's d is that times the ratio of the error constants by stability   r = s_q / (L |h|) for Adams:
 * s_q the reach of its stability region, L a Lipschitz constant
 *
 * Adams gives way when BDF's step would be five times its own; BDF gives way when Adams' would be no smaller.
 */
#include "sim/integrator.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cvode/cvode.h>
#include <nvector/nvector_serial.h>
#include <sunmatrix/sunmatrix_dense.h>
#include <sunnonlinsol/sunnonlinsol_fixedpoint.h>

#include "sim/dense_solver_internal.h"

enum { ADAMS, BDF, STEPS_BEFORE_TEST = 20 };

/* Above order 5 the two cannot be compared, and Adams held at the rim of its stability can stay there for
 * ever. */
enum { MOST_SHARED_ORDER = 5 };

/* Errors of steps gather: held at a fortieth of the tolerance, what has gathered at the end stays near it (on
 * the problems of the bench within 6 times, where LSODA comes to 50). */
static const double LOCAL_SHARE = 0.025;

struct td_integrator {
    td_ode ode;
    td_integrator_method method;
    double relative, max_step_s, first_step_s;
    long max_steps;
    SUNContext context;
    void *memory[2]; /* of CVODE, by ADAMS and BDF; NULL: not needed */
    N_Vector absolute, y, step_end, weight, error, probe, probe_rate;
    SUNMatrix matrix;
    SUNLinearSolver linear;
    SUNNonlinearSolver fixed_point;
    int now;        /* ADAMS or BDF */
    double t;       /* that y is at */
    double reached; /* end of the last internal step, which step_end is at */
    /* Events: sides are those of g > 0, told to the caller, and found at `checked`, until where was looked.
     */
    double checked;
    bool told[TD_ODE_MAX_EVENTS], found[TD_ODE_MAX_EVENTS], zero[TD_ODE_MAX_EVENTS], from_zero;
    bool event_pending; /* one was found, at event_t, and not yet told */
    double event_t;
    int event;
    N_Vector event_y;
    bool want_switch;
    long since;       /* steps since the start or a switch */
    double lipschitz; /* of the corrector's iterations since the last test (Adams), of the Jacobian (BDF) */
    double *last_y, *last_rate; /* (n) of the last call of rate */
    double last_t;
    bool last_valid;
    long conv_fails;                 /* of the present memory, when last looked at */
    long base_rejected, base_newton; /* of memories that were started anew */
    td_integrator_counters count;
    char message[256]; /* CVODE's */
};

td_integrator_options td_integrator_options_default(void)
{
    return (td_integrator_options){.method = TD_INTEGRATOR_AUTO, .relative = 1e-6, .max_steps = 1000000};
}

/* ---- what CVODE calls ---- */

static void keep_message(int code, const char *module, const char *function, char *message, void *user)
{
    td_integrator *g = user;
    (void)code, (void)module, (void)function;
    snprintf(g->message, sizeof g->message, "%s", message);
}

static double weighted_max(const double *v, const double *weight, size_t n)
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
        if (of_y > 100 * DBL_EPSILON * weighted_max(y, w, n))
            g->lipschitz = fmax(g->lipschitz, of_rate / of_y);
    }
    memcpy(g->last_y, y, n * sizeof *y);
    memcpy(g->last_rate, dy, n * sizeof *dy);
    g->last_t = t;
    g->last_valid = true;
}

static bool call_rate(td_integrator *g, double t, const double *y, double *dy)
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
    if (!call_rate(g, t, in, out)) return 1;
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
    double h = fabs(g->count.step_s), least = 1000 * h * DBL_EPSILON * (double)n * weighted_max(dy, w, n);
    if (!(least > 0)) least = 1;
    for (size_t k = 0; k < n; k++) {
        double keep = y[k];
        y[k] += fmax(sqrt(DBL_EPSILON) * fabs(keep), least / w[k]);
        double by = y[k] - keep;
        bool ok = call_rate(g, t, y, changed);
        y[k] = keep;
        if (!ok) return false;
        for (size_t i = 0; i < n; i++) j[i * n + k] = (changed[i] - dy[i]) / by;
    }
    return true;
}

static int jacobian(realtype t, N_Vector y, N_Vector dy, SUNMatrix matrix, void *user, N_Vector t1,
                    N_Vector t2, N_Vector t3)
{
    td_integrator *g = user;
    size_t n = g->ode.size;
    const double *w = N_VGetArrayPointer(g->weight);
    double *in = N_VGetArrayPointer(y), norm = 0, *j = calloc(n * n, sizeof *j);
    (void)t2, (void)t3;
    if (!j) return -1;
    g->count.jacobians++;
    bool ok = g->ode.jacobian ? g->ode.jacobian(j, t, in, N_VGetArrayPointer(dy), g->ode.user)
                              : differences(g, j, t, in, N_VGetArrayPointer(dy), N_VGetArrayPointer(t1));
    for (size_t i = 0; ok && i < n; i++) {
        double sum = 0; /* of row i, in the norm in which errors are weighed */
        for (size_t k = 0; k < n; k++) {
            SM_ELEMENT_D(matrix, (sunindextype)i, (sunindextype)k) = j[i * n + k];
            sum += fabs(j[i * n + k]) / w[k];
        }
        norm = fmax(norm, sum * w[i]);
    }
    free(j);
    if (!ok || !isfinite(norm)) return 1;
    g->lipschitz = norm;
    return 0;
}

/* ---- events ---- */

static void sides(const td_integrator *g, bool *side, double t, N_Vector y)
{
    double value[TD_ODE_MAX_EVENTS];
    if (g->ode.event_count == 0) return;
    g->ode.events(value, t, N_VGetArrayPointer(y), g->ode.user);
    for (size_t k = 0; k < g->ode.event_count; k++) side[k] = value[k] > 0;
}

/* From y: the side each is on there is no event. One that begins at 0 is on the side it goes to. */
static void watch_events(td_integrator *g, double t, N_Vector y)
{
    double value[TD_ODE_MAX_EVENTS];
    g->checked = t;
    g->event_pending = g->from_zero = false;
    if (g->ode.event_count == 0) return;
    g->ode.events(value, t, N_VGetArrayPointer(y), g->ode.user);
    for (size_t k = 0; k < g->ode.event_count; k++) {
        g->told[k] = g->found[k] = value[k] > 0;
        g->zero[k] = value[k] == 0;
        g->from_zero = g->from_zero || g->zero[k];
    }
}

/* ---- making and freeing ---- */

void td_integrator_free(td_integrator **integrator)
{
    if (!integrator || !*integrator) return;
    td_integrator *g = *integrator;
    for (int k = 0; k < 2; k++)
        if (g->memory[k]) CVodeFree(&g->memory[k]);
    if (g->linear) SUNLinSolFree(g->linear);
    if (g->fixed_point) SUNNonlinSolFree(g->fixed_point);
    if (g->matrix) SUNMatDestroy(g->matrix);
    N_Vector vectors[8] = {g->absolute, g->y,       g->step_end, g->weight,
                           g->error,    g->event_y, g->probe,    g->probe_rate};
    for (int k = 0; k < 8; k++)
        if (vectors[k]) N_VDestroy(vectors[k]);
    if (g->context) SUNContext_Free(&g->context);
    free(g->last_y);
    free(g->last_rate);
    free(g);
    *integrator = NULL;
}

static bool make_vectors(td_integrator *g, const td_integrator_options *o, const double *y)
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
        double a = LOCAL_SHARE * (o->absolute ? o->absolute[i] : 1e-9);
        N_VGetArrayPointer(g->absolute)[i] = a;
        N_VGetArrayPointer(g->weight)[i] = 1 / (g->relative * fabs(y[i]) + a);
    }
    memcpy(N_VGetArrayPointer(g->y), y, n * sizeof *y);
    return true;
}

static bool make_memory(td_integrator *g, int which)
{
    void *m = g->memory[which] = CVodeCreate(which == ADAMS ? CV_ADAMS : CV_BDF, g->context);
    if (!m || CVodeSetErrHandlerFn(m, keep_message, g) != CV_SUCCESS) return false;
    if (CVodeInit(m, rate, g->t, g->y) != CV_SUCCESS ||
        CVodeSVtolerances(m, g->relative, g->absolute) != CV_SUCCESS)
        return false;
    bool ok = CVodeSetUserData(m, g) == CV_SUCCESS;
    if (g->max_step_s > 0) ok = ok && CVodeSetMaxStep(m, g->max_step_s) == CV_SUCCESS;
    if (which == ADAMS) {
        g->fixed_point = SUNNonlinSol_FixedPoint(g->y, 0, g->context);
        if (g->method == TD_INTEGRATOR_AUTO) ok = ok && CVodeSetMaxOrd(m, MOST_SHARED_ORDER) == CV_SUCCESS;
        ok = ok && g->fixed_point && CVodeSetNonlinearSolver(m, g->fixed_point) == CV_SUCCESS;
    } else {
        sunindextype n = (sunindextype)g->ode.size;
        g->matrix = SUNDenseMatrix(n, n, g->context);
        g->linear = g->matrix ? td_dense_solver(n, g->context) : NULL;
        ok = ok && g->linear && CVodeSetLinearSolver(m, g->linear, g->matrix) == CV_SUCCESS &&
             CVodeSetJacFn(m, jacobian) == CV_SUCCESS;
    }
    return ok;
}

static td_status check(const td_ode *ode, double t, const double *y, const td_integrator_options *o,
                       td_error *error)
{
    if (!ode->rate || ode->size < 1 || ode->size > TD_ODE_MAX_SIZE)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "integrator: 1 to %d states with a rate are wanted, %zu are given", TD_ODE_MAX_SIZE,
                       ode->size);
    if (ode->event_count > TD_ODE_MAX_EVENTS || (ode->event_count && !ode->events))
        return td_fail(error, TD_ERROR_ARGUMENT, "integrator: at most %d events, with their function",
                       TD_ODE_MAX_EVENTS);
    if (!(o->relative >= 1e-14 && o->relative <= 0.1))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "integrator: relative tolerance %g is not within 1e-14 to 0.1", o->relative);
    if (!(o->max_step_s >= 0) || !(o->first_step_s >= 0) || o->max_steps < 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "integrator: steps must not be negative, max_steps at least 1");
    if (!isfinite(t)) return td_fail(error, TD_ERROR_DATA, "integrator: the time it starts at is no number");
    for (size_t i = 0; i < ode->size; i++) {
        if (!isfinite(y[i]))
            return td_fail(error, TD_ERROR_DATA, "integrator: state %zu is no number at its start", i);
        if (o->absolute && !(o->absolute[i] > 0))
            return td_fail(error, TD_ERROR_ARGUMENT, "integrator: absolute tolerance %zu is not positive", i);
    }
    return TD_OK;
}

td_status td_integrator_new(td_integrator **integrator, const td_ode *ode, double t, const double *y,
                            const td_integrator_options *options, td_error *error)
{
    const td_integrator_options o = options ? *options : td_integrator_options_default();
    *integrator = NULL;
    TD_TRY(check(ode, t, y, &o, error));
    td_integrator *g = calloc(1, sizeof *g);
    if (!g) return td_fail(error, TD_ERROR_MEMORY, "integrator: no memory for %zu states", ode->size);
    *g = (td_integrator){.ode = *ode,
                         .method = o.method,
                         .relative = LOCAL_SHARE * o.relative,
                         .max_step_s = o.max_step_s,
                         .first_step_s = o.first_step_s,
                         .max_steps = o.max_steps,
                         .now = o.method == TD_INTEGRATOR_BDF ? BDF : ADAMS,
                         .t = t,
                         .reached = t};
    bool ok = SUNContext_Create(NULL, &g->context) == 0 && make_vectors(g, &o, y);
    if (ok && o.method != TD_INTEGRATOR_BDF) ok = make_memory(g, ADAMS);
    if (ok && o.method != TD_INTEGRATOR_ADAMS) ok = make_memory(g, BDF);
    if (!ok) {
        td_status status = td_fail(error, TD_ERROR_MEMORY, "integrator: no memory for %zu states%s%s",
                                   ode->size, g->message[0] ? ": " : "", g->message);
        td_integrator_free(&g);
        return status;
    }
    watch_events(g, t, g->y);
    if (g->first_step_s > 0) CVodeSetInitStep(g->memory[g->now], g->first_step_s);
    N_VScale(1, g->y, g->step_end);
    *integrator = g;
    return TD_OK;
}

/* ---- switching ---- */

/* Adds what CVODE counted since its memory was last begun; its own counters begin anew then. */
static void bank(td_integrator *g)
{
    long rejected = 0, newton = 0;
    CVodeGetNumErrTestFails(g->memory[g->now], &rejected);
    if (g->now == BDF) CVodeGetNumNonlinSolvIters(g->memory[g->now], &newton);
    g->base_rejected += rejected;
    g->base_newton += newton;
}

static td_status begin(td_integrator *g, int which, double t, N_Vector y, double first_step, td_error *error)
{
    bank(g);
    g->now = which;
    g->since = 0;
    g->conv_fails = 0;
    g->lipschitz = 0;
    g->last_valid = false;
    g->want_switch = false;
    if (CVodeReInit(g->memory[which], t, y) != CV_SUCCESS ||
        CVodeSetInitStep(g->memory[which], first_step) != CV_SUCCESS)
        return td_fail(error, TD_ERROR_DATA, "integrator at t = %g s: %s", t, g->message);
    return TD_OK;
}

/* What both methods could do, from the last step. */
typedef struct outlook {
    int order;
    double h, error, size; /* size: of the state, weighted */
    double adams, bdf;     /* ratios of the next step to the last */
} outlook;

static double by_accuracy(double error, int order)
{
    return 1 / (1.2 * pow(error, 1.0 / (order + 1)) + 1.2e-6);
}

static double capped_by_stability(double ratio, double lipschitz, double h, int order)
{
    static const double reach[12] = {.5, .575, .55, .45, .35, .25, .2, .15, .1, .075, .05, .025};
    double lh = lipschitz * fabs(h);
    return lh * ratio > 1e-5 ? fmin(ratio, reach[order - 1] / lh) : ratio;
}

/* Error constants of order q: Adams' 1 / |int_-1^0 x (x+1) … (x+q-1) dx|, BDF's (q+1)/q!. */
static double bdf_over_adams(int order)
{
    static const double adams[5] = {2, 6, 4, 30.0 / 19, 4.0 / 9}, bdf[5] = {2, 1.5, 2.0 / 3, 5.0 / 24, 0.05};
    return bdf[order - 1] / adams[order - 1];
}

static outlook look(td_integrator *g)
{
    outlook o = {0};
    void *m = g->memory[g->now];
    CVodeGetLastOrder(m, &o.order);
    CVodeGetLastStep(m, &o.h);
    CVodeGetErrWeights(m, g->weight);
    CVodeGetEstLocalErrors(m, g->error);
    const double *w = N_VGetArrayPointer(g->weight);
    o.error = weighted_max(N_VGetArrayPointer(g->error), w, g->ode.size);
    o.size = weighted_max(N_VGetArrayPointer(g->step_end), w, g->ode.size);
    return o;
}

/* The corrector was content with one call, so the Lipschitz constant is not known: one more call, off by one
 * tolerance along the local error, which is where an unstable step grows. */
static void probe_lipschitz(td_integrator *g, double error)
{
    size_t n = g->ode.size;
    const double *w = N_VGetArrayPointer(g->weight), *e = N_VGetArrayPointer(g->error);
    double *at = N_VGetArrayPointer(g->probe), *out = N_VGetArrayPointer(g->probe_rate), most = 0;
    if (!g->last_valid || !(error > 0)) return;
    for (size_t i = 0; i < n; i++) at[i] = g->last_y[i] + e[i] / error;
    if (!call_rate(g, g->last_t, at, out)) return;
    for (size_t i = 0; i < n; i++) most = fmax(most, fabs(out[i] - g->last_rate[i]) * w[i]);
    g->lipschitz = most;
}

static bool leave_adams(td_integrator *g, outlook *o)
{
    long fails = 0;
    CVodeGetNumNonlinSolvConvFails(g->memory[ADAMS], &fails);
    bool limited = fails > g->conv_fails;
    g->conv_fails = fails;
    if (g->lipschitz == 0 && g->since % 10 == 0) probe_lipschitz(g, o->error);
    /* The error says nothing: the motion stands still, or the corrector was not needed. Then only what the
     * corrector could not do counts. */
    if (o->error <= 100 * o->size * DBL_EPSILON || g->lipschitz == 0) {
        o->bdf = 2;
        return limited;
    }
    o->adams = capped_by_stability(by_accuracy(o->error, o->order), g->lipschitz, o->h, o->order);
    o->bdf = by_accuracy(o->error / bdf_over_adams(o->order), o->order);
    return o->bdf >= 2 * o->adams;
}

static bool leave_bdf(const td_integrator *g, outlook *o)
{
    double error = o->error * bdf_over_adams(o->order);
    o->adams = capped_by_stability(by_accuracy(error, o->order), g->lipschitz, o->h, o->order);
    o->bdf = by_accuracy(o->error, o->order);
    if (o->adams < 1.4 * o->bdf) return false;
    double predicted = error * pow(fmax(1e-3, o->adams), o->order + 1);
    return predicted > 1000 * DBL_EPSILON * o->size;
}

static void consider_switch(td_integrator *g)
{
    outlook o = look(g);
    g->count.order = o.order;
    g->count.step_s = o.h;
    if (g->now == BDF) g->count.time_in_bdf_s += o.h;
    if (g->method != TD_INTEGRATOR_AUTO || ++g->since < STEPS_BEFORE_TEST) return;
    g->want_switch = g->now == ADAMS ? leave_adams(g, &o) : leave_bdf(g, &o);
    if (g->now == ADAMS) g->lipschitz = 0; /* gathered anew from the next step */
}

static td_status change_method(td_integrator *g, td_error *error)
{
    int other = g->now == ADAMS ? BDF : ADAMS;
    if (other == BDF)
        g->count.to_bdf++;
    else
        g->count.to_adams++;
    return begin(g, other, g->reached, g->step_end, 0, error);
}

/* ---- stepping ---- */

static td_status give_up(td_integrator *g, td_error *error)
{
    outlook o = look(g);
    const double *w = N_VGetArrayPointer(g->weight), *e = N_VGetArrayPointer(g->error);
    size_t worst = 0;
    for (size_t i = 1; i < g->ode.size; i++)
        if (fabs(e[i]) * w[i] > fabs(e[worst]) * w[worst]) worst = i;
    return td_fail(error, TD_ERROR_DATA,
                   "integrator stopped at t = %.9g s (step %.3g s, worst state %zu = %.6g): %s", g->reached,
                   o.h, worst, N_VGetArrayPointer(g->step_end)[worst], g->message);
}

/* One internal step of CVODE. */
static td_status step(td_integrator *g, td_error *error)
{
    if (g->want_switch) TD_TRY(change_method(g, error));
    void *m = g->memory[g->now];
    double t;
    long before = 0, after = 0;
    CVodeGetNumSteps(m, &before);
    /* The end is only a direction: the steps, and so the result, do not depend on where the caller stops. */
    int flag = CVode(m, g->reached + 1e4, g->step_end, &t, CV_ONE_STEP);
    CVodeGetNumSteps(m, &after);
    g->count.steps += after - before;
    CVodeGetCurrentTime(m, &g->reached);
    if (flag != CV_SUCCESS) {
        if (g->method != TD_INTEGRATOR_AUTO || g->now != ADAMS ||
            (flag != CV_CONV_FAILURE && flag != CV_ERR_FAILURE))
            return give_up(g, error);
        g->reached = t;
        return change_method(g, error);
    }
    consider_switch(g);
    return TD_OK;
}

/* ---- finding events ---- */

/* Those that began at 0 have gone to a side a tenth of the first step later. */
static bool leave_zero(td_integrator *g)
{
    bool side[TD_ODE_MAX_EVENTS];
    const double t = g->checked + 0.1 * (g->reached - g->checked);
    g->from_zero = false;
    if (CVodeGetDky(g->memory[g->now], t, 0, g->probe) != CV_SUCCESS) return false;
    sides(g, side, t, g->probe);
    for (size_t k = 0; k < g->ode.event_count; k++)
        if (g->zero[k]) g->told[k] = side[k];
    return true;
}

/* Moves `checked` to where, in (checked, reached], a side first differs from what was told (within rounding
 * of time, behind the change), or to reached. By halving: unlike CVODE's own search, it ends for any
 * function, also one whose sign is rounding (a joint that rests on its stop). */
static bool find_change(td_integrator *g)
{
    const size_t bytes = g->ode.event_count * sizeof *g->told;
    void *m = g->memory[g->now];
    double low = g->checked, high = g->reached, h = 0;
    if (g->from_zero && !leave_zero(g)) return false;
    N_VScale(1, g->step_end, g->event_y);
    sides(g, g->found, high, g->event_y);
    g->checked = high;
    if (memcmp(g->found, g->told, bytes) == 0) return true;
    CVodeGetLastStep(m, &h);
    while (high - low > 100 * DBL_EPSILON * (fabs(high) + fabs(h))) {
        bool side[TD_ODE_MAX_EVENTS];
        const double middle = low + (high - low) / 2;
        if (CVodeGetDky(m, middle, 0, g->probe) != CV_SUCCESS) return false;
        sides(g, side, middle, g->probe);
        if (memcmp(side, g->told, bytes) == 0) {
            low = middle;
            continue;
        }
        high = middle;
        memcpy(g->found, side, bytes);
        N_VScale(1, g->probe, g->event_y);
    }
    g->checked = high;
    return true;
}

/* The next event of the last step; of several at one time, the first in order. */
static td_status find_event(td_integrator *g, td_error *error)
{
    while (!g->event_pending) {
        size_t k = 0;
        while (k < g->ode.event_count && g->found[k] == g->told[k]) k++;
        if (k < g->ode.event_count) {
            g->event_pending = true;
            g->event_t = g->checked;
            g->event = (int)k;
        } else if (g->checked >= g->reached) {
            break;
        } else if (!find_change(g)) {
            return give_up(g, error);
        }
    }
    return TD_OK;
}

/* ---- going on ---- */

td_status td_integrator_advance(td_integrator *g, double t_end, int *event, int *direction, td_error *error)
{
    long begun = g->count.steps;
    *event = -1;
    if (!(t_end >= g->t) || !isfinite(t_end))
        return td_fail(error, TD_ERROR_ARGUMENT, "integrator: cannot go from t = %.9g s to %.9g s", g->t,
                       t_end);
    for (;;) {
        TD_TRY(find_event(g, error));
        if (g->event_pending && g->event_t <= t_end) {
            g->event_pending = false;
            g->count.events++;
            g->told[g->event] = g->found[g->event];
            g->t = g->event_t;
            N_VScale(1, g->event_y, g->y);
            *event = g->event;
            if (direction) *direction = g->told[g->event] ? 1 : -1;
            return TD_OK;
        }
        if (g->reached >= t_end) break;
        if (g->count.steps - begun >= g->max_steps)
            return td_fail(error, TD_ERROR_DATA,
                           "integrator: more than %ld steps from t = %.9g s, now at %.9g s", g->max_steps,
                           g->t, g->reached);
        TD_TRY(step(g, error));
    }
    if (t_end > g->t && CVodeGetDky(g->memory[g->now], t_end, 0, g->y) != CV_SUCCESS)
        return give_up(g, error);
    g->t = t_end;
    return TD_OK;
}

td_status td_integrator_restart(td_integrator *g, double t, const double *y, td_error *error)
{
    for (size_t i = 0; i < g->ode.size; i++)
        if (!isfinite(y[i]))
            return td_fail(error, TD_ERROR_DATA, "integrator: state %zu is no number at t = %.9g s", i, t);
    if (!isfinite(t)) return td_fail(error, TD_ERROR_DATA, "integrator: a time that is no number");
    memmove(N_VGetArrayPointer(g->y), y, g->ode.size * sizeof *y);
    N_VScale(1, g->y, g->step_end);
    g->t = g->reached = t;
    watch_events(g, t, g->y);
    return begin(g, g->now, t, g->y, 0, error);
}

double td_integrator_time(const td_integrator *integrator)
{
    return integrator->t;
}

const double *td_integrator_state(const td_integrator *integrator)
{
    return N_VGetArrayPointer(integrator->y);
}

td_integrator_counters td_integrator_count(const td_integrator *g)
{
    td_integrator_counters c = g->count;
    long rejected = 0, newton = 0;
    CVodeGetNumErrTestFails(g->memory[g->now], &rejected);
    if (g->now == BDF) CVodeGetNumNonlinSolvIters(g->memory[g->now], &newton);
    c.rejected = g->base_rejected + rejected;
    c.newton_iterations = g->base_newton + newton;
    c.method = g->now == ADAMS ? TD_INTEGRATOR_ADAMS : TD_INTEGRATOR_BDF;
    return c;
}
