/* The wall around GDAL: GeoTIFF rasters. A module of its own; nothing here knows what an elevation map is. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cpl_conv.h>
#include <cpl_error.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <gdal.h>
#include <gdal_frmts.h>
#include <ogr_srs_api.h>

#include "core/elevation_internal.h"

typedef struct raster {
    GDALDatasetH dataset;
    int columns, rows;
    bool rgba;
    char *crs;
    uint8_t *mask; /* (columns) */
} raster;

/* ---- messages: GDAL's, kept instead of printed ---- */

static void CPL_STDCALL keep_message(CPLErr kind, CPLErrorNum number, const char *message)
{
    char *reason = CPLGetErrorHandlerUserData();
    (void)number;
    if (kind < CE_Failure || reason[0]) return; /* the first failure is the cause */
    snprintf(reason, TD_RASTER_REASON_SIZE, "%s", message);
    for (char *c = reason; *c; c++)
        if ((unsigned char)*c < ' ') *c = ' ';
}

static void listen(char reason[TD_RASTER_REASON_SIZE])
{
    reason[0] = 0;
    CPLPushErrorHandlerEx(keep_message, reason);
}

/* Returns `fine`, so that functions can end in it. */
static bool listened(bool fine, char reason[TD_RASTER_REASON_SIZE])
{
    CPLPopErrorHandler();
    if (!fine && !reason[0]) snprintf(reason, TD_RASTER_REASON_SIZE, "GDAL does not say why");
    return fine;
}

/* Only what is needed: all of GDAL's drivers and plugins would take longer, and open more doors. */
static void register_drivers(void)
{
    GDALRegister_MEM();
    GDALRegister_GTiff();
    GDALRegister_COG();
}

static void close_raster(void *made)
{
    raster *r = made;
    char unheard[TD_RASTER_REASON_SIZE];
    if (!r) return;
    listen(unheard);
    if (r->dataset) GDALClose(r->dataset);
    listened(true, unheard);
    CPLFree(r->crs);
    free(r->mask);
    free(r);
}

/* ---- reading ---- */

/* "EPSG:code" where the file says so, else WKT. */
static char *name_of(OGRSpatialReferenceH reference)
{
    const char *authority = OSRGetAuthorityName(reference, NULL),
               *code = OSRGetAuthorityCode(reference, NULL);
    if (authority && code) return CPLStrdup(CPLSPrintf("%s:%s", authority, code));
    char *text = NULL;
    const char *const options[] = {"FORMAT=WKT2_2019", NULL};
    if (OSRExportToWktEx(reference, &text, options) != OGRERR_NONE) {
        CPLFree(text);
        return NULL;
    }
    return text;
}

static void describe(td_raster_info *info, raster *r)
{
    OGRSpatialReferenceH reference = GDALGetSpatialRef(r->dataset);
    *info = (td_raster_info){
        .columns = r->columns, .rows = r->rows, .bands = GDALGetRasterCount(r->dataset), .unit_m = 1};
    info->has_transform = GDALGetGeoTransform(r->dataset, info->transform) == CE_None;
    if (!reference) return;
    info->crs = r->crs = name_of(reference);
    info->degrees = OSRIsGeographic(reference);
    if (!info->degrees) info->unit_m = OSRGetLinearUnits(reference, NULL);
}

static bool open_raster(void **made, td_raster_info *info, const char *path,
                        char reason[TD_RASTER_REASON_SIZE])
{
    static const char *const drivers[] = {"GTiff", NULL};
    raster *r = calloc(1, sizeof *r);
    listen(reason);
    register_drivers();
    if (r) r->dataset = GDALOpenEx(path, GDAL_OF_RASTER | GDAL_OF_READONLY, drivers, NULL, NULL);
    if (r && r->dataset) {
        r->columns = GDALGetRasterXSize(r->dataset);
        r->rows = GDALGetRasterYSize(r->dataset);
        r->mask = malloc((size_t)r->columns);
        describe(info, r);
    }
    const bool fine = listened(r && r->dataset && r->mask, reason);
    if (fine)
        *made = r;
    else
        close_raster(r);
    return fine;
}

static int find_band(void *made, const char *description)
{
    const raster *r = made;
    for (int i = GDALGetRasterCount(r->dataset); i > 0; i--)
        if (!strcmp(GDALGetDescription(GDALGetRasterBand(r->dataset, i)), description)) return i;
    return 0;
}

static const char *note(void *made, const char *key)
{
    const raster *r = made;
    return GDALGetMetadataItem(r->dataset, key, NULL);
}

static bool read_row(double *value, void *made, int band, int row, char reason[TD_RASTER_REASON_SIZE])
{
    raster *r = made;
    GDALRasterBandH b = GDALGetRasterBand(r->dataset, band);
    listen(reason);
    const bool fine =
        GDALRasterIO(b, GF_Read, 0, row, r->columns, 1, value, r->columns, 1, GDT_Float64, 0, 0) == CE_None &&
        GDALRasterIO(GDALGetMaskBand(b), GF_Read, 0, row, r->columns, 1, r->mask, r->columns, 1, GDT_Byte, 0,
                     0) == CE_None;
    if (!listened(fine, reason)) return false;
    const double scale = GDALGetRasterScale(b, NULL), offset = GDALGetRasterOffset(b, NULL);
    for (int i = 0; i < r->columns; i++) value[i] = r->mask[i] ? value[i] * scale + offset : (double)NAN;
    return true;
}

/* ---- writing ---- */

/* "EPSG:32632", WKT or "+proj…": what else GDAL would take are files and addresses. */
static bool parse_reference(OGRSpatialReferenceH made, const char *crs)
{
    const size_t word = strspn(crs, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_0123456789");
    const char *rest = crs + word;
    const bool code = word > 0 && rest[0] == ':' && rest[1] && !rest[1 + strspn(rest + 1, "0123456789+")];
    const bool text = word > 0 && rest[0] == '[';
    if (code || text || crs[0] == '+') return OSRSetFromUserInput(made, crs) == OGRERR_NONE;
    CPLError(CE_Failure, CPLE_IllegalArg, "neither a code nor WKT nor +proj");
    return false;
}

static bool set_reference(raster *r, const char *crs)
{
    OGRSpatialReferenceH reference = OSRNewSpatialReference(NULL);
    OSRSetAxisMappingStrategy(reference, OAMS_TRADITIONAL_GIS_ORDER);
    const bool fine = parse_reference(reference, crs) && GDALSetSpatialRef(r->dataset, reference) == CE_None;
    OSRDestroySpatialReference(reference);
    return fine;
}

/* So that viewers take the bands for a picture. */
static bool set_colours(raster *r)
{
    static const GDALColorInterp colours[] = {GCI_RedBand, GCI_GreenBand, GCI_BlueBand, GCI_AlphaBand};
    for (int i = 0; i < 4; i++)
        if (GDALSetRasterColorInterpretation(GDALGetRasterBand(r->dataset, i + 1), colours[i]) != CE_None)
            return false;
    return true;
}

static bool create(void **made, const td_raster_info *info, char reason[TD_RASTER_REASON_SIZE])
{
    raster *r = calloc(1, sizeof *r);
    listen(reason);
    register_drivers();
    bool fine = r != NULL;
    if (fine) {
        r->columns = info->columns;
        r->rows = info->rows;
        r->rgba = info->rgba;
        r->dataset = GDALCreate(GDALGetDriverByName("MEM"), "", info->columns, info->rows, info->bands,
                                info->rgba ? GDT_Byte : GDT_Float64, NULL);
        double transform[6];
        memcpy(transform, info->transform, sizeof transform);
        fine = r->dataset && GDALSetGeoTransform(r->dataset, transform) == CE_None &&
               (!info->crs || set_reference(r, info->crs)) && (!info->rgba || set_colours(r));
    }
    listened(fine, reason);
    if (fine)
        *made = r;
    else
        close_raster(r);
    return fine;
}

static bool set_note(void *made, const char *key, const char *value)
{
    const raster *r = made;
    return GDALSetMetadataItem(r->dataset, key, value, NULL) == CE_None;
}

static bool set_band(void *made, int band, const char *description, const char *unit)
{
    const raster *r = made;
    GDALRasterBandH b = GDALGetRasterBand(r->dataset, band);
    GDALSetDescription(b, description);
    return GDALSetRasterNoDataValue(b, (double)NAN) == CE_None && GDALSetRasterUnitType(b, unit) == CE_None;
}

static bool write_row(const double *value, void *made, int band, int row, char reason[TD_RASTER_REASON_SIZE])
{
    const raster *r = made;
    listen(reason);
    return listened(GDALRasterIO(GDALGetRasterBand(r->dataset, band), GF_Write, 0, row, r->columns, 1,
                                 (void *)(uintptr_t)value, r->columns, 1, GDT_Float64, 0, 0) == CE_None,
                    reason);
}

static bool encode(unsigned char **bytes, size_t *size, void *made, char reason[TD_RASTER_REASON_SIZE])
{
    const raster *r = made;
    /* The nearest cell in a map's overviews: a mean of provenances is none. */
    const char *const options[] = {"COMPRESS=DEFLATE",
                                   "LEVEL=1",
                                   "PREDICTOR=YES",
                                   "BLOCKSIZE=256",
                                   r->rgba ? "RESAMPLING=AVERAGE" : "RESAMPLING=NEAREST",
                                   NULL};
    char name[64];
    snprintf(name, sizeof name, "/vsimem/teledimos-%p.tif", made);
    listen(reason);
    GDALDatasetH written = GDALCreateCopy(GDALGetDriverByName("COG"), name, r->dataset, FALSE,
                                          (char **)(uintptr_t)options, NULL, NULL);
    bool fine = written != NULL;
    if (fine) {
        GDALClose(written);
        fine = !reason[0]; /* what could not be flushed on closing */
    }
    vsi_l_offset length = 0;
    *bytes = fine ? VSIGetMemFileBuffer(name, &length, TRUE) : NULL;
    *size = (size_t)length;
    VSIUnlink(name);
    return listened(*bytes != NULL, reason);
}

static void free_bytes(unsigned char *bytes)
{
    CPLFree(bytes);
}

static bool reference(unsigned char **wkt, td_raster_info *info, const char *crs,
                      char reason[TD_RASTER_REASON_SIZE])
{
    static const char *const options[] = {"FORMAT=WKT1_GDAL", NULL};
    char *text = NULL;
    listen(reason);
    OGRSpatialReferenceH made = OSRNewSpatialReference(NULL);
    const bool fine = parse_reference(made, crs) && OSRExportToWktEx(made, &text, options) == OGRERR_NONE;
    *info = (td_raster_info){.unit_m = 1};
    if (fine) {
        info->degrees = OSRIsGeographic(made);
        info->unit_m = OSRGetLinearUnits(made, NULL);
    } else {
        CPLFree(text);
        text = NULL;
    }
    OSRDestroySpatialReference(made);
    *wkt = (unsigned char *)text;
    return listened(fine, reason);
}

static const td_raster_module module = {open_raster, find_band, note,      read_row, close_raster, create,
                                        set_note,    set_band,  write_row, encode,   free_bytes,   reference};

TD_API td_raster_module_get_function td_raster_module_get;

const td_raster_module *td_raster_module_get(void)
{
    return &module;
}
