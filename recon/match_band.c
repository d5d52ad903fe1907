/* ZNCC along an epipolar curve. The curve is followed in pieces of 8 px, straight to well below a pixel, and
 * every pixel within the band's half width is compared once. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/epipolar_internal.h"
#include "recon/match_internal.h"

enum { MOST_PIECES = 1024 }; /* of a curve: an end for those that have none */

#define PIECE_PX 8.0
#define ALONG_PX 1.0 /* no pixel of the longer axis is stepped over */
#define ACROSS_PX 0.5

/* ---- The curve in pieces ---- */

typedef struct piece {
    double from[2], to[2];
} piece;

typedef struct path {
    piece piece[MOST_PIECES];
    size_t count;
} path;

/* How far outside the box of `size`, widened by the band. */
static double outside(const double p[2], int width, int height, double band_px)
{
    const double x = fmax(-p[0], p[0] - width), y = fmax(-p[1], p[1] - height);
    return fmax(fmax(x, y) - band_px, 0);
}

/* From far to near. Outside the image steps are as long as the way back at least is. */
static void follow_curve(path *out, const td_epipolar_curve *curve, double from, double to, double band_px)
{
    const int width = curve->camera->width, height = curve->camera->height;
    double last[2], next[2], d[2], step = 0, w = from, far_out = INFINITY;
    bool has_last = false;
    out->count = 0;
    for (int i = 0; i < MOST_PIECES; i++) {
        if (!td_epipolar_curve_at(next, d, NULL, curve, w)) {
            has_last = false;
            step = (to - from) / 500;
        } else {
            const double now = outside(next, width, height, band_px);
            const double length = has_last ? hypot(next[0] - last[0], next[1] - last[1]) : 0;
            if (length > 2 * fmax(PIECE_PX, far_out) && step > 1e-9 * to) {
                w -= step /= 2;
                continue;
            }
            if (has_last && fmin(now, far_out) <= PIECE_PX)
                out->piece[out->count++] = (piece){{last[0], last[1]}, {next[0], next[1]}};
            memcpy(last, next, sizeof last);
            has_last = true;
            far_out = now;
            step = fmax(PIECE_PX, now) / fmax(hypot(d[0], d[1]), 1e-9);
        }
        if (w >= to) return;
        step = fmin(step, to - w);
        w = step < to - w ? w + step : to;
    }
}

/* ---- The band ---- */

static void empty_band(td_band *band)
{
    memset(band, 0, sizeof *band);
}

void td_band_free(td_band *band)
{
    free(band->score);
    free(band->pixel);
    empty_band(band);
}

/* The box that holds all pieces and the band around them, cut to the image. False: none. */
static bool set_box(td_band *band, const path *p, const td_camera *camera, double band_px)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (size_t i = 0; i < p->count; i++)
        for (int c = 0; c < 2; c++) {
            low[c] = fmin(low[c], fmin(p->piece[i].from[c], p->piece[i].to[c]));
            high[c] = fmax(high[c], fmax(p->piece[i].from[c], p->piece[i].to[c]));
        }
    const double x0 = fmax(floor(low[0] - band_px), 0), y0 = fmax(floor(low[1] - band_px), 0);
    const double x1 = fmin(ceil(high[0] + band_px), camera->width - 1);
    const double y1 = fmin(ceil(high[1] + band_px), camera->height - 1);
    if (!(x1 >= x0 && y1 >= y0)) return false;
    band->x0 = (int)x0;
    band->y0 = (int)y0;
    band->width = (int)x1 - band->x0 + 1;
    band->height = (int)y1 - band->y0 + 1;
    return true;
}

static bool add_pixel(td_band *band, int x, int y, td_band_score score, const void *user)
{
    float *stored = band->score + (size_t)(y - band->y0) * (size_t)band->width + (size_t)(x - band->x0);
    if (!isnan(*stored)) return true;
    if (band->count == band->capacity) {
        const size_t capacity = 2 * band->capacity + 1024;
        td_band_pixel *more = realloc(band->pixel, capacity * sizeof *more);
        if (!more) return false;
        band->pixel = more;
        band->capacity = capacity;
    }
    const double value = score(x, y, user);
    if (!isnan(value)) band->pixel[band->count++] = (td_band_pixel){x, y, value};
    *stored = (float)value;
    return true;
}

/* Pixels within the half width of a piece of the curve. */
static bool add_piece(td_band *band, const piece *p, double band_px, td_band_score score, const void *user)
{
    const double dx = p->to[0] - p->from[0], dy = p->to[1] - p->from[1], length = hypot(dx, dy);
    const int along = (int)ceil(length / ALONG_PX), across = (int)ceil(band_px / ACROSS_PX);
    if (!(length > 0)) return true;
    for (int i = 0; i <= along; i++)
        for (int o = -across; o <= across; o++) {
            const double s = (double)i / along, off = band_px * o / (across * length);
            const double x = floor(p->from[0] + s * dx - off * dy + 0.5);
            const double y = floor(p->from[1] + s * dy + off * dx + 0.5);
            if (x >= band->x0 && y >= band->y0 && x < band->x0 + band->width && y < band->y0 + band->height &&
                !add_pixel(band, (int)x, (int)y, score, user))
                return false;
        }
    return true;
}

bool td_band_search(td_band *band, const td_pair *pair, int i, int j, const td_band_range *range,
                    td_band_score score, const void *user)
{
    const double left[2] = {i, j};
    td_epipolar_curve curve;
    path way;
    empty_band(band);
    if (!td_epipolar_curve_init(&curve, NULL, pair, left)) return true;
    follow_curve(&way, &curve, 1 / range->far_m, 1 / range->near_m, range->band_px);
    if (!set_box(band, &way, curve.camera, range->band_px)) return true;
    const size_t cells = (size_t)band->width * (size_t)band->height;
    band->score = malloc(cells * sizeof *band->score);
    bool done = band->score != NULL;
    for (size_t n = 0; done && n < cells; n++) band->score[n] = NAN;
    for (size_t n = 0; done && n < way.count; n++)
        done = add_piece(band, &way.piece[n], range->band_px, score, user);
    if (!done) td_band_free(band);
    return done;
}

/* No better neighbour; of equal ones the first in reading order counts. */
static bool is_peak(const td_band *band, const td_band_pixel *p)
{
    const int x = p->x - band->x0, y = p->y - band->y0;
    const float own = band->score[(size_t)y * (size_t)band->width + (size_t)x];
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            const int nx = x + dx, ny = y + dy;
            if ((dx == 0 && dy == 0) || nx < 0 || ny < 0 || nx >= band->width || ny >= band->height) continue;
            const float other = band->score[(size_t)ny * (size_t)band->width + (size_t)nx];
            if (other > own || (other == own && (dy < 0 || (dy == 0 && dx < 0)))) return false;
        }
    return true;
}

static bool is_near(const td_band_pixel *a, const td_band_pixel *b, int distance)
{
    return abs(a->x - b->x) <= distance && abs(a->y - b->y) <= distance;
}

size_t td_band_peaks(td_band_pixel *peak, size_t capacity, const td_band *band, int distance)
{
    for (size_t n = 0; n < capacity; n++) {
        const td_band_pixel *best = NULL;
        for (size_t i = 0; i < band->count; i++) {
            const td_band_pixel *p = &band->pixel[i];
            bool taken = best && p->score <= best->score;
            for (size_t k = 0; k < n && !taken; k++) taken = is_near(p, &peak[k], distance);
            if (!taken && is_peak(band, p)) best = p;
        }
        if (!best) return n;
        peak[n] = *best;
    }
    return capacity;
}
