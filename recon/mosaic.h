/* The colours of a site as its frames see them: an orthophoto put together texel by texel.
 *
 * Each frame's disparities are joined to a surface, pixel to neighbouring pixel where they differ by less
 * than 1 px (where they differ by more, one camera does not see what lies between), and each texel under it
 * gets the left image's colour there: so a pixel colours a texel only where its own disparity lies, and what
 * stands in front paints nothing behind it. A view counts only if its height agrees with the map's cell
 * (within a cell's side plus 3 sigma): what the map does not believe is not shown. Of those that agree, the
 * one with the smallest pixel on the ground stays; of the same size, the first. One whose ground has changed
 * gives way to any that agrees.
 *
 * No colour is blended: a seam shows where two frames meet whose exposures differ. */
#ifndef TELEDIMOS_RECON_MOSAIC_H
#define TELEDIMOS_RECON_MOSAIC_H

#include "../core/orthophoto.h"
#include "fusion.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_mosaic_options {
    double cell_m;       /* of the map */
    int texels;          /* along a cell's side: 1, 2, 4 (default) or 8 */
    size_t memory_bytes; /* default 512 MiB: above, texels become twice as large, down to 1 a cell */
} td_mosaic_options;
TD_API td_mosaic_options td_mosaic_options_default(void);

typedef struct td_mosaic td_mosaic;
TD_API td_status td_mosaic_new(td_mosaic **mosaic, const td_mosaic_options *options, td_error *error);
TD_API void td_mosaic_free(td_mosaic **mosaic);

/* A frame that the map has just taken; `left` is its rectified left image, grey or colour. */
TD_API td_status td_mosaic_add(td_mosaic *mosaic, const td_fusion *fusion, const td_fusion_frame *frame,
                               const td_image *left, td_error *error);

/* What agrees with `map`, over the cells that have any. NULL without a failure: none has. */
TD_API td_status td_mosaic_photo(td_orthophoto **photo, const td_mosaic *mosaic, const td_elevation *map,
                                 td_error *error);

/* The whole state in one file, whole or not at all. `mark` says what it belongs to (frames done): loading
 * refuses another, other options, and damaged files. */
TD_API td_status td_mosaic_save(const td_mosaic *mosaic, uint64_t mark, const char *path, td_error *error);
TD_API td_status td_mosaic_load(td_mosaic **mosaic, const td_mosaic_options *options, uint64_t mark,
                                const char *path, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
