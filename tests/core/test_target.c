/* Proves where the points of a target lie, which targets are refused and how, and that the description of a
 * dataset is read as it is meant. References: points worked out by hand from the frame in core/target.h; for
 * planes, core/pose.h. Tolerance 1e-15 m: products of exact small numbers. Blind to whether a printed board
 * looks so: that is the detector's business. */
#include <stdbool.h>

#include "core/target_internal.h"
#include "tests/check.h"

static td_target chessboard(int columns, int rows, double spacing)
{
    td_target t = {.kind = TD_TARGET_CHESSBOARD, .plane_count = 1, .polarity = TD_MARK_ANY};
    t.plane[0] = (td_target_plane){columns, rows, spacing, td_pose_identity()};
    return t;
}

/* Two walls of a corner: 3x2 on the floor, 2x2 standing up at x = 1. */
static td_target corner(void)
{
    td_target t = {.kind = TD_TARGET_MARKS, .plane_count = 2, .diameter_m = 0.05, .polarity = TD_MARK_DARK};
    t.plane[0] = (td_target_plane){3, 2, 0.1, td_pose_identity()};
    t.plane[1] = (td_target_plane){2, 2, 0.2, {{0, 0, 1, 0}, {1, 0, 0}}};
    const double up[3] = {0, -acos(0), 0}; /* x of the plane becomes z of the target */
    td_rotation_exp(t.plane[1].target_from_plane.q, up);
    return t;
}

static td_target aprilgrid(int columns, int rows)
{
    td_target t = {.kind = TD_TARGET_APRILGRID, .plane_count = 1, .polarity = TD_MARK_ANY};
    t.plane[0] = (td_target_plane){columns, rows, 0.5, td_pose_identity()};
    strcpy(t.dictionary, "tag36h11");
    t.border = 2;
    t.tag_size_m = 0.375;
    return t;
}

/* One tag on the floor, one standing up at x = 1. */
static td_target two_tags(void)
{
    td_target t = {.kind = TD_TARGET_TAGS, .polarity = TD_MARK_ANY, .border = 1, .tag_count = 2};
    strcpy(t.dictionary, "tag25h9");
    t.tag[0] = (td_target_tag){7, 0.5, td_pose_identity()};
    t.tag[1] = (td_target_tag){3, 0.25, {{0, 0, 0, 0}, {1, 0, 0}}};
    const double up[3] = {0, -acos(0), 0};
    td_rotation_exp(t.tag[1].target_from_tag.q, up);
    return t;
}

static void test_points(void **state)
{
    (void)state;
    td_target t = chessboard(9, 6, 0.025);
    double p[3];
    size_t first = 99;
    assert_int_equal(td_target_point_count(&t), 54);
    td_target_point(p, &t, 0);
    assert_true(p[0] == 0 && p[1] == 0 && p[2] == 0);
    td_target_point(p, &t, 8);
    check_near(p[0], 0.2, 1e-15);
    check_near(p[1], 0, 0);
    td_target_point(p, &t, 9); /* second row */
    check_near(p[0], 0, 0);
    check_near(p[1], 0.025, 1e-15);
    td_target_point(p, &t, 53);
    check_near(p[0], 0.2, 1e-15);
    check_near(p[1], 0.125, 1e-15);
    td_target_point(p, &t, 54);
    assert_true(isnan(p[0]) && isnan(p[1]) && isnan(p[2]));
    assert_int_equal(td_target_plane_of(&t, 53, &first), 0);
    assert_int_equal(first, 0);
    assert_int_equal(td_target_plane_of(&t, 54, NULL), -1);
}

static void test_points_on_two_planes(void **state)
{
    (void)state;
    td_target t = corner();
    double p[3];
    size_t first = 99;
    assert_int_equal(td_target_point_count(&t), 10);
    assert_int_equal(td_target_plane_of(&t, 5, &first), 0);
    assert_int_equal(first, 0);
    assert_int_equal(td_target_plane_of(&t, 6, &first), 1);
    assert_int_equal(first, 6);
    td_target_point(p, &t, 7); /* one step along the standing plane's columns */
    check_near(p[0], 1, 1e-15);
    check_near(p[1], 0, 1e-15);
    check_near(p[2], 0.2, 1e-15);
    td_target_point(p, &t, 8); /* and one along its rows */
    check_near(p[1], 0.2, 1e-15);
    check_near(p[2], 0, 1e-15);
}

static void check_point(const td_target *t, size_t index, double x, double y, double z)
{
    double p[3], xy[2];
    td_target_point(p, t, index);
    check_near(p[0], x, 1e-15);
    check_near(p[1], y, 1e-15);
    check_near(p[2], z, 1e-15);
    const double on_plane[3] = {(td_target_point_on_plane(xy, t, index), xy[0]), xy[1], 0};
    const td_pose pose = td_target_plane_pose(t, td_target_plane_of(t, index, NULL));
    double again[3];
    td_pose_transform(again, &pose, on_plane);
    for (int i = 0; i < 3; i++) check_near(again[i], p[i], 1e-15);
}

static void test_points_of_tags(void **state)
{
    (void)state;
    td_target t = aprilgrid(3, 2);
    size_t first = 99;
    double p[3], xy[2];
    assert_int_equal(td_target_point_count(&t), 24);
    check_point(&t, 0, 0, 0, 0);
    check_point(&t, 1, 0.375, 0, 0); /* clockwise */
    check_point(&t, 2, 0.375, 0.375, 0);
    check_point(&t, 3, 0, 0.375, 0);
    check_point(&t, 4, 0.5, 0, 0);        /* the next tag of the row */
    check_point(&t, 12, 0, 0.5, 0);       /* the next row */
    check_point(&t, 22, 1.375, 0.875, 0); /* the very last corner */
    td_target_point(p, &t, 24);
    td_target_point_on_plane(xy, &t, 24);
    assert_true(isnan(p[0]) && isnan(xy[0]));
    assert_int_equal(td_target_plane_of(&t, 23, &first), 0);
    assert_int_equal(first, 0);
    assert_int_equal(td_target_plane_of(&t, 24, NULL), -1);
    /* Kalibr's numbers begin at the lower left. */
    assert_int_equal(td_target_tag_count(&t), 6);
    assert_int_equal(td_target_tag_id(&t, 12), 0);
    assert_int_equal(td_target_tag_id(&t, 23), 2);
    assert_int_equal(td_target_tag_id(&t, 3), 3);
    assert_int_equal(td_target_tag_id(&t, 24), -1);
    t.order = TD_TAGS_DOWNWARD;
    t.first_id = 10;
    assert_int_equal(td_target_tag_id(&t, 0), 10);
    assert_int_equal(td_target_tag_id(&t, 23), 15);

    t = two_tags();
    assert_int_equal(td_target_point_count(&t), 8);
    check_point(&t, 0, -0.25, -0.25, 0);
    check_point(&t, 2, 0.25, 0.25, 0);
    check_point(&t, 5, 1, -0.125, 0.125); /* x of the tag is z of the target */
    check_point(&t, 7, 1, 0.125, -0.125);
    assert_int_equal(td_target_plane_of(&t, 6, &first), 1);
    assert_int_equal(first, 4);
    assert_int_equal(td_target_plane_of(&t, 8, NULL), -1);
    assert_int_equal(td_target_tag_id(&t, 4), 3);
    assert_int_equal(td_target_tag_count(&t), 2);

    t = aprilgrid(4, 3);
    t.kind = TD_TARGET_CHARUCO; /* 5x4 squares, half of them light; its points are the inner corners */
    assert_int_equal(td_target_point_count(&t), 12);
    assert_int_equal(td_target_tag_count(&t), 10);
    assert_int_equal(td_target_tag_id(&t, 0), -1);
    check_point(&t, 5, 0.5, 0.5, 0);
    t = chessboard(9, 6, 1);
    assert_int_equal(td_target_tag_count(&t), 0);
}

static void test_flatness(void **state)
{
    (void)state;
    td_target t = chessboard(9, 6, 0.025);
    assert_true(td_target_is_flat(&t));
    const double tilt[3] = {0.3, -1.1, 0.7};
    td_rotation_exp(t.plane[0].target_from_plane.q, tilt);
    t.plane[0].target_from_plane.t[2] = 5;
    assert_true(td_target_is_flat(&t));
    t = corner();
    assert_false(td_target_is_flat(&t));
    t.plane[1].target_from_plane = td_pose_identity();
    t.plane[1].target_from_plane.t[0] = 1;
    assert_true(td_target_is_flat(&t));
    t.plane[1].target_from_plane.t[2] = 1e-3; /* parallel, a millimetre higher */
    assert_false(td_target_is_flat(&t));
}

static void test_check(void **state)
{
    (void)state;
    td_error error = {0};
    td_target t = chessboard(3, 200, 1e-4);
    check_ok(td_target_check(&t, &error), error);
    t = chessboard(200, 3, 10);
    check_ok(td_target_check(&t, &error), error);
    t = corner();
    check_ok(td_target_check(&t, &error), error);

    t = chessboard(2, 6, 0.025);
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "columns: is 2, but must lie between 3 and 200");
    t = chessboard(9, 201, 0.025);
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "rows: is 201, but must lie between 3 and 200");
    t = chessboard(9, 6, 25);
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "spacing_m: is 25.0 metres, but must lie between 0.0001 and 10.0; did you mean 0.025?");
    t = chessboard(9, 6, 1e6);
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "spacing_m");
    assert_null(strstr(error.message, "did you mean"));
    const double wrong[] = {0, -1, 0.99e-4, NAN, INFINITY};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        t = chessboard(9, 6, wrong[i]);
        check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "spacing_m: is ");
        t = corner();
        t.diameter_m = i == 2 ? 0.1 : wrong[i]; /* the smaller spacing itself */
        check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                    "less than the spacing of the marks, 0.1");
        assert_null(strstr(error.message, "did you mean"));
    }
    t.diameter_m = 12;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "diameter_m: is 12.0 metres");
    assert_non_null(strstr(error.message, "did you mean 0.012?"));
    t = corner();
    t.plane[1].rows = 1;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "planes[1].rows: is 1, but must lie between 2 and 200");
    t = corner();
    t.plane[1].target_from_plane.q[0] += 1e-4;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "planes[1].target_from_plane.q");
    t = corner();
    t.plane[0].target_from_plane.t[1] = NAN;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "planes[0].target_from_plane.t_m");
    t = corner();
    t.polarity = (td_mark_polarity)9;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "polarity");
    t = corner();
    t.plane_count = 7;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "planes");
    t.plane_count = 0;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "planes");
    t.kind = TD_TARGET_KIND_COUNT;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "kind");
    t = chessboard(9, 6, 0.025);
    t.plane_count = 2;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "must have 1 to 1");
    t = chessboard(9, 6, 0.025);
    t.diameter_m = 0.01;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "a target of kind chessboard has none");
}

static void test_check_tags(void **state)
{
    (void)state;
    td_error error = {0};
    td_target t = aprilgrid(2, 200);
    check_ok(td_target_check(&t, &error), error);
    t.kind = TD_TARGET_CHARUCO;
    check_ok(td_target_check(&t, &error), error);
    t = two_tags();
    check_ok(td_target_check(&t, &error), error);
    assert_false(td_target_is_flat(&t));
    t.tag[1].target_from_tag = td_pose_identity();
    t.tag[1].target_from_tag.t[1] = 1;
    assert_true(td_target_is_flat(&t));

    t = aprilgrid(6, 6);
    t.tag_size_m = 0.5;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "tag_size_m: is 0.5 metres, but must be less than spacing_m, the distance between the same "
                "corners of two tags, 0.5 metres");
    t.kind = TD_TARGET_CHARUCO;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "tag_size_m: is 0.5 metres, but must be less than spacing_m, the side of the squares");
    t.tag_size_m = NAN;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "tag_size_m: is ");
    t = aprilgrid(1, 6);
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "columns: is 1, but must lie between 2 and 200");
    t = aprilgrid(6, 6);
    t.border = 3;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "border: is 3 cells, but must be 1 (libapriltag's tags) or 2 (Kalibr's)");
    t = aprilgrid(6, 6);
    t.dictionary[0] = 0;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "dictionary: must be a name");
    memset(t.dictionary, 'a', sizeof t.dictionary); /* no end */
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "dictionary: must be a name");
    t = aprilgrid(6, 6);
    t.first_id = -1;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "first_id: is -1");
    t = aprilgrid(6, 6);
    t.plane_count = 2;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "must have 1 to 1");
    t = aprilgrid(6, 6);
    t.diameter_m = 1;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "kind aprilgrid has none");

    t = two_tags();
    t.tag[1].id = 7;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error,
                "tags[1].id: is 7, as that of tags[0]");
    t.tag[1].id = -2;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "tags[1].id: is -2");
    t = two_tags();
    t.tag[0].size_m = 40;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "tags[0].size_m: is 40.0 metres");
    assert_non_null(strstr(error.message, "did you mean 0.04?"));
    t = two_tags();
    t.tag[1].target_from_tag.q[0] += 0.01;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "tags[1].target_from_tag.q");
    t = two_tags();
    t.tag_count = 0;
    check_fails(td_target_check(&t, &error), TD_ERROR_ARGUMENT, error, "must have 1 to 64");
}

static void test_describe(void **state)
{
    (void)state;
    char text[128], small[8];
    td_target t = chessboard(9, 6, 0.025);
    assert_string_equal(td_target_describe(text, sizeof text, &t), "chessboard 9x6, 25 mm");
    assert_string_equal(td_target_describe(small, sizeof small, &t), "chessbo");
    t.plane[0].spacing_m = 0.0254;
    assert_string_equal(td_target_describe(text, sizeof text, &t), "chessboard 9x6, 25.4 mm");
    t = corner();
    assert_string_equal(td_target_describe(text, sizeof text, &t),
                        "marks on 2 planes: 3x2, 100 mm; 2x2, 200 mm; diameter 50 mm");
    t.plane_count = 1;
    assert_string_equal(td_target_describe(text, sizeof text, &t), "marks 3x2, 100 mm, diameter 50 mm");
    t = aprilgrid(6, 7);
    assert_string_equal(td_target_describe(text, sizeof text, &t),
                        "aprilgrid 6x7, 500 mm, tag36h11 of 375 mm, border of 2");
    t.kind = TD_TARGET_CHARUCO;
    assert_string_equal(td_target_describe(text, sizeof text, &t), "charuco 6x7, 500 mm, tag36h11 of 375 mm");
    t = two_tags();
    assert_string_equal(td_target_describe(text, sizeof text, &t), "2 tags of tag25h9, 250 mm to 500 mm");
    t.tag_count = 1;
    t.border = 2;
    assert_string_equal(td_target_describe(text, sizeof text, &t), "tag 7 of tag25h9, 500 mm, border of 2");
    assert_string_equal(td_target_kind_name(TD_TARGET_MARKS), "marks");
    assert_null(td_target_kind_name(TD_TARGET_KIND_COUNT));
}

static td_status parse(td_target *target, const char *text, td_error *error)
{
    json_t *root = NULL;
    td_status status = td_document_parse(&root, text, strlen(text), "d.yaml", error);
    if (status != TD_OK) return status;
    td_field file = {NULL, "d.yaml", root}, field = td_field_get(&file, "target");
    status = td_target_parse(target, &field, error);
    json_decref(root);
    return status;
}

static void test_parse(void **state)
{
    (void)state;
    td_error error = {0};
    td_target t, expected = chessboard(9, 6, 0.025);
    memset(&t, 0xAA, sizeof t);
    check_ok(parse(&t, "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}", &error), error);
    assert_int_equal(t.kind, TD_TARGET_CHESSBOARD);
    assert_int_equal(t.plane_count, 1);
    assert_memory_equal(t.plane, expected.plane, sizeof t.plane);
    assert_true(t.diameter_m == 0);
    check_ok(
        parse(
            &t,
            "target: {kind: marks, columns: 7, rows: 5, spacing_m: 0.03, diameter_m: 0.012, polarity: light}",
            &error),
        error);
    assert_int_equal(t.kind, TD_TARGET_MARKS);
    assert_int_equal(t.polarity, TD_MARK_LIGHT);
    assert_true(t.diameter_m == 0.012 && t.plane[0].columns == 7 && t.plane[0].rows == 5 &&
                t.plane[0].target_from_plane.q[0] == 1);
    check_ok(parse(&t,
                   "target:\n  kind: marks\n  diameter_m: 0.01\n  planes:\n"
                   "    - {columns: 3, rows: 2, spacing_m: 1, target_from_plane: {q: [1, 0, 0, 0], t_m: [0, "
                   "0, 0]}}\n"
                   "    - {columns: 2, rows: 4, spacing_m: 0.5, target_from_plane: {q: [0, 0, 1, 0], t_m: "
                   "[1, 2, 3]}}\n",
                   &error),
             error);
    assert_int_equal(t.plane_count, 2);
    assert_int_equal(t.polarity, TD_MARK_ANY);
    assert_true(t.plane[1].rows == 4 && t.plane[1].spacing_m == 0.5 &&
                t.plane[1].target_from_plane.q[2] == 1 && t.plane[1].target_from_plane.t[2] == 3);
}

static void test_parse_tags(void **state)
{
    (void)state;
    td_error error = {0};
    td_target t;
    check_ok(parse(&t, "target: {kind: aprilgrid, columns: 6, rows: 5, tag_size_m: 0.088, gap_ratio: 0.3}",
                   &error),
             error);
    assert_true(t.kind == TD_TARGET_APRILGRID && t.plane_count == 1 && t.plane[0].columns == 6 &&
                t.plane[0].rows == 5 && t.border == 2 && t.first_id == 0 && t.order == TD_TAGS_UPWARD);
    assert_string_equal(t.dictionary, "tag36h11");
    check_near(t.plane[0].spacing_m, 0.1144, 1e-16);
    assert_true(t.plane[0].target_from_plane.q[0] == 1);
    check_ok(parse(&t,
                   "target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, spacing_m: 0.11, "
                   "dictionary: tag25h9, border: 1, first_id: 4, order: downward}",
                   &error),
             error);
    assert_true(t.plane[0].spacing_m == 0.11 && t.border == 1 && t.first_id == 4 &&
                t.order == TD_TAGS_DOWNWARD && t.tag_size_m == 0.088);
    assert_string_equal(t.dictionary, "tag25h9");
    check_ok(parse(&t,
                   "target: {kind: charuco, columns: 8, rows: 5, spacing_m: 0.04, tag_size_m: 0.03, "
                   "dictionary: aruco5x5_100, first_id: 2, legacy: true}",
                   &error),
             error);
    assert_true(t.kind == TD_TARGET_CHARUCO && t.border == 1 && t.first_id == 2 && t.legacy &&
                t.plane[0].spacing_m == 0.04 && t.tag_size_m == 0.03);
    check_ok(parse(&t, "target: {kind: tags, tags: [{id: 3, size_m: 0.1}]}", &error), error);
    assert_true(t.kind == TD_TARGET_TAGS && t.border == 1 && t.tag_count == 1 && t.tag[0].id == 3 &&
                t.tag[0].size_m == 0.1 && t.tag[0].target_from_tag.q[0] == 1);
    check_ok(parse(&t,
                   "target:\n  kind: tags\n  border: 2\n  tags:\n"
                   "    - {id: 3, size_m: 0.1, target_from_tag: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}}\n"
                   "    - {id: 9, size_m: 0.2, target_from_tag: {q: [0, 0, 1, 0], t_m: [1, 2, 3]}}\n",
                   &error),
             error);
    assert_true(t.tag_count == 2 && t.border == 2 && t.tag[1].id == 9 && t.tag[1].target_from_tag.q[2] == 1 &&
                t.tag[1].target_from_tag.t[2] == 3);
}

static void test_parse_refuses(void **state)
{
    (void)state;
    td_error error = {0};
    td_target t, untouched;
    memset(&t, 0xAA, sizeof t);
    untouched = t;
    const char *const row[][2] = {
        {"a: 1", "d.yaml: target: is missing"},
        {"target: 5", "target: must be a mapping, but is 5"},
        {"target: {columns: 9}", "target.kind: is missing"},
        {"target: {kind: checkerboard}",
         "target.kind: is 'checkerboard', but must be chessboard, marks, aprilgrid, tags or charuco"},
        {"target: {kind: chessboard, columns: 9, rows: 6}", "target.spacing_m: is missing"},
        {"target: {kind: chessboard, columns: 9.5, rows: 6, spacing_m: 1}",
         "target.columns: must be a whole number"},
        {"target: {kind: chessboard, column: 9, rows: 6, spacing_m: 1}",
         "unknown key 'column'; did you mean 'columns'?"},
        {"target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 25}",
         "d.yaml: target: spacing_m: is 25.0 metres"},
        {"target: {kind: chessboard, columns: 9, rows: 6, spacing_m: .nan}",
         "target.spacing_m: must be a finite number"},
        {"target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 1, diameter_m: 1}",
         "unknown key 'diameter_m'"},
        {"target: {kind: marks, columns: 9, rows: 6, spacing_m: 1}", "target.diameter_m: is missing"},
        {"target: {kind: marks, columns: 9, rows: 6, spacing_m: 1, diameter_m: 0.1, polarity: black}",
         "target.polarity: is 'black', but must be dark, light or any"},
        {"target: {kind: marks, diameter_m: 0.1, columns: 9, planes: []}", "unknown key 'columns'"},
        {"target: {kind: marks, diameter_m: 0.1, planes: []}",
         "target.planes: must have 1 to 6 elements, but has 0"},
        {"target: {kind: marks, diameter_m: 0.1, planes: [1]}", "target.planes[0]: must be a mapping"},
        {"target: {kind: marks, diameter_m: 0.1, planes: [{columns: 3, rows: 3, spacing_m: 1}]}",
         "target.planes[0].target_from_plane: is missing"},
        {"target: {kind: marks, diameter_m: 0.1, planes: [{columns: 3, rows: 3, spacing_m: 1, "
         "target_from_plane: {q: [2, 0, 0, 0], t_m: [0, 0, 0]}}]}",
         "target.planes[0].target_from_plane.q: must be a unit quaternion"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088}", "target.spacing_m: is missing"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, gap_ratio: 0.3}", "target.tag_size_m: is missing"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0}",
         "target.gap_ratio: is 0, but must lie between 0.01 and 10"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0.3, spacing_m: 0.1}",
         "target.gap_ratio: must not be given beside spacing_m"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, spacing_m: 0.0264}",
         "target: tag_size_m: is 0.088 metres, but must be less than spacing_m"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0.3, order: down}",
         "target.order: is 'down', but must be upward or downward"},
        {"target: {kind: aprilgrid, columns: 6, rows: 6, tag_size_m: 0.088, gap_ratio: 0.3, tagCols: 6}",
         "unknown key 'tagCols'"},
        {"target: {kind: charuco, columns: 8, rows: 5, spacing_m: 0.04, tag_size_m: 0.03}",
         "target.dictionary: must name a dictionary, such as"},
        {"target: {kind: charuco, columns: 8, rows: 5, spacing_m: 0.04, tag_size_m: 0.03, dictionary: "
         "a-name-that-is-far-too-long}",
         "target.dictionary: must name a dictionary, such as"},
        {"target: {kind: charuco, columns: 8, rows: 5, spacing_m: 0.04, tag_size_m: 0.03, border: 1}",
         "unknown key 'border'"},
        {"target: {kind: tags, tags: []}", "target.tags: must have 1 to 64 elements, but has 0"},
        {"target: {kind: tags, tags: [{id: 1, size_m: 1}, {id: 2, size_m: 1}]}",
         "target.tags[0].target_from_tag: is missing"},
        {"target: {kind: tags, tags: [{id: 1, size: 1}]}", "unknown key 'size'; did you mean 'size_m'?"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        check_fails(parse(&t, row[i][0], &error), TD_ERROR_FORMAT, error, row[i][1]);
        assert_memory_equal(&t, &untouched, sizeof t);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_points),        cmocka_unit_test(test_points_on_two_planes),
        cmocka_unit_test(test_flatness),      cmocka_unit_test(test_check),
        cmocka_unit_test(test_describe),      cmocka_unit_test(test_parse),
        cmocka_unit_test(test_parse_refuses), cmocka_unit_test(test_points_of_tags),
        cmocka_unit_test(test_check_tags),    cmocka_unit_test(test_parse_tags),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
