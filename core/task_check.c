/* Whether a task fits a robot. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/task_internal.h"

static const double G = 9.80665, PI = 3.14159265358979323846;

/* Where the stretched arm reaches, and how fast: bounds, from above. */
typedef struct arm {
    double centre[3]; /* of the first joint, in the root's frame */
    double reach_m, speed_m_s;
} arm;

typedef struct checker {
    const td_task *task;
    const td_robot *robot;
    const td_pose *frame_from_vehicle; /* NULL: not known */
    arm arm;
    char where[48]; /* "steps[2].press" */
    td_error *error;
} checker;

static td_status fail(const checker *c, const char *format, ...) TD_PRINTF(2, 3);

static td_status fail(const checker *c, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return td_fail(c->error, TD_ERROR_DATA, "task '%s': %s: %s", c->task->name, c->where, text);
}

int td_task_tool_link(const td_task *task, const td_robot *robot)
{
    return task->tool.link[0] ? td_robot_find_link(robot, task->tool.link) : robot->link_count - 1;
}

static double length_of(const double v[3])
{
    return hypot(hypot(v[0], v[1]), v[2]);
}

/* From the tool back to the root: lengths add up; each joint moves all that is beyond it. */
static bool measure(arm *a, const td_task *task, const td_robot *robot, int link)
{
    double beyond = length_of(task->tool.point_m);
    td_pose at[TD_ROBOT_MAX_LINKS];
    const double still[TD_ROBOT_MAX_JOINTS] = {0};
    int first = -1;
    *a = (arm){.reach_m = 0};
    for (; link >= 0; link = robot->link[link].parent) {
        const td_robot_link *l = robot->link + link;
        if (l->joint >= 0) {
            const td_robot_joint *j = robot->joint + l->joint;
            const bool slides = j->kind == TD_JOINT_PRISMATIC;
            if (slides) beyond += fmax(fabs(j->lower), fabs(j->upper));
            a->speed_m_s += slides ? j->speed : j->speed * beyond;
            a->reach_m = beyond;
            first = link;
        }
        beyond += length_of(l->parent_from_link.t);
    }
    if (first < 0) return false;
    td_robot_forward(at, robot, still);
    memcpy(a->centre, at[first].t, sizeof a->centre);
    return true;
}

static td_status check_point(const checker *c, const char *what, const double at_m[3])
{
    double centre[3], away[3];
    if (!c->frame_from_vehicle) return TD_OK;
    td_pose_transform(centre, c->frame_from_vehicle, c->arm.centre);
    for (int i = 0; i < 3; i++) away[i] = at_m[i] - centre[i];
    if (length_of(away) <= c->arm.reach_m) return TD_OK;
    return fail(c,
                "%s (%.3f, %.3f, %.3f) m is %.2f m from the first joint, but the arm of '%s' is %.2f m long "
                "when stretched out; drive nearer",
                what, at_m[0], at_m[1], at_m[2], length_of(away), c->robot->name, c->arm.reach_m);
}

static td_status check_joint(const checker *c, const td_task_joint *j)
{
    const int k = td_robot_find_joint(c->robot, j->name);
    if (k < 0) return fail(c, "joints: robot '%s' has no moving joint '%s'", c->robot->name, j->name);
    const td_robot_joint *joint = c->robot->joint + k;
    if (j->slides != (joint->kind == TD_JOINT_PRISMATIC))
        return fail(c, "joints: '%s' %s; write %s_%s", j->name, j->slides ? "turns" : "slides", j->name,
                    j->slides ? "deg" : "m");
    const double unit = j->slides ? 1 : 180 / PI;
    if (j->value >= joint->lower * unit && j->value <= joint->upper * unit) return TD_OK;
    return fail(c, "joints: '%s' at %g %s is outside its range, %.6g to %.6g", j->name, j->value,
                j->slides ? "m" : "deg", joint->lower * unit, joint->upper * unit);
}

static td_status check_position(const checker *c, const td_task_position *p)
{
    for (int i = 0; i < p->joint_count; i++) TD_TRY(check_joint(c, p->joint + i));
    for (int i = 0; i < p->via_count; i++) {
        char what[32];
        snprintf(what, sizeof what, "via[%d]", i);
        TD_TRY(check_point(c, what, p->via[i].at_m));
    }
    return p->joint_count > 0 ? TD_OK : check_point(c, "to", p->to.at_m);
}

static td_status check_dig(const checker *c, const td_task_dig *d)
{
    const double heading = d->heading_deg * PI / 180;
    const double end[3] = {d->from.at_m[0] + d->length_m * cos(heading),
                           d->from.at_m[1] + d->length_m * sin(heading), d->from.at_m[2] - d->depth_m};
    TD_TRY(check_point(c, "from", d->from.at_m));
    return d->has_heading ? check_point(c, "its end", end) : TD_OK;
}

static td_status check_press(const checker *c, const td_task_press *p)
{
    double weight = 0;
    for (int i = 0; i < c->robot->link_count; i++) weight += G * c->robot->link[i].mass_kg;
    const double down = -p->axis[2] * p->force_n;
    if (weight == 0 || down <= weight) return TD_OK;
    return fail(c, "%g N downwards lifts the robot, which weighs %.0f N", down, weight);
}

static td_status check_step(checker *c, const td_task_step *step)
{
    switch (step->kind) {
    case TD_TASK_POSITION:
        return check_position(c, &step->as.position);
    case TD_TASK_DIG:
        return check_dig(c, &step->as.dig);
    case TD_TASK_DUMP:
        return check_point(c, "at", step->as.dump.at_m);
    case TD_TASK_PRESS:
        return check_press(c, &step->as.press);
    case TD_TASK_DRIVE:
        if (c->task->frame == TD_TASK_SITE) c->frame_from_vehicle = NULL;
        return TD_OK;
    case TD_TASK_WAIT:
        break;
    }
    return TD_OK;
}

td_status td_task_check(const td_task *task, const td_robot *robot, const td_pose *site_from_vehicle,
                        td_error *error)
{
    const td_pose same = td_pose_identity();
    checker c = {.task = task, .robot = robot, .where = "tool", .error = error};
    c.frame_from_vehicle = task->frame == TD_TASK_VEHICLE ? &same : site_from_vehicle;
    const int link = td_task_tool_link(task, robot);
    if (link < 0) return fail(&c, "robot '%s' has no link '%s'", robot->name, task->tool.link);
    if (!measure(&c.arm, task, robot, link))
        return fail(&c, "no joint of robot '%s' moves link '%s'", robot->name, robot->link[link].name);
    strcpy(c.where, "limits");
    if (isfinite(task->limits.speed_m_s) && task->limits.speed_m_s > c.arm.speed_m_s)
        return fail(&c,
                    "speed_m_s %g is beyond the robot: all joints of '%s' together move its tool by less "
                    "than %.3g m/s",
                    task->limits.speed_m_s, robot->name, c.arm.speed_m_s);
    for (int i = 0; i < task->step_count; i++) {
        snprintf(c.where, sizeof c.where, "steps[%d].%s", i, td_task_kind_name(task->step[i].kind));
        TD_TRY(check_step(&c, task->step + i));
    }
    return TD_OK;
}
