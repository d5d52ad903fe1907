/* Step one of finding marks: the binary image, and the centre of gravity of each of its blobs.
 *
 * A pixel is dark when it is darker than the mean of the square window around it: uneven light and vignetting
 * change little within a window. The window must be larger than the mark's edge zone and is best larger than
 * the mark; marks come in all sizes, so several windows are tried. In a window smaller than the mark only a
 * rim of the mark is found; with its hole filled that is as good. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/marks_internal.h"

enum {
    MIN_BORDER = 10, /* px: of the least area */
    MIN_AREA = 6,    /* px^2: smaller blobs are noise, and have no shape to speak of */
    NOISE_BINS = 8 * 256,
    MAX_MAJOR = 1500,  /* px, semi-axis of the largest mark */
    MAX_RADIUS = 1000, /* px, of the largest window */
    SMOOTH_ABOVE = 5,  /* grey levels of noise above which the image is smoothed before it is binarised */
};

/* Immerkaer's filter (1996): the second difference in x of the second difference in y takes away planes,
 * edges along the axes and shading; its standard deviation is 6 times the noise's. The median leaves out
 * texture. */
double td_image_noise(const td_image *image)
{
    unsigned bin[NOISE_BINS] = {0}, total = 0, seen = 0;
    int w = image->width, step = image->height > 256 ? 4 : 1;
    for (int y = 1; y + 1 < image->height; y += step) {
        const uint8_t *a = image->data + (size_t)(y - 1) * w, *b = a + w, *c = b + w;
        for (int x = 1; x + 1 < w; x++) {
            int n = a[x - 1] - 2 * a[x] + a[x + 1] - 2 * (b[x - 1] - 2 * b[x] + b[x + 1]) + c[x - 1] -
                    2 * c[x] + c[x + 1];
            bin[abs(n)]++;
            total++;
        }
    }
    int median = 0;
    while (median < NOISE_BINS - 1 && 2 * (seen += bin[median]) < total) median++;
    return median / (6 * 0.6745);
}

/* The 3x3 binomial filter; takes white noise to 3/8. */
static void smooth(uint8_t *out, const td_image *image)
{
    int w = image->width, h = image->height;
    memcpy(out, image->data, (size_t)w * h);
    for (int y = 1; y + 1 < h; y++) {
        const uint8_t *a = image->data + (size_t)(y - 1) * w, *b = a + w, *c = b + w;
        for (int x = 1; x + 1 < w; x++)
            out[(size_t)y * w + x] =
                (uint8_t)((a[x - 1] + 2 * a[x] + a[x + 1] + 2 * (b[x - 1] + 2 * b[x] + b[x + 1]) + c[x - 1] +
                           2 * c[x] + c[x + 1] + 8) >>
                          4);
    }
}

typedef struct point {
    int x, y;
} point;

/* What one pass over the image works on. Masks have a border of one empty pixel. */
typedef struct pass {
    const uint8_t *grey;
    int width, height;
    uint8_t *mask;    /* (height+2,width+2): 1 in the blob's class, +2: left edge walked */
    uint32_t *column; /* (width) sums over the window's rows */
    uint32_t *sum;    /* (width + 2 MAX_RADIUS + 2) */
    int *area;        /* (width) columns of the window around each column */
    point *edge;      /* the contour being walked: corners between pixels */
    size_t edge_size;
    td_blob *blob;
    size_t count, size;
    double least_step; /* grey levels across a blob's border */
} pass;

/* Adds a row of pixels to the columns' sums, or takes it away. */
static void enter_row(pass *p, int y)
{
    const uint8_t *row = p->grey + (size_t)y * p->width;
    for (int x = 0; x < p->width; x++) p->column[x] += row[x];
}

static void leave_row(pass *p, int y)
{
    const uint8_t *row = p->grey + (size_t)y * p->width;
    for (int x = 0; x < p->width; x++) p->column[x] -= row[x];
}

/* mask = pixels that differ from the mean of the window of `radius` by more than `delta` grey levels. Windows
 * are cut at the image's border. The windows' sums stay below 2^31. */
static void binarise(pass *p, int radius, int delta, bool light)
{
    const int w = p->width, h = p->height;
    uint32_t *sum = p->sum + radius + 1; /* sum[x]: of the columns before x, modulo 2^32 */
    for (int x = -radius - 1; x < 0; x++) sum[x] = 0;
    memset(p->column, 0, (size_t)w * sizeof *p->column);
    for (int y = 0; y < radius && y < h; y++) enter_row(p, y);
    for (int y = 0; y < h; y++) {
        int top = y - radius > 0 ? y - radius : 0, bottom = y + radius < h ? y + radius : h - 1;
        if (y + radius < h) enter_row(p, y + radius);
        if (y - radius > 0) leave_row(p, y - radius - 1);
        sum[0] = 0;
        for (int x = 0; x < w; x++) sum[x + 1] = sum[x] + p->column[x];
        for (int x = w + 1; x <= w + radius; x++) sum[x] = sum[w];
        const uint8_t *grey = p->grey + (size_t)y * w;
        uint8_t *mask = p->mask + (size_t)(y + 1) * (w + 2) + 1;
        const int *area = p->area;
        const int rows = bottom - top + 1;
        if (light)
            for (int x = 0; x < w; x++)
                mask[x] = (grey[x] - delta) * (rows * area[x]) > (int)(sum[x + radius + 1] - sum[x - radius]);
        else
            for (int x = 0; x < w; x++)
                mask[x] = (grey[x] + delta) * (rows * area[x]) < (int)(sum[x + radius + 1] - sum[x - radius]);
    }
}

/* Walks once round the border that begins with the left edge of pixel (x, y), its class on the right hand,
 * along the cracks between pixels; diagonal neighbours do not connect. Returns the number of corners, 0 when
 * out of memory. */
static size_t walk(pass *p, int x, int y)
{
    int stride = p->width + 2;
    int dx = 0, dy = -1;
    int cx = x, cy = y + 1; /* corner (cx, cy) is the upper left corner of pixel (cx, cy) */
    size_t n = 0;
    do {
        if (n == p->edge_size) {
            size_t size = 2 * p->edge_size + 1024;
            point *edge = realloc(p->edge, size * sizeof *edge);
            if (!edge) return 0;
            p->edge = edge;
            p->edge_size = size;
        }
        p->edge[n++] = (point){cx, cy};
        cx += dx;
        cy += dy;
        if (dy < 0) p->mask[(size_t)(cy + 1) * stride + cx + 1] |= 2;
        /* The two pixels ahead, on the right and on the left of the direction of travel. */
        int rx = cx - (dx < 0 || dy > 0), ry = cy - (dx < 0 || dy < 0);
        int lx = cx - (dx < 0 || dy < 0), ly = cy - (dx > 0 || dy < 0);
        if (!p->mask[(size_t)(ry + 1) * stride + rx + 1]) {
            int turned = -dy;
            dy = dx;
            dx = turned;
        } else if (p->mask[(size_t)(ly + 1) * stride + lx + 1]) {
            int turned = dy;
            dy = -dx;
            dx = turned;
        }
    } while (cx != x || cy != y + 1 || dx != 0 || dy != -1);
    return n;
}

/* Area, centre of gravity and covariance of what lies within the walked border, by Green's theorem: the
 * double integral of x^a y^b is the border's integral of x^(a+1) / (a+1) y^b dy. False for a hole's border.
 */
static bool measure(td_blob *blob, const point *edge, size_t n)
{
    double m00 = 0, m10 = 0, m01 = 0, m20 = 0, m11 = 0, m02 = 0;
    for (size_t i = 0; i < n; i++) {
        const point *a = &edge[i], *b = &edge[i + 1 < n ? i + 1 : 0];
        double dy = b->y - a->y, x = a->x - edge[0].x, y = 0.5 * (a->y + b->y) - edge[0].y;
        if (dy == 0) continue;
        m00 += dy * x;
        m10 += dy * x * x / 2;
        m01 += dy * x * y;
        m20 += dy * x * x * x / 3;
        m11 += dy * x * x * y / 2;
        m02 += dy * x * (y * y + 1.0 / 12);
    }
    if (m00 < MIN_AREA) return false;
    double x = m10 / m00, y = m01 / m00;
    blob->area = m00;
    blob->centroid[0] = x + edge[0].x - 0.5;
    blob->centroid[1] = y + edge[0].y - 0.5;
    blob->covariance[0] = m20 / m00 - x * x;
    blob->covariance[1] = m11 / m00 - x * y;
    blob->covariance[2] = m02 / m00 - y * y;
    return true;
}

/* The border's distance from the centre in the metric of the blob's covariance is 1 everywhere on an ellipse
 * (4 covariance = B^2). Steps of whole pixels add about half a pixel. */
static bool is_elliptical(const td_blob *blob, const point *edge, size_t n)
{
    double xx = blob->covariance[0], xy = blob->covariance[1], yy = blob->covariance[2];
    double det = xx * yy - xy * xy, half = 0.5 * (xx + yy), root = sqrt(fmax(half * half - det, 0));
    double minor = 2 * sqrt(fmax(half - root, 0)), major = 2 * sqrt(half + root);
    if (!(minor > 0.4) || minor < 0.1 * major || major > MAX_MAJOR) return false;
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        double dx = edge[i].x - 0.5 - blob->centroid[0], dy = edge[i].y - 0.5 - blob->centroid[1];
        double r = sqrt((yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / det) / 2;
        sum += (r - 1) * (r - 1);
    }
    return sqrt(sum / (double)n) < 0.07 + 0.6 / minor;
}

/* Mean step of the grey levels across the border, from the second pixel before it to the second behind it.
 * The blob keeps away from the image's border. */
static double border_step(const pass *p, const point *edge, size_t n)
{
    int64_t sum = 0;
    for (size_t i = 0; i < n; i++) {
        const point *a = &edge[i], *b = &edge[i + 1 < n ? i + 1 : 0];
        int dx = b->x - a->x, dy = b->y - a->y;
        int left_x = a->x - (dx < 0 || dy < 0) + dy, left_y = a->y - (dx > 0 || dy < 0) - dx;
        sum += p->grey[(size_t)left_y * p->width + left_x];
        sum -= p->grey[(size_t)(left_y + 3 * dx) * p->width + left_x - 3 * dy];
    }
    return fabs((double)sum) / (double)n;
}

/* Adds the blobs of the mask. */
static bool collect(pass *p, bool light)
{
    int w = p->width, h = p->height, stride = w + 2;
    for (int y = 0; y < h; y++) {
        const uint8_t *mask = p->mask + (size_t)(y + 1) * stride + 1;
        for (int x = 0; x < w; x++) {
            if (mask[x] != 1 || mask[x - 1]) continue;
            size_t n = walk(p, x, y);
            if (!n) return false;
            td_blob blob = {.light = light};
            if (n < MIN_BORDER || !measure(&blob, p->edge, n) || !is_elliptical(&blob, p->edge, n)) continue;
            bool inside = true;
            for (size_t i = 0; i < n && inside; i++)
                inside = p->edge[i].x > 1 && p->edge[i].y > 1 && p->edge[i].x < w - 1 && p->edge[i].y < h - 1;
            if (!inside || border_step(p, p->edge, n) < p->least_step * (1 + 20 / blob.area)) continue;
            if (p->count == p->size) {
                size_t size = 2 * p->size + 64;
                td_blob *more = realloc(p->blob, size * sizeof *more);
                if (!more) return false;
                p->blob = more;
                p->size = size;
            }
            p->blob[p->count++] = blob;
        }
    }
    return true;
}

/* All windows, dark and light as wanted. */
static bool all_windows(pass *p, td_mark_polarity polarity, int delta)
{
    int larger = p->width > p->height ? p->width : p->height;
    for (int radius = 8; radius == 8 || (radius < larger / 5 && radius < MAX_RADIUS); radius *= 4) {
        for (int x = 0; x < p->width; x++) {
            int left = x - radius > 0 ? x - radius : 0,
                right = x + radius < p->width ? x + radius : p->width - 1;
            p->area[x] = right - left + 1;
        }
        for (int light = 0; light < 2; light++) {
            if (polarity == (light ? TD_MARK_DARK : TD_MARK_LIGHT)) continue;
            binarise(p, radius, delta, light);
            if (!collect(p, light)) return false;
        }
    }
    return true;
}

td_status td_marks_blobs(td_blob **blobs, size_t *count, const td_image *image, td_mark_polarity polarity,
                         td_error *error)
{
    size_t w = (size_t)image->width, h = (size_t)image->height;
    double noise = td_image_noise(image);
    uint8_t *smoothed = NULL;
    pass p = {.grey = image->data, .width = image->width, .height = image->height};
    p.mask = calloc((w + 2) * (h + 2), 1);
    p.column = malloc(w * sizeof *p.column);
    p.sum = malloc((w + 2 * MAX_RADIUS + 2) * sizeof *p.sum);
    p.area = malloc(w * sizeof *p.area);
    if (noise > SMOOTH_ABOVE) {
        p.grey = smoothed = malloc(w * h);
        noise *= 0.375;
    }
    p.least_step = fmax(3, 4 * noise);
    bool ok = p.mask && p.column && p.sum && p.area && p.grey;
    if (ok && smoothed) smooth(smoothed, image);
    if (ok) ok = all_windows(&p, polarity, (int)lround(fmax(2, 3 * noise)));
    free(smoothed);
    free(p.mask);
    free(p.column);
    free(p.sum);
    free(p.area);
    free(p.edge);
    if (!ok) {
        free(p.blob);
        return td_fail(error, TD_ERROR_MEMORY, "no memory to look for marks in an image of %zux%zu", w, h);
    }
    *blobs = p.blob;
    *count = p.count;
    return TD_OK;
}
