/* Step two of finding marks: the parameters of each mark's model by damped Gauss–Newton (Levenberg 1944,
 * Marquardt 1963) on the grey levels around its edge, and their covariance.
 *
 *   I(p) = (1 + g . (p - p0)) (outside + (inside - outside) M(p; edge))
 *
 * with the coverage M of marks_model.c and a linear shading g. A disc's image is an ellipse only without
 * distortion; distortion's second derivatives add a bulge of three periods per turn, which is part of the
 * model because on a foreshortened mark it would otherwise pull the centre. Orthogonal as it is to the first
 * and second harmonics in the frame where the ellipse is a circle, the centre stays the centre of gravity of
 * the mark's area, and that is what td_mark_bias speaks of.
 *
 * Pixels far off the model, and their neighbours, are left out: something lies on the mark or near it. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks_internal.h"
#include "core/linalg.h"

enum {
    INSIDE = TD_EDGE_PARAMETERS,
    OUTSIDE,
    SHADE_X,
    SHADE_Y,
    PARAMETERS,
    MAX_ITERATIONS = 12,
    MAX_NEIGHBOURS = 8,
};

/* Bulge per pixel of radius, one standard deviation: what k1 = -0.3 does at the edge of a wide image. */
static const double BULGE_PER_PX = 2.5e-4;

/* Share of the pixels that must be no outliers. */
static const double LEAST_USED = 0.75;

static const double PI = 3.14159265358979323846;

/* An ellipse for many distances: the inverse of B, and of B^2. */
typedef struct ellipse {
    double x, y, inverse[3], inverse2[3]; /* xx, xy, yy */
} ellipse;

static ellipse ellipse_of(const double *edge)
{
    double xx = edge[TD_EDGE_BXX], xy = edge[TD_EDGE_BXY], yy = edge[TD_EDGE_BYY], det = xx * yy - xy * xy;
    ellipse e = {edge[TD_EDGE_CX], edge[TD_EDGE_CY], {yy / det, -xy / det, xx / det}, {0}};
    const double *i = e.inverse;
    e.inverse2[0] = i[0] * i[0] + i[1] * i[1];
    e.inverse2[1] = i[1] * (i[0] + i[2]);
    e.inverse2[2] = i[1] * i[1] + i[2] * i[2];
    return e;
}

/* A pixel's distance from the edge to first order (Sampson 1982) is excess / slope, px; both squared below,
 * because there are many pixels. excess < 0: inside. */
typedef struct offset {
    double excess, slope2;
} offset;

static offset offset_at(const ellipse *e, double x, double y)
{
    double dx = x - e->x, dy = y - e->y;
    double gx = e->inverse2[0] * dx + e->inverse2[1] * dy, gy = e->inverse2[1] * dx + e->inverse2[2] * dy;
    return (offset){gx * dx + gy * dy - 1, 4 * (gx * gx + gy * gy)};
}

static bool is_within(offset o, double distance)
{
    return o.excess * o.excess < distance * distance * o.slope2;
}

typedef struct problem {
    td_mark_fit *fit;
    const td_image *image;
    td_window window;
    double origin[2]; /* p0 of the shading */
    double p[PARAMETERS];
    int rows;
    int used;            /* rows that are no outliers */
    double cost;         /* sum of their squared residuals, and of the prior */
    double bulge_weight; /* of the prior: squared bulge against squared grey levels */
    double h[PARAMETERS * PARAMETERS], g[PARAMETERS];
    ellipse neighbour[MAX_NEIGHBOURS]; /* other blobs nearby */
    int neighbours;
} problem;

void td_mark_fit_init(td_mark_fit *fit, const td_image *image)
{
    *fit = (td_mark_fit){.noise = td_image_noise(image)};
    td_normal_table_init(&fit->table);
}

void td_mark_fit_free(td_mark_fit *fit)
{
    free(fit->cover);
    free(fit->slot);
    free(fit->pixel);
    free(fit->d_edge);
    *fit = (td_mark_fit){0};
}

static bool reserve_window(td_mark_fit *fit, size_t size)
{
    if (size <= fit->window_size) return true;
    free(fit->cover);
    free(fit->slot);
    fit->cover = malloc(size * sizeof *fit->cover);
    fit->slot = malloc(size * sizeof *fit->slot);
    fit->window_size = fit->cover && fit->slot ? size : 0;
    return fit->window_size > 0;
}

static bool reserve_rows(td_mark_fit *fit, size_t size)
{
    if (size <= fit->row_size) return true;
    free(fit->pixel);
    free(fit->d_edge);
    fit->pixel = malloc(size * sizeof *fit->pixel);
    fit->d_edge = malloc(size * TD_EDGE_PARAMETERS * sizeof *fit->d_edge);
    fit->row_size = fit->pixel && fit->d_edge ? size : 0;
    return fit->row_size > 0;
}

/* Symmetric root of a positive matrix (xx, xy, yy): (S + sqrt(det) I) / sqrt(trace + 2 sqrt(det)). */
static void symmetric_root(double root[3], const double s[3])
{
    double d = sqrt(s[0] * s[2] - s[1] * s[1]), n = sqrt(s[0] + s[2] + 2 * d);
    root[0] = (s[0] + d) / n;
    root[1] = s[1] / n;
    root[2] = (s[2] + d) / n;
}

static void eigenvalues(double value[2], const double s[3])
{
    double half = 0.5 * (s[0] + s[2]), root = hypot(0.5 * (s[0] - s[2]), s[1]);
    value[0] = half - root;
    value[1] = half + root;
}

/* The window around the ellipse with `margin` px on each side, clipped to the image. */
static bool place_window(problem *p, double margin)
{
    const double *e = p->p;
    double half_x = hypot(e[TD_EDGE_BXX], e[TD_EDGE_BXY]) + margin;
    double half_y = hypot(e[TD_EDGE_BXY], e[TD_EDGE_BYY]) + margin;
    if (!(half_x < p->image->width) || !(half_y < p->image->height)) return false;
    double left = fmax(ceil(e[TD_EDGE_CX] - half_x), 0), top = fmax(ceil(e[TD_EDGE_CY] - half_y), 0);
    double right = fmin(floor(e[TD_EDGE_CX] + half_x), p->image->width - 1);
    double bottom = fmin(floor(e[TD_EDGE_CY] + half_y), p->image->height - 1);
    if (!(right > left) || !(bottom > top)) return false;
    p->window = (td_window){(int)left, (int)top, (int)(right - left) + 1, (int)(bottom - top) + 1, NULL};
    return true;
}

/* Does the pixel show another blob, or the blurred edge of one up to `distance` px away? */
static bool is_neighbours(const problem *p, double x, double y, double distance)
{
    for (int i = 0; i < p->neighbours; i++) {
        offset o = offset_at(&p->neighbour[i], x, y);
        if (o.excess < 0 || is_within(o, distance)) return true;
    }
    return false;
}

/* Takes the pixels within `band` px of the edge, where no neighbour's edge of blur `smear` is. */
static bool choose_pixels(problem *p, double band, double smear, bool *memory)
{
    if (!place_window(p, band)) return false;
    td_window *w = &p->window;
    if (!(*memory = reserve_window(p->fit, (size_t)w->width * w->height))) return false;
    int *slot = p->fit->slot;
    w->slot = slot;
    const ellipse e = ellipse_of(p->p);
    p->rows = 0;
    for (int j = 0, i = 0; j < w->height; j++) {
        for (int k = 0; k < w->width; k++, i++) {
            double x = w->x0 + k, y = w->y0 + j;
            bool near = is_within(offset_at(&e, x, y), band) && !is_neighbours(p, x, y, 2 * smear);
            slot[i] = near ? p->rows++ : -1;
        }
    }
    if (p->rows <= 2 * PARAMETERS || !(*memory = reserve_rows(p->fit, (size_t)p->rows))) return false;
    for (int j = 0, i = 0; j < w->height; j++) {
        const uint8_t *grey = p->image->data + (size_t)(w->y0 + j) * p->image->width + w->x0;
        for (int k = 0; k < w->width; k++, i++) {
            if (slot[i] < 0) continue;
            p->fit->pixel[slot[i]] =
                (td_mark_pixel){.index = i, .x = w->x0 + k, .y = w->y0 + j, .grey = grey[k]};
        }
    }
    return true;
}

static void sum_cost(problem *p)
{
    const double *q = p->p;
    p->used = 0;
    p->cost = p->bulge_weight * (q[TD_EDGE_E3C] * q[TD_EDGE_E3C] + q[TD_EDGE_E3S] * q[TD_EDGE_E3S]);
    for (int i = 0; i < p->rows; i++) {
        const td_mark_pixel *px = &p->fit->pixel[i];
        if (px->outlier) continue;
        p->cost += px->residual * px->residual;
        p->used++;
    }
}

/* Coverage, residuals and the cost at p, and the coverage's derivatives if wanted. */
static void evaluate(problem *p, bool derivatives)
{
    td_mark_fit *f = p->fit;
    if (derivatives) memset(f->d_edge, 0, (size_t)p->rows * TD_EDGE_PARAMETERS * sizeof *f->d_edge);
    td_mark_cover(f->cover, derivatives ? f->d_edge : NULL, &p->window, p->p, &f->table);
    const double *q = p->p;
    for (int i = 0; i < p->rows; i++) {
        td_mark_pixel *px = &f->pixel[i];
        double shade = 1 + q[SHADE_X] * (px->x - p->origin[0]) + q[SHADE_Y] * (px->y - p->origin[1]);
        px->residual = px->grey - shade * (q[OUTSIDE] + (q[INSIDE] - q[OUTSIDE]) * f->cover[px->index]);
    }
    sum_cost(p);
}

/* Four rows of the Jacobian of the grey levels side by side, which the compiler keeps in vectors, and the
 * residuals as the last column. Outliers are zeros. */
enum { LANES = 4 };
typedef struct block {
    float j[PARAMETERS + 1][LANES];
} block;

static void fill_block(block *b, const problem *p, int first)
{
    const double *q = p->p, contrast = q[INSIDE] - q[OUTSIDE];
    for (int i = 0; i < LANES; i++) {
        if (first + i >= p->rows || p->fit->pixel[first + i].outlier) {
            for (int k = 0; k <= PARAMETERS; k++) b->j[k][i] = 0;
            continue;
        }
        const td_mark_pixel *px = &p->fit->pixel[first + i];
        const float *d = p->fit->d_edge + (size_t)TD_EDGE_PARAMETERS * (first + i);
        double dx = px->x - p->origin[0], dy = px->y - p->origin[1], m = p->fit->cover[px->index];
        double shade = 1 + q[SHADE_X] * dx + q[SHADE_Y] * dy, plain = q[OUTSIDE] + contrast * m;
        float scale = (float)(shade * contrast);
        for (int k = 0; k < TD_EDGE_PARAMETERS; k++) b->j[k][i] = scale * d[k];
        b->j[INSIDE][i] = (float)(shade * m);
        b->j[OUTSIDE][i] = (float)(shade * (1 - m));
        b->j[SHADE_X][i] = (float)(plain * dx);
        b->j[SHADE_Y][i] = (float)(plain * dy);
        b->j[PARAMETERS][i] = (float)px->residual;
    }
}

/* g = J^T r and, if wanted, h = J^T J, with the prior. */
static void normal_equations(problem *p, bool matrix)
{
    float sum[PARAMETERS + 1][PARAMETERS + 1][LANES] = {{{0}}};
    for (int first = 0; first < p->rows; first += LANES) {
        block b;
        fill_block(&b, p, first);
        for (int k = matrix ? 0 : PARAMETERS; k <= PARAMETERS; k++)
            for (int l = 0; l <= k; l++)
                for (int i = 0; i < LANES; i++) sum[k][l][i] += b.j[k][i] * b.j[l][i];
    }
    double *h = p->h, *g = p->g;
    for (int k = 0; k <= PARAMETERS; k++) {
        for (int l = 0; l <= k && l < PARAMETERS; l++) {
            const float *s = sum[k][l];
            double total = ((double)s[0] + s[1]) + ((double)s[2] + s[3]);
            if (k == PARAMETERS)
                g[l] = total;
            else if (matrix)
                h[k * PARAMETERS + l] = h[l * PARAMETERS + k] = total;
        }
    }
    for (int k = TD_EDGE_E3C; k <= TD_EDGE_E3S; k++) {
        if (matrix) h[k * PARAMETERS + k] += p->bulge_weight;
        g[k] -= p->bulge_weight * p->p[k];
    }
}

/* step = (h + lambda diag h)^-1 g; `inverse` is that of the damped h. A blur at its lower bound that wants to
 * fall stays. */
static bool solve(double step[PARAMETERS], double inverse[PARAMETERS * PARAMETERS], const problem *p,
                  double lambda)
{
    memcpy(inverse, p->h, sizeof p->h);
    for (int k = 0; k < PARAMETERS; k++) inverse[k * PARAMETERS + k] *= 1 + lambda;
    if (p->p[TD_EDGE_BLUR] <= TD_MARK_MIN_BLUR && p->g[TD_EDGE_BLUR] < 0)
        inverse[TD_EDGE_BLUR * PARAMETERS + TD_EDGE_BLUR] *= 1e12;
    if (td_invert_spd(inverse, inverse, PARAMETERS, NULL) != TD_OK) return false;
    for (int k = 0; k < PARAMETERS; k++) {
        step[k] = 0;
        for (int l = 0; l < PARAMETERS; l++) step[k] += inverse[k * PARAMETERS + l] * p->g[l];
        if (!isfinite(step[k])) return false;
    }
    return true;
}

static double variance_of(const problem *p)
{
    return fmax(p->cost / (p->used - PARAMETERS), 1.0 / 12);
}

/* Largest move of the edge, px. */
static double edge_move(const double *a, const double *b)
{
    double most = 0;
    for (int k = TD_EDGE_CX; k <= TD_EDGE_BLUR; k++) most = fmax(most, fabs(a[k] - b[k]));
    return most;
}

/* The ellipse stays one, within its window; the blur within its bounds. */
static bool confine(problem *p)
{
    double *q = p->p, lambda[2];
    q[TD_EDGE_BLUR] = fmin(fmax(q[TD_EDGE_BLUR], TD_MARK_MIN_BLUR), TD_MARK_MAX_BLUR);
    eigenvalues(lambda, q + TD_EDGE_BXX);
    const td_window *w = &p->window;
    return lambda[0] > 0.2 && lambda[1] < w->width + w->height && q[TD_EDGE_CX] > w->x0 &&
           q[TD_EDGE_CY] > w->y0 && q[TD_EDGE_CX] < w->x0 + w->width && q[TD_EDGE_CY] < w->y0 + w->height &&
           fabs(q[TD_EDGE_E3C]) < 0.2 && fabs(q[TD_EDGE_E3S]) < 0.2;
}

/* Every so many pixels will do for the first estimate of a large mark. */
static int start_stride(const td_window *w)
{
    return 1 + (w->width + w->height) / 64;
}

/* Grey levels inside and outside the blob: the mean of its core, the median of a ring around it. */
static bool start_levels(problem *p)
{
    unsigned ring[256] = {0}, total = 0, seen = 0;
    double core = 0, count = 0, deepest = DBL_MAX, at_deepest = 0;
    const td_window *w = &p->window;
    const ellipse e = ellipse_of(p->p);
    const int stride = start_stride(w);
    for (int j = 0; j < w->height; j += stride) {
        const uint8_t *row = p->image->data + (size_t)(w->y0 + j) * p->image->width + w->x0;
        for (int i = 0; i < w->width; i += stride) {
            offset o = offset_at(&e, w->x0 + i, w->y0 + j);
            bool edge = is_within(o, 1.5);
            if (o.excess > 0 && !edge && is_within(o, 4) && !is_neighbours(p, w->x0 + i, w->y0 + j, 0.75))
                ring[row[i]]++, total++;
            if (o.excess < 0 && !edge) core += row[i], count++;
            if (o.excess < deepest) deepest = o.excess, at_deepest = row[i];
        }
    }
    if (total < 8) return false;
    int median = 0;
    while (2 * (seen += ring[median]) < total) median++;
    p->p[OUTSIDE] = median;
    p->p[INSIDE] = count > 0 ? core / count : at_deepest;
    return fabs(p->p[INSIDE] - p->p[OUTSIDE]) >= 2;
}

/* Centre, shape and blur from the grey levels as coverage v: moments, to whose covariance blur adds s^2 I;
 * and v (1 - v), whose integral across a straight blurred edge is s / sqrt(pi). */
static bool start_edge(problem *p)
{
    double m[6] = {0}, across = 0;
    const td_window *w = &p->window;
    const ellipse e = ellipse_of(p->p);
    double outside = p->p[OUTSIDE], contrast = p->p[INSIDE] - outside;
    const int stride = start_stride(w);
    for (int j = 0; j < w->height; j += stride) {
        const uint8_t *row = p->image->data + (size_t)(w->y0 + j) * p->image->width + w->x0;
        for (int i = 0; i < w->width; i += stride) {
            double x = w->x0 + i - p->origin[0], y = w->y0 + j - p->origin[1];
            offset o = offset_at(&e, w->x0 + i, w->y0 + j);
            bool edge = is_within(o, 2.5);
            if (o.excess > 0 && (!edge || is_neighbours(p, w->x0 + i, w->y0 + j, 1))) continue;
            double v = fmin(fmax((row[i] - outside) / contrast, 0), 1);
            m[0] += v, m[1] += v * x, m[2] += v * y, m[3] += v * x * x, m[4] += v * x * y, m[5] += v * y * y;
            if (edge) across += v * (1 - v);
        }
    }
    if (!(m[0] > 2)) return false;
    double x = m[1] / m[0], y = m[2] / m[0], lambda[2];
    double c[3] = {m[3] / m[0] - x * x, m[4] / m[0] - x * y, m[5] / m[0] - y * y};
    double blur = sqrt(PI) * stride * stride * across / (2 * PI * sqrt(2 * (c[0] + c[2])));
    eigenvalues(lambda, c);
    if (!(lambda[0] > 0.15)) return false;
    blur = fmin(fmax(blur, 0.5), sqrt(0.6 * lambda[0]));
    c[0] = 4 * (c[0] - blur * blur), c[1] *= 4, c[2] = 4 * (c[2] - blur * blur);
    symmetric_root(p->p + TD_EDGE_BXX, c);
    p->p[TD_EDGE_CX] = p->origin[0] + x;
    p->p[TD_EDGE_CY] = p->origin[1] + y;
    p->p[TD_EDGE_BLUR] = fmax(blur, TD_MARK_MIN_BLUR);
    return true;
}

/* A uniform ellipse's covariance is B^2 / 4. */
static void edge_of_blob(double *edge, const td_blob *blob)
{
    double c[3];
    for (int i = 0; i < 3; i++) c[i] = 4 * blob->covariance[i];
    edge[TD_EDGE_CX] = blob->centroid[0];
    edge[TD_EDGE_CY] = blob->centroid[1];
    symmetric_root(edge + TD_EDGE_BXX, c);
}

static ellipse ellipse_of_blob(const td_blob *blob)
{
    double edge[TD_EDGE_PARAMETERS];
    edge_of_blob(edge, blob);
    return ellipse_of(edge);
}

/* The blobs that lie beside this one; others are this one again, from another window. */
static void find_neighbours(problem *p, const td_blob *blob, size_t count, size_t self)
{
    const td_blob *b = &blob[self];
    const ellipse e = ellipse_of_blob(b);
    double half_x = 2 * sqrt(b->covariance[0]) + 8, half_y = 2 * sqrt(b->covariance[2]) + 8;
    for (size_t i = 0; i < count && p->neighbours < MAX_NEIGHBOURS; i++) {
        double dx = fabs(blob[i].centroid[0] - b->centroid[0]),
               dy = fabs(blob[i].centroid[1] - b->centroid[1]);
        if (blob[i].light != b->light || dx > half_x + 2 * sqrt(blob[i].covariance[0]) ||
            dy > half_y + 2 * sqrt(blob[i].covariance[2]) ||
            offset_at(&e, blob[i].centroid[0], blob[i].centroid[1]).excess < 0)
            continue;
        ellipse n = ellipse_of_blob(&blob[i]);
        bool again = offset_at(&n, b->centroid[0], b->centroid[1]).excess < 0;
        for (int k = 0; k < p->neighbours && !again; k++)
            again = offset_at(&p->neighbour[k], n.x, n.y).excess < 0;
        if (!again) p->neighbour[p->neighbours++] = n;
    }
}

/* The first estimate, from the blob. */
static bool start(problem *p, const td_blob *blob)
{
    edge_of_blob(p->p, blob);
    p->origin[0] = blob->centroid[0];
    p->origin[1] = blob->centroid[1];
    return place_window(p, 4) && start_levels(p) && start_edge(p);
}

/* Marks the pixels that are far off the model, with their neighbours in the window. The scale comes from the
 * third quartile of the residuals: with sharpening, which the model does not know, most of an edge is off,
 * and that alone makes no outliers. True when the choice has changed. */
static bool mark_outliers(problem *p)
{
    enum { BINS = 1024 };
    unsigned bin[BINS] = {0}, seen = 0;
    td_mark_pixel *pixel = p->fit->pixel;
    const td_window *w = &p->window;
    double contrast = fabs(p->p[INSIDE] - p->p[OUTSIDE]), per_level = BINS / (0.5 * contrast + 1);
    for (int i = 0; i < p->rows; i++) {
        double b = fabs(pixel[i].residual) * per_level;
        bin[b < BINS - 1 ? (int)b : BINS - 1]++;
    }
    int quartile = 0;
    while (4 * (seen += bin[quartile]) < 3 * (unsigned)p->rows) quartile++;
    double limit = 5 / 1.15 * (quartile + 0.5) / per_level + 1 + 0.02 * contrast;
    bool changed = false, any = false;
    for (int i = 0; i < p->rows && !any; i++) any = pixel[i].outlier || fabs(pixel[i].residual) > limit;
    for (int i = 0; i < p->rows && any; i++) {
        int x = pixel[i].index % w->width, y = pixel[i].index / w->width;
        bool outlier = false;
        for (int v = y > 0 ? y - 1 : 0; v <= y + 1 && v < w->height; v++) {
            for (int u = x > 0 ? x - 1 : 0; u <= x + 1 && u < w->width; u++) {
                int slot = w->slot[v * w->width + u];
                outlier |= slot >= 0 && fabs(pixel[slot].residual) > limit;
            }
        }
        changed |= outlier != pixel[i].outlier;
        pixel[i].outlier = outlier;
    }
    sum_cost(p);
    return changed;
}

/* After the first step the model is near. Outliers are told; too many of them mean that it is not. The prior
 * gets its weight against the residuals: what these exceed the image's noise by is a misfit (sharpening,
 * demosaicking), which many pixels do not average out as they do noise. */
static void look_again(problem *p)
{
    const double *q = p->p;
    mark_outliers(p);
    if (p->used < LEAST_USED * p->rows)
        for (int i = 0; i < p->rows; i++) p->fit->pixel[i].outlier = false;
    p->bulge_weight = 0;
    sum_cost(p);
    double variance = variance_of(p), noise = p->fit->noise, misfit = variance / (noise * noise + 1.0 / 12);
    double area = q[TD_EDGE_BXX] * q[TD_EDGE_BYY] - q[TD_EDGE_BXY] * q[TD_EDGE_BXY];
    p->bulge_weight = variance * fmax(misfit, 1) / (BULGE_PER_PX * BULGE_PER_PX * area);
    sum_cost(p);
}

/* Descends until the next step would move the centre by less than a fifth of its sigma and the edge by less
 * than 0.03 px, and takes that step too. The Jacobian is kept while the steps are small. */
static bool descend(problem *p)
{
    double lambda = 1e-4;
    bool fresh = true; /* the Jacobian is that of the present parameters */
    normal_equations(p, true);
    for (int i = 0; i < MAX_ITERATIONS; i++) {
        double step[PARAMETERS], inverse[PARAMETERS * PARAMETERS], before[PARAMETERS], cost = p->cost;
        if (!solve(step, inverse, p, lambda)) return false;
        double variance = 0.5 * (inverse[0] + inverse[PARAMETERS + 1]) * variance_of(p);
        memcpy(before, p->p, sizeof before);
        for (int k = 0; k < PARAMETERS; k++) p->p[k] += step[k];
        bool possible = confine(p);
        double move = edge_move(p->p, before);
        if (possible && move < 0.03 && i > 0 && step[0] * step[0] + step[1] * step[1] < 0.04 * variance)
            return true;
        bool refresh = i == 0 || move > 0.3 || lambda > 1e-2;
        if (possible) evaluate(p, refresh);
        if (possible && p->cost <= cost) {
            if (i == 0) look_again(p);
            lambda *= 0.1;
            normal_equations(p, refresh);
            fresh = refresh;
            continue;
        }
        memcpy(p->p, before, sizeof before);
        p->cost = cost;
        if (move < 0.03) return possible; /* rounding: there is nothing left to gain */
        if (!fresh) {
            evaluate(p, true);
            normal_equations(p, fresh = true);
        }
        lambda = fmax(lambda * 10, 1e-3);
        if (lambda > 1e6) return false;
    }
    return false;
}

/* Fits the pixels near the edge, and those near the new edge if it has moved much. */
static bool fit_edge(problem *p, bool *memory)
{
    for (int round = 0; round < 4; round++) {
        double before[PARAMETERS], *q = p->p;
        memcpy(before, q, sizeof before);
        double smear = sqrt(q[TD_EDGE_BLUR] * q[TD_EDGE_BLUR] + 1.0 / 12);
        if (!choose_pixels(p, 1.2 + 3 * smear, smear, memory)) return false;
        evaluate(p, true);
        double contrast = q[INSIDE] - q[OUTSIDE];
        double most = fmax(0.3 * fabs(contrast), 2 * p->fit->noise);
        if (p->cost > most * most * p->rows || !descend(p)) return false;
        for (int k = 0; k < 4 && mark_outliers(p); k++)
            if (p->used < PARAMETERS * 2 || !descend(p)) return false;
        if (edge_move(q, before) < 0.4) return true;
    }
    return false;
}

/* Is what was fitted a mark, and near the blob? */
static bool plausible(const problem *p, const td_blob *blob)
{
    const double *q = p->p;
    double lambda[2], contrast = q[INSIDE] - q[OUTSIDE], rms = sqrt(p->cost / p->used);
    eigenvalues(lambda, q + TD_EDGE_BXX);
    double area = PI * lambda[0] * lambda[1];
    double dx = q[TD_EDGE_CX] - blob->centroid[0], dy = q[TD_EDGE_CY] - blob->centroid[1];
    return (contrast > 0) == blob->light && fabs(contrast) >= 5 &&
           rms < fmax(0.2 * fabs(contrast), 2 * p->fit->noise) && p->used > LEAST_USED * p->rows &&
           hypot(dx, dy) < 1.5 + 0.3 * lambda[1] && area > 0.25 * blob->area && area < 3 * blob->area + 10 &&
           lambda[0] > 0.1 * lambda[1] && q[TD_EDGE_BLUR] < 0.5 + 1.5 * lambda[0] &&
           hypot(q[TD_EDGE_E3C], q[TD_EDGE_E3S]) < 0.06;
}

/* The mark of a finished fit; false when its covariance is not there. */
static bool report(td_mark *mark, const problem *p, const td_blob *blob)
{
    double inverse[PARAMETERS * PARAMETERS];
    const double *q = p->p;
    if (td_invert_spd(inverse, p->h, PARAMETERS, NULL) != TD_OK) return false;
    double xx = q[TD_EDGE_BXX], xy = q[TD_EDGE_BXY], yy = q[TD_EDGE_BYY], det2 = pow(xx * yy - xy * xy, 2);
    *mark = (td_mark){
        .centre = {q[TD_EDGE_CX], q[TD_EDGE_CY]},
        .shape = {(yy * yy + xy * xy) / det2, -xy * (xx + yy) / det2, (xx * xx + xy * xy) / det2},
        .blur = sqrt(q[TD_EDGE_BLUR] * q[TD_EDGE_BLUR] + 1.0 / 12), /* with the pixel's own */
        .inside = q[INSIDE],
        .outside = q[OUTSIDE],
        .sigma = sqrt(0.5 * variance_of(p) * (inverse[0] + inverse[PARAMETERS + 1])),
        .centroid = {blob->centroid[0], blob->centroid[1]},
    };
    return mark->sigma > 0 && mark->sigma < 0.5;
}

td_status td_mark_fit_blob(td_mark *mark, bool *ok, td_mark_fit *fit, const td_image *image,
                           const td_blob *blob, size_t count, size_t index, td_error *error)
{
    problem p = {.fit = fit, .image = image};
    const td_blob *b = &blob[index];
    bool memory = true;
    find_neighbours(&p, blob, count, index);
    *ok = start(&p, b) && fit_edge(&p, &memory) && plausible(&p, b) && report(mark, &p, b);
    return memory ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory to fit a mark of %.0f px^2", b->area);
}
