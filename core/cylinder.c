/* How long a hydraulic cylinder is at a joint's angle, and back, in the plane across the joint's axis. There
 * the joint is the origin, points of the parent stand still and points of the child turn about it. */
#include <math.h>
#include <stdio.h>

#include "core/robot_internal.h"

/* Points may be this far from one plane, m: a cosine error of 1e-7 at worst. */
static const double PLANE_TOLERANCE = 1e-3;
/* By how much the lengths at the joint's limits may miss the stroke, m. */
static const double STROKE_TOLERANCE = 1e-3;
static const double PI = 3.14159265358979323846;

typedef struct point {
    double x, y;
} point;

/* The plane: two unit vectors with u x v = the axis, in the frame of the child at angle 0. */
typedef struct plane {
    double u[3], v[3], axis[3];
    td_pose zero_from_parent;
} plane;

static point minus(point a, point b)
{
    return (point){a.x - b.x, a.y - b.y};
}

static double dot(point a, point b)
{
    return a.x * b.x + a.y * b.y;
}

static double cross(point a, point b)
{
    return a.x * b.y - a.y * b.x;
}

/* A quarter turn on: d/dangle of a point that turns about the origin. */
static point quarter(point a)
{
    return (point){-a.y, a.x};
}

static point turned(point a, double angle)
{
    const double c = cos(angle), s = sin(angle);
    return (point){c * a.x - s * a.y, s * a.x + c * a.y};
}

static double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static plane plane_of(const td_robot *robot, const td_cylinder *cylinder)
{
    plane p;
    const td_robot_joint *joint = robot->joint + cylinder->joint;
    const double *a = joint->axis;
    p.zero_from_parent = td_pose_inverse(&robot->link[joint->link].parent_from_link);
    int least = 0;
    for (int i = 0; i < 3; i++) {
        p.axis[i] = a[i];
        if (fabs(a[i]) < fabs(a[least])) least = i;
    }
    double length = 0;
    for (int i = 0; i < 3; i++) p.u[i] = (i == least) - a[least] * a[i];
    length = sqrt(dot3(p.u, p.u));
    for (int i = 0; i < 3; i++) p.u[i] /= length;
    for (int i = 0; i < 3; i++)
        p.v[i] = a[(i + 1) % 3] * p.u[(i + 2) % 3] - a[(i + 2) % 3] * p.u[(i + 1) % 3];
    return p;
}

static point of_child(const plane *p, const double at[3])
{
    return (point){dot3(p->u, at), dot3(p->v, at)};
}

static point of_parent(const plane *p, const double at[3])
{
    double moved[3];
    td_pose_transform(moved, &p->zero_from_parent, at);
    return of_child(p, moved);
}

/* Where two circles meet: [0] to the left of the way from a to b. */
static bool meet(point at[2], point a, double radius_a, point b, double radius_b)
{
    const point way = minus(b, a);
    const double d = sqrt(dot(way, way));
    if (!(d > 0)) return false;
    const double along = (d + (radius_a - radius_b) * (radius_a + radius_b) / d) / 2;
    const double square = (radius_a - along) * (radius_a + along);
    if (!(square >= -1e-14 * radius_a * radius_a)) return false;
    const double side = square > 0 ? sqrt(square) : 0;
    const point foot = {a.x + along * way.x / d, a.y + along * way.y / d};
    at[0] = (point){foot.x - side * way.y / d, foot.y + side * way.x / d};
    at[1] = (point){foot.x + side * way.y / d, foot.y - side * way.x / d};
    return true;
}

/* The rod eye of a four-bar and its derivative by the angle. The bar from p turns the eye by some rate s
 * about p, and the bar to c keeps its length: (e - c) . (e' - c') = 0 with e' = s quarter(e - p). */
static bool four_bar_eye(point *eye, point *rate, const td_cylinder *cylinder, const plane *flat,
                         double angle)
{
    const point p = of_parent(flat, cylinder->parent_pivot);
    const point c = turned(of_child(flat, cylinder->child_pivot), angle);
    point both[2];
    if (!meet(both, p, cylinder->parent_bar_m, c, cylinder->child_bar_m)) return false;
    *eye = both[cylinder->branch > 0 ? 0 : 1];
    const point bar = minus(*eye, c), turn = quarter(minus(*eye, p));
    const double held = dot(bar, turn);
    if (!(fabs(held) > 1e-12 * cylinder->parent_bar_m * cylinder->child_bar_m)) return false;
    const double s = dot(bar, quarter(c)) / held;
    *rate = (point){s * turn.x, s * turn.y};
    return true;
}

static bool length_in(double *length, double *lever, const plane *flat, const td_cylinder *cylinder,
                      double angle)
{
    point eye, rate;
    if (cylinder->four_bar) {
        if (!four_bar_eye(&eye, &rate, cylinder, flat, angle)) return false;
    } else {
        eye = turned(of_child(flat, cylinder->eye), angle);
        rate = quarter(eye);
    }
    const point rod = minus(eye, of_parent(flat, cylinder->root));
    *length = sqrt(dot(rod, rod));
    if (!(*length > 0)) return false;
    *lever = dot(rod, rate) / *length;
    return true;
}

bool td_cylinder_length(double *length_m, double *lever_m, const td_robot *robot, const td_cylinder *cylinder,
                        double angle)
{
    const plane p = plane_of(robot, cylinder);
    double length = 0, lever = 0;
    if (!length_in(&length, &lever, &p, cylinder, angle)) return false;
    if (length_m) *length_m = length;
    if (lever_m) *lever_m = lever;
    return true;
}

/* Points of the child that the joint turns, where they are when the cylinder is so long: the eye itself, or
 * the child's pivot for each place of the eye. */
static int turned_points(point at[4], const plane *flat, const td_cylinder *cylinder, double length)
{
    const point origin = {0, 0}, root = of_parent(flat, cylinder->root);
    const double *held = cylinder->four_bar ? cylinder->child_pivot : cylinder->eye;
    const point child = of_child(flat, held);
    const double radius = sqrt(dot(child, child));
    if (!cylinder->four_bar) return meet(at, origin, radius, root, length) ? 2 : 0;
    point eye[2];
    int count = 0;
    if (!meet(eye, of_parent(flat, cylinder->parent_pivot), cylinder->parent_bar_m, root, length)) return 0;
    for (int i = 0; i < 2; i++)
        if (meet(at + count, origin, radius, eye[i], cylinder->child_bar_m)) count += 2;
    return count;
}

bool td_cylinder_angle(double *angle, const td_robot *robot, const td_cylinder *cylinder, double length_m)
{
    static const double slack = 1e-9; /* rad: what rounding takes at the limits */
    const plane p = plane_of(robot, cylinder);
    const td_robot_joint *joint = robot->joint + cylinder->joint;
    const point child = of_child(&p, cylinder->four_bar ? cylinder->child_pivot : cylinder->eye);
    const double middle = (joint->lower + joint->upper) / 2;
    point at[4];
    const int count = turned_points(at, &p, cylinder, length_m);
    double best = 1e-7 * length_m;
    bool found = false;
    for (int i = 0; i < count; i++) {
        double q = atan2(cross(child, at[i]), dot(child, at[i])), length = 0, lever = 0;
        q -= 2 * PI * round((q - middle) / (2 * PI));
        if (q < joint->lower - slack || q > joint->upper + slack) continue;
        q = fmin(fmax(q, joint->lower), joint->upper);
        /* The other branch of a four-bar has another length at this angle. */
        if (!length_in(&length, &lever, &p, cylinder, q) || !(fabs(length - length_m) < best)) continue;
        best = fabs(length - length_m);
        *angle = q;
        found = true;
    }
    return found;
}

double td_cylinder_area(const td_cylinder *cylinder, bool grows)
{
    const double bore = cylinder->bore_m * cylinder->bore_m, rod = cylinder->rod_m * cylinder->rod_m;
    return cylinder->count * PI / 4 * (grows ? bore : bore - rod);
}

bool td_cylinder_flow(double *flow_m3_s, const td_robot *robot, const td_cylinder *cylinder, double angle,
                      double rate)
{
    double lever = 0;
    if (!td_cylinder_length(NULL, &lever, robot, cylinder, angle)) return false;
    *flow_m3_s = lever * rate * td_cylinder_area(cylinder, lever * rate > 0);
    return true;
}

double td_robot_pump(const td_robot *robot)
{
    double pump = robot->cylinder_count ? 0 : INFINITY;
    for (int i = 0; i < robot->cylinder_count; i++) pump = fmax(pump, robot->cylinder[i].flow_m3_s);
    return pump;
}

/* ---- checks ---- */

static bool leaves_plane(const td_robot *robot, const td_cylinder *cylinder)
{
    const plane p = plane_of(robot, cylinder);
    double root[3], pivot[3];
    td_pose_transform(root, &p.zero_from_parent, cylinder->root);
    td_pose_transform(pivot, &p.zero_from_parent, cylinder->parent_pivot);
    const double level = dot3(p.axis, root);
    if (!cylinder->four_bar) return fabs(dot3(p.axis, cylinder->eye) - level) > PLANE_TOLERANCE;
    return fabs(dot3(p.axis, pivot) - level) > PLANE_TOLERANCE ||
           fabs(dot3(p.axis, cylinder->child_pivot) - level) > PLANE_TOLERANCE;
}

/* Over the joint's whole range the bars must close and the cylinder turn the joint one way. */
static bool stalls(char why[TD_CYLINDER_WHY], const td_robot *robot, const td_cylinder *cylinder)
{
    enum { STEPS = 720 };
    const td_robot_joint *joint = robot->joint + cylinder->joint;
    const plane p = plane_of(robot, cylinder);
    double first = 0, least = INFINITY, most = 0;
    for (int i = 0; i <= STEPS; i++) {
        const double q = joint->lower + (joint->upper - joint->lower) * i / STEPS;
        double length = 0, lever = 0;
        if (!length_in(&length, &lever, &p, cylinder, q)) {
            snprintf(why, TD_CYLINDER_WHY, "its bars do not reach one another at %.3f rad of joint '%s'", q,
                     joint->name);
            return true;
        }
        if (i == 0) first = lever;
        if (!(lever * first > 0)) {
            snprintf(why, TD_CYLINDER_WHY, "it passes a dead centre at %.3f rad of joint '%s'", q,
                     joint->name);
            return true;
        }
        least = fmin(least, length);
        most = fmax(most, length);
    }
    if (least >= cylinder->shortest_m - STROKE_TOLERANCE && most <= cylinder->longest_m + STROKE_TOLERANCE)
        return false;
    snprintf(why, TD_CYLINDER_WHY,
             "the limits of joint '%s' need lengths from %.3f to %.3f m, its stroke is from %.3f to %.3f m",
             joint->name, least, most, cylinder->shortest_m, cylinder->longest_m);
    return true;
}

bool td_cylinder_is_wrong(char why[TD_CYLINDER_WHY], const td_robot *robot, const td_cylinder *cylinder)
{
    const td_robot_joint *joint = robot->joint + cylinder->joint;
    if (joint->kind != TD_JOINT_REVOLUTE) {
        snprintf(why, TD_CYLINDER_WHY, "joint '%s' is not revolute, so no cylinder can drive it",
                 joint->name);
        return true;
    }
    if (leaves_plane(robot, cylinder)) {
        snprintf(why, TD_CYLINDER_WHY,
                 "its points do not lie in one plane across the axis of joint '%s' (within 1 mm)",
                 joint->name);
        return true;
    }
    return stalls(why, robot, cylinder);
}
