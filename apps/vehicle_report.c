/* A camera-to-vehicle calibration for people: the table on the terminal and the report. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "apps/vehicle_internal.h"
#include "core/report.h"
#include "core/rig_formats.h"

#define DEGREES 57.29577951308232

static const char *link_name(const vehicle_job *job, int link)
{
    return job->robot->link[link].name;
}

static void print_pose(const char *name, const td_pose *pose, double mm, double deg)
{
    double w[3];
    td_rotation_log(w, pose->q);
    printf("%-17s t (%.2f, %.2f, %.2f) mm", name, 1e3 * pose->t[0], 1e3 * pose->t[1], 1e3 * pose->t[2]);
    if (isfinite(mm)) printf(" ± %.2f", mm);
    printf(", rotation (%.3f, %.3f, %.3f)°", DEGREES * w[0], DEGREES * w[1], DEGREES * w[2]);
    if (isfinite(deg)) printf(" ± %.3f", deg);
    putchar('\n');
}

static void print_offsets(const vehicle_job *job)
{
    for (int j = 0; j < job->robot->joint_count; j++) {
        const td_robot_joint *joint = &job->robot->joint[j];
        bool shift = joint->kind == TD_JOINT_PRISMATIC;
        double unit = shift ? 1e3 : DEGREES;
        if (job->data.offset_prior[j] == 0) continue;
        printf("zero of %-9s %+.4f ± %.4f %s\n", joint->name, unit * job->result->offset[j],
               unit * job->result->sigma_offset[j], shift ? "mm" : "deg");
    }
}

static void print_solution(const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    td_pose inverse = td_pose_inverse(&r->vehicle_from_rig), apart = td_pose_compose(&inverse, &r->closed);
    print_pose("vehicle_from_rig", &r->vehicle_from_rig, r->sigma_mm, r->sigma_deg);
    if (job->how->closed) return;
    if (r->closed_poses)
        printf("the closed way    %.2f mm and %.3f° from it (mean over %zu poses)\n",
               1e3 * td_pose_distance(&apart), DEGREES * td_pose_angle(&apart), r->closed_poses);
    print_offsets(job);
    printf("at the tip (%s): sigma %.1f mm where it is worst, median %.1f mm\n", link_name(job, job->tip),
           r->sigma_tip_worst_mm, r->sigma_tip_median_mm);
    printf("RMS %.3f px, chi-square over its freedom %.3f", r->rms_px, r->chi2_per_dof);
    if (r->outliers) printf(", %zu of %zu sights left out", r->outliers, job->data.sight_count);
    putchar('\n');
    for (size_t i = 0; i < job->advice_count; i++) printf("%s %s\n", i ? "then:" : "next:", job->advice[i]);
}

void vehicle_table(const vehicle_job *job)
{
    printf("\nrobot: %s (%s), rig on %s: %s\n%zu poses, %d points, %zu sights\n\n", job->robot->name,
           job->robot_path, link_name(job, job->data.mount), job->rig_path, job->data.pose_count,
           job->data.point_count, job->data.sight_count);
    if (!job->result->null_count) print_solution(job);
    printf("\nverdict: %s\n", verdict_name(job->gate.verdict));
    for (size_t i = 0; i < job->gate.count; i++) printf("  - %s\n", job->gate.reason[i]);
}

/* ---- The report ---- */

static void figures(td_report *r, const vehicle_job *job)
{
    const td_vehicle *v = job->result;
    td_report_figures_begin(r);
    td_report_figure(r, "sigma at the tip, where it is worst", TD_TONE_PLAIN, "%.1f mm",
                     v->sigma_tip_worst_mm);
    td_report_figure(r, "sigma at the tip, median", TD_TONE_PLAIN, "%.1f mm", v->sigma_tip_median_mm);
    td_report_figure(r, "sigma of vehicle_from_rig, worst axis", TD_TONE_PLAIN, "%.2f mm, %.3f°", v->sigma_mm,
                     v->sigma_deg);
    td_report_figure(r, "residuals, RMS", TD_TONE_PLAIN, "%.3f px", v->rms_px);
    td_report_figure(r, "chi-square over its freedom", TD_TONE_PLAIN, "%.2f", v->chi2_per_dof);
    td_report_figures_end(r);
}

static void pose_row(td_report *r, const char *name, const td_pose *pose, double mm, double deg)
{
    double w[3];
    td_rotation_log(w, pose->q);
    td_report_cell(r, TD_TONE_PLAIN, "%s", name);
    for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.2f", 1e3 * pose->t[k]);
    td_report_cell(r, TD_TONE_PLAIN, "%.2f", mm);
    for (int k = 0; k < 3; k++) td_report_cell(r, TD_TONE_PLAIN, "%.4f", DEGREES * w[k]);
    td_report_cell(r, TD_TONE_PLAIN, "%.4f", deg);
    td_report_row_end(r);
}

static void pose_table(td_report *r, const vehicle_job *job)
{
    static const char *const heads[] = {"transform", "x (mm)", "y (mm)", "z (mm)", "± (mm)",
                                        "rx (°)",    "ry (°)", "rz (°)", "± (°)"};
    const td_vehicle *v = job->result;
    td_report_table_begin(r, heads, 9);
    if (!v->null_count) pose_row(r, "vehicle_from_rig", &v->vehicle_from_rig, v->sigma_mm, v->sigma_deg);
    if (v->closed_poses && !job->how->closed) pose_row(r, "the closed way", &v->closed, NAN, NAN);
    td_report_table_end(r);
    if (v->null_count) return;
    char *urdf = td_pose_to_urdf(&v->vehicle_from_rig);
    td_report_text(r, "As URDF: %s", urdf ? urdf : "");
    free(urdf);
    if (v->closed_poses && !job->how->closed)
        td_report_text(
            r,
            "The closed way triangulates the points in one pose after the other, finds their frame, "
            "and takes the mean through the arm's kinematics: over %zu poses here. The joint "
            "solution weighs all poses, cameras and joint readings at once.",
            v->closed_poses);
}

static void next_poses(td_report *r, const vehicle_job *job)
{
    if (!job->advice_count) return;
    td_report_heading(r, "The next arm poses");
    td_report_text(
        r, "The poses that would help most at the tip if the same points were seen in them, each as if "
           "those before had been taken:");
    for (size_t i = 0; i < job->advice_count; i++) td_report_text(r, "• %s", job->advice[i]);
}

static void boards(td_report *r, const vehicle_job *job)
{
    for (int b = 0; b < job->data.board_count && !job->how->closed; b++) {
        const double *sigma = job->result->sigma_board[b];
        char *urdf = td_pose_to_urdf(&job->result->link_from_board[b]);
        td_report_text(r, "Board %s on %s: %s", job->data.board[b].name,
                       link_name(job, job->data.board[b].link), urdf ? urdf : "");
        if (!job->result->null_count && (sigma[0] > 0 || sigma[1] > 0))
            td_report_text(r, "known to ± %.2f mm, %.3f°", 1e3 * sigma[1], DEGREES * sigma[0]);
        free(urdf);
    }
}

static void tip_map(td_report *r, const vehicle_job *job)
{
    const vehicle_map *m = &job->map;
    if (!m->made) return;
    const td_heat heat = {
        .columns = VEHICLE_MAP_COLUMNS, .rows = VEHICLE_MAP_ROWS, .value = m->value, .label = "sigma (mm)"};
    const td_axes axes = {.title = "sigma at the tip, the worst pose that reaches there",
                          .x_label = "reach, x of the vehicle (m)",
                          .y_label = "height, z of the vehicle (m)",
                          .x_min = m->x_min,
                          .x_max = m->x_max,
                          .y_min = m->z_min,
                          .y_max = m->z_max,
                          .equal = 1,
                          .heat = &heat};
    const td_pose *rig = &job->result->vehicle_from_rig;
    const td_series where = {
        .label = "rig", .shape = TD_SHAPE_CROSS, .count = 1, .x = &rig->t[0], .y = &rig->t[2]};
    td_report_heading(r, "At the tip");
    td_report_text(
        r,
        "How far apart the cameras see %s and the joints say it is: one sigma along the worst axis, "
        "from vehicle_from_rig, the joints' zeros and one reading of the joints. Side view of the "
        "working space, without slewing.",
        link_name(job, job->tip));
    td_report_plot(r, &axes, &where, 1);
}

/* Residuals as arrows in each camera's image. */
static void arrows(td_report *r, const vehicle_job *job)
{
    size_t n = job->data.sight_count;
    double *x = malloc((4 * n + 1) * sizeof *x), *y = x + n, *dx = y + n, *dy = dx + n;
    td_report_grid_begin(r, 2);
    for (int c = 0; c < job->rig->count && x; c++) {
        const td_camera *camera = &job->rig->camera[c].camera;
        size_t fine = 0, off = n;
        for (size_t s = 0; s < n; s++) {
            const td_vehicle_sight *sight = &job->data.sight[s];
            if (sight->camera != c) continue;
            size_t at = job->result->left_out[s] ? --off : fine++;
            x[at] = sight->pixel[0];
            y[at] = sight->pixel[1];
            dx[at] = job->result->residual[s][0];
            dy[at] = job->result->residual[s][1];
        }
        const double scale = 100;
        const td_series series[2] = {{.label = "used",
                                      .shape = TD_SHAPE_POINT,
                                      .count = fine,
                                      .x = x,
                                      .y = y,
                                      .dx = dx,
                                      .dy = dy,
                                      .vector_scale = scale},
                                     {.label = "left out",
                                      .shape = TD_SHAPE_CROSS,
                                      .tone = TD_TONE_BAD,
                                      .count = n - off,
                                      .x = x + off,
                                      .y = y + off}};
        const td_axes axes = {.title = job->rig->camera[c].name,
                              .x_label = "x (px)",
                              .y_label = "y (px)",
                              .x_max = camera->width,
                              .y_max = camera->height,
                              .equal = 1,
                              .y_down = 1};
        td_report_plot(r, &axes, series, n > off ? 2 : 1);
    }
    td_report_grid_end(r);
    free(x);
}

static void pose_residuals(td_report *r, const vehicle_job *job)
{
    static const char *const heads[] = {"frame", "sights", "left out", "RMS (px)", "joint noise (σ)"};
    td_report_table_begin(r, heads, 5);
    for (size_t k = 0; k < job->data.pose_count; k++) {
        size_t used, left_out;
        double rms = vehicle_pose_rms(&used, &left_out, job, k), noise = vehicle_noise_sigmas(job, k);
        td_report_cell(r, left_out ? TD_TONE_WARN : TD_TONE_PLAIN, "%s", job->pose_name[k]);
        td_report_cell(r, TD_TONE_PLAIN, "%zu", used);
        td_report_cell(r, left_out ? TD_TONE_WARN : TD_TONE_PLAIN, "%zu", left_out);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", rms);
        td_report_cell(r, noise > 4 ? TD_TONE_WARN : TD_TONE_PLAIN, "%.1f", noise);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void point_residuals(td_report *r, const vehicle_job *job)
{
    static const char *const heads[] = {"point",    "link",     "x (m)",    "y (m)",  "z (m)",
                                        "± x (mm)", "± y (mm)", "± z (mm)", "sights", "RMS (px)"};
    const td_vehicle *v = job->result;
    td_report_table_begin(r, heads, 10);
    for (int p = 0; p < job->data.point_count; p++) {
        size_t used, left_out;
        double rms = vehicle_point_rms(&used, &left_out, job, p);
        td_report_cell(r, left_out > used ? TD_TONE_WARN : TD_TONE_PLAIN, "%s", job->data.point[p].name);
        td_report_cell(r, TD_TONE_PLAIN, "%s", link_name(job, job->data.point[p].link));
        for (int i = 0; i < 3; i++)
            td_report_cell(r, TD_TONE_PLAIN, "%.4f",
                           job->how->closed ? job->data.point[p].place[i] : v->place[p][i]);
        for (int i = 0; i < 3; i++)
            td_report_cell(r, TD_TONE_PLAIN, "%.2f",
                           1e3 * (job->how->closed || v->null_count ? job->data.point[p].sigma[i]
                                                                    : v->sigma_place[p][i]));
        td_report_cell(r, TD_TONE_PLAIN, "%zu", used);
        td_report_cell(r, TD_TONE_PLAIN, "%.3f", rms);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

static void offset_table(td_report *r, const vehicle_job *job)
{
    static const char *const heads[] = {"joint", "zero (° or mm)", "±", "prior ±"};
    bool any = false;
    for (int j = 0; j < job->robot->joint_count; j++) any = any || job->data.offset_prior[j] > 0;
    if (!any || job->result->null_count || job->how->closed) return;
    td_report_heading(r, "Zeros of the joints");
    td_report_table_begin(r, heads, 4);
    for (int j = 0; j < job->robot->joint_count; j++) {
        double unit = job->robot->joint[j].kind == TD_JOINT_PRISMATIC ? 1e3 : DEGREES;
        if (job->data.offset_prior[j] == 0) continue;
        td_report_cell(r, TD_TONE_PLAIN, "%s", job->robot->joint[j].name);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", unit * job->result->offset[j]);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", unit * job->result->sigma_offset[j]);
        td_report_cell(r, TD_TONE_PLAIN, "%.4f", unit * job->data.offset_prior[j]);
        td_report_row_end(r);
    }
    td_report_table_end(r);
}

/* Open and weak directions stand in the verdict's box. */
static void body(td_report *r, const vehicle_job *job)
{
    const td_vehicle *v = job->result;
    bool solved = !v->null_count && !job->how->closed;
    if (solved) figures(r, job);
    td_report_heading(r, "Where the cameras sit on the vehicle");
    td_report_text(r,
                   "Robot: %s. The rig is on %s; the vehicle's frame is that of %s. %zu poses of the arm, %d "
                   "points, %zu sights.",
                   job->robot->name, link_name(job, job->data.mount), link_name(job, job->data.vehicle),
                   job->data.pose_count, job->data.point_count, job->data.sight_count);
    if (!v->null_count || v->closed_poses) pose_table(r, job);
    offset_table(r, job);
    if (solved) tip_map(r, job);
    next_poses(r, job);
    if (!job->how->closed) {
        td_report_heading(r, "Residuals");
        td_report_text(r, "Predicted less seen, with the joints' noise that was found for each pose.");
        arrows(r, job);
        pose_residuals(r, job);
    }
    td_report_heading(r, "Points");
    boards(r, job);
    point_residuals(r, job);
}

td_status vehicle_report(const vehicle_job *job, const char *path, td_error *error)
{
    char subtitle[300];
    snprintf(subtitle, sizeof subtitle, "%s, %s, %zu poses", job->dataset->name, job->robot->name,
             job->data.pose_count);
    td_report *r = td_report_new("Camera-to-vehicle calibration", subtitle);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &job->gate);
    body(r, job);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
