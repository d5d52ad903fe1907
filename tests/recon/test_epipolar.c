/* Proves where a left point's image can be in the right image as taken, and how far a pixel is from there.
 * References: points of space projected by the cameras themselves; the distance by a search along the curve;
 * every derivative by central differences, the rig's parameters moved one by one; sigma by 4000 rigs drawn
 * from the covariance. Tolerances: rounding for projections; 1e-5 for differences, whose own error
 * is of that size; 99.9 % of the chi-squared distribution for the draws. Blind to: whether the rig is right.
 */
#include "core/linalg.h"
#include "core/random.h"
#include "recon/epipolar.h"
#include "tests/check.h"

static const td_camera brown5 = {
    TD_CAMERA_BROWN5, 640, 480, {536.1, 536.9, 342.3, 235.5, -0.265, -0.047, 0.0018, -0.0003, 0.252}};
static const td_camera brown8 = {
    TD_CAMERA_BROWN8, 640, 480, {530, 531, 322.3, 241.5, 0.1, -0.07, 0.001, -0.0013, 0.02, 0.3, -0.05, 0.01}};
static const td_camera fisheye = {
    TD_CAMERA_FISHEYE, 640, 480, {300, 301, 325, 238, 0.02, -0.01, 0.003, -0.001}};
static const td_camera pinhole = {TD_CAMERA_PINHOLE, 640, 480, {500, 501, 320, 240}};

static td_rig *make_rig(const td_camera *left, const td_camera *right)
{
    td_rig *rig = td_rig_new();
    const double first[6] = {0}, second[6] = {0.03, -0.05, 0.02, 0.05, 0.01, -0.02};
    const double third[6] = {-0.02, 0.11, -0.015, -0.40, 0.02, 0.03};
    const double *xi[3] = {first, second, third};
    const td_camera *camera[3] = {&pinhole, left, right};
    rig->count = 3;
    for (int i = 0; i < 3; i++) {
        snprintf(rig->camera[i].name, TD_NAME_SIZE, "camera%d", i);
        rig->camera[i].camera = *camera[i];
        rig->camera[i].camera_from_rig = td_pose_exp(xi[i]);
    }
    return rig;
}

/* The rig with parameter `index` (of the covariance's order) moved by `step`. */
static void move_parameter(td_rig *rig, size_t index, double step)
{
    for (int c = rig->count - 1; c >= 0; c--) {
        const size_t offset = td_rig_parameter_offset(rig, c);
        if (index < offset) continue;
        td_rig_camera *camera = &rig->camera[c];
        const size_t count = (size_t)td_camera_parameter_count(camera->camera.model);
        double xi[6] = {0};
        if (index - offset < count) {
            camera->camera.parameter[index - offset] += step;
            return;
        }
        xi[index - offset - count] = step;
        camera->camera_from_rig = td_pose_perturb(&camera->camera_from_rig, xi);
        return;
    }
}

static const td_camera *const lefts[] = {&pinhole, &brown5, &brown8, &fisheye, &brown5};
static const td_camera *const rights[] = {&pinhole, &brown8, &brown5, &brown5, &fisheye};
enum { PAIRS = 5, POINTS = 40 };

static void draw_point(double p[3], td_random *random)
{
    p[2] = 0.8 + 6 * td_random_uniform(random);
    p[0] = (0.7 * td_random_uniform(random) - 0.3) * p[2] + 0.15;
    p[1] = (0.5 * td_random_uniform(random) - 0.25) * p[2];
}

static void undistorted(double out[3], const td_camera *camera, const double pixel[2])
{
    double ray[3];
    assert_true(td_camera_unproject(ray, NULL, NULL, camera, pixel));
    out[0] = camera->parameter[0] * ray[0] / ray[2] + camera->parameter[2];
    out[1] = camera->parameter[1] * ray[1] / ray[2] + camera->parameter[3];
    out[2] = 1;
}

static void test_projections(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 0);
    td_error error;
    for (int c = 0; c < PAIRS; c++) {
        td_rig *rig = make_rig(lefts[c], rights[c]);
        td_pair pair;
        double f[9], norm = 0;
        check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
        td_pair_fundamental(f, &pair);
        for (int i = 0; i < 9; i++) norm += f[i] * f[i];
        check_near(norm, 1, 1e-14);
        for (int n = 0; n < POINTS; n++) {
            double p[3], q[3], left[2], right[2], got[2], l[3], r[3], e = 0, distance;
            draw_point(p, &random);
            td_pose_transform(q, &pair.right_from_left, p);
            assert_true(td_camera_project(left, NULL, NULL, lefts[c], p));
            assert_true(td_camera_project(right, NULL, NULL, rights[c], q));
            assert_true(td_pair_transfer(got, NULL, NULL, &pair, left, p[2]));
            check_near(got[0], right[0], 1e-7);
            check_near(got[1], right[1], 1e-7);
            assert_true(td_pair_residual(&distance, NULL, NULL, &pair, left, right));
            check_near(distance, 0, 1e-7);
            undistorted(l, lefts[c], left);
            undistorted(r, rights[c], right);
            for (int i = 0; i < 9; i++) e += r[i / 3] * f[i] * l[i % 3];
            check_near(e, 0, 1e-9);
        }
        td_rig_free(&rig);
    }
}

static void test_transfer_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(2, 0);
    td_error error;
    for (int c = 0; c < PAIRS; c++) {
        td_rig *rig = make_rig(lefts[c], rights[c]);
        td_pair pair;
        check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
        for (int n = 0; n < POINTS; n++) {
            const double left[2] = {60 + 520 * td_random_uniform(&random),
                                    60 + 360 * td_random_uniform(&random)};
            const double w = n == 0 ? 0 : 0.1 + td_random_uniform(&random), step = 1e-4;
            double right[2], d_w[2], d_left[4], plus[2], minus[2];
            if (!td_pair_transfer(right, d_w, d_left, &pair, left, w > 0 ? 1 / w : INFINITY)) continue;
            if (w > 0) {
                assert_true(td_pair_transfer(plus, NULL, NULL, &pair, left, 1 / (w + 1e-5)));
                assert_true(td_pair_transfer(minus, NULL, NULL, &pair, left, 1 / (w - 1e-5)));
                for (int i = 0; i < 2; i++) check_near(d_w[i], (plus[i] - minus[i]) / 2e-5, 1e-3);
            }
            for (int k = 0; k < 2; k++) {
                double a[2] = {left[0], left[1]}, b[2] = {left[0], left[1]};
                a[k] += step;
                b[k] -= step;
                assert_true(td_pair_transfer(plus, NULL, NULL, &pair, a, w > 0 ? 1 / w : INFINITY));
                assert_true(td_pair_transfer(minus, NULL, NULL, &pair, b, w > 0 ? 1 / w : INFINITY));
                for (int i = 0; i < 2; i++)
                    check_near(d_left[2 * i + k], (plus[i] - minus[i]) / (2 * step), 1e-5);
            }
        }
        td_rig_free(&rig);
    }
}

/* Nearest point of the curve by a search over inverse depth, refined by golden section. */
static double searched_distance(const td_pair *pair, const double left[2], const double right[2], double *at)
{
    double best = INFINITY, best_w = 0, q[2];
    for (int i = -300; i <= 3000; i++) {
        const double w = i * 1e-3;
        if (!td_pair_transfer(q, NULL, NULL, pair, left, w > 0 ? 1 / w : INFINITY)) continue;
        const double d = hypot(q[0] - right[0], q[1] - right[1]);
        if (d < best) best = d, best_w = w;
    }
    double low = best_w - 1e-3, high = best_w + 1e-3;
    for (int i = 0; i < 60; i++) {
        double w[2] = {low + 0.382 * (high - low), low + 0.618 * (high - low)}, d[2];
        for (int k = 0; k < 2; k++) {
            assert_true(td_pair_transfer(q, NULL, NULL, pair, left, 1 / w[k]));
            d[k] = hypot(q[0] - right[0], q[1] - right[1]);
        }
        if (d[0] < d[1])
            high = w[1], best = d[0];
        else
            low = w[0], best = d[1];
    }
    *at = (low + high) / 2;
    return best;
}

static void test_distance(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 0);
    td_error error;
    for (int c = 0; c < PAIRS; c++) {
        td_rig *rig = make_rig(lefts[c], rights[c]);
        td_pair pair;
        check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
        for (int n = 0; n < POINTS; n++) {
            double p[3], left[2], right[2], far_[2], distance, along[2], w, on[2];
            draw_point(p, &random);
            assert_true(td_camera_project(left, NULL, NULL, lefts[c], p));
            assert_true(td_pair_transfer(right, NULL, NULL, &pair, left, p[2]));
            const double offset[2] = {16 * td_random_uniform(&random) - 8,
                                      16 * td_random_uniform(&random) - 8};
            right[0] += offset[0];
            right[1] += offset[1];
            assert_true(td_pair_residual(&distance, along, NULL, &pair, left, right));
            check_near(fabs(distance), searched_distance(&pair, left, right, &w), 1e-6);
            assert_true(td_pair_transfer(on, NULL, NULL, &pair, left, 1 / w));
            assert_true(td_pair_transfer(far_, NULL, NULL, &pair, left, 1 / (w - 1e-6)));
            assert_true((far_[0] - on[0]) * along[0] + (far_[1] - on[1]) * along[1] > 0);
            check_near(distance, (right[1] - on[1]) * along[0] - (right[0] - on[0]) * along[1], 1e-4);
            check_near(hypot(along[0], along[1]), 1, 1e-12);
        }
        td_rig_free(&rig);
    }
}

static void test_rectified_sign(void **state)
{
    (void)state;
    td_rig *rig = make_rig(&pinhole, &pinhole);
    td_pair pair;
    td_error error;
    rig->count = 2;
    rig->camera[1].camera_from_rig = (td_pose){{1, 0, 0, 0}, {-0.2, 0, 0}};
    check_ok(td_pair_init(&pair, rig, 0, 1, &error), error);
    const double left[2] = {300, 200}, right[2] = {280, 203};
    double distance, along[2];
    assert_true(td_pair_residual(&distance, along, NULL, &pair, left, right));
    check_near(distance, 3, 1e-9);
    check_near(along[0], 1, 1e-12);
    check_near(pair.baseline_m, 0.2, 1e-15);
    assert_true(isnan(td_pair_residual_sigma(&pair, left, right)));
    td_rig_free(&rig);
}

static void test_residual_derivatives(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 0);
    td_error error;
    for (int c = 0; c < PAIRS; c++) {
        td_rig *rig = make_rig(lefts[c], rights[c]);
        const size_t count = td_rig_parameter_count(rig);
        td_pair pair, moved;
        bool identical = true;
        check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
        for (int n = 0; n < 8; n++) {
            double p[3], left[2], right[2], distance, row[100], value[2];
            draw_point(p, &random);
            assert_true(td_camera_project(left, NULL, NULL, lefts[c], p));
            assert_true(td_pair_transfer(right, NULL, NULL, &pair, left, p[2]));
            right[1] += n % 2 ? 3 : -1.5;
            assert_true(td_pair_residual(&distance, NULL, row, &pair, left, right));
            for (size_t k = 0; k < count; k++) {
                const double step = 1e-5;
                for (int side = 0; side < 2; side++) {
                    td_rig *copy = td_rig_copy(rig);
                    move_parameter(copy, k, side ? step : -step);
                    check_ok(td_pair_init(&moved, copy, 1, 2, &error), error);
                    assert_true(td_pair_residual(&value[side], NULL, NULL, &moved, left, right));
                    td_rig_free(&copy);
                }
                const double difference = (value[1] - value[0]) / (2 * step);
                check_near(row[k], difference, 1e-5 * fabs(row[k]) + 1e-4);
                identical = identical && row[k] == difference;
                if (k < 10) check_near(row[k], 0, 0); /* the first camera is none of the pair */
            }
        }
        assert_false(identical);
        td_rig_free(&rig);
    }
}

/* A covariance of correlated parameters; the residual of 4000 drawn rigs has the variance that is foretold.
 */
static void test_sigma(void **state)
{
    (void)state;
    enum { DRAWS = 4000 };
    td_rig *rig = make_rig(&brown5, &brown8);
    const size_t count = td_rig_parameter_count(rig);
    td_random random = td_random_seed(5, 0);
    td_pair pair;
    td_error error;
    double *root = calloc(count * count, sizeof *root), sum = 0, squares = 0, p[3] = {0.2, -0.1, 3};
    rig->covariance = calloc(count * count, sizeof *root);
    for (size_t i = 10; i < count; i++)
        for (size_t k = 10; k <= i; k++) {
            const int camera = i < td_rig_parameter_offset(rig, 2) ? 1 : 2;
            const size_t within = i - td_rig_parameter_offset(rig, camera);
            const size_t intrinsics = (size_t)td_camera_parameter_count(rig->camera[camera].camera.model);
            const double size = within < 4 ? 0.3 : within < intrinsics ? 1e-4 : 3e-4;
            root[i * count + k] = size * (i == k ? 1 : 0.3 * (td_random_uniform(&random) - 0.5));
        }
    td_multiply_transposed(rig->covariance, root, root, count, count, count);
    check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
    double left[2], right[2];
    assert_true(td_camera_project(left, NULL, NULL, &brown5, p));
    assert_true(td_pair_transfer(right, NULL, NULL, &pair, left, p[2]));
    const double sigma = td_pair_residual_sigma(&pair, left, right);
    for (int n = 0; n < DRAWS; n++) {
        td_rig *copy = td_rig_copy(rig);
        td_pair drawn;
        double normal[100], distance;
        for (size_t i = 0; i < count; i++) normal[i] = td_random_normal(&random);
        for (size_t i = 10; i < count; i++) {
            double step = 0;
            for (size_t k = 0; k <= i; k++) step += root[i * count + k] * normal[k];
            move_parameter(copy, i, step);
        }
        check_ok(td_pair_init(&drawn, copy, 1, 2, &error), error);
        assert_true(td_pair_residual(&distance, NULL, NULL, &drawn, left, right));
        sum += distance;
        squares += distance * distance;
        td_rig_free(&copy);
    }
    const double ratio = squares / DRAWS / (sigma * sigma);
    print_message("epipolar sigma %.3f px, empirical over predicted %.3f\n", sigma, sqrt(ratio));
    /* chi-squared with 4000 degrees of freedom, two-sided 99.9 %: 1 -+ 3.29 sqrt(2 / 4000). */
    check_near(ratio, 1, 3.29 * sqrt(2.0 / DRAWS));
    free(root);
    td_rig_free(&rig);
}

static void test_undefined(void **state)
{
    (void)state;
    td_rig *rig = make_rig(&brown5, &brown5);
    td_pair pair;
    td_error error;
    double right[2], distance;
    const double inside[2] = {300, 200}, none[2] = {NAN, 0};
    check_fails(td_pair_init(&pair, rig, 1, 3, &error), TD_ERROR_ARGUMENT, error, "camera 3");
    check_fails(td_pair_init(&pair, rig, -1, 2, &error), TD_ERROR_ARGUMENT, error, "camera -1");
    check_fails(td_pair_init(&pair, rig, 2, 2, &error), TD_ERROR_ARGUMENT, error, "camera2");
    rig->camera[2].camera_from_rig = rig->camera[1].camera_from_rig;
    check_fails(td_pair_init(&pair, rig, 1, 2, &error), TD_ERROR_ARGUMENT, error, "baseline");
    td_rig_free(&rig);
    rig = make_rig(&brown5, &brown5);
    check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
    assert_false(td_pair_transfer(right, NULL, NULL, &pair, inside, -1));
    assert_false(td_pair_transfer(right, NULL, NULL, &pair, inside, NAN));
    assert_false(td_pair_transfer(right, NULL, NULL, &pair, none, 1));
    assert_false(td_pair_residual(&distance, NULL, NULL, &pair, none, inside));
    assert_false(td_pair_residual(&distance, NULL, NULL, &pair, inside, none));
    td_rig_free(&rig);
    /* Barrel distortion folds at 0.96 of the focal length from the centre: a near point on the far side of
     * the wide left image would be imaged back into the right one. */
    const td_camera wide = {TD_CAMERA_PINHOLE, 640, 480, {100, 100, 320, 240}};
    const td_camera folding = {TD_CAMERA_BROWN5, 640, 480, {400, 400, 320, 240, -0.36}};
    const double border[2] = {600, 240};
    double ghost[2];
    rig = make_rig(&wide, &folding);
    check_ok(td_pair_init(&pair, rig, 1, 2, &error), error);
    assert_false(td_pair_transfer(ghost, NULL, NULL, &pair, border, INFINITY));
    assert_true(td_pair_transfer(ghost, NULL, NULL, &pair, inside, INFINITY));
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_projections),
        cmocka_unit_test(test_transfer_derivatives),
        cmocka_unit_test(test_distance),
        cmocka_unit_test(test_rectified_sign),
        cmocka_unit_test(test_residual_derivatives),
        cmocka_unit_test(test_sigma),
        cmocka_unit_test(test_undefined),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
