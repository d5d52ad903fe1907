/* New views against a rig that is held: their poses, their outliers, and what they say of the rig. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/board_error_internal.h"
#include "calib/drift_internal.h"
#include "core/linalg.h"

#define RAYLEIGH_MEDIAN 1.1774100225154747 /* of a length of two equal Gaussian coordinates, in sigmas */
#define LEAST_NOISE 1e-4                   /* px; what is smaller is rounding, not noise */
/* Views whose median residual is this many times the usual are left out; points so many sigmas out. */
#define VIEW_TIMES 4.0
#define POINT_SIGMAS 5.0
enum { ROUNDS = 6, FEWEST_POINTS = 6 };

/* ---- views and poses ---- */

static bool warp_possible(const td_observations *o)
{
    for (size_t v = 0; v < o->view_count; v++)
        if (!isnan(o->height_m[v])) return false;
    td_target_kind kind = o->target.kind;
    return o->target.plane_count == 1 && o->target.plane[0].columns > 1 && o->target.plane[0].rows > 1 &&
           (kind == TD_TARGET_CHESSBOARD || kind == TD_TARGET_MARKS || kind == TD_TARGET_CHARUCO);
}

/* A copy with the rig's cameras, matched by name. */
static td_status match(td_observations **out, const td_rig *rig, const td_observations *from, td_error *error)
{
    size_t seen = 0;
    TD_TRY(td_observations_new(out, &from->target, rig->count, from->view_count, error));
    td_observations *o = *out;
    memcpy(o->view_name, from->view_name, from->view_count * sizeof *o->view_name);
    memcpy(o->height_m, from->height_m, from->view_count * sizeof *o->height_m);
    for (int c = 0; c < rig->count; c++) {
        const td_rig_camera *camera = &rig->camera[c];
        int k = from->camera_count - 1;
        while (k >= 0 && strcmp(from->camera[k].name, camera->name) != 0) k--;
        o->camera[c].model = camera->camera.model;
        o->camera[c].width = camera->camera.width;
        o->camera[c].height = camera->camera.height;
        memcpy(o->camera[c].name, camera->name, sizeof camera->name);
        if (k < 0) continue;
        const td_observed_camera *seen_by = &from->camera[k];
        if (seen_by->width &&
            (seen_by->width != camera->camera.width || seen_by->height != camera->camera.height))
            return td_fail(error, TD_ERROR_DATA,
                           "camera %s: its images are %dx%d px, the rig was calibrated at %dx%d px",
                           camera->name, seen_by->width, seen_by->height, camera->camera.width,
                           camera->camera.height);
        for (size_t v = 0; v < from->view_count; v++) {
            const td_detection *s = td_observations_get(from, v, k);
            td_detection *d = td_observations_get(o, v, c);
            memcpy(d->point, s->point, 2 * s->count * sizeof *d->point);
            memcpy(d->sigma, s->sigma, s->count * sizeof *d->sigma);
            d->found = s->found;
            seen += s->found;
        }
    }
    if (!seen)
        return td_fail(
            error, TD_ERROR_DATA,
            "no camera of the rig (%s%s) sees the target in any image: names must agree, and the board "
            "must be whole and sharp",
            rig->camera[0].name, rig->count > 1 ? ", …" : "");
    return TD_OK;
}

/* Each view's pose by homography, in the first camera that saw it. */
static td_status start_poses(td_drift_views *views, td_error *error)
{
    const td_observations *o = views->observations;
    td_bundle *b = &views->bundle;
    td_pose *pose = malloc((o->view_count + 1) * sizeof *pose);
    bool *has_pose = malloc((o->view_count + 1) * sizeof *has_pose);
    bool *done = calloc(o->view_count + 1, sizeof *done);
    td_status status = pose && has_pose && done
                           ? TD_OK
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", o->view_count);
    for (int c = 0; c < b->rig->count && status == TD_OK; c++) {
        size_t seen = 0;
        td_camera camera = b->rig->camera[c].camera;
        for (size_t v = 0; v < o->view_count; v++) seen += td_bundle_used(b, v, c) > 0;
        if (!seen) continue;
        status = td_first_estimate(&camera, pose, has_pose, o, c, TD_ESTIMATE_AUTO, true, error);
        td_pose rig_from_camera = td_pose_inverse(&b->rig->camera[c].camera_from_rig);
        for (size_t v = 0; v < o->view_count && status == TD_OK; v++) {
            if (!has_pose[v] || done[v]) continue;
            b->rig_from_target[b->pose_of_view[v]] = td_pose_compose(&rig_from_camera, &pose[v]);
            done[v] = true;
        }
    }
    for (size_t v = 0; v < o->view_count && status == TD_OK; v++)
        for (int c = 0; c < b->rig->count && !done[v]; c++) td_bundle_drop(b, v, c);
    free(pose);
    free(has_pose);
    free(done);
    return status;
}

td_status td_drift_views_make(td_drift_views *views, const td_rig *rig, const td_observations *observations,
                              td_error *error)
{
    *views = (td_drift_views){0};
    TD_TRY(match(&views->observations, rig, observations, error));
    TD_TRY(td_bundle_init(&views->bundle, views->observations, error));
    td_bundle *b = &views->bundle;
    for (int c = 0; c < rig->count; c++) {
        b->rig->camera[c] = rig->camera[c];
        b->hold[c] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION | TD_HOLD_POSE;
    }
    b->use_warp = warp_possible(views->observations);
    return start_poses(views, error);
}

void td_drift_views_free(td_drift_views *views)
{
    td_bundle_free(&views->bundle);
    td_observations_free(&views->observations);
}

/* Of marks the centroid of the disc's image is seen, not the image of its centre. */
static td_status shift_marks(td_bundle *b, td_error *error)
{
    const td_observations *o = b->observations;
    size_t points = td_target_point_count(&o->target), slots = td_bundle_index(b, o->view_count, 0, 0), first;
    if (o->target.kind != TD_TARGET_MARKS) return TD_OK;
    if (!b->shift) b->shift = calloc(2 * slots + 1, sizeof *b->shift);
    if (!b->shift) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu marks", slots);
    for (size_t i = 0; i < slots; i++) {
        size_t v = i / points / (size_t)b->rig->count, p = i % points;
        const td_rig_camera *camera = &b->rig->camera[i / points % (size_t)b->rig->count];
        if (!b->used[i]) continue;
        td_pose pose = td_pose_compose(&camera->camera_from_rig, &b->rig_from_target[b->pose_of_view[v]]);
        double centre[3], normal[3];
        const double z[3] = {0, 0, 1};
        td_bundle_target_point(centre, b, v, p);
        td_pose_rotate(normal, &o->target.plane[td_target_plane_of(&o->target, p, &first)].target_from_plane,
                       z);
        td_mark_bias(b->shift + 2 * i, &camera->camera, &pose, centre, normal, o->target.diameter_m);
    }
    return TD_OK;
}

static td_status fit_poses(td_bundle *b, td_error *error)
{
    TD_TRY(td_bundle_solve(b, NULL, NULL, NULL, error));
    if (b->observations->target.kind != TD_TARGET_MARKS) return TD_OK;
    TD_TRY(shift_marks(b, error));
    return td_bundle_solve(b, NULL, NULL, NULL, error);
}

/* ---- one point ---- */

bool td_drift_row_make(td_drift_row *row, const td_bundle *b, size_t view, int camera, size_t point)
{
    const td_observations *o = b->observations;
    const td_rig_camera *c = &b->rig->camera[camera];
    const td_pose *rig_from_target = &b->rig_from_target[b->pose_of_view[view]];
    size_t index = td_bundle_index(b, view, camera, point);
    if (!b->used[index] || !td_bundle_residual(row->r, b, view, camera, point)) return false;
    size_t count = (size_t)td_camera_parameter_count(c->camera.model);
    double p[3], x_rig[3], x[3], pixel[2], d_point[6], d_parameter[2 * TD_CAMERA_MAX_PARAMETERS], move[18],
        by_pose[12], rotation[9], by_rig[6], by_target[6], turn[9];
    td_bundle_target_point(p, b, view, point);
    td_pose_transform(x_rig, rig_from_target, p);
    td_pose_transform(x, &c->camera_from_rig, x_rig);
    if (!td_camera_project(pixel, d_point, d_parameter, &c->camera, x)) return false;
    td_pose_rotation(rotation, &c->camera_from_rig);
    td_multiply(by_rig, d_point, rotation, 2, 3, 3);
    td_pose_transform_jacobian(move, x);
    td_multiply(by_pose, d_point, move, 2, 3, 6);
    row->first = td_rig_parameter_offset(b->rig, camera);
    row->count = count + (camera ? 6 : 0);
    for (size_t i = 0; i < 2; i++) {
        memcpy(row->own[i], d_parameter + i * count, count * sizeof(double));
        memcpy(row->own[i] + count, by_pose + 6 * i, 6 * sizeof(double));
    }
    td_pose_transform_jacobian(move, x_rig);
    td_multiply(row->view[0], by_rig, move, 2, 3, 6);
    td_pose_rotation(rotation, rig_from_target);
    td_multiply(by_target, by_rig, rotation, 2, 3, 3);
    memcpy(row->point, by_target, sizeof row->point);
    memset(row->warp, 0, sizeof row->warp);
    if (b->use_warp) {
        /* The board's z by each part of the warp, as td_bundle_target_point has it: linear. */
        td_bundle flat = *b;
        for (int k = 0; k < 2; k++) {
            flat.warp[0] = b->warp[0] + (k == 0);
            flat.warp[1] = b->warp[1] + (k == 1);
            td_bundle_target_point(turn, &flat, view, point);
            for (int i = 0; i < 2; i++) row->warp[i][k] = by_target[3 * i + 2] * (turn[2] - p[2]);
        }
    }
    double s = b->own_sigma ? td_observations_get(o, view, camera)->sigma[point] : 0, n = b->noise[camera];
    row->variance = b->noise_share * (s * s + n * n);
    return true;
}

/* ---- normal equations ---- */

void td_drift_normal_free(td_drift_normal *normal)
{
    free(normal->a);
    free(normal->g);
    free(normal->scale);
    free(normal->seen);
    free(normal->inverse);
    free(normal->follow);
    free(normal->start);
    *normal = (td_drift_normal){0};
}

/* Sums over one pose. `all` is (m,m), `right` (m), m = n + 2: the rig, then the warp. */
typedef struct pose_sum {
    double own[36], right[6];
    double *by; /* (6,m) */
    size_t points;
} pose_sum;

static void add_row(double *all, double *right, double *scale, pose_sum *pose, const td_drift_row *row,
                    size_t n)
{
    size_t column[TD_DRIFT_OWN + 2], m = n + 2, k = row->count + 2;
    double j[2][TD_DRIFT_OWN + 2], w = 1 / row->variance;
    for (size_t i = 0; i < k; i++) {
        bool warp = i >= row->count;
        column[i] = warp ? n + i - row->count : row->first + i;
        for (int e = 0; e < 2; e++) j[e][i] = warp ? row->warp[e][i - row->count] : row->own[e][i];
    }
    for (int e = 0; e < 2; e++) {
        for (size_t a = 0; a < k; a++) {
            right[column[a]] += w * j[e][a] * row->r[e];
            if (a < row->count) scale[column[a]] += w * j[e][a] * j[e][a];
            for (size_t b = 0; b < k; b++) all[column[a] * m + column[b]] += w * j[e][a] * j[e][b];
            for (size_t b = 0; b < 6; b++) pose->by[b * m + column[a]] += w * row->view[e][b] * j[e][a];
        }
        for (size_t a = 0; a < 6; a++) {
            pose->right[a] += w * row->view[e][a] * row->r[e];
            for (size_t b = 0; b < 6; b++) pose->own[6 * a + b] += w * row->view[e][a] * row->view[e][b];
        }
    }
    pose->points++;
}

/* Lets the pose follow: all -= by^T own^-1 by, right -= by^T own^-1 pose.right. False when the points do not
 * determine it. */
static bool eliminate_pose(td_drift_normal *normal, double *all, double *right, const pose_sum *pose,
                           size_t index)
{
    size_t m = normal->n + 2;
    double *inverse = normal->inverse + 36 * index, *follow = normal->follow + 6 * m * index,
           *start = normal->start + 6 * index;
    if (pose->points < 4 || td_invert_spd(inverse, pose->own, 6, NULL) != TD_OK) return false;
    td_multiply(follow, inverse, pose->by, 6, 6, m);
    td_multiply(start, inverse, pose->right, 6, 6, 1);
    for (size_t i = 0; i < m; i++)
        for (size_t e = 0; e < 6; e++) {
            double by = pose->by[e * m + i];
            if (by == 0) continue;
            right[i] -= by * start[e];
            for (size_t k = 0; k < m; k++) all[i * m + k] -= by * follow[e * m + k];
        }
    normal->seen[index] = true;
    return true;
}

/* Lets the warp follow, and keeps what is left: the rig's. */
static void eliminate_warp(td_drift_normal *normal, const double *all, const double *right, bool use_warp)
{
    size_t n = normal->n, m = n + 2;
    double own[4] = {all[n * m + n], all[n * m + n + 1], all[(n + 1) * m + n], all[(n + 1) * m + n + 1]};
    bool follows = use_warp && td_invert_spd(own, own, 2, NULL) == TD_OK;
    for (size_t e = 0; e < 2 && follows; e++) {
        normal->warp_start[e] = own[2 * e] * right[n] + own[2 * e + 1] * right[n + 1];
        for (size_t k = 0; k < n; k++)
            normal->warp_follow[e * n + k] =
                own[2 * e] * all[n * m + k] + own[2 * e + 1] * all[(n + 1) * m + k];
    }
    for (size_t i = 0; i < n; i++) {
        normal->g[i] = right[i];
        for (size_t k = 0; k < n; k++) normal->a[i * n + k] = all[i * m + k];
        for (size_t e = 0; e < 2; e++) {
            normal->g[i] -= all[i * m + n + e] * normal->warp_start[e];
            for (size_t k = 0; k < n; k++)
                normal->a[i * n + k] -= all[i * m + n + e] * normal->warp_follow[e * n + k];
        }
    }
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < i; k++)
            normal->a[i * n + k] = normal->a[k * n + i] = (normal->a[i * n + k] + normal->a[k * n + i]) / 2;
    normal->nuisances += follows ? 2 : 0;
}

static bool sum_pose(td_drift_normal *normal, double *all, double *right, pose_sum *pose, const td_bundle *b,
                     unsigned cameras, size_t index)
{
    size_t n = normal->n, m = n + 2, points = td_target_point_count(&b->observations->target);
    td_drift_row row;
    *pose = (pose_sum){.by = pose->by};
    memset(pose->by, 0, 6 * m * sizeof *pose->by);
    for (size_t v = 0; v < b->observations->view_count; v++)
        for (int c = 0; c < b->rig->count; c++) {
            if (b->pose_of_view[v] != index || !(cameras >> c & 1)) continue;
            for (size_t p = 0; p < points; p++)
                if (td_drift_row_make(&row, b, v, c, p)) add_row(all, right, normal->scale, pose, &row, n);
        }
    return pose->points > 0;
}

td_status td_drift_normal_make(td_drift_normal *normal, const td_bundle *b, unsigned cameras, td_error *error)
{
    size_t n = td_rig_parameter_count(b->rig), m = n + 2, poses = b->pose_count;
    *normal = (td_drift_normal){.n = n};
    normal->a = calloc(n * n, sizeof(double));
    normal->g = calloc(n, sizeof(double));
    normal->scale = calloc(n, sizeof(double));
    normal->seen = calloc(poses + 1, sizeof(bool));
    normal->inverse = calloc(36 * poses + 1, sizeof(double));
    normal->follow = calloc(6 * m * poses + 1, sizeof(double));
    normal->start = calloc(6 * poses + 1, sizeof(double));
    double *all = calloc(2 * m * m + 8 * m, sizeof *all);
    if (!normal->a || !normal->g || !normal->scale || !normal->seen || !normal->inverse || !normal->follow ||
        !normal->start || !all) {
        free(all);
        td_drift_normal_free(normal);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    }
    double *one = all + m * m, *right = one + m * m, *one_right = right + m;
    pose_sum pose = {.by = one_right + m};
    for (size_t i = 0; i < poses; i++) {
        memset(one, 0, m * m * sizeof *one);
        memset(one_right, 0, m * sizeof *one_right);
        if (!sum_pose(normal, one, one_right, &pose, b, cameras, i)) continue;
        if (!eliminate_pose(normal, one, one_right, &pose, i)) continue;
        for (size_t k = 0; k < m * m; k++) all[k] += one[k];
        for (size_t k = 0; k < m; k++) right[k] += one_right[k];
        normal->rows += 2 * pose.points;
        normal->nuisances += 6;
    }
    eliminate_warp(normal, all, right, b->use_warp);
    free(all);
    return TD_OK;
}

void td_drift_row_follow(double *j, const td_drift_row *row, const td_drift_normal *normal, size_t pose)
{
    size_t n = normal->n, m = n + 2;
    const double *follow = normal->follow + 6 * m * pose;
    for (size_t e = 0; e < 2; e++) {
        double warp[2] = {row->warp[e][0], row->warp[e][1]}, *out = j + e * n;
        memset(out, 0, n * sizeof *out);
        memcpy(out + row->first, row->own[e], row->count * sizeof *out);
        for (size_t q = 0; q < 6; q++) {
            for (size_t k = 0; k < n; k++) out[k] -= row->view[e][q] * follow[q * m + k];
            for (size_t k = 0; k < 2; k++) warp[k] -= row->view[e][q] * follow[q * m + n + k];
        }
        for (size_t q = 0; q < 2; q++)
            for (size_t k = 0; k < n; k++) out[k] -= warp[q] * normal->warp_follow[q * n + k];
    }
}

/* ---- outliers and noise ---- */

/* How far each parameter may be expected to move at all, however badly a rig is knocked: it keeps the step
 * below finite along what the views leave open. */
static double reach(const td_rig *rig, int camera, size_t k)
{
    const td_rig_camera *c = &rig->camera[camera];
    size_t count = (size_t)td_camera_parameter_count(c->camera.model);
    if (k < 2) return 0.1 * c->camera.parameter[k];
    if (k < 4) return 0.1 * c->camera.width;
    if (k < count) return 1;
    return k < count + 3 ? 0.2 : 0.1 + 0.2 * td_pose_distance(&c->camera_from_rig);
}

/* The change of the rig that the views ask for. */
static td_status rig_step(double *step, const td_drift_normal *normal, const td_rig *rig, td_error *error)
{
    size_t n = normal->n;
    double *h = calloc(n * n + 2 * n, sizeof *h);
    if (!h) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    double *unit = h + n * n, *right = unit + n;
    for (int c = 0; c < rig->count; c++)
        for (size_t k = 0, first = td_rig_parameter_offset(rig, c);
             first + k < (c + 1 < rig->count ? td_rig_parameter_offset(rig, c + 1) : n); k++)
            unit[first + k] = reach(rig, c, k);
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < n; k++) h[i * n + k] = normal->a[i * n + k] * unit[i] * unit[k];
        h[i * (n + 1)] += 1;
        right[i] = -normal->g[i] * unit[i];
    }
    td_status status = td_invert_spd(h, h, n, error);
    if (status == TD_OK) td_multiply(step, h, right, n, n, 1);
    for (size_t i = 0; i < n; i++) step[i] *= unit[i];
    free(h);
    return status;
}

/* Residuals when rig, warp and poses take that step, to first order: (slots,2), NaN where nothing is used;
 * and the share of their squares that the fitted parameters leave. */
static td_status left_over(double *rest, double *free_share, const td_bundle *b, td_error *error)
{
    td_drift_normal normal;
    td_drift_row row;
    size_t slots = td_bundle_index(b, b->observations->view_count, 0, 0);
    size_t points = td_target_point_count(&b->observations->target), n = td_rig_parameter_count(b->rig);
    double *step = calloc(4 * n, sizeof *step);
    if (!step) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu parameters", n);
    double *warp = step + n, *j = warp + n; /* the warp's two, then a row's derivative */
    td_status status = td_drift_normal_make(&normal, b, ~0u, error);
    if (status == TD_OK) status = rig_step(step, &normal, b->rig, error);
    for (size_t i = 0; i < slots && status == TD_OK; i++) {
        size_t view = i / points / (size_t)b->rig->count, pose = b->pose_of_view[view];
        int camera = (int)(i / points % (size_t)b->rig->count);
        rest[2 * i] = rest[2 * i + 1] = NAN;
        if (!normal.seen[pose] || !td_drift_row_make(&row, b, view, camera, i % points)) continue;
        td_drift_row_follow(j, &row, &normal, pose);
        for (size_t e = 0; e < 2; e++) {
            rest[2 * i + e] = row.r[e];
            for (size_t k = 0; k < n; k++) rest[2 * i + e] += j[e * n + k] * step[k];
        }
    }
    size_t fitted = normal.nuisances;
    for (size_t k = 0; k < n && status == TD_OK; k++) fitted += normal.scale[k] > 0;
    *free_share = fmax(1 - (double)fitted / (double)(normal.rows + 1), 0.1);
    td_drift_normal_free(&normal);
    free(step);
    return status;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median over the points [first, end) in use of a camera (-1: all), as the sigma of one coordinate. */
static double usual(const td_bundle *b, const double *rest, int camera, size_t first_view, size_t end_view,
                    double *work)
{
    size_t points = td_target_point_count(&b->observations->target), n = 0;
    for (size_t v = first_view; v < end_view; v++)
        for (int c = 0; c < b->rig->count; c++)
            for (size_t p = 0; p < points && (camera < 0 || c == camera); p++) {
                size_t i = td_bundle_index(b, v, c, p);
                if (b->used[i] && isfinite(rest[2 * i])) work[n++] = hypot(rest[2 * i], rest[2 * i + 1]);
            }
    qsort(work, n, sizeof *work, compare_doubles);
    return n ? work[n / 2] / RAYLEIGH_MEDIAN : NAN;
}

/* Takes out what does not fit, in a view of a camera whose usual residual is `noise`. */
static bool reject_in_view(td_bundle *b, const double *rest, size_t view, int camera, double noise,
                           double *work)
{
    size_t points = td_target_point_count(&b->observations->target), left = 0;
    double own = usual(b, rest, camera, view, view + 1, work);
    bool changed = false;
    if (isnan(own)) return false;
    for (size_t p = 0; p < points; p++) {
        size_t i = td_bundle_index(b, view, camera, p);
        if (!b->used[i]) continue;
        b->used[i] = hypot(rest[2 * i], rest[2 * i + 1]) <= POINT_SIGMAS * fmax(noise, own);
        changed |= !b->used[i];
        left += b->used[i];
    }
    if (own <= VIEW_TIMES * noise && left >= FEWEST_POINTS) return changed;
    for (int c = 0; c < b->rig->count; c++)
        if (c == camera || own > VIEW_TIMES * noise) td_bundle_drop(b, view, c);
    return true;
}

/* The noise common to a camera's points, such that sum r^2 / (sigma_i^2 + n^2) is the degrees of freedom that
 * are left, by bisection. */
static double common_noise(const td_bundle *b, const double *rest, int camera, double share)
{
    size_t points = td_target_point_count(&b->observations->target), n = 0;
    double low = 0, high = 0;
    for (int round = 0; round <= 60; round++) {
        double middle = (low + high) / 2, sum = 0;
        n = 0;
        for (size_t v = 0; v < b->observations->view_count; v++)
            for (size_t p = 0; p < points; p++) {
                size_t i = td_bundle_index(b, v, camera, p);
                if (!b->used[i] || !isfinite(rest[2 * i])) continue;
                double s = td_observations_get(b->observations, v, camera)->sigma[p];
                double r2 = rest[2 * i] * rest[2 * i] + rest[2 * i + 1] * rest[2 * i + 1];
                sum += round ? r2 / (s * s + middle) : r2;
                n++;
            }
        if (!round)
            high = sum;
        else
            *(sum > 2 * (double)n * share ? &low : &high) = middle;
    }
    return fmax(sqrt(high), LEAST_NOISE);
}

td_status td_drift_views_settle(td_drift_views *views, const td_drift_options *options, td_error *error)
{
    td_bundle *b = &views->bundle;
    size_t slots = td_bundle_index(b, b->observations->view_count, 0, 0), used = 0;
    double *rest = malloc((3 * slots + 1) * sizeof *rest), *work = rest + 2 * slots, share = 1;
    td_status status = rest ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", slots);
    for (int round = 0; round < ROUNDS && status == TD_OK; round++) {
        bool changed = false;
        if (!td_progress_report(options->progress, "fitting the views", (size_t)round, ROUNDS))
            status = td_fail(error, TD_ERROR_CANCELLED, "interrupted while fitting the views");
        if (status == TD_OK) status = fit_poses(b, error);
        if (status == TD_OK) status = left_over(rest, &share, b, error);
        for (int c = 0; c < b->rig->count && status == TD_OK; c++) {
            double noise = usual(b, rest, c, 0, b->observations->view_count, work);
            if (isnan(noise)) continue;
            for (size_t v = 0; v < b->observations->view_count; v++)
                if (reject_in_view(b, rest, v, c, fmax(noise, LEAST_NOISE), work)) changed = true;
            b->noise[c] = options->noise_px > 0 ? options->noise_px : common_noise(b, rest, c, share);
        }
        b->own_sigma = !(options->noise_px > 0);
        if (round >= 2 && !changed) break;
    }
    for (size_t i = 0; i < slots; i++) used += b->used[i];
    if (status == TD_OK) status = fit_poses(b, error);
    if (status == TD_OK && !used)
        status =
            td_fail(error, TD_ERROR_DATA, "no view is left: too few points of the target are seen in each");
    if (status == TD_OK) status = td_board_error_estimate(&views->board, b, error);
    free(rest);
    return status;
}
