/* What the tags of a dictionary look like.
 *
 * Names: "tag36h11", "tag25h9", "tag16h5" (AprilTag: Olson 2011; Wang and Olson 2016), "aruco4x4_50" …
 * "aruco7x7_1000", "aruco_original" (Garrido-Jurado et al. 2014, as OpenCV numbers them). */
#ifndef TELEDIMOS_CALIB_TAG_DICTIONARY_H
#define TELEDIMOS_CALIB_TAG_DICTIONARY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_TAG_MAX_CELLS = 12 }; /* 8 of the largest code, and two borders of 2 */

/* Number of tags of a dictionary; 0: there is none of this name. */
TD_API int td_tag_count(const char *dictionary);
/* Name of dictionary `index`, NULL past the last. */
TD_API const char *td_tag_dictionary_name(int index);
/* Cells of the black square (code and border) of tag `id`, row by row from its upper left, 0 dark and 1
 * light; *side is their number along a side. TD_ERROR_ARGUMENT names what there is not. */
TD_API td_status td_tag_cells(uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS], int *side,
                              const char *dictionary, int border, int id, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
