/* Between two elevation maps: cut and fill with an honest sigma, profile, slope, difference.
 *
 * Errors of neighbouring cells are correlated: noise over `correlation_m`, calibration over the whole map.
 * Summed as if independent they would be far too small. */
#ifndef TELEDIMOS_RECON_VOLUME_H
#define TELEDIMOS_RECON_VOLUME_H

#include "../core/elevation.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_volume_options {
    const double (*polygon)[2]; /* region of the site, m; NULL: all cells known in both */
    size_t polygon_count;
    double correlation_m; /* of the cells' noise; 0 (default): estimated from the difference where nothing
                             changed (variogram), else two cells */
    double common_m; /* sigma of a shift of one whole map against the other; default 0; NaN: estimated from
                        the cells outside the polygon, or that changed by less than 3 sigma */
} td_volume_options;
TD_API td_volume_options td_volume_options_default(void);

typedef struct td_volume {
    double cut_m3, fill_m3, net_m3; /* cut: lower after; net = fill - cut */
    double sigma_cut_m3, sigma_fill_m3, sigma_net_m3;
    double area_m2, changed_m2;                   /* compared; changed by more than 3 sigma */
    double correlation_m, shift_m, sigma_shift_m; /* what was found or given */
    size_t cells, missing;                        /* compared; of the region, not known in both */
} td_volume;
/* Grids of another origin or cell are resampled to `before`'s (bilinear). Refused: no cell in common, other
 * frames or CRS. `difference` (may be NULL): after - before with its sigma. */
TD_API td_status td_volume_between(td_volume *volume, td_elevation **difference, const td_elevation *before,
                                   const td_elevation *after, const td_volume_options *options,
                                   td_error *error);

/* Heights along a line, every `step_m`: (count) distance, height, sigma; to be freed with free(). */
typedef struct td_profile_point {
    double distance_m, height_m, sigma_m;
} td_profile_point;
TD_API td_status td_elevation_profile(td_profile_point **profile, size_t *count, const td_elevation *map,
                                      const double from[2], const double to[2], double step_m,
                                      td_error *error);
/* Slope (rad, steepest) of each cell and its sigma, as a map whose height is the slope. */
TD_API td_status td_elevation_slope(td_elevation **slope, const td_elevation *map, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
