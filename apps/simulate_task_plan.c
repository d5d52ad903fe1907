/* A step of a task as a motion: the task's points as the generator's vias, its limits as the generator's. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "servo/trajectory_generator.h"

/* Of speed, acceleration and flow, what a plan may use: the controller needs the rest. A plan that uses all
 * of the swing's acceleration leaves the tool of a 20 t excavator 0.7 m behind where it is to brake; one that
 * uses 0.8 of it 0.08 m. */
static const double PLAN_SHARE = 0.8;

#define RADIANS 0.017453292519943295

/* The shortest turn that takes x to the axis. */
td_pose task_tool(const td_task *task)
{
    const double *a = task->tool.axis;
    const double across = hypot(a[1], a[2]), angle = atan2(across, a[0]);
    double turn[3] = {0, across > 1e-12 ? -a[2] / across * angle : angle,
                      across > 1e-12 ? a[1] / across * angle : 0};
    td_pose p = td_pose_identity();
    td_rotation_exp(p.q, turn);
    memcpy(p.t, task->tool.point_m, sizeof p.t);
    return p;
}

double task_pitch(const td_pose *site_from_tool)
{
    static const double ahead[3] = {1, 0, 0};
    double x[3];
    td_pose_rotate(x, site_from_tool, ahead);
    return atan2(-x[2], hypot(x[0], x[1]));
}

/* What a rotation is in the generator's angles: R = Rz(yaw) Rx(roll) Ry(pitch). */
static void angles(double value[3], const td_pose *p)
{
    double r[9];
    td_pose_rotation(r, p);
    value[0] = atan2(r[7], hypot(r[1], r[4]));
    value[1] = atan2(-r[6], r[8]);
    value[2] = atan2(-r[1], r[4]);
}

/* A pitch in the site, as the vehicle that stands there sees it: of the axis in the upright plane through the
 * vehicle's origin and the point. */
static double pitch_in(const td_pose *vehicle_from_site, const double in_vehicle[3], const double in_site[3],
                       const double origin[3], double pitch)
{
    const double ahead = atan2(in_site[1] - origin[1], in_site[0] - origin[0]);
    const double there = atan2(in_vehicle[1], in_vehicle[0]);
    const double axis[3] = {cos(pitch) * cos(ahead), cos(pitch) * sin(ahead), -sin(pitch)};
    double x[3];
    td_pose_rotate(x, vehicle_from_site, axis);
    return atan2(-x[2], x[0] * cos(there) + x[1] * sin(there));
}

static void via_of(td_via *via, const td_task *task, td_task_frame frame, const td_task_point *p,
                   const td_pose *link_from_tool, const td_pose *base)
{
    const bool in_site = frame == TD_TASK_SITE;
    const td_pose back = in_site ? td_pose_inverse(base) : td_pose_identity();
    *via = (td_via){.tolerance_m = task->tolerance.position_m,
                    .tolerance_rad = RADIANS * task->tolerance.angle_deg};
    td_pose_transform(via->value, &back, p->at_m);
    if (p->attitude == TD_TASK_PITCH) {
        const double pitch = RADIANS * p->pitch_deg;
        via->value[3] = in_site ? pitch_in(&back, via->value, p->at_m, base->t, pitch) : pitch;
    } else if (p->attitude == TD_TASK_WHOLE) {
        td_pose link = td_pose_identity();
        memcpy(link.q, p->q, sizeof link.q);
        link = td_pose_compose(&back, &link);
        const td_pose tool = td_pose_compose(&link, link_from_tool);
        angles(via->value + 3, &tool);
    }
}

static td_tool tool_of(const td_robot *robot, const td_task *task, td_task_attitude attitude)
{
    td_tool t = {.link = td_task_tool_link(task, robot), .link_from_tool = task_tool(task)};
    for (int i = 0; i < 3; i++) t.row[t.row_count++] = (td_tool_row)(TD_TOOL_X + i);
    if (attitude == TD_TASK_PITCH) t.row[t.row_count++] = TD_TOOL_PITCH;
    if (attitude == TD_TASK_WHOLE)
        for (int i = 0; i < 3; i++) t.row[t.row_count++] = (td_tool_row)(TD_TOOL_ROLL + i);
    return t;
}

/* The fastest that the tool is, m/s, and its largest acceleration, by differences. */
static void tool_extremes(double *speed, double *acceleration, const td_trajectory *planned,
                          const td_robot *robot, const td_tool *tool)
{
    enum { POINTS = 400 };
    const double h = td_trajectory_duration(planned) / POINTS;
    double last[3] = {0}, rate[3] = {0}, pose[TD_TOOL_ROWS], q[TD_ROBOT_MAX_JOINTS];
    *speed = *acceleration = 0;
    for (int i = 0; i <= POINTS && h > 0; i++) {
        double now[3];
        td_trajectory_at(q, NULL, NULL, planned, i * h);
        td_tool_pose(pose, robot, tool, q);
        for (int k = 0; k < 3; k++) now[k] = (pose[k] - last[k]) / h;
        if (i > 0) *speed = fmax(*speed, hypot(hypot(now[0], now[1]), now[2]));
        if (i > 1)
            *acceleration =
                fmax(*acceleration, hypot(hypot(now[0] - rate[0], now[1] - rate[1]), now[2] - rate[2]) / h);
        memcpy(rate, now, sizeof rate);
        memcpy(last, pose, sizeof last);
    }
}

/* The generator knows the joints' limits; the tool's are kept by taking longer. */
static td_status hold_tool(td_trajectory *planned, const scenario *s, const td_tool *tool, double asked_s,
                           td_error *error)
{
    const td_task *task = s->task->task;
    double speed, acceleration;
    tool_extremes(&speed, &acceleration, planned, s->robot, tool);
    const double factor =
        fmax(speed / task->limits.speed_m_s, sqrt(acceleration / task->limits.acceleration_m_s2));
    if (factor <= 1) return TD_OK;
    if (asked_s > 0)
        return td_fail(error, TD_ERROR_DATA,
                       "%g s are too short for the tool's limits: it would move at %.3g m/s and %.3g m/s^2; "
                       "%.4g s are long enough",
                       asked_s, speed, acceleration, 1.001 * factor * asked_s);
    td_trajectory_stretch(planned, factor);
    return TD_OK;
}

static td_trajectory_options options_of(const scenario *s, const td_task_position *p)
{
    td_trajectory_options o = td_trajectory_options_default();
    o.law = (td_timing_law)p->law;
    o.duration_s = p->duration_s;
    o.share = PLAN_SHARE * s->task->task->limits.joint_speed_share;
    o.pump_m3_s = PLAN_SHARE * s->task->task->limits.pump_share * td_robot_pump(s->robot);
    if (!isfinite(o.pump_m3_s)) o.pump_m3_s = 0;
    o.alpha = s->task->alpha;
    o.power = s->task->power;
    return o;
}

td_status task_plan(td_trajectory **planned, bool *unreachable, const scenario *s, const td_task_position *p,
                    td_task_frame frame, const double *q, const td_pose *base, td_error *error)
{
    const td_task *task = s->task->task;
    const td_tool tool = tool_of(s->robot, task, p->to.attitude);
    const td_trajectory_options o = options_of(s, p);
    td_via via[TD_TASK_MAX_VIA + 1] = {0};
    td_nearest nearest = {.via = -1};
    td_status status;
    *unreachable = true;
    if (p->joint_count) {
        memcpy(via[0].value, q, (size_t)s->robot->joint_count * sizeof *q);
        for (int i = 0; i < p->joint_count; i++)
            via[0].value[td_robot_find_joint(s->robot, p->joint[i].name)] =
                p->joint[i].slides ? p->joint[i].value : RADIANS * p->joint[i].value;
        status = td_trajectory_plan(planned, &nearest, s->robot, NULL, q, via, 1, &o, error);
    } else {
        for (int i = 0; i <= p->via_count; i++)
            via_of(via + i, task, frame, i < p->via_count ? p->via + i : &p->to, &tool.link_from_tool, base);
        status = td_trajectory_plan(planned, &nearest, s->robot, &tool, q, via, (size_t)p->via_count + 1, &o,
                                    error);
    }
    if (status == TD_OK) status = hold_tool(*planned, s, &tool, p->duration_s, error);
    if (status != TD_OK) td_trajectory_free(planned);
    *unreachable = status == TD_ERROR_DATA || status == TD_ERROR_ARGUMENT;
    return status;
}
