/* Dense matching of a rectified pair: a disparity for each pixel of the left image, and how sure it is.
 *
 * Semi-global matching (Hirschmueller 2008): a census cost with a cut-off difference of grey values (the
 * exposures of the two cameras are compared first), summed along three paths, the winner refined to a
 * fraction of a pixel, checked from the right image, specks taken out, holes filled from the background's
 * side and marked.
 *
 * Matched pixels are then refined by the grey values themselves, and their sigma, the 68 % quantile of the
 * error's size, follows from the images' noise and texture, from what does not fit and from how far the rows
 * are apart (dense_refine.c). Without refinement it is fitted to real pairs from the shape of the cost, how
 * badly the winner fits, and how much the neighbours differ (dense_sigma.c): right on walls that face the
 * camera, too small on ground seen aslant. Of a filled pixel it is 1.5 px and more. The same input and
 * options give the same bytes on every processor, at any thread count. */
#ifndef TELEDIMOS_RECON_DENSE_H
#define TELEDIMOS_RECON_DENSE_H

#include <stdbool.h>

#include "../core/image.h"
#include "../core/log.h"
#include "../core/progress.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_dense_kind { TD_DENSE_NONE, TD_DENSE_MATCHED, TD_DENSE_FILLED } td_dense_kind;

typedef struct td_disparity {
    int width, height;
    float *value;  /* (height,width) px, x of the left pixel minus x of the right; NaN: none */
    float *sigma;  /* (height,width) px, standard deviation; NaN: none */
    uint8_t *kind; /* (height,width) td_dense_kind */
} td_disparity;

typedef enum td_dense_method {
    TD_DENSE_OURS,
    TD_DENSE_OPENCV /* its SGBM, 3WAY: a second opinion */
} td_dense_method;

typedef struct td_dense_options {
    td_dense_method method;
    int lowest;          /* smallest disparity, px; default 0 */
    int levels;          /* how many, px; default 128; a multiple of 16 is used, rounded up */
    bool fill;           /* default true */
    bool left_check;     /* default true */
    bool coarse_to_fine; /* ranges per tile from half the size; default: where it pays (96 levels and more) */
    bool refine; /* matched disparities by the grey values themselves: to a tenth of a pixel also on slopes
                    such as ground seen from aside, where the paths lag behind. Takes half as long as the
                    matching; default true */
    int speckle; /* areas of fewer pixels that differ from all around are taken out; default 50; 0: none */
    int threads; /* 0: one per processor; the result does not depend on it */
    const td_progress *progress;
    const td_log *log;
} td_dense_options;
TD_API td_dense_options td_dense_options_default(void);
TD_API td_status td_dense_options_check(const td_dense_options *options, td_error *error);

/* Images are grey, of one size, rows matching rows, else refused. Where nothing was matched at all, each
 * pixel is TD_DENSE_NONE. TD_ERROR_CANCELLED when the progress says so. */
TD_API td_status td_dense_match(td_disparity **disparity, const td_image *left, const td_image *right,
                                const td_dense_options *options, td_error *error);
TD_API void td_disparity_free(td_disparity **disparity);
/* Bytes that td_dense_match needs at most, its result included. */
TD_API size_t td_dense_memory(int width, int height, const td_dense_options *options);

#ifdef __cplusplus
}
#endif
#endif
