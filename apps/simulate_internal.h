/* teledimos simulate, between its files: what was asked for, and what came of it. */
#ifndef TELEDIMOS_APPS_SIMULATE_INTERNAL_H
#define TELEDIMOS_APPS_SIMULATE_INTERNAL_H

#include "apps/gate.h"
#include "apps/job.h"
#include "apps/station.h"
#include "sim/excitation.h"
#include "sim/machine.h"

enum { SIMULATE_MAX_ROWS = 1 << 20, SIMULATE_MAX_SWEEP = 16 };

/* Commands over time: straight lines between rows; two rows at one time are a jump. */
typedef struct motion {
    char kind[TD_NAME_SIZE]; /* "trapezoid" … */
    td_command_kind command;
    size_t count;
    double *time_s; /* (count), rising, the first at 0 */
    double *value;  /* (count,n) */
} motion;

typedef struct scenario {
    char name[TD_NAME_SIZE], path[1024], robot_path[1024];
    td_robot *robot;
    td_plant_state start;
    td_machine_options options;
    double duration_s, log_s;
    motion motion;
    const char *compile_folder; /* for the robot's generated dynamics; NULL: evaluated, not compiled */
    double gain_1_s, period_s;  /* of the controller of positions; period 0: none, commands go straight in */
    struct task_setup *task;    /* in place of a motion; NULL: none */
    bool has_ground;            /* the machine stands in the world, on: */
    station_ground ground;
    td_elevation *map; /* NULL: not made yet */
} scenario;

/* A row of the log. */
typedef struct sample {
    td_plant_state state;
    double command[TD_ROBOT_MAX_JOINTS]; /* as given to the machine */
    double wanted[TD_ROBOT_MAX_JOINTS];  /* position that a motion of rates leads to */
    td_machine_energy energy;
    td_integrator_counters count;
} sample;

/* One simulation. */
typedef struct run_result {
    size_t count;
    sample *sample; /* (count) */
    td_integrator_counters counters;
    td_machine_event *event;
    size_t event_count;
    double cpu_s;  /* of this thread, logging left out */
    bool unstable; /* it did not end: the sentence says why */
    char why[300];
} run_result;

typedef struct sweep_row {
    double period_s, gain_1_s, oil_n_m;
    bool coriolis, stable;
    double error_rad; /* largest distance from what was wanted, in the motion's time */
    double swing_rad; /* from end to end, in the last quarter of twice that time */
    double apart_rad; /* largest distance from the motion with Coriolis terms */
    long rates, steps;
    double cpu_share; /* of real time */
} sweep_row;
typedef struct sweep {
    size_t period_count, gain_count, oil_count;
    sweep_row period[SIMULATE_MAX_SWEEP], gain[SIMULATE_MAX_SWEEP], oil[SIMULATE_MAX_SWEEP], coriolis[2];
    double limit_s; /* the longest period that was stable; 0: none */
} sweep;

typedef struct simulate_job {
    scenario scenario;
    run_result run;
    bool has_sweep;
    sweep sweep;
    gate_result gate;
} simulate_job;

extern const td_schema_row simulate_schema[];
extern const size_t simulate_schema_count;
extern const gate_row simulate_gate_defaults[];
extern const size_t simulate_gate_count;

/* A folder with scenario.yaml, or the file. */
td_status scenario_read(scenario *s, const char *path, td_error *error);
void scenario_free(scenario *s);

/* The `motion` of a scenario; `folder` is where its table lies. */
struct td_field;
td_status motion_read(motion *m, const struct td_field *field, const td_robot *robot, double duration_s,
                      const char *folder, td_error *error);
/* Nothing is commanded. */
td_status motion_none(motion *m, const td_robot *robot, td_error *error);
void motion_free(motion *m);
/* Value and slope of the commands (n) from `time_s` on, and when the line next bends (INFINITY: never). */
void motion_at(double *value, double *slope, double *next_s, const motion *m, double time_s, int joints);
/* Integral of the values from 0 on. */
void motion_integral(double *sum, const motion *m, double time_s, int joints);

/* TD_ERROR_CANCELLED when progress says so. A motion that the integrator cannot follow is not an error with
 * `may_fail`: run->unstable. */
td_status simulate_run(run_result *run, const scenario *s, bool may_fail, const td_progress *progress,
                       td_error *error);
void run_free(run_result *run);
td_status simulate_log_write(const run_result *run, const scenario *s, const char *path, td_error *error);

td_status simulate_sweep(sweep *w, const scenario *s, const td_progress *progress, td_error *error);

void simulate_judge(simulate_job *j, const gate_row *rows);
json_t *simulate_result(const simulate_job *j);
void simulate_table(const void *done);
td_status simulate_report(const void *done, const char *path, td_error *error);

/* --identify: parameters from a recorded motion. */
typedef struct identify_job {
    const scenario *scenario;
    const char *path; /* of the log */
    size_t count;
    double *time_s, *position, *rate, *force, *base; /* as td_motion_log's; rate, base: NULL when not there */
    td_identification *id;
    td_excitation proposed;
    run_result run;          /* the proposed motion, simulated */
    td_identification *then; /* from its log, with the noise of the one given; NULL: it could not be */
    gate_result gate;
} identify_job;
extern const td_schema_row identify_schema[];
extern const size_t identify_schema_count;
extern const gate_row identify_gate_defaults[];
extern const size_t identify_gate_count;
td_status identify_run(identify_job *j, uint64_t seed, const td_progress *progress, td_error *error);
void identify_free(identify_job *j);
/* proposed.yaml and proposed.csv into a folder. */
td_status identify_write(const identify_job *j, const char *folder, td_error *error);
void identify_judge(identify_job *j, const gate_row *rows);
json_t *identify_result(const identify_job *j);
void identify_table(const void *done);
td_status identify_report(const void *done, const char *path, td_error *error);

/* Largest absolute value of an entry of a sample, and roll, pitch, yaw of the base. */
void simulate_angles(double rpy[3], const td_pose *site_from_vehicle);
bool simulate_is_motor(const td_robot *robot, int joint);

#endif
