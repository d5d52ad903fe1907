/* What the session's behaviour must never do, judged reaction by reaction from what an outsider sees of it.
 */
#ifndef TELEDIMOS_TESTS_VERIFY_PROPERTIES_H
#define TELEDIMOS_TESTS_VERIFY_PROPERTIES_H

#include "sim/behaviour.h"

/* 1 … in this order; the README's table. */
#define VERIFY_LIST(X)                                                                                       \
    X(moves,                                                                                                 \
      "Nothing moves but a run that was started and neither paused nor ended, or in manual while the "       \
      "jog key is held.")                                                                                    \
    X(fault, "Every fault leads to a stop in the same reaction.")                                            \
    X(stop, "UserStop and Abort are never refused, and stop in the same reaction.")                          \
    X(prepared, "Nothing starts before links were open and parameters read.")                                \
    X(reinit, "From every failure Reinit and passed checks lead to ready.")                                  \
    X(validated, "Nothing is downloaded or executed that was not simulated to its end and then validated.")  \
    X(unchanged, "Nor after the task, or what the machine holds of it, has changed.")                        \
    X(pause, "A pause holds until Resume; beside a Pause nothing moves.")                                    \
    X(manual, "Manual excludes automatic, and automatic manual.")                                            \
    X(no_deadlock, "From every state the session can be ended, begun and led to the last phase.")            \
    X(answered, "Every event is answered, and none that did not come.")                                      \
    X(refused, "An order that is refused changes nothing.")                                                  \
    X(failed, "After a failure nothing moves, and no order but UserStop, Abort and Reinit is accepted.")     \
    X(linked, "Nothing moves while a link is not open.")                                                     \
    X(priority, "At most one order is obeyed: the most urgent that alone would be, and none beside a stop.") \
    X(deadline, "Of a run's missed deadlines as many are forgiven as the options say; the next stops it.")   \
    X(singularity, "A singularity is crossed and told, or stops, as the options say.")                       \
    X(not_silent, "What moved stands still only on hold, on stop or at its reported end.")                   \
    X(legal, "The state stays a legal one, and its options as they were.")                                   \
    X(pure, "The same state and inputs give the same bytes.")                                                \
    X(watched, "An execution is watched from its first motion on, paused too.")                              \
    X(resumed, "Resume goes on; only StartSim and Execute begin a motion.")

enum {
#define VERIFY_ENUM(name, sentence) VERIFY_##name,
    VERIFY_LIST(VERIFY_ENUM)
#undef VERIFY_ENUM
        VERIFY_COUNT
};

/* What happened so far, from inputs and answers alone: never from the state that is judged. No padding. */
typedef struct verify_history {
    uint32_t preparing;   /* Prepare or Reinit was accepted, the checks have not passed */
    uint32_t prepared;    /* they have */
    uint32_t failed;      /* a fault came, and no Reinit since */
    uint32_t simulating;  /* the task whose simulation began and has not ended; 0: none */
    uint32_t simulated;   /* the task whose simulation ended */
    uint32_t validated;   /* the task that was simulated, then validated */
    uint32_t downloading; /* Download was accepted, its end not reported */
    uint32_t downloaded;  /* it is */
    uint32_t executing;   /* Execute was accepted, and no end reported */
    uint32_t paused;      /* in one of these runs */
    uint32_t manual;
    uint32_t missed; /* deadlines, since a run began */
    uint32_t moved;  /* something moved after the last reaction */
} verify_history;

enum { VERIFY_OPTIONS = 8 };
/* Begins a session with one of VERIFY_OPTIONS sets of options. */
void verify_begin(td_behaviour *state, verify_history *history, int options);

/* One reaction of the shipped function. Returns a bit for each property that it broke; with PROPERTY=n in the
 * environment, of property n (from 1) alone. VERIFY_PRINT=1 prints the reaction. */
uint32_t verify_react(td_behaviour *state, verify_history *history, const td_behaviour_inputs *inputs,
                      td_behaviour_outputs *outputs);

/* The one input that leads on: every order as it comes due, every report good, links open. */
td_behaviour_inputs verify_next(const td_behaviour *state);

#endif
