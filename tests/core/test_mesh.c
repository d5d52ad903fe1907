/* Proves: a map becomes triangles that cover its known squares once, counter-clockwise from above, through
 * its heights, with its holes, thinned or not; binary glTF holds what the Khronos specification (2.0,
 * chapters 3.6, 3.7 and 4.4) asks for, its positions are the mesh's turned to y up and moved by the origin it
 * states, within a tenth of a millimetre at UTM's coordinates, texture coordinates point at the right texels;
 * bad meshes are refused without a file; an orthophoto is a GeoTIFF that GDAL's own tools (when installed)
 * see at the right place. Reference: counting and geometry written here; the offsets of the format. Blind to:
 * how it looks (tests/apps/test_reconstruct_products.py asks a reader that is not ours). */
#include <jansson.h>
#include <unistd.h>

#include "core/file.h"
#include "core/mesh.h"
#include "core/orthophoto.h"
#include "tests/check.h"
#include "tests/scratch.h"

/* Smooth ground with two unknown cells. */
static td_elevation *ground(int columns, int rows, double x, double y)
{
    td_elevation *map = NULL;
    td_error error = {0};
    check_ok(td_elevation_new(&map, columns, rows, 0.05, (double[2]){x, y}, "site", &error), error);
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) {
            map->height[r * columns + c] = (float)(0.3 * sin(0.2 * c) + 0.02 * r);
            map->sigma[r * columns + c] = 0.001f * (float)c;
        }
    map->height[7 * columns + 5] = map->height[20 * columns + 11] = NAN;
    return map;
}

/* Area in plan; every triangle is counter-clockwise, lies on the map's cells and spans no more than `step`.
 */
static double check_triangles(const td_cloud *mesh, const td_elevation *map, int step)
{
    double area = 0;
    for (size_t i = 0; i < mesh->count; i++) {
        const double u = (mesh->point[i].p[0] - map->origin[0]) / map->cell_m,
                     v = (mesh->point[i].p[1] - map->origin[1]) / map->cell_m;
        const size_t cell = (size_t)lround(v) * (size_t)map->columns + (size_t)lround(u);
        check_near(u, round(u), 1e-6);
        check_near(mesh->point[i].p[2], (double)map->height[cell], 0);
        assert_true(mesh->point[i].sigma == map->sigma[cell]);
    }
    for (size_t i = 0; i < mesh->triangle_count; i++) {
        const double *p[3];
        for (int k = 0; k < 3; k++) {
            assert_true(mesh->triangle[i][k] < mesh->count);
            p[k] = mesh->point[mesh->triangle[i][k]].p;
        }
        const double twice =
            (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[2][0] - p[0][0]) * (p[1][1] - p[0][1]);
        assert_true(twice > 0);
        check_near(twice, step * step * map->cell_m * map->cell_m, 1e-6 * twice);
        area += twice / 2;
    }
    return area;
}

static void test_map_to_mesh(void **state)
{
    (void)state;
    td_error error = {0};
    td_elevation *map = ground(41, 31, 0.1, -2);
    td_cloud *mesh = NULL;
    const double cell = map->cell_m * map->cell_m;
    check_ok(td_mesh_from_elevation(&mesh, map, 0, &error), error);
    /* Around each hole four squares lose half of themselves. */
    check_near(check_triangles(mesh, map, 1), (40 * 30 - 8 * 0.5) * cell, 1e-9);
    assert_int_equal(mesh->count, 41 * 31 - 2);
    assert_int_equal(mesh->triangle_count, 2 * 40 * 30 - 8);
    td_cloud_free(&mesh);
    /* Every second cell: 20 x 15 squares, less the one around (5, 7) and the two beside (11, 20). */
    check_ok(td_mesh_from_elevation(&mesh, map, 400, &error), error);
    check_near(check_triangles(mesh, map, 2), 4 * (20 * 15 - 3) * cell, 1e-9);
    assert_true(mesh->count <= 400);
    td_cloud_free(&mesh);
    for (int i = 0; i < 41 * 31; i++)
        if (i % 41 != 3) map->height[i] = NAN;
    check_fails(td_mesh_from_elevation(&mesh, map, 0, &error), TD_ERROR_DATA, error, "no surface");
    assert_null(mesh);
    td_elevation_free(&map);
}

static uint32_t word(const char *at)
{
    const unsigned char *b = (const unsigned char *)at;
    return b[0] | b[1] << 8 | b[2] << 16 | (uint32_t)b[3] << 24;
}

static double number(const char *at)
{
    const uint32_t bits = word(at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return (double)value;
}

/* Where an accessor's numbers stand; checks its kind. */
static const char *view_of(const json_t *root, const char *bin, int accessor, int type, const char *shape,
                           size_t count)
{
    const json_t *a = json_array_get(json_object_get(root, "accessors"), (size_t)accessor);
    const json_t *v = json_array_get(json_object_get(root, "bufferViews"),
                                     (size_t)json_integer_value(json_object_get(a, "bufferView")));
    assert_int_equal(json_integer_value(json_object_get(a, "componentType")), type);
    assert_string_equal(json_string_value(json_object_get(a, "type")), shape);
    assert_int_equal(json_integer_value(json_object_get(a, "count")), count);
    const size_t at = (size_t)json_integer_value(json_object_get(v, "byteOffset"));
    assert_int_equal(at % 4, 0);
    return bin + at;
}

static void check_gltf(const char *bytes, size_t size, const td_cloud *mesh, const td_gltf_texture *t,
                       const double origin[3])
{
    assert_memory_equal(bytes, "glTF", 4);
    assert_int_equal(word(bytes + 4), 2);
    assert_int_equal(word(bytes + 8), size);
    const uint32_t text = word(bytes + 12);
    assert_memory_equal(bytes + 16, "JSON", 4);
    assert_int_equal(text % 4, 0);
    const char *bin = bytes + 20 + text + 8;
    assert_memory_equal(bin - 4, "BIN\0", 4);
    assert_int_equal(20 + text + 8 + word(bin - 8), size);
    json_t *root = json_loadb(bytes + 20, text, 0, NULL);
    assert_non_null(root);
    const char *position = view_of(root, bin, 0, 5126, "VEC3", mesh->count),
               *normal = view_of(root, bin, 1, 5126, "VEC3", mesh->count),
               *uv = view_of(root, bin, 2, 5126, "VEC2", mesh->count),
               *index = view_of(root, bin, 3, 5125, "SCALAR", 3 * mesh->triangle_count);
    const json_t *extras = json_object_get(json_array_get(json_object_get(root, "nodes"), 0), "extras");
    for (size_t k = 0; k < 3; k++)
        check_near(json_number_value(json_array_get(json_object_get(extras, "origin_m"), k)), origin[k], 0);
    double low = INFINITY;
    for (size_t i = 0; i < mesh->count; i++) {
        const double *p = mesh->point[i].p;
        check_near(number(position + 12 * i), p[0] - origin[0], 1e-4);
        check_near(number(position + 12 * i + 4), p[2] - origin[2], 1e-4);
        check_near(-number(position + 12 * i + 8), p[1] - origin[1], 1e-4);
        low = fmin(low, number(position + 12 * i));
        /* The ground is 0.3 sin(4 x) + 0.4 y, so its normal is known. */
        check_near(number(normal + 12 * i + 8) / number(normal + 12 * i + 4), 0.4, 0.05);
        assert_true(number(normal + 12 * i + 4) > 0.3);
        check_near(number(uv + 8 * i) * (t->high[0] - t->low[0]) + t->low[0], p[0], 1e-6 * fabs(p[0]) + 1e-5);
        check_near(t->high[1] - number(uv + 8 * i + 4) * (t->high[1] - t->low[1]), p[1],
                   1e-6 * fabs(p[1]) + 1e-5);
    }
    const json_t *least = json_object_get(json_array_get(json_object_get(root, "accessors"), 0), "min");
    check_near(json_number_value(json_array_get(least, 0)), low, 0);
    for (size_t i = 0; i < 3 * mesh->triangle_count; i++)
        assert_int_equal(word(index + 4 * i), mesh->triangle[i / 3][i % 3]);
    /* The texture is a JPEG of the view's length. */
    const json_t *view = json_array_get(json_object_get(root, "bufferViews"), 4);
    const char *jpeg = bin + json_integer_value(json_object_get(view, "byteOffset"));
    td_image *image = NULL;
    td_error error = {0};
    check_ok(td_image_decode(&image, jpeg, (size_t)json_integer_value(json_object_get(view, "byteLength")), 3,
                             "texture", &error),
             error);
    assert_true(image->width == 64 && image->height == 32);
    td_image_free(&image);
    json_decref(root);
}

static void test_gltf(void **state)
{
    static const double place[2][2] = {{0.1, -2}, {691000.1, 5334150.2}},
                        origin[2][3] = {{0, 0, 0}, {691000, 5334000, 0}};
    char *path = td_path_join(*state, "m.glb"), *bytes;
    td_error error = {0};
    size_t size;
    for (int i = 0; i < 2; i++) {
        td_elevation *map = ground(41, 31, place[i][0], place[i][1]);
        td_cloud *mesh = NULL;
        td_image *image = NULL;
        check_ok(td_mesh_from_elevation(&mesh, map, 0, &error), error);
        check_ok(td_image_new(&image, 64, 32, 3, &error), error);
        const td_gltf_texture t = {image,
                                   {place[i][0] - 0.1, place[i][1] - 0.2},
                                   {place[i][0] + 3, place[i][1] + 2},
                                   "site",
                                   i ? "EPSG:32632" : NULL};
        check_ok(td_mesh_write_gltf(mesh, &t, path, &error), error);
        check_ok(td_file_read(&bytes, &size, path, 1 << 22, &error), error);
        check_gltf(bytes, size, mesh, &t, origin[i]);
        assert_int_equal(unlink(path), 0);
        mesh->triangle[3][1] = (uint32_t)mesh->count;
        check_fails(td_mesh_write_gltf(mesh, &t, path, &error), TD_ERROR_ARGUMENT, error, "no vertex");
        mesh->point[5].p[1] = INFINITY;
        check_fails(td_mesh_write_gltf(mesh, &t, path, &error), TD_ERROR_ARGUMENT, error, "vertex 5");
        assert_int_not_equal(access(path, F_OK), 0);
        free(bytes);
        td_image_free(&image);
        td_cloud_free(&mesh);
        td_elevation_free(&map);
    }
    free(path);
}

static void run_in(char *printed, size_t size, const char *folder, const char *command)
{
    char line[1000];
    snprintf(line, sizeof line, "cd '%s' && %s 2>&1", folder, command);
    FILE *pipe = popen(line, "r");
    assert_non_null(pipe);
    printed[fread(printed, 1, size - 1, pipe)] = 0;
    pclose(pipe);
}

static void test_orthophoto(void **state)
{
    char *path = td_path_join(*state, "o.tif"), printed[8000];
    td_error error = {0};
    td_orthophoto *photo = NULL;
    td_image *image = NULL;
    const double origin[2] = {691000.25, 5334000.25};
    check_ok(td_orthophoto_new(&photo, 700, 600, 0.5, origin, "site", "EPSG:32632", &error), error);
    const uint8_t red[4] = {200, 30, 7, 255};
    memcpy(photo->rgba + 4 * (45 * 700 + 123), red, 4);
    check_ok(td_orthophoto_write(photo, path, &error), error);
    check_ok(td_orthophoto_image(&image, photo, 99, &error), error);
    assert_memory_equal(image->data + 3 * ((599 - 45) * 700 + 123), red, 3);
    assert_int_equal(image->data[0], 99);
    if (system("gdalinfo --version >/dev/null 2>&1") == 0) {
        run_in(printed, sizeof printed, *state, "gdalinfo o.tif");
        assert_non_null(strstr(printed, "LAYOUT=COG"));
        assert_non_null(strstr(printed, "UTM zone 32N"));
        assert_non_null(strstr(printed, "Origin = (691000.000000000000000,5334300.000000000000000)"));
        assert_non_null(strstr(printed, "ColorInterp=Alpha"));
        run_in(printed, sizeof printed, *state,
               "gdallocationinfo -valonly -geoloc o.tif 691061.75 5334022.75");
        assert_string_equal(printed, "200\n30\n7\n255\n");
        run_in(printed, sizeof printed, *state,
               "gdallocationinfo -valonly -geoloc o.tif 691061.75 5334023.25");
        assert_string_equal(printed, "0\n0\n0\n0\n");
    } else {
        print_message("gdalinfo is not installed: not compared\n");
    }
    td_image_free(&image);
    td_orthophoto_free(&photo);
    td_orthophoto_free(&photo);
    check_fails(td_orthophoto_new(&photo, 1 << 15, 1 << 14, 1, origin, "site", NULL, &error),
                TD_ERROR_ARGUMENT, error, "larger texels");
    check_fails(td_orthophoto_new(&photo, 1, 1, 1, origin, "a b", NULL, &error), TD_ERROR_ARGUMENT, error,
                "frame");
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_map_to_mesh),
        cmocka_unit_test_setup_teardown(test_gltf, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_orthophoto, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
