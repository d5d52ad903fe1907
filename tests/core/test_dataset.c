/* Proves that a dataset is read as it is meant, from files and from memory, that paths and environment
 * variables come out right, and that each slip in either file is refused with a sentence that names file,
 * field or line. Reference: datasets written out by hand. Blind to the images: they are not opened here. */
#include <stdbool.h>

#include "core/dataset.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const char YAML[] = "name: opencv-stereo\n"
                           "about: >\n  Two cameras, one board.\n"
                           "root: ${TELEDIMOS_TEST_DATA}/set    # folder of images\n"
                           "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
                           "cameras:\n"
                           "  - {name: left, model: brown5}\n"
                           "  - {name: right, model: fisheye}\n"
                           "expect: {baseline_m: 0.083, tolerance_m: 0.002}\n";
static const char CSV[] = "frame,time_s,left,note,right,height_m\r\n"
                          "# the first pair\r\n"
                          "01,0.5,left01.jpg,sharp,right01.jpg,0\r\n"
                          "\"02, again\",,left02.jpg,,,-0.05\r\n"
                          "03,2,,,/data/right03.jpg,\r\n";

static td_status parse(td_dataset **dataset, const char *yaml, const char *csv, td_error *error)
{
    return td_dataset_parse(dataset, yaml, strlen(yaml), csv, strlen(csv), "here", error);
}

static int set_data(void **state)
{
    (void)state;
    return setenv("TELEDIMOS_TEST_DATA", "/some/data", 1) + unsetenv("TELEDIMOS_TEST_UNSET") +
           setenv("TELEDIMOS_TEST_EMPTY", "", 1);
}

static void check_content(const td_dataset *d, const char *folder)
{
    assert_string_equal(d->name, "opencv-stereo");
    assert_string_equal(d->folder, folder);
    assert_int_equal(d->target.plane[0].columns, 9);
    assert_int_equal(d->camera_count, 2);
    assert_string_equal(d->camera[0].name, "left");
    assert_string_equal(d->camera[1].name, "right");
    assert_int_equal(d->camera[0].model, TD_CAMERA_BROWN5);
    assert_int_equal(d->camera[1].model, TD_CAMERA_FISHEYE);
    assert_true(d->expected_baseline_m == 0.083 && d->expected_tolerance_m == 0.002);
    assert_null(d->corners);
    assert_int_equal(d->frame_count, 3);
    const td_dataset_frame *f = d->frame;
    assert_string_equal(f[0].name, "01");
    assert_string_equal(f[1].name, "02, again");
    assert_string_equal(f[2].name, "03");
    assert_true(f[0].time_s == 0.5 && isnan(f[1].time_s) && f[2].time_s == 2);
    assert_true(f[0].height_m == 0 && f[1].height_m == -0.05 && isnan(f[2].height_m));
    assert_string_equal(f[0].image[0], "/some/data/set/left01.jpg");
    assert_string_equal(f[0].image[1], "/some/data/set/right01.jpg");
    assert_string_equal(f[1].image[0], "/some/data/set/left02.jpg");
    assert_null(f[1].image[1]);
    assert_null(f[2].image[0]);
    assert_string_equal(f[2].image[1], "/data/right03.jpg");
}

static void test_content(void **state)
{
    (void)state;
    td_error error = {0};
    td_dataset *d = NULL;
    check_ok(parse(&d, YAML, CSV, &error), error);
    check_content(d, "here");
    td_dataset_free(&d);
    assert_null(d);
    td_dataset_free(NULL);
}

static void test_defaults(void **state)
{
    (void)state;
    td_error error = {0};
    td_dataset *d = NULL;
    check_ok(parse(&d,
                   "{name: a, target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}, cameras: "
                   "[{name: c, model: pinhole}]}",
                   "c\nx.png\ny.png\n", &error),
             error);
    assert_string_equal(d->frame[0].name, "1");
    assert_string_equal(d->frame[1].name, "2");
    assert_true(isnan(d->frame[1].time_s) && isnan(d->frame[1].height_m) && isnan(d->expected_baseline_m) &&
                isnan(d->expected_tolerance_m));
    assert_string_equal(d->frame[1].image[0], "here/y.png");
    td_dataset_free(&d);
}

static void test_paths(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const row[][2] = {
        {"images", "here/images/x.png"},
        {"/images/", "/images/x.png"},
        {"a/${TELEDIMOS_TEST_DATA}", "here/a//some/data/x.png"},
        {"${TELEDIMOS_TEST_DATA}${TELEDIMOS_TEST_DATA}-b", "/some/data/some/data-b/x.png"},
        {"$HOME", "here/$HOME/x.png"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char yaml[512];
        snprintf(yaml, sizeof yaml,
                 "{name: a, root: \"%s\", corners: \"%s\", target: {kind: chessboard, columns: 9, rows: 6, "
                 "spacing_m: 0.025}, cameras: [{name: c, model: pinhole}]}",
                 row[i][0], row[i][0]);
        td_dataset *d = NULL;
        check_ok(parse(&d, yaml, "c\nx.png\n", &error), error);
        assert_string_equal(d->frame[0].image[0], row[i][1]);
        assert_non_null(d->corners);
        assert_int_equal(strncmp(d->corners, row[i][1], strlen(d->corners)), 0);
        td_dataset_free(&d);
    }
}

/* The first `from` in a text replaced by `to`; to be freed. */
static char *replaced(const char *text, const char *from, const char *to)
{
    const char *at = strstr(text, from);
    if (!at) fail_msg("'%s' is not there", from);
    char *made = malloc(strlen(text) + strlen(to) + 1);
    sprintf(made, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    return made;
}

static void test_refused_descriptions(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const row[][3] = {
        {"name: opencv-stereo\n", "", "here/dataset.yaml: name: is missing"},
        {"name: opencv-stereo", "name: 12", "name: must be a text, but is the number 12; put it in quotes"},
        {"name: opencv-stereo", "name: \"a\\nb\"", "name: must be one line of 1 to 63 bytes"},
        {"name: opencv-stereo", "name: 0123456789012345678901234567890123456789012345678901234567890123x",
         "name: must be one line"},
        {"name: opencv-stereo", "nam: a", "unknown key 'nam'; did you mean 'name'?"},
        {"about: >\n  Two cameras, one board.\n", "about: [1]\n", "about: must be a text"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "root: ${TELEDIMOS_TEST_UNSET}/set",
         "here/dataset.yaml: root: the environment variable TELEDIMOS_TEST_UNSET is not set; set it"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "root: ${TELEDIMOS_TEST_EMPTY}/set",
         "TELEDIMOS_TEST_EMPTY is not set"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "root: \"${TELEDIMOS_TEST_DATA/set\"",
         "root: '${TELEDIMOS_TEST_DATA/set' is no ${NAME}"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "root: \"${}/set\"", "is no ${NAME}"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "root: ''", "root: is empty"},
        {"root: ${TELEDIMOS_TEST_DATA}/set", "corners: ${TELEDIMOS_TEST_UNSET}",
         "corners: the environment variable"},
        {"spacing_m: 0.025", "spacing_m: 25",
         "target: spacing_m: is 25.0 metres, but must lie between 0.0001 and 10.0; did you mean 0.025?"},
        {"target: {", "targets: {", "unknown key 'targets'; did you mean 'target'?"},
        {"name: left,", "name: \"le ft\",",
         "cameras[0].name: 'le ft' must be 1 to 63 letters, digits, - and _"},
        {"name: right,", "name: left,", "cameras[1].name: 'left' is given twice"},
        {"name: right,", "name: time_s,", "cameras[1].name: 'time_s' is the name of another column"},
        {"model: fisheye", "model: fisheye8",
         "cameras[1].model: is 'fisheye8', but must be one of pinhole, brown5, brown8, fisheye"},
        {", model: fisheye", "", "cameras[1].model: is missing"},
        {"model: fisheye", "model: fisheye, width: 640", "cameras[1]: unknown key 'width'"},
        {"baseline_m: 0.083", "baseline_m: 0",
         "expect.baseline_m: is 0, but must lie between 0.0001 and 1000.0"},
        {"tolerance_m: 0.002", "tolerance_m: 0", "expect.tolerance_m: must be more than 0"},
        {", tolerance_m: 0.002", "", "expect.tolerance_m: is missing"},
        {"name: right,", "name: rigth,",
         "here/frames.csv: no column for the camera 'rigth': the cameras of dataset.yaml are left, rigth; "
         "the columns are frame, time_s, left, note, right, height_m"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char *yaml = replaced(YAML, row[i][0], row[i][1]);
        td_dataset *d = NULL;
        check_fails(parse(&d, yaml, CSV, &error), TD_ERROR_FORMAT, error, row[i][2]);
        assert_int_equal(strncmp(error.message, "here/", 5), 0);
        assert_null(d);
        free(yaml);
    }
    char many[2048] =
        "name: a\ntarget: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\ncameras:\n";
    for (int i = 0; i < 17; i++) strcat(many, "  - {}\n");
    td_dataset *d = NULL;
    check_fails(parse(&d, many, CSV, &error), TD_ERROR_FORMAT, error,
                "cameras: must have 1 to 16 elements, but has 17");
    check_fails(parse(&d, "", CSV, &error), TD_ERROR_FORMAT, error, "here/dataset.yaml: is empty");
}

static void test_refused_frames(void **state)
{
    (void)state;
    td_error error = {0};
    const char *const row[][3] = {
        {",0.5,", ",soon,", "here/frames.csv:3: column time_s: must be a finite number, but is 'soon'"},
        {",0.5,", ",inf,", "here/frames.csv:3: column time_s: must be a finite number"},
        {",-0.05", ",-50000",
         "here/frames.csv:4: column height_m: is -50000, but must lie between -1000.0 and 1000.0"},
        {"03,", "01,", "here/frames.csv:5: column frame: '01' is already the name of line 3"},
        {"03,", ",", "here/frames.csv:5: column frame: a name of 1 to 63 bytes"},
        {"03,", "\"0\n3\",", "here/frames.csv:5: column frame: a name"},
        {"03,", "0123456789012345678901234567890123456789012345678901234567890123,", "column frame: a name"},
        {"03,2,,", "03,2,", "here/frames.csv:5: the row has 5 cells, but the header has 6"},
        {"note", "left", "here/frames.csv:1: the column 'left' is given twice"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char *csv = replaced(CSV, row[i][0], row[i][1]);
        td_dataset *d = NULL;
        check_fails(parse(&d, YAML, csv, &error), TD_ERROR_FORMAT, error, row[i][2]);
        assert_null(d);
        free(csv);
    }
    td_dataset *d = NULL;
    check_fails(parse(&d, YAML, "", &error), TD_ERROR_FORMAT, error, "here/frames.csv: is empty");
    check_fails(parse(&d, YAML, "left,right\n", &error), TD_ERROR_FORMAT, error,
                "here/frames.csv: has a header but no frames");
    check_fails(parse(&d, YAML, "left,right\na,\nb,\n", &error), TD_ERROR_FORMAT, error,
                "here/frames.csv: column right: has no image at all");
}

/* As many frames as are accepted, and one more. */
static void test_many_frames(void **state)
{
    (void)state;
    td_error error = {0};
    enum { MOST = 100000 };
    char *csv = malloc(16 * (MOST + 2)), *end = csv + sprintf(csv, "left,right\n");
    for (int i = 0; i < MOST; i++) end += sprintf(end, "l%d,r\n", i);
    td_dataset *d = NULL;
    check_ok(parse(&d, YAML, csv, &error), error);
    assert_int_equal(d->frame_count, MOST);
    assert_string_equal(d->frame[MOST - 1].name, "100000");
    assert_string_equal(d->frame[MOST - 1].image[0], "/some/data/set/l99999");
    td_dataset_free(&d);
    strcpy(end, "a,b\n");
    check_fails(parse(&d, YAML, csv, &error), TD_ERROR_FORMAT, error, "has 100001 frames; at most 100000");
    free(csv);
}

static void write_text(const char *folder, const char *name, const char *text)
{
    td_error error = {0};
    char *path = td_path_join(folder, name);
    check_ok(td_file_write(path, text, strlen(text), &error), error);
    free(path);
}

static void test_files(void **state)
{
    td_error error = {0};
    td_dataset *d = NULL;
    const char *folder = *state;
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_IO, error,
                "the folder has no dataset.yaml; a dataset is a folder with");
    assert_non_null(strstr(error.message, "target: {kind: chessboard"));
    assert_non_null(strstr(error.message, "teledimos calibrate --help"));
    write_text(folder, "dataset.yaml", YAML);
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_IO, error, "frames.csv");
    write_text(folder, "frames.csv", CSV);
    check_ok(td_dataset_read(&d, folder, &error), error);
    check_content(d, folder);
    td_dataset_free(&d);
    char *other = replaced(YAML, "name:", "frames: few.csv\nname:"),
         *path = td_path_join(folder, "other.yaml");
    write_text(folder, "other.yaml", other);
    write_text(folder, "few.csv", "left,right\na,b\n");
    check_ok(td_dataset_read(&d, path, &error), error);
    assert_int_equal(d->frame_count, 1);
    assert_string_equal(d->folder, folder);
    td_dataset_free(&d);
    check_fails(td_dataset_read(&d, "/no/such/dataset", &error), TD_ERROR_IO, error,
                "/no/such/dataset: there is no such folder or file; a dataset is");
    assert_null(d);
    free(other);
    free(path);
}

#define ARM "name: a\nrig: r.yaml\nrobot: {urdf: m.urdf, joints: q.csv, mount: cab"
#define POINTS "}\nsights: s.csv\npoints:\n  - {name: p, link: stick"

static void test_arm(void **state)
{
    (void)state;
    td_error error;
    td_dataset *d;
    check_ok(parse(&d,
                   ARM ", vehicle: base, tip: t, link: l, sigma_deg: {boom: 0.1}, sigma_mm: 2" POINTS
                       ", place_m: [0.1, null, 1], sigma_m: [0, 1, 0.01]}\n  - {name: q, link: base}\n",
                   "", &error),
             error);
    const td_dataset_arm *a = d->arm;
    assert_non_null(a);
    assert_null(d->robot.path);
    assert_int_equal(d->frame_count, 0);
    assert_string_equal(a->urdf, "here/m.urdf");
    assert_string_equal(a->joints, "here/q.csv");
    assert_string_equal(a->sights, "here/s.csv");
    assert_string_equal(a->mount, "cab");
    assert_string_equal(a->vehicle, "base");
    assert_string_equal(a->tip, "t");
    assert_string_equal(a->link, "l");
    check_near(a->angle.all, 0.05 / 57.29577951308232, 1e-15);
    assert_int_equal(a->angle.count, 1);
    assert_string_equal(a->angle.joint[0], "boom");
    check_near(a->angle.sigma[0], 0.1 / 57.29577951308232, 1e-15);
    check_near(a->slide.all, 0.002, 1e-15);
    assert_true(a->sigma_px == 0.5);
    assert_int_equal(a->point_count, 2);
    assert_true(a->point[0].place_m[0] == 0.1 && isnan(a->point[0].place_m[1]));
    assert_true(a->point[0].sigma_m[0] == 0 && isinf(a->point[0].sigma_m[1]) &&
                a->point[0].sigma_m[2] == 0.01);
    assert_true(isnan(a->point[1].place_m[2]) && isinf(a->point[1].sigma_m[2]));
    td_dataset_free(&d);

    check_ok(parse(&d,
                   ARM
                   "}\ncameras: [{name: l, model: brown5}]\nboards:\n  - {name: b, link: stick, target: "
                   "{kind: chessboard, columns: 9, rows: 6, spacing_m: 0.1}, link_from_target: {q: [1, 0, "
                   "0, 0], t_m: [1, 2, 3]}, sigma_mm: 2, sigma_deg: 0.1}\n",
                   "frame,l\n1,a.png\n", &error),
             error);
    const td_dataset_board *b = &d->arm->board[0];
    assert_int_equal(d->arm->board_count, 1);
    assert_true(b->placed && b->link_from_target.t[2] == 3 && b->target.plane[0].columns == 9);
    check_near(b->sigma_m, 0.002, 1e-15);
    check_near(b->sigma_rad, 0.1 / 57.29577951308232, 1e-15);
    td_dataset_free(&d);
}

static void test_refused_arms(void **state)
{
    (void)state;
    static const struct {
        const char *yaml, *words;
    } bad[] = {
        {"name: a\nsights: s.csv\n", "sights: belongs to an arm"},
        {"name: a\nrobot: {urdf: m.urdf}\n", "robot.joints"},
        {ARM ", poses: p.csv}\n", "robot: unknown key 'poses'"},
        {ARM ", sigma_deg: {boom: -1}}\n", "robot.sigma_deg.boom"},
        {ARM ", mount: ''}\n", "mount"},
        {ARM POINTS "}\n  - {name: p, link: stick}\n", "points[1].name: 'p' is given twice"},
        {ARM POINTS ", place_m: [1, 2]}\n", "points[0].place_m: must have 3 elements"},
        {ARM POINTS ", place_m: [1, 2, x]}\n", "points[0].place_m[2]"},
        {ARM POINTS ", place_m: [1, 2, 1e9]}\n", "points[0].place_m[2]"},
        {ARM POINTS ", sigma_m: -0.1}\n", "points[0].sigma_m"},
        {ARM POINTS ", where: 3}\n", "points[0]: unknown key 'where'"},
        {ARM "}\nboards: [{name: b, link: l, target: {kind: cube}}]\n", "boards[0].target.kind"},
        {ARM "}\nboards: [{name: b, link: l, target: {kind: chessboard, columns: 9, rows: 6, spacing_m: "
             "0.1}}]\n",
         "cameras"},
        {ARM "}\nsights: s.csv\nsigma_px: 0\n", "sigma_px"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_error error;
        td_dataset *d = NULL;
        check_fails(parse(&d, bad[i].yaml, "frame,l\n1,a.png\n", &error), TD_ERROR_FORMAT, error,
                    bad[i].words);
        assert_null(d);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_content),
        cmocka_unit_test(test_defaults),
        cmocka_unit_test(test_paths),
        cmocka_unit_test(test_refused_descriptions),
        cmocka_unit_test(test_refused_frames),
        cmocka_unit_test(test_many_frames),
        cmocka_unit_test(test_arm),
        cmocka_unit_test(test_refused_arms),
        cmocka_unit_test_setup_teardown(test_files, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, set_data, NULL);
}
