#include "apps/panel_about.h"

#include <math.h>
#include <stdlib.h>

#include "core/document.h"

/* ---- the logic ---- */

#define NAME_OF(code, text) #code,
static const char *const phase_names[] = {TD_PHASE_LIST(NAME_OF)};
static const char *const event_names[] = {TD_EVENT_LIST(NAME_OF)};
enum { PHASE_PREFIX = sizeof "TD_PHASE_" - 1, EVENT_PREFIX = sizeof "TD_EVENT_" - 1 };

static const char *phase_name(td_phase phase)
{
    return phase_names[phase] + PHASE_PREFIX;
}

static bool is_order(td_event event)
{
    return event == TD_EVENT_USER_STOP || event == TD_EVENT_ABORT || event >= TD_EVENT_PAUSE;
}

/* One reaction in that phase, with all at hand that an event may need. TD_EVENT_COUNT: none comes. */
static td_phase react(td_phase phase, td_event event, bool checked, td_answer *answer)
{
    td_behaviour_options o = td_behaviour_options_default();
    td_behaviour s;
    td_behaviour_outputs out;
    const td_behaviour_inputs in = {.events = event < TD_EVENT_COUNT ? TD_EVENT_BIT(event) : 0,
                                    .links_open = true,
                                    .parameters_read = checked,
                                    .task = 1,
                                    .machine_task = 1};
    o.singularity = TD_SINGULARITY_FAIL;
    o.has_machine = 1;
    td_behaviour_begin(&s, &o);
    s.phase = phase;
    s.task = 1;
    s.fault = phase == TD_PHASE_FAILED ? TD_FAULT_PART : TD_FAULT_NONE;
    td_behaviour_react(&s, &in, &out);
    *answer = event < TD_EVENT_COUNT ? out.answer[event] : TD_ANSWER_ACCEPTED;
    return out.phase;
}

static json_t *ways_json(void)
{
    json_t *ways = json_array();
    td_answer answer;
    for (td_phase p = 0; p < TD_PHASE_COUNT; p++) {
        for (td_event e = 0; e < TD_EVENT_COUNT; e++) {
            const td_phase to = react(p, e, false, &answer);
            if (answer == TD_ANSWER_ACCEPTED && (to != p || e > TD_EVENT_ABORT))
                json_array_append_new(ways, json_pack("{s:s, s:s, s:s}", "from", phase_name(p), "event",
                                                      td_event_text(e), "to", phase_name(to)));
        }
        const td_phase by_itself = react(p, TD_EVENT_COUNT, true, &answer);
        if (by_itself != p)
            json_array_append_new(ways, json_pack("{s:s, s:s, s:s}", "from", phase_name(p), "event", "", "to",
                                                  phase_name(by_itself)));
    }
    return ways;
}

json_t *panel_behaviour_json(void)
{
    json_t *phases = json_array(), *events = json_array(), *faults = json_array();
    for (td_phase p = 0; p < TD_PHASE_COUNT; p++)
        json_array_append_new(phases,
                              json_pack("{s:s, s:s}", "name", phase_name(p), "text", td_phase_text(p)));
    for (td_event e = 0; e < TD_EVENT_COUNT; e++)
        json_array_append_new(events, json_pack("{s:s, s:s, s:b}", "name", event_names[e] + EVENT_PREFIX,
                                                "text", td_event_text(e), "order", is_order(e)));
    for (td_fault f = TD_FAULT_NONE + 1; f < TD_FAULT_COUNT; f++)
        json_array_append_new(faults, json_string(td_fault_text(f)));
    return json_pack("{s:o, s:o, s:o, s:o}", "phases", phases, "events", events, "ways", ways_json(),
                     "faults", faults);
}

/* ---- the session ---- */

/* null: no limit. */
static json_t *limit(double value)
{
    return isfinite(value) ? td_json_real(value) : json_null();
}

static json_t *joints_json(const td_robot *robot)
{
    json_t *joints = json_array();
    for (int i = 0; i < robot->joint_count; i++) {
        const td_robot_joint *j = robot->joint + i;
        json_array_append_new(joints, json_pack("{s:s, s:s, s:o, s:o}", "name", j->name, "unit",
                                                j->kind == TD_JOINT_PRISMATIC ? "m" : "rad", "low",
                                                limit(j->lower), "high", limit(j->upper)));
    }
    return joints;
}

static json_t *parameter_json(const panel_parameter *p)
{
    json_t *o = json_pack("{s:s, s:b}", "name", p->name, "settable", panel_parameter_is_settable(p));
    if (p->kind == PANEL_REAL && panel_parameter_is_settable(p)) {
        json_object_set_new(o, "low", td_json_real(p->low));
        json_object_set_new(o, "high", td_json_real(p->high));
    }
    if (p->kind == PANEL_LAW) json_object_set_new(o, "choices", panel_laws_json());
    return o;
}

json_t *panel_about_json(const scenario *s, const panel_parameter *list, int count)
{
    const td_task *task = s->task->task;
    json_t *parameters = json_array();
    for (int i = 0; i < count; i++) json_array_append_new(parameters, parameter_json(list + i));
    return json_pack("{s:s, s:s, s:s, s:s, s:s, s:f, s:b, s:o, s:o, s:o}", "scenario", s->name, "robot",
                     s->robot->name, "task", task->name, "about", task->about, "task_frame",
                     task->frame == TD_TASK_SITE ? "site" : "vehicle", "period_s", s->period_s, "ground",
                     s->map != NULL, "joints", joints_json(s->robot), "parameters", parameters, "behaviour",
                     panel_behaviour_json());
}

/* ---- a motion that is to begin ---- */

static void add_fact(json_t *list, const char *key, json_t *value)
{
    char *text = json_is_string(value) ? NULL : json_dumps(value, JSON_ENCODE_ANY | JSON_REAL_PRECISION(6));
    json_array_append_new(list, json_pack("{s:s, s:s}", "key", key, "value",
                                          text                    ? text
                                          : json_is_string(value) ? json_string_value(value)
                                                                  : ""));
    free(text);
    json_decref(value);
}

static json_t *plan_facts(const live_plan *p, const td_robot *robot)
{
    const td_clearance *c = &p->clearance;
    json_t *list = json_array();
    add_fact(list, "duration_s", json_real(p->duration_s));
    add_fact(list, "verdict", json_string(p->clear ? "clear" : "refused"));
    if (!p->checked) return list;
    add_fact(list, "probability", json_real(c->probability));
    add_fact(list, "sigma_probability", json_real(c->sigma_probability));
    if (c->nearest.link < 0 || !isfinite(c->nearest.clearance_m)) return list;
    add_fact(list, "clearance_m", json_real(c->nearest.clearance_m));
    add_fact(list, "link", json_string(robot->link[c->nearest.link].name));
    add_fact(list, "time_s", json_real(c->nearest.time_s));
    if (c->likely.link >= 0) add_fact(list, "sigma_m", json_real(c->likely_sigma_m));
    return list;
}

json_t *panel_plan_json(const live_plan *p, const td_robot *robot)
{
    json_t *points = json_array();
    for (int i = 0; i < LIVE_PLAN_POINTS; i++)
        json_array_append_new(points, json_pack("{s:f, s:f, s:f}", "x", p->point[i][0], "y", p->point[i][1],
                                                "z", p->point[i][2]));
    json_t *line = json_pack(
        "{s:i, s:{s:{s:i, s:i, s:i}, s:{s:i, s:i, s:i, s:i}}, s:i, s:b, s:o, s:{s:f, s:f, s:f, s:f}, "
        "s:[], s:[]}",
        "type", 0, "pose", "position", "x", 0, "y", 0, "z", 0, "orientation", "x", 0, "y", 0, "z", 0, "w", 1,
        "thickness", 3, "scale_invariant", 1, "points", points, "color", "r", 0.84, "g", 0.37, "b", 0.0, "a",
        1.0, "colors", "indices");
    const int64_t ns = (int64_t)(p->time_s * 1e9);
    return json_pack(
        "{s:[], s:[{s:{s:I, s:I}, s:s, s:s, s:{s:i, s:i}, s:b, s:o, s:[], s:[], s:[], s:[], s:[o], s:[], "
        "s:[], s:[]}]}",
        "deletions", "entities", "timestamp", "sec", (json_int_t)(ns / 1000000000), "nsec",
        (json_int_t)(ns % 1000000000), "frame_id", "site", "id", "plan", "lifetime", "sec", 0, "nsec", 0,
        "frame_locked", 1, "metadata", plan_facts(p, robot), "arrows", "cubes", "spheres", "cylinders",
        "lines", line, "triangles", "texts", "models");
}
