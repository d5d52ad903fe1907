/* The result of a camera-to-vehicle calibration as a document, its schema, and the verdict. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/vehicle_internal.h"
#include "core/document.h"
#include "core/rig_formats.h"

#define DEGREES 57.29577951308232
/* A mean this many of its sigmas off is no chance. */
#define ZERO_SIGMAS 5.0

const gate_row vehicle_gate_defaults[] = {
    {"sigma_tip_mm", 15, 30,
     "sigma at the tool's tip, the worst of the working space, reading of the joints included: a trench is "
     "dug to 30 mm, and joints read to 0.05 degrees alone make 8 mm at the reach of 10 m"},
    {"sigma_mm", 5, 15, "sigma of the rig's position, worst axis: half of what the tip may have"},
    {"sigma_deg", 0.1, 0.3, "sigma of its rotation, worst axis; 0.1 degrees are 17 mm at 10 m"},
    {"chi2_per_dof", 1.5, 4,
     "square of the residuals over what the sigmas promise: above 1, pixels or joints are noisier than said, "
     "and every sigma is too small by its root"},
    {"outlier_share", 0.05, 0.25, "sights left out over sights"},
};
const size_t vehicle_gate_count = sizeof vehicle_gate_defaults / sizeof *vehicle_gate_defaults;

const td_schema_row vehicle_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "vehicle"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"dataset", TD_SCHEMA_OBJECT, true, false, "what it is from"},
    {"dataset.name", TD_SCHEMA_STRING, true, false, "as the dataset says"},
    {"dataset.sha256", TD_SCHEMA_STRING, true, false, "of description, robot, rig, tables and images"},
    {"robot", TD_SCHEMA_STRING, true, false, "name of the robot"},
    {"mount", TD_SCHEMA_STRING, true, false, "link that carries the rig"},
    {"vehicle", TD_SCHEMA_STRING, true, false, "link whose frame is the vehicle's"},
    {"tip", TD_SCHEMA_STRING, true, false, "link whose origin is the tool's tip"},
    {"method", TD_SCHEMA_STRING, true, false, "joint (all poses and cameras at once) or closed (--closed)"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"vehicle_from_rig", TD_SCHEMA_OBJECT, true, true, "null: not determined; see null_directions"},
    {"vehicle_from_rig.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"vehicle_from_rig.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},
    {"vehicle_from_rig.sigma_mm", TD_SCHEMA_REAL, true, true, "of t_m, worst axis; null: closed way"},
    {"vehicle_from_rig.sigma_deg", TD_SCHEMA_REAL, true, true, "of the rotation, worst axis"},
    {"vehicle_from_rig.urdf", TD_SCHEMA_STRING, true, false, "as URDF's origin"},
    {"vehicle_from_rig.ros", TD_SCHEMA_STRING, true, false, "as arguments of static_transform_publisher"},
    {"order", TD_SCHEMA_STRINGS, true, false, "of the covariance: left perturbation of vehicle_from_rig"},
    {"covariance", TD_SCHEMA_MATRIX, true, true, "rad and m, in the vehicle's frame"},
    {"closed", TD_SCHEMA_OBJECT, true, true,
     "the closed way, pose by pose; null: no pose shows two cameras six known points"},
    {"closed.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"closed.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},
    {"closed.apart_mm", TD_SCHEMA_REAL, true, true, "from vehicle_from_rig"},
    {"closed.apart_deg", TD_SCHEMA_REAL, true, true, "from vehicle_from_rig"},
    {"closed.poses", TD_SCHEMA_INT, true, false, "that its mean is over"},
    {"sigma_tip_mm", TD_SCHEMA_OBJECT, true, false,
     "where the cameras see the tip against where the joints say it is, over the working space, worst axis"},
    {"sigma_tip_mm.worst", TD_SCHEMA_REAL, true, true, "mm"},
    {"sigma_tip_mm.median", TD_SCHEMA_REAL, true, true, "mm"},
    {"null_directions", TD_SCHEMA_STRINGS, true, false, "what is not determined, and what to do"},
    {"weak_directions", TD_SCHEMA_STRINGS, true, false, "what is known badly, and what to do"},
    {"joint_offsets", TD_SCHEMA_OBJECT, true, false, "added to the readings, by joint"},
    {"joint_offsets.*", TD_SCHEMA_OBJECT, true, false, "a joint"},
    {"joint_offsets.*.held", TD_SCHEMA_BOOL, true, false, "taken as 0: not asked for with --offsets"},
    {"joint_offsets.*.rad", TD_SCHEMA_REAL, false, false, "of a joint that turns"},
    {"joint_offsets.*.sigma_rad", TD_SCHEMA_REAL, false, true, "null: free and not determined"},
    {"joint_offsets.*.m", TD_SCHEMA_REAL, false, false, "of a joint that slides"},
    {"joint_offsets.*.sigma_m", TD_SCHEMA_REAL, false, true, "null: free and not determined"},
    {"points", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"points.*", TD_SCHEMA_OBJECT, true, false, "a point"},
    {"points.*.link", TD_SCHEMA_STRING, true, false, "on which it is"},
    {"points.*.place_m", TD_SCHEMA_REALS, true, true, "in the link's frame"},
    {"points.*.sigma_m", TD_SCHEMA_REALS, true, true, "0: exact"},
    {"points.*.sights", TD_SCHEMA_INT, true, false, "used"},
    {"points.*.rms_px", TD_SCHEMA_REAL, true, true, "of their residuals"},
    {"boards", TD_SCHEMA_OBJECT, false, false, "by name"},
    {"boards.*", TD_SCHEMA_OBJECT, true, false, "a board on a link, or on the ground"},
    {"boards.*.link", TD_SCHEMA_STRING, true, false, "on which it is"},
    {"boards.*.q", TD_SCHEMA_REALS, true, false, "of link_from_target, unit quaternion w x y z"},
    {"boards.*.t_m", TD_SCHEMA_REALS, true, false, "of link_from_target, m"},
    {"boards.*.sigma_mm", TD_SCHEMA_REAL, true, true, "of t_m, worst axis; 0: exact"},
    {"boards.*.sigma_deg", TD_SCHEMA_REAL, true, true, "of the rotation, worst axis; 0: exact"},
    {"per_pose", TD_SCHEMA_OBJECT, true, false, "by frame"},
    {"per_pose.*", TD_SCHEMA_OBJECT, true, false, "a pose of the arm"},
    {"per_pose.*.sights", TD_SCHEMA_INT, true, false, "used"},
    {"per_pose.*.left_out", TD_SCHEMA_INT, true, false, "sights that do not fit"},
    {"per_pose.*.rms_px", TD_SCHEMA_REAL, true, true, "of the residuals, with the pose's joint noise"},
    {"per_pose.*.noise_sigmas", TD_SCHEMA_REAL, true, true, "largest of the joints' noise, in its sigmas"},
    {"poses", TD_SCHEMA_INT, true, false, "of the arm"},
    {"sights", TD_SCHEMA_INT, true, false, "a point in an image"},
    {"rms_px", TD_SCHEMA_REAL, true, true, "2-D, over the sights used"},
    {"chi2_per_dof", TD_SCHEMA_REAL, true, true, "1 where the sigmas are right; null: no redundancy"},
    {"outliers", TD_SCHEMA_INT, true, false, "sights left out"},
    {"outlier_sights", TD_SCHEMA_STRINGS, true, false, "frame/camera/point"},
    {"advice", TD_SCHEMA_ARRAY, false, false, "arm poses that would help most, each after those before"},
    {"advice[].text", TD_SCHEMA_STRING, true, false, "in words"},
    {"advice[].joints", TD_SCHEMA_OBJECT, true, false, "rad or m, by joint"},
    {"advice[].joints.*", TD_SCHEMA_REAL, true, false, "reading"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t vehicle_schema_count = sizeof vehicle_schema / sizeof *vehicle_schema;

/* ---- Verdict ---- */

/* A joint whose zero is held and whose noise is no noise: its mean over the poses is many times what a mean
 * of that many readings may be. */
static void judge_zeros(gate_result *g, const vehicle_job *job)
{
    const td_vehicle_data *d = &job->data;
    size_t n = (size_t)job->robot->joint_count;
    for (size_t j = 0; j < n; j++) {
        const char *name = job->robot->joint[j].name;
        double mean = 0, one = d->sigma_q[j] / sqrt((double)d->pose_count);
        for (size_t k = 0; k < d->pose_count; k++)
            mean += job->result->noise[k * n + j] / (double)d->pose_count;
        if (d->offset_prior[j] == 0 && fabs(mean) > ZERO_SIGMAS * one)
            gate_add(
                g, VERDICT_WARNED,
                "the noise of joint %s does not average out over the poses (%.0f sigmas): its zero, or one "
                "next to it, may be wrong: ask for it (--offsets %s=1)",
                name, fabs(mean) / one, name);
    }
}

static void judge_figures(gate_result *g, const gate_row *rows, const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    size_t n = vehicle_gate_count;
    double share = (double)r->outliers / (double)job->data.sight_count;
    gate_check(g, rows, n, "sigma_tip_mm", r->sigma_tip_worst_mm,
               "at the tip the cameras and the joints agree to %.1f mm only (one sigma, where it is worst; "
               "median %.1f mm): add arm poses (--advise names them), or read the joints better",
               r->sigma_tip_worst_mm, r->sigma_tip_median_mm);
    gate_check(
        g, rows, n, "sigma_mm", r->sigma_mm,
        "the rig's position on the vehicle is known to %.1f mm only; show the points in more and other "
        "poses of the arm",
        r->sigma_mm);
    gate_check(g, rows, n, "sigma_deg", r->sigma_deg,
               "the rig's rotation is known to %.3f degrees only; show the points in more and other poses of "
               "the arm",
               r->sigma_deg);
    if (isnan(r->chi2_per_dof))
        gate_add(g, VERDICT_WARNED, "as many numbers are sought as seen: no residual can show a mistake");
    else
        gate_check(g, rows, n, "chi2_per_dof", r->chi2_per_dof,
                   "residuals are %.1f times what the sigmas of pixels and joints promise: say what they are "
                   "(sigma_px, sigma_deg), or ask for joint offsets (--offsets)",
                   sqrt(r->chi2_per_dof));
    gate_check(g, rows, n, "outlier_share", share, "%zu of %zu sights were left out", r->outliers,
               job->data.sight_count);
    judge_zeros(g, job);
    for (size_t i = 0; i < r->weak_count; i++) gate_add(g, VERDICT_WARNED, "%s", r->weak[i]);
    if (!job->rig->covariance)
        gate_add(g, VERDICT_WARNED,
                 "the rig's file holds no covariance: the error of the cameras' calibration is not in these "
                 "sigmas");
}

void vehicle_judge(vehicle_job *job, const gate_row *rows)
{
    gate_result *g = &job->gate;
    const td_vehicle *r = job->result;
    *g = (gate_result){.verdict = VERDICT_ACCEPTED};
    for (size_t i = 0; i < r->null_count; i++)
        gate_add(g, VERDICT_REFUSED, "not determined: %s", r->null_direction[i]);
    if (job->how->closed)
        gate_add(g, VERDICT_WARNED,
                 "the closed way alone: no sigma is known, nothing was judged; leave out --closed");
    else if (!r->null_count)
        judge_figures(g, rows, job);
    job->wanted = !r->null_count && (g->verdict != VERDICT_REFUSED || job->how->accept);
}

/* ---- Document ---- */

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static void set_text(json_t *object, const char *key, char *text)
{
    set(object, key, json_string(text ? text : ""));
    free(text);
}

static json_t *strings(const char (*text)[320], size_t count)
{
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(list, json_string(text[i]));
    return list;
}

static json_t *transform_json(const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    if (r->null_count) return json_null();
    json_t *o = json_object();
    set(o, "q", td_json_reals(r->vehicle_from_rig.q, 4));
    set(o, "t_m", td_json_reals(r->vehicle_from_rig.t, 3));
    set(o, "sigma_mm", td_json_real(r->sigma_mm));
    set(o, "sigma_deg", td_json_real(r->sigma_deg));
    set_text(o, "urdf", td_pose_to_urdf(&r->vehicle_from_rig));
    set_text(o, "ros", td_pose_to_ros(&r->vehicle_from_rig, job->robot->link[job->data.vehicle].name, "rig"));
    return o;
}

static json_t *closed_json(const td_vehicle *r)
{
    if (!r->closed_poses) return json_null();
    td_pose inverse = td_pose_inverse(&r->vehicle_from_rig), apart = td_pose_compose(&inverse, &r->closed);
    json_t *o = json_object();
    set(o, "q", td_json_reals(r->closed.q, 4));
    set(o, "t_m", td_json_reals(r->closed.t, 3));
    set(o, "apart_mm", td_json_real(r->null_count ? NAN : 1e3 * td_pose_distance(&apart)));
    set(o, "apart_deg", td_json_real(r->null_count ? NAN : DEGREES * td_pose_angle(&apart)));
    set(o, "poses", json_integer((json_int_t)r->closed_poses));
    return o;
}

static json_t *order_json(void)
{
    static const char *const parts[] = {"rx", "ry", "rz", "tx", "ty", "tz"};
    json_t *list = json_array();
    for (int i = 0; i < 6; i++) json_array_append_new(list, json_string(parts[i]));
    return list;
}

static json_t *offsets_json(const vehicle_job *job)
{
    json_t *all = json_object();
    for (int j = 0; j < job->robot->joint_count; j++) {
        bool shift = job->robot->joint[j].kind == TD_JOINT_PRISMATIC;
        bool held = job->data.offset_prior[j] == 0;
        json_t *o = json_object();
        set(o, "held", json_boolean(held));
        set(o, shift ? "m" : "rad", td_json_real(job->result->offset[j]));
        set(o, shift ? "sigma_m" : "sigma_rad",
            td_json_real(held                                          ? 0
                         : job->how->closed || job->result->null_count ? NAN
                                                                       : job->result->sigma_offset[j]));
        set(all, job->robot->joint[j].name, o);
    }
    return all;
}

/* Root mean square of the residuals of one pose, or of one point; how many sights were used and left out. */
static double rms_of(size_t *used, size_t *left_out, const vehicle_job *job, long pose, int point)
{
    double sum = 0;
    *used = *left_out = 0;
    for (size_t s = 0; s < job->data.sight_count; s++) {
        const td_vehicle_sight *sight = &job->data.sight[s];
        const double *r = job->result->residual[s];
        if ((pose >= 0 && sight->pose != (size_t)pose) || (point >= 0 && sight->point != point)) continue;
        if (job->result->left_out[s]) {
            ++*left_out;
            continue;
        }
        ++*used;
        sum += r[0] * r[0] + r[1] * r[1];
    }
    return *used ? sqrt(sum / (double)*used) : NAN;
}

double vehicle_pose_rms(size_t *used, size_t *left_out, const vehicle_job *job, size_t pose)
{
    return rms_of(used, left_out, job, (long)pose, -1);
}

double vehicle_point_rms(size_t *used, size_t *left_out, const vehicle_job *job, int point)
{
    return rms_of(used, left_out, job, -1, point);
}

double vehicle_noise_sigmas(const vehicle_job *job, size_t pose)
{
    double most = 0;
    size_t n = (size_t)job->robot->joint_count;
    if (job->how->closed) return NAN;
    for (size_t j = 0; j < n; j++)
        if (job->data.sigma_q[j] > 0)
            most = fmax(most, fabs(job->result->noise[pose * n + j]) / job->data.sigma_q[j]);
    return most;
}

static json_t *points_json(const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    json_t *all = json_object();
    for (int p = 0; p < job->data.point_count; p++) {
        const td_vehicle_point *point = &job->data.point[p];
        const double *place = job->how->closed ? point->place : r->place[p];
        double sigma[3];
        size_t used, left_out;
        for (int i = 0; i < 3; i++)
            sigma[i] = r->null_count && point->sigma[i] > 0 ? NAN
                       : job->how->closed                   ? point->sigma[i]
                                                            : r->sigma_place[p][i];
        json_t *o = json_object();
        double rms = vehicle_point_rms(&used, &left_out, job, p);
        set(o, "link", json_string(job->robot->link[point->link].name));
        set(o, "place_m", td_json_reals(place, 3));
        set(o, "sigma_m", td_json_reals(sigma, 3));
        set(o, "sights", json_integer((json_int_t)used));
        set(o, "rms_px", td_json_real(rms));
        set(all, point->name, o);
    }
    return all;
}

static json_t *boards_json(const vehicle_job *job)
{
    json_t *all = json_object();
    bool known = !job->how->closed && !job->result->null_count;
    for (int b = 0; b < job->data.board_count; b++) {
        const td_vehicle_board *board = &job->data.board[b];
        const td_pose *pose = job->how->closed ? &board->link_from_board : &job->result->link_from_board[b];
        json_t *o = json_object();
        set(o, "link", json_string(job->robot->link[board->link].name));
        set(o, "q", td_json_reals(pose->q, 4));
        set(o, "t_m", td_json_reals(pose->t, 3));
        set(o, "sigma_mm", td_json_real(known ? 1e3 * job->result->sigma_board[b][1] : NAN));
        set(o, "sigma_deg", td_json_real(known ? DEGREES * job->result->sigma_board[b][0] : NAN));
        set(all, board->name, o);
    }
    return all;
}

static json_t *poses_json(const vehicle_job *job)
{
    json_t *all = json_object();
    for (size_t k = 0; k < job->data.pose_count; k++) {
        json_t *o = json_object();
        size_t used, left_out;
        double rms = vehicle_pose_rms(&used, &left_out, job, k);
        set(o, "sights", json_integer((json_int_t)used));
        set(o, "left_out", json_integer((json_int_t)left_out));
        set(o, "rms_px", td_json_real(rms));
        set(o, "noise_sigmas", td_json_real(vehicle_noise_sigmas(job, k)));
        set(all, job->pose_name[k], o);
    }
    return all;
}

static json_t *outliers_json(const vehicle_job *job)
{
    json_t *list = json_array();
    for (size_t s = 0; s < job->data.sight_count; s++) {
        const td_vehicle_sight *sight = &job->data.sight[s];
        if (job->result->left_out[s])
            json_array_append_new(list, json_sprintf("%s/%s/%s", job->pose_name[sight->pose],
                                                     job->rig->camera[sight->camera].name,
                                                     job->data.point[sight->point].name));
    }
    return list;
}

static json_t *advice_json(const vehicle_job *job)
{
    json_t *list = json_array();
    for (size_t i = 0; i < job->advice_count; i++) {
        json_t *o = json_object(), *q = json_object();
        for (int j = 0; j < job->robot->joint_count; j++)
            set(q, job->robot->joint[j].name, td_json_real(job->advice_q[i][j]));
        set(o, "text", json_string(job->advice[i]));
        set(o, "joints", q);
        json_array_append_new(list, o);
    }
    return list;
}

json_t *vehicle_provenance(const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    json_t *o = json_object();
    set(o, "version", json_string(TD_VERSION));
    set(o, "dataset", json_pack("{s:s, s:s}", "name", job->dataset->name, "sha256", job->hash));
    set(o, "robot", json_string(job->robot->name));
    set(o, "mount", json_string(job->robot->link[job->data.mount].name));
    set(o, "vehicle", json_string(job->robot->link[job->data.vehicle].name));
    set(o, "method", json_string(job->how->closed ? "closed" : "joint"));
    set(o, "verdict", json_string(verdict_name(job->gate.verdict)));
    set(o, "rms_px", td_json_real(r->rms_px));
    if (job->how->closed) return o;
    set(o, "sigma_mm", td_json_real(r->sigma_mm));
    set(o, "sigma_deg", td_json_real(r->sigma_deg));
    set(o, "order", order_json());
    set(o, "covariance", td_json_matrix(r->covariance, 6, 6));
    return o;
}

static void set_head(json_t *root, const vehicle_job *job)
{
    const td_robot *robot = job->robot;
    json_t *reasons = json_array();
    set(root, "job", json_string("vehicle"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "dataset", json_pack("{s:s, s:s}", "name", job->dataset->name, "sha256", job->hash));
    set(root, "robot", json_string(robot->name));
    set(root, "mount", json_string(robot->link[job->data.mount].name));
    set(root, "vehicle", json_string(robot->link[job->data.vehicle].name));
    set(root, "tip", json_string(robot->link[job->tip].name));
    set(root, "method", json_string(job->how->closed ? "closed" : "joint"));
    set(root, "verdict", json_string(verdict_name(job->gate.verdict)));
    for (size_t i = 0; i < job->gate.count; i++)
        json_array_append_new(reasons, json_string(job->gate.reason[i]));
    set(root, "reasons", reasons);
}

json_t *vehicle_result(const vehicle_job *job)
{
    const td_vehicle *r = job->result;
    bool known = !job->how->closed && !r->null_count;
    json_t *root = json_object(), *tip = json_object(), *products = json_object();
    set_head(root, job);
    set(root, "vehicle_from_rig", transform_json(job));
    set(root, "order", order_json());
    set(root, "covariance", known ? td_json_matrix(r->covariance, 6, 6) : json_null());
    set(root, "closed", closed_json(r));
    set(tip, "worst", td_json_real(known ? r->sigma_tip_worst_mm : NAN));
    set(tip, "median", td_json_real(known ? r->sigma_tip_median_mm : NAN));
    set(root, "sigma_tip_mm", tip);
    set(root, "null_directions", strings((const char(*)[320])r->null_direction, r->null_count));
    set(root, "weak_directions", strings((const char(*)[320])r->weak, r->weak_count));
    set(root, "joint_offsets", offsets_json(job));
    set(root, "points", points_json(job));
    if (job->data.board_count) set(root, "boards", boards_json(job));
    set(root, "per_pose", poses_json(job));
    set(root, "poses", json_integer((json_int_t)job->data.pose_count));
    set(root, "sights", json_integer((json_int_t)job->data.sight_count));
    set(root, "rms_px", td_json_real(r->rms_px));
    set(root, "chi2_per_dof", td_json_real(r->chi2_per_dof));
    set(root, "outliers", json_integer((json_int_t)r->outliers));
    set(root, "outlier_sights", outliers_json(job));
    if (job->advice_count) set(root, "advice", advice_json(job));
    set(products, "result", json_string("result.yaml"));
    set(products, "report", json_string("report.html"));
    set(products, "log", json_string("log.jsonl"));
    if (job->wanted) set(products, "rig", json_string("rig.yaml"));
    set(root, "products", products);
    return root;
}
