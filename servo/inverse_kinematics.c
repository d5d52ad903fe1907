/* Where the joints must stand for the tool to be at a place, or as near to it as limits let. */
#include <math.h>
#include <string.h>

#include "core/random.h"
#include "servo/trajectory_generator_internal.h"

enum { STARTS = 16, STEPS = 120 };
static const double THERE = 1e-8;   /* m, rad: sought */
static const double REACHED = 1e-4; /* m, rad: enough, for in a singularity the last way is slow */
static const double LONGEST = 0.5;  /* rad, m: of a step */
static const double PI = 3.14159265358979323846;

/* Half the weighted square of what is missing; INFINITY where the rows are undetermined. */
static double miss(double *difference, double *jacobian, const td_arm *arm, const double *value,
                   const double *q)
{
    double at[TD_TOOL_ROWS], wanted[TD_TOOL_ROWS], sum = 0;
    if (!td_tool_rows(at, jacobian, arm, q)) return INFINITY;
    memcpy(wanted, value, sizeof wanted);
    td_tool_unwrap(wanted, at, arm->tool);
    for (int i = 0; i < arm->tool->row_count; i++) {
        const double weight = td_tool_weight(arm, i);
        difference[i] = wanted[i] - at[i];
        sum += weight * weight * difference[i] * difference[i];
    }
    return sum / 2;
}

/* A damped step in which joints at a limit do not push against it. */
static void step(double *dq, const td_arm *arm, const double *jacobian, const double *difference,
                 const double *q, double damping)
{
    const td_robot *r = arm->robot;
    td_inverse inverse;
    bool held[TD_ROBOT_MAX_JOINTS] = {false}, again = true;
    while (again) {
        again = false;
        td_inverse_make(&inverse, arm, jacobian, held, damping);
        td_inverse_apply(dq, &inverse, difference);
        for (int k = 0; k < r->joint_count; k++) {
            const bool out =
                (q[k] <= r->joint[k].lower && dq[k] < 0) || (q[k] >= r->joint[k].upper && dq[k] > 0);
            if (out && !held[k]) held[k] = again = true;
        }
    }
}

/* Levenberg and Marquardt's method within the limits, from q; the miss that is left. */
static double descend(double *q, const td_arm *arm, const double *value)
{
    const td_robot *r = arm->robot;
    double difference[TD_TOOL_ROWS], jacobian[TD_TOOL_ROWS * TD_ROBOT_MAX_JOINTS], damping = 0.1;
    double now = miss(difference, jacobian, arm, value, q);
    for (int i = 0; i < STEPS && now > THERE * THERE / 4 && isfinite(now) && damping < 1e6; i++) {
        double dq[TD_ROBOT_MAX_JOINTS], next[TD_ROBOT_MAX_JOINTS], most = 0, moved = 0;
        double other[TD_TOOL_ROWS], slope[TD_TOOL_ROWS * TD_ROBOT_MAX_JOINTS];
        step(dq, arm, jacobian, difference, q, damping);
        for (int k = 0; k < r->joint_count; k++) most = fmax(most, fabs(dq[k]));
        for (int k = 0; k < r->joint_count; k++) {
            const double wanted = q[k] + dq[k] * (most > LONGEST ? LONGEST / most : 1);
            next[k] = fmin(fmax(wanted, r->joint[k].lower), r->joint[k].upper);
            moved = fmax(moved, fabs(next[k] - q[k]));
        }
        if (moved < 1e-13) break;
        const double then = miss(other, slope, arm, value, next);
        if (then < now) {
            const bool stalled = now - then < 1e-12 * now;
            now = then;
            memcpy(q, next, (size_t)r->joint_count * sizeof *q);
            memcpy(difference, other, sizeof other);
            memcpy(jacobian, slope, sizeof slope);
            damping /= 5;
            if (stalled) break;
        } else {
            damping *= 4;
        }
    }
    return now;
}

/* The middle of every range first, then places drawn from them. */
static void start(double *q, const td_arm *arm, const double *from, int index, td_random *random)
{
    for (int k = 0; k < arm->robot->joint_count; k++) {
        const td_robot_joint *j = arm->robot->joint + k;
        const bool turns = j->kind != TD_JOINT_PRISMATIC;
        const double lower = isfinite(j->lower) ? j->lower : from[k] - (turns ? PI : 1),
                     upper = isfinite(j->upper) ? j->upper : from[k] + (turns ? PI : 1);
        q[k] = lower + (index == 1 ? 0.5 : td_random_uniform(random)) * (upper - lower);
    }
}

/* Joints that do not move the tool stay where they are. */
bool td_reach(double *q, double *off_m, double *off_rad, const td_arm *arm, const double *value)
{
    const size_t size = (size_t)arm->robot->joint_count * sizeof *q;
    td_random random = td_random_seed(1, 1);
    double best = INFINITY, from[TD_ROBOT_MAX_JOINTS], difference[TD_TOOL_ROWS] = {0};
    bool moves[TD_ROBOT_MAX_JOINTS];
    td_tool_joints(moves, arm);
    memcpy(from, q, size);
    for (int i = 0; i < STARTS && best > THERE * THERE / 2; i++) {
        double at[TD_ROBOT_MAX_JOINTS];
        memcpy(at, from, size);
        if (i > 0) start(at, arm, from, i, &random);
        for (int k = 0; k < arm->robot->joint_count; k++)
            if (!moves[k]) at[k] = from[k];
        const double left = descend(at, arm, value);
        if (!(left < best)) continue;
        best = left;
        memcpy(q, at, size);
    }
    miss(difference, NULL, arm, value, q);
    td_tool_off(off_m, off_rad, arm->tool, difference);
    return *off_m <= REACHED && *off_rad <= REACHED;
}
