/* What the rooms of camera-to-vehicle calibration share: the model, and the chain of joints that matters.
 *
 * A point p of link L in pose k is seen by camera c at
 *   pixel = project(camera_from_rig  mount_from_rig^-1  mount_from_link(q_k + offset + noise_k)  p),
 * with q_k the readings. Only joints between the mount and a seen point take part: the chain. */
#ifndef TELEDIMOS_CALIB_VEHICLE_INTERNAL_H
#define TELEDIMOS_CALIB_VEHICLE_INTERNAL_H

#include "calib/vehicle.h"
#include "core/least_squares.h"

enum { TD_VEHICLE_MAX_CHAIN = TD_MAX_BLOCK_SIZE, TD_VEHICLE_MAX_CHUNKS = 4, TD_VEHICLE_MAX_OPEN = 8 };

typedef struct td_vehicle_model {
    const td_vehicle_data *data;
    int joints;                      /* of the chain */
    int joint[TD_VEHICLE_MAX_CHAIN]; /* their numbers in the robot */
    td_pose mount_from_rig;
    double offset[TD_VEHICLE_MAX_CHAIN];
    double *noise;      /* (poses, joints of the chain) */
    double (*place)[3]; /* (points) in the link's frame, or in the board's */
    td_pose *board;     /* (boards) link_from_board */
    bool *seen;         /* (points) */
    bool *used;         /* (sights) */
    /* The rig's parameters are its own plus factor z; z is held at 0 and its covariance is the identity. */
    size_t factor_rows, factor_columns;
    double *factor; /* (rows, columns): square root of the rig's covariance */
    double z[TD_VEHICLE_MAX_CHUNKS * TD_MAX_BLOCK_SIZE];
} td_vehicle_model;

typedef struct td_vehicle_term {
    const td_vehicle_model *model;
    const td_vehicle_sight *sight;
} td_vehicle_term;

typedef struct td_vehicle_problem {
    td_problem *problem;
    td_vehicle_term *term; /* (sights) */
    int mount, offset;
    int *noise; /* (poses) */
    int *place; /* (points) of a board's points: the board's */
    int board[TD_VEHICLE_MAX_BOARDS];
    int chunks, chunk[TD_VEHICLE_MAX_CHUNKS], chunk_size[TD_VEHICLE_MAX_CHUNKS];
} td_vehicle_problem;

/* What is known of: the perturbation of mount_from_rig (6), the chain's offsets, the points' places (3 each;
 * of boards' points nothing: their places are exact in the board), the perturbations of the boards (6 each).
 *
 * Open directions are those along which the sights say nothing (null), and those along which the rig's pose
 * is known to no better than TD_VEHICLE_OPEN (a turn counts by what it does at TD_VEHICLE_REACH): joint noise
 * alone can make an open direction look determined to some metres. The covariance along null directions is
 * 1 (rad or m)^2. */
#define TD_VEHICLE_OPEN 0.3  /* m */
#define TD_VEHICLE_REACH 3.0 /* m */
typedef struct td_vehicle_belief {
    int joints, points, boards;
    int joint[TD_VEHICLE_MAX_CHAIN];
    bool on_board[TD_VEHICLE_MAX_POINTS];
    int tip; /* link */
    size_t size;
    double *covariance; /* (size,size) */
    size_t open_count;
    double *open; /* (TD_VEHICLE_MAX_OPEN,size) */
} td_vehicle_belief;

/* vehicle_check.c */
td_status td_vehicle_check(const td_vehicle_data *data, const td_vehicle_options *options, td_error *error);
/* "pose 07", or its number where poses have no names. */
enum { TD_VEHICLE_POSE_TEXT = TD_NAME_SIZE + 8 };
const char *td_vehicle_pose_text(char text[TD_VEHICLE_POSE_TEXT], const td_vehicle_data *data, size_t pose);
/* Poses whose readings differ from those of every pose before. */
size_t td_vehicle_distinct_poses(const td_vehicle_model *model);

/* vehicle_model.c */
td_status td_vehicle_model_new(td_vehicle_model *model, const td_vehicle_data *data, td_error *error);
void td_vehicle_model_free(td_vehicle_model *model);
/* The moving joints between two links, in the robot's order, added to those in joint[]. */
td_status td_vehicle_add_chain(int *joint, int *count, const td_robot *robot, int a, int b, td_error *error);
/* a_from_link at q (robot's joints) and, where jacobian is not NULL, its left perturbation (6, joints) by the
 * joints listed. */
td_pose td_vehicle_arm(double *jacobian, const td_robot *robot, int a, int link, const double *q,
                       const int *joint, int joints);
/* Readings of a pose, plus the model's offsets and that pose's noise. */
void td_vehicle_joints(double q[TD_ROBOT_MAX_JOINTS], const td_vehicle_model *model, size_t pose);
/* Residual of a sight, px. False: behind the camera. */
bool td_vehicle_residual(double r[2], const td_vehicle_model *model, const td_vehicle_sight *sight);
/* A point in its link's frame. */
void td_vehicle_place(double x[3], const td_vehicle_model *model, int point);
/* Its derivatives (2, …) by mount_from_rig, the offsets (as by the noise) and the place (2,3) or, of a
 * board's point, the board's perturbation (2,6), over sigma_px. */
bool td_vehicle_linearise(double by_mount[12], double *by_joint, double by_place[12],
                          const td_vehicle_model *model, const td_vehicle_sight *sight);
td_status td_vehicle_problem_new(td_vehicle_problem *problem, td_vehicle_model *model, const td_loss *loss,
                                 td_error *error);
void td_vehicle_problem_free(td_vehicle_problem *problem);

/* vehicle_start.c */
/* The start of the model: mount_from_rig and the places. */
td_status td_vehicle_start(td_vehicle_model *model, td_error *error);
/* The paper's way; *poses 0 where no pose shows six known points. */
td_status td_vehicle_closed(td_pose *mount_from_rig, size_t *poses, const td_vehicle_model *model,
                            td_error *error);

/* vehicle_words.c */
/* Fills null_direction from the belief. */
void td_vehicle_null_words(td_vehicle *result, const td_vehicle_model *model);
void td_vehicle_weak_words(td_vehicle *result, const td_vehicle_model *model);

/* vehicle_tip.c */
td_status td_vehicle_belief_new(td_vehicle_belief **belief, const td_vehicle_model *model,
                                const td_vehicle_problem *problem, const td_covariance *covariance, int tip,
                                td_error *error);
void td_vehicle_belief_free(td_vehicle_belief **belief);
td_status td_vehicle_tip_grid(td_vehicle *result, const td_vehicle_data *data, td_error *error);
#endif
