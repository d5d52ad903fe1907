#include "recon/interest.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"

enum {
    MAX_RADIUS = 48,
    BAND = 48, /* rows: what one thread works on stays in its cache */
    CELL = 8   /* px: squares over which contrast is averaged; divides BAND */
};
static const double MAX_SIGMA = 16;       /* px; three of them are MAX_RADIUS */
static const double CONTRAST_SIGMA = 3;   /* cells: the neighbourhood whose contrast counts */
static const double CONTRAST_FLOOR = 0.2; /* of the image's mean: where nothing is, noise is not raised */

td_interest_options td_interest_options_default(void)
{
    return (td_interest_options){.count = 500,
                                 .sigma_derivative = 0.7,
                                 .sigma_integration = 1.4,
                                 .k = 0.06,
                                 .contrast = 1.5,
                                 .distance_px = 5,
                                 .quality = 1e-4};
}

static td_status check_options(const td_interest_options *o, td_error *error)
{
    const struct {
        const char *name;
        double value, low, high;
    } field[] = {{"sigma_derivative", o->sigma_derivative, 0.4, MAX_SIGMA},
                 {"sigma_integration", o->sigma_integration, 0.4, MAX_SIGMA},
                 {"k", o->k, 0.01, 0.24}, /* 1/4: where not even equal eigenvalues make a corner */
                 {"contrast", o->contrast, 0, 2},
                 {"distance_px", o->distance_px, 0, 1e4},
                 {"quality", o->quality, 0, 1}};
    if (o->count == 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "count: is 0; ask for at least one interest point");
    if (o->threads < 0)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "threads: is %d; give their number, or 0 for one per processor", o->threads);
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].value >= field[i].low && field[i].value <= field[i].high))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: is %g, but must be within %g and %g", field[i].name,
                           field[i].value, field[i].low, field[i].high);
    return TD_OK;
}

/* ---- response ---- */

/* tap[i] weighs the values i before and i after; an odd kernel (a derivative's) takes their difference. */
typedef struct kernel {
    int radius;
    float tap[MAX_RADIUS + 1];
} kernel;

static kernel gaussian(double sigma)
{
    kernel g = {.radius = (int)ceil(3 * sigma)};
    double weight[MAX_RADIUS + 1], sum = 0;
    for (int i = 0; i <= g.radius; i++) {
        weight[i] = exp(-0.5 * i * i / (sigma * sigma));
        sum += i ? 2 * weight[i] : weight[i];
    }
    for (int i = 0; i <= g.radius; i++) g.tap[i] = (float)(weight[i] / sum);
    return g;
}

/* Scaled so that a ramp of slope 1 gives exactly 1, cut off and sampled as it is. */
static kernel gaussian_slope(double sigma)
{
    kernel d = {.radius = (int)ceil(3 * sigma)};
    double weight[MAX_RADIUS + 1], sum = 0;
    for (int i = 0; i <= d.radius; i++) {
        weight[i] = i * exp(-0.5 * i * i / (sigma * sigma));
        sum += 2 * i * weight[i];
    }
    for (int i = 0; i <= d.radius; i++) d.tap[i] = (float)(weight[i] / sum);
    return d;
}

typedef struct response {
    const td_image *image;
    kernel smooth, slope, window;
    float k;
    float *value;    /* (height,width) */
    float *contrast; /* (rows,columns) of cells: sums of the squared gradient */
    int columns, rows;
    bool *failed; /* (bands): out of memory */
} response;

static int clamp(int i, int count)
{
    return i < 0 ? 0 : i >= count ? count - 1 : i;
}

/* Repeats the ends of a row (width) into `pad` values on both sides. */
static void extend(float *row, int width, int pad)
{
    for (int i = 1; i <= pad; i++) {
        row[-i] = row[0];
        row[width - 1 + i] = row[width - 1];
    }
}

/* Both kernels down the columns of the image, at row y. Differences of bytes are exact: equal greys give 0.
 */
static void filter_down(float *restrict smooth, float *restrict slope, const response *r, int y)
{
    const int width = r->image->width, height = r->image->height;
    const size_t w = (size_t)width;
    const uint8_t *here = r->image->data + (size_t)y * w;
    for (int x = 0; x < width; x++) {
        smooth[x] = r->smooth.tap[0] * (float)here[x];
        slope[x] = 0;
    }
    for (int i = 1; i <= r->smooth.radius; i++) {
        const uint8_t *restrict above = r->image->data + (size_t)clamp(y - i, height) * w;
        const uint8_t *restrict below = r->image->data + (size_t)clamp(y + i, height) * w;
        const float g = r->smooth.tap[i], d = r->slope.tap[i];
        for (int x = 0; x < width; x++) {
            smooth[x] += g * (float)(below[x] + above[x]);
            slope[x] += d * (float)(below[x] - above[x]);
        }
    }
}

/* The products of the image's derivatives at row y: xx, yy, xy. `rows`: two extended rows of scratch. */
static void structure_row(float *restrict xx, float *restrict yy, float *restrict xy, float *const rows[2],
                          const response *r, int y)
{
    const int width = r->image->width, radius = r->smooth.radius;
    const float *restrict smooth = rows[0], *restrict slope = rows[1];
    filter_down(rows[0], rows[1], r, y);
    extend(rows[0], width, radius);
    extend(rows[1], width, radius);
    for (int x = 0; x < width; x++) {
        xx[x] = 0;
        yy[x] = r->smooth.tap[0] * slope[x];
    }
    for (int i = 1; i <= radius; i++) {
        const float g = r->smooth.tap[i], d = r->slope.tap[i];
        for (int x = 0; x < width; x++) {
            xx[x] += d * (smooth[x + i] - smooth[x - i]);
            yy[x] += g * (slope[x + i] + slope[x - i]);
        }
    }
    for (int x = 0; x < width; x++) {
        const float gx = xx[x], gy = yy[x];
        xx[x] = gx * gx;
        yy[x] = gy * gy;
        xy[x] = gx * gy;
    }
}

/* One product smoothed: down the columns of its band, whose first row is `first` and which has `count` rows,
 * into `row`, then along it into `out`. */
static void window_row(float *restrict out, float *restrict row, const float *band, int first, int count,
                       const response *r, int y)
{
    const int width = r->image->width;
    const size_t w = (size_t)width;
    const kernel *g = &r->window;
    const float *here = band + (size_t)(y - first) * w;
    for (int x = 0; x < width; x++) row[x] = g->tap[0] * here[x];
    for (int i = 1; i <= g->radius; i++) {
        const float *restrict above = band + (size_t)clamp(y - i - first, count) * w;
        const float *restrict below = band + (size_t)clamp(y + i - first, count) * w;
        for (int x = 0; x < width; x++) row[x] += g->tap[i] * (above[x] + below[x]);
    }
    extend(row, width, g->radius);
    for (int x = 0; x < width; x++) out[x] = g->tap[0] * row[x];
    for (int i = 1; i <= g->radius; i++)
        for (int x = 0; x < width; x++) out[x] += g->tap[i] * (row[x - i] + row[x + i]);
}

/* Adds a row's squared gradient to its cells, in the order of the pixels. */
static void add_contrast(const response *r, const float *xx, const float *yy, int y)
{
    float *cell = r->contrast + (size_t)(y / CELL) * (size_t)r->columns;
    for (int c = 0; c < r->columns; c++) {
        const int end = (c + 1) * CELL < r->image->width ? (c + 1) * CELL : r->image->width;
        float sum = 0;
        for (int x = c * CELL; x < end; x++) sum += xx[x] + yy[x];
        cell[c] += sum;
    }
}

static void respond_row(float *restrict value, float *const a[3], int width, float k)
{
    const float *restrict xx = a[0], *restrict yy = a[1], *restrict xy = a[2];
    for (int x = 0; x < width; x++) {
        const float trace = xx[x] + yy[x];
        value[x] = xx[x] * yy[x] - xy[x] * xy[x] - k * trace * trace;
    }
}

/* Rows of one band. The products are found for the band and for what the window reaches beyond it, where the
 * image has it: rows of two bands are worked out twice, so that bands do not wait for each other. */
static void respond_band(size_t index, void *user)
{
    const response *r = user;
    const int width = r->image->width, height = r->image->height;
    const int begin = (int)index * BAND, end = begin + BAND < height ? begin + BAND : height;
    const int first = begin > r->window.radius ? begin - r->window.radius : 0;
    const int last = end + r->window.radius < height ? end + r->window.radius : height;
    const size_t w = (size_t)width, padded = w + 2 * MAX_RADIUS, plane = (size_t)(last - first) * w;
    float *memory = malloc((3 * plane + 3 * w + 2 * padded) * sizeof *memory);
    r->failed[index] = !memory;
    if (!memory) return;
    float *product[3] = {memory, memory + plane, memory + 2 * plane};
    float *a[3] = {memory + 3 * plane, memory + 3 * plane + w, memory + 3 * plane + 2 * w};
    float *rows[2] = {a[2] + w + MAX_RADIUS, a[2] + w + MAX_RADIUS + padded};
    for (int y = first; y < last; y++) {
        const size_t at = (size_t)(y - first) * w;
        structure_row(product[0] + at, product[1] + at, product[2] + at, rows, r, y);
        if (y >= begin && y < end) add_contrast(r, product[0] + at, product[1] + at, y);
    }
    for (int y = begin; y < end; y++) {
        for (int p = 0; p < 3; p++) window_row(a[p], rows[0], product[p], first, last - first, r, y);
        respond_row(r->value + (size_t)y * w, a, width, r->k);
    }
    free(memory);
}

/* Means over the cells of a line, weighted by a Gaussian; beyond the ends is nothing. */
static void smooth_cells(float *line, size_t stride, int count, float *scratch)
{
    const kernel g = gaussian(CONTRAST_SIGMA);
    for (int i = 0; i < count; i++) {
        float sum = 0, weight = 0;
        for (int k = -g.radius; k <= g.radius; k++) {
            if (i + k < 0 || i + k >= count) continue;
            sum += g.tap[abs(k)] * line[(size_t)(i + k) * stride];
            weight += g.tap[abs(k)];
        }
        scratch[i] = sum / weight;
    }
    for (int i = 0; i < count; i++) line[(size_t)i * stride] = scratch[i];
}

/* From the cells' sums to what responses are divided by, but for its power. */
static bool finish_contrast(response *r)
{
    const int most = r->columns > r->rows ? r->columns : r->rows;
    const size_t columns = (size_t)r->columns, cells = columns * (size_t)r->rows;
    float *scratch = malloc((size_t)most * sizeof *scratch);
    double total = 0;
    if (!scratch) return false;
    for (size_t i = 0; i < cells; i++) {
        const int x = (int)(i % columns) * CELL, y = (int)(i / columns) * CELL;
        const int w = r->image->width - x < CELL ? r->image->width - x : CELL;
        const int h = r->image->height - y < CELL ? r->image->height - y : CELL;
        total += (double)r->contrast[i];
        r->contrast[i] /= (float)(w * h);
    }
    for (int y = 0; y < r->rows; y++) smooth_cells(r->contrast + (size_t)y * columns, 1, r->columns, scratch);
    for (int x = 0; x < r->columns; x++) smooth_cells(r->contrast + x, columns, r->rows, scratch);
    const double mean = total / ((double)r->image->width * r->image->height);
    for (size_t i = 0; i < cells; i++) r->contrast[i] += (float)(CONTRAST_FLOOR * mean);
    free(scratch);
    return true;
}

static void response_free(response *r)
{
    free(r->value);
    free(r->contrast);
    free(r->failed);
}

static bool respond(response *r, const td_image *image, const td_interest_options *o)
{
    const size_t bands = ((size_t)image->height + BAND - 1) / BAND;
    *r = (response){.image = image,
                    .smooth = gaussian(o->sigma_derivative),
                    .slope = gaussian_slope(o->sigma_derivative),
                    .window = gaussian(o->sigma_integration),
                    .k = (float)o->k,
                    .columns = (image->width + CELL - 1) / CELL,
                    .rows = (image->height + CELL - 1) / CELL};
    r->value = malloc((size_t)image->width * (size_t)image->height * sizeof *r->value);
    r->contrast = calloc((size_t)r->columns * (size_t)r->rows, sizeof *r->contrast);
    r->failed = calloc(bands, sizeof *r->failed);
    if (!r->value || !r->contrast || !r->failed) return false;
    td_parallel_for(bands, o->threads, respond_band, r, NULL, NULL);
    for (size_t i = 0; i < bands; i++)
        if (r->failed[i]) return false;
    return finish_contrast(r);
}

/* ---- maxima ---- */

/* The top of the paraboloid that fits the 3x3 responses around pixel (x, y) best, or the pixel itself where
 * it has none within a pixel. */
static td_interest_point refine(const float *value, size_t width, int x, int y)
{
    const float *a = value + (size_t)y * width + x, *u = a - width, *b = a + width;
    const double left = (double)u[-1] + a[-1] + b[-1], right = (double)u[1] + a[1] + b[1];
    const double up = (double)u[-1] + u[0] + u[1], down = (double)b[-1] + b[0] + b[1];
    const double gx = (right - left) / 6, gy = (down - up) / 6;
    const double xx = (right + left - 2 * ((double)u[0] + a[0] + b[0])) / 3;
    const double yy = (down + up - 2 * ((double)a[-1] + a[0] + a[1])) / 3;
    const double xy = ((double)b[1] + u[-1] - u[1] - b[-1]) / 4, det = xx * yy - xy * xy;
    td_interest_point point = {x, y, a[0]};
    if (det > 0 && xx < 0) {
        const double dx = (xy * gy - yy * gx) / det, dy = (xy * gx - xx * gy) / det;
        if (fabs(dx) < 1 && fabs(dy) < 1) point.x += dx, point.y += dy;
    }
    return point;
}

/* Largest of the 3x3; of equal ones the first. */
static bool is_maximum(const float *a, size_t width)
{
    const float *u = a - width, *b = a + width, v = *a;
    return v > u[-1] && v > u[0] && v > u[1] && v > a[-1] && v >= a[1] && v >= b[-1] && v >= b[0] &&
           v >= b[1];
}

typedef struct points {
    td_interest_point *list;
    size_t count, capacity;
} points;

static bool add_point(points *p, const td_interest_point *point)
{
    if (p->count == p->capacity) {
        size_t wanted = p->capacity ? 2 * p->capacity : 1024;
        td_interest_point *list = realloc(p->list, wanted * sizeof *list);
        if (!list) return false;
        p->list = list;
        p->capacity = wanted;
    }
    p->list[p->count++] = *point;
    return true;
}

/* Between the centres of the cells, linearly. */
static double contrast_at(const response *r, double x, double y)
{
    const double u = fmin(fmax((x + 0.5) / CELL - 0.5, 0), r->columns - 1);
    const double v = fmin(fmax((y + 0.5) / CELL - 0.5, 0), r->rows - 1);
    const int c = (int)u, d = c + 1 < r->columns ? c + 1 : c;
    const float *a = r->contrast + (size_t)(int)v * (size_t)r->columns;
    const float *b = (int)v + 1 < r->rows ? a + r->columns : a;
    const double above = (double)a[c] + (u - c) * (double)(a[d] - a[c]);
    const double below = (double)b[c] + (u - c) * (double)(b[d] - b[c]);
    return above + (v - (int)v) * (below - above);
}

/* Maxima inside the outermost pixels, whose neighbours are all there. */
static bool find_maxima(points *p, const response *r, double quality, double power)
{
    const int width = r->image->width, height = r->image->height;
    const size_t w = (size_t)width;
    const float *value = r->value;
    float largest = 0;
    for (size_t i = 0; i < w * (size_t)height; i++) largest = value[i] > largest ? value[i] : largest;
    const float least = (float)(quality * (double)largest);
    for (int y = 1; y + 1 < height; y++)
        for (int x = 1; x + 1 < width; x++) {
            const float *a = value + (size_t)y * w + x;
            if (!(*a > 0) || *a < least || !is_maximum(a, w)) continue;
            td_interest_point point = refine(value, w, x, y);
            if (power > 0) point.response *= pow(contrast_at(r, x, y), -power);
            if (!add_point(p, &point)) return false;
        }
    return true;
}

static int stronger_first(const void *a, const void *b)
{
    const td_interest_point *p = a, *q = b;
    if (p->response != q->response) return p->response > q->response ? -1 : 1;
    if (p->y != q->y) return p->y < q->y ? -1 : 1;
    return (p->x > q->x) - (p->x < q->x);
}

/* ---- spread ---- */

/* Cells of a size such that the points kept in one are few: `first` and `next` chain their numbers + 1. */
typedef struct grid {
    double cell;
    int columns, rows;
    size_t *first, *next;
} grid;

static bool grid_init(grid *g, double cell, int width, int height, size_t count)
{
    g->cell = cell;
    g->columns = (int)(width / cell) + 1;
    g->rows = (int)(height / cell) + 1;
    g->first = calloc((size_t)g->columns * (size_t)g->rows, sizeof *g->first);
    g->next = calloc(count + 1, sizeof *g->next);
    return g->first && g->next;
}

static void grid_free(grid *g)
{
    free(g->first);
    free(g->next);
}

static void grid_cell(int cell[2], const grid *g, const td_interest_point *p)
{
    cell[0] = clamp((int)(p->x / g->cell), g->columns);
    cell[1] = clamp((int)(p->y / g->cell), g->rows);
}

static void grid_insert(grid *g, const td_interest_point *list, size_t index)
{
    int cell[2];
    grid_cell(cell, g, list + index);
    size_t *first = g->first + (size_t)cell[1] * (size_t)g->columns + (size_t)cell[0];
    g->next[index] = *first;
    *first = index + 1;
}

/* Least squared distance from p to the points of one cell. */
static double cell_distance(const grid *g, int column, int row, const td_interest_point *list,
                            const td_interest_point *p)
{
    double least = INFINITY;
    if (column < 0 || row < 0 || column >= g->columns || row >= g->rows) return least;
    for (size_t i = g->first[(size_t)row * (size_t)g->columns + (size_t)column]; i; i = g->next[i - 1]) {
        const double dx = list[i - 1].x - p->x, dy = list[i - 1].y - p->y;
        least = fmin(least, dx * dx + dy * dy);
    }
    return least;
}

/* Distance from p to the nearest point in the grid, ring of cells by ring; INFINITY when none is nearer than
 * `reach`. */
static double grid_nearest(const grid *g, const td_interest_point *list, const td_interest_point *p,
                           double reach)
{
    int cell[2];
    double least = reach * reach;
    bool found = false;
    grid_cell(cell, g, p);
    /* Points of ring i are at least i - 1 cells away. */
    for (int ring = 0; ring <= g->columns + g->rows; ring++) {
        const double away = (ring - 1) * g->cell;
        if (ring > 1 && away * away >= least) break;
        for (int row = -ring; row <= ring; row++) {
            const int step = row == -ring || row == ring || ring == 0 ? 1 : 2 * ring;
            for (int column = -ring; column <= ring; column += step) {
                const double d = cell_distance(g, cell[0] + column, cell[1] + row, list, p);
                if (d < least) least = d, found = true;
            }
        }
    }
    return found ? sqrt(least) : INFINITY;
}

/* Keeps, strongest first, the points that are no nearer than `distance` to one kept; at most `most`. */
static bool thin_out(points *p, double distance, size_t most, int width, int height)
{
    grid g;
    size_t kept = 0;
    bool ok = grid_init(&g, fmax(distance, 4), width, height, p->count);
    for (size_t i = 0; ok && i < p->count && kept < most; i++) {
        if (isfinite(grid_nearest(&g, p->list, p->list + i, distance))) continue;
        p->list[kept] = p->list[i];
        grid_insert(&g, p->list, kept++);
    }
    if (ok) p->count = kept;
    grid_free(&g);
    return ok;
}

typedef struct isolated {
    double radius; /* px, to the nearest point that is clearly stronger */
    size_t index;
} isolated;

static int more_isolated_first(const void *a, const void *b)
{
    const isolated *p = a, *q = b;
    if (p->radius != q->radius) return p->radius > q->radius ? -1 : 1;
    return (p->index > q->index) - (p->index < q->index);
}

/* Brown, Szeliski and Winder's radius of each point, whose list is sorted by response: the points with
 * 0.9 of their response still above its own are in the grid before it is asked for. */
static bool find_radii(isolated *out, const points *p, int width, int height)
{
    static const double ROBUSTNESS = 0.9;
    grid g;
    size_t inside = 0;
    bool ok = grid_init(&g, fmax(4, sqrt((double)width * height / ((double)p->count + 1))), width, height,
                        p->count);
    for (size_t i = 0; ok && i < p->count; i++) {
        while (ROBUSTNESS * p->list[inside].response > p->list[i].response)
            grid_insert(&g, p->list, inside++);
        out[i] = (isolated){inside ? grid_nearest(&g, p->list, p->list + i, width + height) : INFINITY, i};
    }
    grid_free(&g);
    return ok;
}

static bool spread_evenly(points *p, size_t most, int width, int height)
{
    isolated *order = malloc((p->count + 1) * sizeof *order);
    td_interest_point *list = malloc((most < p->count ? most : p->count + 1) * sizeof *list);
    bool ok = order && list && find_radii(order, p, width, height);
    if (ok) {
        qsort(order, p->count, sizeof *order, more_isolated_first);
        if (p->count > most) p->count = most;
        for (size_t i = 0; i < p->count; i++) list[i] = p->list[order[i].index];
        free(p->list);
        p->list = list;
        list = NULL;
    }
    free(order);
    free(list);
    return ok;
}

static bool select_points(points *p, const td_interest_options *o, int width, int height)
{
    if (p->count == 0) return true;
    qsort(p->list, p->count, sizeof *p->list, stronger_first);
    return thin_out(p, o->distance_px, o->even ? SIZE_MAX : o->count, width, height) &&
           (!o->even || spread_evenly(p, o->count, width, height));
}

td_status td_interest_points(td_interest_point **list, size_t *count, const td_image *image,
                             const td_interest_options *options, td_error *error)
{
    const td_interest_options standard = td_interest_options_default(), *o = options ? options : &standard;
    *list = NULL;
    *count = 0;
    TD_TRY(check_options(o, error));
    if (image->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "interest points are found in grey images; this one has %d channels", image->channels);
    points p = {0};
    response r;
    bool ok = respond(&r, image, o) && find_maxima(&p, &r, o->quality, o->contrast) &&
              select_points(&p, o, image->width, image->height);
    response_free(&r);
    if (!ok) {
        free(p.list);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the interest points of %d x %d pixels",
                       image->width, image->height);
    }
    *list = p.list;
    *count = p.count;
    return TD_OK;
}
