#include <math.h>
#include <string.h>

#include "sim/clearance_internal.h"

clearance_shape clearance_place_shape(const td_primitive *primitive, int link, const td_pose *site_from_link)
{
    clearance_shape s = {.kind = primitive->kind, .link = link};
    const td_pose pose = td_pose_compose(site_from_link, &primitive->link_from_shape);
    const double *size = primitive->size;
    td_pose_rotation(s.r, &pose);
    memcpy(s.t, pose.t, sizeof s.t);
    memcpy(s.size, size, sizeof s.size);
    for (int a = 0; a < 3; a++) {
        double half = size[0];
        if (s.kind == TD_PRIMITIVE_CAPSULE) half += 0.5 * size[1] * fabs(s.r[3 * a + 2]);
        if (s.kind == TD_PRIMITIVE_BOX) {
            half = 0;
            for (int k = 0; k < 3; k++) half += 0.5 * size[k] * fabs(s.r[3 * a + k]);
        }
        s.low[a] = s.t[a] - half;
        s.high[a] = s.t[a] + half;
    }
    s.radius = size[0];
    if (s.kind == TD_PRIMITIVE_CAPSULE) s.radius += 0.5 * size[1];
    if (s.kind == TD_PRIMITIVE_BOX) {
        s.radius = 0.5 * sqrt(size[0] * size[0] + size[1] * size[1] + size[2] * size[2]);
        for (int k = 0; k < 3; k++) s.size[k] *= 0.5;
    }
    return s;
}

/* x in the shape's frame; `away` its distance from a core point or line, less the radius. */
static double round_distance(double g[3], const double x[3], double radius)
{
    const double length = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    for (int a = 0; a < 3; a++) g[a] = length > 0 ? x[a] / length : a == 2;
    return length - radius;
}

static double box_distance(double g[3], const double x[3], const double half[3])
{
    double beyond[3], square = 0, largest = -INFINITY;
    int face = 0;
    for (int a = 0; a < 3; a++) {
        beyond[a] = fabs(x[a]) - half[a];
        if (beyond[a] > largest) {
            largest = beyond[a];
            face = a;
        }
        if (beyond[a] > 0) square += beyond[a] * beyond[a];
    }
    if (largest <= 0) {
        for (int a = 0; a < 3; a++) g[a] = a == face ? copysign(1, x[a]) : 0;
        return largest;
    }
    const double length = sqrt(square);
    for (int a = 0; a < 3; a++) g[a] = beyond[a] > 0 ? copysign(beyond[a] / length, x[a]) : 0;
    return length;
}

double clearance_distance(double gradient[3], const clearance_shape *shape, const double p[3])
{
    const double *r = shape->r, d[3] = {p[0] - shape->t[0], p[1] - shape->t[1], p[2] - shape->t[2]};
    double x[3], g[3], distance;
    for (int a = 0; a < 3; a++) x[a] = r[a] * d[0] + r[3 + a] * d[1] + r[6 + a] * d[2];
    if (shape->kind == TD_PRIMITIVE_BOX) {
        distance = box_distance(g, x, shape->size);
    } else {
        const double half = shape->kind == TD_PRIMITIVE_CAPSULE ? 0.5 * shape->size[1] : 0;
        x[2] -= x[2] > half ? half : x[2] < -half ? -half : x[2];
        distance = round_distance(g, x, shape->size[0]);
    }
    for (int a = 0; a < 3; a++) gradient[a] = r[3 * a] * g[0] + r[3 * a + 1] * g[1] + r[3 * a + 2] * g[2];
    return distance;
}

static void to_site(double p[3], const clearance_shape *s, double x, double y, double z)
{
    for (int a = 0; a < 3; a++) p[a] = s->t[a] + s->r[3 * a] * x + s->r[3 * a + 1] * y + s->r[3 * a + 2] * z;
}

int clearance_lines(double line[CLEARANCE_LINES][2][3], double *round, const clearance_shape *s)
{
    *round = 0;
    if (s->kind != TD_PRIMITIVE_BOX) {
        const double half = s->kind == TD_PRIMITIVE_CAPSULE ? 0.5 * s->size[1] : 0;
        *round = s->size[0];
        to_site(line[0][0], s, 0, 0, -half);
        to_site(line[0][1], s, 0, 0, half);
        return 1;
    }
    for (int k = 0; k < CLEARANCE_LINES; k++) {
        const int along = k / 4, u = (along + 1) % 3, v = (along + 2) % 3;
        double x[3];
        x[u] = k & 1 ? s->size[u] : -s->size[u];
        x[v] = k & 2 ? s->size[v] : -s->size[v];
        for (int end = 0; end < 2; end++) {
            x[along] = end ? s->size[along] : -s->size[along];
            to_site(line[k][end], s, x[0], x[1], x[2]);
        }
    }
    return CLEARANCE_LINES;
}

/* ---- undersides ---- */

static double below_ball(const double centre[3], double radius, double x, double y)
{
    const double dx = x - centre[0], dy = y - centre[1], left = radius * radius - dx * dx - dy * dy;
    return left >= 0 ? centre[2] - sqrt(left) : INFINITY;
}

/* The line x + s d in the box's frame enters where it is within all three slabs. */
static double below_box(const clearance_shape *shape, double x, double y)
{
    const double *r = shape->r, dx = x - shape->t[0], dy = y - shape->t[1];
    double from = -INFINITY, to = INFINITY;
    for (int a = 0; a < 3; a++) {
        const double at = r[a] * dx + r[3 + a] * dy, d = r[6 + a], half = shape->size[a];
        if (fabs(d) < 1e-12) {
            if (fabs(at) > half) return INFINITY;
            continue;
        }
        const double one = (-half - at) / d, other = (half - at) / d;
        from = fmax(from, fmin(one, other));
        to = fmin(to, fmax(one, other));
    }
    return from <= to ? shape->t[2] + from : INFINITY;
}

/* A cylinder of axis k between the balls at its ends: |x + s z - ((x + s z) k) k| = radius. */
static double below_capsule(const clearance_shape *shape, double x, double y)
{
    const double k[3] = {shape->r[2], shape->r[5], shape->r[8]}, half = 0.5 * shape->size[1];
    const double dx = x - shape->t[0], dy = y - shape->t[1], along = dx * k[0] + dy * k[1];
    double low = INFINITY;
    for (int end = -1; end <= 1; end += 2) {
        const double centre[3] = {shape->t[0] + end * half * k[0], shape->t[1] + end * half * k[1],
                                  shape->t[2] + end * half * k[2]};
        low = fmin(low, below_ball(centre, shape->size[0], x, y));
    }
    const double a = 1 - k[2] * k[2], b = -along * k[2];
    const double c = dx * dx + dy * dy - along * along - shape->size[0] * shape->size[0];
    const double discriminant = b * b - a * c;
    if (a < 1e-12 || discriminant < 0) return low;
    const double s = (-b - sqrt(discriminant)) / a;
    return fabs(along + s * k[2]) <= half ? fmin(low, shape->t[2] + s) : low;
}

double clearance_underside(const clearance_shape *shape, double x, double y)
{
    if (shape->kind == TD_PRIMITIVE_BOX) return below_box(shape, x, y);
    if (shape->kind == TD_PRIMITIVE_CAPSULE) return below_capsule(shape, x, y);
    return below_ball(shape->t, shape->size[0], x, y);
}
