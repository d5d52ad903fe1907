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
#include "recon/mosaic.h"

enum { FRAME_REASON_SIZE = 400 };

/* One frame: what is known before, and what became of it. */
typedef struct reconstruct_frame {
    const char *name, *image[2];
    double time_s;            /* NaN: not given */
    double skew_s;            /* right camera's time minus the left's; 0: not given */
    td_pose site_from_rig;    /* where the rig stood */
    td_pose vehicle_from_rig; /* of the robot's root, with the joints as they stood */
    const double *q;          /* (joints); NULL: no robot */
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
    const char *rig, *prior, *output, *crs;
    int texels; /* of the orthophoto, along a cell; 0: none */
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
    td_mosaic *mosaic;          /* NULL: no orthophoto is asked for */
    char key[TD_HASH_HEX_SIZE]; /* of all that the map depends on but the images */
    size_t resumed;             /* frames taken over from an earlier run */
    td_elevation *map;
    td_orthophoto *photo; /* NULL: none */
    bool has_mesh;
    double rms_epipolar_px; /* worst of the frames looked at; NaN */
    /* Of the last good frame, for the report. */
    const reconstruct_frame *shown_frame;
    td_image *shown_left, *shown_right;
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
/* reconstruct_run.c: every frame into the map, from where an earlier run stopped. */
td_status reconstruct_run(reconstruct_job *work, td_error *error);
/* reconstruct_state.c: what is done is kept in DIR/state, whole or not at all. */
td_status reconstruct_state_load(reconstruct_job *work, td_error *error);
td_status reconstruct_state_save(const reconstruct_job *work, size_t frames_done, td_error *error);

/* reconstruct_products.c: the orthophoto with the map's frames, its part of the state, and the files. */
td_status reconstruct_photo_begin(reconstruct_job *work, td_error *error);
td_status reconstruct_photo_add(reconstruct_job *work, const reconstruct_frame *f,
                                const td_fusion_frame *frame, td_error *error);
td_status reconstruct_photo_save(const reconstruct_job *work, size_t frames_done, td_error *error);
td_status reconstruct_photo_load(reconstruct_job *work, size_t frames_done, td_error *error);
/* Refuses --crs where it is none, or another than the prior's (NULL: none). */
td_status reconstruct_crs(const reconstruct_job *work, const char *prior, td_error *error);
td_status reconstruct_products(reconstruct_job *work, job *j);
json_t *reconstruct_product_names(const reconstruct_job *work);

void reconstruct_judge(reconstruct_job *work, const gate_row *rows);
/* Of the points about the cells that they became part of, m; NaN: none. */
double reconstruct_rms(const reconstruct_job *work);
json_t *reconstruct_result(const reconstruct_job *work);
void reconstruct_table(const void *job);
td_status reconstruct_report(const void *job, const char *path, td_error *error);

void reconstruct_free(reconstruct_job *work);

#endif
