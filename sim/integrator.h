/* y' = f(t, y), integrated as LSODA does: Adams' method while the motion is easy, BDF where it is stiff,
 * switched both ways by Petzold's rule (1983), over two memories of SUNDIALS' CVODE; events located. */
#ifndef TELEDIMOS_SIM_INTEGRATOR_H
#define TELEDIMOS_SIM_INTEGRATOR_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_ODE_MAX_SIZE = 4096, TD_ODE_MAX_EVENTS = 64 };

typedef struct td_ode {
    size_t size; /* n */
    /* False: not defined there; the step is tried again smaller. */
    bool (*rate)(double *dy, double t, const double *y, void *user);
    /* (n,n) row-major, d rate / d y; NULL: by differences. */
    bool (*jacobian)(double *j, double t, const double *y, const double *dy, void *user);
    size_t event_count;
    /* g (event_count): an event is where one of them becomes positive, or ceases to be; no event, which
     * of the two it is at the start, or after a restart. NULL with event_count 0. */
    void (*events)(double *g, double t, const double *y, void *user);
    void *user;
} td_ode;

typedef enum td_integrator_method {
    TD_INTEGRATOR_AUTO,
    TD_INTEGRATOR_ADAMS,
    TD_INTEGRATOR_BDF
} td_integrator_method;

typedef struct td_integrator_options {
    td_integrator_method method; /* default auto */
    double relative;             /* default 1e-6: of the result (each step is held to relative^(6/5)) */
    const double *absolute;      /* (n); NULL: 1e-9 each */
    double max_step_s;           /* 0 (default): any */
    double first_step_s;         /* 0 (default): chosen */
    long max_steps;              /* of one advance; default 1e6 */
} td_integrator_options;
TD_API td_integrator_options td_integrator_options_default(void);

/* What it cost, since td_integrator_new. */
typedef struct td_integrator_counters {
    long rates, jacobians, steps, rejected, newton_iterations, events;
    long to_bdf, to_adams;       /* switches */
    double time_in_bdf_s;        /* of the integrated time */
    td_integrator_method method; /* now */
    int order;                   /* of the last step */
    double step_s;               /* the last */
} td_integrator_counters;

typedef struct td_integrator td_integrator;
/* `ode` is copied, `user` borrowed. */
TD_API td_status td_integrator_new(td_integrator **integrator, const td_ode *ode, double t, const double *y,
                                   const td_integrator_options *options, td_error *error);
TD_API void td_integrator_free(td_integrator **integrator);

/* Integrates until `t_end`, or to the first event before it. Steps go past t_end and are read between: the
 * rate is called beyond it, and where the caller stops does not change the result. *event: which (-1: none,
 * t_end is reached); direction (may be NULL) 1 rising, -1 falling. y is that at the time reached. Fails,
 * naming time and state, where steps become too small, too many, or the rate is not finite. */
TD_API td_status td_integrator_advance(td_integrator *integrator, double t_end, int *event, int *direction,
                                       td_error *error);
TD_API double td_integrator_time(const td_integrator *integrator);
TD_API const double *td_integrator_state(const td_integrator *integrator); /* (n), lent */
/* After a jump of the state or of the equations: goes on from (t, y), keeping the counters. */
TD_API td_status td_integrator_restart(td_integrator *integrator, double t, const double *y, td_error *error);
TD_API td_integrator_counters td_integrator_count(const td_integrator *integrator);

#ifdef __cplusplus
}
#endif
#endif
