/* Motions of an arm over rough ground with errors of every kind, their probability of contact as told, and
 * whether they touch a truth that is drawn from those errors; for the test and for the diagram. */
#ifndef TELEDIMOS_TESTS_SIM_CLEARANCE_TRIALS_H
#define TELEDIMOS_TESTS_SIM_CLEARANCE_TRIALS_H

#include "core/parallel.h"
#include "core/pose.h"
#include "tests/sim/clearance_scene.h"

static td_error error;
enum { COLUMNS = 113, ROWS = 121, READINGS = 7, BINS = 10 };
static const double cell = 0.05, correlation = 0.1, duration = 3;

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

/* ---- the errors ---- */

typedef struct errors {
    double vehicle[36], map[36], zero[ARM_JOINTS], reading[ARM_JOINTS];
} errors;

/* Small turns and shifts about a point of the site, correlated: A A' by random A. */
static void make_covariance(double covariance[36], td_random *random, double angle, double shift)
{
    double a[36];
    for (int i = 0; i < 36; i++) a[i] = td_random_normal(random) / sqrt(6) * (i < 18 ? angle : shift);
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            covariance[6 * i + j] = 0;
            for (int k = 0; k < 6; k++) covariance[6 * i + j] += a[6 * i + k] * a[6 * j + k];
        }
}

/* By Cholesky. */
static void draw_pose_error(double xi[6], const double covariance[36], td_random *random)
{
    double l[36] = {0}, y[6];
    for (int i = 0; i < 6; i++) {
        y[i] = td_random_normal(random);
        xi[i] = 0;
        for (int j = 0; j <= i; j++) {
            double sum = covariance[6 * i + j];
            for (int k = 0; k < j; k++) sum -= l[6 * i + k] * l[6 * j + k];
            l[6 * i + j] = i == j ? sqrt(fmax(sum, 0)) : l[7 * j] > 0 ? sum / l[7 * j] : 0;
            xi[i] += l[6 * i + j] * y[j];
        }
    }
}

/* Noise of sigma 1 with correlation exp(-r^2 / length^2): white noise through exp(-2 r^2 / length^2). */
static void draw_field(double *field, td_random *random)
{
    enum { REACH = 6, WIDE = COLUMNS + 2 * REACH, HIGH = ROWS + 2 * REACH };
    static _Thread_local double white[HIGH * WIDE], half[HIGH * COLUMNS];
    double kernel[2 * REACH + 1], square = 0;
    for (int k = -REACH; k <= REACH; k++) {
        kernel[k + REACH] = exp(-2 * k * k * cell * cell / (correlation * correlation));
        square += kernel[k + REACH] * kernel[k + REACH];
    }
    for (int k = 0; k <= 2 * REACH; k++) kernel[k] /= sqrt(square);
    for (int i = 0; i < HIGH * WIDE; i++) white[i] = td_random_normal(random);
    for (int r = 0; r < HIGH; r++)
        for (int c = 0; c < COLUMNS; c++) {
            half[r * COLUMNS + c] = 0;
            for (int k = 0; k <= 2 * REACH; k++) half[r * COLUMNS + c] += kernel[k] * white[r * WIDE + c + k];
        }
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLUMNS; c++) {
            field[r * COLUMNS + c] = 0;
            for (int k = 0; k <= 2 * REACH; k++)
                field[r * COLUMNS + c] += kernel[k] * half[(r + k) * COLUMNS + c];
        }
}

/* ---- the truth ---- */

/* Points of a box's edges below the surface. */
static bool edges_touch(const td_elevation *ground, const td_primitive *box, const td_pose *site_from_box)
{
    enum { POINTS = 40 };
    for (int edge = 0; edge < 12; edge++)
        for (int k = 0; k <= POINTS; k++) {
            const int along = edge / 4, u = (along + 1) % 3, v = (along + 2) % 3;
            double x[3], p[3];
            x[u] = edge & 1 ? 0.5 * box->size[u] : -0.5 * box->size[u];
            x[v] = edge & 2 ? 0.5 * box->size[v] : -0.5 * box->size[v];
            x[along] = ((double)k / POINTS - 0.5) * box->size[along];
            td_pose_transform(p, site_from_box, x);
            if (p[2] < td_elevation_at(ground, p[0], p[1], NULL)) return true;
        }
    return false;
}

static bool touches(const td_robot *robot, const td_elevation *ground, const td_pose *site_from_vehicle,
                    const double *q, double top)
{
    td_pose link[TD_ROBOT_MAX_LINKS];
    td_robot_forward(link, robot, q);
    for (int k = 0; k < robot->link_count; k++)
        for (int s = 0; s < robot->link[k].shape_count; s++) {
            const td_primitive *shape = robot->link[k].shape + s;
            const td_pose site_from_link = td_pose_compose(site_from_vehicle, link + k);
            const td_pose pose = td_pose_compose(&site_from_link, &shape->link_from_shape);
            double r[9], low = shape->size[0];
            td_pose_rotation(r, &pose);
            if (shape->kind == TD_PRIMITIVE_CAPSULE) low += 0.5 * shape->size[1] * fabs(r[8]);
            if (shape->kind == TD_PRIMITIVE_BOX)
                low = 0.5 * (shape->size[0] * fabs(r[6]) + shape->size[1] * fabs(r[7]) +
                             shape->size[2] * fabs(r[8]));
            if (pose.t[2] - low > top) continue;
            if (truth_to_ground(ground, shape, &pose, 3, 1e-9, 0) < 0) return true;
            if (shape->kind == TD_PRIMITIVE_BOX && edges_touch(ground, shape, &pose)) return true;
        }
    return false;
}

static bool truly_touches(const td_clearance_motion *m, const td_elevation *ground, const errors *e,
                          int steps, td_random *random)
{
    double field[COLUMNS * ROWS], *q = malloc(m->count * ARM_JOINTS * sizeof *q), xi[6], top = -10;
    bool touched = false;
    td_elevation truth = *ground;
    truth.height = malloc(sizeof(float) * COLUMNS * ROWS);
    assert_true(q && truth.height);
    draw_field(field, random);
    for (int i = 0; i < COLUMNS * ROWS; i++) {
        truth.height[i] = (float)(ground->height[i] + ground->sigma[i] * field[i]);
        top = fmax(top, truth.height[i]);
    }
    /* The vehicle as the map, which is off as a whole, would have it. */
    draw_pose_error(xi, e->vehicle, random);
    td_pose vehicle = td_pose_perturb(&m->site_from_vehicle, xi);
    draw_pose_error(xi, e->map, random);
    td_pose map_error = td_pose_exp(xi);
    map_error = td_pose_inverse(&map_error);
    vehicle = td_pose_compose(&map_error, &vehicle);
    for (int j = 0; j < ARM_JOINTS; j++) {
        const double zero = e->zero[j] * td_random_normal(random);
        for (size_t i = 0; i < m->count; i++)
            q[i * ARM_JOINTS + j] =
                m->q[i * ARM_JOINTS + j] + zero + e->reading[j] * td_random_normal(random);
    }
    for (size_t i = 0; i + 1 < m->count && !touched; i++)
        for (int k = 0; k <= steps && !touched; k++) {
            double at[ARM_JOINTS];
            for (int j = 0; j < ARM_JOINTS; j++)
                at[j] =
                    q[i * ARM_JOINTS + j] + (q[(i + 1) * ARM_JOINTS + j] - q[i * ARM_JOINTS + j]) * k / steps;
            touched = touches(m->robot, &truth, &vehicle, at, top);
        }
    free(q);
    free(truth.height);
    return touched;
}

/* ---- trials ---- */

typedef struct trial {
    double predicted, sigma, left_out;
    size_t samples, points;
    bool touched, failed;
} trial;
typedef struct trials {
    td_robot *robot;
    trial *one;
} trials;

static void run_trial(size_t index, void *user)
{
    trials *all = user;
    trial *t = all->one + index;
    td_random random = td_random_seed(11, index);
    td_elevation *ground = NULL;
    td_clearance_map *map = NULL;
    errors e;
    double time[READINGS], q[READINGS * ARM_JOINTS], from[ARM_JOINTS], to[ARM_JOINTS];
    const double origin[2] = {-0.7, -3}, low[ARM_JOINTS] = {-0.6, -0.6, 0.2, -0.6},
                 high[ARM_JOINTS] = {0.6, 0.1, 1.4, 1.4};
    t->failed = true;
    if (td_elevation_new(&ground, COLUMNS, ROWS, cell, origin, "site", NULL) != TD_OK) return;
    roughen(ground, index);
    const double noise = between(&random, 0.005, 0.03), common = between(&random, 0.002, 0.03);
    for (int i = 0; i < COLUMNS * ROWS; i++) ground->sigma[i] = (float)(noise * between(&random, 0.7, 1.3));
    make_covariance(e.vehicle, &random, 0.3 * common, common);
    make_covariance(e.map, &random, 0.3 * common, common);
    for (int j = 0; j < ARM_JOINTS; j++) {
        e.zero[j] = between(&random, 0, 0.008);
        e.reading[j] = index % 2 ? between(&random, 0, 0.003) : 0;
        from[j] = between(&random, low[j], high[j]);
        to[j] = from[j] + between(&random, -0.35, 0.35);
    }
    for (int i = 0; i < READINGS; i++) {
        time[i] = duration * i / (READINGS - 1);
        for (int j = 0; j < ARM_JOINTS; j++)
            q[i * ARM_JOINTS + j] = from[j] + (to[j] - from[j]) * i / (READINGS - 1);
    }
    td_clearance_motion motion = {.robot = all->robot,
                                  .site_from_vehicle = {{1, 0, 0, 0}, {0, 0, 1.5}},
                                  .count = READINGS,
                                  .time_s = time,
                                  .q = q};
    td_clearance_options options = td_clearance_options_default();
    options.correlation_m = correlation;
    td_clearance found;
    if (td_clearance_map_new(&map, ground, NAN, NULL) == TD_OK &&
        td_clearance_check(&found, map, &motion, &options, NULL) == TD_OK) {
        const double spread = noise + common;
        motion.vehicle_covariance = e.vehicle;
        motion.map_covariance = e.map;
        motion.sigma_zero = e.zero;
        motion.sigma_reading = index % 2 ? e.reading : NULL;
        motion.site_from_vehicle.t[2] += between(&random, -2.5, 3) * spread - found.nearest.clearance_m;
        t->failed = td_clearance_check(&found, map, &motion, &options, NULL) != TD_OK;
        t->predicted = found.probability;
        t->sigma = found.sigma_probability;
        t->left_out = found.left_out;
        t->samples = found.samples;
        t->points = found.points;
        const int steps = (int)(2 * found.samples / (READINGS - 1)) + 1;
        t->touched = truly_touches(&motion, ground, &e, steps, &random);
    }
    td_clearance_map_free(&map);
    td_elevation_free(&ground);
}

/* P(at least k of n) at probability p. */
static double at_least(int k, int n, double p)
{
    double sum = 0;
    for (int i = k; i <= n; i++)
        sum += exp(lgamma(n + 1) - lgamma(i + 1) - lgamma(n - i + 1) + i * log(p) + (n - i) * log1p(-p));
    return fmin(sum, 1);
}

/* Clopper and Pearson: each side's tail is alpha / 2. */
static void clopper_pearson(double interval[2], int k, int n, double alpha)
{
    for (int side = 0; side < 2; side++) {
        double low = 0, high = 1;
        for (int i = 0; i < 50; i++) {
            const double p = 0.5 * (low + high);
            const bool up = side ? 1 - at_least(k + 1, n, p) > 0.5 * alpha : at_least(k, n, p) < 0.5 * alpha;
            *(up ? &low : &high) = p;
        }
        interval[side] = side ? (k == n ? 1 : high) : k == 0 ? 0 : low;
    }
}

/* By tenths of the predicted probability. */
typedef struct reliability {
    int count, n[BINS], hits[BINS];
    double mean[BINS], interval[BINS][2]; /* Clopper and Pearson's, 99.9 % for all tenths together */
    double sigma, left_out, points;       /* of the integral at most, at most, on the mean */
    double difference, variance;          /* of the contacts from those predicted, and of chance */
} reliability;

static reliability measure_reliability(int count)
{
    trials all = {make_robot(arm_urdf), calloc((size_t)count, sizeof(trial))};
    reliability r = {.count = count};
    assert_non_null(all.one);
    check_ok(td_parallel_for((size_t)count, 0, run_trial, &all, NULL, NULL), error);
    for (int i = 0; i < count; i++) {
        const trial *t = all.one + i;
        const int bin = t->predicted < 1 ? (int)(BINS * t->predicted) : BINS - 1;
        assert_false(t->failed);
        r.n[bin]++;
        r.hits[bin] += t->touched;
        r.mean[bin] += t->predicted;
        r.sigma = fmax(r.sigma, t->sigma);
        r.left_out = fmax(r.left_out, t->left_out);
        r.points += (double)t->points / count;
        r.difference += t->touched - t->predicted;
        r.variance += t->predicted * (1 - t->predicted);
    }
    for (int b = 0; b < BINS; b++) {
        r.mean[b] /= r.n[b];
        if (r.n[b]) clopper_pearson(r.interval[b], r.hits[b], r.n[b], 0.001 / BINS);
    }
    free(all.one);
    td_robot_free(&all.robot);
    return r;
}

#endif
