/* What the machine is told, and what it answers. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"

#define ORDER_BIT(order) (UINT32_C(1) << (order))

static const td_event events[TD_ORDER_COUNT] = {
    [TD_ORDER_EXECUTE] = TD_EVENT_EXECUTE,    [TD_ORDER_STOP] = TD_EVENT_ABORT,
    [TD_ORDER_PAUSE] = TD_EVENT_PAUSE,        [TD_ORDER_RESUME] = TD_EVENT_RESUME,
    [TD_ORDER_REINIT] = TD_EVENT_REINIT,      [TD_ORDER_MANUAL] = TD_EVENT_MANUAL,
    [TD_ORDER_AUTOMATIC] = TD_EVENT_AUTOMATIC};
/* What a session that comes to rest may be given; the others wait until it has. */
static const uint32_t IN_SESSION =
    ORDER_BIT(TD_ORDER_STOP) | ORDER_BIT(TD_ORDER_PAUSE) | ORDER_BIT(TD_ORDER_RESUME);

/* ---- orders ---- */

/* Who has just come waits until the machine is prepared. */
static bool is_preparing(const machine *m)
{
    return m->logic.phase == TD_PHASE_IDLE || m->logic.phase == TD_PHASE_PREPARING;
}

uint32_t machine_orders(machine *m)
{
    const bool at_work = m->shown == TD_PHASE_EXECUTING || m->shown == TD_PHASE_EXECUTION_PAUSED;
    const uint32_t may = m->in_session     ? (at_work ? UINT32_MAX : IN_SESSION)
                         : is_preparing(m) ? 0
                                           : UINT32_MAX;
    const uint32_t now = m->asked & may;
    uint32_t bits = 0;
    for (int o = 0; o < TD_ORDER_COUNT; o++)
        if (now & ORDER_BIT(o)) bits |= TD_EVENT_BIT(events[o]);
    m->asked &= ~now;
    m->unanswered |= now;
    return bits;
}

void machine_answer_orders(machine *m, const td_behaviour_outputs *out)
{
    for (int o = 0; o < TD_ORDER_COUNT; o++) {
        if (!(m->unanswered & ORDER_BIT(o))) continue;
        const td_answer answer = out->answer[events[o]];
        machine_answer(m, TD_MACHINE_ORDER, (td_machine_order)o, answer == TD_ANSWER_ACCEPTED, "%s",
                       td_answer_text(answer));
    }
    m->unanswered = 0;
}

void machine_react(machine *m, uint32_t happened)
{
    const td_behaviour_inputs in = {.events = happened,
                                    .links_open = m->master || (happened & TD_EVENT_BIT(TD_EVENT_USER_STOP)),
                                    .parameters_read = true,
                                    .task = m->task_id,
                                    .machine_task = m->task_id};
    td_behaviour_react(&m->logic, &in, &m->out);
}

/* ---- tasks ---- */

static void forget_task(machine *m)
{
    aside_free(&m->check.work);
    td_task_free(&m->task);
    td_dig_plan_free(&m->plan);
    m->check.task = NULL;
    m->task_id = 0;
    m->to_check = false;
    m->task_hash[0] = 0;
}

static void refuse_task(machine *m, const char *why)
{
    machine_answer(m, TD_MACHINE_TASK, 0, false, "%s", why);
    forget_task(m);
}

/* At rest, with nothing under way. */
static bool may_take(const machine *m)
{
    const td_phase phase = m->logic.phase;
    return !m->in_session && !m->check.work && !m->to_check &&
           (is_preparing(m) || phase == TD_PHASE_READY || phase == TD_PHASE_DOWNLOADED ||
            phase == TD_PHASE_MONITORING);
}

static void take_plan(machine *m, const char *text, size_t size)
{
    td_error error = {0};
    if (!may_take(m)) return; /* nor will its task be */
    forget_task(m);
    td_dig_plan_free(&m->plan);
    if (machine_plan_parse(&m->plan, text, size, &error) != TD_OK)
        audit_line(&m->audit, "refused", NULL, "%s", error.message);
    else
        audit_line(&m->audit, "plan", NULL, "%d moves", m->plan->move_count);
}

static void take_task(machine *m, const td_machine_task *sent)
{
    char why[600];
    td_error error = {0};
    td_machine_validation own = {.joints = m->s->robot->joint_count};
    audit_line(&m->audit, "task", json_pack("{s:s}", "task", sent->validation.task), "%zu bytes came",
               sent->size);
    if (!may_take(m)) {
        machine_answer(m, TD_MACHINE_TASK, 0, false, "%s: %s",
                       m->shown == TD_PHASE_FAILED ? "Reinit first" : "not now", td_phase_text(m->shown));
        return;
    }
    td_dig_plan *plan = m->plan; /* came with it */
    m->plan = NULL;
    forget_task(m);
    m->plan = plan;
    if (td_task_parse(&m->task, sent->text, sent->size, "the task that came", &error) != TD_OK ||
        td_task_hash(m->task_hash, m->task, &error) != TD_OK) {
        refuse_task(m, error.message);
        return;
    }
    memcpy(own.task, m->task_hash, sizeof own.task);
    memcpy(own.model, m->model, sizeof own.model);
    memcpy(own.start, m->state.q, sizeof own.start);
    if (!machine_agrees(why, sizeof why, m->s, m->task, &sent->validation, &own)) {
        refuse_task(m, why);
        return;
    }
    m->vouched = sent->validation;
    m->task_id = ++m->tasks;
    m->to_check = true;
}

void machine_take_message(machine *m, const td_machine_message *message)
{
    switch (message->kind) {
    case TD_MACHINE_TASK:
        take_task(m, &message->as.task);
        break;
    case TD_MACHINE_ORDER:
        audit_line(&m->audit, "order", NULL, "%s", td_machine_order_name(message->as.order));
        m->asked |= ORDER_BIT(message->as.order);
        break;
    case TD_MACHINE_LOOK:
        m->wanted = message->as.look;
        break;
    case TD_MACHINE_PLAN:
        take_plan(m, message->as.plan.text, message->as.plan.size);
        break;
    case TD_MACHINE_JOINTS:
        if (message->as.joints.joints != m->s->robot->joint_count) {
            audit_line(&m->audit, "refused", NULL, "a joint command of %d joints", message->as.joints.joints);
            break;
        }
        m->wish = message->as.joints.command;
        m->wish_s = td_machine_now_s();
        break;
    default:
        audit_line(&m->audit, "refused", NULL, "%s: a message that only a machine sends",
                   td_link_peer(m->master));
        td_link_close(m->master, "it sent what only a machine sends");
        break;
    }
}

/* ---- checked by its own simulator ---- */

static td_status begin_check(machine *m, td_error *error)
{
    const td_elevation *map = NULL;
    TD_TRY(station_map(&map, m->station, error));
    m->to_check = false;
    m->check = (machine_check){.s = m->s, .task = m->task, .map = map, .start = m->state, .plan = m->plan};
    memcpy(m->check.model, m->model, sizeof m->check.model);
    return machine_check_begin(&m->check, error);
}

/* The task is not held. */
static void end_check(machine *m, const char *why)
{
    machine_react(m, TD_EVENT_BIT(TD_EVENT_ABORT));
    refuse_task(m, why);
}

static void judge(machine *m, const machine_verdict *v)
{
    char why[600];
    const bool agrees =
        !v->why[0] && machine_agrees(why, sizeof why, m->s, m->task, &m->vouched, &v->validation);
    if (!agrees) {
        end_check(m, v->why[0] ? v->why : why);
        return;
    }
    static const td_event steps[] = {TD_EVENT_ENDED, TD_EVENT_VALIDATE, TD_EVENT_DOWNLOAD,
                                     TD_EVENT_DOWNLOADED};
    for (int i = 0; i < 4; i++) machine_react(m, TD_EVENT_BIT(steps[i]));
    if (m->logic.phase == TD_PHASE_DOWNLOADED)
        machine_answer(m, TD_MACHINE_TASK, 0, true, "held: simulated here in %.2f s, it takes %.2f s",
                       v->cpu_s, v->validation.duration_s);
    else
        refuse_task(m, td_phase_text(m->logic.phase));
}

void machine_go_on_checking(machine *m)
{
    machine_verdict v;
    td_error error = {0};
    if (m->to_check && m->logic.phase == TD_PHASE_SIMULATING && begin_check(m, &error) != TD_OK) {
        end_check(m, error.message);
        return;
    }
    const bool given_up = (m->check.work && m->logic.phase != TD_PHASE_SIMULATING) ||
                          (m->to_check && (m->logic.phase == TD_PHASE_FAILED || !m->master));
    if (given_up) {
        refuse_task(m, "it was stopped while it was checked");
        return;
    }
    if (m->check.work && machine_check_poll(&v, &m->check)) judge(m, &v);
}
