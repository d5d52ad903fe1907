/* Proves: each wrapper solves what its header says, on random problems with known answers; row-major
 * throughout (every matrix used is asymmetric where it may be). Tolerance: condition numbers are below 1e4,
 * so 1e-10 leaves room. Blind to: ill-conditioned input, which LAPACK's own tests cover. */
#include "core/linalg.h"
#include "core/random.h"
#include "tests/check.h"

static void random_matrix(double *a, size_t count, td_random *random)
{
    for (size_t i = 0; i < count; i++) a[i] = td_random_normal(random);
}

static void test_eigen(void **state)
{
    (void)state;
    enum { N = 7 };
    double a[N * N], s[N * N], value[N], vector[N * N];
    td_error error = {0};
    td_random random = td_random_seed(1, 1);
    random_matrix(a, N * N, &random);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) s[N * i + j] = a[N * i + j] + a[N * j + i];
    check_ok(td_eigen_symmetric(value, vector, s, N, &error), error);
    for (int k = 0; k < N; k++) {
        if (k) assert_true(value[k] >= value[k - 1]);
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int j = 0; j < N; j++) sum += s[N * i + j] * vector[N * k + j];
            check_near(sum, value[k] * vector[N * k + i], 1e-10);
        }
    }
    s[3] = s[3 * N] = NAN;
    assert_int_not_equal(td_eigen_symmetric(value, vector, s, N, &error), TD_OK);
}

static void test_null_vector(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(2, 1);
    /* Wide, square and tall. */
    for (size_t m = 4; m <= 12; m += 4) {
        enum { N = 5 };
        double x[N], a[12 * N], found[N], ratio, norm = 0, dot = 0;
        random_matrix(x, N, &random);
        for (int i = 0; i < N; i++) norm += x[i] * x[i];
        for (int i = 0; i < N; i++) x[i] /= sqrt(norm);
        random_matrix(a, m * N, &random);
        for (size_t r = 0; r < m; r++) {
            double along = 0;
            for (int i = 0; i < N; i++) along += a[r * N + (size_t)i] * x[i];
            for (int i = 0; i < N; i++) a[r * N + (size_t)i] -= along * x[i];
        }
        check_ok(td_null_vector(found, &ratio, a, m, N, &error), error);
        for (int i = 0; i < N; i++) dot += found[i] * x[i];
        check_near(fabs(dot), 1, 1e-10);
        assert_true(ratio > 1e-3);
    }
}

static void test_least_squares_linear(void **state)
{
    (void)state;
    enum { M = 9, N = 4 };
    double a[M * N], b[M], x[N], r[M];
    size_t rank = 99;
    td_error error = {0};
    td_random random = td_random_seed(3, 1);
    random_matrix(a, M * N, &random);
    random_matrix(b, M, &random);
    check_ok(td_least_squares_linear(x, &rank, a, b, M, N, &error), error);
    assert_int_equal(rank, N);
    /* The residual is orthogonal to the columns. */
    for (int i = 0; i < M; i++) {
        r[i] = -b[i];
        for (int j = 0; j < N; j++) r[i] += a[N * i + j] * x[j];
    }
    for (int j = 0; j < N; j++) {
        double dot = 0;
        for (int i = 0; i < M; i++) dot += a[N * i + j] * r[i];
        check_near(dot, 0, 1e-10);
    }
    for (int i = 0; i < M; i++) a[N * i + 3] = a[N * i + 2];
    check_ok(td_least_squares_linear(x, &rank, a, b, M, N, &error), error);
    assert_int_equal(rank, 3);
    check_near(x[3], x[2], 1e-10); /* shortest solution shares equally */
    check_fails(td_least_squares_linear(x, &rank, a, b, 3, N, &error), TD_ERROR_ARGUMENT, error,
                "3 equations for 4");
}

static void test_invert_and_sandwich(void **state)
{
    (void)state;
    enum { N = 6 };
    double a[N * N], s[N * N], inverse[N * N], product[N * N], j[2 * N], out[4];
    td_error error = {0};
    td_random random = td_random_seed(4, 1);
    random_matrix(a, N * N, &random);
    td_multiply_transposed(s, a, a, N, N, N);
    check_ok(td_invert_spd(inverse, s, N, &error), error);
    td_multiply(product, s, inverse, N, N, N);
    for (int i = 0; i < N * N; i++) check_near(product[i], i % (N + 1) == 0, 1e-8);
    random_matrix(j, 2 * N, &random);
    check_ok(td_sandwich(out, j, s, 2, N, &error), error);
    double expected = 0;
    for (int p = 0; p < N; p++)
        for (int q = 0; q < N; q++) expected += j[p] * s[N * p + q] * j[N + q];
    check_near(out[1], expected, 1e-10);
    check_near(out[2], expected, 1e-10);
    s[0] = -1;
    check_fails(td_invert_spd(inverse, s, N, &error), TD_ERROR_DATA, error, "not positive definite");
}

static void test_nearest_rotation(void **state)
{
    (void)state;
    td_error error = {0};
    double r[9], rr[9], reflection[9] = {1, 0, 0, 0, 1, 0, 0, 0, -1};
    const double scaled[9] = {0, -2, 0, 2, 0, 0, 0, 0, 2}; /* 2 times a quarter turn about z */
    check_ok(td_nearest_rotation(r, scaled, &error), error);
    for (int i = 0; i < 9; i++) check_near(r[i], scaled[i] / 2, 1e-12);
    check_ok(td_nearest_rotation(r, reflection, &error), error);
    td_multiply_transposed(rr, r, r, 3, 3, 3);
    for (int i = 0; i < 9; i++) check_near(rr[i], i % 4 == 0, 1e-12);
    double det = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                 r[2] * (r[3] * r[7] - r[4] * r[6]);
    check_near(det, 1, 1e-12);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_eigen), cmocka_unit_test(test_null_vector),
                                       cmocka_unit_test(test_least_squares_linear),
                                       cmocka_unit_test(test_invert_and_sandwich),
                                       cmocka_unit_test(test_nearest_rotation)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
