/* The fusion, against a simulated site whose heights are known at every point (fusion_scene.h).
 *
 * Coverage: rigs drawn from their covariance, poses from theirs, matching noise as stated; the share of cells
 * off by at most their sigma must be 0.68. One rig is one draw, and its error is common to most of a map, so
 * the bound is for the draws, not the cells: each draw's share scatters by 0.4 (measured and printed), and
 * 0.4 / sqrt(draws) is one standard deviation of the mean: 0.07 is 2.7 of them at 240 draws, 0.18 is 2.5
 * at 30. Noise alone is independent from cell to cell: there 0.04, for its model is not exact: in cells below
 * the errors' correlation the slope is known roughly and what is left of it counts in full (71 %), at the
 * view's edge large cells are seen in part (67 %). Blind to: matching errors that are not what td_disparity's
 * sigma says; a rig whose covariance is wrong; rough ground (cells hold a plane here, or a clear step); how
 * much of matching's error really repeats from one place (the simulation repeats what the option says).
 */
#include "recon/fusion.h"

#include "core/file.h"
#include "tests/check.h"
#include "tests/recon/fusion_scene.h"
#include "tests/scratch.h"

static int full(void)
{
    const char *value = getenv("TELEDIMOS_FULL");
    return value && !strcmp(value, "1");
}

typedef struct site {
    td_rig *rig;
    td_depth_camera *camera;
    td_fusion_options options;
} site;

static site site_new(bool calibrated, double scale)
{
    site s = {.rig = scene_rig(scale), .options = td_fusion_options_default()};
    td_error error;
    if (!calibrated) {
        free(s.rig->covariance);
        s.rig->covariance = NULL;
    }
    check_ok(td_depth_camera_new(&s.camera, s.rig, 0, 1, 1, 12, &error), error);
    s.options.cell_m = 0.1;
    return s;
}

static void site_free(site *s)
{
    td_depth_camera_free(&s->camera);
    td_rig_free(&s->rig);
}

static const double DOWN = 0.75; /* rad */

static void add(td_fusion *fusion, const site *s, const td_pose *pose, const td_disparity *d,
                const double *covariance, td_fusion_tally *tally)
{
    const td_fusion_frame frame = {s->camera, d, *pose, covariance, 1};
    td_error error;
    check_ok(td_fusion_add(fusion, &frame, tally, &error), error);
}

/* ---- coverage ---- */

typedef struct cover {
    double inside, cells, square, draws, share, share2; /* share: of a draw */
} cover;

static void count(cover *c, const td_elevation *map)
{
    double inside = 0, cells = 0;
    for (int i = 0; i < map->columns * map->rows; i++) {
        double slope[2];
        if (isnan(map->height[i])) continue;
        const double off =
            (double)map->height[i] - scene_height(map->origin[0] + i % map->columns * map->cell_m,
                                                  map->origin[1] + i / map->columns * map->cell_m, slope);
        const double z = off / (double)map->sigma[i];
        inside += fabs(z) <= 1;
        c->square += z * z;
        cells++;
    }
    c->inside += inside;
    c->cells += cells;
    c->share += inside / cells;
    c->share2 += inside / cells * (inside / cells);
    c->draws++;
}

static void print_cover(const char *what, const cover *c)
{
    const double mean = c->share / c->draws;
    print_message(
        "%s: %.1f %% of %.0f cells within 1 sigma (%.0f draws, each scatters by %.2f), rms z %.3f\n", what,
        100 * c->inside / c->cells, c->cells, c->draws, sqrt(c->share2 / c->draws - mean * mean),
        sqrt(c->square / c->cells));
}

/* One drawn rig on a moving base: `frames` from places 0.5 m apart, `repeats` of each. */
static void draw(cover *c, const site *s, int frames, int repeats, double pose_sigma, td_random *random)
{
    td_fusion *fusion;
    td_error error;
    double covariance[36] = {0};
    for (int i = 0; i < 6; i++) covariance[7 * i] = pow(pose_sigma * (i < 3 ? 0.3 : 1), 2);
    td_rig *truth =
        s->rig->covariance ? rig_draw(s->rig, s->rig->covariance, 1, 0, random) : td_rig_copy(s->rig);
    check_ok(td_fusion_new(&fusion, &s->options, &error), error);
    for (int f = 0; f < frames; f++) {
        const td_pose believed = scene_pose(0.5 * f, -0.4 * f, 2.5, 0.2 * f, DOWN);
        double xi[6];
        for (int i = 0; i < 6; i++) xi[i] = sqrt(covariance[7 * i]) * td_random_normal(random);
        const td_pose pose = td_pose_perturb(&believed, xi);
        td_disparity *d = scene_disparity(s->camera, s->rig, truth, &pose, 0.15f, scene_hills, NULL);
        scene_noise(d, 5, sqrt(s->options.repeat_share), random);
        const size_t n = (size_t)d->width * (size_t)d->height;
        float *common = malloc(n * sizeof *common);
        memcpy(common, d->value, n * sizeof *common);
        for (int r = 0; r < repeats; r++) {
            memcpy(d->value, common, n * sizeof *common);
            scene_noise(d, 5, sqrt(1 - s->options.repeat_share), random);
            add(fusion, s, &believed, d, pose_sigma > 0 ? covariance : NULL, NULL);
        }
        free(common);
        scene_disparity_free(&d);
    }
    td_elevation *map;
    check_ok(td_fusion_map(&map, NULL, fusion, &error), error);
    count(c, map);
    td_elevation_free(&map);
    td_fusion_free(&fusion);
    td_rig_free(&truth);
}

static void test_noise_coverage(void **state)
{
    (void)state;
    check_statistics();
    td_random random = td_random_seed(11, 0);
    site s = site_new(false, 1);
    static const double cell[3] = {0.03, 0.1,
                                   0.25}; /* 1.3, 4 and 11 pixels: below, at and above correlation_px */
    for (int k = 0; k < 3; k++) {
        cover one = {0};
        s.options.cell_m = cell[k];
        for (int i = 0; i < (k == 2 ? 12 : 4); i++) draw(&one, &s, 1, 1, 0, &random);
        print_cover("noise, one frame", &one);
        check_near(one.inside / one.cells, 0.683, 0.04);
    }
    cover many = {0};
    s.options.cell_m = 0.1;
    for (int i = 0; i < 4; i++) draw(&many, &s, 3, 3, 0, &random);
    print_cover("noise, 3 places x 3 frames", &many);
    check_near(many.inside / many.cells, 0.683, 0.04);
    site_free(&s);
}

static void test_rig_coverage(void **state)
{
    (void)state;
    check_statistics();
    const int draws = full() ? 240 : 30;
    const double bound = full() ? 0.07 : 0.18;
    td_random random = td_random_seed(12, 0);
    site s = site_new(true, 1), sure = site_new(false, 1);
    cover one = {0}, moving = {0}, posed = {0};
    for (int i = 0; i < draws; i++) {
        draw(&one, &s, 1, 1, 0, &random);
        draw(&moving, &s, 3, 2, 0.004, &random);
        draw(&posed, &sure, 2, 2, 0.03, &random);
    }
    print_cover("rig and noise, one frame", &one);
    print_cover("rig, poses and noise, 3 places x 2 frames", &moving);
    print_cover("poses and noise, 2 places x 2 frames", &posed);
    check_near(one.inside / one.cells, 0.683, bound);
    check_near(posed.inside / posed.cells, 0.683, bound);
    check_near(moving.inside / moving.cells, 0.683, bound);
    site_free(&s);
    site_free(&sure);
}

/* ---- what changes and what does not ---- */

typedef struct works {
    double trench_m, wall_m; /* depth of a trench, height of a block; both from x 2.2 to 3, y -0.6 to 0.6 */
} works;

static double works_height(const works *w, double x, double y)
{
    const bool inside = x >= 2.2 && x <= 3 && y >= -0.6 && y <= 0.6;
    return inside ? w->wall_m - w->trench_m : 0;
}

/* First crossing of a ray with the flat site and its works, by small steps. */
static bool works_meet(double p[3], const double from[3], const double ray[3], void *user)
{
    const works *w = user;
    if (!(ray[2] < -0.05)) return false;
    double s = (from[2] - fmax(w->wall_m, 0)) / -ray[2];
    for (const double last = (from[2] + w->trench_m) / -ray[2] + 0.01; s < last; s += 0.002) {
        for (int k = 0; k < 3; k++) p[k] = from[k] + s * ray[k];
        if (p[2] <= works_height(w, p[0], p[1])) return true;
    }
    return false;
}

static td_disparity *works_seen(const site *s, const td_pose *pose, works w, td_random *random)
{
    td_disparity *d = scene_disparity(s->camera, s->rig, s->rig, pose, 0.1f, works_meet, &w);
    scene_noise(d, 5, 1, random);
    return d;
}

static void works_add(td_fusion *fusion, const site *s, const td_pose *pose, works w, td_random *random,
                      td_fusion_tally *tally)
{
    td_disparity *d = works_seen(s, pose, w, random);
    add(fusion, s, pose, d, NULL, tally);
    scene_disparity_free(&d);
}

static td_elevation *map_of(const td_fusion *fusion)
{
    td_elevation *map;
    td_error error;
    check_ok(td_fusion_map(&map, NULL, fusion, &error), error);
    return map;
}

/* Cells well inside of the works (a cell's width from their edges) whose height is within 5 sigma + 2 cm of
 * `height`, and those known at all. */
static void inside(int *right, int *known, const td_elevation *map, double height)
{
    *right = *known = 0;
    for (int i = 0; i < map->columns * map->rows; i++) {
        const double x = map->origin[0] + i % map->columns * map->cell_m;
        const double y = map->origin[1] + i / map->columns * map->cell_m;
        if (x < 2.3 || x > 2.9 || y < -0.5 || y > 0.5 || isnan(map->height[i])) continue;
        ++*known;
        *right += fabs((double)map->height[i] - height) < 5 * (double)map->sigma[i] + 0.02;
    }
}

/* Whether the rectified left image holds the point, or nearly: a cell at its edge is seen in part. */
static bool in_view(const site *s, const td_pose *site_from_rig, const double at[3])
{
    const td_camera *image = &td_depth_camera_rectification(s->camera)->camera;
    const td_pose rig_from_rectified = td_depth_camera_pose(s->camera);
    const td_pose site_from_camera = td_pose_compose(site_from_rig, &rig_from_rectified);
    const td_pose camera_from_site = td_pose_inverse(&site_from_camera);
    double seen[3], pixel[2];
    td_pose_transform(seen, &camera_from_site, at);
    if (!td_camera_project(pixel, NULL, NULL, image, seen)) return false;
    return pixel[0] > -8 && pixel[0] < image->width + 8 && pixel[1] > -8 && pixel[1] < image->height + 8;
}

/* A trench is believed after N frames, not before; cells away from it that later frames do not see keep every
 * bit. */
static void test_excavated(void **state)
{
    (void)state;
    td_random random = td_random_seed(13, 0);
    site s = site_new(true, 1);
    s.options.region[0] = -1, s.options.region[1] = -3, s.options.region[2] = 6, s.options.region[3] = 3;
    td_error error;
    td_fusion *fusion;
    td_fusion_tally tally;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    const td_pose wide = scene_pose(-0.2, 0, 2.6, 0, 0.6), near = scene_pose(1.4, 0, 2.6, 0, 1.0);
    for (int i = 0; i < 3; i++) works_add(fusion, &s, &wide, (works){0}, &random, &tally);
    td_elevation *before = map_of(fusion);
    int right, known;
    for (int i = 1; i <= s.options.believe_frames; i++) {
        works_add(fusion, &s, &near, (works){.trench_m = 0.3}, &random, &tally);
        td_elevation *map = map_of(fusion);
        inside(&right, &known, map, i < s.options.believe_frames ? 0 : -0.3);
        print_message(
            "frame %d after digging: %zu gated, %zu reset, %zu cleared; %d of %d cells as expected\n", i,
            tally.gated, tally.reset, tally.cleared, right, known);
        assert_true(known > 50 && right == known);
        assert_true(i < s.options.believe_frames ? tally.gated > 50 && tally.reset == 0 : tally.reset > 50);
        td_elevation_free(&map);
    }
    td_elevation *after = map_of(fusion);
    int same = 0, unseen = 0;
    for (int i = 0; i < after->columns * after->rows; i++) {
        const double at[3] = {after->origin[0] + i % after->columns * after->cell_m,
                              after->origin[1] + i / after->columns * after->cell_m,
                              (double)before->height[i]};
        if (isnan(before->height[i]) || in_view(&s, &near, at)) continue;
        unseen++;
        same += !memcmp(&before->height[i], &after->height[i], 4) && before->count[i] == after->count[i] &&
                !memcmp(&before->sigma[i], &after->sigma[i], 4);
    }
    print_message("%d cells out of view, %d the same to the last bit\n", unseen, same);
    assert_true(unseen > 200 && same == unseen);
    td_elevation_free(&before);
    td_elevation_free(&after);
    td_fusion_free(&fusion);
    site_free(&s);
}

/* The points' squared heights above their cells are those of their noise: sigma along the rays, less what the
 * cell's own mean takes (a point's share of it). Slopes are found from the same points, so a tenth is left to
 * them. */
static void test_residuals(void **state)
{
    (void)state;
    td_random random = td_random_seed(29, 0);
    site s = site_new(false, 1);
    td_error error;
    td_fusion *fusion;
    td_fusion_tally tally;
    const td_pose pose = scene_pose(0, 0, 2.6, 0, DOWN);
    for (int noisy = 0; noisy < 2; noisy++) {
        double expected = 0, points = 0;
        td_disparity *d = scene_disparity(s.camera, s.rig, s.rig, &pose, 0.2f, scene_hills, NULL);
        for (int i = 0; i < d->width * d->height; i++) {
            td_depth_point p;
            double at[3], axis[3], slope[2];
            if (!td_depth_camera_point(&p, s.camera, i % d->width, i / d->width, d->value[i], d->sigma[i]))
                continue;
            for (int k = 0; k < 3; k++) at[k] = (double)p.p[k], axis[k] = (double)p.axis[k];
            td_pose_transform(at, &pose, at);
            td_pose_rotate(axis, &pose, axis);
            scene_height(at[0], at[1], slope);
            const double off = axis[2] - slope[0] * axis[0] - slope[1] * axis[1];
            expected += off * off;
            points++;
        }
        if (noisy) scene_noise(d, 1, 1, &random);
        check_ok(td_fusion_new(&fusion, &s.options, &error), error);
        add(fusion, &s, &pose, d, NULL, &tally);
        const double square = tally.square_m2 / (double)tally.believed;
        expected *= (1 - (double)tally.cells / points) / points;
        print_message("%zu points in %zu cells: RMS %.2f mm, their noise %.2f mm\n", tally.believed,
                      tally.cells, 1e3 * sqrt(square), noisy ? 1e3 * sqrt(expected) : 0);
        assert_true(tally.believed == tally.points && tally.gated == 0);
        if (noisy)
            check_near(square / expected, 1, 0.1);
        else
            check_less(square, 0.01 * expected);
        /* The same frame with ground half a metre away is not believed, and counts for nothing. */
        for (int i = 0; i < d->width * d->height; i++) d->value[i] *= 1.2f;
        add(fusion, &s, &pose, d, NULL, &tally);
        assert_true(tally.gated > 100 && tally.believed < tally.points / 2);
        td_fusion_free(&fusion);
        scene_disparity_free(&d);
    }
    site_free(&s);
}

/* One wrong frame among good ones leaves nothing; frames that contradict each other neither. */
static void test_gate(void **state)
{
    (void)state;
    td_random random = td_random_seed(14, 0);
    site s = site_new(true, 1);
    td_error error;
    td_fusion *fusion;
    td_fusion_tally tally;
    int right, known;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    const td_pose pose = scene_pose(0.6, 0, 2.6, 0, 0.8);
    static const double wall[] = {0, 0, 0.4, 0, 0.4, 0.4, 0, 0.2, 0.6, 0.2, 0.6};
    for (size_t i = 0; i < sizeof wall / sizeof *wall; i++) {
        works_add(fusion, &s, &pose, (works){.wall_m = wall[i]}, &random, &tally);
        assert_true(tally.reset < 5); /* at edges of the block a cell may hold either */
    }
    td_elevation *map = map_of(fusion);
    inside(&right, &known, map, 0);
    assert_true(known > 50 && right == known);
    td_elevation_free(&map);
    td_fusion_free(&fusion);
    site_free(&s);
}

/* (Cells at its front edge hold points of its face: their sigma is large, and less surely stood out.) A block
 * is taken away; behind where it stood the frames see, over its foot they do not measure (the ground
 * there is outside of what they match): rays through it clear it after N frames, and only it. */
static void test_visibility(void **state)
{
    (void)state;
    td_random random = td_random_seed(15, 0);
    site s = site_new(true, 1);
    td_error error;
    td_fusion *fusion;
    td_fusion_tally tally;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    const td_pose pose = scene_pose(-0.5, 0, 2, 0, 0.55);
    for (int i = 0; i < 2; i++) works_add(fusion, &s, &pose, (works){.wall_m = 0.6}, &random, &tally);
    assert_int_equal(tally.cleared, 0);
    td_elevation *before = map_of(fusion);
    for (int i = 1; i <= s.options.believe_frames; i++) {
        td_disparity *d = works_seen(&s, &pose, (works){0}, &random);
        for (int k = 0; k < d->width * d->height; k++) { /* the ground under the block is hidden */
            td_depth_point point;
            if (!td_depth_camera_point(&point, s.camera, k % d->width, k / d->width, d->value[k], 0.1f))
                continue;
            double p[3] = {(double)point.p[0], (double)point.p[1], (double)point.p[2]};
            td_pose_transform(p, &pose, p);
            if (p[0] > 2.1 && p[0] < 3.1 && fabs(p[1]) < 0.7) d->kind[k] = TD_DENSE_NONE;
        }
        add(fusion, &s, &pose, d, NULL, &tally);
        scene_disparity_free(&d);
        if (i < s.options.believe_frames) assert_int_equal(tally.cleared, 0);
    }
    td_elevation *after = map_of(fusion);
    int stood = 0, gone = 0, lost = 0;
    for (int i = 0; i < after->columns * after->rows; i++) {
        const double x = before->origin[0] + i % before->columns * before->cell_m;
        const double y = before->origin[1] + i / before->columns * before->cell_m;
        if (isnan(before->height[i])) continue;
        const bool block = x > 2.35 && x < 2.95 && fabs(y) < 0.55, away = x < 2.1 || x > 3.1 || fabs(y) > 0.7;
        stood += block;
        gone += block && isnan(after->height[i]);
        lost += away && isnan(after->height[i]);
    }
    print_message("block of %d cells: %d cleared by rays that pass; %d cells lost elsewhere\n", stood, gone,
                  lost);
    assert_true(stood > 40 && gone >= 0.9 * stood && lost == 0);
    td_elevation_free(&before);
    td_elevation_free(&after);
    td_fusion_free(&fusion);
    site_free(&s);
}

static void test_prior(void **state)
{
    (void)state;
    td_random random = td_random_seed(16, 0);
    site s = site_new(true, 1);
    td_error error;
    td_fusion *fusion;
    td_elevation *prior;
    td_fusion_tally tally;
    const double origin[2] = {-2, -4};
    s.options.believe_frames = 3;
    check_ok(td_elevation_new(&prior, 33, 33, 0.25, origin, "site", &error), error);
    for (int i = 0; i < 33 * 33; i++) prior->height[i] = (float)(0.02 + 0.001 * (i % 33));
    prior->crs = strdup("EPSG:32632");
    prior->height[5] = NAN;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    check_fails(td_fusion_prior(fusion, prior, 0, &error), TD_ERROR_ARGUMENT, error, "sigma_m");
    check_ok(td_fusion_prior(fusion, prior, 0.05, &error), error);
    const td_pose pose = scene_pose(0.6, 0, 2.6, 0, 0.8);
    works_add(fusion, &s, &pose, (works){0}, &random, &tally);
    check_fails(td_fusion_prior(fusion, prior, 0.05, &error), TD_ERROR_ARGUMENT, error,
                "before the first frame");
    td_elevation *map = map_of(fusion);
    assert_string_equal(map->crs, "EPSG:32632");
    int kept = 0, joined = 0, alone = 0;
    for (int i = 0; i < map->columns * map->rows; i++) {
        const double x = map->origin[0] + i % map->columns * map->cell_m;
        const double y = map->origin[1] + i / map->columns * map->cell_m;
        const double there = td_elevation_at(prior, x, y, NULL);
        switch (map->provenance[i]) {
        case TD_CELL_PRIOR: {
            assert_int_equal(map->count[i], 0);
            assert_true(isnan(map->time_s[i]));
            check_near((double)map->height[i], there, 1e-6);
            check_near((double)map->sigma[i], 0.05, 1e-6);
            kept++;
            break;
        }
        case TD_CELL_FUSED:
            assert_false(isnan(there));
            assert_true(map->count[i] > 0 && map->time_s[i] == 1 && (double)map->sigma[i] < 0.05);
            check_less(fabs((double)map->height[i]), fabs(there));
            joined++;
            break;
        case TD_CELL_MEASURED:
            assert_true(isnan(there));
            alone++;
            break;
        default:
            assert_true(isnan(map->height[i]));
        }
    }
    print_message("prior kept in %d cells, joined in %d, %d measured alone\n", kept, joined, alone);
    assert_true(kept > 1000 && joined > 300);
    td_elevation_free(&map);
    td_elevation_free(&prior);
    td_fusion_free(&fusion);
    site_free(&s);
}

/* ---- the same bytes ---- */

static void run_frames(td_fusion *fusion, const site *s, int first, int end, int threads)
{
    (void)threads;
    for (int f = first; f < end; f++) {
        td_random random = td_random_seed(17, (uint64_t)f);
        const td_pose pose = scene_pose(20 + 1.5 * f, -0.8 * f, 2.6, 0.3 * f, 0.7);
        td_disparity *d = scene_disparity(s->camera, s->rig, s->rig, &pose, 0.1f, scene_hills, NULL);
        scene_noise(d, 5, 1, &random);
        add(fusion, s, &pose, d, NULL, NULL);
        scene_disparity_free(&d);
    }
}

static char *state_of(size_t *size, const td_fusion *fusion, const char *folder)
{
    td_error error;
    char *bytes, *path = td_path_join(folder, "state");
    check_ok(td_fusion_save(fusion, path, &error), error);
    check_ok(td_file_read(&bytes, size, path, (size_t)1 << 30, &error), error);
    free(path);
    return bytes;
}

static void test_same_bytes(void **state)
{
    const char *folder = *state;
    site s = site_new(true, 1);
    td_error error;
    char *first = NULL, *tiles = td_path_join(folder, "tiles"), *path = td_path_join(folder, "state");
    size_t first_size = 0;
    const size_t tile = 128 * 128 * 64;
    s.options.cell_m = 0.015; /* many tiles */
    /* one thread in ample memory; three; two tiles in memory; killed after frame 2 and gone on. */
    for (int way = 0; way < 4; way++) {
        td_fusion *fusion;
        size_t size;
        s.options.threads = way == 1 ? 3 : 1;
        s.options.memory_bytes = way >= 2 ? 2 * tile : (size_t)1 << 30;
        s.options.folder = way >= 2 ? tiles : NULL;
        check_ok(td_fusion_new(&fusion, &s.options, &error), error);
        run_frames(fusion, &s, 0, way == 3 ? 2 : 4, 0);
        if (way >= 2) assert_true(td_fusion_memory(fusion) <= 2 * tile);
        if (way == 0) check_less((double)(6 * tile), (double)td_fusion_memory(fusion));
        if (way == 3) {
            check_ok(td_fusion_save(fusion, path, &error), error);
            td_fusion_free(&fusion);
            check_ok(td_fusion_load(&fusion, &s.options, path, &error), error);
            run_frames(fusion, &s, 2, 4, 0);
        }
        char *bytes = state_of(&size, fusion, folder);
        td_elevation *map = map_of(fusion);
        assert_true(map->columns > 128 && map->crs == NULL);
        if (way == 0) {
            first = bytes;
            first_size = size;
        } else {
            assert_int_equal(size, first_size);
            assert_memory_equal(bytes, first, size);
            free(bytes);
        }
        td_elevation_free(&map);
        td_fusion_free(&fusion);
    }
    free(first);
    free(tiles);
    free(path);
    site_free(&s);
}

/* ---- refused ---- */

static void test_damaged_files(void **state)
{
    const char *folder = *state;
    site s = site_new(true, 1);
    td_error error;
    td_fusion *fusion;
    td_random random = td_random_seed(18, 0);
    char *path = td_path_join(folder, "state"), *other = td_path_join(folder, "other");
    s.options.cell_m = 0.2;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    run_frames(fusion, &s, 0, 2, 1);
    size_t size;
    char *bytes = state_of(&size, fusion, folder);
    td_fusion_free(&fusion);
    for (int run = 0; run < 300; run++) {
        size_t cut = run % 2 ? size : td_random_below(&random, (uint32_t)size);
        char *bad = malloc(size);
        memcpy(bad, bytes, size);
        if (run % 2) bad[td_random_below(&random, (uint32_t)size)] ^= (char)(1 << run / 2 % 8);
        check_ok(td_file_write(other, bad, cut, &error), error);
        td_status status = td_fusion_load(&fusion, &s.options, other, &error);
        if (!(run % 2)) assert_int_not_equal(status, TD_OK);
        if (status != TD_OK) assert_non_null(strstr(error.message, other));
        if (status != TD_OK) assert_null(fusion);
        td_fusion_free(&fusion);
        free(bad);
    }
    check_fails(td_fusion_load(&fusion, &s.options, folder, &error), TD_ERROR_IO, error, "is a folder");
    s.options.gate_sigma = 4;
    check_fails(td_fusion_load(&fusion, &s.options, path, &error), TD_ERROR_DATA, error,
                "gate_sigma 3, now it is 4");
    s.options.gate_sigma = 3;
    strcpy(s.options.frame, "map");
    check_fails(td_fusion_load(&fusion, &s.options, path, &error), TD_ERROR_DATA, error,
                "another frame than 'map'");
    free(bytes);
    free(path);
    free(other);
    site_free(&s);
}

static void test_bad_frames(void **state)
{
    (void)state;
    site s = site_new(true, 1);
    td_error error;
    td_fusion *fusion;
    td_elevation *map;
    td_random random = td_random_seed(19, 0);
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    const td_pose pose = scene_pose(0, 0, 2.6, 0, 0.8);
    td_disparity *d = works_seen(&s, &pose, (works){0}, &random);
    double covariance[36] = {0};
    td_fusion_frame good = {s.camera, d, pose, covariance, 1}, bad = good;
    check_fails(td_fusion_map(&map, NULL, fusion, &error), TD_ERROR_DATA, error, "nothing has been measured");
    bad.site_from_rig.t[1] = NAN;
    check_fails(td_fusion_add(fusion, &bad, NULL, &error), TD_ERROR_DATA, error,
                "site_from_rig: its position");
    bad = good;
    bad.site_from_rig.q[0] = NAN;
    check_fails(td_fusion_add(fusion, &bad, NULL, &error), TD_ERROR_DATA, error, "quaternion");
    covariance[1] = 1;
    check_fails(td_fusion_add(fusion, &good, NULL, &error), TD_ERROR_DATA, error, "pose_covariance");
    covariance[1] = 0;
    d->height--;
    check_fails(td_fusion_add(fusion, &good, NULL, &error), TD_ERROR_DATA, error, "the disparities are");
    d->height++;
    check_fails(td_fusion_map(&map, NULL, fusion, &error), TD_ERROR_DATA, error, "nothing has been measured");
    /* Filled holes and NaN are no measurements. */
    const size_t n = (size_t)d->width * (size_t)d->height;
    td_fusion_tally tally;
    memset(d->kind, TD_DENSE_FILLED, n);
    check_ok(td_fusion_add(fusion, &good, &tally, &error), error);
    memset(d->kind, TD_DENSE_MATCHED, n);
    for (size_t i = 0; i < n; i++) d->value[i] = i % 3 ? NAN : i % 2 ? INFINITY : -1;
    check_ok(td_fusion_add(fusion, &good, &tally, &error), error);
    assert_int_equal(tally.points, 0);
    scene_disparity_free(&d);
    td_fusion_free(&fusion);
    /* More tiles than memory, and no folder. */
    s.options.memory_bytes = 1 << 20;
    s.options.cell_m = 0.01;
    check_ok(td_fusion_new(&fusion, &s.options, &error), error);
    d = works_seen(&s, &pose, (works){0}, &random);
    good.disparity = d;
    check_fails(td_fusion_add(fusion, &good, NULL, &error), TD_ERROR_DATA, error, "give a folder");
    td_fusion_free(&fusion);
    scene_disparity_free(&d);
    s.options.correlation_px = NAN;
    check_fails(td_fusion_new(&fusion, &s.options, &error), TD_ERROR_ARGUMENT, error, "correlation_px");
    s.options = td_fusion_options_default();
    s.options.region[0] = 1;
    check_fails(td_fusion_new(&fusion, &s.options, &error), TD_ERROR_ARGUMENT, error, "region");
    check_near(td_fusion_memory_of(1000, 1000, 0.05), 157 * 157 * 1048576., 1);
    site_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_noise_coverage),
        cmocka_unit_test(test_rig_coverage),
        cmocka_unit_test(test_excavated),
        cmocka_unit_test(test_residuals),
        cmocka_unit_test(test_gate),
        cmocka_unit_test(test_visibility),
        cmocka_unit_test(test_prior),
        cmocka_unit_test_setup_teardown(test_same_bytes, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_damaged_files, scratch_make, scratch_remove),
        cmocka_unit_test(test_bad_frames),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
