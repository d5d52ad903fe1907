/* The next pose of the robot: the one whose view would tell most of X. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

#define DEGREE 0.017453292519943295

/* What the views so far show to be visible: the target's direction from the rig and its tilt. */
typedef struct reach {
    double off_axis, tilt; /* rad, largest so far */
} reach;

static double direction_angle(const td_pose *rig_from_target)
{
    const double *t = rig_from_target->t;
    return atan2(hypot(t[0], t[1]), t[2]);
}

static double tilt_angle(const td_pose *rig_from_target)
{
    double z[3] = {0, 0, 1}, normal[3];
    const double *t = rig_from_target->t;
    td_pose_rotate(normal, rig_from_target, z);
    double c = (normal[0] * t[0] + normal[1] * t[1] + normal[2] * t[2]) /
               fmax(td_pose_distance(rig_from_target), 1e-12);
    return acos(fmin(fmax(fabs(c), 0), 1));
}

/* Covariance (12,12) of X and Z after one more view of the robot at `hand`, seen as `like` was. */
static bool with_view(double out[144], const td_hand_eye *result, const td_hand_eye_view *like,
                      const td_pose *hand)
{
    bool swapped = result->setup == TD_EYE_TO_HAND;
    td_hand_eye_view seen = *like;
    seen.base_from_hand = *hand;
    seen.rig_from_target = td_hand_eye_predict(result->setup, &result->x, &result->z, hand);
    td_he_view view;
    td_he_state state = {swapped ? result->z : result->x, swapped ? result->x : result->z, 1};
    double g[6], j[72], order[72], s[36], jc[72], inverse[36], gain[72], log_det;
    td_he_canonical(&view, &seen, 1, result->setup);
    td_he_linearise_view(g, j, s, &view, &state, 12);
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 12; b++) order[12 * a + b] = j[12 * a + (swapped ? (b + 6) % 12 : b)];
    td_multiply(jc, order, result->covariance, 6, 12, 12);
    double through[36];
    td_multiply_transposed(through, jc, order, 6, 12, 6);
    for (int k = 0; k < 36; k++) s[k] += through[k];
    for (int k = 0; k < 6; k++)
        s[7 * k] += k < 3 ? result->robot_rad * result->robot_rad + result->field_rad * result->field_rad
                          : result->robot_m * result->robot_m + result->field_m * result->field_m;
    for (int k = 0; k < 6; k++) s[7 * k] += TD_HE_LEAST_SIGMA * TD_HE_LEAST_SIGMA;
    if (!td_he_invert(inverse, &log_det, s, 6)) return false;
    td_multiply(gain, inverse, jc, 6, 6, 12);
    for (int a = 0; a < 12; a++)
        for (int b = 0; b < 12; b++) {
            double less = 0;
            for (int k = 0; k < 6; k++) less += jc[12 * k + a] * gain[12 * k + b];
            out[12 * a + b] = result->covariance[12 * a + b] - less;
        }
    return true;
}

/* log-determinant of X's covariance: twice the entropy, but for a constant. */
static double entropy_of_x(const double covariance[144])
{
    double block[36], inverse[36], log_det;
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 6; b++) block[6 * a + b] = covariance[12 * a + b];
    return td_he_invert(inverse, &log_det, block, 6) ? log_det : INFINITY;
}

static void worst_axes(td_hand_eye_advice *advice, const td_hand_eye *result, const double covariance[144])
{
    td_hand_eye with = *result;
    double origin[144], value[3];
    memcpy(with.covariance, covariance, sizeof with.covariance);
    td_he_origin_covariance(origin, &with);
    for (int part = 0; part < 2; part++) {
        double block[9], sigma = NAN;
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) block[3 * a + b] = origin[12 * (3 * part + a) + 3 * part + b];
        if (td_eigen_symmetric(value, NULL, block, 3, NULL) == TD_OK) sigma = sqrt(fmax(value[2], 0));
        if (part)
            advice->sigma_x_mm = 1e3 * sigma;
        else
            advice->sigma_x_deg = sigma / DEGREE;
    }
}

static bool visible(const td_hand_eye *result, const td_pose *hand, const reach *seen)
{
    td_pose p = td_hand_eye_predict(result->setup, &result->x, &result->z, hand);
    return direction_angle(&p) < seen->off_axis + 3 * DEGREE &&
           tilt_angle(&p) < fmax(seen->tilt, 35 * DEGREE);
}

static reach reach_of(const td_hand_eye *result)
{
    reach seen = {0, 0};
    for (size_t i = 0; i < result->view_count; i++)
        if (result->view[i].used) {
            seen.off_axis = fmax(seen.off_axis, direction_angle(&result->view[i].predicted));
            seen.tilt = fmax(seen.tilt, tilt_angle(&result->view[i].predicted));
        }
    return seen;
}

/* Tries the turns of one view's pose about the hand's axes. */
static void try_view(td_hand_eye_advice *advice, double *least, const td_hand_eye *result,
                     const td_hand_eye_view *view, const reach *seen)
{
    static const int angle[8] = {10, -10, 20, -20, 30, -30, 40, -40};
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 8; k++) {
            double xi[6] = {0}, covariance[144];
            xi[axis] = angle[k] * DEGREE;
            td_pose turn = td_pose_exp(xi), hand = td_pose_compose(&view->base_from_hand, &turn);
            if (!visible(result, &hand, seen) || !with_view(covariance, result, view, &hand)) continue;
            double entropy = entropy_of_x(covariance);
            if (!(entropy < *least - 1e-9)) continue;
            *least = entropy;
            advice->base_from_hand = hand;
            worst_axes(advice, result, covariance);
            snprintf(advice->text, sizeof advice->text,
                     "from view %s turn the hand by %d degrees about its %c axis", view->name, angle[k],
                     "xyz"[axis]);
        }
}

td_status td_hand_eye_advise(td_hand_eye_advice *advice, const td_hand_eye *result,
                             const td_hand_eye_view *view, size_t count, td_error *error)
{
    if (count != result->view_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "%zu views given for a result of %zu", count,
                       result->view_count);
    reach seen = reach_of(result);
    double least = INFINITY;
    *advice = (td_hand_eye_advice){0};
    for (size_t i = 0; i < count; i++)
        if (result->view[i].used) try_view(advice, &least, result, &view[i], &seen);
    if (isinf(least))
        return td_fail(error, TD_ERROR_DATA,
                       "no turn of the hand by 10 to 40 degrees keeps the target in view");
    return TD_OK;
}
