#include "calib/faugeras_toscani.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

static double dot3(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Centroid and root mean square distance of points of dimension `d`. */
static double centre_and_scale(double *centre, const double *x, size_t n, int d)
{
    double square = 0;
    for (int k = 0; k < d; k++) centre[k] = 0;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < d; k++) centre[k] += x[(size_t)d * i + k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < d; k++) square += pow(x[(size_t)d * i + k] - centre[k], 2) / (double)n;
    return sqrt(square);
}

/* Smallest over largest spread of the points along their principal axes: 0 on a plane. */
static td_status depth_ratio(double *ratio, const double *point, const double centre[3], size_t n, td_error *error)
{
    double moment[9] = {0}, value[3];
    for (size_t i = 0; i < n; i++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++)
                moment[3 * a + b] += (point[3 * i + a] - centre[a]) * (point[3 * i + b] - centre[b]);
    TD_TRY(td_eigen_symmetric(value, NULL, moment, 3, error));
    *ratio = value[2] > 0 && value[0] > 0 ? sqrt(value[0] / value[2]) : 0;
    return TD_OK;
}

/* whiten (4,4) = N^-1/2 of N = sum of (m, 1) (m, 1)^T: in the homogeneous points whiten (m, 1) sums become the identity.
 * Centred points only: N is their moment and their number. */
static td_status whitening(double whiten[16], const double *point, size_t n, td_error *error)
{
    double moment[9] = {0}, value[3], vector[9];
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 9; k++) moment[k] += point[3 * i + k / 3] * point[3 * i + k % 3];
    TD_TRY(td_eigen_symmetric(value, vector, moment, 3, error));
    for (int k = 0; k < 16; k++) whiten[k] = 0;
    for (int r = 0; r < 3; r++)
        for (int s = 0; s < 3; s++)
            for (int k = 0; k < 3; k++) whiten[4 * r + s] += vector[3 * k + r] * vector[3 * k + s] / sqrt(value[k]);
    whiten[15] = 1 / sqrt((double)n);
    return TD_OK;
}

/* The rows q1, q2, q3 (3,4) that minimise the sum of (q1 m - u q3 m)^2 + (q2 m - v q3 m)^2, up to their scale.
 *
 * For a given q3 the best q1 and q2 are linear in it, q1 = N^-1 A_u q3 with A_u = sum of u m m^T, and so is the form in
 * q3 that remains: sum of (u^2 + v^2) m m^T - A_u N^-1 A_u - A_v N^-1 A_v. Its minimum under |q3's direction| = 1 is
 * biased: a pixel's noise is multiplied by the depth q3 m, so that depths, and the focal length with them, come out too
 * small, at 1 px by half. With the noise's share, sigma^2 times twice the sum of the squared depths q3^T N q3, taken off
 * (Kanatani's renormalisation) the minimum is the smallest eigenvector relative to N, which no change of frame alters
 * either; the constraint is left with the scale. */
static td_status minimise(double q[12], const double *point, const double *pixel, size_t n, td_error *error)
{
    double whiten[16], a[2][16] = {{0}}, form[16] = {0}, square[16], value[4], vector[16];
    TD_TRY(whitening(whiten, point, n, error));
    for (size_t i = 0; i < n; i++) {
        const double m[4] = {point[3 * i], point[3 * i + 1], point[3 * i + 2], 1}, *u = pixel + 2 * i;
        double w[4];
        td_multiply(w, whiten, m, 4, 4, 1);
        for (int k = 0; k < 16; k++) {
            double ww = w[k / 4] * w[k % 4];
            a[0][k] += u[0] * ww;
            a[1][k] += u[1] * ww;
            form[k] += (u[0] * u[0] + u[1] * u[1]) * ww;
        }
    }
    for (int c = 0; c < 2; c++) {
        td_multiply(square, a[c], a[c], 4, 4, 4);
        for (int k = 0; k < 16; k++) form[k] -= square[k];
    }
    TD_TRY(td_eigen_symmetric(value, vector, form, 4, error));
    if (!(value[1] > 1e-10 * value[3]))
        return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the points do not determine the camera");
    double rows[12];
    for (int c = 0; c < 2; c++) td_multiply(rows + 4 * c, a[c], vector, 4, 4, 1);
    memcpy(rows + 8, vector, 4 * sizeof *vector);
    td_multiply(q, rows, whiten, 3, 4, 4);
    return TD_OK;
}

/* Faugeras 1993, sect. 3.4: the rows of P are K's parameters along the rotation's rows. */
static td_status decompose(double intrinsics[4], double *skew, td_pose *pose, const double p[12], td_error *error)
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
        return td_fail(error, TD_ERROR_DATA,
                       "Faugeras-Toscani: the points are seen as in a mirror; check the order of their numbers, and that "
                       "heights (height_m) grow towards the camera");
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
    double m0[3], u0[2], ratio = 0;
    double m_scale = centre_and_scale(m0, point, n, 3), u_scale = centre_and_scale(u0, pixel, n, 2);
    if (!(m_scale > 0) || !(u_scale > 0) || !isfinite(m_scale + u_scale))
        return td_fail(error, TD_ERROR_DATA, "Faugeras-Toscani: the points coincide or are not finite");
    TD_TRY(depth_ratio(&ratio, point, m0, n, error));
    if (ratio < 1e-3)
        return td_fail(error, TD_ERROR_DATA,
                       "Faugeras-Toscani needs points with depth, these lie on a plane: use a target of two planes, or "
                       "one plane at several known heights (height_m in frames.csv)");

    /* Centred and scaled points and pixels, for the numbers' sake; an isotropic scale keeps the constraint's form. */
    double *scaled = malloc(5 * n * sizeof *scaled);
    if (!scaled) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", n);
    double *m = scaled, *u = scaled + 3 * n;
    for (size_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) m[3 * i + k] = (point[3 * i + k] - m0[k]) / m_scale;
        for (int k = 0; k < 2; k++) u[2 * i + k] = (pixel[2 * i + k] - u0[k]) / u_scale;
    }
    double q[12];
    td_status status = minimise(q, m, u, n, error);
    free(scaled);
    TD_TRY(status);
    /* The scale at which the third row is a direction, and the sign with which the target is in front of the camera. */
    double scale = (q[11] < 0 ? -1 : 1) / sqrt(dot3(q + 8, q + 8));
    for (int k = 0; k < 12; k++) q[k] *= scale;
    /* Undo: rows of pixels, then columns of points. */
    for (int r = 0; r < 2; r++)
        for (int k = 0; k < 4; k++) q[4 * r + k] = u_scale * q[4 * r + k] + u0[r] * q[8 + k];
    for (int r = 0; r < 3; r++) {
        q[4 * r + 3] = m_scale * q[4 * r + 3] - dot3(q + 4 * r, m0); /* whole row times m_scale */
    }
    double found[4], found_skew = 0;
    td_pose found_pose;
    TD_TRY(decompose(found, &found_skew, &found_pose, q, error));
    if (p) memcpy(p, q, sizeof q);
    if (intrinsics) memcpy(intrinsics, found, sizeof found);
    if (skew) *skew = found_skew;
    if (camera_from_target) *camera_from_target = found_pose;
    return TD_OK;
}
