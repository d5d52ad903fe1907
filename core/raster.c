/* The module behind GDAL, opened; and what is asked of it besides rasters. */
#include <dlfcn.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/crs.h"
#include "core/elevation_internal.h"
#include "core/file.h"
#include "core/text_internal.h"

td_status td_raster_load(const td_raster_module **module, const char *path, td_error *error)
{
    void *library = dlopen(TD_RASTER_MODULE, RTLD_NOW | RTLD_LOCAL);
    if (!library)
        return td_fail(error, TD_ERROR_UNSUPPORTED, "%s: the module for maps cannot be loaded: %s", path,
                       dlerror());
    td_raster_module_get_function *get;
    *(void **)&get = dlsym(library, TD_RASTER_FUNCTION);
    if (!get)
        return td_fail(error, TD_ERROR_UNSUPPORTED, "%s: %s has no %s", path, TD_RASTER_MODULE,
                       TD_RASTER_FUNCTION);
    *module = get();
    return TD_OK;
}

void td_raster_place(double transform[6], const double origin[2], double cell_m, int rows)
{
    const double t[6] = {origin[0] - 0.5 * cell_m, cell_m, 0, origin[1] + (rows - 0.5) * cell_m, 0, -cell_m};
    memcpy(transform, t, sizeof t);
}

td_status td_raster_write(const char *path, const td_raster_info *info, const void *data,
                          bool (*notes)(const td_raster_module *module, void *raster, const void *data),
                          void (*row)(double *value, const void *data, int band, int y), td_error *error)
{
    const td_raster_module *module = NULL;
    void *raster = NULL;
    unsigned char *bytes = NULL;
    size_t size = 0;
    char reason[TD_RASTER_REASON_SIZE] = "";
    TD_TRY(td_raster_load(&module, path, error));
    double *value = malloc((size_t)info->columns * sizeof *value);
    if (!value) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a row", path);
    bool made = module->create(&raster, info, reason) && notes(module, raster, data);
    for (int band = 0; made && band < info->bands; band++)
        for (int y = 0; made && y < info->rows; y++) {
            row(value, data, band, info->rows - 1 - y);
            made = module->write_row(value, raster, band + 1, y, reason);
        }
    made = made && module->encode(&bytes, &size, raster, reason);
    td_status status =
        made ? td_file_write(path, bytes, size, error)
             : td_fail(error, TD_ERROR_EXTERNAL, "%s: cannot be made a GeoTIFF: %s", path, reason);
    if (bytes) module->free_bytes(bytes);
    if (raster) module->close(raster);
    free(value);
    return status;
}

td_status td_crs_wkt(char **wkt, const char *crs, td_error *error)
{
    const td_raster_module *module = NULL;
    td_raster_info info;
    unsigned char *text = NULL;
    char reason[TD_RASTER_REASON_SIZE] = "", shown[TD_SHOWN_SIZE];
    *wkt = NULL;
    td_text_shown(shown, crs);
    TD_TRY(td_raster_load(&module, shown, error));
    if (!module->reference(&text, &info, crs, reason))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "'%s' is no coordinate reference system that is known (write EPSG:32632): %s", shown,
                       reason);
    td_status status = TD_OK;
    if (info.degrees || fabs(info.unit_m - 1) > 1e-12)
        status = td_fail(error, TD_ERROR_ARGUMENT,
                         "'%s': its coordinates are in %s, but must be in metres: take a projected one (UTM)",
                         shown, info.degrees ? "degrees" : "another unit");
    else if (!(*wkt = strdup((const char *)text)))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for a coordinate reference system");
    module->free_bytes(text);
    return status;
}
