/* The logical behaviour of a session: prepare, simulate, validate, download, execute, monitor; jog by hand.
 *
 * The paper (section 2, "Simulation logical behaviour") writes it in Esterel. Here it is one pure function
 * from a reaction's inputs to its outputs: no clock, no memory but the state it is given, no input or output.
 * tests/verify calls this very function with every sequence of inputs and proves what the README lists.
 *
 *   IDLE -> PREPARING -> READY -> SIMULATING -> SIMULATED -> VALIDATED -> DOWNLOADING -> DOWNLOADED
 *                         ^ |         ^ |                                                     |
 *                         | v         | v                                                     v
 *                        MANUAL     _PAUSED            EXECUTION_PAUSED <-> EXECUTING -> MONITORING
 *
 *   phase              drives     steps
 *   IDLE               rest       PREPARE -> PREPARING
 *   PREPARING          rest       links open and parameters read -> READY
 *   READY              rest       START -> SIMULATING, MANUAL -> MANUAL, REINIT -> PREPARING
 *   MANUAL             jog, hold  JOG (held), PAUSE -> MANUAL, AUTOMATIC -> READY
 *   SIMULATING         simulate   PAUSE -> SIMULATION_PAUSED, ENDED -> SIMULATED
 *   SIMULATION_PAUSED  hold       RESUME -> SIMULATING, ENDED -> SIMULATED
 *   SIMULATED          rest       VALIDATE -> VALIDATED, REINIT -> PREPARING
 *   VALIDATED          rest       DOWNLOAD -> DOWNLOADING, REINIT -> PREPARING
 *   DOWNLOADING        rest       DOWNLOADED -> DOWNLOADED
 *   DOWNLOADED         rest       EXECUTE -> EXECUTING, REINIT -> PREPARING
 *   EXECUTING          execute    PAUSE -> EXECUTION_PAUSED, ENDED -> MONITORING
 *   EXECUTION_PAUSED   hold       RESUME -> EXECUTING, ENDED -> MONITORING
 *   MONITORING         rest       REINIT -> PREPARING
 *   FAILED             stop       REINIT -> PREPARING
 *
 * One reaction makes at most one step. What comes together is judged in this order:
 *   1. USER_STOP ends the session: stop, close the links, IDLE.
 *   2. A fault: stop, FAILED (IDLE stays so). Besides those reported: a link that is not open, but in IDLE,
 *      PREPARING and FAILED; a task that changes in SIMULATING, DOWNLOADING, EXECUTING or a pause of them.
 *   3. ABORT gives up what is under way: stop, READY (PREPARING: back to IDLE; FAILED and IDLE stay).
 *   4. A task that changes at rest, SIMULATED to MONITORING: what was simulated and validated is void; READY.
 *   5. The other events, in the order of their list. The first that the phase takes is obeyed; the others are
 *      refused. Beside a PAUSE nothing after it is obeyed.
 * USER_STOP and ABORT are never refused, and each event gets an answer. After an execution the machine stands
 * elsewhere: the task must be simulated anew before it is executed again. */
#ifndef TELEDIMOS_SIM_BEHAVIOUR_H
#define TELEDIMOS_SIM_BEHAVIOUR_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TD_PHASE_LIST(X)                                                                                     \
    X(TD_PHASE_IDLE, "nothing is prepared")                                                                  \
    X(TD_PHASE_PREPARING, "opening links, reading parameters")                                               \
    X(TD_PHASE_READY, "ready")                                                                               \
    X(TD_PHASE_SIMULATING, "simulating")                                                                     \
    X(TD_PHASE_SIMULATION_PAUSED, "the simulation is paused")                                                \
    X(TD_PHASE_SIMULATED, "simulated to the end")                                                            \
    X(TD_PHASE_VALIDATED, "validated by the operator")                                                       \
    X(TD_PHASE_DOWNLOADING, "sending the task to the machine")                                               \
    X(TD_PHASE_DOWNLOADED, "the machine holds the task")                                                     \
    X(TD_PHASE_EXECUTING, "the machine executes the task")                                                   \
    X(TD_PHASE_EXECUTION_PAUSED, "the machine is paused")                                                    \
    X(TD_PHASE_MONITORING, "executed; the machine is watched")                                               \
    X(TD_PHASE_MANUAL, "manual: moved by the operator's hand")                                               \
    X(TD_PHASE_FAILED, "failed: waiting for Reinit")

/* The list's order is the priority. USER_STOP and from ABORT on, but for ENDED and DOWNLOADED: the operator's
 * orders. The others are reports of the parts. */
#define TD_EVENT_LIST(X)                                                                                     \
    X(TD_EVENT_USER_STOP, "UserStop")       /* ends the session */                                           \
    X(TD_EVENT_UNREACHABLE, "unreachable")  /* the pose asked for is out of reach */                         \
    X(TD_EVENT_LIMIT, "limit")              /* the motion goes past a limit (away: no fault) */              \
    X(TD_EVENT_SINGULARITY, "singularity")  /* by the options: crossed, or a fault */                        \
    X(TD_EVENT_DEADLINE, "deadline missed") /* by the options: forgiven, or a fault */                       \
    X(TD_EVENT_DEVIATION, "deviation")      /* the machine does not do what was simulated */                 \
    X(TD_EVENT_PART_FAILED, "part failed")  /* integrator, driver, machine: cannot go on */                  \
    X(TD_EVENT_ABORT, "Abort")              /* stops and gives up what is under way */                       \
    X(TD_EVENT_ENDED, "ended")              /* the motion reached its duration */                            \
    X(TD_EVENT_DOWNLOADED, "downloaded")    /* machine_task is what the machine now holds */                 \
    X(TD_EVENT_PAUSE, "Pause")              /* holds, to go on later */                                      \
    X(TD_EVENT_AUTOMATIC, "Automatic")      /* leaves manual */                                              \
    X(TD_EVENT_RESUME, "Resume")            /* goes on after a pause */                                      \
    X(TD_EVENT_PREPARE, "Prepare")          /* begins a session */                                           \
    X(TD_EVENT_REINIT, "Reinit")            /* prepares anew, with changed parameters */                     \
    X(TD_EVENT_START, "StartSim")           /* simulates the task */                                         \
    X(TD_EVENT_VALIDATE, "Validate")        /* the operator takes the simulated motion */                    \
    X(TD_EVENT_DOWNLOAD, "Download")        /* sends it to the machine */                                    \
    X(TD_EVENT_EXECUTE, "Execute")          /* the machine does it */                                        \
    X(TD_EVENT_MANUAL, "Manual")            /* to jogging */                                                 \
    X(TD_EVENT_JOG, "Jog")                  /* in each reaction while the key is held */

#define TD_FAULT_LIST(X)                                                                                     \
    X(TD_FAULT_NONE, "no fault")                                                                             \
    X(TD_FAULT_LINK_LOST, "a link is lost: check the connection, then Reinit")                               \
    X(TD_FAULT_TASK_CHANGED, "the task changed while it was worked on: Reinit and simulate it")              \
    X(TD_FAULT_UNREACHABLE, "the pose is out of reach: change the task, then Reinit")                        \
    X(TD_FAULT_LIMIT, "a limit was reached: change the task, then Reinit")                                   \
    X(TD_FAULT_SINGULARITY, "a singularity was reached: change the task, then Reinit")                       \
    X(TD_FAULT_DEADLINE, "a deadline was missed: lengthen the period, then Reinit")                          \
    X(TD_FAULT_DEVIATION, "the machine does not follow the simulated motion: find out why, then Reinit")     \
    X(TD_FAULT_PART, "a part failed: read its own message, then Reinit")

#define TD_ANSWER_LIST(X)                                                                                    \
    X(TD_ANSWER_NONE, "was not asked")                                                                       \
    X(TD_ANSWER_ACCEPTED, "accepted")                                                                        \
    X(TD_ANSWER_OVERTAKEN, "refused: something more urgent came at the same time")                           \
    X(TD_ANSWER_NOT_PREPARED, "refused: Prepare first, and wait for the checks")                             \
    X(TD_ANSWER_ALREADY, "refused: prepared already; Reinit prepares anew")                                  \
    X(TD_ANSWER_FAILED, "refused: Reinit first")                                                             \
    X(TD_ANSWER_BUSY, "refused: work is under way; Abort it first")                                          \
    X(TD_ANSWER_FINISHED, "refused: a simulated task is at hand; Reinit for another")                        \
    X(TD_ANSWER_NO_TASK, "refused: there is no task")                                                        \
    X(TD_ANSWER_NO_MACHINE, "refused: no machine belongs to the session")                                    \
    X(TD_ANSWER_NOTHING_MOVES, "refused: nothing moves")                                                     \
    X(TD_ANSWER_NOT_PAUSED, "refused: nothing is paused")                                                    \
    X(TD_ANSWER_NOT_SIMULATED, "refused: only a task simulated to its end can be validated")                 \
    X(TD_ANSWER_NOT_VALIDATED, "refused: only a validated task can be downloaded")                           \
    X(TD_ANSWER_NOT_DOWNLOADED, "refused: only a downloaded task can be executed")                           \
    X(TD_ANSWER_NOT_MANUAL, "refused: only in manual")                                                       \
    X(TD_ANSWER_NOT_EXPECTED, "refused: the report was not expected")

/* What the session tells its environment, besides answers. */
#define TD_MESSAGE_LIST(X)                                                                                   \
    X(TD_MESSAGE_PREPARED, "links are open and parameters read: ready")                                      \
    X(TD_MESSAGE_BEGUN, "the motion begins")                                                                 \
    X(TD_MESSAGE_PAUSED, "paused")                                                                           \
    X(TD_MESSAGE_RESUMED, "resumed")                                                                         \
    X(TD_MESSAGE_SIMULATION_ENDED, "the simulation reached its end")                                         \
    X(TD_MESSAGE_DOWNLOADED, "the machine holds the task")                                                   \
    X(TD_MESSAGE_EXECUTION_ENDED, "the machine has executed the task")                                       \
    X(TD_MESSAGE_SINGULARITY_CROSSED, "a singularity was crossed")                                           \
    X(TD_MESSAGE_DEADLINE_FORGIVEN, "a deadline was missed, and forgiven")                                   \
    X(TD_MESSAGE_TASK_CHANGED, "the task changed: what was simulated and validated is void")                 \
    X(TD_MESSAGE_FAILED, "failed, and stopped")                                                              \
    X(TD_MESSAGE_ABORTED, "aborted, and stopped")                                                            \
    X(TD_MESSAGE_SESSION_ENDED, "the session is ended")

#define TD_BEHAVIOUR_ENUM(code, text) code,
typedef enum td_phase { TD_PHASE_LIST(TD_BEHAVIOUR_ENUM) TD_PHASE_COUNT } td_phase;
typedef enum td_event { TD_EVENT_LIST(TD_BEHAVIOUR_ENUM) TD_EVENT_COUNT } td_event;
typedef enum td_fault { TD_FAULT_LIST(TD_BEHAVIOUR_ENUM) TD_FAULT_COUNT } td_fault;
typedef enum td_answer { TD_ANSWER_LIST(TD_BEHAVIOUR_ENUM) TD_ANSWER_COUNT } td_answer;
typedef enum td_message { TD_MESSAGE_LIST(TD_BEHAVIOUR_ENUM) TD_MESSAGE_COUNT } td_message;
#undef TD_BEHAVIOUR_ENUM

/* What the drives do until the next reaction. */
typedef enum td_drive {
    TD_DRIVE_REST,     /* nothing is asked: stands still */
    TD_DRIVE_STOP,     /* stops at once; the motion is given up */
    TD_DRIVE_HOLD,     /* stops and holds; the motion may go on later */
    TD_DRIVE_SIMULATE, /* the simulated machine does the task */
    TD_DRIVE_EXECUTE,  /* the machine does the task that it holds */
    TD_DRIVE_JOG       /* follows the operator's hand, for this reaction */
} td_drive;

typedef enum td_singularity_policy { TD_SINGULARITY_CROSS, TD_SINGULARITY_FAIL } td_singularity_policy;

typedef struct td_behaviour_options {
    td_singularity_policy singularity; /* default: crossed, with a message (the paper) */
    uint32_t deadlines_forgiven;       /* missed in one run; the next is a fault. Default 0 (the paper) */
    uint32_t has_machine;              /* 1: tasks can be downloaded and executed. Default 0 */
} td_behaviour_options;
TD_API td_behaviour_options td_behaviour_options_default(void);

/* The state, without padding: equal states have equal bytes. */
typedef struct td_behaviour {
    td_phase phase;
    td_fault fault;     /* what brought it to FAILED; NONE elsewhere */
    uint32_t task;      /* identity of the task under work, from SIMULATING to MONITORING; 0 elsewhere */
    uint32_t deadlines; /* missed and forgiven in this run, or in the last */
    td_behaviour_options options;
} td_behaviour;

/* Reports are those of the run under way: one of a run that was stopped is not handed in. */
typedef struct td_behaviour_inputs {
    uint32_t events;      /* TD_EVENT_BIT of each that came since the last reaction */
    bool links_open;      /* now: all that the session needs, the machine's among them */
    bool parameters_read; /* since read_parameters was last asked for */
    /* Hash or counter of all that decides the motion (task, parameters, map): another one for another motion;
     * 0: none. */
    uint32_t task;
    uint32_t machine_task; /* of what the machine says it holds; 0: nothing */
} td_behaviour_inputs;
#define TD_EVENT_BIT(event) (UINT32_C(1) << (event))
#define TD_MESSAGE_BIT(message) (UINT32_C(1) << (message))

typedef struct td_behaviour_outputs {
    td_phase phase; /* after the reaction */
    td_fault fault; /* the one that came in this reaction; NONE: none */
    td_drive drive;
    uint32_t messages;                /* TD_MESSAGE_BIT of each */
    bool open_links;                  /* those that are not */
    bool close_links;                 /* all */
    bool read_parameters;             /* anew */
    bool begin;                       /* SIMULATE or EXECUTE from the start */
    bool download;                    /* as long as it is true: send the task to the machine */
    bool monitor;                     /* compare the machine's motion with the simulated one */
    td_answer answer[TD_EVENT_COUNT]; /* NONE: that event did not come */
} td_behaviour_outputs;

/* A state in IDLE. NULL: defaults. */
TD_API void td_behaviour_begin(td_behaviour *state, const td_behaviour_options *options);

/* One reaction. Depends on nothing but *state and *inputs; all of *outputs is set. */
TD_API void td_behaviour_react(td_behaviour *state, const td_behaviour_inputs *inputs,
                               td_behaviour_outputs *outputs);

/* TD_EVENT_BIT of each order that would be obeyed if it came alone, with the levels in *inputs: for buttons
 * and keys. */
TD_API uint32_t td_behaviour_offers(const td_behaviour *state, const td_behaviour_inputs *inputs);

/* "unknown" for a number that is none. Never NULL. */
TD_API const char *td_phase_text(td_phase phase);
TD_API const char *td_event_text(td_event event);
TD_API const char *td_fault_text(td_fault fault);
TD_API const char *td_answer_text(td_answer answer);
TD_API const char *td_message_text(td_message message);

#ifdef __cplusplus
}
#endif
#endif
