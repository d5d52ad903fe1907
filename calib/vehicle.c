/* Camera to vehicle: start, robust solve, sights left out, covariance. */
#include "calib/vehicle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/vehicle_internal.h"
#include "core/linalg.h"

#define DEGREES 57.29577951308232

enum { MOST_ROUNDS = 6 };

td_vehicle_options td_vehicle_options_default(void)
{
    return (td_vehicle_options){.tip = -1, .outlier_sigma = 5};
}

void td_vehicle_free(td_vehicle **result)
{
    if (!*result) return;
    free((*result)->offset);
    free((*result)->sigma_offset);
    free((*result)->place);
    free((*result)->sigma_place);
    free((*result)->link_from_board);
    free((*result)->sigma_board);
    free((*result)->left_out);
    free((*result)->residual);
    free((*result)->noise);
    td_vehicle_belief_free(&(*result)->belief);
    free(*result);
    *result = NULL;
}

static td_status result_new(td_vehicle **result, const td_vehicle_data *data, td_error *error)
{
    size_t joints = (size_t)data->robot->joint_count + 1, points = (size_t)data->point_count;
    td_vehicle *v = *result = calloc(1, sizeof *v);
    if (!v) return td_fail(error, TD_ERROR_MEMORY, "no memory for a result");
    v->offset = calloc(joints, sizeof *v->offset);
    v->sigma_offset = calloc(joints, sizeof *v->sigma_offset);
    v->place = calloc(points, sizeof *v->place);
    v->sigma_place = calloc(points, sizeof *v->sigma_place);
    v->left_out = calloc(data->sight_count, sizeof *v->left_out);
    v->residual = calloc(data->sight_count, sizeof *v->residual);
    v->noise = calloc(data->pose_count * joints, sizeof *v->noise);
    v->link_from_board = calloc((size_t)data->board_count + 1, sizeof *v->link_from_board);
    v->sigma_board = calloc((size_t)data->board_count + 1, sizeof *v->sigma_board);
    if (!v->link_from_board || !v->sigma_board || !v->offset || !v->sigma_offset || !v->place ||
        !v->sigma_place || !v->left_out || !v->residual || !v->noise)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a result");
    for (size_t s = 0; s < data->sight_count; s++) v->residual[s][0] = v->residual[s][1] = NAN;
    v->rms_px = v->chi2_per_dof = v->sigma_mm = v->sigma_deg = NAN;
    v->sigma_tip_worst_mm = v->sigma_tip_median_mm = NAN;
    return TD_OK;
}

/* The vehicle's frame from the mount's with the joints between the two at zero. */
static td_pose vehicle_from_mount(const td_vehicle_data *data)
{
    const double zero[TD_ROBOT_MAX_JOINTS] = {0};
    return td_vehicle_arm(NULL, data->robot, data->vehicle, data->mount, zero, NULL, 0);
}

/* ---- outliers ---- */

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sights whose residual is longer than `limit` sigmas, where sigma is not below the residuals' own median
 * (sqrt(2 ln 2) = 1.1774 sigma for two normal components). *changed: whether the choice did. */
static td_status choose_sights(td_vehicle_model *model, double limit, bool *changed, td_error *error)
{
    const td_vehicle_data *data = model->data;
    double *length = malloc(2 * data->sight_count * sizeof *length), *sorted = length + data->sight_count;
    if (!length) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu sights", data->sight_count);
    *changed = false;
    for (size_t s = 0; s < data->sight_count; s++) {
        double r[2];
        bool seen = td_vehicle_residual(r, model, &data->sight[s]);
        sorted[s] = length[s] = seen ? hypot(r[0], r[1]) / data->sight[s].sigma_px : INFINITY;
    }
    qsort(sorted, data->sight_count, sizeof *sorted, by_size);
    double scale = fmax(1, sorted[data->sight_count / 2] / 1.1774100225154747);
    for (size_t s = 0; s < data->sight_count; s++) {
        bool use = length[s] <= limit * scale;
        *changed = *changed || use != model->used[s];
        model->used[s] = use;
    }
    free(length);
    return TD_OK;
}

static td_status solve_once(td_vehicle_model *model, const td_loss *loss, const td_vehicle_options *options,
                            td_solve_summary *summary, td_error *error)
{
    td_vehicle_problem vp;
    td_solve_options solve = td_solve_options_default();
    solve.progress = options->progress;
    solve.log = options->log;
    TD_TRY(td_vehicle_problem_new(&vp, model, loss, error));
    td_status status = td_problem_solve(vp.problem, summary, &solve, error);
    td_vehicle_problem_free(&vp);
    return status;
}

/* A robust solve, then plain ones, with the sights that lie outside left out, until the choice stands. */
static td_status solve(td_vehicle_model *model, const td_vehicle_options *options, bool *converged,
                       td_error *error)
{
    td_solve_summary summary;
    const td_loss huber = {TD_LOSS_HUBER, 2, 2};
    if (options->outlier_sigma > 0) TD_TRY(solve_once(model, &huber, options, &summary, error));
    for (int round = 0; round < MOST_ROUNDS; round++) {
        bool changed = false;
        if (options->outlier_sigma > 0) {
            TD_TRY(choose_sights(model, options->outlier_sigma, &changed, error));
            if (!changed && round > 0) break;
        }
        TD_TRY(solve_once(model, NULL, options, &summary, error));
        if (!(options->outlier_sigma > 0)) break;
    }
    *converged = summary.converged;
    return TD_OK;
}

/* ---- the result ---- */

static void fill_estimates(td_vehicle *result, const td_vehicle_model *model,
                           const td_vehicle_options *options)
{
    const td_vehicle_data *data = model->data;
    double sum = 0;
    size_t used = 0;
    td_pose from_mount = vehicle_from_mount(data);
    result->mount_from_rig = model->mount_from_rig;
    result->vehicle_from_rig = td_pose_compose(&from_mount, &model->mount_from_rig);
    for (int k = 0; k < model->joints; k++) result->offset[model->joint[k]] = model->offset[k];
    for (size_t k = 0; k < data->pose_count; k++)
        for (int j = 0; j < model->joints; j++)
            result->noise[k * (size_t)data->robot->joint_count + (size_t)model->joint[j]] =
                model->noise[k * (size_t)model->joints + (size_t)j];
    memcpy(result->link_from_board, model->board, (size_t)data->board_count * sizeof *model->board);
    for (int p = 0; p < data->point_count; p++) {
        double x[3];
        td_vehicle_place(x, model, p);
        for (int i = 0; i < 3; i++)
            result->place[p][i] = model->seen[p] || isfinite(data->point[p].sigma[i]) ? x[i] : NAN;
    }
    for (size_t s = 0; s < data->sight_count; s++) {
        const td_vehicle_sight *sight = &data->sight[s];
        char text[TD_VEHICLE_POSE_TEXT];
        double *r = result->residual[s];
        if (!td_vehicle_residual(r, model, sight)) r[0] = r[1] = NAN;
        result->left_out[s] = !model->used[s];
        if (!model->used[s]) {
            result->outliers++;
            td_log_write(options->log, TD_LOG_WARNING, "vehicle",
                         "left out: point %s in %s as camera %s sees it", data->point[sight->point].name,
                         td_vehicle_pose_text(text, data, sight->pose),
                         data->rig->camera[sight->camera].name);
        } else if (isfinite(r[0])) {
            sum += r[0] * r[0] + r[1] * r[1];
            used++;
        }
    }
    result->rms_px = used ? sqrt(sum / (double)used) : NAN;
}

/* Worst axis of y = jacobian (3,6) times board's perturbation; each axis in sigma (3), which may be NULL. */
static td_status spread(double *worst, double *sigma, const double *jacobian, const td_vehicle_belief *b,
                        int board, td_error *error)
{
    size_t at = 6 + (size_t)b->joints + 3 * (size_t)b->points + 6 * (size_t)board;
    double block[36], c[9], value[3];
    for (size_t i = 0; i < 36; i++) block[i] = b->covariance[(at + i / 6) * b->size + at + i % 6];
    TD_TRY(td_sandwich(c, jacobian, block, 3, 6, error));
    TD_TRY(td_eigen_symmetric(value, NULL, c, 3, error));
    if (worst) *worst = sqrt(fmax(value[2], 0));
    for (int i = 0; i < 3 && sigma; i++) sigma[i] = sqrt(fmax(c[4 * i], 0));
    return TD_OK;
}

/* Boards' sigmas, and those of their points in the link's frame. */
static td_status fill_boards(td_vehicle *result, const td_vehicle_model *model, td_error *error)
{
    const td_vehicle_data *data = model->data;
    const double turn[18] = {1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0};
    double move[18];
    for (int b = 0; b < data->board_count; b++) {
        td_pose_transform_jacobian(move, model->board[b].t);
        TD_TRY(spread(&result->sigma_board[b][0], NULL, turn, result->belief, b, error));
        TD_TRY(spread(&result->sigma_board[b][1], NULL, move, result->belief, b, error));
    }
    for (int p = 0; p < data->point_count; p++) {
        if (!data->point[p].board) continue;
        td_pose_transform_jacobian(move, result->place[p]);
        TD_TRY(spread(NULL, result->sigma_place[p], move, result->belief, data->point[p].board - 1, error));
    }
    return TD_OK;
}

/* From the belief: sigmas of the zeros and places, and the covariance of vehicle_from_rig. */
static td_status fill_sigmas(td_vehicle *result, const td_vehicle_model *model, td_error *error)
{
    const td_vehicle_belief *b = result->belief;
    double block[36], ad[36], half[9], value[3];
    td_pose from_mount = vehicle_from_mount(model->data);
    for (int i = 0; i < 36; i++) block[i] = b->covariance[(size_t)(i / 6) * b->size + (size_t)(i % 6)];
    td_pose_adjoint(ad, &from_mount);
    TD_TRY(td_sandwich(result->covariance, ad, block, 6, 6, error));
    for (int h = 0; h < 2; h++) {
        for (int i = 0; i < 9; i++) half[i] = result->covariance[(3 * h + i / 3) * 6 + 3 * h + i % 3];
        TD_TRY(td_eigen_symmetric(value, NULL, half, 3, error));
        *(h ? &result->sigma_mm : &result->sigma_deg) = sqrt(fmax(value[2], 0)) * (h ? 1e3 : DEGREES);
    }
    size_t at = 6;
    for (int j = 0; j < model->data->robot->joint_count; j++)
        result->sigma_offset[j] = model->data->offset_prior[j]; /* those of the chain follow */
    for (int k = 0; k < b->joints; k++, at++)
        result->sigma_offset[b->joint[k]] = sqrt(fmax(b->covariance[at * (b->size + 1)], 0));
    for (int p = 0; p < b->points; p++)
        for (int i = 0; i < 3; i++, at++)
            result->sigma_place[p][i] = sqrt(fmax(b->covariance[at * (b->size + 1)], 0));
    return fill_boards(result, model, error);
}

static td_status fill_trust(td_vehicle *result, td_vehicle_model *model, const td_vehicle_options *options,
                            td_error *error)
{
    td_vehicle_problem vp;
    td_covariance *covariance = NULL;
    td_consider consider[TD_VEHICLE_MAX_CHUNKS];
    double ones[TD_VEHICLE_MAX_CHUNKS][TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE];
    TD_TRY(td_vehicle_problem_new(&vp, model, NULL, error));
    for (int k = 0; k < vp.chunks; k++) {
        memset(ones[k], 0, sizeof ones[k]);
        for (int i = 0; i < vp.chunk_size[k]; i++) ones[k][i * (vp.chunk_size[k] + 1)] = 1;
        consider[k] = (td_consider){vp.chunk[k], ones[k]};
    }
    int tip = options->tip < 0 ? model->data->robot->link_count - 1 : options->tip;
    td_status status = td_problem_covariance(&covariance, vp.problem, consider, (size_t)vp.chunks, error);
    if (status == TD_OK) {
        double dof =
            (double)td_covariance_rows(covariance) - (double)td_covariance_free_parameters(covariance);
        result->chi2_per_dof = dof > 0 ? td_covariance_chi2(covariance) / dof : NAN;
        status = td_vehicle_belief_new(&result->belief, model, &vp, covariance, tip, error);
    }
    if (status == TD_OK) status = fill_sigmas(result, model, error);
    if (status == TD_OK) td_vehicle_null_words(result, model);
    if (status == TD_OK && !result->null_count) {
        td_vehicle_weak_words(result, model);
        status = td_vehicle_tip_grid(result, model->data, error);
    }
    td_covariance_free(&covariance);
    td_vehicle_problem_free(&vp);
    return status;
}

static td_status fill_closed(td_vehicle *result, const td_vehicle_model *model, bool needed, td_error *error)
{
    td_pose mount_from_rig, from_mount = vehicle_from_mount(model->data);
    TD_TRY(td_vehicle_closed(&mount_from_rig, &result->closed_poses, model, error));
    if (needed && !result->closed_poses)
        return td_fail(
            error, TD_ERROR_DATA,
            "the closed way needs a pose in which two cameras see at least six points of known places "
            "that are not on a line: show more points, or measure their places");
    result->closed = td_pose_compose(&from_mount, &mount_from_rig);
    if (needed) {
        result->mount_from_rig = mount_from_rig;
        result->vehicle_from_rig = result->closed;
        memset(result->covariance, 0, sizeof result->covariance);
    }
    return TD_OK;
}

td_status td_vehicle_solve(td_vehicle **result, const td_vehicle_data *data,
                           const td_vehicle_options *options, td_error *error)
{
    td_vehicle_options o = options ? *options : td_vehicle_options_default();
    td_vehicle_model model;
    bool converged = true;
    *result = NULL;
    TD_TRY(td_vehicle_check(data, &o, error));
    td_status status = td_vehicle_model_new(&model, data, error);
    if (status == TD_OK) status = result_new(result, data, error);
    if (status == TD_OK) status = fill_closed(*result, &model, o.closed_only, error);
    if (status == TD_OK && !o.closed_only) {
        status = td_vehicle_start(&model, error);
        if (status == TD_OK) status = solve(&model, &o, &converged, error);
        if (status == TD_OK) fill_estimates(*result, &model, &o);
        if (status == TD_OK) status = fill_trust(*result, &model, &o, error);
        if (status == TD_OK && !converged && !(*result)->null_count)
            status =
                td_fail(error, TD_ERROR_CONVERGENCE,
                        "vehicle: the joint solution did not settle: check the robot's file, units and signs "
                        "of the joints, and the points' names");
    }
    td_vehicle_model_free(&model);
    if (status != TD_OK) td_vehicle_free(result);
    return status;
}
