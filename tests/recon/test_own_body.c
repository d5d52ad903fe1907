/* The arm in view, with the 20 t excavator of datasets/zx200 and its cameras on the cab.
 *
 * Mask against rays cast by the simulation (its own intersections) at robots whose joints are off by up to 3
 * sigma, at every corner of that box and at random: each pixel whose ray hits the robot is masked. Not
 * wasteful: at most 1.65 times the pixels that one of those 13 robots covers over all postures, 2.5 times in
 * one (measured 1.56, and 2.3 where the boom passes 0.3 m beside the camera): the margin of 5 cm, and joints'
 * errors that add up in whatever direction, on an arm 0.5 m wide. Points: grown distances against a
 * brute-force search of the primitive's surface. Map: with the arm in view and its joints off by 3 sigma, no
 * cell is above the ground by more than 5 sigma; without the mask many are, which shows that the test can
 * fail. Blind to: what the URDF leaves out (hoses, cylinders), matching that smears the arm's edge by more
 * than margin_m. */
#include "recon/own_body.h"

#include "core/random.h"
#include "recon/fusion.h"
#include "sim/stereo_view.h"
#include "tests/check.h"
#include "tests/recon/fusion_scene.h"

static const double SIGMA = 0.005; /* rad, of each joint */
enum { JOINTS = 4, WIDTH = 320, HEIGHT = 240 };

/* On the cab's roof, 1.1 m above its floor's joint, looking forward and down. */
static td_pose upper_from_camera(void)
{
    return scene_pose(1.4, 0.5, 2.0, -0.1, 0.4);
}

static td_robot *zx200(void)
{
    td_robot *robot;
    td_error error;
    check_ok(td_robot_read(&robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    assert_int_equal(robot->joint_count, JOINTS);
    return robot;
}

static const double POSTURE[][JOINTS] = {{0.0, -0.6, 1.2, 0.5},
                                         {0.7, -0.3, 1.6, 1.0},
                                         {-0.4, -0.9, 2.2, 1.8},
                                         {0.2, 0.1, 0.8, 0.2},
                                         {3.0, -0.5, 2.5, 0.0}};
enum { POSTURES = sizeof POSTURE / sizeof *POSTURE };

static td_pose vehicle_from_camera(const td_robot *robot, const double *q)
{
    td_pose link[TD_ROBOT_MAX_LINKS];
    const td_pose held = upper_from_camera();
    td_robot_forward(link, robot, q);
    return td_pose_compose(&link[td_robot_find_link(robot, "upper")], &held);
}

/* A scene of the robot alone, ready for rays. The links that carry the camera are not looked for: their
 * shapes are taken out. */
static void set_scene(td_scene *scene, td_robot *robot, const double *q)
{
    memset(scene, 0, sizeof *scene);
    scene->robot = robot;
    scene->site_from_vehicle = td_pose_identity();
    memcpy(scene->q, q, JOINTS * sizeof *q);
    robot->link[td_robot_find_link(robot, "upper")].shape_count = 0;
    scene->sun[2] = 1;
}

/* Pixels that see the robot at joints q from a camera that moves with its swing. */
static void see(uint8_t *seen, td_robot *robot, const double *q, const td_camera *camera)
{
    td_scene scene;
    td_stereo_view *view;
    td_error error;
    set_scene(&scene, robot, q);
    check_ok(td_stereo_view_new(&view, &scene, &error), error);
    const td_pose from = vehicle_from_camera(robot, q);
    for (int i = 0; i < camera->width * camera->height; i++) {
        const double pixel[2] = {i % camera->width, i / camera->width};
        double ray[3];
        td_view_what what;
        assert_true(td_camera_unproject(ray, NULL, NULL, camera, pixel));
        td_pose_rotate(ray, &from, ray);
        td_stereo_view_cast(view, from.t, ray, &what);
        seen[i] = what == TD_SEES_ROBOT;
    }
    td_stereo_view_free(&view);
}

static td_own_body_options options_of(const td_robot *robot, const double *sigma)
{
    td_own_body_options o = td_own_body_options_default();
    o.sigma_q = sigma;
    o.mount = td_robot_find_link(robot, "upper");
    return o;
}

static void test_mask(void **state)
{
    (void)state;
    td_robot *robot = zx200(), *bare = zx200();
    const td_camera camera = {TD_CAMERA_PINHOLE, WIDTH, HEIGHT, {260, 260, 159.5, 119.5}};
    static uint8_t mask[WIDTH * HEIGHT], seen[WIDTH * HEIGHT], any[WIDTH * HEIGHT];
    const double sigma[JOINTS] = {SIGMA, SIGMA, SIGMA, SIGMA};
    const td_own_body_options o = options_of(robot, sigma);
    td_random random = td_random_seed(3, 0);
    td_error error;
    size_t all_masked = 0, all_covered = 0;
    for (int p = 0; p < POSTURES; p++) {
        const td_pose from = vehicle_from_camera(robot, POSTURE[p]), to = td_pose_inverse(&from);
        check_ok(td_own_body_mask(mask, &camera, &to, robot, POSTURE[p], &o, &error), error);
        size_t missed = 0, hit = 0, masked = 0, covered = 0;
        memset(any, 0, sizeof any);
        for (int run = 0; run < 13; run++) {
            double q[JOINTS];
            for (int j = 0; j < JOINTS; j++) {
                /* run 0: as told; 1 to 8: corners of boom, arm and bucket (swing carries the camera); random
                 */
                const double side = j == 0 ? 1 : (run - 1) >> (j - 1) & 1 ? 1 : -1;
                const double off = run == 0 ? 0 : run < 9 ? side : 2 * td_random_uniform(&random) - 1;
                q[j] = POSTURE[p][j] + 3 * SIGMA * off;
            }
            see(seen, bare, q, &camera);
            for (int i = 0; i < WIDTH * HEIGHT; i++) {
                hit += seen[i];
                missed += seen[i] && !mask[i];
                any[i] |= seen[i];
            }
        }
        for (int i = 0; i < WIDTH * HEIGHT; i++) covered += any[i], masked += mask[i];
        print_message("posture %d: %zu pixels may see the robot, %zu masked: %.2f times; of %zu of 13 robots "
                      "%zu missed\n",
                      p, covered, masked, (double)masked / (double)covered, hit, missed);
        assert_int_equal(missed, 0);
        check_less((double)masked, 2.5 * (double)covered);
        all_masked += masked;
        all_covered += covered;
    }
    print_message("all postures: %.2f times\n", (double)all_masked / (double)all_covered);
    check_less((double)all_masked, 1.65 * (double)all_covered);
    td_robot_free(&robot);
    td_robot_free(&bare);
}

/* Each link's points move by no more than it is grown by, whichever joints are off. */
static void test_growth(void **state)
{
    (void)state;
    td_robot *robot = zx200();
    const double sigma[JOINTS] = {SIGMA, SIGMA, SIGMA, SIGMA};
    double grown[TD_ROBOT_MAX_LINKS], covariance[36] = {0};
    td_own_body_options o = td_own_body_options_default();
    o.sigma_q = sigma;
    o.margin_m = 0;
    td_random random = td_random_seed(4, 0);
    td_pose link[TD_ROBOT_MAX_LINKS], moved[TD_ROBOT_MAX_LINKS];
    td_robot_forward(link, robot, POSTURE[0]);
    td_own_body_growth(grown, robot, POSTURE[0], &o);
    const int bucket = td_robot_find_link(robot, "bucket"), upper = td_robot_find_link(robot, "upper");
    double most = 0;
    for (int run = 0; run < 200; run++) {
        double q[JOINTS];
        for (int j = 0; j < JOINTS; j++)
            q[j] = POSTURE[0][j] + 3 * SIGMA * (td_random_below(&random, 2) ? 1 : -1);
        td_robot_forward(moved, robot, q);
        const double tip[3] = {1.05, 0.55, 0.72}; /* of the shell */
        double a[3], b[3];
        td_pose_transform(a, &link[bucket], tip);
        td_pose_transform(b, &moved[bucket], tip);
        most = fmax(most, sqrt(pow(a[0] - b[0], 2) + pow(a[1] - b[1], 2) + pow(a[2] - b[2], 2)));
    }
    print_message("bucket: grown by %.3f m, moved by at most %.3f m\n", grown[bucket], most);
    check_less(most, 1.02 * grown[bucket]); /* first order */
    check_less(0.6 * grown[bucket], most);
    /* A rig on the upper: the swing carries both, and the upper is not looked for. */
    const double all = grown[bucket];
    o.mount = upper;
    td_own_body_growth(grown, robot, POSTURE[0], &o);
    assert_true(isnan(grown[upper]));
    check_less(grown[bucket], 0.8 * all);
    /* A pose known to 1 cm and 1 mrad adds 3 cm and 3 mrad times the distance. */
    const double alone = grown[bucket];
    for (int i = 0; i < 6; i++) covariance[7 * i] = i < 3 ? 1e-6 : 1e-4;
    o.pose_covariance = covariance;
    td_own_body_growth(grown, robot, POSTURE[0], &o);
    check_near(grown[bucket] - alone, 3 * hypot(0.01, 0.001 * 8), 0.006);
    td_robot_free(&robot);
}

/* Random points of a primitive grown by g, and points beyond. */
static void test_holds(void **state)
{
    (void)state;
    td_robot *robot = calloc(1, sizeof *robot);
    td_random random = td_random_seed(6, 0);
    robot->link_count = 1;
    robot->link[0].parent = robot->link[0].joint = -1;
    robot->link[0].parent_from_link = td_pose_identity();
    robot->link[0].shape_count = 1;
    const double grown[1] = {0.2};
    const td_pose at = td_pose_identity();
    for (int kind = 0; kind < 3; kind++)
        for (int run = 0; run < 300; run++) {
            const double xi[6] = {0.3, -0.8, 0.4, 1, 2, 3};
            const td_primitive shape = {
                (td_primitive_kind)kind, td_pose_exp(xi), {kind ? 0.3 : 1, kind ? 2 : 0.6, 0.4}};
            robot->link[0].shape[0] = shape;
            double p[3], in[3];
            for (int i = 0; i < 3; i++) p[i] = 4 * td_random_uniform(&random) - 2;
            /* Nearest of many points of the core: the box, the capsule's axis, the centre. */
            double best = INFINITY;
            for (int k = 0; k < 9261; k++) {
                double core[3] = {k % 21 / 10. - 1, k / 21 % 21 / 10. - 1, k / 441 / 10. - 1};
                for (int i = 0; i < 3; i++) core[i] *= kind == TD_PRIMITIVE_BOX ? shape.size[i] / 2 : 0;
                if (kind == TD_PRIMITIVE_CAPSULE) core[2] = (k % 2001 / 1000. - 1) * shape.size[1] / 2;
                best = fmin(best,
                            sqrt(pow(p[0] - core[0], 2) + pow(p[1] - core[1], 2) + pow(p[2] - core[2], 2)));
            }
            const double from = best - (kind == TD_PRIMITIVE_BOX ? 0 : shape.size[0]);
            td_pose_transform(in, &shape.link_from_shape, p);
            if (fabs(from - grown[0]) < 0.05) continue; /* the search's grid */
            assert_int_equal(td_own_body_holds(in, robot, &at, grown), from < grown[0]);
        }
    free(robot);
}

/* The disparities of flat ground and arm, from the simulation's rays. */
static td_disparity *look(const td_depth_camera *camera, td_robot *robot, const double *q, td_random *random)
{
    const td_rectification *r = td_depth_camera_rectification(camera);
    td_disparity *d = scene_disparity_new(r->camera.width, r->camera.height);
    td_scene scene;
    td_stereo_view *view;
    td_error error;
    set_scene(&scene, robot, q);
    check_ok(td_stereo_view_new(&view, &scene, &error), error);
    const td_pose rig = td_depth_camera_pose(camera), from_rig = vehicle_from_camera(robot, q);
    const td_pose from = td_pose_compose(&from_rig, &rig);
    for (int i = 0; i < d->width * d->height; i++) {
        const double pixel[2] = {i % d->width, i / d->width};
        double ray[3], turned[3];
        td_view_what what;
        assert_true(td_camera_unproject(ray, NULL, NULL, &r->camera, pixel));
        td_pose_rotate(turned, &from, ray);
        double s = td_stereo_view_cast(view, from.t, turned, &what);
        if (turned[2] < -0.05) s = fmin(s, -from.t[2] / turned[2]);
        if (!isfinite(s)) continue;
        d->value[i] = (float)(r->camera.parameter[0] * r->baseline_m / (s * ray[2]));
        d->sigma[i] = 0.15f;
        d->kind[i] = TD_DENSE_MATCHED;
    }
    td_stereo_view_free(&view);
    scene_noise(d, 5, 1, random);
    return d;
}

/* Cells above the ground by more than 5 sigma after the frames of a working arm. */
static int false_cells(int *cells, int masked)
{
    td_robot *robot = zx200(), *bare = zx200();
    td_rig *rig = scene_rig(1);
    td_depth_camera *camera;
    td_fusion *fusion;
    td_elevation *map;
    td_error error;
    td_random random = td_random_seed(8, 0);
    const double sigma[JOINTS] = {SIGMA, SIGMA, SIGMA, SIGMA};
    const td_own_body_options o = options_of(robot, sigma);
    check_ok(td_depth_camera_new(&camera, rig, 0, 1, 1, 12, &error), error);
    check_ok(td_fusion_new(&fusion, NULL, &error), error);
    const td_camera *image = &td_depth_camera_rectification(camera)->camera;
    uint8_t *mask = malloc((size_t)image->width * (size_t)image->height);
    size_t all_removed = 0;
    for (int p = 0; p < POSTURES - 1; p++) {
        double q[JOINTS];
        for (int j = 0; j < JOINTS; j++)
            q[j] = POSTURE[p][j] + 3 * SIGMA * (j ? td_random_below(&random, 2) ? 1 : -1 : 0);
        td_disparity *d = look(camera, bare, q, &random);
        const td_pose rig_pose = td_depth_camera_pose(camera);
        const td_pose vehicle_from_rig = vehicle_from_camera(robot, POSTURE[p]);
        const td_pose from = td_pose_compose(&vehicle_from_rig, &rig_pose), to = td_pose_inverse(&from);
        size_t removed = 0;
        if (masked & 1) {
            check_ok(td_own_body_mask(mask, image, &to, robot, POSTURE[p], &o, &error), error);
            for (int i = 0; i < d->width * d->height; i++)
                if (mask[i]) d->kind[i] = TD_DENSE_NONE, d->value[i] = NAN;
        }
        if (masked & 2)
            check_ok(
                td_own_body_remove(d, &removed, camera, &vehicle_from_rig, robot, POSTURE[p], &o, 0, &error),
                error);
        all_removed += removed;
        const td_fusion_frame frame = {camera, d, vehicle_from_rig, NULL, p};
        check_ok(td_fusion_add(fusion, &frame, NULL, &error), error);
        scene_disparity_free(&d);
    }
    if (masked == 2) assert_true(all_removed > 5000);
    check_ok(td_fusion_map(&map, NULL, fusion, &error), error);
    int wrong = 0;
    *cells = 0;
    for (int i = 0; i < map->columns * map->rows; i++) {
        *cells += !isnan(map->height[i]);
        wrong += (double)map->height[i] > 5 * (double)map->sigma[i];
    }
    td_elevation_free(&map);
    td_fusion_free(&fusion);
    td_depth_camera_free(&camera);
    td_rig_free(&rig);
    td_robot_free(&robot);
    td_robot_free(&bare);
    free(mask);
    return wrong;
}

static void test_map(void **state)
{
    (void)state;
    static const char *way[] = {"no mask", "mask of pixels", "points removed", "both"};
    for (int masked = 0; masked < 4; masked++) {
        int cells;
        const int wrong = false_cells(&cells, masked);
        print_message("%s: %d of %d cells above the ground by more than 5 sigma\n", way[masked], wrong,
                      cells);
        assert_true(cells > 3000);
        if (masked == 0)
            assert_true(wrong > 100);
        else
            assert_int_equal(wrong, 0);
    }
}

static void test_refused(void **state)
{
    (void)state;
    td_robot *robot = zx200();
    td_camera camera = {TD_CAMERA_PINHOLE, 8, 8, {10, 10, 4, 4}};
    uint8_t mask[64];
    double q[JOINTS] = {0}, sigma[JOINTS] = {0, -1, 0, 0};
    td_own_body_options o = td_own_body_options_default();
    const td_pose to = td_pose_identity();
    td_error error;
    q[2] = NAN;
    check_fails(td_own_body_mask(mask, &camera, &to, robot, q, NULL, &error), TD_ERROR_DATA, error,
                "joint 'arm'");
    q[2] = 0;
    o.sigma_q = sigma;
    check_fails(td_own_body_mask(mask, &camera, &to, robot, q, &o, &error), TD_ERROR_ARGUMENT, error,
                "'boom'");
    o.sigma_q = NULL;
    o.mount = 99;
    check_fails(td_own_body_mask(mask, &camera, &to, robot, q, &o, &error), TD_ERROR_ARGUMENT, error,
                "mount");
    camera.model = TD_CAMERA_BROWN5;
    check_fails(td_own_body_mask(mask, &camera, &to, robot, q, NULL, &error), TD_ERROR_ARGUMENT, error,
                "brown5");
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_mask), cmocka_unit_test(test_growth),  cmocka_unit_test(test_holds),
        cmocka_unit_test(test_map),  cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
