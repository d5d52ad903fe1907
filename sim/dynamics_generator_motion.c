/* The recursions over symbols: Newton and Euler down the tree and back, composite bodies for the mass matrix.
 *
 * With second moments J instead of the moments of inertia both laws are linear in U = [alpha] + [omega]^2:
 * force = m a + U h, moment = h x a + the axial vector of U J - (U J)^T, and U h, U J hold every velocity
 * term. Links whose axes are parallel are kept in one set of axes: there a turn about axis k leaves the
 * column U e_k as it is, and of the others changes only the rest; the constant inertia is turned instead of
 * the motion, by the double angle (dynamics_symbol_internal.h). */
#include "sim/dynamics_generator_internal.h"

static bool turns(const td_body *body)
{
    return body->kind == TD_JOINT_REVOLUTE || body->kind == TD_JOINT_CONTINUOUS;
}

static td_symbol input(td_writing *w, int array, int element)
{
    return td_symbol_input(&w->graph, array * TD_INPUT_STRIDE + element);
}

static td_symbol3 input3(td_writing *w, int array, int element)
{
    td_symbol3 a;
    for (int i = 0; i < 3; i++) a.v[i] = input(w, array, element + i);
    return a;
}

/* ---- places ---- */

td_symbol3 td_write_spun(td_writing *w, int body, td_symbol3 a)
{
    const td_turn turn = w->place[body].turn;
    if (turn.axis < 0 || w->tree->body[body].turned) return a;
    return td_turn_apply(&w->graph, turn, a);
}

static td_symbol joint_position(td_writing *w, int index)
{
    const td_symbol q = input(w, TD_INPUT_Q, index - 1);
    return turns(w->tree->body + index) ? td_symbol_angle(&w->graph, q) : q;
}

static void place_body(td_writing *w, int index)
{
    td_graph *g = &w->graph;
    const td_body *body = w->tree->body + index;
    const bool parent_spins = body->parent > 0 && !w->tree->body[body->parent].turned;
    td_place *place = w->place + index;
    const td_symbol q = joint_position(w, index);
    const td_symbol3 axis = td_symbol3_constant(g, body->axis);
    td_symbol3 offset = td_symbol3_constant(g, body->offset);
    place->angle = parent_spins ? w->place[body->parent].angle : 0;
    place->axis = axis;
    if (turns(body)) {
        place->angle =
            body->sign > 0 ? td_symbol_add(g, place->angle, q) : td_symbol_subtract(g, place->angle, q);
    } else {
        offset = td_symbol3_add(g, offset, td_symbol3_scale(g, q, axis));
        place->axis = td_write_spun(w, body->parent, axis);
    }
    place->offset = td_write_spun(w, body->parent, offset);
    place->turn = (td_turn){-1, 1, 0};
    if (body->spin >= 0)
        place->turn =
            (td_turn){body->spin, td_symbol_cosine(g, place->angle), td_symbol_sine(g, place->angle)};
}

void td_write_places(td_writing *w)
{
    w->place[0] = (td_place){.turn = {-1, 1, 0}};
    for (int i = 1; i < w->tree->body_count; i++)
        joint_position(w, i); /* branches first, while little lives */
    for (int i = 1; i < w->tree->body_count; i++) place_body(w, i);
}

td_symbol3 td_write_to_parent(td_writing *w, int index, td_symbol3 a)
{
    const td_body *body = w->tree->body + index;
    if (!body->turned) return a;
    if (body->is_after) a = td_rotate_apply(&w->graph, body->after, a);
    a = td_turn_apply(&w->graph, w->place[index].turn, a);
    return body->is_before ? td_rotate_apply(&w->graph, body->before, a) : a;
}

td_symbol3 td_write_from_parent(td_writing *w, int index, td_symbol3 a)
{
    const td_body *body = w->tree->body + index;
    if (!body->turned) return a;
    if (body->is_before) a = td_rotate_back(&w->graph, body->before, a);
    a = td_turn_back(&w->graph, w->place[index].turn, a);
    return body->is_after ? td_rotate_back(&w->graph, body->after, a) : a;
}

/* ---- motion ---- */

static void set_diagonal(td_writing *w, td_motion *m)
{
    td_graph *g = &w->graph;
    td_symbol square[3];
    for (int i = 0; i < 3; i++) square[i] = td_symbol_multiply(g, m->omega.v[i], m->omega.v[i]);
    for (int i = 0; i < 3; i++)
        m->u.m[i][i] = td_symbol_negate(g, td_symbol_add(g, square[(i + 1) % 3], square[(i + 2) % 3]));
}

static void set_u(td_writing *w, td_motion *m)
{
    td_graph *g = &w->graph;
    set_diagonal(w, m);
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const td_symbol product = td_symbol_multiply(g, m->omega.v[i], m->omega.v[j]);
        m->u.m[i][j] = td_symbol_subtract(g, product, m->alpha.v[k]);
        m->u.m[j][i] = td_symbol_add(g, product, m->alpha.v[k]);
    }
}

/* The joint turns about coordinate axis k, `from` being the parent's motion: the column U e_k stays; with it
 * the symmetric part 2 omega_k omega_j gives the row; in the plane only alpha_k changes. */
static void change_u(td_writing *w, td_motion *to, const td_motion *from, int k, td_symbol rate)
{
    td_graph *g = &w->graph;
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    set_diagonal(w, to);
    to->u.m[k][k] = from->u.m[k][k];
    for (int other = 0; other < 3; other++) {
        if (other == k) continue;
        const td_symbol twice = td_symbol_add(g, from->omega.v[other], from->omega.v[other]);
        to->u.m[k][other] =
            td_symbol_subtract(g, td_symbol_multiply(g, twice, to->omega.v[k]), from->u.m[other][k]);
    }
    to->u.m[i][j] = td_symbol_subtract(g, from->u.m[i][j], rate);
    to->u.m[j][i] = td_symbol_add(g, from->u.m[j][i], rate);
}

static void move_body(td_writing *w, int index, td_given given)
{
    td_graph *g = &w->graph;
    const td_body *body = w->tree->body + index;
    const td_place *place = w->place + index;
    const td_motion *parent = w->motion + body->parent;
    td_motion *m = w->motion + index;
    const td_symbol rate = given.rates ? input(w, TD_INPUT_NU, 5 + index) : 0;
    const td_symbol change = given.acceleration ? input(w, TD_INPUT_ACCELERATION, 5 + index) : 0;
    const td_symbol3 along = td_symbol3_scale(g, change, place->axis);
    const td_symbol3 across =
        td_symbol3_scale(g, rate, td_symbol3_cross(g, parent->omega, place->axis)); /* rate omega x axis */
    *m = *parent;
    m->acceleration = td_symbol3_add(g, m->acceleration, td_symbol33_apply(g, parent->u, place->offset));
    if (turns(body)) {
        m->omega = td_symbol3_add(g, m->omega, td_symbol3_scale(g, rate, place->axis));
        m->alpha = td_symbol3_add(g, td_symbol3_add(g, m->alpha, across), along);
    } else {
        m->acceleration =
            td_symbol3_add(g, td_symbol3_add(g, m->acceleration, along), td_symbol3_add(g, across, across));
    }
    if (body->turned) {
        m->omega = td_write_from_parent(w, index, m->omega);
        m->alpha = td_write_from_parent(w, index, m->alpha);
        m->acceleration = td_write_from_parent(w, index, m->acceleration);
        set_u(w, m);
    } else if (turns(body)) {
        change_u(w, m, parent, body->spin, along.v[body->spin]);
    }
}

void td_write_motion(td_writing *w, td_given given)
{
    td_graph *g = &w->graph;
    td_motion *base = w->motion;
    *base = (td_motion){0};
    if (given.omega) base->omega = input3(w, TD_INPUT_NU, 0);
    if (given.acceleration) {
        base->alpha = input3(w, TD_INPUT_ACCELERATION, 0);
        base->acceleration = input3(w, TD_INPUT_ACCELERATION, 3);
    }
    if (given.gravity)
        base->acceleration = td_symbol3_subtract(g, base->acceleration, input3(w, TD_INPUT_GRAVITY, 0));
    set_u(w, base);
    for (int i = 1; i < w->tree->body_count; i++) move_body(w, i, given);
}

/* ---- forces ---- */

/* A body's inertia in its working axes. */
static td_symbol_inertia inertia_of(td_writing *w, int index)
{
    td_graph *g = &w->graph;
    const td_body *body = w->tree->body + index;
    const td_symbol_inertia inertia =
        td_symbol_inertia_constant(g, body->inertia_axis, body->mass, body->h, body->moment);
    if (w->place[index].turn.axis < 0 || body->turned) return inertia;
    return td_symbol_inertia_turn(g, w->place[index].turn, inertia);
}

/* The axial vector of U J - (U J)^T, for J split about axis k. */
static td_symbol3 moment_of(td_writing *w, const td_motion *m, td_symbol_inertia inertia)
{
    td_graph *g = &w->graph;
    const td_symbol33 j = td_symbol_inertia_moments(g, inertia);
    const int axis = inertia.axis, first = (axis + 1) % 3, second = (axis + 2) % 3;
    td_symbol3 moment;
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        td_symbol sum = 0;
        for (int l = 0; l < 3; l++) {
            if (k == axis && l != k) continue;
            sum = td_symbol_add(g, sum, td_symbol_multiply(g, m->u.m[q][l], j.m[l][p]));
            sum = td_symbol_subtract(g, sum, td_symbol_multiply(g, m->u.m[p][l], j.m[l][q]));
        }
        moment.v[k] = sum;
    }
    /* In the plane: 2 sum alpha_k + 2 difference w_i w_j + mixed (w_j^2 - w_i^2). */
    const td_symbol wi = m->omega.v[first], wj = m->omega.v[second];
    const td_symbol product = td_symbol_multiply(g, td_symbol_add(g, wi, wi), wj);
    const td_symbol squares =
        td_symbol_subtract(g, td_symbol_multiply(g, wj, wj), td_symbol_multiply(g, wi, wi));
    td_symbol sum = td_symbol_multiply(g, td_symbol_add(g, inertia.sum, inertia.sum), m->alpha.v[axis]);
    sum = td_symbol_add(g, sum, td_symbol_multiply(g, inertia.difference, product));
    sum = td_symbol_add(g, sum, td_symbol_multiply(g, inertia.mixed, squares));
    moment.v[axis] = td_symbol_add(g, moment.v[axis], sum);
    return moment;
}

static td_wrench wrench_of(td_writing *w, int index)
{
    td_graph *g = &w->graph;
    const td_motion *m = w->motion + index;
    const td_symbol_inertia inertia = inertia_of(w, index);
    return (td_wrench){.moment = td_symbol3_add(g, td_symbol3_cross(g, inertia.h, m->acceleration),
                                                moment_of(w, m, inertia)),
                       .force = td_symbol3_add(g, td_symbol3_scale(g, inertia.mass, m->acceleration),
                                               td_symbol33_apply(g, m->u, inertia.h))};
}

td_symbol td_write_pass(td_writing *w, int index, td_wrench *wrench)
{
    td_graph *g = &w->graph;
    const td_place *place = w->place + index;
    wrench->moment = td_write_to_parent(w, index, wrench->moment);
    wrench->force = td_write_to_parent(w, index, wrench->force);
    const td_symbol at_joint =
        td_symbol3_dot(g, place->axis, turns(w->tree->body + index) ? wrench->moment : wrench->force);
    wrench->moment = td_symbol3_add(g, wrench->moment, td_symbol3_cross(g, place->offset, wrench->force));
    return at_joint;
}

td_wrench td_write_to_pivot(td_writing *w, td_wrench wrench)
{
    td_graph *g = &w->graph;
    if (w->pivot == 0) return wrench;
    const td_symbol3 shift = td_symbol3_cross(g, w->place[w->pivot].offset, wrench.force);
    const td_symbol3 moment = td_symbol3_subtract(g, wrench.moment, shift);
    return (td_wrench){td_write_from_parent(w, w->pivot, moment),
                       td_write_from_parent(w, w->pivot, wrench.force)};
}

void td_write_from_pivot(td_writing *w, td_symbol3 *alpha, td_symbol3 *acceleration)
{
    td_graph *g = &w->graph;
    if (w->pivot == 0) return;
    *alpha = td_write_to_parent(w, w->pivot, *alpha);
    *acceleration = td_symbol3_add(g, td_write_to_parent(w, w->pivot, *acceleration),
                                   td_symbol3_cross(g, w->place[w->pivot].offset, *alpha));
}

void td_write_inverse(td_writing *w, td_symbol *force, td_given given)
{
    td_graph *g = &w->graph;
    td_wrench wrench[TD_DYNAMICS_MAX];
    td_write_places(w);
    td_write_motion(w, given);
    for (int i = 0; i < w->tree->body_count; i++) wrench[i] = wrench_of(w, i);
    for (int i = w->tree->body_count - 1; i > 0; i--) {
        td_wrench *parent = wrench + w->tree->body[i].parent;
        const bool is_pivot = i == w->pivot;
        if (is_pivot) w->at_pivot = wrench[i];
        force[5 + i] = td_write_pass(w, i, wrench + i);
        if (is_pivot) continue;
        parent->moment = td_symbol3_add(g, parent->moment, wrench[i].moment);
        parent->force = td_symbol3_add(g, parent->force, wrench[i].force);
    }
    for (int k = 0; k < 3; k++) {
        force[k] = wrench[0].moment.v[k];
        force[3 + k] = wrench[0].force.v[k];
    }
}

/* ---- mass matrix ---- */

/* The composite body of a joint, about its origin, to the parent's working axes. */
static td_symbol_inertia inertia_in_parent(td_writing *w, int index, td_symbol_inertia inertia)
{
    td_graph *g = &w->graph;
    const td_body *body = w->tree->body + index;
    if (!body->turned) return inertia;
    if (body->is_after) inertia = td_symbol_inertia_rotate(g, body->after, inertia);
    inertia = td_symbol_inertia_turn(g, w->place[index].turn, inertia);
    return body->is_before ? td_symbol_inertia_rotate(g, body->before, inertia) : inertia;
}

static const double *transposed(double to[9], const double r[9])
{
    for (int i = 0; i < 9; i++) to[i] = r[3 * (i % 3) + i / 3];
    return to;
}

/* I a = tr(J) a - J a: what turns a body with unit angular acceleration a. */
static td_symbol3 inertia_times(td_writing *w, td_symbol_inertia inertia, td_symbol3 a)
{
    td_graph *g = &w->graph;
    const td_symbol33 j = td_symbol_inertia_moments(g, inertia);
    td_symbol3 product;
    for (int i = 0; i < 3; i++) {
        const int p = (i + 1) % 3, q = (i + 2) % 3;
        const td_symbol across = i == inertia.axis ? td_symbol_add(g, inertia.sum, inertia.sum)
                                                   : td_symbol_add(g, j.m[p][p], j.m[q][q]);
        product.v[i] = td_symbol_multiply(g, across, a.v[i]);
        product.v[i] = td_symbol_subtract(g, product.v[i], td_symbol_multiply(g, j.m[i][p], a.v[p]));
        product.v[i] = td_symbol_subtract(g, product.v[i], td_symbol_multiply(g, j.m[i][q], a.v[q]));
    }
    return product;
}

static void set_entry(td_writing *w, td_symbol *mass, int row, int column, td_symbol value)
{
    const int n = w->tree->body_count + 5;
    mass[row * n + column] = mass[column * n + row] = value;
}

/* The wrench that gives a composite body unit acceleration along a joint's axis. */
static td_wrench unit_wrench(td_writing *w, int index, td_symbol_inertia inertia, td_symbol3 axis)
{
    td_graph *g = &w->graph;
    if (turns(w->tree->body + index))
        return (td_wrench){inertia_times(w, inertia, axis), td_symbol3_cross(g, axis, inertia.h)};
    return (td_wrench){td_symbol3_cross(g, inertia.h, axis), td_symbol3_scale(g, inertia.mass, axis)};
}

static void set_base_rows(td_writing *w, td_symbol *mass, int index, td_wrench wrench)
{
    for (int k = 0; k < 3; k++) {
        set_entry(w, mass, 5 + index, k, wrench.moment.v[k]);
        set_entry(w, mass, 5 + index, 3 + k, wrench.force.v[k]);
    }
}

/* Unit acceleration of the joint: its composite body's wrench, at each joint up the tree. */
static void write_column(td_writing *w, td_symbol *mass, int index, td_symbol_inertia inertia)
{
    bool beyond_pivot = false;
    td_symbol3 axis = td_write_from_parent(w, index, w->place[index].axis);
    td_wrench wrench = unit_wrench(w, index, inertia, axis);
    for (int up = index; up > 0; up = w->tree->body[up].parent) {
        if (up == w->pivot) {
            set_base_rows(w, mass, index, wrench);
            beyond_pivot = true;
        }
        set_entry(w, mass, 5 + index, 5 + up, td_write_pass(w, up, &wrench));
    }
    if (!beyond_pivot) set_base_rows(w, mass, index, td_write_to_pivot(w, wrench));
}

/* What hangs on the base without the pivot, about the pivot's origin in its axes, and with what is beyond it.
 */
static td_symbol_inertia inertia_at_pivot(td_writing *w, td_symbol_inertia rest, td_symbol_inertia beyond)
{
    td_graph *g = &w->graph;
    const td_body *body = w->tree->body + w->pivot;
    const td_symbol3 zero = td_symbol3_zero();
    const td_symbol_inertia nothing = {.axis = rest.axis};
    td_turn turn = w->place[w->pivot].turn;
    turn.s = td_symbol_negate(g, turn.s);
    rest = td_symbol_inertia_join(g, nothing, rest, td_symbol3_subtract(g, zero, w->place[w->pivot].offset));
    double back[9];
    if (body->is_before) rest = td_symbol_inertia_rotate(g, transposed(back, body->before), rest);
    rest = td_symbol_inertia_turn(g, turn, rest);
    if (body->is_after) rest = td_symbol_inertia_rotate(g, transposed(back, body->after), rest);
    return td_symbol_inertia_join(g, beyond, rest, zero);
}

static void write_base(td_writing *w, td_symbol *mass, td_symbol_inertia inertia)
{
    td_graph *g = &w->graph;
    for (int k = 0; k < 3; k++) {
        td_symbol3 unit = td_symbol3_zero();
        unit.v[k] = 1;
        const td_symbol3 turning = inertia_times(w, inertia, unit),
                         force = td_symbol3_cross(g, unit, inertia.h);
        for (int i = 0; i < 3; i++) {
            set_entry(w, mass, k, i, turning.v[i]);
            set_entry(w, mass, 3 + i, k, force.v[i]);
            set_entry(w, mass, 3 + k, 3 + i, i == k ? inertia.mass : 0);
        }
    }
}

void td_write_mass(td_writing *w, td_symbol *mass)
{
    const int count = w->tree->body_count, n = count + 5;
    td_symbol_inertia composite[TD_DYNAMICS_MAX];
    td_write_places(w);
    for (int i = 0; i < n * n; i++) mass[i] = 0;
    for (int i = 0; i < count; i++) composite[i] = inertia_of(w, i);
    for (int i = count - 1; i > 0; i--) {
        td_symbol_inertia *parent = composite + w->tree->body[i].parent;
        write_column(w, mass, i, composite[i]);
        if (i == w->pivot) continue;
        const td_symbol_inertia own = inertia_in_parent(w, i, composite[i]);
        *parent = td_symbol_inertia_join(&w->graph, *parent, own, w->place[i].offset);
    }
    write_base(w, mass, w->pivot ? inertia_at_pivot(w, composite[0], composite[w->pivot]) : composite[0]);
}
