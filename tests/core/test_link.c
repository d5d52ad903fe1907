/* Proves of core/link: two sides that hold the same token open, whatever pieces their bytes come in, and pass
 * frames of any allowed size in order; a side with another token, of another version, or that answers with
 * what was said before (a replayed session, a reflection, a frame sent twice, any one bit changed) is
 * refused, and learns no proof of the token before it has given its own; frames too large, too many, too slow
 * or not taken close the link; a ping without an answer closes it within the timeout and half a period, at a
 * delay as at a cut, and a side that slept does not blame the other. Round trips are those of the clock that
 * the test turns.
 *
 * Reference: the header's words; the bytes themselves are made a second time by tests/apps/test_machine.py
 * with Python's hmac. Tolerances: none but of times, which are sums of the test's own steps (1e-9 s). Blind
 * to: TLS and real networks (tests/apps/test_machine.py). */
#include "core/link.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "tests/check.h"
#include "tests/scratch.h"

static const char TOKEN[] = "0123456789abcdef0123456789abcdef";

static td_link_options options_of(const char *token)
{
    td_link_options o = td_link_options_default();
    o.token = token;
    o.token_size = strlen(token);
    return o;
}

typedef struct pair {
    td_link *side[2]; /* client, server */
    double now_s;
} pair;

static pair pair_of(const td_link_options *client, const td_link_options *server)
{
    pair p = {.now_s = 100};
    td_error error = {0};
    check_ok(td_link_new(&p.side[0], false, client, p.now_s, &error), error);
    check_ok(td_link_new(&p.side[1], true, server, p.now_s, &error), error);
    return p;
}

static void end(pair *p)
{
    td_link_free(&p->side[0]);
    td_link_free(&p->side[1]);
}

/* What lies there, `piece` bytes at a time. Whether anything did. */
static bool carry(pair *p, int from, size_t piece)
{
    size_t size;
    const uint8_t *bytes = td_link_give(p->side[from], &size);
    if (size == 0) return false;
    if (size > piece) size = piece;
    td_link_take(p->side[!from], bytes, size, p->now_s);
    td_link_gave(p->side[from], size);
    return true;
}

static void settle(pair *p, size_t piece)
{
    bool more = true;
    while (more) {
        more = carry(p, 0, piece);
        more = carry(p, 1, piece) || more;
    }
}

static pair open_pair(void)
{
    const td_link_options o = options_of(TOKEN);
    pair p = pair_of(&o, &o);
    settle(&p, SIZE_MAX);
    for (int i = 0; i < 2; i++) assert_int_equal(td_link_state_of(p.side[i]), TD_LINK_OPEN);
    return p;
}

static void check_closed(const td_link *link, const char *words)
{
    if (td_link_state_of(link) != TD_LINK_CLOSED) fail_msg("open, where it should say '%s'", words);
    if (!strstr(td_link_why(link, NULL), words)) fail_msg("'%s' lacks '%s'", td_link_why(link, NULL), words);
}

static void pump(pair *p, double seconds, double step_s)
{
    for (const double to = p->now_s + seconds; p->now_s < to - 1e-9;) {
        p->now_s += step_s;
        for (int i = 0; i < 2; i++) td_link_poll(p->side[i], p->now_s);
        settle(p, SIZE_MAX);
    }
}

/* ---- frames ---- */

static void passes_frames(void **state)
{
    (void)state;
    td_error error = {0};
    static uint8_t big[3000];
    for (size_t i = 0; i < sizeof big; i++) big[i] = (uint8_t)(i * 7);
    static const size_t sizes[] = {0, 1, 13, 14, 255, 3000};
    for (size_t piece = 1; piece < 4000; piece = piece * 3 + 1) {
        const td_link_options o = options_of(TOKEN);
        pair p = pair_of(&o, &o);
        settle(&p, piece);
        for (int from = 0; from < 2; from++) {
            for (size_t i = 0; i < 6; i++)
                check_ok(td_link_send(p.side[from], (uint8_t)(i + 1), big, sizes[i], false, &error), error);
            settle(&p, piece);
            td_link_frame f;
            for (size_t i = 0; i < 6; i++) {
                assert_true(td_link_next(&f, p.side[!from]));
                assert_int_equal(f.kind, i + 1);
                assert_int_equal(f.size, sizes[i]);
                assert_memory_equal(f.payload, big, f.size);
            }
            assert_false(td_link_next(&f, p.side[!from]));
        }
        end(&p);
    }
}

static void refuses_kinds_and_sizes(void **state)
{
    (void)state;
    td_error error = {0};
    pair p = open_pair();
    check_fails(td_link_send(p.side[0], TD_LINK_KIND_MAX + 1, "", 0, false, &error), TD_ERROR_ARGUMENT, error,
                "kind");
    uint8_t *big = calloc(1, (size_t)300 << 10);
    assert_non_null(big);
    check_ok(td_link_send(p.side[0], 1, big, (size_t)300 << 10, false, &error), error);
    settle(&p, 1000);
    check_closed(p.side[1], "307200 bytes came, above the 262144 allowed");
    end(&p);
    /* The other does not read: what may be dropped is, what may not closes. */
    p = open_pair();
    for (int i = 0; i < 10; i++)
        check_ok(td_link_send(p.side[0], 1, big, (size_t)300 << 10, true, &error), error);
    assert_true(td_link_unsent(p.side[0]) < (size_t)1 << 20);
    check_fails(td_link_send(p.side[0], 1, big, (size_t)300 << 10, false, &error), TD_ERROR_IO, error,
                "does not read");
    check_fails(td_link_send(p.side[0], 1, big, 0, false, &error), TD_ERROR_IO, error, "not open");
    free(big);
    end(&p);
}

/* ---- who is there ---- */

static void refuses_another_token(void **state)
{
    (void)state;
    const td_link_options right = options_of(TOKEN), wrong = options_of("0123456789abcdef0123456789abcdeF");
    pair p = pair_of(&wrong, &right);
    size_t said = 0;
    carry(&p, 0, SIZE_MAX); /* the client's hello, */
    td_link_give(p.side[1], &said);
    assert_int_equal(said, TD_LINK_HELLO_SIZE);
    carry(&p, 1, SIZE_MAX); /* the server's, */
    carry(&p, 0, SIZE_MAX); /* the client's proof */
    check_closed(p.side[1], "does not hold the token");
    td_link_give(p.side[1], &said);
    assert_int_equal(said, 0); /* and none of the server's */
    end(&p);
    td_error error = {0};
    td_link *none = NULL;
    const td_link_options missing = td_link_options_default(), brief = options_of("short");
    check_fails(td_link_new(&none, true, &missing, 0, &error), TD_ERROR_ARGUMENT, error, "token");
    check_fails(td_link_new(&none, true, &brief, 0, &error), TD_ERROR_ARGUMENT, error, "token");
    assert_null(none);
}

static void refuses_other_versions_and_channels(void **state)
{
    (void)state;
    td_link_options client = options_of(TOKEN), server = client;
    pair p = pair_of(&client, &server);
    uint8_t hello[TD_LINK_HELLO_SIZE];
    size_t size;
    memcpy(hello, td_link_give(p.side[0], &size), sizeof hello);
    hello[5] = 2;
    td_link_take(p.side[1], hello, sizeof hello, p.now_s);
    check_closed(p.side[1], "speaks version 2 of the link, this one 1");
    td_link_give(p.side[1], &size);
    assert_int_equal(size, TD_LINK_HELLO_SIZE); /* so that the other can say so too */
    end(&p);
    client.channel = 1;
    p = pair_of(&client, &server);
    settle(&p, SIZE_MAX);
    check_closed(p.side[1], "channel 1");
    end(&p);
    server.any_channel = true;
    p = pair_of(&client, &server);
    settle(&p, SIZE_MAX);
    assert_int_equal(td_link_state_of(p.side[1]), TD_LINK_OPEN);
    assert_int_equal(td_link_channel(p.side[1]), 1);
    end(&p);
    p = pair_of(&client, &server);
    td_link_take(p.side[1], "GET / HTTP/1.1\r\n", 16, p.now_s);
    check_closed(p.side[1], "no hello of this protocol");
    end(&p);
}

/* ---- hostile bytes ---- */

static void refuses_any_changed_bit(void **state)
{
    (void)state;
    td_error error = {0};
    for (size_t at = 0; at < 40; at++) { /* 14 of head, 10 of payload, 16 of tag */
        pair p = open_pair();
        td_link_frame f;
        uint8_t frame[40];
        size_t size;
        check_ok(td_link_send(p.side[0], 7, "0123456789", 10, false, &error), error);
        memcpy(frame, td_link_give(p.side[0], &size), sizeof frame);
        assert_int_equal(size, sizeof frame);
        frame[at] ^= (uint8_t)(1 << at % 8);
        td_link_take(p.side[1], frame, sizeof frame, p.now_s);
        p.now_s += 1; /* where more is waited for, it does not come */
        td_link_poll(p.side[1], p.now_s);
        assert_int_equal(td_link_state_of(p.side[1]), TD_LINK_CLOSED);
        assert_false(td_link_next(&f, p.side[1]));
        end(&p);
    }
}

static void refuses_what_was_said_before(void **state)
{
    (void)state;
    td_error error = {0};
    uint8_t session[2000], frame[100];
    size_t said = 0, size;
    const td_link_options o = options_of(TOKEN);
    pair p = pair_of(&o, &o);
    for (int turn = 0; turn < 4; turn++) { /* kept as it goes */
        const uint8_t *bytes = td_link_give(p.side[0], &size);
        memcpy(session + said, bytes, size);
        said += size;
        settle(&p, SIZE_MAX);
        if (turn == 1) check_ok(td_link_send(p.side[0], 1, "start", 5, false, &error), error);
    }
    assert_int_equal(td_link_state_of(p.side[1]), TD_LINK_OPEN);
    /* The frame once more. */
    check_ok(td_link_send(p.side[0], 1, "start", 5, false, &error), error);
    memcpy(frame, td_link_give(p.side[0], &size), 35);
    assert_int_equal(size, 35);
    settle(&p, SIZE_MAX);
    td_link_take(p.side[1], frame, 35, p.now_s);
    check_closed(p.side[1], "it was sent again");
    end(&p);
    /* The whole session once more. */
    p = pair_of(&o, &o);
    td_link_take(p.side[1], session, said, p.now_s);
    check_closed(p.side[1], "does not hold the token");
    end(&p);
    /* To whom it came from. */
    p = open_pair();
    check_ok(td_link_send(p.side[0], 1, "start", 5, false, &error), error);
    const uint8_t *bytes = td_link_give(p.side[0], &size);
    td_link_take(p.side[0], bytes, size, p.now_s);
    check_closed(p.side[0], "tag is wrong");
    end(&p);
}

static void refuses_floods(void **state)
{
    (void)state;
    td_error error = {0};
    td_link_options o = options_of(TOKEN);
    o.frames_per_s = 20;
    pair p = pair_of(&o, &o);
    settle(&p, SIZE_MAX);
    td_link_frame f;
    for (int i = 0; i < 20; i++) check_ok(td_link_send(p.side[0], 1, "x", 1, false, &error), error);
    settle(&p, SIZE_MAX);
    while (td_link_next(&f, p.side[1])) continue;
    assert_int_equal(td_link_state_of(p.side[1]), TD_LINK_OPEN);
    p.now_s += 0.1;
    for (int i = 0; i < 3; i++) check_ok(td_link_send(p.side[0], 1, "x", 1, false, &error), error);
    settle(&p, SIZE_MAX);
    check_closed(p.side[1], "more than 20 frames a second");
    end(&p);
    o = options_of(TOKEN);
    o.bytes_per_s = 5000;
    p = pair_of(&o, &o);
    settle(&p, SIZE_MAX);
    static const uint8_t kilobyte[1000];
    for (int i = 0; i < 6; i++) check_ok(td_link_send(p.side[0], 1, kilobyte, 1000, false, &error), error);
    settle(&p, SIZE_MAX);
    check_closed(p.side[1], "more than 5000 bytes a second");
    end(&p);
    o = options_of(TOKEN);
    o.frame_max = 1000;
    p = pair_of(&o, &o);
    settle(&p, SIZE_MAX);
    for (int i = 0; i < 6; i++) check_ok(td_link_send(p.side[0], 1, kilobyte, 1000, false, &error), error);
    settle(&p, SIZE_MAX);
    check_closed(p.side[1], "more frames came than were taken");
    end(&p);
}

static void refuses_the_slow(void **state)
{
    (void)state;
    td_error error = {0};
    const td_link_options o = options_of(TOKEN);
    /* A hello that never comes, and one that comes by a byte a second. */
    pair p = pair_of(&o, &o);
    for (int i = 0; i < 3 && td_link_state_of(p.side[1]) != TD_LINK_CLOSED; i++) {
        carry(&p, 0, 1);
        p.now_s += 1;
        td_link_poll(p.side[1], p.now_s);
    }
    check_closed(p.side[1], "no link after 2 s");
    check_near(p.now_s, 103, 1e-9);
    end(&p);
    /* A frame whose end does not come, while pings would be answered. */
    p = open_pair();
    check_ok(td_link_send(p.side[0], 1, "start", 5, false, &error), error);
    carry(&p, 0, 20);
    for (int i = 0; i < 7; i++) {
        p.now_s += 0.05;
        td_link_poll(p.side[1], p.now_s);
    }
    check_closed(p.side[1], "a frame came too slowly");
    end(&p);
}

/* ---- the heartbeat ---- */

/* Bytes that arrive `delay` steps later. */
typedef struct line {
    uint8_t bytes[64][4096];
    size_t size[64];
} line;

static void turn(pair *p, line *lines, int delay, int step, bool cut)
{
    for (int from = 0; from < 2; from++) {
        line *l = lines + from;
        const int slot = step % 64, due = (step + 64 - delay) % 64;
        size_t size;
        const uint8_t *bytes = td_link_give(p->side[from], &size);
        assert_true(size <= sizeof l->bytes[0]);
        l->size[slot] = cut ? 0 : size;
        if (size) memcpy(l->bytes[slot], bytes, size);
        td_link_gave(p->side[from], size);
        if (step >= delay && l->size[due])
            td_link_take(p->side[!from], l->bytes[due], l->size[due], p->now_s);
    }
}

static void measures_the_round_trip(void **state)
{
    (void)state;
    static line lines[2];
    pair p = open_pair();
    memset(lines, 0, sizeof lines);
    for (int step = 0; step < 400; step++) { /* of 5 ms, 8 steps there and 8 and one back: 80 to 85 ms */
        p.now_s += 0.005;
        for (int i = 0; i < 2; i++) td_link_poll(p.side[i], p.now_s);
        turn(&p, lines, 8, step, false);
    }
    for (int i = 0; i < 2; i++) {
        const td_link_measure m = td_link_measure_of(p.side[i], p.now_s);
        assert_int_equal(td_link_state_of(p.side[i]), TD_LINK_OPEN);
        assert_true(m.pings >= 39 && m.pings <= 41); /* twice each 0.1 s for 2 s */
        assert_true(m.pings - m.answers <= 2);
        assert_true(m.mean_s > 0.0799 && m.most_s < 0.0851);
        assert_int_equal(m.late, 0);
    }
    /* Then it grows to 250 ms each way, or the line is cut: found within the timeout, half a period and the
     * test's own step after the last that came through. */
    for (int step = 400; td_link_state_of(p.side[1]) == TD_LINK_OPEN; step++) {
        assert_true(step < 500);
        p.now_s += 0.005;
        for (int i = 0; i < 2; i++) td_link_poll(p.side[i], p.now_s);
        turn(&p, lines, 8, step, true);
        if (td_link_state_of(p.side[1]) != TD_LINK_OPEN) assert_true((step - 400) * 0.005 <= 0.35 + 0.005);
    }
    check_closed(p.side[1], "no answer for 0.30");
    end(&p);
    p = open_pair();
    memset(lines, 0, sizeof lines);
    int step = 0;
    for (; td_link_state_of(p.side[1]) == TD_LINK_OPEN; step++) {
        assert_true(step < 100);
        p.now_s += 0.005;
        for (int i = 0; i < 2; i++) td_link_poll(p.side[i], p.now_s);
        turn(&p, lines, 50, step, false);
    }
    assert_true(step * 0.005 <= 0.35);
    end(&p);
}

static void does_not_blame_the_other_for_its_own_sleep(void **state)
{
    (void)state;
    pair p = open_pair();
    pump(&p, 1, 0.02);
    /* The server sleeps for 2 s; in the meantime it is pinged, and the answers to its own pings have come. */
    td_link_poll(p.side[1], p.now_s + 0.06);
    carry(&p, 1, SIZE_MAX);
    p.now_s += 2;
    carry(&p, 0, SIZE_MAX); /* the answers, read first */
    td_link_poll(p.side[1], p.now_s);
    assert_int_equal(td_link_state_of(p.side[1]), TD_LINK_OPEN);
    assert_true(td_link_measure_of(p.side[1], p.now_s).late >= 1);
    end(&p);
}

static void says_farewell(void **state)
{
    (void)state;
    td_error error = {0};
    bool left = false;
    td_link_listener *listener = NULL;
    td_link *a = NULL, *b = NULL;
    const td_link_options o = options_of(TOKEN);
    char address[32];
    check_ok(td_link_listen(&listener, "127.0.0.1:0", &o, &error), error);
    snprintf(address, sizeof address, "127.0.0.1:%d", td_link_listener_port(listener));
    check_ok(td_link_connect(&a, address, &o, 0, &error), error);
    double now_s = 0;
    for (int i = 0; i < 1000 && (!b || td_link_state_of(b) != TD_LINK_OPEN); i++) {
        struct pollfd none = {.fd = -1};
        (void)poll(&none, 1, 1);
        now_s += 0.001;
        if (!b) check_ok(td_link_accept(&b, listener, now_s, &error), error);
        td_link_poll(a, now_s);
        if (b) td_link_poll(b, now_s);
    }
    assert_int_equal(td_link_state_of(b), TD_LINK_OPEN);
    assert_non_null(strstr(td_link_peer(b), "127.0.0.1:"));
    td_link_poll(a, now_s);
    check_ok(td_link_send(a, 3, "last words", 10, false, &error), error);
    td_link_free(&a);
    td_link_frame f = {0};
    for (int i = 0; i < 200 && td_link_state_of(b) == TD_LINK_OPEN; i++) {
        struct pollfd none = {.fd = -1};
        (void)poll(&none, 1, 1);
        td_link_poll(b, now_s);
    }
    assert_true(td_link_next(&f, b) && f.size == 10);
    assert_non_null(strstr(td_link_why(b, &left), "farewell"));
    assert_true(left);
    td_link_free(&b);
    /* Nobody listens any more. */
    td_link_listener_free(&listener);
    check_ok(td_link_connect(&a, address, &o, 0, &error), error);
    for (int i = 0; i < 100 && td_link_state_of(a) != TD_LINK_CLOSED; i++) td_link_poll(a, 0.001 * i);
    check_closed(a, "cannot connect to 127.0.0.1");
    td_link_free(&a);
}

/* ---- addresses and tokens ---- */

static void refuses_addresses(void **state)
{
    (void)state;
    td_error error = {0};
    td_link_listener *listener = NULL;
    td_link *link = NULL;
    td_link_options o = options_of(TOKEN);
    static const char *const bad[] = {
        "", ":1", "127.0.0.1", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:99999", "[::1:80"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        check_fails(td_link_listen(&listener, bad[i], &o, &error), TD_ERROR_ARGUMENT, error, "is no address");
    check_fails(td_link_listen(&listener, "0.0.0.0:0", &o, &error), TD_ERROR_ARGUMENT, error,
                "beyond this computer a link is encrypted");
    check_fails(td_link_connect(&link, "192.0.2.1:9", &o, 0, &error), TD_ERROR_ARGUMENT, error, "encrypted");
    o.plain_anywhere = true;
    check_ok(td_link_listen(&listener, "0.0.0.0:0", &o, &error), error);
    td_link_listener_free(&listener);
    o.tls = true;
    o.certificate = o.key = "/nonexistent.pem";
    check_fails(td_link_listen(&listener, "127.0.0.1:0", &o, &error), TD_ERROR_DATA, error,
                "/nonexistent.pem");
    assert_null(listener);
}

static void reads_tokens(void **state)
{
    td_error error = {0};
    uint8_t token[TD_LINK_TOKEN_MAX];
    size_t size = 0;
    char *path = td_path_join(*state, "token");
    static const struct {
        const char *text;
        mode_t mode;
        const char *words;
    } cases[] = {{"0123456789abcdef\n", 0600, NULL},
                 {"0123456789abcdef\n", 0640, "others may read"},
                 {"0123456789abcde\n", 0600, "has 16 to 1024 bytes, this one 15"}};
    for (size_t i = 0; i < 3; i++) {
        FILE *f = fopen(path, "w");
        assert_non_null(f);
        fputs(cases[i].text, f);
        fclose(f);
        chmod(path, cases[i].mode);
        if (cases[i].words)
            check_fails(td_link_token_read(token, &size, path, &error), TD_ERROR_DATA, error, cases[i].words);
        else
            check_ok(td_link_token_read(token, &size, path, &error), error);
        assert_int_equal(size, cases[i].words ? 0 : 16);
    }
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(passes_frames),
        cmocka_unit_test(refuses_kinds_and_sizes),
        cmocka_unit_test(refuses_another_token),
        cmocka_unit_test(refuses_other_versions_and_channels),
        cmocka_unit_test(refuses_any_changed_bit),
        cmocka_unit_test(refuses_what_was_said_before),
        cmocka_unit_test(refuses_floods),
        cmocka_unit_test(refuses_the_slow),
        cmocka_unit_test(measures_the_round_trip),
        cmocka_unit_test(does_not_blame_the_other_for_its_own_sleep),
        cmocka_unit_test(says_farewell),
        cmocka_unit_test(refuses_addresses),
        cmocka_unit_test_setup_teardown(reads_tokens, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
