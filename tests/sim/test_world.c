/* The world on ODE, sim/world. */
#include "tests/check.h"

#include <time.h>

#include "sim/dynamics.h"
#include "sim/world.h"

#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

enum { SWING, BOOM, ARM, BUCKET, JOINTS };


static td_robot *zx200(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

/* A plane, `rise` up a metre forwards, and as much to the left. 40 m square, the site's origin in its middle. */
static td_elevation *plane(double rise, double aside)
{
    enum { CELLS = 161 };
    const double origin[2] = {-20, -20};
    td_elevation *map = NULL;
    td_error error = {0};
    check_ok(td_elevation_new(&map, CELLS, CELLS, 0.25, origin, "site", &error), error);
    for (int r = 0; r < CELLS; r++)
        for (int c = 0; c < CELLS; c++)
            map->height[r * CELLS + c] = (float)(rise * (origin[0] + 0.25 * c) + aside * (origin[1] + 0.25 * r));
    return map;
}

static td_world *world_of(const td_robot *robot, const td_elevation *map, const td_world_options *options)
{
    td_world *world = NULL;
    td_error error = {0};
    check_ok(td_world_new(&world, robot, map, options, &error), error);
    return world;
}

static td_plant_state state_of(double swing, double boom, double arm, double bucket)
{
    return (td_plant_state){.site_from_vehicle = td_pose_identity(), .q = {swing, boom, arm, bucket}};
}

static void put(td_world *world, const td_plant_state *state)
{
    td_error error = {0};
    check_ok(td_world_reset(world, state, &error), error);
    check_ok(td_world_settle(world, &error), error);
}

static td_plant_state after(td_world *world, double dt)
{
    td_plant_state s;
    td_error error = {0};
    check_ok(td_world_step(world, dt, &error), error);
    td_world_state(world, &s);
    return s;
}

static void tip_of(double tip[3], const td_robot *robot, const td_plant_state *s)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, robot, s->q);
    td_pose_transform(tip, &s->site_from_vehicle, at[td_robot_find_link(robot, "bucket_tip")].t);
}

/* ---- free motion ---- */

static double apart_over(const td_robot *robot, const td_world_options *o, const td_plant_state *start, double step)
{
    td_world_options options = *o;
    options.step_s = step;
    td_world *world = world_of(robot, NULL, &options);
    td_machine *machine = NULL;
    td_error error = {0};
    double worst = 0;
    td_machine_options fine = o->machine;
    fine.integrator.relative = 1e-9;
    check_ok(td_machine_new(&machine, robot, &fine, NULL, &error), error);
    check_ok(td_machine_reset(machine, start, &error), error);
    check_ok(td_world_reset(world, start, &error), error);
    for (int i = 0; i < 100; i++) {
        td_plant_state other;
        double a[3], b[3];
        const td_plant_state s = after(world, 0.1);
        check_ok(td_machine_step(machine, 0.1, &error), error);
        td_machine_state(machine, &other);
        tip_of(a, robot, &s);
        tip_of(b, robot, &other);
        if (getenv("SHOW") && i % 10 == 9) { size_t ev = 0; td_machine_events(machine, &ev); printf("%d %g  q %g %g %g %g ev %zu\n", i, 1e3*hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]), s.q[0], s.q[1], s.q[2], s.q[3], ev); }
        worst = fmax(worst, hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]));
    }
    td_world_free(&world);
    td_machine_free(&machine);
    return worst;
}

static void test_free_motion(void **unused)
{
    td_robot *robot = zx200();
    (void)unused;
    robot->cylinder_count = 0;
    for (int k = 0; k < JOINTS; k++) robot->joint[k].lower = -INFINITY, robot->joint[k].upper = INFINITY;
    for (int kind = 0; kind < 3; kind++) {
        td_world_options o = td_world_options_default(robot);
        td_plant_state s = state_of(0.2, -0.6, 1.6, 0.8);
        o.machine.base = kind != 1 ? TD_MACHINE_FIXED : TD_MACHINE_FLOATING;
        o.machine.hydraulics = false;
        if (kind == 1) o.machine.gravity[2] = 0;
        if (kind < 2) {
            memset(o.machine.viscous, 0, sizeof o.machine.viscous);
            memset(o.machine.coulomb, 0, sizeof o.machine.coulomb);
        }
        o.machine.stop_damping = 0;
        s.dq[SWING] = 0.3;
        s.dq[BUCKET] = 0.1;
        if (kind == 1) s.twist[0] = 0.1, s.twist[2] = 0.2, s.twist[3] = 0.1;
        const double one = apart_over(robot, &o, &s, 1e-3), half = apart_over(robot, &o, &s, 5e-4);
        printf("free motion %d, 10 s: tips apart %.3g mm at 1 ms, %.3g at 0.5 ms\n", kind, 1e3 * one, 1e3 * half);
    }
    td_robot_free(&robot);
}

static void test_stand(void **unused)
{
    td_robot *robot = zx200();
    const double tilt = tan(10 * 3.14159265358979 / 180);
    td_elevation *map = plane(tilt, 0);
    td_world *world = world_of(robot, map, NULL);
    td_plant_state s = state_of(0.4, -0.6, 1.6, 0.5);
    (void)unused;
    put(world, &s);
    td_plant_state begun, now;
    td_world_state(world, &begun);
    const clock_t c = clock();
    now = after(world, 600);
    printf("10 min: %.3f %.3f %.3f mm, %g s; pose %g %g %g  q %g %g %g %g, boom by %g mrad\n",
           1e3 * (now.site_from_vehicle.t[0] - begun.site_from_vehicle.t[0]),
           1e3 * (now.site_from_vehicle.t[1] - begun.site_from_vehicle.t[1]),
           1e3 * (now.site_from_vehicle.t[2] - begun.site_from_vehicle.t[2]),
           (double)(clock() - c) / CLOCKS_PER_SEC, begun.site_from_vehicle.t[0], begun.site_from_vehicle.t[1],
           begun.site_from_vehicle.t[2], begun.site_from_vehicle.q[0], begun.site_from_vehicle.q[1],
           begun.site_from_vehicle.q[2], begun.site_from_vehicle.q[3], 1e3 * (now.q[BOOM] - begun.q[BOOM]));
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_free_motion), cmocka_unit_test(test_stand)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
