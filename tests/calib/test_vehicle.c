/* Proves: camera-to-vehicle on a simulated excavator. Against truth without noise (exact); against Monte
 * Carlo: the scatter of vehicle_from_rig is the covariance that is told, jointly over its six numbers, and so
 * is the scatter at the tip (bounds: two-sided 99.9 % of chi-squared for the count of runs); the refusals
 * name the direction that the machine's parallel axes leave open, and what is said to help does. Blind to:
 * errors of the kinematics that are no zero offsets (link lengths, bent pins, play), and to points whose
 * finding in images is biased. */
#include "calib/vehicle.h"

#include "calib/vehicle_internal.h"
#include "core/linalg.h"
#include "tests/calib/vehicle_scene.h"
#include "tests/jacobians.h"

#define DEGREES 57.29577951308232

static void error_of(double xi[6], const td_pose *estimate, const td_pose *truth)
{
    td_pose inverse = td_pose_inverse(truth), difference = td_pose_compose(estimate, &inverse);
    td_pose_log(xi, &difference);
}

static void check_pose(const td_pose *estimate, const td_pose *truth, double rad, double m)
{
    td_pose inverse = td_pose_inverse(truth), d = td_pose_compose(&inverse, estimate);
    check_near(td_pose_angle(&d), 0, rad);
    check_near(td_pose_distance(&d), 0, m);
}

static double mahalanobis(const double *e, const double *covariance, size_t n)
{
    double inverse[36], sum = 0;
    td_error error;
    check_ok(td_invert_spd(inverse, covariance, n, &error), error);
    for (size_t i = 0; i < n * n; i++) sum += e[i / n] * inverse[i] * e[i % n];
    return sum;
}

/* Two-sided 99.9 % of chi-squared over its `freedom` (Wilson and Hilferty 1931). */
static void check_chi2(const char *what, double mean_per_freedom, double freedom)
{
    double a = 2 / (9 * freedom), low = pow(1 - a - 3.2905 * sqrt(a), 3),
           high = pow(1 - a + 3.2905 * sqrt(a), 3);
    print_message("%s: error over sigma %.4f (bounds %.4f to %.4f)\n", what, sqrt(mean_per_freedom),
                  sqrt(low), sqrt(high));
    check_less(low, mean_per_freedom);
    check_less(mean_per_freedom, high);
}

static int runs(int few)
{
    return getenv("TELEDIMOS_FULL") && !strcmp(getenv("TELEDIMOS_FULL"), "1") ? 1000 : few;
}

static void test_jacobians(void **state)
{
    (void)state;
    scene s;
    td_error error;
    scene_make(&s, true);
    scene_add_board(&s, true);
    scene_free_place(&s, 1, 0);
    for (int j = 0; j < SCENE_JOINTS; j++) s.offset_prior[j] = 0.01;
    scene_poses(&s, 3, 0.2, 1);
    scene_measure(&s, 1, 1);
    for (size_t i = 0; i < s.data.sight_count; i++) s.sight[i].sigma_px = 5;
    size_t n = td_rig_parameter_count(s.rig);
    s.rig->covariance = calloc(n * n, sizeof *s.rig->covariance);
    for (size_t i = 0; i < n; i++)
        s.rig->covariance[i * (n + 1)] = i >= 9 && i < 15 ? 0 : i % 15 < 4 ? 0.04 : 1e-6;
    td_vehicle_model model;
    td_vehicle_problem vp;
    td_vehicle_board board = {.link = s.point[3].link, .sigma_rad = 0.02, .sigma_m = 0.01};
    td_pose said = td_pose_exp((double[]){0.2, -0.1, 0.3, 0.5, 0.1, -0.2}), back = td_pose_inverse(&said);
    board.link_from_board = said;
    s.data.board = &board;
    s.data.board_count = 1;
    for (int p = 3; p < 6; p++) {
        td_pose_transform(s.place[p], &back, s.place[p]);
        memcpy(s.point[p].place, s.place[p], sizeof s.place[p]);
        s.point[p].board = 1;
    }
    check_ok(td_vehicle_model_new(&model, &s.data, &error), error);
    model.board[0] = td_pose_perturb(&said, (double[]){0.01, -0.02, 0.03, 0.01, 0.02, -0.01});
    model.mount_from_rig = s.mount_from_rig;
    memcpy(model.place, s.place, sizeof s.place[0] * (size_t)s.data.point_count);
    assert_int_equal(model.joints, 3);
    for (size_t i = 0; i < 9; i++) model.noise[i] = 1e-3 * (double)(i % 4);
    check_ok(td_vehicle_problem_new(&vp, &model, NULL, &error), error);
    check_problem_jacobians(vp.problem, 2e-5);
    td_vehicle_problem_free(&vp);
    td_vehicle_model_free(&model);
    scene_drop(&s);
}

static void test_exact(void **state)
{
    (void)state;
    for (int on_cab = 0; on_cab < 2; on_cab++) {
        scene s;
        td_error error;
        td_vehicle *v;
        scene_make(&s, on_cab);
        scene_poses(&s, 6, 0.15, 3);
        scene_measure(&s, 0, 1);
        check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
        assert_int_equal(v->null_count, 0);
        check_pose(&v->vehicle_from_rig, &s.mount_from_rig, 1e-8, 1e-7);
        assert_int_equal(v->closed_poses, 6);
        check_pose(&v->closed, &s.mount_from_rig, 1e-8, 1e-7);
        check_near(v->rms_px, 0, 1e-5);
        td_vehicle_free(&v);
        scene_drop(&s);
    }
}

/* The tip where the true angles are `at`: as seen through the cameras, less as one reading q says. */
static void tip_error(double d[3], double *q, const scene *s, const td_vehicle *v, const double *at, int tip,
                      td_random *random)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS], back = td_pose_inverse(&s->mount_from_rig);
    double told[3], corrected[SCENE_JOINTS];
    td_robot_forward(root_from_link, s->robot, at);
    td_pose mount_from_root = td_pose_inverse(&root_from_link[s->data.mount]);
    td_pose_transform(d, &mount_from_root, root_from_link[tip].t);
    td_pose_transform(d, &back, d);
    td_pose_transform(d, &v->mount_from_rig, d);
    for (int j = 0; j < SCENE_JOINTS; j++) {
        q[j] = at[j] - s->offset[j] + s->sigma_q[j] * td_random_normal(random);
        corrected[j] = q[j] + v->offset[j];
    }
    td_robot_forward(root_from_link, s->robot, corrected);
    mount_from_root = td_pose_inverse(&root_from_link[s->data.mount]);
    td_pose_transform(told, &mount_from_root, root_from_link[tip].t);
    for (int k = 0; k < 3; k++) d[k] -= told[k];
}

/* Twenty poses, six known points: scatter, closed way, tip. */
static void test_scatter(void **state)
{
    (void)state;
    check_statistics();
    scene s;
    td_error error;
    int count = runs(150), tip;
    double chi2 = 0, tip_chi2 = 0, scatter[6] = {0}, predicted[6] = {0}, closed[2] = {0}, refined[2] = {0},
           dof = 0;
    const double at[SCENE_JOINTS] = {0.3, 0.1, 1.5, 1.0};
    scene_make(&s, true);
    scene_poses(&s, 20, 0.15, 3);
    tip = td_robot_find_link(s.robot, "bucket_tip");
    td_random random = td_random_seed(77, 0);
    for (int i = 0; i < count; i++) {
        td_vehicle *v;
        double xi[6], c9[9], seen[3], q[SCENE_JOINTS];
        scene_measure(&s, 1, (uint64_t)(100 + i));
        check_ok(td_vehicle_solve(&v, &s.data, &(td_vehicle_options){.tip = tip}, &error), error);
        assert_int_equal(v->null_count, 0);
        error_of(xi, &v->vehicle_from_rig, &s.mount_from_rig);
        chi2 += mahalanobis(xi, v->covariance, 6) / (6 * count);
        dof += v->chi2_per_dof / count;
        td_pose inverse = td_pose_inverse(&s.mount_from_rig), d = td_pose_compose(&inverse, &v->closed),
                r = td_pose_compose(&inverse, &v->vehicle_from_rig);
        closed[0] += pow(td_pose_angle(&d), 2) / count, closed[1] += pow(td_pose_distance(&d), 2) / count;
        refined[0] += pow(td_pose_angle(&r), 2) / count, refined[1] += pow(td_pose_distance(&r), 2) / count;
        for (int k = 0; k < 6; k++) {
            scatter[k] += xi[k] * xi[k] / count;
            predicted[k] += v->covariance[7 * k] / count;
        }
        tip_error(seen, q, &s, v, at, tip, &random);
        check_ok(td_vehicle_tip_sigma(c9, v, &s.data, -1, q, &error), error);
        tip_chi2 += mahalanobis(seen, c9, 3) / (3 * count);
        if (i == 0)
            print_message(
                "%d poses, 6 points: sigma %.3f mm, %.4f deg; tip %.2f mm worst, %.2f mm median; rms %.3f\n",
                20, v->sigma_mm, v->sigma_deg, v->sigma_tip_worst_mm, v->sigma_tip_median_mm, v->rms_px);
        td_vehicle_free(&v);
    }
    for (int k = 0; k < 6; k++) {
        double ratio = sqrt(scatter[k] / predicted[k]);
        print_message("component %d: scatter over the Cramer-Rao bound %.3f\n", k, ratio);
        /* 10 % of 1000 runs is 4.5 standard deviations; of fewer as many. */
        check_near(ratio, 1, 0.1 * sqrt(1000.0 / count));
    }
    print_message("closed way %.3f mm %.4f deg, refined %.3f mm %.4f deg (rms over %d runs)\n",
                  1e3 * sqrt(closed[1]), DEGREES * sqrt(closed[0]), 1e3 * sqrt(refined[1]),
                  DEGREES * sqrt(refined[0]), count);
    check_less(refined[1], closed[1]);
    check_chi2("vehicle_from_rig", chi2, 6.0 * count);
    check_chi2("tip", tip_chi2, 3.0 * count);
    check_near(dof, 1, 0.03);
    scene_drop(&s);
}

/* A rig whose covariance is known, and zeros with priors: every run draws another rig and other zeros, and
 * the solution takes the mean ones. */
static void test_rig_covariance(void **state)
{
    (void)state;
    scene s;
    td_error error;
    int count = runs(100) / 2;
    double chi2 = 0, offset_chi2 = 0, tip_chi2 = 0, height_chi2 = 0, without = 0;
    const double at[SCENE_JOINTS] = {0.3, 0.1, 1.5, 1.0};
    scene_make(&s, true);
    int tip = td_robot_find_link(s.robot, "bucket_tip");
    td_rig *mean = s.rig;
    size_t n = td_rig_parameter_count(mean);
    mean->covariance = calloc(n * n, sizeof *mean->covariance);
    /* Focal lengths and centres of both cameras with a common part, and the second camera's pose. */
    double *root = calloc(n * n, sizeof *root);
    for (size_t i = 0; i < n; i++) {
        size_t k = i % 15;
        bool pose = i >= 15 && k >= 9;
        root[i * n + i] = pose ? (k < 12 ? 2e-4 : 3e-4) : k < 4 ? 0.4 : 0;
        if (i >= 15 && k < 2) root[i * n + k] = 0.5;
        if (pose && k == 10) root[i * n + 2] = 4e-4;
    }
    td_multiply_transposed(mean->covariance, root, root, n, n, n);
    s.offset_prior[BOOM] = s.offset_prior[BUCKET] = 3e-3;
    td_random random = td_random_seed(5, 5);
    for (int i = 0; i < count; i++) {
        td_vehicle *v;
        double z[64], xi[6], plain[36];
        td_rig *drawn = td_rig_copy(mean);
        for (size_t k = 0; k < n; k++) z[k] = td_random_normal(&random);
        for (int c = 0; c < 2; c++) {
            double move[6];
            for (size_t p = 0; p < 15; p++) {
                double d = 0;
                for (size_t k = 0; k < n; k++) d += root[((size_t)c * 15 + p) * n + k] * z[k];
                if (p < 9)
                    drawn->camera[c].camera.parameter[p] += d;
                else
                    move[p - 9] = d;
            }
            drawn->camera[c].camera_from_rig = td_pose_perturb(&drawn->camera[c].camera_from_rig, move);
        }
        for (int j = BOOM; j <= BUCKET; j++) s.offset[j] = s.offset_prior[j] * td_random_normal(&random);
        s.rig = drawn;
        scene_poses(&s, 12, 0.15, 3);
        scene_measure(&s, 1, (uint64_t)(100 + i));
        check_ok(td_vehicle_solve(&v, &s.data, &(td_vehicle_options){.tip = -1}, &error), error);
        error_of(xi, &v->vehicle_from_rig, &s.mount_from_rig);
        chi2 += mahalanobis(xi, v->covariance, 6) / (6 * count);
        offset_chi2 += pow((v->offset[BOOM] - s.offset[BOOM]) / v->sigma_offset[BOOM], 2) / count;
        double c9[9], d[3], q[SCENE_JOINTS];
        tip_error(d, q, &s, v, at, tip, &random);
        check_ok(td_vehicle_tip_sigma(c9, v, &s.data, tip, q, &error), error);
        tip_chi2 += mahalanobis(d, c9, 3) / (3 * count);
        height_chi2 += d[2] * d[2] / c9[8] / count;
        td_vehicle_free(&v);
        double *kept = mean->covariance;
        mean->covariance = NULL;
        check_ok(td_vehicle_solve(&v, &s.data, &(td_vehicle_options){.tip = -1}, &error), error);
        mean->covariance = kept;
        memcpy(plain, v->covariance, sizeof plain);
        without += mahalanobis(xi, plain, 6) / (6 * count);
        td_vehicle_free(&v);
        td_rig_free(&drawn);
    }
    print_message("without the rig's covariance: error over sigma %.3f\n", sqrt(without));
    check_chi2("vehicle_from_rig, rig uncertain", chi2, 6.0 * count);
    check_chi2("tip, rig and zeros uncertain", tip_chi2, 3.0 * count);
    /* Height at the tip: the pitch of the rig and the boom's zero cancel there. */
    check_chi2("height of the tip", height_chi2, count);
    check_chi2("zero of the boom", offset_chi2, count);
    check_less(4, without);
    free(root);
    s.rig = mean;
    scene_drop(&s);
}

/* One camera and known points; the vehicle's frame another than the mount's. */
static void test_one_camera(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    scene_make(&s, true);
    scene_poses(&s, 8, 0.15, 3);
    scene_measure(&s, 0, 1);
    s.data.vehicle = 0;
    size_t kept = 0;
    for (size_t i = 0; i < s.data.sight_count; i++)
        if (s.sight[i].camera == 1) s.sight[kept++] = s.sight[i];
    s.data.sight_count = kept;
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    assert_int_equal(v->closed_poses, 0);
    check_pose(&v->mount_from_rig, &s.mount_from_rig, 1e-7, 1e-6);
    td_pose expected = s.mount_from_rig;
    const double swing_axis[3] = {0.108, -0.034, 1.121};
    for (int k = 0; k < 3; k++) expected.t[k] += swing_axis[k];
    check_pose(&v->vehicle_from_rig, &expected, 1e-7, 1e-6);
    td_vehicle_free(&v);
    scene_free_place(&s, 2, 0);
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "two cameras");
    scene_drop(&s);
}

/* Solves and gives back the null directions, all in one text. */
static size_t refused(char text[4096], td_vehicle_data *data)
{
    td_error error;
    td_vehicle *v;
    check_ok(td_vehicle_solve(&v, data, NULL, &error), error);
    size_t count = v->null_count;
    text[0] = '\0';
    for (size_t i = 0; i < count; i++) {
        print_message("  refused: %s\n", v->null_direction[i]);
        strcat(strcat(text, v->null_direction[i]), "\n");
    }
    if (!count) print_message("  solved: %.3f mm, %.4f deg\n", v->sigma_mm, v->sigma_deg);
    td_vehicle_free(&v);
    return count;
}

#define check_names(text, words)                                                                             \
    do {                                                                                                     \
        if (!strstr(text, words)) fail_msg("'%s' lacks '%s'", text, words);                                  \
    } while (0)

static void free_all(scene *s)
{
    for (int p = 0; p < 6; p++)
        for (int k = 0; k < 3; k++) scene_free_place(s, p, k);
}

static void test_free_points(void **state)
{
    (void)state;
    char text[4096];
    for (int slew = 0; slew < 2; slew++) {
        scene s;
        scene_make(&s, true);
        free_all(&s);
        scene_poses(&s, 20, 0.4 * slew, 5);
        scene_measure(&s, 1, 9);
        assert_int_equal(refused(text, &s.data), 1);
        check_names(text, "sideways along the axis of boom (y of upper)");
        check_names(text, "measure one point's lateral place, or look at a fixed board");
        s.point[2].place[1] = s.place[2][1];
        s.point[2].sigma[1] = 0.001;
        assert_int_equal(refused(text, &s.data), 0);
        scene_drop(&s);
    }
}

static void test_ground_board(void **state)
{
    (void)state;
    scene s;
    char text[4096];
    scene_make(&s, true);
    free_all(&s);
    scene_add_board(&s, true);
    scene_poses(&s, 30, 0.4, 5);
    scene_measure(&s, 1, 9);
    assert_int_equal(refused(text, &s.data), 0);
    scene_drop(&s);
}

/* The stick's points become a board that stands at `pose` on it. */
static void group(scene *s, td_vehicle_board *board, const td_pose *pose)
{
    td_pose back = td_pose_inverse(pose);
    *board = (td_vehicle_board){.name = "plate", .link = s->point[0].link, .link_from_board = *pose};
    s->data.board = board;
    s->data.board_count = 1;
    for (int p = 0; p < 6; p++) {
        td_pose_transform(s->point[p].place, &back, s->place[p]);
        s->point[p].board = 1;
    }
}

static void test_board(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    td_vehicle_board board;
    char text[4096];
    const td_pose pose = td_pose_exp((double[]){0.4, -0.3, 1.2, 1.1, 0.2, 0.1});
    scene_make(&s, true);
    scene_poses(&s, 20, 0.4, 5);
    scene_measure(&s, 0, 1);
    group(&s, &board, &pose);
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    check_pose(&v->vehicle_from_rig, &s.mount_from_rig, 1e-8, 1e-7);
    for (int i = 0; i < 18; i++) check_near(v->place[i / 3][i % 3], s.place[i / 3][i % 3], 1e-12);
    assert_true(v->closed_poses == 20);
    td_vehicle_free(&v);

    scene_measure(&s, 1, 9);
    board.sigma_rad = board.sigma_m = INFINITY;
    board.link_from_board = td_pose_identity();
    assert_int_equal(refused(text, &s.data), 1);
    check_names(text, "sideways along the axis of boom (y of upper)");

    /* A board on the ground, seen while slewing, settles that. */
    scene_add_board(&s, true);
    scene_poses(&s, 30, 0.4, 5);
    scene_measure(&s, 1, 9);
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    assert_int_equal(v->null_count, 0);
    td_pose inverse = td_pose_inverse(&pose), off = td_pose_compose(&v->link_from_board[0], &inverse);
    print_message("  free board: off %.3f mm, %.4f deg; sigma %.3f mm, %.4f deg\n",
                  1e3 * td_pose_distance(&off), DEGREES * td_pose_angle(&off), 1e3 * v->sigma_board[0][1],
                  DEGREES * v->sigma_board[0][0]);
    check_less(td_pose_angle(&off), 5 * v->sigma_board[0][0]);
    check_less(hypot(hypot(v->link_from_board[0].t[0] - pose.t[0], v->link_from_board[0].t[1] - pose.t[1]),
                     v->link_from_board[0].t[2] - pose.t[2]),
               5 * v->sigma_board[0][1]);
    td_vehicle_free(&v);
    board.link = s.data.mount;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "board plate is on upper");
    scene_drop(&s);
}

/* A board whose pose has a prior: every run draws another one, common to all its points. */
static void test_board_prior(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle_board board;
    int count = runs(150);
    double chi2 = 0, tip_chi2 = 0;
    const double sigma_rad = 2e-3, sigma_m = 3e-3, at[SCENE_JOINTS] = {0.3, 0.1, 1.5, 1.0};
    const td_pose truth = td_pose_exp((double[]){0.4, -0.3, 1.2, 1.1, 0.2, 0.1});
    td_random random = td_random_seed(8, 8);
    scene_make(&s, true);
    int tip = td_robot_find_link(s.robot, "bucket_tip");
    scene_poses(&s, 12, 0.15, 3);
    group(&s, &board, &truth);
    board.sigma_rad = sigma_rad;
    board.sigma_m = sigma_m;
    for (int i = 0; i < count; i++) {
        td_vehicle *v;
        double xi[6], own[6], c9[9], d[3], q[SCENE_JOINTS];
        scene_measure(&s, 1, (uint64_t)(700 + i));
        for (int k = 0; k < 6; k++) own[k] = (k < 3 ? sigma_rad : sigma_m) * td_random_normal(&random);
        td_pose wrong = td_pose_exp(own);
        board.link_from_board = td_pose_compose(&truth, &wrong);
        check_ok(td_vehicle_solve(&v, &s.data, &(td_vehicle_options){.tip = tip}, &error), error);
        error_of(xi, &v->vehicle_from_rig, &s.mount_from_rig);
        chi2 += mahalanobis(xi, v->covariance, 6) / (6 * count);
        tip_error(d, q, &s, v, at, tip, &random);
        check_ok(td_vehicle_tip_sigma(c9, v, &s.data, -1, q, &error), error);
        tip_chi2 += mahalanobis(d, c9, 3) / (3 * count);
        td_vehicle_free(&v);
    }
    check_chi2("vehicle_from_rig, board uncertain", chi2, 6.0 * count);
    check_chi2("tip, board uncertain", tip_chi2, 3.0 * count);
    scene_drop(&s);
}

static void test_zeros(void **state)
{
    (void)state;
    scene s;
    char text[4096];
    scene_make(&s, true);
    scene_poses(&s, 20, 0.2, 5);
    scene_measure(&s, 1, 9);
    s.offset_prior[BOOM] = INFINITY;
    assert_int_equal(refused(text, &s.data), 1);
    check_names(text, "pitch of the rig about the axis of boom");
    check_names(text, "give the zero of boom a tight prior");
    s.offset_prior[BOOM] = 0.002;
    assert_int_equal(refused(text, &s.data), 0);
    free_all(&s);
    s.offset_prior[BOOM] = s.offset_prior[STICK] = INFINITY;
    assert_int_equal(refused(text, &s.data), 3);
    check_names(text, "sideways");
    check_names(text, "pitch of the rig about the axis of boom");
    check_names(text, "zero of arm");
    scene_drop(&s);
}

static void test_undercarriage(void **state)
{
    (void)state;
    scene s;
    char text[4096];
    scene_make(&s, false);
    free_all(&s);
    scene_poses(&s, 20, 0, 5);
    scene_measure(&s, 1, 9);
    assert_int_equal(refused(text, &s.data), 1);
    check_names(text, "sideways along the axis of boom");
    check_names(text, "swing stood still: slew between images");
    scene_poses(&s, 20, 0.25, 5);
    scene_measure(&s, 1, 9);
    assert_int_equal(refused(text, &s.data), 0);
    scene_drop(&s);
}

static void test_outliers(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    scene_make(&s, true);
    scene_poses(&s, 20, 0.2, 5);
    scene_measure(&s, 1, 9);
    static const size_t wrong[] = {3, 50, 51, 130};
    for (int i = 0; i < 4; i++) s.sight[wrong[i]].pixel[i % 2] += i % 2 ? 40 : -8;
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    assert_int_equal(v->outliers, 4);
    for (int i = 0; i < 4; i++) assert_true(v->left_out[wrong[i]]);
    double xi[6];
    error_of(xi, &v->vehicle_from_rig, &s.mount_from_rig);
    check_less(mahalanobis(xi, v->covariance, 6), 30);
    td_vehicle_free(&v);
    scene_drop(&s);
}

static void test_advice(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    char text[320];
    double q[SCENE_JOINTS];
    scene_make(&s, true);
    scene_poses(&s, 4, 0.2, 5);
    scene_measure(&s, 1, 9);
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    check_ok(td_vehicle_advise(q, text, v, &s.data, &error), error);
    print_message("  advice: %s\n", text);
    check_names(text, "the tip's sigma over the working space from");
    assert_true(td_robot_within_limits(s.robot, q, NULL));
    td_vehicle_free(&v);
    scene_drop(&s);
}

static void test_bad_input(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    scene_make(&s, true);
    scene_poses(&s, 5, 0.2, 5);
    scene_measure(&s, 0, 9);
    double kept = s.reading[2 * SCENE_JOINTS + STICK];
    s.reading[2 * SCENE_JOINTS + STICK] = 3;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error,
                "pose 2: joint arm reads 171.9 deg, outside its limits");
    assert_null(v);
    s.reading[2 * SCENE_JOINTS + STICK] = NAN;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_ARGUMENT, error, "joint arm");
    s.reading[2 * SCENE_JOINTS + STICK] = kept;
    s.sight[7].pixel[0] = NAN;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_ARGUMENT, error, "sight 7");
    s.sight[7].pixel[0] = s.pixel[7][0];
    s.sight[7].point = 9;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_ARGUMENT, error, "point 9");
    s.sight[7].point = s.sight[6].point;
    s.point[3].sigma[0] = -1;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_ARGUMENT, error, "s4");
    s.point[3].sigma[0] = 0;
    s.point[3].link = s.data.mount;
    s.point[3].sigma[0] = INFINITY;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "carries the cameras");
    s.point[3].link = s.point[0].link;
    s.point[3].sigma[0] = 0;
    s.sigma_q[1] = NAN;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_ARGUMENT, error, "boom");
    s.sigma_q[1] = 0;
    s.data.sight_count = 0;
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "no sights");
    scene_drop(&s);
}

static void test_too_little(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_vehicle *v;
    scene_make(&s, true);
    s.data.point_count = 5;
    scene_poses(&s, 1, 0.2, 5);
    scene_measure(&s, 0, 9);
    check_fails(td_vehicle_solve(&v, &s.data, &(td_vehicle_options){.closed_only = true, .tip = -1}, &error),
                TD_ERROR_DATA, error, "at least six points");
    check_ok(td_vehicle_solve(&v, &s.data, NULL, &error), error);
    assert_int_equal(v->closed_poses, 0);
    td_vehicle_free(&v);
    s.data.point_count = 2;
    scene_poses(&s, 1, 0.2, 5);
    scene_measure(&s, 0, 9);
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "at least three points");
    s.data.point_count = 4;
    for (int p = 0; p < 4; p++)
        for (int k = 0; k < 3; k++) s.place[p][k] = s.point[p].place[k] = 0.3 + 0.2 * p;
    scene_poses(&s, 1, 0.2, 5);
    scene_measure(&s, 0, 9);
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error, "on a line");
    scene_drop(&s);

    scene_make(&s, true);
    free_all(&s);
    scene_poses(&s, 3, 0, 5);
    for (size_t k = 1; k < 3; k++) memcpy(s.angle + k * SCENE_JOINTS, s.angle, SCENE_JOINTS * sizeof(double));
    scene_measure(&s, 0, 9);
    check_fails(td_vehicle_solve(&v, &s.data, NULL, &error), TD_ERROR_DATA, error,
                "same pose in all 3 images");
    scene_drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_jacobians),      cmocka_unit_test(test_exact),
        cmocka_unit_test(test_scatter),        cmocka_unit_test(test_free_points),
        cmocka_unit_test(test_ground_board),   cmocka_unit_test(test_zeros),
        cmocka_unit_test(test_undercarriage),  cmocka_unit_test(test_outliers),
        cmocka_unit_test(test_advice),         cmocka_unit_test(test_bad_input),
        cmocka_unit_test(test_rig_covariance), cmocka_unit_test(test_one_camera),
        cmocka_unit_test(test_too_little),     cmocka_unit_test(test_board),
        cmocka_unit_test(test_board_prior),
    };
    td_linalg_single_thread();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
