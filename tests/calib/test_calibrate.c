/* Proves: the joint problem's Jacobians; exact recovery without noise for every camera model; outlying
 * corners, blurred, turned and swapped views are named; a real bulge of the board is found and none is
 * invented; held parts stay and pass their covariance on; the same bytes at any thread count; views that
 * cannot determine the cameras are told in words. Reference: simulated truth. Tolerances: exact recovery to
 * 1e-6 relative (solver tolerance over conditioning); others stated in place. Blind to: detection
 * (test_chessboard, test_marks) and to sigmas (test_calibrate_sigma). */
#include "calib/bundle_internal.h"
#include "calib/calibrate.h"
#include "core/linalg.h"
#include "tests/calib/simulate.h"
#include "tests/jacobians.h"

static void test_jacobians(void **state)
{
    (void)state;
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
        td_error error = {0};
        simulation s = simulate_stereo(m, 4);
        td_observations *o = simulate(&s, 1, 2, 0.3, 0.05);
        td_bundle b;
        td_bundle_problem p;
        td_random random = td_random_seed(1, 5);
        o->height_m[2] = 0.01; /* two views on a rail, which share a pose */
        o->height_m[3] = 0.02;
        check_ok(td_bundle_init(&b, o, &error), error);
        assert_int_equal(b.pose_count, 3);
        b.use_warp = true;
        b.warp[0] = 1e-3;
        b.own_sigma = true;
        for (int k = 0; k < 2; k++) b.rig->camera[k] = s.rig->camera[k];
        for (size_t i = 0; i < b.pose_count; i++) b.rig_from_target[i] = simulated_pose(&s, &random);
        check_ok(td_bundle_problem_new(&p, &b, NULL, &error), error);
        check_problem_jacobians(p.problem, 2e-6);
        td_bundle_problem_free(&p);
        td_bundle_free(&b);
        td_observations_free(&o);
        td_rig_free(&s.rig);
    }
}

static void check_rig(const td_rig *found, const td_rig *truth, double relative)
{
    assert_int_equal(found->count, truth->count);
    for (int k = 0; k < truth->count; k++) {
        const td_camera *a = &found->camera[k].camera, *b = &truth->camera[k].camera;
        for (int i = 0; i < 4; i++) check_near(a->parameter[i], b->parameter[i], relative * b->parameter[0]);
        for (int i = 0; i < 3; i++)
            check_near(found->camera[k].camera_from_rig.t[i], truth->camera[k].camera_from_rig.t[i],
                       relative * 0.1);
    }
}

static void test_exact(void **state)
{
    (void)state;
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int plain = 0; plain < 2; plain++) {
            td_error error = {0};
            simulation s = simulate_stereo(m, 12);
            td_observations *o = simulate(&s, 3, 1, 0, 0);
            td_calibrate_options options = td_calibrate_options_default();
            td_calibration *c = NULL;
            options.plain = plain;
            check_ok(td_calibrate(&c, o, &options, &error), error);
            /* The rational model's coefficients trade against each other; its images agree all the same. */
            check_rig(c->rig, s.rig, m == TD_CAMERA_BROWN8 ? 1e-4 : 1e-6);
            check_less(c->rms_px, 1e-5);
            assert_int_equal(c->leave_one_out.views, 12);
            check_less(fabs(c->leave_one_out.scale_error), 1e-5);
            assert_false(c->has_warp);
            td_calibration_free(&c);
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
}

/* ViSP's start leads to the same minimum. */
static void test_methods(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 8);
    td_observations *o = simulate(&s, 3, 1, 0.1, 0.1);
    td_calibration *a = NULL, *b = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.method = TD_ESTIMATE_HOMOGRAPHY;
    check_ok(td_calibrate(&a, o, &options, &error), error);
    options.method = TD_ESTIMATE_VISP;
    td_status status = td_calibrate(&b, o, &options, &error);
    if (status == TD_ERROR_UNSUPPORTED) fail_msg("%s", error.message);
    check_ok(status, error);
    check_rig(b->rig, a->rig, 1e-6);
    td_calibration_free(&a);
    td_calibration_free(&b);
    options.method = TD_ESTIMATE_FAUGERAS_TOSCANI;
    check_fails(td_calibrate(&b, o, &options, &error), TD_ERROR_DATA, error, "target with depth");
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void test_outliers(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    td_observations *o = simulate(&s, 5, 6, 0.1, 0.02);
    td_calibration *c = NULL;
    td_observations_get(o, 2, 0)->point[20] += 3;
    td_observations_get(o, 7, 1)->point[31] -= 1.2;
    td_random random = td_random_seed(9, 9);
    for (size_t i = 0; i < 2 * td_observations_get(o, 4, 1)->count;
         i++) /* a blurred image: 8 times the noise */
        td_observations_get(o, 4, 1)->point[i] += 0.8 * td_random_normal(&random);
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    size_t points = td_target_point_count(&s.target);
    assert_int_equal(c->used[(2 * 2 + 0) * points + 10], 0);
    assert_int_equal(c->used[(7 * 2 + 1) * points + 15], 0);
    assert_int_equal(c->view[4].state, TD_VIEW_OUTLIER);
    assert_non_null(strstr(c->view[4].remark, "right"));
    for (size_t v = 0; v < 12; v++)
        if (v != 4) assert_int_equal(c->view[v].state, TD_VIEW_USED);
    /* Left alone they would shift the focal length by several sigmas. */
    check_less(fabs(c->rig->camera[0].camera.parameter[0] - 530), 4 * c->camera[0].sigma[0]);
    /* At 5 sigma 2600 good points lose one in a hundred runs. */
    assert_true(c->camera[0].outlier_points <= 2);
    check_near(c->camera[0].rms_px, 0.1 * sqrt(2.0), 0.01);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void turn_half(td_detection *d)
{
    for (size_t i = 0; i < d->count / 2; i++)
        for (int k = 0; k < 2; k++) {
            double *a = &d->point[2 * i + k], *b = &d->point[2 * (d->count - 1 - i) + k], t = *a;
            *a = *b;
            *b = t;
        }
}

static void test_turned_and_swapped(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_observations *o = simulate(&s, 7, 8, 0.1, 0.02);
    td_calibration *c = NULL;
    turn_half(td_observations_get(o, 3, 1));
    td_detection swap = *td_observations_get(o, 6, 0);
    *td_observations_get(o, 6, 0) = *td_observations_get(o, 6, 1);
    *td_observations_get(o, 6, 1) = swap;
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    assert_int_equal(c->view[3].state, TD_VIEW_CORRECTED);
    assert_non_null(strstr(c->view[3].remark, "180 degrees"));
    assert_int_equal(c->view[6].state, TD_VIEW_OUTLIER);
    assert_non_null(strstr(c->view[6].remark, "swapped"));
    check_near(c->rms_px, 0.1 * sqrt(2.0), 0.01);
    assert_int_equal(c->camera[0].views, 9);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* 3.7 sigma of the warp is seen as significant, 0 is not. */
static void test_warp(void **state)
{
    (void)state;
    for (int bent = 0; bent < 2; bent++) {
        td_error error = {0};
        simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
        s.warp_m[0] = bent * 4e-4;
        s.warp_m[1] = bent * -2e-4;
        td_observations *o = simulate(&s, 11, 12, 0.1, 0.1);
        td_calibration *c = NULL;
        check_ok(td_calibrate(&c, o, NULL, &error), error);
        assert_int_equal(c->has_warp, bent);
        for (int i = 0; i < 2 && bent; i++) check_near(c->warp_m[i], s.warp_m[i], 4 * c->sigma_warp_m[i]);
        check_less(fabs(c->pair[0].baseline_m - td_pose_distance(&s.rig->camera[1].camera_from_rig)),
                   4 * c->pair[0].sigma_baseline_m);
        td_calibration_free(&c);
        td_observations_free(&o);
        td_rig_free(&s.rig);
    }
}

static void test_hold(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_observations *o = simulate(&s, 13, 14, 0.1, 0.1);
    td_calibration *first = NULL, *held = NULL;
    check_ok(td_calibrate(&first, o, NULL, &error), error);
    td_calibrate_options options = td_calibrate_options_default();
    options.known = first->rig;
    options.hold[0] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION;
    check_ok(td_calibrate(&held, o, &options, &error), error);
    for (int i = 0; i < 9; i++)
        check_near(held->rig->camera[0].camera.parameter[i], first->rig->camera[0].camera.parameter[i], 0);
    assert_true(held->covariance_known);
    assert_non_null(held->rig->covariance);
    /* The held camera keeps its own uncertainty, and the baseline feels it. */
    check_near(held->camera[0].sigma[0], first->camera[0].sigma[0], 1e-12);
    assert_true(held->pair[0].sigma_baseline_m > 0.3 * first->pair[0].sigma_baseline_m);

    td_calibration_free(&held);
    free(first->rig->covariance);
    first->rig->covariance = NULL;
    check_ok(td_calibrate(&held, o, &options, &error), error);
    assert_false(held->covariance_known);
    assert_null(held->rig->covariance);
    options.known = NULL;
    td_calibration *none = NULL;
    check_fails(td_calibrate(&none, o, &options, &error), TD_ERROR_ARGUMENT, error, "no camera 'left'");
    td_calibration_free(&held);
    td_calibration_free(&first);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void test_threads(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_observations *o = simulate(&s, 15, 16, 0.1, 0.05);
    td_calibration *one = NULL, *three = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.threads = 1;
    check_ok(td_calibrate(&one, o, &options, &error), error);
    options.threads = 3;
    check_ok(td_calibrate(&three, o, &options, &error), error);
    size_t n = td_rig_parameter_count(one->rig);
    for (int k = 0; k < 2; k++) { /* field by field: padding is anything */
        const td_rig_camera *a = &one->rig->camera[k], *b = &three->rig->camera[k];
        assert_memory_equal(a->camera.parameter, b->camera.parameter, sizeof a->camera.parameter);
        assert_memory_equal(&a->camera_from_rig, &b->camera_from_rig, sizeof a->camera_from_rig);
    }
    assert_memory_equal(one->rig->covariance, three->rig->covariance, n * n * sizeof(double));
    assert_memory_equal(&one->leave_one_out, &three->leave_one_out, sizeof one->leave_one_out);
    td_calibration_free(&one);
    td_calibration_free(&three);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void test_weak(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_calibration *c = NULL;
    s.largest_tilt = 0;
    td_observations *o = simulate(&s, 17, 18, 0.1, 0.1);
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    assert_true(c->weak_count >= 1);
    assert_non_null(strstr(c->weak[0].text, "focal length and distance"));
    assert_non_null(strstr(c->weak[0].text, "tilt the board"));
    assert_true(c->weak[0].severity > 1);
    td_calibration_free(&c);
    td_observations_free(&o);

    s.largest_tilt = 0.7;
    s.views = 1;
    o = simulate(&s, 17, 18, 0.1, 0.1);
    check_fails(td_calibrate(&c, o, NULL, &error), TD_ERROR_DATA, error, "1 of 1 images");
    td_observations_free(&o);

    /* The right camera never shares a view with the left. */
    s.views = 8;
    o = simulate(&s, 17, 18, 0.1, 0.1);
    for (size_t v = 0; v < 8; v++) td_observations_get(o, v, v % 2)->found = false;
    check_fails(td_calibrate(&c, o, NULL, &error), TD_ERROR_DATA, error, "shares no view");
    assert_null(c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* Three cameras in a chain: the first and the last never see the board together. */
static void test_three_cameras(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    s.rig->count = 3;
    strcpy(s.rig->camera[2].name, "third");
    s.rig->camera[2].camera = simulated_camera(TD_CAMERA_PINHOLE, 500, -3);
    const double xi[6] = {0.01, 0.02, -0.01, 0.06, 0.002, 0.001};
    s.rig->camera[2].camera_from_rig = td_pose_exp(xi);
    td_observations *o = simulate(&s, 19, 20, 0, 0);
    for (size_t v = 0; v < 12; v++) td_observations_get(o, v, v % 2 ? 0 : 2)->found = false;
    td_calibration *c = NULL;
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    check_rig(c->rig, s.rig, 1e-6);
    assert_int_equal(c->pair_count, 2);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_jacobians),
                                       cmocka_unit_test(test_exact),
                                       cmocka_unit_test(test_methods),
                                       cmocka_unit_test(test_outliers),
                                       cmocka_unit_test(test_turned_and_swapped),
                                       cmocka_unit_test(test_warp),
                                       cmocka_unit_test(test_hold),
                                       cmocka_unit_test(test_threads),
                                       cmocka_unit_test(test_weak),
                                       cmocka_unit_test(test_three_cameras)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
