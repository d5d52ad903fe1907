/* The result of a calibration as a document, and its schema. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "apps/calibrate_internal.h"
#include "core/document.h"
#include "core/linalg.h"
#include "core/stereo.h"

#define DEGREES 57.29577951308232

const td_schema_row calibrate_schema[] = {
    {"job", TD_SCHEMA_STRING, true, false, "calibrate"},
    {"version", TD_SCHEMA_STRING, true, false, "of teledimos"},
    {"dataset", TD_SCHEMA_OBJECT, true, false, "what was calibrated from"},
    {"dataset.name", TD_SCHEMA_STRING, true, false, "its name"},
    {"dataset.sha256", TD_SCHEMA_STRING, true, false, "of its description and images"},
    {"dataset.target", TD_SCHEMA_STRING, true, false, "kind and size of the target"},
    {"options", TD_SCHEMA_OBJECT, true, false, "how"},
    {"options.method", TD_SCHEMA_STRING, true, false, "of the first estimate"},
    {"options.plain", TD_SCHEMA_BOOL, true, false, "least squares on pixels, no outlier rejection, no warp"},
    {"options.warp", TD_SCHEMA_STRING, true, false, "auto, on or off"},
    {"options.held", TD_SCHEMA_STRINGS, true, false, "what was held at given values"},
    {"cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"cameras.*", TD_SCHEMA_OBJECT, true, false, "a camera"},
    {"cameras.*.model", TD_SCHEMA_STRING, true, false, "pinhole, brown5, brown8 or fisheye"},
    {"cameras.*.width_px", TD_SCHEMA_INT, true, false, "of its images"},
    {"cameras.*.height_px", TD_SCHEMA_INT, true, false, "of its images"},
    {"cameras.*.rms_px", TD_SCHEMA_REAL, true, true, "sqrt(sum of squared residuals / points), used points"},
    {"cameras.*.mono_rms_px", TD_SCHEMA_REAL, true, true, "the same when calibrated alone, all points"},
    {"cameras.*.noise_px", TD_SCHEMA_REAL, true, false,
     "standard deviation common to its points beyond their own, per coordinate"},
    {"cameras.*.views", TD_SCHEMA_INT, true, false, "used"},
    {"cameras.*.points", TD_SCHEMA_INT, true, false, "used"},
    {"cameras.*.outlier_points", TD_SCHEMA_INT, true, false, "seen and left out"},
    {"cameras.*.order", TD_SCHEMA_STRINGS, true, false, "names of the intrinsics, then of the distortion"},
    {"cameras.*.intrinsics", TD_SCHEMA_REALS, true, false, "fx fy cx cy, px"},
    {"cameras.*.distortion", TD_SCHEMA_REALS, true, false, "the model's coefficients"},
    {"cameras.*.sigma_intrinsics", TD_SCHEMA_REALS, true, true, "standard deviations, px"},
    {"cameras.*.sigma_distortion", TD_SCHEMA_REALS, true, true, "standard deviations"},
    {"cameras.*.camera_from_rig", TD_SCHEMA_OBJECT, true, false,
     "pose; the rig's frame is the first camera's"},
    {"cameras.*.camera_from_rig.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"cameras.*.camera_from_rig.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},
    {"cameras.*.perspective_matrix", TD_SCHEMA_MATRIX, true, false,
     "P = K [R t] of undistorted pixels, from the rig's frame"},
    {"cameras.*.coverage", TD_SCHEMA_OBJECT, true, false, "what its views cover"},
    {"cameras.*.coverage.image_share", TD_SCHEMA_REAL, true, false,
     "of 12x9 cells of the image that hold points"},
    {"cameras.*.coverage.nearest_m", TD_SCHEMA_REAL, true, true, "distance of the nearest board's centre"},
    {"cameras.*.coverage.farthest_m", TD_SCHEMA_REAL, true, true, "distance of the farthest board's centre"},
    {"cameras.*.coverage.tilt_deg", TD_SCHEMA_REAL, true, true, "the largest between board and image"},
    {"cameras.*.coverage.tilted", TD_SCHEMA_OBJECT, true, false,
     "views with one side of the board farther away than the other by 15 degrees or more"},
    {"cameras.*.coverage.tilted.right", TD_SCHEMA_INT, true, false, "its right side"},
    {"cameras.*.coverage.tilted.left", TD_SCHEMA_INT, true, false, "its left side"},
    {"cameras.*.coverage.tilted.lower", TD_SCHEMA_INT, true, false, "its lower side"},
    {"cameras.*.coverage.tilted.upper", TD_SCHEMA_INT, true, false, "its upper side"},
    {"cameras.*.coverage.missing", TD_SCHEMA_STRING, true, false, "what to add; empty: nothing"},
    {"cameras.*.models", TD_SCHEMA_OBJECT, false, false, "lens models, judged by views held out"},
    {"cameras.*.models.best", TD_SCHEMA_STRING, true, false, "the simplest that predicts as well as any"},
    {"cameras.*.models.text", TD_SCHEMA_STRING, true, false, "in words"},
    {"cameras.*.models.held_out_px", TD_SCHEMA_OBJECT, true, false, "RMS of views held out, by model"},
    {"cameras.*.models.held_out_px.*", TD_SCHEMA_REAL, true, true, "null: it cannot be fitted"},
    {"projected_uncertainty", TD_SCHEMA_OBJECT, false, false,
     "standard deviation of projected points, the worst direction; uncertainty.csv has the map"},
    {"projected_uncertainty.distances_m", TD_SCHEMA_REALS, true, false,
     "of the points: the nearest board, the middle, the farthest, ten times that"},
    {"projected_uncertainty.cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"projected_uncertainty.cameras.*", TD_SCHEMA_OBJECT, true, false, "a camera"},
    {"projected_uncertainty.cameras.*.median_px", TD_SCHEMA_REALS, true, true,
     "over its image, at each distance"},
    {"projected_uncertainty.cameras.*.largest_px", TD_SCHEMA_REALS, true, true,
     "in its image, at each distance"},
    {"stereo", TD_SCHEMA_OBJECT, false, false, "the second camera relative to the first"},
    {"pairs", TD_SCHEMA_OBJECT, false, false,
     "each camera relative to the first, by name; more than two cameras"},
    {"pairs.*", TD_SCHEMA_OBJECT, true, false, "as stereo"},
#define PAIR_ROWS(prefix)                                                                                    \
    {prefix ".first", TD_SCHEMA_STRING, true, false, "camera"},                                              \
        {prefix ".second", TD_SCHEMA_STRING, true, false, "camera"},                                         \
        {prefix ".views", TD_SCHEMA_INT, true, false, "in which both saw the target"},                       \
        {prefix ".rms_px", TD_SCHEMA_REAL, true, true, "over the used points of both"},                      \
        {prefix ".baseline_m", TD_SCHEMA_REAL, true, false, "distance of the centres"},                      \
        {prefix ".sigma_baseline_m", TD_SCHEMA_REAL, true, true, "standard deviation"},                      \
        {prefix ".rotation_deg", TD_SCHEMA_REAL, true, false, "angle of the relative rotation"},             \
        {prefix ".sigma_rotation_deg", TD_SCHEMA_REALS, true, true,                                          \
         "standard deviations about the second camera's x y z"},                                             \
        {prefix ".second_from_first", TD_SCHEMA_OBJECT, true, false, "relative pose"},                       \
        {prefix ".second_from_first.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},            \
        {prefix ".second_from_first.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},                   \
        {prefix ".epipolar_error_px", TD_SCHEMA_REAL, true, true,                                            \
         "mean of the distances to both epipolar lines, added"},                                             \
        {prefix ".essential_matrix", TD_SCHEMA_MATRIX, true, false,                                          \
         "y2^T E y1 = 0, normalised coordinates"},                                                           \
    {                                                                                                        \
        prefix ".fundamental_matrix", TD_SCHEMA_MATRIX, true, false,                                         \
            "x2^T F x1 = 0, undistorted pixels; unit norm"                                                   \
    }
    PAIR_ROWS("stereo"),
    PAIR_ROWS("pairs.*"),
#undef PAIR_ROWS
    {"rms_px", TD_SCHEMA_REAL, true, false, "over all used points"},
    {"chi2_per_dof", TD_SCHEMA_REAL, true, true, "weighted squares over degrees of freedom"},
    {"warp", TD_SCHEMA_OBJECT, false, false, "bulge of the board, when significant"},
    {"warp.warp_m", TD_SCHEMA_REALS, true, false,
     "at the middle against the edges, along its columns and rows"},
    {"warp.sigma_warp_m", TD_SCHEMA_REALS, true, false, "standard deviations"},
    {"board", TD_SCHEMA_OBJECT, false, false,
     "its errors, when significant, RMS along one axis; every sigma and covariance takes them into account"},
    {"board.print_error_m", TD_SCHEMA_REAL, true, false, "of points, the same in all views"},
    {"board.bend_m", TD_SCHEMA_REAL, true, false, "along its normal, anew in each view"},
    {"board.stretch_m", TD_SCHEMA_REAL, true, false,
     "in its plane, linear over the board, anew in each view"},
    {"board.ripple_m", TD_SCHEMA_REAL, true, false,
     "in its plane, of degree 2 and 3 over the board, anew in each view"},
    {"leave_one_out", TD_SCHEMA_OBJECT, true, false, "views held out in turn"},
    {"leave_one_out.views", TD_SCHEMA_INT, true, false, "held out; 0: too few"},
    {"leave_one_out.rms_px", TD_SCHEMA_REAL, true, true, "residual of held-out views, their pose fitted"},
    {"leave_one_out.scale_error", TD_SCHEMA_REAL, true, true, "mean relative error of triangulated size"},
    {"leave_one_out.scale_error_rms", TD_SCHEMA_REAL, true, true, "the same, root mean square over views"},
    {"leave_one_out.flatness_m", TD_SCHEMA_REAL, true, true,
     "RMS of triangulated points off the target's surface"},
    {"views", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"views.*", TD_SCHEMA_OBJECT, true, false, "a view"},
    {"views.*.state", TD_SCHEMA_STRING, true, false, "used, corrected, outlier or unseen"},
    {"views.*.remark", TD_SCHEMA_STRING, false, false, "why"},
    {"views.*.rig_from_target", TD_SCHEMA_OBJECT, false, false, "pose of the target"},
    {"views.*.rig_from_target.q", TD_SCHEMA_REALS, true, false, "unit quaternion w x y z"},
    {"views.*.rig_from_target.t_m", TD_SCHEMA_REALS, true, false, "translation, m"},
    {"views.*.sigma_rotation_deg", TD_SCHEMA_REALS, false, true,
     "standard deviations about x y z of the rig"},
    {"views.*.sigma_t_m", TD_SCHEMA_REALS, false, true, "standard deviations along x y z of the rig"},
    {"views.*.cameras", TD_SCHEMA_OBJECT, true, false, "by name"},
    {"views.*.cameras.*", TD_SCHEMA_OBJECT, true, false, "the view in a camera"},
    {"views.*.cameras.*.rms_px", TD_SCHEMA_REAL, true, true, "over all seen points, used or not"},
    {"views.*.cameras.*.points", TD_SCHEMA_INT, true, false, "seen"},
    {"views.*.cameras.*.outliers", TD_SCHEMA_INT, true, false, "of them left out"},
    {"views.*.cameras.*.blur_px", TD_SCHEMA_REAL, true, true, "standard deviation of the edges' blur"},
    {"views.*.cameras.*.reason", TD_SCHEMA_STRING, false, false, "why the target was not found"},
    {"outlier_views", TD_SCHEMA_STRINGS, true, false, "names"},
    {"corrected_views", TD_SCHEMA_STRINGS, true, false, "names; their numbering was put right"},
    {"outlier_points", TD_SCHEMA_ARRAY, true, false, "single points left out"},
    {"outlier_points[].view", TD_SCHEMA_STRING, true, false, "name"},
    {"outlier_points[].camera", TD_SCHEMA_STRING, true, false, "name"},
    {"outlier_points[].point", TD_SCHEMA_INT, true, false, "number in the target"},
    {"outlier_points[].residual_px", TD_SCHEMA_REAL, true, false, "length of its residual"},
    {"weak_directions", TD_SCHEMA_STRINGS, true, false, "what the views do not determine, and what to do"},
    {"sigma_conditional", TD_SCHEMA_BOOL, true, false, "true: sigmas take held values as exact"},
    {"verdict", TD_SCHEMA_STRING, true, false, "accepted, warned or refused"},
    {"reasons", TD_SCHEMA_STRINGS, true, false, "sentences behind the verdict"},
    {"products", TD_SCHEMA_OBJECT, true, false, "files in the result's folder"},
    {"products.*", TD_SCHEMA_STRING, true, false, "file name"},
};
const size_t calibrate_schema_count = sizeof calibrate_schema / sizeof *calibrate_schema;

static void set(json_t *object, const char *key, json_t *value)
{
    json_object_set_new(object, key, value);
}

static json_t *pose_json(const td_pose *pose)
{
    json_t *o = json_object();
    set(o, "q", td_json_reals(pose->q, 4));
    set(o, "t_m", td_json_reals(pose->t, 3));
    return o;
}

static json_t *sigmas_json(const double *sigma, size_t count, double factor)
{
    double scaled[TD_CAMERA_MAX_PARAMETERS];
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(sigma[i])) return json_null();
        scaled[i] = sigma[i] * factor;
    }
    return td_json_reals(scaled, count);
}

static json_t *coverage_json(const td_coverage *k)
{
    static const char *const sides[TD_COVERAGE_TILTS] = {"right", "left", "lower", "upper"};
    json_t *o = json_object(), *tilted = json_object();
    for (int i = 0; i < TD_COVERAGE_TILTS; i++) set(tilted, sides[i], json_integer((json_int_t)k->tilted[i]));
    set(o, "image_share", td_json_real(k->image_share));
    set(o, "nearest_m", td_json_real(k->nearest_m));
    set(o, "farthest_m", td_json_real(k->farthest_m));
    set(o, "tilt_deg", td_json_real(k->tilt_rad * DEGREES));
    set(o, "tilted", tilted);
    set(o, "missing", json_string(k->missing));
    return o;
}

static json_t *models_json(const td_model_choice *choice)
{
    json_t *o = json_object(), *held_out = json_object();
    for (int i = 0; i < TD_CAMERA_MODEL_COUNT; i++)
        set(held_out, td_camera_model_name(choice->score[i].model),
            td_json_real(choice->score[i].failed ? NAN : choice->score[i].held_out_px));
    set(o, "best", json_string(td_camera_model_name(choice->best)));
    set(o, "text", json_string(choice->text));
    set(o, "held_out_px", held_out);
    return o;
}

static json_t *uncertainty_json(const calibrate_job *job)
{
    const td_uncertainty_map *map = job->trust->map;
    json_t *o = json_object(), *cameras = json_object();
    set(o, "distances_m", td_json_reals(map->distance_m, (size_t)map->distance_count));
    for (int c = 0; c < map->camera_count; c++) {
        json_t *k = json_object();
        double median[TD_CAMERA_MAX_PARAMETERS], most[TD_CAMERA_MAX_PARAMETERS];
        for (int d = 0; d < map->distance_count; d++) median[d] = calibrate_map_median(map, c, d, &most[d]);
        set(k, "median_px", sigmas_json(median, (size_t)map->distance_count, 1));
        set(k, "largest_px", sigmas_json(most, (size_t)map->distance_count, 1));
        set(cameras, job->calibration->rig->camera[c].name, k);
    }
    set(o, "cameras", cameras);
    return o;
}

static json_t *camera_json(const calibrate_job *job, int index)
{
    const td_rig_camera *rc = &job->calibration->rig->camera[index];
    const td_calibrated_camera *cc = &job->calibration->camera[index];
    size_t count = (size_t)td_camera_parameter_count(rc->camera.model);
    json_t *o = json_object(), *order = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(order, json_string(td_camera_parameter_name(rc->camera.model, (int)i)));
    set(o, "model", json_string(td_camera_model_name(rc->camera.model)));
    set(o, "width_px", json_integer(rc->camera.width));
    set(o, "height_px", json_integer(rc->camera.height));
    set(o, "rms_px", td_json_real(cc->rms_px));
    set(o, "mono_rms_px", td_json_real(cc->mono_rms_px));
    set(o, "noise_px", td_json_real(cc->noise_px));
    set(o, "views", json_integer((json_int_t)cc->views));
    set(o, "points", json_integer((json_int_t)cc->points));
    set(o, "outlier_points", json_integer((json_int_t)cc->outlier_points));
    set(o, "order", order);
    set(o, "intrinsics", td_json_reals(rc->camera.parameter, 4));
    set(o, "distortion", td_json_reals(rc->camera.parameter + 4, count - 4));
    set(o, "sigma_intrinsics", sigmas_json(cc->sigma, 4, 1));
    set(o, "sigma_distortion", sigmas_json(cc->sigma + 4, count - 4, 1));
    set(o, "coverage", coverage_json(&job->trust->coverage[index]));
    if (job->trust->has_choice[index]) set(o, "models", models_json(&job->trust->choice[index]));
    set(o, "camera_from_rig", pose_json(&rc->camera_from_rig));
    double p[12];
    td_perspective_matrix(p, &rc->camera, &rc->camera_from_rig);
    set(o, "perspective_matrix", td_json_matrix(p, 3, 4));
    return o;
}

static json_t *pair_json(const td_rig *rig, const td_calibrated_pair *p)
{
    json_t *o = json_object();
    set(o, "first", json_string(rig->camera[p->first].name));
    set(o, "second", json_string(rig->camera[p->second].name));
    set(o, "views", json_integer((json_int_t)p->pairs));
    set(o, "rms_px", td_json_real(p->rms_px));
    set(o, "baseline_m", td_json_real(p->baseline_m));
    set(o, "sigma_baseline_m", td_json_real(p->sigma_baseline_m));
    set(o, "rotation_deg", td_json_real(p->rotation_rad * DEGREES));
    set(o, "sigma_rotation_deg", sigmas_json(p->sigma_rotation_rad, 3, DEGREES));
    set(o, "second_from_first", pose_json(&p->second_from_first));
    set(o, "epipolar_error_px", td_json_real(p->epipolar_error_px));
    set(o, "essential_matrix", td_json_matrix(p->essential, 3, 3));
    set(o, "fundamental_matrix", td_json_matrix(p->fundamental, 3, 3));
    return o;
}

static json_t *view_json(const calibrate_job *job, size_t v)
{
    static const char *const states[] = {"unseen", "used", "outlier", "corrected"};
    const td_calibrated_view *view = &job->calibration->view[v];
    const td_observations *obs = job->observations;
    json_t *o = json_object(), *cameras = json_object();
    set(o, "state", json_string(states[view->state]));
    if (view->remark[0]) set(o, "remark", json_string(view->remark));
    if (view->state == TD_VIEW_USED || view->state == TD_VIEW_CORRECTED) {
        set(o, "rig_from_target", pose_json(&view->rig_from_target));
        set(o, "sigma_rotation_deg", sigmas_json(view->sigma, 3, DEGREES));
        set(o, "sigma_t_m", sigmas_json(view->sigma + 3, 3, 1));
    }
    for (int c = 0; c < obs->camera_count; c++) {
        const td_detection *d = td_observations_get(obs, v, c);
        if (!d->found && !d->reason[0]) continue; /* no image */
        json_t *k = json_object();
        set(k, "rms_px", td_json_real(view->rms_px[c]));
        set(k, "points", json_integer((json_int_t)view->points[c]));
        set(k, "outliers", json_integer((json_int_t)view->outliers[c]));
        set(k, "blur_px", td_json_real(d->blur_px));
        if (!d->found) set(k, "reason", json_string(d->reason));
        set(cameras, obs->camera[c].name, k);
    }
    set(o, "cameras", cameras);
    return o;
}

static json_t *outlier_points_json(const calibrate_job *job)
{
    enum { MOST = 1000 };
    const td_calibration *c = job->calibration;
    const td_observations *obs = job->observations;
    size_t points = td_target_point_count(&obs->target);
    json_t *list = json_array();
    for (size_t v = 0; v < c->view_count; v++)
        for (int k = 0; k < obs->camera_count; k++) {
            if (c->view[v].outliers[k] == c->view[v].points[k]) continue; /* the whole view is named */
            for (size_t p = 0; p < points && json_array_size(list) < MOST; p++) {
                size_t i = (v * (size_t)obs->camera_count + (size_t)k) * points + p;
                const double *r = c->residual + 2 * i;
                if (c->used[i] || !isfinite(r[0])) continue;
                json_t *o = json_object();
                set(o, "view", json_string(obs->view_name[v]));
                set(o, "camera", json_string(obs->camera[k].name));
                set(o, "point", json_integer((json_int_t)p));
                set(o, "residual_px", td_json_real(hypot(r[0], r[1])));
                json_array_append_new(list, o);
            }
        }
    return list;
}

static json_t *view_names(const calibrate_job *job, td_view_state state)
{
    json_t *list = json_array();
    for (size_t v = 0; v < job->calibration->view_count; v++)
        if (job->calibration->view[v].state == state)
            json_array_append_new(list, json_string(job->observations->view_name[v]));
    return list;
}

static json_t *options_json(const calibrate_job *job)
{
    static const char *const warps[] = {"auto", "off", "on"};
    json_t *o = json_object(), *held = json_array();
    for (int c = 0; c < job->observations->camera_count; c++) {
        static const char *const parts[] = {"intrinsics", "distortion", "pose"};
        for (int b = 0; b < 3; b++)
            if (job->options->hold[c] >> b & 1)
                json_array_append_new(held,
                                      json_sprintf("%s.%s", job->observations->camera[c].name, parts[b]));
    }
    set(o, "method", json_string(td_estimate_method_name(job->options->method)));
    set(o, "plain", json_boolean(job->options->plain));
    set(o, "warp", json_string(warps[job->options->warp]));
    set(o, "held", held);
    return o;
}

static json_t *dataset_json(const calibrate_job *job)
{
    char target[160];
    json_t *o = json_object();
    set(o, "name", json_string(job->dataset->name));
    set(o, "sha256", json_string(job->hash));
    set(o, "target", json_string(td_target_describe(target, sizeof target, &job->dataset->target)));
    return o;
}

json_t *calibrate_provenance(const calibrate_job *job)
{
    json_t *o = json_object();
    set(o, "job", json_string("calibrate"));
    set(o, "version", json_string(TD_VERSION));
    set(o, "dataset", dataset_json(job));
    set(o, "options", options_json(job));
    set(o, "rms_px", td_json_real(job->calibration->rms_px));
    set(o, "verdict", json_string(verdict_name(job->gate->verdict)));
    return o;
}

json_t *calibrate_result(const calibrate_job *job)
{
    const td_calibration *c = job->calibration;
    json_t *root = json_object(), *cameras = json_object(), *views = json_object(), *weak = json_array(),
           *reasons = json_array(), *loo = json_object(), *products = json_object();
    set(root, "job", json_string("calibrate"));
    set(root, "version", json_string(TD_VERSION));
    set(root, "dataset", dataset_json(job));
    set(root, "options", options_json(job));
    set(root, "verdict", json_string(verdict_name(job->gate->verdict)));
    for (size_t i = 0; i < job->gate->count; i++)
        json_array_append_new(reasons, json_string(job->gate->reason[i]));
    set(root, "reasons", reasons);
    set(root, "rms_px", td_json_real(c->rms_px));
    set(root, "chi2_per_dof", td_json_real(c->chi2_per_dof));
    for (int i = 0; i < c->rig->count; i++) set(cameras, c->rig->camera[i].name, camera_json(job, i));
    set(root, "cameras", cameras);
    if (c->pair_count) set(root, "stereo", pair_json(c->rig, &c->pair[0]));
    if (c->pair_count > 1) {
        json_t *pairs = json_object();
        for (size_t i = 0; i < c->pair_count; i++)
            set(pairs, c->rig->camera[c->pair[i].second].name, pair_json(c->rig, &c->pair[i]));
        set(root, "pairs", pairs);
    }
    if (c->has_warp) {
        json_t *warp = json_object();
        set(warp, "warp_m", td_json_reals(c->warp_m, 2));
        set(warp, "sigma_warp_m", td_json_reals(c->sigma_warp_m, 2));
        set(root, "warp", warp);
    }
    if (c->board.significant) {
        json_t *board = json_object();
        set(board, "print_error_m", td_json_real(c->board.print_m));
        set(board, "bend_m", td_json_real(c->board.bend_m));
        set(board, "stretch_m", td_json_real(c->board.stretch_m));
        set(board, "ripple_m", td_json_real(c->board.ripple_m));
        set(root, "board", board);
    }
    set(loo, "views", json_integer((json_int_t)c->leave_one_out.views));
    bool done = c->leave_one_out.views > 0;
    set(loo, "rms_px", done ? td_json_real(c->leave_one_out.rms_px) : json_null());
    set(loo, "scale_error", done ? td_json_real(c->leave_one_out.scale_error) : json_null());
    set(loo, "scale_error_rms", done ? td_json_real(c->leave_one_out.scale_error_rms) : json_null());
    set(loo, "flatness_m", done ? td_json_real(c->leave_one_out.flatness_m) : json_null());
    set(root, "leave_one_out", loo);
    if (job->trust->map) set(root, "projected_uncertainty", uncertainty_json(job));
    set(root, "outlier_views", view_names(job, TD_VIEW_OUTLIER));
    set(root, "corrected_views", view_names(job, TD_VIEW_CORRECTED));
    set(root, "outlier_points", outlier_points_json(job));
    for (size_t i = 0; i < c->weak_count; i++) json_array_append_new(weak, json_string(c->weak[i].text));
    set(root, "weak_directions", weak);
    set(root, "sigma_conditional", json_boolean(!c->covariance_known));
    for (size_t v = 0; v < c->view_count; v++) set(views, job->observations->view_name[v], view_json(job, v));
    set(root, "views", views);
    static const char *const product[][2] = {
        {"rig", "rig.yaml"},      {"result", "result.yaml"},          {"report", "report.html"},
        {"points", "points.csv"}, {"uncertainty", "uncertainty.csv"}, {"log", "log.jsonl"}};
    for (size_t i = 0; i < sizeof product / sizeof *product; i++)
        if (job->trust->map || strcmp(product[i][0], "uncertainty") != 0)
            set(products, product[i][0], json_string(product[i][1]));
    set(root, "products", products);
    return root;
}
