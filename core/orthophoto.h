/* A picture of a site as seen straight from above, texel by texel.
 *
 * Texel (column c, row r) is the square around x = origin[0] + c texel_m, y = origin[1] + r texel_m of the
 * frame named `frame`: rows go to the left of a vehicle, or north, as in an elevation map. */
#ifndef TELEDIMOS_CORE_ORTHOPHOTO_H
#define TELEDIMOS_CORE_ORTHOPHOTO_H

#include <stdint.h>

#include "image.h"
#include "rig.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_orthophoto {
    int columns, rows;
    double texel_m, origin[2];
    char frame[TD_NAME_SIZE];
    char *crs;     /* as GDAL takes it; NULL: none */
    uint8_t *rgba; /* (rows, columns, 4) red, green, blue, and 255 where seen, 0 where not */
} td_orthophoto;

enum { TD_ORTHOPHOTO_MAX_TEXELS = 1 << 28 };

/* Nothing seen yet. Refuses sizes below 1 or above TD_ORTHOPHOTO_MAX_TEXELS together. `crs` may be NULL. */
TD_API td_status td_orthophoto_new(td_orthophoto **photo, int columns, int rows, double texel_m,
                                   const double origin[2], const char *frame, const char *crs,
                                   td_error *error);
TD_API void td_orthophoto_free(td_orthophoto **photo);

/* Cloud-optimised GeoTIFF of four bytes a texel, north up, whole or not at all. */
TD_API td_status td_orthophoto_write(const td_orthophoto *photo, const char *path, td_error *error);

/* North up; what was not seen is grey `unseen`. */
TD_API td_status td_orthophoto_image(td_image **image, const td_orthophoto *photo, uint8_t unseen,
                                     td_error *error);

#ifdef __cplusplus
}
#endif
#endif
