/* Proves: views that were held out choose the lens model that made the images: pinhole, Brown's five or eight
 * terms, or a fisheye, whatever model the calibration had; the choice is quick, says why in words, and is the
 * same at any thread count. Reference: simulated truth; 0.1 px noise on 24 views, coefficients large enough
 * that the simpler model's error is several times the noise. held_out_px is compared with the noise itself:
 * sqrt(2) 0.1 px, raised by what fitted parameters add (bounds: 0 and 15 %). Prints the choice for OpenCV's
 * real pairs. Blind to: lenses that are none of the four. */
#include <time.h>

#include "calib/model_choice.h"
#include "core/linalg.h"
#include "tests/calib/simulate.h"

static simulation one_camera(td_camera_model model)
{
    simulation s = simulate_stereo(model, 24);
    s.rig->count = 1;
    return s;
}

/* The choice for views of `s`, calibrated as `present`. */
static td_model_choice choose(const simulation *s, td_camera_model present, int threads)
{
    td_error error = {0};
    td_observations *o = simulate(s, 5, 6, 0.1, 0.1);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    td_model_choice choice;
    struct timespec before, after;
    o->camera[0].model = present;
    options.leave_one_out = false;
    options.threads = threads;
    check_ok(td_calibrate(&c, o, &options, &error), error);
    timespec_get(&before, TIME_UTC);
    check_ok(td_model_choice_make(&choice, 0, c, o, &options, &error), error);
    timespec_get(&after, TIME_UTC);
    printf("%s data as %s, %.2f s:", td_camera_model_name(s->rig->camera[0].camera.model),
           td_camera_model_name(present),
           (double)(after.tv_sec - before.tv_sec) + 1e-9 * (double)(after.tv_nsec - before.tv_nsec));
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        printf(" %s%s %.4f/%.4f ± %.4f", td_camera_model_name(choice.score[i].model),
               choice.score[i].failed ? " (failed)" : "", choice.score[i].rms_px, choice.score[i].held_out_px,
               choice.score[i].sigma_px);
    printf("\n  %s\n", choice.text);
    td_calibration_free(&c);
    td_observations_free(&o);
    return choice;
}

static void check_choice(simulation *s, td_camera_model present, td_camera_model wanted)
{
    td_model_choice choice = choose(s, present, 0);
    assert_int_equal(choice.present, present);
    assert_string_equal(td_camera_model_name(choice.best), td_camera_model_name(wanted));
    const td_model_score *best = &choice.score[wanted];
    assert_false(best->failed);
    check_near(best->sigma_px, 0, 0);
    double noise = 0.1 * sqrt(2);
    assert_true(best->held_out_px > noise && best->held_out_px < 1.15 * noise);
    check_less(best->rms_px, best->held_out_px);
    assert_non_null(strstr(choice.text, td_camera_model_name(wanted)));
    assert_int_equal(strncmp(choice.text, "left: ", 6), 0);
    td_rig_free(&s->rig);
}

static void test_pinhole(void **state)
{
    (void)state;
    simulation s = one_camera(TD_CAMERA_PINHOLE);
    check_choice(&s, TD_CAMERA_BROWN5, TD_CAMERA_PINHOLE);
}

static void test_brown5(void **state)
{
    (void)state;
    simulation s = one_camera(TD_CAMERA_BROWN5);
    check_choice(&s, TD_CAMERA_BROWN5, TD_CAMERA_BROWN5);
    s = one_camera(TD_CAMERA_BROWN5);
    check_choice(&s, TD_CAMERA_BROWN8, TD_CAMERA_BROWN5);
}

/* A lens of 100 degrees: a rational radial function that five terms do not follow to the image's corners. */
static void test_brown8(void **state)
{
    (void)state;
    simulation s = one_camera(TD_CAMERA_BROWN8);
    const double p[TD_CAMERA_MAX_PARAMETERS] = {330,  330.6, 322, 236, 2.0, 0.5,
                                                1e-3, -5e-4, 0.0, 3.0, 1.5, 0.5};
    memcpy(s.rig->camera[0].camera.parameter, p, sizeof p);
    s.near_m = 0.16, s.far_m = 0.4;
    check_choice(&s, TD_CAMERA_BROWN5, TD_CAMERA_BROWN8);
}

static void test_fisheye(void **state)
{
    (void)state;
    simulation s = one_camera(TD_CAMERA_FISHEYE);
    s.rig->camera[0].camera.parameter[0] = s.rig->camera[0].camera.parameter[1] = 260;
    s.near_m = 0.12, s.far_m = 0.35;
    check_choice(&s, TD_CAMERA_FISHEYE, TD_CAMERA_FISHEYE);
    s = one_camera(TD_CAMERA_FISHEYE);
    s.rig->camera[0].camera.parameter[0] = s.rig->camera[0].camera.parameter[1] = 260;
    s.near_m = 0.12, s.far_m = 0.35;
    check_choice(&s, TD_CAMERA_BROWN5, TD_CAMERA_FISHEYE);
}

static void test_threads_and_refusal(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = one_camera(TD_CAMERA_BROWN5);
    td_model_choice one = choose(&s, TD_CAMERA_BROWN5, 1), three = choose(&s, TD_CAMERA_BROWN5, 3);
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        assert_memory_equal(&one.score[i].held_out_px, &three.score[i].held_out_px, sizeof(double));
    s.views = 3;
    td_observations *o = simulate(&s, 5, 6, 0.1, 0.1);
    td_calibration *c = NULL;
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    check_fails(td_model_choice_make(&one, 0, c, o, NULL, &error), TD_ERROR_DATA, error, "there are 3");
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void test_opencv_pairs(void **state)
{
    (void)state;
    td_error error = {0};
    td_dataset *dataset = NULL;
    td_observations *o = NULL;
    td_calibration *c = NULL;
    check_ok(td_dataset_read(&dataset, TD_SOURCE_DIR "/datasets/opencv-stereo", &error), error);
    td_observe_options observe = {0};
    if (td_observe(&o, dataset, &observe, &error) != TD_OK) {
        td_dataset_free(&dataset);
        printf("opencv-doc is not installed\n");
        skip();
    }
    td_calibrate_options options = td_calibrate_options_default();
    check_ok(td_calibrate(&c, o, &options, &error), error);
    for (int k = 0; k < 2; k++) {
        td_model_choice choice;
        check_ok(td_model_choice_make(&choice, k, c, o, &options, &error), error);
        for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
            printf("  %-8s %.4f px fitted, %.4f px held out, ± %.4f\n",
                   td_camera_model_name(choice.score[i].model), choice.score[i].rms_px,
                   choice.score[i].held_out_px, choice.score[i].sigma_px);
        printf("  %s\n", choice.text);
        /* A lens with 28 % of barrel distortion is no pinhole. */
        assert_true(choice.best != TD_CAMERA_PINHOLE);
    }
    td_calibration_free(&c);
    td_observations_free(&o);
    td_dataset_free(&dataset);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_pinhole),
                                       cmocka_unit_test(test_brown5),
                                       cmocka_unit_test(test_brown8),
                                       cmocka_unit_test(test_fisheye),
                                       cmocka_unit_test(test_threads_and_refusal),
                                       cmocka_unit_test(test_opencv_pairs)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
