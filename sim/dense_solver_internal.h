/* Gaussian elimination with partial pivoting for CVODE's dense matrices of some tens of rows: SUNDIALS' own
 * spends 40 % of a machine's simulation there, one number at a time; these loops run along columns. */
#ifndef TELEDIMOS_SIM_DENSE_SOLVER_INTERNAL_H
#define TELEDIMOS_SIM_DENSE_SOLVER_INTERNAL_H

#include <sundials/sundials_linearsolver.h>

/* NULL: out of memory. Freed with SUNLinSolFree. */
SUNLinearSolver td_dense_solver(sunindextype size, SUNContext context);

#endif
