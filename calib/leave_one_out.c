/* Leave-one-out: solve without a view, then ask how well the result explains it. With many views, groups of
 * them are held out, so that there are never more than MOST_FOLDS solves. */
#include <math.h>
#include <stdlib.h>

#include "calib/calibrate_internal.h"
#include "core/parallel.h"
#include "core/stereo.h"

enum { MOST_FOLDS = 30 };

typedef struct fold {
    td_status status;
    size_t views, points, scaled, flat_points;
    double square_sum, scale_sum, scale_square_sum, flat_square_sum;
} fold;

typedef struct folds_work {
    const td_bundle *bundle;
    const size_t *view; /* views that are in use */
    size_t view_count, fold_count;
    fold *fold;
} folds_work;

static double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Scale of the triangulated points y against the model x, for the best rotation (Umeyama 1991: trace(D
 * S)/var(x); the model is exact, so noise in y leaves it unbiased), by the rotation R already known from the
 * pose of the view. */
static void add_shape(fold *f, const double *x, const double *y, size_t n)
{
    double mx[3] = {0}, my[3] = {0}, xy = 0, xx = 0;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            mx[k] += x[3 * i + k] / (double)n;
            my[k] += y[3 * i + k] / (double)n;
        }
    for (size_t i = 0; i < n; i++) {
        double a[3], b[3];
        for (int k = 0; k < 3; k++) {
            a[k] = x[3 * i + k] - mx[k];
            b[k] = y[3 * i + k] - my[k];
        }
        xy += dot3(a, b);
        xx += dot3(a, a);
    }
    double scale = xy / xx - 1;
    f->scaled++;
    f->scale_sum += scale;
    f->scale_square_sum += scale * scale;
}

/* Triangulates a held-out view with the first camera that shares points with it and each further one. */
static void measure_shape(fold *f, const td_bundle *b, size_t view)
{
    const td_observations *o = b->observations;
    size_t points = td_target_point_count(&o->target), n = 0;
    double *x = malloc(6 * points * sizeof *x);
    if (!x) return;
    double *y = x + 3 * points;
    const td_rig_camera *first = &b->rig->camera[0];
    for (int c = 1; c < b->rig->count; c++) {
        const td_rig_camera *second = &b->rig->camera[c];
        n = 0;
        for (size_t p = 0; p < points; p++) {
            if (!b->used[td_bundle_index(b, view, 0, p)] || !b->used[td_bundle_index(b, view, c, p)])
                continue;
            if (!td_triangulate_pair(y + 3 * n, &first->camera, &second->camera, &second->camera_from_rig,
                                     td_observations_get(o, view, 0)->point + 2 * p,
                                     td_observations_get(o, view, c)->point + 2 * p))
                continue;
            /* Into the target's frame, where the model is; pose and points are from the same images. */
            td_bundle_target_point(x + 3 * n, b, view, p);
            td_pose target_from_rig = td_pose_inverse(&b->rig_from_target[b->pose_of_view[view]]);
            td_pose_transform(y + 3 * n, &target_from_rig, y + 3 * n);
            double d = y[3 * n + 2] - x[3 * n + 2];
            f->flat_square_sum += d * d;
            f->flat_points++;
            n++;
        }
        if (n >= 4) {
            add_shape(f, x, y, n);
            break;
        }
    }
    free(x);
}

static void restore_view(td_bundle *copy, const td_bundle *from, size_t view)
{
    size_t points = td_target_point_count(&from->observations->target);
    for (int c = 0; c < from->rig->count; c++)
        for (size_t p = 0; p < points; p++)
            copy->used[td_bundle_index(from, view, c, p)] = from->used[td_bundle_index(from, view, c, p)];
}

static void run_fold(size_t index, void *user)
{
    folds_work *work = user;
    fold *f = &work->fold[index];
    td_bundle b;
    td_error error;
    f->status = td_bundle_copy(&b, work->bundle, &error);
    if (f->status != TD_OK) return;
    td_solve_options solve = td_solve_options_default();
    solve.function_tolerance = 1e-10;
    for (size_t i = index; i < work->view_count; i += work->fold_count)
        for (int c = 0; c < b.rig->count; c++) td_bundle_drop(&b, work->view[i], c);
    f->status = td_bundle_solve(&b, NULL, NULL, &solve, &error);
    for (size_t i = index; i < work->view_count && f->status == TD_OK; i += work->fold_count) {
        size_t v = work->view[i];
        restore_view(&b, work->bundle, v);
        f->status = td_bundle_solve_view(&b, v, NULL, &error);
        size_t points = td_target_point_count(&b.observations->target);
        double r[2];
        for (int c = 0; c < b.rig->count; c++)
            for (size_t p = 0; p < points; p++) {
                if (!b.used[td_bundle_index(&b, v, c, p)] || !td_bundle_residual(r, &b, v, c, p)) continue;
                f->square_sum += r[0] * r[0] + r[1] * r[1];
                f->points++;
            }
        f->views++;
        measure_shape(f, &b, v);
    }
    td_bundle_free(&b);
}

/* Views of their own pose; those on a rail share one and are never held out. */
static size_t candidate_views(size_t *view, const td_bundle *bundle)
{
    size_t n = 0;
    for (size_t v = 0; v < bundle->observations->view_count; v++) {
        size_t used = 0;
        for (int c = 0; c < bundle->rig->count; c++) used += td_bundle_used(bundle, v, c);
        if (used >= 4 && isnan(bundle->observations->height_m[v])) view[n++] = v;
    }
    return n;
}

td_status td_leave_one_out_run(td_leave_one_out *result, const td_bundle *bundle,
                               const td_calibrate_options *options, td_error *error)
{
    *result =
        (td_leave_one_out){.rms_px = NAN, .scale_error = NAN, .scale_error_rms = NAN, .flatness_m = NAN};
    size_t *view = malloc((bundle->observations->view_count + 1) * sizeof *view);
    fold folds[MOST_FOLDS] = {0};
    if (!view)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", bundle->observations->view_count);
    folds_work work = {.bundle = bundle, .view = view, .fold = folds};
    work.view_count = candidate_views(view, bundle);
    work.fold_count = work.view_count < MOST_FOLDS ? work.view_count : MOST_FOLDS;
    td_status status = TD_OK;
    if (work.view_count >= 4)
        status = td_parallel_for(work.fold_count, options->threads, run_fold, &work, options->progress,
                                 "leaving views out in turn");
    else
        work.fold_count = 0;
    free(view);
    if (status != TD_OK) return td_fail(error, status, "interrupted while leaving views out");

    fold sum = {0};
    for (size_t i = 0; i < work.fold_count; i++) {
        if (folds[i].status != TD_OK) continue; /* too few views left in this fold */
        sum.views += folds[i].views;
        sum.points += folds[i].points;
        sum.square_sum += folds[i].square_sum;
        sum.scaled += folds[i].scaled;
        sum.scale_sum += folds[i].scale_sum;
        sum.scale_square_sum += folds[i].scale_square_sum;
        sum.flat_points += folds[i].flat_points;
        sum.flat_square_sum += folds[i].flat_square_sum;
    }
    result->views = sum.views;
    result->folds = work.fold_count;
    if (sum.points) result->rms_px = sqrt(sum.square_sum / (double)sum.points);
    if (sum.scaled) {
        result->scale_error = sum.scale_sum / (double)sum.scaled;
        result->scale_error_rms = sqrt(sum.scale_square_sum / (double)sum.scaled);
    }
    if (sum.flat_points) result->flatness_m = sqrt(sum.flat_square_sum / (double)sum.flat_points);
    return TD_OK;
}
