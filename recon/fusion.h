/* The elevation map of a site from many frames of a moving base.
 *
 * A cell is a Kalman filter of a height: that of its square, the mean of the ground over it. Its error has
 * two parts that are kept apart:
 *   noise, which averages out over measurements: matching, and each frame's own pose;
 *   calibration of the rig, which does not: it is the same in every frame and is taken as fully correlated.
 * What is assumed of the noise: matching errors of one frame are those of white noise averaged over a square
 * of correlation_px; of two frames from one place (place_m) a share `repeat_share` of their variance is the
 * same error, for the same texture is seen the same way, and the pose's error is the same; of frames from two
 * places a share `elsewhere_share`, for the window rounds off the same ground, and nothing of the pose.
 *
 * The defaults of these four were measured on rendered sites at 3 m, 1280 x 960 px, baseline 0.4 m:
 *   8 px   the autocorrelation of refined disparities' errors falls nearly as a triangle that ends at 8 to 9
 *          px, the window's side, and the means of squares of any size scatter as for 8 px (6.4 px where
 *          there is little noise);
 *   0.5    the same place again, with other noise: errors are correlated by 0.3 to 0.5 under much noise (1.4
 *          grey levels), by 0.8 under little;
 *   0.3 m  from there on, a tenth of the distance, the correlation is down to a half or two thirds of that;
 *   0.2    moved by a fifth of the distance: 0.2; by 0.4 of it, and turned by half a radian: 0.1 to 0.2.
 *
 * Heights are taken along the vertical of the cell's centre, so that an error sideways counts as much as the
 * slope makes of it; where the points of a cell scatter far more than their noise (an edge, a stone) their
 * scatter counts too.
 *
 * A measurement that contradicts the cell (Mahalanobis distance above the gate) is not believed at once; when
 * N frames in a row say the same, the ground has changed, and the cell begins anew. A cell that N frames in a
 * row have looked through (rays to points measured behind it pass more than 3 sigma below its height) is
 * cleared. Nothing else ever changes a cell.
 *
 * Memory: tiles of 128 x 128 cells of 64 bytes, made where something is measured; beyond a limit the least
 * recently used are kept in a folder. 1 km^2 at 5 cm is 24649 tiles: 25.8 GB if all of it is measured. */
#ifndef TELEDIMOS_RECON_FUSION_H
#define TELEDIMOS_RECON_FUSION_H

#include "../core/elevation.h"
#include "../core/pose.h"
#include "depth_points.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_fusion_options {
    double cell_m;    /* default 0.05 */
    double region[4]; /* x_min, y_min, x_max, y_max, m, of the site; all 0 (default): as far as is measured */
    double gate_sigma;     /* default 3 */
    int believe_frames;    /* N; default 3 */
    double correlation_px; /* neighbouring pixels share their error over so many pixels; default 8 */
    double repeat_share;   /* of matching's variance that frames from one place have in common; default 0.5 */
    double elsewhere_share; /* and frames from two places, at most repeat_share; default 0.2 */
    double place_m;      /* frames whose camera moved by less, and turned by less than 0.35 rad, are from one
                            place; a tenth of the distance; default 0.3 */
    size_t memory_bytes; /* of tiles, at least one's; default 1 GiB */
    const char *folder;  /* of this map alone: where tiles go beyond it; NULL: refused then */
    char frame[TD_NAME_SIZE]; /* default "site" */
    int threads;              /* 0: one per processor; the result does not depend on it */
} td_fusion_options;
TD_API td_fusion_options td_fusion_options_default(void);
TD_API td_status td_fusion_options_check(const td_fusion_options *options, td_error *error);

typedef struct td_fusion td_fusion;
TD_API td_status td_fusion_new(td_fusion **fusion, const td_fusion_options *options, td_error *error);
TD_API void td_fusion_free(td_fusion **fusion);

/* What is known before: cells of provenance prior, with their sigma (or `sigma_m` where the map has none).
 * Refused after the first frame, and in another frame of reference. */
TD_API td_status td_fusion_prior(td_fusion *fusion, const td_elevation *prior, double sigma_m,
                                 td_error *error);

/* One frame: disparities of the rectified left image (those masked are NaN), where the rig stood, and how
 * sure that is: pose_covariance (6,6) of site_from_rig, or NULL. */
typedef struct td_fusion_frame {
    const td_depth_camera *camera;
    const td_disparity *disparity;
    td_pose site_from_rig;
    const double *pose_covariance;
    double time_s; /* NaN: not known */
} td_fusion_frame;
typedef struct td_fusion_tally {
    size_t points;    /* that fell into cells, but those seen in small part only */
    size_t cells;     /* measured by this frame: */
    size_t new_cells; /* of these: not known before */
    size_t gated;     /* of these: contradicted the cell, and not believed yet */
    size_t reset;     /* of these: believed now */
    size_t cleared;   /* others, which were looked through */
    size_t believed;  /* points in cells that were not gated, */
    double square_m2; /* and the sum of their squared heights above them, slope taken off, once fused */
} td_fusion_tally;
/* Disparities that are filled, not matched, are left out. A refused frame changes nothing; after a failure of
 * memory or of the folder the map is to be given up. `tally` may be NULL. */
TD_API td_status td_fusion_add(td_fusion *fusion, const td_fusion_frame *frame, td_fusion_tally *tally,
                               td_error *error);

/* The map so far, over the region or over the tiles that are known; sigma holds noise and calibration
 * together. `noise` (may be NULL) is given a map whose sigma is the noise alone. Refused: nothing known, or
 * more cells than a map may have. */
TD_API td_status td_fusion_map(td_elevation **map, td_elevation **noise, const td_fusion *fusion,
                               td_error *error);
/* The same of a rectangle x_min, y_min, x_max, y_max, m: a large site in parts. */
TD_API td_status td_fusion_map_of(td_elevation **map, td_elevation **noise, const td_fusion *fusion,
                                  const double region[4], td_error *error);
TD_API size_t td_fusion_memory(const td_fusion *fusion); /* bytes of tiles in memory */
/* Bytes that an area of so many m by m takes when all of it is known: in memory up to memory_bytes, else in
 * the folder. */
TD_API double td_fusion_memory_of(double width_m, double length_m, double cell_m);

/* Bytes that td_fusion_add needs at most besides, for a frame of this size. */
TD_API size_t td_fusion_frame_memory(int width, int height);

/* The whole state, to go on from after a kill: one file, whole or not at all. Loading refuses a damaged file,
 * and one made with other options, naming the first that differs (memory, folder and threads may). */
TD_API td_status td_fusion_save(const td_fusion *fusion, const char *path, td_error *error);
TD_API td_status td_fusion_load(td_fusion **fusion, const td_fusion_options *options, const char *path,
                                td_error *error);

#ifdef __cplusplus
}
#endif
#endif
