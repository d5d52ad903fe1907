/* The model of a mark's image: how much of each pixel is covered by a disc whose edge is blurred by a
 * Gaussian, and the derivatives by the edge.
 *
 * Coverage M(p) is the disc's indicator, blurred by a Gaussian G of standard deviation s and integrated over
 * the pixel (a square of side 1). With Green's theorem it is an integral along the edge q(t) alone, exact for
 * any size of disc:
 *
 *   M(p)        = closed integral of  F(q - p) dq_y,          dF/dx = G * pixel
 *   dM/dtheta   = closed integral of (G * pixel)(q - p) (dq/dtheta x dq),   the edge's sweep
 *   dM/ds       = s laplace(M) = s closed integral of d(G * pixel)/dn |dq|
 *
 * G and the pixel are both products of a function of x and one of y, so that each node of the edge needs
 * error functions for its few columns and rows only. The integrand is smooth and periodic: the trapezoidal
 * rule converges faster than any power of the step, to about 1e-4 at a step of 1.5 s. */
#include <math.h>
#include <string.h>

#include "calib/marks_internal.h"

static const double PI = 3.14159265358979323846;

/* Where the Gaussian ends, in standard deviations: 2e-4 of the contrast is cut off. */
static const double REACH = 3.5;
/* Between nodes of the edge, in standard deviations. */
static const double NODE_STEP = 1.5;

/* More than any edge lies outside its window. */
enum { BEYOND = 1 << 20 };

enum { MAX_KERNEL = 2 * (4 * TD_MARK_MAX_BLUR + 1) + 2, MIN_NODES = 16, MAX_NODES = 1 << 15 };

void td_normal_table_init(td_normal_table *table)
{
    const int n = TD_NORMAL_STEPS * TD_NORMAL_RANGE;
    for (int i = -n; i <= n; i++) {
        double x = (double)i / TD_NORMAL_STEPS;
        table->cumulative[i + n] = 0.5 * erfc(-x * sqrt(0.5));
        table->density[i + n] = exp(-0.5 * x * x) / sqrt(2 * PI);
    }
}

/* Taylor's series to the second order from the nearest entry: good to 1e-7. */
static void normal(double *cumulative, double *density, double x, const td_normal_table *table)
{
    double steps = x * TD_NORMAL_STEPS + TD_NORMAL_STEPS * TD_NORMAL_RANGE + 0.5;
    if (!(steps > 0)) {
        *cumulative = *density = 0;
        return;
    }
    if (!(steps < 2 * TD_NORMAL_STEPS * TD_NORMAL_RANGE + 1)) {
        *cumulative = 1;
        *density = 0;
        return;
    }
    int i = (int)steps;
    double c = (i - TD_NORMAL_STEPS * TD_NORMAL_RANGE) * (1.0 / TD_NORMAL_STEPS), h = x - c, ch = c * h;
    double d = table->density[i];
    *cumulative = table->cumulative[i] + d * h * (1 - 0.5 * ch);
    *density = d * (1 - ch + 0.5 * (ch * ch - h * h));
}

/* Along one axis, for the pixels first … first + count - 1 of the window: */
typedef struct kernel {
    int first, count;
    float weight[MAX_KERNEL]; /* G * pixel at q */
    float slope[MAX_KERNEL];  /* its derivative by q */
    float drop[MAX_KERNEL +
               1]; /* F at pixel first + i - 1 less F at the next; F is 1 far below q, 0 far above */
} kernel;

static void kernel_at(kernel *k, double q, double blur, int size, const td_normal_table *table)
{
    double reach = REACH * blur + 0.5, per_blur = 1 / blur;
    /* Rounding up and down, by truncation of positive numbers. */
    int last = (int)(q + reach + BEYOND) - BEYOND, first = BEYOND - (int)(BEYOND + reach - q);
    k->first = first < 0 ? 0 : first > size ? size : first;
    k->count = (last > size - 1 ? size - 1 : last) - k->first + 1;
    if (k->count < 0) k->count = 0;

    double phi, density, v = q - (k->first - 0.5), share = 1;
    normal(&phi, &density, v * per_blur, table);
    double psi = v * phi + blur * density;
    for (int i = 0; i < k->count; i++) {
        double next_phi, next_density;
        v -= 1;
        normal(&next_phi, &next_density, v * per_blur, table);
        double next_psi = v * next_phi + blur * next_density, next_share = psi - next_psi;
        k->weight[i] = (float)(phi - next_phi);
        k->slope[i] = (float)((density - next_density) * per_blur);
        k->drop[i] = (float)(share - next_share);
        phi = next_phi;
        density = next_density;
        psi = next_psi;
        share = next_share;
    }
    k->drop[k->count] = (float)share;
}

/* The edge at one parameter t: position, tangent times dt, and the sweeps of the edge's parameters. */
typedef struct node {
    double q[2];
    float tangent[2];
    float sweep[TD_EDGE_PARAMETERS]; /* dq/dtheta x dq; of the blur: 0 */
} node;

static node node_at(const double edge[TD_EDGE_PARAMETERS], double c, double s, double dt)
{
    double c3 = c * (4 * c * c - 3), s3 = s * (3 - 4 * s * s);
    double r = 1 + edge[TD_EDGE_E3C] * c3 + edge[TD_EDGE_E3S] * s3;
    double dr = 3 * (edge[TD_EDGE_E3S] * c3 - edge[TD_EDGE_E3C] * s3);
    double xx = edge[TD_EDGE_BXX], xy = edge[TD_EDGE_BXY], yy = edge[TD_EDGE_BYY];
    double u[2] = {xx * c + xy * s, xy * c + yy * s}, du[2] = {xy * c - xx * s, yy * c - xy * s};
    node n;
    n.q[0] = edge[TD_EDGE_CX] + r * u[0];
    n.q[1] = edge[TD_EDGE_CY] + r * u[1];
    double tx = (r * du[0] + dr * u[0]) * dt, ty = (r * du[1] + dr * u[1]) * dt;
    n.tangent[0] = (float)tx;
    n.tangent[1] = (float)ty;
    const double sweep[TD_EDGE_PARAMETERS] = {
        [TD_EDGE_CX] = ty,
        [TD_EDGE_CY] = -tx,
        [TD_EDGE_BXX] = r * c * ty,
        [TD_EDGE_BXY] = r * (s * ty - c * tx),
        [TD_EDGE_BYY] = -r * s * tx,
        [TD_EDGE_E3C] = c3 * (u[0] * ty - u[1] * tx),
        [TD_EDGE_E3S] = s3 * (u[0] * ty - u[1] * tx),
    };
    for (int k = 0; k < TD_EDGE_PARAMETERS; k++) n.sweep[k] = (float)sweep[k];
    return n;
}

/* Adds one node's share; of the coverage, the drops from each pixel to the next on its right. */
static void add_node(float *drop, float *d_edge, const td_window *window, const node *n, float blur,
                     const kernel *kx, const kernel *ky)
{
    for (int j = 0; j < ky->count; j++) {
        size_t row = (size_t)(ky->first + j) * window->width + kx->first;
        const float along_y = ky->weight[j] * n->tangent[1];
        if (kx->first > 0) drop[row - 1] += kx->drop[0] * along_y;
        const float bend_x = blur * along_y, bend_y = blur * ky->slope[j] * n->tangent[0];
        for (int i = 0; i < kx->count; i++) drop[row + i] += kx->drop[i + 1] * along_y;
        for (int i = 0; d_edge && i < kx->count; i++) {
            int slot = window->slot ? window->slot[row + i] : (int)row + i;
            if (slot < 0) continue;
            float *d = d_edge + TD_EDGE_PARAMETERS * (size_t)slot;
            const float weight = kx->weight[i] * ky->weight[j];
            for (int k = 0; k < TD_EDGE_PARAMETERS; k++) d[k] += weight * n->sweep[k];
            d[TD_EDGE_BLUR] += kx->slope[i] * bend_x - kx->weight[i] * bend_y;
        }
    }
}

void td_mark_cover(float *cover, float *d_edge, const td_window *window,
                   const double edge[TD_EDGE_PARAMETERS], const td_normal_table *table)
{
    const double blur = edge[TD_EDGE_BLUR];
    double half = 0.5 * (edge[TD_EDGE_BXX] + edge[TD_EDGE_BYY]);
    double major = half + hypot(0.5 * (edge[TD_EDGE_BXX] - edge[TD_EDGE_BYY]), edge[TD_EDGE_BXY]);
    double wanted = 2 * PI * major / (NODE_STEP * blur);
    int nodes = wanted < MIN_NODES ? MIN_NODES : wanted > MAX_NODES ? MAX_NODES : (int)wanted;
    double dt = 2 * PI / nodes, dc = cos(dt), ds = sin(dt), c = 1, s = 0;

    memset(cover, 0, (size_t)window->width * window->height * sizeof *cover);
    for (int i = 0; i < nodes; i++) {
        node n = node_at(edge, c, s, dt);
        kernel kx, ky;
        kernel_at(&kx, n.q[0] - window->x0, blur, window->width, table);
        kernel_at(&ky, n.q[1] - window->y0, blur, window->height, table);
        add_node(cover, d_edge, window, &n, (float)blur, &kx, &ky);
        double next = c * dc - s * ds;
        s = s * dc + c * ds;
        c = next;
    }
    for (int y = 0; y < window->height; y++) {
        float *row = cover + (size_t)y * window->width;
        for (int x = window->width - 2; x >= 0; x--) row[x] += row[x + 1];
    }
}
