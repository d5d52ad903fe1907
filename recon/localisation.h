/* Where a frame was taken from, by the ground it sees: registration of its points to a map.
 *
 * Minimises sum rho((z - h(x, y)) / sigma) over the six unknowns of site_from_rig: h the map's height under
 * each point, sigma that of the point along the vertical of the ground and of the map together, rho Tukey's
 * biweight with the spread found (Zhang 1994 and Rusinkiewicz & Levoy 2001 for the iteration, with the
 * vertical instead of the nearest point, as maps are heights). The start may be off by search_m and
 * search_rad: starts around it are tried on a smoothed map, then followed to the full one.
 *
 * Covariance: H^-1 M H^-1, times the square of the scatter where that is above 1. M holds the correlation of
 * the errors: of neighbouring points, by the matcher's window, and of points over neighbouring cells of the
 * map. H is the normal matrix less what noise of the map's slopes puts into it: noise in a slope looks like
 * ground that would tell a place, and makes flat sites look well located (it does not move the minimum
 * itself: of noise, height and slope at a point are uncorrelated). Not in it: the rig's calibration, which
 * the map that the same rig made shares. */
#ifndef TELEDIMOS_RECON_LOCALISATION_H
#define TELEDIMOS_RECON_LOCALISATION_H

#include "../core/elevation.h"
#include "../core/pose.h"
#include "depth_points.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_localisation_options {
    double search_m, search_rad;         /* how far the start may be off, level and in heading; 1 and 0.15 */
    double correlation_px;               /* neighbouring pixels share their error over so many; default 9 */
    double map_correlation_m;            /* of the map's noise: 1/e there; 0 (default): two cells */
    double map_sigma_m;                  /* of cells whose sigma is not known; default 0.05 */
    double most_sigma_m, most_sigma_rad; /* a place known less well is refused; 0.15 and 0.03 */
    double least_share;                  /* of the frame's points that must lie on known cells; default 0.3 */
} td_localisation_options;
TD_API td_localisation_options td_localisation_options_default(void);
TD_API td_status td_localisation_options_check(const td_localisation_options *options, td_error *error);

typedef struct td_localisation {
    td_pose site_from_rig;
    double covariance[36]; /* of its perturbation (pose.h: on the left, in the site's frame) */
    double sigma[6];       /* rad, m: turns about the site's x, y, z axes through the rig, and its x, y, z */
    double scatter;        /* spread of the residuals over their sigma: 1 when both sigmas are honest */
    double rms_m;          /* of the residuals that count */
    double share;          /* of the points, that lay on known cells */
    size_t points;         /* means of correlation_px x correlation_px pixels */
} td_localisation;

/* Disparities of the rectified left image (masked: NaN), as td_fusion_add takes them. TD_ERROR_DATA, with
 * what was seen: too few points or too little of the map under them; ground that does not tell x, y or the
 * heading (flat, or ridges along one way), naming which; a fit that no pose makes good. */
TD_API td_status td_localise(td_localisation *found, const td_elevation *map, const td_depth_camera *camera,
                             const td_disparity *disparity, const td_pose *start,
                             const td_localisation_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
