/* Proves: a cloud written as LAS has the bytes that the ASPRS specification (LAS 1.4 R15, tables 3, 4, 9, 16
 * and 24) asks for, field by field at its offset; coordinates come back within half a step at a vehicle's, at
 * UTM's and at a continent's size; the header's bounds are those of what is read back; sigma, colours and the
 * reference system arrive; the same cloud gives the same bytes; what LAS cannot hold is refused without a
 * file. Reference: the offsets below, written from the specification, not from the writer. Blind to: what
 * single programs think of the file (tests/apps/test_reconstruct_products.py asks some). */
#include <unistd.h>

#include "core/cloud.h"
#include "core/crs.h"
#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static uint64_t whole(const char *at, int size)
{
    uint64_t bits = 0;
    for (int i = 0; i < size; i++) bits |= (uint64_t)(unsigned char)at[i] << (8 * i);
    return bits;
}

static double real(const char *at)
{
    const uint64_t bits = whole(at, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static float real32(const char *at)
{
    const uint32_t bits = (uint32_t)whole(at, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static td_cloud *cloud_at(const double origin[3], double size, size_t count)
{
    td_cloud *cloud = NULL;
    td_error error = {0};
    check_ok(td_cloud_new(&cloud, count, 0, &error), error);
    for (size_t i = 0; i < count; i++) {
        const double u = (double)i / (double)(count - 1);
        cloud->point[i] = (td_cloud_point){
            {origin[0] + size * u * u, origin[1] - size * sin(3 * u), origin[2] + 0.01 * size * cos(40 * u)},
            i % 7 == 3 ? NAN : 0.001f * (float)i,
            {(uint8_t)i, (uint8_t)(255 - i), 128}};
    }
    return cloud;
}

static void check_header(const char *b, size_t count, int records)
{
    assert_memory_equal(b, "LASF", 4);
    assert_int_equal(whole(b + 6, 2), 16); /* WKT, and nothing else */
    assert_true(b[24] == 1 && b[25] == 4);
    assert_int_equal(whole(b + 94, 2), 375);
    assert_int_equal(whole(b + 100, 4), records);
    assert_int_equal(b[104], 7);
    assert_int_equal(whole(b + 105, 2), 40);
    assert_int_equal(whole(b + 107, 4), 0); /* format 7 must not fill the old counts */
    assert_int_equal(whole(b + 247, 8), count);
    assert_int_equal(whole(b + 255, 8), count);
    assert_int_equal(whole(b + 263, 8), 0);
    /* The first record: one extra dimension of floats, named and described. */
    const char *v = b + 375;
    assert_string_equal(v + 2, "LASF_Spec");
    assert_int_equal(whole(v + 18, 2), 4);
    assert_int_equal(whole(v + 20, 2), 192);
    assert_int_equal(v[54 + 2], 9);
    assert_int_equal(v[54 + 3], 0);
    assert_string_equal(v + 54 + 4, "sigma");
    assert_string_equal(v + 54 + 160, "standard deviation, m");
}

static void check_points(const char *b, const td_cloud *cloud, double finest)
{
    const size_t first = whole(b + 96, 4);
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < cloud->count; i++) {
        const char *p = b + first + 40 * i;
        const td_cloud_point *q = &cloud->point[i];
        for (int k = 0; k < 3; k++) {
            const double scale = real(b + 131 + 8 * k), offset = real(b + 155 + 8 * k);
            const double v = offset + scale * (int32_t)whole(p + 4 * k, 4);
            assert_true(scale <= finest);
            check_near(v, q->p[k], 0.5 * scale + 1e-15 * fabs(v) + 1e-12);
            low[k] = fmin(low[k], v);
            high[k] = fmax(high[k], v);
            assert_int_equal(whole(p + 30 + 2 * k, 2), 257 * q->rgb[k]);
        }
        assert_int_equal(p[14], 0x11);
        const float sigma = real32(p + 36);
        assert_true(isnan(q->sigma) ? isnan(sigma) : sigma == q->sigma);
    }
    for (int k = 0; k < 3; k++) {
        check_near(real(b + 179 + 16 * k), high[k], 0);
        check_near(real(b + 187 + 16 * k), low[k], 0);
    }
}

static void test_bytes(void **state)
{
    static const struct {
        double origin[3], size, finest;
    } cases[] = {{{0, 0, 0}, 5, 1e-4},
                 {{-3.25, 1e-3, -40}, 1e-3, 1e-4},
                 {{691000.1, 5334150.2, 512.3}, 2000, 1e-4},
                 {{691000.1, 5334150.2, 512.3}, 3e6, 1e-3 * (1 + 1e-12)}};
    char *path = td_path_join(*state, "c.las"), *bytes;
    td_error error = {0};
    size_t size;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        td_cloud *cloud = cloud_at(cases[i].origin, cases[i].size, 101);
        const char *wkt = i % 2 ? "PROJCS[\"here\"]" : NULL;
        check_ok(td_cloud_write_las(cloud, path, wkt, &error), error);
        check_ok(td_file_read(&bytes, &size, path, 1 << 20, &error), error);
        const size_t first = 375 + 54 + 192 + (wkt ? 54 + strlen(wkt) + 1 : 0);
        assert_int_equal(size, first + 101 * 40);
        assert_int_equal(whole(bytes + 96, 4), first);
        check_header(bytes, 101, wkt ? 2 : 1);
        check_points(bytes, cloud, cases[i].finest);
        if (wkt) {
            assert_string_equal(bytes + 621 + 2, "LASF_Projection");
            assert_int_equal(whole(bytes + 621 + 18, 2), 2112);
            assert_int_equal(whole(bytes + 621 + 20, 2), strlen(wkt) + 1);
            assert_string_equal(bytes + 621 + 54, wkt);
        }
        char *again;
        check_ok(td_cloud_write_las(cloud, path, wkt, &error), error);
        check_ok(td_file_read(&again, &size, path, 1 << 20, &error), error);
        assert_memory_equal(bytes, again, size);
        free(again);
        free(bytes);
        td_cloud_free(&cloud);
    }
    free(path);
}

static void test_refused(void **state)
{
    char *path = td_path_join(*state, "r.las"), *long_text = malloc(70000);
    td_error error = {0};
    td_cloud *cloud = cloud_at((double[3]){0, 0, 0}, 1, 3);
    memset(long_text, 'A', 69999);
    long_text[69999] = 0;
    check_fails(td_cloud_write_las(cloud, path, long_text, &error), TD_ERROR_ARGUMENT, error, "70000 bytes");
    cloud->point[1].p[2] = NAN;
    check_fails(td_cloud_write_las(cloud, path, NULL, &error), TD_ERROR_ARGUMENT, error, "point 1");
    assert_int_not_equal(access(path, F_OK), 0);
    td_cloud_free(&cloud);
    /* No points at all is a file all the same. */
    char *bytes;
    size_t size;
    check_ok(td_cloud_new(&cloud, 0, 0, &error), error);
    check_ok(td_cloud_write_las(cloud, path, NULL, &error), error);
    check_ok(td_file_read(&bytes, &size, path, 1 << 20, &error), error);
    assert_int_equal(size, 621);
    check_header(bytes, 0, 1);
    check_near(real(bytes + 179), 0, 0);
    free(bytes);
    free(long_text);
    free(path);
    td_cloud_free(&cloud);
}

/* Names of reference systems: by GDAL, nothing but names and texts, metres only. */
static void test_reference_systems(void **state)
{
    (void)state;
    td_error error = {0};
    char *wkt, *again;
    check_ok(td_crs_wkt(&wkt, "EPSG:32632", &error), error);
    assert_true(!strncmp(wkt, "PROJCS[\"WGS 84 / UTM zone 32N\"", 30));
    check_ok(td_crs_wkt(&again, wkt, &error), error);
    assert_string_equal(wkt, again);
    free(again);
    free(wkt);
    check_fails(td_crs_wkt(&wkt, "EPSG:4326", &error), TD_ERROR_ARGUMENT, error, "degrees");
    check_fails(td_crs_wkt(&wkt, "EPSG:2263", &error), TD_ERROR_ARGUMENT, error, "another unit");
    static const char *const none[] = {
        "EPSG:1", "", "UTM 32", "/etc/passwd", "http://localhost/x.prj", "PROJCS[", "EPSG:", "EPSG:32632 "};
    for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
        check_fails(td_crs_wkt(&wkt, none[i], &error), TD_ERROR_ARGUMENT, error,
                    "is no coordinate reference");
        assert_null(wkt);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_bytes, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_refused, scratch_make, scratch_remove),
        cmocka_unit_test(test_reference_systems),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
