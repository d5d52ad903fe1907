/* Rigs as they may truly be: drawn from a rig's covariance. */
#ifndef TELEDIMOS_CORE_RIG_DRAW_H
#define TELEDIMOS_CORE_RIG_DRAW_H

#include "random.h"
#include "rig.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Moves parameters and poses by `step`, in the covariance's order (n); the first camera's pose stays. */
TD_API void td_rig_move(td_rig *rig, const double *step);
/* A copy moved by a draw from `times`^2 times its covariance, which it keeps. Refused: a rig without one, and
 * one that the draw makes no rig (td_rig_check). */
TD_API td_status td_rig_draw(td_rig **drawn, const td_rig *rig, double times, td_random *random,
                             td_error *error);

#ifdef __cplusplus
}
#endif
#endif
