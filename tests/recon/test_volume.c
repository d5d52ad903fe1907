/* Proves: cut, fill and net are exact on noise-free boxes and pyramids, on grids of another origin or cell
 * too; a polygon takes exactly the cells whose centre it holds; under simulated noise that neighbouring cells
 * share (white noise smoothed by a Gaussian), a common shift, and both estimated, what comes out scatters by
 * the sigma that comes with it, and is unbiased, also where nothing changed and on slopes that fade into the
 * noise; a correlation length is found. Profiles and slopes are those of planes, and their sigma what noise
 * makes of them. References: closed forms, sums by hand, Monte Carlo; bounds of 99.9 % for the count of
 * draws, shared among the figures of a test (3.9 sigma). Blind to: noise whose correlation is no Gaussian's
 * but for its area, to maps whose own sigma is wrong (`scatter` tells), and to a correlation found from too
 * little ground (volume.h).
 */
#include "core/random.h"
#include "recon/volume.h"
#include "tests/check.h"

static td_error error;

static td_elevation *make_map(int columns, int rows, double cell, double x, double y)
{
    td_elevation *map = NULL;
    const double origin[2] = {x, y};
    check_ok(td_elevation_new(&map, columns, rows, cell, origin, "site", &error), error);
    return map;
}

static size_t cells_of(const td_elevation *map)
{
    return (size_t)map->columns * (size_t)map->rows;
}

static double x_of(const td_elevation *map, size_t i)
{
    return map->origin[0] + (double)(i % (size_t)map->columns) * map->cell_m;
}

static double y_of(const td_elevation *map, size_t i)
{
    return map->origin[1] + (double)(i / (size_t)map->columns) * map->cell_m;
}

/* z = a + b x + c y */
static td_elevation *make_plane(int columns, int rows, double cell, double x, double y, double a, double b,
                                double c, double sigma)
{
    td_elevation *map = make_map(columns, rows, cell, x, y);
    for (size_t i = 0; i < cells_of(map); i++) {
        map->height[i] = (float)(a + b * x_of(map, i) + c * y_of(map, i));
        map->sigma[i] = (float)sigma;
        map->count[i] = 1;
        map->provenance[i] = TD_CELL_MEASURED;
    }
    return map;
}

/* ---- without noise ---- */

static void test_box(void **state)
{
    (void)state;
    for (int k = 0; k < 3; k++) { /* sigma unknown, zero, 5 mm */
        const double sigma = k == 0 ? NAN : k == 1 ? 0 : 0.005;
        td_elevation *before = make_plane(60, 40, 0.25, 100, -3, 0, 0, 0, sigma), *difference = NULL;
        td_elevation *after = make_plane(60, 40, 0.25, 100, -3, 0, 0, 0, sigma);
        for (int r = 10; r < 20; r++)
            for (int c = 5; c < 25; c++) after->height[60 * r + c] = -0.5F;
        for (int r = 25; r < 30; r++)
            for (int c = 40; c < 48; c++) after->height[60 * r + c] = 0.75F;
        td_volume v;
        check_ok(td_volume_between(&v, &difference, before, after, NULL, &error), error);
        check_near(v.cut_m3, 200 * 0.0625 * 0.5, 1e-12);
        check_near(v.fill_m3, 40 * 0.0625 * 0.75, 1e-12);
        check_near(v.net_m3, v.fill_m3 - v.cut_m3, 1e-12);
        check_near(v.rest_m3, 0, 0);
        check_near(v.area_m2, 150, 1e-9);
        check_near(v.changed_m2, 240 * 0.0625, 1e-12);
        assert_int_equal(v.cells, 2400);
        assert_int_equal(v.missing, 0);
        if (k < 2) check_near(v.sigma_net_m3, 0, 0);
        if (k == 2) assert_true(v.sigma_cut_m3 > 0 && v.sigma_net_m3 > v.sigma_cut_m3);
        check_near(difference->height[60 * 10 + 5], -0.5, 0);
        check_near(difference->height[0], 0, 0);
        td_elevation_free(&before);
        td_elevation_free(&after);
        td_elevation_free(&difference);
    }
}

/* Noise shared by the whole map is a shift of it: as sure as the area times sigma. */
static void test_long_correlation(void **state)
{
    (void)state;
    td_elevation *before = make_plane(30, 20, 0.5, 0, 0, 0, 0, 0, 0.003);
    td_elevation *after = make_plane(30, 20, 0.5, 0, 0, 1, 0, 0, 0.004);
    td_volume_options o = td_volume_options_default();
    td_volume v;
    o.correlation_m = 1e6;
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    check_near(v.fill_m3, 150, 1e-9);
    check_near(v.sigma_fill_m3, 150 * 0.005, 1e-7);
    o.correlation_m = 1e-6; /* and by no other cell: the root of the count */
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    check_near(v.sigma_fill_m3, 0.25 * sqrt(600) * 0.005, 1e-8);
    td_elevation_free(&before);
    td_elevation_free(&after);
}

/* A pyramid of 2 x 2 m, 1 m high, over a slope: the sum over lattice cells that hold its ridges is its volume
 * but for the discretisation, which the sum by hand shares; sigma known, so that its foot fades. */
static void test_pyramid(void **state)
{
    (void)state;
    td_elevation *before = make_plane(81, 81, 0.05, 0, 0, 2, 0.25, -0.5, 0.01);
    td_elevation *after = make_plane(81, 81, 0.05, 0, 0, 2, 0.25, -0.5, 0.01);
    double by_hand = 0;
    for (size_t i = 0; i < cells_of(after); i++) {
        const double h = 1 - fmax(fabs(x_of(after, i) - 2), fabs(y_of(after, i) - 2));
        if (h > 0) after->height[i] += (float)h;
        by_hand += 0.0025 * ((double)after->height[i] - (double)before->height[i]);
    }
    td_volume v;
    check_ok(td_volume_between(&v, NULL, before, after, NULL, &error), error);
    check_near(v.net_m3, by_hand, 1e-9);
    check_near(v.fill_m3, by_hand, 1e-6);  /* rounding of heights outside */
    check_near(v.fill_m3, 4.0 / 3, 0.002); /* 2 cell^2 / 3 of the lattice */
    check_near(v.cut_m3, 0, 0);
    td_elevation_free(&before);
    td_elevation_free(&after);
}

/* Bilinear interpolation keeps planes: between two of them the volume is exact on any grid. */
static void test_other_grids(void **state)
{
    (void)state;
    td_elevation *before = make_plane(30, 20, 0.5, 10, 20, 1, 0.125, 0.25, NAN);
    const double grids[][3] = {{0.5, 8.5, 19}, {0.5, 9.8, 18.7}, {0.3, 9.1, 19.3}, {0.5, 12, 20}};
    for (int k = 0; k < 4; k++) {
        td_elevation *after =
            make_plane(80, 70, grids[k][0], grids[k][1], grids[k][2], 1.5, 0.125, 0.25, NAN);
        td_volume v;
        check_ok(td_volume_between(&v, NULL, before, after, NULL, &error), error);
        const double columns = k == 3 ? 26 : 30;
        check_near(v.area_m2, columns * 20 * 0.25, 1e-9);
        assert_int_equal(v.missing, 600 - v.cells);
        check_near(v.net_m3, 0.5 * v.area_m2, 1.5e-4); /* heights up to 12 m as float: 0.5e-6 each */
        check_near(v.fill_m3, 0.5 * v.area_m2, 1.5e-4);
        td_elevation_free(&after);
    }
    /* Unknown cells beside a common grid's do not spread. */
    td_elevation *after = make_plane(30, 20, 0.5, 10, 20 + 0.5, 1.5, 0.125, 0.25, NAN);
    after->height[0] = NAN;
    td_volume v;
    check_ok(td_volume_between(&v, NULL, before, after, NULL, &error), error);
    assert_int_equal(v.cells, 30 * 19 - 1);
    td_elevation_free(&after);
    td_elevation_free(&before);
}

static bool left_of(const double *a, const double *b, double x, double y)
{
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0;
}

static void test_polygon(void **state)
{
    (void)state;
    td_elevation *before = make_plane(50, 50, 0.1, 0, 0, 0, 0, 0, NAN);
    td_elevation *after = make_plane(50, 50, 0.1, 0, 0, 1, 0, 0, NAN);
    const double triangle[3][2] = {{0.523, 0.311}, {4.217, 1.133}, {1.891, 4.477}};
    size_t inside = 0;
    for (size_t i = 0; i < 2500; i++) {
        const double x = x_of(before, i), y = y_of(before, i);
        inside += left_of(triangle[0], triangle[1], x, y) && left_of(triangle[1], triangle[2], x, y) &&
                  left_of(triangle[2], triangle[0], x, y);
    }
    td_volume_options o = td_volume_options_default();
    td_volume v;
    o.polygon = triangle;
    o.polygon_count = 3;
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    assert_int_equal(v.cells, inside);
    check_near(v.net_m3, 0.01 * (double)inside, 1e-9);
    /* Two halves along a row and a column of centres, and a notch: each cell once. */
    const double notch[6][2] = {{-1, -1}, {9, -1}, {9, 2}, {2, 2}, {2, 9}, {-1, 9}};
    const double rest[4][2] = {{2, 2}, {9, 2}, {9, 9}, {2, 9}};
    o.polygon = notch;
    o.polygon_count = 6;
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    size_t first = v.cells;
    o.polygon = rest;
    o.polygon_count = 4;
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    assert_int_equal(first + v.cells, 2500);
    assert_int_equal(v.cells, 900);
    td_elevation_free(&before);
    td_elevation_free(&after);
}

/* ---- with noise ---- */

enum { COLUMNS = 96, ROWS = 80, CELL_COUNT = COLUMNS * ROWS, FIGURES = 4 };

static int wrapped(int k, int count)
{
    return k < 0 ? k + count : k >= count ? k - count : k;
}

/* White noise smoothed by a Gaussian of `width` cells, on a torus, of standard deviation 1: correlated as
 * exp(-r^2 / (2 width)^2). */
static void draw_noise(double *out, double width, td_random *random)
{
    static double white[CELL_COUNT], rows[CELL_COUNT];
    const int reach = (int)ceil(4.5 * width);
    double weight[64], square = 0;
    assert_true(reach < 32);
    for (int k = -reach; k <= reach; k++) {
        weight[k + reach] = width > 0 ? exp(-0.5 * k * k / (width * width)) : 1;
        square += weight[k + reach] * weight[k + reach];
    }
    for (int i = 0; i < CELL_COUNT; i++) white[i] = td_random_normal(random);
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++) {
            double sum = 0;
            for (int k = -reach; k <= reach; k++)
                sum += weight[k + reach] * white[r * COLUMNS + wrapped(c + k, COLUMNS)];
            rows[r * COLUMNS + c] = sum;
        }
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++) {
            double sum = 0;
            for (int k = -reach; k <= reach; k++)
                sum += weight[k + reach] * rows[wrapped(r + k, ROWS) * COLUMNS + c];
            out[r * COLUMNS + c] = sum / square;
        }
}

typedef struct experiment {
    const char *name;
    double width, sigma, common; /* cells; m; sigma of the true shift, m */
    bool find_correlation, find_shift, polygon, no_sigma, no_change;
} experiment;

/* A trench with sloping walls (1 in 2), and its soil as a heap with a slope of 1 in 3. */
static double change_at(double x, double y)
{
    const double trench = 0.5 * fmin(0.9 - fabs(x - 2.2), 1.1 - fabs(y - 2));
    const double heap = 0.3 - hypot(x - 3.8, y - 2) / 3;
    return -fmin(0.4, fmax(0, trench)) + fmax(0, heap);
}

static td_volume measure_once(const experiment *e, const td_elevation *before, td_elevation *after,
                              td_random *random)
{
    static const double polygon[4][2] = {{0.9, 0.6}, {4.75, 0.6}, {4.75, 3.4}, {0.9, 3.4}};
    static double noise[CELL_COUNT];
    const double shift = e->common * td_random_normal(random);
    draw_noise(noise, e->width, random);
    for (size_t i = 0; i < CELL_COUNT; i++) {
        const double change = e->no_change ? 0 : change_at(x_of(after, i), y_of(after, i));
        const double sigma = before->sigma[i] > 0 ? sqrt(2) * before->sigma[i] : e->sigma;
        after->height[i] = (float)(before->height[i] + change + shift + sigma * noise[i]);
    }
    td_volume_options o = td_volume_options_default();
    td_volume v;
    o.correlation_m = e->find_correlation ? 0 : 2 * e->width * after->cell_m;
    o.common_m = e->find_shift ? NAN : e->common;
    if (e->polygon) {
        o.polygon = polygon;
        o.polygon_count = 4;
    }
    check_ok(td_volume_between(&v, NULL, before, after, &o, &error), error);
    return v;
}

static void run_experiment(const experiment *e, uint64_t seed)
{
    static const char *const names[FIGURES] = {"net", "cut", "fill", "rest"};
    const char *full = getenv("TELEDIMOS_FULL");
    const int draws = full && strcmp(full, "1") == 0 ? 2000 : 300;
    td_elevation *before = make_plane(COLUMNS, ROWS, 0.05, 0, 0, 0, 0.1, 0.05, NAN);
    td_elevation *after = make_plane(COLUMNS, ROWS, 0.05, 0, 0, 0, 0.1, 0.05, NAN);
    double truth[FIGURES] = {0}, sum[FIGURES] = {0}, square[FIGURES] = {0}, predicted[FIGURES] = {0};
    double correlation = 0, scatter = 0;
    for (size_t i = 0; i < CELL_COUNT; i++) {
        const double change = e->no_change ? 0 : change_at(x_of(after, i), y_of(after, i));
        truth[0] += 0.0025 * change;
        truth[change < 0 ? 1 : 2] += 0.0025 * fabs(change);
        /* From one side of the map to the other sigma doubles. */
        if (!e->no_sigma)
            before->sigma[i] = after->sigma[i] =
                (float)(e->sigma / sqrt(2) * (1 + (double)(i % COLUMNS) / COLUMNS));
    }
    td_random random = td_random_seed(seed, 7);
    for (int k = 0; k < draws; k++) {
        const td_volume v = measure_once(e, before, after, &random);
        const double value[FIGURES] = {v.net_m3, v.cut_m3, v.fill_m3, v.rest_m3};
        const double sigma[FIGURES] = {v.sigma_net_m3, v.sigma_cut_m3, v.sigma_fill_m3, v.sigma_rest_m3};
        for (int f = 0; f < FIGURES; f++) {
            sum[f] += value[f] - truth[f];
            square[f] += (value[f] - truth[f]) * (value[f] - truth[f]);
            predicted[f] += sigma[f] * sigma[f];
        }
        correlation += v.correlation_m / draws;
        scatter += v.scatter / draws;
    }
    for (int f = 0; f < FIGURES; f++) {
        if (e->no_change && (f == 1 || f == 2)) continue;
        print_message(
            "%s: %s: empirical %.2e over predicted sigma %.2e: %.3f, mean error %+.2f of its sigma\n",
            e->name, names[f], sqrt(square[f] / draws), sqrt(predicted[f] / draws),
            sqrt(square[f] / predicted[f]), sum[f] / sqrt(square[f]));
    }
    print_message("%s: correlation %.3f m (true %.3f), scatter %.3f\n", e->name, correlation,
                  2 * e->width * 0.05, scatter);
    /* A correlation found from little ground is a few per cent long (volume.h): only the full count sees it.
     */
    const double long_by = e->find_correlation && e->width > 0 ? correlation / (0.1 * e->width) - 1 : 0;
    const double bound = 3.9 / sqrt(2.0 * draws) + (draws > 300 ? fabs(long_by) : 0);
    check_near(long_by, 0, 0.07);
    for (int f = 0; f < FIGURES; f++) {
        if (e->no_change && (f == 1 || f == 2)) continue;
        if (f == 3 && e->find_shift && !e->polygon) { /* the shift is what makes it so */
            check_near(sqrt(square[f] / draws), 0, 1e-9);
            continue;
        }
        check_near(sqrt(square[f] / predicted[f]), 1, bound);
        check_near(sum[f] / sqrt(square[f]), 0, 3.9);
    }
    if (e->no_change) { /* noise is neither cut nor fill */
        check_near(sum[1], 0, 1e-3 * draws * sqrt(predicted[0] / draws));
        check_near(sum[2], 0, 1e-3 * draws * sqrt(predicted[0] / draws));
    }
    td_elevation_free(&before);
    td_elevation_free(&after);
}

static void test_given(void **state)
{
    (void)state;
    check_statistics();
    run_experiment(&(experiment){.name = "given", .width = 1.5, .sigma = 0.01}, 1);
}

static void test_shift(void **state)
{
    (void)state;
    run_experiment(&(experiment){.name = "shift", .width = 1.5, .sigma = 0.01, .common = 0.004}, 2);
}

static void test_white(void **state)
{
    (void)state;
    run_experiment(&(experiment){.name = "white", .width = 0, .sigma = 0.01, .find_correlation = true}, 3);
}

static void test_estimated(void **state)
{
    (void)state;
    check_statistics();
    const experiment e = {.name = "all estimated, polygon",
                          .width = 1,
                          .sigma = 0.01,
                          .common = 0.03,
                          .find_correlation = true,
                          .find_shift = true,
                          .polygon = true};
    run_experiment(&e, 4);
}

static void test_estimated_everywhere(void **state)
{
    (void)state;
    check_statistics();
    const experiment e = {.name = "all estimated, no polygon, no sigma",
                          .width = 1,
                          .sigma = 0.01,
                          .common = 0.03,
                          .find_correlation = true,
                          .find_shift = true,
                          .no_sigma = true};
    run_experiment(&e, 5);
}

static void test_unchanged(void **state)
{
    (void)state;
    const experiment e = {
        .name = "unchanged", .width = 1.5, .sigma = 0.02, .find_correlation = true, .no_change = true};
    run_experiment(&e, 6);
}

/* ---- profile and slope ---- */

static void test_profile(void **state)
{
    (void)state;
    td_elevation *map = make_plane(41, 41, 0.25, -5, -5, 3, 0.5, -0.25, 0.02);
    td_profile_point *p = NULL;
    size_t n = 0;
    const double from[2] = {-3, -4}, to[2] = {3, 4}, out[2] = {13, 4}, far[2] = {100, 100},
                 off[2] = {101, 100};
    check_ok(td_elevation_profile(&p, &n, map, from, to, 0.3, &error), error);
    assert_int_equal(n, 35); /* 10 m: 33 whole steps, and the end */
    for (size_t i = 0; i < n; i++) {
        const double s = i + 1 < n ? 0.3 * (double)i : 10;
        check_near(p[i].distance_m, s, 1e-12);
        check_near(p[i].height_m, 3 + 0.5 * (-3 + 0.6 * s) - 0.25 * (-4 + 0.8 * s), 1e-6);
        check_near(p[i].sigma_m, 0.02, 1e-9);
    }
    free(p);
    check_ok(td_elevation_profile(&p, &n, map, from, to, 0.1, &error), error);
    assert_int_equal(n, 101);
    free(p);
    check_ok(td_elevation_profile(&p, &n, map, from, to, 50, &error), error);
    assert_int_equal(n, 2);
    free(p);
    check_ok(td_elevation_profile(&p, &n, map, from, out, 1, &error), error);
    assert_true(isnan(p[n - 1].height_m) && isnan(p[n - 1].sigma_m) && isfinite(p[0].height_m));
    free(p);
    check_fails(td_elevation_profile(&p, &n, map, far, off, 1, &error), TD_ERROR_DATA, error, "no height");
    check_fails(td_elevation_profile(&p, &n, map, from, from, 1, &error), TD_ERROR_ARGUMENT, error,
                "same place");
    check_fails(td_elevation_profile(&p, &n, map, from, to, 0, &error), TD_ERROR_ARGUMENT, error, "step_m");
    check_fails(td_elevation_profile(&p, &n, map, from, to, 1e-7, &error), TD_ERROR_ARGUMENT, error,
                "longer steps");
    const double nan[2] = {0, NAN};
    check_fails(td_elevation_profile(&p, &n, map, from, nan, 1, &error), TD_ERROR_ARGUMENT, error,
                "to must be");
    check_fails(td_elevation_profile(&p, &n, map, nan, to, 1, &error), TD_ERROR_ARGUMENT, error,
                "from must be");
    assert_null(p);
    td_elevation_free(&map);
}

static void test_slope(void **state)
{
    (void)state;
    td_elevation *map = make_plane(20, 15, 0.5, 7, 8, 1, 0.75, -1, NAN), *slope = NULL;
    map->height[20 * 7 + 9] = NAN;
    map->height[20 * 14 + 18] = NAN; /* the corner has no neighbour along x */
    check_ok(td_elevation_slope(&slope, map, &error), error);
    for (size_t i = 0; i < 300; i++) {
        if (i == 20 * 7 + 9 || i == 20 * 14 + 18 || i == 299)
            assert_true(isnan(slope->height[i]) && slope->count[i] == 0 &&
                        slope->provenance[i] == TD_CELL_UNKNOWN);
        else
            check_near(slope->height[i], atan(1.25), 1e-5);
        assert_true(isnan(slope->sigma[i]));
    }
    td_elevation_free(&slope);
    for (size_t i = 0; i < 300; i++) map->height[i] = NAN;
    check_fails(td_elevation_slope(&slope, map, &error), TD_ERROR_DATA, error, "no cell");
    td_elevation_free(&map);
}

/* The middle cell's slope over draws of independent noise; 2 % for 10000 draws is 2.8 sigma of a spread, and
 * what the arctangent bends adds 0.1 %. */
static void test_slope_sigma(void **state)
{
    (void)state;
    check_statistics();
    td_random random = td_random_seed(8, 1);
    double sum = 0, square = 0, predicted = 0;
    for (int k = 0; k < 10000; k++) {
        td_elevation *map = make_plane(3, 3, 0.5, 0, 0, 1, 0.6, 0.8, 0), *slope = NULL;
        for (size_t i = 0; i < 9; i++) {
            map->sigma[i] = (float)(0.01 + 0.002 * (double)i);
            map->height[i] += (float)(map->sigma[i] * td_random_normal(&random));
        }
        check_ok(td_elevation_slope(&slope, map, &error), error);
        const double e = slope->height[4] - atan(1);
        sum += e;
        square += e * e;
        predicted = slope->sigma[4];
        td_elevation_free(&map);
        td_elevation_free(&slope);
    }
    check_near(sqrt(square / 10000) / predicted, 1, 0.025);
    check_near(sum / 10000, 0, 0.1 * predicted);
}

/* ---- what is refused ---- */

static void test_refused(void **state)
{
    (void)state;
    td_elevation *a = make_plane(20, 20, 0.5, 0, 0, 0, 0, 0, NAN);
    td_elevation *b = make_plane(20, 20, 0.5, 0, 0, 1, 0, 0, NAN), *difference = NULL;
    td_elevation *far = make_plane(20, 20, 0.5, 50, 0, 1, 0, 0, NAN);
    td_volume v;
    td_volume_options o = td_volume_options_default();
    check_fails(td_volume_between(&v, &difference, a, far, NULL, &error), TD_ERROR_DATA, error,
                "no cell in common");
    assert_null(difference);
    const double corner[4][2] = {{1, 1}, {2, 1}, {NAN, 2}, {3, 3}}, away[3][2] = {{90, 0}, {91, 0}, {90, 1}},
                 flat[3][2] = {{1, 1}, {2, 2}, {3, 3}};
    o.polygon = corner;
    o.polygon_count = 4;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_ARGUMENT, error, "corner 3");
    o.polygon_count = 2;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_ARGUMENT, error, "2 corners");
    o.polygon = flat;
    o.polygon_count = 3;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_ARGUMENT, error, "no area");
    o.polygon = away;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_DATA, error, "holds no cell");
    o = td_volume_options_default();
    o.correlation_m = NAN;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_ARGUMENT, error, "correlation_m");
    o.correlation_m = 0;
    o.common_m = -1;
    check_fails(td_volume_between(&v, NULL, a, b, &o, &error), TD_ERROR_ARGUMENT, error, "common_m");
    td_elevation *small = make_plane(9, 11, 0.5, 0, 0, 1, 0, 0, NAN);
    o.common_m = NAN;
    check_fails(td_volume_between(&v, NULL, a, small, &o, &error), TD_ERROR_DATA, error,
                "99 cells are unchanged");
    b->sigma[3] = -0.5F;
    check_fails(td_volume_between(&v, NULL, a, b, NULL, &error), TD_ERROR_DATA, error, "after");
    b->sigma[3] = NAN;
    b->crs = strdup("EPSG:32632");
    check_fails(td_volume_between(&v, NULL, a, b, NULL, &error), TD_ERROR_DATA, error, "EPSG:32632 after");
    a->crs = strdup("EPSG:32633");
    check_fails(td_volume_between(&v, NULL, a, b, NULL, &error), TD_ERROR_DATA, error, "EPSG:32633 before");
    strcpy(b->frame, "vehicle");
    check_fails(td_volume_between(&v, NULL, a, b, NULL, &error), TD_ERROR_DATA, error, "frames");
    td_elevation_free(&a);
    td_elevation_free(&b);
    td_elevation_free(&far);
    td_elevation_free(&small);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_box),       cmocka_unit_test(test_long_correlation),
        cmocka_unit_test(test_pyramid),   cmocka_unit_test(test_other_grids),
        cmocka_unit_test(test_polygon),   cmocka_unit_test(test_given),
        cmocka_unit_test(test_shift),     cmocka_unit_test(test_white),
        cmocka_unit_test(test_estimated), cmocka_unit_test(test_estimated_everywhere),
        cmocka_unit_test(test_unchanged), cmocka_unit_test(test_profile),
        cmocka_unit_test(test_slope),     cmocka_unit_test(test_slope_sigma),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
