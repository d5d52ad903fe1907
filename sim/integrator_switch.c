/* Petzold's rule (SIAM J. Sci. Stat. Comput. 4, 1983, 136; as in LSODA) over CVODE: at each step, from the
 * twentieth after a start or a switch on, what step could either method take?
 *
 *   by accuracy    r = 1 / (1.2 d^(1/(q+1)) + 1.2e-6),   d the local error over its tolerance at order q; the
 *                  other method's d is that times the ratio of the error constants
 *   by stability   r = s_q / (L |h|) for Adams: s_q the reach of its stability region, L a Lipschitz constant
 *
 * LSODA leaves Adams where BDF's step would be five times its own and returns where Adams' would be no
 * smaller: its BDF asks for two rates a step and more. Here Newton's matrix is made from our own Jacobian and
 * follows the step, and a step asks for 1.1 rates, one of Adams for 1.8: so Adams gives way as soon as BDF's
 * step would be as long, and gets the work back where its own would have been 1.3 times as long for a hundred
 * steps, for each start from order 1 costs some forty rates. (1.44 is the most that error constants give it.)
 */
#include "sim/integrator_internal.h"

#include <float.h>
#include <math.h>

enum { STEPS_BEFORE_TEST = 20 };

/* Above it the two cannot be compared. */
enum { MOST_SHARED_ORDER = 5 };

static const double RETURN = 1.3;
enum { EASY_STEPS = 100, RIM_STEPS = 10 };

/* Adds what CVODE counted since its memory was last begun; its own counters begin anew then. */
static void bank(td_integrator *g)
{
    long rejected = 0, newton = 0;
    CVodeGetNumErrTestFails(g->memory[g->now], &rejected);
    if (g->now == BDF) CVodeGetNumNonlinSolvIters(g->memory[g->now], &newton);
    g->base_rejected += rejected;
    g->base_newton += newton;
}

td_status td_integrator_begin(td_integrator *g, int which, double t, N_Vector y, double first_step,
                              td_error *error)
{
    bank(g);
    g->now = which;
    g->since = g->settled = 0;
    g->conv_fails = 0;
    g->lipschitz = 0;
    g->contraction = 1;
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

/* Of Adams' stability region, by order. */
static const double REACH[12] = {.5, .575, .55, .45, .35, .25, .2, .15, .1, .075, .05, .025};

static double capped_by_stability(double ratio, double lipschitz, double h, int order)
{
    double lh = lipschitz * fabs(h);
    return lh * ratio > 1e-5 ? fmin(ratio, REACH[order - 1] / lh) : ratio;
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
    o.error = td_integrator_norm(N_VGetArrayPointer(g->error), w, g->ode.size);
    o.size = td_integrator_norm(N_VGetArrayPointer(g->step_end), w, g->ode.size);
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
    if (!td_integrator_rate(g, g->last_t, at, out)) return;
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
    /* LSODA keeps its steps within the reach; CVODE does not know of it. Held at the rim of its stability by
     * an error that is noise, Adams would stay there for ever. */
    if (o->order > MOST_SHARED_ORDER) {
        g->settled = g->lipschitz * fabs(o->h) > REACH[o->order - 1] ? g->settled + 1 : 0;
        return g->settled >= RIM_STEPS;
    }
    g->settled = 0;
    o->adams = capped_by_stability(by_accuracy(o->error, o->order), g->lipschitz, o->h, o->order);
    o->bdf = by_accuracy(o->error / bdf_over_adams(o->order), o->order);
    return o->bdf >= o->adams;
}

static bool leave_bdf(td_integrator *g, outlook *o)
{
    double error = o->error * bdf_over_adams(o->order);
    o->adams = capped_by_stability(by_accuracy(error, o->order), g->lipschitz, o->h, o->order);
    o->bdf = by_accuracy(o->error, o->order);
    g->settled = o->adams < RETURN * o->bdf ? 0 : g->settled + 1;
    if (g->settled < EASY_STEPS) return false;
    double predicted = error * pow(fmax(1e-3, o->adams), o->order + 1);
    return predicted > 1000 * DBL_EPSILON * o->size;
}

void td_integrator_consider(td_integrator *g)
{
    outlook o = look(g);
    g->count.order = o.order;
    g->count.step_s = o.h;
    if (g->now == BDF) g->count.time_in_bdf_s += o.h;
    if (g->method != TD_INTEGRATOR_AUTO || ++g->since < STEPS_BEFORE_TEST) return;
    g->want_switch = g->now == ADAMS ? leave_adams(g, &o) : leave_bdf(g, &o);
    if (g->now == ADAMS) g->lipschitz = 0; /* gathered anew from the next step */
}

td_status td_integrator_change(td_integrator *g, td_error *error)
{
    int other = g->now == ADAMS ? BDF : ADAMS;
    if (other == BDF)
        g->count.to_bdf++;
    else
        g->count.to_adams++;
    return td_integrator_begin(g, other, g->reached, g->step_end, 0, error);
}
