/* Proves: the solver finds known minima (a curve fit, poses from points, robustly with outliers); every kind
 * of block, hold, prior and loss is honoured; Jacobians with losses and priors equal differences; the
 * covariance equals the one computed densely and independently from the whole Jacobian, with local blocks,
 * held components and considered blocks; null directions are found and are the true ones. Reference: closed
 * forms and a dense inverse. Tolerances: solutions 1e-8 (solver tolerance), covariance 1e-9 relative
 * (conditioning below 1e6). Blind to: whether residuals given by users are right. */
#include "core/least_squares.h"
#include "core/linalg.h"
#include "core/random.h"
#include "tests/jacobians.h"

/* Points known in a frame, seen in another after a pose and a common scale and shift: block 0 vector {scale,
 * shift}, block 1 pose. */
typedef struct sighting {
    double p[3], seen[3];
} sighting;

static bool sight(double *residual, double *const *jacobian, const double *const *block, const void *user)
{
    const sighting *s = user;
    td_pose pose;
    double x[3], move[18];
    memcpy(&pose, block[1], sizeof pose);
    td_pose_transform(x, &pose, s->p);
    td_pose_transform_jacobian(move, x);
    for (int i = 0; i < 3; i++) {
        residual[i] = block[0][0] * x[i] + (i == 0 ? block[0][1] : 0) - s->seen[i];
        if (jacobian && jacobian[0]) {
            jacobian[0][2 * i] = x[i];
            jacobian[0][2 * i + 1] = i == 0;
        }
        if (jacobian && jacobian[1])
            for (int k = 0; k < 6; k++) jacobian[1][6 * i + k] = block[0][0] * move[6 * i + k];
    }
    return true;
}

enum { POSES = 3, POINTS = 8, SIGHTINGS = POSES * POINTS };

typedef struct scene {
    double common[2];
    td_pose pose[POSES], true_pose[POSES];
    sighting s[SIGHTINGS];
    td_problem *problem;
    int common_block, pose_block[POSES];
} scene;

static void scene_init(scene *sc, double noise, const td_loss *loss, uint64_t seed)
{
    td_error error = {0};
    td_random random = td_random_seed(seed, 7);
    memset(sc, 0, sizeof *sc);
    sc->problem = td_problem_new();
    sc->common[0] = 1.1;
    check_ok(td_problem_add_block(sc->problem, &sc->common_block, sc->common, 2, TD_VECTOR, false, &error),
             error);
    for (int k = 0; k < POSES; k++) {
        double xi[6];
        for (int i = 0; i < 6; i++) xi[i] = td_random_normal(&random);
        sc->true_pose[k] = td_pose_exp(xi);
        for (int i = 0; i < 6; i++) xi[i] = 0.1 * td_random_normal(&random);
        sc->pose[k] = td_pose_perturb(&sc->true_pose[k], xi);
        check_ok(td_problem_add_block(sc->problem, &sc->pose_block[k], (double *)&sc->pose[k], 7, TD_POSE,
                                      true, &error),
                 error);
        for (int i = 0; i < POINTS; i++) {
            sighting *s = &sc->s[k * POINTS + i];
            for (int j = 0; j < 3; j++) s->p[j] = td_random_normal(&random);
            td_pose_transform(s->seen, &sc->true_pose[k], s->p);
            for (int j = 0; j < 3; j++)
                s->seen[j] = 1.3 * s->seen[j] + (j == 0 ? 0.4 : 0) + noise * td_random_normal(&random);
            int blocks[2] = {sc->common_block, sc->pose_block[k]};
            check_ok(td_problem_add_residual(sc->problem, sight, s, 3, blocks, 2, loss, &error), error);
        }
    }
}

/* One pose is known, or scale, shift and all poses' translations are confounded. */
static void anchor(scene *sc)
{
    td_error error = {0};
    sc->pose[0] = sc->true_pose[0];
    check_ok(td_problem_hold(sc->problem, sc->pose_block[0], &error), error);
}

static void test_solve(void **state)
{
    (void)state;
    scene sc;
    td_error error = {0};
    td_solve_summary summary;
    scene_init(&sc, 0, NULL, 1);
    anchor(&sc);
    check_problem_jacobians(sc.problem, 1e-7);
    check_ok(td_problem_solve(sc.problem, &summary, NULL, &error), error);
    assert_true(summary.converged);
    assert_int_equal(summary.parameters, 2 + 6 * (POSES - 1));
    assert_int_equal(summary.residuals, 3 * SIGHTINGS);
    assert_true(summary.initial_cost > summary.final_cost);
    check_near(sc.common[0], 1.3, 1e-8);
    check_near(sc.common[1], 0.4, 1e-8);
    for (int k = 0; k < POSES; k++)
        for (int i = 0; i < 3; i++) check_near(sc.pose[k].t[i], sc.true_pose[k].t[i], 1e-8);
    td_problem_free(&sc.problem);
    assert_null(sc.problem);
}

static void test_robust(void **state)
{
    (void)state;
    for (int kind = TD_LOSS_HUBER; kind <= TD_LOSS_CAUCHY; kind++) {
        scene sc;
        td_error error = {0};
        const td_loss loss = {(td_loss_kind)kind, 0.01, 3};
        scene_init(&sc, 0, &loss, 2);
        anchor(&sc);
        sc.s[3].seen[1] += 5;
        sc.s[POINTS + 2].seen[0] -= 3;
        check_problem_jacobians(sc.problem, 1e-6);
        check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
        /* Cauchy forgets an outlier, Huber's pull stays of the order of its scale. */
        check_near(sc.common[0], 1.3, kind == TD_LOSS_CAUCHY ? 1e-4 : 5e-3);
        td_problem_free(&sc.problem);
    }
}

static void test_hold_and_prior(void **state)
{
    (void)state;
    scene sc;
    td_error error = {0};
    scene_init(&sc, 0, NULL, 3);
    anchor(&sc);
    check_ok(td_problem_hold_component(sc.problem, sc.common_block, 1, &error), error);
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    check_near(sc.common[1], 0, 0);
    td_problem_free(&sc.problem);

    /* A heavy prior wins over the data; on a pose too. */
    scene_init(&sc, 0, NULL, 3);
    anchor(&sc);
    const double mean[2] = {1.25, 0.1}, weight[4] = {1e7, 0, 0, 1e7};
    double six[36] = {0};
    for (int i = 0; i < 6; i++) six[7 * i] = 1e7;
    td_pose other = td_pose_identity();
    check_ok(td_problem_add_prior(sc.problem, sc.common_block, mean, weight, &error), error);
    check_ok(td_problem_add_prior(sc.problem, sc.pose_block[1], (const double *)&other, six, &error), error);
    check_problem_jacobians(sc.problem, 1e-6);
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    check_near(sc.common[0], 1.25, 1e-6);
    check_near(td_pose_angle(&sc.pose[1]), 0, 1e-6);
    td_problem_free(&sc.problem);
}

/* Dense J^T J over chosen free components, by brute force from single-residual evaluations. */
static void dense_normal(double *n, const td_problem *problem, const int *block_of, const int *component_of,
                         size_t size)
{
    memset(n, 0, size * size * sizeof *n);
    for (size_t i = 0; i < problem->residual_count; i++) {
        const td_residual *r = &problem->residual[i];
        double out[3], j0[3 * TD_MAX_BLOCK_SIZE], j1[3 * TD_MAX_BLOCK_SIZE], *jacobian[2] = {j0, j1};
        const double *value[2] = {problem->block[r->block[0]].value, problem->block[r->block[1]].value};
        assert_true(td_residual_evaluate(problem, r, out, jacobian, value));
        for (int row = 0; row < r->rows; row++) {
            double full[64] = {0};
            for (size_t a = 0; a < size; a++)
                for (int b = 0; b < r->block_count; b++)
                    if (r->block[b] == block_of[a])
                        full[a] = jacobian[b][row * problem->block[block_of[a]].tangent + component_of[a]];
            for (size_t a = 0; a < size; a++)
                for (size_t b = 0; b < size; b++) n[a * size + b] += full[a] * full[b];
        }
    }
}

static void test_covariance(void **state)
{
    (void)state;
    scene sc;
    td_error error = {0};
    td_covariance *c = NULL;
    scene_init(&sc, 0.01, NULL, 4);
    anchor(&sc);
    check_ok(td_problem_hold_component(sc.problem, sc.pose_block[1], 2, &error), error);
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    check_ok(td_problem_covariance(&c, sc.problem, NULL, 0, &error), error);
    assert_int_equal(td_covariance_null_count(c), 0);
    assert_int_equal(td_covariance_free_parameters(c), 2 + 5 + 6);
    assert_int_equal(td_covariance_rows(c), 3 * SIGHTINGS);

    int block_of[13], component_of[13];
    size_t size = 0;
    for (int i = 0; i < 2; i++) block_of[size] = sc.common_block, component_of[size++] = i;
    for (int k = 1; k < POSES; k++)
        for (int i = 0; i < 6; i++)
            if (k != 1 || i != 2) block_of[size] = sc.pose_block[k], component_of[size++] = i;
    double n[13 * 13], inverse[13 * 13];
    dense_normal(n, sc.problem, block_of, component_of, size);
    check_ok(td_invert_spd(inverse, n, size, &error), error);
    for (size_t a = 0; a < size; a++)
        for (size_t b = 0; b < size; b++) {
            double out[36];
            check_ok(td_covariance_get(out, c, block_of[a], block_of[b], &error), error);
            int width = sc.problem->block[block_of[b]].tangent;
            check_near(out[component_of[a] * width + component_of[b]], inverse[a * size + b],
                       1e-9 * sqrt(inverse[a * size + a] * inverse[b * size + b]));
        }
    double held[36];
    check_ok(td_covariance_get(held, c, sc.pose_block[1], sc.pose_block[1], &error), error);
    check_near(held[2 * 6 + 2], 0, 0);
    td_covariance_free(&c);
    td_problem_free(&sc.problem);
}

/* A linear function of all blocks, its covariance against G C G^T with C written out block by block. */
static void test_propagate(void **state)
{
    (void)state;
    enum { ROWS = 3 };
    scene sc;
    td_error error = {0};
    td_covariance *c = NULL;
    td_random random = td_random_seed(9, 9);
    scene_init(&sc, 0.01, NULL, 8);
    anchor(&sc);
    check_ok(td_problem_hold_component(sc.problem, sc.pose_block[1], 2, &error), error);
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    check_ok(td_problem_covariance(&c, sc.problem, NULL, 0, &error), error);

    double g[1 + POSES][ROWS * 6], expected[ROWS * ROWS] = {0}, out[ROWS * ROWS];
    td_linear_part part[1 + POSES];
    for (int b = 0; b <= POSES; b++) {
        part[b] = (td_linear_part){b ? sc.pose_block[b - 1] : sc.common_block, g[b]};
        for (int i = 0; i < ROWS * 6; i++) g[b][i] = td_random_normal(&random);
    }
    for (int a = 0; a <= POSES; a++)
        for (int b = 0; b <= POSES; b++) {
            double block[36], left[ROWS * 6], both[ROWS * ROWS];
            size_t ta = a ? 6 : 2, tb = b ? 6 : 2;
            check_ok(td_covariance_get(block, c, part[a].block, part[b].block, &error), error);
            td_multiply(left, g[a], block, ROWS, ta, tb);
            td_multiply_transposed(both, left, g[b], ROWS, tb, ROWS);
            for (int i = 0; i < ROWS * ROWS; i++) expected[i] += both[i];
        }
    check_ok(td_covariance_propagate(out, ROWS, c, part, 1 + POSES, &error), error);
    for (int i = 0; i < ROWS; i++)
        for (int k = 0; k < ROWS; k++) {
            check_near(out[ROWS * i + k], expected[ROWS * i + k],
                       1e-12 * sqrt(expected[ROWS * i + i] * expected[ROWS * k + k]));
            check_near(out[ROWS * i + k], out[ROWS * k + i], 0);
        }
    part[1].block = 99;
    check_fails(td_covariance_propagate(out, ROWS, c, part, 2, &error), TD_ERROR_ARGUMENT, error, "block 99");
    td_covariance_free(&c);
    td_problem_free(&sc.problem);
}

/* Consider analysis: hold the common block, say how uncertain it is, and compare the poses' covariance with
 * Monte Carlo over the held values. 4000 draws: the standard deviation's own relative sigma is 1.1 %, 5 % is
 * over 4 of them. */
static void test_consider(void **state)
{
    (void)state;
    enum { DRAWS = 4000 };
    scene sc;
    td_error error = {0};
    td_covariance *c = NULL;
    scene_init(&sc, 0, NULL, 5);
    sc.common[0] = 1.3, sc.common[1] = 0.4;
    check_ok(td_problem_hold(sc.problem, sc.common_block, &error), error);
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    const double common_covariance[4] = {4e-6, 1e-6, 1e-6, 1e-6};
    const td_consider consider = {sc.common_block, common_covariance};
    double predicted[36], alone[36], sum[6] = {0};
    check_ok(td_problem_covariance(&c, sc.problem, &consider, 1, &error), error);
    check_ok(td_covariance_get(predicted, c, sc.pose_block[1], sc.pose_block[1], &error), error);
    td_covariance_free(&c);
    check_ok(td_problem_covariance(&c, sc.problem, NULL, 0, &error), error);
    check_ok(td_covariance_get(alone, c, sc.pose_block[1], sc.pose_block[1], &error), error);
    td_covariance_free(&c);

    td_random random = td_random_seed(6, 1);
    td_pose kept[POSES];
    memcpy(kept, sc.pose, sizeof kept);
    for (int draw = 0; draw < DRAWS; draw++) {
        double a = td_random_normal(&random), b = td_random_normal(&random), xi[6];
        sc.common[0] = 1.3 + 2e-3 * a;
        sc.common[1] = 0.4 + 0.5e-3 * a + sqrt(0.75e-6) * b;
        memcpy(sc.pose, kept, sizeof kept);
        check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
        td_pose back = td_pose_inverse(&kept[1]), delta = td_pose_compose(&sc.pose[1], &back);
        td_pose_log(xi, &delta);
        for (int i = 0; i < 6; i++) sum[i] += xi[i] * xi[i] / DRAWS;
    }
    for (int i = 3; i < 6; i++) {
        /* The considered part alone: what it adds to the covariance of unit residuals. */
        double added = predicted[7 * i] - alone[7 * i];
        check_near(sqrt(sum[i] / added), 1, 0.05);
    }
    td_problem_free(&sc.problem);
}

static void test_null_direction(void **state)
{
    (void)state;
    scene sc;
    td_error error = {0};
    td_covariance *c = NULL;
    scene_init(&sc, 0, NULL, 8);
    /* No anchor: the shift along x is confounded with every pose's translation, exactly. */
    check_ok(td_problem_solve(sc.problem, NULL, NULL, &error), error);
    check_ok(td_problem_covariance(&c, sc.problem, NULL, 0, &error), error);
    assert_int_equal(td_covariance_null_count(c), 1);
    double scale = td_covariance_null_direction(c, 0, sc.common_block, 0);
    double shift = td_covariance_null_direction(c, 0, sc.common_block, 1);
    assert_true(fabs(shift) > 0);
    check_near(scale / shift, 0, 1e-5);
    td_covariance_free(&c);
    assert_null(c);
    td_problem_free(&sc.problem);
}

static bool stop(const char *stage, size_t done, size_t total, void *user)
{
    (void)stage, (void)done, (void)total;
    return ++*(int *)user < 2;
}

static void test_refusals(void **state)
{
    (void)state;
    scene sc;
    td_error error = {0};
    int block, two[2] = {0, 0}, calls = 0;
    double value[3] = {0};
    td_problem *p = td_problem_new();
    check_fails(td_problem_add_block(p, &block, value, 0, TD_VECTOR, false, &error), TD_ERROR_ARGUMENT, error,
                "0 numbers");
    check_ok(td_problem_add_block(p, &block, value, 3, TD_VECTOR, false, &error), error);
    check_fails(td_problem_add_residual(p, sight, NULL, 3, two, 2, NULL, &error), TD_ERROR_ARGUMENT, error,
                "twice");
    check_fails(td_problem_hold(p, 9, &error), TD_ERROR_ARGUMENT, error, "no block 9");
    check_fails(td_problem_hold_component(p, block, 3, &error), TD_ERROR_ARGUMENT, error, "component 3");
    td_solve_options options = td_solve_options_default();
    check_ok(td_solve_options_check(&options, &error), error);
    options.max_iterations = 0;
    check_fails(td_problem_solve(p, NULL, &options, &error), TD_ERROR_ARGUMENT, error, "max_iterations");
    td_problem_free(&p);

    scene_init(&sc, 0.01, NULL, 9);
    anchor(&sc);
    td_progress progress = {stop, &calls};
    options = td_solve_options_default();
    options.progress = &progress;
    check_fails(td_problem_solve(sc.problem, NULL, &options, &error), TD_ERROR_CANCELLED, error,
                "interrupted");
    td_problem_free(&sc.problem);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_solve),          cmocka_unit_test(test_robust),
        cmocka_unit_test(test_hold_and_prior), cmocka_unit_test(test_covariance),
        cmocka_unit_test(test_propagate),      cmocka_unit_test(test_consider),
        cmocka_unit_test(test_null_direction), cmocka_unit_test(test_refusals)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
