/* OpenCV's triangulation, for tests/recon/test_triangulation.c. */
#ifndef TELEDIMOS_TESTS_RECON_TRIANGULATION_OPENCV_H
#define TELEDIMOS_TESTS_RECON_TRIANGULATION_OPENCV_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* cv::correctMatches; pixels (n,2). */
void opencv_correct_matches(double *left_corrected, double *right_corrected, const double f[9],
                            const double *left, const double *right, size_t n);
/* cv::triangulatePoints; xyz (n,3), projections (3,4). */
void opencv_triangulate(double *xyz, const double p_left[12], const double p_right[12], const double *left,
                        const double *right, size_t n);

#ifdef __cplusplus
}
#endif
#endif
