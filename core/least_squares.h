/* Non-linear least squares over parameter blocks: the C door to Ceres, and the covariance of what it found.
 *
 *     minimise  1/2 sum_i rho_i(|r_i(blocks)|^2)
 *
 * Residuals and their Jacobians are C functions. Jacobians are by the TANGENT of each block: a vector's is
 * the vector itself; a pose's (td_pose: 7 numbers) is pose.h's left perturbation, [rotation; translation], 6
 * numbers.
 *
 * A block may be local: eliminated first (Schur complement), as the poses of views are. No residual touches
 * two local blocks. Blocks that are not local are shared. */
#ifndef TELEDIMOS_CORE_LEAST_SQUARES_H
#define TELEDIMOS_CORE_LEAST_SQUARES_H

#include <stdbool.h>
#include <stddef.h>

#include "log.h"
#include "progress.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_problem td_problem;

typedef enum td_manifold { TD_VECTOR, TD_POSE } td_manifold;

enum { TD_MAX_RESIDUAL_BLOCKS = 8, TD_MAX_BLOCK_SIZE = 32 };

/* Writes residual (rows) and, where jacobian and jacobian[k] are not NULL, jacobian[k] (rows, tangent of
 * block k), row-major. `block[k]` is block k's value. False: cannot be evaluated there (the step is refused).
 */
typedef bool (*td_residual_function)(double *residual, double *const *jacobian, const double *const *block,
                                     const void *user);

/* Applied to the squared length s of each group of a residual's rows; `scale` c is in the residual's unit.
 *   Huber:  s <= c^2: s, else 2 c sqrt(s) - c^2        Cauchy:  c^2 log(1 + s/c^2) */
typedef enum td_loss_kind { TD_LOSS_NONE, TD_LOSS_HUBER, TD_LOSS_CAUCHY } td_loss_kind;
typedef struct td_loss {
    td_loss_kind kind;
    double scale;
    int group; /* rows that share one loss, e.g. 2 for u and v; divides the rows */
} td_loss;

TD_API td_problem *td_problem_new(void); /* NULL: out of memory */
TD_API void td_problem_free(td_problem **problem);

/* Adds a block and returns its number in *block. `value` is borrowed: (size) for a vector, a td_pose (size 7)
 * for a pose; it is read and, when solved, written. */
TD_API td_status td_problem_add_block(td_problem *problem, int *block, double *value, int size,
                                      td_manifold manifold, bool local, td_error *error);
/* Holds a whole block, or one component of its tangent, at its value. */
TD_API td_status td_problem_hold(td_problem *problem, int block, td_error *error);
TD_API td_status td_problem_hold_component(td_problem *problem, int block, int component, td_error *error);

/* Adds `rows` residuals over `block_count` distinct blocks. `user` is borrowed. `loss` may be NULL. */
TD_API td_status td_problem_add_residual(td_problem *problem, td_residual_function function, const void *user,
                                         int rows, const int *block, int block_count, const td_loss *loss,
                                         td_error *error);

/* Adds the prior residual W (value - mean), W (t,t) row-major in the block's tangent (t numbers), `mean` like
 * the block's value; for a pose the difference is log(value * mean^-1). Both are copied. */
TD_API td_status td_problem_add_prior(td_problem *problem, int block, const double *mean,
                                      const double *square_root_information, td_error *error);

typedef struct td_solve_options {
    int max_iterations;          /* > 0; default 100 */
    double function_tolerance;   /* relative change of cost; default 1e-14 */
    double parameter_tolerance;  /* relative change of parameters; default 1e-11 */
    double gradient_tolerance;   /* default 1e-12 */
    int threads;                 /* default 1: the same bytes on every machine; parallelism belongs above */
    const td_progress *progress; /* told of each iteration; may cancel; may be NULL */
    const td_log *log;           /* may be NULL */
} td_solve_options;

TD_API td_solve_options td_solve_options_default(void);
TD_API td_status td_solve_options_check(const td_solve_options *options, td_error *error);

typedef struct td_solve_summary {
    bool converged;
    int iterations;
    double initial_cost, final_cost; /* 1/2 sum rho */
    size_t residuals, parameters;    /* rows, and free tangent components */
    char message[256];               /* "not called" until it was */
} td_solve_summary;

/* Levenberg-Marquardt (Ceres). TD_OK with converged false when it ran out of iterations: values are the best
 * found. `summary` and `options` may be NULL. */
TD_API td_status td_problem_solve(td_problem *problem, td_solve_summary *summary,
                                  const td_solve_options *options, td_error *error);

/* Covariance at the blocks' present values: (J^T J)^-1 with the losses' weights, residuals taken to be of
 * unit variance. Shared blocks by a rank-revealing eigenvalue decomposition after elimination of the local
 * ones. */
typedef struct td_covariance td_covariance;

/* A held block that is itself uncertain: its covariance (t,t), as far as known from elsewhere, is passed on
 * to the others (consider analysis: Bierman 1977, ch. VIII). */
typedef struct td_consider {
    int block;
    const double *covariance; /* (t,t) row-major */
} td_consider;

TD_API td_status td_problem_covariance(td_covariance **covariance, const td_problem *problem,
                                       const td_consider *consider, size_t consider_count, td_error *error);
TD_API void td_covariance_free(td_covariance **covariance);

/* Part of the effect of errors that residuals have in common: their derivatives of the gradient J^T r. */
typedef struct td_common_error {
    int block;
    const double *gradient; /* (t,count), t the block's tangent */
} td_common_error;

/* Adds `count` independent errors of unit variance, beside the residuals' own: a solution x of J^T r = 0
 * moves by -(J^T J)^-1 times the gradient of an error, so that everything asked for afterwards has the
 * covariance of this estimate under correlated errors (the "sandwich"; considered blocks stay apart from
 * them). Each block at most once in `part`; what is not named has gradient 0. Few parts on local blocks keep
 * it cheap. */
TD_API td_status td_covariance_add_common(td_covariance *covariance, size_t count,
                                          const td_common_error *part, size_t part_count, td_error *error);
/* Covariance (ta,tb), row-major, of two blocks' tangents; rows of held components are 0. Along null
 * directions it is that of the other directions only: ask for them first. */
TD_API td_status td_covariance_get(double *out, const td_covariance *covariance, int a, int b,
                                   td_error *error);
/* A part of a linear function of the blocks' tangents: jacobian (rows,t) times that of `block`. */
typedef struct td_linear_part {
    int block;
    const double *jacobian;
} td_linear_part;

/* Covariance (rows,rows), row-major, of y = sum of the parts, each of another block: G C G^T without writing
 * out C, in time proportional to the number of local blocks. Held components add nothing. */
TD_API td_status td_covariance_propagate(double *out, size_t rows, const td_covariance *covariance,
                                         const td_linear_part *part, size_t count, td_error *error);
/* Directions in the shared blocks' free components along which the residuals do not change at all, once the
 * local blocks follow (curvature below 1e-13, each parameter scaled to unit curvature with the local blocks
 * held). */
TD_API size_t td_covariance_null_count(const td_covariance *covariance);
/* Component of null direction `index` along component `component` of `block`; units of the block. */
TD_API double td_covariance_null_direction(const td_covariance *covariance, size_t index, int block,
                                           int component);
/* Sum of squared (robustly weighted) residuals, rows, and free parameters less null directions. */
TD_API double td_covariance_chi2(const td_covariance *covariance);
TD_API size_t td_covariance_rows(const td_covariance *covariance);
TD_API size_t td_covariance_free_parameters(const td_covariance *covariance);

#ifdef __cplusplus
}
#endif
#endif
