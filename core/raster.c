/* The module behind GDAL, opened; and what is asked of it besides rasters. */
#include <dlfcn.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/crs.h"
#include "core/elevation_internal.h"
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
