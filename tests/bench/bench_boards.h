/* OpenCV on boards, for bench_boards.c. */
#ifndef TELEDIMOS_TESTS_BENCH_BOARDS_H
#define TELEDIMOS_TESTS_BENCH_BOARDS_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct bench_board_input {
    const unsigned char *const *image; /* (images) grey */
    int images, width, height, columns, rows, marks;
    double *point; /* (images,rows*columns,2) px, NaN where the board was not found */
} bench_board_input;

/* findChessboardCorners with cornerSubPix (half window 5), or findCirclesGrid. */
void bench_opencv_boards(void *input);

#ifdef __cplusplus
}
#endif
#endif
