/* The state of a map as bytes.
 *
 *   head    "teledimos fusion 2\n", an int32 1 (the order of bytes), what of the options must be the same,
 *           frames, place and its pose, the length of the coordinate reference system, the number of tiles
 *   crs
 *   tiles   by y, then x: x, y, base, number of known cells; a bit for each cell; the known cells as they are
 *   end     the same eight bytes in every file, so that a cut one is told
 *
 * Every number is checked when read: the file may be anybody's. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/file.h"
#include "recon/fusion_internal.h"

static const char MAGIC[20] = "teledimos fusion 2\n";
static const char END[8] = "the end\n";
enum { ORDER = 1, MOST_CRS = 65536, FARTHEST_TILE = 1 << 23 };

typedef struct head {
    char magic[20];
    int32_t order;
    double cell_m, region[4], gate_sigma, correlation_px, repeat_share, elsewhere_share, place_m;
    char frame[TD_NAME_SIZE];
    uint64_t frames, tiles;
    double place_q[4], place_t[3];
    int32_t believe_frames;
    uint32_t place, crs_size, spare;
} head;

/* ---- tiles ---- */

typedef struct tile_head {
    int32_t x, y;
    double base;
    uint32_t known, spare;
} tile_head;
_Static_assert(sizeof(tile_head) == TD_TILE_HEAD_BYTES, "a tile's head is stored as it is");

size_t td_tile_pack(unsigned char *bytes, const td_tile *tile, const td_cell *cell)
{
    tile_head h = {tile->x, tile->y, tile->base, 0, 0};
    unsigned char *map = bytes + TD_TILE_HEAD_BYTES, *to = map + TD_TILE_MAP_BYTES;
    memset(map, 0, TD_TILE_MAP_BYTES);
    for (int i = 0; i < TD_TILE_CELLS; i++) {
        if (cell[i].provenance == TD_CELL_UNKNOWN) continue;
        map[i / 8] = (unsigned char)(map[i / 8] | 1 << i % 8);
        memcpy(to, &cell[i], sizeof *cell);
        to += sizeof *cell;
        h.known++;
    }
    memcpy(bytes, &h, sizeof h);
    return (size_t)(to - bytes);
}

bool td_tile_unpack(td_tile *tile, td_cell *cell, FILE *file, const td_fusion_options *options)
{
    tile_head h;
    unsigned char map[TD_TILE_MAP_BYTES];
    uint32_t known = 0;
    if (fread(&h, sizeof h, 1, file) != 1 || fread(map, sizeof map, 1, file) != 1) return false;
    if (h.x < -FARTHEST_TILE || h.x > FARTHEST_TILE || h.y < -FARTHEST_TILE || h.y > FARTHEST_TILE ||
        !(fabs(h.base) < 1e9) || h.spare)
        return false;
    memset(cell, 0, TD_TILE_CELLS * sizeof *cell);
    for (int i = 0; i < TD_TILE_CELLS; i++) {
        if (!(map[i / 8] >> i % 8 & 1)) continue;
        if (fread(&cell[i], sizeof *cell, 1, file) != 1 || !td_cell_sound(&cell[i], options)) return false;
        known++;
    }
    tile->x = h.x;
    tile->y = h.y;
    tile->base = h.base;
    return known == h.known;
}

/* ---- save ---- */

static head head_of(const td_fusion *f)
{
    const td_fusion_options *o = &f->options;
    head h;
    memset(&h, 0, sizeof h); /* no byte is left to chance */
    memcpy(h.magic, MAGIC, sizeof MAGIC);
    h.order = ORDER;
    h.cell_m = o->cell_m;
    memcpy(h.region, o->region, sizeof h.region);
    h.gate_sigma = o->gate_sigma;
    h.correlation_px = o->correlation_px;
    h.repeat_share = o->repeat_share;
    h.elsewhere_share = o->elsewhere_share;
    h.place_m = o->place_m;
    h.believe_frames = o->believe_frames;
    snprintf(h.frame, sizeof h.frame, "%s", o->frame);
    h.frames = f->frames;
    h.tiles = f->tile_count;
    memcpy(h.place_q, f->place_pose.q, sizeof h.place_q);
    memcpy(h.place_t, f->place_pose.t, sizeof h.place_t);
    h.place = f->place;
    h.crs_size = f->crs ? (uint32_t)strlen(f->crs) : 0;
    return h;
}

/* The file piece after piece. */
typedef struct saving {
    const td_fusion *fusion;
    head head;
    size_t step; /* 0 head, 1 crs, then tiles, the end, nothing */
    unsigned char *bytes;
    td_cell *scratch;
} saving;

static td_status next_part(const void **bytes, size_t *size, void *user, td_error *error)
{
    saving *s = user;
    const size_t step = s->step++, tiles = s->fusion->tile_count;
    *bytes = NULL;
    *size = 0;
    if (step == 1 && s->head.crs_size == 0) return next_part(bytes, size, user, error);
    if (step == 0) {
        *bytes = &s->head;
        *size = sizeof s->head;
    } else if (step == 1) {
        *bytes = s->fusion->crs;
        *size = s->head.crs_size;
    } else if (step - 2 < tiles) {
        const td_cell *cell;
        const td_tile *tile = s->fusion->tile[step - 2];
        TD_TRY(td_tiles_peek(&cell, s->scratch, s->fusion, tile, error));
        *bytes = s->bytes;
        *size = td_tile_pack(s->bytes, tile, cell);
    } else if (step - 2 == tiles) {
        *bytes = END;
        *size = sizeof END;
    }
    return TD_OK;
}

td_status td_fusion_save(const td_fusion *fusion, const char *path, td_error *error)
{
    saving s = {.fusion = fusion, .head = head_of(fusion)};
    s.bytes = malloc(TD_TILE_MOST_BYTES);
    s.scratch = malloc(TD_TILE_CELLS * sizeof *s.scratch);
    td_status status = s.bytes && s.scratch
                           ? td_file_write_parts(path, next_part, &s, error)
                           : td_fail(error, TD_ERROR_MEMORY, "%s: no memory to save the map", path);
    free(s.bytes);
    free(s.scratch);
    return status;
}

/* ---- load ---- */

static td_status damaged(const char *name, const char *what, td_error *error)
{
    return td_fail(error, TD_ERROR_FORMAT, "%s: %s: it is damaged or not a map's state; start the map anew",
                   name, what);
}

static td_status differs(const char *name, const char *field, double there, double here, td_error *error)
{
    return td_fail(error, TD_ERROR_DATA,
                   "%s: was made with %s %g, now it is %g: give the same options, or start the map anew",
                   name, field, there, here);
}

static td_status check_same(const head *h, const td_fusion_options *o, const char *name, td_error *error)
{
    const struct {
        const char *name;
        double there, here;
    } field[] = {{"cell_m", h->cell_m, o->cell_m},
                 {"region x_min", h->region[0], o->region[0]},
                 {"region y_min", h->region[1], o->region[1]},
                 {"region x_max", h->region[2], o->region[2]},
                 {"region y_max", h->region[3], o->region[3]},
                 {"gate_sigma", h->gate_sigma, o->gate_sigma},
                 {"believe_frames", h->believe_frames, o->believe_frames},
                 {"correlation_px", h->correlation_px, o->correlation_px},
                 {"repeat_share", h->repeat_share, o->repeat_share},
                 {"elsewhere_share", h->elsewhere_share, o->elsewhere_share},
                 {"place_m", h->place_m, o->place_m}};
    for (size_t i = 0; i < sizeof field / sizeof *field; i++)
        if (!(field[i].there == field[i].here))
            return differs(name, field[i].name, field[i].there, field[i].here, error);
    if (memcmp(h->frame, o->frame, strlen(o->frame) + 1) != 0)
        return td_fail(error, TD_ERROR_DATA, "%s: was made in another frame than '%s'", name, o->frame);
    return TD_OK;
}

static td_status read_head(td_fusion *f, head *h, FILE *file, const char *name, td_error *error)
{
    double norm = 0;
    if (fread(h, sizeof *h, 1, file) != 1 || memcmp(h->magic, MAGIC, sizeof MAGIC) != 0 || h->order != ORDER)
        return damaged(name, "its beginning is wrong", error);
    TD_TRY(check_same(h, &f->options, name, error));
    for (int i = 0; i < 4; i++) norm += h->place_q[i] * h->place_q[i];
    bool fine = h->crs_size <= MOST_CRS && h->spare == 0 && h->tiles <= (uint64_t)1 << 32 &&
                (h->place == 0 || fabs(norm - 1) < 1e-6);
    for (int i = 0; i < 3; i++) fine &= fabs(h->place_t[i]) < 1e12;
    if (!fine) return damaged(name, "its head holds impossible numbers", error);
    memcpy(f->place_pose.q, h->place_q, sizeof h->place_q);
    memcpy(f->place_pose.t, h->place_t, sizeof h->place_t);
    f->place = h->place;
    f->frames = h->frames;
    if (h->crs_size == 0) return TD_OK;
    f->crs = calloc(h->crs_size + 1, 1);
    if (!f->crs) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory to load it", name);
    if (fread(f->crs, h->crs_size, 1, file) != 1 || strlen(f->crs) != h->crs_size)
        return damaged(name, "its coordinate reference system is wrong", error);
    return TD_OK;
}

static td_status read_tiles(td_fusion *f, uint64_t count, FILE *file, const char *name, td_cell *scratch,
                            td_error *error)
{
    char end[sizeof END];
    for (uint64_t i = 0; i < count; i++) {
        td_tile read = {0}, *tile;
        if (!td_tile_unpack(&read, scratch, file, &f->options))
            return damaged(name, "a tile is wrong", error);
        const td_tile *last = f->tile_count ? f->tile[f->tile_count - 1] : NULL;
        if (last && (read.y < last->y || (read.y == last->y && read.x <= last->x)))
            return damaged(name, "its tiles are out of order", error);
        TD_TRY(td_tiles_check_room(f, 1, error));
        TD_TRY(td_tiles_make(&tile, f, read.x, read.y, read.base, error));
        TD_TRY(td_tiles_fetch(f, &tile, 1, error));
        memcpy(tile->cell, scratch, TD_TILE_CELLS * sizeof *scratch);
    }
    if (fread(end, sizeof end, 1, file) != 1 || memcmp(end, END, sizeof end) != 0 || fgetc(file) != EOF)
        return damaged(name, "its end is wrong", error);
    return TD_OK;
}

td_status td_fusion_load_stream(td_fusion **fusion, const td_fusion_options *options, FILE *file,
                                const char *name, td_error *error)
{
    head h;
    TD_TRY(td_fusion_new(fusion, options, error));
    td_cell *scratch = malloc(TD_TILE_CELLS * sizeof *scratch);
    td_status status = scratch ? read_head(*fusion, &h, file, name, error)
                               : td_fail(error, TD_ERROR_MEMORY, "%s: no memory to load it", name);
    if (status == TD_OK) status = read_tiles(*fusion, h.tiles, file, name, scratch, error);
    free(scratch);
    if (status != TD_OK) td_fusion_free(fusion);
    return status;
}

td_status td_fusion_load(td_fusion **fusion, const td_fusion_options *options, const char *path,
                         td_error *error)
{
    FILE *file = NULL;
    *fusion = NULL;
    TD_TRY(td_file_stream(&file, path, error));
    td_status status = td_fusion_load_stream(fusion, options, file, path, error);
    fclose(file);
    return status;
}
