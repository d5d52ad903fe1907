/* The sigma of dense disparities on rendered scenes, where the truth is known: 68 +- 5 % of the errors lie
 * within it, of all pixels that both cameras see and in each third by sigma. Of the scenes, boxes and wedges
 * on a plane (datasets/site-polyhedra) were among those that its factors were fitted to; the two of rough
 * ground, with much noise and with little, were not: half of their errors are below 0.1 and 0.05 px. 1280 x
 * 960 px, lenses with distortion, noise, vignetting. The
 * noisy one only with TELEDIMOS_FULL=1.
 *
 * How far errors go together, which the fusion assumes of them, is measured beside: over neighbouring pixels,
 * whose mean over 9 x 9 px must have the variance that td_mean_variance gives it, or a little less (0.65 to
 * 1.15 of it: 1.0 under much noise, 0.8 under little).
 *
 * Blind to: images as poor in contrast as their noise (a third of what is matched there is wrong by whole
 * pixels), real lenses and soil (Motorcycle in test_dense), motion blur. */
#include "recon/fusion_internal.h"
#include "tests/recon/dense_cover.h"
#include "tests/recon/site_scene.h"

enum { STEP = 3 }; /* px between the pixels that are judged */

/* Of errors in sigmas, at every pixel of some patches: the variance of patches' means over that of pixels. */
static double share_of_mean(const site_scene *s, const td_depth_camera *camera, const td_pose *pose,
                            const td_disparity *d)
{
    enum { SIDE = 9, APART = 53 };
    double pixels = 0, square = 0, means = 0, mean_square = 0;
    for (int y = APART; y + SIDE < d->height; y += APART)
        for (int x = APART; x + SIDE < d->width; x += APART) {
            double sum = 0, own = 0, n = 0, p[3];
            for (int k = 0; k < SIDE * SIDE; k++) {
                const int u = x + k % SIDE, v = y + k / SIDE;
                const size_t at = (size_t)v * (size_t)d->width + (size_t)u;
                const double z =
                    ((double)d->value[at] - site_truth(p, s, camera, pose, u, v)) / (double)d->sigma[at];
                if (d->kind[at] != TD_DENSE_MATCHED || !(fabs(z) < 3)) continue;
                n++, sum += z, own += z * z;
            }
            if (n < SIDE * SIDE) continue;
            pixels += n, square += own, means++, mean_square += sum / n * (sum / n);
        }
    return mean_square / means / (square / pixels);
}

static void check_scene(const char *name, td_scene_file *file)
{
    site_scene s = site_scene_of(file);
    td_image *raw[2];
    td_depth_camera *camera;
    td_error error;
    check_ok(td_depth_camera_new(&camera, file->rig, 0, 1, 1.5, 6, &error), error);
    const td_pose pose = site_render(raw, &s, 0);
    td_disparity *d = site_match(camera, raw);
    const size_t pixels = (size_t)d->width * (size_t)d->height;
    dense_cover cover = {.error = malloc(pixels * sizeof(float)), .sigma = malloc(pixels * sizeof(float))};
    for (int y = 2; y < d->height - 2; y += STEP)
        for (int x = 2; x < d->width - 2; x += STEP) {
            const size_t at = (size_t)y * (size_t)d->width + (size_t)x;
            double p[3], truth = site_truth(p, &s, camera, &pose, x, y);
            if (isfinite(truth) && d->kind[at] != TD_DENSE_NONE)
                dense_cover_add(&cover, (float)((double)d->value[at] - truth), d->sigma[at]);
        }
    dense_cover_check(&cover, name);
    const double share = share_of_mean(&s, camera, &pose, d);
    const double said = td_mean_variance(81, td_fusion_options_default().correlation_px);
    print_message("  of a pixel's variance the mean of 9 x 9 keeps %.3f; assumed %.3f\n", share, said);
    check_near(share / said, 0.9, 0.25);
    td_disparity_free(&d);
    for (int k = 0; k < 2; k++) td_image_free(&raw[k]);
    td_depth_camera_free(&camera);
    site_scene_free(&s);
}

static void test_boxes(void **state)
{
    (void)state;
    td_scene_file *file = NULL;
    td_error error;
    check_ok(td_scene_read(&file, TD_SOURCE_DIR "/datasets/site-polyhedra/scene.yaml", &error), error);
    check_scene("boxes", file);
}

static void test_noisy(void **state)
{
    (void)state;
    const char *value = getenv("TELEDIMOS_FULL");
    if (value && !strcmp(value, "1")) check_scene("rough ground, noisy", site_rough(SITE_NOISY));
}

static void test_clean(void **state)
{
    (void)state;
    check_scene("rough ground, clean", site_rough(SITE_CLEAN));
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_boxes), cmocka_unit_test(test_noisy),
                                       cmocka_unit_test(test_clean)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
