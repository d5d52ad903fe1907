/* Proves: a homography is found to rounding from exact pairs, at the least-squares optimum (which only
 * Hartley's normalisation reaches) from noisy ones, and refused from points that do not determine it; focal
 * lengths and poses come back from exact homographies. Reference: simulated pinhole cameras. Tolerances:
 * exact cases 1e-8 px and 1e-8 relative, a thousand times rounding through the singular values; the noisy
 * case against the expectation of chi-square. Blind to: distortion, and how well a focal length from a poor
 * set of views serves (test_first_estimate). */
#include "calib/homography.h"
#include "core/random.h"
#include "tests/check.h"

enum { COLUMNS = 9, ROWS = 6, POINTS = COLUMNS * ROWS };

typedef struct scene {
    double k[4]; /* fx fy cx cy */
    td_pose pose;
    double plane[2 * POINTS], image[2 * POINTS];
} scene;

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

/* A board of 0.2 m about the origin of its plane, tilted by `tilt`, whole before a camera. */
static scene make_scene(td_random *random, double tilt)
{
    scene s = {.k = {between(random, 300, 3000), 0, between(random, 300, 340), between(random, 220, 260)}};
    s.k[1] = s.k[0] * between(random, 0.8, 1.25);
    double about = between(random, 0, 6.28), z = s.k[0] / 300 * between(random, 0.3, 0.6);
    const double lean[6] = {tilt * cos(about), tilt * sin(about), 0, 0, 0, 0};
    const double spin[6] = {0, 0, between(random, -3, 3), 0, 0, 0};
    const double away[6] = {0, 0, 0, between(random, -0.05, 0.05), between(random, -0.05, 0.05), z};
    td_pose a = td_pose_exp(away), l = td_pose_exp(lean), t = td_pose_exp(spin);
    a = td_pose_compose(&a, &l);
    s.pose = td_pose_compose(&a, &t);
    for (int i = 0; i < POINTS; i++) {
        double p[3] = {0.025 * (i % COLUMNS - 4), 0.025 * (i / COLUMNS) - 0.0625, 0};
        memcpy(s.plane + 2 * i, p, 2 * sizeof *p);
        td_pose_transform(p, &s.pose, p);
        assert_true(p[2] > 0.05);
        for (int k = 0; k < 2; k++) s.image[2 * i + k] = s.k[k] * p[k] / p[2] + s.k[2 + k];
    }
    return s;
}

/* K [r1 r2 t], or without K. */
static void true_homography(double h[9], const scene *s, bool with_k)
{
    double r[9];
    td_pose_rotation(r, &s->pose);
    for (int i = 0; i < 3; i++) {
        h[3 * i] = r[3 * i];
        h[3 * i + 1] = r[3 * i + 1];
        h[3 * i + 2] = s->pose.t[i];
    }
    for (int i = 0; i < 2 && with_k; i++)
        for (int j = 0; j < 3; j++) h[3 * i + j] = s->k[i] * h[3 * i + j] + s->k[2 + i] * h[6 + j];
}

static void poison(double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = 1e300;
}

/* Root mean square distance of the mapped points, px. */
static double rms_of(const double h[9], const double *plane, const double *image, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        const double *p = plane + 2 * i, *u = image + 2 * i;
        double w = h[6] * p[0] + h[7] * p[1] + h[8];
        double x = (h[0] * p[0] + h[1] * p[1] + h[2]) / w - u[0],
               y = (h[3] * p[0] + h[4] * p[1] + h[5]) / w - u[1];
        sum += x * x + y * y;
    }
    return sqrt(sum / (double)n);
}

static void test_exact(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 1);
    for (int trial = 0; trial < 200; trial++) {
        scene s = make_scene(&random, between(&random, 0, 1.2));
        td_error error = {0};
        double h[9], norm = 0;
        poison(h, 9);
        check_ok(td_homography(h, s.plane, s.image, POINTS, &error), error);
        for (int i = 0; i < 9; i++) norm += h[i] * h[i];
        check_near(norm, 1, 1e-14);
        check_less(rms_of(h, s.plane, s.image, POINTS), 1e-8);
        /* The four outer corners are enough. */
        const int corner[4] = {0, COLUMNS - 1, POINTS - COLUMNS, POINTS - 1};
        double plane[8], image[8];
        for (int i = 0; i < 4; i++)
            for (int k = 0; k < 2; k++) {
                plane[2 * i + k] = s.plane[2 * corner[i] + k];
                image[2 * i + k] = s.image[2 * corner[i] + k];
            }
        poison(h, 9);
        check_ok(td_homography(h, plane, image, 4, &error), error);
        check_less(rms_of(h, s.plane, s.image, POINTS), 1e-8);
    }
}

/* The residuals of a least-squares fit of 8 parameters leave 2n - 8 degrees of freedom: over many trials
 * their sum of squares over the noise's variance has this mean, and a standard deviation of sqrt(2 (2n - 8)
 * trials). The algebraic error with normalisation stays within 1 % of that optimum; without, it misses it by
 * tens of percents. The pixels are moved far off the origin, as in the corner of a large image, which is
 * where normalisation matters. */
static void test_noise(void **state)
{
    (void)state;
    enum { TRIALS = 400 };
    td_random random = td_random_seed(2, 1);
    double sum = 0, dof = 2. * POINTS - 8;
    for (int trial = 0; trial < TRIALS; trial++) {
        scene s = make_scene(&random, 0.7);
        td_error error = {0};
        double h[9];
        for (int i = 0; i < 2 * POINTS; i++) s.image[i] += 3000 + 0.5 * td_random_normal(&random);
        check_ok(td_homography(h, s.plane, s.image, POINTS, &error), error);
        double rms = rms_of(h, s.plane, s.image, POINTS);
        sum += rms * rms * POINTS / 0.25 / dof;
    }
    print_message("mean square of noisy residuals over its expectation: %.4f\n", sum / TRIALS);
    check_near(sum / TRIALS, 1, 0.01 + 3.3 * sqrt(2 / dof / TRIALS));
}

static void test_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 1);
    scene s = make_scene(&random, 0.5);
    td_error error = {0};
    double h[9], bad[2 * POINTS];
    check_fails(td_homography(h, s.plane, s.image, 3, &error), TD_ERROR_DATA, error, "needs 4 points, 3");
    check_fails(td_homography(h, s.plane, s.image, 0, &error), TD_ERROR_DATA, error, "needs 4 points, 0");
    for (int i = 0; i < 2 * POINTS; i++) bad[i] = s.image[i % 2];
    check_fails(td_homography(h, s.plane, bad, POINTS, &error), TD_ERROR_DATA, error, "coincide");
    /* One row of the board; and one row with the noise of a print, 10 nm. */
    check_fails(td_homography(h, s.plane, s.image, COLUMNS, &error), TD_ERROR_DATA, error, "on a line");
    memcpy(bad, s.plane, sizeof bad);
    for (int i = 0; i < COLUMNS; i++) bad[2 * i + 1] += 1e-8 * td_random_normal(&random);
    check_fails(td_homography(h, bad, s.image, COLUMNS, &error), TD_ERROR_DATA, error, "on a line");
    /* Four points of which three are on a line. */
    const int three[4] = {0, 1, 2, COLUMNS};
    double plane[8], image[8];
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 2; k++) {
            plane[2 * i + k] = s.plane[2 * three[i] + k];
            image[2 * i + k] = s.image[2 * three[i] + k];
        }
    check_fails(td_homography(h, plane, image, 4, &error), TD_ERROR_DATA, error, "on a line");
    const double poisons[] = {NAN, INFINITY, -INFINITY, 1e308};
    for (size_t i = 0; i < 4; i++)
        for (int where = 0; where < 2; where++) {
            double *x = (where ? s.image : s.plane) + 17, kept = *x;
            *x = poisons[i];
            td_status status = td_homography(h, s.plane, s.image, POINTS, &error);
            *x = kept;
            assert_int_equal(status, TD_ERROR_DATA);
        }
    assert_int_equal(td_homography(h, s.plane, s.image, 3, NULL), TD_ERROR_DATA);
}

static void test_focal(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 1);
    for (int trial = 0; trial < 100; trial++) {
        enum { VIEWS = 5 };
        double h[9 * VIEWS], k[4] = {0}, focal[2] = {-1, -1};
        for (int v = 0; v < VIEWS; v++) {
            scene s = make_scene(&random, between(&random, 0.3, 0.8));
            if (!v) memcpy(k, s.k, sizeof k);
            memcpy(s.k, k, sizeof k);
            true_homography(h + 9 * v, &s, true);
            double scale = td_random_normal(&random) * 100; /* any factor and sign */
            for (int i = 0; i < 9; i++) h[9 * v + i] *= scale;
        }
        assert_true(td_focal_from_homographies(focal, k + 2, h, VIEWS));
        for (int i = 0; i < 2; i++) check_near(focal[i] / k[i], 1, 1e-8);
        focal[0] = focal[1] = -1;
        assert_true(td_focal_from_homographies(focal, k + 2, h, 2));
        for (int i = 0; i < 2; i++) check_near(focal[i] / k[i], 1, 1e-6);
    }
}

/* A view tilted about an image axis tells one focal length, not two: it serves for both. */
static void test_focal_of_one_axis(void **state)
{
    (void)state;
    for (int axis = 0; axis < 2; axis++) {
        scene s = {.k = {800, 800, 320, 240}};
        double xi[6] = {0, 0, 0, 0.1, -0.05, 1}, h[9], focal[2];
        xi[axis] = 0.6;
        s.pose = td_pose_exp(xi);
        true_homography(h, &s, true);
        assert_true(td_focal_from_homographies(focal, s.k + 2, h, 1));
        for (int i = 0; i < 2; i++) check_near(focal[i] / 800, 1, 1e-8);
    }
}

/* Boards parallel to the image say nothing of the focal length: not when that is exact, and not when only
 * rounding hides it. */
static void test_focal_of_parallel_views(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int trial = 0; trial < 100; trial++) {
        double h[18], focal[2] = {-1, -1}, centre[2] = {320, 240};
        for (int v = 0; v < 2; v++) {
            td_error error = {0};
            scene s = make_scene(&random, 0);
            if (trial % 2)
                true_homography(h + 9 * v, &s, true);
            else
                check_ok(td_homography(h + 9 * v, s.plane, s.image, POINTS, &error), error);
        }
        if (td_focal_from_homographies(focal, centre, h, 1 + (trial / 2) % 2))
            fail_msg("trial %d: focal lengths %g, %g out of nothing", trial, focal[0], focal[1]);
        check_near(focal[0], -1, 0);
    }
    double zero[9] = {0}, focal[2], nan[9];
    for (int i = 0; i < 9; i++) nan[i] = NAN;
    const double centre[2] = {320, 240};
    assert_false(td_focal_from_homographies(focal, centre, zero, 1));
    assert_false(td_focal_from_homographies(focal, centre, nan, 1));
    assert_false(td_focal_from_homographies(focal, centre, zero, 0));
}

static void test_pose(void **state)
{
    (void)state;
    td_random random = td_random_seed(6, 1);
    for (int trial = 0; trial < 200; trial++) {
        scene s = make_scene(&random, between(&random, 0, 1.2));
        td_error error = {0};
        double h[9], r[9], wanted[9], scale = td_random_normal(&random);
        td_pose pose;
        poison((double *)&pose, 7);
        true_homography(h, &s, false);
        for (int i = 0; i < 9; i++) h[i] *= scale;
        check_ok(td_pose_from_homography(&pose, h, &error), error);
        td_pose_rotation(r, &pose);
        td_pose_rotation(wanted, &s.pose);
        for (int i = 0; i < 9; i++) check_near(r[i], wanted[i], 1e-12);
        for (int i = 0; i < 3; i++) check_near(pose.t[i], s.pose.t[i], 1e-12 * s.pose.t[2]);
    }
}

static void test_pose_refused(void **state)
{
    (void)state;
    td_error error = {0};
    td_pose pose;
    double zero[9] = {0}, nan[9] = {1, 0, 0, 0, NAN, 0, 0, 0, 1};
    check_fails(td_pose_from_homography(&pose, zero, &error), TD_ERROR_DATA, error, "without a pose");
    check_fails(td_pose_from_homography(&pose, nan, &error), TD_ERROR_DATA, error, "without a pose");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_exact),
                                       cmocka_unit_test(test_noise),
                                       cmocka_unit_test(test_refused),
                                       cmocka_unit_test(test_focal),
                                       cmocka_unit_test(test_focal_of_one_axis),
                                       cmocka_unit_test(test_focal_of_parallel_views),
                                       cmocka_unit_test(test_pose),
                                       cmocka_unit_test(test_pose_refused)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
