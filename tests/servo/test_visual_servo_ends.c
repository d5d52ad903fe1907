/* How a visual servo ends, and what it says: each outcome is brought about on purpose.
 *
 * Hidden for 1 s the arm brakes within its limits, rests, says why, and goes on to the goal; for longer than
 * loss_s it stops for good. Out of reach, a goal that the arm meets only in part, a wrong hand-eye transform
 * (turned by 180 degrees: it diverges), a local minimum of points, lateness: named. Features that are no
 * numbers, too few, behind the camera, of another number: one sentence that names the point, a command that
 * brakes, and the servo goes on with the next good view. Every bad goal and option is refused by name.
 *
 * Blind to what a real detector does when it half sees a target. */
#include "tests/check.h"

#include "tests/servo/servo_robots.h"
#include "tests/servo/visual_scene.h"

static td_pose looking_ahead(double x, double z)
{
    const double r[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, t[3] = {x, 0, z};
    return td_pose_from_rotation(r, t);
}

/* Six joints, a target 0.6 m before the camera where the arm is at `home`. */
static const double HOME[6] = {0.2, 0.3, 0.9, 0.1, 0.5, 0.2}, START[6] = {0.35, 0.2, 1.1, 0.2, 0.35, 0.1};

static scene bench_scene(td_robot *robot, const double *home, double away_m)
{
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = robot->link_count - 1,
                       .link_from_camera = looking_ahead(0.05, 0.06)}};
    td_pose at[TD_ROBOT_MAX_LINKS];
    const td_pose from = pose_at(0.03, -0.02, away_m, 0.2, -0.1, 0.3);
    td_robot_forward(at, robot, home);
    const td_pose camera = td_pose_compose(at + s.eye.camera_link, &s.eye.link_from_camera);
    s.link_from_target = td_pose_compose(&camera, &from);
    square_target(&s, 0.1);
    return s;
}

typedef struct run {
    scene s;
    td_visual_servo servo;
    td_plant_state state;
    td_servo_report report;
    td_error error;
} run;

static void start(run *r, const scene *s, const td_servo_sight *goal, const double *q,
                  const td_visual_servo_options *options)
{
    memset(r, 0, sizeof *r);
    r->s = *s;
    memcpy(r->state.q, q, (size_t)s->eye.robot->joint_count * sizeof *q);
    check_ok(td_visual_servo_start(&r->servo, &s->eye, goal, options, &r->error), r->error);
}

/* A period with what the scene shows, or nothing. */
static void go(run *r, bool hidden)
{
    td_servo_sight sight = view_at(&r->s, r->state.q, NULL);
    sight.kind = r->servo.goal.kind;
    sight.pose_seen = !hidden;
    for (int i = 0; i < sight.count && hidden; i++) sight.point[i].seen = false;
    check_ok(td_visual_servo_step(&r->report, &r->servo, &sight, &r->state, &r->error), r->error);
    pass_period(&r->state, r->s.eye.robot, r->report.command.value, 0.02, 0.05);
}

static void go_to_end(run *r)
{
    while (r->report.phase <= TD_SERVO_HOLDING) go(r, false);
    print_message("%.1f s: %s: %s\n", r->state.time_s, td_servo_phase_name(r->report.phase),
                  r->report.reason);
}

static double fastest(const run *r)
{
    double most = 0;
    for (int k = 0; k < r->s.eye.robot->joint_count; k++) most = fmax(most, fabs(r->state.dq[k]));
    return most;
}

static void test_hidden(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    for (int kind = 0; kind < 2; kind++) {
        const scene s = bench_scene(robot, HOME, 0.6);
        run r;
        td_servo_sight goal = view_at(&s, HOME, NULL);
        goal.kind = (td_servo_kind)kind;
        start(&r, &s, &goal, START, NULL);
        for (int i = 0; i < 40; i++) go(&r, false);
        assert_int_equal(r.report.phase, TD_SERVO_MOVING);
        assert_true(fastest(&r) > 0.02);
        for (int i = 0; i < 50; i++) {
            go(&r, true);
            assert_int_equal(r.report.phase, TD_SERVO_HOLDING);
            assert_non_null(strstr(r.report.reason, "sight"));
        }
        check_less(fastest(&r), 1e-6);
        double held[6];
        memcpy(held, r.state.q, sizeof held);
        go(&r, false);
        assert_int_equal(r.report.phase, TD_SERVO_MOVING);
        go_to_end(&r);
        assert_int_equal(r.report.phase, TD_SERVO_CONVERGED);
        for (int k = 0; k < 6; k++) check_near(r.state.q[k], HOME[k], kind ? 3e-3 : 3e-2);

        start(&r, &s, &goal, START, NULL);
        for (int i = 0; i < 20; i++) go(&r, false);
        while (r.report.phase <= TD_SERVO_HOLDING) go(&r, true);
        assert_int_equal(r.report.phase, TD_SERVO_LOST);
        check_near(r.state.time_s, 0.4 + 5, 0.05);
        assert_non_null(strstr(r.report.reason, "5 s"));
        for (int i = 0; i < 50; i++) go(&r, false); /* it stays */
        assert_int_equal(r.report.phase, TD_SERVO_LOST);
        check_less(fastest(&r), 1e-6);
    }
    td_robot_free(&robot);
}

/* Two of four points, then three: with three it goes on. */
static void test_points_missing(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    const scene s = bench_scene(robot, HOME, 0.6);
    run r;
    const td_servo_sight goal = view_at(&s, HOME, NULL);
    start(&r, &s, &goal, START, NULL);
    td_servo_sight sight = view_at(&s, START, NULL);
    sight.point[1].seen = sight.point[3].seen = false;
    check_ok(td_visual_servo_step(&r.report, &r.servo, &sight, &r.state, &r.error), r.error);
    assert_int_equal(r.report.phase, TD_SERVO_HOLDING);
    assert_non_null(strstr(r.report.reason, "2 of 4 points"));
    for (int k = 0; k < 6; k++) check_near(r.report.command.value[k], 0, 0);
    sight.point[3].seen = true;
    check_ok(td_visual_servo_step(&r.report, &r.servo, &sight, &r.state, &r.error), r.error);
    assert_int_equal(r.report.phase, TD_SERVO_MOVING);
    td_robot_free(&robot);
}

/* The goal is where the arm would have to be with a joint beyond its stop. */
static void test_unreachable(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    double beyond[6];
    run r;
    memcpy(beyond, HOME, sizeof beyond);
    beyond[2] = robot->joint[2].upper + 0.15;
    double near[6];
    memcpy(near, beyond, sizeof near);
    near[2] -= 0.2;
    scene s = bench_scene(robot, beyond, 1.5);
    const td_servo_sight goal = view_at(&s, beyond, NULL);
    start(&r, &s, &goal, near, NULL);
    go_to_end(&r);
    assert_int_equal(r.report.phase, TD_SERVO_UNREACHABLE);
    assert_non_null(strstr(r.report.reason, "third"));
    for (int k = 0; k < 6; k++) assert_true(fabs(r.state.q[k]) <= robot->joint[k].upper);

    /* And so far that the arm is stretched out: the target has gone 2 m on. */
    s = bench_scene(robot, HOME, 0.6);
    const td_servo_sight close = view_at(&s, HOME, NULL);
    s = bench_scene(robot, HOME, 2.6);
    start(&r, &s, &close, HOME, NULL);
    go_to_end(&r);
    assert_int_equal(r.report.phase, TD_SERVO_UNREACHABLE);
    assert_non_null(strstr(r.report.reason, "singular"));
    check_less(fastest(&r), 0.1); /* and it does not swing through the stretched elbow */
    td_robot_free(&robot);
}

/* The goal shows the target turned about an axis about which the excavator's arm does not turn. */
static void test_reduced(void **unused)
{
    (void)unused;
    static const double home[4] = {0.3, -0.3, 1.5, 0.9}, from[4] = {0.2, -0.4, 1.7, 0.8};
    td_robot *robot = excavator();
    scene s = bench_scene(robot, home, 4);
    run r;
    td_pose turned = camera_from_target(&s, home);
    const double twist[6] = {0, 0.15, 0, 0, 0, 0};
    turned = td_pose_perturb(&turned, twist);
    square_target(&s, 0.5);
    td_servo_sight goal = view_from(&s, &turned, NULL);
    goal.kind = TD_SERVO_POSE;
    start(&r, &s, &goal, from, NULL);
    go_to_end(&r);
    assert_int_equal(r.report.phase, TD_SERVO_REDUCED);
    assert_int_equal(r.report.freedoms, 4);
    check_less(r.report.controlled.m, 1e-3);
    assert_true(r.report.rest.rad > 0.01 && r.report.rest.rad < 0.15);
    check_less(r.report.share[2], 0.9);
    check_near(r.report.share[0], 1, 1e-9); /* the planar joints turn about the camera's x axis */
    assert_non_null(strstr(r.report.reason, "4 dimensions"));
    td_robot_free(&robot);
}

static void test_diverges(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    const scene s = bench_scene(robot, HOME, 0.6);
    run r;
    td_servo_sight goal = view_at(&s, HOME, NULL);
    start(&r, &s, &goal, START, NULL);
    const td_pose about_z = pose_at(0, 0, 0, 0, 0, 3.14159265358979323846);
    r.servo.eye.link_from_camera = td_pose_compose(&s.eye.link_from_camera, &about_z);
    for (int i = 0; i < 1000 && r.report.phase <= TD_SERVO_HOLDING; i++) {
        const td_pose pose = camera_from_target(&s, r.state.q);
        td_servo_sight sight = view_from(&s, &pose, NULL);
        for (int k = 0; k < 4; k++) sight.point[k].seen = true; /* a wide camera */
        check_ok(td_visual_servo_step(&r.report, &r.servo, &sight, &r.state, &r.error), r.error);
        pass_period(&r.state, robot, r.report.command.value, 0.02, 0.05);
    }
    print_message("%.1f s: %s: %s\n", r.state.time_s, td_servo_phase_name(r.report.phase), r.report.reason);
    assert_int_equal(r.report.phase, TD_SERVO_DIVERGED);
    assert_non_null(strstr(r.report.reason, "hand-eye"));
    td_robot_free(&robot);
}

/* Oil, when it is asked for: what the rates need of it. */
static void test_flows(void **unused)
{
    (void)unused;
    static const double home[4] = {0.3, -0.3, 1.5, 0.9}, from[4] = {0.2, -0.4, 1.7, 0.8};
    td_robot *robot = excavator();
    scene s = bench_scene(robot, home, 4);
    td_plant_command flows;
    run r;
    td_visual_servo_options o = td_visual_servo_options_default();
    o.command = TD_COMMAND_FLOW;
    const td_servo_sight goal = view_at(&s, home, NULL), here = view_at(&s, from, NULL);
    start(&r, &s, &goal, from, &o);
    for (int i = 0; i < 5; i++)
        check_ok(td_visual_servo_step(&r.report, &r.servo, &here, &r.state, &r.error), r.error);
    assert_int_equal(r.report.command.kind, TD_COMMAND_FLOW);
    assert_true(td_rates_command(&flows, TD_COMMAND_FLOW, robot, from, r.servo.rate));
    for (int k = 0; k < 4; k++) {
        check_near(r.report.command.value[k], flows.value[k], 0);
        assert_true(k == 0 || fabs(flows.value[k]) < 0.1 * fabs(r.servo.rate[k]));
    }
    td_robot_free(&robot);
}

static void test_late(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    const scene s = bench_scene(robot, HOME, 0.6);
    run r;
    td_visual_servo_options o = td_visual_servo_options_default();
    o.limit_s = 1;
    const td_servo_sight goal = view_at(&s, HOME, NULL);
    start(&r, &s, &goal, START, &o);
    go_to_end(&r);
    assert_int_equal(r.report.phase, TD_SERVO_LATE);
    check_near(r.state.time_s, 1, 0.05);
    td_robot_free(&robot);
}

/* Each view is bad in one way; the arm brakes, and goes on when the next is good. */
static void test_bad_views(void **unused)
{
    (void)unused;
    static const char *const words[] = {"point 2 of the view is no number",
                                        "point 1 of the view is no number",
                                        "point 0 of the view lies behind the camera",
                                        "point 3 of the view has no depth",
                                        "3 points instead of 4",
                                        "other features",
                                        "joint's angle is no number"};
    td_robot *robot = six_joints();
    const scene s = bench_scene(robot, HOME, 0.6);
    run r;
    const td_servo_sight goal = view_at(&s, HOME, NULL);
    start(&r, &s, &goal, START, NULL);
    for (int i = 0; i < 7; i++) {
        for (int k = 0; k < 30; k++) go(&r, false);
        double last[6], most = 0;
        memcpy(last, r.report.command.value, sizeof last);
        td_servo_sight sight = view_at(&s, r.state.q, NULL);
        td_plant_state state = r.state;
        if (i == 0) sight.point[2].pixel[1] = NAN;
        if (i == 1) sight.point[1].depth_m = INFINITY;
        if (i == 2) sight.point[0].depth_m = -0.4;
        if (i == 3) sight.point[3].depth_m = 0;
        if (i == 4) sight.count = 3;
        if (i == 5) sight.kind = TD_SERVO_POSE;
        if (i == 6) state.q[2] = NAN;
        assert_int_not_equal(td_visual_servo_step(&r.report, &r.servo, &sight, &state, &r.error), TD_OK);
        if (!strstr(r.error.message, words[i])) fail_msg("'%s' lacks '%s'", r.error.message, words[i]);
        for (int k = 0; k < 6; k++) {
            assert_true(fabs(r.report.command.value[k]) <= fabs(last[k]));
            most = fmax(most, fabs(last[k]) - fabs(r.report.command.value[k]));
        }
        assert_true(most > 0);
        pass_period(&r.state, robot, r.report.command.value, 0.02, 0.05);
        go(&r, false);
        assert_int_equal(r.report.phase, TD_SERVO_MOVING);
    }
    go_to_end(&r);
    assert_int_equal(r.report.phase, TD_SERVO_CONVERGED);
    td_robot_free(&robot);
}

static void test_bad_goals(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    const scene s = bench_scene(robot, HOME, 0.6);
    const td_servo_sight good = view_at(&s, HOME, NULL);
    td_servo_sight bad = good;
    td_servo_eye eye = s.eye;
    td_visual_servo servo;
    td_error error = {0};
#define REFUSED(options, words)                                                                              \
    do {                                                                                                     \
        td_error e_ = {0};                                                                                   \
        assert_int_not_equal(td_visual_servo_start(&servo, &eye, &bad, options, &e_), TD_OK);                \
        if (!strstr(e_.message, words)) fail_msg("'%s' lacks '%s'", e_.message, words);                      \
    } while (0)
    bad.count = 2;
    REFUSED(NULL, "2 points");
    bad = good, bad.point[1].pixel[0] = NAN;
    REFUSED(NULL, "point 1 of the goal is no number");
    bad = good, bad.point[1].depth_m = 0;
    REFUSED(NULL, "point 1 of the goal has no depth");
    bad = good, bad.point[1].pixel[0] = 1e5, eye.camera.parameter[4] = -0.5, eye.camera.parameter[5] = 0;
    REFUSED(NULL, "no ray");
    eye = s.eye;
    bad = good, bad.kind = TD_SERVO_POSE, bad.camera_from_target.t[2] = -1;
    REFUSED(NULL, "behind the camera");
    bad.camera_from_target.q[0] = 3;
    REFUSED(NULL, "no pose");
    bad = good, eye.camera_link = 99;
    REFUSED(NULL, "no link 99");
    eye.camera_link = eye.target_link = 3;
    REFUSED(NULL, "no joint of robot 'six' moves");
    eye = s.eye;
    const td_visual_servo_options usual = td_visual_servo_options_default();
    td_visual_servo_options o = usual;
    o.gain_zero = 300, o.limits.lag_s = 0.2;
    REFUSED(&o, "not stable");
    o = usual, o.gain_infinity = 2;
    REFUSED(&o, "gain at infinity");
    o = usual, o.limits.period_s = NAN;
    REFUSED(&o, "period");
    o = usual, o.command = TD_COMMAND_FORCE;
    REFUSED(&o, "rates or flows");
    o = usual, o.rho = 2;
    REFUSED(&o, "rho");
#undef REFUSED
    check_ok(td_visual_servo_start(&servo, &eye, &good, NULL, &error), error);
    td_robot_free(&robot);
}

/* The camera free, from a pose; how far it went away from the target meanwhile. */
static td_servo_report fly(double *farthest_m, td_pose there, td_pose at, td_servo_kind kind)
{
    scene s = {.eye = {.camera = lens()}};
    td_visual_servo servo;
    td_servo_report r = {0};
    td_error error = {0};
    td_visual_servo_options o = td_visual_servo_options_default();
    o.interaction = TD_INTERACTION_CURRENT;
    square_target(&s, 0.1);
    td_servo_sight goal = view_from(&s, &there, NULL);
    goal.kind = kind;
    check_ok(td_visual_servo_start(&servo, &s.eye, &goal, &o, &error), error);
    *farthest_m = 0;
    while (r.phase <= TD_SERVO_HOLDING) {
        td_servo_sight sight = view_from(&s, &at, NULL);
        double back[6];
        sight.kind = kind;
        if (td_visual_servo_step(&r, &servo, &sight, NULL, &error) != TD_OK) break;
        for (int k = 0; k < 6; k++) back[k] = -0.02 * r.twist[k];
        at = td_pose_perturb(&at, back);
        *farthest_m = fmax(*farthest_m, at.t[2]);
    }
    return r;
}

/* Half a turn about the optical axis: points come together and the camera retreats (Chaumette 1998), the
 * pose only turns. */
static void test_half_turn(void **unused)
{
    (void)unused;
    double farthest_m;
    td_servo_report r =
        fly(&farthest_m, pose_at(0, 0, 0.75, 0, 0, 0), pose_at(0, 0, 0.75, 0, 0, 3.13), TD_SERVO_POINTS);
    print_message("half a turn, points: %s, as far as %.1f m\n", td_servo_phase_name(r.phase), farthest_m);
    assert_true(farthest_m > 5);
    r = fly(&farthest_m, pose_at(0, 0, 0.75, 0, 0, 0), pose_at(0, 0, 0.75, 0, 0, 3.13), TD_SERVO_POSE);
    assert_int_equal(r.phase, TD_SERVO_CONVERGED);
    check_less(farthest_m, 0.76);
}

/* A plane looks nearly the same tilted either way: from one side the points' error has a minimum there. */
static void test_minimum(void **unused)
{
    (void)unused;
    const td_pose there = pose_at(0, 0, 0.8, 0.7, 0, 0), at = pose_at(0, 0, 0.8, -0.7, 0, 0);
    double farthest_m;
    td_servo_report r = fly(&farthest_m, there, at, TD_SERVO_POINTS);
    print_message("%s: %s\n", td_servo_phase_name(r.phase), r.reason);
    assert_int_equal(r.phase, TD_SERVO_MINIMUM);
    check_less(r.controlled.px, 0.3);
    assert_true(r.rest.px > 10 && r.whole.px > 10);
    r = fly(&farthest_m, there, at, TD_SERVO_POSE);
    assert_int_equal(r.phase, TD_SERVO_CONVERGED);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_hidden),      cmocka_unit_test(test_points_missing),
        cmocka_unit_test(test_unreachable), cmocka_unit_test(test_reduced),
        cmocka_unit_test(test_diverges),    cmocka_unit_test(test_late),
        cmocka_unit_test(test_flows),       cmocka_unit_test(test_bad_views),
        cmocka_unit_test(test_bad_goals),   cmocka_unit_test(test_half_turn),
        cmocka_unit_test(test_minimum),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
