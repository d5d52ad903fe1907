/* Registration of a frame to a map, against frames made at known poses over ground known at every point
 * (fusion_scene.h), without images: disparities with noise averaged over 5 x 5 px, a map with noise averaged
 * over 3 x 3 cells.
 *
 * Sigma, by many draws of both noises: the sum of squares of all six errors over their sigma has a mean of 1
 * within the two-sided 99.9 % bound for that count, and the Mahalanobis length of the whole error a mean
 * of 6. Tolerance besides: the estimated covariance itself scatters (a few hundred patches), and a share of
 * the correlation lies beyond its band: 10 % of sigma. Blind to: maps whose sigma is wrong; ground that has
 * changed; matching that errs for the same texture in the map and in the frame. */
#include "recon/localisation.h"

#include "core/linalg.h"
#include "tests/check.h"
#include "tests/recon/fusion_scene.h"

static int full(void)
{
    const char *value = getenv("TELEDIMOS_FULL");
    return value && !strcmp(value, "1");
}

static const double CELL = 0.1, MAP_SIGMA = 0.01;

/* Ground that tells its place: the hills of the scene and shorter waves across them. */
static double rough(double x, double y)
{
    double slope[2];
    return scene_height(x, y, slope) + 0.06 * sin(2.6 * x + 0.4 * y) * cos(2.1 * y - 0.5 * x);
}

static double ridges(double x, double y)
{
    (void)y;
    return 0.1 * sin(2.6 * x);
}

static double flat(double x, double y)
{
    return 0.02 * x - 0.01 * y;
}

typedef double ground(double x, double y);

/* Where a ray meets the ground, by secants from both sides of it. */
static bool meet(double p[3], const double from[3], const double ray[3], void *user)
{
    ground *const *h = user;
    if (!(ray[2] < -0.05)) return false;
    double s[2] = {(from[2] - 0.6) / -ray[2], (from[2] + 0.6) / -ray[2]}, off[2];
    for (int i = 0; i < 2; i++)
        off[i] = from[2] + s[i] * ray[2] - (*h)(from[0] + s[i] * ray[0], from[1] + s[i] * ray[1]);
    for (int i = 0; i < 20 && fabs(off[1]) > 1e-9 && off[1] != off[0]; i++) {
        const double next = s[1] - off[1] * (s[1] - s[0]) / (off[1] - off[0]);
        s[0] = s[1], off[0] = off[1], s[1] = next;
        for (int k = 0; k < 3; k++) p[k] = from[k] + next * ray[k];
        off[1] = p[2] - (*h)(p[0], p[1]);
    }
    return fabs(off[1]) <= 1e-9;
}

typedef struct site {
    td_rig *rig;
    td_depth_camera *camera;
    td_elevation *truth;
    td_localisation_options options;
} site;

static site site_new(ground *h)
{
    site s = {.rig = scene_rig(1), .options = td_localisation_options_default()};
    td_error error;
    const double origin[2] = {-3, -6};
    check_ok(td_depth_camera_new(&s.camera, s.rig, 0, 1, 1, 12, &error), error);
    check_ok(td_elevation_new(&s.truth, 130, 120, CELL, origin, "site", &error), error);
    for (int i = 0; i < 130 * 120; i++) {
        s.truth->height[i] = (float)h(origin[0] + i % 130 * CELL, origin[1] + i / 130 * CELL);
        s.truth->sigma[i] = (float)MAP_SIGMA;
        s.truth->count[i] = 1;
        s.truth->provenance[i] = TD_CELL_FUSED;
    }
    s.options.correlation_px = 5;
    s.options.map_correlation_m = 3 * CELL / sqrt(3.14159265); /* as much area as 3 x 3 cells */
    return s;
}

static void site_free(site *s)
{
    td_depth_camera_free(&s->camera);
    td_rig_free(&s->rig);
    td_elevation_free(&s->truth);
}

/* The truth with noise averaged over 3 x 3 cells. */
static td_elevation *noisy(const site *s, td_random *random)
{
    td_error error;
    td_elevation *map;
    check_ok(td_elevation_copy(&map, s->truth, &error), error);
    const int w = map->columns, h = map->rows;
    double *white = malloc((size_t)(w + 2) * (size_t)(h + 2) * sizeof *white);
    for (int i = 0; i < (w + 2) * (h + 2); i++) white[i] = td_random_normal(random);
    for (int i = 0; i < w * h; i++) {
        double sum = 0;
        for (int k = 0; k < 9; k++) sum += white[(i / w + k / 3) * (w + 2) + i % w + k % 3];
        map->height[i] += (float)(MAP_SIGMA * sum / 3);
    }
    free(white);
    return map;
}

static td_pose pose_at(double x, double y, double yaw)
{
    return scene_pose(x, y, 2.4, yaw, 0.6);
}

static td_disparity *frame(const site *s, ground *h, const td_pose *pose, td_random *random)
{
    td_disparity *d = scene_disparity(s->camera, s->rig, s->rig, pose, 0.15f, meet, &h);
    scene_noise(d, 5, 1, random);
    return d;
}

/* Errors of the pose about the rig's place: turn, then place. */
static void error_of(double e[6], const td_pose *found, const td_pose *truth)
{
    const td_pose back = td_pose_inverse(truth), turn = td_pose_compose(found, &back);
    td_rotation_log(e, turn.q);
    for (int k = 0; k < 3; k++) e[3 + k] = found->t[k] - truth->t[k];
}

static void test_sigma(void **state)
{
    (void)state;
    const int draws = full() ? 1000 : 40;
    site s = site_new(rough);
    s.options.search_m = s.options.search_rad = 0;
    td_random random = td_random_seed(21, 0);
    double square[6] = {0}, length = 0, sigma[6] = {0}, worst = 0, scatter = 0;
    for (int i = 0; i < draws; i++) {
        const td_pose truth =
            pose_at(-0.5 + 2 * td_random_uniform(&random), 2 * td_random_uniform(&random) - 1,
                    0.6 * td_random_uniform(&random) - 0.3);
        td_elevation *map = noisy(&s, &random);
        td_disparity *d = frame(&s, rough, &truth, &random);
        td_localisation found;
        td_error error;
        double e[6], inverse[36], xi[6], product[6];
        check_ok(td_localise(&found, map, s.camera, d, &truth, &s.options, &error), error);
        error_of(e, &found.site_from_rig, &truth);
        for (int k = 0; k < 6; k++) {
            square[k] += e[k] * e[k] / (found.sigma[k] * found.sigma[k]) / draws;
            sigma[k] += found.sigma[k] / draws;
        }
        worst = fmax(worst, hypot(e[3], e[4]));
        scatter += found.scatter / draws;
        const td_pose back = td_pose_inverse(&truth), off = td_pose_compose(&found.site_from_rig, &back);
        td_pose_log(xi, &off);
        check_ok(td_invert_spd(inverse, found.covariance, 6, &error), error);
        td_multiply(product, inverse, xi, 6, 6, 1);
        for (int k = 0; k < 6; k++) length += xi[k] * product[k] / draws;
        td_elevation_free(&map);
        scene_disparity_free(&d);
    }
    double all = 0;
    for (int k = 0; k < 6; k++) all += square[k] / 6;
    print_message(
        "%d draws: error over sigma: roll %.2f pitch %.2f heading %.2f x %.2f y %.2f z %.2f, all %.3f; "
        "Mahalanobis %.2f of 6\n",
        draws, sqrt(square[0]), sqrt(square[1]), sqrt(square[2]), sqrt(square[3]), sqrt(square[4]),
        sqrt(square[5]), sqrt(all), length);
    print_message(
        "sigma: turns %.2f %.2f %.2f mrad, place %.1f %.1f %.1f mm; worst place %.1f mm; scatter %.2f\n",
        1e3 * sigma[0], 1e3 * sigma[1], 1e3 * sigma[2], 1e3 * sigma[3], 1e3 * sigma[4], 1e3 * sigma[5],
        1e3 * worst, scatter);
    /* 6 draws are independent in the length; 3.29 sqrt(2 / (6 n)) of the mean, and 12 % of sigma besides. */
    const double bound = 3.29 * sqrt(2.0 / (6 * draws)) + 0.25;
    check_near(length / 6, 1, bound);
    check_near(all, 1, 3.29 * sqrt(2.0 / draws) / sqrt(3) + 0.25);
    site_free(&s);
}

/* From starts far off, and from one frame's place to the next. */
static void test_search(void **state)
{
    (void)state;
    site s = site_new(rough);
    td_random random = td_random_seed(22, 0);
    td_elevation *map = noisy(&s, &random);
    for (int i = 0; i < 4; i++) {
        const td_pose truth = pose_at(-0.4 + 0.3 * i, 0.8 - 0.3 * i, 0.1 * i - 0.2);
        const double a = 6.2831853 * td_random_uniform(&random);
        td_pose start = pose_at(truth.t[0] + 0.8 * cos(a), truth.t[1] + 0.8 * sin(a),
                                0.1 * i - 0.2 + (i % 2 ? 0.12 : -0.12));
        start.t[2] += 0.1;
        td_disparity *d = frame(&s, rough, &truth, &random);
        td_localisation found;
        td_error error;
        double e[6];
        check_ok(td_localise(&found, map, s.camera, d, &start, &s.options, &error), error);
        error_of(e, &found.site_from_rig, &truth);
        print_message(
            "start off by 0.8 m, 0.12 rad: found to %.1f mm, %.2f mrad (sigma %.1f %.1f mm, %.2f mrad)\n",
            1e3 * hypot(e[3], e[4]), 1e3 * fabs(e[2]), 1e3 * found.sigma[3], 1e3 * found.sigma[4],
            1e3 * found.sigma[2]);
        for (int k = 0; k < 6; k++) check_less(fabs(e[k]), 5 * found.sigma[k]);
        scene_disparity_free(&d);
    }
    td_elevation_free(&map);
    site_free(&s);
}

/* Ground that does not tell: refused by the name of what it does not tell, although the map's noise has
 * slopes. */
static void test_flat(void **state)
{
    (void)state;
    static const struct {
        ground *h;
        const char *words;
    } cases[] = {{flat, "x, y, the heading"}, {ridges, "not tell y"}};
    for (int i = 0; i < 2; i++) {
        site s = site_new(cases[i].h);
        td_random random = td_random_seed(23, (uint64_t)i);
        td_elevation *map = noisy(&s, &random);
        const td_pose truth = pose_at(0, 0, 0.1);
        td_disparity *d = frame(&s, cases[i].h, &truth, &random);
        td_localisation found;
        td_error error = {0};
        s.options.search_m = s.options.search_rad = 0;
        check_fails(td_localise(&found, map, s.camera, d, &truth, &s.options, &error), TD_ERROR_DATA, error,
                    cases[i].words);
        print_message("%s\n", error.message);
        scene_disparity_free(&d);
        td_elevation_free(&map);
        site_free(&s);
    }
}

/* A quarter of the view is the machine's arm, and some of the ground has been dug away: the rest tells. */
static void test_changed(void **state)
{
    (void)state;
    site s = site_new(rough);
    td_random random = td_random_seed(24, 0);
    td_elevation *map = noisy(&s, &random);
    const td_pose truth = pose_at(0.2, 0.1, 0.05), start = pose_at(0.5, 0.3, 0.1);
    td_disparity *d = frame(&s, rough, &truth, &random);
    for (int i = 0; i < d->width * d->height; i++)
        if (i % d->width > 150) d->value[i] = d->sigma[i] = NAN, d->kind[i] = TD_DENSE_NONE;
    for (int i = 0; i < map->columns * map->rows; i++) {
        const double x = map->origin[0] + i % map->columns * CELL,
                     y = map->origin[1] + i / map->columns * CELL;
        if (x > 2.6 && x < 3.3 && y > -0.2 && y < 0.5) map->height[i] += 0.4f;
    }
    td_localisation found;
    td_error error;
    double e[6];
    check_ok(td_localise(&found, map, s.camera, d, &start, &s.options, &error), error);
    error_of(e, &found.site_from_rig, &truth);
    print_message("scatter %.2f, %zu of the points agree\n", found.scatter, found.points);
    for (int k = 0; k < 6; k++) check_less(fabs(e[k]), 5 * found.sigma[k]);
    scene_disparity_free(&d);
    td_elevation_free(&map);
    site_free(&s);
}

static void test_refused(void **state)
{
    (void)state;
    site s = site_new(rough);
    td_random random = td_random_seed(25, 0);
    const td_pose truth = pose_at(0, 0, 0), away = pose_at(40, 0, 0);
    td_disparity *d = frame(&s, rough, &truth, &random);
    td_localisation found;
    td_error error;
    check_fails(td_localise(&found, s.truth, s.camera, d, &away, &s.options, &error), TD_ERROR_DATA, error,
                "lies on the map");
    for (int i = 0; i < 130 * 120; i++) s.truth->height[i] = (float)(0.5 * td_random_normal(&random));
    check_fails(td_localise(&found, s.truth, s.camera, d, &truth, &s.options, &error), TD_ERROR_DATA, error,
                "does not fit");
    s.options.least_share = NAN;
    check_fails(td_localise(&found, s.truth, s.camera, d, &truth, &s.options, &error), TD_ERROR_ARGUMENT,
                error, "least_share");
    s.options = td_localisation_options_default();
    for (int i = 0; i < d->width * d->height; i++) d->kind[i] = TD_DENSE_FILLED;
    check_fails(td_localise(&found, s.truth, s.camera, d, &truth, &s.options, &error), TD_ERROR_DATA, error,
                "too little");
    d->height--;
    check_fails(td_localise(&found, s.truth, s.camera, d, &truth, &s.options, &error), TD_ERROR_DATA, error,
                "the disparities are");
    d->height++;
    scene_disparity_free(&d);
    site_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sigma),   cmocka_unit_test(test_search),  cmocka_unit_test(test_flat),
        cmocka_unit_test(test_changed), cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
