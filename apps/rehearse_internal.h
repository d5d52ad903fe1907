/* teledimos rehearse, between its files. */
#ifndef TELEDIMOS_APPS_REHEARSE_INTERNAL_H
#define TELEDIMOS_APPS_REHEARSE_INTERNAL_H

#include "apps/look.h"
#include "apps/simulate_task.h"
#include "core/random.h"
#include "recon/volume.h"
#include "servo/dig_plan.h"

enum { REHEARSE_MAX_ROUNDS = 8, REHEARSE_MAX_POSES = 8, REHEARSE_MAX_DRAWS = 16, REHEARSE_MAX_FILM = 24 };

/* What is true and not known. */
typedef struct rehearse_truth {
    double mass_sigma;     /* relative, of each link's mass, inertia with it */
    double soil_sigma;     /* relative, of cohesion and adhesion; friction and density by a quarter of it */
    double soil_times;     /* by which cohesion and adhesion are larger besides */
    double rig_covariance; /* by which the rig's is multiplied: of what is believed and of what is true */
    double rig_sigma;      /* by which the true one is besides, of standard deviations: a wrong rig */
    double joint_sigma_rad;
    int dark_look; /* from that look on, counted from 1, the cameras see nothing; 0: never */
    int stone_count;
    td_world_stone stone[STATION_MAX_STONES]; /* that no earlier map shows; the cameras see what stands out */
} rehearse_truth;

typedef struct rehearse_setup {
    char name[TD_NAME_SIZE], path[1024], scenario_path[1100], rig_path[1100];
    rehearse_truth truth;
    int frames, pose_count; /* pairs taken in each of these poses of the arm, after digging */
    double pose[REHEARSE_MAX_POSES][TD_ROBOT_MAX_JOINTS];
    int first, last; /* of the scene's frames, from 0: the looks before */
    int draws, rounds;
} rehearse_setup;

/* One machine on one soil as they may be. */
typedef struct rehearse_draw {
    td_robot *robot;
    station_ground ground;
    double zero[TD_ROBOT_MAX_JOINTS]; /* reading less truth */
    td_random random;                 /* for what else is drawn */
} rehearse_draw;

/* Of predicted and actual, sample by sample along the same motion. Quantities: the joints (rad or m), the
 * forces (N), the tool (m, in the site: x, y, z). */
enum {
    MONITOR_CLASSES = 7, /* the phases of a pass, and all others */
    MONITOR_MOST = 2 * TD_ROBOT_MAX_JOINTS + 3,
    MONITOR_WINDOW = 20
};
typedef struct monitor {
    int joints;
    const task_run *predicted;
    double sigma[MONITOR_CLASSES][MONITOR_MOST]; /* of actual less predicted, over each phase */
    int motion_count;
    double (*of_motion)[MONITOR_MOST]; /* (motion_count) the same over each motion, at least its phase's */
    size_t *samples;                   /* (motion_count) while learning */
    size_t counts[MONITOR_CLASSES], tip_count;
    double tip_square, up_square;
    double sigma_tip_m, sigma_up_m; /* of the true tool's distance, above the ground; of its height */
    /* while watching: */
    int motion;
    double since_s;
    int filled, next;
    double off[MONITOR_WINDOW][MONITOR_MOST]; /* in sigma */
    double ratio[MONITOR_MOST];               /* largest so far of the window's mean */
    double late;                              /* largest so far of a motion's time over what was predicted */
    double alarm;                             /* the ratio from which on the machine is stopped */
} monitor;
/* From the same task simulated with other draws. */
td_status monitor_begin(monitor *m, const task_run *predicted, int joints, double alarm, td_error *error);
void monitor_learn(monitor *m, const task_run *drawn);
void monitor_learnt(monitor *m);
void monitor_free(monitor *m);
void monitor_watch(void *self, const task_sample *sample, bool *deviates, char *why, size_t size);
/* In no cut, nor on the way in and out of the ground. */
bool monitor_is_free(const task_sample *a);
/* Actual less predicted (values, 2 joints + 3), the same of the tool as it truly is, and its predicted place;
 * false: nothing was predicted there. */
bool monitor_compare(double *difference, double tip[3], double place[3], const task_run *predicted,
                     const task_sample *a, int joints);

typedef struct rehearse_round {
    task_run ahead, done;
    td_dig_plan *plan;
    monitor monitor;
    bool executed;
    double predicted_m3;           /* around the trench */
    double tip_square, tip_most_m; /* of true less predicted, above the ground */
    size_t tip_count;
    double above_square, sigma_above_square; /* the same of its height above ground that nobody dug */
    size_t above_count;
} rehearse_round;

/* What was executed, in order; without a run: what was told then. */
enum { REHEARSE_MAX_PARTS = 2 * REHEARSE_MAX_ROUNDS * (REHEARSE_MAX_POSES + 2) };
typedef struct rehearse_part {
    char text[700];
    task_run *run; /* of a round, or `own` */
    task_run own;
} rehearse_part;

typedef struct rehearse {
    const rehearse_setup *setup;
    scenario scenario; /* as believed */
    td_scene_file *scene;
    td_rig *rig, *rig_true;
    rehearse_draw truth;
    double sigma_q[TD_ROBOT_MAX_JOINTS];
    uint64_t seed;
    int threads;
    const td_progress *progress;
    look *look;
    int looks;
    double look_s;
    double epipolar_px, sigma_epipolar_px;
    double rig_sigmas; /* by how many of its own sigma the images show the rig off; NaN: none */
    double matched_least;
    double scatter_m; /* of ground as it was predicted, against what was then seen of it */
    td_image *film[REHEARSE_MAX_FILM];
    int film_count;
    station *station;         /* the machine as it truly is; NULL: it is elsewhere, */
    struct rehearse_far *far; /* at the other end of this link */
    td_plant_state state;     /* as it reads */
    td_elevation *map, *map_before;
    td_elevation *true_before, *true_after;
    td_behaviour logic;
    size_t part_count;
    rehearse_part part[REHEARSE_MAX_PARTS];
    int looked; /* rounds whose work has been looked at */
    int round_count;
    rehearse_round round[REHEARSE_MAX_ROUNDS + 1];
    td_dig_floor floor;
    double planned_m3, left_m3;
    bool stopped; /* safely, with: */
    char why[600];
    double map_rms_m, map_share, clearance_m, probability, real_time;
    double dug_m3, predicted_m3, mass_error_kg;
    int deadline_misses; /* periods of a task simulated ahead that took longer to compute */
    bool stones_lie;     /* where they lay after the last task: */
    double stone_at[STATION_MAX_STONES][3];
    int unmeant; /* executed tasks with contact that was not meant */
    td_volume volume;
    double sigma_volume_m3;
    double unseen_m2, seen_share; /* around the trench: not seen since it was dug, taken as predicted */
    double dug_seen_m3, predicted_unseen_m3; /* in truth, where it is seen; as predicted, where it is not */
    double measured_m3, sigma_measured_m3;   /* of the whole: volume and predicted_unseen_m3 */
    gate_result gate;
} rehearse;

td_status rehearse_read(rehearse_setup *setup, scenario *s, const char *path, td_error *error);
/* stream 0: the truth; further ones: what the truth may be. */
td_status rehearse_draw_make(rehearse_draw *draw, const rehearse *r, uint64_t stream, td_error *error);
void rehearse_draw_free(rehearse_draw *draw);
td_status rehearse_run(rehearse *r, td_error *error);
void rehearse_free(rehearse *r);

/* rehearse_look.c */
td_status rehearse_look_first(rehearse *r, td_error *error);
/* Through the arm's poses, each a task of its own; with what has been dug. */
td_status rehearse_look_again(rehearse *r, td_error *error);

/* rehearse_far.c: the machine elsewhere, whose truth nobody is told. */
struct machine_address;
td_status rehearse_far_begin(rehearse *r, const struct machine_address *address, td_error *error);
void rehearse_far_free(rehearse *r);
/* A pair as it is now (frame -1), or the one that was taken in a frame of the scene as the machine came; with
 * where the machine says it stood. Stops the loop where none comes. */
td_status rehearse_far_look(rehearse *r, int frame, td_image *pair[2], td_pose *site_from_vehicle, double *q,
                            td_error *error);
/* Sends the task with what came of it ahead, has it executed and watches it. */
td_status rehearse_far_execute(task_run *run, rehearse *r, const scenario *s, const task_run *ahead,
                               task_world *w, td_error *error);

/* What the cameras see of stones: the scene's ground, raised over them where they lie. */
void rehearse_show_stones(rehearse *r);

/* rehearse_imagine.c */
/* The machine on the map, standing as the true one is measured to stand. `draw`: as it may be; NULL: as it is
 * believed to be. */
td_status rehearse_imagine(station **made, const rehearse *r, const rehearse_draw *draw,
                           const td_elevation *map, td_error *error);

/* rehearse_task.c */
/* The scenario's task simulated ahead on the map, validated, downloaded, executed and watched. */
td_status rehearse_ahead(rehearse *r, rehearse_round *round, td_error *error);
td_status rehearse_execute(rehearse *r, rehearse_round *round, td_error *error);
/* The arm alone, to joints, likewise. */
td_status rehearse_move(rehearse *r, const double *q, td_error *error);
/* The behaviour is handed one order of the operator. */
void rehearse_order(rehearse *r, td_event event, uint32_t task_id);
void rehearse_stop(rehearse *r, const char *format, ...) TD_PRINTF(2, 3);

/* rehearse_record.c */
/* Keeps a session, or a line, for the recording. `run` (may be NULL) is taken over where `own`, else lent. */
void rehearse_keep(rehearse *r, task_run *run, bool own, const char *format, ...) TD_PRINTF(4, 5);
/* recording.mcap: all that was executed. */
td_status rehearse_record(const rehearse *r, const char *folder, td_error *error);
/* The seed and the rig's covariance of an earlier recording of the same rehearsal. */
td_status rehearse_replay(rehearse *r, rehearse_setup *setup, const char *path, td_error *error);

/* rehearse_contact.c */
/* Counts what was executed with contact that was not meant. */
td_status rehearse_touched(rehearse *r, const task_run *run, td_error *error);

/* rehearse_compare.c */
td_status rehearse_compare(rehearse *r, td_error *error);

/* Of all that was executed, rms; NaN: nothing was. */
typedef struct rehearse_tip {
    double rms_m, most_m, sigma_m; /* true less predicted place, above the ground */
    double above_m, sigma_above_m; /* and height above ground that nobody dug */
} rehearse_tip;
rehearse_tip rehearse_tips(const rehearse *r);

extern const td_schema_row rehearse_schema[];
extern const size_t rehearse_schema_count;
extern const gate_row rehearse_gate_defaults[];
extern const size_t rehearse_gate_count;
void rehearse_judge(rehearse *r, const gate_row *rows);
json_t *rehearse_result(const rehearse *r);
void rehearse_table(const void *done);
td_status rehearse_report(const void *done, const char *path, td_error *error);
td_status rehearse_write(const rehearse *r, const char *folder, td_error *error);

#endif
