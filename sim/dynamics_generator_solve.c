/* Forward dynamics: M acceleration = force - velocity terms, by M = L D L^T over symbols, where what is 0 by
 * the tree's shape costs nothing. From the base: its translation first, whose block is the mass times the
 * identity; from the leaves: as the tree branches (Featherstone 2008, section 6.5). Gravity is taken as an
 * acceleration of the base, and added at the end. */
#include <stdlib.h>

#include "sim/dynamics_generator_internal.h"

static void choose_order(int *order, int n, bool from_base)
{
    for (int i = 0; i < n; i++) order[i] = i < 6 ? (i + 3) % 6 : i;
    if (from_base) return;
    for (int i = 0; i < n / 2; i++) {
        const int other = order[i];
        order[i] = order[n - 1 - i];
        order[n - 1 - i] = other;
    }
}

/* A pivot that is a number: 0, or what rounding left of the diagonal it began as. */
static bool is_nothing(const td_graph *g, td_symbol pivot, td_symbol diagonal)
{
    if (!td_symbol_is_constant(g, pivot)) return false;
    const double value = g->node[pivot].value, start = g->node[diagonal].value; /* 0: not a number yet */
    return !(value > 1e-13 * start);
}

/* Solves m x = x, both overwritten. False: a pivot is 0 whatever q. */
static bool solve(td_graph *g, td_symbol *m, td_symbol *x, td_symbol *pivot, const td_symbol *diagonal,
                  const int *order, int n)
{
    for (int k = 0; k < n; k++) {
        const int row = order[k];
        pivot[row] = m[row * n + row];
        if (g->failed) return true;
        if (is_nothing(g, pivot[row], diagonal[row])) return false;
        const td_symbol inverse = td_symbol_divide(g, 1, pivot[row]);
        for (int i = k + 1; i < n; i++) {
            const int below = order[i];
            const td_symbol factor = td_symbol_multiply(g, m[below * n + row], inverse);
            for (int j = k + 1; j <= i; j++) {
                const int at = order[j];
                td_symbol *entry = m + below * n + at;
                *entry = td_symbol_subtract(g, *entry, td_symbol_multiply(g, factor, m[at * n + row]));
            }
            x[below] = td_symbol_subtract(g, x[below], td_symbol_multiply(g, factor, x[row]));
        }
        for (int i = k + 1; i < n; i++) /* column k becomes L's, row k stays D L^T's */
            m[row * n + order[i]] = td_symbol_multiply(g, m[order[i] * n + row], inverse);
        x[row] = td_symbol_multiply(g, x[row], inverse);
    }
    for (int k = n - 1; k >= 0; k--)
        for (int i = k + 1; i < n; i++)
            x[order[k]] = td_symbol_subtract(g, x[order[k]],
                                             td_symbol_multiply(g, m[order[k] * n + order[i]], x[order[i]]));
    return true;
}

/* Force less velocity terms, the base's at the pivot. */
static void write_rest(td_writing *w, td_symbol *rest, bool coriolis)
{
    td_graph *g = &w->graph;
    const int n = w->tree->body_count + 5;
    td_symbol bias[TD_DYNAMICS_MAX];
    td_write_inverse(w, bias, (td_given){.omega = coriolis, .rates = coriolis});
    for (int i = 0; i < n; i++)
        rest[i] = td_symbol_subtract(g, td_symbol_input(g, TD_INPUT_FORCE * TD_INPUT_STRIDE + i), bias[i]);
    if (w->pivot == 0) return;
    const td_wrench moved =
        td_write_to_pivot(w, (td_wrench){{{rest[0], rest[1], rest[2]}}, {{rest[3], rest[4], rest[5]}}});
    for (int k = 0; k < 3; k++) {
        rest[k] = td_symbol_subtract(g, moved.moment.v[k], w->at_pivot.moment.v[k]);
        rest[3 + k] = td_symbol_subtract(g, moved.force.v[k], w->at_pivot.force.v[k]);
    }
}

bool td_write_forward(td_writing *w, td_symbol *acceleration, td_symbol *pivot, td_symbol *diagonal,
                      bool coriolis, bool from_base)
{
    td_graph *g = &w->graph;
    const int n = w->tree->body_count + 5;
    int order[TD_DYNAMICS_MAX];
    td_symbol *mass = malloc((size_t)n * (size_t)n * sizeof *mass);
    if (!mass) {
        g->failed = true;
        return true;
    }
    write_rest(w, acceleration, coriolis);
    td_write_mass(w, mass);
    for (int i = 0; i < n; i++) diagonal[i] = mass[i * n + i];
    choose_order(order, n, from_base);
    const bool regular = solve(g, mass, acceleration, pivot, diagonal, order, n);
    td_symbol3 alpha = {{acceleration[0], acceleration[1], acceleration[2]}};
    td_symbol3 a = {{acceleration[3], acceleration[4], acceleration[5]}};
    td_write_from_pivot(w, &alpha, &a);
    for (int k = 0; k < 3; k++) {
        const td_symbol gravity = td_symbol_input(g, TD_INPUT_GRAVITY * TD_INPUT_STRIDE + k);
        acceleration[k] = alpha.v[k];
        acceleration[3 + k] = td_symbol_add(g, a.v[k], gravity);
    }
    free(mass);
    return regular;
}
