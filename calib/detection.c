#include "calib/detection.h"

#include <math.h>
#include <stdlib.h>

#include "calib/charuco.h"
#include "calib/chessboard.h"
#include "calib/marks.h"
#include "calib/tags.h"

td_status td_detection_init(td_detection *detection, size_t count, td_error *error)
{
    *detection = (td_detection){.count = count, .blur_px = NAN};
    detection->point = malloc(2 * count * sizeof *detection->point);
    detection->sigma = calloc(count, sizeof *detection->sigma);
    if (!detection->point || !detection->sigma) {
        td_detection_free(detection);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu points", count);
    }
    for (size_t i = 0; i < 2 * count; i++) detection->point[i] = NAN;
    return TD_OK;
}

void td_detection_free(td_detection *detection)
{
    free(detection->point);
    free(detection->sigma);
    *detection = (td_detection){0};
}

td_status td_detect(td_detection *detection, const td_image *image, const td_target *target, td_error *error)
{
    switch (target->kind) {
    case TD_TARGET_CHESSBOARD:
        return td_chessboard_detect(detection, image, target, error);
    case TD_TARGET_MARKS:
        return td_marks_detect(detection, image, target, NULL, 0, error);
    case TD_TARGET_CHARUCO:
        return td_charuco_detect(detection, image, target, error);
    case TD_TARGET_APRILGRID:
    case TD_TARGET_TAGS:
        return td_tags_detect(detection, image, target, error);
    case TD_TARGET_KIND_COUNT:
        break;
    }
    return td_fail(error, TD_ERROR_ARGUMENT, "no detector for targets of kind %d", (int)target->kind);
}
