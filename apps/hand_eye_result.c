/* The result of a hand-eye calibration as a document, its schema, and the verdict. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/hand_eye_internal.h"
#include "core/document.h"
#include "core/rig_formats.h"

#define DEGREES 57.29577951308232

const gate_row hand_eye_gate_defaults[] = {
    {"sigma_mm", 3, 10,
     "sigma of X's position, worst axis: what the views leave open, robot's noise included"},
    {"sigma_deg", 0.3, 1, "sigma of X's rotation, worst axis; at 1 m, 0.3 degrees are 5 mm"},
    {"robot_mm", 2, 10,
     "the robot's noise at the hand, per axis; an arm in order repeats to well below 1 mm"},
    {"scale", 0.05, 0.05,
     "error of the target's size, when it is also 3 sigmas; below, it cannot be told from X"},
    {"outlier_share", 0.1, 0.34, "views left out over views"},
};
const size_t hand_eye_gate_count = sizeof hand_eye_gate_defaults / sizeof *hand_eye_gate_defaults;

const td_schema_row hand_eye_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "hand-eye"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"dataset", TD_SCHEMA_STRING, true, false, "name"},
    {"setup", TD_SCHEMA_STRING, true, false, "eye-in-hand, eye-to-hand or robot-world"},
    {"cameras", TD_SCHEMA_STRING, true, false, "where their calibration comes from"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
#define POSE_ROWS(p, what)                                                                                   \
    {p, TD_SCHEMA_OBJECT, true, false, what}, {p ".name", TD_SCHEMA_STRING, true, false, "a_from_b"},        \
        {p ".q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},                                   \
        {p ".t_m", TD_SCHEMA_REALS, true, false, "translation, m"},                                          \
        {p ".sigma_mm", TD_SCHEMA_REAL, true, true, "standard deviation of the position, worst axis"},       \
        {p ".sigma_deg", TD_SCHEMA_REAL, true, true, "standard deviation of the rotation, worst axis"},      \
        {p ".urdf", TD_SCHEMA_STRING, true, false, "as URDF's origin"},                                      \
    {                                                                                                        \
        p ".ros", TD_SCHEMA_STRING, true, false, "as arguments of ROS' static_transform_publisher"           \
    }
    POSE_ROWS("x", "where the cameras sit"),
    POSE_ROWS("z", "where the target stands"),
#undef POSE_ROWS
    {"order", TD_SCHEMA_STRINGS, true, false, "of the covariance: perturbations of X, then Z"},
    {"covariance", TD_SCHEMA_MATRIX, true, false, "joint, rad and m; left perturbations"},
    {"views", TD_SCHEMA_INT, true, false, "with target and robot pose"},
    {"used_views", TD_SCHEMA_INT, true, false, "not left out"},
    {"rms_px", TD_SCHEMA_REAL, true, true, "of reprojection through the robot's poses; null without images"},
    {"model", TD_SCHEMA_STRING, true, false, "of the robot: exact, independent or field"},
    {"robot_noise", TD_SCHEMA_OBJECT, true, false, "at the hand, per axis"},
    {"robot_noise.mm", TD_SCHEMA_REAL, true, false, "standard deviation in translation"},
    {"robot_noise.deg", TD_SCHEMA_REAL, true, false, "standard deviation in rotation"},
    {"robot_noise.sigma_mm", TD_SCHEMA_REAL, true, true, "how well that is known"},
    {"robot_noise.sigma_deg", TD_SCHEMA_REAL, true, true, "how well that is known"},
    {"robot_field", TD_SCHEMA_OBJECT, false, false, "smooth error over the working space, per axis"},
    {"robot_field.mm", TD_SCHEMA_REAL, true, false, "standard deviation in translation"},
    {"robot_field.deg", TD_SCHEMA_REAL, true, false, "standard deviation in rotation"},
    {"robot_field.length_m", TD_SCHEMA_REAL, true, false, "over which it changes"},
    {"log_likelihood", TD_SCHEMA_OBJECT, true, false, "restricted, of the robot models tried"},
    {"log_likelihood.*", TD_SCHEMA_REAL, true, true, "by model; null: not tried"},
    {"leave_one_out", TD_SCHEMA_OBJECT, true, false,
     "held-out views from their robot poses, X and Z of the others"},
    {"leave_one_out.rms_px", TD_SCHEMA_REAL, true, true, "reprojection"},
    {"leave_one_out.rms_mm", TD_SCHEMA_REAL, true, true, "of the target's place"},
    {"leave_one_out.rms_deg", TD_SCHEMA_REAL, true, true, "of its rotation"},
    {"leave_one_out.floor_px", TD_SCHEMA_REAL, true, true,
     "what the robot's noise leaves were X and Z exact"},
    {"leave_one_out.floor_mm", TD_SCHEMA_REAL, true, true, "the same"},
    {"leave_one_out.floor_deg", TD_SCHEMA_REAL, true, true, "the same"},
    {"scale", TD_SCHEMA_REAL, true, true, "true size of the target over the given one"},
    {"sigma_scale", TD_SCHEMA_REAL, true, true, "its standard deviation"},
    {"plain", TD_SCHEMA_OBJECT, false, false,
     "X by plain least squares, the robot taken as exact, against this X"},
    {"plain.apart_mm", TD_SCHEMA_REAL, true, false, "distance of the positions"},
    {"plain.apart_deg", TD_SCHEMA_REAL, true, false, "angle between the rotations"},
    {"time_offset_s", TD_SCHEMA_REAL, false, false, "added to the target's times"},
    {"sigma_time_offset_s", TD_SCHEMA_REAL, false, true, "its standard deviation"},
    {"solvers", TD_SCHEMA_ARRAY, true, false, "closed forms"},
    {"solvers[].name", TD_SCHEMA_STRING, true, false,
     "tsai, park, horaud, andreff, daniilidis, shah, li, visp"},
    {"solvers[].failed", TD_SCHEMA_BOOL, true, false, "not to be used"},
    {"solvers[].why", TD_SCHEMA_STRING, true, false, "it failed"},
    {"solvers[].rms_px", TD_SCHEMA_REAL, true, true, "of reprojection"},
    {"solvers[].scatter_mm", TD_SCHEMA_REAL, true, true, "of the target's place over the views"},
    {"solvers[].scatter_deg", TD_SCHEMA_REAL, true, true, "of its rotation"},
    {"best_solver", TD_SCHEMA_STRING, true, true, "from which the refinement starts"},
    {"per_view", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"per_view.*", TD_SCHEMA_OBJECT, true, false, "a view"},
    {"per_view.*.used", TD_SCHEMA_BOOL, true, false, "not left out"},
    {"per_view.*.remark", TD_SCHEMA_STRING, false, false, "why it was left out"},
    {"per_view.*.rms_px", TD_SCHEMA_REAL, true, true, "of reprojection"},
    {"per_view.*.target_mm", TD_SCHEMA_REAL, true, true, "predicted against seen, at the target"},
    {"per_view.*.target_deg", TD_SCHEMA_REAL, true, true, "predicted against seen"},
    {"per_view.*.deviate", TD_SCHEMA_REAL, true, true, "as a normal deviate"},
    {"per_view.*.held_out_px", TD_SCHEMA_REAL, true, true, "leave-one-out"},
    {"per_view.*.held_out_mm", TD_SCHEMA_REAL, true, true, "leave-one-out"},
    {"per_view.*.held_out_deg", TD_SCHEMA_REAL, true, true, "leave-one-out"},
    {"outlier_views", TD_SCHEMA_STRINGS, true, false, "names"},
    {"weak_directions", TD_SCHEMA_STRINGS, true, false, "what the motion leaves open, and what to do"},
    {"mistakes", TD_SCHEMA_STRINGS, true, false, "conventions that look confused"},
    {"advice", TD_SCHEMA_OBJECT, false, false, "the next robot pose that would help most"},
    {"advice.text", TD_SCHEMA_STRING, true, false, "in words"},
    {"advice.base_from_hand", TD_SCHEMA_OBJECT, true, false, "the pose"},
    {"advice.base_from_hand.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"advice.base_from_hand.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},
    {"advice.sigma_mm", TD_SCHEMA_REAL, true, false, "of X with it, worst axis"},
    {"advice.sigma_deg", TD_SCHEMA_REAL, true, false, "of X with it, worst axis"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t hand_eye_schema_count = sizeof hand_eye_schema / sizeof *hand_eye_schema;

/* ---- Verdict ---- */

static void judge_scale(gate_result *g, const gate_row *rows, const hand_eye_job *job)
{
    const td_hand_eye *r = job->result;
    double off = fabs(r->scale - 1);
    if (!isfinite(r->scale) || !(off > 3 * r->sigma_scale)) return;
    const td_target *t = job->observations ? &job->observations->target : NULL;
    double given = !t ? NAN : t->kind == TD_TARGET_TAGS ? t->tag[0].size_m : t->plane[0].spacing_m;
    char size[96] = "";
    if (isfinite(given))
        snprintf(size, sizeof size, ": %.4g mm instead of %.4g mm (spacing_m, or size_m)",
                 1e3 * given * r->scale, 1e3 * given);
    gate_check(g, rows, hand_eye_gate_count, "scale", off,
               "the target looks %.3f ± %.3f times as large as is said%s; measure it", r->scale,
               r->sigma_scale, size);
}

void hand_eye_judge(hand_eye_job *job, const gate_row *rows)
{
    gate_result *g = &job->gate;
    const td_hand_eye *r = job->result;
    *g = (gate_result){.verdict = VERDICT_ACCEPTED};
    for (size_t i = 0; i < job->mistake_count; i++) gate_add(g, VERDICT_REFUSED, "%s", job->mistake[i].text);
    for (size_t i = 0; i < r->weak_count; i++) gate_add(g, VERDICT_REFUSED, "%s", r->weak[i]);
    judge_scale(g, rows, job);
    gate_check(g, rows, hand_eye_gate_count, "sigma_mm", r->sigma_x_mm,
               "%s is known to %.1f mm only; add views with the hand turned about other axes",
               td_hand_eye_x_name(r->setup), r->sigma_x_mm);
    gate_check(g, rows, hand_eye_gate_count, "sigma_deg", r->sigma_x_deg,
               "%s is known to %.2f degrees only; add views with the hand turned about other axes",
               td_hand_eye_x_name(r->setup), r->sigma_x_deg);
    gate_check(g, rows, hand_eye_gate_count, "robot_mm", 1e3 * r->robot_m,
               "the robot's poses are off by %.1f mm and %.2f degrees per axis: is its kinematic model the "
               "right one?",
               1e3 * r->robot_m, DEGREES * r->robot_rad);
    gate_check(g, rows, hand_eye_gate_count, "outlier_share", 1 - (double)r->used / (double)r->view_count,
               "%zu of %zu views were left out", r->view_count - r->used, r->view_count);
    for (size_t v = 0; v < job->count; v++)
        if (!r->view[v].used) gate_add(g, VERDICT_WARNED, "%s", r->view[v].remark);
    if (job->moved_sigma > 3)
        gate_add(g, VERDICT_WARNED,
                 "the intrinsics moved by %.1f of their sigmas against the given ones: were focus or zoom "
                 "changed?",
                 job->moved_sigma);
    if (*job->lens)
        gate_add(g, VERDICT_WARNED, "%s%s", job->lens,
                 job->how->find_lens ? "; it was taken in"
                                     : "; calibrate the camera, or take it in by --intrinsics lens");
    if (job->best < 0)
        gate_add(g, VERDICT_WARNED, "every closed form failed; the refinement began on its own");
}

/* ---- Document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *text_json(char *text)
{
    json_t *o = json_string(text ? text : "");
    free(text);
    return o;
}

static json_t *transform_json(const char *name, const td_pose *pose, double mm, double deg)
{
    char a[TD_NAME_SIZE];
    const char *from = strstr(name, "_from_");
    snprintf(a, sizeof a, "%.*s", (int)(from - name), name);
    json_t *o = json_object();
    set(o, "name", json_string(name));
    set(o, "q", td_json_reals(pose->q, 4));
    set(o, "t_m", td_json_reals(pose->t, 3));
    set(o, "sigma_mm", td_json_real(mm));
    set(o, "sigma_deg", td_json_real(deg));
    set(o, "urdf", text_json(td_pose_to_urdf(pose)));
    set(o, "ros", text_json(td_pose_to_ros(pose, a, from + 6)));
    return o;
}

static json_t *solvers_json(const hand_eye_job *job)
{
    json_t *list = json_array();
    for (int i = 0; i < TD_SOLVER_COUNT; i++) {
        const td_solver_score *s = &job->solver[i];
        json_t *o = json_object();
        set(o, "name", json_string(td_hand_eye_solver_name(s->solver)));
        set(o, "failed", json_boolean(s->failed));
        set(o, "why", json_string(s->why));
        set(o, "rms_px", td_json_real(s->rms_px));
        set(o, "scatter_mm", td_json_real(s->scatter_mm));
        set(o, "scatter_deg", td_json_real(s->scatter_deg));
        json_array_append_new(list, o);
    }
    return list;
}

static json_t *view_json(const hand_eye_job *job, size_t v)
{
    const td_hand_eye_fit *f = &job->result->view[v];
    json_t *o = json_object();
    set(o, "used", json_boolean(f->used));
    if (*f->remark) set(o, "remark", json_string(f->remark));
    set(o, "rms_px", td_json_real(job->rms_px[v]));
    set(o, "target_mm", td_json_real(f->target_mm));
    set(o, "target_deg", td_json_real(f->target_deg));
    set(o, "deviate", td_json_real(f->deviate));
    set(o, "held_out_px", td_json_real(job->held_out_px[v]));
    set(o, "held_out_mm", td_json_real(f->held_out_mm));
    set(o, "held_out_deg", td_json_real(f->held_out_deg));
    return o;
}

static void set_robot(json_t *root, const td_hand_eye *r)
{
    static const char *const models[] = {"exact", "independent", "field"};
    json_t *noise = json_object(), *likelihood = json_object();
    set(root, "model", json_string(models[r->model]));
    set(noise, "mm", td_json_real(1e3 * r->robot_m));
    set(noise, "deg", td_json_real(DEGREES * r->robot_rad));
    set(noise, "sigma_mm", td_json_real(1e3 * r->sigma_robot_m));
    set(noise, "sigma_deg", td_json_real(DEGREES * r->sigma_robot_rad));
    set(root, "robot_noise", noise);
    if (r->model == TD_ROBOT_FIELD) {
        json_t *field = json_object();
        set(field, "mm", td_json_real(1e3 * r->field_m));
        set(field, "deg", td_json_real(DEGREES * r->field_rad));
        set(field, "length_m", td_json_real(r->field_length_m));
        set(root, "robot_field", field);
    }
    for (int i = 0; i < 3; i++) set(likelihood, models[i], td_json_real(r->log_likelihood[i]));
    set(root, "log_likelihood", likelihood);
}

static void set_leave_one_out(json_t *root, const hand_eye_job *job)
{
    json_t *o = json_object();
    set(o, "rms_px", td_json_real(job->total_held_out_px));
    set(o, "rms_mm", td_json_real(job->result->held_out_mm));
    set(o, "rms_deg", td_json_real(job->result->held_out_deg));
    set(o, "floor_px", td_json_real(job->floor_px));
    set(o, "floor_mm", td_json_real(job->floor_mm));
    set(o, "floor_deg", td_json_real(job->floor_deg));
    set(root, "leave_one_out", o);
}

static void set_comparisons(json_t *root, const hand_eye_job *job)
{
    const td_hand_eye *r = job->result;
    if (job->plain) {
        td_pose inverse = td_pose_inverse(&r->x), apart = td_pose_compose(&inverse, &job->plain->x);
        json_t *plain = json_object();
        set(plain, "apart_mm", td_json_real(1e3 * td_pose_distance(&apart)));
        set(plain, "apart_deg", td_json_real(DEGREES * td_pose_angle(&apart)));
        set(root, "plain", plain);
    }
    if (job->has_offset) {
        set(root, "time_offset_s", td_json_real(job->offset_s));
        set(root, "sigma_time_offset_s", td_json_real(job->sigma_offset_s));
    }
    if (!job->has_advice) return;
    json_t *advice = json_object(), *pose = json_object();
    set(pose, "q", td_json_reals(job->advice.base_from_hand.q, 4));
    set(pose, "t_m", td_json_reals(job->advice.base_from_hand.t, 3));
    set(advice, "text", json_string(job->advice.text));
    set(advice, "base_from_hand", pose);
    set(advice, "sigma_mm", td_json_real(job->advice.sigma_x_mm));
    set(advice, "sigma_deg", td_json_real(job->advice.sigma_x_deg));
    set(root, "advice", advice);
}

static json_t *order_json(void)
{
    static const char *const parts[] = {"rx", "ry", "rz", "tx", "ty", "tz"};
    json_t *list = json_array();
    for (int i = 0; i < 12; i++)
        json_array_append_new(list, json_sprintf("%s.%s", i < 6 ? "x" : "z", parts[i % 6]));
    return list;
}

json_t *hand_eye_result(const hand_eye_job *job)
{
    const td_hand_eye *r = job->result;
    json_t *root = json_object(), *reasons = json_array(), *views = json_object(), *outliers = json_array(),
           *weak = json_array(), *mistakes = json_array();
    set(root, "job", json_string("hand-eye"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "dataset", json_string(job->dataset->name));
    set(root, "setup", json_string(td_hand_eye_setup_name(r->setup)));
    set(root, "cameras", json_string(job->rig_from));
    set(root, "verdict", json_string(verdict_name(job->gate.verdict)));
    for (size_t i = 0; i < job->gate.count; i++)
        json_array_append_new(reasons, json_string(job->gate.reason[i]));
    set(root, "reasons", reasons);
    set(root, "x", transform_json(td_hand_eye_x_name(r->setup), &r->x, r->sigma_x_mm, r->sigma_x_deg));
    set(root, "z", transform_json(td_hand_eye_z_name(r->setup), &r->z, r->sigma_z_mm, r->sigma_z_deg));
    set(root, "order", order_json());
    set(root, "covariance", td_json_matrix(r->covariance, 12, 12));
    set(root, "views", json_integer((json_int_t)r->view_count));
    set(root, "used_views", json_integer((json_int_t)r->used));
    set(root, "rms_px", td_json_real(job->total_rms_px));
    set_robot(root, r);
    set_leave_one_out(root, job);
    set(root, "scale", td_json_real(r->scale));
    set(root, "sigma_scale", td_json_real(r->sigma_scale));
    set_comparisons(root, job);
    set(root, "solvers", solvers_json(job));
    set(root, "best_solver",
        job->best < 0 ? json_null() : json_string(td_hand_eye_solver_name((td_hand_eye_solver)job->best)));
    for (size_t v = 0; v < job->count; v++) {
        set(views, job->view[v].name, view_json(job, v));
        if (!r->view[v].used) json_array_append_new(outliers, json_string(job->view[v].name));
    }
    set(root, "per_view", views);
    set(root, "outlier_views", outliers);
    for (size_t i = 0; i < r->weak_count; i++) json_array_append_new(weak, json_string(r->weak[i]));
    set(root, "weak_directions", weak);
    for (size_t i = 0; i < job->mistake_count; i++)
        json_array_append_new(mistakes, json_string(job->mistake[i].text));
    set(root, "mistakes", mistakes);
    set(root, "products",
        json_pack("{s:s, s:s, s:s}", "result", "result.yaml", "report", "report.html", "log", "log.jsonl"));
    return root;
}
