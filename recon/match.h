/* Matching points of a stereo pair: guided (a person's left points, ranked candidates along the epipolar
 * curve) and automatic (interest points of the left image), each refined to a fraction of a pixel. */
#ifndef TELEDIMOS_RECON_MATCH_H
#define TELEDIMOS_RECON_MATCH_H

#include "../core/log.h"
#include "../core/progress.h"
#include "epipolar.h"
#include "interest.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The same point of the scene in both images. The left pixel says which point is meant; the error is all in
 * the right one. */
typedef struct td_match {
    double left[2], right[2]; /* px, as taken */
    double covariance[4];     /* (2,2) px^2 of `right`, noise of both images; NaN before refinement */
    double zncc;              /* of the windows around the nearest pixels */
    double runner_up; /* ZNCC of the next best place, at least a window's half away; NaN: there was none */
    bool refined;
} td_match;

typedef struct td_match_options {
    int half_window;      /* k of ZNCC; default 7 */
    double near_m, far_m; /* depths looked for, along the left camera's z; default 0.5, INFINITY */
    double band_px;       /* half width of the band around the epipolar curve; 0 (default): max(1 px, 3
                             sigma from the rig's covariance) */
    double least_zncc;    /* default 0.7 */
    double uniqueness;    /* runner-up must be below best times this; default 0.95; automatic only */
    size_t candidates;    /* guided: at most, default 8 */
    double most_sigma_px; /* automatic: matches less sure than this (sqrt of the covariance's trace) are left
                             out; default 0.1; 0: none */
    td_interest_options interest; /* automatic: default 2000 points, evenly spread */
    int threads;                  /* 0: one per processor; the result does not depend on it */
    const td_progress *progress;
    const td_log *log;
} td_match_options;
TD_API td_match_options td_match_options_default(void);
TD_API td_status td_match_options_check(const td_match_options *options, td_error *error);

/* Candidates for the left point, best ZNCC first, each refined where that succeeds. *candidates is (count),
 * to be freed with free(). count 0 with TD_OK: none reaches least_zncc. Images are grey and of the cameras'
 * sizes, else refused, as is a point outside the image or nearer than the window to its edge. */
TD_API td_status td_match_guided(td_match **candidates, size_t *count, const td_pair *pair,
                                 const td_image *left, const td_image *right, const double point[2],
                                 const td_match_options *options, td_error *error);

/* Why automatic matches are fewer than the points. Left interest points are compared with every right pixel
 * of their band, not with right interest points alone: a point need not be detected twice. */
typedef struct td_match_tally {
    size_t left_points; /* interest points */
    size_t unseen;      /* no place in the band with enough ZNCC, or the window leaves the image */
    size_t ambiguous;   /* runner-up too near */
    size_t one_sided;   /* left-right check failed */
    size_t unrefined;   /* no sub-pixel solution */
    size_t unsure;      /* a sigma above most_sigma_px */
} td_match_tally;
/* *matches is (count), in the order of the left interest points. TD_OK with none: see `tally`. */
TD_API td_status td_match_automatic(td_match **matches, size_t *count, td_match_tally *tally,
                                    const td_pair *pair, const td_image *left, const td_image *right,
                                    const td_match_options *options, td_error *error);

/* Symmetric least-squares matching (Gruen 1985; symmetric as Nehab et al. 2005 ask): both windows are warped
 * by half of the affine difference, gain and offset free. Writes match->right, covariance, refined. The
 * covariance is that of the images' noise, estimated from the windows' residuals, through the normal
 * equations, with what interpolation does to the noise. False, match untouched: diverged, left the window, or
 * texture in one direction only. */
TD_API bool td_match_refine(td_match *match, const td_image *left, const td_image *right, int half_window);

#ifdef __cplusplus
}
#endif
#endif
