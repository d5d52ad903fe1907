/* The session's reaction: who wins, what follows, what is answered. */
#include "sim/behaviour.h"

#include <assert.h>
#include <string.h>

static_assert(sizeof(td_behaviour) == 7 * sizeof(uint32_t), "states are compared by their bytes");
static_assert(TD_EVENT_COUNT <= 32 && TD_MESSAGE_COUNT <= 32, "one bit each");

/* ---- what there is ---- */

/* The header's table: where an event leads from a phase. None leads to IDLE, which stands for: not taken. */
static const td_phase ways[TD_PHASE_COUNT][TD_EVENT_COUNT] = {
    [TD_PHASE_IDLE] = {[TD_EVENT_PREPARE] = TD_PHASE_PREPARING},
    [TD_PHASE_READY] = {[TD_EVENT_START] = TD_PHASE_SIMULATING,
                        [TD_EVENT_MANUAL] = TD_PHASE_MANUAL,
                        [TD_EVENT_REINIT] = TD_PHASE_PREPARING},
    [TD_PHASE_MANUAL] = {[TD_EVENT_JOG] = TD_PHASE_MANUAL,
                         [TD_EVENT_PAUSE] = TD_PHASE_MANUAL,
                         [TD_EVENT_AUTOMATIC] = TD_PHASE_READY},
    [TD_PHASE_SIMULATING] =
        {[TD_EVENT_PAUSE] = TD_PHASE_SIMULATION_PAUSED, [TD_EVENT_ENDED] = TD_PHASE_SIMULATED},
    /* The end and a pause may cross on the wire. */
    [TD_PHASE_SIMULATION_PAUSED] = {[TD_EVENT_PAUSE] = TD_PHASE_SIMULATION_PAUSED,
                                    [TD_EVENT_RESUME] = TD_PHASE_SIMULATING,
                                    [TD_EVENT_ENDED] = TD_PHASE_SIMULATED},
    [TD_PHASE_SIMULATED] = {[TD_EVENT_VALIDATE] = TD_PHASE_VALIDATED, [TD_EVENT_REINIT] = TD_PHASE_PREPARING},
    [TD_PHASE_VALIDATED] =
        {[TD_EVENT_DOWNLOAD] = TD_PHASE_DOWNLOADING, [TD_EVENT_REINIT] = TD_PHASE_PREPARING},
    [TD_PHASE_DOWNLOADING] = {[TD_EVENT_DOWNLOADED] = TD_PHASE_DOWNLOADED},
    [TD_PHASE_DOWNLOADED] = {[TD_EVENT_EXECUTE] = TD_PHASE_EXECUTING, [TD_EVENT_REINIT] = TD_PHASE_PREPARING},
    [TD_PHASE_EXECUTING] =
        {[TD_EVENT_PAUSE] = TD_PHASE_EXECUTION_PAUSED, [TD_EVENT_ENDED] = TD_PHASE_MONITORING},
    [TD_PHASE_EXECUTION_PAUSED] = {[TD_EVENT_PAUSE] = TD_PHASE_EXECUTION_PAUSED,
                                   [TD_EVENT_RESUME] = TD_PHASE_EXECUTING,
                                   [TD_EVENT_ENDED] = TD_PHASE_MONITORING},
    [TD_PHASE_MONITORING] = {[TD_EVENT_REINIT] = TD_PHASE_PREPARING},
    [TD_PHASE_FAILED] = {[TD_EVENT_REINIT] = TD_PHASE_PREPARING},
};

/* What each phase is. */
static const struct {
    td_drive drive;
    bool links;        /* needs them open */
    bool task;         /* is about a task, which must not change */
    bool machine_task; /* the machine holds it, too */
    bool works;        /* something is under way */
    bool monitor;
    td_phase aborted; /* where ABORT leads */
} phases[TD_PHASE_COUNT] = {
    [TD_PHASE_IDLE] = {TD_DRIVE_REST, .aborted = TD_PHASE_IDLE},
    [TD_PHASE_PREPARING] = {TD_DRIVE_REST, .works = true, .aborted = TD_PHASE_IDLE},
    [TD_PHASE_READY] = {TD_DRIVE_REST, true, .aborted = TD_PHASE_READY},
    [TD_PHASE_SIMULATING] = {TD_DRIVE_SIMULATE, true, true, .works = true, .aborted = TD_PHASE_READY},
    [TD_PHASE_SIMULATION_PAUSED] = {TD_DRIVE_HOLD, true, true, .works = true, .aborted = TD_PHASE_READY},
    [TD_PHASE_SIMULATED] = {TD_DRIVE_REST, true, true, .aborted = TD_PHASE_READY},
    [TD_PHASE_VALIDATED] = {TD_DRIVE_REST, true, true, .aborted = TD_PHASE_READY},
    [TD_PHASE_DOWNLOADING] = {TD_DRIVE_REST, true, true, .works = true, .aborted = TD_PHASE_READY},
    [TD_PHASE_DOWNLOADED] = {TD_DRIVE_REST, true, true, true, .aborted = TD_PHASE_READY},
    [TD_PHASE_EXECUTING] = {TD_DRIVE_EXECUTE, true, true, true, true, true, TD_PHASE_READY},
    [TD_PHASE_EXECUTION_PAUSED] = {TD_DRIVE_HOLD, true, true, true, true, true, TD_PHASE_READY},
    [TD_PHASE_MONITORING] = {TD_DRIVE_REST, true, true, .monitor = true, .aborted = TD_PHASE_READY},
    [TD_PHASE_MANUAL] = {TD_DRIVE_HOLD, true, .works = true, .aborted = TD_PHASE_READY},
    [TD_PHASE_FAILED] = {TD_DRIVE_STOP, .aborted = TD_PHASE_FAILED},
};

/* Why an event is refused where the phase has no reason of its own; and the message of one that is obeyed. */
static const struct {
    td_answer refused;
    uint32_t message;
} events[TD_EVENT_COUNT] = {
    [TD_EVENT_ENDED] = {TD_ANSWER_NOT_EXPECTED, 0},
    [TD_EVENT_DOWNLOADED] = {TD_ANSWER_NOT_EXPECTED, TD_MESSAGE_BIT(TD_MESSAGE_DOWNLOADED)},
    [TD_EVENT_PAUSE] = {TD_ANSWER_NOTHING_MOVES, TD_MESSAGE_BIT(TD_MESSAGE_PAUSED)},
    [TD_EVENT_AUTOMATIC] = {TD_ANSWER_NOT_MANUAL, 0},
    [TD_EVENT_RESUME] = {TD_ANSWER_NOT_PAUSED, TD_MESSAGE_BIT(TD_MESSAGE_RESUMED)},
    [TD_EVENT_PREPARE] = {TD_ANSWER_ALREADY, 0},
    [TD_EVENT_REINIT] = {TD_ANSWER_BUSY, 0},
    [TD_EVENT_START] = {TD_ANSWER_FINISHED, TD_MESSAGE_BIT(TD_MESSAGE_BEGUN)},
    [TD_EVENT_VALIDATE] = {TD_ANSWER_NOT_SIMULATED, 0},
    [TD_EVENT_DOWNLOAD] = {TD_ANSWER_NOT_VALIDATED, 0},
    [TD_EVENT_EXECUTE] = {TD_ANSWER_NOT_DOWNLOADED, TD_MESSAGE_BIT(TD_MESSAGE_BEGUN)},
    [TD_EVENT_MANUAL] = {TD_ANSWER_FINISHED, 0},
    [TD_EVENT_JOG] = {TD_ANSWER_NOT_MANUAL, 0},
};

static const struct {
    td_event event;
    td_fault fault;
} reported_faults[] = {
    {TD_EVENT_UNREACHABLE, TD_FAULT_UNREACHABLE}, {TD_EVENT_LIMIT, TD_FAULT_LIMIT},
    {TD_EVENT_SINGULARITY, TD_FAULT_SINGULARITY}, {TD_EVENT_DEADLINE, TD_FAULT_DEADLINE},
    {TD_EVENT_DEVIATION, TD_FAULT_DEVIATION},     {TD_EVENT_PART_FAILED, TD_FAULT_PART},
};

static bool came(const td_behaviour_inputs *in, td_event event)
{
    return (in->events & TD_EVENT_BIT(event)) != 0;
}

static void say(td_behaviour_outputs *out, td_message message)
{
    out->messages |= TD_MESSAGE_BIT(message);
}

/* ---- who wins ---- */

/* Not the task that was simulated, or not what the machine holds. */
static bool task_changed(const td_behaviour *s, const td_behaviour_inputs *in)
{
    if (!phases[s->phase].task) return false;
    const bool held =
        phases[s->phase].machine_task || (s->phase == TD_PHASE_DOWNLOADING && came(in, TD_EVENT_DOWNLOADED));
    return in->task != s->task || (held && in->machine_task != s->task);
}

/* Takes off the faults what the options allow: it is told, and counted. */
static uint32_t forgive(td_behaviour *s, const td_behaviour_inputs *in, td_behaviour_outputs *out)
{
    uint32_t left = in->events;
    if (came(in, TD_EVENT_SINGULARITY) && s->options.singularity == TD_SINGULARITY_CROSS) {
        left &= ~TD_EVENT_BIT(TD_EVENT_SINGULARITY);
        say(out, TD_MESSAGE_SINGULARITY_CROSSED);
    }
    if (came(in, TD_EVENT_DEADLINE) && s->deadlines < s->options.deadlines_forgiven) {
        left &= ~TD_EVENT_BIT(TD_EVENT_DEADLINE);
        s->deadlines++;
        say(out, TD_MESSAGE_DEADLINE_FORGIVEN);
    }
    return left;
}

static td_fault find_fault(const td_behaviour *s, const td_behaviour_inputs *in, uint32_t left)
{
    if (phases[s->phase].links && !in->links_open) return TD_FAULT_LINK_LOST;
    if (phases[s->phase].works && task_changed(s, in)) return TD_FAULT_TASK_CHANGED;
    for (size_t i = 0; i < sizeof reported_faults / sizeof *reported_faults; i++)
        if (left & TD_EVENT_BIT(reported_faults[i].event)) return reported_faults[i].fault;
    return TD_FAULT_NONE;
}

/* What an order or a report would be answered if it came alone. */
static td_answer judge(const td_behaviour *s, const td_behaviour_inputs *in, td_event event)
{
    const td_answer refused = events[event].refused;
    if (ways[s->phase][event] != TD_PHASE_IDLE) {
        if (event == TD_EVENT_START && in->task == 0) return TD_ANSWER_NO_TASK;
        if (event == TD_EVENT_DOWNLOAD && !s->options.has_machine) return TD_ANSWER_NO_MACHINE;
        return TD_ANSWER_ACCEPTED;
    }
    if (refused == TD_ANSWER_NOT_EXPECTED || refused == TD_ANSWER_ALREADY) return refused;
    if (s->phase == TD_PHASE_IDLE || s->phase == TD_PHASE_PREPARING) return TD_ANSWER_NOT_PREPARED;
    if (s->phase == TD_PHASE_FAILED) return TD_ANSWER_FAILED;
    if (refused == TD_ANSWER_FINISHED && phases[s->phase].works) return TD_ANSWER_BUSY;
    return refused;
}

/* The one that is obeyed; TD_EVENT_COUNT: none. */
static td_event first_taken(const td_behaviour *s, const td_behaviour_inputs *in)
{
    for (td_event e = TD_EVENT_ENDED; e < TD_EVENT_COUNT; e++) {
        if (!came(in, e)) continue;
        if (judge(s, in, e) == TD_ANSWER_ACCEPTED) return e;
        if (e == TD_EVENT_PAUSE) break;
    }
    return TD_EVENT_COUNT;
}

/* ---- what follows ---- */

static void enter(td_behaviour *s, td_phase phase)
{
    s->phase = phase;
    s->fault = TD_FAULT_NONE;
    if (!phases[phase].task) s->task = 0;
}

static void end_session(td_behaviour *s, td_behaviour_outputs *out)
{
    enter(s, TD_PHASE_IDLE);
    out->drive = TD_DRIVE_STOP;
    out->close_links = true;
    say(out, TD_MESSAGE_SESSION_ENDED);
}

static void fail(td_behaviour *s, td_fault fault, td_behaviour_outputs *out)
{
    out->drive = TD_DRIVE_STOP;
    out->fault = fault;
    say(out, TD_MESSAGE_FAILED);
    if (s->phase == TD_PHASE_IDLE || s->phase == TD_PHASE_FAILED) return;
    enter(s, TD_PHASE_FAILED);
    s->fault = fault;
}

static void give_up(td_behaviour *s, td_behaviour_outputs *out)
{
    const td_fault fault = s->fault;
    out->close_links = s->phase == TD_PHASE_PREPARING;
    enter(s, phases[s->phase].aborted);
    s->fault = fault;
    out->drive = TD_DRIVE_STOP;
    say(out, TD_MESSAGE_ABORTED);
}

static void obey(td_behaviour *s, const td_behaviour_inputs *in, td_event event, td_behaviour_outputs *out)
{
    enter(s, ways[s->phase][event]);
    out->drive = phases[s->phase].drive;
    out->messages |= events[event].message;
    out->begin = event == TD_EVENT_START || event == TD_EVENT_EXECUTE;
    out->open_links = out->read_parameters = s->phase == TD_PHASE_PREPARING;
    if (out->begin || event == TD_EVENT_MANUAL || s->phase == TD_PHASE_PREPARING) s->deadlines = 0;
    if (event == TD_EVENT_START) s->task = in->task;
    if (event == TD_EVENT_ENDED)
        say(out, s->phase == TD_PHASE_SIMULATED ? TD_MESSAGE_SIMULATION_ENDED : TD_MESSAGE_EXECUTION_ENDED);
    if (event == TD_EVENT_JOG) out->drive = TD_DRIVE_JOG;
    if (event == TD_EVENT_AUTOMATIC) out->drive = TD_DRIVE_STOP;
}

/* At most one step, by the header's priorities. Returns the event that was obeyed; TD_EVENT_COUNT: none. */
static td_event step(td_behaviour *s, const td_behaviour_inputs *in, td_behaviour_outputs *out)
{
    const td_fault fault = find_fault(s, in, forgive(s, in, out));
    td_event taken = TD_EVENT_COUNT;
    out->drive = phases[s->phase].drive;
    if (fault) fail(s, fault, out);
    if (came(in, TD_EVENT_USER_STOP)) {
        end_session(s, out);
    } else if (fault) {
        return taken;
    } else if (came(in, TD_EVENT_ABORT)) {
        give_up(s, out);
    } else if (task_changed(s, in)) {
        enter(s, TD_PHASE_READY);
        out->drive = TD_DRIVE_STOP;
        say(out, TD_MESSAGE_TASK_CHANGED);
    } else if (s->phase == TD_PHASE_PREPARING && in->links_open && in->parameters_read) {
        enter(s, TD_PHASE_READY);
        say(out, TD_MESSAGE_PREPARED);
    } else {
        taken = first_taken(s, in);
        if (taken != TD_EVENT_COUNT) obey(s, in, taken, out);
    }
    return taken;
}

void td_behaviour_react(td_behaviour *state, const td_behaviour_inputs *inputs, td_behaviour_outputs *outputs)
{
    const td_behaviour before = *state;
    memset(outputs, 0, sizeof *outputs);
    const td_event taken = step(state, inputs, outputs);
    outputs->phase = state->phase;
    outputs->download = state->phase == TD_PHASE_DOWNLOADING;
    outputs->monitor = phases[state->phase].monitor;
    for (td_event e = 0; e < TD_EVENT_COUNT; e++) {
        if (!came(inputs, e)) continue;
        const td_answer alone = e <= TD_EVENT_ABORT ? TD_ANSWER_ACCEPTED : judge(&before, inputs, e);
        const bool overtaken = e > TD_EVENT_ABORT && e != taken && alone == TD_ANSWER_ACCEPTED;
        outputs->answer[e] = overtaken ? TD_ANSWER_OVERTAKEN : alone;
    }
}

uint32_t td_behaviour_offers(const td_behaviour *state, const td_behaviour_inputs *inputs)
{
    uint32_t offers = TD_EVENT_BIT(TD_EVENT_USER_STOP) | TD_EVENT_BIT(TD_EVENT_ABORT);
    for (td_event e = TD_EVENT_PAUSE; e < TD_EVENT_COUNT; e++) {
        td_behaviour s = *state;
        td_behaviour_inputs in = *inputs;
        td_behaviour_outputs out;
        in.events = TD_EVENT_BIT(e);
        td_behaviour_react(&s, &in, &out);
        if (out.answer[e] == TD_ANSWER_ACCEPTED) offers |= TD_EVENT_BIT(e);
    }
    return offers;
}

/* ---- begin, and words ---- */

td_behaviour_options td_behaviour_options_default(void)
{
    return (td_behaviour_options){.singularity = TD_SINGULARITY_CROSS};
}

void td_behaviour_begin(td_behaviour *state, const td_behaviour_options *options)
{
    *state = (td_behaviour){.phase = TD_PHASE_IDLE,
                            .options = options ? *options : td_behaviour_options_default()};
}

static const char *text_of(const char *const *text, size_t count, int code)
{
    return code >= 0 && (size_t)code < count ? text[code] : "unknown";
}

#define TD_BEHAVIOUR_TEXT(code, text) text,
#define TD_BEHAVIOUR_TEXT_FUNCTION(name, list)                                                               \
    const char *td_##name##_text(td_##name code)                                                             \
    {                                                                                                        \
        static const char *const text[] = {list(TD_BEHAVIOUR_TEXT)};                                         \
        return text_of(text, sizeof text / sizeof *text, (int)code);                                         \
    }
TD_BEHAVIOUR_TEXT_FUNCTION(phase, TD_PHASE_LIST)
TD_BEHAVIOUR_TEXT_FUNCTION(event, TD_EVENT_LIST)
TD_BEHAVIOUR_TEXT_FUNCTION(fault, TD_FAULT_LIST)
TD_BEHAVIOUR_TEXT_FUNCTION(answer, TD_ANSWER_LIST)
TD_BEHAVIOUR_TEXT_FUNCTION(message, TD_MESSAGE_LIST)
