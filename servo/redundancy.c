/* The inverse of a task, and what joints do that the task leaves free. */
#include <math.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

enum { M = TD_TOOL_ROWS, SWEEPS = 30 };

/* One rotation of Jacobi's that clears a[p][q]; v's columns become eigenvectors. */
static void rotate(double a[M][M], double v[M][M], int size, int p, int q)
{
    const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
    const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
    const double c = 1 / sqrt(t * t + 1), s = t * c;
    for (int i = 0; i < size; i++) {
        const double x = a[i][p], y = a[i][q];
        a[i][p] = c * x - s * y;
        a[i][q] = s * x + c * y;
    }
    for (int i = 0; i < size; i++) {
        const double x = a[p][i], y = a[q][i];
        a[p][i] = c * x - s * y;
        a[q][i] = s * x + c * y;
        const double vx = v[i][p], vy = v[i][q];
        v[i][p] = c * vx - s * vy;
        v[i][q] = s * vx + c * vy;
    }
}

/* Eigenvalues on the diagonal of a, by Jacobi's cyclic method: for matrices this small faster than LAPACK. */
static void eigen(double a[M][M], double v[M][M], int size)
{
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++) v[i][j] = i == j;
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        double off = 0, all = 0;
        for (int i = 0; i < size; i++)
            for (int j = 0; j < size; j++) {
                all += a[i][j] * a[i][j];
                if (i != j) off += a[i][j] * a[i][j];
            }
        if (off <= 1e-30 * all) return;
        for (int p = 0; p < size; p++)
            for (int q = p + 1; q < size; q++)
                if (a[p][q] != 0) rotate(a, v, size, p, q);
    }
}

/* J J^T = V diag(s^2) V^T, so J+ = J^T V diag(1 / (s^2 + l^2)) V^T. Rows are weighted, so that s is in m/rad.
 */
void td_inverse_make(td_inverse *inverse, const td_arm *arm, const double *jacobian, const bool *held,
                     double damping)
{
    const int m = arm->tool->row_count, n = arm->robot->joint_count;
    double a[M][M], v[M][M], gain[M], weight[M], most = 0, least = INFINITY;
    inverse->rows = m, inverse->joints = n;
    memcpy(inverse->jacobian, jacobian, (size_t)(m * n) * sizeof *jacobian);
    for (int i = 0; i < m; i++) weight[i] = td_tool_weight(arm, i);
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            a[i][j] = 0;
            for (int k = 0; k < n; k++)
                if (!held || !held[k])
                    a[i][j] += weight[i] * jacobian[i * n + k] * weight[j] * jacobian[j * n + k];
        }
    eigen(a, v, m);
    for (int i = 0; i < m; i++) {
        most = fmax(most, sqrt(fmax(a[i][i], 0)));
        least = fmin(least, sqrt(fmax(a[i][i], 0)));
    }
    const double limit = arm->options->singular_share * most;
    inverse->least = least;
    inverse->damping = fmax(damping, least < limit ? limit - least : 0);
    for (int i = 0; i < m; i++) {
        const double square = fmax(a[i][i], 0) + inverse->damping * inverse->damping;
        gain[i] = square > 0 ? 1 / square : 0;
    }
    for (int k = 0; k < n; k++)
        for (int j = 0; j < m; j++) {
            double sum = 0;
            for (int e = 0; e < m && !(held && held[k]); e++) {
                double along = 0;
                for (int i = 0; i < m; i++) along += weight[i] * jacobian[i * n + k] * v[i][e];
                sum += along * gain[e] * v[j][e] * weight[j];
            }
            inverse->plus[k * m + j] = sum;
        }
}

void td_inverse_apply(double *dq, const td_inverse *inverse, const double *dx)
{
    for (int k = 0; k < inverse->joints; k++) {
        dq[k] = 0;
        for (int i = 0; i < inverse->rows; i++) dq[k] += inverse->plus[k * inverse->rows + i] * dx[i];
    }
}

/* phi = [sum |z|^p]^(1/p), z = (q - qmid) / Dq: its derivative by q is (|z| / phi)^(p-1) sign(z) / Dq, and
 * how fast that changes at most the largest (p - 1) / phi (|z| / phi)^(p-2) / Dq^2. */
static bool gradient(double *slope, double *bend, const td_arm *arm, const double *q)
{
    const double p = arm->options->power;
    double z[TD_ROBOT_MAX_JOINTS], most = 0, sum = 0;
    bool moves[TD_ROBOT_MAX_JOINTS];
    td_tool_joints(moves, arm);
    for (int k = 0; k < arm->robot->joint_count; k++) {
        const td_robot_joint *j = arm->robot->joint + k;
        const double half = (j->upper - j->lower) / 2;
        z[k] = moves[k] && isfinite(half) && half > 0 ? (q[k] - j->lower - half) / half : 0;
        most = fmax(most, fabs(z[k]));
    }
    *bend = 0;
    if (!(most > 0)) return false;
    for (int k = 0; k < arm->robot->joint_count; k++) sum += pow(fabs(z[k]) / most, p);
    const double phi = most * pow(sum, 1 / p);
    for (int k = 0; k < arm->robot->joint_count; k++) {
        const td_robot_joint *j = arm->robot->joint + k;
        if (z[k] != 0)
            *bend =
                fmax(*bend, (p - 1) / phi * pow(fabs(z[k]) / phi, p - 2) * pow(2 / (j->upper - j->lower), 2));
        slope[k] = z[k] == 0 ? 0 : copysign(pow(fabs(z[k]) / phi, p - 1), z[k]) * 2 / (j->upper - j->lower);
    }
    return true;
}

double td_inverse_avoid(double *dq, const td_inverse *inverse, const td_arm *arm, const double *q)
{
    const int m = inverse->rows, n = inverse->joints;
    double slope[TD_ROBOT_MAX_JOINTS], seen[TD_TOOL_ROWS], held[TD_ROBOT_MAX_JOINTS], bend = 0;
    if (arm->options->alpha == 0 || !gradient(slope, &bend, arm, q)) return 0;
    for (int i = 0; i < m; i++) {
        seen[i] = 0;
        for (int k = 0; k < n; k++) seen[i] += inverse->jacobian[i * n + k] * slope[k];
    }
    td_inverse_apply(held, inverse, seen);
    for (int k = 0; k < n; k++) dq[k] += arm->options->alpha * (slope[k] - held[k]);
    return -arm->options->alpha * bend;
}
