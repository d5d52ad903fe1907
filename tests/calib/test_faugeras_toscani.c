/* Proves: camera and pose come back from exact points of a cloud, of two planes and of a plane at several
 * heights, in whatever frame the target is given; that with noise too the answer does not depend on the frame
 * (Faugeras and Toscani's constraint is one that a change of frame leaves alone); that noise scatters the
 * focal length and does not shift it; that points which do not determine a camera, or are numbered as in a
 * mirror, are refused; and that the joint refinement ends where it ends when it starts from the truth.
 * Reference: simulated truth. Tolerances: 1e-10 relative without noise (measured: 4e-12); 3 % of the
 * residual, the paper's bound, after refinement; others stated in place. Blind to: wrong views among many
 * (test_first_estimate). */
#include "calib/bundle_internal.h"
#include "calib/faugeras_toscani.h"
#include "core/linalg.h"
#include "tests/calib/simulate_depth.h"

enum { MOST = 162 };

typedef enum shape { CLOUD, PLANES, HEIGHTS, SHAPES } shape;

/* A camera, points and their exact images. */
typedef struct scene {
    double intrinsics[4], skew;
    td_pose pose; /* camera_from_target */
    size_t n;
    double point[3 * MOST], pixel[2 * MOST];
} scene;

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

static size_t make_points(double *point, shape form, td_random *random)
{
    const td_target book = two_planes();
    size_t n = form == CLOUD ? 40 : form == PLANES ? td_target_point_count(&book) : MOST;
    for (size_t i = 0; i < n; i++) {
        double *p = point + 3 * i;
        if (form == CLOUD)
            for (int k = 0; k < 3; k++) p[k] = between(random, 0, 0.2);
        else if (form == PLANES)
            td_target_point(p, &book, i);
        else {
            p[0] = 0.025 * (double)(i % 9);
            p[1] = 0.025 * (double)(i / 9 % 6);
            p[2] = -0.04 * (double)(i / 54);
        }
    }
    return n;
}

static void look(scene *s)
{
    for (size_t i = 0; i < s->n; i++) {
        double p[3];
        td_pose_transform(p, &s->pose, s->point + 3 * i);
        assert_true(p[2] > 0.1);
        for (int k = 0; k < 2; k++)
            s->pixel[2 * i + k] = s->intrinsics[k] * p[k] / p[2] + s->intrinsics[2 + k];
        s->pixel[2 * i] += s->skew * p[1] / p[2];
    }
}

static scene make_scene(shape form, td_random *random)
{
    scene s = {.n = 0};
    s.n = make_points(s.point, form, random);
    s.intrinsics[0] = between(random, 300, 3000);
    s.intrinsics[1] = s.intrinsics[0] * between(random, 0.8, 1.25);
    s.intrinsics[2] = between(random, 0, 640);
    s.intrinsics[3] = between(random, 0, 480);
    double z = s.intrinsics[0] / 300 * between(random, 0.4, 0.7), lean[6] = {0};
    for (int i = 0; i < 3; i++) lean[i] = between(random, -0.8, 0.8);
    const double centre[6] = {0, 0, 0, -0.1, -0.06, 0};
    const double away[6] = {0, 0, 0, between(random, -0.1, 0.1), between(random, -0.1, 0.1), z};
    td_pose a = td_pose_exp(away), l = td_pose_exp(lean), c = td_pose_exp(centre);
    a = td_pose_compose(&a, &l);
    s.pose = td_pose_compose(&a, &c);
    look(&s);
    return s;
}

/* The same scene told in another frame of the target. */
static scene in_another_frame(const scene *from, td_random *random, double distance)
{
    double xi[6];
    for (int i = 0; i < 3; i++) xi[i] = between(random, -1.7, 1.7);
    for (int i = 3; i < 6; i++) xi[i] = between(random, -distance, distance);
    td_pose other_from_target = td_pose_exp(xi), back = td_pose_inverse(&other_from_target);
    scene s = *from;
    for (size_t i = 0; i < s.n; i++) td_pose_transform(s.point + 3 * i, &other_from_target, s.point + 3 * i);
    s.pose = td_pose_compose(&from->pose, &back);
    return s;
}

typedef struct answer {
    double p[12], intrinsics[4], skew;
    td_pose pose;
} answer;

static td_status solve(answer *a, const scene *s, td_error *error)
{
    for (int i = 0; i < 12; i++) a->p[i] = 1e300;
    for (int i = 0; i < 4; i++) a->intrinsics[i] = 1e300;
    a->skew = 1e300;
    memset(&a->pose, 0x7f, sizeof a->pose);
    return td_faugeras_toscani(a->p, a->intrinsics, &a->skew, &a->pose, s->point, s->pixel, s->n, error);
}

static void check_pose(const td_pose *found, const td_pose *truth, double tolerance)
{
    td_pose back = td_pose_inverse(truth), difference = td_pose_compose(found, &back);
    check_near(td_pose_angle(&difference), 0, tolerance);
    check_near(td_pose_distance(&difference), 0, tolerance * td_pose_distance(truth));
}

static void test_exact(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 1);
    double worst = 0;
    for (int trial = 0; trial < 100; trial++)
        for (shape form = 0; form < SHAPES; form++) {
            scene base = make_scene(form, &random);
            base.skew = trial % 2 ? 0 : between(&random, -20, 20);
            look(&base);
            for (int frame = 0; frame < 4; frame++) {
                scene s = frame ? in_another_frame(&base, &random, frame == 3 ? 3 : 0.5) : base;
                td_error error = {0};
                answer a;
                check_ok(solve(&a, &s, &error), error);
                for (int i = 0; i < 4; i++) {
                    worst = fmax(worst, fabs(a.intrinsics[i] - s.intrinsics[i]) / s.intrinsics[0]);
                    check_near(a.intrinsics[i], s.intrinsics[i], 1e-10 * s.intrinsics[0]);
                }
                check_near(a.skew, s.skew, 1e-10 * s.intrinsics[0]);
                check_pose(&a.pose, &s.pose, 1e-10);
                /* The matrix maps as the camera does, and its third row has length 1. */
                check_near(a.p[8] * a.p[8] + a.p[9] * a.p[9] + a.p[10] * a.p[10], 1, 1e-12);
                for (size_t i = 0; i < s.n; i++) {
                    double u[3];
                    for (int r = 0; r < 3; r++) {
                        const double *q = a.p + 4 * r, *m = s.point + 3 * i;
                        u[r] = q[0] * m[0] + q[1] * m[1] + q[2] * m[2] + q[3];
                    }
                    assert_true(u[2] > 0);
                    for (int k = 0; k < 2; k++) check_near(u[k] / u[2], s.pixel[2 * i + k], 1e-8);
                }
            }
        }
    print_message("worst relative error of the intrinsics without noise: %.1e\n", worst);
}

/* Six points in general position are enough. */
static void test_six_points(void **state)
{
    (void)state;
    td_random random = td_random_seed(2, 1);
    for (int trial = 0; trial < 100; trial++) {
        scene s = make_scene(CLOUD, &random);
        td_error error = {0};
        answer a;
        const double corner[18] = {0,   0,    0, 0.2, 0,    0.01, 0,    0.2,  0.05,
                                   0.2, 0.18, 0, 0.1, 0.11, 0.2,  0.05, 0.15, 0.12};
        memcpy(s.point, corner, sizeof corner);
        s.n = 6;
        look(&s);
        check_ok(solve(&a, &s, &error), error);
        for (int i = 0; i < 4; i++) check_near(a.intrinsics[i], s.intrinsics[i], 1e-6 * s.intrinsics[0]);
        s.n = 5;
        check_fails(solve(&a, &s, &error), TD_ERROR_DATA, error, "needs 6 points, 5");
    }
}

/* What p34 = 1, or a unit p, would not give: with noise, the same camera in every frame. */
static void test_frame_independent(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 1);
    for (int trial = 0; trial < 100; trial++)
        for (shape form = 0; form < SHAPES; form++) {
            scene s = make_scene(form, &random);
            td_error error = {0};
            answer a, b;
            for (size_t i = 0; i < 2 * s.n; i++) s.pixel[i] += 0.2 * td_random_normal(&random);
            scene other = in_another_frame(&s, &random, 1);
            memcpy(other.pixel, s.pixel, sizeof s.pixel);
            check_ok(solve(&a, &s, &error), error);
            check_ok(solve(&b, &other, &error), error);
            for (int i = 0; i < 4; i++) check_near(a.intrinsics[i], b.intrinsics[i], 1e-8 * a.intrinsics[0]);
            check_near(a.skew, b.skew, 1e-8 * a.intrinsics[0]);
            assert_true(fabs(a.skew) > 1e-6); /* the noise did reach the answer */
        }
}

/* The plain minimum is pulled towards small depths by noise: at 1 px two planes 0.24 m wide, 0.6 m away from
 * a lens of 530 px, gave it 150 to 250 px. Without that pull the answer falls on either side of the truth as
 * a coin does, within 3.3 standard deviations of it. */
static void test_unbiased(void **state)
{
    (void)state;
    enum { TRIALS = 400 };
    td_random random = td_random_seed(8, 1);
    double below = 0, square = 0;
    size_t n = 0;
    for (int trial = 0; trial < TRIALS; trial++) {
        scene s = make_scene(PLANES, &random);
        td_error error = {0};
        answer a;
        const double k[4] = {530, 530, 320, 240};
        memcpy(s.intrinsics, k, sizeof k);
        for (int i = 0; i < 3; i++) s.pose.t[i] *= 0.6 / s.pose.t[2] * (i == 2 ? 1 : 0.5);
        look(&s);
        for (size_t i = 0; i < 2 * s.n; i++) s.pixel[i] += 0.3 * td_random_normal(&random);
        if (solve(&a, &s, &error) != TD_OK) continue;
        double e = log(a.intrinsics[0] / 530);
        below += e < 0;
        square += e * e;
        n++;
    }
    print_message("focal length, 0.3 px of noise: scatter %.1f %%, below the truth %.1f %% of the time\n",
                  100 * sqrt(square / (double)n), 100 * below / (double)n);
    assert_true(n > 0.95 * TRIALS);
    check_near(below / (double)n, 0.5, 3.3 * 0.5 / sqrt((double)n));
}

static void test_outputs_are_optional(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 1);
    scene s = make_scene(PLANES, &random);
    td_error error = {0};
    double intrinsics[4];
    check_ok(td_faugeras_toscani(NULL, NULL, NULL, NULL, s.point, s.pixel, s.n, &error), error);
    check_ok(td_faugeras_toscani(NULL, intrinsics, NULL, NULL, s.point, s.pixel, s.n, NULL), error);
    check_near(intrinsics[0] / s.intrinsics[0], 1, 1e-8);
}

static void test_plane_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int trial = 0; trial < 20; trial++) {
        scene s = make_scene(HEIGHTS, &random);
        td_error error = {0};
        answer a;
        s.n = 54; /* one height */
        check_fails(solve(&a, &s, &error), TD_ERROR_DATA, error, "height_m in frames.csv");
        assert_non_null(strstr(error.message, "two planes"));
        scene turned = in_another_frame(&s, &random, 1);
        check_fails(solve(&a, &turned, &error), TD_ERROR_DATA, error, "lie on a plane");
        /* A board that is bent by a twentieth of a millimetre has no depth either. */
        for (size_t i = 0; i < s.n; i++) s.point[3 * i + 2] += 5e-5 * td_random_normal(&random);
        check_fails(solve(&a, &s, &error), TD_ERROR_DATA, error, "lie on a plane");
        /* A plane and one point beside it have depth, but leave the camera open. */
        s = make_scene(HEIGHTS, &random);
        s.n = 55;
        td_status status = solve(&a, &s, &error);
        if (status != TD_ERROR_DATA)
            fail_msg("one point beside a plane: f = %g, truth %g", a.intrinsics[0], s.intrinsics[0]);
    }
}

static void test_bad_points(void **state)
{
    (void)state;
    td_random random = td_random_seed(6, 1);
    scene s = make_scene(CLOUD, &random);
    td_error error = {0};
    answer a;
    const double bad[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++)
        for (int where = 0; where < 2; where++) {
            double *x = (where ? s.point : s.pixel) + 13, kept = *x;
            *x = bad[i];
            check_fails(solve(&a, &s, &error), TD_ERROR_DATA, error, "not finite");
            *x = kept;
        }
    scene same = s;
    for (size_t i = 0; i < 3 * same.n; i++) same.point[i] = 0.3 + 0.1 * (double)(i % 3);
    assert_int_equal(solve(&a, &same, &error), TD_ERROR_DATA);
    same = s;
    for (size_t i = 0; i < 2 * same.n; i++) same.pixel[i] = 300;
    assert_int_equal(solve(&a, &same, &error), TD_ERROR_DATA);
    assert_int_equal(solve(&a, &same, NULL), TD_ERROR_DATA);
}

/* The rows of both planes counted from below; a rail whose heights have the wrong sign. */
static void test_mirror_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(7, 1);
    for (int trial = 0; trial < 20; trial++) {
        td_error error = {0};
        answer a;
        scene s = make_scene(PLANES, &random);
        scene mirrored = s;
        for (size_t i = 0; i < s.n; i++) {
            size_t k = i % 36, from = i - k + (5 - k / 6) * 6 + k % 6;
            memcpy(mirrored.pixel + 2 * i, s.pixel + 2 * from, 2 * sizeof(double));
        }
        check_fails(solve(&a, &mirrored, &error), TD_ERROR_DATA, error, "mirror");
        s = make_scene(HEIGHTS, &random);
        for (size_t i = 0; i < s.n; i++) s.point[3 * i + 2] = -s.point[3 * i + 2];
        check_fails(solve(&a, &s, &error), TD_ERROR_DATA, error, "height");
    }
}

/* Residual of the joint refinement of the same observations that starts from the truth. */
static double rms_from_truth(const td_observations *o, const simulation *s, const td_pose *rig_from_target)
{
    td_error error = {0};
    td_bundle b;
    size_t points;
    check_ok(td_bundle_init(&b, o, &error), error);
    memcpy(b.rig->camera, s->rig->camera, sizeof b.rig->camera);
    for (size_t v = 0; v < o->view_count; v++) b.rig_from_target[b.pose_of_view[v]] = rig_from_target[v];
    check_ok(td_bundle_solve(&b, NULL, NULL, NULL, &error), error);
    double rms = sqrt(td_bundle_square_sum(&b, -1, &points) / (double)points);
    assert_int_equal(points, o->view_count * (size_t)o->camera_count * td_target_point_count(&s->target));
    td_bundle_free(&b);
    return rms;
}

static void check_refinement(const td_observations *o, const simulation *s, const td_pose *rig_from_target,
                             double *largest)
{
    td_error error = {0};
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.method = TD_ESTIMATE_FAUGERAS_TOSCANI;
    options.plain = true;
    options.leave_one_out = false;
    check_ok(td_calibrate(&c, o, &options, &error), error);
    double ratio = c->rms_px / rms_from_truth(o, s, rig_from_target);
    *largest = fmax(*largest, ratio);
    check_near(ratio, 1, 0.03);
    td_calibration_free(&c);
}

static void test_refinement_of_two_planes(void **state)
{
    (void)state;
    double largest = 0;
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int level = 0; level < 3; level++) {
            simulation s = simulate_stereo(m, 5);
            const double noise[] = {0.05, 0.3, 1};
            td_pose truth[5];
            s.target = two_planes();
            td_observations *o = simulate(&s, 20 + m, 30 + (uint64_t)level, noise[level], noise[level]);
            true_poses(truth, &s, 20 + m);
            check_refinement(o, &s, truth, &largest);
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
    print_message("two planes: largest residual over that from the truth: %.6f\n", largest);
}

static void test_refinement_of_heights(void **state)
{
    (void)state;
    enum { VIEWS = 4 };
    double largest = 0;
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int level = 0; level < 3; level++) {
            simulation s = simulate_stereo(m, VIEWS);
            const double px[] = {0.05, 0.3, 1}, xi[6] = {0.05, -0.08, 0.1, -0.09, -0.06, 0.5};
            td_random noise = td_random_seed(40 + (uint64_t)level, 1);
            td_pose truth[VIEWS];
            td_observations *o = simulate(&s, 1, 1, 0, 0);
            for (size_t v = 0; v < VIEWS; v++) {
                truth[v] = td_pose_exp(xi);
                put_on_rail(o, &s, v, &truth[v], 0.05 * (double)v, px[level], &noise);
            }
            check_refinement(o, &s, truth, &largest);
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
    print_message("heights: largest residual over that from the truth: %.6f\n", largest);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_exact),
                                       cmocka_unit_test(test_six_points),
                                       cmocka_unit_test(test_frame_independent),
                                       cmocka_unit_test(test_unbiased),
                                       cmocka_unit_test(test_outputs_are_optional),
                                       cmocka_unit_test(test_plane_refused),
                                       cmocka_unit_test(test_bad_points),
                                       cmocka_unit_test(test_mirror_refused),
                                       cmocka_unit_test(test_refinement_of_two_planes),
                                       cmocka_unit_test(test_refinement_of_heights)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
