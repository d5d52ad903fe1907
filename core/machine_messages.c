/* Each message is written and read by one and the same function, `pass_…`, so that the two cannot differ. */
#include "core/machine_messages.h"

#include <math.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* Writing (at NULL: only counting) or reading, until something is wrong. */
typedef struct coder {
    bool reads;
    uint8_t *to;
    const uint8_t *from;
    size_t used, size; /* size: where reading ends */
    const char *wrong; /* NULL: nothing so far */
} coder;

static void blame(coder *c, const char *what)
{
    if (!c->wrong) c->wrong = what;
}

/* ---- parts ---- */

static void pass_bytes(coder *c, void *bytes, size_t size)
{
    if (c->reads && (c->wrong || size > c->size - c->used)) {
        blame(c, "it ends too early");
        memset(bytes, 0, size);
        return;
    }
    if (c->reads)
        memcpy(bytes, c->from + c->used, size);
    else if (c->to)
        memcpy(c->to + c->used, bytes, size);
    c->used += size;
}

static uint64_t pass_number(coder *c, uint64_t value, int size)
{
    uint8_t bytes[8];
    for (int i = 0; i < size; i++) bytes[i] = (uint8_t)(value >> (8 * (size - 1 - i)));
    pass_bytes(c, bytes, (size_t)size);
    value = 0;
    for (int i = 0; i < size; i++) value = value << 8 | bytes[i];
    return value;
}

/* 0 to most. */
static int pass_int(coder *c, int value, int size, int most, const char *what)
{
    if (value < 0 || value > most) blame(c, what);
    const uint64_t got = pass_number(c, (uint64_t)value, size);
    if (got <= (uint64_t)most) return (int)got;
    blame(c, what);
    return 0;
}

static bool pass_bool(coder *c, bool value, const char *what)
{
    return pass_int(c, value, 1, 1, what) == 1;
}

static void pass_real(coder *c, double *value, const char *what)
{
    uint64_t bits;
    memcpy(&bits, value, sizeof bits);
    bits = pass_number(c, bits, 8);
    if (c->reads) memcpy(value, &bits, sizeof bits);
    if (isfinite(*value)) return;
    blame(c, what);
    if (c->reads) *value = 0;
}

static void pass_reals(coder *c, double *value, int count, const char *what)
{
    for (int i = 0; i < count; i++) pass_real(c, value + i, what);
}

/* What is no character of UTF-8 in its shortest form, or controls a terminal, is wrong. */
static bool is_text(const char *text, size_t size)
{
    for (size_t i = 0; i < size;) {
        const unsigned char lead = (unsigned char)text[i++];
        const int more = lead < 0x80 ? 0 : lead >= 0xF0 ? 3 : lead >= 0xE0 ? 2 : 1;
        unsigned code = more == 0 ? lead : lead & (0x3Fu >> more);
        if (lead < 0x20 || lead == 0x7F || (lead >= 0x80 && lead < 0xC2) || lead > 0xF4) return false;
        for (int k = 0; k < more; k++, i++) {
            if (i >= size || ((unsigned char)text[i] & 0xC0) != 0x80) return false;
            code = code << 6 | ((unsigned char)text[i] & 0x3F);
        }
        if ((more == 1 && code < 0xA0) || (more == 2 && code < 0x800) || (more == 3 && code < 0x10000) ||
            (code >= 0xD800 && code < 0xE000) || code > 0x10FFFF)
            return false;
    }
    return true;
}

static void pass_text(coder *c, char *text, size_t room, const char *what)
{
    size_t length = c->reads ? 0 : strnlen(text, room - 1);
    for (int i = 0; i < 3 && length && !is_text(text, length); i++) length--; /* a character cut in two */
    const size_t got = (size_t)pass_int(c, (int)length, 2, (int)room - 1, what);
    if (c->wrong) {
        if (c->reads) text[0] = 0;
        return;
    }
    pass_bytes(c, text, got);
    if (c->reads) text[c->wrong ? 0 : got] = 0;
    if (!is_text(text, got)) blame(c, what);
}

/* `digits` hexadecimal ones, lower case; all 0 stands for "" where that may be. */
static void pass_hex(coder *c, char *hex, int digits, bool may_be_none, const char *what)
{
    char text[TD_HASH_HEX_SIZE] = "";
    memset(text, '0', (size_t)digits);
    if (!c->reads && (hex[0] || !may_be_none)) memcpy(text, hex, strnlen(hex, (size_t)digits));
    if (!c->reads && hex[0] && strlen(hex) != (size_t)digits) blame(c, what);
    if (!c->reads && !hex[0] && !may_be_none) blame(c, what);
    pass_bytes(c, text, (size_t)digits);
    if (strspn(text, "0123456789abcdef") < (size_t)digits) blame(c, what);
    if (!c->reads) return;
    const bool none = may_be_none && strspn(text, "0") == (size_t)digits;
    memcpy(hex, text, (size_t)digits);
    hex[none || c->wrong ? 0 : digits] = 0;
}

static void pass_pose(coder *c, td_pose *pose)
{
    double length = 0;
    pass_reals(c, pose->q, 4, "its pose is no number");
    pass_reals(c, pose->t, 3, "its pose is no number");
    for (int i = 0; i < 4; i++) length += pose->q[i] * pose->q[i];
    if (!(fabs(length - 1) < 1e-6)) blame(c, "its pose's quaternion has not length 1");
}

static int pass_joints(coder *c, int joints)
{
    return pass_int(c, joints, 1, TD_ROBOT_MAX_JOINTS, "it has too many joints");
}

/* Bytes at the end, lent. */
static void pass_rest(coder *c, const void **bytes, size_t *size, size_t most, const char *what)
{
    if (!c->reads && *size > most) blame(c, what);
    const size_t got = (size_t)pass_number(c, *size, 4);
    if (c->wrong) return;
    if (c->reads && (got > most || got != c->size - c->used)) {
        blame(c, what);
        return;
    }
    if (c->reads)
        *bytes = c->from + c->used;
    else if (c->to)
        memcpy(c->to + c->used, *bytes, got);
    *size = got;
    c->used += got;
}

/* ---- messages ---- */

static void pass_welcome(coder *c, td_machine_welcome *m)
{
    m->version = (uint16_t)pass_number(c, m->version, 2);
    if (m->version != TD_MACHINE_VERSION) blame(c, "it is of another version: use the same release");
    pass_bytes(c, m->session, sizeof m->session);
    m->is_operator = pass_bool(c, m->is_operator, "it does not say who commands");
    pass_text(c, m->robot, sizeof m->robot, "its robot has no proper name");
    pass_hex(c, m->model, 64, false, "its model is no hash");
    pass_real(c, &m->period_s, "its period is no number");
    m->joints = pass_joints(c, m->joints);
    for (int k = 0; k < m->joints; k++)
        pass_text(c, m->joint[k], sizeof m->joint[k], "a joint has no proper name");
}

static void pass_task(coder *c, td_machine_task *m)
{
    td_machine_validation *v = &m->validation;
    const void *text = m->text;
    pass_hex(c, v->task, 64, false, "its hash is none");
    pass_hex(c, v->model, 64, false, "its model is no hash");
    v->joints = pass_joints(c, v->joints);
    pass_reals(c, v->start, v->joints, "its start is no number");
    pass_real(c, &v->duration_s, "its duration is no number");
    pass_reals(c, v->end, v->joints, "its end is no number");
    pass_reals(c, v->force, v->joints, "its forces are no numbers");
    pass_rest(c, &text, &m->size, TD_MACHINE_MAX_TASK, "its text is not as long as it says, or too long");
    m->text = text;
}

static void pass_joint_command(coder *c, int *joints, td_plant_command *m)
{
    m->kind = (td_command_kind)pass_int(c, (int)m->kind, 1, TD_COMMAND_RATE,
                                        "it commands neither flows, "
                                        "forces nor rates");
    *joints = pass_joints(c, *joints);
    pass_reals(c, m->value, *joints, "a value is no number");
}

static void pass_answer(coder *c, td_machine_answer *m)
{
    m->kind = (td_machine_kind)pass_int(c, (int)m->kind, 1, TD_MACHINE_ORDER, "it answers nothing known");
    if (m->kind != TD_MACHINE_TASK && m->kind != TD_MACHINE_ORDER) blame(c, "it answers nothing known");
    m->order = (td_machine_order)pass_int(c, (int)m->order, 1, TD_ORDER_COUNT - 1, "it answers no order");
    m->accepted = pass_bool(c, m->accepted, "it says neither yes nor no");
    pass_text(c, m->text, sizeof m->text, "its text is none");
}

static void pass_state(coder *c, td_machine_state_message *m)
{
    td_plant_state *p = &m->plant;
    double *const of_joints[] = {p->q, p->dq, p->force, p->pressure, p->flow};
    pass_real(c, &p->time_s, "its time is no number");
    m->mode = (td_machine_mode)pass_int(c, (int)m->mode, 1, TD_MODE_COUNT - 1, "its mode is none");
    pass_text(c, m->phase, sizeof m->phase, "its phase is no text");
    pass_text(c, m->fault, sizeof m->fault, "its fault is no text");
    pass_hex(c, m->task, 8, true, "its task is no hash");
    m->step = pass_int(c, m->step, 2, UINT16_MAX, "its step is none");
    m->steps = pass_int(c, m->steps, 2, UINT16_MAX, "its steps are none");
    pass_pose(c, &p->site_from_vehicle);
    pass_reals(c, p->twist, 6, "its twist is no number");
    m->joints = pass_joints(c, m->joints);
    for (int i = 0; i < 5; i++) pass_reals(c, of_joints[i], m->joints, "a joint's state is no number");
    for (int k = 0; k < m->joints; k++)
        p->at_stop[k] = pass_bool(c, p->at_stop[k], "a joint is neither at a stop nor free");
    m->motion = pass_int(c, m->motion + 1, 2, UINT16_MAX, "its motion is none") - 1;
    pass_real(c, &m->share, "its share is no number");
    m->dig_phase = pass_int(c, m->dig_phase + 1, 1, UINT8_MAX, "its phase of a trench is none") - 1;
    m->loose = pass_bool(c, m->loose, "its tool is neither held nor loose");
}

static void pass_stopped(coder *c, td_machine_stopped *m)
{
    double *const real[] = {&m->time_s, &m->silent_s, &m->took_s};
    for (int i = 0; i < 3; i++) pass_real(c, real[i], "a time is no number");
    m->joint = pass_int(c, m->joint, 1, TD_ROBOT_MAX_JOINTS - 1, "its joint is none");
    pass_real(c, &m->angle, "its angle is no number");
    pass_text(c, m->why, sizeof m->why, "its reason is no text");
}

static void pass_image(coder *c, td_machine_image *m)
{
    const void *jpeg = m->jpeg;
    pass_real(c, &m->time_s, "its time is no number");
    m->side = pass_int(c, m->side, 1, 1, "it is neither left nor right");
    m->width = pass_int(c, m->width, 2, UINT16_MAX, "its width is none");
    m->height = pass_int(c, m->height, 2, UINT16_MAX, "its height is none");
    pass_pose(c, &m->site_from_vehicle);
    m->joints = pass_joints(c, m->joints);
    pass_reals(c, m->q, m->joints, "a joint is no number");
    pass_rest(c, &jpeg, &m->size, TD_MACHINE_MAX_IMAGE, "its image is not as long as it says, or too long");
    m->jpeg = jpeg;
}

static const char *const kind_names[] = {"",      "welcome", "task",  "order", "joint command", "answer",
                                         "state", "stopped", "image", "look",  "plan"};

static void pass(coder *c, td_machine_message *m)
{
    switch (m->kind) {
    case TD_MACHINE_WELCOME:
        pass_welcome(c, &m->as.welcome);
        break;
    case TD_MACHINE_TASK:
        pass_task(c, &m->as.task);
        break;
    case TD_MACHINE_ORDER:
        m->as.order =
            (td_machine_order)pass_int(c, (int)m->as.order, 1, TD_ORDER_COUNT - 1, "there is no such order");
        break;
    case TD_MACHINE_JOINTS:
        pass_joint_command(c, &m->as.joints.joints, &m->as.joints.command);
        break;
    case TD_MACHINE_ANSWER:
        pass_answer(c, &m->as.answer);
        break;
    case TD_MACHINE_STATE:
        pass_state(c, &m->as.state);
        break;
    case TD_MACHINE_STOPPED:
        pass_stopped(c, &m->as.stopped);
        break;
    case TD_MACHINE_IMAGE:
        pass_image(c, &m->as.image);
        break;
    case TD_MACHINE_LOOK:
        m->as.look = pass_int(c, m->as.look, 2, UINT16_MAX, "its frame is none");
        break;
    case TD_MACHINE_PLAN: {
        const void *text = m->as.plan.text;
        pass_rest(c, &text, &m->as.plan.size, TD_MACHINE_MAX_TASK, "its text is not as long as it says");
        m->as.plan.text = text;
        break;
    }
    }
}

static bool is_kind(unsigned kind)
{
    return kind >= TD_MACHINE_WELCOME && kind <= TD_MACHINE_PLAN;
}

td_status td_machine_encode(uint8_t **payload, size_t *size, const td_machine_message *message,
                            td_error *error)
{
    td_machine_message copy = *message;
    coder counts = {0};
    *payload = NULL;
    *size = 0;
    if (!is_kind((unsigned)message->kind))
        return td_fail(error, TD_ERROR_ARGUMENT, "there is no message of kind %d", (int)message->kind);
    pass(&counts, &copy);
    if (counts.wrong)
        return td_fail(error, TD_ERROR_ARGUMENT, "a %s cannot be sent: %s", kind_names[message->kind],
                       counts.wrong);
    coder writes = {.to = malloc(counts.used + 1)};
    if (!writes.to) return td_fail(error, TD_ERROR_MEMORY, "no memory for a message");
    pass(&writes, &copy);
    *payload = writes.to;
    *size = writes.used;
    return TD_OK;
}

td_status td_machine_decode(td_machine_message *message, uint8_t kind, const void *payload, size_t size,
                            td_error *error)
{
    coder c = {.reads = true, .from = payload, .size = size};
    memset(message, 0, sizeof *message);
    if (!is_kind(kind)) return td_fail(error, TD_ERROR_FORMAT, "there is no message of kind %u", kind);
    message->kind = (td_machine_kind)kind;
    pass(&c, message);
    if (!c.wrong && c.used != size) c.wrong = "it is longer than it should be";
    if (!c.wrong) return TD_OK;
    memset(message, 0, sizeof *message);
    return td_fail(error, TD_ERROR_FORMAT, "a %s is refused: %s", kind_names[kind], c.wrong);
}

td_status td_machine_send(td_link *link, const td_machine_message *message, bool may_drop, td_error *error)
{
    uint8_t *payload = NULL;
    size_t size = 0;
    TD_TRY(td_machine_encode(&payload, &size, message, error));
    const td_status status = td_link_send(link, (uint8_t)message->kind, payload, size, may_drop, error);
    free(payload);
    return status;
}

double td_machine_now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

td_status td_machine_wait(td_machine_message *message, bool *came, td_link *link, double seconds,
                          td_error *error)
{
    static const double LOOK_S = 0.01; /* pings are due, too */
    const double until = td_machine_now_s() + seconds;
    td_link_frame frame;
    *came = false;
    for (;;) {
        td_link_poll(link, td_machine_now_s());
        if (td_link_next(&frame, link)) {
            *came = true;
            return td_machine_decode(message, frame.kind, frame.payload, frame.size, error);
        }
        if (td_link_state_of(link) == TD_LINK_CLOSED)
            return td_fail(error, TD_ERROR_IO, "the link to %s is closed: %s", td_link_peer(link),
                           td_link_why(link, NULL));
        const double left = until - td_machine_now_s();
        if (left <= 0) return TD_OK;
        struct pollfd p = {0};
        p.fd = td_link_fd(link, &p.events);
        (void)poll(&p, 1, (int)ceil(1e3 * fmin(left, LOOK_S)));
    }
}

const char *td_machine_order_name(td_machine_order order)
{
    static const char *const names[] = {"execute", "stop",   "pause",    "resume",
                                        "reinit",  "manual", "automatic"};
    return order >= 0 && order < TD_ORDER_COUNT ? names[order] : "unknown";
}

const char *td_machine_mode_name(td_machine_mode mode)
{
    static const char *const names[] = {"rest",   "checking", "holding", "working",
                                        "paused", "manual",   "failed"};
    return mode >= 0 && mode < TD_MODE_COUNT ? names[mode] : "unknown";
}
