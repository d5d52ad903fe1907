/* What the files behind clearance.h share: the pyramid, primitives placed in the site, points of near contact
 * and the integral over them. */
#ifndef TELEDIMOS_SIM_CLEARANCE_INTERNAL_H
#define TELEDIMOS_SIM_CLEARANCE_INTERNAL_H

#include "sim/clearance.h"

/* Points further off than this many sigma do not matter: 3e-7. */
#define CLEARANCE_SIGMAS 5.0

/* ---- clearance_map.c ---- */

enum { CLEARANCE_TILE = 2 /* cells of the lowest level: 1 << this, squared */, CLEARANCE_LEVELS = 30 };

struct td_clearance_map {
    const td_elevation *elevation;
    double sigma_m;
    int levels, width[CLEARANCE_LEVELS], height[CLEARANCE_LEVELS];
    float *high[CLEARANCE_LEVELS];   /* highest of the known cells; -INFINITY: none */
    float *top[CLEARANCE_LEVELS];    /* highest height + 5 sigma of the known cells; -INFINITY: none */
    uint8_t *hole[CLEARANCE_LEVELS]; /* a cell is unknown */
};
double clearance_cell_sigma(const td_clearance_map *map, size_t cell);
/* Highest ground over a rectangle of the site, or a little more than it; -INFINITY: nothing known there. */
double clearance_top(const td_clearance_map *map, const double low[2], const double high[2]);

/* ---- clearance_shape.c ---- */

typedef struct clearance_shape {
    td_primitive_kind kind;
    int link;
    double size[3];         /* as td_primitive; box: half lengths */
    double r[9], t[3];      /* site_from_shape */
    double low[3], high[3]; /* box around it in the site */
    double radius;          /* of the ball around its centre */
} clearance_shape;
clearance_shape clearance_place_shape(const td_primitive *primitive, int link, const td_pose *site_from_link);
/* Signed distance of a point of the site to the shape (negative inside), and its gradient: unit vector. */
double clearance_distance(double gradient[3], const clearance_shape *shape, const double p[3]);
/* Height at which a vertical line first meets the shape from below; INFINITY: it does not. */
double clearance_underside(const clearance_shape *shape, double x, double y);
/* The lines along which it may touch the ground between cells: edges of a box, axis of a capsule, centre of a
 * sphere (a line of no length). Returns how many; `round`: how far the surface is from them. */
enum { CLEARANCE_LINES = 12 };
int clearance_lines(double line[CLEARANCE_LINES][2][3], double *round, const clearance_shape *shape);

/* ---- clearance_motion.c ---- */

/* The motion, refined: sample i lies between readings knot and knot + 1. */
typedef struct clearance_state {
    uint32_t knot;
    double part;
} clearance_state;
typedef struct clearance_path {
    const td_clearance_motion *motion;
    size_t count;
    clearance_state *state;
    int shape_count;
    int *link, *number; /* (shape_count) of those that a joint moves */
    double common[36];  /* root of the covariance of vehicle against map: columns are errors of sigma 1 */
} clearance_path;
td_status clearance_path_new(clearance_path *path, const td_clearance_motion *motion, double step_m,
                             td_error *error);
void clearance_path_free(clearance_path *path);
double clearance_time(const clearance_path *path, clearance_state state);
/* site_from_link of all links. */
void clearance_links(td_pose *site_from_link, const clearance_path *path, clearance_state state);
clearance_shape clearance_shape_of(const clearance_path *path, int shape, const td_pose *site_from_link);
bool clearance_is_allowed(const clearance_path *path, int link, double time_s);
/* Derivative of n times the velocity of the link's point p by each joint (joints). */
void clearance_joint_rates(double *rate, const td_robot *robot, const td_pose *site_from_link, int link,
                           const double p[3], const double n[3]);
/* Not less than the sigma of any point of the shape in any direction, from all but the ground's noise. */
double clearance_motion_sigma(const clearance_path *path, const clearance_shape *shape,
                              const td_pose *site_from_link);

/* ---- clearance_near.c ---- */

/* A point of the ground near a shape: margin = d + n u - n_z e to first order, u the shape's displacement
 * there, e = sum weight_c e_c the ground's rise. */
typedef struct clearance_point {
    int shape;      /* of the check's list */
    uint32_t state; /* of the motion: index of the refined sample */
    int32_t cell;   /* first of one, or of four */
    bool patch;
    double distance, margin; /* m; differ for points between cells (clearance_near.c) */
    double n[3], p[3];
    double weight[4];
} clearance_point;

/* Called with each point of the ground nearer than `limit` (which it may lower), or than `reach` less five
 * sigma of the ground. */
typedef struct clearance_visit {
    void (*point)(struct clearance_visit *visit, const clearance_point *point);
    double limit, reach;
} clearance_visit;
void clearance_near(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape);
/* Height of the surface; NaN beside unknown cells and outside. */
double clearance_surface(const td_elevation *ground, double x, double y);
/* Whether a shape reaches unknown cells, or the outside, below `top`; where. */
bool clearance_unseen(double at[3], const td_clearance_map *map, const clearance_shape *shape, double top);

/* ---- clearance_probability.c ---- */

/* A margin as a function of the errors, to first order. */
enum { CLEARANCE_COMMON = 6 + TD_ROBOT_MAX_JOINTS };
typedef struct clearance_margin {
    double mean, variance;
    const double *common;  /* (common_count) by errors of sigma 1 that all share */
    const double *reading; /* (joints) by the noise of a reading, times its sigma */
    uint32_t knot;         /* the reading before, and the weight of the one after */
    double part;
    int column, row; /* of the ground: cell, and four weights with the cells' sigma in them, negative; */
    double ground[4];
    double up; /* and what a rise of the ground makes of the margin */
} clearance_margin;
typedef struct clearance_integral {
    size_t count;
    const clearance_margin *margin;
    int common_count, joints; /* joints: 0 where readings have no noise */
    double correlation_cells;
    int points, draws;
    uint64_t seed;
} clearance_integral;
/* The margins (at most `points`) that matter for P(any < 0), and what the others add at most. */
td_status clearance_choose(size_t *chosen, int *points, double *left_out, const clearance_integral *integral,
                           td_error *error);

/* A margin as it is: the vertical gap between a shape and the ground once both are displaced. */
typedef struct clearance_contact {
    const td_elevation *ground;
    clearance_shape shape;
    bool patch; /* a point of the shape over the surface; else a cell's centre below the shape */
    double p[3];
    double move[CLEARANCE_COMMON][3];     /* of the shape there, by common errors of sigma 1, */
    double shake[TD_ROBOT_MAX_JOINTS][3]; /* and by readings' noise of sigma 1 */
    int knot[2];                          /* of the integral's: the readings before and after */
    double part;
} clearance_contact;
/* INFINITY: the shape is beside the point. noise: (knots, joints). */
double clearance_gap(const clearance_contact *contact, const double *common, int common_count,
                     const double *noise, int joints);
/* P(any gap < the ground's rise there) for the contacts of the chosen margins. */
td_status clearance_integrate(double *probability, double *sigma, const clearance_integral *integral,
                              const clearance_contact *contact, const size_t *chosen, int points, int knots,
                              td_error *error);

#endif
