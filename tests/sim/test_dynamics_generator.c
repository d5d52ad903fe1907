/* Proves: generated code — the build's for the zx200, and code compiled at run time for random trees with
 * branches, prismatic joints, fixed links, parallel and skew axes — equals the recursive evaluation, which
 * shares nothing with it, to 1e-10 relative (both round at 1e-16; the excavator's masses span 1e5) in every
 * function, at random states whose base turns; the text is the same each time; what cannot be generated or
 * compiled is named; half-written files and two processes at once do no harm. Blind to: errors that the
 * recursive evaluation shares (test_dynamics.c has KDL and conservation for those); compilers other than the
 * machine's. */
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/file.h"
#include "sim/dynamics_generator.h"
#include "tests/check.h"
#include "tests/scratch.h"
#include "tests/sim/dynamics_robots.h"

static const double TOLERANCE = 1e-10;

static bool full_count(void)
{
    const char *full = getenv("TELEDIMOS_FULL");
    return full && strcmp(full, "1") == 0;
}

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
    td_robot *robot = read_zx200();
    td_dynamics *made;
    td_error error;
    check_ok(td_dynamics_zx200(&made, robot, &error), error);
    compare(made, robot, full_count() ? 10000 : 1000, 1);
    td_dynamics_free(&made);
    td_robot_free(&robot);
}

/* What a robot's own code is compiled with here: the flags after the name win, and -O0 is quick. */
static void choose_compiler(const char *compiler)
{
    assert_int_equal(setenv("CC", compiler, 1), 0);
}

static void compare_compiled(const td_robot *robot, const char *folder, int states)
{
    td_dynamics *made;
    td_error error;
    check_ok(td_dynamics_compile(&made, robot, folder, &error), error);
    assert_int_equal(td_dynamics_joints(made), robot->joint_count);
    compare(made, robot, states, 3);
    td_dynamics_free(&made);
    assert_null(made);
}

static void test_random_trees(void **state)
{
    static const robot_kind kinds[] = {
        {.joints = 7, .aligned = 1},
        {.joints = 12, .prismatic = 0.2, .branch = 0.5, .fixed = 0.2, .aligned = 0.8},
        {.joints = 3, .prismatic = 0.3},
        {.joints = 1},
        {.joints = 0},
    };
    choose_compiler("cc -O0");
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        td_robot *robot = random_robot(10 + i, kinds[i]);
        compare_compiled(robot, *state, 50);
        free(robot);
    }
}

/* Trees for each way in which working axes are chosen, small, so that many are tried: the code is generated
 * and compiled at once for several seeds. */
static void test_small_trees(void **state)
{
    choose_compiler("cc -O0");
    for (uint64_t seed = 0; seed < (full_count() ? 60 : 6); seed++) {
        td_robot *robot = random_robot(100 + seed, (robot_kind){3 + (int)(seed / 20), seed % 2 ? 0.4 : 0.1,
                                                                0.3, 0.1, seed % 3 ? 0.9 : 0.4});
        compare_compiled(robot, *state, 20);
        free(robot);
    }
}

/* With the library's own flags. */
static void test_optimised(void **state)
{
    unsetenv("CC");
    td_robot *robot = random_robot(30, (robot_kind){.joints = 2, .aligned = 1});
    compare_compiled(robot, *state, 100);
    free(robot);
}

/* Angles far out: the sine's reduction, and the C library's beyond it. */
static void test_large_angles(void **state)
{
    (void)state;
    td_robot *robot = read_zx200();
    td_dynamics *made, *plain;
    td_error error;
    td_random random = td_random_seed(31, 1);
    check_ok(td_dynamics_zx200(&made, robot, &error), error);
    check_ok(td_dynamics_new(&plain, robot, &error), error);
    for (int i = 0; i < 200; i++) {
        robot_state s = random_state(&random, 4);
        const double size = i % 2 ? 1e4 : 1e7;
        for (int k = 0; k < 4; k++) s.q[k] = floor(s.q[k] * size); /* whole: sums of angles are exact */
        compare_inverse(made, plain, &s);
    }
    td_dynamics_free(&made);
    td_dynamics_free(&plain);
    td_robot_free(&robot);
}

/* A joint that moves no mass: forward dynamics answers false, in generated code too. */
static void test_massless_end(void **state)
{
    td_robot *robot = random_robot(32, (robot_kind){.joints = 3});
    td_random random = td_random_seed(32, 3);
    td_dynamics *made;
    td_error error;
    double out[9];
    const robot_state at = random_state(&random, 3);
    choose_compiler("cc -O0");
    robot->link[3].mass_kg = 0;
    memset(robot->link[3].inertia, 0, sizeof robot->link[3].inertia);
    check_ok(td_dynamics_compile(&made, robot, *state, &error), error);
    td_dynamics_inverse(out, made, at.q, at.nu, at.acceleration, at.gravity, true);
    assert_true(out[8] == 0);
    assert_false(td_dynamics_forward(out, made, at.q, at.nu, at.force, at.gravity, true));
    assert_false(td_dynamics_forward(out, made, at.q, at.nu, at.force, at.gravity, false));
    td_dynamics_free(&made);
    /* Two joints about one line with nothing between: M is singular only at run time. */
    free(robot);
    robot = random_robot(33, (robot_kind){.joints = 2});
    robot->link[2].parent_from_link = td_pose_identity();
    memcpy(robot->joint[1].axis, robot->joint[0].axis, sizeof robot->joint[0].axis);
    robot->link[1].mass_kg = 0;
    memset(robot->link[1].inertia, 0, sizeof robot->link[1].inertia);
    check_ok(td_dynamics_compile(&made, robot, *state, &error), error);
    assert_false(td_dynamics_forward(out, made, at.q, at.nu, at.force, at.gravity, true));
    td_dynamics_free(&made);
    free(robot);
}

/* 64 joints: what is too long to write is evaluated recursively behind the same door. */
static void test_many_joints(void **state)
{
    td_robot *robot = random_robot(34, (robot_kind){.joints = 64, .branch = 0.2, .aligned = 1});
    td_generated generated;
    td_error error;
    choose_compiler("cc -O0");
    check_ok(td_dynamics_generate(&generated, robot, "many", &error), error);
    assert_non_null(strstr(generated.code, "too long"));
    assert_true(generated.inverse_flops > 0);
    td_generated_free(&generated);
    compare_compiled(robot, *state, 2);
    free(robot);
}

/* ---- the text ---- */

static void test_text(void **state)
{
    (void)state;
    td_robot *robot = read_zx200(), *other = random_robot(40, (robot_kind){.joints = 5});
    td_generated first, between, second;
    td_error error;
    check_ok(td_dynamics_generate(&first, robot, "same", &error), error);
    check_ok(td_dynamics_generate(&between, other, "same", &error), error);
    check_ok(td_dynamics_generate(&second, robot, "same", &error), error);
    assert_int_equal(first.size, second.size);
    assert_memory_equal(first.code, second.code, first.size);
    assert_int_equal(first.size, strlen(first.code));
    assert_string_not_equal(first.code, between.code);
    /* What the trial that this follows needed: 551, 1273, 292. */
    assert_in_range(first.inverse_flops, 300, 551);
    assert_in_range(first.forward_flops, 600, 1273);
    assert_in_range(first.mass_flops, 150, 292);
    check_less((double)first.inverse_no_coriolis_flops, (double)first.inverse_flops);
    td_generated_free(&first);
    td_generated_free(&between);
    td_generated_free(&second);
    check_fails(td_dynamics_generate(&first, robot, "1; evil", &error), TD_ERROR_ARGUMENT, error, "prefix");
    check_fails(td_dynamics_generate(&first, robot, "", &error), TD_ERROR_ARGUMENT, error, "prefix");
    snprintf(robot->name, sizeof robot->name, "%s", "*/ int evil; /*");
    check_ok(td_dynamics_generate(&first, robot, "same", &error), error);
    assert_null(strstr(first.code, "int evil"));
    td_generated_free(&first);
    robot->link[0].mass_kg = NAN;
    check_fails(td_dynamics_generate(&first, robot, "same", &error), TD_ERROR_DATA, error, "undercarriage");
    td_robot_free(&robot);
    free(other);
}

/* ---- compiling ---- */

static int files_in(const char *folder, char *one)
{
    int count = 0;
    DIR *stream = opendir(folder);
    assert_non_null(stream);
    for (struct dirent *entry; (entry = readdir(stream));)
        if (entry->d_name[0] != '.') {
            count++;
            snprintf(one, 300, "%s", entry->d_name);
        }
    closedir(stream);
    return count;
}

static void test_no_compiler(void **state)
{
    td_robot *robot = random_robot(50, (robot_kind){.joints = 1});
    td_dynamics *made = NULL;
    td_error error;
    char name[300];
    choose_compiler("/nonexistent");
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_NOT_FOUND, error,
                "'/nonexistent' cannot be started");
    choose_compiler("false");
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_EXTERNAL, error,
                "'false' failed");
    choose_compiler("cc -Dturn_of=(");
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_EXTERNAL, error, "error:");
    choose_compiler("  ");
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_ARGUMENT, error, "CC");
    choose_compiler("cc;touch$IFS/evil");
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_NOT_FOUND, error, "cc;touch");
    check_fails(td_dynamics_compile(&made, robot, "", &error), TD_ERROR_ARGUMENT, error, "folder");
    check_fails(td_dynamics_compile(&made, robot, "/proc/none", &error), TD_ERROR_IO, error, "/proc/none");
    assert_null(made);
    assert_int_equal(files_in(*state, name), 0); /* nothing is left lying about */
    free(robot);
}

/* Loaded without a compiler the second time; a spoilt file is named, one of another robot is not looked at.
 */
static void test_cache(void **state)
{
    td_robot *robot = random_robot(51, (robot_kind){.joints = 1});
    td_dynamics *made, *again;
    td_error error;
    char name[300];
    choose_compiler("cc -O0");
    check_ok(td_dynamics_compile(&made, robot, *state, &error), error);
    assert_int_equal(files_in(*state, name), 1);
    choose_compiler("/nonexistent");
    check_ok(td_dynamics_compile(&again, robot, *state, &error), error);
    compare(again, robot, 2, 1);
    td_dynamics_free(&again);
    td_dynamics_free(&made);
    robot->link[0].mass_kg += 1;
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_NOT_FOUND, error, "/nonexistent");
    robot->link[0].mass_kg -= 1;
    char *path = td_path_join(*state, name);
    check_ok(td_file_write(path, "no library", 10, &error), error);
    check_fails(td_dynamics_compile(&made, robot, *state, &error), TD_ERROR_EXTERNAL, error, name);
    free(path);
    free(robot);
}

static void test_two_processes(void **state)
{
    td_robot *robot = random_robot(52, (robot_kind){.joints = 2});
    pid_t child[3];
    char name[300];
    choose_compiler("cc -O0");
    for (int i = 0; i < 3; i++) {
        child[i] = fork();
        assert_true(child[i] >= 0);
        if (child[i] > 0) continue;
        td_dynamics *made = NULL;
        const td_status status = td_dynamics_compile(&made, robot, *state, NULL);
        td_dynamics_free(&made);
        _exit(status == TD_OK ? 0 : 1);
    }
    for (int i = 0; i < 3; i++) {
        int ended;
        assert_int_equal(waitpid(child[i], &ended, 0), child[i]);
        assert_true(WIFEXITED(ended) && WEXITSTATUS(ended) == 0);
    }
    assert_int_equal(files_in(*state, name), 1);
    compare_compiled(robot, *state, 5);
    free(robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_zx200),
        cmocka_unit_test_setup_teardown(test_random_trees, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_small_trees, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_optimised, scratch_make, scratch_remove),
        cmocka_unit_test(test_large_angles),
        cmocka_unit_test_setup_teardown(test_massless_end, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_many_joints, scratch_make, scratch_remove),
        cmocka_unit_test(test_text),
        cmocka_unit_test_setup_teardown(test_no_compiler, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_cache, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_two_processes, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests_name("dynamics_generator", tests, NULL, NULL);
}
