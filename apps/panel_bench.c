#include "apps/panel_bench.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>

#include "apps/panel_child.h"
#include "apps/terminal.h"
#include "core/foxglove.h"

enum { MOST_WAITING = 16 };
static const double UNWATCHED_S = 5, AGAIN_S = 5;

#define OBJECT(fields) "{\"type\":\"object\",\"additionalProperties\":false,\"properties\":{" fields "}}"
#define NOTHING OBJECT("")
#define ANYTHING "{\"type\":\"object\"}"
#define TEXT(name) "\"" name "\":{\"type\":\"string\"}"
#define NUMBER(name) "\"" name "\":{\"type\":\"number\"}"
#define CLICKS                                                                                               \
    "\"clicks\":{\"type\":\"array\",\"maxItems\":9,\"items\":{\"type\":\"object\",\"properties\":{"          \
    "\"mark\":{\"type\":\"integer\"}," NUMBER("x") "," NUMBER("y") "}}}"

enum { ACQUIRING = 2 };
static const panel_bench_service services[] = {
    {{"Freeze", OBJECT("\"on\":{\"type\":\"boolean\"}"), OBJECT("\"frozen\":{\"type\":\"boolean\"}")},
     " on ",
     true,
     true,
     15},
    {{"Store", NOTHING, OBJECT(TEXT("folder") "," TEXT("frame") ",\"stored\":{\"type\":\"integer\"}")},
     NULL,
     true,
     true,
     15},
    {{"Benches", NOTHING, ANYTHING}, NULL, false, false, 20},
    {{"OpenBench", OBJECT(TEXT("bench") "," TEXT("for")), ANYTHING}, " bench for ", false, false, 20},
    {{"Picture", OBJECT(TEXT("frame") "," TEXT("camera") "," TEXT("for")), ANYTHING},
     " frame camera for ",
     false,
     false,
     20},
    {{"FindMarks", OBJECT(TEXT("frame") "," TEXT("camera") "," CLICKS), ANYTHING},
     " frame camera clicks ",
     false,
     false,
     30},
    {{"Coverage", NOTHING, ANYTHING}, NULL, false, false, 300},
    {{"Calibrate", NOTHING, ANYTHING}, NULL, true, false, 900},
    {{"MatchOpen", OBJECT(TEXT("frame") "," TEXT("rig") "," NUMBER("near_m") "," NUMBER("far_m")), ANYTHING},
     " frame rig near_m far_m ",
     false,
     false,
     20},
    {{"MatchCheck", NOTHING, ANYTHING}, NULL, false, false, 60},
    {{"InterestPoints", NOTHING, ANYTHING}, NULL, false, false, 30},
    {{"MatchPoint", OBJECT(NUMBER("x") "," NUMBER("y")), ANYTHING}, " x y ", false, false, 30},
    {{"MatchChoose", OBJECT("\"candidate\":{\"type\":\"integer\"}," NUMBER("x") "," NUMBER("y")), ANYTHING},
     " candidate x y ",
     false,
     false,
     30},
    {{"MatchUndo", NOTHING, ANYTHING}, NULL, false, false, 30},
    {{"MatchExport", NOTHING, ANYTHING}, NULL, true, false, 30},
};
enum { SERVICES = sizeof services / sizeof *services };

static const char state_schema[] =
    "{\"type\":\"object\",\"title\":\"teledimos.Acquire\",\"properties\":{\"cameras\":{\"type\":\"integer\"},"
    "\"seen\":{\"type\":\"integer\"},\"frozen\":{\"type\":\"boolean\"},\"is_stored\":{\"type\":\"boolean\"},"
    "\"stored\":{\"type\":\"integer\"},\"ended\":{\"type\":\"boolean\"},\"focus\":{\"type\":\"array\","
    "\"items\":{"
    "\"type\":\"number\"}},\"best_focus\":{\"type\":\"array\",\"items\":{\"type\":\"number\"}},"
    "\"saturated_share\":{\"type\":\"array\",\"items\":{\"type\":\"number\"}},\"names\":{\"type\":\"array\","
    "\"items\":{\"type\":\"string\"}},\"skew_s\":{\"type\":[\"number\",\"null\"]},\"trouble\":{\"type\":"
    "\"string\"}}}";

static const char *const message_names[PANEL_BENCH_CHANNELS] = {"state", "left", "right"};

/* A call that is not answered. */
typedef struct waiting {
    uint64_t client;
    uint32_t service, call;
    json_int_t id;
    const panel_bench_service *what;
} waiting;

typedef struct worker {
    panel_bench *bench;
    panel_child child;
    uint64_t client;            /* 0: it acquires */
    bool over;                  /* ended; its file is still watched */
    waiting wait[MOST_WAITING]; /* (waits) the first is under way, since: */
    size_t waits;
    double since_s, used_s;
    struct worker *next;
} worker;

struct panel_bench {
    panel_bench_options o;
    td_mcap_channel about[PANEL_BENCH_CHANNELS];
    int hub[PANEL_BENCH_CHANNELS]; /* the hub's index; -1: not shown */
    worker *first;
    json_int_t requests;
    double watched_s, begun_s;
};

/* ---- what there is ---- */

static bool acquires(const panel_bench *b)
{
    return b->o.source[0] != NULL;
}

panel_bench *panel_bench_new(const panel_bench_options *options)
{
    panel_bench *b = calloc(1, sizeof *b);
    if (!b) return NULL;
    b->o = *options;
    b->watched_s = b->begun_s = -1e9;
    const td_mcap_channel image = td_foxglove_channel(TD_FOXGLOVE_IMAGE, "/acquire/left");
    b->about[0] = (td_mcap_channel){"/acquire",   "json",       "teledimos.Acquire",
                                    "jsonschema", state_schema, sizeof state_schema - 1};
    b->about[1] = b->about[2] = image;
    b->about[2].topic = "/acquire/right";
    for (int k = 0; k < PANEL_BENCH_CHANNELS; k++) b->hub[k] = -1;
    return b;
}

const td_mcap_channel *panel_bench_channels(const panel_bench *b, size_t *count)
{
    *count = !acquires(b) ? 0 : b->o.source[1] ? 3 : 2;
    return b->about;
}

void panel_bench_channel(panel_bench *b, size_t number, int hub)
{
    b->hub[number] = hub;
}

const panel_bench_service *panel_bench_services(const panel_bench *b, size_t *count)
{
    const size_t without = acquires(b) ? 0 : ACQUIRING;
    *count = acquires(b) || b->o.places ? SERVICES - without : 0;
    return services + without;
}

/* ---- a process, from its beginning to its end ---- */

static void answer_first(worker *w, json_t *json, const char *why)
{
    const waiting first = w->wait[0];
    const panel_bench_answer answer = {first.client,           first.service, first.call,
                                       first.what->about.name, json,          why};
    memmove(w->wait, w->wait + 1, --w->waits * sizeof *w->wait);
    w->since_s = w->used_s = terminal_now_s();
    w->bench->o.answer(w->bench->o.user, &answer);
}

static void publish(panel_bench *b, int channel, const char *json)
{
    char *copy = b->hub[channel] >= 0 ? strdup(json) : NULL;
    if (copy) (void)panel_hub_publish(b->o.hub, b->hub[channel], b->o.hub->time_ns, copy, strlen(copy));
}

static void tell_trouble(panel_bench *b, const char *why)
{
    json_t *state = json_pack("{s:s}", "trouble", why);
    char *text = state ? json_dumps(state, JSON_COMPACT) : NULL;
    if (text) publish(b, 0, text);
    free(text);
    json_decref(state);
}

/* Why it ended, if nobody knows better. */
static const char *last_words(char text[160], int status)
{
    if (WIFSIGNALED(status))
        snprintf(text, 160, "the bench's process was ended by signal %d; what was not stored is lost",
                 WTERMSIG(status));
    else
        snprintf(text, 160, "the bench's process ended with status %d; what was not stored is lost",
                 WEXITSTATUS(status));
    return text;
}

/* Ends it; `why` NULL: find out. */
static void end(worker *w, const char *why)
{
    char text[160];
    panel_bench *b = w->bench;
    if (w->over) return;
    const int status = panel_child_end(&w->child);
    const bool said = !w->client && !why && WIFEXITED(status); /* it has told its trouble itself */
    w->over = true;
    if (!w->client) b->begun_s = terminal_now_s(); /* not again at once */
    if (!why) why = last_words(text, status);
    while (w->waits) answer_first(w, NULL, why);
    const panel_bench_answer told = {w->client, 0, 0, NULL, NULL, why};
    b->o.answer(b->o.user, &told);
    if (!w->client && !said) tell_trouble(b, why);
}

static worker *find(const panel_bench *b, uint64_t client)
{
    for (worker *w = b->first; w; w = w->next)
        if (!w->over && w->client == client) return w;
    return NULL;
}

static void arguments_of(const char *argv[], const panel_bench *b, uint64_t client, char rate[32])
{
    size_t n = 0;
    argv[n++] = "workbench";
    argv[n++] = client ? "pictures" : "acquire";
    for (size_t i = 0; client && i < b->o.places && i < PANEL_BENCH_PLACES; i++) argv[n++] = b->o.place[i];
    for (int k = 0; !client && k < 2; k++)
        if (b->o.source[k]) argv[n++] = b->o.source[k];
    argv[n++] = "-o";
    argv[n++] = b->o.output;
    if (!client) {
        snprintf(rate, 32, "%.6g", b->o.rate_hz);
        argv[n++] = "--rate";
        argv[n++] = rate;
        if (b->o.target) argv[n++] = "--target";
        if (b->o.target) argv[n++] = b->o.target;
    }
    argv[n] = NULL;
}

static worker *begin(panel_bench *b, uint64_t client)
{
    const char *argv[PANEL_BENCH_PLACES + 12];
    char rate[32];
    worker *w = calloc(1, sizeof *w);
    if (!w) return NULL;
    w->bench = b;
    w->client = client;
    w->used_s = terminal_now_s();
    arguments_of(argv, b, client, rate);
    if (panel_child_start(&w->child, "workbench", argv, NULL) != TD_OK) {
        free(w);
        return NULL;
    }
    w->next = b->first;
    b->first = w;
    if (b->o.watch(b->o.user, w->child.out, w)) return w;
    w->over = true;
    panel_bench_closed(w);
    return NULL;
}

/* Its client's, a new one, or for who holds control another's. */
static worker *bench_of(panel_bench *b, uint64_t client, bool leads, const char **why)
{
    size_t count = 0;
    worker *mine = find(b, client), *idlest = NULL;
    if (mine) return mine;
    for (worker *w = b->first; w; w = w->next) {
        if (w->over || !w->client) continue;
        count++;
        if (!idlest || w->used_s < idlest->used_s) idlest = w;
    }
    if (count >= PANEL_BENCHES) {
        *why = "all four benches are in use";
        if (!leads || !idlest) return NULL;
        end(idlest, "the bench went to who holds control");
    }
    mine = begin(b, client);
    *why = "the bench cannot be started";
    return mine;
}

/* ---- calls ---- */

static bool pass(const worker *w, const waiting *wait, const json_t *arguments)
{
    bool told = false;
    json_t *request = json_copy((json_t *)arguments);
    json_object_set_new(request, "id", json_integer(wait->id));
    json_object_set_new(request, "op", json_string(wait->what->about.name));
    char *text = request ? json_dumps(request, JSON_COMPACT) : NULL;
    const size_t size = text ? strlen(text) : 0;
    if (text && size < PANEL_CHILD_REQUEST) {
        text[size] = '\n'; /* instead of its end */
        told = panel_child_tell(&w->child, text, size + 1);
    }
    free(text);
    json_decref(request);
    return told;
}

const char *panel_bench_call(panel_bench *b, uint64_t client, bool leads, uint32_t service, uint32_t call,
                             const panel_bench_service *what, const json_t *arguments)
{
    const char *why = "nothing is acquired now: watch /acquire first";
    worker *w = what->acquires ? find(b, 0) : bench_of(b, client, leads, &why);
    if (!w) return why;
    const waiting wait = {client, service, call, ++b->requests, what};
    if (w->waits == MOST_WAITING) return "the bench has too much to do";
    if (!pass(w, &wait, arguments)) return "the bench takes nothing now, or the request is too large";
    if (!w->waits) w->since_s = terminal_now_s();
    w->used_s = terminal_now_s();
    w->wait[w->waits++] = wait;
    return NULL;
}

void panel_bench_leave(panel_bench *b, uint64_t client)
{
    worker *w = find(b, client);
    if (w) end(w, "its client is gone");
}

/* ---- what it says ---- */

static bool take_message(worker *w, char *rest)
{
    char *json = strchr(rest, ' ');
    if (w->client || !json) return false;
    *json++ = 0;
    for (int k = 0; k < PANEL_BENCH_CHANNELS; k++)
        if (strcmp(rest, message_names[k]) == 0) publish(w->bench, k, json);
    return true;
}

static bool take_answer(worker *w, bool fine, char *rest)
{
    char *text;
    const long long id = strtoll(rest, &text, 10);
    if (*text != ' ' || !w->waits || w->wait[0].id != id) return false;
    json_t *json = fine ? json_loads(text + 1, 0, NULL) : NULL;
    if (fine && !json) return false;
    answer_first(w, json, fine ? NULL : text + 1);
    return true;
}

static bool take_line(void *user, char *line)
{
    worker *w = user;
    char *rest = strchr(line, ' ');
    if (!rest) return false;
    *rest++ = 0;
    if (strcmp(line, "message") == 0) return take_message(w, rest);
    if (strcmp(line, "answer") == 0) return take_answer(w, true, rest);
    return strcmp(line, "failure") == 0 && take_answer(w, false, rest);
}

bool panel_bench_readable(void *child)
{
    worker *w = child;
    if (!w->over && panel_child_read(&w->child, take_line, w)) return true;
    end(w, NULL);
    return false;
}

void panel_bench_closed(void *child)
{
    worker *w = child, **at = &w->bench->first;
    end(w, NULL);
    while (*at && *at != w) at = &(*at)->next;
    if (*at) *at = w->next;
    (void)panel_child_end(&w->child);
    free(w);
}

/* ---- time ---- */

/* Runs while somebody watches; one that fails is tried again after a while. */
static void keep_acquiring(panel_bench *b, bool watched, double now_s)
{
    worker *w = find(b, 0);
    if (watched) b->watched_s = now_s;
    if (w && now_s > b->watched_s + UNWATCHED_S) end(w, "nobody watches");
    if (w || !watched || now_s < b->begun_s + AGAIN_S) return;
    b->begun_s = now_s;
    if (!begin(b, 0)) tell_trouble(b, "what acquires cannot be started");
}

void panel_bench_tick(panel_bench *b, bool watched, double now_s)
{
    for (worker *w = b->first; w; w = w->next)
        if (!w->over && w->waits && now_s > w->since_s + w->wait[0].what->limit_s)
            end(w, "the bench took too long, and was ended; what was not stored is lost");
    if (acquires(b)) keep_acquiring(b, watched, now_s);
}

void panel_bench_stop(panel_bench *b)
{
    for (worker *w = b ? b->first : NULL; w; w = w->next) end(w, "the panel ends");
}

void panel_bench_free(panel_bench **bench)
{
    panel_bench *b = *bench;
    if (!b) return;
    while (b->first) panel_bench_closed(b->first);
    free(b);
    *bench = NULL;
}
