/* Where the machine can go with its bucket: postures, straight ways, and what the arm and the shell keep off.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servo/dig_internal.h"

static const double PI = 3.14159265358979323846;
static const double PARALLEL = 1e-3;   /* rad: axes that are taken to be upright or parallel */
static const double ARM_KEEPS_M = 0.3; /* between the arm's line and the ground: half its beam */
static const double SAMPLE_M = 0.15, SAMPLE_RAD = 0.2;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- the machine ---- */

/* The joints that move the tool, from the root; how many. */
static int chain_of(int *link, const td_robot *robot, int last)
{
    int count = 0;
    for (int l = last; l >= 0; l = robot->link[l].parent)
        if (robot->link[l].joint >= 0) count++;
    int i = count;
    for (int l = last; l >= 0; l = robot->link[l].parent)
        if (robot->link[l].joint >= 0) link[--i] = l;
    return count;
}

static void joint_axis(double axis[3], const td_robot *robot, const td_pose *at, int link)
{
    td_pose_rotate(axis, at + link, robot->joint[robot->link[link].joint].axis);
}

/* A swing about the upright axis, then joints across, all parallel to the tool's y axis. */
static bool is_excavator(const td_robot *robot, const td_pose *at, const int *link, int count,
                         const double across[3])
{
    double axis[3];
    if (count < 4) return false;
    for (int i = 0; i < count; i++) {
        if (robot->joint[robot->link[link[i]].joint].kind == TD_JOINT_PRISMATIC) return false;
        joint_axis(axis, robot, at, link[i]);
        if (i == 0 && !(fabs(axis[2]) > cos(PARALLEL))) return false;
        if (i > 0 && !(fabs(dot(axis, across)) > cos(PARALLEL))) return false;
    }
    return fabs(across[2]) < PARALLEL;
}

static void narrow_limits(td_robot *robot, double margin)
{
    for (int k = 0; k < robot->joint_count; k++) {
        td_robot_joint *j = robot->joint + k;
        const double by = fmin(margin, (j->upper - j->lower) / 2);
        j->lower += by;
        j->upper -= by;
    }
}

/* Directions and lengths of the bucket as the tool sees them. */
static td_status set_bucket(dig_job *job, const td_pose *at, td_error *error)
{
    const td_dig_bucket *b = job->request->bucket;
    const td_pose root_from_tool = td_pose_compose(at + job->tool.link, &job->tool.link_from_tool);
    const td_pose back = td_pose_inverse(&root_from_tool);
    const td_pose tool_from_bucket = td_pose_compose(&back, at + b->link);
    double edge[3], floor[3], opening[3];
    td_pose_transform(edge, &tool_from_bucket, b->edge);
    td_pose_transform(floor, &tool_from_bucket, b->heel);
    td_pose_rotate(opening, &tool_from_bucket, b->opening);
    if (!(sqrt(dot(edge, edge)) < 1e-3))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: the tool is %.3f m from the bucket's edge; take the edge's middle as the tool",
                       sqrt(dot(edge, edge)));
    job->heel_m = sqrt(dot(floor, floor));
    job->floor_rad = atan2(floor[2], -floor[0]); /* from heel to edge: the floor's negative */
    job->upright_rad = 1.5 * PI - atan2(-opening[2], opening[0]);
    if (!(job->heel_m > 1e-3) || !(hypot(opening[0], opening[2]) > 1e-6))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: the bucket's heel and opening must differ from its edge and lie across its "
                       "joint's axis");
    return TD_OK;
}

td_status dig_machine(dig_job *job, td_error *error)
{
    const td_robot *robot = job->request->robot;
    td_pose at[TD_ROBOT_MAX_LINKS];
    double still[TD_ROBOT_MAX_JOINTS] = {0};
    int link[TD_ROBOT_MAX_LINKS];
    job->robot = malloc(sizeof *job->robot);
    if (!job->robot) return td_fail(error, TD_ERROR_MEMORY, "no memory for the plan of a trench");
    *job->robot = *robot;
    narrow_limits(job->robot, job->o.margin);
    job->tool = *job->request->tool;
    job->tool.row_count = 4;
    for (int i = 0; i < 3; i++) job->tool.row[i] = (td_tool_row)(TD_TOOL_X + i);
    job->tool.row[3] = TD_TOOL_PITCH;
    job->arm_options = td_trajectory_options_default();
    job->arm = (td_arm){.robot = job->robot, .tool = &job->tool, .options = &job->arm_options};
    td_robot_forward(at, robot, still);
    const td_pose tool = td_pose_compose(at + job->tool.link, &job->tool.link_from_tool);
    static const double left[3] = {0, 1, 0};
    double across[3];
    td_pose_rotate(across, &tool, left);
    const int count = chain_of(link, robot, job->tool.link);
    if (!is_excavator(robot, at, link, count, across))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: the tool of robot '%s' is not moved by a swing about an upright axis and three "
                       "joints or more across it; only such machines dig",
                       robot->name);
    int bucket[TD_ROBOT_MAX_LINKS];
    const int held = chain_of(bucket, robot, job->request->bucket->link);
    if (held != count || bucket[count - 1] != link[count - 1])
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "dig: the bucket's link '%s' and the tool's do not move together",
                       robot->link[job->request->bucket->link].name);
    memcpy(job->axis, at[link[0]].t, sizeof job->axis);
    job->aside_m = (tool.t[0] - job->axis[0]) * across[0] + (tool.t[1] - job->axis[1]) * across[1];
    double axis[3];
    joint_axis(axis, robot, at, link[0]);
    job->swing = robot->link[link[0]].joint;
    job->swing_sign = axis[2] > 0 ? 1 : -1;
    job->still_rad = atan2(-across[0], across[1]);
    job->first = link[1];
    job->pin = link[count - 1];
    return set_bucket(job, at, error);
}

/* ---- the edge ---- */

/* Where the arm's plane points when the edge's middle is there, in the vehicle. */
static double azimuth_of(const dig_job *job, const double in_vehicle[3])
{
    const double x = in_vehicle[0] - job->axis[0], y = in_vehicle[1] - job->axis[1];
    return atan2(y, x) - asin(fmin(fmax(job->aside_m / hypot(x, y), -1), 1));
}

void dig_edge(double edge[3], const dig_job *job, const double at[3])
{
    double p[3];
    td_pose_transform(p, &job->vehicle_from_site, at);
    const double azimuth = azimuth_of(job, p);
    const double in_vehicle[3] = {-sin(azimuth), cos(azimuth), 0};
    td_pose_rotate(edge, job->request->site_from_vehicle, in_vehicle);
}

/* The arm points against the heading. */
double dig_askew(const dig_job *job, const double at[3])
{
    double edge[3];
    dig_edge(edge, job, at);
    const double along = edge[0] * job->heading[0] + edge[1] * job->heading[1];
    const double across = edge[1] * job->heading[0] - edge[0] * job->heading[1];
    return fabs(atan2(along, -across));
}

double dig_shell(const dig_job *job, double pitch)
{
    /* Corners of the box of which the floor's side is as deep as the shell. The floor is above the tool's
     * axis where the mouth is upright. */
    const double body = job->request->bucket->body_m, turned = pitch - job->upright_rad + PI;
    const double corner = job->heel_m * sin(turned) + body * cos(turned);
    return fmax(0, -corner);
}

/* ---- postures ---- */

/* A pitch in the site as the vehicle sees it: of the axis in the upright plane through the vehicle's origin
 * and the place, as tasks have it. */
static double pitch_in_vehicle(const dig_job *job, const double in_vehicle[3], const dig_pose *pose)
{
    const double *origin = job->request->site_from_vehicle->t;
    const double ahead = atan2(pose->at[1] - origin[1], pose->at[0] - origin[0]);
    const double there = atan2(in_vehicle[1], in_vehicle[0]);
    const double axis[3] = {cos(pose->pitch) * cos(ahead), cos(pose->pitch) * sin(ahead), -sin(pose->pitch)};
    double x[3];
    td_pose_rotate(x, &job->vehicle_from_site, axis);
    return atan2(-x[2], x[0] * cos(there) + x[1] * sin(there));
}

bool dig_reach(double *q, const dig_job *job, const dig_pose *pose)
{
    double value[TD_TOOL_ROWS], off_m, off_rad;
    td_pose_transform(value, &job->vehicle_from_site, pose->at);
    value[3] = pitch_in_vehicle(job, value, pose);
    /* The swing follows from the place; the short way round. */
    const double wanted = job->swing_sign * (azimuth_of(job, value) - job->still_rad);
    q[job->swing] += remainder(wanted - q[job->swing], 2 * PI);
    return td_reach(q, &off_m, &off_rad, &job->arm, value);
}

static void forward(td_pose *site_from_link, const dig_job *job, const double *q)
{
    td_robot_forward(site_from_link, job->robot, q);
    for (int l = 0; l < job->robot->link_count; l++)
        site_from_link[l] = td_pose_compose(job->request->site_from_vehicle, site_from_link + l);
}

bool dig_arm_clear(const dig_job *job, const double *q)
{
    enum { PARTS = 12 };
    td_pose at[TD_ROBOT_MAX_LINKS];
    forward(at, job, q);
    for (int l = job->pin; l != job->first; l = job->robot->link[l].parent) {
        const double *from = at[l].t, *to = at[job->robot->link[l].parent].t;
        for (int i = 0; i < PARTS; i++) {
            double p[3];
            for (int k = 0; k < 3; k++) p[k] = from[k] + (to[k] - from[k]) * i / PARTS;
            if (p[2] < dig_ground(job->map, p[0], p[1]) + ARM_KEEPS_M) return false;
        }
    }
    return true;
}

bool dig_line(double *q, const dig_job *job, const dig_pose *from, const dig_pose *to, td_dig_reason *reason)
{
    double way = 0;
    for (int k = 0; k < 3; k++) way = hypot(way, to->at[k] - from->at[k]);
    const int parts = (int)ceil(fmax(way / SAMPLE_M, fabs(to->pitch - from->pitch) / SAMPLE_RAD)) + 1;
    for (int i = 0; i <= parts; i++) {
        dig_pose p;
        for (int k = 0; k < 3; k++) p.at[k] = from->at[k] + (to->at[k] - from->at[k]) * i / parts;
        p.pitch = from->pitch + (to->pitch - from->pitch) * i / parts;
        if (!dig_reach(q, job, &p)) {
            *reason = TD_DIG_TOO_FAR;
            return false;
        }
        if (!dig_arm_clear(job, q)) {
            *reason = TD_DIG_BLOCKED;
            return false;
        }
    }
    return true;
}

static dig_pose tool_at(const dig_job *job, const td_pose *at)
{
    static const double ahead[3] = {1, 0, 0};
    const td_pose tool = td_pose_compose(at + job->tool.link, &job->tool.link_from_tool);
    const double *foot = at[job->first].t;
    const double out[2] = {tool.t[0] - foot[0], tool.t[1] - foot[1]};
    dig_pose pose;
    double x[3];
    td_pose_rotate(x, &tool, ahead);
    memcpy(pose.at, tool.t, sizeof pose.at);
    pose.pitch = atan2(-x[2], (x[0] * out[0] + x[1] * out[1]) / hypot(out[0], out[1]));
    return pose;
}

void dig_pose_of(dig_pose *pose, const dig_job *job, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    forward(at, job, q);
    *pose = tool_at(job, at);
}

double dig_too_low(double *where, const dig_job *job, const double *from, const double *to)
{
    enum { PARTS = 40 };
    td_pose at[TD_ROBOT_MAX_LINKS];
    double lowest[PARTS + 1], ground[PARTS + 1], highest = -INFINITY, worst = -INFINITY;
    for (int i = 0; i <= PARTS; i++) {
        double q[TD_ROBOT_MAX_JOINTS] = {0};
        for (int k = 0; k < job->robot->joint_count; k++) q[k] = from[k] + (to[k] - from[k]) * i / PARTS;
        forward(at, job, q);
        const dig_pose p = tool_at(job, at);
        lowest[i] = fmin(p.at[2] - dig_shell(job, p.pitch), at[job->pin].t[2] - ARM_KEEPS_M);
        ground[i] = dig_below(job, p.at);
        highest = fmax(highest, ground[i]);
    }
    *where = 0;
    for (int i = 0; i <= PARTS; i++) { /* over unknown ground the highest that is known on the way counts */
        const double low = (isinf(ground[i]) ? highest : ground[i]) + job->o.clear_m - lowest[i];
        if (!(low > worst)) continue;
        worst = low;
        *where = (double)i / PARTS;
    }
    return worst;
}
