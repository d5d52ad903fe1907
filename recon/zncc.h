/* Zero-mean normalised cross-correlation of two windows, exactly as the paper's 3.4 writes it:
 *
 *   ZNCC_k(ij, lm) = sum (a - mean a)(b - mean b) / (sqrt(sum (a - mean a)^2) sqrt(sum (b - mean b)^2))
 *
 * over (2k+1) x (2k+1) pixels around (i, j) of image a and (l, m) of image b; i, l count columns. */
#ifndef TELEDIMOS_RECON_ZNCC_H
#define TELEDIMOS_RECON_ZNCC_H

#include "../core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* In [-1, 1]; NaN where a window leaves its image or is of one grey. Grey images. */
TD_API double td_zncc(const td_image *a, int i, int j, const td_image *b, int l, int m, int k);

#ifdef __cplusplus
}
#endif
#endif
