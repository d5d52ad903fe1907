/* What of a scenario the operator sees, and may change while nothing runs: the paper's parameters of the
 * panel (durations, the law of motion, the pose wanted) and the generator's. */
#include <stdio.h>
#include <string.h>

#include "apps/panel_internal.h"
#include "core/document.h"

static const char *const laws[] = {"fastest", "cubic", "quintic", "constant-velocity",
                                   "constant-acceleration"};
enum { LAWS = sizeof laws / sizeof *laws };

typedef struct listing {
    panel_parameter *list;
    int count;
} listing;

static panel_parameter *next(listing *l, const char *name)
{
    static panel_parameter beyond;
    panel_parameter *p = l->count < PANEL_MAX_PARAMETERS ? l->list + l->count++ : &beyond;
    *p = (panel_parameter){.kind = PANEL_TEXT};
    snprintf(p->name, sizeof p->name, "%s", name);
    return p;
}

static void add_text(listing *l, const char *name, const char *text)
{
    next(l, name)->text = text;
}

/* low = high: it can only be seen. */
static void add_real(listing *l, const char *name, double *target, double low, double high)
{
    panel_parameter *p = next(l, name);
    p->kind = PANEL_REAL;
    p->value = *target;
    p->target = target;
    p->low = low, p->high = high;
}

/* "/task/step_1/to/x_m" and so on. */
static void add_point(listing *l, td_task_point *p, int step, const char *which)
{
    static const char *const axes[] = {"x_m", "y_m", "z_m"};
    char name[96];
    for (int k = 0; k < 3; k++) {
        snprintf(name, sizeof name, "/task/step_%d/%s/%s", step + 1, which, axes[k]);
        add_real(l, name, p->at_m + k, -1e5, 1e5);
    }
    if (p->attitude != TD_TASK_PITCH) return;
    snprintf(name, sizeof name, "/task/step_%d/%s/pitch_deg", step + 1, which);
    add_real(l, name, &p->pitch_deg, -180, 180);
}

static void add_position(listing *l, td_task_position *p, int step)
{
    char name[96], which[16];
    snprintf(name, sizeof name, "/task/step_%d/duration_s", step + 1);
    add_real(l, name, &p->duration_s, 0, 1e5);
    snprintf(name, sizeof name, "/task/step_%d/law", step + 1);
    panel_parameter *law = next(l, name);
    law->kind = PANEL_LAW;
    law->law = &p->law;
    panel_parameter_show(law, p->law);
    for (int i = 0; i < p->via_count; i++) {
        snprintf(which, sizeof which, "via_%d", i + 1);
        add_point(l, p->via + i, step, which);
    }
    if (p->joint_count == 0) add_point(l, &p->to, step, "to");
}

int panel_parameters_of(panel_parameter list[PANEL_MAX_PARAMETERS], scenario *s)
{
    listing l = {.list = list};
    add_text(&l, "/scenario", s->name);
    add_text(&l, "/robot", s->robot->name);
    add_text(&l, "/task/name", s->task->task->name);
    add_real(&l, "/control/period_s", &s->period_s, 0, 0);
    add_real(&l, "/control/gain_1_s", &s->gain_1_s, 0, 0);
    add_real(&l, "/simulation/duration_s", &s->duration_s, 1e-3, 1e5);
    add_real(&l, "/generator/alpha", &s->task->alpha, -1e3, 0);
    add_real(&l, "/generator/power", &s->task->power, 1, 100);
    for (int i = 0; i < s->task->task->step_count; i++)
        if (s->task->task->step[i].kind == TD_TASK_POSITION)
            add_position(&l, &s->task->task->step[i].as.position, i);
    return l.count;
}

json_t *panel_laws_json(void)
{
    json_t *list = json_array();
    for (int i = 0; i < LAWS; i++) json_array_append_new(list, json_string(laws[i]));
    return list;
}

bool panel_parameter_is_settable(const panel_parameter *p)
{
    return p->kind == PANEL_LAW || p->low < p->high;
}

td_status panel_parameter_read(double *number, const panel_parameter *p, const json_t *value, td_error *error)
{
    *number = 0;
    if (!panel_parameter_is_settable(p))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s can only be read", p->name);
    if (p->kind == PANEL_LAW) {
        const char *text = json_string_value(value);
        for (int i = 0; text && i < LAWS; i++)
            if (strcmp(text, laws[i]) == 0) {
                *number = i;
                return TD_OK;
            }
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s is fastest, cubic, quintic, constant-velocity or constant-acceleration", p->name);
    }
    *number = json_number_value(value);
    if (json_is_number(value) && *number >= p->low && *number <= p->high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "%s is a number from %g to %g", p->name, p->low, p->high);
}

json_t *panel_parameter_json(const panel_parameter *p)
{
    if (p->kind != PANEL_REAL) return json_pack("{s:s, s:s}", "name", p->name, "value", p->text);
    return json_pack("{s:s, s:o, s:s}", "name", p->name, "value", td_json_real(p->value), "type", "float64");
}

void panel_parameter_show(panel_parameter *p, double number)
{
    p->value = number;
    if (p->kind == PANEL_LAW) p->text = laws[(int)number];
}

static void set(const panel_parameter *p, double number)
{
    if (p->law)
        *p->law = (td_task_law)number;
    else
        *p->target = number;
}

td_status panel_parameter_apply(const panel_parameter *p, double number, const scenario *s, td_error *error)
{
    const double before = p->law ? (double)*p->law : *p->target;
    set(p, number);
    const td_status status = td_task_check(s->task->task, s->robot, &s->start.site_from_vehicle, error);
    if (status != TD_OK) set(p, before);
    return status;
}
