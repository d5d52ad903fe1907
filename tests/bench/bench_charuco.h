/* OpenCV's charuco detector, for bench_charuco.c. */
#ifndef TELEDIMOS_TESTS_BENCH_CHARUCO_H
#define TELEDIMOS_TESTS_BENCH_CHARUCO_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct bench_charuco_input {
    const unsigned char *const *image; /* (images) grey */
    int images, width, height, columns, rows;
    int dictionary; /* OpenCV's number */
    double share;   /* of a square's side that its marker takes */
    double *point;  /* (images,rows*columns,2) px, NaN: not found; out */
} bench_charuco_input;
void bench_opencv_charuco(void *input);

#ifdef __cplusplus
}
#endif
#endif
