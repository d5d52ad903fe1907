/* Proves: a rig drawn from its own covariance is found drifted no more often than the p value says, all
 * together, by camera and by pair, and the predicted residuals, epipolar distances and scales are those that
 * come; a rig of which one thing was changed by ten of its sigmas is always found, named, and measured;
 * outliers and a wrong board do no harm; a bent board is no drift.
 *
 * Reference: simulated truth; the covariance is that of one calibration of 14 views. Bounds: Kolmogorov and
 * Smirnov at one in a thousand, binomial likewise; predicted figures within 5 % over 200 rigs (root mean
 * square of n values known to 1 / sqrt(2 n) = 5 %, and to less for figures that average over points). Blind
 * to: errors that neither the rig's nor a point's noise are (blur, unequal boards). */
#include "calib/drift.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "tests/calib/rig_draw.h"

enum { DRAWS = 200, FULL_DRAWS = 2000 };

static td_rig *calibrated(simulation *s, uint64_t seed)
{
    td_error error = {0};
    size_t views = s->views;
    s->views = 14;
    td_observations *o = simulate(s, seed, seed + 1, 0.1, 0);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    check_ok(td_calibrate(&c, o, &options, &error), error);
    td_rig *rig = td_rig_copy(c->rig);
    td_calibration_free(&c);
    td_observations_free(&o);
    s->views = views;
    return rig;
}

typedef struct draws {
    const simulation *s;
    const td_rig *calibrated;
    double noise_px; /* given to the check; 0: estimated */
    td_drift *drift; /* (count) */
} draws;

static void run_draw(size_t index, void *user)
{
    draws *d = user;
    td_error error = {0};
    td_random random = td_random_seed(77, 1000 + index);
    td_rig *rig = rig_draw(d->s->rig, d->calibrated->covariance, 1, 0, &random);
    td_observations *o = simulate(d->s, 300 + index, 9000 + index, 0.1, d->noise_px > 0 ? 0.1 : 0);
    td_drift_options options = td_drift_options_default();
    options.noise_px = d->noise_px;
    if (td_drift_measure(&d->drift[index], rig, o, &options, &error) != TD_OK) {
        printf("draw %zu: %s\n", index, error.message);
        d->drift[index].p_value = NAN;
    }
    td_observations_free(&o);
    td_rig_free(&rig);
}

static void check_draws(td_camera_model model, size_t views, double noise_px)
{
    size_t count = full_tests() ? FULL_DRAWS : DRAWS;
    simulation s = simulate_stereo(model, views);
    td_rig *rig = calibrated(&s, 3);
    draws d = {&s, rig, noise_px, calloc(count, sizeof(td_drift))};
    double *p = malloc(count * sizeof *p), rms = 0, predicted = 0, epipolar = 0, expected = 0, up = 0,
           scale = 0;
    assert_int_equal(td_parallel_for(count, 0, run_draw, &d, NULL, NULL), TD_OK);
    printf("%s, %zu views, noise %s:\n", td_camera_model_name(model), views,
           noise_px > 0 ? "given" : "estimated");
    for (int what = 0; what < 4; what++) {
        static const char *const names[] = {"all together", "left", "right", "pair"};
        for (size_t i = 0; i < count; i++)
            p[i] = what == 0   ? d.drift[i].p_value
                   : what == 3 ? d.drift[i].pair[0].p_value
                               : d.drift[i].camera[what - 1].p_value;
        check_uniform(names[what], p, count);
    }
    for (size_t i = 0; i < count; i++) {
        const td_drift *a = &d.drift[i];
        rms += a->camera[1].rms_px * a->camera[1].rms_px;
        predicted += a->camera[1].predicted_px * a->camera[1].predicted_px;
        epipolar += a->pair[0].epipolar_px * a->pair[0].epipolar_px;
        expected += a->pair[0].predicted_epipolar_px * a->pair[0].predicted_epipolar_px;
        up += pow(a->pair[0].vertical_px / a->pair[0].sigma_vertical_px, 2) / (double)count;
        scale += pow(a->pair[0].scale_error / a->pair[0].sigma_scale_error, 2) / (double)count;
    }
    double low, high;
    sigma_bounds(&low, &high, count, 2);
    printf("  residuals over predicted %.3f, epipolar %.3f; vertical over sigma %.3f, scale %.3f (within "
           "%.3f, %.3f)\n",
           sqrt(rms / predicted), sqrt(epipolar / expected), sqrt(up), sqrt(scale), low, high);
    check_near(sqrt(rms / predicted), 1, 0.05);
    check_near(sqrt(epipolar / expected), 1, 0.05);
    assert_true(sqrt(up) > low && sqrt(up) < high);
    assert_true(sqrt(scale) > low && sqrt(scale) < high);
    free(p);
    free(d.drift);
    td_rig_free(&rig);
    td_rig_free(&s.rig);
}

static void test_unchanged(void **state)
{
    (void)state;
    check_draws(TD_CAMERA_BROWN5, 6, 0);
    check_draws(TD_CAMERA_BROWN5, 1, 0);
    check_draws(TD_CAMERA_PINHOLE, 6, 0.1);
}

/* One parameter moved by `times` of its own sigma. */
static void check_moved(size_t parameter, double times, const char *words, double *p)
{
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_rig *rig = calibrated(&s, 3);
    size_t n = td_rig_parameter_count(rig);
    double *d = calloc(n, sizeof *d);
    td_random random = td_random_seed(5, parameter);
    td_rig *moved = rig_draw(s.rig, rig->covariance, 1, 0, &random);
    d[parameter] = times * sqrt(rig->covariance[parameter * (n + 1)]);
    td_rig_move(moved, d);
    td_observations *o = simulate(&s, 40, 41 + parameter, 0.1, 0);
    td_drift drift;
    check_ok(td_drift_measure(&drift, moved, o, NULL, &error), error);
    char name[TD_NAME_SIZE + 8];
    *p = drift.p_value;
    if (words) {
        printf("  %-10s %s\n", td_rig_parameter_name(name, rig, parameter), drift.text);
        assert_true(drift.drifted);
        assert_true(drift.drift_sigma > 3.29);
        assert_non_null(strstr(drift.text, words));
    }
    free(d);
    td_observations_free(&o);
    td_rig_free(&moved);
    td_rig_free(&rig);
    td_rig_free(&s.rig);
}

static void test_moved(void **state)
{
    (void)state;
    double p;
    check_moved(0, 10, "", &p);
    check_moved(1, 10, "", &p);
    check_moved(2, 10, "left", &p);
    check_moved(9 + 6 + 0, 10, "right", &p);
    check_moved(9 + 6 + 3, 10, "right", &p);
    check_moved(9 + 6 + 9 + 0, 10, "about its x axis", &p);
    check_moved(9 + 6 + 9 + 1, 10, "right", &p);
    check_moved(9 + 6 + 9 + 2, 10, "right has turned by", &p);
    check_moved(9 + 6 + 9 + 3, 10, "right", &p);
}

/* Two of a joint covariance's sigmas: mostly fine; ten: mostly found, by 6 views or 12. */
static void test_along_covariance(void **state)
{
    (void)state;
    enum { TRIALS = 24 };
    for (int times = 2; times <= 10; times += 8)
        for (size_t views = 6; views <= 14; views += 8) {
            int drifted = 0;
            simulation s = simulate_stereo(TD_CAMERA_BROWN5, views);
            td_rig *rig = calibrated(&s, 3);
            for (uint64_t i = 0; i < TRIALS; i++) {
                td_error error = {0};
                td_random random = td_random_seed(9, i);
                td_rig *drawn = rig_draw(s.rig, rig->covariance, 1, 0, &random);
                td_rig *moved = rig_draw(drawn, rig->covariance, times, 1, &random);
                td_observations *o = simulate(&s, 500 + i, 700 + i, 0.1, 0);
                td_drift drift;
                check_ok(td_drift_measure(&drift, moved, o, NULL, &error), error);
                drifted += drift.drifted;
                td_observations_free(&o);
                td_rig_free(&moved);
                td_rig_free(&drawn);
            }
            printf("  Mahalanobis %d, %zu views: %d of %d drifted\n", times, views, drifted, TRIALS);
            if (times == 2) assert_true(drifted <= 2); /* power at 2 sigma: under 1 %, 0.2 in 24 */
            td_rig_free(&rig);
            td_rig_free(&s.rig);
        }
}

/* A camera knocked out of place: named and measured, with outliers in the views. */
static void test_knock(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 8);
    td_rig *rig = calibrated(&s, 3);
    const double degree = 3.14159265358979 / 180;
    for (int camera = 0; camera < 2; camera++) {
        td_rig *now = td_rig_copy(s.rig);
        const double turn[6] = {0, camera ? 0.12 * degree : 0, camera ? 0 : 0.5 * degree, 0, 0, 0};
        td_pose knock = td_pose_exp(turn), *p = &s.rig->camera[1].camera_from_rig, before = *p;
        if (camera)
            *p = td_pose_compose(&knock, p);
        else {
            td_pose back = td_pose_inverse(&knock);
            *p = td_pose_compose(p, &back);
        }
        td_observations *o = simulate(&s, 40, 41, 0.1, 0);
        td_observations_get(o, 2, 0)->point[17] += 30;
        td_observations_get(o, 3, 1)->point[40] -= 4;
        for (size_t i = 0; i < 54; i++) td_observations_get(o, 5, 1)->point[2 * i] += 25.0 * sin((double)i);
        td_drift drift;
        check_ok(td_drift_measure(&drift, rig, o, NULL, &error), error);
        printf("  %s\n", drift.text);
        assert_true(drift.drifted);
        assert_non_null(
            strstr(drift.text, camera ? "right has turned by 0.12" : "left has turned by 0.499 ±"));
        assert_non_null(strstr(drift.text, camera ? "about its y axis" : "about its z axis"));
        assert_null(strstr(drift.text, "more than that"));
        assert_int_equal(drift.camera[0].views, 7);
        assert_int_equal(drift.camera[0].points, 7 * 54 - 1);
        assert_int_equal(drift.camera[1].points, 7 * 54 - 1);
        *p = before;
        td_observations_free(&o);
        td_rig_free(&now);
    }
    td_rig_free(&rig);
    td_rig_free(&s.rig);
}

static void test_bent_board(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 6);
    td_rig *rig = calibrated(&s, 3);
    s.warp_m[0] = 1e-3, s.warp_m[1] = -4e-4;
    td_observations *o = simulate(&s, 50, 51, 0.1, 0);
    td_drift drift;
    check_ok(td_drift_measure(&drift, rig, o, NULL, &error), error);
    printf("  %s\n", drift.text);
    assert_false(drift.drifted);
    assert_true(drift.p_value > 1e-3);
    td_observations_free(&o);
    td_rig_free(&rig);
    td_rig_free(&s.rig);
}

static void test_words(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 4);
    td_observations *o = simulate(&s, 50, 51, 0.1, 0);
    td_drift drift;
    /* No covariance: no judgement, but figures. */
    check_ok(td_drift_measure(&drift, s.rig, o, NULL, &error), error);
    assert_false(drift.covariance_known || drift.drifted);
    assert_true(isnan(drift.p_value) && isnan(drift.camera[0].predicted_px));
    check_near(drift.camera[0].rms_px, drift.camera[0].noise_px, 0.02);
    assert_non_null(strstr(drift.text, "cannot be judged"));
    /* Cameras by name, in any order, one missing. */
    td_rig *rig = calibrated(&s, 3);
    td_drift both, one;
    check_ok(td_drift_measure(&both, rig, o, NULL, &error), error);
    assert_false(both.drifted);
    assert_int_equal(strncmp(both.text, "fine: ", 6), 0);
    for (size_t v = 0; v < 4; v++) {
        td_detection kept = *td_observations_get(o, v, 0);
        *td_observations_get(o, v, 0) = *td_observations_get(o, v, 1);
        *td_observations_get(o, v, 1) = kept;
    }
    strcpy(o->camera[0].name, "right");
    strcpy(o->camera[1].name, "left");
    check_ok(td_drift_measure(&drift, rig, o, NULL, &error), error);
    check_near(drift.p_value, both.p_value, 1e-9);
    strcpy(o->camera[1].name, "other");
    check_ok(td_drift_measure(&one, rig, o, NULL, &error), error);
    assert_int_equal(one.camera[0].points, 0);
    assert_int_equal(one.pair_count, 0);
    check_near(one.p_value, one.camera[1].p_value, 1e-12);
    strcpy(o->camera[0].name, "third");
    check_fails(td_drift_measure(&one, rig, o, NULL, &error), TD_ERROR_DATA, error, "names must agree");
    strcpy(o->camera[0].name, "right");
    o->camera[0].width = 1280;
    check_fails(td_drift_measure(&one, rig, o, NULL, &error), TD_ERROR_DATA, error, "1280x480");
    td_drift_options options = td_drift_options_default();
    options.p_limit = 2;
    check_fails(td_drift_measure(&one, rig, o, &options, &error), TD_ERROR_ARGUMENT, error, "p_limit");
    td_observations_free(&o);
    td_rig_free(&rig);
    td_rig_free(&s.rig);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_unchanged),        cmocka_unit_test(test_moved),
                                       cmocka_unit_test(test_along_covariance), cmocka_unit_test(test_knock),
                                       cmocka_unit_test(test_bent_board),       cmocka_unit_test(test_words)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
