/* A task: what an operator asks of a machine, step by step, with limits and tolerances, as a YAML file.
 *
 *   teledimos: task 1
 *   name: trench-1
 *   about: free text                                        (may be missing)
 *   frame: vehicle                                          (default; or site)
 *   tool: {link: bucket_tip, point_m: [0, 0, 0], axis: [1, 0, 0]}
 *   limits: {speed_m_s: 1, acceleration_m_s2: 2, joint_speed_share: 0.8, pump_share: 1}
 *   tolerance: {position_m: 0.05, angle_deg: 2, force_n: 1000}
 *   steps:
 *     - position: {to: {x_m: 7, y_m: 0, z_m: 1.5, pitch_deg: 60}, via: [{x_m: 6, y_m: 1, z_m: 2}],
 *                  law: quintic, duration_s: 6}
 *     - position: {joints: {boom_deg: -30, arm_deg: 90}}      (NAME_deg; of one that slides NAME_m)
 *     - drive: {to: {x_m: 2, y_m: 0, yaw_deg: 0}, speed_m_s: 0.5}
 *     - drive: {distance_m: 3, turn_deg: 20}                  (an arc; or one of the two)
 *     - dig: {from: {x_m: 7, y_m: 0, z_m: 0}, heading_deg: 180, length_m: 2, depth_m: 0.4, width_m: 1.2,
 *            force_n: 40000}
 *     - dump: {at: {x_m: 3, y_m: 5, z_m: 2}}
 *     - press: {axis: [0, 0, -1], force_n: 20000, for_s: 3, approach_speed_m_s: 0.02, most_travel_m: 0.3}
 *     - wait: {for_s: 1}
 *
 * Frame vehicle: the robot's root link as it stands when a step begins. A point may have pitch_deg, the angle
 * of the tool's axis below the level plane, or q: [w, x, y, z], the tool link's whole attitude in the frame;
 * without either its attitude is free. The tool is a point of a link and its axis there; missing: the end of
 * the robot's chain, that is its last link, its origin, its x axis. What is missing of limits is the robot's
 * own; of the tolerances 0.05 m, 2 deg and 1000 N; law: fastest, and no duration as the limits allow. */
#ifndef TELEDIMOS_CORE_TASK_H
#define TELEDIMOS_CORE_TASK_H

#include <stdbool.h>
#include <stddef.h>

#include "hash.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_TASK_MAX_STEPS = 1000, TD_TASK_MAX_VIA = 100, TD_TASK_ABOUT_SIZE = 1024 };

typedef enum td_task_frame { TD_TASK_VEHICLE, TD_TASK_SITE } td_task_frame;

typedef enum td_task_attitude { TD_TASK_FREE, TD_TASK_PITCH, TD_TASK_WHOLE } td_task_attitude;
typedef struct td_task_point {
    double at_m[3];
    td_task_attitude attitude;
    double pitch_deg; /* TD_TASK_PITCH */
    double q[4];      /* TD_TASK_WHOLE: w, x, y, z, of length 1 */
} td_task_point;

typedef struct td_task_joint {
    char name[TD_NAME_SIZE];
    bool slides;
    double value; /* deg; m where it slides */
} td_task_joint;

/* How a path is passed in time (TELEDIMOS, 2.1). */
typedef enum td_task_law {
    TD_TASK_FASTEST,
    TD_TASK_CUBIC,
    TD_TASK_QUINTIC,
    TD_TASK_CONSTANT_VELOCITY,
    TD_TASK_CONSTANT_ACCELERATION
} td_task_law;

typedef struct td_task_position {
    int via_count, joint_count; /* one of `to` and joints: with joints there is no via */
    td_task_point *via;         /* passed on the way */
    td_task_point to;
    td_task_joint *joint; /* the others stay where they are */
    td_task_law law;
    double duration_s; /* 0: as the limits allow */
} td_task_position;

typedef struct td_task_drive {
    bool has_to;
    double to_m[2], yaw_deg;     /* has_to: where it stands in the end */
    double distance_m, turn_deg; /* else: an arc, backwards where negative; to the left where positive */
    double speed_m_s;            /* 0: the machine's own */
} td_task_drive;

/* A trench: from `from` along the heading, in as many passes as the tool needs. The ground is the map's, as
 * it was when the digging began: what was dug since does not make the trench deeper. */
typedef struct td_task_dig {
    td_task_point from; /* on the ground: the middle of its far end */
    bool has_heading;   /* else towards the machine, along the ground */
    double heading_deg; /* in the frame's level plane, from x to the left */
    double length_m;    /* along the heading */
    double depth_m;     /* of its floor below the ground as it was */
    double width_m;     /* across; 0: the tool's own */
    double force_n;     /* the most; INFINITY: what the machine can */
} td_task_dig;

typedef struct td_task_press {
    double axis[3]; /* along which the tool pushes, of length 1 */
    double force_n, for_s;
    double approach_speed_m_s; /* 0: the controller's own */
    double most_travel_m;      /* INFINITY: no bound */
} td_task_press;

typedef enum td_task_kind {
    TD_TASK_POSITION,
    TD_TASK_DRIVE,
    TD_TASK_DIG,
    TD_TASK_DUMP,
    TD_TASK_PRESS,
    TD_TASK_WAIT
} td_task_kind;
typedef struct td_task_step {
    td_task_kind kind;
    union {
        td_task_position position;
        td_task_drive drive;
        td_task_dig dig;
        td_task_point dump; /* over which the tool is emptied */
        td_task_press press;
        double wait_s;
    } as;
} td_task_step;

typedef struct td_task {
    char name[TD_NAME_SIZE], about[TD_TASK_ABOUT_SIZE];
    td_task_frame frame;
    struct {
        char link[TD_NAME_SIZE]; /* empty: the robot's last */
        double point_m[3], axis[3];
    } tool;
    struct {
        double speed_m_s, acceleration_m_s2;  /* of the tool; INFINITY: the robot's own */
        double joint_speed_share, pump_share; /* of the robot's own, in (0, 1] */
    } limits;
    struct {
        double position_m, angle_deg, force_n;
    } tolerance;
    int step_count;
    td_task_step *step;
} td_task;

/* Refused, naming file, line and field: keys that are unknown or missing, no steps, numbers that are none or
 * beyond what any machine is or does, and what contradicts itself: a duration in which the straight way would
 * break speed_m_s, an approach faster than it, a force not above its own tolerance. */
TD_API td_status td_task_read(td_task **task, const char *path, td_error *error);
/* The same from memory; `name` is for messages. */
TD_API td_status td_task_parse(td_task **task, const char *text, size_t size, const char *name,
                               td_error *error);
TD_API void td_task_free(td_task **task);

/* As a file: what is as it is by default is left out, numbers give back the same bits, so a task that was
 * read and written is the same text each time. The text (free()) is read again before it is given out: a task
 * that td_task_parse would refuse is refused. */
TD_API td_status td_task_text(char **text, const td_task *task, td_error *error);
TD_API td_status td_task_write(const td_task *task, const char *path, td_error *error);
/* SHA-256 of that text: who validated a task keeps it, who runs the task compares. Comments and order of a
 * file do not count. */
TD_API td_status td_task_hash(char hex[TD_HASH_HEX_SIZE], const td_task *task, td_error *error);

/* Whether it fits a robot, as far as can be seen without planning. Refused, naming step and field: links and
 * joints that it has not, angles beyond its limits, points that the stretched arm does not reach (all of its
 * lengths laid in one line from its first joint), a tool faster than every joint together could make it, a
 * press downwards by more than the robot's weight. In the site only up to the first drive, and only with
 * site_from_vehicle (NULL: not known). */
TD_API td_status td_task_check(const td_task *task, const td_robot *robot, const td_pose *site_from_vehicle,
                               td_error *error);
/* The link of its tool; -1: the robot has none of that name. */
TD_API int td_task_tool_link(const td_task *task, const td_robot *robot);
/* position, drive, dig, dump, press, wait. */
TD_API const char *td_task_kind_name(td_task_kind kind);

#ifdef __cplusplus
}
#endif
#endif
