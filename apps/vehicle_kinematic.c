/* Kinematic calibration of an arm's chain from poses of a target and readings of the joints. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"
#include "core/document.h"
#include "core/report.h"
#include "core/rig_formats.h"

#define DEGREES 57.29577951308232

const td_schema_row vehicle_kinematic_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "vehicle"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"dataset", TD_SCHEMA_STRING, true, false, "name"},
    {"method", TD_SCHEMA_STRING, true, false, "kinematic: from poses of a target"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"poses", TD_SCHEMA_INT, true, false, "measured"},
    {"used_poses", TD_SCHEMA_INT, true, false, "not left out"},
    {"outlier_poses", TD_SCHEMA_STRINGS, true, false, "names"},
    {"noise_mm", TD_SCHEMA_REAL, true, false, "of a measured pose, each axis"},
    {"noise_deg", TD_SCHEMA_REAL, true, false, "of a measured pose, each axis"},
    {"held_out", TD_SCHEMA_OBJECT, true, false,
     "every fifth pose predicted by the chain calibrated from the others; null: too few poses"},
    {"held_out.poses", TD_SCHEMA_INT, true, false, "held out"},
    {"held_out.mean_mm", TD_SCHEMA_REAL, true, true, "distance"},
    {"held_out.mean_deg", TD_SCHEMA_REAL, true, true, "angle"},
    {"mount_from_rig", TD_SCHEMA_OBJECT, true, false, "where the cameras sit"},
    {"mount_from_rig.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"mount_from_rig.t_m", TD_SCHEMA_REALS, true, false, "m"},
    {"link_from_target", TD_SCHEMA_OBJECT, true, false, "where the target sits"},
    {"link_from_target.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"link_from_target.t_m", TD_SCHEMA_REALS, true, false, "m"},
    {"joints", TD_SCHEMA_OBJECT, true, false, "of the chain, by name"},
    {"joints.*", TD_SCHEMA_OBJECT, true, false, "a joint's origin"},
    {"joints.*.origin_urdf", TD_SCHEMA_STRING, true, false, "the corrected origin, for the robot's file"},
    {"joints.*.correction", TD_SCHEMA_REALS, true, false, "left perturbation rx ry rz tx ty tz, rad and m"},
    {"joints.*.sigma", TD_SCHEMA_REALS, true, false, "of the correction, rad and m"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t vehicle_kinematic_schema_count =
    sizeof vehicle_kinematic_schema / sizeof *vehicle_kinematic_schema;

/* ---- The solution ---- */

/* Every fifth pose predicted from the others. */
static td_status hold_out(vehicle_kinematic *k, const td_kinematic_data *all,
                          const td_kinematic_options *options, td_error *error)
{
    size_t n = (size_t)all->robot->joint_count, kept = 0;
    double *q = malloc((all->count * n + 1) * sizeof *q);
    td_pose *seen = malloc((all->count + 1) * sizeof *seen);
    td_kinematic *found = NULL;
    td_status status = q && seen ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "out of memory");
    k->held_out_mm = k->held_out_deg = NAN;
    for (size_t i = 0; i < all->count && status == TD_OK; i++) {
        if (i % 5 == 2) continue;
        memcpy(q + kept * n, all->q + i * n, n * sizeof *q);
        seen[kept++] = all->rig_from_target[i];
    }
    td_kinematic_data part = *all;
    part.count = kept;
    part.q = q;
    part.rig_from_target = seen;
    if (status == TD_OK && all->count >= 10 && td_kinematic_solve(&found, &part, options, NULL) == TD_OK) {
        k->held_out_mm = k->held_out_deg = 0;
        for (size_t i = 2; i < all->count; i += 5) {
            td_pose said = td_kinematic_predict(found, &part, all->q + i * n),
                    back = td_pose_inverse(&all->rig_from_target[i]), off = td_pose_compose(&back, &said);
            k->held_out_mm += 1e3 * td_pose_distance(&off);
            k->held_out_deg += DEGREES * td_pose_angle(&off);
            k->held_out++;
        }
        k->held_out_mm /= (double)k->held_out;
        k->held_out_deg /= (double)k->held_out;
    }
    td_kinematic_free(&found);
    free(q);
    free(seen);
    return status;
}

static td_status pair(vehicle_job *job, td_pose **seen, const td_robot_poses *target, td_error *error)
{
    if (target->count != job->data.pose_count)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s holds %zu poses, but %s %zu lines of readings: they belong together in their order",
            job->dataset->target_poses.path, target->count, job->joints->name, job->data.pose_count);
    *seen = malloc((target->count + 1) * sizeof **seen);
    if (!*seen) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < target->count; i++) (*seen)[i] = target->pose[i].base_from_hand;
    return TD_OK;
}

td_status vehicle_kinematic_solve(vehicle_kinematic *k, vehicle_job *job, td_error *error)
{
    const td_dataset *d = job->dataset;
    td_kinematic_options o = td_kinematic_options_default();
    td_robot_poses *target = NULL;
    td_pose *seen = NULL;
    int link;
    o.progress = job->how->progress;
    o.log = job->how->log;
    if (!*d->arm->link)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: which link carries the target of target_poses is not said: robot: {link: LINK}",
                       d->folder);
    TD_TRY(vehicle_find_link(&link, job, "link", d->arm->link, error));
    TD_TRY(vehicle_read_joints(job, &link, 1, error));
    TD_TRY(td_robot_poses_read(&target, d->target_poses.path, &d->target_poses.how, error));
    td_status status = pair(job, &seen, target, error);
    const td_kinematic_data data = {job->robot,           job->data.mount, link,
                                    job->data.pose_count, job->data.q,     seen};
    if (status == TD_OK) status = td_kinematic_solve(&k->result, &data, &o, error);
    if (status == TD_OK) status = hold_out(k, &data, &o, error);
    td_robot_poses_free(&target);
    free(seen);
    return status;
}

/* ---- The result ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *pose_json(const td_pose *pose)
{
    return json_pack("{s:o, s:o}", "q", td_json_reals(pose->q, 4), "t_m", td_json_reals(pose->t, 3));
}

void vehicle_kinematic_judge(vehicle_kinematic *k, const vehicle_job *job)
{
    const td_kinematic *r = k->result;
    double left_out = 1 - (double)r->used / (double)job->data.pose_count;
    k->gate = (gate_result){.verdict = VERDICT_ACCEPTED};
    if (left_out > 0)
        gate_add(&k->gate, left_out > 0.25 ? VERDICT_REFUSED : VERDICT_WARNED,
                 "%zu of %zu poses were left out", job->data.pose_count - r->used, job->data.pose_count);
    if (k->held_out && k->held_out_mm > 5 * 1e3 * r->sigma_m)
        gate_add(&k->gate, VERDICT_WARNED,
                 "poses held out are %.2f mm off, more than the noise of %.2f mm explains: take more poses",
                 k->held_out_mm, 1e3 * r->sigma_m);
}

json_t *vehicle_kinematic_result(const vehicle_kinematic *k, const vehicle_job *job)
{
    const td_kinematic *r = k->result;
    json_t *root = json_object(), *reasons = json_array(), *left = json_array(), *joints = json_object(),
           *held = json_object();
    for (size_t i = 0; i < k->gate.count; i++) json_array_append_new(reasons, json_string(k->gate.reason[i]));
    for (size_t i = 0; i < job->data.pose_count; i++)
        if (r->left_out[i]) json_array_append_new(left, json_string(job->pose_name[i]));
    for (int i = 0; i < r->joints; i++) {
        const td_robot_joint *joint = &r->robot->joint[r->joint[i]];
        char *urdf = td_pose_to_urdf(&r->robot->link[joint->link].parent_from_link);
        set(joints, joint->name,
            json_pack("{s:s, s:o, s:o}", "origin_urdf", urdf ? urdf : "", "correction",
                      td_json_reals(r->correction[i], 6), "sigma", td_json_reals(r->sigma_correction[i], 6)));
        free(urdf);
    }
    set(held, "poses", json_integer((json_int_t)k->held_out));
    set(held, "mean_mm", td_json_real(k->held_out_mm));
    set(held, "mean_deg", td_json_real(k->held_out_deg));
    set(root, "job", json_string("vehicle"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "dataset", json_string(job->dataset->name));
    set(root, "method", json_string("kinematic"));
    set(root, "verdict", json_string(verdict_name(k->gate.verdict)));
    set(root, "reasons", reasons);
    set(root, "poses", json_integer((json_int_t)job->data.pose_count));
    set(root, "used_poses", json_integer((json_int_t)r->used));
    set(root, "outlier_poses", left);
    set(root, "noise_mm", td_json_real(1e3 * r->sigma_m));
    set(root, "noise_deg", td_json_real(DEGREES * r->sigma_rad));
    set(root, "held_out", held);
    set(root, "mount_from_rig", pose_json(&r->mount_from_rig));
    set(root, "link_from_target", pose_json(&r->link_from_target));
    set(root, "joints", joints);
    set(root, "products",
        json_pack("{s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log", "log.jsonl"));
    return root;
}

void vehicle_kinematic_table(const vehicle_kinematic *k, const vehicle_job *job)
{
    const td_kinematic *r = k->result;
    printf("\nrobot: %s (%s)\n%zu of %zu poses used, noise of a pose %.3f mm, %.4f°\n", job->robot->name,
           job->robot_path, r->used, job->data.pose_count, 1e3 * r->sigma_m, DEGREES * r->sigma_rad);
    if (k->held_out)
        printf("every fifth pose held out: %.3f mm, %.4f° off on average (%zu poses)\n", k->held_out_mm,
               k->held_out_deg, k->held_out);
    for (int i = 0; i < r->joints; i++) {
        const double *c = r->correction[i];
        printf("%-10s origin corrected by (%.3f, %.3f, %.3f)°, (%.2f, %.2f, %.2f) mm\n",
               r->robot->joint[r->joint[i]].name, DEGREES * c[0], DEGREES * c[1], DEGREES * c[2], 1e3 * c[3],
               1e3 * c[4], 1e3 * c[5]);
    }
    printf("\nverdict: %s\n", verdict_name(k->gate.verdict));
    for (size_t i = 0; i < k->gate.count; i++) printf("  - %s\n", k->gate.reason[i]);
}

static void origin_table(td_report *r, const td_kinematic *k)
{
    static const char *const heads[] = {"joint",  "rx (°)", "ry (°)", "rz (°)",
                                        "x (mm)", "y (mm)", "z (mm)", "corrected origin"};
    td_report_table_begin(r, heads, 8);
    for (int i = 0; i < k->joints; i++) {
        const td_robot_joint *joint = &k->robot->joint[k->joint[i]];
        char *urdf = td_pose_to_urdf(&k->robot->link[joint->link].parent_from_link);
        td_report_cell(r, TD_TONE_PLAIN, "%s", joint->name);
        for (int c = 0; c < 6; c++) {
            double unit = c < 3 ? DEGREES : 1e3;
            td_report_cell(r, TD_TONE_PLAIN, "%.3f ± %.3f", unit * k->correction[i][c],
                           unit * k->sigma_correction[i][c]);
        }
        td_report_cell(r, TD_TONE_PLAIN, "%s", urdf ? urdf : "");
        td_report_row_end(r);
        free(urdf);
    }
    td_report_table_end(r);
}

td_status vehicle_kinematic_report(const vehicle_kinematic *k, const vehicle_job *job, const char *path,
                                   td_error *error)
{
    td_report *r = td_report_new("Kinematic calibration", job->dataset->name);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for the report", path);
    gate_report(r, &k->gate);
    td_report_figures_begin(r);
    td_report_figure(r, "poses held out, mean", TD_TONE_PLAIN, "%.2f mm, %.3f°", k->held_out_mm,
                     k->held_out_deg);
    td_report_figure(r, "noise of a measured pose, per axis", TD_TONE_PLAIN, "%.2f mm, %.3f°",
                     1e3 * k->result->sigma_m, DEGREES * k->result->sigma_rad);
    td_report_figure(r, "poses used", TD_TONE_PLAIN, "%zu / %zu", k->result->used, job->data.pose_count);
    td_report_figures_end(r);
    td_report_heading(r, "Origins of the joints");
    td_report_text(r, "Corrections of what the robot's file says, against priors about it: what the chain "
                      "cannot tell, such as a shift along a joint's own axis, stays near zero.");
    origin_table(r, k->result);
    td_status status = td_report_write(r, path, error);
    td_report_free(&r);
    return status;
}
