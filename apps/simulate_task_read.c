/* What a scenario says of its task. All but `task` may be missing:
 *
 *   task: dig.yaml                                (a file beside it, or the task itself)
 *   ground: {map: …, soil: …}                     (apps/station.h: then drive, dig and dump are done too)
 *   contact: {link: bucket_tip, point_m: [0, 0, 0], plane_m: [8, 0, 0], normal: [0, 0, 1],
 *             stiffness_n_m: 1e7, friction: 0.4}  (a plane of the site that a point of a link meets)
 *   generator: {alpha: -1, power: 6}              (of trajectories: the pull away from the joints' limits)
 *   on_singularity: cross                         (or fail)
 *   live: {on_miss: stop, tolerance_s: 0.005}     (on_miss: stop, catch-up or slip)
 *   operator:                                     (orders given at a time, as keys give them live)
 *     - {at_s: 1, order: Pause}
 *     - {at_s: 2, order: Jog, joint: boom, stick: -0.5, for_s: 0.4} */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/simulate_task.h"
#include "core/document.h"
#include "core/file.h"

const char *const task_miss_names[] = {"stop", "catch-up", "slip", NULL};

static const uint32_t ORDERS = TD_EVENT_BIT(TD_EVENT_USER_STOP) | TD_EVENT_BIT(TD_EVENT_ABORT) |
                               TD_EVENT_BIT(TD_EVENT_PAUSE) | TD_EVENT_BIT(TD_EVENT_AUTOMATIC) |
                               TD_EVENT_BIT(TD_EVENT_RESUME) | TD_EVENT_BIT(TD_EVENT_PREPARE) |
                               TD_EVENT_BIT(TD_EVENT_REINIT) | TD_EVENT_BIT(TD_EVENT_START) |
                               TD_EVENT_BIT(TD_EVENT_MANUAL) | TD_EVENT_BIT(TD_EVENT_JOG);

void task_setup_free(task_setup **setup)
{
    if (!setup || !*setup) return;
    td_task_free(&(*setup)->task);
    free((*setup)->orders.item);
    free(*setup);
    *setup = NULL;
}

td_status inputs_add(task_inputs *inputs, const task_input *input, td_error *error)
{
    if (inputs->count == inputs->room) {
        const size_t room = 2 * inputs->room + 64;
        task_input *item = realloc(inputs->item, room * sizeof *item);
        if (!item) return td_fail(error, TD_ERROR_MEMORY, "no memory for the operator's orders");
        inputs->item = item;
        inputs->room = room;
    }
    inputs->item[inputs->count++] = *input;
    return TD_OK;
}

td_event task_event_named(const char *name)
{
    for (int e = 0; e < TD_EVENT_COUNT; e++)
        if (strcmp(name, td_event_text((td_event)e)) == 0) return (td_event)e;
    return TD_EVENT_COUNT;
}

static td_status real(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

/* ---- the task ---- */

/* A task within the scenario is one line for its reader, whose number says nothing. */
static td_status parse_inline(task_setup *t, const td_field *field, td_error *error)
{
    json_t *copy = json_copy((json_t *)field->value);
    if (copy && !json_object_get(copy, "teledimos"))
        json_object_set_new(copy, "teledimos", json_string("task 1"));
    char *text = copy ? json_dumps(copy, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(copy);
    if (!text) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    const td_status status = td_task_parse(&t->task, text, strlen(text), t->path, error);
    free(text);
    char *line = status != TD_OK && error ? strstr(error->message, ":1: ") : NULL;
    if (line) memmove(line, line + 2, strlen(line + 2) + 1);
    return status;
}

static td_status check_attitudes(const task_setup *t, int step, td_error *error)
{
    const td_task_position *p = &t->task->step[step].as.position;
    for (int k = 0; k < p->via_count; k++)
        if (p->via[k].attitude != p->to.attitude)
            return td_fail(error, TD_ERROR_DATA,
                           "%s: steps[%d].position: via[%d] and the goal must say the attitude alike, "
                           "as pitch_deg, as q, or not at all",
                           t->path, step, k);
    return TD_OK;
}

/* What only a machine on its ground does. */
static td_status check_ground(const task_setup *t, const scenario *s, int step, td_error *error)
{
    const td_task_kind kind = t->task->step[step].kind;
    const char *name = td_task_kind_name(kind);
    bool dumped = kind != TD_TASK_DIG;
    if (kind == TD_TASK_POSITION || kind == TD_TASK_WAIT || (kind == TD_TASK_PRESS && !s->has_ground))
        return TD_OK;
    if (!s->has_ground)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: steps[%d]: without a ground the machine stands on its suspension and does not "
                       "%s; give the scenario a ground",
                       t->path, step, name);
    if (kind == TD_TASK_DRIVE && s->options.base != TD_MACHINE_SUSPENDED)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: steps[%d]: a machine whose base is not suspended cannot drive", t->path, step);
    if (kind != TD_TASK_DRIVE && !s->ground.has_soil)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: steps[%d]: there is nothing to %s in ground without soil; give ground: {soil: "
                       "FILE}",
                       t->path, step, name);
    for (int i = step + 1; i < t->task->step_count && !dumped; i++)
        dumped = t->task->step[i].kind == TD_TASK_DUMP;
    if (!dumped)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: steps[%d]: a dig needs a place for its soil: add a dump after it", t->path, step);
    return TD_OK;
}

static td_status check_kinds(const task_setup *t, const scenario *s, td_error *error)
{
    for (int i = 0; i < t->task->step_count; i++) {
        if (t->task->step[i].kind == TD_TASK_POSITION) TD_TRY(check_attitudes(t, i, error));
        TD_TRY(check_ground(t, s, i, error));
    }
    return TD_OK;
}

static td_status read_task(task_setup *t, const scenario *s, const td_field *field, const char *folder,
                           td_error *error)
{
    if (json_is_object(field->value)) {
        snprintf(t->path, sizeof t->path, "%s: task", s->path);
        TD_TRY(parse_inline(t, field, error));
    } else {
        const char *name = NULL;
        TD_TRY(td_field_string(&name, field, error));
        char *path = td_path_join(folder, name);
        if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
        snprintf(t->path, sizeof t->path, "%s", path);
        free(path);
        TD_TRY(td_task_read(&t->task, t->path, error));
    }
    TD_TRY(check_kinds(t, s, error));
    const td_status status = td_task_check(t->task, s->robot, &s->start.site_from_vehicle, error);
    return status == TD_OK ? status : td_error_prefix(error, TD_ERROR_DATA, "%s", t->path);
}

/* ---- the rest ---- */

static td_status read_contact(task_setup *t, const scenario *s, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"link",        "point_m",  "plane_m",  "normal", "stiffness_n_m",
                                       "damping_s_m", "friction", "slip_m_s", NULL};
    const td_field field = td_field_get(root, "contact");
    if (!field.value) return TD_OK;
    if (s->has_ground)
        return td_field_fail(&field, error,
                             "a plane to touch is not for a machine on its ground; leave it out");
    const td_field link = td_field_get(&field, "link"), point = td_field_get(&field, "point_m"),
                   plane = td_field_get(&field, "plane_m"), normal = td_field_get(&field, "normal");
    const char *name = NULL;
    td_machine_contact *c = &t->contact;
    *c = td_machine_contact_default();
    t->has_contact = true;
    TD_TRY(td_field_check_keys(&field, keys, error));
    TD_TRY(td_field_string(&name, &link, error));
    c->link = td_robot_find_link(s->robot, name);
    if (c->link < 0) return td_field_fail(&link, error, "robot '%s' has no link '%s'", s->robot->name, name);
    c->normal[0] = c->normal[1] = 0, c->normal[2] = 1;
    if (point.value) TD_TRY(td_field_reals(c->point_m, 3, &point, -1e3, 1e3, error));
    if (normal.value) TD_TRY(td_field_reals(c->normal, 3, &normal, -1, 1, error));
    TD_TRY(td_field_reals(c->plane_m, 3, &plane, -1e5, 1e5, error));
    TD_TRY(real(&c->stiffness_n_m, &field, "stiffness_n_m", 1, 1e12, error));
    TD_TRY(real(&c->damping_s_m, &field, "damping_s_m", 0, 1e3, error));
    TD_TRY(real(&c->friction, &field, "friction", 0, 10, error));
    return real(&c->slip_m_s, &field, "slip_m_s", 1e-6, 1, error);
}

static td_status read_order(task_setup *t, const scenario *s, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"at_s", "order", "joint", "stick", "for_s", NULL};
    const td_field at = td_field_get(field, "at_s"), order = td_field_get(field, "order"),
                   joint = td_field_get(field, "joint");
    const char *name = NULL;
    double at_s = 0, for_s = 0;
    task_input input = {.joint = -1};
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(td_field_real(&at_s, &at, 0, 1e5, error));
    TD_TRY(td_field_string(&name, &order, error));
    input.event = task_event_named(name);
    if (input.event == TD_EVENT_COUNT || !(ORDERS & TD_EVENT_BIT(input.event)))
        return td_field_fail(
            &order, error,
            "'%s' is no order: Pause, Resume, Abort, Reinit, StartSim, UserStop, Manual, Jog "
            "or Automatic",
            name);
    if (input.event == TD_EVENT_JOG) {
        TD_TRY(td_field_string(&name, &joint, error));
        input.joint = td_robot_find_joint(s->robot, name);
        if (input.joint < 0)
            return td_field_fail(&joint, error, "robot '%s' has no joint '%s'", s->robot->name, name);
        TD_TRY(real(&input.stick, field, "stick", -1, 1, error));
        TD_TRY(real(&for_s, field, "for_s", 0, 60, error));
    }
    input.period = lround(at_s / s->period_s);
    if (t->orders.count && t->orders.item[t->orders.count - 1].period > input.period)
        return td_field_fail(&at, error, "orders stand in the order of time");
    const long last = lround((at_s + for_s) / s->period_s);
    for (; input.period == lround(at_s / s->period_s) || input.period < last; input.period++)
        TD_TRY(inputs_add(&t->orders, &input, error));
    return TD_OK;
}

static td_status read_operator(task_setup *t, const scenario *s, const td_field *root, td_error *error)
{
    const td_field list = td_field_get(root, "operator");
    size_t count = 0;
    t->orders.end = -1;
    if (!list.value) return TD_OK;
    TD_TRY(td_field_count(&count, &list, 0, 1000, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field order = td_field_at(&list, i, index);
        TD_TRY(read_order(t, s, &order, error));
    }
    return TD_OK;
}

static td_status read_rules(task_setup *t, const td_field *root, td_error *error)
{
    static const char *const generator_keys[] = {"alpha", "power", NULL};
    static const char *const live_keys[] = {"on_miss", "tolerance_s", NULL};
    static const char *const policies[] = {"cross", "fail", NULL};
    const td_field generator = td_field_get(root, "generator"), live = td_field_get(root, "live"),
                   singular = td_field_get(root, "on_singularity");
    int choice = 0;
    t->alpha = -1, t->power = 6, t->tolerance_s = 0.005;
    if (generator.value) TD_TRY(td_field_check_keys(&generator, generator_keys, error));
    TD_TRY(real(&t->alpha, &generator, "alpha", -1e3, 0, error));
    TD_TRY(real(&t->power, &generator, "power", 1, 100, error));
    if (singular.value) TD_TRY(td_field_choice(&choice, &singular, policies, "cross or fail", error));
    t->singularity = (td_singularity_policy)choice;
    choice = 0;
    if (!live.value) return TD_OK;
    TD_TRY(td_field_check_keys(&live, live_keys, error));
    TD_TRY(real(&t->tolerance_s, &live, "tolerance_s", 0, 10, error));
    const td_field miss = td_field_get(&live, "on_miss");
    if (miss.value) TD_TRY(td_field_choice(&choice, &miss, task_miss_names, "stop, catch-up or slip", error));
    t->miss = (td_miss_policy)choice;
    return TD_OK;
}

td_status task_setup_read(task_setup **setup, const scenario *s, const td_field *root, const char *folder,
                          td_error *error)
{
    const td_field field = td_field_get(root, "task");
    task_setup *t = *setup = calloc(1, sizeof *t);
    if (!t) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    if (!s->options.hydraulics)
        return td_field_fail(&field, error, "a task needs machine: {hydraulics: true}");
    TD_TRY(read_task(t, s, &field, folder, error));
    TD_TRY(read_contact(t, s, root, error));
    TD_TRY(read_rules(t, root, error));
    return read_operator(t, s, root, error);
}
