/* Tiles in memory, and beyond the limit in a folder. What is in which place is nobody else's business:
 * results do not depend on it. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/file.h"
#include "recon/fusion_internal.h"

static const size_t TILE_BYTES = TD_TILE_CELLS * sizeof(td_cell);

/* Index of the first tile that is not before (x, y). */
static size_t place_of(const td_fusion *f, int32_t x, int32_t y)
{
    size_t low = 0, high = f->tile_count;
    while (low < high) {
        const size_t middle = (low + high) / 2;
        const td_tile *t = f->tile[middle];
        if (t->y < y || (t->y == y && t->x < x))
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

td_tile *td_tiles_find(const td_fusion *f, int32_t x, int32_t y)
{
    const size_t i = place_of(f, x, y);
    return i < f->tile_count && f->tile[i]->x == x && f->tile[i]->y == y ? f->tile[i] : NULL;
}

td_status td_tiles_make(td_tile **tile, td_fusion *f, int32_t x, int32_t y, double base, td_error *error)
{
    *tile = td_tiles_find(f, x, y);
    if (*tile) return TD_OK;
    if (f->tile_count == f->tile_room) {
        const size_t room = f->tile_room ? 2 * f->tile_room : 64;
        td_tile **larger = realloc(f->tile, room * sizeof(td_tile *));
        if (!larger) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu tiles", room);
        f->tile = larger;
        f->tile_room = room;
    }
    td_tile *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for a tile");
    made->x = x;
    made->y = y;
    made->base = base;
    const size_t i = place_of(f, x, y);
    memmove(f->tile + i + 1, f->tile + i, (f->tile_count - i) * sizeof(td_tile *));
    f->tile[i] = made;
    f->tile_count++;
    *tile = made;
    return TD_OK;
}

td_status td_tiles_check_room(const td_fusion *f, size_t more, td_error *error)
{
    if (f->options.folder || f->tile_count + more <= f->capacity) return TD_OK;
    return td_fail(
        error, TD_ERROR_DATA,
        "the map needs %zu tiles, memory_bytes = %zu holds %zu: give a folder for the others, more "
        "memory or larger cells",
        f->tile_count + more, f->options.memory_bytes, f->capacity);
}

/* ---- the folder ---- */

static char *path_of(const td_fusion *f, const td_tile *tile)
{
    char name[64];
    snprintf(name, sizeof name, "tile_%ld_%ld", (long)tile->x, (long)tile->y);
    return td_path_join(f->options.folder, name);
}

/* Only this process reads it again: no need to last, so no fsync. */
static td_status store(td_fusion *f, td_tile *tile, td_error *error)
{
    unsigned char *bytes = malloc(TD_TILE_MOST_BYTES);
    char *path = path_of(f, tile);
    td_status status = TD_OK;
    if (!bytes || !path) {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory to store a tile");
    } else {
        const size_t size = td_tile_pack(bytes, tile, tile->cell);
        FILE *file = fopen(path, "wb");
        bool fine = file && fwrite(bytes, 1, size, file) == size;
        int cause = errno;
        if (file && fclose(file) != 0 && fine) fine = false, cause = errno;
        if (!fine)
            status = td_fail(error, TD_ERROR_IO, "%s: cannot be written: %s%s", path, strerror(cause),
                             cause == ENOSPC ? "; free some space and run again" : "");
    }
    tile->stored = status == TD_OK;
    free(bytes);
    free(path);
    return status;
}

static td_status restore(td_cell *cell, const td_fusion *f, const td_tile *tile, td_error *error)
{
    td_tile read = {0};
    memset(cell, 0, TILE_BYTES);
    if (!tile->stored) return TD_OK; /* just made */
    char *path = path_of(f, tile);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for the name of a tile");
    td_status status = TD_OK;
    FILE *file = fopen(path, "rb");
    if (!file) {
        status = td_fail(error, TD_ERROR_IO, "%s: cannot be opened: %s", path, strerror(errno));
    } else if (!td_tile_unpack(&read, cell, file, &f->options) || read.x != tile->x || read.y != tile->y) {
        status =
            td_fail(error, TD_ERROR_FORMAT,
                    "%s: is not the tile that was stored there: give each map a folder of its own", path);
    }
    if (file) fclose(file);
    free(path);
    return status;
}

/* ---- in and out ---- */

/* The tile longest unused among those that have no part in the present fetch. */
static td_tile *oldest(const td_fusion *f, uint64_t present)
{
    td_tile *best = NULL;
    for (size_t i = 0; i < f->tile_count; i++) {
        td_tile *t = f->tile[i];
        if (t->cell && t->used != present && (!best || t->used < best->used)) best = t;
    }
    return best;
}

static td_status bring_in(td_fusion *f, td_tile *tile, uint64_t present, td_error *error)
{
    td_cell *room = NULL;
    if (f->resident >= f->capacity) {
        if (!f->options.folder) return td_tiles_check_room(f, 0, error);
        td_tile *out = oldest(f, present); /* there is one: a fetch is no larger than the capacity */
        TD_TRY(store(f, out, error));
        room = out->cell;
        out->cell = NULL;
    } else {
        room = malloc(TILE_BYTES);
        if (!room) return td_fail(error, TD_ERROR_MEMORY, "no memory for a tile of %zu bytes", TILE_BYTES);
        f->resident++;
    }
    td_status status = restore(room, f, tile, error);
    if (status != TD_OK) {
        free(room);
        f->resident--;
        return status;
    }
    tile->cell = room;
    return TD_OK;
}

td_status td_tiles_fetch(td_fusion *f, td_tile *const *tile, size_t count, td_error *error)
{
    const uint64_t present = ++f->clock;
    for (size_t i = 0; i < count; i++) tile[i]->used = present;
    for (size_t i = 0; i < count; i++)
        if (!tile[i]->cell) TD_TRY(bring_in(f, tile[i], present, error));
    return TD_OK;
}

td_status td_tiles_peek(const td_cell **cell, td_cell *scratch, const td_fusion *f, const td_tile *tile,
                        td_error *error)
{
    *cell = tile->cell ? tile->cell : scratch;
    return tile->cell ? TD_OK : restore(scratch, f, tile, error);
}

void td_tiles_free(td_fusion *f)
{
    for (size_t i = 0; i < f->tile_count; i++) {
        td_tile *t = f->tile[i];
        char *path = t->stored ? path_of(f, t) : NULL;
        if (path) unlink(path);
        free(path);
        free(t->cell);
        free(t);
    }
    free(f->tile);
    f->tile = NULL;
    f->tile_count = 0;
}
