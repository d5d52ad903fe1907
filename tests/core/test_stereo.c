/* Proves: perspective, essential and fundamental matrix and epipolar distances are what their definitions
 * say; triangulation is exact without noise and otherwise the least squares that it claims to be, with the
 * residual that chi-square expects; rectified points of any rig (side by side, one above the other, in either
 * order) lie on one row or column with the disparity that the baseline demands; a rectified image shows what
 * the source image shows, all of both or only what both see, and nothing that no camera saw. Reference: the
 * definitions, and simulated cameras. Tolerances: 1e-9 px where only rounding is left; others stated in
 * place. Blind to: how well a rig was calibrated. */
#include "core/stereo.h"
#include "core/random.h"
#include "tests/check.h"

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

static td_camera make_camera(td_camera_model model, td_random *random)
{
    td_camera c = {.model = model, .width = 320, .height = 240};
    const double p[TD_CAMERA_MODEL_COUNT][TD_CAMERA_MAX_PARAMETERS] = {
        {0},
        {0, 0, 0, 0, -0.28, 0.10, 1e-3, -5e-4, -0.02},
        {0, 0, 0, 0, -0.20, 0.05, 1e-3, -5e-4, 0.01, 0.08, 0.02, 0.01},
        {0, 0, 0, 0, 0.05, -0.02, 0.01, -0.004}};
    memcpy(c.parameter, p[model], sizeof c.parameter);
    c.parameter[0] = between(random, 250, 350);
    c.parameter[1] = c.parameter[0] * between(random, 0.98, 1.02);
    c.parameter[2] = between(random, 150, 170);
    c.parameter[3] = between(random, 110, 130);
    return c;
}

typedef enum arrangement { RIGHT, LEFT, BELOW, ABOVE, ARRANGEMENTS } arrangement;

typedef struct rig {
    td_camera camera[2];
    td_pose second_from_first;
} rig;

/* The second camera to the right of the first, left of it, below or above, a little off that axis and turned
 * by some degrees about every axis. */
static rig make_rig(td_camera_model model, arrangement how, td_random *random)
{
    rig r;
    double centre[3], turn[6] = {0}, length = between(random, 0.05, 0.3);
    r.camera[0] = make_camera(model, random);
    r.camera[1] = make_camera(model, random);
    for (int i = 0; i < 3; i++) centre[i] = length * between(random, -0.15, 0.15);
    centre[how < BELOW ? 0 : 1] = how == RIGHT || how == BELOW ? length : -length;
    for (int i = 0; i < 3; i++) turn[i] = between(random, -0.1, 0.1);
    r.second_from_first = td_pose_exp(turn);
    td_pose_rotate(r.second_from_first.t, &r.second_from_first, centre);
    for (int i = 0; i < 3; i++) r.second_from_first.t[i] = -r.second_from_first.t[i];
    return r;
}

/* A point that both cameras of the rig see, and its pixels. */
static void make_point(double point[3], double pixel[2][2], const rig *r, td_random *random)
{
    for (;;) {
        double ray[3], u[2] = {between(random, 0, 319), between(random, 0, 239)}, z = between(random, 0.8, 6),
                       y[3];
        if (!td_camera_unproject(ray, NULL, NULL, &r->camera[0], u)) continue;
        for (int i = 0; i < 3; i++) point[i] = ray[i] * z / ray[2];
        td_pose_transform(y, &r->second_from_first, point);
        if (!td_camera_project(pixel[0], NULL, NULL, &r->camera[0], point)) continue;
        if (!td_camera_project(pixel[1], NULL, NULL, &r->camera[1], y)) continue;
        if (pixel[1][0] > 0 && pixel[1][0] < 319 && pixel[1][1] > 0 && pixel[1][1] < 239) return;
    }
}

static void test_perspective_matrix(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 1);
    for (int trial = 0; trial < 100; trial++) {
        rig r = make_rig(TD_CAMERA_PINHOLE, (arrangement)(trial % ARRANGEMENTS), &random);
        double p[12], x[3], pixel[2][2], u[3];
        make_point(x, pixel, &r, &random);
        td_perspective_matrix(p, &r.camera[1], &r.second_from_first);
        for (int i = 0; i < 3; i++)
            u[i] = p[4 * i] * x[0] + p[4 * i + 1] * x[1] + p[4 * i + 2] * x[2] + p[4 * i + 3];
        for (int i = 0; i < 2; i++) check_near(u[i] / u[2], pixel[1][i], 1e-9);
        assert_true(u[2] > 0);
        check_near(p[8] * p[8] + p[9] * p[9] + p[10] * p[10], 1, 1e-12);
    }
}

/* y2^T E y1 = 0, E y1 = t x (R y1); F the same in undistorted pixels. */
static void test_epipolar_matrices(void **state)
{
    (void)state;
    td_random random = td_random_seed(2, 1);
    for (int trial = 0; trial < 200; trial++) {
        rig r = make_rig((td_camera_model)(trial % TD_CAMERA_MODEL_COUNT),
                         (arrangement)(trial / 4 % ARRANGEMENTS), &random);
        double x[3], pixel[2][2], y[3], e[9], f[9], norm = 0;
        make_point(x, pixel, &r, &random);
        td_pose_transform(y, &r.second_from_first, x);
        td_essential_matrix(e, &r.second_from_first);
        const double *t = r.second_from_first.t;
        double turned[3];
        td_pose_rotate(turned, &r.second_from_first, x);
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            check_near(e[3 * i] * x[0] + e[3 * i + 1] * x[1] + e[3 * i + 2] * x[2],
                       t[j] * turned[k] - t[k] * turned[j], 1e-12);
        }
        td_fundamental_matrix(f, &r.camera[0], &r.camera[1], &r.second_from_first);
        for (int i = 0; i < 9; i++) norm += f[i] * f[i];
        check_near(norm, 1, 1e-14);
        /* x2^T F x1 through td_undistort_pixel, and K2^T F K1 ~ E. */
        double u[2][3], k1[9], k2[9], product = 0, size = 0;
        for (int c = 0; c < 2; c++) {
            assert_true(td_undistort_pixel(u[c], &r.camera[c], pixel[c]));
            u[c][2] = 1;
        }
        td_camera_matrix(k1, &r.camera[0]);
        td_camera_matrix(k2, &r.camera[1]);
        double back[9] = {0}, scale = 0, size_e = 0, dot = 0;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                product += u[1][i] * f[3 * i + j] * u[0][j];
                size += fabs(u[1][i] * f[3 * i + j] * u[0][j]);
                for (int a = 0; a < 3; a++)
                    for (int b = 0; b < 3; b++)
                        back[3 * i + j] += k2[3 * a + i] * f[3 * a + b] * k1[3 * b + j];
            }
        check_near(product, 0, 1e-10 * size);
        for (int i = 0; i < 9; i++) {
            scale += back[i] * back[i];
            size_e += e[i] * e[i];
            dot += back[i] * e[i];
        }
        check_near(fabs(dot) / sqrt(scale * size_e), 1, 1e-12);
    }
}

/* Distance from the line through the images of two points of the other pixel's ray. */
static double distance_from_ray(const td_camera *camera, const td_pose *camera_from_other,
                                const double ray[3], const double pixel[2])
{
    double u[2][3];
    for (int i = 0; i < 2; i++) {
        double p[3];
        for (int k = 0; k < 3; k++) p[k] = ray[k] * (i ? 5 : 1) / ray[2];
        td_pose_transform(p, camera_from_other, p);
        for (int k = 0; k < 2; k++) u[i][k] = camera->parameter[k] * p[k] / p[2] + camera->parameter[2 + k];
    }
    double dx = u[1][0] - u[0][0], dy = u[1][1] - u[0][1];
    return fabs(dx * (pixel[1] - u[0][1]) - dy * (pixel[0] - u[0][0])) / hypot(dx, dy);
}

static void test_epipolar_distances(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 1);
    for (int trial = 0; trial < 200; trial++) {
        rig r = make_rig(TD_CAMERA_PINHOLE, (arrangement)(trial % ARRANGEMENTS), &random);
        double x[3], pixel[2][2], f[9], d[2], ray[2][3];
        make_point(x, pixel, &r, &random);
        td_fundamental_matrix(f, &r.camera[0], &r.camera[1], &r.second_from_first);
        td_epipolar_distances(d, f, pixel[0], pixel[1]);
        for (int i = 0; i < 2; i++) check_near(d[i], 0, 1e-9);
        for (int c = 0; c < 2; c++) {
            for (int i = 0; i < 2; i++) pixel[c][i] += 3 * td_random_normal(&random);
            assert_true(td_camera_unproject(ray[c], NULL, NULL, &r.camera[c], pixel[c]));
        }
        td_pose first_from_second = td_pose_inverse(&r.second_from_first);
        td_epipolar_distances(d, f, pixel[0], pixel[1]);
        check_near(d[0], distance_from_ray(&r.camera[0], &first_from_second, ray[1], pixel[0]), 1e-8);
        check_near(d[1], distance_from_ray(&r.camera[1], &r.second_from_first, ray[0], pixel[1]), 1e-8);
        assert_true(d[0] > 1e-4 || d[1] > 1e-4);
    }
}

static void test_undistort(void **state)
{
    (void)state;
    td_random random = td_random_seed(4, 1);
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int trial = 0; trial < 50; trial++) {
            td_camera c = make_camera(m, &random);
            double p[3] = {between(&random, -0.4, 0.4), between(&random, -0.3, 0.3), 1}, pixel[2], out[2];
            assert_true(td_camera_project(pixel, NULL, NULL, &c, p));
            assert_true(td_undistort_pixel(out, &c, pixel));
            for (int i = 0; i < 2; i++) check_near(out[i], c.parameter[i] * p[i] + c.parameter[2 + i], 1e-8);
        }
    double out[2] = {-1, -1};
    /* Beyond the fold of a barrel; and beside the camera, where a plane has no image. */
    const td_camera barrel = {TD_CAMERA_BROWN5, 640, 480, {400, 400, 320, 240, -0.5}};
    const td_camera fisheye = {TD_CAMERA_FISHEYE, 640, 480, {150, 150, 320, 240}};
    const double corner[2] = {0, 0}, side[2] = {640, 240}, nan[2] = {NAN, 0};
    assert_false(td_undistort_pixel(out, &barrel, corner));
    assert_false(td_undistort_pixel(out, &fisheye, side));
    assert_false(td_undistort_pixel(out, &fisheye, nan));
    check_near(out[0], -1, 0);
}

static double reprojection_square(const rig *r, const double x[3], double pixel[2][2])
{
    double u[2][2], y[3], sum = 0;
    td_pose_transform(y, &r->second_from_first, x);
    if (!td_camera_project(u[0], NULL, NULL, &r->camera[0], x) ||
        !td_camera_project(u[1], NULL, NULL, &r->camera[1], y))
        return INFINITY;
    for (int c = 0; c < 2; c++)
        for (int i = 0; i < 2; i++) sum += (u[c][i] - pixel[c][i]) * (u[c][i] - pixel[c][i]);
    return sum;
}

static void test_triangulate_exact(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
        for (int trial = 0; trial < 200; trial++) {
            rig r = make_rig(m, (arrangement)(trial % ARRANGEMENTS), &random);
            double x[3], pixel[2][2], found[3] = {1e300, 1e300, 1e300};
            make_point(x, pixel, &r, &random);
            assert_true(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, pixel[0],
                                            pixel[1]));
            for (int i = 0; i < 3; i++) check_near(found[i], x[i], 1e-9 * x[2]);
        }
}

/* Four measured coordinates and three unknowns leave one degree of freedom: the sum of squares over the
 * noise's variance has mean 1 and standard deviation sqrt(2 / trials). And no point in the neighbourhood does
 * better. */
static void test_triangulate_noise(void **state)
{
    (void)state;
    enum { TRIALS = 4000 };
    td_random random = td_random_seed(6, 1);
    double sum = 0, largest_gain = 0;
    const double sigma = 1;
    size_t n = 0;
    for (int trial = 0; trial < TRIALS; trial++) {
        rig r = make_rig((td_camera_model)(trial % TD_CAMERA_MODEL_COUNT),
                         (arrangement)(trial / 4 % ARRANGEMENTS), &random);
        double x[3], pixel[2][2], found[3];
        make_point(x, pixel, &r, &random);
        for (int c = 0; c < 2; c++)
            for (int i = 0; i < 2; i++) pixel[c][i] += sigma * td_random_normal(&random);
        /* At 1 px a far point's rays may meet behind the cameras. */
        if (!td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, pixel[0], pixel[1]))
            continue;
        double cost = reprojection_square(&r, found, pixel);
        sum += cost / (sigma * sigma);
        n++;
        for (int k = 0; k < 60; k++) {
            double near[3], step = found[2] * pow(10, -6 + k / 12);
            for (int i = 0; i < 3; i++)
                near[i] = found[i] + step * td_random_normal(&random) * (i == 2 ? 3 : 1);
            double gain = cost - reprojection_square(&r, near, pixel);
            largest_gain = fmax(largest_gain, gain);
        }
        /* Along the ray, which is the soft direction. */
        for (int k = -40; k <= 40; k++) {
            double near[3], factor = 1 + (k < 0 ? -1 : 1) * pow(10, -6 + fabs((double)k) / 7);
            if (!k || !(factor > 0)) continue;
            for (int i = 0; i < 3; i++) near[i] = found[i] * factor;
            largest_gain = fmax(largest_gain, cost - reprojection_square(&r, near, pixel));
        }
    }
    print_message(
        "%zu of %d triangulated; mean square over its expectation %.4f; best gain nearby %.1e px^2\n", n,
        TRIALS, sum / (double)n, largest_gain);
    assert_true(n > 0.95 * TRIALS);
    check_near(sum / (double)n, 1, 3.3 * sqrt(2. / (double)n));
    check_less(largest_gain, 1e-6);
}

static void test_triangulate_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(7, 1);
    rig r = make_rig(TD_CAMERA_PINHOLE, RIGHT, &random);
    for (int c = 0; c < 2; c++) {
        const double p[4] = {300, 300, 160, 120};
        memcpy(r.camera[c].parameter, p, sizeof p);
    }
    r.second_from_first = td_pose_identity();
    r.second_from_first.t[0] = -0.1;
    double found[3] = {-1, -1, -1};
    const double left[2] = {100, 100}, right[2] = {90, 100}, beyond[2] = {110, 100}, nan[2] = {NAN, 100};
    assert_true(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, left, right));
    check_near(found[2], 300 * 0.1 / 10, 1e-9);
    found[2] = -1;
    assert_false(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, left, left));
    assert_false(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, left, beyond));
    assert_false(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, nan, right));
    /* One camera at the other's place. */
    r.second_from_first.t[0] = 0;
    assert_false(td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, left, right));
    check_near(found[2], -1, 0);

    /* Whatever the pixels, a point that is given lies before both cameras and is finite. */
    size_t given = 0;
    for (int trial = 0; trial < 20000; trial++) {
        if (trial % 100 == 0)
            r = make_rig((td_camera_model)(trial / 100 % TD_CAMERA_MODEL_COUNT), RIGHT, &random);
        double y[3], pixel[2][2];
        for (int c = 0; c < 2; c++) {
            pixel[c][0] = between(&random, 0, 319);
            pixel[c][1] = c && trial % 2 ? pixel[0][1] + td_random_normal(&random) : between(&random, 0, 239);
        }
        if (trial % 3 == 0) pixel[1][0] = pixel[0][0] + between(&random, -1, 0.2); /* far away */
        if (!td_triangulate_pair(found, &r.camera[0], &r.camera[1], &r.second_from_first, pixel[0], pixel[1]))
            continue;
        td_pose_transform(y, &r.second_from_first, found);
        double ray[2][3], ahead[2] = {0};
        for (int c = 0; c < 2; c++) {
            assert_true(td_camera_unproject(ray[c], NULL, NULL, &r.camera[c], pixel[c]));
            for (int i = 0; i < 3; i++) ahead[c] += ray[c][i] * (c ? y : found)[i];
        }
        if (!(ahead[0] > 0 && ahead[1] > 0 && isfinite(found[0] + found[1] + found[2])))
            fail_msg("trial %d: %g %g %g from pixels %g %g and %g %g", trial, found[0], found[1], found[2],
                     pixel[0][0], pixel[0][1], pixel[1][0], pixel[1][1]);
        given++;
    }
    assert_true(given > 1000);
}

static void rectified_pixel(double out[2], const td_rectification *rectification, int index,
                            const double p[3])
{
    double q[3];
    td_pose_transform(q, &rectification->rectified_from[index], p);
    assert_true(td_camera_project(out, NULL, NULL, &rectification->camera, q));
}

static void test_rectify_rows(void **state)
{
    (void)state;
    td_random random = td_random_seed(8, 1);
    double worst = 0;
    for (int trial = 0; trial < 200; trial++) {
        arrangement how = (arrangement)(trial / 4 % ARRANGEMENTS);
        rig r = make_rig((td_camera_model)(trial % TD_CAMERA_MODEL_COUNT), how, &random);
        td_rectification k;
        td_error error = {0};
        memset(&k, 0x7f, sizeof k);
        check_ok(
            td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, between(&random, 0, 1), &error),
            error);
        check_ok(td_camera_check(&k.camera, &error), error);
        assert_int_equal(k.camera.model, TD_CAMERA_PINHOLE);
        assert_int_equal(k.camera.width, 320);
        assert_int_equal(k.camera.height, 240);
        check_near(k.camera.parameter[0], k.camera.parameter[1], 0);
        assert_int_equal(k.vertical, how >= BELOW);
        assert_true((k.baseline_m > 0) == (how == RIGHT || how == BELOW));
        check_near(fabs(k.baseline_m), td_pose_distance(&r.second_from_first), 1e-12);
        for (int i = 0; i < 2; i++) {
            check_near(td_pose_distance(&k.rectified_from[i]), 0, 0);
            check_less(td_pose_angle(&k.rectified_from[i]), 0.5); /* no more than the rig is askew */
        }
        for (int point = 0; point < 30; point++) {
            double x[3], y[3], pixel[2][2], u[2], v[2], q[3];
            make_point(x, pixel, &r, &random);
            td_pose_transform(y, &r.second_from_first, x);
            rectified_pixel(u, &k, 0, x);
            rectified_pixel(v, &k, 1, y);
            td_pose_transform(q, &k.rectified_from[0], x);
            int across = k.vertical ? 0 : 1, along = 1 - across;
            worst = fmax(worst, fabs(u[across] - v[across]));
            check_near(u[across], v[across], 1e-9);
            check_near(u[along] - v[along], k.camera.parameter[0] * k.baseline_m / q[2], 1e-9);
        }
    }
    print_message("rectified rows or columns agree within %.1e px\n", worst);
}

/* The turn is shared: of two cameras that squint by the same angle each is turned by that angle. */
static void test_rectify_shares_the_turn(void **state)
{
    (void)state;
    td_random random = td_random_seed(9, 1);
    rig r = make_rig(TD_CAMERA_PINHOLE, RIGHT, &random);
    const double squint[6] = {0, -0.2, 0, 0, 0, 0};
    td_rectification k;
    td_error error = {0};
    r.second_from_first = td_pose_exp(squint);
    /* The baseline as seen by the squinting first camera. */
    const double centre[3] = {0.2 * cos(0.1), 0, -0.2 * sin(0.1)};
    td_pose_rotate(r.second_from_first.t, &r.second_from_first, centre);
    for (int i = 0; i < 3; i++) r.second_from_first.t[i] = -r.second_from_first.t[i];
    check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 0, &error), error);
    for (int i = 0; i < 2; i++) check_near(td_pose_angle(&k.rectified_from[i]), 0.1, 1e-9);
}

/* Where the border pixels of both cameras fall, in rectified pixels: smallest and largest x, y. */
static void border_in_rectified(double low[2], double high[2], const rig *r, const td_rectification *k)
{
    low[0] = low[1] = INFINITY;
    high[0] = high[1] = -INFINITY;
    for (int c = 0; c < 2; c++)
        for (int i = 0; i < 2 * (320 + 240); i++) {
            double u[2] = {i < 640 ? i % 320 : i % 2 * 319, i < 640 ? i / 320 * 239 : (i - 640) / 2}, ray[3],
                   v[2];
            assert_true(td_camera_unproject(ray, NULL, NULL, &r->camera[c], u));
            rectified_pixel(v, k, c, ray);
            for (int j = 0; j < 2; j++) {
                low[j] = fmin(low[j], v[j]);
                high[j] = fmax(high[j], v[j]);
            }
        }
}

static size_t black_pixels(const rig *r, const td_rectification *k)
{
    size_t black = 0;
    for (int c = 0; c < 2; c++) {
        td_image *white, *out = NULL;
        td_error error = {0};
        check_ok(td_image_new(&white, 320, 240, 1, &error), error);
        memset(white->data, 255, 320 * 240);
        check_ok(td_rectify_image(&out, white, k, c, &r->camera[c], 1, &error), error);
        assert_int_equal(out->width, 320);
        assert_int_equal(out->height, 240);
        for (size_t i = 0; i < 320 * 240; i++) black += out->data[i] != 255;
        td_image_free(&out);
        td_image_free(&white);
    }
    return black;
}

static void test_rectify_zoom(void **state)
{
    (void)state;
    td_random random = td_random_seed(10, 1);
    for (int trial = 0; trial < 40; trial++) {
        rig r = make_rig((td_camera_model)(trial % TD_CAMERA_MODEL_COUNT),
                         (arrangement)(trial / 4 % ARRANGEMENTS), &random);
        td_rectification k;
        td_error error = {0};
        double low[2], high[2], previous = INFINITY;
        check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 0, &error), error);
        assert_int_equal(black_pixels(&r, &k), 0);
        /* It is not much smaller than it must be: a field 10 % wider shows black. */
        td_rectification wider = k;
        for (int i = 0; i < 4; i++)
            wider.camera.parameter[i] =
                i < 2 ? k.camera.parameter[i] * 0.9
                      : k.camera.parameter[i] + 0.1 * ((i == 2 ? 159.5 : 119.5) - k.camera.parameter[i]);
        assert_true(black_pixels(&r, &wider) > 0);

        check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 1, &error), error);
        border_in_rectified(low, high, &r, &k);
        for (int i = 0; i < 2; i++) {
            assert_true(low[i] > -0.5);
            assert_true(high[i] < (i ? 239.5 : 319.5));
        }
        assert_true(high[0] - low[0] > 318 || high[1] - low[1] > 238);
        /* In between the field grows with the zoom, without jumps. */
        for (int i = 0; i <= 100; i++) {
            check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 0.01 * i, &error),
                     error);
            check_less(k.camera.parameter[0], previous * (1 + 1e-9));
            if (i) assert_true(k.camera.parameter[0] > 0.95 * previous);
            previous = k.camera.parameter[0];
        }
    }
}

/* A smooth pattern in rectified directions. */
static double pattern(double x, double y, int channel)
{
    return 127 + 100 * sin(6 * x + channel) * cos(5 * y - channel);
}

/* An image of the pattern in a camera comes back as the pattern: bilinear interpolation of it errs by (1/8)
 * second derivative per direction, 100 (36 + 25) / 300^2 / 8 < 0.01, and both roundings to whole greys by 0.5
 * and a little. */
static void test_rectify_image(void **state)
{
    (void)state;
    td_random random = td_random_seed(11, 1);
    for (int trial = 0; trial < 16; trial++) {
        rig r = make_rig((td_camera_model)(trial % TD_CAMERA_MODEL_COUNT), (arrangement)(trial / 4), &random);
        int channels = trial % 2 ? 3 : 1;
        td_rectification k;
        td_error error = {0};
        check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, trial % 3 * 0.5, &error),
                 error);
        for (int c = 0; c < 2; c++) {
            td_image *seen, *out = NULL, *again = NULL;
            check_ok(td_image_new(&seen, 320, 240, channels, &error), error);
            for (int i = 0; i < 320 * 240; i++) {
                double u[2] = {i % 320, i / 320}, ray[3];
                assert_true(td_camera_unproject(ray, NULL, NULL, &r.camera[c], u));
                td_pose_rotate(ray, &k.rectified_from[c], ray);
                for (int j = 0; j < channels; j++)
                    seen->data[i * channels + j] =
                        (uint8_t)lrint(pattern(ray[0] / ray[2], ray[1] / ray[2], j));
            }
            check_ok(td_rectify_image(&out, seen, &k, c, &r.camera[c], 1, &error), error);
            check_ok(td_rectify_image(&again, seen, &k, c, &r.camera[c], 3, &error), error);
            assert_int_equal(out->channels, channels);
            assert_memory_equal(out->data, again->data, (size_t)(320 * 240 * channels));
            size_t shown = 0;
            for (int i = 0; i < 320 * 240; i++) {
                const double *p = k.camera.parameter, x = (i % 320 - p[2]) / p[0],
                             y = (i / 320 - p[3]) / p[1];
                /* The black around it, and the half pixel of border that repeats the last one, show no
                 * pattern. */
                double ray[3] = {x, y, 1}, u[2];
                td_pose back = td_pose_inverse(&k.rectified_from[c]);
                td_pose_rotate(ray, &back, ray);
                bool inside = td_camera_project(u, NULL, NULL, &r.camera[c], ray) && u[0] >= 0 &&
                              u[0] <= 319 && u[1] >= 0 && u[1] <= 239;
                if (!inside) continue;
                shown++;
                for (int j = 0; j < channels; j++)
                    check_near(out->data[i * channels + j], pattern(x, y, j), 1.05);
            }
            assert_true(shown > 320 * 240 / 3);
            td_image_free(&seen);
            td_image_free(&out);
            td_image_free(&again);
        }
    }
}

/* Beyond the fold of its distortion a lens model maps directions into the image that the lens never saw
 * there: they must stay black. */
static void test_no_ghosts(void **state)
{
    (void)state;
    rig r = {.second_from_first = td_pose_identity()};
    r.second_from_first.t[0] = -0.1;
    const double barrel[TD_CAMERA_MAX_PARAMETERS] = {325, 325, 159.5, 119.5, -0.36};
    for (int c = 0; c < 2; c++) {
        r.camera[c] = (td_camera){.model = TD_CAMERA_BROWN5, .width = 320, .height = 240};
        memcpy(r.camera[c].parameter, barrel, sizeof barrel);
    }
    const double turn[6] = {0, 0.35, 0, 0, 0, 0};
    td_pose turned = td_pose_exp(turn);
    r.second_from_first = td_pose_compose(&turned, &r.second_from_first);
    td_rectification k;
    td_error error = {0};
    check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 1, &error), error);
    /* Shown wider still, so that there is room for ghosts. */
    for (int i = 0; i < 2; i++) k.camera.parameter[i] *= 0.4;
    td_image *white, *out = NULL;
    check_ok(td_image_new(&white, 320, 240, 1, &error), error);
    memset(white->data, 255, 320 * 240);
    check_ok(td_rectify_image(&out, white, &k, 0, &r.camera[0], 1, &error), error);
    td_pose back = td_pose_inverse(&k.rectified_from[0]);
    size_t shown = 0, ghosts = 0;
    for (int i = 0; i < 320 * 240; i++) {
        const double *p = k.camera.parameter;
        double ray[3] = {(i % 320 - p[2]) / p[0], (i / 320 - p[3]) / p[1], 1}, u[2], seen[3];
        if (!out->data[i]) continue;
        shown++;
        td_pose_rotate(ray, &back, ray);
        assert_true(td_camera_project(u, NULL, NULL, &r.camera[0], ray));
        double length = sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]);
        bool same = td_camera_unproject(seen, NULL, NULL, &r.camera[0], u);
        for (int j = 0; j < 3; j++) same = same && fabs(seen[j] - ray[j] / length) < 1e-6;
        ghosts += !same;
    }
    assert_true(shown > 1000);
    assert_int_equal(ghosts, 0);
    td_image_free(&white);
    td_image_free(&out);
}

static void test_refused(void **state)
{
    (void)state;
    td_random random = td_random_seed(12, 1);
    rig r = make_rig(TD_CAMERA_BROWN5, RIGHT, &random);
    td_rectification k;
    td_error error = {0};
    const double zooms[] = {-0.01, 1.01, NAN, INFINITY};
    for (int i = 0; i < 4; i++)
        check_fails(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, zooms[i], &error),
                    TD_ERROR_ARGUMENT, error, "zoom");
    td_pose same = td_pose_identity();
    check_fails(td_rectify(&k, &r.camera[0], &r.camera[1], &same, 0, &error), TD_ERROR_DATA, error,
                "at one place");

    rig wide = make_rig(TD_CAMERA_FISHEYE, RIGHT, &random);
    const double half_globe[TD_CAMERA_MAX_PARAMETERS] = {120, 120, 160, 120};
    for (int c = 0; c < 2; c++) memcpy(wide.camera[c].parameter, half_globe, sizeof half_globe);
    check_fails(td_rectify(&k, &wide.camera[0], &wide.camera[1], &wide.second_from_first, 0, &error),
                TD_ERROR_DATA, error, "too wide");

    /* One behind the other: whatever the baseline's direction becomes, neither looks across it. */
    td_pose ahead = td_pose_identity();
    ahead.t[2] = -0.5;
    ahead.t[0] = 0.01;
    check_fails(td_rectify(&k, &r.camera[0], &r.camera[1], &ahead, 0, &error), TD_ERROR_DATA, error,
                "ahead of");

    /* Looking away from each other, by the same angle from the baseline's normal. */
    const double away[6] = {0, 1.2, 0, 0, 0, 0}, half[6] = {0, 0.6, 0, 0, 0, 0}, along[3] = {-0.1, 0, 0};
    td_pose apart = td_pose_exp(away), half_way = td_pose_exp(half);
    td_pose_rotate(apart.t, &half_way, along);
    check_fails(td_rectify(&k, &r.camera[0], &r.camera[1], &apart, 0, &error), TD_ERROR_DATA, error,
                "nothing in common");

    td_image *small, *out = NULL;
    check_ok(td_image_new(&small, 319, 240, 1, &error), error);
    check_ok(td_rectify(&k, &r.camera[0], &r.camera[1], &r.second_from_first, 0, &error), error);
    check_fails(td_rectify_image(&out, small, &k, 0, &r.camera[0], 1, &error), TD_ERROR_DATA, error,
                "319x240");
    assert_null(out);
    td_image_free(&small);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_perspective_matrix),
                                       cmocka_unit_test(test_epipolar_matrices),
                                       cmocka_unit_test(test_epipolar_distances),
                                       cmocka_unit_test(test_undistort),
                                       cmocka_unit_test(test_triangulate_exact),
                                       cmocka_unit_test(test_triangulate_noise),
                                       cmocka_unit_test(test_triangulate_refused),
                                       cmocka_unit_test(test_rectify_rows),
                                       cmocka_unit_test(test_rectify_shares_the_turn),
                                       cmocka_unit_test(test_rectify_zoom),
                                       cmocka_unit_test(test_rectify_image),
                                       cmocka_unit_test(test_no_ghosts),
                                       cmocka_unit_test(test_refused)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
