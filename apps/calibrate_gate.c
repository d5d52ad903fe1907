#include <math.h>
#include <stdio.h>
#include <string.h>

#include "apps/calibrate_internal.h"

const gate_row calibrate_gate_defaults[] = {
    {"rms_px", 0.5, 1.0, "residual of each camera; a good board and lens give 0.1 to 0.4 px"},
    {"epipolar_error_px", 0.6, 1.2,
     "distances to both epipolar lines, added; matching needs rows right to a pixel"},
    {"leave_one_out_ratio", 1.4, 2.0,
     "residual of held-out views over that of used ones; above, the model is overfitted"},
    {"outlier_share", 0.1, 0.3, "points left out over points seen"},
    {"weak", 0.7, 1.0,
     "severity of the worst weak direction; 1: focal length, centre or baseline known to 2 %"},
    {"projected_px", 0.5, 1.5,
     "sigma of a projected point over the images, at the boards' middle distance: what the noise alone "
     "leaves open"},
    {"baseline_sigmas", 2.0, 3.0, "distance from the expected baseline over tolerance and sigma"},
};
const size_t calibrate_gate_count = sizeof calibrate_gate_defaults / sizeof *calibrate_gate_defaults;

static void judge_cameras(gate_result *g, const gate_row *rows, const td_calibration *c)
{
    for (int i = 0; i < c->rig->count; i++) {
        const td_calibrated_camera *camera = &c->camera[i];
        const char *name = c->rig->camera[i].name;
        size_t seen = camera->points + camera->outlier_points;
        double share = seen ? (double)camera->outlier_points / (double)seen : 1;
        gate_check(g, rows, calibrate_gate_count, "rms_px", camera->rms_px,
                   "%s: the residual is %.2f px RMS; look for blur, a bent board or a wrong lens model", name,
                   camera->rms_px);
        gate_check(g, rows, calibrate_gate_count, "outlier_share", share,
                   "%s: %.0f %% of the points were left out as outliers", name, 100 * share);
        if (camera->views < 8)
            gate_add(g, VERDICT_WARNED,
                     "%s: %zu views were used; 10 or more, spread over the image, give a firmer result", name,
                     camera->views);
    }
}

static void judge_baseline(gate_result *g, const gate_row *rows, const td_dataset *dataset,
                           const td_calibration *c)
{
    if (!dataset || isnan(dataset->expected_baseline_m) || !c->pair_count) return;
    const td_calibrated_pair *p = &c->pair[0];
    double off = p->baseline_m - dataset->expected_baseline_m;
    double scale =
        hypot(dataset->expected_tolerance_m / 2, isfinite(p->sigma_baseline_m) ? p->sigma_baseline_m : 0);
    gate_check(g, rows, calibrate_gate_count, "baseline_sigmas", fabs(off) / scale,
               "the baseline comes out as %.2f mm, %.2f mm was expected: if the tape is right, spacing_m "
               "should be %.5g "
               "instead of %.5g",
               1e3 * p->baseline_m, 1e3 * dataset->expected_baseline_m,
               dataset->target.plane[0].spacing_m * dataset->expected_baseline_m / p->baseline_m,
               dataset->target.plane[0].spacing_m);
}

static void judge_views(gate_result *g, const td_observations *o, const td_calibration *c)
{
    size_t missed = 0, seen_views = 0;
    for (size_t v = 0; v < c->view_count; v++) {
        if (c->view[v].remark[0])
            gate_add(g, VERDICT_WARNED, "view %s: %s", o->view_name[v], c->view[v].remark);
        bool any = false;
        for (int k = 0; k < o->camera_count; k++) {
            const td_detection *d = td_observations_get(o, v, k);
            any |= d->found;
            if (!d->found && d->reason[0] && missed++ < 5)
                gate_add(g, VERDICT_ACCEPTED, "view %s, %s: not used, %s", o->view_name[v], o->camera[k].name,
                         d->reason);
        }
        seen_views += any;
    }
    if (missed > 5)
        gate_add(g, VERDICT_ACCEPTED, "and %zu more images without the target (see result.yaml)", missed - 5);
    if (c->view_count && seen_views * 2 < c->view_count)
        gate_add(g, VERDICT_WARNED, "the target was found in %zu of %zu views only", seen_views,
                 c->view_count);
}

/* Blur of each image against the camera's median. */
static void judge_blur(gate_result *g, const td_observations *o, const td_calibration *c)
{
    for (int k = 0; k < o->camera_count; k++) {
        double sum = 0;
        size_t n = 0;
        for (size_t v = 0; v < o->view_count; v++) {
            const td_detection *d = td_observations_get(o, v, k);
            if (d->found && isfinite(d->blur_px)) sum += log(d->blur_px), n++;
        }
        if (n < 3) continue;
        double usual = exp(sum / (double)n);
        for (size_t v = 0; v < o->view_count; v++) {
            const td_detection *d = td_observations_get(o, v, k);
            if (d->found && d->blur_px > 2 * usual && d->blur_px > 1.5)
                gate_add(
                    g, VERDICT_WARNED,
                    "view %s, %s: blurred (edges %.1f px wide, the others %.1f px); its points count less%s",
                    o->view_name[v], o->camera[k].name, d->blur_px, usual,
                    c->view[v].state == TD_VIEW_OUTLIER ? "" : ", take it again with the board at rest");
        }
    }
}

static void judge_trust(gate_result *g, const gate_row *rows, const calibrate_trust *t,
                        const td_calibration *c)
{
    const char *missing = "";
    for (int i = 0; i < c->rig->count && !*missing; i++) missing = t->coverage[i].missing;
    if (isfinite(t->projected_px))
        gate_check(g, rows, calibrate_gate_count, "projected_px", t->projected_px,
                   "a point %.2f m away is projected to %.2f px only; %s", t->middle_distance_m,
                   t->projected_px, *missing ? missing : "add views");
    for (int i = 0; i < c->rig->count; i++)
        if (t->has_choice[i] && t->choice[i].best != t->choice[i].present)
            gate_add(g, VERDICT_ACCEPTED, "%s", t->choice[i].text);
}

void calibrate_judge(gate_result *g, const gate_row *rows, const calibrate_job *job)
{
    const td_observations *o = job->observations;
    const td_calibration *c = job->calibration;
    *g = (gate_result){.verdict = VERDICT_ACCEPTED};
    for (size_t i = 0; i < c->weak_count; i++)
        gate_check(g, rows, calibrate_gate_count, "weak", c->weak[i].severity, "%s", c->weak[i].text);
    judge_cameras(g, rows, c);
    for (size_t i = 0; i < c->pair_count; i++)
        gate_check(g, rows, calibrate_gate_count, "epipolar_error_px", c->pair[i].epipolar_error_px,
                   "%s and %s: the epipolar error is %.2f px", c->rig->camera[0].name,
                   c->rig->camera[c->pair[i].second].name, c->pair[i].epipolar_error_px);
    if (c->leave_one_out.views)
        gate_check(g, rows, calibrate_gate_count, "leave_one_out_ratio", c->leave_one_out.rms_px / c->rms_px,
                   "views left out fit %.2f px RMS against %.2f px when used: the result leans on single "
                   "views; add more",
                   c->leave_one_out.rms_px, c->rms_px);
    judge_baseline(g, rows, job->dataset, c);
    judge_trust(g, rows, job->trust, c);
    judge_views(g, o, c);
    judge_blur(g, o, c);
    if (!c->covariance_known)
        gate_add(g, VERDICT_WARNED,
                 "what is held has no covariance (or is held in part), so rig.yaml carries none: sigmas here "
                 "take the held "
                 "values as exact");
}
