/* Closed forms, refinement, mistakes, and the figures that judge them. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/hand_eye_internal.h"
#include "core/linalg.h"

/* Root mean square over the used views. */
static double over_views(const hand_eye_job *job, const double *value)
{
    double sum = 0;
    size_t n = 0;
    for (size_t v = 0; v < job->count; v++) {
        if (!job->result->view[v].used || isnan(value[v])) continue;
        sum += value[v] * value[v];
        n++;
    }
    return n ? sqrt(sum / (double)n) : NAN;
}

static void score_solvers(hand_eye_job *job)
{
    for (int s = 0; s < TD_SOLVER_COUNT; s++) {
        td_solver_score *score = &job->solver[s];
        double sum = 0;
        score->rms_px = NAN;
        if (!job->observations || isnan(score->scatter_mm)) continue;
        for (size_t v = 0; v < job->count; v++) {
            td_pose pose =
                td_hand_eye_predict(job->how->setup, &score->x, &score->z, &job->view[v].base_from_hand);
            sum += pow(hand_eye_view_rms(job, v, &pose), 2);
        }
        score->rms_px = sqrt(sum / (double)job->count);
    }
}

/* With X and Z exact, the held-out view would still be off by the noise of its own robot pose: the squares of
 * what one sigma along each axis does, added. */
static void measure_floor(hand_eye_job *job)
{
    const td_hand_eye *r = job->result;
    double *px = malloc((job->count + 1) * sizeof *px), mm = 0, deg = 0;
    job->floor_px = job->floor_mm = job->floor_deg = NAN;
    if (!px || r->model == TD_ROBOT_EXACT) {
        free(px);
        return;
    }
    for (size_t v = 0; v < job->count; v++) {
        td_pose there = td_hand_eye_predict(job->how->setup, &r->x, &r->z, &job->view[v].base_from_hand);
        td_pose inverse = td_pose_inverse(&there);
        px[v] = pow(hand_eye_view_rms(job, v, &job->view[v].rig_from_target), 2);
        double seen = px[v];
        for (int k = 0; k < 6; k++) {
            double xi[6] = {0};
            xi[k] = k < 3 ? r->robot_rad : r->robot_m;
            td_pose wrong = td_pose_exp(xi), hand = td_pose_compose(&job->view[v].base_from_hand, &wrong);
            td_pose moved = td_hand_eye_predict(job->how->setup, &r->x, &r->z, &hand);
            td_pose step = td_pose_compose(&inverse, &moved);
            mm += pow(1e3 * td_pose_distance(&step), 2);
            deg += pow(57.29577951308232 * td_pose_angle(&step), 2);
            /* The same step from where the target was seen: the residual beyond the points' own. */
            td_pose shifted = td_pose_compose(&job->view[v].rig_from_target, &step);
            px[v] += fmax(pow(hand_eye_view_rms(job, v, &shifted), 2) - seen, 0);
        }
        px[v] = sqrt(px[v]);
    }
    job->floor_mm = sqrt(mm / (double)job->count);
    job->floor_deg = sqrt(deg / (double)job->count);
    job->floor_px = over_views(job, px);
    free(px);
}

static td_status measure(hand_eye_job *job, td_error *error)
{
    job->rms_px = malloc((job->count + 1) * sizeof *job->rms_px);
    job->held_out_px = malloc((job->count + 1) * sizeof *job->held_out_px);
    if (!job->rms_px || !job->held_out_px) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t v = 0; v < job->count; v++) {
        job->rms_px[v] = hand_eye_view_rms(job, v, &job->result->view[v].predicted);
        job->held_out_px[v] =
            job->result->view[v].used ? hand_eye_view_rms(job, v, &job->result->view[v].held_out) : NAN;
    }
    job->total_rms_px = over_views(job, job->rms_px);
    job->total_held_out_px = over_views(job, job->held_out_px);
    measure_floor(job);
    return TD_OK;
}

/* Noise about the target's own axes: its rotation does not move it. */
static void set_pose_noise(hand_eye_job *job, double rad, double m)
{
    double own[36] = {0}, ad[36];
    for (int k = 0; k < 6; k++) own[7 * k] = k < 3 ? rad * rad : m * m;
    for (size_t v = 0; v < job->count; v++) {
        td_pose_adjoint(ad, &job->view[v].rig_from_target);
        td_sandwich(job->view[v].covariance, ad, own, 6, 6, NULL);
    }
}

/* Poses of a target that came without a covariance have noise of their own, at the cameras, which the
 * robot's, at the hand, cannot stand for: a target's rotation is seen less well than its place. The pair of a
 * coarse grid under which the data are likeliest is taken. */
static void find_pose_noise(hand_eye_job *job, const td_hand_eye_options *options)
{
    static const double rad[] = {2e-4, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3}, m[] = {1e-4, 5e-4, 1e-3, 2e-3, 4e-3};
    td_hand_eye_options o = *options;
    double best = -INFINITY, best_rad = rad[0], best_m = m[0];
    o.model = TD_ROBOT_INDEPENDENT;
    o.leave_one_out = false;
    o.outlier_sigma = 0;
    for (size_t i = 0; i < sizeof rad / sizeof *rad; i++)
        for (size_t k = 0; k < sizeof m / sizeof *m; k++) {
            td_hand_eye *r = NULL;
            set_pose_noise(job, rad[i], m[k]);
            if (td_hand_eye_solve(&r, job->view, job->count, &o, NULL) != TD_OK) continue;
            if (r->log_likelihood[TD_ROBOT_INDEPENDENT] > best) {
                best = r->log_likelihood[TD_ROBOT_INDEPENDENT];
                best_rad = rad[i];
                best_m = m[k];
            }
            td_hand_eye_free(&r);
        }
    set_pose_noise(job, best_rad, best_m);
    size_t used = strlen(job->rig_from);
    snprintf(job->rig_from + used, sizeof job->rig_from - used,
             "; their own noise is likeliest %.1f mm and %.2f degrees", 1e3 * best_m,
             57.29577951308232 * best_rad);
}

td_status hand_eye_solve(hand_eye_job *job, td_error *error)
{
    const hand_eye_how *how = job->how;
    job->total_rms_px = job->total_held_out_px = job->floor_px = job->floor_mm = job->floor_deg = NAN;
    job->mistake_count = td_hand_eye_mistakes(job->mistake, how->setup, job->view, job->count);
    TD_TRY(td_hand_eye_solvers_run(job->solver, how->setup, job->view, job->count, error));
    score_solvers(job);
    job->best = td_hand_eye_solvers_best(job->solver);
    td_hand_eye_options o = td_hand_eye_options_default(how->setup);
    td_pose start[2];
    if (job->best >= 0) {
        start[0] = job->solver[job->best].x;
        start[1] = job->solver[job->best].z;
        o.start = start;
    }
    o.model = how->model;
    o.outlier_sigma = how->outlier_sigma;
    o.threads = how->threads;
    o.progress = how->progress;
    o.log = how->log;
    if (!job->observations) find_pose_noise(job, &o);
    TD_TRY(td_hand_eye_solve(&job->result, job->view, job->count, &o, error));
    if (how->model != TD_ROBOT_EXACT) {
        o.model = TD_ROBOT_EXACT;
        o.leave_one_out = false;
        if (td_hand_eye_solve(&job->plain, job->view, job->count, &o, NULL) != TD_OK) job->plain = NULL;
    }
    if (how->advise) {
        TD_TRY(td_hand_eye_advise(&job->advice, job->result, job->view, job->count, error));
        job->has_advice = true;
    }
    return measure(job, error);
}

void hand_eye_free(hand_eye_job *job)
{
    td_observations_free(&job->observations);
    td_rig_free(&job->rig);
    free(job->view);
    free(job->source);
    free(job->rms_px);
    free(job->held_out_px);
    td_hand_eye_free(&job->result);
    td_hand_eye_free(&job->plain);
}
