/* ChArUco boards: a chessboard whose light squares hold numbered markers, so that a part of it suffices. */
#ifndef TELEDIMOS_CALIB_CHARUCO_H
#define TELEDIMOS_CALIB_CHARUCO_H

#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Every inner corner whose place the markers tell, refined as a chessboard's. Found with two markers that
 * agree and 4 corners that are not in line. When not found, the reason says what was seen instead: another
 * dictionary, other numbers, a mirrored board, or a layout that the markers fit better (legacy, columns and
 * rows exchanged, squares counted instead of corners). A part of a board whose squares are even in rows and
 * odd in columns may fit both values of legacy: then the corners are numbered one column off. */
TD_API td_status td_charuco_detect(td_detection *detection, const td_image *image, const td_target *target,
                                   td_error *error);

#ifdef __cplusplus
}
#endif
#endif
