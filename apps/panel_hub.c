#include "apps/panel_hub.h"

#include <stdlib.h>
#include <string.h>

/* Bytes: what a head with a length of 16 bits has, and tells. */
enum { FRAME_HEAD = 4, MOST_PAYLOAD = 65535 };

/* ---- messages ---- */

static void let_go(panel_frame **frame)
{
    if (*frame && --(*frame)->holders == 0) {
        free((*frame)->data);
        free(*frame);
    }
    *frame = NULL;
}

int panel_hub_add(panel_hub *hub, size_t depth)
{
    if (hub->count == PANEL_MAX_CHANNELS) return -1;
    panel_channel *c = hub->channel + hub->count;
    *c = (panel_channel){.depth = depth, .kept = calloc(depth, sizeof *c->kept)};
    return c->kept ? (int)hub->count++ : -1;
}

void panel_hub_free(panel_hub *hub)
{
    for (size_t i = 0; i < hub->count; i++) {
        for (size_t k = 0; k < hub->channel[i].depth; k++) let_go(hub->channel[i].kept + k);
        free(hub->channel[i].kept);
    }
    *hub = (panel_hub){0};
}

bool panel_hub_publish(panel_hub *hub, int channel, uint64_t time_ns, char *data, size_t size)
{
    panel_channel *c = hub->channel + channel;
    panel_frame *f = malloc(sizeof *f);
    if (!f) {
        free(data);
        return false;
    }
    *f = (panel_frame){.holders = 1, .time_ns = time_ns, .size = size, .data = data};
    panel_frame **place = c->kept + c->next % c->depth;
    let_go(place);
    *place = f;
    c->next++;
    return true;
}

void panel_hub_clock(panel_hub *hub, uint64_t time_ns)
{
    hub->time_ns = time_ns;
    hub->ticks++;
}

/* ---- a watcher ---- */

static void reply_free(panel_reply **reply)
{
    if (*reply) free((*reply)->bytes.data);
    free(*reply);
    *reply = NULL;
}

void panel_outbox_free(panel_outbox *box)
{
    let_go(&box->frame);
    reply_free(&box->reply);
    while (box->first) {
        panel_reply *next = box->first->next;
        reply_free(&box->first);
        box->first = next;
    }
    *box = (panel_outbox){0};
}

bool panel_subscribe(panel_outbox *box, const panel_hub *hub, uint32_t id, int channel)
{
    for (size_t i = 0; i < box->count; i++)
        if (box->subscription[i].id == id) return false;
    if (box->count == PANEL_MAX_SUBSCRIPTIONS) return false;
    const uint64_t next = hub->channel[channel].next;
    box->subscription[box->count].id = id;
    box->subscription[box->count].channel = channel;
    box->subscription[box->count++].next = next ? next - 1 : 0;
    return true;
}

bool panel_unsubscribe(panel_outbox *box, uint32_t id)
{
    for (size_t i = 0; i < box->count; i++) {
        if (box->subscription[i].id != id) continue;
        box->subscription[i] = box->subscription[--box->count];
        return true;
    }
    return false;
}

bool panel_reply_add(panel_outbox *box, panel_bytes bytes)
{
    panel_reply *r = bytes.data && box->replies < PANEL_MAX_REPLIES ? malloc(sizeof *r) : NULL;
    if (!r) {
        free(bytes.data);
        return false;
    }
    *r = (panel_reply){.bytes = bytes};
    if (box->last)
        box->last->next = r;
    else
        box->first = r;
    box->last = r;
    box->replies++;
    return true;
}

bool panel_outbox_has(const panel_outbox *box, const panel_hub *hub)
{
    if (box->frame || box->reply || box->first) return true;
    if (box->count > 0 && box->ticks != hub->ticks) return true;
    for (size_t i = 0; i < box->count; i++)
        if (box->subscription[i].next < hub->channel[box->subscription[i].channel].next) return true;
    return false;
}

/* The next channel in turn that has something new: its oldest that is kept. */
static bool begin_frame(panel_outbox *box, const panel_hub *hub)
{
    for (size_t k = 0; k < box->count; k++) {
        const size_t i = (box->turn + k) % box->count;
        const panel_channel *c = hub->channel + box->subscription[i].channel;
        uint64_t *next = &box->subscription[i].next;
        if (*next >= c->next) continue;
        const uint64_t oldest = c->next > c->depth ? c->next - c->depth : 0;
        if (*next < oldest) box->skipped += oldest - *next, *next = oldest;
        box->frame = c->kept[(*next)++ % c->depth];
        box->frame->holders++;
        box->sent++;
        box->turn = i + 1;
        panel_message_head(box->head, box->subscription[i].id, box->frame->time_ns);
        box->head_size = PANEL_MESSAGE_HEAD;
        return true;
    }
    return false;
}

/* What is to be sent after what was: an answer, the clock, a message. */
static bool begin_next(panel_outbox *box, const panel_hub *hub)
{
    box->given = box->head_size = 0;
    if (box->first) {
        box->reply = box->first;
        box->first = box->first->next;
        if (!box->first) box->last = NULL;
        box->replies--;
        return true;
    }
    if (box->count > 0 && box->ticks != hub->ticks) {
        box->ticks = hub->ticks;
        panel_time(box->head, hub->time_ns);
        box->head_size = PANEL_TIME_SIZE;
        return true;
    }
    return begin_frame(box, hub);
}

size_t panel_outbox_give(panel_outbox *box, const panel_hub *hub, unsigned char *bytes, size_t room,
                         bool *first, bool *last, bool *binary)
{
    *first = !box->frame && !box->reply;
    if (*first && !begin_next(box, hub)) return 0;
    const size_t size = box->frame ? box->frame->size : box->reply ? box->reply->bytes.size : 0;
    const void *data = box->frame   ? (const void *)box->frame->data
                       : box->reply ? box->reply->bytes.data
                                    : NULL;
    size_t put = 0;
    if (box->given < box->head_size) {
        memcpy(bytes, box->head, box->head_size);
        put = box->head_size;
        box->given = put;
    }
    const size_t from = box->given - box->head_size, left = size - from,
                 now = left < room - put ? left : room - put;
    if (now > 0) memcpy(bytes + put, (const char *)data + from, now);
    box->given += now;
    *binary = !box->reply || box->reply->bytes.binary;
    *last = now == left;
    if (*last) {
        let_go(&box->frame);
        reply_free(&box->reply);
    }
    return put + now;
}

/* RFC 6455, 5.2: the head in front of its payload, which lies FRAME_HEAD behind; the frame's size. */
static size_t set_head(unsigned char *bytes, size_t size, bool first, bool last, bool binary)
{
    bytes[0] = (unsigned char)((last ? 0x80 : 0) | (!first ? 0 : binary ? 2 : 1));
    if (size < 126) {
        bytes[1] = (unsigned char)size;
        memmove(bytes + 2, bytes + FRAME_HEAD, size);
        return 2 + size;
    }
    bytes[1] = 126;
    bytes[2] = (unsigned char)(size >> 8);
    bytes[3] = (unsigned char)(size & 255);
    return FRAME_HEAD + size;
}

size_t panel_outbox_frames(panel_outbox *box, const panel_hub *hub, unsigned char *bytes, size_t room)
{
    bool first, last, binary;
    size_t used = 0;
    while (used < room / 2) {
        unsigned char *at = bytes + used;
        const size_t left = room - FRAME_HEAD - used < MOST_PAYLOAD ? room - FRAME_HEAD - used : MOST_PAYLOAD;
        const size_t size = panel_outbox_give(box, hub, at + FRAME_HEAD, left, &first, &last, &binary);
        if (size == 0) break;
        used += set_head(at, size, first, last, binary);
    }
    return used;
}
