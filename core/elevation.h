/* An elevation map: a height for each square cell of a grid, how sure it is and where it comes from.
 *
 * Cell (column c, row r) stands for the square around x = origin[0] + c cell_m, y = origin[1] + r cell_m of
 * the frame named `frame` (z up): rows go to the left of a vehicle, or north. Arrays are (rows, columns),
 * row-major. A cell without a height is NaN there, 0 in `count`, and TD_CELL_UNKNOWN.
 *
 * File: cloud-optimised GeoTIFF, north up, with five bands told by their descriptions (height, sigma, count,
 * provenance, time; all double, as a TIFF has one type for all; nodata NaN), through GDAL, which is opened
 * only when a map is read or written (libteledimos_core_raster). */
#ifndef TELEDIMOS_CORE_ELEVATION_H
#define TELEDIMOS_CORE_ELEVATION_H

#include <stddef.h>
#include <stdint.h>

#include "rig.h"
#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_provenance {
    TD_CELL_UNKNOWN,
    TD_CELL_PRIOR,    /* from a map that was given */
    TD_CELL_MEASURED, /* by one frame */
    TD_CELL_FUSED,    /* by several */
    TD_CELL_FILLED,   /* interpolated from its neighbours */
    TD_CELL_SIMULATED /* moved by a simulation: nobody has seen it */
} td_provenance;

typedef struct td_elevation {
    int columns, rows;
    double cell_m, origin[2];
    char frame[TD_NAME_SIZE]; /* "vehicle", "site", … */
    char *crs;           /* coordinate reference system as GDAL takes it (WKT, "EPSG:32632"); NULL: none */
    float *height;       /* m */
    float *sigma;        /* m, standard deviation of the height; NaN: not known */
    uint32_t *count;     /* measurements in it */
    uint8_t *provenance; /* td_provenance */
    double *time_s;      /* of the last measurement; NaN */
} td_elevation;

enum { TD_ELEVATION_MAX_CELLS = 1 << 28 };

/* All cells unknown. Refuses sizes below 1 or above TD_ELEVATION_MAX_CELLS together, and cells of no size. */
TD_API td_status td_elevation_new(td_elevation **map, int columns, int rows, double cell_m,
                                  const double origin[2], const char *frame, td_error *error);
TD_API td_status td_elevation_copy(td_elevation **copy, const td_elevation *map, td_error *error);
TD_API void td_elevation_free(td_elevation **map);

/* Height at (x, y), bilinear between the four cells around; NaN beside an unknown cell and outside the
 * rectangle of the cells' centres. `sigma` (may be NULL) is the largest of the four, NaN when one is not
 * known. */
TD_API double td_elevation_at(const td_elevation *map, double x, double y, double *sigma);

/* GeoTIFF, whole or not at all. A foreign GeoTIFF of one band is a height map whose sigma is unknown; its
 * nodata value and NaN are unknown cells. Refused, naming it: rotated or sheared grids, cells that are not
 * square, coordinates in degrees or feet, sizes too large, damaged files. */
TD_API td_status td_elevation_read(td_elevation **map, const char *path, td_error *error);
/* How many cells a file has, without reading them. */
TD_API td_status td_elevation_size(int *columns, int *rows, const char *path, td_error *error);
TD_API td_status td_elevation_write(const td_elevation *map, const char *path, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
