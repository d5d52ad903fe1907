/* Rays against bodies: triangles, the robot's boxes, capsules and spheres, pictures; in a tree of boxes. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sim/stereo_view_internal.h"

enum { LEAF = 2, STACK = 64 };

static inline double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static inline void subtract(double c[3], const double a[3], const double b[3])
{
    for (int i = 0; i < 3; i++) c[i] = a[i] - b[i];
}

/* ---- one body ---- */

/* Moller and Trumbore 1997. */
static double cross_triangle(const td_body *body, const double o[3], const double d[3])
{
    const double(*side)[3] = body->of.triangle.side;
    double p[3], q[3], from[3];
    cross(p, d, side[1]);
    const double determinant = dot(side[0], p);
    if (determinant == 0) return INFINITY;
    const double inverse = 1 / determinant;
    subtract(from, o, body->of.triangle.corner);
    const double u = dot(from, p) * inverse;
    if (u < 0 || u > 1) return INFINITY;
    cross(q, from, side[0]);
    const double v = dot(d, q) * inverse;
    if (v < 0 || u + v > 1) return INFINITY;
    return dot(side[1], q) * inverse;
}

static double cross_picture(const td_body *body, const double o[3], const double d[3])
{
    const double facing = dot(body->of.picture.normal, d);
    double from[3], at[3];
    if (facing == 0) return INFINITY;
    subtract(from, body->of.picture.corner, o);
    const double t = dot(body->of.picture.normal, from) / facing;
    for (int i = 0; i < 3; i++) at[i] = t * d[i] - from[i];
    const double x = dot(at, body->of.picture.right), y = dot(at, body->of.picture.down);
    const td_scene_picture *picture = body->of.picture.picture;
    return x >= 0 && x <= picture->width_m && y >= 0 && y <= picture->height_m ? t : INFINITY;
}

static double enter_box(const double half[3], const double o[3], const double d[3])
{
    double begin = -INFINITY, end = INFINITY;
    for (int a = 0; a < 3; a++) {
        if (d[a] == 0) {
            if (fabs(o[a]) > half[a]) return INFINITY;
            continue;
        }
        const double t0 = (-half[a] - o[a]) / d[a], t1 = (half[a] - o[a]) / d[a];
        begin = fmax(begin, fmin(t0, t1));
        end = fmin(end, fmax(t0, t1));
    }
    return begin <= end ? begin : INFINITY;
}

/* Entry into a ball around (0, 0, z). The nearest point of the ray first, so that far balls keep their
 * digits. */
static double enter_ball(double radius, double z, const double o[3], const double d[3])
{
    const double from[3] = {o[0], o[1], o[2] - z}, length = dot(d, d), nearest = -dot(from, d) / length;
    double at[3];
    for (int i = 0; i < 3; i++) at[i] = from[i] + nearest * d[i];
    const double room = radius * radius - dot(at, at);
    return room >= 0 ? nearest - sqrt(room / length) : INFINITY;
}

/* A capsule is the union of a cylinder's wall and two balls: the first entry is the least of theirs, for
 * none of them is entered inside another before it. */
static double enter_capsule(double radius, double half, const double o[3], const double d[3])
{
    double first = fmin(enter_ball(radius, half, o, d), enter_ball(radius, -half, o, d));
    const double across = d[0] * d[0] + d[1] * d[1];
    if (across == 0) return first;
    const double nearest = -(o[0] * d[0] + o[1] * d[1]) / across;
    const double x = o[0] + nearest * d[0], y = o[1] + nearest * d[1];
    const double room = radius * radius - x * x - y * y;
    if (room < 0) return first;
    const double t = nearest - sqrt(room / across);
    return fabs(o[2] + t * d[2]) <= half ? fmin(first, t) : first;
}

static void to_shape(double v[3], const double rotation[9], const double w[3])
{
    for (int i = 0; i < 3; i++) v[i] = rotation[i] * w[0] + rotation[3 + i] * w[1] + rotation[6 + i] * w[2];
}

static double cross_primitive(const td_body *body, const double o[3], const double d[3])
{
    double from[3], origin[3], ray[3];
    const double *size = body->of.primitive.size;
    subtract(from, o, body->of.primitive.centre);
    to_shape(origin, body->of.primitive.rotation, from);
    to_shape(ray, body->of.primitive.rotation, d);
    switch (body->of.primitive.kind) {
    case TD_PRIMITIVE_BOX:
        return enter_box(size, origin, ray);
    case TD_PRIMITIVE_CAPSULE:
        return enter_capsule(size[0], size[1], origin, ray);
    default:
        return enter_ball(size[0], 0, origin, ray);
    }
}

static double cross_body(const td_body *body, const double o[3], const double d[3])
{
    return body->kind == TD_BODY_TRIANGLE    ? cross_triangle(body, o, d)
           : body->kind == TD_BODY_PRIMITIVE ? cross_primitive(body, o, d)
                                             : cross_picture(body, o, d);
}

static int primitive_surface(const td_body *body, double normal[3], double local[3])
{
    const double *size = body->of.primitive.size, *r = body->of.primitive.rotation;
    double n[3] = {local[0], local[1], local[2]};
    int side = 0;
    if (body->of.primitive.kind == TD_PRIMITIVE_BOX) {
        for (int a = 1; a < 3; a++)
            if (fabs(local[a]) - size[a] > fabs(local[side]) - size[side]) side = a;
        for (int a = 0; a < 3; a++) n[a] = a == side ? copysign(1, local[a]) : 0;
        side = 2 * side + (local[side] > 0);
    } else if (body->of.primitive.kind == TD_PRIMITIVE_CAPSULE) {
        n[2] = local[2] > size[1] ? local[2] - size[1] : local[2] < -size[1] ? local[2] + size[1] : 0;
    }
    const double scale = 1 / sqrt(dot(n, n));
    for (int i = 0; i < 3; i++)
        normal[i] = scale * (r[3 * i] * n[0] + r[3 * i + 1] * n[1] + r[3 * i + 2] * n[2]);
    return side;
}

int td_body_surface(const td_body *body, const double point[3], double normal[3], double local[3])
{
    double from[3];
    if (body->kind == TD_BODY_PRIMITIVE) {
        subtract(from, point, body->of.primitive.centre);
        to_shape(local, body->of.primitive.rotation, from);
        return primitive_surface(body, normal, local);
    }
    if (body->kind == TD_BODY_PICTURE) {
        subtract(from, point, body->of.picture.corner);
        local[0] = dot(from, body->of.picture.right);
        local[1] = dot(from, body->of.picture.down);
        local[2] = 0;
        memcpy(normal, body->of.picture.normal, 3 * sizeof(double));
        return 0;
    }
    const td_pose solid_from_site = td_pose_inverse(&body->of.triangle.site_from_solid);
    td_pose_transform(local, &solid_from_site, point);
    memcpy(normal, body->of.triangle.normal, 3 * sizeof(double));
    return 0;
}

/* ---- the list ---- */

static td_status append(td_body **body, td_bodies *bodies, td_error *error)
{
    if (bodies->count == bodies->capacity) {
        const size_t capacity = bodies->capacity ? 2 * bodies->capacity : 64;
        td_body *more = realloc(bodies->body, capacity * sizeof *more);
        if (!more || capacity > UINT32_MAX) {
            if (more) bodies->body = more;
            return td_fail(error, TD_ERROR_MEMORY, "no memory for the scene's %zu bodies", bodies->count);
        }
        bodies->body = more;
        bodies->capacity = capacity;
    }
    *body = bodies->body + bodies->count++;
    **body = (td_body){.low = {INFINITY, INFINITY, INFINITY}, .high = {-INFINITY, -INFINITY, -INFINITY}};
    return TD_OK;
}

static void stretch(td_body *body, const double point[3])
{
    for (int i = 0; i < 3; i++) {
        body->low[i] = fmin(body->low[i], point[i]);
        body->high[i] = fmax(body->high[i], point[i]);
    }
}

static td_status add_triangle(td_bodies *bodies, const td_solid *solid, const uint32_t triangle[3],
                              td_error *error)
{
    double corner[3][3], normal[3];
    td_body *body;
    TD_TRY(append(&body, bodies, error));
    body->kind = TD_BODY_TRIANGLE;
    body->surface = &solid->surface;
    body->of.triangle.site_from_solid = solid->site_from_solid;
    for (int k = 0; k < 3; k++) {
        td_pose_transform(corner[k], &solid->site_from_solid, solid->corner[triangle[k]]);
        stretch(body, corner[k]);
    }
    memcpy(body->of.triangle.corner, corner[0], sizeof corner[0]);
    for (int k = 0; k < 2; k++) subtract(body->of.triangle.side[k], corner[k + 1], corner[0]);
    cross(normal, body->of.triangle.side[0], body->of.triangle.side[1]);
    const double length = sqrt(dot(normal, normal));
    for (int i = 0; i < 3; i++) body->of.triangle.normal[i] = length > 0 ? normal[i] / length : 0;
    return TD_OK;
}

static td_status add_picture(td_bodies *bodies, const td_scene_picture *picture,
                             const td_pose *site_from_picture, td_error *error)
{
    double r[9];
    td_body *body;
    TD_TRY(append(&body, bodies, error));
    body->kind = TD_BODY_PICTURE;
    body->of.picture.picture = picture;
    td_pose_rotation(r, site_from_picture);
    for (int i = 0; i < 3; i++) {
        body->of.picture.corner[i] = site_from_picture->t[i];
        body->of.picture.right[i] = r[3 * i];
        body->of.picture.down[i] = r[3 * i + 1];
        body->of.picture.normal[i] = -r[3 * i + 2];
    }
    for (int k = 0; k < 4; k++) {
        double corner[3];
        const double local[3] = {k & 1 ? picture->width_m : 0, k & 2 ? picture->height_m : 0, 0};
        td_pose_transform(corner, site_from_picture, local);
        stretch(body, corner);
    }
    return TD_OK;
}

td_status td_bodies_add_fixed(td_bodies *bodies, const td_scene *scene, td_error *error)
{
    for (size_t i = 0; i < scene->solid_count; i++) {
        const td_solid *solid = scene->solid + i;
        for (size_t k = 0; k < solid->triangle_count; k++) {
            const uint32_t *triangle = solid->triangle[k];
            for (int c = 0; c < 3; c++)
                if (triangle[c] >= solid->corner_count)
                    return td_fail(error, TD_ERROR_ARGUMENT,
                                   "solid '%s': triangle %zu names corner %u of %zu", solid->name, k,
                                   (unsigned)triangle[c], solid->corner_count);
            TD_TRY(add_triangle(bodies, solid, triangle, error));
        }
    }
    for (size_t i = 0; i < scene->picture_count; i++)
        if (scene->picture[i].link < 0)
            TD_TRY(add_picture(bodies, scene->picture + i, &scene->picture[i].site_from_picture, error));
    return TD_OK;
}

static td_status add_primitive(td_bodies *bodies, const td_primitive *shape, const td_pose *site_from_link,
                               const td_surface *surface, td_error *error)
{
    const td_pose pose = td_pose_compose(site_from_link, &shape->link_from_shape);
    td_body *body;
    TD_TRY(append(&body, bodies, error));
    body->kind = TD_BODY_PRIMITIVE;
    body->surface = surface;
    body->of.primitive.kind = shape->kind;
    double *size = body->of.primitive.size, *r = body->of.primitive.rotation;
    td_pose_rotation(r, &pose);
    memcpy(body->of.primitive.centre, pose.t, sizeof pose.t);
    memcpy(size, shape->size, sizeof shape->size);
    if (shape->kind == TD_PRIMITIVE_BOX)
        for (int i = 0; i < 3; i++) size[i] *= 0.5;
    if (shape->kind == TD_PRIMITIVE_CAPSULE) size[1] *= 0.5;
    for (int i = 0; i < 3; i++) {
        const double reach =
            shape->kind == TD_PRIMITIVE_BOX
                ? fabs(r[3 * i]) * size[0] + fabs(r[3 * i + 1]) * size[1] + fabs(r[3 * i + 2]) * size[2]
            : shape->kind == TD_PRIMITIVE_CAPSULE ? fabs(r[3 * i + 2]) * size[1] + size[0]
                                                  : size[0];
        body->low[i] = pose.t[i] - reach;
        body->high[i] = pose.t[i] + reach;
    }
    return TD_OK;
}

td_status td_bodies_add_moving(td_bodies *bodies, const td_scene *scene, td_error *error)
{
    const td_robot *robot = scene->robot;
    if (!robot) return TD_OK;
    td_pose *root_from_link = malloc(((size_t)robot->link_count + 1) * sizeof *root_from_link);
    if (!root_from_link) return td_fail(error, TD_ERROR_MEMORY, "no memory for the robot's links");
    td_robot_forward(root_from_link, robot, scene->q);
    td_status status = TD_OK;
    for (int l = 0; l < robot->link_count && status == TD_OK; l++) {
        const td_pose site_from_link = td_pose_compose(&scene->site_from_vehicle, root_from_link + l);
        for (int k = 0; k < robot->link[l].shape_count && status == TD_OK; k++)
            status = add_primitive(bodies, robot->link[l].shape + k, &site_from_link, &scene->robot_surface,
                                   error);
        for (size_t i = 0; i < scene->picture_count && status == TD_OK; i++) {
            if (scene->picture[i].link != l) continue;
            const td_pose pose = td_pose_compose(&site_from_link, &scene->picture[i].site_from_picture);
            status = add_picture(bodies, scene->picture + i, &pose, error);
        }
    }
    free(root_from_link);
    return status;
}

void td_bodies_free(td_bodies *bodies)
{
    free(bodies->body);
    free(bodies->order);
    free(bodies->node);
    *bodies = (td_bodies){0};
}

/* ---- the tree ---- */

static double middle(const td_bodies *b, uint32_t index, int axis)
{
    return b->body[index].low[axis] + b->body[index].high[axis];
}

/* Puts the `half` bodies with the lowest middles first (Hoare's selection); equal middles by their numbers,
 * so that the tree is always the same. */
static void split(td_bodies *b, uint32_t first, uint32_t count, int axis)
{
    uint32_t *order = b->order + first;
    int64_t low = 0, high = (int64_t)count - 1;
    const int64_t wanted = count / 2;
    while (low < high) {
        const uint32_t pivot = order[(low + high) / 2];
        const double value = middle(b, pivot, axis);
        int64_t i = low, j = high;
        while (i <= j) {
            while (middle(b, order[i], axis) < value ||
                   (middle(b, order[i], axis) == value && order[i] < pivot))
                i++;
            while (middle(b, order[j], axis) > value ||
                   (middle(b, order[j], axis) == value && order[j] > pivot))
                j--;
            if (i > j) break;
            const uint32_t swap = order[i];
            order[i++] = order[j];
            order[j--] = swap;
        }
        if (wanted <= j)
            high = j;
        else if (wanted >= i)
            low = i;
        else
            return;
    }
}

static void make_node(td_bodies *b, uint32_t first, uint32_t count)
{
    const size_t self = b->node_count++;
    td_box_node *node = b->node + self;
    *node = (td_box_node){.low = {INFINITY, INFINITY, INFINITY}, .high = {-INFINITY, -INFINITY, -INFINITY}};
    for (uint32_t k = first; k < first + count; k++)
        for (int i = 0; i < 3; i++) {
            node->low[i] = fmin(node->low[i], b->body[b->order[k]].low[i]);
            node->high[i] = fmax(node->high[i], b->body[b->order[k]].high[i]);
        }
    if (count <= LEAF) {
        node->first = first;
        node->count = count;
        return;
    }
    int axis = 0;
    for (int i = 1; i < 3; i++)
        if (node->high[i] - node->low[i] > node->high[axis] - node->low[axis]) axis = i;
    split(b, first, count, axis);
    make_node(b, first, count / 2);
    node->second = (uint32_t)b->node_count;
    make_node(b, first + count / 2, count - count / 2);
}

td_status td_bodies_sort(td_bodies *bodies, td_error *error)
{
    free(bodies->order);
    free(bodies->node);
    bodies->order = NULL;
    bodies->node = NULL;
    bodies->node_count = 0;
    if (!bodies->count) return TD_OK;
    bodies->order = malloc(bodies->count * sizeof *bodies->order);
    bodies->node = malloc(2 * bodies->count * sizeof *bodies->node);
    if (!bodies->order || !bodies->node)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a tree of %zu bodies", bodies->count);
    for (size_t i = 0; i < bodies->count; i++) bodies->order[i] = (uint32_t)i;
    make_node(bodies, 0, (uint32_t)bodies->count);
    return TD_OK;
}

/* Distance at which a box is entered; INFINITY when it is missed in [0, end). Touching counts. */
static inline double enter_node(const td_box_node *node, const double o[3], const double d[3],
                                const double inverse[3], double end)
{
    double begin = 0, stop = end;
    for (int a = 0; a < 3; a++) {
        if (d[a] == 0) {
            if (o[a] < node->low[a] || o[a] > node->high[a]) return INFINITY;
            continue;
        }
        const double t0 = (node->low[a] - o[a]) * inverse[a], t1 = (node->high[a] - o[a]) * inverse[a];
        const double near = t0 < t1 ? t0 : t1, far = t0 < t1 ? t1 : t0;
        if (near > begin) begin = near;
        if (far < stop) stop = far;
    }
    /* A flat box is entered and left at once: room for rounding. */
    return begin <= stop * (1 + 1e-15) + 1e-12 ? begin : INFINITY;
}

/* A cone: its rays' mean direction, and the farthest ray from it with room for rounding. */
typedef struct cone {
    const double *origin;
    double axis[3], cosine, sine;
} cone;

static bool make_cone(cone *c, const double origin[3], const double (*ray)[3], int count)
{
    *c = (cone){.origin = origin, .cosine = 1};
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3 && ray[i][0] == ray[i][0]; k++) c->axis[k] += ray[i][k];
    const double length = sqrt(dot(c->axis, c->axis));
    if (!(length > 0)) return false;
    for (int k = 0; k < 3; k++) c->axis[k] /= length;
    for (int i = 0; i < count; i++) c->cosine = fmin(c->cosine, dot(c->axis, ray[i])); /* fmin skips NaN */
    c->cosine -= 1e-9;
    if (c->cosine < 0) return false;
    c->sine = sqrt(1 - c->cosine * c->cosine);
    return true;
}

/* The ball around the box: with b the angle under which it is seen, cos(angle to its middle) >= cos(cone +
 * b). */
static bool meets(const cone *c, const double low[3], const double high[3])
{
    double to[3], square = 0;
    for (int k = 0; k < 3; k++) {
        const double half = (high[k] - low[k]) / 2;
        to[k] = (low[k] + high[k]) / 2 - c->origin[k];
        square += half * half;
    }
    square *= 1 + 1e-9;
    const double distance = dot(to, to);
    return distance <= square ||
           dot(to, c->axis) >= c->cosine * sqrt(distance - square) - c->sine * sqrt(square);
}

void td_bodies_in_beam(td_beam *beam, const td_bodies *bodies, const double origin[3], const double (*ray)[3],
                       int count)
{
    cone c;
    uint32_t stack[STACK];
    int depth = 0;
    *beam = (td_beam){.many = !make_cone(&c, origin, ray, count)};
    if (bodies->node_count) stack[depth++] = 0;
    while (depth > 0 && !beam->many) {
        const uint32_t at = stack[--depth];
        const td_box_node *node = bodies->node + at;
        if (!meets(&c, node->low, node->high)) continue;
        for (uint32_t k = node->first; k < node->first + node->count; k++) {
            const uint32_t which = bodies->order[k];
            if (!meets(&c, bodies->body[which].low, bodies->body[which].high)) continue;
            beam->many = beam->count == TD_BEAM_BODIES;
            if (!beam->many) beam->body[beam->count++] = which;
        }
        if (node->count) continue;
        stack[depth++] = node->second;
        stack[depth++] = at + 1;
    }
}

double td_bodies_cast(const td_bodies *bodies, const td_beam *beam, const double origin[3],
                      const double ray[3], double end, uint32_t *index)
{
    if (!bodies->node_count) return end;
    if (beam && !beam->many) {
        for (int i = 0; i < beam->count; i++) {
            const double t = cross_body(bodies->body + beam->body[i], origin, ray);
            if (t >= 0 && t < end) end = t, *index = beam->body[i];
        }
        return end;
    }
    const double inverse[3] = {1 / ray[0], 1 / ray[1], 1 / ray[2]};
    uint32_t stack[STACK];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const uint32_t at = stack[--depth];
        const td_box_node *node = bodies->node + at;
        if (!(enter_node(node, origin, ray, inverse, end) < end)) continue;
        for (uint32_t k = node->first; k < node->first + node->count; k++) {
            const uint32_t which = bodies->order[k];
            const double t = cross_body(bodies->body + which, origin, ray);
            if (!(t >= 0 && t < end)) continue;
            end = t;
            *index = which;
        }
        if (node->count) continue;
        stack[depth++] = node->second;
        stack[depth++] = at + 1;
    }
    return end;
}
