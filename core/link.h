/* A link to another process, which may be far away and whose words are not trusted: frames over TCP, with or
 * without TLS, between two sides that hold the same token. Nothing blocks, no threads: td_link_poll does what
 * there is to do now.
 *
 *   state       what comes                                          leads to
 *   CONNECTING  TCP, and TLS where it is asked for                  HELLO
 *   HELLO       the other's hello, of this version and channel      PROOF
 *   PROOF       the other's proof that it holds the token           OPEN
 *   OPEN        what is refused below, td_link_close                CLOSED
 *   any         anything else; handshake_s are over before OPEN     CLOSED (td_link_why)
 *
 * On the wire, numbers with the highest byte first:
 *   hello   "TDLK", u16 version, u8 side (0 client, 1 server), u8 channel, 16 bytes of session, 32 of a
 *           nonce. The client's comes first. A server answers another version with its hello, and closes.
 *   proof   HMAC-SHA256(token; "teledimos client proof", client's hello, server's hello, binding); the
 *           server's with "server", and only after the client's was right. The binding is what TLS exports
 *           under "EXPORTER-teledimos-link" (32 bytes; zeros without TLS), so that nobody can sit in the
 *           middle who has not the token, whatever certificates are believed. The token is never sent.
 *   frame   u32 size of the payload, u8 version, u8 kind, u64 sequence, payload, tag: the first 16 bytes
 *           of HMAC-SHA256(key; all before it), key = HMAC-SHA256(token; "teledimos client frames", the
 *           rest as in the proof), or with "server". Sequence: 0, 1, 2 ... each way.
 *   ping    a frame of kind 255, u64 number, twice each period
 *   pong    254, the same number, at once
 *   farewell  253, nothing
 *
 * Refused, by closing: a tag that is wrong; a sequence number out of turn (a replayed frame); a payload above
 * frame_max; more frames a second than frames_per_s, more bytes than bytes_per_s; a frame that takes longer
 * than timeout_s to come; frames that nobody takes. A ping that is not answered within timeout_s closes too,
 * so that a cut line, a delay, and a peer that hears but does not answer are all found the same way, whoever
 * of the two was slow to look: answers that came meanwhile are read first. */
#ifndef TELEDIMOS_CORE_LINK_H
#define TELEDIMOS_CORE_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    TD_LINK_VERSION = 1,
    TD_LINK_SESSION_SIZE = 16,
    TD_LINK_TOKEN_MIN = 16,
    TD_LINK_TOKEN_MAX = 1024,
    TD_LINK_KIND_MAX = 199, /* of the users' frames */
    TD_LINK_OVERHEAD = 30,  /* bytes of a frame besides its payload */
    TD_LINK_HELLO_SIZE = 56
};

typedef enum td_link_state {
    TD_LINK_CONNECTING,
    TD_LINK_HELLO,
    TD_LINK_PROOF,
    TD_LINK_OPEN,
    TD_LINK_CLOSED
} td_link_state;

typedef struct td_link_options {
    const void *token; /* copied */
    size_t token_size;
    uint8_t channel;                       /* both sides must mean the same, but for a server with: */
    bool any_channel;                      /* td_link_channel tells which */
    uint8_t session[TD_LINK_SESSION_SIZE]; /* client: of another link that this one belongs to; else zeros */
    double period_s, timeout_s;            /* of the heartbeat: 0.1, 0.3 */
    double handshake_s;                    /* 2 */
    size_t frame_max;                      /* bytes of a payload that is received: 256 KiB */
    size_t unsent_max;                     /* bytes that wait to be sent: 1 MiB */
    double frames_per_s, bytes_per_s;      /* received: 1000, 4 MiB; a second's worth may come at once */
    /* TLS (1.3). Server: certificate chain and key, PEM. Client: `tls` without authority: the token alone
     * says who is there; with: the certificate is checked against it, and the host's name or address. */
    bool tls;
    const char *certificate, *key; /* paths */
    const char *authority;         /* path */
    bool plain_anywhere;           /* without TLS beyond this computer: refused unless asked for */
} td_link_options;
TD_API td_link_options td_link_options_default(void);

/* A token from a file: what stands there but for a line's end. Refused: files that others than the owner may
 * read, fewer than TD_LINK_TOKEN_MIN or more than TD_LINK_TOKEN_MAX bytes. */
TD_API td_status td_link_token_read(uint8_t token[TD_LINK_TOKEN_MAX], size_t *size, const char *path,
                                    td_error *error);

typedef struct td_link td_link;
typedef struct td_link_listener td_link_listener;

/* "HOST:PORT", "[::1]:PORT"; port 0: any that is free. */
TD_API td_status td_link_listen(td_link_listener **listener, const char *address,
                                const td_link_options *options, td_error *error);
TD_API void td_link_listener_free(td_link_listener **listener);
TD_API int td_link_listener_fd(const td_link_listener *listener); /* readable: somebody is there */
TD_API int td_link_listener_port(const td_link_listener *listener);
/* *link NULL: nobody is there. */
TD_API td_status td_link_accept(td_link **link, td_link_listener *listener, double now_s, td_error *error);
/* Begins to; td_link_poll goes on. */
TD_API td_status td_link_connect(td_link **link, const char *address, const td_link_options *options,
                                 double now_s, td_error *error);
/* Says farewell where it is open. */
TD_API void td_link_free(td_link **link);

/* Reads, answers, sends, judges. now_s: of a monotonic clock, the same for all calls. */
TD_API void td_link_poll(td_link *link, double now_s);
/* For poll(2); *events gets POLLIN, POLLOUT. -1: closed. */
TD_API int td_link_fd(const td_link *link, short *events);

TD_API td_link_state td_link_state_of(const td_link *link);
/* Why it is closed, a sentence; "" while it is not. *left (may be NULL): the other said farewell. */
TD_API const char *td_link_why(const td_link *link, bool *left);
TD_API const char *td_link_peer(const td_link *link); /* "127.0.0.1:4711" */
TD_API uint8_t td_link_channel(const td_link *link);
TD_API const uint8_t *td_link_session(const td_link *link); /* of the client's hello */

/* To be sent as soon as may be. Refused: not open; a kind above TD_LINK_KIND_MAX; more than unsent_max waits,
 * which closes the link unless `may_drop`: then this one is left out. */
TD_API td_status td_link_send(td_link *link, uint8_t kind, const void *payload, size_t size, bool may_drop,
                              td_error *error);
TD_API size_t td_link_unsent(const td_link *link);

typedef struct td_link_frame {
    uint8_t kind;
    const uint8_t *payload; /* lent until the next td_link_next or td_link_poll */
    size_t size;
} td_link_frame;
/* The next one that has come; false: none. */
TD_API bool td_link_next(td_link_frame *frame, td_link *link);
/* Another timeout than that of the options, once it is known what the link is for. */
TD_API void td_link_set_timeout(td_link *link, double timeout_s);
TD_API void td_link_close(td_link *link, const char *why); /* at once; what waits is lost */

typedef struct td_link_measure {
    uint64_t pings, answers, late; /* late: after more than a period */
    double round_trip_s;           /* the last */
    double mean_s, most_s;
    double unanswered_s; /* age of the oldest ping without an answer; 0: none */
    uint64_t frames_in, frames_out, bytes_in, bytes_out;
    uint64_t retransmitted; /* segments that TCP sent again: what was lost on the way */
} td_link_measure;
TD_API td_link_measure td_link_measure_of(const td_link *link, double now_s);

/* Without a socket, for another transport and for tests: HELLO at once. What comes is given to td_link_take;
 * td_link_poll pings and judges; what is to go lies in td_link_give until td_link_gave. `server`: of which
 * side. */
TD_API td_status td_link_new(td_link **link, bool server, const td_link_options *options, double now_s,
                             td_error *error);
TD_API void td_link_take(td_link *link, const void *bytes, size_t size, double now_s);
TD_API const uint8_t *td_link_give(const td_link *link, size_t *size);
TD_API void td_link_gave(td_link *link, size_t size);

#ifdef __cplusplus
}
#endif
#endif
