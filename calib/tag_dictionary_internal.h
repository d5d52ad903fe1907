/* Behind the wall to OpenCV, which holds the ArUco dictionaries. */
#ifndef TELEDIMOS_CALIB_TAG_DICTIONARY_INTERNAL_H
#define TELEDIMOS_CALIB_TAG_DICTIONARY_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The bits (side,side) of marker `id` of OpenCV's predefined dictionary `number`, upright, 1 light. False
 * when there is no such marker, or its side is another. */
bool td_aruco_bits(uint8_t *bit, int side, int number, int id);

#ifdef __cplusplus
}
#endif
#endif
