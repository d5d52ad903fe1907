/* A first estimate of a camera and of the target's poses, good enough for the joint refinement to start from.
 */
#ifndef TELEDIMOS_CALIB_FIRST_ESTIMATE_H
#define TELEDIMOS_CALIB_FIRST_ESTIMATE_H

#include "observations.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_estimate_method {
    TD_ESTIMATE_AUTO,             /* homographies for flat targets, Faugeras-Toscani for targets with depth */
    TD_ESTIMATE_HOMOGRAPHY,       /* plane homographies (Zhang 2000) */
    TD_ESTIMATE_VISP,             /* virtual visual servoing (ViSP; Marchand and Chaumette 2002) */
    TD_ESTIMATE_FAUGERAS_TOSCANI, /* perspective matrix of a target with depth */
    TD_ESTIMATE_COUNT
} td_estimate_method;

TD_API const char *td_estimate_method_name(td_estimate_method method); /* NULL if none */
TD_API td_estimate_method td_estimate_method_from_name(const char *name);

/* Estimates `camera` (model and size are given; with `keep_camera` its parameters are kept and only poses are
 * found) and camera_from_target (views) for the views in which camera `index` saw the target; `has_pose`
 * (views) tells which. Views of known heights are one rigid target and get the same pose. */
TD_API td_status td_first_estimate(td_camera *camera, td_pose *camera_from_target, bool *has_pose,
                                   const td_observations *observations, int index, td_estimate_method method,
                                   bool keep_camera, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
