#include "core/link.h"

#include <math.h>
#include <openssl/crypto.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <openssl/rand.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/file.h"
#include "core/link_internal.h"

enum { PING = 255, PONG = 254, FAREWELL = 253 };
static const char MAGIC[4] = {'T', 'D', 'L', 'K'};
static const double MOST_WAIT = 4; /* frames that nobody takes: so many times frame_max */

td_link_options td_link_options_default(void)
{
    return (td_link_options){.period_s = 0.1,
                             .timeout_s = 0.3,
                             .handshake_s = 2,
                             .frame_max = (size_t)256 << 10,
                             .unsent_max = (size_t)1 << 20,
                             .frames_per_s = 1000,
                             .bytes_per_s = 4 << 20};
}

td_status td_link_token_read(uint8_t token[TD_LINK_TOKEN_MAX], size_t *size, const char *path,
                             td_error *error)
{
    struct stat about;
    char *bytes = NULL;
    *size = 0;
    if (stat(path, &about) == 0 && (about.st_mode & (S_IRWXG | S_IRWXO)))
        return td_fail(error, TD_ERROR_DATA, "%s: others may read this token: chmod 600 it", path);
    size_t length = 0;
    TD_TRY(td_file_read(&bytes, &length, path, (size_t)2 * TD_LINK_TOKEN_MAX, error));
    while (length && (bytes[length - 1] == '\n' || bytes[length - 1] == '\r')) length--;
    const bool fits = length >= TD_LINK_TOKEN_MIN && length <= TD_LINK_TOKEN_MAX;
    if (fits) memcpy(token, bytes, *size = length);
    OPENSSL_cleanse(bytes, length);
    free(bytes);
    if (fits) return TD_OK;
    return td_fail(error, TD_ERROR_DATA,
                   "%s: a token has %d to %d bytes, this one %zu: openssl rand -hex 32 makes one", path,
                   TD_LINK_TOKEN_MIN, TD_LINK_TOKEN_MAX, length);
}

/* ---- bytes ---- */

bool link_bytes_add(link_bytes *b, const void *bytes, size_t size)
{
    if (size == 0) return true;
    if (b->first && b->first + b->used + size > b->room) {
        memmove(b->data, b->data + b->first, b->used);
        b->first = 0;
    }
    if (b->used + size > b->room) {
        const size_t room = 2 * (b->used + size);
        uint8_t *more = realloc(b->data, room);
        if (!more) return false;
        b->data = more;
        b->room = room;
    }
    memcpy(b->data + b->first + b->used, bytes, size);
    b->used += size;
    return true;
}

void link_bytes_drop(link_bytes *b, size_t size)
{
    b->first += size;
    b->used -= size;
    if (b->used == 0) b->first = 0;
}

static void put(uint8_t *at, uint64_t value, int size)
{
    for (int i = 0; i < size; i++) at[i] = (uint8_t)(value >> (8 * (size - 1 - i)));
}

static uint64_t get(const uint8_t *at, int size)
{
    uint64_t value = 0;
    for (int i = 0; i < size; i++) value = value << 8 | at[i];
    return value;
}

/* ---- the end ---- */

void link_fail(td_link *link, const char *format, ...)
{
    va_list list;
    if (link->state == TD_LINK_CLOSED) return;
    va_start(list, format);
    vsnprintf(link->why, sizeof link->why, format, list);
    va_end(list);
    link->state = TD_LINK_CLOSED;
}

void td_link_close(td_link *link, const char *why)
{
    link_fail(link, "%s", why);
}

void td_link_set_timeout(td_link *link, double timeout_s)
{
    link->o.timeout_s = timeout_s;
}

void link_write(td_link *link, const void *bytes, size_t size)
{
    if (link->state == TD_LINK_CLOSED) return;
    if (link->tls)
        link_tls_write(link, bytes, size);
    else if (!link_bytes_add(&link->out, bytes, size))
        link_fail(link, "no memory for a link");
}

/* ---- who is there ---- */

/* HMAC(token; text, both hellos, binding). */
static bool derive(uint8_t out[32], const td_link *link, const char *text)
{
    uint8_t all[64 + 2 * TD_LINK_HELLO_SIZE + 32];
    const size_t head = strlen(text);
    unsigned length = 0;
    memcpy(all, text, head);
    memcpy(all + head, link->hello, sizeof link->hello);
    memcpy(all + head + sizeof link->hello, link->binding, sizeof link->binding);
    return HMAC(EVP_sha256(), link->token, (int)link->o.token_size, all,
                head + sizeof link->hello + sizeof link->binding, out, &length) &&
           length == 32;
}

static bool prove(uint8_t proof[32], const td_link *link, bool server)
{
    return derive(proof, link, server ? "teledimos server proof" : "teledimos client proof");
}

void link_say_hello(td_link *link)
{
    uint8_t *mine = link->hello[link->server], *at = mine;
    memcpy(at, MAGIC, sizeof MAGIC);
    put(at + 4, TD_LINK_VERSION, 2);
    at[6] = link->server;
    at[7] = link->o.channel;
    memcpy(at + 8, link->o.session, TD_LINK_SESSION_SIZE);
    if (RAND_bytes(at + 24, 32) != 1) {
        link_fail(link, "OpenSSL gives no random numbers");
        return;
    }
    link->state = TD_LINK_HELLO;
    if (!link->server) link_write(link, mine, TD_LINK_HELLO_SIZE);
}

static void send_proof(td_link *link)
{
    uint8_t proof[LINK_PROOF_SIZE];
    if (!prove(proof, link, link->server) || !derive(link->key[0], link, "teledimos client frames") ||
        !derive(link->key[1], link, "teledimos server frames")) {
        link_fail(link, "OpenSSL's libcrypto offers no HMAC here");
        return;
    }
    link_write(link, proof, sizeof proof);
}

static void take_hello(td_link *link)
{
    const uint8_t *at = link->in.data + link->in.first;
    if (memcmp(at, MAGIC, sizeof MAGIC) != 0) {
        link_fail(link, "what came is no hello of this protocol%s",
                  link->o.tls ? "" : "; does one side speak TLS and the other not?");
        return;
    }
    const unsigned version = (unsigned)get(at + 4, 2);
    memcpy(link->hello[!link->server], at, TD_LINK_HELLO_SIZE);
    link_bytes_drop(&link->in, TD_LINK_HELLO_SIZE);
    const uint8_t *theirs = link->hello[!link->server];
    if (link->server && link->o.any_channel) link->o.channel = link->hello[1][7] = theirs[7];
    if (link->server) link_write(link, link->hello[1], TD_LINK_HELLO_SIZE);
    if (version != TD_LINK_VERSION)
        link_fail(link, "the other end speaks version %u of the link, this one %d: use the same release",
                  version, TD_LINK_VERSION);
    else if (theirs[6] != !link->server)
        link_fail(link, "the other end is a %s too", link->server ? "server" : "client");
    else if (theirs[7] != link->o.channel)
        link_fail(link, "the other end means channel %u, this one %u", theirs[7], link->o.channel);
    if (link->state == TD_LINK_CLOSED) return;
    link->state = TD_LINK_PROOF;
    if (!link->server) send_proof(link);
}

static void take_proof(td_link *link, double now_s)
{
    uint8_t right[LINK_PROOF_SIZE];
    const bool made = prove(right, link, !link->server);
    const bool same = made && CRYPTO_memcmp(right, link->in.data + link->in.first, LINK_PROOF_SIZE) == 0;
    link_bytes_drop(&link->in, LINK_PROOF_SIZE);
    if (!same) {
        link_fail(link, "the other end does not hold the token");
        return;
    }
    if (link->server) send_proof(link);
    if (link->state == TD_LINK_CLOSED) return;
    link->state = TD_LINK_OPEN;
    link->filled_s = now_s;
    link->frames_left = link->o.frames_per_s;
    link->bytes_left = link->o.bytes_per_s;
    link->ping_s = -INFINITY;
}

/* ---- frames ---- */

static bool tag(uint8_t out[32], const uint8_t key[32], const uint8_t *bytes, size_t size)
{
    unsigned length = 0;
    return HMAC(EVP_sha256(), key, 32, bytes, size, out, &length) && length == 32;
}

static void write_frame(td_link *link, uint8_t kind, const void *payload, size_t size)
{
    const size_t whole = LINK_HEAD_SIZE + size + LINK_TAG_SIZE;
    uint8_t small[256], full[32], *frame = whole <= sizeof small ? small : malloc(whole);
    if (!frame) {
        link_fail(link, "no memory for a frame");
        return;
    }
    put(frame, size, 4);
    frame[4] = TD_LINK_VERSION;
    frame[5] = kind;
    put(frame + 6, link->sent++, 8);
    if (size) memcpy(frame + LINK_HEAD_SIZE, payload, size);
    if (tag(full, link->key[link->server], frame, LINK_HEAD_SIZE + size)) {
        memcpy(frame + LINK_HEAD_SIZE + size, full, LINK_TAG_SIZE);
        link_write(link, frame, whole);
        link->measure.frames_out++;
    } else {
        link_fail(link, "OpenSSL's libcrypto offers no HMAC here");
    }
    if (frame != small) free(frame);
}

td_status td_link_send(td_link *link, uint8_t kind, const void *payload, size_t size, bool may_drop,
                       td_error *error)
{
    if (link->state != TD_LINK_OPEN)
        return td_fail(error, TD_ERROR_IO, "the link is not open%s%s", link->why[0] ? ": " : "", link->why);
    if (kind > TD_LINK_KIND_MAX || size > UINT32_MAX / 2)
        return td_fail(error, TD_ERROR_ARGUMENT, "a frame of kind %d, %zu bytes cannot be sent", kind, size);
    if (link->out.used + size + TD_LINK_OVERHEAD > link->o.unsent_max) {
        if (may_drop) return TD_OK;
        link_fail(link, "the other end does not read: %zu bytes wait to be sent", link->out.used);
        return td_fail(error, TD_ERROR_IO, "%s", link->why);
    }
    write_frame(link, kind, payload, size);
    return link->state == TD_LINK_OPEN ? TD_OK : td_fail(error, TD_ERROR_IO, "%s", link->why);
}

static void take_pong(td_link *link, const uint8_t *payload, double now_s)
{
    td_link_measure *m = &link->measure;
    if (get(payload, 8) != m->answers || m->answers == m->pings) {
        link_fail(link, "a ping was answered that was not sent");
        return;
    }
    m->round_trip_s = now_s - link->stamp_s[m->answers % LINK_PINGS];
    link->sum_s += m->round_trip_s;
    m->most_s = fmax(m->most_s, m->round_trip_s);
    m->answers++;
    m->mean_s = link->sum_s / (double)m->answers;
    if (m->round_trip_s > link->o.period_s) m->late++;
}

static void keep_frame(td_link *link, const uint8_t *frame, size_t size)
{
    if ((double)(link->ready.used + size) > MOST_WAIT * (double)(link->o.frame_max + TD_LINK_OVERHEAD))
        link_fail(link, "more frames came than were taken");
    else if (!link_bytes_add(&link->ready, frame, LINK_HEAD_SIZE + size))
        link_fail(link, "no memory for a frame");
}

static void take_frame(td_link *link, const uint8_t *frame, size_t size, double now_s)
{
    const uint8_t kind = frame[5];
    uint8_t full[32];
    const bool made = tag(full, link->key[!link->server], frame, LINK_HEAD_SIZE + size);
    if (!made || CRYPTO_memcmp(full, frame + LINK_HEAD_SIZE + size, LINK_TAG_SIZE) != 0) {
        link_fail(link, "a frame's tag is wrong: it was changed on its way, or is of another link");
        return;
    }
    if (frame[4] != TD_LINK_VERSION) {
        link_fail(link, "a frame of version %u came", frame[4]);
        return;
    }
    const uint64_t sequence = get(frame + 6, 8);
    if (sequence != link->received) {
        link_fail(link, "frame %llu came where %llu was due: it was sent again, or one is missing",
                  (unsigned long long)sequence, (unsigned long long)link->received);
        return;
    }
    link->received++;
    link->measure.frames_in++;
    if (kind == PING && size == 8)
        write_frame(link, PONG, frame + LINK_HEAD_SIZE, 8);
    else if (kind == PONG && size == 8)
        take_pong(link, frame + LINK_HEAD_SIZE, now_s);
    else if (kind == FAREWELL && size == 0)
        link->left = true, link_fail(link, "the other end said farewell");
    else if (kind <= TD_LINK_KIND_MAX)
        keep_frame(link, frame, size);
    else
        link_fail(link, "a frame of an unknown kind came (%u)", kind);
}

static bool allow(td_link *link, size_t size, double now_s)
{
    const td_link_options *o = &link->o;
    const double passed = fmax(0, now_s - link->filled_s);
    link->filled_s = now_s;
    link->frames_left = fmin(o->frames_per_s, link->frames_left + passed * o->frames_per_s) - 1;
    link->bytes_left =
        fmin(o->bytes_per_s, link->bytes_left + passed * o->bytes_per_s) - (double)(size + TD_LINK_OVERHEAD);
    if (link->frames_left < 0)
        link_fail(link, "more than %g frames a second came", o->frames_per_s);
    else if (link->bytes_left < 0)
        link_fail(link, "more than %g bytes a second came", o->bytes_per_s);
    return link->state != TD_LINK_CLOSED;
}

/* Whether a whole one was there. */
static bool next_in(td_link *link, double now_s)
{
    const link_bytes *in = &link->in;
    if (link->state == TD_LINK_HELLO) {
        if (in->used >= 4 && memcmp(in->data + in->first, MAGIC, 4) != 0) {
            take_hello(link); /* garbage: no need to wait for more of it */
            return false;
        }
        if (in->used < TD_LINK_HELLO_SIZE) return false;
        take_hello(link);
        return true;
    }
    if (link->state == TD_LINK_PROOF) {
        if (in->used < LINK_PROOF_SIZE) return false;
        take_proof(link, now_s);
        return true;
    }
    if (link->state != TD_LINK_OPEN || in->used < LINK_HEAD_SIZE) return false;
    const size_t size = (size_t)get(in->data + in->first, 4);
    if (size > link->o.frame_max) {
        link_fail(link, "a frame of %zu bytes came, above the %zu allowed", size, link->o.frame_max);
        return false;
    }
    const size_t whole = LINK_HEAD_SIZE + size + LINK_TAG_SIZE;
    if (in->used < whole) return false;
    if (!allow(link, size, now_s)) return false;
    take_frame(link, in->data + in->first, size, now_s);
    link_bytes_drop(&link->in, whole);
    return true;
}

bool td_link_next(td_link_frame *frame, td_link *link)
{
    link_bytes_drop(&link->ready, link->lent);
    link->lent = 0;
    if (link->ready.used == 0) return false;
    const uint8_t *at = link->ready.data + link->ready.first;
    *frame = (td_link_frame){at[5], at + LINK_HEAD_SIZE, (size_t)get(at, 4)};
    link->lent = LINK_HEAD_SIZE + frame->size;
    return true;
}

/* ---- time ---- */

static void ping(td_link *link, double now_s)
{
    td_link_measure *m = &link->measure;
    uint8_t number[8];
    if (now_s - link->ping_s < link->o.period_s / 2 - 1e-6 || m->pings - m->answers == LINK_PINGS) return;
    link->ping_s = now_s;
    link->stamp_s[m->pings % LINK_PINGS] = now_s;
    put(number, m->pings++, 8);
    write_frame(link, PING, number, sizeof number);
}

static double unanswered(const td_link *link, double now_s)
{
    const td_link_measure *m = &link->measure;
    return m->pings == m->answers ? 0 : now_s - link->stamp_s[m->answers % LINK_PINGS];
}

static void judge_time(td_link *link, double now_s)
{
    if (link->state < TD_LINK_OPEN && now_s - link->begun_s > link->o.handshake_s)
        link_fail(link, "no link after %g s: the other end is silent, or too slow", link->o.handshake_s);
    if (link->state != TD_LINK_OPEN) return;
    if (unanswered(link, now_s) > link->o.timeout_s)
        link_fail(link, "no answer for %.3f s, more than the %g s allowed", unanswered(link, now_s),
                  link->o.timeout_s);
    else if (now_s - link->part_s > link->o.timeout_s)
        link_fail(link, "a frame came too slowly: it is incomplete for more than %g s", link->o.timeout_s);
}

void link_look(td_link *link, double now_s)
{
    bool came = false;
    while (next_in(link, now_s)) came = true;
    if (link->in.used == 0)
        link->part_s = NAN;
    else if (came || isnan(link->part_s))
        link->part_s = now_s;
}

void link_judge(td_link *link, double now_s)
{
    judge_time(link, now_s);
    if (link->state == TD_LINK_OPEN) ping(link, now_s);
}

void link_farewell(td_link *link)
{
    if (link->state == TD_LINK_OPEN) write_frame(link, FAREWELL, NULL, 0);
}

/* ---- made, given, taken ---- */

static td_status check(const td_link_options *o, td_error *error)
{
    if (!o->token || o->token_size < TD_LINK_TOKEN_MIN || o->token_size > TD_LINK_TOKEN_MAX)
        return td_fail(error, TD_ERROR_ARGUMENT, "a link needs a token of %d to %d bytes", TD_LINK_TOKEN_MIN,
                       TD_LINK_TOKEN_MAX);
    if (!(o->period_s > 0) || !(o->timeout_s > o->period_s) || !(o->handshake_s > 0))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "period_s, timeout_s, handshake_s: positive, and the timeout longer than the period");
    if (!(o->frames_per_s >= 1) || !(o->bytes_per_s >= 1) || o->frame_max > (size_t)1 << 30)
        return td_fail(error, TD_ERROR_ARGUMENT, "frames_per_s, bytes_per_s, frame_max are out of range");
    return TD_OK;
}

td_status link_begin(td_link **out, bool server, const td_link_options *options, double now_s,
                     td_error *error)
{
    *out = NULL;
    TD_TRY(check(options, error));
    td_link *link = calloc(1, sizeof *link);
    if (!link) return td_fail(error, TD_ERROR_MEMORY, "no memory for a link");
    link->o = *options;
    memcpy(link->token, options->token, options->token_size);
    link->o.token = NULL;
    link->server = server;
    link->fd = -1;
    link->begun_s = now_s;
    link->part_s = NAN;
    *out = link;
    return TD_OK;
}

td_status td_link_new(td_link **link, bool server, const td_link_options *options, double now_s,
                      td_error *error)
{
    TD_TRY(link_begin(link, server, options, now_s, error));
    link_say_hello(*link);
    return TD_OK;
}

void td_link_take(td_link *link, const void *bytes, size_t size, double now_s)
{
    if (link->state == TD_LINK_CLOSED) return;
    link->measure.bytes_in += size;
    if (link->tls)
        link_tls_take(link, bytes, size);
    else if (!link_bytes_add(&link->in, bytes, size))
        link_fail(link, "no memory for a link");
    link_look(link, now_s);
}

const uint8_t *td_link_give(const td_link *link, size_t *size)
{
    *size = link->out.used;
    return link->out.data ? link->out.data + link->out.first : NULL;
}

void td_link_gave(td_link *link, size_t size)
{
    link->measure.bytes_out += size;
    link_bytes_drop(&link->out, size);
}

/* ---- what it is ---- */

td_link_state td_link_state_of(const td_link *link)
{
    return link->state;
}

const char *td_link_why(const td_link *link, bool *left)
{
    if (left) *left = link->left;
    return link->why;
}

const char *td_link_peer(const td_link *link)
{
    return link->peer;
}

uint8_t td_link_channel(const td_link *link)
{
    return link->o.channel;
}

const uint8_t *td_link_session(const td_link *link)
{
    return link->hello[0] + 8;
}

size_t td_link_unsent(const td_link *link)
{
    return link->out.used;
}
