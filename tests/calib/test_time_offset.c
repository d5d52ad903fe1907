/* Proves that the time offset of two streams comes out right, with a sigma that means it, and that streams
 * which do not tell it are refused. References: simulated streams with a known offset; on ETH's real arm
 * (hand and camera, clocks apart), a shift put on one stream must come back to the millisecond (the streams'
 * own offset being found without it). Blind to offsets that drift. */
#include "calib/hand_eye_mistakes.h"
#include "calib/hand_eye_solvers.h"
#include "core/robot_poses.h"
#include "tests/calib/hand_eye_motions.h"
#include "tests/scratch.h"

enum { MOST = 4000 };

typedef struct streams {
    size_t na, nb;
    double ta[MOST], tb[MOST];
    td_pose a[MOST], b[MOST];
} streams;

/* An irregular motion: sums of sines of unrelated periods. */
static td_pose wander(double t, td_random seed)
{
    double xi[6] = {0};
    for (int k = 0; k < 6; k++)
        for (int s = 0; s < 4; s++) {
            double f = 0.3 + 2.2 * td_random_uniform(&seed), phase = 6.3 * td_random_uniform(&seed);
            xi[k] += (k < 3 ? 0.3 : 0.1) * sin(f * t + phase);
        }
    return td_pose_exp(xi);
}

/* Robot at 50 Hz, camera at 30 Hz with jitter; the camera's clock is behind by `offset`. */
static void simulate(streams *s, uint64_t trial, double duration, double offset, double noise, bool inverted)
{
    td_random random = td_random_seed(77, trial), path = td_random_seed(78, trial);
    hand_eye_truth truth = random_truth(&random, TD_EYE_IN_HAND);
    s->na = (size_t)(duration * 50);
    s->nb = (size_t)(duration * 30);
    for (size_t i = 0; i < s->na; i++) {
        s->ta[i] = (double)i / 50;
        s->a[i] = wander(s->ta[i], path);
    }
    for (size_t i = 0; i < s->nb; i++) {
        double t = 0.3 + ((double)i + 0.1 * td_random_uniform(&random)) / 30;
        s->tb[i] = t - offset;
        td_pose hand = wander(t, path), seen = true_target(&truth, &hand);
        s->b[i] = with_noise(&seen, &random, noise, noise);
        if (inverted) s->b[i] = td_pose_inverse(&s->b[i]);
    }
}

static td_status solve(double *offset, double *sigma, const streams *s, td_error *error)
{
    return td_time_offset(offset, sigma, s->ta, s->a, s->na, s->tb, s->b, s->nb, error);
}

static void test_simulated(void **state)
{
    (void)state;
    streams *s = malloc(sizeof *s);
    td_error error = {0};
    static const double offsets[] = {0, 0.0123, -3.21, 1e3};
    for (int k = 0; k < 8; k++) {
        double offset = NAN, sigma = NAN, truth = offsets[k / 2];
        simulate(s, (uint64_t)k, 30, truth, 0, k % 2);
        check_ok(solve(&offset, &sigma, s, &error), error);
        /* What is left is the robot's motion between its poses taken as straight. */
        check_near(offset, truth, 2e-4);
        assert_true(sigma >= 0 && sigma < 2e-4);
    }
    free(s);
}

/* sqrt of the mean squared (estimate - truth) / sigma over many streams. */
static void test_sigma(void **state)
{
    (void)state;
    const char *full = getenv("TELEDIMOS_FULL");
    int trials = full && !strcmp(full, "1") ? 1000 : 60;
    streams *s = malloc(sizeof *s);
    double sum = 0, usual = 0;
    for (int trial = 0; trial < trials; trial++) {
        td_error error = {0};
        double offset = NAN, sigma = NAN;
        simulate(s, 100 + (uint64_t)trial, 30, 0.5, 0.004, trial % 2);
        check_ok(solve(&offset, &sigma, s, &error), error);
        sum += pow((offset - 0.5) / sigma, 2);
        usual += sigma / trials;
    }
    double ratio = sqrt(sum / trials);
    print_message("sigma %.2f ms, error over sigma %.3f in %d streams\n", 1e3 * usual, ratio, trials);
    /* Newey and West's variance with a tenth of the blocks as lags has about 15 degrees of freedom: errors
     * are Student's t, of which the mean square is 15/13; 99.9 % of `trials` draws lie within 3.3 times their
     * scatter. */
    check_near(ratio, sqrt(15.0 / 13), 3.3 * 1.2 / sqrt(2.0 * trials));
    free(s);
}

/* A camera that loses the target, and poses that flipped. */
static void test_gaps_and_outliers(void **state)
{
    (void)state;
    streams *s = malloc(sizeof *s);
    simulate(s, 5, 40, 0.25, 0.002, false);
    size_t n = 0;
    for (size_t i = 0; i < s->nb; i++) {
        if (i % 200 > 140) continue;
        s->tb[n] = s->tb[i];
        s->b[n] = s->b[i];
        const double flip[6] = {2, 0, 0, 0, 0, 0};
        td_pose f = td_pose_exp(flip);
        if (i % 37 == 0) s->b[n] = td_pose_compose(&s->b[i], &f);
        n++;
    }
    s->nb = n;
    td_error error = {0};
    double offset = NAN, sigma = NAN;
    check_ok(solve(&offset, &sigma, s, &error), error);
    print_message("with gaps and flips: off by %.2f ms, sigma %.2f ms\n", 1e3 * (offset - 0.25), 1e3 * sigma);
    check_near(offset, 0.25, 2e-3);
    free(s);
}

static void test_refused(void **state)
{
    (void)state;
    streams *s = malloc(sizeof *s);
    td_error error = {0};
    double offset = 7, sigma = 7;
    simulate(s, 1, 20, 0, 0.002, false);
    s->nb = 19;
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error, "19 poses in the second stream");
    simulate(s, 1, 20, 0, 0.002, false);
    s->ta[5] = s->ta[6];
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error,
                "times of the first stream do not ascend");
    s->ta[5] = NAN;
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error, "do not ascend");
    streams *other = malloc(sizeof *other);
    simulate(s, 1, 60, 0, 0.002, false);
    simulate(other, 2, 60, 0, 0.002, false);
    memcpy(s->b, other->b, sizeof s->b);
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error, "time offset: the ");
    print_message("another body: %s\n", error.message);
    for (size_t i = 0; i < s->na; i++) s->a[i] = td_pose_identity();
    for (size_t i = 0; i < s->nb; i++) s->b[i] = td_pose_identity();
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error, "are alike to 0.00 at best");
    for (size_t i = 0; i < s->na; i++) {
        const double xi[6] = {0.3 * sin(2 * s->ta[i]), 0.3 * cos(3 * s->ta[i]), 0, 0, 0, 0};
        s->a[i] = td_pose_exp(xi);
    }
    for (size_t i = 0; i < s->nb; i++) {
        const double xi[6] = {0.3 * sin(2 * s->tb[i]), 0.3 * cos(3 * s->tb[i]), 0, 0, 0, 0};
        s->b[i] = td_pose_exp(xi);
    }
    check_fails(solve(&offset, &sigma, s, &error), TD_ERROR_DATA, error, "the motion repeats itself");
    check_near(offset, 7, 0);
    assert_int_equal(solve(&offset, NULL, s, NULL), TD_ERROR_DATA);
    free(s);
    free(other);
}

static void load(double *time, td_pose *pose, size_t *count, const char *folder, const char *name)
{
    td_error error = {0};
    td_robot_poses *p = NULL;
    char path[1024];
    snprintf(path, sizeof path, "%s/robot_arm/robot_arm_complete_bag_color_and_ir_%s.csv", folder, name);
    check_ok(td_robot_poses_read(&p, path, NULL, &error), error);
    *count = p->count < MOST ? p->count : MOST;
    for (size_t i = 0; i < *count; i++) {
        time[i] = p->pose[i].time_s;
        pose[i] = p->pose[i].base_from_hand;
    }
    td_robot_poses_free(&p);
}

/* What is left of the motion once times are aligned: the closed forms on pairs of poses of one time. */
static void print_residuals(const streams *s, double offset, const char *when)
{
    enum { VIEWS = 200 };
    td_hand_eye_view *view = calloc(VIEWS, sizeof *view);
    td_robot_poses robot = {s->na, calloc(s->na, sizeof *robot.pose)};
    size_t n = 0;
    for (size_t i = 0; i < s->na; i++) {
        robot.pose[i].time_s = s->ta[i];
        robot.pose[i].base_from_hand = s->a[i];
    }
    for (size_t i = 0; i < s->nb && n < VIEWS; i += s->nb / VIEWS)
        if (td_robot_poses_at(&view[n].base_from_hand, &robot, s->tb[i] + offset, 0.1))
            view[n++].rig_from_target = td_pose_inverse(&s->b[i]); /* the file has the camera in the target */
    td_solver_score score[TD_SOLVER_COUNT];
    td_error error = {0};
    check_ok(td_hand_eye_solvers_run(score, TD_EYE_IN_HAND, view, n, &error), error);
    int best = td_hand_eye_solvers_best(score);
    print_message("%s: target scatters by %.2f mm, %.3f degrees (%s, %zu poses)\n", when,
                  score[best].scatter_mm, score[best].scatter_deg,
                  td_hand_eye_solver_name(score[best].solver), n);
    free(robot.pose);
    free(view);
}

static void test_real_arm(void **state)
{
    const char *data = getenv("TELEDIMOS_DATA"), *folder = *state;
    char command[2048];
    snprintf(command, sizeof command,
             "unzip -qo '%s/ethz-robot-arm/robot_arm_w_color_camera_real.zip' -d '%s' 2>/dev/null",
             data ? data : "", folder);
    if (!data || system(command) != 0) {
        print_message("skipped: no ethz-robot-arm (TELEDIMOS_DATA), or no unzip\n");
        skip();
    }
    streams *s = malloc(sizeof *s);
    td_error error = {0};
    double own = NAN, sigma = NAN, offset = NAN;
    load(s->ta, s->a, &s->na, folder, "base_link_sr300_hinge");
    load(s->tb, s->b, &s->nb, folder, "target_ir");
    check_ok(solve(&own, &sigma, s, &error), error);
    print_message("ETH's arm: the camera's clock is behind by %.2f ms, sigma %.2f ms\n", 1e3 * own,
                  1e3 * sigma);
    static const double shift[] = {0.137, -1.5, 0.0104};
    for (int k = 0; k < 3; k++) {
        for (size_t i = 0; i < s->nb; i++) s->tb[i] += shift[k];
        check_ok(solve(&offset, &sigma, s, &error), error);
        print_message("shifted by %.1f ms: %.3f ms found\n", 1e3 * shift[k], 1e3 * (own - offset));
        check_near(own - offset, shift[k], 1e-3);
        for (size_t i = 0; i < s->nb; i++) s->tb[i] -= shift[k];
    }
    print_residuals(s, 0, "as recorded");
    print_residuals(s, own, "aligned");
    print_residuals(s, own + 0.02, "20 ms off");
    free(s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_simulated),
        cmocka_unit_test(test_sigma),
        cmocka_unit_test(test_gaps_and_outliers),
        cmocka_unit_test(test_refused),
        cmocka_unit_test_setup_teardown(test_real_arm, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
