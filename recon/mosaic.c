#include "recon/mosaic.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "recon/mosaic_internal.h"

td_mosaic_options td_mosaic_options_default(void)
{
    return (td_mosaic_options){.cell_m = 0.05, .texels = 4, .memory_bytes = (size_t)512 << 20};
}

td_status td_mosaic_new(td_mosaic **mosaic, const td_mosaic_options *options, td_error *error)
{
    const td_mosaic_options standard = td_mosaic_options_default();
    if (!options) options = &standard;
    *mosaic = NULL;
    if (!(options->cell_m > 0 && isfinite(options->cell_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "cell_m: must be above 0, not %g", options->cell_m);
    if (options->texels != 1 && options->texels != 2 && options->texels != 4 && options->texels != 8)
        return td_fail(error, TD_ERROR_ARGUMENT, "texels: must be 1, 2, 4 or 8 along a cell, not %d",
                       options->texels);
    *mosaic = calloc(1, sizeof **mosaic);
    if (!*mosaic) return td_fail(error, TD_ERROR_MEMORY, "no memory for an orthophoto");
    (*mosaic)->options = *options;
    (*mosaic)->texels = options->texels;
    return TD_OK;
}

static void free_tiles(td_mosaic_tile *tile, size_t count)
{
    for (size_t i = 0; i < count; i++) free(tile[i].texel);
    free(tile);
}

void td_mosaic_free(td_mosaic **mosaic)
{
    if (!mosaic || !*mosaic) return;
    free_tiles((*mosaic)->tile, (*mosaic)->count);
    free(*mosaic);
    *mosaic = NULL;
}

/* ---- tiles ---- */

/* The first tile that is not before (x, y). */
static size_t find(const td_mosaic *m, int32_t x, int32_t y)
{
    size_t low = 0, high = m->count;
    while (low < high) {
        const size_t middle = (low + high) / 2;
        const td_mosaic_tile *t = &m->tile[middle];
        if (t->y < y || (t->y == y && t->x < x))
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

td_texel *td_mosaic_tile_at(td_mosaic *m, int32_t x, int32_t y)
{
    const size_t at = find(m, x, y);
    if (at < m->count && m->tile[at].x == x && m->tile[at].y == y) return m->tile[at].texel;
    if (m->count == m->room) {
        const size_t room = 2 * m->room + 64;
        td_mosaic_tile *larger = realloc(m->tile, room * sizeof *larger);
        if (!larger) return NULL;
        m->tile = larger;
        m->room = room;
    }
    td_texel *texel = calloc(TD_MOSAIC_TEXELS, sizeof *texel);
    if (!texel) return NULL;
    memmove(m->tile + at + 1, m->tile + at, (m->count - at) * sizeof *m->tile);
    m->tile[at] = (td_mosaic_tile){x, y, texel};
    m->count++;
    return texel;
}

/* ---- larger texels ---- */

static td_texel joined(const td_texel four[4])
{
    td_texel out = {0};
    unsigned sum[3] = {0, 0, 0}, seen = 0;
    for (int i = 0; i < 4; i++) {
        if (!four[i].seen) continue;
        if (!seen || four[i].pixel < out.pixel) out = four[i];
        for (int k = 0; k < 3; k++) sum[k] += four[i].rgb[k];
        seen++;
    }
    for (int k = 0; seen && k < 3; k++) out.rgb[k] = (uint8_t)((sum[k] + seen / 2) / seen);
    return out;
}

static int32_t half(int32_t v)
{
    return v >= 0 ? v / 2 : -((1 - v) / 2);
}

static void shrink_into(td_texel *to, const td_mosaic_tile *from)
{
    enum { HALF = TD_MOSAIC_SIDE / 2 };
    const int x0 = from->x == 2 * half(from->x) ? 0 : HALF, y0 = from->y == 2 * half(from->y) ? 0 : HALF;
    for (int y = 0; y < HALF; y++)
        for (int x = 0; x < HALF; x++) {
            const td_texel *a = from->texel + 2 * y * TD_MOSAIC_SIDE + 2 * x, *b = a + TD_MOSAIC_SIDE;
            to[(y0 + y) * TD_MOSAIC_SIDE + x0 + x] = joined((td_texel[4]){a[0], a[1], b[0], b[1]});
        }
}

td_status td_mosaic_halve(td_mosaic *m, td_error *error)
{
    td_mosaic coarse = {.options = m->options, .texels = m->texels / 2};
    td_status status = TD_OK;
    for (size_t i = 0; status == TD_OK && i < m->count; i++) {
        td_texel *to = td_mosaic_tile_at(&coarse, half(m->tile[i].x), half(m->tile[i].y));
        if (to)
            shrink_into(to, &m->tile[i]);
        else
            status = td_fail(error, TD_ERROR_MEMORY, "no memory for an orthophoto");
    }
    if (status != TD_OK) {
        free_tiles(coarse.tile, coarse.count);
        return status;
    }
    free_tiles(m->tile, m->count);
    *m = coarse;
    return TD_OK;
}

/* ---- the photo ---- */

/* Texels of the map's first cell begin here. */
static int64_t first_texel(double origin, const td_mosaic *m)
{
    return (int64_t)llround(origin / m->options.cell_m) * m->texels;
}

/* Whether the texel (column, row) of the map's rectangle shows what the map has there. */
static bool shown(const td_texel *t, const td_elevation *map, size_t cell)
{
    return t->seen && td_mosaic_agrees((double)t->height, map, cell);
}

typedef struct rectangle {
    int64_t x0, y0, columns, rows; /* of the map, in texels */
} rectangle;

/* Every texel that is shown: its place in the rectangle. */
typedef void visitor(void *user, int64_t column, int64_t row, const td_texel *texel);
static void visit(const td_mosaic *m, const td_elevation *map, const rectangle *r, visitor *seen, void *user)
{
    for (size_t i = 0; i < m->count; i++) {
        const int64_t x = (int64_t)m->tile[i].x * TD_MOSAIC_SIDE - r->x0,
                      y = (int64_t)m->tile[i].y * TD_MOSAIC_SIDE - r->y0;
        for (int k = 0; k < TD_MOSAIC_TEXELS; k++) {
            const int64_t column = x + k % TD_MOSAIC_SIDE, row = y + k / TD_MOSAIC_SIDE;
            if (column < 0 || column >= r->columns || row < 0 || row >= r->rows) continue;
            const size_t cell =
                (size_t)(row / m->texels) * (size_t)map->columns + (size_t)(column / m->texels);
            if (shown(&m->tile[i].texel[k], map, cell)) seen(user, column, row, &m->tile[i].texel[k]);
        }
    }
}

static void widen(void *user, int64_t column, int64_t row, const td_texel *texel)
{
    int64_t *box = user;
    (void)texel;
    if (column < box[0]) box[0] = column;
    if (column > box[1]) box[1] = column;
    if (row < box[2]) box[2] = row;
    if (row > box[3]) box[3] = row;
}

typedef struct painting {
    td_orthophoto *photo;
    int64_t column, row;
} painting;

static void paint(void *user, int64_t column, int64_t row, const td_texel *texel)
{
    const painting *p = user;
    uint8_t *to = p->photo->rgba +
                  4 * ((size_t)(row - p->row) * (size_t)p->photo->columns + (size_t)(column - p->column));
    memcpy(to, texel->rgb, sizeof texel->rgb);
    to[3] = 255;
}

td_status td_mosaic_photo(td_orthophoto **photo, const td_mosaic *m, const td_elevation *map, td_error *error)
{
    const int n = m->texels;
    const rectangle r = {first_texel(map->origin[0], m), first_texel(map->origin[1], m),
                         (int64_t)map->columns * n, (int64_t)map->rows * n};
    int64_t box[4] = {INT64_MAX, INT64_MIN, INT64_MAX, INT64_MIN};
    *photo = NULL;
    if (fabs(map->cell_m - m->options.cell_m) > 1e-9 * map->cell_m)
        return td_fail(error, TD_ERROR_ARGUMENT, "the map has cells of %g m, the orthophoto of %g m",
                       map->cell_m, m->options.cell_m);
    visit(m, map, &r, widen, box);
    if (box[1] < box[0]) return TD_OK;
    for (int i = 0; i < 2; i++) { /* whole cells */
        box[2 * i] = box[2 * i] / n * n;
        box[2 * i + 1] = box[2 * i + 1] / n * n + n - 1;
    }
    const int64_t columns = box[1] - box[0] + 1, rows = box[3] - box[2] + 1;
    const double texel = map->cell_m / n;
    const double origin[2] = {map->origin[0] - 0.5 * map->cell_m + ((double)box[0] + 0.5) * texel,
                              map->origin[1] - 0.5 * map->cell_m + ((double)box[2] + 0.5) * texel};
    if (columns * rows > TD_ORTHOPHOTO_MAX_TEXELS)
        return td_fail(error, TD_ERROR_DATA,
                       "an orthophoto of %lld x %lld texels is too large for one file: take fewer texels",
                       (long long)columns, (long long)rows);
    TD_TRY(td_orthophoto_new(photo, (int)columns, (int)rows, texel, origin, map->frame, map->crs, error));
    painting p = {*photo, box[0], box[2]};
    visit(m, map, &r, paint, &p);
    return TD_OK;
}
