/* teledimos panel, between its files.
 *
 *   session's thread                      server's thread
 *   session.c -> panel_live.c   -- panel_link --   panel_server.c: libwebsockets, connections, what they may
 *                                                    panel_desk.c: requests, control, the audit log
 *                                                    panel_hub.c, panel_protocol.c: what goes out, and how
 *
 * The session never waits: it puts states and news into rings, and takes orders from one. */
#ifndef TELEDIMOS_APPS_PANEL_INTERNAL_H
#define TELEDIMOS_APPS_PANEL_INTERNAL_H

#include <stdatomic.h>

#include "apps/audit.h"
#include "apps/far_machine.h"
#include "apps/panel_bench.h"
#include "apps/panel_hub.h"
#include "apps/panel_ring.h"
#include "apps/simulate_task.h"

/* ---- parameters ---- */

enum { PANEL_MAX_PARAMETERS = 200 };

/* Of the scenario, what can be seen and (where `low` < `high`, or a law) set. The value here is the server's
 * copy; `target` belongs to the session. */
typedef struct panel_parameter {
    char name[96];
    enum { PANEL_REAL, PANEL_LAW, PANEL_TEXT } kind;
    double value, low, high;
    const char *text; /* of what is no number */
    double *target;
    td_task_law *law;
} panel_parameter;

/* Returns how many. */
int panel_parameters_of(panel_parameter list[PANEL_MAX_PARAMETERS], scenario *s);
bool panel_parameter_is_settable(const panel_parameter *p);
/* Whether it takes that value: then *number is a real, or the number of a law. */
td_status panel_parameter_read(double *number, const panel_parameter *p, const json_t *value,
                               td_error *error);
json_t *panel_parameter_json(const panel_parameter *p);
/* The names of the laws of motion. */
json_t *panel_laws_json(void);
void panel_parameter_show(panel_parameter *p, double number);
/* The session's: sets it where it stands; refused, and left as it was, when the task does not fit the robot.
 */
td_status panel_parameter_apply(const panel_parameter *p, double number, const scenario *s, td_error *error);

/* ---- between the threads ---- */

typedef struct panel_sample {
    panel_numbered head;
    task_sample sample;
    long period;
    int steps;
    uint32_t offers;
    uint64_t ticks, misses;
    double late_p99_s, late_max_s, speed; /* speed: of the session's time against the clock's */
} panel_sample;

typedef struct panel_news {
    panel_numbered head;
    enum { PANEL_NOTE, PANEL_GROUND, PANEL_ANSWER, PANEL_CHANGE, PANEL_PLAN } kind;
    task_note note;
    task_ground ground;
    live_plan plan;
    /* ANSWER, to `order`: */
    uint64_t order;
    bool accepted;
    char text[300];
    /* CHANGE of a parameter: in that period. */
    long period;
    double time_s;
    int parameter;
} panel_news;

typedef struct panel_order {
    panel_numbered head;
    uint64_t order; /* for its answer */
    td_event event; /* TD_EVENT_COUNT: a parameter is set */
    int joint;      /* Jog */
    double stick, for_s;
    int parameter;
    double number;
} panel_order;

typedef struct panel_link {
    panel_ring samples, news, orders;
    /* What was taken goes back to the thread that made it, which uses or frees it: a thread that frees what
     * another allocated takes that one's lock, and could be put to sleep with it. */
    panel_ring spent_samples, spent_news, spent_orders;
    atomic_bool stop;         /* the operator is gone: UserStop */
    atomic_ullong dropped;    /* samples */
    void (*wake)(void *user); /* the server; from any thread */
    void *user;
} panel_link;
td_status panel_link_begin(panel_link *link, td_error *error);
void panel_link_end(panel_link *link);
/* One of `size` bytes that came back, or a new one; zeroed. NULL: out of memory. */
void *panel_link_fresh(panel_ring *spent, size_t size);
void panel_link_give_back(panel_ring *spent, void *thing);

/* ---- the session's side ---- */

typedef struct panel_options {
    const char *host;
    int port;
    const char *token_file, *certificate, *key;
    bool insecure;
    const char *const *origin; /* besides our own */
    size_t origin_count;
    int most_clients;
    double for_s;              /* 0: until told to end */
    far_machine *machine;      /* lent; NULL: none */
    panel_bench_options bench; /* what pictures there are */
} panel_options;

/* `link`, `s` and `list` are lent. */
td_status panel_live_begin(struct live **live, panel_link *link, scenario *s, const panel_parameter *list,
                           const panel_options *options, td_log log, td_error *error);
void panel_live_end(struct live **live);

/* ---- the server's side ---- */

enum { PANEL_PEER_SIZE = 48, PANEL_WHY_SIZE = 120 };

typedef struct panel_client {
    uint64_t number; /* from 1 */
    char peer[PANEL_PEER_SIZE];
    panel_outbox box;
    bool called;
    uint32_t last_call;
    bool watches[PANEL_MAX_PARAMETERS];
    int faults;
    char why[PANEL_WHY_SIZE]; /* it is to be closed; "": not */
} panel_client;

typedef struct panel_desk panel_desk;
typedef struct panel_counts {
    uint64_t orders, accepted, refused, faults, turned_away, clients, most_clients, sent, skipped, slow;
} panel_counts;

/* The desk takes what clients ask for. All that it is given is lent. `find`: the client of that number, or
 * NULL; `each` calls f for every client. */
typedef struct panel_desk_options {
    const scenario *scenario;
    panel_parameter *parameter;
    int parameter_count;
    panel_link *link;
    panel_hub *hub;
    audit *audit;
    panel_counts *counts;
    const td_mcap_channel *channel; /* as advertised */
    size_t channel_count;
    panel_bench *bench;
    panel_client *(*find)(void *user, uint64_t number);
    void (*each)(void *user, void (*f)(panel_client *client, void *with), void *with);
    void *user;
} panel_desk_options;
panel_desk *panel_desk_new(const panel_desk_options *options);
void panel_desk_free(panel_desk **desk);
/* Tells the newcomer what there is. */
void panel_desk_greet(panel_desk *desk, panel_client *client);
/* A whole message of a client's. */
void panel_desk_take(panel_desk *desk, panel_client *client, const void *bytes, size_t size, bool binary);
/* Something about a client that is refused. */
void panel_desk_refuse(panel_desk *desk, panel_client *client, const char *what, const char *why);
void panel_desk_answer(panel_desk *desk, const panel_news *news);
/* Of a bench. */
void panel_desk_bench(panel_desk *desk, const panel_bench_answer *answer);
void panel_desk_phase(panel_desk *desk, td_phase phase);
/* Into the audit log; `fields` is taken. */
void panel_desk_note(panel_desk *desk, const char *what, json_t *fields);
uint64_t panel_desk_operator(const panel_desk *desk); /* 0: none */
/* It is gone. */
void panel_desk_leave(panel_desk *desk, panel_client *client, const char *why);

typedef struct panel_server panel_server;
/* Listens; nothing is sent until the session begins. `scenario` and `list` as they stand now. */
td_status panel_server_new(panel_server **server, panel_link *link, const scenario *s, panel_parameter *list,
                           int count, const char *folder, const panel_options *options, td_log log,
                           td_error *error);
const char *panel_server_url(const panel_server *server);
/* Takes what the link still holds, and finishes the recording, whose session ended with `period`. */
td_status panel_server_finish(panel_server **server, panel_counts *counts, long period, double time_s,
                              td_error *error);
/* As it stands; without the recording. */
void panel_server_free(panel_server **server);

#endif
