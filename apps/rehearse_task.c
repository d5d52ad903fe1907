/* What moves: simulated ahead on the map, validated, downloaded, executed by the machine as it truly is. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"

#define DEGREES 57.29577951308232

static const double ALARM = 6;            /* sigma */
static const double MOST_PROBABLE = 0.01; /* contact that is not meant, of a motion that is validated */

void rehearse_stop(rehearse *r, const char *format, ...)
{
    va_list list;
    if (r->stopped) return;
    r->stopped = true;
    va_start(list, format);
    vsnprintf(r->why, sizeof r->why, format, list);
    va_end(list);
}

void rehearse_order(rehearse *r, td_event event, uint32_t task_id)
{
    td_behaviour_outputs out;
    const td_behaviour_inputs in = {.events = TD_EVENT_BIT(event),
                                    .links_open = true,
                                    .parameters_read = true,
                                    .task = task_id,
                                    .machine_task = event >= TD_EVENT_EXECUTE ||
                                                            event == TD_EVENT_DOWNLOADED ||
                                                            r->logic.phase == TD_PHASE_EXECUTING
                                                        ? task_id
                                                        : 0};
    td_behaviour_react(&r->logic, &in, &out);
}

/* Of all that decides the motion: the task, the map it was planned on, and where the machine stood. */
static td_status identify(uint32_t *id, const td_task *task, const td_elevation *map, const double *q,
                          td_error *error)
{
    char hex[TD_HASH_HEX_SIZE];
    td_hash *hash = NULL;
    const size_t cells = (size_t)map->columns * (size_t)map->rows;
    TD_TRY(td_task_hash(hex, task, error));
    TD_TRY(td_hash_new(&hash, error));
    td_hash_add(hash, hex, strlen(hex));
    td_hash_add(hash, map->height, cells * sizeof *map->height);
    td_hash_add(hash, map->sigma, cells * sizeof *map->sigma);
    td_hash_add(hash, q, TD_ROBOT_MAX_JOINTS * sizeof *q);
    TD_TRY(td_hash_finish(hex, &hash, error));
    hex[8] = 0;
    *id = (uint32_t)strtoul(hex, NULL, 16) | 1;
    return TD_OK;
}

static const char *why_failed(const task_run *run)
{
    const char *text = td_fault_text(run->fault);
    for (size_t i = 0; i < run->note_count; i++)
        if (run->note[i].kind == NOTE_REPORT && run->note[i].text[0]) text = run->note[i].text;
    return text;
}

/* ---- ahead ---- */

static td_status simulate(task_run *run, rehearse *r, const scenario *s, const td_elevation *map,
                          task_world *w, td_error *error)
{
    td_error why = {0};
    TD_TRY(identify(&w->task_id, s->task->task, map, r->state.q, error));
    const td_status made = rehearse_imagine(&w->station, r, NULL, map, &why);
    if (made == TD_ERROR_MEMORY) return td_fail(error, made, "%s", why.message);
    if (made != TD_OK) {
        rehearse_stop(r, "the machine as the map has it: %s", why.message);
        return TD_OK;
    }
    w->logic = &r->logic;
    const td_status status = task_run_in(run, s, w, r->progress, error);
    station_free(&w->station);
    TD_TRY(status);
    r->deadline_misses += run->late;
    if (run->time_s > 0 && run->cpu_s > 0) r->real_time = fmin(r->real_time, run->time_s / run->cpu_s);
    r->clearance_m = fmin(r->clearance_m, run->dug.clearance_m);
    r->probability = fmax(r->probability, run->dug.probability);
    if (r->logic.phase != TD_PHASE_SIMULATED) rehearse_stop(r, "simulated ahead: %s", why_failed(run));
    return TD_OK;
}

/* The map as it may be: all of it higher or lower together by its own sigma. */
static td_status draw_map(td_elevation **drawn, const rehearse *r, uint64_t stream, td_error *error)
{
    td_random random = td_random_seed(r->seed, 500 + stream);
    const double z = td_random_normal(&random);
    TD_TRY(td_elevation_copy(drawn, r->map, error));
    const size_t cells = (size_t)r->map->columns * (size_t)r->map->rows;
    for (size_t i = 0; i < cells; i++)
        if (!isnan(r->map->sigma[i])) (*drawn)->height[i] += (float)z * r->map->sigma[i];
    return TD_OK;
}

static td_status draw_one(bool *done, rehearse *r, rehearse_round *round, uint64_t stream, td_error *error)
{
    rehearse_draw draw = {0};
    task_run run = {0};
    td_elevation *map = NULL;
    td_behaviour logic;
    td_behaviour_begin(&logic, NULL);
    task_world w = {.zero = draw.zero, .task_id = 1, .logic = &logic, .plan = round->plan};
    td_status status = rehearse_draw_make(&draw, r, stream, error);
    if (status == TD_OK) status = draw_map(&map, r, stream, error);
    if (status == TD_OK) status = rehearse_imagine(&w.station, r, &draw, map, error);
    if (status == TD_OK) status = task_run_in(&run, &r->scenario, &w, r->progress, error);
    if ((*done = status == TD_OK)) monitor_learn(&round->monitor, &run);
    station_free(&w.station);
    td_elevation_free(&map);
    task_run_free(&run);
    rehearse_draw_free(&draw);
    return status;
}

/* The same task by machines on soils as they may be: how far what happens may lie off what is predicted. A
 * machine that cannot be drawn, or that does not come to rest, tells nothing. */
static td_status learn(rehearse *r, rehearse_round *round, td_error *error)
{
    td_error why = {0};
    int learnt = 0;
    TD_TRY(monitor_begin(&round->monitor, &round->ahead, r->scenario.robot->joint_count, ALARM, error));
    for (int i = 0; i < r->setup->draws; i++) {
        const uint64_t stream = 1 + (uint64_t)((r->round_count - 1) * REHEARSE_MAX_DRAWS + i);
        bool done = false;
        const td_status status = draw_one(&done, r, round, stream, &why);
        if (status == TD_ERROR_MEMORY || status == TD_ERROR_CANCELLED)
            return td_fail(error, status, "%s", why.message);
        learnt += done;
    }
    if (!learnt) rehearse_stop(r, "how far the motion may lie off is not known: %s", why.message);
    monitor_learnt(&round->monitor);
    return TD_OK;
}

td_status rehearse_ahead(rehearse *r, rehearse_round *round, td_error *error)
{
    task_world w = {.floor = r->round_count > 1 ? &r->floor : NULL};
    r->scenario.map = r->map;
    const td_status status = simulate(&round->ahead, r, &r->scenario, r->map, &w, error);
    r->scenario.map = NULL;
    round->plan = w.made;
    return status;
}

/* ---- executed ---- */

/* What the operator does with a simulated task, and the link. */
static void hand_over(rehearse *r, const task_run *ahead, uint32_t id)
{
    if (ahead->dug.probability > MOST_PROBABLE) {
        rehearse_stop(r, "not validated: a contact that is not meant has a probability of %.3f",
                      ahead->dug.probability);
        return;
    }
    rehearse_order(r, TD_EVENT_VALIDATE, id);
    rehearse_order(r, TD_EVENT_DOWNLOAD, id);
    rehearse_order(r, TD_EVENT_DOWNLOADED, id);
    if (r->logic.phase != TD_PHASE_DOWNLOADED)
        rehearse_stop(r, "the machine does not hold the task that was validated (%s)",
                      td_phase_text(r->logic.phase));
}

static td_status read_state(rehearse *r, td_error *error)
{
    const td_plant plant = station_plant(r->station);
    TD_TRY(plant.state(plant.self, &r->state, error));
    for (int k = 0; k < r->scenario.robot->joint_count; k++) r->state.q[k] += r->truth.zero[k];
    return TD_OK;
}

static td_status execute(task_run *run, rehearse *r, const scenario *s, const td_elevation *map,
                         const task_run *ahead, task_world *w, td_error *error)
{
    TD_TRY(identify(&w->task_id, s->task->task, map, r->state.q, error));
    hand_over(r, ahead, w->task_id);
    if (r->stopped) return TD_OK;
    if (r->far) return rehearse_far_execute(run, r, s, ahead, w, error);
    TD_TRY(station_believe(r->station, map, r->sigma_q, error));
    w->station = r->station;
    w->zero = r->truth.zero;
    w->logic = &r->logic;
    TD_TRY(task_run_in(run, s, w, r->progress, error));
    TD_TRY(rehearse_touched(r, run, error));
    r->clearance_m = fmin(r->clearance_m, run->dug.clearance_m);
    r->probability = fmax(r->probability, run->dug.probability);
    if (r->logic.phase != TD_PHASE_MONITORING)
        rehearse_stop(r, "stopped safely at %.1f s of the execution: %s", run->time_s, why_failed(run));
    return read_state(r, error);
}

td_status rehearse_execute(rehearse *r, rehearse_round *round, td_error *error)
{
    task_world w = {.plan = round->plan, .watch = monitor_watch, .user = r};
    TD_TRY(learn(r, round, error));
    if (r->stopped) return TD_OK;
    r->scenario.map = r->map;
    const td_status status = execute(&round->done, r, &r->scenario, r->map, &round->ahead, &w, error);
    r->scenario.map = NULL;
    round->executed = round->done.count > 0;
    return status;
}

/* ---- the arm alone ---- */

static td_status make_move(td_task **task, const rehearse *r, const double *q, td_error *error)
{
    char text[1000], *at = text, *const end = text + sizeof text;
    const td_robot *robot = r->scenario.robot;
    at += snprintf(at, (size_t)(end - at), "teledimos: task 1\nname: look\nsteps:\n  - position: {joints: {");
    for (int k = 0; k < robot->joint_count && at < end; k++)
        at += snprintf(at, (size_t)(end - at), "%s%s_%s: %.17g", k ? ", " : "", robot->joint[k].name,
                       robot->joint[k].kind == TD_JOINT_PRISMATIC ? "m" : "deg",
                       robot->joint[k].kind == TD_JOINT_PRISMATIC ? q[k] : DEGREES * q[k]);
    if (at < end) at += snprintf(at, (size_t)(end - at), "}, law: quintic}\n");
    if (at >= end) return td_fail(error, TD_ERROR_DATA, "the robot's joints have names that are too long");
    return td_task_parse(task, text, strlen(text), "the task of a look", error);
}

static td_status move(rehearse *r, const scenario *s, const td_elevation *map, td_error *error)
{
    task_run ahead = {0}, done = {0};
    task_world first = {0}, then = {0};
    td_status status = simulate(&ahead, r, s, map, &first, error);
    if (status == TD_OK && !r->stopped) status = execute(&done, r, s, map, &ahead, &then, error);
    if (status == TD_OK && done.count) rehearse_keep(r, &done, true, "the arm moved for a look");
    task_run_free(&ahead);
    task_run_free(&done);
    return status;
}

/* On the map as it is expected after what was executed last. */
td_status rehearse_move(rehearse *r, const double *q, td_error *error)
{
    const rehearse_round *last = r->round_count ? r->round + r->round_count - 1 : NULL;
    scenario s = r->scenario;
    task_setup setup = *s.task;
    td_task *task = NULL;
    TD_TRY(make_move(&task, r, q, error));
    setup.task = task;
    s.task = &setup;
    const td_status status = move(r, &s, last && last->executed ? last->ahead.after : r->map, error);
    td_task_free(&task);
    return status;
}
