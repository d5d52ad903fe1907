/* The law: the inverse of the task, the gain, and the second task that avoids limits. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/visual_servo_internal.h"

enum { N = TD_ROBOT_MAX_JOINTS, SWEEPS = 40 };
static const double NOTHING = 1e-6; /* of the largest singular value: below it there is none (as ViSP) */

/* ---- J of full rank: Householder's QR ---- */

/* a (m,n), m >= n, becomes R above its diagonal, with the reflections' vectors below and their heads in
 * `head`. */
static void factorise(double *a, double *head, double *diagonal, int m, int n)
{
    for (int k = 0; k < n; k++) {
        double square = 0;
        for (int i = k; i < m; i++) square += a[i * n + k] * a[i * n + k];
        const double length = sqrt(square), top = a[k * n + k];
        diagonal[k] = top > 0 ? -length : length;
        head[k] = top - diagonal[k];
        const double half = -head[k] * diagonal[k]; /* of the vector's square */
        for (int j = k + 1; j < n && half > 0; j++) {
            double dot = head[k] * a[k * n + j];
            for (int i = k + 1; i < m; i++) dot += a[i * n + k] * a[i * n + j];
            dot /= half;
            a[k * n + j] -= dot * head[k];
            for (int i = k + 1; i < m; i++) a[i * n + j] -= dot * a[i * n + k];
        }
    }
}

static void reflect(double *x, const double *a, const double *head, const double *diagonal, int k, int m,
                    int n)
{
    double dot = head[k] * x[k];
    for (int i = k + 1; i < m; i++) dot += a[i * n + k] * x[i];
    dot /= -head[k] * diagonal[k];
    x[k] -= dot * head[k];
    for (int i = k + 1; i < m; i++) x[i] -= dot * a[i * n + k];
}

/* |R|_F |R^-1|_F, which no ratio of singular values exceeds; INFINITY where R is singular. */
static double condition(const double *a, const double *diagonal, int n)
{
    double inverse[6 * 6], all = 0, back = 0;
    for (int j = 0; j < n; j++) {
        if (diagonal[j] == 0) return INFINITY;
        for (int i = j; i >= 0; i--) {
            double sum = i == j;
            for (int k = i + 1; k <= j; k++) sum -= a[i * n + k] * inverse[k * n + j];
            inverse[i * n + j] = sum / diagonal[i];
            back += inverse[i * n + j] * inverse[i * n + j];
            all += i == j ? diagonal[i] * diagonal[i] : a[i * n + j] * a[i * n + j];
        }
    }
    return sqrt(all * back);
}

static void solve_upper(double *step, const double *a, const double *diagonal, const double *x, int n)
{
    for (int i = n - 1; i >= 0; i--) {
        double sum = x[i];
        for (int k = i + 1; k < n; k++) sum -= a[i * n + k] * step[k];
        step[i] = sum / diagonal[i];
    }
}

/* The step that minimises |R step - x|^2 + mu^2 |step|^2: that of [R; mu I], factorised once more. */
static void solve_damped(double *step, const double *a, const double *diagonal, const double *x, int n,
                         double mu)
{
    double both[12 * 6] = {0}, right[12] = {0}, head[6], again[6];
    for (int i = 0; i < n; i++) {
        for (int k = i; k < n; k++) both[i * n + k] = k == i ? diagonal[i] : a[i * n + k];
        both[(n + i) * n + i] = mu;
        right[i] = x[i];
    }
    factorise(both, head, again, 2 * n, n);
    for (int k = 0; k < n; k++) reflect(right, both, head, again, k, 2 * n, n);
    solve_upper(step, both, again, right, n);
}

static double length_of(const double *x, int n)
{
    double square = 0;
    for (int i = 0; i < n; i++) square += x[i] * x[i];
    return sqrt(square);
}

/* False: not of full rank, or too near to a singularity. */
static bool invert_regular(td_task_inverse *inverse, const double *j, const double *e, int m, int n,
                           const td_task_damping *damping)
{
    double a[TD_SERVO_ROWS * 6], x[TD_SERVO_ROWS], head[6], diagonal[6];
    if (m < n || n > 6) return false;
    memcpy(a, j, (size_t)(m * n) * sizeof *a);
    factorise(a, head, diagonal, m, n);
    if (!(condition(a, diagonal, n) * fmax(damping->share, NOTHING) < 1)) return false;
    inverse->rank = n, inverse->damped = 0;
    if (!e) return true;
    memcpy(x, e, (size_t)m * sizeof *x);
    for (int k = 0; k < n; k++) reflect(x, a, head, diagonal, k, m, n);
    if (damping->by_error > 0)
        solve_damped(inverse->step, a, diagonal, x, n, sqrt(damping->by_error) * length_of(x, n));
    else
        solve_upper(inverse->step, a, diagonal, x, n);
    memcpy(inverse->seen, x, (size_t)n * sizeof *x);
    for (int i = n; i < m; i++) inverse->seen[i] = 0;
    for (int k = n - 1; k >= 0; k--) reflect(inverse->seen, a, head, diagonal, k, m, n);
    return true;
}

/* ---- J of any rank: singular values by Jacobi's one-sided method (Hestenes 1958) ---- */

/* a (columns,rows): its rows become orthogonal, and v (columns,columns) the rotations that did it, v^T a. */
static void orthogonalise(double *a, double *v, int columns, int rows)
{
    bool turned = true;
    for (int i = 0; i < columns * columns; i++) v[i] = i % (columns + 1) == 0;
    for (int sweep = 0; sweep < SWEEPS && turned; sweep++) {
        turned = false;
        for (int p = 0; p < columns; p++)
            for (int q = p + 1; q < columns; q++) {
                double *x = a + p * rows, *y = a + q * rows, xx = 0, yy = 0, xy = 0;
                for (int i = 0; i < rows; i++) xx += x[i] * x[i], yy += y[i] * y[i], xy += x[i] * y[i];
                if (!(fabs(xy) > DBL_EPSILON * sqrt(xx * yy)) || xy == 0) continue;
                const double theta = (yy - xx) / (2 * xy),
                             t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1)),
                             c = 1 / sqrt(t * t + 1), s = t * c;
                for (int i = 0; i < rows; i++) {
                    const double was = x[i];
                    x[i] = c * was - s * y[i];
                    y[i] = s * was + c * y[i];
                }
                for (int i = 0; i < columns; i++) {
                    const double was = v[p * columns + i];
                    v[p * columns + i] = c * was - s * v[q * columns + i];
                    v[q * columns + i] = s * was + c * v[q * columns + i];
                }
                turned = true;
            }
    }
}

/* J = sum s u v^T, from J or its transpose, whichever has fewer columns. */
typedef struct svd {
    int count, rows, columns;
    bool transposed;
    double s[N], rotation[N * N];   /* vectors of the shorter side, a row each */
    double side[TD_SERVO_ROWS * N]; /* s times those of the longer side, a row each */
    double largest;
} svd;

static void decompose(svd *d, const double *j, int m, int n, const bool *held)
{
    d->rows = m, d->columns = n;
    d->transposed = m < n;
    d->count = m < n ? m : n;
    d->largest = 0;
    const int length = m < n ? n : m;
    for (int i = 0; i < m; i++)
        for (int k = 0; k < n; k++)
            d->side[d->transposed ? i * n + k : k * m + i] = held && held[k] ? 0 : j[i * n + k];
    orthogonalise(d->side, d->rotation, d->count, length);
    for (int k = 0; k < d->count; k++) {
        double square = 0;
        for (int i = 0; i < length; i++) square += d->side[k * length + i] * d->side[k * length + i];
        d->s[k] = sqrt(square);
        d->largest = fmax(d->largest, d->s[k]);
    }
}

static double left(const svd *d, int k, int i)
{
    return d->transposed ? d->rotation[k * d->count + i] : d->side[k * d->rows + i] / d->s[k];
}

static double right(const svd *d, int k, int i)
{
    return d->transposed ? d->side[k * d->columns + i] / d->s[k] : d->rotation[k * d->count + i];
}

/* 1/s, or less of it: s / (s^2 + l^2 + mu^2), l = s0 - s near a singularity (as Nakamura and Hanafusa 1986).
 */
static double inverse_of(double s, double least, double mu)
{
    const double damping = s < least ? least - s : 0;
    return s / (s * s + damping * damping + mu * mu);
}

static void invert_any(td_task_inverse *inverse, const double *j, const double *e, int m, int n,
                       const bool *held, const td_task_damping *damping)
{
    svd d;
    double along[N], square = 0;
    decompose(&d, j, m, n, held);
    inverse->rank = inverse->damped = 0;
    for (int i = 0; i < n; i++) inverse->step[i] = 0;
    for (int i = 0; i < m; i++) inverse->seen[i] = 0;
    for (int k = 0; k < d.count; k++) {
        along[k] = 0;
        if (!(d.s[k] > NOTHING * d.largest)) continue;
        for (int i = 0; i < m && e; i++) along[k] += left(&d, k, i) * e[i];
        for (int i = 0; i < m; i++) inverse->seen[i] += along[k] * left(&d, k, i);
        for (int i = 0; i < n; i++) inverse->basis[inverse->rank * n + i] = right(&d, k, i);
        inverse->rank++;
        if (d.s[k] < damping->share * d.largest) inverse->damped++;
        square += along[k] * along[k];
    }
    const double mu = sqrt(damping->by_error * square);
    for (int k = 0; k < d.count; k++) {
        if (!(d.s[k] > NOTHING * d.largest)) continue;
        const double by = along[k] * inverse_of(d.s[k], damping->share * d.largest, mu);
        for (int i = 0; i < n; i++) inverse->step[i] += by * right(&d, k, i);
    }
}

void td_task_invert(td_task_inverse *inverse, const double *j, const double *e, int m, int n,
                    const bool *held, const td_task_damping *damping)
{
    if (held || !invert_regular(inverse, j, e, m, n, damping)) invert_any(inverse, j, e, m, n, held, damping);
}

void td_task_pseudo_inverse(double *plus, const double *j, int m, int n, double share)
{
    svd d;
    decompose(&d, j, m, n, NULL);
    memset(plus, 0, (size_t)(m * n) * sizeof *plus);
    for (int k = 0; k < d.count; k++) {
        if (!(d.s[k] > NOTHING * d.largest)) continue;
        const double gain = inverse_of(d.s[k], share * d.largest, 0);
        for (int i = 0; i < n; i++)
            for (int r = 0; r < m; r++) plus[i * m + r] += gain * right(&d, k, i) * left(&d, k, r);
    }
}

/* ---- gain ---- */

double td_servo_gain(const td_visual_servo_options *o, const double *step, int n)
{
    const double a = o->gain_zero - o->gain_infinity;
    double most = 0;
    for (int i = 0; i < n; i++) most = fmax(most, fabs(step[i]));
    return a == 0 ? o->gain_infinity : a * exp(-o->gain_slope / a * most) + o->gain_infinity;
}

/* ---- limits ---- */

/* 0 to 1 as the joint goes from where avoidance begins to where it is full; `side`: of which limit. */
static double nearness(int *side, const td_visual_servo_options *o, const td_robot_joint *j, double q)
{
    const double range = j->upper - j->lower, begin = o->rho * range, width = begin * o->rho1;
    if (!isfinite(range) || !(range > 0)) return 0;
    const double beyond = fmax(j->lower + begin - q, q - j->upper + begin);
    *side = q - j->lower < j->upper - q ? -1 : 1;
    if (!(beyond > 0)) return 0;
    return beyond > width ? 1 : 1 / (1 + exp(6 - 12 * beyond / width));
}

/* P g: P = sigma (I - J'e e'J / e'JJ'e) + (1 - sigma) (I - J+J), sigma from 0 at |e| = 0.1 to 1 at 0.7. Of e
 * only what J reaches counts: the rest stays, however near the goal is. */
static void project(double *out, const double *g, const double *j, const double *e,
                    const td_task_inverse *inverse, int m, int n)
{
    const double least = 0.1, most = 0.7;
    double down[N], size = 0, square = 0, dot = 0;
    for (int i = 0; i < m; i++) size += inverse->seen[i] * inverse->seen[i];
    size = sqrt(size);
    for (int k = 0; k < n; k++) {
        down[k] = 0;
        for (int i = 0; i < m; i++) down[k] += j[i * n + k] * e[i];
        square += down[k] * down[k];
        dot += down[k] * g[k];
    }
    double sigma = size > most    ? 1
                   : size < least ? 0
                                  : 1 / (1 + exp(6 - 12 * (size - least) / (most - least)));
    if (!(square > 0)) sigma = 0;
    for (int k = 0; k < n; k++) {
        out[k] = sigma > 0 ? sigma * (g[k] - down[k] * dot / square) : 0;
        if (inverse->rank < n) out[k] += (1 - sigma) * g[k];
    }
    for (int r = 0; r < inverse->rank && inverse->rank < n; r++) {
        double along = 0;
        for (int k = 0; k < n; k++) along += inverse->basis[r * n + k] * g[k];
        for (int k = 0; k < n; k++) out[k] -= (1 - sigma) * along * inverse->basis[r * n + k];
    }
}

bool td_servo_avoid(double *extra, const td_visual_servo_options *o, const td_robot *robot, const double *q,
                    const double *rate, const double *j, const double *e, const td_task_inverse *inverse,
                    int m)
{
    const int n = robot->joint_count;
    bool any = false;
    for (int k = 0; k < n; k++) {
        int side = 0;
        const double near = nearness(&side, o, robot->joint + k, q[k]);
        if (!(near > 0)) continue;
        double g[N] = {0}, away[N];
        g[k] = side;
        project(away, g, j, e, inverse, m, n);
        const double scale = fabs(rate[k]) / fabs(away[k]);
        if (!(scale < 1)) continue; /* the joint cannot be turned without the task (Marey and Chaumette) */
        for (int i = 0; i < n; i++) extra[i] -= near * (1 + o->tune) * scale * away[i];
        any = true;
    }
    return any;
}
