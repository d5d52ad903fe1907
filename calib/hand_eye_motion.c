/* What the hand's motions leave open: before the solve by the motions alone, after it by the covariance. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "calib/hand_eye_internal.h"
#include "core/linalg.h"

#define DEGREE 0.017453292519943295

/* A direction is weak when it is known no better than this. */
static const double limit_rad = 2 * DEGREE, limit_m = 0.020;

static const double same_rad = 0.02 * DEGREE, same_m = 1e-4; /* poses nearer than this are one */
static const double least_turn = 0.5 * DEGREE;

static td_pose relative(const td_he_view *a, const td_he_view *b)
{
    td_pose back = td_pose_inverse(&a->hand);
    return td_pose_compose(&back, &b->hand);
}

/* Number of different poses, up to `enough`. */
static size_t different_poses(const td_he_view *view, size_t n, size_t enough)
{
    size_t count = 0;
    for (size_t i = 0; i < n && count < enough; i++) {
        bool seen = false;
        for (size_t k = 0; k < i && !seen; k++) {
            td_pose d = relative(&view[k], &view[i]);
            seen = td_pose_angle(&d) < same_rad && td_pose_distance(&d) < same_m;
        }
        count += !seen;
    }
    return count;
}

/* Second moments (rad^2) of the rotation vectors between views, in the hand's frame, and the largest turn. */
static double turns(double value[3], double vector[9], const td_he_view *view, size_t n)
{
    double moment[9] = {0}, largest = 0;
    size_t count = 0, stride = 1 + n / 60;
    for (size_t i = 0; i < n; i++)
        for (size_t k = i + 1; k < n; k += stride, count++) {
            td_pose d = relative(&view[i], &view[k]);
            double w[3];
            td_rotation_log(w, d.q);
            largest = fmax(largest, td_pose_angle(&d));
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) moment[3 * a + b] += w[a] * w[b];
        }
    for (int a = 0; a < 9; a++) moment[a] /= (double)(count ? count : 1);
    if (td_eigen_symmetric(value, vector, moment, 3, NULL) != TD_OK) largest = 0;
    return largest;
}

/* A direction of unit length to be read by people: its largest component positive, no -0.00. */
static void clean_axis(double axis[3], const double v[3])
{
    int most = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(v[k]) > fabs(v[most]) + 1e-9) most = k;
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) * (v[most] < 0 ? -1 : 1);
    for (int k = 0; k < 3; k++) axis[k] = fabs(v[k]) < 0.005 * fabs(length) ? 0 : v[k] / length;
}

td_status td_he_check_motion(const td_he_view *view, size_t n, td_hand_eye_setup setup, td_error *error)
{
    double value[3], vector[9];
    if (n < 3)
        return td_fail(
            error, TD_ERROR_DATA,
            "%zu views do not determine a hand-eye calibration: at least 3 are needed, and 15 or more "
            "are advised",
            n);
    size_t different = different_poses(view, n, 3);
    if (different < 3)
        return td_fail(error, TD_ERROR_DATA,
                       "the robot's poses of all %zu views are %zu in truth: at least 3 different ones are "
                       "needed; move the hand between the views, or check how the poses are read",
                       n, different);
    double largest = turns(value, vector, view, n);
    if (largest < least_turn)
        return td_fail(
            error, TD_ERROR_DATA,
            "the hand does not turn: %.2f degrees at most between two views; turn it by 20 degrees "
            "or more about at least two axes",
            largest / DEGREE);
    if (sqrt(fmax(value[1], 0)) >= least_turn) return TD_OK;
    bool to_hand = setup == TD_EYE_TO_HAND;
    double axis[3];
    clean_axis(axis, vector + 6);
    return td_fail(
        error, TD_ERROR_DATA,
        "all turns of the hand are about one axis, which leaves the translation of %s along the "
        "common axis (%.2f, %.2f, %.2f in the hand's frame) open, and that of %s with it; add views in "
        "which the hand is turned by 20 degrees or more about another axis",
        to_hand ? td_hand_eye_z_name(setup) : td_hand_eye_x_name(setup), axis[0], axis[1], axis[2],
        to_hand ? td_hand_eye_x_name(setup) : td_hand_eye_z_name(setup));
}

void td_he_origin_covariance(double out[144], const td_hand_eye *result)
{
    double map[144] = {0};
    for (int half = 0; half < 2; half++) {
        double j[18];
        td_pose_transform_jacobian(j, half ? result->z.t : result->x.t);
        for (int i = 0; i < 3; i++) {
            map[12 * (6 * half + i) + 6 * half + i] = 1;
            for (int k = 0; k < 6; k++) map[12 * (6 * half + 3 + i) + 6 * half + k] = j[6 * i + k];
        }
    }
    if (td_sandwich(out, map, result->covariance, 12, 12, NULL) != TD_OK)
        for (int k = 0; k < 144; k++) out[k] = NAN;
}

/* The part of a direction that is largest against the limits: X's rotation (0), origin (1), Z's (2, 3). */
static void describe(char text[320], const td_hand_eye *result, const double direction[12], double sigma)
{
    int part = 0;
    double length[4];
    for (int k = 0; k < 4; k++) {
        const double *v = direction + 3 * k;
        length[k] = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        if (length[k] > length[part] + 1e-9) part = k;
    }
    double axis[3];
    clean_axis(axis, direction + 3 * part);
    bool turn = part % 2 == 0, of_x = part < 2;
    bool hand = of_x == (result->setup != TD_EYE_TO_HAND);
    double size = sigma * length[part] * (turn ? limit_rad / DEGREE : limit_m * 1e3);
    snprintf(text, 320,
             "%s of %s %s (%.2f, %.2f, %.2f) in the %s's frame is known to %.3g %s only: add views in which "
             "the hand is turned by 20 degrees or more about axes across %s",
             turn ? "rotation" : "translation",
             of_x ? td_hand_eye_x_name(result->setup) : td_hand_eye_z_name(result->setup),
             turn ? "about" : "along", axis[0], axis[1], axis[2], hand ? "hand" : "base", size,
             turn ? "degrees" : "mm", hand ? "this one" : "those of the turns so far");
}

void td_he_find_weak(td_hand_eye *result)
{
    double origin[144], value[12], vector[144];
    td_he_origin_covariance(origin, result);
    for (int a = 0; a < 12; a++)
        for (int b = 0; b < 12; b++)
            origin[12 * a + b] /= (a % 6 < 3 ? limit_rad : limit_m) * (b % 6 < 3 ? limit_rad : limit_m);
    if (td_eigen_symmetric(value, vector, origin, 12, NULL) != TD_OK) return;
    for (int k = 11; k >= 0 && value[k] > 1 && result->weak_count < 8; k--)
        describe(result->weak[result->weak_count++], result, vector + 12 * k, sqrt(value[k]));
}
