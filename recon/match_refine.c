/* Symmetric least-squares matching (Gruen 1985; symmetric: Nehab, Rusinkiewicz and Davis 2005).
 *
 * With s a place in the window, D the affine difference and c the wanted right pixel,
 *
 *   e(s) = (1 - q/2) R(c + s + D s/2) - (1 + q/2) L(left + s - D s/2) - o
 *
 * is made small in the least-squares sense over c, D, q (gain) and o (offset). Everything is shared out by
 * halves; the gradient is the mean of both images' (Malis 2004), so that the images' noise, being in gradient
 * and residual alike, cancels in the normal equations' right side.
 *
 * Both images are read through the quintic B-spline, without making it interpolate: it smooths by 0.7 px,
 * lets through less than 1 % of what aliases at 0.3 cycles/px, and the smoothed noise has nearly the same
 * variance between pixels as on them. An interpolating kernel has not, and pulls the match towards half
 * pixels.
 *
 * Smoothed noise is correlated from sample to sample. The solution is linear in the pixels' noise n: with
 * weights W (samples, pixels), d = H^-1 J^T W n, so its covariance is H^-1 (J^T W)(J^T W)^T H^-1 sigma^2, and
 * the residuals' expected sum of squares is sigma^2 (|W|^2 - tr(H^-1 (J^T W)(J^T W)^T)). Both are evaluated
 * as they stand, by spreading J over the pixels. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "recon/match_internal.h"

enum {
    TAPS = 6,
    UNKNOWNS = 8, /* c (2), D (2,2), q, o */
    STEPS = 20,
};

#define CONVERGED 1e-4    /* px */
#define FURTHEST 2.5      /* px from the start */
#define LARGEST_SHEAR 0.6 /* of D: more is no longer the same window */
#define LARGEST_SIGMA 0.5 /* px: one direction is not determined */
#define QUANTISATION (1. / 12)
/* Of white noise of variance 1 read through the spline: variance of value and of a derivative, and the sum of
 * the squared covariances with all samples one pixel apart in rows and columns. */
#define VALUE_VARIANCE 0.1552
#define SLOPE_VARIANCE 0.1475
#define SUM_OF_SQUARES 0.0786

/* Values and gradients of both windows at the samples. */
typedef struct sample {
    double l, lx, ly, r, rx, ry;
} sample;

typedef struct unknowns {
    double c[2], d[4], q, o;
} unknowns;

typedef struct window {
    const td_image *left, *right;
    double at[2]; /* left pixel */
    int k, side;
    sample *sample;          /* (side,side) */
    double (*row)[UNKNOWNS]; /* (side*side) J */
    double *e;               /* (side*side) */
    double normal[UNKNOWNS * UNKNOWNS];
} window;

/* Quintic B-spline weights of the pixels floor(x) - 2 … + 3, and of its derivative, t = x - floor(x). */
static void spline_weights(double w[TAPS], double d[TAPS], double t)
{
    const double u = 1 - t, t2 = t * t, u2 = u * u, t4 = t2 * t2, u4 = u2 * u2;
    w[0] = u4 * u / 120;
    w[1] = (26 - t * (50 - t * (20 + t * (20 - t * (20 - t * 5))))) / 120;
    w[2] = (66 - t2 * (60 - t2 * (30 - t * 10))) / 120;
    w[3] = (66 - u2 * (60 - u2 * (30 - u * 10))) / 120;
    w[4] = (26 - u * (50 - u * (20 + u * (20 - u * (20 - u * 5))))) / 120;
    w[5] = t4 * t / 120;
    d[0] = -u4 / 24;
    d[1] = (-10 + t * (8 + t * (12 - t * (16 - t * 5)))) / 24;
    d[2] = t * (-24 + t2 * (24 - t * 10)) / 24;
    d[3] = -u * (-24 + u2 * (24 - u * 10)) / 24;
    d[4] = -(-10 + u * (8 + u * (12 - u * (16 - u * 5)))) / 24;
    d[5] = t4 / 24;
}

/* First of the pixels under the kernel; false where it leaves the image. */
static bool place(int *first, double *fraction, double x, int size)
{
    const double whole = floor(x);
    if (!(whole >= 2 && whole < size - 3)) return false;
    *first = (int)whole - 2;
    *fraction = x - whole;
    return true;
}

static bool read_image(double *value, double *gx, double *gy, const td_image *image, double x, double y)
{
    int i, j;
    double fx, fy, wx[TAPS], wy[TAPS], dx[TAPS], dy[TAPS];
    if (!place(&i, &fx, x, image->width) || !place(&j, &fy, y, image->height)) return false;
    spline_weights(wx, dx, fx);
    spline_weights(wy, dy, fy);
    double v = 0, vx = 0, vy = 0;
    for (int m = 0; m < TAPS; m++) {
        const uint8_t *p = image->data + (size_t)(j + m) * (size_t)image->width + i;
        double sum = 0, slope = 0;
        for (int n = 0; n < TAPS; n++) {
            sum += wx[n] * p[n];
            slope += dx[n] * p[n];
        }
        v += wy[m] * sum;
        vx += wy[m] * slope;
        vy += dy[m] * sum;
    }
    *value = v;
    *gx = vx;
    *gy = vy;
    return true;
}

/* Places of sample (sx, sy) in the left and the right image. */
static void places(double left[2], double right[2], const window *w, const unknowns *p, int sx, int sy)
{
    for (int i = 0; i < 2; i++) {
        const double half = (p->d[2 * i] * sx + p->d[2 * i + 1] * sy) / 2, s = i == 0 ? sx : sy;
        left[i] = w->at[i] + s - half;
        right[i] = p->c[i] + s + half;
    }
}

static bool read_windows(window *w, const unknowns *p)
{
    sample *s = w->sample;
    for (int y = -w->k; y <= w->k; y++)
        for (int x = -w->k; x <= w->k; x++, s++) {
            double l[2], r[2];
            places(l, r, w, p, x, y);
            if (!read_image(&s->l, &s->lx, &s->ly, w->left, l[0], l[1]) ||
                !read_image(&s->r, &s->rx, &s->ry, w->right, r[0], r[1]))
                return false;
        }
    return true;
}

/* Residuals, their derivatives J, the normal matrix J^T J and the right side J^T e. */
static void linearise(window *w, const unknowns *p, double side[UNKNOWNS])
{
    const double a = 1 - p->q / 2, b = 1 + p->q / 2;
    const sample *s = w->sample;
    size_t n = 0;
    memset(w->normal, 0, sizeof w->normal);
    memset(side, 0, UNKNOWNS * sizeof *side);
    for (int y = -w->k; y <= w->k; y++)
        for (int x = -w->k; x <= w->k; x++, s++, n++) {
            const double gx = (a * s->rx + b * s->lx) / 2, gy = (a * s->ry + b * s->ly) / 2;
            const double j[UNKNOWNS] = {gx, gy, gx * x, gx * y, gy * x, gy * y, -(s->r + s->l) / 2, -1};
            w->e[n] = a * s->r - b * s->l - p->o;
            memcpy(w->row[n], j, sizeof j);
            for (int i = 0; i < UNKNOWNS; i++) {
                side[i] += j[i] * w->e[n];
                for (int k = 0; k <= i; k++) w->normal[i * UNKNOWNS + k] += j[i] * j[k];
            }
        }
    for (int i = 0; i < UNKNOWNS; i++)
        for (int k = 0; k < i; k++) w->normal[k * UNKNOWNS + i] = w->normal[i * UNKNOWNS + k];
}

/* Gain and offset that make mean and deviation of both windows agree: the iteration's start. */
static bool start_gain(const window *w, unknowns *p)
{
    const int count = w->side * w->side;
    double l = 0, r = 0, ll = 0, rr = 0;
    for (int i = 0; i < count; i++) {
        l += w->sample[i].l / count;
        r += w->sample[i].r / count;
    }
    for (int i = 0; i < count; i++) {
        ll += (w->sample[i].l - l) * (w->sample[i].l - l);
        rr += (w->sample[i].r - r) * (w->sample[i].r - r);
    }
    if (!(ll > 0 && rr > 0)) return false;
    const double gain = sqrt(rr / ll);
    p->q = 2 * (gain - 1) / (gain + 1);
    p->o = (1 - p->q / 2) * r - (1 + p->q / 2) * l;
    return true;
}

/* x = inverse side, of the scaled system: gain and shear have other sizes than shifts. */
static bool invert_normal(double inverse[UNKNOWNS * UNKNOWNS], const double normal[UNKNOWNS * UNKNOWNS])
{
    double scale[UNKNOWNS], scaled[UNKNOWNS * UNKNOWNS];
    for (int i = 0; i < UNKNOWNS; i++) {
        if (!(normal[i * (UNKNOWNS + 1)] > 1e-9)) return false;
        scale[i] = 1 / sqrt(normal[i * (UNKNOWNS + 1)]);
    }
    for (int i = 0; i < UNKNOWNS * UNKNOWNS; i++)
        scaled[i] = normal[i] * scale[i / UNKNOWNS] * scale[i % UNKNOWNS];
    if (td_invert_spd(scaled, scaled, UNKNOWNS, NULL) != TD_OK) return false;
    for (int i = 0; i < UNKNOWNS * UNKNOWNS; i++)
        inverse[i] = scaled[i] * scale[i / UNKNOWNS] * scale[i % UNKNOWNS];
    return true;
}

/* Gauss and Newton's iteration. `inverse` is that of the last normal matrix. */
static bool iterate(window *w, unknowns *p, double inverse[UNKNOWNS * UNKNOWNS])
{
    const double start[2] = {p->c[0], p->c[1]};
    if (!read_windows(w, p) || !start_gain(w, p)) return false;
    for (int step = 0; step < STEPS; step++) {
        double side[UNKNOWNS], x[UNKNOWNS], *value = p->c;
        linearise(w, p, side);
        if (!invert_normal(inverse, w->normal)) return false;
        td_multiply(x, inverse, side, UNKNOWNS, UNKNOWNS, 1);
        for (int i = 0; i < 2; i++) value[i] -= x[i];
        for (int i = 0; i < 4; i++) p->d[i] -= x[2 + i];
        p->q -= x[6];
        p->o -= x[7];
        for (int i = 0; i < 4; i++)
            if (!(fabs(p->d[i]) <= LARGEST_SHEAR)) return false;
        if (!(hypot(p->c[0] - start[0], p->c[1] - start[1]) <= FURTHEST) || !(fabs(p->q) < 1.5) ||
            !read_windows(w, p))
            return false;
        if (hypot(x[0], x[1]) < CONVERGED) {
            linearise(w, p, side);
            return invert_normal(inverse, w->normal);
        }
    }
    return false;
}

/* Adds J^T W of one image to `spread` (box,box,UNKNOWNS) around `corner`; returns |W|^2 of the image. */
static double spread_rows(double *spread, int box, const int corner[2], const window *w, const unknowns *p,
                          bool right)
{
    double squares = 0;
    size_t n = 0;
    for (int y = -w->k; y <= w->k; y++)
        for (int x = -w->k; x <= w->k; x++, n++) {
            double at[2][2], wx[TAPS], wy[TAPS], unused[TAPS], sx = 0, sy = 0;
            places(at[0], at[1], w, p, x, y);
            const double *place_ = at[right], ix = floor(place_[0]), iy = floor(place_[1]);
            spline_weights(wx, unused, place_[0] - ix);
            spline_weights(wy, unused, place_[1] - iy);
            for (int i = 0; i < TAPS; i++) {
                sx += wx[i] * wx[i];
                sy += wy[i] * wy[i];
            }
            squares += sx * sy;
            for (int m = 0; m < TAPS; m++)
                for (int i = 0; i < TAPS; i++) {
                    const int column = (int)ix - 2 + i - corner[0], line = (int)iy - 2 + m - corner[1];
                    double *to = spread + (size_t)(line * box + column) * UNKNOWNS;
                    for (int u = 0; u < UNKNOWNS; u++) to[u] += wx[i] * wy[m] * w->row[n][u];
                }
        }
    return squares;
}

/* (J^T W)(J^T W)^T of both images, each with its share of the gain; returns |W|^2. False: out of memory. */
static bool noise_normal(double noise[UNKNOWNS * UNKNOWNS], double *squares, const window *w,
                         const unknowns *p)
{
    const int reach = (int)ceil(w->k * (1 + LARGEST_SHEAR)) + TAPS, box = 2 * reach + 1;
    const size_t cells = (size_t)box * (size_t)box;
    double *spread = malloc(cells * UNKNOWNS * sizeof *spread);
    if (!spread) return false;
    memset(noise, 0, UNKNOWNS * UNKNOWNS * sizeof *noise);
    *squares = 0;
    for (int image = 0; image < 2; image++) {
        const double *centre = image ? p->c : w->at, share = image ? 1 - p->q / 2 : 1 + p->q / 2;
        const int corner[2] = {(int)floor(centre[0]) - reach, (int)floor(centre[1]) - reach};
        memset(spread, 0, cells * UNKNOWNS * sizeof *spread);
        *squares += share * share * spread_rows(spread, box, corner, w, p, image == 1);
        for (size_t c = 0; c < cells; c++)
            for (int i = 0; i < UNKNOWNS; i++)
                for (int k = 0; k < UNKNOWNS; k++)
                    noise[i * UNKNOWNS + k] +=
                        share * share * spread[c * UNKNOWNS + (size_t)i] * spread[c * UNKNOWNS + (size_t)k];
    }
    free(spread);
    return true;
}

/* The normal matrix less what noise of this variance puts into it. */
static bool invert_noiseless(double inverse[UNKNOWNS * UNKNOWNS], const window *w, const unknowns *p,
                             double variance)
{
    const double a = 1 - p->q / 2, b = 1 + p->q / 2, count = (double)w->side * w->side;
    const double slope = SLOPE_VARIANCE * variance * (a * a + b * b) / 4 * count;
    const double moment = slope * w->k * (w->k + 1) / 3; /* times the mean square of a coordinate */
    const double own[UNKNOWNS] = {
        slope, slope, moment, moment, moment, moment, VALUE_VARIANCE * variance / 2 * count};
    double normal[UNKNOWNS * UNKNOWNS];
    memcpy(normal, w->normal, sizeof normal);
    for (int i = 0; i < UNKNOWNS; i++) normal[i * (UNKNOWNS + 1)] -= own[i];
    return invert_normal(inverse, normal);
}

/* Covariance of c. False: no redundancy, or one direction is not determined. */
static bool find_covariance(double covariance[4], const window *w, const unknowns *p,
                            double inverse[UNKNOWNS * UNKNOWNS])
{
    double noise[UNKNOWNS * UNKNOWNS], all[UNKNOWNS * UNKNOWNS], weights, sum = 0, taken = 0;
    const double a = 1 - p->q / 2, b = 1 + p->q / 2, both = a * a + b * b;
    if (!noise_normal(noise, &weights, w, p)) return false;
    for (int i = 0; i < UNKNOWNS * UNKNOWNS; i++) taken += inverse[i] * noise[i];
    for (int i = 0; i < w->side * w->side; i++) sum += w->e[i] * w->e[i];
    const double redundancy = weights - taken;
    const double freedom = redundancy * redundancy / (SUM_OF_SQUARES * both * both * w->side * w->side);
    if (!(freedom > 4)) return false;
    const double variance = fmax(sum / redundancy, QUANTISATION);
    if (!invert_noiseless(inverse, w, p, variance) ||
        td_sandwich(all, inverse, noise, UNKNOWNS, UNKNOWNS, NULL) != TD_OK)
        return false;
    const double scale = variance * freedom / (freedom - 2);
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 2; k++)
            covariance[2 * i + k] = scale * (all[i * UNKNOWNS + k] + all[k * UNKNOWNS + i]) / 2;
    const double mean = (covariance[0] + covariance[3]) / 2;
    const double largest = mean + hypot((covariance[0] - covariance[3]) / 2, covariance[1]);
    return largest <= LARGEST_SIGMA * LARGEST_SIGMA;
}

static double window_correlation(const window *w)
{
    const int count = w->side * w->side;
    double l = 0, r = 0, ll = 0, rr = 0, lr = 0;
    for (int i = 0; i < count; i++) {
        l += w->sample[i].l / count;
        r += w->sample[i].r / count;
    }
    for (int i = 0; i < count; i++) {
        const double a = w->sample[i].l - l, b = w->sample[i].r - r;
        ll += a * a;
        rr += b * b;
        lr += a * b;
    }
    return lr / sqrt(ll * rr);
}

bool td_match_refine_correlated(td_match *match, double *correlation, const td_image *left,
                                const td_image *right, int half_window)
{
    const int side = 2 * half_window + 1;
    const size_t count = (size_t)side * (size_t)side;
    double inverse[UNKNOWNS * UNKNOWNS], covariance[4];
    unknowns p = {{match->right[0], match->right[1]}, {0}, 0, 0};
    window w = {left, right, {match->left[0], match->left[1]}, half_window, side, NULL, NULL, NULL, {0}};
    if (half_window < 1 || left->channels != 1 || right->channels != 1) return false;
    w.sample = malloc(count * sizeof *w.sample);
    w.row = malloc(count * sizeof *w.row);
    w.e = malloc(count * sizeof *w.e);
    const bool found =
        w.sample && w.row && w.e && iterate(&w, &p, inverse) && find_covariance(covariance, &w, &p, inverse);
    if (found) {
        memcpy(match->right, p.c, sizeof p.c);
        memcpy(match->covariance, covariance, sizeof covariance);
        match->refined = true;
        if (correlation) *correlation = window_correlation(&w);
    }
    free(w.sample);
    free(w.row);
    free(w.e);
    return found;
}

bool td_match_refine(td_match *match, const td_image *left, const td_image *right, int half_window)
{
    return td_match_refine_correlated(match, NULL, left, right, half_window);
}
