/* Do the images belong to the rig as its covariance has it? Not whether matches lie on their epipolar curves
 * at all, which a rig that is ten of its own sigma off may still let them, but whether they lie off them by
 * more than the rig's own uncertainty explains.
 *
 * Whitened by the covariance, C = R R^T, the rig is off by z ~ N(0, I). Distances from the curves are d = A z
 * + e with A = (derivatives) R and noise e of s px, that is taken from what no z explains. Then b = A^T d /
 * s^2 ~ N(0, M^2 + M), M = A^T A / s^2, and along each eigenvector of M with eigenvalue mu
 *
 *   c = (u^T b) / sqrt(mu^2 + mu) ~ N(0, 1).
 *
 * Directions that the images show better than the covariance knows them (mu above 4) are taken; the sum of
 * their c^2 is chi-squared. A rig that is off by k sigma makes it k^2 as large. Errors along the curves,
 * which move depths, leave it as it is: such are seen only as far as they come with others, as in the
 * covariance of a calibration they do. */
#ifndef TELEDIMOS_RECON_RIG_BELIEF_H
#define TELEDIMOS_RECON_RIG_BELIEF_H

#include "match.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_rig_belief td_rig_belief;
/* The pair, and its rig, are borrowed. Refused: a rig without a covariance. */
TD_API td_status td_rig_belief_new(td_rig_belief **belief, const td_pair *pair, td_error *error);
TD_API void td_rig_belief_free(td_rig_belief **belief);
/* More matches, of any images of this pair. */
TD_API td_status td_rig_belief_add(td_rig_belief *belief, const td_match *match, size_t count,
                                   td_error *error);
/* Forgets the matches. */
TD_API void td_rig_belief_clear(td_rig_belief *belief);

typedef struct td_rig_belief_result {
    size_t matches, inliers;
    double noise_px;      /* robust standard deviation of what no error of the rig explains */
    int freedom;          /* directions of the rig that are seen */
    double sigmas, limit; /* sqrt(chi-squared / freedom), about 1 for a rig that is believed rightly; what one
                             such in ten thousand exceeds */
} td_rig_belief_result;
/* Refused: fewer than 30 matches. */
TD_API td_status td_rig_belief_check(td_rig_belief_result *result, const td_rig_belief *belief,
                                     td_error *error);

#ifdef __cplusplus
}
#endif
#endif
