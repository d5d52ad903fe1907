#include "core/pose.h"

#include <math.h>
#include <string.h>

/* Below this angle the closed forms lose digits by cancellation; the series' remainder is under 1e-13. */
#define SERIES_ANGLE 0.3

static double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(double c[3], const double a[3], const double b[3])
{
    double r[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    memcpy(c, r, sizeof r);
}

static void skew(double s[9], const double v[3])
{
    const double m[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
    memcpy(s, m, sizeof m);
}

static void multiply3(double c[9], const double a[9], const double b[9])
{
    double m[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            m[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
    memcpy(c, m, sizeof m);
}

static void multiply3v(double y[3], const double a[9], const double x[3])
{
    double r[3] = {dot3(a, x), dot3(a + 3, x), dot3(a + 6, x)};
    memcpy(y, r, sizeof r);
}

/* Copies a 3x3 block into a row-major 6x6 matrix. */
static void set_block(double m[36], int row, int column, const double block[9])
{
    for (int i = 0; i < 3; i++) memcpy(m + 6 * (row + i) + column, block + 3 * i, 3 * sizeof(double));
}

td_pose td_pose_identity(void)
{
    return (td_pose){{1, 0, 0, 0}, {0, 0, 0}};
}

static void quaternion_product(double r[4], const double a[4], const double b[4])
{
    double q[4] = {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                   a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                   a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                   a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
    double n = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) r[i] = q[i] * n;
}

void td_pose_rotate(double v_a[3], const td_pose *a_from_b, const double v_b[3])
{
    const double *q = a_from_b->q;
    double c[3], d[3];
    cross3(c, q + 1, v_b);
    for (int i = 0; i < 3; i++) c[i] *= 2;
    cross3(d, q + 1, c);
    double r[3] = {v_b[0] + q[0] * c[0] + d[0], v_b[1] + q[0] * c[1] + d[1], v_b[2] + q[0] * c[2] + d[2]};
    memcpy(v_a, r, sizeof r);
}

void td_pose_transform(double p_a[3], const td_pose *a_from_b, const double p_b[3])
{
    td_pose_rotate(p_a, a_from_b, p_b);
    for (int i = 0; i < 3; i++) p_a[i] += a_from_b->t[i];
}

td_pose td_pose_compose(const td_pose *a_from_b, const td_pose *b_from_c)
{
    td_pose r;
    td_pose_transform(r.t, a_from_b, b_from_c->t);
    quaternion_product(r.q, a_from_b->q, b_from_c->q);
    return r;
}

td_pose td_pose_inverse(const td_pose *a_from_b)
{
    const double *q = a_from_b->q;
    td_pose r = {{q[0], -q[1], -q[2], -q[3]}, {0, 0, 0}};
    td_pose_rotate(r.t, &r, a_from_b->t);
    for (int i = 0; i < 3; i++) r.t[i] = -r.t[i];
    return r;
}

void td_pose_rotation(double r[9], const td_pose *pose)
{
    const double w = pose->q[0], x = pose->q[1], y = pose->q[2], z = pose->q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(r, m, sizeof m);
}

td_pose td_pose_from_rotation(const double r[9], const double t[3])
{
    /* Shepperd 1978: divide by the largest of the four, so that no case loses digits. */
    double trace = r[0] + r[4] + r[8];
    double four_squared[4] = {1 + trace, 1 + 2 * r[0] - trace, 1 + 2 * r[4] - trace, 1 + 2 * r[8] - trace};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (four_squared[i] > four_squared[k]) k = i;
    double a = r[7] - r[5], b = r[2] - r[6], c = r[3] - r[1];
    double d = r[1] + r[3], e = r[2] + r[6], f = r[5] + r[7];
    const double rows[4][4] = {{four_squared[0], a, b, c},
                               {a, four_squared[1], d, e},
                               {b, d, four_squared[2], f},
                               {c, e, f, four_squared[3]}};
    td_pose p;
    double n = 0;
    for (int i = 0; i < 4; i++) n += rows[k][i] * rows[k][i];
    n = (rows[k][0] < 0 ? -1 : 1) / sqrt(n);
    for (int i = 0; i < 4; i++) p.q[i] = rows[k][i] * n;
    memcpy(p.t, t, sizeof p.t);
    return p;
}

void td_pose_matrix(double m[16], const td_pose *pose)
{
    double r[9];
    td_pose_rotation(r, pose);
    for (int i = 0; i < 3; i++) {
        memcpy(m + 4 * i, r + 3 * i, 3 * sizeof(double));
        m[4 * i + 3] = pose->t[i];
    }
    const double last[4] = {0, 0, 0, 1};
    memcpy(m + 12, last, sizeof last);
}

void td_rotation_exp(double q[4], const double omega[3])
{
    double angle2 = dot3(omega, omega), angle = sqrt(angle2);
    /* sin(a/2)/a = 1/2 - a^2/48 + … */
    double s = angle < 1e-4 ? 0.5 - angle2 / 48 : sin(angle / 2) / angle;
    q[0] = cos(angle / 2);
    for (int i = 0; i < 3; i++) q[i + 1] = s * omega[i];
}

void td_rotation_log(double omega[3], const double q[4])
{
    double n = sqrt(dot3(q + 1, q + 1));
    double sign = q[0] < 0 ? -1 : 1;
    /* 2 atan2(n, w)/n; for small n: 2/w. */
    double s = n < 1e-10 ? 2 * sign : 2 * atan2(n, sign * q[0]) / n * sign;
    for (int i = 0; i < 3; i++) omega[i] = s * q[i + 1];
}

/* (1 - cos a)/a^2, (a - sin a)/a^3 */
static void left_jacobian_factors(double angle, double *b, double *c)
{
    double x = angle * angle;
    if (angle < SERIES_ANGLE) {
        *b = 1. / 2 - x * (1. / 24 - x * (1. / 720 - x * (1. / 40320 - x / 3628800)));
        *c = 1. / 6 - x * (1. / 120 - x * (1. / 5040 - x * (1. / 362880 - x / 39916800)));
    } else {
        *b = (1 - cos(angle)) / x;
        *c = (angle - sin(angle)) / (x * angle);
    }
}

void td_rotation_left_jacobian(double j[9], const double omega[3])
{
    double w[9], w2[9], b, c;
    left_jacobian_factors(sqrt(dot3(omega, omega)), &b, &c);
    skew(w, omega);
    multiply3(w2, w, w);
    for (int i = 0; i < 9; i++) j[i] = (i % 4 == 0) + b * w[i] + c * w2[i];
}

void td_rotation_left_jacobian_inverse(double j[9], const double omega[3])
{
    double w[9], w2[9], angle = sqrt(dot3(omega, omega)), x = angle * angle;
    /* (1 - (a/2) cot(a/2))/a^2 */
    double c = angle < SERIES_ANGLE
                   ? 1. / 12 + x * (1. / 720 + x * (1. / 30240 + x * (1. / 1209600 + x / 47900160)))
                   : (1 - angle / 2 / tan(angle / 2)) / x;
    skew(w, omega);
    multiply3(w2, w, w);
    for (int i = 0; i < 9; i++) j[i] = (i % 4 == 0) - w[i] / 2 + c * w2[i];
}

td_pose td_pose_exp(const double xi[6])
{
    td_pose p;
    double j[9];
    td_rotation_exp(p.q, xi);
    td_rotation_left_jacobian(j, xi);
    multiply3v(p.t, j, xi + 3);
    return p;
}

void td_pose_log(double xi[6], const td_pose *pose)
{
    double j[9];
    td_rotation_log(xi, pose->q);
    td_rotation_left_jacobian_inverse(j, xi);
    multiply3v(xi + 3, j, pose->t);
}

td_pose td_pose_perturb(const td_pose *pose, const double xi[6])
{
    td_pose step = td_pose_exp(xi);
    return td_pose_compose(&step, pose);
}

/* The lower left block Q of the left Jacobian of SE(3) (Barfoot, eq. 7.86). */
static void left_jacobian_q(double q[9], const double xi[6])
{
    double p[9], r[9], pr[9], rp[9], prp[9], ppr[9], rpp[9], prpp[9], pprp[9], pp[9];
    skew(p, xi);
    skew(r, xi + 3);
    multiply3(pr, p, r);
    multiply3(rp, r, p);
    multiply3(pp, p, p);
    multiply3(prp, pr, p);
    multiply3(ppr, p, pr);
    multiply3(rpp, rp, p);
    multiply3(prpp, prp, p);
    multiply3(pprp, pp, rp);
    double angle = sqrt(dot3(xi, xi)), x = angle * angle, a, b, c, unused;
    left_jacobian_factors(angle, &unused, &a);
    if (angle < SERIES_ANGLE) {
        b = 1. / 24 - x * (1. / 720 - x * (1. / 40320 - x / 3628800));
        c = 1. / 120 - x * (1. / 2520 - x * (1. / 120960 - x / 9979200));
    } else {
        b = (x + 2 * cos(angle) - 2) / (2 * x * x);
        c = (2 * angle - 3 * sin(angle) + angle * cos(angle)) / (2 * x * x * angle);
    }
    for (int i = 0; i < 9; i++)
        q[i] = r[i] / 2 + a * (pr[i] + rp[i] + prp[i]) + b * (ppr[i] + rpp[i] - 3 * prp[i]) +
               c * (prpp[i] + pprp[i]);
}

void td_pose_left_jacobian(double j[36], const double xi[6])
{
    double jr[9], q[9];
    td_rotation_left_jacobian(jr, xi);
    left_jacobian_q(q, xi);
    memset(j, 0, 36 * sizeof *j);
    set_block(j, 0, 0, jr);
    set_block(j, 3, 0, q);
    set_block(j, 3, 3, jr);
}

void td_pose_left_jacobian_inverse(double j[36], const double xi[6])
{
    double jr[9], q[9];
    td_rotation_left_jacobian_inverse(jr, xi);
    left_jacobian_q(q, xi);
    multiply3(q, jr, q);
    multiply3(q, q, jr);
    for (int i = 0; i < 9; i++) q[i] = -q[i];
    memset(j, 0, 36 * sizeof *j);
    set_block(j, 0, 0, jr);
    set_block(j, 3, 0, q);
    set_block(j, 3, 3, jr);
}

void td_pose_adjoint(double ad[36], const td_pose *a_from_b)
{
    double r[9], t[9], tr[9];
    td_pose_rotation(r, a_from_b);
    skew(t, a_from_b->t);
    multiply3(tr, t, r);
    memset(ad, 0, 36 * sizeof *ad);
    set_block(ad, 0, 0, r);
    set_block(ad, 3, 0, tr);
    set_block(ad, 3, 3, r);
}

void td_pose_transform_jacobian(double j[18], const double p_a[3])
{
    double s[9];
    skew(s, p_a);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            j[6 * i + k] = -s[3 * i + k];
            j[6 * i + 3 + k] = i == k;
        }
}

/* s = a s a^T, 6x6 */
static void transport6(double out[36], const double a[36], const double s[36])
{
    double as[36];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += a[6 * i + k] * s[6 * k + j];
            as[6 * i + j] = sum;
        }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += as[6 * i + k] * a[6 * j + k];
            out[6 * i + j] = sum;
        }
}

void td_pose_compose_covariance(double s_ac[36], const td_pose *a_from_b, const double s_ab[36],
                                const double s_bc[36])
{
    double ad[36], moved[36];
    td_pose_adjoint(ad, a_from_b);
    transport6(moved, ad, s_bc);
    for (int i = 0; i < 36; i++) s_ac[i] = s_ab[i] + moved[i];
}

void td_pose_inverse_covariance(double s_ba[36], const td_pose *a_from_b, const double s_ab[36])
{
    double ad[36];
    td_pose b_from_a = td_pose_inverse(a_from_b);
    td_pose_adjoint(ad, &b_from_a);
    transport6(s_ba, ad, s_ab);
}

double td_pose_angle(const td_pose *pose)
{
    return 2 * atan2(sqrt(dot3(pose->q + 1, pose->q + 1)), fabs(pose->q[0]));
}

double td_pose_distance(const td_pose *pose)
{
    return sqrt(dot3(pose->t, pose->t));
}
