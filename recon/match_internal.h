/* What guided and automatic matching share. */
#ifndef TELEDIMOS_RECON_MATCH_INTERNAL_H
#define TELEDIMOS_RECON_MATCH_INTERNAL_H

#include <stdint.h>

#include "recon/match.h"

/* td_match_refine; *correlation (may be NULL) is the ZNCC of the windows as interpolated at the end. */
bool td_match_refine_correlated(td_match *match, double *correlation, const td_image *left,
                                const td_image *right, int half_window);

/* An image made ready for ZNCC of whole pixels: numerator and deviations from exact sums, so that the value
 * is td_zncc's to rounding. */
typedef struct td_zncc_plane {
    int width, height, k;
    int16_t *grey;  /* (height,width), and `k`'s padding at the end */
    int32_t *sum;   /* (height,width) over the window around each pixel */
    double *factor; /* (height,width) 1/sqrt(n sum of squares - sum^2); 0 at the edge and in flat windows */
} td_zncc_plane;
td_status td_zncc_plane_new(td_zncc_plane **plane, const td_image *image, int k, td_error *error);
void td_zncc_plane_free(td_zncc_plane **plane);
/* ZNCC, NaN where undefined; both planes have the same k. */
double td_zncc_plane_at(const td_zncc_plane *a, int i, int j, const td_zncc_plane *b, int l, int m);

/* ZNCC of one left pixel with every right pixel of the band around its epipolar curve. */
typedef struct td_band {
    int x0, y0, width, height; /* px, the box that is stored */
    float *score;              /* (height,width); NaN: not in the band, or undefined */
} td_band;
/* An empty box where the curve misses the image. near_m and far_m as in td_match_options. */
td_status td_band_search(td_band *band, const td_pair *pair, const double left[2], const td_zncc_plane *a,
                         const td_zncc_plane *b, double near_m, double far_m, double band_px,
                         td_error *error);
void td_band_free(td_band *band);
/* Local maxima, best first, none within `distance` (px, the larger of |dx|, |dy|) of a better one; at most
 * `capacity`. peak (capacity,2) px of the right image, score (capacity). */
size_t td_band_peaks(int (*peak)[2], double *score, size_t capacity, const td_band *band, int distance);

/* Half width of the band for this left point: the option, or max(1 px, 3 sigma of the rig's residual). */
double td_match_band_px(const td_pair *pair, const double left[2], const td_match_options *options);

/* Sizes and channels of both images. */
td_status td_match_images_check(const td_pair *pair, const td_image *left, const td_image *right,
                                td_error *error);

#endif
