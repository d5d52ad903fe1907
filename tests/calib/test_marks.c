/* The detector of marks, against rendered scenes of known geometry (marks_scene.h) and on real images.
 *
 * What is proved: coverage and Jacobian of the model against an independent rendering and finite differences;
 * the bias of a disc's image against the pinhole's closed form and brute force; positions at the 0.01 px
 * level for any tilt; lattice, numbering, clicks and words in the cases that users meet. Tolerances are
 * stated at each test. Blind to: lenses whose blur is no Gaussian, printing errors, rolling shutters. That
 * sigma is honest is tested in test_marks_sigma.c. */
#include "calib/marks.h"

#include "calib/marks_internal.h"
#include "tests/calib/marks_scene.h"

static const light PAPER = {.inside = 35, .outside = 190, .noise = 1.5};
static const light PLATE = {.inside = 200, .outside = 40, .noise = 1.5};

static td_camera test_camera(double k1)
{
    return (td_camera){TD_CAMERA_BROWN5, 640, 480, {600, 602, 322, 236, k1, 0.08, 0.001, -0.0005, 0}};
}

/* ---- The model. ---- */

static void coverage_is_that_of_an_independent_rendering(void **state)
{
    (void)state;
    td_normal_table *table = malloc(sizeof *table);
    td_normal_table_init(table);
    const double edge[3][TD_EDGE_PARAMETERS] = {{20.3, 17.7, 9, 2, 6, 0.6, 0, 0},
                                                {19.1, 18.2, 1.1, 0.2, 2.9, 0.8, 0, 0},
                                                {20, 18, 12, -1, 8, 2.1, 0.02, -0.015}};
    for (int e = 0; e < 3; e++) {
        enum { W = 40, H = 37 };
        float cover[W * H];
        td_window window = {0, 0, W, H, NULL};
        td_mark_cover(cover, NULL, &window, edge[e], table);
        double xy[2 * MAX_RIM];
        for (int i = 0; i < MAX_RIM; i++) {
            const double *p = edge[e];
            double t = 2 * PI * i / MAX_RIM, c = cos(t), s = sin(t);
            double r = 1 + p[TD_EDGE_E3C] * cos(3 * t) + p[TD_EDGE_E3S] * sin(3 * t);
            xy[2 * i] = p[TD_EDGE_CX] + r * (p[TD_EDGE_BXX] * c + p[TD_EDGE_BXY] * s);
            xy[2 * i + 1] = p[TD_EDGE_CY] + r * (p[TD_EDGE_BXY] * c + p[TD_EDGE_BYY] * s);
        }
        scene s = scene_new(W, H, edge[e][TD_EDGE_BLUR]);
        scene_add_polygon(&s, xy, MAX_RIM);
        /* The model cuts the Gaussian at 3.5 sigma in x and y, 4.7e-4 each; the rendering is good to 4e-4. */
        for (int i = 0; i < W * H; i++) check_near(cover[i], s.cover[i], 1.5e-3);
        free(s.cover);
    }
    free(table);
}

static void derivatives_are_those_of_the_coverage(void **state)
{
    (void)state;
    enum { W = 40, H = 37 };
    td_normal_table *table = malloc(sizeof *table);
    td_normal_table_init(table);
    const double edge[TD_EDGE_PARAMETERS] = {20.3, 17.7, 9, 2, 6, 0.9, 0.02, -0.015};
    float cover[W * H], plus[W * H], minus[W * H], *d = calloc(W * H * TD_EDGE_PARAMETERS, sizeof *d);
    td_window window = {0, 0, W, H, NULL};
    td_mark_cover(cover, d, &window, edge, table);
    for (int k = 0; k < TD_EDGE_PARAMETERS; k++) {
        /* A step large against the cut of the Gaussian and small against the blur. Cut at 3.5 sigma, the
         * blur's derivative x phi(x) misses 1.3 % of its largest value. */
        double moved[TD_EDGE_PARAMETERS], h = k < TD_EDGE_E3C ? 0.05 : 0.005, largest = 0, off = 0;
        memcpy(moved, edge, sizeof moved);
        moved[k] = edge[k] + h;
        td_mark_cover(plus, NULL, &window, moved, table);
        moved[k] = edge[k] - h;
        td_mark_cover(minus, NULL, &window, moved, table);
        for (int i = 0; i < W * H; i++) {
            double numeric = ((double)plus[i] - (double)minus[i]) / (2 * h);
            largest = fmax(largest, fabs(numeric));
            off = fmax(off, fabs(numeric - d[i * TD_EDGE_PARAMETERS + k]));
        }
        check_less(0.1, largest);
        check_less(off, 0.02 * largest);
        assert_true(off > 0);
    }
    free(d);
    free(table);
}

/* ---- The bias. ---- */

/* Centre of the conic that is the image of a circle: the circle's point conic C, the homography H, H^-T C
 * H^-1. With the dual conic D = C^-1 it is column 3 of H D H^T. */
static void pinhole_bias(double bias[2], const td_camera *camera, const td_pose *pose, double x, double y,
                         double radius)
{
    double r[9], k[9], h[9];
    td_pose_rotation(r, pose);
    td_camera_matrix(k, camera);
    double centre[3] = {x, y, 0}, t[3];
    td_pose_transform(t, pose, centre);
    const double m[9] = {r[0], r[1], t[0], r[3], r[4], t[1], r[6], r[7], t[2]};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            h[3 * i + j] = k[3 * i] * m[j] + k[3 * i + 1] * m[3 + j] + k[3 * i + 2] * m[6 + j];
    const double dual[3] = {radius * radius, radius * radius, -1};
    double c[3] = {0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c[i] += h[3 * i + j] * dual[j] * h[6 + j];
    for (int i = 0; i < 2; i++) bias[i] = c[i] / c[2] - h[3 * i + 2] / h[8];
}

static void bias_is_the_closed_form_under_a_pinhole(void **state)
{
    (void)state;
    td_camera camera = {TD_CAMERA_PINHOLE, 640, 480, {600, 602, 322, 236}};
    const double normal[3] = {0, 0, 1};
    double largest = 0;
    for (int tilt = 0; tilt <= 75; tilt += 15) {
        for (int az = 0; az < 360; az += 60) {
            const double pixel[2] = {100, 400};
            td_pose pose = pose_of_plane(&camera, pixel, 0.5, tilt * PI / 180, az * PI / 180, 1, 0.1, 0.05);
            double bias[2], truth[2], centre[3] = {0.1, 0.05, 0};
            assert_true(td_mark_bias(bias, &camera, &pose, centre, normal, 0.08)); /* a disc of 100 px */
            pinhole_bias(truth, &camera, &pose, 0.1, 0.05, 0.04);
            largest = fmax(largest, hypot(truth[0], truth[1]));
            for (int k = 0; k < 2; k++) check_near(bias[k], truth[k], 1e-8);
        }
    }
    check_less(1, largest); /* px: there was something to correct */
}

/* Midpoint rule over the disc, in equal areas: image position weighted by the area of the cell's image. */
static void brute_force(double bias[2], const td_camera *camera, const td_pose *pose, double x, double y,
                        double radius)
{
    enum { RINGS = 200, SECTORS = 360 };
    double sum[3] = {0}, origin[2], p[3] = {x, y, 0};
    td_pose_transform(p, pose, p);
    assert_true(td_camera_project(origin, NULL, NULL, camera, p));
    for (int i = 0; i < RINGS; i++) {
        for (int j = 0; j < SECTORS; j++) {
            double r = radius * sqrt((i + 0.5) / RINGS), a = 2 * PI * (j + 0.5) / SECTORS, q[3][2],
                   e = 1e-5 * radius;
            const double at[3][2] = {{0, 0}, {e, 0}, {0, e}};
            for (int k = 0; k < 3; k++) {
                double s[3] = {x + r * cos(a) + at[k][0], y + r * sin(a) + at[k][1], 0};
                td_pose_transform(s, pose, s);
                assert_true(td_camera_project(q[k], NULL, NULL, camera, s));
            }
            double weight =
                (q[1][0] - q[0][0]) * (q[2][1] - q[0][1]) - (q[1][1] - q[0][1]) * (q[2][0] - q[0][0]);
            sum[0] += weight * (q[0][0] - origin[0]);
            sum[1] += weight * (q[0][1] - origin[1]);
            sum[2] += weight;
        }
    }
    for (int k = 0; k < 2; k++) bias[k] = sum[k] / sum[2];
}

static void bias_is_brute_force_through_distortion(void **state)
{
    (void)state;
    td_camera camera[2] = {test_camera(-0.3),
                           {TD_CAMERA_FISHEYE, 640, 480, {300, 301, 322, 236, 0.05, -0.02, 0.01, -0.004}}};
    const double normal[3] = {0, 0, 1};
    for (int c = 0; c < 2; c++) {
        for (int tilt = 0; tilt <= 70; tilt += 35) {
            const double pixel[2] = {110, 400};
            td_pose pose = pose_of_plane(&camera[c], pixel, 0.5, tilt * PI / 180, 2, 1, 0.1, 0.05);
            double bias[2], truth[2], centre[3] = {0.1, 0.05, 0};
            assert_true(td_mark_bias(bias, &camera[c], &pose, centre, normal, 0.08));
            brute_force(truth, &camera[c], &pose, 0.1, 0.05, 0.04);
            /* The midpoint rule and its differences are good to 1e-4 px here. */
            for (int k = 0; k < 2; k++) check_near(bias[k], truth[k], 2e-4);
        }
    }
}

static void bias_is_refused_without_an_image(void **state)
{
    (void)state;
    td_camera camera = test_camera(-0.3);
    td_pose pose = td_pose_identity();
    double bias[2] = {7, 7};
    const double behind[3] = {0, 0, -1}, across[3] = {0, 0, 0.01}, folded[3] = {1.6, 0, 1};
    const double normal[3] = {0, 0, 1}, side[3] = {1, 0, 0}, none[3] = {0, 0, 0};
    assert_false(td_mark_bias(bias, &camera, &pose, behind, normal, 0.02));
    assert_false(
        td_mark_bias(bias, &camera, &pose, across, side, 0.1)); /* the disc goes through the camera */
    assert_false(td_mark_bias(bias, &camera, &pose, folded, none, 0.02));
    camera.parameter[5] = 0; /* k2: the model folds at r = 1.05 */
    const double fold[3] = {1.05, 0, 1};
    assert_false(td_mark_bias(bias, &camera, &pose, fold, normal, 0.1));
}

/* ---- Accuracy of one mark. ---- */

typedef struct accuracy {
    double fitted,
        centroid; /* mean distances from the projected centre: corrected fit, plain centre of gravity, px */
    double worst;
    int seen, all;
} accuracy;

/* Twelve discs of `px` diameter (facing the camera) all over a strongly distorted image. */
static accuracy twelve_discs(double px, double tilt, const light *l, td_mark_polarity polarity,
                             td_random *random)
{
    td_camera camera = test_camera(-0.3);
    scene s = scene_new(640, 480, 0.6);
    td_pose pose[12];
    const double distance = 0.6, diameter = px * distance / 600, normal[3] = {0, 0, 1}, zero[3] = {0, 0, 0};
    for (int i = 0; i < 12; i++) {
        const double pixel[2] = {80 + 160 * (i % 4) + 20 * td_random_uniform(random),
                                 80 + 160 * (i / 4) + 20 * td_random_uniform(random)};
        pose[i] = pose_of_plane(&camera, pixel, distance, tilt, 2 * PI * td_random_uniform(random), 0, 0, 0);
        double xy[2 * MAX_RIM];
        scene_add_polygon(&s, xy, rim_of_disc(xy, NULL, &camera, &pose[i], 0, 0, diameter));
    }
    td_image *image = scene_image(&s, l, random);
    td_mark *mark;
    size_t count;
    td_error error;
    check_ok(td_marks_find(&mark, &count, image, polarity, &error), error);
    accuracy a = {.all = 12};
    for (int i = 0; i < 12; i++) {
        double truth[2], bias[2];
        assert_true(td_camera_project(truth, NULL, NULL, &camera, pose[i].t));
        assert_true(td_mark_bias(bias, &camera, &pose[i], zero, normal, diameter));
        for (size_t m = 0; m < count; m++) {
            if (hypot(mark[m].centre[0] - truth[0], mark[m].centre[1] - truth[1]) > 3) continue;
            double off =
                hypot(mark[m].centre[0] - bias[0] - truth[0], mark[m].centre[1] - bias[1] - truth[1]);
            a.fitted += off;
            a.worst = fmax(a.worst, off);
            a.centroid += hypot(mark[m].centroid[0] - truth[0], mark[m].centroid[1] - truth[1]);
            a.seen++;
        }
    }
    assert_int_equal(count, a.seen);
    a.fitted /= a.seen;
    a.centroid /= a.seen;
    free(mark);
    td_image_free(&image);
    return a;
}

/* Without noise what is left is the 8 bits: a rounding error of 0.29 grey levels, on 155. */
static void corrected_fits_are_exact_where_centroids_are_not(void **state)
{
    (void)state;
    td_random random = td_random_seed(7, 1);
    const double diameter[4] = {6, 12, 30, 60};
    const int tilt[4] = {0, 30, 55, 70};
    for (int d = 0; d < 4; d++) {
        for (int t = 0; t < 4; t++) {
            light dark = PAPER, bright = PLATE;
            dark.noise = bright.noise = 0;
            accuracy a = twelve_discs(diameter[d], tilt[t] * PI / 180, &dark, TD_MARK_DARK, &random);
            accuracy b = twelve_discs(diameter[d], tilt[t] * PI / 180, &bright, TD_MARK_ANY, &random);
            print_message(
                "%2.0f px, tilt %2d: fit %.4f px (worst %.4f), centre of gravity %.3f px; seen %d of %d\n",
                diameter[d], tilt[t], (a.fitted + b.fitted) / 2, fmax(a.worst, b.worst),
                (a.centroid + b.centroid) / 2, a.seen + b.seen, a.all + b.all);
            assert_int_equal(a.seen + b.seen, a.all + b.all);
            check_less(a.fitted, 0.01);
            check_less(b.fitted, 0.01);
            check_less(fmax(a.worst, b.worst), 0.03);
            check_less(8 * (a.fitted + b.fitted), a.centroid + b.centroid);
        }
    }
}

/* ---- Grids. ---- */

/* What a test looks at. */
typedef struct view {
    td_camera camera;
    td_target target;
    td_pose camera_from_target;
    td_image *image;
} view;

static td_detection detect(const view *v, const td_click *click, size_t clicks)
{
    td_error error;
    td_detection d;
    check_ok(td_marks_detect(&d, v->image, &v->target, click, clicks, &error), error);
    return d;
}

/* A flat grid with its middle at the middle of the image, its diagonal `fill` of the height when it faces the
 * camera.
 */
static view view_of(td_target target, double fill, double tilt, double azimuth, double roll, const light *l,
                    const bool *hidden, td_random *random)
{
    view v = {.camera = test_camera(-0.25), .target = target};
    const td_target_plane *p = &target.plane[0];
    double x = 0.5 * (p->columns - 1) * p->spacing_m, y = 0.5 * (p->rows - 1) * p->spacing_m;
    const double pixel[2] = {320, 240};
    double distance = 600 * 2 * hypot(x, y) / (fill * 480);
    v.camera_from_target = pose_of_plane(&v.camera, pixel, distance, tilt, azimuth, roll, x, y);
    scene s = scene_new(640, 480, 0.6);
    scene_add_target(&s, &v.camera, &v.camera_from_target, &target, hidden);
    v.image = scene_image(&s, l, random);
    return v;
}

static void true_centre(double pixel[2], const view *v, size_t index)
{
    size_t first;
    const td_target_plane *plane = &v->target.plane[td_target_plane_of(&v->target, index, &first)];
    td_pose pose = td_pose_compose(&v->camera_from_target, &plane->target_from_plane);
    double centre[3] = {(double)((index - first) % (size_t)plane->columns) * plane->spacing_m,
                        (double)((index - first) / (size_t)plane->columns) * plane->spacing_m, 0};
    const double normal[3] = {0, 0, 1};
    double p[3], bias[2];
    td_pose_transform(p, &pose, centre);
    assert_true(td_camera_project(pixel, NULL, NULL, &v->camera, p));
    assert_true(td_mark_bias(bias, &v->camera, &pose, centre, normal, v->target.diameter_m));
    for (int k = 0; k < 2; k++) pixel[k] += bias[k];
}

/* Every seen point is where truth says, within 6 sigma; returns how many are seen. */
static size_t check_points(const td_detection *d, const view *v)
{
    size_t seen = 0;
    assert_int_equal(d->count, td_target_point_count(&v->target));
    for (size_t i = 0; i < d->count; i++) {
        if (d->sigma[i] == 0) {
            assert_true(isnan(d->point[2 * i]) && isnan(d->point[2 * i + 1]));
            continue;
        }
        double truth[2];
        true_centre(truth, v, i);
        check_less(d->sigma[i], 0.1);
        for (int k = 0; k < 2; k++) check_near(d->point[2 * i + k], truth[k], 6 * d->sigma[i] + 0.01);
        seen++;
    }
    return seen;
}

static void finish(view *v, td_detection *d)
{
    td_image_free(&v->image);
    td_detection_free(d);
}

static void grids_are_found_at_any_tilt(void **state)
{
    (void)state;
    check_statistics();
    td_random random = td_random_seed(3, 1);
    const int size[4][2] = {{6, 6}, {7, 5}, {4, 11}, {12, 9}};
    for (int k = 0; k < 4; k++) {
        for (int tilt = 0; tilt <= 70; tilt += 35) {
            for (int az = 0; az < 4; az++) {
                /* Rolls within 40 degrees of upright: the numbering is the target's own. */
                double roll = (az - 1.5) * 26 * PI / 180;
                view v = view_of(flat_target(size[k][0], size[k][1], TD_MARK_DARK), 0.6, tilt * PI / 180,
                                 az * 1.3, roll, &PAPER, NULL, &random);
                td_detection d = detect(&v, NULL, 0);
                if (!d.found) fail_msg("%dx%d, tilt %d: %s", size[k][0], size[k][1], tilt, d.reason);
                assert_string_equal(d.reason, "");
                assert_int_equal(check_points(&d, &v), d.count);
                check_near(d.blur_px, 0.66, 0.05); /* 0.6 and the pixel's own 0.29 */
                finish(&v, &d);
            }
        }
    }
}

/* Index of the point that lies at the place of point `index` when the grid is turned by `turn` quarter turns.
 */
static size_t turned(const td_target_plane *p, size_t index, int turn)
{
    int c = (int)index % p->columns, r = (int)index / p->columns, n = p->columns - 1, m = p->rows - 1;
    const int column[4] = {c, n - r, n - c, r}, row[4] = {r, c, m - r, m - c};
    return (size_t)(row[turn] * p->columns + column[turn]);
}

static void numbering_starts_where_columns_run_right(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int square = 0; square < 2; square++) {
        for (int turn = 0; turn < 4; turn++) {
            /* A quarter turn of a rectangle is no symmetry: within 90 degrees of upright, the numbers are the
             * target's. */
            double off = square ? 30 : 75, roll = (90 * turn + (turn % 2 ? off : -off)) * PI / 180;
            if (!square && turn % 2) continue;
            td_target target = flat_target(square ? 5 : 6, 5, TD_MARK_DARK);
            view v = view_of(target, 0.6, 0.5, 1, roll, &PAPER, NULL, &random);
            td_detection d = detect(&v, NULL, 0);
            assert_true(d.found);
            for (size_t i = 0; i < d.count; i++) {
                double truth[2];
                true_centre(truth, &v, turned(&target.plane[0], i, (4 - turn) % 4));
                check_near(d.point[2 * i], truth[0], 0.1);
                check_near(d.point[2 * i + 1], truth[1], 0.1);
            }
            finish(&v, &d);
        }
    }
}

/* A target seen from behind, as in a mirror, must not be taken for one. */
static void mirror_images_are_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(6, 1);
    view v = view_of(flat_target(6, 5, TD_MARK_DARK), 0.6, 0.5, 1, 0.2, &PAPER, NULL, &random);
    for (int y = 0; y < 480; y++)
        for (int x = 0; x < 320; x++) {
            uint8_t *a = &v.image->data[y * 640 + x], *b = &v.image->data[y * 640 + 639 - x], t = *a;
            *a = *b;
            *b = t;
        }
    td_detection d = detect(&v, NULL, 0);
    assert_true(d.found); /* a symmetric grid's mirror image is a grid ... */
    /* ... but never numbered against the turn from x to y. */
    const double *o = d.point, *c = d.point + 2, *r = d.point + 12;
    assert_true((c[0] - o[0]) * (r[1] - o[1]) - (c[1] - o[1]) * (r[0] - o[0]) > 0);
    finish(&v, &d);
}

static void uneven_light_and_both_polarities(void **state)
{
    (void)state;
    td_random random = td_random_seed(8, 1);
    const light dim[3] = {{.inside = 35, .outside = 230, .vignetting = 0.8, .slope = 0.4, .noise = 2},
                          {.inside = 220, .outside = 30, .vignetting = 0.8, .slope = 0.4, .noise = 2},
                          {.inside = 60, .outside = 100, .vignetting = 0.3, .slope = 0.3, .noise = 6}};
    for (int k = 0; k < 3; k++) {
        for (int any = 0; any < 2; any++) {
            td_mark_polarity polarity = any ? TD_MARK_ANY : k == 1 ? TD_MARK_LIGHT : TD_MARK_DARK;
            view v = view_of(flat_target(8, 7, polarity), 0.95, 0.6, 2, 0.1, &dim[k], NULL, &random);
            td_detection d = detect(&v, NULL, 0);
            if (!d.found) fail_msg("light %d: %s", k, d.reason);
            assert_int_equal(check_points(&d, &v), d.count);
            finish(&v, &d);
        }
    }
}

static void clutter_does_not_matter(void **state)
{
    (void)state;
    td_random random = td_random_seed(9, 1);
    for (int k = 0; k < 4; k++) {
        td_target target = flat_target(6, 6, TD_MARK_DARK);
        view v = {.camera = test_camera(-0.25), .target = target};
        const double pixel[2] = {320, 240};
        v.camera_from_target = pose_of_plane(&v.camera, pixel, 0.55, 0.8, k, 0.2, 0.075, 0.075);
        scene s = scene_new(640, 480, 0.6);
        scene_add_target(&s, &v.camera, &v.camera_from_target, &target, NULL);
        size_t near = 0;
        for (int i = 0; i < 120; i++) {
            /* Blots and strokes between the marks and around, some of a mark's own size; none touches a mark.
             */
            double x = 640 * td_random_uniform(&random), y = 480 * td_random_uniform(&random);
            double a = 1 + 9 * td_random_uniform(&random), b = 1 + 6 * td_random_uniform(&random),
                   clear = 1e9;
            for (size_t m = 0; m < 36; m++) {
                double truth[2];
                true_centre(truth, &v, m);
                clear = fmin(clear, hypot(truth[0] - x, truth[1] - y));
            }
            if (clear < 14 + fmax(a, b)) continue;
            near += clear < 60;
            scene_add_ellipse(&s, x, y, a, b, 3 * td_random_uniform(&random));
        }
        assert_true(near > 3);
        v.image = scene_image(&s, &PAPER, &random);
        td_detection d = detect(&v, NULL, 0);
        if (!d.found) fail_msg("%s", d.reason);
        assert_int_equal(check_points(&d, &v), d.count);
        finish(&v, &d);
    }
}

/* Dirt that touches a mark spoils its blob but not its fit. */
static void dirt_on_a_mark_is_left_out(void **state)
{
    (void)state;
    td_random random = td_random_seed(10, 1);
    view v = {.camera = test_camera(-0.25), .target = flat_target(5, 5, TD_MARK_DARK)};
    const double pixel[2] = {320, 240};
    v.camera_from_target = pose_of_plane(&v.camera, pixel, 0.3, 0.5, 1, 0.2, 0.06, 0.06);
    scene s = scene_new(640, 480, 0.6);
    scene_add_target(&s, &v.camera, &v.camera_from_target, &v.target, NULL);
    for (size_t m = 0; m < 25; m += 6) {
        double truth[2];
        true_centre(truth, &v, m);
        scene_add_ellipse(&s, truth[0] + 19, truth[1] + 3, 6, 2, 0.3);
    }
    v.image = scene_image(&s, &PAPER, &random);
    td_detection d = detect(&v, NULL, 0);
    if (!d.found) fail_msg("%s", d.reason);
    assert_int_equal(check_points(&d, &v), 25);
    finish(&v, &d);
}

static void hidden_marks_are_not_seen(void **state)
{
    (void)state;
    td_random random = td_random_seed(11, 1);
    bool hidden[36] = {false};
    const size_t out[8] = {0, 1, 7, 14, 15, 21, 28, 35};
    for (size_t i = 0; i < 8; i++) hidden[out[i]] = true;
    view v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.7, 1, 0.2, &PAPER, hidden, &random);
    td_detection d = detect(&v, NULL, 0);
    assert_true(d.found);
    assert_string_equal(d.reason, "28 of 36 marks seen");
    assert_int_equal(check_points(&d, &v), 28);
    for (size_t i = 0; i < 36; i++) assert_true((d.sigma[i] == 0) == hidden[i]);
    finish(&v, &d);

    /* A row in the middle: the grid goes on behind the gap. */
    for (size_t i = 0; i < 36; i++) hidden[i] = i / 6 == 2;
    v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.7, 1, 0.2, &PAPER, hidden, &random);
    d = detect(&v, NULL, 0);
    assert_true(d.found);
    assert_int_equal(check_points(&d, &v), 30);
    finish(&v, &d);
}

/* What cannot be told is not guessed. */
static void a_hidden_outer_row_is_not_guessed(void **state)
{
    (void)state;
    td_random random = td_random_seed(12, 1);
    bool hidden[36] = {false};
    for (size_t i = 0; i < 6; i++) hidden[6 * i] = true;
    view v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.5, 1, 0.2, &PAPER, hidden, &random);
    td_detection d = detect(&v, NULL, 0);
    assert_false(d.found);
    print_message("%s\n", d.reason);
    assert_non_null(
        strstr(d.reason, "looked for 6x6 dark marks, saw 30 round marks, all of them in a 5x6 grid"));
    assert_non_null(strstr(d.reason, "outer row"));
    for (size_t i = 0; i < 36; i++) assert_true(d.sigma[i] == 0 && isnan(d.point[2 * i]));
    td_detection_free(&d);

    /* Clicks tell: marks 2, 5, 32, 35 and 20. */
    const size_t marks[5] = {2, 5, 32, 35, 20};
    td_click click[5];
    for (int i = 0; i < 5; i++) {
        click[i].index = marks[i];
        true_centre(click[i].pixel, &v, marks[i]);
        click[i].pixel[0] += 4;
    }
    d = detect(&v, click, 5);
    if (!d.found) fail_msg("%s", d.reason);
    assert_int_equal(check_points(&d, &v), 30);
    finish(&v, &d);
}

/* A board with a column more than the target says, of which only half is in view. */
static void a_larger_grid_is_not_taken(void **state)
{
    (void)state;
    td_random random = td_random_seed(23, 1);
    bool hidden[42] = {false};
    for (size_t i = 3; i < 6; i++) hidden[7 * i] = true;
    view v = view_of(flat_target(7, 6, TD_MARK_DARK), 0.8, 0.5, 1, 0.2, &PAPER, hidden, &random);
    v.target = flat_target(6, 6, TD_MARK_DARK);
    td_detection d = detect(&v, NULL, 0);
    assert_false(d.found);
    assert_non_null(strstr(d.reason, "all of them in a 7x6 grid: is the target's size right?"));
    finish(&v, &d);
}

/* The sharp edge of a shadow lies across the board: what it crosses is known less well, and sigma says so. */
static void a_shadow_on_the_board_does_little(void **state)
{
    (void)state;
    td_random random = td_random_seed(24, 1);
    light bright = PAPER;
    bright.noise = 0;
    view v = view_of(flat_target(5, 5, TD_MARK_DARK), 0.8, 0.5, 1, 0.2, &bright, NULL, &random);
    for (int y = 0; y < 480; y++) {
        for (int x = 0; x < 640; x++) {
            double side = 0.8 * (x - 310) + 0.6 * (y - 250), gain = 0.65 + 0.175 * erfc(-side / 0.8);
            double grey = gain * v.image->data[y * 640 + x] + 1.5 * td_random_normal(&random);
            v.image->data[y * 640 + x] = (uint8_t)fmin(fmax(floor(grey + 0.5), 0), 255);
        }
    }
    td_detection d = detect(&v, NULL, 0);
    assert_true(d.found);
    assert_int_equal(check_points(&d, &v), 25);
    finish(&v, &d);
}

static void marks_cut_by_the_border_are_no_marks(void **state)
{
    (void)state;
    td_random random = td_random_seed(25, 1);
    const double centre[4][2] = {{17, 100.3}, {622, 200.6}, {300.2, 17}, {400.7, 462}};
    scene s = scene_new(640, 480, 0.6);
    for (int i = 0; i < 4; i++) scene_add_ellipse(&s, centre[i][0], centre[i][1], 20, 20, 0);
    td_image *image = scene_image(&s, &PAPER, &random);
    td_mark *mark;
    size_t count;
    td_error error;
    check_ok(td_marks_find(&mark, &count, image, TD_MARK_DARK, &error), error);
    assert_int_equal(count, 0);
    free(mark);
    td_image_free(&image);
}

static void wrong_targets_are_named(void **state)
{
    (void)state;
    td_random random = td_random_seed(13, 1);
    view v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.5, 1, 0.2, &PAPER, NULL, &random);
    const struct {
        int columns, rows;
        td_mark_polarity polarity;
        double diameter;
        bool found;
        const char *words;
    } wrong[6] = {
        {5, 6, TD_MARK_DARK, 0.018, false, "all of them in a 6x6 grid: is the target's size right?"},
        {4, 4, TD_MARK_DARK, 0.018, false, "all of them in a 6x6 grid: is the target's size right?"},
        {7, 6, TD_MARK_DARK, 0.018, false, "all of them in a 6x6 grid: is an outer row hidden"},
        {6, 6, TD_MARK_LIGHT, 0.018, false, "36 dark marks form such a grid: is the polarity right?"},
        {6, 6, TD_MARK_DARK, 0.010, true, "the marks are about 17.9 mm wide, the target says 10 mm"},
        {6, 6, TD_MARK_ANY, 0.018, true, ""}};
    for (int i = 0; i < 6; i++) {
        v.target = flat_target(wrong[i].columns, wrong[i].rows, wrong[i].polarity);
        v.target.diameter_m = wrong[i].diameter;
        td_detection d = detect(&v, NULL, 0);
        print_message("%s\n", d.reason);
        assert_true(d.found == wrong[i].found);
        assert_non_null(strstr(d.reason, wrong[i].words));
        td_detection_free(&d);
    }
    td_image_free(&v.image);
}

/* ---- Clicks. ---- */

/* Clicks on marks of the true grid, each said to be `number[i]`; off by a few pixels. */
static void make_clicks(td_click *click, const view *v, const size_t *mark, const size_t *number, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        true_centre(click[i].pixel, v, mark[i]);
        click[i].pixel[0] += (double)(i % 3) - 1;
        click[i].pixel[1] += (double)(i % 2) * 3;
        click[i].index = number[i];
    }
}

static void clicks_decide_the_numbering(void **state)
{
    (void)state;
    td_random random = td_random_seed(14, 1);
    td_target target = flat_target(6, 6, TD_MARK_DARK);
    for (int turn = 0; turn < 4; turn++) {
        view v = view_of(target, 0.8, 0.9, 1, 0.2, &PAPER, NULL, &random);
        const size_t mark[4] = {0, 5, 30, 35};
        size_t number[4];
        for (int i = 0; i < 4; i++) number[i] = turned(&target.plane[0], mark[i], turn);
        td_click click[4];
        make_clicks(click, &v, mark, number, 4);
        td_detection d = detect(&v, click, 4);
        if (!d.found) fail_msg("%s", d.reason);
        for (size_t i = 0; i < 36; i++) {
            double truth[2];
            size_t k = turned(&target.plane[0], i, turn);
            true_centre(truth, &v, i);
            check_near(d.point[2 * k], truth[0], 0.1);
            check_near(d.point[2 * k + 1], truth[1], 0.1);
        }
        finish(&v, &d);
    }
}

/* Clicks close together say little of the far marks of a distorted grid: the marks found on the way do. */
static void few_clicks_reach_far(void **state)
{
    (void)state;
    td_random random = td_random_seed(26, 1);
    view v = view_of(flat_target(12, 9, TD_MARK_DARK), 0.95, 0.9, 1, 0.2, &PAPER, NULL, &random);
    const size_t mark[4] = {94, 95, 106, 107};
    td_click click[4];
    make_clicks(click, &v, mark, mark, 4);
    td_detection d = detect(&v, click, 4);
    if (!d.found) fail_msg("%s", d.reason);
    assert_int_equal(check_points(&d, &v), 108);
    finish(&v, &d);
}

static void wrong_clicks_are_told(void **state)
{
    (void)state;
    td_random random = td_random_seed(15, 1);
    view v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.6, 1, 0.2, &PAPER, NULL, &random);
    const struct {
        size_t mark[6], number[6], count;
        double shift; /* of the last click, px */
        const char *words;
    } wrong[6] = {
        {{0, 5, 30, 35}, {0, 5, 30, 35}, 4, 30, "click 4 (mark 35 at"},
        {{0, 5, 30, 35}, {5, 0, 35, 30}, 4, 0, "mirror"},
        {{0, 5, 30, 35}, {5, 0, 30, 35}, 4, 0, "are their numbers right?"},
        {{0, 5, 30, 35}, {0, 4, 30, 34}, 4, 0, "are their numbers right?"},
        {{0, 5, 30, 35, 14, 20}, {0, 5, 30, 35, 15, 20}, 6, 0, "click 5 contradicts the others"},
        {{0, 5, 30, 35, 35}, {0, 5, 30, 35, 34}, 5, 0, "clicks 4 and 5 are on the same mark"},
    };
    for (int k = 0; k < 6; k++) {
        td_click click[6];
        make_clicks(click, &v, wrong[k].mark, wrong[k].number, wrong[k].count);
        click[wrong[k].count - 1].pixel[1] += wrong[k].shift;
        td_detection d = detect(&v, click, wrong[k].count);
        print_message("%s\n", d.reason);
        assert_false(d.found);
        assert_non_null(strstr(d.reason, wrong[k].words));
        td_detection_free(&d);
    }
    td_image_free(&v.image);
}

static void impossible_clicks_are_arguments(void **state)
{
    (void)state;
    td_random random = td_random_seed(16, 1);
    view v = view_of(flat_target(6, 6, TD_MARK_DARK), 0.8, 0.6, 1, 0.2, &PAPER, NULL, &random);
    td_click click[10] = {{0, {10, 10}}, {1, {20, 10}}, {2, {30, 10}}, {3, {40, 10}}, {4, {50, 10}}};
    td_detection d;
    td_error error;
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 3, &error), TD_ERROR_ARGUMENT, error,
                "give 4 to 9");
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 10, &error), TD_ERROR_ARGUMENT, error,
                "give 4 to 9");
    check_fails(td_marks_detect(&d, v.image, &v.target, NULL, 4, &error), TD_ERROR_ARGUMENT, error,
                "not given");
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 4, &error), TD_ERROR_ARGUMENT, error,
                "on a line");
    click[3].index = 36;
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 4, &error), TD_ERROR_ARGUMENT, error,
                "no mark 36");
    click[3].index = 1;
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 4, &error), TD_ERROR_ARGUMENT, error,
                "clicks 2 and 4");
    click[3].index = 9;
    click[3].pixel[1] = NAN;
    check_fails(td_marks_detect(&d, v.image, &v.target, click, 4, &error), TD_ERROR_ARGUMENT, error,
                "click 4");
    v.target.kind = TD_TARGET_CHESSBOARD;
    v.target.diameter_m = 0;
    check_fails(td_marks_detect(&d, v.image, &v.target, NULL, 0, &error), TD_ERROR_ARGUMENT, error,
                "chessboard");
    td_image_free(&v.image);
}

/* ---- Several planes. ---- */

/* Two planes at a right angle that meet at an edge half a spacing from both. */
static td_target corner_target(int columns_a, int columns_b, int rows)
{
    td_target t = {.kind = TD_TARGET_MARKS, .plane_count = 2, .diameter_m = 0.018, .polarity = TD_MARK_DARK};
    td_pose second = td_pose_identity();
    const double turn[3] = {0, PI / 2, 0}; /* x of the second plane points towards the camera */
    td_rotation_exp(second.q, turn);
    second.t[0] = (columns_a - 0.5) * 0.03;
    second.t[2] = -0.5 * 0.03;
    t.plane[0] = (td_target_plane){columns_a, rows, 0.03, td_pose_identity()};
    t.plane[1] = (td_target_plane){columns_b, rows, 0.03, second};
    return t;
}

static view corner_view(const td_target *target, double yaw, double roll, const bool *hidden,
                        td_random *random)
{
    view v = {.camera = test_camera(-0.2), .target = *target};
    td_pose pose = td_pose_identity(), turn = td_pose_identity();
    const double about_y[3] = {0, yaw, 0}, about_x[3] = {0.25, 0, 0}, about_z[3] = {0, 0, roll};
    td_rotation_exp(pose.q, about_z);
    td_rotation_exp(turn.q, about_x);
    pose = td_pose_compose(&pose, &turn);
    td_rotation_exp(turn.q, about_y);
    pose = td_pose_compose(&pose, &turn);
    double edge[3] = {(target->plane[0].columns - 0.5) * 0.03, 0.5 * (target->plane[0].rows - 1) * 0.03, 0},
           there[3];
    td_pose_rotate(there, &pose, edge);
    for (int k = 0; k < 3; k++) pose.t[k] = (k == 2 ? 0.45 : 0) - there[k];
    v.camera_from_target = pose;
    scene s = scene_new(640, 480, 0.6);
    scene_add_target(&s, &v.camera, &v.camera_from_target, &v.target, hidden);
    v.image = scene_image(&s, &PAPER, random);
    return v;
}

static void two_planes_are_told_apart(void **state)
{
    (void)state;
    td_random random = td_random_seed(17, 1);
    /* Equal planes: from left to right. At 45 degrees the grids seem to be one of ten columns. */
    const double yaw[3] = {-0.5, -PI / 4, -1.1};
    for (int unequal = 0; unequal < 2; unequal++) {
        for (int k = 0; k < 3; k++) {
            td_target target = corner_target(5, unequal ? 6 : 5, 4);
            view v = corner_view(&target, yaw[k], 0.1, NULL, &random);
            td_detection d = detect(&v, NULL, 0);
            if (!d.found) fail_msg("yaw %.2f: %s", yaw[k], d.reason);
            assert_string_equal(d.reason, "");
            assert_int_equal(check_points(&d, &v), d.count);
            finish(&v, &d);
        }
    }
}

static void a_hidden_plane_is_said(void **state)
{
    (void)state;
    td_random random = td_random_seed(18, 1);
    bool hidden[44];
    for (int i = 0; i < 44; i++) hidden[i] = i >= 20;
    /* Of different planes the one in view is known ... */
    td_target target = corner_target(5, 6, 4);
    view v = corner_view(&target, -PI / 4, 0.1, hidden, &random);
    td_detection d = detect(&v, NULL, 0);
    assert_true(d.found);
    assert_string_equal(d.reason, "20 of 44 marks seen; plane 2 not seen");
    assert_int_equal(check_points(&d, &v), 20);
    finish(&v, &d);
    /* ... of equal planes it is not, unless clicks say so. */
    target = corner_target(5, 5, 4);
    for (int i = 0; i < 40; i++) hidden[i] = i < 20;
    v = corner_view(&target, -PI / 4, 0.1, hidden, &random);
    d = detect(&v, NULL, 0);
    assert_false(d.found);
    print_message("%s\n", d.reason);
    assert_non_null(strstr(d.reason, "1 grid of 5x4 is seen where 2 are expected"));
    td_detection_free(&d);
    const size_t mark[4] = {20, 24, 35, 39};
    td_click click[4];
    make_clicks(click, &v, mark, mark, 4);
    d = detect(&v, click, 4);
    if (!d.found) fail_msg("%s", d.reason);
    assert_int_equal(check_points(&d, &v), 20);
    finish(&v, &d);
}

/* Four clicks on one plane, one on the other: its symmetry follows the click, which here is a half turn. */
static void one_click_chooses_a_symmetry(void **state)
{
    (void)state;
    td_random random = td_random_seed(19, 1);
    td_target target = corner_target(5, 5, 4);
    view v = corner_view(&target, -PI / 4, 0.1, NULL, &random);
    const size_t mark[5] = {0, 4, 15, 19, 39}, number[5] = {0, 4, 15, 19, 20};
    td_click click[5];
    make_clicks(click, &v, mark, number, 5);
    td_detection d = detect(&v, click, 5);
    if (!d.found) fail_msg("%s", d.reason);
    for (size_t i = 0; i < 40; i++) {
        double truth[2];
        true_centre(truth, &v, i < 20 ? i : 59 - i);
        check_near(d.point[2 * i], truth[0], 0.1);
        check_near(d.point[2 * i + 1], truth[1], 0.1);
    }
    finish(&v, &d);
}

/* ---- Images without a target. ---- */

static void empty_and_tiny_images_give_reasons(void **state)
{
    (void)state;
    td_random random = td_random_seed(20, 1);
    const int size[7][2] = {{1, 1}, {3, 3}, {1, 300}, {300, 1}, {16, 16}, {640, 480}, {640, 480}};
    for (int k = 0; k < 7; k++) {
        for (int any = 0; any < 2; any++) {
            scene s = scene_new(size[k][0], size[k][1], 0.6);
            light l = {.inside = 30, .outside = 128, .noise = k == 6 ? 30 : k == 5 ? 0 : 3};
            view v = {.target = flat_target(6, 6, any ? TD_MARK_ANY : TD_MARK_DARK),
                      .image = scene_image(&s, &l, &random)};
            td_detection d = detect(&v, NULL, 0);
            assert_false(d.found);
            assert_int_equal(d.count, 36);
            assert_non_null(strstr(d.reason, "looked for 6x6 "));
            assert_non_null(strstr(d.reason, "saw no round"));
            finish(&v, &d);
        }
    }
}

static void one_mark_is_no_grid(void **state)
{
    (void)state;
    td_random random = td_random_seed(21, 1);
    scene s = scene_new(640, 480, 0.6);
    scene_add_ellipse(&s, 200.3, 150.7, 30, 25, 0.4);
    view v = {.target = flat_target(6, 6, TD_MARK_DARK), .image = scene_image(&s, &PAPER, &random)};
    td_detection d = detect(&v, NULL, 0);
    assert_false(d.found);
    assert_string_equal(d.reason, "looked for 6x6 dark marks, saw 1 round mark and no grid among it");
    finish(&v, &d);
}

/* Marks of any size: from 6 px to most of the image. */
static void large_marks_are_found(void **state)
{
    (void)state;
    td_random random = td_random_seed(22, 1);
    for (int k = 0; k < 2; k++) {
        scene s = scene_new(640, 480, 1.2);
        scene_add_ellipse(&s, 320.25, 240.5, 220, 180, 0.4);
        td_image *image = scene_image(&s, k ? &PLATE : &PAPER, &random);
        td_mark *mark;
        size_t count;
        td_error error;
        check_ok(td_marks_find(&mark, &count, image, TD_MARK_ANY, &error), error);
        assert_int_equal(count, 1);
        check_near(mark[0].centre[0], 320.25, 0.01);
        check_near(mark[0].centre[1], 240.5, 0.01);
        check_near(mark[0].blur, hypot(1.2, 0.29), 0.02);
        check_near(mark[0].inside, k ? PLATE.inside : PAPER.inside, 1);
        check_near(mark[0].outside, k ? PLATE.outside : PAPER.outside, 1);
        free(mark);
        td_image_free(&image);
    }
}

static void colour_images_are_refused(void **state)
{
    (void)state;
    td_image *image;
    td_error error;
    td_mark *mark = (td_mark *)1;
    size_t count = 7;
    check_ok(td_image_new(&image, 20, 20, 3, &error), error);
    check_fails(td_marks_find(&mark, &count, image, TD_MARK_ANY, &error), TD_ERROR_ARGUMENT, error,
                "grey image");
    assert_null(mark);
    assert_int_equal(count, 0);
    td_image_free(&image);
}

/* ---- Real images: ViSP's sheet of 6x6 dark marks (Debian: visp-images-data). ---- */

static void visp_sheets_are_found_whole(void **state)
{
    (void)state;
    const char *folder = "/usr/share/visp-images-data/ViSP-images/calibration";
    for (int k = 1; k <= 4; k++) {
        char path[256];
        snprintf(path, sizeof path, "%s/grid36-%02d.pgm", folder, k);
        FILE *file = fopen(path, "rb");
        if (!file) {
            print_message("skipped: %s is not there (Debian package visp-images-data)\n", path);
            skip();
        }
        fclose(file);
        td_error error;
        view v = {.target = flat_target(6, 6, TD_MARK_DARK)};
        v.target.diameter_m = 0.020;
        check_ok(td_image_read(&v.image, path, 1, &error), error);
        td_detection d = detect(&v, NULL, 0);
        if (!d.found) fail_msg("%s: %s", path, d.reason);
        assert_string_equal(d.reason, "");
        for (size_t i = 0; i < 36; i++) {
            assert_true(d.sigma[i] > 0.005 && d.sigma[i] < 0.05);
            if (i % 6) assert_true(d.point[2 * i] > d.point[2 * i - 2] + 20);
            if (i / 6) assert_true(d.point[2 * i + 1] > d.point[2 * i - 11] + 20);
        }
        finish(&v, &d);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(coverage_is_that_of_an_independent_rendering),
        cmocka_unit_test(derivatives_are_those_of_the_coverage),
        cmocka_unit_test(bias_is_the_closed_form_under_a_pinhole),
        cmocka_unit_test(bias_is_brute_force_through_distortion),
        cmocka_unit_test(bias_is_refused_without_an_image),
        cmocka_unit_test(corrected_fits_are_exact_where_centroids_are_not),
        cmocka_unit_test(grids_are_found_at_any_tilt),
        cmocka_unit_test(numbering_starts_where_columns_run_right),
        cmocka_unit_test(mirror_images_are_refused),
        cmocka_unit_test(uneven_light_and_both_polarities),
        cmocka_unit_test(clutter_does_not_matter),
        cmocka_unit_test(dirt_on_a_mark_is_left_out),
        cmocka_unit_test(hidden_marks_are_not_seen),
        cmocka_unit_test(a_hidden_outer_row_is_not_guessed),
        cmocka_unit_test(a_larger_grid_is_not_taken),
        cmocka_unit_test(a_shadow_on_the_board_does_little),
        cmocka_unit_test(marks_cut_by_the_border_are_no_marks),
        cmocka_unit_test(wrong_targets_are_named),
        cmocka_unit_test(clicks_decide_the_numbering),
        cmocka_unit_test(few_clicks_reach_far),
        cmocka_unit_test(wrong_clicks_are_told),
        cmocka_unit_test(impossible_clicks_are_arguments),
        cmocka_unit_test(two_planes_are_told_apart),
        cmocka_unit_test(a_hidden_plane_is_said),
        cmocka_unit_test(one_click_chooses_a_symmetry),
        cmocka_unit_test(empty_and_tiny_images_give_reasons),
        cmocka_unit_test(one_mark_is_no_grid),
        cmocka_unit_test(large_marks_are_found),
        cmocka_unit_test(colour_images_are_refused),
        cmocka_unit_test(visp_sheets_are_found_whole),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
