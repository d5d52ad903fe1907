/* Stones and other solids: bodies that touch the machine, one another and the ground. */
#include <math.h>
#include <string.h>

#include "sim/world_internal.h"

enum { MAX_CONTACTS = 8 };
static const double PLATE_M = 0.05; /* thickness of the hollow bucket's plates */
/* Contact: a tenth of a penetration is taken back in a step; the softness keeps the equations of many
 * contacts of one body regular. */
static const double CONTACT_ERP = 0.1, CONTACT_CFM = 1e-9;
static const double FASTEST = 1e4; /* m/s, rad/s */

static void set_offset(dGeomID geom, const td_world_body *b, const td_pose *body_from_shape)
{
    double at[3];
    for (int c = 0; c < 3; c++) at[c] = body_from_shape->t[c] - b->com[c];
    if (!b->ode) {
        const td_pose site = td_pose_compose(&b->pose, body_from_shape);
        dGeomSetPosition(geom, site.t[0], site.t[1], site.t[2]);
        dGeomSetQuaternion(geom, site.q);
        return;
    }
    dGeomSetBody(geom, b->ode);
    dGeomSetOffsetPosition(geom, at[0], at[1], at[2]);
    dGeomSetOffsetQuaternion(geom, body_from_shape->q);
}

static dGeomID make_geom(dSpaceID space, const td_primitive *p)
{
    if (p->kind == TD_PRIMITIVE_BOX) return dCreateBox(space, p->size[0], p->size[1], p->size[2]);
    if (p->kind == TD_PRIMITIVE_SPHERE) return dCreateSphere(space, p->size[0]);
    return dCreateCapsule(space, p->size[0], p->size[1]);
}

/* ---- the machine's shapes ---- */

/* The last link (deepest in the tree) that has a box. */
static int hollow_link(const td_robot *r)
{
    for (int i = r->link_count - 1; i > 0; i--)
        if (r->link[i].shape_count > 0 && r->link[i].shape[0].kind == TD_PRIMITIVE_BOX) return i;
    return -1;
}

/* A plate from (x0, z0) to (x1, z1) in the shell's own axes, as wide as the shell. */
static void add_plate(td_world *w, const td_world_body *b, const td_pose *body_from_box, double wide,
                      double x0, double z0, double x1, double z1)
{
    const double angle = -atan2(z1 - z0, x1 - x0);
    const td_pose at = {.q = {cos(angle / 2), 0, sin(angle / 2), 0}, .t = {(x0 + x1) / 2, 0, (z0 + z1) / 2}};
    const td_pose pose = td_pose_compose(body_from_box, &at);
    set_offset(dCreateBox(w->machine_space, hypot(x1 - x0, z1 - z0), wide, PLATE_M), b, &pose);
}

/* The shell's first box without its lower side: back, floor as far as the middle, from there a plate to the
 * teeth, which are where the link's boxes end in x at the mouth, and sides. */
static void add_shell(td_world *w, int link)
{
    const td_robot_link *l = w->machine->robot.link + link;
    const td_world_body *b = w->body + w->body_of[link];
    const td_primitive *box = l->shape;
    const td_pose at = td_pose_compose(w->body_from_link + link, &box->link_from_shape);
    const double x = box->size[0] / 2, y = box->size[1] / 2, z = box->size[2] / 2;
    double teeth = x;
    for (int i = 1; i < l->shape_count; i++)
        if (l->shape[i].kind == TD_PRIMITIVE_BOX)
            teeth = fmax(teeth, l->shape[i].link_from_shape.t[0] + l->shape[i].size[0] / 2 -
                                    box->link_from_shape.t[0]);
    add_plate(w, b, &at, 2 * y, -x, -z, -x, z);
    add_plate(w, b, &at, 2 * y, -x, z, 0, z);
    add_plate(w, b, &at, 2 * y, 0, z, teeth, -z);
    for (int side = -1; side < 2; side += 2) {
        td_pose wall = td_pose_identity();
        wall.t[1] = side * (y - PLATE_M / 2);
        wall = td_pose_compose(&at, &wall);
        set_offset(dCreateBox(w->machine_space, 2 * x, PLATE_M, 2 * z), b, &wall);
    }
}

static void make_spaces(td_world *w)
{
    const td_robot *r = &w->machine->robot;
    const int hollow = hollow_link(r);
    w->machine_space = dSimpleSpaceCreate(NULL);
    w->stone_space = dHashSpaceCreate(NULL);
    w->contacts = dJointGroupCreate(0);
    for (int i = 0; i < r->link_count; i++)
        for (int k = 0; k < r->link[i].shape_count && i != hollow; k++) {
            const td_primitive *p = r->link[i].shape + k;
            const td_pose at = td_pose_compose(w->body_from_link + i, &p->link_from_shape);
            set_offset(make_geom(w->machine_space, p), w->body + w->body_of[i], &at);
        }
    if (hollow >= 0) add_shell(w, hollow);
}

double td_world_buried(const td_world *w, int *link)
{
    const td_robot *r = &w->machine->robot;
    double deepest = -INFINITY;
    for (int i = 1; i < r->link_count; i++) {
        if (w->body_of[i] != w->body_count - 1) continue;
        const td_pose at = td_pose_compose(&w->body[w->body_of[i]].pose, w->body_from_link + i);
        const double depth = td_world_height_at(w, at.t[0], at.t[1]) - at.t[2];
        if (depth > deepest) deepest = depth, *link = i;
    }
    return deepest;
}

/* ---- stones ---- */

static td_status check_stone(const td_world_stone *s, td_error *error)
{
    static const int sizes[3] = {3, 2, 1};
    double square = 0;
    bool ok = (unsigned)s->shape.kind <= TD_PRIMITIVE_SPHERE;
    for (int i = 0; ok && i < sizes[s->shape.kind]; i++) ok = s->shape.size[i] > 0 && s->shape.size[i] < 1e3;
    for (int i = 0; i < 3; i++) ok = ok && isfinite(s->shape.link_from_shape.t[i]);
    for (int i = 0; i < 4; i++) square += s->shape.link_from_shape.q[i] * s->shape.link_from_shape.q[i];
    if (!ok || !(fabs(square - 1) < 1e-6))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "world: a stone's kind, size or pose is none; sizes are above 0 and below 1000 m, its "
                       "quaternion of length 1");
    if (!(s->density >= 0 && s->density <= 1e5) || !(s->friction >= 0 && s->friction <= 100))
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "world: a stone of %g kg/m^3 and friction %g; they must be within 0 and 1e5, 0 and 100",
            s->density, s->friction);
    return TD_OK;
}

static void set_mass(dMass *mass, const td_world_stone *s)
{
    const double *size = s->shape.size;
    if (s->shape.kind == TD_PRIMITIVE_BOX)
        dMassSetBox(mass, s->density, size[0], size[1], size[2]);
    else if (s->shape.kind == TD_PRIMITIVE_SPHERE)
        dMassSetSphere(mass, s->density, size[0]);
    else
        dMassSetCapsule(mass, s->density, 3, size[0], size[1]);
}

td_status td_world_add_stone(td_world *w, int *index, const td_world_stone *s, td_error *error)
{
    const td_pose *at = &s->shape.link_from_shape;
    TD_TRY(check_stone(s, error));
    if (w->stone_count == TD_WORLD_MAX_STONES)
        return td_fail(error, TD_ERROR_ARGUMENT, "world: more than %d stones; leave some out",
                       TD_WORLD_MAX_STONES);
    dAllocateODEDataForThread(dAllocateFlagCollisionData);
    if (!w->stone_space) make_spaces(w);
    td_world_stone_body *b = w->stone + w->stone_count;
    *b = (td_world_stone_body){.shape = s->shape, .friction = s->friction};
    b->geom = make_geom(w->stone_space, &s->shape);
    dGeomSetData(b->geom, b);
    if (s->density > 0) {
        dMass mass;
        set_mass(&mass, s);
        b->ode = dBodyCreate(w->ode);
        dBodySetMass(b->ode, &mass);
        dGeomSetBody(b->geom, b->ode);
    }
    dGeomSetPosition(b->geom, at->t[0], at->t[1], at->t[2]);
    dGeomSetQuaternion(b->geom, at->q);
    if (index) *index = w->stone_count;
    w->stone_count++;
    return TD_OK;
}

int td_world_stone_count(const td_world *w)
{
    return w->stone_count;
}

bool td_world_stone_at(td_pose *site_from_stone, double twist[6], const td_world *w, int index)
{
    const td_world_stone_body *b = w->stone + index;
    dQuaternion q;
    dGeomGetQuaternion(b->geom, q);
    memcpy(site_from_stone->q, q, sizeof site_from_stone->q);
    memcpy(site_from_stone->t, dGeomGetPosition(b->geom), sizeof site_from_stone->t);
    for (int c = 0; c < 3 && twist; c++) {
        twist[c] = b->ode ? dBodyGetAngularVel(b->ode)[c] : 0;
        twist[3 + c] = b->ode ? dBodyGetLinearVel(b->ode)[c] : 0;
    }
    return !b->lost;
}

void td_world_free_stones(td_world *w)
{
    if (w->contacts) dJointGroupDestroy(w->contacts);
    if (w->machine_space) dSpaceDestroy(w->machine_space);
    if (w->stone_space) dSpaceDestroy(w->stone_space);
}

/* ---- contacts ---- */

static void add_contact(td_world *w, const dContactGeom *geom, double friction, dBodyID one, dBodyID other)
{
    dContact c = {.surface = {.mode = dContactApprox1 | dContactSoftERP | dContactSoftCFM,
                              .mu = friction,
                              .soft_erp = CONTACT_ERP,
                              .soft_cfm = CONTACT_CFM},
                  .geom = *geom};
    dJointAttach(dJointCreateContact(w->ode, w->contacts, &c), one, other);
}

/* Friction of a pair: the stone's, or the smaller of two stones'. */
static void touch_pair(void *world, dGeomID one, dGeomID other)
{
    td_world *w = world;
    const dBodyID a = dGeomGetBody(one), b = dGeomGetBody(other);
    const td_world_stone_body *p = dGeomGetData(one), *q = dGeomGetData(other);
    dContactGeom found[MAX_CONTACTS];
    if (!a && !b) return;
    const double friction = fmin(p ? p->friction : INFINITY, q ? q->friction : INFINITY);
    const int count = dCollide(one, other, MAX_CONTACTS, found, sizeof *found);
    for (int i = 0; i < count; i++) add_contact(w, found + i, friction, a, b);
}

static bool touch_ground_at(td_world *w, const td_world_stone_body *b, const double at[3], double radius)
{
    double normal[3], height;
    if (!td_world_normal(normal, &height, w, at[0], at[1])) return false;
    const double depth = (height - at[2]) * normal[2] + radius;
    if (!(depth > 0)) return true;
    dContactGeom geom = {.depth = depth, .g1 = b->geom};
    for (int c = 0; c < 3; c++) {
        geom.pos[c] = at[c] - radius * normal[c];
        geom.normal[c] = normal[c];
    }
    add_contact(w, &geom, b->friction, b->ode, NULL);
    return true;
}

/* Corners of a box, lowest points of spheres and capsules. */
static bool touch_ground(td_world *w, const td_world_stone_body *b)
{
    const double *size = b->shape.size;
    const bool box = b->shape.kind == TD_PRIMITIVE_BOX;
    const int count = box ? 8 : b->shape.kind == TD_PRIMITIVE_CAPSULE ? 2 : 1;
    for (int i = 0; i < count; i++) {
        dVector3 at;
        double p[3] = {0};
        for (int c = 0; c < 3 && box; c++) p[c] = (i >> c & 1 ? 0.5 : -0.5) * size[c];
        if (count == 2) p[2] = (i ? 0.5 : -0.5) * size[1];
        dBodyGetRelPointPos(b->ode, p[0], p[1], p[2], at);
        if (!touch_ground_at(w, b, at, box ? 0 : size[0])) return false;
    }
    return true;
}

/* ODE aborts the program on numbers that are none, which grow out of speeds that no stone has. */
static bool runs_away(dBodyID body)
{
    const dReal *v = dBodyGetLinearVel(body), *turn = dBodyGetAngularVel(body);
    double most = 0;
    for (int c = 0; c < 3; c++) most += fabs(v[c]) + fabs(turn[c]);
    return !(most < FASTEST);
}

void td_world_touch(td_world *w)
{
    if (w->stone_count == 0) return;
    dJointGroupEmpty(w->contacts);
    dSpaceCollide2((dGeomID)w->machine_space, (dGeomID)w->stone_space, w, touch_pair);
    dSpaceCollide(w->stone_space, w, touch_pair);
    for (int i = 0; i < w->stone_count; i++) {
        td_world_stone_body *b = w->stone + i;
        if (b->ode && !b->lost && (runs_away(b->ode) || !touch_ground(w, b))) {
            b->lost = true;
            dBodySetLinearVel(b->ode, 0, 0, 0);
            dBodySetAngularVel(b->ode, 0, 0, 0);
            dBodyDisable(b->ode);
            dGeomDisable(b->geom);
        }
    }
}
