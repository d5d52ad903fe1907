/* The properties, one function each; and the history they are judged by. */
#include "tests/verify/properties.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* One reaction, seen from outside. */
typedef struct seen {
    const td_behaviour *before, *after;
    const td_behaviour_inputs *in;
    const td_behaviour_outputs *out;
    const verify_history *was, *is; /* before and after */
    bool fault;                     /* there is one, by the inputs and the history */
} seen;

static bool came(const td_behaviour_inputs *in, td_event event)
{
    return (in->events & TD_EVENT_BIT(event)) != 0;
}

static bool accepted(const td_behaviour_outputs *out, td_event event)
{
    return out->answer[event] == TD_ANSWER_ACCEPTED;
}

static bool runs(td_drive drive)
{
    return drive == TD_DRIVE_SIMULATE || drive == TD_DRIVE_EXECUTE;
}

static bool moves(td_drive drive)
{
    return runs(drive) || drive == TD_DRIVE_JOG;
}

/* The reaction of a copy to these events alone, with the levels of `in`. */
static td_behaviour react_alone(td_behaviour state, td_behaviour_inputs in, uint32_t alone,
                                td_behaviour_outputs *out)
{
    in.events = alone;
    td_behaviour_react(&state, &in, out);
    return state;
}

/* Then what was shown of the state when it was entered still holds. */
static bool same_state(const seen *a)
{
    return memcmp(a->before, a->after, sizeof *a->before) == 0;
}

/* ---- history ---- */

/* The task that the session has at hand, by its history; 0: none. */
static uint32_t at_hand(const verify_history *h)
{
    return h->simulating ? h->simulating : h->simulated;
}

static bool changed(const verify_history *h, const td_behaviour_inputs *in)
{
    const bool held = h->downloaded || (h->downloading && came(in, TD_EVENT_DOWNLOADED));
    return at_hand(h) && (in->task != at_hand(h) || (held && in->machine_task != at_hand(h)));
}

static bool is_fault(const verify_history *h, const td_behaviour_options *options,
                     const td_behaviour_inputs *in)
{
    const bool working = h->simulating || h->downloading || h->executing;
    return came(in, TD_EVENT_UNREACHABLE) || came(in, TD_EVENT_LIMIT) || came(in, TD_EVENT_DEVIATION) ||
           came(in, TD_EVENT_PART_FAILED) ||
           (came(in, TD_EVENT_SINGULARITY) && options->singularity == TD_SINGULARITY_FAIL) ||
           (came(in, TD_EVENT_DEADLINE) && h->missed >= options->deadlines_forgiven) ||
           (h->prepared && !in->links_open) || (working && changed(h, in));
}

static void note_accepted(verify_history *h, const td_behaviour_inputs *in, const td_behaviour_outputs *out)
{
    if (accepted(out, TD_EVENT_PREPARE) || accepted(out, TD_EVENT_REINIT))
        *h = (verify_history){.preparing = 1};
    if (accepted(out, TD_EVENT_START) || accepted(out, TD_EVENT_EXECUTE) || accepted(out, TD_EVENT_MANUAL))
        h->missed = 0;
    if (accepted(out, TD_EVENT_START)) h->simulating = in->task;
    if (accepted(out, TD_EVENT_VALIDATE)) h->validated = h->simulated;
    if (accepted(out, TD_EVENT_DOWNLOAD)) h->downloading = 1;
    if (accepted(out, TD_EVENT_DOWNLOADED)) {
        h->downloading = 0;
        h->downloaded = 1;
    }
    if (accepted(out, TD_EVENT_EXECUTE)) h->executing = 1;
    if (accepted(out, TD_EVENT_PAUSE) && !h->manual) h->paused = 1;
    if (accepted(out, TD_EVENT_RESUME)) h->paused = 0;
    if (accepted(out, TD_EVENT_ENDED)) {
        if (h->simulating) h->simulated = h->simulating;
        /* The machine stands elsewhere now, and may forget the task. */
        if (h->executing) h->downloaded = h->validated = 0;
        h->simulating = h->executing = h->paused = 0;
    }
    if (accepted(out, TD_EVENT_MANUAL)) h->manual = 1;
    if (accepted(out, TD_EVENT_AUTOMATIC)) h->manual = 0;
}

static void note(verify_history *h, bool fault, const td_behaviour_options *options,
                 const td_behaviour_inputs *in, const td_behaviour_outputs *out)
{
    const bool session = h->preparing || h->prepared || h->failed;
    if (came(in, TD_EVENT_DEADLINE) && h->missed < options->deadlines_forgiven) h->missed++;
    if (came(in, TD_EVENT_USER_STOP)) {
        *h = (verify_history){.missed = h->missed};
    } else if (fault) {
        *h = (verify_history){.failed = session, .missed = h->missed};
    } else if (came(in, TD_EVENT_ABORT) || changed(h, in)) {
        *h = (verify_history){.prepared = h->prepared, .failed = h->failed, .missed = h->missed};
    } else if (h->preparing && in->links_open && in->parameters_read) {
        h->preparing = 0;
        h->prepared = 1;
    } else {
        note_accepted(h, in, out);
    }
    h->moved = moves(out->drive);
}

/* ---- the properties: true where they hold ---- */

static bool holds_moves(const seen *a)
{
    const td_drive drive = a->out->drive;
    if (drive == TD_DRIVE_SIMULATE) return a->is->simulating && !a->is->paused;
    if (drive == TD_DRIVE_EXECUTE) return a->is->executing && !a->is->paused;
    if (drive == TD_DRIVE_JOG) return a->was->manual && came(a->in, TD_EVENT_JOG);
    return true;
}

static bool holds_fault(const seen *a)
{
    return !a->fault || (a->out->drive == TD_DRIVE_STOP && a->out->fault != TD_FAULT_NONE);
}

static bool holds_stop(const seen *a)
{
    const bool user_stop = came(a->in, TD_EVENT_USER_STOP), abort = came(a->in, TD_EVENT_ABORT);
    if (user_stop && !(a->out->close_links && a->out->phase == TD_PHASE_IDLE)) return false;
    if (user_stop && !accepted(a->out, TD_EVENT_USER_STOP)) return false;
    if (abort && !accepted(a->out, TD_EVENT_ABORT)) return false;
    return !(user_stop || abort) || a->out->drive == TD_DRIVE_STOP;
}

static bool holds_prepared(const seen *a)
{
    static const td_event needs[] = {TD_EVENT_START,   TD_EVENT_RESUME, TD_EVENT_VALIDATE, TD_EVENT_DOWNLOAD,
                                     TD_EVENT_EXECUTE, TD_EVENT_MANUAL, TD_EVENT_JOG};
    for (size_t i = 0; i < sizeof needs / sizeof *needs; i++)
        if (accepted(a->out, needs[i]) && !a->was->prepared) return false;
    return true;
}

static bool holds_reinit(const seen *a)
{
    td_behaviour_outputs out;
    if (!a->is->failed || same_state(a)) return true;
    const td_behaviour_inputs lost = {0}, passed = {.links_open = true, .parameters_read = true};
    td_behaviour s = react_alone(*a->after, lost, TD_EVENT_BIT(TD_EVENT_REINIT), &out);
    if (!accepted(&out, TD_EVENT_REINIT) || !out.open_links || !out.read_parameters) return false;
    react_alone(s, passed, 0, &out);
    return out.phase == TD_PHASE_READY;
}

static bool holds_validated(const seen *a)
{
    return !(a->out->drive == TD_DRIVE_EXECUTE || a->out->download) || a->is->validated;
}

static bool holds_unchanged(const seen *a)
{
    if (a->out->download && a->in->task != a->is->validated) return false;
    return a->out->drive != TD_DRIVE_EXECUTE ||
           (a->in->task == a->is->validated && a->in->machine_task == a->is->validated);
}

static bool holds_pause(const seen *a)
{
    if (came(a->in, TD_EVENT_PAUSE) && moves(a->out->drive)) return false;
    if (a->is->paused && a->out->drive != TD_DRIVE_HOLD) return false;
    return !a->was->paused || accepted(a->out, TD_EVENT_RESUME) || !moves(a->out->drive);
}

static bool holds_manual(const seen *a)
{
    const bool by_hand = accepted(a->out, TD_EVENT_MANUAL) || accepted(a->out, TD_EVENT_JOG);
    const bool by_itself = accepted(a->out, TD_EVENT_START) || accepted(a->out, TD_EVENT_EXECUTE) ||
                           accepted(a->out, TD_EVENT_RESUME);
    if (by_hand && (a->was->simulating || a->was->downloading || a->was->executing)) return false;
    return !(by_itself && a->was->manual);
}

static bool holds_no_deadlock(const seen *a)
{
    td_behaviour_outputs out;
    if (same_state(a)) return true;
    const td_behaviour_inputs none = {0};
    const td_phase last = a->after->options.has_machine ? TD_PHASE_MONITORING : TD_PHASE_VALIDATED;
    td_behaviour s = react_alone(*a->after, none, TD_EVENT_BIT(TD_EVENT_USER_STOP), &out);
    for (int i = 0; i < 9; i++) {
        const td_behaviour_inputs in = verify_next(&s);
        if (s.phase == last) break;
        td_behaviour_react(&s, &in, &out);
    }
    return s.phase == last;
}

static bool holds_answered(const seen *a)
{
    for (td_event e = 0; e < TD_EVENT_COUNT; e++) {
        const td_answer answer = a->out->answer[e];
        if (came(a->in, e) != (answer > TD_ANSWER_NONE && answer < TD_ANSWER_COUNT)) return false;
        if (!came(a->in, e) && answer != TD_ANSWER_NONE) return false;
    }
    return true;
}

static bool holds_refused(const seen *a)
{
    uint32_t taken = a->in->events;
    for (td_event e = TD_EVENT_PAUSE; e < TD_EVENT_COUNT; e++)
        if (!accepted(a->out, e)) taken &= ~TD_EVENT_BIT(e);
    if (taken == a->in->events) return true;
    td_behaviour_outputs out;
    const td_behaviour s = react_alone(*a->before, *a->in, taken, &out);
    memcpy(out.answer, a->out->answer, sizeof out.answer);
    return memcmp(&s, a->after, sizeof s) == 0 && memcmp(&out, a->out, sizeof out) == 0;
}

static bool holds_failed(const seen *a)
{
    if (!a->was->failed) return true;
    for (td_event e = TD_EVENT_ABORT + 1; e < TD_EVENT_COUNT; e++)
        if (e != TD_EVENT_REINIT && accepted(a->out, e)) return false;
    return !moves(a->out->drive);
}

static bool holds_linked(const seen *a)
{
    return a->in->links_open || !moves(a->out->drive);
}

static bool holds_priority(const seen *a)
{
    const bool stop = a->fault || came(a->in, TD_EVENT_USER_STOP) || came(a->in, TD_EVENT_ABORT);
    bool more_urgent = stop;
    for (td_event e = TD_EVENT_ABORT + 1; e < TD_EVENT_COUNT; e++) {
        td_behaviour_outputs out;
        if (!came(a->in, e)) continue;
        if (accepted(a->out, e) && more_urgent) return false;
        if (a->in->events == TD_EVENT_BIT(e)) return true;
        react_alone(*a->before, *a->in, TD_EVENT_BIT(e), &out);
        const bool alone = accepted(&out, e);
        if (alone && !more_urgent && !accepted(a->out, e)) return false;
        more_urgent = more_urgent || alone || e == TD_EVENT_PAUSE;
    }
    return true;
}

static bool holds_deadline(const seen *a)
{
    const bool forgiven = a->was->missed < a->before->options.deadlines_forgiven;
    const bool told = a->out->messages & TD_MESSAGE_BIT(TD_MESSAGE_DEADLINE_FORGIVEN);
    if (!came(a->in, TD_EVENT_DEADLINE)) return !told && a->out->fault != TD_FAULT_DEADLINE;
    if (forgiven) return told && a->out->fault != TD_FAULT_DEADLINE;
    return !told && a->out->drive == TD_DRIVE_STOP;
}

static bool holds_singularity(const seen *a)
{
    const bool cross = a->before->options.singularity == TD_SINGULARITY_CROSS;
    const bool told = a->out->messages & TD_MESSAGE_BIT(TD_MESSAGE_SINGULARITY_CROSSED);
    if (!came(a->in, TD_EVENT_SINGULARITY)) return !told && a->out->fault != TD_FAULT_SINGULARITY;
    if (cross) return told && a->out->fault != TD_FAULT_SINGULARITY;
    return !told && a->out->drive == TD_DRIVE_STOP;
}

static bool holds_not_silent(const seen *a)
{
    const td_drive drive = a->out->drive;
    return !a->was->moved || moves(drive) || drive == TD_DRIVE_HOLD || drive == TD_DRIVE_STOP ||
           accepted(a->out, TD_EVENT_ENDED);
}

static bool holds_legal(const seen *a)
{
    const td_behaviour *s = a->after;
    const bool about_task = s->phase >= TD_PHASE_SIMULATING && s->phase <= TD_PHASE_MONITORING;
    return s->phase < TD_PHASE_COUNT && s->fault < TD_FAULT_COUNT && a->out->phase == s->phase &&
           (s->fault != TD_FAULT_NONE) == (s->phase == TD_PHASE_FAILED) && (s->task != 0) == about_task &&
           s->deadlines <= s->options.deadlines_forgiven &&
           memcmp(&s->options, &a->before->options, sizeof s->options) == 0;
}

static bool holds_pure(const seen *a)
{
    td_behaviour_outputs out;
    memset(&out, 0x5a, sizeof out);
    const td_behaviour s = react_alone(*a->before, *a->in, a->in->events, &out);
    return memcmp(&s, a->after, sizeof s) == 0 && memcmp(&out, a->out, sizeof out) == 0;
}

static bool holds_watched(const seen *a)
{
    return !a->is->executing || a->out->monitor;
}

static bool holds_resumed(const seen *a)
{
    return a->out->begin == (accepted(a->out, TD_EVENT_START) || accepted(a->out, TD_EVENT_EXECUTE));
}

/* ---- all together ---- */

static const struct {
    const char *name, *sentence;
    bool (*holds)(const seen *);
} properties[] = {
#define VERIFY_ROW(name, sentence) {#name, sentence, holds_##name},
    VERIFY_LIST(VERIFY_ROW)
#undef VERIFY_ROW
};

static void print_reaction(const seen *a, uint32_t broken)
{
    printf("%s: links %d parameters %d task %u machine %u:", td_phase_text(a->before->phase),
           a->in->links_open, a->in->parameters_read, a->in->task, a->in->machine_task);
    for (td_event e = 0; e < TD_EVENT_COUNT; e++)
        if (came(a->in, e)) printf(" %s (%s)", td_event_text(e), td_answer_text(a->out->answer[e]));
    printf(" -> %s, drive %d\n", td_phase_text(a->after->phase), (int)a->out->drive);
    for (int i = 0; i < VERIFY_COUNT; i++)
        if (broken & UINT32_C(1) << i)
            printf("broken: %d %s: %s\n", i + 1, properties[i].name, properties[i].sentence);
}

void verify_begin(td_behaviour *state, verify_history *history, int options)
{
    const td_behaviour_options o = {.singularity = options & 1 ? TD_SINGULARITY_FAIL : TD_SINGULARITY_CROSS,
                                    .deadlines_forgiven = options & 2 ? 1 : 0,
                                    .has_machine = options & 4 ? 1 : 0};
    td_behaviour_begin(state, &o);
    *history = (verify_history){0};
}

uint32_t verify_react(td_behaviour *state, verify_history *history, const td_behaviour_inputs *inputs,
                      td_behaviour_outputs *outputs)
{
    static int only = -1, print = 0;
    if (only < 0) {
        const char *property = getenv("PROPERTY");
        only = property ? atoi(property) : 0;
        print = getenv("VERIFY_PRINT") != NULL;
    }
    const td_behaviour before = *state;
    const verify_history was = *history;
    memset(outputs, 0xa5, sizeof *outputs);
    td_behaviour_react(state, inputs, outputs);
    const bool fault = is_fault(&was, &before.options, inputs);
    note(history, fault, &before.options, inputs, outputs);
    const seen a = {&before, state, inputs, outputs, &was, history, fault};
    uint32_t broken = 0;
    for (int i = 0; i < VERIFY_COUNT; i++)
        if ((only == 0 || only == i + 1) && !properties[i].holds(&a)) broken |= UINT32_C(1) << i;
    if (print || broken) print_reaction(&a, broken);
    return broken;
}

td_behaviour_inputs verify_next(const td_behaviour *state)
{
    static const uint32_t next[TD_PHASE_COUNT] = {
        [TD_PHASE_IDLE] = TD_EVENT_BIT(TD_EVENT_PREPARE),
        [TD_PHASE_READY] = TD_EVENT_BIT(TD_EVENT_START),
        [TD_PHASE_SIMULATING] = TD_EVENT_BIT(TD_EVENT_ENDED),
        [TD_PHASE_SIMULATION_PAUSED] = TD_EVENT_BIT(TD_EVENT_RESUME),
        [TD_PHASE_SIMULATED] = TD_EVENT_BIT(TD_EVENT_VALIDATE),
        [TD_PHASE_VALIDATED] = TD_EVENT_BIT(TD_EVENT_DOWNLOAD),
        [TD_PHASE_DOWNLOADING] = TD_EVENT_BIT(TD_EVENT_DOWNLOADED),
        [TD_PHASE_DOWNLOADED] = TD_EVENT_BIT(TD_EVENT_EXECUTE),
        [TD_PHASE_EXECUTING] = TD_EVENT_BIT(TD_EVENT_ENDED),
        [TD_PHASE_EXECUTION_PAUSED] = TD_EVENT_BIT(TD_EVENT_RESUME),
        [TD_PHASE_MANUAL] = TD_EVENT_BIT(TD_EVENT_AUTOMATIC),
        [TD_PHASE_MONITORING] = TD_EVENT_BIT(TD_EVENT_REINIT),
        [TD_PHASE_FAILED] = TD_EVENT_BIT(TD_EVENT_REINIT),
    };
    return (td_behaviour_inputs){.events = next[state->phase],
                                 .links_open = true,
                                 .parameters_read = true,
                                 .task = state->task ? state->task : 1,
                                 .machine_task = state->task ? state->task : 1};
}
