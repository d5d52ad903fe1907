/* A session: the behaviour decides each period, the step under work says what the joints are to do. */
#include "apps/session_internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const double REST_S = 1;      /* a machine told to stop has come to rest */
static const double ROCK_S = 5;      /* and so has one that rocks on its tracks */
static const double JOG_SHARE = 0.3; /* of a joint's speed, by hand */

void task_run_free(task_run *run)
{
    for (size_t i = 0; i < run->ground_count; i++) td_elevation_free(&run->ground[i].map);
    td_elevation_free(&run->after);
    free(run->sample);
    free(run->note);
    free(run->input.item);
    *run = (task_run){0};
}

static double cpu_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* ---- the behaviour ---- */

static td_status hand_in(session *x, const task_input *input, uint32_t *events, td_error *error)
{
    const bool order = input->event != TD_EVENT_DEADLINE;
    *events |= TD_EVENT_BIT(input->event);
    TD_TRY(session_note(x, order ? NOTE_ORDER : NOTE_REPORT, td_event_text(input->event), "", error));
    task_note *n = x->run->note + x->run->note_count - 1;
    n->joint = input->joint;
    n->stick = input->stick;
    if (input->event == TD_EVENT_JOG)
        x->wish = (td_jog_wish){.kind = TD_JOG_JOINT, .joint = input->joint, .stick = input->stick};
    task_input kept = *input;
    kept.period = x->period;
    return inputs_add(&x->run->input, &kept, error);
}

static td_status tell(session *x, td_phase before, uint32_t orders, td_error *error)
{
    for (int e = 0; e < TD_EVENT_COUNT; e++)
        if ((orders & TD_EVENT_BIT(e)) && x->out.answer[e] > TD_ANSWER_ACCEPTED)
            TD_TRY(session_note(x, NOTE_MESSAGE, td_event_text((td_event)e), td_answer_text(x->out.answer[e]),
                                error));
    if (x->live && x->live->answered) x->live->answered(x->live, orders, x->out.answer);
    for (int m = 0; m < TD_MESSAGE_COUNT; m++)
        if (x->out.messages & TD_MESSAGE_BIT(m))
            TD_TRY(session_note(x, NOTE_MESSAGE, "session", td_message_text((td_message)m), error));
    if (x->out.fault != TD_FAULT_NONE) {
        x->run->fault = x->out.fault;
        TD_TRY(session_note(x, NOTE_FAULT, "fault", td_fault_text(x->out.fault), error));
    }
    if (x->out.phase == before) return TD_OK;
    x->phase_since = x->period;
    return session_note(x, NOTE_PHASE, "phase", td_phase_text(x->out.phase), error);
}

/* ---- a machine elsewhere ---- */

static bool has_machine(const session *x)
{
    return x->live && x->live->look;
}

static bool is_at_rest(const session *x, const td_plant_state *state)
{
    static const double AT_REST = 2e-3; /* rad/s or m/s */
    for (int k = 0; k < x->s->robot->joint_count; k++)
        if (fabs(state->dq[k]) > AT_REST) return false;
    return true;
}

/* The simulated machine where the other one stands, on the ground that is expected there. Nothing moves
 * meanwhile: the clock begins anew. */
static td_status stand_there(session *x, td_error *error)
{
    const td_robot *robot = x->s->robot;
    td_plant_state there = *x->seen.state;
    for (int k = 0; k < robot->joint_count; k++) {
        there.q[k] = fmax(robot->joint[k].lower, fmin(robot->joint[k].upper, there.q[k]));
        there.dq[k] = 0;
    }
    memset(there.twist, 0, sizeof there.twist);
    there.time_s = session_time(x);
    TD_TRY(station_stand(x->station, &there, x->dug && x->logic.phase != TD_PHASE_EXECUTING, error));
    TD_TRY(session_read(x, error));
    x->dug = x->dug && x->logic.phase == TD_PHASE_EXECUTING;
    x->stands = true;
    memcpy(x->stood, x->seen.state->q, sizeof x->stood);
    x->base = x->state.site_from_vehicle;
    memset(x->at_stop, 0, sizeof x->at_stop);
    memset(x->jog.rate, 0, sizeof x->jog.rate);
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    td_trajectory_free(&x->motion);
    live_again(x->live);
    return session_keep_ground(x, error);
}

/* It is not where it was. */
static bool is_elsewhere(const session *x)
{
    static const double NEAR = 2e-3; /* rad or m */
    for (int k = 0; k < x->s->robot->joint_count; k++)
        if (fabs(x->seen.state->q[k] - x->stood[k]) > NEAR) return true;
    return false;
}

static td_status look_at_machine(session *x, uint32_t *events, td_error *error)
{
    const td_phase phase = x->logic.phase;
    if (!has_machine(x)) return TD_OK;
    x->live->look(x->live, phase, &x->seen);
    x->links_open = x->seen.open;
    *events |= x->seen.reports & ~TD_EVENT_BIT(TD_EVENT_PART_FAILED);
    if (x->seen.reports & TD_EVENT_BIT(TD_EVENT_PART_FAILED)) {
        TD_TRY(session_report(x, TD_EVENT_PART_FAILED, x->seen.why, error));
        *events |= x->reports;
        x->reports = 0;
    }
    const bool first = phase == TD_PHASE_FAILED && x->simulated == 0 && !x->dug;
    if ((phase != TD_PHASE_READY && !first) || !x->seen.state || !is_at_rest(x, x->seen.state)) return TD_OK;
    return x->stands && !is_elsewhere(x) ? TD_OK : stand_there(x, error);
}

static td_status lead_machine(session *x, uint32_t events, td_error *error)
{
    const live_lead lead = {
        .events = events, .out = &x->out, .task = x->setup->task, .run = x->run, .command = &x->command};
    return has_machine(x) ? x->live->lead(x->live, &lead, error) : TD_OK;
}

/* Back to where the scenario begins; the session's time goes on. */
static td_status prepare(session *x, td_error *error)
{
    x->parameters_read = true;
    x->stands = false;
    if (x->period == 0 || has_machine(x)) return TD_OK;
    td_plant_state again = x->start;
    again.time_s = session_time(x);
    if (x->station)
        TD_TRY(station_restart(x->station, again.time_s, error));
    else
        TD_TRY(x->plant.reset(x->plant.self, &again, error));
    x->stops_seen = 0;
    memset(x->at_stop, 0, sizeof x->at_stop);
    x->state = again;
    memset(x->jog.rate, 0, sizeof x->jog.rate);
    memcpy(x->wanted, again.q, sizeof x->wanted);
    return TD_OK;
}

static td_status begin_run(session *x, td_error *error)
{
    if (has_machine(x) && x->seen.state && (!x->stands || x->logic.phase == TD_PHASE_EXECUTING))
        TD_TRY(stand_there(x, error));
    x->stands = false;
    x->dug = x->dug || x->logic.phase == TD_PHASE_EXECUTING;
    memcpy(x->run->from, has_machine(x) ? x->stood : x->state.q, sizeof x->run->from);
    memset(x->run->peak, 0, sizeof x->run->peak);
    x->step = 0;
    x->step_begun = false;
    x->simulated = 0;
    x->reports = 0;
    x->run->simulated = false;
    x->run->steps_done = 0;
    x->run->planned_s = 0;
    x->run->dug = (task_dug){.clearance_m = INFINITY};
    x->idle = 0;
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    session_forget_plans(x);
    session_end_dig(x);
    return session_plan_ahead(x, error);
}

static td_behaviour_inputs levels(const session *x, uint32_t events)
{
    return (td_behaviour_inputs){.events = events,
                                 .links_open = x->links_open,
                                 .parameters_read = x->parameters_read,
                                 .task = x->task_id,
                                 .machine_task = x->world || x->seen.holds ? x->task_id : 0};
}

static td_status react(session *x, uint32_t events, td_error *error)
{
    const td_phase before = x->logic.phase;
    const td_behaviour_inputs in = levels(x, events);
    td_behaviour_react(&x->logic, &in, &x->out);
    TD_TRY(tell(x, before, events, error));
    if (x->out.close_links && !has_machine(x)) x->links_open = false;
    if (x->out.open_links && !has_machine(x)) x->links_open = true;
    if (x->out.read_parameters) TD_TRY(prepare(x, error));
    if (x->out.begin) TD_TRY(begin_run(x, error));
    return TD_OK;
}

/* `brake`: with nothing asked. */
static td_status by_hand(session *x, bool brake, td_error *error)
{
    const td_jog_wish nothing = {.kind = TD_JOG_NOTHING};
    const td_status status = td_jog_step(&x->command, &x->jog, brake ? &nothing : &x->wish, &x->state, error);
    memcpy(x->wanted, x->state.q, sizeof x->wanted);
    return status;
}

/* Fails only where the program cannot go on; what a controller cannot is a report. */
static td_status drive(session *x, td_error *error)
{
    td_error why = {0};
    td_status status;
    switch (x->out.drive) {
    case TD_DRIVE_SIMULATE:
    case TD_DRIVE_EXECUTE:
        status = session_work(x, &why);
        break;
    case TD_DRIVE_JOG:
        status = by_hand(x, false, &why);
        break;
    case TD_DRIVE_HOLD:
        status = session_halt(x, &why);
        if (status == TD_OK)
            status = x->logic.phase == TD_PHASE_MANUAL ? by_hand(x, true, &why) : session_follow(x, 0, &why);
        break;
    case TD_DRIVE_REST:
        status = session_halt(x, &why);
        if (status == TD_OK)
            status =
                x->logic.phase == TD_PHASE_SIMULATED ? session_follow(x, 0, &why) : by_hand(x, true, &why);
        break;
    default:
        td_trajectory_free(&x->motion);
        status = session_halt(x, &why);
        if (status == TD_OK) status = by_hand(x, true, &why);
        break;
    }
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    if (status != TD_OK) return session_report(x, TD_EVENT_PART_FAILED, why.message, error);
    return TD_OK;
}

/* ---- a period ---- */

static td_status look_outside(session *x, uint32_t *events, td_error *error)
{
    const task_world *w = x->world;
    if (!w || !w->outside) return TD_OK;
    task_outside o = {.state = &x->state,
                      .phase = x->logic.phase,
                      .fault = x->logic.fault,
                      .step = x->step,
                      .steps = x->steps,
                      .motion = x->motions - 1,
                      .dig_phase = session_dig_phase(x),
                      .share = session_share(x),
                      .loose = session_is_loose(x),
                      .last = &x->out};
    TD_TRY(w->outside(w->user, &o, error));
    x->links_open = o.links_open;
    for (td_event e = 0; e < TD_EVENT_COUNT; e++) {
        const task_input input = {.event = e, .joint = -1};
        if (o.events & TD_EVENT_BIT(e)) TD_TRY(hand_in(x, &input, events, error));
    }
    return TD_OK;
}

static td_status take_inputs(session *x, uint32_t *events, td_error *error)
{
    TD_TRY(look_outside(x, events, error));
    while (x->next_input < x->input->count && x->input->item[x->next_input].period <= x->period)
        TD_TRY(hand_in(x, x->input->item + x->next_input++, events, error));
    if (!x->live) return TD_OK;
    task_inputs keys = {0};
    const int changes = x->live->changes;
    td_status status = x->live->inputs(x->live, &keys, x->period, x->logic.phase, error);
    x->task_id += 2 * (uint32_t)(x->live->changes - changes); /* another motion */
    for (size_t i = 0; status == TD_OK && i < keys.count; i++)
        status = hand_in(x, keys.item + i, events, error);
    free(keys.item);
    return status;
}

static td_status tell_stop(session *x, int joint, bool met, bool upper, double time_s, td_error *error)
{
    char text[200];
    snprintf(text, sizeof text, "%s %s its %s stop at %.6f s", x->s->robot->joint[joint].name,
             met ? "met" : "left", upper ? "upper" : "lower", time_s);
    if (met) return session_report(x, TD_EVENT_LIMIT, text, error);
    return session_note(x, NOTE_MESSAGE, "stop left", text, error);
}

/* Of the machine, which locates them in time. */
static td_status see_events(session *x, td_error *error)
{
    size_t count = 0;
    const td_machine_event *e = td_machine_events(x->machine, &count);
    for (; x->stops_seen < count; x->stops_seen++) {
        const td_machine_event *now = e + x->stops_seen;
        char text[200];
        if (now->joint >= 0) {
            TD_TRY(tell_stop(x, now->joint, now->met, now->upper, now->time_s, error));
            continue;
        }
        snprintf(text, sizeof text, "at %.6f s", now->time_s);
        TD_TRY(session_note(x, NOTE_MESSAGE, now->met ? "contact met" : "contact left", text, error));
    }
    return TD_OK;
}

td_status session_read(session *x, td_error *error)
{
    TD_TRY(x->plant.state(x->plant.self, &x->state, error));
    if (!x->world || !x->world->zero) return TD_OK;
    for (int k = 0; k < x->s->robot->joint_count; k++) x->state.q[k] += x->world->zero[k];
    return TD_OK;
}

/* Of any other plant, as its readings tell them. */
static td_status see_stops(session *x, td_error *error)
{
    if (x->machine) return see_events(x, error);
    TD_TRY(session_read(x, error));
    for (int k = 0; k < x->s->robot->joint_count; k++) {
        const td_robot_joint *j = x->s->robot->joint + k;
        const bool met = x->state.at_stop[k];
        if (met == x->at_stop[k]) continue;
        x->at_stop[k] = met;
        TD_TRY(tell_stop(x, k, met, x->state.q[k] > (j->lower + j->upper) / 2, x->state.time_s, error));
    }
    return TD_OK;
}

static bool is_working(const session *x)
{
    return x->logic.phase == TD_PHASE_SIMULATING || x->logic.phase == TD_PHASE_EXECUTING;
}

static bool is_over(const session *x)
{
    const td_phase phase = x->logic.phase;
    if (x->broken) return true;
    if (x->input->end >= 0) return x->period >= x->input->end;
    if (x->next_input < x->input->count) return false;
    const bool rested = (double)(x->period - x->phase_since) * x->s->period_s >= REST_S;
    const bool attended = x->live && x->live->attended(x->live);
    if (phase == TD_PHASE_IDLE) return rested && !(attended && x->live->lasting);
    if (is_working(x) || attended) return false;
    if (x->world && x->world->outside && phase == TD_PHASE_EXECUTION_PAUSED) return false;
    return phase == TD_PHASE_SIMULATED || rested;
}

/* On the ground a scenario's duration is the longest: how long a trench takes is not known before. */
static bool is_at_end(const session *x)
{
    if (x->station && x->step >= x->steps && (double)x->idle * x->s->period_s >= ROCK_S) return true;
    return (double)x->simulated * x->s->period_s >= x->s->duration_s - x->s->period_s / 2;
}

/* What a simulation comes to, for who vouches for it. */
static void keep_results(session *x)
{
    task_run *r = x->run;
    for (int k = 0; k < x->s->robot->joint_count; k++) r->peak[k] = fmax(r->peak[k], fabs(x->state.force[k]));
    memcpy(r->to, x->state.q, sizeof r->to);
    r->took_s = (double)x->simulated * x->s->period_s;
}

static td_status one_period(session *x, td_error *error)
{
    uint32_t events = x->reports;
    x->reports = 0;
    x->wish.kind = TD_JOG_NOTHING;
    TD_TRY(session_read(x, error));
    if (x->logic.phase == TD_PHASE_SIMULATING) keep_results(x);
    const bool ends = is_working(x) && !(has_machine(x) && x->logic.phase == TD_PHASE_EXECUTING);
    if (ends && is_at_end(x)) events |= TD_EVENT_BIT(TD_EVENT_ENDED);
    TD_TRY(look_at_machine(x, &events, error));
    TD_TRY(take_inputs(x, &events, error));
    TD_TRY(react(x, events, error));
    if (x->out.phase == TD_PHASE_MANUAL) x->stands = false;
    if (x->out.messages &
        (TD_MESSAGE_BIT(TD_MESSAGE_SIMULATION_ENDED) | TD_MESSAGE_BIT(TD_MESSAGE_EXECUTION_ENDED)))
        session_keep_steady(x);
    TD_TRY(drive(x, error));
    TD_TRY(lead_machine(x, events, error));
    if (session_time(x) >= (double)x->log_index * x->s->log_s - 1e-9) {
        x->log_index = (size_t)floor(session_time(x) / x->s->log_s + 1e-6) + 1;
        TD_TRY(session_sample(x, error));
    }
    return TD_OK;
}

/* The machine for a period; what it cannot is a report, and its end. */
static td_status advance(session *x, td_error *error)
{
    td_error why = {0};
    td_status status = x->plant.command(x->plant.self, &x->command, &why);
    if (status == TD_OK) status = x->plant.step(x->plant.self, x->s->period_s, &why);
    if (status == TD_ERROR_MEMORY) return td_fail(error, status, "%s", why.message);
    x->period++;
    if (status == TD_OK) return see_stops(x, error);
    x->broken = true;
    TD_TRY(session_report(x, TD_EVENT_PART_FAILED, why.message, error));
    return react(x, x->reports, error);
}

static td_status wait_for_clock(session *x, td_error *error)
{
    bool missed = false;
    if (!x->live) return TD_OK;
    TD_TRY(live_wait(x->live, &missed, error));
    const task_input input = {.event = TD_EVENT_DEADLINE, .joint = -1};
    uint32_t events = 0;
    if (missed) TD_TRY(hand_in(x, &input, &events, error));
    x->reports |= events;
    return TD_OK;
}

static td_status show(session *x, td_error *error)
{
    if (!x->live) return TD_OK;
    const td_behaviour_inputs now = levels(x, 0);
    const live_view view = {.run = x->run,
                            .phase = x->logic.phase,
                            .step = x->step,
                            .steps = x->steps,
                            .period = x->period,
                            .time_s = session_time(x),
                            .offers = td_behaviour_offers(&x->logic, &now)};
    return x->live->show(x->live, &view, error);
}

/* ---- from the start to the end ---- */

static td_status begin_machine(session *x, td_machine_base base, td_error *error)
{
    const scenario *s = x->s;
    td_machine_options o = s->options;
    o.base = base;
    TD_TRY(td_machine_new(&x->machine, s->robot, &o, s->compile_folder, error));
    x->plant = td_machine_plant(x->machine);
    TD_TRY(td_machine_reset(x->machine, &s->start, error));
    TD_TRY(td_machine_settle(x->machine, error));
    if (x->setup->has_contact) TD_TRY(td_machine_touch(x->machine, &x->setup->contact, error));
    return TD_OK;
}

static td_status begin_station(session *x, td_error *error)
{
    const scenario *s = x->s;
    if (x->world)
        x->station = x->world->station;
    else
        TD_TRY(station_new(&x->station, s->robot, &s->options, &s->start, s->map, &s->ground, error));
    x->plant = station_plant(x->station);
    return session_keep_ground(x, error);
}

static td_status begin_plant(session *x, td_machine_base base, td_error *error)
{
    if (x->s->map || x->world)
        TD_TRY(begin_station(x, error));
    else
        TD_TRY(begin_machine(x, base, error));
    TD_TRY(session_read(x, error));
    x->start = x->state;
    x->base = x->start.site_from_vehicle;
    memcpy(x->wanted, x->start.q, sizeof x->wanted);
    if (td_dynamics_zx200(&x->dynamics, x->s->robot, NULL) == TD_OK) return TD_OK;
    return td_dynamics_new(&x->dynamics, x->s->robot, error);
}

static td_status begin_control(session *x, td_error *error)
{
    const scenario *s = x->s;
    td_joint_controller_options o = td_joint_controller_options_default();
    o.gain_1_s = s->gain_1_s;
    o.kind = TD_COMMAND_FLOW;
    o.limits.period_s = s->period_s;
    o.limits.lag_s = s->options.valve_s;
    o.limits.pump_m3_s = isfinite(s->options.pump_m3_s) ? s->options.pump_m3_s : 0;
    TD_TRY(td_joint_controller_start(&x->joints, s->robot, &o, error));
    td_motion_limits slow = o.limits;
    slow.speed_share = JOG_SHARE;
    return td_jog_start(&x->jog, s->robot, &slow, TD_COMMAND_FLOW, error);
}

/* With the behaviour as it was left: what was downloaded is executed, else the task is simulated. */
static td_status begin_in_world(session *x, td_error *error)
{
    x->logic = *x->world->logic;
    x->links_open = x->logic.phase != TD_PHASE_IDLE;
    if (x->logic.phase == TD_PHASE_DOWNLOADED) {
        x->task_id = x->world->task_id;
        return react(x, TD_EVENT_BIT(TD_EVENT_EXECUTE), error);
    }
    x->task_id = x->logic.task; /* that of the last task, until it is put away */
    const td_event begins = x->logic.phase == TD_PHASE_IDLE ? TD_EVENT_PREPARE : TD_EVENT_REINIT;
    TD_TRY(react(x, TD_EVENT_BIT(begins), error));
    TD_TRY(react(x, 0, error));
    x->task_id = x->world->task_id;
    return react(x, TD_EVENT_BIT(TD_EVENT_START), error);
}

/* A log that begins with Prepare is one of a session that waited for its operator. */
static bool waits(const session *x)
{
    if (x->live && x->live->lasting) return true;
    return x->input->count > 0 && x->input->item[0].period == 0 &&
           x->input->item[0].event == TD_EVENT_PREPARE;
}

/* Prepare, the checks, StartSim: before time begins. */
static td_status begin_session(session *x, td_error *error)
{
    td_behaviour_options o = td_behaviour_options_default();
    char hex[TD_HASH_HEX_SIZE];
    o.singularity = x->setup->singularity;
    o.has_machine = has_machine(x);
    o.deadlines_forgiven = x->setup->miss == TD_MISS_STOP ? 0 : UINT32_MAX;
    TD_TRY(td_task_hash(hex, x->setup->task, error));
    hex[8] = 0;
    x->task_id = (uint32_t)strtoul(hex, NULL, 16) | 1;
    x->steps = x->setup->task->step_count;
    x->step = -1;
    x->tool_link = td_task_tool_link(x->setup->task, x->s->robot);
    x->link_from_tool = task_tool(x->setup->task);
    x->command.kind = TD_COMMAND_FLOW;
    x->ahead = calloc((size_t)x->steps, sizeof *x->ahead);
    if (!x->ahead) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    if (x->world) return begin_in_world(x, error);
    td_behaviour_begin(&x->logic, &o);
    if (waits(x)) return TD_OK;
    TD_TRY(react(x, TD_EVENT_BIT(TD_EVENT_PREPARE), error));
    TD_TRY(react(x, 0, error));
    return react(x, TD_EVENT_BIT(TD_EVENT_START), error);
}

static td_status all_the_way(session *x, const td_progress *progress, td_error *error)
{
    const size_t total = (size_t)(x->s->duration_s / x->s->period_s);
    for (;;) {
        const double begun = cpu_now();
        TD_TRY(one_period(x, error));
        TD_TRY(show(x, error));
        if (is_over(x)) return TD_OK;
        TD_TRY(advance(x, error));
        x->run->late += cpu_now() - begun > x->s->period_s;
        if (x->broken) return TD_OK;
        TD_TRY(wait_for_clock(x, error));
        const size_t done = (size_t)x->simulated < total ? (size_t)x->simulated : total;
        const bool go_on = x->live ? x->live->lasting || !terminal_interrupted()
                                   : td_progress_report(progress, "simulating", done, total);
        if (!go_on) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
}

static td_status end_station(session *x, td_error *error)
{
    const td_elevation *map = NULL;
    const td_soil_state soil = station_soil(x->station);
    task_dug *d = &x->run->dug;
    d->peak_n = station_cutting_peak(x->station);
    d->mass_error_kg = station_mass_error(x->station);
    d->load_kg = 1e-6 * (double)soil.bucket_mg;
    TD_TRY(session_keep_ground(x, error));
    TD_TRY(station_map(&map, x->station, error));
    return td_elevation_copy(&x->run->after, map, error);
}

/* The whole session; frees all but what the world lent. */
static td_status run_session(session *x, td_machine_base base, const td_progress *progress, td_error *error)
{
    task_run *run = x->run;
    td_status status = begin_plant(x, base, error);
    if (status == TD_OK) status = begin_control(x, error);
    if (status == TD_OK) status = begin_session(x, error);
    const double begun = cpu_now();
    if (status == TD_OK && x->live) status = live_start(x->live, error);
    if (status == TD_OK) status = all_the_way(x, progress, error);
    run->cpu_s = cpu_now() - begun;
    run->time_s = session_time(x);
    run->input.end = x->period;
    run->phase = x->logic.phase;
    if (x->machine) run->counters = td_machine_count(x->machine);
    if (status == TD_OK && x->station) status = end_station(x, error);
    if (x->live) run->live = (task_live){true, x->live->clock.counts, x->s->period_s};
    session_forget_plans(x);
    session_end_dig(x);
    free(x->ahead);
    td_dynamics_free(&x->dynamics);
    if (!x->world) station_free(&x->station);
    td_machine_free(&x->machine);
    return status;
}

td_status task_run_session(task_run *run, const scenario *s, td_machine_base base, const task_inputs *inputs,
                           struct live *live, const td_progress *progress, td_error *error)
{
    session *x = calloc(1, sizeof *x);
    *run = (task_run){0};
    if (!x) return td_fail(error, TD_ERROR_MEMORY, "no memory for a session");
    *x = (session){
        .s = s, .setup = s->task, .input = inputs ? inputs : &s->task->orders, .run = run, .live = live};
    const td_status status = run_session(x, base, progress, error);
    free(x);
    return status;
}

td_status task_run_in(task_run *run, const scenario *s, task_world *world, const td_progress *progress,
                      td_error *error)
{
    static const task_inputs none = {.end = -1};
    session *x = calloc(1, sizeof *x);
    *run = (task_run){0};
    if (!x) return td_fail(error, TD_ERROR_MEMORY, "no memory for a session");
    *x = (session){.s = s, .setup = s->task, .input = &none, .run = run, .world = world};
    const td_status status = run_session(x, s->options.base, progress, error);
    *world->logic = x->logic;
    free(x);
    return status;
}
