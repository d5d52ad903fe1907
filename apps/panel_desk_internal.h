/* The desk, between its files. */
#ifndef TELEDIMOS_APPS_PANEL_DESK_INTERNAL_H
#define TELEDIMOS_APPS_PANEL_DESK_INTERNAL_H

#include "apps/panel_internal.h"

enum { DESK_PENDING = 128 };

/* An order that the session has not answered. */
typedef struct desk_pending {
    uint64_t order, client;
    uint32_t service, call; /* from 1; 0: a parameter */
    int parameter;
    double number;
    char id[PANEL_ID_SIZE];
} desk_pending;

struct panel_desk {
    panel_desk_options o;
    uint64_t operator_number, orders;
    td_phase phase;
    char session[48]; /* this run of the server */
    desk_pending pending[DESK_PENDING];
    size_t pending_count;
};

/* `bytes` are taken. */
void desk_reply(panel_client *client, panel_bytes bytes);
/* Whose request it is, as the audit log has it. */
json_t *desk_about(const panel_client *client);
void desk_refuse_call(panel_desk *d, panel_client *client, const panel_request *r, const char *why);
/* Written, then passed on to the session. NULL, or why it was not. `order` and `fields` are taken. */
const char *desk_pass(panel_desk *d, const panel_client *client, const desk_pending *waits,
                      panel_order *order, json_t *fields);

/* panel_desk_control.c */

/* NULL: this client holds control; or why what it asks for is not for it. */
const char *desk_not_leading(const panel_desk *d, const panel_client *client);
void desk_take_control(panel_desk *d, panel_client *client, const panel_request *r);
void desk_release_control(panel_desk *d, panel_client *client, const panel_request *r);

/* panel_desk_parameters.c */

void desk_get_parameters(panel_desk *d, panel_client *client, const panel_request *r);
void desk_watch_parameters(panel_desk *d, panel_client *client, const panel_request *r);
/* `item`: one of those that are to be set by the request `id`. */
void desk_set_parameter(panel_desk *d, panel_client *client, const json_t *item, const char *id);
/* The session has answered. `client`: who asked; NULL: it is gone. */
void desk_parameter_is_set(panel_desk *d, const desk_pending *p, panel_client *client,
                           const panel_news *news);

#endif
