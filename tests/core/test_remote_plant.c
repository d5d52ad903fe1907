/* Proves of core/remote_plant: whatever drives a plant drives a machine at the other end of a link: rates
 * that are commanded turn the joints there, for as long as the plant is stepped, and its state is the
 * machine's; the joints are asked for first and given back in the end; a machine that another one commands,
 * that refuses, that has other joints, is silent, fails on the way or is gone is told in a sentence.
 *
 * Reference: a machine made here of a few lines, in a process of its own, which integrates the rates that it
 * hears exactly (its positions are then known), and stands still when it hears none for three periods.
 * Tolerance: 1e-12 where nothing is in doubt; one period where the first command may come a period earlier or
 * later. Blind to: a machine with oil in it (tests/apps/test_machine.py: jog). */
#include "core/remote_plant.h"

#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/machine_messages.h"
#include "tests/check.h"

static const char TOKEN[] = "0123456789abcdef";
static const double PERIOD = 0.02;

typedef enum fault { FINE, COMMANDED, REFUSES, OTHER_JOINTS, SILENT, FAILS, DIES } fault;

typedef struct fake {
    fault kind;
    const td_robot *robot;
    td_link_listener *listener;
    td_link *link;
    td_machine_state_message state;
    td_plant_command command;
    int fresh, periods;
} fake;

static td_link_options options_of(void)
{
    td_link_options o = td_link_options_default();
    o.token = TOKEN;
    o.token_size = sizeof TOKEN - 1;
    o.timeout_s = 2; /* the test's machine may be busy */
    return o;
}

/* ---- a machine ---- */

static void tell(fake *f, const td_machine_message *m)
{
    td_error error;
    (void)td_machine_send(f->link, m, false, &error);
}

static void welcome(fake *f)
{
    td_machine_message m = {.kind = TD_MACHINE_WELCOME};
    td_machine_welcome *w = &m.as.welcome;
    w->version = TD_MACHINE_VERSION;
    w->is_operator = f->kind != COMMANDED;
    strcpy(w->robot, "fake");
    memset(w->model, 'a', 64);
    w->period_s = PERIOD;
    w->joints = f->robot->joint_count;
    for (int k = 0; k < w->joints; k++) strcpy(w->joint[k], f->robot->joint[k].name);
    if (f->kind == OTHER_JOINTS) strcpy(w->joint[1], "elbow");
    if (f->kind != SILENT) tell(f, &m);
}

static void obey(fake *f, const td_machine_message *m)
{
    td_machine_message answer = {.kind = TD_MACHINE_ANSWER};
    if (m->kind == TD_MACHINE_JOINTS) {
        f->command = m->as.joints.command;
        f->fresh = 3;
    }
    if (m->kind != TD_MACHINE_ORDER) return;
    answer.as.answer = (td_machine_answer){.kind = TD_MACHINE_ORDER, .order = m->as.order, .accepted = true};
    if (f->kind == REFUSES) {
        answer.as.answer.accepted = false;
        strcpy(answer.as.answer.text, "Reinit first");
    } else {
        f->state.mode = m->as.order == TD_ORDER_MANUAL ? TD_MODE_MANUAL : TD_MODE_REST;
    }
    tell(f, &answer);
}

static void go_on(fake *f)
{
    td_machine_message m = {.kind = TD_MACHINE_STATE};
    for (int k = 0; k < f->state.joints; k++) {
        f->state.plant.dq[k] = f->fresh && f->state.mode == TD_MODE_MANUAL ? f->command.value[k] : 0;
        f->state.plant.q[k] += PERIOD * f->state.plant.dq[k];
    }
    if (f->fresh) f->fresh--;
    f->periods++;
    f->state.plant.time_s = f->periods * PERIOD;
    if (f->kind == FAILS && f->periods == 15) {
        f->state.mode = TD_MODE_FAILED;
        strcpy(f->state.fault, "a limit was reached");
    }
    m.as.state = f->state;
    tell(f, &m);
}

/* Until the master has gone. Status 3: it gave the joints back, and said farewell. */
static void be_machine(fake *f)
{
    td_error error;
    bool left = false;
    f->state.joints = f->robot->joint_count;
    f->state.plant.site_from_vehicle = td_pose_identity();
    while (!f->link) {
        (void)td_link_accept(&f->link, f->listener, td_machine_now_s(), &error);
        (void)poll(NULL, 0, 1);
    }
    while (td_link_state_of(f->link) < TD_LINK_OPEN) {
        td_link_poll(f->link, td_machine_now_s());
        (void)poll(NULL, 0, 1);
    }
    welcome(f);
    for (;;) {
        static td_machine_message m;
        bool came = true;
        const double until = td_machine_now_s() + PERIOD;
        while (came) {
            const double seconds = until - td_machine_now_s();
            if (td_machine_wait(&m, &came, f->link, seconds > 0 ? seconds : 0, &error) != TD_OK) {
                (void)td_link_why(f->link, &left);
                _exit(left && f->state.mode == TD_MODE_REST ? 3 : 4);
            }
            if (came) obey(f, &m);
        }
        go_on(f);
        if (f->kind == DIES && f->periods == 15) _exit(5);
    }
}

/* ---- its master ---- */

typedef struct test {
    td_robot *robot;
    pid_t child;
    char address[40];
} test;

static void begin(test *t, fault kind)
{
    td_error error = {0};
    const td_link_options o = options_of();
    fake f = {.kind = kind};
    check_ok(td_robot_read(&t->robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    check_ok(td_link_listen(&f.listener, "127.0.0.1:0", &o, &error), error);
    snprintf(t->address, sizeof t->address, "127.0.0.1:%d", td_link_listener_port(f.listener));
    f.robot = t->robot;
    t->child = fork();
    if (t->child == 0) be_machine(&f);
    td_link_listener_free(&f.listener);
}

static int end(test *t)
{
    int status = 0;
    waitpid(t->child, &status, 0);
    td_robot_free(&t->robot);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

static void drives(void **state)
{
    (void)state;
    test t;
    td_plant plant;
    td_plant_state s, later;
    td_error error = {0};
    const td_link_options o = options_of();
    td_plant_command c = {.kind = TD_COMMAND_RATE, .value = {0.5, -0.25, 0, 0}};
    begin(&t, FINE);
    check_ok(td_remote_plant_new(&plant, t.robot, t.address, &o, &error), error);
    assert_null(plant.reset);
    assert_ptr_equal(plant.robot, t.robot);
    check_ok(plant.state(plant.self, &s, &error), error);
    check_near(s.q[0], 0, 1e-12);
    for (int i = 0; i < 10; i++) {
        check_ok(plant.command(plant.self, &c, &error), error);
        check_ok(plant.step(plant.self, 2 * PERIOD, &error), error);
    }
    check_ok(plant.state(plant.self, &later, &error), error);
    const double passed = later.time_s - s.time_s;
    assert_true(passed >= 20 * PERIOD - 1e-9);
    assert_true(fabs(later.q[0] - 0.5 * passed) <= 0.5 * PERIOD + 1e-12);
    check_near(later.q[1], -0.5 * later.q[0], 1e-12);
    check_near(later.dq[0], 0.5, 0);
    assert_true(td_remote_plant_measure(&plant).answers > 0);
    /* Nothing new is commanded: the last holds, for step says it again. */
    check_ok(plant.step(plant.self, 10 * PERIOD, &error), error);
    check_ok(plant.state(plant.self, &s, &error), error);
    check_near(s.dq[0], 0.5, 0);
    check_near(s.q[0] - later.q[0], 0.5 * (s.time_s - later.time_s), 1e-12);
    c.value[2] = NAN;
    check_fails(plant.command(plant.self, &c, &error), TD_ERROR_ARGUMENT, error, "a value is no number");
    td_remote_plant_free(&plant);
    assert_null(plant.self);
    assert_int_equal(end(&t), 3);
}

static void tells_what_is_wrong(void **state)
{
    (void)state;
    static const struct {
        fault kind;
        td_status status;
        const char *words;
    } cases[] = {{COMMANDED, TD_ERROR_DATA, "another operator commands"},
                 {REFUSES, TD_ERROR_DATA, "does not take manual: Reinit first"},
                 {OTHER_JOINTS, TD_ERROR_DATA, "a fake, has other joints than robot 'zx200'"},
                 {SILENT, TD_ERROR_DEADLINE, "said nothing for"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        test t;
        td_plant plant;
        td_error error = {0};
        const td_link_options o = options_of();
        begin(&t, cases[i].kind);
        check_fails(td_remote_plant_new(&plant, t.robot, t.address, &o, &error), cases[i].status, error,
                    cases[i].words);
        assert_null(plant.self);
        (void)end(&t);
    }
}

static void tells_what_fails_on_the_way(void **state)
{
    (void)state;
    static const fault kinds[] = {FAILS, DIES};
    for (int i = 0; i < 2; i++) {
        test t;
        td_plant plant;
        td_error error = {0};
        const td_link_options o = options_of();
        begin(&t, kinds[i]);
        check_ok(td_remote_plant_new(&plant, t.robot, t.address, &o, &error), error);
        td_status status = TD_OK;
        for (int k = 0; k < 30 && status == TD_OK; k++) status = plant.step(plant.self, PERIOD, &error);
        check_fails(status, i ? TD_ERROR_IO : TD_ERROR_DATA, error,
                    i ? "closed the connection" : "a limit was reached");
        td_remote_plant_free(&plant);
        (void)end(&t);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(drives),
        cmocka_unit_test(tells_what_is_wrong),
        cmocka_unit_test(tells_what_fails_on_the_way),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
