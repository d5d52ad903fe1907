/* What the files of the integrator share: integrator.c steps, integrator_cvode.c stands behind CVODE's
 * functions, integrator_switch.c holds Petzold's rule, integrator_events.c looks for events. */
#ifndef TELEDIMOS_SIM_INTEGRATOR_INTERNAL_H
#define TELEDIMOS_SIM_INTEGRATOR_INTERNAL_H

#include <cvode/cvode.h>
#include <nvector/nvector_serial.h>

#include "sim/integrator.h"

enum { ADAMS, BDF };

struct td_integrator {
    td_ode ode;
    td_integrator_method method;
    double root_size; /* sqrt(n) */
    double relative, max_step_s, first_step_s;
    long max_steps;
    SUNContext context;
    void *memory[2]; /* of CVODE, by ADAMS and BDF; NULL: not needed */
    N_Vector absolute, y, step_end, weight, error, probe, probe_rate;
    SUNMatrix matrix;
    SUNLinearSolver linear;
    SUNNonlinearSolver fixed_point, newton;
    long jacobian_step; /* steps until it was made; -1: never */
    int again;          /* times that the matrix was made anew in this step */
    long matrix_step;   /* steps until the matrix was made */
    long kept;          /* steps that the Jacobian is kept for */
    double jacobian_change;
    double *jacobian;   /* (n,n) column-major, the last */
    double contraction; /* of Newton's iterations, when last seen */
    double last_change; /* of the iteration before, weighted */
    int now;            /* ADAMS or BDF */
    double t;           /* that y is at */
    double reached;     /* end of the last internal step, which step_end is at */
    /* Events: sides are those of g > 0, told to the caller, and found at `checked`, until where was looked.
     */
    double checked;
    bool told[TD_ODE_MAX_EVENTS], found[TD_ODE_MAX_EVENTS], zero[TD_ODE_MAX_EVENTS], from_zero;
    bool event_pending; /* one was found, at event_t, and not yet told */
    double event_t;
    int event;
    N_Vector event_y;
    bool want_switch;
    long settled;     /* steps in a row that speak for the other method */
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

/* integrator_cvode.c: vectors and weights, from the first state; a method's memory. False: no memory. */
bool td_integrator_vectors(td_integrator *g, const td_integrator_options *o, const double *y);
bool td_integrator_memory(td_integrator *g, int which);
/* Counted; false where it is not defined or not finite. */
bool td_integrator_rate(td_integrator *g, double t, const double *y, double *dy);
/* Largest of |v| weight. */
double td_integrator_norm(const double *v, const double *weight, size_t n);
/* Each step is held to this share of the tolerance. */
double td_integrator_share(double relative);

/* integrator_switch.c: a method begun anew; after each step, whether the other would do better; the change.
 */
td_status td_integrator_begin(td_integrator *g, int which, double t, N_Vector y, double first_step,
                              td_error *error);
void td_integrator_consider(td_integrator *g);
td_status td_integrator_change(td_integrator *g, td_error *error);

/* integrator_events.c: from y: the side each is on there is no event; one that begins at 0 is on the side it
 * goes to. */
void td_integrator_watch(td_integrator *g, double t, N_Vector y);
/* The next event of the last step; of several at one time, the first in order. False: CVODE has failed. */
bool td_integrator_find(td_integrator *g);

#endif
