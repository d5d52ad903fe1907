/* The moving tree: fixed links merged, working axes chosen, inertia regrouped (dynamics_internal.h). */
#include <math.h>
#include <string.h>

#include "sim/dynamics_internal.h"

static const double IDENTITY[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

/* ---- small matrices ---- */

static void apply(double y[3], const double r[9], const double x[3])
{
    double sum[3];
    for (int i = 0; i < 3; i++) sum[i] = r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2];
    memcpy(y, sum, sizeof sum);
}

static void apply_back(double y[3], const double r[9], const double x[3])
{
    double sum[3];
    for (int i = 0; i < 3; i++) sum[i] = r[i] * x[0] + r[3 + i] * x[1] + r[6 + i] * x[2];
    memcpy(y, sum, sizeof sum);
}

static void multiply(double c[9], const double a[9], const double b[9])
{
    double product[9];
    for (int i = 0; i < 9; i++) {
        const double *row = a + i / 3 * 3, *column = b + i % 3;
        product[i] = row[0] * column[0] + row[1] * column[3] + row[2] * column[6];
    }
    memcpy(c, product, sizeof product);
}

static void transpose(double b[9], const double a[9])
{
    for (int i = 0; i < 9; i++) b[i] = a[3 * (i % 3) + i / 3];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* R J R^T. */
static void rotate_moment(double to[9], const double r[9], const double j[9])
{
    double back[9], half[9];
    transpose(back, r);
    multiply(half, r, j);
    multiply(to, half, back);
}

/* Round-off of a rotation's entries would be code: what is 0 or 1 to the last bits is made so. */
static void snap(double *x, int count)
{
    for (int i = 0; i < count; i++)
        if (fabs(x[i] - round(x[i])) < 4e-16) x[i] = round(x[i]) + 0.0;
}

static bool parallel(const double a[3], const double b[3])
{
    double square = 0;
    for (int i = 0; i < 3; i++) {
        const double across = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
        square += across * across;
    }
    return square < 1e-30;
}

/* The coordinate axis that `a` is, with its sign; -1. */
static int coordinate(const double a[3], double *sign)
{
    for (int k = 0; k < 3; k++)
        if (fabs(a[k]) == 1 && a[(k + 1) % 3] == 0 && a[(k + 2) % 3] == 0) {
            *sign = a[k];
            return k;
        }
    return -1;
}

/* A rotation whose third column is a. */
static void rotation_to(double r[9], const double a[3])
{
    int least = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(a[k]) < fabs(a[least])) least = k;
    double x[3] = {-a[0] * a[least], -a[1] * a[least], -a[2] * a[least]};
    x[least] += 1;
    const double length = sqrt(dot(x, x));
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        r[3 * i] = x[i] / length;
        r[3 * i + 1] = (a[j] * x[k] - a[k] * x[j]) / length;
        r[3 * i + 2] = a[i];
    }
}

/* ---- merging ---- */

/* While the tree is built: each body in the axes of the link that its joint moves. */
typedef struct raw {
    double offset[3], rotation[9]; /* of the body in its parent body, at q = 0 */
    double axis[3];                /* in the body */
    double working[9];             /* the body's working axes from its own, at q = 0 */
    double spin_axis[3];           /* in the body's axes, about which it turns in its working axes */
    bool spins;
    double slid[3]; /* in the working axes: own origin as given, from the slid one */
} raw;

typedef struct builder {
    td_tree *tree;
    const td_robot *robot;
    raw body[TD_DYNAMICS_MAX];
} builder;

static void place_links(builder *b)
{
    for (int i = 0; i < b->robot->link_count; i++) {
        const td_robot_link *from = b->robot->link + i;
        td_body_link *to = b->tree->link + i;
        double offset[3] = {0}, rotation[9];
        memcpy(rotation, IDENTITY, sizeof rotation);
        to->body = 0;
        if (from->parent >= 0) {
            const td_body_link *parent = b->tree->link + from->parent;
            double own[9];
            td_pose_rotation(own, &from->parent_from_link);
            snap(own, 9);
            apply(offset, parent->rotation, from->parent_from_link.t);
            for (int k = 0; k < 3; k++) offset[k] += parent->offset[k];
            multiply(rotation, parent->rotation, own);
            snap(rotation, 9);
            to->body = parent->body;
        }
        if (from->joint >= 0) {
            raw *moving = b->body + from->joint + 1;
            td_body *body = b->tree->body + from->joint + 1;
            body->parent = to->body;
            body->kind = b->robot->joint[from->joint].kind;
            memcpy(moving->offset, offset, sizeof offset);
            memcpy(moving->rotation, rotation, sizeof rotation);
            memcpy(moving->axis, b->robot->joint[from->joint].axis, sizeof moving->axis);
            memset(offset, 0, sizeof offset);
            memcpy(rotation, IDENTITY, sizeof rotation);
            to->body = from->joint + 1;
        }
        memcpy(to->offset, offset, sizeof offset);
        memcpy(to->rotation, rotation, sizeof rotation);
    }
}

/* ---- working axes ---- */

static bool turns(const td_body *body)
{
    return body->kind == TD_JOINT_REVOLUTE || body->kind == TD_JOINT_CONTINUOUS;
}

/* A child's axis, in the axes of `index`, that does not stand still while `index` spins; -1: all do. */
static int unlike_child(double axis[3], const builder *b, int index)
{
    for (int c = index + 1; c < b->tree->body_count; c++) {
        if (b->tree->body[c].parent != index || !turns(b->tree->body + c)) continue;
        apply(axis, b->body[c].rotation, b->body[c].axis);
        if (!parallel(axis, b->body[index].spin_axis)) return c;
    }
    return -1;
}

/* Whether this body spins in its parent's working axes, and about what. */
static void find_spin(builder *b, int index)
{
    raw *body = b->body + index;
    const raw *parent = b->body + b->tree->body[index].parent;
    body->spins = turns(b->tree->body + index) || parent->spins;
    if (turns(b->tree->body + index))
        memcpy(body->spin_axis, body->axis, sizeof body->axis);
    else
        apply_back(body->spin_axis, body->rotation, parent->spin_axis);
}

/* The constant rotation behind the spin: one that makes the child's axis a coordinate axis. */
static void choose_after(double after[9], const builder *b, int index, const double rotation[9])
{
    double axis[3], sign;
    memcpy(after, IDENTITY, 9 * sizeof *after);
    if (unlike_child(axis, b, index) < 0) return;
    apply(axis, rotation, axis);
    snap(axis, 3);
    if (coordinate(axis, &sign) < 0) rotation_to(after, axis);
}

/* Of a spinning body: about which coordinate axis of the parent's working axes. A body below one that spins
 * spins about the same axis, or that one would be turned. */
static void choose_spin(builder *b, int index)
{
    td_body *body = b->tree->body + index;
    const td_body *parent = b->tree->body + body->parent;
    body->sign = 1;
    if (b->body[body->parent].spins) {
        body->spin = parent->spin;
        if (!turns(body)) return;
        const int k = body->spin;
        body->sign = body->axis[k] < 0 ? -1 : 1;
        for (int i = 0; i < 3; i++) body->axis[i] = i == k ? body->sign : 0;
        return;
    }
    body->spin = coordinate(body->axis, &body->sign);
    body->is_before = body->spin < 0;
}

static void take_off(double rotation[9], const double left[9])
{
    double back[9];
    transpose(back, left);
    multiply(rotation, back, rotation);
    snap(rotation, 9);
}

static void choose_axes(builder *b, int index)
{
    td_body *body = b->tree->body + index;
    raw *own = b->body + index;
    double rotation[9], ignored[3]; /* rotation: the parent's working axes from the body's own */
    multiply(rotation, b->body[body->parent].working, own->rotation);
    snap(rotation, 9);
    apply(body->axis, rotation, own->axis);
    snap(body->axis, 3);
    memcpy(body->before, IDENTITY, sizeof body->before);
    memcpy(body->after, IDENTITY, sizeof body->after);
    body->spin = -1;
    if (own->spins) choose_spin(b, index);
    body->turned = body->is_before || (own->spins && unlike_child(ignored, b, index) >= 0);
    body->frame = body->turned ? index : b->tree->body[body->parent].frame;
    if (body->is_before) {
        rotation_to(body->before, body->axis);
        take_off(rotation, body->before);
        body->spin = 2;
        body->sign = 1;
    }
    if (body->turned) {
        choose_after(body->after, b, index, rotation);
        body->is_after = memcmp(body->after, IDENTITY, sizeof IDENTITY) != 0;
        take_off(rotation, body->after);
        own->spins = false;
    }
    memcpy(own->working, rotation, sizeof rotation);
}

/* The offset in the parent's working axes, made to lie across a revolute joint's axis. */
static void choose_origin(builder *b, int index)
{
    td_body *body = b->tree->body + index;
    raw *own = b->body + index;
    const raw *parent = b->body + body->parent;
    apply(body->offset, parent->working, own->offset);
    for (int k = 0; k < 3; k++) body->offset[k] += parent->slid[k];
    if (!turns(body)) return;
    const double along = dot(body->offset, body->axis);
    double axis[3];
    apply(axis, own->working, own->axis);
    snap(axis, 3);
    for (int k = 0; k < 3; k++) {
        body->offset[k] -= along * body->axis[k];
        own->slid[k] = along * axis[k];
    }
}

/* ---- inertia ---- */

/* Links to the working axes of their bodies. */
static void turn_links(builder *b)
{
    for (int i = 0; i < b->tree->link_count; i++) {
        td_body_link *link = b->tree->link + i;
        const raw *body = b->body + link->body;
        apply(link->offset, body->working, link->offset);
        for (int k = 0; k < 3; k++) link->offset[k] += body->slid[k];
        multiply(link->rotation, body->working, link->rotation);
        snap(link->rotation, 9);
    }
}

/* J = tr(I) / 2 - I, about the centre of mass; then about the body's origin. */
static void add_link(td_body *body, const td_body_link *at, const td_robot_link *link)
{
    const double *inertia = link->inertia, half = (inertia[0] + inertia[4] + inertia[8]) / 2;
    double central[9], turned[9], centre[3];
    for (int i = 0; i < 9; i++) central[i] = (i % 4 == 0 ? half : 0) - inertia[i];
    rotate_moment(turned, at->rotation, central);
    apply(centre, at->rotation, link->com_m);
    for (int k = 0; k < 3; k++) centre[k] += at->offset[k];
    body->mass += link->mass_kg;
    for (int k = 0; k < 3; k++) body->h[k] += link->mass_kg * centre[k];
    for (int i = 0; i < 9; i++) body->moment[i] += turned[i] + link->mass_kg * centre[i / 3] * centre[i % 3];
}

/* A mass, first moment h along unit a, and second moment j, about a point at r, added to the parent. */
static void give(td_body *parent, const double r[3], const double a[3], double mass, double h,
                 const double j[9])
{
    parent->mass += mass;
    for (int k = 0; k < 3; k++) parent->h[k] += mass * r[k] + h * a[k];
    for (int i = 0; i < 9; i++) {
        const int p = i / 3, q = i % 3;
        parent->moment[i] += mass * r[p] * r[q] + h * (r[p] * a[q] + a[p] * r[q]) + j[i];
    }
}

/* Of a body's moments to the parent's working axes with the parent's own spin at 0. */
static void moment_in_parent(double to[9], const td_body *body, const double moment[9])
{
    double r[9];
    multiply(r, body->before, body->after);
    rotate_moment(to, r, moment);
}

static void regroup(td_tree *tree, int index, const double axis[3], bool spare_base)
{
    td_body *body = tree->body + index, *parent = tree->body + body->parent;
    double j[9];
    if (!turns(body)) {
        static const double none[3] = {0};
        moment_in_parent(j, body, body->moment);
        give(parent, none, none, 0, 0, j);
        memset(body->moment, 0, sizeof body->moment);
        return;
    }
    const bool spared = spare_base && body->parent == 0;
    const double mass = spared ? 0 : body->mass, h = spared ? 0 : dot(body->h, axis);
    double across[3];
    apply(across, body->moment, axis);
    const double along = dot(across, axis);
    for (int i = 0; i < 9; i++) {
        body->moment[i] -= along * axis[i / 3] * axis[i % 3];
        j[i] = along * body->axis[i / 3] * body->axis[i % 3];
    }
    give(parent, body->offset, body->axis, mass, h, j);
    for (int k = 0; k < 3; k++) body->h[k] -= h * axis[k];
    body->mass -= mass;
}

/* Differences of equal numbers leave round-off, which would be code: against the size of the whole. */
static void clean(double *x, int count, double size)
{
    for (int i = 0; i < count; i++)
        if (fabs(x[i]) < 1e-15 * size) x[i] = 0;
}

static void choose_inertia_axis(td_tree *tree, int index)
{
    td_body *body = tree->body + index;
    body->inertia_axis = body->spin >= 0 && !body->turned ? body->spin : -1;
    for (int c = index + 1; body->inertia_axis < 0 && c < tree->body_count; c++)
        if (tree->body[c].parent == index && tree->body[c].spin >= 0 && !tree->body[c].is_before)
            body->inertia_axis = tree->body[c].spin;
    if (body->inertia_axis < 0) body->inertia_axis = 2;
}

void td_tree_build(td_tree *tree, const td_robot *robot, bool spare_base)
{
    static const raw base = {.rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .working = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    builder b = {.tree = tree, .robot = robot};
    *tree = (td_tree){.body_count = robot->joint_count + 1, .link_count = robot->link_count};
    b.body[0] = base;
    tree->body[0] = (td_body){.parent = -1, .kind = TD_JOINT_FIXED, .spin = -1};
    place_links(&b);
    for (int i = 1; i < tree->body_count; i++) {
        find_spin(&b, i);
        choose_axes(&b, i);
        choose_origin(&b, i);
    }
    turn_links(&b);
    for (int i = 0; i < robot->link_count; i++)
        add_link(tree->body + tree->link[i].body, tree->link + i, robot->link + i);
    for (int i = 0; i < tree->body_count; i++) choose_inertia_axis(tree, i);
    for (int i = tree->body_count - 1; i >= 0; i--) {
        td_body *body = tree->body + i;
        double axis[3], size = 0, reach = 0;
        for (int k = 0; k < 9; k++) size = fmax(size, fabs(body->moment[k]));
        for (int k = 0; k < 3; k++) reach = fmax(reach, fabs(body->h[k]));
        apply(axis, b.body[i].working, b.body[i].axis);
        snap(axis, 3);
        if (i > 0) regroup(tree, i, axis, spare_base);
        clean(body->moment, 9, size);
        clean(body->h, 3, reach);
    }
}
