/* Proves: what a board does wrong (points off their places, a sheet that bends and stretches from view to
 * view) is found from the residuals, and the covariance of the rig is then that of its errors: error over
 * sigma, the root mean square of the Mahalanobis length over its degrees of freedom, jointly over both
 * cameras' parameters and their relative pose, in calibrations of simulated views of a new board each time.
 * Reference: simulated truth; without the board's errors counted the ratio must be far too large. Bounds: 0.9
 * to 1.15, and sigmas of the components within 20 %. On clean views nothing may be found: with the
 * false-alarm rate of 1 in 1000, 3 in 300 are exceeded less than once in 10000 times. 300 calibrations with
 * TELEDIMOS_FULL=1, 60 otherwise. Blind to: errors that are not the board's, and shapes beyond the third
 * degree. */
#include "calib/board_error_internal.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "tests/calib/simulate.h"

enum { MOST_RUNS = 300, RIG = 24 };

typedef struct monte_carlo {
    const simulation *truth;
    double noise_px, with[MOST_RUNS], without[MOST_RUNS];
    td_board_error board[MOST_RUNS];
} monte_carlo;

/* Mahalanobis length, squared, of the rig's error by a covariance of its td_rig_parameter_count numbers, the
 * first camera's pose left out. */
static double length2(const td_rig *rig, const td_rig *truth, const double *covariance)
{
    double e[RIG], c[RIG * RIG], scale[RIG], sum = 0, xi[6];
    size_t at[RIG], n = 0, width = td_rig_parameter_count(rig);
    td_pose back = td_pose_inverse(&truth->camera[1].camera_from_rig);
    td_pose delta = td_pose_compose(&rig->camera[1].camera_from_rig, &back);
    td_pose_log(xi, &delta);
    for (int k = 0; k < 2; k++)
        for (size_t i = 0; i < 9; i++) {
            e[n] = rig->camera[k].camera.parameter[i] - truth->camera[k].camera.parameter[i];
            at[n++] = td_rig_parameter_offset(rig, k) + i;
        }
    for (size_t i = 0; i < 6; i++) {
        e[n] = xi[i];
        at[n++] = td_rig_parameter_offset(rig, 1) + 9 + i;
    }
    for (size_t i = 0; i < RIG; i++) scale[i] = 1 / sqrt(covariance[at[i] * (width + 1)]);
    for (size_t i = 0; i < RIG; i++)
        for (size_t k = 0; k < RIG; k++)
            c[i * RIG + k] = covariance[at[i] * width + at[k]] * scale[i] * scale[k];
    assert_int_equal(td_invert_spd(c, c, RIG, NULL), TD_OK);
    for (size_t i = 0; i < RIG; i++)
        for (size_t k = 0; k < RIG; k++) sum += e[i] * scale[i] * c[i * RIG + k] * e[k] * scale[k];
    return sum;
}

/* The rig's covariance when the board is taken to be perfect: the calibration's problem without it. */
static void naive_covariance(double *out, const td_calibration *c, const td_observations *o)
{
    td_calibration naive = *c;
    td_bundle_result result;
    td_error error = {0};
    size_t n = td_rig_parameter_count(c->rig);
    naive.board = (td_board_error){.noise_share = 1};
    check_ok(td_bundle_result_new(&result, &naive, o, &error), error);
    const int block[3] = {result.problem.blocks.camera[0], result.problem.blocks.camera[1],
                          result.problem.blocks.pose[1]};
    const size_t first[3] = {0, td_rig_parameter_offset(c->rig, 1), td_rig_parameter_offset(c->rig, 1) + 9},
                 size[3] = {9, 9, 6};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            double s[81];
            check_ok(td_covariance_get(s, result.covariance, block[i], block[k], &error), error);
            for (size_t a = 0; a < size[i]; a++)
                memcpy(out + (first[i] + a) * n + first[k], s + a * size[k], size[k] * sizeof *s);
        }
    td_bundle_result_free(&result);
}

static void run_one(size_t index, void *user)
{
    monte_carlo *mc = user;
    td_error error = {0};
    td_observations *o = simulate(mc->truth, 21, 5000 + index, mc->noise_px, 0);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    options.threads = 1;
    mc->with[index] = mc->without[index] = NAN;
    if (td_calibrate(&c, o, &options, &error) == TD_OK) {
        size_t n = td_rig_parameter_count(c->rig);
        double *naive = calloc(n * n, sizeof *naive);
        naive_covariance(naive, c, o);
        mc->with[index] = length2(c->rig, mc->truth->rig, c->rig->covariance);
        mc->without[index] = length2(c->rig, mc->truth->rig, naive);
        mc->board[index] = c->board;
        free(naive);
    }
    td_calibration_free(&c);
    td_observations_free(&o);
}

static size_t runs(void)
{
    return full_tests() ? MOST_RUNS : sanitized_tests() ? 4 : 60;
}

static monte_carlo *carry_out(const simulation *s, double noise_px)
{
    monte_carlo *mc = calloc(1, sizeof *mc);
    *mc = (monte_carlo){.truth = s, .noise_px = noise_px};
    assert_int_equal(td_parallel_for(runs(), 0, run_one, mc, NULL, NULL), TD_OK);
    return mc;
}

static double root_mean(const double *x, size_t n, double over)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += x[i] / over / (double)n;
    return sqrt(sum);
}

/* RMS over the board and over all directions of what a unit sag leaves once the pose has followed. */
static double bend_of_sag(const td_target *target)
{
    enum { DIRECTIONS = 36 };
    size_t n = td_target_point_count(target), columns = (size_t)target->plane[0].columns;
    double *a = malloc(4 * n * sizeof *a), *z = a + 3 * n, fit[3], square = 0;
    for (int k = 0; k < DIRECTIONS; k++) {
        for (size_t i = 0; i < n; i++) {
            double x = 2 * (double)(i % columns) / (double)(columns - 1) - 1;
            double y = 2 * (double)(i / columns) / (target->plane[0].rows - 1.0) - 1;
            double u = x * cos(6.2831853 * k / DIRECTIONS) + y * sin(6.2831853 * k / DIRECTIONS);
            a[3 * i] = 1, a[3 * i + 1] = x, a[3 * i + 2] = y;
            z[i] = 1 - u * u;
        }
        assert_int_equal(td_least_squares_linear(fit, NULL, a, z, n, 3, NULL), TD_OK);
        for (size_t i = 0; i < n; i++) {
            double rest = z[i] - fit[0] - fit[1] * a[3 * i + 1] - fit[2] * a[3 * i + 2];
            square += rest * rest / (double)(n * DIRECTIONS);
        }
    }
    free(a);
    return sqrt(square);
}

static void check_board(double print_m, double sag_m, double stretch_m, size_t views)
{
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, views);
    s.print_m = print_m, s.sag_m = sag_m, s.stretch_m = stretch_m;
    monte_carlo *mc = carry_out(&s, 0.1);
    size_t n = runs();
    double with = root_mean(mc->with, n, RIG), without = root_mean(mc->without, n, RIG), part[4] = {0},
           share = 0;
    for (size_t i = 0; i < n; i++) {
        const double rms[4] = {mc->board[i].print_m, mc->board[i].bend_m, mc->board[i].stretch_m,
                               mc->board[i].ripple_m};
        for (int k = 0; k < 4; k++) part[k] += rms[k] * rms[k] / (double)n;
        share += mc->board[i].noise_share / (double)n;
        assert_true(mc->board[i].significant);
    }
    printf("print %.0f um, sag %.0f um, stretch %.0f um, %zu views, %zu calibrations:\n"
           "  error over sigma %.3f; with a perfect board assumed %.3f\n"
           "  found: print %.1f um, bend %.1f um, stretch %.1f um, ripple %.1f um, noise share %.3f\n",
           1e6 * print_m, 1e6 * sag_m, 1e6 * stretch_m, views, n, with, without, 1e6 * sqrt(part[0]),
           1e6 * sqrt(part[1]), 1e6 * sqrt(part[2]), 1e6 * sqrt(part[3]), share);
    if (!sanitized_tests()) {
        assert_true(with > 0.9);
        assert_true(with < 1.15);
        assert_true(without > 1.2);
        assert_true(without - with > 0.15);
        check_near(sqrt(part[1]) / (sag_m * bend_of_sag(&s.target)), 1, 0.2);
        check_near(sqrt(part[0]) / print_m, 1, 0.2);
        if (stretch_m > 0) check_near(sqrt(part[2]) / stretch_m, 1, 0.2);
    }
    free(mc);
    td_rig_free(&s.rig);
}

static void test_print_and_bend(void **state)
{
    (void)state;
    check_board(50e-6, 0.1e-3, 0, 12);
}

static void test_stretch(void **state)
{
    (void)state;
    check_board(50e-6, 0.1e-3, 70e-6, 7);
}

static void test_clean(void **state)
{
    (void)state;
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    size_t n = runs(), alarms = 0;
    monte_carlo *mc = carry_out(&s, 0.1);
    double largest = 0;
    for (size_t i = 0; i < n; i++) {
        alarms += mc->board[i].significant;
        largest = fmax(largest, mc->board[i].gain);
    }
    printf("clean: %zu false alarms in %zu, largest gain %.1f; error over sigma %.3f\n", alarms, n, largest,
           root_mean(mc->with, n, RIG));
    assert_true(alarms <= 3);
    free(mc);
    td_rig_free(&s.rig);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_print_and_bend), cmocka_unit_test(test_stretch),
                                       cmocka_unit_test(test_clean)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
