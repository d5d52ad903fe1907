/* The machine: turns its periods, from the first to the last. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"
#include "core/document.h"
#include "core/file.h"

static const double AT_REST = 2e-3;     /* rad/s or m/s of each joint, and of the base */
static const double WISH_PERIODS = 3;   /* a joint command holds so long */
static const double SLIP_S = 1;         /* further behind than that, lost time is given up */
static const double LOOKS_A_PERIOD = 8; /* of the heartbeat: how sharply its timeout is kept */
static const double MANUAL_SHARE = 0.5; /* of each joint's own acceleration, when it brakes */

/* ---- what is shown ---- */

static td_machine_mode mode_of(td_phase phase)
{
    switch (phase) {
    case TD_PHASE_SIMULATING:
    case TD_PHASE_SIMULATION_PAUSED:
        return TD_MODE_CHECKING;
    case TD_PHASE_DOWNLOADED:
        return TD_MODE_HOLDING;
    case TD_PHASE_EXECUTING:
        return TD_MODE_WORKING;
    case TD_PHASE_EXECUTION_PAUSED:
        return TD_MODE_PAUSED;
    case TD_PHASE_MANUAL:
        return TD_MODE_MANUAL;
    case TD_PHASE_FAILED:
        return TD_MODE_FAILED;
    default:
        return TD_MODE_REST;
    }
}

static void show_state(machine *m, td_phase phase, td_fault fault, const task_outside *task)
{
    td_machine_message message = {.kind = TD_MACHINE_STATE};
    td_machine_state_message *s = &message.as.state;
    *s = (td_machine_state_message){.motion = -1, .dig_phase = -1, .loose = true, .share = 1};
    s->mode = mode_of(phase);
    snprintf(s->phase, sizeof s->phase, "%s", td_phase_text(phase));
    if (fault) snprintf(s->fault, sizeof s->fault, "%s", td_fault_text(fault));
    if (m->task_id) snprintf(s->task, sizeof s->task, "%.8s", m->task_hash);
    if (task) {
        s->step = task->step < 0 ? 0 : task->step;
        s->steps = task->steps;
        s->motion = task->motion;
        s->dig_phase = task->dig_phase;
        s->share = task->share;
        s->loose = task->loose;
    }
    s->joints = m->s->robot->joint_count;
    s->plant = m->state;
    machine_tell(m, &message, true);
}

static bool is_moving_phase(td_phase phase)
{
    return phase == TD_PHASE_EXECUTING || phase == TD_PHASE_EXECUTION_PAUSED || phase == TD_PHASE_MANUAL;
}

static void show_phase(machine *m, td_phase phase, td_fault fault)
{
    if (phase == m->shown) return;
    audit_line(&m->audit, "phase", json_pack("{s:f}", "time_s", m->state.time_s), "%s%s%s",
               td_phase_text(phase), fault ? "; " : "", fault ? td_fault_text(fault) : "");
    m->shown = phase;
}

/* ---- stops ---- */

static void begin_stop(machine *m, double silent_s, const char *why)
{
    m->stop = (machine_stop){.under_way = true, .begun_s = m->state.time_s};
    m->stop.found = (td_machine_stopped){.silent_s = silent_s, .took_s = -1};
    memcpy(m->stop.q, m->state.q, sizeof m->stop.q);
    snprintf(m->stop.found.why, sizeof m->stop.found.why, "%s", why);
    audit_line(&m->audit, "stop",
               json_pack("{s:f, s:f, s:f}", "time_s", m->state.time_s, "silent_s", silent_s, "starved_s",
                         m->starved_s),
               "%s", why);
}

static bool is_at_rest(const machine *m)
{
    for (int k = 0; k < m->s->robot->joint_count; k++)
        if (fabs(m->state.dq[k]) > AT_REST) return false;
    for (int i = 0; i < 6; i++)
        if (fabs(m->state.twist[i]) > 10 * AT_REST) return false; /* it may rock on its tracks */
    return true;
}

static void watch_stop(machine *m)
{
    machine_stop *x = &m->stop;
    td_machine_stopped *found = &x->found;
    if (x->under_way && is_at_rest(m)) {
        x->under_way = false;
        found->took_s = m->state.time_s - x->begun_s;
        found->time_s = m->state.time_s;
        for (int k = 0; k < m->s->robot->joint_count; k++)
            if (fabs(m->state.q[k] - x->q[k]) > fabs(found->angle))
                found->joint = k, found->angle = m->state.q[k] - x->q[k];
        audit_line(&m->audit, "stopped",
                   json_pack("{s:f, s:f, s:f, s:s, s:f}", "time_s", found->time_s, "silent_s",
                             found->silent_s, "took_s", found->took_s, "joint",
                             m->s->robot->joint[found->joint].name, "angle", found->angle),
                   "at rest after %.2f s; %s went on by %.4f", found->took_s,
                   m->s->robot->joint[found->joint].name, found->angle);
    }
    if (found->took_s < 0 || x->told || !m->master || td_link_state_of(m->master) != TD_LINK_OPEN) return;
    td_machine_message message = {.kind = TD_MACHINE_STOPPED};
    message.as.stopped = *found;
    machine_tell(m, &message, false);
    x->told = true;
}

/* ---- time ---- */

void machine_tick(machine *m, td_phase phase, td_fault fault, const task_outside *task)
{
    show_phase(m, phase, fault);
    watch_stop(m);
    show_state(m, phase, fault, task);
    m->ticks++;
    m->tick_s += m->s->period_s;
    double left = m->tick_s - td_machine_now_s();
    const bool had = m->master != NULL;
    do { /* a master who is lost is not waited for */
        machine_hear(m, fmax(0, fmin(left, m->o->period_s / LOOKS_A_PERIOD)));
        left = m->tick_s - td_machine_now_s();
    } while (left > 0 && !terminal_interrupted() && !(had && !m->master));
    if (left < -m->s->period_s) m->misses++;
    if (left < -SLIP_S) {
        audit_line(&m->audit, "late", NULL, "%.2f s behind; time goes on from here", -left);
        m->tick_s = td_machine_now_s();
    }
}

bool machine_is_over(const machine *m)
{
    if (terminal_interrupted()) return true;
    if (m->o->for_s > 0 && td_machine_now_s() - m->begun_s > m->o->for_s) return true;
    return m->o->once && m->masters > 0 && !m->master;
}

/* ---- a session: a task under way ---- */

static td_status outside(void *user, task_outside *o, td_error *error)
{
    (void)error;
    machine *m = user;
    const bool had = m->master != NULL;
    m->state = *o->state;
    machine_answer_orders(m, o->last);
    if (o->phase == TD_PHASE_FAILED && is_moving_phase(m->shown) && !m->stop.under_way)
        begin_stop(m, 0, td_fault_text(o->fault));
    machine_tick(m, o->phase, o->fault, o);
    o->links_open = m->master != NULL;
    o->events = machine_orders(m);
    if (o->phase == TD_PHASE_FAILED) m->ends = false; /* a farewell is no Reinit */
    if (machine_is_over(m) || m->ends) o->events |= TD_EVENT_BIT(TD_EVENT_USER_STOP);
    if (m->ends) o->links_open = true; /* until the session has ended: nobody was lost */
    m->ends = false;
    if (!is_moving_phase(o->phase)) return TD_OK;
    if (o->events & TD_EVENT_BIT(TD_EVENT_USER_STOP))
        begin_stop(m, 0, "the session is ended");
    else if (had && !o->links_open)
        begin_stop(m, m->silent_s, "the master is lost");
    else if (o->events & TD_EVENT_BIT(TD_EVENT_ABORT))
        begin_stop(m, 0, "ordered");
    return TD_OK;
}

static void keep_reports(machine *m, const task_run *run)
{
    for (size_t i = 0; i < run->note_count; i++)
        if (run->note[i].kind == NOTE_REPORT || run->note[i].kind == NOTE_FAULT)
            audit_line(&m->audit, "report", json_pack("{s:f}", "run_s", run->note[i].time_s), "%s: %s",
                       run->note[i].name, run->note[i].text);
}

static td_status execute(machine *m, td_error *error)
{
    scenario s = *m->s;
    task_setup setup = *s.task;
    task_run run = {0};
    task_world w = {.station = m->station,
                    .zero = m->zero,
                    .task_id = m->task_id,
                    .logic = &m->logic,
                    .plan = m->plan,
                    .outside = outside,
                    .user = m};
    setup.task = m->task;
    s.task = &setup;
    m->unanswered |= UINT32_C(1) << TD_ORDER_EXECUTE;
    m->in_session = true;
    m->longest_work_s = 0;
    audit_line(&m->audit, "execute", json_pack("{s:s, s:f}", "task", m->task_hash, "time_s", m->state.time_s),
               "'%s', %d steps", m->task->name, m->task->step_count);
    const td_status status = task_run_in(&run, &s, &w, NULL, error);
    m->in_session = false;
    keep_reports(m, &run);
    audit_line(&m->audit, "executed",
               json_pack("{s:f, s:i, s:I, s:I, s:f}", "took_s", run.time_s, "steps_done", run.steps_done,
                         "periods", (json_int_t)m->ticks, "late_periods", (json_int_t)m->misses,
                         "longest_work_s", m->longest_work_s),
               "%s", td_phase_text(m->logic.phase));
    task_run_free(&run);
    td_dig_plan_free(&w.made);
    memset(m->jog.rate, 0, sizeof m->jog.rate);
    return status;
}

/* ---- out of a session ---- */

static td_status read_state(machine *m, td_error *error)
{
    TD_TRY(m->plant.state(m->plant.self, &m->state, error));
    for (int k = 0; k < m->s->robot->joint_count; k++) m->state.q[k] += m->zero[k];
    return TD_OK;
}

static bool has_wish(const machine *m)
{
    return m->master && td_machine_now_s() - m->wish_s < WISH_PERIODS * m->s->period_s;
}

/* As it was told joint by joint, or standing. */
static td_status move(machine *m, td_error *error)
{
    const td_jog_wish nothing = {.kind = TD_JOG_NOTHING};
    td_plant_command command = {.kind = TD_COMMAND_FLOW};
    td_error why = {0};
    TD_TRY(station_drive(m->station, 0, 0, error));
    if (m->out.drive == TD_DRIVE_JOG) {
        memcpy(m->jog.rate, m->state.dq, sizeof m->jog.rate);
        if (m->plant.command(m->plant.self, &m->wish, &why) == TD_OK) return TD_OK;
        audit_line(&m->audit, "refused", NULL, "a joint command: %s", why.message);
        m->wish_s = NAN;
    }
    (void)td_jog_step(&command, &m->jog, &nothing, &m->state, &why);
    return m->plant.command(m->plant.self, &command, error);
}

static uint32_t gather(machine *m)
{
    uint32_t events = machine_orders(m);
    if (m->logic.phase == TD_PHASE_IDLE && !machine_is_over(m)) events |= TD_EVENT_BIT(TD_EVENT_PREPARE);
    if (m->to_check && m->logic.phase == TD_PHASE_READY) events |= TD_EVENT_BIT(TD_EVENT_START);
    if (m->logic.phase == TD_PHASE_MANUAL && has_wish(m)) events |= TD_EVENT_BIT(TD_EVENT_JOG);
    if (m->ends) events |= TD_EVENT_BIT(TD_EVENT_USER_STOP);
    m->ends = false;
    return events;
}

static td_status one_period(machine *m, td_error *error)
{
    const td_phase before = m->logic.phase;
    machine_tick(m, before, m->logic.fault, NULL);
    const uint32_t events = gather(m);
    if ((events & TD_EVENT_BIT(TD_EVENT_EXECUTE)) && before == TD_PHASE_DOWNLOADED && m->master)
        return execute(m, error);
    machine_react(m, events);
    machine_answer_orders(m, &m->out);
    if (before == TD_PHASE_MANUAL && m->logic.phase != TD_PHASE_MANUAL)
        begin_stop(m, m->master ? 0 : m->silent_s, m->master ? "ordered" : "the master is lost");
    machine_go_on_checking(m);
    return move(m, error);
}

static td_status run(machine *m, td_error *error)
{
    while (!machine_is_over(m)) {
        TD_TRY(one_period(m, error));
        TD_TRY(m->plant.step(m->plant.self, m->s->period_s, error));
        TD_TRY(read_state(m, error));
    }
    return TD_OK;
}

/* ---- begun and ended ---- */

static td_status begin(machine *m, td_error *error)
{
    const scenario *s = m->s;
    td_plant_state start = s->start;
    td_behaviour_options logic = td_behaviour_options_default();
    td_motion_limits limits = td_motion_limits_default();
    TD_TRY(machine_truth_draw(m, error));
    for (int k = 0; k < s->robot->joint_count; k++)
        start.q[k] = fmax(s->robot->joint[k].lower, fmin(s->robot->joint[k].upper, start.q[k] - m->zero[k]));
    TD_TRY(station_new(&m->station, m->robot_true, &s->options, &start, m->ground ? m->ground : s->map,
                       m->rehearsal ? &m->rehearsal->truth.ground : &s->ground, error));
    m->plant = station_plant(m->station);
    TD_TRY(read_state(m, error));
    limits.period_s = s->period_s;
    limits.lag_s = s->options.valve_s;
    limits.acceleration_share = MANUAL_SHARE;
    TD_TRY(td_jog_start(&m->jog, s->robot, &limits, TD_COMMAND_FLOW, error));
    logic.has_machine = 1;
    logic.singularity = s->task->singularity;
    td_behaviour_begin(&m->logic, &logic);
    m->shown = m->logic.phase;
    m->stop.found.took_s = -1;
    m->wish_s = NAN;
    TD_TRY(machine_model(m->model, s, error));
    TD_TRY(machine_truth_keep(m, "truth-before.tif", error));
    TD_TRY(machine_look_begin(m, error));
    TD_TRY(machine_links_open(m, error));
    m->begun_s = m->tick_s = td_machine_now_s();
    audit_line(&m->audit, "begin",
               json_pack("{s:s, s:s, s:i}", "model", m->model, "scenario", s->path, "port",
                         td_link_listener_port(m->listener)),
               "a %s listens at %s", s->robot->name, m->o->listen);
    /* For who started it: a line with the port. */
    if (!m->o->common->quiet) {
        printf("listening on port %d\n", td_link_listener_port(m->listener));
        fflush(stdout);
    }
    return TD_OK;
}

static void end(machine *m, td_status status, const td_error *error)
{
    audit_line(
        &m->audit, "end",
        json_pack("{s:I, s:I}", "periods", (json_int_t)m->ticks, "late_periods", (json_int_t)m->misses), "%s",
        status == TD_OK ? "as asked" : error->message);
    machine_links_close(m);
    machine_look_end(m);
    aside_free(&m->check.work);
    td_task_free(&m->task);
    td_dig_plan_free(&m->plan);
    (void)machine_truth_keep(m, "truth-after.tif", NULL);
    station_free(&m->station);
    machine_truth_free(m);
    audit_close(&m->audit);
}

static td_status open_audit(machine *m, td_error *error)
{
    char path[1200];
    if (!m->o->common->output) return TD_OK;
    TD_TRY(td_folder_make(m->o->common->output, error));
    snprintf(path, sizeof path, "%s/audit.jsonl", m->o->common->output);
    return audit_open(&m->audit, path, error);
}

/* A scenario, or a rehearsal, of whose truth it is. */
static td_status read_there(machine *m, const td_progress *progress, td_error *error)
{
    json_t *root = NULL;
    TD_TRY(td_document_read(&root, m->o->scenario, error));
    const char *kind = json_string_value(json_object_get(root, "teledimos"));
    const bool rehearsal = kind && strncmp(kind, "rehearsal", 9) == 0;
    json_decref(root);
    if (!rehearsal) return machine_read(m->s, m->o, m->o->scenario, progress, error);
    m->setup = calloc(1, sizeof *m->setup);
    m->rehearsal = calloc(1, sizeof *m->rehearsal);
    if (!m->setup || !m->rehearsal) return td_fail(error, TD_ERROR_MEMORY, "no memory for a rehearsal");
    return rehearse_read(m->setup, m->s, m->o->scenario, error);
}

td_status machine_serve(const machine_options *o, terminal *term, td_error *error)
{
    scenario s = {0};
    const td_progress progress = terminal_progress(term);
    machine *m = calloc(1, sizeof *m);
    if (!m) return td_fail(error, TD_ERROR_MEMORY, "no memory for a machine");
    m->o = o;
    m->s = &s;
    m->term = term;
    td_status status = read_there(m, &progress, error);
    if (status == TD_OK) status = open_audit(m, error);
    if (status == TD_OK) status = begin(m, error);
    if (status == TD_OK) status = run(m, error);
    end(m, status, error);
    scenario_free(&s);
    free(m);
    return status;
}
