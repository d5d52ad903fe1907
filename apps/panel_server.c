/* The panel's server: one thread, libwebsockets, and all that comes from the session's rings.
 *
 * A watcher is sent what fits into its socket, a piece at a time, when libwebsockets says that it can take
 * more; so one that does not read costs a piece and its socket's buffer, and is closed after a while. All
 * that is new for a watcher goes out as one piece: with many watchers the system's calls are what costs, not
 * the bytes. libwebsockets makes a call for each message, so that messages are framed by the outbox and a
 * piece is raw to it. */
#include <libwebsockets.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include "apps/panel_door.h"
#include "apps/panel_feed.h"
#include "apps/panel_page.h"
#include "core/file.h"

enum {
    PIECE = 1 << 16, /* bytes */
    SOCKET_BUFFER = 1 << 17,
};

static const double SILENT_S = 10, OPERATOR_SILENT_S = 3; /* no answer to pings */
static const double STUCK_S = 10;                         /* takes nothing of what it is sent */
static const double SLOW_S = 5;                           /* for one message */
static const double MESSAGES_S = 50, MESSAGES_AT_ONCE = 100;

typedef struct connection {
    panel_client client;
    struct lws *wsi;
    struct connection *next;
    unsigned char *in; /* of a message that is not whole yet */
    size_t in_size;
    double in_since_s, heard_s, moved_s, allowed, allowed_at_s;
    bool in_binary, in_open, ping;
} connection;

struct panel_server {
    panel_feed feed;
    panel_options options;
    panel_door door;
    audit audit;
    panel_counts counts;
    panel_desk *desk;
    panel_bench *bench;
    /* libwebsockets. */
    struct lws_context *context;
    struct lws_vhost *host;
    lws_sorted_usec_list_t second, half;
    double swept_s; /* when `second` last came */
    pthread_t thread;
    bool started;
    size_t acquired; /* channels of pictures, the last ones */
    atomic_bool stop;
    connection *first;
    uint64_t clients; /* so far */
    char url[120];
    panel_files files;
    unsigned char piece[LWS_PRE + PIECE];
};

static void serve_all(panel_server *s)
{
    for (connection *c = s->first; c; c = c->next)
        if (panel_outbox_has(&c->client.box, &s->feed.hub)) lws_callback_on_writable(c->wsi);
}

/* ---- clients ---- */

static panel_client *find_client(void *user, uint64_t number)
{
    panel_server *s = user;
    for (connection *c = s->first; c; c = c->next)
        if (c->client.number == number) return &c->client;
    return NULL;
}

static void each_client(void *user, void (*f)(panel_client *client, void *with), void *with)
{
    panel_server *s = user;
    for (connection *c = s->first; c; c = c->next) f(&c->client, with);
}

static void peer_of(char peer[PANEL_PEER_SIZE], struct lws *wsi)
{
    peer[0] = 0;
    lws_get_peer_simple(wsi, peer, PANEL_PEER_SIZE);
}

/* Why it is not let in; NULL: it is. */
static const char *turn_away(panel_server *s, struct lws *wsi, unsigned *status)
{
    char origin[200] = "", host[200] = "", header[200] = "", query[200] = "";
    const char *token = NULL;
    if (lws_hdr_total_length(wsi, WSI_TOKEN_ORIGIN) > 0 &&
        lws_hdr_copy(wsi, origin, sizeof origin, WSI_TOKEN_ORIGIN) < 0)
        snprintf(origin, sizeof origin, "?");
    (void)lws_hdr_copy(wsi, host, sizeof host, WSI_TOKEN_HOST);
    *status = HTTP_STATUS_FORBIDDEN;
    if (!panel_door_takes_origin(&s->door, origin, host))
        return "a page of another origin (--origin allows it)";
    if (lws_hdr_copy(wsi, header, sizeof header, WSI_TOKEN_HTTP_AUTHORIZATION) > 7 &&
        strncmp(header, "Bearer ", 7) == 0)
        token = header + 7;
    else
        token = lws_get_urlarg_by_name(wsi, "token=", query, sizeof query);
    *status = HTTP_STATUS_UNAUTHORIZED;
    if (!panel_door_knows(&s->door, token)) return token ? "a wrong token" : "no token";
    *status = HTTP_STATUS_SERVICE_UNAVAILABLE;
    if (s->counts.clients >= (uint64_t)s->options.most_clients) return "too many clients (--clients)";
    return NULL;
}

/* `known`: a subprotocol of ours was among those asked for. */
static int filter(panel_server *s, struct lws *wsi, bool known)
{
    char peer[PANEL_PEER_SIZE], origin[200] = "";
    unsigned status = HTTP_STATUS_BAD_REQUEST;
    const char *why = known ? turn_away(s, wsi, &status) : "none of the subprotocols that are spoken here";
    if (!why) return 0;
    (void)lws_hdr_copy(wsi, origin, sizeof origin, WSI_TOKEN_ORIGIN);
    peer_of(peer, wsi);
    s->counts.turned_away++;
    json_t *fields = json_pack("{s:s, s:s}", "peer", peer, "why", why);
    if (fields && *origin) json_object_set_new(fields, "origin", json_string(origin));
    audit_stranger(&s->audit, "turned away", fields);
    (void)lws_return_http_status(wsi, status, why);
    return -1;
}

static void welcome(panel_server *s, connection *c, struct lws *wsi)
{
    const int size = SOCKET_BUFFER;
    (void)setsockopt(lws_get_socket_fd(wsi), SOL_SOCKET, SO_SNDBUF, &size, sizeof size);
    c->wsi = wsi;
    c->client.number = ++s->clients;
    peer_of(c->client.peer, wsi);
    c->heard_s = c->moved_s = c->allowed_at_s = terminal_now_s();
    c->allowed = MESSAGES_AT_ONCE;
    c->next = s->first;
    s->first = c;
    s->counts.clients++;
    if (s->counts.clients > s->counts.most_clients) s->counts.most_clients = s->counts.clients;
    audit_stranger(&s->audit, "connect",
                   json_pack("{s:I, s:s}", "client", (json_int_t)c->client.number, "peer", c->client.peer));
    panel_desk_greet(s->desk, &c->client);
    lws_callback_on_writable(wsi);
}

static void farewell(panel_server *s, connection *c)
{
    connection **at = &s->first;
    while (*at && *at != c) at = &(*at)->next;
    if (!*at) return; /* it was never let in */
    *at = c->next;
    s->counts.clients--;
    panel_desk_leave(s->desk, &c->client, c->client.why[0] ? c->client.why : "closed");
    panel_outbox_free(&c->client.box);
    free(c->in);
    c->in = NULL;
    serve_all(s);
}

static int close_now(connection *c)
{
    lws_close_reason(c->wsi, LWS_CLOSE_STATUS_POLICY_VIOLATION, (unsigned char *)c->client.why,
                     strlen(c->client.why));
    return -1;
}

static void give_up(panel_server *s, connection *c, const char *why)
{
    if (c->client.why[0]) return;
    snprintf(c->client.why, sizeof c->client.why, "%s", why);
    s->counts.slow++;
    lws_set_timeout(c->wsi, PENDING_TIMEOUT_USER_REASON_BASE, LWS_TO_KILL_ASYNC);
}

/* A ping is due; not in the middle of a message. */
static int send_ping(panel_server *s, connection *c)
{
    if (!c->ping || c->client.box.frame || c->client.box.reply) return 0;
    c->ping = false;
    s->piece[LWS_PRE] = '?'; /* libwebsockets does not tell of an answer that is empty */
    return lws_write(c->wsi, s->piece + LWS_PRE, 1, LWS_WRITE_PING) < 1 ? -1 : 0;
}

static int send_some(panel_server *s, connection *c)
{
    if (c->client.why[0]) return close_now(c);
    if (send_ping(s, c) != 0) return -1;
    const size_t size = lws_send_pipe_choked(c->wsi)
                            ? 0
                            : panel_outbox_frames(&c->client.box, &s->feed.hub, s->piece + LWS_PRE, PIECE);
    if (size > 0) {
        if (lws_write(c->wsi, s->piece + LWS_PRE, size, LWS_WRITE_RAW) < (int)size) return -1;
        c->moved_s = terminal_now_s();
    }
    if (c->ping || panel_outbox_has(&c->client.box, &s->feed.hub)) lws_callback_on_writable(c->wsi);
    return 0;
}

static bool may_speak(connection *c, double now)
{
    c->allowed += MESSAGES_S * (now - c->allowed_at_s);
    c->allowed_at_s = now;
    if (c->allowed > MESSAGES_AT_ONCE) c->allowed = MESSAGES_AT_ONCE;
    c->allowed--;
    return c->allowed >= 0;
}

static void refuse_client(panel_server *s, connection *c, const char *why)
{
    panel_desk_refuse(s->desk, &c->client, "a message", why);
    s->counts.faults++;
    snprintf(c->client.why, sizeof c->client.why, "%s", why);
}

/* Pieces of frames, frames of messages. */
static int receive(panel_server *s, connection *c, const void *bytes, size_t size)
{
    const double now = terminal_now_s();
    const bool last = lws_is_final_fragment(c->wsi) && lws_remaining_packet_payload(c->wsi) == 0;
    c->heard_s = now;
    if (!c->in_open) {
        c->in_open = true;
        c->in_since_s = now;
        c->in_size = 0;
        c->in_binary = lws_frame_is_binary(c->wsi);
        if (!may_speak(c, now)) refuse_client(s, c, "more than 50 messages a second");
    }
    if (c->in_size + size > PANEL_MAX_REQUEST) refuse_client(s, c, "a message of more than 65536 bytes");
    if (c->client.why[0]) return close_now(c);
    unsigned char *more = realloc(c->in, c->in_size + size + 1);
    if (!more) return -1;
    c->in = more;
    memcpy(c->in + c->in_size, bytes, size);
    c->in_size += size;
    if (!last) return 0;
    c->in_open = false;
    panel_desk_take(s->desk, &c->client, c->in, c->in_size, c->in_binary);
    free(c->in);
    c->in = NULL;
    serve_all(s);
    return c->client.why[0] ? close_now(c) : 0;
}

static int on_socket(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
    connection *c = user;
    panel_server *s = lws_context_user(lws_get_context(wsi));
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return filter(s, wsi, true);
    case LWS_CALLBACK_ESTABLISHED:
        welcome(s, c, wsi);
        return 0;
    case LWS_CALLBACK_CLOSED:
        farewell(s, c);
        return 0;
    case LWS_CALLBACK_SERVER_WRITEABLE:
        return send_some(s, c);
    case LWS_CALLBACK_RECEIVE:
        return receive(s, c, in, size);
    case LWS_CALLBACK_RECEIVE_PONG:
        c->heard_s = terminal_now_s();
        return 0;
    default:
        return 0;
    }
}

/* ---- benches ---- */

static const char bench_protocol[] = "teledimos.bench"; /* of their pipes; no client speaks it */

static bool watch_bench(void *user, int file, void *child)
{
    panel_server *s = user;
    const lws_adopt_desc_t pipe = {.vh = s->host,
                                   .type = LWS_ADOPT_RAW_FILE_DESC,
                                   .fd = {.filefd = file},
                                   .vh_prot_name = bench_protocol,
                                   .opaque = child};
    return lws_adopt_descriptor_vhost_via_info(&pipe) != NULL;
}

static void answer_bench(void *user, const panel_bench_answer *answer)
{
    panel_server *s = user;
    panel_desk_bench(s->desk, answer);
}

static int on_bench(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
    panel_server *s = lws_context_user(lws_get_context(wsi));
    void *child = reason == LWS_CALLBACK_RAW_RX_FILE || reason == LWS_CALLBACK_RAW_CLOSE_FILE
                      ? lws_get_opaque_user_data(wsi)
                      : NULL;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return filter(s, wsi, false);
    case LWS_CALLBACK_RAW_RX_FILE: {
        const bool goes_on = panel_bench_readable(child);
        serve_all(s);
        return goes_on ? 0 : -1;
    }
    case LWS_CALLBACK_RAW_CLOSE_FILE:
        if (child) panel_bench_closed(child);
        return 0;
    default:
        return lws_callback_http_dummy(wsi, reason, user, in, size);
    }
}

static bool is_acquisition_watched(const panel_server *s)
{
    const size_t first = s->feed.about_count - s->acquired;
    for (const connection *c = s->first; c; c = c->next)
        for (size_t i = 0; i < c->client.box.count; i++)
            if ((size_t)c->client.box.subscription[i].channel >= first) return true;
    return false;
}

static td_status begin_bench(panel_server *s, const char *folder, td_error *error)
{
    panel_bench_options o = s->options.bench;
    o.output = folder;
    o.hub = &s->feed.hub;
    o.watch = watch_bench;
    o.answer = answer_bench;
    o.user = s;
    s->bench = panel_bench_new(&o);
    if (!s->bench) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    const td_mcap_channel *about = panel_bench_channels(s->bench, &s->acquired);
    for (size_t k = 0; k < s->acquired; k++) {
        int index;
        TD_TRY(panel_feed_add(&s->feed, &index, about + k, error));
        panel_bench_channel(s->bench, k, index);
    }
    return TD_OK;
}

/* ---- timers ---- */

static void each_second(lws_sorted_usec_list_t *timer)
{
    panel_server *s = lws_container_of(timer, panel_server, second);
    const double now = terminal_now_s(), late = s->swept_s > 0 ? now - s->swept_s - 1 : 0;
    s->swept_s = now;
    for (connection *c = s->first; c; c = c->next) {
        /* What came while this thread had to wait is not read yet. */
        if (late > 0) c->heard_s += late, c->moved_s += late, c->in_since_s += late;
        const bool leads = c->client.number == panel_desk_operator(s->desk);
        if (!panel_outbox_has(&c->client.box, &s->feed.hub)) c->moved_s = now;
        if (now - c->moved_s > STUCK_S) give_up(s, c, "it reads nothing of what it is sent");
        if (now - c->heard_s > (leads ? OPERATOR_SILENT_S : SILENT_S)) give_up(s, c, "it answers no ping");
        if (c->in_open && now - c->in_since_s > SLOW_S) {
            panel_desk_refuse(s->desk, &c->client, "a message", "too slow: not whole after 5 s");
            give_up(s, c, "too slow: a message was not whole after 5 s");
        }
        c->ping = true;
        lws_callback_on_writable(c->wsi);
    }
    panel_feed_flush(&s->feed, now);
    lws_sul_schedule(s->context, 0, &s->second, each_second, LWS_US_PER_SEC);
}

static void each_half_second(lws_sorted_usec_list_t *timer)
{
    panel_server *s = lws_container_of(timer, panel_server, half);
    panel_feed_diagnose(&s->feed);
    panel_bench_tick(s->bench, is_acquisition_watched(s), terminal_now_s());
    serve_all(s);
    lws_sul_schedule(s->context, 0, &s->half, each_half_second, LWS_US_PER_SEC / 2);
}

/* ---- the page ---- */

static int on_http(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
    panel_server *s = lws_context_user(lws_get_context(wsi));
    const panel_file *file = NULL;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return filter(s, wsi, false);
    case LWS_CALLBACK_HTTP:
        if (lws_hdr_total_length(wsi, WSI_TOKEN_GET_URI) > 0) file = panel_files_find(&s->files, in);
        if (file) return panel_page_send(wsi, user, file);
        if (lws_return_http_status(wsi, HTTP_STATUS_NOT_FOUND, NULL)) return -1;
        return lws_http_transaction_completed(wsi) ? -1 : 0;
    case LWS_CALLBACK_HTTP_WRITEABLE:
        return panel_page_send_more(wsi, user, s->piece + LWS_PRE, PIECE);
    case LWS_CALLBACK_EVENT_WAIT_CANCELLED:
        if (!s || !s->started) return 0;
        panel_feed_take(&s->feed);
        serve_all(s);
        return 0;
    default:
        return lws_callback_http_dummy(wsi, reason, user, in, size);
    }
}

/* ---- from the start to the end ---- */

static void *serve(void *user)
{
    panel_server *s = user;
    const struct sched_param usual = {0};
    /* Of this thread, whatever the program was given: the session's goes first. */
    (void)pthread_setschedparam(pthread_self(), SCHED_OTHER, &usual);
    (void)setpriority(PRIO_PROCESS, 0, 5);
    lws_sul_schedule(s->context, 0, &s->second, each_second, LWS_US_PER_SEC);
    lws_sul_schedule(s->context, 0, &s->half, each_half_second, 1);
    while (!atomic_load(&s->stop) && lws_service(s->context, 0) >= 0) {
    }
    return NULL;
}

static void wake(void *user)
{
    panel_server *s = user;
    lws_cancel_service(s->context);
}

static td_status listen_on(panel_server *s, td_error *error)
{
    static const struct lws_protocols protocols[] = {
        {"http", on_http, sizeof(transfer), 0, 0, NULL, 0},
        {PANEL_PROTOCOL_SDK, on_socket, sizeof(connection), 4096, 0, NULL, PIECE},
        {PANEL_PROTOCOL_WEBSOCKET, on_socket, sizeof(connection), 4096, 0, NULL, PIECE},
        {bench_protocol, on_bench, 0, 0, 0, NULL, 0},
        {NULL, NULL, 0, 0, 0, NULL, 0},
    };
    const bool everywhere = strcmp(s->options.host, "0.0.0.0") == 0;
    struct lws_context_creation_info info = {0};
    info.port = s->options.port;
    info.iface = everywhere ? NULL : s->options.host;
    info.protocols = protocols;
    info.user = s;
    info.gid = (gid_t)-1;
    info.uid = (uid_t)-1;
    info.timeout_secs = 5;
    info.keepalive_timeout = 5;
    info.max_http_header_pool = 64;
    info.fd_limit_per_thread = (unsigned)s->options.most_clients + 64;
    info.options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS | LWS_SERVER_OPTION_DISABLE_IPV6 |
                   LWS_SERVER_OPTION_FAIL_UPON_UNABLE_TO_BIND;
    if (s->options.certificate) info.options |= LWS_SERVER_OPTION_DO_SSL_GLOBAL_INIT;
    lws_set_log_level(0, NULL);
    s->context = lws_create_context(&info);
    if (!s->context) return td_fail(error, TD_ERROR_EXTERNAL, "the panel's server cannot be made");
    info.ssl_cert_filepath = s->options.certificate;
    info.ssl_private_key_filepath = s->options.key;
    s->host = lws_create_vhost(s->context, &info);
    if (!s->host)
        return td_fail(
            error, TD_ERROR_IO,
            "nothing can be served at %s:%d%s; is another program using this port? Give another by "
            "--port",
            s->options.host, s->options.port,
            s->options.certificate ? " with this certificate and key (PEM files)" : "");
    const int port = lws_get_vhost_listen_port(s->host);
    snprintf(s->url, sizeof s->url, "%s://%s:%d/", s->options.certificate ? "wss" : "ws", s->options.host,
             port);
    return TD_OK;
}

static td_status begin_files(panel_server *s, const char *folder, td_error *error)
{
    char identity[TD_HASH_HEX_SIZE];
    TD_TRY(task_identity(identity, s->feed.scenario, error));
    TD_TRY(td_folder_make(folder, error));
    char *record = td_path_join(folder, "audit.jsonl"), *recording = td_path_join(folder, "recording.mcap");
    td_status status = record && recording ? audit_open(&s->audit, record, error)
                                           : td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    if (status == TD_OK && !audit_write(&s->audit, "begin",
                                        json_pack("{s:s, s:s, s:s}", "scenario", s->feed.scenario->name,
                                                  "identity", identity, "version", TD_VERSION)))
        status = td_fail(error, TD_ERROR_IO, "%s: cannot be written; is the disk full?", record);
    if (status == TD_OK) status = panel_feed_begin(&s->feed, recording, identity, error);
    free(record);
    free(recording);
    return status;
}

static td_status begin_desk(panel_server *s, panel_parameter *list, int count, td_error *error)
{
    const panel_desk_options o = {.scenario = s->feed.scenario,
                                  .parameter = list,
                                  .parameter_count = count,
                                  .link = s->feed.link,
                                  .hub = &s->feed.hub,
                                  .audit = &s->audit,
                                  .counts = &s->counts,
                                  .channel = s->feed.about,
                                  .channel_count = s->feed.about_count,
                                  .bench = s->bench,
                                  .find = find_client,
                                  .each = each_client,
                                  .user = s};
    s->desk = s->feed.desk = panel_desk_new(&o);
    return s->desk ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
}

/* Signals are the main thread's. */
static td_status start(panel_server *s, td_error *error)
{
    sigset_t all, before;
    sigfillset(&all);
    s->feed.link->wake = wake;
    s->feed.link->user = s;
    s->started = true;
    pthread_sigmask(SIG_SETMASK, &all, &before);
    if (pthread_create(&s->thread, NULL, serve, s) != 0) s->started = false;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return s->started ? TD_OK : td_fail(error, TD_ERROR_EXTERNAL, "the panel's thread cannot be started");
}

td_status panel_server_new(panel_server **server, panel_link *link, const scenario *sc, panel_parameter *list,
                           int count, const char *folder, const panel_options *options, td_log log,
                           td_error *error)
{
    panel_server *s = *server = calloc(1, sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    s->feed = (panel_feed){.link = link,
                           .scenario = sc,
                           .parameter = list,
                           .parameter_count = count,
                           .log = log,
                           .counts = &s->counts,
                           .machine = options->machine};
    s->options = *options;
    atomic_init(&s->stop, false);
    s->door = (panel_door){.local = panel_door_is_local(options->host),
                           .origin = options->origin,
                           .origin_count = options->origin_count};
    if (options->token_file) TD_TRY(panel_door_token(&s->door, options->token_file, error));
    TD_TRY(listen_on(s, error));
    TD_TRY(begin_files(s, folder, error));
    TD_TRY(begin_bench(s, folder, error));
    TD_TRY(begin_desk(s, list, count, error));
    TD_TRY(panel_page_begin(&s->files, s->url, s->door.locked, error));
    return start(s, error);
}

const char *panel_server_url(const panel_server *server)
{
    return server->url;
}

static void stop(panel_server *s)
{
    if (s->started) {
        atomic_store(&s->stop, true);
        lws_cancel_service(s->context);
        pthread_join(s->thread, NULL);
    }
    s->started = false;
    panel_bench_stop(s->bench);
    if (s->context) lws_context_destroy(s->context);
    s->context = NULL;
}

void panel_server_free(panel_server **server)
{
    panel_server *s = *server;
    if (!s) return;
    stop(s);
    panel_bench_free(&s->bench);
    panel_feed_free(&s->feed);
    panel_files_free(&s->files);
    audit_close(&s->audit);
    panel_desk_free(&s->desk);
    free(s);
    *server = NULL;
}

td_status panel_server_finish(panel_server **server, panel_counts *counts, long period, double time_s,
                              td_error *error)
{
    panel_server *s = *server;
    stop(s);
    const td_status status = panel_feed_finish(&s->feed, period, time_s, error);
    (void)audit_write(&s->audit, "end",
                      json_pack("{s:f, s:I}", "time_s", time_s, "period", (json_int_t)period));
    *counts = s->counts;
    panel_server_free(server);
    return status;
}
