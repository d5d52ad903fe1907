/* The joints along a path of the tool: each step by the inverse of the Jacobian, then corrected onto the
 * path. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "servo/trajectory_generator_internal.h"

enum {
    LEAST_STEPS = 24,
    MOST_STEPS = 4000,
    CORNER_STEPS = 12,
    CORRECTIONS = 8,
    LAST_CORRECTIONS = 10,
    WHY = 160
};
static const double TURN = 0.03;     /* rad or m of a joint in a step */
static const double CATCH_UP = 0.05; /* rad or m of a joint in a correction */
static const double STIFF = 1; /* of the way in which what avoids limits would settle; at 2 it never does */
static const double ON_PATH = 1e-10; /* m, rad */
static const double AT_GOAL = 1e-4;  /* m, rad */
static const double THERE = 1e-6;    /* m, rad: less, and a singularity is over */

typedef struct walk {
    const td_arm *arm;
    const td_polyline *line;
    td_path *path;
    td_nearest *nearest;
    int joints;    /* that move the tool */
    bool singular; /* an event is open */
    td_inverse inverse;
    double stiff; /* of the last rates, 1/m */
    double off_m, off_rad;
} walk;

/* dq/ds at s. */
static bool rates(double *dq, walk *w, const double *q, double s)
{
    double at[TD_TOOL_ROWS], jacobian[TD_TOOL_ROWS * TD_ROBOT_MAX_JOINTS], along[TD_TOOL_ROWS];
    if (!td_tool_rows(at, jacobian, w->arm, q)) return false;
    td_polyline_at(NULL, along, NULL, w->line, s);
    td_inverse_make(&w->inverse, w->arm, jacobian, NULL, 0);
    td_inverse_apply(dq, &w->inverse, along);
    w->stiff = w->arm->tool->row_count < w->joints ? td_inverse_avoid(dq, &w->inverse, w->arm, q) : 0;
    return true;
}

static double most_of(const double *x, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++) most = fmax(most, fabs(x[i]));
    return most;
}

/* Newton's method onto X(s). */
static bool correct(double *q, walk *w, double s)
{
    const int n = w->arm->robot->joint_count, m = w->arm->tool->row_count;
    double at[TD_TOOL_ROWS], jacobian[TD_TOOL_ROWS * TD_ROBOT_MAX_JOINTS], wanted[TD_TOOL_ROWS],
        missing[TD_TOOL_ROWS], dq[TD_ROBOT_MAX_JOINTS];
    double budget = CATCH_UP;
    td_polyline_at(wanted, NULL, NULL, w->line, s);
    for (int i = 0;; i++) {
        if (!td_tool_rows(at, jacobian, w->arm, q)) return false;
        td_tool_unwrap(at, wanted, w->arm->tool);
        for (int k = 0; k < m; k++) missing[k] = wanted[k] - at[k];
        td_tool_off(&w->off_m, &w->off_rad, w->arm->tool, missing);
        td_inverse_make(&w->inverse, w->arm, jacobian, NULL, 0);
        if (fmax(w->off_m, w->off_rad) < ON_PATH || i == CORRECTIONS || budget <= 0) return true;
        td_inverse_apply(dq, &w->inverse, missing);
        const double most = most_of(dq, n), part = most > budget ? budget / most : 1;
        for (int k = 0; k < n; k++) q[k] += part * dq[k];
        budget -= part * most;
    }
}

/* How far to go from s: fine where joints turn fast, and through corners. */
static double step_from(const walk *w, double s, double speed)
{
    const td_polyline *line = w->line;
    const double all = line->s[line->count - 1];
    double ds = fmin(all / LEAST_STEPS, TURN / fmax(speed, 1e-9));
    ds = fmin(ds, STIFF / fmax(w->stiff, 1e-9));
    for (size_t i = 1; i + 1 < line->count; i++)
        if (s < line->s[i] + line->half[i] && s + ds > line->s[i] - line->half[i])
            ds = fmin(ds, fmax(line->s[i] - line->half[i] - s, 2 * line->half[i] / CORNER_STEPS));
    ds = fmax(ds, all / MOST_STEPS);
    return (all - s) / ceil((all - s) / ds - 1e-9);
}

static void note_singularity(walk *w, double s)
{
    td_path *path = w->path;
    const size_t capacity = sizeof path->event / sizeof *path->event;
    const bool now = w->inverse.damping > 0 || fmax(w->off_m, w->off_rad) > THERE;
    if (now && !w->singular && path->event_count < capacity)
        path->event[path->event_count++] = (td_trajectory_event){
            .kind = TD_TRAJECTORY_SINGULAR, .from_s = s, .joint = -1, .least = w->inverse.least};
    w->singular = now;
    if (!now) return;
    td_trajectory_event *event = path->event + path->event_count - 1;
    event->to_s = s;
    event->least = fmin(event->least, w->inverse.least);
    event->damping = fmax(event->damping, w->inverse.damping);
    event->off_m = fmax(event->off_m, w->off_m);
    event->off_rad = fmax(event->off_rad, w->off_rad);
}

/* The way to the via ends at q, before s: says why and leaves where that is. */
static td_status stuck(const walk *w, const double *q, double s, const char *why, td_error *error)
{
    const td_polyline *line = w->line;
    const int n = w->arm->robot->joint_count;
    size_t corner = 1;
    while (corner + 1 < line->count && line->s[corner] < s) corner++;
    const size_t via = line->via[corner];
    td_nearest nearest = {.via = (int)via};
    double at[TD_TOOL_ROWS], missing[TD_TOOL_ROWS];
    memcpy(nearest.q, q, (size_t)n * sizeof *q);
    td_tool_pose(nearest.pose, w->arm->robot, w->arm->tool, q);
    td_tool_rows(at, NULL, w->arm, q);
    td_tool_unwrap(at, line->point + corner * (size_t)line->size, w->arm->tool);
    for (int i = 0; i < w->arm->tool->row_count; i++)
        missing[i] = line->point[corner * (size_t)line->size + (size_t)i] - at[i];
    td_tool_off(&nearest.off_m, &nearest.off_rad, w->arm->tool, missing);
    if (w->nearest) *w->nearest = nearest;
    return td_fail(
        error, TD_ERROR_DATA,
        "via %zu: on the straight line to it %s, %.3g m and %.3g rad before it (tool at x %.3f, y %.3f, "
        "z %.3f m): add a via, move the joints there, or ask for fewer rows",
        via + 1, why, nearest.off_m, nearest.off_rad, nearest.pose[0], nearest.pose[1], nearest.pose[2]);
}

/* What forbids to stand at q, in `why`; joints that rounding carried out are put back. */
static bool forbidden(char why[WHY], const walk *w, double *q)
{
    static const double rounding = 1e-9;
    const td_robot *r = w->arm->robot;
    for (int k = 0; k < r->joint_count; k++) {
        const td_robot_joint *j = r->joint + k;
        if (q[k] < j->lower - rounding || q[k] > j->upper + rounding) {
            snprintf(why, WHY, "joint '%s' meets its limit of %.4g", j->name,
                     q[k] < j->lower ? j->lower : j->upper);
            return true;
        }
        q[k] = fmin(fmax(q[k], j->lower), j->upper);
    }
    if (w->off_m > w->arm->options->off_m || w->off_rad > w->arm->options->off_rad) {
        snprintf(why, WHY, "a singularity holds the tool back by more than %g m or %g rad",
                 w->arm->options->off_m, w->arm->options->off_rad);
        return true;
    }
    return false;
}

/* One step: the midpoint rule, then onto the path. */
static td_status advance(walk *w, double *q, double *s, td_error *error)
{
    static const char upright[] =
        "the tool's y axis stands nearly upright, where its angles are undetermined";
    const int n = w->arm->robot->joint_count;
    double dq[TD_ROBOT_MAX_JOINTS], next[TD_ROBOT_MAX_JOINTS];
    char why[WHY];
    if (!rates(dq, w, q, *s)) return stuck(w, q, *s, upright, error);
    const double ds = step_from(w, *s, most_of(dq, n));
    for (int k = 0; k < n; k++) next[k] = q[k] + ds / 2 * dq[k];
    if (!rates(dq, w, next, *s + ds / 2)) return stuck(w, q, *s, upright, error);
    for (int k = 0; k < n; k++) next[k] = q[k] + ds * dq[k];
    if (!correct(next, w, *s + ds)) return stuck(w, q, *s, upright, error);
    if (forbidden(why, w, next)) return stuck(w, q, *s, why, error);
    memcpy(q, next, (size_t)n * sizeof *q);
    *s += ds;
    note_singularity(w, *s);
    return td_path_add(w->path, *s, q, error);
}

td_status td_path_of_tool(td_path *path, td_nearest *nearest, const td_arm *arm, const td_polyline *line,
                          double *q, td_error *error)
{
    walk w = {.arm = arm, .line = line, .path = path, .nearest = nearest};
    const double all = line->s[line->count - 1];
    double s = 0, first[TD_ROBOT_MAX_JOINTS], last[TD_ROBOT_MAX_JOINTS];
    char why[WHY];
    bool moves[TD_ROBOT_MAX_JOINTS];
    td_tool_joints(moves, arm);
    for (int k = 0; k < arm->robot->joint_count; k++) w.joints += moves[k];
    path->n = arm->robot->joint_count;
    TD_TRY(td_path_add(path, 0, q, error));
    if (!rates(first, &w, q, 0))
        return stuck(&w, q, 0, "the tool's y axis stands nearly upright at the start", error);
    while (all - s > 1e-9 * all) TD_TRY(advance(&w, q, &s, error));
    for (int i = 0; fmax(w.off_m, w.off_rad) > ON_PATH && i < LAST_CORRECTIONS; i++)
        if (!correct(q, &w, all)) break;
    memcpy(path->q + (path->count - 1) * (size_t)path->n, q, (size_t)path->n * sizeof *q);
    if (fmax(w.off_m, w.off_rad) > AT_GOAL || forbidden(why, &w, q))
        return stuck(&w, q, all, "a singularity holds the tool back at its end", error);
    if (!rates(last, &w, q, all)) return stuck(&w, q, all, "the tool's y axis stands nearly upright", error);
    return td_path_spline(path, first, last, error);
}
