/* Driving on tracks along a way, servo/track_drive, in a kinematic machine written here: belts follow with a
 * lag, each slips by its own share, and the pose is integrated.
 *
 * Where it must end is computed here from the task (arc in closed form, goal turned into the site). Without
 * slip it ends within its tolerances; with a tenth of slip on one track too, for it sees where it is. A
 * machine whose tracks turn but that does not move is told stuck. Its speed and acceleration stay within what
 * was asked. Blind to: ground that gives (tests/sim/test_world.c, tests/apps/test_dig.py). */
#include "tests/check.h"

#include "servo/track_drive.h"

static const double PI = 3.14159265358979323846, T = 0.05;

typedef struct machine {
    double x, y, yaw, belt[2], slip[2], half_gauge;
} machine;

static td_pose pose_of(const machine *m)
{
    return (td_pose){.q = {cos(m->yaw / 2), 0, 0, sin(m->yaw / 2)}, .t = {m->x, m->y, 0.3}};
}

static void move(machine *m, double left, double right)
{
    enum { PARTS = 10 };
    const double wanted[2] = {left, right};
    for (int i = 0; i < PARTS; i++) {
        for (int k = 0; k < 2; k++) m->belt[k] += (wanted[k] - m->belt[k]) * -expm1(-T / PARTS / 0.2);
        const double l = m->belt[0] * (1 - m->slip[0]), r = m->belt[1] * (1 - m->slip[1]);
        m->yaw += (r - l) / 2 / m->half_gauge * T / PARTS;
        m->x += (l + r) / 2 * cos(m->yaw) * T / PARTS;
        m->y += (l + r) / 2 * sin(m->yaw) * T / PARTS;
    }
}

/* Until done or stuck, 200 s at most; returns the fastest that a track was commanded. */
static double drive(machine *m, td_track_drive *d, double *seconds)
{
    double fastest = 0;
    for (*seconds = 0; *seconds < 200 && !d->done && !d->stuck; *seconds += T) {
        const td_pose now = pose_of(m);
        double left, right;
        td_track_drive_step(&left, &right, d, &now, T);
        fastest = fmax(fastest, fmax(fabs(left), fabs(right)));
        move(m, left, right);
    }
    for (int i = 0; i < 40; i++) move(m, 0, 0);
    return fastest;
}

static void start(td_track_drive *d, const machine *m, const td_task_drive *task, td_task_frame frame)
{
    const td_pose now = pose_of(m);
    td_error error = {0};
    check_ok(td_track_drive_start(d, task, frame, &now, NULL, &error), error);
}

/* Unequal slip of the tracks moves the middle while it turns in place, and a turn takes nothing of that back.
 */
static void check_end(const machine *m, double x, double y, double yaw)
{
    const double unequal = fabs(m->slip[1] - m->slip[0]), off = hypot(m->x - x, m->y - y);
    check_near(off, 0, 0.06 + 2.5 * unequal);
    assert_true(fabs(remainder(m->yaw - yaw, 2 * PI)) < 0.03);
}

static const double SLIPS[3][2] = {{0, 0}, {0.1, 0}, {0.05, 0.15}};

static void goes_along_an_arc(void **state)
{
    (void)state;
    for (int i = 0; i < 3; i++)
        for (int way = -1; way <= 1; way += 2) {
            machine m = {.x = 3, .y = -2, .yaw = 0.7, .half_gauge = 1.1};
            memcpy(m.slip, SLIPS[i], sizeof m.slip);
            td_track_drive d;
            const td_task_drive task = {.distance_m = way * 4.0, .turn_deg = 60};
            const double turn = PI / 3, radius = way * 4 / turn;
            double seconds;
            start(&d, &m, &task, TD_TASK_VEHICLE);
            const double fastest = drive(&m, &d, &seconds);
            assert_true(d.done && !d.stuck);
            /* Centre to the left of the start by the radius. */
            check_end(&m, 3 + radius * (sin(0.7 + turn) - sin(0.7)),
                      -2 - radius * (cos(0.7 + turn) - cos(0.7)), 0.7 + turn);
            assert_true(fastest < 1.5);
            assert_true(seconds > 4 / 0.5 && seconds < 30);
        }
}

static void comes_to_a_goal(void **state)
{
    static const double GOALS[][3] = {{5, 1, 30}, {-4, 0.5, 0}, {0, 0, 90}, {2, -3, -170}};
    (void)state;
    for (int i = 0; i < 3; i++)
        for (int g = 0; g < 4; g++) {
            machine m = {.x = -1, .y = 2, .yaw = -2.5, .half_gauge = 1.1};
            memcpy(m.slip, SLIPS[i], sizeof m.slip);
            td_track_drive d;
            const td_task_drive task = {
                .has_to = true, .to_m = {GOALS[g][0], GOALS[g][1]}, .yaw_deg = GOALS[g][2]};
            double seconds;
            start(&d, &m, &task, TD_TASK_VEHICLE);
            drive(&m, &d, &seconds);
            assert_true(d.done);
            check_end(&m, -1 + cos(-2.5) * GOALS[g][0] - sin(-2.5) * GOALS[g][1],
                      2 + sin(-2.5) * GOALS[g][0] + cos(-2.5) * GOALS[g][1], -2.5 + PI / 180 * GOALS[g][2]);
            machine other = {.x = -1, .y = 2, .yaw = -2.5, .half_gauge = 1.1};
            start(&d, &other, &task, TD_TASK_SITE);
            drive(&other, &d, &seconds);
            check_end(&other, GOALS[g][0], GOALS[g][1], PI / 180 * GOALS[g][2]);
        }
}

/* Shoved aside by 0.3 m at the start, it is back on its line 6 m further on, forwards and backwards. */
static void takes_back_a_shove(void **state)
{
    (void)state;
    for (int way = -1; way <= 1; way += 2) {
        machine m = {.half_gauge = 1.1};
        const td_task_drive task = {.distance_m = way * 6.0};
        td_track_drive d;
        double seconds;
        start(&d, &m, &task, TD_TASK_VEHICLE);
        m.y += 0.3;
        drive(&m, &d, &seconds);
        assert_true(d.done);
        check_near(m.x, way * 6, 0.06);
        check_near(m.y, 0, 0.03);
    }
}

/* The way's points lead from where it stands to the goal, each a step from the one before. */
static void tells_its_way(void **state)
{
    enum { MOST = 200 };
    const machine m = {.x = 1, .y = 1, .yaw = 0};
    const td_task_drive task = {.has_to = true, .to_m = {6, 4}, .yaw_deg = 0};
    double way[MOST][3];
    td_track_drive d;
    (void)state;
    start(&d, &m, &task, TD_TASK_SITE);
    const int count = td_track_drive_way(way, MOST, &d);
    assert_true(count > 100 && count <= MOST);
    check_near(way[0][0], 1, 1e-12);
    check_near(way[count - 1][0], 6, 1e-9);
    check_near(way[count - 1][1], 4, 1e-9);
    check_near(remainder(way[count - 1][2], 2 * PI), 0, 1e-9);
    for (int i = 1; i < count; i++)
        assert_true(hypot(way[i][0] - way[i - 1][0], way[i][1] - way[i - 1][1]) < 0.1);
}

static void is_stuck_where_it_does_not_move(void **state)
{
    machine m = {.half_gauge = 1.1, .slip = {1, 1}};
    const td_task_drive task = {.distance_m = 2};
    td_track_drive d;
    double seconds;
    (void)state;
    start(&d, &m, &task, TD_TASK_VEHICLE);
    drive(&m, &d, &seconds);
    assert_true(d.stuck && !d.done);
    check_near(d.off_m, 2, 1e-6);
    assert_true(seconds < 40);
}

static void refuses(void **state)
{
    const td_pose here = td_pose_identity();
    td_track_drive d;
    td_error error = {0};
    (void)state;
    const td_task_drive bad[] = {{.distance_m = NAN}, {.distance_m = 1, .speed_m_s = 5}};
    check_fails(td_track_drive_start(&d, bad, TD_TASK_SITE, &here, NULL, &error), TD_ERROR_ARGUMENT, error,
                "no number");
    check_fails(td_track_drive_start(&d, bad + 1, TD_TASK_SITE, &here, NULL, &error), TD_ERROR_ARGUMENT,
                error, "5 m/s");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(goes_along_an_arc),
        cmocka_unit_test(comes_to_a_goal),
        cmocka_unit_test(tells_its_way),
        cmocka_unit_test(takes_back_a_shove),
        cmocka_unit_test(is_stuck_where_it_does_not_move),
        cmocka_unit_test(refuses),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
