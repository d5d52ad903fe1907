/* The elevation map of a site from many frames of a moving base.
 *
 * A cell is a Kalman filter of a height. Its error has two parts that are kept apart: noise, which averages
 * out over measurements, and calibration (of the rig, and of the base's pose where frames share it), which
 * does not. A measurement that contradicts the cell (Mahalanobis distance above the gate) is not believed at
 * once; when N frames in a row say the same, the ground has changed, and the cell begins anew. A ray that
 * passes well below a cell's height says that what stood there is gone (visibility).
 *
 * Memory: tiles of 128 x 128 cells, made where something is measured; beyond a limit the least recently used
 * are kept in a folder. */
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
    double gate_sigma;        /* default 3 */
    int believe_frames;       /* N; default 3 */
    double correlation_px;    /* neighbouring pixels share their error over so many pixels; default 5 */
    size_t memory_bytes;      /* of tiles; default 1 GiB */
    const char *folder;       /* where tiles go beyond it; NULL: refused then */
    char frame[TD_NAME_SIZE]; /* default "site" */
    int threads;              /* 0: one per processor; the result does not depend on it */
} td_fusion_options;
TD_API td_fusion_options td_fusion_options_default(void);

typedef struct td_fusion td_fusion;
TD_API td_status td_fusion_new(td_fusion **fusion, const td_fusion_options *options, td_error *error);
TD_API void td_fusion_free(td_fusion **fusion);

/* What is known before: cells of provenance prior, with their sigma (or `sigma_m` where the map has none). */
TD_API td_status td_fusion_prior(td_fusion *fusion, const td_elevation *prior, double sigma_m,
                                 td_error *error);

/* One frame: disparities of the rectified left image (those masked are NaN), where the rig stood, and how
 * sure that is: pose_covariance (6,6) of site_from_rig, or NULL. */
typedef struct td_fusion_frame {
    const td_depth_camera *camera;
    const td_disparity *disparity;
    td_pose site_from_rig;
    const double *pose_covariance;
    double time_s;
} td_fusion_frame;
typedef struct td_fusion_tally {
    size_t points, cells, new_cells, gated, reset, cleared;
} td_fusion_tally;
TD_API td_status td_fusion_add(td_fusion *fusion, const td_fusion_frame *frame, td_fusion_tally *tally,
                               td_error *error);

/* The map so far; sigma holds noise and calibration together. `noise` (may be NULL) is given a map whose
 * sigma is the noise alone. */
TD_API td_status td_fusion_map(td_elevation **map, td_elevation **noise, const td_fusion *fusion,
                               td_error *error);
TD_API size_t td_fusion_memory(const td_fusion *fusion); /* bytes of tiles in memory */

/* The whole state, to go on from after a kill: one file, whole or not at all. */
TD_API td_status td_fusion_save(const td_fusion *fusion, const char *path, td_error *error);
TD_API td_status td_fusion_load(td_fusion **fusion, const td_fusion_options *options, const char *path,
                                td_error *error);

#ifdef __cplusplus
}
#endif
#endif
