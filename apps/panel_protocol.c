#include "apps/panel_protocol.h"

#include <stdlib.h>
#include <string.h>

enum { OP_MESSAGE = 1, OP_TIME = 2, OP_RESPONSE = 3, OP_CALL = 2 };

static const char *const names[] = {"subscribe",
                                    "unsubscribe",
                                    "getParameters",
                                    "setParameters",
                                    "subscribeParameterUpdates",
                                    "unsubscribeParameterUpdates",
                                    "a service call"};

const char *panel_op_name(panel_op op)
{
    return names[op];
}

/* ---- bytes ---- */

static void put(unsigned char **at, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++) *(*at)++ = (unsigned char)(value >> 8 * i);
}

static uint32_t get(const unsigned char *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* ---- from a client ---- */

void panel_request_free(panel_request *request)
{
    free(request->subscription);
    json_decref(request->parameters);
    json_decref(request->arguments);
    *request = (panel_request){0};
}

static bool number_of(uint32_t *number, const json_t *value)
{
    const json_int_t n = json_is_integer(value) ? json_integer_value(value) : -1;
    *number = (uint32_t)n;
    return n >= 0 && n <= UINT32_MAX;
}

static td_status read_subscriptions(panel_request *r, const json_t *root, td_error *error)
{
    const bool subscribes = r->op == PANEL_SUBSCRIBE;
    const char *key = subscribes ? "subscriptions" : "subscriptionIds";
    const json_t *list = json_object_get(root, key);
    if (!json_is_array(list) || json_array_size(list) > PANEL_MAX_LIST)
        return td_fail(error, TD_ERROR_FORMAT, "%s: '%s' must be a list of at most %d", names[r->op], key,
                       PANEL_MAX_LIST);
    r->count = json_array_size(list);
    r->subscription = calloc(r->count + 1, sizeof *r->subscription);
    if (!r->subscription) return td_fail(error, TD_ERROR_MEMORY, "no memory for a request");
    for (size_t i = 0; i < r->count; i++) {
        const json_t *item = json_array_get(list, i);
        panel_subscription *s = r->subscription + i;
        if (!number_of(&s->id, subscribes ? json_object_get(item, "id") : item) ||
            (subscribes && !number_of(&s->channel, json_object_get(item, "channelId"))))
            return td_fail(error, TD_ERROR_FORMAT, "%s: %s[%zu] has no whole number as id%s", names[r->op],
                           key, i, subscribes ? " and channelId" : "");
    }
    return TD_OK;
}

/* Names, or a name in each object. */
static td_status read_parameters(panel_request *r, const json_t *root, td_error *error)
{
    const bool sets = r->op == PANEL_SET_PARAMETERS;
    const char *key = sets ? "parameters" : "parameterNames";
    json_t *list = json_object_get(root, key);
    const json_t *id = json_object_get(root, "id");
    if (!json_is_array(list) || json_array_size(list) > PANEL_MAX_LIST)
        return td_fail(error, TD_ERROR_FORMAT, "%s: '%s' must be a list of at most %d", names[r->op], key,
                       PANEL_MAX_LIST);
    for (size_t i = 0; i < json_array_size(list); i++) {
        const json_t *item = json_array_get(list, i);
        if (!json_is_string(sets ? json_object_get(item, "name") : item))
            return td_fail(error, TD_ERROR_FORMAT, "%s: %s[%zu] has no name", names[r->op], key, i);
    }
    if (id && (!json_is_string(id) || json_string_length(id) >= sizeof r->id))
        return td_fail(error, TD_ERROR_FORMAT, "%s: 'id' must be a text of at most %zu bytes", names[r->op],
                       sizeof r->id - 1);
    if (id) memcpy(r->id, json_string_value(id), json_string_length(id) + 1);
    r->parameters = json_incref(list);
    return TD_OK;
}

static td_status read_text(panel_request *r, const json_t *root, td_error *error)
{
    static const char *const others[] = {"advertise", "unadvertise", "subscribeConnectionGraph",
                                         "unsubscribeConnectionGraph", "fetchAsset"};
    const char *op = json_string_value(json_object_get(root, "op"));
    if (!op) return td_fail(error, TD_ERROR_FORMAT, "a message without 'op'");
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (strcmp(op, others[i]) == 0)
            return td_fail(error, TD_ERROR_UNSUPPORTED, "%s is not among the capabilities of this server",
                           op);
    int found = 0;
    while (found < PANEL_CALL && strcmp(op, names[found]) != 0) found++;
    r->op = (panel_op)found;
    if (found <= PANEL_UNSUBSCRIBE) return read_subscriptions(r, root, error);
    if (found < PANEL_CALL) return read_parameters(r, root, error);
    const size_t plain = strspn(op, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ");
    return td_fail(error, TD_ERROR_FORMAT, "'%.40s' is no operation of the protocol", op[plain] ? "…" : op);
}

static td_status parse_text(panel_request *r, const void *bytes, size_t size, td_error *error)
{
    json_t *root = json_loadb(bytes, size, JSON_REJECT_DUPLICATES, NULL);
    const td_status status = json_is_object(root)
                                 ? read_text(r, root, error)
                                 : td_fail(error, TD_ERROR_FORMAT, "a message that is no JSON object");
    json_decref(root);
    return status;
}

/* Opcode, service, call, length of the encoding's name, its name, the arguments. */
static td_status parse_binary(panel_request *r, const unsigned char *bytes, size_t size, td_error *error)
{
    enum { HEAD = 13 };
    static const char json[] = "json";
    if (size > 0 && bytes[0] == 1)
        return td_fail(error, TD_ERROR_UNSUPPORTED,
                       "messages on channels of a client are not among the capabilities of this server");
    if (size < HEAD || bytes[0] != OP_CALL)
        return td_fail(error, TD_ERROR_FORMAT, "a binary message that is no service call");
    r->op = PANEL_CALL;
    r->service = get(bytes + 1);
    r->call = get(bytes + 5);
    const uint32_t length = get(bytes + 9);
    if (length > size - HEAD)
        return td_fail(error, TD_ERROR_FORMAT, "a service call whose encoding is longer than the message");
    if (length != sizeof json - 1 || memcmp(bytes + HEAD, json, length) != 0)
        return td_fail(error, TD_ERROR_FORMAT, "a service call that is not encoded as json");
    const size_t begin = HEAD + length;
    r->arguments = begin == size
                       ? json_object()
                       : json_loadb((const char *)bytes + begin, size - begin, JSON_REJECT_DUPLICATES, NULL);
    if (!json_is_object(r->arguments))
        return td_fail(error, TD_ERROR_FORMAT, "a service call whose arguments are no JSON object");
    return TD_OK;
}

td_status panel_request_parse(panel_request *request, const void *bytes, size_t size, bool binary,
                              td_error *error)
{
    *request = (panel_request){0};
    if (size > PANEL_MAX_REQUEST)
        return td_fail(error, TD_ERROR_FORMAT, "a message of more than %d bytes", PANEL_MAX_REQUEST);
    const td_status status =
        binary ? parse_binary(request, bytes, size, error) : parse_text(request, bytes, size, error);
    /* Of a call the numbers stay, for its answer. */
    const panel_request kept = *request;
    if (status == TD_OK) return status;
    panel_request_free(request);
    request->op = kept.op, request->service = kept.service, request->call = kept.call;
    return status;
}

/* ---- to a client ---- */

/* The text of a message, which is freed; NULL in, NULL out. */
static panel_bytes text_of(json_t *message)
{
    char *text = message ? json_dumps(message, JSON_COMPACT | JSON_REAL_PRECISION(12)) : NULL;
    json_decref(message);
    return (panel_bytes){(unsigned char *)text, text ? strlen(text) : 0, false};
}

panel_bytes panel_server_info(const char *name, const char *session, uint64_t client)
{
    char number[24];
    snprintf(number, sizeof number, "%llu", (unsigned long long)client);
    return text_of(json_pack("{s:s, s:s, s:[s,s,s,s], s:[s], s:s, s:{s:s, s:s}}", "op", "serverInfo", "name",
                             name, "capabilities", "time", "services", "parameters", "parametersSubscribe",
                             "supportedEncodings", "json", "sessionId", session, "metadata", "program",
                             "teledimos", "client", number));
}

panel_bytes panel_advertise(const td_mcap_channel *channel, size_t count)
{
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) {
        const td_mcap_channel *c = channel + i;
        json_array_append_new(list, json_pack("{s:I, s:s, s:s, s:s, s:s%, s:s}", "id", (json_int_t)i + 1,
                                              "topic", c->topic, "encoding", c->encoding, "schemaName",
                                              c->schema_name, "schema", (const char *)c->schema,
                                              c->schema_size, "schemaEncoding", c->schema_encoding));
    }
    return text_of(json_pack("{s:s, s:o}", "op", "advertise", "channels", list));
}

static json_t *side(const char *name, const char *what, const char *schema)
{
    return json_pack("{s:s, s:s++, s:s, s:s}", "encoding", "json", "schemaName", "teledimos.", name, what,
                     "schemaEncoding", "jsonschema", "schema", schema);
}

panel_bytes panel_advertise_services(const panel_service *service, size_t count)
{
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) {
        const panel_service *s = service + i;
        json_array_append_new(list, json_pack("{s:I, s:s, s:s+, s:o, s:o}", "id", (json_int_t)i + 1, "name",
                                              s->name, "type", "teledimos.", s->name, "request",
                                              side(s->name, "Request", s->request), "response",
                                              side(s->name, "Response", s->response)));
    }
    return text_of(json_pack("{s:s, s:o}", "op", "advertiseServices", "services", list));
}

void panel_message_head(unsigned char head[PANEL_MESSAGE_HEAD], uint32_t subscription, uint64_t time_ns)
{
    unsigned char *at = head;
    put(&at, OP_MESSAGE, 1);
    put(&at, subscription, 4);
    put(&at, time_ns, 8);
}

void panel_time(unsigned char bytes[PANEL_TIME_SIZE], uint64_t time_ns)
{
    unsigned char *at = bytes;
    put(&at, OP_TIME, 1);
    put(&at, time_ns, 8);
}

panel_bytes panel_response(uint32_t service, uint32_t call, json_t *json)
{
    panel_bytes text = text_of(json), whole = {.binary = true};
    if (!text.data) return whole;
    whole.data = malloc(17 + text.size);
    if (whole.data) {
        unsigned char *at = whole.data;
        put(&at, OP_RESPONSE, 1);
        put(&at, service, 4);
        put(&at, call, 4);
        put(&at, 4, 4);
        memcpy(at, "json", 4);
        memcpy(at + 4, text.data, text.size);
        whole.size = 17 + text.size;
    }
    free(text.data);
    return whole;
}

panel_bytes panel_failure(uint32_t service, uint32_t call, const char *text)
{
    return text_of(json_pack("{s:s, s:I, s:I, s:s}", "op", "serviceCallFailure", "serviceId",
                             (json_int_t)service, "callId", (json_int_t)call, "message", text));
}

panel_bytes panel_parameter_values(json_t *parameters, const char *id)
{
    json_t *message = json_pack("{s:s, s:o}", "op", "parameterValues", "parameters", parameters);
    if (message && *id) json_object_set_new(message, "id", json_string(id));
    return text_of(message);
}

panel_bytes panel_status(panel_level level, const char *text)
{
    return text_of(json_pack("{s:s, s:i, s:s}", "op", "status", "level", (int)level, "message", text));
}
