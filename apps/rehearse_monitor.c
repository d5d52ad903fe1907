/* The monitor: predicted against actual, sample by sample along the same motion.
 *
 * Both move along the same motions by their shares of the way, so that a motion that waits in the soil is
 * compared where it is. Each motion is planned anew from where the machine is measured to stand: deviations
 * do not add up. Sigma is that of the same task done by machines on soils drawn as they may be, taken
 * together over each phase of a pass, or over the motion itself where it is more. What counts is the mean
 * over the last two seconds, in sigma: the machine rocks on its tracks, in a phase that nobody predicts; and
 * over half a second, where twice as much is allowed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/rehearse_internal.h"

/* Of what no draw shows: the ground under the tracks and in the cut is not quite as the map has it. */
static const double FLOOR_JOINT = 0.01, FLOOR_FORCE_N = 1e4, FLOOR_TIP_M = 0.03;
static const double LATE_TIMES = 2, LATE_S = 10;

static int class_of(const task_sample *a)
{
    return a->dig_phase >= 0 && a->dig_phase < MONITOR_CLASSES - 1 ? a->dig_phase : MONITOR_CLASSES - 1;
}

bool monitor_is_free(const task_sample *a)
{
    return !a->loose && a->dig_phase != TD_DIG_APPROACH && a->dig_phase != TD_DIG_CUT &&
           a->dig_phase != TD_DIG_LIFT;
}

static void values_of(double *value, const task_sample *a, int joints)
{
    for (int k = 0; k < joints; k++) {
        value[k] = a->state.q[k];
        value[joints + k] = a->state.force[k];
    }
    for (int i = 0; i < 3; i++) value[2 * joints + i] = a->tool.t[i];
}

bool monitor_compare(double *difference, double tip[3], double place[3], const task_run *predicted,
                     const task_sample *a, int joints)
{
    const task_sample *low = NULL, *high = NULL;
    double before[MONITOR_MOST], after[MONITOR_MOST];
    if (a->motion < 0) return false;
    for (size_t i = 0; i < predicted->count; i++) {
        const task_sample *p = predicted->sample + i;
        if (p->motion != a->motion) continue;
        if (p->share <= a->share || !low) low = p;
        if (p->share >= a->share) {
            high = p;
            break;
        }
    }
    if (!low) return false;
    if (!high) high = low;
    const double span = high->share - low->share, t = span > 0 ? fmax(0, a->share - low->share) / span : 0;
    values_of(difference, a, joints);
    values_of(before, low, joints);
    values_of(after, high, joints);
    for (int k = 0; k < 2 * joints + 3; k++) difference[k] -= before[k] + t * (after[k] - before[k]);
    for (int i = 0; i < 3; i++) {
        place[i] = low->tool.t[i] + t * (high->tool.t[i] - low->tool.t[i]);
        tip[i] = a->tool_true.t[i] - place[i];
    }
    return true;
}

td_status monitor_begin(monitor *m, const task_run *predicted, int joints, double alarm, td_error *error)
{
    int count = 0;
    for (size_t i = 0; i < predicted->count; i++)
        if (predicted->sample[i].motion >= count) count = predicted->sample[i].motion + 1;
    *m = (monitor){
        .joints = joints, .predicted = predicted, .motion = -1, .alarm = alarm, .motion_count = count};
    m->of_motion = calloc((size_t)count + 1, sizeof *m->of_motion);
    m->samples = calloc((size_t)count + 1, sizeof *m->samples);
    return m->of_motion && m->samples ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a monitor");
}

void monitor_free(monitor *m)
{
    free(m->of_motion);
    free(m->samples);
    m->of_motion = NULL;
    m->samples = NULL;
}

void monitor_learn(monitor *m, const task_run *drawn)
{
    double d[MONITOR_MOST], tip[3], place[3];
    for (size_t i = 0; i < drawn->count; i++) {
        const task_sample *a = drawn->sample + i;
        if (!monitor_compare(d, tip, place, m->predicted, a, m->joints)) continue;
        const int c = class_of(a);
        for (int k = 0; k < 2 * m->joints + 3; k++) {
            m->sigma[c][k] += d[k] * d[k];
            m->of_motion[a->motion][k] += d[k] * d[k];
        }
        m->counts[c]++;
        m->samples[a->motion]++;
        if (!monitor_is_free(a)) continue;
        m->tip_square += tip[0] * tip[0] + tip[1] * tip[1] + tip[2] * tip[2];
        m->up_square += tip[2] * tip[2];
        m->tip_count++;
    }
}

/* A motion's own where it is larger: the machine rocks in some more than in others. */
void monitor_learnt(monitor *m)
{
    const int joints = m->joints, most = 2 * joints + 3;
    for (int c = 0; c < MONITOR_CLASSES; c++)
        for (int k = 0; k < most; k++) {
            const double least = k < joints ? FLOOR_JOINT : k < 2 * joints ? FLOOR_FORCE_N : FLOOR_TIP_M;
            m->sigma[c][k] = hypot(least, m->counts[c] ? sqrt(m->sigma[c][k] / (double)m->counts[c]) : 0);
        }
    for (int i = 0; i < m->motion_count; i++)
        for (int k = 0; k < most; k++)
            m->of_motion[i][k] = m->samples[i] ? sqrt(m->of_motion[i][k] / (double)m->samples[i]) : 0;
    m->sigma_tip_m = m->tip_count ? sqrt(m->tip_square / (double)m->tip_count) : NAN;
    m->sigma_up_m = m->tip_count ? sqrt(m->up_square / (double)m->tip_count) : NAN;
}

/* ---- while it is executed ---- */

static const char *unit_of(const monitor *m, int k, double *scale)
{
    *scale = k < m->joints ? 57.29577951308232 : k < 2 * m->joints ? 1e-3 : 1;
    return k < m->joints ? "deg" : k < 2 * m->joints ? "kN" : "m";
}

static void name_of(char *text, size_t size, const monitor *m, const td_robot *robot, int k)
{
    if (k < 2 * m->joints)
        snprintf(text, size, "%s of %s", k < m->joints ? "the angle" : "the force",
                 robot->joint[k % m->joints].name);
    else
        snprintf(text, size, "the tool's %c", "xyz"[k - 2 * m->joints]);
}

static double predicted_time(const monitor *m, int number)
{
    double first = NAN, last = NAN;
    for (size_t i = 0; i < m->predicted->count; i++) {
        if (m->predicted->sample[i].motion != number) continue;
        if (isnan(first)) first = m->predicted->sample[i].time_s;
        last = m->predicted->sample[i].time_s;
    }
    return last - first;
}

static bool is_late(monitor *m, const task_sample *a, char *why, size_t size)
{
    const double taken = a->time_s - m->since_s, planned = predicted_time(m, a->motion);
    if (!isfinite(planned) || a->share >= 1) return false;
    m->late = fmax(m->late, taken / (planned + LATE_S));
    if (taken <= LATE_TIMES * planned + LATE_S) return false;
    snprintf(why, size, "motion %d takes %.1f s already, where %.1f s were predicted: something holds it",
             a->motion + 1, taken, planned);
    return true;
}

/* Of the last `samples` deviations of a quantity, their mean, in sigma. */
static double mean_off(const monitor *m, int k, int samples)
{
    double sum = 0;
    for (int i = 1; i <= samples; i++) sum += m->off[(m->next + MONITOR_WINDOW - i) % MONITOR_WINDOW][k];
    return fabs(sum) / samples;
}

/* By how much it may be off for two seconds, and for half a second: what the machine runs against is not to
 * be pushed for longer. */
static bool is_off(monitor *m, double *ratio, double *allowed, int k)
{
    enum { SOON = MONITOR_WINDOW / 4 };
    static const double AT_ONCE = 2; /* times the alarm */
    *ratio = m->filled < SOON ? 0 : mean_off(m, k, SOON);
    *allowed = AT_ONCE * m->alarm;
    if (*ratio > *allowed) return true;
    if (m->filled < MONITOR_WINDOW) return false;
    *ratio = mean_off(m, k, MONITOR_WINDOW);
    *allowed = m->alarm;
    m->ratio[k] = fmax(m->ratio[k], *ratio);
    return *ratio > *allowed;
}

void monitor_watch(void *self, const task_sample *a, bool *deviates, char *why, size_t size)
{
    rehearse *r = self;
    monitor *m = &r->round[r->round_count - 1].monitor;
    const int most = 2 * m->joints + 3;
    double d[MONITOR_MOST], tip[3], place[3];
    *deviates = false;
    if (a->motion != m->motion) {
        m->motion = a->motion;
        m->since_s = a->time_s;
        m->filled = m->next = 0;
    }
    if (!monitor_compare(d, tip, place, m->predicted, a, m->joints)) return;
    double sigma[MONITOR_MOST];
    for (int k = 0; k < most; k++) {
        sigma[k] = fmax(m->sigma[class_of(a)][k], m->of_motion[a->motion][k]);
        m->off[m->next][k] = d[k] / sigma[k];
    }
    m->next = (m->next + 1) % MONITOR_WINDOW;
    m->filled += m->filled < MONITOR_WINDOW;
    if ((*deviates = is_late(m, a, why, size))) return;
    for (int k = 0; k < most; k++) {
        double ratio, allowed, scale;
        if (!is_off(m, &ratio, &allowed, k) || *deviates) continue;
        char name[100];
        name_of(name, sizeof name, m, r->scenario.robot, k);
        const char *unit = unit_of(m, k, &scale);
        snprintf(
            why, size,
            "%s is %.3g %s off what was predicted, and has been for %s %.1f times its sigma of %.3g %s (%g "
            "are allowed)",
            name, scale * d[k], unit, allowed > m->alarm ? "half a second" : "two seconds", ratio,
            scale * sigma[k], unit, allowed);
        *deviates = true;
    }
}
