/* Points in space, each with a colour and how sure it is. File: PLY, binary little-endian, which CloudCompare
 * and MeshLab open (x, y, z as double m; red, green, blue; sigma as float m); or LAS, which surveyors open.
 */
#ifndef TELEDIMOS_CORE_CLOUD_H
#define TELEDIMOS_CORE_CLOUD_H

#include <stddef.h>
#include <stdint.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_cloud_point {
    double p[3]; /* m */
    float sigma; /* m, standard deviation along the worst direction; NaN: not known */
    uint8_t rgb[3];
} td_cloud_point;

typedef struct td_cloud {
    size_t count;
    td_cloud_point *point; /* (count) */
    size_t triangle_count; /* of a mesh over the points; 0: none */
    uint32_t (*triangle)[3];
} td_cloud;

/* All points at the origin, grey, of unknown sigma; corners of triangles 0. At most 2^32 - 1 of each. */
TD_API td_status td_cloud_new(td_cloud **cloud, size_t count, size_t triangle_count, td_error *error);
TD_API void td_cloud_free(td_cloud **cloud);
/* PLY. `comment` (may be NULL) goes into its header: the frame, the unit. Reading takes binary (both orders)
 * and ASCII, any order of properties; what is missing is NaN or grey. Polygons are cut into triangles. */
TD_API td_status td_cloud_write_ply(const td_cloud *cloud, const char *path, const char *comment,
                                    td_error *error);
TD_API td_status td_cloud_read_ply(td_cloud **cloud, const char *path, td_error *error);
/* The same from memory; `name` is for messages. */
TD_API td_status td_cloud_parse_ply(td_cloud **cloud, const void *bytes, size_t size, const char *name,
                                    td_error *error);

/* LAS 1.4 (ASPRS 2019), point format 7 with sigma as an extra dimension of floats (m, NaN: not known), whole
 * or not at all. Coordinates are whole steps of a tenth of a millimetre, coarser where the cloud is wider
 * than 200 km, from an offset near its middle. `wkt` (core/crs.h) says where on Earth; NULL: nowhere. Times
 * are 0, dates left out: the same cloud gives the same bytes. Triangles are left out. Refused: points that
 * are not finite. */
TD_API td_status td_cloud_write_las(const td_cloud *cloud, const char *path, const char *wkt,
                                    td_error *error);

#ifdef __cplusplus
}
#endif
#endif
