#include "servo/jog.h"

#include <math.h>
#include <string.h>

#include "servo/controller_internal.h"

td_status td_jog_start(td_jog *jog, const td_robot *robot, const td_motion_limits *limits,
                       td_command_kind kind, td_error *error)
{
    const td_motion_limits l = limits ? *limits : td_motion_limits_default();
    TD_TRY(td_controller_check(&l, kind, robot, error));
    *jog = (td_jog){.robot = robot, .limits = l, .kind = kind};
    return TD_OK;
}

static td_status check_tool(const td_jog_wish *w, const td_robot *robot, double *length, td_error *error)
{
    *length = sqrt(w->axis[0] * w->axis[0] + w->axis[1] * w->axis[1] + w->axis[2] * w->axis[2]);
    if (w->link < 0 || w->link >= robot->link_count)
        return td_fail(error, TD_ERROR_ARGUMENT, "jog: robot '%s' has no link %d", robot->name, w->link);
    if (!(*length > 1e-9 && isfinite(*length)) || !(w->speed_m_s >= 0 && isfinite(w->speed_m_s)))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "jog: the tool's axis has no length, or its speed is no number of at least 0");
    return TD_OK;
}

/* The rates that the stick asks for. */
static td_status ask(double *rate, const td_jog *jog, const td_jog_wish *w, const double *q, td_error *error)
{
    const td_robot *robot = jog->robot;
    if (w->kind == TD_JOG_NOTHING) return TD_OK;
    if (!isfinite(w->stick)) return td_fail(error, TD_ERROR_ARGUMENT, "jog: the stick is no number");
    const double stick = fmax(-1, fmin(1, w->stick));
    if (w->kind == TD_JOG_JOINT) {
        if (w->joint < 0 || w->joint >= robot->joint_count)
            return td_fail(error, TD_ERROR_ARGUMENT, "jog: robot '%s' has no joint %d", robot->name,
                           w->joint);
        rate[w->joint] = stick * robot->joint[w->joint].speed * jog->limits.speed_share;
        return TD_OK;
    }
    double length, velocity[3];
    TD_TRY(check_tool(w, robot, &length, error));
    for (int i = 0; i < 3; i++) velocity[i] = stick * w->speed_m_s * w->axis[i] / length;
    if (td_point_rates(rate, robot, q, w->link, w->point_m, velocity)) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "jog: the tool's point or a joint's angle is no number");
}

td_status td_jog_step(td_plant_command *command, td_jog *jog, const td_jog_wish *wish,
                      const td_plant_state *state, td_error *error)
{
    double rate[TD_ROBOT_MAX_JOINTS] = {0};
    const td_status asked = ask(rate, jog, wish, state->q, error);
    if (asked != TD_OK) memset(rate, 0, sizeof rate);
    const td_status given =
        td_controller_give(command, jog->rate, rate, &jog->limits, jog->kind, jog->robot, state,
                           wish->kind == TD_JOG_TOOL, asked == TD_OK ? error : NULL);
    return asked != TD_OK ? asked : given;
}
