/* Tasks: what is read, that it is written as the same bytes, and that bad ones are refused by name.
 *
 * The task of every kind of step (the seed that is fuzzed as well) against its values typed here; written,
 * read and written again to the same text; its hash against another order of the same. Each refusal is one
 * change to a good task, and must name file, line and field. Against the excavator of datasets/zx200: names,
 * ranges, reach (the stretched arm by hand: 0.868 + 5.648 + 2.889 + 1.562 m from the swing's axis), speed,
 * weight.
 *
 * Blind to: whether a task can be done; planning tells. */
#include "tests/check.h"

#include <unistd.h>

#include "core/document.h"
#include "core/file.h"
#include "core/task.h"

#define ALL TD_SOURCE_DIR "/tests/fuzz/seeds/task/all.yaml"
#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

static td_task *parse(const char *text)
{
    td_task *task = NULL;
    td_error error = {0};
    check_ok(td_task_parse(&task, text, strlen(text), "t.yaml", &error), error);
    return task;
}

static void check_steps(const td_task *t)
{
    const td_task_position *p = &t->step[0].as.position, *j = &t->step[1].as.position;
    assert_int_equal(t->step_count, 9);
    assert_true(t->step[0].kind == TD_TASK_POSITION && p->joint_count == 0 && p->via_count == 1);
    check_near(p->to.at_m[0], 7, 0);
    check_near(p->to.pitch_deg, 60, 0);
    check_near(p->via[0].at_m[2], 2, 0);
    check_near(p->duration_s, 6, 0);
    assert_true(p->to.attitude == TD_TASK_PITCH && p->via[0].attitude == TD_TASK_FREE);
    assert_true(p->law == TD_TASK_QUINTIC && j->law == TD_TASK_CONSTANT_VELOCITY);
    assert_int_equal(j->joint_count, 2);
    assert_string_equal(j->joint[1].name, "arm");
    check_near(j->joint[1].value, 90, 0);
    assert_true(!j->joint[1].slides && t->step[2].as.position.to.attitude == TD_TASK_WHOLE);
    check_near(t->step[2].as.position.to.q[0], 1, 0);
    assert_true(t->step[3].as.drive.has_to && !t->step[4].as.drive.has_to);
    check_near(t->step[3].as.drive.yaw_deg, 10, 0);
    check_near(t->step[4].as.drive.turn_deg, 20, 0);
    check_near(t->step[5].as.dig.depth_m, 0.4, 0);
    check_near(t->step[5].as.dig.force_n, 4e4, 0);
    check_near(t->step[6].as.dump.at_m[1], 5, 0);
    check_near(t->step[7].as.press.axis[2], -1, 0);
    check_near(t->step[7].as.press.most_travel_m, 0.3, 0);
    check_near(t->step[8].as.wait_s, 1, 0);
}

static void test_read(void **unused)
{
    td_task *t = NULL;
    td_error error = {0};
    (void)unused;
    check_ok(td_task_read(&t, ALL, &error), error);
    assert_string_equal(t->name, "trench-1");
    assert_string_equal(t->tool.link, "bucket_tip");
    assert_true(t->frame == TD_TASK_VEHICLE);
    check_near(t->tool.point_m[0], 0.1, 0);
    check_near(t->limits.pump_share, 0.9, 0);
    check_near(t->tolerance.force_n, 900, 0);
    check_steps(t);
    td_task_free(&t);
    assert_null(t);

    t = parse("teledimos: task 1\nname: a\nframe: site\nsteps: [{press: {axis: [0, 3, 4], force_n: 2e3, "
              "for_s: 0}}]\n");
    assert_true(isinf(t->limits.speed_m_s) && isinf(t->step[0].as.press.most_travel_m));
    assert_true(t->frame == TD_TASK_SITE && !t->tool.link[0] && t->tool.axis[0] == 1);
    check_near(t->step[0].as.press.axis[1], 0.6, 1e-15);
    check_near(t->tolerance.position_m, 0.05, 0);
    check_near(t->limits.joint_speed_share, 1, 0);
    td_task_free(&t);
}

static void test_same_bytes(void **unused)
{
    td_task *t = NULL;
    td_error error = {0};
    char *text = NULL, *again = NULL, hash[2][TD_HASH_HEX_SIZE];
    (void)unused;
    check_ok(td_task_read(&t, ALL, &error), error);
    check_ok(td_task_text(&text, t, &error), error);
    check_ok(td_task_hash(hash[0], t, &error), error);
    td_task_free(&t);
    t = parse(text);
    check_steps(t);
    check_ok(td_task_text(&again, t, &error), error);
    assert_string_equal(text, again);
    check_ok(td_task_hash(hash[1], t, &error), error);
    assert_string_equal(hash[0], hash[1]);
    t->step[8].as.wait_s = nextafter(1, 2);
    check_ok(td_task_hash(hash[1], t, &error), error);
    assert_string_not_equal(hash[0], hash[1]);
    check_ok(td_task_write(t, TD_BINARY_DIR "/task.yaml", &error), error);
    td_task_free(&t);
    check_ok(td_task_read(&t, TD_BINARY_DIR "/task.yaml", &error), error);
    check_near(t->step[8].as.wait_s, nextafter(1, 2), 0);
    td_task_free(&t);
    unlink(TD_BINARY_DIR "/task.yaml");
    free(text);
    free(again);
}

/* What a program made wrong is not written. */
static void test_unwritable(void **unused)
{
    td_error error = {0};
    char *text = NULL;
    (void)unused;
    td_task *t = parse("teledimos: task 1\nname: a\nsteps: [{wait: {for_s: 1}}]\n");
    t->step[0].as.wait_s = NAN;
    check_fails(td_task_text(&text, t, &error), TD_ERROR_FORMAT, error, "steps[0].wait.for_s");
    assert_null(text);
    t->step[0].as.wait_s = 1;
    strcpy(t->about, "\xff");
    check_fails(td_task_write(t, TD_BINARY_DIR "/no.yaml", &error), TD_ERROR_DATA, error, "UTF-8");
    strcpy(t->about, "");
    t->step[0].kind = (td_task_kind)77;
    check_fails(td_task_text(&text, t, &error), TD_ERROR_FORMAT, error, "unknown key 'unknown'");
    td_task_free(&t);
}

/* ---- refusals ---- */

#define HEAD "teledimos: task 1\nname: a\n"

static void test_refusals(void **unused)
{
    static const struct {
        const char *text, *words;
    } bad[] = {
        {"name: a\nsteps: []\n", "is no task: 'teledimos: task 1' is missing"},
        {"teledimos: task 2\n", "t.yaml:1: teledimos: is 'task 2'"},
        {"teledimos: task 1\nsteps: []\n", "name: is missing"},
        {HEAD, "steps: is missing"},
        {HEAD "steps: []\n", "t.yaml:3: steps: must have 1 to 1000 elements, but has 0"},
        {HEAD "steps:\n  - wait: {for_s: 1}\n  - wait:\n      for_sec: 2\n",
         "t.yaml:6: steps[1].wait: unknown key 'for_sec'; did you mean 'for_s'?"},
        {HEAD "stpes: []\n", "t.yaml:3: unknown key 'stpes'; did you mean 'steps'?"},
        {HEAD "steps:\n  - wait: {for_s: .nan}\n", "t.yaml:4: steps[0].wait.for_s: must be a finite number"},
        {HEAD "steps:\n  - wait: {for_s: -1}\n", "t.yaml:4: steps[0].wait.for_s: is -1"},
        {HEAD "steps:\n  - wait: {for_s: 1}\n    drive: {distance_m: 1}\n",
         "t.yaml:4: steps[0]: must be one of"},
        {HEAD "steps:\n  - {}\n", "t.yaml:4: steps[0]: must be one of"},
        {HEAD "steps:\n  - hop: {}\n", "t.yaml:4: steps[0]: unknown key 'hop'"},
        {HEAD "steps:\n  - position: {}\n", "steps[0].position: needs either to"},
        {HEAD "steps:\n  - position: {joints: {boom_deg: 1}, via: []}\n", "position.via: goes with to"},
        {HEAD "steps:\n  - position: {joints: {boom: 1}}\n", "joints.boom: must end in its unit: boom_deg"},
        {HEAD "steps:\n  - position: {joints: {boom_m: 1, boom_deg: 1}}\n",
         "boom_deg: the joint is given twice"},
        {HEAD "steps:\n  - position: {joints: {}}\n", "joints: must name 1 to 64"},
        {HEAD "steps:\n  - position: {to: {x_m: 1, y_m: 1}}\n", "steps[0].position.to.z_m: is missing"},
        {HEAD "steps:\n  - position: {to: {x_m: 1, y_m: 1, z_m: 1e9}}\n", "to.z_m: is 1"},
        {HEAD "steps:\n  - position: {to: {x_m: 1, y_m: 1, z_m: 1, pitch_deg: 1, q: [1, 0, 0, 0]}}\n",
         "has both pitch"},
        {HEAD "steps:\n  - position: {to: {x_m: 1, y_m: 1, z_m: 1, q: [1, 1, 0, 0]}}\n", "unit quaternion"},
        {HEAD "steps:\n  - position: {joints: {boom_deg: 1}, law: linear}\n", "law: is 'linear'"},
        {HEAD "limits: {speed_m_s: 0.5}\nsteps:\n  - position: {to: {x_m: 3, y_m: 0, z_m: 0}, via: [{x_m: 0, "
              "y_m: 0, z_m: 0}], duration_s: 5}\n",
         "t.yaml:5: steps[0].position: duration_s 5 is too short"},
        {HEAD "limits: {speed_m_s: 0}\nsteps: []\n", "limits.speed_m_s: is 0"},
        {HEAD "limits: {pump_share: 1.5}\nsteps: []\n", "limits.pump_share: is 1.5"},
        {HEAD "tolerance: {angle_deg: x}\nsteps: []\n",
         "t.yaml:3: tolerance.angle_deg: must be a finite number"},
        {HEAD "tool: {axis: [0, 0, 0]}\nsteps: []\n", "tool.axis: has no length"},
        {HEAD "tool: {link: ''}\nsteps: []\n", "tool.link: must be a name"},
        {HEAD "frame: world\nsteps: []\n", "frame: is 'world', but must be vehicle or site"},
        {HEAD "steps:\n  - drive: {}\n", "needs either to (a place)"},
        {HEAD "steps:\n  - drive: {distance_m: 0}\n", "drives nowhere"},
        {HEAD "steps:\n  - drive: {to: {x_m: 1, y_m: 1, yaw_deg: 0}, turn_deg: 3}\n",
         "needs either to (a place)"},
        {HEAD "steps:\n  - dig: {from: {x_m: 1, y_m: 1, z_m: 0}, length_m: 1}\n", "dig.depth_m: is missing"},
        {HEAD "steps:\n  - dump: {}\n", "dump.at: is missing"},
        {HEAD "steps:\n  - press: {force_n: 5000, for_s: 1}\n", "press.axis: is missing"},
        {HEAD "steps:\n  - press: {axis: [0, 0, -1], force_n: 500, for_s: 1}\n",
         "force_n 500 is within its own tolerance, tolerance.force_n 1000"},
        {HEAD "limits: {speed_m_s: 0.1}\nsteps:\n  - press: {axis: [0, 0, -1], force_n: 5000, for_s: 1, "
              "approach_speed_m_s: 0.2}\n",
         "t.yaml:5: steps[0].press: approach_speed_m_s 0.2 is beyond limits.speed_m_s 0.1"},
        {"teledimos: task 1\nname: 'a b'\nsteps: []\n", "name: must be"},
    };
    (void)unused;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        td_error error = {0};
        td_task *t = NULL;
        check_fails(td_task_parse(&t, bad[i].text, strlen(bad[i].text), "t.yaml", &error), TD_ERROR_FORMAT,
                    error, bad[i].words);
        assert_null(t);
    }
}

static void test_line(void **unused)
{
    static const char text[] =
        "a: 1\nb:\n  - x: {c: 1}\n    y:\n\n      - 1\n      - z.z: [1,\n          2]\n  - 5\nc: {}\n";
    static const struct {
        const char *path;
        size_t line;
    } at[] = {{"a", 1},
              {"b", 2},
              {"b[0]", 3},
              {"b[0].x.c", 3},
              {"b[0].y[0]", 6},
              {"b[0].y[1]", 7},
              {"b[1]", 9},
              {"b[0].y[1].z.z", 7},
              {"b[0].y[1].z.z[1]", 8},
              {"c", 10},
              {"c.none", 10},
              {"b[7].x", 2},
              {"none", 0},
              {"", 0},
              {"b[x]", 2}};
    (void)unused;
    for (size_t i = 0; i < sizeof at / sizeof *at; i++)
        if (td_document_line(text, sizeof text - 1, at[i].path) != at[i].line)
            fail_msg("'%s' is on line %zu, not %zu", at[i].path, at[i].line,
                     td_document_line(text, sizeof text - 1, at[i].path));
    td_error error = {.message = "other.yaml: a: is 1"};
    td_document_locate(&error, TD_ERROR_FORMAT, text, sizeof text - 1, "t.yaml");
    assert_string_equal(error.message, "other.yaml: a: is 1");
}

/* ---- against a robot ---- */

static void check_task(const char *text, const td_robot *robot, const td_pose *site_from_vehicle,
                       const char *words)
{
    td_error error = {0};
    td_task *t = parse(text);
    if (words)
        check_fails(td_task_check(t, robot, site_from_vehicle, &error), TD_ERROR_DATA, error, words);
    else
        check_ok(td_task_check(t, robot, site_from_vehicle, &error), error);
    td_task_free(&t);
}

static void test_robot(void **unused)
{
    td_robot *robot = NULL;
    td_error error = {0};
    td_pose far = td_pose_identity();
    char *text = NULL;
    size_t size = 0;
    (void)unused;
    far.t[0] = 100;
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    check_ok(td_file_read(&text, &size, ALL, 1 << 16, &error), error);
    check_task(text, robot, NULL, NULL);
    free(text);
    check_task(HEAD "tool: {link: shovel}\nsteps: [{wait: {for_s: 1}}]\n", robot, NULL, "no link 'shovel'");
    check_task(HEAD "tool: {link: undercarriage}\nsteps: [{wait: {for_s: 1}}]\n", robot, NULL,
               "no joint of robot");
    check_task(HEAD "limits: {speed_m_s: 50}\nsteps: [{wait: {for_s: 1}}]\n", robot, NULL,
               "speed_m_s 50 is beyond");
    check_task(HEAD "steps: [{position: {joints: {bom_deg: 1}}}]\n", robot, NULL,
               "steps[0].position: joints: robot 'zx200' has no moving joint 'bom'");
    check_task(HEAD "steps: [{position: {joints: {boom_m: 1}}}]\n", robot, NULL,
               "'boom' turns; write boom_deg");
    check_task(HEAD "steps: [{position: {joints: {boom_deg: 60}}}]\n", robot, NULL,
               "'boom' at 60 deg is outside");
    check_task(HEAD "steps: [{position: {joints: {boom_deg: 44, swing_deg: 720}}}]\n", robot, NULL, NULL);
    /* 10.967 m from the swing's axis at (0.108, -0.034, 1.121). */
    check_task(HEAD "steps: [{position: {to: {x_m: 11.07, y_m: -0.034, z_m: 1.121}}}]\n", robot, NULL, NULL);
    check_task(HEAD "steps: [{position: {to: {x_m: 11.08, y_m: -0.034, z_m: 1.121}}}]\n", robot, NULL,
               "10.97 m long when stretched out");
    check_task(HEAD "steps: [{dump: {at: {x_m: 0, y_m: 20, z_m: 2}}}]\n", robot, NULL,
               "steps[0].dump: at (0.000, 20");
    check_task(
        HEAD
        "steps: [{wait: {for_s: 1}}, {dig: {from: {x_m: 7, y_m: 0, z_m: 0}, heading_deg: 0, length_m: 9, "
        "depth_m: 1}}]\n",
        robot, NULL, "steps[1].dig: its end");
    check_task(HEAD "steps: [{press: {axis: [0, 0, -1], force_n: 3e5, for_s: 1}}]\n", robot, NULL,
               "lifts the robot");
    check_task(HEAD "steps: [{press: {axis: [1, 0, 0], force_n: 3e5, for_s: 1}}]\n", robot, NULL, NULL);
    check_task(HEAD "frame: site\nsteps: [{dump: {at: {x_m: 107, y_m: 0, z_m: 2}}}]\n", robot, &far, NULL);
    check_task(HEAD "frame: site\nsteps: [{dump: {at: {x_m: 7, y_m: 0, z_m: 2}}}]\n", robot, &far,
               "drive nearer");
    check_task(HEAD "frame: site\nsteps: [{dump: {at: {x_m: 7, y_m: 0, z_m: 2}}}]\n", robot, NULL, NULL);
    check_task(HEAD
               "frame: site\nsteps: [{drive: {distance_m: 90}}, {dump: {at: {x_m: 7, y_m: 0, z_m: 2}}}]\n",
               robot, &far, NULL);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_read),     cmocka_unit_test(test_same_bytes), cmocka_unit_test(test_unwritable),
        cmocka_unit_test(test_refusals), cmocka_unit_test(test_line),       cmocka_unit_test(test_robot),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
