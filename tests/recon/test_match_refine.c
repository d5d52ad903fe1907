/* Proves that a match's place is without bias and its covariance true. Reference: pairs of a texture known
 * everywhere, the right one seen through a random affine map, gain and offset, with noise and 8-bit rounding.
 * Tolerances: mean error 0.01 px, also of its part that goes with the place between pixels (pixel locking);
 * squared error over covariance within 99.9 % of chi-squared for the count. Blind to: surfaces that are not
 * flat within the window, and lenses blurring one image more than the other. */
#include "core/random.h"
#include "recon/match.h"
#include "tests/check.h"
#include "tests/recon/texture.h"

enum { SIDE = 31, HALF = 7 };

typedef struct figures {
    double mean[2], locking[2], rms, ratio; /* px; ratio: mean of squared error over covariance, / 2 */
    int refined;
} figures;

typedef struct setting {
    double contrast, noise, shear; /* grey levels; of the affine map */
} setting;

/* One pair; false when it is not refined. error (2), *square = error^T covariance^-1 error, *fraction of the
 * true place between pixels. */
static bool one_pair(double error[2], double *square, double fraction[2], const setting *s, td_random *random)
{
    td_image *left, *right;
    td_error e;
    const texture t = texture_draw(random, s->contrast);
    const double identity[4] = {1, 0, 0, 1}, zero[2] = {0, 0}, middle = (SIDE - 1) / 2;
    double a[4], c[2], truth[2];
    for (int i = 0; i < 4; i++) a[i] = identity[i] + s->shear * (2 * td_random_uniform(random) - 1);
    for (int i = 0; i < 2; i++) c[i] = td_random_uniform(random) - 0.5;
    td_match match = {.left = {middle + td_random_uniform(random) - 0.5, middle}};
    for (int i = 0; i < 2; i++) { /* the map turns about the window's middle */
        c[i] += middle - a[2 * i] * middle - a[2 * i + 1] * middle;
        truth[i] = a[2 * i] * match.left[0] + a[2 * i + 1] * match.left[1] + c[i];
        match.right[i] = floor(truth[i] + 0.5) + match.left[i] - middle;
        fraction[i] = truth[i] - floor(truth[i]);
    }
    check_ok(td_image_new(&left, SIDE, SIDE, 1, &e), e);
    check_ok(td_image_new(&right, SIDE, SIDE, 1, &e), e);
    texture_render(left, &t, identity, zero, 1, 120, s->noise, random);
    texture_render(right, &t, a, c, 0.8 + 0.4 * td_random_uniform(random),
                   100 + 40 * td_random_uniform(random), s->noise, random);
    const bool refined = td_match_refine(&match, left, right, HALF);
    td_image_free(&left);
    td_image_free(&right);
    if (!refined) return false;
    const double *v = match.covariance, det = v[0] * v[3] - v[1] * v[2];
    for (int i = 0; i < 2; i++) error[i] = match.right[i] - truth[i];
    *square =
        (v[3] * error[0] * error[0] - 2 * v[1] * error[0] * error[1] + v[0] * error[1] * error[1]) / det;
    return true;
}

static figures many_pairs(const setting *s, int count)
{
    figures f = {{0, 0}, {0, 0}, 0, 0, 0};
    td_random random = td_random_seed(11, 0);
    for (int n = 0; n < count; n++) {
        double error[2], square, fraction[2];
        if (!one_pair(error, &square, fraction, s, &random)) continue;
        f.refined++;
        f.ratio += square / 2;
        for (int i = 0; i < 2; i++) {
            f.mean[i] += error[i];
            f.locking[i] += 2 * error[i] * sin(6.283185307179586 * fraction[i]);
            f.rms += error[i] * error[i] / 2;
        }
    }
    for (int i = 0; i < 2; i++) {
        f.mean[i] /= f.refined;
        f.locking[i] /= f.refined;
    }
    f.rms = sqrt(f.rms / f.refined);
    f.ratio /= f.refined;
    return f;
}

static void check_setting(const setting *s)
{
    const char *full = getenv("TELEDIMOS_FULL");
    const int count = full && strcmp(full, "1") == 0 ? 20000 : 1000;
    const figures f = many_pairs(s, count);
    print_message(
        "contrast %g, noise %g, shear %g: %d of %d refined, mean %.4f %.4f px, locking %.4f %.4f px, "
        "rms %.4f px, empirical over predicted %.3f\n",
        s->contrast, s->noise, s->shear, f.refined, count, f.mean[0], f.mean[1], f.locking[0], f.locking[1],
        f.rms, sqrt(f.ratio));
    assert_true(f.refined > 0.98 * count);
    for (int i = 0; i < 2; i++) {
        check_less(fabs(f.mean[i]), 0.01);
        check_less(fabs(f.locking[i]), 0.01);
    }
    check_near(f.ratio, 1, 3.29 / sqrt(f.refined));
}

static void test_low_noise(void **state)
{
    (void)state;
    check_setting(&(setting){30, 1, 0});
}

static void test_usual_noise(void **state)
{
    (void)state;
    check_statistics();
    check_setting(&(setting){20, 3, 0.08});
}

static void test_strong_noise(void **state)
{
    (void)state;
    check_statistics();
    check_setting(&(setting){12, 4, 0.03});
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_low_noise),
        cmocka_unit_test(test_usual_noise),
        cmocka_unit_test(test_strong_noise),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
