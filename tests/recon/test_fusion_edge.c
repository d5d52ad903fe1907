/* What the image says of edges (recon/fusion_edge.c), on disparities written down here:
 * - a plane however aslant has none: 0 everywhere but for rounding;
 * - a step of 10 px is found on both sides as far as a window reaches (0.45 of 3 px, less what chance makes:
 *   1.2 px), and for what it is within 4 px on its nearer side, which fattening moves (4.5 px); nothing is
 *   found beyond 13 px (a window of 8 and 5 of the look);
 * - a fold too small to matter has none;
 * - white noise of 0.1 px sigma, rougher than matching's, which goes together over 8 px: fewer than 1 % of
 * the pixels (the largest of 12 looks, 0.24 px each, is beyond 1.35 px once in 10^7);
 * - pixels without a disparity change nothing but the looks that need them, and are never an edge's;
 * - one thread and three give the same bits.
 * And of the relief around a pixel (recon/fusion_relief.c), over 20 x 20 px:
 * - a plane has none, 1e-3 px of rounding; white noise has its own sigma, to 20 % (the mean of 400, to 2 %);
 * - a step of H through the middle has H / 4: of its variance, H^2 / 4, the plane takes three quarters;
 * - where fewer than 10 pixels are known it is 0; one thread and three give the same bits.
 * Blind to: how often what is flagged is wrong (rendered ground in test_site_map and apps/test_site). */
#include "core/random.h"
#include "recon/fusion_internal.h"
#include "tests/check.h"

enum { WIDTH = 160, HEIGHT = 120, STEP_AT = 60 };

typedef struct field {
    td_disparity d;
    float value[WIDTH * HEIGHT];
} field;

static float *edges_of(field *f, int threads)
{
    td_error error;
    float *edge = NULL;
    f->d = (td_disparity){.width = WIDTH, .height = HEIGHT, .value = f->value};
    check_ok(td_frame_edges(&edge, &f->d, threads, &error), error);
    return edge;
}

static double plane(int x, int y)
{
    return 50 + 0.21 * x - 0.13 * y;
}

static void fill(field *f, double step, double noise)
{
    td_random random = td_random_seed(7, 0);
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        const int x = i % WIDTH, y = i / WIDTH;
        f->value[i] = (float)(plane(x, y) + (y >= STEP_AT ? step : 0) + noise * td_random_normal(&random));
    }
}

static double largest(const float *edge, int first_row, int end_row)
{
    double most = 0;
    for (int i = first_row * WIDTH; i < end_row * WIDTH; i++) most = fmax(most, (double)edge[i]);
    return most;
}

static void test_plane(void **state)
{
    (void)state;
    static field f;
    fill(&f, 0, 0);
    float *edge = edges_of(&f, 1);
    assert_true(largest(edge, 0, HEIGHT) == 0);
    free(edge);
    fill(&f, 1.2, 0); /* less than roughness makes */
    edge = edges_of(&f, 1);
    assert_true(largest(edge, 0, HEIGHT) == 0);
    free(edge);
}

static void test_step(void **state)
{
    (void)state;
    static field f;
    fill(&f, 10, 0);
    float *edge = edges_of(&f, 1);
    for (int y = STEP_AT - 8; y < STEP_AT + 8; y++)
        for (int x = 20; x < WIDTH - 20; x++) {
            const double here = (double)edge[y * WIDTH + x];
            const bool beside = y >= STEP_AT && y < STEP_AT + 4;
            assert_true(here > (beside ? 4 : 1) && here < (beside ? 5 : 1.4));
        }
    assert_true(largest(edge, 0, STEP_AT - 13) == 0);
    assert_true(largest(edge, STEP_AT + 13, HEIGHT) == 0);
    free(edge);
}

static void test_noise(void **state)
{
    (void)state;
    static field f;
    fill(&f, 0, 0.1);
    float *edge = edges_of(&f, 1);
    int fires = 0;
    for (int i = 0; i < WIDTH * HEIGHT; i++) fires += edge[i] > 0;
    print_message("noise of 0.1 px: %d of %d pixels\n", fires, WIDTH * HEIGHT);
    check_less(fires, 0.01 * WIDTH * HEIGHT);
    free(edge);
}

static void test_missing(void **state)
{
    (void)state;
    static field f, whole;
    fill(&f, 10, 0);
    fill(&whole, 10, 0);
    for (int y = 40; y < 90; y++)
        for (int x = 60; x < 75; x++) f.value[y * WIDTH + x] = NAN;
    for (int x = 0; x < WIDTH; x++) f.value[x] = NAN;
    float *edge = edges_of(&f, 1), *other = edges_of(&whole, 3), *again = edges_of(&f, 3);
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        const int x = i % WIDTH;
        assert_true(edge[i] >= 0 && edge[i] <= other[i]);
        if (i >= 25 * WIDTH && (x < 60 - 13 || x >= 75 + 13)) assert_true(edge[i] == other[i]);
    }
    assert_memory_equal(edge, again, sizeof f.value);
    for (int i = 0; i < WIDTH * HEIGHT; i++) f.value[i] = NAN;
    free(again);
    again = edges_of(&f, 1);
    assert_true(largest(again, 0, HEIGHT) == 0);
    free(edge);
    free(other);
    free(again);
}

static float *relief_of(field *f, int threads)
{
    td_error error;
    float *relief = NULL;
    f->d = (td_disparity){.width = WIDTH, .height = HEIGHT, .value = f->value};
    check_ok(td_frame_relief(&relief, &f->d, threads, &error), error);
    return relief;
}

static void test_relief(void **state)
{
    (void)state;
    enum { COLUMNS = WIDTH / TD_RELIEF_BLOCK, ROWS = HEIGHT / TD_RELIEF_BLOCK };
    static field f;
    fill(&f, 0, 0);
    float *relief = relief_of(&f, 1);
    for (int i = 0; i < COLUMNS * ROWS; i++) check_less((double)relief[i], 1e-3);
    free(relief);
    fill(&f, 0, 0.1);
    relief = relief_of(&f, 1);
    for (int i = 0; i < COLUMNS * ROWS; i++) check_near((double)relief[i], 0.1, 0.02);
    free(relief);
    fill(&f, 10, 0);
    relief = relief_of(&f, 3);
    const int edge = STEP_AT / TD_RELIEF_BLOCK;
    for (int x = 2; x < COLUMNS - 2; x++) {
        check_near((double)relief[edge * COLUMNS + x], 2.5, 0.3); /* 8 rows of the 20 are before the step */
        check_less((double)relief[(edge + 3) * COLUMNS + x], 1e-3);
    }
    float *again = relief_of(&f, 1);
    assert_memory_equal(relief, again, COLUMNS * ROWS * sizeof *relief);
    free(relief);
    free(again);
    for (int i = 9; i < WIDTH * HEIGHT; i++) f.value[i] = NAN;
    relief = relief_of(&f, 1);
    for (int i = 0; i < COLUMNS * ROWS; i++) assert_true(relief[i] == 0);
    free(relief);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_plane), cmocka_unit_test(test_step),
                                       cmocka_unit_test(test_noise), cmocka_unit_test(test_missing),
                                       cmocka_unit_test(test_relief)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
