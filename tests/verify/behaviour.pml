/* Every sequence of inputs, given to the shipped td_behaviour_react. A reaction gets any levels and any events: none, one
 * or two at once; and UserStop with the two that may be forgiven, and any other. More do what one of them does beside
 * these three: tests/sim/test_behaviour.c shows it on the sets of events. With -DFULL any three besides UserStop, and a
 * machine that holds nothing.
 *   without -DLTL: after each reaction every property of tests/verify/properties.h is judged.
 *   with -DLTL: temporal claims, over what the last reaction did. */

c_decl {
\#include "tests/verify/properties.h"
_Static_assert(TD_EVENT_SINGULARITY == 3 && TD_EVENT_DEADLINE == 4 && TD_EVENT_COUNT == 21,
                "as named below");
}
c_state "td_behaviour state" "Global"
c_state "verify_history history" "Global"

#define SINGULARITY 3
#define DEADLINE 4
#define NONE 21
byte a, b, c, task, machine_task;
bit user_stop, links, parameters;

#ifdef LTL
bit goes, pauses, resumes, begins, fails, prepares, helpful, monitors;
#else
int broken;
#endif

/* x: an event after `last` in the list, or none. */
#define CHOOSE(x, last)                                                                                               \
    if                                                                                                                \
    :: x = NONE                                                                                                       \
    :: last < 1 -> x = 0                                                                                              \
    :: last < 2 -> x = 1                                                                                              \
    :: last < 3 -> x = 2                                                                                              \
    :: last < 4 -> x = 3                                                                                              \
    :: last < 5 -> x = 4                                                                                              \
    :: last < 6 -> x = 5                                                                                              \
    :: last < 7 -> x = 6                                                                                              \
    :: last < 8 -> x = 7                                                                                              \
    :: last < 9 -> x = 8                                                                                              \
    :: last < 10 -> x = 9                                                                                             \
    :: last < 11 -> x = 10                                                                                            \
    :: last < 12 -> x = 11                                                                                            \
    :: last < 13 -> x = 12                                                                                            \
    :: last < 14 -> x = 13                                                                                            \
    :: last < 15 -> x = 14                                                                                            \
    :: last < 16 -> x = 15                                                                                            \
    :: last < 17 -> x = 16                                                                                            \
    :: last < 18 -> x = 17                                                                                            \
    :: last < 19 -> x = 18                                                                                            \
    :: last < 20 -> x = 19                                                                                            \
    :: last < 21 -> x = 20                                                                                            \
    fi

#define FORGIVABLE(event) (a == event || b == event)

/* `last` counts from 1: 0 is before all of them. */
inline choose()
{
    CHOOSE(a, 0);
    CHOOSE(b, (a + 1));
#ifdef FULL
    CHOOSE(c, (b + 1));
    if :: user_stop = 0 :: user_stop = 1 fi;
#else
    if :: c = NONE :: FORGIVABLE(SINGULARITY) -> c = DEADLINE fi;
    if :: user_stop = 0 :: FORGIVABLE(SINGULARITY) || FORGIVABLE(DEADLINE) -> user_stop = 1 fi;
#endif
    if :: links = 0 :: links = 1 fi;
    if :: parameters = 0 :: parameters = 1 fi;
    if :: task = 0 :: task = 1 :: task = 2 fi;
    if
#ifdef FULL
    :: machine_task = 0
#endif
    :: machine_task = 1
    :: machine_task = 2
    fi
}

c_code {
    static td_behaviour_inputs gather(void)
    {
        return (td_behaviour_inputs){.events = (TD_EVENT_BIT(now.a) | TD_EVENT_BIT(now.b) | TD_EVENT_BIT(now.c)) &
                                               (TD_EVENT_BIT(TD_EVENT_COUNT) - 1) | now.user_stop << TD_EVENT_USER_STOP,
                                     .links_open = now.links, .parameters_read = now.parameters,
                                     .task = now.task, .machine_task = now.machine_task};
    }

    /* What was chosen is no part of the state. */
    static void forget(void)
    {
        now.a = now.b = now.c = now.task = now.machine_task = 0;
        now.user_stop = now.links = now.parameters = 0;
    }

#ifdef LTL
    static int accepts(const td_behaviour_outputs *out, td_event event)
    {
        return out->answer[event] == TD_ANSWER_ACCEPTED;
    }
#endif
}

inline react()
{
#ifdef LTL
    c_code {
        const td_behaviour_inputs in = gather(), helpful = verify_next(&now.state);
        td_behaviour_outputs out;
        now.helpful = in.events == helpful.events && in.links_open && in.parameters_read &&
                      in.task == helpful.task && in.machine_task == helpful.machine_task;
        td_behaviour_react(&now.state, &in, &out);
        now.goes = out.drive >= TD_DRIVE_SIMULATE;
        now.pauses = accepts(&out, TD_EVENT_PAUSE) && out.phase != TD_PHASE_MANUAL;
        now.resumes = accepts(&out, TD_EVENT_RESUME);
        now.begins = out.begin || accepts(&out, TD_EVENT_MANUAL);
        now.fails = out.fault != TD_FAULT_NONE;
        now.prepares = (out.messages & TD_MESSAGE_BIT(TD_MESSAGE_PREPARED)) != 0;
        now.monitors = out.phase == TD_PHASE_MONITORING;
        forget();
    }
#else
    c_code {
        const td_behaviour_inputs in = gather();
        td_behaviour_outputs out;
        now.broken = (int)verify_react(&now.state, &now.history, &in, &out);
        forget();
    };
    assert(broken == 0)
#endif
}

active proctype session()
{
    atomic {
#ifdef LTL
        c_code { verify_begin(&now.state, &now.history, 7); };
#else
        if
        :: c_code { verify_begin(&now.state, &now.history, 0); }
        :: c_code { verify_begin(&now.state, &now.history, 1); }
        :: c_code { verify_begin(&now.state, &now.history, 2); }
        :: c_code { verify_begin(&now.state, &now.history, 3); }
        :: c_code { verify_begin(&now.state, &now.history, 4); }
        :: c_code { verify_begin(&now.state, &now.history, 5); }
        :: c_code { verify_begin(&now.state, &now.history, 6); }
        :: c_code { verify_begin(&now.state, &now.history, 7); }
        fi
#endif
    };
    do
    :: atomic { choose(); react() }
    od
}

#ifdef LTL
ltl pause { [] (pauses -> (!goes W (resumes || begins))) }
ltl failed { [] (fails -> (!goes W prepares)) }
ltl progress { (<> [] helpful) -> ([] <> monitors) }
#endif
