/* Limits that hold whatever asks for a motion: speed, acceleration, the end of the joint's range, oil.
 *
 * Stops. A machine that follows with the lag tau comes to rest, when told to, where its joint has p = q + tau
 * dq: p moves by exactly what is commanded, p' = v. From the distance D between p and the stop, braking by at
 * most A = a T a period T, the fastest rate that still stops in time is
 *
 *     v = A (m/2 + D' / (m + 1)),  D' = D / (A T),  m = floor((sqrt(1 + 8 D') - 1) / 2),
 *
 * for then v T + (v - A) T + … = D over the m + 1 periods that it takes; after each, the same formula gives v
 * - A.
 */
#ifndef TELEDIMOS_SERVO_MOTION_LIMITS_H
#define TELEDIMOS_SERVO_MOTION_LIMITS_H

#include <stdbool.h>

#include "../core/plant.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_motion_limits {
    double period_s;           /* between commands; default 0.02 */
    double lag_s;              /* tau; default 0.05 */
    double speed_share;        /* of the robot's limits, in (0, 1]; default 1 */
    double acceleration_share; /* the same */
    double pump_m3_s;          /* all cylinders together; 0 (default): td_robot_pump */
    double margin;             /* stops are taken to be this much nearer, rad or m; default 0.01 */
} td_motion_limits;
TD_API td_motion_limits td_motion_limits_default(void);
/* Refused by name: what is no number or out of range, a joint of unlimited speed or acceleration. */
TD_API td_status td_motion_limits_check(const td_motion_limits *limits, const td_robot *robot,
                                        td_error *error);

/* The v of above; acceleration and period > 0; 0 where distance is not above 0. */
TD_API double td_stopping_speed(double distance, double acceleration, double period_s);

/* Brings wanted rates (joints) within the limits; `last` are those commanded a period before (0 at the
 * start). Too much oil: all rates are scaled by one factor. `together`: so they are for the other limits, so
 * that the tool keeps its direction; else each joint is held by its own. Where limits contradict each other,
 * as where a joint is beyond its stop already, acceleration's counts. False, and rates that brake all joints:
 * a state or a wish that is no number, or a cylinder that does not reach. */
TD_API bool td_motion_limits_apply(double *rate, const td_motion_limits *limits, const td_robot *robot,
                                   const double *q, const double *dq, const double *last, bool together);

/* Rates as the command of that kind: rates, or what flows of oil they need (a feed-forward through the
 * cylinders' levers). False: a force is asked for, or a cylinder does not reach. */
TD_API bool td_rates_command(td_plant_command *command, td_command_kind kind, const td_robot *robot,
                             const double *q, const double *rate);

#ifdef __cplusplus
}
#endif
#endif
