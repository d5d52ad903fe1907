/* Kinematic calibration from measured poses. */
#include "calib/kinematic.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "calib/kinematic_internal.h"

enum { LEAST = 6, ROUNDS = 8 };
enum { MOUNT, TARGET, CHUNKS };

#define LEAST_RAD 1e-9
#define LEAST_M 1e-9
/* A joint that moves by less than this stands still (rad or m). */
#define MOVED 0.01

td_kinematic_options td_kinematic_options_default(void)
{
    return (td_kinematic_options){.sigma_origin_rad = 0.05, .sigma_origin_m = 0.05, .outlier_sigma = 5};
}

/* ---- the chain ---- */

static td_pose motion(const td_robot_joint *joint, double q)
{
    td_pose m = td_pose_identity();
    double turn[3] = {joint->axis[0] * q, joint->axis[1] * q, joint->axis[2] * q};
    if (joint->kind == TD_JOINT_PRISMATIC)
        memcpy(m.t, turn, sizeof turn);
    else
        td_rotation_exp(m.q, turn);
    return m;
}

static int chain_index(const td_kin_model *m, int joint)
{
    for (int k = 0; k < m->joints; k++)
        if (m->joint[k] == joint) return k;
    return -1;
}

/* root_from_link with corrected origins; in `above`, for each joint of the chain on the way, root_from its
 * parent, which carries the perturbation of its origin to the root; on_way tells which. */
static td_pose forward(td_pose *above, bool *on_way, const td_kin_model *m, const double *const *correction,
                       int link, const double *q)
{
    const td_robot *robot = m->data->robot;
    int path[TD_ROBOT_MAX_LINKS], count = 0;
    td_pose pose = td_pose_identity();
    for (int l = link; l >= 0; l = robot->link[l].parent) path[count++] = l;
    for (int k = 0; k < m->joints; k++) on_way[k] = false;
    while (count-- > 0) {
        const td_robot_link *l = &robot->link[path[count]];
        td_pose origin = l->parent_from_link, turn;
        int k = l->joint >= 0 ? chain_index(m, l->joint) : -1;
        if (k >= 0) {
            origin = td_pose_perturb(&origin, correction[k / TD_KIN_IN_CHUNK] +
                                                  TD_KIN_OF_JOINT * (k % TD_KIN_IN_CHUNK));
            above[k] = pose;
            on_way[k] = true;
        }
        pose = td_pose_compose(&pose, &origin);
        if (l->joint < 0) continue;
        turn = motion(&robot->joint[l->joint], q[l->joint]);
        pose = td_pose_compose(&pose, &turn);
    }
    return pose;
}

/* mount_from_link; by_origin (joints,6,6) its left perturbation by each correction, NULL: not wanted. */
static td_pose chain(double (*by_origin)[36], const td_kin_model *m, const double *const *correction,
                     const double *q)
{
    td_pose above[2][TD_KIN_JOINTS];
    bool on_way[2][TD_KIN_JOINTS];
    td_pose root_from_link = forward(above[0], on_way[0], m, correction, m->data->link, q);
    td_pose root_from_mount = forward(above[1], on_way[1], m, correction, m->data->mount, q);
    td_pose mount_from_root = td_pose_inverse(&root_from_mount);
    for (int k = 0; k < m->joints && by_origin; k++) {
        /* A joint is on one of the two ways: on the mount's its perturbation counts backwards. */
        int way = on_way[0][k] ? 0 : 1;
        td_pose to_mount = td_pose_compose(&mount_from_root, &above[way][k]);
        double ad[36], left[36];
        td_pose_adjoint(ad, &to_mount);
        td_pose_left_jacobian(left,
                              correction[k / TD_KIN_IN_CHUNK] + TD_KIN_OF_JOINT * (k % TD_KIN_IN_CHUNK));
        for (int i = 0; i < 36; i++) {
            double sum = 0;
            for (int c = 0; c < 6; c++) sum += ad[6 * (i / 6) + c] * left[6 * c + i % 6];
            by_origin[k][i] = way ? -sum : sum;
        }
    }
    return td_pose_compose(&mount_from_root, &root_from_link);
}

/* ---- the residual ---- */

/* out (6,6) = rows (6,6) of the residual by the predicted pose's perturbation, times its own by a block. */
static void put(double *out, int stride, int column, const double rows[36], const double by[36])
{
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 6; k++) {
            double sum = 0;
            for (int c = 0; c < 6; c++) sum += rows[6 * i + c] * by[6 * c + k];
            out[i * stride + column + k] = sum;
        }
}

/* Residual rows by the left perturbation of the predicted pose: rotation J_l^-1(r) omega, translation
 * tau + omega x t. */
static void residual_rows(double rows[36], const double r[3], const double t[3], const td_kin_model *m)
{
    double inverse[9], move[18];
    td_rotation_left_jacobian_inverse(inverse, r);
    td_pose_transform_jacobian(move, t);
    memset(rows, 0, 36 * sizeof *rows);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 6; k++) {
            if (k < 3) rows[6 * i + k] = inverse[3 * i + k] / m->sigma_rad;
            rows[6 * (i + 3) + k] = move[6 * i + k] / m->sigma_m;
        }
}

static bool evaluate(double *residual, double *const *jacobian, const double *const *block, const void *user)
{
    const td_kin_term *t = user;
    const td_kin_model *m = t->model;
    const td_pose *seen = &m->data->rig_from_target[t->index];
    const double *q = m->data->q + t->index * (size_t)m->data->robot->joint_count;
    double by_origin[TD_KIN_JOINTS][36], r[3], rows[36], ad[36];
    td_pose mount_from_rig, link_from_target, turn = td_pose_identity(), back = td_pose_inverse(seen);
    memcpy(&mount_from_rig, block[MOUNT], sizeof mount_from_rig);
    memcpy(&link_from_target, block[TARGET], sizeof link_from_target);
    td_pose mount_from_link = chain(jacobian ? by_origin : NULL, m, block + CHUNKS, q);
    td_pose rig_from_mount = td_pose_inverse(&mount_from_rig);
    td_pose rig_from_link = td_pose_compose(&rig_from_mount, &mount_from_link);
    td_pose said = td_pose_compose(&rig_from_link, &link_from_target);
    turn = td_pose_compose(&said, &back);
    td_rotation_log(r, turn.q);
    for (int i = 0; i < 3; i++) {
        residual[i] = r[i] / m->sigma_rad;
        residual[i + 3] = (said.t[i] - seen->t[i]) / m->sigma_m;
    }
    if (!jacobian) return true;
    residual_rows(rows, r, said.t, m);
    td_pose_adjoint(ad, &rig_from_link);
    if (jacobian[TARGET]) put(jacobian[TARGET], 6, 0, rows, ad);
    /* rig_from_mount turns the mount's perturbations into the rig's; that of mount_from_rig counts backwards.
     */
    double to_rig[36], backwards[36];
    td_pose_adjoint(ad, &rig_from_mount);
    for (int i = 0; i < 36; i++) backwards[i] = -ad[i];
    if (jacobian[MOUNT]) put(jacobian[MOUNT], 6, 0, rows, backwards);
    put(to_rig, 6, 0, rows, ad);
    for (int k = 0; k < m->joints; k++) {
        int left = m->joints - k / TD_KIN_IN_CHUNK * TD_KIN_IN_CHUNK,
            stride = TD_KIN_OF_JOINT * (left < TD_KIN_IN_CHUNK ? left : TD_KIN_IN_CHUNK);
        if (jacobian[CHUNKS + k / TD_KIN_IN_CHUNK])
            put(jacobian[CHUNKS + k / TD_KIN_IN_CHUNK], stride, TD_KIN_OF_JOINT * (k % TD_KIN_IN_CHUNK),
                to_rig, by_origin[k]);
    }
    return true;
}

/* ---- the problem ---- */

static td_status add_corrections(td_kin_problem *p, td_kin_model *m, const td_kinematic_options *options,
                                 td_error *error)
{
    const double zero[TD_KIN_OF_JOINT * TD_KIN_IN_CHUNK] = {0};
    double sigma[2] = {options->sigma_origin_rad, options->sigma_origin_m};
    for (int first = 0; first < m->joints; first += TD_KIN_IN_CHUNK) {
        int left = m->joints - first,
            size = TD_KIN_OF_JOINT * (left < TD_KIN_IN_CHUNK ? left : TD_KIN_IN_CHUNK);
        double weight[TD_KIN_OF_JOINT * TD_KIN_IN_CHUNK * TD_KIN_OF_JOINT * TD_KIN_IN_CHUNK] = {0};
        int *block = &p->chunk[p->chunks];
        p->size[p->chunks++] = size;
        TD_TRY(td_problem_add_block(p->problem, block, m->correction + TD_KIN_OF_JOINT * first, size,
                                    TD_VECTOR, false, error));
        for (int i = 0; i < size; i++) {
            double s = sigma[i % TD_KIN_OF_JOINT / 3];
            if (s > 0)
                weight[i * (size + 1)] = 1 / s;
            else
                TD_TRY(td_problem_hold_component(p->problem, *block, i, error));
        }
        if (sigma[0] > 0 || sigma[1] > 0)
            TD_TRY(td_problem_add_prior(p->problem, *block, zero, weight, error));
        else
            TD_TRY(td_problem_hold(p->problem, *block, error));
    }
    return TD_OK;
}

void td_kin_problem_free(td_kin_problem *p)
{
    td_problem_free(&p->problem);
    free(p->term);
}

td_status td_kin_problem_new(td_kin_problem *p, td_kin_model *m, const td_kinematic_options *options,
                             td_error *error)
{
    *p =
        (td_kin_problem){.problem = td_problem_new(), .term = malloc((m->data->count + 1) * sizeof *p->term)};
    if (!p->problem || !p->term)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", m->data->count);
    TD_TRY(
        td_problem_add_block(p->problem, &p->mount, (double *)&m->mount_from_rig, 7, TD_POSE, false, error));
    TD_TRY(td_problem_add_block(p->problem, &p->target, (double *)&m->link_from_target, 7, TD_POSE, false,
                                error));
    TD_TRY(add_corrections(p, m, options, error));
    for (size_t i = 0; i < m->data->count; i++) {
        int block[CHUNKS + TD_KIN_CHUNKS] = {p->mount, p->target};
        if (!m->used[i]) continue;
        for (int k = 0; k < p->chunks; k++) block[CHUNKS + k] = p->chunk[k];
        p->term[i] = (td_kin_term){m, i};
        TD_TRY(td_problem_add_residual(p->problem, evaluate, &p->term[i], 6, block, CHUNKS + p->chunks, NULL,
                                       error));
    }
    return TD_OK;
}

static td_pose predict(const td_kin_model *m, const double *q)
{
    const double *correction[TD_KIN_CHUNKS];
    for (int k = 0; k < TD_KIN_CHUNKS; k++)
        correction[k] = m->correction + TD_KIN_OF_JOINT * TD_KIN_IN_CHUNK * k;
    td_pose arm = chain(NULL, m, correction, q), rig_from_mount = td_pose_inverse(&m->mount_from_rig);
    td_pose there = td_pose_compose(&rig_from_mount, &arm);
    return td_pose_compose(&there, &m->link_from_target);
}

/* Lengths of a pose's residual: rotation, translation. */
static void lengths(double out[2], const td_kin_model *m, size_t index)
{
    td_pose said = predict(m, m->data->q + index * (size_t)m->data->robot->joint_count);
    const td_pose *seen = &m->data->rig_from_target[index];
    td_pose back = td_pose_inverse(seen), turn = td_pose_compose(&said, &back);
    out[0] = td_pose_angle(&turn);
    out[1] = hypot(hypot(said.t[0] - seen->t[0], said.t[1] - seen->t[1]), said.t[2] - seen->t[2]);
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sigma of each axis from the used residuals; first from medians (the median of the length of three normal
 * components is 1.538 sigma), over which poses are left out. */
static td_status choose_poses(td_kin_model *m, double limit, td_error *error)
{
    size_t n = m->data->count, used = 0;
    double *length = malloc(3 * n * sizeof *length), *sorted = length + 2 * n, sum[2] = {0}, median[2];
    if (!length) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", n);
    for (size_t i = 0; i < n; i++) lengths(length + 2 * i, m, i);
    for (int half = 0; half < 2; half++) {
        for (size_t i = 0; i < n; i++) sorted[i] = length[2 * i + (size_t)half];
        qsort(sorted, n, sizeof *sorted, by_size);
        median[half] = fmax(sorted[n / 2] / 1.538, half ? LEAST_M : LEAST_RAD);
    }
    for (size_t i = 0; i < n; i++) {
        m->used[i] =
            limit == 0 || (length[2 * i] <= limit * median[0] && length[2 * i + 1] <= limit * median[1]);
        used += m->used[i];
        for (int half = 0; half < 2 && m->used[i]; half++) sum[half] += pow(length[2 * i + (size_t)half], 2);
    }
    free(length);
    /* Twelve numbers of the two poses are spent; those of the origins have priors. */
    double freedom = fmax(3 * (double)used - 6, 1);
    m->sigma_rad = fmax(sqrt(sum[0] / freedom), LEAST_RAD);
    m->sigma_m = fmax(sqrt(sum[1] / freedom), LEAST_M);
    return TD_OK;
}

static td_status solve(td_kin_model *m, const td_kinematic_options *options, td_error *error)
{
    td_solve_options solve_options = td_solve_options_default();
    solve_options.progress = options->progress;
    solve_options.log = options->log;
    for (int round = 0; round < ROUNDS; round++) {
        td_kin_problem p;
        double before[2] = {m->sigma_rad, m->sigma_m};
        td_status status = td_kin_problem_new(&p, m, options, error);
        if (status == TD_OK) status = td_problem_solve(p.problem, NULL, &solve_options, error);
        td_kin_problem_free(&p);
        if (status == TD_OK) status = choose_poses(m, options->outlier_sigma, error);
        if (status != TD_OK) return status;
        if (fabs(m->sigma_rad - before[0]) < 1e-3 * before[0] &&
            fabs(m->sigma_m - before[1]) < 1e-3 * before[1])
            break;
    }
    return TD_OK;
}

/* ---- start, checks, result ---- */

static bool is_above(const td_robot *robot, int above, int link)
{
    for (; link >= 0; link = robot->link[link].parent)
        if (link == above) return true;
    return false;
}

static td_status find_chain(td_kin_model *m, td_error *error)
{
    const td_kinematic_data *data = m->data;
    for (int j = 0; j < data->robot->joint_count; j++) {
        int child = data->robot->joint[j].link;
        double low = INFINITY, high = -INFINITY;
        if (is_above(data->robot, child, data->mount) == is_above(data->robot, child, data->link)) continue;
        if (m->joints == TD_KIN_JOINTS)
            return td_fail(error, TD_ERROR_UNSUPPORTED,
                           "robot %s: more than %d joints between mount and target", data->robot->name,
                           TD_KIN_JOINTS);
        m->joint[m->joints++] = j;
        for (size_t i = 0; i < data->count; i++) {
            double q = data->q[i * (size_t)data->robot->joint_count + (size_t)j];
            if (!isfinite(q))
                return td_fail(error, TD_ERROR_ARGUMENT, "pose %zu: joint %s reads %g: give a number", i,
                               data->robot->joint[j].name, q);
            low = fmin(low, q);
            high = fmax(high, q);
        }
        if (high - low < MOVED)
            return td_fail(error, TD_ERROR_DATA, "joint %s stands still in all %zu poses: move it",
                           data->robot->joint[j].name, data->count);
    }
    if (!m->joints)
        return td_fail(error, TD_ERROR_DATA,
                       "no moving joint lies between the links of the rig and of the target");
    return TD_OK;
}

static td_status check(const td_kinematic_data *data, const td_kinematic_options *options, td_error *error)
{
    if (!data || !data->robot || !data->q || !data->rig_from_target)
        return td_fail(error, TD_ERROR_ARGUMENT, "kinematic: give a robot, readings and poses");
    int links = data->robot->link_count;
    if (data->mount < 0 || data->mount >= links || data->link < 0 || data->link >= links)
        return td_fail(error, TD_ERROR_ARGUMENT, "kinematic: links %d and %d: the robot %s has links 0 to %d",
                       data->mount, data->link, data->robot->name, links - 1);
    if (data->count < LEAST)
        return td_fail(error, TD_ERROR_DATA, "kinematic: %zu poses: give at least %d", data->count, LEAST);
    if (!(options->sigma_origin_rad >= 0) || !(options->sigma_origin_m >= 0) ||
        !(options->outlier_sigma >= 0) || !isfinite(options->sigma_origin_rad) ||
        !isfinite(options->sigma_origin_m))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "kinematic: sigma_origin_rad %g, sigma_origin_m %g, outlier_sigma %g: give finite numbers, "
            "0 or more",
            options->sigma_origin_rad, options->sigma_origin_m, options->outlier_sigma);
    for (size_t i = 0; i < data->count; i++)
        for (int k = 0; k < 7; k++)
            if (!isfinite(k < 4 ? data->rig_from_target[i].q[k] : data->rig_from_target[i].t[k - 4]))
                return td_fail(error, TD_ERROR_ARGUMENT, "pose %zu: a number of the measured pose is none",
                               i);
    return TD_OK;
}

/* link_from_mount mount_from_rig rig_from_target = link_from_target: a hand-eye problem. */
static td_status start(td_kin_model *m, td_error *error)
{
    size_t n = m->data->count;
    const double *zero[TD_KIN_CHUNKS];
    td_he_view *view = calloc(n, sizeof *view);
    td_he_state state = {.scale = 1};
    if (!view) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", n);
    for (int k = 0; k < TD_KIN_CHUNKS; k++) zero[k] = m->correction;
    for (size_t i = 0; i < n; i++) {
        td_pose arm = chain(NULL, m, zero, m->data->q + i * (size_t)m->data->robot->joint_count);
        view[i] =
            (td_he_view){.hand = td_pose_inverse(&arm), .sight = m->data->rig_from_target[i], .index = i};
        for (int k = 0; k < 6; k++) view[i].cov[7 * k] = 1e-6;
    }
    td_status status = td_he_start(&state, view, n, error);
    free(view);
    m->mount_from_rig = state.near;
    m->link_from_target = state.far;
    return status == TD_OK ? choose_poses(m, 0, error) : status;
}

static td_status fill(td_kinematic *result, td_kin_model *m, const td_kinematic_options *options,
                      td_error *error)
{
    td_kin_problem p;
    td_covariance *covariance = NULL;
    td_status status = td_kin_problem_new(&p, m, options, error);
    if (status == TD_OK) status = td_problem_covariance(&covariance, p.problem, NULL, 0, error);
    for (int i = 0; i < 4 && status == TD_OK; i++) {
        double block[36];
        status = td_covariance_get(block, covariance, i / 2 ? p.target : p.mount, i % 2 ? p.target : p.mount,
                                   error);
        for (int k = 0; k < 36 && status == TD_OK; k++)
            result->covariance[(6 * (i / 2) + k / 6) * 12 + 6 * (i % 2) + k % 6] = block[k];
    }
    for (int c = 0; c < p.chunks && status == TD_OK; c++) {
        double block[TD_MAX_BLOCK_SIZE * TD_MAX_BLOCK_SIZE];
        status = td_covariance_get(block, covariance, p.chunk[c], p.chunk[c], error);
        for (int k = 0; k < p.size[c] && status == TD_OK; k++)
            result->sigma_correction[TD_KIN_IN_CHUNK * c + k / TD_KIN_OF_JOINT][k % TD_KIN_OF_JOINT] =
                sqrt(fmax(block[k * (p.size[c] + 1)], 0));
    }
    td_covariance_free(&covariance);
    td_kin_problem_free(&p);
    if (status != TD_OK) return status;
    result->mount_from_rig = m->mount_from_rig;
    result->link_from_target = m->link_from_target;
    result->sigma_rad = m->sigma_rad;
    result->sigma_m = m->sigma_m;
    result->joints = m->joints;
    for (int k = 0; k < m->joints; k++) {
        td_pose *origin = &result->robot->link[result->robot->joint[m->joint[k]].link].parent_from_link;
        result->joint[k] = m->joint[k];
        memcpy(result->correction[k], m->correction + TD_KIN_OF_JOINT * k, TD_KIN_OF_JOINT * sizeof(double));
        *origin = td_pose_perturb(origin, result->correction[k]);
    }
    for (size_t i = 0; i < m->data->count; i++) {
        result->left_out[i] = !m->used[i];
        result->used += m->used[i];
    }
    return TD_OK;
}

void td_kinematic_free(td_kinematic **result)
{
    if (!*result) return;
    free((*result)->robot);
    free((*result)->left_out);
    free(*result);
    *result = NULL;
}

td_status td_kinematic_solve(td_kinematic **result, const td_kinematic_data *data,
                             const td_kinematic_options *options, td_error *error)
{
    td_kinematic_options o = options ? *options : td_kinematic_options_default();
    *result = NULL;
    TD_TRY(check(data, &o, error));
    td_kin_model m = {
        .data = data, .sigma_rad = 1e-3, .sigma_m = 1e-3, .used = calloc(data->count, sizeof(bool))};
    td_kinematic *k = *result = calloc(1, sizeof *k);
    td_status status = TD_OK;
    if (k) k->robot = malloc(sizeof *k->robot);
    if (k) k->left_out = calloc(data->count, sizeof *k->left_out);
    if (!m.used || !k || !k->robot || !k->left_out)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for %zu poses", data->count);
    if (status == TD_OK) *k->robot = *data->robot;
    if (status == TD_OK) status = find_chain(&m, error);
    if (status == TD_OK) status = start(&m, error);
    if (status == TD_OK) status = solve(&m, &o, error);
    if (status == TD_OK) status = fill(k, &m, &o, error);
    free(m.used);
    if (status != TD_OK) td_kinematic_free(result);
    return status;
}

td_pose td_kinematic_predict(const td_kinematic *result, const td_kinematic_data *data, const double *q)
{
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    td_robot_forward(root_from_link, result->robot, q);
    td_pose root_from_rig = td_pose_compose(&root_from_link[data->mount], &result->mount_from_rig);
    td_pose rig_from_root = td_pose_inverse(&root_from_rig);
    td_pose root_from_target = td_pose_compose(&root_from_link[data->link], &result->link_from_target);
    return td_pose_compose(&rig_from_root, &root_from_target);
}
