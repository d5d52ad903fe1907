/* Rows over symbols: the regressor in the inertial parameters, and Jacobians of links. */
#include "sim/dynamics_generator_internal.h"

/* From a link's own axes to the working axes of its body, and back. */
static td_symbol3 from_link(td_writing *w, const td_body_link *link, td_symbol3 a)
{
    return td_write_spun(w, link->body, td_rotate_apply(&w->graph, link->rotation, a));
}

static td_symbol3 to_link(td_writing *w, const td_body_link *link, td_symbol3 a)
{
    const td_turn turn = w->place[link->body].turn;
    if (turn.axis >= 0 && !w->tree->body[link->body].turned) a = td_turn_back(&w->graph, turn, a);
    return td_rotate_back(&w->graph, link->rotation, a);
}

/* ---- regressor ---- */

/* U = [alpha] + [omega]^2. */
static td_symbol3 u_column(td_graph *g, const td_motion *m, int k)
{
    td_symbol3 unit = td_symbol3_zero();
    unit.v[k] = 1;
    const td_symbol3 inner = td_symbol3_cross(g, m->omega, unit);
    return td_symbol3_add(g, td_symbol3_cross(g, m->alpha, unit), td_symbol3_cross(g, m->omega, inner));
}

/* The wrench, about the link's origin and in its axes, of one unit of parameter `which` (0 to 9). */
static td_wrench unit_wrench(td_graph *g, const td_motion *m, int which)
{
    static const int rows[6] = {0, 0, 0, 1, 1, 2}, columns[6] = {0, 1, 2, 1, 2, 2};
    if (which == 0) return (td_wrench){td_symbol3_zero(), m->acceleration};
    if (which < 4) {
        td_symbol3 unit = td_symbol3_zero();
        unit.v[which - 1] = 1;
        return (td_wrench){td_symbol3_cross(g, unit, m->acceleration), u_column(g, m, which - 1)};
    }
    const int i = rows[which - 4], j = columns[which - 4];
    td_symbol3 turning = td_symbol3_zero(), spin = td_symbol3_zero();
    turning.v[i] = m->alpha.v[j], turning.v[j] = m->alpha.v[i];
    spin.v[i] = m->omega.v[j], spin.v[j] = m->omega.v[i];
    return (td_wrench){td_symbol3_add(g, turning, td_symbol3_cross(g, m->omega, spin)), td_symbol3_zero()};
}

static void write_parameter(td_writing *w, td_symbol *regressor, int link, int which, const td_motion *m)
{
    td_graph *g = &w->graph;
    const td_body_link *at = w->tree->link + link;
    const int columns = 10 * w->tree->link_count, column = 10 * link + which;
    td_wrench wrench = unit_wrench(g, m, which);
    const td_symbol3 offset = td_write_spun(w, at->body, td_symbol3_constant(g, at->offset));
    wrench.moment = from_link(w, at, wrench.moment);
    wrench.force = from_link(w, at, wrench.force);
    wrench.moment = td_symbol3_add(g, wrench.moment, td_symbol3_cross(g, offset, wrench.force));
    for (int body = at->body; body > 0; body = w->tree->body[body].parent)
        regressor[(5 + body) * columns + column] = td_write_pass(w, body, &wrench);
    for (int k = 0; k < 3; k++) {
        regressor[k * columns + column] = wrench.moment.v[k];
        regressor[(3 + k) * columns + column] = wrench.force.v[k];
    }
}

void td_write_regressor(td_writing *w, td_symbol *regressor)
{
    td_graph *g = &w->graph;
    const int rows = w->tree->body_count + 5, columns = 10 * w->tree->link_count;
    for (int i = 0; i < rows * columns; i++) regressor[i] = 0;
    td_write_places(w);
    td_write_motion(w, (td_given){true, true, true, true});
    for (int i = 0; i < w->tree->link_count && !g->failed; i++) {
        const td_body_link *link = w->tree->link + i;
        const td_motion *body = w->motion + link->body;
        const td_symbol3 offset = td_write_spun(w, link->body, td_symbol3_constant(g, link->offset));
        const td_symbol3 acceleration =
            td_symbol3_add(g, body->acceleration, td_symbol33_apply(g, body->u, offset));
        const td_motion m = {.omega = to_link(w, link, body->omega),
                             .alpha = to_link(w, link, body->alpha),
                             .acceleration = to_link(w, link, acceleration)};
        for (int k = 0; k < 10; k++) write_parameter(w, regressor, i, k, &m);
    }
}

/* ---- Jacobian ---- */

static td_symbol3 to_base(td_writing *w, int body, td_symbol3 a)
{
    for (; body > 0; body = w->tree->body[body].parent) a = td_write_to_parent(w, body, a);
    return a;
}

static void set_column(td_symbol *jacobian, int n, int column, td_symbol3 omega, td_symbol3 v)
{
    for (int i = 0; i < 3; i++) {
        jacobian[i * n + column] = omega.v[i];
        jacobian[(3 + i) * n + column] = v.v[i];
    }
}

void td_write_jacobian(td_writing *w, td_symbol *jacobian, int link)
{
    td_graph *g = &w->graph;
    const td_body_link *at = w->tree->link + link;
    const int n = w->tree->body_count + 5;
    for (int i = 0; i < 6 * n; i++) jacobian[i] = 0;
    td_write_places(w);
    td_symbol3 arm = td_write_spun(w, at->body, td_symbol3_constant(g, at->offset));
    for (int body = at->body; body > 0; body = w->tree->body[body].parent) {
        const td_place *place = w->place + body;
        const bool prismatic = w->tree->body[body].kind == TD_JOINT_PRISMATIC;
        const int parent = w->tree->body[body].parent;
        arm = td_write_to_parent(w, body, arm);
        const td_symbol3 axis = to_base(w, parent, place->axis);
        const td_symbol3 moved = to_base(w, parent, td_symbol3_cross(g, place->axis, arm));
        set_column(jacobian, n, 5 + body, prismatic ? td_symbol3_zero() : axis, prismatic ? axis : moved);
        arm = td_symbol3_add(g, arm, place->offset);
    }
    for (int k = 0; k < 3; k++) {
        td_symbol3 unit = td_symbol3_zero();
        unit.v[k] = 1;
        set_column(jacobian, n, k, unit, td_symbol3_cross(g, unit, arm));
        set_column(jacobian, n, 3 + k, td_symbol3_zero(), unit);
    }
}
