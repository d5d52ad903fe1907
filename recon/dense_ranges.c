/* Which disparities each tile searches: all, or those about what was found in images of half the size. */
#include <stdlib.h>

#include "recon/dense_internal.h"

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

enum {
    AROUND = 8, /* px of the small map about the tile that count too */
    MARGIN = 4, /* levels that are searched beyond what was found */
    ALIGNED = 16
};

static int tiles_of(int size)
{
    return (size + DENSE_TILE - 1) / DENSE_TILE;
}

td_status dense_ranges_full(dense_range **ranges, int width, int height, int levels)
{
    size_t n = (size_t)tiles_of(width) * (size_t)tiles_of(height);
    *ranges = malloc(n * sizeof **ranges);
    if (!*ranges) return TD_ERROR_MEMORY;
    int end = (levels + DENSE_LANES - 1) / DENSE_LANES * DENSE_LANES;
    for (size_t k = 0; k < n; k++) (*ranges)[k] = (dense_range){0, (uint16_t)end};
    return TD_OK;
}

static dense_range tile_range(const dense_map *small, int tile_x, int tile_y, int shift, int levels)
{
    enum { HALF = DENSE_TILE / 2 };
    int x0 = MIN(MAX(tile_x * HALF - AROUND, 0), small->width - 1);
    int y0 = MIN(MAX(tile_y * HALF - AROUND, 0), small->height - 1);
    int x1 = MIN((tile_x + 1) * HALF + AROUND, small->width);
    int y1 = MIN((tile_y + 1) * HALF + AROUND, small->height);
    int least = INT16_MAX, most = 0;
    for (int y = y0; y < y1; y++)
        for (int x = x0; x < x1; x++) {
            int d = small->disparity[(size_t)y * (size_t)small->width + (size_t)x];
            least = MIN(least, d), most = MAX(most, d);
        }
    int first = MIN(MAX(2 * least / DENSE_ONE + shift - MARGIN, 0), levels - 1) / ALIGNED * ALIGNED;
    int last = MIN(MAX(2 * most / DENSE_ONE + shift + MARGIN + 1, first), levels - 1);
    int vectors = (last - first) / DENSE_LANES + 1;
    return (dense_range){(uint16_t)first, (uint16_t)(first + vectors * DENSE_LANES)};
}

/* `small` has no holes; `shift` is what a disparity of twice its lowest counts from the lowest here. */
td_status dense_ranges_about(dense_range **ranges, const dense_map *small, int width, int height, int shift,
                             int levels)
{
    int columns = tiles_of(width), rows = tiles_of(height);
    *ranges = malloc((size_t)columns * (size_t)rows * sizeof **ranges);
    if (!*ranges) return TD_ERROR_MEMORY;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++)
            (*ranges)[(size_t)y * (size_t)columns + (size_t)x] = tile_range(small, x, y, shift, levels);
    return TD_OK;
}
