/* The master: one order, or one task from its simulation to its end. */
#include <math.h>
#include <openssl/crypto.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"
#include "core/file.h"
#include "core/number.h"
#include "core/remote_plant.h"

static const double MEASURED_S = 0.5;     /* of the link, for status */
static const double PATIENT_PERIODS = 10; /* whether the machine is safe is the machine's to judge */
static const double ANSWER_S = 5, CHECKED_S = 120, RESTS_S = 10;

typedef struct master {
    const machine_options *o;
    terminal *term;
    td_link_options link_options;
    td_link *link, *pictures;
    td_machine_welcome welcome;
    td_machine_state_message state;
    td_machine_stopped stopped;
    td_machine_answer answer;
    bool has_welcome, has_state, has_stopped, has_answer;
    bool stopping; /* interrupted: what is left is to see the machine at rest */
    int images;
    json_t *task; /* what came of it; NULL: none */
} master;

/* ---- what comes ---- */

static td_status keep_image(master *m, const td_machine_image *i, td_error *error)
{
    char name[80];
    snprintf(name, sizeof name, "%04d-%s.jpg", m->images / 2 + 1, i->side ? "right" : "left");
    char *path = td_path_join(m->o->images, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const td_status status = td_file_write(path, i->jpeg, i->size, error);
    free(path);
    m->images++;
    return status;
}

static td_status hear_pictures(master *m, td_error *error)
{
    static td_machine_message message;
    bool came = true;
    while (m->pictures && came) {
        td_error why = {0};
        if (td_machine_wait(&message, &came, m->pictures, 0, &why) != TD_OK)
            td_link_free(&m->pictures); /* commands go on without */
        else if (came && message.kind == TD_MACHINE_IMAGE)
            TD_TRY(keep_image(m, &message.as.image, error));
    }
    return TD_OK;
}

static void show(master *m)
{
    const td_machine_state_message *s = &m->state;
    if (m->term->quiet || !m->term->is_tty) return;
    m->term->bar_shown = true;
    fprintf(stderr, "\r\033[K%8.1f s  %s, step %d of %d, round trip %.1f ms", s->plant.time_s, s->phase,
            s->step + 1 > s->steps ? s->steps : s->step + 1, s->steps,
            1e3 * td_link_measure_of(m->link, td_machine_now_s()).round_trip_s);
    fflush(stderr);
}

static td_status hear(master *m, double seconds, td_error *error)
{
    static td_machine_message message;
    bool came;
    TD_TRY(hear_pictures(m, error));
    TD_TRY(td_machine_wait(&message, &came, m->link, seconds, error));
    if (!came) return TD_OK;
    switch (message.kind) {
    case TD_MACHINE_WELCOME:
        m->welcome = message.as.welcome;
        m->has_welcome = true;
        break;
    case TD_MACHINE_STATE:
        m->state = message.as.state;
        m->has_state = true;
        show(m);
        break;
    case TD_MACHINE_STOPPED:
        m->stopped = message.as.stopped;
        m->has_stopped = true;
        break;
    case TD_MACHINE_ANSWER:
        m->answer = message.as.answer;
        m->has_answer = true;
        break;
    default:
        break;
    }
    return TD_OK;
}

/* Until *flag, at most `seconds`. */
static td_status await(master *m, const bool *flag, double seconds, const char *what, td_error *error)
{
    const double until = td_machine_now_s() + seconds;
    while (!*flag) {
        TD_TRY(hear(m, 0.05, error));
        if (terminal_interrupted() && !m->stopping) return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
        if (td_machine_now_s() > until)
            return td_fail(error, TD_ERROR_DEADLINE, "the machine at %s gave no %s within %g s",
                           td_link_peer(m->link), what, seconds);
    }
    return TD_OK;
}

/* ---- connected ---- */

static td_status meet(master *m, td_error *error)
{
    TD_TRY(td_link_connect(&m->link, m->o->connect, &m->link_options, td_machine_now_s(), error));
    TD_TRY(await(m, &m->has_welcome, ANSWER_S, "welcome", error));
    if (!m->welcome.is_operator)
        return td_fail(error, TD_ERROR_DATA, "another operator commands the machine at %s",
                       td_link_peer(m->link));
    return await(m, &m->has_state, ANSWER_S, "state", error);
}

static td_status see_images(master *m, td_error *error)
{
    if (!m->o->images) return TD_OK;
    TD_TRY(td_folder_make(m->o->images, error));
    td_link_options o = m->link_options;
    o.channel = TD_MACHINE_IMAGES;
    memcpy(o.session, m->welcome.session, sizeof o.session);
    o.frame_max = (size_t)TD_MACHINE_MAX_IMAGE + 4096;
    o.bytes_per_s = 64 << 20;
    o.timeout_s *= 10;
    return td_link_connect(&m->pictures, m->o->connect, &o, td_machine_now_s(), error);
}

/* ---- orders ---- */

static td_status order(master *m, td_machine_order what, bool *refused, td_error *error)
{
    td_machine_message message = {.kind = TD_MACHINE_ORDER};
    message.as.order = what;
    m->has_answer = false;
    TD_TRY(td_machine_send(m->link, &message, false, error));
    TD_TRY(await(m, &m->has_answer, ANSWER_S, "answer", error));
    *refused = !m->answer.accepted;
    return TD_OK;
}

static bool is_at_work(const master *m)
{
    return m->state.mode == TD_MODE_WORKING || m->state.mode == TD_MODE_PAUSED;
}

/* ---- a task ---- */

static td_status simulate(machine_verdict *v, master *m, const scenario *s, td_error *error)
{
    machine_check check = {.s = s, .task = s->task->task, .map = s->map, .start = m->state.plant};
    td_status status = machine_model(check.model, s, error);
    if (status == TD_OK && strcmp(check.model, m->welcome.model) != 0)
        status = td_fail(error, TD_ERROR_DATA, "the machine at %s is not that of %s: model %.8s, not %.8s",
                         td_link_peer(m->link), s->path, m->welcome.model, check.model);
    if (status == TD_OK) status = machine_check_begin(&check, error);
    while (status == TD_OK && !machine_check_poll(v, &check)) {
        status = hear(m, 0.02, error); /* the heart beats on */
        if (terminal_interrupted()) status = td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    }
    aside_free(&check.work);
    if (status == TD_OK && v->why[0]) status = td_fail(error, TD_ERROR_DATA, "simulated here: %s", v->why);
    return status;
}

static td_status send_task(const machine_verdict *v, master *m, const scenario *s, bool *refused,
                           td_error *error)
{
    td_machine_message message = {.kind = TD_MACHINE_TASK};
    char *text = NULL;
    TD_TRY(td_task_text(&text, s->task->task, error));
    message.as.task = (td_machine_task){.validation = v->validation, .text = text, .size = strlen(text)};
    m->has_answer = false;
    td_status status = td_machine_send(m->link, &message, false, error);
    free(text);
    if (status == TD_OK) status = await(m, &m->has_answer, CHECKED_S, "answer to the task", error);
    *refused = status == TD_OK && !m->answer.accepted;
    return status;
}

/* Ctrl-C stops the machine first. */
static td_status stop_first(master *m, td_error *error)
{
    bool unused;
    m->stopping = true;
    TD_TRY(order(m, TD_ORDER_STOP, &unused, error));
    TD_TRY(await(m, &m->has_stopped, RESTS_S, "word of its stop", error));
    return td_fail(error, TD_ERROR_CANCELLED, "interrupted: the machine was stopped, and is at rest");
}

static td_status watch(master *m, td_error *error)
{
    const double until = td_machine_now_s() + ANSWER_S;
    while (!is_at_work(m) && td_machine_now_s() < until) TD_TRY(hear(m, 0.05, error));
    while (is_at_work(m)) {
        TD_TRY(hear(m, 0.05, error));
        if (terminal_interrupted()) return stop_first(m, error);
    }
    if (m->state.mode == TD_MODE_FAILED || strstr(m->state.phase, "ready"))
        return await(m, &m->has_stopped, RESTS_S, "word of its stop", error);
    return TD_OK;
}

static td_status run_task(master *m, const scenario *s, bool *refused, td_error *error)
{
    machine_verdict v;
    double furthest = 0;
    TD_TRY(see_images(m, error));
    TD_TRY(simulate(&v, m, s, error));
    TD_TRY(send_task(&v, m, s, refused, error));
    if (*refused) return TD_OK;
    m->has_stopped = false;
    TD_TRY(order(m, TD_ORDER_EXECUTE, refused, error));
    if (*refused) return TD_OK;
    TD_TRY(watch(m, error));
    *refused = m->has_stopped;
    for (int k = 0; k < m->state.joints; k++)
        furthest = fmax(furthest, fabs(m->state.plant.q[k] - v.validation.end[k]));
    m->task = json_pack("{s:s, s:s, s:f, s:f, s:f, s:i}", "name", s->task->task->name, "hash",
                        v.validation.task, "predicted_s", v.validation.duration_s, "simulated_in_s", v.cpu_s,
                        "largest_joint_error", furthest, "images", m->images);
    return TD_OK;
}

/* ---- jog: through the plant ---- */

static td_status wanted_rates(td_plant_command *c, const master *m, const td_robot *robot, td_error *error)
{
    *c = (td_plant_command){.kind = TD_COMMAND_RATE};
    for (size_t i = 0; i < m->o->joints.count; i++) {
        char name[TD_NAME_SIZE];
        const char *text = m->o->joints.value[i], *equals = strchr(text, '=');
        snprintf(name, sizeof name, "%.*s", equals ? (int)(equals - text) : 0, text);
        const int k = td_robot_find_joint(robot, name);
        if (!equals || k < 0 || !td_number_real(&c->value[k], equals + 1))
            return td_fail(error, TD_ERROR_ARGUMENT, "--joint %s: NAME=RATE, of a joint of the robot", text);
    }
    return TD_OK;
}

static td_status jog(master *m, const scenario *s, td_error *error)
{
    td_plant plant;
    td_plant_command c;
    td_plant_state first = {0}, last = {0};
    TD_TRY(wanted_rates(&c, m, s->robot, error));
    TD_TRY(td_remote_plant_new(&plant, s->robot, m->o->connect, &m->link_options, error));
    td_status status = plant.state(plant.self, &first, error);
    last = first;
    const double for_s = m->o->for_s > 0 ? m->o->for_s : 1;
    while (status == TD_OK && last.time_s < first.time_s + for_s - 1e-9 && !terminal_interrupted()) {
        status = plant.command(plant.self, &c, error);
        if (status == TD_OK) status = plant.step(plant.self, s->period_s, error);
        if (status == TD_OK) status = plant.state(plant.self, &last, error);
    }
    if (status == TD_OK) {
        json_t *moved = json_object();
        for (int k = 0; k < s->robot->joint_count; k++)
            json_object_set_new(moved, s->robot->joint[k].name, json_real(last.q[k] - first.q[k]));
        m->task = json_pack("{s:f, s:o}", "took_s", last.time_s - first.time_s, "moved", moved);
    }
    td_remote_plant_free(&plant);
    return status;
}

/* ---- told ---- */

static json_t *result_of(const master *m, bool refused)
{
    json_t *result = json_pack("{s:s, s:s, s:s, s:b}", "job", "machine", "version", TD_VERSION, "verb",
                               m->o->verb, "refused", refused);
    if (m->has_state) {
        const td_machine_state_message *s = &m->state;
        json_t *joints = json_object();
        for (int k = 0; k < s->joints; k++)
            json_object_set_new(joints, m->welcome.joint[k],
                                json_pack("{s:f, s:f, s:f}", "position", s->plant.q[k], "rate",
                                          s->plant.dq[k], "force_n", s->plant.force[k]));
        json_object_set_new(result, "machine",
                            json_pack("{s:s, s:s, s:s, s:s, s:s, s:f, s:o}", "robot", m->welcome.robot,
                                      "model", m->welcome.model, "mode", td_machine_mode_name(s->mode),
                                      "phase", s->phase, "fault", s->fault, "time_s", s->plant.time_s,
                                      "joints", joints));
    }
    if (m->link) {
        const td_link_measure l = td_link_measure_of(m->link, td_machine_now_s());
        json_object_set_new(result, "link",
                            json_pack("{s:f, s:f, s:I, s:I, s:I}", "round_trip_mean_s", l.mean_s,
                                      "round_trip_most_s", l.most_s, "pings", (json_int_t)l.pings, "late",
                                      (json_int_t)l.late, "retransmitted", (json_int_t)l.retransmitted));
    }
    if (m->has_answer)
        json_object_set_new(result, "answer",
                            json_pack("{s:b, s:s}", "accepted", m->answer.accepted, "text", m->answer.text));
    if (m->has_stopped)
        json_object_set_new(result, "stopped",
                            json_pack("{s:s, s:f, s:f, s:s, s:f}", "why", m->stopped.why, "silent_s",
                                      m->stopped.silent_s, "took_s", m->stopped.took_s, "joint",
                                      m->welcome.joint[m->stopped.joint], "angle", m->stopped.angle));
    if (m->task) json_object_set(result, "task", m->task);
    return result;
}

static void table_of(const master *m)
{
    const td_machine_state_message *s = &m->state;
    if (m->has_answer)
        printf("%s: %s\n",
               m->answer.kind == TD_MACHINE_TASK ? "task" : td_machine_order_name(m->answer.order),
               m->answer.text);
    if (m->has_state)
        printf("%s at %.1f s: %s%s%s\n", m->welcome.robot, s->plant.time_s, s->phase, s->fault[0] ? "; " : "",
               s->fault);
    for (int k = 0; k < s->joints && m->has_state; k++)
        printf("  %-12s %9.4f  %9.4f /s  %10.1f kN\n", m->welcome.joint[k], s->plant.q[k], s->plant.dq[k],
               1e-3 * s->plant.force[k]);
    if (m->has_stopped)
        printf("stopped (%s): silent for %.3f s, at rest after %.2f s, %s went on by %.4f\n", m->stopped.why,
               m->stopped.silent_s, m->stopped.took_s, m->welcome.joint[m->stopped.joint], m->stopped.angle);
    if (m->task) {
        const char *key;
        json_t *value;
        json_object_foreach(m->task, key, value) if (json_is_number(value))
            printf("%s: %.6g\n", key, json_number_value(value));
    }
    if (m->link) {
        const td_link_measure l = td_link_measure_of(m->link, td_machine_now_s());
        printf(
            "link: round trip %.2f ms, at most %.2f ms; %llu of %llu pings late, %llu segments sent again\n",
            1e3 * l.mean_s, 1e3 * l.most_s, (unsigned long long)l.late, (unsigned long long)l.pings,
            (unsigned long long)l.retransmitted);
    }
}

static td_status tell(const master *m, bool refused, td_error *error)
{
    terminal_clear(m->term);
    if (m->o->common->json) {
        json_t *result = result_of(m, refused);
        char *text = result ? json_dumps(result, JSON_INDENT(2) | JSON_PRESERVE_ORDER) : NULL;
        const bool told = text && puts(text) >= 0;
        free(text);
        json_decref(result);
        if (!told) return td_fail(error, TD_ERROR_IO, "the result cannot be told as JSON");
    } else if (!m->o->common->quiet) {
        table_of(m);
    }
    if (fflush(stdout) != 0) return td_fail(error, TD_ERROR_IO, "standard output cannot be written");
    return TD_OK;
}

static td_status obey(master *m, const scenario *s, bool *refused, td_error *error)
{
    const char *verb = m->o->verb;
    if (strcmp(verb, "jog") == 0) return jog(m, s, error);
    TD_TRY(meet(m, error));
    if (strcmp(verb, "run") == 0) return run_task(m, s, refused, error);
    for (int o = 0; o < TD_ORDER_COUNT; o++)
        if (strcmp(verb, td_machine_order_name((td_machine_order)o)) == 0)
            TD_TRY(order(m, (td_machine_order)o, refused, error));
    const double until = td_machine_now_s() + MEASURED_S;
    while (td_machine_now_s() < until) TD_TRY(hear(m, 0.05, error));
    return TD_OK;
}

td_status machine_master(const machine_options *o, terminal *term, bool *refused, td_error *error)
{
    master *m = calloc(1, sizeof *m);
    uint8_t token[TD_LINK_TOKEN_MAX];
    scenario s = {0};
    const td_progress progress = terminal_progress(term);
    if (!m) return td_fail(error, TD_ERROR_MEMORY, "no memory for a master");
    m->o = o;
    m->term = term;
    td_status status = machine_link_options(&m->link_options, token, o, error);
    m->link_options.timeout_s = PATIENT_PERIODS * o->period_s;
    if (status == TD_OK && o->scenario) status = machine_read(&s, o, o->scenario, &progress, error);
    if (status == TD_OK) status = obey(m, &s, refused, error);
    if (status == TD_OK) status = tell(m, *refused, error);
    td_link_free(&m->link);
    td_link_free(&m->pictures);
    OPENSSL_cleanse(token, sizeof token);
    json_decref(m->task);
    scenario_free(&s);
    free(m);
    return status;
}
