/* The parts of `teledimos hand-eye`. */
#ifndef TELEDIMOS_APPS_HAND_EYE_INTERNAL_H
#define TELEDIMOS_APPS_HAND_EYE_INTERNAL_H

#include <jansson.h>

#include "apps/gate.h"
#include "calib/calibrate.h"
#include "calib/hand_eye.h"
#include "calib/hand_eye_mistakes.h"
#include "calib/hand_eye_solvers.h"
#include "calib/lens_check.h"
#include "calib/view_poses.h"
#include "core/dataset.h"
#include "core/schema.h"

/* How the job is done. */
typedef struct hand_eye_how {
    td_hand_eye_setup setup;
    td_robot_model model;
    const char *rig;      /* file of the cameras' calibration; NULL: the dataset's, or from its images */
    bool free_intrinsics; /* calibrate again from the images although a rig is given */
    bool find_lens;       /* take in the distortion that the views tell of */
    const char *offset;   /* "auto", "none" or seconds */
    bool advise;
    int threads;
    double outlier_sigma;
    const td_progress *progress;
    const td_log *log;
} hand_eye_how;

typedef struct hand_eye_job {
    const td_dataset *dataset;
    const hand_eye_how *how;
    td_observations *observations; /* NULL: target poses were given */
    td_rig *rig;                   /* NULL with target poses */
    char rig_from[400];            /* where the rig comes from, in words */
    char lens[400];                /* distortion that the views tell of and the rig has not, in words; "" */
    double moved_sigma;            /* free intrinsics: how far they moved, in sigmas; NaN */

    size_t count;
    td_hand_eye_view *view; /* (count) */
    size_t *source;         /* (count) view of the observations */
    bool has_offset;
    double offset_s, sigma_offset_s;

    td_solver_score solver[TD_SOLVER_COUNT];
    int best;            /* of the solvers; -1 */
    td_hand_eye *result; /* NULL: refused before a solution */
    td_hand_eye *plain;  /* plain least squares, for comparison; NULL: none */
    size_t mistake_count;
    td_hand_eye_mistake mistake[TD_MAX_MISTAKES];
    bool has_advice;
    td_hand_eye_advice advice;

    double *rms_px, *held_out_px;           /* (count) of each view; NaN without images */
    double total_rms_px, total_held_out_px; /* over the used views' points */
    double floor_px, floor_mm, floor_deg;   /* of leave-one-out: what the robot's noise alone leaves */
    gate_result gate;
} hand_eye_job;

/* hand_eye_views.c: cameras, poses of the target and of the robot, paired. */
td_status hand_eye_views(hand_eye_job *job, td_error *error);
/* Root mean square distance, px, of a view's points when the target stands at `rig_from_target`. */
double hand_eye_view_rms(const hand_eye_job *job, size_t view, const td_pose *rig_from_target);

/* hand_eye_solve.c */
td_status hand_eye_solve(hand_eye_job *job, td_error *error);
void hand_eye_free(hand_eye_job *job);

/* hand_eye_result.c */
extern const gate_row hand_eye_gate_defaults[];
extern const size_t hand_eye_gate_count;
void hand_eye_judge(hand_eye_job *job, const gate_row *rows);
extern const td_schema_row hand_eye_schema[];
extern const size_t hand_eye_schema_count;
json_t *hand_eye_result(const hand_eye_job *job);

/* hand_eye_report.c */
void hand_eye_table(const hand_eye_job *job);
td_status hand_eye_report(const hand_eye_job *job, const char *path, td_error *error);

/* hand_eye_init.c: a dataset to fill in. */
td_status hand_eye_init(const char *folder, td_hand_eye_setup setup, td_error *error);

#endif
