/* A machine on two tracks along a way: turns in place, straight lines and arcs, each passed from rest to
 * rest. To a goal it goes by two arcs of less than 90 degrees where their radii are 2 m or more, for a turn
 * in place shifts a machine that stands heavier on one end; else it turns there, goes straight, and turns.
 *
 * Where it should be moves along the way (trapezoid of speed). The tracks' speeds lead it there and take back
 * how far it is off, as Kanayama, Kimura, Miyazaki and Noguchi ("A stable tracking control method for an
 * autonomous mobile robot", ICRA 1990): with the error (x, y, theta) in the machine's axes, v_r and w_r of
 * the way, v = v_r cos theta + k_x x and w = w_r + v_r k_y y + |v_r| k_theta sin theta; at its end and where
 * it turns in place w = w_r + k_turn sin theta (ours). Tracks: v -+ w b, b half their gauge; where one is
 * beyond the speed limit both are slowed alike. Slip is not known to it, only seen. */
#ifndef TELEDIMOS_SERVO_TRACK_DRIVE_H
#define TELEDIMOS_SERVO_TRACK_DRIVE_H

#include <stdbool.h>

#include "../core/pose.h"
#include "../core/task.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_track_drive_options {
    double half_gauge_m;      /* of the middles of the tracks; default 1.1 */
    double speed_m_s;         /* default 0.5; a drive's own speed_m_s comes before it */
    double acceleration_m_s2; /* default 0.3 */
    double limit_m_s;         /* of a track; default 1.5 */
    double tolerance_m,
        tolerance_rad; /* it has arrived within these, along the way and in heading; 0.05, 1 deg */
    double patience_s; /* for arriving, after the time the way takes; default 20 */
} td_track_drive_options;
TD_API td_track_drive_options td_track_drive_options_default(void);

/* Parts of a way: turn in place, then go. */
typedef struct td_track_part {
    double length_m, turn_rad; /* along; by how much the heading turns */
} td_track_part;

enum { TD_TRACK_PARTS = 3 };
typedef struct td_track_drive {
    td_track_drive_options options;
    int part_count, part;
    td_track_part way[TD_TRACK_PARTS];
    double from[3]; /* where the part begins: x, y, heading; site */
    double along_s; /* on the part */
    double speed_m_s, late_s;
    double off_m, off_rad; /* how far it is from where it should be */
    bool done, stuck;      /* arrived; or not, though patience is over */
} td_track_drive;

/* From where the machine stands. A goal behind it within 60 deg is driven to backwards. A goal of frame
 * vehicle is of site_from_vehicle. Refused: numbers that are none, speeds not above 0. */
TD_API td_status td_track_drive_start(td_track_drive *drive, const td_task_drive *task, td_task_frame frame,
                                      const td_pose *site_from_vehicle, const td_track_drive_options *options,
                                      td_error *error);
/* Once a period: the speeds of the tracks; 0 when done or stuck. */
TD_API void td_track_drive_step(double *left_m_s, double *right_m_s, td_track_drive *drive,
                                const td_pose *site_from_vehicle, double period_s);
/* Where the part under way is, or the whole way ends, as x, y, heading. */
TD_API void td_track_drive_wanted(double at[3], const td_track_drive *drive);
/* The way's points, at most `most` of them: x, y, heading, evenly, from the start of the first part. */
TD_API int td_track_drive_way(double (*at)[3], int most, const td_track_drive *drive);

#ifdef __cplusplus
}
#endif
#endif
