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
    /* Standard deviation of each coordinate, px: from the residuals with their own strength and correlation.
     * Right on average, but good to a third only; over many corners of an image, the mean of (sigma /
     * white)^2 is steadier. */
    double sigma;
    double white;    /* the same, were the residuals white noise, px */
    double blur;     /* standard deviation of the edges' Gaussian blur, the pixel's own width included, px */
    double contrast; /* white minus black, grey levels; positive when the square between the two steps is
                        light */
    double residual; /* root mean square of the fit's residuals, grey levels */
} td_corner;

/* Refines a corner in a grey image, known to within half the distance to the next edge. `along_column` and
 * `along_row` (px) are the steps to the neighbouring corners; they set the window, which stays inside the
 * four squares, and the edges' first directions. Returns false, with *corner undefined, where the image holds
 * no such corner or too little of it: edges that leave the steps by more than 17 degrees, squares less than 5
 * px wide, a window cut by the image's border, residuals beyond a quarter of the contrast, a sigma beyond 0.5
 * px. */
TD_API bool td_corner_refine(td_corner *corner, const td_image *image, const double start[2],
                             const double along_column[2], const double along_row[2]);

#ifdef __cplusplus
}
#endif
#endif
