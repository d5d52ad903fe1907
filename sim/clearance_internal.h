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

/* Called with each point of the ground nearer than `limit`, which it may lower. */
typedef struct clearance_visit {
    void (*point)(struct clearance_visit *visit, const clearance_point *point);
    double limit;
} clearance_visit;
void clearance_near(clearance_visit *visit, const td_clearance_map *map, const clearance_shape *shape);
/* Whether a shape reaches unknown cells, or the outside, below `top`; where. */
bool clearance_unseen(double at[3], const td_clearance_map *map, const clearance_shape *shape, double top);

/* ---- clearance_probability.c ---- */

/* A margin as a function of the errors. */
typedef struct clearance_margin {
    double mean, variance;
    const double *common;  /* (common_count) by errors of sigma 1 that all share */
    const double *reading; /* (joints) by the noise of a reading, times its sigma */
    uint32_t knot;         /* the reading before, and the weight of the one after */
    double part;
    int column, row; /* of the ground: cell, and four weights with n_z and the cells' sigma in them */
    double ground[4];
} clearance_margin;
typedef struct clearance_integral {
    size_t count;
    const clearance_margin *margin;
    int common_count, joints; /* joints: 0 where readings have no noise */
    double correlation_cells;
    int points, draws;
    uint64_t seed;
} clearance_integral;
/* P(any margin < 0). */
td_status clearance_probability(double *probability, double *sigma, double *left_out,
                                const clearance_integral *integral, td_error *error);

#endif
