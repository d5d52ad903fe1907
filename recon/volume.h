/* Between two elevation maps: cut and fill with an honest sigma, profile, slope, difference.
 *
 * Differences d = after - before carry errors that neighbouring cells share. Model: d_i = change_i + s + n_i,
 * with one shift s of the whole map (sigma_shift) and noise n_i of the cell's own sigma_i (both maps'
 * together; where a map has none: the robust scatter of d where nothing changed), correlated as exp(-r^2 /
 * correlation_m^2) over the distance r. A sum over cells with weights w_i then has the variance
 *
 *   area^2 (sum_ij w_i w_j sigma_i sigma_j exp(-r_ij^2 / correlation_m^2) + (sum_i w_i)^2 sigma_shift^2);
 *
 * where a sigma_i counts up to twice the median around it, and what it is beyond that, as at the edge of a
 * stone, is the cell's own. Taken as independent, the cells would give a sigma too small by sqrt(pi) correlation_m / cell_m. Noise of
 * another shape is given the correlation_m of the same correlation area, which is what counts in large sums.
 *
 * Cut and fill. Summed by sign, noise alone would be both: 0.4 sigma for every cell. So places are told apart
 * first: a place has changed if a cell of it differs by 5 sigma; it goes on over neighbours that differ by 2
 * sigma to the same side; and a margin of 2 correlation_m (at least four cells) belongs to it, each cell to
 * the nearest place. Over a place all differences are summed with their signs: its slopes, which fade into
 * the noise, are whole, and the noise averages out. What is left is no place's: `rest_m3`, nought within its
 * sigma unless something changed widely by less than 5 sigma, or one map is shifted. */
#ifndef TELEDIMOS_RECON_VOLUME_H
#define TELEDIMOS_RECON_VOLUME_H

#include "../core/elevation.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_volume_options {
    const double (*polygon)[2]; /* region of the site, m; NULL: all cells known in both. A cell is inside when
                                   its centre is (even-odd; half-open, so that neighbours share no cell) */
    size_t polygon_count;
    double correlation_m; /* of the cells' noise: 1/e there; 0 (default): estimated from the difference where
                             nothing changed (robust variogram), else two cells. Of a hundred patches of noise
                             it comes out 6 % long (sigma as much too large), of more by less */
    double
        common_m; /* sigma of a shift of one whole map against the other; default 0; NaN: the shift is
                     estimated where nothing changed (outside the polygon, if there is one) and taken off */
} td_volume_options;
TD_API td_volume_options td_volume_options_default(void);

typedef struct td_volume {
    double cut_m3, fill_m3, net_m3; /* cut: lower after; net: of all cells = fill - cut + rest */
    double sigma_cut_m3, sigma_fill_m3, sigma_net_m3;
    double rest_m3, sigma_rest_m3;                /* signed, of the cells of no place that changed */
    double area_m2, changed_m2;                   /* compared; differing by more than 3 sigma */
    double correlation_m, shift_m, sigma_shift_m; /* what was found or given */
    double scatter; /* robust spread of d where nothing changed, over the cells' sigma: 1 if that is honest;
                       NaN: the maps have no sigma, or nothing is unchanged */
    double noise_m; /* median sigma of a cell's difference */
    size_t cells, missing; /* compared; of the region, not known in both */
} td_volume;
/* Grids of another origin or cell are resampled to `before`'s (bilinear, sigma as td_elevation_at). Refused:
 * no cell in common, other frames or CRS, a polygon or options that are none, a negative sigma; a shift to be
 * estimated from fewer than 100 unchanged cells. `difference` (may be NULL): after - before, less the shift
 * found, with its sigma. */
TD_API td_status td_volume_between(td_volume *volume, td_elevation **difference, const td_elevation *before,
                                   const td_elevation *after, const td_volume_options *options,
                                   td_error *error);

/* Heights along a line every `step_m`, the last at `to`: (count) distance, height and sigma as
 * td_elevation_at; NaN where the map knows none. To be freed with free(). Refused: a line of no length, a
 * step that is none or makes more than 10 million points, a line that meets no known cell. */
typedef struct td_profile_point {
    double distance_m, height_m, sigma_m;
} td_profile_point;
TD_API td_status td_elevation_profile(td_profile_point **profile, size_t *count, const td_elevation *map,
                                      const double from[2], const double to[2], double step_m,
                                      td_error *error);
/* Slope (rad, steepest: atan |grad z|) of each cell and its sigma, as a map whose height is the slope:
 * central differences, one-sided beside unknown cells, unknown without a neighbour along x or y. Sigma takes
 * the neighbours' errors as independent; those that they share would cancel, so it is rather too large.
 * Refused: no cell with a slope. */
TD_API td_status td_elevation_slope(td_elevation **slope, const td_elevation *map, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
