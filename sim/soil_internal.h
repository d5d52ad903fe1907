/* What the files behind soil.h share. */
#ifndef TELEDIMOS_SIM_SOIL_INTERNAL_H
#define TELEDIMOS_SIM_SOIL_INTERNAL_H

#include <math.h>

#include "sim/soil.h"

enum { SOIL_CLASSES = 5 };

/* mg; zero where nothing was done. */
typedef struct soil_cell {
    int64_t taken; /* of the bank; negative: pressed into it */
    int64_t loose; /* on it */
} soil_cell;

typedef struct soil_place {
    int column, row;
} soil_place;

/* Soil in the air, above a strip of ground in plan: start + s along + t across, s and t in 0 … 1. */
typedef struct soil_strip {
    double start[2], along[2], across[2];
} soil_strip;
typedef struct soil_parcel {
    int64_t mass;
    double left_s;
    soil_strip strip;
} soil_parcel;

typedef struct soil_list {
    soil_place *place;
    size_t count, capacity;
} soil_list;

/* The bucket in the site's axes. */
typedef struct soil_blade {
    double edge[3], end[2][3]; /* middle and ends of the edge */
    double heel[3];
    double face[3];  /* unit, square to the floor, on the side of the soil */
    double point[3]; /* unit, from heel to edge */
    double opening[3];
} soil_blade;

/* The edge's motion in an update. */
typedef struct soil_motion {
    double by[3], length; /* of the edge's middle, m */
    double rake;          /* between floor and motion, -pi to pi; 0 at rest */
    bool cuts;
    double speed; /* m/s */
} soil_motion;

struct td_soil {
    td_elevation *map; /* as given */
    soil_cell *cell;
    double *surface; /* height of each cell, as it follows from map and cell; NaN: unknown */
    uint8_t *awake;
    td_soil_preset preset;
    td_soil_bucket bucket;
    td_soil_options options;
    bool has_bucket, placed;
    td_pose site_from_bucket; /* at the last update */
    double bank_m, loose_m;   /* height of 1 mg in a cell */
    double loose_m3;          /* volume of 1 mg of loose soil */
    double steep_m, stand_m;  /* drop to a neighbour at repose; what the bank holds upright */
    int64_t column_mg;        /* of bank in a cell, down to the floor */
    int64_t known_cells;
    int64_t poured_mg;
    int64_t load; /* in the bucket */
    int64_t airborne;
    soil_parcel *parcel;
    size_t parcel_count, parcel_capacity;
    soil_list active[SOIL_CLASSES], found;
    int sweep; /* of all, modulo 2 SOIL_CLASSES */
    double since_s;
    double last_ground;                    /* under the edge, where it was last over known ground; NaN */
    double contact;                        /* share of the edge that is in the soil */
    double slope_rad;                      /* of the ground ahead */
    double floor_depth;                    /* of the floor's middle below the ground */
    bool told_unknown, told_floor, failed; /* failed: out of memory */
    td_soil_state state;
};

static inline bool soil_inside(const td_soil *s, int column, int row)
{
    return column >= 0 && row >= 0 && column < s->map->columns && row < s->map->rows;
}

static inline size_t soil_index(const td_soil *s, int column, int row)
{
    return (size_t)row * (size_t)s->map->columns + (size_t)column;
}

static inline double soil_bank(const td_soil *s, size_t i)
{
    return (double)s->map->height[i] - (double)s->cell[i].taken * s->bank_m;
}

/* The surface of the cell around (x, y); NaN: unknown or outside. */
double soil_ground(const td_soil *s, double x, double y);

bool soil_list_add(soil_list *list, soil_place p); /* false: out of memory */
/* First column and row, last column and row of the cells whose centres are in the rectangle; false: none. */
bool soil_span(int box[4], const td_soil *s, const double low[2], const double high[2]);

/* soil.c: all changes of a cell: adds to what is taken of its bank, and to what is loose on it. */
void soil_change(td_soil *s, soil_place p, int64_t taken, int64_t loose);
/* The cells whose centres are in the strip, known and unknown, in s->found; what is outside the map is not.
 */
void soil_find(td_soil *s, const soil_strip *strip);
/* Spreads loose soil evenly over the known cells of the strip, or onto the one in its middle when it is too
 * thin to hold a centre. False: there is none, and nothing was put down. */
bool soil_spread(td_soil *s, const soil_strip *strip, int64_t mass);
bool soil_can_spread(td_soil *s, const soil_strip *strip);

/* soil_flow.c */
/* The cell and its neighbours will be looked at. */
void soil_wake(td_soil *s, soil_place p);
/* The sweeps of an update. */
void soil_flow(td_soil *s);
size_t soil_flowing(const td_soil *s);

/* soil_bucket.c */
td_status soil_bucket_check(const td_soil_bucket *bucket, td_error *error);
soil_blade soil_blade_at(const td_soil *s, const td_pose *site_from_bucket);
soil_motion soil_motion_between(const soil_blade *from, const soil_blade *to, double dt_s);
/* By how much (m) the edge is below the ground where it is deepest; its place in `at`. */
double soil_edge_depth(const td_soil *s, const soil_blade *blade, double at[2]);
void soil_dig(td_soil *s, const soil_blade *from, const soil_blade *to, const soil_motion *motion);
void soil_dump(td_soil *s, const soil_blade *blade);
void soil_fall(td_soil *s, double dt_s);

/* soil_wrench.c */
/* How the blade stands in the ground, before it moves any; and force and torque from that. */
void soil_feel(td_soil *s, const soil_blade *blade, const soil_motion *motion);
void soil_wrench(td_soil *s, const soil_blade *blade, const soil_motion *motion, const td_pose *pose);

#endif
