/* Proves that the clearance of a motion is that of the links to the surface of the map (brute force: the
 * surface sampled twelve times in a cell, formulas of the test's own; ours is never nearer, and further by
 * what lies between cells at most), that first contact comes when geometry says, that the pyramid follows
 * changes of the map, that the integral gives normal probabilities known in closed form, that contact is
 * allowed where it is said, that unknown ground is told, and that bad input is refused.
 *
 * Blind to: whether the probability holds for true geometry (test_clearance_probability.c). */
#include "sim/clearance.h"

#include "sim/clearance_internal.h"
#include "tests/sim/clearance_scene.h"

static td_error error;

static td_clearance_map *make_map(const td_elevation *ground)
{
    td_clearance_map *map = NULL;
    check_ok(td_clearance_map_new(&map, ground, NAN, &error), error);
    return map;
}

static double random_between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

/* ---- distances ---- */

static double truth_of_arm(const td_elevation *ground, const td_robot *robot,
                           const td_pose *site_from_vehicle, const double *q, int fine)
{
    td_pose link[TD_ROBOT_MAX_LINKS];
    double least = 10;
    td_robot_forward(link, robot, q);
    for (int k = 0; k < robot->link_count; k++)
        for (int s = 0; s < robot->link[k].shape_count; s++) {
            const td_pose site_from_link = td_pose_compose(site_from_vehicle, link + k);
            const td_pose pose = td_pose_compose(&site_from_link, &robot->link[k].shape[s].link_from_shape);
            const double d = truth_to_ground(ground, robot->link[k].shape + s, &pose, fine, least, -10);
            least = fmin(least, d);
        }
    return least;
}

static void test_distance(void **state)
{
    (void)state;
    td_robot *robot = make_robot(arm_urdf);
    td_random random = td_random_seed(3, 0);
    double worst = 0, worst_near = 0;
    int near = 0, touching = 0;
    for (int trial = 0; trial < 150; trial++) {
        td_elevation *ground = make_ground(113, 121, 0.05, -0.7, -3, 0.01);
        roughen(ground, (uint64_t)trial);
        td_clearance_map *map = make_map(ground);
        const double time = 0,
                     q[ARM_JOINTS] = {random_between(&random, -0.8, 0.8), random_between(&random, -0.7, 0.2),
                                      random_between(&random, 0.2, 1.5), random_between(&random, -0.8, 1.5)};
        td_clearance_motion motion = {
            .robot = robot,
            .site_from_vehicle = {{1, 0, 0, 0}, {0, 0, random_between(&random, 0.3, 1.3)}},
            .count = 1,
            .time_s = &time,
            .q = q};
        td_clearance found;
        check_ok(td_clearance_check(&found, map, &motion, NULL, &error), error);
        if (trial % 3) { /* just above or just in */
            motion.site_from_vehicle.t[2] += random_between(&random, -0.05, 0.05) - found.nearest.clearance_m;
            check_ok(td_clearance_check(&found, map, &motion, NULL, &error), error);
        }
        const double truth = truth_of_arm(ground, robot, &motion.site_from_vehicle, q, 12);
        if (truth > 0) {
            const double off = found.nearest.clearance_m - truth;
            if (!(off > -0.001))
                fail_msg("trial %d: %g m, truth %g m", trial, found.nearest.clearance_m, truth);
            worst = fmax(worst, off);
            if (truth < 0.1) worst_near = fmax(worst_near, off);
            near += truth < 0.1;
            assert_false(found.contact && truth > 0.001);
        } else {
            touching++;
            if (truth < -0.005) assert_true(found.contact);
        }
        td_clearance_map_free(&map);
        td_elevation_free(&ground);
    }
    print_message(
        "clearance over the truth: at most %.2f mm, nearer than 0.1 m %.2f mm (%d near, %d touching)\n",
        1e3 * worst, 1e3 * worst_near, near, touching);
    assert_true(near > 15 && touching > 15);
    check_less(worst, 0.012);
    td_robot_free(&robot);
}

/* ---- a ball on a lift over a plane: everything in closed form ---- */

static const char lift_urdf[] =
    "<robot name='lift'><link name='base'/><link name='ball'><collision><geometry><sphere radius='0.3'/>"
    "</geometry></collision></link><joint name='lift' type='prismatic'><parent link='base'/>"
    "<child link='ball'/><axis xyz='0 0 1'/><limit lower='-10' upper='10' effort='1' velocity='1'/></joint>"
    "</robot>";

typedef struct lift {
    td_robot *robot;
    td_elevation *ground;
    td_clearance_map *map;
    td_clearance_motion motion;
} lift;

static lift make_lift(double sigma, const double *time, const double *q, size_t count)
{
    lift l = {.robot = make_robot(lift_urdf), .ground = make_ground(101, 101, 0.05, -2.5, -2.5, sigma)};
    l.map = make_map(l.ground);
    l.motion = (td_clearance_motion){
        .robot = l.robot, .site_from_vehicle = td_pose_identity(), .count = count, .time_s = time, .q = q};
    return l;
}

static void free_lift(lift *l)
{
    td_robot_free(&l->robot);
    td_elevation_free(&l->ground);
    td_clearance_map_free(&l->map);
}

static double below(double x)
{
    return 0.5 * erfc(-x / sqrt(2));
}

static void test_lift(void **state)
{
    (void)state;
    const double time[] = {1, 3, 5}, q[] = {1, 0.2, 1};
    lift l = make_lift(0, time, q, 3);
    td_clearance c;
    char words[256];
    check_ok(td_clearance_check(&c, l.map, &l.motion, NULL, &error), error);
    /* Height 0.3 after 0.7 of 0.8 m: 1 + 2 * 0.875 s. */
    assert_true(c.contact);
    check_near(c.first.time_s, 2.75, 1e-4);
    check_near(c.nearest.clearance_m, -0.1, 1e-6);
    check_near(c.nearest.time_s, 3, 1e-9);
    assert_true(c.probability == 1);
    assert_false(td_clearance_verdict(words, sizeof words, &c, l.robot, NULL));
    assert_string_equal(
        words, "ball meets the ground at 2.75 s with probability 1 (clearance -0.100 m at 0.00, 0.00)");
    /* Common errors alone: one normal variable. */
    const double height[] = {1, 0.35, 1};
    double vehicle[36] = {0}, calibration[36] = {0}, zero = 0.03;
    vehicle[35] = 0.02 * 0.02;
    calibration[35] = 0.04 * 0.04;
    l.motion.q = height;
    l.motion.vehicle_covariance = vehicle;
    l.motion.map_covariance = calibration;
    l.motion.sigma_zero = &zero;
    check_ok(td_clearance_check(&c, l.map, &l.motion, NULL, &error), error);
    const double sigma = sqrt(0.02 * 0.02 + 0.04 * 0.04 + zero * zero);
    check_near(c.nearest.clearance_m, 0.05, 1e-6);
    check_near(c.likely_sigma_m, sigma, 1e-9);
    assert_false(c.contact);
    check_near(c.probability, below(-0.05 / sigma), 2e-3);
    /* Accepted where the risk is. */
    td_clearance_options options = td_clearance_options_default();
    options.highest_probability = 0.5;
    assert_false(td_clearance_verdict(NULL, 0, &c, l.robot, NULL));
    assert_true(td_clearance_verdict(words, sizeof words, &c, l.robot, &options));
    assert_non_null(strstr(words, "clear of the ground: ball comes nearest at 3.00 s"));
    free_lift(&l);
}

/* A cube on its corner in the middle between four cells, none of which is below it. */
static void test_corner(void **state)
{
    (void)state;
    static const char urdf[] =
        "<robot name='lift'><link name='base'/><link name='cube'><collision>"
        "<origin xyz='0.3 0.3 0' rpy='0.78539816339745 0.61547970867039 0'/><geometry><box size='0.4 0.4 "
        "0.4'/>"
        "</geometry></collision></link><joint name='lift' type='prismatic'><parent link='base'/>"
        "<child link='cube'/><axis xyz='0 0 1'/><limit lower='-9' upper='9' effort='1' velocity='1'/></joint>"
        "</robot>";
    td_robot *robot = make_robot(urdf);
    td_elevation *ground = make_ground(21, 21, 0.4, -3.9, -3.9, 0);
    td_clearance_map *map = make_map(ground);
    const double time = 0, half = 0.2 * sqrt(3), above = half + 0.05, in = half - 0.02, sigma = 0.04;
    td_clearance_motion motion = {.robot = robot,
                                  .site_from_vehicle = td_pose_identity(),
                                  .sigma_zero = &sigma,
                                  .count = 1,
                                  .time_s = &time,
                                  .q = &above};
    td_clearance c;
    td_clearance_options options = td_clearance_options_default();
    options.draws = 20000;
    check_ok(td_clearance_check(&c, map, &motion, &options, &error), error);
    check_near(c.nearest.clearance_m, 0.05, 1e-6);
    check_near(c.probability, below(-0.05 / sigma), 1e-3);
    motion.q = &in;
    check_ok(td_clearance_check(&c, map, &motion, NULL, &error), error);
    assert_true(c.contact);
    check_near(c.nearest.clearance_m, -0.02, 1e-6);
    td_clearance_map_free(&map);
    td_elevation_free(&ground);
    td_robot_free(&robot);
}

/* Two readings near the ground with noise of their own: 1 - (1 - p)^2. */
static void test_readings(void **state)
{
    (void)state;
    const double time[] = {1, 2, 3, 4, 5}, q[] = {2, 0.32, 2, 0.32, 2}, noise = 0.02;
    lift l = make_lift(0, time, q, 5);
    td_clearance c;
    td_clearance_options options = td_clearance_options_default();
    options.draws = 100000; /* plain: sigma 0.0015 */
    l.motion.sigma_reading = &noise;
    check_ok(td_clearance_check(&c, l.map, &l.motion, &options, &error), error);
    const double p = below(-1);
    check_near(c.probability, 1 - (1 - p) * (1 - p), 6e-3);
    free_lift(&l);
}

static void test_allowed(void **state)
{
    (void)state;
    const double time[] = {1, 3, 5}, q[] = {1, 0.2, 1};
    lift l = make_lift(0, time, q, 3);
    const td_clearance_allowed digging = {td_robot_find_link(l.robot, "ball"), 2.5, 3.5};
    td_clearance c;
    l.motion.allowed = &digging;
    l.motion.allowed_count = 1;
    check_ok(td_clearance_check(&c, l.map, &l.motion, NULL, &error), error);
    assert_false(c.contact);
    assert_true(c.probability == 0);
    /* At 2.5 s it is 0.1 m above; the last sample before is a step of 0.05 m at most earlier. */
    assert_true(c.nearest.clearance_m > 0.1 - 1e-9 && c.nearest.clearance_m < 0.15);
    free_lift(&l);
}

/* ---- unknown ground, changes ---- */

static void test_unseen(void **state)
{
    (void)state;
    const double time[] = {0, 1}, q[] = {0.5, 0.4};
    lift l = make_lift(0.01, time, q, 2);
    td_clearance c;
    char words[256];
    check_ok(td_clearance_check(&c, l.map, &l.motion, NULL, &error), error);
    assert_false(c.unseen);
    l.ground->height[50 * 101 + 52] = NAN;
    check_ok(td_clearance_map_update(l.map, 52, 50, 1, 1, &error), error);
    check_ok(td_clearance_check(&c, l.map, &l.motion, NULL, &error), error);
    assert_false(c.unseen); /* the highest ground that is known is 0 + 5 sigma */
    td_clearance_options options = td_clearance_options_default();
    options.unseen_top_m = 0.15;
    check_ok(td_clearance_check(&c, l.map, &l.motion, &options, &error), error);
    assert_true(c.unseen);
    assert_true(c.unseen_at.time_s > 0.3 && c.unseen_at.time_s <= 1);
    check_near(c.unseen_at.at[0], 0.1, 1e-9);
    assert_false(td_clearance_verdict(words, sizeof words, &c, l.robot, &options));
    assert_non_null(strstr(words, "ball comes within reach of ground that is not known"));
    l.motion.site_from_vehicle.t[1] = 2.4; /* over the map's border */
    check_ok(td_clearance_check(&c, l.map, &l.motion, &options, &error), error);
    assert_true(c.unseen && c.unseen_at.at[1] > 2.5);
    free_lift(&l);
}

static void test_update(void **state)
{
    (void)state;
    td_elevation *ground = make_ground(203, 150, 0.05, 0, 0, 0.01);
    td_random random = td_random_seed(5, 0);
    roughen(ground, 5);
    td_clearance_map *map = make_map(ground);
    for (int trial = 0; trial < 40; trial++) {
        const int column = (int)td_random_below(&random, 203), row = (int)td_random_below(&random, 150);
        const int columns = 1 + (int)td_random_below(&random, 30),
                  rows = 1 + (int)td_random_below(&random, 30);
        for (int r = row; r < row + rows && r < 150; r++)
            for (int c = column; c < column + columns && c < 203; c++)
                ground->height[r * 203 + c] =
                    td_random_below(&random, 20) ? (float)random_between(&random, -1, 1) : NAN;
        check_ok(td_clearance_map_update(map, column, row, columns, rows, &error), error);
        td_clearance_map *anew = make_map(ground);
        for (int level = 0; level < map->levels; level++) {
            const size_t n = (size_t)map->width[level] * (size_t)map->height[level];
            assert_memory_equal(map->top[level], anew->top[level], n * sizeof(float));
            assert_memory_equal(map->hole[level], anew->hole[level], n);
        }
        td_clearance_map_free(&anew);
    }
    td_clearance_map_free(&map);
    td_elevation_free(&ground);
}

/* ---- the integral ---- */

/* Contacts of a huge box far above one point of a plane: their gaps are the margins, linear in the errors. */
static double integral_of(clearance_margin *margin, const double *rows, size_t count, int common, int draws)
{
    double probability, sigma, left_out;
    clearance_contact contact[32] = {0};
    size_t chosen[96];
    int points;
    for (size_t i = 0; i < count; i++) {
        margin[i].common = rows + i * (size_t)common;
        margin[i].variance = 0;
        margin[i].up = 1;
        for (int k = 0; k < common; k++) margin[i].variance += margin[i].common[k] * margin[i].common[k];
    }
    const clearance_integral integral = {
        .count = count, .margin = margin, .common_count = common, .points = 96, .draws = draws, .seed = 1};
    const td_primitive box = {TD_PRIMITIVE_BOX, td_pose_identity(), {1000, 1000, 1000}};
    const td_pose pose = {{1, 0, 0, 0}, {0, 0, 500}};
    check_ok(clearance_choose(chosen, &points, &left_out, &integral, &error), error);
    for (int i = 0; i < points; i++) {
        contact[i].shape = clearance_place_shape(&box, 0, &pose);
        contact[i].p[2] = -margin[chosen[i]].mean;
        for (int k = 0; k < common; k++) contact[i].move[k][2] = margin[chosen[i]].common[k];
    }
    check_ok(clearance_integrate(&probability, &sigma, &integral, contact, chosen, points, 0, &error), error);
    print_message("%.4f +- %.4f of %d contacts\n", probability, sigma, points);
    return probability;
}

static void test_integral(void **state)
{
    (void)state;
    enum { MANY = 20 };
    clearance_margin margin[MANY] = {{0}};
    double rows[MANY * (MANY + 1)] = {0};
    /* Independent. */
    for (int i = 0; i < MANY; i++) {
        margin[i].mean = 2;
        rows[i * MANY + i] = 1.2;
    }
    check_near(integral_of(margin, rows, MANY, MANY, 20000), 1 - pow(below(2 / 1.2), MANY), 4e-3);
    /* All the same; one of them is nearer. */
    memset(rows, 0, sizeof rows);
    for (int i = 0; i < MANY; i++) rows[i] = 1.2;
    margin[7].mean = 1;
    check_near(integral_of(margin, rows, MANY, 1, 20000), below(-1 / 1.2), 1e-3);
    margin[7].mean = 2;
    /* Correlation 1/2 between means of 0: P(all positive) = 1 / (n + 1). */
    memset(rows, 0, sizeof rows);
    for (int i = 0; i < MANY; i++) {
        margin[i].mean = 0;
        rows[i * (MANY + 1)] = rows[i * (MANY + 1) + 1 + i] = 1;
    }
    check_near(integral_of(margin, rows, MANY, MANY + 1, 20000), 1 - 1.0 / (MANY + 1), 4e-3);
    /* Opposite: both positive in a band: Phi(a) + Phi(b) - 1. */
    const double two[2] = {1, -1};
    margin[0].mean = 1.5;
    margin[1].mean = 2;
    check_near(integral_of(margin, two, 2, 1, 20000), 2 - below(1.5) - below(2), 2e-3);
}

/* ---- what is refused ---- */

static void test_refused(void **state)
{
    (void)state;
    double time[] = {0, 1}, q[] = {1, 0.9}, covariance[36] = {0};
    lift l = make_lift(0.01, time, q, 2);
    td_clearance c;
    td_clearance_options options = td_clearance_options_default();
    time[1] = 0;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "sample 2 of the motion is at 0 s");
    time[1] = 1;
    q[1] = NAN;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "joint 'lift' of sample 2");
    q[1] = 0.9;
    covariance[0] = -1;
    l.motion.map_covariance = covariance;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "negative eigenvalue");
    covariance[0] = 1;
    covariance[1] = 0.1;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "map_covariance: element");
    l.motion.map_covariance = NULL;
    const td_clearance_allowed allowed = {5, 0, 1};
    l.motion.allowed = &allowed;
    l.motion.allowed_count = 1;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "allowed contact 1");
    l.motion.allowed_count = 0;
    l.motion.count = 0;
    check_fails(td_clearance_check(&c, l.map, &l.motion, NULL, &error), TD_ERROR_ARGUMENT, error,
                "0 samples");
    l.motion.count = 2;
    options.step_m = -1;
    check_fails(td_clearance_check(&c, l.map, &l.motion, &options, &error), TD_ERROR_ARGUMENT, error,
                "step_m");
    options.step_m = 1e-9;
    check_fails(td_clearance_check(&c, l.map, &l.motion, &options, &error), TD_ERROR_ARGUMENT, error,
                "more than 10000000 samples");
    l.ground->sigma[7] = NAN;
    td_clearance_map *map = NULL;
    check_fails(td_clearance_map_new(&map, l.ground, NAN, &error), TD_ERROR_DATA, error, "cell (7, 0)");
    assert_null(map);
    check_ok(td_clearance_map_new(&map, l.ground, 0.05, &error), error);
    td_clearance_map_free(&map);
    free_lift(&l);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_distance), cmocka_unit_test(test_lift),     cmocka_unit_test(test_corner),
        cmocka_unit_test(test_readings), cmocka_unit_test(test_allowed),  cmocka_unit_test(test_unseen),
        cmocka_unit_test(test_update),   cmocka_unit_test(test_integral), cmocka_unit_test(test_refused)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
