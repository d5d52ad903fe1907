/* The closed forms of the literature, each run and each judged: none is trusted. */
#ifndef TELEDIMOS_CALIB_HAND_EYE_SOLVERS_H
#define TELEDIMOS_CALIB_HAND_EYE_SOLVERS_H

#include "hand_eye.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_hand_eye_solver {
    TD_SOLVER_TSAI,       /* Tsai and Lenz 1989 */
    TD_SOLVER_PARK,       /* Park and Martin 1994 */
    TD_SOLVER_HORAUD,     /* Horaud and Dornaika 1995 */
    TD_SOLVER_ANDREFF,    /* Andreff, Horaud and Espiau 1999 */
    TD_SOLVER_DANIILIDIS, /* Daniilidis 1999 */
    TD_SOLVER_SHAH,       /* Shah 2013: X and Z */
    TD_SOLVER_LI,         /* Li, Wang and Wu 2010: X and Z */
    TD_SOLVER_VISP,       /* ViSP's vpHandEyeCalibration */
    TD_SOLVER_COUNT
} td_hand_eye_solver;

TD_API const char *td_hand_eye_solver_name(td_hand_eye_solver solver); /* "tsai", … */

typedef struct td_solver_score {
    td_hand_eye_solver solver;
    bool failed;
    char why[160];                  /* "no number", "84 degrees of scatter: …", "not installed"; "" */
    td_pose x, z;                   /* Z of solvers that give X alone: the mean over the views */
    double rms_px;                  /* of reprojection; filled in by the caller (NaN here) */
    double scatter_mm, scatter_deg; /* RMS of the target's place over the views, seen through X */
} td_solver_score;

/* Runs all; `score` in the order of the enum. A solver fails when it throws, gives no rotation or no number,
 * or scatters far more than the best does. */
TD_API td_status td_hand_eye_solvers_run(td_solver_score score[TD_SOLVER_COUNT], td_hand_eye_setup setup,
                                         const td_hand_eye_view *view, size_t count, td_error *error);
/* Index of the best that did not fail by scatter, -1 if none. */
TD_API int td_hand_eye_solvers_best(const td_solver_score score[TD_SOLVER_COUNT]);

#ifdef __cplusplus
}
#endif
#endif
