/* Proves: td_chessboard_detect finds whole boards of every kind of symmetry, numbers them as chessboard.h
 * promises however they are turned, with a sigma that is the scatter; says what it saw when it finds none;
 * gives the same bits on every thread; and finds all of OpenCV's example images.
 *
 * Reference: boards rendered with known corners (render_chessboard.h). A corner counts as right within 0.15
 * px, 1/100 of a square and 5 times its usual error here: a wrong numbering is off by squares. Blind to: the
 * accuracy on real images, which a calibration judges (tests/apps). */
#include "calib/chessboard.h"
#include "core/parallel.h"
#include "core/random.h"
#include "tests/calib/render_chessboard.h"
#include "tests/check.h"

#define OPENCV_IMAGES "/usr/share/doc/opencv-doc/examples/data/"

static td_target target_of(int columns, int rows)
{
    td_target t = {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1};
    t.plane[0] = (td_target_plane){columns, rows, 0.025, td_pose_identity()};
    return t;
}

static scene scene_of(int width, int height, int columns, int rows, bool light_first, double square,
                      double turn, double tilt)
{
    scene s = {width, height, columns, rows, light_first, {0}, {0}, 0.8, 40, 200, 24};
    scene_place(&s, square, turn, tilt, 1);
    return s;
}

static td_image *photograph(const scene *s, double noise, uint64_t seed)
{
    td_random random = td_random_seed(seed, 2);
    td_image *image = NULL;
    td_error error;
    check_ok(td_image_new(&image, s->width, s->height, 1, &error), error);
    double *grey = scene_render(s);
    scene_expose(image->data, grey, s, noise, &random);
    free(grey);
    return image;
}

static td_detection detect(const td_image *image, int columns, int rows)
{
    td_target target = target_of(columns, rows);
    td_detection d;
    td_error error;
    memset(&d, 0xff, sizeof d);
    check_ok(td_chessboard_detect(&d, image, &target, &error), error);
    assert_int_equal(d.count, columns * rows);
    return d;
}

/* Whether point k lies on corner (column, row) of the scene. */
static bool lies_on(const td_detection *d, int k, const scene *s, int column, int row)
{
    double p[2];
    scene_corner(p, s, column, row);
    return hypot(d->point[2 * k] - p[0], d->point[2 * k + 1] - p[1]) < 0.15;
}

/* By how many quarter turns the numbering of a found board differs from the scene's; fails if by none of the
 * four. */
static int turns_of(const td_detection *d, const scene *s)
{
    const int c = s->columns - 1, r = s->rows - 1;
    for (int turns = 0; turns < 4; turns++) {
        int columns = turns % 2 ? s->rows : s->columns, right = 0;
        for (int k = 0; k < (int)d->count; k++) {
            int i = k % columns, j = k / columns;
            int at[4][2] = {{i, j}, {c - j, i}, {c - i, r - j}, {j, r - i}};
            right += lies_on(d, k, s, at[turns][0], at[turns][1]);
        }
        if (right == (int)d->count) return turns;
    }
    fail_msg("%dx%d: points lie on no numbering of the board: %s", s->columns, s->rows, d->reason);
    return -1;
}

/* ---- Order ---- */

/* One of columns and rows even: the colours decide, whatever the turn. */
static void an_odd_sum_is_numbered_by_its_colours(void **state)
{
    (void)state;
    const int size[][2] = {{9, 6}, {6, 9}, {4, 3}, {8, 5}};
    for (int b = 0; b < 4; b++)
        for (int turn = 0; turn < 8; turn++)
            for (int light = 0; light < 2; light++) {
                scene s =
                    scene_of(400, 400, size[b][0], size[b][1], light, 28, 0.1 + turn * SCENE_PI / 4, 0.5);
                td_image *image = photograph(&s, 2, 1);
                td_detection d = detect(image, s.columns, s.rows);
                if (!d.found) fail_msg("%dx%d turn %d: %s", s.columns, s.rows, turn, d.reason);
                assert_string_equal(d.reason, "");
                check_near(d.blur_px, sqrt(0.64 + 1 / 12.0), 0.15);
                assert_int_equal(turns_of(&d, &s), light ? 2 : 0);
                td_detection_free(&d);
                td_image_free(&image);
            }
}

/* Both even or both odd: a half turn keeps the colours, so the image's top left decides. */
static void an_even_sum_is_numbered_from_the_top_left(void **state)
{
    (void)state;
    const int size[][2] = {{8, 6}, {7, 5}, {5, 9}};
    for (int b = 0; b < 3; b++)
        for (int turn = 0; turn < 8; turn++)
            for (int light = 0; light < 2; light++) {
                double angle = 0.1 + turn * SCENE_PI / 4, p[2], q[2];
                scene s = scene_of(400, 400, size[b][0], size[b][1], light, 28, angle, 0.5);
                td_image *image = photograph(&s, 2, 1);
                td_detection d = detect(image, s.columns, s.rows);
                if (!d.found) fail_msg("%dx%d turn %d: %s", s.columns, s.rows, turn, d.reason);
                scene_corner(p, &s, 0, 0);
                scene_corner(q, &s, s.columns - 1, s.rows - 1);
                assert_int_equal(turns_of(&d, &s), p[0] + p[1] < q[0] + q[1] ? 0 : 2);
                td_detection_free(&d);
                td_image_free(&image);
            }
}

/* As many columns as rows: of an even number all four turns look alike, of an odd number those two with a
 * dark first square count. */
static void a_square_board_is_numbered_by_both(void **state)
{
    (void)state;
    for (int n = 5; n <= 6; n++)
        for (int turn = 0; turn < 8; turn++)
            for (int light = 0; light < 2; light++) {
                scene s = scene_of(400, 400, n, n, light, 32, 0.1 + turn * SCENE_PI / 4, 0.5);
                td_image *image = photograph(&s, 2, 1);
                td_detection d = detect(image, n, n);
                if (!d.found) fail_msg("%dx%d turn %d: %s", n, n, turn, d.reason);
                /* Corner 0 after 0 to 3 quarter turns, and the best of those allowed. */
                const int last = n - 1, corner[4][2] = {{0, 0}, {last, 0}, {last, last}, {0, last}};
                int best = -1;
                double least = INFINITY;
                for (int t = 0; t < 4; t++) {
                    double p[2];
                    scene_corner(p, &s, corner[t][0], corner[t][1]);
                    bool dark = n % 2 == 0 || (t % 2 == 1) == light;
                    if (!dark || p[0] + p[1] >= least) continue;
                    best = t, least = p[0] + p[1];
                }
                assert_int_equal(turns_of(&d, &s), best);
                td_detection_free(&d);
                td_image_free(&image);
            }
}

/* A board of 9x6 is one of 6x9 too, on its side: columns along the short side, and the first square dark. */
static void a_transposed_target_is_the_same_board(void **state)
{
    (void)state;
    for (int turn = 0; turn < 4; turn++) {
        scene s = scene_of(400, 400, 9, 6, false, 28, 0.2 + turn * SCENE_PI / 2, 0.4);
        td_image *image = photograph(&s, 2, 1);
        td_detection d = detect(image, 6, 9);
        assert_true(d.found);
        assert_int_equal(turns_of(&d, &s),
                         3); /* from (0, 5), before which the square is dark as before (0, 0) */
        td_detection_free(&d);
        td_image_free(&image);
    }
}

/* ---- Sigma ---- */

/* 40 shots of 54 corners: the ratio's standard deviation is 1.1 %. */
static void sigma_is_the_scatter(void **state)
{
    (void)state;
    check_statistics();
    const double noise[] = {2, 8};
    for (int level = 0; level < 2; level++) {
        double square = 0;
        int count = 0;
        for (int board = 0; board < 4; board++) {
            scene s = scene_of(360, 300, 9, 6, false, 26, 0.1 + 0.7 * board, 0.15 * board);
            s.pairs = 200;
            double *grey = scene_render(&s);
            td_random random = td_random_seed(5, (uint64_t)board);
            for (int shot = 0; shot < 10; shot++) {
                td_image *image = NULL;
                td_error error;
                check_ok(td_image_new(&image, s.width, s.height, 1, &error), error);
                scene_expose(image->data, grey, &s, noise[level], &random);
                td_detection d = detect(image, 9, 6);
                assert_true(d.found);
                for (int k = 0; k < 54; k++) {
                    double p[2];
                    scene_corner(p, &s, k % 9, k / 9);
                    if (!(d.sigma[k] > 0)) continue;
                    for (int c = 0; c < 2; c++) square += pow((d.point[2 * k + c] - p[c]) / d.sigma[k], 2);
                    count++;
                }
                td_detection_free(&d);
                td_image_free(&image);
            }
            free(grey);
        }
        printf("  noise %.0f: scatter / sigma %.3f over %d corners\n", noise[level],
               sqrt(square / (2 * count)), count);
        assert_true(count > 2000);
        check_near(sqrt(square / (2 * count)), 1, 0.06);
    }
}

/* ---- What is not there ---- */

static void expect_reason(const td_image *image, int columns, int rows, const char *words)
{
    td_detection d = detect(image, columns, rows);
    if (d.found) fail_msg("%dx%d was found, not '%s'", columns, rows, words);
    if (!strstr(d.reason, words)) fail_msg("'%s' lacks '%s'", d.reason, words);
    char size[32];
    snprintf(size, sizeof size, "%dx%d inner corners", columns, rows);
    assert_non_null(strstr(d.reason, size));
    for (size_t i = 0; i < d.count; i++) {
        assert_true(isnan(d.point[2 * i]) && isnan(d.point[2 * i + 1]));
        assert_true(d.sigma[i] == 0);
    }
    assert_true(isnan(d.blur_px));
    td_detection_free(&d);
}

/* A board of another size is named; a part of a board is never taken for it. */
static void another_size_is_named(void **state)
{
    (void)state;
    scene s = scene_of(400, 320, 9, 6, false, 28, 0.1, 0.4);
    td_image *image = photograph(&s, 2, 1);
    expect_reason(image, 8, 6, "one of 9x6 seems to be in the image: is it another board?");
    expect_reason(image, 6, 8, "one of 6x9 seems");
    expect_reason(image, 9, 5, "one of 9x6 seems");
    expect_reason(image, 9, 7,
                  "one of 9x6 seems to be in the image: is it another board, or not wholly in view?");
    expect_reason(image, 10, 7, "were squares counted instead of corners?");
    expect_reason(image, 4, 3, "9x6");
    expect_reason(image, 30, 20, "one of 9x6 seems");
    td_image_free(&image);
    scene cut = scene_of(200, 320, 9, 6, false, 28, 0.1, 0.2); /* the outer columns lie outside */
    image = photograph(&cut, 2, 1);
    expect_reason(image, 9, 6, "not wholly in view");
    td_image_free(&image);
}

static void nothing_is_said_to_be_nothing(void **state)
{
    (void)state;
    td_random random = td_random_seed(9, 1);
    td_image *image = NULL;
    td_error error;
    check_ok(td_image_new(&image, 320, 240, 1, &error), error);
    expect_reason(image, 9, 6, "saw none");
    for (int i = 0; i < 320 * 240; i++) image->data[i] = (uint8_t)td_random_below(&random, 256);
    expect_reason(image, 9, 6, "saw none");
    td_image_free(&image);
    for (int side = 1; side < 100; side = 2 * side + 1) { /* images too small for anything */
        check_ok(td_image_new(&image, side, 100 - side, 1, &error), error);
        expect_reason(image, 9, 6, "saw none");
        td_image_free(&image);
    }
}

static void blur_is_named(void **state)
{
    (void)state;
    scene s = scene_of(400, 320, 9, 6, false, 26, 0.1, 0.4);
    s.blur = 8;
    td_image *image = photograph(&s, 1, 1);
    expect_reason(image, 9, 6, "the image is blurred, its edges spread over 7");
    td_image_free(&image);
}

/* ---- Hard but there ---- */

static void blot(td_image *image, const scene *s, int column, int row, int radius, uint8_t grey)
{
    double p[2];
    scene_corner(p, s, column, row);
    for (int y = -radius; y <= radius; y++)
        for (int x = -radius; x <= radius; x++)
            if (x * x + y * y <= radius * radius)
                image->data[((int)p[1] + y) * image->width + (int)p[0] + x] = grey;
}

/* Glare on a few corners leaves them unseen and the rest as it was. */
static void a_few_corners_may_be_unseen(void **state)
{
    (void)state;
    scene s = scene_of(480, 400, 9, 6, false, 36, 0.1, 0.3);
    td_image *image = photograph(&s, 2, 1);
    blot(image, &s, 3, 2, 5, 255);
    blot(image, &s, 7, 4, 5, 255);
    td_detection d = detect(image, 9, 6);
    if (!d.found) fail_msg("%s", d.reason);
    assert_string_equal(d.reason, "2 of 54 corners cannot be measured");
    for (int k = 0; k < 54; k++) {
        bool blotted = k == 2 * 9 + 3 || k == 4 * 9 + 7;
        if (blotted) {
            assert_true(isnan(d.point[2 * k]) && isnan(d.point[2 * k + 1]) && d.sigma[k] == 0);
        } else {
            assert_true(lies_on(&d, k, &s, k % 9, k / 9) && d.sigma[k] > 0 && d.sigma[k] < 0.05);
        }
    }
    td_detection_free(&d);
    for (int k = 0; k < 54; k += 3) blot(image, &s, k % 9, k / 9, 5, 255);
    d = detect(image, 9, 6);
    assert_false(d.found);
    assert_true(strlen(d.reason) > 0);
    printf("  with a third blotted: %s\n", d.reason);
    td_detection_free(&d);
    td_image_free(&image);
}

/* Large images are searched shrunk, dark and unevenly lit ones by other thresholds, blurred ones by sectors.
 */
static void hard_images_are_found(void **state)
{
    (void)state;
    scene large = scene_of(2400, 1800, 9, 6, false, 150, 0.2, 0.4),
          small = scene_of(1800, 1400, 9, 6, false, 12, 0.2, 0.4);
    scene blurred = scene_of(480, 400, 9, 6, false, 36, 0.1, 0.3), dark = blurred, oblique = blurred;
    large.blur = 2.5;
    blurred.blur = 5;
    dark.dark = 6, dark.light = 30;
    scene_place(&oblique, 34, 0.3, 1.0, 0.4);
    const scene hard[] = {large, small, blurred, dark, oblique};
    static const char *const name[] = {"large", "small in large", "blurred", "dark", "oblique"};
    for (int i = 0; i < 5; i++) {
        td_image *image = photograph(&hard[i], 1, 3);
        td_detection d = detect(image, 9, 6);
        if (!d.found) fail_msg("%s: %s", name[i], d.reason);
        int unseen = 0, wrong = 0;
        for (int k = 0; k < 54; k++) {
            double p[2];
            scene_corner(p, &hard[i], k % 9, k / 9);
            unseen += d.sigma[k] == 0;
            wrong += d.sigma[k] > 0 && hypot(d.point[2 * k] - p[0], d.point[2 * k + 1] - p[1]) > 0.3;
        }
        printf("  %-14s blur %.2f px, sigma of the first %.4f px, unseen %d\n", name[i], d.blur_px,
               d.sigma[0], unseen);
        assert_int_equal(wrong, 0);
        assert_true(unseen <= 1);
        td_detection_free(&d);
        td_image_free(&image);
    }
}

typedef struct shots {
    td_image *image[8];
    td_detection detection[8];
    td_target target;
} shots;

static void detect_one(size_t i, void *user)
{
    shots *s = user;
    td_error error;
    if (td_chessboard_detect(&s->detection[i], s->image[i], &s->target, &error) != TD_OK) abort();
}

/* The search by sectors draws random numbers, and both searches use OpenCV's threads. */
static void the_same_bits_on_every_thread(void **state)
{
    (void)state;
    shots serial = {.target = target_of(9, 6)};
    for (int i = 0; i < 8; i++) {
        scene s = scene_of(360, 300, 9, 6, false, 27, 0.3 * i, 0.4);
        if (i % 2) s.blur = 4.5;
        serial.image[i] = photograph(&s, 3, (uint64_t)i);
    }
    shots parallel = serial;
    for (size_t i = 0; i < 8; i++) detect_one(i, &serial);
    assert_int_equal(td_parallel_for(8, 4, detect_one, &parallel, NULL, "boards"), TD_OK);
    for (int i = 0; i < 8; i++) {
        td_detection *a = &serial.detection[i], *b = &parallel.detection[i];
        assert_true(a->found);
        assert_memory_equal(a->point, b->point, 2 * 54 * sizeof *a->point);
        assert_memory_equal(a->sigma, b->sigma, 54 * sizeof *a->sigma);
        assert_string_equal(a->reason, b->reason);
        td_detection_free(a);
        td_detection_free(b);
        td_image_free(&serial.image[i]);
    }
}

static void bad_arguments_are_refused(void **state)
{
    (void)state;
    td_error error;
    td_image *colour = NULL, *grey = NULL;
    check_ok(td_image_new(&colour, 100, 100, 3, &error), error);
    check_ok(td_image_new(&grey, 100, 100, 1, &error), error);
    td_target board = target_of(9, 6), marks = board, small = target_of(2, 6);
    marks.kind = TD_TARGET_MARKS, marks.diameter_m = 0.01;
    td_detection d;
    check_fails(td_chessboard_detect(&d, colour, &board, &error), TD_ERROR_ARGUMENT, error, "3 channels");
    assert_null(d.point);
    check_fails(td_chessboard_detect(&d, grey, &marks, &error), TD_ERROR_ARGUMENT, error, "not a chessboard");
    check_fails(td_chessboard_detect(&d, grey, &small, &error), TD_ERROR_ARGUMENT, error, "columns");
    td_image_free(&colour);
    td_image_free(&grey);
}

/* OpenCV's own detector finds these 26 too; it needs half as long again. Left and right must agree on corner
 * 0, and the order is OpenCV's. */
static void opencv_images_are_found(void **state)
{
    (void)state;
    static const char *const side[] = {"left", "right"};
    /* Where OpenCV's findChessboardCorners puts corner 0 in images 1 to 3, to the pixel. */
    static const double first[2][3][2] = {{{244.5, 94.3}, {256.6, 357.2}, {277.4, 72.5}},
                                          {{128.5, 110.4}, {127.4, 366.5}, {133.4, 89.8}}};
    double sigma = 0;
    int found = 0;
    for (int s = 0; s < 2; s++)
        for (int i = 1; i <= 14; i++) {
            char path[128];
            if (i == 10) continue;
            snprintf(path, sizeof path, OPENCV_IMAGES "%s%02d.jpg", side[s], i);
            td_image *image = NULL;
            td_error error;
            if (td_image_read(&image, path, 1, &error) != TD_OK) {
                print_message("skipped: %s (install opencv-doc)\n", error.message);
                skip();
            }
            td_detection d = detect(image, 9, 6);
            if (!d.found || *d.reason) fail_msg("%s: %s", path, d.reason);
            for (int c = 0; c < 2 && i <= 3; c++) check_near(d.point[c], first[s][i - 1][c], 1);
            for (int k = 0; k < 54; k++) sigma += d.sigma[k] / 54;
            check_near(d.blur_px, 0.85, 0.25);
            found++;
            td_detection_free(&d);
            td_image_free(&image);
        }
    printf("  %d images, mean sigma %.4f px\n", found, sigma / found);
    check_near(sigma / found, 0.028, 0.006);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_odd_sum_is_numbered_by_its_colours),
        cmocka_unit_test(an_even_sum_is_numbered_from_the_top_left),
        cmocka_unit_test(a_square_board_is_numbered_by_both),
        cmocka_unit_test(a_transposed_target_is_the_same_board),
        cmocka_unit_test(sigma_is_the_scatter),
        cmocka_unit_test(another_size_is_named),
        cmocka_unit_test(nothing_is_said_to_be_nothing),
        cmocka_unit_test(blur_is_named),
        cmocka_unit_test(a_few_corners_may_be_unseen),
        cmocka_unit_test(hard_images_are_found),
        cmocka_unit_test(the_same_bits_on_every_thread),
        cmocka_unit_test(bad_arguments_are_refused),
        cmocka_unit_test(opencv_images_are_found),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
