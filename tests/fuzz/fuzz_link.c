/* Any bytes from the other end of a link: no crash; never open without the token; nothing is taken from
 * frames whose tags are wrong; a closed link says why and stays closed; what is kept is bounded. The first
 * byte says who speaks: a stranger to a server or a client; one who holds the token, and has gone wrong then:
 * raw bytes after the opening, in pieces; or frames with right tags, of any kinds and payloads. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/link.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(bool fine)
{
    if (!fine) abort();
}

static td_link *made(bool server, double now_s)
{
    static const char token[] = "0123456789abcdef";
    td_link_options o = td_link_options_default();
    td_link *link = NULL;
    o.token = token;
    o.token_size = 16;
    o.frame_max = 1000;
    o.any_channel = server;
    must(td_link_new(&link, server, &o, now_s, NULL) == TD_OK);
    return link;
}

static void carry(td_link *from, td_link *to, double now_s)
{
    size_t size;
    const uint8_t *bytes = td_link_give(from, &size);
    td_link_take(to, bytes, size, now_s);
    td_link_gave(from, size);
}

static void check_closed(td_link *link)
{
    if (td_link_state_of(link) == TD_LINK_CLOSED) must(td_link_why(link, NULL)[0] != 0);
}

/* In pieces of up to 256 bytes, their sizes by the bytes. */
static void say(td_link *link, const uint8_t *data, size_t size, double *now_s)
{
    while (size) {
        size_t piece = (size_t)data[0] + 1;
        if (piece > size) piece = size;
        uint8_t *copy = malloc(piece); /* behind it nothing may be read */
        must(copy != NULL);
        memcpy(copy, data, piece);
        const bool was_closed = td_link_state_of(link) == TD_LINK_CLOSED;
        td_link_take(link, copy, piece, *now_s);
        *now_s += 0.01;
        td_link_poll(link, *now_s);
        must(!was_closed || td_link_state_of(link) == TD_LINK_CLOSED);
        free(copy);
        data += piece;
        size -= piece;
    }
}

static void with_the_token(const uint8_t *data, size_t size, bool raw)
{
    double now_s = 5;
    td_link *a = made(false, now_s), *b = made(true, now_s);
    td_link_frame f;
    for (int i = 0; i < 4; i++) carry(a, b, now_s), carry(b, a, now_s);
    must(td_link_state_of(a) == TD_LINK_OPEN && td_link_state_of(b) == TD_LINK_OPEN);
    if (raw) {
        say(b, data, size, &now_s);
        must(!td_link_next(&f, b)); /* no tag can have been right */
    }
    while (!raw && size >= 2) { /* kind, size, payload */
        const size_t length = data[1] < size - 2 ? data[1] : size - 2;
        const uint64_t before = td_link_measure_of(b, now_s).frames_in;
        const td_status status = td_link_send(a, data[0], data + 2, length, false, NULL);
        must(status == TD_OK || data[0] > TD_LINK_KIND_MAX || td_link_state_of(a) != TD_LINK_OPEN);
        carry(a, b, now_s);
        carry(b, a, now_s);
        now_s += 0.01;
        td_link_poll(a, now_s);
        td_link_poll(b, now_s);
        if (status == TD_OK && td_link_state_of(b) == TD_LINK_OPEN) {
            must(td_link_measure_of(b, now_s).frames_in > before && td_link_next(&f, b));
            must(f.kind == data[0] && f.size == length && memcmp(f.payload, data + 2, length) == 0);
        }
        data += 2 + length;
        size -= 2 + length;
    }
    check_closed(a);
    check_closed(b);
    td_link_free(&a);
    td_link_free(&b);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    double now_s = 5;
    td_link_frame f;
    if (size == 0) return 0;
    if (data[0] >= 128) {
        with_the_token(data + 1, size - 1, data[0] & 1);
        return 0;
    }
    td_link *link = made(data[0] & 1, now_s);
    say(link, data + 1, size - 1, &now_s);
    must(td_link_state_of(link) != TD_LINK_OPEN && !td_link_next(&f, link));
    check_closed(link);
    td_link_free(&link);
    return 0;
}
