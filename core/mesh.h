/* Surfaces of triangles, for viewers. A mesh is a cloud with triangles over its points (core/cloud.h). */
#ifndef TELEDIMOS_CORE_MESH_H
#define TELEDIMOS_CORE_MESH_H

#include "cloud.h"
#include "elevation.h"
#include "image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The map's surface: two triangles between each four neighbours, one between three; where a cell is unknown
 * there is a hole. A map of more known cells than `most` (0: any) is thinned to every second, third … cell;
 * then squares that hold an unknown cell are left out, so that no hole is closed. Counter-clockwise seen from
 * above; sigma is the cells'. Refused: a map without a triangle. */
TD_API td_status td_mesh_from_elevation(td_cloud **mesh, const td_elevation *map, size_t most,
                                        td_error *error);

/* What a glTF file says besides the triangles. */
typedef struct td_gltf_texture {
    const td_image *image;   /* its first row is the northernmost */
    double low[2], high[2];  /* x, y (m) of the edges of its first column and last row, last and first */
    const char *frame, *crs; /* of the coordinates; crs NULL: none */
} td_gltf_texture;

/* glTF 2.0 (Khronos, 2021) in one binary file, whole or not at all, the texture within, seen straight from
 * above. glTF has Y up: (x, y, z) becomes (x - ox, z - oz, -(y - oy)). Its numbers are floats, so a whole
 * number of kilometres is taken off first: the node's extras.origin_m (0 for a site near its origin), in
 * their order x, y, z; so floats keep 0.06 mm within the kilometre. */
TD_API td_status td_mesh_write_gltf(const td_cloud *mesh, const td_gltf_texture *texture, const char *path,
                                    td_error *error);

#ifdef __cplusplus
}
#endif
#endif
