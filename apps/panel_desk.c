/* Where clients' requests are judged: subscriptions, services, the session's answers; the audit log.
 *
 * Each order is written into the audit log before it is passed on, and so is the answer; what cannot be
 * written is refused. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "apps/panel_desk_internal.h"
#include "core/document.h"

enum { MOST_FAULTS = 20, KEPT_FOR_STOPS = 16 };

#define OBJECT(fields) "{\"type\":\"object\",\"additionalProperties\":false,\"properties\":{" fields "}}"
#define NOTHING OBJECT("")
#define ANSWER OBJECT("\"answer\":{\"type\":\"string\"}")
#define HOLDER OBJECT("\"operator\":{\"type\":\"integer\"}")

typedef struct service {
    panel_service about;
    td_event event;   /* TD_EVENT_COUNT: control */
    const char *keys; /* of its arguments, each between blanks; NULL: none */
} service;

#define ORDER(name, event)                                                                                   \
    {                                                                                                        \
        {name, NOTHING, ANSWER}, event, NULL                                                                 \
    }

static const service services[] = {
    {{"TakeControl", NOTHING, HOLDER}, TD_EVENT_COUNT, NULL},
    {{"ReleaseControl", OBJECT("\"to\":{\"type\":\"integer\",\"description\":\"the client who gets it\"}"),
      HOLDER},
     TD_EVENT_COUNT,
     " to "},
    ORDER("Prepare", TD_EVENT_PREPARE),
    ORDER("StartSim", TD_EVENT_START),
    ORDER("Pause", TD_EVENT_PAUSE),
    ORDER("Resume", TD_EVENT_RESUME),
    ORDER("Abort", TD_EVENT_ABORT),
    ORDER("UserStop", TD_EVENT_USER_STOP),
    ORDER("Reinit", TD_EVENT_REINIT),
    ORDER("Validate", TD_EVENT_VALIDATE),
    ORDER("Download", TD_EVENT_DOWNLOAD),
    ORDER("Execute", TD_EVENT_EXECUTE),
    ORDER("Manual", TD_EVENT_MANUAL),
    ORDER("Automatic", TD_EVENT_AUTOMATIC),
    {{"Jog",
      "{\"type\":\"object\",\"additionalProperties\":false,\"required\":[\"joint\",\"stick\"],\"properties\":"
      "{"
      "\"joint\":{\"type\":\"string\"},\"stick\":{\"type\":\"number\",\"minimum\":-1,\"maximum\":1},"
      "\"for_s\":{\"type\":\"number\",\"minimum\":0,\"maximum\":1}}}",
      ANSWER},
     TD_EVENT_JOG,
     " joint stick for_s "},
};
enum { SERVICES = sizeof services / sizeof *services, TAKE = 0, RELEASE = 1 };

panel_desk *panel_desk_new(const panel_desk_options *options)
{
    panel_desk *d = calloc(1, sizeof *d);
    if (!d) return NULL;
    d->o = *options;
    snprintf(d->session, sizeof d->session, "%lld-%ld", (long long)time(NULL), (long)getpid());
    return d;
}

void panel_desk_free(panel_desk **desk)
{
    free(*desk);
    *desk = NULL;
}

uint64_t panel_desk_operator(const panel_desk *desk)
{
    return desk->operator_number;
}

void panel_desk_phase(panel_desk *desk, td_phase phase)
{
    desk->phase = phase;
}

void panel_desk_note(panel_desk *desk, const char *what, json_t *fields)
{
    (void)audit_write(desk->o.audit, what, fields);
}

/* ---- telling ---- */

static void close_for(panel_client *client, const char *why)
{
    if (!client->why[0]) snprintf(client->why, sizeof client->why, "%s", why);
}

void desk_reply(panel_client *client, panel_bytes bytes)
{
    if (!panel_reply_add(&client->box, bytes)) close_for(client, "its answers pile up unread");
}

json_t *desk_about(const panel_client *client)
{
    return json_pack("{s:I, s:s}", "client", (json_int_t)client->number, "peer", client->peer);
}

void panel_desk_refuse(panel_desk *d, panel_client *client, const char *what, const char *why)
{
    json_t *fields = desk_about(client);
    d->o.counts->refused++;
    json_object_set_new(fields, "request", json_string(what));
    json_object_set_new(fields, "why", json_string(why));
    if (client->number == d->operator_number)
        (void)audit_write(d->o.audit, "refused", fields);
    else
        audit_stranger(d->o.audit, "refused", fields);
}

static void fault(panel_desk *d, panel_client *client, const char *what, const char *why)
{
    d->o.counts->faults++;
    panel_desk_refuse(d, client, what, why);
    desk_reply(client, panel_status(PANEL_ERROR, why));
    if (++client->faults >= MOST_FAULTS) close_for(client, "too many messages that are none");
}

/* ---- the newcomer ---- */

void panel_desk_greet(panel_desk *d, panel_client *client)
{
    enum { MOST = SERVICES + 32 };
    size_t benches;
    const panel_bench_service *bench = panel_bench_services(d->o.bench, &benches);
    panel_service list[MOST];
    char name[200];
    for (int i = 0; i < SERVICES; i++) list[i] = services[i].about;
    for (size_t i = 0; i < benches && i < MOST - SERVICES; i++) list[SERVICES + i] = bench[i].about;
    snprintf(name, sizeof name, "teledimos panel: %s", d->o.scenario->name);
    desk_reply(client, panel_server_info(name, d->session, client->number));
    desk_reply(client, panel_advertise(d->o.channel, d->o.channel_count));
    desk_reply(client, panel_advertise_services(list, SERVICES + benches));
}

/* ---- orders ---- */

void desk_refuse_call(panel_desk *d, panel_client *client, const panel_request *r, const char *why)
{
    const bool known = r->service >= 1 && r->service <= SERVICES;
    panel_desk_refuse(d, client, known ? services[r->service - 1].about.name : "a service call", why);
    desk_reply(client, panel_failure(r->service, r->call, why));
}

/* Written, then passed on. NULL, or why it was not. `order` is taken. */
const char *desk_pass(panel_desk *d, const panel_client *client, const desk_pending *waits,
                      panel_order *order, json_t *fields)
{
    order->order = ++d->orders;
    json_object_set_new(fields, "order", json_integer((json_int_t)order->order));
    const bool stops = order->event == TD_EVENT_USER_STOP || order->event == TD_EVENT_ABORT ||
                       order->event == TD_EVENT_PAUSE;
    const size_t room = stops ? DESK_PENDING : DESK_PENDING - KEPT_FOR_STOPS;
    const char *why = d->pending_count >= room ? "too many orders wait for their answers" : NULL;
    if (!why && !audit_write(d->o.audit, "order", json_incref(fields)) && !stops)
        why = "the audit log cannot be written";
    json_decref(fields);
    if (!why && !panel_ring_offer(&d->o.link->orders, order)) why = "the session takes no orders now";
    if (why) {
        free(order);
        return why;
    }
    desk_pending *p = d->pending + d->pending_count++;
    *p = *waits;
    p->order = d->orders;
    p->client = client->number;
    d->o.counts->orders++;
    return NULL;
}

/* The arguments of a Jog. */
static const char *read_jog(panel_order *o, const panel_desk *d, const json_t *arguments)
{
    const char *joint = json_string_value(json_object_get(arguments, "joint"));
    const json_t *stick = json_object_get(arguments, "stick"), *for_s = json_object_get(arguments, "for_s");
    o->joint = joint ? td_robot_find_joint(d->o.scenario->robot, joint) : -1;
    if (o->joint < 0) return "joint: the robot has none of that name";
    o->stick = json_number_value(stick);
    if (!json_is_number(stick) || !(fabs(o->stick) <= 1)) return "stick: a number from -1 to 1";
    o->for_s = json_number_value(for_s);
    if (for_s && (!json_is_number(for_s) || !(o->for_s >= 0 && o->for_s <= 1)))
        return "for_s: a number from 0 to 1";
    return NULL;
}

static const char *check_keys(const char *keys, const json_t *arguments)
{
    const char *key;
    char blanks[64];
    json_t *value;
    json_object_foreach((json_t *)arguments, key, value)
    {
        snprintf(blanks, sizeof blanks, " %s ", key);
        if (!keys || strlen(key) > 60 || strchr(key, ' ') || !strstr(keys, blanks))
            return "an argument that this service has not";
    }
    return NULL;
}

static void call_order(panel_desk *d, panel_client *client, const panel_request *r)
{
    const service *s = services + r->service - 1;
    panel_order *o = panel_link_fresh(&d->o.link->spent_orders, sizeof *o);
    json_t *fields = desk_about(client);
    if (!o || !fields) {
        free(o);
        json_decref(fields);
        desk_refuse_call(d, client, r, "out of memory");
        return;
    }
    o->event = s->event;
    const char *why = s->event == TD_EVENT_JOG ? read_jog(o, d, r->arguments) : NULL;
    json_object_set_new(fields, "request", json_string(s->about.name));
    if (json_object_size(r->arguments)) json_object_set(fields, "arguments", r->arguments);
    if (why) {
        free(o);
        json_decref(fields);
    } else {
        const desk_pending waits = {.service = r->service, .call = r->call};
        why = desk_pass(d, client, &waits, o, fields);
    }
    if (why) desk_refuse_call(d, client, r, why);
}

/* ---- benches ---- */

static const panel_bench_service *bench_service(const panel_desk *d, uint32_t number)
{
    size_t count;
    const panel_bench_service *list = panel_bench_services(d->o.bench, &count);
    return number > SERVICES && number - SERVICES <= count ? list + number - SERVICES - 1 : NULL;
}

static void refuse_bench(panel_desk *d, panel_client *client, uint32_t number, uint32_t of_call,
                         const char *name, const char *why)
{
    panel_desk_refuse(d, client, name, why);
    desk_reply(client, panel_failure(number, of_call, why));
}

/* What leaves something behind is for who holds control, and stands in the audit log. */
static const char *may_lead(panel_desk *d, const panel_client *client, const panel_request *r,
                            const panel_bench_service *s)
{
    if (!s->led) return NULL;
    const char *why = desk_not_leading(d, client);
    if (why) return why;
    json_t *fields = desk_about(client);
    json_object_set_new(fields, "request", json_string(s->about.name));
    if (json_object_size(r->arguments)) json_object_set(fields, "arguments", r->arguments);
    return audit_write(d->o.audit, "bench", fields) ? NULL : "the audit log cannot be written";
}

static void call_bench(panel_desk *d, panel_client *client, const panel_request *r)
{
    enum { MOST_UNREAD = 8 }; /* pictures are large */
    const panel_bench_service *s = bench_service(d, r->service);
    const char *why = check_keys(s->keys, r->arguments);
    if (!why && client->box.replies > MOST_UNREAD) why = "answers wait to be read";
    if (!why) why = may_lead(d, client, r, s);
    if (!why)
        why = panel_bench_call(d->o.bench, client->number, client->number == d->operator_number, r->service,
                               r->call, s, r->arguments);
    if (why) refuse_bench(d, client, r->service, r->call, s->about.name, why);
}

void panel_desk_bench(panel_desk *d, const panel_bench_answer *a)
{
    panel_client *client = a->client ? d->o.find(d->o.user, a->client) : NULL;
    if (client && a->json)
        desk_reply(client, panel_response(a->service, a->call, json_incref(a->json)));
    else if (client && a->call)
        refuse_bench(d, client, a->service, a->call, a->name, a->why);
    else if (client)
        desk_reply(client, panel_status(PANEL_WARNING, a->why));
    json_decref(a->json);
    if (!a->name)
        audit_stranger(d->o.audit, "bench ended",
                       json_pack("{s:I, s:s}", "client", (json_int_t)a->client, "why", a->why));
}

/* Calls of a connection rise in their numbers, so that one that was sent before is known. */
static void call(panel_desk *d, panel_client *client, const panel_request *r)
{
    const bool again = client->called && r->call <= client->last_call;
    if (again) {
        desk_refuse_call(d, client, r, "replayed: the numbers of a connection's calls must rise");
        return;
    }
    client->called = true;
    client->last_call = r->call;
    if (r->service > SERVICES && bench_service(d, r->service)) {
        call_bench(d, client, r);
        return;
    }
    if (r->service < 1 || r->service > SERVICES) {
        desk_refuse_call(d, client, r, "there is no service of that number");
        return;
    }
    const char *why = check_keys(services[r->service - 1].keys, r->arguments);
    const bool takes = r->service == TAKE + 1;
    if (!why && !takes) why = desk_not_leading(d, client);
    if (why)
        desk_refuse_call(d, client, r, why);
    else if (takes)
        desk_take_control(d, client, r);
    else if (r->service == RELEASE + 1)
        desk_release_control(d, client, r);
    else
        call_order(d, client, r);
}

/* ---- what comes in ---- */

void panel_desk_answer(panel_desk *d, const panel_news *news)
{
    size_t i = 0;
    while (i < d->pending_count && d->pending[i].order != news->order) i++;
    if (i == d->pending_count) return;
    const desk_pending p = d->pending[i];
    d->pending[i] = d->pending[--d->pending_count];
    panel_client *client = d->o.find(d->o.user, p.client);
    (void)audit_write(d->o.audit, "answer",
                      json_pack("{s:I, s:I, s:b, s:s}", "order", (json_int_t)p.order, "client",
                                (json_int_t)p.client, "accepted", news->accepted, "answer", news->text));
    if (news->accepted) {
        audit_sync(d->o.audit); /* before anybody is told so; the session went on long ago */
        d->o.counts->accepted++;
    } else {
        d->o.counts->refused++;
    }
    if (!p.service)
        desk_parameter_is_set(d, &p, client, news);
    else if (client && news->accepted)
        desk_reply(client, panel_response(p.service, p.call, json_pack("{s:s}", "answer", news->text)));
    else if (client)
        desk_reply(client, panel_failure(p.service, p.call, news->text));
}

static void subscribe(panel_desk *d, panel_client *client, const panel_request *r)
{
    for (size_t i = 0; i < r->count; i++) {
        const panel_subscription *s = r->subscription + i;
        if (s->channel < 1 || s->channel > d->o.channel_count)
            fault(d, client, "subscribe", "there is no channel of that number");
        else if (!panel_subscribe(&client->box, d->o.hub, s->id, (int)s->channel - 1))
            fault(d, client, "subscribe", "that id is in use, or there are 64 subscriptions already");
    }
}

static void unsubscribe(panel_desk *d, panel_client *client, const panel_request *r)
{
    for (size_t i = 0; i < r->count; i++)
        if (!panel_unsubscribe(&client->box, r->subscription[i].id))
            fault(d, client, "unsubscribe", "there is no subscription of that id");
}

void panel_desk_take(panel_desk *d, panel_client *client, const void *bytes, size_t size, bool binary)
{
    panel_request r;
    td_error error = {0};
    if (panel_request_parse(&r, bytes, size, binary, &error) != TD_OK) {
        fault(d, client, "a message", error.message);
        if (binary && r.op == PANEL_CALL && r.call)
            desk_reply(client, panel_failure(r.service, r.call, error.message));
        return;
    }
    switch (r.op) {
    case PANEL_SUBSCRIBE:
        subscribe(d, client, &r);
        break;
    case PANEL_UNSUBSCRIBE:
        unsubscribe(d, client, &r);
        break;
    case PANEL_GET_PARAMETERS:
        desk_get_parameters(d, client, &r);
        break;
    case PANEL_SET_PARAMETERS:
        for (size_t i = 0; i < json_array_size(r.parameters); i++)
            desk_set_parameter(d, client, json_array_get(r.parameters, i), r.id);
        break;
    case PANEL_CALL:
        call(d, client, &r);
        break;
    default:
        desk_watch_parameters(d, client, &r);
        break;
    }
    panel_request_free(&r);
}
