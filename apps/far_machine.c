#include "apps/far_machine.h"

#include <openssl/crypto.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double LOOK_S = 0.004, AGAIN_S = 0.5, TELL_S = 0.25, FAREWELL_S = 0.5;
enum { STATES = 4, LINES = 64, SAID = 256, PICTURES = 4 };

/* Things go one way, and the room they took comes back. */
typedef struct lane {
    panel_ring there, back;
} lane;

struct far_machine {
    /* given */
    uint8_t token[TD_LINK_TOKEN_MAX];
    td_link_options options;
    char at[300], authority[1100], model[TD_HASH_HEX_SIZE];
    int joints;
    double silent_s;
    void (*wake)(void *user);
    void *user;
    /* between the threads */
    lane states, heard, shown, lines, pictures, said;
    atomic_bool stop;
    atomic_ullong beats;
    pthread_t thread;
    bool started;
    /* the link's thread */
    td_link *link, *images;
    far_measured now;
    double again_s, images_again_s, told_s, beat_s;
    unsigned long long beat;
    bool silenced; /* stopped, for a session that does not beat */
    td_machine_welcome welcome;
};

/* ---- lanes ---- */

static void release_said(void *thing)
{
    free(((far_said *)thing)->text);
    free(thing);
}

static void release_picture(void *thing)
{
    free(((far_picture *)thing)->bytes);
    free(thing);
}

static bool lane_begin(lane *l, size_t size, void (*release)(void *thing))
{
    return panel_ring_begin(&l->there, size, release) && panel_ring_begin(&l->back, size, release);
}

static void lane_end(lane *l)
{
    if (l->there.slot) panel_ring_end(&l->there);
    if (l->back.slot) panel_ring_end(&l->back);
}

static void *lane_fresh(lane *l, size_t size)
{
    void *thing = panel_ring_take(&l->back);
    return thing ? thing : calloc(1, size);
}

static void lane_give_back(lane *l, void *thing)
{
    if (!panel_ring_offer(&l->back, thing)) l->back.release(thing);
}

/* ---- told to the others ---- */

static void show(far_machine *m, double now_s)
{
    m->told_s = now_s;
    if (m->link) m->now.link = td_link_measure_of(m->link, now_s);
    lane *const lanes[] = {&m->states, &m->shown};
    for (int i = 0; i < 2; i++) {
        far_measured *x = lane_fresh(lanes[i], sizeof *x);
        if (!x) continue;
        *x = m->now;
        (void)panel_ring_put(&lanes[i]->there, x);
    }
    m->wake(m->user);
}

static void report(far_machine *m, const far_heard *heard)
{
    lane *const lanes[] = {&m->heard, &m->lines};
    for (int i = 0; i < 2; i++) {
        if (i == 0 && heard->kind == FAR_TOLD) continue; /* the session knows */
        far_heard *x = lane_fresh(lanes[i], sizeof *x);
        if (!x) continue;
        *x = *heard;
        if (!panel_ring_offer(&lanes[i]->there, x)) free(x);
    }
    m->wake(m->user);
}

static TD_PRINTF(3, 4) void report_text(far_machine *m, int kind, const char *format, ...)
{
    far_heard h = {.kind = kind};
    va_list list;
    va_start(list, format);
    vsnprintf(h.answer.text, sizeof h.answer.text, format, list);
    va_end(list);
    report(m, &h);
}

/* ---- the link ---- */

static void lose(far_machine *m, const char *why, double now_s)
{
    const bool was = m->now.open;
    const bool news = was || strcmp(m->now.why, why) != 0;
    m->now.open = false;
    snprintf(m->now.why, sizeof m->now.why, "%s", why);
    td_link_free(&m->link);
    td_link_free(&m->images);
    m->again_s = now_s + AGAIN_S;
    if (!news) return;
    report_text(m, FAR_UNLINKED, "%s", why);
    show(m, now_s);
}

static void connect_again(far_machine *m, double now_s)
{
    td_error error = {0};
    if (m->link || now_s < m->again_s) return;
    if (td_link_connect(&m->link, m->at, &m->options, now_s, &error) != TD_OK) lose(m, error.message, now_s);
}

/* Images may come late, or not at all: the state has a link of its own. */
static void see_images(far_machine *m, double now_s)
{
    td_error unused;
    if (!m->now.open || m->images || now_s < m->images_again_s) return;
    const td_link_options o = machine_address_images(&m->options, m->welcome.session);
    m->images_again_s = now_s + AGAIN_S;
    (void)td_link_connect(&m->images, m->at, &o, now_s, &unused);
}

static void take_welcome(far_machine *m, const td_machine_welcome *w, double now_s)
{
    char why[300];
    m->welcome = *w;
    if (!w->is_operator)
        snprintf(why, sizeof why, "another operator commands the machine at %s", m->at);
    else if (strcmp(w->model, m->model) != 0 || w->joints != m->joints)
        snprintf(why, sizeof why, "the machine at %s is not that of the scenario: model %.8s, not %.8s",
                 m->at, w->model, m->model);
    else {
        m->now.open = true;
        m->now.has_state = false;
        m->now.why[0] = 0;
        m->silenced = false;
        report_text(m, FAR_LINKED, "%s: a %s, model %.8s", td_link_peer(m->link), w->robot, w->model);
        return;
    }
    lose(m, why, now_s);
}

static void take(far_machine *m, const td_machine_message *message, double now_s)
{
    far_heard h = {0};
    switch (message->kind) {
    case TD_MACHINE_WELCOME:
        take_welcome(m, &message->as.welcome, now_s);
        return;
    case TD_MACHINE_STATE:
        if (message->as.state.joints != m->joints) return;
        m->now.state = message->as.state;
        m->now.has_state = true;
        m->now.heard_s = now_s;
        show(m, now_s);
        return;
    case TD_MACHINE_ANSWER:
        h.kind = FAR_ANSWERED;
        h.answer = message->as.answer;
        break;
    case TD_MACHINE_STOPPED:
        h.kind = FAR_STOPPED;
        h.stopped = message->as.stopped;
        snprintf(h.answer.text, sizeof h.answer.text, "%s", h.stopped.why);
        break;
    default:
        return;
    }
    report(m, &h);
}

static void hear(far_machine *m, double now_s)
{
    static td_machine_message message; /* large; one machine a program */
    td_link_frame frame;
    td_error error = {0};
    td_link_poll(m->link, now_s);
    while (m->link && td_link_next(&frame, m->link)) {
        if (td_machine_decode(&message, frame.kind, frame.payload, frame.size, &error) != TD_OK) {
            lose(m, error.message, now_s);
            return;
        }
        take(m, &message, now_s);
    }
    if (m->link && td_link_state_of(m->link) == TD_LINK_CLOSED) {
        char why[300];
        snprintf(why, sizeof why, "%s: %s", m->at, td_link_why(m->link, NULL));
        lose(m, why, now_s);
    }
}

static void keep_picture(far_machine *m, const td_machine_image *image, double now_s)
{
    far_picture *p = lane_fresh(&m->pictures, sizeof *p);
    if (!p) return;
    uint8_t *bytes = realloc(p->bytes, image->size + 1);
    if (!bytes) {
        release_picture(p);
        return;
    }
    memcpy(bytes, image->jpeg, image->size);
    *p = (far_picture){.image = *image, .heard_s = now_s, .bytes = bytes};
    p->image.jpeg = bytes;
    (void)panel_ring_put(&m->pictures.there, p);
    m->wake(m->user);
}

static void hear_images(far_machine *m, double now_s)
{
    static td_machine_message message;
    td_link_frame frame;
    if (!m->images) return;
    td_link_poll(m->images, now_s);
    while (td_link_next(&frame, m->images))
        if (td_machine_decode(&message, frame.kind, frame.payload, frame.size, NULL) == TD_OK &&
            message.kind == TD_MACHINE_IMAGE)
            keep_picture(m, &message.as.image, now_s);
    if (td_link_state_of(m->images) == TD_LINK_CLOSED) td_link_free(&m->images);
}

/* ---- said ---- */

static void send(far_machine *m, const far_said *s)
{
    td_machine_message message = {.kind = s->kind};
    td_error error = {0};
    if (s->kind == TD_MACHINE_TASK) {
        message.as.task =
            (td_machine_task){.validation = s->validation, .text = s->text, .size = strlen(s->text)};
        report_text(m, FAR_TOLD, "task %s", s->validation.task);
    } else if (s->kind == TD_MACHINE_PLAN) {
        message.as.plan.text = s->text;
        message.as.plan.size = strlen(s->text);
    } else if (s->kind == TD_MACHINE_LOOK) {
        message.as.look = s->look;
    } else if (s->kind == TD_MACHINE_ORDER) {
        message.as.order = s->order;
        report_text(m, FAR_TOLD, "%s", td_machine_order_name(s->order));
    } else {
        message.as.joints.joints = m->joints;
        message.as.joints.command = s->command;
    }
    if (td_machine_send(m->link, &message, s->kind == TD_MACHINE_JOINTS, &error) != TD_OK &&
        s->kind != TD_MACHINE_JOINTS)
        report_text(m, FAR_ANSWERED, "it was not sent: %s", error.message);
}

/* What is said to a machine that is not there is lost: it stands, or stops by itself. */
static void say_all(far_machine *m)
{
    for (far_said *s; (s = panel_ring_take(&m->said.there)); lane_give_back(&m->said, s))
        if (m->now.open) send(m, s);
}

static void watch_session(far_machine *m, double now_s)
{
    static const far_said stop = {.kind = TD_MACHINE_ORDER, .order = TD_ORDER_STOP};
    const unsigned long long beat = atomic_load(&m->beats);
    const td_machine_mode mode = m->now.state.mode;
    const bool moves = m->now.open && m->now.has_state && (mode == TD_MODE_WORKING || mode == TD_MODE_MANUAL);
    if (beat != m->beat || !moves) {
        m->beat = beat;
        m->beat_s = now_s;
        m->silenced = false;
    }
    if (m->silenced || now_s < m->beat_s + m->silent_s) return;
    m->silenced = true;
    report_text(m, FAR_TOLD, "the session does not go on: the machine is stopped");
    send(m, &stop);
}

/* ---- the thread ---- */

static void wait(const far_machine *m)
{
    struct pollfd p[2];
    nfds_t n = 0;
    const td_link *const links[] = {m->link, m->images};
    for (int i = 0; i < 2; i++) {
        p[n] = (struct pollfd){.fd = -1};
        if (links[i]) p[n].fd = td_link_fd(links[i], &p[n].events);
        if (p[n].fd >= 0) n++;
    }
    (void)poll(p, n, (int)(1e3 * LOOK_S));
}

static void say_farewell(far_machine *m)
{
    const double until = td_machine_now_s() + FAREWELL_S;
    say_all(m);
    while (m->link && td_link_unsent(m->link) && td_machine_now_s() < until) {
        td_link_poll(m->link, td_machine_now_s());
        if (td_link_state_of(m->link) == TD_LINK_CLOSED) break;
        wait(m);
    }
    td_link_free(&m->images);
    td_link_free(&m->link);
}

static void *serve(void *user)
{
    static const struct sched_param soon = {.sched_priority = 10};
    far_machine *m = user;
    /* Where it may: the heart beats before anything that computes. */
    (void)pthread_setschedparam(pthread_self(), SCHED_FIFO, &soon);
    while (!atomic_load(&m->stop)) {
        const double now = td_machine_now_s();
        connect_again(m, now);
        if (m->link) hear(m, now);
        see_images(m, now);
        hear_images(m, now);
        say_all(m);
        watch_session(m, now);
        if (now > m->told_s + TELL_S) show(m, now);
        wait(m);
    }
    say_farewell(m);
    return NULL;
}

/* ---- from the start to the end ---- */

td_status far_machine_new(far_machine **machine, const machine_address *address, const char *model,
                          int joints, double silent_s, td_error *error)
{
    far_machine *m = *machine = calloc(1, sizeof *m);
    if (!m || !lane_begin(&m->states, STATES, free) || !lane_begin(&m->heard, LINES, free) ||
        !lane_begin(&m->shown, STATES, free) || !lane_begin(&m->lines, LINES, free) ||
        !lane_begin(&m->pictures, PICTURES, release_picture) || !lane_begin(&m->said, SAID, release_said))
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a machine's link");
    TD_TRY(machine_address_options(&m->options, m->token, address, error));
    snprintf(m->at, sizeof m->at, "%s", address->at);
    snprintf(m->model, sizeof m->model, "%s", model);
    snprintf(m->now.why, sizeof m->now.why, "%s: not reached yet", m->at);
    if (address->authority) {
        snprintf(m->authority, sizeof m->authority, "%s", address->authority);
        m->options.authority = m->authority;
    }
    m->joints = joints;
    m->silent_s = silent_s;
    atomic_init(&m->stop, false);
    atomic_init(&m->beats, 0);
    return TD_OK;
}

/* Signals are the main thread's. */
td_status far_machine_start(far_machine *m, void (*wake)(void *user), void *user, td_error *error)
{
    sigset_t all, before;
    sigfillset(&all);
    m->wake = wake;
    m->user = user;
    pthread_sigmask(SIG_SETMASK, &all, &before);
    m->started = pthread_create(&m->thread, NULL, serve, m) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return m->started ? TD_OK : td_fail(error, TD_ERROR_EXTERNAL, "the machine's thread cannot be started");
}

void far_machine_stop(far_machine *m)
{
    if (!m || !m->started) return;
    atomic_store(&m->stop, true);
    pthread_join(m->thread, NULL);
    m->started = false;
}

void far_machine_free(far_machine **machine)
{
    far_machine *m = *machine;
    if (!m) return;
    far_machine_stop(m);
    lane *const lanes[] = {&m->states, &m->heard, &m->shown, &m->lines, &m->pictures, &m->said};
    for (size_t i = 0; i < sizeof lanes / sizeof *lanes; i++) lane_end(lanes[i]);
    OPENSSL_cleanse(m->token, sizeof m->token);
    free(m);
    *machine = NULL;
}

/* ---- the session's thread ---- */

bool far_machine_state(far_measured *newest, far_machine *m)
{
    bool found = false;
    for (far_measured *x; (x = panel_ring_take(&m->states.there)); lane_give_back(&m->states, x)) {
        *newest = *x;
        found = true;
    }
    return found;
}

far_heard *far_machine_hear(far_machine *m)
{
    return panel_ring_take(&m->heard.there);
}

void far_machine_heard(far_machine *m, far_heard *heard)
{
    lane_give_back(&m->heard, heard);
}

bool far_machine_say(far_machine *m, const far_said *said)
{
    far_said *s = lane_fresh(&m->said, sizeof *s);
    if (!s) {
        free(said->text);
        return false;
    }
    free(s->text);
    *s = *said;
    if (panel_ring_offer(&m->said.there, s)) return true;
    release_said(s);
    return false;
}

void far_machine_beat(far_machine *m)
{
    atomic_fetch_add(&m->beats, 1);
}

void far_machine_model(char model[TD_HASH_HEX_SIZE], const far_machine *m)
{
    memcpy(model, m->model, TD_HASH_HEX_SIZE);
}

/* ---- the server's thread ---- */

far_measured *far_machine_shown(far_machine *m)
{
    return panel_ring_take(&m->shown.there);
}

void far_machine_was_shown(far_machine *m, far_measured *shown)
{
    lane_give_back(&m->shown, shown);
}

far_heard *far_machine_line(far_machine *m)
{
    return panel_ring_take(&m->lines.there);
}

void far_machine_lined(far_machine *m, far_heard *line)
{
    lane_give_back(&m->lines, line);
}

far_picture *far_machine_picture(far_machine *m)
{
    return panel_ring_take(&m->pictures.there);
}

void far_machine_pictured(far_machine *m, far_picture *picture)
{
    lane_give_back(&m->pictures, picture);
}
