/* Proves that a rig survives its file bit for bit (random rigs of every model, up to 16 cameras, with and
 * without the optional parts), that the file is laid out as core/rig.h says, and that each way of being wrong
 * is refused with file and field. References: the rig itself; the layout written out by hand. No tolerances.
 * Blind to whether a covariance is positive semidefinite: only symmetry and variances are checked. */
#include <stdbool.h>

#include "core/random.h"
#include "core/rig.h"
#include "tests/check.h"
#include "tests/scratch.h"

static void random_camera(td_rig_camera *c, td_random *random, int index)
{
    snprintf(c->name, sizeof c->name, "%s%d", index % 3 == 0 ? "" : index % 3 == 1 ? "cam-" : "_", index);
    c->camera = (td_camera){.model = (td_camera_model)td_random_below(random, TD_CAMERA_MODEL_COUNT),
                            .width = 640,
                            .height = 480};
    double *p = c->camera.parameter;
    for (int i = 0; i < td_camera_parameter_count(c->camera.model); i++)
        p[i] = i < 4 ? 300 + 50 * td_random_normal(random) : td_random_normal(random);
    p[0] = fabs(p[0]) + 10;
    p[1] = fabs(p[1]) + 10;
    double xi[6];
    for (int i = 0; i < 6; i++) xi[i] = td_random_normal(random);
    c->camera_from_rig = index ? td_pose_exp(xi) : td_pose_identity();
}

static void random_covariance(td_rig *rig, td_random *random)
{
    const size_t n = td_rig_parameter_count(rig),
                 first = (size_t)td_camera_parameter_count(rig->camera[0].camera.model);
    rig->covariance = calloc(n * n, sizeof(double));
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            bool fixed = (i >= first && i < first + 6) || (j >= first && j < first + 6);
            double value = fixed    ? 0
                           : i == j ? 1 + td_random_uniform(random)
                                    : 1e-3 * td_random_normal(random);
            rig->covariance[i * n + j] = rig->covariance[j * n + i] = value;
        }
}

static td_rig *random_rig(td_random *random, int count, bool whole)
{
    td_rig *rig = td_rig_new();
    rig->count = count;
    for (int i = 0; i < count; i++) random_camera(rig->camera + i, random, i);
    if (!whole) return rig;
    rig->has_vehicle = true;
    double xi[6];
    for (int i = 0; i < 6; i++) xi[i] = td_random_normal(random);
    rig->vehicle_from_rig = td_pose_exp(xi);
    random_covariance(rig, random);
    rig->provenance = json_pack("{s:s, s:f, s:{s:i}, s:[s,s]}", "dataset", "0123abc", "rms_px", 0.1 + 0.2,
                                "options", "views", 13, "version", "0.1.0", "null");
    return rig;
}

/* An honest stereo head, to be spoilt. */
static td_rig *stereo(void)
{
    td_random random = td_random_seed(1, 1);
    td_rig *rig = td_rig_new();
    rig->count = 2;
    for (int i = 0; i < 2; i++) {
        td_rig_camera *c = rig->camera + i;
        strcpy(c->name, i ? "right" : "left");
        c->camera = (td_camera){.model = TD_CAMERA_BROWN5,
                                .width = 640,
                                .height = 480,
                                .parameter = {536.5, 536, 342, 235.25, -0.25, 0, 0.001, 0, 0.125}};
        c->camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[0] = -0.125;
    random_covariance(rig, &random);
    return rig;
}

static void check_same(const td_rig *a, const td_rig *b)
{
    assert_int_equal(a->count, b->count);
    for (int i = 0; i < a->count; i++) {
        assert_string_equal(a->camera[i].name, b->camera[i].name);
        const td_camera *x = &a->camera[i].camera, *y = &b->camera[i].camera;
        assert_true(x->model == y->model && x->width == y->width && x->height == y->height);
        assert_memory_equal(x->parameter, y->parameter, sizeof x->parameter);
        assert_memory_equal(&a->camera[i].camera_from_rig, &b->camera[i].camera_from_rig, sizeof(td_pose));
    }
    assert_int_equal(a->has_vehicle, b->has_vehicle);
    if (a->has_vehicle) assert_memory_equal(&a->vehicle_from_rig, &b->vehicle_from_rig, sizeof(td_pose));
    assert_int_equal(!a->covariance, !b->covariance);
    const size_t n = td_rig_parameter_count(a);
    if (a->covariance) assert_memory_equal(a->covariance, b->covariance, n * n * sizeof(double));
    assert_int_equal(!a->provenance, !b->provenance);
    if (a->provenance) assert_true(json_equal(a->provenance, b->provenance));
}

static void test_every_bit_survives(void **state)
{
    td_error error = {0};
    td_random random = td_random_seed(4, 2);
    char *path = td_path_join(*state, "rig.yaml");
    for (int i = 0; i < 2 * TD_RIG_MAX_CAMERAS; i++) {
        td_rig *rig = random_rig(&random, 1 + i / 2, i % 2), *back = NULL, *copy = td_rig_copy(rig);
        check_same(rig, copy);
        check_ok(td_rig_write(rig, path, &error), error);
        check_ok(td_rig_read(&back, path, &error), error);
        check_same(rig, back);
        char *text = NULL, *again = NULL;
        check_ok(td_rig_to_yaml(&text, rig, &error), error);
        check_ok(td_rig_to_yaml(&again, back, &error), error);
        assert_string_equal(text, again);
        free(text);
        free(again);
        td_rig_free(&rig);
        td_rig_free(&back);
        td_rig_free(&copy);
        assert_null(copy);
    }
    td_rig_free(NULL);
    free(path);
}

static void test_layout(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = stereo();
    free(rig->covariance);
    rig->covariance = NULL;
    rig->camera[1].camera.model = TD_CAMERA_PINHOLE;
    for (int i = 4; i < 9; i++) rig->camera[1].camera.parameter[i] = 0;
    rig->has_vehicle = true;
    rig->vehicle_from_rig = td_pose_identity();
    rig->provenance = json_pack("{s:s}", "version", "0.1.0");
    char *text = NULL;
    check_ok(td_rig_to_yaml(&text, rig, &error), error);
    assert_int_equal(text[0], '#');
    assert_non_null(strstr(text, "left perturbation"));
    assert_string_equal(strstr(text, "teledimos"),
                        "teledimos: rig 1\n"
                        "cameras:\n"
                        "  - name: left\n"
                        "    model: brown5\n"
                        "    width: 640\n"
                        "    height: 480\n"
                        "    intrinsics: {fx: 536.5, fy: 536.0, cx: 342.0, cy: 235.25}\n"
                        "    distortion: {k1: -0.25, k2: 0.0, p1: 0.001, p2: 0.0, k3: 0.125}\n"
                        "    camera_from_rig: {q: [1.0, 0.0, 0.0, 0.0], t_m: [0.0, 0.0, 0.0]}\n"
                        "  - name: right\n"
                        "    model: pinhole\n"
                        "    width: 640\n"
                        "    height: 480\n"
                        "    intrinsics: {fx: 536.5, fy: 536.0, cx: 342.0, cy: 235.25}\n"
                        "    camera_from_rig: {q: [1.0, 0.0, 0.0, 0.0], t_m: [-0.125, 0.0, 0.0]}\n"
                        "vehicle_from_rig: {q: [1.0, 0.0, 0.0, 0.0], t_m: [0.0, 0.0, 0.0]}\n"
                        "provenance:\n"
                        "  version: \"0.1.0\"\n");
    free(text);
    td_rig_free(&rig);
    rig = stereo();
    check_ok(td_rig_to_yaml(&text, rig, &error), error);
    assert_non_null(strstr(
        text,
        "\ncovariance:\n  order: [left.fx, left.fy, left.cx, left.cy, left.k1, left.k2, left.p1, left.p2, "
        "left.k3, left.rx, left.ry, left.rz, left.tx, left.ty, left.tz, right.fx, "));
    assert_non_null(strstr(text, "right.tz]\n  matrix:\n    - ["));
    free(text);
    td_rig_free(&rig);
}

static void test_parameter_names(void **state)
{
    (void)state;
    td_rig *rig = stereo();
    char name[TD_NAME_SIZE + 8];
    rig->camera[0].camera.model = TD_CAMERA_FISHEYE;
    assert_int_equal(td_rig_parameter_count(rig), 8 + 6 + 9 + 6);
    assert_int_equal(td_rig_parameter_offset(rig, 0), 0);
    assert_int_equal(td_rig_parameter_offset(rig, 1), 14);
    const struct {
        size_t index;
        const char *name;
    } row[] = {{0, "left.fx"},   {7, "left.k4"},   {8, "left.rx"},   {13, "left.tz"}, {14, "right.fx"},
               {22, "right.k3"}, {23, "right.rx"}, {28, "right.tz"}, {29, ""}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        assert_string_equal(td_rig_parameter_name(name, rig, row[i].index), row[i].name);
    assert_int_equal(td_rig_find(rig, "right"), 1);
    assert_int_equal(td_rig_find(rig, "Right"), -1);
    td_rig_free(&rig);
}

static void test_check(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = stereo();
    check_ok(td_rig_check(rig, &error), error);
#define SPOILT(change, words)                                                                                \
    do {                                                                                                     \
        rig = stereo();                                                                                      \
        change;                                                                                              \
        check_fails(td_rig_check(rig, &error), TD_ERROR_ARGUMENT, error, words);                             \
        char *text_ = NULL;                                                                                  \
        check_fails(td_rig_to_yaml(&text_, rig, &error), TD_ERROR_ARGUMENT, error, words);                   \
        assert_null(text_);                                                                                  \
        td_rig_free(&rig);                                                                                   \
    } while (0)
    td_rig_free(&rig);
    SPOILT(rig->count = 0, "cameras: there are 0");
    SPOILT(rig->count = 17, "cameras: there are 17");
    SPOILT(strcpy(rig->camera[1].name, "left"), "cameras[1].name: 'left' is given twice");
    SPOILT(strcpy(rig->camera[1].name, "a b"), "cameras[1].name: 'a b' must be 1 to 63 letters");
    SPOILT(rig->camera[1].name[0] = 0, "cameras[1].name");
    SPOILT(memset(rig->camera[1].name, 'a', TD_NAME_SIZE), "cameras[1].name");
    SPOILT(rig->camera[1].camera.parameter[0] = NAN, "cameras.right: fx");
    SPOILT(rig->camera[1].camera.width = 0, "cameras.right: width");
    SPOILT(rig->camera[1].camera_from_rig.q[1] = 1e-5,
           "cameras.right.camera_from_rig.q: must be a unit quaternion");
    SPOILT(rig->camera[1].camera_from_rig.q[1] = NAN, "cameras.right.camera_from_rig.q");
    SPOILT(rig->camera[1].camera_from_rig.t[2] = INFINITY, "cameras.right.camera_from_rig.t_m");
    SPOILT(rig->camera[0].camera_from_rig.t[2] = 1e-9, "cameras.left.camera_from_rig: must be the identity");
    SPOILT((rig->has_vehicle = true, rig->vehicle_from_rig.q[0] = 2), "vehicle_from_rig.q");
    SPOILT(rig->covariance[0] = -1e-9, "covariance: the variance of left.fx is -1e-09");
    SPOILT(rig->covariance[30 * 15 + 15] = NAN, "covariance: the variance of right.fx is nan");
    SPOILT(rig->covariance[1] += 1e-6, "covariance: is not symmetric");
    SPOILT(rig->covariance[29 * 30] = INFINITY, "covariance");
    SPOILT(rig->covariance[9 * 30 + 9] = 1, "covariance: must be zero for left.rx");
    SPOILT(rig->provenance = json_array(), "provenance: must be a mapping");
#undef SPOILT
    rig = stereo();
    rig->covariance[1] += 1e-12; /* rounding is forgiven */
    check_ok(td_rig_check(rig, &error), error);
    check_fails(td_rig_write(rig, "/no/such/folder/rig.yaml", &error), TD_ERROR_IO, error,
                "/no/such/folder/rig.yaml");
    td_rig_free(&rig);
}

/* Replaces the first `from` in the text by `to`; the result is to be freed. */
static char *replaced(const char *text, const char *from, const char *to)
{
    const char *at = strstr(text, from);
    if (!at) fail_msg("'%s' is not in the rig", from);
    char *made = malloc(strlen(text) + strlen(to) + 1);
    sprintf(made, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    return made;
}

static void test_reading_refuses(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = stereo(), *back = NULL;
    char *good = NULL;
    check_ok(td_rig_to_yaml(&good, rig, &error), error);
    const char *const row[][3] = {
        {"teledimos: rig 1", "teledimos: rig 2",
         "r.yaml: teledimos: is version 2 of a rig, but this program reads up to version 1"},
        {"teledimos: rig 1", "teledimos: result 1", "teledimos: is 'result 1', so this is not a rig"},
        {"teledimos: rig 1", "teledimos: rig", "is 'rig', so this is not a rig"},
        {"teledimos: rig 1", "teledimos: rig x", "is no version"},
        {"teledimos: rig 1", "teledimos: rig 0", "is no version"},
        {"teledimos: rig 1", "teledimos: 1", "teledimos: must be a text"},
        {"teledimos: rig 1\n", "", "r.yaml: is not a rig: 'teledimos: rig 1' is missing"},
        {"cameras:", "cams: 1\ncameras:", "r.yaml: unknown key 'cams'"},
        {"\ncovariance:", "\ncovarience:", "unknown key 'covarience'; did you mean 'covariance'?"},
        {"    width:", "    widht:", "r.yaml: cameras[0]: unknown key 'widht'; did you mean 'width'?"},
        {"    width: 640\n", "", "cameras.left.width: is missing"},
        {"width: 640", "width: 0", "cameras.left.width: is 0"},
        {"width: 640", "width: 100000", "cameras.left: width"},
        {"width: 640", "width: 640.5", "cameras.left.width: must be a whole number"},
        {"name: left", "name: ../left", "cameras[0].name: must be 1 to 63 letters, digits, - and _"},
        {"name: left", "name: 1", "cameras[0].name: must be a text, but is the number 1; put it in quotes"},
        {"name: right", "name: left", "cameras: the name 'left' is given twice"},
        {"model: brown5", "model: brown6",
         "cameras.left.model: is 'brown6', but must be one of pinhole, brown5, brown8, fisheye"},
        {"model: brown5", "model: pinhole", "cameras.left.distortion: unknown key 'k1'; known here are none"},
        {"model: brown5", "model: brown8", "cameras.left.distortion.k4: is missing"},
        {"fx: 536.5", "fx: .nan",
         "cameras.left.intrinsics.fx: must be a finite number, but is the text '.nan'"},
        {"fx: 536.5", "fx: .inf", "cameras.left.intrinsics.fx: must be a finite number"},
        {"fx: 536.5", "fx: 1e12", "cameras.left.intrinsics.fx: is 1000000000000.0"},
        {"fx: 536.5", "fx: -5", "cameras.left: fx"},
        {"fx: 536.5", "f: 536.5", "cameras.left.intrinsics: unknown key 'f'"},
        {"k3: 0.125", "k3: \"0.125\"", "cameras.left.distortion.k3: must be a finite number"},
        {"q: [1.0, 0.0,", "q: [0.999, 0.0,", "cameras.left.camera_from_rig.q: must be a unit quaternion"},
        {"q: [1.0, 0.0,", "q: [1.0,", "cameras.left.camera_from_rig.q: must have 4 elements, but has 3"},
        {"t_m: [0.0,", "t_mm: [0.0,",
         "cameras.left.camera_from_rig: unknown key 't_mm'; did you mean 't_m'?"},
        {"t_m: [0.0,", "t_m: [0.1,", "cameras.left.camera_from_rig: must be the identity"},
        {"t_m: [-0.125,", "t_m: [1e9,", "cameras.right.camera_from_rig.t_m[0]: is 1000000000.0"},
        {"[left.fx,", "[left.f,",
         "r.yaml: covariance.order[0]: is 'left.f', but the cameras above have 'left.fx' here"},
        {"[left.fx,", "[", "covariance.order: must have 30 elements, but has 29"},
        {"left.fy, left.cx", "left.cx, left.fy", "covariance.order[1]: is 'left.cx'"},
        {"    - [", "    - [-", "covariance: the variance of left.fx is -1."},
        {"    - [", "    - [1, ", "covariance.matrix[0]: must have 30 elements, but has 31"},
        {"matrix:\n", "matrix:\n    - []\n", "covariance.matrix: must have 30 elements, but has 31"},
        {"covariance:\n  order:", "covariance:\n  orders:",
         "covariance: unknown key 'orders'; did you mean 'order'?"},
        {"cameras:\n", "provenance: [1]\ncameras:\n", "provenance: must be a mapping"},
        {"cameras:\n", "vehicle_from_rig: {q: [1, 0, 0, 0]}\ncameras:\n", "vehicle_from_rig.t_m: is missing"},
        {"cameras:\n", "&a cameras:\n", "anchors"}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char *bad = replaced(good, row[i][0], row[i][1]);
        check_fails(td_rig_parse(&back, bad, strlen(bad), "r.yaml", &error), TD_ERROR_FORMAT, error,
                    row[i][2]);
        assert_int_equal(strncmp(error.message, "r.yaml:", 7), 0);
        assert_null(back);
        free(bad);
    }
    check_fails(td_rig_parse(&back, "a: 1", 4, "r.yaml", &error), TD_ERROR_FORMAT, error,
                "r.yaml: is not a rig");
    const char *const none[] = {"cameras: []", "cameras: {}", "cameras: 3", "cameras: [1]", ""};
    for (size_t i = 0; i < 5; i++) {
        char text[64];
        snprintf(text, sizeof text, "teledimos: rig 1\n%s\n", none[i]);
        check_fails(td_rig_parse(&back, text, strlen(text), "r.yaml", &error), TD_ERROR_FORMAT, error,
                    "r.yaml: cameras");
    }
    char many[2048] = "teledimos: rig 1\ncameras: [";
    for (int i = 0; i < 17; i++) strcat(many, "{},");
    strcat(many, "]\n");
    check_fails(td_rig_parse(&back, many, strlen(many), "r.yaml", &error), TD_ERROR_FORMAT, error,
                "cameras: must have 1 to 16 elements, but has 17");
    assert_null(back);
    free(good);
    td_rig_free(&rig);
}

/* What a person may write by hand: whole numbers, JSON, another order of keys, rounded quaternions, nulls. */
static void test_reading_is_liberal_where_it_may(void **state)
{
    (void)state;
    td_error error = {0};
    td_rig *rig = NULL;
    const char *text =
        "{\"covariance\": null, \"vehicle_from_rig\": null, \"provenance\": null, \"cameras\": [{\"height\": "
        "480, \"width\": 640, "
        "\"name\": \"01\", \"camera_from_rig\": {\"t_m\": [0, 0, 0], \"q\": [1, 0, 0, 0]}, \"intrinsics\": "
        "{\"fx\": 500, \"fy\": 500, "
        "\"cx\": 320, \"cy\": 240}, \"model\": \"pinhole\"}, {\"name\": \"b\", \"height\": 480, \"width\": "
        "640, \"model\": \"pinhole\", "
        "\"intrinsics\": {\"fx\": 500, \"fy\": 500, \"cx\": 320, \"cy\": 240}, \"distortion\": {}, "
        "\"camera_from_rig\": {\"t_m\": [1, 0, 0], \"q\": [0.7071068, 0.7071068, 0, 0]}}], \"teledimos\": "
        "\"rig 1\"}";
    check_ok(td_rig_parse(&rig, text, strlen(text), "r.yaml", &error), error);
    assert_int_equal(rig->count, 2);
    assert_string_equal(rig->camera[0].name, "01");
    assert_true(rig->camera[0].camera.parameter[0] == 500 && !rig->covariance && !rig->provenance &&
                !rig->has_vehicle);
    check_near(rig->camera[1].camera_from_rig.q[0], sqrt(0.5), 1e-15);
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_every_bit_survives, scratch_make, scratch_remove),
        cmocka_unit_test(test_layout),
        cmocka_unit_test(test_parameter_names),
        cmocka_unit_test(test_check),
        cmocka_unit_test(test_reading_refuses),
        cmocka_unit_test(test_reading_is_liberal_where_it_may),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
