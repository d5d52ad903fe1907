/* task.yaml, laid out as core/task.h says. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/task_internal.h"
#include "core/text_internal.h"

static const double FAR_M = 1e7, LONG_M = 1e4, LONG_S = 1e6, FAST_M_S = 1e3, STRONG_N = 1e9,
                    TURNS_DEG = 36000;
/* A length, time, speed or force is at least this much of its unit. */
static const double LEAST = 1e-6;

/* ---- fields ---- */

/* Leaves the default where it is missing. */
static td_status take(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

static td_status need(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return td_field_real(value, &field, low, high, error);
}

static td_status take_axis(double axis[3], const td_field *parent, bool needed, td_error *error)
{
    const td_field field = td_field_get(parent, "axis");
    if (!field.value && !needed) return TD_OK;
    TD_TRY(td_field_reals(axis, 3, &field, -FAR_M, FAR_M, error));
    return td_task_unit(axis, 3) ? TD_OK : td_field_fail(&field, error, "has no length; give a direction");
}

/* A name of a robot's: the URDF says what may be in it. */
static td_status take_name(char name[TD_NAME_SIZE], const td_field *field, td_error *error)
{
    const char *text = NULL;
    TD_TRY(td_field_string(&text, field, error));
    if (!*text || strlen(text) >= TD_NAME_SIZE)
        return td_field_fail(field, error, "must be a name of 1 to %d bytes", TD_NAME_SIZE - 1);
    strcpy(name, text);
    return TD_OK;
}

static td_status take_point(td_task_point *p, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"x_m", "y_m", "z_m", "pitch_deg", "q", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    for (int i = 0; i < 3; i++) TD_TRY(need(p->at_m + i, field, keys[i], -FAR_M, FAR_M, error));
    const td_field pitch = td_field_get(field, keys[3]), q = td_field_get(field, keys[4]);
    if (pitch.value && q.value)
        return td_field_fail(field, error, "has both pitch_deg and q; give one, or none for any attitude");
    if (pitch.value) {
        p->attitude = TD_TASK_PITCH;
        return td_field_real(&p->pitch_deg, &pitch, -TURNS_DEG, TURNS_DEG, error);
    }
    if (!q.value) return TD_OK;
    p->attitude = TD_TASK_WHOLE;
    TD_TRY(td_field_reals(p->q, 4, &q, -2, 2, error));
    const double length = sqrt(p->q[0] * p->q[0] + p->q[1] * p->q[1] + p->q[2] * p->q[2] + p->q[3] * p->q[3]);
    if (!(fabs(length - 1) <= 1e-6))
        return td_field_fail(&q, error, "must be a unit quaternion [w, x, y, z], but its length is %.9g",
                             length);
    td_task_unit(p->q, 4);
    return TD_OK;
}

/* ---- steps ---- */

static bool ends_in(const char *text, const char *end)
{
    const size_t size = strlen(text), tail = strlen(end);
    return size > tail && !strcmp(text + size - tail, end);
}

/* "boom_deg: 30". */
static td_status take_joint(td_task_joint *j, const td_field *field, td_error *error)
{
    char shown[TD_SHOWN_SIZE];
    j->slides = ends_in(field->name, "_m");
    if (!j->slides && !ends_in(field->name, "_deg"))
        return td_field_fail(field, error, "must end in its unit: %s_deg, or _m where the joint slides",
                             td_text_shown(shown, field->name));
    const size_t size = strlen(field->name) - (j->slides ? 2 : 4);
    if (size >= TD_NAME_SIZE) return td_field_fail(field, error, "is no joint: its name is too long");
    memcpy(j->name, field->name, size);
    j->name[size] = 0;
    const double most = j->slides ? LONG_M : TURNS_DEG;
    return td_field_real(&j->value, field, -most, most, error);
}

static td_status take_joints(td_task_position *p, const td_field *field, td_error *error)
{
    if (!json_is_object(field->value))
        return td_field_fail(field, error, "must be a mapping of joints to angles");
    const size_t count = json_object_size(field->value);
    if (count == 0 || count > TD_ROBOT_MAX_JOINTS)
        return td_field_fail(field, error, "must name 1 to %d joints", TD_ROBOT_MAX_JOINTS);
    p->joint = calloc(count, sizeof *p->joint);
    if (!p->joint) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)field->value, key, value)
    {
        const td_field at = {field, key, value};
        TD_TRY(take_joint(p->joint + p->joint_count, &at, error));
        for (int i = 0; i < p->joint_count; i++)
            if (!strcmp(p->joint[i].name, p->joint[p->joint_count].name))
                return td_field_fail(&at, error, "the joint is given twice");
        p->joint_count++;
    }
    return TD_OK;
}

static td_status take_vias(td_task_position *p, const td_field *field, td_error *error)
{
    size_t count = 0;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_count(&count, field, 1, TD_TASK_MAX_VIA, error));
    p->via = calloc(count, sizeof *p->via);
    if (!p->via) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field at = td_field_at(field, i, index);
        TD_TRY(take_point(p->via + i, &at, error));
    }
    p->via_count = (int)count;
    return TD_OK;
}

/* The straight way through the points that are known takes a time of its own. */
static td_status check_duration(const td_task *task, const td_task_position *p, const td_field *field,
                                td_error *error)
{
    double length = 0;
    for (int i = 0; i < p->via_count; i++) {
        const double *a = p->via[i].at_m, *b = i + 1 < p->via_count ? p->via[i + 1].at_m : p->to.at_m;
        length += hypot(hypot(b[0] - a[0], b[1] - a[1]), b[2] - a[2]);
    }
    if (p->duration_s == 0 || length <= p->duration_s * task->limits.speed_m_s) return TD_OK;
    return td_field_fail(
        field, error,
        "duration_s %g is too short: from the first via to the end it is %.4g m, which at limits.speed_m_s "
        "%g takes %.4g s",
        p->duration_s, length, task->limits.speed_m_s, length / task->limits.speed_m_s);
}

static td_status take_position(td_task_step *step, const td_task *task, const td_field *field,
                               td_error *error)
{
    static const char *const keys[] = {"to", "via", "joints", "law", "duration_s", NULL};
    td_task_position *p = &step->as.position;
    int law = TD_TASK_FASTEST;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field to = td_field_get(field, "to"), via = td_field_get(field, "via");
    const td_field joints = td_field_get(field, "joints"), way = td_field_get(field, "law");
    if (!to.value == !joints.value)
        return td_field_fail(field, error, "needs either to (a point) or joints (their angles)");
    if (joints.value && via.value)
        return td_field_fail(&via, error, "goes with to, not with joints; write a step for each place");
    if (way.value)
        TD_TRY(td_field_choice(&law, &way, td_task_laws,
                               "fastest, cubic, quintic, constant-velocity or constant-acceleration", error));
    p->law = (td_task_law)law;
    TD_TRY(take(&p->duration_s, field, "duration_s", LEAST, LONG_S, error));
    if (joints.value) return take_joints(p, &joints, error);
    TD_TRY(take_vias(p, &via, error));
    TD_TRY(take_point(&p->to, &to, error));
    return check_duration(task, p, field, error);
}

static td_status take_drive(td_task_drive *d, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"to", "distance_m", "turn_deg", "speed_m_s", NULL};
    static const char *const place[] = {"x_m", "y_m", "yaw_deg", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field to = td_field_get(field, "to"), distance = td_field_get(field, "distance_m"),
                   turn = td_field_get(field, "turn_deg");
    TD_TRY(take(&d->speed_m_s, field, "speed_m_s", LEAST, FAST_M_S, error));
    d->has_to = to.value != NULL;
    if (d->has_to == (distance.value || turn.value))
        return td_field_fail(field, error, "needs either to (a place) or distance_m, turn_deg or both");
    if (!d->has_to) {
        TD_TRY(take(&d->distance_m, field, "distance_m", -FAR_M, FAR_M, error));
        TD_TRY(take(&d->turn_deg, field, "turn_deg", -TURNS_DEG, TURNS_DEG, error));
        return d->distance_m != 0 || d->turn_deg != 0 ? TD_OK : td_field_fail(field, error, "drives nowhere");
    }
    TD_TRY(td_field_check_keys(&to, place, error));
    for (int i = 0; i < 2; i++) TD_TRY(need(d->to_m + i, &to, place[i], -FAR_M, FAR_M, error));
    return need(&d->yaw_deg, &to, place[2], -TURNS_DEG, TURNS_DEG, error);
}

static td_status take_dig(td_task_dig *d, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"from",    "heading_deg", "length_m", "depth_m",
                                       "width_m", "force_n",     NULL};
    d->force_n = INFINITY;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field from = td_field_get(field, "from"), heading = td_field_get(field, "heading_deg");
    TD_TRY(take_point(&d->from, &from, error));
    d->has_heading = heading.value != NULL;
    TD_TRY(take(&d->heading_deg, field, "heading_deg", -TURNS_DEG, TURNS_DEG, error));
    TD_TRY(need(&d->length_m, field, "length_m", LEAST, LONG_M, error));
    TD_TRY(need(&d->depth_m, field, "depth_m", LEAST, LONG_M, error));
    TD_TRY(take(&d->width_m, field, "width_m", LEAST, LONG_M, error));
    return take(&d->force_n, field, "force_n", LEAST, STRONG_N, error);
}

static td_status take_press(td_task_press *p, const td_task *task, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"axis",          "force_n", "for_s", "approach_speed_m_s",
                                       "most_travel_m", NULL};
    p->most_travel_m = INFINITY;
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(take_axis(p->axis, field, true, error));
    TD_TRY(need(&p->force_n, field, "force_n", LEAST, STRONG_N, error));
    TD_TRY(need(&p->for_s, field, "for_s", 0, LONG_S, error));
    TD_TRY(take(&p->approach_speed_m_s, field, keys[3], LEAST, FAST_M_S, error));
    TD_TRY(take(&p->most_travel_m, field, keys[4], LEAST, LONG_M, error));
    if (p->approach_speed_m_s > task->limits.speed_m_s)
        return td_field_fail(field, error, "approach_speed_m_s %g is beyond limits.speed_m_s %g",
                             p->approach_speed_m_s, task->limits.speed_m_s);
    if (p->force_n <= task->tolerance.force_n)
        return td_field_fail(field, error,
                             "force_n %g is within its own tolerance, tolerance.force_n %g; ask for a "
                             "narrower one",
                             p->force_n, task->tolerance.force_n);
    return TD_OK;
}

static td_status take_dump(td_task_point *p, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"at", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field at = td_field_get(field, "at");
    return take_point(p, &at, error);
}

static td_status take_wait(double *wait_s, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"for_s", NULL};
    TD_TRY(td_field_check_keys(field, keys, error));
    return need(wait_s, field, "for_s", 0, LONG_S, error);
}

static td_status take_step(td_task_step *step, const td_task *task, const td_field *field, td_error *error)
{
    const char *keys[TD_TASK_KINDS + 1] = {NULL};
    for (int i = 0; i < TD_TASK_KINDS; i++) keys[i] = td_task_kind_name((td_task_kind)i);
    TD_TRY(td_field_check_keys(field, keys, error));
    if (json_object_size(field->value) != 1)
        return td_field_fail(field, error,
                             "must be one of position, drive, dig, dump, press and wait, but has %zu",
                             json_object_size(field->value));
    for (int i = 0; i < TD_TASK_KINDS; i++)
        if (json_object_get(field->value, keys[i])) step->kind = (td_task_kind)i;
    const td_field what = td_field_get(field, keys[step->kind]);
    switch (step->kind) {
    case TD_TASK_POSITION:
        return take_position(step, task, &what, error);
    case TD_TASK_DRIVE:
        return take_drive(&step->as.drive, &what, error);
    case TD_TASK_DIG:
        return take_dig(&step->as.dig, &what, error);
    case TD_TASK_DUMP:
        return take_dump(&step->as.dump, &what, error);
    case TD_TASK_PRESS:
        return take_press(&step->as.press, task, &what, error);
    case TD_TASK_WAIT:
        break;
    }
    return take_wait(&step->as.wait_s, &what, error);
}

/* ---- the whole ---- */

static td_status take_kind(const td_field *root, td_error *error)
{
    const td_field field = td_field_get(root, "teledimos");
    const char *text = NULL;
    char shown[TD_SHOWN_SIZE];
    if (!field.value)
        return td_field_fail(root, error, "is no task: 'teledimos: %s' is missing at its beginning",
                             TD_TASK_IS);
    TD_TRY(td_field_string(&text, &field, error));
    if (strcmp(text, TD_TASK_IS) == 0) return TD_OK;
    return td_field_fail(&field, error, "is '%s', but must be '%s'", td_text_shown(shown, text), TD_TASK_IS);
}

static td_status take_head(td_task *t, const td_field *root, td_error *error)
{
    const td_field name = td_field_get(root, "name"), about = td_field_get(root, "about"),
                   frame = td_field_get(root, "frame");
    const char *text = NULL;
    int which = TD_TASK_VEHICLE;
    TD_TRY(td_field_string(&text, &name, error));
    if (!td_name_is_plain(text))
        return td_field_fail(&name, error, "must be 1 to %d letters, digits, - and _", TD_NAME_SIZE - 1);
    strcpy(t->name, text);
    if (about.value) {
        TD_TRY(td_field_string(&text, &about, error));
        if (strlen(text) >= TD_TASK_ABOUT_SIZE)
            return td_field_fail(&about, error, "is longer than %d bytes", TD_TASK_ABOUT_SIZE - 1);
        strcpy(t->about, text);
    }
    if (frame.value) TD_TRY(td_field_choice(&which, &frame, td_task_frames, "vehicle or site", error));
    t->frame = (td_task_frame)which;
    return TD_OK;
}

static td_status take_tool(td_task *t, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"link", "point_m", "axis", NULL};
    if (!field->value) return TD_OK;
    TD_TRY(td_field_check_keys(field, keys, error));
    const td_field link = td_field_get(field, "link"), point = td_field_get(field, "point_m");
    if (link.value) TD_TRY(take_name(t->tool.link, &link, error));
    if (point.value) TD_TRY(td_field_reals(t->tool.point_m, 3, &point, -LONG_M, LONG_M, error));
    return take_axis(t->tool.axis, field, false, error);
}

static td_status take_bounds(td_task *t, const td_field *root, td_error *error)
{
    static const char *const limits[] = {"speed_m_s", "acceleration_m_s2", "joint_speed_share", "pump_share",
                                         NULL};
    static const char *const tolerances[] = {"position_m", "angle_deg", "force_n", NULL};
    const td_field l = td_field_get(root, "limits"), o = td_field_get(root, "tolerance");
    if (l.value) {
        TD_TRY(td_field_check_keys(&l, limits, error));
        TD_TRY(take(&t->limits.speed_m_s, &l, limits[0], LEAST, FAST_M_S, error));
        TD_TRY(take(&t->limits.acceleration_m_s2, &l, limits[1], LEAST, FAST_M_S, error));
        TD_TRY(take(&t->limits.joint_speed_share, &l, limits[2], LEAST, 1, error));
        TD_TRY(take(&t->limits.pump_share, &l, limits[3], LEAST, 1, error));
    }
    if (!o.value) return TD_OK;
    TD_TRY(td_field_check_keys(&o, tolerances, error));
    TD_TRY(take(&t->tolerance.position_m, &o, tolerances[0], LEAST, LONG_M, error));
    TD_TRY(take(&t->tolerance.angle_deg, &o, tolerances[1], LEAST, 360, error));
    return take(&t->tolerance.force_n, &o, tolerances[2], LEAST, STRONG_N, error);
}

static td_status take_task(td_task *t, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"teledimos", "name",      "about", "frame", "tool",
                                       "limits",    "tolerance", "steps", NULL};
    size_t count = 0;
    const td_field tool = td_field_get(root, "tool"), steps = td_field_get(root, "steps");
    TD_TRY(take_kind(root, error));
    TD_TRY(td_field_check_keys(root, keys, error));
    TD_TRY(take_head(t, root, error));
    TD_TRY(take_tool(t, &tool, error));
    TD_TRY(take_bounds(t, root, error));
    TD_TRY(td_field_count(&count, &steps, 1, TD_TASK_MAX_STEPS, error));
    t->step = calloc(count, sizeof *t->step);
    if (!t->step) return td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    t->step_count = (int)count;
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field step = td_field_at(&steps, i, index);
        TD_TRY(take_step(t->step + i, t, &step, error));
    }
    return TD_OK;
}

td_status td_task_parse(td_task **task, const char *text, size_t size, const char *name, td_error *error)
{
    json_t *document = NULL;
    *task = NULL;
    TD_TRY(td_document_parse(&document, text, size, name, error));
    td_task *made = calloc(1, sizeof *made);
    td_status status = made ? TD_OK : td_fail(error, TD_ERROR_MEMORY, "no memory for a task");
    if (made) {
        const td_field root = {NULL, name, document};
        td_task_defaults(made);
        status = take_task(made, &root, error);
        if (status != TD_OK) status = td_document_locate(error, status, text, size, name);
    }
    json_decref(document);
    if (status != TD_OK)
        td_task_free(&made);
    else
        *task = made;
    return status;
}
