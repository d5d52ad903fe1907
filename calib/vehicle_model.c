/* The measurement model of camera-to-vehicle calibration, its derivatives and its least-squares problem. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/vehicle_internal.h"
#include "core/linalg.h"

/* ---- the chain ---- */

static bool is_above(const td_robot *robot, int above, int link)
{
    for (; link >= 0; link = robot->link[link].parent)
        if (link == above) return true;
    return false;
}

td_status td_vehicle_add_chain(int *joint, int *count, const td_robot *robot, int a, int b, td_error *error)
{
    for (int j = 0; j < robot->joint_count; j++) {
        int child = robot->joint[j].link, at = 0;
        if (is_above(robot, child, a) == is_above(robot, child, b)) continue;
        while (at < *count && joint[at] < j) at++;
        if (at < *count && joint[at] == j) continue;
        if (*count == TD_VEHICLE_MAX_CHAIN)
            return td_fail(error, TD_ERROR_UNSUPPORTED,
                           "robot %s: more than %d moving joints lie between the cameras and the points",
                           robot->name, TD_VEHICLE_MAX_CHAIN);
        memmove(joint + at + 1, joint + at, (size_t)(*count - at) * sizeof *joint);
        joint[at] = j;
        ++*count;
    }
    return TD_OK;
}

td_pose td_vehicle_arm(double *jacobian, const td_robot *robot, int a, int link, const double *q,
                       const int *joint, int joints)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    td_robot_forward(root_from_link, robot, q);
    td_pose a_from_root = td_pose_inverse(&root_from_link[a]);
    if (jacobian) {
        double of_link[6 * TD_ROBOT_MAX_JOINTS], of_a[6 * TD_ROBOT_MAX_JOINTS], ad[36];
        int n = robot->joint_count;
        td_robot_jacobian(of_link, robot, root_from_link, link);
        td_robot_jacobian(of_a, robot, root_from_link, a);
        td_pose_adjoint(ad, &a_from_root);
        for (int i = 0; i < 6; i++)
            for (int k = 0; k < joints; k++) {
                double sum = 0;
                for (int m = 0; m < 6; m++)
                    sum += ad[6 * i + m] * (of_link[m * n + joint[k]] - of_a[m * n + joint[k]]);
                jacobian[i * joints + k] = sum;
            }
    }
    return td_pose_compose(&a_from_root, &root_from_link[link]);
}

/* ---- the model ---- */

/* Eigenvectors times roots of the eigenvalues, of the correlations so that pixels and radians weigh alike. */
static td_status factor_rig(td_vehicle_model *model, td_error *error)
{
    const td_rig *rig = model->data->rig;
    if (!rig->covariance) return TD_OK;
    size_t n = td_rig_parameter_count(rig), kept = 0;
    double *work = calloc(2 * n * n + 2 * n, sizeof *work);
    double *correlation = work, *vector = correlation + n * n, *value = vector + n * n, *sigma = value + n;
    model->factor = calloc(n * n + 1, sizeof *model->factor);
    td_status status = TD_OK;
    if (!work || !model->factor)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the rig's covariance");
    if (status == TD_OK) {
        for (size_t i = 0; i < n; i++) sigma[i] = sqrt(fmax(rig->covariance[i * (n + 1)], 0));
        for (size_t i = 0; i < n; i++)
            for (size_t k = 0; k < n; k++)
                if (sigma[i] > 0 && sigma[k] > 0)
                    correlation[i * n + k] = rig->covariance[i * n + k] / (sigma[i] * sigma[k]);
        status = td_eigen_symmetric(value, vector, correlation, n, error);
    }
    if (status == TD_OK) {
        for (size_t e = 0; e < n; e++) kept += value[e] > 1e-12;
        if (kept > sizeof model->z / sizeof *model->z)
            status = td_fail(error, TD_ERROR_UNSUPPORTED,
                             "the rig's covariance has %zu independent parts: at most %zu can be passed on; "
                             "calibrate with fewer cameras at a time",
                             kept, sizeof model->z / sizeof *model->z);
    }
    if (status == TD_OK) {
        model->factor_rows = n;
        model->factor_columns = kept;
        for (size_t i = 0; i < n; i++)
            for (size_t e = 0; e < kept; e++)
                model->factor[i * kept + e] = sigma[i] * vector[(n - 1 - e) * n + i] * sqrt(value[n - 1 - e]);
    }
    free(work);
    return status;
}

td_status td_vehicle_model_new(td_vehicle_model *model, const td_vehicle_data *data, td_error *error)
{
    size_t points = (size_t)data->point_count;
    *model = (td_vehicle_model){.data = data, .mount_from_rig = td_pose_identity()};
    model->place = calloc(points + 1, sizeof *model->place);
    model->seen = calloc(points + 1, sizeof *model->seen);
    model->used = calloc(data->sight_count + 1, sizeof *model->used);
    model->board = calloc((size_t)data->board_count + 1, sizeof *model->board);
    if (!model->place || !model->seen || !model->used || !model->board)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu sights", data->sight_count);
    for (size_t s = 0; s < data->sight_count; s++) {
        model->used[s] = true;
        model->seen[data->sight[s].point] = true;
    }
    for (int b = 0; b < data->board_count; b++) model->board[b] = data->board[b].link_from_board;
    for (size_t p = 0; p < points; p++) {
        for (int i = 0; i < 3; i++)
            model->place[p][i] = isfinite(data->point[p].sigma[i]) ? data->point[p].place[i] : 0;
        if (model->seen[p])
            TD_TRY(td_vehicle_add_chain(model->joint, &model->joints, data->robot, data->mount,
                                        data->point[p].link, error));
    }
    model->noise = calloc(data->pose_count * (size_t)model->joints + 1, sizeof *model->noise);
    if (!model->noise) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", data->pose_count);
    return factor_rig(model, error);
}

void td_vehicle_model_free(td_vehicle_model *model)
{
    free(model->noise);
    free(model->place);
    free(model->board);
    free(model->seen);
    free(model->used);
    free(model->factor);
    *model = (td_vehicle_model){0};
}

void td_vehicle_joints(double q[TD_ROBOT_MAX_JOINTS], const td_vehicle_model *model, size_t pose)
{
    int n = model->data->robot->joint_count;
    memcpy(q, model->data->q + pose * (size_t)n, (size_t)n * sizeof *q);
    for (int k = 0; k < model->joints; k++)
        q[model->joint[k]] += model->offset[k] + model->noise[pose * (size_t)model->joints + (size_t)k];
}

/* ---- the residual ---- */

static void multiply(double *c, const double *a, const double *b, int m, int k, int n)
{
    for (int i = 0; i < m; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int l = 0; l < k; l++) sum += a[i * k + l] * b[l * n + j];
            c[i * n + j] = sum;
        }
}

/* Camera c with the deviation z of the rig. */
static td_rig_camera deviated_camera(const td_vehicle_model *model, int c, const double *const *z, int chunks)
{
    td_rig_camera camera = model->data->rig->camera[c];
    int count = td_camera_parameter_count(camera.camera.model);
    if (!chunks) return camera;
    size_t row = td_rig_parameter_offset(model->data->rig, c), width = model->factor_columns;
    double xi[6] = {0};
    for (int i = 0; i < count + 6; i++) {
        double sum = 0;
        const double *f = model->factor + (row + (size_t)i) * width;
        for (size_t k = 0; k < width; k++) sum += f[k] * z[k / TD_MAX_BLOCK_SIZE][k % TD_MAX_BLOCK_SIZE];
        if (i < count)
            camera.camera.parameter[i] += sum;
        else
            xi[i - count] = sum;
    }
    camera.camera_from_rig = td_pose_perturb(&camera.camera_from_rig, xi);
    return camera;
}

/* Derivative (2, size of the chunk) by a chunk of the rig's deviation, at deviation 0. */
static void chunk_jacobian(double *out, const td_vehicle_model *model, int c, int chunk,
                           const double *d_parameter, const double *d_pose)
{
    int count = td_camera_parameter_count(model->data->rig->camera[c].camera.model);
    size_t row = td_rig_parameter_offset(model->data->rig, c), width = model->factor_columns;
    size_t first = (size_t)chunk * TD_MAX_BLOCK_SIZE;
    size_t size = width - first < TD_MAX_BLOCK_SIZE ? width - first : TD_MAX_BLOCK_SIZE;
    for (int i = 0; i < 2; i++)
        for (size_t k = 0; k < size; k++) {
            double sum = 0;
            for (int p = 0; p < count + 6; p++)
                sum += (p < count ? d_parameter[i * count + p] : d_pose[6 * i + p - count]) *
                       model->factor[(row + (size_t)p) * width + first + k];
            out[(size_t)i * size + k] = sum;
        }
}

enum { MOUNT, OFFSET, NOISE, PLACE, CHUNKS };

void td_vehicle_place(double x[3], const td_vehicle_model *model, int point)
{
    int board = model->data->point[point].board;
    memcpy(x, model->place[point], sizeof *model->place);
    if (board) td_pose_transform(x, &model->board[board - 1], x);
}

/* What the place's block holds: the place itself, or the pose of the point's board. */
static const double *place_block(const td_vehicle_model *model, int point)
{
    int board = model->data->point[point].board;
    return board ? (const double *)&model->board[board - 1] : model->place[point];
}

/* Derivative by the place's block, from that by the point in the link's frame (2,3). */
static void place_jacobian(double *out, const double by_link[6], const double x[3], bool on_board)
{
    double move[18];
    if (!on_board) {
        memcpy(out, by_link, 6 * sizeof *out);
        return;
    }
    td_pose_transform_jacobian(move, x);
    multiply(out, by_link, move, 2, 3, 6);
}

/* Blocks: mount_from_rig, the chain's offsets, the pose's noise, the point's place or its board's pose, the
 * rig's deviations. */
static bool evaluate(double *residual, double *const *jacobian, const double *const *block, const void *user)
{
    const td_vehicle_term *term = user;
    const td_vehicle_model *model = term->model;
    const td_vehicle_sight *sight = term->sight;
    const td_vehicle_data *data = model->data;
    int n = model->joints, joints = data->robot->joint_count;
    int chunks = (int)((model->factor_columns + TD_MAX_BLOCK_SIZE - 1) / TD_MAX_BLOCK_SIZE);
    double q[TD_ROBOT_MAX_JOINTS], by_joint[6 * TD_VEHICLE_MAX_CHAIN], w = 1 / sight->sigma_px;
    memcpy(q, data->q + sight->pose * (size_t)joints, (size_t)joints * sizeof *q);
    for (int k = 0; k < n; k++) q[model->joint[k]] += block[OFFSET][k] + block[NOISE][k];
    td_pose mount_from_rig;
    memcpy(&mount_from_rig, block[MOUNT], sizeof mount_from_rig);
    td_pose mount_from_link = td_vehicle_arm(jacobian ? by_joint : NULL, data->robot, data->mount,
                                             data->point[sight->point].link, q, model->joint, n);
    td_pose rig_from_mount = td_pose_inverse(&mount_from_rig);
    td_rig_camera camera = deviated_camera(model, sight->camera, block + CHUNKS, chunks);
    td_pose camera_from_mount = td_pose_compose(&camera.camera_from_rig, &rig_from_mount);
    double x_link[3], x_mount[3], x_camera[3], pixel[2], d_point[6],
        d_parameter[2 * TD_CAMERA_MAX_PARAMETERS];
    bool on_board = data->point[sight->point].board > 0;
    if (on_board) {
        td_pose link_from_board;
        memcpy(&link_from_board, block[PLACE], sizeof link_from_board);
        td_pose_transform(x_link, &link_from_board, model->place[sight->point]);
    } else {
        memcpy(x_link, block[PLACE], sizeof x_link);
    }
    td_pose_transform(x_mount, &mount_from_link, x_link);
    td_pose_transform(x_camera, &camera_from_mount, x_mount);
    if (!td_camera_project(pixel, d_point, d_parameter, &camera.camera, x_camera)) return false;
    for (int i = 0; i < 2; i++) residual[i] = w * (pixel[i] - sight->pixel[i]);
    if (!jacobian) return true;

    double r[9], move[18], by_mount[6], by_pose[12];
    for (int i = 0; i < 6; i++) d_point[i] *= w;
    td_pose_rotation(r, &camera_from_mount);
    multiply(by_mount, d_point, r, 2, 3, 3);
    td_pose_transform_jacobian(move, x_mount);
    multiply(by_pose, by_mount, move, 2, 3, 6);
    if (jacobian[MOUNT])
        for (int i = 0; i < 12; i++) jacobian[MOUNT][i] = -by_pose[i];
    if (n && jacobian[OFFSET]) multiply(jacobian[OFFSET], by_pose, by_joint, 2, 6, n);
    if (n && jacobian[NOISE]) multiply(jacobian[NOISE], by_pose, by_joint, 2, 6, n);
    if (jacobian[PLACE]) {
        td_pose_rotation(r, &mount_from_link);
        double by_link[6];
        multiply(by_link, by_mount, r, 2, 3, 3);
        place_jacobian(jacobian[PLACE], by_link, x_link, on_board);
    }
    int count = td_camera_parameter_count(camera.camera.model);
    for (int i = 0; i < 2 * count; i++) d_parameter[i] *= w;
    td_pose_transform_jacobian(move, x_camera);
    multiply(by_pose, d_point, move, 2, 3, 6);
    for (int k = 0; k < chunks; k++)
        if (jacobian[CHUNKS + k])
            chunk_jacobian(jacobian[CHUNKS + k], model, sight->camera, k, d_parameter, by_pose);
    return true;
}

bool td_vehicle_residual(double r[2], const td_vehicle_model *model, const td_vehicle_sight *sight)
{
    const double *block[CHUNKS + TD_VEHICLE_MAX_CHUNKS] = {
        (const double *)&model->mount_from_rig, model->offset,
        model->noise + sight->pose * (size_t)model->joints, place_block(model, sight->point)};
    for (int k = 0; k < TD_VEHICLE_MAX_CHUNKS; k++) block[CHUNKS + k] = model->z + k * TD_MAX_BLOCK_SIZE;
    td_vehicle_term term = {model, sight};
    if (!evaluate(r, NULL, block, &term)) return false;
    for (int i = 0; i < 2; i++) r[i] *= sight->sigma_px;
    return true;
}

bool td_vehicle_linearise(double by_mount[12], double *by_joint, double by_place[12],
                          const td_vehicle_model *model, const td_vehicle_sight *sight)
{
    const double *block[CHUNKS + TD_VEHICLE_MAX_CHUNKS] = {
        (const double *)&model->mount_from_rig, model->offset,
        model->noise + sight->pose * (size_t)model->joints, place_block(model, sight->point)};
    for (int k = 0; k < TD_VEHICLE_MAX_CHUNKS; k++) block[CHUNKS + k] = model->z + k * TD_MAX_BLOCK_SIZE;
    double r[2], *jacobian[CHUNKS + TD_VEHICLE_MAX_CHUNKS] = {by_mount, by_joint, NULL, by_place};
    td_vehicle_term term = {model, sight};
    return evaluate(r, jacobian, block, &term);
}

/* ---- the problem ---- */

/* A vector block whose components are exact (sigma 0), have a prior about `mean`, or are free. */
static td_status add_known(td_problem *problem, int *block, double *value, const double *mean,
                           const double *sigma, int size, bool local, td_error *error)
{
    double weight[TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE] = {0}, about[TD_MAX_BLOCK_SIZE] = {0};
    int held = 0, priors = 0;
    TD_TRY(td_problem_add_block(problem, block, value, size, TD_VECTOR, local, error));
    for (int i = 0; i < size; i++) held += sigma[i] == 0;
    if (held == size) return td_problem_hold(problem, *block, error);
    for (int i = 0; i < size; i++) {
        if (sigma[i] == 0) {
            TD_TRY(td_problem_hold_component(problem, *block, i, error));
        } else if (isfinite(sigma[i])) {
            weight[i * (size + 1)] = 1 / sigma[i];
            about[i] = mean[i]; /* that of a free component may be no number */
            priors++;
        }
    }
    return priors ? td_problem_add_prior(problem, *block, about, weight, error) : TD_OK;
}

/* A board's pose: exact, with a prior about where it was said to be, or free. The prior is of the board's own
 * axes, log(mean^-1 value) = Ad(mean^-1) log(value mean^-1). */
static td_status add_board(td_problem *problem, int *block, td_pose *value, const td_vehicle_board *board,
                           bool seen, td_error *error)
{
    double weight[36], sigma[2] = {board->sigma_rad, board->sigma_m};
    const double least[2] = {1e-7, 1e-6};
    TD_TRY(td_problem_add_block(problem, block, (double *)value, 7, TD_POSE, false, error));
    if (!seen || (sigma[0] == 0 && sigma[1] == 0)) return td_problem_hold(problem, *block, error);
    if (!isfinite(sigma[0]) && !isfinite(sigma[1])) return TD_OK;
    td_pose mean = board->link_from_board, inverse = td_pose_inverse(&mean);
    td_pose_adjoint(weight, &inverse);
    for (int i = 0; i < 36; i++) {
        double one = sigma[i / 18];
        weight[i] = isfinite(one) ? weight[i] / fmax(one, least[i / 18]) : 0;
    }
    return td_problem_add_prior(problem, *block, (const double *)&mean, weight, error);
}

static td_status add_places(td_vehicle_problem *vp, td_vehicle_model *model, td_error *error)
{
    const td_vehicle_data *data = model->data;
    const double zero[3] = {0};
    for (int b = 0; b < data->board_count; b++) {
        bool seen = false;
        for (int p = 0; p < data->point_count; p++)
            seen = seen || (data->point[p].board == b + 1 && model->seen[p]);
        TD_TRY(add_board(vp->problem, &vp->board[b], &model->board[b], &data->board[b], seen, error));
    }
    for (int p = 0; p < data->point_count; p++) {
        const td_vehicle_point *point = &data->point[p];
        if (point->board)
            vp->place[p] = vp->board[point->board - 1];
        else
            TD_TRY(add_known(vp->problem, &vp->place[p], model->place[p], point->place,
                             model->seen[p] ? point->sigma : zero, 3, false, error));
    }
    return TD_OK;
}

static td_status add_blocks(td_vehicle_problem *vp, td_vehicle_model *model, const bool *pose_used,
                            td_error *error)
{
    const td_vehicle_data *data = model->data;
    double sigma_q[TD_VEHICLE_MAX_CHAIN], sigma_offset[TD_VEHICLE_MAX_CHAIN];
    const double zero[TD_VEHICLE_MAX_CHAIN] = {0};
    int n = model->joints, size = n ? n : 1; /* a chain without joints keeps one number that nothing moves */
    for (int k = 0; k < size; k++) {
        sigma_q[k] = n ? data->sigma_q[model->joint[k]] : 0;
        sigma_offset[k] = n ? data->offset_prior[model->joint[k]] : 0;
    }
    TD_TRY(td_problem_add_block(vp->problem, &vp->mount, (double *)&model->mount_from_rig, 7, TD_POSE, false,
                                error));
    TD_TRY(add_known(vp->problem, &vp->offset, model->offset, zero, sigma_offset, size, false, error));
    for (size_t k = 0; k < data->pose_count; k++)
        TD_TRY(add_known(vp->problem, &vp->noise[k], n ? model->noise + k * (size_t)n : model->noise, zero,
                         pose_used[k] ? sigma_q : zero, size, true, error));
    TD_TRY(add_places(vp, model, error));
    for (size_t first = 0; first < model->factor_columns; first += TD_MAX_BLOCK_SIZE) {
        size_t left = model->factor_columns - first;
        vp->chunk_size[vp->chunks] = (int)(left < TD_MAX_BLOCK_SIZE ? left : TD_MAX_BLOCK_SIZE);
        int *block = &vp->chunk[vp->chunks];
        TD_TRY(td_problem_add_block(vp->problem, block, model->z + first, vp->chunk_size[vp->chunks],
                                    TD_VECTOR, false, error));
        TD_TRY(td_problem_hold(vp->problem, *block, error));
        vp->chunks++;
    }
    return TD_OK;
}

static td_status add_terms(td_vehicle_problem *vp, const td_vehicle_model *model, const td_loss *loss,
                           td_error *error)
{
    for (size_t s = 0; s < model->data->sight_count; s++) {
        const td_vehicle_sight *sight = &model->data->sight[s];
        if (!model->used[s]) continue;
        vp->term[s] = (td_vehicle_term){model, sight};
        int block[TD_MAX_RESIDUAL_BLOCKS] = {vp->mount, vp->offset, vp->noise[sight->pose],
                                             vp->place[sight->point]};
        for (int k = 0; k < vp->chunks; k++) block[CHUNKS + k] = vp->chunk[k];
        TD_TRY(td_problem_add_residual(vp->problem, evaluate, &vp->term[s], 2, block, CHUNKS + vp->chunks,
                                       loss, error));
    }
    return TD_OK;
}

td_status td_vehicle_problem_new(td_vehicle_problem *vp, td_vehicle_model *model, const td_loss *loss,
                                 td_error *error)
{
    const td_vehicle_data *data = model->data;
    *vp = (td_vehicle_problem){.problem = td_problem_new()};
    vp->term = calloc(data->sight_count + 1, sizeof *vp->term);
    vp->noise = calloc(data->pose_count + 1, sizeof *vp->noise);
    vp->place = calloc((size_t)data->point_count + 1, sizeof *vp->place);
    bool *pose_used = calloc(data->pose_count + 1, sizeof *pose_used);
    td_status status = TD_OK;
    if (!vp->problem || !vp->term || !vp->noise || !vp->place || !pose_used) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the joint problem");
    } else {
        for (size_t s = 0; s < data->sight_count; s++)
            if (model->used[s]) pose_used[data->sight[s].pose] = true;
        status = add_blocks(vp, model, pose_used, error);
    }
    if (status == TD_OK) status = add_terms(vp, model, loss, error);
    free(pose_used);
    if (status != TD_OK) td_vehicle_problem_free(vp);
    return status;
}

void td_vehicle_problem_free(td_vehicle_problem *vp)
{
    td_problem_free(&vp->problem);
    free(vp->term);
    free(vp->noise);
    free(vp->place);
    *vp = (td_vehicle_problem){0};
}
