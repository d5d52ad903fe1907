/* The parts of `teledimos reconstruct`. */
#ifndef TELEDIMOS_APPS_RECONSTRUCT_INTERNAL_H
#define TELEDIMOS_APPS_RECONSTRUCT_INTERNAL_H

#include <jansson.h>

#include "apps/gate.h"
#include "apps/job.h"
#include "core/dataset.h"
#include "core/hash.h"
#include "core/robot.h"
#include "recon/epipolar_gate.h"
#include "recon/fusion.h"

enum { FRAME_REASON_SIZE = 400 };

/* How a frame's place was found. */
typedef enum reconstruct_place { PLACE_GIVEN, PLACE_TAGS, PLACE_MAP, PLACE_UNKNOWN } reconstruct_place;

/* One frame: what is known before, and what became of it. */
typedef struct reconstruct_frame {
    const char *name, *image[2];
    double time_s;         /* NaN: not given */
    double skew_s;         /* right camera's time minus the left's; 0: not given */
    td_pose site_from_rig; /* where the rig stood, once `place` is known */
    reconstruct_place place;
    double pose_covariance[36]; /* of site_from_rig, where it was found */
    double pose_sigma[6];       /* rad, m: turns about the site's axes through the rig, and its x, y, z */
    td_pose vehicle_from_rig;   /* of the robot's root, with the joints as they stood */
    const double *q;            /* (joints); NULL: no robot */
    bool done, failed;
    char reason[FRAME_REASON_SIZE]; /* why it failed */
    char sha256[TD_HASH_HEX_SIZE];  /* of both images */
    double matched;                 /* share of pixels with a disparity */
    double masked;                  /* share of pixels that see the machine itself */
    double epipolar_px;             /* NaN: not looked at */
    td_fusion_tally tally;
    double seconds;
} reconstruct_frame;

/* What was asked for. */
typedef struct reconstruct_how {
    const char *rig, *prior, *output;
    const double
        *start; /* x, y, z of the base, m, and its heading, rad, before the first frame; NULL: unknown */
    int camera[2];
    double near_m, far_m, prior_sigma_m;
    td_dense_options dense;
    td_fusion_options fusion;
    int gate_every; /* frames whose epipolar residual is looked at: the first, and each so many; 0: none */
    const td_progress *progress;
    const td_log *log;
} reconstruct_how;

typedef struct reconstruct_job {
    const td_dataset *dataset;
    reconstruct_how *how;
    td_rig *rig;
    td_robot *robot; /* NULL: none */
    int mount;       /* link that carries the rig */
    double *q;       /* (frames, joints) */
    double sigma_q[TD_ROBOT_MAX_JOINTS];
    bool has_poses;
    size_t count;
    reconstruct_frame *frame; /* (count) */
    td_pair pair;
    td_depth_camera *depth;
    td_fusion *fusion;
    char key[TD_HASH_HEX_SIZE]; /* of all that the map depends on but the images */
    size_t resumed;             /* frames taken over from an earlier run */
    td_elevation *map;
    double rms_epipolar_px; /* worst of the frames looked at; NaN */
    /* Of the last good frame, for the report. */
    td_image *shown_left;
    td_disparity *shown;
    gate_result gate;
    double seconds;
} reconstruct_job;

extern const td_schema_row reconstruct_schema[];
extern const size_t reconstruct_schema_count;
extern const gate_row reconstruct_gate_defaults[];
extern const size_t reconstruct_gate_count;

/* reconstruct_frames.c: frames with their images, poses and joints; the rig, the robot, the key. */
td_status reconstruct_frames(reconstruct_job *work, td_error *error);
/* reconstruct_localise.c: the place of a frame that the table does not give, by tags on the site, else by the
 * ground it sees (its disparities, the machine left out), from where the last frame was. */
td_status reconstruct_localise(reconstruct_job *work, size_t index, const td_disparity *disparity,
                               td_image *const raw[2], td_error *error);
extern const char *const reconstruct_place_name[]; /* by reconstruct_place */

/* reconstruct_run.c: every frame into the map, from where an earlier run stopped. */
td_status reconstruct_run(reconstruct_job *work, td_error *error);
/* reconstruct_state.c: what is done is kept in DIR/state, whole or not at all. */
td_status reconstruct_state_load(reconstruct_job *work, td_error *error);
td_status reconstruct_state_save(const reconstruct_job *work, size_t frames_done, td_error *error);

void reconstruct_judge(reconstruct_job *work, const gate_row *rows);
json_t *reconstruct_result(const reconstruct_job *work);
void reconstruct_table(const void *job);
td_status reconstruct_report(const void *job, const char *path, td_error *error);

void reconstruct_free(reconstruct_job *work);

#endif
