/* Limits of motion, and the two controllers that only pass through them: joints that follow, and the jog.
 *
 * The machine here is the lag that the controllers are told of, tau w' = v - w, solved exactly between
 * samples, so that nothing else is to blame. Stops: from 200 random starts the joint comes to the margin
 * before its stop within 1e-9 and not past it, and no rate jumps by more than the acceleration allows. Oil:
 * the flow that cylinders take, by lever and area, stays within the pumps' on random wishes to rounding. The
 * tool's jog: off its line by less than 1 % of the way (0.5 % is reached: while it starts and stops, joints
 * of different accelerations and the arm's turning within a period), attitude kept within 5 mrad. Following:
 * a step dies out with the pole that servo/lag.h gives for the gain, and nothing is left on a ramp.
 *
 * Blind to: masses and oil; tests/sim/test_press.c has them. */
#include "tests/check.h"

#include "core/random.h"
#include "servo/jog.h"
#include "servo/joint_controller.h"
#include "servo/lag.h"

#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

enum { SWING, BOOM, ARM, BUCKET, JOINTS };
static const double PERIOD_S = 0.02, LAG_S = 0.05;

static td_robot *zx200(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

/* A period of the machine. */
static void pass(td_plant_state *s, const double *v)
{
    const double rest = exp(-PERIOD_S / LAG_S);
    for (int k = 0; k < JOINTS; k++) {
        s->q[k] += v[k] * PERIOD_S + (s->dq[k] - v[k]) * LAG_S * (1 - rest);
        s->dq[k] = v[k] + (s->dq[k] - v[k]) * rest;
    }
    s->time_s += PERIOD_S;
}

/* Rates never jump by more than the acceleration allows, and never pass the limit of speed. */
static void check_rates(const td_robot *robot, const double *rate, const double *last)
{
    for (int k = 0; k < JOINTS; k++) {
        check_less(fabs(rate[k]), robot->joint[k].speed * (1 + 1e-12));
        check_less(fabs(rate[k] - last[k]), robot->joint[k].acceleration * PERIOD_S * (1 + 1e-9));
    }
}

static void test_stopping_speed(void **unused)
{
    (void)unused;
    check_near(td_stopping_speed(0, 1, 0.1), 0, 0);
    check_near(td_stopping_speed(-1, 1, 0.1), 0, 0);
    check_near(td_stopping_speed(0.005, 1, 0.1), 0.05, 1e-15);        /* within one period: there at once */
    check_near(td_stopping_speed(0.1 * 0.6, 1, 0.1), 0.3, 1e-12);     /* 0.3 + 0.2 + 0.1 */
    check_near(td_stopping_speed(1e6, 1, 1e-4), sqrt(2e6), 1e-3);     /* v^2 / 2a */
    check_near(td_stopping_speed(0.1 * 0.75, 1, 0.1), 0.3375, 1e-12); /* 0.3375 + 0.2375 + 0.1375 + 0.0375 */
}

static void test_stops(void **unused)
{
    td_robot *robot = zx200();
    td_random random;
    (void)unused;
    random = td_random_seed(7, 0);
    for (int i = 0; i < 200; i++) {
        td_jog jog;
        td_error error = {0};
        td_plant_command command;
        td_plant_state s = {0};
        const int k = 1 + i % 3, way = i % 2 ? 1 : -1;
        const td_robot_joint *j = robot->joint + k;
        for (int n = 0; n < JOINTS; n++) {
            const double low = fmax(robot->joint[n].lower, -3), high = fmin(robot->joint[n].upper, 3);
            s.q[n] = low + 0.03 + (high - low - 0.06) * td_random_uniform(&random);
        }
        check_ok(td_jog_start(&jog, robot, NULL, TD_COMMAND_RATE, &error), error);
        const td_jog_wish wish = {.kind = TD_JOG_JOINT, .joint = k, .stick = way};
        const double end = way > 0 ? j->upper - 0.02 : j->lower + 0.02;
        for (int n = 0; n < 1000; n++) {
            const double last[JOINTS] = {jog.rate[0], jog.rate[1], jog.rate[2], jog.rate[3]};
            check_ok(td_jog_step(&command, &jog, &wish, &s, &error), error);
            check_rates(robot, command.value, last);
            pass(&s, command.value);
            check_less(way * (s.q[k] - end), 1e-9);
        }
        check_near(s.q[k], end, 1e-9);
    }
    td_robot_free(&robot);
}

static void test_oil(void **unused)
{
    td_robot *robot = zx200();
    td_random random;
    td_plant_state s = {.q = {0, -0.3, 1.5, 0.8}};
    td_motion_limits limits = td_motion_limits_default();
    double last[JOINTS] = {0}, most = 0;
    int full = 0;
    (void)unused;
    random = td_random_seed(8, 0);
    limits.pump_m3_s = 5e-3;
    for (int i = 0; i < 3000; i++) {
        static double wish[JOINTS];
        double rate[JOINTS], flow = 0;
        if (i % 25 == 0)
            for (int k = 0; k < JOINTS; k++) wish[k] = 3 * td_random_uniform(&random) - 1.5;
        memcpy(rate, wish, sizeof rate);
        assert_true(td_motion_limits_apply(rate, &limits, robot, s.q, s.dq, last, i % 2000 > 1000));
        check_rates(robot, rate, last);
        for (int c = 0; c < robot->cylinder_count; c++) {
            double lever = 0;
            const td_cylinder *cylinder = robot->cylinder + c;
            const int k = cylinder->joint;
            assert_true(td_cylinder_length(NULL, &lever, robot, cylinder, s.q[k]));
            flow += fabs(lever * rate[k]) * td_cylinder_area(cylinder, lever * rate[k] > 0);
        }
        most = fmax(most, flow);
        full += flow > 0.98 * 5e-3;
        memcpy(last, rate, sizeof last);
        pass(&s, rate);
    }
    printf("the pumps give at most %.4f of their flow, all of it in %d of 3000 periods\n", most / 5e-3, full);
    check_less(most, 5e-3 * (1 + 1e-9));
    assert_true(full > 300);
    td_robot_free(&robot);
}

static void tip_of(double tip[3], double *pitch, const td_robot *robot, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    static const double ahead[3] = {1, 0, 0};
    double x[3];
    const int link = td_robot_find_link(robot, "bucket_tip");
    td_robot_forward(at, robot, q);
    memcpy(tip, at[link].t, 3 * sizeof *tip);
    td_pose_rotate(x, at + link, ahead);
    *pitch = atan2(-x[2], hypot(x[0], x[1]));
}

static void test_tool(void **unused)
{
    static const double ways[4][3] = {{-1, 0, 0}, {0, 0, 2}, {-1, 0, 1}, {0, 1, 0}};
    td_robot *robot = zx200();
    (void)unused;
    for (int w = 0; w < 4; w++) {
        td_jog jog;
        td_error error = {0};
        td_plant_command command;
        td_plant_state s = {.q = {0, -0.5, 1.5, 0.6}};
        double from[3], to[3], pitch[2], along = 0, across = 0;
        td_jog_wish wish = {.kind = TD_JOG_TOOL, .stick = 1, .speed_m_s = 0.3};
        const double length =
            sqrt(ways[w][0] * ways[w][0] + ways[w][1] * ways[w][1] + ways[w][2] * ways[w][2]);
        memcpy(wish.axis, ways[w], sizeof wish.axis);
        wish.link = td_robot_find_link(robot, "bucket_tip");
        check_ok(td_jog_start(&jog, robot, NULL, TD_COMMAND_RATE, &error), error);
        tip_of(from, pitch, robot, s.q);
        for (int i = 0; i < 150; i++) {
            const double last[JOINTS] = {jog.rate[0], jog.rate[1], jog.rate[2], jog.rate[3]};
            if (i == 120) wish.kind = TD_JOG_NOTHING;
            check_ok(td_jog_step(&command, &jog, &wish, &s, &error), error);
            check_rates(robot, command.value, last);
            pass(&s, command.value);
        }
        tip_of(to, pitch + 1, robot, s.q);
        for (int i = 0; i < 3; i++) along += (to[i] - from[i]) * ways[w][i] / length;
        for (int i = 0; i < 3; i++) across += pow(to[i] - from[i] - along * ways[w][i] / length, 2);
        printf("jog %d: %.3f m along, %.2f mm off, %.2f mrad turned\n", w, along, 1e3 * sqrt(across),
               1e3 * (pitch[1] - pitch[0]));
        check_less(0.55, along);
        check_less(sqrt(across), 0.01 * along);
        check_near(pitch[1], pitch[0], 5e-3);
        check_near(hypot(hypot(s.dq[0], s.dq[1]), hypot(s.dq[2], s.dq[3])), 0, 1e-3);
    }
    td_robot_free(&robot);
}

static void test_follow(void **unused)
{
    td_robot *robot = zx200();
    td_joint_controller c;
    td_error error = {0};
    td_plant_command command;
    td_plant_state s = {.q = {0, -0.5, 1.5, 0.6}};
    const double start[JOINTS] = {0, -0.5, 1.5, 0.6}, ramp[JOINTS] = {0.1, -0.05, 0.1, 0.2};
    double wanted[JOINTS], still[JOINTS] = {0};
    (void)unused;
    check_ok(td_joint_controller_start(&c, robot, NULL, &error), error);
    for (int k = 0; k < JOINTS; k++) wanted[k] = start[k] + 0.01;
    double before = 0;
    for (int i = 0; i < 150; i++) {
        check_ok(td_joint_controller_step(&command, &c, wanted, still, &s, &error), error);
        pass(&s, command.value);
        if (i == 99) before = wanted[BOOM] - s.q[BOOM];
    }
    /* The slower pole, by K = 3: of the loop that servo/lag.h gives. */
    const double rest = exp(-PERIOD_S / LAG_S), a = PERIOD_S - LAG_S * (1 - rest),
                 b = LAG_S * (1 - rest) - rest * PERIOD_S, trace = 1 + rest - 3 * a,
                 pole = (trace + sqrt(trace * trace - 4 * (rest + 3 * b))) / 2;
    for (int k = 0; k < JOINTS; k++) check_near(s.q[k], wanted[k], 1e-4);
    check_near((wanted[BOOM] - s.q[BOOM]) / before, pow(pole, 50), 0.02 * pow(pole, 50));

    /* On a ramp: what the lag leaves at its start dies out. */
    for (int i = 0; i < 300; i++) {
        for (int k = 0; k < JOINTS; k++) wanted[k] += ramp[k] * PERIOD_S;
        check_ok(td_joint_controller_step(&command, &c, wanted, ramp, &s, &error), error);
        pass(&s, command.value);
    }
    for (int k = 0; k < JOINTS; k++) {
        check_near(command.value[k], ramp[k], 1e-6);
        check_near(s.q[k], wanted[k] + ramp[k] * PERIOD_S, 1e-6);
    }
    td_robot_free(&robot);
}

static void test_flows(void **unused)
{
    td_robot *robot = zx200();
    td_plant_command command;
    const double q[JOINTS] = {0, -0.5, 1.5, 0.6}, rate[JOINTS] = {0.3, -0.1, 0.2, 0};
    double lever = 0;
    (void)unused;
    assert_true(td_rates_command(&command, TD_COMMAND_FLOW, robot, q, rate));
    check_near(command.value[SWING], 0.3, 0); /* a motor */
    assert_true(td_cylinder_length(NULL, &lever, robot, robot->cylinder, q[BOOM]));
    /* The boom rises (its angle falls) as its two cylinders grow: the bores are filled. */
    assert_true(lever < 0);
    check_near(command.value[BOOM], -0.1 * fabs(lever) * 2 * 3.14159265358979 / 4 * 0.12 * 0.12, 1e-12);
    assert_true(command.value[ARM] > 0 && command.value[BUCKET] == 0);
    assert_false(td_rates_command(&command, TD_COMMAND_FORCE, robot, q, rate));
    td_robot_free(&robot);
}

static void test_refusals(void **unused)
{
    td_robot *robot = zx200();
    td_error error = {0};
    td_joint_controller c;
    td_jog jog;
    td_plant_command command;
    td_plant_state s = {.q = {0, -0.5, 1.5, 0.6}};
    td_joint_controller_options o = td_joint_controller_options_default();
    td_motion_limits limits = td_motion_limits_default();
    (void)unused;
    o.gain_1_s = 110;
    check_fails(td_joint_controller_start(&c, robot, &o, &error), TD_ERROR_ARGUMENT, error,
                "between 0 and 107.1");
    o = td_joint_controller_options_default();
    o.kind = TD_COMMAND_FORCE;
    check_fails(td_joint_controller_start(&c, robot, &o, &error), TD_ERROR_ARGUMENT, error, "rates or flows");
    limits.speed_share = 1.1;
    check_fails(td_jog_start(&jog, robot, &limits, TD_COMMAND_RATE, &error), TD_ERROR_ARGUMENT, error,
                "the share of speed is 1.1");
    check_ok(td_jog_start(&jog, robot, NULL, TD_COMMAND_RATE, &error), error);

    /* What is wrong on the way brakes the joints, and says so. */
    td_jog_wish wish = {.kind = TD_JOG_JOINT, .joint = BOOM, .stick = 1};
    for (int i = 0; i < 10; i++) check_ok(td_jog_step(&command, &jog, &wish, &s, &error), error);
    const double fast = command.value[BOOM];
    s.q[ARM] = NAN;
    check_fails(td_jog_step(&command, &jog, &wish, &s, &error), TD_ERROR_ARGUMENT, error, "it brakes");
    check_near(command.value[BOOM], fast - 0.7 * PERIOD_S, 1e-12);
    s.q[ARM] = 1.5;
    wish.joint = 9;
    check_fails(td_jog_step(&command, &jog, &wish, &s, &error), TD_ERROR_ARGUMENT, error, "has no joint 9");
    check_near(command.value[BOOM], fast - 2 * 0.7 * PERIOD_S, 1e-12);
    wish = (td_jog_wish){.kind = TD_JOG_TOOL, .stick = 1, .link = 3};
    check_fails(td_jog_step(&command, &jog, &wish, &s, &error), TD_ERROR_ARGUMENT, error, "no length");
    robot->joint[ARM].acceleration = INFINITY;
    check_fails(td_jog_start(&jog, robot, NULL, TD_COMMAND_RATE, &error), TD_ERROR_ARGUMENT, error,
                "joint 'arm' has no limit");
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_stopping_speed), cmocka_unit_test(test_stops),  cmocka_unit_test(test_oil),
        cmocka_unit_test(test_tool),           cmocka_unit_test(test_follow), cmocka_unit_test(test_flows),
        cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
