/* What the files of the plan of a trench share. Planes are named by g: the floor raised by g (m). Along and
 * across are those of td_dig_floor: a from the far end along the heading, t to its left. */
#ifndef TELEDIMOS_SERVO_DIG_INTERNAL_H
#define TELEDIMOS_SERVO_DIG_INTERNAL_H

#include "servo/dig_plan.h"
#include "servo/trajectory_generator_internal.h"

/* What is planned with. */
typedef struct dig_job {
    const td_dig_request *request;
    td_dig_options o;
    td_robot *robot; /* limits narrowed by the margin */
    td_tool tool;    /* rows x, y, z, pitch */
    td_arm arm;
    td_trajectory_options arm_options;
    td_pose vehicle_from_site;
    td_dig_floor floor;
    double heading[2];  /* unit */
    td_elevation *map;  /* as it will be when the passes so far are done */
    double floor_rad;   /* of the bucket's floor below the tool's axis */
    double upright_rad; /* pitch of the tool where the mouth is upright */
    double heel_m;      /* from the edge to the floor's rear end */
    double axis[2];     /* of the swing, in the vehicle's plan */
    double aside_m;     /* of the arm's plane, to the left of that axis */
    int swing;          /* joint */
    double still_rad;   /* azimuth of the arm's plane when it is 0 */
    double swing_sign;  /* 1: it turns left */
    int first, pin;     /* links: the first that a planar joint moves, the last that any joint does */
    double dump[3];     /* where the edge is when the bucket opens; site */
    double dumped_m3;   /* so far */
    double dump_ground; /* under the heap */
} dig_job;

/* A posture: of the tool in the site. */
typedef struct dig_pose {
    double at[3], pitch;
} dig_pose;

typedef struct dig_cell {
    size_t index;
    double a, t, floor; /* place, and the floor's height there */
    double met;         /* where along the lane the edge's middle is when it passes */
    bool inside;        /* the trench */
} dig_cell;

typedef struct dig_lane {
    double t;             /* of its middle */
    double first, last;   /* along; a little beyond the ends where the edge lies askew to them */
    double from, to, g;   /* what is reached of that: down to the floor raised by g */
    td_dig_reason reason; /* why no more is */
    size_t count;
    dig_cell *cell; /* (count) that the edge sweeps */
    bool done;
} dig_lane;

/* ---- dig_columns.c: what is counted ---- */

void dig_place(double at[3], const dig_job *job, double a, double t, double g);
/* Height of the cell around a place; NaN: unknown, or off the map. */
double dig_ground(const td_elevation *map, double x, double y);
/* Fits the floor to the map; refuses what is not known. `across`: slope of the edge there. */
td_status dig_fit_floor(dig_job *job, double depth_m, td_error *error);
td_status dig_check_trench(const dig_job *job, td_error *error);
/* Above the floor, in the trench, m^3. */
double dig_trench_volume(const dig_job *job, double *depth_m);
td_status dig_sweep_lane(dig_lane *lane, const dig_job *job, td_error *error);
/* Of the lane's columns in [from, to] above plane g, m^3. */
double dig_above(const dig_job *job, const dig_lane *lane, double g);
/* First and last place along at which something stands above the plane by 1 cm. False: nowhere. */
bool dig_extent(double *from, double *to, const dig_job *job, const dig_lane *lane, double g);
/* The plane above which `volume` stands. */
double dig_plane_of(const dig_job *job, const dig_lane *lane, double volume);
/* Takes off what is above the plane in [from, to]: m^3, and the largest depth. */
double dig_cut(dig_job *job, const dig_lane *lane, double from, double to, double g, double *depth_m);
/* Highest known ground within `radius` of a place; -INFINITY: none. With the heap that is being dumped. */
double dig_highest(const dig_job *job, const double at[2], double radius);
/* The same below the bucket, whichever way it points. */
double dig_below(const dig_job *job, const double at[2]);

/* ---- dig_reach.c: where the machine can go ---- */

td_status dig_machine(dig_job *job, td_error *error);
/* The edge's direction in the site (to the left of the arm) when its middle is there. */
void dig_edge(double edge[3], const dig_job *job, const double at[3]);
double dig_askew(const dig_job *job,
                 const double at[3]); /* of the arm's plane to the heading, rad, absolute */
/* q: from where it is sought; then the joints there. */
bool dig_reach(double *q, const dig_job *job, const dig_pose *pose);
/* Whether the arm between its foot and the bucket's pin touches the ground. */
bool dig_arm_clear(const dig_job *job, const double *q);
/* A straight way of the tool, its samples reached and clear. `reason` says what is not. */
bool dig_line(double *q, const dig_job *job, const dig_pose *from, const dig_pose *to, td_dig_reason *reason);
/* Between two postures by the joints in one line: by how much the bucket is too low, m; at most 0: clear.
 * `where`: the share of the way at which it is lowest. */
double dig_too_low(double *where, const dig_job *job, const double *from, const double *to);
/* Where the tool is. */
void dig_pose_of(dig_pose *pose, const dig_job *job, const double *q);
/* How far the shell reaches below the edge at a pitch, m. */
double dig_shell(const dig_job *job, double pitch);

/* ---- dig_drag.c: one drag ---- */

typedef struct dig_drag {
    double from, to, g;
    double top; /* ground above its far end, highest */
    /* Return to; approach to; bottom of the far end; end; off the near wall; lifted. */
    dig_pose above, over, in, out, off, up;
    double q_above[TD_ROBOT_MAX_JOINTS], q_over[TD_ROBOT_MAX_JOINTS], q_in[TD_ROBOT_MAX_JOINTS],
        q_out[TD_ROBOT_MAX_JOINTS], q_off[TD_ROBOT_MAX_JOINTS], q_up[TD_ROBOT_MAX_JOINTS];
} dig_drag;
/* From upright, of the mouth of a full bucket that is carried, at most. */
double dig_carry_tilt(const dig_job *job);
/* The drag from drag->from to drag->to; `fails`: the place along at which it is not reached. */
bool dig_drag_whole(dig_drag *drag, const dig_job *job, const dig_lane *lane, td_dig_reason *reason,
                    double *fails);
/* The longest drag within drag->from … to that is reached, at least DIG_LEAST_M. False: none; `reason`: what
 * stood in the way last. */
#define DIG_LEAST_M 0.3
bool dig_drag_make(dig_drag *drag, const dig_job *job, const dig_lane *lane, td_dig_reason *reason);

/* ---- dig_moves.c: a pass as moves ---- */

typedef struct dig_pass {
    int pass, lane;
    double cut_m3, depth_m;
} dig_pass;
/* From where the joints stand (q) to where the bucket is empty, which q then is. Raises what it passes over
 * until that is clear. */
td_status dig_moves_add(td_dig_plan *plan, dig_job *job, dig_drag *drag, const dig_pass *pass, double *q,
                        td_error *error);

#endif
