/* Proves: the standard deviations that a calibration prints are those of its errors: intrinsics, distortion,
 * baseline and relative rotation, over repeated simulated calibrations of one scene with fresh Gaussian
 * noise. Reference: simulated truth. Bounds: error over sigma, root mean square, stays within what chi-square
 * leaves once in a thousand times for all parameters together; 1000 calibrations with TELEDIMOS_FULL=1, 120
 * otherwise. Blind to: model error and outliers, which no covariance foresees. */
#include "calib/calibrate.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "tests/calib/simulate.h"

enum { PARAMETERS = 9 + 9 + 1 + 3, MOST_RUNS = 1000 };

typedef struct monte_carlo {
    const simulation *truth;
    double noise_px, sigma_px;
    double (*normalised)[PARAMETERS]; /* (runs) error over sigma */
} monte_carlo;

static void run_one(size_t index, void *user)
{
    monte_carlo *mc = user;
    td_error error = {0};
    td_observations *o = simulate(mc->truth, 21, 1000 + index, mc->noise_px, mc->sigma_px);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    options.threads = 1;
    double *out = mc->normalised[index];
    for (int i = 0; i < PARAMETERS; i++) out[i] = NAN;
    if (td_calibrate(&c, o, &options, &error) == TD_OK) {
        int n = 0;
        for (int k = 0; k < 2; k++)
            for (int i = 0; i < 9; i++)
                out[n++] =
                    (c->rig->camera[k].camera.parameter[i] - mc->truth->rig->camera[k].camera.parameter[i]) /
                    c->camera[k].sigma[i];
        const td_pose *t = &mc->truth->rig->camera[1].camera_from_rig;
        out[n++] = (c->pair[0].baseline_m - td_pose_distance(t)) / c->pair[0].sigma_baseline_m;
        double xi[6];
        td_pose back = td_pose_inverse(t), delta = td_pose_compose(&c->rig->camera[1].camera_from_rig, &back);
        td_pose_log(xi, &delta);
        for (int i = 0; i < 3; i++) out[n++] = xi[i] / c->pair[0].sigma_rotation_rad[i];
    }
    td_calibration_free(&c);
    td_observations_free(&o);
}

static void check_coverage(double noise_px, double sigma_px)
{
    static const char *const names[PARAMETERS] = {
        "left.fx",  "left.fy",  "left.cx",  "left.cy",    "left.k1",    "left.k2",   "left.p1",  "left.p2",
        "left.k3",  "right.fx", "right.fy", "right.cx",   "right.cy",   "right.k1",  "right.k2", "right.p1",
        "right.p2", "right.k3", "baseline", "rotation x", "rotation y", "rotation z"};
    size_t runs = full_tests() ? MOST_RUNS : 120;
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    monte_carlo mc = {&s, noise_px, sigma_px, calloc(MOST_RUNS, sizeof *mc.normalised)};
    assert_int_equal(td_parallel_for(runs, 0, run_one, &mc, NULL, NULL), TD_OK);
    double low, high, total = 0;
    sigma_bounds(&low, &high, runs, PARAMETERS);
    printf("noise %.2f px, detections say %.2f px, %zu calibrations: error over sigma within [%.3f, %.3f]\n",
           noise_px, sigma_px, runs, low, high);
    for (int p = 0; p < PARAMETERS; p++) {
        double sum = 0;
        for (size_t i = 0; i < runs; i++) sum += mc.normalised[i][p] * mc.normalised[i][p] / (double)runs;
        printf("  %-12s %.3f\n", names[p], sqrt(sum));
        total += sum / PARAMETERS;
        assert_true(sqrt(sum) > low);
        assert_true(sqrt(sum) < high);
    }
    printf("  %-12s %.3f\n", "all", sqrt(total));
    free(mc.normalised);
    td_rig_free(&s.rig);
}

static void test_known_sigma(void **state)
{
    (void)state;
    check_coverage(0.1, 0.1);
}

/* Nothing is known of the points' own sigma: the noise is estimated from the residuals. */
static void test_estimated_sigma(void **state)
{
    (void)state;
    check_coverage(0.3, 0);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_sigma),
                                       cmocka_unit_test(test_estimated_sigma)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
