/* Simulated views of a board by a rig: truth for the calibration tests. */
#ifndef TELEDIMOS_TESTS_CALIB_SIMULATE_H
#define TELEDIMOS_TESTS_CALIB_SIMULATE_H

#include "calib/calibrate.h"
#include "core/random.h"
#include "tests/check.h"

typedef struct simulation {
    td_rig *rig; /* truth */
    td_target target;
    size_t views;
    double warp_m[2];
    double largest_tilt; /* rad */
    double near_m, far_m;
    /* The board's own errors: each point's place, once and for all, along x, y and z; a sag of this size in
     * the middle of every view, along a direction of its own; a stretch of this RMS over the board and along
     * each axis. All normal. */
    double print_m, sag_m, stretch_m;
} simulation;

static inline td_camera simulated_camera(td_camera_model model, double focal, double dx)
{
    td_camera c = {.model = model, .width = 640, .height = 480};
    const double p[4][TD_CAMERA_MAX_PARAMETERS] = {
        {0},
        {0, 0, 0, 0, -0.28, 0.10, 1e-3, -5e-4, -0.02},
        {0, 0, 0, 0, -0.20, 0.05, 1e-3, -5e-4, 0.01, 0.08, 0.02, 0.01},
        {0, 0, 0, 0, 0.05, -0.02, 0.01, -0.004}};
    memcpy(c.parameter, p[model], sizeof c.parameter);
    c.parameter[0] = focal;
    c.parameter[1] = focal * 1.002;
    c.parameter[2] = 322 + dx;
    c.parameter[3] = 236 - dx;
    return c;
}

static inline simulation simulate_stereo(td_camera_model model, size_t views)
{
    simulation s = {.rig = td_rig_new(), .views = views, .largest_tilt = 0.7, .near_m = 0.35, .far_m = 0.7};
    s.target = (td_target){.kind = TD_TARGET_CHESSBOARD, .plane_count = 1};
    s.target.plane[0] = (td_target_plane){9, 6, 0.025, td_pose_identity()};
    s.rig->count = 2;
    strcpy(s.rig->camera[0].name, "left");
    strcpy(s.rig->camera[1].name, "right");
    s.rig->camera[0].camera = simulated_camera(model, 530, 0);
    s.rig->camera[1].camera = simulated_camera(model, 540, 5);
    s.rig->camera[0].camera_from_rig = td_pose_identity();
    const double xi[6] = {0.005, -0.01, 0.003, -0.083, 0.001, 0.0005};
    s.rig->camera[1].camera_from_rig = td_pose_exp(xi);
    return s;
}

/* A pose of the board in front of the rig that both cameras see whole. */
static inline td_pose simulated_pose(const simulation *s, td_random *random)
{
    for (;;) {
        double w = s->target.plane[0].spacing_m * (s->target.plane[0].columns - 1) / 2;
        double h = s->target.plane[0].spacing_m * (s->target.plane[0].rows - 1) / 2;
        double about = 6.2831853 * td_random_uniform(random),
               tilt = s->largest_tilt * td_random_uniform(random);
        double turn = 0.6 * (td_random_uniform(random) - 0.5);
        const double lean[6] = {tilt * cos(about), tilt * sin(about), 0, 0, 0, 0},
                     spin[6] = {0, 0, turn, 0, 0, 0};
        const double centre[6] = {0, 0, 0, -w, -h, 0};
        double z = s->near_m + (s->far_m - s->near_m) * td_random_uniform(random);
        const double away[6] = {
            0, 0, 0, 0.5 * z * (td_random_uniform(random) - 0.5), 0.4 * z * (td_random_uniform(random) - 0.5),
            z};
        td_pose a = td_pose_exp(away), l = td_pose_exp(lean), t = td_pose_exp(spin), c = td_pose_exp(centre);
        td_pose p = td_pose_compose(&a, &l);
        p = td_pose_compose(&p, &t);
        p = td_pose_compose(&p, &c);
        bool whole = true;
        for (size_t i = 0; i < td_target_point_count(&s->target) && whole; i++)
            for (int k = 0; k < s->rig->count && whole; k++) {
                double x[3], u[2];
                td_target_point(x, &s->target, i);
                td_pose_transform(x, &p, x);
                td_pose_transform(x, &s->rig->camera[k].camera_from_rig, x);
                whole = td_camera_project(u, NULL, NULL, &s->rig->camera[k].camera, x) && u[0] > 0 &&
                        u[0] < 639 && u[1] > 0 && u[1] < 479;
            }
        if (whole) return p;
    }
}

/* How the board bends and stretches in one view. */
typedef struct simulated_shape {
    double sag, along[2], stretch[4];
} simulated_shape;

static inline simulated_shape simulated_board_shape(const simulation *s, td_random *random)
{
    simulated_shape b = {.sag = s->sag_m * td_random_normal(random)};
    double angle = 6.2831853 * td_random_uniform(random);
    b.along[0] = cos(angle), b.along[1] = sin(angle);
    double columns = s->target.plane[0].columns, rows = s->target.plane[0].rows;
    const double rms[2] = {sqrt((columns + 1) / (3 * (columns - 1))), sqrt((rows + 1) / (3 * (rows - 1)))};
    for (int i = 0; i < 4; i++)
        b.stretch[i] = s->stretch_m * sqrt(0.5) / rms[i % 2] * td_random_normal(random);
    return b;
}

/* Moves a point that lies at (a, b), -1 to 1 over the board. */
static inline void simulated_displace(double x[3], const simulated_shape *shape, double a, double b,
                                      const double *print)
{
    double u = shape->along[0] * a + shape->along[1] * b;
    for (int i = 0; i < 3; i++) x[i] += print[i];
    for (int i = 0; i < 2; i++) x[i] += shape->stretch[2 * i] * a + shape->stretch[2 * i + 1] * b;
    x[2] += shape->sag * (1 - u * u);
}

/* Views whose poses come from `scene_seed`, with Gaussian noise `noise_px` on each coordinate from
 * `noise_seed`. `sigma_px` is what the detections say of themselves. */
static inline td_observations *simulate(const simulation *s, uint64_t scene_seed, uint64_t noise_seed,
                                        double noise_px, double sigma_px)
{
    td_error error = {0};
    td_observations *o = NULL;
    td_random scene = td_random_seed(scene_seed, 11), noise = td_random_seed(noise_seed, 13);
    check_ok(td_observations_new(&o, &s->target, s->rig->count, s->views, &error), error);
    for (int k = 0; k < s->rig->count; k++) {
        const td_rig_camera *c = &s->rig->camera[k];
        memcpy(o->camera[k].name, c->name, sizeof o->camera[k].name);
        o->camera[k].model = c->camera.model;
        o->camera[k].width = c->camera.width;
        o->camera[k].height = c->camera.height;
    }
    enum { MOST_PRINTED = 1000 };
    static _Thread_local double print[3 * MOST_PRINTED];
    td_random board = td_random_seed(noise_seed, 17);
    assert_true(td_target_point_count(&s->target) <= MOST_PRINTED);
    for (size_t i = 0; i < 3 * td_target_point_count(&s->target); i++)
        print[i] = s->print_m * td_random_normal(&board);
    for (size_t v = 0; v < s->views; v++) {
        simulated_shape bend = simulated_board_shape(s, &board);
        snprintf(o->view_name[v], sizeof o->view_name[v], "%02zu", v);
        td_pose rig_from_target = simulated_pose(s, &scene);
        for (int k = 0; k < s->rig->count; k++) {
            td_detection *d = td_observations_get(o, v, k);
            d->found = true;
            for (size_t i = 0; i < d->count; i++) {
                double x[3], columns = s->target.plane[0].columns, rows = s->target.plane[0].rows;
                double a = 2 * (double)(i % (size_t)columns) / (columns - 1) - 1;
                double b = 2 * (double)(i / (size_t)columns) / (rows - 1) - 1;
                td_target_point(x, &s->target, i);
                x[2] += s->warp_m[0] * (1 - a * a) + s->warp_m[1] * (1 - b * b);
                simulated_displace(x, &bend, a, b, print + 3 * i);
                td_pose_transform(x, &rig_from_target, x);
                td_pose_transform(x, &s->rig->camera[k].camera_from_rig, x);
                assert_true(td_camera_project(d->point + 2 * i, NULL, NULL, &s->rig->camera[k].camera, x));
                d->point[2 * i] += noise_px * td_random_normal(&noise);
                d->point[2 * i + 1] += noise_px * td_random_normal(&noise);
                d->sigma[i] = sigma_px;
            }
        }
    }
    return o;
}

/* Bounds on sqrt(sum of n squared standard normals / n) that a true sigma leaves once in a thousand times
 * over `parameters` of them together (Bonferroni; Wilson and Hilferty's approximation of chi-square). */
static inline void sigma_bounds(double *low, double *high, size_t n, size_t parameters)
{
    /* Quantile of the standard normal by bisection on erfc. */
    double p = 0.001 / 2 / (double)parameters, a = 0, b = 10;
    for (int i = 0; i < 100; i++) {
        double m = (a + b) / 2;
        *(erfc(m / sqrt(2.0)) / 2 > p ? &a : &b) = m;
    }
    double c = 2 / (9.0 * (double)n);
    *low = sqrt(pow(1 - c - a * sqrt(c), 3));
    *high = sqrt(pow(1 - c + a * sqrt(c), 3));
}

/* Under AddressSanitizer solves take ten times as long: a few show what it is for. */
static inline bool sanitized_tests(void)
{
#ifdef __SANITIZE_ADDRESS__
    return true;
#else
    return false;
#endif
}

static inline bool full_tests(void)
{
    const char *full = getenv("TELEDIMOS_FULL");
    return full && *full && *full != '0';
}

#endif
