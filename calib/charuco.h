/* ChArUco boards: a chessboard whose light squares hold numbered markers, so that a part of it suffices. */
#ifndef TELEDIMOS_CALIB_CHARUCO_H
#define TELEDIMOS_CALIB_CHARUCO_H

#include "detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Every inner corner whose place the markers tell, refined as a chessboard's. Found with 4 corners that are
 * not in line. */
TD_API td_status td_charuco_detect(td_detection *detection, const td_image *image, const td_target *target,
                                   td_error *error);

#ifdef __cplusplus
}
#endif
#endif
