/* What the files of the localisation share. */
#ifndef TELEDIMOS_RECON_LOCALISATION_INTERNAL_H
#define TELEDIMOS_RECON_LOCALISATION_INTERNAL_H

#include "localisation.h"

/* ---- the map: localisation_map.c ---- */

/* The map averaged over squares of 2 radius + 1 cells, with slopes. */
typedef struct td_ground_level {
    const td_elevation *map;
    int radius;
    float *height;      /* (rows,columns) m; NaN: too few known cells around */
    float *slope[2];    /* (rows,columns) along x and y; NaN */
    double slope_noise; /* variance of a slope over that of a height, 1/m^2 */
    double map_sigma_m, correlation_m;
    double beside; /* correlation of the noise of neighbouring cells */
} td_ground_level;

td_status td_ground_level_new(td_ground_level *level, const td_elevation *map, int radius, double map_sigma_m,
                              double correlation_m, td_error *error);
void td_ground_level_free(td_ground_level *level);
/* Height, slopes and variance of a height at (x, y); false: not known there. */
bool td_ground_at(double *height, double slope[2], double *variance, const td_ground_level *level, double x,
                  double y);

/* ---- the frame's points ---- */

/* Mean of a block of pixels. */
typedef struct td_block {
    double p[3];     /* m, rig's frame */
    double axis[3];  /* m: its standard deviation along the ray */
    int column, row; /* in the grid of blocks */
} td_block;

/* ---- the fit: localisation_fit.c ---- */

typedef struct td_registration {
    const td_block *block;
    size_t count, step; /* every step-th block is looked at */
    const td_ground_level *level;
    double unevenness; /* m: of the ground against its smoothed level */
} td_registration;

typedef struct td_fit_state {
    double cost;    /* mean of rho at a spread of 1, so that costs compare; 1: no known points */
    double scatter; /* robust spread of residual / sigma, at least 1 in the fit */
    size_t known, used;
    double rms_m;
} td_fit_state;

/* Moves the pose to the nearest minimum, and says how it fits there. */
td_status td_register(td_pose *pose, td_fit_state *state, const td_registration *r, int iterations,
                      td_error *error);
/* Covariance at the minimum, of the perturbation in the site and of the one about the rig; `weak` (2^6: rx …
 * z) says what is not told within the limits. */
td_status td_register_covariance(td_localisation *found, unsigned *weak, const td_registration *r,
                                 const td_localisation_options *options, td_error *error);

#endif
