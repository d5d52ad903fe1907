#include "servo/trajectory_generator.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

/* Looked at between knots, a motion may use this of a limit; it is planned for a little less. */
static const double FULL = 1 - 3e-4;
static const double LEAST_TOLERANCE = 1e-5; /* m, rad */

td_trajectory_options td_trajectory_options_default(void)
{
    return (td_trajectory_options){.law = TD_LAW_FASTEST,
                                   .ramp_share = 0.25,
                                   .share = 1,
                                   .alpha = -1,
                                   .power = 6,
                                   .radius_m = 1,
                                   .singular_share = 0.01,
                                   .off_m = 0.05,
                                   .off_rad = 0.05,
                                   .near_share = 0.02};
}

/* What a plan is made with. */
typedef struct plan {
    td_arm arm;
    const td_via *via;
    size_t via_count;
    td_nearest *nearest;
    double q[TD_ROBOT_MAX_JOINTS]; /* where the motion is so far */
    td_trajectory **part;          /* (parts) from stop to stop */
    size_t parts;
} plan;

/* ---- what is refused ---- */

static td_status check_options(const td_trajectory_options *o, td_error *error)
{
    const struct {
        const char *name;
        double value, low, high;
    } all[] = {{"law", o->law, TD_LAW_FASTEST, TD_LAW_CONSTANT_ACCELERATION},
               {"duration_s", o->duration_s, 0, 1e6},
               {"ramp_share", o->ramp_share, 1e-3, 0.5},
               {"share", o->share, 1e-6, 1},
               {"pump_m3_s", o->pump_m3_s, 0, INFINITY},
               {"alpha", o->alpha, -1e3, 0},
               {"power", o->power, 2, 100},
               {"radius_m", o->radius_m, 1e-6, 1e6},
               {"singular_share", o->singular_share, 0, 0.5},
               {"off_m", o->off_m, 1e-6, 1e6},
               {"off_rad", o->off_rad, 1e-6, 1e6},
               {"near_share", o->near_share, 0, 0.5}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (!(all[i].value >= all[i].low && all[i].value <= all[i].high))
            return td_fail(error, TD_ERROR_ARGUMENT, "trajectory option %s is %g: give %g to %g", all[i].name,
                           all[i].value, all[i].low, all[i].high);
    return TD_OK;
}

static td_status check_tool(const td_arm *arm, td_error *error)
{
    const td_tool *tool = arm->tool;
    bool moves[TD_ROBOT_MAX_JOINTS], seen[TD_TOOL_ROWS] = {false};
    int joints = 0;
    if (tool->link < 0 || tool->link >= arm->robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "the tool is on link %d, robot '%s' has %d", tool->link,
                       arm->robot->name, arm->robot->link_count);
    td_tool_joints(moves, arm);
    for (int k = 0; k < arm->robot->joint_count; k++) joints += moves[k];
    if (tool->row_count < 1 || tool->row_count > TD_TOOL_ROWS || tool->row_count > joints)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "%d rows of the tool on link '%s' of robot '%s' are asked for, which %d joints move: ask for "
            "1 to %d",
            tool->row_count, arm->robot->link[tool->link].name, arm->robot->name, joints,
            joints < TD_TOOL_ROWS ? joints : TD_TOOL_ROWS);
    for (int i = 0; i < tool->row_count; i++) {
        if ((unsigned)tool->row[i] >= TD_TOOL_ROWS || seen[tool->row[i]])
            return td_fail(error, TD_ERROR_ARGUMENT, "row %d of the tool is unknown or given twice", i + 1);
        seen[tool->row[i]] = true;
    }
    return TD_OK;
}

static td_status check_joints(const td_robot *robot, const double *q, const char *where, td_error *error)
{
    for (int k = 0; k < robot->joint_count; k++) {
        const td_robot_joint *j = robot->joint + k;
        if (!isfinite(q[k]))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: joint '%s' is no number", where, j->name);
        if (q[k] < j->lower || q[k] > j->upper)
            return td_fail(error, TD_ERROR_DATA, "%s: joint '%s' is at %.6g, its limits are %.6g and %.6g",
                           where, j->name, q[k], j->lower, j->upper);
    }
    return TD_OK;
}

/* Is value k of a via an angle? */
static bool is_angle(const td_arm *arm, int k)
{
    return arm->tool ? arm->tool->row[k] >= TD_TOOL_ROLL : arm->robot->joint[k].kind != TD_JOINT_PRISMATIC;
}

static td_status check_via(const plan *p, size_t i, int size, td_error *error)
{
    const td_via *via = p->via + i;
    const bool passed = !via->stop && i + 1 < p->via_count;
    for (int k = 0; k < size; k++) {
        const double tolerance = is_angle(&p->arm, k) ? via->tolerance_rad : via->tolerance_m;
        if (!(fabs(via->value[k]) <= 1e6))
            return td_fail(error, TD_ERROR_ARGUMENT, "via %zu: its value %d is %g, no number up to 1e6",
                           i + 1, k + 1, via->value[k]);
        if (passed && !(tolerance >= LEAST_TOLERANCE))
            return td_fail(error, TD_ERROR_ARGUMENT,
                           "via %zu is passed within %g %s: give %g or more, or stop there", i + 1, tolerance,
                           is_angle(&p->arm, k) ? "rad" : "m", LEAST_TOLERANCE);
    }
    return TD_OK;
}

static td_status check_vias(const plan *p, td_error *error)
{
    const int size = p->arm.tool ? p->arm.tool->row_count : p->arm.robot->joint_count;
    if (p->via_count < 1 || p->via_count > 100000)
        return td_fail(error, TD_ERROR_ARGUMENT, "%zu via points: give 1 to 100000", p->via_count);
    for (size_t i = 0; i < p->via_count; i++) TD_TRY(check_via(p, i, size, error));
    return TD_OK;
}

/* ---- paths from stop to stop ---- */

static td_status refuse_via(const plan *p, size_t via, const double *q, double off_m, double off_rad,
                            td_error *error)
{
    td_nearest nearest = {.via = (int)via, .off_m = off_m, .off_rad = off_rad};
    memcpy(nearest.q, q, (size_t)p->arm.robot->joint_count * sizeof *q);
    td_tool_pose(nearest.pose, p->arm.robot, p->arm.tool, q);
    if (p->nearest) *p->nearest = nearest;
    return td_fail(
        error, TD_ERROR_DATA,
        "via %zu is out of reach: the nearest place is %.3g m and %.3g rad off, at x %.3f, y %.3f, z %.3f "
        "m, pitch %.3f rad; ask for that or drive nearer",
        via + 1, off_m, off_rad, nearest.pose[0], nearest.pose[1], nearest.pose[2],
        nearest.pose[TD_TOOL_PITCH]);
}

/* The via's rows, angles on by as many turns as joints take them between q and where they reach it; q goes
 * there. `last`: the rows at q, unwrapped. */
static td_status via_rows(double *value, double *last, double *q, const plan *p, size_t via, td_error *error)
{
    enum { LOOKS = 32 };
    const td_arm *arm = &p->arm;
    const int n = arm->robot->joint_count;
    const size_t rows = (size_t)arm->tool->row_count * sizeof *value;
    double goal[TD_ROBOT_MAX_JOINTS], at[TD_ROBOT_MAX_JOINTS], off_m = 0, off_rad = 0;
    memcpy(goal, q, (size_t)n * sizeof *q);
    const bool there = td_reach(goal, &off_m, &off_rad, arm, p->via[via].value);
    if (!there) return refuse_via(p, via, goal, off_m, off_rad, error);
    for (int i = 1; i <= LOOKS; i++) {
        double now[TD_TOOL_ROWS];
        for (int k = 0; k < n; k++) at[k] = q[k] + (goal[k] - q[k]) * i / LOOKS;
        td_tool_rows(now, NULL, arm, at);
        td_tool_unwrap(now, last, arm->tool);
        memcpy(last, now, rows);
    }
    memcpy(value, p->via[via].value, rows);
    td_tool_unwrap(value, last, arm->tool);
    memcpy(last, value, rows);
    memcpy(q, goal, (size_t)n * sizeof *q);
    return TD_OK;
}

/* Lines from where the motion is through the vias from `first` to the next stop, the via *stop. */
static td_status lines_of(td_polyline *line, size_t *stop, const plan *p, size_t first, td_error *error)
{
    const td_arm *arm = &p->arm;
    double weight[TD_ROBOT_MAX_JOINTS], value[TD_ROBOT_MAX_JOINTS], last[TD_TOOL_ROWS],
        q[TD_ROBOT_MAX_JOINTS];
    for (int k = 0; k < line->size; k++) weight[k] = arm->tool ? td_tool_weight(arm, k) : 1;
    memcpy(q, p->q, sizeof q);
    if (arm->tool) td_tool_rows(last, NULL, arm, q);
    td_polyline_add(line, arm->tool ? last : q, weight, first);
    for (size_t i = first; i < p->via_count; i++) {
        char where[32];
        snprintf(where, sizeof where, "via %zu", i + 1);
        if (arm->tool) {
            TD_TRY(via_rows(value, last, q, p, i, error));
        } else {
            TD_TRY(check_joints(arm->robot, p->via[i].value, where, error));
            memcpy(value, p->via[i].value, (size_t)line->size * sizeof *value);
        }
        td_polyline_add(line, value, weight, i);
        *stop = i;
        if (p->via[i].stop) break;
    }
    return TD_OK;
}

/* Each value gets its part of the tolerance, so that together they are within it. */
static void round_corners(td_polyline *line, const plan *p)
{
    double tolerance[TD_ROBOT_MAX_JOINTS];
    int angles = 0;
    for (int k = 0; k < line->size; k++) angles += is_angle(&p->arm, k);
    for (size_t i = 1; i + 1 < line->count; i++) {
        const td_via *via = p->via + line->via[i];
        for (int k = 0; k < line->size; k++)
            tolerance[k] = is_angle(&p->arm, k) ? via->tolerance_rad / sqrt(angles)
                                                : via->tolerance_m / sqrt(line->size - angles);
        td_polyline_round(line, i, tolerance);
    }
}

/* Joints that move must have limits of speed and acceleration. */
static td_status check_limits(const td_path *path, const td_robot *robot, td_error *error)
{
    const size_t n = (size_t)path->n;
    for (size_t k = 0; k < n; k++) {
        const td_robot_joint *j = robot->joint + k;
        bool moves = false;
        for (size_t i = 0; i < path->count; i++) moves = moves || path->d1[i * n + k] != 0;
        if (!moves ||
            (j->speed > 0 && isfinite(j->speed) && j->acceleration > 0 && isfinite(j->acceleration)))
            continue;
        return td_fail(
            error, TD_ERROR_DATA, "joint '%s' of robot '%s' must move but has no limit of %s: give %s",
            j->name, robot->name, j->speed > 0 && isfinite(j->speed) ? "acceleration" : "speed",
            j->speed > 0 && isfinite(j->speed) ? "acceleration_rad_s2 (acceleration_m_s2) in the YAML "
                                                 "beside its URDF"
                                               : "velocity in its URDF");
    }
    return TD_OK;
}

/* ---- knots ---- */

static void add_knot(td_trajectory *t, const td_timing *timing, size_t node, const double *q,
                     const double *d1, const double *d2, double dds)
{
    const size_t n = (size_t)t->joints;
    t->time_s[t->count] = timing->t[node];
    for (size_t k = 0; k < n; k++) {
        const size_t at = t->count * n + k;
        t->q[at] = q[k];
        t->dq[at] = d1[k] * timing->ds[node];
        t->ddq[at] = d1[k] * dds + d2[k] * timing->ds[node] * timing->ds[node];
    }
    t->count++;
}

/* A knot for each node; two where s'' jumps. */
static td_status make_knots(td_trajectory **out, const td_path *path, const td_timing *timing,
                            td_error *error)
{
    double q[TD_ROBOT_MAX_JOINTS], d1[TD_ROBOT_MAX_JOINTS], d2[TD_ROBOT_MAX_JOINTS];
    TD_TRY(td_trajectory_new(out, path->n, 2 * timing->count, error));
    td_trajectory *t = *out;
    t->count = 0;
    size_t interval = 0;
    for (size_t i = 0; i < timing->count; i++) {
        while (interval + 2 < path->count && path->s[interval + 1] <= timing->s[i]) interval++;
        td_path_at(q, d1, d2, path, interval, timing->s[i]);
        add_knot(t, timing, i, q, d1, d2, timing->before[i]);
        if (i > 0 && i + 1 < timing->count && timing->before[i] != timing->after[i])
            add_knot(t, timing, i, q, d1, d2, timing->after[i]);
    }
    return TD_OK;
}

/* When the motion is at s. */
static double time_at(const td_timing *timing, double s)
{
    size_t i = 0;
    while (i + 2 < timing->count && timing->s[i + 1] < s) i++;
    const double all = timing->s[i + 1] - timing->s[i], part = all > 0 ? (s - timing->s[i]) / all : 0;
    return timing->t[i] + fmin(fmax(part, 0), 1) * (timing->t[i + 1] - timing->t[i]);
}

static td_status add_event(td_trajectory *t, const td_trajectory_event *event, td_error *error)
{
    td_trajectory_event *more = realloc(t->event, (t->event_count + 1) * sizeof *more);
    if (!more) return td_fail(error, TD_ERROR_MEMORY, "no memory for an event");
    t->event = more;
    t->event[t->event_count++] = *event;
    return TD_OK;
}

/* By how much a motion must be longer for every limit to hold (below 1: it may be shorter). */
static td_status stretch_needed(double *factor, const td_arm *arm, const td_trajectory *t, td_error *error)
{
    td_trajectory_shares most;
    TD_TRY(td_trajectory_check(&most, t, arm->robot, arm->pump_m3_s, 0, error));
    const double allowed = arm->options->share * FULL;
    *factor = fmax(fmax(most.speed.share, most.flow.share), most.pump.share) / allowed;
    *factor = fmax(*factor, sqrt(most.acceleration.share / allowed));
    return TD_OK;
}

static td_status time_path(td_trajectory **part, const plan *p, const td_path *path, td_error *error)
{
    const td_trajectory_options *o = p->arm.options;
    td_timing timing = {0};
    double factor = 1;
    TD_TRY(check_limits(path, p->arm.robot, error));
    const bool fastest = o->law == TD_LAW_FASTEST;
    td_status status = fastest ? td_timing_fastest(&timing, &p->arm, path, error)
                               : td_timing_of_law(&timing, path, o->law, o->ramp_share, error);
    if (status == TD_OK) status = make_knots(part, path, &timing, error);
    for (size_t i = 0; status == TD_OK && i < path->event_count; i++) {
        td_trajectory_event event = path->event[i];
        event.from_s = time_at(&timing, event.from_s);
        event.to_s = time_at(&timing, event.to_s);
        status = add_event(*part, &event, error);
    }
    if (status == TD_OK) status = stretch_needed(&factor, &p->arm, *part, error);
    if (status == TD_OK && (!fastest || factor > 1)) td_trajectory_stretch(*part, factor);
    td_timing_free(&timing);
    return status;
}

/* The motion to the next stop; *first goes behind it. */
static td_status plan_part(plan *p, size_t *first, td_error *error)
{
    td_polyline line;
    td_path path = {0};
    size_t stop = *first;
    const int size = p->arm.tool ? p->arm.tool->row_count : p->arm.robot->joint_count;
    TD_TRY(td_polyline_new(&line, size, p->via_count - *first + 1, error));
    td_status status = lines_of(&line, &stop, p, *first, error);
    if (status == TD_OK && line.count > 1) {
        round_corners(&line, p);
        status = p->arm.tool ? td_path_of_tool(&path, p->nearest, &p->arm, &line, p->q, error)
                             : td_path_of_joints(&path, &p->arm, &line, error);
        if (status == TD_OK) status = time_path(p->part + p->parts, p, &path, error);
        if (status == TD_OK)
            memcpy(p->q, path.q + (path.count - 1) * (size_t)path.n, (size_t)path.n * sizeof *path.q);
        p->parts += p->part[p->parts] != NULL;
    }
    *first = stop + 1;
    td_path_free(&path);
    td_polyline_free(&line);
    return status;
}

/* ---- the whole ---- */

static td_status join(td_trajectory **out, const plan *p, td_error *error)
{
    const size_t n = (size_t)p->arm.robot->joint_count;
    size_t count = 0;
    double time_s = 0;
    for (size_t i = 0; i < p->parts; i++) count += p->part[i]->count;
    TD_TRY(td_trajectory_new(out, (int)n, count ? count : 1, error));
    td_trajectory *t = *out;
    if (count == 0) memcpy(t->q, p->q, n * sizeof *p->q);
    count = 0;
    for (size_t i = 0; i < p->parts; i++) {
        const td_trajectory *part = p->part[i];
        for (size_t k = 0; k < part->count; k++) t->time_s[count + k] = time_s + part->time_s[k];
        memcpy(t->q + count * n, part->q, part->count * n * sizeof *t->q);
        memcpy(t->dq + count * n, part->dq, part->count * n * sizeof *t->q);
        memcpy(t->ddq + count * n, part->ddq, part->count * n * sizeof *t->q);
        for (size_t k = 0; k < part->event_count; k++) {
            td_trajectory_event event = part->event[k];
            event.from_s += time_s;
            event.to_s += time_s;
            TD_TRY(add_event(t, &event, error));
        }
        count += part->count;
        time_s += td_trajectory_duration(part);
    }
    return TD_OK;
}

/* Events of one joint near a limit: from the first knot to the last of each stay. */
static td_status note_near(td_trajectory *t, const td_arm *arm, int joint, td_error *error)
{
    const td_robot_joint *j = arm->robot->joint + joint;
    const double near = arm->options->near_share * (j->upper - j->lower);
    td_trajectory_event event = {.kind = TD_TRAJECTORY_NEAR_LIMIT, .joint = joint, .least = INFINITY};
    if (!isfinite(near)) return TD_OK;
    for (size_t i = 0; i < t->count; i++) {
        const double q = t->q[i * (size_t)t->joints + (size_t)joint], left = fmin(q - j->lower, j->upper - q);
        if (left < near) {
            if (!isfinite(event.least)) event.from_s = t->time_s[i];
            event.least = fmin(event.least, fmax(left, 0));
            event.to_s = t->time_s[i];
        }
        if (isfinite(event.least) && (left >= near || i + 1 == t->count)) {
            TD_TRY(add_event(t, &event, error));
            event.least = INFINITY;
        }
    }
    return TD_OK;
}

static int compare_events(const void *a, const void *b)
{
    const td_trajectory_event *x = a, *y = b;
    if (x->from_s != y->from_s) return x->from_s > y->from_s ? 1 : -1;
    return x->kind != y->kind ? (int)x->kind - (int)y->kind : x->joint - y->joint;
}

static td_status finish(td_trajectory *t, const td_arm *arm, td_error *error)
{
    const double wanted = arm->options->duration_s, shortest = td_trajectory_duration(t);
    if (wanted > 0 && wanted < shortest)
        return td_fail(error, TD_ERROR_DATA,
                       "a duration of %.6g s is too short: within the limits the motion takes %.6g s or more",
                       wanted, shortest);
    if (wanted > 0 && shortest > 0) {
        td_trajectory_stretch(t, wanted / shortest);
        t->time_s[t->count - 1] = wanted;
    }
    for (int k = 0; k < t->joints; k++) TD_TRY(note_near(t, arm, k, error));
    if (t->event_count) qsort(t->event, t->event_count, sizeof *t->event, compare_events);
    return TD_OK;
}

static td_status make(td_trajectory **out, plan *p, td_error *error)
{
    p->part = calloc(p->via_count, sizeof(td_trajectory *));
    if (!p->part) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu via points", p->via_count);
    td_status status = TD_OK;
    for (size_t i = 0; i < p->via_count && status == TD_OK;) status = plan_part(p, &i, error);
    if (status == TD_OK) status = join(out, p, error);
    if (status == TD_OK) status = finish(*out, &p->arm, error);
    for (size_t i = 0; i < p->parts; i++) td_trajectory_free(p->part + i);
    free(p->part);
    if (status != TD_OK) td_trajectory_free(out);
    return status;
}

td_status td_trajectory_plan(td_trajectory **trajectory, td_nearest *nearest, const td_robot *robot,
                             const td_tool *tool, const double *q, const td_via *via, size_t via_count,
                             const td_trajectory_options *options, td_error *error)
{
    const td_trajectory_options defaults = td_trajectory_options_default();
    plan p = {.via = via, .via_count = via_count, .nearest = nearest};
    p.arm = (td_arm){robot, tool, options ? options : &defaults, 0};
    *trajectory = NULL;
    if (nearest) *nearest = (td_nearest){.via = -1};
    TD_TRY(check_options(p.arm.options, error));
    TD_TRY(check_joints(robot, q, "the start", error));
    if (tool) TD_TRY(check_tool(&p.arm, error));
    TD_TRY(check_vias(&p, error));
    p.arm.pump_m3_s = p.arm.options->pump_m3_s > 0 ? p.arm.options->pump_m3_s : td_robot_pump(robot);
    memcpy(p.q, q, (size_t)robot->joint_count * sizeof *q);
    return make(trajectory, &p, error);
}
