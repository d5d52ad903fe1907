/* The session's behaviour.
 *
 * Proves, by tables a person can read, what the paper's session does: prepare, simulate, pause, fail and
 * begin anew; the whole system's phases; jogging. Then, on random sequences with any set of events at once,
 * that each property of tests/verify/properties.h holds; and that a set of events has the effect of the most
 * urgent of them beside UserStop and what may be forgiven, so that the sets SPIN tries stand for all.
 * Against: the table in sim/behaviour.h and the properties. Exact: there are no tolerances. Blind to: what a
 * caller makes of the outputs. Every sequence is SPIN's part (tests/verify). */
#include "core/random.h"
#include "sim/behaviour.h"
#include "tests/check.h"
#include "tests/verify/properties.h"

#define AND(a, b) (TD_EVENT_BIT(a) | TD_EVENT_BIT(b))

static const td_behaviour_inputs GOOD = {0, true, true, 7, 7}; /* links, parameters, task, machine's task */
static const td_behaviour_inputs UNREAD = {0, true, false, 7, 7};   /* parameters not read */
static const td_behaviour_inputs LOST = {0, false, true, 7, 7};     /* a link is not open */
static const td_behaviour_inputs NO_TASK = {0, true, true, 0, 7};   /* nothing to simulate */
static const td_behaviour_inputs CHANGED = {0, true, true, 8, 7};   /* the operator changed the task */
static const td_behaviour_inputs FORGOTTEN = {0, true, true, 7, 0}; /* the machine holds nothing */
static const td_behaviour_options PAPER = {TD_SINGULARITY_CROSS, 0, 0};
static const td_behaviour_options MACHINE = {TD_SINGULARITY_CROSS, 0, 1};
static const td_behaviour_options STRICT = {TD_SINGULARITY_FAIL, 2, 0};

/* A reaction and what it must come to. `event` TD_EVENT_COUNT: none. */
typedef struct row {
    td_event event;
    const td_behaviour_inputs *levels;
    td_answer answer;
    td_phase phase;
    td_drive drive;
} row;
#define NOTHING TD_EVENT_COUNT, &GOOD, TD_ANSWER_NONE

static td_behaviour play(const char *name, const td_behaviour_options *options, const row *rows, size_t count)
{
    td_behaviour s;
    td_behaviour_begin(&s, options);
    for (size_t i = 0; i < count; i++) {
        const row *r = rows + i;
        td_behaviour_inputs in = *r->levels;
        td_behaviour_outputs out;
        if (r->event < TD_EVENT_COUNT) in.events = TD_EVENT_BIT(r->event);
        td_behaviour_react(&s, &in, &out);
        const td_answer answer = r->event < TD_EVENT_COUNT ? out.answer[r->event] : TD_ANSWER_NONE;
        if (answer != r->answer || out.phase != r->phase || out.drive != r->drive)
            fail_msg("%s, row %zu: '%s' was %s; %s, drive %d, instead of %s; %s, drive %d", name, i + 1,
                     td_event_text(r->event), td_answer_text(answer), td_phase_text(out.phase),
                     (int)out.drive, td_answer_text(r->answer), td_phase_text(r->phase), (int)r->drive);
    }
    return s;
}
#define PLAY(name, options, rows) play(name, options, rows, sizeof(rows) / sizeof *(rows))

#define YES TD_ANSWER_ACCEPTED
#define EV(name) TD_EVENT_##name
#define NO(name) TD_ANSWER_##name
#define PH(name) TD_PHASE_##name
#define DO(name) TD_DRIVE_##name

/* clang-format off */
static void the_papers_session(void **state)
{
    (void)state;
    static const row rows[] = {
        {EV(START), &GOOD,      NO(NOT_PREPARED),  PH(IDLE),              DO(REST)},
        {EV(PREPARE), &UNREAD,  YES,               PH(PREPARING),         DO(REST)},
        {EV(START), &UNREAD,    NO(NOT_PREPARED),  PH(PREPARING),         DO(REST)},
        {TD_EVENT_COUNT, &LOST, NO(NONE),          PH(PREPARING),         DO(REST)}, /* waits for the link */
        {NOTHING,                                  PH(READY),             DO(REST)}, /* both checks passed */
        {EV(PREPARE), &GOOD,    NO(ALREADY),       PH(READY),             DO(REST)},
        {EV(START), &NO_TASK,   NO(NO_TASK),       PH(READY),             DO(REST)},
        {EV(START), &GOOD,      YES,               PH(SIMULATING),        DO(SIMULATE)},
        {NOTHING,                                  PH(SIMULATING),        DO(SIMULATE)},
        {EV(SINGULARITY), &GOOD, YES,              PH(SIMULATING),        DO(SIMULATE)}, /* crossed */
        {EV(START), &GOOD,      NO(BUSY),          PH(SIMULATING),        DO(SIMULATE)},
        {EV(REINIT), &GOOD,     NO(BUSY),          PH(SIMULATING),        DO(SIMULATE)},
        {EV(ENDED), &GOOD,      YES,               PH(SIMULATED),         DO(REST)},
        {EV(ENDED), &GOOD,      NO(NOT_EXPECTED),  PH(SIMULATED),         DO(REST)},
        {EV(START), &GOOD,      NO(FINISHED),      PH(SIMULATED),         DO(REST)},
        {EV(REINIT), &UNREAD,   YES,               PH(PREPARING),         DO(REST)}, /* another */
        {NOTHING,                                  PH(READY),             DO(REST)},
        {EV(START), &GOOD,      YES,               PH(SIMULATING),        DO(SIMULATE)},
        {EV(ABORT), &GOOD,      YES,               PH(READY),             DO(STOP)},
        {EV(USER_STOP), &GOOD,  YES,               PH(IDLE),              DO(STOP)},
        {NOTHING,                                  PH(IDLE),              DO(REST)},
    };
    const td_behaviour s = PLAY("the paper's session", &PAPER, rows);
    td_behaviour begun;
    td_behaviour_begin(&begun, NULL); /* the paper's options are the defaults */
    assert_memory_equal(&s, &begun, sizeof s);
}

static void a_pause_holds(void **state)
{
    (void)state;
    static const row rows[] = {
        {EV(PREPARE), &GOOD,  YES,              PH(PREPARING),         DO(REST)},
        {NOTHING,                               PH(READY),             DO(REST)},
        {EV(PAUSE), &GOOD,    NO(NOTHING_MOVES), PH(READY),            DO(REST)},
        {EV(START), &GOOD,    YES,              PH(SIMULATING),        DO(SIMULATE)},
        {EV(RESUME), &GOOD,   NO(NOT_PAUSED),   PH(SIMULATING),        DO(SIMULATE)},
        {EV(PAUSE), &GOOD,    YES,              PH(SIMULATION_PAUSED), DO(HOLD)},
        {NOTHING,                               PH(SIMULATION_PAUSED), DO(HOLD)},
        {EV(PAUSE), &GOOD,    YES,              PH(SIMULATION_PAUSED), DO(HOLD)},
        {EV(START), &GOOD,    NO(BUSY),         PH(SIMULATION_PAUSED), DO(HOLD)},
        {EV(MANUAL), &GOOD,   NO(BUSY),         PH(SIMULATION_PAUSED), DO(HOLD)},
        {EV(RESUME), &GOOD,   YES,              PH(SIMULATING),        DO(SIMULATE)},
        {EV(PAUSE), &GOOD,    YES,              PH(SIMULATION_PAUSED), DO(HOLD)},
        {EV(ENDED), &GOOD,    YES,              PH(SIMULATED),         DO(REST)}, /* crossed on the wire */
    };
    PLAY("a pause holds", &PAPER, rows);
}

static void a_failure_waits_for_reinit(void **state)
{
    (void)state;
    static const row rows[] = {
        {EV(PREPARE), &GOOD,      YES,         PH(PREPARING),  DO(REST)},
        {NOTHING,                              PH(READY),      DO(REST)},
        {EV(START), &GOOD,        YES,         PH(SIMULATING), DO(SIMULATE)},
        {EV(UNREACHABLE), &GOOD,  YES,         PH(FAILED),     DO(STOP)},
        {NOTHING,                              PH(FAILED),     DO(STOP)},
        {EV(START), &GOOD,        NO(FAILED),  PH(FAILED),     DO(STOP)},
        {EV(RESUME), &GOOD,       NO(FAILED),  PH(FAILED),     DO(STOP)},
        {EV(ABORT), &GOOD,        YES,         PH(FAILED),     DO(STOP)},
        {EV(LIMIT), &GOOD,        YES,         PH(FAILED),     DO(STOP)}, /* a second fault */
        {EV(REINIT), &LOST,       YES,         PH(PREPARING),  DO(REST)},
        {EV(ABORT), &LOST,        YES,         PH(IDLE),       DO(STOP)},
        {EV(LIMIT), &LOST,        YES,         PH(IDLE),       DO(STOP)},
        {EV(PREPARE), &LOST,      YES,         PH(PREPARING),  DO(REST)},
        {EV(PART_FAILED), &LOST,  YES,         PH(FAILED),     DO(STOP)}, /* a check that cannot be passed */
        {EV(REINIT), &GOOD,       YES,         PH(PREPARING),  DO(REST)},
        {NOTHING,                              PH(READY),      DO(REST)},
        {EV(START), &CHANGED,     YES,         PH(SIMULATING), DO(SIMULATE)},
    };
    PLAY("a failure waits for Reinit", &PAPER, rows);
}

static void the_whole_system(void **state)
{
    (void)state;
    static const row rows[] = {
        {EV(PREPARE), &GOOD,    YES,                PH(PREPARING),        DO(REST)},
        {NOTHING,                                   PH(READY),            DO(REST)},
        {EV(VALIDATE), &GOOD,   NO(NOT_SIMULATED),  PH(READY),            DO(REST)},
        {EV(DOWNLOAD), &GOOD,   NO(NOT_VALIDATED),  PH(READY),            DO(REST)},
        {EV(EXECUTE), &GOOD,    NO(NOT_DOWNLOADED), PH(READY),            DO(REST)},
        {EV(START), &GOOD,      YES,                PH(SIMULATING),       DO(SIMULATE)},
        {EV(VALIDATE), &GOOD,   NO(NOT_SIMULATED),  PH(SIMULATING),       DO(SIMULATE)},
        {EV(ENDED), &GOOD,      YES,                PH(SIMULATED),        DO(REST)},
        {EV(DOWNLOAD), &GOOD,   NO(NOT_VALIDATED),  PH(SIMULATED),        DO(REST)},
        {EV(VALIDATE), &GOOD,   YES,                PH(VALIDATED),        DO(REST)},
        {EV(EXECUTE), &GOOD,    NO(NOT_DOWNLOADED), PH(VALIDATED),        DO(REST)},
        {EV(DOWNLOAD), &FORGOTTEN, YES,             PH(DOWNLOADING),      DO(REST)},
        {EV(EXECUTE), &FORGOTTEN, NO(NOT_DOWNLOADED), PH(DOWNLOADING),    DO(REST)},
        {EV(DOWNLOADED), &GOOD, YES,                PH(DOWNLOADED),       DO(REST)},
        {EV(EXECUTE), &GOOD,    YES,                PH(EXECUTING),        DO(EXECUTE)},
        {EV(PAUSE), &GOOD,      YES,                PH(EXECUTION_PAUSED), DO(HOLD)},
        {EV(RESUME), &GOOD,     YES,                PH(EXECUTING),        DO(EXECUTE)},
        {EV(ENDED), &GOOD,      YES,                PH(MONITORING),       DO(REST)},
        {TD_EVENT_COUNT, &FORGOTTEN, NO(NONE),      PH(MONITORING),       DO(REST)},
        {EV(EXECUTE), &GOOD,    NO(NOT_DOWNLOADED), PH(MONITORING),       DO(REST)}, /* it stands elsewhere */
        {EV(DEVIATION), &GOOD,  YES,                PH(FAILED),           DO(STOP)},
    };
    PLAY("the whole system", &MACHINE, rows);
    static const row without[] = {
        {EV(PREPARE), &GOOD,    YES,                PH(PREPARING),        DO(REST)},
        {NOTHING,                                   PH(READY),            DO(REST)},
        {EV(START), &GOOD,      YES,                PH(SIMULATING),       DO(SIMULATE)},
        {EV(ENDED), &GOOD,      YES,                PH(SIMULATED),        DO(REST)},
        {EV(VALIDATE), &GOOD,   YES,                PH(VALIDATED),        DO(REST)},
        {EV(DOWNLOAD), &GOOD,   NO(NO_MACHINE),     PH(VALIDATED),        DO(REST)},
    };
    PLAY("no machine", &PAPER, without);
}

static void jogging(void **state)
{
    (void)state;
    static const row rows[] = {
        {EV(MANUAL), &GOOD,    NO(NOT_PREPARED), PH(IDLE),      DO(REST)},
        {EV(PREPARE), &GOOD,   YES,              PH(PREPARING), DO(REST)},
        {NOTHING,                                PH(READY),     DO(REST)},
        {EV(JOG), &GOOD,       NO(NOT_MANUAL),   PH(READY),     DO(REST)},
        {EV(AUTOMATIC), &GOOD, NO(NOT_MANUAL),   PH(READY),     DO(REST)},
        {EV(MANUAL), &GOOD,    YES,              PH(MANUAL),    DO(HOLD)},
        {EV(JOG), &GOOD,       YES,              PH(MANUAL),    DO(JOG)},
        {EV(JOG), &GOOD,       YES,              PH(MANUAL),    DO(JOG)},
        {NOTHING,                                PH(MANUAL),    DO(HOLD)}, /* the key is let go */
        {EV(START), &GOOD,     NO(BUSY),         PH(MANUAL),    DO(HOLD)},
        {EV(JOG), &CHANGED,    YES,              PH(MANUAL),    DO(JOG)},  /* no task is at hand */
        {EV(AUTOMATIC), &GOOD, YES,              PH(READY),     DO(STOP)},
        {EV(MANUAL), &GOOD,    YES,              PH(MANUAL),    DO(HOLD)},
        {EV(JOG), &LOST,       NO(OVERTAKEN),    PH(FAILED),    DO(STOP)},
    };
    PLAY("jogging", &PAPER, rows);
}

static void options_decide(void **state)
{
    (void)state;
    static const row paper[] = {
        {EV(PREPARE), &GOOD,     YES, PH(PREPARING),  DO(REST)},
        {NOTHING,                     PH(READY),      DO(REST)},
        {EV(START), &GOOD,       YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(DEADLINE), &GOOD,    YES, PH(FAILED),     DO(STOP)},
    };
    PLAY("the paper's deadline", &PAPER, paper);
    static const row strict[] = {
        {EV(PREPARE), &GOOD,     YES, PH(PREPARING),  DO(REST)},
        {NOTHING,                     PH(READY),      DO(REST)},
        {EV(START), &GOOD,       YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(DEADLINE), &GOOD,    YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(DEADLINE), &GOOD,    YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(ABORT), &GOOD,       YES, PH(READY),      DO(STOP)},
        {EV(START), &GOOD,       YES, PH(SIMULATING), DO(SIMULATE)}, /* counted anew */
        {EV(DEADLINE), &GOOD,    YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(DEADLINE), &GOOD,    YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(DEADLINE), &GOOD,    YES, PH(FAILED),     DO(STOP)},
        {EV(REINIT), &GOOD,      YES, PH(PREPARING),  DO(REST)},
        {NOTHING,                     PH(READY),      DO(REST)},
        {EV(START), &GOOD,       YES, PH(SIMULATING), DO(SIMULATE)},
        {EV(SINGULARITY), &GOOD, YES, PH(FAILED),     DO(STOP)},
    };
    PLAY("two deadlines and no singularity", &STRICT, strict);
}
/* clang-format on */

/* A state in that phase, with a machine; by the way that leads there. */
static td_behaviour reach(td_phase phase)
{
    td_behaviour s;
    td_behaviour_outputs out;
    td_behaviour_begin(&s, &MACHINE);
    for (int i = 0; i < 20 && s.phase != phase; i++) {
        td_behaviour_inputs in = verify_next(&s);
        in.task = in.machine_task = 7;
        if (phase == TD_PHASE_MANUAL && s.phase == TD_PHASE_READY) in.events = TD_EVENT_BIT(TD_EVENT_MANUAL);
        if (phase == TD_PHASE_FAILED && s.phase == TD_PHASE_READY) in.events = TD_EVENT_BIT(TD_EVENT_LIMIT);
        if (phase == TD_PHASE_SIMULATION_PAUSED && s.phase == TD_PHASE_SIMULATING)
            in.events = TD_EVENT_BIT(TD_EVENT_PAUSE);
        if (phase == TD_PHASE_EXECUTION_PAUSED && s.phase == TD_PHASE_EXECUTING)
            in.events = TD_EVENT_BIT(TD_EVENT_PAUSE);
        td_behaviour_react(&s, &in, &out);
    }
    assert_int_equal(s.phase, phase);
    return s;
}

static td_behaviour_outputs react(td_behaviour *s, const td_behaviour_inputs *levels, uint32_t events)
{
    td_behaviour_inputs in = *levels;
    td_behaviour_outputs out;
    in.events = events;
    td_behaviour_react(s, &in, &out);
    return out;
}

/* In every phase: UserStop ends the session, each fault stops and is named, and Reinit leads back from it. */
static void from_every_phase(void **state)
{
    (void)state;
    static const td_event fault[] = {TD_EVENT_UNREACHABLE, TD_EVENT_LIMIT, TD_EVENT_DEADLINE,
                                     TD_EVENT_DEVIATION, TD_EVENT_PART_FAILED};
    static const td_fault named[] = {TD_FAULT_UNREACHABLE, TD_FAULT_LIMIT, TD_FAULT_DEADLINE,
                                     TD_FAULT_DEVIATION, TD_FAULT_PART};
    for (td_phase p = 0; p < TD_PHASE_COUNT; p++) {
        td_behaviour s = reach(p);
        td_behaviour_outputs out = react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_USER_STOP));
        assert_int_equal(out.phase, TD_PHASE_IDLE);
        assert_int_equal(out.drive, TD_DRIVE_STOP);
        assert_true(out.close_links);
        if (p == TD_PHASE_IDLE || p == TD_PHASE_FAILED) continue;
        for (size_t i = 0; i < sizeof fault / sizeof *fault; i++) {
            s = reach(p);
            out = react(&s, &GOOD, TD_EVENT_BIT(fault[i]));
            assert_int_equal(out.phase, TD_PHASE_FAILED);
            assert_int_equal(out.drive, TD_DRIVE_STOP);
            assert_int_equal(out.fault, named[i]);
            assert_int_equal(s.fault, named[i]);
            assert_true(out.messages & TD_MESSAGE_BIT(TD_MESSAGE_FAILED));
            out = react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_REINIT));
            assert_true(out.open_links && out.read_parameters);
            out = react(&s, &GOOD, 0);
            assert_int_equal(out.phase, TD_PHASE_READY);
        }
        s = reach(p);
        out = react(&s, &LOST, 0);
        assert_int_equal(out.fault, p == TD_PHASE_PREPARING ? TD_FAULT_NONE : TD_FAULT_LINK_LOST);
    }
}

/* At work a changed task is a fault; at rest what was simulated and validated is void; else it is of no
 * account. The same for what the machine holds, from when it said so. */
static void a_changed_task(void **state)
{
    (void)state;
    for (td_phase p = TD_PHASE_SIMULATING; p <= TD_PHASE_MONITORING; p++) {
        const bool works = p <= TD_PHASE_SIMULATION_PAUSED || p == TD_PHASE_DOWNLOADING ||
                           p == TD_PHASE_EXECUTING || p == TD_PHASE_EXECUTION_PAUSED;
        const bool held = p >= TD_PHASE_DOWNLOADED && p <= TD_PHASE_EXECUTION_PAUSED;
        td_behaviour s = reach(p);
        td_behaviour_outputs out = react(&s, &CHANGED, TD_EVENT_BIT(TD_EVENT_DOWNLOAD));
        assert_int_equal(out.phase, works ? TD_PHASE_FAILED : TD_PHASE_READY);
        assert_int_equal(out.fault, works ? TD_FAULT_TASK_CHANGED : TD_FAULT_NONE);
        assert_int_equal(out.drive, TD_DRIVE_STOP);
        assert_int_not_equal(out.answer[TD_EVENT_DOWNLOAD], TD_ANSWER_ACCEPTED);
        s = reach(p);
        out = react(&s, &FORGOTTEN, 0);
        assert_int_equal(out.phase, !held ? p : works ? TD_PHASE_FAILED : TD_PHASE_READY);
    }
    td_behaviour s = reach(TD_PHASE_DOWNLOADING);
    const td_behaviour_outputs out = react(&s, &FORGOTTEN, TD_EVENT_BIT(TD_EVENT_DOWNLOADED));
    assert_int_equal(out.fault, TD_FAULT_TASK_CHANGED); /* it says that it holds another */
}

static void what_is_more_urgent_wins(void **state)
{
    (void)state;
    td_behaviour s = reach(TD_PHASE_EXECUTING);
    td_behaviour_outputs out = react(&s, &GOOD, AND(TD_EVENT_ABORT, TD_EVENT_LIMIT));
    assert_int_equal(out.phase, TD_PHASE_FAILED); /* a fault before Abort, which stops all the same */
    assert_int_equal(out.answer[TD_EVENT_ABORT], TD_ANSWER_ACCEPTED);
    s = reach(TD_PHASE_EXECUTING);
    out = react(&s, &GOOD, AND(TD_EVENT_USER_STOP, TD_EVENT_LIMIT));
    assert_int_equal(out.phase, TD_PHASE_IDLE);
    assert_int_equal(out.fault, TD_FAULT_LIMIT);
    s = reach(TD_PHASE_SIMULATING);
    out = react(&s, &GOOD, AND(TD_EVENT_ENDED, TD_EVENT_PAUSE));
    assert_int_equal(out.phase, TD_PHASE_SIMULATED); /* the end before a pause */
    assert_int_equal(out.answer[TD_EVENT_PAUSE], TD_ANSWER_OVERTAKEN);
    s = reach(TD_PHASE_SIMULATION_PAUSED);
    out = react(&s, &GOOD, AND(TD_EVENT_RESUME, TD_EVENT_PAUSE));
    assert_int_equal(out.drive, TD_DRIVE_HOLD);
    s = reach(TD_PHASE_READY);
    out = react(&s, &GOOD, AND(TD_EVENT_START, TD_EVENT_PAUSE));
    assert_int_equal(out.phase, TD_PHASE_READY); /* a refused Pause keeps others from moving */
    assert_int_equal(out.answer[TD_EVENT_PAUSE], TD_ANSWER_NOTHING_MOVES);
    assert_int_equal(out.answer[TD_EVENT_START], TD_ANSWER_OVERTAKEN);
    out = react(&s, &GOOD, AND(TD_EVENT_START, TD_EVENT_VALIDATE));
    assert_int_equal(out.phase, TD_PHASE_SIMULATING); /* what is refused stands in nobody's way */
    out = react(&s, &GOOD, UINT32_C(0xffffffff) << TD_EVENT_COUNT);
    assert_int_equal(out.drive, TD_DRIVE_SIMULATE); /* bits that are no event's */
}

static void commands_and_messages(void **state)
{
    (void)state;
    td_behaviour s = reach(TD_PHASE_READY);
    assert_true(react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_START)).begin);
    react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_PAUSE));
    assert_false(react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_RESUME)).begin);
    td_behaviour_outputs out = react(&s, &GOOD, AND(TD_EVENT_ENDED, TD_EVENT_SINGULARITY));
    assert_int_equal(out.messages, TD_MESSAGE_BIT(TD_MESSAGE_SIMULATION_ENDED) |
                                       TD_MESSAGE_BIT(TD_MESSAGE_SINGULARITY_CROSSED));
    react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_VALIDATE));
    assert_true(react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_DOWNLOAD)).download);
    assert_true(react(&s, &GOOD, 0).download);
    out = react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_DOWNLOADED));
    assert_false(out.download || out.monitor);
    out = react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_EXECUTE));
    assert_true(out.begin && out.monitor);
    out = react(&s, &GOOD, TD_EVENT_BIT(TD_EVENT_ENDED));
    assert_true(out.monitor);
    assert_int_equal(out.messages, TD_MESSAGE_BIT(TD_MESSAGE_EXECUTION_ENDED));
    s = reach(TD_PHASE_PREPARING);
    assert_int_equal(react(&s, &GOOD, 0).messages, TD_MESSAGE_BIT(TD_MESSAGE_PREPARED));
}

static void offers_are_what_is_taken(void **state)
{
    (void)state;
    const uint32_t always = AND(TD_EVENT_USER_STOP, TD_EVENT_ABORT);
    td_behaviour s = reach(TD_PHASE_READY);
    const td_behaviour before = s;
    assert_int_equal(td_behaviour_offers(&s, &GOOD),
                     always | TD_EVENT_BIT(TD_EVENT_START) | AND(TD_EVENT_MANUAL, TD_EVENT_REINIT));
    assert_int_equal(td_behaviour_offers(&s, &NO_TASK), always | AND(TD_EVENT_MANUAL, TD_EVENT_REINIT));
    assert_int_equal(td_behaviour_offers(&s, &LOST), always);
    assert_memory_equal(&s, &before, sizeof s);
    s = reach(TD_PHASE_FAILED);
    assert_int_equal(td_behaviour_offers(&s, &LOST), always | TD_EVENT_BIT(TD_EVENT_REINIT));
}

static void every_code_has_its_text(void **state)
{
    (void)state;
    for (int i = 0; i < 40; i++) {
        assert_int_equal(strcmp(td_phase_text((td_phase)i), "unknown") == 0, i >= TD_PHASE_COUNT);
        assert_int_equal(strcmp(td_event_text((td_event)i), "unknown") == 0, i >= TD_EVENT_COUNT);
        assert_int_equal(strcmp(td_fault_text((td_fault)i), "unknown") == 0, i >= TD_FAULT_COUNT);
        assert_int_equal(strcmp(td_answer_text((td_answer)i), "unknown") == 0, i >= TD_ANSWER_COUNT);
        assert_int_equal(strcmp(td_message_text((td_message)i), "unknown") == 0, i >= TD_MESSAGE_COUNT);
    }
    assert_string_equal(td_phase_text((td_phase)-1), "unknown");
}

/* Any set of events, sparse and dense; levels that are mostly good. */
static td_behaviour_inputs any_inputs(td_random *random)
{
    td_behaviour_inputs in = {.links_open = td_random_below(random, 8) > 0,
                              .parameters_read = td_random_below(random, 4) > 0,
                              .task = td_random_below(random, 16) > 0,
                              .machine_task = td_random_below(random, 16) > 0};
    const uint32_t one_in = UINT32_C(2) << td_random_below(random, 6);
    for (td_event e = 0; e < TD_EVENT_COUNT; e++)
        if (td_random_below(random, one_in) == 0) in.events |= TD_EVENT_BIT(e);
    if (td_random_below(random, 32) == 0) in.task = 2;
    return in;
}

/* What is due, or by a turn to manual or a pause. */
static td_behaviour_inputs lead_on(td_random *random, const td_behaviour *s)
{
    td_behaviour_inputs in = verify_next(s);
    const bool turn = td_random_below(random, 2) == 0;
    if (turn && s->phase == TD_PHASE_READY) in.events = TD_EVENT_BIT(TD_EVENT_MANUAL);
    if (turn && (s->phase == TD_PHASE_SIMULATING || s->phase == TD_PHASE_EXECUTING))
        in.events = TD_EVENT_BIT(TD_EVENT_PAUSE);
    return in;
}

/* Sequences that go all the way now and then; each phase meets each event, each answer and message is given.
 */
static void properties_hold_for_any_sets(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 0);
    uint32_t met[TD_PHASE_COUNT] = {0}, messages = 0;
    bool answers[TD_ANSWER_COUNT] = {false}, faults[TD_FAULT_COUNT] = {false};
    for (int sequence = 0; sequence < 4000; sequence++) {
        td_behaviour s;
        verify_history history;
        verify_begin(&s, &history, sequence % VERIFY_OPTIONS);
        for (int i = 0; i < 60; i++) {
            const td_behaviour_inputs in =
                td_random_below(&random, 8) < 6 ? lead_on(&random, &s) : any_inputs(&random);
            td_behaviour_outputs out;
            met[s.phase] |= in.events;
            assert_int_equal(verify_react(&s, &history, &in, &out), 0);
            messages |= out.messages;
            faults[out.fault] = true;
            for (td_event e = 0; e < TD_EVENT_COUNT; e++) answers[out.answer[e]] = true;
        }
    }
    for (td_phase p = 0; p < TD_PHASE_COUNT; p++) assert_int_equal(met[p], TD_EVENT_BIT(TD_EVENT_COUNT) - 1);
    for (int i = 0; i < TD_ANSWER_COUNT; i++) assert_true(answers[i]);
    for (int i = 0; i < TD_FAULT_COUNT; i++) assert_true(faults[i]);
    assert_int_equal(messages, TD_MESSAGE_BIT(TD_MESSAGE_COUNT) - 1);
}

/* The reaction to all of `in` is, but for the answers, that to one of its events beside UserStop (then it is
 * still told what else came) and what may be forgiven. */
static bool one_stands_for_all(const td_behaviour *s, const td_behaviour_inputs *in)
{
    const uint32_t beside =
        in->events & (TD_EVENT_BIT(TD_EVENT_USER_STOP) | AND(TD_EVENT_SINGULARITY, TD_EVENT_DEADLINE));
    td_behaviour all = *s;
    td_behaviour_outputs out = react(&all, in, in->events);
    memset(out.answer, 0, sizeof out.answer);
    for (td_event e = 0; e <= TD_EVENT_COUNT; e++) {
        const uint32_t one = e < TD_EVENT_COUNT ? in->events & TD_EVENT_BIT(e) : 0;
        if (one == 0 && e < TD_EVENT_COUNT) continue;
        td_behaviour alone = *s;
        td_behaviour_outputs its = react(&alone, in, beside | one);
        memset(its.answer, 0, sizeof its.answer);
        if (memcmp(&alone, &all, sizeof all) == 0 && memcmp(&its, &out, sizeof out) == 0) return true;
    }
    return false;
}

static void few_stand_for_all_sets(void **state)
{
    (void)state;
    const char *full = getenv("TELEDIMOS_FULL");
    const uint32_t stride = full && strcmp(full, "1") == 0 ? 1 : 251;
    static const td_behaviour_inputs *const levels[] = {&GOOD, &UNREAD, &LOST, &CHANGED, &FORGOTTEN};
    for (uint32_t k = 0; k < 2 * TD_PHASE_COUNT; k++) {
        td_behaviour s = reach(k % TD_PHASE_COUNT);
        s.options.deadlines_forgiven = k / TD_PHASE_COUNT;
        s.options.singularity = k >= TD_PHASE_COUNT ? TD_SINGULARITY_FAIL : TD_SINGULARITY_CROSS;
        for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
            td_behaviour_inputs in = *levels[i];
            for (in.events = k; in.events < TD_EVENT_BIT(TD_EVENT_COUNT); in.events += stride)
                if (!one_stands_for_all(&s, &in))
                    fail_msg("%s: the events %#x do more than one of them beside", td_phase_text(s.phase),
                             in.events);
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_papers_session),
        cmocka_unit_test(a_pause_holds),
        cmocka_unit_test(a_failure_waits_for_reinit),
        cmocka_unit_test(the_whole_system),
        cmocka_unit_test(jogging),
        cmocka_unit_test(options_decide),
        cmocka_unit_test(from_every_phase),
        cmocka_unit_test(a_changed_task),
        cmocka_unit_test(what_is_more_urgent_wins),
        cmocka_unit_test(commands_and_messages),
        cmocka_unit_test(offers_are_what_is_taken),
        cmocka_unit_test(every_code_has_its_text),
        cmocka_unit_test(properties_hold_for_any_sets),
        cmocka_unit_test(few_stand_for_all_sets),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
