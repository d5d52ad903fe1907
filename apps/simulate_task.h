/* teledimos simulate, tasks: between its files. A session plans a task step by step, runs it at the control
 * period through the joints' controller, and asks the behaviour (sim/behaviour.h) each period what to do.
 *
 * Nothing of what a session does depends on anything but the scenario and its inputs: orders of the operator
 * and missed deadlines, each kept with the number of the period that it was handed in. So a log replays. */
#ifndef TELEDIMOS_APPS_SIMULATE_TASK_H
#define TELEDIMOS_APPS_SIMULATE_TASK_H

#include "apps/simulate_internal.h"
#include "core/task.h"
#include "core/trajectory.h"
#include "sim/behaviour.h"
#include "sim/clearance.h"
#include "sim/clock.h"

/* An order of the operator, or a report that comes from outside the simulation (a missed deadline). */
typedef struct task_input {
    long period;
    td_event event;
    int joint;    /* Jog */
    double stick; /* Jog: -1 to 1 of the joint's speed */
} task_input;

typedef struct task_inputs {
    size_t count, room;
    task_input *item; /* by period */
    long end;         /* the last period; -1: where the session ends by itself */
} task_inputs;
td_status inputs_add(task_inputs *inputs, const task_input *input, td_error *error);

/* What a scenario says of its task. */
typedef struct task_setup {
    td_task *task;
    char path[1100];
    bool has_contact;
    td_machine_contact contact;
    double alpha, power; /* of the generator of trajectories */
    td_singularity_policy singularity;
    td_miss_policy miss;
    double tolerance_s; /* of a deadline */
    task_inputs orders; /* the operator's, written in the scenario */
} task_setup;
/* Its fields of the scenario's document (contact, generator, live, operator), after all the others. */
td_status task_setup_read(task_setup **setup, const scenario *s, const struct td_field *root,
                          const char *folder, td_error *error);
void task_setup_free(task_setup **setup);
extern const char *const task_miss_names[];

/* What happened, in words. */
typedef enum note_kind { NOTE_ORDER, NOTE_REPORT, NOTE_MESSAGE, NOTE_PHASE, NOTE_FAULT, NOTE_STEP } note_kind;
typedef struct task_note {
    long period;
    double time_s;
    note_kind kind;
    const char *name;
    int joint;
    double stick;
    char text[400];
} task_note;

/* A row of the log. */
typedef struct task_sample {
    double time_s;
    td_phase phase;
    int step; /* from 0; -1: none yet */
    td_plant_state state;
    double wanted[TD_ROBOT_MAX_JOINTS], command[TD_ROBOT_MAX_JOINTS];
    td_pose tool_wanted, tool; /* site_from_tool; wanted: with the base as it stood at the step's begin */
    double pitch_wanted_rad, pitch_rad; /* of the tool's axis below the level plane */
    double press_n;                     /* as the cylinders tell it, while pressing; else NaN */
    double contact_n;        /* of the plane on the tool; on the ground: of the soil that the bucket cuts */
    double load_kg, depth_m; /* on the ground: in the bucket; of its edge below the ground ahead */
    int motion;              /* number of the motion under way, from 0; -1: none yet */
    double share;            /* of its length, 0 to 1 */
    int dig_phase;           /* td_dig_phase of it; -1: of no trench */
    td_pose tool_true;       /* with the joints as they are, whatever they read */
    bool loose;              /* the tool is not held to its path: in a cut, on a drive, when all is done */
} task_sample;

enum { TASK_MAX_GROUNDS = 24 };
typedef struct task_ground {
    double time_s;
    td_elevation *map;
} task_ground;

/* On the ground: what came of a trench. */
typedef struct task_dug {
    int passes, stalls;
    double planned_m3, left_m3; /* of the bank: as the first plan has it; above the floor after the last */
    double clearance_m;         /* least of the motions checked, contact that is meant left out */
    double probability;         /* of contact that is not meant: the largest of the motions checked */
    double raised_m;            /* the edge, at most, for the force's sake */
    double peak_n, load_kg, mass_error_kg;
} task_dug;

typedef struct task_live {
    bool used;
    td_clock_counts counts;
    double period_s;
} task_live;

typedef struct task_run {
    size_t count, room, note_count, note_room;
    task_sample *sample; /* (count) */
    task_note *note;     /* (note_count), by period */
    task_inputs input;   /* as handed in */
    td_integrator_counters counters;
    double time_s, cpu_s;
    int late;         /* periods that took longer to compute than they last */
    double planned_s; /* of the motions planned */
    td_phase phase;   /* at the end */
    td_fault fault;
    bool simulated; /* to the end, at least once; the samples are of it */
    int steps_done;
    double steady[3]; /* actual less wanted place of the tool when the simulation ended, m, in the site */
    double joint_off; /* the same of the joint that is furthest off, rad or m */
    task_live live;
    /* Of the last simulation: joints as it began and as they were last, the most that each pushed (N), and
     * how long it took. */
    double from[TD_ROBOT_MAX_JOINTS], to[TD_ROBOT_MAX_JOINTS], peak[TD_ROBOT_MAX_JOINTS], took_s;
    size_t ground_count;
    task_ground ground[TASK_MAX_GROUNDS]; /* for the recording, near the machine */
    td_elevation *after;                  /* the whole map at the end; NULL: no ground */
    task_dug dug;
} task_run;
void task_run_free(task_run *run);

/* In real time: keys and clock. NULL: as fast as it goes. */
struct live;
/* Runs the scenario with these inputs (NULL: those of the scenario); `base` in place of the scenario's. */
td_status task_run_session(task_run *run, const scenario *s, td_machine_base base, const task_inputs *inputs,
                           struct live *live, const td_progress *progress, td_error *error);

/* A period of a session in a world that others take part in: what it shows, and what comes of them. */
typedef struct task_outside {
    const td_plant_state *state; /* as it reads */
    td_phase phase;
    td_fault fault;
    int step, steps, motion, dig_phase; /* as a task_sample has them */
    double share;
    bool loose;
    const td_behaviour_outputs *last; /* of the reaction before */
    uint32_t events;                  /* out: TD_EVENT_BIT of orders */
    bool links_open;                  /* out */
} task_outside;

/* Where a session happens when it is one of several: of the machine that simulates ahead, and of the one that
 * executes. */
struct td_dig_plan;
typedef struct task_world {
    station *station;   /* lent; the session begins with it as it stands */
    const double *zero; /* (joints) what a joint reads beyond what it is; NULL: 0 */
    uint32_t task_id;   /* of all that decides the motion */
    /* DOWNLOADED: the task is executed; else it is simulated. Left as the session ends. */
    td_behaviour *logic;
    const struct td_dig_plan *plan;   /* of the trench, done as it is; NULL: the session plans, */
    const struct td_dig_floor *floor; /* with the floor of an earlier plan, or NULL, */
    struct td_dig_plan *made;         /* and leaves its plan here, to be freed */
    /* Looks at each sample while executing; *deviates: the machine is stopped, `why` is told. May be NULL. */
    void (*watch)(void *user, const task_sample *sample, bool *deviates, char *why, size_t size);
    /* Once a period, before the behaviour reacts; waits for the period's time where time is real. NULL: there
     * is nobody else. */
    td_status (*outside)(void *user, task_outside *o, td_error *error);
    void *user;
} task_world;
/* The scenario's task in that world. A trench is planned once: what still stands is for the next look. */
td_status task_run_in(task_run *run, const scenario *s, task_world *world, const td_progress *progress,
                      td_error *error);

/* One motion, from q. `base`: site_from_vehicle. *unreachable: the sentence in `error` is the operator's
 * concern, not a fault of the program. */
td_status task_plan(td_trajectory **planned, bool *unreachable, const scenario *s,
                    const td_task_position *position, td_task_frame frame, const double *q,
                    const td_pose *base, td_error *error);
td_pose task_tool(const td_task *task); /* link_from_tool */
double task_pitch(const td_pose *site_from_tool);

typedef struct task_job {
    scenario *scenario;
    task_run run, locked;
    bool has_locked;
    gate_result gate;
} task_job;
extern const td_schema_row task_schema[];
extern const size_t task_schema_count;
extern const gate_row task_gate_defaults[];
extern const size_t task_gate_count;
void task_judge(task_job *j, const gate_row *rows);
double task_steady(const task_run *run); /* m; NaN: the simulation did not end */
json_t *task_result(const task_job *j);
void task_table(const void *done);
td_status task_report(const void *done, const char *path, td_error *error);

/* On the ground: in the bank, of what the map knew before; fill as it lies. */
void task_volumes(double *cut_m3, double *fill_m3, const task_job *j);
/* before.tif, after.tif. */
td_status task_write_ground(const task_run *run, const scenario *s, const char *folder, td_error *error);
struct td_report;
void task_report_ground(struct td_report *r, const task_job *j);

/* Adds the digits of a file's hash: as many, whatever it holds. */
td_status task_hash_file(td_hash *hash, const char *path, td_error *error);
/* What decides the motion: files and options; SHA-256. */
td_status task_identity(char hex[TD_HASH_HEX_SIZE], const scenario *s, td_error *error);
/* trajectory.csv, events.csv, recording.mcap. */
td_status task_write(const task_run *run, const scenario *s, const char *folder, td_error *error);
/* Sessions one after another as one recording, each begun with a line of the log; without a run: the line
 * alone. `given`: what besides the identity decides them, as inputs of their own kinds. */
typedef struct task_part {
    char text[700];
    const task_run *run;
} task_part;
typedef struct task_given {
    const char *kind;
    char text[64];
} task_given;
td_status task_record_parts(const task_part *part, size_t count, const task_given *given, size_t given_count,
                            const scenario *s, const char *identity, const char *path, td_error *error);
/* What was given, from such a recording; it must be of this identity. */
td_status task_given_read(task_given *given, size_t count, const char *path, const scenario *s,
                          const char *identity, td_error *error);
/* Inputs from events.csv or recording.mcap. */
td_status task_replay_read(task_inputs *inputs, const char *path, const scenario *s, td_error *error);
/* "order", "report" … */
const char *note_kind_name(note_kind kind);
/* The event of that text (td_event_text); TD_EVENT_COUNT: none. */
td_event task_event_named(const char *name);

/* What of a session is shown each period. */
typedef struct live_view {
    task_run *run;
    td_phase phase;
    int step, steps;
    long period;
    double time_s;
    uint32_t offers; /* orders that would be obeyed now (td_behaviour_offers) */
} live_view;

/* A machine elsewhere that does what was simulated here, as it is seen before a reaction. */
typedef struct live_seen {
    bool open;                   /* it is there, ours to command */
    bool holds;                  /* the task that it was sent last */
    uint32_t reports;            /* TD_EVENT_BIT of DOWNLOADED, ENDED, PART_FAILED, */
    char why[400];               /* the last one's reason */
    const td_plant_state *state; /* NULL: not known */
} live_seen;
/* What comes of the reaction. */
typedef struct live_lead {
    uint32_t events; /* that were handed in: TD_EVENT_BIT */
    const td_behaviour_outputs *out;
    const td_task *task;
    const task_run *run;             /* what it came to, simulated */
    const td_plant_command *command; /* of the joints, for this period */
} live_lead;
/* A motion that is to begin: the tool's path in the site, and what the map says of it. */
enum { LIVE_PLAN_POINTS = 61 };
typedef struct live_plan {
    double time_s; /* of the session */
    double duration_s, point[LIVE_PLAN_POINTS][3];
    bool checked, clear; /* against a map; it may begin */
    td_clearance clearance;
} live_plan;

/* In real time: the ticks; where orders come from and where the session is shown. Made by keys (live_begin)
 * or by the panel. All of it is called by the session's thread, which it must not keep waiting. */
struct live {
    td_clock_options options;
    td_clock clock;
    double period_s;
    /* Until `attended` says no: the session begins in IDLE, waits for orders there, and keeps nothing but its
     * newest sample. Else the task is simulated at once. */
    bool lasting;
    int changes; /* of the scenario, by orders: another task from now on */
    /* What is asked for now. */
    td_status (*inputs)(struct live *live, task_inputs *inputs, long period, td_phase phase, td_error *error);
    /* To the orders among `events` (TD_EVENT_BIT): answers by event. May be NULL. */
    void (*answered)(struct live *live, uint32_t events, const td_answer *answer);
    /* Whether an operator is there, who ends the session. */
    bool (*attended)(const struct live *live);
    td_status (*show)(struct live *live, const live_view *view, td_error *error);
    /* Once a period, where the session has a machine of its own: before the reaction, and after it. Then the
     * simulated machine stands where that one does before anything begins, goes with it while it executes,
     * and is moved by the same hand. NULL: there is none. */
    void (*look)(struct live *live, td_phase phase, live_seen *seen);
    td_status (*lead)(struct live *live, const live_lead *lead, td_error *error);
    /* May be NULL. */
    td_status (*planned)(struct live *live, const live_plan *plan, td_error *error);
};
/* Its clock, from what the scenario says. */
void live_pace(struct live *live, const scenario *s, td_log log);
/* The first tick is a period from now. */
td_status live_start(struct live *live, td_error *error);
/* Until the next tick. *missed: its deadline was. */
td_status live_wait(struct live *live, bool *missed, td_error *error);
/* Time goes on from now: nothing moved meanwhile. */
void live_again(struct live *live);

/* Led by keys. */
td_status live_begin(struct live **live, const scenario *s, terminal *term, td_log log, td_error *error);
void live_end(struct live **live);

#endif
