#include "apps/panel_feed_machine.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/foxglove.h"

static const char far_schema[] =
    "{\"type\":\"object\",\"title\":\"teledimos.Link\",\"properties\":{\"open\":{\"type\":\"boolean\"},"
    "\"why\":{\"type\":\"string\"},\"mode\":{\"type\":\"string\"},\"phase\":{\"type\":\"string\"},"
    "\"fault\":{\"type\":\"string\"},\"task\":{\"type\":\"string\"},\"step\":{\"type\":\"integer\"},"
    "\"steps\":{\"type\":\"integer\"},\"time_s\":{\"type\":\"number\"},\"round_trip_s\":{\"type\":\"number\"}"
    ","
    "\"round_trip_mean_s\":{\"type\":\"number\"},\"round_trip_most_s\":{\"type\":\"number\"},"
    "\"unanswered_s\":{\"type\":\"number\"},\"pings\":{\"type\":\"integer\"},\"late\":{\"type\":\"integer\"},"
    "\"retransmitted\":{\"type\":\"integer\"},\"lost_share\":{\"type\":\"number\"},\"state_age_s\":{\"type\":"
    "["
    "\"number\",\"null\"]},\"image_age_s\":{\"type\":[\"number\",\"null\"]},\"map_age_s\":{\"type\":["
    "\"number\",\"null\"]}}}";

td_mcap_channel panel_feed_machine_about(int channel)
{
    switch (channel) {
    case PANEL_MEASURED_TF:
        return td_foxglove_channel(TD_FOXGLOVE_TRANSFORMS, "/measured/tf");
    case PANEL_MEASURED_JOINTS:
        return td_foxglove_channel(TD_FOXGLOVE_JOINTS, "/measured/joints");
    case PANEL_MEASURED_MACHINE:
        return td_foxglove_channel(TD_FOXGLOVE_SCENE, "/measured/machine");
    case PANEL_LEFT:
        return td_foxglove_channel(TD_FOXGLOVE_IMAGE, "/camera/left");
    case PANEL_RIGHT:
        return td_foxglove_channel(TD_FOXGLOVE_IMAGE, "/camera/right");
    default:
        return (td_mcap_channel){"/link",      "json",     "teledimos.Link",
                                 "jsonschema", far_schema, sizeof far_schema - 1};
    }
}

static void give(panel_feed *f, int channel, td_status made, char *json, size_t size)
{
    if (made == TD_OK) (void)panel_feed_publish(f, channel, f->hub.time_ns, json, size, NULL);
}

/* ---- its state ---- */

static json_t *age(double now_s, double then_s)
{
    return td_json_real(then_s > 0 ? now_s - then_s : NAN);
}

/* Segments sent again, of all frames that were sent: what the way loses. */
static double lost_share(const td_link_measure *l)
{
    return l->frames_out ? fmin(1, (double)l->retransmitted / (double)l->frames_out) : 0;
}

static void tell_link(panel_feed *f, const far_measured *m)
{
    const td_link_measure *l = &m->link;
    const td_machine_state_message *s = &m->state;
    const double now = td_machine_now_s(), clock = terminal_now_s();
    json_t *o =
        json_pack("{s:b, s:s, s:s, s:s, s:s, s:s, s:i, s:i, s:f}", "open", m->open, "why", m->why, "mode",
                  m->has_state ? td_machine_mode_name(s->mode) : "", "phase", s->phase, "fault", s->fault,
                  "task", s->task, "step", s->step, "steps", s->steps, "time_s", s->plant.time_s);
    json_t *link = json_pack("{s:f, s:f, s:f, s:f, s:I, s:I, s:I, s:f}", "round_trip_s", l->round_trip_s,
                             "round_trip_mean_s", l->mean_s, "round_trip_most_s", l->most_s, "unanswered_s",
                             l->unanswered_s, "pings", (json_int_t)l->pings, "late", (json_int_t)l->late,
                             "retransmitted", (json_int_t)l->retransmitted, "lost_share", lost_share(l));
    if (o && link) json_object_update(o, link);
    json_decref(link);
    if (o) {
        json_object_set_new(o, "state_age_s", age(now, m->has_state ? m->heard_s : 0));
        json_object_set_new(o, "image_age_s", age(now, f->image_s));
        json_object_set_new(o, "map_age_s", age(clock, f->ground_s));
    }
    f->link_told_s = now;
    panel_feed_publish_json(f, PANEL_FAR, o);
}

static void tell_state(panel_feed *f, const far_measured *m)
{
    const td_plant_state *s = &m->state.plant;
    const uint64_t ns = f->hub.time_ns;
    char *json = NULL;
    size_t size = 0;
    td_status made =
        td_foxglove_transforms(&json, &size, f->ghost, s->q, "site", &s->site_from_vehicle, ns, NULL);
    give(f, PANEL_MEASURED_TF, made, json, size);
    made = td_foxglove_joints(&json, &size, f->scenario->robot, s, ns, NULL);
    give(f, PANEL_MEASURED_JOINTS, made, json, size);
}

/* ---- what is said ---- */

static void note(panel_feed *f, const far_heard *h)
{
    static const char *const what[] = {"machine linked", "machine lost", "machine told", "machine answered",
                                       "machine stopped"};
    const td_machine_answer *a = &h->answer;
    json_t *fields = json_pack("{s:s}", "text", a->text);
    if (fields && h->kind == FAR_ANSWERED && a->kind) {
        json_object_set_new(
            fields, "to", json_string(a->kind == TD_MACHINE_TASK ? "task" : td_machine_order_name(a->order)));
        json_object_set_new(fields, "accepted", json_boolean(a->accepted));
    }
    if (fields && h->kind == FAR_STOPPED) {
        json_object_set_new(fields, "silent_s", td_json_real(h->stopped.silent_s));
        json_object_set_new(fields, "took_s", td_json_real(h->stopped.took_s));
    }
    panel_desk_note(f->desk, what[h->kind], fields);
    char text[TD_MACHINE_TEXT_SIZE + 40], *json = NULL;
    size_t size = 0;
    const bool bad =
        h->kind == FAR_UNLINKED || h->kind == FAR_STOPPED || (h->kind == FAR_ANSWERED && !a->accepted);
    snprintf(text, sizeof text, "%s: %s", what[h->kind], a->text);
    const td_status made = td_foxglove_log(&json, &size, bad ? TD_LOG_WARNING : TD_LOG_INFO, "machine", text,
                                           f->hub.time_ns, NULL);
    give(f, TASK_LOG, made, json, size);
}

static void tell_picture(panel_feed *f, const far_picture *p)
{
    char *json = NULL;
    size_t size = 0;
    f->image_s = p->heard_s;
    const td_status made = td_foxglove_image(
        &json, &size, p->image.jpeg, p->image.size, p->image.jpeg[0] == 0x89 ? "png" : "jpeg",
        p->image.side ? "camera/right" : "camera/left", f->hub.time_ns, NULL);
    give(f, p->image.side ? PANEL_RIGHT : PANEL_LEFT, made, json, size);
}

void panel_feed_machine_take(panel_feed *f)
{
    static const double LINK_S = 0.2;
    for (far_heard *h; (h = far_machine_line(f->machine)); far_machine_lined(f->machine, h)) note(f, h);
    for (far_measured *m; (m = far_machine_shown(f->machine)); far_machine_was_shown(f->machine, m)) {
        if (m->has_state && m->open) tell_state(f, m);
        if (td_machine_now_s() > f->link_told_s + LINK_S || !m->open) tell_link(f, m);
    }
    for (far_picture *p; (p = far_machine_picture(f->machine)); far_machine_pictured(f->machine, p))
        tell_picture(f, p);
}

/* ---- at the begin ---- */

/* Its frames beside those of the simulated machine: a translucent one over it. */
static td_status make_ghost(panel_feed *f, td_error *error)
{
    TD_TRY(td_robot_read(&f->ghost, f->scenario->robot_path, error));
    for (int i = 0; i < f->ghost->link_count; i++) {
        char name[TD_NAME_SIZE];
        snprintf(name, sizeof name, "%s", f->ghost->link[i].name);
        snprintf(f->ghost->link[i].name, sizeof f->ghost->link[i].name, "measured/%.*s", TD_NAME_SIZE - 10,
                 name);
    }
    return TD_OK;
}

td_status panel_feed_machine_begin(panel_feed *f, td_error *error)
{
    static const double pale[4] = {0.2, 0.55, 0.95, 0.35};
    const task_sink to = {.take = panel_feed_take_message, .user = f};
    char *json = NULL;
    size_t size = 0;
    TD_TRY(make_ghost(f, error));
    for (int i = PANEL_MEASURED_TF; i <= PANEL_FAR; i++) {
        const td_mcap_channel about = panel_feed_machine_about(i);
        TD_TRY(td_mcap_channel_add(f->writer, f->recorded + i, &about, error));
    }
    const td_status made = td_foxglove_machine(&json, &size, f->ghost, pale, 0, error);
    give(f, PANEL_MEASURED_MACHINE, made, json, size);
    TD_TRY(made);
    return task_message_input(&to, f->scenario->robot, 0, 0, "machine", "elsewhere", -1, 0, error);
}
