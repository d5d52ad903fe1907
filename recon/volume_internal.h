/* What the files behind volume.h share: the difference on one grid, its noise, the places that changed. */
#ifndef TELEDIMOS_RECON_VOLUME_INTERNAL_H
#define TELEDIMOS_RECON_VOLUME_INTERNAL_H

#include <stdbool.h>

#include "recon/volume.h"

/* Cells row-major, as in the map. */
typedef struct volume_grid {
    int columns, rows;
    double cell_m;
    double *d;      /* after - before, m; NaN: not known in both */
    double *sigma;  /* of d without the shift, m; NaN: unknown */
    double *shared; /* the part of it that neighbours have in common */
    bool *guessed;  /* sigma is the spread of d, as the maps know none */
    bool some_guess;
    bool *region;       /* inside the polygon */
    bool *base;         /* where d is known and change is not expected: outside the polygon, else anywhere */
    signed char *place; /* -1: of a cut; 1: of a fill; 0: of none */
} volume_grid;

static inline size_t volume_cells(const volume_grid *g)
{
    return (size_t)g->columns * (size_t)g->rows;
}

/* ---- volume_region.c ---- */

/* Cells whose centre is inside. */
td_status volume_inside(bool *inside, const td_elevation *map, const double (*polygon)[2], size_t count,
                        td_error *error);

/* ---- volume_places.c ---- */

/* Fills `place` of the differences less `shift`, whose own sigma adds to the cells'. */
td_status volume_places(volume_grid *g, double shift, double sigma_shift, double correlation_m,
                        td_error *error);

/* ---- volume_noise.c ---- */

/* Reorders `value`; NaN of none. */
double volume_median(double *value, size_t count);

/* From the cells of `base` that belong to no place: robust spread of (d - middle) / sigma, or of d - middle
 * where sigma is zero, and the correlation length of the same area. NaN each: too few cells, or no noise. */
td_status volume_noise(double *spread, double *correlation_m, const volume_grid *g, double middle,
                       td_error *error);

/* sum_ij w_i w_j sigma_i sigma_j exp(-r_ij^2 / correlation_m^2); `ws` (cells) holds w sigma, 0 where unknown.
 */
td_status volume_variance(double *variance, const double *ws, const volume_grid *g, double correlation_m,
                          td_error *error);

#endif
