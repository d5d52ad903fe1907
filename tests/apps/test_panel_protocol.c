/* The Foxglove WebSocket protocol: each message against the bytes that its specification gives, written out
 * here; what is refused by its sentence. tests/apps/test_panel.py speaks it over a socket.
 * Blind to: what clients do with it (Foxglove's own client was tried by hand). */
#include "apps/panel_protocol.h"
#include "core/foxglove.h"
#include "tests/check.h"

static panel_request parse(const char *text)
{
    panel_request r;
    td_error error = {0};
    check_ok(panel_request_parse(&r, text, strlen(text), false, &error), error);
    return r;
}

static void requests_as_text(void **state)
{
    (void)state;
    panel_request r = parse("{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":0,\"channelId\":3},"
                            "{\"id\":4294967295,\"channelId\":1}]}");
    assert_int_equal(r.op, PANEL_SUBSCRIBE);
    assert_int_equal(r.count, 2);
    assert_int_equal(r.subscription[0].id, 0);
    assert_int_equal(r.subscription[0].channel, 3);
    assert_int_equal(r.subscription[1].id, UINT32_MAX);
    panel_request_free(&r);
    r = parse("{\"op\":\"unsubscribe\",\"subscriptionIds\":[5]}");
    assert_int_equal(r.op, PANEL_UNSUBSCRIBE);
    assert_int_equal(r.subscription[0].id, 5);
    panel_request_free(&r);
    r = parse("{\"op\":\"getParameters\",\"parameterNames\":[\"/a\",\"/b\"],\"id\":\"q1\"}");
    assert_int_equal(r.op, PANEL_GET_PARAMETERS);
    assert_int_equal(json_array_size(r.parameters), 2);
    assert_string_equal(r.id, "q1");
    panel_request_free(&r);
    r = parse("{\"op\":\"setParameters\",\"parameters\":[{\"name\":\"/a\",\"value\":2.5}]}");
    assert_int_equal(r.op, PANEL_SET_PARAMETERS);
    assert_string_equal(r.id, "");
    panel_request_free(&r);
    r = parse("{\"op\":\"subscribeParameterUpdates\",\"parameterNames\":[]}");
    assert_int_equal(r.op, PANEL_WATCH_PARAMETERS);
    panel_request_free(&r);
    r = parse("{\"op\":\"unsubscribeParameterUpdates\",\"parameterNames\":[]}");
    assert_int_equal(r.op, PANEL_UNWATCH_PARAMETERS);
    panel_request_free(&r);
}

static void a_call(void **state)
{
    static const char bytes[] = "\2\3\0\0\0\7\1\0\0\4\0\0\0json{\"joint\":\"boom\"}";
    panel_request r;
    td_error error = {0};
    (void)state;
    check_ok(panel_request_parse(&r, bytes, sizeof bytes - 1, true, &error), error);
    assert_int_equal(r.op, PANEL_CALL);
    assert_int_equal(r.service, 3);
    assert_int_equal(r.call, 0x107);
    assert_string_equal(json_string_value(json_object_get(r.arguments, "joint")), "boom");
    panel_request_free(&r);
    check_ok(panel_request_parse(&r, bytes, 17, true, &error), error); /* no arguments: none */
    assert_int_equal(json_object_size(r.arguments), 0);
    panel_request_free(&r);
}

static void refusals(void **state)
{
    static const struct {
        const char *text, *words;
    } bad[] = {
        {"", "no JSON object"},
        {"[1]", "no JSON object"},
        {"{\"op\":", "no JSON object"},
        {"{\"op\":\"subscribe\",\"op\":\"subscribe\"}", "no JSON object"},
        {"{}", "without 'op'"},
        {"{\"op\":1}", "without 'op'"},
        {"{\"op\":\"dance\"}", "'dance' is no operation"},
        {"{\"op\":\"dance\\u001b\"}", "is no operation"},
        {"{\"op\":\"advertise\",\"channels\":[]}", "not among the capabilities"},
        {"{\"op\":\"fetchAsset\"}", "not among the capabilities"},
        {"{\"op\":\"subscribe\"}", "must be a list"},
        {"{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":-1,\"channelId\":1}]}", "subscriptions[0]"},
        {"{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1}]}", "subscriptions[0]"},
        {"{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":4294967296,\"channelId\":1}]}", "whole number"},
        {"{\"op\":\"unsubscribe\",\"subscriptionIds\":[1.5]}", "subscriptionIds[0]"},
        {"{\"op\":\"getParameters\",\"parameterNames\":[3]}", "parameterNames[0]"},
        {"{\"op\":\"setParameters\",\"parameters\":[\"a\"]}", "parameters[0]"},
        {"{\"op\":\"getParameters\",\"parameterNames\":[],\"id\":7}", "'id' must be a text"},
    };
    static const struct {
        const char *bytes;
        size_t size;
        const char *words;
    } binary[] = {
        {"", 0, "no service call"},
        {"\2\1\0\0\0\1\0\0\0\4\0\0", 12, "no service call"},
        {"\3\1\0\0\0\1\0\0\0\4\0\0\0json{}", 19, "no service call"},
        {"\1\1\0\0\0hello, all of you", 22, "not among the capabilities"},
        {"\2\1\0\0\0\1\0\0\0\5\0\0\0json", 17, "longer than the message"},
        {"\2\1\0\0\0\1\0\0\0\377\377\377\377json{}", 19, "longer than the message"},
        {"\2\1\0\0\0\1\0\0\0\3\0\0\0cdr{}", 18, "not encoded as json"},
        {"\2\1\0\0\0\1\0\0\0\4\0\0\0json[]", 19, "no JSON object"},
    };
    panel_request r;
    td_error error = {0};
    (void)state;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        if (panel_request_parse(&r, bad[i].text, strlen(bad[i].text), false, &error) == TD_OK)
            fail_msg("taken: %s", bad[i].text);
        if (!strstr(error.message, bad[i].words)) fail_msg("%s: '%s'", bad[i].text, error.message);
        panel_request_free(&r);
    }
    for (size_t i = 0; i < sizeof binary / sizeof *binary; i++) {
        if (panel_request_parse(&r, binary[i].bytes, binary[i].size, true, &error) == TD_OK)
            fail_msg("binary %zu taken", i);
        if (!strstr(error.message, binary[i].words)) fail_msg("binary %zu: '%s'", i, error.message);
    }
    char *large = calloc(1, PANEL_MAX_REQUEST + 1);
    assert_non_null(large);
    check_fails(panel_request_parse(&r, large, PANEL_MAX_REQUEST + 1, false, &error), TD_ERROR_FORMAT, error,
                "more than 65536 bytes");
    free(large);
}

/* A text message as JSON, and its bytes freed. */
static json_t *read_text(panel_bytes b)
{
    assert_non_null(b.data);
    assert_false(b.binary);
    json_t *o = json_loadb((const char *)b.data, b.size, 0, NULL);
    assert_non_null(o);
    free(b.data);
    return o;
}

static const char *text_at(const json_t *o, const char *key)
{
    const char *text = json_string_value(json_object_get(o, key));
    assert_non_null(text);
    return text;
}

static void what_the_server_offers(void **state)
{
    (void)state;
    const td_mcap_channel channel[2] = {td_foxglove_channel(TD_FOXGLOVE_TRANSFORMS, "/tf"),
                                        td_foxglove_channel(TD_FOXGLOVE_LOG, "/log")};
    const panel_service service = {"Jog", "{\"type\":\"object\"}", "{}"};
    json_t *o = read_text(panel_server_info("panel", "s-1", 7));
    assert_string_equal(text_at(o, "op"), "serverInfo");
    assert_string_equal(text_at(o, "sessionId"), "s-1");
    assert_int_equal(json_array_size(json_object_get(o, "capabilities")), 4);
    assert_string_equal(json_string_value(json_array_get(json_object_get(o, "supportedEncodings"), 0)),
                        "json");
    json_decref(o);
    o = read_text(panel_advertise(channel, 2));
    assert_string_equal(text_at(o, "op"), "advertise");
    const json_t *c = json_array_get(json_object_get(o, "channels"), 1);
    assert_int_equal(json_integer_value(json_object_get(c, "id")), 2);
    assert_string_equal(text_at(c, "topic"), "/log");
    assert_string_equal(text_at(c, "schemaName"), "foxglove.Log");
    assert_string_equal(text_at(c, "schemaEncoding"), "jsonschema");
    json_t *schema = json_loads(text_at(c, "schema"), 0, NULL);
    assert_string_equal(text_at(schema, "title"), "foxglove.Log");
    json_decref(schema);
    json_decref(o);
    o = read_text(panel_advertise_services(&service, 1));
    const json_t *s = json_array_get(json_object_get(o, "services"), 0);
    assert_string_equal(text_at(s, "name"), "Jog");
    assert_string_equal(text_at(s, "type"), "teledimos.Jog");
    assert_string_equal(text_at(json_object_get(s, "request"), "schema"), "{\"type\":\"object\"}");
    assert_string_equal(text_at(json_object_get(s, "response"), "schemaName"), "teledimos.JogResponse");
    json_decref(o);
}

static void what_the_server_sends(void **state)
{
    unsigned char head[PANEL_MESSAGE_HEAD], time[PANEL_TIME_SIZE];
    (void)state;
    panel_message_head(head, 0x01020304, 0x1122334455667788);
    assert_memory_equal(head, "\1\4\3\2\1\x88\x77\x66\x55\x44\x33\x22\x11", PANEL_MESSAGE_HEAD);
    panel_time(time, 50000000);
    assert_memory_equal(time, "\2\x80\xf0\xfa\2\0\0\0\0", PANEL_TIME_SIZE);
    panel_bytes b = panel_response(3, 0x107, json_pack("{s:b}", "ok", 1));
    assert_true(b.binary);
    assert_int_equal(b.size, 28);
    assert_memory_equal(b.data, "\3\3\0\0\0\7\1\0\0\4\0\0\0json{\"ok\":true}", 28);
    free(b.data);
    json_t *o = read_text(panel_failure(3, 9, "no"));
    assert_string_equal(text_at(o, "op"), "serviceCallFailure");
    assert_int_equal(json_integer_value(json_object_get(o, "callId")), 9);
    assert_string_equal(text_at(o, "message"), "no");
    json_decref(o);
    o = read_text(panel_parameter_values(json_pack("[{s:s, s:f}]", "name", "/a", "value", 2.5), "q"));
    assert_string_equal(text_at(o, "op"), "parameterValues");
    assert_string_equal(text_at(o, "id"), "q");
    json_decref(o);
    o = read_text(panel_status(PANEL_WARNING, "slow"));
    assert_string_equal(text_at(o, "op"), "status");
    assert_int_equal(json_integer_value(json_object_get(o, "level")), 1);
    json_decref(o);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(requests_as_text),
        cmocka_unit_test(a_call),
        cmocka_unit_test(refusals),
        cmocka_unit_test(what_the_server_offers),
        cmocka_unit_test(what_the_server_sends),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
