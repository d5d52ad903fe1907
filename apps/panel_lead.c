#include "apps/panel_lead.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double CHECKED_S = 120; /* the machine's own simulation of a task */

/* ---- what it says ---- */

static void take_answer(panel_lead *l, const td_machine_answer *a)
{
    const bool task = a->kind == TD_MACHINE_TASK;
    if (!task && a->order == TD_ORDER_REINIT) l->renewed = l->reinit = l->reinit && a->accepted;
    if (task && l->sends) l->held = a->accepted;
    if (a->accepted || (!task && a->order != TD_ORDER_EXECUTE && a->order != TD_ORDER_MANUAL)) return;
    snprintf(l->why, sizeof l->why, "the machine does not take %s: %.300s",
             task ? "the task" : td_machine_order_name(a->order), a->text);
}

static void hear(panel_lead *l)
{
    for (far_heard *h; (h = far_machine_hear(l->machine)); far_machine_heard(l->machine, h)) {
        if (h->kind == FAR_ANSWERED) take_answer(l, &h->answer);
        if (h->kind != FAR_UNLINKED) continue;
        l->reinit = l->renewed = l->sends = l->held = l->begun = false;
        l->now.open = false;
    }
    (void)far_machine_state(&l->now, l->machine);
}

static bool is_executing(td_phase phase)
{
    return phase == TD_PHASE_EXECUTING || phase == TD_PHASE_EXECUTION_PAUSED;
}

/* Of the task that it was given: its end, or that it was given up. */
static void watch_execution(panel_lead *l, live_seen *seen)
{
    const td_machine_state_message *s = &l->now.state;
    const bool works = s->mode == TD_MODE_WORKING || s->mode == TD_MODE_PAUSED;
    l->begun = l->begun || works;
    if (strcmp(s->phase, td_phase_text(TD_PHASE_MONITORING)) == 0)
        seen->reports |= TD_EVENT_BIT(TD_EVENT_ENDED);
    else if (l->begun && s->mode == TD_MODE_REST)
        snprintf(l->why, sizeof l->why, "the machine gave up the task: %.300s", s->phase);
}

static void watch_download(panel_lead *l, live_seen *seen)
{
    const td_machine_state_message *s = &l->now.state;
    if (l->held && s->mode == TD_MODE_HOLDING && s->task[0] && strncmp(s->task, l->task, 8) == 0)
        seen->reports |= TD_EVENT_BIT(TD_EVENT_DOWNLOADED);
    else if (l->sends && td_machine_now_s() > l->since_s + CHECKED_S)
        snprintf(l->why, sizeof l->why, "the machine did not answer the task within %g s", CHECKED_S);
}

void panel_lead_look(panel_lead *l, td_phase phase, live_seen *seen)
{
    const td_machine_state_message *s = &l->now.state;
    hear(l);
    const bool failed = s->mode == TD_MODE_FAILED;
    if (l->renewed && !failed) l->reinit = l->renewed = false;
    *seen =
        (live_seen){.open = l->now.open && l->now.has_state && !(l->reinit && phase == TD_PHASE_PREPARING)};
    if (l->now.has_state) seen->state = &s->plant;
    if (phase == TD_PHASE_IDLE || phase == TD_PHASE_FAILED || !seen->open) {
        l->why[0] = 0;
        return;
    }
    if (is_executing(phase)) watch_execution(l, seen);
    if (phase == TD_PHASE_DOWNLOADING) watch_download(l, seen);
    if (failed) snprintf(l->why, sizeof l->why, "the machine: %.100s; %.200s", s->phase, s->fault);
    seen->holds = l->held && s->task[0] && strncmp(s->task, l->task, 8) == 0;
    if (!l->why[0]) return;
    seen->reports = TD_EVENT_BIT(TD_EVENT_PART_FAILED);
    memcpy(seen->why, l->why, sizeof seen->why);
    l->why[0] = 0;
}

/* ---- what it is told ---- */

static void order(panel_lead *l, td_machine_order what)
{
    const far_said said = {.kind = TD_MACHINE_ORDER, .order = what};
    if (what == TD_ORDER_REINIT) l->reinit = l->now.open, l->renewed = false;
    (void)far_machine_say(l->machine, &said);
}

static td_status send_task(panel_lead *l, const live_lead *lead, int joints, td_error *error)
{
    const task_run *run = lead->run;
    far_said said = {.kind = TD_MACHINE_TASK};
    td_machine_validation *v = &said.validation;
    TD_TRY(td_task_hash(v->task, lead->task, error));
    TD_TRY(td_task_text(&said.text, lead->task, error));
    v->joints = joints;
    v->duration_s = run->took_s;
    memcpy(v->start, run->from, sizeof v->start);
    memcpy(v->end, run->to, sizeof v->end);
    memcpy(v->force, run->peak, sizeof v->force);
    far_machine_model(v->model, l->machine);
    memcpy(l->task, v->task, sizeof l->task);
    l->held = l->begun = false;
    l->sends = far_machine_say(l->machine, &said);
    l->since_s = td_machine_now_s();
    if (!l->sends) snprintf(l->why, sizeof l->why, "the task cannot be sent now");
    return TD_OK;
}

static bool is_obeyed(const live_lead *lead, td_event event)
{
    return (lead->events & TD_EVENT_BIT(event)) && lead->out->answer[event] == TD_ANSWER_ACCEPTED;
}

static void move(panel_lead *l, const td_plant_command *command)
{
    const far_said said = {.kind = TD_MACHINE_JOINTS, .command = *command};
    (void)far_machine_say(l->machine, &said);
}

td_status panel_lead_on(panel_lead *l, const live_lead *lead, int joints, td_error *error)
{
    static const struct {
        td_event event;
        td_machine_order order;
    } orders[] = {{TD_EVENT_REINIT, TD_ORDER_REINIT},
                  {TD_EVENT_MANUAL, TD_ORDER_MANUAL},
                  {TD_EVENT_AUTOMATIC, TD_ORDER_AUTOMATIC}};
    const td_phase phase = lead->out->phase;
    far_machine_beat(l->machine);
    if (lead->out->fault != TD_FAULT_NONE || is_obeyed(lead, TD_EVENT_USER_STOP) ||
        is_obeyed(lead, TD_EVENT_ABORT)) {
        order(l, TD_ORDER_STOP);
        l->sends = l->sends && phase != TD_PHASE_READY;
        return TD_OK;
    }
    for (size_t i = 0; i < sizeof orders / sizeof *orders; i++)
        if (is_obeyed(lead, orders[i].event)) order(l, orders[i].order);
    if (is_obeyed(lead, TD_EVENT_DOWNLOAD)) return send_task(l, lead, joints, error);
    if (is_obeyed(lead, TD_EVENT_EXECUTE)) order(l, TD_ORDER_EXECUTE);
    if (is_obeyed(lead, TD_EVENT_PAUSE) && phase == TD_PHASE_EXECUTION_PAUSED) order(l, TD_ORDER_PAUSE);
    if (is_obeyed(lead, TD_EVENT_RESUME) && phase == TD_PHASE_EXECUTING) order(l, TD_ORDER_RESUME);
    if (phase == TD_PHASE_MANUAL && l->now.state.mode == TD_MODE_MANUAL) move(l, lead->command);
    return TD_OK;
}
