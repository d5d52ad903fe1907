/* Proves: td_charuco_detect finds the corners of boards that are turned, leant, blurred, noisy, bent by the
 * lens and partly out of view, in their order, nearly all of those in view and none in a wrong place, as
 * exactly as a chessboard's, with a sigma that is the scatter; of every dictionary and both kinds; a part of
 * a board suffices; and what is wrong with a board or its description is said.
 *
 * Reference: the board's drawing (test_target_drawing.c judges that) seen by a camera of known pose. The
 * bounds: RMS 0.03 px is three times what the noise alone does here; a wrong number or place would be off by
 * 7 px or more, so 0.3 px shows it. The sigma is asked within 20 %: 30 views hold over 1000 corners, whose
 * mean square is good to 3 %, and the common figure of a view to 10 %. Blind to: printing, glare, uneven
 * light. */
#include "calib/charuco.h"
#include "core/parallel.h"
#include "tests/calib/charuco_scene.h"
#include "tests/check.h"

static charuco_scene scene_of(td_target target)
{
    charuco_scene s = {
        .target = target, .camera = charuco_camera(), .blur = 0.6, .noise = 2, .dark = 30, .light = 210};
    td_error error;
    check_ok(charuco_draw(&s, &error), error);
    s.camera_from_target = td_pose_identity();
    return s;
}

/* Straight in front, wholly in view. */
static void stand_in_front(charuco_scene *s)
{
    const td_target_plane *p = s->target.plane;
    const double xi[2][6] = {
        {0.1, -0.15, 0.05, 0, 0, 0},
        {0, 0, 0, -p->spacing_m * (p->columns - 1) / 2, -p->spacing_m * (p->rows - 1) / 2, 0}};
    const td_pose lean = td_pose_exp(xi[0]), centre = td_pose_exp(xi[1]);
    s->camera_from_target = td_pose_compose(&lean, &centre);
    s->camera_from_target.t[2] += 0.4;
}

static td_image *photograph(const charuco_scene *s, uint64_t seed)
{
    td_random random = td_random_seed(seed, 3);
    td_image *image = NULL;
    td_error error;
    check_ok(charuco_photograph(&image, s, &random, &error), error);
    return image;
}

static td_detection detect(const td_image *image, const td_target *target)
{
    td_detection d;
    td_error error;
    memset(&d, 0xff, sizeof d);
    check_ok(td_charuco_detect(&d, image, target, &error), error);
    assert_int_equal(d.count, td_target_point_count(target));
    return d;
}

typedef struct tally {
    size_t there, found, wrong, all; /* corners in view; of these found; far off; found anywhere */
    double square, chi_square;       /* sums over `all` less `wrong`, of both coordinates */
} tally;

static void count(tally *t, const charuco_scene *s, const td_detection *d)
{
    for (size_t k = 0; k < d->count; k++) {
        double truth[2];
        const bool inside = charuco_truth(truth, s, k, 6), seen = d->sigma[k] > 0;
        t->there += inside;
        if (!seen) continue;
        const double x = d->point[2 * k] - truth[0], y = d->point[2 * k + 1] - truth[1], off = x * x + y * y;
        t->all++;
        t->found += inside;
        if (sqrt(off) > 0.3) {
            t->wrong++;
            continue;
        }
        t->square += off;
        t->chi_square += off / (d->sigma[k] * d->sigma[k]);
    }
}

static void random_views(void **state)
{
    (void)state;
    check_statistics();
    const char *full = getenv("TELEDIMOS_FULL");
    const int views = full && strcmp(full, "1") == 0 ? 240 : 30;
    charuco_scene s = scene_of(charuco_target(9, 6, "aruco4x4_50"));
    td_random random = td_random_seed(11, 1);
    tally t = {0};
    int found = 0;
    for (int i = 0; i < views; i++) {
        const double distance = 0.25 + 0.5 * td_random_uniform(&random);
        s.camera_from_target = charuco_pose(&s, distance, 0.8, &random);
        s.blur = 0.3 + 0.7 * td_random_uniform(&random);
        s.noise = 1 + 3 * td_random_uniform(&random);
        td_image *image = photograph(&s, (uint64_t)i);
        td_detection d = detect(image, &s.target);
        found += d.found;
        count(&t, &s, &d);
        td_detection_free(&d);
        td_image_free(&image);
    }
    const double corners = (double)(t.all - t.wrong), rms = sqrt(t.square / 2 / corners);
    const double recall = (double)t.found / (double)t.there, ratio = sqrt(t.chi_square / 2 / corners);
    printf("%d of %d views found, %.2f %% of %zu corners in view, %zu wrong, RMS %.4f px, error over sigma "
           "%.3f\n",
           found, views, 100 * recall, t.there, t.wrong, rms, ratio);
    assert_int_equal(found, views);
    assert_int_equal(t.wrong, 0);
    check_less(0.97, recall);
    check_less(rms, 0.03);
    check_near(ratio, 1, 0.2);
    td_image_free(&s.board);
}

/* All corners, in place. */
static void check_whole(const td_target *target)
{
    charuco_scene s = scene_of(*target);
    stand_in_front(&s);
    td_image *image = photograph(&s, 5);
    td_detection d = detect(image, target);
    tally t = {0};
    count(&t, &s, &d);
    if (!d.found || t.wrong || t.all != d.count)
        fail_msg("%s, legacy %d: %zu of %zu, %zu wrong; %s", target->dictionary, target->legacy, t.all,
                 d.count, t.wrong, d.reason);
    check_near(d.blur_px, hypot(0.6, 0.29), 0.15);
    td_detection_free(&d);
    td_image_free(&image);
    td_image_free(&s.board);
}

static void every_dictionary_and_kind(void **state)
{
    (void)state;
    static const char *const dictionary[] = {"aruco4x4_100",  "aruco5x5_50",    "aruco6x6_250",
                                             "aruco7x7_1000", "aruco_original", "tag36h11"};
    for (int i = 0; i < 6; i++) {
        td_target t = charuco_target(6, 5, dictionary[i]);
        t.legacy = i % 2;
        t.first_id = i == 2 ? 100 : 0;
        check_whole(&t);
    }
}

/* The board behind a sheet with a hole three squares wide. */
static void a_part_suffices(void **state)
{
    (void)state;
    charuco_scene s = scene_of(charuco_target(9, 6, "aruco4x4_50"));
    double a[2], b[2];
    stand_in_front(&s);
    td_image *image = photograph(&s, 6);
    assert_true(charuco_truth(a, &s, 11, 0) && charuco_truth(b, &s, 31, 0)); /* (2, 1) and (4, 3) */
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++)
            if (x < a[0] - 25 || x > b[0] + 25 || y < a[1] - 25 || y > b[1] + 25)
                image->data[y * image->width + x] = 120;
    td_detection d = detect(image, &s.target);
    tally t = {0};
    count(&t, &s, &d);
    if (!d.found) fail_msg("%s", d.reason);
    printf("a part: %zu corners, %zu wrong\n", t.all, t.wrong);
    assert_int_equal(t.wrong, 0);
    assert_true(t.all >= 7 && t.all <= 9);
    td_detection_free(&d);
    td_image_free(&image);
    td_image_free(&s.board);
}

static void check_reason(const td_image *image, td_target target, const char *words)
{
    td_detection d = detect(image, &target);
    if (d.found || !strstr(d.reason, words)) fail_msg("found %d, '%s' lacks '%s'", d.found, d.reason, words);
    printf("%s\n", d.reason);
    for (size_t k = 0; k < d.count; k++) assert_true(d.sigma[k] == 0 && isnan(d.point[2 * k]));
    td_detection_free(&d);
}

static void mirror(td_image *image)
{
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width / 2; x++) {
            uint8_t *row = image->data + y * image->width, kept = row[x];
            row[x] = row[image->width - 1 - x];
            row[image->width - 1 - x] = kept;
        }
}

static void reasons_are_said(void **state)
{
    (void)state;
    const td_target right = charuco_target(8, 5, "aruco4x4_250");
    charuco_scene s = scene_of(right);
    stand_in_front(&s);
    td_image *image = photograph(&s, 7);
    td_target t = right;
    strcpy(t.dictionary, "aruco6x6_250");
    check_reason(image, t, "of aruco4x4_1000, with numbers up to 26: set dictionary");
    t = right, t.legacy = true;
    check_reason(image, t, "change legacy");
    t = right, t.plane[0].columns = 5, t.plane[0].rows = 8;
    check_reason(image, t, "exchanged");
    t = right, t.plane[0].columns = 9, t.plane[0].rows = 6;
    check_reason(image, t, "squares were counted");
    t = right, t.first_id = 100;
    check_reason(image, t, "markers 100 to 126, but saw 27 with numbers from 0 to 26");
    t = right, t.tag_size_m = 0.011;
    check_reason(image, t, "ratio of sizes");
    mirror(image);
    check_reason(image, right, "mirrored");
    memset(image->data, 128, (size_t)image->width * (size_t)image->height);
    check_reason(image, right, "saw no marker");
    td_image_free(&image);
    td_image_free(&s.board);
}

typedef struct job {
    const td_image *image;
    const td_target *target;
    td_detection detection[4];
} job;

static void detect_one(size_t index, void *user)
{
    job *j = user;
    td_charuco_detect(&j->detection[index], j->image, j->target, NULL);
}

static void same_bits_on_every_thread(void **state)
{
    (void)state;
    charuco_scene s = scene_of(charuco_target(9, 6, "aruco4x4_50"));
    stand_in_front(&s);
    td_image *image = photograph(&s, 8);
    job j = {.image = image, .target = &s.target};
    td_detection alone = detect(image, &s.target);
    assert_true(alone.found);
    assert_int_equal(td_parallel_for(4, 4, detect_one, &j, NULL, ""), TD_OK);
    for (int i = 0; i < 4; i++) {
        assert_memory_equal(alone.point, j.detection[i].point, 2 * alone.count * sizeof *alone.point);
        assert_memory_equal(alone.sigma, j.detection[i].sigma, alone.count * sizeof *alone.sigma);
        td_detection_free(&j.detection[i]);
    }
    td_detection_free(&alone);
    td_image_free(&image);
    td_image_free(&s.board);
}

static void bad_arguments(void **state)
{
    (void)state;
    td_target t = charuco_target(9, 6, "aruco9x9_50");
    td_image *image = NULL;
    td_detection d;
    td_error error;
    check_ok(td_image_new(&image, 64, 48, 1, &error), error);
    check_fails(td_charuco_detect(&d, image, &t, &error), TD_ERROR_ARGUMENT, error, "aruco9x9_50");
    t = charuco_target(9, 6, "aruco4x4_50");
    t.tag_size_m = 0.04;
    check_fails(td_charuco_detect(&d, image, &t, &error), TD_ERROR_ARGUMENT, error, "tag_size_m");
    td_image_free(&image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(random_views),
        cmocka_unit_test(every_dictionary_and_kind),
        cmocka_unit_test(a_part_suffices),
        cmocka_unit_test(reasons_are_said),
        cmocka_unit_test(same_bits_on_every_thread),
        cmocka_unit_test(bad_arguments),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
