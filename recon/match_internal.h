/* What guided and automatic matching share. */
#ifndef TELEDIMOS_RECON_MATCH_INTERNAL_H
#define TELEDIMOS_RECON_MATCH_INTERNAL_H

#include <stdint.h>

#include "recon/match.h"

/* td_match_refine; *correlation (may be NULL) is the ZNCC of the windows as interpolated at the end. */
bool td_match_refine_correlated(td_match *match, double *correlation, const td_image *left,
                                const td_image *right, int half_window);

/* An image made ready for ZNCC of whole pixels: products and deviations are exact sums, so that the value is
 * td_zncc's to rounding. */
typedef struct td_zncc_plane {
    int width, height, k;
    int16_t *grey;  /* (height,width), and zeros to read on past the end */
    int32_t *sum;   /* (height,width) over the window around each pixel */
    double *factor; /* (height,width) 1/sqrt(n sum of squares - sum^2); 0 at the edge and in flat windows */
} td_zncc_plane;
td_status td_zncc_plane_new(td_zncc_plane **plane, const td_image *image, int k, td_error *error);
void td_zncc_plane_free(td_zncc_plane **plane);

/* One left window, to be compared with many right ones by the plane's sums. */
typedef struct td_zncc_window {
    const td_zncc_plane *plane; /* the right image's */
    int16_t *grey;              /* (side,stride), rows padded with zeros */
    int side, stride;
    double sum, factor;
} td_zncc_window;
/* factor 0: flat, or over the edge. False: out of memory. */
bool td_zncc_window_cut(td_zncc_window *window, const td_zncc_plane *left, int i, int j,
                        const td_zncc_plane *right);
void td_zncc_window_free(td_zncc_window *window);
/* ZNCC of a td_zncc_window with the pixel (x, y); NaN where undefined. A td_band_score. */
double td_zncc_window_score(int x, int y, const void *window);

/* ZNCC of one left pixel with every right pixel in the band around its epipolar curve. */
typedef struct td_band_pixel {
    int x, y;
    double score;
} td_band_pixel;
typedef struct td_band {
    int x0, y0, width, height; /* px, the box that is stored */
    float *score;              /* (height,width); NaN: not in the band, or undefined */
    td_band_pixel *pixel;      /* (count) those of the band with a score */
    size_t count, capacity;
} td_band;
typedef struct td_band_range {
    double near_m, far_m, band_px; /* as in td_match_options */
} td_band_range;
/* The score of a right pixel; NaN: none. */
typedef double (*td_band_score)(int x, int y, const void *user);
/* Empty where the curve misses the image. False: out of memory. */
bool td_band_search(td_band *band, const td_pair *pair, int i, int j, const td_band_range *range,
                    td_band_score score, const void *user);
void td_band_free(td_band *band);
/* Local maxima, best first, none within `distance` (px, the larger of |dx|, |dy|) of a better one; at most
 * `capacity`. */
size_t td_band_peaks(td_band_pixel *peak, size_t capacity, const td_band *band, int distance);

/* The option's half width, or max(1 px, 3 sigma of the rig's residual at this left pixel). */
double td_match_band_px(const td_pair *pair, int i, int j, const td_match_options *options);

/* Sizes and channels of both images. */
td_status td_match_images_check(const td_pair *pair, const td_image *left, const td_image *right,
                                td_error *error);

#endif
