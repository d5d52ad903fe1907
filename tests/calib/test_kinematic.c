/* Proves: kinematic calibration finds a simulated chain's wrong origins again (prediction exact without
 * noise, the noise's sigma with noise), and predicts held-out poses of a real two-joint positioner
 * (industrial calibration's example; every fifth pose held out) to less than 2 mm and 0.2 degrees on average.
 * Blind to: errors that are no wrong origin, such as bending under load. */
#include "calib/kinematic.h"

#include "calib/kinematic_internal.h"
#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"
#include "core/random.h"
#include "tests/jacobians.h"

#define DEGREES 57.29577951308232

/* The example's chain, DH (d, theta, a, alpha) = (0, 0, 0, -pi/2), (-0.475, -pi/2, 0, 0) from a base at
 * (2.2, 0, 1.6) m turned by 90 degrees about x; the constant theta is the target's. */
static const char *const positioner_urdf =
    "<robot name='positioner'><link name='base'/><link name='one'/><link name='two'/>"
    "<joint name='tilt' type='continuous'><parent link='base'/><child link='one'/>"
    "<origin xyz='2.2 0 1.6' rpy='1.5707963267948966 0 0'/><axis xyz='0 0 1'/></joint>"
    "<joint name='turn' type='continuous'><parent link='one'/><child link='two'/>"
    "<origin xyz='0 -0.475 0' rpy='-1.5707963267948966 0 0'/><axis xyz='0 0 1'/></joint></robot>";

enum { COUNT = 60 };

static void simulate(double (*q)[2], td_pose *seen, const td_robot *robot, const td_pose *rig,
                     const td_pose *target, double sigma)
{
    td_random random = td_random_seed(4, 0);
    td_pose root_from_link[TD_ROBOT_MAX_LINKS], rig_from_root = td_pose_inverse(rig);
    for (int i = 0; i < COUNT; i++) {
        q[i][0] = -0.6 + 1.2 * td_random_uniform(&random);
        q[i][1] = 6.2 * td_random_uniform(&random);
        td_robot_forward(root_from_link, robot, q[i]);
        td_pose at = td_pose_compose(&rig_from_root, &root_from_link[2]);
        seen[i] = td_pose_compose(&at, target);
        td_pose turn = td_pose_identity();
        double omega[3];
        for (int k = 0; k < 3; k++) {
            omega[k] = sigma * td_random_normal(&random);
            seen[i].t[k] += sigma * td_random_normal(&random);
        }
        td_rotation_exp(turn.q, omega);
        td_pose kept = seen[i];
        seen[i] = td_pose_compose(&turn, &seen[i]);
        memcpy(seen[i].t, kept.t, sizeof kept.t);
    }
}

static void test_jacobians(void **state)
{
    (void)state;
    td_error error;
    td_robot *robot;
    double q[COUNT][2];
    td_pose seen[COUNT], rig = td_pose_exp((double[]){0.3, -0.4, 0.2, 2.0, 0.5, 1.0}),
                         target = td_pose_exp((double[]){-1, 0.5, 0.7, 0.2, -0.5, 0.4});
    check_ok(
        td_robot_parse(&robot, positioner_urdf, strlen(positioner_urdf), NULL, 0, "positioner.urdf", &error),
        error);
    for (int reversed = 0; reversed < 2; reversed++) {
        bool used[COUNT] = {true, true, true};
        td_kinematic_data data = {robot, reversed ? 2 : 0, reversed ? 0 : 2, 3, q[0], seen};
        td_kin_model m = {
            .data = &data, .joints = 2, .joint = {0, 1}, .sigma_rad = 0.1, .sigma_m = 0.2, .used = used};
        td_kinematic_options options = td_kinematic_options_default();
        td_kin_problem p;
        simulate(q, seen, robot, &rig, &target, 0.2);
        m.mount_from_rig = rig;
        m.link_from_target = target;
        for (int i = 0; i < 12; i++) m.correction[i] = 0.03 * (i % 5) - 0.05;
        check_ok(td_kin_problem_new(&p, &m, &options, &error), error);
        check_problem_jacobians(p.problem, 1e-6);
        td_kin_problem_free(&p);
    }
    td_robot_free(&robot);
}

static void test_simulated(void **state)
{
    (void)state;
    td_error error;
    td_robot *robot, *truth;
    double q[COUNT][2];
    td_pose seen[COUNT], rig = td_pose_exp((double[]){0.3, -0.4, 0.2, 2.0, 0.5, 1.0}),
                         target = td_pose_exp((double[]){-1, 0.5, 0.7, 0.2, -0.5, 0.4});
    size_t size = strlen(positioner_urdf);
    check_ok(td_robot_parse(&robot, positioner_urdf, size, NULL, 0, "positioner.urdf", &error), error);
    check_ok(td_robot_parse(&truth, positioner_urdf, size, NULL, 0, "positioner.urdf", &error), error);
    for (int l = 1; l < 3; l++)
        truth->link[l].parent_from_link = td_pose_perturb(
            &truth->link[l].parent_from_link, (double[]){0.01 * l, -0.02, 0.015, 0.01, -0.02, 0.012 * l});
    for (int noisy = 0; noisy < 2; noisy++) {
        double sigma = noisy * 5e-4;
        td_kinematic *k;
        simulate(q, seen, truth, &rig, &target, sigma);
        td_kinematic_data data = {robot, 0, 2, COUNT, q[0], seen};
        td_kinematic_options options = td_kinematic_options_default();
        options.outlier_sigma = 0;
        check_ok(td_kinematic_solve(&k, &data, &options, &error), error);
        print_message("sigma %.3g: found %.4g rad, %.4g m\n", sigma, k->sigma_rad, k->sigma_m);
        for (int i = 0; i < COUNT && !noisy; i++) {
            td_pose said = td_kinematic_predict(k, &data, q[i]), back = td_pose_inverse(&seen[i]),
                    d = td_pose_compose(&back, &said);
            check_near(td_pose_angle(&d), 0, 1e-6);
            check_near(td_pose_distance(&d), 0, 1e-6);
        }
        /* 174 residuals each: 5.4 % is one standard deviation, four allowed. */
        if (noisy) check_near(k->sigma_rad / sigma, 1, 0.22);
        if (noisy) check_near(k->sigma_m / sigma, 1, 0.22);
        td_kinematic_free(&k);
    }
    td_robot_free(&robot);
    td_robot_free(&truth);
}

static void test_real(void **state)
{
    (void)state;
    td_error error;
    td_robot *robot;
    json_t *root;
    const char *folder = getenv("TELEDIMOS_DATA"), *key;
    static double q[512][2], held_q[512][2];
    static td_pose seen[512], held[512];
    size_t count = 0, held_count = 0, at = 0;
    char path[1024];
    snprintf(path, sizeof path, "%s/industrial-kinematic/measurements.yaml", folder ? folder : "");
    if (!folder || td_document_read(&root, path, &error) != TD_OK) {
        print_message("skipped: no industrial-kinematic in $TELEDIMOS_DATA\n");
        skip();
    }
    json_t *value;
    json_object_foreach(root, key, value)
    {
        json_t *p = json_object_get(value, "pose"), *joints = json_object_get(value, "target_joints");
        bool hold = at++ % 5 == 2;
        td_pose *pose = hold ? &held[held_count] : &seen[count];
        static const char *const name[] = {"qw", "qx", "qy", "qz", "x", "y", "z"};
        double length = 0;
        for (int k = 0; k < 7; k++)
            *(k < 4 ? &pose->q[k] : &pose->t[k - 4]) = json_number_value(json_object_get(p, name[k]));
        for (int k = 0; k < 4; k++) length = hypot(length, pose->q[k]);
        for (int k = 0; k < 4; k++) pose->q[k] /= length;
        for (size_t k = 0; k < 2; k++)
            (hold ? held_q[held_count] : q[count])[k] = json_number_value(json_array_get(joints, k));
        *(hold ? &held_count : &count) += 1;
    }
    json_decref(root);
    check_ok(
        td_robot_parse(&robot, positioner_urdf, strlen(positioner_urdf), NULL, 0, "positioner.urdf", &error),
        error);
    for (int corrected = 0; corrected < 2; corrected++) {
        td_kinematic *k;
        td_kinematic_data data = {robot, 0, 2, count, q[0], seen};
        td_kinematic_options options = td_kinematic_options_default();
        double mm = 0, deg = 0, worst_mm = 0, worst_deg = 0;
        if (!corrected) options.sigma_origin_m = options.sigma_origin_rad = 0;
        check_ok(td_kinematic_solve(&k, &data, &options, &error), error);
        for (size_t i = 0; i < held_count; i++) {
            td_pose said = td_kinematic_predict(k, &data, held_q[i]), back = td_pose_inverse(&held[i]),
                    d = td_pose_compose(&back, &said);
            double m = 1e3 * td_pose_distance(&d), a = DEGREES * td_pose_angle(&d);
            mm += m / (double)held_count;
            deg += a / (double)held_count;
            worst_mm = fmax(worst_mm, m);
            worst_deg = fmax(worst_deg, a);
        }
        print_message(
            "%s: %zu of %zu poses used, %zu held out: mean %.3f mm, %.4f deg; worst %.3f mm, %.4f deg; "
            "sigma of an axis %.3f mm, %.4f deg\n",
            corrected ? "origins free" : "origins held", k->used, count, held_count, mm, deg, worst_mm,
            worst_deg, 1e3 * k->sigma_m, DEGREES * k->sigma_rad);
        for (int j = 0; j < 2 && corrected; j++)
            print_message("  %s: %.3f %.3f %.3f deg, %.2f %.2f %.2f mm\n", robot->joint[j].name,
                          DEGREES * k->correction[j][0], DEGREES * k->correction[j][1],
                          DEGREES * k->correction[j][2], 1e3 * k->correction[j][3], 1e3 * k->correction[j][4],
                          1e3 * k->correction[j][5]);
        if (corrected) {
            check_less(mm, 2);
            check_less(deg, 0.2);
        }
        td_kinematic_free(&k);
    }
    td_robot_free(&robot);
}

static void test_bad_input(void **state)
{
    (void)state;
    td_error error;
    td_robot *robot;
    td_kinematic *k;
    double q[8][2];
    td_pose seen[8];
    check_ok(
        td_robot_parse(&robot, positioner_urdf, strlen(positioner_urdf), NULL, 0, "positioner.urdf", &error),
        error);
    for (int i = 0; i < 8; i++) {
        q[i][0] = 0.1 * i;
        q[i][1] = 0.5;
        seen[i] = td_pose_identity();
    }
    td_kinematic_data data = {robot, 0, 2, 5, q[0], seen};
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_DATA, error, "5 poses");
    data.count = 8;
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_DATA, error, "joint turn stands still");
    q[3][1] = NAN;
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_ARGUMENT, error, "pose 3: joint turn");
    data.link = 0;
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_DATA, error, "no moving joint");
    data.link = 7;
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_ARGUMENT, error, "links 0 and 7");
    data.link = 2;
    seen[1].t[0] = NAN;
    check_fails(td_kinematic_solve(&k, &data, NULL, &error), TD_ERROR_ARGUMENT, error, "pose 1");
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_jacobians), cmocka_unit_test(test_simulated),
                                       cmocka_unit_test(test_real), cmocka_unit_test(test_bad_input)};
    td_linalg_single_thread();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
