/* What the files of teledimos servo share. */
#ifndef TELEDIMOS_APPS_SERVO_INTERNAL_H
#define TELEDIMOS_APPS_SERVO_INTERNAL_H

#include "apps/job.h"
#include "core/scene.h"
#include "servo/visual_servo.h"
#include "sim/stereo_view.h"

enum { SERVO_MAX_TAGS = TD_SERVO_MAX_POINTS / 4, SERVO_PATH = 1100 };

typedef struct servo_tag {
    int id;
    double size_m;           /* side of the black square */
    td_pose target_from_tag; /* x to its right, y down, z into it; origin at its centre */
} servo_tag;

/* Tags that are fixed to one another: those on the bucket, or the board's. */
typedef struct servo_target {
    int link;                 /* -1: of the site */
    td_pose link_from_target; /* or site_from_target */
    int count;
    servo_tag tag[SERVO_MAX_TAGS];
} servo_target;

typedef struct servo_scenario {
    char name[TD_NAME_SIZE], path[SERVO_PATH], scene_path[SERVO_PATH], dictionary[TD_NAME_SIZE];
    td_scene_file *scene; /* each run reads its own; this one for the robot and the rig */
    int camera;           /* of the rig */
    int tool;             /* link whose origin is the tip */
    servo_target bucket, board;
    td_pose board_from_bucket; /* the goal, of the bucket's target */
    double q[TD_ROBOT_MAX_JOINTS];
    double low[TD_ROBOT_MAX_JOINTS], high[TD_ROBOT_MAX_JOINTS]; /* of starts that are drawn */
    double spread; /* rad or m: with each, of each joint where the goal is met; the board goes with it */
    td_visual_servo_options options;
    double hide_from_s, hide_for_s;
} servo_scenario;
/* A folder with scenario.yaml, or the file. */
td_status servo_scenario_read(servo_scenario *s, const char *path, td_error *error);
void servo_scenario_free(servo_scenario *s);

/* ---- what the camera shows ---- */

typedef struct servo_points {
    int count;
    double at[TD_SERVO_MAX_POINTS][3]; /* of the target */
    bool seen[TD_SERVO_MAX_POINTS];
    double pixel[TD_SERVO_MAX_POINTS][2], sigma_px[TD_SERVO_MAX_POINTS];
    bool has_pose;
    td_pose camera_from_target;
    double covariance[36]; /* of its left perturbation, by the corners' sigma */
    double variance_px2;   /* mean of the corners' sigma^2 */
    double residual_px2;   /* mean of the residuals' squares, by degree of freedom */
    int freedoms;          /* degrees of freedom of the residuals */
} servo_points;

typedef struct servo_look {
    servo_points bucket, board;
    double seconds; /* that finding them took */
} servo_look;

typedef struct servo_view servo_view;
/* The scenario's scene with its tags in it. */
td_status servo_view_new(servo_view **view, const servo_scenario *s, uint64_t seed, int threads,
                         td_error *error);
void servo_view_free(servo_view **view);
const td_scene *servo_view_scene(const servo_view *view);
/* Renders the machine as it stands and finds the tags. `hidden`: something stands before the camera. */
td_status servo_view_look(servo_look *look, servo_view *view, const td_plant_state *state, uint64_t frame,
                          bool hidden, td_error *error);
/* The last image; lent. */
const td_image *servo_view_image(const servo_view *view);
const td_camera *servo_view_camera(const servo_view *view);
/* root_from_camera at q. */
td_pose servo_camera_at(const servo_scenario *s, const double *q);
/* Corners of the tags in the target's frame. */
int servo_corners(double (*at)[3], const servo_target *target);
/* Pose by least squares over the camera's model, from the seen points; false: they give none. */
bool servo_pose(servo_points *points, const servo_target *target, const td_camera *camera);

/* From q on: joints that bring the bucket's target and the tool nearest to the goal, and how far they are
 * from it then, root mean square, m. */
double servo_reach(double *q, const servo_scenario *s, const td_pose *root_from_goal);

/* ---- one run ---- */

typedef struct servo_sample {
    double time_s;
    td_servo_phase phase;
    bool bucket_seen, board_seen;
    double whole_px, controlled_px; /* NaN: not judged */
    double tip_error_m;
    double q[TD_ROBOT_MAX_JOINTS], dq[TD_ROBOT_MAX_JOINTS], rate[TD_ROBOT_MAX_JOINTS];
    double now[8], goal[8]; /* px, of the first tag's corners; NaN: not seen */
} servo_sample;

typedef struct servo_run {
    size_t count, room;
    servo_sample *sample;
    double start[TD_ROBOT_MAX_JOINTS];
    td_servo_phase phase;
    char reason[256];
    int freedoms, iterations; /* until it was over */
    double time_s, lost_s;
    double steady_px;    /* largest while it settled; NaN: it did not */
    double tip_error[3]; /* m, vehicle's axes: where the tip is at rest against where the board says */
    double sigma_tip[3]; /* m */
    double corner_px;    /* sigma of the corners by the targets' residuals */
    double sigmas;       /* of the error: sqrt(e' S^-1 e); NaN: no sigma */
    double clearance_m;  /* least of the tip over the ground */
    int limit_violations;
    double loop_hz; /* of finding tags and the law, by the clock */
    td_image *image;
} servo_run;
void servo_run_free(servo_run *run);
/* TD_OK too when the goal is not met: run->phase. */
td_status servo_run_one(servo_run *run, const servo_scenario *s, const double *q, uint64_t seed, int threads,
                        const td_progress *progress, td_error *error);
bool servo_met(const servo_run *run);
td_status servo_log_write(const servo_run *run, const td_robot *robot, const char *path, td_error *error);

/* ---- many ---- */

typedef struct servo_starts {
    size_t count;
    servo_run *run;
    int met, judged, covered;                 /* of those met: with a sigma; within 3 of it */
    double rms_sigmas;                        /* sqrt(mean(sigmas^2) / 3); 1: sigma is what it should be */
    double steady_px[3], tip_m[3], sigmas[3]; /* of those met: median, 90 %, largest */
} servo_starts;
void servo_starts_free(servo_starts *starts);
td_status servo_starts_run(servo_starts *starts, const servo_scenario *s, int count, uint64_t seed,
                           int threads, const td_progress *progress, td_error *error);

/* ---- the job ---- */

typedef struct servo_job {
    servo_scenario scenario;
    servo_run run;
    servo_starts starts;
    gate_result gate;
} servo_job;
extern const td_schema_row servo_schema[];
extern const size_t servo_schema_count;
extern const gate_row servo_gate_defaults[];
extern const size_t servo_gate_count;
void servo_judge(servo_job *j, const gate_row *rows);
json_t *servo_result(const servo_job *j);
void servo_table(const void *done);
td_status servo_report(const void *done, const char *path, td_error *error);

#endif
