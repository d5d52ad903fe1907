/* The estimate: the motion as splines, the parameters by instrumental variables. */
#include "sim/identification.h"

#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/identification_internal.h"
#include "sim/machine.h"

enum { LEAST_FORCES = 60, LEAST_KNOTS = 8, MOST_ROUNDS = 40 };
static const double PI = 3.14159265358979323846;
/* Samples to a knot, at least. */
static const double SAMPLES_A_KNOT = 2.5;
/* In slips: slower, a joint's friction is not whole and its equation left out. */
static const double MOVES = 4;
/* rad or m: as near to a stop, a joint may be in it. */
static const double NEAR_STOP = 2e-3;
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

/* ---- work ---- */

td_status td_id_no_memory(td_error *error)
{
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the identification");
}

static bool turns(const td_id_job *j, int channel)
{
    return channel < j->m.n ? j->m.robot->joint[channel].kind == TD_JOINT_CONTINUOUS : channel >= j->m.n + 3;
}

static void gather(td_id_job *j)
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
static double force_span(const td_id_job *j, size_t k)
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

static td_status find_noise(td_id_job *j, td_error *error)
{
    const td_identification_options *o = &j->m.o;
    const size_t count = j->log->count, n = (size_t)j->m.n;
    double *work = calloc(count, sizeof *work);
    if (!work) return td_id_no_memory(error);
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

static td_status set_knots(td_id_motion *motion, const td_id_job *j, double knot_s, td_error *error)
{
    const td_motion_log *log = j->log;
    const double first = log->time_s[0], all = log->time_s[log->count - 1] - first;
    const double step = fmax(knot_s, SAMPLES_A_KNOT * median_step(log));
    if (all < LEAST_KNOTS * step)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: %.3g s are too short to identify anything from; at least %.3g are needed",
                       td_id_log_name(log), all, LEAST_KNOTS * step);
    for (size_t i = 1; i < log->count; i++)
        if (log->time_s[i] - log->time_s[i - 1] > 2 * step)
            return td_fail(
                error, TD_ERROR_DATA,
                "%s: sample %zu: a gap of %.3g s before it; give a log without gaps, or a part of it",
                td_id_log_name(log), i + 1, log->time_s[i] - log->time_s[i - 1]);
    motion->spline.first = first;
    motion->spline.intervals = (size_t)floor(all / step);
    motion->spline.step = all / (double)motion->spline.intervals;
    motion->unknowns = (motion->spline.intervals + ID_SPLINE - 1) * (size_t)j->channels;
    free(motion->coefficient);
    motion->coefficient = calloc(motion->unknowns, sizeof *motion->coefficient);
    return motion->coefficient ? TD_OK : td_id_no_memory(error);
}

/* ---- rows ---- */

/* Values, rates and second derivatives (3,channels) of the splines. */
void td_id_values_at(double out[3][TD_DYNAMICS_MAX], const td_id_job *j, const td_id_motion *motion,
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
static double add_measured(td_arrow *a, const td_id_job *j, size_t first, const double weight[ID_SPLINE],
                           int channel, double difference, double sigma)
{
    double row[ID_SPLINE * TD_DYNAMICS_MAX] = {0};
    const size_t wide = (size_t)j->channels;
    for (size_t r = 0; a && r < ID_SPLINE; r++) row[r * wide + (size_t)channel] = weight[r] / sigma;
    if (a) td_arrow_add(a, first * wide, row, ID_SPLINE * wide, NULL, difference / sigma);
    return difference * difference / (sigma * sigma);
}

static double add_motion(td_arrow *a, const td_id_job *j, size_t i, size_t first, double weight[3][ID_SPLINE],
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
double td_id_force_residual(const td_id_job *j, size_t i, int k, const double *rows, double *force)
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
static void add_force(td_arrow *a, const td_id_job *j, size_t i, int k, size_t first,
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
    td_arrow_add(a, first * wide, row, ID_SPLINE * wide, border, td_id_force_residual(j, i, k, rows, NULL));
}

/* Rows (n,count) of the regressor on a motion at a time; its state in *s and its rates in `rate`. */
static void rows_at(double *rows, td_id_state *s, double rate[TD_DYNAMICS_MAX], const td_id_job *j,
                    const td_id_motion *motion, double time_s)
{
    double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
    const size_t first = td_id_basis(weight, &motion->spline, time_s);
    td_id_values_at(at, j, motion, first, weight);
    td_id_state_from(s, &j->m, at[0], at[1], at[2], j->base_moves);
    td_id_rows(rows, &j->m, s);
    memcpy(rate, at[1], sizeof at[1]);
}

/* Sum of squared residuals of the forces; their rows into `a`. */
static td_status assemble_forces(double *chi2, td_arrow *a, const td_id_job *j, td_error *error)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n, size = n * (size_t)m->count;
    double *rows = calloc(size * (size_t)(2 + j->channels), sizeof *rows), *smooth = rows + size,
           *unit = smooth + size;
    if (!rows) return td_id_no_memory(error);
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
            const double r = td_id_force_residual(j, i, k, rows, NULL);
            *chi2 += r * r;
            add_force(a, j, i, k, first, weight, smooth, rows, unit, rate[k]);
        }
    }
    free(rows);
    return TD_OK;
}

/* Sum of squared residuals of positions, poses and rates; their rows into `a` (may be NULL). */
static double assemble_motion(td_arrow *a, const td_id_job *j, const td_id_motion *motion)
{
    double chi2 = 0;
    if (a) td_arrow_clear(a);
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        const size_t first = td_id_basis(weight, &motion->spline, j->log->time_s[i]);
        td_id_values_at(at, j, motion, first, weight);
        chi2 += add_motion(a, j, i, first, weight, at);
    }
    return chi2;
}

/* ---- the motion alone ---- */

static td_status fit_motion(double *chi2, const td_id_job *j, td_id_motion *motion, td_error *error)
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

double td_id_spline_misfit(const td_id_job *j)
{
    const size_t rows = j->log->count * (size_t)(j->channels + (j->log->rate ? j->m.n : 0));
    return rows > j->fine.unknowns ? sqrt(j->spline_chi2 / (double)(rows - j->fine.unknowns)) : 0;
}

/* Knots are halved while the splines do not follow the motion to its noise. */
static td_status follow_motion(td_id_job *j, td_error *error)
{
    double knot = j->m.o.knot_s, unused = 0;
    const double least = SAMPLES_A_KNOT * median_step(j->log);
    while (true) {
        TD_TRY(set_knots(&j->fine, j, knot, error));
        TD_TRY(fit_motion(&j->spline_chi2, j, &j->fine, error));
        if (td_id_spline_misfit(j) < 1.1 || knot <= least) break;
        knot = fmax(knot / 2, least);
    }
    TD_TRY(set_knots(&j->coarse, j, j->m.o.smooth_s, error));
    return fit_motion(&unused, j, &j->coarse, error);
}

/* ---- which forces are explained ---- */

static td_status find_levers(td_id_job *j, td_error *error)
{
    const td_robot *robot = j->m.robot;
    const size_t n = (size_t)j->m.n;
    for (size_t i = 0; i < j->log->count; i++) {
        double weight[3][ID_SPLINE], at[3][TD_DYNAMICS_MAX];
        if (!j->log->acceleration)
            td_id_values_at(at, j, &j->fine, td_id_basis(weight, &j->fine.spline, j->log->time_s[i]), weight);
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
                               td_id_log_name(j->log), i + 1, joint->name, q);
            j->lever[i * n + k] = fabs(lever);
            j->used[i * n + k] = fabs(d) > MOVES * j->m.o.slip && q > joint->lower + NEAR_STOP &&
                                 q < joint->upper - NEAR_STOP && fabs(lever) > 1e-6;
            j->used_count += j->used[i * n + k];
        }
    }
    if (j->used_count < LEAST_FORCES)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: joints move faster than %.3g rad/s in %zu samples alone; a motion must be in it",
                       td_id_log_name(j->log), MOVES * j->m.o.slip, j->used_count);
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
static void prior_pull(double *out, const td_id_job *j, const double *prior)
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
static td_status instrument_step(double *step, td_id_job *j, const double *schur, const double *right,
                                 const double *prior, const double *pull, td_error *error)
{
    const size_t count = (unsigned)j->m.count, wide = 2 * count;
    double *a = calloc(3 * count * count, sizeof *a), *middle = a + count * count,
           *inverse = middle + count * count;
    lapack_int *pivot = calloc(count, sizeof *pivot);
    td_status status = a && pivot ? TD_OK : td_id_no_memory(error);
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
                         td_id_log_name(j->log));
    if (status == TD_OK) status = td_sandwich(j->covariance, inverse, middle, count, count, error);
    for (size_t c = 0; status == TD_OK && c < count; c++) {
        step[c] = 0;
        for (size_t d = 0; d < count; d++) step[c] += inverse[c * count + d] * (right[d] + pull[d]);
    }
    free(a);
    free(pivot);
    return status;
}

static double take_step(td_id_job *j, const double *step)
{
    double largest = 0;
    for (int c = 0; c < j->m.count; c++) {
        largest = fmax(largest, fabs(step[c]) / sqrt(j->covariance[c * j->m.count + c]));
        j->beta[c] += step[c] * j->m.base_size[c];
    }
    return largest;
}

/* Residuals are linear in the parameters; only their weights, by the mass matrix, are of the last round. */
static td_status iterate(td_id_job *j, td_arrow *a, const double *prior, double *pull, double *step,
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
                   td_id_log_name(j->log), MOST_ROUNDS);
}

/* The motion as the forces see it too: what the model then explains is shown. */
static td_status settle_motion(td_id_job *j, const td_arrow *a, const double *step, td_error *error)
{
    double *moved = calloc(j->fine.unknowns, sizeof *moved);
    td_status status = moved ? td_arrow_follow(moved, a, step, error) : td_id_no_memory(error);
    for (size_t i = 0; status == TD_OK && i < j->fine.unknowns; i++) j->fine.coefficient[i] += moved[i];
    free(moved);
    return status;
}

static td_status fit_all(td_id_job *j, td_error *error)
{
    const size_t count = (size_t)j->m.count;
    td_arrow a = {0};
    double *prior = calloc(count * count + 3 * count, sizeof *prior);
    td_status status =
        prior ? td_arrow_make(&a, j->fine.unknowns, (size_t)j->channels * ID_SPLINE, 2 * j->m.count, error)
              : td_id_no_memory(error);
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

void td_id_exact_state(td_id_state *s, const td_id_job *j, size_t i)
{
    const size_t n = (size_t)j->m.n;
    td_id_state_from(s, &j->m, j->value + i * n, j->log->rate + i * n, j->log->acceleration + i * n, false);
}

/* Weighted rows (used_count,count) in sizes, and what the prior does not explain. */
static void stack_rows(double *stack, double *right, const td_id_job *j, double *rows)
{
    const td_id_model *m = &j->m;
    const size_t n = (size_t)m->n, count = (size_t)m->count;
    size_t row = 0;
    for (size_t i = 0; i < j->log->count; i++) {
        td_id_state s;
        td_id_exact_state(&s, j, i);
        td_id_rows(rows, m, &s);
        for (size_t k = 0; k < n; k++) {
            if (!j->used[i * n + k]) continue;
            const double scale = 1 / (j->lever[i * n + k] * j->sigma_force[k]);
            right[row] = td_id_force_residual(j, i, (int)k, rows, NULL);
            for (size_t c = 0; c < count; c++)
                stack[row * count + c] = scale * rows[k * count + c] * m->base_size[c];
            row++;
        }
    }
}

static td_status solve_exact(td_id_job *j, double *stack, double *work, td_error *error)
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

static td_status fit_exact(td_id_job *j, td_error *error)
{
    const size_t count = (size_t)j->m.count, rows = j->used_count;
    if (rows < count)
        return td_fail(error, TD_ERROR_DATA, "%s: %zu forces are too few for %zu parameters",
                       td_id_log_name(j->log), rows, count);
    double *stack = calloc(rows * count, sizeof *stack),
           *work = calloc(rows + count + count * count + (size_t)j->m.n * count, sizeof *work);
    td_status status = stack && work ? solve_exact(j, stack, work, error) : td_id_no_memory(error);
    free(stack);
    free(work);
    return status;
}

/* ---- the door ---- */

static td_status begin(td_id_job *j, td_error *error)
{
    const size_t count = j->log->count, n = (size_t)j->m.n, base = (size_t)j->m.count;
    j->value = calloc(count * (size_t)j->channels, sizeof *j->value);
    j->lever = calloc(count * n, sizeof *j->lever);
    j->used = calloc(count * n, sizeof *j->used);
    j->beta = calloc(base, sizeof *j->beta);
    j->information = calloc(base * base, sizeof *j->information);
    j->covariance = calloc(base * base, sizeof *j->covariance);
    if (!j->value || !j->lever || !j->used || !j->beta || !j->information || !j->covariance)
        return td_id_no_memory(error);
    memcpy(j->beta, j->m.base_prior, base * sizeof *j->beta);
    gather(j);
    return find_noise(j, error);
}

static td_status run(td_id_job *j, td_error *error)
{
    TD_TRY(begin(j, error));
    if (!j->log->acceleration) TD_TRY(follow_motion(j, error));
    TD_TRY(find_levers(j, error));
    return j->log->acceleration ? fit_exact(j, error) : fit_all(j, error);
}

static void end(td_id_job *j)
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
    td_id_job j = {.log = log, .base_moves = log->base, .channels = robot->joint_count + (log->base ? 6 : 0)};
    TD_TRY(td_id_check_options(&o, robot->joint_count, error));
    TD_TRY(td_id_check_log(log, robot, error));
    td_identification *id = calloc(1, sizeof *id);
    if (!id) return td_id_no_memory(error);
    td_status status = td_id_model_make(&j.m, robot, &o, j.base_moves, error);
    if (status == TD_OK) status = run(&j, error);
    if (status == TD_OK) status = td_id_fill(id, &j, error);
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
