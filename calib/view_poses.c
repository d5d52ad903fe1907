#include "calib/view_poses.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/bundle_internal.h"
#include "calib/unsure_lens_internal.h"
#include "core/linalg.h"

/* Points farther out than this many usual residuals are left out, where as many as this remain. */
#define OUTLIER 5.0
#define LEAST_NOISE 1e-3 /* px: below, it is rounding */
enum { ROUNDS = 3, KEEP = 8, FEWEST = 4 };

/* The rig's cameras as the observations see them, held. */
static td_status take_cameras(td_bundle *b, const td_rig *rig, td_error *error)
{
    const td_observations *o = b->observations;
    for (int c = 0; c < o->camera_count; c++) {
        int k = td_rig_find(rig, o->camera[c].name);
        if (k < 0)
            return td_fail(error, TD_ERROR_DATA, "the rig has no camera %s: names must agree",
                           o->camera[c].name);
        const td_camera *camera = &rig->camera[k].camera;
        if (o->camera[c].width &&
            (o->camera[c].width != camera->width || o->camera[c].height != camera->height))
            return td_fail(error, TD_ERROR_DATA,
                           "camera %s: its images are %dx%d px, the rig was calibrated at %dx%d px",
                           o->camera[c].name, o->camera[c].width, o->camera[c].height, camera->width,
                           camera->height);
        b->rig->camera[c] = rig->camera[k];
        b->hold[c] = TD_HOLD_INTRINSICS | TD_HOLD_DISTORTION | TD_HOLD_POSE;
    }
    /* The bundle counts poses from its first camera, the rig from its own. */
    td_pose rig_from_first = td_pose_inverse(&b->rig->camera[0].camera_from_rig);
    for (int c = 0; c < o->camera_count; c++)
        b->rig->camera[c].camera_from_rig =
            td_pose_compose(&b->rig->camera[c].camera_from_rig, &rig_from_first);
    return TD_OK;
}

static td_status start(td_bundle *b, bool *seen, td_error *error)
{
    const td_observations *o = b->observations;
    td_pose *pose = malloc((o->view_count + 1) * sizeof *pose);
    bool *has = calloc(o->view_count + 1, sizeof *has);
    td_status status = pose && has ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (int c = 0; c < o->camera_count && status == TD_OK; c++) {
        td_camera camera = b->rig->camera[c].camera;
        size_t found = 0;
        for (size_t v = 0; v < o->view_count; v++) found += td_observations_get(o, v, c)->found;
        if (!found) continue;
        status = td_first_estimate(&camera, pose, has, o, c, TD_ESTIMATE_AUTO, true, error);
        td_pose first_from_camera = td_pose_inverse(&b->rig->camera[c].camera_from_rig);
        for (size_t v = 0; v < o->view_count && status == TD_OK; v++) {
            if (!has[v] || seen[v]) continue;
            b->rig_from_target[b->pose_of_view[v]] = td_pose_compose(&first_from_camera, &pose[v]);
            seen[v] = true;
        }
    }
    free(pose);
    free(has);
    return status;
}

/* Sum of squares of a view's residuals in use. */
static double cost_of(const td_bundle *b, size_t view)
{
    size_t points = td_target_point_count(&b->observations->target);
    double sum = 0, r[2];
    for (int c = 0; c < b->rig->count; c++)
        for (size_t p = 0; p < points; p++) {
            if (!b->used[td_bundle_index(b, view, c, p)]) continue;
            if (!td_bundle_residual(r, b, view, c, p)) return INFINITY;
            sum += r[0] * r[0] + r[1] * r[1];
        }
    return sum;
}

/* A flat target tilted the other way about the line of sight looks nearly the same: the other minimum
 * (Schweighofer and Pinz 2006). */
static td_pose tilted_over(const td_pose *pose, const td_target *target)
{
    size_t points = td_target_point_count(target);
    double centre[3] = {0}, p[3], sight[3], normal[3], axis[3], length, dot = 0;
    const double z[3] = {0, 0, 1};
    for (size_t i = 0; i < points; i++) {
        td_target_point(p, target, i);
        for (int k = 0; k < 3; k++) centre[k] += p[k] / (double)points;
    }
    td_pose_transform(sight, pose, centre);
    length = sqrt(sight[0] * sight[0] + sight[1] * sight[1] + sight[2] * sight[2]);
    td_pose_rotate(normal, pose, z);
    for (int k = 0; k < 3; k++) dot += normal[k] * sight[k] / length;
    for (int k = 0; k < 3; k++) axis[k] = sight[k] / length * (dot < 0 ? -1 : 1);
    /* Half a turn about the line of sight takes the normal to its mirror image; half a turn back about the
     * normal keeps the target's points in their order. */
    double turn[3] = {axis[0] * 3.141592653589793, axis[1] * 3.141592653589793, axis[2] * 3.141592653589793};
    td_pose over = td_pose_identity(), spin = td_pose_identity();
    const double about_z[3] = {0, 0, 3.141592653589793};
    td_rotation_exp(over.q, turn);
    td_rotation_exp(spin.q, about_z);
    td_pose out = td_pose_compose(&over, pose);
    out = td_pose_compose(&out, &spin);
    td_pose_rotate(p, &out, centre);
    for (int k = 0; k < 3; k++) out.t[k] = sight[k] - p[k];
    return out;
}

static td_status fit_view(td_bundle *b, size_t view, td_error *error)
{
    td_pose *pose = &b->rig_from_target[b->pose_of_view[view]];
    TD_TRY(td_bundle_solve_view(b, view, NULL, error));
    if (!td_target_is_flat(&b->observations->target)) return TD_OK;
    td_pose best = *pose;
    double cost = cost_of(b, view);
    *pose = tilted_over(&best, &b->observations->target);
    if (td_bundle_solve_view(b, view, NULL, NULL) != TD_OK || !(cost_of(b, view) < cost)) *pose = best;
    return TD_OK;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Takes out a view's points that do not fit, unless too few would remain. */
static bool reject(td_bundle *b, size_t view, double *work)
{
    size_t points = td_target_point_count(&b->observations->target), n = 0, out = 0;
    double r[2];
    for (int c = 0; c < b->rig->count; c++)
        for (size_t p = 0; p < points; p++)
            if (b->used[td_bundle_index(b, view, c, p)] && td_bundle_residual(r, b, view, c, p))
                work[n++] = hypot(r[0], r[1]);
    qsort(work, n, sizeof *work, compare_doubles);
    double limit = n ? OUTLIER * fmax(work[n / 2] / 1.1774, LEAST_NOISE) : 0;
    for (size_t i = 0; i < n; i++) out += work[i] > limit;
    if (!out || n - out < KEEP) return false;
    for (int c = 0; c < b->rig->count; c++)
        for (size_t p = 0; p < points; p++) {
            uint8_t *used = &b->used[td_bundle_index(b, view, c, p)];
            if (*used && (!td_bundle_residual(r, b, view, c, p) || hypot(r[0], r[1]) > limit)) *used = 0;
        }
    return true;
}

/* The noise of a coordinate beyond the points' own sigma, such that chi-square is its degrees of freedom. */
static double common_noise(const td_bundle *b, const bool *seen)
{
    const td_observations *o = b->observations;
    size_t points = td_target_point_count(&o->target);
    double low = 0, high = 1e3, r[2];
    for (int round = 0; round < 60; round++) {
        double middle = (low + high) / 2, chi2 = 0, freedom = 0;
        for (size_t v = 0; v < o->view_count; v++) {
            if (!seen[v]) continue;
            freedom -= 6;
            for (int c = 0; c < b->rig->count; c++)
                for (size_t p = 0; p < points; p++) {
                    if (!b->used[td_bundle_index(b, v, c, p)] || !td_bundle_residual(r, b, v, c, p)) continue;
                    double s = td_observations_get(o, v, c)->sigma[p];
                    chi2 += (r[0] * r[0] + r[1] * r[1]) / (s * s + middle * middle);
                    freedom += 2;
                }
        }
        *(chi2 > freedom ? &low : &high) = middle;
    }
    return fmax(high, LEAST_NOISE);
}

static td_status covariances(td_view_pose *pose, td_bundle *b, td_error *error)
{
    td_bundle_problem problem;
    td_covariance *covariance = NULL;
    TD_TRY(td_bundle_problem_new(&problem, b, NULL, error));
    td_status status = td_problem_covariance(&covariance, problem.problem, NULL, 0, error);
    for (size_t v = 0; v < b->observations->view_count && status == TD_OK; v++) {
        int block = problem.blocks.view[b->pose_of_view[v]];
        if (pose[v].seen) status = td_covariance_get(pose[v].covariance, covariance, block, block, error);
    }
    td_covariance_free(&covariance);
    td_bundle_problem_free(&problem);
    return status;
}

static void count_points(td_view_pose *pose, const td_bundle *b, size_t view)
{
    size_t points = td_target_point_count(&b->observations->target);
    for (int c = 0; c < b->rig->count; c++) {
        const td_detection *d = td_observations_get(b->observations, view, c);
        for (size_t p = 0; p < points && d->found; p++) {
            if (!isfinite(d->point[2 * p])) continue;
            *(b->used[td_bundle_index(b, view, c, p)] ? &pose->points : &pose->outliers) += 1;
        }
    }
    pose->rms_px = pose->points ? sqrt(cost_of(b, view) / (double)pose->points) : NAN;
}

static td_status fit(td_view_pose *pose, double *bend, td_bundle *b, const td_rig *rig, td_error *error)
{
    const td_observations *o = b->observations;
    size_t views = 0, points = td_target_point_count(&o->target);
    bool *seen = calloc(o->view_count + 1, sizeof *seen);
    double *work = malloc((points * (size_t)o->camera_count + 1) * sizeof *work);
    td_status status = seen && work ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    if (status == TD_OK) status = take_cameras(b, rig, error);
    if (status == TD_OK) status = start(b, seen, error);
    for (size_t v = 0; v < o->view_count && status == TD_OK; v++) {
        for (int c = 0; c < o->camera_count && !seen[v]; c++) td_bundle_drop(b, v, c);
        for (int round = 0; round < ROUNDS && seen[v] && status == TD_OK; round++) {
            status = fit_view(b, v, error);
            if (status != TD_OK || !reject(b, v, work)) break;
        }
        count_points(&pose[v], b, v);
        pose[v].seen = seen[v] && pose[v].points >= FEWEST;
        views += pose[v].seen;
    }
    if (status == TD_OK && !views)
        status = td_fail(error, TD_ERROR_DATA, "no view shows enough of the target for a pose");
    for (int c = 0; c < o->camera_count && status == TD_OK; c++) b->noise[c] = common_noise(b, seen);
    b->own_sigma = true;
    if (status == TD_OK) status = covariances(pose, b, error);
    if (status == TD_OK && bend && !rig->covariance)
        status = td_unsure_lens_refine(pose, bend, b, b->noise[0], error);
    free(seen);
    free(work);
    return status;
}

/* bend: NULL where the lenses are as the rig says. */
static td_status find_poses(td_view_pose *pose, double *bend, const td_rig *rig,
                            const td_observations *observations, td_error *error)
{
    td_bundle b;
    for (size_t v = 0; v < observations->view_count; v++) pose[v] = (td_view_pose){.rms_px = NAN};
    TD_TRY(td_bundle_init(&b, observations, error));
    td_status status = fit(pose, bend, &b, rig, error);
    int k = td_rig_find(rig, observations->camera[0].name);
    for (size_t v = 0; v < observations->view_count && status == TD_OK; v++) {
        if (!pose[v].seen) continue;
        td_pose rig_from_first = td_pose_inverse(&rig->camera[k].camera_from_rig);
        double ad[36], moved[36];
        pose[v].rig_from_target = td_pose_compose(&rig_from_first, &b.rig_from_target[b.pose_of_view[v]]);
        td_pose_adjoint(ad, &rig_from_first);
        status = td_sandwich(moved, ad, pose[v].covariance, 6, 6, error);
        memcpy(pose[v].covariance, moved, sizeof moved);
    }
    td_bundle_free(&b);
    return status;
}

td_status td_view_poses(td_view_pose *pose, const td_rig *rig, const td_observations *observations,
                        td_error *error)
{
    return find_poses(pose, NULL, rig, observations, error);
}

td_status td_view_poses_unsure(td_view_pose *pose, double *bend, const td_rig *rig,
                               const td_observations *observations, td_error *error)
{
    double found = 0;
    td_status status = find_poses(pose, &found, rig, observations, error);
    if (bend) *bend = found;
    return status;
}
