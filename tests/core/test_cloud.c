/* Proves: a cloud written is read back to the last bit, in the bytes that the format's description asks for;
 * text, both byte orders, other types, unknown elements and polygons are understood; what is missing is NaN
 * or grey; anything damaged is refused by a sentence that names the file and the line or element.
 * Reference: files written by hand after the description of PLY.
 * Blind to: dialects that no one has shown us. */
#include "core/cloud.h"
#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static td_status parse(td_cloud **cloud, const char *text, td_error *error)
{
    return td_cloud_parse_ply(cloud, text, strlen(text), "c.ply", error);
}

static void test_written_and_read(void **state)
{
    td_error error = {0};
    td_cloud *cloud = NULL, *back = NULL;
    char *path = td_path_join(*state, "c.ply"), *bytes;
    size_t size;
    check_ok(td_cloud_new(&cloud, 4, 2, &error), error);
    assert_true(isnan(cloud->point[3].sigma) && cloud->point[3].rgb[1] == 128 && cloud->point[3].p[2] == 0);
    for (int i = 0; i < 4; i++)
        cloud->point[i] = (td_cloud_point){
            {i / 3., 691000.1 + i, -i * 1e-9}, i == 2 ? NAN : 0.001f * (float)i, {(uint8_t)i, 255, 7}};
    cloud->triangle[0][1] = 1;
    cloud->triangle[0][2] = 2;
    cloud->triangle[1][0] = 3;
    check_ok(td_cloud_write_ply(cloud, path, "frame: rig\nunit: m\tx", &error), error);
    check_ok(td_cloud_read_ply(&back, path, &error), error);
    assert_true(back->count == 4 && back->triangle_count == 2);
    for (int i = 0; i < 4; i++) {
        assert_memory_equal(back->point[i].p, cloud->point[i].p, sizeof cloud->point[i].p);
        assert_memory_equal(&back->point[i].sigma, &cloud->point[i].sigma, sizeof(float));
        assert_memory_equal(back->point[i].rgb, cloud->point[i].rgb, 3);
    }
    assert_memory_equal(back->triangle, cloud->triangle, 2 * sizeof *cloud->triangle);
    check_ok(td_file_read(&bytes, &size, path, 1 << 20, &error), error);
    const char *body = strstr(bytes, "end_header\n") + 11;
    assert_non_null(strstr(bytes, "comment frame: rig\ncomment unit: m?x\nelement vertex 4\n"));
    assert_int_equal(size - (size_t)(body - bytes), 4 * 31 + 2 * 13);
    /* 691001.1 = 0x1.5167233333333p+19 as a double, the least byte first. */
    const unsigned char expected[8] = {0x33, 0x33, 0x33, 0x33, 0x72, 0x16, 0x25, 0x41};
    assert_memory_equal(body + 31 + 8, expected, 8);
    /* Cut short anywhere, it is refused. */
    td_cloud_free(&back);
    for (size_t cut = 0; cut < size; cut++) {
        assert_int_not_equal(td_cloud_parse_ply(&back, bytes, cut, "cut.ply", &error), TD_OK);
        assert_null(back);
        assert_true(!strncmp(error.message, "cut.ply:", 8));
    }
    free(bytes);
    free(path);
    td_cloud_free(&cloud);
    td_cloud_free(&cloud);
    td_cloud_free(NULL);
}

static void test_text(void **state)
{
    (void)state;
    td_error error = {0};
    td_cloud *cloud = NULL;
    check_ok(parse(&cloud,
                   "ply\r\nformat ascii 1.0\r\ncomment by hand\nobj_info x\nelement sensor 1\n"
                   "property list uchar float view\nelement vertex 5\nproperty float blue\nproperty float z\n"
                   "property short x\nproperty list uchar int seen\nproperty double y\nproperty ushort red\n"
                   "element face 2\nproperty uchar flags\nproperty list uchar int vertex_index\nend_header\n"
                   "2 0.5 0.25\n0.5 1e3 -7 0 3.5 65535\n1 nan 2 2 8 9 3 0\n0 0 0 0 0 0\n0 0 0 0 0 0\n"
                   "0 0 0 0 0 257\n1 5 0 1 2 3 4\n0 3 4 3 0",
                   &error),
             error);
    assert_true(cloud->count == 5 && cloud->triangle_count == 4);
    assert_true(cloud->point[0].p[0] == -7 && cloud->point[0].p[1] == 3.5 && cloud->point[0].p[2] == 1000);
    assert_true(cloud->point[0].rgb[0] == 255 && cloud->point[0].rgb[1] == 128 &&
                cloud->point[0].rgb[2] == 128);
    assert_true(isnan(cloud->point[0].sigma) && isnan(cloud->point[1].p[2]) && cloud->point[1].rgb[2] == 255);
    assert_int_equal(cloud->point[4].rgb[0], 1);
    const uint32_t expected[4][3] = {{0, 1, 2}, {0, 2, 3}, {0, 3, 4}, {4, 3, 0}};
    assert_memory_equal(cloud->triangle, expected, sizeof expected);
    td_cloud_free(&cloud);
}

static void test_big_endian(void **state)
{
    (void)state;
    td_error error = {0};
    td_cloud *cloud = NULL;
    static const char text[] = "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\n"
                               "property int16 y\nproperty double z\nproperty int8 red\nend_header\n"
                               "\x3f\xc0\0\0\xff\xfe\x40\x09\x21\xfb\x54\x44\x2d\x18\xff";
    check_ok(td_cloud_parse_ply(&cloud, text, sizeof text - 1, "c.ply", &error), error);
    assert_true(cloud->point[0].p[0] == 1.5 && cloud->point[0].p[1] == -2);
    check_near(cloud->point[0].p[2], 3.14159265358979312, 0);
    assert_int_equal(cloud->point[0].rgb[0], 0);
    td_cloud_free(&cloud);
}

#define XYZ "property float x\nproperty float y\nproperty float z\n"
#define FACE "element face 1\nproperty list uchar int vertex_indices\nend_header\n"

static void test_refused(void **state)
{
    (void)state;
    static const char *const cases[][2] = {
        {"", "c.ply: is not a PLY"},
        {"plyx\n", "is not a PLY"},
        {"ply\nformat ascii 2.0\n", "c.ply:2: the second line"},
        {"ply\nformat ascii 1.0\nelement vertex 0\n" XYZ, "c.ply:7: the header ends"},
        {"ply\nformat ascii 1.0\nend_header\n", "no element 'vertex'"},
        {"ply\nformat ascii 1.0\nproperty float x\n", "c.ply:3: a property before"},
        {"ply\nformat ascii 1.0\nelement vertex -1\n", "c.ply:3: an element needs"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\n", "c.ply:4: no type of PLY"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\n", "no type of PLY"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float\n", "c.ply:4: not a property"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty int x\n",
         "c.ply:5: a property for"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nelement vertex 1\n", "c.ply:4: an element for"},
        {"ply\nformat ascii 1.0\nvertices 1\n", "c.ply:3: not a line"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no x, y and z"},
        {"ply\nformat ascii 1.0\nelement vertex 9999999999\n" XYZ "end_header\n1 2 3\n", "too short"},
        {"ply\nformat ascii 1.0\nelement vertex 2\n" XYZ "end_header\n1 2 3\n4 5", "too short"},
        {"ply\nformat ascii 1.0\nelement vertex 2\n" XYZ "end_header\n1 2 3\n14 x 6\n", "c.ply:9: vertex 1"},
        {"ply\nformat ascii 1.0\nelement vertex 3\n" XYZ FACE "0 0 0 1 0 0 0 1 0\n3 0 1 3\n",
         "face 0: a corner is no vertex"},
        {"ply\nformat ascii 1.0\nelement vertex 3\n" XYZ FACE "0 0 0 1 0 0 0 1 0\n3 0 1 -1\n", "no vertex"},
        {"ply\nformat ascii 1.0\nelement vertex 3\n" XYZ FACE "0 0 0 1 0 0 0 1 0\n3 0 1 0.5\n", "no vertex"},
        {"ply\nformat ascii 1.0\nelement vertex 3\n" XYZ FACE "0 0 0 1 0 0 0 1 0\n2 0 1 2\n",
         "three corners"},
        {"ply\nformat ascii 1.0\nelement vertex 3\n" XYZ FACE "0 0 0 1 0 0 0 1 0\n4 0 1 2\n",
         "the file ends"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        td_error error = {0};
        td_cloud *cloud = NULL;
        check_fails(parse(&cloud, cases[i][0], &error), TD_ERROR_FORMAT, error, cases[i][1]);
        assert_null(cloud);
    }
    td_error error = {0};
    td_cloud *cloud = NULL;
    check_fails(td_cloud_read_ply(&cloud, "nowhere/c.ply", &error), TD_ERROR_IO, error, "nowhere/c.ply");
    check_fails(td_cloud_new(&cloud, (size_t)1 << 33, 0, &error), TD_ERROR_ARGUMENT, error, "at most");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_written_and_read, scratch_make, scratch_remove),
        cmocka_unit_test(test_text),
        cmocka_unit_test(test_big_endian),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
