/* Finds the inner corners of a chessboard in an image. */
#ifndef TELEDIMOS_CALIB_CHESSBOARD_H
#define TELEDIMOS_CALIB_CHESSBOARD_H

#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Corners in the target's order with sub-pixel positions and sigmas (corner.h). The order is made unique where the
 * board allows it: the first square (between points 0, 1, columns, columns+1) is dark when exactly one of columns and
 * rows is even... see the .c; on boards with a half-turn symmetry the corner nearer the image's top left comes first.
 * When not found, the reason tells what was seen instead: another size of board, a transposed one, none. */
TD_API td_status td_chessboard_detect(td_detection *detection, const td_image *image, const td_target *target,
                                      td_error *error);

#ifdef __cplusplus
}
#endif
#endif
