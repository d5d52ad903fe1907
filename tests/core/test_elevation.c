/* Proves: a new map is unknown everywhere; heights between cells are those of the bilinear surface, exactly
 * for one that is bilinear itself (to a float's rounding); a copy shares nothing; a map written is read back
 * to the last bit, and GDAL's own tools see the same place and values (gdalinfo, when installed); foreign
 * GeoTIFFs become prior heights; damaged, rotated and foreign-unit files are refused by name; the same map is
 * the same bytes.
 * Reference: closed form; GDAL through another door than ours (its command line).
 * Blind to: a mistake that GDAL's library and its tools share. */
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
            map->provenance[i] = (uint8_t)(TD_CELL_PRIOR + i % 5);
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

/* ---- files ---- */

static bool tools(void)
{
    return system("gdalinfo --version >/dev/null 2>&1") == 0;
}

/* Runs a command of the shell in the test's folder; what it prints comes back. */
static void run_in(char *printed, size_t size, const char *folder, const char *command)
{
    char line[2048];
    snprintf(line, sizeof line, "cd '%s' && %s", folder, command);
    FILE *stream = popen(line, "r");
    assert_non_null(stream);
    size_t got = fread(printed, 1, size - 1, stream);
    printed[got] = 0;
    if (pclose(stream) != 0) fail_msg("%s: failed: %s", line, printed);
}

/* NaN equals NaN. */
static bool same(double a, double b)
{
    return a == b || (isnan(a) && isnan(b));
}

static void check_same(const td_elevation *a, const td_elevation *b)
{
    assert_true(a->columns == b->columns && a->rows == b->rows && a->cell_m == b->cell_m);
    assert_true(a->origin[0] == b->origin[0] && a->origin[1] == b->origin[1]);
    assert_string_equal(a->frame, b->frame);
    for (int i = 0; i < a->columns * a->rows; i++) {
        assert_true(same((double)a->height[i], (double)b->height[i]));
        assert_true(same((double)a->sigma[i], (double)b->sigma[i]));
        assert_true(same(a->time_s[i], b->time_s[i]));
        assert_int_equal(a->count[i], b->count[i]);
        assert_int_equal(a->provenance[i], b->provenance[i]);
    }
}

static void test_written_and_read(void **state)
{
    td_error error = {0};
    char *path = td_path_join(*state, "map.tif"), *again = td_path_join(*state, "again.tif");
    td_elevation *map = sample_map(), *back = NULL;
    /* No binary fractions: half a cell to and fro would move them. */
    map->cell_m = 0.07;
    map->origin[0] = 1. / 3;
    map->origin[1] = 700. / 3;
    check_ok(td_elevation_write(map, path, &error), error);
    check_ok(td_elevation_write(map, again, &error), error);
    char *bytes[2];
    size_t size[2];
    check_ok(td_file_read(&bytes[0], &size[0], path, 1 << 20, &error), error);
    check_ok(td_file_read(&bytes[1], &size[1], again, 1 << 20, &error), error);
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    check_ok(td_elevation_read(&back, path, &error), error);
    check_same(map, back);
    assert_null(back->crs);
    td_elevation_free(&back);
    /* Cut short anywhere, it is refused or, where only padding went, whole. */
    for (size_t cut = 0; cut < size[0]; cut += 1 + size[0] / 97) {
        check_ok(td_file_write(again, bytes[0], cut, &error), error);
        if (td_elevation_read(&back, again, &error) == TD_OK) {
            check_same(map, back);
            td_elevation_free(&back);
        } else {
            assert_null(back);
            assert_non_null(strstr(error.message, "again.tif: "));
        }
    }
    for (int i = 0; i < 2; i++) free(bytes[i]);
    td_elevation_free(&map);
    free(path);
    free(again);
}

/* Tiles and overviews; a system of coordinates. */
static void test_large_with_crs(void **state)
{
    td_error error = {0};
    char *path = td_path_join(*state, "utm.tif"), printed[1 << 16];
    td_elevation *map = NULL, *back = NULL;
    check_ok(td_elevation_new(&map, 700, 600, 0.25, (double[]){691000.125, 5334000.375}, "world", &error),
             error);
    map->crs = strdup("EPSG:32632");
    for (int i = 0; i < 700 * 600; i++) {
        if (i % 11 == 0) continue;
        map->height[i] = (float)(500 + 0.01 * (i % 700) + 0.02 * (i / 700));
        map->provenance[i] = TD_CELL_MEASURED;
        map->count[i] = 1;
    }
    check_ok(td_elevation_write(map, path, &error), error);
    check_ok(td_elevation_read(&back, path, &error), error);
    check_same(map, back);
    assert_string_equal(back->crs, "EPSG:32632");
    td_elevation_free(&back);
    if (tools()) {
        run_in(printed, sizeof printed, *state, "gdalinfo utm.tif");
        assert_non_null(strstr(printed, "LAYOUT=COG"));
        assert_non_null(strstr(printed, "Overviews: 350x300"));
        assert_non_null(strstr(printed, "UTM zone 32N"));
        assert_non_null(strstr(printed, "Origin = (691000.000000000000000,5334150.250000000000000)"));
        assert_non_null(strstr(printed, "Pixel Size = (0.250000000000000,-0.250000000000000)"));
        assert_non_null(strstr(printed, "Description = provenance"));
        assert_non_null(strstr(printed, "NoData Value=nan"));
        /* Cell (123, 45) by its coordinates. */
        run_in(printed, sizeof printed, *state,
               "gdallocationinfo -valonly -geoloc -b 1 utm.tif 691030.875 5334011.625");
        check_near((double)(float)strtod(printed, NULL), (double)map->height[45 * 700 + 123],
                   0); /* 15 digits */
        /* A part that was cut out keeps its place, though the note on the whole's origin goes with it. */
        run_in(printed, sizeof printed, *state, "gdal_translate -q -srcwin 100 50 40 30 utm.tif part.tif");
        free(path);
        path = td_path_join(*state, "part.tif");
        check_ok(td_elevation_read(&back, path, &error), error);
        check_near(back->origin[0], 691025.125, 1e-9);
        check_near(back->origin[1], 5334000.375 + 0.25 * (600 - 50 - 30), 1e-9);
        assert_true(
            same((double)back->height[3 * 40 + 7], (double)map->height[(600 - 50 - 30 + 3) * 700 + 107]));
        td_elevation_free(&back);
    } else {
        print_message("gdalinfo is not installed: not compared\n");
    }
    td_elevation_free(&map);
    free(path);
}

static void refused(const char *folder, const char *command, const char *words)
{
    td_error error = {0};
    td_elevation *map = NULL;
    char printed[4096], *path = td_path_join(folder, "foreign.tif");
    unlink(path);
    run_in(printed, sizeof printed, folder, command);
    check_fails(td_elevation_read(&map, path, &error), TD_ERROR_FORMAT, error, words);
    assert_non_null(strstr(error.message, "foreign.tif: "));
    assert_null(map);
    free(path);
}

#define CREATE "gdal_create -q -of GTiff -ot Float32 "

static void test_foreign(void **state)
{
    td_error error = {0};
    td_elevation *map = NULL;
    char printed[4096], *path = td_path_join(*state, "foreign.tif");
    if (!tools()) {
        print_message("gdal-bin is not installed: skipped\n");
        skip();
    }
    run_in(printed, sizeof printed, *state,
           "printf 'ncols 3\nnrows 2\nxllcorner 5\nyllcorner 6\ncellsize 2\nNODATA_value -9999\n"
           "1.5 2 -9999\n4 5 6\n' > a.asc && gdal_translate -q -ot Float32 a.asc foreign.tif 2>/dev/null");
    check_ok(td_elevation_read(&map, path, &error), error);
    assert_true(map->columns == 3 && map->rows == 2 && map->cell_m == 2);
    check_near(map->origin[0], 6, 0);
    check_near(map->origin[1], 7, 0);
    const float expected[6] = {4, 5, 6, 1.5f, 2, NAN};
    for (int i = 0; i < 6; i++) {
        assert_true(same((double)map->height[i], (double)expected[i]));
        assert_int_equal(map->provenance[i], i == 5 ? TD_CELL_UNKNOWN : TD_CELL_PRIOR);
        assert_true(isnan(map->sigma[i]) && isnan(map->time_s[i]) && map->count[i] == 0);
    }
    td_elevation_free(&map);
    refused(*state, CREATE "-outsize 4 3 -burn 1 foreign.tif", "where its cells lie");
    refused(*state, CREATE "-outsize 4 3 -burn 1 -a_ullr 0 3 8 0 foreign.tif", "square");
    refused(*state, CREATE "-outsize 4 3 -burn 1 -a_ullr 0 3 4 0 -a_srs EPSG:4326 foreign.tif", "degrees");
    refused(*state, CREATE "-outsize 4 3 -burn 1 -a_ullr 0 3 4 0 -a_srs EPSG:2229 foreign.tif", "metres");
    refused(*state, CREATE "-outsize 4 3 -bands 3 -burn 1 -a_ullr 0 3 4 0 foreign.tif", "has 3 bands");
    refused(*state,
            CREATE "-outsize 40000 40000 -co SPARSE_OK=TRUE -co TILED=YES -a_ullr 0 4 4 0 foreign.tif",
            "40000 x 40000");
    refused(*state,
            "echo '<VRTDataset rasterXSize=\"4\" rasterYSize=\"3\"><GeoTransform>0,1,0.1,0,0.1,-1"
            "</GeoTransform><VRTRasterBand dataType=\"Float32\" band=\"1\"/></VRTDataset>' > r.vrt && "
            "gdal_translate -q r.vrt foreign.tif",
            "rotated");
    refused(*state, "echo 'no raster' > foreign.tif", "is not a GeoTIFF");
    free(path);
}

static void test_files_refused(void **state)
{
    td_error error = {0};
    td_elevation *map = NULL, *good = sample_map();
    char *path = td_path_join(*state, "nowhere/map.tif");
    check_fails(td_elevation_read(&map, path, &error), TD_ERROR_IO, error, "nowhere/map.tif");
    check_fails(td_elevation_read(&map, *state, &error), TD_ERROR_IO, error, "folder");
    check_fails(td_elevation_write(good, path, &error), TD_ERROR_IO, error, "nowhere/map.tif");
    good->crs = strdup("no such system");
    free(path);
    path = td_path_join(*state, "map.tif");
    check_fails(td_elevation_write(good, path, &error), TD_ERROR_EXTERNAL, error, "map.tif");
    assert_int_not_equal(access(path, F_OK), 0);
    td_elevation_free(&good);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_memory),
        cmocka_unit_test(test_heights_between_cells),
        cmocka_unit_test_setup_teardown(test_written_and_read, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_large_with_crs, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_foreign, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_files_refused, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
