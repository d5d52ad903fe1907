/* Clients' requests about parameters: told to who asks and who watches; set by who holds control, through the
 * session. */
#include <stdio.h>
#include <string.h>

#include "apps/panel_desk_internal.h"

static int find_parameter(const panel_desk *d, const char *name)
{
    for (int i = 0; i < d->o.parameter_count; i++)
        if (strcmp(d->o.parameter[i].name, name) == 0) return i;
    return -1;
}

/* Unknown ones are left out, as the protocol has it; no names: all. */
void desk_get_parameters(panel_desk *d, panel_client *client, const panel_request *r)
{
    json_t *list = json_array();
    const size_t count = json_array_size(r->parameters);
    for (size_t i = 0; i < count; i++) {
        const int p = find_parameter(d, json_string_value(json_array_get(r->parameters, i)));
        if (p >= 0) json_array_append_new(list, panel_parameter_json(d->o.parameter + p));
    }
    for (int p = 0; count == 0 && p < d->o.parameter_count; p++)
        json_array_append_new(list, panel_parameter_json(d->o.parameter + p));
    desk_reply(client, panel_parameter_values(list, r->id));
}

void desk_watch_parameters(panel_desk *d, panel_client *client, const panel_request *r)
{
    const size_t count = json_array_size(r->parameters);
    const bool watches = r->op == PANEL_WATCH_PARAMETERS;
    for (size_t i = 0; i < count; i++) {
        const int p = find_parameter(d, json_string_value(json_array_get(r->parameters, i)));
        if (p >= 0) client->watches[p] = watches;
    }
    for (int p = 0; count == 0 && p < d->o.parameter_count; p++) client->watches[p] = watches;
}

/* As it is: to who asked. */
static void show_parameter(panel_desk *d, panel_client *client, int p, const char *id)
{
    json_t *list = json_array();
    if (p >= 0) json_array_append_new(list, panel_parameter_json(d->o.parameter + p));
    desk_reply(client, panel_parameter_values(list, id));
}

void desk_set_parameter(panel_desk *d, panel_client *client, const json_t *item, const char *id)
{
    const char *name = json_string_value(json_object_get(item, "name")), *why = desk_not_leading(d, client);
    const int p = find_parameter(d, name);
    desk_pending waits = {.parameter = p};
    td_error error = {0};
    snprintf(waits.id, sizeof waits.id, "%s", id);
    if (!why && p < 0) why = "there is no parameter of that name";
    if (!why && panel_parameter_read(&waits.number, d->o.parameter + p, json_object_get(item, "value"),
                                     &error) != TD_OK)
        why = error.message;
    panel_order *o = why ? NULL : panel_link_fresh(&d->o.link->spent_orders, sizeof *o);
    if (!why && !o) why = "out of memory";
    if (!why) {
        json_t *fields = desk_about(client);
        *o = (panel_order){.event = TD_EVENT_COUNT, .parameter = p, .number = waits.number};
        json_object_set_new(fields, "request", json_string("setParameters"));
        json_object_set_new(fields, "parameter", json_string(name));
        json_object_set(fields, "value", json_object_get(item, "value"));
        why = desk_pass(d, client, &waits, o, fields);
    }
    if (!why) return;
    panel_desk_refuse(d, client, "setParameters", why);
    desk_reply(client, panel_status(PANEL_WARNING, why));
    show_parameter(d, client, p, id);
}

typedef struct change {
    panel_desk *desk;
    int parameter;
    const panel_client *but;
} change;

static void tell_change(panel_client *client, void *with)
{
    const change *c = with;
    if (client->watches[c->parameter] && client != c->but) show_parameter(c->desk, client, c->parameter, "");
}

void desk_parameter_is_set(panel_desk *d, const desk_pending *p, panel_client *client, const panel_news *news)
{
    if (news->accepted) panel_parameter_show(d->o.parameter + p->parameter, p->number);
    if (client) {
        if (!news->accepted) desk_reply(client, panel_status(PANEL_WARNING, news->text));
        show_parameter(d, client, p->parameter, p->id);
    }
    change c = {d, p->parameter, client};
    if (news->accepted) d->o.each(d->o.user, tell_change, &c);
}
