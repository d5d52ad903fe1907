/* A trench or pit as passes that the machine can reach, and where their soil is dumped.
 *
 * Trench. From the middle of its far end along a heading (the way of the drags, towards the machine), length
 * by width. Its floor is a plane: along the heading the straight line that fits the ground as it was best,
 * across it lying as the bucket's edge does, both lowered by the depth. A plan keeps it (td_dig_floor), so
 * that a later plan from the changed map cuts only what still stands above it.
 *
 * Passes. The trench is cut in lanes side by side, each as wide as the edge across its way; a lane whose soil
 * (of the bank, times swell) is V is cut in n = ceil(V / fill) passes of equal volume, by the planes parallel
 * to the floor that part V so; the lanes take turns. Each pass: return above the far end, approach down to
 * the ground, cut (down beside the wall, then the drag along the plane, over what stands above it), lift (off
 * the near wall, which would be cut on the way up, then up, while the bucket curls), carry, dump: the bucket
 * opens over the point, on the last part of its way where the arm is not long enough to open it there. Return
 * and carry go by the joints, all others along straight lines of the edge; carry and return are raised until
 * they are clear of what stands on their way, of the heap too. In the cut the face leads and the floor's back
 * is clear: the rake, between floor and motion, is within rake_least_deg and rake_most_deg; at the end of the
 * drag the mouth is near enough to upright for the bucket to hold its struck volume when it leaves the
 * ground.
 *
 * Volumes are counted over the map's columns between its surface and the plane, over what the edge sweeps: at
 * the ends of a trench that does not point at the machine that is a little more than the trench. Walls that
 * do not stand slide in: plan again from the map as it is then, with the floor of the first plan.
 *
 * The machine is to swing about its upright axis and to move the tool in an upright plane by three joints or
 * more (an excavator). Ground without a height is unknown: refused in the trench; under a carry or a return
 * it is taken to be as high as the highest known ground below the same way. The line of boom and arm keeps
 * 0.3 m off the ground. Not looked at: own body and bystanders (sim/clearance.h does), and the shell's back,
 * which a far wall that is upright and higher than the bucket's floor is long would rub. */
#ifndef TELEDIMOS_SERVO_DIG_PLAN_H
#define TELEDIMOS_SERVO_DIG_PLAN_H

#include "../core/elevation.h"
#include "../core/task.h"
#include "trajectory_generator.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Lengths in m, in the frame of the bucket's link; edge, heel and opening as sim/soil.h has them. */
typedef struct td_dig_bucket {
    int link;
    double edge[3];              /* middle of the cutting edge */
    double heel[3];              /* middle of the floor's rear end */
    double opening[3];           /* out of the mouth; any length */
    double width_m;              /* of the edge */
    double struck_m3, heaped_m3; /* loose soil it holds, level and with its heap */
    double body_m;               /* how far the shell reaches below the line from its pin to its edge */
} td_dig_bucket;

/* Lanes are counted to the left of the heading. Plane: z = start[2] + along a + across t, a along the
 * heading, t to its left, m. */
typedef struct td_dig_floor {
    double start[3]; /* middle of the far end, on the floor; site */
    double heading_rad, length_m, width_m;
    double along, across;
} td_dig_floor;

typedef struct td_dig_options {
    double swell;      /* volume of loose soil over that of the bank; default 1.28 */
    double repose_rad; /* at which dumped soil lies, for the heap below the dump; default 40 deg */
    double fill_share; /* of the struck volume, taken in a pass at most; default 0.95 */
    double clear_m;    /* between the bucket and the highest ground below its way; default 0.5 */
    double margin;     /* to every limit of a joint, rad or m; default 0.03 */
    double rake_least_deg, rake_most_deg; /* in the cut; default 20, 100 */
    double tilt_deg; /* of the mouth from upright where a drag ends, repose_rad at most; default 38 */
    double worth_m3; /* a pass takes that much of the bank, or is not made; default 0.02 */
    bool partly;     /* what cannot be reached is left out, and told; else the trench is refused */
} td_dig_options;
TD_API td_dig_options td_dig_options_default(void);

typedef struct td_dig_request {
    const td_elevation *map; /* as it is now, in the site */
    const td_robot *robot;
    const td_pose *site_from_vehicle;
    const double *q;     /* (joints) where the arm stands */
    const td_tool *tool; /* its origin is the edge's middle, its x axis what `pitch` is of; rows not used */
    td_task_frame frame; /* of dig and dump: vehicle or site */
    const td_task_dig *dig;
    const td_task_point *dump; /* the edge is over it when the bucket opens, and not lower */
    const td_dig_floor *floor; /* of an earlier plan, in place of what `dig` says of the trench; or NULL */
    const td_dig_bucket *bucket;
} td_dig_request;

typedef enum td_dig_phase {
    TD_DIG_RETURN,
    TD_DIG_APPROACH,
    TD_DIG_CUT,
    TD_DIG_LIFT,
    TD_DIG_CARRY,
    TD_DIG_DUMP
} td_dig_phase;

typedef struct td_dig_move {
    int pass, lane; /* from 0 */
    td_dig_phase phase;
    bool contact;                  /* with the ground is meant */
    td_task_position position;     /* of the tool, in the site; or joints: return and carry */
    double cut_m3;                 /* of the bank, by this move (the drag of a pass); 0 else */
    double load_m3;                /* of loose soil in the bucket when it ends */
    double depth_m;                /* of the cut, the largest */
    double q[TD_ROBOT_MAX_JOINTS]; /* where the joints stand when it ends */
} td_dig_move;

typedef enum td_dig_reason {
    TD_DIG_TOO_FAR,  /* its surface is out of reach */
    TD_DIG_TOO_DEEP, /* its surface is not, its floor is */
    TD_DIG_BLOCKED   /* the arm would touch the ground */
} td_dig_reason;
TD_API const char *td_dig_phase_name(td_dig_phase phase);
TD_API const char *td_dig_reason_name(td_dig_reason reason);

/* A part of the trench that is left out. */
typedef struct td_dig_left {
    td_dig_reason reason;
    double from_m, to_m; /* along the heading from the far end */
    double volume_m3;    /* of the bank that stays there above the floor */
    char text[200];
} td_dig_left;

typedef struct td_dig_plan {
    td_dig_floor floor;
    int pass_count, lane_count, move_count, left_count;
    td_dig_move *move; /* (move_count) in order */
    td_dig_left *left; /* (left_count) */
    double trench_m3;  /* of the bank, between the surface and the floor */
    double cut_m3;     /* by all passes; beside the trench too, where the edge lies askew to its ends */
    double left_m3;    /* that stays above the floor in the trench: `left`, and what is not worth a pass */
    double loose_m3;   /* dumped */
    double depth_m;    /* the largest, below the ground as it is */
    td_elevation *expected; /* the map when all is done: cells cut are TD_CELL_SIMULATED; no heap */
} td_dig_plan;

/* No pass where nothing worth it stands above the floor. Refused, naming what and what to do: a robot that is
 * no such machine, numbers that are none or make no sense, a trench narrower than the bucket, off the map or
 * with unknown ground, a heading more than 30 deg off the machine, a dump in the trench or out of reach;
 * without `partly` what is out of reach, too deep or blocked, naming the part that is not; with it a trench
 * of which nothing can be reached, naming the nearest place that can. */
TD_API td_status td_dig_plan_make(td_dig_plan **plan, const td_dig_request *request,
                                  const td_dig_options *options, td_error *error);
TD_API void td_dig_plan_free(td_dig_plan **plan);

#ifdef __cplusplus
}
#endif
#endif
