/* The parts of `teledimos vehicle`. */
#ifndef TELEDIMOS_APPS_VEHICLE_INTERNAL_H
#define TELEDIMOS_APPS_VEHICLE_INTERNAL_H

#include <jansson.h>

#include "apps/cli.h"
#include "apps/gate.h"
#include "calib/kinematic.h"
#include "calib/observations.h"
#include "calib/vehicle.h"
#include "core/csv.h"
#include "core/dataset.h"
#include "core/hash.h"
#include "core/schema.h"

enum { VEHICLE_MOST_ADVICE = 3, VEHICLE_MAP_COLUMNS = 48, VEHICLE_MAP_ROWS = 36 };

/* How the job is done. */
typedef struct vehicle_how {
    const char *rig, *robot, *mount; /* NULL: the dataset's */
    const cli_list *offsets;         /* JOINT=SIGMA_DEG, JOINT=free */
    bool closed, advise, accept;
    int threads;
    double outlier_sigma;
    const td_progress *progress;
    const td_log *log;
} vehicle_how;

/* Worst sigma of the tip over a side view of the working space, mm; NaN: out of reach. */
typedef struct vehicle_map {
    bool made;
    double x_min, x_max, z_min, z_max; /* m, vehicle's frame */
    double value[VEHICLE_MAP_ROWS * VEHICLE_MAP_COLUMNS];
} vehicle_map;

typedef struct vehicle_job {
    const td_dataset *dataset;
    const vehicle_how *how;
    const char *robot_path, *rig_path;
    td_robot *robot;
    td_rig *rig; /* NULL: kinematic calibration */
    td_csv *joints;
    const char **pose_name; /* (poses) lent from `joints`, or `names` */
    char (*names)[TD_NAME_SIZE];
    td_vehicle_data data;
    int tip;
    char hash[TD_HASH_HEX_SIZE];

    td_vehicle *result;
    size_t advice_count;
    char advice[VEHICLE_MOST_ADVICE][320];
    double advice_q[VEHICLE_MOST_ADVICE][TD_ROBOT_MAX_JOINTS];
    vehicle_map map;
    gate_result gate;
    bool wanted; /* the rig is written */
} vehicle_job;

/* vehicle_joints.c: readings of the joints out of a table. */
/* Into job->data.q; columns of joints between `mount` and the links listed are needed, the others may lack.
 */
td_status vehicle_read_joints(vehicle_job *job, const int *link, size_t links, td_error *error);
/* Number of the pose of this name; -1. */
long vehicle_find_pose(const vehicle_job *job, const char *name);

/* vehicle_data.c: robot, rig, readings, points and sights. */
td_status vehicle_read_robot(vehicle_job *job, td_error *error);
td_status vehicle_read(vehicle_job *job, td_error *error);
td_status vehicle_find_link(int *link, const vehicle_job *job, const char *what, const char *name,
                            td_error *error);
void vehicle_free(vehicle_job *job);

/* vehicle_solve.c: the solution, the map of the tip's sigma, the poses that would help. */
td_status vehicle_solve(vehicle_job *job, td_error *error);

/* vehicle_result.c */
extern const gate_row vehicle_gate_defaults[];
extern const size_t vehicle_gate_count;
extern const td_schema_row vehicle_schema[];
extern const size_t vehicle_schema_count;
void vehicle_judge(vehicle_job *job, const gate_row *rows);
json_t *vehicle_result(const vehicle_job *job);
/* Root mean square residual, px, of a pose's and of a point's sights; how many were used and left out. */
double vehicle_pose_rms(size_t *used, size_t *left_out, const vehicle_job *job, size_t pose);
double vehicle_point_rms(size_t *used, size_t *left_out, const vehicle_job *job, int point);
/* The largest noise that was found of a pose's joints, in its sigmas; NaN with --closed. */
double vehicle_noise_sigmas(const vehicle_job *job, size_t pose);
/* What the rig's provenance says of its place on the vehicle. */
json_t *vehicle_provenance(const vehicle_job *job);

/* vehicle_report.c */
void vehicle_table(const vehicle_job *job);
td_status vehicle_report(const vehicle_job *job, const char *path, td_error *error);

/* vehicle_kinematic.c: the chain's origins, where the dataset holds target_poses. */
typedef struct vehicle_kinematic {
    td_kinematic *result;
    size_t held_out;
    double held_out_mm, held_out_deg; /* mean over every fifth pose, predicted from the others; NaN */
    gate_result gate;
} vehicle_kinematic;
extern const td_schema_row vehicle_kinematic_schema[];
extern const size_t vehicle_kinematic_schema_count;
td_status vehicle_kinematic_solve(vehicle_kinematic *k, vehicle_job *job, td_error *error);
void vehicle_kinematic_judge(vehicle_kinematic *k, const vehicle_job *job);
json_t *vehicle_kinematic_result(const vehicle_kinematic *k, const vehicle_job *job);
void vehicle_kinematic_table(const vehicle_kinematic *k, const vehicle_job *job);
td_status vehicle_kinematic_report(const vehicle_kinematic *k, const vehicle_job *job, const char *path,
                                   td_error *error);

/* vehicle_init.c: a dataset to fill in. */
td_status vehicle_init(const char *folder, td_error *error);

#endif
