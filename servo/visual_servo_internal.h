/* What the files of the visual servo share. Plain arrays: ViSP's wall takes them too. */
#ifndef TELEDIMOS_SERVO_VISUAL_SERVO_INTERNAL_H
#define TELEDIMOS_SERVO_VISUAL_SERVO_INTERNAL_H

#include "servo/visual_servo.h"

enum { TD_SERVO_ROWS = 2 * TD_SERVO_MAX_POINTS };

/* ---- visual_features.c ---- */

/* s, s* and how they move. */
typedef struct td_servo_features {
    td_servo_kind kind;
    td_interaction interaction;
    int count;                           /* points that are seen */
    double now[TD_SERVO_MAX_POINTS][3];  /* x, y, Z */
    double goal[TD_SERVO_MAX_POINTS][3]; /* the same points */
    td_pose goal_from_camera;            /* TD_SERVO_POSE */
    double radius_m;
} td_servo_features;

/* e (rows) and L (rows,6) for [omega; v]. Returns the rows. */
int td_servo_error_of(double *e, const td_servo_features *features);
int td_servo_interaction(double *l, const td_servo_features *features);
/* A point's rows (2,6). */
void td_servo_point_rows(double rows[12], double x, double y, double depth);

/* The camera's twist against the target by the joints' rates (6,joints), and root_from_camera (may be NULL);
 * I without a robot, and joints = 6. */
void td_servo_jacobian(double *jacobian, td_pose *root_from_camera, const td_servo_eye *eye, const double *q);

/* ---- visual_servo.c ---- */

/* Those of the goal's points that are seen, and which they are; of a pose count is 1 or 0. Fails: another
 * kind or number than the goal's, no numbers, behind the camera. */
td_status td_servo_gather(td_servo_features *features, int *index, const td_visual_servo *servo,
                          const td_servo_sight *sight, td_error *error);

/* ---- visual_law.c ---- */

/* share: singular values below this share of the largest are damped. by_error: so are all, by mu^2 = by_error
 * |J J+ e|^2 (Sugihara 2011): far from the goal no joint is sent round for little, near it nothing is lost.
 */
typedef struct td_task_damping {
    double share, by_error;
} td_task_damping;

/* J+ e of J (rows,columns) and what J can do. */
typedef struct td_task_inverse {
    int rank;                         /* singular values above 1e-6 of the largest */
    int damped;                       /* those below the share, of them */
    double step[TD_ROBOT_MAX_JOINTS]; /* J+ e */
    double seen[TD_SERVO_ROWS];       /* J J+ e, undamped: the part of e that J reaches */
    double basis[TD_ROBOT_MAX_JOINTS * TD_ROBOT_MAX_JOINTS]; /* (rank,columns): V^T of what it reaches, where
                                                                rank < columns */
} td_task_inverse;
/* e may be NULL: then only ranks. held (may be NULL): columns taken for 0. */
void td_task_invert(td_task_inverse *inverse, const double *j, const double *e, int rows, int columns,
                    const bool *held, const td_task_damping *damping);
/* J+ itself (columns,rows), damped as above. */
void td_task_pseudo_inverse(double *plus, const double *j, int rows, int columns, double share);

double td_servo_gain(const td_visual_servo_options *options, const double *step, int n);

/* The second task: rates that lead away from limits, added to `extra` (joints). False where none is near. */
bool td_servo_avoid(double *extra, const td_visual_servo_options *options, const td_robot *robot,
                    const double *q, const double *rate, const double *j, const double *e,
                    const td_task_inverse *inverse, int rows);

/* ---- visual_servo_visp.cpp, a module ---- */

#define TD_SERVO_VISP_MODULE "libteledimos_servo_visp.so"
#define TD_SERVO_VISP_FUNCTION "td_visp_servo"

/* vpServo's -lambda J+ e, of the features and the Jacobian (6,joints); gain: zero, infinity, slope. */
typedef td_status td_visp_servo_function(double *rate, double *gain, const td_servo_features *features,
                                         const double *jacobian, int joints, const double settings[3],
                                         td_error *error);

#endif
