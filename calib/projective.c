#include "calib/projective_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

/* Centroid and root mean square distance from it, of points of dimension `d`. False: they coincide, are not
 * finite. */
static bool centre_and_scale(double *centre, double *scale, const double *x, size_t n, int d)
{
    double square = 0, away = 0;
    for (int k = 0; k < d; k++) centre[k] = 0;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < d; k++) centre[k] += x[(size_t)d * i + k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < d; k++) {
            double r = x[(size_t)d * i + k] - centre[k];
            square += r * r / (double)n;
        }
    for (int k = 0; k < d; k++) away += centre[k] * centre[k];
    *scale = sqrt(square);
    /* Of points that coincide rounding leaves a little. */
    return isfinite(square) && square > 1e-24 * away;
}

/* whiten (d+1,d+1) = N^-1/2 of the centred points' N = sum of (m, 1) (m, 1)^T: for the points whiten (m, 1)
 * that sum is the identity. Returns the spread; at 0 there is no such matrix. */
static double whitening(double *whiten, const double *m, size_t n, int d)
{
    const int e = d + 1;
    double moment[9] = {0}, value[3], vector[9];
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < d * d; k++) moment[k] += m[(size_t)d * i + k / d] * m[(size_t)d * i + k % d];
    if (td_eigen_symmetric(value, vector, moment, (size_t)d, NULL) != TD_OK || !(value[0] > 0)) return 0;
    for (int k = 0; k < e * e; k++) whiten[k] = 0;
    for (int r = 0; r < d; r++)
        for (int s = 0; s < d; s++)
            for (int k = 0; k < d; k++)
                whiten[e * r + s] += vector[d * k + r] * vector[d * k + s] / sqrt(value[k]);
    whiten[e * e - 1] = 1 / sqrt((double)n);
    return sqrt(value[0] / value[d - 1]);
}

/* The rows q1, q2, q3 that minimise the sum of (q1 m - u q3 m)^2 + (q2 m - v q3 m)^2 over points (m, 1),
 * written m.
 *
 * For a given q3 the best q1 and q2 are linear in it, q1 = N^-1 A_u q3 with A_u = sum of u m m^T, and so is
 * the form in q3 that remains: sum of (u^2 + v^2) m m^T - A_u N^-1 A_u - A_v N^-1 A_v. Its minimum under a
 * constraint on q3's length is biased: a pixel's noise is multiplied by the depth q3 m, so that depths, and
 * the focal length with them, come out too small, at 1 px by half. With the noise's share, sigma^2 times
 * twice the sum of the squared depths q3^T N q3, taken off (Kanatani's renormalisation) the minimum is the
 * smallest eigenvector relative to N, which no change of the points' frame alters. Returns the gap. */
static double minimise(double *q, const double *whiten, const double *m, const double *pixel, size_t n, int d)
{
    const int e = d + 1;
    double a[2][16] = {{0}}, form[16] = {0}, value[4], vector[16], rows[12];
    for (size_t i = 0; i < n; i++) {
        double w[4], u = pixel[2 * i], v = pixel[2 * i + 1], square = u * u + v * v;
        for (int r = 0; r < e; r++) {
            w[r] = whiten[e * r + d];
            for (int s = 0; s < d; s++) w[r] += whiten[e * r + s] * m[(size_t)d * i + s];
        }
        for (int r = 0; r < e; r++)
            for (int s = 0; s <= r; s++) {
                double ww = w[r] * w[s];
                a[0][e * r + s] += u * ww;
                a[1][e * r + s] += v * ww;
                form[e * r + s] += square * ww;
            }
    }
    for (int c = 0; c < 2; c++)
        for (int r = 0; r < e; r++)
            for (int s = 0; s < r; s++) a[c][e * s + r] = a[c][e * r + s];
    for (int r = 0; r < e; r++)
        for (int s = 0; s <= r; s++) {
            for (int k = 0; k < e; k++)
                form[e * r + s] -= a[0][e * r + k] * a[0][e * k + s] + a[1][e * r + k] * a[1][e * k + s];
            form[e * s + r] = form[e * r + s];
        }
    if (td_eigen_symmetric(value, vector, form, (size_t)e, NULL) != TD_OK || !(value[d] > 0)) return 0;
    for (int c = 0; c < 2; c++) td_multiply(rows + e * c, a[c], vector, (size_t)e, (size_t)e, 1);
    memcpy(rows + 2 * e, vector, (size_t)e * sizeof *vector);
    td_multiply(q, rows, whiten, 3, (size_t)e, (size_t)e);
    return fmax(value[1] / value[d], 0);
}

/* Undoes the shift and scale of both sides: pixels are u_scale * u + u0, points m_scale * m + m0. */
static void restore(double *q, const double *m0, double m_scale, const double u0[2], double u_scale, int d)
{
    const int e = d + 1;
    for (int r = 0; r < 2; r++)
        for (int k = 0; k < e; k++) q[e * r + k] = u_scale * q[e * r + k] + u0[r] * q[2 * e + k];
    for (int r = 0; r < 3; r++) {
        q[e * r + d] *= m_scale;
        for (int k = 0; k < d; k++) q[e * r + d] -= q[e * r + k] * m0[k];
    }
}

bool td_projective_fit(td_projective *fit, const double *point, const double *pixel, size_t n, int d)
{
    double m0[3], u0[2], m_scale, u_scale, whiten[16];
    *fit = (td_projective){.spread = 0};
    if (n < 1 || !centre_and_scale(m0, &m_scale, point, n, d) || !centre_and_scale(u0, &u_scale, pixel, n, 2))
        return false;
    double *m = malloc((size_t)(d + 2) * n * sizeof *m);
    if (!m) return false;
    double *u = m + (size_t)d * n;
    for (size_t i = 0; i < n; i++) {
        for (int k = 0; k < d; k++) m[(size_t)d * i + k] = (point[(size_t)d * i + k] - m0[k]) / m_scale;
        for (int k = 0; k < 2; k++) u[2 * i + k] = (pixel[2 * i + k] - u0[k]) / u_scale;
    }
    fit->spread = whitening(whiten, m, n, d);
    if (fit->spread > 0) {
        fit->gap = minimise(fit->q, whiten, m, u, n, d);
        restore(fit->q, m0, m_scale, u0, u_scale, d);
    }
    free(m);
    return true;
}
