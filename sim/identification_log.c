/* What is refused before anything is estimated. */
#include <math.h>

#include "sim/identification_internal.h"

enum { LEAST_SAMPLES = 60 };
/* Of a joint's range: as far past a stop no noise carries it. */
static const double PAST_STOP = 0.05;

const char *td_id_log_name(const td_motion_log *log)
{
    return log->name ? log->name : "log";
}

td_status td_id_check_options(const td_identification_options *o, int n, td_error *error)
{
    const struct {
        const char *name;
        double value;
    } positive[] = {{"slip", o->slip},           {"knot_s", o->knot_s},
                    {"smooth_s", o->smooth_s},   {"floor_rad", o->floor_rad},
                    {"floor_m", o->floor_m},     {"floor_rad_s", o->floor_rad_s},
                    {"floor_m_s", o->floor_m_s}, {"floor_force", o->floor_force},
                    {"prior", o->prior},         {"told", o->told}};
    for (size_t i = 0; i < sizeof positive / sizeof *positive; i++)
        if (!(positive[i].value > 0) || !isfinite(positive[i].value))
            return td_fail(error, TD_ERROR_ARGUMENT, "identification: %s is %g, and must be positive",
                           positive[i].name, positive[i].value);
    for (int k = 0; k < n; k++)
        if (!(o->viscous[k] >= 0) || !(o->coulomb[k] >= 0) || !isfinite(o->viscous[k] + o->coulomb[k]))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "identification: friction of joint %d is negative or no number", k);
    for (int i = 0; i < 3; i++)
        if (!isfinite(o->gravity[i]))
            return td_fail(error, TD_ERROR_ARGUMENT, "identification: gravity is no number");
    return TD_OK;
}

/* ---- the log ---- */

static td_status check_numbers(const td_motion_log *log, const double *value, int columns, const char *what,
                               const td_robot *robot, td_error *error)
{
    for (size_t i = 0; value && i < log->count; i++)
        for (int k = 0; k < columns; k++)
            if (!isfinite(value[i * (size_t)columns + (size_t)k]))
                return td_fail(error, TD_ERROR_DATA, "%s: sample %zu: the %s of %s is no number",
                               td_id_log_name(log), i + 1, what, robot ? robot->joint[k].name : "the base");
    return TD_OK;
}

static td_status check_times(const td_motion_log *log, td_error *error)
{
    if (log->count < LEAST_SAMPLES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %zu samples are too few to identify anything from; at least %d are needed",
                       td_id_log_name(log), log->count, LEAST_SAMPLES);
    if (log->count > ID_MOST_SAMPLES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %zu samples are too many; at most %d fit, so take every other",
                       td_id_log_name(log), log->count, ID_MOST_SAMPLES);
    for (size_t i = 0; i < log->count; i++)
        if (!isfinite(log->time_s[i]) || (i > 0 && !(log->time_s[i] > log->time_s[i - 1])))
            return td_fail(error, TD_ERROR_DATA, "%s: sample %zu: times must rise, and %g s does not",
                           td_id_log_name(log), i + 1, log->time_s[i]);
    return TD_OK;
}

/* Noise may carry a position past a stop; a wrong unit or zero carries it further. */
static td_status check_stops(const td_motion_log *log, const td_robot *robot, td_error *error)
{
    const size_t n = (size_t)robot->joint_count;
    for (size_t i = 0; i < log->count; i++)
        for (size_t k = 0; k < n; k++) {
            const td_robot_joint *j = robot->joint + k;
            const double q = log->position[i * n + k], past = PAST_STOP * (j->upper - j->lower);
            if (q < j->lower - past || q > j->upper + past)
                return td_fail(
                    error, TD_ERROR_DATA,
                    "%s: sample %zu: %s at %.4g is beyond its stops, %.4g to %.4g; is its zero or its "
                    "unit another?",
                    td_id_log_name(log), i + 1, j->name, q, j->lower, j->upper);
        }
    return TD_OK;
}

td_status td_id_check_log(const td_motion_log *log, const td_robot *robot, td_error *error)
{
    const int n = robot->joint_count;
    double largest = 0;
    TD_TRY(check_times(log, error));
    TD_TRY(check_numbers(log, log->position, n, "position", robot, error));
    TD_TRY(check_numbers(log, log->rate, n, "rate", robot, error));
    TD_TRY(check_numbers(log, log->acceleration, n, "acceleration", robot, error));
    TD_TRY(check_numbers(log, log->force, n, "force", robot, error));
    TD_TRY(check_numbers(log, log->base, 6, "pose", NULL, error));
    TD_TRY(check_stops(log, robot, error));
    for (size_t i = 0; i < log->count * (size_t)n; i++) largest = fmax(largest, fabs(log->force[i]));
    if (!(largest > 0))
        return td_fail(error, TD_ERROR_DATA, "%s: its forces are all 0; nothing can be told without them",
                       td_id_log_name(log));
    if (log->acceleration && (!log->rate || log->base))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: given accelerations go with given rates and a base that stands still",
                       td_id_log_name(log));
    return TD_OK;
}
