#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"
#include "sim/clearance_internal.h"

static void cross(double c[3], const double a[3], const double b[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static double square_of(const double a[3])
{
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
}

double clearance_time(const clearance_path *path, clearance_state state)
{
    const double *time = path->motion->time_s + state.knot;
    return state.part > 0 ? (1 - state.part) * time[0] + state.part * time[1] : time[0];
}

static void joints_at(double *q, const td_clearance_motion *motion, clearance_state state)
{
    const int joints = motion->robot->joint_count;
    const double *low = motion->q + (size_t)state.knot * (size_t)joints;
    for (int j = 0; j < joints; j++)
        q[j] = state.part > 0 ? (1 - state.part) * low[j] + state.part * low[joints + j] : low[j];
}

void clearance_links(td_pose *site_from_link, const clearance_path *path, clearance_state state)
{
    const td_robot *robot = path->motion->robot;
    double q[TD_ROBOT_MAX_JOINTS];
    joints_at(q, path->motion, state);
    td_robot_forward(site_from_link, robot, q);
    for (int k = 0; k < robot->link_count; k++)
        site_from_link[k] = td_pose_compose(&path->motion->site_from_vehicle, site_from_link + k);
}

clearance_shape clearance_shape_of(const clearance_path *path, int shape, const td_pose *site_from_link)
{
    const int link = path->link[shape];
    return clearance_place_shape(path->motion->robot->link[link].shape + path->number[shape], link,
                                 site_from_link + link);
}

bool clearance_is_allowed(const clearance_path *path, int link, double time_s)
{
    for (size_t k = 0; k < path->motion->allowed_count; k++) {
        const td_clearance_allowed *allowed = path->motion->allowed + k;
        if (allowed->link == link && time_s >= allowed->from_s && time_s <= allowed->to_s) return true;
    }
    return false;
}

static bool turns(const td_robot_joint *joint)
{
    return joint->kind != TD_JOINT_PRISMATIC;
}

void clearance_joint_rates(double *rate, const td_robot *robot, const td_pose *site_from_link, int link,
                           const double p[3], const double n[3])
{
    memset(rate, 0, (size_t)robot->joint_count * sizeof *rate);
    for (; link >= 0; link = robot->link[link].parent) {
        const int joint = robot->link[link].joint;
        double axis[3], arm[3], v[3];
        if (joint < 0) continue;
        td_pose_rotate(axis, site_from_link + link, robot->joint[joint].axis);
        for (int a = 0; a < 3; a++) arm[a] = p[a] - site_from_link[link].t[a];
        cross(v, axis, arm);
        const double *velocity = turns(robot->joint + joint) ? v : axis;
        rate[joint] = n[0] * velocity[0] + n[1] * velocity[1] + n[2] * velocity[2];
    }
}

static double joint_variance(const td_clearance_motion *m, int joint)
{
    const double zero = m->sigma_zero ? m->sigma_zero[joint] : 0;
    const double reading = m->sigma_reading ? m->sigma_reading[joint] : 0;
    return zero * zero + reading * reading;
}

static void add_square(double c[9], const double v[3], double weight)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c[3 * i + j] += weight * v[i] * v[j];
}

/* Not less than the largest eigenvalue of a covariance: Frobenius' norm of it squared, which squares what the
 * smaller ones add. */
static double largest_variance(const double c[9])
{
    double two[9] = {0}, square = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) two[3 * i + j] += c[3 * i + k] * c[3 * k + j];
    for (int i = 0; i < 9; i++) square += two[i] * two[i];
    return sqrt(sqrt(square));
}

double clearance_motion_sigma(const clearance_path *path, const clearance_shape *shape,
                              const td_pose *site_from_link)
{
    const td_robot *robot = path->motion->robot;
    double turn[9] = {0}, shift[9] = {0};
    for (int k = 0; k < 6; k++) {
        double omega[3], v[3];
        for (int a = 0; a < 3; a++) omega[a] = path->common[6 * a + k];
        cross(v, omega, shape->t);
        for (int a = 0; a < 3; a++) v[a] += path->common[6 * (a + 3) + k];
        add_square(turn, omega, 1);
        add_square(shift, v, 1);
    }
    for (int link = shape->link; link >= 0; link = robot->link[link].parent) {
        const int joint = robot->link[link].joint;
        double axis[3], arm[3], v[3];
        if (joint < 0) continue;
        const double variance = joint_variance(path->motion, joint);
        td_pose_rotate(axis, site_from_link + link, robot->joint[joint].axis);
        for (int a = 0; a < 3; a++) arm[a] = shape->t[a] - site_from_link[link].t[a];
        cross(v, axis, arm);
        add_square(shift, turns(robot->joint + joint) ? v : axis, variance);
        if (turns(robot->joint + joint)) add_square(turn, axis, variance);
    }
    return sqrt(largest_variance(shift)) + shape->radius * sqrt(largest_variance(turn));
}

/* ---- refinement ---- */

/* How far a point of the shapes moves at most from one reading to the next, from the arms of the joints at
 * the first of them. */
static double farthest_move(const clearance_path *path, const td_pose *site_from_link, const double *dq)
{
    const td_robot *robot = path->motion->robot;
    double farthest = 0;
    for (int s = 0; s < path->shape_count; s++) {
        const clearance_shape shape = clearance_shape_of(path, s, site_from_link);
        double moved = 0;
        for (int link = shape.link; link >= 0; link = robot->link[link].parent) {
            const int joint = robot->link[link].joint;
            double arm[3];
            if (joint < 0 || dq[joint] == 0) continue;
            for (int a = 0; a < 3; a++) arm[a] = shape.t[a] - site_from_link[link].t[a];
            const double lever = turns(robot->joint + joint) ? sqrt(square_of(arm)) + shape.radius : 1;
            moved += fabs(dq[joint]) * lever;
        }
        farthest = fmax(farthest, moved);
    }
    return farthest;
}

static size_t pieces_between(const clearance_path *path, uint32_t knot, double step_m)
{
    const int joints = path->motion->robot->joint_count;
    const double *q = path->motion->q + (size_t)knot * (size_t)joints;
    double dq[TD_ROBOT_MAX_JOINTS], most = 0, moved = 0;
    td_pose site_from_link[TD_ROBOT_MAX_LINKS];
    for (int j = 0; j < joints; j++) {
        dq[j] = q[joints + j] - q[j];
        most = fmax(most, fabs(dq[j]));
    }
    /* Arms change along a long way: they are looked at every 0.1 rad. */
    const int looks = most < 6.4 ? 1 + (int)(most / 0.1) : 64;
    for (int k = 0; k < looks; k++) {
        clearance_links(site_from_link, path, (clearance_state){knot, (double)k / looks});
        moved = fmax(moved, farthest_move(path, site_from_link, dq));
    }
    const double pieces = ceil(moved / step_m);
    return pieces >= 1e8 ? 100000000 : pieces > 1 ? (size_t)pieces : 1;
}

static td_status refine(clearance_path *path, double step_m, td_error *error)
{
    enum { MOST = 10000000 };
    const size_t knots = path->motion->count;
    size_t capacity = 2 * knots + 16;
    path->state = malloc(capacity * sizeof *path->state);
    for (uint32_t knot = 0; knot < knots; knot++) {
        const size_t pieces = knot + 1 < knots ? pieces_between(path, knot, step_m) : 1;
        if (path->count + pieces > MOST)
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "the motion needs more than %d samples with steps of %g m; take a larger step_m or "
                "check it in parts",
                MOST, step_m);
        if (path->state && path->count + pieces > capacity) {
            capacity = 2 * (path->count + pieces);
            clearance_state *larger = realloc(path->state, capacity * sizeof *larger);
            if (!larger) free(path->state);
            path->state = larger;
        }
        if (!path->state) return td_fail(error, TD_ERROR_MEMORY, "no memory for the samples of the motion");
        for (size_t k = 0; k < pieces; k++)
            path->state[path->count++] = (clearance_state){knot, (double)k / (double)pieces};
    }
    return TD_OK;
}

/* ---- what is given ---- */

static bool is_moved(const td_robot *robot, int link)
{
    for (; link >= 0; link = robot->link[link].parent)
        if (robot->link[link].joint >= 0) return true;
    return false;
}

static td_status list_shapes(clearance_path *path, td_error *error)
{
    const td_robot *robot = path->motion->robot;
    path->link = malloc((size_t)robot->link_count * TD_ROBOT_MAX_SHAPES * sizeof *path->link);
    path->number = malloc((size_t)robot->link_count * TD_ROBOT_MAX_SHAPES * sizeof *path->number);
    if (!path->link || !path->number)
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the shapes of robot '%s'", robot->name);
    for (int link = 0; link < robot->link_count; link++)
        for (int k = 0; k < robot->link[link].shape_count && is_moved(robot, link); k++) {
            path->link[path->shape_count] = link;
            path->number[path->shape_count++] = k;
        }
    if (path->shape_count == 0)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "robot '%s' has no collision shape that a joint moves; give its links boxes, cylinders or "
            "spheres",
            robot->name);
    return TD_OK;
}

static td_status check_motion(const td_clearance_motion *m, td_error *error)
{
    const int joints = m->robot->joint_count;
    if (m->count < 1 || m->count > 10000000)
        return td_fail(error, TD_ERROR_ARGUMENT, "the motion has %zu samples; it must have 1 to 10000000",
                       m->count);
    for (size_t i = 0; i < m->count; i++) {
        if (!isfinite(m->time_s[i]) || (i && !(m->time_s[i] > m->time_s[i - 1])))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "sample %zu of the motion is at %g s: times must be finite and ascend", i + 1,
                           m->time_s[i]);
        for (int j = 0; j < joints; j++)
            if (!isfinite(m->q[i * (size_t)joints + (size_t)j]))
                return td_fail(error, TD_ERROR_ARGUMENT,
                               "joint '%s' of sample %zu of the motion (%g s) is no number",
                               m->robot->joint[j].name, i + 1, m->time_s[i]);
    }
    for (int j = 0; j < joints; j++)
        if (!(joint_variance(m, j) >= 0) || !isfinite(joint_variance(m, j)))
            return td_fail(error, TD_ERROR_ARGUMENT, "the sigma of joint '%s' is no number",
                           m->robot->joint[j].name);
    for (size_t k = 0; k < m->allowed_count; k++)
        if (m->allowed[k].link < 0 || m->allowed[k].link >= m->robot->link_count ||
            !(m->allowed[k].from_s <= m->allowed[k].to_s))
            return td_fail(
                error, TD_ERROR_ARGUMENT,
                "allowed contact %zu: link %d from %g to %g s is none of the robot's links, or ends "
                "before it begins",
                k + 1, m->allowed[k].link, m->allowed[k].from_s, m->allowed[k].to_s);
    return TD_OK;
}

/* The root V diag(sqrt(lambda)) of the covariances' sum: errors of map and vehicle act as their difference.
 */
static td_status common_root(clearance_path *path, td_error *error)
{
    const double *given[2] = {path->motion->vehicle_covariance, path->motion->map_covariance};
    double sum[36] = {0}, value[6], vector[36];
    for (int k = 0; k < 2; k++)
        for (int i = 0; given[k] && i < 36; i++) {
            const double other = given[k][6 * (i % 6) + i / 6];
            if (!isfinite(given[k][i]) || fabs(given[k][i] - other) > 1e-9 * (1 + fabs(other)))
                return td_fail(error, TD_ERROR_ARGUMENT,
                               "%s_covariance: element (%d, %d) is no number, or it is not symmetric",
                               k ? "map" : "vehicle", i / 6 + 1, i % 6 + 1);
            sum[i] += given[k][i];
        }
    TD_TRY(td_eigen_symmetric(value, vector, sum, 6, error));
    for (int k = 0; k < 6; k++) {
        if (value[k] < -1e-9 * fabs(value[5]) - 1e-30)
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "vehicle_covariance and map_covariance: their sum has the negative eigenvalue %g",
                           value[k]);
        for (int a = 0; a < 6; a++) path->common[6 * a + k] = vector[6 * k + a] * sqrt(fmax(value[k], 0));
    }
    return TD_OK;
}

td_status clearance_path_new(clearance_path *path, const td_clearance_motion *motion, double step_m,
                             td_error *error)
{
    *path = (clearance_path){.motion = motion};
    td_status status = check_motion(motion, error);
    if (status == TD_OK) status = list_shapes(path, error);
    if (status == TD_OK) status = common_root(path, error);
    if (status == TD_OK) status = refine(path, step_m, error);
    if (status != TD_OK) clearance_path_free(path);
    return status;
}

void clearance_path_free(clearance_path *path)
{
    free(path->state);
    free(path->link);
    free(path->number);
    *path = (clearance_path){0};
}
