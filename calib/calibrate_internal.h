/* The stages of a calibration, in the order in which calibrate.c runs them. */
#ifndef TELEDIMOS_CALIB_CALIBRATE_INTERNAL_H
#define TELEDIMOS_CALIB_CALIBRATE_INTERNAL_H

#include "calib/bundle_internal.h"
#include "calib/calibrate.h"

/* rig_start.c: each camera alone, then their relative poses by consensus over the views. Puts right, in
 * `observations` (of which bundle->observations is the same), the numbering of views that were seen with the
 * board turned, drops views on which cameras disagree, and says so in the result's views. */
td_status td_rig_start(td_bundle *bundle, td_observations *observations, td_calibration *result,
                       const td_calibrate_options *options, td_error *error);

/* outliers.c: takes corners and views that do not fit out of use and names them; *changed when any were. */
td_status td_outliers_mark(bool *changed, td_bundle *bundle, td_calibration *result,
                           const td_calibrate_options *options, td_error *error);
/* Median length of a camera's used residuals as the standard deviation of one coordinate, px. */
double td_robust_noise(const td_bundle *bundle, int camera);

/* trust.c: the joint covariance, sigmas of everything, weak directions. */
td_status td_trust_covariance(td_calibration *result, td_bundle *bundle, const td_calibrate_options *options,
                              td_error *error);
/* What is held of the bundle's cameras and has a covariance in `from` (may be NULL), for
 * td_problem_covariance: at most 2 TD_RIG_MAX_CAMERAS of them, their matrices in `store`, TD_MAX_BLOCK_SIZE^2
 * each. *known: nothing that is held lacks a covariance. */
size_t td_trust_considered(td_consider *out, double *store, bool *known, const td_bundle *bundle,
                           const td_bundle_blocks *blocks, const td_rig *from);
/* Significance of the warp: w^T C^-1 w, chi-square with 2 degrees of freedom. */
td_status td_trust_warp(double *chi2, td_bundle *bundle, td_error *error);

/* leave_one_out.c */
td_status td_leave_one_out_run(td_leave_one_out *result, const td_bundle *bundle,
                               const td_calibrate_options *options, td_error *error);

#endif
