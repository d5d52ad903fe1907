/* Proves: td_corner_refine finds corners without bias, its derivatives are right, its sigma is the scatter,
 * it notices correlated noise, and it refuses what is no corner.
 *
 * Reference: chessboards rendered by render_chessboard.h, which knows nothing of the model that is fitted.
 * Tolerances: without noise the errors are the renderer's own (they halve with four times the offsets; with
 * 5120 pairs they are 0.0006 to 0.0026 px, that of rounding to 8 bits), so the bounds are twice what is seen
 * with the offsets used here. OpenCV's cornerSubPix with half-window 5 has 3 to 10 times the errors of this
 * fit, with and without noise. Blind to: lines bent by distortion, real JPEG artefacts, lenses whose blur is
 * not symmetric. */
#include "calib/corner.h"
#include "calib/corner_internal.h"
#include "core/random.h"
#include "tests/calib/render_chessboard.h"
#include "tests/check.h"

enum { SIDE = 240, COUNT = 7 }; /* px of an image; corners of its board along each side */

/* A board seen at random angles. */
static scene random_scene(td_random *random, double square, double blur, int pairs)
{
    scene s = {SIDE, SIDE, COUNT, COUNT, false, {0}, {0}, blur, 40, 200, pairs};
    scene_place(&s, square, 2 * SCENE_PI * td_random_uniform(random), 0.7 * td_random_uniform(random),
                2 * SCENE_PI * td_random_uniform(random));
    return s;
}

static void true_steps(double along_column[2], double along_row[2], const scene *s, int column, int row)
{
    double p[2], q[2];
    scene_corner(p, s, column + 1, row), scene_corner(q, s, column - 1, row);
    for (int k = 0; k < 2; k++) along_column[k] = (p[k] - q[k]) / 2;
    scene_corner(p, s, column, row + 1), scene_corner(q, s, column, row - 1);
    for (int k = 0; k < 2; k++) along_row[k] = (p[k] - q[k]) / 2;
}

typedef struct tally {
    int tried, refined;
    double sum[2], square, worst; /* of the errors, px */
    double variance, white;       /* of what was predicted, px^2 */
    double normalised;            /* sum of squared errors over the pooled variance */
    double blur;                  /* sum */
} tally;

/* Refines every corner of an image, from starts up to `away` px off. */
static void refine_all(tally *t, const uint8_t *pixels, const scene *s, double away, td_random *random)
{
    td_image image = {s->width, s->height, 1, (uint8_t *)pixels};
    double error[2 * COUNT * COUNT], white[COUNT * COUNT], inflation = 0;
    int n = 0;
    for (int row = 0; row < s->rows; row++)
        for (int column = 0; column < s->columns; column++) {
            double truth[2], start[2], x[2], y[2];
            scene_corner(truth, s, column, row);
            if (fmin(truth[0], truth[1]) < 15 || fmax(truth[0], truth[1]) > SIDE - 16) continue;
            for (int k = 0; k < 2; k++) start[k] = truth[k] + away * (2 * td_random_uniform(random) - 1);
            true_steps(x, y, s, column, row);
            td_corner corner;
            memset(&corner, 0xff, sizeof corner);
            t->tried++;
            if (!td_corner_refine(&corner, &image, start, x, y)) continue;
            for (int k = 0; k < 2; k++) error[2 * n + k] = corner.position[k] - truth[k];
            white[n] = corner.white * corner.white;
            inflation += corner.sigma * corner.sigma / white[n];
            t->variance += corner.sigma * corner.sigma;
            t->white += white[n++];
            t->blur += corner.blur;
        }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 2; k++) {
            double e = error[2 * i + k];
            t->sum[k] += e;
            t->square += e * e;
            t->worst = fmax(t->worst, fabs(e));
            t->normalised += e * e / (white[i] * inflation / n);
        }
    t->refined += n;
}

static double rms(const tally *t)
{
    return sqrt(t->square / (2 * t->refined));
}
static double bias(const tally *t)
{
    return hypot(t->sum[0], t->sum[1]) / t->refined;
}

/* ---- Tests ---- */

static void check_derivatives(bool wedge)
{
    const double at[CORNER_PARAMETERS] = {0.3, -0.2, 0.4, 2.1, 1.3, 110, 70, 0.4, -0.3};
    const double step[CORNER_PARAMETERS] = {0.02, 0.02, 0.002, 0.002, 0.02, 1, 1, 0.1, 0.1};
    corner_window *w = calloc(3, sizeof *w);
    for (int y = -9; y <= 9; y++)
        for (int x = -9; x <= 9; x++) {
            w->x[w->count] = (float)x, w->y[w->count] = (float)y;
            w->derivative[CORNER_MEAN][w->count] = 1;
            w->derivative[CORNER_SLOPE_X][w->count] = (float)x;
            w->derivative[CORNER_SLOPE_Y][w->count++] = (float)y;
        }
    w[0].wedge = wedge;
    w[1] = w[2] = w[0];
    td_corner_model(&w[0], at);
    bool identical = true;
    for (int k = 0; k < CORNER_PARAMETERS; k++) {
        double plus[CORNER_PARAMETERS], minus[CORNER_PARAMETERS], largest = 0;
        memcpy(plus, at, sizeof at), memcpy(minus, at, sizeof at);
        plus[k] += step[k], minus[k] -= step[k];
        td_corner_model(&w[1], plus), td_corner_model(&w[2], minus);
        for (int i = 0; i < w->count; i++) largest = fmax(largest, fabs((double)w[0].derivative[k][i]));
        assert_true(largest > 0);
        for (int i = 0; i < w->count; i++) {
            double difference = ((double)w[2].residual[i] - (double)w[1].residual[i]) / (2 * step[k]);
            check_near((double)w[0].derivative[k][i], difference, 2e-3 * largest);
            identical = identical && difference == (double)w[0].derivative[k][i];
        }
    }
    assert_false(identical);
    free(w);
}

static void derivatives_are_those_of_the_model(void **state)
{
    (void)state;
    check_derivatives(false);
    check_derivatives(true);
}

static void no_bias_without_noise(void **state)
{
    (void)state;
    check_statistics();
    td_random random = td_random_seed(1, 1);
    const double square[] = {30, 30, 30, 30, 14, 14}, blur[] = {0.4, 1, 2, 3, 0.5, 1.5};
    const double bound[] = {0.003, 0.007, 0.009, 0.009, 0.004, 0.008};
    printf("  square  blur  RMS px   mean px  worst px  measured blur\n");
    for (int k = 0; k < 6; k++) {
        tally t = {0};
        for (int board = 0; board < 2; board++) {
            scene s = random_scene(&random, square[k], blur[k], 640);
            double *grey = scene_render(&s);
            uint8_t pixels[SIDE * SIDE];
            scene_expose(pixels, grey, &s, 0, &random);
            refine_all(&t, pixels, &s, 1.5, &random);
            free(grey);
        }
        printf("  %6.0f  %4.1f  %.5f  %.5f  %.4f    %.3f\n", square[k], blur[k], rms(&t), bias(&t), t.worst,
               t.blur / t.refined);
        assert_int_equal(t.refined, t.tried);
        check_less(rms(&t), bound[k]);
        check_less(bias(&t), 0.002);
        /* The blur of the pixel's own width comes on top. */
        check_near(t.blur / t.refined, sqrt(blur[k] * blur[k] + 1 / 12.0), 0.02);
    }
}

/* Sharpening, a curved response and stray light that fades across the image leave the corner where it is.
 * Illumination that falls by 20 % over 240 px (grey levels multiplied, where the model adds) moves it by
 * 0.005 px: the bound is to notice when that grows. */
static void what_the_model_lacks_hardly_moves_it(void **state)
{
    (void)state;
    check_statistics();
    enum { SHARPENED, CURVED, STRAY, FALLING, KINDS };
    static const char *const name[KINDS] = {"sharpened", "gamma 2.2", "stray light", "falling light"};
    static const double bound[KINDS] = {0.002, 0.002, 0.002, 0.008};
    td_random random = td_random_seed(2, 1);
    for (int kind = 0; kind < KINDS; kind++) {
        tally t = {0};
        for (int board = 0; board < 3; board++) {
            scene s = random_scene(&random, 30, 1, 320);
            double *grey = scene_render(&s);
            uint8_t pixels[SIDE * SIDE] = {0};
            for (int y = 1; y + 1 < SIDE; y++)
                for (int x = 1; x + 1 < SIDE; x++) {
                    const double *g = grey + y * SIDE + x, across = (x - SIDE / 2.0) / SIDE;
                    double v = g[0];
                    if (kind == SHARPENED) v += 0.25 * (4 * g[0] - g[1] - g[-1] - g[SIDE] - g[-SIDE]);
                    if (kind == CURVED) v = 255 * pow(g[0] / 255, 1 / 2.2);
                    if (kind == STRAY) v += 40 * across;
                    if (kind == FALLING) v *= 1 + 0.2 * across;
                    pixels[y * SIDE + x] = (uint8_t)fmin(fmax(round(v), 0), 255);
                }
            refine_all(&t, pixels, &s, 1, &random);
            free(grey);
        }
        printf("  %-13s RMS %.5f px, mean %.5f px, of %d refined %d\n", name[kind], rms(&t), bias(&t),
               t.tried, t.refined);
        assert_int_equal(t.refined, t.tried);
        check_less(rms(&t), 0.01);
        check_less(bias(&t), bound[kind]);
    }
}

/* Some 1900 corners for each level of noise: with two coordinates each, the ratio has a standard deviation
 * of 1.2 %, and 0.05 is its 99.9 % bound with a little room for the renderer's error. */
static void sigma_is_the_scatter(void **state)
{
    (void)state;
    check_statistics();
    td_random random = td_random_seed(3, 1);
    const double noise[] = {2, 8}, blur[] = {0.5, 1, 1.5, 2, 0.7};
    for (int level = 0; level < 2; level++) {
        tally t = {0};
        for (int board = 0; board < 5; board++) {
            scene s = random_scene(&random, board % 2 ? 28 : 16, blur[board % 5], 320);
            double *grey = scene_render(&s);
            uint8_t pixels[SIDE * SIDE];
            for (int shot = 0; shot < 8; shot++) {
                scene_expose(pixels, grey, &s, noise[level], &random);
                refine_all(&t, pixels, &s, 1, &random);
            }
            free(grey);
        }
        double own = sqrt(t.square / (2 * t.variance)), pooled = sqrt(t.normalised / (2 * t.refined));
        printf(
            "  noise %.0f: RMS %.4f px, mean %.4f px; scatter / sigma %.3f (own), %.3f (pooled), %d of %d\n",
            noise[level], rms(&t), bias(&t), own, pooled, t.refined, t.tried);
        assert_true(t.tried > 1500 && t.refined >= 0.99 * t.tried);
        check_near(own, 1, 0.05);
        check_near(pooled, 1, 0.05);
        check_less(bias(&t), 0.06 * rms(&t));
    }
}

/* Noise that neighbours share (JPEG, demosaicing): as white noise it would be taken to be much too harmless.
 * Blocks of 3x3 pixels see five sixths of the standard deviation of noise averaged over 2x2, so 1.2 is
 * expected. */
static void sigma_knows_correlated_noise(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 1);
    tally t = {0};
    for (int board = 0; board < 6; board++) {
        scene s = random_scene(&random, 28, 1, 320);
        double *grey = scene_render(&s), *white = malloc(SIDE * SIDE * sizeof *white);
        uint8_t pixels[SIDE * SIDE];
        for (int shot = 0; shot < 4; shot++) {
            for (int i = 0; i < SIDE * SIDE; i++) white[i] = 12 * td_random_normal(&random);
            for (int i = 0; i < SIDE * SIDE; i++) {
                double sum = 0;
                for (int dy = 0; dy < 2; dy++)
                    for (int dx = 0; dx < 2; dx++) sum += white[(i + dy * SIDE + dx) % (SIDE * SIDE)];
                pixels[i] = (uint8_t)fmin(fmax(round(grey[i] + sum / 4), 0), 255);
            }
            refine_all(&t, pixels, &s, 1, &random);
        }
        free(grey);
        free(white);
    }
    double own = sqrt(t.square / (2 * t.variance)), as_white = sqrt(t.square / (2 * t.white));
    printf("  noise averaged over 2x2 pixels: scatter / sigma %.3f, as white noise %.3f\n", own, as_white);
    check_near(own, 1.2, 0.12);
    check_less(1.6, as_white);
}

/* One corner between squares 28 px wide, turned by `turn`. */
static scene one_corner(double turn, bool light_first)
{
    scene s = {SIDE, SIDE, COUNT, COUNT, light_first, {0}, {0}, 1, 40, 200, 160};
    scene_place(&s, 28, turn, 0.3, 1);
    return s;
}

static void contrast_tells_the_colours(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int light = 0; light < 2; light++)
        for (int quarter = 0; quarter < 4; quarter++) {
            scene s = one_corner(0.3 + quarter * SCENE_PI / 2, light);
            double *grey = scene_render(&s), truth[2], x[2], y[2];
            uint8_t pixels[SIDE * SIDE];
            scene_expose(pixels, grey, &s, 0, &random);
            td_image image = {SIDE, SIDE, 1, pixels};
            scene_corner(truth, &s, 3, 3);
            true_steps(x, y, &s, 3, 3);
            td_corner corner, other;
            assert_true(td_corner_refine(&corner, &image, truth, x, y));
            check_near(corner.contrast, light ? 160 : -160, 2); /* square (3, 3) has the colour of (-1, -1) */
            assert_true(td_corner_refine(&other, &image, truth, y, x)); /* the same square, mirrored order */
            check_near(other.contrast, corner.contrast, 0.1);
            check_near(other.position[0], corner.position[0], 1e-3);
            const double back[2] = {-x[0], -x[1]};
            assert_true(td_corner_refine(&other, &image, truth, back, y));
            check_near(other.contrast, -corner.contrast, 0.1);
            free(grey);
        }
}

static void refuses(const td_image *image, double x, double y, const double step[2][2])
{
    td_corner corner;
    const double start[2] = {x, y};
    if (td_corner_refine(&corner, image, start, step[0], step[1]))
        fail_msg("(%g, %g): a corner at (%g, %g), sigma %g, contrast %g, residual %g", x, y,
                 corner.position[0], corner.position[1], corner.sigma, corner.contrast, corner.residual);
}

static void what_is_no_corner_is_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(6, 1);
    const double step[2][2] = {{28, 1}, {-1, 28}}, tiny[2][2] = {{4, 0}, {0, 4}},
                 same[2][2] = {{28, 1}, {28, 1}};
    const double skew[2][2] = {{28, 28}, {-28, 28}}, not [2][2] = {{NAN, 1}, {-1, 28}};
    uint8_t pixels[SIDE * SIDE];
    td_image image = {SIDE, SIDE, 1, pixels};

    memset(pixels, 90, sizeof pixels);
    refuses(&image, 120, 120, step);
    for (int i = 0; i < SIDE * SIDE; i++) pixels[i] = i % SIDE < 120 ? 30 : 220; /* an edge */
    refuses(&image, 120, 120, step);
    for (int i = 0; i < SIDE * SIDE; i++)
        pixels[i] = i % SIDE < 120 && i / SIDE < 120 ? 30 : 220; /* a board's end */
    for (int k = -2; k <= 2; k++) refuses(&image, 120 + k, 119, step);
    for (int i = 0; i < SIDE * SIDE; i++) pixels[i] = (uint8_t)td_random_below(&random, 256);
    for (int k = 0; k < 200; k++) refuses(&image, 30 + 0.9 * k, 210 - 0.9 * k, step);

    scene s = one_corner(0, false);
    scene_place(&s, 28, 0, 0, 0);
    double *grey = scene_render(&s), truth[2];
    scene_expose(pixels, grey, &s, 0, &random);
    scene_corner(truth, &s, 3, 3);
    td_corner corner;
    assert_true(td_corner_refine(&corner, &image, truth, step[0], step[1])); /* so the rest tells something */
    refuses(&image, truth[0] + 14, truth[1] + 14, step);                     /* the middle of a square */
    refuses(&image, truth[0] + 14, truth[1], step);                          /* the middle of an edge */
    refuses(&image, truth[0], truth[1], tiny);
    refuses(&image, truth[0], truth[1], same);
    refuses(&image, truth[0], truth[1], skew);
    refuses(&image, truth[0], truth[1], not );
    refuses(&image, NAN, truth[1], step);
    refuses(&image, INFINITY, truth[1], step);
    refuses(&image, -50, truth[1], step);
    refuses(&image, truth[0], 1e9, step);
    td_image colour = {SIDE / 3, SIDE, 3, pixels};
    refuses(&colour, 30, 30, step);
    free(grey);
}

/* Corners close to the border are found as long as a window of three pixels is left. */
static void border_is_kept(void **state)
{
    (void)state;
    td_random random = td_random_seed(7, 1);
    scene s = one_corner(0, false);
    scene_place(&s, 28, 0, 0, 0);
    double *grey = scene_render(&s), truth[2];
    uint8_t pixels[SIDE * SIDE];
    const double step[2][2] = {{28, 0}, {0, 28}};
    scene_expose(pixels, grey, &s, 0, &random);
    scene_corner(truth, &s, 3, 3);
    for (int left = 0; left < 12; left++) {
        /* The image cut off `left` px to the right of the corner, in memory of its own for the sanitizer. */
        int width = (int)truth[0] + left + 1;
        td_image *cut = NULL;
        td_error error;
        check_ok(td_image_new(&cut, width, SIDE, 1, &error), error);
        for (int y = 0; y < SIDE; y++) memcpy(cut->data + y * width, pixels + y * SIDE, (size_t)width);
        td_corner corner;
        bool found = td_corner_refine(&corner, cut, truth, step[0], step[1]);
        if (left < 3) assert_false(found);
        if (left > 4) assert_true(found);
        if (found) check_near(corner.position[0], truth[0], 0.02);
        td_image_free(&cut);
    }
    free(grey);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(derivatives_are_those_of_the_model),   cmocka_unit_test(no_bias_without_noise),
        cmocka_unit_test(what_the_model_lacks_hardly_moves_it), cmocka_unit_test(sigma_is_the_scatter),
        cmocka_unit_test(sigma_knows_correlated_noise),         cmocka_unit_test(contrast_tells_the_colours),
        cmocka_unit_test(what_is_no_corner_is_refused),         cmocka_unit_test(border_is_kept),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
