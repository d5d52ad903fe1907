/* What the files of the generator share. */
#ifndef TELEDIMOS_SERVO_TRAJECTORY_GENERATOR_INTERNAL_H
#define TELEDIMOS_SERVO_TRAJECTORY_GENERATOR_INTERNAL_H

#include "servo/trajectory_generator.h"

/* What is planned for. */
typedef struct td_arm {
    const td_robot *robot;
    const td_tool *tool; /* NULL: joints */
    const td_trajectory_options *options;
    double pump_m3_s;
} td_arm;

/* ---- tool.c ---- */

/* The tool's rows, and their derivative (rows,joints) by q. False: roll or yaw where they are undetermined.
 */
bool td_tool_rows(double *value, double *jacobian, const td_arm *arm, const double *q);
/* Angles go to within half a turn of `near`. */
void td_tool_unwrap(double *value, const double *near, const td_tool *tool);
/* Which joints move the tool. */
void td_tool_joints(bool *moves, const td_arm *arm);
/* 1 for a length, radius_m for an angle. */
double td_tool_weight(const td_arm *arm, int row);
void td_tool_off(double *off_m, double *off_rad, const td_tool *tool, const double *difference);

/* ---- redundancy.c ---- */

/* J+ of the weighted task, damped where it is near-singular. */
typedef struct td_inverse {
    int rows, joints;
    double least, damping;                               /* smallest singular value, lambda */
    double plus[TD_ROBOT_MAX_JOINTS * TD_TOOL_ROWS];     /* (joints,rows), of the task as it is */
    double jacobian[TD_ROBOT_MAX_JOINTS * TD_TOOL_ROWS]; /* (rows,joints) */
} td_inverse;
/* Joints with held[k] do not move (held NULL: all move); lambda is at least `damping`. */
void td_inverse_make(td_inverse *inverse, const td_arm *arm, const double *jacobian, const bool *held,
                     double damping);
/* dq = J+ dX. */
void td_inverse_apply(double *dq, const td_inverse *inverse, const double *dx);
/* Adds alpha (I - J+J) grad phi; gives how stiff that is, 1/m of path. */
double td_inverse_avoid(double *dq, const td_inverse *inverse, const td_arm *arm, const double *q);

/* ---- inverse_kinematics.c ---- */

/* As near to `value` as limits let, from q and a few other starts; q is the place. False: not there. */
bool td_reach(double *q, double *off_m, double *off_rad, const td_arm *arm, const double *value);

/* ---- polyline.c ---- */

/* Straight lines with rounded corners between stops; s is the length of the lines, s of a corner its own. */
typedef struct td_polyline {
    int size;      /* of a point */
    size_t count;  /* corners, the ends among them; 2 up */
    double *point; /* (count,size) */
    double *s;     /* (count) */
    double *half;  /* (count) length of rounding before and behind */
    size_t *via;   /* (count) which via a corner is */
} td_polyline;
td_status td_polyline_new(td_polyline *line, int size, size_t capacity, td_error *error);
void td_polyline_free(td_polyline *line);
/* Adds a corner; one that is where the last is, is left out. `weight` of each value in the length. */
void td_polyline_add(td_polyline *line, const double *point, const double *weight, size_t via);
/* Rounds corner i so that no value misses it by more than its tolerance. */
void td_polyline_round(td_polyline *line, size_t i, const double *tolerance);
/* X, X', X''; any may be NULL. */
void td_polyline_at(double *x, double *d1, double *d2, const td_polyline *line, double s);

/* ---- path.c ---- */

/* q over s in [0, s of the last]: quintics between points that have q, q' and q''. */
typedef struct td_path {
    int n;
    size_t count, capacity;
    double *s, *q, *d1, *d2; /* (count), (count,n) */
    size_t event_count;
    td_trajectory_event event[16]; /* in s instead of time */
} td_path;
void td_path_free(td_path *path);
td_status td_path_add(td_path *path, double s, const double *q, td_error *error);
void td_path_at(double *q, double *d1, double *d2, const td_path *path, size_t interval, double s);
/* Of the joints themselves. */
td_status td_path_of_joints(td_path *path, const td_arm *arm, const td_polyline *line, td_error *error);
/* The cubic spline (C2) through the points with these q' at its ends: fills d1, d2. */
td_status td_path_spline(td_path *path, const double *first, const double *last, td_error *error);
/* ---- follow.c: of the tool's rows, from q, which becomes where it ends. */
td_status td_path_of_tool(td_path *path, td_nearest *nearest, const td_arm *arm, const td_polyline *line,
                          double *q, td_error *error);

/* ---- timing: s over time ---- */

/* Nodes in time; between two, s'' is smooth; at one it may jump. */
typedef struct td_timing {
    size_t count;
    double *t, *s, *ds;     /* (count) */
    double *before, *after; /* (count) s'' on either side */
} td_timing;
td_status td_timing_new(td_timing *timing, size_t count, td_error *error);
void td_timing_free(td_timing *timing);
/* time_scaling.c: the fastest; timing_law.c: a law over 1 s. */
td_status td_timing_fastest(td_timing *timing, const td_arm *arm, const td_path *path, td_error *error);
td_status td_timing_of_law(td_timing *timing, const td_path *path, td_timing_law law, double ramp_share,
                           td_error *error);

#endif
