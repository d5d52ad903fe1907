/* Proves of core/machine_messages: every message comes back as it was sent, in both directions of the link;
 * each is refused, with its name, when it is cut anywhere, when a byte follows it, when a number is none, a
 * count beyond its bound, a text no text; what does not fit is not sent.
 *
 * Reference: the struct itself, and, of one message, the bytes written by hand after the header's table.
 * Tolerances: none. Blind to: what the numbers mean to a machine (tests/apps/test_machine.py). */
#include "core/machine_messages.h"

#include "tests/check.h"

static td_machine_message message_of(td_machine_kind kind)
{
    static const char hash[] = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";
    td_machine_message m;
    memset(&m, 0, sizeof m);
    m.kind = kind;
    switch (kind) {
    case TD_MACHINE_WELCOME:
        m.as.welcome.version = TD_MACHINE_VERSION;
        memcpy(m.as.welcome.session, hash, sizeof m.as.welcome.session);
        m.as.welcome.is_operator = true;
        strcpy(m.as.welcome.robot, "zx200");
        strcpy(m.as.welcome.model, hash);
        m.as.welcome.period_s = 0.05;
        m.as.welcome.joints = 2;
        strcpy(m.as.welcome.joint[0], "swing");
        strcpy(m.as.welcome.joint[1], "bras \xc3\xa9tendu");
        break;
    case TD_MACHINE_TASK:
        strcpy(m.as.task.validation.task, hash);
        strcpy(m.as.task.validation.model, hash);
        m.as.task.validation.joints = 3;
        for (int k = 0; k < 3; k++) {
            m.as.task.validation.start[k] = 0.1 * k;
            m.as.task.validation.end[k] = -0.7 * k;
            m.as.task.validation.force[k] = 1e5 + k;
        }
        m.as.task.validation.duration_s = 12.5;
        m.as.task.text = "teledimos: task 1\n";
        m.as.task.size = 18;
        break;
    case TD_MACHINE_ORDER:
        m.as.order = TD_ORDER_REINIT;
        break;
    case TD_MACHINE_JOINTS:
        m.as.joints.joints = 4;
        m.as.joints.command.kind = TD_COMMAND_RATE;
        for (int k = 0; k < 4; k++) m.as.joints.command.value[k] = 0.25 * (k - 2);
        break;
    case TD_MACHINE_ANSWER:
        m.as.answer = (td_machine_answer){.kind = TD_MACHINE_ORDER, .order = TD_ORDER_STOP, .accepted = true};
        strcpy(m.as.answer.text, "stops");
        break;
    case TD_MACHINE_STATE:
        m.as.state.mode = TD_MODE_FAILED;
        strcpy(m.as.state.phase, "failed: waiting for Reinit");
        strcpy(m.as.state.fault, "a link is lost");
        strcpy(m.as.state.task, "01234567");
        m.as.state.step = 2;
        m.as.state.steps = 1000;
        m.as.state.joints = 4;
        m.as.state.plant.time_s = 3.75;
        m.as.state.plant.site_from_vehicle = td_pose_identity();
        for (int k = 0; k < 6; k++) m.as.state.plant.twist[k] = -1.5 * k;
        for (int k = 0; k < 4; k++) {
            m.as.state.plant.q[k] = k;
            m.as.state.plant.dq[k] = 10 + k;
            m.as.state.plant.force[k] = 20 + k;
            m.as.state.plant.pressure[k] = 30 + k;
            m.as.state.plant.flow[k] = 40 + k;
            m.as.state.plant.at_stop[k] = k % 2;
        }
        m.as.state.motion = 7;
        m.as.state.share = 0.25;
        m.as.state.dig_phase = 2;
        m.as.state.loose = true;
        break;
    case TD_MACHINE_STOPPED:
        m.as.stopped = (td_machine_stopped){.time_s = 5,
                                            .silent_s = 0.31,
                                            .took_s = 0.4,
                                            .angle = 0.02,
                                            .joint = 1,
                                            .why = "the link is lost"};
        break;
    case TD_MACHINE_IMAGE:
        m.as.image = (td_machine_image){.time_s = 7,
                                        .side = 1,
                                        .width = 640,
                                        .height = 480,
                                        .site_from_vehicle = td_pose_identity(),
                                        .joints = 2,
                                        .q = {0.5, -0.5},
                                        .jpeg = (const uint8_t *)"JFIF",
                                        .size = 4};
        break;
    case TD_MACHINE_LOOK:
        m.as.look = 4;
        break;
    case TD_MACHINE_PLAN:
        m.as.plan.text = "{}";
        m.as.plan.size = 2;
        break;
    }
    return m;
}

/* Lent pointers differ; what they point to must not. */
static void check_same(const td_machine_message *a, td_machine_message b)
{
    if (a->kind == TD_MACHINE_TASK) {
        assert_memory_equal(a->as.task.text, b.as.task.text, a->as.task.size);
        b.as.task.text = a->as.task.text;
    }
    if (a->kind == TD_MACHINE_PLAN) {
        assert_memory_equal(a->as.plan.text, b.as.plan.text, a->as.plan.size);
        b.as.plan.text = a->as.plan.text;
    }
    if (a->kind == TD_MACHINE_IMAGE) {
        assert_memory_equal(a->as.image.jpeg, b.as.image.jpeg, a->as.image.size);
        b.as.image.jpeg = a->as.image.jpeg;
    }
    assert_memory_equal(a, &b, sizeof b);
}

static void comes_back(void **state)
{
    (void)state;
    td_error error = {0};
    for (td_machine_kind kind = TD_MACHINE_WELCOME; kind <= TD_MACHINE_PLAN; kind++) {
        const td_machine_message m = message_of(kind);
        td_machine_message back;
        uint8_t *bytes = NULL;
        size_t size = 0;
        check_ok(td_machine_encode(&bytes, &size, &m, &error), error);
        check_ok(td_machine_decode(&back, (uint8_t)kind, bytes, size, &error), error);
        check_same(&m, back);
        for (size_t cut = 0; cut < size; cut++) { /* behind it nothing may be read: a copy of that size */
            uint8_t *less = malloc(cut + 1);
            assert_non_null(less);
            memcpy(less, bytes, cut);
            check_fails(td_machine_decode(&back, (uint8_t)kind, less, cut, &error), TD_ERROR_FORMAT, error,
                        "is refused: ");
            free(less);
        }
        uint8_t *more = calloc(1, size + 1);
        assert_non_null(more);
        memcpy(more, bytes, size);
        check_fails(td_machine_decode(&back, (uint8_t)kind, more, size + 1, &error), TD_ERROR_FORMAT, error,
                    "is refused: ");
        free(more);
        free(bytes);
    }
    td_machine_message back;
    check_fails(td_machine_decode(&back, 0, "", 0, &error), TD_ERROR_FORMAT, error, "kind 0");
    check_fails(td_machine_decode(&back, 11, "", 0, &error), TD_ERROR_FORMAT, error, "kind 11");
}

static void is_as_the_header_says(void **state)
{
    (void)state;
    static const uint8_t by_hand[] = {2,    2,                       /* rates of two joints */
                                      0x3F, 0xF0, 0, 0, 0, 0, 0, 0,  /* 1 */
                                      0xC0, 0x04, 0, 0, 0, 0, 0, 0}; /* -2.5 */
    td_error error = {0};
    td_machine_message m;
    uint8_t *bytes = NULL;
    size_t size = 0;
    check_ok(td_machine_decode(&m, TD_MACHINE_JOINTS, by_hand, sizeof by_hand, &error), error);
    assert_int_equal(m.as.joints.command.kind, TD_COMMAND_RATE);
    assert_int_equal(m.as.joints.joints, 2);
    check_near(m.as.joints.command.value[0], 1, 0);
    check_near(m.as.joints.command.value[1], -2.5, 0);
    check_ok(td_machine_encode(&bytes, &size, &m, &error), error);
    assert_int_equal(size, sizeof by_hand);
    assert_memory_equal(bytes, by_hand, size);
    free(bytes);
}

static void refuses_what_is_none(void **state)
{
    (void)state;
    static const struct {
        td_machine_kind kind;
        size_t at;
        uint8_t bytes[8];
        size_t size;
        const char *words;
    } cases[] = {
        {TD_MACHINE_WELCOME, 0, {0, 9}, 2, "a welcome is refused: it is of another version"},
        {TD_MACHINE_WELCOME, 21, {7}, 1, "no proper name"}, /* a bell in the robot's name */
        {TD_MACHINE_TASK, 3, {'G'}, 1, "its hash is none"},
        {TD_MACHINE_TASK, 128, {200}, 1, "too many joints"},
        {TD_MACHINE_TASK, 129, {0x7F, 0xF8, 0, 0, 0, 0, 0, 0}, 8, "its start is no number"},
        {TD_MACHINE_TASK, 209, {0xFF, 0xFF, 0xFF, 0xFF}, 4, "not as long as it says"},
        {TD_MACHINE_ORDER, 0, {TD_ORDER_COUNT}, 1, "no such order"},
        {TD_MACHINE_JOINTS, 0, {3}, 1, "neither flows"},
        {TD_MACHINE_JOINTS, 2, {0x7F, 0xF0, 0, 0, 0, 0, 0, 0}, 8, "a value is no number"},
        {TD_MACHINE_ANSWER, 0, {4}, 1, "answers nothing known"},
        {TD_MACHINE_ANSWER, 5, {0xFF}, 1, "its text is none"},
        {TD_MACHINE_STATE, 8, {TD_MODE_COUNT}, 1, "its mode is none"},
        {TD_MACHINE_STOPPED, 24, {64}, 1, "its joint is none"},
        {TD_MACHINE_IMAGE, 8, {2}, 1, "neither left nor right"},
        {TD_MACHINE_IMAGE, 13, {0, 0, 0, 0, 0, 0, 0, 0}, 8, "has not length 1"},
    };
    td_error error = {0};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const td_machine_message m = message_of(cases[i].kind);
        td_machine_message back;
        uint8_t *bytes = NULL;
        size_t size = 0;
        check_ok(td_machine_encode(&bytes, &size, &m, &error), error);
        assert_true(cases[i].at + cases[i].size <= size);
        memcpy(bytes + cases[i].at, cases[i].bytes, cases[i].size);
        check_fails(td_machine_decode(&back, (uint8_t)m.kind, bytes, size, &error), TD_ERROR_FORMAT, error,
                    cases[i].words);
        free(bytes);
    }
}

static void does_not_send_what_does_not_fit(void **state)
{
    (void)state;
    td_error error = {0};
    uint8_t *bytes = NULL;
    size_t size = 0;
    td_machine_message m = message_of(TD_MACHINE_JOINTS);
    m.as.joints.command.value[3] = NAN;
    check_fails(td_machine_encode(&bytes, &size, &m, &error), TD_ERROR_ARGUMENT, error,
                "a joint command cannot be sent: a value is no number");
    m = message_of(TD_MACHINE_TASK);
    m.as.task.size = TD_MACHINE_MAX_TASK + 1;
    check_fails(td_machine_encode(&bytes, &size, &m, &error), TD_ERROR_ARGUMENT, error, "too long");
    m = message_of(TD_MACHINE_TASK);
    m.as.task.validation.task[20] = 0;
    check_fails(td_machine_encode(&bytes, &size, &m, &error), TD_ERROR_ARGUMENT, error, "hash");
    m.kind = (td_machine_kind)77;
    check_fails(td_machine_encode(&bytes, &size, &m, &error), TD_ERROR_ARGUMENT, error, "kind 77");
    assert_null(bytes);
    /* A text whose end was cut, in the middle of a character. */
    m = message_of(TD_MACHINE_STOPPED);
    strcpy(m.as.stopped.why, "caf\xc3");
    check_ok(td_machine_encode(&bytes, &size, &m, &error), error);
    check_ok(td_machine_decode(&m, TD_MACHINE_STOPPED, bytes, size, &error), error);
    assert_string_equal(m.as.stopped.why, "caf");
    free(bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(comes_back),
        cmocka_unit_test(is_as_the_header_says),
        cmocka_unit_test(refuses_what_is_none),
        cmocka_unit_test(does_not_send_what_does_not_fit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
