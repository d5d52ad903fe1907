/* A joint motion over time: knots, and quintic polynomials between them.
 *
 * Between two knots each joint follows the polynomial of degree 5 that has the angle, rate and acceleration
 * of both. Two knots may share one time: the acceleration jumps there (angle and rate do not), and from that
 * time on the second one counts. Before the first knot and after the last the joints stand still where those
 * are.
 *
 * As a table: time_s, then for each joint NAME_rad, NAME_rad_s, NAME_rad_s2 (of one that slides NAME_m,
 * NAME_m_s, NAME_m_s2), a row a knot, in numbers that give back the same bits. */
#ifndef TELEDIMOS_CORE_TRAJECTORY_H
#define TELEDIMOS_CORE_TRAJECTORY_H

#include <stddef.h>

#include "hash.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_trajectory_event_kind {
    TD_TRAJECTORY_SINGULAR,  /* the tool could not move some way, or hardly: the inverse was damped */
    TD_TRAJECTORY_NEAR_LIMIT /* a joint came near a limit of its position */
} td_trajectory_event_kind;

/* What happened on the way, for those who watch; it is no part of the table. */
typedef struct td_trajectory_event {
    td_trajectory_event_kind kind;
    double from_s, to_s;
    int joint;      /* near a limit; -1 */
    double least;   /* singular: the smallest singular value of the task's Jacobian (m/rad); near a limit: the
                       smallest distance to it (rad or m) */
    double damping; /* singular: the largest lambda used (m/rad) */
    double off_m, off_rad; /* singular: how far the tool was from its path, at most */
} td_trajectory_event;

typedef struct td_trajectory {
    int joints;
    size_t count;
    double *time_s;       /* (count) from 0; never going back */
    double *q, *dq, *ddq; /* (count,joints) rad or m, 1/s, 1/s^2 */
    size_t event_count;
    td_trajectory_event *event; /* by from_s */
} td_trajectory;

/* `count` (at least 1) knots of zeros. */
TD_API td_status td_trajectory_new(td_trajectory **trajectory, int joints, size_t count, td_error *error);
TD_API void td_trajectory_free(td_trajectory **trajectory);
TD_API double td_trajectory_duration(const td_trajectory *trajectory);
/* (joints) each; any may be NULL. */
TD_API void td_trajectory_at(double *q, double *dq, double *ddq, const td_trajectory *trajectory,
                             double time_s);
/* The same path, `factor` times as long (> 0): rates fall by it, accelerations by its square. */
TD_API void td_trajectory_stretch(td_trajectory *trajectory, double factor);

/* The polynomial of degree 5 through value, first and second derivative at 0 and at h > 0: those three at t.
 */
TD_API void td_quintic(double at[3], const double begin[3], const double end[3], double h, double t);

/* The largest share of a limit that is used: 1 is all of it. Position: how far from the middle of the range,
 * in halves of it. `joint` is that of the cylinder where a flow is meant; -1: no such limit, or the pumps. */
typedef struct td_trajectory_share {
    double share, time_s;
    int joint;
} td_trajectory_share;
typedef struct td_trajectory_shares {
    td_trajectory_share position, speed, acceleration, flow, pump;
} td_trajectory_shares;
/* Looks at every knot, and in between rate_hz times a second; rate_hz 0: where accelerations and rates are
 * extreme, and at thirds. pump_m3_s: of all cylinders together (INFINITY: unlimited). Refused: a robot of
 * other joints, joints where a cylinder does not reach, numbers that are none. */
TD_API td_status td_trajectory_check(td_trajectory_shares *shares, const td_trajectory *trajectory,
                                     const td_robot *robot, double pump_m3_s, double rate_hz,
                                     td_error *error);

/* Refused, naming file, line and column: columns that are no joint's or missing, no rows, times that do not
 * begin at 0, go back or are closer than 1e-6 s but not the same, jumps of angle or rate where two rows share
 * a time, numbers that are none. */
TD_API td_status td_trajectory_read(td_trajectory **trajectory, const char *path, const td_robot *robot,
                                    td_error *error);
TD_API td_status td_trajectory_parse(td_trajectory **trajectory, const char *text, size_t size,
                                     const char *name, const td_robot *robot, td_error *error);
TD_API td_status td_trajectory_write(const td_trajectory *trajectory, const char *path, const td_robot *robot,
                                     td_error *error);
/* SHA-256 of the table as written: the same as of the file. Who validated a motion keeps it, who runs the
 * motion compares. */
TD_API td_status td_trajectory_hash(char hex[TD_HASH_HEX_SIZE], const td_trajectory *trajectory,
                                    const td_robot *robot, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
