/* Proves: coverage counts points in the right cells of the image, tells the four tilts apart, measures
 * distances and says in words what is missing, and only that. Reference: boards placed by hand, so that every
 * figure is known beforehand; exact but for rounding (1e-12). Blind to: whether the advice helps a
 * calibration. */
#include "calib/coverage.h"
#include "tests/calib/simulate.h"

/* A camera of 540 px focal length with `views` boards whose centres stand at (x, y, z) and lean by tilt_x
 * about the image's x, tilt_y about its y. */
typedef struct placed {
    double x, y, z, tilt_x, tilt_y;
} placed;

typedef struct scene {
    simulation s;
    td_observations *o;
    td_calibration c;
    td_calibrated_view view[32];
} scene;

static void scene_make(scene *sc, const placed *at, size_t views)
{
    td_error error = {0};
    memset(sc, 0, sizeof *sc);
    sc->s = simulate_stereo(TD_CAMERA_PINHOLE, views);
    sc->s.rig->count = 1;
    sc->s.rig->camera[0].camera.parameter[2] = 319.5;
    sc->s.rig->camera[0].camera.parameter[3] = 239.5;
    check_ok(td_observations_new(&sc->o, &sc->s.target, 1, views, &error), error);
    strcpy(sc->o->camera[0].name, "left");
    sc->o->camera[0].width = 640, sc->o->camera[0].height = 480;
    size_t points = td_target_point_count(&sc->s.target);
    sc->c = (td_calibration){.rig = sc->s.rig, .view_count = views, .view = sc->view};
    sc->c.used = calloc(views * points, 1);
    for (size_t v = 0; v < views; v++) {
        const double centre[6] = {0, 0, 0, -0.1, -0.0625, 0}, lean_x[6] = {at[v].tilt_x, 0, 0, 0, 0, 0},
                     lean_y[6] = {0, at[v].tilt_y, 0, 0, 0, 0},
                     away[6] = {0, 0, 0, at[v].x, at[v].y, at[v].z};
        td_pose a = td_pose_exp(away), l = td_pose_exp(lean_x), k = td_pose_exp(lean_y),
                p = td_pose_exp(centre);
        p = td_pose_compose(&k, &p);
        p = td_pose_compose(&l, &p);
        sc->view[v] = (td_calibrated_view){.state = TD_VIEW_USED, .rig_from_target = td_pose_compose(&a, &p)};
        td_detection *d = td_observations_get(sc->o, v, 0);
        d->found = true;
        for (size_t i = 0; i < points; i++) {
            double x[3];
            td_target_point(x, &sc->s.target, i);
            td_pose_transform(x, &sc->view[v].rig_from_target, x);
            assert_true(td_camera_project(d->point + 2 * i, NULL, NULL, &sc->s.rig->camera[0].camera, x));
            sc->c.used[v * points + i] = 1;
        }
    }
}

static void scene_free(scene *sc)
{
    free(sc->c.used);
    td_observations_free(&sc->o);
    td_rig_free(&sc->s.rig);
}

static void test_tilts(void **state)
{
    (void)state;
    /* A turn by +20 degrees about y (down) takes the right side (x > 0) nearer: the left side is away; about
     * x by +20 degrees the lower side (y > 0) goes away. */
    const placed at[] = {{0, 0, 0.5, 0, 0.35},
                         {0, 0, 0.4, 0, -0.35},
                         {0, 0, 0.5, 0.35, 0},
                         {0, 0, 0.8, -0.30, 0},
                         {0, 0, 0.5, 0.2, 0.2}};
    scene sc;
    td_coverage c;
    scene_make(&sc, at, 4);
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    assert_int_equal(c.views, 4);
    for (int i = 0; i < 4; i++) assert_int_equal(c.tilted[i], 1);
    /* What the words say, by the board itself: of view 1 the right edge is farther. */
    double left[3], right[3];
    td_target_point(left, &sc.s.target, 0);
    td_target_point(right, &sc.s.target, 8);
    td_pose_transform(left, &sc.view[1].rig_from_target, left);
    td_pose_transform(right, &sc.view[1].rig_from_target, right);
    assert_true(right[2] > left[2]);
    const int away[4] = {1, 0, 2, 3}; /* of each view: left, right, lower, upper side */
    for (int v = 0; v < 4; v++) {
        for (size_t i = 0; i < 4 * 54; i++) sc.c.used[i] = i / 54 == (size_t)v;
        td_coverage one;
        td_coverage_measure(&one, 0, &sc.c, sc.o);
        assert_int_equal(one.views, 1);
        for (int i = 0; i < 4; i++) assert_int_equal(one.tilted[i], i == away[v]);
    }
    check_near(c.tilt_rad, 0.35, 1e-12);
    check_near(c.nearest_m, 0.4, 1e-12);
    check_near(c.farthest_m, 0.8, 1e-12);
    scene_free(&sc);
    scene_make(&sc, at + 4, 1); /* 11.5 degrees both ways: none */
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    for (int i = 0; i < 4; i++) assert_int_equal(c.tilted[i], 0);
    assert_non_null(strstr(c.missing, "no board is tilted to any side by more than 15 degrees"));
    scene_free(&sc);
}

static void test_words(void **state)
{
    (void)state;
    /* Boards of 200 x 125 mm at 0.45 m cover 240 x 150 px: one in every ninth but the lower right. All are
     * tilted sideways. */
    placed at[9];
    size_t n = 0;
    for (int row = -1; row <= 1; row++)
        for (int column = -1; column <= 1; column++)
            if (row < 1 || column < 1)
                at[n++] = (placed){0.14 * column, 0.11 * row, row ? 0.45 : 0.5, 0, column ? 0.3 : -0.3};
    scene sc;
    td_coverage c;
    scene_make(&sc, at, n);
    for (size_t i = 0; i < 20; i++) sc.c.used[4 * 54 + i] = 0; /* outliers do not count */
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    assert_string_equal(
        c.missing,
        "left: the lower right of the image has no point; no board is tilted up or down by more than "
        "15 degrees; all boards are between 0.46 and 0.52 m, also take some nearer and farther");
    /* Cells: their sum is the number of points in use, and each holds those that lie in it. */
    size_t sum = 0, used = 0, last = 0, counted = 0;
    for (int i = 0; i < TD_COVERAGE_ROWS * TD_COVERAGE_COLUMNS; i++) sum += c.points[i];
    for (size_t i = 0; i < n * 54; i++) used += sc.c.used[i];
    for (size_t v = 0; v < n; v++)
        for (size_t i = 0; i < 54; i++) {
            const double *p = td_observations_get(sc.o, v, 0)->point + 2 * i;
            if (sc.c.used[v * 54 + i] && floor((p[0] + 0.5) * 12 / 640) == 5 &&
                floor((p[1] + 0.5) * 9 / 480) == 1)
                counted++;
        }
    last = c.points[1 * TD_COVERAGE_COLUMNS + 5];
    assert_int_equal(sum, used);
    assert_int_equal(last, counted);
    assert_true(last > 0);
    assert_true(c.image_share > 0.6 && c.image_share < 0.95);
    /* Without a calibration all seen points count, and nothing is said on poses. */
    td_coverage_measure(&c, 0, NULL, sc.o);
    assert_true(isnan(c.nearest_m) && isnan(c.tilt_rad));
    assert_string_equal(c.missing, "left: the lower right of the image has no point");
    scene_free(&sc);
}

static void test_nothing_missing(void **state)
{
    (void)state;
    placed at[11];
    size_t n = 0;
    for (int row = -1; row <= 1; row++)
        for (int column = -1; column <= 1; column++)
            at[n++] = (placed){0.14 * column, 0.11 * row, 0.45, 0, 0.3};
    at[n++] = (placed){0, 0, 0.9, 0.3, 0};
    scene sc;
    td_coverage c;
    scene_make(&sc, at, n);
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    assert_string_equal(c.missing, "");
    scene_free(&sc);
    /* One board in the middle: too many parts to name. */
    scene_make(&sc, at + 4, 1);
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    assert_non_null(strstr(c.missing, "of 9 parts of the image have no point"));
    /* None. */
    td_observations_get(sc.o, 0, 0)->found = false;
    td_coverage_measure(&c, 0, &sc.c, sc.o);
    assert_int_equal(c.views, 0);
    assert_string_equal(c.missing, "left: no view shows the target");
    scene_free(&sc);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_tilts), cmocka_unit_test(test_words),
                                       cmocka_unit_test(test_nothing_missing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
