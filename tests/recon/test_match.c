/* Proves guided and automatic matching.
 * References: a slanted plane with a texture known everywhere, seen by two cameras whose baseline is oblique
 * to the rows (exact truth); Middlebury's Aloe (integer truth, Debian's opencv-doc) and Motorcycle (truth to
 * a fraction of a pixel, TELEDIMOS_DATA). Tolerances: on the plane what refinement is tested to; on Aloe 1.5
 * px, its truth's steps. Guided matching is judged where the truth is one: visible in both images, and within
 * 2 px no edge of depth, on which a corner belongs to one side and the truth's pixel to the other. Blind to:
 * distortion (test_epipolar), surfaces turned away so far that no window is like its image. */
#include "core/image.h"
#include "recon/match.h"
#include "recon/zncc.h"
#include "tests/check.h"
#include "tests/recon/texture.h"

/* ---- A rig whose rows, or lines oblique to them, are epipolar lines ---- */

static td_rig *parallel_rig(int width, int height, double f, double cx, double cy, const double t[3])
{
    td_rig *rig = td_rig_new();
    rig->count = 2;
    for (int i = 0; i < 2; i++) {
        strcpy(rig->camera[i].name, i ? "right" : "left");
        rig->camera[i].camera = (td_camera){TD_CAMERA_PINHOLE, width, height, {f, f, cx, cy}};
        rig->camera[i].camera_from_rig = td_pose_identity();
    }
    memcpy(rig->camera[1].camera_from_rig.t, t, 3 * sizeof *t);
    return rig;
}

/* ---- The plane: right = left - D (1, eta), D = 14 + 0.03 (x - 120) - 0.02 (y - 90) ---- */

enum { WIDTH = 240, HEIGHT = 180 };
static const double eta = 0.2;

static void plane_truth(double right[2], const double left[2])
{
    const double d = 14 + 0.03 * (left[0] - 120) - 0.02 * (left[1] - 90);
    right[0] = left[0] - d;
    right[1] = left[1] - eta * d;
}

typedef struct scene {
    td_rig *rig;
    td_pair pair;
    td_image *left, *right;
    td_match_options options;
} scene;

static void draw_plane(scene *s, double noise)
{
    const double identity[4] = {1, 0, 0, 1}, zero[2] = {0, 0}, t[3] = {-0.1, -0.1 * eta, 0};
    const double a[4] = {1 - 0.03, 0.02, -0.03 * eta, 1 + 0.02 * eta};
    double c[2];
    td_random random = td_random_seed(21, 0);
    td_error error;
    const texture wall = texture_draw(&random, 25);
    plane_truth(c, zero);
    check_ok(td_image_new(&s->left, WIDTH, HEIGHT, 1, &error), error);
    check_ok(td_image_new(&s->right, WIDTH, HEIGHT, 1, &error), error);
    texture_render(s->left, &wall, identity, zero, 1, 120, noise, &random);
    texture_render(s->right, &wall, a, c, 0.9, 135, noise, &random);
    s->rig = parallel_rig(WIDTH, HEIGHT, 500, 120, 90, t);
    check_ok(td_pair_init(&s->pair, s->rig, 0, 1, &error), error);
    s->options = td_match_options_default();
    s->options.near_m = 1.5;
}

static void free_scene(scene *s)
{
    td_image_free(&s->left);
    td_image_free(&s->right);
    td_rig_free(&s->rig);
}

static void test_plane_automatic(void **state)
{
    (void)state;
    scene s;
    td_match *match;
    td_match_tally tally;
    td_error error;
    size_t count, good = 0;
    double squares = 0, ratio = 0;
    draw_plane(&s, 2);
    s.options.interest.distance_px = 15; /* windows do not overlap: errors are independent */
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, s.left, s.right, &s.options, &error), error);
    for (size_t i = 0; i < count; i++) {
        double truth[2];
        const td_match *m = &match[i];
        const double *v = m->covariance, det = v[0] * v[3] - v[1] * v[2];
        plane_truth(truth, m->left);
        const double e[2] = {m->right[0] - truth[0], m->right[1] - truth[1]};
        assert_true(m->refined);
        if (hypot(e[0], e[1]) > 1) continue;
        good++;
        squares += e[0] * e[0] + e[1] * e[1];
        ratio += (v[3] * e[0] * e[0] - 2 * v[1] * e[0] * e[1] + v[0] * e[1] * e[1]) / det / 2;
    }
    print_message(
        "plane: %zu points, %zu matches, %zu within 1 px, RMS %.4f px, empirical over predicted %.3f\n",
        tally.left_points, count, good, sqrt(squares / (double)good), sqrt(ratio / (double)good));
    assert_int_equal(tally.left_points,
                     count + tally.unseen + tally.ambiguous + tally.one_sided + tally.unrefined);
    assert_true(count > tally.left_points * 6 / 10 && count > 60);
    assert_true(good == count);
    check_less(sqrt(squares / (double)good), 0.05);
    check_near(ratio / (double)good, 1, 3.29 / sqrt((double)good));
    free(match);
    free_scene(&s);
}

static void test_same_at_any_thread_count(void **state)
{
    (void)state;
    scene s;
    td_match *match[2];
    size_t count[2];
    td_error error;
    draw_plane(&s, 2);
    for (int i = 0; i < 2; i++) {
        s.options.threads = i ? 4 : 1;
        check_ok(td_match_automatic(&match[i], &count[i], NULL, &s.pair, s.left, s.right, &s.options, &error),
                 error);
    }
    assert_int_equal(count[0], count[1]);
    assert_true(count[0] > 60);
    assert_memory_equal(match[0], match[1], count[0] * sizeof *match[0]);
    free(match[0]);
    free(match[1]);
    free_scene(&s);
}

static void test_plane_guided(void **state)
{
    (void)state;
    scene s;
    td_error error;
    draw_plane(&s, 2);
    for (int n = 0; n < 40; n++) {
        const double point[2] = {60.3 + 4 * n, 30.4 + 3 * n};
        double truth[2];
        td_match *candidate;
        size_t count;
        check_ok(td_match_guided(&candidate, &count, &s.pair, s.left, s.right, point, &s.options, &error),
                 error);
        assert_true(count >= 1);
        plane_truth(truth, point);
        assert_true(candidate[0].refined);
        check_near(candidate[0].left[0], point[0], 0);
        check_near(candidate[0].right[0], truth[0], 0.2);
        check_near(candidate[0].right[1], truth[1], 0.2);
        for (size_t i = 1; i < count; i++) assert_true(candidate[i].zncc <= candidate[i - 1].zncc);
        free(candidate);
    }
    free_scene(&s);
}

/* Every pixel of the band is looked at: the best candidate is the best of an exhaustive search. */
static void test_exhaustive(void **state)
{
    (void)state;
    scene s;
    td_error error;
    draw_plane(&s, 2);
    s.options.least_zncc = -1;
    s.options.band_px = 2.5;
    s.options.candidates = 3;
    for (int n = 0; n < 12; n++) {
        const int i = 50 + 13 * n, j = 30 + 9 * n;
        const double point[2] = {i, j};
        td_match *candidate;
        size_t count;
        double best = -1, wider = -1;
        for (int y = 0; y < HEIGHT; y++)
            for (int x = 0; x < WIDTH; x++) {
                const double at[2] = {x, y}, z = td_zncc(s.left, i, j, s.right, x, y, 7);
                double distance;
                assert_true(td_pair_residual(&distance, NULL, NULL, &s.pair, point, at));
                if (isnan(z) || x > i || x < i - 33) continue;
                if (fabs(distance) < 1.8) best = fmax(best, z);
                if (fabs(distance) < 3.3) wider = fmax(wider, z);
            }
        check_ok(td_match_guided(&candidate, &count, &s.pair, s.left, s.right, point, &s.options, &error),
                 error);
        assert_true(count > 0);
        assert_true(candidate[0].zncc >= best && candidate[0].zncc <= wider);
        free(candidate);
    }
    free_scene(&s);
}

/* ---- What must be named ---- */

static void test_bad_input(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_match *match;
    size_t count;
    td_image *small, *colour;
    const double inside[2] = {120, 90}, outside[2] = {300, 90}, edge[2] = {3, 90}, none[2] = {NAN, 1};
    draw_plane(&s, 2);
    check_ok(td_image_new(&small, WIDTH - 1, HEIGHT, 1, &error), error);
    check_ok(td_image_new(&colour, WIDTH, HEIGHT, 3, &error), error);
#define GUIDED(l, r, p) td_match_guided(&match, &count, &s.pair, l, r, p, &s.options, &error)
    check_fails(GUIDED(small, s.right, inside), TD_ERROR_ARGUMENT, error, "left image: 239 x 180");
    check_fails(GUIDED(s.left, colour, inside), TD_ERROR_ARGUMENT, error, "3 channels");
    check_fails(GUIDED(s.left, s.right, outside), TD_ERROR_ARGUMENT, error, "outside");
    check_fails(GUIDED(s.left, s.right, none), TD_ERROR_ARGUMENT, error, "outside");
    check_fails(GUIDED(s.left, s.right, edge), TD_ERROR_ARGUMENT, error, "edge");
    check_fails(td_match_automatic(&match, &count, NULL, &s.pair, s.left, small, NULL, &error),
                TD_ERROR_ARGUMENT, error, "right image: 239 x 180");
    const td_match_options good = s.options;
#define REFUSED(field, value, words)                                                                         \
    do {                                                                                                     \
        s.options = good;                                                                                    \
        s.options.field = value;                                                                             \
        check_fails(GUIDED(s.left, s.right, inside), TD_ERROR_ARGUMENT, error, words);                       \
    } while (0)
    REFUSED(half_window, 0, "half_window");
    REFUSED(half_window, 51, "half_window");
    REFUSED(near_m, 0, "near_m");
    REFUSED(far_m, 1, "far_m");
    REFUSED(far_m, NAN, "far_m");
    REFUSED(band_px, -1, "band_px");
    REFUSED(least_zncc, 1, "least_zncc");
    REFUSED(uniqueness, 0, "uniqueness");
    REFUSED(candidates, 0, "candidates");
    REFUSED(threads, -1, "threads");
    td_image_free(&small);
    td_image_free(&colour);
    free_scene(&s);
}

typedef struct heard {
    int warnings;
    char text[300];
} heard;

static void listen(td_log_level level, const char *topic, const char *text, void *user)
{
    heard *h = user;
    (void)topic;
    h->warnings += level == TD_LOG_WARNING;
    snprintf(h->text, sizeof h->text, "%s", text);
}

static void test_hopeless_pairs(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_match *match;
    td_match_tally tally;
    size_t count;
    td_image *flat;
    heard h = {0, ""};
    const td_log log = {listen, &h};
    const double inside[2] = {120, 90};
    draw_plane(&s, 2);
    s.options.log = &log;
    check_ok(td_image_new(&flat, WIDTH, HEIGHT, 1, &error), error);
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, flat, flat, &s.options, &error), error);
    assert_int_equal(count, 0);
    assert_int_equal(tally.left_points, 0);
    assert_int_equal(h.warnings, 1);
    free(match);
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, s.left, flat, &s.options, &error), error);
    assert_int_equal(count, 0);
    assert_int_equal(tally.unseen, tally.left_points);
    free(match);
    check_ok(td_match_guided(&match, &count, &s.pair, flat, s.right, inside, &s.options, &error), error);
    assert_int_equal(count, 0);
    free(match);
    h.warnings = 0;
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, s.right, s.left, &s.options, &error), error);
    assert_true(count < tally.left_points / 10);
    assert_int_equal(h.warnings, 1);
    assert_non_null(strstr(h.text, "swapped"));
    free(match);
    td_image_free(&flat);
    free_scene(&s);
}

/* A chequered wall every 10 px: whatever is matched must not be claimed. */
static void test_repeated_texture(void **state)
{
    (void)state;
    scene s;
    td_error error;
    td_match *match;
    td_match_tally tally;
    size_t count;
    const double inside[2] = {120, 90}, t[3] = {-0.1, 0, 0};
    draw_plane(&s, 2);
    td_rig_free(&s.rig);
    s.rig = parallel_rig(WIDTH, HEIGHT, 500, 120, 90, t);
    check_ok(td_pair_init(&s.pair, s.rig, 0, 1, &error), error);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            s.left->data[y * WIDTH + x] = s.right->data[y * WIDTH + x] =
                (uint8_t)(120 + 60 * sin(x * 0.6283185307179586) + 40 * sin(y * 0.5));
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, s.left, s.right, &s.options, &error), error);
    print_message("repeated: %zu points, %zu matches, %zu unseen, %zu ambiguous, %zu one-sided\n",
                  tally.left_points, count, tally.unseen, tally.ambiguous, tally.one_sided);
    assert_true(tally.left_points > 50);
    /* unseen: nearer than the window to the edge */
    assert_true(tally.ambiguous * 10 > (tally.left_points - tally.unseen) * 9);
    assert_true(count < tally.left_points / 20);
    free(match);
    check_ok(td_match_guided(&match, &count, &s.pair, s.left, s.right, inside, &s.options, &error), error);
    assert_true(count >= 3);
    check_near(match[0].runner_up, match[0].zncc, 0.01);
    free(match);
    free_scene(&s);
}

/* ---- Real pairs ---- */

enum { POINTS = 500 };

/* The disparity at a left pixel, where it is one; NAN elsewhere. */
typedef double (*truth_function)(int x, int y, const void *user);

static double aloe_truth(int x, int y, const void *user)
{
    const td_image *truth = user;
    const uint8_t *row = truth->data + (size_t)y * (size_t)truth->width;
    const int d = row[x];
    if (d == 0 || x - d < 0) return NAN;
    return d;
}

/* Visible in the right image, and no edge of depth within 2 px. */
static bool has_one_truth(int x, int y, const td_image *truth)
{
    const double d = aloe_truth(x, y, truth);
    if (isnan(d) || x < 2 || y < 2 || x >= truth->width - 2 || y >= truth->height - 2) return false;
    for (int v = -2; v <= 2; v++)
        for (int u = -2; u <= 2; u++)
            if (!(fabs(aloe_truth(x + u, y + v, truth) - d) <= 2)) return false;
    for (int other = 0; other < truth->width; other++) {
        const double e = aloe_truth(other, y, truth);
        if (e > d + 1 && fabs(other - e - (x - d)) <= 1) return false;
    }
    return true;
}

static td_image *read_grey(const char *path)
{
    td_image *image = NULL;
    td_error error;
    return td_image_read(&image, path, 1, &error) == TD_OK ? image : NULL;
}

#define ALOE "/usr/share/doc/opencv-doc/examples/data/aloe"

static bool read_aloe(scene *s, td_image **truth)
{
    const double t[3] = {-0.16, 0, 0};
    td_error error;
    s->left = read_grey(ALOE "L.jpg");
    s->right = read_grey(ALOE "R.jpg");
    *truth = read_grey(ALOE "GT.png");
    if (!s->left || !s->right || !*truth) return false;
    s->rig = parallel_rig(s->left->width, s->left->height, 3740, 640, 555, t);
    check_ok(td_pair_init(&s->pair, s->rig, 0, 1, &error), error);
    s->options = td_match_options_default();
    s->options.near_m = 3740 * 0.16 / 240;
    return true;
}

static void test_aloe_automatic(void **state)
{
    (void)state;
    scene s;
    td_image *truth;
    td_match *match;
    td_match_tally tally;
    td_error error;
    size_t count, known = 0, good = 0;
    if (!read_aloe(&s, &truth)) {
        print_message("skipped: no Aloe; install opencv-doc\n");
        skip();
    }
    check_ok(td_match_automatic(&match, &count, &tally, &s.pair, s.left, s.right, &s.options, &error), error);
    for (size_t i = 0; i < count; i++) {
        const double d = aloe_truth((int)lrint(match[i].left[0]), (int)lrint(match[i].left[1]), truth);
        if (isnan(d)) continue;
        known++;
        good += fabs(match[i].left[0] - match[i].right[0] - d) <= 1.5;
    }
    print_message(
        "Aloe: %zu points, %zu matches (%zu unseen, %zu ambiguous, %zu one-sided, %zu unrefined); of "
        "%zu with truth %.2f %% within 1.5 px\n",
        tally.left_points, count, tally.unseen, tally.ambiguous, tally.one_sided, tally.unrefined, known,
        100. * (double)good / (double)known);
    assert_true(count > 900 && known > 880);
    assert_true((double)good >= 0.99 * (double)known);
    free(match);
    td_image_free(&truth);
    free_scene(&s);
}

static void test_aloe_guided(void **state)
{
    (void)state;
    scene s;
    td_image *truth;
    td_interest_point *point;
    td_error error;
    size_t points, n = 0, first = 0, three = 0;
    if (!read_aloe(&s, &truth)) {
        print_message("skipped: no Aloe; install opencv-doc\n");
        skip();
    }
    s.options.least_zncc = 0.5;
    check_ok(td_interest_points(&point, &points, s.left, &s.options.interest, &error), error);
    for (size_t i = 0; i < points && n < POINTS; i++) {
        const int x = (int)lrint(point[i].x), y = (int)lrint(point[i].y);
        const double at[2] = {point[i].x, point[i].y}, d = aloe_truth(x, y, truth);
        td_match *candidate;
        size_t count, rank = SIZE_MAX;
        if (!has_one_truth(x, y, truth) || x - d < 7 || x < 7 || y < 7 || x >= s.left->width - 7 ||
            y >= s.left->height - 7)
            continue;
        check_ok(td_match_guided(&candidate, &count, &s.pair, s.left, s.right, at, &s.options, &error),
                 error);
        for (size_t k = 0; k < count && rank == SIZE_MAX; k++)
            if (fabs(candidate[k].left[0] - candidate[k].right[0] - d) <= 1.5) rank = k;
        n++;
        first += rank == 0;
        three += rank < 3;
        free(candidate);
    }
    print_message(
        "Aloe, guided: true candidate first for %.1f %%, in the first three for %.1f %% of %zu points\n",
        100. * (double)first / (double)n, 100. * (double)three / (double)n, n);
    assert_int_equal(n, POINTS);
    assert_true(first * 100 >= 97 * n);
    assert_true(three * 100 >= 97 * n);
    free(point);
    td_image_free(&truth);
    free_scene(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_plane_automatic),  cmocka_unit_test(test_same_at_any_thread_count),
        cmocka_unit_test(test_plane_guided),     cmocka_unit_test(test_exhaustive),
        cmocka_unit_test(test_bad_input),        cmocka_unit_test(test_hopeless_pairs),
        cmocka_unit_test(test_repeated_texture), cmocka_unit_test(test_aloe_automatic),
        cmocka_unit_test(test_aloe_guided),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
