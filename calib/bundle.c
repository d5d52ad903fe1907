#include "calib/bundle_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

td_status td_bundle_init(td_bundle *bundle, const td_observations *observations, td_error *error)
{
    size_t views = observations->view_count, points = td_target_point_count(&observations->target);
    size_t cameras = (size_t)observations->camera_count;
    *bundle = (td_bundle){.observations = observations, .noise_share = 1};
    bundle->rig = td_rig_new();
    bundle->pose_of_view = calloc(views + 1, sizeof *bundle->pose_of_view);
    bundle->rig_from_target = calloc(views + 1, sizeof *bundle->rig_from_target);
    bundle->used = calloc(views * cameras * points + 1, 1);
    if (!bundle->rig || !bundle->pose_of_view || !bundle->rig_from_target || !bundle->used) {
        td_bundle_free(bundle);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
    }
    bundle->rig->count = observations->camera_count;
    for (int c = 0; c < observations->camera_count; c++) {
        td_rig_camera *camera = &bundle->rig->camera[c];
        memcpy(camera->name, observations->camera[c].name, sizeof camera->name);
        camera->camera = (td_camera){.model = observations->camera[c].model,
                                     .width = observations->camera[c].width,
                                     .height = observations->camera[c].height};
        camera->camera_from_rig = td_pose_identity();
        bundle->noise[c] = 1;
    }
    size_t rail = SIZE_MAX; /* the pose shared by the views of known heights */
    for (size_t v = 0; v < views; v++) {
        bool free_view = isnan(observations->height_m[v]);
        if (free_view || rail == SIZE_MAX) bundle->pose_of_view[v] = bundle->pose_count++;
        if (!free_view && rail == SIZE_MAX) rail = bundle->pose_of_view[v];
        if (!free_view) bundle->pose_of_view[v] = rail;
        bundle->rig_from_target[bundle->pose_of_view[v]] = td_pose_identity();
        for (int c = 0; c < observations->camera_count; c++) {
            const td_detection *d = td_observations_get(observations, v, c);
            for (size_t p = 0; p < points && d->found; p++)
                bundle->used[td_bundle_index(bundle, v, c, p)] =
                    isfinite(d->point[2 * p]) && isfinite(d->point[2 * p + 1]);
        }
    }
    return TD_OK;
}

static void *duplicate(const void *from, size_t size)
{
    void *copy = malloc(size ? size : 1);
    if (copy && from) memcpy(copy, from, size);
    return copy;
}

td_status td_bundle_copy(td_bundle *copy, const td_bundle *bundle, td_error *error)
{
    size_t views = bundle->observations->view_count;
    size_t slots = td_bundle_index(bundle, views, 0, 0);
    *copy = *bundle;
    copy->rig = td_rig_copy(bundle->rig);
    copy->pose_of_view = duplicate(bundle->pose_of_view, views * sizeof *copy->pose_of_view);
    copy->rig_from_target = duplicate(bundle->rig_from_target, views * sizeof *copy->rig_from_target);
    copy->used = duplicate(bundle->used, slots);
    if (bundle->shift) copy->shift = duplicate(bundle->shift, 2 * slots * sizeof *copy->shift);
    if (!copy->rig || !copy->pose_of_view || !copy->rig_from_target || !copy->used ||
        (bundle->shift && !copy->shift)) {
        td_bundle_free(copy);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
    }
    return TD_OK;
}

void td_bundle_free(td_bundle *bundle)
{
    td_rig_free(&bundle->rig);
    free(bundle->pose_of_view);
    free(bundle->rig_from_target);
    free(bundle->used);
    free(bundle->shift);
    *bundle = (td_bundle){0};
}

void td_bundle_warp_shape(double shape[2], const td_target *target, size_t point)
{
    const td_target_plane *plane = target->plane;
    const double tag = target->kind == TD_TARGET_APRILGRID ? target->tag_size_m : 0;
    double at[2];
    td_target_point_on_plane(at, target, point);
    double x = 2 * at[0] / ((plane->columns - 1) * plane->spacing_m + tag) - 1;
    double y = 2 * at[1] / ((plane->rows - 1) * plane->spacing_m + tag) - 1;
    shape[0] = 1 - x * x;
    shape[1] = 1 - y * y;
}

void td_bundle_target_point(double p[3], const td_bundle *bundle, size_t view, size_t point)
{
    const td_target *target = &bundle->observations->target;
    td_target_point(p, target, point);
    if (bundle->use_warp) {
        double shape[2];
        td_bundle_warp_shape(shape, target, point);
        p[2] += bundle->warp[0] * shape[0] + bundle->warp[1] * shape[1];
    }
    double height = bundle->observations->height_m[view];
    if (!isnan(height)) p[2] -= height; /* z points into the board, heights towards the camera */
}

bool td_bundle_residual(double r[2], const td_bundle *bundle, size_t view, int camera, size_t point)
{
    const td_rig_camera *c = &bundle->rig->camera[camera];
    double p[3], pixel[2];
    td_bundle_target_point(p, bundle, view, point);
    td_pose_transform(p, &bundle->rig_from_target[bundle->pose_of_view[view]], p);
    td_pose_transform(p, &c->camera_from_rig, p);
    if (!td_camera_project(pixel, NULL, NULL, &c->camera, p)) return false;
    size_t index = td_bundle_index(bundle, view, camera, point);
    const double *seen = td_observations_get(bundle->observations, view, camera)->point + 2 * point;
    for (int i = 0; i < 2; i++)
        r[i] = pixel[i] + (bundle->shift ? bundle->shift[2 * index + i] : 0) - seen[i];
    return true;
}

size_t td_bundle_used(const td_bundle *bundle, size_t view, int camera)
{
    size_t points = td_target_point_count(&bundle->observations->target), count = 0;
    const uint8_t *used = bundle->used + td_bundle_index(bundle, view, camera, 0);
    for (size_t p = 0; p < points; p++) count += used[p];
    return count;
}

void td_bundle_drop(td_bundle *bundle, size_t view, int camera)
{
    memset(bundle->used + td_bundle_index(bundle, view, camera, 0), 0,
           td_target_point_count(&bundle->observations->target));
}

double td_bundle_square_sum(const td_bundle *bundle, int camera, size_t *points)
{
    size_t count = td_target_point_count(&bundle->observations->target);
    double sum = 0, r[2];
    *points = 0;
    for (size_t v = 0; v < bundle->observations->view_count; v++)
        for (int c = 0; c < bundle->rig->count; c++) {
            if (camera >= 0 && c != camera) continue;
            for (size_t p = 0; p < count; p++) {
                if (!bundle->used[td_bundle_index(bundle, v, c, p)]) continue;
                if (!td_bundle_residual(r, bundle, v, c, p)) return INFINITY;
                sum += r[0] * r[0] + r[1] * r[1];
                ++*points;
            }
        }
    return sum;
}

/* One camera's points in one view: a residual of 2 rows for each. */
typedef struct term {
    const td_bundle *bundle;
    size_t view;
    int camera;
} term;

/* r = A b, A (2,3), b (3,n) */
static void multiply23(double *r, const double a[6], const double *b, int n)
{
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < n; k++)
            r[i * n + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[n + k] + a[3 * i + 2] * b[2 * n + k];
}

static double weight_of(const td_bundle *bundle, const td_detection *d, int camera, size_t point)
{
    double s = bundle->own_sigma ? d->sigma[point] : 0, n = bundle->noise[camera];
    return 1 / sqrt(bundle->noise_share * (s * s + n * n));
}

/* Blocks in order: camera parameters, rig_from_target, then camera_from_rig unless first, then warp if used.
 */
static bool evaluate(double *residual, double *const *jacobian, const double *const *block, const void *user)
{
    const term *t = user;
    const td_bundle *bundle = t->bundle;
    const td_detection *d = td_observations_get(bundle->observations, t->view, t->camera);
    int next = 2, pose_block = t->camera > 0 ? next++ : -1, warp_block = bundle->use_warp ? next++ : -1;
    int parameters = td_camera_parameter_count(bundle->rig->camera[t->camera].camera.model);
    size_t points = td_target_point_count(&bundle->observations->target);
    td_camera camera = bundle->rig->camera[t->camera].camera;
    memcpy(camera.parameter, block[0], (size_t)parameters * sizeof(double));
    td_pose rig_from_target, camera_from_rig = td_pose_identity();
    memcpy(&rig_from_target, block[1], sizeof rig_from_target);
    if (pose_block >= 0) memcpy(&camera_from_rig, block[pose_block], sizeof camera_from_rig);
    double r_cr[9], r_rt[9];
    td_pose_rotation(r_cr, &camera_from_rig);
    td_pose_rotation(r_rt, &rig_from_target);
    double height = bundle->observations->height_m[t->view];

    int row = 0;
    for (size_t p = 0; p < points; p++) {
        size_t index = td_bundle_index(bundle, t->view, t->camera, p);
        if (!bundle->used[index]) continue;
        double x[3], x_rig[3], x_camera[3], pixel[2], d_point[6], d_parameter[2 * TD_CAMERA_MAX_PARAMETERS];
        double shape[2] = {0, 0}, w = weight_of(bundle, d, t->camera, p);
        td_target_point(x, &bundle->observations->target, p);
        if (warp_block >= 0) {
            td_bundle_warp_shape(shape, &bundle->observations->target, p);
            x[2] += block[warp_block][0] * shape[0] + block[warp_block][1] * shape[1];
        }
        if (!isnan(height)) x[2] -= height;
        td_pose_transform(x_rig, &rig_from_target, x);
        td_pose_transform(x_camera, &camera_from_rig, x_rig);
        if (!td_camera_project(pixel, d_point, d_parameter, &camera, x_camera)) return false;
        for (int i = 0; i < 2; i++)
            residual[row + i] =
                w * (pixel[i] + (bundle->shift ? bundle->shift[2 * index + i] : 0) - d->point[2 * p + i]);

        if (jacobian) {
            for (int i = 0; i < 6; i++) d_point[i] *= w;
            if (jacobian[0])
                for (int i = 0; i < 2 * parameters; i++)
                    jacobian[0][row * parameters + i] = w * d_parameter[i];
            double by_rig[6], move[18];
            multiply23(by_rig, d_point, r_cr, 3);
            if (jacobian[1]) {
                td_pose_transform_jacobian(move, x_rig);
                multiply23(jacobian[1] + 6 * row, by_rig, move, 6);
            }
            if (pose_block >= 0 && jacobian[pose_block]) {
                td_pose_transform_jacobian(move, x_camera);
                multiply23(jacobian[pose_block] + 6 * row, d_point, move, 6);
            }
            if (warp_block >= 0 && jacobian[warp_block])
                for (int i = 0; i < 2; i++) {
                    double by_z =
                        by_rig[3 * i] * r_rt[2] + by_rig[3 * i + 1] * r_rt[5] + by_rig[3 * i + 2] * r_rt[8];
                    jacobian[warp_block][2 * (row + i)] = by_z * shape[0];
                    jacobian[warp_block][2 * (row + i) + 1] = by_z * shape[1];
                }
        }
        row += 2;
    }
    return true;
}

static td_status hold_camera(td_bundle_problem *bp, const td_bundle *bundle, int camera, bool active,
                             td_error *error)
{
    td_problem *problem = bp->problem;
    unsigned hold = bundle->hold[camera];
    int count = td_camera_parameter_count(bundle->rig->camera[camera].camera.model);
    for (int i = 0; i < count; i++)
        if (hold & (i < 4 ? TD_HOLD_INTRINSICS : TD_HOLD_DISTORTION))
            TD_TRY(td_problem_hold_component(problem, bp->blocks.camera[camera], i, error));
    if (!active) TD_TRY(td_problem_hold(problem, bp->blocks.camera[camera], error));
    if (bp->blocks.pose[camera] >= 0 && ((hold & TD_HOLD_POSE) || !active))
        TD_TRY(td_problem_hold(problem, bp->blocks.pose[camera], error));
    return TD_OK;
}

/* Where views leave the distortion open its coefficients would run away (a rational model's numerator and
 * denominator cancel; a polynomial grows beyond the points): a prior far wider than any lens keeps them from
 * it. */
static td_status add_distortion_prior(td_bundle_problem *bp, const td_camera *camera, int block,
                                      td_error *error)
{
    enum { FIRST = 4 };
    const double spread = 50;
    int count = td_camera_parameter_count(camera->model);
    double mean[TD_CAMERA_MAX_PARAMETERS] = {0},
           weight[TD_CAMERA_MAX_PARAMETERS * TD_CAMERA_MAX_PARAMETERS] = {0};
    for (int i = FIRST; i < count; i++)
        if (td_camera_parameter_name(camera->model, i)[0] == 'k') weight[i * (count + 1)] = 1 / spread;
    return td_problem_add_prior(bp->problem, block, mean, weight, error);
}

static td_status add_blocks(td_bundle_problem *bp, td_bundle *bundle, td_error *error)
{
    td_bundle_blocks *b = &bp->blocks;
    for (int c = 0; c < bundle->rig->count; c++) {
        td_rig_camera *camera = &bundle->rig->camera[c];
        bool active = false;
        for (size_t v = 0; v < bundle->observations->view_count && !active; v++)
            active = td_bundle_used(bundle, v, c) > 0;
        TD_TRY(td_problem_add_block(bp->problem, &b->camera[c], camera->camera.parameter,
                                    td_camera_parameter_count(camera->camera.model), TD_VECTOR, false,
                                    error));
        if (camera->camera.model != TD_CAMERA_PINHOLE && active && !(bundle->hold[c] & TD_HOLD_DISTORTION))
            TD_TRY(add_distortion_prior(bp, &camera->camera, b->camera[c], error));
        b->pose[c] = -1;
        if (c > 0)
            TD_TRY(td_problem_add_block(bp->problem, &b->pose[c], (double *)&camera->camera_from_rig, 7,
                                        TD_POSE, false, error));
        TD_TRY(hold_camera(bp, bundle, c, active, error));
    }
    b->warp = -1;
    if (bundle->use_warp)
        TD_TRY(td_problem_add_block(bp->problem, &b->warp, bundle->warp, 2, TD_VECTOR, false, error));
    for (size_t i = 0; i < bundle->pose_count; i++)
        TD_TRY(td_problem_add_block(bp->problem, &b->view[i], (double *)&bundle->rig_from_target[i], 7,
                                    TD_POSE, true, error));
    return TD_OK;
}

static td_status add_terms(td_bundle_problem *bp, const td_bundle *bundle, const td_loss *loss,
                           td_error *error)
{
    term *terms = bp->terms;
    bool *seen = calloc(bundle->pose_count + 1, sizeof *seen);
    if (!seen) return td_fail(error, TD_ERROR_MEMORY, "no memory for the joint problem");
    td_status status = TD_OK;
    for (size_t v = 0; v < bundle->observations->view_count && status == TD_OK; v++)
        for (int c = 0; c < bundle->rig->count && status == TD_OK; c++) {
            size_t used = td_bundle_used(bundle, v, c);
            if (!used) continue;
            *terms = (term){bundle, v, c};
            int block[4] = {bp->blocks.camera[c], bp->blocks.view[bundle->pose_of_view[v]]}, count = 2;
            seen[bundle->pose_of_view[v]] = true;
            if (c > 0) block[count++] = bp->blocks.pose[c];
            if (bundle->use_warp) block[count++] = bp->blocks.warp;
            status = td_problem_add_residual(bp->problem, evaluate, terms++, (int)(2 * used), block, count,
                                             loss, error);
        }
    for (size_t i = 0; i < bundle->pose_count && status == TD_OK; i++)
        if (!seen[i]) status = td_problem_hold(bp->problem, bp->blocks.view[i], error);
    free(seen);
    return status;
}

td_status td_bundle_problem_new(td_bundle_problem *bp, td_bundle *bundle, const td_loss *loss,
                                td_error *error)
{
    *bp = (td_bundle_problem){.problem = td_problem_new()};
    bp->blocks.view = malloc((bundle->pose_count + 1) * sizeof *bp->blocks.view);
    bp->terms = malloc((bundle->observations->view_count * (size_t)bundle->rig->count + 1) * sizeof(term));
    td_status status = TD_OK;
    if (!bp->problem || !bp->blocks.view || !bp->terms)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the joint problem");
    if (status == TD_OK) status = add_blocks(bp, bundle, error);
    if (status == TD_OK) status = add_terms(bp, bundle, loss, error);
    if (status != TD_OK) td_bundle_problem_free(bp);
    return status;
}

void td_bundle_problem_free(td_bundle_problem *bp)
{
    td_problem_free(&bp->problem);
    free(bp->blocks.view);
    free(bp->terms);
    *bp = (td_bundle_problem){0};
}

td_status td_bundle_solve(td_bundle *bundle, const td_loss *loss, td_solve_summary *summary,
                          const td_solve_options *options, td_error *error)
{
    td_bundle_problem bp;
    TD_TRY(td_bundle_problem_new(&bp, bundle, loss, error));
    td_status status = td_problem_solve(bp.problem, summary, options, error);
    td_bundle_problem_free(&bp);
    return status;
}

td_status td_bundle_solve_view(td_bundle *bundle, size_t view, const td_loss *loss, td_error *error)
{
    td_problem *problem = td_problem_new();
    if (!problem) return td_fail(error, TD_ERROR_MEMORY, "no memory for a pose");
    td_status status = TD_OK;
    int pose = 0, warp = 0;
    term terms[TD_RIG_MAX_CAMERAS];
    status =
        td_problem_add_block(problem, &pose, (double *)&bundle->rig_from_target[bundle->pose_of_view[view]],
                             7, TD_POSE, false, error);
    if (status == TD_OK && bundle->use_warp) {
        status = td_problem_add_block(problem, &warp, bundle->warp, 2, TD_VECTOR, false, error);
        if (status == TD_OK) status = td_problem_hold(problem, warp, error);
    }
    for (int c = 0; c < bundle->rig->count && status == TD_OK; c++) {
        size_t used = td_bundle_used(bundle, view, c);
        td_rig_camera *camera = &bundle->rig->camera[c];
        int block[4] = {0, pose}, count = 2;
        if (!used) continue;
        terms[c] = (term){bundle, view, c};
        status =
            td_problem_add_block(problem, &block[0], camera->camera.parameter,
                                 td_camera_parameter_count(camera->camera.model), TD_VECTOR, false, error);
        if (status == TD_OK) status = td_problem_hold(problem, block[0], error);
        if (status == TD_OK && c > 0) {
            status = td_problem_add_block(problem, &block[count], (double *)&camera->camera_from_rig, 7,
                                          TD_POSE, false, error);
            if (status == TD_OK) status = td_problem_hold(problem, block[count++], error);
        }
        if (bundle->use_warp) block[count++] = warp;
        if (status == TD_OK)
            status = td_problem_add_residual(problem, evaluate, &terms[c], (int)(2 * used), block, count,
                                             loss, error);
    }
    if (status == TD_OK) status = td_problem_solve(problem, NULL, NULL, error);
    td_problem_free(&problem);
    return status;
}
