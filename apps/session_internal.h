/* What the files of a session share: session.c leads it by the behaviour, session_steps.c says what the
 * joints are to do in each step, session_dig.c and session_drive.c for the steps that only a machine on its
 * ground does, session_log.c keeps what happened. */
#ifndef TELEDIMOS_APPS_SESSION_INTERNAL_H
#define TELEDIMOS_APPS_SESSION_INTERNAL_H

#include "apps/simulate_task.h"
#include "servo/dig_plan.h"
#include "servo/force_controller.h"
#include "servo/jog.h"
#include "servo/joint_controller.h"
#include "servo/track_drive.h"
#include "sim/dynamics.h"

/* A dig or dump step under work: its moves one after the other. */
typedef struct session_dig {
    bool busy;
    const td_dig_plan *plan; /* NULL: none yet, or the bucket is emptied by: */
    td_dig_plan *own;        /* the same where it is to be freed */
    bool dumps;
    td_task_frame frame;
    td_task_position emptied[2];
    td_task_joint opened;
    td_dig_floor floor; /* of the first plan */
    int move, round;    /* move: the next */
    double raise_m;     /* by which the edge is raised, for the force's sake */
    double stalled_s;
    bool raised; /* in this pass: told once */
} session_dig;

typedef struct session {
    const scenario *s;
    const task_setup *setup;
    const task_inputs *input;
    task_run *run;
    task_world *world; /* NULL: the session has its own machine and ground */
    struct live *live;
    td_plant plant;
    td_machine *machine; /* behind the plant; NULL: the station is */
    station *station;    /* NULL: the machine is */
    td_dynamics *dynamics;
    td_plant_state start; /* settled */
    td_behaviour logic;
    td_behaviour_outputs out;
    bool links_open, parameters_read;
    live_seen seen; /* of the machine elsewhere; its state is only there while a period begins */
    bool stands;    /* the simulated machine, where that one does: */
    double stood[TD_ROBOT_MAX_JOINTS];
    bool dug;                  /* it executed a task since */
    uint32_t task_id, reports; /* reports of the last period, for the next reaction */
    size_t next_input, stops_seen;
    bool at_stop[TD_ROBOT_MAX_JOINTS];
    long period, simulated, phase_since; /* counted in periods; simulated: of the run under way */
    long idle;                           /* periods since the last step was done */
    size_t log_index;
    int step, steps;
    bool step_begun, broken;
    td_trajectory *motion;
    td_trajectory **ahead;           /* (steps) planned when the run began; NULL: not yet, or taken */
    double along_s, pace, pace_rate; /* on the motion; pace: 1 while it runs, 0 while it is held */
    size_t next_event;
    int motions; /* begun so far */
    double step_s;
    td_pose base, link_from_tool;
    int tool_link;
    double wanted[TD_ROBOT_MAX_JOINTS];
    td_joint_controller joints;
    td_force_controller press;
    td_track_drive tracks;
    session_dig dig;
    td_jog jog;
    td_jog_wish wish;
    td_plant_state state;
    td_plant_command command;
} session;

/* The machine's readings. */
td_status session_read(session *x, td_error *error);

/* session_log.c */
double session_time(const session *x);
td_status session_note(session *x, note_kind kind, const char *name, const char *text, td_error *error);
td_status session_report(session *x, td_event event, const char *text, td_error *error);
td_pose session_tool(const session *x, const double *q, const td_pose *base);
td_status session_sample(session *x, td_error *error);
double session_share(const session *x); /* of the motion's length */
bool session_is_loose(const session *x);
void session_keep_steady(session *x);
/* The ground as it is now, for the recording. */
td_status session_keep_ground(session *x, td_error *error);

/* session_steps.c */
/* From q; what is out of reach is reported, *planned stays NULL. */
td_status session_plan(session *x, td_trajectory **planned, const td_task_position *position,
                       td_task_frame frame, const double *q, int step, td_error *error);
td_status session_plan_ahead(session *x, td_error *error);
void session_forget_plans(session *x);
/* A motion runs from the next period on, unless the ground is in its way: then *motion is NULL again, and it
 * is reported. */
td_status session_begin_motion(session *x, td_trajectory **planned, bool bucket_may_touch, td_error *error);
/* Along the motion at the pace `to` (1: as planned, 0: held), or where the joints are wanted. */
td_status session_follow(session *x, double to, td_error *error);
void session_end_step(session *x);
/* One period of the task. */
td_status session_work(session *x, td_error *error);

/* session_dig.c */
td_status session_begin_dig(session *x, td_error *error);
td_status session_dig_on(session *x, td_error *error);
void session_end_dig(session *x);
/* Whether a step of these kinds is under way; whether it is in a cut. */
bool session_digs(const session *x);
bool session_cuts(const session *x);
/* td_dig_phase of the motion; -1: none of a trench. */
int session_dig_phase(const session *x);
/* Adds to q what raises the edge. */
void session_raise(double *q, const session *x);

/* session_drive.c */
td_status session_begin_drive(session *x, td_error *error);
td_status session_drive_on(session *x, td_error *error);
/* Stands still. */
td_status session_halt(session *x, td_error *error);

#endif
