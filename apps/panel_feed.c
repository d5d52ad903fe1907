#include "apps/panel_feed_machine.h"

#include <stdlib.h>
#include <string.h>

#include "apps/panel_about.h"
#include "core/document.h"
#include "core/foxglove.h"

enum { EVENTS_KEPT = 512 };
static const double FLUSH_S = 5;

/* ---- messages ---- */

td_status panel_feed_publish(panel_feed *f, int channel, uint64_t ns, char *json, size_t size,
                             td_error *error)
{
    td_error why = {0};
    if (f->recorded[channel] >= 0 && !f->failed &&
        td_mcap_write(f->writer, f->recorded[channel], ns, json, size, &why) != TD_OK) {
        f->failed = true;
        td_log_write(&f->log, TD_LOG_WARNING, "panel", "the recording ends here: %s", why.message);
    }
    if (panel_hub_publish(&f->hub, f->index[channel], ns, json, size)) return TD_OK;
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a message");
}

td_status panel_feed_take_message(void *user, task_channel channel, uint64_t ns, char *json, size_t size,
                                  td_error *error)
{
    return panel_feed_publish(user, (int)channel, ns, json, size, error);
}

void panel_feed_publish_json(panel_feed *f, int channel, json_t *o)
{
    char *text = o ? json_dumps(o, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9)) : NULL;
    json_decref(o);
    if (text) (void)panel_feed_publish(f, channel, f->hub.time_ns, text, strlen(text), NULL);
}

static const char session_schema[] =
    "{\"type\":\"object\",\"title\":\"teledimos.Session\",\"properties\":{\"phase\":{\"type\":\"string\"},"
    "\"step\":{\"type\":\"integer\"},\"steps\":{\"type\":\"integer\"},\"motion\":{\"type\":\"integer\"},"
    "\"share\":{\"type\":\"number\"},\"load_kg\":{\"type\":\"number\"},\"contact_n\":{\"type\":\"number\"},"
    "\"press_n\":{\"type\":[\"number\",\"null\"]},\"offers\":{\"type\":\"array\",\"items\":{\"type\":"
    "\"string\"}},"
    "\"operator\":{\"type\":\"integer\"}}}";
static const char diagnostics_schema[] =
    "{\"type\":\"object\",\"title\":\"teledimos.Diagnostics\",\"properties\":{\"ticks\":{\"type\":"
    "\"integer\"}"
    ",\"misses\":{\"type\":\"integer\"},\"late_p99_s\":{\"type\":\"number\"},\"late_max_s\":{\"type\":"
    "\"number\"},\"real_time_factor\":{\"type\":\"number\"},\"clients\":{\"type\":\"integer\"},\"operator\":{"
    "\"type\":\"integer\"},\"samples_dropped\":{\"type\":\"integer\"},\"orders\":{\"type\":\"integer\"},"
    "\"refused\":{\"type\":\"integer\"}}}";

static const char about_schema[] =
    "{\"type\":\"object\",\"title\":\"teledimos.Panel\","
    "\"properties\":{\"scenario\":{\"type\":\"string\"},\"about\":{\"type\":\"string\"},"
    "\"robot\":{\"type\":\"string\"},\"task\":{\"type\":\"string\"},"
    "\"task_frame\":{\"type\":\"string\"},\"ground\":{\"type\":\"boolean\"},"
    "\"period_s\":{\"type\":\"number\"},\"joints\":{\"type\":\"array\",\"items\":{\"type\":\"object\","
    "\"properties\":{\"name\":{\"type\":\"string\"},\"unit\":{\"type\":\"string\"},"
    "\"low\":{\"type\":[\"number\",\"null\"]},\"high\":{\"type\":[\"number\",\"null\"]}}}},"
    "\"parameters\":{\"type\":\"array\",\"items\":{\"type\":\"object\","
    "\"properties\":{\"name\":{\"type\":\"string\"},\"settable\":{\"type\":\"boolean\"},"
    "\"low\":{\"type\":[\"number\",\"null\"]},\"high\":{\"type\":[\"number\",\"null\"]},"
    "\"choices\":{\"type\":\"array\",\"items\":{\"type\":\"string\"}}},\"required\":[\"name\","
    "\"settable\"]}},\"behaviour\":{\"type\":\"object\","
    "\"properties\":{\"phases\":{\"type\":\"array\",\"items\":{\"type\":\"object\","
    "\"properties\":{\"name\":{\"type\":\"string\"},\"text\":{\"type\":\"string\"}}}},"
    "\"events\":{\"type\":\"array\",\"items\":{\"type\":\"object\","
    "\"properties\":{\"name\":{\"type\":\"string\"},\"text\":{\"type\":\"string\"},"
    "\"order\":{\"type\":\"boolean\"}}}},\"ways\":{\"type\":\"array\",\"items\":{\"type\":\"object\","
    "\"properties\":{\"from\":{\"type\":\"string\"},\"event\":{\"type\":\"string\"},"
    "\"to\":{\"type\":\"string\"}}}},\"faults\":{\"type\":\"array\","
    "\"items\":{\"type\":\"string\"}}}}}}";

static void publish_session(panel_feed *f, const panel_sample *p)
{
    const task_sample *a = &p->sample;
    json_t *offers = json_array();
    for (int e = 0; e < TD_EVENT_COUNT; e++)
        if (p->offers & TD_EVENT_BIT(e))
            json_array_append_new(offers, json_string(td_event_text((td_event)e)));
    panel_feed_publish_json(f, PANEL_SESSION,
                            json_pack("{s:s, s:i, s:i, s:i, s:o, s:o, s:o, s:o, s:o, s:I}", "phase",
                                      td_phase_text(a->phase), "step", a->step + 1, "steps", p->steps,
                                      "motion", a->motion + 1, "share", td_json_real(a->share), "load_kg",
                                      td_json_real(a->load_kg), "contact_n", td_json_real(a->contact_n),
                                      "press_n", td_json_real(a->press_n), "offers", offers, "operator",
                                      (json_int_t)panel_desk_operator(f->desk)));
}

void panel_feed_diagnose(panel_feed *f)
{
    const panel_sample *p = &f->last;
    panel_feed_publish_json(
        f, PANEL_DIAGNOSTICS,
        json_pack("{s:I, s:I, s:f, s:f, s:f, s:I, s:I, s:I, s:I, s:I}", "ticks", (json_int_t)p->ticks,
                  "misses", (json_int_t)p->misses, "late_p99_s", p->late_p99_s, "late_max_s", p->late_max_s,
                  "real_time_factor", p->speed, "clients", (json_int_t)f->counts->clients, "operator",
                  (json_int_t)panel_desk_operator(f->desk), "samples_dropped",
                  (json_int_t)atomic_load(&f->link->dropped), "orders", (json_int_t)f->counts->orders,
                  "refused", (json_int_t)f->counts->refused));
}

/* ---- from the session ---- */

static td_status take_news(panel_feed *f, const panel_news *n, td_error *error)
{
    const td_robot *robot = f->scenario->robot;
    const task_sink to = {.take = panel_feed_take_message, .user = f};
    switch (n->kind) {
    case PANEL_NOTE:
        return task_message_note(&to, robot, &n->note, error);
    case PANEL_GROUND:
        f->ground_s = terminal_now_s();
        return task_message_ground(&to, &n->ground, error);
    case PANEL_CHANGE:
        return task_message_input(&to, robot, n->period, n->time_s, "parameter", "a parameter", -1, 0, error);
    case PANEL_PLAN:
        panel_feed_publish_json(f, PANEL_PATH, panel_plan_json(&n->plan, robot));
        return TD_OK;
    default:
        panel_desk_answer(f->desk, n);
        return TD_OK;
    }
}

static td_status take_sample(panel_feed *f, const panel_sample *p, td_error *error)
{
    const task_sink to = {.take = panel_feed_take_message, .user = f};
    uint64_t ns = 0;
    td_mcap_time(&ns, p->sample.time_s);
    f->last = *p;
    panel_desk_phase(f->desk, p->sample.phase);
    panel_hub_clock(&f->hub, ns);
    publish_session(f, p);
    return task_message_sample(&to, f->scenario->robot, &p->sample, error);
}

/* A message that cannot be made is told, and left out. */
static void tell_fault(panel_feed *f, td_status status, const td_error *error)
{
    if (status != TD_OK)
        td_log_write(&f->log, TD_LOG_WARNING, "panel", "a message is left out: %s", error->message);
}

void panel_feed_take(panel_feed *f)
{
    td_error error = {0};
    for (panel_news *n; (n = panel_ring_take(&f->link->news)); panel_link_give_back(&f->link->spent_news, n))
        tell_fault(f, take_news(f, n, &error), &error);
    for (panel_sample *p; (p = panel_ring_take(&f->link->samples));
         panel_link_give_back(&f->link->spent_samples, p))
        tell_fault(f, take_sample(f, p, &error), &error);
    if (f->machine) panel_feed_machine_take(f);
}

/* ---- from the start to the end ---- */

static td_status add_channels(panel_feed *f, td_error *error)
{
    const td_mcap_channel own[] = {
        {"/session", "json", "teledimos.Session", "jsonschema", session_schema, sizeof session_schema - 1},
        {"/diagnostics", "json", "teledimos.Diagnostics", "jsonschema", diagnostics_schema,
         sizeof diagnostics_schema - 1},
        {"/panel", "json", "teledimos.Panel", "jsonschema", about_schema, sizeof about_schema - 1},
        td_foxglove_channel(TD_FOXGLOVE_SCENE, "/plan")};
    for (int i = 0; i < PANEL_CHANNELS; i++) {
        const bool events = i == TASK_LOG || i == TASK_INPUTS;
        f->index[i] = -1;
        f->recorded[i] = -1;
        if (i == TASK_TERRAIN && !f->scenario->map) continue;
        if (i >= PANEL_MEASURED_TF && !f->machine) continue;
        f->index[i] = panel_hub_add(&f->hub, events ? EVENTS_KEPT : 1);
        if (f->index[i] < 0) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
        f->about[f->about_count++] = i < PANEL_SESSION       ? task_channel_about((task_channel)i)
                                     : i < PANEL_MEASURED_TF ? own[i - PANEL_SESSION]
                                                             : panel_feed_machine_about(i);
    }
    return TD_OK;
}

td_status panel_feed_add(panel_feed *f, int *index, const td_mcap_channel *about, td_error *error)
{
    *index = panel_hub_add(&f->hub, 1);
    if (*index < 0) return td_fail(error, TD_ERROR_MEMORY, "no memory for the panel");
    f->about[f->about_count++] = *about;
    return TD_OK;
}

td_status panel_feed_begin(panel_feed *f, const char *recording, const char *identity, td_error *error)
{
    const task_sink to = {.take = panel_feed_take_message, .user = f};
    TD_TRY(add_channels(f, error));
    TD_TRY(task_recording_begin(&f->writer, f->recorded, recording, f->scenario->map != NULL, error));
    f->flushed_s = terminal_now_s();
    panel_feed_publish_json(f, PANEL_ABOUT, panel_about_json(f->scenario, f->parameter, f->parameter_count));
    TD_TRY(task_message_begin(&to, f->scenario->robot, identity, error));
    return f->machine ? panel_feed_machine_begin(f, error) : TD_OK;
}

void panel_feed_free(panel_feed *f)
{
    td_robot_free(&f->ghost);
    td_mcap_writer_free(&f->writer);
    panel_hub_free(&f->hub);
}

void panel_feed_flush(panel_feed *f, double now_s)
{
    if (f->failed || now_s < f->flushed_s + FLUSH_S) return;
    f->flushed_s = now_s;
    (void)td_mcap_flush(f->writer, NULL); /* a failure is kept, and told by the next message */
}

td_status panel_feed_finish(panel_feed *f, long period, double time_s, td_error *error)
{
    const task_sink to = {.take = panel_feed_take_message, .user = f};
    panel_feed_take(f);
    const td_status status = task_message_end(&to, period, time_s, error);
    const td_status finished = td_mcap_finish(&f->writer, status == TD_OK ? error : NULL);
    return status == TD_OK ? finished : status;
}
