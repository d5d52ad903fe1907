#include "tests/watchers.h"

#include <arpa/inet.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum {
    MOST_TOPICS = 32,
    HEAD = 10,     /* bytes before a frame's payload, at most */
    CONTROL = 125, /* bytes of a ping */
    MESSAGE = 13,  /* what is looked at of a message: opcode, subscription, time */
    SMALL = 4096,
    PIECE = 1 << 17
};
static const double AGAIN_S = 20, LOOK_S = 1, PATIENCE_S = 20;

typedef struct watcher {
    int fd; /* -1: closed */
    bool silent;
    unsigned char part[HEAD + CONTROL]; /* (size) of a frame: what is looked at */
    size_t size;
    uint64_t skip; /* bytes of it that are not */
    uint64_t count[MOST_TOPICS], first_tf_ns, last_tf_ns;
    double joined_s, seen_s, silence_s;
} watcher;

typedef struct crowd {
    watchers_options o;
    watcher *watcher; /* (o.clients) */
    int poll, open;   /* readers that are there */
    char topic[MOST_TOPICS][80];
    int tf; /* which of them; -1: none */
    size_t topics;
    char subscribe[4096];
    uint64_t silent_joins, bytes;
    double begun_s, looked_s, panel_begun_s;
    long memory_kib[3];
    char *why;
} crowd;

static double seconds_of(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double now_s(void)
{
    return seconds_of(CLOCK_MONOTONIC);
}

/* ---- frames ---- */

static bool send_all(int fd, const void *bytes, size_t size)
{
    return send(fd, bytes, size, MSG_NOSIGNAL) == (ssize_t)size; /* little, into an empty buffer */
}

/* One frame, masked as a client's must be. */
static bool send_frame(int fd, int op, const void *payload, size_t size)
{
    static const unsigned char key[4] = {0x5a, 0x17, 0xc3, 0x88};
    unsigned char frame[8 + sizeof((crowd *)0)->subscribe];
    size_t at = 0;
    frame[at++] = (unsigned char)(0x80 | op);
    frame[at++] = (unsigned char)(0x80 | (size < 126 ? size : 126));
    if (size >= 126) frame[at++] = (unsigned char)(size >> 8), frame[at++] = (unsigned char)(size & 255);
    memcpy(frame + at, key, 4);
    at += 4;
    for (size_t i = 0; i < size; i++) frame[at++] = ((const unsigned char *)payload)[i] ^ key[i % 4];
    return send_all(fd, frame, at);
}

static uint64_t little_endian(const unsigned char *bytes, size_t size)
{
    uint64_t x = 0;
    while (size--) x = x << 8 | bytes[size];
    return x;
}

/* Bytes before a frame's payload, and how many that is; as far as `size` bytes of it tell. */
static size_t head_of(const unsigned char *part, size_t size, uint64_t *payload)
{
    if (size < 2) return 2;
    const size_t more = (part[1] & 127) < 126 ? 0 : (part[1] & 127) == 126 ? 2 : 8;
    *payload = part[1] & 127;
    if (more && size >= 2 + more) *payload = 0;
    for (size_t i = 0; more && size >= 2 + more && i < more; i++) *payload = *payload << 8 | part[2 + i];
    return 2 + more;
}

/* Of a frame that begins with `part`, what is to be looked at. */
static size_t needed(const watcher *w, uint64_t *payload)
{
    *payload = 0;
    const size_t head = head_of(w->part, w->size, payload);
    if (w->size < head) return head;
    const size_t most = w->part[0] & 8 ? CONTROL : MESSAGE;
    return head + (*payload < most ? (size_t)*payload : most);
}

static void take_message(crowd *c, watcher *w, const unsigned char *message)
{
    const uint64_t topic = little_endian(message + 1, 4) - 1, ns = little_endian(message + 5, 8);
    if (topic >= c->topics) return;
    w->count[topic]++;
    if ((int)topic != c->tf) return;
    if (!w->first_tf_ns) w->first_tf_ns = ns;
    w->last_tf_ns = ns;
}

/* False: the panel closes. */
static bool take_frame(crowd *c, watcher *w, uint64_t payload)
{
    const int op = w->part[0] & 15;
    uint64_t unused;
    const unsigned char *begin = w->part + head_of(w->part, w->size, &unused);
    if (op == 8) return false;
    if (op == 9) return payload <= CONTROL && send_frame(w->fd, 10, begin, (size_t)payload);
    if (op == 2 && payload >= MESSAGE && begin[0] == 1) take_message(c, w, begin);
    return true;
}

static bool take_bytes(crowd *c, watcher *w, const unsigned char *bytes, size_t size)
{
    while (size) {
        uint64_t payload;
        const size_t wanted = w->skip ? (size_t)w->skip : needed(w, &payload) - w->size;
        const size_t n = wanted < size ? wanted : size;
        if (w->skip) {
            w->skip -= n;
        } else {
            memcpy(w->part + w->size, bytes, n);
            w->size += n;
            const size_t whole = needed(w, &payload);
            if (w->size == whole) {
                uint64_t unused;
                if (!take_frame(c, w, payload)) return false;
                w->skip = payload - (whole - head_of(w->part, w->size, &unused));
                w->size = 0;
            }
        }
        bytes += n;
        size -= n;
    }
    return true;
}

/* ---- joining ---- */

static bool read_all(int fd, void *bytes, size_t size)
{
    return size == 0 || recv(fd, bytes, size, MSG_WAITALL) == (ssize_t)size;
}

/* To the end of the answer's head, and no further. */
static bool is_let_in(int fd)
{
    char answer[1024] = "";
    for (size_t n = 0; n + 1 < sizeof answer && recv(fd, answer + n, 1, 0) == 1; n++)
        if (n >= 3 && memcmp(answer + n - 3, "\r\n\r\n", 4) == 0)
            return strncmp(answer, "HTTP/1.1 101", 12) == 0;
    return false;
}

/* -1: it is not let in. */
static int join_in(int port, bool silent)
{
    static const char hello[] =
        "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";
    static const int small = SMALL;
    static const struct timeval patience = {(time_t)PATIENCE_S, 0};
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int fd = socket(AF_INET, SOCK_STREAM, 0);
    if (fd < 0) return -1;
    if (silent) (void)setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    if (connect(fd, (struct sockaddr *)&at, sizeof at) == 0 && send_all(fd, hello, sizeof hello - 1) &&
        is_let_in(fd))
        return fd;
    close(fd);
    return -1;
}

static bool is_wanted(const watchers_options *o, const char *topic)
{
    for (size_t i = 0; i < o->topics; i++)
        if (strcmp(topic, o->topic[i]) == 0) return true;
    return o->topics == 0;
}

/* The subscriptions' numbers are 1 more than the topics' places. */
static void choose_topics(crowd *c, const json_t *advertise)
{
    size_t i;
    const json_t *channel;
    char *at = c->subscribe, *end = at + sizeof c->subscribe;
    at += snprintf(at, (size_t)(end - at), "{\"op\":\"subscribe\",\"subscriptions\":[");
    json_array_foreach(json_object_get(advertise, "channels"), i, channel)
    {
        const char *topic = json_string_value(json_object_get(channel, "topic"));
        if (!topic || !is_wanted(&c->o, topic) || c->topics == MOST_TOPICS) continue;
        if (strcmp(topic, "/tf") == 0) c->tf = (int)c->topics;
        snprintf(c->topic[c->topics++], sizeof *c->topic, "%s", topic);
        at += snprintf(at, (size_t)(end - at), "%s{\"id\":%zu,\"channelId\":%lld}", c->topics > 1 ? "," : "",
                       c->topics, (long long)json_integer_value(json_object_get(channel, "id")));
    }
    snprintf(at, (size_t)(end - at), "]}");
}

/* A whole text message, or a frame of another kind; to be freed. NULL: the panel says no more. */
static char *read_message(int fd, size_t *size)
{
    unsigned char head[HEAD] = {0};
    char *text = NULL;
    *size = 0;
    do {
        uint64_t more = 0;
        const size_t rest = read_all(fd, head, 2) ? head_of(head, 2, &more) - 2 : HEAD;
        if (rest == HEAD || !read_all(fd, head + 2, rest)) break;
        (void)head_of(head, 2 + rest, &more);
        char *longer = more < 1 << 24 ? realloc(text, *size + (size_t)more + 1) : NULL;
        if (!longer) break;
        text = longer;
        if (!read_all(fd, text + *size, (size_t)more)) break;
        *size += (size_t)more;
        if (head[0] & 128) return text;
    } while (*size < 1 << 24);
    free(text);
    return NULL;
}

/* What there is, as a newcomer is told. */
static bool learn_topics(crowd *c)
{
    size_t size;
    const int fd = join_in(c->o.port, false);
    for (char *text; fd >= 0 && c->topics == 0 && (text = read_message(fd, &size)); free(text)) {
        json_t *told = json_loadb(text, size, 0, NULL);
        const char *op = json_string_value(json_object_get(told, "op"));
        if (op && strcmp(op, "advertise") == 0) choose_topics(c, told);
        json_decref(told);
    }
    if (fd >= 0) close(fd);
    return c->topics > 0;
}

static bool join(crowd *c, watcher *w)
{
    w->fd = join_in(c->o.port, w->silent);
    if (w->fd < 0 || !send_frame(w->fd, 1, c->subscribe, strlen(c->subscribe))) return false;
    w->joined_s = w->seen_s = now_s();
    if (w->silent) {
        c->silent_joins++;
        return true;
    }
    struct epoll_event e = {.events = EPOLLIN, .data.ptr = w};
    c->open++;
    return epoll_ctl(c->poll, EPOLL_CTL_ADD, w->fd, &e) == 0;
}

static bool join_all(crowd *c)
{
    if (!learn_topics(c)) {
        snprintf(c->why, 200, "the panel at port %d tells no channels", c->o.port);
        return false;
    }
    for (int i = 0; i < c->o.clients; i++) {
        /* Spread among those who read. */
        c->watcher[i].silent = (i + 1) * c->o.silent / c->o.clients > i * c->o.silent / c->o.clients;
        if (join(c, c->watcher + i)) continue;
        snprintf(c->why, 200, "client %d is not let in", i + 1);
        return false;
    }
    return true;
}

/* ---- watching ---- */

static void leave(crowd *c, watcher *w)
{
    close(w->fd);
    w->fd = -1;
    c->open--;
}

static void read_some(crowd *c, watcher *w, double now)
{
    static unsigned char piece[PIECE]; /* one crowd a program */
    const ssize_t n = recv(w->fd, piece, sizeof piece, MSG_DONTWAIT);
    if (now - w->seen_s > w->silence_s) w->silence_s = now - w->seen_s;
    w->seen_s = now;
    if (n > 0) c->bytes += (uint64_t)n;
    if (n <= 0 || !take_bytes(c, w, piece, (size_t)n)) leave(c, w);
}

/* One at a time: the others go on reading. */
static void join_again(crowd *c, double now)
{
    for (int i = 0; i < c->o.clients; i++) {
        watcher *w = c->watcher + i;
        if (!w->silent || now < w->joined_s + AGAIN_S) continue;
        if (w->fd >= 0) close(w->fd);
        if (join(c, w)) return;
        if (w->fd >= 0) close(w->fd);
        w->fd = -1;
        w->joined_s = now; /* and once more, later */
        return;
    }
}

static double panel_seconds(pid_t panel)
{
    char path[64], text[1024] = "";
    unsigned long user = 0, system = 0;
    snprintf(path, sizeof path, "/proc/%ld/stat", (long)panel);
    FILE *file = panel ? fopen(path, "r") : NULL;
    if (!file) return 0;
    const char *at = fgets(text, sizeof text, file) ? strrchr(text, ')') : NULL;
    if (at) (void)sscanf(at, ") %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &system);
    fclose(file);
    return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

static long memory_of(pid_t panel)
{
    char path[64], line[200];
    long kib = 0;
    snprintf(path, sizeof path, "/proc/%ld/status", (long)panel);
    FILE *file = panel ? fopen(path, "r") : NULL;
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, "VmRSS: %ld", &kib) == 1) break;
    if (file) fclose(file);
    return kib;
}

/* The silent ones ask for what they do not read. */
static void ask(crowd *c)
{
    static const char all[] = "{\"op\":\"getParameters\",\"parameterNames\":[],\"id\":\"all\"}";
    for (int i = 0; i < c->o.clients; i++)
        if (c->watcher[i].silent && c->watcher[i].fd >= 0)
            (void)send_frame(c->watcher[i].fd, 1, all, sizeof all - 1);
}

/* Each second. */
static void look(crowd *c, double now)
{
    const long kib = memory_of(c->o.panel);
    long *peak = c->memory_kib + (now < c->begun_s + c->o.seconds / 3 ? 1 : 2);
    if (!c->memory_kib[0]) c->memory_kib[0] = kib;
    if (kib > *peak) *peak = kib;
    c->looked_s = now;
}

static void watch(crowd *c)
{
    struct epoll_event event[64];
    double now = c->begun_s = now_s();
    c->panel_begun_s = panel_seconds(c->o.panel);
    for (int i = 0; i < c->o.clients; i++) c->watcher[i].seen_s = now; /* nobody read while they joined */
    while (now < c->begun_s + c->o.seconds && c->open > 0) {
        const int n = epoll_wait(c->poll, event, 64, 100);
        now = now_s();
        for (int i = 0; i < n; i++) read_some(c, event[i].data.ptr, now);
        join_again(c, now);
        if (now > c->looked_s + LOOK_S) ask(c), look(c, now);
    }
}

/* ---- told ---- */

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts; the least, the median and the most. */
static json_t *spread(double *x, size_t n)
{
    qsort(x, n, sizeof *x, by_size);
    return n ? json_pack("[f, f, f]", x[0], x[n / 2], x[n - 1]) : json_array();
}

static double share_of(const crowd *c, const watcher *w)
{
    const double periods = 1e-9 * (double)(w->last_tf_ns - w->first_tf_ns) / c->o.period_s + 1;
    return c->tf < 0 ? 0 : (double)w->count[c->tf] / periods;
}

static json_t *tell(const crowd *c, double took, double own)
{
    double *share = calloc((size_t)c->o.clients, sizeof *share),
           *silence = calloc((size_t)c->o.clients, sizeof *silence);
    json_t *messages = json_object();
    uint64_t all = 0;
    size_t readers = 0;
    for (int i = 0; i < c->o.clients && share && silence; i++) {
        const watcher *w = c->watcher + i;
        const double last = c->begun_s + took - w->seen_s;
        if (w->silent) continue;
        share[readers] = share_of(c, w);
        silence[readers++] = last > w->silence_s ? last : w->silence_s;
    }
    for (size_t t = 0; t < c->topics; t++) {
        uint64_t sum = 0;
        for (int i = 0; i < c->o.clients; i++) sum += c->watcher[i].count[t];
        json_object_set_new(messages, c->topic[t], json_integer((json_int_t)sum));
        all += sum;
    }
    json_t *told =
        json_pack("{s:I, s:I, s:I, s:f, s:f, s:f, s:o, s:o, s:o, s:[I, I, I], s:f, s:f}", "readers",
                  (json_int_t)readers, "closed", (json_int_t)readers - c->open, "silent_joins",
                  (json_int_t)c->silent_joins, "seconds", took, "messages_1_s", (double)all / took, "mb_1_s",
                  1e-6 * (double)c->bytes / took, "messages", messages, "tf_share", spread(share, readers),
                  "silence_s", spread(silence, readers), "memory_kib", (json_int_t)c->memory_kib[0],
                  (json_int_t)c->memory_kib[1], (json_int_t)c->memory_kib[2], "panel_cpu",
                  (panel_seconds(c->o.panel) - c->panel_begun_s) / took, "own_cpu", own / took);
    free(share);
    free(silence);
    return told;
}

json_t *watchers_run(const watchers_options *options, char why[200])
{
    crowd *c = calloc(1, sizeof *c);
    json_t *told = NULL;
    snprintf(why, 200, "out of memory");
    if (!c) return NULL;
    c->o = *options;
    c->tf = -1;
    c->why = why;
    c->poll = epoll_create1(0);
    c->watcher = calloc((size_t)options->clients, sizeof *c->watcher);
    for (int i = 0; c->watcher && i < options->clients; i++) c->watcher[i].fd = -1;
    if (c->watcher && join_all(c)) {
        const double own = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
        watch(c);
        told = tell(c, now_s() - c->begun_s, seconds_of(CLOCK_PROCESS_CPUTIME_ID) - own);
    }
    for (int i = 0; c->watcher && i < options->clients; i++)
        if (c->watcher[i].fd >= 0) close(c->watcher[i].fd);
    if (c->poll >= 0) close(c->poll);
    free(c->watcher);
    free(c);
    return told;
}
