/* Proves that tags of either border are found, that their corners are where they were drawn and as uncertain
 * as they say, that poses come out with an honest covariance, and that an image which shows something else is
 * told so in words. References: views rendered by render_tags.h through a lens with distortion, with blur,
 * noise and uneven light; ViSP's picture of twelve tags with the poses that ship beside it. Tolerances stand
 * at each bound. Blind to paper that is not flat, to motion blur, to glare, and to a camera's curved
 * response. TELEDIMOS_FULL=1 renders 200 views of each kind. */
#include <stdio.h>

#include "calib/calibrate.h"
#include "calib/tags.h"
#include "core/linalg.h"
#include "tests/calib/render_tags.h"
#include "tests/check.h"

static const double LEAST_CELL = 3; /* px: smaller ones need not be read */

static bool is_full(void)
{
    const char *full = getenv("TELEDIMOS_FULL");
    return full && !strcmp(full, "1");
}

/* What came of the tags that lie inside the image as a whole, their cells 3 px and more. */
typedef struct tally {
    size_t tags, whole, corners;
    double square, normal; /* sums of squared errors, px^2, and of the same over sigma^2, both coordinates */
    double worst;          /* px */
} tally;

/* Height of a cell between opposite sides, px, the lesser of two. */
static double cell_height(const tag_scene *s, const double corner[8])
{
    double least = INFINITY;
    for (int k = 0; k < 4; k++) {
        const double *p = corner + 2 * k, *q = corner + 2 * ((k + 1) % 4), *r = corner + 2 * ((k + 2) % 4);
        double side = hypot(q[0] - p[0], q[1] - p[1]);
        double area = fabs((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]));
        least = fmin(least, area / side);
    }
    return least / s->side;
}

static void count_view(tally *t, const tag_scene *s, const td_detection *d)
{
    for (size_t tag = 0; tag < d->count / 4; tag++) {
        double truth[8];
        int measured = 0;
        bool in = true;
        for (size_t k = 0; k < 4; k++) {
            in = in && tag_scene_truth(truth + 2 * k, s, 4 * tag + k, 4);
            measured += d->sigma[4 * tag + k] > 0;
        }
        if (!in || cell_height(s, truth) < LEAST_CELL) continue;
        t->tags++;
        t->whole += measured == 4;
        for (size_t k = 0; k < 4; k++) {
            size_t i = 4 * tag + k;
            if (!(d->sigma[i] > 0)) continue;
            double x = d->point[2 * i] - truth[2 * k], y = d->point[2 * i + 1] - truth[2 * k + 1];
            t->corners++;
            t->square += x * x + y * y;
            t->normal += (x * x + y * y) / (d->sigma[i] * d->sigma[i]);
            t->worst = fmax(t->worst, hypot(x, y));
        }
    }
}

static void random_views(tally *t, int kind, int views)
{
    td_random random = td_random_seed(11, (uint64_t)kind);
    *t = (tally){0};
    for (int v = 0; v < views; v++) {
        td_target target = kind < 2 ? tag_scene_grid(6, 6, kind + 1) : tag_scene_singles(&random);
        tag_scene s = tag_scene_random(&target, kind == 1, 0.95, &random);
        td_image *image = tag_scene_render(&s, &random);
        td_detection d;
        td_error error = {0};
        check_ok(td_tags_detect(&d, image, &target, &error), error);
        if (!d.found || d.reason[0]) fail_msg("kind %d, view %d: found %d, '%s'", kind, v, d.found, d.reason);
        check_near(d.blur_px, hypot(s.blur, sqrt(2.0 / 12)), 0.1); /* and twice a pixel's width */
        count_view(t, &s, &d);
        td_detection_free(&d);
        td_image_free(&image);
    }
}

/* Recall above 0.99: room for one in a hundred. Corners: RMS of a coordinate below 0.03 px with Kalibr's
 * squares, 0.05 px and (single tags, smaller) 0.07 px for lone corners. RMS over sigma up to 1.35, as what
 * bends edges is left out of sigma; white noise alone has a test of its own. */
static void test_random_views(void **state)
{
    (void)state;
    check_statistics();
    static const char *const name[] = {"aprilgrid, border 1", "aprilgrid, border 2", "single tags"};
    static const double most[] = {0.05, 0.03, 0.07};
    for (int kind = 0; kind < 3; kind++) {
        tally t;
        random_views(&t, kind, is_full() ? 200 : 4);
        double rms = sqrt(t.square / (2 * (double)t.corners)), z = sqrt(t.normal / (2 * (double)t.corners));
        print_message("%s: %zu of %zu tags, RMS %.4f px, RMS over sigma %.3f, worst %.3f px\n", name[kind],
                      t.whole, t.tags, rms, z, t.worst);
        check_less(0.99 * (double)t.tags, (double)t.whole + 0.5);
        check_less(rms, most[kind]);
        check_less(z, 1.35);
        check_less(0.8, z);
    }
}

/* Without distortion, 12 exposures of one view of a board: error over sigma within 0.9 to 1.1, over 12 x 100
 * corners and more, whose ratio scatters by about 1 / sqrt(2 x 2 x 1200) = 1.4 %. */
static void check_sigma(const td_target *target, bool squares, double lean, double blur, double noise)
{
    td_random random = td_random_seed(3, (uint64_t)(10 * blur));
    tag_scene s = tag_scene_random(target, squares, 0.95, &random);
    const double tilt[3] = {lean, -lean / 2, 0.3};
    const double middle[3] = {0.31, 0.31, 0};
    double turned[3];
    tally t = {0};
    s.camera = (td_camera){TD_CAMERA_PINHOLE, 640, 480, {600, 600, 320, 240}};
    td_rotation_exp(s.camera_from_target.q, tilt);
    td_pose_rotate(turned, &s.camera_from_target, middle);
    for (int c = 0; c < 3; c++) s.camera_from_target.t[c] = (c == 2 ? 1.05 : 0) - turned[c];
    s.blur = blur;
    s.noise = noise;
    s.fall = 0;
    float *light = tag_scene_light(&s);
    for (int shot = 0; shot < 12; shot++) {
        td_image *image = tag_scene_shoot(&s, light, &random);
        td_detection d;
        td_error error = {0};
        check_ok(td_tags_detect(&d, image, target, &error), error);
        count_view(&t, &s, &d);
        td_detection_free(&d);
        td_image_free(&image);
    }
    free(light);
    double z = sqrt(t.normal / (2 * (double)t.corners));
    print_message("blur %.1f, noise %.0f: RMS %.4f px, over sigma %.3f, %zu corners\n", blur, noise,
                  sqrt(t.square / (2 * (double)t.corners)), z, t.corners);
    assert_true(t.corners > 1200);
    check_near(z, 1, 0.1);
}

static void test_sigma(void **state)
{
    (void)state;
    check_statistics();
    const td_target lone = tag_scene_grid(6, 6, 1), touched = tag_scene_grid(6, 6, 2);
    check_sigma(&lone, false, 0.3, 0.6, 6);
    check_sigma(&lone, false, 0.5, 1.0, 10);
    check_sigma(&touched, true, 0.3, 0.6, 6);
    check_sigma(&touched, true, 0.5, 1.0, 10);
}

/* ---- words ---- */

/* A board of 4x3 that fills most of the image, a little leant; `shown` as printed, `wanted` as described. */
static td_image *plain_view(const td_target *shown, bool squares)
{
    td_random random = td_random_seed(5, 1);
    tag_scene s = tag_scene_random(shown, squares, 0.8, &random);
    const double tilt[3] = {0.2, -0.3, 0.1};
    td_rotation_exp(s.camera_from_target.q, tilt);
    s.camera = (td_camera){TD_CAMERA_PINHOLE, 640, 480, {600, 600, 320, 240}};
    const double w = shown->plane[0].columns * shown->plane[0].spacing_m,
                 h = shown->plane[0].rows * shown->plane[0].spacing_m;
    const double t[3] = {-w / 2, -h / 2, 600 * fmax(w / 580, h / 420)};
    memcpy(s.camera_from_target.t, t, sizeof t);
    s.blur = 0.7;
    s.noise = 2;
    return tag_scene_render(&s, &random);
}

static void check_words(const td_image *image, const td_target *wanted, bool found, const char *words)
{
    td_detection d;
    td_error error = {0};
    check_ok(td_tags_detect(&d, image, wanted, &error), error);
    if (d.found != found || !strstr(d.reason, words))
        fail_msg("found %d; '%s' lacks '%s'", d.found, d.reason, words);
    if (!words[0]) assert_string_equal(d.reason, "");
    td_detection_free(&d);
}

static void test_borders(void **state)
{
    (void)state;
    td_target one = tag_scene_grid(4, 3, 1), two = tag_scene_grid(4, 3, 2);
    td_image *image = plain_view(&one, false);
    check_words(image, &one, true, "");
    check_words(
        image, &two, false,
        "looked for tag36h11 with a border of 2 cells (Kalibr's), saw 12 tags with a border of 1 cell "
        "(libapriltag's): set border: 1");
    td_image_free(&image);
    image = plain_view(&two, true);
    check_words(image, &two, true, "");
    check_words(image, &one, false,
                "looked for tag36h11 with a border of 1 cell (libapriltag's), saw 12 tags with a border of 2 "
                "cells (Kalibr's): set border: 2");
    td_tag *tag;
    size_t count;
    td_error error = {0};
    check_ok(td_tags_find(&tag, &count, image, "tag36h11", 0, 0, &error), error);
    assert_int_equal(count, 12);
    for (size_t i = 0; i < count; i++) assert_true(tag[i].border == 2 && tag[i].id == (int)i);
    free(tag);
    td_image_free(&image);
}

/* ---- light behind a tag ---- */

/* A tag in the shade before a light sky: light cells and a rim of one cell at 95 of 173 grey levels, dark
 * ones at 8, so that half way between sky and dark is lighter than the rim; x, y in the image, 8 x 8 points
 * a pixel. */
static td_image *tag_before_sky(double shift, td_random *random)
{
    enum { SIZE = 96, FINE = 8 };
    static const double cosine = 0.9976, sine = 0.0698, wide = 6, high = 5;
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    int side;
    td_image *image;
    check_ok(td_tag_cells(cell, &side, "tag36h11", 1, 0, NULL), (td_error){0});
    check_ok(td_image_new(&image, SIZE, SIZE, 1, NULL), (td_error){0});
    for (int i = 0; i < SIZE * SIZE; i++) {
        double sum = 0;
        for (int k = 0; k < FINE * FINE; k++) {
            const double x = i % SIZE - 20 - shift + (k % FINE + 0.5) / FINE - 0.5,
                         y = i / SIZE - 25 - shift + (k / FINE + 0.5) / FINE - 0.5;
            const int c = (int)floor((cosine * x + sine * y) / wide),
                      r = (int)floor((cosine * y - sine * x) / high);
            const bool rim = c < 0 || r < 0 || c >= side || r >= side;
            sum += c < -1 || r < -1 || c > side || r > side ? 173 : rim || cell[r * side + c] ? 85 : 8;
        }
        image->data[i] = (uint8_t)lround(sum / (FINE * FINE) + 1.5 * td_random_normal(random));
    }
    return image;
}

/* Found, and its corners are where they were drawn, wherever they lie between the pixels. 0.2 px is five of
 * their sigma. Half way in grey levels finds 1 of these 8. */
static void test_light_sky(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 1);
    for (int i = 0; i < 8; i++) {
        const double shift = i / 8.0, corner[8] = {0, 0, 48, 0, 48, 40, 0, 40};
        td_tag *tag;
        size_t count;
        td_error error = {0};
        td_image *image = tag_before_sky(shift, &random);
        check_ok(td_tags_find(&tag, &count, image, "tag36h11", 1, 1, &error), error);
        assert_int_equal(count, 1);
        for (int k = 0; k < 4; k++) {
            const double x = corner[2 * k], y = corner[2 * k + 1];
            assert_true(tag->sigma[k] > 0);
            check_near(tag->corner[2 * k], 20 + shift + 0.9976 * x - 0.0698 * y, 0.2);
            check_near(tag->corner[2 * k + 1], 25 + shift + 0.0698 * x + 0.9976 * y, 0.2);
        }
        free(tag);
        td_image_free(&image);
    }
}

static void test_dictionaries(void **state)
{
    (void)state;
    td_target shown = tag_scene_grid(4, 3, 1), wanted = shown;
    strcpy(shown.dictionary, "tag25h9");
    td_image *image = plain_view(&shown, false);
    check_words(image, &shown, true, "");
    check_words(image, &wanted, false,
                "looked for tag36h11, saw 12 tags of tag25h9: set dictionary: tag25h9");
    wanted.border = 2;
    check_words(image, &wanted, false, "saw 12 tags of tag25h9: set dictionary: tag25h9 and border: 1");
    td_image_free(&image);
    strcpy(shown.dictionary, "aruco5x5_100"); /* any dictionary can be read */
    image = plain_view(&shown, false);
    check_words(image, &shown, true, "");
    td_image_free(&image);
    strcpy(shown.dictionary, "tag16h5");
    image = plain_view(&shown, true);
    check_words(image, &shown, true, "");
    td_image_free(&image);
}

static void test_numbers(void **state)
{
    (void)state;
    td_target shown = tag_scene_grid(4, 3, 1), wanted = shown;
    td_error error = {0};
    td_detection d;
    shown.first_id = 40;
    td_image *image = plain_view(&shown, false);
    check_words(image, &wanted, false,
                "saw tags 40, 41, 42, 43, 44, 45, 46, 47, … of tag36h11, but the target has 0 to 11");
    wanted.kind = TD_TARGET_TAGS;
    wanted.tag_count = 1;
    wanted.tag[0] = (td_target_tag){45, 0.088, td_pose_identity()};
    check_words(image, &wanted, true, "but the target has 45");
    wanted.tag[0].id = 600;
    check_fails(td_tags_detect(&d, image, &wanted, &error), TD_ERROR_ARGUMENT, error,
                "tags[0].id: is 600, but tag36h11 has the tags 0 to 586");
    wanted = tag_scene_grid(30, 20, 1);
    check_fails(td_tags_detect(&d, image, &wanted, &error), TD_ERROR_ARGUMENT, error,
                "the target needs the tags 0 to 599, but tag36h11 has the tags 0 to 586");
    strcpy(wanted.dictionary, "tag36h10");
    check_fails(td_tags_detect(&d, image, &wanted, &error), TD_ERROR_ARGUMENT, error,
                "there is no 'tag36h10'");
    td_image_free(&image);
}

static void test_layouts(void **state)
{
    (void)state;
    td_target shown = tag_scene_grid(5, 3, 2), wanted = tag_scene_grid(3, 5, 2);
    td_image *image = plain_view(&shown, true);
    check_words(image, &shown, true, "");
    check_words(image, &wanted, false,
                "the tags lie as on a grid of 5x3, not 3x5: set columns: 5 and rows: 3");
    wanted = shown;
    wanted.order = TD_TAGS_DOWNWARD;
    check_words(image, &wanted, false,
                "the tags are numbered in the other direction; they are numbered from the lowest row, set "
                "order: upward");
    wanted = tag_scene_grid(4, 4, 2);
    check_words(image, &wanted, false, "the tags lie as on a grid of 5 columns, not 4: set columns: 5");
    td_image_free(&image);
    shown.order = TD_TAGS_DOWNWARD;
    image = plain_view(&shown, true);
    check_words(image, &shown, true, "");
    td_image_free(&image);
}

static void test_mirrored(void **state)
{
    (void)state;
    td_target shown = tag_scene_grid(4, 3, 2);
    td_image *image = plain_view(&shown, true);
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width / 2; x++) {
            uint8_t *row = image->data + y * image->width, swap = row[x];
            row[x] = row[image->width - 1 - x];
            row[image->width - 1 - x] = swap;
        }
    check_words(image, &shown, false,
                "the image is mirrored: flipped left to right, it shows 12 tags of tag36h11");
    td_image_free(&image);
}

/* Nothing, very little, and noise of every kind: no crash, no tag, a sentence. */
static void test_nothing(void **state)
{
    (void)state;
    static const int size[][2] = {{1, 1},   {1, 300}, {300, 1}, {15, 15},
                                  {16, 16}, {17, 40}, {33, 20}, {320, 240}};
    td_random random = td_random_seed(8, 8);
    const td_target grid = tag_scene_grid(4, 3, 2);
    for (size_t i = 0; i < sizeof size / sizeof *size; i++)
        for (int kind = 0; kind < 4; kind++) {
            td_image *image = NULL;
            td_error error = {0};
            check_ok(td_image_new(&image, size[i][0], size[i][1], 1, &error), error);
            for (int k = 0; k < size[i][0] * size[i][1]; k++) {
                int x = k % size[i][0], y = k / size[i][0];
                image->data[k] = (uint8_t)(kind == 0   ? 0
                                           : kind == 1 ? (int)(td_random_u32(&random) % 256)
                                           : kind == 2 ? x + y
                                                       : 255 * ((x / 5 + y / 5) % 2));
            }
            check_words(image, &grid, false,
                        "looked for tag36h11 with a border of 2 cells (Kalibr's), saw no tag");
            td_image_free(&image);
        }
    td_image *colour = NULL;
    td_error error = {0};
    td_detection d;
    check_ok(td_image_new(&colour, 64, 64, 3, &error), error);
    check_fails(td_tags_detect(&d, colour, &grid, &error), TD_ERROR_ARGUMENT, error, "grey");
    td_image_free(&colour);
}

/* ---- poses ---- */

static td_tag tag_at(const td_pose *pose, double size, const td_camera *camera, double sigma,
                     td_random *random)
{
    static const double corner[4][2] = {{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};
    td_tag tag = {.border = 1};
    for (int k = 0; k < 4; k++) {
        const double p[3] = {corner[k][0] * size, corner[k][1] * size, 0};
        double x[3];
        td_pose_transform(x, pose, p);
        assert_true(td_camera_project(tag.corner + 2 * k, NULL, NULL, camera, x));
        for (int c = 0; c < 2 && random; c++) tag.corner[2 * k + c] += sigma * td_random_normal(random);
        tag.sigma[k] = sigma;
    }
    return tag;
}

/* Exact corners give the pose back to 1e-9 (rounding, over the tag's weak perspective); noisy ones a pose
 * whose error is chi^2 of 6 degrees by the covariance: over 1000 draws the mean is 6 within 3.3 x sqrt(12 /
 * 1000) = 0.36, the 99.9 % bound. The tag is large and leant, so that the other minimum is far. */
static void test_pose(void **state)
{
    (void)state;
    const td_camera camera = {
        TD_CAMERA_BROWN5, 640, 480, {520, 521, 318, 242, -0.2, 0.04, 0.0003, -0.0005, 0}};
    const double omega[3] = {0.5, -0.3, 0.8};
    td_pose truth = {{1, 0, 0, 0}, {0.05, -0.03, 0.5}}, pose;
    td_random random = td_random_seed(2, 2);
    double covariance[36], information[36], xi[6], weighed[6], ratio, sum = 0;
    td_rotation_exp(truth.q, omega);
    td_tag tag = tag_at(&truth, 0.2, &camera, 0.05, NULL);
    assert_true(td_tag_pose(&pose, covariance, &ratio, &tag, 0.2, &camera));
    td_pose inverse = td_pose_inverse(&truth), off = td_pose_compose(&pose, &inverse);
    check_less(td_pose_angle(&off), 1e-9);
    check_less(td_pose_distance(&off), 1e-9);
    check_less(10, ratio);
    const int draws = is_full() ? 10000 : 1000;
    for (int i = 0; i < draws; i++) {
        tag = tag_at(&truth, 0.2, &camera, 0.05, &random);
        assert_true(td_tag_pose(&pose, covariance, &ratio, &tag, 0.2, &camera));
        off = td_pose_compose(&pose, &inverse);
        td_pose_log(xi, &off);
        assert_int_equal(td_invert_spd(information, covariance, 6, NULL), TD_OK);
        td_multiply(weighed, information, xi, 6, 6, 1);
        for (int k = 0; k < 6; k++) sum += xi[k] * weighed[k];
    }
    print_message("chi^2 of the pose: mean %.3f of 6\n", sum / draws);
    check_near(sum / draws, 6, 3.3 * sqrt(12.0 / draws));
}

/* A small tag seen nearly head on looks the same leant either way: the ratio says so; and of both minima the
 * better one is taken. */
static void test_pose_is_ambiguous(void **state)
{
    (void)state;
    const td_camera camera = {TD_CAMERA_PINHOLE, 640, 480, {600, 600, 320, 240}};
    const double slight[3] = {0.1, 0, 0}, strong[3] = {0.9, 0.2, 0};
    td_random random = td_random_seed(4, 4);
    td_pose truth = {{1, 0, 0, 0}, {0.02, 0.01, 2}}, pose;
    double ratio;
    td_rotation_exp(truth.q, slight);
    td_tag tag = tag_at(&truth, 0.05, &camera, 0.1, &random);
    assert_true(td_tag_pose(&pose, NULL, &ratio, &tag, 0.05, &camera));
    check_less(ratio, 2);
    check_less(1 - 1e-9, ratio);
    truth.t[2] = 0.4;
    for (int turn = 0; turn < 2; turn++) { /* whichever of the two is started from */
        double omega[3] = {turn ? -strong[0] : strong[0], strong[1], strong[2]};
        td_rotation_exp(truth.q, omega);
        tag = tag_at(&truth, 0.08, &camera, 0.02, &random);
        assert_true(td_tag_pose(&pose, NULL, &ratio, &tag, 0.08, &camera));
        td_pose inverse = td_pose_inverse(&truth), off = td_pose_compose(&pose, &inverse);
        check_less(td_pose_angle(&off), 0.01);
        check_less(3, ratio);
    }
    for (int k = 0; k < 4; k++) tag.corner[2 * k] = tag.corner[2 * k + 1] = 100; /* no square at all */
    assert_false(td_tag_pose(&pose, NULL, NULL, &tag, 0.08, &camera));
}

/* ---- a real picture ---- */

#define VISP "/usr/share/visp-images-data/ViSP-images/AprilTag/"

/* ViSP's picture of twelve tags of 53 mm with its camera. The corners and poses beside it are ViSP's own,
 * made of libapriltag's corners, whose pixels are counted from half a pixel further left and up: fed with
 * those corners our poses equal them (0.5 mm, 0.1 degrees). From our own corners, moved by that half pixel,
 * all are within 1 degree and 3 mm, eleven of them within 2 mm: the corners of the two differ by 0.2 px and
 * more on this glossy paper, and 0.3 px of a tag 58 px wide at 0.48 m are 2.5 mm. */
static void compare_poses(FILE *corners, FILE *poses, const td_tag *tag)
{
    const td_camera camera = {
        TD_CAMERA_PINHOLE, 640, 480, {615.1674805, 615.1675415, 312.1889954, 243.4373779}};
    const td_pose flip = {{0, 1, 0, 0}, {0, 0, 0}}; /* ViSP's y points up, its z out of the tag */
    double v[8], g[6], worst[2] = {0, 0};
    int id, again, near = 0, lines = 0;
    for (; fscanf(corners, " 36h11_id:_%d %lf %lf %lf %lf %lf %lf %lf %lf", &id, v, v + 1, v + 2, v + 3,
                  v + 4, v + 5, v + 6, v + 7) == 9 &&
           fscanf(poses, " 36h11_id:_%d %lf %lf %lf %lf %lf %lf", &again, g, g + 1, g + 2, g + 3, g + 4,
                  g + 5) == 7;
         lines++) {
        assert_int_equal(id, again);
        assert_int_equal(tag[lines].id, id);
        td_pose truth = {{1, 0, 0, 0}, {g[0], g[1], g[2]}}, pose;
        td_rotation_exp(truth.q, g + 3);
        truth = td_pose_compose(&truth, &flip);
        const td_pose inverse = td_pose_inverse(&truth);
        for (int own = 0; own < 2; own++) {
            td_tag used = tag[lines];
            for (int k = 0; k < 8; k++) used.corner[k] += 0.5;
            for (int k = 0; k < 4 && !own; k++) { /* lower left first, and row before column */
                used.corner[2 * k] = v[2 * (3 - k) + 1];
                used.corner[2 * k + 1] = v[2 * (3 - k)];
                used.sigma[k] = 1;
            }
            assert_true(td_tag_pose(&pose, NULL, NULL, &used, 0.053, &camera));
            td_pose off = td_pose_compose(&pose, &inverse);
            double mm = 1e3 * hypot(hypot(pose.t[0] - g[0], pose.t[1] - g[1]), pose.t[2] - g[2]);
            double degrees = td_pose_angle(&off) * 57.29577951;
            check_less(degrees, own ? 1 : 0.1);
            check_less(mm, own ? 3 : 0.5);
            near += own && mm < 2;
            if (own) worst[0] = fmax(worst[0], mm), worst[1] = fmax(worst[1], degrees);
        }
    }
    print_message("12 tags: %d within 2 mm, worst %.2f mm, %.2f degrees\n", near, worst[0], worst[1]);
    assert_int_equal(lines, 12);
    assert_true(near >= 11);
}

static void test_real_tags(void **state)
{
    (void)state;
    FILE *corners = fopen(VISP "ground_truth_detection.txt", "r"),
         *poses = fopen(VISP "ground_truth_pose.txt", "r");
    td_image *image = NULL;
    td_tag *tag = NULL;
    td_error error = {0};
    size_t count = 0;
    if (corners && poses) {
        check_ok(td_image_read(&image, VISP "AprilTag.pgm", 1, &error), error);
        check_ok(td_tags_find(&tag, &count, image, "tag36h11", 0, 0, &error), error);
        assert_int_equal(count, 12);
        compare_poses(corners, poses, tag);
    }
    if (corners) fclose(corners);
    if (poses) fclose(poses);
    free(tag);
    td_image_free(&image);
    if (!count) {
        print_message("Debian's visp-images-data is not installed: skipped\n");
        skip();
    }
}

/* ---- a calibration ---- */

/* A camera calibrated with tags' corners, drawn exactly and moved by noise of 0.1 px, 15 views: the RMS is
 * that of the noise, 0.1 sqrt 2 px within a tenth, and the focal length within 0.5 %. That its sigma is
 * honest is proved with chessboards; here, that the solver takes the planes, the numbers and the bulge of
 * tags. */
static void check_calibration(const td_target *target)
{
    enum { SHOTS = 15 };
    td_random random = td_random_seed(21, 1);
    td_observations *o = NULL;
    td_calibration *c = NULL;
    td_error error = {0};
    const double truth[9] = {600, 601.2, 321.3, 238.4, -0.1, 0.02, 0.0004, -0.0006, 0};
    check_ok(td_observations_new(&o, target, 1, SHOTS, &error), error);
    o->camera[0] = (td_observed_camera){"camera", TD_CAMERA_BROWN5, 640, 480};
    for (size_t v = 0; v < SHOTS; v++) {
        tag_scene s = tag_scene_random(target, false, 0.95, &random);
        memcpy(s.camera.parameter, truth, sizeof truth);
        td_detection *d = td_observations_get(o, v, 0);
        snprintf(o->view_name[v], sizeof o->view_name[v], "%zu", v);
        for (size_t i = 0; i < d->count; i++) {
            double seen[2];
            if (!tag_scene_truth(seen, &s, i, 0)) continue;
            for (size_t k = 0; k < 2; k++) d->point[2 * i + k] = seen[k] + 0.1 * td_random_normal(&random);
            d->sigma[i] = 0.1;
        }
        d->found = true;
    }
    check_ok(td_calibrate(&c, o, NULL, &error), error);
    print_message("calibrated: RMS %.4f px, fx %.2f\n", c->rms_px, c->rig->camera[0].camera.parameter[0]);
    check_near(c->rms_px, 0.1 * sqrt(2), 0.014);
    check_near(c->rig->camera[0].camera.parameter[0], 600, 3);
    td_calibration_free(&c);
    td_observations_free(&o);
}

static void test_calibration(void **state)
{
    (void)state;
    td_random random = td_random_seed(22, 1);
    const td_target grid = tag_scene_grid(6, 5, 2), singles = tag_scene_singles(&random);
    check_calibration(&grid);
    check_calibration(&singles);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_random_views),      cmocka_unit_test(test_sigma),
        cmocka_unit_test(test_borders),           cmocka_unit_test(test_light_sky),
        cmocka_unit_test(test_dictionaries),      cmocka_unit_test(test_numbers),
        cmocka_unit_test(test_layouts),           cmocka_unit_test(test_mirrored),
        cmocka_unit_test(test_nothing),           cmocka_unit_test(test_pose),
        cmocka_unit_test(test_pose_is_ambiguous), cmocka_unit_test(test_real_tags),
        cmocka_unit_test(test_calibration),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
