/* Moving by hand: a joint, or the tool along an axis, as far as the stick is pushed, and never past a limit.
 *
 * Before the end of a joint's range the rate falls so that the joint stops there with its own acceleration
 * (servo/motion_limits.h); so do speed, acceleration and oil bound what the stick asks. The tool keeps its
 * direction: what slows one joint slows all. Its attitude it keeps where the arm can (the angle of its x axis
 * to the horizon). */
#ifndef TELEDIMOS_SERVO_JOG_H
#define TELEDIMOS_SERVO_JOG_H

#include "motion_limits.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_jog_kind {
    TD_JOG_NOTHING, /* brakes */
    TD_JOG_JOINT,
    TD_JOG_TOOL
} td_jog_kind;

typedef struct td_jog_wish {
    td_jog_kind kind;
    double stick; /* -1 to 1; beyond is held */
    int joint;    /* stick 1: its full speed */
    int link;     /* the tool: a point of a link, m in its frame, */
    double point_m[3];
    double axis[3];   /* along this, in the root's frame (any length) … */
    double speed_m_s; /* … at this speed where stick is 1 */
} td_jog_wish;

typedef struct td_jog {
    const td_robot *robot; /* borrowed */
    td_motion_limits limits;
    td_command_kind kind;
    double rate[TD_ROBOT_MAX_JOINTS]; /* commanded last */
} td_jog;

/* At rest. Limits NULL: defaults. kind: rates or flows. */
TD_API td_status td_jog_start(td_jog *jog, const td_robot *robot, const td_motion_limits *limits,
                              td_command_kind kind, td_error *error);
/* Once a period. Fails, with a command that brakes all joints: no such joint or link, an axis of no length,
 * what is no number. */
TD_API td_status td_jog_step(td_plant_command *command, td_jog *jog, const td_jog_wish *wish,
                             const td_plant_state *state, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
