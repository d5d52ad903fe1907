/* Proves that a robot is what its URDF and YAML say:
 * - forward kinematics and Jacobians of every link against Orocos KDL, which gets its own tree from urdfdom,
 * on our excavator and on robots that Debian ships (1e-12 of the size: a chain of 10 products in doubles);
 * - the Jacobian and the derivative by fixed transforms against central differences (1e-9: step 1e-6, so h^2
 *   and eps / h are below 1e-10), a shifting joint among them;
 * - cylinders: lengths against triangles solved by the law of cosines, lever arms against differences, length
 *   to angle and back over the whole range (1e-10 rad, where the shortest lever arm is 0.12 m);
 * - the excavator's data against the figures they are from;
 * - that each bad file is refused in one sentence with its name, and that urdfdom prints nothing meanwhile.
 * Blind to whether the figures of the excavator are a real machine's, and to what the assumed ones should be.
 */
#include <stdbool.h>

#include <fcntl.h>
#include <unistd.h>

#include "core/random.h"
#include "core/robot.h"
#include "tests/check.h"
#include "tests/core/robot_kdl.h"
#include "tests/scratch.h"

#define PI 3.14159265358979323846
#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"
#define DART "/usr/share/doc/dart/data/"

static td_robot *read_robot(const char *path)
{
    td_error error;
    td_robot *robot = NULL;
    check_ok(td_robot_read(&robot, path, &error), error);
    return robot;
}

static td_robot *parse_robot(const char *urdf, const char *yaml)
{
    td_error error;
    td_robot *robot = NULL;
    check_ok(td_robot_parse(&robot, urdf, strlen(urdf), yaml, yaml ? strlen(yaml) : 0, "test", &error),
             error);
    return robot;
}

/* Every kind of joint, turned origins, and a skew axis that is no unit vector. */
static const char ODD[] =
    "<robot name='odd'><link name='a'/><link name='b'/><link name='c'/><link name='d'/><link name='e'/>"
    "<link name='f'/>"
    "<joint name='fixed' type='fixed'><parent link='b'/><child link='e'/>"
    "<origin xyz='0.1 0.2 0.3' rpy='0.3 -0.2 1'/></joint>"
    "<joint name='slide' type='prismatic'><parent link='a'/><child link='b'/><axis xyz='1 2 -2'/>"
    "<origin xyz='1 2 3' rpy='0.1 0.2 0.3'/><limit lower='-1' upper='2' effort='5' velocity='3'/></joint>"
    "<joint name='turn' type='revolute'><parent link='e'/><child link='c'/><axis xyz='0.2 0.3 -4'/>"
    "<origin xyz='-1 0.5 0.2' rpy='1 -0.5 2'/><limit lower='-2' upper='1' effort='7' velocity='6'/></joint>"
    "<joint name='spin' type='continuous'><parent link='c'/><child link='d'/><axis xyz='0 -1 0.1'/>"
    "<origin xyz='0.4 0.5 0.6'/></joint>"
    "<joint name='side' type='revolute'><parent link='b'/><child link='f'/>"
    "<limit lower='-2' upper='1' effort='7' velocity='6'/></joint></robot>";

static void random_state(double *q, const td_robot *robot, td_random *random)
{
    for (int k = 0; k < robot->joint_count; k++) {
        const double low = fmax(robot->joint[k].lower, -4), high = fmin(robot->joint[k].upper, 4);
        q[k] = low + (high - low) * td_random_uniform(random);
    }
}

/* ---- against KDL ---- */

#ifdef TD_TEST_KDL
static void compare_link(const td_robot *robot, const kdl_robot *peer, const double *q, const double *peer_q,
                         const int *ours, const td_pose *pose, int link, double *worst)
{
    double rotation[9], t[3], r[9], theirs[6 * TD_ROBOT_MAX_JOINTS], jacobian[6 * TD_ROBOT_MAX_JOINTS];
    const int n = robot->joint_count;
    (void)q;
    assert_true(kdl_robot_solve(rotation, t, theirs, peer, peer_q, robot->link[link].name));
    td_pose_rotation(r, pose + link);
    for (int i = 0; i < 9; i++) *worst = fmax(*worst, fabs(r[i] - rotation[i]));
    for (int i = 0; i < 3; i++) *worst = fmax(*worst, fabs(pose[link].t[i] - t[i]));
    td_robot_jacobian(jacobian, robot, pose, link);
    for (int k = 0; k < n; k++) {
        double w[3], v[3];
        for (int i = 0; i < 3; i++) {
            v[i] = theirs[i * n + k];
            w[i] = theirs[(3 + i) * n + k];
        }
        /* KDL's velocity is the link origin's, ours the one of the body's point at the root: v - w x t. */
        const double tau[3] = {v[0] - (w[1] * t[2] - w[2] * t[1]), v[1] - (w[2] * t[0] - w[0] * t[2]),
                               v[2] - (w[0] * t[1] - w[1] * t[0])};
        for (int i = 0; i < 3; i++) {
            *worst = fmax(*worst, fabs(jacobian[i * n + ours[k]] - w[i]));
            *worst = fmax(*worst, fabs(jacobian[(3 + i) * n + ours[k]] - tau[i]));
        }
    }
}

static void compare_with_kdl(const char *path)
{
    if (access(path, R_OK) != 0) {
        print_message("SKIPPED: %s is not there (package dart-doc)\n", path);
        return;
    }
    td_robot *robot = read_robot(path);
    kdl_robot *peer = kdl_robot_read(path);
    td_random random = td_random_seed(5, 1);
    td_pose pose[TD_ROBOT_MAX_LINKS];
    double worst = 0;
    int ours[TD_ROBOT_MAX_JOINTS];
    assert_non_null(peer);
    assert_int_equal(kdl_robot_joint_count(peer), robot->joint_count);
    for (int k = 0; k < robot->joint_count; k++) {
        ours[k] = td_robot_find_joint(robot, kdl_robot_joint_name(peer, k));
        assert_true(ours[k] >= 0);
    }
    for (int trial = 0; trial < 20; trial++) {
        double q[TD_ROBOT_MAX_JOINTS], peer_q[TD_ROBOT_MAX_JOINTS];
        random_state(q, robot, &random);
        for (int k = 0; k < robot->joint_count; k++) peer_q[k] = q[ours[k]];
        td_robot_forward(pose, robot, q);
        for (int i = 0; i < robot->link_count; i++)
            compare_link(robot, peer, q, peer_q, ours, pose, i, &worst);
    }
    print_message("%-28s %2d links %2d joints: KDL apart by %.1e\n", robot->name, robot->link_count,
                  robot->joint_count, worst);
    check_less(worst, 1e-12);
    kdl_robot_free(peer);
    td_robot_free(&robot);
}
#endif

static void test_kdl(void **state)
{
#ifdef TD_TEST_KDL
    char *path = td_path_join(*state, "odd.urdf");
    td_error error;
    check_ok(td_file_write(path, ODD, strlen(ODD), &error), error);
    compare_with_kdl(ZX200);
    compare_with_kdl(path);
    compare_with_kdl(DART "urdf/KR5/KR5 sixx R650.urdf");
    compare_with_kdl(DART "urdf/wam/wam.urdf");
    compare_with_kdl(DART "urdf/drchubo/drchubo.urdf");
    compare_with_kdl(DART "urdf/test/issue838.urdf");
    compare_with_kdl(DART "urdf/test/joint_properties.urdf");
    compare_with_kdl(DART "sdf/atlas/atlas_v3_no_head.urdf");
    free(path);
#else
    (void)state;
    print_message("SKIPPED: built without Orocos KDL (package liborocos-kdl-dev)\n");
    skip();
#endif
}

/* ---- derivatives ---- */

/* The left perturbation that leads from a to b, over 2 h. */
static void difference(double xi[6], const td_pose *a, const td_pose *b, double h)
{
    const td_pose inverse = td_pose_inverse(a);
    const td_pose apart = td_pose_compose(b, &inverse);
    td_pose_log(xi, &apart);
    for (int i = 0; i < 6; i++) xi[i] /= 2 * h;
}

static void check_derivatives(const td_robot *robot)
{
    const double h = 1e-6;
    td_random random = td_random_seed(6, 1);
    double q[TD_ROBOT_MAX_JOINTS], jacobian[6 * TD_ROBOT_MAX_JOINTS], xi[6], derivative[36], largest = 0;
    td_pose pose[TD_ROBOT_MAX_LINKS], low[TD_ROBOT_MAX_LINKS], high[TD_ROBOT_MAX_LINKS];
    const int n = robot->joint_count;
    td_robot *moved = malloc(sizeof *moved);
    assert_non_null(moved);
    random_state(q, robot, &random);
    td_robot_forward(pose, robot, q);
    for (int k = 0; k < n; k++) {
        const double kept = q[k];
        q[k] = kept - h;
        td_robot_forward(low, robot, q);
        q[k] = kept + h;
        td_robot_forward(high, robot, q);
        q[k] = kept;
        for (int link = 0; link < robot->link_count; link++) {
            td_robot_jacobian(jacobian, robot, pose, link);
            difference(xi, low + link, high + link, h);
            for (int i = 0; i < 6; i++) {
                check_near(jacobian[i * n + k], xi[i], 1e-9 * 10);
                largest = fmax(largest, fabs(xi[i]));
            }
        }
    }
    assert_true(n == 0 || largest > 0.5);
    largest = 0;
    for (int at = 0; at < robot->link_count; at++)
        for (int c = 0; c < 6; c++) {
            double step[6] = {0};
            memcpy(moved, robot, sizeof *moved);
            const bool root = robot->link[at].parent < 0; /* has no fixed transform */
            step[c] = root ? 0 : h;
            moved->link[at].parent_from_link = td_pose_perturb(&robot->link[at].parent_from_link, step);
            td_robot_forward(high, moved, q);
            step[c] = -step[c];
            moved->link[at].parent_from_link = td_pose_perturb(&robot->link[at].parent_from_link, step);
            td_robot_forward(low, moved, q);
            for (int link = 0; link < robot->link_count; link++) {
                td_robot_link_derivative(derivative, robot, pose, link, at);
                difference(xi, low + link, high + link, h);
                for (int i = 0; i < 6; i++) {
                    check_near(derivative[6 * i + c], xi[i], 1e-9 * 10);
                    largest = fmax(largest, fabs(xi[i]));
                }
            }
        }
    assert_true(largest >= 1);
    free(moved);
}

static void test_derivatives(void **state)
{
    (void)state;
    td_robot *zx200 = read_robot(ZX200), *odd = parse_robot(ODD, NULL);
    check_derivatives(zx200);
    check_derivatives(odd);
    td_robot_free(&zx200);
    td_robot_free(&odd);
}

/* ---- what is read ---- */

static void test_content(void **state)
{
    (void)state;
    td_robot *robot = parse_robot(ODD, NULL);
    const char *const links[] = {"a", "b", "e", "c", "d", "f"}, *const joints[] = {"slide", "turn", "spin",
                                                                                   "side"};
    assert_string_equal(robot->name, "odd");
    assert_int_equal(robot->link_count, 6);
    assert_int_equal(robot->joint_count, 4);
    for (int i = 0; i < 6; i++) {
        assert_string_equal(robot->link[i].name, links[i]);
        assert_int_equal(td_robot_find_link(robot, links[i]), i);
        assert_true(robot->link[i].parent < i);
    }
    for (int k = 0; k < 4; k++) {
        assert_string_equal(robot->joint[k].name, joints[k]);
        assert_int_equal(td_robot_find_joint(robot, joints[k]), k);
        assert_int_equal(robot->link[robot->joint[k].link].joint, k);
    }
    assert_int_equal(td_robot_find_link(robot, "fixed"), -1);
    assert_int_equal(td_robot_find_joint(robot, "fixed"), -1);
    const td_robot_joint *slide = robot->joint, *spin = robot->joint + 2;
    assert_int_equal(slide->kind, TD_JOINT_PRISMATIC);
    check_near(slide->axis[2], -2. / 3, 1e-15);
    assert_true(slide->lower == -1 && slide->upper == 2 && slide->speed == 3 && slide->effort == 5);
    assert_true(isinf(slide->acceleration));
    assert_true(spin->lower == -INFINITY && spin->upper == INFINITY && isinf(spin->speed));
    double q[4] = {0, 0, 100, 0};
    int joint = -1;
    assert_true(td_robot_within_limits(robot, q, &joint));
    assert_int_equal(joint, -1);
    q[1] = 1.1;
    assert_false(td_robot_within_limits(robot, q, &joint));
    assert_int_equal(joint, 1);
    q[1] = NAN;
    assert_false(td_robot_within_limits(robot, q, NULL));
    td_robot_free(&robot);
    assert_null(robot);
    td_robot_free(&robot);
}

/* Shapes as they stand; moments of inertia turned by the inertial's quarter turn about z: xx and yy change
 * places, xy its sign. */
static void test_shapes_and_inertia(void **state)
{
    (void)state;
    td_robot *robot = parse_robot(
        "<robot name='r'><link name='a'><inertial><origin xyz='1 2 3' rpy='0 0 1.5707963267948966'/><mass "
        "value='5'/>"
        "<inertia ixx='1' iyy='2' izz='2.5' ixy='0.1' ixz='0.2' iyz='0.3'/></inertial>"
        "<collision><geometry><box size='1 2 3'/></geometry></collision>"
        "<collision><origin xyz='0 0 7'/><geometry><cylinder radius='0.5' length='4'/></geometry></collision>"
        "<collision><geometry><mesh filename='file:///nothing.stl'/></geometry></collision>"
        "<collision><geometry><sphere radius='0.25'/></geometry></collision></link></robot>",
        NULL);
    const td_robot_link *link = robot->link;
    const double expected[9] = {2, -0.1, -0.3, -0.1, 1, 0.2, -0.3, 0.2, 2.5};
    assert_int_equal(link->shape_count, 3);
    assert_int_equal(link->mesh_count, 1);
    assert_int_equal(link->shape[0].kind, TD_PRIMITIVE_BOX);
    assert_true(link->shape[0].size[0] == 1 && link->shape[0].size[1] == 2 && link->shape[0].size[2] == 3);
    assert_int_equal(link->shape[1].kind, TD_PRIMITIVE_CAPSULE);
    assert_true(link->shape[1].size[0] == 0.5 && link->shape[1].size[1] == 4);
    assert_true(link->shape[1].link_from_shape.t[2] == 7);
    assert_int_equal(link->shape[2].kind, TD_PRIMITIVE_SPHERE);
    assert_true(link->shape[2].size[0] == 0.25);
    assert_true(link->mass_kg == 5 && link->com_m[0] == 1 && link->com_m[1] == 2 && link->com_m[2] == 3);
    for (int i = 0; i < 9; i++) check_near(link->inertia[i], expected[i], 1e-15);
    td_robot_free(&robot);
}

/* ---- cylinders ---- */

/* The angle between sides a and b of a triangle, opposite to c. */
static double angle_between(double a, double b, double c)
{
    return acos((a * a + b * b - c * c) / (2 * a * b));
}

static double side_opposite(double a, double b, double angle)
{
    return sqrt(a * a + b * b - 2 * a * b * cos(angle));
}

/* The bucket's four-bar solved triangle by triangle: between the pivots, between the bars, and from the root
 * to the eye. Directions of the points are those of the data, angles are counted about the bucket pin. */
static double bucket_length(const td_cylinder *c, double q)
{
    const double pin = 2.889, px = c->parent_pivot[0] - pin, pz = c->parent_pivot[2];
    const double to_parent = hypot(px, pz), to_child = hypot(c->child_pivot[0], c->child_pivot[2]);
    /* y turns z towards x, so a direction's elevation falls as q grows. */
    const double child = atan2(c->child_pivot[2], c->child_pivot[0]) - q;
    const double gamma = remainder(atan2(pz, px) - child, 2 * PI);
    const double pivots = side_opposite(to_parent, to_child, gamma);
    const double at_parent = angle_between(to_parent, pivots, to_child) * (gamma < 0 ? -1 : 1);
    const double at_eye = angle_between(c->parent_bar_m, pivots, c->child_bar_m);
    /* Seen from the parent's pivot: the pin, the child's pivot, the eye. */
    const double eye = atan2(-pz, -px) + at_parent + at_eye;
    const double root = atan2(c->root[2] - pz, c->root[0] - c->parent_pivot[0]);
    const double root_far = hypot(c->root[2] - pz, c->root[0] - c->parent_pivot[0]);
    return side_opposite(root_far, c->parent_bar_m, root - eye);
}

static void test_cylinder_lengths(void **state)
{
    (void)state;
    td_robot *robot = read_robot(ZX200);
    const td_cylinder *boom = robot->cylinder, *arm = boom + 1, *bucket = boom + 2;
    assert_int_equal(robot->cylinder_count, 3);
    for (int i = 0; i <= 1000; i++) {
        double length = 0;
        double q = -1.137 + 1.905 * i / 1000;
        assert_true(td_cylinder_length(&length, NULL, robot, boom, q));
        /* The boom's root is 0.759 m from the pin, 52.54 deg below it; the eye 2.428 m, 23.05 deg up. */
        check_near(length, side_opposite(0.7596, 2.428, 23.05 * PI / 180 - q + atan2(0.603, 0.462)), 1e-3);
        q = 0.594 + 2.093 * i / 1000;
        assert_true(td_cylinder_length(&length, NULL, robot, arm, q));
        check_near(length, side_opposite(2.509, 0.873, q - 0.505), 1e-3);
        q = -0.622 + 2.994 * i / 1000;
        assert_true(td_cylinder_length(&length, NULL, robot, bucket, q));
        /* The law's cosine is within 0.005 of 1 here, where acos magnifies rounding tenfold. */
        check_near(length, bucket_length(bucket, q), 1e-12);
    }
    td_robot_free(&robot);
}

static void check_cylinder(const td_robot *robot, const td_cylinder *c, double tolerance)
{
    const td_robot_joint *joint = robot->joint + c->joint;
    const double h = 1e-5;
    double least = INFINITY, most = 0, worst = 0, worst_back = 0;
    for (int i = 0; i <= 2000; i++) {
        const double q = joint->lower + (joint->upper - joint->lower) * i / 2000;
        double length = 0, lever = 0, low = 0, high = 0, back = NAN, again = 0;
        assert_true(td_cylinder_length(&length, &lever, robot, c, q));
        assert_true(td_cylinder_length(&low, NULL, robot, c, q - h));
        assert_true(td_cylinder_length(&high, NULL, robot, c, q + h));
        check_near(lever, (high - low) / (2 * h), 1e-8);
        assert_true(td_cylinder_angle(&back, robot, c, length));
        worst = fmax(worst, fabs(back - q));
        assert_true(td_cylinder_length(&again, NULL, robot, c, back));
        worst_back = fmax(worst_back, fabs(again - length));
        least = fmin(least, fabs(lever));
        most = fmax(most, fabs(lever));
    }
    print_message(
        "%-8s lever arm %.3f to %.3f m, force %.0f kN, torque up to %.0f kN m; inverse apart by %.1e "
        "rad, %.1e m\n",
        c->name, least, most, c->count * PI / 4 * c->bore_m * c->bore_m * c->pressure_pa / 1e3,
        c->count * PI / 4 * c->bore_m * c->bore_m * c->pressure_pa * most / 1e3, worst, worst_back);
    check_less(worst, tolerance);
    check_less(worst_back, tolerance);
    double angle = 0;
    assert_false(td_cylinder_angle(&angle, robot, c, 0.5 * c->shortest_m));
    assert_false(td_cylinder_angle(&angle, robot, c, 2 * c->longest_m));
    assert_false(td_cylinder_angle(&angle, robot, c, NAN));
}

/* A cylinder whose plane, axis and fixed transform are turned every way: lengths must be as with the plain
 * one. */
static void test_turned_cylinder(void **state)
{
    (void)state;
    td_robot *plain = read_robot(ZX200), *turned = malloc(sizeof *turned);
    td_random random = td_random_seed(9, 1);
    assert_non_null(turned);
    for (int trial = 0; trial < 50; trial++)
        for (int i = 0; i < plain->cylinder_count; i++) {
            memcpy(turned, plain, sizeof *turned);
            td_cylinder *c = turned->cylinder + i;
            td_robot_joint *joint = turned->joint + c->joint;
            td_pose *fixed = &turned->link[joint->link].parent_from_link;
            double xi[2][6];
            for (int k = 0; k < 12; k++) xi[k / 6][k % 6] = td_random_normal(&random);
            /* New frames for parent and child. */
            const td_pose parent = td_pose_exp(xi[0]);
            td_pose child = td_pose_exp(xi[1]), back;
            memset(child.t, 0, sizeof child.t);
            back = td_pose_inverse(&child);
            *fixed = td_pose_compose(&parent, fixed);
            *fixed = td_pose_compose(fixed, &back);
            td_pose_rotate(joint->axis, &child, joint->axis);
            td_pose_transform(c->root, &parent, c->root);
            td_pose_transform(c->parent_pivot, &parent, c->parent_pivot);
            td_pose_transform(c->eye, &child, c->eye);
            td_pose_transform(c->child_pivot, &child, c->child_pivot);
            const double q = joint->lower + (joint->upper - joint->lower) * td_random_uniform(&random);
            double a = 0, b = 1, lever_a = 0, lever_b = 1, angle = 0;
            assert_true(td_cylinder_length(&a, &lever_a, plain, plain->cylinder + i, q));
            assert_true(td_cylinder_length(&b, &lever_b, turned, c, q));
            check_near(a, b, 1e-13);
            check_near(lever_a, lever_b, 1e-12);
            assert_true(td_cylinder_angle(&angle, turned, c, b));
            check_near(angle, q, 1e-10);
        }
    free(turned);
    td_robot_free(&plain);
}

static void test_cylinder_maps(void **state)
{
    (void)state;
    td_robot *robot = read_robot(ZX200);
    for (int i = 0; i < robot->cylinder_count; i++) check_cylinder(robot, robot->cylinder + i, 1e-10);
    td_robot_free(&robot);
}

/* ---- the excavator's figures ---- */

/* The strokes give the joints' limits, the torques are those of the URDF, to the figures' last digit. */
static void test_excavator_limits(void **state)
{
    (void)state;
    td_robot *robot = read_robot(ZX200);
    double angle = 0;
    /* A wider limit, so that the angle at the stroke's end is inside. */
    robot->joint[1].upper = 0.9;
    robot->joint[1].lower = -1.3;
    assert_true(td_cylinder_angle(&angle, robot, robot->cylinder, 1.825));
    check_near(angle, 0.768, 2e-3);
    assert_true(td_cylinder_angle(&angle, robot, robot->cylinder, 3.084));
    check_near(angle, -1.221, 2e-3);
    robot->joint[2].lower = 0.52;
    robot->joint[2].upper = 2.9;
    assert_true(td_cylinder_angle(&angle, robot, robot->cylinder + 1, 1.64));
    check_near(angle, 0.594, 0.02);
    assert_true(td_cylinder_angle(&angle, robot, robot->cylinder + 1, 3.10));
    check_near(angle, 2.687, 0.02);
    td_robot_free(&robot);
    robot = read_robot(ZX200);
    for (int i = 0; i < 3; i++) {
        const td_cylinder *c = robot->cylinder + i;
        const td_robot_joint *joint = robot->joint + c->joint;
        double most = 0;
        for (int s = 0; s <= 2000; s++) {
            double lever = 0;
            td_cylinder_length(NULL, &lever, robot, c,
                               joint->lower + (joint->upper - joint->lower) * s / 2000);
            most = fmax(most, fabs(lever));
        }
        check_near(joint->effort / (c->count * PI / 4 * c->bore_m * c->bore_m * c->pressure_pa * most), 1,
                   2e-3);
    }
    assert_true(robot->joint[0].acceleration == 0.35 && robot->joint[3].acceleration == 4.2);
    /* 4 Hz on 20.5 t; 15 mm of sag. */
    check_near(sqrt(robot->suspension_n_m[0] / 20500) / (2 * PI), 4, 0.05);
    check_near(20500 * 9.81 / robot->suspension_n_m[0], 0.015, 0.001);
    td_robot_free(&robot);
}

static void test_excavator_masses(void **state)
{
    (void)state;
    td_robot *robot = read_robot(ZX200);
    double mass = 0, body[3] = {0};
    const double axis[3] = {0.108, -0.034, 1.121};
    for (int i = 0; i < robot->link_count; i++) {
        const td_robot_link *link = robot->link + i;
        mass += link->mass_kg;
        if (link->mass_kg == 0) continue;
        /* Moments that a body can have: none above the sum of the others. */
        const double x = link->inertia[0], y = link->inertia[4], z = link->inertia[8];
        assert_true(x > 0 && y > 0 && z > 0 && x <= y + z && y <= x + z && z <= x + y);
    }
    check_near(mass, 20500, 1);
    for (int k = 0; k < 3; k++)
        body[k] = (7000 * (robot->link[0].com_m[k] - axis[k]) + 9520 * robot->link[1].com_m[k]) / 16520;
    check_near(body[0], -0.606, 1e-3);
    check_near(body[1], 0, 1e-3);
    check_near(body[2], -0.117, 1e-3);
    td_robot_free(&robot);
}

/* The published reach and depth of a 20 t machine are about 9.9 m and 6.7 m (with the 2.91 m arm). */
static void test_excavator_reach(void **state)
{
    (void)state;
    enum { STEPS = 60 };
    td_robot *robot = read_robot(ZX200);
    td_pose pose[TD_ROBOT_MAX_LINKS];
    double reach = 0, depth = 0, height = 0, ground = 0;
    const int tip = td_robot_find_link(robot, "bucket_tip");
    for (int a = 0; a <= STEPS; a++)
        for (int b = 0; b <= STEPS; b++)
            for (int c = 0; c <= STEPS; c++) {
                const int step[3] = {a, b, c};
                double q[4] = {0};
                for (int k = 0; k < 3; k++) {
                    const td_robot_joint *joint = robot->joint + k + 1;
                    q[k + 1] = joint->lower + (joint->upper - joint->lower) * step[k] / STEPS;
                }
                td_robot_forward(pose, robot, q);
                const double far = pose[tip].t[0] - pose[1].t[0], up = pose[tip].t[2];
                reach = fmax(reach, far);
                if (fabs(up) < 0.1) ground = fmax(ground, far);
                depth = fmax(depth, -up);
                height = fmax(height, up);
            }
    print_message("excavator: reach %.2f m, on the ground %.2f m, depth %.2f m, height %.2f m\n", reach,
                  ground, depth, height);
    check_near(reach, 9.9, 0.3);
    check_near(ground, 9.7, 0.3);
    check_near(depth, 6.5, 0.4);
    td_robot_free(&robot);
}

/* ---- bad files ---- */

#define LINKS(text) "<robot name='r'><link name='a'/><link name='b'/>" text "</robot>"
#define JOINT(type, text)                                                                                    \
    LINKS("<joint name='j' type='" type "'><parent link='a'/><child link='b'/>" text "</joint>")
#define LIMIT "<limit lower='-1' upper='1' effort='1' velocity='1'/>"
#define INERTIAL(mass, ixx)                                                                                  \
    "<robot name='r'><link name='a'><inertial><mass value='" mass "'/><inertia ixx='" ixx                    \
    "' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>"

static const struct {
    const char *urdf, *words;
} BAD_URDF[] = {
    {"", "is empty"},
    {"no xml at all", "is no XML: line 1"},
    {"<robot name='r'><link name='a'/>", "is no XML"},
    {"<robot name='r'><link name='a'></robot>", "is no XML"},
    {"<html/>", "root is <html> instead of <robot>"},
    {"<robot name='r'/>", "no link"},
    {"<robot><link name='a'/></robot>", "is no sound URDF"},
    {"<!DOCTYPE robot [<!ENTITY a 'b'>]><robot name='r'><link name='a'/></robot>", "document type"},
    {"<robot name='r'><link name='\xff'/></robot>", "not UTF-8"},
    {"<robot name='r'><link/></robot>", "a link has no name"},
    {LINKS("<link name='a'/>"), "link 'a' is given twice"},
    {LINKS(""), "two roots, 'a' and 'b'"},
    {LINKS("<joint name='j' type='fixed'><parent link='a'/><child link='c'/></joint>"),
     "'c' that is not there"},
    {LINKS("<joint name='j' type='fixed'><parent link='x'/><child link='b'/></joint>"),
     "'x' that is not there"},
    {LINKS("<joint name='j' type='fixed'><parent link='a'/></joint>"), "lacks its <child"},
    {LINKS("<joint name='j' type='fixed'><child link='b'/></joint>"), "lacks its <parent"},
    {LINKS("<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"
           "<joint name='k' type='fixed'><parent link='b'/><child link='a'/></joint>"),
     "close a loop"},
    {LINKS("<joint name='j' type='fixed'><parent link='b'/><child link='b'/></joint>"), "'b' does not hang"},
    {LINKS("<link name='c'/><joint name='j' type='fixed'><parent link='a'/><child link='c'/></joint>"
           "<joint name='k' type='fixed'><parent link='a'/><child link='b'/></joint>"
           "<joint name='l' type='fixed'><parent link='b'/><child link='c'/></joint>"),
     "'c' hangs on two joints: a loop"},
    {LINKS("<link name='c'/><joint name='j' type='fixed'><parent link='b'/><child link='c'/></joint>"
           "<joint name='k' type='fixed'><parent link='c'/><child link='b'/></joint>"),
     "does not hang on the root"},
    {LINKS("<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"
           "<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"),
     "joint 'j' is given twice"},
    {JOINT("floating", ""), "'j' is of the type 'floating'"},
    {JOINT("planar", ""), "'j' is of the type 'planar'"},
    {JOINT("", ""), "'j' is of the type ''"},
    {JOINT("revolute", LIMIT "<mimic joint='j'/>"), "'j' mimics"},
    {JOINT("revolute", ""), "no sound URDF: Joint [j]"},
    {JOINT("revolute", "<limit lower='1' upper='-1' effort='1' velocity='1'/>"),
     "'j' are the wrong way round"},
    {JOINT("prismatic", "<limit lower='1' upper='1' effort='1' velocity='1'/>"),
     "'j' are the wrong way round"},
    {JOINT("revolute", "<limit lower='-1' upper='1' effort='1' velocity='-1'/>"), "must not be negative"},
    {JOINT("revolute", "<limit lower='-1' upper='1' effort='-1' velocity='1'/>"), "must not be negative"},
    {JOINT("revolute", "<limit lower='nan' upper='1' effort='1' velocity='1'/>"), "test:"},
    {JOINT("revolute", "<limit lower='-1' upper='1' effort='1' velocity='1e999'/>"), "test:"},
    {JOINT("revolute", LIMIT "<axis xyz='0 0 0'/>"), "axis of joint 'j' has no direction"},
    {JOINT("revolute", LIMIT "<axis xyz='nan 0 0'/>"), "test:"},
    {JOINT("revolute", LIMIT "<axis xyz='1 0'/>"), "test:"},
    {JOINT("fixed", "<origin xyz='1e300 0 0'/>"), "origin of joint 'j' is out of bounds"},
    {JOINT("fixed", "<origin xyz='nan 0 0'/>"), "test:"},
    {JOINT("fixed", "<origin xyz='one two three'/>"), "test:"},
    {INERTIAL("-1", "1"), "'a' has a negative mass"},
    {INERTIAL("1", "-1"), "'a' has a negative mass or moment"},
    {INERTIAL("nan", "1"), "mass [nan] is not a float: Could not parse inertial element for Link [a]"},
    {INERTIAL("1e200", "1"), "'a' holds a number out of bounds"},
    {"<robot name='r'><link name='a'><collision><geometry><box size='1 0 "
     "1'/></geometry></collision></link></robot>",
     "shape 1 of link 'a' has no size"},
    {"<robot name='r'><link name='a'><collision><geometry><sphere radius='-1'/></geometry></collision></link>"
     "</robot>",
     "shape 1 of link 'a' has no size"},
};

static void check_bad(const char *urdf, size_t size, const char *yaml, const char *words)
{
    td_error error = {0};
    td_robot *robot = NULL;
    const td_status status =
        td_robot_parse(&robot, urdf, size, yaml, yaml ? strlen(yaml) : 0, "test", &error);
    if (status == TD_OK) fail_msg("not refused (%s): %.300s", words, yaml ? yaml : urdf);
    assert_null(robot);
    if (!strstr(error.message, words)) fail_msg("'%s' lacks '%s'", error.message, words);
    assert_true(strncmp(error.message, "test:", 5) == 0);
    assert_null(strchr(error.message, '\n'));
}

/* What is printed meanwhile goes to a file, which must stay empty. */
static void test_bad_urdf(void **state)
{
    char *path = td_path_join(*state, "stderr");
    const int kept = dup(2), file = open(path, O_CREAT | O_RDWR, 0600);
    assert_true(kept >= 0 && file >= 0);
    fflush(stderr);
    dup2(file, 2);
    char message[400] = "";
    for (size_t i = 0; i < sizeof BAD_URDF / sizeof *BAD_URDF && !*message; i++) {
        td_error error = {0};
        td_robot *robot = NULL;
        const char *urdf = BAD_URDF[i].urdf;
        const td_status status = td_robot_parse(&robot, urdf, strlen(urdf), NULL, 0, "test", &error);
        if (status == TD_OK || robot || !strstr(error.message, BAD_URDF[i].words) ||
            strncmp(error.message, "test:", 5) != 0 || strchr(error.message, '\n'))
            snprintf(message, sizeof message, "row %zu: '%.150s' lacks '%s'", i, error.message,
                     BAD_URDF[i].words);
    }
    fflush(stderr);
    dup2(kept, 2);
    const off_t printed = lseek(file, 0, SEEK_END);
    close(kept);
    close(file);
    free(path);
    if (*message) fail_msg("%s", message);
    assert_int_equal(printed, 0);
}

/* Limits hold before anything is built: far too many links, one in another too deep, too large a file. */
static void test_huge_urdf(void **state)
{
    (void)state;
    const size_t room = 40 << 20;
    char *text = malloc(room);
    assert_non_null(text);
    size_t used = (size_t)sprintf(text, "<robot name='r'>");
    for (int i = 0; i < 1000000; i++) used += (size_t)sprintf(text + used, "<link name='l%d'/>", i);
    used += (size_t)sprintf(text + used, "</robot>");
    check_bad(text, used, NULL, "larger than 16 MiB");
    check_bad(text, 10 << 20, NULL, "more links than 256");
    used = (size_t)sprintf(text, "<robot name='r'>");
    for (int i = 0; i < 40; i++) used += (size_t)sprintf(text + used, "<a>");
    for (int i = 0; i < 40; i++) used += (size_t)sprintf(text + used, "</a>");
    used += (size_t)sprintf(text + used, "<link name='a'/></robot>");
    check_bad(text, used, NULL, "nested more than 32 deep");
    used = (size_t)sprintf(text, "<robot name='r'>");
    for (int i = 0; i < 1000000; i++) used += (size_t)sprintf(text + used, "<a>");
    check_bad(text, used, NULL, "nested more than 32 deep");
    used = (size_t)sprintf(text, "<robot name='r'><link name='l0'/>");
    for (int i = 1; i < 100; i++)
        used += (size_t)sprintf(text + used,
                                "<link name='l%d'/><joint name='j%d' type='continuous'><parent link='l%d'/>"
                                "<child link='l%d'/></joint>",
                                i, i, i - 1, i);
    used += (size_t)sprintf(text + used, "</robot>");
    check_bad(text, used, NULL, "more moving joints than 64");
    used = (size_t)sprintf(text, "<robot name='r'><link name='");
    for (int i = 0; i < 64; i++) text[used++] = 'n';
    used += (size_t)sprintf(text + used, "'/></robot>");
    check_bad(text, used, NULL, "longer than 63 bytes");
    used = (size_t)sprintf(text, "<robot name='r'><link name='a'>");
    for (int i = 0; i < 9; i++)
        used +=
            (size_t)sprintf(text + used, "<collision><geometry><sphere radius='1'/></geometry></collision>");
    used += (size_t)sprintf(text + used, "</link></robot>");
    check_bad(text, used, NULL, "9 collision shapes");
    free(text);
}

#define HEAD "teledimos: robot 1\n"
#define DRIVE "root_m: [1, 0, 1], eye_m: [1, 0, 0], "
#define SIZES "bore_m: 0.1, rod_m: 0.05, shortest_m: 0.1, longest_m: 9"
#define CYLINDER(text) HEAD "cylinders: [{name: c, " text "}]\n"
static const struct {
    const char *yaml, *words;
} BAD_YAML[] = {
    {"", "test:"},
    {"cylinders: []\n", "'teledimos: robot 1' is missing"},
    {"teledimos: rig 1\n", "is 'rig 1', but must be 'robot 1'"},
    {HEAD "cylinder: []\n", "cylinder"},
    {HEAD "joints: [{name: nobody}]\n", "'nobody', which is no moving joint"},
    {HEAD "joints: [{name: turn, acceleration_rad_s2: -1}]\n", "acceleration_rad_s2"},
    {HEAD "joints: [{name: turn, acceleration_m_s2: 1}]\n", "acceleration_m_s2"},
    {HEAD "joints: [{name: turn}, {name: turn}]\n", "'turn' is given twice"},
    {HEAD "joints: 3\n", "joints"},
    {CYLINDER("joint: nobody"), "'nobody', which is no moving joint"},
    {CYLINDER("joint: turn, " SIZES), "root_m"},
    {CYLINDER("joint: turn, root_m: [1, 0, 0], " SIZES), "either eye_m"},
    {CYLINDER("joint: turn, four_bar: {}, " DRIVE SIZES), "either eye_m"},
    {CYLINDER("joint: turn, " DRIVE "bore_m: 0.1, rod_m: 0.1, shortest_m: 1, longest_m: 2"), "not thinner"},
    {CYLINDER("joint: turn, " DRIVE "bore_m: 0.1, rod_m: 0.05, shortest_m: 2, longest_m: 2"), "not below"},
    {CYLINDER("joint: turn, " DRIVE "bore_m: .nan, rod_m: 0.05, shortest_m: 1, longest_m: 2"), "bore_m"},
    {CYLINDER("joint: turn, count: 0, " DRIVE SIZES), "count"},
    {CYLINDER("joint: turn, pressure_pa: 0, " DRIVE SIZES), "pressure_pa"},
    {CYLINDER("joint: slide, " DRIVE SIZES), "'slide' is not revolute"},
    {CYLINDER("joint: turn, " DRIVE SIZES), "in one plane"},
    {CYLINDER("joint: side, root_m: [0, 2, 0], eye_m: [0, 0.5, 0], " SIZES), "dead centre"},
    {CYLINDER(
         "joint: side, root_m: [0, 2, 0], eye_m: [0, -0.24, 0.44], bore_m: 0.1, rod_m: 0.05, shortest_m: 3, "
         "longest_m: 3.1"),
     "stroke"},
    {CYLINDER(
         "joint: side, root_m: [0, 2, 0], four_bar: {parent_pivot_m: [0, -3, 0], child_pivot_m: [0, 1, 0], "
         "parent_bar_m: 0.1, child_bar_m: 0.1, branch: 1}, " SIZES),
     "do not reach"},
    {CYLINDER(
         "joint: side, root_m: [0, 2, 0], four_bar: {parent_pivot_m: [0, -3, 0], child_pivot_m: [0, 1, 0], "
         "parent_bar_m: 0.1, child_bar_m: 0.1, branch: 0}, " SIZES),
     "branch"},
    {HEAD "suspension: {heave: {stiffness_n_m: -1, damping_ns_m: 1}}\n", "stiffness_n_m"},
    {HEAD "suspension: {yaw: {}}\n", "yaw"},
};

static void test_bad_yaml(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof BAD_YAML / sizeof *BAD_YAML; i++)
        check_bad(ODD, strlen(ODD), BAD_YAML[i].yaml, BAD_YAML[i].words);
    /* A robot may have none of it. */
    td_robot *robot = parse_robot(ODD, HEAD);
    assert_int_equal(robot->cylinder_count, 0);
    assert_true(robot->suspension_n_m[0] == 0);
    td_robot_free(&robot);
}

/* The YAML may be missing; when it is there it must be right, and is named. */
static void test_files(void **state)
{
    char *urdf = td_path_join(*state, "r.urdf"), *yaml = td_path_join(*state, "r.yaml");
    td_error error;
    td_robot *robot = NULL;
    check_fails(td_robot_read(&robot, urdf, &error), TD_ERROR_IO, error, "r.urdf: ");
    check_ok(td_file_write(urdf, ODD, strlen(ODD), &error), error);
    check_ok(td_robot_read(&robot, urdf, &error), error);
    assert_true(isinf(robot->joint[1].acceleration));
    td_robot_free(&robot);
    const char *good =
        HEAD "joints: [{name: turn, acceleration_rad_s2: 3}, {name: slide, acceleration_m_s2: 4}]\n";
    check_ok(td_file_write(yaml, good, strlen(good), &error), error);
    check_ok(td_robot_read(&robot, urdf, &error), error);
    assert_true(robot->joint[0].acceleration == 4 && robot->joint[1].acceleration == 3);
    td_robot_free(&robot);
    check_ok(td_file_write(yaml, "3", 1, &error), error);
    check_fails(td_robot_read(&robot, urdf, &error), TD_ERROR_FORMAT, error, "r.yaml:");
    free(urdf);
    free(yaml);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_kdl, scratch_make, scratch_remove),
        cmocka_unit_test(test_derivatives),
        cmocka_unit_test(test_content),
        cmocka_unit_test(test_shapes_and_inertia),
        cmocka_unit_test(test_cylinder_lengths),
        cmocka_unit_test(test_turned_cylinder),
        cmocka_unit_test(test_cylinder_maps),
        cmocka_unit_test(test_excavator_limits),
        cmocka_unit_test(test_excavator_masses),
        cmocka_unit_test(test_excavator_reach),
        cmocka_unit_test_setup_teardown(test_bad_urdf, scratch_make, scratch_remove),
        cmocka_unit_test(test_huge_urdf),
        cmocka_unit_test(test_bad_yaml),
        cmocka_unit_test_setup_teardown(test_files, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
