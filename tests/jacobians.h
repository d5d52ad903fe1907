/* Checks every Jacobian of a least-squares problem against central differences: non-zero somewhere, close
 * everywhere, not identical everywhere (which would mean that it is a difference itself), and residuals that
 * do not depend on whether Jacobians are asked for. */
#ifndef TELEDIMOS_TESTS_JACOBIANS_H
#define TELEDIMOS_TESTS_JACOBIANS_H

#include "core/least_squares_internal.h"
#include "core/pose.h"
#include "tests/check.h"

static inline void move_block(double *out, const td_block *block, const double *value, int component,
                              double step)
{
    double delta[TD_MAX_BLOCK_SIZE] = {0};
    delta[component] = step;
    if (block->manifold == TD_POSE) {
        td_pose pose, moved;
        memcpy(&pose, value, sizeof pose);
        moved = td_pose_perturb(&pose, delta);
        memcpy(out, &moved, sizeof moved);
    } else {
        for (int i = 0; i < block->size; i++) out[i] = value[i] + delta[i];
    }
}

/* Steps relative to each component's size; `tolerance` relative to the largest element of the block's
 * Jacobian. */
static inline void check_problem_jacobians(const td_problem *problem, double tolerance)
{
    bool identical = true;
    for (size_t i = 0; i < problem->residual_count; i++) {
        const td_residual *r = &problem->residual[i];
        size_t rows = (size_t)r->rows;
        double *residual = malloc(4 * rows * sizeof *residual), *plus = residual + rows, *minus = plus + rows,
               *again = minus + rows;
        double *jacobian[TD_MAX_RESIDUAL_BLOCKS];
        const double *value[TD_MAX_RESIDUAL_BLOCKS];
        for (int b = 0; b < r->block_count; b++) {
            value[b] = problem->block[r->block[b]].value;
            jacobian[b] = malloc(rows * TD_MAX_BLOCK_SIZE * sizeof(double));
            for (size_t k = 0; k < rows * TD_MAX_BLOCK_SIZE; k++) jacobian[b][k] = NAN;
        }
        assert_true(td_residual_evaluate(problem, r, residual, jacobian, value));
        assert_true(td_residual_evaluate(problem, r, again, NULL, value));
        for (size_t k = 0; k < rows; k++) check_near(residual[k], again[k], 0);
        for (int b = 0; b < r->block_count; b++) {
            const td_block *block = &problem->block[r->block[b]];
            double largest = 0, moved[TD_MAX_BLOCK_SIZE];
            const double *kept = value[b];
            for (size_t k = 0; k < rows * (size_t)block->tangent; k++)
                largest = fmax(largest, fabs(jacobian[b][k]));
            assert_true(largest > 0);
            for (int c = 0; c < block->tangent; c++) {
                /* Large enough for the rounding of residuals of some 1000 px. */
                double step = block->manifold == TD_POSE ? 1e-6 : 1e-5 * fmax(fabs(kept[c]), 0.1);
                double column = 0;
                move_block(moved, block, kept, c, step);
                value[b] = moved;
                assert_true(td_residual_evaluate(problem, r, plus, NULL, value));
                move_block(moved, block, kept, c, -step);
                assert_true(td_residual_evaluate(problem, r, minus, NULL, value));
                value[b] = kept;
                for (size_t k = 0; k < rows; k++)
                    column = fmax(column, fabs(jacobian[b][k * (size_t)block->tangent + (size_t)c]));
                for (size_t k = 0; k < rows; k++) {
                    double analytic = jacobian[b][k * (size_t)block->tangent + (size_t)c];
                    double difference = (plus[k] - minus[k]) / (2 * step);
                    check_near(analytic, difference, tolerance * fmax(column, 1e-3 * largest) + 1e-7);
                    identical = identical && analytic == difference;
                }
            }
        }
        for (int b = 0; b < r->block_count; b++) free(jacobian[b]);
        free(residual);
    }
    assert_false(identical);
}

#endif
