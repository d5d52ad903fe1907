/* The state of a mosaic as bytes: a head; tiles by y, then x: x, y, number of seen texels, a bit for each
 * texel, the seen texels as they are; an end that tells a cut file. Every number is checked when read. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"
#include "recon/mosaic_internal.h"

static const char MAGIC[20] = "teledimos mosaic 1\n";
static const char END[8] = "the end\n";
enum { ORDER = 1, BITS = TD_MOSAIC_TEXELS / 8, FARTHEST_TILE = 1 << 27 };

typedef struct head {
    char magic[20];
    int32_t order;
    double cell_m;
    uint64_t memory_bytes, mark, tiles;
    int32_t asked, texels;
} head;

typedef struct tile_head {
    int32_t x, y;
    uint32_t seen, spare;
} tile_head;
enum { TILE_MOST_BYTES = sizeof(tile_head) + BITS + TD_MOSAIC_TEXELS * sizeof(td_texel) };

static size_t pack(unsigned char *bytes, const td_mosaic_tile *tile)
{
    tile_head h = {tile->x, tile->y, 0, 0};
    unsigned char *bits = bytes + sizeof h, *to = bits + BITS;
    memset(bits, 0, BITS);
    for (int i = 0; i < TD_MOSAIC_TEXELS; i++) {
        if (!tile->texel[i].seen) continue;
        bits[i / 8] = (unsigned char)(bits[i / 8] | 1 << i % 8);
        memcpy(to, &tile->texel[i], sizeof *tile->texel);
        to += sizeof *tile->texel;
        h.seen++;
    }
    memcpy(bytes, &h, sizeof h);
    return (size_t)(to - bytes);
}

typedef struct saving {
    const td_mosaic *mosaic;
    head head;
    size_t step; /* 0 head, then tiles, the end, nothing */
    unsigned char *bytes;
} saving;

static td_status next_part(const void **bytes, size_t *size, void *user, td_error *error)
{
    saving *s = user;
    const size_t step = s->step++, tiles = s->mosaic->count;
    (void)error;
    *bytes = NULL;
    *size = 0;
    if (step == 0) {
        *bytes = &s->head;
        *size = sizeof s->head;
    } else if (step <= tiles) {
        *bytes = s->bytes;
        *size = pack(s->bytes, &s->mosaic->tile[step - 1]);
    } else if (step == tiles + 1) {
        *bytes = END;
        *size = sizeof END;
    }
    return TD_OK;
}

td_status td_mosaic_save(const td_mosaic *m, uint64_t mark, const char *path, td_error *error)
{
    saving s = {.mosaic = m, .bytes = malloc(TILE_MOST_BYTES)};
    if (!s.bytes) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to save the orthophoto", path);
    memset(&s.head, 0, sizeof s.head); /* no byte is left to chance */
    memcpy(s.head.magic, MAGIC, sizeof MAGIC);
    s.head.order = ORDER;
    s.head.cell_m = m->options.cell_m;
    s.head.memory_bytes = m->options.memory_bytes;
    s.head.mark = mark;
    s.head.tiles = m->count;
    s.head.asked = m->options.texels;
    s.head.texels = m->texels;
    td_status status = td_file_write_parts(path, next_part, &s, error);
    free(s.bytes);
    return status;
}

/* ---- load ---- */

static td_status damaged(const char *name, const char *what, td_error *error)
{
    return td_fail(error, TD_ERROR_FORMAT,
                   "%s: %s: it is damaged or not an orthophoto's state; start the map anew", name, what);
}

static td_status read_head(head *h, const td_mosaic_options *o, uint64_t mark, FILE *file, const char *name,
                           td_error *error)
{
    if (fread(h, sizeof *h, 1, file) != 1 || memcmp(h->magic, MAGIC, sizeof MAGIC) != 0 || h->order != ORDER)
        return damaged(name, "its beginning is wrong", error);
    if (h->cell_m != o->cell_m || h->asked != o->texels || h->memory_bytes != o->memory_bytes)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: was made with %d texels in cells of %g m, now it is %d in %g m: give the same "
                       "options, or start the map anew",
                       name, h->asked, h->cell_m, o->texels, o->cell_m);
    if (h->mark != mark)
        return td_fail(error, TD_ERROR_DATA, "%s: belongs to another state of the map; start the map anew",
                       name);
    const bool size = h->texels == 1 || h->texels == 2 || h->texels == 4 || h->texels == 8;
    return size && h->texels <= h->asked ? TD_OK : damaged(name, "its head holds impossible numbers", error);
}

static bool sound(const td_texel *t)
{
    return t->seen == 1 && isfinite(t->height) && t->pixel > 0 && isfinite(t->pixel);
}

static bool read_tile(td_mosaic *m, FILE *file)
{
    tile_head h;
    unsigned char bits[BITS];
    uint32_t seen = 0;
    if (fread(&h, sizeof h, 1, file) != 1 || fread(bits, sizeof bits, 1, file) != 1) return false;
    if (h.x < -FARTHEST_TILE || h.x > FARTHEST_TILE || h.y < -FARTHEST_TILE || h.y > FARTHEST_TILE || h.spare)
        return false;
    const td_mosaic_tile *last = m->count ? &m->tile[m->count - 1] : NULL;
    if (last && (h.y < last->y || (h.y == last->y && h.x <= last->x))) return false;
    td_texel *texel = td_mosaic_tile_at(m, h.x, h.y);
    for (int i = 0; texel && i < TD_MOSAIC_TEXELS; i++) {
        if (!(bits[i / 8] >> i % 8 & 1)) continue;
        if (fread(&texel[i], sizeof *texel, 1, file) != 1 || !sound(&texel[i])) return false;
        seen++;
    }
    return texel && seen == h.seen;
}

static td_status load(td_mosaic *m, uint64_t mark, FILE *file, const char *name, td_error *error)
{
    head h;
    char end[sizeof END + 1];
    TD_TRY(read_head(&h, &m->options, mark, file, name, error));
    m->texels = h.texels;
    for (uint64_t i = 0; i < h.tiles; i++)
        if (!read_tile(m, file)) return damaged(name, "a tile holds impossible numbers", error);
    if (fread(end, 1, sizeof end, file) != sizeof END || memcmp(end, END, sizeof END) != 0)
        return damaged(name, "its end is wrong", error);
    return TD_OK;
}

td_status td_mosaic_load(td_mosaic **mosaic, const td_mosaic_options *options, uint64_t mark,
                         const char *path, td_error *error)
{
    FILE *file = NULL;
    TD_TRY(td_mosaic_new(mosaic, options, error));
    td_status status = td_file_stream(&file, path, error);
    if (status == TD_OK) status = load(*mosaic, mark, file, path, error);
    if (file) fclose(file);
    if (status != TD_OK) td_mosaic_free(mosaic);
    return status;
}
