/* The parts of `teledimos reconstruct`. */
#ifndef TELEDIMOS_APPS_RECONSTRUCT_INTERNAL_H
#define TELEDIMOS_APPS_RECONSTRUCT_INTERNAL_H

#include <jansson.h>

#include "apps/gate.h"
#include "apps/job.h"
#include "core/dataset.h"
#include "core/hash.h"
#include "core/robot.h"
#include "core/source.h"
#include "recon/epipolar_gate.h"
#include "recon/fusion.h"
#include "recon/mosaic.h"

enum { FRAME_REASON_SIZE = 400 };

/* How a frame's place was found. */
typedef enum reconstruct_place { PLACE_GIVEN, PLACE_TAGS, PLACE_MAP, PLACE_UNKNOWN } reconstruct_place;

/* One frame: what is known before, and what became of it. */
typedef struct reconstruct_frame {
    const char *name, *image[2];
    double time_s;         /* NaN: not given */
    double skew_s;         /* right camera's time minus the left's; 0: not given */
    double skew_px;        /* by how much the picture moves meanwhile; NaN: the motion is not known */
    td_pose site_from_rig; /* where the rig stood, once `place` is known */
    reconstruct_place place;
    double pose_covariance[36]; /* of site_from_rig, where it was found */
    double pose_sigma[6];       /* rad, m: turns about the site's axes through the rig, and its x, y, z */
    td_pose vehicle_from_rig;   /* of the robot's root, with the joints as they stood */
    const double *q;            /* (joints); NULL: no robot */
    bool done, failed;
    char reason[FRAME_REASON_SIZE]; /* why it failed */
    char sha256[TD_HASH_HEX_SIZE];  /* of both images; "": they were not looked for */
    double matched;                 /* share of pixels with a disparity */
    double masked;                  /* share of pixels that see the machine itself */
    double epipolar_px;             /* NaN: not looked at */
    td_fusion_tally tally;
    double seconds;
} reconstruct_frame;

/* What a frame's images say, before it goes into the map; empty when the frame failed. */
typedef struct reconstruct_view {
    td_image *left; /* rectified */
    td_disparity *disparity;
} reconstruct_view;

/* A camera's video of which frames are taken: "left.mp4#120" is the picture after 120 others. */
typedef struct reconstruct_video {
    char *path; /* of the video that is open; NULL: none */
    td_source *source;
    long next;    /* picture that it gives next */
    char *hashed; /* path of the file whose hash is kept; NULL: none */
    char sha256[TD_HASH_HEX_SIZE];
} reconstruct_video;

/* Bytes of memory. */
typedef struct reconstruct_memory {
    double program;  /* when it began */
    double frame;    /* a frame while it is worked on */
    double tiles;    /* of the map, if all that the cameras can see is known */
    double resident; /* of them, those in memory */
    double products; /* the finished map and its cloud */
} reconstruct_memory;

/* What was asked for. */
typedef struct reconstruct_how {
    const char *rig, *prior, *output, *crs;
    const double *start; /* of the base before the first frame: x, y, z, m, heading, rad; NULL: unknown */
    int texels;          /* of the orthophoto, along a cell; 0: none */
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
    bool has_poses, has_skew; /* the table gives poses of the base; times of both cameras */
    size_t count;
    reconstruct_frame *frame; /* (count) */
    td_pair pair;
    td_depth_camera *depth;
    td_fusion *fusion;
    td_mosaic *mosaic;                    /* NULL: no orthophoto is asked for */
    char key[TD_HASH_HEX_SIZE];           /* of all that the map depends on but the images */
    size_t resumed;                       /* frames taken over from an earlier run */
    int saved_as;                         /* which of the state's two files of the map is the present one */
    int lock;                             /* file that says that this process works on DIR; 0: none */
    reconstruct_video video[2], coloured; /* of the cameras; of the left one again, for the orthophoto */
    reconstruct_memory memory;
    td_elevation *map;
    td_orthophoto *photo; /* NULL: none */
    bool has_mesh;
    double rms_epipolar_px; /* worst of the frames looked at; NaN */
    /* Of the last good frame, for the report. */
    const reconstruct_frame *shown_frame;
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
/* reconstruct_images.c: an image of its own file, or a picture of a video, whose time is then given (else
 * NaN). The hash is that of the file (and the picture's number). */
td_status reconstruct_image_read(td_image **image, double *time_s, reconstruct_video *video, const char *path,
                                 int channels, td_error *error);
td_status reconstruct_image_hash(char sha256[TD_HASH_HEX_SIZE], reconstruct_video *video, const char *path,
                                 td_error *error);
void reconstruct_video_free(reconstruct_video *video);
/* Of both images, of those that are there. */
td_status reconstruct_frame_hash(char sha256[TD_HASH_HEX_SIZE], reconstruct_job *work,
                                 const reconstruct_frame *frame, td_error *error);
/* reconstruct_measure.c: a frame's images into disparities. A frame that fails says so itself, with TD_OK;
 * else only no memory and an interruption are failures. */
td_status reconstruct_measure(reconstruct_view *view, reconstruct_job *work, size_t index, td_error *error);
void reconstruct_view_free(reconstruct_view *view);
/* reconstruct_localise.c: the place of a frame that the table does not give, by tags on the site, else by the
 * ground it sees (its disparities, the machine left out), from where the last frame was. */
td_status reconstruct_localise(reconstruct_job *work, size_t index, const td_disparity *disparity,
                               td_error *error);
extern const char *const reconstruct_place_name[]; /* by reconstruct_place */

/* reconstruct_run.c: what every process needs; then, by the first of them, every frame into the map in their
 * order, from where an earlier run stopped. */
td_status reconstruct_prepare(reconstruct_job *work, td_error *error);
td_status reconstruct_begin(reconstruct_job *work, td_error *error);
td_status reconstruct_run(reconstruct_job *work, td_error *error);
/* reconstruct_state.c: what is done is kept in DIR/state, whole or not at all. One process at a time works
 * on DIR. */
td_status reconstruct_state_lock(reconstruct_job *work, td_error *error);
td_status reconstruct_state_load(reconstruct_job *work, td_error *error);
td_status reconstruct_state_save(reconstruct_job *work, size_t frames_done, td_error *error);
/* reconstruct_batch.c: the memory a run will need, told before it starts; how far the cameras' times matter;
 * what a run came to, for the terminal. */
void reconstruct_memory_foresee(reconstruct_job *work);
void reconstruct_skew(reconstruct_job *work);
void reconstruct_summary(const reconstruct_job *work);

/* reconstruct_products.c: the orthophoto with the map's frames, its part of the state, and the files. */
td_status reconstruct_photo_begin(reconstruct_job *work, td_error *error);
td_status reconstruct_photo_add(reconstruct_job *work, const reconstruct_frame *f,
                                const td_fusion_frame *frame, td_error *error);
/* Which of two files: 0 or 1. */
td_status reconstruct_photo_save(const reconstruct_job *work, int slot, size_t frames_done, td_error *error);
td_status reconstruct_photo_load(reconstruct_job *work, int slot, size_t frames_done, td_error *error);
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
