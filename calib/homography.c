#include "calib/homography.h"

#include <math.h>
#include <stdlib.h>

#include "calib/projective_internal.h"
#include "core/linalg.h"

td_status td_homography(double h[9], const double *plane, const double *image, size_t n, td_error *error)
{
    td_projective fit;
    double norm = 0;
    if (n < 4) return td_fail(error, TD_ERROR_DATA, "a homography needs 4 points, %zu were given", n);
    if (!td_projective_fit(&fit, plane, image, n, 2))
        return td_fail(error, TD_ERROR_DATA, "a homography's points coincide or are not finite");
    if (!(fit.spread > 1e-6) || !(fit.gap > 1e-10))
        return td_fail(error, TD_ERROR_DATA, "a homography's points lie on a line");
    for (int i = 0; i < 9; i++) norm += fit.q[i] * fit.q[i];
    for (int i = 0; i < 9; i++) h[i] = fit.q[i] / sqrt(norm);
    return TD_OK;
}

bool td_focal_from_homographies(double focal[2], const double centre[2], const double *h, size_t n)
{
    double *a = malloc(6 * n * sizeof *a), x[2];
    if (!a) return false;
    double *b = a + 4 * n;
    bool tilted = false;
    for (size_t i = 0; i < n; i++) {
        /* Columns of the homography with the principal point moved to the origin, and their sum and
         * difference: both pairs are orthogonal on the plane. */
        double c[3][2], d[2][2], w[2] = {h[9 * i + 6], h[9 * i + 7]};
        double length = 0;
        for (int k = 0; k < 2; k++) {
            for (int r = 0; r < 2; r++) c[r][k] = h[9 * i + 3 * r + k] - centre[r] * w[k];
            c[2][k] = w[k];
        }
        for (int r = 0; r < 3; r++) length += c[r][0] * c[r][0] + c[r][1] * c[r][1];
        /* |w|^2 / length = (sine of the tilt / focal length in px)^2: some 1e-6^2 for a view that tells,
         * rounding (1e-16^2) for one that is parallel to the image. */
        tilted = tilted || w[0] * w[0] + w[1] * w[1] > 1e-24 * length;
        for (int r = 0; r < 2; r++) {
            d[r][0] = c[r][0] * c[r][1] / length;
            d[r][1] = (c[r][0] * c[r][0] - c[r][1] * c[r][1]) / length;
        }
        a[4 * i] = d[0][0], a[4 * i + 1] = d[1][0];
        a[4 * i + 2] = d[0][1], a[4 * i + 3] = d[1][1];
        b[2 * i] = -w[0] * w[1] / length;
        b[2 * i + 1] = -(w[0] * w[0] - w[1] * w[1]) / length;
    }
    size_t rank = 0;
    td_status status = td_least_squares_linear(x, &rank, a, b, 2 * n, 2, NULL);
    if (status == TD_OK && !(x[0] > 0 && x[1] > 0)) {
        /* One focal length for both is better determined. */
        double aa = 0, ab = 0;
        for (size_t i = 0; i < 2 * n; i++) {
            double s = a[2 * i] + a[2 * i + 1];
            aa += s * s;
            ab += s * b[i];
        }
        x[0] = x[1] = aa > 0 ? ab / aa : 0;
    }
    free(a);
    if (status != TD_OK || !tilted || rank < 1 || !(x[0] > 0 && x[1] > 0)) return false;
    focal[0] = 1 / sqrt(x[0]);
    focal[1] = 1 / sqrt(x[1]);
    return isfinite(focal[0]) && isfinite(focal[1]);
}

td_status td_pose_from_homography(td_pose *camera_from_plane, const double h[9], td_error *error)
{
    double r[9], nearest[9], t[3];
    double n0 = sqrt(h[0] * h[0] + h[3] * h[3] + h[6] * h[6]),
           n1 = sqrt(h[1] * h[1] + h[4] * h[4] + h[7] * h[7]);
    double scale = sqrt(n0 * n1);
    if (!(scale > 0) || !isfinite(scale)) return td_fail(error, TD_ERROR_DATA, "a homography without a pose");
    if (h[8] < 0) scale = -scale; /* the plane is in front of the camera */
    for (int i = 0; i < 3; i++) {
        r[3 * i] = h[3 * i] / scale;
        r[3 * i + 1] = h[3 * i + 1] / scale;
        t[i] = h[3 * i + 2] / scale;
    }
    r[2] = r[3] * r[7] - r[6] * r[4];
    r[5] = r[6] * r[1] - r[0] * r[7];
    r[8] = r[0] * r[4] - r[3] * r[1];
    TD_TRY(td_nearest_rotation(nearest, r, error));
    *camera_from_plane = td_pose_from_rotation(nearest, t);
    return TD_OK;
}
