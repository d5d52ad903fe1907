/* Is the sigma of a mark honest? Empirical error over predicted sigma of many simulated marks: sizes from 6
 * to 60 px, tilts to 70 degrees, both polarities, distortion; white noise of two levels, and the correlated
 * noise of JPEG.
 *
 * Reference: the projected centre plus td_mark_bias, exact to 1e-4 px. With n errors the ratio scatters by 1
 * / sqrt(2 n) about 1; the bound is the two-sided 99.9 % one, 3.29 of that. Blind to noise that grows with
 * the signal. */
#include "calib/marks.h"
#include "tests/calib/marks_scene.h"

enum { KINDS = 24, DRAWS = 50 };

/* A noiseless mark in a small image. */
typedef struct sample {
    scene cover;
    double truth[2]; /* centre of gravity of its area, px */
    double px;
    bool light;
} sample;

static sample make_sample(double px, double tilt, bool is_light, td_random *random)
{
    td_camera camera = {TD_CAMERA_BROWN5, 640, 480, {600, 602, 322, 236, -0.3, 0.08, 0.001, -0.0005, 0}};
    const double distance = 0.6, normal[3] = {0, 0, 1}, zero[3] = {0, 0, 0};
    const double pixel[2] = {60 + 520 * td_random_uniform(random), 60 + 360 * td_random_uniform(random)};
    td_pose pose = pose_of_plane(&camera, pixel, distance, tilt, 2 * PI * td_random_uniform(random), 0, 0, 0);
    sample s = {.px = px, .light = is_light};
    double bias[2], xy[2 * MAX_RIM];
    assert_true(td_camera_project(s.truth, NULL, NULL, &camera, pose.t));
    assert_true(td_mark_bias(bias, &camera, &pose, zero, normal, px * distance / 600));
    int n = rim_of_disc(xy, NULL, &camera, &pose, 0, 0, px * distance / 600), side = (int)px + 40;
    double corner[2] = {floor(s.truth[0]) - side / 2, floor(s.truth[1]) - side / 2};
    for (int i = 0; i < 2 * n; i++) xy[i] -= corner[i % 2];
    for (int k = 0; k < 2; k++) s.truth[k] += bias[k] - corner[k];
    s.cover = scene_new(side, side, 0.5 + 0.5 * td_random_uniform(random));
    scene_add_polygon(&s.cover, xy, n);
    return s;
}

static void make_samples(sample *s, td_random *random)
{
    const double px[4] = {6, 12, 25, 60}, tilt[3] = {0, 0.7, 1.22};
    for (int i = 0; i < KINDS; i++) s[i] = make_sample(px[i % 4], tilt[i / 4 % 3], i / 12, random);
}

static td_image *noisy(const sample *s, double noise, int jpeg_quality, td_random *random)
{
    light l = {.inside = s->light ? 190 : 45, .outside = s->light ? 50 : 180, .slope = 0.1, .noise = noise};
    scene copy = s->cover;
    size_t pixels = (size_t)copy.width * (size_t)copy.height;
    copy.cover = malloc(pixels * sizeof *copy.cover);
    memcpy(copy.cover, s->cover.cover, pixels * sizeof *copy.cover);
    td_image *image = scene_image(&copy, &l, random);
    if (!jpeg_quality) return image;
    uint8_t *bytes = NULL;
    size_t size = 0;
    td_error error;
    td_image *decoded = NULL;
    check_ok(td_image_encode_jpeg(&bytes, &size, image, jpeg_quality, &error), error);
    check_ok(td_image_decode(&decoded, bytes, size, 1, "simulated", &error), error);
    free(bytes);
    td_image_free(&image);
    return decoded;
}

/* Root mean square of error over sigma, over both coordinates of all marks found; prints it by size. */
static double ratio(const char *name, double noise, int jpeg_quality, size_t *count)
{
    td_random random = td_random_seed(99, 1);
    sample s[KINDS];
    make_samples(s, &random);
    double sum[4] = {0}, all = 0, sigma[4] = {0};
    size_t n[4] = {0};
    *count = 0;
    for (int i = 0; i < KINDS; i++) {
        for (int k = 0; k < DRAWS; k++) {
            td_image *image = noisy(&s[i], noise, jpeg_quality, &random);
            td_mark *mark;
            size_t found;
            td_error error;
            check_ok(td_marks_find(&mark, &found, image, s[i].light ? TD_MARK_LIGHT : TD_MARK_DARK, &error),
                     error);
            for (size_t m = 0; m < found; m++) {
                double dx = mark[m].centre[0] - s[i].truth[0], dy = mark[m].centre[1] - s[i].truth[1];
                if (hypot(dx, dy) > 2) continue;
                double squares = (dx * dx + dy * dy) / (mark[m].sigma * mark[m].sigma);
                sum[i % 4] += squares;
                sigma[i % 4] += mark[m].sigma;
                n[i % 4]++;
            }
            free(mark);
            td_image_free(&image);
        }
        free(s[i].cover.cover);
    }
    for (int d = 0; d < 4; d++) {
        all += sum[d];
        *count += n[d];
    }
    print_message("%s: error/sigma %.3f over %zu marks (6 px: %.3f of %.4f px, 12: %.3f of %.4f, 25: %.3f of "
                  "%.4f, 60: %.3f of %.4f)\n",
                  name, sqrt(all / (2.0 * (double)*count)), *count, sqrt(sum[0] / (2.0 * (double)n[0])),
                  sigma[0] / (double)n[0], sqrt(sum[1] / (2.0 * (double)n[1])), sigma[1] / (double)n[1],
                  sqrt(sum[2] / (2.0 * (double)n[2])), sigma[2] / (double)n[2],
                  sqrt(sum[3] / (2.0 * (double)n[3])), sigma[3] / (double)n[3]);
    return sqrt(all / (2.0 * (double)*count));
}

static void check_honest(const char *name, double noise)
{
    size_t count;
    double r = ratio(name, noise, 0, &count);
    double bound = 3.29 / sqrt(4.0 * (double)count);
    assert_true(count >= 1000);
    check_near(r, 1, bound);
}

static void sigma_is_honest_at_low_noise(void **state)
{
    (void)state;
    check_honest("noise 1.5", 1.5);
}

static void sigma_is_honest_at_high_noise(void **state)
{
    (void)state;
    check_honest("noise 5", 5);
}

/* JPEG's errors are no white noise: what is promised is 0.8 to 1.3. */
static void sigma_is_fair_under_jpeg(void **state)
{
    (void)state;
    size_t count;
    const int quality[3] = {95, 85, 70};
    for (int i = 0; i < 3; i++) {
        char name[32];
        snprintf(name, sizeof name, "noise 3, JPEG %d", quality[i]);
        double r = ratio(name, 3, quality[i], &count);
        assert_true(count >= 1000);
        check_near(r, 1.05, 0.25);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sigma_is_honest_at_low_noise),
        cmocka_unit_test(sigma_is_honest_at_high_noise),
        cmocka_unit_test(sigma_is_fair_under_jpeg),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
