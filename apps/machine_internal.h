/* teledimos machine, between its files. The machine: machine_serve.c turns its periods, machine_links.c hears
 * who is there, machine_orders.c does what it is told, machine_look.c takes images. machine_check.c simulates
 * a task, for the machine and for its master, machine_master.c. */
#ifndef TELEDIMOS_APPS_MACHINE_INTERNAL_H
#define TELEDIMOS_APPS_MACHINE_INTERNAL_H

#include "apps/aside.h"
#include "apps/audit.h"
#include "apps/machine_model.h"
#include "apps/machine_plan.h"
#include "apps/rehearse_internal.h"
#include "core/machine_messages.h"
#include "core/scene.h"
#include "servo/dig_plan.h"
#include "servo/jog.h"

/* ---- the command line ---- */

typedef struct machine_options {
    const cli_common *common;
    const char *scenario, *listen, *connect, *verb, *token, *certificate, *key, *authority, *rig, *mount,
        *images;
    bool tls, plain, once;
    double period_s; /* of the heartbeat */
    double image_hz; /* 0: none */
    double for_s;    /* 0: until it is told */
    double mass_sigma, zero_sigma_deg;
    cli_list joints; /* of jog: NAME=RATE */
} machine_options;

enum { MACHINE_TIMEOUT_PERIODS = 3 };

/* Scenario with its ground's map; links' options with the token, which lies in `token`. */
td_status machine_read(scenario *s, const machine_options *o, const char *path, const td_progress *progress,
                       td_error *error);
td_status machine_link_options(td_link_options *options, uint8_t token[TD_LINK_TOKEN_MAX],
                               const machine_options *o, td_error *error);
td_status machine_serve(const machine_options *o, terminal *term, td_error *error);
/* *refused: the machine said no, or stopped. */
td_status machine_master(const machine_options *o, terminal *term, bool *refused, td_error *error);

/* ---- a task, simulated ---- */

typedef struct machine_verdict {
    td_machine_validation validation;
    char why[600]; /* it cannot be done; "": it can */
    double cpu_s;
} machine_verdict;
/* Aside: from `start` on `map`; all is lent until it has ended. */
typedef struct machine_check {
    const scenario *s;
    td_task *task;
    const td_elevation *map;
    td_plant_state start;    /* as it reads */
    const td_dig_plan *plan; /* of its trench; NULL: its own */
    char model[TD_HASH_HEX_SIZE];
    aside *work;
} machine_check;
td_status machine_check_begin(machine_check *check, td_error *error);
/* True: it has ended, and the verdict is there. */
bool machine_check_poll(machine_verdict *verdict, machine_check *check);
/* Whether what another one vouches for is what was found here; else `why`. */
bool machine_agrees(char *why, size_t size, const scenario *s, const td_task *task,
                    const td_machine_validation *his, const td_machine_validation *own);

/* ---- the machine ---- */

enum { MACHINE_PENDING = 8 };

/* A stop, from where it was commanded to rest. */
typedef struct machine_stop {
    bool under_way, told;
    double begun_s; /* of the machine's time */
    double q[TD_ROBOT_MAX_JOINTS];
    td_machine_stopped found; /* took_s < 0: none yet */
} machine_stop;

typedef struct machine {
    const machine_options *o;
    scenario *s;
    char model[TD_HASH_HEX_SIZE];
    terminal *term;
    audit audit;
    /* as it truly is */
    rehearse *rehearsal; /* of what is drawn so; NULL: of the options */
    rehearse_setup *setup;
    td_elevation *ground; /* with a rehearsal; else the scenario's map */
    td_robot *robot_true;
    double zero[TD_ROBOT_MAX_JOINTS]; /* reading less truth */
    station *station;
    td_plant plant;
    td_plant_state state; /* as it reads */
    td_jog jog;
    /* the behaviour, and what goes into it */
    td_behaviour logic;
    td_behaviour_outputs out;
    td_phase shown;      /* in the log so far */
    uint32_t asked;      /* orders since the last reaction, 1 << td_machine_order, */
    uint32_t unanswered; /* and those whose answer is due */
    bool ends;           /* the session: the master said farewell */
    bool in_session;     /* task_run_in turns the periods */
    /* the task */
    td_task *task;
    td_dig_plan *plan; /* of the next one's trench; NULL: its own */
    char task_hash[TD_HASH_HEX_SIZE];
    td_machine_validation vouched;
    uint32_t task_id, tasks; /* task_id 0: none */
    bool to_check;           /* as soon as the behaviour lets it */
    machine_check check;
    /* joints, one by one */
    td_plant_command wish;
    double wish_s; /* when it came; NaN: none */
    machine_stop stop;
    /* links */
    td_link_listener *listener;
    td_link *pending[MACHINE_PENDING], *master, *pictures;
    uint8_t session[TD_LINK_SESSION_SIZE];
    double silent_s; /* of the master that was lost last */
    int masters;     /* that were there */
    /* images */
    td_scene_file *scene_file;
    td_scene scene;
    td_rig *rig;
    int mount;
    aside *look;
    double next_look_s;
    uint64_t looks;
    int wanted; /* a pair without loss: 0: as it is now, n: of the way here; -1: none */
    /* time */
    double begun_s, tick_s; /* tick_s: when the next period is due */
    uint64_t ticks, misses;
    double heard_s;                  /* when it last looked at its links, */
    double starved_s, starved_at_s;  /* by how much later than it meant to, at worst in the last second */
    double worked_s, longest_work_s; /* of the processor, up to then; the most between two looks */
} machine;

/* machine_serve.c: the end of a period: shows the state, hears everyone until the next is due. */
/* `task`: under way; NULL: none. */
void machine_tick(machine *m, td_phase phase, td_fault fault, const task_outside *task);
bool machine_is_over(const machine *m);

/* machine_links.c */
td_status machine_links_open(machine *m, td_error *error);
void machine_links_close(machine *m);
/* What there is to hear, for at most `seconds`. */
void machine_hear(machine *m, double seconds);
void machine_tell(machine *m, const td_machine_message *message, bool may_drop);
void machine_answer(machine *m, td_machine_kind kind, td_machine_order order, bool accepted,
                    const char *format, ...) TD_PRINTF(5, 6);

/* machine_orders.c */
void machine_take_message(machine *m, const td_machine_message *message);
/* TD_EVENT_BIT of the orders asked for; in a session only those that it may get: the others wait for its end.
 */
uint32_t machine_orders(machine *m);
/* What the reaction said of them. */
void machine_answer_orders(machine *m, const td_behaviour_outputs *out);
/* The check of a task: begun, ended, given up. */
void machine_go_on_checking(machine *m);
/* One reaction of the behaviour, out of a session. */
void machine_react(machine *m, uint32_t events);

/* machine_truth.c: what is true, and nobody is told. */
td_status machine_truth_draw(machine *m, td_error *error);
/* The head as it truly is; with a rehearsal. */
td_status machine_truth_rig(td_rig **rig, const machine *m, td_error *error);
/* With a rehearsal: the ground as it was, or is by now, into the folder for the record. */
td_status machine_truth_keep(machine *m, const char *name, td_error *error);
void machine_truth_free(machine *m);

/* machine_look.c */
td_status machine_look_begin(machine *m, td_error *error);
void machine_look_end(machine *m);
void machine_look(machine *m);

#endif
