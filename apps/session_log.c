/* What a session keeps of what happened: notes, samples, the ground. */
#include "apps/session_internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

double session_time(const session *x)
{
    return (double)x->period * x->s->period_s;
}

/* ---- notes ---- */

td_status session_note(session *x, note_kind kind, const char *name, const char *text, td_error *error)
{
    task_run *r = x->run;
    if (r->note_count == r->note_room) {
        const size_t room = 2 * r->note_room + 64;
        task_note *more = realloc(r->note, room * sizeof *more);
        if (!more) return td_fail(error, TD_ERROR_MEMORY, "no memory for the events of a session");
        r->note = more;
        r->note_room = room;
    }
    task_note *n = r->note + r->note_count++;
    *n = (task_note){.period = x->period, .time_s = session_time(x), .kind = kind, .name = name, .joint = -1};
    snprintf(n->text, sizeof n->text, "%s", text);
    return TD_OK;
}

td_status session_report(session *x, td_event event, const char *text, td_error *error)
{
    x->reports |= TD_EVENT_BIT(event);
    return session_note(x, NOTE_REPORT, td_event_text(event), text, error);
}

td_pose session_tool(const session *x, const double *q, const td_pose *base)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, x->s->robot, q);
    const td_pose vehicle = td_pose_compose(at + x->tool_link, &x->link_from_tool);
    return td_pose_compose(base, &vehicle);
}

static td_status watch(session *x, const task_sample *a, td_error *error)
{
    const task_world *w = x->world;
    char why[400] = "";
    bool deviates = false;
    if (!w || !w->watch || a->phase != TD_PHASE_EXECUTING) return TD_OK;
    w->watch(w->user, a, &deviates, why, sizeof why);
    return deviates ? session_report(x, TD_EVENT_DEVIATION, why, error) : TD_OK;
}

double session_share(const session *x)
{
    return x->motion ? fmin(1, x->along_s / fmax(1e-9, td_trajectory_duration(x->motion))) : 1;
}

bool session_is_loose(const session *x)
{
    return session_cuts(x) || !x->step_begun || !(x->step < x->steps) ||
           (x->step >= 0 && x->setup->task->step[x->step].kind == TD_TASK_DRIVE);
}

td_status session_sample(session *x, td_error *error)
{
    task_run *r = x->run;
    if (x->live && x->live->lasting) r->count = 0;
    if (r->count == r->room) {
        const size_t room = 2 * r->room + 512;
        task_sample *more = room <= SIMULATE_MAX_ROWS ? realloc(r->sample, room * sizeof *more) : NULL;
        if (!more)
            return td_fail(error, TD_ERROR_MEMORY, "a session of more than %zu rows of the log", r->room);
        r->sample = more;
        r->room = room;
    }
    task_sample *a = r->sample + r->count++;
    *a = (task_sample){.time_s = session_time(x),
                       .phase = x->logic.phase,
                       .step = x->step < x->steps ? x->step : x->steps - 1,
                       .state = x->state};
    a->state.time_s = a->time_s;
    memcpy(a->wanted, x->wanted, sizeof a->wanted);
    memcpy(a->command, x->command.value, sizeof a->command);
    a->tool_wanted = session_tool(x, x->wanted, &x->base);
    a->tool = session_tool(x, x->state.q, &x->state.site_from_vehicle);
    a->pitch_wanted_rad = task_pitch(&a->tool_wanted);
    a->pitch_rad = task_pitch(&a->tool);
    a->motion = x->motions - 1;
    a->share = session_share(x);
    a->dig_phase = session_dig_phase(x);
    a->tool_true = a->tool;
    if (x->world && x->world->zero) {
        double q[TD_ROBOT_MAX_JOINTS];
        for (int k = 0; k < x->s->robot->joint_count; k++) q[k] = x->state.q[k] - x->world->zero[k];
        a->tool_true = session_tool(x, q, &x->state.site_from_vehicle);
    }
    const bool pressing = (x->out.drive == TD_DRIVE_SIMULATE || x->out.drive == TD_DRIVE_EXECUTE) &&
                          x->step < x->steps && x->step_begun &&
                          x->setup->task->step[x->step].kind == TD_TASK_PRESS;
    a->press_n = pressing ? x->press.force_n : NAN;
    a->loose = session_is_loose(x);
    if (x->machine) {
        double force[3];
        td_machine_contact_force(force, x->machine);
        a->contact_n = hypot(hypot(force[0], force[1]), force[2]);
        return TD_OK;
    }
    const td_soil_state soil = station_soil(x->station);
    a->contact_n = soil.cutting_n;
    a->load_kg = 1e-6 * (double)soil.bucket_mg;
    a->depth_m = soil.depth_m;
    return watch(x, a, error);
}

void session_keep_steady(session *x)
{
    task_run *r = x->run;
    const td_pose wanted = session_tool(x, x->wanted, &x->base),
                  is = session_tool(x, x->state.q, &x->state.site_from_vehicle);
    r->simulated = true;
    r->joint_off = 0;
    for (int i = 0; i < 3; i++) r->steady[i] = is.t[i] - wanted.t[i];
    for (int k = 0; k < x->s->robot->joint_count; k++)
        r->joint_off = fmax(r->joint_off, fabs(x->state.q[k] - x->wanted[k]));
}

/* What is further from where the machine began than it could be seen or dug from is left out: a map may be
 * large. */
static const double KEPT_M = 20;

td_status session_keep_ground(session *x, td_error *error)
{
    task_run *r = x->run;
    const td_elevation *map = NULL;
    TD_TRY(station_map(&map, x->station, error));
    if (r->ground_count == TASK_MAX_GROUNDS) td_elevation_free(&r->ground[--r->ground_count].map);
    task_ground *g = r->ground + r->ground_count;
    const double *at = x->s->start.site_from_vehicle.t;
    int low[2], high[2];
    for (int i = 0; i < 2; i++) {
        const int most = i ? map->rows : map->columns;
        low[i] = (int)fmax(0, fmin(most - 1, ceil((at[i] - KEPT_M - map->origin[i]) / map->cell_m)));
        high[i] = (int)fmax(low[i], fmin(most - 1, floor((at[i] + KEPT_M - map->origin[i]) / map->cell_m)));
    }
    const double origin[2] = {map->origin[0] + low[0] * map->cell_m, map->origin[1] + low[1] * map->cell_m};
    TD_TRY(td_elevation_new(&g->map, high[0] - low[0] + 1, high[1] - low[1] + 1, map->cell_m, origin,
                            map->frame, error));
    for (int row = low[1]; row <= high[1]; row++)
        for (int c = low[0]; c <= high[0]; c++) {
            const size_t from = (size_t)row * (size_t)map->columns + (size_t)c,
                         to = (size_t)(row - low[1]) * (size_t)g->map->columns + (size_t)(c - low[0]);
            g->map->height[to] = map->height[from];
            g->map->sigma[to] = map->sigma[from];
            g->map->provenance[to] = map->provenance[from];
        }
    g->time_s = session_time(x);
    r->ground_count++;
    return TD_OK;
}
