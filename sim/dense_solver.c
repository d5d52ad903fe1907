#include "sim/dense_solver_internal.h"

#include <math.h>
#include <stdlib.h>

#include <nvector/nvector_serial.h>
#include <sunmatrix/sunmatrix_dense.h>

typedef struct content {
    sunindextype n, *pivot; /* (n) row that changed places with this one */
    double *inverse;        /* (n) of the diagonal */
} content;

static SUNLinearSolver_Type type(SUNLinearSolver solver)
{
    (void)solver;
    return SUNLINEARSOLVER_DIRECT;
}

static int initialize(SUNLinearSolver solver)
{
    (void)solver;
    return SUNLS_SUCCESS;
}

static void swap(double *column, sunindextype a, sunindextype b)
{
    const double keep = column[a];
    column[a] = column[b];
    column[b] = keep;
}

/* y -= by x */
static void subtract(double *restrict y, const double *restrict x, double by, sunindextype count)
{
    for (sunindextype i = 0; i < count; i++) y[i] -= by * x[i];
}

/* Column by column from the left (Golub and Van Loan, Matrix Computations, 3.2): each is changed by those
 * before it, then its pivot is found. */
static int setup(SUNLinearSolver solver, SUNMatrix matrix)
{
    content *c = solver->content;
    const sunindextype n = c->n;
    double *const a = SM_DATA_D(matrix);
    for (sunindextype j = 0; j < n; j++) {
        double *const own = a + j * n;
        for (sunindextype k = 0; k < j; k++) swap(own, k, c->pivot[k]);
        for (sunindextype k = 0; k < j; k++)
            if (own[k] != 0) subtract(own + k + 1, a + k * n + k + 1, own[k], n - k - 1);
        sunindextype best = j;
        for (sunindextype i = j + 1; i < n; i++)
            if (fabs(own[i]) > fabs(own[best])) best = i;
        if (!(fabs(own[best]) > 0)) return SUNLS_LUFACT_FAIL;
        c->pivot[j] = best;
        for (sunindextype k = 0; k <= j && best != j; k++) swap(a + k * n, j, best);
        c->inverse[j] = 1 / own[j];
        for (sunindextype i = j + 1; i < n; i++) own[i] *= c->inverse[j];
    }
    return SUNLS_SUCCESS;
}

static int solve(SUNLinearSolver solver, SUNMatrix matrix, N_Vector out, N_Vector right, realtype tolerance)
{
    const content *c = solver->content;
    const sunindextype n = c->n;
    const double *const a = SM_DATA_D(matrix);
    (void)tolerance;
    N_VScale(1, right, out);
    double *const x = N_VGetArrayPointer(out);
    for (sunindextype k = 0; k < n; k++) swap(x, k, c->pivot[k]);
    for (sunindextype k = 0; k < n; k++)
        if (x[k] != 0) subtract(x + k + 1, a + k * n + k + 1, x[k], n - k - 1);
    for (sunindextype k = n - 1; k >= 0; k--) {
        x[k] *= c->inverse[k];
        if (x[k] != 0) subtract(x, a + k * n, x[k], k);
    }
    return SUNLS_SUCCESS;
}

static int release(SUNLinearSolver solver)
{
    content *c = solver->content;
    if (c) {
        free(c->pivot);
        free(c->inverse);
        free(c);
    }
    solver->content = NULL;
    SUNLinSolFreeEmpty(solver);
    return SUNLS_SUCCESS;
}

SUNLinearSolver td_dense_solver(sunindextype size, SUNContext context)
{
    SUNLinearSolver solver = SUNLinSolNewEmpty(context);
    if (!solver) return NULL;
    content *c = calloc(1, sizeof *c);
    solver->content = c;
    solver->ops->gettype = type;
    solver->ops->initialize = initialize;
    solver->ops->setup = setup;
    solver->ops->solve = solve;
    solver->ops->free = release;
    if (c) {
        c->n = size;
        c->pivot = calloc((size_t)size, sizeof *c->pivot);
        c->inverse = calloc((size_t)size, sizeof *c->inverse);
        if (c->pivot && c->inverse) return solver;
    }
    release(solver);
    return NULL;
}
