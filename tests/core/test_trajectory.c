/* Proves of a trajectory: the quintic between knots (against polynomials written out), jumps of acceleration,
 * the ends; shares of limits (against looking 20000 times a second, and a flow from the cylinder's length by
 * finite differences); the table gives back the same bits and bytes, its hash is the file's, and bad tables
 * are named. Blind to: whether a machine could follow the motion. */
#include "tests/check.h"
#include "tests/scratch.h"

#include "core/file.h"
#include "core/random.h"
#include "core/trajectory.h"

static const char ARM[] =
    "<robot name='arm'><link name='a'/><link name='b'/><link name='c'/>"
    "<joint name='turn' type='revolute'><parent link='a'/><child link='b'/><axis xyz='0 0 1'/>"
    "<limit lower='-2' upper='1' velocity='1.5' effort='1'/></joint>"
    "<joint name='slide' type='prismatic'><parent link='b'/><child link='c'/><axis xyz='1 0 0'/>"
    "<limit lower='-1' upper='1' velocity='0.5' effort='1'/></joint></robot>";
static const char ARM_YAML[] = "teledimos: robot 1\njoints:\n  - {name: turn, acceleration_rad_s2: 4}\n"
                               "  - {name: slide, acceleration_m_s2: 2}\n";

static td_robot *arm(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_parse(&robot, ARM, sizeof ARM - 1, ARM_YAML, sizeof ARM_YAML - 1, "arm", &error),
             error);
    return robot;
}

/* Any knots: values up to 1. */
static td_trajectory *drawn(size_t count, int joints, uint64_t seed)
{
    td_random random = td_random_seed(seed, 1);
    td_trajectory *t = NULL;
    td_error error = {0};
    check_ok(td_trajectory_new(&t, joints, count, &error), error);
    for (size_t i = 0; i < count * (size_t)joints; i++) {
        t->q[i] = td_random_uniform(&random);
        t->dq[i] = 2 * td_random_uniform(&random) - 1;
        t->ddq[i] = 2 * td_random_uniform(&random) - 1;
    }
    for (size_t i = 1; i < count; i++) t->time_s[i] = t->time_s[i - 1] + 0.1 + td_random_uniform(&random);
    return t;
}

/* A polynomial of degree 5 is given back: 1e-12 is rounding at values of 10. */
static void the_quintic_gives_back_a_polynomial(void **state)
{
    (void)state;
    const double c[6] = {0.3, -1.2, 2.1, 0.7, -1.9, 0.4}, h = 1.7;
    for (double t = 0; t <= h; t += 0.05) {
        double end[2][3] = {{0}}, at[3], want[3] = {0};
        for (int p = 0; p < 6; p++) {
            const double x[3] = {0, h, t};
            for (int i = 0; i < 3; i++) {
                double *out = i < 2 ? end[i] : want;
                out[0] += c[p] * pow(x[i], p);
                if (p > 0) out[1] += c[p] * p * pow(x[i], p - 1);
                if (p > 1) out[2] += c[p] * p * (p - 1) * pow(x[i], p - 2);
            }
        }
        td_quintic(at, end[0], end[1], h, t);
        for (int i = 0; i < 3; i++) check_near(at[i], want[i], 1e-12);
    }
}

/* At its knots a motion has their values; in between rate and acceleration are its derivatives (central
 * differences: 1e-6 of their error), outside it stands. */
static void motion_is_continuous(void **state)
{
    (void)state;
    td_trajectory *t = drawn(12, 3, 4);
    double q[3], dq[3], ddq[3], before[3], after[3], slope[2][3];
    for (size_t i = 0; i < t->count; i++) {
        td_trajectory_at(q, dq, ddq, t, t->time_s[i]);
        for (size_t k = 0; k < 3; k++) {
            check_near(q[k], t->q[i * 3 + k], 1e-14);
            check_near(dq[k], t->dq[i * 3 + k], 1e-14);
            check_near(ddq[k], t->ddq[i * 3 + k], 1e-13);
        }
    }
    for (double time = 0.011; time < td_trajectory_duration(t); time += 0.0171) {
        td_trajectory_at(NULL, dq, ddq, t, time);
        td_trajectory_at(before, slope[0], NULL, t, time - 1e-5);
        td_trajectory_at(after, slope[1], NULL, t, time + 1e-5);
        for (size_t k = 0; k < 3; k++) {
            check_near((after[k] - before[k]) / 2e-5, dq[k], 1e-5);
            check_near((slope[1][k] - slope[0][k]) / 2e-5, ddq[k], 1e-2); /* a jerk may jump at a knot */
        }
    }
    td_trajectory_at(q, dq, ddq, t, -1);
    check_near(q[1], t->q[1], 0);
    check_near(dq[1], 0, 0);
    td_trajectory_at(q, dq, ddq, t, 1e3);
    check_near(q[2], t->q[11 * 3 + 2], 0);
    check_near(ddq[2], 0, 0);
    td_trajectory_free(&t);
}

/* Full acceleration, then full braking: two knots share the middle. */
static void acceleration_may_jump(void **state)
{
    (void)state;
    td_trajectory *t = NULL;
    td_error error = {0};
    double q = 0, dq = 0, ddq = 0;
    check_ok(td_trajectory_new(&t, 1, 4, &error), error);
    const double time[4] = {0, 1, 1, 2}, at[4] = {0, 1, 1, 2}, rate[4] = {0, 2, 2, 0},
                 change[4] = {2, 2, -2, -2};
    memcpy(t->time_s, time, sizeof time);
    memcpy(t->q, at, sizeof at);
    memcpy(t->dq, rate, sizeof rate);
    memcpy(t->ddq, change, sizeof change);
    td_trajectory_at(&q, &dq, &ddq, t, 1 - 1e-9);
    check_near(ddq, 2, 1e-6);
    td_trajectory_at(&q, &dq, &ddq, t, 1);
    check_near(ddq, -2, 0);
    td_trajectory_at(&q, &dq, &ddq, t, 1.5);
    check_near(q, 1.75, 1e-14);
    check_near(dq, 1, 1e-14);
    check_near(ddq, -2, 1e-13);
    td_trajectory_stretch(t, 2);
    td_trajectory_at(&q, &dq, &ddq, t, 3);
    check_near(td_trajectory_duration(t), 4, 0);
    check_near(q, 1.75, 1e-14);
    check_near(dq, 0.5, 1e-14);
    check_near(ddq, -0.5, 1e-13);
    td_trajectory_free(&t);
}

/* What is found where extremes are is no less than what looking often finds, and no more than 1e-4 above (20
 * kHz miss that little). */
static void shares_are_the_largest(void **state)
{
    (void)state;
    td_robot *robot = arm();
    td_error error = {0};
    for (uint64_t seed = 1; seed <= 5; seed++) {
        td_trajectory *t = drawn(8, 2, seed);
        td_trajectory_shares exact, often;
        check_ok(td_trajectory_check(&exact, t, robot, INFINITY, 0, &error), error);
        check_ok(td_trajectory_check(&often, t, robot, INFINITY, 20000, &error), error);
        check_near(exact.acceleration.share, often.acceleration.share, 1e-4 * often.acceleration.share);
        assert_true(exact.acceleration.share >= often.acceleration.share - 1e-12);
        check_near(exact.acceleration.time_s, often.acceleration.time_s, 1e-3);
        assert_int_equal(exact.acceleration.joint, often.acceleration.joint);
        check_near(exact.speed.share, often.speed.share, 0.02 * often.speed.share); /* by the secant */
        td_trajectory_free(&t);
    }
    td_trajectory *t = drawn(3, 2, 9);
    td_trajectory_shares shares;
    for (int i = 0; i < 6; i++) t->q[i] = t->dq[i] = t->ddq[i] = 0;
    t->q[2] = t->q[0] = t->q[4] = -2;
    check_ok(td_trajectory_check(&shares, t, robot, INFINITY, 100, &error), error);
    check_near(shares.position.share, 1, 1e-15); /* turn at its lower limit */
    assert_int_equal(shares.position.joint, 0);
    check_near(shares.flow.share, 0, 0);
    t->q[2] = NAN;
    check_fails(td_trajectory_check(&shares, t, robot, INFINITY, 100, &error), TD_ERROR_DATA, error,
                "no number");
    robot->joint_count = 1;
    check_fails(td_trajectory_check(&shares, t, robot, INFINITY, 0, &error), TD_ERROR_ARGUMENT, error,
                "2 joints");
    robot->joint_count = 2;
    check_fails(td_trajectory_check(&shares, t, robot, 0, 0, &error), TD_ERROR_ARGUMENT, error, "pumps");
    td_trajectory_free(&t);
    td_robot_free(&robot);
}

/* The flow is the area times how fast the length changes: 1e-6 is the central difference's error. The bore
 * fills while the cylinder grows, the annulus while it shrinks. */
static void flow_is_the_swept_volume(void **state)
{
    (void)state;
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    check_near(td_robot_pump(robot), 7.07e-3, 1e-12);
    for (int i = 0; i < robot->cylinder_count; i++)
        for (int side = -1; side <= 1; side += 2) {
            const td_cylinder *c = robot->cylinder + i;
            const td_robot_joint *j = robot->joint + c->joint;
            const double q = (j->lower + j->upper) / 2, rate = 0.3 * side, h = 1e-5;
            double flow = 0, length[2];
            assert_true(td_cylinder_flow(&flow, robot, c, q, rate));
            assert_true(td_cylinder_length(length, NULL, robot, c, q - h * rate));
            assert_true(td_cylinder_length(length + 1, NULL, robot, c, q + h * rate));
            const double speed = (length[1] - length[0]) / (2 * h), pi = 3.14159265358979323846;
            const double area =
                pi / 4 * (c->bore_m * c->bore_m - (speed < 0 ? c->rod_m * c->rod_m : 0)) * c->count;
            check_near(flow, area * speed, 1e-6 * fabs(flow));
        }
    td_robot_free(&robot);
}

static void a_table_gives_back_the_same(void **state)
{
    td_robot *robot = arm();
    td_trajectory *t = drawn(20, 2, 7), *back = NULL;
    td_error error = {0};
    char *path[2], hash[3][TD_HASH_HEX_SIZE], *bytes[2];
    size_t size[2];
    for (int i = 0; i < 2; i++) path[i] = td_path_join(*state, i ? "b.csv" : "a.csv");
    check_ok(td_trajectory_write(t, path[0], robot, &error), error);
    check_ok(td_trajectory_read(&back, path[0], robot, &error), error);
    check_ok(td_trajectory_write(back, path[1], robot, &error), error);
    for (int i = 0; i < 2; i++) check_ok(td_file_read(bytes + i, size + i, path[i], 1 << 20, &error), error);
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    assert_int_equal(
        strncmp(bytes[0], "time_s,turn_rad,turn_rad_s,turn_rad_s2,slide_m,slide_m_s,slide_m_s2\n0.0,", 71),
        0);
    assert_memory_equal(t->ddq, back->ddq, 40 * sizeof *t->ddq);
    assert_memory_equal(t->time_s, back->time_s, 20 * sizeof *t->time_s);
    check_ok(td_trajectory_hash(hash[0], t, robot, &error), error);
    check_ok(td_hash_file(hash[1], path[0], &error), error);
    assert_string_equal(hash[0], hash[1]);
    back->q[5] = nextafter(back->q[5], 1); /* the least change shows */
    check_ok(td_trajectory_hash(hash[2], back, robot, &error), error);
    assert_string_not_equal(hash[0], hash[2]);
    for (int i = 0; i < 2; i++) {
        free(bytes[i]);
        free(path[i]);
    }
    td_trajectory_free(&t);
    td_trajectory_free(&back);
    td_robot_free(&robot);
}

static void bad_tables_are_named(void **state)
{
    (void)state;
#define HEAD "time_s,turn_rad,turn_rad_s,turn_rad_s2,slide_m,slide_m_s,slide_m_s2\n"
    static const struct {
        const char *text, *words;
    } bad[] = {{"turn_rad\n1\n", "no column time_s"},
               {"time_s,turn_rad,turn_rad_s,turn_rad_s2,slide_m,slide_m_s\n0,0,0,0,0,0\n", "slide_m_s2"},
               {"x," HEAD "0,0,0,0,0,0,0,0\n", "8 columns"},
               {HEAD, "no rows"},
               {HEAD "1,0,0,0,0,0,0\n", "t.csv:2: column time_s: times begin at 0"},
               {HEAD "0,0,0,0,0,0,0\n2,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "t.csv:4: column time_s: times begin"},
               {HEAD "0,0,0,0,0,0,0\n1e-9,0,0,0,0,0,0\n", "1e-6 s apart"},
               {HEAD "0,0,0,0,0,0,0\n0,0,0.5,0,0,0,0\n", "t.csv:3: column turn_rad_s: it jumps"},
               {HEAD "0,0,0,0,0,nan,0\n", "t.csv:2: column slide_m_s"},
               {HEAD "0,0,0,0,0,,0\n", "t.csv:2: column slide_m_s"}};
    td_robot *robot = arm();
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_trajectory *t = NULL;
        td_error error = {0};
        check_fails(td_trajectory_parse(&t, bad[i].text, strlen(bad[i].text), "t.csv", robot, &error),
                    TD_ERROR_FORMAT, error, bad[i].words);
        assert_null(t);
    }
    td_trajectory *t = NULL;
    td_error error = {0};
    const char good[] = HEAD "0,0,0,0,0,0,0\n0,0,0,5,0,0,0\n";
    check_ok(td_trajectory_parse(&t, good, sizeof good - 1, "t.csv", robot, &error), error);
    td_trajectory_free(&t);
    check_fails(td_trajectory_new(&t, 0, 1, &error), TD_ERROR_ARGUMENT, error, "0 joints");
    check_fails(td_trajectory_new(&t, 1, 0, &error), TD_ERROR_ARGUMENT, error, "0 knots");
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_quintic_gives_back_a_polynomial),
        cmocka_unit_test(motion_is_continuous),
        cmocka_unit_test(acceleration_may_jump),
        cmocka_unit_test(shares_are_the_largest),
        cmocka_unit_test(flow_is_the_swept_volume),
        cmocka_unit_test_setup_teardown(a_table_gives_back_the_same, scratch_make, scratch_remove),
        cmocka_unit_test(bad_tables_are_named)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
