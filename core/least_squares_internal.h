/* What the rooms of least_squares share: the problem's description, and how a residual is evaluated. */
#ifndef TELEDIMOS_CORE_LEAST_SQUARES_INTERNAL_H
#define TELEDIMOS_CORE_LEAST_SQUARES_INTERNAL_H

#include <stdint.h>

#include "core/least_squares.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_block {
    double *value;
    int size, tangent; /* numbers in the value; components of the tangent */
    td_manifold manifold;
    bool local, held;
    uint32_t held_components; /* bit i: component i of the tangent */
} td_block;

typedef struct td_prior {
    int tangent;
    td_manifold manifold;
    double mean[TD_MAX_BLOCK_SIZE];
    double weight[]; /* (tangent,tangent) */
} td_prior;

typedef struct td_residual {
    td_residual_function function;
    const void *user;
    int rows, block_count;
    int block[TD_MAX_RESIDUAL_BLOCKS];
    td_loss loss;
    td_prior *prior; /* owned; NULL unless this is one */
} td_residual;

struct td_problem {
    td_block *block;
    size_t block_count, block_capacity;
    td_residual *residual;
    size_t residual_count, residual_capacity;
    int max_rows;
};

/* Evaluates one residual at the given block values, losses applied to residual and Jacobians. */
bool td_residual_evaluate(const td_problem *problem, const td_residual *residual, double *out,
                          double *const *jacobian, const double *const *value);

static inline bool td_block_component_free(const td_block *block, int component)
{
    return !block->held && !(block->held_components >> component & 1);
}

/* The wall: least_squares_ceres.cpp. */
td_status td_ceres_solve(td_problem *problem, td_solve_summary *summary, const td_solve_options *options,
                         td_error *error);

#ifdef __cplusplus
}
#endif
#endif
