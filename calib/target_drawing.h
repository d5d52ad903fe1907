/* A target on paper, at true scale, with rulers and its parameters printed beside it. */
#ifndef TELEDIMOS_CALIB_TARGET_DRAWING_H
#define TELEDIMOS_CALIB_TARGET_DRAWING_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/image.h"
#include "../core/target.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_target_drawing_options {
    double page_width_m, page_height_m; /* both 0 (default): as large as the target needs */
    double margin_m; /* white around the target; never less than detectors need, which is the default (0):
                        half a square or spacing, a quarter of a tag */
    double dots_per_inch; /* of an image; default 600. Rounded to whole pixels per metre, as PNG keeps it */
    double printer_scale[2]; /* measured over nominal, along x and y; the drawing is divided by it; 1 */
    bool ruler, text;        /* default true */
} td_target_drawing_options;

TD_API td_target_drawing_options td_target_drawing_options_default(void);

/* Plane `plane` of the target, or of single tags the tag of this index with all that lie beside it, unturned,
 * on one plane.
 *
 * Writes PATH as its ending says: .svg, .pdf or .png. A target that does not fit the page is refused with the
 * size it needs. The same input gives the same bytes. */
TD_API td_status td_target_draw(const char *path, const td_target *target, int plane,
                                const td_target_drawing_options *options, td_error *error);
/* Rendered into memory, grey; pixel_from_target (2,3), row-major: px from m on the plane (single tags: from m
 * in the frame of tag `plane`). */
TD_API td_status td_target_render(td_image **image, double pixel_from_target[6], const td_target *target,
                                  int plane, const td_target_drawing_options *options, td_error *error);
/* Width and height, m, of the least page of the options' width (0: of any) that holds the target with its
 * margin, rulers and text. */
TD_API td_status td_target_page_needed(double size_m[2], const td_target *target, int plane,
                                       const td_target_drawing_options *options, td_error *error);
/* "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}": the target's line of a dataset.yaml.
 * Writes at most `size` bytes and returns `text`. */
TD_API char *td_target_dataset_line(char *text, size_t size, const td_target *target);

#ifdef __cplusplus
}
#endif
#endif
