/* OpenCV's corners as the peer of recon/interest.h, for tests and benches only. */
#ifndef TELEDIMOS_TESTS_INTEREST_OPENCV_H
#define TELEDIMOS_TESTS_INTEREST_OPENCV_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How OpenCV is asked. Both go through goodFeaturesToTrack, which takes the strongest maxima of cornerHarris
 * or of cornerMinEigenVal that keep the distance. */
typedef struct opencv_corners {
    int harris, block, sub_pixel; /* sub_pixel: cornerSubPix afterwards */
    double quality, distance_px;
} opencv_corners;

/* Writes at most `most` corners (n,2) px to xy, strongest first; returns how many. One thread. */
size_t opencv_find_corners(double *xy, size_t most, const unsigned char *image, int width, int height,
                           const opencv_corners *how);

#ifdef __cplusplus
}
#endif
#endif
