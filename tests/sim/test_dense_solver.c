/* Elimination for CVODE's matrices, sim/dense_solver: random matrices of 1 to 60 rows times a known vector
 * give that vector back, to rounding times the condition that such matrices have; zeros on the diagonal, that
 * only pivoting gets past; a singular matrix is refused. Blind to badly conditioned matrices. */
#include "tests/check.h"

#include <nvector/nvector_serial.h>
#include <sunmatrix/sunmatrix_dense.h>

#include "core/random.h"
#include "sim/dense_solver_internal.h"

static void test_solve(void **unused)
{
    SUNContext context;
    td_random random = td_random_seed(7, 1);
    double worst = 0;
    (void)unused;
    assert_int_equal(SUNContext_Create(NULL, &context), 0);
    for (sunindextype n = 1; n <= 60; n++) {
        SUNMatrix a = SUNDenseMatrix(n, n, context);
        N_Vector b = N_VNew_Serial(n, context), x = N_VNew_Serial(n, context);
        SUNLinearSolver solver = td_dense_solver(n, context);
        assert_true(a && b && x && solver);
        double *right = N_VGetArrayPointer(b), *out = N_VGetArrayPointer(x);
        for (sunindextype i = 0; i < n; i++) right[i] = 0;
        for (sunindextype j = 0; j < n; j++)
            for (sunindextype i = 0; i < n; i++) {
                const double value = i == j && n > 1 ? 0 : td_random_normal(&random);
                SM_ELEMENT_D(a, i, j) = value;
                right[i] += value * (double)(j + 1);
            }
        assert_int_equal(SUNLinSolSetup(solver, a), 0);
        assert_int_equal(SUNLinSolSolve(solver, a, x, b, 0), 0);
        for (sunindextype i = 0; i < n; i++) worst = fmax(worst, fabs(out[i] / (double)(i + 1) - 1));
        SUNLinSolFree(solver);
        SUNMatDestroy(a);
        N_VDestroy(b);
        N_VDestroy(x);
    }
    printf("largest error %.1e\n", worst);
    check_less(worst, 1e-10);

    SUNMatrix flat = SUNDenseMatrix(2, 2, context);
    SUNLinearSolver solver = td_dense_solver(2, context);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) SM_ELEMENT_D(flat, i, j) = (i + 1) * (j + 1);
    assert_int_not_equal(SUNLinSolSetup(solver, flat), 0);
    SUNLinSolFree(solver);
    SUNMatDestroy(flat);
    SUNContext_Free(&context);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_solve)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
