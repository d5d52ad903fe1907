/* Folders in other makers' layouts, made here file by file from their published descriptions: what is read
 * must be what was written, by hand-made figures (poses between two of the table, the second camera's place
 * from two T_BS); what is damaged is refused by the file's name. Blind to: folders whose makers did not keep
 * to their own description (tests/apps/test_real_folders.py reads real ones). */
#include "core/csv.h"
#include "core/dataset.h"
#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static td_error error;

static void put(const char *folder, const char *name, const char *text)
{
    char *path = td_path_join(folder, name), *parent = td_path_folder(path);
    check_ok(td_folder_make(parent, &error), error);
    check_ok(td_file_write(path, text, strlen(text), &error), error);
    free(parent);
    free(path);
}

static const char SENSOR[] =
    "%%YAML:1.0\n#Sensor\nsensor_type: camera\ncomment: x\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [0.0, -1.0, 0.0, %g,\n    1.0, 0.0, 0.0, 0.2,\n    0.0, 0.0, 1.0, 0.0,\n    0.0, 0.0, 0.0, "
    "1.0]\n"
    "rate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [50, 51, 31.5, 23.5]\n"
    "distortion_model: %s\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 0.00001]\n";

static void put_sensors(const char *folder, const char *prefix, const char *model)
{
    for (int c = 0; c < 2; c++) {
        char text[1000], name[100];
        snprintf(text, sizeof text, SENSOR, c ? 0.35 : 0.1, model);
        snprintf(name, sizeof name, "%scam%d/sensor.yaml", prefix, c);
        put(folder, name, text);
    }
}

static void put_euroc(const char *folder, const char *prefix)
{
    static const char *const images = "#timestamp [ns],filename\r\n1000000000000000000,a.png\r\n"
                                      "1000000000100000000,b.png\r\n1000000000200000000,c.png\r\n";
    char name[100];
    put_sensors(folder, prefix, "radial-tangential");
    for (int c = 0; c < 2; c++) {
        snprintf(name, sizeof name, "%scam%d/data.csv", prefix, c);
        put(folder, name, images);
        for (const char *i = "ac"; *i; i++) { /* b is listed, and not there */
            snprintf(name, sizeof name, "%scam%d/data/%c.png", prefix, c, *i);
            put(folder, name, "x");
        }
    }
}

static td_csv *table_of(const td_dataset *d)
{
    td_csv *csv;
    check_ok(td_csv_parse(&csv, d->table_text, strlen(d->table_text), d->table, &error), error);
    return csv;
}

static double cell(const td_csv *csv, size_t row, const char *column)
{
    double value;
    check_ok(td_csv_real(&value, csv, row, td_csv_column(csv, column), -1e12, 1e12, &error), error);
    return value;
}

static void test_euroc(void **state)
{
    const char *folder = *state;
    td_dataset *d;
    td_rig *rig;
    put_euroc(folder, "mav0/");
    put(folder, "truth.txt",
        "# timestamp(s) tx ty tz qx qy qz qw\n1000000000.150 1 2 3 0 0 0 1\n"
        "1000000000.250 3 2 3 0 0 0.479425538604203 0.8775825618903728\n");
    check_ok(td_dataset_read(&d, folder, &error), error);
    assert_int_equal(d->camera_count, 2);
    assert_int_equal(d->frame_count, 2); /* b's images are not there */
    assert_string_equal(d->frame[1].name, "1000000000200000000");
    check_near(d->frame[1].time_s, 1000000000.2, 1e-6);
    assert_non_null(strstr(d->frame[1].image[1], "mav0/cam1/data/c.png"));
    td_csv *csv = table_of(d);
    assert_string_equal(td_csv_cell(csv, 0, td_csv_column(csv, "x_m")), ""); /* 0.15 s from the first pose */
    check_near(cell(csv, 1, "x_m"), 2, 1e-5);
    check_near(cell(csv, 1, "qz"), sin(0.25), 1e-6); /* half of a turn by 1 rad */
    check_near(cell(csv, 1, "qw"), cos(0.25), 1e-6);
    td_csv_free(&csv);
    check_ok(td_rig_parse(&rig, d->rig_text, strlen(d->rig_text), d->rig, &error), error);
    assert_int_equal(rig->camera[0].camera.model, TD_CAMERA_BROWN5);
    check_near(rig->camera[1].camera.parameter[5], 0.07, 0);
    assert_true(rig->has_vehicle);
    check_near(rig->vehicle_from_rig.t[0], 0.1, 1e-15);
    /* Both cameras turned alike, the second 0.25 m along the body's x: along the cameras' -y. */
    check_near(rig->camera[1].camera_from_rig.t[0], 0, 1e-12);
    check_near(rig->camera[1].camera_from_rig.t[1], 0.25, 1e-12);
    td_rig_free(&rig);
    td_dataset_free(&d);
    /* The data set's own table of states goes first, in nanoseconds, the real part first. */
    put(folder, "mav0/state_groundtruth_estimate0/data.csv",
        "#timestamp, p_RS_R_x [m],…\n1000000000000000000,5,6,7,0,1,0,0,0,0,0,0,0,0,0,0,0\n");
    check_ok(td_dataset_read(&d, folder, &error), error);
    csv = table_of(d);
    check_near(cell(csv, 0, "y_m"), 6, 0);
    check_near(cell(csv, 0, "qx"), 1, 0);
    assert_string_equal(td_csv_cell(csv, 1, td_csv_column(csv, "qx")), "");
    td_csv_free(&csv);
    td_dataset_free(&d);
}

static void test_euroc_variants(void **state)
{
    const char *folder = *state;
    td_dataset *d;
    td_rig *rig;
    put_euroc(folder, ""); /* mav0 itself, no poses, a fisheye */
    put_sensors(folder, "", "equidistant");
    check_ok(td_dataset_read(&d, folder, &error), error);
    assert_null(strstr(d->table_text, "x_m"));
    check_ok(td_rig_parse(&rig, d->rig_text, strlen(d->rig_text), d->rig, &error), error);
    assert_int_equal(rig->camera[0].camera.model, TD_CAMERA_FISHEYE);
    td_rig_free(&rig);
    td_dataset_free(&d);
    put_sensors(folder, "", "fisheye624");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "cam0/sensor.yaml");
    put_sensors(folder, "", "none");
    put(folder, "cam0/data.csv", "#timestamp [ns],filename\n1e9,a.png\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "cam0/data.csv");
    put(folder, "cam0/data.csv", "#timestamp [ns],filename\n1000,../../a.png\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "cam0/data.csv");
    put(folder, "cam0/data.csv", "#timestamp [ns],filename\n1000,a.png\n");
    put(folder, "poses.txt", "# timestamp(s) tx ty tz qx qy qz qw\n1 2 3\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "poses.txt");
    put(folder, "poses.txt", "# timestamp(s) tx ty tz qx qy qz qw\n1 2 3 4 0.5 0 0 0.1\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "quaternion");
    assert_null(d);
}

static void test_middlebury(void **state)
{
    const char *folder = *state;
    static const char *const calib = "cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\n"
                                     "cam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]\n"
                                     "doffs=%s\nbaseline=193.001\nwidth=741\nheight=497\nndisp=70\n";
    td_dataset *d;
    td_rig *rig;
    char text[400];
    put(folder, "im0.png", "x");
    put(folder, "im1.png", "x");
    check_ok(td_dataset_read(&d, folder, &error), error);
    assert_null(d->rig);
    assert_null(d->rig_text);
    td_dataset_free(&d);
    snprintf(text, sizeof text, calib, "31.086");
    put(folder, "calib.txt", text);
    check_ok(td_dataset_read(&d, folder, &error), error);
    assert_int_equal(d->frame_count, 1);
    assert_non_null(strstr(d->frame[0].image[1], "im1.png"));
    check_ok(td_rig_parse(&rig, d->rig_text, strlen(d->rig_text), d->rig, &error), error);
    assert_int_equal(rig->camera[0].camera.width, 741);
    check_near(rig->camera[1].camera.parameter[2] - rig->camera[0].camera.parameter[2], 31.086, 1e-9);
    check_near(rig->camera[1].camera_from_rig.t[0], -0.193001, 1e-12);
    td_rig_free(&rig);
    td_dataset_free(&d);
    snprintf(text, sizeof text, calib, "30");
    put(folder, "calib.txt", text);
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "doffs");
    put(folder, "calib.txt", "cam0=[994.978 0 311.193; 0 994.978]\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "9 numbers");
    put(folder, "calib.txt", "baseline=1\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "cam0");
    /* A description of our own goes first. */
    put(folder, "dataset.yaml", "name: mine\n");
    check_fails(td_dataset_read(&d, folder, &error), TD_ERROR_FORMAT, error, "dataset.yaml");
}

/* Tags on a site in a dataset of ours. */
static void test_site_tags(void **state)
{
    (void)state;
    td_dataset *d;
    static const char csv[] = "left,right\na.png,b.png\n";
    static const char yaml[] =
        "name: s\nrig: rig.yaml\ncameras: [{name: left, model: pinhole}, {name: right, model: pinhole}]\n"
        "site_tags: {sigma_mm: 2, sigma_deg: 0.5, target: {kind: %s, tags: [{id: 3, size_m: 0.3}]}}\n";
    char text[500];
    snprintf(text, sizeof text, yaml, "tags");
    check_ok(td_dataset_parse(&d, text, strlen(text), csv, strlen(csv), "f", &error), error);
    assert_int_equal(d->site_tags.tag_count, 1);
    check_near(d->site_tags_sigma_m, 0.002, 1e-15);
    check_near(d->site_tags_sigma_rad, 0.5 * 3.141592653589793 / 180, 1e-15);
    td_dataset_free(&d);
    snprintf(text, sizeof text,
             "name: s\nrig: rig.yaml\ncameras: [{name: left, model: pinhole}]\nsite_tags: {target: "
             "{kind: chessboard, columns: 4, rows: 5, spacing_m: 0.1}}\n");
    check_fails(td_dataset_parse(&d, text, strlen(text), csv, strlen(csv), "f", &error), TD_ERROR_FORMAT,
                error, "site_tags.target");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_euroc, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_euroc_variants, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_middlebury, scratch_make, scratch_remove),
        cmocka_unit_test(test_site_tags),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
