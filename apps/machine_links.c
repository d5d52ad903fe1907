/* Who is there: strangers until they have shown the token, one master, and his link for images. */
#include <math.h>
#include <openssl/crypto.h>
#include <openssl/rand.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "apps/machine_internal.h"

static const double IMAGES_TIMEOUT = 10; /* times the commands': a large image may take that long */

/* ---- opened and closed ---- */

td_status machine_link_options(td_link_options *options, uint8_t token[TD_LINK_TOKEN_MAX],
                               const machine_options *o, td_error *error)
{
    size_t size = 0;
    if (!o->token)
        return td_fail(
            error, TD_ERROR_ARGUMENT,
            "--token-file is missing: a file of the token that both sides hold (openssl rand -hex 32)");
    TD_TRY(td_link_token_read(token, &size, o->token, error));
    *options = td_link_options_default();
    options->token = token;
    options->token_size = size;
    options->period_s = o->period_s;
    options->timeout_s = MACHINE_TIMEOUT_PERIODS * o->period_s;
    options->handshake_s = fmax(options->handshake_s, 2 * options->timeout_s);
    options->tls = o->tls || o->certificate || o->authority;
    options->certificate = o->certificate;
    options->key = o->key;
    options->authority = o->authority;
    options->plain_anywhere = o->plain;
    return TD_OK;
}

td_status machine_links_open(machine *m, td_error *error)
{
    uint8_t token[TD_LINK_TOKEN_MAX];
    td_link_options o = {0};
    td_status status = machine_link_options(&o, token, m->o, error);
    if (status == TD_OK && o.tls && (!o.certificate || !o.key))
        status = td_fail(error, TD_ERROR_ARGUMENT, "--cert and --key go together, and make TLS");
    o.any_channel = true;
    o.unsent_max = (size_t)TD_MACHINE_MAX_IMAGE + 65536;
    if (status == TD_OK) status = td_link_listen(&m->listener, m->o->listen, &o, error);
    OPENSSL_cleanse(token, sizeof token);
    return status;
}

void machine_links_close(machine *m)
{
    for (int i = 0; i < MACHINE_PENDING; i++) td_link_free(&m->pending[i]);
    td_link_free(&m->master);
    td_link_free(&m->pictures);
    td_link_listener_free(&m->listener);
}

/* ---- what the master is told ---- */

void machine_tell(machine *m, const td_machine_message *message, bool may_drop)
{
    td_error error = {0};
    if (!m->master || td_link_state_of(m->master) != TD_LINK_OPEN) return;
    if (td_machine_send(m->master, message, may_drop, &error) != TD_OK)
        audit_line(&m->audit, "trouble", NULL, "%s", error.message);
}

static void answer_to(td_link *link, audit *a, td_machine_kind kind, td_machine_order order, bool accepted,
                      const char *text)
{
    td_machine_message message = {.kind = TD_MACHINE_ANSWER};
    td_error error = {0};
    message.as.answer = (td_machine_answer){.kind = kind, .order = order, .accepted = accepted};
    snprintf(message.as.answer.text, sizeof message.as.answer.text, "%s", text);
    if (td_machine_send(link, &message, false, &error) != TD_OK)
        audit_line(a, "trouble", NULL, "%s", error.message);
}

void machine_answer(machine *m, td_machine_kind kind, td_machine_order order, bool accepted,
                    const char *format, ...)
{
    char text[TD_MACHINE_TEXT_SIZE];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    audit_line(&m->audit, accepted ? "accepted" : "refused", NULL, "%s: %s",
               kind == TD_MACHINE_TASK ? "task" : td_machine_order_name(order), text);
    if (m->master && td_link_state_of(m->master) == TD_LINK_OPEN)
        answer_to(m->master, &m->audit, kind, order, accepted, text);
}

static void welcome(machine *m, td_link *link, bool is_operator)
{
    td_machine_message message = {.kind = TD_MACHINE_WELCOME};
    td_machine_welcome *w = &message.as.welcome;
    td_error error = {0};
    w->version = TD_MACHINE_VERSION;
    w->is_operator = is_operator;
    if (is_operator) memcpy(w->session, m->session, sizeof w->session);
    snprintf(w->robot, sizeof w->robot, "%s", m->s->robot->name);
    memcpy(w->model, m->model, sizeof w->model);
    w->period_s = m->s->period_s;
    w->joints = m->s->robot->joint_count;
    for (int k = 0; k < w->joints; k++)
        snprintf(w->joint[k], sizeof w->joint[k], "%s", m->s->robot->joint[k].name);
    if (td_machine_send(link, &message, false, &error) != TD_OK)
        audit_line(&m->audit, "trouble", NULL, "%s", error.message);
}

/* ---- who comes ---- */

/* Takes the link. */
static void meet_master(machine *m, td_link *link)
{
    if (m->master) {
        audit_stranger(&m->audit, "refused", audit_text("%s: a second operator", td_link_peer(link)));
        welcome(m, link, false);
        answer_to(link, &m->audit, TD_MACHINE_ORDER, TD_ORDER_EXECUTE, false, "another operator commands");
        td_link_poll(link, td_machine_now_s());
        td_link_free(&link);
        return;
    }
    if (RAND_bytes(m->session, sizeof m->session) != 1) {
        td_link_free(&link);
        return;
    }
    m->master = link;
    m->masters++;
    audit_line(&m->audit, "master", NULL, "%s commands", td_link_peer(link));
    welcome(m, link, true);
    if (m->stop.found.took_s >= 0) m->stop.told = false; /* what it missed */
}

static void meet_pictures(machine *m, td_link *link)
{
    const bool his = m->master && td_link_channel(link) == TD_MACHINE_IMAGES &&
                     CRYPTO_memcmp(td_link_session(link), m->session, sizeof m->session) == 0;
    if (!his) {
        audit_stranger(&m->audit, "refused",
                       audit_text("%s: a link for images of no session under way", td_link_peer(link)));
        td_link_free(&link);
        return;
    }
    td_link_free(&m->pictures);
    m->pictures = link;
    td_link_set_timeout(link, IMAGES_TIMEOUT * MACHINE_TIMEOUT_PERIODS * m->o->period_s);
    audit_line(&m->audit, "images", NULL, "%s is sent images", td_link_peer(link));
}

static void let_in(machine *m, double now_s)
{
    for (;;) {
        td_link *link = NULL;
        td_error error = {0};
        int place = 0;
        if (td_link_accept(&link, m->listener, now_s, &error) != TD_OK)
            audit_stranger(&m->audit, "trouble", audit_text("%s", error.message));
        if (!link) return;
        while (place < MACHINE_PENDING && m->pending[place]) place++;
        if (place < MACHINE_PENDING) {
            m->pending[place] = link;
            continue;
        }
        audit_stranger(&m->audit, "refused",
                       audit_text("%s: %d others are at the door", td_link_peer(link), MACHINE_PENDING));
        td_link_free(&link);
    }
}

static void hear_stranger(machine *m, td_link **place, double now_s)
{
    td_link *link = *place;
    td_link_poll(link, now_s);
    if (td_link_state_of(link) == TD_LINK_CLOSED) {
        audit_stranger(&m->audit, "refused",
                       audit_text("%s: %s", td_link_peer(link), td_link_why(link, NULL)));
        td_link_free(place);
    } else if (td_link_state_of(link) == TD_LINK_OPEN) {
        *place = NULL;
        if (td_link_channel(link) == TD_MACHINE_COMMANDS)
            meet_master(m, link);
        else
            meet_pictures(m, link);
    }
}

/* ---- the master ---- */

static void lose_master(machine *m, double now_s)
{
    bool left = false;
    const char *why = td_link_why(m->master, &left);
    const td_link_measure l = td_link_measure_of(m->master, now_s);
    m->silent_s = left ? 0 : l.unanswered_s;
    audit_line(&m->audit, left ? "farewell" : "lost",
               json_pack("{s:f, s:f, s:f, s:I, s:I, s:I}", "silent_s", m->silent_s, "round_trip_mean_s",
                         l.mean_s, "round_trip_most_s", l.most_s, "pings", (json_int_t)l.pings, "late",
                         (json_int_t)l.late, "retransmitted", (json_int_t)l.retransmitted),
               "%s: %s", td_link_peer(m->master), why);
    if (left && m->logic.phase != TD_PHASE_FAILED) m->ends = true;
    m->asked = m->unanswered = 0;
    m->wish_s = NAN;
    td_link_free(&m->master);
    td_link_free(&m->pictures);
}

/* The task is done, and its session ends when the machine has stood for a moment. What comes meanwhile waits,
 * for it is of the next task; nothing moves that an order could stop. */
static bool is_resting(const machine *m)
{
    return m->in_session && m->shown == TD_PHASE_MONITORING;
}

static void hear_master(machine *m, double now_s)
{
    td_link_frame frame;
    td_link_poll(m->master, now_s);
    while (!is_resting(m) && td_link_next(&frame, m->master)) {
        static td_machine_message message; /* large */
        td_error error = {0};
        if (td_machine_decode(&message, frame.kind, frame.payload, frame.size, &error) == TD_OK) {
            machine_take_message(m, &message);
            continue;
        }
        audit_line(&m->audit, "refused", NULL, "%s: %s", td_link_peer(m->master), error.message);
        td_link_close(m->master, "what it sent is no message");
        break;
    }
    if (td_link_state_of(m->master) == TD_LINK_CLOSED) lose_master(m, now_s);
}

static void hear_pictures(machine *m, double now_s)
{
    td_link_frame frame;
    td_link_poll(m->pictures, now_s);
    if (td_link_next(&frame, m->pictures)) td_link_close(m->pictures, "nothing is to be said there");
    if (td_link_state_of(m->pictures) != TD_LINK_CLOSED) return;
    audit_line(&m->audit, "images", NULL, "%s: %s", td_link_peer(m->pictures),
               td_link_why(m->pictures, NULL));
    td_link_free(&m->pictures);
}

static void wait_for_any(const machine *m, double seconds)
{
    struct pollfd p[MACHINE_PENDING + 5];
    nfds_t n = 0;
    p[n++] = (struct pollfd){.fd = td_link_listener_fd(m->listener), .events = POLLIN};
    td_link *const others[] = {m->master, m->pictures};
    for (int i = 0; i < MACHINE_PENDING + 2; i++) {
        const td_link *link = i < MACHINE_PENDING ? m->pending[i] : others[i - MACHINE_PENDING];
        if (link) p[n].fd = td_link_fd(link, &p[n].events), n++;
    }
    if (m->check.work) p[n++] = (struct pollfd){.fd = aside_fd(m->check.work), .events = POLLIN};
    if (m->look) p[n++] = (struct pollfd){.fd = aside_fd(m->look), .events = POLLIN};
    const int milliseconds = (int)(1e3 * seconds);
    (void)poll(p, n, milliseconds < 1 ? 1 : milliseconds);
}

/* Other processes, and its own work, may keep it from looking. */
static void note_starving(machine *m, double now_s, double meant_s)
{
    const double over = now_s - m->heard_s - meant_s;
    if (m->heard_s > 0 && (over > m->starved_s || now_s > m->starved_at_s + 1)) {
        m->starved_s = fmax(0, over);
        m->starved_at_s = now_s;
    }
    m->heard_s = now_s;
    struct timespec cpu;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &cpu);
    const double worked_s = (double)cpu.tv_sec + 1e-9 * (double)cpu.tv_nsec;
    m->longest_work_s = fmax(m->longest_work_s, worked_s - m->worked_s);
    m->worked_s = worked_s;
}

void machine_hear(machine *m, double seconds)
{
    if (seconds > 0) wait_for_any(m, seconds);
    const double now = td_machine_now_s();
    note_starving(m, now, seconds);
    let_in(m, now);
    for (int i = 0; i < MACHINE_PENDING; i++)
        if (m->pending[i]) hear_stranger(m, &m->pending[i], now);
    if (m->master) hear_master(m, now);
    if (m->pictures) hear_pictures(m, now);
    machine_look(m);
}
