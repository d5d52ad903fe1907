/* The session's side of the panel: orders come out of a ring, what happens goes into two others. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "apps/panel_internal.h"
#include "apps/panel_lead.h"

enum { SAMPLES = 256, NEWS = 1024, ORDERS = 64, ASKED = 4 * ORDERS };

static const double HELD_S = 0.3; /* a Jog without a time of its own */

/* An order whose answer is not with the server yet. */
typedef struct asked {
    uint64_t order;
    td_event event;
    bool answered, accepted;
    char text[300];
} asked;

typedef struct panel_live {
    struct live live; /* the first: what the session sees */
    panel_link *link;
    scenario *scenario;
    const panel_parameter *parameter;
    double for_s;
    bool ending;
    task_input jog;
    long jog_until; /* period */
    asked asked[ASKED];
    size_t asked_count;
    task_ground ground; /* the last that was sent; its map is the run's */
    double sample_s, begun_s, begun_at_s;
    panel_lead lead; /* of the machine elsewhere */
} panel_live;

/* ---- the link ---- */

static void release_news(void *thing)
{
    panel_news *n = thing;
    td_elevation_free(&n->ground.map);
    free(n);
}

td_status panel_link_begin(panel_link *link, td_error *error)
{
    *link = (panel_link){0};
    atomic_init(&link->stop, false);
    atomic_init(&link->dropped, 0);
    if (panel_ring_begin(&link->samples, SAMPLES, free) &&
        panel_ring_begin(&link->news, NEWS, release_news) && panel_ring_begin(&link->orders, ORDERS, free) &&
        panel_ring_begin(&link->spent_samples, SAMPLES, free) &&
        panel_ring_begin(&link->spent_news, NEWS, release_news) &&
        panel_ring_begin(&link->spent_orders, ORDERS, free))
        return TD_OK;
    return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
}

void panel_link_end(panel_link *link)
{
    panel_ring_end(&link->samples);
    panel_ring_end(&link->news);
    panel_ring_end(&link->orders);
    panel_ring_end(&link->spent_samples);
    panel_ring_end(&link->spent_news);
    panel_ring_end(&link->spent_orders);
}

void *panel_link_fresh(panel_ring *spent, size_t size)
{
    void *thing = panel_ring_take(spent);
    if (!thing) return calloc(1, size);
    memset(thing, 0, size);
    return thing;
}

void panel_link_give_back(panel_ring *spent, void *thing)
{
    if (!panel_ring_offer(spent, thing)) spent->release(thing);
}

static panel_news *fresh_news(panel_live *l)
{
    panel_news *n = panel_ring_take(&l->link->spent_news);
    if (!n) return calloc(1, sizeof *n);
    td_elevation_free(&n->ground.map);
    *n = (panel_news){0};
    return n;
}

/* ---- orders ---- */

static asked *ask(panel_live *l, const panel_order *order)
{
    if (l->asked_count == ASKED) return NULL;
    asked *a = l->asked + l->asked_count++;
    *a = (asked){.order = order->order, .event = order->event};
    return a;
}

static td_status add(task_inputs *inputs, uint32_t *events, long period, td_event event, td_error *error)
{
    const task_input input = {.period = period, .event = event, .joint = -1};
    if (*events & TD_EVENT_BIT(event)) return TD_OK;
    *events |= TD_EVENT_BIT(event);
    return inputs_add(inputs, &input, error);
}

static bool is_busy(td_phase phase)
{
    return phase == TD_PHASE_SIMULATING || phase == TD_PHASE_SIMULATION_PAUSED ||
           phase == TD_PHASE_EXECUTING || phase == TD_PHASE_EXECUTION_PAUSED ||
           phase == TD_PHASE_DOWNLOADING || phase == TD_PHASE_MANUAL;
}

static td_status set_parameter(panel_live *l, const panel_order *order, long period, td_phase phase,
                               td_error *error)
{
    td_error why = {0};
    asked *a = ask(l, order);
    if (!a) return TD_OK;
    a->answered = true;
    if (is_busy(phase)) {
        snprintf(a->text, sizeof a->text, "refused: work is under way; Abort it first");
        return TD_OK;
    }
    a->accepted =
        panel_parameter_apply(l->parameter + order->parameter, order->number, l->scenario, &why) == TD_OK;
    snprintf(a->text, sizeof a->text, "%s%.280s",
             a->accepted ? "" : "refused: ", a->accepted ? "accepted" : why.message);
    if (!a->accepted) return TD_OK;
    l->live.changes++;
    panel_news *n = fresh_news(l);
    if (!n) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    *n = (panel_news){.kind = PANEL_CHANGE,
                      .parameter = order->parameter,
                      .period = period,
                      .time_s = (double)period * l->live.period_s};
    if (!panel_ring_offer(&l->link->news, n)) release_news(n);
    return TD_OK;
}

static td_status take_order(panel_live *l, const panel_order *order, task_inputs *inputs, uint32_t *events,
                            long period, td_phase phase, td_error *error)
{
    if (order->event == TD_EVENT_COUNT) return set_parameter(l, order, period, phase, error);
    (void)ask(l, order);
    if (order->event != TD_EVENT_JOG) return add(inputs, events, period, order->event, error);
    l->jog = (task_input){.event = TD_EVENT_JOG, .joint = order->joint, .stick = order->stick};
    l->jog_until = period + (long)ceil((order->for_s > 0 ? order->for_s : HELD_S) / l->live.period_s);
    return TD_OK;
}

/* The time is up, or somebody asked the program to end: the machine is stopped first. */
static bool ends_now(panel_live *l, long period)
{
    if (l->ending) return false;
    l->ending = terminal_interrupted() || (l->for_s > 0 && (double)period * l->live.period_s >= l->for_s);
    return l->ending;
}

/* Of orders of one kind that come together the first counts, and of Jogs the last: they get the same answer.
 * A Jog holds for its time; outside of manual it is refused once. */
static td_status take_orders(struct live *live, task_inputs *inputs, long period, td_phase phase,
                             td_error *error)
{
    panel_live *l = (panel_live *)live;
    uint32_t events = 0;
    td_status status = TD_OK;
    if (period == 0) TD_TRY(add(inputs, &events, period, TD_EVENT_PREPARE, error));
    if (ends_now(l, period) || atomic_exchange(&l->link->stop, false)) {
        l->jog_until = 0;
        TD_TRY(add(inputs, &events, period, TD_EVENT_USER_STOP, error));
    }
    for (panel_order *o; status == TD_OK && (o = panel_ring_take(&l->link->orders));
         panel_link_give_back(&l->link->spent_orders, o))
        status = take_order(l, o, inputs, &events, period, phase, error);
    if (status != TD_OK || period >= l->jog_until) return status;
    if (phase != TD_PHASE_MANUAL) l->jog_until = 0;
    l->jog.period = period;
    return inputs_add(inputs, &l->jog, error);
}

static void take_answers(struct live *live, uint32_t events, const td_answer *answer)
{
    panel_live *l = (panel_live *)live;
    for (size_t i = 0; i < l->asked_count; i++) {
        asked *a = l->asked + i;
        if (a->answered || a->event == TD_EVENT_COUNT || !(events & TD_EVENT_BIT(a->event))) continue;
        a->answered = true;
        a->accepted = answer[a->event] == TD_ANSWER_ACCEPTED;
        snprintf(a->text, sizeof a->text, "%s", td_answer_text(answer[a->event]));
    }
}

/* ---- what happens ---- */

/* What the ring has no room for is kept for the next period. */
static td_status send_answers(panel_live *l, td_error *error)
{
    size_t left = 0;
    for (size_t i = 0; i < l->asked_count; i++) {
        const asked *a = l->asked + i;
        panel_news *n = a->answered ? fresh_news(l) : NULL;
        if (a->answered && !n) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
        if (n) {
            *n = (panel_news){.kind = PANEL_ANSWER, .order = a->order, .accepted = a->accepted};
            memcpy(n->text, a->text, sizeof n->text);
            if (panel_ring_offer(&l->link->news, n)) continue;
            release_news(n);
        }
        l->asked[left++] = *a;
    }
    l->asked_count = left;
    return TD_OK;
}

/* Those that are sent are the server's; the session keeps none. */
static td_status send_notes(panel_live *l, task_run *run, td_error *error)
{
    size_t sent = 0;
    for (; sent < run->note_count; sent++) {
        panel_news *n = fresh_news(l);
        if (!n) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
        n->kind = PANEL_NOTE;
        n->note = run->note[sent];
        if (panel_ring_offer(&l->link->news, n)) continue;
        release_news(n);
        break;
    }
    memmove(run->note, run->note + sent, (run->note_count - sent) * sizeof *run->note);
    run->note_count -= sent;
    run->input.count = 0;
    return TD_OK;
}

static td_status send_ground(panel_live *l, const task_run *run, td_error *error)
{
    const task_ground *g = run->ground_count ? run->ground + run->ground_count - 1 : NULL;
    if (!g || (g->map == l->ground.map && g->time_s == l->ground.time_s)) return TD_OK;
    panel_news *n = fresh_news(l);
    if (!n) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    n->kind = PANEL_GROUND;
    n->ground.time_s = g->time_s;
    const td_status status = td_elevation_copy(&n->ground.map, g->map, error);
    if (status == TD_OK && panel_ring_offer(&l->link->news, n)) {
        l->ground = *g;
        return TD_OK;
    }
    release_news(n);
    return status;
}

static td_status send_sample(panel_live *l, const live_view *v, td_error *error)
{
    const task_sample *a = v->run->count ? v->run->sample + v->run->count - 1 : NULL;
    const td_clock_counts *c = &l->live.clock.counts;
    if (!a || a->time_s == l->sample_s) return TD_OK;
    panel_sample *s = panel_link_fresh(&l->link->spent_samples, sizeof *s);
    if (!s) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    if (l->begun_s == 0) l->begun_s = terminal_now_s(), l->begun_at_s = v->time_s;
    const double passed = terminal_now_s() - l->begun_s;
    *s = (panel_sample){.sample = *a,
                        .period = v->period,
                        .steps = v->steps,
                        .offers = v->offers,
                        .ticks = c->ticks,
                        .misses = c->misses,
                        .late_p99_s = 1e-9 * (double)td_clock_late(c, 0.99),
                        .late_max_s = 1e-9 * (double)c->late_max_ns,
                        .speed = passed > 0 ? (v->time_s - l->begun_at_s) / passed : 1};
    s->sample.phase = v->phase;
    l->sample_s = a->time_s;
    if (panel_ring_put(&l->link->samples, s)) atomic_fetch_add(&l->link->dropped, 1);
    return TD_OK;
}

static td_status show(struct live *live, const live_view *view, td_error *error)
{
    panel_live *l = (panel_live *)live;
    TD_TRY(send_answers(l, error));
    TD_TRY(send_notes(l, view->run, error));
    TD_TRY(send_ground(l, view->run, error));
    TD_TRY(send_sample(l, view, error));
    l->link->wake(l->link->user);
    return TD_OK;
}

static td_status send_plan(struct live *live, const live_plan *plan, td_error *error)
{
    panel_live *l = (panel_live *)live;
    panel_news *n = fresh_news(l);
    if (!n) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    n->kind = PANEL_PLAN;
    n->plan = *plan;
    if (!panel_ring_offer(&l->link->news, n)) release_news(n); /* the next one will be seen */
    return TD_OK;
}

static bool is_attended(const struct live *live)
{
    return !((const panel_live *)live)->ending;
}

/* ---- a machine elsewhere ---- */

static void look(struct live *live, td_phase phase, live_seen *seen)
{
    panel_lead_look(&((panel_live *)live)->lead, phase, seen);
}

static td_status lead(struct live *live, const live_lead *what, td_error *error)
{
    panel_live *l = (panel_live *)live;
    return panel_lead_on(&l->lead, what, l->scenario->robot->joint_count, error);
}

/* ---- from the start to the end ---- */

td_status panel_live_begin(struct live **live, panel_link *link, scenario *s, const panel_parameter *list,
                           const panel_options *options, td_log log, td_error *error)
{
    panel_live *l = calloc(1, sizeof *l);
    *live = NULL;
    if (!l) return td_fail(error, TD_ERROR_MEMORY, "no memory for a session");
    l->live.lasting = true;
    l->live.inputs = take_orders;
    l->live.answered = take_answers;
    l->live.attended = is_attended;
    l->live.show = show;
    l->live.planned = send_plan;
    l->link = link;
    l->scenario = s;
    l->parameter = list;
    l->for_s = options->for_s;
    if (options->machine) {
        l->lead.machine = options->machine;
        l->live.look = look;
        l->live.lead = lead;
    }
    l->sample_s = -1;
    live_pace(&l->live, s, log);
    *live = &l->live;
    return TD_OK;
}

void panel_live_end(struct live **live)
{
    if (!live || !*live) return;
    (void)munlockall();
    free((panel_live *)*live);
    *live = NULL;
}
