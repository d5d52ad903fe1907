#include "core/least_squares.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/least_squares_internal.h"
#include "core/pose.h"

td_problem *td_problem_new(void)
{
    return calloc(1, sizeof(td_problem));
}

void td_problem_free(td_problem **problem)
{
    if (!problem || !*problem) return;
    for (size_t i = 0; i < (*problem)->residual_count; i++) free((*problem)->residual[i].prior);
    free((*problem)->residual);
    free((*problem)->block);
    free(*problem);
    *problem = NULL;
}

/* Makes room for one more element of `size` bytes. */
static bool grow(void **array, size_t *capacity, size_t count, size_t size)
{
    if (count < *capacity) return true;
    size_t wanted = *capacity ? 2 * *capacity : 16;
    void *larger = realloc(*array, wanted * size);
    if (!larger) return false;
    *array = larger;
    *capacity = wanted;
    return true;
}

td_status td_problem_add_block(td_problem *problem, int *block, double *value, int size, td_manifold manifold,
                               bool local, td_error *error)
{
    if (size <= 0 || size > TD_MAX_BLOCK_SIZE || (manifold == TD_POSE && size != 7))
        return td_fail(error, TD_ERROR_ARGUMENT, "a block of %d numbers: 1–%d, or 7 for a pose", size,
                       TD_MAX_BLOCK_SIZE);
    if (!grow((void **)&problem->block, &problem->block_capacity, problem->block_count,
              sizeof *problem->block))
        return td_fail(error, TD_ERROR_MEMORY, "no memory for block %zu", problem->block_count);
    *block = (int)problem->block_count++;
    problem->block[*block] = (td_block){.value = value,
                                        .size = size,
                                        .tangent = manifold == TD_POSE ? 6 : size,
                                        .manifold = manifold,
                                        .local = local};
    return TD_OK;
}

static td_status check_block(const td_problem *problem, int block, td_error *error)
{
    if (block < 0 || (size_t)block >= problem->block_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "there is no block %d", block);
    return TD_OK;
}

td_status td_problem_hold(td_problem *problem, int block, td_error *error)
{
    TD_TRY(check_block(problem, block, error));
    problem->block[block].held = true;
    return TD_OK;
}

td_status td_problem_hold_component(td_problem *problem, int block, int component, td_error *error)
{
    TD_TRY(check_block(problem, block, error));
    td_block *b = &problem->block[block];
    if (component < 0 || component >= b->tangent)
        return td_fail(error, TD_ERROR_ARGUMENT, "block %d has no component %d", block, component);
    b->held_components |= (uint32_t)1 << component;
    if (b->held_components == (uint32_t)(((uint64_t)1 << b->tangent) - 1)) b->held = true;
    return TD_OK;
}

td_status td_problem_add_residual(td_problem *problem, td_residual_function function, const void *user,
                                  int rows, const int *block, int block_count, const td_loss *loss,
                                  td_error *error)
{
    if (!function || rows <= 0 || block_count <= 0 || block_count > TD_MAX_RESIDUAL_BLOCKS)
        return td_fail(error, TD_ERROR_ARGUMENT, "a residual of %d rows over %d blocks", rows, block_count);
    td_residual r = {.function = function, .user = user, .rows = rows, .block_count = block_count};
    if (loss) r.loss = *loss;
    if (r.loss.kind != TD_LOSS_NONE && (!(r.loss.scale > 0) || r.loss.group <= 0 || rows % r.loss.group))
        return td_fail(error, TD_ERROR_ARGUMENT, "loss: scale %g must be > 0, group %d must divide %d rows",
                       r.loss.scale, r.loss.group, rows);
    int locals = 0;
    for (int i = 0; i < block_count; i++) {
        TD_TRY(check_block(problem, block[i], error));
        for (int k = 0; k < i; k++)
            if (block[k] == block[i])
                return td_fail(error, TD_ERROR_ARGUMENT, "a residual names block %d twice", block[i]);
        locals += problem->block[block[i]].local;
        r.block[i] = block[i];
    }
    if (locals > 1) return td_fail(error, TD_ERROR_ARGUMENT, "a residual touches %d local blocks", locals);
    if (!grow((void **)&problem->residual, &problem->residual_capacity, problem->residual_count,
              sizeof *problem->residual))
        return td_fail(error, TD_ERROR_MEMORY, "no memory for residual %zu", problem->residual_count);
    problem->residual[problem->residual_count++] = r;
    if (rows > problem->max_rows) problem->max_rows = rows;
    return TD_OK;
}

static bool evaluate_prior(double *residual, double *const *jacobian, const double *const *block,
                           const void *user)
{
    const td_prior *prior = user;
    int t = prior->tangent;
    double difference[TD_MAX_BLOCK_SIZE], d[36];
    if (prior->manifold == TD_POSE) {
        td_pose value, mean;
        memcpy(&value, block[0], sizeof value);
        memcpy(&mean, prior->mean, sizeof mean);
        td_pose inverse = td_pose_inverse(&mean), delta = td_pose_compose(&value, &inverse);
        td_pose_log(difference, &delta);
        td_pose_left_jacobian_inverse(d, difference);
    } else {
        for (int i = 0; i < t; i++) difference[i] = block[0][i] - prior->mean[i];
    }
    for (int i = 0; i < t; i++) {
        const double *w = prior->weight + i * t;
        residual[i] = 0;
        for (int k = 0; k < t; k++) residual[i] += w[k] * difference[k];
        if (!jacobian || !jacobian[0]) continue;
        for (int k = 0; k < t; k++) {
            double sum = 0;
            if (prior->manifold == TD_POSE)
                for (int l = 0; l < 6; l++) sum += w[l] * d[6 * l + k];
            else
                sum = w[k];
            jacobian[0][i * t + k] = sum;
        }
    }
    return true;
}

td_status td_problem_add_prior(td_problem *problem, int block, const double *mean,
                               const double *square_root_information, td_error *error)
{
    TD_TRY(check_block(problem, block, error));
    const td_block *b = &problem->block[block];
    size_t weights = (size_t)b->tangent * b->tangent;
    td_prior *prior = malloc(sizeof *prior + weights * sizeof(double));
    if (!prior) return td_fail(error, TD_ERROR_MEMORY, "no memory for a prior");
    prior->tangent = b->tangent;
    prior->manifold = b->manifold;
    memcpy(prior->mean, mean, (size_t)b->size * sizeof *mean);
    memcpy(prior->weight, square_root_information, weights * sizeof(double));
    td_status status =
        td_problem_add_residual(problem, evaluate_prior, prior, b->tangent, &block, 1, NULL, error);
    if (status == TD_OK)
        problem->residual[problem->residual_count - 1].prior = prior;
    else
        free(prior);
    return status;
}

/* Replaces a group's r by w r, w = sqrt(rho(s)/s), so that its square is rho(s), and J by the derivative of w
 * r. */
static void apply_loss(const td_loss *loss, double *r, double *const *jacobian, const int *tangent,
                       int blocks, int row)
{
    double s = 0, c2 = loss->scale * loss->scale;
    for (int i = 0; i < loss->group; i++) s += r[row + i] * r[row + i];
    if (s < 1e-12 * c2) return;
    if (loss->kind == TD_LOSS_HUBER && s <= c2) return;
    double rho = loss->kind == TD_LOSS_HUBER ? 2 * loss->scale * sqrt(s) - c2 : c2 * log1p(s / c2);
    double slope = loss->kind == TD_LOSS_HUBER ? loss->scale / sqrt(s) : 1 / (1 + s / c2);
    double w = sqrt(rho / s), w2 = (slope * s - rho) / (w * s * s); /* w2 = 2 dw/ds */
    for (int b = 0; b < blocks; b++) {
        if (!jacobian || !jacobian[b]) continue;
        int t = tangent[b];
        for (int k = 0; k < t; k++) {
            double along = 0;
            for (int i = 0; i < loss->group; i++) along += r[row + i] * jacobian[b][(row + i) * t + k];
            for (int i = 0; i < loss->group; i++) {
                double *j = &jacobian[b][(row + i) * t + k];
                *j = w * *j + w2 * along * r[row + i];
            }
        }
    }
    for (int i = 0; i < loss->group; i++) r[row + i] *= w;
}

bool td_residual_evaluate(const td_problem *problem, const td_residual *residual, double *out,
                          double *const *jacobian, const double *const *value)
{
    const void *user = residual->prior ? residual->prior : residual->user;
    if (!residual->function(out, jacobian, value, user)) return false;
    if (residual->loss.kind == TD_LOSS_NONE) return true;
    int tangent[TD_MAX_RESIDUAL_BLOCKS];
    for (int i = 0; i < residual->block_count; i++) tangent[i] = problem->block[residual->block[i]].tangent;
    for (int row = 0; row < residual->rows; row += residual->loss.group)
        apply_loss(&residual->loss, out, jacobian, tangent, residual->block_count, row);
    return true;
}

td_solve_options td_solve_options_default(void)
{
    return (td_solve_options){.max_iterations = 100,
                              .function_tolerance = 1e-14,
                              .parameter_tolerance = 1e-11,
                              .gradient_tolerance = 1e-12,
                              .threads = 1};
}

td_status td_solve_options_check(const td_solve_options *options, td_error *error)
{
    if (options->max_iterations <= 0) return td_fail(error, TD_ERROR_ARGUMENT, "max_iterations: must be > 0");
    if (!(options->function_tolerance >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "function_tolerance: must be >= 0");
    if (!(options->parameter_tolerance >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "parameter_tolerance: must be >= 0");
    if (!(options->gradient_tolerance >= 0))
        return td_fail(error, TD_ERROR_ARGUMENT, "gradient_tolerance: must be >= 0");
    if (options->threads < 1) return td_fail(error, TD_ERROR_ARGUMENT, "threads: must be >= 1");
    return TD_OK;
}

td_status td_problem_solve(td_problem *problem, td_solve_summary *summary, const td_solve_options *options,
                           td_error *error)
{
    td_solve_options defaults = td_solve_options_default();
    td_solve_summary ignored;
    if (!options) options = &defaults;
    if (!summary) summary = &ignored;
    *summary = (td_solve_summary){.initial_cost = INFINITY, .final_cost = INFINITY, .message = "not called"};
    TD_TRY(td_solve_options_check(options, error));
    return td_ceres_solve(problem, summary, options, error);
}
