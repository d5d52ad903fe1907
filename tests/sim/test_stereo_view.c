/* Proves that rays meet what they should (planes, balls, boxes, capsules and triangles in closed form, to
 * 1e-9 of the distance, for nothing but rounding is between; any terrain against all its patches one by one,
 * each crossed by a formula of the test's own), that the image is what the camera model projects, that the
 * two cameras of a rig see the same grey at the same point, that grain and noise have the mean and deviation
 * they are asked for (bounds: about four deviations of the estimate), and that images do not depend on the
 * number of threads.
 *
 * Blind to: how real soil looks; shadows, which are not cast. */
#include "sim/stereo_view.h"

#include "core/random.h"
#include "sim/stereo_view_internal.h"
#include "tests/check.h"

static td_error error;

static td_elevation *make_map(int columns, int rows, double cell, double x, double y)
{
    td_elevation *map = NULL;
    const double origin[2] = {x, y};
    check_ok(td_elevation_new(&map, columns, rows, cell, origin, "site", &error), error);
    return map;
}

static td_scene make_scene(td_elevation *ground)
{
    return (td_scene){
        .ground = ground,
        .ground_surface = {.albedo = 0.4, .contrast = 0.3, .grain_m = 0.5, .octaves = 9, .seed = 3},
        .robot_surface = {.albedo = 0.4},
        .site_from_vehicle = td_pose_identity(),
        .sun = {0, 0, 1},
        .ambient = 0.3};
}

static td_stereo_view *make_view(const td_scene *scene)
{
    td_stereo_view *view = NULL;
    check_ok(td_stereo_view_new(&view, scene, &error), error);
    return view;
}

static void random_unit(td_random *random, double v[3])
{
    double length = 0;
    for (int i = 0; i < 3; i++) v[i] = td_random_normal(random);
    for (int i = 0; i < 3; i++) length += v[i] * v[i];
    for (int i = 0; i < 3; i++) v[i] /= sqrt(length);
}

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

/* ---- the ground ---- */

static void test_plane(void **state)
{
    (void)state;
    td_elevation *map = make_map(65, 49, 0.25, -8, -6); /* x -8 … 8, y -6 … 6; heights exact in float */
    for (int r = 0; r < 49; r++)
        for (int c = 0; c < 65; c++)
            map->height[r * 65 + c] = (float)(0.5 + (c * 0.25 - 8) / 8 - (r * 0.25 - 6) / 4);
    td_scene scene = make_scene(map);
    td_stereo_view *view = make_view(&scene);
    td_random random = td_random_seed(1, 0);
    int met = 0, missed = 0;
    for (int k = 0; k < 20000; k++) {
        const double o[3] = {between(&random, -10, 10), between(&random, -8, 8), between(&random, -6, 6)};
        double d[3];
        random_unit(&random, d);
        if (k % 4 < 2) d[k % 4] = 0; /* along an axis of the grid */
        const double t = (0.5 + o[0] / 8 - o[1] / 4 - o[2]) / (d[2] - d[0] / 8 + d[1] / 4);
        const double x = o[0] + t * d[0], y = o[1] + t * d[1];
        td_view_what what;
        const double found = td_stereo_view_cast(view, o, d, &what);
        if (fabs(fabs(x) - 8) < 1e-6 || fabs(fabs(y) - 6) < 1e-6) continue;
        if (t >= 0 && fabs(x) < 8 && fabs(y) < 6) {
            check_near(found, t, 1e-9 * (1 + t));
            assert_int_equal(what, TD_SEES_GROUND);
            met++;
        } else {
            assert_true(isinf(found));
            assert_int_equal(what, TD_SEES_SKY);
            missed++;
        }
    }
    assert_true(met > 3000 && missed > 3000);
    td_stereo_view_free(&view);
    td_elevation_free(&map);
}

/* The first root of a quadratic given by its values at 0, 1/2 and 1, in [0, 1]; `least`: how near to zero it
 * comes. */
static double first_root(double f0, double f1, double f2, double *least)
{
    const double a = 2 * (f0 - 2 * f1 + f2), b = f2 - f0 - a, c = f0;
    double root = INFINITY;
    const double turning = a != 0 ? -b / (2 * a) : -1;
    if (turning > 0 && turning < 1) *least = fmin(*least, fabs(c + 0.5 * b * turning));
    *least = fmin(*least, fmin(fabs(f0), fabs(f2)));
    const double discriminant = b * b - 4 * a * c;
    if (discriminant < 0) return INFINITY;
    for (int sign = -1; sign <= 1; sign += 2) {
        const double x = fabs(a) > 1e-8 * fabs(b) ? (-b + sign * sqrt(discriminant)) / (2 * a) : -c / b;
        if (x >= -1e-9 && x <= 1 + 1e-9 && x < root) root = x;
    }
    return root;
}

/* Every patch of the map, one by one. */
static double brute_force(const td_elevation *map, const double o[3], const double d[3], double *least)
{
    double first = INFINITY;
    for (int j = 0; j + 1 < map->rows; j++)
        for (int i = 0; i + 1 < map->columns; i++) {
            const float *h = map->height + j * map->columns + i;
            double begin = 0, end = 1e3;
            const int at[2] = {i, j};
            for (int a = 0; a < 2; a++) {
                const double low = map->origin[a] + at[a] * map->cell_m, high = low + map->cell_m;
                if (d[a] == 0) {
                    if (o[a] < low || o[a] > high) end = -1;
                    continue;
                }
                const double t0 = (low - o[a]) / d[a], t1 = (high - o[a]) / d[a];
                begin = fmax(begin, fmin(t0, t1));
                end = fmin(end, fmax(t0, t1));
            }
            if (begin > end) continue;
            double f[3];
            for (int k = 0; k < 3; k++) {
                const double t = begin + 0.5 * k * (end - begin);
                const double u = (o[0] + t * d[0] - map->origin[0]) / map->cell_m - i;
                const double v = (o[1] + t * d[1] - map->origin[1]) / map->cell_m - j;
                f[k] = o[2] + t * d[2] -
                       ((1 - v) * ((1 - u) * h[0] + u * h[1]) +
                        v * ((1 - u) * h[map->columns] + u * h[map->columns + 1]));
            }
            const double root = first_root(f[0], f[1], f[2], least);
            if (root < INFINITY) first = fmin(first, begin + root * (end - begin));
        }
    return first;
}

static void test_brute_force(void **state)
{
    (void)state;
    td_random random = td_random_seed(2, 0);
    int met = 0, left_out = 0, rays = 0;
    for (int k = 0; k < 60; k++) {
        const int columns = 2 + (int)td_random_below(&random, 30),
                  rows = 2 + (int)td_random_below(&random, 30);
        td_elevation *map =
            make_map(columns, rows, between(&random, 0.05, 0.5), between(&random, -5, 5), 100);
        for (int i = 0; i < columns * rows; i++)
            map->height[i] =
                td_random_uniform(&random) < 0.02 ? NAN : (float)(0.3 * td_random_normal(&random));
        td_scene scene = make_scene(map);
        td_stereo_view *view = make_view(&scene);
        for (int n = 0; n < 400; n++, rays++) {
            double o[3], d[3];
            for (int a = 0; a < 2; a++)
                o[a] =
                    map->origin[a] + between(&random, -0.3, 1.3) * ((a ? rows : columns) - 1) * map->cell_m;
            o[2] = between(&random, -1, 1);
            random_unit(&random, d);
            if (n % 8 == 0) d[0] = 0;
            if (n % 8 == 1) d[1] = 0;
            if (n % 8 == 2) d[2] *= 0.02; /* grazing */
            if (n % 16 == 3) d[0] = d[1] = 0;
            if (n % 16 == 11) d[2] = 0;
            if (n % 8 == 4) o[0] = map->origin[0] + map->cell_m * td_random_below(&random, (uint32_t)columns);
            if (n % 8 == 5) o[1] = map->origin[1] + map->cell_m * td_random_below(&random, (uint32_t)rows);
            double least = INFINITY;
            const double expected = brute_force(map, o, d, &least);
            const double found = td_stereo_view_cast(view, o, d, NULL);
            /* A ray that touches a seam or a ridge within rounding may go either way. */
            if (least < 1e-7) {
                left_out++;
                continue;
            }
            if (isinf(expected) || isinf(found))
                assert_true(isinf(expected) && isinf(found));
            else
                check_near(found, expected, 1e-6);
            met += isfinite(found);
        }
        td_stereo_view_free(&view);
        td_elevation_free(&map);
    }
    assert_true(met > rays / 8);
    assert_true(left_out < rays / 100);
}

/* Rays of a block begin where all of them are still above the ground: the same hits as one by one. */
static void test_block(void **state)
{
    (void)state;
    td_random random = td_random_seed(5, 0);
    td_elevation *map = make_map(200, 150, 0.1, -10, -7.5);
    for (int i = 0; i < 200 * 150; i++)
        map->height[i] =
            (float)(sin(0.13 * (i % 200)) * cos(0.2 * (i / 200.)) + 0.05 * td_random_normal(&random));
    td_ground_rays ground;
    check_ok(td_ground_rays_new(&ground, map, &error), error);
    int helped = 0;
    for (int k = 0; k < 400; k++) {
        const double o[3] = {between(&random, -12, 12), between(&random, -9, 9), between(&random, 0.5, 5)};
        double d[32][3], middle[3], spread = between(&random, 1e-4, 1e-2);
        random_unit(&random, middle);
        middle[2] = -fabs(middle[2]);
        for (int i = 0; i < 32; i++) {
            double length = 0;
            for (int a = 0; a < 3; a++) d[i][a] = middle[a] + spread * td_random_normal(&random);
            for (int a = 0; a < 3; a++) length += d[i][a] * d[i][a];
            for (int a = 0; a < 3; a++) d[i][a] /= sqrt(length);
        }
        const double clear = td_ground_rays_clear(&ground, o, (const double(*)[3])d, 32, 0);
        const double near = td_ground_rays_clear(&ground, o, (const double(*)[3])d, 4, clear);
        helped += clear > 1;
        for (int i = 0; i < 32; i++) {
            const double alone = td_ground_rays_cast(&ground, o, d[i], 0, INFINITY);
            const double together = td_ground_rays_cast(&ground, o, d[i], i < 4 ? near : clear, INFINITY);
            if (isinf(alone))
                assert_true(isinf(together));
            else
                check_near(together, alone, 1e-9 * (1 + alone));
        }
    }
    assert_true(helped > 100);
    td_ground_rays_free(&ground);
    td_elevation_free(&map);
}

static void test_update(void **state)
{
    (void)state;
    td_random random = td_random_seed(3, 0);
    td_elevation *map = make_map(100, 70, 0.1, 0, 0);
    for (int i = 0; i < 7000; i++) map->height[i] = (float)(0.05 * td_random_normal(&random));
    td_scene scene = make_scene(map);
    td_stereo_view *view = make_view(&scene);
    for (int r = 20; r < 31; r++)
        for (int c = 40; c < 77; c++) map->height[r * 100 + c] += c < 60 ? -0.7f : 0.6f;
    td_stereo_view_update(view, 40, 20, 37, 11);
    td_stereo_view *fresh = make_view(&scene);
    for (int k = 0; k < 20000; k++) {
        const double o[3] = {between(&random, 0, 10), between(&random, 0, 7), between(&random, 0.2, 2)};
        double d[3];
        random_unit(&random, d);
        const double a = td_stereo_view_cast(view, o, d, NULL), b = td_stereo_view_cast(fresh, o, d, NULL);
        assert_true(a == b);
    }
    const double above[3] = {5, 2.5, 3}, down[3] = {0, 0, -1};
    check_near(td_stereo_view_cast(view, above, down, NULL), 3.7, 0.3);
    td_stereo_view_free(&view);
    td_stereo_view_free(&fresh);
    td_elevation_free(&map);
}

/* ---- bodies ---- */

static const char machine[] =
    "<robot name='m'><link name='base'>"
    "<collision><origin xyz='1 0 0' rpy='0.3 0.2 0.1'/><geometry><sphere "
    "radius='0.5'/></geometry></collision>"
    "<collision><origin xyz='-2 0 0' rpy='0 0 0.7853981633974483'/><geometry><box size='1 1 "
    "2'/></geometry></collision>"
    "</link><link name='arm'>"
    "<collision><origin xyz='0 0 0' rpy='0 1.5707963267948966 0'/><geometry><cylinder radius='0.25' "
    "length='2'/></geometry></collision>"
    "</link><joint name='turn' type='revolute'><parent link='base'/><child link='arm'/><origin xyz='0 4 0'/>"
    "<axis xyz='0 0 1'/><limit lower='-3' upper='3' velocity='1' effort='1'/></joint></robot>";

static void check_cast(const td_stereo_view *view, double ox, double oy, double oz, double dx, double dy,
                       double dz, double expected, td_view_what expected_what)
{
    const double o[3] = {ox, oy, oz}, d[3] = {dx, dy, dz};
    td_view_what what;
    const double found = td_stereo_view_cast(view, o, d, &what);
    if (isinf(expected))
        assert_true(isinf(found));
    else
        check_near(found, expected, 1e-9);
    assert_int_equal(what, expected_what);
}

static void test_primitives(void **state)
{
    (void)state;
    td_scene scene = make_scene(NULL);
    check_ok(td_robot_parse(&scene.robot, machine, sizeof machine - 1, NULL, 0, "m", &error), error);
    td_stereo_view *view = make_view(&scene);
    check_cast(view, 1, 0, 5, 0, 0, -1, 4.5, TD_SEES_ROBOT);   /* ball */
    check_cast(view, 1.3, 0, 5, 0, 0, -1, 4.6, TD_SEES_ROBOT); /* 0.3, 0.4, 0.5 */
    check_cast(view, 1.51, 0, 5, 0, 0, -1, INFINITY, TD_SEES_SKY);
    check_cast(view, -2, 0, 5, 0, 0, -1, 4, TD_SEES_ROBOT);             /* box, from above */
    check_cast(view, -2, -5, 0, 0, 1, 0, 5 - sqrt(0.5), TD_SEES_ROBOT); /* its edge, turned by 45 deg */
    check_cast(view, -2, 0, 0, 0, 0, 1, INFINITY, TD_SEES_SKY);         /* from inside: not seen */
    check_cast(view, 0.5, 4, 5, 0, 0, -1, 4.75, TD_SEES_ROBOT);         /* capsule: the wall */
    check_cast(view, 1.15, 4, 5, 0, 0, -1, 4.8, TD_SEES_ROBOT);         /* its end: 0.15, 0.2, 0.25 */
    check_cast(view, 5, 4, 0, -1, 0, 0, 3.75, TD_SEES_ROBOT);           /* along its axis */
    scene.q[0] = 1.5707963267948966;
    scene.site_from_vehicle.t[2] = 10;
    check_ok(td_stereo_view_move(view, &error), error);
    check_cast(view, 0, 4.9, 20, 0, 0, -1, 9.75, TD_SEES_ROBOT);
    check_cast(view, 0.5, 4, 20, 0, 0, -1, INFINITY, TD_SEES_SKY);
    td_stereo_view_free(&view);
    td_robot_free(&scene.robot);
}

static void random_beam(double (*ray)[3], int count, td_random *random)
{
    double middle[3], spread = pow(10, between(random, -4, 0));
    random_unit(random, middle);
    for (int i = 0; i < count; i++) {
        double length = 0;
        for (int a = 0; a < 3; a++) ray[i][a] = middle[a] + spread * td_random_normal(random);
        for (int a = 0; a < 3; a++) length += ray[i][a] * ray[i][a];
        for (int a = 0; a < 3; a++) ray[i][a] /= sqrt(length);
    }
}

/* What the rays of a beam meet is the same, to the bit, with the beam's list as with the tree. */
static void check_beams(const td_stereo_view *view, td_random *random)
{
    int listed = 0, met = 0;
    for (int k = 0; k < 2000; k++) {
        const double o[3] = {between(random, -9, 9), between(random, -9, 9), between(random, -9, 9)};
        double ray[16][3];
        td_beam beam;
        random_beam(ray, 16, random);
        if (k % 7 == 0) ray[3][0] = NAN;
        td_bodies_in_beam(&beam, &view->fixed, o, (const double(*)[3])ray, 16);
        listed += !beam.many;
        for (int i = 0; i < 16; i++) {
            uint32_t alone = 0, together = 0;
            if (isnan(ray[i][0])) continue;
            const double a = td_bodies_cast(&view->fixed, NULL, o, ray[i], INFINITY, &alone);
            const double b = td_bodies_cast(&view->fixed, &beam, o, ray[i], INFINITY, &together);
            assert_true(a == b && alone == together);
            met += isfinite(a) && !beam.many;
        }
    }
    assert_true(listed > 500 && met > 500);
}

/* Many tetrahedra in a tree against each of their triangles; a ball through a mesh of many sides. */
static void test_triangles(void **state)
{
    (void)state;
    enum { COUNT = 200 };
    static double corner[COUNT][4][3];
    static uint32_t side[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    static td_solid solid[COUNT];
    td_random random = td_random_seed(8, 0);
    td_scene scene = make_scene(NULL);
    for (int i = 0; i < COUNT; i++) {
        for (int k = 0; k < 12; k++) corner[i][k / 3][k % 3] = 0.4 * td_random_normal(&random);
        solid[i] = (td_solid){.name = "t",
                              .site_from_solid = td_pose_identity(),
                              .corner_count = 4,
                              .triangle_count = 4,
                              .corner = corner[i],
                              .triangle = side,
                              .surface = {.albedo = 0.5}};
        for (int a = 0; a < 3; a++) solid[i].site_from_solid.t[a] = between(&random, -5, 5);
    }
    scene.solid = solid;
    scene.solid_count = COUNT;
    td_stereo_view *view = make_view(&scene);
    int met = 0;
    for (int k = 0; k < 3000; k++) {
        const double o[3] = {between(&random, -7, 7), between(&random, -7, 7), between(&random, -7, 7)};
        double d[3], first = INFINITY;
        random_unit(&random, d);
        if (k % 5 < 3) d[k % 5] = 0;
        for (int i = 0; i < COUNT; i++)
            for (int t = 0; t < 4; t++) {
                /* Barycentric coordinates by determinants: o + s d = a + v (b - a) + w (c - a). */
                double m[3][3], r[3];
                for (int a = 0; a < 3; a++) {
                    const double *p = corner[i][side[t][0]];
                    m[a][0] = -d[a];
                    m[a][1] = corner[i][side[t][1]][a] - p[a];
                    m[a][2] = corner[i][side[t][2]][a] - p[a];
                    r[a] = o[a] - p[a] - solid[i].site_from_solid.t[a];
                }
                double x[4];
                for (int c = -1; c < 3; c++) {
                    double n[3][3];
                    memcpy(n, m, sizeof n);
                    for (int a = 0; a < 3 && c >= 0; a++) n[a][c] = r[a];
                    x[c + 1] = n[0][0] * (n[1][1] * n[2][2] - n[1][2] * n[2][1]) -
                               n[0][1] * (n[1][0] * n[2][2] - n[1][2] * n[2][0]) +
                               n[0][2] * (n[1][0] * n[2][1] - n[1][1] * n[2][0]);
                }
                const double s = x[1] / x[0], v = x[2] / x[0], w = x[3] / x[0];
                if (v >= 0 && w >= 0 && v + w <= 1 && s >= 0) first = fmin(first, s);
            }
        const double found = td_stereo_view_cast(view, o, d, NULL);
        if (isinf(first))
            assert_true(isinf(found));
        else
            check_near(found, first, 1e-9);
        met += isfinite(first);
    }
    assert_true(met > 200);
    check_beams(view, &random);
    td_stereo_view_free(&view);
}

/* ---- images ---- */

static td_rig *make_rig(int width, int height, double focal, td_camera_model model)
{
    td_rig *rig = td_rig_new();
    assert_non_null(rig);
    rig->count = 2;
    for (int k = 0; k < 2; k++) {
        td_rig_camera *c = rig->camera + k;
        snprintf(c->name, sizeof c->name, "%s", k ? "right" : "left");
        c->camera = (td_camera){.model = model,
                                .width = width,
                                .height = height,
                                .parameter = {focal, focal, 0.5 * width + 3, 0.5 * height - 5}};
        if (model == TD_CAMERA_BROWN5) c->camera.parameter[4] = -0.15;
        c->camera_from_rig = td_pose_identity();
    }
    rig->camera[1].camera_from_rig.t[0] = -0.4;
    return rig;
}

/* At (0, 0, height), looking forward and down. */
static td_pose looking_down(double pitch, double height)
{
    const double r[9] = {0, -sin(pitch), cos(pitch), -1, 0, 0, 0, -cos(pitch), -sin(pitch)},
                 t[3] = {0, 0, height};
    return td_pose_from_rotation(r, t);
}

static td_view_options plain(void)
{
    td_view_options o = td_view_options_default();
    o.blur_px = o.vignetting = o.read_noise = o.shot_noise = 0;
    return o;
}

static td_elevation *hills(int n)
{
    td_elevation *map = make_map(n, n, 20.0 / n, -2, -10);
    for (int i = 0; i < n * n; i++) {
        const double x = 20.0 * (i % n) / n, y = 20.0 * (i / n) / n;
        map->height[i] = (float)(0.2 * sin(1.1 * x) * cos(0.9 * y) + 0.03 * sin(5 * x + y));
    }
    return map;
}

static void test_left_and_right(void **state)
{
    (void)state;
    td_elevation *map = hills(300);
    td_scene scene = make_scene(map);
    td_stereo_view *view = make_view(&scene);
    td_rig *rig = make_rig(640, 480, 700, TD_CAMERA_BROWN5);
    const td_pose pose = looking_down(0.8, 3);
    td_view_options options = plain();
    td_view *side[2];
    for (int k = 0; k < 2; k++)
        check_ok(td_stereo_view_render(&side[k], view, rig, k, &pose, 0, &options, &error), error);
    double squares = 0, mean = 0, power = 0;
    int count = 0;
    for (int y = 5; y < 475; y += 3)
        for (int x = 5; x < 635; x += 3) {
            const double at[2] = {x, y};
            double ray[3], p[3], q[3], pixel[2];
            assert_true(td_camera_unproject(ray, NULL, NULL, &rig->camera[0].camera, at));
            const double z = side[0]->depth[y * 640 + x];
            for (int a = 0; a < 3; a++) p[a] = ray[a] / ray[2] * z;
            td_pose_transform(q, &rig->camera[1].camera_from_rig, p);
            if (!td_camera_project(pixel, NULL, NULL, &rig->camera[1].camera, q)) continue;
            if (!(pixel[0] > 3 && pixel[0] < 636 && pixel[1] > 3 && pixel[1] < 476)) continue;
            const int u = (int)lround(pixel[0]), v = (int)lround(pixel[1]);
            if (fabs(side[1]->depth[v * 640 + u] - q[2]) > 0.05 * q[2]) continue; /* hidden from the other */
            const double left = side[0]->image->data[y * 640 + x];
            const double right = td_image_sample(side[1]->image, pixel[0], pixel[1], 0);
            squares += (left - right) * (left - right);
            mean += left;
            power += left * left;
            count++;
        }
    const double rms = sqrt(squares / count),
                 deviation = sqrt(power / count - (mean / count) * (mean / count));
    print_message("left and right: %d points, RMS %.2f of %.1f grey levels\n", count, rms, deviation);
    assert_true(count > 10000);
    check_less(rms, 0.1 * deviation);
    assert_true(mean / count > 60 && mean / count < 140);
    for (int k = 0; k < 2; k++) td_view_free(&side[k]);
    td_rig_free(&rig);
    td_stereo_view_free(&view);
    td_elevation_free(&map);
}

static void test_threads(void **state)
{
    (void)state;
    td_elevation *map = hills(120);
    td_scene scene = make_scene(map);
    check_ok(td_robot_parse(&scene.robot, machine, sizeof machine - 1, NULL, 0, "m", &error), error);
    scene.site_from_vehicle.t[0] = 5;
    td_stereo_view *view = make_view(&scene);
    td_rig *rig = make_rig(200, 150, 180, TD_CAMERA_PINHOLE);
    const td_pose pose = looking_down(0.5, 3);
    td_view *first = NULL;
    for (int threads = 1; threads < 6; threads += 2) {
        td_view_options options = td_view_options_default();
        options.threads = threads;
        td_view *out = NULL;
        check_ok(td_stereo_view_render(&out, view, rig, 1, &pose, 7, &options, &error), error);
        if (first) {
            assert_memory_equal(out->image->data, first->image->data, 200 * 150);
            assert_memory_equal(out->depth, first->depth, 200 * 150 * sizeof(float));
            td_view_free(&out);
        } else {
            first = out;
        }
    }
    int robot = 0;
    for (int i = 0; i < 200 * 150; i++) robot += first->what[i] == TD_SEES_ROBOT;
    assert_true(robot > 100);
    td_view_free(&first);
    td_rig_free(&rig);
    td_stereo_view_free(&view);
    td_robot_free(&scene.robot);
    td_elevation_free(&map);
}

/* A slanted picture whose grey grows along x and y: its outline is the quadrangle of its projected corners,
 * its grey that of the point on it that each pixel sees, and its saddle is where it is projected. */
static void test_picture(void **state)
{
    (void)state;
    td_image *image = NULL;
    check_ok(td_image_new(&image, 100, 60, 1, &error), error);
    for (int y = 0; y < 60; y++)
        for (int x = 0; x < 100; x++) image->data[y * 100 + x] = (uint8_t)(20 + x + 2 * y);
    const double turn[3] = {0.3, -0.4, 0.2};
    td_scene_picture picture = {.name = "ramp", .link = -1, .width_m = 1, .height_m = 0.6, .image = image};
    td_rotation_exp(picture.site_from_picture.q, turn);
    memcpy(picture.site_from_picture.t, (double[3]){-0.45, -0.3, 2}, sizeof picture.site_from_picture.t);
    td_scene scene = make_scene(NULL);
    scene.picture = &picture;
    scene.picture_count = 1;
    scene.ambient = 1;
    td_stereo_view *view = make_view(&scene);
    td_rig *rig = make_rig(320, 240, 400, TD_CAMERA_PINHOLE);
    const td_pose pose = td_pose_identity();
    td_view_options options = plain();
    td_view *out = NULL;
    check_ok(td_stereo_view_render(&out, view, rig, 0, &pose, 0, &options, &error), error);
    double corner[4][2];
    for (int k = 0; k < 4; k++) {
        const double local[3] = {k == 1 || k == 2, k > 1 ? 0.6 : 0, 0};
        double p[3];
        td_pose_transform(p, &picture.site_from_picture, local);
        assert_true(td_camera_project(corner[k], NULL, NULL, &rig->camera[0].camera, p));
    }
    int inside_count = 0;
    for (int y = 0; y < 240; y++)
        for (int x = 0; x < 320; x++) {
            double nearest = INFINITY; /* signed distance to the outline, positive inside */
            for (int k = 0; k < 4; k++) {
                const double *a = corner[k], *b = corner[(k + 1) % 4];
                const double dx = b[0] - a[0], dy = b[1] - a[1];
                nearest = fmin(nearest, (dx * (y - a[1]) - dy * (x - a[0])) / hypot(dx, dy));
            }
            if (fabs(nearest) > 1e-3)
                assert_int_equal(out->what[y * 320 + x], nearest > 0 ? TD_SEES_PICTURE : TD_SEES_SKY);
            if (nearest < 3) continue;
            inside_count++;
            const td_camera *c = &rig->camera[0].camera;
            const double z = out->depth[y * 320 + x];
            const double p[3] = {(x - c->parameter[2]) / c->parameter[0] * z,
                                 (y - c->parameter[3]) / c->parameter[1] * z, z};
            const td_pose picture_from_site = td_pose_inverse(&picture.site_from_picture);
            double local[3];
            td_pose_transform(local, &picture_from_site, p);
            check_near(local[2], 0, 1e-6);
            check_near(out->image->data[y * 320 + x],
                       20 + (100 * local[0] - 0.5) + 2 * (100 * local[1] - 0.5), 0.55);
        }
    assert_true(inside_count > 5000);
    td_view_free(&out);
    td_rig_free(&rig);
    td_stereo_view_free(&view);
    td_image_free(&image);
}

/* An empty scene is evenly bright: what varies is noise and the fall of light to the corners. */
static void test_sensor(void **state)
{
    (void)state;
    td_scene scene = make_scene(NULL);
    td_stereo_view *view = make_view(&scene);
    td_rig *rig = make_rig(400, 300, 300, TD_CAMERA_PINHOLE);
    const td_pose pose = td_pose_identity();
    td_view_options options = plain();
    options.read_noise = 2;
    options.shot_noise = 0.05;
    options.gain = 0.5;
    options.offset = 8;
    td_view *out[2];
    for (int k = 0; k < 2; k++)
        check_ok(td_stereo_view_render(&out[k], view, rig, 0, &pose, (uint64_t)k, &options, &error), error);
    const double value = 0.8 * 127.5 + 8;
    double sum = 0, squares = 0, product = 0;
    const int count = 400 * 300;
    for (int i = 0; i < count; i++) {
        const double a = out[0]->image->data[i] - value, b = out[1]->image->data[i] - value;
        sum += a;
        squares += a * a;
        product += a * b;
        assert_true(isnan(out[0]->depth[i]));
    }
    const double variance = 4 + 0.05 * value + 1.0 / 12;
    check_near(sum / count, 0, 4 * sqrt(variance / count));
    check_near(squares / count, variance, 4 * variance * sqrt(2.0 / count));
    check_near(product / count, 0, 4 * variance / sqrt(count)); /* another frame, other noise */
    for (int k = 0; k < 2; k++) td_view_free(&out[k]);
    options = plain();
    options.vignetting = 1;
    check_ok(td_stereo_view_render(&out[0], view, rig, 0, &pose, 0, &options, &error), error);
    const double x = (0 - 203.) / 300, y = (0 - 145.) / 300, square = 1 / (1 + x * x + y * y);
    check_near(out[0]->image->data[0], 204 * square * square, 0.51);
    td_view_free(&out[0]);
    td_rig_free(&rig);
    td_stereo_view_free(&view);
}

static void grain_moments(double *mean, double *deviation, const td_surface *surface, float footprint)
{
    td_random random = td_random_seed(4, 0);
    double sum = 0, squares = 0;
    enum { BLOCKS = 1500 };
    for (int k = 0; k < BLOCKS; k++) {
        double p[3][TD_GRAIN_BLOCK];
        float f[TD_GRAIN_BLOCK], r[TD_GRAIN_BLOCK];
        for (int i = 0; i < TD_GRAIN_BLOCK; i++) {
            for (int a = 0; a < 3; a++) p[a][i] = between(&random, -100, 100);
            f[i] = footprint;
        }
        td_grain(r, surface, p[0], p[1], p[2], f, TD_GRAIN_BLOCK);
        for (int i = 0; i < TD_GRAIN_BLOCK; i++) {
            sum += r[i];
            squares += (double)r[i] * r[i];
        }
    }
    const double n = BLOCKS * (double)TD_GRAIN_BLOCK;
    *mean = sum / n;
    *deviation = sqrt(squares / n - *mean * *mean);
}

static void test_grain(void **state)
{
    (void)state;
    td_surface surface = {.albedo = 0.5, .contrast = 0.2, .grain_m = 0.3, .octaves = 1, .seed = 9};
    double mean, deviation;
    for (; surface.octaves <= 8; surface.octaves += 7) {
        grain_moments(&mean, &deviation, &surface, 1e-5f);
        check_near(mean, 0.5, 0.002);
        check_near(deviation, 0.1, 0.002);
    }
    grain_moments(&mean, &deviation, &surface, 1.0f); /* a pixel wider than every grain: plain */
    check_near(mean, 0.5, 1e-6);
    check_near(deviation, 0, 1e-6);
    /* Continuous across cells: a step of 1e-7 of a grain changes it by no more than the slope allows. */
    double x[2], y[2] = {0.3, 0.3}, z[2] = {0.1, 0.1};
    const float f[2] = {1e-5f, 1e-5f};
    float r[2];
    surface.octaves = 1;
    for (int k = -200; k < 200; k++) {
        x[0] = 0.3 * (k - 0.17) - 1e-6;
        x[1] = x[0] + 2e-6;
        td_grain(r, &surface, x, y, z, f, 2);
        check_near(r[0], r[1], 1e-4);
    }
}

static void test_refusals(void **state)
{
    (void)state;
    td_scene scene = make_scene(NULL);
    td_stereo_view *view = make_view(&scene);
    td_rig *rig = make_rig(20, 10, 20, TD_CAMERA_PINHOLE);
    const td_pose pose = td_pose_identity();
    td_view *out = NULL;
    td_view_options options = td_view_options_default();
    check_fails(td_stereo_view_render(&out, view, rig, 2, &pose, 0, NULL, &error), TD_ERROR_ARGUMENT, error,
                "the rig has 2");
    options.samples = 0;
    check_fails(td_stereo_view_render(&out, view, rig, 0, &pose, 0, &options, &error), TD_ERROR_ARGUMENT,
                error, "samples");
    options = td_view_options_default();
    options.blur_px = NAN;
    check_fails(td_stereo_view_render(&out, view, rig, 0, &pose, 0, &options, &error), TD_ERROR_ARGUMENT,
                error, "blur_px");
    assert_null(out);
    td_stereo_view_free(&view);
    scene.sun[2] = 2;
    check_fails(td_stereo_view_new(&view, &scene, &error), TD_ERROR_ARGUMENT, error, "sun");
    td_rig_free(&rig);
}

static void test_options_of_scene(void **state)
{
    (void)state;
    const td_scene_image image = {.samples = 2,
                                  .blur_px = 0.1,
                                  .vignetting = 0.2,
                                  .gain = 1.3,
                                  .offset = 4,
                                  .read_noise = 0.5,
                                  .shot_noise = 0.06};
    const td_view_options o = td_view_options_of_scene(&image);
    assert_int_equal(o.samples, image.samples);
    assert_true(o.blur_px == image.blur_px && o.vignetting == image.vignetting);
    assert_true(o.gain == image.gain && o.offset == image.offset);
    assert_true(o.read_noise == image.read_noise && o.shot_noise == image.shot_noise);
    assert_true(o.seed == 0 && o.threads == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_plane),
        cmocka_unit_test(test_brute_force),
        cmocka_unit_test(test_block),
        cmocka_unit_test(test_update),
        cmocka_unit_test(test_primitives),
        cmocka_unit_test(test_triangles),
        cmocka_unit_test(test_left_and_right),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_picture),
        cmocka_unit_test(test_sensor),
        cmocka_unit_test(test_grain),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_options_of_scene),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
