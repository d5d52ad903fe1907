/* Proves that scene files give the scene they describe: places, sizes, angles and states by hand-worked
 * numbers (to 1e-6 m: heights are floats), made grounds by what they are asked for (deviation, trench,
 * mound), and that what is wrong is refused with the place named. Blind to: how the images look
 * (tests/sim/test_stereo_view.c). */
#include "core/scene.h"

#include "core/file.h"
#include "tests/check.h"
#include "tests/scratch.h"

static td_error error;

static const char rig[] =
    "teledimos: rig 1\ncameras:\n  - name: left\n    model: pinhole\n    width: 64\n    height: 48\n"
    "    intrinsics: {fx: 60, fy: 60, cx: 32, cy: 24}\n"
    "    camera_from_rig: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}\n";

static const char head[] = "teledimos: scene 1\nname: test\nrig: rig.yaml\nframes: frames.csv\n";
static const char frames[] =
    "frame,time_s,ground,x_m,y_m,z_m,qw,qx,qy,qz,boom_rad\n"
    "a,0,flat,1,2,3,1,0,0,0,-0.5\nb,2.5,dug,0,0,0,0.7071067811865476,0,0,0.7071067811865476,0\n";

static void put(const char *folder, const char *name, const char *text)
{
    char *path = td_path_join(folder, name);
    check_ok(td_file_write(path, text, strlen(text), &error), error);
    free(path);
}

static td_status read_scene(td_scene_file **file, const char *folder, const char *more, const char *table)
{
    char text[8192];
    snprintf(text, sizeof text, "%s%s", head, more);
    put(folder, "rig.yaml", rig);
    put(folder, "scene.yaml", text);
    put(folder, "frames.csv", table);
    return td_scene_read(file, folder, &error);
}

static void test_whole(void **state)
{
    const char *folder = *state;
    td_scene_file *f = NULL;
    const char *more =
        "grounds:\n"
        "  - {name: flat, generate: {columns: 101, rows: 81, cell_m: 0.1, origin_m: [0, -4], slope: [0.1, "
        "0]}}\n"
        "  - name: dug\n    generate:\n      columns: 101\n      rows: 81\n      cell_m: 0.1\n      "
        "origin_m: [0, -4]\n"
        "      slope: [0.1, 0]\n      trench: {from_m: [3, 0], to_m: [5, 0], width_m: 1, depth_m: 0.8}\n"
        "      mound: {at_m: [8, 2], radius_m: 1, height_m: 0.5}\n"
        "surface: {albedo: 0.5, contrast: 0.1, grain_m: 0.2, octaves: 3, seed: 4}\n"
        "solids:\n"
        "  - {name: crate, box_m: [1, 2, 3], at_m: [4, 0], yaw_deg: 90}\n"
        "  - {name: ramp, wedge_m: [1, 1, 1], at_m: [1, 1, 7]}\n"
        "  - {name: stone, rock_m: [0.5, 0.4, 0.3], seed: 3, at_m: [2, 2]}\n"
        "robot: {urdf: " TD_SOURCE_DIR "/datasets/zx200/zx200.urdf}\n"
        "mount: {link: upper, pose: {q: [1, 0, 0, 0], t_m: [0, 0, 1]}}\n"
        "light: {azimuth_deg: 90, elevation_deg: 30, ambient: 0.25}\n"
        "image: {gain: 2, samples: 1}\n"
        "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n";
    check_ok(read_scene(&f, folder, more, frames), error);
    assert_int_equal(f->ground_count, 2);
    assert_int_equal(f->frame_count, 2);
    check_near(td_elevation_at(f->ground[0].map, 4.03, 0.01, NULL), 0.403, 1e-6);
    check_near(td_elevation_at(f->ground[1].map, 4, 0, NULL), 0.4 - 0.8, 1e-6);
    check_near(td_elevation_at(f->ground[1].map, 4, 0.4, NULL), 0.4 - 0.4, 1e-6); /* its wall, 4 : 1 */
    check_near(td_elevation_at(f->ground[1].map, 4, 0.6, NULL), 0.4, 1e-6);
    assert_true(td_elevation_at(f->ground[1].map, 8, 2, NULL) > 0.8 + 0.3);
    check_near(td_elevation_at(f->ground[1].map, 8, 3.05, NULL), 0.8, 1e-6);
    const td_solid *crate = f->scene.solid;
    double corner[3];
    td_pose_transform(corner, &crate->site_from_solid, crate->corner[7]); /* (0.5, 1, 3), turned, lifted */
    check_near(corner[0], 4 - 1, 1e-6);
    check_near(corner[1], 0.5, 1e-6);
    check_near(corner[2], 3.4, 1e-6);
    check_near(f->scene.solid[1].site_from_solid.t[2], 7, 0);
    for (size_t k = 0; k < f->scene.solid[2].corner_count; k++)
        for (int i = 0; i < 2; i++) assert_true(fabs(f->scene.solid[2].corner[k][i]) <= 0.2501);
    check_near(f->scene.sun[1], sqrt(0.75), 1e-12);
    check_near(f->scene.sun[2], 0.5, 1e-12);
    check_near(f->image.gain, 2, 0);
    assert_non_null(f->target);
    td_pose pose;
    td_scene_pose(f, 0, &pose);
    check_near(f->scene.q[1], -0.5, 0);
    assert_ptr_equal(f->scene.ground, f->ground[0].map);
    check_near(pose.t[0], 1 + 0.108, 1e-12);
    check_near(pose.t[2], 3 + 1.121 + 1, 1e-12);
    td_scene_pose(f, 1, &pose); /* turned by 90 deg: upper's (0.108, -0.034) becomes (0.034, 0.108) */
    assert_ptr_equal(f->scene.ground, f->ground[1].map);
    check_near(pose.t[0], 0.034, 1e-12);
    check_near(pose.t[1], 0.108, 1e-12);
    td_scene_free(&f);
    assert_null(f);
}

/* Volume by the divergence theorem: right only when every triangle winds the same way, seen from outside. */
static double volume(const td_solid *solid)
{
    double sum = 0;
    for (size_t t = 0; t < solid->triangle_count; t++) {
        const double *a = solid->corner[solid->triangle[t][0]], *b = solid->corner[solid->triangle[t][1]],
                     *c = solid->corner[solid->triangle[t][2]];
        sum += a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
               a[2] * (b[0] * c[1] - b[1] * c[0]);
    }
    return sum / 6;
}

static void test_solids(void **state)
{
    td_scene_file *f = NULL;
    check_ok(read_scene(&f, *state,
                        "solids:\n  - {name: box, box_m: [1, 2, 3], at_m: [0, 0, 0]}\n"
                        "  - {name: wedge, wedge_m: [1, 2, 3], at_m: [0, 0, 0]}\n"
                        "  - {name: rock, rock_m: [1, 2, 3], at_m: [0, 0, 0]}\n",
                        "frame\n1\n"),
             error);
    check_near(volume(f->scene.solid), 6, 1e-12);
    check_near(volume(f->scene.solid + 1), 3, 1e-12);
    const double rock = volume(f->scene.solid + 2);
    assert_true(rock > 1 && rock < 3.1415926 + 0.01); /* within the ellipsoid, 4/3 pi 0.5 1 1.5 */
    td_scene_free(&f);
}

static void test_ground(void **state)
{
    td_scene_file *f[2] = {NULL, NULL};
    for (int k = 0; k < 2; k++)
        check_ok(read_scene(&f[k], *state,
                            "grounds:\n  - {name: flat, generate: {columns: 400, rows: 400, cell_m: 0.1, "
                            "origin_m: [0, 0], "
                            "seed: 3, roughness_m: 0.2, scale_m: 2}}\n",
                            "frame\n1\n"),
                 error);
    const td_elevation *map = f[0]->ground[0].map;
    double sum = 0, squares = 0;
    for (int i = 0; i < 160000; i++) {
        sum += map->height[i];
        squares += map->height[i] * map->height[i];
    }
    check_near(sqrt(squares / 160000 - (sum / 160000) * (sum / 160000)), 0.2, 0.03);
    assert_memory_equal(map->height, f[1]->ground[0].map->height, 160000 * sizeof(float));
    for (int k = 0; k < 2; k++) td_scene_free(&f[k]);
}

static void test_refusals(void **state)
{
    static const struct {
        const char *more, *table, *words;
    } wrong[] = {
        {"sun: 3\n", "frame\n1\n", "sun"},
        {"grounds: [{name: a}]\n", "frame\n1\n", "grounds[0]: either 'map: FILE' or 'generate: {…}'"},
        {"grounds: [{name: a, generate: {columns: 9000, rows: 2, cell_m: 1, origin_m: [0, 0]}}]\n",
         "frame\n1\n", "grounds[0].generate.columns"},
        {"grounds: [{name: a, map: none.tif}]\n", "frame\n1\n", "none.tif"},
        {"solids: [{name: a, box_m: [1, 1, 1]}]\n", "frame\n1\n", "solids[0]: either 'pose' or 'at_m'"},
        {"solids: [{name: a, box_m: [1, 1, 1], rock_m: [1, 1, 1], at_m: [0, 0, 0]}]\n", "frame\n1\n",
         "one of box_m"},
        {"solids: [{name: a, box_m: [1, 0, 1], at_m: [0, 0, 0]}]\n", "frame\n1\n", "solids[0].box_m"},
        {"pictures: [{name: a, file: none.png, width_m: 1, at_m: [0, 0, 0]}]\n", "frame\n1\n", "none.png"},
        {"mount: {link: nose, pose: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}}\n", "frame\n1\n", "no link 'nose'"},
        {"light: {ambient: 2}\n", "frame\n1\n", "light.ambient"},
        {"image: {samples: 99}\n", "frame\n1\n", "image.samples"},
        {"", "frame\n", "0 frames"},
        {"", "frame,x_m\n1,2\n", "only 1 of the pose's columns"},
        {"", "frame,x_m,y_m,z_m,qw,qx,qy,qz\n1,0,0,0,1,1,0,0\n", "quaternion's length"},
        {"", "frame\n1\n1\n", "a frame '1' is there already"},
        {"", "frame\n../x\n", "letters, digits"},
        {"grounds: [{name: a, generate: {columns: 9, rows: 9, cell_m: 1, origin_m: [0, 0]}}]\n",
         "frame,ground\n1,b\n", "no ground 'b'"},
    };
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        td_scene_file *f = NULL;
        if (read_scene(&f, *state, wrong[i].more, wrong[i].table) == TD_OK)
            fail_msg("'%s' was taken", wrong[i].more);
        if (!strstr(error.message, wrong[i].words))
            fail_msg("'%s' lacks '%s'", error.message, wrong[i].words);
        assert_null(f);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_whole, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_solids, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_ground, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_refusals, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
