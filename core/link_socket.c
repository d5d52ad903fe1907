/* TCP under the link. */
#define _DEFAULT_SOURCE /* struct tcp_info */
#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fcntl.h>

#include <openssl/crypto.h>

#include "core/link_internal.h"

struct td_link_listener {
    td_link_options o;
    uint8_t token[TD_LINK_TOKEN_MAX];
    int fd, port;
    struct ssl_ctx_st *context;
};

/* ---- addresses ---- */

enum { HOST_SIZE = 256 };

/* HOST:PORT apart. */
static td_status split(char host[HOST_SIZE], const char **port, const char *address, td_error *error)
{
    const char *colon = strrchr(address, ':');
    const bool bracketed = address[0] == '[';
    const char *first = address + bracketed, *last = colon ? colon - bracketed : NULL;
    if (!colon || last <= first || (bracketed && *last != ']') || last - first >= HOST_SIZE || !colon[1] ||
        strspn(colon + 1, "0123456789") != strlen(colon + 1) || strlen(colon + 1) > 5 ||
        atoi(colon + 1) > 65535)
        return td_fail(error, TD_ERROR_ARGUMENT, "'%.80s' is no address: HOST:PORT, as 127.0.0.1:7420",
                       address);
    snprintf(host, HOST_SIZE, "%.*s", (int)(last - first), first);
    *port = colon + 1;
    return TD_OK;
}

static bool is_loopback(const struct sockaddr *a)
{
    if (a->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)(const void *)a)->sin_addr.s_addr) >> 24 == 127;
    return a->sa_family == AF_INET6 &&
           IN6_IS_ADDR_LOOPBACK(&((const struct sockaddr_in6 *)(const void *)a)->sin6_addr);
}

static td_status resolve(struct addrinfo **found, char host[HOST_SIZE], const char *address, bool to_listen,
                         const td_link_options *o, td_error *error)
{
    const char *port = NULL;
    const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = to_listen ? AI_PASSIVE : 0};
    TD_TRY(split(host, &port, address, error));
    const int failed = getaddrinfo(host, port, &hints, found);
    if (failed) return td_fail(error, TD_ERROR_NOT_FOUND, "%s: %s", address, gai_strerror(failed));
    const bool secret = o->tls || o->plain_anywhere || is_loopback((*found)->ai_addr);
    if (secret) return TD_OK;
    freeaddrinfo(*found);
    *found = NULL;
    return td_fail(error, TD_ERROR_ARGUMENT,
                   "%s: beyond this computer a link is encrypted: use TLS (or ask for plain TCP)", address);
}

static void name_peer(td_link *link, const struct sockaddr *a, socklen_t size)
{
    char host[64] = "?", port[16] = "?";
    (void)getnameinfo(a, size, host, sizeof host, port, sizeof port, NI_NUMERICHOST | NI_NUMERICSERV);
    snprintf(link->peer, sizeof link->peer, strchr(host, ':') ? "[%.60s]:%.8s" : "%.60s:%.8s", host, port);
}

/* Not blocking, not kept by programs that are run; small frames at once. */
static bool make_ready(int fd, bool stream)
{
    const int on = 1, flags = fcntl(fd, F_GETFL);
    if (flags < 0 || fcntl(fd, F_SETFL, flags | O_NONBLOCK) != 0 || fcntl(fd, F_SETFD, FD_CLOEXEC) != 0)
        return false;
    return !stream || setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on) == 0;
}

/* ---- listening ---- */

void td_link_listener_free(td_link_listener **listener)
{
    if (!listener || !*listener) return;
    if ((*listener)->fd >= 0) close((*listener)->fd);
    link_tls_context_free(&(*listener)->context);
    OPENSSL_cleanse((*listener)->token, sizeof(*listener)->token);
    free(*listener);
    *listener = NULL;
}

static td_status open_listener(td_link_listener *l, const struct addrinfo *a, const char *address,
                               td_error *error)
{
    const int on = 1;
    struct sockaddr_storage bound = {0};
    socklen_t size = sizeof bound;
    l->fd = socket(a->ai_family, SOCK_STREAM, 0);
    if (l->fd < 0 || !make_ready(l->fd, false) ||
        setsockopt(l->fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0 ||
        bind(l->fd, a->ai_addr, a->ai_addrlen) != 0 || listen(l->fd, 8) != 0 ||
        getsockname(l->fd, (struct sockaddr *)(void *)&bound, &size) != 0)
        return td_fail(error, TD_ERROR_IO, "%s: cannot listen here: %s", address, strerror(errno));
    l->port = ntohs(bound.ss_family == AF_INET6 ? ((struct sockaddr_in6 *)(void *)&bound)->sin6_port
                                                : ((struct sockaddr_in *)(void *)&bound)->sin_port);
    return TD_OK;
}

td_status td_link_listen(td_link_listener **listener, const char *address, const td_link_options *options,
                         td_error *error)
{
    char host[HOST_SIZE];
    struct addrinfo *found = NULL;
    td_link *probe = NULL;
    *listener = NULL;
    TD_TRY(link_begin(&probe, true, options, 0, error)); /* its options' check */
    td_link_free(&probe);
    TD_TRY(resolve(&found, host, address, true, options, error));
    td_link_listener *l = calloc(1, sizeof *l);
    if (!l) {
        freeaddrinfo(found);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a link");
    }
    l->o = *options;
    memcpy(l->token, options->token, options->token_size);
    l->o.token = l->token;
    l->fd = -1;
    td_status status = open_listener(l, found, address, error);
    if (status == TD_OK && l->o.tls) status = link_tls_server(&l->context, options, error);
    freeaddrinfo(found);
    if (status != TD_OK) td_link_listener_free(&l);
    *listener = l;
    return status;
}

int td_link_listener_fd(const td_link_listener *listener)
{
    return listener->fd;
}

int td_link_listener_port(const td_link_listener *listener)
{
    return listener->port;
}

td_status td_link_accept(td_link **link, td_link_listener *listener, double now_s, td_error *error)
{
    struct sockaddr_storage from = {0};
    socklen_t size = sizeof from;
    *link = NULL;
    const int fd = accept(listener->fd, (struct sockaddr *)(void *)&from, &size);
    if (fd < 0) return TD_OK; /* nobody, or gone again */
    td_status status = make_ready(fd, true) ? link_begin(link, true, &listener->o, now_s, error)
                                            : td_fail(error, TD_ERROR_IO, "a socket: %s", strerror(errno));
    if (status != TD_OK) {
        close(fd);
        return status;
    }
    (*link)->fd = fd;
    name_peer(*link, (struct sockaddr *)(void *)&from, size);
    if (listener->context)
        status = link_tls_begin(*link, listener->context, NULL, error);
    else
        link_say_hello(*link);
    if (status != TD_OK) td_link_free(link);
    return status;
}

/* ---- connecting ---- */

static td_status begin_connect(td_link *link, const struct addrinfo *a, const char *host, td_error *error)
{
    struct ssl_ctx_st *context = NULL;
    name_peer(link, a->ai_addr, a->ai_addrlen);
    link->fd = socket(a->ai_family, SOCK_STREAM, 0);
    if (link->fd < 0 || !make_ready(link->fd, true))
        return td_fail(error, TD_ERROR_IO, "a socket: %s", strerror(errno));
    if (connect(link->fd, a->ai_addr, a->ai_addrlen) != 0 && errno != EINPROGRESS)
        return td_fail(error, TD_ERROR_IO, "%s: cannot connect: %s", link->peer, strerror(errno));
    link->connecting = true;
    if (!link->o.tls) return TD_OK;
    TD_TRY(link_tls_client(&context, &link->o, error));
    const td_status status = link_tls_begin(link, context, link->o.authority ? host : NULL, error);
    link_tls_context_free(&context);
    return status;
}

td_status td_link_connect(td_link **link, const char *address, const td_link_options *options, double now_s,
                          td_error *error)
{
    char host[HOST_SIZE];
    struct addrinfo *found = NULL;
    TD_TRY(link_begin(link, false, options, now_s, error));
    td_status status = resolve(&found, host, address, false, options, error);
    if (status == TD_OK) status = begin_connect(*link, found, host, error);
    if (found) freeaddrinfo(found);
    if (status != TD_OK) td_link_free(link);
    return status;
}

/* ---- carrying ---- */

static void hang_up(td_link *link)
{
    if (link->fd >= 0) close(link->fd);
    link->fd = -1;
}

static void finish_connect(td_link *link)
{
    struct pollfd p = {.fd = link->fd, .events = POLLOUT};
    int failed = 0;
    socklen_t size = sizeof failed;
    if (poll(&p, 1, 0) != 1) return;
    if (getsockopt(link->fd, SOL_SOCKET, SO_ERROR, &failed, &size) != 0) failed = errno;
    if (failed) {
        link_fail(link, "cannot connect to %s: %s", link->peer, strerror(failed));
        return;
    }
    link->connecting = false;
    if (link->tls)
        link_tls_take(link, NULL, 0);
    else
        link_say_hello(link);
}

/* What a client may have done wrong. */
static const char *hint(const td_link *link)
{
    if (link->server) return "";
    if (link->state == TD_LINK_HELLO && !link->tls) return " before it said anything: does it want TLS?";
    return link->state == TD_LINK_PROOF ? " when tokens were compared: do both hold the same?" : "";
}

/* No more at a time than is worth a frame or so: what comes faster waits in the kernel, and slows the sender.
 */
static void receive(td_link *link, double now_s)
{
    uint8_t bytes[16384];
    size_t most = link->o.frame_max + (size_t)65536;
    while (link->state != TD_LINK_CLOSED && most > 0) {
        const ssize_t n = recv(link->fd, bytes, sizeof bytes, 0);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (n > 0) {
            td_link_take(link, bytes, (size_t)n, now_s);
            most -= (size_t)n < most ? (size_t)n : most;
            continue;
        }
        link_fail(link, "the other end closed the connection%s%s%s", n < 0 ? ": " : "",
                  n < 0 ? strerror(errno) : "", hint(link));
        return;
    }
}

static void carry(td_link *link)
{
    while (link->out.used) {
        size_t size;
        const uint8_t *bytes = td_link_give(link, &size);
        const ssize_t n = send(link->fd, bytes, size, MSG_NOSIGNAL);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (n < 0) {
            link_fail(link, "the other end closed the connection: %s", strerror(errno));
            return;
        }
        td_link_gave(link, (size_t)n);
    }
}

void td_link_poll(td_link *link, double now_s)
{
    if (link->fd >= 0 && link->connecting) finish_connect(link);
    if (link->fd >= 0 && !link->connecting) receive(link, now_s);
    link_judge(link, now_s);
    if (link->fd >= 0 && !link->connecting) carry(link);
    if (link->state == TD_LINK_CLOSED) hang_up(link);
}

int td_link_fd(const td_link *link, short *events)
{
    *events = (short)(POLLIN | (link->connecting || link->out.used ? POLLOUT : 0));
    return link->fd;
}

td_link_measure td_link_measure_of(const td_link *link, double now_s)
{
    td_link_measure m = link->measure;
    if (m.pings != m.answers) m.unanswered_s = now_s - link->stamp_s[m.answers % LINK_PINGS];
    struct tcp_info about;
    socklen_t size = sizeof about;
    if (link->fd >= 0 && getsockopt(link->fd, IPPROTO_TCP, TCP_INFO, &about, &size) == 0)
        m.retransmitted = about.tcpi_total_retrans;
    return m;
}

void td_link_free(td_link **link)
{
    if (!link || !*link) return;
    td_link *l = *link;
    if (l->state == TD_LINK_OPEN && l->fd >= 0) {
        link_farewell(l);
        carry(l);
    }
    hang_up(l);
    link_tls_end(l);
    OPENSSL_cleanse(l->token, sizeof l->token);
    OPENSSL_cleanse(l->key, sizeof l->key);
    free(l->in.data);
    free(l->out.data);
    free(l->ready.data);
    free(l);
    *link = NULL;
}
