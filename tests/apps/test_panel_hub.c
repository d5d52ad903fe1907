/* What watchers are given, against what the header says, counted out by hand: the newest of a state, every
 * one of the kept events, whole messages out of pieces, answers first, and no memory for one who does not
 * read; frames read by the letter of RFC 6455. Blind to: the sockets behind it (tests/apps/test_panel.py). */
#include "apps/panel_hub.h"
#include "tests/check.h"

static void publish(panel_hub *hub, int channel, uint64_t number)
{
    char *text = malloc(32);
    assert_non_null(text);
    snprintf(text, 32, "%llu", (unsigned long long)number);
    assert_true(panel_hub_publish(hub, channel, number, text, strlen(text)));
}

/* The next message, put together out of pieces of at most `room`; "": none. */
static size_t next(char *message, size_t size, panel_outbox *box, const panel_hub *hub, size_t room,
                   bool *binary)
{
    unsigned char piece[256];
    size_t whole = 0, pieces = 0;
    bool first, last = false;
    while (!last) {
        const size_t n = panel_outbox_give(box, hub, piece, room, &first, &last, binary);
        if (n == 0) {
            assert_int_equal(pieces, 0);
            break;
        }
        assert_true(n <= room && whole + n < size);
        assert_int_equal(first, pieces == 0);
        memcpy(message + whole, piece, n);
        whole += n;
        pieces++;
    }
    message[whole] = 0;
    return whole;
}

/* A channel's message of this number, on this subscription. */
static void gives(panel_outbox *box, const panel_hub *hub, uint32_t subscription, uint64_t number)
{
    char message[300];
    unsigned char head[PANEL_MESSAGE_HEAD];
    bool binary = false;
    const size_t size = next(message, sizeof message, box, hub, 100, &binary);
    if (size <= PANEL_MESSAGE_HEAD) fail_msg("nothing instead of %llu", (unsigned long long)number);
    panel_message_head(head, subscription, number);
    assert_memory_equal(message, head, sizeof head);
    assert_int_equal(strtoull(message + PANEL_MESSAGE_HEAD, NULL, 10), number);
    assert_true(binary);
}

static void gives_nothing(panel_outbox *box, const panel_hub *hub)
{
    char message[300];
    bool binary;
    assert_false(panel_outbox_has(box, hub));
    assert_int_equal(next(message, sizeof message, box, hub, 100, &binary), 0);
}

static void states_and_events(void **state)
{
    panel_hub hub = {0};
    panel_outbox box = {0};
    (void)state;
    const int newest = panel_hub_add(&hub, 1), events = panel_hub_add(&hub, 4);
    publish(&hub, newest, 100);
    assert_true(panel_subscribe(&box, &hub, 7, newest));
    assert_true(panel_subscribe(&box, &hub, 8, events));
    assert_false(panel_subscribe(&box, &hub, 7, events));
    gives(&box, &hub, 7, 100); /* what was there before it came */
    gives_nothing(&box, &hub);
    for (uint64_t i = 1; i <= 3; i++) publish(&hub, newest, i), publish(&hub, events, 10 + i);
    gives(&box, &hub, 8, 11); /* in turn */
    gives(&box, &hub, 7, 3);
    gives(&box, &hub, 8, 12);
    gives(&box, &hub, 8, 13);
    gives_nothing(&box, &hub);
    assert_int_equal(box.skipped, 2);
    for (uint64_t i = 0; i < 10; i++) publish(&hub, events, 20 + i);
    for (uint64_t i = 6; i < 10; i++) gives(&box, &hub, 8, 20 + i);
    assert_int_equal(box.skipped, 2 + 6);
    assert_true(panel_unsubscribe(&box, 7));
    assert_false(panel_unsubscribe(&box, 7));
    publish(&hub, newest, 4);
    gives_nothing(&box, &hub);
    panel_outbox_free(&box);
    panel_hub_free(&hub);
}

static void pieces_and_answers(void **state)
{
    panel_hub hub = {0};
    panel_outbox box = {0};
    unsigned char piece[64];
    char text[300];
    bool first, last, binary;
    (void)state;
    const int channel = panel_hub_add(&hub, 1);
    char *large = malloc(200);
    assert_non_null(large);
    for (int i = 0; i < 200; i++) large[i] = (char)('a' + i % 26);
    assert_true(panel_subscribe(&box, &hub, 1, channel));
    assert_true(panel_hub_publish(&hub, channel, 5, large, 200));
    assert_int_equal(panel_outbox_give(&box, &hub, piece, 64, &first, &last, &binary), 64);
    assert_true(first && !last);
    /* What comes in the middle waits; the message goes on as it began, though it is no longer the newest. */
    panel_hub_clock(&hub, 9);
    publish(&hub, channel, 6);
    assert_true(panel_reply_add(&box, panel_status(PANEL_INFO, "hello")));
    size_t whole = 64;
    memcpy(text, piece, 64);
    while (!last) {
        const size_t n = panel_outbox_give(&box, &hub, piece, 64, &first, &last, &binary);
        assert_false(first);
        memcpy(text + whole, piece, n);
        whole += n;
    }
    assert_int_equal(whole, PANEL_MESSAGE_HEAD + 200);
    for (int i = 0; i < 200; i++) assert_int_equal(text[PANEL_MESSAGE_HEAD + i], 'a' + i % 26);
    next(text, sizeof text, &box, &hub, 64, &binary);
    assert_false(binary);
    assert_non_null(strstr(text, "hello"));
    assert_int_equal(next(text, sizeof text, &box, &hub, 64, &binary), PANEL_TIME_SIZE);
    assert_int_equal(text[0], 2);
    gives(&box, &hub, 1, 6);
    gives_nothing(&box, &hub);
    for (int i = 0; i < PANEL_MAX_REPLIES; i++)
        assert_true(panel_reply_add(&box, panel_status(PANEL_INFO, "x")));
    assert_false(panel_reply_add(&box, panel_status(PANEL_INFO, "x")));
    panel_outbox_free(&box);
    panel_hub_free(&hub);
}

/* One who stopped reading in the middle holds that message and no other. */
static void one_who_does_not_read(void **state)
{
    panel_hub hub = {0};
    panel_outbox box = {0};
    unsigned char piece[14];
    bool first, last, binary;
    (void)state;
    const int channel = panel_hub_add(&hub, 8);
    assert_true(panel_subscribe(&box, &hub, 1, channel));
    publish(&hub, channel, 123456);
    assert_int_equal(panel_outbox_give(&box, &hub, piece, sizeof piece, &first, &last, &binary), 14);
    assert_false(last);
    for (uint64_t i = 0; i < 1000; i++) publish(&hub, channel, i);
    assert_int_equal(box.frame->holders, 1);
    assert_int_equal(box.replies, 0);
    panel_outbox_free(&box);
    panel_hub_free(&hub);
}

/* A frame as RFC 6455, 5.2 has it, not masked; the bytes it takes. */
static size_t read_frame(const unsigned char *bytes, size_t size, bool *last, int *opcode, size_t *payload)
{
    assert_true(size >= 2);
    assert_int_equal(bytes[0] & 0x70, 0);
    assert_int_equal(bytes[1] & 0x80, 0);
    *last = bytes[0] >> 7;
    *opcode = bytes[0] & 15;
    *payload = bytes[1];
    if (*payload < 126) return 2;
    assert_int_equal(*payload, 126);
    *payload = (size_t)bytes[2] << 8 | bytes[3];
    assert_true(*payload >= 126); /* the shortest form */
    return 4;
}

/* Messages of all lengths about those at which the form changes, and longer than a piece and than a frame may
 * be: put together from the frames they are what was published, whatever the piece's room. */
static void frames(void **state)
{
    static const size_t room[] = {200, 1000, 1 << 16, 1 << 18},
                        sizes[] = {0, 100, 112, 113, 114, 700, 65000, 65522, 65523, 66000, 200000};
    enum { SIZES = sizeof sizes / sizeof *sizes };
    static unsigned char piece[1 << 18], whole[1 << 18];
    (void)state;
    for (size_t r = 0; r < sizeof room / sizeof *room; r++) {
        panel_hub hub = {0};
        panel_outbox box = {0};
        const int channel = panel_hub_add(&hub, SIZES);
        assert_true(panel_subscribe(&box, &hub, 3, channel));
        for (size_t i = 0; i < SIZES; i++) {
            char *data = malloc(sizes[i] + 1);
            assert_non_null(data);
            for (size_t k = 0; k < sizes[i]; k++) data[k] = (char)(k * 7 + i);
            assert_true(panel_hub_publish(&hub, channel, i, data, sizes[i]));
        }
        assert_true(panel_reply_add(&box, panel_status(PANEL_INFO, "hello")));
        size_t messages = 0, got = 0;
        for (size_t n; (n = panel_outbox_frames(&box, &hub, piece, room[r])) > 0;) {
            assert_true(n <= room[r]);
            for (size_t at = 0; at < n;) {
                bool last;
                int opcode;
                size_t payload;
                at += read_frame(piece + at, n - at, &last, &opcode, &payload);
                assert_true(at + payload <= n && got + payload <= sizeof whole);
                assert_int_equal(opcode, got > 0 ? 0 : messages == 0 ? 1 : 2);
                memcpy(whole + got, piece + at, payload);
                at += payload;
                got += payload;
                if (!last) continue;
                if (messages > 0) {
                    const size_t i = messages - 1;
                    assert_int_equal(got, PANEL_MESSAGE_HEAD + sizes[i]);
                    for (size_t k = 0; k < sizes[i]; k++)
                        assert_int_equal(whole[PANEL_MESSAGE_HEAD + k], (unsigned char)(k * 7 + i));
                }
                messages++;
                got = 0;
            }
        }
        assert_int_equal(messages, 1 + SIZES);
        assert_int_equal(got, 0);
        panel_outbox_free(&box);
        panel_hub_free(&hub);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(states_and_events),
        cmocka_unit_test(pieces_and_answers),
        cmocka_unit_test(one_who_does_not_read),
        cmocka_unit_test(frames),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
