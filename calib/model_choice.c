#include "calib/model_choice.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/bundle_internal.h"
#include "core/parallel.h"

enum { MOST_FOLDS = 10, FEWEST_VIEWS = 4, FEWEST_POINTS = 12 };

/* What one camera alone saw, as the calibration used it. */
typedef struct mono {
    td_observations *observations; /* one camera; unused points are unseen */
    td_pose *camera_from_target;   /* (views) */
} mono;

typedef struct model_work {
    td_bundle bundle; /* fitted to all views */
    td_status status;
    double rms_px;
    double *square_sum; /* (views) of held-out residuals, px^2 */
    size_t *count;      /* (views) */
    td_status fold[MOST_FOLDS];
} model_work;

typedef struct choice_work {
    int camera;
    const td_calibration *calibration;
    const td_calibrate_options *options;
    const mono *mono;
    size_t *view, view_count, folds; /* views with points */
    model_work model[TD_CAMERA_MODEL_COUNT];
} choice_work;

/* A point as the calibration took it: its projection less its residual. Numbering that was put right, and the
 * marks' bias, are then in it. */
static bool point_in_use(double pixel[2], const td_calibration *c, int camera, const td_observations *o,
                         size_t view, size_t point)
{
    size_t index =
        (view * (size_t)o->camera_count + (size_t)camera) * td_target_point_count(&o->target) + point;
    const double *r = c->residual + 2 * index;
    if (!c->used[index] || !isfinite(r[0]) || !isfinite(r[1])) return false;
    const td_bundle as_it_was = {
        .observations = o, .use_warp = c->has_warp, .warp = {c->warp_m[0], c->warp_m[1]}};
    double p[3];
    td_bundle_target_point(p, &as_it_was, view, point);
    td_pose_transform(p, &c->view[view].rig_from_target, p);
    td_pose_transform(p, &c->rig->camera[camera].camera_from_rig, p);
    if (!td_camera_project(pixel, NULL, NULL, &c->rig->camera[camera].camera, p)) return false;
    pixel[0] -= r[0];
    pixel[1] -= r[1];
    return true;
}

/* Sigma of a point; where a view was numbered anew the mean of its sigmas, since they are numbered as seen.
 */
static double sigma_of(const td_detection *d, size_t point, bool renumbered)
{
    if (!renumbered) return d->sigma[point];
    double sum = 0;
    size_t n = 0;
    for (size_t p = 0; p < d->count; p++)
        if (isfinite(d->point[2 * p])) sum += d->sigma[p], n++;
    return n ? sum / (double)n : 0;
}

static td_status mono_make(mono *m, int camera, const td_calibration *c, const td_observations *o,
                           td_error *error)
{
    TD_TRY(td_observations_new(&m->observations, &o->target, 1, o->view_count, error));
    m->camera_from_target = malloc((o->view_count + 1) * sizeof *m->camera_from_target);
    if (!m->camera_from_target)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", o->view_count);
    m->observations->camera[0] = o->camera[camera];
    memcpy(m->observations->height_m, o->height_m, o->view_count * sizeof *o->height_m);
    for (size_t v = 0; v < o->view_count; v++) {
        const td_detection *from = td_observations_get(o, v, camera);
        td_detection *d = td_observations_get(m->observations, v, 0);
        m->camera_from_target[v] =
            td_pose_compose(&c->rig->camera[camera].camera_from_rig, &c->view[v].rig_from_target);
        for (size_t p = 0; p < d->count; p++) {
            double pixel[2];
            if (!point_in_use(pixel, c, camera, o, v, p)) continue;
            memcpy(d->point + 2 * p, pixel, sizeof pixel);
            d->sigma[p] = sigma_of(from, p, c->view[v].state == TD_VIEW_CORRECTED);
            d->found = true;
        }
    }
    return TD_OK;
}

/* Solves from the given camera and poses; the RMS over all points. */
static double solve_from(td_bundle *b, const td_camera *camera, const td_pose *pose)
{
    td_solve_options solve = td_solve_options_default();
    solve.function_tolerance = 1e-9;
    b->rig->camera[0].camera = *camera;
    for (size_t v = 0; v < b->observations->view_count; v++)
        if (td_bundle_used(b, v, 0)) b->rig_from_target[b->pose_of_view[v]] = pose[v];
    size_t points;
    if (td_bundle_solve(b, NULL, NULL, &solve, NULL) != TD_OK) return INFINITY;
    if (td_camera_check(&b->rig->camera[0].camera, NULL) != TD_OK) return INFINITY;
    return sqrt(td_bundle_square_sum(b, 0, &points) / (double)(points ? points : 1));
}

/* Fits one model to all views, from the present calibration and from a first estimate of its own: neither is
 * always near when models differ as much as a pinhole and a fisheye. */
static void fit_model(size_t index, void *user)
{
    choice_work *work = user;
    model_work *m = &work->model[index];
    const td_observations *o = work->mono->observations;
    const td_camera *present = &work->calibration->rig->camera[work->camera].camera;
    td_camera start = {.model = (td_camera_model)index, .width = present->width, .height = present->height};
    td_camera estimate = start;
    td_pose *pose = malloc((o->view_count + 1) * sizeof *pose);
    bool *has_pose = malloc((o->view_count + 1) * sizeof *has_pose);
    td_bundle second = {0};
    m->status = pose && has_pose ? td_bundle_init(&m->bundle, o, NULL) : TD_ERROR_MEMORY;
    if (m->status == TD_OK) {
        td_bundle *b = &m->bundle;
        b->rig->camera[0].camera = start;
        b->own_sigma = !work->options->plain;
        b->noise[0] = work->calibration->camera[work->camera].noise_px;
        b->use_warp = work->calibration->has_warp;
        memcpy(b->warp, work->calibration->warp_m, sizeof b->warp);
        m->status = td_bundle_copy(&second, b, NULL);
    }
    if (m->status == TD_OK) {
        memcpy(start.parameter, present->parameter,
               (start.model == present->model ? 12 : 4) * sizeof(double));
        m->rms_px = solve_from(&m->bundle, &start, work->mono->camera_from_target);
        double other = INFINITY;
        if (start.model != present->model &&
            td_first_estimate(&estimate, pose, has_pose, o, 0, TD_ESTIMATE_AUTO, false, NULL) == TD_OK)
            other = solve_from(&second, &estimate, pose);
        if (other < m->rms_px) {
            td_bundle kept = m->bundle;
            m->bundle = second, second = kept;
            m->rms_px = other;
        }
        if (!isfinite(m->rms_px)) m->status = TD_ERROR_DATA;
    }
    td_bundle_free(&second);
    free(has_pose);
    free(pose);
}

/* Adds a view's squared residuals over its points whose rank in the view is `half` modulo 2 (-1: all). */
static bool add_residuals(model_work *m, const td_bundle *b, const uint8_t *points, size_t view, int half)
{
    size_t count = td_target_point_count(&b->observations->target), rank = 0;
    double r[2];
    for (size_t p = 0; p < count; p++) {
        if (!points[p]) continue;
        if (half >= 0 && (int)(rank++ % 2) != half) continue;
        if (!td_bundle_residual(r, b, view, 0, p)) return false;
        m->square_sum[view] += r[0] * r[0] + r[1] * r[1];
        m->count[view]++;
    }
    return true;
}

/* A held-out view needs a pose, which only its own points can give. Every second point fits it and the others
 * judge, then the other way round: no residual helps to shape what it judges, so that the figure is an error
 * of prediction. (Judged on the points that fitted the pose it would come out smaller, by the 6 parameters of
 * the pose, and the smaller the fewer points a view has.) */
static bool judge_view(model_work *m, td_bundle *b, size_t view)
{
    size_t count = td_target_point_count(&b->observations->target);
    const uint8_t *points = m->bundle.used + td_bundle_index(b, view, 0, 0);
    uint8_t *used = b->used + td_bundle_index(b, view, 0, 0);
    if (!isnan(b->observations->height_m[view])) return add_residuals(m, b, points, view, -1);
    td_pose start = b->rig_from_target[b->pose_of_view[view]];
    for (int half = 0; half < 2; half++) {
        size_t rank = 0;
        for (size_t p = 0; p < count; p++) used[p] = points[p] && (int)(rank++ % 2) != half;
        b->rig_from_target[b->pose_of_view[view]] = start;
        if (td_bundle_solve_view(b, view, NULL, NULL) != TD_OK) return false;
        if (!add_residuals(m, b, points, view, half)) return false;
    }
    return true;
}

static void run_fold(size_t index, void *user)
{
    choice_work *work = user;
    model_work *m = &work->model[index / work->folds];
    size_t fold = index % work->folds;
    td_bundle b;
    if (m->status != TD_OK) return;
    m->fold[fold] = td_bundle_copy(&b, &m->bundle, NULL);
    if (m->fold[fold] != TD_OK) return;
    td_solve_options solve = td_solve_options_default();
    solve.function_tolerance = 1e-6;
    for (size_t i = fold; i < work->view_count; i += work->folds) td_bundle_drop(&b, work->view[i], 0);
    m->fold[fold] = td_bundle_solve(&b, NULL, NULL, &solve, NULL);
    for (size_t i = fold; i < work->view_count && m->fold[fold] == TD_OK; i += work->folds)
        if (!judge_view(m, &b, work->view[i])) m->fold[fold] = TD_ERROR_DATA;
    td_bundle_free(&b);
}

/* Standard error over the views of the difference of two models' held-out RMS: a view's influence on sqrt(sum
 * s / sum n) is (s - n rms^2) / (2 N rms) (the delta method; paired, so that what makes a view bad for both
 * cancels). */
static double paired_error(const choice_work *work, const td_model_choice *choice, int a, int b)
{
    double rms[2] = {choice->score[a].held_out_px, choice->score[b].held_out_px}, sum = 0, points = 0;
    const model_work *m[2] = {&work->model[a], &work->model[b]};
    for (size_t i = 0; i < work->view_count; i++) points += (double)m[0]->count[work->view[i]];
    for (size_t i = 0; i < work->view_count; i++) {
        double influence[2];
        for (int k = 0; k < 2; k++) {
            double n = (double)m[k]->count[work->view[i]];
            influence[k] =
                (m[k]->square_sum[work->view[i]] - n * rms[k] * rms[k]) / (2 * points * fmax(rms[k], 1e-12));
        }
        sum += (influence[0] - influence[1]) * (influence[0] - influence[1]);
    }
    double views = (double)work->view_count;
    return sqrt(sum * views / (views - 1));
}

/* Pinhole, then Brown's five terms and the fisheye's four (neither contains the other, and one parameter's
 * difference orders nothing), then Brown's eight. */
static int complexity(td_camera_model model)
{
    static const int order[TD_CAMERA_MODEL_COUNT] = {0, 1, 2, 1};
    return order[model];
}

/* The simplest within one standard error of the least (Breiman, Friedman, Olshen and Stone 1984, section
 * 3.4.3); of two as simple, the better one. */
static td_camera_model choose(const choice_work *work, const td_model_choice *choice)
{
    int least = -1, best = -1;
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        if (!choice->score[i].failed &&
            (least < 0 || choice->score[i].held_out_px < choice->score[least].held_out_px))
            least = i;
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT && least >= 0; i++) {
        const td_model_score *s = &choice->score[i];
        if (s->failed) continue;
        double above = s->held_out_px - choice->score[least].held_out_px;
        if (i != least && above > paired_error(work, choice, i, least)) continue;
        if (best >= 0) {
            int more = complexity(s->model) - complexity((td_camera_model)best);
            if (more > 0 ||
                (more == 0 && above > choice->score[best].held_out_px - choice->score[least].held_out_px))
                continue;
        }
        best = i;
    }
    return best < 0 ? choice->present : (td_camera_model)best;
}

/* Compares with the present model; where that is kept, with the best of the more complex ones. */
static void write_text(td_model_choice *choice, const char *name)
{
    const td_model_score *best = &choice->score[choice->best], *other = &choice->score[choice->present];
    if (choice->best == choice->present) {
        other = NULL;
        for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++) {
            const td_model_score *s = &choice->score[i];
            if (s->failed || s->model == choice->best || complexity(s->model) < complexity(choice->best))
                continue;
            if (!other || s->held_out_px < other->held_out_px) other = s;
        }
    }
    const char *model = td_camera_model_name(choice->best);
    if (!other)
        snprintf(choice->text, sizeof choice->text,
                 "%s: %s is right: simpler models predict held-out views worse than its %.3f px", name, model,
                 best->held_out_px);
    else if (other->failed)
        snprintf(choice->text, sizeof choice->text,
                 "%s: %s predicts held-out views to %.3f px, %s cannot be fitted", name, model,
                 best->held_out_px, td_camera_model_name(other->model));
    else if (choice->best == choice->present || complexity(best->model) < complexity(other->model))
        snprintf(
            choice->text, sizeof choice->text,
            "%s: %s is enough: %s predicts held-out views no better (%.3f px against %.3f px, difference ± "
            "%.2g px)",
            name, model, td_camera_model_name(other->model), other->held_out_px, best->held_out_px,
            other->sigma_px);
    else
        snprintf(
            choice->text, sizeof choice->text,
            "%s: %s predicts held-out views better than %s (%.3f px against %.3f px, difference ± %.2g px): "
            "calibrate with %s",
            name, model, td_camera_model_name(other->model), best->held_out_px, other->held_out_px,
            other->sigma_px, model);
}

static td_status run(choice_work *work, td_model_choice *choice, const char *name, td_error *error)
{
    size_t views = work->mono->observations->view_count;
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++) {
        work->model[i].square_sum = calloc(views + 1, sizeof(double));
        work->model[i].count = calloc(views + 1, sizeof(size_t));
        if (!work->model[i].square_sum || !work->model[i].count)
            return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu views", views);
    }
    td_status status = td_parallel_for(TD_CAMERA_MODEL_COUNT, work->options->threads, fit_model, work,
                                       work->options->progress, "fitting other lens models");
    if (status == TD_OK)
        status = td_parallel_for(TD_CAMERA_MODEL_COUNT * work->folds, work->options->threads, run_fold, work,
                                 work->options->progress, "comparing lens models");
    if (status != TD_OK) return td_fail(error, status, "interrupted while comparing lens models");
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++) {
        const model_work *m = &work->model[i];
        td_model_score *s = &choice->score[i];
        double sum = 0, count = 0;
        s->failed = m->status != TD_OK;
        for (size_t f = 0; f < work->folds; f++) s->failed |= m->fold[f] != TD_OK;
        if (s->failed) continue;
        for (size_t k = 0; k < work->view_count; k++) {
            sum += m->square_sum[work->view[k]];
            count += (double)m->count[work->view[k]];
        }
        s->rms_px = m->rms_px;
        s->held_out_px = sqrt(sum / count);
    }
    choice->best = choose(work, choice);
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        if (!choice->score[i].failed && !choice->score[choice->best].failed)
            choice->score[i].sigma_px = paired_error(work, choice, i, (int)choice->best);
    write_text(choice, name);
    return TD_OK;
}

td_status td_model_choice_make(td_model_choice *choice, int camera, const td_calibration *calibration,
                               const td_observations *observations, const td_calibrate_options *options,
                               td_error *error)
{
    const td_calibrate_options defaults = td_calibrate_options_default();
    const char *name = observations->camera[camera].name;
    mono m = {0};
    choice_work work = {
        .camera = camera, .calibration = calibration, .options = options ? options : &defaults, .mono = &m};
    td_camera_model present = calibration->rig->camera[camera].camera.model;
    *choice = (td_model_choice){.camera = camera, .present = present, .best = present};
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        choice->score[i] = (td_model_score){(td_camera_model)i, true, NAN, NAN, NAN};
    work.view = malloc((observations->view_count + 1) * sizeof *work.view);
    td_status status = work.view ? mono_make(&m, camera, calibration, observations, error)
                                 : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t v = 0; v < observations->view_count && status == TD_OK; v++)
        if (td_observations_seen(m.observations, v, 0) >= FEWEST_POINTS) work.view[work.view_count++] = v;
    work.folds = work.view_count < MOST_FOLDS ? work.view_count : MOST_FOLDS;
    if (status == TD_OK && work.view_count < FEWEST_VIEWS)
        status =
            td_fail(error, TD_ERROR_DATA,
                    "camera %s: lens models are compared over %d views or more with %d points or more each, "
                    "there are %zu",
                    name, FEWEST_VIEWS, FEWEST_POINTS, work.view_count);
    if (status == TD_OK) status = run(&work, choice, name, error);
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++) {
        td_bundle_free(&work.model[i].bundle);
        free(work.model[i].square_sum);
        free(work.model[i].count);
    }
    td_observations_free(&m.observations);
    free(m.camera_from_target);
    free(work.view);
    return status;
}
