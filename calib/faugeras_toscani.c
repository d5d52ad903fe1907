#include "calib/faugeras_toscani.h"

#include <math.h>
#include <string.h>

#include "calib/projective_internal.h"
#include "core/linalg.h"

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Faugeras 1993, sect. 3.4: the rows of P are K's parameters along the rotation's rows. */
static td_status decompose(double intrinsics[4], double *skew, td_pose *pose, const double p[12],
                           td_error *error)
{
    const double *q1 = p, *q2 = p + 4, *q3 = p + 8;
    double cx = dot3(q1, q3), cy = dot3(q2, q3), r[9], nearest[9];
    for (int k = 0; k < 3; k++) r[6 + k] = q3[k];
    /* q2 - cy q3 = fy r2; q1 - cx q3 = fx r1 + skew r2 */
    double fy = 0, s = 0, fx = 0;
    for (int k = 0; k < 3; k++) {
        r[3 + k] = q2[k] - cy * q3[k];
        r[k] = q1[k] - cx * q3[k];
    }
    fy = sqrt(dot3(r + 3, r + 3));
    for (int k = 0; k < 3; k++) r[3 + k] /= fy;
    s = dot3(r, r + 3);
    for (int k = 0; k < 3; k++) r[k] -= s * r[3 + k];
    fx = sqrt(dot3(r, r));
    for (int k = 0; k < 3; k++) r[k] /= fx;
    if (!(fx > 0) || !(fy > 0) || !isfinite(fx + fy))
        return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the matrix is not a camera's");
    double det = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) +
                 r[2] * (r[3] * r[7] - r[4] * r[6]);
    if (det < 0)
        return td_fail(
            error, TD_ERROR_DATA,
            "Faugeras-Toscani: the points are seen as in a mirror; check the order of their numbers, "
            "and that heights (height_m) grow towards the camera");
    double t[3] = {0, (p[7] - cy * p[11]) / fy, p[11]};
    t[0] = (p[3] - cx * p[11] - s * t[1]) / fx;
    TD_TRY(td_nearest_rotation(nearest, r, error));
    *pose = td_pose_from_rotation(nearest, t);
    const double values[4] = {fx, fy, cx, cy};
    memcpy(intrinsics, values, sizeof values);
    *skew = s;
    return TD_OK;
}

td_status td_faugeras_toscani(double p[12], double intrinsics[4], double *skew, td_pose *camera_from_target,
                              const double *point, const double *pixel, size_t n, td_error *error)
{
    if (n < 6) return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani needs 6 points, %zu were given", n);
    td_projective fit;
    if (!td_projective_fit(&fit, point, pixel, n, 3))
        return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the points coincide or are not finite");
    if (!(fit.spread > 1e-3))
        return td_fail(
            error, TD_ERROR_DATA,
            "Faugeras-Toscani needs points with depth, these lie on a plane: use a target of two planes, or "
            "one plane at several known heights (height_m in frames.csv)");
    if (!(fit.gap > 1e-10))
        return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the points do not determine the camera");
    /* The scale at which the third row is a direction, and the sign with which the target is in front of the
     * camera. */
    double *q = fit.q, depth = 0;
    for (size_t i = 0; i < n; i++) depth += dot3(q + 8, point + 3 * i) + q[11];
    double scale = (depth < 0 ? -1 : 1) / sqrt(dot3(q + 8, q + 8));
    for (int k = 0; k < 12; k++) q[k] *= scale;
    double found[4], found_skew = 0;
    td_pose found_pose;
    TD_TRY(decompose(found, &found_skew, &found_pose, q, error));
    if (p) memcpy(p, q, 12 * sizeof *p);
    if (intrinsics) memcpy(intrinsics, found, sizeof found);
    if (skew) *skew = found_skew;
    if (camera_from_target) *camera_from_target = found_pose;
    return TD_OK;
}
