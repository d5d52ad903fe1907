/* Motions of an arm: from where it stands, through via points, to a goal, within every limit of the robot.
 *
 * Path. Straight lines between the vias, of the joints' angles or of rows of the tool's pose. At a via that
 * is passed, X' turns from one line's direction to the next over the length 2 l as 3u^2 - 2u^3: X'' is
 * continuous, and the path misses the via by 3/16 l |u2 - u1|, which is the via's tolerance unless half of a
 * line is shorter.
 *
 * Rows of the tool. A tool is a frame on a link: its x axis is the tool's. Rows are those of root_from_tool =
 * (x, y, z), Rz(yaw) Rx(roll) Ry(pitch): so pitch is the angle of the tool's axis below the horizon in the
 * vertical plane of an arm whose joints turn about the tool's y axis, over the whole turn. roll and yaw are
 * refused where the tool's y axis is nearly vertical. Angles of vias are taken as many turns on as the joints
 * turn on their way. Ask for as many rows as the arm has joints, or fewer.
 *
 * Joints (TELEDIMOS, 2.1). Along the path dq = J+ dX + alpha (I - J+J) grad phi, corrected onto the path at
 * each step, with phi = [sum_i |(q_i - qmid_i) / Dq_i|^p]^(1/p), p = 6, Dq_i half of joint i's range. The
 * paper divides the norm, outside its sum, by one |Dq_i| and takes the largest; then phi is decided by the
 * joint of the shortest range wherever it stands. Inside the sum each joint counts by its own range, and phi
 * reaches 1 where one reaches its limit. Joints without limits do not count. alpha (per m of path) is
 * negative or 0. Where the smallest singular value s of J is below s0 (a share of the largest), J+ is damped:
 * s / (s^2 + l^2), l = s0 (1 - s/s0) (as Nakamura and Hanafusa 1986, with s for their w); the tool may then
 * leave its path by as much as the options allow, which an event reports, and a goal in a singularity is met
 * to 1e-4 m and rad.
 *
 * Time. As fast as the limits allow: the parameterisation of the path by reachable sets (Pham and Pham 2018)
 * with limits of speed, acceleration, each cylinder's flow and the pumps' sum; the acceleration along the
 * path is constant between its grid's points. Or one of the paper's laws r(t) between stops, each stretched
 * until every limit holds. Either is then looked at between its knots, and stretched by what it lacks. */
#ifndef TELEDIMOS_SERVO_TRAJECTORY_GENERATOR_H
#define TELEDIMOS_SERVO_TRAJECTORY_GENERATOR_H

#include "../core/trajectory.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_tool_row {
    TD_TOOL_X,
    TD_TOOL_Y,
    TD_TOOL_Z,
    TD_TOOL_ROLL,
    TD_TOOL_PITCH,
    TD_TOOL_YAW,
    TD_TOOL_ROWS
} td_tool_row;

typedef struct td_tool {
    int link;
    td_pose link_from_tool;
    int row_count;
    td_tool_row row[TD_TOOL_ROWS]; /* asked for, each once */
} td_tool;
/* All six rows (m, rad) of where the tool is. */
TD_API void td_tool_pose(double pose[TD_TOOL_ROWS], const td_robot *robot, const td_tool *tool,
                         const double *q);

typedef enum td_timing_law {
    TD_LAW_FASTEST,
    TD_LAW_CUBIC,                /* r = 3u^2 - 2u^3 */
    TD_LAW_QUINTIC,              /* r = 10u^3 - 15u^4 + 6u^5 */
    TD_LAW_CONSTANT_VELOCITY,    /* r': a trapezoid with ramps of ramp_share of the time */
    TD_LAW_CONSTANT_ACCELERATION /* r'': one sign, then the other */
} td_timing_law;

typedef struct td_via {
    double value[TD_ROBOT_MAX_JOINTS]; /* the tool's rows in its order; or every joint's q (rad or m) */
    bool stop;                         /* the last via is always a stop */
    double tolerance_m, tolerance_rad; /* by how much a passed via may be missed */
} td_via;

typedef struct td_trajectory_options {
    td_timing_law law;
    double duration_s;     /* 0: as short as the limits allow */
    double ramp_share;     /* of TD_LAW_CONSTANT_VELOCITY; in (0, 0.5]; default 0.25 */
    double share;          /* of every limit of speed, acceleration and flow; in (0, 1]; default 1 */
    double pump_m3_s;      /* all the pumps; default 0: the largest of the cylinders' limits */
    double alpha;          /* default -1; 0: no care for limits */
    double power;          /* p; default 6 */
    double radius_m;       /* one radian of a row weighs as much as this; default 1 */
    double singular_share; /* s0 by the largest singular value; default 0.01 */
    double off_m, off_rad; /* how far the tool may leave its path in a singularity; default 0.05, 0.05 */
    double near_share;     /* of a joint's range: nearer to a limit is an event; default 0.02 */
} td_trajectory_options;
TD_API td_trajectory_options td_trajectory_options_default(void);

/* As near as the arm comes to what was asked of it. */
typedef struct td_nearest {
    int via;
    double pose[TD_TOOL_ROWS]; /* of the tool */
    double q[TD_ROBOT_MAX_JOINTS];
    double off_m, off_rad; /* from what was asked, over the rows */
} td_nearest;

/* From q at rest to the last via. tool NULL: vias are joints' angles. *nearest (may be NULL) is filled, and
 * its `via` is not -1, when a via, or the straight line to it, is out of reach (TD_ERROR_DATA): the error
 * says how far. Refused as well: a start or goal beyond limits, joints that must move but have no limit of
 * speed or acceleration, a duration that is too short (the error says the shortest), numbers that are none.
 */
TD_API td_status td_trajectory_plan(td_trajectory **trajectory, td_nearest *nearest, const td_robot *robot,
                                    const td_tool *tool, const double *q, const td_via *via, size_t via_count,
                                    const td_trajectory_options *options, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
