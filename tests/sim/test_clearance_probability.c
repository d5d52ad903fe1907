/* Proves that the probability of contact is one: motions of an arm over rough ground at all heights, for each
 * a truth drawn from the errors it was told of (noise of the cells with its correlation, one pose of the
 * vehicle, one of the map, the joints' zeros and readings), moved exactly and tested for contact by brute
 * force (surface sampled three times in a cell, twice in a step). Reliability: in each tenth of predicted
 * probability the interval of Clopper and Pearson around the share of contacts holds the mean prediction
 * (99.9 % for all tenths together), and all contacts are as many as predicted but for 99.9 % of chance and
 * one trial in a hundred (points of the ground that are not used, times between samples). 300 trials, 20000
 * with TELEDIMOS_FULL=1. And that a motion through a stone is refused by name, time and probability.
 *
 * Blind to: errors that are not those of the model; probabilities far below a hundredth. */
#include "tests/sim/clearance_trials.h"

static void test_reliability(void **state)
{
    (void)state;
    check_statistics();
    const char *full = getenv("TELEDIMOS_FULL");
    const reliability r = measure_reliability(full && strcmp(full, "1") == 0 ? 20000 : 300);
    int wrong = 0;
    print_message("%d trials, %.0f points each; sigma of the integral up to %.4f, left out up to %.4f\n"
                  "contacts over the predicted: %.2f sigma\n"
                  "predicted     trials  contacts  mean     share    99.9 %% of all bins\n",
                  r.count, r.points, r.sigma, r.left_out, r.difference / sqrt(r.variance));
    for (int b = 0; b < BINS; b++) {
        if (r.n[b] == 0) continue;
        const bool holds = r.mean[b] >= r.interval[b][0] && r.mean[b] <= r.interval[b][1];
        print_message("%.1f to %.1f  %7d  %8d  %.4f   %.4f   %.4f to %.4f%s\n", (double)b / BINS,
                      (b + 1.0) / BINS, r.n[b], r.hits[b], r.mean[b], (double)r.hits[b] / r.n[b],
                      r.interval[b][0], r.interval[b][1], holds ? "" : "  *");
        wrong += !holds;
    }
    assert_int_equal(wrong, 0);
    check_less(fabs(r.difference), 3.29 * sqrt(r.variance) + 0.01 * r.count);
    for (int b = 0; b < BINS; b++) assert_true(r.n[b] > r.count / 200);
}

/* ---- through a stone ---- */

static void test_stone(void **state)
{
    (void)state;
    td_robot *robot = make_robot(arm_urdf);
    td_elevation *ground = make_ground(COLUMNS, ROWS, cell, -0.7, -3, 0.01);
    td_clearance_map *map = NULL;
    td_clearance c;
    char words[256];
    /* A ball of 0.25 m half in the ground, 3.7 m ahead. */
    for (int r = 0; r < ROWS; r++)
        for (int i = 0; i < COLUMNS; i++) {
            const double left = 0.25 * 0.25 - pow(-0.7 + cell * i - 3.7, 2) - pow(-3 + cell * r, 2);
            if (left > 0) ground->height[r * COLUMNS + i] = (float)sqrt(left);
        }
    check_ok(td_clearance_map_new(&map, ground, NAN, &error), error);
    /* The bucket swings through it, 0.1 m above the plain. */
    const double time[] = {0, 4}, q[] = {-0.5, 0, 0, 0, 0.5, 0, 0, 0};
    double common[36] = {0};
    for (int i = 0; i < 6; i++) common[7 * i] = i < 3 ? 1e-6 : 1e-4;
    td_clearance_motion motion = {.robot = robot,
                                  .site_from_vehicle = {{1, 0, 0, 0}, {0, 0, -0.35}},
                                  .map_covariance = common,
                                  .count = 2,
                                  .time_s = time,
                                  .q = q};
    check_ok(td_clearance_check(&c, map, &motion, NULL, &error), error);
    assert_false(td_clearance_verdict(words, sizeof words, &c, robot, NULL));
    print_message("%s\n", words);
    assert_string_equal(robot->link[c.first.link].name, "bucket");
    check_less(0.99, c.probability);
    /* Its nearer edge, y = -0.25 from the axis of the bucket, meets the stone's side, 0.23 m from its middle
     * at this height: a swing of about -0.48 / 3.7 rad. */
    check_near(c.first.time_s, 2 - 4 * 0.48 / 3.7, 0.12);
    assert_non_null(strstr(words, "bucket meets the ground at 1."));
    assert_non_null(strstr(words, "with probability 1"));
    td_clearance_map_free(&map);
    td_elevation_free(&ground);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_reliability), cmocka_unit_test(test_stone)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
