/* Proves: triangles are Delaunay's (no point within a circumcircle, all of the hull covered), for random
 * points, grids (four points on each circle), duplicates and coordinates of UTM's size, where not one point
 * is lost; they come counter-clockwise and sorted. Grids hold the heights of planes exactly, miss no cell on
 * a common side, and their sigma is what noise drawn from the corners' joint covariance leaves. References:
 * every circle against every point, in 64-bit integers; closed forms; Monte Carlo, bound of 99.9 % for its
 * count. Blind to: whether a plane between three points is what the ground is like. */
#include <string.h>
#include <time.h>

#include "core/random.h"
#include "recon/tin.h"
#include "tests/check.h"

typedef int64_t wide;

/* Points on a raster of 2^-10 m, so that integers hold them exactly; at most 16 m apart, so that products
 * fit. */
static long long units(double x)
{
    return (long long)(x * 1024);
}

static wide turn(const double *a, const double *b, const double *c)
{
    return (wide)(units(b[0]) - units(a[0])) * (units(c[1]) - units(a[1])) -
           (wide)(units(b[1]) - units(a[1])) * (units(c[0]) - units(a[0]));
}

/* d strictly within the circle through a, b, c (counter-clockwise). */
static bool within(const double *a, const double *b, const double *c, const double *d)
{
    const double *p[3] = {a, b, c};
    wide x[3], y[3], z[3];
    for (int i = 0; i < 3; i++) {
        x[i] = units(p[i][0]) - units(d[0]);
        y[i] = units(p[i][1]) - units(d[1]);
        z[i] = x[i] * x[i] + y[i] * y[i];
    }
    return x[0] * (y[1] * z[2] - y[2] * z[1]) - y[0] * (x[1] * z[2] - x[2] * z[1]) +
               z[0] * (x[1] * y[2] - x[2] * y[1]) >
           0;
}

/* Twice the area of the convex hull (Andrew's monotone chain), and its corners. */
static int by_plan(const void *a, const void *b)
{
    const double *p = a, *q = b;
    if (p[0] != q[0]) return p[0] < q[0] ? -1 : 1;
    return p[1] < q[1] ? -1 : p[1] > q[1];
}

static wide hull_area(const double (*xyz)[3], size_t n)
{
    double(*p)[3] = malloc(n * sizeof *p), (*h)[3] = malloc((2 * n + 1) * sizeof *h);
    size_t k = 0;
    wide area = 0;
    memcpy(p, xyz, n * sizeof *p);
    qsort(p, n, sizeof *p, by_plan);
    for (size_t i = 0; i < n; i++) {
        while (k >= 2 && turn(h[k - 2], h[k - 1], p[i]) <= 0) k--;
        memcpy(h[k++], p[i], sizeof *h);
    }
    for (size_t i = n - 1, lower = k + 1; i-- > 0;) {
        while (k >= lower && turn(h[k - 2], h[k - 1], p[i]) <= 0) k--;
        memcpy(h[k++], p[i], sizeof *h);
    }
    for (size_t i = 1; i + 2 < k; i++) area += turn(h[0], h[i], h[i + 1]);
    free(p);
    free(h);
    return area;
}

/* All there is to ask of a triangulation. */
static void check_delaunay(const double (*xyz)[3], size_t n, const uint32_t (*t)[3], size_t count)
{
    wide area = 0;
    for (size_t i = 0; i < count; i++) {
        const double *a = xyz[t[i][0]], *b = xyz[t[i][1]], *c = xyz[t[i][2]];
        assert_true(turn(a, b, c) > 0);
        area += turn(a, b, c);
        assert_true(t[i][0] < t[i][1] && t[i][0] < t[i][2]);
        if (i > 0) assert_true(memcmp(t[i - 1], t[i], sizeof *t) != 0 && t[i - 1][0] <= t[i][0]);
        if (i > 0 && t[i - 1][0] == t[i][0]) assert_true(t[i - 1][1] < t[i][1]);
        for (size_t k = 0; k < n; k++) assert_false(within(a, b, c, xyz[k]));
    }
    assert_true(area == hull_area(xyz, n));
}

static double on_raster(td_random *random, double extent)
{
    return floor(extent * 1024 * td_random_uniform(random)) / 1024;
}

static void test_random_points(void **state)
{
    (void)state;
    enum { N = 400 };
    td_random random = td_random_seed(1, 1);
    td_error error = {0};
    double xyz[N][3], far_off[N][3];
    uint32_t(*t)[3], (*far_t)[3];
    size_t count, far_count;
    for (int i = 0; i < N; i++)
        for (int k = 0; k < 3; k++) xyz[i][k] = on_raster(&random, 10);
    check_ok(td_tin_triangulate(&t, &count, (const double(*)[3])xyz, N, &error), error);
    check_delaunay((const double(*)[3])xyz, N, (const uint32_t(*)[3])t, count);
    /* The same elsewhere in UTM: 1 mm is the 2^33rd part of a northing. */
    for (int i = 0; i < N; i++) {
        far_off[i][0] = xyz[i][0] + 691000;
        far_off[i][1] = xyz[i][1] + 5334000;
        far_off[i][2] = xyz[i][2];
    }
    check_ok(td_tin_triangulate(&far_t, &far_count, (const double(*)[3])far_off, N, &error), error);
    assert_int_equal(far_count, count);
    assert_memory_equal(far_t, t, count * sizeof *t);
    free(far_t);
    free(t);
}

/* Every quarter of a grid is a degenerate case. */
static void test_grid_points(void **state)
{
    (void)state;
    enum { SIDE = 17, N = SIDE * SIDE };
    td_error error = {0};
    double xyz[N][3];
    uint32_t(*t)[3], (*again)[3];
    size_t count, same;
    for (int i = 0; i < N; i++) {
        xyz[i][0] = 691000 + 0.25 * (i % SIDE);
        xyz[i][1] = 5334000 + 0.25 * (i / SIDE); /* row */
        xyz[i][2] = 0;
    }
    check_ok(td_tin_triangulate(&t, &count, (const double(*)[3])xyz, N, &error), error);
    assert_int_equal(count, 2 * (SIDE - 1) * (SIDE - 1));
    check_delaunay((const double(*)[3])xyz, N, (const uint32_t(*)[3])t, count);
    check_ok(td_tin_triangulate(&again, &same, (const double(*)[3])xyz, N, &error), error);
    assert_memory_equal(again, t, count * sizeof *t);
    free(again);
    free(t);
}

static void test_duplicates(void **state)
{
    (void)state;
    td_error error = {0};
    const double xyz[][3] = {{0, 0, 1}, {1, 0, 2}, {0, 0, 5},    {0, 1, 3},
                             {1, 1, 4}, {1, 0, 9}, {-0.0, 0, 7}, {2, 3, 0}};
    uint32_t(*t)[3];
    size_t count;
    bool used[8] = {false};
    check_ok(td_tin_triangulate(&t, &count, xyz, 8, &error), error);
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) used[t[i][k]] = true;
    const bool expected[8] = {true, true, false, true, true, false, false, true};
    assert_memory_equal(used, expected, sizeof used);
    check_delaunay(xyz, 8, (const uint32_t(*)[3])t, count);
    free(t);
}

static void test_refused(void **state)
{
    (void)state;
    td_error error = {0};
    uint32_t(*t)[3];
    size_t count;
    double line[5][3] = {{691000.25, 5334000.5, 1},
                         {691001.25, 5334001.5, 2},
                         {691002.25, 5334002.5, 3},
                         {691009.25, 5334009.5, 3},
                         {691002.25, 5334002.5, 8}};
    check_fails(td_tin_triangulate(&t, &count, (const double(*)[3])line, 5, &error), TD_ERROR_DATA, error,
                "on one line");
    assert_true(t == NULL && count == 0);
    check_fails(td_tin_triangulate(&t, &count, (const double(*)[3])line, 2, &error), TD_ERROR_DATA, error,
                "2 points");
    line[3][2] = NAN;
    check_fails(td_tin_triangulate(&t, &count, (const double(*)[3])line, 5, &error), TD_ERROR_ARGUMENT, error,
                "point 3");
    td_elevation *map = NULL;
    const double three[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    const uint32_t bad[1][3] = {{0, 1, 3}};
    check_ok(td_elevation_new(&map, 2, 2, 1, (double[]){0, 0}, "site", &error), error);
    check_fails(td_tin_grid(map, three, 3, bad, 1, NULL, NULL, 0, &error), TD_ERROR_ARGUMENT, error,
                "triangle 0");
    check_fails(td_tin_grid(map, three, 3, bad, 0, NULL, NULL, NAN, &error), TD_ERROR_ARGUMENT, error,
                "longest_m");
    assert_true(isnan(map->height[0]));
    td_elevation_free(&map);
}

/* Seconds that 100 000 points take: 0 random, 1 on a parabola (its vertex the hub of a fan), 2 random with
 * one far off. */
static double seconds_for(int kind)
{
    enum { N = 100000 };
    td_random random = td_random_seed(3, 1);
    td_error error = {0};
    double(*xyz)[3] = calloc(N, sizeof *xyz);
    uint32_t(*t)[3];
    size_t count;
    for (int i = 0; i < N; i++) {
        const double u = td_random_uniform(&random), v = td_random_uniform(&random);
        xyz[i][0] = kind == 1 ? (double)i / N : u;
        xyz[i][1] = kind == 1 ? xyz[i][0] * xyz[i][0] : v;
    }
    if (kind == 2) xyz[5][0] = 1e7;
    const clock_t begin = clock();
    check_ok(td_tin_triangulate(&t, &count, (const double(*)[3])xyz, N, &error), error);
    const double seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
    if (kind == 1) assert_int_equal(count, N - 2);
    free(t);
    free(xyz);
    return seconds;
}

/* Neither takes quadratic time, which was 20 times as long as random points take: at most five times. */
static void test_hard_points(void **state)
{
    (void)state;
    const double easy = seconds_for(0), curve = seconds_for(1), far = seconds_for(2);
    print_message("100 000 points: %.0f ms, on a curve %.0f, one far off %.0f\n", 1e3 * easy, 1e3 * curve,
                  1e3 * far);
    check_less(curve, 5 * easy);
    check_less(far, 5 * easy);
}

/* Nothing is lost among many at UTM's coordinates, whose points no raster makes exact. */
static void test_many(void **state)
{
    (void)state;
    enum { N = 100000 };
    td_random random = td_random_seed(2, 1);
    td_error error = {0};
    double(*xyz)[3] = malloc(N * sizeof *xyz);
    bool *used = calloc(N, sizeof *used);
    uint32_t(*t)[3];
    size_t count, seen = 0;
    for (int i = 0; i < N; i++) {
        xyz[i][0] = 691000 + 20 * td_random_uniform(&random);
        xyz[i][1] = 5334000 + 20 * td_random_uniform(&random);
        xyz[i][2] = 0;
    }
    const clock_t begin = clock();
    check_ok(td_tin_triangulate(&t, &count, (const double(*)[3])xyz, N, &error), error);
    print_message("100 000 points: %.0f ms\n", 1e3 * (double)(clock() - begin) / CLOCKS_PER_SEC);
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            seen += !used[t[i][k]];
            used[t[i][k]] = true;
        }
    assert_int_equal(seen, N);
    check_less((double)count, 2 * N - 5);
    check_less(2 * N - 2 - 100, (double)count); /* fewer than 100 of them on the hull */
    free(t);
    free(used);
    free(xyz);
}

/* ---- the grid ---- */

static const double at[2] = {691000, 5334000};

static double plane(double x, double y)
{
    return 2 + 0.5 * (x - at[0]) - 0.3 * (y - at[1]);
}

static void test_planes(void **state)
{
    (void)state;
    enum { N = 40, C = 41, R = 31 };
    td_random random = td_random_seed(3, 1);
    td_error error = {0};
    double xyz[N][3];
    uint32_t(*t)[3];
    size_t count;
    td_elevation *map = NULL;
    /* The hull is the rectangle [0, 4] x [0, 3]; centres lie on its border and on corners, every 0.1 m. */
    for (int i = 0; i < N; i++) {
        xyz[i][0] = at[0] + (i < 4 ? 4 * (i & 1) : 0.5 + floor(7 * td_random_uniform(&random)) / 2);
        xyz[i][1] = at[1] + (i < 4 ? 3 * (i >> 1) : 0.5 + floor(5 * td_random_uniform(&random)) / 2);
        xyz[i][2] = plane(xyz[i][0], xyz[i][1]);
    }
    check_ok(td_tin_triangulate(&t, &count, (const double(*)[3])xyz, N, &error), error);
    check_ok(td_elevation_new(&map, C + 4, R + 4, 0.1, (double[]){at[0] - 0.2, at[1] - 0.2}, "site", &error),
             error);
    map->height[0] = 77;
    map->provenance[0] = TD_CELL_PRIOR;
    check_ok(
        td_tin_grid(map, (const double(*)[3])xyz, N, (const uint32_t(*)[3])t, count, NULL, NULL, 0, &error),
        error);
    size_t points = 0;
    for (int r = 0; r < R + 4; r++)
        for (int c = 0; c < C + 4; c++) {
            const int i = r * (C + 4) + c;
            /* Centres on the hull's border are within or not, by the rounding of 0.1 m. */
            const bool in = c > 2 && c < C + 1 && r > 2 && r < R + 1;
            const bool out = c < 2 || c > C + 1 || r < 2 || r > R + 1;
            if (in) {
                check_near((double)map->height[i], plane(at[0] + 0.1 * (c - 2), at[1] + 0.1 * (r - 2)), 1e-6);
                assert_true(isnan(map->sigma[i]));
                assert_int_equal(map->provenance[i], map->count[i] ? TD_CELL_MEASURED : TD_CELL_FILLED);
                points += map->count[i];
            }
            if (out && i > 0) assert_true(isnan(map->height[i]) && map->provenance[i] == TD_CELL_UNKNOWN);
        }
    assert_true(map->height[0] == 77 && map->provenance[0] == TD_CELL_PRIOR);
    assert_int_equal(points, N - 4); /* the corners lie on the border */
    td_elevation_free(&map);
    free(t);
}

/* A cell's centre on the side of two triangles, but for rounding: one of them has it. */
static void test_common_sides(void **state)
{
    (void)state;
    td_random random = td_random_seed(9, 1);
    td_error error = {0};
    td_elevation *map = NULL;
    const double origin[2] = {0, 0};
    const uint32_t t[2][3] = {{0, 1, 2}, {3, 1, 0}};
    for (int i = 0; i < 5000; i++) {
        double xyz[4][3] = {{0}};
        const double angle = 6.28 * td_random_uniform(&random), length = 0.1 + td_random_uniform(&random);
        check_ok(td_elevation_new(&map, 3, 3, 0.1 + td_random_uniform(&random), origin, "site", &error),
                 error);
        const double centre[2] = {map->cell_m, map->cell_m};
        for (int k = 0; k < 2; k++) {
            const double along = k ? sin(angle) : cos(angle), across = k ? cos(angle) : -sin(angle);
            xyz[0][k] = centre[k] - 0.7 * length * along;
            xyz[1][k] = centre[k] + length * along;
            xyz[2][k] = centre[k] + across;
            xyz[3][k] = centre[k] - across;
        }
        check_ok(td_tin_grid(map, (const double(*)[3])xyz, 4, t, 2, NULL, NULL, 0, &error), error);
        assert_false(isnan(map->height[4]));
        td_elevation_free(&map);
    }
}

static void test_long_sides(void **state)
{
    (void)state;
    td_error error = {0};
    td_elevation *map = NULL;
    const double xyz[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 9}, {8, 0.5, 0}};
    const uint32_t t[3][3] = {{0, 1, 2}, {1, 3, 2}, {1, 4, 3}};
    check_ok(td_elevation_new(&map, 80, 10, 0.1, (double[]){0.05, 0.05}, "site", &error), error);
    check_ok(td_tin_grid(map, xyz, 5, t, 3, NULL, NULL, 1.5, &error), error);
    for (int i = 0; i < 800; i++) assert_int_equal(isnan(map->height[i]), i % 80 >= 10);
    check_ok(td_tin_grid(map, xyz, 5, t, 3, NULL, NULL, 0, &error), error);
    assert_false(isnan(map->height[5 * 80 + 60]));
    td_elevation_free(&map);
}

/* The cell in the middle of three points has a third of each; of two of them, what geometry says. */
static void test_independent_sigma(void **state)
{
    (void)state;
    td_error error = {0};
    td_elevation *map = NULL;
    const double xyz[3][3] = {{0, 0, 1}, {3, 0, 2}, {0, 3, 7}}, sigma_z[3] = {0.1, 0.2, 0.4};
    const uint32_t t[1][3] = {{0, 1, 2}};
    check_ok(td_elevation_new(&map, 4, 4, 1, (double[]){0, 0}, "site", &error), error);
    check_ok(td_tin_grid(map, xyz, 3, t, 1, NULL, sigma_z, 0, &error), error);
    check_near((double)map->height[5], 10 / 3., 1e-6);
    check_near((double)map->sigma[5], sqrt(0.01 + 0.04 + 0.16) / 3, 1e-7);
    check_near((double)map->sigma[0], 0.1, 1e-7);
    check_near((double)map->sigma[1], sqrt(4 * 0.01 + 0.04) / 3, 1e-7);
    td_elevation_free(&map);
}

static void test_joint_sigma(void **state)
{
    (void)state;
    enum { N = 5, SIZE = 3 * N, DRAWS = 4000, CELLS = 4 };
    const double xyz[N][3] = {{0, 0, 1}, {4, 0, 3}, {4, 4, 0}, {0, 4, 2}, {1.5, 2.5, 4}};
    const int cell[CELLS] = {1 * 5 + 2, 2 * 5 + 3, 3 * 5 + 1, 1 * 5 + 1}; /* none near a side */
    td_random random = td_random_seed(5, 1);
    td_error error = {0};
    td_elevation *map = NULL, *noisy = NULL;
    uint32_t(*t)[3];
    size_t count;
    double root[SIZE][SIZE], covariance[SIZE * SIZE], sum[CELLS] = {0};
    for (int i = 0; i < SIZE * SIZE; i++) root[i / SIZE][i % SIZE] = 0.002 * td_random_normal(&random);
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < SIZE; j++) {
            covariance[i * SIZE + j] = 0;
            for (int k = 0; k < SIZE; k++) covariance[i * SIZE + j] += root[i][k] * root[j][k];
        }
    check_ok(td_tin_triangulate(&t, &count, xyz, N, &error), error);
    check_ok(td_elevation_new(&map, 5, 5, 1, (double[]){0.1, -0.2}, "site", &error), error);
    check_ok(td_elevation_new(&noisy, 5, 5, 1, (double[]){0.1, -0.2}, "site", &error), error);
    check_ok(td_tin_grid(map, xyz, N, (const uint32_t(*)[3])t, count, covariance, NULL, 0, &error), error);
    for (int d = 0; d < DRAWS; d++) {
        double unit[SIZE], moved[N][3];
        for (int i = 0; i < SIZE; i++) unit[i] = td_random_normal(&random);
        for (int i = 0; i < SIZE; i++) {
            moved[i / 3][i % 3] = xyz[i / 3][i % 3];
            for (int k = 0; k < SIZE; k++) moved[i / 3][i % 3] += root[i][k] * unit[k];
        }
        check_ok(td_tin_grid(noisy, (const double(*)[3])moved, N, (const uint32_t(*)[3])t, count, NULL, NULL,
                             0, &error),
                 error);
        for (int c = 0; c < CELLS; c++) {
            const double e = (double)noisy->height[cell[c]] - (double)map->height[cell[c]];
            sum[c] += e * e / pow((double)map->sigma[cell[c]], 2);
        }
    }
    for (int c = 0; c < CELLS; c++) {
        print_message("cell %d: sigma %.4f m, empirical over predicted variance %.3f\n", cell[c],
                      (double)map->sigma[cell[c]], sum[c] / DRAWS);
        check_near(sum[c] / DRAWS, 1, 3.29 * sqrt(2. / DRAWS));
    }
    td_elevation_free(&map);
    td_elevation_free(&noisy);
    free(t);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_random_points), cmocka_unit_test(test_grid_points),
        cmocka_unit_test(test_duplicates),    cmocka_unit_test(test_refused),
        cmocka_unit_test(test_many),          cmocka_unit_test(test_hard_points),
        cmocka_unit_test(test_planes),        cmocka_unit_test(test_common_sides),
        cmocka_unit_test(test_long_sides),    cmocka_unit_test(test_independent_sigma),
        cmocka_unit_test(test_joint_sigma),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
