/* The world: the machine among solid bodies (Open Dynamics Engine), on tracks that drive over a map. A plant
 * (core/plant.h) with the cylinders, motors, friction and stops of sim/machine.h; joints with a cylinder push
 * with what its limits of force and flow allow.
 *
 * Step. Links are rigid bodies, joints are ODE's; ODE solves for the velocities at the next half step, with
 * contacts. Positions are then taken along the joints, so that they hold exactly, and the terms of the
 * velocities' products (centrifugal, Coriolis, gyroscopic) are given to ODE as forces: its own step leaves
 * them out, which slows what turns (by h w^2 / 2 a second). Velocities are those between two positions
 * (leapfrog): the error is of second order in the step. Oil and friction enter as motors whose softness is
 * their slope (CFM), so that stiff ones stay stable.
 *
 * Tracks. Each stands on points of the undercarriage, looked up in the map, where springs and dampers carry
 * it along the ground's normal. The points' weights are such that heave, pitch and roll have the robot file's
 * stiffness and damping. Along the ground each point has a shear e (m) against it that is elastic up to
 * friction N: force = -(weight) (shear_n_m e + shear_ns_m e'), e' = s - |V| e / relax_m, s the speed at which
 * the belt slides on the ground, V the belt's: shoes that are fresh come in, those that are sheared leave. So
 * a driven track slips by (pull) / (shear_n_m relax_m) of V, until friction is used up. Rolling resistance is
 * rolling N against the belt's way.
 *
 * Stones are pushed by contact; the last link with a box (the bucket's shell) is hollow for them, open
 * towards its -z (the line from pin to tip). Against the ground the machine itself has its tracks only: what
 * the soil does to the bucket is given by td_world_push. */
#ifndef TELEDIMOS_SIM_WORLD_H
#define TELEDIMOS_SIM_WORLD_H

#include <stdbool.h>
#include <stddef.h>

#include "../core/elevation.h"
#include "machine.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_WORLD_MAX_POINTS = 64, TD_WORLD_MAX_STONES = 256 };

typedef struct td_world td_world;
/* Height of the ground, m (site); NaN: there is none. */
typedef double (*td_world_height)(void *user, double x, double y);

typedef struct td_world_tracks {
    int points;              /* of each track, 2 to TD_WORLD_MAX_POINTS / 2; default 4 */
    double half_length_m;    /* default 1.15 of what the pitch's stiffness makes of heave's */
    double half_gauge_m;     /* default: what the roll's stiffness makes of heave's */
    double friction;         /* default 0.7 */
    double shear_n_m;        /* of both tracks together; default: heave's stiffness */
    double shear_ns_m;       /* default: heave's damping */
    double relax_m;          /* default 0.07: 20 t slip by a fifth at a pull of 0.9 of their weight */
    double rolling;          /* default 0.05 */
    double speed_m_s, lag_s; /* limit of the belts' speed and how they follow; defaults 1.5, 0.2 */
} td_world_tracks;

typedef struct td_world_options {
    td_machine_options machine; /* `base` suspended: on its tracks; what concerns the integrator and
                                   `coriolis` is not used */
    td_world_tracks tracks;
    double step_s;          /* default 1e-3 */
    td_world_height height; /* NULL: the map's */
    void *height_user;
    void (*before_step)(void *user,
                        td_world *world); /* before each step of step_s: where a soil pushes; or NULL */
    void *before_step_user;
    bool buried; /* it may start with its last links under the ground */
} td_world_options;
TD_API td_world_options td_world_options_default(const td_robot *robot);

/* `ground` (frame of the site) is lent, and may change between steps; NULL only where options.height is given
 * or the machine has no tracks. The machine stands as td_machine_new leaves it: td_world_reset and
 * td_world_settle come next. Refused by name: what td_machine_new refuses, no map, links that have no mass or
 * no inertia. */
TD_API td_status td_world_new(td_world **world, const td_robot *robot, const td_elevation *ground,
                              const td_world_options *options, td_error *error);
TD_API void td_world_free(td_world **world);
/* Another map from now on. */
TD_API void td_world_set_ground(td_world *world, const td_elevation *ground);
TD_API double td_world_height_at(const td_world *world, double x, double y);

/* Pose, twist, q, dq and force are taken as they are given; valves are shut, belts stand, stones stay.
 * Refused, and nothing changed: what td_machine_reset refuses; tracks with a point where the map has no
 * height, or over an edge, or under the ground; a last link that is buried. */
TD_API td_status td_world_reset(td_world *world, const td_plant_state *state, td_error *error);
/* At rest on the ground below it, heading as it does, cylinders carrying the joints' loads. Time stands
 * still. Refused, naming it, where the ground or the cylinders cannot hold it. */
TD_API td_status td_world_settle(td_world *world, td_error *error);

TD_API td_status td_world_command(td_world *world, const td_plant_command *command, td_error *error);
/* Speeds of the belts, m/s, forwards; kept until the next. */
TD_API td_status td_world_drive(td_world *world, double left, double right, td_error *error);
/* Force (N) at a point (m), site's axes, on a link: over the next td_world_step; called by before_step: over
 * that step of step_s. They add up. */
TD_API td_status td_world_push(td_world *world, int link, const double force[3], const double point[3],
                               td_error *error);
/* In whole steps of step_s; what is left over comes with the next. Refused, naming where: a track comes where
 * there is no ground; a state that is no number. */
TD_API td_status td_world_step(td_world *world, double dt_s, td_error *error);
TD_API void td_world_state(const td_world *world, td_plant_state *state);
/* site_from_link of every link. */
TD_API void td_world_links(td_pose *site_from_link, const td_world *world);

typedef struct td_world_track_state {
    double belt_m_s;   /* as it runs */
    double force_n[3]; /* of the ground on the track, site's axes */
    int touching;      /* points */
} td_world_track_state;
TD_API void td_world_track(td_world_track_state *state, const td_world *world, bool right);

typedef struct td_world_stone {
    td_primitive shape; /* link_from_shape: site_from_stone */
    double density;     /* kg/m^3; 0: it cannot be moved */
    double friction;
} td_world_stone;
/* Stands at the index, counted from 0, that is returned in *index (may be NULL). */
TD_API td_status td_world_add_stone(td_world *world, int *index, const td_world_stone *stone,
                                    td_error *error);
TD_API int td_world_stone_count(const td_world *world);
/* twist: omega, v (site's axes; may be NULL). False: it left the ground's map, or sped away, and was stopped
 * there. */
TD_API bool td_world_stone_at(td_pose *site_from_stone, double twist[6], const td_world *world, int index);

/* A plant over it. The plant's free frees the world. */
TD_API td_plant td_world_plant(td_world *world);

#ifdef __cplusplus
}
#endif
#endif
