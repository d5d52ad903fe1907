/* The machine elsewhere: what it sees, and what it does, over a link. Nothing of its truth comes over it but
 * what it measures and what its cameras see. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "apps/far_machine.h"
#include "apps/machine_model.h"
#include "apps/machine_plan.h"
#include "apps/rehearse_internal.h"

static const double OPEN_S = 10, IMAGES_S = 120, CHECKED_S = 300, ANSWER_S = 10, REST_S = 10;
static const double AT_REST = 2e-3; /* rad/s or m/s */
static const double SILENT_S = 2;   /* this program is not in time */

struct rehearse_far {
    far_machine *machine;
    far_measured now;
    bool answered, accepted;
    td_machine_kind answered_kind;
    char answer[TD_MACHINE_TEXT_SIZE];
    double started_s; /* of the machine's time */
};
typedef struct rehearse_far rehearse_far;

static void wake(void *user)
{
    (void)user; /* it is looked at often enough */
}

static void nap(void)
{
    const struct timespec a_little = {.tv_nsec = 3000000};
    (void)nanosleep(&a_little, NULL);
}

/* ---- heard ---- */

static void hear(rehearse_far *f)
{
    far_machine_beat(f->machine);
    (void)far_machine_state(&f->now, f->machine);
    for (far_heard *h; (h = far_machine_hear(f->machine)); far_machine_heard(f->machine, h)) {
        if (h->kind != FAR_ANSWERED) continue;
        f->answered = true;
        f->answered_kind = h->answer.kind;
        f->accepted = h->answer.accepted;
        snprintf(f->answer, sizeof f->answer, "%s", h->answer.text);
    }
    for (far_heard *h; (h = far_machine_line(f->machine)); far_machine_lined(f->machine, h)) continue;
    for (far_measured *m; (m = far_machine_shown(f->machine)); far_machine_was_shown(f->machine, m)) continue;
}

/* Where the machine says that it stands. */
static void take_state(rehearse *r)
{
    r->state = r->far->now.state.plant;
}

static bool is_there(const rehearse_far *f)
{
    return f->now.open && f->now.has_state;
}

static bool is_at_rest(const rehearse_far *f, int joints)
{
    for (int k = 0; k < joints; k++)
        if (fabs(f->now.state.plant.dq[k]) > AT_REST) return false;
    return f->now.state.mode != TD_MODE_WORKING;
}

/* False: it is not there any more, or did not answer; the loop is stopped. */
static td_status await_answer(bool *accepted, rehearse *r, td_machine_kind kind, double seconds,
                              td_error *error)
{
    rehearse_far *f = r->far;
    const double until = td_machine_now_s() + seconds;
    *accepted = false;
    while (!f->answered || f->answered_kind != kind) {
        hear(f);
        if (terminal_interrupted()) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
        if (!f->now.open)
            rehearse_stop(r, "the machine is lost: %s", f->now.why);
        else if (td_machine_now_s() > until)
            rehearse_stop(r, "the machine did not answer within %g s", seconds);
        if (r->stopped) return TD_OK;
        nap();
    }
    *accepted = f->accepted;
    return TD_OK;
}

static void say(rehearse_far *f, const far_said *said)
{
    f->answered = false;
    (void)far_machine_say(f->machine, said);
}

static void order(rehearse_far *f, td_machine_order what)
{
    const far_said said = {.kind = TD_MACHINE_ORDER, .order = what};
    say(f, &said);
}

/* ---- begun and ended ---- */

static td_status reach(rehearse *r, td_error *error)
{
    rehearse_far *f = r->far;
    const double until = td_machine_now_s() + OPEN_S;
    while (!is_there(f) || f->now.state.mode == TD_MODE_CHECKING) {
        hear(f);
        if (terminal_interrupted()) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
        if (td_machine_now_s() > until)
            return td_fail(error, TD_ERROR_IO, "the machine is not there: %s", f->now.why);
        nap();
    }
    if (f->now.state.mode != TD_MODE_REST && f->now.state.mode != TD_MODE_HOLDING)
        return td_fail(error, TD_ERROR_DATA, "the machine is not at rest: %s; %s (teledimos machine reinit)",
                       f->now.state.phase, f->now.state.fault);
    take_state(r);
    return TD_OK;
}

td_status rehearse_far_begin(rehearse *r, const struct machine_address *address, td_error *error)
{
    char model[TD_HASH_HEX_SIZE];
    rehearse_far *f = r->far = calloc(1, sizeof *f);
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "no memory for a link");
    TD_TRY(machine_model(model, &r->scenario, error));
    TD_TRY(far_machine_new(&f->machine, address, model, r->scenario.robot->joint_count, SILENT_S, error));
    TD_TRY(far_machine_start(f->machine, wake, NULL, error));
    return reach(r, error);
}

void rehearse_far_free(rehearse *r)
{
    if (!r->far) return;
    far_machine_free(&r->far->machine);
    free(r->far);
    r->far = NULL;
}

/* ---- seen ---- */

static td_status take_picture(td_image *pair[2], td_pose *site_from_vehicle, double *q, const far_picture *p,
                              td_error *error)
{
    const td_machine_image *i = &p->image;
    if (i->size < 4 || i->jpeg[0] != 0x89) return TD_OK; /* not what was asked for */
    td_image_free(&pair[i->side]);
    *site_from_vehicle = i->site_from_vehicle;
    memcpy(q, i->q, (size_t)i->joints * sizeof *q);
    return td_image_decode(&pair[i->side], i->jpeg, i->size, 1, "an image of the machine's", error);
}

td_status rehearse_far_look(rehearse *r, int frame, td_image *pair[2], td_pose *site_from_vehicle, double *q,
                            td_error *error)
{
    rehearse_far *f = r->far;
    const far_said asked = {.kind = TD_MACHINE_LOOK, .look = frame + 1};
    const double until = td_machine_now_s() + IMAGES_S;
    td_status status = TD_OK;
    (void)far_machine_say(f->machine, &asked);
    while (status == TD_OK && !r->stopped && (!pair[0] || !pair[1])) {
        hear(f);
        for (far_picture *p; (p = far_machine_picture(f->machine)); far_machine_pictured(f->machine, p))
            if (status == TD_OK) status = take_picture(pair, site_from_vehicle, q, p, error);
        if (terminal_interrupted()) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
        if (!f->now.open) rehearse_stop(r, "the machine is lost: %s", f->now.why);
        if (td_machine_now_s() > until)
            rehearse_stop(r, "look %d: no images of the machine within %g s", r->looks, IMAGES_S);
        nap();
    }
    return status;
}

/* ---- done ---- */

static td_status keep_sample(task_run *run, const rehearse *r, const scenario *s, td_error *error)
{
    const td_machine_state_message *m = &r->far->now.state;
    td_pose at[TD_ROBOT_MAX_LINKS];
    if (run->count == run->room) {
        const size_t room = 2 * run->room + 512;
        task_sample *more = realloc(run->sample, room * sizeof *more);
        if (!more) return td_fail(error, TD_ERROR_MEMORY, "no memory for what the machine does");
        run->sample = more;
        run->room = room;
    }
    task_sample *a = run->sample + run->count++;
    *a = (task_sample){.time_s = m->plant.time_s - r->far->started_s,
                       .phase = TD_PHASE_EXECUTING,
                       .step = m->step,
                       .state = m->plant,
                       .motion = m->motion,
                       .share = m->share,
                       .dig_phase = m->dig_phase,
                       .loose = m->loose,
                       .press_n = NAN};
    a->state.time_s = a->time_s;
    memcpy(a->wanted, m->plant.q, sizeof a->wanted);
    const td_pose tool = task_tool(s->task->task);
    td_robot_forward(at, s->robot, m->plant.q);
    const td_pose vehicle = td_pose_compose(at + td_task_tool_link(s->task->task, s->robot), &tool);
    a->tool = a->tool_wanted = a->tool_true = td_pose_compose(&m->plant.site_from_vehicle, &vehicle);
    a->pitch_rad = a->pitch_wanted_rad = task_pitch(&a->tool);
    return TD_OK;
}

/* It is told to stop, and seen at rest. */
static void stop_there(rehearse *r)
{
    rehearse_far *f = r->far;
    const double until = td_machine_now_s() + REST_S;
    order(f, TD_ORDER_STOP);
    do {
        hear(f);
        nap();
    } while (f->now.open && td_machine_now_s() < until && !is_at_rest(f, r->scenario.robot->joint_count));
}

static td_status watch(task_run *run, rehearse *r, const scenario *s, const task_world *w, td_error *error)
{
    rehearse_far *f = r->far;
    const char *monitoring = td_phase_text(TD_PHASE_MONITORING);
    bool begun = false;
    double next_s = 0;
    for (;;) {
        char why[400] = "";
        bool deviates = false;
        const td_machine_state_message *m = &f->now.state;
        hear(f);
        if (terminal_interrupted()) {
            stop_there(r);
            return td_fail(error, TD_ERROR_CANCELLED, "interrupted: the machine was stopped");
        }
        if (!f->now.open) rehearse_stop(r, "the machine is lost: %s", f->now.why);
        if (m->mode == TD_MODE_FAILED) rehearse_stop(r, "the machine stopped: %s", m->fault);
        if (begun && m->mode == TD_MODE_REST && strcmp(m->phase, monitoring) != 0)
            rehearse_stop(r, "the machine gave up the task: %s", m->phase);
        if (r->stopped) return TD_OK;
        if (strcmp(m->phase, monitoring) == 0) return TD_OK;
        if (!begun && m->mode == TD_MODE_WORKING) begun = true, f->started_s = m->plant.time_s;
        if (!begun || m->plant.time_s - f->started_s < next_s - 1e-9) {
            nap();
            continue;
        }
        next_s += s->log_s;
        TD_TRY(keep_sample(run, r, s, error));
        run->time_s = run->sample[run->count - 1].time_s;
        if (w->watch) w->watch(w->user, run->sample + run->count - 1, &deviates, why, sizeof why);
        if (!deviates) continue;
        rehearse_stop(r, "stopped safely at %.1f s of the execution: %s", run->time_s, why);
        stop_there(r);
        return TD_OK;
    }
}

static td_status send_plan(rehearse *r, const scenario *s, const task_world *w, td_error *error)
{
    far_said said = {.kind = TD_MACHINE_PLAN};
    if (!w->plan) return TD_OK;
    TD_TRY(machine_plan_text(&said.text, w->plan, s->task->task, error));
    (void)far_machine_say(r->far->machine, &said);
    return TD_OK;
}

static td_status send_task(rehearse *r, const scenario *s, const task_run *ahead, td_error *error)
{
    far_said said = {.kind = TD_MACHINE_TASK};
    td_machine_validation *v = &said.validation;
    TD_TRY(td_task_hash(v->task, s->task->task, error));
    TD_TRY(td_task_text(&said.text, s->task->task, error));
    far_machine_model(v->model, r->far->machine);
    v->joints = s->robot->joint_count;
    v->duration_s = ahead->took_s;
    memcpy(v->start, r->state.q, sizeof v->start);
    memcpy(v->end, ahead->to, sizeof v->end);
    memcpy(v->force, ahead->peak, sizeof v->force);
    say(r->far, &said);
    return TD_OK;
}

td_status rehearse_far_execute(task_run *run, rehearse *r, const scenario *s, const task_run *ahead,
                               task_world *w, td_error *error)
{
    rehearse_far *f = r->far;
    bool accepted = false;
    *run = (task_run){.dug = {.clearance_m = INFINITY}};
    TD_TRY(send_plan(r, s, w, error));
    TD_TRY(send_task(r, s, ahead, error));
    TD_TRY(await_answer(&accepted, r, TD_MACHINE_TASK, CHECKED_S, error));
    if (!r->stopped && !accepted) rehearse_stop(r, "the machine does not take the task: %s", f->answer);
    if (r->stopped) return TD_OK;
    order(f, TD_ORDER_EXECUTE);
    TD_TRY(await_answer(&accepted, r, TD_MACHINE_ORDER, ANSWER_S, error));
    if (!r->stopped && !accepted) rehearse_stop(r, "the machine does not execute the task: %s", f->answer);
    if (r->stopped) return TD_OK;
    rehearse_order(r, TD_EVENT_EXECUTE, w->task_id);
    TD_TRY(watch(run, r, s, w, error));
    rehearse_order(r, r->stopped ? TD_EVENT_PART_FAILED : TD_EVENT_ENDED, w->task_id);
    run->phase = r->logic.phase;
    take_state(r);
    return TD_OK;
}
