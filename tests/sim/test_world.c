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
    now = after(world, 60);
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

/* ---- cylinders ---- */

/* What holds the joint, by the generated dynamics: gravity in the base's axes, and a load at the bucket's tip. */
static double needed(const td_robot *robot, const td_dynamics *dynamics, const td_plant_state *s, int joint,
                     const double load[3])
{
    const double down[3] = {0, 0, -9.80665};
    const int link = td_robot_find_link(robot, "bucket_tip"), cylinder = joint - 1;
    const td_pose back = td_pose_inverse(&s->site_from_vehicle);
    double gravity[3], own[3], force[TD_DYNAMICS_MAX], jacobian[6 * TD_DYNAMICS_MAX], lever, v;
    td_pose_rotate(gravity, &back, down);
    td_pose_rotate(own, &back, load);
    td_dynamics_gravity(force, dynamics, s->q, gravity);
    td_dynamics_jacobian(jacobian, dynamics, s->q, link);
    double torque = force[6 + joint];
    for (int c = 0; c < 3; c++) {
        v = jacobian[(3 + c) * (6 + JOINTS) + 6 + joint];
        torque -= v * own[c];
    }
    assert_true(td_cylinder_length(NULL, &lever, robot, robot->cylinder + cylinder, s->q[joint]));
    return torque / fabs(lever);
}

static void test_lifting(void **unused)
{
    static const double load[3] = {0, 0, -10e3};
    td_robot *robot = zx200();
    td_world_options o = td_world_options_default(robot);
    td_elevation *map = plane(0, 0);
    td_dynamics *dynamics = NULL;
    td_error error = {0};
    const int link = td_robot_find_link(robot, "bucket_tip");
    double worst = 0;
    (void)unused;
    check_ok(td_dynamics_new(&dynamics, robot, &error), error);
    memset(o.machine.viscous, 0, sizeof o.machine.viscous); /* friction is no statics */
    memset(o.machine.coulomb, 0, sizeof o.machine.coulomb);
    td_world *world = world_of(robot, map, &o);
    td_plant_state s = state_of(0.3, -0.3, 1.6, 0.5);
    put(world, &s);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_RATE, {0, -0.05, 0.03, 0.05}}, &error), error);
    for (int i = 0; i < 600; i++) {
        double tip[3], moved = 0;
        td_world_state(world, &s);
        tip_of(tip, robot, &s);
        check_ok(td_world_push(world, link, load, tip, &error), error);
        s = after(world, 0.01);
        if (i < 400) continue; /* what the load's arrival set swinging has come to rest */
        for (int k = BOOM; k < JOINTS; k++) {
            moved = needed(robot, dynamics, &s, k, load);
            worst = fmax(worst, fabs(s.force[k] / moved - 1));
            check_near(s.force[k], moved, 0.01 * fabs(moved));
        }
    }
    printf("lifting 10 kN: cylinders are %.2f %% from statics\n", 100 * worst);
    check_less(s.q[BOOM], -0.55);
    td_world_free(&world);
    td_dynamics_free(&dynamics);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* The strongest push of a cylinder against the ground's: it never exceeds its limit. */
static void test_limits(void **unused)
{
    td_robot *robot = zx200();
    td_elevation *map = plane(0, 0);
    td_world *world = world_of(robot, map, NULL);
    td_error error = {0};
    td_plant_state s = state_of(0, -0.9, 1.6, 0.5);
    const double push = 34.3e6 * 3.14159265358979 / 4 * 2 * 0.120 * 0.120;
    double most = 0, speed = 0;
    (void)unused;
    put(world, &s);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_FLOW, {0, -7.07e-3, 0, 0}}, &error), error);
    for (int i = 0; i < 400; i++) {
        s = after(world, 0.01);
        most = fmax(most, fabs(s.force[BOOM]));
        speed = fmax(speed, fabs(s.dq[BOOM]));
    }
    printf("boom against its stop: %.1f of %.1f kN, %.3f rad/s, %.2f mrad past it\n", 1e-3 * most, 1e-3 * push, speed,
           1e3 * (robot->joint[BOOM].lower - s.q[BOOM]));
    check_less(most, push * (1 + 1e-9));
    check_less(0.97 * push, fabs(s.force[BOOM]));
    assert_true(s.at_stop[BOOM]);
    check_near(s.q[BOOM], robot->joint[BOOM].lower, 3e-3);
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* ---- driving ---- */

static double yaw_of(const td_pose *pose)
{
    static const double x[3] = {1, 0, 0};
    double way[3];
    td_pose_rotate(way, pose, x);
    return atan2(way[1], way[0]);
}

static double mass_of(const td_robot *robot)
{
    double mass = 0;
    for (int i = 0; i < robot->link_count; i++) mass += robot->link[i].mass_kg;
    return mass;
}

static void test_straight(void **unused)
{
    td_robot *robot = zx200();
    const td_world_options o = td_world_options_default(robot);
    const td_world_tracks *t = &o.tracks;
    (void)unused;
    for (int uphill = 0; uphill < 2; uphill++) {
        const double angle = uphill ? 10 * 3.14159265358979 / 180 : 0, belt = 0.8;
        td_elevation *map = plane(tan(angle), 0);
        td_world *world = world_of(robot, map, &o);
        td_error error = {0};
        td_plant_state s = state_of(0, -0.6, 1.6, 0.5), begun;
        s.site_from_vehicle.t[0] = -8;
        s.site_from_vehicle.t[2] = -8 * tan(angle);
        td_error why = {0};
        if (uphill) { /* it cannot stand upright on a slope */
            const td_pose nose_up = {.q = {cos(angle / 2), 0, -sin(angle / 2), 0}};
            memcpy(s.site_from_vehicle.q, nose_up.q, sizeof nose_up.q);
        }
        check_ok(td_world_reset(world, &s, &why), why);
        check_ok(td_world_settle(world, &why), why);
        check_ok(td_world_drive(world, belt, belt, &error), error);
        begun = after(world, 5);
        s = after(world, 5);
        const double way = hypot(s.site_from_vehicle.t[0] - begun.site_from_vehicle.t[0],
                                 s.site_from_vehicle.t[2] - begun.site_from_vehicle.t[2]);
        const double pull = 9.80665 * mass_of(robot) * (sin(angle) + t->rolling * cos(angle)),
                     slip = pull / (t->shear_n_m * t->relax_m);
        printf("straight%s: slip %.4f, by its parameters %.4f; %.2f mm aside\n", uphill ? ", 10 deg up" : "",
               1 - way / (5 * belt), slip, 1e3 * s.site_from_vehicle.t[1]);
        check_near(1 - way / (5 * belt), slip, 0.01 * slip);
        td_world_free(&world);
        td_elevation_free(&map);
    }
    td_robot_free(&robot);
}

/* Moment about z of the ground on a machine whose weight is spread as `load` over its points, turning about its
 * middle at `rate` with belts at -belt and belt: each point's steady shear is its sliding times relax / belt, within
 * friction. */
static double turning_moment(const td_world_tracks *t, const double load[], double rate, double belt)
{
    double moment = 0;
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < t->points; i++) {
            const double x = t->half_length_m * (2.0 * i / (t->points - 1) - 1),
                         y = side ? -t->half_gauge_m : t->half_gauge_m, v = side ? belt : -belt,
                         n = load[side * t->points + i];
            double sx = -rate * y - v, sy = rate * x;
            const double weight = n, k = t->shear_n_m * t->relax_m / belt;
            double fx = -k * weight * sx, fy = -k * weight * sy;
            const double most = t->friction * weight * 9.80665 * 20500, size = hypot(fx, fy);
            if (size > most) fx *= most / size, fy *= most / size;
            fx -= t->rolling * weight * 9.80665 * 20500 * (v > 0 ? 1 : -1);
            moment += x * fy - y * fx;
        }
    return moment;
}

static void test_turn(void **unused)
{
    td_robot *robot = zx200();
    const td_world_options o = td_world_options_default(robot);
    const td_world_tracks *t = &o.tracks;
    const double belt = 0.5;
    td_elevation *map = plane(0, 0);
    td_world *world = world_of(robot, map, &o);
    td_error error = {0};
    td_plant_state s = state_of(0, -0.6, 1.6, 0.5), begun;
    (void)unused;
    put(world, &s);
    check_ok(td_world_drive(world, -belt, belt, &error), error);
    begun = after(world, 3);
    s = after(world, 4);
    double turned = yaw_of(&s.site_from_vehicle) - yaw_of(&begun.site_from_vehicle);
    if (turned < 0) turned += 2 * 3.14159265358979;
    printf("turn in place: %.4f rad/s of %.4f without slip\n", turned / 4, belt / t->half_gauge_m);
    (void)turning_moment;
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_free_motion), cmocka_unit_test(test_stand), cmocka_unit_test(test_lifting), cmocka_unit_test(test_limits), cmocka_unit_test(test_straight), cmocka_unit_test(test_turn)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
