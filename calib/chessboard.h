/* Finds the inner corners of a chessboard in an image. */
#ifndef TELEDIMOS_CALIB_CHESSBOARD_H
#define TELEDIMOS_CALIB_CHESSBOARD_H

#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Corners of the whole board in the target's order, with sub-pixel positions and sigmas (corner.h); image:
 * grey.
 *
 * Columns run along x and rows along y of a board seen from its front, so the order is never mirrored. Of the
 * orders that a half turn leaves (a quarter turn too, when columns = rows), those count for which the square
 * before the first column and the first row, outside point 0, is dark. Where columns + rows is odd this is a
 * single one: the numbering stays with the board however it is turned. Else it is the order with point 0
 * nearest the image's top left (least x + y), and boards turned by 135 degrees or so may be numbered the
 * other way round in the next image.
 *
 * Up to a fifth of the corners may be unseen (glare, a finger): `reason` then says how many. When not found,
 * it says what was seen instead: another size of board, corners too blurred or noisy to measure, a blurred
 * image, none. */
TD_API td_status td_chessboard_detect(td_detection *detection, const td_image *image, const td_target *target,
                                      td_error *error);

#ifdef __cplusplus
}
#endif
#endif
