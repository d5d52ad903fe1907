/* A motion against the map before it is executed: how near each link comes to the ground, where and when it
 * meets it first, and how probable it is that it meets it at all.
 *
 * Ground: the surface through the heights of the cells' centres, bilinear between four of them (as
 * td_elevation_at), and all that is below. Distances are those of points of that surface to the primitives:
 * of every cell's centre, and of the surface below the edges of boxes, the axes of capsules and the centres
 * of spheres, sampled at most a cell apart. A primitive is in contact where such a point lies in it, or a
 * point of its own below the surface; the clearance is then negative: minus how deep.
 *
 * Errors, all normal, of mean 0 and independent of each other:
 *   map       the height of each cell has its own sigma; between cells r apart it is correlated as
 *             exp(-r^2 / correlation_m^2) (the model of volumes, recon/volume.h)
 *   common    the whole map stands off by one rigid motion (calibration of the rig, which every measurement
 *             shares), the vehicle by another; one draw for the whole motion
 *   joints    each joint's zero is off, one draw for the whole motion; and each reading of the given motion
 *             by noise of its own, linear in between
 * Probability: that any link, but for the allowed contacts, meets the ground at any time of the motion. What
 * can meet: the points above that come within five sigma, of each shape and cell the time at which it comes
 * nearest (where readings have noise: between each two readings). Of these the ones that matter are chosen to
 * first order, one after the other as the one most probably met where none of those before is. Then
 *
 *   P = 1 - E_common [ P(no gap_k(common) < rise_k of the ground) ]
 *
 * with gap_k the vertical gap between the shape's underside and a cell, or between a point of the shape and
 * the surface, evaluated as it is after the displacement by the common errors (small angles: w x p + v +
 * sum_j J_j e_j). The outer mean is a lattice over errors of map, vehicle and joints, wider along the
 * direction that matters most, with weights; the inner probability is one step a point of sequential
 * conditioning (Genz 1992, "Numerical computation of multivariate normal probabilities"). So no time or cell
 * is taken as independent of another. Left out: second order in the errors' angles; other times of a point
 * than its nearest. */
#ifndef TELEDIMOS_SIM_CLEARANCE_H
#define TELEDIMOS_SIM_CLEARANCE_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/elevation.h"
#include "../core/robot.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Pyramids of the highest ground (height, and height + 5 sigma) over the map, so that what is far from it
 * costs little. Borrows the map. After its cells have changed in a rectangle (columns from `column`, rows
 * from `row`), td_clearance_map_update brings them up to date. sigma_m: of cells whose sigma is not known;
 * NaN: maps with such cells are refused. */
typedef struct td_clearance_map td_clearance_map;
TD_API td_status td_clearance_map_new(td_clearance_map **map, const td_elevation *elevation, double sigma_m,
                                      td_error *error);
/* Refused: a changed cell whose sigma is none (and sigma_m NaN); the pyramids are then as before. */
TD_API td_status td_clearance_map_update(td_clearance_map *map, int column, int row, int columns, int rows,
                                         td_error *error);
TD_API void td_clearance_map_free(td_clearance_map **map);

/* Contact that is meant, such as of the bucket while it digs: the link is not looked at in [from, to]. */
typedef struct td_clearance_allowed {
    int link;
    double from_s, to_s;
} td_clearance_allowed;

typedef struct td_clearance_motion {
    const td_robot *robot;
    td_pose site_from_vehicle;        /* of the robot's root link, in the map's frame */
    const double *vehicle_covariance; /* (6,6) of it; NULL: 0 */
    const double *map_covariance;     /* (6,6) of the map's common error, as a left perturbation in the site's
                                         frame: that of site_from_rig; that of vehicle_from_rig goes through the
                                         adjoint of site_from_vehicle. NULL: 0. What vehicle and map share
                                         cancels and belongs into neither */
    const double *sigma_zero;         /* (joints) rad or m; NULL: 0 */
    const double *sigma_reading;      /* (joints) rad or m, of each sample; NULL: 0 */
    size_t count;                     /* samples, one or more */
    const double *time_s;             /* (count) ascending */
    const double *q;                  /* (count, joints) rad or m; linear in between */
    const td_clearance_allowed *allowed;
    size_t allowed_count;
} td_clearance_motion;

typedef struct td_clearance_options {
    double correlation_m; /* of the cells' noise; 0 (default): two cells */
    double step_m; /* samples are put in so that no point of a link moves further; 0 (default): a cell */
    double unseen_top_m; /* unknown ground, and that beyond the map, may be so high; NaN (default): as high as
                            the highest known cell */
    double highest_probability; /* of contact, up to which the motion is accepted; default 0.01 */
    int points;                 /* contact points that the probability may use, 1 to 256; default 96 */
    int draws;                  /* points of the lattice for the integral, 8 to 1e6; default 256 */
    uint64_t seed;              /* of its shifts */
} td_clearance_options;
TD_API td_clearance_options td_clearance_options_default(void);

/* Where a link comes nearest to the ground. */
typedef struct td_clearance_place {
    int link;           /* -1: none, all that moves is allowed contact or over unknown ground */
    double clearance_m; /* negative: contact, minus the depth; INFINITY: link -1 */
    double time_s;
    double at[3]; /* the point of the ground */
} td_clearance_place;

typedef struct td_clearance {
    td_clearance_place nearest; /* over the whole motion, of the links as given */
    bool contact;               /* the links as given meet the ground as given */
    td_clearance_place first;   /* contact in time, if so */
    double probability;         /* of contact, over the whole motion */
    double sigma_probability;   /* of its numerical integral */
    double left_out;            /* what the points that were not used may add at most */
    td_clearance_place likely;  /* the most probable place of contact; link -1: none within five sigma */
    double likely_sigma_m;      /* of the clearance there */
    bool unseen; /* a link comes within reach of ground that is not known: it was not checked */
    td_clearance_place unseen_at; /* for the first time; at: the cell at unseen_top_m */
    size_t samples;               /* looked at, after refinement */
    size_t points;                /* of the ground within five sigma */
} td_clearance;

/* Links that no joint moves are not looked at. Refused, naming it: a motion without samples, times that do
 * not ascend, joints or covariances that are no numbers, options out of range. */
TD_API td_status td_clearance_check(td_clearance *clearance, const td_clearance_map *map,
                                    const td_clearance_motion *motion, const td_clearance_options *options,
                                    td_error *error);
/* Accepted: probable contact is not above highest_probability, no contact as given, nothing unseen. `words`
 * (may be NULL) then says how far off the motion is, else what is met, when, and how probable it is: one
 * sentence. */
TD_API bool td_clearance_verdict(char *words, size_t size, const td_clearance *clearance,
                                 const td_robot *robot, const td_clearance_options *options);

#ifdef __cplusplus
}
#endif
#endif
