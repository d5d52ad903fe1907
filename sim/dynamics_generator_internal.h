/* What the rooms of the generator share: the tree's motion in symbols, and a function on its way to text. */
#ifndef TELEDIMOS_SIM_DYNAMICS_GENERATOR_INTERNAL_H
#define TELEDIMOS_SIM_DYNAMICS_GENERATOR_INTERNAL_H

#include <stdio.h>

#include "sim/dynamics_generator.h"
#include "sim/dynamics_internal.h"
#include "sim/dynamics_symbol_internal.h"

/* Inputs of a function: index = array * TD_INPUT_STRIDE + element. */
enum { TD_INPUT_Q, TD_INPUT_NU, TD_INPUT_ACCELERATION, TD_INPUT_FORCE, TD_INPUT_GRAVITY, TD_INPUT_COUNT };
enum { TD_INPUT_STRIDE = 128 };

/* Where a body is against its parent: all in the parent's working axes. */
typedef struct td_place {
    td_symbol angle; /* of the spin since the working axes began; of a turned body: at which its own begin */
    td_turn turn;    /* by it; axis -1: none */
    td_symbol3 offset, axis;
} td_place;

/* Motion in the body's working axes: U = [alpha] + [omega]^2 takes a vector of the body to the acceleration
 * of its end against its origin. */
typedef struct td_motion {
    td_symbol3 omega, alpha, acceleration;
    td_symbol33 u;
} td_motion;

typedef struct td_wrench {
    td_symbol3 moment, force;
} td_wrench;

/* One function being written: a graph of its own, so that nothing is carried from one to the next. */
typedef struct td_writing {
    const td_tree *tree;
    td_graph graph;
    td_place place[TD_DYNAMICS_MAX];
    td_motion motion[TD_DYNAMICS_MAX];
    /* Not 0: a turned body on the base. The base's six rows are then those of the same motion and force taken
     * at this body's origin in its working axes, where the links beyond it couple to fewer of them. */
    int pivot;
    td_wrench at_pivot; /* of the bodies from the pivot on; those of the others stay at the base */
} td_writing;

/* ---- dynamics_generator.c ---- */

/* What moves, in symbols: absent parts are 0. */
typedef struct td_given {
    bool omega, rates, acceleration, gravity;
} td_given;

void td_write_places(td_writing *w);
void td_write_motion(td_writing *w, td_given given);
/* A vector of the body in its working axes: given where their turns are 0, as it stands. */
td_symbol3 td_write_spun(td_writing *w, int body, td_symbol3 a);
/* From the working axes of `body` to its parent's, and back. */
td_symbol3 td_write_to_parent(td_writing *w, int body, td_symbol3 a);
td_symbol3 td_write_from_parent(td_writing *w, int body, td_symbol3 a);
/* A wrench on `body` about its origin, in its working axes, to one on its parent; the joint's force on the
 * way. */
td_symbol td_write_pass(td_writing *w, int body, td_wrench *wrench);

/* The base's wrench at the pivot, and the acceleration of the pivot's point of the base at the base. */
td_wrench td_write_to_pivot(td_writing *w, td_wrench wrench);
void td_write_from_pivot(td_writing *w, td_symbol3 *alpha, td_symbol3 *acceleration);

void td_write_inverse(td_writing *w, td_symbol *force, td_given given);
void td_write_mass(td_writing *w, td_symbol *mass);

/* ---- dynamics_generator_solve.c ---- */

/* Acceleration by the LDL^T of M, eliminated from the base or from the leaves; pivots (6+n) and the diagonal
 * they began as. False: M is singular whatever q. */
bool td_write_forward(td_writing *w, td_symbol *acceleration, td_symbol *pivot, td_symbol *diagonal,
                      bool coriolis, bool from_base);

/* ---- dynamics_generator_rows.c ---- */

/* (6+n, 10 links), row-major. */
void td_write_regressor(td_writing *w, td_symbol *regressor);
/* (6, 6+n), row-major. */
void td_write_jacobian(td_writing *w, td_symbol *jacobian, int link);

/* ---- dynamics_print.c ---- */

void td_print_head(FILE *to, const char *robot, const char *hash, const char *prefix);
/* The body of a function: statements that compute the outputs, returning 0 before them where one of the
 * `check_count` pivots is not above 1e-13 of its diagonal. False: out of memory. */
bool td_print_body(FILE *to, size_t *flops, const td_graph *graph, const char *output_name,
                   const td_symbol *output, size_t output_count, const td_symbol *pivot,
                   const td_symbol *diagonal, size_t check_count);

#endif
