/* Soil that is dug: the ground of an elevation map as mass, a bucket that cuts, fills, spills and dumps, and
 * what it feels.
 *
 * Mass is counted in whole milligrams: what leaves a cell comes to another, to the bucket or to the air, so
 * the sum never changes by one. A cell has a bank, as the map saw it, and loose soil on it, `swell` times as
 * bulky. A cell that nothing was done to keeps the map's height to the last bit. Cells without a height
 * are unknown ground: nothing is dug there, nothing flows or falls in; so is what is beyond the map's edge.
 *
 * One update (td_soil_step runs them at the soil's own rate):
 * 1. From its last place to this one the edge sweeps a surface. Where the face leads (rake from -5 to 175
 *    deg), soil above the surface goes into the bucket, up to its heap; the rest is pushed on, ahead of the
 *    edge. Where the back leads, loose soil that reaches above the floor is pressed to the bank's density.
 * 2. Out of the soil the bucket holds, by the tilt of its opening from upright and the angle of repose: the
 *    heap, down to the rim as the tilt goes to repose; then (repose + 90 deg - tilt) / 90 deg of the struck
 *    volume. What is above falls for sqrt(2 h / g) and lands below the edge, on known ground only:
 *    over unknown ground the bucket keeps it.
 * 3. Soil flows where it stands too steep: a cell gives to its lower neighbours in x and in y, a and b below,
 *    where sqrt(a^2 + b^2) > cell tan(r): the slope of an upwind gradient, so heaps come out round. Loose
 *    soil first; a bank gives way where it stands above that by more than its cohesion holds upright,
 *    4 c / (gamma) tan(45 deg + phi/2). Cells go by (column + 2 row) mod 5: crosses of one class
 *    do not touch, so the order within it cannot matter. Only cells near a change are looked at, so the cost
 *    does not grow with the map. A few sweeps an update, fewer when much moves; what
 *    still moves goes on in the next.
 * 4. The forces on the bucket, held until the next update: Luengo's wedge where the face leads, with the mean
 *    depth and share of the edge in the ground ahead, the bucket's load as Vs, and the slope ahead
 *    within 30 deg; the ground's bearing under the edge's thickness and the floor, where they are pushed
 *    in; both times tanh(speed / slip_m_s), so that they vanish at rest; and the load's weight.
 *
 * The bucket is no wall to flowing soil. The same calls give the same bytes. */
#ifndef TELEDIMOS_SIM_SOIL_H
#define TELEDIMOS_SIM_SOIL_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/elevation.h"
#include "../core/hash.h"
#include "../core/log.h"
#include "soil_force.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Lengths in m, in the bucket's frame. */
typedef struct td_soil_bucket {
    double edge[3];              /* middle of the cutting edge */
    double heel[3];              /* middle of the floor's rear end: from the edge to it is the floor */
    double opening[3];           /* out of the mouth, square to it; any length; not along the floor */
    double centre[3];            /* of the soil in it: where its weight acts */
    double width_m, edge_m;      /* of the edge, and its thickness */
    double struck_m3, heaped_m3; /* level with the rim, and with its heap */
    double reach_m;              /* deeper with its edge, it is all under the ground: refused */
} td_soil_bucket;
/* The bucket of datasets/zx200, in its link's frame: 1.1 m wide, 0.58 m^3 struck, 0.8 m^3 heaped (assumed, as
 * machines of this class have). */
TD_API td_soil_bucket td_soil_bucket_zx200(void);

typedef struct td_soil_options {
    double period_s; /* of an update; default 0.02 */
    int sweeps;      /* of flowing soil in an update, at most; default 4 */
    int flow_cells;  /* another sweep is begun only when that makes at most so many looks at cells: what an
                        update may cost when much flows at once; default 4000 */
    double floor_m;  /* how far below the map's surface may be dug; default 5 */
    double gravity;  /* m/s^2; default 9.80665 */
    double slip_m_s; /* speed at which the soil's resistance is nearly whole; default 0.01 */
    td_log log;      /* told once: unknown ground, the floor */
} td_soil_options;
TD_API td_soil_options td_soil_options_default(void);

/* 1e8 cells are refused; so many are a square of 290 m at 5 cm. */
enum { TD_SOIL_MAX_CELLS = 1 << 25 };

typedef struct td_soil td_soil;
/* Copies what it is given. Bucket and options may be NULL: no bucket, defaults. Refused by name: no map, no
 * cell with a height, too many cells, a preset, bucket or option that makes no sense. */
TD_API td_status td_soil_new(td_soil **soil, const td_elevation *map, const td_soil_preset *preset,
                             const td_soil_bucket *bucket, const td_soil_options *options, td_error *error);
TD_API void td_soil_free(td_soil **soil);

/* Puts the bucket somewhere, without sweeping anything on the way. The first step does so by itself. */
TD_API td_status td_soil_place(td_soil *soil, const td_pose *site_from_bucket, td_error *error);
/* Goes on by dt; an update runs when a period is over, from the last update's pose to this one. NULL: the
 * bucket stays where it is. Refused, and nothing is changed: numbers that are none, a bucket that goes
 * deeper though it is buried, or leapt by more than 2 m (td_soil_place is for that). Out of memory, the soil
 * is as after an update cut short: all mass is there. */
TD_API td_status td_soil_step(td_soil *soil, const td_pose *site_from_bucket, double dt_s, td_error *error);
/* Updates with the bucket at rest until all has landed and nothing flows. TD_ERROR_CONVERGENCE after 1e6. */
TD_API td_status td_soil_settle(td_soil *soil, td_error *error);
/* Lets that much loose soil (mg) fall onto the cell: for heaps to begin with. The only way mass comes in. */
TD_API td_status td_soil_pour(td_soil *soil, int column, int row, int64_t mass_mg, td_error *error);

typedef struct td_soil_state {
    double time_s; /* of the clock that td_soil_step drives */
    uint64_t updates;
    int64_t bucket_mg, airborne_mg;
    double force[3];  /* N on the bucket, in the site's axes: cutting, bearing and the weight of its soil */
    double torque[3]; /* N m about the origin of the bucket's frame, in the site's axes */
    double cutting_n; /* of it, the failing wedge's; 0 where the face does not lead */
    double depth_m;   /* of the edge below the ground ahead of it, mean of where it is in */
    bool in_soil;     /* somewhere along the edge */
    size_t flowing;   /* cells that still may move */
    uint64_t unknown_cells; /* swept below ground so far, but without a height */
    int disturbed[4]; /* first column and row, last column and row that ever changed; {0, 0, -1, -1}: none */
} td_soil_state;
TD_API void td_soil_get(td_soil_state *state, const td_soil *soil);

/* Counts every cell anew (O(map)): the sum of the three is constant. */
typedef struct td_soil_balance {
    int64_t terrain_mg, bucket_mg, airborne_mg, total_mg;
    int64_t loose_mg; /* of the terrain's */
} td_soil_balance;
TD_API td_soil_balance td_soil_balance_of(const td_soil *soil);

/* Surface of a cell; NaN: unknown. And of the loose soil on it, its thickness. */
TD_API double td_soil_height(const td_soil *soil, int column, int row);
TD_API double td_soil_loose_height(const td_soil *soil, int column, int row);
/* Bilinear, as td_elevation_at: for tracks on ground that changes. */
TD_API double td_soil_height_at(const td_soil *soil, double x, double y);
/* The map as it is now. Cells whose soil was moved: TD_CELL_SIMULATED, sigma and time NaN, count 0. */
TD_API td_status td_soil_map(td_elevation **map, const td_soil *soil, td_error *error);
/* SHA-256 of all that a replay must reproduce: disturbed cells, bucket, soil in the air, clock. */
TD_API td_status td_soil_hash(char hex[TD_HASH_HEX_SIZE], const td_soil *soil, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
