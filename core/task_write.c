/* A task as the document that td_task_parse reads; defaults are left out. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/task_internal.h"

/* Puts value under key; a missing one (no memory) shows in `failed`. */
typedef struct writer {
    bool failed;
} writer;

static void put(writer *w, json_t *object, const char *key, json_t *value)
{
    if (json_object_set_new(object, key, value) != 0) w->failed = true;
}

/* Left out where it is the default; what is no number becomes null, which no reader takes. */
static void put_real(writer *w, json_t *object, const char *key, double value, double fallback)
{
    if (value != fallback) put(w, object, key, td_json_real(value));
}

static json_t *point_json(writer *w, const td_task_point *p)
{
    static const char *const keys[3] = {"x_m", "y_m", "z_m"};
    json_t *o = json_object();
    for (int i = 0; i < 3; i++) put(w, o, keys[i], td_json_real(p->at_m[i]));
    if (p->attitude == TD_TASK_PITCH) put(w, o, "pitch_deg", td_json_real(p->pitch_deg));
    if (p->attitude == TD_TASK_WHOLE) put(w, o, "q", td_json_reals(p->q, 4));
    return o;
}

static json_t *joints_json(writer *w, const td_task_position *p)
{
    json_t *o = json_object();
    for (int i = 0; i < p->joint_count; i++) {
        char key[TD_NAME_SIZE + 8] = "";
        strncat(key, p->joint[i].name, TD_NAME_SIZE);
        put(w, o, strcat(key, p->joint[i].slides ? "_m" : "_deg"), td_json_real(p->joint[i].value));
    }
    return o;
}

static json_t *position_json(writer *w, const td_task_position *p)
{
    json_t *o = json_object();
    if (p->joint_count > 0)
        put(w, o, "joints", joints_json(w, p));
    else
        put(w, o, "to", point_json(w, &p->to));
    if (p->via_count > 0) {
        json_t *via = json_array();
        for (int i = 0; i < p->via_count; i++)
            if (json_array_append_new(via, point_json(w, p->via + i)) != 0) w->failed = true;
        put(w, o, "via", via);
    }
    if (p->law != TD_TASK_FASTEST)
        put(w, o, "law",
            (unsigned)p->law <= TD_TASK_CONSTANT_ACCELERATION ? json_string(td_task_laws[p->law])
                                                              : json_null());
    put_real(w, o, "duration_s", p->duration_s, 0);
    return o;
}

static json_t *drive_json(writer *w, const td_task_drive *d)
{
    json_t *o = json_object();
    if (d->has_to) {
        json_t *to = json_object();
        put(w, to, "x_m", td_json_real(d->to_m[0]));
        put(w, to, "y_m", td_json_real(d->to_m[1]));
        put(w, to, "yaw_deg", td_json_real(d->yaw_deg));
        put(w, o, "to", to);
    } else {
        put_real(w, o, "distance_m", d->distance_m, 0);
        put_real(w, o, "turn_deg", d->turn_deg, 0);
    }
    put_real(w, o, "speed_m_s", d->speed_m_s, 0);
    return o;
}

static json_t *dig_json(writer *w, const td_task_dig *d)
{
    json_t *o = json_object();
    put(w, o, "from", point_json(w, &d->from));
    if (d->has_heading) put(w, o, "heading_deg", td_json_real(d->heading_deg));
    put(w, o, "length_m", td_json_real(d->length_m));
    put(w, o, "depth_m", td_json_real(d->depth_m));
    put_real(w, o, "width_m", d->width_m, 0);
    put_real(w, o, "force_n", d->force_n, INFINITY);
    return o;
}

static json_t *press_json(writer *w, const td_task_press *p)
{
    json_t *o = json_object();
    put(w, o, "axis", td_json_reals(p->axis, 3));
    put(w, o, "force_n", td_json_real(p->force_n));
    put(w, o, "for_s", td_json_real(p->for_s));
    put_real(w, o, "approach_speed_m_s", p->approach_speed_m_s, 0);
    put_real(w, o, "most_travel_m", p->most_travel_m, INFINITY);
    return o;
}

static json_t *step_json(writer *w, const td_task_step *step)
{
    json_t *o = json_object(), *what = NULL;
    switch (step->kind) {
    case TD_TASK_POSITION:
        what = position_json(w, &step->as.position);
        break;
    case TD_TASK_DRIVE:
        what = drive_json(w, &step->as.drive);
        break;
    case TD_TASK_DIG:
        what = dig_json(w, &step->as.dig);
        break;
    case TD_TASK_DUMP:
        what = json_object();
        put(w, what, "at", point_json(w, &step->as.dump));
        break;
    case TD_TASK_PRESS:
        what = press_json(w, &step->as.press);
        break;
    case TD_TASK_WAIT:
        what = json_object();
        put(w, what, "for_s", td_json_real(step->as.wait_s));
        break;
    }
    put(w, o, td_task_kind_name(step->kind), what ? what : json_null());
    return o;
}

static void put_tool(writer *w, json_t *root, const td_task *t)
{
    static const double origin[3] = {0}, ahead[3] = {1, 0, 0};
    json_t *o = json_object();
    if (t->tool.link[0]) put(w, o, "link", json_string(t->tool.link));
    if (memcmp(t->tool.point_m, origin, sizeof origin) != 0)
        put(w, o, "point_m", td_json_reals(t->tool.point_m, 3));
    if (memcmp(t->tool.axis, ahead, sizeof ahead) != 0) put(w, o, "axis", td_json_reals(t->tool.axis, 3));
    if (json_object_size(o) > 0)
        put(w, root, "tool", o);
    else
        json_decref(o);
}

static void put_bounds(writer *w, json_t *root, const td_task *t)
{
    td_task d;
    td_task_defaults(&d);
    json_t *l = json_object(), *o = json_object();
    put_real(w, l, "speed_m_s", t->limits.speed_m_s, INFINITY);
    put_real(w, l, "acceleration_m_s2", t->limits.acceleration_m_s2, INFINITY);
    put_real(w, l, "joint_speed_share", t->limits.joint_speed_share, 1);
    put_real(w, l, "pump_share", t->limits.pump_share, 1);
    put_real(w, o, "position_m", t->tolerance.position_m, d.tolerance.position_m);
    put_real(w, o, "angle_deg", t->tolerance.angle_deg, d.tolerance.angle_deg);
    put_real(w, o, "force_n", t->tolerance.force_n, d.tolerance.force_n);
    if (json_object_size(l) > 0)
        put(w, root, "limits", l);
    else
        json_decref(l);
    if (json_object_size(o) > 0)
        put(w, root, "tolerance", o);
    else
        json_decref(o);
}

static json_t *task_json(writer *w, const td_task *t)
{
    json_t *root = json_object(), *steps = json_array();
    put(w, root, "teledimos", json_string(TD_TASK_IS));
    put(w, root, "name", json_string(t->name));
    if (t->about[0]) put(w, root, "about", json_string(t->about));
    if (t->frame != TD_TASK_VEHICLE)
        put(w, root, "frame", t->frame == TD_TASK_SITE ? json_string(td_task_frames[1]) : json_null());
    put_tool(w, root, t);
    put_bounds(w, root, t);
    for (int i = 0; i < t->step_count; i++)
        if (json_array_append_new(steps, step_json(w, t->step + i)) != 0) w->failed = true;
    put(w, root, "steps", steps);
    return root;
}

td_status td_task_text(char **text, const td_task *task, td_error *error)
{
    writer w = {false};
    td_task *again = NULL;
    *text = NULL;
    json_t *root = task_json(&w, task);
    td_status status =
        w.failed ? td_fail(error, TD_ERROR_DATA,
                           "task '%s': a text in it is not UTF-8, or there is no memory for it", task->name)
                 : td_document_to_yaml(text, root, 0, error);
    json_decref(root);
    if (status == TD_OK) {
        char name[TD_NAME_SIZE + 16] = "task ";
        strncat(name, task->name, TD_NAME_SIZE);
        status = td_task_parse(&again, *text, strlen(*text), name, error);
    }
    td_task_free(&again);
    if (status == TD_OK) return TD_OK;
    free(*text);
    *text = NULL;
    return status;
}
