/* Fits the image of a corner by least squares over the pixels of a disc: where four squares of a chessboard
 * meet,
 *
 *     grey(x) = mean + slope . x - (contrast / 2) S(d1 / w, d2 / w),
 *
 * d1, d2 the distances to two lines through the corner, w the blur of their edges, and S the product of the
 * signs of d1 and d2, blurred: E(d1 / w) E(d2 / w) with E(t) = erf(t / sqrt 2), and a term for oblique lines.
 * Of a lone corner one quadrant is dark, and (E(d1 / w) + E(d2 / w) + S - 1) / 2 stands in the place of S.
 * Levenberg-Marquardt with analytic derivatives. What the model leaves out (overshoot from sharpening, a
 * curved response) is the same on both sides of the corner, and so cannot move it.
 *
 * The sigma is a sandwich estimate (Huber 1967; for correlated residuals Newey and West 1987): residuals of
 * JPEG and Bayer images are neither white nor as strong in the squares as on the edges. The scores (influence
 * of a pixel on the corner times its residual) are summed over blocks of 3x3 pixels joined with the block
 * opposite, which cancels what is symmetric about the corner, and the sums' squares are compared with their
 * expectation for white noise.
 *
 * Known failures: lines bent by distortion, of curvature k, shift the corner by up to k radius^2 / 6 (0.01 px
 * where a wide lens bends most); illumination that falls by 0.1 % per pixel shifts it by 0.005 px. */
#include "calib/corner.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/corner_internal.h"

enum {
    N = CORNER_PARAMETERS,
    LANES = CORNER_LANES,
    MOST_ITERATIONS = 15,
    BLOCK = 3,
    BLOCK_SIDE = 2 * (CORNER_MAX_RADIUS / BLOCK + 1) + 1
};

static const double FIRST_RADIUS = 6, FIRST_SHARE = 0.13, MOST_FIRST_RADIUS = 12, USUAL_RADIUS = 10,
                    LEAST_RADIUS = 3;   /* px */
static const double SQUARE_SHARE = 0.6; /* of the distance to the next edge */
static const double LEAST_BLUR = 0.29;  /* px: that of a pixel itself, 1 / sqrt 12 */
static const double MOST_RESIDUAL = 0.25, MOST_TURN = 0.3, MOST_SIGMA = 0.5; /* of the contrast; sine; px */
static const float OBLIQUE_REACH = 4.5f;                                     /* in blurs */
static const double LEAST_CONTRAST = 4;                                      /* grey levels */
static const double MARGIN = 2.5;                       /* from what is not in the model, in blurs */
static const double SIDE_SHARE = 0.6;                   /* of a tag's side */
static const double LEAST_SLACK = 2.5;                  /* px */
static const double FIRST_STEP = 0.1, LAST_STEP = 0.01; /* at which a fit ends, px */

/* exp(-y) for y >= 0, not less than exp(-16), as the 32nd power of a short series: no branch, no table,
 * vector code. */
static inline float bell(float y)
{
    float t = (y + 16 - fabsf(y - 16)) * (1.0f / 64); /* the lesser of y and 16, over 32 */
    float e = 1 - t * (1 - t * (1.0f / 2) * (1 - t * (1.0f / 3) * (1 - t * (1.0f / 4))));
    e *= e, e *= e, e *= e, e *= e;
    return e * e;
}

/* erf(z) and, in *bell_z, exp(-z^2); Abramowitz and Stegun 7.1.26, error below 2e-7. */
static inline float edge(float z, float *bell_z)
{
    float t = 1 / (1 + 0.3275911f * fabsf(z));
    float p =
        ((((1.061405429f * t - 1.453152027f) * t + 1.421413741f) * t - 0.284496736f) * t + 0.254829592f) * t;
    *bell_z = bell(z * z);
    return copysignf(1 - p * *bell_z, z);
}

/* What the model needs of its parameters. */
typedef struct lines {
    float x, y, c1, s1, c2, s2, blur, mean, half, slope_x, slope_y;
} lines;

/* Edges as if they crossed at right angles: the product of two, or the one quadrant. */
static inline void crossed_edges(corner_window *window, lines m, bool wedge)
{
    const float to_z = 0.70710678f / m.blur;           /* 1 / (w sqrt 2) */
    const float steep = 0.79788456f / m.blur * m.half; /* half sqrt(2 / pi) / w */
    float(*d)[CORNER_MAX_PIXELS] = window->derivative;
    for (int i = 0; i < window->count; i++) {
        float x = window->x[i] - m.x, y = window->y[i] - m.y;
        float d1 = m.c1 * y - m.s1 * x, d2 = m.c2 * y - m.s2 * x; /* across the lines */
        float bell_1, bell_2, e1 = edge(d1 * to_z, &bell_1), e2 = edge(d2 * to_z, &bell_2);
        float by_e1 = wedge ? 0.5f * (1 + e2) : e2, by_e2 = wedge ? 0.5f * (1 + e1) : e1;
        float by_half = wedge ? 0.5f * (e1 + e2 + e1 * e2 - 1) : e1 * e2;
        float by_d1 = steep * bell_1 * by_e1, by_d2 = steep * bell_2 * by_e2;
        window->residual[i] = window->grey[i] - (m.mean + m.slope_x * window->x[i] +
                                                 m.slope_y * window->y[i] + m.half * by_half);
        d[CORNER_X][i] = by_d1 * m.s1 + by_d2 * m.s2;
        d[CORNER_Y][i] = -(by_d1 * m.c1 + by_d2 * m.c2);
        d[CORNER_ANGLE_1][i] = -by_d1 * (m.c1 * x + m.s1 * y);
        d[CORNER_ANGLE_2][i] = -by_d2 * (m.c2 * x + m.s2 * y);
        d[CORNER_BLUR][i] = -(by_d1 * d1 + by_d2 * d2) / m.blur;
        d[CORNER_HALF][i] = by_half;
    }
}

/* Adds what oblique lines change: with r the cosine of the angle between the lines and p the density of two
 * normal numbers of correlation r, the blurred product of two signs is E1 E2 + 4 times the integral of p over
 * r from 0 to r (Plackett 1954), here 4 r p(r / 2). */
static void oblique_edges(corner_window *window, lines m, int first, int last)
{
    const float to_z = 0.70710678f / m.blur, r = m.c1 * m.c2 + m.s1 * m.s2,
                r_by_angle_2 = m.s1 * m.c2 - m.c1 * m.s2;
    const float t = r / 2, sharp = 1 / (1 - t * t), share = window->wedge ? 0.5f : 1,
                density = share * 0.63661977f * sqrtf(sharp); /* 4 / (2 pi) sqrt … */
    float(*d)[CORNER_MAX_PIXELS] = window->derivative;
    for (int i = first; i < last; i++) {
        float x = window->x[i] - m.x, y = window->y[i] - m.y;
        float z1 = (m.c1 * y - m.s1 * x) * to_z, z2 = (m.c2 * y - m.s2 * x) * to_z;
        float zz = z1 * z2, square = z1 * z1 + z2 * z2;
        float p = density * bell((square - 2 * t * zz) * sharp), e = r * p;
        float pull = -2 * m.half * e * sharp * to_z;
        float by_d1 = pull * (z1 - t * z2), by_d2 = pull * (z2 - t * z1);
        float by_r = m.half * (p + e * sharp * (t / 2 + sharp * ((1 + t * t) * zz - t * square)));
        window->residual[i] -= m.half * e;
        d[CORNER_X][i] += by_d1 * m.s1 + by_d2 * m.s2;
        d[CORNER_Y][i] -= by_d1 * m.c1 + by_d2 * m.c2;
        d[CORNER_ANGLE_1][i] -= by_d1 * (m.c1 * x + m.s1 * y) + by_r * r_by_angle_2;
        d[CORNER_ANGLE_2][i] -= by_d2 * (m.c2 * x + m.s2 * y) - by_r * r_by_angle_2;
        d[CORNER_BLUR][i] -= (by_d1 * z1 + by_d2 * z2) / (m.blur * to_z);
        d[CORNER_HALF][i] += e;
    }
}

void td_corner_model(corner_window *window, const double parameter[N])
{
    const double a1 = parameter[CORNER_ANGLE_1], a2 = parameter[CORNER_ANGLE_2];
    const lines m = {.x = (float)parameter[CORNER_X],
                     .y = (float)parameter[CORNER_Y],
                     .c1 = (float)cos(a1),
                     .s1 = (float)sin(a1),
                     .c2 = (float)cos(a2),
                     .s2 = (float)sin(a2),
                     .blur = (float)parameter[CORNER_BLUR],
                     .mean = (float)parameter[CORNER_MEAN],
                     .half = (float)parameter[CORNER_HALF],
                     .slope_x = (float)parameter[CORNER_SLOPE_X],
                     .slope_y = (float)parameter[CORNER_SLOPE_Y]};
    if (window->wedge)
        crossed_edges(window, m, true);
    else
        crossed_edges(window, m, false);
    const float reach = OBLIQUE_REACH * m.blur;
    int first = 0, last = window->count;
    while (first < last && window->y[first] < m.y - reach) first++;
    while (last > first && window->y[last - 1] > m.y + reach) last--;
    oblique_edges(window, m, first, last);
    for (int i = window->count; i % LANES; i++) {
        window->residual[i] = 0;
        for (int k = 0; k < N; k++) window->derivative[k][i] = 0;
    }
}

/* Scalar product of whole rows of LANES, in fixed lanes: vector code, and the same sum at any width of
 * vectors. */
static double dot(const float *a, const float *b, int count)
{
    float sum[LANES] = {0};
    for (int i = 0; i < count; i += LANES)
        for (int k = 0; k < LANES; k++) sum[k] += a[i + k] * b[i + k];
    for (int half = LANES / 2; half > 0; half /= 2)
        for (int k = 0; k < half; k++) sum[k] += sum[k + half];
    return (double)sum[0];
}

/* Whether a pixel at (x, y) from a tag's corner is far enough from all that is not in the model. */
static bool in_shape(const tag_shape *s, double x, double y, double margin)
{
    const double *a = s->along[0], *b = s->along[1], cross = a[0] * b[1] - a[1] * b[0];
    const double u = (x * b[1] - y * b[0]) / cross, v = (a[0] * y - a[1] * x) / cross;           /* cells */
    const double height[2] = {fabs(cross) / hypot(b[0], b[1]), fabs(cross) / hypot(a[0], a[1])}; /* px */
    const double coordinate[2] = {u, v};
    bool in_code = true;
    for (int i = 0; i < 2; i++) {
        double inside = s->inside - fmin(margin / height[i], 0.5 * s->inside);
        double outside = s->outside - fmin(margin / height[i], 0.5 * s->outside);
        in_code = in_code && coordinate[i] > inside;
        if (coordinate[i] < -outside || coordinate[i] > s->side - inside) return false;
    }
    return !in_code;
}

/* The pixels of the disc about `centre` (image, px), which must lie inside the image; of a tag's corner
 * (`shape`, else NULL) those that its model explains. */
static void gather(corner_window *window, const td_image *image, const double centre[2], double radius,
                   const tag_shape *shape, double blur)
{
    const double margin = MARGIN * blur;
    int cx = (int)lround(centre[0]), cy = (int)lround(centre[1]), reach = (int)radius + 1, count = 0;
    for (int y = cy - reach; y <= cy + reach; y++) {
        double dy = y - centre[1], square = radius * radius - dy * dy;
        if (square < 0) continue;
        const uint8_t *row = image->data + (size_t)y * (size_t)image->width;
        int first = (int)ceil(centre[0] - sqrt(square)), last = (int)floor(centre[0] + sqrt(square));
        for (int x = first; x <= last; x++) {
            if (shape && !in_shape(shape, x - centre[0], dy, margin)) continue;
            window->x[count] = (float)(x - cx);
            window->y[count] = (float)(y - cy);
            window->grey[count++] = row[x];
        }
    }
    window->origin[0] = cx, window->origin[1] = cy, window->count = count;
    for (int i = 0; i < count; i++) window->derivative[CORNER_MEAN][i] = 1;
    for (int i = count; i % LANES; i++) window->grey[i] = 0;
    memcpy(window->derivative[CORNER_SLOPE_X], window->x, (size_t)count * sizeof *window->x);
    memcpy(window->derivative[CORNER_SLOPE_Y], window->y, (size_t)count * sizeof *window->y);
}

/* a := lower triangle L of a = L L^T, with the reciprocals of its diagonal in the diagonal's place; false
 * when `a` is not positive. */
static bool factor(double a[N][N])
{
    for (int i = 0; i < N; i++) {
        for (int j = 0; j <= i; j++) {
            double s = a[i][j];
            for (int k = 0; k < j; k++) s -= a[i][k] * a[j][k];
            if (i == j && !(s > 0)) return false;
            a[i][j] = i == j ? 1 / sqrt(s) : s * a[j][j];
        }
    }
    return true;
}

/* b := L^-1 b */
static void forward(const double l[N][N], double b[N])
{
    for (int i = 0; i < N; i++) {
        double s = b[i];
        for (int k = 0; k < i; k++) s -= l[i][k] * b[k];
        b[i] = s * l[i][i];
    }
}

/* b := L^-T b */
static void backward(const double l[N][N], double b[N])
{
    for (int i = N - 1; i >= 0; i--) {
        double s = b[i];
        for (int k = i + 1; k < N; k++) s -= l[k][i] * b[k];
        b[i] = s * l[i][i];
    }
}

typedef struct fit {
    double parameter[N];
    double normal[N][N]; /* sum of derivatives' products (lower triangle) */
    double cost;         /* sum of squared residuals */
} fit;

/* Mean and contrast that suit the other parameters, by projection. */
static void first_greys(fit *f, corner_window *window)
{
    f->parameter[CORNER_MEAN] = f->parameter[CORNER_HALF] = 0;
    td_corner_model(window, f->parameter);
    const float *one = window->derivative[CORNER_MEAN], *e = window->derivative[CORNER_HALF];
    double n = window->count, s = dot(one, window->grey, window->count),
           se = dot(e, window->grey, window->count);
    double e1 = dot(one, e, window->count), ee = dot(e, e, window->count);
    f->parameter[CORNER_HALF] = (se - s * e1 / n) / (ee - e1 * e1 / n);
    f->parameter[CORNER_MEAN] = (s - f->parameter[CORNER_HALF] * e1) / n;
}

/* Takes the blur out of the normal equations: it stays where it is. */
static void hold_blur(double normal[N][N], double gradient[N])
{
    for (int i = 0; i < N; i++)
        normal[i > CORNER_BLUR ? i : CORNER_BLUR][i > CORNER_BLUR ? CORNER_BLUR : i] = 0;
    normal[CORNER_BLUR][CORNER_BLUR] = 1;
    gradient[CORNER_BLUR] = 0;
}

static void normal_equations(fit *f, double gradient[N], const corner_window *window)
{
    for (int i = 0; i < N; i++) {
        gradient[i] = dot(window->derivative[i], window->residual, window->count);
        for (int j = 0; j <= i; j++)
            f->normal[i][j] = dot(window->derivative[i], window->derivative[j], window->count);
    }
}

/* The step under Marquardt's scaling, and the decrease of the cost that the linear model predicts for it. */
static bool solve_step(double step[N], double *predicted, const fit *f, const double gradient[N],
                       double damping)
{
    double l[N][N];
    memcpy(l, f->normal, sizeof l);
    memcpy(step, gradient, N * sizeof *step);
    for (int i = 0; i < N; i++) l[i][i] *= 1 + damping;
    if (f->parameter[CORNER_BLUR] <= LEAST_BLUR && gradient[CORNER_BLUR] < 0) hold_blur(l, step);
    if (!factor(l)) return false;
    forward(l, step), backward(l, step);
    *predicted = 0;
    for (int i = 0; i < N; i++) *predicted += step[i] * (gradient[i] + damping * f->normal[i][i] * step[i]);
    return true;
}

/* Levenberg-Marquardt, until the corner moves by less than `enough`. False when it does not come to that. */
static bool minimise(fit *f, corner_window *window, double enough)
{
    double damping = 1e-3, gradient[N], step[N], trial[N], predicted;
    td_corner_model(window, f->parameter);
    f->cost = dot(window->residual, window->residual, window->count);
    normal_equations(f, gradient, window);
    for (int iteration = 0; iteration < MOST_ITERATIONS; iteration++) {
        if (!solve_step(step, &predicted, f, gradient, damping)) return false;
        for (int i = 0; i < N; i++) trial[i] = f->parameter[i] + step[i];
        trial[CORNER_BLUR] = fmax(trial[CORNER_BLUR], LEAST_BLUR);
        td_corner_model(window, trial);
        double cost = dot(window->residual, window->residual, window->count), gain = f->cost - cost;
        bool small = damping < 1 && hypot(step[CORNER_X], step[CORNER_Y]) < enough;
        if (gain > 0 || small) {
            memcpy(f->parameter, trial, sizeof trial);
            f->cost = cost;
            if (small) return true;
            normal_equations(f, gradient, window);
        }
        /* A poor gain tells of steps to and fro across the minimum, as on the sharpest edges. */
        damping = gain > 0.25 * predicted ? 0.1 * damping : 10 * damping + 0.03;
    }
    return false;
}

/* Blocks are numbered outwards from the corner's nearest half pixel, so that each has its mirror image. */
static int block_of(int pixel, int twice_centre)
{
    int k = 2 * pixel - twice_centre; /* twice the distance */
    int b = (abs(k) + BLOCK) / (2 * BLOCK);
    return k < 0 ? -b : b;
}

/* Sums over a block and the block opposite. */
typedef struct score {
    double sum[2];       /* of influence times residual, px */
    double square;       /* of the influence, over both coordinates */
    double shared[2][N]; /* of influence times derivatives */
} score;

/* Of each pixel on coordinate `c` of the corner, px per grey level: a row of (J^T J)^-1 J^T. */
static void influence_of(float *influence, const double row[N], const corner_window *window)
{
    float r[N];
    for (int k = 0; k < N; k++) r[k] = (float)row[k];
    for (int i = 0; i < window->count; i++) {
        float sum = 0;
        for (int k = 0; k < N; k++) sum += r[k] * window->derivative[k][i];
        influence[i] = sum;
    }
}

/* Variances of a coordinate, px^2: for white noise of the residuals' variance, and by the block sums. */
static bool variances(double *white, double *blocked, const fit *f, corner_window *window)
{
    double l[N][N], row[2][N] = {{0}};
    memcpy(l, f->normal, sizeof l);
    if (f->parameter[CORNER_BLUR] <= LEAST_BLUR) {
        hold_blur(l, row[0]);
        memset(window->derivative[CORNER_BLUR], 0, sizeof window->derivative[CORNER_BLUR]);
    }
    if (window->count <= N || !factor(l)) return false;
    float influence[2][CORNER_MAX_PIXELS];
    for (int c = 0; c < 2; c++) {
        row[c][CORNER_X + c] = 1;
        forward(l, row[c]), backward(l, row[c]);
        influence_of(influence[c], row[c], window);
    }
    double unit = (row[0][CORNER_X] + row[1][CORNER_Y]) / 2;
    *white = unit * f->cost / (window->count - N);

    enum { SCORES = BLOCK_SIDE * BLOCK_SIDE / 2 + 1 };
    score block[SCORES];
    memset(block, 0, sizeof block);
    int twice[2] = {(int)lround(2 * f->parameter[CORNER_X]), (int)lround(2 * f->parameter[CORNER_Y])};
    for (int i = 0; i < window->count; i++) {
        double q[2] = {(double)influence[0][i], (double)influence[1][i]}, square = q[0] * q[0] + q[1] * q[1];
        if (square < 1e-4 * unit) continue; /* inside a square, where nothing is learnt of the corner */
        int at = block_of((int)window->y[i], twice[1]) * BLOCK_SIDE + block_of((int)window->x[i], twice[0]);
        score *s = &block[abs(at)];
        s->square += square;
        for (int c = 0; c < 2; c++) {
            s->sum[c] += q[c] * (double)window->residual[i];
            for (int k = 0; k < N; k++) s->shared[c][k] += q[c] * (double)window->derivative[k][i];
        }
    }
    /* The fit takes its share of the noise out of the residuals: the expectation of sum^2 for noise of
     * variance 1 is sum q^2 - (sum q J) (J^T J)^-1 (sum q J)^T. */
    double seen = 0, expected = 0;
    for (int b = 0; b < SCORES; b++) {
        score *s = &block[b];
        if (s->square == 0) continue;
        seen += s->sum[0] * s->sum[0] + s->sum[1] * s->sum[1];
        expected += s->square;
        for (int c = 0; c < 2; c++) {
            forward(l, s->shared[c]);
            for (int k = 0; k < N; k++) expected -= s->shared[c][k] * s->shared[c][k];
        }
    }
    if (!(expected > 0)) return false;
    *blocked = unit * seen / expected;
    return true;
}

static double residual_of(const fit *f, const corner_window *window)
{
    return sqrt(f->cost / (window->count - N));
}

/* Whether the model explains the pixels. */
static bool explains(const fit *f, const corner_window *window)
{
    double contrast = 2 * fabs(f->parameter[CORNER_HALF]);
    return contrast > LEAST_CONTRAST && residual_of(f, window) < MOST_RESIDUAL * contrast;
}

/* Where a corner is looked for. */
typedef struct place {
    const double *start;
    double first, limit;    /* radius of the first window, of any, px */
    double slack;           /* how far from `start` it may lie, px */
    const tag_shape *shape; /* NULL: of a chessboard */
} place;

/* Fits in a small window, then in one as large as the squares, the blur and the image allow, until the window
 * sits on the corner. False when it does not come to rest near the start. */
static bool settle(fit *f, corner_window *window, const td_image *image, const place *p)
{
    double at[2] = {p->start[0], p->start[1]}, radius = p->first;
    window->wedge = p->shape && p->shape->wedge;
    for (int pass = 0; pass < 5; pass++) {
        double border = fmin(fmin(at[0], image->width - 1 - at[0]), fmin(at[1], image->height - 1 - at[1]));
        radius = fmin(radius, fmin(p->limit, border));
        if (!(radius >= LEAST_RADIUS)) return false;
        gather(window, image, at, radius, p->shape, f->parameter[CORNER_BLUR]);
        if (window->count <= 2 * N) return false;
        f->parameter[CORNER_X] = at[0] - window->origin[0];
        f->parameter[CORNER_Y] = at[1] - window->origin[1];
        if (pass == 0) first_greys(f, window);
        if (!minimise(f, window, pass == 0 ? FIRST_STEP : LAST_STEP) || !explains(f, window)) return false;
        double now[2] = {window->origin[0] + f->parameter[CORNER_X],
                         window->origin[1] + f->parameter[CORNER_Y]};
        double moved = hypot(now[0] - at[0], now[1] - at[1]);
        at[0] = now[0], at[1] = now[1];
        if (!(hypot(at[0] - p->start[0], at[1] - p->start[1]) < p->slack)) return false;
        double wanted = fmin(p->limit, fmax(USUAL_RADIUS, 4 * f->parameter[CORNER_BLUR]));
        if (pass > 0 && moved < 0.5 && radius > 0.9 * fmin(wanted, border)) return true;
        radius = wanted;
    }
    return false;
}

static bool refine(td_corner *corner, const td_image *image, const double angle[2], const place *p)
{
    fit f = {.parameter = {[CORNER_ANGLE_1] = angle[0], [CORNER_ANGLE_2] = angle[1], [CORNER_BLUR] = 1}};
    corner_window window;
    double white, blocked;
    if (!settle(&f, &window, image, p)) return false;
    if (!variances(&white, &blocked, &f, &window)) return false;
    *corner = (td_corner){
        .position = {window.origin[0] + f.parameter[CORNER_X], window.origin[1] + f.parameter[CORNER_Y]},
        .sigma = sqrt(blocked),
        .white = sqrt(white),
        .blur = f.parameter[CORNER_BLUR],
        .contrast = -2 * f.parameter[CORNER_HALF], /* d1 d2 < 0 between the steps, whatever their sense */
        .residual = residual_of(&f, &window)};
    return fabs(sin(f.parameter[CORNER_ANGLE_1] - angle[0])) < MOST_TURN &&
           fabs(sin(f.parameter[CORNER_ANGLE_2] - angle[1])) < MOST_TURN && corner->sigma < MOST_SIGMA &&
           corner->white < MOST_SIGMA;
}

bool td_corner_refine(td_corner *corner, const td_image *image, const double start[2],
                      const double along_column[2], const double along_row[2])
{
    double cross = along_column[0] * along_row[1] - along_column[1] * along_row[0];
    double longer = fmax(hypot(along_column[0], along_column[1]), hypot(along_row[0], along_row[1]));
    if (image->channels != 1 || !isfinite(start[0]) || !isfinite(start[1]) || !isfinite(longer)) return false;

    const double angle[2] = {atan2(along_column[1], along_column[0]), atan2(along_row[1], along_row[0])};
    const double next_edge = fabs(cross) / longer;
    const place p = {.start = start,
                     .first = fmin(fmax(FIRST_RADIUS, FIRST_SHARE * next_edge), MOST_FIRST_RADIUS),
                     .limit = fmin(SQUARE_SHARE * next_edge, CORNER_MAX_RADIUS),
                     .slack = next_edge / 2};
    return refine(corner, image, angle, &p);
}

bool td_corner_refine_tag(td_corner *corner, const td_image *image, const double start[2],
                          const tag_shape *shape)
{
    const double *a = shape->along[0], *b = shape->along[1], cross = a[0] * b[1] - a[1] * b[0];
    const double cell = fabs(cross) / fmax(hypot(a[0], a[1]), hypot(b[0], b[1])); /* px */
    if (image->channels != 1 || !isfinite(start[0]) || !isfinite(start[1]) || !(cell > 0)) return false;
    /* The tag lies where d1 > 0 and d2 > 0, so that the quadrant of a lone corner is the dark one. */
    const double way = cross > 0 ? 1 : -1;
    const double angle[2] = {atan2(way * a[1], way * a[0]), atan2(-way * b[1], -way * b[0])};
    const place p = {.start = start,
                     .first = FIRST_RADIUS,
                     .limit = fmin(SIDE_SHARE * shape->side * cell, CORNER_MAX_RADIUS),
                     .slack = fmax(LEAST_SLACK, cell),
                     .shape = shape};
    return refine(corner, image, angle, &p) && corner->contrast > 0;
}
