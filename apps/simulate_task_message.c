#include "apps/simulate_task_message.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/foxglove.h"

static const char *const kinds[] = {"order", "report", "message", "phase", "fault", "step"};
static const char SITE[] = "site";
const char task_input_topic[] = "/inputs";

const char *note_kind_name(note_kind kind)
{
    return kinds[kind];
}

td_mcap_channel task_channel_about(task_channel channel)
{
    static const char *const topic[] = {"/tf",      "/joints", "/joints/desired", "/tool", "/tool/desired",
                                        "/machine", "/log",    "/terrain"};
    static const td_foxglove_kind kind[] = {TD_FOXGLOVE_TRANSFORMS, TD_FOXGLOVE_JOINTS, TD_FOXGLOVE_JOINTS,
                                            TD_FOXGLOVE_POSE,       TD_FOXGLOVE_POSE,   TD_FOXGLOVE_SCENE,
                                            TD_FOXGLOVE_LOG,        TD_FOXGLOVE_GRID};
    static const char schema[] =
        "{\"type\":\"object\",\"title\":\"teledimos.Input\",\"properties\":{\"period\":{\"type\":\"integer\"}"
        ","
        "\"kind\":{\"type\":\"string\"},\"name\":{\"type\":\"string\"},\"joint\":{\"type\":\"string\"},"
        "\"stick\":{\"type\":\"number\"}}}";
    if (channel != TASK_INPUTS) return td_foxglove_channel(kind[channel], topic[channel]);
    return (td_mcap_channel){task_input_topic, "json", "teledimos.Input",
                             "jsonschema",     schema, sizeof schema - 1};
}

static td_status send(const task_sink *to, task_channel channel, td_status made, char *json, size_t size,
                      uint64_t ns, td_error *error)
{
    return made == TD_OK ? to->take(to->user, channel, ns, json, size, error) : made;
}

td_status task_message_sample(const task_sink *to, const td_robot *robot, const task_sample *a,
                              td_error *error)
{
    td_plant_state wanted = {.time_s = to->begun_s + a->time_s};
    char *json = NULL;
    size_t size = 0;
    uint64_t ns = 0;
    td_mcap_time(&ns, to->begun_s + a->time_s);
    td_status status =
        td_foxglove_transforms(&json, &size, robot, a->state.q, SITE, &a->state.site_from_vehicle, ns, error);
    TD_TRY(send(to, TASK_TF, status, json, size, ns, error));
    status = td_foxglove_joints(&json, &size, robot, &a->state, ns, error);
    TD_TRY(send(to, TASK_JOINTS, status, json, size, ns, error));
    memcpy(wanted.q, a->wanted, sizeof wanted.q);
    status = td_foxglove_joints(&json, &size, robot, &wanted, ns, error);
    TD_TRY(send(to, TASK_WANTED, status, json, size, ns, error));
    status = td_foxglove_pose(&json, &size, &a->tool, SITE, ns, error);
    TD_TRY(send(to, TASK_TOOL, status, json, size, ns, error));
    status = td_foxglove_pose(&json, &size, &a->tool_wanted, SITE, ns, error);
    return send(to, TASK_TOOL_WANTED, status, json, size, ns, error);
}

td_status task_message_ground(const task_sink *to, const task_ground *g, td_error *error)
{
    char *json = NULL;
    size_t size = 0;
    uint64_t ns = 0;
    td_mcap_time(&ns, to->begun_s + g->time_s);
    const td_status status = td_foxglove_grid(&json, &size, g->map, ns, error);
    return send(to, TASK_TERRAIN, status, json, size, ns, error);
}

td_status task_message_input(const task_sink *to, const td_robot *robot, long period, double time_s,
                             const char *kind, const char *name, int joint, double stick, td_error *error)
{
    uint64_t ns = 0;
    td_mcap_time(&ns, to->begun_s + time_s);
    if (to->begun_s > 0) period += lround(to->begun_s / to->period_s);
    json_t *o = json_pack("{s:I, s:s, s:s, s:s, s:f}", "period", (json_int_t)period, "kind", kind, "name",
                          name, "joint", joint >= 0 ? robot->joint[joint].name : "", "stick", stick);
    char *text = o ? json_dumps(o, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(o);
    if (!text) return td_fail(error, TD_ERROR_MEMORY, "no memory for a message");
    return to->take(to->user, TASK_INPUTS, ns, text, strlen(text), error);
}

td_status task_message_text(const task_sink *to, const char *name, const char *text, td_error *error)
{
    char *json = NULL;
    size_t size = 0;
    uint64_t ns = 0;
    td_mcap_time(&ns, to->begun_s);
    const td_status status = td_foxglove_log(&json, &size, TD_LOG_INFO, name, text, ns, error);
    return send(to, TASK_LOG, status, json, size, ns, error);
}

td_status task_message_note(const task_sink *to, const td_robot *robot, const task_note *n, td_error *error)
{
    const td_log_level level = n->kind == NOTE_FAULT || n->kind == NOTE_REPORT ? TD_LOG_WARNING : TD_LOG_INFO;
    char text[600], *json = NULL;
    size_t size = 0;
    uint64_t ns = 0;
    td_mcap_time(&ns, to->begun_s + n->time_s);
    snprintf(text, sizeof text, "%s: %s%s%s", kinds[n->kind], n->name, *n->text ? ": " : "", n->text);
    const td_status status = td_foxglove_log(&json, &size, level, "session", text, ns, error);
    TD_TRY(send(to, TASK_LOG, status, json, size, ns, error));
    if (n->kind != NOTE_ORDER && n->kind != NOTE_REPORT) return TD_OK;
    return task_message_input(to, robot, n->period, n->time_s, kinds[n->kind], n->name, n->joint, n->stick,
                              error);
}

td_status task_message_begin(const task_sink *to, const td_robot *robot, const char *identity,
                             td_error *error)
{
    static const double yellow[4] = {0.93, 0.69, 0.13, 1};
    char *json = NULL;
    size_t size = 0;
    const td_status status = td_foxglove_machine(&json, &size, robot, yellow, 0, error);
    TD_TRY(send(to, TASK_MACHINE, status, json, size, 0, error));
    return task_message_input(to, robot, 0, 0, "scenario", identity, -1, 0, error);
}

td_status task_message_end(const task_sink *to, long period, double time_s, td_error *error)
{
    return task_message_input(to, NULL, period, time_s, "end", "end", -1, 0, error);
}
