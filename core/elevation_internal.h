/* What the rooms that read and write rasters share with the module behind GDAL. */
#ifndef TELEDIMOS_CORE_ELEVATION_INTERNAL_H
#define TELEDIMOS_CORE_ELEVATION_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/status.h"

/* The module: what it needs of GDAL, whose libraries take 0.2 s to load. It is opened when asked for and
 * stays. Reasons are texts of the module. */
#define TD_RASTER_MODULE "libteledimos_core_raster.so"
#define TD_RASTER_FUNCTION "td_raster_module_get"

enum { TD_RASTER_REASON_SIZE = 512 };

typedef struct td_raster_info {
    int columns, rows, bands;
    bool has_transform;
    double transform[6]; /* GDAL's: x = t0 + t1 column + t2 row, y = t3 + t4 column + t5 row, of corners */
    const char *crs;     /* "EPSG:32632" or WKT; NULL: none. Reading: lent until close */
    bool degrees;        /* reading: coordinates are angles */
    double unit_m;       /* reading: of the coordinates; 1 without a crs */
    bool rgba;           /* writing: red, green, blue, alpha as bytes, instead of bands of doubles */
} td_raster_info;

/* False with a reason: failed. Rows are the file's: the first is at the top. Bands count from 1. */
typedef struct td_raster_module {
    /* A GeoTIFF that is there. */
    bool (*open)(void **raster, td_raster_info *info, const char *path, char reason[TD_RASTER_REASON_SIZE]);
    /* The band described so; 0: none. */
    int (*find)(void *raster, const char *description);
    /* Of the file, lent until close; NULL: none. */
    const char *(*note)(void *raster, const char *key);
    /* Scale and offset applied, NaN where masked or nodata. */
    bool (*read_row)(double *value, void *raster, int band, int row, char reason[TD_RASTER_REASON_SIZE]);
    void (*close)(void *raster);

    /* In memory; doubles have nodata NaN. */
    bool (*create)(void **raster, const td_raster_info *info, char reason[TD_RASTER_REASON_SIZE]);
    bool (*set_note)(void *raster, const char *key, const char *value);
    bool (*set_band)(void *raster, int band, const char *description, const char *unit);
    bool (*write_row)(const double *value, void *raster, int band, int row,
                      char reason[TD_RASTER_REASON_SIZE]);
    /* As cloud-optimised GeoTIFF; *bytes to be freed with free_bytes. */
    bool (*encode)(unsigned char **bytes, size_t *size, void *raster, char reason[TD_RASTER_REASON_SIZE]);
    void (*free_bytes)(unsigned char *bytes);

    /* A coordinate reference system as WKT (OGC 01-009), to be freed with free_bytes; `degrees` and `unit_m`
     * of the info. */
    bool (*reference)(unsigned char **wkt, td_raster_info *info, const char *crs,
                      char reason[TD_RASTER_REASON_SIZE]);
} td_raster_module;

typedef const td_raster_module *td_raster_module_get_function(void);

/* raster.c: the module; `path` is for the message. */
td_status td_raster_load(const td_raster_module **module, const char *path, td_error *error);
/* A north-up GeoTIFF, written whole or not at all. notes: what is said besides; row: values of a band, y
 * counted from the southernmost. */
td_status td_raster_write(const char *path, const td_raster_info *info, const void *data,
                          bool (*notes)(const td_raster_module *module, void *raster, const void *data),
                          void (*row)(double *value, const void *data, int band, int y), td_error *error);
/* Of a grid of square cells with its first, south-west, centre at origin. */
void td_raster_place(double transform[6], const double origin[2], double cell_m, int rows);

#endif
