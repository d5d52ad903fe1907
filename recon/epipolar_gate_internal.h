/* The gate's residual, for its test. */
#ifndef TELEDIMOS_RECON_EPIPOLAR_GATE_INTERNAL_H
#define TELEDIMOS_RECON_EPIPOLAR_GATE_INTERNAL_H

#include "recon/epipolar_gate.h"

/* td_pair_residual and its derivative, px/rad, by a rotation of the right camera (left perturbation of its
 * camera_from_rig). */
bool td_epipolar_gate_residual(double *distance, double row[3], const td_pair *pair, const td_match *match);

#endif
