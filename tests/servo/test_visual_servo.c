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

#include "core/linalg.h"
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
    o.limits.period_s = 0.04, o.tolerance_px = 1e-9, o.interaction = TD_INTERACTION_CURRENT;
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
    double worst_px = 0, worst_m = 0, longest_s = 0, share[6] = {0};
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
            if (getenv("TELEDIMOS_VERBOSE"))
                print_message("  %d: %s: %s whole %g controlled %g t %g\n", i, td_servo_phase_name(r.phase),
                              r.reason, r.whole.px, r.controlled.px, state.time_s);
            continue;
        }
        worst_px = fmax(worst_px, r.controlled.px), worst_m = fmax(worst_m, r.controlled.m);
        longest_s = fmax(longest_s, state.time_s);
        memcpy(share, r.share, sizeof share);
    }
    print_message(
        "%s: %d of %d converged, worst %.2f px, %.2f mm, longest %.1f s; controls rx %.2f ry %.2f rz %.2f "
        "tx %.2f ty %.2f tz %.2f;",
        t->name, ended[TD_SERVO_CONVERGED], STARTS, worst_px, 1e3 * worst_m, longest_s, share[0], share[1],
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
        &s, &(trial){.name = "six joints, points", .around = 0.2, .near_m = 0.4, .far_m = 0.8, .tilt = 0.3},
        true);
    run_trials(&s,
               &(trial){.name = "six joints, pose",
                        .around = 0.2,
                        .near_m = 0.4,
                        .far_m = 0.8,
                        .tilt = 0.3,
                        .kind = TD_SERVO_POSE},
               true);
    td_robot_free(&robot);
}

/* The camera stands 2.5 m before the arm and looks back at it; the target is on its tool. */
static void test_fixed_camera(void **unused)
{
    (void)unused;
    check_statistics();
    td_robot *robot = six_joints();
    const double r[9] = {0, 0, -1, 1, 0, 0, 0, -1, 0}, t[3] = {2.5, 0, 0.6};
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .target_link = td_robot_find_link(robot, "tool"),
                       .link_from_camera = td_pose_from_rotation(r, t)},
               .link_from_target = looking_ahead(0.1, 0)};
    square_target(&s, 0.2);
    run_trials(&s, &(trial){.name = "six joints, fixed camera", .around = 0.2, .near_m = 1}, false);
    td_robot_free(&robot);
}

static void test_excavator(void **unused)
{
    (void)unused;
    check_statistics();
    td_robot *robot = excavator();
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = td_robot_find_link(robot, "bucket"),
                       .link_from_camera = looking_ahead(0.3, 0.8)}};
    square_target(&s, 0.5);
    run_trials(&s, &(trial){.name = "excavator, points", .around = 0.3, .near_m = 3, .far_m = 6, .tilt = 0.3},
               true);
    run_trials(&s,
               &(trial){.name = "excavator, pose",
                        .around = 0.3,
                        .near_m = 3,
                        .far_m = 6,
                        .tilt = 0.3,
                        .kind = TD_SERVO_POSE},
               true);
    td_robot_free(&robot);
}

/* The camera on the cab, the target on the back of the bucket, which swings with it: three joints between. */
static void test_cab(void **unused)
{
    (void)unused;
    td_robot *robot = excavator();
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = td_robot_find_link(robot, "upper"),
                       .target_link = td_robot_find_link(robot, "bucket"),
                       .link_from_camera = looking_ahead(1, 1.8)},
               .link_from_target = pose_at(0.3, 0, 0.8, 0, 0, 0)};
    s.eye.camera.parameter[0] = s.eye.camera.parameter[1] = 400;
    square_target(&s, 0.4);
    run_trials(&s, &(trial){.name = "excavator, camera on the cab", .around = 0.3, .near_m = 3}, false);
    td_robot_free(&robot);
}

/* ---- the law ---- */

/* Where the condition of J is below 100, so that 1e-12 is rounding. */
static bool well_conditioned(const double *j, int rows, int n)
{
    td_task_inverse inverse;
    td_task_invert(&inverse, j, NULL, rows, n, NULL, &(td_task_damping){0.01, 0});
    return inverse.rank == (rows < n ? rows : n) && inverse.damped == 0;
}

static void reorder(double *theirs, const double *ours, int n)
{
    for (int i = 0; i < 6; i++) memcpy(theirs + i * n, ours + (i + 3) % 6 * n, (size_t)n * sizeof *ours);
}

/* Of both, from features drawn for q. */
static void draw_task(visp_task *t, td_servo_features *f, td_servo_eye *eye, const double *q, int mode,
                      td_random *random)
{
    const bool hand = mode == VISP_CAMERA || mode == VISP_HAND_cVe_eJe;
    const td_robot *robot = eye->robot;
    *t = (visp_task){.mode = mode,
                     .interaction = (int)f->interaction,
                     .pose = f->kind == TD_SERVO_POSE,
                     .points = f->count,
                     .joints = robot ? robot->joint_count : 6,
                     .gain = {2, 0.4, 5}};
    for (int i = 0; i < f->count; i++)
        for (int k = 0; k < 3; k++) {
            f->now[i][k] = t->now[i][k] =
                k < 2 ? td_random_uniform(random) - 0.5 : 0.5 + td_random_uniform(random);
            f->goal[i][k] = t->goal[i][k] =
                k < 2 ? td_random_uniform(random) - 0.5 : 0.5 + td_random_uniform(random);
        }
    f->goal_from_camera =
        pose_at(td_random_normal(random), td_random_normal(random), td_random_normal(random),
                td_random_normal(random), 0.5 * td_random_normal(random), td_random_normal(random));
    td_pose_matrix(t->goal_from_camera, &f->goal_from_camera);
    if (!robot) return;
    const int link = hand ? eye->camera_link : eye->target_link, n = robot->joint_count;
    td_pose at[TD_ROBOT_MAX_LINKS];
    double root[6 * TD_ROBOT_MAX_JOINTS], own[6 * TD_ROBOT_MAX_JOINTS], ad[36];
    td_robot_forward(at, robot, q);
    td_robot_jacobian(root, robot, at, link);
    const td_pose from_root = td_pose_inverse(at + link),
                  camera_from_root = td_pose_inverse(&eye->link_from_camera),
                  camera_from_hand = hand ? camera_from_root : td_pose_compose(&camera_from_root, at + link);
    td_pose_adjoint(ad, &from_root);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < n; k++) {
            own[i * n + k] = 0;
            for (int j = 0; j < 6; j++) own[i * n + k] += ad[6 * i + j] * root[j * n + k];
        }
    reorder(t->hand_jacobian, own, n);
    reorder(t->root_jacobian, root, n);
    td_pose_matrix(t->camera_from_hand, &camera_from_hand);
    td_pose_matrix(t->camera_from_root, &camera_from_root);
    td_pose_matrix(t->root_from_hand, at + link);
}

static void full_jacobian(double *j, const td_servo_features *f, const td_servo_eye *eye, const double *q,
                          int n)
{
    double l[TD_SERVO_ROWS * 6], twist[6 * TD_ROBOT_MAX_JOINTS];
    const int rows = td_servo_interaction(l, f);
    td_servo_jacobian(twist, NULL, eye, q);
    td_multiply(j, l, twist, (size_t)rows, 6, (size_t)n);
}

static double largest(const double *x, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++) most = fmax(most, fabs(x[i]));
    return most;
}

static void test_law(void **unused)
{
    (void)unused;
    enum { DRAWS = 8 };
    td_robot *robots[3] = {NULL, six_joints(), excavator()};
    td_random random = td_random_seed(3, 1);
    double worst = 0;
    int compared = 0;
    for (int mode = 0; mode < VISP_MODES; mode++)
        for (int choice = 0; choice < 6; choice++)
            for (int i = 0; i < DRAWS; i++) {
                const td_robot *robot = robots[mode == VISP_CAMERA ? 0 : 1 + i % 2];
                td_servo_features f = {.kind = choice < 3 ? TD_SERVO_POINTS : TD_SERVO_POSE,
                                       .interaction = (td_interaction)(choice % 3),
                                       .count = 5,
                                       .radius_m = 1};
                const int n = robot ? robot->joint_count : 6, hand = robot ? robot->link_count - 1 : 0;
                td_servo_eye eye = {.robot = robot,
                                    .camera_link = mode == VISP_HAND_cVe_eJe ? hand : 0,
                                    .target_link = mode > VISP_HAND_cVe_eJe ? hand : 0,
                                    .link_from_camera = pose_at(0.1, 0.2, -0.1, 0.3, -0.2, 0.5)};
                double q[TD_ROBOT_MAX_JOINTS] = {0}, j[TD_SERVO_ROWS * TD_ROBOT_MAX_JOINTS], e[TD_SERVO_ROWS],
                       own[TD_ROBOT_MAX_JOINTS], theirs[TD_ROBOT_MAX_JOINTS];
                visp_task t;
                int rows;
                do {
                    if (robot) draw_joints(q, robot, NULL, 1, &random);
                    draw_task(&t, &f, &eye, q, mode, &random);
                    rows = td_servo_error_of(e, &f);
                    full_jacobian(j, &f, &eye, q, n);
                } while (!well_conditioned(j, rows, n));
                td_visual_servo_options o = td_visual_servo_options_default();
                o.gain_zero = 2, o.gain_infinity = 0.4, o.gain_slope = 5;
                td_task_inverse inverse;
                td_task_invert(&inverse, j, e, rows, n, NULL, &(td_task_damping){1e-3, 0});
                const double gain = td_servo_gain(&o, inverse.step, n);
                for (int k = 0; k < n; k++) own[k] = -gain * inverse.step[k];
                visp_law(theirs, NULL, &t);
                if (!robot) { /* its camera's twist begins with v */
                    double turned[6];
                    reorder(turned, theirs, 1);
                    memcpy(theirs, turned, sizeof turned);
                }
                for (int k = 0; k < n; k++) {
                    const double off = fabs(own[k] - theirs[k]) / largest(theirs, n);
                    worst = fmax(worst, off);
                    if (!(off < 1e-12))
                        fail_msg("form %d, choice %d: rate %d is %.17g, ViSP's %.17g", mode, choice, k,
                                 own[k], theirs[k]);
                }
                compared++;
            }
    print_message("%d laws in ViSP's five forms: apart by %.1e at most\n", compared, worst);
    td_robot_free(&robots[1]);
    td_robot_free(&robots[2]);
}

/* One joint near its limit. Of a pose, so that e is all reached, as ViSP takes it. */
static void test_avoidance(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    td_random random = td_random_seed(4, 1);
    const td_visual_servo_options o = td_visual_servo_options_default();
    const int n = robot->joint_count;
    double worst = 0, most = 0;
    for (int i = 0; i < 50; i++) {
        td_servo_features f = {.kind = TD_SERVO_POSE, .interaction = TD_INTERACTION_CURRENT, .radius_m = 1};
        td_servo_eye eye = {.robot = robot,
                            .camera_link = robot->link_count - 1,
                            .link_from_camera = pose_at(0.1, 0.2, -0.1, 0.3, -0.2, 0.5)};
        double q[TD_ROBOT_MAX_JOINTS] = {0}, j[36], e[6], theirs[TD_ROBOT_MAX_JOINTS],
               rate[TD_ROBOT_MAX_JOINTS];
        double own[TD_ROBOT_MAX_JOINTS] = {0}, extra[TD_ROBOT_MAX_JOINTS] = {0};
        visp_task t;
        do {
            for (int k = 0; k < n; k++)
                q[k] = robot->joint[k].upper *
                       (k == i % n ? (i % 2 ? 1 : -1) * (0.8 + 0.2 * td_random_uniform(&random))
                                   : 1.5 * td_random_uniform(&random) - 0.75);
            draw_task(&t, &f, &eye, q, VISP_HAND_cVe_eJe, &random);
            td_servo_error_of(e, &f);
            full_jacobian(j, &f, &eye, q, n);
        } while (!well_conditioned(j, 6, n));
        t.avoid = 1;
        memcpy(t.q, q, sizeof t.q);
        for (int k = 0; k < n; k++) t.lower[k] = robot->joint[k].lower, t.upper[k] = robot->joint[k].upper;
        visp_law(rate, theirs, &t);
        td_task_inverse inverse;
        td_task_invert(&inverse, j, e, 6, n, NULL, &(td_task_damping){1e-3, 0});
        td_servo_avoid(extra, &o, robot, q, rate, j, e, &inverse, 6);
        for (int k = 0; k < n; k++) {
            own[k] = extra[k];
            worst = fmax(worst, fabs(own[k] - theirs[k]));
            check_near(own[k], theirs[k], 1e-12 * fmax(1, largest(rate, n)));
        }
        most = fmax(most, largest(extra, n));
        /* It leaves e falling as it was. */
        double change = 0;
        for (int r = 0; r < 6; r++)
            for (int k = 0; k < n; k++) change += e[r] * j[r * n + k] * extra[k];
        check_near(change, 0, largest(e, 6) > 0.7 ? 1e-11 : INFINITY);
    }
    print_message("avoidance of limits: up to %.2f rad/s, apart from ViSP's by %.1e\n", most, worst);
    assert_true(most > 0.1);
    td_robot_free(&robot);
}

/* ViSP's law and ours through the whole servo, limits and all. */
static void test_module(void **unused)
{
    (void)unused;
    td_robot *robot = six_joints();
    scene s = {.eye = {.camera = lens(),
                       .robot = robot,
                       .camera_link = td_robot_find_link(robot, "tool"),
                       .link_from_camera = looking_ahead(0.05, 0.06)}};
    const trial t = {.around = 0.1, .near_m = 0.4, .far_m = 0.8, .tilt = 0.3};
    td_random random = td_random_seed(5, 1);
    double goal[TD_ROBOT_MAX_JOINTS];
    td_plant_state state = {0};
    square_target(&s, 0.08);
    while (!draw_scene(&s, goal, state.q, &t, true, &random)) {
    }
    const td_servo_sight wanted = view_at(&s, goal, NULL);
    td_visual_servo own, theirs;
    td_error error = {0};
    td_visual_servo_options o = td_visual_servo_options_default();
    o.damping = 0;
    check_ok(td_visual_servo_start(&own, &s.eye, &wanted, &o, &error), error);
    o.law = TD_SERVO_LAW_VISP;
    check_ok(td_visual_servo_start(&theirs, &s.eye, &wanted, &o, &error), error);
    for (int i = 0; i < 100; i++) {
        td_servo_report a, b;
        const td_servo_sight sight = view_at(&s, state.q, NULL);
        check_ok(td_visual_servo_step(&a, &own, &sight, &state, &error), error);
        check_ok(td_visual_servo_step(&b, &theirs, &sight, &state, &error), error);
        assert_int_equal(a.phase, b.phase);
        check_near(a.gain, b.gain, 1e-11);
        for (int k = 0; k < 6; k++) check_near(a.command.value[k], b.command.value[k], 1e-11);
        pass_period(&state, robot, a.command.value, 0.02, 0.05);
    }
    td_visual_servo_end(&theirs);
    o.radius_m = 2;
    check_fails(td_visual_servo_start(&theirs, &s.eye, &wanted, &o, &error), TD_ERROR_ARGUMENT, error,
                "radius_m");
    td_robot_free(&robot);
}

/* ---- derivatives ---- */

/* e of either kind by the joints, against differences of what the scene shows. */
static void check_derivative(const scene *s, const double *q, const double *goal, td_servo_kind kind)
{
    const int n = s->eye.robot->joint_count;
    td_visual_servo servo;
    td_error error = {0};
    td_servo_sight wanted = view_at(s, goal, NULL);
    wanted.kind = kind;
    td_visual_servo_options o = td_visual_servo_options_default();
    o.radius_m = 0.7, o.interaction = TD_INTERACTION_CURRENT;
    check_ok(td_visual_servo_start(&servo, &s->eye, &wanted, &o, &error), error);
    double j[TD_SERVO_ROWS * TD_ROBOT_MAX_JOINTS], most;
    bool identical = true;
    td_servo_features f;
    int index[TD_SERVO_MAX_POINTS];
    td_servo_sight here = view_at(s, q, NULL);
    here.kind = kind;
    check_ok(td_servo_gather(&f, index, &servo, &here, &error), error);
    full_jacobian(j, &f, &s->eye, q, n);
    const int rows = kind == TD_SERVO_POSE ? 6 : 2 * f.count;
    most = largest(j, rows * n);
    for (int k = 0; k < n; k++) {
        double e[2][TD_SERVO_ROWS];
        for (int side = 0; side < 2; side++) {
            double moved[TD_ROBOT_MAX_JOINTS];
            memcpy(moved, q, (size_t)n * sizeof *q);
            moved[k] += side ? 1e-6 : -1e-6;
            td_servo_sight sight = view_at(s, moved, NULL);
            sight.kind = kind;
            check_ok(td_servo_gather(&f, index, &servo, &sight, &error), error);
            td_servo_error_of(e[side], &f);
        }
        for (int r = 0; r < rows; r++) {
            const double difference = (e[1][r] - e[0][r]) / 2e-6;
            check_near(j[r * n + k], difference, 1e-7 * fmax(1, most));
            identical = identical && difference == j[r * n + k];
        }
    }
    assert_true(most > 0.1);
    assert_false(identical);
}

static void test_derivatives(void **unused)
{
    (void)unused;
    td_robot *robots[2] = {six_joints(), excavator()};
    td_random random = td_random_seed(6, 1);
    for (int i = 0; i < 12; i++) {
        td_robot *robot = robots[i % 2];
        const bool fixed = i % 4 > 1;
        const int hand = robot->link_count - 1;
        scene s = {.eye = {.camera = lens(),
                           .robot = robot,
                           .camera_link = fixed ? 1 : hand,
                           .target_link = fixed ? hand : 0}};
        double q[TD_ROBOT_MAX_JOINTS], goal[TD_ROBOT_MAX_JOINTS];
        td_pose at[TD_ROBOT_MAX_LINKS];
        square_target(&s, 0.2);
        draw_joints(q, robot, NULL, 1, &random);
        draw_joints(goal, robot, q, 0.02, &random);
        td_robot_forward(at, robot, q);
        /* The target before the camera, wherever that is. */
        const td_pose from = pose_at(0.1, -0.05, 1.5, 0.3, -0.2, 0.7),
                      camera = pose_at(0.2, 0.1, 0.3, -0.4, 0.5, 1);
        s.eye.link_from_camera = camera;
        const td_pose root_from_camera = td_pose_compose(at + s.eye.camera_link, &camera),
                      root_from_target = td_pose_compose(&root_from_camera, &from),
                      link_from_root = td_pose_inverse(at + s.eye.target_link);
        s.link_from_target = td_pose_compose(&link_from_root, &root_from_target);
        check_derivative(&s, q, goal, TD_SERVO_POINTS);
        check_derivative(&s, q, goal, TD_SERVO_POSE);
    }
    td_robot_free(&robots[0]);
    td_robot_free(&robots[1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tutorial),     cmocka_unit_test(test_law),
        cmocka_unit_test(test_avoidance),    cmocka_unit_test(test_module),
        cmocka_unit_test(test_derivatives),  cmocka_unit_test(test_six_joints),
        cmocka_unit_test(test_fixed_camera), cmocka_unit_test(test_excavator),
        cmocka_unit_test(test_cab),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
