/* The estimate: the motion as splines, the parameters by instrumental variables. */
#include "sim/identification.h"

#include <lapacke.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/identification_internal.h"
#include "sim/machine.h"

enum { LEAST_SAMPLES = 60, LEAST_KNOTS = 8, MOST_ROUNDS = 40, MOST_WEAK = 12 };
static const double PI = 3.14159265358979323846;
/* Samples to a knot, at least. */
static const double SAMPLES_A_KNOT = 2.5;
/* In slips: slower, a joint's friction is not whole and its equation left out. */
static const double MOVES = 4;
/* rad or m: as near to a stop, a joint may be in it. */
static const double NEAR_STOP = 2e-3;
/* Of a joint's range: as far past a stop no noise carries it. */
static const double PAST_STOP = 0.05;
/* Change of parameters that ends the iteration, in sigmas. */
static const double SMALL_CHANGE = 1e-3;

td_identification_options td_identification_options_default(const td_robot *robot)
{
    const td_machine_options machine = td_machine_options_default(robot);
    td_identification_options o = {
        .site_from_vehicle = td_pose_identity(),
        .gravity = {0, 0, -9.80665},
        .slip = machine.slip,
        .knot_s = 0.05,
        .smooth_s = 0.25,
        .floor_rad = 1e-4,
        .floor_m = 1e-4,
        .floor_rad_s = 1e-3,
        .floor_m_s = 1e-3,
        .floor_force = 1e-3,
        .prior = 10,
        .told = 0.5,
    };
    memcpy(o.viscous, machine.viscous, sizeof o.viscous);
    memcpy(o.coulomb, machine.coulomb, sizeof o.coulomb);
    return o;
}

static td_status check_options(const td_identification_options *o, int n, td_error *error)
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

static const char *name_of(const td_motion_log *log)
{
    return log->name ? log->name : "log";
}

static td_status check_numbers(const td_motion_log *log, const double *value, int columns, const char *what,
                               const td_robot *robot, td_error *error)
{
    for (size_t i = 0; value && i < log->count; i++)
        for (int k = 0; k < columns; k++)
            if (!isfinite(value[i * (size_t)columns + (size_t)k]))
                return td_fail(error, TD_ERROR_DATA, "%s: sample %zu: the %s of %s is no number",
                               name_of(log), i + 1, what, robot ? robot->joint[k].name : "the base");
    return TD_OK;
}

static td_status check_times(const td_motion_log *log, td_error *error)
{
    if (log->count < LEAST_SAMPLES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %zu samples are too few to identify anything from; at least %d are needed",
                       name_of(log), log->count, LEAST_SAMPLES);
    if (log->count > ID_MOST_SAMPLES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %zu samples are too many; at most %d fit, so take every other", name_of(log),
                       log->count, ID_MOST_SAMPLES);
    for (size_t i = 0; i < log->count; i++)
        if (!isfinite(log->time_s[i]) || (i > 0 && !(log->time_s[i] > log->time_s[i - 1])))
            return td_fail(error, TD_ERROR_DATA, "%s: sample %zu: times must rise, and %g s does not",
                           name_of(log), i + 1, log->time_s[i]);
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
                    name_of(log), i + 1, j->name, q, j->lower, j->upper);
        }
    return TD_OK;
}

static td_status check_log(const td_motion_log *log, const td_robot *robot, td_error *error)
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
                       name_of(log));
    if (log->acceleration && (!log->rate || log->base))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: given accelerations go with given rates and a base that stands still",
                       name_of(log));
    return TD_OK;
}

/* ---- work ---- */

/* Splines of all channels. */
typedef struct td_id_motion {
    td_id_spline spline;
    size_t unknowns;
    double *coefficient; /* (intervals+5,channels) */
} td_id_motion;

typedef struct id_job {
    td_id_model m;
    const td_motion_log *log;
    bool base_moves;
    int channels;  /* joints, and 6 of the base */
    double *value; /* (count,channels), turns unwrapped */
    double sigma[TD_DYNAMICS_MAX], sigma_rate[TD_ROBOT_MAX_JOINTS], sigma_force[TD_ROBOT_MAX_JOINTS];
    td_id_motion fine, coarse; /* as the record has it, and its slow part */
    double *lever;             /* (count,n) */
    bool *used;                /* (count,n) */
    size_t used_count;
    double spline_chi2, chi2;
    double *beta, *information, *covariance; /* (count), in sizes (count,count) */
    int rounds;
} id_job;

static td_status no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the identification");
}

static bool turns(const id_job *j, int channel)
{
    return channel < j->m.n ? j->m.robot->joint[channel].kind == TD_JOINT_CONTINUOUS : channel >= j->m.n + 3;
}

static void gather(id_job *j)
{
    const size_t n = (size_t)j->m.n, wide = (size_t)j->channels;
    for (size_t i = 0; i < j->log->count; i++)
        for (size_t c = 0; c < wide; c++) {
            double v = c < n ? j->log->position[i * n + c] : j->log->base[i * 6 + c - n];
            if (i > 0 && turns(j, (int)c)) v -= 2 * PI * round((v - j->value[(i - 1) * wide + c]) / (2 * PI));
            j->value[i * wide + c] = v;
        }
}

static const td_cylinder *cylinder_of(const td_robot *robot, int joint)
{
    for (int i = 0; i < robot->cylinder_count; i++)
        if (robot->cylinder[i].joint == joint) return robot->cylinder + i;
    return NULL;
}

/* What a sensor of forces spans: the joint's limit; where it has none, the largest force in the log. */
static double force_span(const id_job *j, size_t k)
{
    const td_cylinder *c = cylinder_of(j->m.robot, (int)k);
    const double limit =
        c ? c->pressure_pa * c->count * PI / 4 * c->bore_m * c->bore_m : j->m.robot->joint[k].effort;
    double largest = 0;
    if (isfinite(limit) && limit > 0) return limit;
    for (size_t i = 0; i < j->log->count; i++)
        largest = fmax(largest, fabs(j->log->force[i * (size_t)j->m.n + k]));
    return largest;
}

static td_status find_noise(id_job *j, td_error *error)
{
    const td_identification_options *o = &j->m.o;
    const size_t count = j->log->count, n = (size_t)j->m.n;
    double *work = calloc(count, sizeof *work);
    if (!work) return no_memory(error);
    for (int c = 0; c < j->channels; c++) {
        const bool slides = c < j->m.n ? j->m.robot->joint[c].kind == TD_JOINT_PRISMATIC : c < j->m.n + 3;
        j->sigma[c] = fmax(slides ? o->floor_m : o->floor_rad,
                           td_id_noise(j->value + c, (size_t)j->channels, count, work));
    }
    for (size_t k = 0; k < n; k++) {
        const bool slides = j->m.robot->joint[k].kind == TD_JOINT_PRISMATIC;
        j->sigma_force[k] = fmax(fmax(o->floor_force * force_span(j, k), 1e-9),
                                 td_id_noise(j->log->force + k, n, count, work));
        j->sigma_rate[k] = slides ? o->floor_m_s : o->floor_rad_s;
        if (j->log->rate)
            j->sigma_rate[k] = fmax(j->sigma_rate[k], td_id_noise(j->log->rate + k, n, count, work));
    }
    free(work);
    return TD_OK;
}

static double median_step(const td_motion_log *log)
{
    return (log->time_s[log->count - 1] - log->time_s[0]) / (double)(log->count - 1);
}

static td_status set_knots(td_id_motion *motion, const id_job *j, double knot_s, td_error *error)
{
    const td_motion_log *log = j->log;
    const double first = log->time_s[0], all = log->time_s[log->count - 1] - first;
    const double step = fmax(knot_s, SAMPLES_A_KNOT * median_step(log));
    if (all < LEAST_KNOTS * step)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %.3g s are too short to identify anything from; at least %.3g are needed",
                       name_of(log), all, LEAST_KNOTS * step);
    for (size_t i = 1; i < log->count; i++)
        if (log->time_s[i] - log->time_s[i - 1] > 2 * step)
            return td_fail(
                error, TD_ERROR_DATA,
                "%s: sample %zu: a gap of %.3g s before it; give a log without gaps, or a part of it",
                name_of(log), i + 1, log->time_s[i] - log->time_s[i - 1]);
    motion->spline.first = first;
    motion->spline.intervals = (size_t)floor(all / step);
    motion->spline.step = all / (double)motion->spline.intervals;
    motion->unknowns = (motion->spline.intervals + ID_SPLINE - 1) * (size_t)j->channels;
    free(motion->coefficient);
    motion->coefficient = calloc(motion->unknowns, sizeof *motion->coefficient);
    return motion->coefficient ? TD_OK : no_memory(error);
}

/* ---- rows ---- */

/* Values, rates and second derivatives (3,channels) of the splines. */
static void values_at(double out[3][TD_DYNAMICS_MAX], const id_job *j, const td_id_motion *motion,
                      size_t first, double weight[3][ID_SPLINE])
{
    const size_t wide = (size_t)j->channels;
    for (int d = 0; d < 3; d++)
        for (size_t c = 0; c < wide; c++) {
            double sum = 0;
            for (size_t r = 0; r < ID_SPLINE; r++)
                sum += weight[d][r] * motion->coefficient[(first + r) * wide + c];
            out[d][c] = sum;
        }
}

/* A measured value or rate of a channel. */
static double add_measured(td_arrow *a, const id_job *j, size_t first, const double weight[ID_SPLINE],
                           int channel, double difference, double sigma)
{
    double row[ID_SPLINE * TD_DYNAMICS_MAX] = {0};
    const size_t wide = (size_t)j->channels;
    for (size_t r = 0; a && r < ID_SPLINE; r++) row[r * wide + (size_t)channel] = weight[r] / sigma;
    if (a) td_arrow_add(a, first * wide, row, ID_SPLINE * wide, NULL, difference / sigma);
    return difference * difference / (sigma * sigma);
}

static double add_motion(td_arrow *a, const id_job *j, size_t i, size_t first, double weight[3][ID_SPLINE],
                         double at[3][TD_DYNAMICS_MAX])
{
    const size_t n = (size_t)j->m.n;
    double chi2 = 0;
    for (int c = 0; c < j->channels; c++)
        chi2 += add_measured(a, j, first, weight[0], c,
                             at[0][c] - j->value[i * (size_t)j->channels + (size_t)c], j->sigma[c]);
    for (size_t k = 0; j->log->rate && k < n; k++)
        chi2 += add_measured(a, j, first, weight[1], (int)k, at[1][k] - j->log->rate[i * n + k],
                             j->sigma_rate[k]);
    return chi2;
}

/* Measured less predicted force of joint k, over its noise; predicted in *force (may be NULL). */
static double force_residual(const id_job *j, size_t i, int k, const double *rows, double *force)
{
    const size_t at = i * (size_t)j->m.n + (size_t)k;
    double torque = 0;
    for (int c = 0; c < j->m.count; c++) torque += rows[k * j->m.count + c] * j->beta[c];
    if (force) *force = torque / j->lever[at];
    return (j->log->force[at] - torque / j->lever[at]) / j->sigma_force[k];
}

/* Columns: the regressor of the smooth motion (instruments), then that of the splines. Derivatives by
 * positions, and by rates but for friction, are left out: their effect is that of noise on a smoothed
 * position and rate, and what is left of the equations has mean 0 all the same. */
static void add_force(td_arrow *a, const id_job *j, size_t i, int k, size_t first,
                      double weight[3][ID_SPLINE], const double *smooth, const double *rows,
                      const double *unit, double rate)
{
    const td_id_model *m = &j->m;
    const size_t wide = (size_t)j->channels, count = (size_t)m->count;
    const double scale = 1 / (j->lever[i * (size_t)m->n + (size_t)k] * j->sigma_force[k]),
                 past = tanh(rate / m->o.slip);
    const double *friction = j->beta + m->count - 2 * m->n + k;
    const double by_rate = friction[0] + friction[m->n] * (1 - past * past) / m->o.slip;
    double row[ID_SPLINE * TD_DYNAMICS_MAX], border[2 * (10 * TD_ROBOT_MAX_LINKS + 2 * TD_ROBOT_MAX_JOINTS)];
    for (size_t c = 0; c < wide; c++) {
        double mass = 0;
        for (size_t b = 0; b < count; b++) mass += unit[((size_t)k * wide + c) * count + b] * j->beta[b];
        for (size_t r = 0; r < ID_SPLINE; r++) row[r * wide + c] = -scale * mass * weight[2][r];
    }
    for (size_t r = 0; r < ID_SPLINE; r++) row[r * wide + (size_t)k] -= scale * by_rate * weight[1][r];
    for (size_t c = 0; c < count; c++) {
        border[c] = -scale * smooth[(size_t)k * count + c] * m->base_size[c];
        border[count + c] = -scale * rows[(size_t)k * count + c] * m->base_size[c];
    }
    td_arrow_add(a, first * wide, row, ID_SPLINE * wide, border, force_residual(j, i, k, rows, NULL));
}

/* Rows (n,count) of the regressor on a motion at a time; its state in *s and its rates in `rate`. */
static void rows_at(double *rows, td_id_state *s, double rate[TD_DYNAMICS_MAX], const id_job *j,
                    const td_id_motion *motion, double time_s)
{
    double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
    const size_t first = td_id_basis(weight, &motion->spline, time_s);
    values_at(at, j, motion, first, weight);
    td_id_state_from(s, &j->m, at[0], at[1], at[2], j->base_moves);
    td_id_rows(rows, &j->m, s);
    memcpy(rate, at[1], sizeof at[1]);
}

/* Sum of squared residuals of the forces; their rows into `a`. */
static td_status assemble_forces(double *chi2, td_arrow *a, const id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n, size = n * (size_t)m->count;
    double *rows = calloc(size * (size_t)(2 + j->channels), sizeof *rows), *smooth = rows + size,
           *unit = smooth + size;
    if (!rows) return no_memory(error);
    for (size_t i = 0; i < j->log->count; i++) {
        const double t = j->log->time_s[i];
        double weight[3][ID_SPLINE], rate[TD_DYNAMICS_MAX], unused[TD_DYNAMICS_MAX];
        td_id_state s;
        const size_t first = td_id_basis(weight, &j->fine.spline, t);
        rows_at(smooth, &s, unused, j, &j->coarse, t);
        rows_at(rows, &s, rate, j, &j->fine, t);
        td_id_units(unit, m, &s, j->base_moves);
        for (int k = 0; k < m->n; k++) {
            if (!j->used[i * n + (size_t)k]) continue;
            const double r = force_residual(j, i, k, rows, NULL);
            *chi2 += r * r;
            add_force(a, j, i, k, first, weight, smooth, rows, unit, rate[k]);
        }
    }
    free(rows);
    return TD_OK;
}

/* Sum of squared residuals of positions, poses and rates; their rows into `a` (may be NULL). */
static double assemble_motion(td_arrow *a, const id_job *j, const td_id_motion *motion)
{
    double chi2 = 0;
    if (a) td_arrow_clear(a);
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        const size_t first = td_id_basis(weight, &motion->spline, j->log->time_s[i]);
        values_at(at, j, motion, first, weight);
        chi2 += add_motion(a, j, i, first, weight, at);
    }
    return chi2;
}

/* ---- the motion alone ---- */

static td_status fit_motion(double *chi2, const id_job *j, td_id_motion *motion, td_error *error)
{
    td_arrow a;
    td_status status = td_arrow_make(&a, motion->unknowns, (size_t)j->channels * ID_SPLINE, 0, error);
    if (status == TD_OK) assemble_motion(&a, j, motion);
    if (status == TD_OK) status = td_arrow_reduce(&a, error);
    if (status == TD_OK) status = td_arrow_follow(motion->coefficient, &a, NULL, error);
    if (status == TD_OK) *chi2 = assemble_motion(NULL, j, motion);
    td_arrow_free(&a);
    return status;
}

static double spline_misfit(const id_job *j)
{
    const size_t rows = j->log->count * (size_t)(j->channels + (j->log->rate ? j->m.n : 0));
    return rows > j->fine.unknowns ? sqrt(j->spline_chi2 / (double)(rows - j->fine.unknowns)) : 0;
}

/* Knots are halved while the splines do not follow the motion to its noise. */
static td_status follow_motion(id_job *j, td_error *error)
{
    double knot = j->m.o.knot_s, unused = 0;
    const double least = SAMPLES_A_KNOT * median_step(j->log);
    while (true) {
        TD_TRY(set_knots(&j->fine, j, knot, error));
        TD_TRY(fit_motion(&j->spline_chi2, j, &j->fine, error));
        if (spline_misfit(j) < 1.1 || knot <= least) break;
        knot = fmax(knot / 2, least);
    }
    TD_TRY(set_knots(&j->coarse, j, j->m.o.smooth_s, error));
    return fit_motion(&unused, j, &j->coarse, error);
}

/* ---- which forces are explained ---- */

static td_status find_levers(id_job *j, td_error *error)
{
    const td_robot *robot = j->m.robot;
    const size_t n = (size_t)j->m.n;
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        if (!j->log->acceleration)
            values_at(at, j, &j->fine, td_id_basis(weight, &j->fine.spline, j->log->time_s[i]), weight);
        for (size_t k = 0; k < n; k++) {
            const bool exact = j->log->acceleration;
            const double q = exact ? j->value[i * n + k] : at[0][k],
                         d = exact ? j->log->rate[i * n + k] : at[1][k];
            const td_robot_joint *joint = robot->joint + k;
            const td_cylinder *cylinder = cylinder_of(robot, (int)k);
            double lever = 1;
            if (cylinder && !td_cylinder_length(NULL, &lever, robot, cylinder, q))
                return td_fail(error, TD_ERROR_DATA,
                               "%s: sample %zu: %s at %.4g rad is beyond its cylinder's reach",
                               name_of(j->log), i + 1, joint->name, q);
            j->lever[i * n + k] = fabs(lever);
            j->used[i * n + k] = fabs(d) > MOVES * j->m.o.slip && q > joint->lower + NEAR_STOP &&
                                 q < joint->upper - NEAR_STOP && fabs(lever) > 1e-6;
            j->used_count += j->used[i * n + k];
        }
    }
    if (j->used_count < LEAST_SAMPLES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: joints move faster than %.3g rad/s in %zu samples alone; a motion must be in it",
                       name_of(j->log), MOVES * j->m.o.slip, j->used_count);
    return TD_OK;
}

/* ---- parameters ---- */

/* Inverse of the prior's covariance in sizes. */
static td_status prior_information(double *out, const td_id_model *m, td_error *error)
{
    td_id_prior(out, m, m->o.prior);
    for (int a = 0; a < m->count; a++)
        for (int b = 0; b < m->count; b++) out[a * m->count + b] /= m->base_size[a] * m->base_size[b];
    return td_invert_spd(out, out, (size_t)m->count, error);
}

/* prior information times (prior - beta), in sizes. */
static void prior_pull(double *out, const id_job *j, const double *prior)
{
    const td_id_model *m = &j->m;
    for (int a = 0; a < m->count; a++) {
        out[a] = 0;
        for (int b = 0; b < m->count; b++)
            out[a] += prior[a * m->count + b] * (m->base_prior[b] - j->beta[b]) / m->base_size[b];
    }
}

/* With instruments Z, regressor Y and weight R^-1: (Z' R^-1 Y + P) step = Z' R^-1 r + pull, and covariance
 * A^-1 (Z' R^-1 Z + P) A^-T of it; P is the prior's information. `schur` (2 count, 2 count) holds Z' R^-1 Z
 * and, beside it, Z' R^-1 Y. */
static td_status instrument_step(double *step, id_job *j, const double *schur, const double *right,
                                 const double *prior, const double *pull, td_error *error)
{
    const size_t count = (unsigned)j->m.count, wide = 2 * count;
    double *a = calloc(3 * count * count, sizeof *a), *middle = a + count * count,
           *inverse = middle + count * count;
    lapack_int *pivot = calloc(count, sizeof *pivot);
    td_status status = a && pivot ? TD_OK : no_memory(error);
    for (size_t c = 0; status == TD_OK && c < count; c++) {
        for (size_t d = 0; d < count; d++) {
            j->information[c * count + d] = schur[c * wide + d];
            middle[c * count + d] = schur[c * wide + d] + prior[c * count + d];
            a[c * count + d] = schur[c * wide + count + d] + prior[c * count + d];
        }
        inverse[c * count + c] = 1;
    }
    if (status == TD_OK && LAPACKE_dgesv(LAPACK_ROW_MAJOR, (lapack_int)count, (lapack_int)count, a,
                                         (lapack_int)count, pivot, inverse, (lapack_int)count) != 0)
        status = td_fail(error, TD_ERROR_DATA, "%s: the equations of the parameters cannot be solved",
                         name_of(j->log));
    if (status == TD_OK) status = td_sandwich(j->covariance, inverse, middle, count, count, error);
    for (size_t c = 0; status == TD_OK && c < count; c++) {
        step[c] = 0;
        for (size_t d = 0; d < count; d++) step[c] += inverse[c * count + d] * (right[d] + pull[d]);
    }
    free(a);
    free(pivot);
    return status;
}

static double take_step(id_job *j, const double *step)
{
    double largest = 0;
    for (int c = 0; c < j->m.count; c++) {
        largest = fmax(largest, fabs(step[c]) / sqrt(j->covariance[c * j->m.count + c]));
        j->beta[c] += step[c] * j->m.base_size[c];
    }
    return largest;
}

/* Residuals are linear in the parameters; only their weights, by the mass matrix, are of the last round. */
static td_status iterate(id_job *j, td_arrow *a, const double *prior, double *pull, double *step,
                         td_error *error)
{
    const size_t count = (size_t)j->m.count;
    for (j->rounds = 1; j->rounds <= MOST_ROUNDS; j->rounds++) {
        double chi2 = assemble_motion(a, j, &j->fine);
        TD_TRY(assemble_forces(&chi2, a, j, error));
        TD_TRY(td_arrow_reduce(a, error));
        for (size_t i = 0; i < a->unknowns; i++) {
            const double way = a->turned[2 * count * a->unknowns + i];
            chi2 -= way * way;
        }
        j->chi2 = chi2;
        prior_pull(pull, j, prior);
        TD_TRY(instrument_step(step + count, j, a->corner, a->right, prior, pull, error));
        const double largest = take_step(j, step + count);
        if (!isfinite(largest)) break;
        if (largest < SMALL_CHANGE) return TD_OK;
    }
    return td_fail(error, TD_ERROR_DATA,
                   "%s: the parameters do not settle in %d rounds: forces and motion do not belong together",
                   name_of(j->log), MOST_ROUNDS);
}

/* The motion as the forces see it too: what the model then explains is shown. */
static td_status settle_motion(id_job *j, const td_arrow *a, const double *step, td_error *error)
{
    double *moved = calloc(j->fine.unknowns, sizeof *moved);
    td_status status = moved ? td_arrow_follow(moved, a, step, error) : no_memory(error);
    for (size_t i = 0; status == TD_OK && i < j->fine.unknowns; i++) j->fine.coefficient[i] += moved[i];
    free(moved);
    return status;
}

static td_status fit_all(id_job *j, td_error *error)
{
    const size_t count = (size_t)j->m.count;
    td_arrow a = {0};
    double *prior = calloc(count * count + 3 * count, sizeof *prior);
    td_status status =
        prior ? td_arrow_make(&a, j->fine.unknowns, (size_t)j->channels * ID_SPLINE, 2 * j->m.count, error)
              : no_memory(error);
    double *step =
        prior ? prior + count * count + count : NULL; /* of the instruments: 0; of the parameters */
    if (status == TD_OK) status = prior_information(prior, &j->m, error);
    if (status == TD_OK) status = iterate(j, &a, prior, prior + count * count, step, error);
    if (status == TD_OK) status = settle_motion(j, &a, step, error);
    td_arrow_free(&a);
    free(prior);
    return status;
}

/* ---- exact accelerations: linear least squares ---- */

static void exact_state(td_id_state *s, const id_job *j, size_t i)
{
    const size_t n = (size_t)j->m.n;
    td_id_state_from(s, &j->m, j->value + i * n, j->log->rate + i * n, j->log->acceleration + i * n, false);
}

/* Weighted rows (used_count,count) in sizes, and what the prior does not explain. */
static void stack_rows(double *stack, double *right, const id_job *j, double *rows)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n, count = (size_t)m->count;
    size_t row = 0;
    for (size_t i = 0; i < j->log->count; i++) {
        td_id_state s;
        exact_state(&s, j, i);
        td_id_rows(rows, m, &s);
        for (size_t k = 0; k < n; k++) {
            if (!j->used[i * n + k]) continue;
            const double scale = 1 / (j->lever[i * n + k] * j->sigma_force[k]);
            right[row] = force_residual(j, i, (int)k, rows, NULL);
            for (size_t c = 0; c < count; c++)
                stack[row * count + c] = scale * rows[k * count + c] * m->base_size[c];
            row++;
        }
    }
}

static td_status solve_exact(id_job *j, double *stack, double *work, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t count = (size_t)m->count, rows = j->used_count, area = count * count;
    double *right = work, *step = right + rows, *prior = step + count;
    stack_rows(stack, right, j, prior + area);
    TD_TRY(td_least_squares_linear(step, NULL, stack, right, rows, count, error));
    for (size_t a = 0; a < count; a++)
        for (size_t b = 0; b < count; b++) {
            double sum = 0;
            for (size_t i = 0; i < rows; i++) sum += stack[i * count + a] * stack[i * count + b];
            j->information[a * count + b] = sum;
        }
    for (size_t i = 0; i < rows; i++) {
        double left = right[i];
        for (size_t c = 0; c < count; c++) left -= stack[i * count + c] * step[c];
        j->chi2 += left * left;
    }
    TD_TRY(prior_information(prior, m, error));
    for (size_t i = 0; i < area; i++) j->covariance[i] = j->information[i] + prior[i];
    TD_TRY(td_invert_spd(j->covariance, j->covariance, count, error));
    take_step(j, step);
    return TD_OK;
}

static td_status fit_exact(id_job *j, td_error *error)
{
    const size_t count = (size_t)j->m.count, rows = j->used_count;
    if (rows < count)
        return td_fail(error, TD_ERROR_DATA, "%s: %zu forces are too few for %zu parameters", name_of(j->log),
                       rows, count);
    double *stack = calloc(rows * count, sizeof *stack),
           *work = calloc(rows + count + count * count + (size_t)j->m.n * count, sizeof *work);
    td_status status = stack && work ? solve_exact(j, stack, work, error) : no_memory(error);
    free(stack);
    free(work);
    return status;
}

/* ---- what comes of it ---- */

static td_status fill_parameters(td_identification *id, const id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const double widen = fmax(1, id->misfit * id->misfit);
    for (int a = 0; a < m->count; a++) {
        td_identified *p = id->parameter + a;
        td_id_name(p->name, m, m->column[a]);
        p->means = td_id_words(m, m->group + a * m->standard, 1e-9);
        if (!p->means) return no_memory(error);
        p->unit = td_id_unit(m, m->column[a]);
        p->value = j->beta[a];
        p->prior = m->base_prior[a];
        p->size = m->base_size[a];
        for (int b = 0; b < m->count; b++)
            id->covariance[a * m->count + b] =
                widen * j->covariance[a * m->count + b] * m->base_size[a] * m->base_size[b];
        p->sigma = sqrt(id->covariance[a * m->count + a]);
        p->told = p->sigma <= m->o.told * p->size;
    }
    return TD_OK;
}

/* "boom_mass_x + 0.4 arm_mass_x": components above 0.3 of the largest. */
static char *direction_words(const td_identification *id, const double *direction)
{
    char *text = NULL;
    size_t size = 0;
    double largest = 0;
    bool first = true;
    FILE *f = open_memstream(&text, &size);
    if (!f) return NULL;
    for (int c = 0; c < id->count; c++)
        if (fabs(direction[c]) > fabs(largest)) largest = direction[c];
    for (int c = 0; c < id->count; c++) {
        const double share = direction[c] / largest;
        if (fabs(share) < 0.3) continue;
        fprintf(f, "%s", share < 0 ? (first ? "-" : " - ") : first ? "" : " + ");
        if (share < 0.995) fprintf(f, "%.2f ", fabs(share));
        fputs(id->parameter[c].name, f);
        first = false;
    }
    fclose(f);
    return text;
}

static td_status fill_weak(td_identification *id, const id_job *j, td_error *error)
{
    const size_t count = (size_t)id->count;
    double *work = calloc(count * count + count, sizeof *work), *value = work + count * count;
    id->weak = calloc(MOST_WEAK, sizeof *id->weak);
    td_status status = work && id->weak ? TD_OK : no_memory(error);
    if (status == TD_OK) status = td_eigen_symmetric(value, work, j->covariance, count, error);
    for (size_t i = count; status == TD_OK && i-- > 0 && id->weak_count < MOST_WEAK;) {
        const double share = sqrt(fmax(value[i], 0)) * fmax(1, id->misfit);
        if (share <= j->m.o.told) break;
        td_weak_direction *w = id->weak + id->weak_count++;
        w->share = share;
        w->means = direction_words(id, work + i * count);
        if (!w->means) status = no_memory(error);
    }
    if (status == TD_OK) status = td_eigen_symmetric(value, NULL, j->information, count, error);
    if (status == TD_OK)
        id->condition = value[0] > 1e-13 * value[count - 1] ? sqrt(value[count - 1] / value[0]) : INFINITY;
    free(work);
    return status;
}

static td_status fill_never(td_identification *id, const td_id_model *m, td_error *error)
{
    id->never = calloc((size_t)m->standard, sizeof *id->never);
    if (!id->never) return no_memory(error);
    for (int c = 0; c < 10 * m->links; c++) {
        bool enters = false;
        for (int a = 0; a < m->count; a++) enters = enters || m->group[a * m->standard + c] != 0;
        if (!enters) td_id_name(id->never[id->never_count++], m, c);
    }
    return TD_OK;
}

static td_status fill_samples(td_identification *id, const id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n;
    double *rows = calloc(n * (size_t)m->count, sizeof *rows);
    if (!rows) return no_memory(error);
    for (size_t k = 0; k < n; k++)
        id->joint[k] = (td_identified_joint){.sigma_position = j->sigma[k],
                                             .sigma_rate = j->log->rate ? j->sigma_rate[k] : NAN,
                                             .sigma_force = j->sigma_force[k]};
    if (j->base_moves) memcpy(id->sigma_base, j->sigma + n, sizeof id->sigma_base);
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        td_id_state s;
        if (j->log->acceleration) {
            exact_state(&s, j, i);
        } else {
            values_at(at, j, &j->fine, td_id_basis(weight, &j->fine.spline, j->log->time_s[i]), weight);
            td_id_state_from(&s, m, at[0], at[1], at[2], j->base_moves);
        }
        td_id_rows(rows, m, &s);
        for (size_t k = 0; k < n; k++) {
            const double r =
                force_residual(j, i, (int)k, rows, id->predicted + i * n + k) * j->sigma_force[k];
            if (!j->used[i * n + k]) continue;
            id->joint[k].rms_force += r * r;
            id->joint[k].used++;
        }
    }
    for (size_t k = 0; k < n; k++)
        id->joint[k].rms_force =
            id->joint[k].used ? sqrt(id->joint[k].rms_force / (double)id->joint[k].used) : NAN;
    memcpy(id->used, j->used, j->log->count * n * sizeof *id->used);
    free(rows);
    return TD_OK;
}

static td_status fill(td_identification *id, const id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t count = (size_t)m->count, values = j->log->count * (size_t)m->n;
    id->count = m->count;
    id->parameter = calloc(count, sizeof *id->parameter);
    id->covariance = calloc(count * count, sizeof *id->covariance);
    id->predicted = calloc(values, sizeof *id->predicted);
    id->used = calloc(values, sizeof *id->used);
    if (!id->parameter || !id->covariance || !id->predicted || !id->used) return no_memory(error);
    id->joints = m->n;
    id->samples = j->log->count;
    id->iterations = j->rounds;
    id->spline_misfit = j->log->acceleration ? 0 : spline_misfit(j);
    const double spare = (double)j->used_count - (double)m->count;
    id->misfit = spare > 0 ? sqrt(fmax(j->chi2 - j->spline_chi2, 0) / spare) : 0;
    TD_TRY(fill_parameters(id, j, error));
    TD_TRY(fill_weak(id, j, error));
    TD_TRY(fill_never(id, m, error));
    TD_TRY(fill_samples(id, j, error));
    return td_id_links(id, m, id->covariance, error);
}

/* ---- the door ---- */

static td_status begin(id_job *j, td_error *error)
{
    const size_t count = j->log->count, n = (size_t)j->m.n, base = (size_t)j->m.count;
    j->value = calloc(count * (size_t)j->channels, sizeof *j->value);
    j->lever = calloc(count * n, sizeof *j->lever);
    j->used = calloc(count * n, sizeof *j->used);
    j->beta = calloc(base, sizeof *j->beta);
    j->information = calloc(base * base, sizeof *j->information);
    j->covariance = calloc(base * base, sizeof *j->covariance);
    if (!j->value || !j->lever || !j->used || !j->beta || !j->information || !j->covariance)
        return no_memory(error);
    memcpy(j->beta, j->m.base_prior, base * sizeof *j->beta);
    gather(j);
    return find_noise(j, error);
}

static td_status run(id_job *j, td_error *error)
{
    TD_TRY(begin(j, error));
    if (!j->log->acceleration) TD_TRY(follow_motion(j, error));
    TD_TRY(find_levers(j, error));
    return j->log->acceleration ? fit_exact(j, error) : fit_all(j, error);
}

static void end(id_job *j)
{
    free(j->value);
    free(j->fine.coefficient);
    free(j->coarse.coefficient);
    free(j->lever);
    free(j->used);
    free(j->beta);
    free(j->information);
    free(j->covariance);
    td_id_model_free(&j->m);
}

td_status td_identify(td_identification **identification, const td_motion_log *log, const td_robot *robot,
                      const td_identification_options *options, td_error *error)
{
    const td_identification_options o = options ? *options : td_identification_options_default(robot);
    id_job j = {.log = log, .base_moves = log->base, .channels = robot->joint_count + (log->base ? 6 : 0)};
    TD_TRY(check_options(&o, robot->joint_count, error));
    TD_TRY(check_log(log, robot, error));
    td_identification *id = calloc(1, sizeof *id);
    if (!id) return no_memory(error);
    td_status status = td_id_model_make(&j.m, robot, &o, j.base_moves, error);
    if (status == TD_OK) status = run(&j, error);
    if (status == TD_OK) status = fill(id, &j, error);
    end(&j);
    if (status == TD_OK)
        *identification = id;
    else
        td_identification_free(&id);
    return status;
}

void td_identification_free(td_identification **identification)
{
    td_identification *id = *identification;
    if (!id) return;
    for (int i = 0; id->parameter && i < id->count; i++) free(id->parameter[i].means);
    for (int i = 0; i < id->weak_count; i++) free(id->weak[i].means);
    free(id->parameter);
    free(id->covariance);
    free(id->weak);
    free(id->never);
    free(id->link);
    free(id->predicted);
    free(id->used);
    free(id);
    *identification = NULL;
}
