/* A motion that tells much of a machine's inertias and frictions, to be recorded for td_identify.
 *
 * Each joint's rate is a finite Fourier series over the motion's duration, 0 at its start and end (Swevers
 * and others 1997); it begins and ends at `start`. Positions, rates, accelerations, flows and the height of
 * the links' origins stay within limits. Searched, from a seed, is the largest determinant of what forces of
 * known noise tell of the base parameters, each in its size. The base is taken to stand still. */
#ifndef TELEDIMOS_SIM_EXCITATION_H
#define TELEDIMOS_SIM_EXCITATION_H

#include <stdint.h>

#include "../core/progress.h"
#include "identification.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_EXCITATION_HARMONICS = 8 };

typedef struct td_excitation_options {
    double duration_s; /* default 20 */
    double share;      /* of speed, acceleration and flow limits used; default 0.7 */
    double margin;     /* to the stops, as a share of the range; default 0.05 */
    double lowest_m;   /* of links' origins over the root's; default 0.5 on a suspension,
                          else -INFINITY */
    double sigma_force[TD_ROBOT_MAX_JOINTS]; /* N, motors N m; default: 1 % of the limit */
    int steps;                               /* of the search; default 600 */
    uint64_t seed;
} td_excitation_options;
TD_API td_excitation_options td_excitation_options_default(const td_robot *robot);

typedef struct td_excitation {
    double duration_s;
    int joints;
    double start[TD_ROBOT_MAX_JOINTS];                         /* rad or m */
    double sine[TD_ROBOT_MAX_JOINTS][TD_EXCITATION_HARMONICS]; /* rad/s or m/s */
    double cosine[TD_ROBOT_MAX_JOINTS][TD_EXCITATION_HARMONICS];
    double condition; /* of the regressor, each parameter in its size */
} td_excitation;

/* `model`: what is identified (gravity, frictions, sizes). Refused, naming it: options out of range, a robot
 * that td_dynamics refuses, limits that leave no room. */
TD_API td_status td_excitation_propose(td_excitation *excitation, const td_robot *robot,
                                       const td_identification_options *model,
                                       const td_excitation_options *options, const td_progress *progress,
                                       td_error *error);
/* Position, rate and acceleration (joints each; may be NULL) at t in [0, duration]. */
TD_API void td_excitation_at(double *position, double *rate, double *acceleration,
                             const td_excitation *excitation, double t);

#ifdef __cplusplus
}
#endif
#endif
