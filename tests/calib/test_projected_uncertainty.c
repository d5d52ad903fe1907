/* Proves: a calibration can be taken up where it ended (covariance to 1e-9 of the standard deviations, also
 * when a view was renumbered, cameras were held, views share a rail); the gradient of the reprojected point
 * equals differences of an independent reprojection through every board; the covariance equals the one
 * written out over all blocks; the map equals single queries; and the predicted covariance is that of the
 * errors, over repeated simulated calibrations with fresh noise. References: differences, dense products,
 * simulated truth. Tolerances: gradients 1e-6 of their largest element (rounding of differences), products
 * 1e-8; error over sigma within what chi-square leaves once in a thousand times for all points together (1000
 * calibrations with TELEDIMOS_FULL=1, 80 and 40 otherwise). Blind to: model error, which no covariance
 * foresees. */
#include <time.h>

#include "calib/projected_internal.h"
#include "calib/projected_uncertainty.h"
#include "core/linalg.h"
#include "core/parallel.h"
#include "tests/calib/simulate_depth.h"

static td_calibration *calibrated(const td_observations *o, const td_calibrate_options *given)
{
    td_error error = {0};
    td_calibration *c = NULL;
    td_calibrate_options options = given ? *given : td_calibrate_options_default();
    options.leave_one_out = false;
    check_ok(td_calibrate(&c, o, &options, &error), error);
    return c;
}

/* ---- taken up where it ended ---- */

/* The rig's covariance and residuals of the rebuilt problem against the calibration's. */
static void check_rebuilt(const td_calibration *c, const td_observations *o)
{
    td_error error = {0};
    td_bundle_result result;
    check_ok(td_bundle_result_new(&result, c, o, &error), error);
    size_t n = td_rig_parameter_count(c->rig);
    for (int a = 0; a < c->rig->count; a++)
        for (int b = 0; b < c->rig->count; b++)
            for (int kind = 0; kind < 4; kind++) {
                bool pose_a = kind & 1, pose_b = kind & 2;
                if ((pose_a && a == 0) || (pose_b && b == 0)) continue;
                const td_bundle_blocks *blocks = &result.problem.blocks;
                size_t pa = (size_t)td_camera_parameter_count(c->rig->camera[a].camera.model);
                size_t pb = (size_t)td_camera_parameter_count(c->rig->camera[b].camera.model);
                size_t row = td_rig_parameter_offset(c->rig, a) + (pose_a ? pa : 0);
                size_t column = td_rig_parameter_offset(c->rig, b) + (pose_b ? pb : 0);
                double block[TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE];
                check_ok(td_covariance_get(block, result.covariance,
                                           pose_a ? blocks->pose[a] : blocks->camera[a],
                                           pose_b ? blocks->pose[b] : blocks->camera[b], &error),
                         error);
                size_t height = pose_a ? 6 : pa, width = pose_b ? 6 : pb;
                for (size_t i = 0; i < height; i++)
                    for (size_t k = 0; k < width; k++) {
                        double si = c->rig->covariance[(row + i) * (n + 1)],
                               sk = c->rig->covariance[(column + k) * (n + 1)];
                        check_near(block[i * width + k], c->rig->covariance[(row + i) * n + column + k],
                                   1e-9 * sqrt(si * sk));
                    }
            }
    size_t points = td_target_point_count(&o->target);
    for (size_t v = 0; v < o->view_count; v++)
        for (int k = 0; k < o->camera_count; k++)
            for (size_t p = 0; p < points; p++) {
                double r[2];
                size_t index = td_bundle_index(&result.bundle, v, k, p);
                if (!c->used[index]) continue;
                assert_true(td_bundle_residual(r, &result.bundle, v, k, p));
                for (int i = 0; i < 2; i++) check_near(r[i], c->residual[2 * index + i], 1e-10);
            }
    check_near(td_covariance_chi2(result.covariance) /
                   ((double)td_covariance_rows(result.covariance) -
                    (double)td_covariance_free_parameters(result.covariance)),
               c->chi2_per_dof, 1e-9);
    td_bundle_result_free(&result);
}

static void turn_half(td_detection *d)
{
    for (size_t i = 0; i < d->count / 2; i++) {
        size_t j = d->count - 1 - i;
        for (int k = 0; k < 2; k++) {
            double t = d->point[2 * i + k];
            d->point[2 * i + k] = d->point[2 * j + k];
            d->point[2 * j + k] = t;
        }
        double t = d->sigma[i];
        d->sigma[i] = d->sigma[j];
        d->sigma[j] = t;
    }
}

static void test_rebuilt(void **state)
{
    (void)state;
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    s.warp_m[0] = 1e-3;
    td_observations *o = simulate(&s, 31, 32, 0.1, 0.05);
    for (size_t v = 0; v < o->view_count; v++)
        for (int k = 0; k < 2; k++)
            for (size_t i = 0; i < 54; i++) td_observations_get(o, v, k)->sigma[i] = 0.02 + 0.002 * (double)i;
    td_observations_get(o, 2, 0)->point[9] += 7; /* an outlier */
    td_observations_get(o, 5, 0)->found = false;
    turn_half(td_observations_get(o, 3, 1));
    td_calibration *c = calibrated(o, NULL);
    assert_true(c->has_warp && c->own_sigma);
    assert_int_equal(c->view[3].state, TD_VIEW_CORRECTED);
    assert_true(c->camera[0].outlier_points > 0);
    check_rebuilt(c, o);

    td_calibrate_options options = td_calibrate_options_default();
    options.plain = true;
    td_calibration *plain = calibrated(o, &options);
    assert_false(plain->own_sigma);
    check_rebuilt(plain, o);
    td_calibration_free(&plain);

    /* Held, with the covariance of the first. */
    options = td_calibrate_options_default();
    options.known = c->rig;
    options.hold[1] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION;
    td_calibration *held = calibrated(o, &options);
    assert_true(held->covariance_known);
    check_rebuilt(held, o);
    td_calibration_free(&held);

    td_calibration_free(&c);
    td_observations_free(&o);
    s.warp_m[0] = 0;
    o = simulate(&s, 33, 34, 0.1, 0.1);
    put_rest_on_rail(o, &s, 35, 6);
    c = calibrated(o, NULL);
    check_rebuilt(c, o);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* The bias of marks moves their images, not the problem: it is small beside the 1e-9 only where it is taken
 * off the points, so the residuals tell. */
static void test_rebuilt_marks(void **state)
{
    (void)state;
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 8);
    s.target.kind = TD_TARGET_MARKS;
    s.target.diameter_m = 0.015;
    s.target.polarity = TD_MARK_DARK;
    td_observations *o = simulate(&s, 36, 37, 0.1, 0.1);
    td_calibration *c = calibrated(o, NULL);
    check_rebuilt(c, o);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

static void test_other_observations(void **state)
{
    (void)state;
    td_error error = {0};
    double out[4];
    const td_projected_query q = {0, {320, 240}, 0.5};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 8);
    td_observations *o = simulate(&s, 41, 42, 0.1, 0.1);
    td_calibration *c = calibrated(o, NULL);
    o->view_count--;
    check_fails(td_projected_uncertainty(out, &q, 1, c, o, &error), TD_ERROR_ARGUMENT, error,
                "7 views of 2 cameras, calibrated were 8 of 2");
    o->view_count++;
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* ---- gradient ---- */

enum { BOARDS = 3 };

/* The mean of the projections, written out: p fixed to each board, boards and camera wherever they are now.
 */
static void reprojected(double q[2], const td_rig *rig, int camera, const td_pose board[BOARDS],
                        const double fixed[BOARDS][3], bool far)
{
    q[0] = q[1] = 0;
    for (int i = 0; i < BOARDS; i++) {
        double x[3], u[2];
        const td_rig_camera *c = &rig->camera[camera];
        (far ? td_pose_rotate : td_pose_transform)(x, &board[i], fixed[i]);
        (far ? td_pose_rotate : td_pose_transform)(x, &c->camera_from_rig, x);
        assert_true(td_camera_project(u, NULL, NULL, &c->camera, x));
        for (int k = 0; k < 2; k++) q[k] += u[k] / BOARDS;
    }
}

static void check_gradient(td_rig *rig, int camera, const double pixel[2], double distance_m,
                           td_random *random)
{
    td_rig_camera *c = &rig->camera[camera];
    bool far = isinf(distance_m);
    double ray[3], g[2 * TD_PROJECTED_MOST], fixed[BOARDS][3], plus[2], minus[2];
    td_pose board[BOARDS], kept_pose = c->camera_from_rig;
    size_t n, parameters = (size_t)td_camera_parameter_count(c->camera.model);
    assert_true(td_projected_gradient(g, &n, rig, camera, pixel, distance_m));
    assert_int_equal(n, parameters + 12);
    assert_true(td_camera_unproject(ray, NULL, NULL, &c->camera, pixel));
    for (int i = 0; i < BOARDS; i++) {
        double xi[6];
        for (int k = 0; k < 6; k++) xi[k] = td_random_normal(random);
        board[i] = td_pose_exp(xi);
        td_pose chain = td_pose_compose(&c->camera_from_rig, &board[i]), back = td_pose_inverse(&chain);
        double p[3] = {ray[0], ray[1], ray[2]};
        for (int k = 0; k < 3 && !far; k++) p[k] *= distance_m;
        (far ? td_pose_rotate : td_pose_transform)(fixed[i], &back, p);
    }
    double scale[3] = {0}, largest = 0;
    for (size_t k = 0; k < 2 * n; k++) largest = fmax(largest, fabs(g[k]));
    assert_true(largest > 0);
    bool identical = true;
    for (size_t k = 0; k < n; k++) {
        int kind = k < parameters ? 0 : k < parameters + 6 ? 1 : 2;
        double difference[2] = {0}, step = 1e-6;
        if (kind == 0) {
            double kept = c->camera.parameter[k];
            step = 1e-6 * fmax(fabs(kept), 0.1);
            c->camera.parameter[k] = kept + step;
            reprojected(plus, rig, camera, board, fixed, far);
            c->camera.parameter[k] = kept - step;
            reprojected(minus, rig, camera, board, fixed, far);
            c->camera.parameter[k] = kept;
            for (int i = 0; i < 2; i++) difference[i] = (plus[i] - minus[i]) / (2 * step);
        } else if (kind == 1) {
            double xi[6] = {0};
            xi[k - parameters] = step;
            c->camera_from_rig = td_pose_perturb(&kept_pose, xi);
            reprojected(plus, rig, camera, board, fixed, far);
            xi[k - parameters] = -step;
            c->camera_from_rig = td_pose_perturb(&kept_pose, xi);
            reprojected(minus, rig, camera, board, fixed, far);
            c->camera_from_rig = kept_pose;
            for (int i = 0; i < 2; i++) difference[i] = (plus[i] - minus[i]) / (2 * step);
        } else {
            /* Each board alone moves the mean by a share: their sum is the derivative by the mean motion. */
            for (int b = 0; b < BOARDS; b++) {
                td_pose kept = board[b];
                double xi[6] = {0};
                xi[k - parameters - 6] = step;
                board[b] = td_pose_perturb(&kept, xi);
                reprojected(plus, rig, camera, board, fixed, far);
                xi[k - parameters - 6] = -step;
                board[b] = td_pose_perturb(&kept, xi);
                reprojected(minus, rig, camera, board, fixed, far);
                board[b] = kept;
                for (int i = 0; i < 2; i++) {
                    double share = (plus[i] - minus[i]) / (2 * step);
                    check_near(share, g[(size_t)i * n + k] / BOARDS, 1e-6 * largest);
                    difference[i] += share;
                }
            }
        }
        for (int i = 0; i < 2; i++) {
            double analytic = g[(size_t)i * n + k];
            check_near(difference[i], analytic, 1e-6 * fmax(fabs(analytic), 1e-3 * largest) + 1e-6);
            scale[kind] = fmax(scale[kind], fabs(analytic));
            identical = identical && difference[i] == analytic;
        }
    }
    for (int kind = 0; kind < 3; kind++) assert_true(scale[kind] > 0);
    assert_false(identical);
}

static void test_gradient(void **state)
{
    (void)state;
    td_random random = td_random_seed(51, 1);
    for (td_camera_model model = 0; model < TD_CAMERA_MODEL_COUNT; model++) {
        simulation s = simulate_stereo(model, 1);
        const double distance[3] = {0.4, 3, INFINITY};
        for (int k = 0; k < 2; k++)
            for (int d = 0; d < 3; d++)
                for (int i = 0; i < 5; i++) {
                    const double pixel[2] = {639 * td_random_uniform(&random),
                                             479 * td_random_uniform(&random)};
                    check_gradient(s.rig, k, pixel, distance[d], &random);
                }
        td_rig_free(&s.rig);
    }
}

/* ---- covariance ---- */

/* G C G^T with every board's block written out. */
static void written_out(double out[4], const td_bundle_result *result, int camera, const double pixel[2],
                        double distance_m)
{
    td_error error = {0};
    const td_rig *rig = result->bundle.rig;
    const td_bundle_blocks *blocks = &result->problem.blocks;
    size_t n, parameters = (size_t)td_camera_parameter_count(rig->camera[camera].camera.model), count = 0;
    double g[2 * TD_PROJECTED_MOST];
    int block[64];
    size_t column[64], width[64];
    assert_true(td_projected_gradient(g, &n, rig, camera, pixel, distance_m));
    block[count] = blocks->camera[camera], column[count] = 0, width[count++] = parameters;
    if (camera) block[count] = blocks->pose[camera], column[count] = parameters, width[count++] = 6;
    size_t boards = count;
    for (size_t i = 0; i < result->board_count; i++)
        block[count] = result->board[i], column[count] = parameters + 6, width[count++] = 6;
    for (int i = 0; i < 4; i++) out[i] = 0;
    for (size_t a = 0; a < count; a++)
        for (size_t b = 0; b < count; b++) {
            double c[TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE];
            double share = (a < boards ? 1 : 1 / (double)result->board_count) *
                           (b < boards ? 1 : 1 / (double)result->board_count);
            check_ok(td_covariance_get(c, result->covariance, block[a], block[b], &error), error);
            for (size_t i = 0; i < 2; i++)
                for (size_t j = 0; j < 2; j++)
                    for (size_t k = 0; k < width[a]; k++)
                        for (size_t l = 0; l < width[b]; l++)
                            out[2 * i + j] += share * g[i * n + column[a] + k] * c[k * width[b] + l] *
                                              g[j * n + column[b] + l];
        }
}

static void test_covariance(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_observations *o = simulate(&s, 61, 62, 0.1, 0.05);
    put_rest_on_rail(o, &s, 63, 8);
    td_observations_get(o, 4, 0)->found = td_observations_get(o, 4, 1)->found = false;
    td_calibration *c = calibrated(o, NULL);
    td_bundle_result result;
    check_ok(td_bundle_result_new(&result, c, o, &error), error);
    assert_int_equal(result.board_count, 8); /* ten views, one unseen, two on one rail */
    const td_projected_query query[] = {
        {0, {320, 240}, 0.5},     {0, {0, 0}, 0.4},     {1, {639, 479}, 0.5}, {1, {100, 300}, INFINITY},
        {0, {500, 50}, INFINITY}, {0, {5000, 5000}, 1}, {0, {500, 50}, 1e7}};
    double out[7 * 4], expected[4];
    check_ok(td_projected_uncertainty(out, query, 7, c, o, &error), error);
    for (int i = 0; i < 5; i++) {
        written_out(expected, &result, query[i].camera, query[i].pixel, query[i].distance_m);
        double size = expected[0] + expected[3];
        for (int k = 0; k < 4; k++) check_near(out[4 * i + k], expected[k], 1e-8 * size);
        printf("  camera %d, (%3.0f, %3.0f) at %4.1f m: sigma %.4f px\n", query[i].camera, query[i].pixel[0],
               query[i].pixel[1], query[i].distance_m, td_worst_sigma(out + 4 * i));
        assert_true(out[4 * i] > 0 && out[4 * i + 3] > 0);
    }
    /* Infinity is where growing distances lead; no ray, no covariance. */
    for (int k = 0; k < 4; k++) check_near(out[4 * 6 + k], out[4 * 4 + k], 1e-4 * (out[16] + out[19]));
    assert_true(isnan(out[20]) && isnan(out[23]));

    td_projected_query bad = query[0];
    bad.camera = 2;
    check_fails(td_projected_uncertainty(out, &bad, 1, c, o, &error), TD_ERROR_ARGUMENT, error,
                "no camera 2");
    bad = query[0];
    bad.distance_m = 0;
    check_fails(td_projected_uncertainty(out, &bad, 1, c, o, &error), TD_ERROR_ARGUMENT, error, "distance_m");
    td_bundle_result_free(&result);
    td_calibration_free(&c);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* What is held exactly, cameras and all, leaves the boards' noise alone; held with its covariance, more. */
static void test_held(void **state)
{
    (void)state;
    td_error error = {0};
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 10);
    td_observations *o = simulate(&s, 64, 65, 0.1, 0.1);
    td_calibration *free_one = calibrated(o, NULL);
    td_calibrate_options options = td_calibrate_options_default();
    options.known = free_one->rig;
    options.hold[0] = options.hold[1] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION | TD_HOLD_POSE;
    td_calibration *held = calibrated(o, &options);
    free(free_one->rig->covariance);
    free_one->rig->covariance = NULL;
    td_calibration *exact = calibrated(o, &options);
    assert_false(exact->covariance_known);
    const td_projected_query q = {0, {60, 60}, 0.5};
    double with[4], without[4];
    check_ok(td_projected_uncertainty(with, &q, 1, held, o, &error), error);
    check_ok(td_projected_uncertainty(without, &q, 1, exact, o, &error), error);
    assert_true(td_worst_sigma(without) > 0.001 && td_worst_sigma(without) < td_worst_sigma(with));
    td_calibration_free(&free_one);
    td_calibration_free(&held);
    td_calibration_free(&exact);
    td_observations_free(&o);
    td_rig_free(&s.rig);
}

/* ---- map ---- */

static double now(void)
{
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void test_map(void **state)
{
    (void)state;
    td_error error = {0};
    td_uncertainty_map *map = NULL;
    const size_t views[2] = {13, sanitized_tests() ? 20 : 200};
    for (int i = 0; i < 2; i++) {
        simulation s = simulate_stereo(TD_CAMERA_BROWN5, views[i]);
        td_observations *o = simulate(&s, 71, 72, 0.1, 0.1);
        td_calibration *c = calibrated(o, NULL);
        const double distance[3] = {0.4, 1, INFINITY};
        double best = INFINITY;
        for (int k = 0; k < 3; k++) {
            td_uncertainty_map_free(&map);
            double start = now();
            check_ok(td_uncertainty_map_new(&map, 20, 15, distance, 3, c, o, &error), error);
            best = fmin(best, now() - start);
        }
        printf("  2 cameras, 3 distances, 20 x 15, %zu views: %.1f ms\n", views[i], 1e3 * best);
        for (int k = 0; k < 2; k++)
            for (int d = 0; d < 3; d++) {
                const td_projected_query q = {k, {639.0 * 19 / 19, 479.0 * 7 / 14}, distance[d]};
                double out[4];
                check_ok(td_projected_uncertainty(out, &q, 1, c, o, &error), error);
                check_near(map->sigma_px[((k * 3 + d) * 15 + 7) * 20 + 19], td_worst_sigma(out), 1e-12);
            }
        td_uncertainty_map_free(&map);
        assert_null(map);

        /* The distances it takes by itself. */
        check_ok(td_uncertainty_map_new(&map, 1, 1, NULL, 0, c, o, &error), error);
        assert_int_equal(map->distance_count, 4);
        assert_true(map->distance_m[0] > 0.34 && map->distance_m[0] < map->distance_m[2]);
        check_near(map->distance_m[1], (map->distance_m[0] + map->distance_m[2]) / 2, 1e-12);
        check_near(map->distance_m[3], 10 * map->distance_m[2], 1e-12);
        td_uncertainty_map_free(&map);
        check_fails(td_uncertainty_map_new(&map, 0, 5, NULL, 0, c, o, &error), TD_ERROR_ARGUMENT, error,
                    "0 x 5");
        check_fails(td_uncertainty_map_new(&map, 5, 5, distance, 0, c, o, &error), TD_ERROR_ARGUMENT, error,
                    "distance_count");
        td_calibration_free(&c);
        td_observations_free(&o);
        td_rig_free(&s.rig);
    }
    const double s[4] = {2, 1, 1, 2}; /* eigenvalues 1 and 3 */
    check_near(td_worst_sigma(s), sqrt(3), 1e-15);
}

/* ---- Monte Carlo ---- */

enum { GRID = 9, DISTANCES = 3, POINTS = 2 * GRID * DISTANCES, MOST_RUNS = 1000 };

typedef struct monte_carlo {
    const simulation *truth;
    const td_pose *board;            /* (views) true rig_from_target */
    const td_projected_query *query; /* (POINTS) */
    double (*error)[POINTS][2];      /* (runs) px */
    double (*square)[POINTS];        /* (runs) error^T covariance^-1 error */
    double (*sigma)[POINTS];         /* (runs) worst direction's sigma, px */
    double noise_px, sigma_px;
    uint64_t first_seed; /* of the noise */
} monte_carlo;

/* Where a solved calibration images the point that truly stands at the query, fixed to the true boards. */
static void image_of(double q[2], const monte_carlo *mc, const td_calibration *c,
                     const td_projected_query *query)
{
    const td_rig_camera *truth = &mc->truth->rig->camera[query->camera],
                        *got = &c->rig->camera[query->camera];
    bool far = isinf(query->distance_m);
    double p[3];
    q[0] = q[1] = 0;
    assert_true(td_camera_unproject(p, NULL, NULL, &truth->camera, query->pixel));
    for (int i = 0; i < 3 && !far; i++) p[i] *= query->distance_m;
    for (size_t v = 0; v < mc->truth->views; v++) {
        td_pose chain = td_pose_compose(&truth->camera_from_rig, &mc->board[v]),
                back = td_pose_inverse(&chain);
        double x[3], u[2];
        (far ? td_pose_rotate : td_pose_transform)(x, &back, p);
        (far ? td_pose_rotate : td_pose_transform)(x, &c->view[v].rig_from_target, x);
        (far ? td_pose_rotate : td_pose_transform)(x, &got->camera_from_rig, x);
        assert_true(td_camera_project(u, NULL, NULL, &got->camera, x));
        for (int i = 0; i < 2; i++) q[i] += u[i] / (double)mc->truth->views;
    }
}

static void run_one(size_t index, void *user)
{
    monte_carlo *mc = user;
    td_error error = {0};
    td_observations *o = simulate(mc->truth, 81, mc->first_seed + index, mc->noise_px, mc->sigma_px);
    td_calibration *c = NULL;
    td_calibrate_options options = td_calibrate_options_default();
    options.leave_one_out = false;
    options.threads = 1;
    double s[POINTS * 4];
    for (int i = 0; i < POINTS; i++) mc->square[index][i] = NAN; /* fails the test where nothing comes */
    if (td_calibrate(&c, o, &options, &error) == TD_OK &&
        td_projected_uncertainty(s, mc->query, POINTS, c, o, &error) == TD_OK)
        for (int i = 0; i < POINTS; i++) {
            double q[2], *e = mc->error[index][i], *k = s + 4 * i;
            image_of(q, mc, c, &mc->query[i]);
            for (int j = 0; j < 2; j++) e[j] = q[j] - mc->query[i].pixel[j];
            mc->square[index][i] = (e[0] * e[0] * k[3] - 2 * e[0] * e[1] * k[1] + e[1] * e[1] * k[0]) /
                                   (k[0] * k[3] - k[1] * k[1]);
            mc->sigma[index][i] = td_worst_sigma(k);
        }
    td_calibration_free(&c);
    td_observations_free(&o);
}

/* Error and prediction of nine image points at three distances in both cameras. The weighted square of a
 * point is chi-square with 2 degrees of freedom a calibration, so `sigma_bounds` is asked for 2 runs. */
static void check_monte_carlo(double noise_px, double sigma_px, size_t few, uint64_t first_seed)
{
    size_t runs = sanitized_tests() ? 6 : full_tests() ? MOST_RUNS : few;
    simulation s = simulate_stereo(TD_CAMERA_BROWN5, 12);
    td_pose board[12];
    td_random scene = td_random_seed(81, 11);
    for (size_t v = 0; v < s.views; v++) board[v] = simulated_pose(&s, &scene);
    td_projected_query query[POINTS];
    const double distance[DISTANCES] = {0.35, 0.7, INFINITY};
    for (int i = 0; i < POINTS; i++)
        query[i] = (td_projected_query){i / (GRID * DISTANCES),
                                        {100 + 220 * (i % 3), 75 + 165 * (i / 3 % 3)},
                                        distance[i / GRID % DISTANCES]};
    monte_carlo mc = {&s,
                      board,
                      query,
                      calloc(MOST_RUNS, sizeof *mc.error),
                      calloc(MOST_RUNS, sizeof *mc.square),
                      calloc(MOST_RUNS, sizeof *mc.sigma),
                      noise_px,
                      sigma_px,
                      first_seed};
    assert_int_equal(td_parallel_for(runs, 0, run_one, &mc, NULL, NULL), TD_OK);
    double low, high, total = 0;
    sigma_bounds(&low, &high, 2 * runs, POINTS);
    printf("noise %.2f px, detections say %.2f px, %zu calibrations: error over sigma within [%.3f, %.3f]\n",
           noise_px, sigma_px, runs, low, high);
    for (int i = 0; i < POINTS; i++) {
        double sum = 0, sigma = 0;
        for (size_t k = 0; k < runs; k++) {
            sum += mc.square[k][i] / (2 * (double)runs);
            sigma += mc.sigma[k][i] / (double)runs;
        }
        if (i % GRID == 0)
            printf("  %s, %.2f m: ratio (sigma px)\n", s.rig->camera[query[i].camera].name,
                   query[i].distance_m);
        printf("    %.3f (%.3f)%s", sqrt(sum), sigma, i % 3 == 2 ? "\n" : "");
        total += sum / POINTS;
        assert_true(sqrt(sum) > low);
        assert_true(sqrt(sum) < high);
    }
    printf("  all: %.3f\n", sqrt(total));
    free(mc.error);
    free(mc.square);
    free(mc.sigma);
    td_rig_free(&s.rig);
}

static void test_known_sigma(void **state)
{
    (void)state;
    check_monte_carlo(0.1, 0.1, 80, 9000);
}

/* Nothing is known of the points' own sigma: the noise is estimated from the residuals. */
static void test_estimated_sigma(void **state)
{
    (void)state;
    check_monte_carlo(0.3, 0, 40, 19000);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_rebuilt),
                                       cmocka_unit_test(test_rebuilt_marks),
                                       cmocka_unit_test(test_other_observations),
                                       cmocka_unit_test(test_gradient),
                                       cmocka_unit_test(test_covariance),
                                       cmocka_unit_test(test_held),
                                       cmocka_unit_test(test_map),
                                       cmocka_unit_test(test_known_sigma),
                                       cmocka_unit_test(test_estimated_sigma)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
