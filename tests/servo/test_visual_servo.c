/* The visual servo: its law beside ViSP's, and arms that it brings home.
 *
 * Law. Against vpServo called directly, on the same features drawn at random: eye in hand and eye to hand in
 * ViSP's five forms, points and poses, all three interaction matrices, adaptive gain: 1e-12 of the largest
 * rate (the two invert the same matrix by other methods; its condition is kept below 100). The free camera of
 * ViSP's tutorial needs no more steps than ViSP itself, run here, and than its published figures. The second
 * task against ViSP's where one joint is near a limit (with more, ViSP counts a joint twice that cannot be
 * turned). Derivatives against central differences, 1e-7.
 *
 * Arms. 200 starts each, drawn from the joints' ranges around a goal drawn too, in kinematic simulation with
 * the machine's lag and points that leave the image unseen: at least 95 % end converged, which here is
 * 0.3 px in what the arm controls; limits of place, speed and acceleration hold at every step. Blind to
 * images, masses and oil. */
#include "tests/check.h"

#include "core/random.h"
#include "servo/visual_servo_internal.h"
#include "tests/servo/servo_robots.h"
#include "tests/servo/visual_scene.h"
#include "tests/servo/visual_servo_visp.h"

enum { STARTS = 200 };
static const double PI = 3.14159265358979323846;

/* ---- the free camera ---- */

static td_pose tutorial_start(void)
{
    /* ViSP's vpThetaUVector is the rotation vector. */
    return pose_at(0.15, -0.1, 1, 10 * PI / 180, -10 * PI / 180, 50 * PI / 180);
}

/* Steps until |e| < tolerance, as in the tutorial; -1: never. */
static int own_tutorial(double zero, double infinity, double slope, double tolerance, td_servo_law law)
{
    scene s = {.eye = {.camera = {.model = TD_CAMERA_PINHOLE,
                                  .width = 640,
                                  .height = 480,
                                  .parameter = {600, 600, 320, 240}}}};
    td_pose there = pose_at(0, 0, 0.75, 0, 0, 0), at = tutorial_start();
    td_visual_servo_options o = td_visual_servo_options_default();
    td_visual_servo servo;
    td_servo_report r;
    td_error error = {0};
    square_target(&s, 0.1);
    const td_servo_sight goal = view_from(&s, &there, NULL);
    o.gain_zero = zero, o.gain_infinity = infinity, o.gain_slope = slope, o.law = law;
    o.limits.period_s = 0.04, o.tolerance_px = 1e-9;
    check_ok(td_visual_servo_start(&servo, &s.eye, &goal, &o, &error), error);
    int i = 0;
    for (; i < 1000; i++) {
        const td_servo_sight sight = view_from(&s, &at, NULL);
        double square = 0, back[6];
        for (int k = 0; k < 4; k++)
            for (int j = 0; j < 2; j++)
                square += pow((sight.point[k].pixel[j] - goal.point[k].pixel[j]) / 600, 2);
        if (sqrt(square) < tolerance) break;
        check_ok(td_visual_servo_step(&r, &servo, &sight, NULL, &error), error);
        for (int k = 0; k < 6; k++) back[k] = -0.04 * r.twist[k];
        at = td_pose_perturb(&at, back);
    }
    td_visual_servo_end(&servo);
    return i;
}

static void test_tutorial(void **unused)
{
    (void)unused;
    const double adaptive[3] = {4, 0.4, 30}, constant[3] = {0.5, 0.5, 0}, tolerance[2] = {1e-3, 1e-6};
    const int figure[2][2] = {{104, 144}, {305, 647}};
    for (int i = 0; i < 2; i++)
        for (int t = 0; t < 2; t++) {
            const double *g = i == 0 ? adaptive : constant;
            const int own = own_tutorial(g[0], g[1], g[2], tolerance[t], TD_SERVO_LAW_OWN),
                      theirs = visp_tutorial(g, tolerance[t]);
            print_message("gain %g to %g, |e| < %g: %d steps, ViSP %d\n", g[0], g[1], tolerance[t], own,
                          theirs);
            assert_true(own >= 0 && own <= figure[i][t] && own == theirs);
        }
    assert_int_equal(own_tutorial(4, 0.4, 30, 1e-3, TD_SERVO_LAW_VISP),
                     own_tutorial(4, 0.4, 30, 1e-3, TD_SERVO_LAW_OWN));
}

/* ---- arms ---- */

/* On the last link, looking along its x axis, its image's down along -z. */
static td_pose looking_ahead(double x, double z)
{
    const double r[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, t[3] = {x, 0, z};
    return td_pose_from_rotation(r, t);
}

static void check_limits(const td_robot *robot, const td_motion_limits *l, const td_plant_state *state,
                         const double *rate, const double *last)
{
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        check_less(fabs(rate[k]), j->speed * l->speed_share * (1 + 1e-12));
        check_less(fabs(rate[k] - last[k]),
                   j->acceleration * l->acceleration_share * l->period_s * (1 + 1e-9));
        assert_true(state->q[k] >= j->lower && state->q[k] <= j->upper);
    }
}

/* Until it is over; what is hidden from `hide_s` on for `hidden_s` is not seen. */
static td_servo_report drive(td_visual_servo *servo, const scene *s, td_plant_state *state, double hide_s,
                             double hidden_s)
{
    td_servo_report r = {0};
    td_error error = {0};
    const td_motion_limits *l = &servo->options.limits;
    double last[TD_ROBOT_MAX_JOINTS] = {0};
    while (r.phase <= TD_SERVO_HOLDING) {
        td_servo_sight sight = view_at(s, state->q, NULL);
        sight.kind = servo->goal.kind;
        if (state->time_s >= hide_s && state->time_s < hide_s + hidden_s) {
            sight.pose_seen = false;
            for (int i = 0; i < sight.count; i++) sight.point[i].seen = false;
        }
        check_ok(td_visual_servo_step(&r, servo, &sight, state, &error), error);
        check_limits(s->eye.robot, l, state, r.command.value, last);
        memcpy(last, r.command.value, sizeof last);
        pass_period(state, s->eye.robot, r.command.value, l->period_s, l->lag_s);
    }
    return r;
}

typedef struct trial {
    const char *name;
    double around;        /* of each joint's range: the start's distance from the goal */
    double near_m, far_m; /* of the target, where the camera is on the hand */
    double tilt;
    td_servo_kind kind;
} trial;

/* A goal, a target it sees, and a start that sees it: false where these draws do not. */
static bool draw_scene(scene *s, double *goal, double *start, const trial *t, bool place, td_random *random)
{
    const td_robot *robot = s->eye.robot;
    const double inside = 0.05;
    draw_joints(goal, robot, NULL, 1, random);
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        if (!isfinite(j->lower)) goal[k] = PI * (2 * td_random_uniform(random) - 1);
        if (goal[k] < j->lower + inside || goal[k] > j->upper - inside) return false;
        const double width = isfinite(j->lower) ? j->upper - j->lower : 2;
        start[k] = goal[k] + t->around * width * (2 * td_random_uniform(random) - 1);
        if (start[k] < j->lower + inside || start[k] > j->upper - inside) return false;
    }
    if (place) {
        const double depth = t->near_m + (t->far_m - t->near_m) * td_random_uniform(random);
        const td_pose from = pose_at(0.2 * depth * (2 * td_random_uniform(random) - 1),
                                     0.15 * depth * (2 * td_random_uniform(random) - 1), depth,
                                     t->tilt * td_random_normal(random), t->tilt * td_random_normal(random),
                                     PI * td_random_uniform(random));
        td_pose at[TD_ROBOT_MAX_LINKS];
        td_robot_forward(at, robot, goal);
        const td_pose camera = td_pose_compose(at + s->eye.camera_link, &s->eye.link_from_camera);
        s->link_from_target = td_pose_compose(&camera, &from);
    }
    const td_servo_sight a = view_at(s, goal, NULL), b = view_at(s, start, NULL);
    return whole_in_view(&a, 0.3 * t->near_m, 20, &s->eye.camera) &&
           whole_in_view(&b, 0.3 * t->near_m, 20, &s->eye.camera);
}

static void run_trials(scene *s, const trial *t, bool place)
{
    td_random random = td_random_seed(7, 1);
    int ended[TD_SERVO_PHASES] = {0}, draws = 0;
    double worst_px = 0, longest_s = 0, share[6] = {0};
    for (int i = 0; i < STARTS; i++) {
        double goal[TD_ROBOT_MAX_JOINTS];
        td_plant_state state = {0};
        do {
            draws++;
            assert_true(draws < 10000000);
        } while (!draw_scene(s, goal, state.q, t, place, &random));
        td_visual_servo servo;
        td_error error = {0};
        td_servo_sight wanted = view_at(s, goal, NULL);
        wanted.kind = t->kind;
        check_ok(td_visual_servo_start(&servo, &s->eye, &wanted, NULL, &error), error);
        const td_servo_report r = drive(&servo, s, &state, INFINITY, 0);
        ended[r.phase]++;
        if (r.phase != TD_SERVO_CONVERGED) {
            if (getenv("V"))
                print_message("  %d: %s: %s whole %g controlled %g t %g\n", i, td_servo_phase_name(r.phase),
                              r.reason, r.whole.px, r.controlled.px, state.time_s);
            continue;
        }
        worst_px = fmax(worst_px, r.controlled.px);
        longest_s = fmax(longest_s, state.time_s);
        memcpy(share, r.share, sizeof share);
    }
    print_message("%s: %d of %d converged, worst %.2f px, longest %.1f s; controls rx %.2f ry %.2f rz %.2f "
                  "tx %.2f ty %.2f tz %.2f;",
                  t->name, ended[TD_SERVO_CONVERGED], STARTS, worst_px, longest_s, share[0], share[1],
                  share[2], share[3], share[4], share[5]);
    for (int p = TD_SERVO_CONVERGED + 1; p < TD_SERVO_PHASES; p++)
        if (ended[p]) print_message(" %d %s", ended[p], td_servo_phase_name((td_servo_phase)p));
    print_message(" (%d draws)\n", draws);
    assert_true(ended[TD_SERVO_CONVERGED] >= 0.95 * STARTS);
    check_less(worst_px, 0.3 + 1e-12);
}

static void test_six_joints(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = td_robot_find_link(robot, "tool"),
                       .link_from_camera = looking_ahead(0.05, 0.06)}};
    square_target(&s, 0.08);
    run_trials(
        &s, &(trial){.name = "six joints, points", .around = 0.1, .near_m = 0.4, .far_m = 0.8, .tilt = 0.3},
        true);
    run_trials(&s,
               &(trial){.name = "six joints, pose",
                        .around = 0.1,
                        .near_m = 0.4,
                        .far_m = 0.8,
                        .tilt = 0.3,
                        .kind = TD_SERVO_POSE},
               true);
    td_robot_free(&robot);
}

static void test_excavator(void **unused)
{
    (void)unused;
    td_robot *robot = excavator();
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = td_robot_find_link(robot, "bucket"),
                       .link_from_camera = looking_ahead(0.3, 0.8)}};
    square_target(&s, 0.5);
    run_trials(
        &s, &(trial){.name = "excavator, eye in hand", .around = 0.1, .near_m = 3, .far_m = 6, .tilt = 0.3},
        true);
    run_trials(&s,
               &(trial){.name = "excavator, eye in hand, pose",
                        .around = 0.1,
                        .near_m = 3,
                        .far_m = 6,
                        .tilt = 0.3,
                        .kind = TD_SERVO_POSE},
               true);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tutorial),
        cmocka_unit_test(test_six_joints),
        cmocka_unit_test(test_excavator),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
