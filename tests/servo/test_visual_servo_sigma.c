/* The predicted sigma of the tool's place, against servos that are really run.
 *
 * Common: camera, hand-eye and target are drawn from their joint covariance (correlated), the goal is
 * computed with what is believed, the servo converges in the world as drawn, 1000 times. Noise: one servo
 * runs at its goal with a new image's noise every period, and its tool is read every second (100 periods at
 * least e^-5 apart), 1000 times, with the machine's lag. Whitened by the prediction, the squares' sum must be
 * chi-square within its two-sided 99.9 % bound; directions that the arm does not move in must have none. With
 * the gain of one period and no lag the loop leaves all of one image's noise. Six joints, the excavator's
 * four (pose, radians weighed by 2 m) and the three between cab and bucket. Derivative of the loop's factor:
 * by the runs.
 *
 * Blind to what is not linear, so sigmas are small here: 0.1 px, 1 mm, 1 mrad. */
#include "tests/check.h"

#include "core/linalg.h"
#include "tests/servo/servo_robots.h"
#include "tests/servo/visual_scene.h"

enum { DRAWS = 1000, CAMERA = 9, COMMON = CAMERA + 12 };

typedef struct world {
    scene believed;
    double goal[6], tip_m[3];
    int tip_link;
    td_servo_kind kind;
    td_visual_servo_options options;
} world;

static void tip_at(double p[3], const world *w, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, w->believed.eye.robot, q);
    td_pose_transform(p, at + w->tip_link, w->tip_m);
}

static td_pose looking_ahead(double x, double z)
{
    const double r[9] = {0, 0, 1, -1, 0, 0, 0, -1, 0}, t[3] = {x, 0, z};
    return td_pose_from_rotation(r, t);
}

static void put_target(scene *s, const double *q, const td_pose *from)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, s->eye.robot, q);
    const td_pose camera = td_pose_compose(at + s->eye.camera_link, &s->eye.link_from_camera),
                  target = td_pose_compose(&camera, from), link = td_pose_inverse(at + s->eye.target_link);
    s->link_from_target = td_pose_compose(&link, &target);
}

static world base_world(td_robot *robot)
{
    world w = {.believed = {.eye = {.camera = lens(), .robot = robot}}};
    w.options = td_visual_servo_options_default();
    w.options.settle_s = 1e5, w.options.limit_s = 1e8, w.options.stall_s = 1e8;
    w.options.tolerance_px = 1e3; /* it is never told to stop */
    w.tip_link = robot->link_count - 1;
    w.tip_m[0] = 0.2, w.tip_m[2] = -0.1;
    return w;
}

static world six_world(td_robot *robot)
{
    static const double home[6] = {0.2, 0.3, 0.9, 0.1, 0.5, 0.2};
    const td_pose from = pose_at(0.03, -0.02, 0.6, 0.4, -0.3, 0.3);
    world w = base_world(robot);
    memcpy(w.goal, home, sizeof home);
    w.believed.eye.camera_link = robot->link_count - 1;
    w.believed.eye.link_from_camera = looking_ahead(0.05, 0.06);
    square_target(&w.believed, 0.15);
    put_target(&w.believed, home, &from);
    return w;
}

/* The camera on the bucket; the cab's camera that sees the bucket. */
static world excavator_world(td_robot *robot, bool cab)
{
    static const double home[4] = {0.3, -0.3, 1.5, 0.9};
    const td_pose from = pose_at(0.1, -0.2, 4, 0.4, -0.3, 0.3);
    world w = base_world(robot);
    memcpy(w.goal, home, sizeof home);
    w.believed.eye.camera_link = td_robot_find_link(robot, cab ? "upper" : "bucket");
    w.believed.eye.target_link = cab ? td_robot_find_link(robot, "bucket") : 0;
    w.believed.eye.link_from_camera = cab ? looking_ahead(1, 1.8) : looking_ahead(0.3, 0.8);
    square_target(&w.believed, 0.5);
    put_target(&w.believed, home, &from);
    return w;
}

static td_visual_servo servo_of(const world *w, double sigma_px, const double *covariance,
                                td_servo_sight *goal)
{
    td_visual_servo servo;
    td_error error = {0};
    *goal = view_at(&w->believed, w->goal, NULL);
    goal->kind = w->kind;
    for (int i = 0; i < goal->count; i++) goal->point[i].sigma_px = sigma_px;
    if (covariance) memcpy(goal->covariance, covariance, sizeof goal->covariance);
    check_ok(td_visual_servo_start(&servo, &w->believed.eye, goal, &w->options, &error), error);
    return servo;
}

/* Sum of squares of offsets (count,3), whitened by the covariance where it is not zero. */
static void check_offsets(const char *name, const double *offset, int count, const double covariance[9])
{
    double value[3], axis[9], sum = 0, still = 0;
    td_error error = {0};
    int dimensions = 0;
    check_ok(td_eigen_symmetric(value, axis, covariance, 3, &error), error);
    assert_true(value[2] > 0);
    for (int k = 0; k < 3; k++) {
        const bool moves = value[k] > 1e-9 * value[2];
        dimensions += moves;
        for (int i = 0; i < count; i++) {
            const double *o = offset + 3 * i,
                         along = o[0] * axis[3 * k] + o[1] * axis[3 * k + 1] + o[2] * axis[3 * k + 2];
            if (moves)
                sum += along * along / value[k];
            else
                still = fmax(still, fabs(along));
        }
    }
    const double n = (double)count * dimensions;
    print_message("%s: sigma %.3g %.3g %.3g mm along its axes, found over predicted %.3f (%d dimensions)\n",
                  name, 1e3 * sqrt(fmax(value[0], 0)), 1e3 * sqrt(fmax(value[1], 0)), 1e3 * sqrt(value[2]),
                  sqrt(sum / n), dimensions);
    check_near(sum, n, 3.29 * sqrt(2 * n));
    check_less(still, 0.05 * sqrt(value[2]) + 1e-9);
}

/* ---- what is common ---- */

/* Correlated: root (n,n), lower triangle, of the covariance. */
static void draw_covariance(double *covariance, double *root, td_random *random)
{
    static const double sigma[COMMON] = {0.5,  0.5,  0.4,  0.4,  1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3,
                                         1e-3, 1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4, 5e-4, 5e-4, 5e-4};
    memset(root, 0, COMMON * COMMON * sizeof *root);
    for (int i = 0; i < COMMON; i++)
        for (int k = 0; k <= i; k++)
            root[i * COMMON + k] = sigma[i] * (i == k ? 1 : 0.3 * td_random_normal(random));
    td_multiply_transposed(covariance, root, root, COMMON, COMMON, COMMON);
}

static scene draw_world(const scene *believed, const double *root, td_random *random)
{
    double z[COMMON], x[COMMON];
    scene s = *believed;
    for (int i = 0; i < COMMON; i++) z[i] = td_random_normal(random);
    td_multiply(x, root, z, COMMON, COMMON, 1);
    for (int i = 0; i < CAMERA; i++) s.eye.camera.parameter[i] += x[i];
    s.eye.link_from_camera = td_pose_perturb(&s.eye.link_from_camera, x + CAMERA);
    s.link_from_target = td_pose_perturb(&s.link_from_target, x + CAMERA + 6);
    return s;
}

static void run_common(const char *name, world *w)
{
    enum { STEPS = 60 };
    static double offset[3 * DRAWS], covariance[COMMON * COMMON], root[COMMON * COMMON];
    td_random random = td_random_seed(11, 1);
    td_servo_sight goal;
    td_servo_sigma sigma;
    td_error error = {0};
    double there[3];
    w->options.gain_zero = w->options.gain_infinity = 15, w->options.limits.lag_s = 0;
    w->options.limits.period_s = 0.02;
    draw_covariance(covariance, root, &random);
    td_visual_servo servo = servo_of(w, 0, NULL, &goal);
    check_ok(td_visual_servo_sigma(&sigma, &servo, w->goal, &goal, w->tip_link, w->tip_m, covariance, &error),
             error);
    for (int i = 0; i < 9; i++) check_near(sigma.image[i], 0, 0);
    tip_at(there, w, w->goal);
    for (int i = 0; i < DRAWS; i++) {
        const scene s = draw_world(&w->believed, root, &random);
        td_plant_state state = {0};
        td_servo_report r;
        memcpy(state.q, w->goal, sizeof w->goal);
        servo = servo_of(w, 0, NULL, &goal);
        for (int k = 0; k < STEPS; k++) {
            td_servo_sight sight = view_at(&s, state.q, NULL);
            sight.kind = w->kind;
            check_ok(td_visual_servo_step(&r, &servo, &sight, &state, &error), error);
            assert_int_equal(r.phase, TD_SERVO_MOVING);
            pass_period(&state, s.eye.robot, r.command.value, 0.02, 0);
        }
        check_less(r.controlled.px, 1e-3);
        check_less(r.controlled.m, 1e-6);
        tip_at(offset + 3 * i, w, state.q);
        for (int k = 0; k < 3; k++) offset[3 * i + k] -= there[k];
    }
    check_offsets(name, offset, DRAWS, sigma.common);
}

static void test_common(void **unused)
{
    (void)unused;
    check_statistics();
    td_robot *six = six_joints(), *four = excavator();
    world w = six_world(six);
    run_common("common, six joints", &w);
    w = excavator_world(four, false);
    run_common("common, camera on the bucket", &w);
    w = excavator_world(four, true);
    run_common("common, camera on the cab", &w);
    td_robot_free(&six);
    td_robot_free(&four);
}

/* A pose knows the camera's parameters by its covariance only: theirs is left out of the draws. */
static void test_common_pose(void **unused)
{
    (void)unused;
    td_robot *four = excavator();
    world w = excavator_world(four, false);
    w.kind = TD_SERVO_POSE;
    w.options.radius_m = 2;
    run_common("common, pose, camera on the bucket", &w);
    td_robot_free(&four);
}

/* ---- noise ---- */

static void run_noise(const char *name, world *w, double gain, double lag_s)
{
    static double offset[3 * DRAWS];
    const double sigma_px = 0.1;
    double covariance[36] = {0};
    for (int i = 0; i < 6; i++) covariance[7 * i] = i < 3 ? 1e-6 : 4e-6;
    covariance[1] = covariance[6] = 5e-7;
    td_random random = td_random_seed(12, 1);
    td_servo_sight goal;
    td_servo_sigma sigma;
    td_error error = {0};
    double there[3];
    w->options.gain_zero = w->options.gain_infinity = gain, w->options.limits.lag_s = lag_s;
    w->believed.sigma_px = sigma_px;
    td_visual_servo servo = servo_of(w, sigma_px, covariance, &goal);
    td_servo_report r;
    td_plant_state state = {0};
    check_ok(td_visual_servo_sigma(&sigma, &servo, w->goal, &goal, w->tip_link, w->tip_m, NULL, &error),
             error);
    for (int i = 0; i < 9; i++) check_near(sigma.common[i], 0, 0);
    print_message("%s: of one image's noise the loop leaves %.3f\n", name,
                  sqrt(sigma.loop[0] / sigma.image[0]));
    memcpy(state.q, w->goal, sizeof w->goal);
    tip_at(there, w, w->goal);
    for (int i = 0; i < DRAWS; i++) {
        for (int k = 0; k < (int)(5 / gain / 0.02) + 5; k++) {
            td_servo_sight sight = view_at(&w->believed, state.q, &random);
            double eta[6];
            for (int j = 0; j < 6; j++) eta[j] = sqrt(covariance[7 * j]) * td_random_normal(&random);
            eta[1] = 0.5 * eta[0] + sqrt(0.75) * eta[1]; /* of the covariance above */
            sight.kind = w->kind;
            sight.camera_from_target = td_pose_perturb(&sight.camera_from_target, eta);
            check_ok(td_visual_servo_step(&r, &servo, &sight, &state, &error), error);
            assert_int_equal(r.phase, TD_SERVO_MOVING);
            pass_period(&state, w->believed.eye.robot, r.command.value, 0.02, lag_s);
        }
        tip_at(offset + 3 * i, w, state.q);
        for (int k = 0; k < 3; k++) offset[3 * i + k] -= there[k];
    }
    check_offsets(name, offset, DRAWS, sigma.loop);
}

static void test_noise(void **unused)
{
    (void)unused;
    check_statistics();
    td_robot *six = six_joints(), *four = excavator();
    world w = six_world(six);
    run_noise("noise, six joints, lag 50 ms", &w, 5, 0.05);
    run_noise("noise, six joints, no lag", &w, 10, 0);
    w = excavator_world(four, false);
    run_noise("noise, camera on the bucket", &w, 5, 0.05);
    w.kind = TD_SERVO_POSE;
    w.options.radius_m = 2;
    run_noise("noise, pose, camera on the bucket", &w, 5, 0.05);
    td_robot_free(&six);
    td_robot_free(&four);
}

/* The gain of a period: the joints go where the last image says. */
static void test_one_image(void **unused)
{
    (void)unused;
    td_robot *six = six_joints();
    world w = six_world(six);
    td_servo_sight goal;
    td_servo_sigma sigma;
    td_error error = {0};
    w.options.gain_zero = w.options.gain_infinity = 50, w.options.limits.lag_s = 0;
    const td_visual_servo servo = servo_of(&w, 0.1, NULL, &goal);
    check_ok(td_visual_servo_sigma(&sigma, &servo, w.goal, &goal, w.tip_link, w.tip_m, NULL, &error), error);
    for (int i = 0; i < 9; i++) check_near(sigma.loop[i], sigma.image[i], 1e-12 * sigma.image[0]);
    check_fails(td_visual_servo_sigma(&sigma, &servo, w.goal, &goal, 99, w.tip_m, NULL, &error),
                TD_ERROR_ARGUMENT, error, "no link 99");
    td_robot_free(&six);
}

/* The free camera: a point's noise and the target's perturbation, moved by hand through one step of the law.
 */
static void test_free_camera(void **unused)
{
    (void)unused;
    scene s = {.eye = {.camera = lens()}};
    const td_pose there = pose_at(0.05, -0.03, 0.75, 0.3, 0.2, 0.1);
    const double tip_m[3] = {0.1, 0.05, 0.3}, zero[6] = {0};
    td_visual_servo_options o = td_visual_servo_options_default();
    td_visual_servo servo;
    td_servo_report r;
    td_servo_sigma sigma;
    td_error error = {0};
    double common[COMMON * COMMON] = {0}, image[9] = {0}, moved[9] = {0};
    square_target(&s, 0.1);
    s.sigma_px = 1;
    td_servo_sight goal = view_from(&s, &there, NULL);
    o.gain_zero = o.gain_infinity = 50; /* all of it within a period */
    o.singular_share = 0;
    for (int k = 0; k < 18; k++) {
        td_servo_sight sight = goal;
        const double step = 1e-5;
        if (k < 8) sight.point[k / 2].pixel[k % 2] += step;
        if (k >= 12) {
            double xi[6] = {0};
            xi[k - 12] = step;
            const td_pose at = td_pose_perturb(&there, xi);
            sight = view_from(&s, &at, NULL);
        }
        if (k >= 8 && k < 12) continue;
        check_ok(td_visual_servo_start(&servo, &s.eye, &goal, &o, &error), error);
        check_ok(td_visual_servo_step(&r, &servo, &sight, NULL, &error), error);
        double by[18], p[3];
        td_pose_transform_jacobian(by, tip_m);
        for (int i = 0; i < 3; i++) {
            p[i] = 0;
            for (int j = 0; j < 6; j++) p[i] += by[6 * i + j] * r.twist[j] * 0.02 / step;
        }
        for (int i = 0; i < 9; i++) (k < 8 ? image : moved)[i] += p[i / 3] * p[i % 3];
    }
    for (int k = CAMERA + 6; k < COMMON; k++) common[k * (COMMON + 1)] = 1;
    for (int k = CAMERA; k < CAMERA + 6; k++) common[k * (COMMON + 1)] = 5; /* counts for nothing */
    check_ok(td_visual_servo_sigma(&sigma, &servo, zero, &goal, 0, tip_m, common, &error), error);
    for (int i = 0; i < 9; i++) {
        check_near(sigma.image[i], image[i], 1e-4 * (image[0] + image[4] + image[8]));
        check_near(sigma.common[i], moved[i], 1e-4 * (moved[0] + moved[4] + moved[8]));
    }
    assert_true(sigma.common[0] > 0.1 && sigma.image[0] > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_common),    cmocka_unit_test(test_common_pose), cmocka_unit_test(test_noise),
        cmocka_unit_test(test_one_image), cmocka_unit_test(test_free_camera),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
