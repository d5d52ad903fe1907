/* Depth cameras: rectification by tables, points, and what calibration adds.
 *
 * Tables against td_rectify_image (exact, pixel by pixel): at most 1 grey level off, for the table holds
 * 1/256 px and the noise image's neighbours differ by up to 255 (0.5/256 * 255 in each direction). Points
 * against projection by the rig itself: float's rounding. Calibration against central differences of an
 * estimator that rectifies anew with each moved rig, in three dimensions, anywhere in the image: 1 % of the
 * standard deviation in any direction, which is the grid's interpolation. Blind to: lenses of more than
 * Brown's five terms; a rig's covariance that is itself wrong. */
#include "recon/depth_points.h"

#include <time.h>

#include "core/linalg.h"
#include "tests/check.h"
#include "tests/recon/fusion_scene.h"

static td_image *noise_image(int width, int height, int channels, uint64_t seed)
{
    td_image *image = NULL;
    td_random random = td_random_seed(seed, 0);
    td_error error;
    check_ok(td_image_new(&image, width, height, channels, &error), error);
    for (int i = 0; i < width * height * channels; i++)
        image->data[i] = (uint8_t)td_random_below(&random, 256);
    return image;
}

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void compare_images(int channels)
{
    td_rig *rig = scene_rig(1);
    td_depth_camera *camera;
    td_error error;
    for (int c = 0; c < 2; c++) {
        td_camera *lens = &rig->camera[c].camera;
        lens->width *= 4, lens->height *= 4;
        for (int i = 0; i < 4; i++) lens->parameter[i] *= 4;
    }
    check_ok(td_depth_camera_new(&camera, rig, 0, 1, 1, 20, &error), error);
    td_image *raw[2], *ours[2], *again[2];
    for (int c = 0; c < 2; c++) raw[c] = noise_image(800, 600, channels, (uint64_t)c);
    double best = 1, exact = 1;
    for (int run = 0; run < 3; run++) {
        const double start = seconds();
        check_ok(td_depth_camera_rectify(&ours[0], &ours[1], camera, raw[0], raw[1], 1, &error), error);
        best = fmin(best, seconds() - start);
        if (run < 2) td_image_free(&ours[0]), td_image_free(&ours[1]);
    }
    check_ok(td_depth_camera_rectify(&again[0], &again[1], camera, raw[0], raw[1], 3, &error), error);
    for (int c = 0; c < 2; c++) {
        td_image *reference;
        const double start = seconds();
        check_ok(td_rectify_image(&reference, raw[c], td_depth_camera_rectification(camera), c,
                                  &rig->camera[c].camera, 1, &error),
                 error);
        exact = fmin(exact, 2 * (seconds() - start));
        const size_t n = 800 * 600 * (size_t)channels;
        int worst = 0;
        for (size_t i = 0; i < n; i++) {
            const int off = abs(ours[c]->data[i] - reference->data[i]);
            if (off > worst) worst = off;
        }
        check_less(worst, 2);
        assert_memory_equal(ours[c]->data, again[c]->data, n);
        td_image_free(&reference);
        td_image_free(&ours[c]);
        td_image_free(&again[c]);
        td_image_free(&raw[c]);
    }
    print_message("%d channels, 2 x 800x600: %.2f ms by tables, %.0f ms exactly\n", channels, 1e3 * best,
                  1e3 * exact);
    check_less(2 * best, exact);
    td_depth_camera_free(&camera);
    td_rig_free(&rig);
}

static void test_rectify(void **state)
{
    (void)state;
    compare_images(1);
    compare_images(3);
}

/* A pair that is not the rig's first cameras. */
static td_rig *three_cameras(void)
{
    td_rig *pair = scene_rig(1), *rig = td_rig_new();
    rig->count = 3;
    rig->camera[0] = pair->camera[0];
    rig->camera[1] = pair->camera[0];
    rig->camera[2] = pair->camera[1];
    const double xi[6] = {0.1, -0.05, 0.02, 0.3, -0.1, 0.2};
    rig->camera[1].camera_from_rig = td_pose_exp(xi);
    rig->camera[2].camera_from_rig =
        td_pose_compose(&pair->camera[1].camera_from_rig, &rig->camera[1].camera_from_rig);
    snprintf(rig->camera[0].name, TD_NAME_SIZE, "other");
    const size_t n = td_rig_parameter_count(rig);
    rig->covariance = calloc(n * n, sizeof *rig->covariance);
    const double sigma[15] = {0.2,  0.2,  0.3,  0.3,  1e-3, 2e-3, 1e-4, 1e-4,
                              1e-3, 4e-4, 4e-4, 4e-4, 3e-4, 3e-4, 3e-4};
    for (size_t i = 0; i < n; i++)
        for (size_t k = 15; k < n && i >= 15; k++)
            rig->covariance[i * n + k] =
                sigma[i % 15] * sigma[k % 15] * (i == k ? 1 : 0.3 * cos((double)(i + k)));
    td_rig_free(&pair);
    return rig;
}

/* The point that a rig makes of two pixels as taken: rectified, left pixel and disparity. */
static void estimate(double p[3], const td_rig *rig, int left, int right, const double pixel[2][2])
{
    const td_rig_camera *camera[2] = {&rig->camera[left], &rig->camera[right]};
    const td_pose rig_from_left = td_pose_inverse(&camera[0]->camera_from_rig);
    const td_pose right_from_left = td_pose_compose(&camera[1]->camera_from_rig, &rig_from_left);
    td_rectification r;
    td_error error;
    double at[2][2];
    check_ok(td_rectify(&r, &camera[0]->camera, &camera[1]->camera, &right_from_left, 0, &error), error);
    const double *k = r.camera.parameter;
    for (int c = 0; c < 2; c++) {
        double ray[3];
        assert_true(td_camera_unproject(ray, NULL, NULL, &camera[c]->camera, pixel[c]));
        td_pose_rotate(ray, &r.rectified_from[c], ray);
        for (int i = 0; i < 2; i++) at[c][i] = k[i] * ray[i] / ray[2] + k[2 + i];
    }
    const double z = k[0] * r.baseline_m / (at[0][0] - at[1][0]);
    const double seen[3] = {(at[0][0] - k[2]) / k[0] * z, (at[0][1] - k[3]) / k[1] * z, z};
    const td_pose left_from_rectified = td_pose_inverse(&r.rectified_from[0]);
    const td_pose rig_from_rectified = td_pose_compose(&rig_from_left, &left_from_rectified);
    td_pose_transform(p, &rig_from_rectified, seen);
}

/* Both pixels as taken of a rectified left pixel and a disparity. */
static void taken(double pixel[2][2], const td_depth_camera *camera, const td_rig *rig, int left, int right,
                  int x, int y, float d)
{
    const td_rectification *r = td_depth_camera_rectification(camera);
    const double *k = r->camera.parameter;
    const int index[2] = {left, right};
    for (int c = 0; c < 2; c++) {
        const td_pose back = td_pose_inverse(&r->rectified_from[c]);
        double ray[3] = {(x - (c ? (double)d : 0) - k[2]) / k[0], (y - k[3]) / k[1], 1};
        td_pose_rotate(ray, &back, ray);
        assert_true(td_camera_project(pixel[c], NULL, NULL, &rig->camera[index[c]].camera, ray));
    }
}

static void move(td_rig *rig, size_t parameter, double by)
{
    for (int c = 0; c < rig->count; c++) {
        const size_t first = td_rig_parameter_offset(rig, c);
        const size_t own = (size_t)td_camera_parameter_count(rig->camera[c].camera.model);
        if (parameter < first || parameter >= first + own + 6) continue;
        double xi[6] = {0};
        if (parameter < first + own)
            rig->camera[c].camera.parameter[parameter - first] += by;
        else
            xi[parameter - first - own] = by;
        rig->camera[c].camera_from_rig = td_pose_perturb(&rig->camera[c].camera_from_rig, xi);
    }
}

/* Covariance of the estimate by central differences. */
static void difference_covariance(double s[9], const td_rig *rig, int left, int right, double pixel[2][2])
{
    const size_t n = td_rig_parameter_count(rig);
    double *j = calloc(3 * n, sizeof *j);
    td_error error;
    for (size_t k = 0; k < n; k++) {
        const double step = 1e-2 * sqrt(rig->covariance[k * n + k]);
        double p[2][3];
        if (step == 0) continue;
        for (int side = 0; side < 2; side++) {
            td_rig *moved = td_rig_copy(rig);
            move(moved, k, side ? step : -step);
            estimate(p[side], moved, left, right, (const double(*)[2])pixel);
            td_rig_free(&moved);
        }
        for (size_t i = 0; i < 3; i++) j[i * n + k] = (p[1][i] - p[0][i]) / (2 * step);
    }
    check_ok(td_sandwich(s, j, rig->covariance, 3, n, &error), error);
    free(j);
}

static void check_points(const td_rig *rig, int left, int right)
{
    td_depth_camera *camera;
    td_error error;
    td_random random = td_random_seed(5, 1);
    double worst = 0;
    check_ok(td_depth_camera_new(&camera, rig, left, right, 1, 20, &error), error);
    const td_camera *image = &td_depth_camera_rectification(camera)->camera;
    for (int run = 0; run < 60; run++) {
        const int x = (int)td_random_below(&random, (uint32_t)image->width);
        const int y = (int)td_random_below(&random, (uint32_t)image->height);
        const double depth = 1 / (1 / 19.9 + td_random_uniform(&random) * (1 / 1.01 - 1 / 19.9));
        const float d =
            (float)(image->parameter[0] * td_depth_camera_rectification(camera)->baseline_m / depth);
        double pixel[2][2], p[3], s[9], next[3];
        td_depth_point point;
        assert_true(td_depth_camera_point(&point, camera, x, y, d, 0.2f));
        taken(pixel, camera, rig, left, right, x, y, d);
        estimate(p, rig, left, right, (const double(*)[2])pixel);
        for (int i = 0; i < 3; i++) check_near((double)point.p[i], p[i], 3e-6 * depth);
        /* One sigma more of disparity. */
        taken(pixel, camera, rig, left, right, x, y, d + 0.002f);
        estimate(next, rig, left, right, (const double(*)[2])pixel);
        for (int i = 0; i < 3; i++)
            check_near(fabs((double)point.axis[i]), 100 * fabs(next[i] - p[i]),
                       0.01 * depth * 0.2 / (double)d);
        taken(pixel, camera, rig, left, right, x, y, d);
        difference_covariance(s, rig, left, right, pixel);
        for (int i = 0; i < 20; i++) {
            double v[3], ours = 0, theirs = 0;
            const float *c = point.calibration;
            for (int k = 0; k < 3; k++) v[k] = td_random_normal(&random);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) {
                    static const int at[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
                    ours += v[a] * v[b] * (double)c[at[3 * a + b]];
                    theirs += v[a] * v[b] * s[3 * a + b];
                }
            worst = fmax(worst, fabs(sqrt(ours / theirs) - 1));
        }
    }
    print_message("cameras %d and %d: calibration sigma off by at most %.2f %%\n", left, right, 100 * worst);
    check_less(worst, 0.01);
    td_depth_camera_free(&camera);
}

static void test_points(void **state)
{
    (void)state;
    td_rig *rig = scene_rig(1), *three = three_cameras();
    check_points(rig, 0, 1);
    check_points(three, 1, 2);
    td_rig_free(&rig);
    td_rig_free(&three);
}

static void test_range(void **state)
{
    (void)state;
    td_rig *rig = scene_rig(1);
    td_depth_camera *camera;
    td_error error;
    td_depth_point point;
    int lowest, levels;
    free(rig->covariance);
    rig->covariance = NULL;
    check_ok(td_depth_camera_new(&camera, rig, 0, 1, 2, 10, &error), error);
    td_depth_camera_range(&lowest, &levels, camera);
    const double base = td_depth_camera_rectification(camera)->camera.parameter[0] *
                        td_depth_camera_rectification(camera)->baseline_m;
    assert_true(lowest <= base / 10 && lowest > base / 10 - 1);
    assert_true(lowest + levels - 1 >= base / 2 && lowest + levels - 1 < base / 2 + 1.001);
    assert_true(td_depth_camera_point(&point, camera, 3, 4, (float)(base / 3), 0.1f));
    assert_true(isnan(point.calibration[0]));
    assert_false(td_depth_camera_point(&point, camera, 3, 4, (float)(base / 1.9), 0.1f));
    assert_false(td_depth_camera_point(&point, camera, 3, 4, (float)(base / 10.5), 0.1f));
    assert_false(td_depth_camera_point(&point, camera, 3, 4, NAN, 0.1f));
    assert_false(td_depth_camera_point(&point, camera, 3, 4, -1, 0.1f));
    td_depth_camera_free(&camera);
    td_rig_free(&rig);
}

static void test_refused(void **state)
{
    (void)state;
    td_rig *rig = scene_rig(1);
    td_depth_camera *camera;
    td_image *left = noise_image(200, 150, 1, 1), *right = noise_image(200, 151, 1, 1), *out[2];
    td_error error;
    check_fails(td_depth_camera_new(&camera, rig, 0, 2, 1, 9, &error), TD_ERROR_ARGUMENT, error, "no pair");
    check_fails(td_depth_camera_new(&camera, rig, 1, 1, 1, 9, &error), TD_ERROR_ARGUMENT, error, "no pair");
    check_fails(td_depth_camera_new(&camera, rig, 1, 0, 1, 9, &error), TD_ERROR_ARGUMENT, error,
                "the other way round");
    check_fails(td_depth_camera_new(&camera, rig, 0, 1, 0, 9, &error), TD_ERROR_ARGUMENT, error, "near_m");
    check_fails(td_depth_camera_new(&camera, rig, 0, 1, 1, INFINITY, &error), TD_ERROR_ARGUMENT, error,
                "far_m");
    check_ok(td_depth_camera_new(&camera, rig, 0, 1, 1, 9, &error), error);
    check_fails(td_depth_camera_rectify(&out[0], &out[1], camera, left, right, 1, &error), TD_ERROR_DATA,
                error, "camera 'right': the image is 200x151 px");
    assert_null(out[0]);
    td_depth_camera_free(&camera);
    td_pose *pose = &rig->camera[1].camera_from_rig;
    pose->t[1] = -0.5;
    pose->t[0] = 0;
    check_fails(td_depth_camera_new(&camera, rig, 0, 1, 1, 9, &error), TD_ERROR_UNSUPPORTED, error,
                "one above the other");
    assert_null(camera);
    td_image_free(&left);
    td_image_free(&right);
    td_rig_free(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rectify),
        cmocka_unit_test(test_points),
        cmocka_unit_test(test_range),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
