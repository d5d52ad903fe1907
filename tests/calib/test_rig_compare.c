/* Proves: independent calibrations of one rig are found consistent as often as the p value says, of equal
 * models and of different ones, finite distance or not; the predicted difference is the one that comes; a
 * change far above the sigmas is found, in its place; a common rotation of a camera's frame is none of its
 * images.
 *
 * Reference: simulated truth, two calibrations each from views and noise of their own. Bounds: Kolmogorov and
 * Smirnov at one in a thousand, binomial likewise; predicted RMS, over
 * the parts of the image that are known to half a pixel, within the chi-square bound of so many pairs
 * (sigma_bounds for one parameter, since a field's few weak directions carry most of it). Derivatives are
 * behind every p value: an error in them shows as a p that is not uniform. Blind to: errors common to both
 * calibrations.
 */
#include "calib/rig_compare.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "tests/calib/rig_draw.h"

enum { PAIRS = 40, FULL_PAIRS = 1000 };

typedef struct pairs {
    const simulation *s;
    td_camera_model model[2]; /* with which the two calibrations are made */
    double distance_m;
    td_rig_compare *compare; /* (count) */
} pairs;

static td_rig *calibrated(const simulation *s, uint64_t seed, td_camera_model model)
{
    td_error error = {0};
    td_observations *o = simulate(s, seed, seed + 1000000, 0.1, 0);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    options.threads = 1;
    for (int k = 0; k < o->camera_count; k++) o->camera[k].model = model;
    td_rig *rig = td_calibrate(&c, o, &options, &error) == TD_OK ? td_rig_copy(c->rig) : NULL;
    td_calibration_free(&c);
    td_observations_free(&o);
    return rig;
}

static void run_pair(size_t index, void *user)
{
    pairs *w = user;
    td_error error = {0};
    td_rig *a = calibrated(w->s, 100 + 2 * index, w->model[0]),
           *b = calibrated(w->s, 101 + 2 * index, w->model[1]);
    w->compare[index].p_value = NAN;
    if (!a || !b || td_rig_compare_run(&w->compare[index], a, b, w->distance_m, 1e-3, &error) != TD_OK)
        printf("pair %zu: %s\n", index, error.message);
    td_rig_free(&a);
    td_rig_free(&b);
}

static void check_pairs(td_camera_model truth, td_camera_model a, td_camera_model b, double distance_m)
{
    size_t count = full_tests() ? FULL_PAIRS : PAIRS;
    simulation s = simulate_stereo(truth, 12);
    pairs w = {&s, {a, b}, distance_m, calloc(count, sizeof(td_rig_compare))};
    double *p = malloc(count * sizeof *p), square = 0, predicted = 0, low, high;
    assert_int_equal(td_parallel_for(count, 0, run_pair, &w, NULL, NULL), TD_OK);
    printf("%s as %s and %s, at %g m:\n", td_camera_model_name(truth), td_camera_model_name(a),
           td_camera_model_name(b), distance_m);
    for (int what = 0; what < 4; what++) {
        static const char *const names[] = {"all together", "left", "right", "pair"};
        /* Frames of different models mean different things: their relative pose is not compared by itself. */
        if (what == 3 && a != b) continue;
        for (size_t i = 0; i < count; i++)
            p[i] = what == 0   ? w.compare[i].p_value
                   : what == 3 ? w.compare[i].pair[0].p_value
                               : w.compare[i].camera[what - 1].p_value;
        check_uniform(names[what], p, count);
    }
    for (size_t i = 0; i < count; i++) {
        const td_compared_camera *c = &w.compare[i].camera[0];
        for (int k = 0; k < TD_COMPARE_ROWS * TD_COMPARE_COLUMNS; k++) {
            /* Corners that no view reached are known to pixels: there the difference is not linear. */
            if (!(c->expected_px[k] < 0.5)) continue;
            square += pow(c->difference_px[k][0], 2) + pow(c->difference_px[k][1], 2);
            predicted += pow(c->expected_px[k], 2);
        }
    }
    sigma_bounds(&low, &high, count, 1);
    printf("  difference over predicted %.3f (within %.3f, %.3f), %d degrees\n", sqrt(square / predicted),
           low, high, w.compare[0].camera[0].degrees);
    assert_true(sqrt(square / predicted) > low && sqrt(square / predicted) < high);
    free(p);
    free(w.compare);
    td_rig_free(&s.rig);
}

static void test_consistent(void **state)
{
    (void)state;
    check_pairs(TD_CAMERA_BROWN5, TD_CAMERA_BROWN5, TD_CAMERA_BROWN5, 0.5);
    check_pairs(TD_CAMERA_PINHOLE, TD_CAMERA_PINHOLE, TD_CAMERA_BROWN5, 0.5);
    check_pairs(TD_CAMERA_PINHOLE, TD_CAMERA_BROWN5, TD_CAMERA_PINHOLE, INFINITY);
}

/* Turned frames, known exactly: the image differs by nothing, and the rotation is the one put in. */
static void test_common_motion(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *a = td_rig_new(), *b;
    a->count = 1;
    strcpy(a->camera[0].name, "left");
    a->camera[0].camera = simulated_camera(TD_CAMERA_PINHOLE, 530, 0);
    a->camera[0].camera_from_rig = td_pose_identity();
    b = td_rig_copy(a);
    td_rig_compare c;
    check_ok(td_rig_compare_run(&c, a, b, 1, 1e-3, &error), error);
    check_near(c.camera[0].most_px, 0, 1e-9);
    check_near(c.camera[0].rms_mm, 0, 1e-9);
    assert_true(isnan(c.p_value));
    assert_false(c.significant);
    assert_non_null(strstr(c.text, "no covariance"));
    /* A principal point moved by 1 px is a turn by 1/530 rad about y to first order: what stays is
     * second-order, (1/530) (320/530)^2 530 px = 0.4 px at the corners. */
    b->camera[0].camera.parameter[2] += 1;
    check_ok(td_rig_compare_run(&c, a, b, INFINITY, 1e-3, &error), error);
    check_near(fabs(c.camera[0].rotation_rad[1]), 1 / 530.0, 0.2 / 530);
    assert_true(c.camera[0].most_px < 0.5 && c.camera[0].most_px > 0.05);
    assert_true(isnan(c.camera[0].rms_mm));
    double before = c.camera[0].rms_px;
    /* A focal length 1 % longer: at one finite distance a shift towards the scene explains part of it. */
    b->camera[0].camera = a->camera[0].camera;
    b->camera[0].camera.parameter[0] *= 1.01, b->camera[0].camera.parameter[1] *= 1.01;
    check_ok(td_rig_compare_run(&c, a, b, INFINITY, 1e-3, &error), error);
    double far = c.camera[0].rms_px;
    assert_true(far > 1 && far > before);
    check_ok(td_rig_compare_run(&c, a, b, 0.5, 1e-3, &error), error);
    check_less(c.camera[0].rms_px, 0.3 * far);
    check_near(c.camera[0].rms_mm, c.camera[0].rms_px / 530 * 500, 0.3 * c.camera[0].rms_mm);
    td_rig_free(&a);
    td_rig_free(&b);
}

static void test_different(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    td_rig *a = calibrated(&s, 5, TD_CAMERA_BROWN5), *b = calibrated(&s, 7, TD_CAMERA_BROWN5);
    size_t n = td_rig_parameter_count(a);
    td_rig_compare c;
    double *d = calloc(n, sizeof *d);
    for (int what = 0; what < 3; what++) {
        td_rig *moved = td_rig_copy(b);
        size_t k = what == 0 ? 4 : what == 1 ? 15 + 4 : 15 + 9 + 2; /* left.k1, right.k1, right.rz */
        memset(d, 0, n * sizeof *d);
        d[k] = 10 * sqrt(2 * b->covariance[k * (n + 1)]);
        td_rig_move(moved, d);
        check_ok(td_rig_compare_run(&c, a, moved, 0.5, 1e-3, &error), error);
        printf("  %s\n", c.text);
        assert_true(c.significant);
        assert_non_null(strstr(c.text, what == 0   ? "most in left"
                                       : what == 1 ? "most in right"
                                                   : "pose of right relative to left"));
        td_rig_free(&moved);
    }
    /* By name, whatever the order: b's cameras exchanged, its frame now the right one's. */
    td_rig *exchanged = td_rig_copy(b);
    exchanged->camera[0] = b->camera[1], exchanged->camera[1] = b->camera[0];
    exchanged->camera[0].camera_from_rig = td_pose_identity();
    exchanged->camera[1].camera_from_rig = td_pose_inverse(&b->camera[1].camera_from_rig);
    double ad[36], *map = calloc(n * n, sizeof *map);
    td_pose_adjoint(ad, &exchanged->camera[1].camera_from_rig);
    for (size_t i = 0; i < 9; i++) map[i * n + 15 + i] = map[(15 + i) * n + i] = 1;
    for (size_t i = 0; i < 36; i++) map[(24 + i / 6) * n + 24 + i % 6] = -ad[i];
    check_ok(td_sandwich(exchanged->covariance, map, b->covariance, n, n, &error), error);
    td_rig_compare straight, crossed;
    check_ok(td_rig_compare_run(&straight, a, b, 0.5, 1e-3, &error), error);
    check_ok(td_rig_compare_run(&crossed, a, exchanged, 0.5, 1e-3, &error), error);
    printf("  %s\n", straight.text);
    assert_false(straight.significant);
    check_near(crossed.p_value, straight.p_value, 1e-6);
    check_near(crossed.pair[0].p_value, straight.pair[0].p_value, 1e-6);
    check_near(crossed.camera[1].rms_px, straight.camera[1].rms_px, 1e-9);
    assert_string_equal(crossed.camera[1].name, "right");
    /* Refusals. */
    check_fails(td_rig_compare_run(&c, a, b, -1, 1e-3, &error), TD_ERROR_ARGUMENT, error, "distance_m");
    exchanged->camera[0].camera.width = 800;
    check_fails(td_rig_compare_run(&c, a, exchanged, 1, 1e-3, &error), TD_ERROR_DATA, error,
                "camera right: 640x480");
    free(map);
    free(d);
    td_rig_free(&exchanged);
    td_rig_free(&a);
    td_rig_free(&b);
    td_rig_free(&s.rig);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_common_motion), cmocka_unit_test(test_different),
                                       cmocka_unit_test(test_consistent)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
