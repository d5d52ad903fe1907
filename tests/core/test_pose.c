/* Proves the algebra of poses: exponential and logarithm, composition, every Jacobian, and how covariance
 * travels.
 *
 * References: the defining power series, summed in long double until it stops changing (the exponential of a
 * 4x4 or 3x3 matrix; the left Jacobian as the sum of ad^n/(n+1)!), which share no formula with the closed
 * forms; central differences of fourth order for what each Jacobian claims to be the derivative of; Monte
 * Carlo for covariances. Rotations and their Jacobians are held to some roundings, 1e-14; those of SE(3) to
 * 1e-12, as their closed forms lose digits just above 0.3 rad and their series leave out 1e-13 just below.
 * Differences have truncation and rounding under 1e-10 at steps of 1e-3. Blind to quaternions that are not of
 * unit length. */
#include "core/pose.h"
#include "core/random.h"
#include "tests/check.h"

#define PI 3.14159265358979323846

static const double ANGLES[] = {0,      1e-150,    1e-16,     1e-12,     1e-10,      1e-8, 1e-6,    1e-5,
                                9.9e-5, 1.01e-4,   1e-3,      0.01,      0.1,        0.29, 0.29999, 0.30001,
                                0.31,   0.5,       1,         1.5707,    1.5708,     2,    3,       3.1,
                                3.14,   PI - 1e-4, PI - 1e-6, PI - 1e-9, PI - 1e-12, PI};
enum { ANGLE_COUNT = sizeof ANGLES / sizeof *ANGLES };

/* ---- Helpers ---- */

static double norm_of(const double *v, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++) sum += v[i] * v[i];
    return sqrt(sum);
}

static void random_direction(double v[3], td_random *random)
{
    for (int i = 0; i < 3; i++) v[i] = td_random_normal(random);
    const double n = norm_of(v, 3);
    for (int i = 0; i < 3; i++) v[i] /= n;
}

/* A twist of this angle, with a translation of about `reach`. */
static void random_twist(double xi[6], td_random *random, double angle, double reach)
{
    random_direction(xi, random);
    for (int i = 0; i < 3; i++) {
        xi[i] *= angle;
        xi[3 + i] = reach * td_random_normal(random);
    }
}

static td_pose random_pose(td_random *random)
{
    double xi[6];
    random_twist(xi, random, PI * td_random_uniform(random), 2);
    return td_pose_exp(xi);
}

static void check_all_near(const double *a, const double *b, int count, double tolerance)
{
    for (int i = 0; i < count; i++) check_near(a[i], b[i], tolerance);
}

/* Quaternions of opposite sign are the same rotation. */
static void check_same_pose(const td_pose *a, const td_pose *b, double tolerance)
{
    double dot = 0;
    for (int i = 0; i < 4; i++) dot += a->q[i] * b->q[i];
    for (int i = 0; i < 4; i++) check_near(a->q[i], (dot < 0 ? -1 : 1) * b->q[i], tolerance);
    check_all_near(a->t, b->t, 3, tolerance);
    check_near(norm_of(a->q, 4), 1, 1e-15);
}

static void multiply(double *c, const double *a, const double *b, int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            c[n * i + j] = 0;
            for (int k = 0; k < n; k++) c[n * i + j] += a[n * i + k] * b[n * k + j];
        }
}

/* sum of first[n] m^n over n, with first[n] = 1/n! (shift 0) or 1/(n+1)! (shift 1). */
static void power_series(double *sum, const double *m, int size, int shift)
{
    long double power[36] = {0}, next[36], total[36] = {0};
    for (int i = 0; i < size; i++) power[(size + 1) * i] = 1;
    for (int n = 0; n < 60; n++) {
        for (int i = 0; i < size * size; i++) total[i] += power[i];
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++) {
                long double s = 0;
                for (int k = 0; k < size; k++) s += power[size * i + k] * m[size * k + j];
                next[size * i + j] = s / (n + 1 + shift);
            }
        memcpy(power, next, sizeof power);
    }
    for (int i = 0; i < size * size; i++) sum[i] = (double)total[i];
}

static void cross_matrix(double *m, int stride, const double v[3])
{
    m[1] = -v[2];
    m[2] = v[1];
    m[stride] = v[2];
    m[stride + 2] = -v[0];
    m[2 * stride] = -v[1];
    m[2 * stride + 1] = v[0];
}

/* ---- Rotations ---- */

static void test_rotation_exp_and_log(void **state)
{
    (void)state;
    td_random random = td_random_seed(21, 1);
    for (int a = 0; a < ANGLE_COUNT; a++)
        for (int i = 0; i < 20; i++) {
            double w[3], back[3], r[9], series[9], m[9] = {0};
            td_pose pose = td_pose_identity();
            random_direction(w, &random);
            for (int k = 0; k < 3; k++) w[k] *= ANGLES[a];
            td_rotation_exp(pose.q, w);
            check_near(norm_of(pose.q, 4), 1, 4e-16);
            td_rotation_log(back, pose.q);
            /* At pi itself both axes are right. */
            double sign = a == ANGLE_COUNT - 1 && back[0] * w[0] < 0 ? -1 : 1;
            for (int k = 0; k < 3; k++) check_near(back[k], sign * w[k], 1e-15 * ANGLES[a]);
            cross_matrix(m, 3, w);
            power_series(series, m, 3, 0);
            td_pose_rotation(r, &pose);
            check_all_near(r, series, 9, 1e-15);
            check_near(td_pose_angle(&pose), ANGLES[a], 1e-15 * ANGLES[a]);
            /* The other quaternion of the same rotation has the same logarithm. */
            for (int k = 0; k < 4; k++) pose.q[k] = -pose.q[k];
            td_rotation_log(back, pose.q);
            sign = a == ANGLE_COUNT - 1 && back[0] * w[0] < 0 ? -1 : 1;
            for (int k = 0; k < 3; k++) check_near(back[k], sign * w[k], 1e-15 * ANGLES[a]);
            check_near(td_pose_angle(&pose), ANGLES[a], 1e-15 * ANGLES[a]);
        }
}

/* A vector longer than pi is a rotation too; its logarithm goes the short way round. */
static void test_long_rotation_vectors(void **state)
{
    (void)state;
    td_random random = td_random_seed(22, 1);
    for (int i = 0; i < 200; i++) {
        double w[3], q[4], back[3], angle = PI + PI * (i + 0.5) / 200;
        random_direction(w, &random);
        const double axis[3] = {w[0], w[1], w[2]};
        for (int k = 0; k < 3; k++) w[k] *= angle;
        td_rotation_exp(q, w);
        td_rotation_log(back, q);
        for (int k = 0; k < 3; k++) check_near(back[k], (angle - 2 * PI) * axis[k], 1e-14);
    }
}

static void check_from_rotation(const td_pose *pose)
{
    double r[9], again[9];
    const double t[3] = {1, -2, 3};
    td_pose_rotation(r, pose);
    td_pose back = td_pose_from_rotation(r, t);
    td_pose_rotation(again, &back);
    check_all_near(again, r, 9, 2e-15);
    check_all_near(back.t, t, 3, 0);
    check_near(norm_of(back.q, 4), 1, 4e-16);
    td_pose expected = *pose;
    memcpy(expected.t, t, sizeof t);
    check_same_pose(&back, &expected, 2e-15);
}

static void test_from_rotation(void **state)
{
    (void)state;
    td_random random = td_random_seed(23, 1);
    for (int i = 0; i < 5000; i++) {
        td_pose pose = random_pose(&random);
        check_from_rotation(&pose);
    }
    /* Half turns, about any axis and about the axes themselves, and nearly so. */
    for (int i = 0; i < 2000; i++) {
        double w[3] = {0};
        td_pose pose = td_pose_identity();
        random_direction(w, &random);
        if (i % 4 < 3)
            for (int k = 0; k < 3; k++) w[k] = (k == i % 3) * (i % 2 ? -1. : 1.) + (i % 4 ? 1e-9 * w[k] : 0);
        const double angle = PI - (i % 5 == 0 ? 1e-8 : 0);
        for (int k = 0; k < 3; k++) w[k] *= angle;
        td_rotation_exp(pose.q, w);
        check_from_rotation(&pose);
    }
    /* A file's six digits make a matrix that is not quite a rotation: still a unit quaternion, as near as
     * that. */
    for (int i = 0; i < 1000; i++) {
        double r[9];
        td_pose pose = random_pose(&random);
        td_pose_rotation(r, &pose);
        for (int k = 0; k < 9; k++) r[k] = floor(r[k] * 1e6 + 0.5) / 1e6;
        td_pose back = td_pose_from_rotation(r, pose.t);
        check_same_pose(&back, &pose, 2e-6);
    }
}

/* ---- Poses ---- */

static void test_group(void **state)
{
    (void)state;
    td_random random = td_random_seed(24, 1);
    const td_pose one = td_pose_identity();
    for (int i = 0; i < 2000; i++) {
        td_pose a = random_pose(&random), b = random_pose(&random), c = random_pose(&random);
        td_pose ab = td_pose_compose(&a, &b), bc = td_pose_compose(&b, &c);
        td_pose left = td_pose_compose(&ab, &c), right = td_pose_compose(&a, &bc);
        check_same_pose(&left, &right, 1e-14);
        td_pose inverse = td_pose_inverse(&a), gone = td_pose_compose(&inverse, &a),
                there = td_pose_compose(&a, &inverse);
        check_same_pose(&gone, &one, 1e-14);
        check_same_pose(&there, &one, 1e-14);
        td_pose same = td_pose_compose(&one, &a);
        check_same_pose(&same, &a, 1e-15);

        /* The matrices do the same as the quaternions. */
        double ma[16], mb[16], mab[16], expected[16], p[4] = {1, -2, 3, 1}, moved[3], rotated[3];
        td_pose_matrix(ma, &a);
        td_pose_matrix(mb, &b);
        td_pose_matrix(mab, &ab);
        multiply(expected, ma, mb, 4);
        check_all_near(mab, expected, 16, 2e-14);
        td_pose_transform(moved, &a, p);
        td_pose_rotate(rotated, &a, p);
        for (int k = 0; k < 3; k++) {
            double r = ma[4 * k] * p[0] + ma[4 * k + 1] * p[1] + ma[4 * k + 2] * p[2];
            check_near(rotated[k], r, 1e-14);
            check_near(moved[k], r + ma[4 * k + 3], 1e-14);
        }
        check_near(td_pose_distance(&a), norm_of(a.t, 3), 1e-15);
        /* The output may be the input. */
        td_pose_transform(p, &a, p);
        check_all_near(p, moved, 3, 0);
        td_pose_rotate(rotated, &inverse, rotated);
        check_near(rotated[2], 3, 1e-14);
    }
}

/* A long chain stays a rotation. */
static void test_chain_stays_normalised(void **state)
{
    (void)state;
    td_random random = td_random_seed(25, 1);
    td_pose chain = td_pose_identity();
    for (int i = 0; i < 100000; i++) {
        td_pose step = random_pose(&random);
        chain = td_pose_compose(&step, &chain);
    }
    check_near(norm_of(chain.q, 4), 1, 4e-16);
}

static void test_exp_and_log(void **state)
{
    (void)state;
    td_random random = td_random_seed(26, 1);
    for (int a = 0; a < ANGLE_COUNT - 1; a++)
        for (int i = 0; i < 20; i++) {
            double xi[6], back[6], m[16] = {0}, series[16], matrix[16];
            random_twist(xi, &random, ANGLES[a], 3);
            td_pose pose = td_pose_exp(xi);
            td_pose_log(back, &pose);
            check_all_near(back, xi, 3, 1e-15 * ANGLES[a]);
            check_all_near(back + 3, xi + 3, 3, 2e-13);
            cross_matrix(m, 4, xi);
            for (int k = 0; k < 3; k++) m[4 * k + 3] = xi[3 + k];
            power_series(series, m, 4, 0);
            td_pose_matrix(matrix, &pose);
            check_all_near(matrix, series, 16, 2e-13);
        }
}

/* ---- Jacobians ---- */

/* The left Jacobian as the series that defines it; `size` 3 or 6. */
static void left_jacobian_series(double *j, const double xi[6], int size)
{
    double ad[36] = {0};
    cross_matrix(ad, size, xi);
    if (size == 6) {
        cross_matrix(ad + 21, 6, xi);
        cross_matrix(ad + 18, 6, xi + 3);
    }
    power_series(j, ad, size, 1);
}

static void check_is_identity(const double *a, const double *b, int n, double tolerance)
{
    double product[36];
    multiply(product, a, b, n);
    for (int i = 0; i < n * n; i++) check_near(product[i], i % (n + 1) == 0, tolerance);
}

static void test_left_jacobians_are_their_series(void **state)
{
    (void)state;
    td_random random = td_random_seed(27, 1);
    for (int a = 0; a < ANGLE_COUNT; a++)
        for (int i = 0; i < 10; i++) {
            double xi[6], j[36], inverse[36], series[36];
            random_twist(xi, &random, ANGLES[a], 1);
            td_rotation_left_jacobian(j, xi);
            td_rotation_left_jacobian_inverse(inverse, xi);
            left_jacobian_series(series, xi, 3);
            check_all_near(j, series, 9, 1e-14);
            check_is_identity(inverse, series, 3, 1e-14);
            td_pose_left_jacobian(j, xi);
            td_pose_left_jacobian_inverse(inverse, xi);
            left_jacobian_series(series, xi, 6);
            check_all_near(j, series, 36, 1e-12);
            check_is_identity(inverse, series, 6, 2e-12);
        }
}

/* f'(0) from f(-2h), f(-h), f(h), f(2h). */
static double difference(const double f[4], double h)
{
    return (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
}

static const double STENCIL[4] = {-2, -1, 1, 2};

/* Exp(xi + d) = Exp(J d) Exp(xi): the columns of J are the derivatives of log(Exp(xi + d) Exp(xi)^-1). */
static void test_left_jacobians_are_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(28, 1);
    const double h = 1e-3;
    int different = 0;
    for (int a = 0; a < ANGLE_COUNT; a++) {
        double xi[6], j[36], jr[9], log_of[4][6];
        random_twist(xi, &random, ANGLES[a], 1);
        td_pose pose = td_pose_exp(xi), inverse = td_pose_inverse(&pose);
        td_pose_left_jacobian(j, xi);
        td_rotation_left_jacobian(jr, xi);
        for (int column = 0; column < 6; column++) {
            for (int s = 0; s < 4; s++) {
                double moved[6];
                memcpy(moved, xi, sizeof moved);
                moved[column] += STENCIL[s] * h;
                td_pose there = td_pose_exp(moved), step = td_pose_compose(&there, &inverse);
                td_pose_log(log_of[s], &step);
            }
            double size = 0;
            for (int row = 0; row < 6; row++) {
                double f[4] = {log_of[0][row], log_of[1][row], log_of[2][row], log_of[3][row]},
                       d = difference(f, h);
                check_near(j[6 * row + column], d, 1e-9);
                if (row < 3 && column < 3) check_near(jr[3 * row + column], d, 1e-9);
                size += fabs(d);
                different += j[6 * row + column] != d;
            }
            assert_true(size > 0.1);
        }
    }
    assert_true(different > 100);
}

static void test_adjoint(void **state)
{
    (void)state;
    td_random random = td_random_seed(29, 1);
    const double h = 1e-3;
    for (int i = 0; i < 300; i++) {
        td_pose pose = random_pose(&random), inverse = td_pose_inverse(&pose);
        double ad[36], xi[6], moved[6] = {0};
        td_pose_adjoint(ad, &pose);
        /* The identity that defines it, at any size of xi. */
        random_twist(xi, &random, 3 * td_random_uniform(&random), 1);
        for (int row = 0; row < 6; row++)
            for (int k = 0; k < 6; k++) moved[row] += ad[6 * row + k] * xi[k];
        td_pose step_b = td_pose_exp(xi), step_a = td_pose_exp(moved);
        td_pose right = td_pose_compose(&pose, &step_b), left = td_pose_compose(&step_a, &pose);
        check_same_pose(&left, &right, 5e-13);
        /* And as a derivative: of log(T Exp(d) T^-1). */
        for (int column = 0; column < 6; column++) {
            double log_of[4][6];
            for (int s = 0; s < 4; s++) {
                double d[6] = {0};
                d[column] = STENCIL[s] * h;
                td_pose small = td_pose_exp(d), outer = td_pose_compose(&pose, &small);
                outer = td_pose_compose(&outer, &inverse);
                td_pose_log(log_of[s], &outer);
            }
            for (int row = 0; row < 6; row++) {
                double f[4] = {log_of[0][row], log_of[1][row], log_of[2][row], log_of[3][row]};
                check_near(ad[6 * row + column], difference(f, h), 1e-9);
            }
        }
    }
}

static void test_transform_jacobian(void **state)
{
    (void)state;
    td_random random = td_random_seed(30, 1);
    const double h = 1e-3;
    int different = 0;
    for (int i = 0; i < 300; i++) {
        td_pose pose = random_pose(&random);
        double p[3], p_a[3], j[18], moved[4][3];
        for (int k = 0; k < 3; k++) p[k] = 5 * td_random_normal(&random);
        td_pose_transform(p_a, &pose, p);
        td_pose_transform_jacobian(j, p_a);
        for (int column = 0; column < 6; column++) {
            for (int s = 0; s < 4; s++) {
                double xi[6] = {0};
                xi[column] = STENCIL[s] * h;
                td_pose perturbed = td_pose_perturb(&pose, xi), step = td_pose_exp(xi),
                        composed = td_pose_compose(&step, &pose);
                check_same_pose(&perturbed, &composed, 1e-15);
                td_pose_transform(moved[s], &perturbed, p);
            }
            double size = 0;
            for (int row = 0; row < 3; row++) {
                double f[4] = {moved[0][row], moved[1][row], moved[2][row], moved[3][row]},
                       d = difference(f, h);
                check_near(j[6 * row + column], d, 1e-9);
                size += fabs(d);
                different += j[6 * row + column] != d;
            }
            assert_true(size > 0);
        }
    }
    assert_true(different > 1000);
}

/* ---- Covariance ---- */

enum { TRIALS = 20000 };
#define SIGMA 1e-4 /* so small that what is left out, the second order, is 1e-4 of what is tested */

/* A correlated covariance and its Cholesky factor. */
static void random_covariance(double s[36], double factor[36], td_random *random)
{
    memset(factor, 0, 36 * sizeof *factor);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k <= i; k++)
            factor[6 * i + k] =
                SIGMA * (i == k ? 0.5 + td_random_uniform(random) : td_random_normal(random) / 2);
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            s[6 * i + j] = 0;
            for (int k = 0; k < 6; k++) s[6 * i + j] += factor[6 * i + k] * factor[6 * j + k];
        }
}

static void cholesky(double factor[36], const double s[36])
{
    memset(factor, 0, 36 * sizeof *factor);
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = s[6 * i + j];
            for (int k = 0; k < j; k++) sum -= factor[6 * i + k] * factor[6 * j + k];
            assert_true(i != j || sum > 0);
            factor[6 * i + j] = i == j ? sqrt(sum) : sum / factor[6 * j + j];
        }
}

static td_pose draw_near(const td_pose *pose, const double factor[36], td_random *random)
{
    double z[6], xi[6] = {0};
    for (int i = 0; i < 6; i++) z[i] = td_random_normal(random);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k <= i; k++) xi[i] += factor[6 * i + k] * z[k];
    return td_pose_perturb(pose, xi);
}

/* Adds the outer product of the whitened perturbation that leads from `mean` to `drawn`. */
static void gather(double sum[36], const td_pose *drawn, const td_pose *mean, const double factor[36])
{
    double xi[6];
    td_pose back = td_pose_inverse(mean), step = td_pose_compose(drawn, &back);
    td_pose_log(xi, &step);
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k < i; k++) xi[i] -= factor[6 * i + k] * xi[k];
        xi[i] /= factor[6 * i + i];
    }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) sum[6 * i + j] += xi[i] * xi[j] / TRIALS;
}

/* Whitened by the predicted covariance, the sample covariance is the identity; its 21 different elements have
 * standard errors sqrt(2/n) on the diagonal and sqrt(1/n) beside it. 4.07 of them hold all 21 at once at 99.9
 * %. */
static double check_white(const double sample[36])
{
    double mean = 0;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            check_near(sample[6 * i + j], i == j, 4.07 * sqrt((i == j ? 2. : 1.) / TRIALS));
            if (i == j) mean += sample[6 * i + j] / 6;
        }
    return sqrt(mean);
}

static void test_covariance_against_monte_carlo(void **state)
{
    (void)state;
    td_random random = td_random_seed(31, 1);
    for (int trial = 0; trial < 3; trial++) {
        td_pose ab = random_pose(&random), bc = random_pose(&random);
        td_pose ac = td_pose_compose(&ab, &bc), ba = td_pose_inverse(&ab);
        double s_ab[36], f_ab[36], s_bc[36], f_bc[36], s_ac[36], f_ac[36], s_ba[36], f_ba[36];
        double composed[36] = {0}, inverted[36] = {0};
        random_covariance(s_ab, f_ab, &random);
        random_covariance(s_bc, f_bc, &random);
        td_pose_compose_covariance(s_ac, &ab, s_ab, s_bc);
        td_pose_inverse_covariance(s_ba, &ab, s_ab);
        cholesky(f_ac, s_ac);
        cholesky(f_ba, s_ba);
        for (int i = 0; i < 36; i++) {
            check_near(s_ac[i], s_ac[6 * (i % 6) + i / 6], 1e-15 * SIGMA);
            check_near(s_ba[i], s_ba[6 * (i % 6) + i / 6], 1e-15 * SIGMA);
        }
        for (int n = 0; n < TRIALS; n++) {
            td_pose drawn_ab = draw_near(&ab, f_ab, &random), drawn_bc = draw_near(&bc, f_bc, &random);
            td_pose drawn_ac = td_pose_compose(&drawn_ab, &drawn_bc), drawn_ba = td_pose_inverse(&drawn_ab);
            gather(composed, &drawn_ac, &ac, f_ac);
            gather(inverted, &drawn_ba, &ba, f_ba);
        }
        print_message("sigma, sampled over predicted: composed %.4f, inverted %.4f\n", check_white(composed),
                      check_white(inverted));
        /* The output may be the input. */
        double aliased[36];
        memcpy(aliased, s_ab, sizeof aliased);
        td_pose_inverse_covariance(aliased, &ab, aliased);
        assert_memory_equal(aliased, s_ba, sizeof aliased);
        memcpy(aliased, s_bc, sizeof aliased);
        td_pose_compose_covariance(aliased, &ab, s_ab, aliased);
        assert_memory_equal(aliased, s_ac, sizeof aliased);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rotation_exp_and_log),
        cmocka_unit_test(test_long_rotation_vectors),
        cmocka_unit_test(test_from_rotation),
        cmocka_unit_test(test_group),
        cmocka_unit_test(test_chain_stays_normalised),
        cmocka_unit_test(test_exp_and_log),
        cmocka_unit_test(test_left_jacobians_are_their_series),
        cmocka_unit_test(test_left_jacobians_are_derivatives),
        cmocka_unit_test(test_adjoint),
        cmocka_unit_test(test_transform_jacobian),
        cmocka_unit_test(test_covariance_against_monte_carlo),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
