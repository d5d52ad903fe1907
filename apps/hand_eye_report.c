/* A hand-eye calibration for people: the table on the terminal and the report. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/hand_eye_internal.h"
#include "core/report.h"
#include "core/rig_formats.h"

#define DEGREES 57.29577951308232

static void print_pose(const char *name, const td_pose *pose, double mm, double deg)
{
    double w[3];
    td_rotation_log(w, pose->q);
    printf("%-17s t (%.2f, %.2f, %.2f) mm ± %.2f, rotation (%.3f, %.3f, %.3f)° ± %.3f\n", name,
           1e3 * pose->t[0], 1e3 * pose->t[1], 1e3 * pose->t[2], mm, DEGREES * w[0], DEGREES * w[1],
           DEGREES * w[2], deg);
}

static void print_robot(const td_hand_eye *r)
{
    if (r->model == TD_ROBOT_EXACT) {
        printf("robot: taken as exact (plain least squares); sigmas are then too small, and X is bent\n");
        return;
    }
    printf("robot: noise at the hand %.3f mm, %.4f° per axis", 1e3 * r->robot_m, DEGREES * r->robot_rad);
    if (r->model == TD_ROBOT_FIELD)
        printf("; smooth error %.3f mm, %.4f° over %.2f m", 1e3 * r->field_m, DEGREES * r->field_rad,
               r->field_length_m);
    putchar('\n');
}

void hand_eye_table(const hand_eye_job *job)
{
    const td_hand_eye *r = job->result;
    printf("\ncameras: %s\n\n%-12s %9s %12s %13s\n", job->rig_from, "closed form", "RMS px", "scatter mm",
           "scatter deg");
    for (int i = 0; i < TD_SOLVER_COUNT; i++) {
        const td_solver_score *s = &job->solver[i];
        printf("%-12s %9.3f %12.3f %13.3f  %s%s\n", td_hand_eye_solver_name(s->solver), s->rms_px,
               s->scatter_mm, s->scatter_deg,
               i == job->best ? "best"
               : s->failed    ? "failed: "
                              : "",
               s->why);
    }
    putchar('\n');
    print_pose(td_hand_eye_x_name(r->setup), &r->x, r->sigma_x_mm, r->sigma_x_deg);
    print_pose(td_hand_eye_z_name(r->setup), &r->z, r->sigma_z_mm, r->sigma_z_deg);
    print_robot(r);
    if (job->plain) {
        td_pose inverse = td_pose_inverse(&r->x), apart = td_pose_compose(&inverse, &job->plain->x);
        printf("plain least squares would put %s %.2f mm and %.3f° elsewhere\n", td_hand_eye_x_name(r->setup),
               1e3 * td_pose_distance(&apart), DEGREES * td_pose_angle(&apart));
    }
    if (job->has_offset) printf("time offset: %+.4f ± %.4f s\n", job->offset_s, job->sigma_offset_s);
    printf("%zu of %zu views used", r->used, r->view_count);
    if (isfinite(job->total_rms_px)) printf(", RMS %.3f px", job->total_rms_px);
    printf("; left out in turn: ");
    if (isfinite(job->total_held_out_px)) printf("%.3f px, ", job->total_held_out_px);
    printf("%.3f mm, %.4f° (the robot's noise alone: %.3f mm, %.4f°)\n", r->held_out_mm, r->held_out_deg,
           job->floor_mm, job->floor_deg);
    if (job->has_advice) printf("next: %s\n", job->advice.text);
    printf("\nverdict: %s\n", verdict_name(job->gate.verdict));
    for (size_t i = 0; i < job->gate.count; i++) printf("  - %s\n", job->gate.reason[i]);
}

/* ---- The report ---- */

static void solver_table(td_report *r, const hand_eye_job *job)
{
    static const char *const heads[] = {"closed form", "RMS (px)", "scatter (mm)", "scatter (°)", "remark"};
    td_report_table_begin(r, heads, 5);
    for (int i = 0; i < TD_SOLVER_COUNT; i++) {
        const td_solver_score *s = &job->solver[i];
        td_tone tone = s->failed ? TD_TONE_BAD : i == job->best ? TD_TONE_GOOD : TD_TONE_PLAIN;
        td_report_cell(r, tone, "%s", td_hand_eye_solver_name(s->solver));
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", s->rms_px);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", s->scatter_mm);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", s->scatter_deg);
        td_report_cell(r, tone, "%s%s", i == job->best ? "best" : s->failed ? "failed: " : "", s->why);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void pose_table(td_report *r, const hand_eye_job *job)
{
    static const char *const heads[] = {"transform", "x (mm)", "y (mm)", "z (mm)", "± (mm)",
                                        "rx (°)",    "ry (°)", "rz (°)", "± (°)"};
    const td_hand_eye *h = job->result;
    const char *names[2] = {td_hand_eye_x_name(h->setup), td_hand_eye_z_name(h->setup)};
    const td_pose *pose[2] = {&h->x, &h->z};
    const double sigma[2][2] = {{h->sigma_x_mm, h->sigma_x_deg}, {h->sigma_z_mm, h->sigma_z_deg}};
    td_report_table_begin(r, heads, 9);
    for (int i = 0; i < 2; i++) {
        double w[3];
        td_rotation_log(w, pose[i]->q);
        td_report_cell(r, TD_TONE_PLAIN, "%s", names[i]);
        for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.3f", 1e3 * pose[i]->t[k]);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", sigma[i][0]);
        for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.4f", DEGREES * w[k]);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", sigma[i][1]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
    for (int i = 0; i < 2; i++) {
        char *urdf = td_pose_to_urdf(pose[i]);
        td_report_text(r, "%s: %s", names[i], urdf ? urdf : "");
        free(urdf);
    }
}

static void view_table(td_report *r, const hand_eye_job *job)
{
    static const char *const heads[] = {"view", "RMS (px)", "off at the target (mm)",
                                        "(°)",  "deviate",  "left out: (px)",
                                        "(mm)", "(°)",      "remark"};
    td_report_table_begin(r, heads, 9);
    for (size_t v = 0; v < job->count; v++) {
        const td_hand_eye_fit *f = &job->result->view[v];
        td_report_cell(r, f->used ? TD_TONE_PLAIN : TD_TONE_BAD, "%s", job->view[v].name);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", job->rms_px[v]);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", f->target_mm);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", f->target_deg);
        td_report_cell(r, f->deviate > 3 ? TD_TONE_WARN : TD_TONE_PLAIN, "%.1f", f->deviate);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", job->held_out_px[v]);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", f->held_out_mm);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", f->held_out_deg);
        td_report_cell(r, TD_TONE_PLAIN, "%s", f->remark);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* What the robot would have to be wrong by, view by view, at the hand. */
static void residual_plots(td_report *r, const hand_eye_job *job)
{
    size_t n = job->count;
    double *x = malloc((7 * n + 1) * sizeof *x);
    const char **names = malloc((n + 1) * sizeof *names);
    static const char *const labels[] = {"x", "y", "z"};
    for (size_t v = 0; v < n && x && names; v++) {
        names[v] = job->view[v].name;
        x[v] = (double)v;
        for (int k = 0; k < 6; k++)
            x[(size_t)(k + 1) * n + v] = job->result->view[v].residual[k] * (k < 3 ? DEGREES : 1e3);
    }
    td_report_grid_begin(r, 2);
    for (int part = 1; part >= 0 && x && names; part--) {
        td_series series[3];
        for (int k = 0; k < 3; k++)
            series[k] = (td_series){.label = labels[k],
                                    .shape = TD_SHAPE_BAR,
                                    .count = n,
                                    .x = x,
                                    .y = x + (size_t)(3 * part + k + 1) * n};
        const td_axes axes = {.title = part ? "the robot's error at the hand, translation"
                                            : "the robot's error at the hand, rotation",
                              .x_label = "view",
                              .y_label = part ? "mm" : "degrees",
                              .x_names = names,
                              .x_name_count = n};
        td_report_plot(r, &axes, series, 3);
    }
    td_report_grid_end(r);
    free(x);
    free(names);
}

static void figures(td_report *r, const hand_eye_job *job)
{
    const td_hand_eye *h = job->result;
    td_report_figures_begin(r);
    td_report_figure(r, "sigma of X, worst axis", TD_TONE_PLAIN, "%.2f mm, %.3f°", h->sigma_x_mm,
                     h->sigma_x_deg);
    td_report_figure(r, "views left out in turn", TD_TONE_PLAIN, "%.2f mm, %.3f°", h->held_out_mm,
                     h->held_out_deg);
    td_report_figure(r, "robot's noise per axis", TD_TONE_PLAIN, "%.2f mm, %.3f°", 1e3 * h->robot_m,
                     DEGREES * h->robot_rad);
    if (isfinite(job->total_held_out_px))
        td_report_figure(r, "left out, in the images", TD_TONE_PLAIN, "%.2f px", job->total_held_out_px);
    td_report_figures_end(r);
}

td_status hand_eye_report(const hand_eye_job *job, const char *path, td_error *error)
{
    char subtitle[300];
    snprintf(subtitle, sizeof subtitle, "%s, %s, %zu views", job->dataset->name,
             td_hand_eye_setup_name(job->result->setup), job->count);
    td_report *r = td_report_new("Hand–eye calibration", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &job->gate);
    figures(r, job);
    td_report_heading(r, "Where the cameras sit, where the target stands");
    td_report_text(r, "Cameras: %s.", job->rig_from);
    pose_table(r, job);
    td_report_heading(r, "Closed forms");
    td_report_text(r, "Each is run and judged by how far the target's place scatters when it is seen through "
                      "its result; the best begins "
                      "the refinement, none is the result.");
    solver_table(r, job);
    td_report_heading(r, "Views");
    residual_plots(r, job);
    view_table(r, job);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
