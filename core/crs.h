/* Coordinate reference systems, by name. GDAL, which knows them, is opened only when one is asked for. */
#ifndef TELEDIMOS_CORE_CRS_H
#define TELEDIMOS_CORE_CRS_H

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* "EPSG:32632", WKT or PROJ's text as WKT of OGC 01-009, which LAS asks for; to be freed with free().
 * Refused: what is not known, and coordinates that are not in metres (degrees, feet). */
TD_API td_status td_crs_wkt(char **wkt, const char *crs, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
