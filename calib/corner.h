/* Sub-pixel position of the corner where four squares of a chessboard meet, with its sigma. */
#ifndef TELEDIMOS_CALIB_CORNER_H
#define TELEDIMOS_CALIB_CORNER_H

#include <stdbool.h>

#include "../core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_corner {
    double position[2]; /* px */
    double sigma; /* standard deviation of each coordinate, from the residuals' own strength and correlation,
                     px */
    double white; /* the same, were the residuals white noise: steadier from corner to corner, px */
    double blur;  /* standard deviation of the edges' Gaussian blur, px */
    double contrast; /* white minus black, grey levels; positive when the square between the two steps is
                        light */
    double residual; /* root mean square of the fit's residuals, grey levels */
} td_corner;

/* Refines a corner known to a few pixels. `along_column` and `along_row` (px) are the steps to the
 * neighbouring corners; they set the window (which stays inside the four squares) and the edges' first
 * directions. Returns false when the fit diverges, leaves the window, or the image there is no such corner.
 */
TD_API bool td_corner_refine(td_corner *corner, const td_image *image, const double start[2],
                             const double along_column[2], const double along_row[2]);

#ifdef __cplusplus
}
#endif
#endif
