/* Proves, for every format and camera model: what a format holds comes back bit for bit (parameters) and to
 * 1e-12 (poses, which pass through rotation matrices or vectors); what it does not hold is refused, and when
 * approximated stays within the error told; that poses have the direction each format gives them, by files
 * written out by hand with an asymmetric pose; that bad files get one sentence with file and field.
 * References: the rig itself; each format's own definition, computed here from matrices (ROS: K'[I|t] R;
 * Kalibr: the chain; OpenCV: right_from_left). The error told is checked at random rays: it is a maximum over
 * a grid, so 2 % are allowed. Blind to whether the other tools read the same: tests/apps/test_convert.py. */
#include <sys/stat.h>

#include "core/random.h"
#include "core/rig_formats.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const double POSE_TOLERANCE = 1e-12;

static td_camera make_camera(td_camera_model model, td_random *random)
{
    static const double brown5[] = {-0.28, 0.07, 0.0013, -0.0007, 0.011},
                        brown8[] = {0.31, 0.12, 0.0009, -0.0004, 0.006, 0.62, 0.21, 0.02},
                        fisheye[] = {-0.013, 0.021, -0.009, 0.0017};
    td_camera camera = {.model = model, .width = 752, .height = 480};
    const double *d = model == TD_CAMERA_BROWN5 ? brown5 : model == TD_CAMERA_BROWN8 ? brown8 : fisheye;
    for (int i = 0; i < td_camera_parameter_count(model); i++)
        camera.parameter[i] = (i < 4 ? (const double[]){458.654, 457.296, 367.215, 248.375}[i] : d[i - 4]) *
                              (1 + 0.01 * td_random_normal(random));
    return camera;
}

/* Cameras side by side (or one above the other), turned by some degrees: a pair that can be rectified. */
static td_rig *make_rig(int count, td_camera_model model, int axis, td_random *random)
{
    td_rig *rig = td_rig_new();
    rig->count = count;
    for (int i = 0; i < count; i++) {
        td_rig_camera *c = rig->camera + i;
        snprintf(c->name, sizeof c->name, "cam-%c", 'a' + i);
        c->camera = make_camera(model, random);
        double xi[6];
        for (int k = 0; k < 6; k++) xi[k] = 0.05 * td_random_normal(random);
        xi[3 + axis] -= 0.4 * i;
        c->camera_from_rig = i ? td_pose_exp(xi) : td_pose_identity();
    }
    return rig;
}

static double pose_apart(const td_pose *a, const td_pose *b)
{
    const td_pose b_inverse = td_pose_inverse(b), d = td_pose_compose(a, &b_inverse);
    return fmax(td_pose_angle(&d), td_pose_distance(&d));
}

/* Files of a rig in memory, read again. */
static td_status round_trip(td_rig **back, const td_rig *rig, td_rig_format format, bool approximate,
                            td_rig_export_report *report, td_error *error)
{
    td_rig_text file[TD_RIG_MAX_CAMERAS] = {{0}};
    char *text[TD_RIG_MAX_CAMERAS] = {NULL};
    const bool several = format == TD_RIG_ROS || format == TD_RIG_MRCAL;
    const int count = several ? rig->count : 1;
    td_status status = TD_OK;
    for (int i = 0; status == TD_OK && i < count; i++) {
        *report = (td_rig_export_report){0};
        status = td_rig_export_text(&text[i], rig, i, format, approximate, report, error);
        file[i] =
            (td_rig_text){several ? rig->camera[i].name : "file", text[i], text[i] ? strlen(text[i]) : 0};
        if (text[i]) assert_int_equal(td_rig_format_guess(text[i], file[i].size), format);
    }
    if (status == TD_OK) status = td_rig_import_text(back, file, (size_t)count, NULL, error);
    for (int i = 0; i < count; i++) free(text[i]);
    return status;
}

/* Which models a format holds (bits), and whether it holds the poses of so many cameras. */
static bool holds_model(td_rig_format format, td_camera_model model)
{
    static const unsigned held[TD_RIG_FORMAT_COUNT] = {0xF, 0xF, 0xF, 0x9, 0x9, 0x7};
    return held[format] >> model & 1u;
}

static bool holds_poses(td_rig_format format, int count)
{
    return count == 1 || (format == TD_RIG_ROS ? count == 2 : format != TD_RIG_VISP);
}

static void check_rig(const td_rig *a, const td_rig *b)
{
    assert_int_equal(a->count, b->count);
    for (int i = 0; i < a->count; i++) {
        const td_camera *x = &a->camera[i].camera, *y = &b->camera[i].camera;
        assert_string_equal(a->camera[i].name, b->camera[i].name);
        assert_true(x->model == y->model && x->width == y->width && x->height == y->height);
        assert_memory_equal(x->parameter, y->parameter, sizeof x->parameter);
        check_near(pose_apart(&a->camera[i].camera_from_rig, &b->camera[i].camera_from_rig), 0,
                   POSE_TOLERANCE);
    }
}

static void test_round_trips(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(7, 1);
    int exact = 0, refused = 0, poseless = 0;
    for (int f = 0; f < TD_RIG_FORMAT_COUNT; f++)
        for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
            for (int count = 1; count <= 5; count++)
                for (int axis = 0; axis < 2; axis++) {
                    const td_rig_format format = (td_rig_format)f;
                    td_rig *rig = make_rig(count, (td_camera_model)m, axis, &random), *back = NULL;
                    td_rig_export_report report;
                    const td_status status = round_trip(&back, rig, format, false, &report, &error);
                    if (!holds_model(format, (td_camera_model)m)) {
                        assert_int_equal(status, TD_ERROR_UNSUPPORTED);
                        refused++;
                    } else if (!holds_poses(format, count)) {
                        assert_int_equal(status, TD_ERROR_DATA);
                        assert_non_null(strstr(error.message, "poses of cam-a, cam-b"));
                        assert_non_null(strstr(report.remark, "poses of the cameras are not held"));
                        poseless++;
                    } else {
                        check_ok(status, error);
                        check_rig(rig, back);
                        assert_true(report.largest_error_px == 0);
                        exact++;
                    }
                    td_rig_free(&rig);
                    td_rig_free(&back);
                }
    print_message("          %d rigs came back, %d refused for their model, %d for want of poses\n", exact,
                  refused, poseless);
    assert_int_equal(exact + refused + poseless, 6 * 4 * 5 * 2);
    assert_true(exact > 100 && refused >= 50 && poseless > 20);
}

/* Models that a format holds in part: those parameters at 0 make them exact. */
static void test_parts_of_models_are_exact(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(8, 1);
    static const struct {
        td_rig_format format;
        td_camera_model model;
        int zero[5], count;
    } parts[] = {{TD_RIG_KALIBR, TD_CAMERA_BROWN5, {8}, 1},
                 {TD_RIG_VISP, TD_CAMERA_BROWN5, {5, 6, 7, 8}, 4},
                 {TD_RIG_MRCAL, TD_CAMERA_BROWN5, {8}, 1}};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
        td_rig *rig = make_rig(1, parts[i].model, 0, &random), *back = NULL;
        td_rig_export_report report;
        for (int k = 0; k < parts[i].count; k++) rig->camera[0].camera.parameter[parts[i].zero[k]] = 0;
        check_ok(round_trip(&back, rig, parts[i].format, false, &report, &error), error);
        check_rig(rig, back);
        td_rig_free(&rig);
        td_rig_free(&back);
    }
    /* A rational model whose denominator is 1 is a Brown model with k3 = 0 to Kalibr. */
    td_rig *rig = make_rig(1, TD_CAMERA_BROWN8, 0, &random), *back = NULL;
    td_rig_export_report report;
    for (int k = 8; k < 12; k++) rig->camera[0].camera.parameter[k] = 0;
    check_ok(round_trip(&back, rig, TD_RIG_KALIBR, false, &report, &error), error);
    rig->camera[0].camera.model = TD_CAMERA_BROWN5;
    check_rig(rig, back);
    td_rig_free(&rig);
    td_rig_free(&back);
}

/* The error of `b` against `a` over the image's corners and random pixels of it. */
static double error_of(const td_camera *a, const td_camera *b, td_random *random)
{
    double worst = 0;
    for (int i = 0; i < 20000; i++) {
        const double x = i < 4 ? i % 2 : td_random_uniform(random),
                     y = i < 4 ? i / 2 : td_random_uniform(random);
        const double pixel[2] = {a->width * x - 0.5, a->height * y - 0.5};
        double ray[3], seen[2];
        if (!td_camera_unproject(ray, NULL, NULL, a, pixel)) continue;
        assert_true(td_camera_project(seen, NULL, NULL, b, ray));
        worst = fmax(worst, hypot(seen[0] - pixel[0], seen[1] - pixel[1]));
    }
    return worst;
}

static void test_approximations_tell_their_error(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(9, 1);
    for (int f = 1; f < TD_RIG_FORMAT_COUNT; f++)
        for (int m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
            if (holds_model((td_rig_format)f, (td_camera_model)m)) continue;
            td_rig *rig = make_rig(1, (td_camera_model)m, 0, &random), *back = NULL;
            td_rig_export_report report;
            char told[32];
            check_fails(round_trip(&back, rig, (td_rig_format)f, false, &report, &error),
                        TD_ERROR_UNSUPPORTED, error, "camera cam-a: ");
            check_ok(round_trip(&back, rig, (td_rig_format)f, true, &report, &error), error);
            const double seen = error_of(&rig->camera[0].camera, &back->camera[0].camera, &random);
            print_message("          %-7s for %-10s as %-8s off by %.4f px, told %.4f\n",
                          td_camera_model_name((td_camera_model)m), td_rig_format_name((td_rig_format)f),
                          td_camera_model_name(back->camera[0].camera.model), seen, report.largest_error_px);
            assert_true(report.largest_error_px > 0);
            check_less(seen, 1.02 * report.largest_error_px);
            check_less(0.8 * report.largest_error_px, seen); /* a maximum, not a bound far above */
            snprintf(told, sizeof told, "%.3g px", report.largest_error_px);
            assert_non_null(strstr(report.remark, told));
            td_rig_free(&rig);
            td_rig_free(&back);
        }
}

/* No fit is nearer: moving any parameter by a thousandth of a pixel's worth does not make the sum less. */
static void test_fit_is_the_least(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(10, 1);
    td_rig *rig = make_rig(1, TD_CAMERA_FISHEYE, 0, &random), *back = NULL;
    td_rig_export_report report;
    check_ok(round_trip(&back, rig, TD_RIG_MRCAL, true, &report, &error), error);
    double sums[25];
    for (int k = 0; k < 25; k++) {
        td_camera camera = back->camera[0].camera;
        const int p = (k - 1) / 2;
        if (k) camera.parameter[p] += (k % 2 ? 1 : -1) * (p < 4 ? 0.01 : 1e-5);
        sums[k] = 0;
        for (int j = 0; j < 61; j++)
            for (int i = 0; i < 61; i++) {
                const double pixel[2] = {752. * i / 60 - 0.5, 480. * j / 60 - 0.5};
                double ray[3], seen[2];
                assert_true(td_camera_unproject(ray, NULL, NULL, &rig->camera[0].camera, pixel));
                assert_true(td_camera_project(seen, NULL, NULL, &camera, ray));
                sums[k] += pow(seen[0] - pixel[0], 2) + pow(seen[1] - pixel[1], 2);
            }
        if (k) check_less(sums[0], sums[k]);
    }
    td_rig_free(&rig);
    td_rig_free(&back);
}

/* ViSP's kdu is the one coefficient for the way back: r_d (1 + kdu r_d^2) nearest to r over the image's disc,
 * each ring by its circumference. Another kdu is worse. */
static void test_inverse_coefficient(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = td_rig_new();
    rig->count = 1;
    rig->camera[0] = (td_rig_camera){.name = "a", .camera_from_rig = td_pose_identity()};
    rig->camera[0].camera =
        (td_camera){TD_CAMERA_BROWN5, 640, 480, {600, 600, 319.5, 239.5, -0.15, 0, 0, 0, 0}};
    char *text = NULL;
    check_ok(td_rig_export_text(&text, rig, 0, TD_RIG_VISP, false, NULL, &error), error);
    const double kdu = strtod(strstr(text, "<kdu>") + 5, NULL), corner = hypot(320, 240) / 600;
    double sum[3] = {0};
    for (int k = 0; k < 3; k++)
        for (int i = 1; i <= 1000; i++) {
            double rd = corner * i / 1000, r = rd; /* r (1 + kud r^2) = rd by Newton's method */
            for (int n = 0; n < 20; n++) r -= (r * (1 - 0.15 * r * r) - rd) / (1 - 0.45 * r * r);
            sum[k] += rd * pow(rd + kdu * (1 + 0.02 * (k == 2) - 0.02 * (k == 1)) * rd * rd * rd - r, 2);
        }
    check_less(0.15, kdu);
    check_less(sum[0], sum[1]);
    check_less(sum[0], sum[2]);
    free(text);
    td_rig_free(&rig);
}

/* Beyond 90 degrees no perspective model follows. */
static void test_wide_fisheye_is_refused(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(11, 1);
    td_rig *rig = make_rig(1, TD_CAMERA_FISHEYE, 0, &random), *back = NULL;
    td_rig_export_report report;
    rig->camera[0].camera.parameter[0] = rig->camera[0].camera.parameter[1] = 180;
    for (int i = 4; i < 8; i++) rig->camera[0].camera.parameter[i] = 0;
    check_fails(round_trip(&back, rig, TD_RIG_MRCAL, true, &report, &error), TD_ERROR_UNSUPPORTED, error,
                "not even nearly");
    td_rig_free(&rig);
}

/* ---- directions ---- */

/* A turn by 90 degrees about z, then a shift: x of the first is y of the second. Written by hand. */
static const td_pose ASYMMETRIC = {{0.70710678118654757, 0, 0, 0.70710678118654757}, {-0.5, 0.25, 0.125}};

static td_rig *read_all(const char *const *text, size_t count, const td_rig_import_options *options)
{
    static const char *const names[] = {"one.x", "two.x", "three.x"};
    td_error error = {0};
    td_rig_text file[3];
    td_rig *rig = NULL;
    for (size_t i = 0; i < count; i++) file[i] = (td_rig_text){names[i], text[i], strlen(text[i])};
    check_ok(td_rig_import_text(&rig, file, count, options, &error), error);
    return rig;
}

static void check_second(td_rig *rig, double tolerance)
{
    assert_int_equal(rig->count, 2);
    check_near(pose_apart(&rig->camera[1].camera_from_rig, &ASYMMETRIC), 0, tolerance);
    td_rig_free(&rig);
}

#define MATRIX(name, rows, cols, data)                                                                       \
    name ": !!opencv-matrix\n   rows: " rows "\n   cols: " cols "\n   dt: d\n   data: [ " data " ]\n"
#define K33 "500., 0., 320., 0., 501., 240., 0., 0., 1."

static void test_directions(void **state)
{
    (void)state;
    const td_rig_import_options size = {.format = TD_RIG_FORMAT_COUNT, .width = 640, .height = 480};
    const char *intrinsics =
        "%YAML:1.0\n" MATRIX("M1", "3", "3", K33) MATRIX("D1", "1", "5", "0.1, 0., 0., 0., 0.")
            MATRIX("M2", "3", "3", K33) MATRIX("D2", "1", "4", "0.1, 0.2, 0., 0.");
    const char *extrinsics = "%YAML:1.0\n---\n" MATRIX("R", "3", "3", "0., -1., 0., 1., 0., 0., 0., 0., 1.")
        MATRIX("T", "3", "1", "-0.5, 0.25,\n       0.125");
    td_rig *rig = read_all((const char *[]){intrinsics, extrinsics}, 2, &size);
    assert_string_equal(rig->camera[1].name, "right");
    check_near(rig->camera[1].camera.parameter[5], 0.2, 0);
    check_second(rig, 1e-15);
    const char *vector = "%YAML:1.0\n---\n" MATRIX("R", "3", "1", "0., 0., 1.5707963267948966")
        MATRIX("T", "3", "1", "-500., 250., 125.");
    td_rig_import_options millimetres = size;
    millimetres.unit_m = 1e-3;
    check_second(read_all((const char *[]){intrinsics, vector}, 2, &millimetres), 1e-15);
    const char *kalibr =
        "cam0:\n  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n"
        "  intrinsics: [500, 501, 320, 240]\n  resolution: [640, 480]\ncam1:\n"
        "  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0.1, 0, 0, 0]\n"
        "  intrinsics: [500, 501, 320, 240]\n  resolution: [640, 480]\n  T_cn_cnm1:\n"
        "  - [0, -1, 0, -0.5]\n  - [1, 0, 0, 0.25]\n  - [0, 0, 1, 0.125]\n  - [0, 0, 0, 1.0]\n";
    rig = read_all(&kalibr, 1, NULL);
    assert_string_equal(rig->camera[1].name, "cam1");
    check_second(rig, 1e-15);
    const char *mrcal[] = {
        "{'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': [500,501,320,240,],\n"
        "'extrinsics': [0,0,0,0,0,0], 'imagersize': [640,480]}",
        "# c\n{'lensmodel': 'LENSMODEL_OPENCV4', 'intrinsics': [500,501,320,240,0.1,0,0,0],\n"
        "'extrinsics': [0,0,1.5707963267948966,-0.5,0.25,0.125], 'imagersize': (640,480,),\n"
        "'optimization_inputs': b'~{}#\\''}"};
    rig = read_all(mrcal, 2, NULL);
    assert_string_equal(rig->camera[0].name, "one");
    check_second(rig, 1e-15);
}

/* ROS: a point of the rig's frame goes through R and P of each camera to where rows are equal. */
static void test_ros_rectification(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(12, 1);
    for (int axis = 0; axis < 2; axis++) {
        td_rig *rig = make_rig(2, TD_CAMERA_BROWN5, axis, &random);
        double r[2][9], p[2][12];
        for (int c = 0; c < 2; c++) {
            char *text = NULL;
            check_ok(td_rig_export_text(&text, rig, c, TD_RIG_ROS, false, NULL, &error), error);
            const char *at = strstr(strstr(text, "rectification_matrix"), "data: [") + 7;
            for (int i = 0; i < 9; i++) r[c][i] = strtod(at, (char **)&at), at++;
            at = strstr(at, "data: [") + 7;
            for (int i = 0; i < 12; i++) p[c][i] = strtod(at, (char **)&at), at++;
            free(text);
        }
        check_less(p[1][axis ? 7 : 3], 0); /* the second lies at +x (+y): Tx = -f B */
        assert_true(p[0][3] == 0 && p[0][7] == 0 && p[1][axis ? 3 : 7] == 0);
        for (int n = 0; n < 100; n++) {
            const double x[3] = {td_random_normal(&random), td_random_normal(&random),
                                 4 + td_random_uniform(&random)};
            double seen[2][2], from_first[3], rectified[2][3], in_camera[3];
            for (int c = 0; c < 2; c++) {
                td_pose_transform(in_camera, &rig->camera[c].camera_from_rig, x);
                for (int i = 0; i < 3; i++)
                    rectified[c][i] = r[c][3 * i] * in_camera[0] + r[c][3 * i + 1] * in_camera[1] +
                                      r[c][3 * i + 2] * in_camera[2];
                /* P_c projects points of the first rectified frame; K' alone those of its own. */
                for (int i = 0; i < 3; i++)
                    from_first[i] = p[c][4 * i] * rectified[0][0] + p[c][4 * i + 1] * rectified[0][1] +
                                    p[c][4 * i + 2] * rectified[0][2] + p[c][4 * i + 3];
                for (int i = 0; i < 2; i++) {
                    seen[c][i] = p[c][5 * i] * rectified[c][i] / rectified[c][2] + p[c][4 * i + 2];
                    check_near(from_first[i] / from_first[2], seen[c][i], 1e-9);
                }
            }
            check_near(seen[0][1 - axis], seen[1][1 - axis], 1e-9);
            check_less(seen[1][axis], seen[0][axis]); /* disparity is positive */
        }
        td_rig_free(&rig);
    }
}

/* ---- what else is said ---- */

static void test_losses_are_told(void **state)
{
    (void)state;
    td_error error = {0};
    td_random random = td_random_seed(13, 1);
    td_rig *rig = make_rig(1, TD_CAMERA_PINHOLE, 0, &random);
    td_rig_export_report report = {0};
    rig->covariance = calloc(100, sizeof(double));
    rig->has_vehicle = true;
    rig->vehicle_from_rig = td_pose_identity();
    char *text = NULL;
    check_ok(td_rig_export_text(&text, rig, 0, TD_RIG_KALIBR, false, &report, &error), error);
    assert_string_equal(report.remark, "the covariance and vehicle_from_rig are not held by the format.");
    free(text);
    td_rig_free(&rig);
}

static void test_names_sizes_and_choice(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = NULL;
    const char *visp =
        "<root><camera><name>Camera 1</name><image_width>640</image_width><image_height>480"
        "</image_height><model><type>perspectiveProjWithoutDistortion</type><px>500</px><py>501</py>"
        "<u0>320</u0><v0>240</v0></model><model><type>perspectiveProjWithDistortion</type><px>510</px>"
        "<py>511</py><u0>321</u0><v0>241</v0><kud>-0.2</kud><kdu>0.21</kdu></model></camera>"
        "<camera><name>Camera 1</name><image_width>320</image_width><image_height>240</image_height>"
        "<model><type>perspectiveProjWithoutDistortion</type><px>250</px><py>251</py><u0>160</u0>"
        "<v0>120</v0></model></camera></root>";
    const td_rig_text file = {"v.xml", visp, strlen(visp)};
    check_fails(td_rig_import_text(&rig, &file, 1, NULL, &error), TD_ERROR_DATA, error,
                "v.xml: the poses of Camera_1, Camera_1_2 to one another");
    td_rig_import_options options = {.format = TD_RIG_FORMAT_COUNT, .width = 640, .height = 480};
    check_ok(td_rig_import_text(&rig, &file, 1, &options, &error), error);
    assert_int_equal(rig->count, 1);
    assert_int_equal(rig->camera[0].camera.model, TD_CAMERA_BROWN5);
    check_near(rig->camera[0].camera.parameter[0], 510, 0);
    td_rig_free(&rig);
    options = (td_rig_import_options){.format = TD_RIG_FORMAT_COUNT, .camera = "Camera_1_2"};
    check_ok(td_rig_import_text(&rig, &file, 1, &options, &error), error);
    check_near(rig->camera[0].camera.parameter[0], 250, 0);
    td_rig_free(&rig);
    options.camera = "left";
    check_fails(td_rig_import_text(&rig, &file, 1, &options, &error), TD_ERROR_NOT_FOUND, error,
                "has no camera left; there are Camera_1, Camera_1_2");
}

/* ---- files ---- */

static void test_files(void **state)
{
    td_error error = {0};
    td_random random = td_random_seed(14, 1);
    td_rig *rig = make_rig(2, TD_CAMERA_BROWN5, 0, &random), *back = NULL;
    td_rig_export_report report = {0};
    char *folder = td_path_join(*state, "ros/"), *single = td_path_join(*state, "one.yaml");
    char *pattern = td_path_join(*state, "sub/x-%s.cameramodel"), *whole = td_path_join(*state, "pair.yml");
    check_ok(td_rig_export(rig, folder, TD_RIG_ROS, false, &report, &error), error);
    assert_int_equal(report.file_count, 2);
    assert_non_null(strstr(report.file[1], "ros/cam-b.yaml"));
    check_ok(td_rig_import(&back, (const char *const *)report.file, 2, NULL, &error), error);
    check_rig(rig, back);
    td_rig_free(&back);
    td_rig_export_report_free(&report);
    check_ok(td_rig_export(rig, pattern, TD_RIG_MRCAL, false, &report, &error), error);
    assert_non_null(strstr(report.file[0], "sub/x-cam-a.cameramodel"));
    td_rig_export_report_free(&report);
    check_fails(td_rig_export(rig, single, TD_RIG_ROS, false, &report, &error), TD_ERROR_ARGUMENT, error,
                "a file for each of the 2 cameras");
    struct stat seen;
    assert_int_not_equal(stat(single, &seen), 0);
    check_ok(td_rig_export(rig, whole, TD_RIG_OPENCV, false, NULL, &error), error);
    check_ok(td_rig_import(&back, (const char *const *)&whole, 1, NULL, &error), error);
    check_rig(rig, back);
    td_rig_free(&back);
    td_rig_free(&rig);
    free(folder);
    free(single);
    free(pattern);
    free(whole);
}

/* ---- bad files ---- */

static void check_refused(td_rig_format format, const char *text, const char *words)
{
    td_error error = {0};
    td_rig *rig = NULL;
    const td_rig_text file = {"bad", text, strlen(text)};
    const td_rig_import_options options = {.format = format};
    const td_status status = td_rig_import_text(&rig, &file, 1, &options, &error);
    if (status == TD_OK) fail_msg("accepted: %s", text);
    assert_null(rig);
    if (strncmp(error.message, "bad", 3) != 0 || strchr(error.message, '\n') || !strstr(error.message, words))
        fail_msg("'%s' lacks '%s'", error.message, words);
}

#define YML "%YAML:1.0\n"
#define ROS_HEAD                                                                                             \
    "image_width: 640\nimage_height: 480\ncamera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, "    \
    "240, 0, 0, 1]}\n"
#define VISP_HEAD                                                                                            \
    "<root><camera><name>a</name><image_width>640</image_width><image_height>480</image_height><model>"
#define MRCAL(model, values, size)                                                                           \
    "{'lensmodel': '" model "', 'intrinsics': [" values                                                      \
    "], 'extrinsics': [0,0,0,0,0,0], 'imagersize': " size "}"

static void test_bad_files(void **state)
{
    (void)state;
    for (int f = 0; f <= TD_RIG_FORMAT_COUNT; f++) check_refused((td_rig_format)f, "", "bad");
    check_refused(TD_RIG_FORMAT_COUNT, "hello", "looks like no format known here");
    check_refused(TD_RIG_OPENCV, YML "a: 1\n", "holds no camera matrix");
    check_refused(TD_RIG_OPENCV, YML MATRIX("M1", "3", "3", K33), "does not tell the size");
    check_refused(TD_RIG_OPENCV, YML MATRIX("M1", "3", "2", "1., 2., 3., 4., 5., 6."), "M1: is 3 x 2");
    check_refused(TD_RIG_OPENCV, YML MATRIX("M1", "3", "3", "1., 2., 3."),
                  "M1.data: must have 9 elements, but has 3");
    check_refused(TD_RIG_OPENCV, YML MATRIX("M1", "3", "3", "500., 0., .Nan, 0., 500., 240., 0., 0., 1."),
                  "M1.data[2]: must be a finite number");
    check_refused(TD_RIG_OPENCV, YML MATRIX("M1", "3", "3", "500., 0.1, 320., 0., 500., 240., 0., 0., 1."),
                  "skew");
    check_refused(TD_RIG_OPENCV,
                  YML MATRIX("K", "3", "3", K33) MATRIX("D", "1", "12", "0,0,0,0,0,0,0,0,0,0,.5,0"),
                  "D: holds a thin prism distortion (s3 = 0.5)");
    check_refused(TD_RIG_OPENCV,
                  YML MATRIX("K", "3", "3", K33) MATRIX("D", "1", "14", "0,0,0,0,0,0,0,0,0,0,0,0,.1,0"),
                  "tilted sensor");
    check_refused(TD_RIG_OPENCV,
                  YML "M1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 5.3, 0.", "bad:");
    check_refused(TD_RIG_OPENCV,
                  YML MATRIX("M1", "3", "3", K33) MATRIX("M2", "3", "3", K33)
                      MATRIX("R", "3", "3", "1., 0., 0., 0., 1., 0., 0., 0., -1.")
                          MATRIX("T", "3", "1", "1., 0., 0."),
                  "R: is no rotation matrix");
    check_refused(TD_RIG_OPENCV, "<?xml version=\"1.0\"?><!DOCTYPE a [<!ENTITY b \"c\">]><opencv_storage/>",
                  "document types");
    check_refused(TD_RIG_VISP, "<?xml version=\"1.0\"?><!DOCTYPE a SYSTEM \"file:///etc/hostname\"><root/>",
                  "document types");
    check_refused(TD_RIG_OPENCV, "<opencv_storage><M1>", "is not valid XML");
    check_refused(TD_RIG_OPENCV, "<opencv><M1>1</M1></opencv>", "the root element is <opencv>");
    check_refused(TD_RIG_ROS, ROS_HEAD, "distortion_coefficients: is missing");
    check_refused(TD_RIG_ROS,
                  ROS_HEAD "distortion_model: fov\ndistortion_coefficients: {rows: 1, cols: 1, data: [1]}\n",
                  "distortion_model: is 'fov'");
    check_refused(TD_RIG_ROS, "image_width: 1e400\n", "too large");
    check_refused(TD_RIG_KALIBR, "cam1: {}\n", "cam0: is missing");
    check_refused(TD_RIG_KALIBR, "cam0: {camera_model: omni}\n", "cam0.camera_model: is 'omni'");
    check_refused(TD_RIG_KALIBR,
                  "cam0: {camera_model: pinhole, distortion_model: fov, intrinsics: [1, 2, 3, 4]}\n",
                  "cam0.distortion_model: is 'fov'");
    check_refused(TD_RIG_VISP, "<root></root>", "camera: is missing");
    check_refused(TD_RIG_VISP, VISP_HEAD "<type>fish</type></model></camera></root>",
                  "camera.model.type: is 'fish'");
    check_refused(TD_RIG_VISP,
                  VISP_HEAD
                  "<type>perspectiveProjWithoutDistortion</type><px>nan</px></model></camera></root>",
                  "camera.model.px");
    check_refused(TD_RIG_VISP,
                  VISP_HEAD
                  "<type>perspectiveProjWithDistortion</type><px>500</px><py>500</py><u0>320</u0><v0>240"
                  "</v0><kud>0</kud><kdu>0.2</kdu></model></camera></root>",
                  "camera.model.kud: is 0, but kdu is 0.2");
    check_refused(TD_RIG_VISP, "<root><camera>&x;</camera></root>", "is not valid XML");
    check_refused(TD_RIG_MRCAL, "{'lensmodel'", "a ':' is missing");
    check_refused(TD_RIG_MRCAL, "{'a': [1, 2", "cut short");
    check_refused(TD_RIG_MRCAL, MRCAL("LENSMODEL_CAHVOR", "1", "[640, 480]"),
                  "lensmodel: is 'LENSMODEL_CAHVOR'");
    check_refused(TD_RIG_MRCAL, MRCAL("LENSMODEL_OPENCV5", "500,500,320,240", "[640, 480]"),
                  "intrinsics: must have 9 elements, but has 4");
    check_refused(TD_RIG_MRCAL, MRCAL("LENSMODEL_PINHOLE", "500,nan,320,240", "[640, 480]"), "intrinsics[1]");
    check_refused(TD_RIG_MRCAL, MRCAL("LENSMODEL_PINHOLE", "500,500,320,240", "[0, 480]"), "imagersize[0]");
}

/* Every prefix of a good file: refused, or the same rig (the end may be blank). */
static void test_truncated_files(void **state)
{
    (void)state;
    td_random random = td_random_seed(15, 1);
    for (int f = 0; f < TD_RIG_FORMAT_COUNT; f++) {
        td_error error = {0};
        td_rig *rig = make_rig(1, TD_CAMERA_PINHOLE, 0, &random);
        char *text = NULL;
        check_ok(td_rig_export_text(&text, rig, 0, (td_rig_format)f, false, NULL, &error), error);
        for (size_t size = 0; size < strlen(text); size++) {
            td_rig *back = NULL;
            const td_rig_text file = {"cut", text, size};
            const td_rig_import_options options = {.format = (td_rig_format)f};
            if (td_rig_import_text(&back, &file, 1, &options, &error) == TD_OK)
                assert_true(back->camera[0].camera.width > 0);
            else
                assert_memory_equal(error.message, "cut", 3);
            td_rig_free(&back);
        }
        free(text);
        td_rig_free(&rig);
    }
}

static void test_hostile_nesting(void **state)
{
    (void)state;
    enum { DEPTH = 100000 };
    static const struct {
        td_rig_format format;
        const char *head, *unit;
    } deep[] = {
        {TD_RIG_MRCAL, "", "["},  {TD_RIG_MRCAL, "", "{'a':"}, {TD_RIG_OPENCV, "<opencv_storage>", "<a>"},
        {TD_RIG_VISP, "", "<a>"}, {TD_RIG_OPENCV, "a: ", "["}, {TD_RIG_KALIBR, "a: ", "{b: "}};
    for (size_t i = 0; i < sizeof deep / sizeof *deep; i++) {
        const size_t head = strlen(deep[i].head), unit = strlen(deep[i].unit);
        char *text = malloc(head + unit * DEPTH + 1);
        strcpy(text, deep[i].head);
        for (size_t k = 0; k < DEPTH; k++) memcpy(text + head + k * unit, deep[i].unit, unit + 1);
        check_refused(deep[i].format, text, "bad");
        free(text);
    }
}

/* ---- poses as text ---- */

static void test_urdf_and_ros_lines(void **state)
{
    (void)state;
    td_random random = td_random_seed(16, 1);
    for (int n = 0; n < 2000; n++) {
        double xi[6], rpy[3], t[3], q[4];
        for (int i = 0; i < 6; i++) xi[i] = 2 * td_random_normal(&random);
        td_pose pose = td_pose_exp(xi);
        if (n % 4 == 0) { /* pitch at or near a right angle, where roll and yaw are one */
            const double about_z[3] = {0, 0, xi[0]},
                         about_y[3] = {0, (n % 8 ? 1 : -1) * (1.5707963267948966 + (n % 16 ? 0 : 1e-9)), 0};
            td_pose z = td_pose_identity(), y = z;
            td_rotation_exp(z.q, about_z);
            td_rotation_exp(y.q, about_y);
            pose = td_pose_compose(&z, &y);
        }
        char *urdf = td_pose_to_urdf(&pose), *ros = td_pose_to_ros(&pose, "base", "camera"), a[16], b[16];
        assert_int_equal(sscanf(urdf, "<origin xyz=\"%lf %lf %lf\" rpy=\"%lf %lf %lf\"/>", t, t + 1, t + 2,
                                rpy, rpy + 1, rpy + 2),
                         6);
        td_pose back = {{1, 0, 0, 0}, {t[0], t[1], t[2]}};
        for (int axis = 0; axis < 3; axis++) { /* R = Rz Ry Rx */
            double omega[3] = {0, 0, 0};
            td_pose turn = td_pose_identity();
            omega[axis] = rpy[axis];
            td_rotation_exp(turn.q, omega);
            const td_pose rotation = {{back.q[0], back.q[1], back.q[2], back.q[3]}, {0, 0, 0}};
            memcpy(back.q, td_pose_compose(&turn, &rotation).q, sizeof back.q);
        }
        check_near(pose_apart(&back, &pose), 0, 1e-14 * (1 + td_pose_distance(&pose)));
        assert_int_equal(sscanf(ros, "%lf %lf %lf %lf %lf %lf %lf %15s %15s", t, t + 1, t + 2, q + 1, q + 2,
                                q + 3, q, a, b),
                         9);
        assert_memory_equal(q, pose.q, sizeof q);
        assert_memory_equal(t, pose.t, sizeof t);
        assert_string_equal(a, "base");
        assert_string_equal(b, "camera");
        free(urdf);
        free(ros);
    }
}

static void test_format_names(void **state)
{
    (void)state;
    for (int f = 0; f < TD_RIG_FORMAT_COUNT; f++)
        assert_int_equal(td_rig_format_from_name(td_rig_format_name((td_rig_format)f)), f);
    assert_int_equal(td_rig_format_from_name("colmap"), TD_RIG_FORMAT_COUNT);
    assert_int_equal(td_rig_format_from_name(NULL), TD_RIG_FORMAT_COUNT);
    assert_null(td_rig_format_name(TD_RIG_FORMAT_COUNT));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trips),
        cmocka_unit_test(test_parts_of_models_are_exact),
        cmocka_unit_test(test_approximations_tell_their_error),
        cmocka_unit_test(test_fit_is_the_least),
        cmocka_unit_test(test_inverse_coefficient),
        cmocka_unit_test(test_wide_fisheye_is_refused),
        cmocka_unit_test(test_directions),
        cmocka_unit_test(test_ros_rectification),
        cmocka_unit_test(test_losses_are_told),
        cmocka_unit_test(test_names_sizes_and_choice),
        cmocka_unit_test(test_bad_files),
        cmocka_unit_test(test_truncated_files),
        cmocka_unit_test(test_hostile_nesting),
        cmocka_unit_test(test_urdf_and_ros_lines),
        cmocka_unit_test(test_format_names),
        cmocka_unit_test_setup_teardown(test_files, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
