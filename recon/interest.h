/* Interest points: where the signal changes in two directions (Harris and Stephens 1988), improved as Schmid,
 * Mohr and Bauckhage (2000) found most repeatable: derivatives of a Gaussian instead of differences. */
#ifndef TELEDIMOS_RECON_INTEREST_H
#define TELEDIMOS_RECON_INTEREST_H

#include <stdbool.h>

#include "../core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_interest_point {
    double x, y;     /* px, to a fraction of a pixel */
    double response; /* Harris' det(A) - k trace(A)^2 of the smoothed structure tensor A (grey levels^4/px^4),
                        over C^contrast; C (grey levels^2/px^2) is the mean squared gradient around the point
                        (Gaussian, 24 px) + 0.2 times that of the image */
} td_interest_point;

/* The defaults repeat best at the same number of points (tests/recon/test_interest.c): smaller Gaussians than
 * that paper's 1 and 2 px see more under a change of scale and of viewpoint, and points ranked by contrast
 * with their surroundings keep their rank when light and viewpoint change. */
typedef struct td_interest_options {
    size_t count;             /* at most; default 500 */
    double sigma_derivative;  /* px, 0.4 to 16, of the Gaussian whose derivatives are taken; default 0.7 */
    double sigma_integration; /* px, 0.4 to 16, of the window of A; default 1.4 */
    double k;                 /* 0.01 to 0.24; default 0.06 */
    double contrast;          /* 0 (Harris' own order) to 2 (gain and gamma cancel); default 1.5 */
    double distance_px;       /* no two points nearer; default 5 */
    double quality; /* Harris' response over the image's largest, below which is no point; default 1e-4 */
    bool even;   /* spread evenly over the image (suppression radius of each point: Brown, Szeliski and Winder
                    2005) rather than by response alone, which repeats better; default false */
    int threads; /* 0 (default): one per processor; the result does not depend on it */
} td_interest_options;
TD_API td_interest_options td_interest_options_default(void);

/* *points is (count), strongest first (even: most isolated first), to be freed with free(). A featureless
 * image has none: TD_OK. The image is grey. */
TD_API td_status td_interest_points(td_interest_point **points, size_t *count, const td_image *image,
                                    const td_interest_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
