#include "core/remote_plant.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/machine_messages.h"

static const double ANSWER_S = 3; /* more than any machine takes to answer an order */

typedef struct remote {
    const td_robot *robot;
    td_link *link;
    bool has_state, commanded;
    td_machine_state_message state;
    td_machine_message next; /* the command */
} remote;

/* Until a message of that kind; states are kept, a stop is a failure. */
static td_status await(td_machine_message *m, remote *r, td_machine_kind kind, double seconds,
                       td_error *error)
{
    const double until = td_machine_now_s() + seconds;
    for (;;) {
        bool came;
        TD_TRY(td_machine_wait(m, &came, r->link, fmax(0, until - td_machine_now_s()), error));
        if (!came)
            return td_fail(error, TD_ERROR_DEADLINE, "the machine at %s said nothing for %g s",
                           td_link_peer(r->link), seconds);
        if (m->kind == TD_MACHINE_STATE && m->as.state.joints == r->robot->joint_count) {
            r->state = m->as.state;
            r->has_state = true;
        }
        if (m->kind == kind) return TD_OK;
    }
}

static td_status check_welcome(const remote *r, const td_machine_welcome *w, td_error *error)
{
    if (!w->is_operator)
        return td_fail(error, TD_ERROR_DATA, "another operator commands the machine at %s",
                       td_link_peer(r->link));
    bool same = w->joints == r->robot->joint_count;
    for (int k = 0; same && k < w->joints; k++) same = strcmp(w->joint[k], r->robot->joint[k].name) == 0;
    if (same) return TD_OK;
    return td_fail(error, TD_ERROR_DATA, "the machine at %s, a %s, has other joints than robot '%s'",
                   td_link_peer(r->link), w->robot, r->robot->name);
}

static td_status ask(remote *r, td_machine_order order, td_error *error)
{
    td_machine_message m = {.kind = TD_MACHINE_ORDER};
    m.as.order = order;
    TD_TRY(td_machine_send(r->link, &m, false, error));
    TD_TRY(await(&m, r, TD_MACHINE_ANSWER, ANSWER_S, error));
    if (m.as.answer.accepted) return TD_OK;
    return td_fail(error, TD_ERROR_DATA, "the machine at %s does not take %s: %s", td_link_peer(r->link),
                   td_machine_order_name(order), m.as.answer.text);
}

static td_status begin(remote *r, td_error *error)
{
    td_machine_message m;
    TD_TRY(await(&m, r, TD_MACHINE_WELCOME, ANSWER_S, error));
    TD_TRY(check_welcome(r, &m.as.welcome, error));
    TD_TRY(ask(r, TD_ORDER_MANUAL, error));
    r->has_state = false;
    while (!r->has_state || r->state.mode != TD_MODE_MANUAL)
        TD_TRY(await(&m, r, TD_MACHINE_STATE, ANSWER_S, error));
    return TD_OK;
}

static td_status plant_command(void *self, const td_plant_command *command, td_error *error)
{
    remote *r = self;
    r->next = (td_machine_message){.kind = TD_MACHINE_JOINTS};
    r->next.as.joints.joints = r->robot->joint_count;
    r->next.as.joints.command = *command;
    r->commanded = true;
    return td_machine_send(r->link, &r->next, false, error);
}

static td_status plant_step(void *self, double dt_s, td_error *error)
{
    remote *r = self;
    td_machine_message m;
    const double until = r->state.plant.time_s + dt_s;
    while (r->state.plant.time_s < until - 1e-9) {
        TD_TRY(await(&m, r, TD_MACHINE_STATE, ANSWER_S, error));
        if (r->state.mode != TD_MODE_MANUAL)
            return td_fail(error, TD_ERROR_DATA, "the machine at %s is not moved by hand any more: %s%s%s",
                           td_link_peer(r->link), r->state.phase, r->state.fault[0] ? "; " : "",
                           r->state.fault);
        if (r->commanded && r->state.plant.time_s < until - 1e-9)
            TD_TRY(td_machine_send(r->link, &r->next, false, error));
    }
    return TD_OK;
}

static td_status plant_state(void *self, td_plant_state *state, td_error *error)
{
    (void)error;
    *state = ((const remote *)self)->state.plant;
    return TD_OK;
}

static void plant_free(void *self)
{
    remote *r = self;
    if (!r) return;
    if (r->link && td_link_state_of(r->link) == TD_LINK_OPEN && r->has_state) {
        td_error unused;
        (void)ask(r, TD_ORDER_AUTOMATIC, &unused);
    }
    td_link_free(&r->link);
    free(r);
}

td_status td_remote_plant_new(td_plant *plant, const td_robot *robot, const char *address,
                              const td_link_options *options, td_error *error)
{
    remote *r = calloc(1, sizeof *r);
    *plant = (td_plant){0};
    if (!r) return td_fail(error, TD_ERROR_MEMORY, "no memory for a remote machine");
    r->robot = robot;
    td_status status = td_link_connect(&r->link, address, options, td_machine_now_s(), error);
    if (status == TD_OK) status = begin(r, error);
    if (status != TD_OK) {
        plant_free(r);
        return status;
    }
    *plant = (td_plant){.self = r,
                        .robot = robot,
                        .command = plant_command,
                        .step = plant_step,
                        .state = plant_state,
                        .free = plant_free};
    return TD_OK;
}

void td_remote_plant_free(td_plant *plant)
{
    if (plant->self) plant->free(plant->self);
    *plant = (td_plant){0};
}

td_link_measure td_remote_plant_measure(const td_plant *plant)
{
    return td_link_measure_of(((const remote *)plant->self)->link, td_machine_now_s());
}
