/* Proves: what td_target_render draws of every kind of target lies where pixel_from_target says, its inside
 * and outside have the right colours, the detector of its kind finds it, blurred and in perspective, in the
 * order of the target's points; lengths follow the printer's scale; the white that detectors need stays
 * white; the same input gives the same bytes; what cannot be drawn is refused by name.
 *
 * Reference: td_target_point_on_plane and td_tag_cells; for the charuco OpenCV's pictures as its documents
 * describe them. Positions are asked within 0.1 px in a view of 0.2 mm per px: half a pixel of the drawing, a
 * tenth of any wrong convention (pixel corners for centres: 0.5). Blind to: what a printer makes of it. */
#include "calib/detection.h"
#include "calib/tag_dictionary.h"
#include "calib/target_drawing.h"
#include "core/file.h"
#include "tests/calib/render_chessboard.h"
#include "tests/check.h"
#include "tests/scratch.h"

static td_target target_of(td_target_kind kind, int columns, int rows, double spacing_m)
{
    td_target t = {.kind = kind, .plane_count = 1, .border = 1};
    t.plane[0] = (td_target_plane){columns, rows, spacing_m, td_pose_identity()};
    if (kind == TD_TARGET_MARKS) t.diameter_m = spacing_m / 2;
    if (kind == TD_TARGET_APRILGRID || kind == TD_TARGET_CHARUCO) t.tag_size_m = 0.75 * spacing_m;
    strcpy(t.dictionary, kind == TD_TARGET_CHARUCO ? "aruco4x4_50" : "tag36h11");
    return t;
}

static td_target two_tags(void)
{
    td_target t = {.kind = TD_TARGET_TAGS, .border = 1, .dictionary = "tag36h11", .tag_count = 2};
    t.tag[0] = (td_target_tag){7, 0.05, td_pose_identity()};
    t.tag[1] = (td_target_tag){3, 0.04, td_pose_identity()};
    t.tag[1].target_from_tag.t[0] = 0.08;
    return t;
}

/* Bare, in pixels of 0.1 mm. */
static td_target_drawing_options bare(void)
{
    td_target_drawing_options o = td_target_drawing_options_default();
    o.ruler = o.text = false;
    o.dots_per_inch = 254;
    return o;
}

typedef struct drawing {
    td_image *image;
    double a[6];
} drawing;

static drawing render(const td_target *target, int plane, const td_target_drawing_options *options)
{
    drawing d = {NULL, {0}};
    td_error error;
    check_ok(td_target_render(&d.image, d.a, target, plane, options, &error), error);
    return d;
}

static int grey_at(const drawing *d, double x_m, double y_m)
{
    const double u = d->a[0] * x_m + d->a[1] * y_m + d->a[2], v = d->a[3] * x_m + d->a[4] * y_m + d->a[5];
    return (int)lround(td_image_sample(d->image, u, v, 0));
}

static void check_ink(const drawing *d, double x_m, double y_m, bool dark)
{
    const int grey = grey_at(d, x_m, y_m);
    if (grey != (dark ? 0 : 255)) fail_msg("grey is %d at (%g, %g) m", grey, x_m, y_m);
}

/* The drawing in perspective: turned by some degrees, half as large, a little nearer on one side; px to px.
 */
static const double view_from_drawing[9] = {0.49, 0.06, 40, -0.05, 0.5, 140, 6e-5, -4e-5, 1};

static void view_of(double out[2], double u, double v)
{
    scene_apply(out, view_from_drawing, u, v);
}

static td_image *photograph(const drawing *d)
{
    enum { SIDE = 5 };
    td_image *view = NULL;
    td_error error;
    double back[9];
    scene_invert(back, view_from_drawing);
    check_ok(td_image_new(&view, 1000, 800, 1, &error), error);
    for (int y = 0; y < view->height; y++)
        for (int x = 0; x < view->width; x++) {
            double p[2], q[2], sum = 0, weights = 0;
            scene_apply(p, back, x, y);
            scene_apply(q, back, x + 1, y);
            const double step = hypot(q[0] - p[0], q[1] - p[1]);
            for (int i = 0; i < SIDE * SIDE; i++) {
                const double a = (i % SIDE - SIDE / 2) * 0.6, b = (i / SIDE - SIDE / 2) * 0.6;
                const double weight = exp(-(a * a + b * b) / 2 / 0.6 / 0.6);
                const double u = p[0] + a * step, v = p[1] + b * step;
                const bool inside = u >= 0 && v >= 0 && u <= d->image->width - 1 && v <= d->image->height - 1;
                sum += weight * (inside ? td_image_sample(d->image, u, v, 0) : 255);
                weights += weight;
            }
            view->data[y * view->width + x] = (uint8_t)lround(20 + 0.85 * sum / weights);
        }
    return view;
}

/* Draws the target, takes a view, and asks the detector for its points. */
static void check_found(const td_target *target)
{
    const td_target_drawing_options o = bare();
    drawing d = render(target, 0, &o);
    td_image *view = photograph(&d);
    td_detection seen;
    td_error error;
    check_ok(td_detect(&seen, view, target, &error), error);
    if (!seen.found) fail_msg("%s: %s", td_target_kind_name(target->kind), seen.reason);
    double worst = 0;
    for (size_t i = 0; i < seen.count; i++) {
        double xyz[3], p[2];
        td_target_point(xyz, target, i);
        view_of(p, d.a[0] * xyz[0] + d.a[2], d.a[4] * xyz[1] + d.a[5]);
        const double off = hypot(seen.point[2 * i] - p[0], seen.point[2 * i + 1] - p[1]);
        if (!(off <= worst)) worst = off;
    }
    printf("%s: worst of %zu points off by %.3f px\n", td_target_kind_name(target->kind), seen.count, worst);
    /* Of a mark the centre of gravity is found, which perspective moves by 0.1 px here. */
    check_less(worst, target->kind == TD_TARGET_MARKS ? 0.15 : 0.05);
    td_detection_free(&seen);
    td_image_free(&view);
    td_image_free(&d.image);
}

static void what_is_drawn_is_found(void **state)
{
    (void)state;
    const td_target chessboard = target_of(TD_TARGET_CHESSBOARD, 7, 5, 0.018);
    const td_target marks = target_of(TD_TARGET_MARKS, 7, 5, 0.02);
    td_target light = marks;
    light.polarity = TD_MARK_LIGHT;
    td_target grid = target_of(TD_TARGET_APRILGRID, 5, 4, 0.028), kalibr = grid;
    kalibr.border = 2;
    td_target charuco = target_of(TD_TARGET_CHARUCO, 6, 5, 0.02), legacy = charuco;
    legacy.legacy = true;
    const td_target tags = two_tags();
    check_found(&chessboard);
    check_found(&marks);
    check_found(&light);
    check_found(&grid);
    check_found(&kalibr);
    check_found(&charuco);
    check_found(&legacy);
    check_found(&tags);
}

static void squares_of_a_chessboard_alternate_from_a_dark_one(void **state)
{
    (void)state;
    const td_target t = target_of(TD_TARGET_CHESSBOARD, 4, 3, 0.01);
    const td_target_drawing_options o = bare();
    drawing d = render(&t, 0, &o);
    for (int j = -1; j <= 4; j++)
        for (int i = -1; i <= 5; i++) {
            const bool inside = i >= 0 && i <= 4 && j >= 0 && j <= 3;
            const double edge = 0.0002;
            for (int k = 0; k < 4; k++) { /* near all four corners of the square: its size is right */
                const double x = (i - 1 + k % 2) * 0.01 + (k % 2 ? -edge : edge);
                const double y = (j - 1 + k / 2) * 0.01 + (k / 2 ? -edge : edge);
                if (x < -0.0145 || y < -0.0145 || x > 0.0445 || y > 0.0345) continue;
                check_ink(&d, x, y, inside && (i + j) % 2 == 0);
            }
        }
    td_image_free(&d.image);
}

/* The cells of the tag whose black square begins at (x, y). */
static void check_tag(const drawing *d, const td_target *t, int id, double x, double y, double size)
{
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    int side;
    td_error error;
    check_ok(td_tag_cells(cell, &side, t->dictionary, t->border, id, &error), error);
    for (int i = 0; i < side * side; i++)
        check_ink(d, x + (i % side + 0.5) * size / side, y + (i / side + 0.5) * size / side, !cell[i]);
}

static void tags_have_their_cells_and_places(void **state)
{
    (void)state;
    td_target_drawing_options o = bare();
    o.dots_per_inch = 508;
    td_target t = target_of(TD_TARGET_APRILGRID, 3, 2, 0.04);
    t.tag_size_m = 0.03;
    t.first_id = 10;
    for (t.border = 1; t.border <= 2; t.border++) {
        drawing d = render(&t, 0, &o);
        check_tag(&d, &t, 13, 0, 0, 0.03); /* numbered upward: the lower row begins */
        check_tag(&d, &t, 12, 0.08, 0.04, 0.03);
        check_ink(&d, -0.005, -0.005, t.border == 2); /* Kalibr's squares between the tags */
        check_ink(&d, 0.035, 0.035, t.border == 2);
        check_ink(&d, 0.035, 0.015, false);
        td_image_free(&d.image);
    }
    const td_target tags = two_tags();
    drawing d = render(&tags, 1, &o); /* seen from the second tag */
    check_tag(&d, &tags, 3, -0.02, -0.02, 0.04);
    check_tag(&d, &tags, 7, -0.105, -0.025, 0.05);
    td_image_free(&d.image);
}

/* OpenCV from 4.6 on: dark at the upper left, first marker beside it. Before, boards with an even number of
 * rows of squares began with the marker. */
static void markers_sit_where_opencv_puts_them(void **state)
{
    (void)state;
    td_target_drawing_options o = bare();
    o.dots_per_inch = 508;
    for (int rows = 4; rows <= 5; rows++)
        for (int legacy = 0; legacy < 2; legacy++) {
            td_target t = target_of(TD_TARGET_CHARUCO, 4, rows, 0.02);
            t.legacy = legacy;
            t.first_id = 2;
            const bool marker_first = legacy && rows == 5;
            drawing d = render(&t, 0, &o);
            check_tag(&d, &t, 2, marker_first ? -0.0175 : 0.0025, -0.0175, 0.015);
            check_tag(&d, &t, marker_first ? 5 : 4, marker_first ? 0.0025 : -0.0175, 0.0025, 0.015);
            check_ink(&d, -0.0190, -0.0190, !marker_first);
            td_image_free(&d.image);
        }
}

static void marks_are_round_and_placed(void **state)
{
    (void)state;
    td_target t = target_of(TD_TARGET_MARKS, 3, 2, 0.02);
    const td_target_drawing_options o = bare();
    for (int light = 0; light < 2; light++) {
        t.polarity = light ? TD_MARK_LIGHT : TD_MARK_DARK;
        drawing d = render(&t, 0, &o);
        for (int k = 0; k < 8; k++) {
            const double c = cos(k * 0.785398), s = sin(k * 0.785398);
            check_ink(&d, 0.04 + 0.00475 * c, 0.02 + 0.00475 * s, !light);
            check_ink(&d, 0.04 + 0.00525 * c, 0.02 + 0.00525 * s, light);
        }
        td_image_free(&d.image);
    }
}

/* Around the pattern no ink comes nearer than half a square, with rulers and text and on every page. */
static void white_stays_white(void **state)
{
    (void)state;
    const td_target t = target_of(TD_TARGET_CHESSBOARD, 9, 6, 0.023);
    td_target_drawing_options o = td_target_drawing_options_default();
    o.page_width_m = 0.297, o.page_height_m = 0.21;
    o.dots_per_inch = 127;
    drawing d = render(&t, 0, &o);
    assert_int_equal(d.image->width, 1485);
    assert_int_equal(d.image->height, 1050);
    const double x0 = -0.023 - 0.0115, x1 = 9 * 0.023 + 0.0115, y0 = x0, y1 = 6 * 0.023 + 0.0115;
    for (double x = x0 + 3e-4; x < x1 - 3e-4; x += 1e-4)
        for (double y = y0 + 3e-4; y < y1 - 3e-4; y += 1e-4)
            if (x < -0.0232 || x > 9 * 0.023 + 2e-4 || y < -0.0232 || y > 6 * 0.023 + 2e-4)
                check_ink(&d, x, y, false);
    /* The rulers are there, and as long as they say. */
    const double tick[][2] = {{-0.023, y1 + 0.002}, {-0.023 + 0.2, y1 + 0.002}, {x0 - 0.002, -0.023 + 0.15}};
    for (int i = 0; i < 3; i++)
        check_less(grey_at(&d, tick[i][0], tick[i][1]), 200); /* thinner than a pixel */
    td_image_free(&d.image);
}

static void a_printers_scale_is_taken_off(void **state)
{
    (void)state;
    const td_target t = target_of(TD_TARGET_CHESSBOARD, 4, 3, 0.01);
    td_target_drawing_options o = bare();
    o.printer_scale[0] = 1.02, o.printer_scale[1] = 0.98;
    drawing d = render(&t, 0, &o);
    check_near(d.a[0], 10000 / 1.02, 1e-9);
    check_near(d.a[4], 10000 / 0.98, 1e-9);
    for (int k = 0; k < 2; k++) check_ink(&d, 0.03 - 0.0002 + 0.0004 * k, 0.0052, k == 0);
    td_image_free(&d.image);
}

static void page_needed_is_what_fits(void **state)
{
    (void)state;
    const td_target t = target_of(TD_TARGET_CHESSBOARD, 9, 6, 0.025);
    td_target_drawing_options o = td_target_drawing_options_default();
    drawing d = {NULL, {0}};
    td_error error;
    double size[2];
    check_ok(td_target_page_needed(size, &t, 0, &o, &error), error);
    o.dots_per_inch = 20;
    o.page_width_m = size[0], o.page_height_m = size[1];
    d = render(&t, 0, &o);
    td_image_free(&d.image);
    o.page_height_m = size[1] - 0.001;
    check_fails(td_target_render(&d.image, d.a, &t, 0, &o, &error), TD_ERROR_ARGUMENT, error,
                "chessboard 9x6, 25 mm needs");
    assert_null(d.image);
}

static char *read_all(const char *path, size_t *size)
{
    char *bytes = NULL;
    td_error error;
    check_ok(td_file_read(&bytes, size, path, 1 << 26, &error), error);
    return bytes;
}

static void same_input_same_bytes(void **state)
{
    static const char *const name[] = {"a.svg", "a.pdf", "a.png"};
    const td_target t = target_of(TD_TARGET_CHARUCO, 4, 3, 0.02);
    td_error error;
    const char *folder = *state;
    for (int i = 0; i < 3; i++) {
        char *path = td_path_join(folder, name[i]), *first, *second;
        size_t size[2];
        check_ok(td_target_draw(path, &t, 0, NULL, &error), error);
        first = read_all(path, &size[0]);
        check_ok(td_target_draw(path, &t, 0, NULL, &error), error);
        second = read_all(path, &size[1]);
        assert_int_equal(size[0], size[1]);
        assert_memory_equal(first, second, size[0]);
        free(first), free(second), free(path);
    }
}

static void a_png_knows_its_scale(void **state)
{
    const td_target t = target_of(TD_TARGET_CHESSBOARD, 4, 3, 0.01);
    td_image *image = NULL;
    td_error error;
    size_t size;
    char *path = td_path_join(*state, "a.png");
    check_ok(td_target_draw(path, &t, 0, NULL, &error), error);
    char *bytes = read_all(path, &size);
    const unsigned char scale[] = {'p', 'H', 'Y', 's', 0, 0, 0x5c, 0x46, 0, 0, 0x5c, 0x46, 1}; /* 23622 / m */
    assert_memory_equal(bytes + 37, scale, sizeof scale);
    check_ok(td_image_read(&image, path, 1, &error), error); /* libpng checks the chunk's CRC */
    td_image_free(&image);
    free(bytes), free(path);
}

static void dataset_lines(void **state)
{
    (void)state;
    char line[1024];
    const td_target chessboard = target_of(TD_TARGET_CHESSBOARD, 9, 6, 0.025);
    assert_string_equal(td_target_dataset_line(line, sizeof line, &chessboard),
                        "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}");
    td_target grid = target_of(TD_TARGET_APRILGRID, 6, 6, 0.088 * 1.3);
    grid.tag_size_m = 0.088, grid.border = 2, grid.order = TD_TAGS_DOWNWARD;
    assert_string_equal(
        td_target_dataset_line(line, sizeof line, &grid),
        "target: {kind: aprilgrid, columns: 6, rows: 6, spacing_m: 0.1144, tag_size_m: 0.088, "
        "dictionary: tag36h11, border: 2, order: downward}");
    char small[20];
    td_target_dataset_line(small, sizeof small, &grid);
    assert_string_equal(small, "target: {kind: apri");
}

static void faults_are_named(void **state)
{
    (void)state;
    td_target t = target_of(TD_TARGET_CHESSBOARD, 9, 6, 0.025), bad = t;
    td_target_drawing_options o = td_target_drawing_options_default();
    td_image *image = NULL;
    double a[6];
    td_error error;
#define REFUSED(words)                                                                                       \
    check_fails(td_target_render(&image, a, &t, 0, &o, &error), TD_ERROR_ARGUMENT, error, words)
    o.margin_m = -0.01;
    REFUSED("margin_m");
    o = td_target_drawing_options_default(), o.printer_scale[1] = 2;
    REFUSED("printer_scale[1]");
    o = td_target_drawing_options_default(), o.dots_per_inch = 9000;
    REFUSED("dots_per_inch");
    o = td_target_drawing_options_default(), o.page_width_m = NAN;
    REFUSED("page_width_m");
    o = td_target_drawing_options_default(), o.page_width_m = 0.02, o.page_height_m = 0.02;
    REFUSED("too narrow");
    o = bare();
    check_fails(td_target_render(&image, a, &t, 1, &o, &error), TD_ERROR_ARGUMENT, error, "plane");
    bad.plane[0].columns = 1;
    check_fails(td_target_render(&image, a, &bad, 0, &o, &error), TD_ERROR_ARGUMENT, error, "columns");
    bad = target_of(TD_TARGET_CHARUCO, 14, 10, 0.02);
    check_fails(td_target_render(&image, a, &bad, 0, &o, &error), TD_ERROR_ARGUMENT, error, "aruco4x4_50");
    check_fails(td_target_draw("board.gif", &t, 0, &o, &error), TD_ERROR_ARGUMENT, error, ".svg");
    assert_null(image);
#undef REFUSED
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_drawn_is_found),
        cmocka_unit_test(squares_of_a_chessboard_alternate_from_a_dark_one),
        cmocka_unit_test(tags_have_their_cells_and_places),
        cmocka_unit_test(markers_sit_where_opencv_puts_them),
        cmocka_unit_test(marks_are_round_and_placed),
        cmocka_unit_test(white_stays_white),
        cmocka_unit_test(a_printers_scale_is_taken_off),
        cmocka_unit_test(page_needed_is_what_fits),
        cmocka_unit_test_setup_teardown(same_input_same_bytes, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(a_png_knows_its_scale, scratch_make, scratch_remove),
        cmocka_unit_test(dataset_lines),
        cmocka_unit_test(faults_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
