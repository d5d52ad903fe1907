/* What the paper discusses, each over a range: the control period and the gain (stability, cost), the oil's
 * stiffness (calls of the equations, share of the processor), Coriolis terms on and off. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_internal.h"

/* A swing that stays below this is none, rad or m. */
static const double STILL = 2e-3;
static const double PERIODS[] = {0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.2};
static const double GAINS[] = {0.5, 1, 2, 3, 5, 8, 12, 20, 30};
static const double OILS[] = {1e6, 1e7, 1e8, 1e9, 1e10};
enum { PERIOD_COUNT = 14, GAIN_COUNT = 9, OIL_COUNT = 5 };

static double largest_apart(const run_result *a, const run_result *b, int joints)
{
    double most = 0;
    for (size_t i = 0; i < a->count && i < b->count; i++)
        for (int k = 0; k < joints; k++)
            most = fmax(most, fabs(a->sample[i].state.q[k] - b->sample[i].state.q[k]));
    return most;
}

/* Largest distance from what was wanted in [first, last), and by how much a joint swings about its mean
 * there.
 */
static double swing_of(double *error, const run_result *r, size_t first, size_t last, int joints)
{
    double most = 0;
    *error = 0;
    for (int k = 0; k < joints; k++) {
        double low = INFINITY, high = -INFINITY;
        for (size_t i = first; i < last; i++) {
            const double off = r->sample[i].state.q[k] - r->sample[i].wanted[k];
            low = fmin(low, off);
            high = fmax(high, off);
            *error = fmax(*error, fabs(off));
        }
        most = fmax(most, high - low);
    }
    return most;
}

/* The motion, and as long again of calming down: stable where what swings in the last quarter is less than
 * half of the quarter before, or nothing. */
static td_status one(sweep_row *row, run_result *kept, const scenario *s, const td_progress *progress,
                     td_error *error)
{
    run_result run;
    scenario longer = *s;
    const int n = s->robot->joint_count;
    double after = 0, before = 0;
    longer.duration_s = 2 * s->duration_s;
    *row = (sweep_row){.period_s = s->period_s,
                       .gain_1_s = s->gain_1_s,
                       .oil_n_m = s->options.oil_n_m,
                       .coriolis = s->options.coriolis};
    td_status status = simulate_run(&run, &longer, true, progress, error);
    if (status == TD_OK) {
        const double third = swing_of(&before, &run, run.count / 2, 3 * run.count / 4, n),
                     fourth = swing_of(&after, &run, 3 * run.count / 4, run.count, n);
        row->stable = !run.unstable && (fourth < STILL || fourth < third / 2);
        row->swing_rad = fourth;
        swing_of(&row->error_rad, &run, 0, run.count / 2, n);
        row->rates = run.counters.rates;
        row->steps = run.counters.steps;
        row->cpu_share = run.cpu_s / longer.duration_s;
    }
    if (kept && status == TD_OK)
        *kept = run;
    else
        run_free(&run);
    return status;
}

static td_status sweep_coriolis(sweep *w, const scenario *s, const td_progress *progress, td_error *error)
{
    run_result run[2] = {{0}, {0}};
    td_status status = TD_OK;
    for (int with = 1; with >= 0 && status == TD_OK; with--) {
        scenario changed = *s;
        changed.options.coriolis = with;
        status = one(w->coriolis + with, run + with, &changed, progress, error);
    }
    if (status == TD_OK) w->coriolis[0].apart_rad = largest_apart(run, run + 1, s->robot->joint_count);
    run_free(run);
    run_free(run + 1);
    return status;
}

td_status simulate_sweep(sweep *w, const scenario *s, const td_progress *progress, td_error *error)
{
    *w = (sweep){0};
    const bool loop = s->period_s > 0;
    if (!s->options.hydraulics || s->motion.command != TD_COMMAND_RATE)
        return td_fail(error, TD_ERROR_ARGUMENT, "--sweep wants a motion of rates through the hydraulics");
    scenario base = *s;
    if (!loop) base.period_s = 0.05, base.gain_1_s = 3; /* the paper's */
    for (size_t i = 0; i < PERIOD_COUNT; i++) {
        scenario changed = base;
        changed.period_s = PERIODS[i];
        TD_TRY(one(w->period + w->period_count++, NULL, &changed, progress, error));
        const sweep_row *row = w->period + i;
        if (row->stable && (i == 0 || w->limit_s == PERIODS[i - 1])) w->limit_s = row->period_s;
    }
    for (size_t i = 0; i < GAIN_COUNT; i++) {
        scenario changed = base;
        changed.gain_1_s = GAINS[i];
        TD_TRY(one(w->gain + w->gain_count++, NULL, &changed, progress, error));
    }
    for (size_t i = 0; i < OIL_COUNT; i++) {
        scenario changed = base;
        changed.options.oil_n_m = OILS[i];
        TD_TRY(one(w->oil + w->oil_count++, NULL, &changed, progress, error));
    }
    return sweep_coriolis(w, &base, progress, error);
}
