/* The Foxglove WebSocket protocol (https://github.com/foxglove/ws-protocol, docs/spec.md), the server's side,
 * as functions of bytes alone: what a client sent as a struct, what it is sent as bytes.
 *
 *   from a client, text    subscribe, unsubscribe, getParameters, setParameters, subscribeParameterUpdates,
 *                          unsubscribeParameterUpdates; what we do not offer is told as such
 *                  binary  2: service call request
 *   to a client,   text    serverInfo, advertise, advertiseServices, serviceCallFailure, parameterValues,
 *                          status
 *                  binary  1: message data, 2: time, 3: service call response
 *
 * Whole numbers are little-endian. Channels and services are numbered from 1, in the order of their lists. */
#ifndef TELEDIMOS_APPS_PANEL_PROTOCOL_H
#define TELEDIMOS_APPS_PANEL_PROTOCOL_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/mcap.h"
#include "core/status.h"

/* In the order we prefer them; they say the same of what is used here. */
#define PANEL_PROTOCOL_SDK "foxglove.sdk.v1"
#define PANEL_PROTOCOL_WEBSOCKET "foxglove.websocket.v1"

enum {
    PANEL_MAX_REQUEST = 1 << 16, /* bytes of one message from a client */
    PANEL_MAX_LIST = 256,        /* subscriptions or parameters in it */
    PANEL_ID_SIZE = 64,
    PANEL_MESSAGE_HEAD = 13,
    PANEL_TIME_SIZE = 9
};

typedef enum panel_op {
    PANEL_SUBSCRIBE,
    PANEL_UNSUBSCRIBE,
    PANEL_GET_PARAMETERS,
    PANEL_SET_PARAMETERS,
    PANEL_WATCH_PARAMETERS,
    PANEL_UNWATCH_PARAMETERS,
    PANEL_CALL
} panel_op;
const char *panel_op_name(panel_op op);

typedef struct panel_subscription {
    uint32_t id, channel; /* unsubscribe: no channel */
} panel_subscription;

typedef struct panel_request {
    panel_op op;
    size_t count;
    panel_subscription *subscription; /* (count) */
    json_t *parameters;               /* array of names, or of {name, value}; NULL: none */
    char id[PANEL_ID_SIZE];           /* of the request, to be given back; "": none */
    uint32_t service, call;
    json_t *arguments; /* of the call: an object */
} panel_request;

/* Refused, with what is wrong: what is no message of the protocol, or one that we do not offer. */
td_status panel_request_parse(panel_request *request, const void *bytes, size_t size, bool binary,
                              td_error *error);
void panel_request_free(panel_request *request);

/* To be freed with free(); NULL: out of memory. */
typedef struct panel_bytes {
    unsigned char *data;
    size_t size;
    bool binary;
} panel_bytes;

typedef struct panel_service {
    const char *name;
    const char *request, *response; /* JSON schemas */
} panel_service;

/* `client`: the number of the one who is told. */
panel_bytes panel_server_info(const char *name, const char *session, uint64_t client);
panel_bytes panel_advertise(const td_mcap_channel *channel, size_t count);
panel_bytes panel_advertise_services(const panel_service *service, size_t count);
/* What stands before the message's own bytes. */
void panel_message_head(unsigned char head[PANEL_MESSAGE_HEAD], uint32_t subscription, uint64_t time_ns);
void panel_time(unsigned char bytes[PANEL_TIME_SIZE], uint64_t time_ns);
/* `json` is taken. */
panel_bytes panel_response(uint32_t service, uint32_t call, json_t *json);
panel_bytes panel_failure(uint32_t service, uint32_t call, const char *text);
/* An array of {name, value, type}; taken. */
panel_bytes panel_parameter_values(json_t *parameters, const char *id);
typedef enum panel_level { PANEL_INFO, PANEL_WARNING, PANEL_ERROR } panel_level;
panel_bytes panel_status(panel_level level, const char *text);

#endif
