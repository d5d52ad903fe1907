/* A task simulated from where the machine stands, in a process aside: what a master vouches for, and what the
 * machine holds against it. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "apps/machine_internal.h"

/* What two computers may make of the same task. */
static const double SAME_START = 0.01, SAME_END = 0.01; /* rad or m */
static const double SAME_SHARE = 0.02, SAME_FORCE_SHARE = 0.15, SAME_FORCE_N = 1e4;
/* Who digs knows the ground by what he sees of it: how long soil holds the bucket, and how hard, is known to
 * so much. */
static const double SOIL_SHARE = 0.2, SOIL_FORCE_SHARE = 0.5, SOIL_END = 0.05;

/* ---- simulated ---- */

static void keep(machine_verdict *v, const task_run *run, int joints)
{
    td_machine_validation *x = &v->validation;
    x->joints = joints;
    x->duration_s = run->took_s;
    v->cpu_s = run->cpu_s;
    memcpy(x->force, run->peak, sizeof x->force);
    memcpy(x->end, run->to, sizeof x->end);
}

/* On few points of its ground, which the arm's weight moves over, it may find no rest there that is quite
 * where it stands: then the ground is laid under it. */
static td_status stand(station **made, const scenario *s, const machine_check *c, td_error *error)
{
    const td_status status = station_new(made, s->robot, &s->options, &c->start, c->map, &s->ground, error);
    if (status != TD_ERROR_CONVERGENCE) return status;
    rehearse *r = calloc(1, sizeof *r);
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "no memory for a simulation");
    r->scenario = *s; /* lent */
    r->state = c->start;
    const td_status laid = rehearse_imagine(made, r, NULL, c->map, error);
    free(r);
    return laid;
}

static td_status simulate(machine_verdict *v, const machine_check *c, td_error *error)
{
    scenario s = *c->s;
    task_setup setup = *s.task;
    task_run run = {0};
    td_behaviour logic;
    task_world w = {.task_id = 1, .logic = &logic, .plan = c->plan};
    setup.task = c->task;
    s.task = &setup;
    td_behaviour_begin(&logic, NULL);
    logic.options.singularity = setup.singularity;
    TD_TRY(stand(&w.station, &s, c, error));
    const td_status status = task_run_in(&run, &s, &w, NULL, error);
    if (status == TD_OK) keep(v, &run, s.robot->joint_count);
    if (status == TD_OK && logic.phase != TD_PHASE_SIMULATED) {
        snprintf(v->why, sizeof v->why, "%s", td_fault_text(run.fault));
        for (size_t i = 0; i < run.note_count; i++)
            if (run.note[i].kind == NOTE_REPORT && run.note[i].text[0])
                snprintf(v->why, sizeof v->why, "%s", run.note[i].text);
    }
    task_run_free(&run);
    station_free(&w.station);
    td_dig_plan_free(&w.made);
    return status;
}

static bool work(void *user, FILE *out)
{
    machine_check *c = user;
    machine_verdict v = {0};
    td_error error = {0};
    td_pose base = c->start.site_from_vehicle;
    if (td_task_check(c->task, c->s->robot, &base, &error) != TD_OK || simulate(&v, c, &error) != TD_OK)
        snprintf(v.why, sizeof v.why, "%s", error.message);
    memcpy(v.validation.model, c->model, sizeof v.validation.model);
    memcpy(v.validation.start, c->start.q, sizeof v.validation.start);
    if (td_task_hash(v.validation.task, c->task, &error) != TD_OK) return false;
    return fwrite(&v, sizeof v, 1, out) == 1;
}

td_status machine_check_begin(machine_check *check, td_error *error)
{
    for (int k = 0; k < check->s->robot->joint_count; k++) {
        const td_robot_joint *j = check->s->robot->joint + k;
        check->start.q[k] = fmax(j->lower, fmin(j->upper, check->start.q[k]));
        check->start.dq[k] = 0;
    }
    memset(check->start.twist, 0, sizeof check->start.twist);
    check->start.time_s = 0;
    return aside_begin(&check->work, work, check, 0, error);
}

bool machine_check_poll(machine_verdict *found, machine_check *check)
{
    size_t size = 0;
    if (!aside_poll(check->work)) return false;
    const machine_verdict *v = aside_bytes(check->work, &size);
    *found = (machine_verdict){0};
    if (v && size == sizeof *v)
        memcpy(found, v, sizeof *v);
    else
        snprintf(found->why, sizeof found->why, "the simulation did not end as it should");
    aside_free(&check->work);
    return true;
}

/* ---- compared ---- */

static bool digs_in(const td_task *task)
{
    for (int i = 0; task && i < task->step_count; i++)
        if (task->step[i].kind == TD_TASK_DIG) return true;
    return false;
}

bool machine_agrees(char *why, size_t size, const scenario *s, const td_task *task,
                    const td_machine_validation *his, const td_machine_validation *own)
{
    const td_robot *r = s->robot;
    const bool digs = digs_in(task);
    const double same_share = digs ? SOIL_SHARE : SAME_SHARE, same_end = digs ? SOIL_END : SAME_END,
                 same_force = digs ? SOIL_FORCE_SHARE : SAME_FORCE_SHARE;
    why[0] = 0;
    if (strcmp(his->task, own->task) != 0)
        snprintf(why, size,
                 "the task that came is not the one that was validated: its hash is %.8s, not %.8s",
                 own->task, his->task);
    else if (strcmp(his->model, own->model) != 0)
        snprintf(why, size, "it was validated on another machine: model %.8s, not %.8s", his->model,
                 own->model);
    else if (his->joints != r->joint_count)
        snprintf(why, size, "it was validated with %d joints, the machine has %d", his->joints,
                 r->joint_count);
    for (int k = 0; k < r->joint_count && !why[0]; k++)
        if (!(fabs(his->start[k] - own->start[k]) <= SAME_START))
            snprintf(why, size, "it was validated from %s at %.4f, which stands at %.4f", r->joint[k].name,
                     his->start[k], own->start[k]);
    if (why[0] || own->duration_s == 0) return !why[0]; /* 0: not simulated yet */
    if (!(fabs(his->duration_s - own->duration_s) <= 2 * s->period_s + same_share * own->duration_s))
        snprintf(why, size, "it was validated to take %.2f s, and takes %.2f s here", his->duration_s,
                 own->duration_s);
    for (int k = 0; k < r->joint_count && !why[0]; k++) {
        if (!(fabs(his->end[k] - own->end[k]) <= same_end))
            snprintf(why, size, "it was validated to leave %s at %.4f, and leaves it at %.4f here",
                     r->joint[k].name, his->end[k], own->end[k]);
        else if (!(fabs(his->force[k] - own->force[k]) <= same_force * own->force[k] + SAME_FORCE_N))
            snprintf(why, size, "it was validated to push %s with %.0f kN, and pushes with %.0f kN here",
                     r->joint[k].name, 1e-3 * his->force[k], 1e-3 * own->force[k]);
    }
    return !why[0];
}
