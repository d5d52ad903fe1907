/* The link, between its files: link.c speaks, link_tls.c is a filter of bytes, link_socket.c carries them. */
#ifndef TELEDIMOS_CORE_LINK_INTERNAL_H
#define TELEDIMOS_CORE_LINK_INTERNAL_H

#include "core/link.h"

enum { LINK_PROOF_SIZE = 32, LINK_TAG_SIZE = 16, LINK_HEAD_SIZE = 14, LINK_PINGS = 64 };

/* Bytes that come at the end and go at the beginning. */
typedef struct link_bytes {
    uint8_t *data;
    size_t first, used, room; /* used: from first on */
} link_bytes;
bool link_bytes_add(link_bytes *b, const void *bytes, size_t size); /* false: no memory */
void link_bytes_drop(link_bytes *b, size_t size);

struct ssl_st;
struct ssl_ctx_st;

struct td_link {
    td_link_options o;
    uint8_t token[TD_LINK_TOKEN_MAX];
    bool server, left;
    td_link_state state;
    char why[300], peer[80];
    int fd;             /* -1: no socket, or closed */
    bool connecting;    /* TCP is not there yet */
    struct ssl_st *tls; /* NULL: plain */
    uint8_t binding[32];
    uint8_t hello[2][TD_LINK_HELLO_SIZE]; /* the client's, the server's */
    uint8_t key[2][32];                   /* of frames: the client's, the server's */
    uint64_t sent, received;              /* sequence numbers */
    link_bytes in, out;                   /* plain; as it goes on the wire */
    link_bytes ready;                     /* frames taken apart: u32 size, kind, payload */
    size_t lent;                          /* of `ready`, dropped at the next look */
    double begun_s, part_s;               /* part_s: since when a frame is incomplete; NaN: none is */
    double frames_left, bytes_left, filled_s;
    double ping_s; /* of the last */
    double stamp_s[LINK_PINGS];
    double sum_s;
    td_link_measure measure;
};

td_status link_begin(td_link **link, bool server, const td_link_options *options, double now_s,
                     td_error *error);
/* TCP and TLS are there. */
void link_say_hello(td_link *link);
/* Takes apart what came. */
void link_look(td_link *link, double now_s);
/* Pings, and ends what takes too long: when all that came was looked at. */
void link_judge(td_link *link, double now_s);
void link_farewell(td_link *link);
/* Puts bytes on their way. */
void link_write(td_link *link, const void *bytes, size_t size);
void link_fail(td_link *link, const char *format, ...) TD_PRINTF(2, 3);

/* link_tls.c */
td_status link_tls_server(struct ssl_ctx_st **context, const td_link_options *o, td_error *error);
td_status link_tls_client(struct ssl_ctx_st **context, const td_link_options *o, td_error *error);
/* `host`: whose name the certificate must bear; NULL: any. */
td_status link_tls_begin(td_link *link, struct ssl_ctx_st *context, const char *host, td_error *error);
/* Bytes of the wire in; NULL: only the handshake goes on. */
void link_tls_take(td_link *link, const void *bytes, size_t size);
void link_tls_write(td_link *link, const void *bytes, size_t size);
void link_tls_end(td_link *link);
void link_tls_context_free(struct ssl_ctx_st **context);

#endif
