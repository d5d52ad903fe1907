/* Events are where a sign differs from what was told, looked for by halving CVODE's interpolant. */
#include "sim/integrator_internal.h"

#include <float.h>
#include <math.h>
#include <string.h>

static void sides(const td_integrator *g, bool *side, double t, N_Vector y)
{
    double value[TD_ODE_MAX_EVENTS];
    if (g->ode.event_count == 0) return;
    g->ode.events(value, t, N_VGetArrayPointer(y), g->ode.user);
    for (size_t k = 0; k < g->ode.event_count; k++) side[k] = value[k] > 0;
}

/* From y: the side each is on there is no event. One that begins at 0 is on the side it goes to. */
void td_integrator_watch(td_integrator *g, double t, N_Vector y)
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
bool td_integrator_find(td_integrator *g)
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
            return false;
        }
    }
    return true;
}
