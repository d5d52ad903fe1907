/* The world on ODE, sim/world.
 *
 * Free motion against the generated dynamics integrated at 1e-9 (sim/machine), which shares with the world
 * only the joints' friction: within 5 mm at the tip over 10 s, and four times closer at half the step, which
 * a missing or wrong term would not be. Cylinders when lifting, against gravity's term and the Jacobian of
 * the recursive dynamics, to 1 %. Standing on a 10 degree slope: 5 mm. Slip of straight driving against
 * (pull) / (shear stiffness * relaxation) in closed form, of turning in place against a rigid plate in the
 * plane solved here, to 1 %; sliding against a block on a slope that is diagonal to the vehicle, where
 * friction of the two axes taken apart would hold. Stones against where they must lie; limits and refusals by
 * their words.
 *
 * Blind to: whether the tracks' friction, shear and rolling resistance are a real machine's. */
#include "tests/check.h"

#include "sim/dynamics.h"
#include "sim/world.h"

#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

enum { SWING, BOOM, ARM, BUCKET, JOINTS };
static const double PI = 3.14159265358979323846;

static td_robot *zx200(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

/* A plane, `rise` up a metre forwards, and as much to the left. 40 m square, the site's origin in its middle.
 */
static td_elevation *plane(double rise, double aside)
{
    enum { CELLS = 161 };
    const double origin[2] = {-20, -20};
    td_elevation *map = NULL;
    td_error error = {0};
    check_ok(td_elevation_new(&map, CELLS, CELLS, 0.25, origin, "site", &error), error);
    for (int r = 0; r < CELLS; r++)
        for (int c = 0; c < CELLS; c++)
            map->height[r * CELLS + c] =
                (float)(rise * (origin[0] + 0.25 * c) + aside * (origin[1] + 0.25 * r));
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

static double mass_of(const td_robot *robot)
{
    double mass = 0;
    for (int i = 0; i < robot->link_count; i++) mass += robot->link[i].mass_kg;
    return mass;
}

/* ---- free motion ---- */

static double apart_over(const td_robot *robot, const td_world_options *o, const td_plant_state *start,
                         double step)
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
        worst = fmax(worst, hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]));
    }
    td_world_free(&world);
    td_machine_free(&machine);
    return worst;
}

static void test_free_motion(void **unused)
{
    (void)unused;
    check_statistics();
    static const char *const names[3] = {"swinging", "floating", "with friction"};
    td_robot *robot = zx200();
    robot->cylinder_count = 0; /* no stops: a bounce makes chaos of rounding */
    for (int k = 0; k < JOINTS; k++) robot->joint[k].lower = -INFINITY, robot->joint[k].upper = INFINITY;
    for (int kind = 0; kind < 3; kind++) {
        td_world_options o = td_world_options_default(robot);
        td_plant_state s = kind ? state_of(0.2, -0.6, 1.6, 0.8) : state_of(0.2, 0.8, 0.6, 0.3);
        o.machine.base = kind == 1 ? TD_MACHINE_FLOATING : TD_MACHINE_FIXED;
        o.machine.hydraulics = false;
        if (kind < 2) {
            memset(o.machine.viscous, 0, sizeof o.machine.viscous);
            memset(o.machine.coulomb, 0, sizeof o.machine.coulomb);
        }
        s.dq[SWING] = 0.3;
        s.dq[BUCKET] = 0.1;
        if (kind == 1) {
            o.machine.gravity[2] = 0;
            s.twist[0] = 0.1, s.twist[2] = 0.2, s.twist[3] = 0.1;
        }
        const double one = apart_over(robot, &o, &s, 1e-3), half = apart_over(robot, &o, &s, 5e-4);
        printf("free, %s, 10 s: tips apart by %.3g mm at 1 ms, %.3g at 0.5 ms\n", names[kind], 1e3 * one,
               1e3 * half);
        check_less(one, 5e-3);
        check_near(one / half, 4, 0.5);
    }
    td_robot_free(&robot);
}

/* 10 min with TELEDIMOS_FULL=1. */
static void test_stand(void **unused)
{
    (void)unused;
    check_statistics();
    const char *full = getenv("TELEDIMOS_FULL");
    const int minutes = full && strcmp(full, "1") == 0 ? 10 : 1;
    const double rise = tan(10 * PI / 180);
    td_robot *robot = zx200();
    td_elevation *map = plane(rise, 0);
    td_world *world = world_of(robot, map, NULL);
    td_plant_state s = state_of(0.4, -0.6, 1.6, 0.5), begun;
    double most = 0, tip[2][3];
    put(world, &s);
    td_world_state(world, &begun);
    tip_of(tip[0], robot, &begun);
    for (int i = 0; i < minutes; i++) {
        s = after(world, 60);
        tip_of(tip[1], robot, &s);
        for (int c = 0; c < 3; c++) {
            most = fmax(most, fabs(s.site_from_vehicle.t[c] - begun.site_from_vehicle.t[c]));
            most = fmax(most, fabs(tip[1][c] - tip[0][c]));
        }
    }
    printf("%d min on 10 deg: it and its tip move by %.2g mm\n", minutes, 1e3 * most);
    check_less(most, 5e-3);
    /* Its middle is below the slope by the sag. */
    const double weight = 9.80665 * mass_of(robot), c = cos(atan(rise)), *t = begun.site_from_vehicle.t;
    check_near((t[2] - rise * t[0]) * c, -weight * c / 1.3e7, 2e-5);
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* ---- cylinders ---- */

/* What holds the joint, by the generated dynamics: gravity in the base's axes, and a load at the bucket's
 * tip. */
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
    td_plant_state s = state_of(0.3, -0.7, 1.6, 0.5);
    put(world, &s);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_RATE, {0, -0.03, 0.02, 0.03}}, &error),
             error);
    for (int i = 0; i < 1200; i++) {
        double tip[3], moved = 0;
        td_world_state(world, &s);
        tip_of(tip, robot, &s);
        check_ok(td_world_push(world, link, load, tip, &error), error);
        s = after(world, 0.01);
        if (i < 1000) continue; /* what the load's arrival set swinging has come to rest */
        for (int k = BOOM; k < JOINTS; k++) {
            moved = needed(robot, dynamics, &s, k, load);
            worst = fmax(worst, fabs(s.force[k] / moved - 1));
            check_near(s.force[k], moved, 0.01 * fabs(moved));
        }
    }
    printf("lifting 10 kN: cylinders are %.2f %% from statics\n", 100 * worst);
    check_less(s.q[BOOM], -0.95);
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
    const double push = 34.3e6 * PI / 4 * 2 * 0.120 * 0.120;
    double most = 0, speed = 0;
    (void)unused;
    put(world, &s);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_FLOW, {0, -7.07e-3, 0, 0}}, &error),
             error);
    for (int i = 0; i < 400; i++) {
        s = after(world, 0.01);
        most = fmax(most, fabs(s.force[BOOM]));
        speed = fmax(speed, fabs(s.dq[BOOM]));
    }
    printf("boom against its stop: %.1f of %.1f kN, %.3f rad/s, %.2f mrad past it\n", 1e-3 * most,
           1e-3 * push, speed, 1e3 * (robot->joint[BOOM].lower - s.q[BOOM]));
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

static void test_straight(void **unused)
{
    td_robot *robot = zx200();
    const td_world_options o = td_world_options_default(robot);
    const td_world_tracks *t = &o.tracks;
    (void)unused;
    for (int uphill = 0; uphill < 2; uphill++) {
        const double angle = uphill ? 10 * PI / 180 : 0, belt = 0.8;
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

/* A machine as a rigid plate that turns at a steady rate: each point's shear is then its sliding times relax
 * / belt, its force within friction. Loads are those of a plate on springs. */
typedef struct plate {
    const td_world_tracks *tracks;
    double mass, com[2], square[2], belt;
} plate;

/* Force and moment about the centre of mass, in the vehicle's axes, at v and rate there. */
static void plate_force(double force[3], const plate *p, const double v[3])
{
    const td_world_tracks *t = p->tracks;
    const double third = t->half_length_m / 3, weight = 9.80665 * p->mass;
    /* Four points a track, at +-L and +-L/3: two conditions, two weights. */
    const double inner = (t->half_length_m * t->half_length_m - p->square[0]) / 4 /
                         (t->half_length_m * t->half_length_m - third * third),
                 outer = 0.25 - inner;
    memset(force, 0, 3 * sizeof *force);
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < 4; i++) {
            const double x = t->half_length_m * (2.0 * i / 3 - 1),
                         y = side ? -t->half_gauge_m : t->half_gauge_m, belt = side ? p->belt : -p->belt,
                         share = i == 0 || i == 3 ? outer : inner;
            const double load =
                share * weight * (1 + x * p->com[0] / p->square[0] + y * p->com[1] / p->square[1]);
            const double rx = x - p->com[0], ry = y - p->com[1],
                         k = share * t->shear_n_m * t->relax_m / fabs(belt);
            double fx = -k * (v[0] - v[2] * ry - belt), fy = -k * (v[1] + v[2] * rx);
            const double size = hypot(fx, fy), most = t->friction * load;
            if (size > most) fx *= most / size, fy *= most / size;
            fx -= t->rolling * load * (belt > 0 ? 1 : -1);
            force[0] += fx;
            force[1] += fy;
            force[2] += rx * fy - ry * fx;
        }
}

static double plate_rate(const plate *p)
{
    const double h = 2e-3, inertia = 8e4; /* any: only where it comes to rest counts */
    double v[3] = {0}, f[3];
    for (int i = 0; i < 20000; i++) {
        plate_force(f, p, v);
        v[0] += h * (f[0] / p->mass + v[2] * v[1]);
        v[1] += h * (f[1] / p->mass - v[2] * v[0]);
        v[2] += h * f[2] / inertia;
    }
    return v[2];
}

static plate plate_of(const td_robot *robot, const td_world_tracks *tracks, const double *q, double belt)
{
    plate p = {.tracks = tracks, .mass = mass_of(robot), .belt = belt};
    td_pose at[TD_ROBOT_MAX_LINKS];
    td_robot_forward(at, robot, q);
    for (int i = 0; i < robot->link_count; i++) {
        double c[3];
        td_pose_transform(c, at + i, robot->link[i].com_m);
        for (int k = 0; k < 2; k++) p.com[k] += robot->link[i].mass_kg * c[k] / p.mass;
    }
    for (int k = 0; k < 2; k++) p.square[k] = robot->suspension_n_m[1 + k] / robot->suspension_n_m[0];
    return p;
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
    if (turned < 0) turned += 2 * PI;
    const plate p = plate_of(robot, t, s.q, belt);
    const double rate = plate_rate(&p);
    printf("turn in place: %.4f rad/s, by its parameters %.4f, without slip %.4f\n", turned / 4, rate,
           belt / t->half_gauge_m);
    check_near(turned / 4, rate, 0.01 * rate);
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* Belts that stand, on a slope diagonal to the vehicle: with friction above the slope it stays, below it
 * slides as a block does. */
static void test_slide(void **unused)
{
    td_robot *robot = zx200();
    td_world_options o = td_world_options_default(robot);
    const double angle = 10 * PI / 180, each = tan(angle) / sqrt(2);
    td_elevation *map = plane(each, each);
    td_world *world = world_of(robot, map, &o);
    td_error error = {0};
    td_plant_state rest = state_of(0, -0.6, 1.6, 0.5);
    (void)unused;
    put(world, &rest);
    td_world_state(world, &rest);
    td_world_free(&world);
    for (int slippery = 0; slippery < 2; slippery++) {
        o.tracks.friction = slippery ? 0.15 : 0.2;
        world = world_of(robot, map, &o);
        check_ok(td_world_reset(world, &rest, &error), error);
        const td_plant_state begun = after(world, 1), later = after(world, 4);
        double apart = 0, v = 0;
        for (int c = 0; c < 3; c++) {
            apart += pow(later.site_from_vehicle.t[c] - begun.site_from_vehicle.t[c], 2);
            v += pow(begun.twist[3 + c], 2);
        }
        const double a = 9.80665 * (sin(angle) - 0.15 * cos(angle)), way = slippery ? 4 * sqrt(v) + a * 8 : 0;
        printf("friction %.2f, diagonally on 10 deg, 4 s: slides %.4f m, a block %.4f\n", o.tracks.friction,
               sqrt(apart), way);
        check_near(sqrt(apart), way, slippery ? 0.01 * way : 1e-3);
        td_world_free(&world);
    }
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* ---- stones ---- */

static td_world_stone box_of(double x, double y, double z, double size, double density)
{
    td_world_stone s = {.shape = {.kind = TD_PRIMITIVE_BOX, .link_from_shape = td_pose_identity()},
                        .density = density,
                        .friction = 0.6};
    for (int c = 0; c < 3; c++) s.shape.size[c] = size;
    s.shape.link_from_shape.t[0] = x;
    s.shape.link_from_shape.t[1] = y;
    s.shape.link_from_shape.t[2] = z;
    return s;
}

static int add(td_world *world, const td_world_stone *stone)
{
    td_error error = {0};
    int index = -1;
    check_ok(td_world_add_stone(world, &index, stone, &error), error);
    return index;
}

/* They come to rest where they must: on the ground, on a wall. */
static void test_stones(void **unused)
{
    td_robot *robot = zx200();
    td_elevation *map = plane(0, 0);
    td_world *world = world_of(robot, map, NULL);
    td_plant_state s = state_of(0, -0.6, 1.6, 0.8);
    td_pose at;
    double twist[6];
    (void)unused;
    td_world_stone stone = box_of(3, 6, 0.4, 0.5, 2500);
    const int cube = add(world, &stone);
    stone = box_of(-6, 0, 0.5, 1, 0);
    const int wall = add(world, &stone);
    stone = box_of(-6, 0, 1.3, 0, 2500);
    stone.shape.kind = TD_PRIMITIVE_SPHERE;
    stone.shape.size[0] = 0.2;
    const int ball = add(world, &stone);
    put(world, &s);
    after(world, 2);
    assert_true(td_world_stone_at(&at, twist, world, ball));
    check_near(at.t[2], 1.2, 2e-3);
    assert_true(td_world_stone_at(&at, twist, world, cube));
    check_near(at.t[2], 0.25, 2e-3);
    for (int i = 0; i < 6; i++) check_near(twist[i], 0, 1e-3);
    assert_true(td_world_stone_at(&at, twist, world, wall));
    check_near(at.t[2], 0.5, 1e-12);
    assert_int_equal(td_world_stone_count(world), 3);
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* A cube is pushed along by the track, a wall stops it. */
static void test_pushing(void **unused)
{
    td_robot *robot = zx200();
    td_elevation *map = plane(0, 0);
    td_world *world = world_of(robot, map, NULL);
    td_error error = {0};
    td_plant_state s = state_of(0, -0.9, 1.6, 0.8);
    td_pose at;
    (void)unused;
    td_world_stone stone = box_of(3, 1.1, 0.25, 0.5, 2500);
    const int cube = add(world, &stone);
    stone = box_of(6, 0, 0.5, 1, 0); /* between the tracks */
    add(world, &stone);
    put(world, &s);
    check_ok(td_world_drive(world, 0.8, 0.8, &error), error);
    s = after(world, 2);
    assert_true(td_world_stone_at(&at, NULL, world, cube));
    printf("pushed to %.3f m by a track whose front is at %.3f\n", at.t[0], s.site_from_vehicle.t[0] + 2.1);
    check_near(at.t[0], s.site_from_vehicle.t[0] + 2.1 + 0.25, 0.1);
    s = after(world, 8);
    const td_plant_state later = after(world, 2);
    printf("at the wall: the frame's front at %.3f m of 5.5\n", later.site_from_vehicle.t[0] + 1);
    check_near(later.site_from_vehicle.t[0], s.site_from_vehicle.t[0], 0.02);
    check_near(later.site_from_vehicle.t[0] + 1, 5.5, 0.02); /* the box of the frame between the tracks */
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* The bucket's lip under a stone; raised and curled, it brings it along. */
static void test_scooping(void **unused)
{
    td_robot *robot = zx200();
    td_elevation *map = plane(0, 0);
    td_world *world = world_of(robot, map, NULL);
    td_error error = {0};
    td_plant_state s = state_of(0, -0.320, 1.786, 1.056);
    td_pose at, link[TD_ROBOT_MAX_LINKS];
    double inside[3];
    (void)unused;
    td_world_stone stone = box_of(5.5, -0.07, 0.2, 0, 2500);
    stone.shape.kind = TD_PRIMITIVE_SPHERE;
    stone.shape.size[0] = 0.2;
    const int ball = add(world, &stone);
    put(world, &s);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_RATE, {0, -0.1, 0, 0.3}}, &error), error);
    after(world, 3);
    check_ok(td_world_command(world, &(td_plant_command){TD_COMMAND_RATE, {0.2, -0.1, 0, 0}}, &error), error);
    after(world, 3);
    assert_true(td_world_stone_at(&at, NULL, world, ball));
    td_world_links(link, world);
    const td_pose back = td_pose_inverse(link + td_robot_find_link(robot, "bucket"));
    td_pose_transform(inside, &back, at.t);
    printf("scooped: the stone is %.2f m up, at (%.2f, %.2f, %.2f) in the bucket\n", at.t[2], inside[0],
           inside[1], inside[2]);
    check_less(1, at.t[2]);
    assert_true(inside[0] > 0 && inside[0] < 1.4 && fabs(inside[1]) < 0.55 && inside[2] > 0 &&
                inside[2] < 0.72);
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* ---- what is refused ---- */

static void test_refusals(void **unused)
{
    td_robot *robot = zx200();
    td_world_options o = td_world_options_default(robot);
    td_elevation *map = plane(0, 0);
    td_world *world = NULL;
    td_error error = {0};
    td_plant_state s = state_of(0, -0.6, 1.6, 0.5);
    (void)unused;
    check_fails(td_world_new(&world, robot, NULL, &o, &error), TD_ERROR_ARGUMENT, error, "there is no map");
    assert_null(world);
    o.tracks.points = 1;
    check_fails(td_world_new(&world, robot, map, &o, &error), TD_ERROR_ARGUMENT, error,
                "points of each track 1");
    o = td_world_options_default(robot);
    o.step_s = NAN;
    check_fails(td_world_new(&world, robot, map, &o, &error), TD_ERROR_ARGUMENT, error, "step");
    o.step_s = 1e-3;
    o.machine.oil_n_m = -1;
    check_fails(td_world_new(&world, robot, map, &o, &error), TD_ERROR_ARGUMENT, error, "oil's stiffness");
    td_robot *light = zx200();
    light->link[td_robot_find_link(light, "arm")].mass_kg = 0;
    check_fails(td_world_new(&world, light, map, NULL, &error), TD_ERROR_DATA, error, "link 'arm'");
    td_robot_free(&light);

    world = world_of(robot, map, NULL);
    put(world, &s);
    td_plant_state before, later;
    td_world_state(world, &before);
    s.site_from_vehicle.t[0] = 19;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_DATA, error, "has a hole or ends");
    s.site_from_vehicle.t[0] = 0;
    s.site_from_vehicle.t[2] = 2;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "starts over an edge");
    s.site_from_vehicle.t[2] = -2;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "under the ground");
    s.site_from_vehicle.t[2] = 0;
    s.q[BOOM] = 0.1;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "link 'bucket_tip'");
    s.q[BOOM] = NAN;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "position of joint 'boom'");
    s.q[BOOM] = -0.6;
    s.dq[BOOM] = 1e5;
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "starts at 100000 rad/s");
    td_world_state(world, &later);
    assert_memory_equal(&before, &later, sizeof before); /* refused, it has changed nothing */

    const double force[3] = {NAN, 0, 0}, point[3] = {0};
    check_fails(td_world_push(world, 0, force, point, &error), TD_ERROR_ARGUMENT, error, "no number");
    check_fails(td_world_push(world, 99, point, point, &error), TD_ERROR_ARGUMENT, error, "no link 99");
    check_fails(td_world_drive(world, 0, 9, &error), TD_ERROR_ARGUMENT, error, "0 and 9 m/s");
    check_fails(td_world_step(world, -1, &error), TD_ERROR_ARGUMENT, error, "-1 s");
    check_fails(td_world_command(world, &(td_plant_command){TD_COMMAND_FLOW, {0, 1, 0, 0}}, &error),
                TD_ERROR_ARGUMENT, error, "joint 'boom': a flow of");
    td_world_stone stone = box_of(0, 0, 0, -1, 2500);
    check_fails(td_world_add_stone(world, NULL, &stone, &error), TD_ERROR_ARGUMENT, error,
                "kind, size or pose");

    /* A hole in the way, and an edge. */
    for (int i = 0; i < map->columns * map->rows; i++)
        if (i % map->columns > 100 && i % map->columns < 104) map->height[i] = NAN; /* 5.25 to 5.75 m */
    check_ok(td_world_drive(world, 1, 1, &error), error);
    check_fails(td_world_step(world, 20, &error), TD_ERROR_DATA, error, "comes to (5.0");
    for (int i = 0; i < map->columns * map->rows; i++) map->height[i] = i % map->columns > 80 ? -3 : 0;
    s = state_of(0, -0.6, 1.6, 0.5);
    check_fails(td_world_reset(world, &s, &error), TD_ERROR_ARGUMENT, error, "over an edge");
    td_world_free(&world);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

/* ---- the same again ---- */

static void shake(void *user, td_world *world)
{
    const double force[3] = {500, -300, 2000}, point[3] = {5, 0, 2};
    (void)user;
    assert_int_equal(td_world_push(world, 4, force, point, NULL), TD_OK);
}

/* Driven, turned, lifted, stones pushed, pushed on from before each step; behind the plant's functions. */
static td_plant_state manoeuvre(const td_robot *robot, const td_elevation *map, double piece, td_pose *pushed)
{
    td_world_options o = td_world_options_default(robot);
    o.before_step = shake;
    td_world *world = world_of(robot, map, &o);
    td_plant plant = td_world_plant(world);
    td_error error = {0};
    td_plant_state s = state_of(0, -0.7, 1.6, 0.5);
    for (int i = 0; i < 3; i++) {
        const td_world_stone stone = box_of(3 + 0.7 * i, 1.1, 0.3, 0.4, 2500);
        add(world, &stone);
    }
    s.site_from_vehicle.t[2] = -0.015;
    check_ok(plant.reset(plant.self, &s, &error), error);
    check_ok(td_world_drive(world, 0.7, 0.5, &error), error);
    check_ok(plant.command(plant.self, &(td_plant_command){TD_COMMAND_RATE, {0.3, -0.05, 0.1, 0.2}}, &error),
             error);
    const int pieces = (int)(2 / piece + 0.5);
    for (int i = 0; i < pieces; i++) check_ok(plant.step(plant.self, piece, &error), error);
    check_ok(plant.state(plant.self, &s, &error), error);
    for (int i = 0; i < 3; i++) td_world_stone_at(pushed + i, NULL, world, i);
    plant.free(plant.self);
    return s;
}

static void test_again(void **unused)
{
    td_robot *robot = zx200();
    td_elevation *map = plane(0.02, 0.01);
    td_pose pushed[3][3];
    (void)unused;
    const td_plant_state a = manoeuvre(robot, map, 2, pushed[0]), b = manoeuvre(robot, map, 2, pushed[1]),
                         c = manoeuvre(robot, map, 0.02, pushed[2]);
    assert_memory_equal(&a, &b, sizeof a);
    assert_memory_equal(pushed[0], pushed[1], sizeof pushed[0]);
    assert_memory_equal(&a, &c, sizeof a); /* nor does it matter how it is cut into pieces */
    assert_memory_equal(pushed[0], pushed[2], sizeof pushed[0]);
    check_near(a.time_s, 2, 1e-12);
    td_elevation_free(&map);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_free_motion), cmocka_unit_test(test_stand),    cmocka_unit_test(test_lifting),
        cmocka_unit_test(test_limits),      cmocka_unit_test(test_straight), cmocka_unit_test(test_turn),
        cmocka_unit_test(test_slide),       cmocka_unit_test(test_stones),   cmocka_unit_test(test_pushing),
        cmocka_unit_test(test_scooping),    cmocka_unit_test(test_refusals), cmocka_unit_test(test_again)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
