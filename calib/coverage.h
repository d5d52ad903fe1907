/* What the views cover: the image, distances, tilts. */
#ifndef TELEDIMOS_CALIB_COVERAGE_H
#define TELEDIMOS_CALIB_COVERAGE_H

#include "calibrate.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_COVERAGE_COLUMNS = 12, TD_COVERAGE_ROWS = 9, TD_COVERAGE_TILTS = 4 };

typedef struct td_coverage {
    size_t views;                                          /* in which the camera saw the target */
    size_t points[TD_COVERAGE_ROWS * TD_COVERAGE_COLUMNS]; /* in each cell: seen, and in use if calibrated */
    double image_share;                                    /* of cells with a point, 0 to 1 */
    double nearest_m, farthest_m;                          /* of the boards' centres; NaN without poses */
    double tilt_rad;                                       /* the largest between board and image; NaN */
    size_t tilted[TD_COVERAGE_TILTS]; /* views whose right, left, lower, upper side is tilted away by 15° */
    char missing[TD_TEXT_SIZE];       /* what to add, in words; "" when nothing is missing */
} td_coverage;

/* `calibration` may be NULL: then image and views only. */
TD_API void td_coverage_measure(td_coverage *coverage, int camera, const td_calibration *calibration,
                                const td_observations *observations);

#ifdef __cplusplus
}
#endif
#endif
