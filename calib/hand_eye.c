/* Hand-eye calibration from end to end: checks, start, views, variances, model, result. */
#include "calib/hand_eye.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

#define DEGREE 0.017453292519943295

enum { FIELD_LEAST_VIEWS = 10 };

td_hand_eye_options td_hand_eye_options_default(td_hand_eye_setup setup)
{
    return (td_hand_eye_options){
        .setup = setup, .model = TD_ROBOT_AUTO, .outlier_sigma = 4, .leave_one_out = true};
}

static bool pose_is_sound(const td_pose *pose)
{
    double length = 0;
    for (int k = 0; k < 4; k++) length += pose->q[k] * pose->q[k];
    return fabs(length - 1) < 1e-6 && isfinite(pose->t[0] + pose->t[1] + pose->t[2]);
}

static td_status check(const td_hand_eye_view *view, size_t count, const td_hand_eye_options *o,
                       td_error *error)
{
    if ((int)o->setup < 0 || o->setup >= TD_HAND_EYE_SETUP_COUNT)
        return td_fail(error, TD_ERROR_ARGUMENT, "options.setup: no such setup: %d", (int)o->setup);
    if ((int)o->model < 0 || o->model > TD_ROBOT_AUTO)
        return td_fail(error, TD_ERROR_ARGUMENT, "options.model: no such model: %d", (int)o->model);
    if (!(o->outlier_sigma >= 0) || isinf(o->outlier_sigma))
        return td_fail(error, TD_ERROR_ARGUMENT, "options.outlier_sigma: %g; 0 (none left out) or more",
                       o->outlier_sigma);
    if (o->start && (!pose_is_sound(&o->start[0]) || !pose_is_sound(&o->start[1])))
        return td_fail(error, TD_ERROR_ARGUMENT, "options.start: not two poses");
    for (size_t i = 0; i < count; i++) {
        const td_hand_eye_view *v = &view[i];
        if (!pose_is_sound(&v->base_from_hand) || !pose_is_sound(&v->rig_from_target))
            return td_fail(error, TD_ERROR_DATA,
                           "view %s: %s is not a pose (a unit quaternion and three numbers)", v->name,
                           pose_is_sound(&v->base_from_hand) ? "rig_from_target" : "base_from_hand");
        bool sound = true;
        for (int a = 0; a < 6; a++)
            for (int b = 0; b < 6; b++) {
                double limit = sqrt(v->covariance[7 * a] * v->covariance[7 * b]);
                sound = sound && isfinite(v->covariance[6 * a + b]) &&
                        fabs(v->covariance[6 * a + b]) <= limit * (1 + 1e-6) &&
                        fabs(v->covariance[6 * a + b] - v->covariance[6 * b + a]) <= 1e-6 * limit;
            }
        if (!sound)
            return td_fail(error, TD_ERROR_DATA,
                           "view %s: covariance is not one (finite, symmetric, none beyond its variances)",
                           v->name);
    }
    return TD_OK;
}

/* The start asked for, or a closed form's. */
static td_status begin(td_he_state *state, const td_he_view *view, size_t n, const td_hand_eye_options *o,
                       td_error *error)
{
    if (!o->start) return td_he_start(state, view, n, error);
    bool swapped = o->setup == TD_EYE_TO_HAND;
    *state = (td_he_state){o->start[swapped], o->start[!swapped], 1};
    return TD_OK;
}

static void take(td_he_fit *to, td_he_fit *from)
{
    td_he_fit_free(to);
    *to = *from;
    *from = (td_he_fit){0};
}

/* The field from the fit with independent noise, at two lengths: a share of the working space, and all of
 * it. The likelihood may have a maximum at each. */
static td_status fit_field(td_he_fit *best, const td_he_view *view, size_t n, const td_he_fit *independent,
                           td_error *error)
{
    static const double share[2] = {0.3, 1.5};
    double spread = 0, mean[3] = {0};
    td_status status = TD_ERROR_DATA;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) mean[k] += view[i].hand.t[k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) spread += pow(view[i].hand.t[k] - mean[k], 2) / (double)n;
    *best = (td_he_fit){0};
    for (int k = 0; k < 2; k++) {
        td_he_fit fit;
        td_he_variance v = {.count = 5};
        for (int c = 0; c < 2; c++) {
            v.log[c] = independent->variance.log[c] + log(0.5);
            v.log[2 + c] = independent->variance.log[c] + log(0.9);
        }
        v.log[4] = log(fmax(sqrt(spread), 1e-3) * share[k]);
        if (td_he_fit_run(&fit, view, n, &independent->state, &v, independent->linear.p > 12, error) ==
                TD_OK &&
            (status != TD_OK || fit.gls.minus_two_log < best->gls.minus_two_log - 1e-6)) {
            take(best, &fit);
            status = TD_OK;
        }
        td_he_fit_free(&fit);
    }
    return status;
}

static double log_likelihood(const td_he_fit *fit)
{
    double rows = 6 * (double)fit->linear.n - fit->linear.p;
    return -0.5 * fit->gls.minus_two_log - 0.5 * rows * log(6.283185307179586);
}

/* The model, from the fit with independent noise over the used views. The field is chosen when it raises -2
 * log L by more than its three parameters cost by Schwarz's criterion (BIC): 3 log(6 n - 12). */
static td_status choose_model(td_hand_eye *result, td_he_fit *fit, td_he_view *view, size_t *used,
                              const td_hand_eye_options *o, td_error *error)
{
    bool wanted = o->model == TD_ROBOT_FIELD || (o->model == TD_ROBOT_AUTO && *used >= FIELD_LEAST_VIEWS);
    result->model = TD_ROBOT_INDEPENDENT;
    result->log_likelihood[TD_ROBOT_INDEPENDENT] = log_likelihood(fit);
    if (o->model == TD_ROBOT_EXACT) {
        td_he_fit exact;
        td_he_variance none = {.count = 0};
        td_status status = td_he_fit_run(&exact, view, *used, &fit->state, &none, fit->linear.p > 12, error);
        if (status == TD_OK) take(fit, &exact);
        td_he_fit_free(&exact);
        result->model = TD_ROBOT_EXACT;
        result->log_likelihood[TD_ROBOT_EXACT] = log_likelihood(fit);
        return status;
    }
    if (wanted && *used > TD_HE_FIELD_MOST_VIEWS) {
        td_log_write(o->log, TD_LOG_WARNING, "hand-eye",
                     "%zu views are too many for an error field (%d at most): independent noise is assumed",
                     *used, (int)TD_HE_FIELD_MOST_VIEWS);
        wanted = false;
    }
    if (!wanted) return TD_OK;
    td_he_fit field;
    td_status status = fit_field(&field, view, *used, fit, error);
    if (status == TD_OK) {
        double cost = 3 * log(6 * (double)*used - 12);
        result->log_likelihood[TD_ROBOT_FIELD] = log_likelihood(&field);
        if (o->model == TD_ROBOT_FIELD || fit->gls.minus_two_log - field.gls.minus_two_log > cost) {
            result->model = TD_ROBOT_FIELD;
            take(fit, &field);
        }
    }
    td_he_fit_free(&field);
    if (o->model == TD_ROBOT_AUTO) status = TD_OK;
    return status;
}

static void put_poses(td_hand_eye *result, const td_he_fit *fit)
{
    bool swapped = result->setup == TD_EYE_TO_HAND;
    int p = fit->linear.p;
    result->x = swapped ? fit->state.far : fit->state.near;
    result->z = swapped ? fit->state.near : fit->state.far;
    for (int a = 0; a < 12; a++)
        for (int b = 0; b < 12; b++) {
            int i = swapped ? (a + 6) % 12 : a, k = swapped ? (b + 6) % 12 : b;
            result->covariance[12 * a + b] = fit->gls.cov[i * p + k];
        }
    double origin[144],
        *out[4] = {&result->sigma_x_deg, &result->sigma_x_mm, &result->sigma_z_deg, &result->sigma_z_mm};
    td_he_origin_covariance(origin, result);
    for (int part = 0; part < 4; part++) {
        double block[9], value[3];
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) block[3 * a + b] = origin[12 * (3 * part + a) + 3 * part + b];
        *out[part] = td_eigen_symmetric(value, NULL, block, 3, NULL) == TD_OK
                         ? sqrt(fmax(value[2], 0)) * (part % 2 ? 1e3 : 1 / DEGREE)
                         : NAN;
    }
}

static void put_variances(td_hand_eye *result, const td_he_fit *fit)
{
    const td_he_variance *v = &fit->variance;
    if (v->count) {
        result->robot_rad = exp(v->log[0]);
        result->robot_m = exp(v->log[1]);
        result->sigma_robot_rad = td_he_sigma_of(&fit->gls, v, 0);
        result->sigma_robot_m = td_he_sigma_of(&fit->gls, v, 1);
    }
    if (v->count > 2) {
        result->field_rad = exp(v->log[2]);
        result->field_m = exp(v->log[3]);
        result->field_length_m = exp(v->log[4]);
    }
}

/* The target's scale beside everything else, whether X and Z are to follow it or not. */
static void put_scale(td_hand_eye *result, const td_he_fit *fit, const td_he_view *view, size_t used)
{
    td_he_fit other = {0};
    const td_he_fit *from = fit;
    if (fit->linear.p == 12) {
        if (used < 4 || td_he_fit_run(&other, view, used, &fit->state, &fit->variance, true, NULL) != TD_OK) {
            td_he_fit_free(&other);
            return;
        }
        from = &other;
    }
    result->scale = from->state.scale;
    result->sigma_scale = sqrt(from->gls.cov[12 * 13 + 12]);
    td_he_fit_free(&other);
}

/* rig_from_target from which the seen one is off by r at the hand, in the base's axes: the sight
 * Exp(Ad(near^-1) r) near_from_far, back at the target's given size. */
static td_pose sight_less(const td_he_view *view, const td_he_fit *fit, const double r[6],
                          td_hand_eye_setup setup)
{
    td_pose base = {.q = {view->hand.q[0], view->hand.q[1], view->hand.q[2], view->hand.q[3]}};
    td_pose turn = td_pose_inverse(&base), near_back = td_pose_inverse(&fit->state.near), sight = view->sight;
    double d[6], adjoint[36], xi[6];
    td_pose_rotate(d, &turn, r);
    td_pose_rotate(d + 3, &turn, r + 3);
    td_pose_adjoint(adjoint, &near_back);
    td_multiply(xi, adjoint, d, 6, 6, 1);
    for (int k = 0; k < 3; k++) sight.t[k] *= fit->state.scale;
    sight = td_pose_perturb(&sight, xi);
    for (int k = 0; k < 3; k++) sight.t[k] /= fit->state.scale;
    return setup == TD_EYE_TO_HAND ? td_pose_inverse(&sight) : sight;
}

/* How far the target is off: its origin and its rotation. */
static void apart(double *mm, double *deg, const td_pose *a, const td_pose *b)
{
    double square = 0;
    for (int k = 0; k < 3; k++) square += (a->t[k] - b->t[k]) * (a->t[k] - b->t[k]);
    td_pose back = td_pose_inverse(b), off = td_pose_compose(a, &back);
    *mm = 1e3 * sqrt(square);
    *deg = td_pose_angle(&off) / DEGREE;
}

static void put_view(td_hand_eye *result, const td_hand_eye_view *view, const td_he_fit *fit,
                     const td_he_view *inside, size_t place, size_t used, const td_hand_eye_options *o)
{
    td_hand_eye_fit *out = &result->view[inside->index];
    const td_pose *seen = &view[inside->index].rig_from_target;
    double r[6], cov[36], scale = fit->state.scale;
    out->used = place < used;
    td_he_residual(out->residual, inside, &fit->state);
    out->predicted =
        td_hand_eye_predict(result->setup, &result->x, &result->z, &view[inside->index].base_from_hand);
    for (int k = 0; k < 3; k++) out->predicted.t[k] /= scale;
    apart(&out->target_mm, &out->target_deg, &out->predicted, seen);
    out->held_out = out->predicted;
    out->held_out_mm = out->held_out_deg = out->deviate = NAN;
    bool known = true;
    if (out->used)
        known = td_he_held_out(r, cov, fit, place);
    else
        td_he_predict_new(r, cov, fit, inside);
    if (known) out->deviate = td_he_deviate(td_he_distance(r, cov), 0);
    if (known && (o->leave_one_out || !out->used)) {
        out->held_out = sight_less(inside, fit, r, result->setup);
        apart(&out->held_out_mm, &out->held_out_deg, &out->held_out, seen);
    }
    if (!out->used)
        snprintf(
            out->remark, sizeof out->remark,
            "view %s: %.3g mm and %.2g degrees off the others, %.1f standard deviations: left out; take it "
            "again with the robot at rest, or check its pose and image",
            view[inside->index].name, out->held_out_mm, out->held_out_deg, out->deviate);
}

static void put_views(td_hand_eye *result, const td_hand_eye_view *view, const td_he_fit *fit,
                      const td_he_view *inside, size_t used, const td_hand_eye_options *o)
{
    double mm = 0, deg = 0;
    for (size_t i = 0; i < result->view_count; i++) {
        put_view(result, view, fit, &inside[i], i, used, o);
        td_hand_eye_fit *out = &result->view[inside[i].index];
        if (!out->used) {
            td_log_write(o->log, TD_LOG_WARNING, "hand-eye", "%s", out->remark);
            continue;
        }
        mm += out->held_out_mm * out->held_out_mm / (double)used;
        deg += out->held_out_deg * out->held_out_deg / (double)used;
    }
    result->held_out_mm = sqrt(mm);
    result->held_out_deg = sqrt(deg);
}

/* The fit with independent noise again, with the scale as one parameter more. */
static td_status free_scale(td_he_fit *fit, const td_he_view *view, size_t used, td_error *error)
{
    td_he_fit other;
    td_status status = td_he_fit_run(&other, view, used, &fit->state, &fit->variance, true, error);
    if (status == TD_OK) take(fit, &other);
    td_he_fit_free(&other);
    return status;
}

static td_status estimate(td_hand_eye *result, td_he_fit *fit, td_he_view *inside,
                          const td_hand_eye_view *view, size_t count, const td_hand_eye_options *o,
                          td_error *error)
{
    td_he_state start;
    size_t used;
    td_he_canonical(inside, view, count, o->setup);
    TD_TRY(td_he_check_motion(inside, count, o->setup, error));
    TD_TRY(begin(&start, inside, count, o, error));
    TD_TRY(td_he_choose_views(fit, inside, count, &used, &start, o->outlier_sigma, error));
    if (!td_progress_report(o->progress, "choosing the robot's model", 1, 2))
        return td_fail(error, TD_ERROR_CANCELLED, "the hand-eye calibration was interrupted");
    if (o->free_scale) TD_TRY(free_scale(fit, inside, used, error));
    TD_TRY(choose_model(result, fit, inside, &used, o, error));
    if ((result->model == TD_ROBOT_FIELD || o->free_scale) && o->outlier_sigma > 0)
        td_he_drop_views(fit, inside, &used, count - count / 3 < 4 ? 4 : count - count / 3, o->outlier_sigma);
    result->used = used;
    put_poses(result, fit);
    put_variances(result, fit);
    put_scale(result, fit, inside, used);
    put_views(result, view, fit, inside, used, o);
    td_he_find_weak(result);
    (void)td_progress_report(o->progress, "choosing the robot's model", 2, 2);
    return TD_OK;
}

td_status td_hand_eye_solve(td_hand_eye **out, const td_hand_eye_view *view, size_t count,
                            const td_hand_eye_options *options, td_error *error)
{
    td_hand_eye_options o = options ? *options : td_hand_eye_options_default(TD_EYE_IN_HAND);
    *out = NULL;
    TD_TRY(check(view, count, &o, error));
    td_hand_eye *result = calloc(1, sizeof *result);
    td_he_view *inside = calloc(count ? count : 1, sizeof *inside);
    td_he_fit fit = {0};
    td_status status = TD_ERROR_MEMORY;
    if (result) result->view = calloc(count ? count : 1, sizeof *result->view);
    if (!result || !inside || !result->view) {
        (void)td_fail(error, status, "no memory for %zu views", count);
    } else {
        result->setup = o.setup;
        result->view_count = count;
        result->scale = result->sigma_scale = NAN;
        for (int k = 0; k < 3; k++) result->log_likelihood[k] = NAN;
        status = estimate(result, &fit, inside, view, count, &o, error);
    }
    td_he_fit_free(&fit);
    free(inside);
    if (status != TD_OK) td_hand_eye_free(&result);
    *out = result;
    return status;
}

void td_hand_eye_free(td_hand_eye **result)
{
    if (!*result) return;
    free((*result)->view);
    free(*result);
    *result = NULL;
}
