/* Proves, of the recursive evaluation and of the code generated for the zx200 alike: equal to KDL, whose free
 * base is emulated by six joints (1e-9 relative: KDL's own solution of forward dynamics rounds at 1e-14, its
 * mass matrix spans 1e5); forward dynamics undoes inverse dynamics; the mass matrix has the columns of the
 * inverse, is symmetric and positive definite; gravity, Coriolis and mass terms add up; forces are linear in
 * the inertial parameters; Jacobians are the derivatives of td_robot_forward (central differences, error
 * about 1e-9); energy, momentum and angular momentum of a free motion are kept, better by 2^4 for half the
 * step of a Runge-Kutta method of order 4. What cannot be computed is named or answered with false. Blind to:
 * an error in the robot's file itself; joint friction and stops, which are the machine's. */
#include "core/pose.h"
#include "tests/check.h"
#include "tests/sim/dynamics_base.h"
#include "tests/sim/dynamics_robots.h"
#ifdef TD_TEST_KDL
#include "tests/sim/dynamics_kdl.h"
#endif

enum { KINDS = 3 };

/* A robot with its dynamics: the zx200's generated code and recursion, and a random tree. */
typedef struct subject {
    td_robot *robot;
    td_dynamics *dynamics;
} subject;

static subject make_subject(int kind)
{
    subject s;
    td_error error;
    if (kind < 2)
        check_ok(td_robot_read(&s.robot, ZX200, &error), error);
    else
        s.robot = random_robot(5, (robot_kind){9, 0.3, 0.3, 0.2, 0.5});
    if (kind == 0)
        check_ok(td_dynamics_zx200(&s.dynamics, s.robot, &error), error);
    else
        check_ok(td_dynamics_new(&s.dynamics, s.robot, &error), error);
    return s;
}

static void free_subject(subject *s)
{
    td_dynamics_free(&s->dynamics);
    free(s->robot);
}

/* ---- KDL ---- */

#ifdef TD_TEST_KDL
static void compare_with_kdl(const td_dynamics *dynamics, kdl_dynamics *peer, td_random *random)
{
    static const double down[3] = {0, 0, -9.81};
    base_state base;
    double q[10], rate[10], change[10], nu[10], acceleration[10], gravity[3], force[10], ours[10], theirs[10];
    for (int k = 0; k < 10; k++) {
        q[k] = spread(random);
        rate[k] = td_random_normal(random);
        change[k] = td_random_normal(random);
    }
    memcpy(base.position, q, sizeof base.position);
    memcpy(base.rate, rate, sizeof base.rate);
    memcpy(base.change, change, sizeof base.change);
    base_complete(&base);
    memcpy(nu, base.nu, sizeof base.nu);
    memcpy(acceleration, base.acceleration, sizeof base.acceleration);
    memcpy(nu + 6, rate + 6, 4 * sizeof *nu);
    memcpy(acceleration + 6, change + 6, 4 * sizeof *nu);
    base_turn_back(gravity, base.rotation, down);

    td_dynamics_inverse(force, dynamics, q + 6, nu, acceleration, gravity, true);
    base_force(ours, &base, force);
    memcpy(ours + 6, force + 6, 4 * sizeof *ours);
    assert_true(kdl_dynamics_inverse(theirs, peer, q, rate, change));
    check_near(apart(ours, theirs, 10), 0, 1e-9);

    double forward[10], peers[10];
    assert_true(td_dynamics_forward(forward, dynamics, q + 6, nu, force, gravity, true));
    assert_true(kdl_dynamics_forward(peers, peer, q, rate, ours));
    check_near(apart(forward, acceleration, 10), 0, 1e-9);
    check_near(apart(peers, change, 10), 0, 1e-9);

    double mass[100], its[100];
    td_dynamics_mass(mass, dynamics, q + 6);
    assert_true(kdl_dynamics_mass(its, peer, q));
    for (int i = 6; i < 10; i++)
        for (int j = 6; j < 10; j++) check_near(mass[10 * i + j], its[10 * i + j], 1e-9 * 1e5);
}
#endif

static void test_kdl(void **state)
{
    (void)state;
#ifdef TD_TEST_KDL
    for (int kind = 0; kind < 2; kind++) {
        subject s = make_subject(kind);
        td_random random = td_random_seed(3, 1);
        kdl_dynamics *peer = kdl_dynamics_read(ZX200);
        assert_non_null(peer);
        for (int i = 0; i < 200; i++) compare_with_kdl(s.dynamics, peer, &random);
        kdl_dynamics_free(peer);
        free_subject(&s);
    }
#else
    print_message("KDL is not installed: not compared with it\n");
    skip();
#endif
}

/* ---- identities ---- */

static void check_round_trip(const subject *s, const robot_state *at)
{
    const size_t n = 6 + (size_t)s->robot->joint_count;
    double force[TD_DYNAMICS_MAX], back[TD_DYNAMICS_MAX];
    for (int coriolis = 0; coriolis < 2; coriolis++) {
        td_dynamics_inverse(force, s->dynamics, at->q, at->nu, at->acceleration, at->gravity, coriolis);
        assert_true(td_dynamics_forward(back, s->dynamics, at->q, at->nu, force, at->gravity, coriolis));
        check_near(apart(back, at->acceleration, n), 0, 1e-9);
    }
}

static void check_mass(const subject *s, const robot_state *at)
{
    const size_t n = 6 + (size_t)s->robot->joint_count;
    static const double none[TD_DYNAMICS_MAX] = {0};
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX], column[TD_DYNAMICS_MAX], size = 0;
    td_dynamics_mass(mass, s->dynamics, at->q);
    for (size_t i = 0; i < n * n; i++) size = fmax(size, fabs(mass[i]));
    for (size_t j = 0; j < n; j++) {
        double unit[TD_DYNAMICS_MAX] = {0};
        unit[j] = 1;
        td_dynamics_inverse(column, s->dynamics, at->q, none, unit, none, true);
        for (size_t i = 0; i < n; i++) {
            check_near(mass[i * n + j], column[i], 1e-12 * size);
            assert_true(mass[i * n + j] == mass[j * n + i]);
        }
    }
    for (size_t k = 0; k < n; k++) { /* all pivots of elimination are positive */
        assert_true(mass[k * n + k] > 0);
        for (size_t i = k + 1; i < n; i++)
            for (size_t j = n; j-- > k;)
                mass[i * n + j] -= mass[i * n + k] / mass[k * n + k] * mass[k * n + j];
    }
}

static void check_parts(const subject *s, const robot_state *at)
{
    const size_t n = 6 + (size_t)s->robot->joint_count, parameters = 10 * (size_t)s->robot->link_count;
    double force[TD_DYNAMICS_MAX], sum[TD_DYNAMICS_MAX], part[TD_DYNAMICS_MAX], still[TD_DYNAMICS_MAX];
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX];
    td_dynamics_inverse(force, s->dynamics, at->q, at->nu, at->acceleration, at->gravity, true);
    td_dynamics_inverse(still, s->dynamics, at->q, at->nu, at->acceleration, at->gravity, false);
    td_dynamics_mass(mass, s->dynamics, at->q);
    td_dynamics_gravity(sum, s->dynamics, at->q, at->gravity);
    for (size_t i = 0; i < n * n; i++) sum[i / n] += mass[i] * at->acceleration[i % n];
    check_near(apart(sum, still, n), 0, 1e-12);
    td_dynamics_coriolis(part, s->dynamics, at->q, at->nu);
    for (size_t i = 0; i < n; i++) sum[i] += part[i];
    check_near(apart(sum, force, n), 0, 1e-12);
    check_less(1e-3, apart(still, force, n)); /* there is a velocity term */

    double *regressor = malloc((n + 1) * parameters * sizeof *regressor), *p = regressor + n * parameters;
    assert_non_null(regressor);
    assert_int_equal(td_dynamics_parameter_count(s->dynamics), parameters);
    td_dynamics_parameters(p, s->dynamics);
    td_dynamics_regressor(regressor, s->dynamics, at->q, at->nu, at->acceleration, at->gravity);
    for (size_t i = 0; i < n; i++) {
        sum[i] = 0;
        for (size_t j = 0; j < parameters; j++) sum[i] += regressor[i * parameters + j] * p[j];
    }
    check_near(apart(sum, force, n), 0, 1e-11);
    free(regressor);
}

/* Central differences of root_from_link, turned from left perturbations to the velocity of its origin. */
static void check_jacobian(const subject *s, const robot_state *at)
{
    const int n = 6 + s->robot->joint_count;
    const double h = 1e-5;
    td_pose here[TD_ROBOT_MAX_LINKS], less[TD_ROBOT_MAX_LINKS], more[TD_ROBOT_MAX_LINKS];
    double jacobian[6 * TD_DYNAMICS_MAX], q[TD_ROBOT_MAX_JOINTS];
    td_robot_forward(here, s->robot, at->q);
    memcpy(q, at->q, sizeof q);
    for (int link = 0; link < s->robot->link_count; link++) {
        td_dynamics_jacobian(jacobian, s->dynamics, at->q, link);
        for (int k = 0; k < s->robot->joint_count; k++) {
            q[k] = at->q[k] - h;
            td_robot_forward(less, s->robot, q);
            q[k] = at->q[k] + h;
            td_robot_forward(more, s->robot, q);
            q[k] = at->q[k];
            const td_pose back = td_pose_inverse(less + link), step = td_pose_compose(more + link, &back);
            double omega[3];
            td_rotation_log(omega, step.q);
            for (int i = 0; i < 3; i++) {
                check_near(jacobian[i * n + 6 + k], omega[i] / (2 * h), 1e-8);
                check_near(jacobian[(3 + i) * n + 6 + k], (more[link].t[i] - less[link].t[i]) / (2 * h),
                           1e-8);
            }
        }
        for (int k = 0; k < 3; k++) { /* the base: omega x p + v */
            const int i = (k + 1) % 3, j = (k + 2) % 3;
            check_near(jacobian[(3 + i) * n + k], -here[link].t[j], 1e-12);
            check_near(jacobian[(3 + j) * n + k], here[link].t[i], 1e-12);
            check_near(jacobian[k * n + k], 1, 1e-12);
            check_near(jacobian[(3 + k) * n + 3 + k], 1, 1e-12);
            check_near(jacobian[(3 + k) * n + k], 0, 1e-12);
            assert_true(jacobian[k * n + 3 + k] == 0);
        }
    }
}

static void test_identities(void **state)
{
    (void)state;
    for (int kind = 0; kind < KINDS; kind++) {
        subject s = make_subject(kind);
        td_random random = td_random_seed(4, (uint64_t)kind);
        for (int i = 0; i < 100; i++) {
            const robot_state at = random_state(&random, s.robot->joint_count);
            check_round_trip(&s, &at);
            check_mass(&s, &at);
            check_parts(&s, &at);
            if (i < 5) check_jacobian(&s, &at);
        }
        free_subject(&s);
    }
}

/* ---- a free motion ---- */

typedef struct flight {
    const subject *s;
    int n;
    bool gravity;
} flight;

/* y = [quaternion of world_from_base, position, q, nu]. */
static void flight_rate(double *dy, const flight *f, const double *y)
{
    static const double down[3] = {0, 0, -9.81};
    const int n = f->n;
    const double *q = y + 7, *nu = q + n;
    double force[TD_DYNAMICS_MAX] = {0}, gravity[3] = {0}, acceleration[TD_DYNAMICS_MAX], v[3];
    const td_pose pose = {{y[0], y[1], y[2], y[3]}, {0}}, back = td_pose_inverse(&pose);
    if (f->gravity) td_pose_rotate(gravity, &back, down);
    assert_true(td_dynamics_forward(acceleration, f->s->dynamics, q, nu, force, gravity, true));
    dy[0] = -(y[1] * nu[0] + y[2] * nu[1] + y[3] * nu[2]) / 2;
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        dy[1 + i] = (y[0] * nu[i] + y[1 + j] * nu[k] - y[1 + k] * nu[j]) / 2;
    }
    td_pose_rotate(v, &pose, nu + 3);
    memcpy(dy + 4, v, sizeof v);
    memcpy(dy + 7, nu + 6, (size_t)n * sizeof *dy);
    memcpy(dy + 7 + n, acceleration, (size_t)(6 + n) * sizeof *dy);
    for (int i = 0; i < 3; i++) { /* v' = a - omega x v: in axes that turn */
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        dy[7 + n + 3 + i] -= nu[j] * nu[3 + k] - nu[k] * nu[3 + j];
    }
}

static void flight_step(const flight *f, double *y, double h)
{
    enum { MOST = 13 + 2 * TD_ROBOT_MAX_JOINTS };
    static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
    const int size = 13 + 2 * f->n;
    double rate[MOST] = {0}, point[MOST], next[MOST];
    memcpy(next, y, (size_t)size * sizeof *y);
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < size; i++) point[i] = y[i] + at[stage] * h * rate[i];
        flight_rate(rate, f, point);
        for (int i = 0; i < size; i++) next[i] += weight[stage] * h * rate[i];
    }
    memcpy(y, next, (size_t)size * sizeof *y);
}

/* Energy, momentum and angular momentum about the world's origin. The wrench of M nu on the base is the
 * momentum about the base's origin, in its axes. */
static void constants_of(double constant[7], const flight *f, const double *y)
{
    const int n = f->n, size = 6 + n;
    const double *q = y + 7, *nu = q + n;
    double mass[TD_DYNAMICS_MAX * TD_DYNAMICS_MAX], momentum[TD_DYNAMICS_MAX] = {0}, linear[3], angular[3];
    td_pose pose = {{y[0], y[1], y[2], y[3]}, {y[4], y[5], y[6]}}, link[TD_ROBOT_MAX_LINKS];
    td_dynamics_mass(mass, f->s->dynamics, q);
    for (int i = 0; i < size * size; i++) momentum[i / size] += mass[i] * nu[i % size];
    constant[0] = 0;
    for (int i = 0; i < size; i++) constant[0] += nu[i] * momentum[i] / 2;
    td_robot_forward(link, f->s->robot, q);
    for (int i = 0; f->gravity && i < f->s->robot->link_count; i++) {
        double centre[3];
        td_pose_transform(centre, link + i, f->s->robot->link[i].com_m);
        td_pose_transform(centre, &pose, centre);
        constant[0] += f->s->robot->link[i].mass_kg * 9.81 * centre[2];
    }
    td_pose_rotate(angular, &pose, momentum);
    td_pose_rotate(linear, &pose, momentum + 3);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        constant[1 + i] = linear[i];
        constant[4 + i] = angular[i] + pose.t[j] * linear[k] - pose.t[k] * linear[j];
    }
}

/* Largest drift over `time`, relative to the largest of energy, of momentum, of angular momentum. */
static void fly(double drift[3], const flight *f, const double *start, double time, int steps)
{
    double y[13 + 2 * TD_ROBOT_MAX_JOINTS], before[7], after[7];
    memcpy(y, start, (size_t)(13 + 2 * f->n) * sizeof *y);
    constants_of(before, f, y);
    for (int i = 0; i < steps; i++) flight_step(f, y, time / steps);
    constants_of(after, f, y);
    drift[0] = fabs(after[0] - before[0]) / fabs(before[0]);
    drift[1] = apart(after + 1, before + 1, 3);
    drift[2] = apart(after + 4, before + 4, 3);
}

static void check_flight(const subject *s, bool gravity)
{
    const flight f = {s, s->robot->joint_count, gravity};
    td_random random = td_random_seed(6, 1);
    double y[13 + 2 * TD_ROBOT_MAX_JOINTS] = {1}, coarse[3], fine[3];
    for (int i = 4; i < 7 + f.n; i++) y[i] = spread(&random);
    for (int i = 7 + f.n; i < 13 + 2 * f.n; i++) y[i] = 0.5 * spread(&random);
    fly(coarse, &f, y, 1, 100);
    fly(fine, &f, y, 1, 200);
    check_less(coarse[0], 1e-5);
    check_less(fine[0], coarse[0] / 10 + 1e-13);
    if (gravity) return; /* momentum then grows */
    for (int i = 1; i < 3; i++) {
        check_less(coarse[i], 1e-5);
        check_less(fine[i], coarse[i] / 10 + 1e-13);
    }
}

static void test_conservation(void **state)
{
    (void)state;
    for (int kind = 0; kind < KINDS; kind++) {
        subject s = make_subject(kind);
        check_flight(&s, true);
        check_flight(&s, false);
        free_subject(&s);
    }
}

/* A minute in steps of 1 ms, without gravity: nothing drifts. */
static void test_minute(void **state)
{
    (void)state;
    subject s = make_subject(0);
    const flight f = {&s, s.robot->joint_count, false};
    td_random random = td_random_seed(11, 1);
    double y[13 + 2 * TD_ROBOT_MAX_JOINTS] = {1}, drift[3];
    for (int i = 4; i < 7 + f.n; i++) y[i] = spread(&random);
    for (int i = 7 + f.n; i < 13 + 2 * f.n; i++) y[i] = 0.5 * spread(&random);
    fly(drift, &f, y, 60, 60000);
    print_message("60 s: energy %.1e, momentum %.1e, angular momentum %.1e\n", drift[0], drift[1], drift[2]);
    for (int i = 0; i < 3; i++) check_less(drift[i], 1e-8);
    free_subject(&s);
}

/* ---- what cannot be ---- */

static void test_refusals(void **state)
{
    (void)state;
    td_robot *robot = random_robot(7, (robot_kind){.joints = 3});
    td_dynamics *dynamics = NULL;
    td_error error = {0};
    robot->link[1].mass_kg = NAN;
    check_fails(td_dynamics_new(&dynamics, robot, &error), TD_ERROR_DATA, error, "link 'link1'");
    robot->link[1].mass_kg = -1;
    check_fails(td_dynamics_new(&dynamics, robot, &error), TD_ERROR_DATA, error, "is negative");
    robot->link[1].mass_kg = 1;
    robot->link[2].inertia[1] += 1;
    check_fails(td_dynamics_new(&dynamics, robot, &error), TD_ERROR_DATA, error, "not symmetric");
    robot->link[2].inertia[3] = robot->link[2].inertia[1] = 100;
    check_fails(td_dynamics_new(&dynamics, robot, &error), TD_ERROR_DATA, error, "negative principal moment");
    for (int i = 0; i < robot->link_count; i++) {
        robot->link[i].mass_kg = 0;
        memset(robot->link[i].inertia, 0, sizeof robot->link[i].inertia);
    }
    check_fails(td_dynamics_new(&dynamics, robot, &error), TD_ERROR_DATA, error, "has no mass");
    check_fails(td_dynamics_zx200(&dynamics, robot, &error), TD_ERROR_ARGUMENT, error, "is not the zx200");
    assert_null(dynamics);
    td_dynamics_free(&dynamics);
    free(robot);
}

/* A joint that moves no mass: inverse dynamics goes on, forward dynamics has no answer. */
static void test_massless_end(void **state)
{
    (void)state;
    td_robot *robot = random_robot(8, (robot_kind){.joints = 3});
    td_random random = td_random_seed(8, 3);
    td_dynamics *dynamics;
    td_error error;
    double out[9];
    const robot_state at = random_state(&random, 3);
    robot->link[3].mass_kg = 0;
    memset(robot->link[3].inertia, 0, sizeof robot->link[3].inertia);
    check_ok(td_dynamics_new(&dynamics, robot, &error), error);
    td_dynamics_inverse(out, dynamics, at.q, at.nu, at.acceleration, at.gravity, true);
    assert_true(out[8] == 0);
    assert_false(td_dynamics_forward(out, dynamics, at.q, at.nu, at.force, at.gravity, true));
    td_dynamics_free(&dynamics);
    free(robot);
}

/* One link: Newton and Euler's laws of a single body, by hand. */
static void test_one_link(void **state)
{
    (void)state;
    td_robot *robot = random_robot(9, (robot_kind){.joints = 0});
    td_dynamics *dynamics;
    td_error error;
    robot->link[0].mass_kg = 2;
    memcpy(robot->link[0].com_m, (double[]){1, 0, 0}, sizeof robot->link[0].com_m);
    memset(robot->link[0].inertia, 0, sizeof robot->link[0].inertia);
    for (int i = 0; i < 3; i++) robot->link[0].inertia[4 * i] = i + 1;
    check_ok(td_dynamics_new(&dynamics, robot, &error), error);
    /* omega = (0, 0, 3), alpha = (0, 0, 1), a = (0, 5, 0), gravity (0, 0, -10): the centre's acceleration is
     * (-9, 1 + 5, 10), the moment about z 3 + 2 * 6, about y -2 * 10. */
    const double nu[6] = {0, 0, 3, 7, 8, 9}, acceleration[6] = {0, 0, 1, 0, 5, 0}, gravity[3] = {0, 0, -10};
    const double expected[6] = {0, -20, 15, -18, 12, 20};
    double force[6];
    td_dynamics_inverse(force, dynamics, NULL, nu, acceleration, gravity, true);
    for (int i = 0; i < 6; i++) check_near(force[i], expected[i], 1e-14);
    assert_int_equal(td_dynamics_joints(dynamics), 0);
    td_dynamics_free(&dynamics);
    free(robot);
}

static void test_many_joints(void **state)
{
    (void)state;
    subject s = {.robot = random_robot(10, (robot_kind){.joints = 64, .prismatic = 0.1, .branch = 0.2})};
    td_random random = td_random_seed(10, 1);
    td_error error;
    check_ok(td_dynamics_new(&s.dynamics, s.robot, &error), error);
    for (int i = 0; i < 3; i++) {
        const robot_state at = random_state(&random, 64);
        check_mass(&s, &at);
        check_parts(&s, &at);
    }
    free_subject(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_minute),     cmocka_unit_test(test_kdl),
        cmocka_unit_test(test_identities), cmocka_unit_test(test_conservation),
        cmocka_unit_test(test_refusals),   cmocka_unit_test(test_massless_end),
        cmocka_unit_test(test_one_link),   cmocka_unit_test(test_many_joints),
    };
    return cmocka_run_group_tests_name("dynamics", tests, NULL, NULL);
}
