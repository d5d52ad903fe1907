/* How far each link may be from where the joint angles say, and whether a point lies in the grown robot.
 *
 * A joint off by e moves a point p of a link by (tau + omega x p) e, a column of the link's Jacobian. All
 * joints may be off at once and the same way, so the lengths add up. When the rig is carried by a link, only
 * what moves the point against that link counts: the difference of both Jacobians. The rig's pose moves the
 * point, as the rig sees it, by [-[p]x, I] xi: the root of that covariance's largest eigenvalue. The
 * displacement is linear in p and a norm is convex, so the corners of a box around a primitive have the
 * largest. */
#include "recon/own_body.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "core/parallel.h"
#include "recon/depth_points_internal.h"
#include "recon/own_body_internal.h"

td_own_body_options td_own_body_options_default(void)
{
    return (td_own_body_options){.margin_m = 0.05, .times_sigma = 3, .mount = -1};
}

td_status td_own_body_options_check(const td_own_body_options *o, const td_robot *robot, td_error *error)
{
    if (!(o->margin_m >= 0 && isfinite(o->margin_m)))
        return td_fail(error, TD_ERROR_ARGUMENT, "margin_m: must be 0 or more, not %g", o->margin_m);
    if (!(o->times_sigma >= 0 && isfinite(o->times_sigma)))
        return td_fail(error, TD_ERROR_ARGUMENT, "times_sigma: must be 0 or more, not %g", o->times_sigma);
    if (o->mount < -1 || o->mount >= robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "mount: the robot has %d links, none is %d",
                       robot->link_count, o->mount);
    for (int i = 0; o->sigma_q && i < robot->joint_count; i++)
        if (!(o->sigma_q[i] >= 0 && isfinite(o->sigma_q[i])))
            return td_fail(error, TD_ERROR_ARGUMENT, "sigma_q: joint '%s' has %g", robot->joint[i].name,
                           o->sigma_q[i]);
    for (int i = 0; o->pose_covariance && i < 36; i++)
        if (!isfinite(o->pose_covariance[i]))
            return td_fail(error, TD_ERROR_ARGUMENT, "pose_covariance: element %d is %g", i,
                           o->pose_covariance[i]);
    return TD_OK;
}

td_status td_own_body_check(const td_robot *robot, const double *q, const td_own_body_options *options,
                            td_error *error)
{
    TD_TRY(td_own_body_options_check(options, robot, error));
    for (int i = 0; i < robot->joint_count; i++)
        if (!isfinite(q[i]))
            return td_fail(error, TD_ERROR_DATA, "joint '%s' is at %g: without it the arm cannot be masked",
                           robot->joint[i].name, q[i]);
    return TD_OK;
}

/* The link that everything fixed to `link` hangs on. */
static int rigid_root(const td_robot *robot, int link)
{
    while (link >= 0 && robot->link[link].joint < 0 && robot->link[link].parent >= 0)
        link = robot->link[link].parent;
    return link;
}

/* Corners of a box around the primitive, root's frame. */
static void corners_of(double corner[8][3], const td_primitive *shape, const td_pose *root_from_link)
{
    const double radius = shape->size[0];
    double half[3] = {radius, radius, radius};
    for (int i = 0; i < 3 && shape->kind == TD_PRIMITIVE_BOX; i++) half[i] = shape->size[i] / 2;
    if (shape->kind == TD_PRIMITIVE_CAPSULE) half[2] += shape->size[1] / 2;
    const td_pose root_from_shape = td_pose_compose(root_from_link, &shape->link_from_shape);
    for (int k = 0; k < 8; k++) {
        const double p[3] = {k & 1 ? half[0] : -half[0], k & 2 ? half[1] : -half[1],
                             k & 4 ? half[2] : -half[2]};
        td_pose_transform(corner[k], &root_from_shape, p);
    }
}

/* How far the joints move the point against the mount; `by` (6, joints) is the difference of the Jacobians.
 */
static double by_joints(const double *by, size_t joints, const double *sigma, const double p[3])
{
    double sum = 0;
    for (size_t j = 0; sigma && j < joints; j++) {
        const double w[3] = {by[j], by[joints + j], by[2 * joints + j]};
        const double moved[3] = {by[3 * joints + j] + w[1] * p[2] - w[2] * p[1],
                                 by[4 * joints + j] + w[2] * p[0] - w[0] * p[2],
                                 by[5 * joints + j] + w[0] * p[1] - w[1] * p[0]};
        sum += sigma[j] * sqrt(moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2]);
    }
    return sum;
}

static double by_pose(const double *covariance, const double p[3])
{
    double j[18], s[9], value[3];
    if (!covariance) return 0;
    td_pose_transform_jacobian(j, p);
    if (td_sandwich(s, j, covariance, 3, 6, NULL) != TD_OK ||
        td_eigen_symmetric(value, NULL, s, 3, NULL) != TD_OK)
        return 0;
    return sqrt(fmax(value[2], 0));
}

void td_own_motion_begin(td_own_motion *m, const td_robot *robot, const double *q,
                         const td_own_body_options *options)
{
    m->robot = robot;
    m->options = options;
    m->carrier = rigid_root(robot, options->mount);
    td_robot_forward(m->root_from_link, robot, q);
    memset(m->mount, 0, sizeof m->mount);
    if (options->mount >= 0) td_robot_jacobian(m->mount, robot, m->root_from_link, options->mount);
}

bool td_own_motion_looked_for(const td_own_motion *m, int link)
{
    return m->carrier < 0 || rigid_root(m->robot, link) != m->carrier;
}

double td_own_motion_growth(const td_own_motion *m, int link, const td_primitive *shape)
{
    const td_own_body_options *o = m->options;
    const size_t joints = (size_t)m->robot->joint_count;
    double by[6 * TD_ROBOT_MAX_JOINTS], corner[8][3], most = 0;
    td_robot_jacobian(by, m->robot, m->root_from_link, link);
    for (size_t k = 0; k < 6 * joints; k++) by[k] -= m->mount[k];
    corners_of(corner, shape, &m->root_from_link[link]);
    for (int c = 0; c < 8; c++)
        most =
            fmax(most, by_joints(by, joints, o->sigma_q, corner[c]) + by_pose(o->pose_covariance, corner[c]));
    return o->margin_m + o->times_sigma * most;
}

void td_own_body_growth(double *grown_m, const td_robot *robot, const double *q,
                        const td_own_body_options *options)
{
    const td_own_body_options standard = td_own_body_options_default();
    td_own_motion motion;
    td_own_motion_begin(&motion, robot, q, options ? options : &standard);
    for (int i = 0; i < robot->link_count; i++) {
        grown_m[i] = td_own_motion_looked_for(&motion, i) ? motion.options->margin_m : (double)NAN;
        if (isnan(grown_m[i])) continue;
        for (int k = 0; k < robot->link[i].shape_count; k++)
            grown_m[i] = fmax(grown_m[i], td_own_motion_growth(&motion, i, &robot->link[i].shape[k]));
    }
}

/* ---- points ---- */

/* Distance of a point, in the primitive's frame, from the primitive; 0 or less inside. */
static double distance(const td_primitive *shape, const double p[3])
{
    double square = 0;
    if (shape->kind == TD_PRIMITIVE_BOX) {
        for (int i = 0; i < 3; i++) {
            const double out = fmax(fabs(p[i]) - shape->size[i] / 2, 0);
            square += out * out;
        }
        return sqrt(square);
    }
    const double end = shape->kind == TD_PRIMITIVE_CAPSULE ? shape->size[1] / 2 : 0;
    const double along = fmax(fabs(p[2]) - end, 0);
    return sqrt(p[0] * p[0] + p[1] * p[1] + along * along) - shape->size[0];
}

/* A grown primitive, ready for many points. */
typedef struct body {
    td_primitive shape;
    td_pose shape_from_vehicle;
    double grown_m, centre[3], reach; /* a ball that holds it, grown */
} body;

static body body_of(const td_primitive *shape, const td_pose *vehicle_from_link, double grown_m)
{
    const td_pose vehicle_from_shape = td_pose_compose(vehicle_from_link, &shape->link_from_shape);
    const double *size = shape->size;
    body b = {
        .shape = *shape, .shape_from_vehicle = td_pose_inverse(&vehicle_from_shape), .grown_m = grown_m};
    memcpy(b.centre, vehicle_from_shape.t, sizeof b.centre);
    b.reach = grown_m;
    if (shape->kind == TD_PRIMITIVE_BOX)
        b.reach += sqrt(size[0] * size[0] + size[1] * size[1] + size[2] * size[2]) / 2;
    else
        b.reach += size[0] + (shape->kind == TD_PRIMITIVE_CAPSULE ? size[1] / 2 : 0);
    return b;
}

static bool holds(const body *b, const double p[3])
{
    const double off[3] = {p[0] - b->centre[0], p[1] - b->centre[1], p[2] - b->centre[2]};
    if (off[0] * off[0] + off[1] * off[1] + off[2] * off[2] > b->reach * b->reach) return false;
    double in_shape[3];
    td_pose_transform(in_shape, &b->shape_from_vehicle, p);
    return distance(&b->shape, in_shape) <= b->grown_m;
}

bool td_own_body_holds(const double p[3], const td_robot *robot, const td_pose *vehicle_from_link,
                       const double *grown_m)
{
    for (int i = 0; i < robot->link_count; i++)
        for (int k = 0; !isnan(grown_m[i]) && k < robot->link[i].shape_count; k++) {
            const body b = body_of(&robot->link[i].shape[k], &vehicle_from_link[i], grown_m[i]);
            if (holds(&b, p)) return true;
        }
    return false;
}

typedef struct removal {
    td_disparity *disparity;
    const td_depth_camera *camera;
    td_pose vehicle_from_rectified;
    body *body;
    size_t bodies;
    size_t *removed; /* (rows) */
} removal;

static void remove_row(size_t row, void *user)
{
    const removal *r = user;
    const td_depth_camera *c = r->camera;
    td_disparity *d = r->disparity;
    for (int column = 0; column < d->width; column++) {
        const size_t i = row * (size_t)d->width + (size_t)column;
        if (!(d->value[i] > 0)) continue;
        const double depth = c->base_px_m / (double)d->value[i];
        double p[3] = {(column - c->cx) / c->f * depth, ((double)row - c->cy) / c->f * depth, depth};
        td_pose_transform(p, &r->vehicle_from_rectified, p);
        bool inside = false;
        for (size_t k = 0; !inside && k < r->bodies; k++) inside = holds(&r->body[k], p);
        if (!inside) continue;
        d->value[i] = d->sigma[i] = NAN;
        d->kind[i] = TD_DENSE_NONE;
        r->removed[row]++;
    }
}

/* All that is looked for. */
static size_t gather(body *list, const td_robot *robot, const double *q, const td_own_body_options *options)
{
    td_pose vehicle_from_link[TD_ROBOT_MAX_LINKS];
    double grown[TD_ROBOT_MAX_LINKS];
    size_t count = 0;
    td_robot_forward(vehicle_from_link, robot, q);
    td_own_body_growth(grown, robot, q, options);
    for (int i = 0; i < robot->link_count; i++)
        for (int k = 0; !isnan(grown[i]) && k < robot->link[i].shape_count; k++)
            list[count++] = body_of(&robot->link[i].shape[k], &vehicle_from_link[i], grown[i]);
    return count;
}

td_status td_own_body_remove(td_disparity *disparity, size_t *removed, const td_depth_camera *camera,
                             const td_pose *vehicle_from_rig, const td_robot *robot, const double *q,
                             const td_own_body_options *options, int threads, td_error *error)
{
    const td_own_body_options standard = td_own_body_options_default();
    if (!options) options = &standard;
    TD_TRY(td_own_body_check(robot, q, options, error));
    const td_camera *image = &td_depth_camera_rectification(camera)->camera;
    if (disparity->width != image->width || disparity->height != image->height)
        return td_fail(error, TD_ERROR_ARGUMENT, "the disparities are %dx%d px, the camera's are %dx%d",
                       disparity->width, disparity->height, image->width, image->height);
    size_t *rows = calloc((size_t)disparity->height, sizeof *rows), sum = 0;
    body *list = malloc((size_t)robot->link_count * TD_ROBOT_MAX_SHAPES * sizeof *list);
    td_status status = TD_ERROR_MEMORY;
    if (rows && list) {
        removal r = {.disparity = disparity, .camera = camera, .body = list, .removed = rows};
        r.vehicle_from_rectified = td_pose_compose(vehicle_from_rig, &camera->rig_from_rectified);
        r.bodies = gather(list, robot, q, options);
        status = td_parallel_for((size_t)disparity->height, threads, remove_row, &r, NULL, NULL);
        for (int i = 0; i < disparity->height; i++) sum += rows[i];
    }
    if (removed) *removed = sum;
    free(rows);
    free(list);
    return status == TD_ERROR_MEMORY ? td_fail(error, status, "no memory to look for the arm's points")
                                     : status;
}
