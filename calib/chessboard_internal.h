/* What chessboard.c asks of the detectors of OpenCV, which find corners to a pixel or a few. */
#ifndef TELEDIMOS_CALIB_CHESSBOARD_INTERNAL_H
#define TELEDIMOS_CALIB_CHESSBOARD_INTERNAL_H

#include <stdbool.h>

#include "core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How the image is made black and white before quadrangles are looked for. */
typedef struct td_chessboard_threshold {
    int block;     /* side of the block around a pixel, odd, 3 or more, px */
    double offset; /* white: above the block's mean less this, grey levels */
    int smooth;    /* side of a Gaussian filter before, odd, px; 0: none */
} td_chessboard_threshold;

/* Corners by the black quadrangles and their neighbours: quick, wants a white margin around the board.
 * `corner` (columns*rows,2) px, row by row, in an order of OpenCV's choice. */
td_status td_chessboard_by_quadrangles(double *corner, bool *found, const td_image *image, int columns,
                                       int rows, const td_chessboard_threshold *threshold, td_error *error);

/* Corners by the sectors around each (Duda and Frese 2018): slower, bears blur. With `larger`, columns and
 * rows are the smallest wanted on entry and the board's on return; a board of more than `capacity` corners is
 * not found. */
td_status td_chessboard_by_sectors(double *corner, size_t capacity, bool *found, int *columns, int *rows,
                                   bool larger, const td_image *image, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
