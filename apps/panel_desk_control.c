/* One operator holds control, the others watch. It is taken (TakeControl) where nobody holds it, handed over
 * (ReleaseControl with `to`), given back (ReleaseControl, while nothing moves), and lost with its connection:
 * then the machine is stopped (UserStop). */
#include <stdio.h>

#include "apps/panel_desk_internal.h"

const char *desk_not_leading(const panel_desk *d, const panel_client *client)
{
    if (d->operator_number == client->number) return NULL;
    return d->operator_number ? "another client holds control" : "nobody holds control: TakeControl first";
}

static bool moves(td_phase phase)
{
    return phase == TD_PHASE_SIMULATING || phase == TD_PHASE_SIMULATION_PAUSED ||
           phase == TD_PHASE_EXECUTING || phase == TD_PHASE_EXECUTION_PAUSED ||
           phase == TD_PHASE_DOWNLOADING || phase == TD_PHASE_MANUAL;
}

static void tell_one(panel_client *client, void *text)
{
    desk_reply(client, panel_status(PANEL_INFO, text));
}

static void give_control(panel_desk *d, uint64_t to)
{
    char text[120];
    d->operator_number = to;
    if (to)
        snprintf(text, sizeof text, "client %llu holds control", (unsigned long long)to);
    else
        snprintf(text, sizeof text, "nobody holds control");
    d->o.each(d->o.user, tell_one, text);
}

static bool note_control(panel_desk *d, const panel_client *client, const char *how, uint64_t to)
{
    json_t *fields = desk_about(client);
    json_object_set_new(fields, "how", json_string(how));
    json_object_set_new(fields, "operator", json_integer((json_int_t)to));
    return audit_write(d->o.audit, "control", fields);
}

static void answer_control(panel_desk *d, panel_client *client, const panel_request *r)
{
    desk_reply(client, panel_response(r->service, r->call,
                                      json_pack("{s:I}", "operator", (json_int_t)d->operator_number)));
}

void desk_take_control(panel_desk *d, panel_client *client, const panel_request *r)
{
    char text[200];
    panel_client *holder = d->operator_number ? d->o.find(d->o.user, d->operator_number) : NULL;
    if (holder && holder != client) {
        snprintf(text, sizeof text,
                 "client %llu asks for control: ReleaseControl with to: %llu hands it over",
                 (unsigned long long)client->number, (unsigned long long)client->number);
        desk_reply(holder, panel_status(PANEL_WARNING, text));
        snprintf(text, sizeof text, "client %llu (%s) holds control; it was told that you ask for it",
                 (unsigned long long)holder->number, holder->peer);
        desk_refuse_call(d, client, r, text);
        return;
    }
    if (!note_control(d, client, "taken", client->number)) {
        desk_refuse_call(d, client, r, "the audit log cannot be written");
        return;
    }
    give_control(d, client->number);
    answer_control(d, client, r);
}

void desk_release_control(panel_desk *d, panel_client *client, const panel_request *r)
{
    const json_t *to = json_object_get(r->arguments, "to");
    const json_int_t number = json_is_integer(to) ? json_integer_value(to) : 0;
    const panel_client *next = number > 0 ? d->o.find(d->o.user, (uint64_t)number) : NULL;
    if (to && !next)
        desk_refuse_call(d, client, r, "there is no client of that number to hand control to");
    else if (!next && moves(d->phase))
        desk_refuse_call(d, client, r,
                         "refused: work is under way; Abort it first, or hand control over with `to`");
    else if (!note_control(d, client, next ? "handed over" : "released", next ? next->number : 0))
        desk_refuse_call(d, client, r, "the audit log cannot be written");
    else {
        give_control(d, next ? next->number : 0);
        answer_control(d, client, r);
    }
}

void panel_desk_leave(panel_desk *d, panel_client *client, const char *why)
{
    json_t *fields = desk_about(client);
    json_object_set_new(fields, "why", json_string(why));
    json_object_set_new(fields, "sent", json_integer((json_int_t)client->box.sent));
    json_object_set_new(fields, "skipped", json_integer((json_int_t)client->box.skipped));
    audit_stranger(d->o.audit, "disconnect", fields);
    d->o.counts->sent += client->box.sent;
    d->o.counts->skipped += client->box.skipped;
    panel_bench_leave(d->o.bench, client->number);
    if (d->operator_number != client->number) return;
    /* Whatever the log says: a machine that nobody leads is stopped. */
    atomic_store(&d->o.link->stop, true);
    (void)note_control(d, client, "lost: UserStop", 0);
    give_control(d, 0);
}
