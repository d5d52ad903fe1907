/* Proves that rigs are drawn with the rig's covariance: of 20000 draws each parameter and pose scatters by
 * its sigma and with the others by its correlation (5 standard errors of so many draws), about the rig
 * itself; that what has no variance, and the first camera's pose, never moves; that `times` scales; and that
 * a rig without a covariance is refused.
 *
 * Reference: the covariance, made as A A' of rank below its size, so that it is singular. Blind to: the shape
 * of the distribution beyond its second moments. */
#include "core/camera.h"
#include "core/pose.h"
#include "core/rig_draw.h"
#include "tests/check.h"

enum { DRAWS = 20000, RANK = 9 };

static td_rig *make_rig(void)
{
    static const double fx[] = {1100, 1101, 640, 480, -0.16, 0.05, 4e-4, -3e-4, 0};
    td_rig *rig = td_rig_new();
    td_random random = td_random_seed(3, 0);
    rig->count = 2;
    for (int c = 0; c < 2; c++) {
        td_rig_camera *k = &rig->camera[c];
        strcpy(k->name, c ? "right" : "left");
        k->camera.model = TD_CAMERA_BROWN5;
        k->camera.width = 1280, k->camera.height = 960;
        memcpy(k->camera.parameter, fx, sizeof fx);
        k->camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[0] = -0.6;
    const size_t n = td_rig_parameter_count(rig), first_pose = td_rig_parameter_offset(rig, 1) - 6;
    double a[64][RANK] = {{0}};
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < RANK && i != 2 && (i < first_pose || i >= first_pose + 6); k++)
            a[i][k] = td_random_normal(&random) * (i % 15 < 4 ? 0.3 : 1e-4);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            for (int k = 0; k < RANK; k++) rig->covariance[i * n + j] += a[i][k] * a[j][k];
    return rig;
}

/* How far `drawn` is from `rig`, in the covariance's order: left perturbations to first order. */
static void step_of(double *step, const td_rig *drawn, const td_rig *rig)
{
    for (int c = 0; c < rig->count; c++) {
        double *own = step + td_rig_parameter_offset(rig, c);
        const int count = td_camera_parameter_count(rig->camera[c].camera.model);
        for (int k = 0; k < count; k++)
            own[k] = drawn->camera[c].camera.parameter[k] - rig->camera[c].camera.parameter[k];
        const td_pose back = td_pose_inverse(&rig->camera[c].camera_from_rig);
        const td_pose moved = td_pose_compose(&drawn->camera[c].camera_from_rig, &back);
        for (int k = 0; k < 3; k++) own[count + k] = 2 * moved.q[1 + k], own[count + 3 + k] = moved.t[k];
    }
}

static void test_moments(void **state)
{
    (void)state;
    check_statistics();
    td_rig *rig = make_rig();
    td_error error = {0};
    const size_t n = td_rig_parameter_count(rig);
    double *mean = calloc(n + n * n, sizeof *mean), *second = mean + n, *step = calloc(n, sizeof *step);
    td_random random = td_random_seed(5, 0);
    for (int i = 0; i < DRAWS; i++) {
        td_rig *drawn;
        check_ok(td_rig_draw(&drawn, rig, 2, &random, &error), error);
        step_of(step, drawn, rig);
        for (size_t k = 0; k < n; k++) {
            mean[k] += step[k] / DRAWS;
            for (size_t j = 0; j < n; j++) second[k * n + j] += step[k] * step[j] / DRAWS;
        }
        td_rig_free(&drawn);
    }
    for (size_t k = 0; k < n; k++) {
        const double s = 2 * sqrt(rig->covariance[k * n + k]);
        check_near(mean[k], 0, 5 * s / sqrt(DRAWS) + 1e-12);
        for (size_t j = 0; j < n; j++) {
            const double r = 2 * sqrt(rig->covariance[j * n + j]);
            check_near(second[k * n + j], 4 * rig->covariance[k * n + j],
                       5 * sqrt(2.0 / DRAWS) * s * r + 1e-12);
        }
    }
    free(mean);
    free(step);
    td_rig_free(&rig);
}

static void test_still(void **state)
{
    (void)state;
    td_rig *rig = make_rig(), *drawn;
    td_error error = {0};
    td_random random = td_random_seed(6, 0);
    check_ok(td_rig_draw(&drawn, rig, 1, &random, &error), error);
    assert_true(drawn->camera[0].camera.parameter[2] == rig->camera[0].camera.parameter[2]);
    assert_true(drawn->camera[0].camera.parameter[0] != rig->camera[0].camera.parameter[0]);
    assert_memory_equal(&drawn->camera[0].camera_from_rig, &rig->camera[0].camera_from_rig, sizeof(td_pose));
    assert_non_null(drawn->covariance);
    td_rig_free(&drawn);
    free(rig->covariance);
    rig->covariance = NULL;
    check_fails(td_rig_draw(&drawn, rig, 1, &random, &error), TD_ERROR_DATA, error, "covariance");
    assert_null(drawn);
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_moments), cmocka_unit_test(test_still)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
