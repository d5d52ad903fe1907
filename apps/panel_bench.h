/* The panel's benches: the operator's work with pictures, done by `teledimos workbench` in processes of its
 * own, so that nothing that is heavy, or goes wrong, is in this one.
 *
 * One acquires: there is one head, so it is shared, runs while anybody watches its channels, and obeys who
 * holds control. The others belong to a client each, since clicks and points that are tried change nothing
 * for anybody else: a watcher may look, click and match. What leaves something on the disk (Store, Calibrate,
 * MatchExport) is for who holds control. Benches are bounded in number, time and memory; where all are taken,
 * who holds control gets the one that was used longest ago. Used by the server's thread alone. */
#ifndef TELEDIMOS_APPS_PANEL_BENCH_H
#define TELEDIMOS_APPS_PANEL_BENCH_H

#include "apps/panel_hub.h"
#include "core/log.h"

enum { PANEL_BENCHES = 4, PANEL_BENCH_CHANNELS = 3, PANEL_BENCH_PLACES = 31 };

typedef struct panel_bench panel_bench;

typedef struct panel_bench_service {
    panel_service about;
    const char *keys; /* of its arguments, each between blanks; NULL: none */
    bool led;         /* for who holds control */
    bool acquires;
    double limit_s; /* it must be answered in this time */
} panel_bench_service;

/* What became of a call, or (call 0) of a bench itself. */
typedef struct panel_bench_answer {
    uint64_t client; /* 0: all */
    uint32_t service, call;
    const char *name; /* of the service; NULL: of none */
    json_t *json;     /* taken; NULL: `why` not */
    const char *why;
} panel_bench_answer;

typedef struct panel_bench_options {
    const char *output;       /* where the benches store */
    const char *source[2];    /* what is acquired; NULL: nothing, one camera */
    const char *target;       /* in words; NULL: not said */
    double rate_hz;           /* pictures a second */
    const char *const *place; /* (places) datasets and folders that may be opened */
    size_t places;
    panel_hub *hub;
    /* Has `readable` called with `child` whenever there is something in the file, which is closed by who
     * watches it, after `closed`. */
    bool (*watch)(void *user, int file, void *child);
    void (*answer)(void *user, const panel_bench_answer *answer);
    void *user;
} panel_bench_options;

/* All that it is given is lent. */
panel_bench *panel_bench_new(const panel_bench_options *options);
/* Ends all that run; what is left is to be closed and freed. */
void panel_bench_stop(panel_bench *bench);
void panel_bench_free(panel_bench **bench);
/* What it shows and does; nothing where nothing was given to it. *count up to PANEL_BENCH_CHANNELS; `hub` of
 * each is told by panel_bench_channel. */
const td_mcap_channel *panel_bench_channels(const panel_bench *bench, size_t *count);
void panel_bench_channel(panel_bench *bench, size_t number, int hub);
const panel_bench_service *panel_bench_services(const panel_bench *bench, size_t *count);
/* Passes a call on. NULL, or why not. */
const char *panel_bench_call(panel_bench *bench, uint64_t client, bool leads, uint32_t service, uint32_t call,
                             const panel_bench_service *what, const json_t *arguments);
/* The client is gone, and its bench with it. */
void panel_bench_leave(panel_bench *bench, uint64_t client);
/* Each half second: whether anybody watches what is acquired. */
void panel_bench_tick(panel_bench *bench, bool watched, double now_s);
/* False: the file is to be closed. */
bool panel_bench_readable(void *child);
void panel_bench_closed(void *child);

#endif
