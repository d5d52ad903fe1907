/* Proves that the squares which the belief in a rig rests on are chi-squared for rigs drawn from the rig's
 * own covariance, with the degrees of freedom it says, that a rig ten of its sigma off exceeds the limit, and
 * that a tenth of wrong matches changes neither. Reference: points projected by drawn rigs, whose law is
 * known. Tolerances: the mean of N draws of chi-squared over its freedom k is 1 within 4 sqrt(2 / (k N)),
 * widened by 10 % for the noise is estimated from the same matches; of 300 draws none is above the one in ten
 * thousand (3 % are so by chance). Of rigs ten sigma off, with k of 5 and more, one in 600 is not seen: of
 * 100 at most
 * 2. Blind to: errors of matches that are common to a region; which rigs are off along the curves only. */
#include "core/linalg.h"
#include "core/random.h"
#include "core/rig_draw.h"
#include "recon/rig_belief.h"
#include "tests/check.h"

static const double NOISE_PX = 0.05;
enum { MATCHES = 300 };

/* Correlated, as of a calibration: each parameter's own sigma, and half as much that all share. */
static td_rig *make_rig(void)
{
    static const double sigma[] = {0.2,  0.2,  0.2,  0.2,  4e-4, 1e-3, 3e-5, 3e-5,
                                   1e-3, 2e-4, 2e-4, 1e-4, 5e-5, 5e-5, 1e-4};
    td_rig *rig = td_rig_new();
    const td_camera camera = {
        TD_CAMERA_BROWN5, 640, 480, {536.1, 536.9, 322.3, 235.5, -0.265, -0.047, 0.0018, -0.0003, 0.1}};
    const double xi[6] = {0.005, -0.03, 0.01, -0.4, 0.01, 0.02};
    rig->count = 2;
    for (int i = 0; i < 2; i++) {
        snprintf(rig->camera[i].name, TD_NAME_SIZE, i ? "right" : "left");
        rig->camera[i].camera = camera;
        rig->camera[i].camera_from_rig = i ? td_pose_exp(xi) : td_pose_identity();
    }
    const size_t n = td_rig_parameter_count(rig), each = n / 2;
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) {
            const bool fixed = (i < each && i >= 9) || (k < each && k >= 9);
            rig->covariance[i * n + k] = fixed ? 0 : sigma[i % each] * sigma[k % each] * (i == k ? 1 : 0.25);
        }
    return rig;
}

static bool draw_match(td_match *m, const td_rig *truth, bool wrong, td_random *random)
{
    double ray[3], p[3], q[3];
    *m = (td_match){.covariance = {NAN, NAN, NAN, NAN}};
    m->left[0] = 639 * td_random_uniform(random);
    m->left[1] = 479 * td_random_uniform(random);
    if (!td_camera_unproject(ray, NULL, NULL, &truth->camera[0].camera, m->left)) return false;
    const double depth = 2 + 8 * td_random_uniform(random);
    for (int i = 0; i < 3; i++) p[i] = depth * ray[i] / ray[2];
    td_pose_transform(q, &truth->camera[1].camera_from_rig, p);
    if (!td_camera_project(m->right, NULL, NULL, &truth->camera[1].camera, q)) return false;
    for (int i = 0; i < 2; i++)
        m->right[i] += wrong ? 8 * (td_random_uniform(random) - 0.5) : NOISE_PX * td_random_normal(random);
    return m->right[0] >= 0 && m->right[0] <= 639 && m->right[1] >= 0 && m->right[1] <= 479;
}

static td_rig_belief_result run(const td_rig *rig, double times, double wrong, uint64_t stream)
{
    td_random random = td_random_seed(5, stream);
    td_rig_belief_result result;
    td_rig_belief *belief = NULL;
    td_rig *truth = NULL;
    td_pair pair;
    td_error error;
    td_match match[MATCHES];
    check_ok(td_rig_draw(&truth, rig, times, &random, &error), error);
    for (int i = 0; i < MATCHES; i++)
        while (!draw_match(match + i, truth, i < wrong * MATCHES, &random)) continue;
    check_ok(td_pair_init(&pair, rig, 0, 1, &error), error);
    check_ok(td_rig_belief_new(&belief, &pair, &error), error);
    check_ok(td_rig_belief_add(belief, match, MATCHES / 2, &error), error);
    check_ok(td_rig_belief_add(belief, match + MATCHES / 2, MATCHES / 2, &error), error);
    check_ok(td_rig_belief_check(&result, belief, &error), error);
    td_rig_belief_free(&belief);
    td_rig_free(&truth);
    return result;
}

static void check_law(double wrong)
{
    enum { DRAWS = 300 };
    td_rig *rig = make_rig();
    double sum = 0, freedom = 0;
    for (uint64_t i = 0; i < DRAWS; i++) {
        const td_rig_belief_result r = run(rig, 1, wrong, i);
        assert_true(r.freedom >= 4 && r.matches == MATCHES);
        assert_true(r.sigmas <= r.limit);
        sum += r.sigmas * r.sigmas * r.freedom;
        freedom += r.freedom;
        if (wrong == 0) check_near(r.noise_px, NOISE_PX, 0.012);
    }
    check_near(sum / freedom, 1, 0.1 + 4 * sqrt(2 / freedom));
    td_rig_free(&rig);
}

static void test_right_rigs(void **state)
{
    (void)state;
    check_statistics();
    check_law(0);
}

static void test_wrong_matches(void **state)
{
    (void)state;
    check_statistics();
    check_law(0.1);
}

static void test_wrong_rigs(void **state)
{
    (void)state;
    check_statistics();
    td_rig *rig = make_rig();
    int unseen = 0;
    for (uint64_t i = 0; i < 100; i++) {
        const td_rig_belief_result r = run(rig, 10, 0, 1000 + i);
        unseen += r.sigmas <= r.limit;
    }
    assert_true(unseen <= 2);
    td_rig_free(&rig);
}

static void test_bad_input(void **state)
{
    (void)state;
    td_rig *rig = make_rig();
    td_rig_belief_result result;
    td_rig_belief *belief = NULL;
    td_match match[MATCHES] = {{.left = {320, 240}, .right = {300, 240}}};
    td_pair pair;
    td_error error;
    check_ok(td_pair_init(&pair, rig, 0, 1, &error), error);
    check_ok(td_rig_belief_new(&belief, &pair, &error), error);
    check_ok(td_rig_belief_add(belief, match, 1, &error), error);
    check_fails(td_rig_belief_check(&result, belief, &error), TD_ERROR_DATA, error, "too few");
    td_rig_belief_clear(belief);
    td_rig_belief_free(&belief);
    free(rig->covariance);
    rig->covariance = NULL;
    check_fails(td_rig_belief_new(&belief, &pair, &error), TD_ERROR_DATA, error, "no covariance");
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_right_rigs),
                                       cmocka_unit_test(test_wrong_matches),
                                       cmocka_unit_test(test_wrong_rigs), cmocka_unit_test(test_bad_input)};
    td_linalg_single_thread();
    return cmocka_run_group_tests(tests, NULL, NULL);
}
