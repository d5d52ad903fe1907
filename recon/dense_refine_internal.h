/* What the files of the refinement share. Grey values' slopes and residuals are held as whole eighths of a
 * grey level, so that sums over a window are exact however they are formed. */
#ifndef TELEDIMOS_RECON_DENSE_REFINE_INTERNAL_H
#define TELEDIMOS_RECON_DENSE_REFINE_INTERNAL_H

#include "recon/dense_internal.h"

enum {
    REFINE_WINDOW = 4, /* px to each side */
    REFINE_SIDE = 2 * REFINE_WINDOW + 1,
    REFINE_ONE = 8,                 /* a grey level */
    REFINE_MOST = 255 * REFINE_ONE, /* of a slope or a residual */
    REFINE_SUMS = 6,                /* n, g, r, gg, gr, rr */
    REFINE_TILES = 4                /* of the rows' offset, across and down */
};

/* How far the right image's rows are off the left's: px, positive where what is seen lies lower at the left;
 * at the centres of tiles. */
typedef struct dense_lift {
    float at[REFINE_TILES * REFINE_TILES]; /* by rows */
    float square;                          /* mean of the squares */
} dense_lift;

/* Variance of a residual's noise, grey levels^2: base + rate * grey. */
typedef struct dense_noise {
    float base, rate;
} dense_noise;

/* dense_refine_fit.c */
float dense_fit_gain(const td_image *left, const td_image *right, const td_disparity *result);
/* slope, residual, with (height,width): of dense_look. */
void dense_fit_lift(dense_lift *lift, const td_image *left, const int16_t *slope, const int16_t *residual,
                    const int16_t *with, int threads);
/* Offsets of the rows along row y. */
void dense_lift_row(float *lift, const dense_lift *of, int y, int width, int height);
/* variance (height,width): of the residuals in each window; negative: not known. */
/* False: no memory. */
bool dense_fit_noise(dense_noise *noise, const td_image *left, const float *variance);

#endif
