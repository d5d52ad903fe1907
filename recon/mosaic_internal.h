/* What the files of the mosaic share. */
#ifndef TELEDIMOS_RECON_MOSAIC_INTERNAL_H
#define TELEDIMOS_RECON_MOSAIC_INTERNAL_H

#include <stdbool.h>

#include "mosaic.h"

enum { TD_MOSAIC_SIDE = 128, TD_MOSAIC_TEXELS = TD_MOSAIC_SIDE * TD_MOSAIC_SIDE };

/* All zero: not seen. */
typedef struct td_texel {
    float height; /* m, of what was seen */
    float pixel;  /* m, longer side of the pixel on level ground */
    uint8_t rgb[3];
    uint8_t seen; /* 1 */
} td_texel;
_Static_assert(sizeof(td_texel) == 12, "texels are stored as they are");

typedef struct td_mosaic_tile {
    int32_t x, y;    /* texels x … x + 127 times 128; texel (0, 0) begins at the edge of cell (0, 0) */
    td_texel *texel; /* (128,128), rows in y */
} td_mosaic_tile;

struct td_mosaic {
    td_mosaic_options options;
    int texels;           /* along a cell's side now */
    td_mosaic_tile *tile; /* (count), by y, then x */
    size_t count, room;
};

/* Made when it is not there; NULL: no memory. */
td_texel *td_mosaic_tile_at(td_mosaic *mosaic, int32_t x, int32_t y);
/* Texels twice as large: the mean colour of the four, the best one's height. */
td_status td_mosaic_halve(td_mosaic *mosaic, td_error *error);
/* Whether something at `height` is what the map has in the cell. False of an unknown one. */
bool td_mosaic_agrees(double height, const td_elevation *map, size_t cell);

#endif
