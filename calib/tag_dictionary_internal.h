/* All codes of a dictionary at once; and behind the wall to OpenCV, which holds the ArUco dictionaries. */
#ifndef TELEDIMOS_CALIB_TAG_DICTIONARY_INTERNAL_H
#define TELEDIMOS_CALIB_TAG_DICTIONARY_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The bits (side,side) of marker `id` of OpenCV's predefined dictionary `number`, upright, 1 light. False
 * when there is no such marker, or its side is another. */
bool td_aruco_bits(uint8_t *bit, int side, int number, int id);

/* A code's most significant bit (of side * side) stands at the upper left, the others row by row; 1 light. */
typedef struct tag_codes {
    int count, side;
    uint64_t *code; /* (count), to be freed with free() */
} tag_codes;

td_status td_tag_codes(tag_codes *codes, const char *dictionary, td_error *error);
/* The cells (side + 2 border)^2 of a code. */
void td_tag_code_cells(uint8_t *cell, uint64_t code, int side, int border);

#ifdef __cplusplus
}
#endif
#endif
