/* Hartley and Sturm (1997), "Triangulation". The epipolar lines of the left image form a pencil; each has one
 * partner in the right image. Of all pairs of lines the best is looked for, by a polynomial of degree 6.
 *
 * Both points are moved to their origins, and the images turned so that the epipoles are (1, 0, f) and
 * (1, 0, f'). F becomes [ff'd, -f'c, -f'd; -fb, a, b; -fd, c, d]; line t of the left image goes through
 * (0, t), its partner is (-f'(ct + d), at + b, ct + d), and the sum of both squared distances is
 *
 *   s(t) = t^2 / (1 + f^2 t^2) + (ct + d)^2 / ((at + b)^2 + f'^2 (ct + d)^2),
 *
 * whose derivative vanishes with t P^2 - (ad - bc)(1 + f^2 t^2)^2 (at + b)(ct + d), P the second denominator.
 */
#include <lapacke.h>
#include <math.h>
#include <string.h>

#include "recon/triangulation.h"

enum { DEGREE = 6, POLISH_STEPS = 20 };

typedef struct pencil {
    double a, b, c, d, f, g;            /* g: f' */
    double left_turn[2], right_turn[2]; /* (e1, e2) of the epipoles: cosine and sine */
} pencil;

/* The null vector of m's rows: the longest of their cross products. */
static void null_of_rows(double e[3], const double m[9])
{
    double longest = -1;
    for (int i = 0; i < 3; i++) {
        const double *p = m + 3 * i, *q = m + 3 * ((i + 1) % 3);
        const double n[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
        const double length = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        if (length > longest) {
            longest = length;
            memcpy(e, n, sizeof n);
        }
    }
}

/* False: a point lies on its epipole, so that every line goes through it. */
static bool make_pencil(pencil *p, const double f[9], const double left[2], const double right[2])
{
    double m[9], transposed[9], e[3], g[3];
    memcpy(m, f, sizeof m);
    for (int i = 0; i < 3; i++) m[3 * i + 2] += m[3 * i] * left[0] + m[3 * i + 1] * left[1];
    for (int j = 0; j < 3; j++) m[6 + j] += m[j] * right[0] + m[3 + j] * right[1];
    for (int i = 0; i < 9; i++) transposed[i] = m[i % 3 * 3 + i / 3];
    null_of_rows(e, m);
    null_of_rows(g, transposed);
    const double ne = hypot(e[0], e[1]), ng = hypot(g[0], g[1]);
    if (!(ne > 0) || !(ng > 0)) return false;
    const double ec = e[0] / ne, es = e[1] / ne, gc = g[0] / ng, gs = g[1] / ng;
    *p = (pencil){.f = e[2] / ne, .g = g[2] / ng, .left_turn = {ec, es}, .right_turn = {gc, gs}};
    /* Second and third row of R' m, times R^T's second and third column. */
    double second[3];
    for (int j = 0; j < 3; j++) second[j] = -gs * m[j] + gc * m[3 + j];
    p->a = -es * second[0] + ec * second[1];
    p->b = second[2];
    p->c = -es * m[6] + ec * m[7];
    p->d = m[8];
    return true;
}

/* s of the line t = u / v; v = 0: the one at t = infinity. */
static double cost(const pencil *p, double u, double v)
{
    const double n = p->c * u + p->d * v, m = p->a * u + p->b * v;
    return u * u / (v * v + p->f * p->f * u * u) + n * n / (m * m + p->g * p->g * n * n);
}

/* c (na+nb-1) = a (na) b (nb), lowest first. */
static void product(double *c, const double *a, int na, const double *b, int nb)
{
    memset(c, 0, (size_t)(na + nb - 1) * sizeof *c);
    for (int i = 0; i < na; i++)
        for (int j = 0; j < nb; j++) c[i + j] += a[i] * b[j];
}

static void polynomial(double s[DEGREE + 1], const pencil *p)
{
    const double ab[2] = {p->b, p->a}, cd[2] = {p->d, p->c}, ff[3] = {1, 0, p->f * p->f};
    double square[3], other[3], denominator[3], first[5], widths[5], both[3], second[7];
    product(square, ab, 2, ab, 2);
    product(other, cd, 2, cd, 2);
    for (int i = 0; i < 3; i++) denominator[i] = square[i] + p->g * p->g * other[i];
    product(first, denominator, 3, denominator, 3);
    product(widths, ff, 3, ff, 3);
    product(both, ab, 2, cd, 2);
    product(second, widths, 5, both, 3);
    const double determinant = p->a * p->d - p->b * p->c;
    double largest = 0;
    for (int i = 0; i <= DEGREE; i++) {
        s[i] = (i > 0 && i < 6 ? first[i - 1] : 0) - determinant * second[i];
        largest = fmax(largest, fabs(s[i]));
    }
    for (int i = 0; largest > 0 && i <= DEGREE; i++) s[i] /= largest;
}

/* Real parts of the roots, their number: eigenvalues of the companion matrices' pencil (Moler and Stewart's
 * QZ), which needs no division by a leading coefficient: it is nearly 0 when an epipole is far, and the roots
 * that go to infinity then disturb no others. */
static int roots(double t[DEGREE], const double s[DEGREE + 1])
{
    double a[DEGREE * DEGREE] = {0}, b[DEGREE * DEGREE] = {0}, real[DEGREE], imaginary[DEGREE], scale[DEGREE];
    int count = 0;
    for (int i = 0; i < DEGREE; i++) {
        a[i * DEGREE + DEGREE - 1] = -s[i];
        b[i * DEGREE + i] = i < DEGREE - 1 ? 1 : s[DEGREE];
        if (i > 0) a[i * DEGREE + i - 1] = 1;
    }
    if (LAPACKE_dggev(LAPACK_ROW_MAJOR, 'N', 'N', DEGREE, a, DEGREE, b, DEGREE, real, imaginary, scale, NULL,
                      1, NULL, 1) != 0)
        return 0;
    for (int i = 0; i < DEGREE; i++)
        if (isfinite(real[i] / scale[i])) t[count++] = real[i] / scale[i];
    return count;
}

/* Newton's steps from t, as far as they go. */
static double polished(double t, const double s[DEGREE + 1])
{
    for (int step = 0; step < POLISH_STEPS; step++) {
        double value = s[DEGREE], slope = 0;
        for (int i = DEGREE - 1; i >= 0; i--) {
            slope = slope * t + value;
            value = value * t + s[i];
        }
        const double next = t - value / slope;
        if (!isfinite(next) || next == t) break;
        t = next;
    }
    return t;
}

/* The root at which s is least: a real part that belongs to no real root costs more than the best. t = 0, the
 * line through the left point, is tried beside the eigenvalues. */
static void best_line(double *u, double *v, const pencil *p)
{
    double s[DEGREE + 1], t[DEGREE + 1];
    *u = 1;
    *v = 0;
    double least = cost(p, 1, 0);
    polynomial(s, p);
    const int count = roots(t, s);
    t[count] = 0;
    for (int i = 0; i <= count; i++) {
        const double exact = polished(t[i], s), candidates[2] = {exact, t[i]};
        for (int k = 0; k < 2; k++) {
            const double value = cost(p, candidates[k], 1);
            if (value < least || (isnan(least) && !isnan(value))) {
                least = value;
                *u = candidates[k];
                *v = 1;
            }
        }
    }
}

/* The point of the line (x, y, w) nearest to the origin, turned back and moved back. */
static void foot(double out[2], double x, double y, double w, const double turn[2], const double at[2])
{
    const double scale = -w / (x * x + y * y), px = scale * x, py = scale * y;
    out[0] = at[0] + turn[0] * px - turn[1] * py;
    out[1] = at[1] + turn[1] * px + turn[0] * py;
}

void td_hartley_sturm(double left_corrected[2], double right_corrected[2], const double f[9],
                      const double left[2], const double right[2])
{
    pencil p;
    double u, v;
    const double l[2] = {left[0], left[1]}, r[2] = {right[0], right[1]};
    memcpy(left_corrected, l, sizeof l);
    memcpy(right_corrected, r, sizeof r);
    if (!make_pencil(&p, f, l, r)) return;
    best_line(&u, &v, &p);
    const double n = p.c * u + p.d * v;
    foot(left_corrected, u * p.f, v, -u, p.left_turn, l);
    foot(right_corrected, -p.g * n, p.a * u + p.b * v, n, p.right_turn, r);
}
