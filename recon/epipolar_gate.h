/* The first gate of every reconstruction: do the images belong to the rig? Robust matches must lie on their
 * epipolar curves; where they do not, the cameras have turned since the calibration, and by how much is said.
 */
#ifndef TELEDIMOS_RECON_EPIPOLAR_GATE_H
#define TELEDIMOS_RECON_EPIPOLAR_GATE_H

#include "match.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_epipolar_gate {
    size_t matches, inliers;
    double median_px;     /* of the signed distances, inliers */
    double rms_px;        /* robust: 1.4826 times the median absolute distance */
    double corrected_px;  /* rms_px after the rotation below */
    double rotation[3];   /* rad, left perturbation of the right camera's camera_from_rig that removes it; the
                             baseline's direction is held where the scene cannot tell the two apart */
    double covariance[9]; /* of it */
    bool determined;      /* false: too few matches, or spread too little */
} td_epipolar_gate;

/* Refused: fewer than 8 matches. */
TD_API td_status td_epipolar_gate_check(td_epipolar_gate *gate, const td_pair *pair, const td_match *match,
                                        size_t count, td_error *error);
/* The rig with the right camera turned by gate->rotation; its covariance widened by gate->covariance. */
TD_API td_status td_epipolar_gate_correct(td_rig **corrected, const td_epipolar_gate *gate,
                                          const td_pair *pair, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
