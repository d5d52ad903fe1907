/* What goes out to those who watch, and how much of it each has had.
 *
 * A message is kept once, for all who are still to have it. A channel keeps its newest messages: one where
 * only the newest counts (depth 1), more where each does. A watcher that is slow, or reads nothing, skips
 * what is no longer kept; it costs no memory but the one message it is in the middle of, and nobody waits for
 * it. Answers to a watcher's own requests wait in its own short queue. One thread uses all of it. */
#ifndef TELEDIMOS_APPS_PANEL_HUB_H
#define TELEDIMOS_APPS_PANEL_HUB_H

#include "apps/panel_protocol.h"

enum { PANEL_MAX_CHANNELS = 32, PANEL_MAX_SUBSCRIPTIONS = 64, PANEL_MAX_REPLIES = 256 };

typedef struct panel_frame {
    int holders;
    uint64_t time_ns;
    size_t size;
    char *data;
} panel_frame;

typedef struct panel_channel {
    size_t depth;
    panel_frame **kept; /* (depth): number n at n % depth; NULL: none */
    uint64_t next;      /* number of the next message */
} panel_channel;

typedef struct panel_hub {
    size_t count;
    panel_channel channel[PANEL_MAX_CHANNELS];
    uint64_t time_ns, ticks; /* the clock that watchers are told, and how often it was set */
} panel_hub;

/* Returns its index; -1: out of memory or of channels. */
int panel_hub_add(panel_hub *hub, size_t depth);
void panel_hub_free(panel_hub *hub);
/* `data` is taken. False: out of memory. */
bool panel_hub_publish(panel_hub *hub, int channel, uint64_t time_ns, char *data, size_t size);
void panel_hub_clock(panel_hub *hub, uint64_t time_ns);

typedef struct panel_reply {
    struct panel_reply *next;
    panel_bytes bytes;
} panel_reply;

/* One watcher's. Begins zeroed. */
typedef struct panel_outbox {
    size_t count;
    struct {
        uint32_t id;
        int channel;
        uint64_t next; /* number of the message it is to have next */
    } subscription[PANEL_MAX_SUBSCRIPTIONS];
    size_t turn;
    uint64_t ticks;
    panel_reply *first, *last;
    size_t replies;
    /* In the middle of: one of these; and how much of it, with its head, was given. */
    panel_frame *frame;
    panel_reply *reply;
    unsigned char head[PANEL_MESSAGE_HEAD];
    size_t head_size, given;
    uint64_t sent, skipped; /* messages of channels */
} panel_outbox;

void panel_outbox_free(panel_outbox *box);
/* The channel's newest message is the first it gets. False: too many, or the id is in use. */
bool panel_subscribe(panel_outbox *box, const panel_hub *hub, uint32_t id, int channel);
bool panel_unsubscribe(panel_outbox *box, uint32_t id);
/* The bytes are taken. False: too many wait already. */
bool panel_reply_add(panel_outbox *box, panel_bytes bytes);

bool panel_outbox_has(const panel_outbox *box, const panel_hub *hub);
/* The next bytes to be sent, at most `room` (more than a head); 0: none. *first, *last: of their message. */
size_t panel_outbox_give(panel_outbox *box, const panel_hub *hub, unsigned char *bytes, size_t room,
                         bool *first, bool *last, bool *binary);
/* The same in WebSocket frames, as many as half of `room` (at least PANEL_MESSAGE_HEAD and 100 bytes) takes:
 * only a message longer than the rest is parted. Their bytes; 0: nothing is new. */
size_t panel_outbox_frames(panel_outbox *box, const panel_hub *hub, unsigned char *bytes, size_t room);

#endif
