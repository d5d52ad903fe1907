/* A target on paper, at true scale, with a ruler and its parameters printed beside it. */
#ifndef TELEDIMOS_CALIB_TARGET_DRAWING_H
#define TELEDIMOS_CALIB_TARGET_DRAWING_H

#include "../core/image.h"
#include "../core/target.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_target_drawing_options {
    double page_width_m, page_height_m; /* 0: as large as the target needs */
    double margin_m;                    /* white around the target; default one square or tag */
    double dots_per_inch;               /* of a PNG; default 600 */
    double printer_scale[2]; /* measured over nominal, along x and y; the drawing is divided by it; 1 */
    bool ruler, text;        /* default true */
} td_target_drawing_options;

TD_API td_target_drawing_options td_target_drawing_options_default(void);

/* Writes PATH as its ending says: .svg, .pdf or .png. Targets that do not fit the page are refused with the
 * size they need. The same input gives the same bytes. */
TD_API td_status td_target_draw(const char *path, const td_target *target, int plane,
                                const td_target_drawing_options *options, td_error *error);
/* Rendered into memory, grey; pixel_from_target (2,3), row-major: px from m on the plane. */
TD_API td_status td_target_render(td_image **image, double pixel_from_target[6], const td_target *target,
                                  int plane, const td_target_drawing_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
