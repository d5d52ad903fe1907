#include "sim/integrator.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim/integrator_internal.h"

td_integrator_options td_integrator_options_default(void)
{
    return (td_integrator_options){.method = TD_INTEGRATOR_AUTO, .relative = 1e-6, .max_steps = 1000000};
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
    if (g->newton) SUNNonlinSolFree(g->newton);
    if (g->matrix) SUNMatDestroy(g->matrix);
    N_Vector vectors[8] = {g->absolute, g->y,       g->step_end, g->weight,
                           g->error,    g->event_y, g->probe,    g->probe_rate};
    for (int k = 0; k < 8; k++)
        if (vectors[k]) N_VDestroy(vectors[k]);
    if (g->context) SUNContext_Free(&g->context);
    free(g->last_y);
    free(g->last_rate);
    free(g->jacobian);
    free(g);
    *integrator = NULL;
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
                         /* Not below what rounding leaves of the weighted state. */
                         .relative = fmax(td_integrator_share(o.relative) * o.relative,
                                          10 * DBL_EPSILON * sqrt((double)ode->size)),
                         .root_size = sqrt((double)ode->size),
                         .max_step_s = o.max_step_s,
                         .first_step_s = o.first_step_s,
                         .max_steps = o.max_steps,
                         .now = o.method == TD_INTEGRATOR_BDF ? BDF : ADAMS,
                         .t = t,
                         .reached = t};
    bool ok = SUNContext_Create(NULL, &g->context) == 0 && td_integrator_vectors(g, &o, y);
    if (ok && o.method != TD_INTEGRATOR_BDF) ok = td_integrator_memory(g, ADAMS);
    if (ok && o.method != TD_INTEGRATOR_ADAMS) ok = td_integrator_memory(g, BDF);
    if (!ok) {
        td_status status = td_fail(error, TD_ERROR_MEMORY, "integrator: no memory for %zu states%s%s",
                                   ode->size, g->message[0] ? ": " : "", g->message);
        td_integrator_free(&g);
        return status;
    }
    td_integrator_watch(g, t, g->y);
    if (g->first_step_s > 0) CVodeSetInitStep(g->memory[g->now], g->first_step_s);
    N_VScale(1, g->y, g->step_end);
    *integrator = g;
    return TD_OK;
}

/* ---- stepping ---- */

static td_status give_up(td_integrator *g, td_error *error)
{
    void *m = g->memory[g->now];
    double h = 0;
    CVodeGetLastStep(m, &h);
    CVodeGetErrWeights(m, g->weight);
    CVodeGetEstLocalErrors(m, g->error);
    const double *w = N_VGetArrayPointer(g->weight), *e = N_VGetArrayPointer(g->error);
    size_t worst = 0;
    for (size_t i = 1; i < g->ode.size; i++)
        if (fabs(e[i]) * w[i] > fabs(e[worst]) * w[worst]) worst = i;
    return td_fail(error, TD_ERROR_DATA,
                   "integrator stopped at t = %.9g s (step %.3g s, worst state %zu = %.6g): %s", g->reached,
                   h, worst, N_VGetArrayPointer(g->step_end)[worst], g->message);
}

/* The steps behind do not fit what comes: the equations have jumped, or they were Adams' and it cannot. */
static td_status recover(td_integrator *g, double t, td_error *error)
{
    g->reached = t;
    g->jacobian_step = -1;
    if (g->method == TD_INTEGRATOR_AUTO && g->now == ADAMS) return td_integrator_change(g, error);
    return td_integrator_begin(g, g->now, t, g->step_end, 0, error);
}

/* One internal step of CVODE. */
static td_status step(td_integrator *g, td_error *error)
{
    if (g->want_switch) TD_TRY(td_integrator_change(g, error));
    void *m = g->memory[g->now];
    double t;
    long before = 0, after = 0;
    CVodeGetNumSteps(m, &before);
    /* The end is only a direction: the steps, and so the result, do not depend on where the caller stops. */
    int flag = CVode(m, g->reached + 1e4, g->step_end, &t, CV_ONE_STEP);
    CVodeGetNumSteps(m, &after);
    g->count.steps += after - before;
    CVodeGetCurrentTime(m, &g->reached);
    if (flag == CV_CONV_FAILURE || flag == CV_ERR_FAILURE)
        if (after > 0 || (g->method == TD_INTEGRATOR_AUTO && g->now == ADAMS)) return recover(g, t, error);
    if (flag != CV_SUCCESS) return give_up(g, error);
    td_integrator_consider(g);
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
        if (!td_integrator_find(g)) return give_up(g, error);
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
    td_integrator_watch(g, t, g->y);
    return td_integrator_begin(g, g->now, t, g->y, 0, error);
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
