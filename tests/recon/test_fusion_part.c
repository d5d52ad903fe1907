/* Cells seen in part (recon/fusion_measure.c), on disparities of two sites known at every point, without
 * noise, for which every claim can be told beforehand:
 * - a wall 0.5 m high, level ground at its foot, and a strip of ground before it without disparities: the
 * foot's cells have nine times fewer points than the wall's, and a neighbour that is not measured. They are
 * seen nevertheless, and claimed;
 * - a lip, behind which the ground is 1 m lower and hidden: cells of which a fifth is seen are not claimed,
 * those of which nine tenths are, are; a look from above claims all. Heights claimed are right to 2 mm, for
 * which rounding and the disparities' last digits are enough. Blind to: how often such cells are wrong in
 * rendered images (apps/test_site). */
#include "recon/fusion.h"
#include "tests/check.h"
#include "tests/recon/fusion_scene.h"

static const double CELL = 0.1, WALL_AT = 2.97, GAP_FROM = 2.4, GAP_TO = 2.85;

typedef struct ground {
    double wall_m; /* height of all beyond WALL_AT; with it, nothing is known in the gap */
    double lip_at; /* m; beyond, the ground is `depth_m` lower */
    double depth_m;
} ground;

static double height_at(const ground *g, double x)
{
    if (g->wall_m > 0) return x >= WALL_AT ? g->wall_m : 0;
    return x >= g->lip_at ? -g->depth_m : 0;
}

static bool meet(double p[3], const double from[3], const double ray[3], void *user)
{
    const ground *g = user;
    if (!(ray[2] < -0.05)) return false;
    double s = (from[2] - g->wall_m) / -ray[2];
    for (const double last = (from[2] + g->depth_m) / -ray[2] + 0.01; s < last; s += 0.0005) {
        for (int k = 0; k < 3; k++) p[k] = from[k] + s * ray[k];
        if (p[2] <= height_at(g, p[0])) return !(g->wall_m > 0 && p[0] > GAP_FROM && p[0] < GAP_TO);
    }
    return false;
}

typedef struct site {
    td_rig *rig;
    td_depth_camera *camera;
    td_fusion *fusion;
} site;

static site site_new(void)
{
    site s = {.rig = scene_rig(1)};
    td_fusion_options options = td_fusion_options_default();
    td_error error;
    free(s.rig->covariance);
    s.rig->covariance = NULL;
    options.cell_m = CELL;
    check_ok(td_depth_camera_new(&s.camera, s.rig, 0, 1, 1, 12, &error), error);
    check_ok(td_fusion_new(&s.fusion, &options, &error), error);
    return s;
}

static void site_free(site *s)
{
    td_fusion_free(&s->fusion);
    td_depth_camera_free(&s->camera);
    td_rig_free(&s->rig);
}

static void look(site *s, const ground *g, td_pose pose)
{
    td_error error;
    td_fusion_tally tally;
    td_disparity *d = scene_disparity(s->camera, s->rig, s->rig, &pose, 0.1f, meet, (void *)g);
    const td_fusion_frame frame = {.camera = s->camera, .disparity = d, .site_from_rig = pose};
    check_ok(td_fusion_add(s->fusion, &frame, &tally, &error), error);
    scene_disparity_free(&d);
}

/* Of the column of cells whose centre is x, -0.4 <= y <= 0.4: how many are claimed; those that are must be
 * `height` to sigma or 2 mm, unless it is NAN. */
static int claimed(const site *s, double x, double height)
{
    td_elevation *map;
    td_error error;
    int count = 0;
    check_ok(td_fusion_map(&map, NULL, s->fusion, &error), error);
    for (int row = 0; row < map->rows; row++) {
        const int column = (int)lround((x - map->origin[0]) / CELL);
        const double y = map->origin[1] + row * CELL;
        const double h = (double)map->height[row * map->columns + column];
        if (fabs(y) > 0.4 + 1e-9 || isnan(h)) continue;
        const double sigma = (double)map->sigma[row * map->columns + column];
        if (!isnan(height)) check_near(h, height, fmax(0.002, sigma));
        count++;
    }
    td_elevation_free(&map);
    return count;
}

enum { ROWS = 9 };

static void test_foot_of_a_wall(void **state)
{
    (void)state;
    site s = site_new();
    look(&s, &(ground){.wall_m = 0.5}, scene_pose(0, 0, 2, 0, 0.6));
    assert_int_equal(claimed(&s, 2.7, NAN), 0);
    assert_int_equal(claimed(&s, 2.9, 0), ROWS);
    site_free(&s);
}

static void test_lip(void **state)
{
    (void)state;
    static const double lip[] = {2.97, 3.04};
    for (int i = 0; i < 2; i++) {
        site s = site_new();
        const ground g = {.lip_at = lip[i], .depth_m = 1};
        look(&s, &g, scene_pose(0, 0, 2, 0, 0.6));
        assert_int_equal(claimed(&s, 2.9, 0), ROWS);
        assert_int_equal(claimed(&s, 3, 0), i ? ROWS : 0);
        look(&s, &g, scene_pose(3, 0, 2, 0, 1.5));
        assert_int_equal(claimed(&s, 3, NAN), ROWS);
        assert_int_equal(claimed(&s, 3.2, -1), ROWS);
        site_free(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_foot_of_a_wall), cmocka_unit_test(test_lip)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
