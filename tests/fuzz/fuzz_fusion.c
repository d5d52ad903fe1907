/* Any bytes as the state of a map: refused with a sentence, or loaded, and then every cell is one that the
 * filter can come to: a map can be made of it and a frame added. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "recon/fusion.h"
#include "recon/fusion_internal.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    td_fusion *fusion = NULL;
    td_elevation *map = NULL;
    td_error error = {TD_OK, ""};
    td_fusion_options options = td_fusion_options_default();
    options.cell_m = 0.2;
    options.memory_bytes = (size_t)16 << 20;
    if (size == 0) return 0;
    FILE *file = fmemopen((void *)(uintptr_t)data, size, "rb");
    if (!file) return 0;
    const td_status status = td_fusion_load_stream(&fusion, &options, file, "input", &error);
    fclose(file);
    if ((status == TD_OK) != (fusion != NULL)) abort();
    if (status == TD_ERROR_FORMAT && strncmp(error.message, "input: ", 7) != 0) abort();
    if (fusion && fusion->tile_count) {
        const td_tile *tile = fusion->tile[0];
        const double x = tile->x * 128 * 0.2, y = tile->y * 128 * 0.2, region[4] = {x, y, x + 25, y + 25};
        if (td_fusion_map_of(&map, NULL, fusion, region, NULL) == TD_OK)
            for (int i = 0; i < map->columns * map->rows; i++)
                if (map->provenance[i] != TD_CELL_UNKNOWN && !(map->sigma[i] >= 0)) abort();
    }
    td_elevation_free(&map);
    td_fusion_free(&fusion);
    return 0;
}
