/* The ViSP module's one function. ViSP's libraries take 0.25 s to load, so it is a shared object of its own
 * that is opened only when asked for. */
#ifndef TELEDIMOS_CALIB_FIRST_ESTIMATE_INTERNAL_H
#define TELEDIMOS_CALIB_FIRST_ESTIMATE_INTERNAL_H

#include <stddef.h>

#include "core/status.h"

#define TD_VISP_MODULE "libteledimos_calib_visp.so"
#define TD_VISP_FUNCTION "td_visp_estimate"

/* Start in, estimate out: intrinsics (4) px, which `keep_camera` leaves alone, and matrix (views,16),
 * camera_from_target, row-major. The points of view v are point[3 first[v]…], pixel[2 first[v]…], count[v] of
 * them. */
typedef td_status td_visp_estimate_function(double intrinsics[4], double *matrix, const double *point,
                                            const double *pixel, const size_t *first, const size_t *count,
                                            size_t views, int keep_camera, td_error *error);

#endif
