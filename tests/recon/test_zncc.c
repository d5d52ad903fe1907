/* Proves ZNCC as the paper's 3.4 writes it: against a direct evaluation of that formula, term by term, to
 * 1e-10 (rounding of some hundred terms); of the fast form, which shares its sums between windows, to 1e-12
 * of td_zncc. Blind to: whether ZNCC is a good measure. */
#include "core/random.h"
#include "recon/match_internal.h"
#include "recon/zncc.h"
#include "tests/check.h"

static td_image *noise_image(int width, int height, uint64_t seed, int smooth)
{
    td_image *image;
    td_error error;
    td_random random = td_random_seed(seed, 0);
    check_ok(td_image_new(&image, width, height, 1, &error), error);
    for (int i = 0; i < width * height; i++)
        image->data[i] =
            (uint8_t)(smooth ? 250 + td_random_below(&random, 3) : td_random_below(&random, 256));
    return image;
}

static double luminance(const td_image *image, int i, int j)
{
    return image->data[(size_t)j * (size_t)image->width + (size_t)i];
}

static double mean(const td_image *image, int i, int j, int k)
{
    double sum = 0;
    for (int dx = -k; dx <= k; dx++)
        for (int dy = -k; dy <= k; dy++) sum += luminance(image, i + dx, j + dy);
    return 1. / ((2 * k + 1) * (2 * k + 1)) * sum;
}

static double paper(const td_image *a, int i, int j, const td_image *b, int l, int m, int k)
{
    const double mean_a = mean(a, i, j, k), mean_b = mean(b, l, m, k);
    double both = 0, own_a = 0, own_b = 0;
    for (int dx = -k; dx <= k; dx++)
        for (int dy = -k; dy <= k; dy++) {
            const double p = luminance(a, i + dx, j + dy) - mean_a, q = luminance(b, l + dx, m + dy) - mean_b;
            both += p * q;
            own_a += p * p;
            own_b += q * q;
        }
    return both / (sqrt(own_a) * sqrt(own_b));
}

static void test_formula(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 0);
    for (int smooth = 0; smooth < 2; smooth++) {
        td_image *a = noise_image(61, 47, 2, smooth), *b = noise_image(53, 59, 3, smooth);
        for (int n = 0; n < 2000; n++) {
            const int k = 1 + (int)td_random_below(&random, 12);
            const int i = k + (int)td_random_below(&random, (uint32_t)(a->width - 2 * k));
            const int j = k + (int)td_random_below(&random, (uint32_t)(a->height - 2 * k));
            const int l = k + (int)td_random_below(&random, (uint32_t)(b->width - 2 * k));
            const int m = k + (int)td_random_below(&random, (uint32_t)(b->height - 2 * k));
            check_near(td_zncc(a, i, j, b, l, m, k), paper(a, i, j, b, l, m, k), 1e-10);
        }
        check_near(td_zncc(a, 20, 20, a, 20, 20, 7), 1, 1e-12);
        td_image_free(&a);
        td_image_free(&b);
    }
}

static void test_undefined(void **state)
{
    (void)state;
    td_image *a = noise_image(30, 30, 4, 0), *flat;
    td_error error;
    check_ok(td_image_new(&flat, 30, 30, 1, &error), error);
    assert_true(isnan(td_zncc(a, 4, 15, a, 15, 15, 5)));
    assert_true(isnan(td_zncc(a, 15, 15, a, 15, 25, 5)));
    assert_false(isnan(td_zncc(a, 5, 24, a, 24, 5, 5)));
    assert_true(isnan(td_zncc(a, 15, 15, flat, 15, 15, 5)));
    assert_true(isnan(td_zncc(flat, 15, 15, a, 15, 15, 5)));
    td_image_free(&a);
    td_image_free(&flat);
}

static void test_fast_form(void **state)
{
    (void)state;
    static const int halves[] = {1, 3, 7, 11, 50};
    td_error error;
    for (int h = 0; h < 5; h++) {
        const int k = halves[h];
        td_image *a = noise_image(130, 117, 5, h % 2), *b = noise_image(112, 123, 6, h % 2);
        td_zncc_plane *p, *q;
        td_zncc_window window;
        memset(b->data, 255, 40 * 112); /* flat windows */
        check_ok(td_zncc_plane_new(&p, a, k, &error), error);
        check_ok(td_zncc_plane_new(&q, b, k, &error), error);
        for (int n = 0; n < 5; n++) {
            const int i = k + 5 * n, j = k + 3 * n;
            assert_true(td_zncc_window_cut(&window, p, i, j, q));
            for (int y = -1; y <= b->height; y += h == 4 ? 11 : 3)
                for (int x = -1; x <= b->width; x += h == 4 ? 11 : 1) {
                    const double exact = td_zncc(a, i, j, b, x, y, k);
                    const double fast = td_zncc_window_score(x, y, &window);
                    assert_true(isnan(exact) == isnan(fast));
                    if (!isnan(exact)) check_near(fast, exact, 1e-12);
                }
            td_zncc_window_free(&window);
        }
        assert_true(td_zncc_window_cut(&window, p, k - 1, k, q));
        assert_true(isnan(td_zncc_window_score(60, 60, &window)));
        td_zncc_window_free(&window);
        td_zncc_plane_free(&p);
        td_zncc_plane_free(&q);
        td_image_free(&a);
        td_image_free(&b);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_formula),
        cmocka_unit_test(test_undefined),
        cmocka_unit_test(test_fast_form),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
