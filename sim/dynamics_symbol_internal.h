/* Expressions as a graph: every distinct expression is one node, so that common subexpressions are found as
 * they are made; sums and products with 0, 1 and constants are simplified on the way. */
#ifndef TELEDIMOS_SIM_DYNAMICS_SYMBOL_INTERNAL_H
#define TELEDIMOS_SIM_DYNAMICS_SYMBOL_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

/* A node's number in its graph; 0 and 1 are the constants 0 and 1. */
typedef int td_symbol;

typedef enum td_symbol_kind {
    TD_SYMBOL_CONSTANT,
    TD_SYMBOL_INPUT, /* a: index */
    TD_SYMBOL_ADD,
    TD_SYMBOL_SUBTRACT,
    TD_SYMBOL_MULTIPLY,
    TD_SYMBOL_DIVIDE,
    TD_SYMBOL_NEGATE,
    TD_SYMBOL_ANGLE, /* a, or the same angle within a turn where a is large */
    TD_SYMBOL_SINE,
    TD_SYMBOL_COSINE
} td_symbol_kind;

typedef struct td_symbol_node {
    td_symbol_kind kind;
    int a, b;
    double value; /* of a constant */
} td_symbol_node;

typedef struct td_graph {
    td_symbol_node *node;
    size_t count, capacity;
    td_symbol *slot; /* open addressing; -1: free */
    size_t slots;
    bool failed; /* out of memory, or full: symbols are worthless from then on */
    bool full;   /* TD_GRAPH_MOST nodes are there */
} td_graph;

/* Far more than a compiler takes in one function. */
enum { TD_GRAPH_MOST = 1 << 20 };

void td_graph_begin(td_graph *graph);
void td_graph_free(td_graph *graph);

td_symbol td_symbol_constant(td_graph *graph, double value);
td_symbol td_symbol_input(td_graph *graph, int index);
td_symbol td_symbol_add(td_graph *graph, td_symbol a, td_symbol b);
td_symbol td_symbol_subtract(td_graph *graph, td_symbol a, td_symbol b);
td_symbol td_symbol_multiply(td_graph *graph, td_symbol a, td_symbol b);
td_symbol td_symbol_divide(td_graph *graph, td_symbol a, td_symbol b);
td_symbol td_symbol_negate(td_graph *graph, td_symbol a);
td_symbol td_symbol_angle(td_graph *graph, td_symbol a);
td_symbol td_symbol_sine(td_graph *graph, td_symbol a);
td_symbol td_symbol_cosine(td_graph *graph, td_symbol a);
bool td_symbol_is_constant(const td_graph *graph, td_symbol a);

/* Marks in used (graph->count) what the roots need. */
void td_graph_mark(bool *used, const td_graph *graph, const td_symbol *root, size_t root_count);
/* Additions, subtractions, multiplications and divisions among the marked. */
size_t td_graph_flops(const td_graph *graph, const bool *used);

/* ---- vectors and inertias of symbols (dynamics_symbol_vector.c) ---- */

typedef struct td_symbol3 {
    td_symbol v[3];
} td_symbol3;
typedef struct td_symbol33 {
    td_symbol m[3][3];
} td_symbol33;

/* A turn about coordinate axis k: cosine and sine of the angle. */
typedef struct td_turn {
    int axis;
    td_symbol c, s;
} td_turn;

/* Mass, first moment h and second moment J = integral of r r^T dm about an origin. Of J, in the plane across
 * axis k (i, j = the next axes in turn): half the sum and half the difference of J_ii and J_jj, and J_ij; a
 * turn about k leaves the first and turns the other two by twice the angle. */
typedef struct td_symbol_inertia {
    int axis;
    td_symbol mass;
    td_symbol3 h;
    td_symbol sum, difference, mixed, along, along_i, along_j; /* the last: J_kk, J_ki, J_kj */
} td_symbol_inertia;

td_symbol3 td_symbol3_zero(void);
td_symbol3 td_symbol3_constant(td_graph *graph, const double value[3]);
td_symbol3 td_symbol3_add(td_graph *graph, td_symbol3 a, td_symbol3 b);
td_symbol3 td_symbol3_subtract(td_graph *graph, td_symbol3 a, td_symbol3 b);
td_symbol3 td_symbol3_scale(td_graph *graph, td_symbol a, td_symbol3 b);
td_symbol3 td_symbol3_cross(td_graph *graph, td_symbol3 a, td_symbol3 b);
td_symbol td_symbol3_dot(td_graph *graph, td_symbol3 a, td_symbol3 b);
td_symbol3 td_symbol33_apply(td_graph *graph, td_symbol33 a, td_symbol3 b);
/* Turned by the angle, or back. */
td_symbol3 td_turn_apply(td_graph *graph, td_turn turn, td_symbol3 a);
td_symbol3 td_turn_back(td_graph *graph, td_turn turn, td_symbol3 a);
/* By a constant rotation (row-major), or its transpose. */
td_symbol3 td_rotate_apply(td_graph *graph, const double r[9], td_symbol3 a);
td_symbol3 td_rotate_back(td_graph *graph, const double r[9], td_symbol3 a);

td_symbol_inertia td_symbol_inertia_constant(td_graph *graph, int axis, double mass, const double h[3],
                                             const double j[9]);
td_symbol_inertia td_symbol_inertia_about(td_graph *graph, td_symbol_inertia a, int axis);
td_symbol_inertia td_symbol_inertia_turn(td_graph *graph, td_turn turn, td_symbol_inertia a);
td_symbol_inertia td_symbol_inertia_rotate(td_graph *graph, const double r[9], td_symbol_inertia a);
/* About the point at -r: the sum of a there and b. */
td_symbol_inertia td_symbol_inertia_join(td_graph *graph, td_symbol_inertia b, td_symbol_inertia a,
                                         td_symbol3 r);
/* Row-major second moments (symmetric). */
td_symbol33 td_symbol_inertia_moments(td_graph *graph, td_symbol_inertia a);

#endif
