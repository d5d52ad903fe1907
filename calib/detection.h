/* What a detector saw of a target in one image. */
#ifndef TELEDIMOS_CALIB_DETECTION_H
#define TELEDIMOS_CALIB_DETECTION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../core/image.h"
#include "../core/target.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Points in the order of the target's points. A point that was not seen has sigma 0 and position NaN. */
typedef struct td_detection {
    bool found;       /* enough points for a pose; if not, `reason` says why in one sentence */
    char reason[240]; /* what was looked for, what was seen, what to do; "" when found without remark */
    size_t count;     /* points of the target */
    double *point;    /* (count,2) px */
    double *sigma;    /* (count)   px, standard deviation of each coordinate */
    double blur_px;   /* median standard deviation of the edges' blur, px; NaN: not measured */
} td_detection;

/* All points unseen, found = false. Free with td_detection_free; a zeroed one may be freed too. */
TD_API td_status td_detection_init(td_detection *detection, size_t count, td_error *error);
TD_API void td_detection_free(td_detection *detection);

/* Finds `target` in the grey image by the detector of its kind. TD_OK with found = false when the target is
 * not there; an error only for bad arguments or lack of memory. `detection` need not be initialised. */
TD_API td_status td_detect(td_detection *detection, const td_image *image, const td_target *target,
                           td_error *error);

#ifdef __cplusplus
}
#endif
#endif
