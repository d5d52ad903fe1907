/* Proves: every method finds, for every lens model, a start near enough for the joint refinement: focal
 * lengths within 15 %, poses within 10 % and 10 degrees (what the search's coarse lenses leave; half of that
 * was measured); one wrong view among them does not spoil it, whichever it is; views on a rail share one
 * pose; a camera that is to be kept is kept to the last bit; what cannot be estimated is said. Reference:
 * simulated truth with 0.1 px of noise. Blind to: the refinement itself (test_calibrate), real detections. */
#include "calib/first_estimate.h"
#include "core/linalg.h"
#include "tests/calib/simulate_depth.h"

enum { VIEWS = 8 };

#define DEGREE 0.017453292519943295

/* rig_from_target of the board on the rail at height 0. */
static const double rail[6] = {0.2, -0.15, 0.1, -0.09, -0.06, 0.55};

/* AUTO is one of these: test_auto. ViSP is slow (0.3 s an estimate), so it gets fewer scenes. */
enum { METHODS = 3 };
static const td_estimate_method methods[METHODS] = {TD_ESTIMATE_HOMOGRAPHY, TD_ESTIMATE_VISP,
                                                    TD_ESTIMATE_FAUGERAS_TOSCANI};

static int scenes(td_estimate_method method, int most)
{
    return method == TD_ESTIMATE_VISP ? 1 : most;
}

static bool spared(td_estimate_method method, td_camera_model model)
{
    return method == TD_ESTIMATE_VISP && model != TD_CAMERA_BROWN5;
}

typedef struct estimate {
    td_camera camera;
    td_pose pose[VIEWS];
    bool has_pose[VIEWS];
} estimate;

static td_status run(estimate *e, const td_observations *o, int camera, td_estimate_method method,
                     td_error *error)
{
    memset(e, 0x7f, sizeof *e);
    for (int v = 0; v < VIEWS; v++) e->has_pose[v] = v % 2;
    const td_observed_camera *c = &o->camera[camera];
    e->camera = (td_camera){.model = c->model, .width = c->width, .height = c->height};
    return td_first_estimate(&e->camera, e->pose, e->has_pose, o, camera, method, false, error);
}

/* Largest errors of the estimates that a test made: shares of the focal length and of the distance, and
 * degrees. */
typedef struct worst {
    double focal, distance, degrees;
} worst;

/* Distance between where the two poses put the middle of the target, over its distance; angle between the
 * poses. */
static void check_pose(const td_pose *found, const td_pose *truth, const td_target *target, double share,
                       double degrees, worst *w)
{
    double first[3], last[3], a[3], b[3], apart = 0, away = 0;
    td_target_point(first, target, 0);
    td_target_point(last, target, td_target_point_count(target) - 1);
    for (int i = 0; i < 3; i++) first[i] = (first[i] + last[i]) / 2;
    td_pose_transform(a, found, first);
    td_pose_transform(b, truth, first);
    for (int i = 0; i < 3; i++) {
        apart += (a[i] - b[i]) * (a[i] - b[i]);
        away += b[i] * b[i];
    }
    td_pose back = td_pose_inverse(truth), difference = td_pose_compose(found, &back);
    w->distance = fmax(w->distance, sqrt(apart / away));
    w->degrees = fmax(w->degrees, td_pose_angle(&difference) / DEGREE);
    check_less(sqrt(apart / away), share);
    check_less(td_pose_angle(&difference) / DEGREE, degrees);
}

/* All views but `wrong` (-1: none). */
static void check_estimate(const estimate *e, const simulation *s, int camera, const td_pose *rig_from_target,
                           int wrong, worst *w)
{
    const td_rig_camera *c = &s->rig->camera[camera];
    assert_int_equal(e->camera.model, c->camera.model);
    assert_int_equal(e->camera.width, 640);
    for (int i = 0; i < 2; i++) {
        double ratio = e->camera.parameter[i] / c->camera.parameter[i];
        w->focal = fmax(w->focal, fabs(ratio - 1));
        check_near(ratio, 1, 0.15);
    }
    td_error error = {0};
    check_ok(td_camera_check(&e->camera, &error), error);
    for (int v = 0; v < VIEWS; v++) {
        if (v == wrong) continue;
        td_pose truth = td_pose_compose(&c->camera_from_rig, &rig_from_target[v]);
        assert_true(e->has_pose[v]);
        check_pose(&e->pose[v], &truth, &s->target, 0.1, 10, w);
    }
}

static bool suits(td_estimate_method method, bool depth)
{
    return depth || method != TD_ESTIMATE_FAUGERAS_TOSCANI;
}

static void print_worst(const char *what, td_estimate_method method, const worst *w)
{
    print_message("%s, %s: focal length %.1f %%, distance %.1f %%, angle %.1f degrees at worst\n", what,
                  td_estimate_method_name(method), 100 * w->focal, 100 * w->distance, w->degrees);
}

static void test_free_views(void **state)
{
    (void)state;
    for (int depth = 0; depth < 2; depth++)
        for (size_t i = 0; i < METHODS; i++) {
            worst w = {0};
            for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT && suits(methods[i], depth); m++)
                for (int seed = 1; seed <= scenes(methods[i], 5); seed++) {
                    td_error error = {0};
                    simulation s = simulate_stereo(m, VIEWS);
                    td_pose truth[VIEWS];
                    estimate e;
                    if (depth) s.target = two_planes();
                    td_observations *o = simulate(&s, (uint64_t)seed, (uint64_t)seed, 0.1, 0.1);
                    true_poses(truth, &s, (uint64_t)seed);
                    for (int k = 0; k < scenes(methods[i], 2); k++) {
                        check_ok(run(&e, o, k, methods[i], &error), error);
                        check_estimate(&e, &s, k, truth, -1, &w);
                    }
                    td_observations_free(&o);
                    td_rig_free(&s.rig);
                }
            if (suits(methods[i], depth)) print_worst(depth ? "two planes" : "board", methods[i], &w);
        }
}

/* AUTO is Faugeras-Toscani for a target with depth whose camera is sought, else homographies. */
static void test_auto(void **state)
{
    (void)state;
    for (int depth = 0; depth < 2; depth++)
        for (int keep = 0; keep < 2; keep++) {
            td_error error = {0};
            simulation s = simulate_stereo(TD_CAMERA_BROWN5, VIEWS);
            if (depth) s.target = two_planes();
            td_observations *o = simulate(&s, 1, 1, 0.1, 0.1);
            estimate e[TD_ESTIMATE_COUNT];
            memset(e, 0, sizeof e);
            for (td_estimate_method m = 0; m < TD_ESTIMATE_COUNT; m++) {
                if (m == TD_ESTIMATE_VISP || !suits(m, depth)) continue;
                e[m].camera = s.rig->camera[0].camera;
                check_ok(td_first_estimate(&e[m].camera, e[m].pose, e[m].has_pose, o, 0, m, keep, &error),
                         error);
            }
            td_estimate_method same = depth && !keep ? TD_ESTIMATE_FAUGERAS_TOSCANI : TD_ESTIMATE_HOMOGRAPHY;
            const estimate *a = &e[TD_ESTIMATE_AUTO], *b = &e[same];
            assert_memory_equal(a->camera.parameter, b->camera.parameter, sizeof a->camera.parameter);
            assert_memory_equal(a->pose, b->pose, sizeof a->pose);
            assert_memory_equal(a->has_pose, b->has_pose, sizeof a->has_pose);
            if (depth && !keep)
                assert_memory_not_equal(a->pose, e[TD_ESTIMATE_HOMOGRAPHY].pose, sizeof a->pose);
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
}

/* Half of the views stand on the rail, the others are free: one rigid target, and boards beside it. */
static void test_rail(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++) {
        worst w = {0};
        for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
            for (int free_views = 0; free_views <= 4 && !spared(methods[i], m); free_views += 4) {
                td_error error = {0};
                simulation s = simulate_stereo(m, VIEWS);
                td_random noise = td_random_seed(5, 5);
                td_pose truth[VIEWS];
                estimate e;
                td_observations *o = simulate(&s, 2, 2, 0.1, 0.1);
                true_poses(truth, &s, 2);
                for (size_t v = (size_t)free_views; v < VIEWS; v++) {
                    truth[v] = td_pose_exp(rail);
                    put_on_rail(o, &s, v, &truth[v], 0.04 * (double)(v - (size_t)free_views), 0.1, &noise);
                }
                for (int k = 0; k < scenes(methods[i], 2); k++) {
                    check_ok(run(&e, o, k, methods[i], &error), error);
                    check_estimate(&e, &s, k, truth, -1, &w);
                    for (size_t v = (size_t)free_views; v < VIEWS; v++)
                        assert_memory_equal(&e.pose[v], &e.pose[free_views], sizeof *e.pose);
                    for (size_t v = 1; v < (size_t)free_views; v++)
                        assert_memory_not_equal(&e.pose[v], &e.pose[0], sizeof *e.pose);
                }
                td_observations_free(&o);
                td_rig_free(&s.rig);
            }
        print_worst("rail", methods[i], &w);
    }
}

/* A rail before which a target with depth is also moved by hand: the free view with most points is no part of
 * the rail's rigid target. */
static void test_rail_beside_free_target_with_depth(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_PINHOLE, VIEWS);
    td_random noise = td_random_seed(5, 5);
    td_pose truth[VIEWS];
    estimate e;
    worst w = {0};
    s.target = two_planes();
    td_observations *o = simulate(&s, 2, 2, 0, 0.1);
    true_poses(truth, &s, 2);
    for (size_t v = 4; v < VIEWS; v++) {
        truth[v] = td_pose_exp(rail);
        put_on_rail(o, &s, v, &truth[v], 0.03 * (double)(v - 4), 0, &noise);
        td_observations_get(o, v, 0)->point[0] = NAN;
    }
    check_ok(run(&e, o, 0, TD_ESTIMATE_FAUGERAS_TOSCANI, &error), error);
    check_estimate(&e, &s, 0, truth, -1, &w);
    check_less(w.focal, 1e-6);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* Heights that are all the same have no depth: AUTO takes homographies, and who asks for Faugeras-Toscani is
 * told. */
static void test_rail_of_one_height(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, VIEWS);
    td_random noise = td_random_seed(5, 5);
    td_pose truth[VIEWS];
    estimate e;
    worst w = {0};
    td_observations *o = simulate(&s, 2, 2, 0.1, 0.1);
    true_poses(truth, &s, 2);
    for (size_t v = 6; v < VIEWS; v++) {
        truth[v] = td_pose_exp(rail);
        put_on_rail(o, &s, v, &truth[v], 0.04, 0.1, &noise);
    }
    check_ok(run(&e, o, 0, TD_ESTIMATE_AUTO, &error), error);
    check_estimate(&e, &s, 0, truth, -1, &w);
    check_fails(run(&e, o, 0, TD_ESTIMATE_FAUGERAS_TOSCANI, &error), TD_ERROR_DATA, error, "lie on a plane");
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

typedef enum wrong_view { MIRRORED, OTHER_BOARD, OTHER_NUMBERS, WRONG_VIEWS } wrong_view;

static void spoil(td_detection *d, const td_target *target, wrong_view how, uint64_t seed)
{
    td_random random = td_random_seed(seed, 3);
    size_t columns = (size_t)target->plane[0].columns, plane = columns * (size_t)target->plane[0].rows;
    double *from = malloc(2 * d->count * sizeof *from);
    assert_non_null(from);
    memcpy(from, d->point, 2 * d->count * sizeof *from);
    for (size_t i = 0; i < d->count; i++) {
        size_t k = i % plane, x = k % columns, y = k / columns;
        if (how == MIRRORED) memcpy(d->point + 2 * i, from + 2 * (i - x + columns - 1 - x), 2 * sizeof *from);
        if (how == OTHER_NUMBERS)
            memcpy(d->point + 2 * i, from + 2 * td_random_below(&random, (uint32_t)d->count),
                   2 * sizeof *from);
        if (how == OTHER_BOARD) { /* of half the spacing along one side, read as ours */
            d->point[2 * i] = 200 + 12 * (double)x + 3 * (double)y + 100 * (double)(i / plane);
            d->point[2 * i + 1] = 150 - 2 * (double)x + 30 * (double)y;
        }
    }
    free(from);
}

static void test_wrong_view(void **state)
{
    (void)state;
    for (int depth = 0; depth < 2; depth++)
        for (size_t i = 0; i < METHODS; i++) {
            worst w = {0};
            for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT && suits(methods[i], depth); m++)
                for (wrong_view how = 0; how < WRONG_VIEWS && !spared(methods[i], m); how++)
                    for (int wrong = 0; wrong < scenes(methods[i], VIEWS); wrong += 3) {
                        td_error error = {0};
                        simulation s = simulate_stereo(m, VIEWS);
                        td_pose truth[VIEWS];
                        estimate e;
                        if (depth) s.target = two_planes();
                        td_observations *o = simulate(&s, 7, 7, 0.1, 0.1);
                        true_poses(truth, &s, 7);
                        spoil(td_observations_get(o, (size_t)wrong, 0), &s.target, how, (uint64_t)wrong);
                        check_ok(run(&e, o, 0, methods[i], &error), error);
                        check_estimate(&e, &s, 0, truth, wrong, &w);
                        td_observations_free(&o);
                        td_rig_free(&s.rig);
                    }
            if (suits(methods[i], depth))
                print_worst(depth ? "a wrong view, two planes" : "a wrong view, board", methods[i], &w);
        }
}

/* One of the rail's boards was turned by 180 degrees, or is another. */
static void test_wrong_view_on_rail(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++) {
        worst w = {0};
        for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++)
            for (int how = -1; how < WRONG_VIEWS && !spared(methods[i], m); how++)
                for (int wrong = 0; wrong < scenes(methods[i], VIEWS); wrong += 3) {
                    td_error error = {0};
                    simulation s = simulate_stereo(m, VIEWS);
                    td_random noise = td_random_seed(5, 5);
                    td_pose truth[VIEWS];
                    estimate e;
                    td_observations *o = simulate(&s, 2, 2, 0.1, 0.1);
                    for (size_t v = 0; v < VIEWS; v++) {
                        truth[v] = td_pose_exp(rail);
                        put_on_rail(o, &s, v, &truth[v], 0.03 * (double)v, 0.1, &noise);
                    }
                    td_detection *d = td_observations_get(o, (size_t)wrong, 0);
                    for (size_t p = 0; p < d->count && how < 0; p++)
                        memcpy(d->point + 2 * p,
                               td_observations_get(o, (size_t)wrong, 1)->point + 2 * (d->count - 1 - p),
                               2 * sizeof(double));
                    if (how >= 0) spoil(d, &s.target, (wrong_view)how, (uint64_t)wrong);
                    check_ok(run(&e, o, 0, methods[i], &error), error);
                    check_estimate(&e, &s, 0, truth, wrong, &w);
                    td_observations_free(&o);
                    td_rig_free(&s.rig);
                }
        print_worst("a wrong view on the rail", methods[i], &w);
    }
}

static void test_keep_camera(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++)
        for (int depth = 0; depth < 2; depth++)
            for (td_camera_model m = 0; m < TD_CAMERA_MODEL_COUNT; m++) {
                td_error error = {0};
                simulation s = simulate_stereo(m, VIEWS);
                td_pose truth[VIEWS];
                estimate e;
                worst w = {0};
                if (depth) s.target = two_planes();
                td_observations *o = simulate(&s, 3, 3, 0, 0.1);
                true_poses(truth, &s, 3);
                for (int k = 0; k < scenes(methods[i], 2); k++) {
                    memset(&e, 0x7f, sizeof e);
                    e.camera = s.rig->camera[k].camera;
                    check_ok(td_first_estimate(&e.camera, e.pose, e.has_pose, o, k, methods[i], true, &error),
                             error);
                    assert_memory_equal(e.camera.parameter, s.rig->camera[k].camera.parameter,
                                        sizeof e.camera.parameter);
                    for (int v = 0; v < VIEWS; v++) {
                        td_pose t = td_pose_compose(&s.rig->camera[k].camera_from_rig, &truth[v]);
                        assert_true(e.has_pose[v]);
                        /* Exact points and the true camera: nothing is left but rounding. */
                        check_pose(&e.pose[v], &t, &s.target, 1e-5, 1e-3, &w);
                    }
                }
                td_observations_free(&o);
                td_rig_free(&s.rig);
            }
}

static void test_partly_seen(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++)
        for (int depth = 0; depth < 2; depth++) {
            if (!suits(methods[i], depth)) continue;
            td_error error = {0};
            simulation s = simulate_stereo(TD_CAMERA_BROWN5, VIEWS);
            td_pose truth[VIEWS];
            estimate e;
            worst w = {0};
            if (depth) s.target = two_planes();
            td_observations *o = simulate(&s, 4, 4, 0.1, 0.1);
            true_poses(truth, &s, 4);
            td_observations_get(o, 2, 0)->found = false;
            td_detection *three = td_observations_get(o, 5, 0), *line = td_observations_get(o, 6, 0),
                         *some = td_observations_get(o, 7, 0);
            for (size_t p = 3; p < three->count; p++) three->point[2 * p + p % 2] = NAN;
            size_t columns = (size_t)s.target.plane[0].columns;
            for (size_t p = columns; p < line->count; p++) line->point[2 * p] = NAN;
            for (size_t p = 0; p < some->count; p += 3) some->point[2 * p] = NAN;
            check_ok(run(&e, o, 0, methods[i], &error), error);
            const bool expected[VIEWS] = {true, true, false, true, true, false, false, true};
            for (int v = 0; v < VIEWS; v++) {
                assert_int_equal(e.has_pose[v], expected[v]);
                if (expected[v]) check_pose(&e.pose[v], &truth[v], &s.target, 0.1, 10, &w);
            }
            for (int v = 0; v < VIEWS; v++) td_observations_get(o, (size_t)v, 0)->found = false;
            check_fails(run(&e, o, 0, methods[i], &error), TD_ERROR_DATA, error,
                        methods[i] == TD_ESTIMATE_FAUGERAS_TOSCANI ? "Faugeras-Toscani" : "4 points");
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
}

/* Pixels that are not square. */
static void test_aspect(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++) {
        worst w = {0};
        for (int depth = 0; depth < 2; depth++) {
            if (!suits(methods[i], depth)) continue;
            td_error error = {0};
            simulation s = simulate_stereo(TD_CAMERA_BROWN5, VIEWS);
            td_pose truth[VIEWS];
            estimate e;
            s.rig->camera[0].camera.parameter[1] *= 0.7;
            if (depth) s.target = two_planes();
            td_observations *o = simulate(&s, 6, 6, 0.1, 0.1);
            true_poses(truth, &s, 6);
            check_ok(run(&e, o, 0, methods[i], &error), error);
            check_estimate(&e, &s, 0, truth, -1, &w);
            td_observations_free(&o);
            td_rig_free(&s.rig);
        }
        print_worst("pixels of 10 by 7", methods[i], &w);
    }
}

static void test_flat_target_refused(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, VIEWS);
    estimate e;
    td_observations *o = simulate(&s, 4, 4, 0.1, 0.1);
    check_fails(run(&e, o, 0, TD_ESTIMATE_FAUGERAS_TOSCANI, &error), TD_ERROR_DATA, error,
                "target with depth");
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* 180 degrees from side to side: much of what it sees a homography cannot hold. */
static void test_wide_fisheye(void **state)
{
    (void)state;
    for (size_t i = 0; i < METHODS; i++) {
        worst w = {0};
        for (int seed = 1; seed <= scenes(methods[i], 5); seed++)
            for (int depth = 0; depth < 2; depth++) {
                if (!suits(methods[i], depth)) continue;
                td_error error = {0};
                simulation s = simulate_stereo(TD_CAMERA_FISHEYE, VIEWS);
                td_pose truth[VIEWS];
                estimate e;
                s.near_m = 0.12;
                s.far_m = 0.3;
                for (int k = 0; k < 2; k++)
                    for (int j = 0; j < 2; j++) s.rig->camera[k].camera.parameter[j] = 200;
                if (depth) s.target = two_planes();
                td_observations *o = simulate(&s, (uint64_t)seed, (uint64_t)seed, 0.1, 0.1);
                true_poses(truth, &s, (uint64_t)seed);
                check_ok(run(&e, o, 0, methods[i], &error), error);
                check_estimate(&e, &s, 0, truth, -1, &w);
                td_observations_free(&o);
                td_rig_free(&s.rig);
            }
        print_worst("wide fisheye", methods[i], &w);
    }
}

static void test_names(void **state)
{
    (void)state;
    for (td_estimate_method m = 0; m < TD_ESTIMATE_COUNT; m++) {
        assert_non_null(td_estimate_method_name(m));
        assert_int_equal(td_estimate_method_from_name(td_estimate_method_name(m)), m);
    }
    assert_null(td_estimate_method_name(TD_ESTIMATE_COUNT));
    assert_int_equal(td_estimate_method_from_name("no such method"), TD_ESTIMATE_COUNT);
    assert_int_equal(td_estimate_method_from_name("visp"), TD_ESTIMATE_VISP);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_free_views),
                                       cmocka_unit_test(test_auto),
                                       cmocka_unit_test(test_rail),
                                       cmocka_unit_test(test_rail_beside_free_target_with_depth),
                                       cmocka_unit_test(test_rail_of_one_height),
                                       cmocka_unit_test(test_wrong_view),
                                       cmocka_unit_test(test_wrong_view_on_rail),
                                       cmocka_unit_test(test_keep_camera),
                                       cmocka_unit_test(test_partly_seen),
                                       cmocka_unit_test(test_aspect),
                                       cmocka_unit_test(test_flat_target_refused),
                                       cmocka_unit_test(test_wide_fisheye),
                                       cmocka_unit_test(test_names)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
