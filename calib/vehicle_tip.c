/* From the calibration's covariance to the bucket's tip, and to the arm pose that would help most. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/vehicle_internal.h"
#include "core/linalg.h"

#define DEGREES 57.29577951308232

enum { GRID_MOST = 4096, ADVICE_MOST = 700, ADVICE_COARSE = 60 };

/* ---- belief ---- */

static double null_part(const td_vehicle_belief *b, const td_vehicle_problem *vp,
                        const td_covariance *covariance, size_t index, size_t i)
{
    size_t n = (size_t)b->joints;
    if (i < 6) return td_covariance_null_direction(covariance, index, vp->mount, (int)i);
    if (i < 6 + n) return td_covariance_null_direction(covariance, index, vp->offset, (int)(i - 6));
    i -= 6 + n;
    if (i >= 3 * (size_t)b->points) {
        i -= 3 * (size_t)b->points;
        return td_covariance_null_direction(covariance, index, vp->board[i / 6], (int)(i % 6));
    }
    if (b->on_board[i / 3]) return 0;
    return td_covariance_null_direction(covariance, index, vp->place[i / 3], (int)(i % 3));
}

/* A null direction, of length 1 over the rig's pose and the zeros where it has a part there. */
static void add_null(td_vehicle_belief *b, const td_vehicle_problem *vp, const td_covariance *covariance,
                     size_t index)
{
    double *v = b->open + b->open_count++ * b->size, moving = 0, all = 0;
    for (size_t i = 0; i < b->size; i++) {
        v[i] = null_part(b, vp, covariance, index, i);
        all += v[i] * v[i];
        if (i < 6 + (size_t)b->joints) moving += v[i] * v[i];
    }
    double scale = moving > 1e-6 * all ? moving : all;
    for (size_t i = 0; i < b->size && scale > 0; i++) v[i] /= sqrt(scale);
}

/* Of what is left of the covariance once the open directions are taken out, the direction along which the
 * rig's pose is known worst: a mode of the whole, scaled to one of the rig's pose. */
static bool add_open(td_vehicle_belief *b, double *c)
{
    double block[36], value[6], vector[36], unit[6];
    size_t n = b->size;
    if (b->open_count == TD_VEHICLE_MAX_OPEN) return false;
    for (int i = 0; i < 6; i++) unit[i] = i < 3 ? TD_VEHICLE_REACH : 1;
    for (int i = 0; i < 36; i++)
        block[i] = c[(size_t)(i / 6) * n + (size_t)(i % 6)] * unit[i / 6] * unit[i % 6];
    if (td_eigen_symmetric(value, vector, block, 6, NULL) != TD_OK ||
        !(value[5] > TD_VEHICLE_OPEN * TD_VEHICLE_OPEN))
        return false;
    double *v = b->open + b->open_count++ * n;
    for (size_t i = 0; i < n; i++) {
        v[i] = 0;
        for (size_t k = 0; k < 6; k++) v[i] += c[i * n + k] * unit[k] * vector[30 + k] / value[5];
    }
    for (size_t i = 0; i < n * n; i++) c[i] -= value[5] * v[i / n] * v[i % n];
    return true;
}

static td_status find_open(td_vehicle_belief *b, const td_vehicle_problem *vp,
                           const td_covariance *covariance, td_error *error)
{
    size_t n = b->size, nulls = td_covariance_null_count(covariance);
    double *c = malloc(n * n * sizeof *c);
    if (!c) return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu numbers", n);
    memcpy(c, b->covariance, n * n * sizeof *c);
    for (size_t k = 0; k < nulls && k < TD_VEHICLE_MAX_OPEN; k++) add_null(b, vp, covariance, k);
    for (size_t k = 0; k < b->open_count; k++)
        for (size_t i = 0; i < n * n; i++)
            b->covariance[i] += b->open[k * n + i / n] * b->open[k * n + i % n];
    while (add_open(b, c)) continue;
    free(c);
    return TD_OK;
}

/* Part x of the belief: its block, where it begins, its length (0: nothing is sought there). */
typedef struct part {
    int block, at, width;
} part;

static part part_of(const td_vehicle_belief *b, const td_vehicle_problem *vp, int x)
{
    int places = 6 + b->joints, boards = places + 3 * b->points;
    if (x == 0) return (part){vp->mount, 0, 6};
    if (x == 1) return (part){vp->offset, 6, b->joints};
    x -= 2;
    if (x < b->points) return (part){vp->place[x], places + 3 * x, b->on_board[x] ? 0 : 3};
    x -= b->points;
    return (part){vp->board[x], boards + 6 * x, 6};
}

td_status td_vehicle_belief_new(td_vehicle_belief **belief, const td_vehicle_model *model,
                                const td_vehicle_problem *vp, const td_covariance *covariance, int tip,
                                td_error *error)
{
    int n = model->joints, points = model->data->point_count, boards = model->data->board_count,
        blocks = 2 + points + boards;
    size_t size = 6 + (size_t)n + 3 * (size_t)points + 6 * (size_t)boards;
    td_vehicle_belief *b = *belief = calloc(1, sizeof *b);
    if (b) b->covariance = calloc(size * size, sizeof *b->covariance);
    if (b) b->open = calloc(TD_VEHICLE_MAX_OPEN * size, sizeof *b->open);
    double *work = calloc(size + (size_t)TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE, sizeof *work);
    if (!b || !b->covariance || !b->open || !work) {
        free(work);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a covariance of %zu numbers", size);
    }
    b->joints = n;
    b->points = points;
    b->boards = boards;
    for (int p = 0; p < points; p++) b->on_board[p] = model->data->point[p].board > 0;
    b->tip = tip;
    b->size = size;
    memcpy(b->joint, model->joint, sizeof b->joint);
    td_status status = TD_OK;
    for (int i = 0; i < blocks && status == TD_OK; i++)
        for (int k = 0; k < blocks && status == TD_OK; k++) {
            part a = part_of(b, vp, i), c = part_of(b, vp, k);
            if (!a.width || !c.width) continue;
            status = td_covariance_get(work, covariance, a.block, c.block, error);
            for (int r = 0; r < a.width && status == TD_OK; r++)
                memcpy(b->covariance + (size_t)(a.at + r) * size + c.at, work + r * c.width,
                       (size_t)c.width * sizeof *work);
        }
    if (status == TD_OK) status = find_open(b, vp, covariance, error);
    free(work);
    return status;
}

void td_vehicle_belief_free(td_vehicle_belief **belief)
{
    if (*belief) free((*belief)->covariance);
    if (*belief) free((*belief)->open);
    free(*belief);
    *belief = NULL;
}

/* ---- the tip ---- */

/* How the tip, as seen less as by the kinematics, follows from the belief: gradient (3, 6 + joints) in the
 * mount's frame; `other` (3,3): what joints outside the chain and one reading of all add. */
static td_status tip_gradient(double *gradient, double other[9], const td_vehicle *result,
                              const td_vehicle_data *data, int tip, const double *reading, td_error *error)
{
    const td_vehicle_belief *b = result->belief;
    int joint[TD_VEHICLE_MAX_CHAIN], n = 0, width = 6 + b->joints;
    double q[TD_ROBOT_MAX_JOINTS], move[18], screw[6 * TD_VEHICLE_MAX_CHAIN];
    TD_TRY(td_vehicle_add_chain(joint, &n, data->robot, data->mount, tip, error));
    for (int j = 0; j < data->robot->joint_count; j++) q[j] = reading[j] + result->offset[j];
    td_pose mount_from_tip = td_vehicle_arm(screw, data->robot, data->mount, tip, q, joint, n);
    td_pose_transform_jacobian(move, mount_from_tip.t);
    memset(gradient, 0, 3 * (size_t)width * sizeof *gradient);
    memset(other, 0, 9 * sizeof *other);
    for (int i = 0; i < 3; i++) memcpy(gradient + i * width, move + 6 * i, 6 * sizeof *gradient);
    for (int k = 0; k < n; k++) {
        double by_joint[3] = {0}, variance = data->sigma_q[joint[k]] * data->sigma_q[joint[k]];
        int at = 0;
        for (int i = 0; i < 3; i++)
            for (int m = 0; m < 6; m++) by_joint[i] += move[6 * i + m] * screw[m * n + k];
        while (at < b->joints && b->joint[at] != joint[k]) at++;
        if (at < b->joints) {
            for (int i = 0; i < 3; i++) gradient[i * width + 6 + at] = -by_joint[i];
        } else {
            double prior = data->offset_prior[joint[k]];
            if (!isfinite(prior))
                return td_fail(error, TD_ERROR_DATA,
                               "zero of joint %s is free and no point is seen beyond it: give it a prior, or "
                               "hold it",
                               data->robot->joint[joint[k]].name);
            variance += prior * prior;
        }
        for (int i = 0; i < 9; i++) other[i] += variance * by_joint[i / 3] * by_joint[i % 3];
    }
    return TD_OK;
}

td_status td_vehicle_tip_sigma(double covariance[9], const td_vehicle *result, const td_vehicle_data *data,
                               int tip, const double *q, td_error *error)
{
    const td_vehicle_belief *b = result->belief;
    double gradient[3 * (6 + TD_VEHICLE_MAX_CHAIN)], other[9], in_mount[9], r[9];
    if (!b) return td_fail(error, TD_ERROR_ARGUMENT, "tip: there is no covariance, only the closed solution");
    if (result->null_count)
        return td_fail(error, TD_ERROR_DATA, "tip: the transform is not determined: %s",
                       result->null_direction[0]);
    if (tip == -1) tip = b->tip;
    if (tip < 0 || tip >= data->robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "tip %d: the robot %s has links 0 to %d", tip,
                       data->robot->name, data->robot->link_count - 1);
    TD_TRY(tip_gradient(gradient, other, result, data, tip, q, error));
    int width = 6 + b->joints;
    for (int i = 0; i < 9; i++) {
        double sum = other[i];
        for (int a = 0; a < width; a++)
            for (int c = 0; c < width; c++)
                sum += gradient[i / 3 * width + a] * b->covariance[(size_t)a * b->size + (size_t)c] *
                       gradient[i % 3 * width + c];
        in_mount[i] = sum;
    }
    double at[TD_ROBOT_MAX_JOINTS];
    for (int j = 0; j < data->robot->joint_count; j++) at[j] = q[j] + result->offset[j];
    td_pose vehicle_from_mount = td_vehicle_arm(NULL, data->robot, data->vehicle, data->mount, at, NULL, 0);
    td_pose_rotation(r, &vehicle_from_mount);
    return td_sandwich(covariance, r, in_mount, 3, 3, error);
}

/* ---- grids over the joints' limits ---- */

typedef struct grid {
    const td_robot *robot;
    int n, joint[TD_VEHICLE_MAX_CHAIN], level[TD_VEHICLE_MAX_CHAIN];
    size_t total;
} grid;

static void limits_of(double *low, double *high, const td_robot_joint *joint)
{
    double reach = joint->kind == TD_JOINT_PRISMATIC ? 1 : 3.141592653589793;
    bool round = joint->kind == TD_JOINT_CONTINUOUS;
    *low = !round && isfinite(joint->lower) ? joint->lower : -reach;
    *high = !round && isfinite(joint->upper) ? joint->upper : reach;
}

static td_status grid_new(grid *g, const td_vehicle_data *data, int from, int to, int most_levels,
                          size_t most, td_error *error)
{
    *g = (grid){.robot = data->robot, .total = 1};
    TD_TRY(td_vehicle_add_chain(g->joint, &g->n, data->robot, from, to, error));
    for (int levels = most_levels; levels > 1; levels--) {
        size_t total = 1;
        for (int k = 0; k < g->n && total <= most; k++) total *= (size_t)levels;
        if (total > most && levels > 2) continue;
        /* Where even two levels are too many the joints beyond stay in the middle. */
        for (int k = 0; k < g->n; k++) {
            g->level[k] = g->total * (size_t)levels <= most ? levels : 1;
            g->total *= (size_t)g->level[k];
        }
        break;
    }
    return TD_OK;
}

static void grid_q(double *q, const grid *g, size_t index)
{
    for (int j = 0; j < g->robot->joint_count; j++) {
        double low, high;
        limits_of(&low, &high, &g->robot->joint[j]);
        q[j] = fmin(fmax(0, low), high);
    }
    for (int k = 0; k < g->n; k++) {
        double low, high;
        size_t level = (size_t)g->level[k], at = index % level;
        limits_of(&low, &high, &g->robot->joint[g->joint[k]]);
        q[g->joint[k]] = level > 1 ? low + (high - low) * (double)at / (double)(level - 1) : (low + high) / 2;
        index /= level;
    }
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

td_status td_vehicle_tip_grid(td_vehicle *result, const td_vehicle_data *data, td_error *error)
{
    grid g;
    TD_TRY(grid_new(&g, data, data->mount, result->belief->tip, 7, GRID_MOST, error));
    double *sigma = malloc(g.total * sizeof *sigma);
    if (!sigma) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", g.total);
    td_status status = TD_OK;
    for (size_t i = 0; i < g.total && status == TD_OK; i++) {
        double q[TD_ROBOT_MAX_JOINTS], covariance[9], value[3];
        grid_q(q, &g, i);
        status = td_vehicle_tip_sigma(covariance, result, data, -1, q, error);
        if (status == TD_OK) status = td_eigen_symmetric(value, NULL, covariance, 3, error);
        if (status == TD_OK) sigma[i] = 1e3 * sqrt(fmax(value[2], 0));
    }
    if (status == TD_OK) {
        qsort(sigma, g.total, sizeof *sigma, by_size);
        result->sigma_tip_worst_mm = sigma[g.total - 1];
        result->sigma_tip_median_mm = sigma[g.total / 2];
    }
    free(sigma);
    return status;
}

/* ---- advice ---- */

/* Mean over a coarse grid of gradient^T gradient (width, width), and what one reading adds. */
static td_status tip_weight(double *weight, double *constant, const td_vehicle *result,
                            const td_vehicle_data *data, td_error *error)
{
    int width = 6 + result->belief->joints;
    double gradient[3 * (6 + TD_VEHICLE_MAX_CHAIN)], other[9], q[TD_ROBOT_MAX_JOINTS];
    grid g;
    TD_TRY(grid_new(&g, data, data->mount, result->belief->tip, 3, ADVICE_COARSE, error));
    memset(weight, 0, (size_t)(width * width) * sizeof *weight);
    *constant = 0;
    for (size_t i = 0; i < g.total; i++) {
        grid_q(q, &g, i);
        TD_TRY(tip_gradient(gradient, other, result, data, result->belief->tip, q, error));
        for (int k = 0; k < width * width; k++)
            for (int r = 0; r < 3; r++)
                weight[k] +=
                    gradient[r * width + k / width] * gradient[r * width + k % width] / (double)g.total;
        *constant += (other[0] + other[4] + other[8]) / (double)g.total;
    }
    return TD_OK;
}

static double tip_variance(const double *covariance, size_t size, const double *weight, int width)
{
    double sum = 0;
    for (int i = 0; i < width; i++)
        for (int k = 0; k < width; k++)
            sum += weight[i * width + k] * covariance[(size_t)i * size + (size_t)k];
    return sum;
}

/* c (n,n) after one measurement of unit variance along h (n). */
static void update(double *c, const double *h, size_t n, double *ch)
{
    double s = 1;
    for (size_t i = 0; i < n; i++) {
        ch[i] = 0;
        for (size_t k = 0; k < n; k++) ch[i] += c[i * n + k] * h[k];
        s += h[i] * ch[i];
    }
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) c[i * n + k] -= ch[i] * ch[k] / s;
}

/* The belief, and the noise of the pose's joints after it, after the sights of all points in the model's only
 * pose; false when nothing is seen. */
static bool see(double *c, size_t n, td_vehicle_model *model, double sigma_px, double *work)
{
    const td_vehicle_data *data = model->data;
    bool any = false;
    size_t joints = (size_t)model->joints, noise = n - joints;
    for (int camera = 0; camera < data->rig->count; camera++)
        for (int p = 0; p < data->point_count; p++) {
            td_vehicle_sight sight = {.camera = camera, .point = p, .sigma_px = sigma_px};
            double by_mount[12], by_joint[2 * TD_VEHICLE_MAX_CHAIN], by_place[12], pixel[2];
            size_t board = (size_t)data->point[p].board, width = board ? 6 : 3,
                   at =
                       6 + joints + (board ? 3 * (size_t)data->point_count + 6 * (board - 1) : 3 * (size_t)p);
            const td_camera *c0 = &data->rig->camera[camera].camera;
            if (!model->seen[p] || !td_vehicle_residual(pixel, model, &sight)) continue;
            if (pixel[0] < 0 || pixel[1] < 0 || pixel[0] > c0->width - 1 || pixel[1] > c0->height - 1)
                continue;
            if (!td_vehicle_linearise(by_mount, by_joint, by_place, model, &sight)) continue;
            any = true;
            for (int row = 0; row < 2; row++) {
                double *h = work;
                memset(h, 0, n * sizeof *h);
                memcpy(h, by_mount + 6 * row, 6 * sizeof *h);
                memcpy(h + 6, by_joint + (size_t)row * joints, joints * sizeof *h);
                memcpy(h + noise, by_joint + (size_t)row * joints, joints * sizeof *h);
                memcpy(h + at, by_place + width * (size_t)row, width * sizeof *h);
                update(c, h, n, work + n);
            }
        }
    return any;
}

static double mean_sigma_px(const td_vehicle_data *data)
{
    double sum = 0;
    for (size_t s = 0; s < data->sight_count; s++) sum += data->sight[s].sigma_px;
    return sum / (double)data->sight_count;
}

typedef struct advice {
    double *c, *work, weight[(6 + TD_VEHICLE_MAX_CHAIN) * (6 + TD_VEHICLE_MAX_CHAIN)];
    double constant, before, best;
} advice;

/* Tries every pose of the grid in one->q, which the model reads; the best in q. */
static void search(double *q, advice *a, const td_vehicle *result, td_vehicle_model *model,
                   const td_vehicle_data *one)
{
    const td_vehicle_belief *b = result->belief;
    size_t joints = (size_t)b->joints, n = b->size + joints;
    double sigma_px = mean_sigma_px(one);
    grid g = {.robot = one->robot, .n = b->joints};
    memcpy(g.joint, b->joint, sizeof g.joint);
    for (int levels = 7; levels >= 1; levels--) {
        g.total = 1;
        for (int k = 0; k < g.n && g.total <= ADVICE_MOST; k++) g.total *= (size_t)(g.level[k] = levels);
        if (g.total <= ADVICE_MOST) break;
    }
    for (size_t i = 0; i < g.total; i++) {
        grid_q(one->q, &g, i);
        memset(a->c, 0, n * n * sizeof *a->c);
        for (size_t r = 0; r < b->size; r++)
            memcpy(a->c + r * n, b->covariance + r * b->size, b->size * sizeof *a->c);
        for (size_t k = 0; k < joints; k++)
            a->c[(b->size + k) * (n + 1)] = one->sigma_q[b->joint[k]] * one->sigma_q[b->joint[k]];
        if (!see(a->c, n, model, sigma_px, a->work)) continue;
        double variance = tip_variance(a->c, n, a->weight, 6 + b->joints);
        if (variance < a->best) {
            a->best = variance;
            memcpy(q, one->q, (size_t)one->robot->joint_count * sizeof *q);
        }
    }
}

static void advice_text(char text[320], const double *q, const advice *a, const td_vehicle_belief *b,
                        const td_robot *robot)
{
    size_t used = 0;
    text[0] = '\0';
    for (int k = 0; k < b->joints && used < 200; k++) {
        const td_robot_joint *joint = &robot->joint[b->joint[k]];
        bool shift = joint->kind == TD_JOINT_PRISMATIC;
        used += (size_t)snprintf(text + used, 320 - used, "%s%.40s %.*f %s", used ? ", " : "", joint->name,
                                 shift ? 2 : 0, q[b->joint[k]] * (shift ? 1 : DEGREES), shift ? "m" : "deg");
    }
    snprintf(text + used, 320 - used, ": the tip's sigma over the working space from %.2f to %.2f mm",
             1e3 * sqrt(a->before + a->constant), 1e3 * sqrt(a->best + a->constant));
}

td_status td_vehicle_advise(double *q, char text[320], const td_vehicle *result, const td_vehicle_data *data,
                            td_error *error)
{
    const td_vehicle_belief *b = result->belief;
    if (!b)
        return td_fail(error, TD_ERROR_ARGUMENT, "advice: there is no covariance, only the closed solution");
    td_vehicle_model model;
    td_vehicle_data one = *data;
    double candidate[TD_ROBOT_MAX_JOINTS];
    size_t n = b->size + (size_t)b->joints;
    advice a = {.c = calloc(n * n, sizeof *a.c), .work = calloc(2 * n, sizeof *a.work)};
    td_status status = td_vehicle_model_new(&model, data, error);
    if (status == TD_OK && (!a.c || !a.work))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for advice");
    if (status == TD_OK) status = tip_weight(a.weight, &a.constant, result, data, error);
    if (status == TD_OK) {
        memset(model.noise, 0, (size_t)model.joints * sizeof *model.noise);
        model.mount_from_rig = result->mount_from_rig;
        for (int p = 0; p < data->point_count; p++)
            if (!data->point[p].board) memcpy(model.place[p], result->place[p], sizeof *model.place);
        for (int i = 0; i < data->board_count; i++) model.board[i] = result->link_from_board[i];
        for (int k = 0; k < model.joints; k++) model.offset[k] = result->offset[model.joint[k]];
        model.data = &one;
        a.before = a.best = tip_variance(b->covariance, b->size, a.weight, 6 + b->joints);
        grid_q(q, &(grid){.robot = data->robot}, 0);
        one.q = candidate;
        search(q, &a, result, &model, &one);
    }
    if (status == TD_OK && a.best < a.before) {
        advice_text(text, q, &a, b, data->robot);
    } else if (status == TD_OK) {
        snprintf(text, 320, "no pose within the joints' limits shows the points to the cameras");
    }
    td_vehicle_model_free(&model);
    free(a.c);
    free(a.work);
    return status;
}
