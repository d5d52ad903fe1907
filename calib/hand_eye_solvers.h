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

TD_API const char *td_hand_eye_solver_name(td_hand_eye_solver solver); /* "tsai", …; NULL if none */

typedef struct td_solver_score {
    td_hand_eye_solver solver;
    bool failed;
    char why[160]; /* "no number", "no rotation", "84.1 degrees of scatter: …", "not installed: …"; "" */
    td_pose x, z;  /* Z of solvers that give X alone: the mean over the views; identities without a result */
    double rms_px; /* of reprojection; filled in by the caller (NaN here) */
    double scatter_mm,
        scatter_deg;       /* RMS over the views of the target's place, seen through X, about Z; NaN */
    double scatter_all_mm; /* both as one: the root of the sum of squares of scatter_mm and of scatter_deg's
                              arc at the target's usual distance from the cameras; NaN */
} td_solver_score;

/* More views than this are thinned out evenly before the solvers see them: they look at all pairs of views,
 * as equals. Scatter is over all views. */
enum { TD_SOLVERS_MAX_VIEWS = 60 };

/* Runs all; `score` in the order of the enum. A solver fails when it throws, gives no rotation or no number,
 * or scatters more than twice as far as the best does. TD_ERROR_DATA when the motion determines
 * nothing, whatever the solver: fewer than three views, a hand that does not turn, or turns about parallel
 * axes only. */
TD_API td_status td_hand_eye_solvers_run(td_solver_score score[TD_SOLVER_COUNT], td_hand_eye_setup setup,
                                         const td_hand_eye_view *view, size_t count, td_error *error);
/* Index of the best that did not fail, by scatter_all_mm; -1 if none. */
TD_API int td_hand_eye_solvers_best(const td_solver_score score[TD_SOLVER_COUNT]);

#ifdef __cplusplus
}
#endif
#endif
