/* ZNCC of whole pixels, fast: window sums and deviations by running sums, once for an image; for each pair of
 * windows only the sum of products remains, in whole numbers. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/match_internal.h"

enum { LANES = 8 }; /* a window's row is padded with zeros to whole vectors */

static td_status allocate_plane(td_zncc_plane *p)
{
    const size_t pixels = (size_t)p->width * (size_t)p->height;
    p->grey = calloc(pixels + LANES, sizeof *p->grey);
    p->sum = calloc(pixels, sizeof *p->sum);
    p->factor = calloc(pixels, sizeof *p->factor);
    return p->grey && p->sum && p->factor ? TD_OK : TD_ERROR_MEMORY;
}

/* Window sums by running sums: down the columns, then along the row. column (2,width). */
static void fill_sums(td_zncc_plane *p, const td_image *image, int64_t *column)
{
    const int k = p->k, w = p->width;
    const double n = (2. * k + 1) * (2. * k + 1);
    int64_t *sums = column, *squares = column + w;
    for (int y = 0; y < p->height; y++) {
        const uint8_t *in = image->data + (size_t)y * (size_t)w;
        for (int x = 0; x < w; x++) {
            const int out = y > 2 * k ? in[x - (ptrdiff_t)(2 * k + 1) * w] : 0;
            sums[x] += in[x] - out;
            squares[x] += in[x] * in[x] - out * out;
        }
        if (y < 2 * k) continue;
        int64_t sum = 0, square = 0;
        for (int x = 0; x < w; x++) {
            sum += sums[x] - (x > 2 * k ? sums[x - 2 * k - 1] : 0);
            square += squares[x] - (x > 2 * k ? squares[x - 2 * k - 1] : 0);
            if (x < 2 * k) continue;
            const size_t centre = (size_t)(y - k) * (size_t)w + (size_t)(x - k);
            const double deviation = n * (double)square - (double)sum * (double)sum;
            p->sum[centre] = (int32_t)sum;
            p->factor[centre] = deviation > 0 ? 1 / sqrt(deviation) : 0;
        }
    }
}

td_status td_zncc_plane_new(td_zncc_plane **plane, const td_image *image, int k, td_error *error)
{
    td_zncc_plane *p = calloc(1, sizeof *p);
    int64_t *column = calloc(2 * (size_t)image->width, sizeof *column);
    if (p) *p = (td_zncc_plane){image->width, image->height, k, NULL, NULL, NULL};
    if (!p || !column || allocate_plane(p) != TD_OK) {
        free(column);
        td_zncc_plane_free(&p);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the window sums of an image of %d x %d pixels",
                       image->width, image->height);
    }
    for (size_t i = 0; i < (size_t)p->width * (size_t)p->height; i++) p->grey[i] = image->data[i];
    fill_sums(p, image, column);
    free(column);
    *plane = p;
    return TD_OK;
}

void td_zncc_plane_free(td_zncc_plane **plane)
{
    if (!*plane) return;
    free((*plane)->grey);
    free((*plane)->sum);
    free((*plane)->factor);
    free(*plane);
    *plane = NULL;
}

/* ---- One window against many ---- */

bool td_zncc_window_cut(td_zncc_window *window, const td_zncc_plane *left, int i, int j,
                        const td_zncc_plane *right)
{
    const int k = left->k, side = 2 * k + 1, stride = (side + LANES - 1) / LANES * LANES;
    *window = (td_zncc_window){right, NULL, side, stride, 0, 0};
    if (i < k || j < k || i >= left->width - k || j >= left->height - k) return true;
    const size_t centre = (size_t)j * (size_t)left->width + (size_t)i;
    window->grey = calloc((size_t)side * (size_t)stride, sizeof *window->grey);
    if (!window->grey) return false;
    window->sum = left->sum[centre];
    window->factor = left->factor[centre];
    for (int y = 0; y < side; y++)
        memcpy(window->grey + y * stride, left->grey + centre + (ptrdiff_t)(y - k) * left->width - k,
               (size_t)side * sizeof *window->grey);
    return true;
}

void td_zncc_window_free(td_zncc_window *window)
{
    free(window->grey);
    window->grey = NULL;
}

double td_zncc_window_score(int x, int y, const void *window)
{
    const td_zncc_window *w = window;
    const td_zncc_plane *p = w->plane;
    if (x < 0 || y < 0 || x >= p->width || y >= p->height) return NAN;
    const size_t centre = (size_t)y * (size_t)p->width + (size_t)x;
    if (!(w->factor > 0 && p->factor[centre] > 0)) return NAN;
    const int16_t *corner = p->grey + centre - (ptrdiff_t)p->k * p->width - p->k;
    int32_t products = 0; /* below 2^31 for the largest window that options allow */
    for (int r = 0; r < w->side; r++) {
        const int16_t *a = w->grey + r * w->stride, *b = corner + (ptrdiff_t)r * p->width;
        for (int c = 0; c < w->stride; c++) products += a[c] * b[c];
    }
    const double n = (double)w->side * w->side;
    return (n * products - w->sum * p->sum[centre]) * w->factor * p->factor[centre];
}
