/* Vectors, turns and inertias of symbols. */
#include "sim/dynamics_symbol_internal.h"

td_symbol3 td_symbol3_zero(void)
{
    return (td_symbol3){{0, 0, 0}};
}

td_symbol3 td_symbol3_constant(td_graph *graph, const double value[3])
{
    td_symbol3 a;
    for (int i = 0; i < 3; i++) a.v[i] = td_symbol_constant(graph, value[i]);
    return a;
}

td_symbol3 td_symbol3_add(td_graph *graph, td_symbol3 a, td_symbol3 b)
{
    for (int i = 0; i < 3; i++) a.v[i] = td_symbol_add(graph, a.v[i], b.v[i]);
    return a;
}

td_symbol3 td_symbol3_subtract(td_graph *graph, td_symbol3 a, td_symbol3 b)
{
    for (int i = 0; i < 3; i++) a.v[i] = td_symbol_subtract(graph, a.v[i], b.v[i]);
    return a;
}

td_symbol3 td_symbol3_scale(td_graph *graph, td_symbol a, td_symbol3 b)
{
    for (int i = 0; i < 3; i++) b.v[i] = td_symbol_multiply(graph, a, b.v[i]);
    return b;
}

td_symbol3 td_symbol3_cross(td_graph *graph, td_symbol3 a, td_symbol3 b)
{
    td_symbol3 c;
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        c.v[k] = td_symbol_subtract(graph, td_symbol_multiply(graph, a.v[i], b.v[j]),
                                    td_symbol_multiply(graph, a.v[j], b.v[i]));
    }
    return c;
}

td_symbol td_symbol3_dot(td_graph *graph, td_symbol3 a, td_symbol3 b)
{
    td_symbol sum = 0;
    for (int i = 0; i < 3; i++) sum = td_symbol_add(graph, sum, td_symbol_multiply(graph, a.v[i], b.v[i]));
    return sum;
}

td_symbol3 td_symbol33_apply(td_graph *graph, td_symbol33 a, td_symbol3 b)
{
    td_symbol3 c;
    for (int i = 0; i < 3; i++) {
        const td_symbol3 row = {{a.m[i][0], a.m[i][1], a.m[i][2]}};
        c.v[i] = td_symbol3_dot(graph, row, b);
    }
    return c;
}

td_symbol3 td_turn_apply(td_graph *graph, td_turn turn, td_symbol3 a)
{
    const int i = (turn.axis + 1) % 3, j = (turn.axis + 2) % 3;
    td_symbol3 b = a;
    b.v[i] = td_symbol_subtract(graph, td_symbol_multiply(graph, turn.c, a.v[i]),
                                td_symbol_multiply(graph, turn.s, a.v[j]));
    b.v[j] = td_symbol_add(graph, td_symbol_multiply(graph, turn.s, a.v[i]),
                           td_symbol_multiply(graph, turn.c, a.v[j]));
    return b;
}

td_symbol3 td_turn_back(td_graph *graph, td_turn turn, td_symbol3 a)
{
    turn.s = td_symbol_negate(graph, turn.s);
    return td_turn_apply(graph, turn, a);
}

td_symbol3 td_rotate_apply(td_graph *graph, const double r[9], td_symbol3 a)
{
    td_symbol3 b;
    for (int i = 0; i < 3; i++) b.v[i] = td_symbol3_dot(graph, td_symbol3_constant(graph, r + 3 * i), a);
    return b;
}

td_symbol3 td_rotate_back(td_graph *graph, const double r[9], td_symbol3 a)
{
    const double transpose[9] = {r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]};
    return td_rotate_apply(graph, transpose, a);
}

/* ---- inertia ---- */

td_symbol_inertia td_symbol_inertia_constant(td_graph *graph, int axis, double mass, const double h[3],
                                             const double j[9])
{
    const int k = axis, i = (k + 1) % 3, l = (k + 2) % 3;
    return (td_symbol_inertia){.axis = axis,
                               .mass = td_symbol_constant(graph, mass),
                               .h = td_symbol3_constant(graph, h),
                               .sum = td_symbol_constant(graph, (j[4 * i] + j[4 * l]) / 2),
                               .difference = td_symbol_constant(graph, (j[4 * i] - j[4 * l]) / 2),
                               .mixed = td_symbol_constant(graph, j[3 * i + l]),
                               .along = td_symbol_constant(graph, j[4 * k]),
                               .along_i = td_symbol_constant(graph, j[3 * k + i]),
                               .along_j = td_symbol_constant(graph, j[3 * k + l])};
}

td_symbol33 td_symbol_inertia_moments(td_graph *graph, td_symbol_inertia a)
{
    const int k = a.axis, i = (k + 1) % 3, j = (k + 2) % 3;
    td_symbol33 moments;
    moments.m[i][i] = td_symbol_add(graph, a.sum, a.difference);
    moments.m[j][j] = td_symbol_subtract(graph, a.sum, a.difference);
    moments.m[k][k] = a.along;
    moments.m[i][j] = moments.m[j][i] = a.mixed;
    moments.m[k][i] = moments.m[i][k] = a.along_i;
    moments.m[k][j] = moments.m[j][k] = a.along_j;
    return moments;
}

static void set_moments(td_graph *graph, td_symbol_inertia *a, int axis, td_symbol33 moments)
{
    const int k = axis, i = (k + 1) % 3, j = (k + 2) % 3;
    const td_symbol half = td_symbol_constant(graph, 0.5);
    a->axis = axis;
    a->sum = td_symbol_multiply(graph, half, td_symbol_add(graph, moments.m[i][i], moments.m[j][j]));
    a->difference =
        td_symbol_multiply(graph, half, td_symbol_subtract(graph, moments.m[i][i], moments.m[j][j]));
    a->mixed = moments.m[i][j];
    a->along = moments.m[k][k];
    a->along_i = moments.m[k][i];
    a->along_j = moments.m[k][j];
}

td_symbol_inertia td_symbol_inertia_about(td_graph *graph, td_symbol_inertia a, int axis)
{
    if (a.axis != axis) set_moments(graph, &a, axis, td_symbol_inertia_moments(graph, a));
    return a;
}

td_symbol_inertia td_symbol_inertia_turn(td_graph *graph, td_turn turn, td_symbol_inertia a)
{
    a = td_symbol_inertia_about(graph, a, turn.axis);
    a.h = td_turn_apply(graph, turn, a.h);
    const td_symbol twice = td_symbol_add(graph, turn.s, turn.s);
    const td_turn doubled = {0, td_symbol_subtract(graph, 1, td_symbol_multiply(graph, twice, turn.s)),
                             td_symbol_multiply(graph, twice, turn.c)};
    const td_symbol3 plane = td_turn_apply(graph, doubled, (td_symbol3){{0, a.difference, a.mixed}});
    const td_symbol3 along =
        td_turn_apply(graph, (td_turn){0, turn.c, turn.s}, (td_symbol3){{0, a.along_i, a.along_j}});
    a.difference = plane.v[1], a.mixed = plane.v[2];
    a.along_i = along.v[1], a.along_j = along.v[2];
    return a;
}

td_symbol_inertia td_symbol_inertia_rotate(td_graph *graph, const double r[9], td_symbol_inertia a)
{
    const td_symbol33 from = td_symbol_inertia_moments(graph, a);
    td_symbol33 half, to;
    for (int i = 0; i < 3; i++) { /* rows of from R^T: R applied to each row of the symmetric J */
        const td_symbol3 row =
            td_rotate_apply(graph, r, (td_symbol3){{from.m[i][0], from.m[i][1], from.m[i][2]}});
        for (int j = 0; j < 3; j++) half.m[i][j] = row.v[j];
    }
    for (int j = 0; j < 3; j++) {
        const td_symbol3 column =
            td_rotate_apply(graph, r, (td_symbol3){{half.m[0][j], half.m[1][j], half.m[2][j]}});
        for (int i = 0; i <= j; i++) to.m[i][j] = to.m[j][i] = column.v[i];
    }
    a.h = td_rotate_apply(graph, r, a.h);
    set_moments(graph, &a, a.axis, to);
    return a;
}

/* J + r h^T + h r^T + m r r^T = J + r p^T + p r^T with p = h + m r / 2. */
td_symbol_inertia td_symbol_inertia_join(td_graph *graph, td_symbol_inertia b, td_symbol_inertia a,
                                         td_symbol3 r)
{
    const int k = b.axis, i = (k + 1) % 3, j = (k + 2) % 3;
    a = td_symbol_inertia_about(graph, a, k);
    const td_symbol half = td_symbol_multiply(graph, td_symbol_constant(graph, 0.5), a.mass);
    const td_symbol3 p = td_symbol3_add(graph, a.h, td_symbol3_scale(graph, half, r));
    const td_symbol ii = td_symbol_multiply(graph, r.v[i], p.v[i]),
                    jj = td_symbol_multiply(graph, r.v[j], p.v[j]);
    const td_symbol twice = td_symbol_add(graph, r.v[k], r.v[k]);
#define CROSS(x, y)                                                                                          \
    td_symbol_add(graph, td_symbol_multiply(graph, r.v[x], p.v[y]), td_symbol_multiply(graph, r.v[y], p.v[x]))
#define ADD3(x, y, z) td_symbol_add(graph, td_symbol_add(graph, b.x, a.y), z)
    b.sum = ADD3(sum, sum, td_symbol_add(graph, ii, jj));
    b.difference = ADD3(difference, difference, td_symbol_subtract(graph, ii, jj));
    b.mixed = ADD3(mixed, mixed, CROSS(i, j));
    b.along = ADD3(along, along, td_symbol_multiply(graph, twice, p.v[k]));
    b.along_i = ADD3(along_i, along_i, CROSS(k, i));
    b.along_j = ADD3(along_j, along_j, CROSS(k, j));
#undef CROSS
#undef ADD3
    b.h = td_symbol3_add(graph, td_symbol3_add(graph, b.h, a.h), td_symbol3_scale(graph, a.mass, r));
    b.mass = td_symbol_add(graph, b.mass, a.mass);
    return b;
}
