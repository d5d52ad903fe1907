/* Options and checks that guided and automatic matching share. */
#include "recon/match.h"

#include <math.h>

#include "recon/match_internal.h"

enum { LARGEST_HALF_WINDOW = 50 }; /* sums of products stay below 2^31 */

td_match_options td_match_options_default(void)
{
    td_match_options o = {.half_window = 7,
                          .near_m = 0.5,
                          .far_m = INFINITY,
                          .least_zncc = 0.7,
                          .uniqueness = 0.95,
                          .candidates = 8,
                          .interest = td_interest_options_default()};
    o.interest.count = 2000;
    o.interest.even = true;
    o.most_sigma_px = 0.1;
    return o;
}

td_status td_match_options_check(const td_match_options *o, td_error *error)
{
    if (o->half_window < 1 || o->half_window > LARGEST_HALF_WINDOW)
        return td_fail(error, TD_ERROR_ARGUMENT, "half_window: must be 1 to %d px, not %d",
                       LARGEST_HALF_WINDOW, o->half_window);
    if (!(o->near_m > 0 && isfinite(o->near_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "near_m: must be above 0 m, not %g", o->near_m);
    if (!(o->far_m > o->near_m))
        return td_fail(error, TD_ERROR_ARGUMENT, "far_m: must be beyond near_m (%g m), not %g", o->near_m,
                       o->far_m);
    if (!(o->band_px >= 0 && o->band_px <= 1000))
        return td_fail(error, TD_ERROR_ARGUMENT, "band_px: must be 0 (from the rig) to 1000 px, not %g",
                       o->band_px);
    if (!(o->least_zncc >= -1 && o->least_zncc < 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "least_zncc: must be -1 to 1, not %g", o->least_zncc);
    if (!(o->uniqueness > 0 && o->uniqueness <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "uniqueness: must be above 0 and not above 1, not %g",
                       o->uniqueness);
    if (o->candidates < 1 || o->candidates > 1000)
        return td_fail(error, TD_ERROR_ARGUMENT, "candidates: must be 1 to 1000, not %zu", o->candidates);
    if (o->threads < 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "threads: must be 0 (one per processor) or more, not %d",
                       o->threads);
    return TD_OK;
}

static td_status check_image(const td_rig_camera *camera, const td_image *image, const char *side,
                             td_error *error)
{
    if (image->channels != 1)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s image: has %d channels; matching needs a grey one", side,
                       image->channels);
    if (image->width != camera->camera.width || image->height != camera->camera.height)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "%s image: %d x %d pixels, but camera %s of the rig has %d x %d; give the images the rig "
            "was calibrated for",
            side, image->width, image->height, camera->name, camera->camera.width, camera->camera.height);
    return TD_OK;
}

td_status td_match_images_check(const td_pair *pair, const td_image *left, const td_image *right,
                                td_error *error)
{
    TD_TRY(check_image(&pair->rig->camera[pair->left], left, "left", error));
    return check_image(&pair->rig->camera[pair->right], right, "right", error);
}

double td_match_band_px(const td_pair *pair, int i, int j, const td_match_options *options)
{
    const double left[2] = {i, j};
    double right[2];
    if (options->band_px > 0) return options->band_px;
    const double depth =
        isfinite(options->far_m) ? sqrt(options->near_m * options->far_m) : 4 * options->near_m;
    if (!td_pair_transfer(right, NULL, NULL, pair, left, depth)) return 1;
    const double sigma = td_pair_residual_sigma(pair, left, right);
    return isnan(sigma) ? 1 : fmax(1, 3 * sigma);
}
