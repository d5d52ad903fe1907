/* The machine model, sim/machine.
 *
 * Statics: forces of the cylinders at ten poses against moments and lever arms taken by hand from the
 * figures of datasets/zx200 (perpendicular distance from pin to cylinder; the four-bar by the balance of
 * forces at its rod eye), to 1e-6: independent of the dynamics' code and of td_cylinder_length. Sag against
 * m g / k. Conservation of energy and momentum at stated tolerances: without dissipation nothing may get
 * lost, so a force that is no gradient, or a wrong frame, shows. Flow against the joint's rate through the
 * lever arm; limits, stops and pumps against the figures of the robot file; refusals by their words.
 *
 * Blind to: whether the assumed friction, lag and stiffness are a real machine's. */
#include "tests/check.h"

#include <time.h>

#include "sim/machine.h"

#define ZX200 TD_SOURCE_DIR "/datasets/zx200/zx200.urdf"

enum { SWING, BOOM, ARM, BUCKET, JOINTS };
static const double G = 9.80665, PI = 3.14159265358979323846;

static td_robot *zx200(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

static td_machine *machine_of(const td_robot *robot, const td_machine_options *options)
{
    td_machine *machine = NULL;
    td_error error = {0};
    check_ok(td_machine_new(&machine, robot, options, NULL, &error), error);
    check_ok(td_machine_settle(machine, &error), error);
    return machine;
}

static void put(td_machine *machine, double swing, double boom, double arm, double bucket)
{
    td_plant_state state;
    td_error error = {0};
    const double q[JOINTS] = {swing, boom, arm, bucket};
    td_machine_state(machine, &state);
    memcpy(state.q, q, sizeof q);
    check_ok(td_machine_reset(machine, &state, &error), error);
    check_ok(td_machine_settle(machine, &error), error);
}

static void step(td_machine *machine, double dt)
{
    td_error error = {0};
    check_ok(td_machine_step(machine, dt, &error), error);
}

static void command(td_machine *machine, td_command_kind kind, double swing, double boom, double arm,
                    double bucket)
{
    td_error error = {0};
    const td_plant_command c = {.kind = kind, .value = {swing, boom, arm, bucket}};
    check_ok(td_machine_command(machine, &c, NULL, &error), error);
}

static td_plant_state read_state(const td_machine *machine)
{
    td_plant_state state;
    td_machine_state(machine, &state);
    return state;
}

/* ---- statics, by hand ---- */

/* In the plane of the arm: x forward, z up; an angle is positive downwards. */
typedef struct flat {
    double x, z;
} flat;

static flat turned(double angle, double x, double z)
{
    return (flat){x * cos(angle) + z * sin(angle), z * cos(angle) - x * sin(angle)};
}

static flat towards(flat a, flat b)
{
    const double length = hypot(b.x - a.x, b.z - a.z);
    return (flat){(b.x - a.x) / length, (b.z - a.z) / length};
}

/* About the axis y (left), of a unit force along `way` at `at`: the lever arm with its sign. */
static double arm_of(flat at, flat way)
{
    return at.z * way.x - at.x * way.z;
}

/* Forces that hold boom, arm and bucket; positive where the angle would grow, as in core/plant.h. */
static void by_hand(double force[JOINTS], const double q[JOINTS])
{
    const double a = q[BOOM], b = a + q[ARM], c = b + q[BUCKET];
    const flat boom_com = turned(a, 2.620, 0.590), arm_com = turned(b, 0.950, 0.207),
               bucket_com = turned(c, 0.564, 0.364), arm_pin = turned(a, 5.648, 0),
               bucket_pin = turned(b, 2.889, 0);
    const double bucket_load = G * 660 * bucket_com.x,
                 arm_load = G * (1010 * arm_com.x + 660 * (bucket_pin.x + bucket_com.x)),
                 boom_load = G * (2310 * boom_com.x + 1010 * (arm_pin.x + arm_com.x) +
                                  660 * (arm_pin.x + bucket_pin.x + bucket_com.x));

    const flat boom_root = {0.462, -0.603}, boom_eye = turned(a, 2.2342, 0.9507);
    force[BOOM] = -boom_load / fabs(arm_of(boom_eye, towards(boom_root, boom_eye)));

    /* About the arm pin. */
    const flat in_boom = turned(a, 3.2903 - 5.648, 0.8581), arm_eye = turned(b, -0.8624, -0.1356);
    force[ARM] = -arm_load / fabs(arm_of(arm_eye, towards(in_boom, arm_eye)));

    /* About the bucket pin: the rod eye is where circles of the two bars meet, above the line of their
     * pivots. */
    const flat root = turned(b, 0.5406 - 2.889, 0.5567), p = turned(b, 2.4588 - 2.889, 0.0872),
               k = turned(c, -0.2036, 0.4225);
    const double apart = hypot(k.x - p.x, k.z - p.z),
                 along = (apart * apart + 0.579 * 0.579 - 0.561 * 0.561) / (2 * apart),
                 up = sqrt(0.579 * 0.579 - along * along);
    const flat u = towards(p, k);
    flat eye = {p.x + along * u.x - up * u.z, p.z + along * u.z + up * u.x};
    const flat in_arm = turned(-b, eye.x, eye.z), k_arm = turned(-b, k.x, k.z), p_arm = turned(-b, p.x, p.z);
    const double over =
        (k_arm.x - p_arm.x) * (in_arm.z - p_arm.z) - (k_arm.z - p_arm.z) * (in_arm.x - p_arm.x);
    assert_true(over > 0);
    /* Balance at the eye: push cylinder + along bar 1 + along bar 2 = 0. Bar 2 then pushes the bucket. */
    const flat push = towards(root, eye), one = towards(p, eye), two = towards(k, eye);
    const double det = one.x * two.z - one.z * two.x,
                 in_two =
                     (one.x * -push.z - one.z * -push.x) / det; /* bar 2's force on the eye, along `two` */
    const double arm = arm_of(k, two) * -in_two; /* on the bucket, for each newton of the cylinder */
    force[BUCKET] = -bucket_load / fabs(arm);
}

static void test_statics(void **unused)
{
    static const double pose[10][JOINTS] = {
        {0, -0.6, 1.6, 0.5},   {0, -1.1, 2.6, 2.3},    {0, 0.7, 0.6, -0.6},  {0, 0, 1.0, 0},
        {0, -0.9, 0.7, -0.3},  {0.7, -0.3, 2.0, 1.0},  {2.0, 0.3, 1.3, 1.5}, {-1.5, -0.7, 1.9, 2.0},
        {3.0, -1.0, 1.2, 0.2}, {-0.4, -0.45, 2.4, 0.1}};
    td_robot *robot = zx200();
    td_machine_options options = td_machine_options_default(robot);
    options.base = TD_MACHINE_FIXED;
    td_machine *machine = machine_of(robot, &options);
    double worst = 0;
    (void)unused;
    for (int i = 0; i < 10; i++) {
        double hand[JOINTS];
        put(machine, pose[i][0], pose[i][1], pose[i][2], pose[i][3]);
        const td_plant_state s = read_state(machine);
        by_hand(hand, pose[i]);
        for (int k = BOOM; k < JOINTS; k++) {
            check_near(s.force[k], hand[k], 1e-6 * fabs(hand[k]));
            worst = fmax(worst, fabs(s.force[k] / hand[k] - 1));
        }
        check_near(s.force[SWING], 0, 1e-6);
        /* The integrator finds nothing to do. */
        step(machine, 2);
        const td_plant_state later = read_state(machine);
        for (int k = 0; k < JOINTS; k++) check_near(later.q[k], s.q[k], 1e-9);
    }
    printf("statics: forces by hand to %.1e\n", worst);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

static void test_sag(void **unused)
{
    td_robot *robot = zx200();
    td_machine *machine = machine_of(robot, NULL);
    double mass = 0;
    (void)unused;
    for (int i = 0; i < robot->link_count; i++) mass += robot->link[i].mass_kg;
    put(machine, 0.4, -0.6, 1.6, 0.5);
    td_plant_state s = read_state(machine);
    printf("sag %.3f mm of %.0f kg\n", -1e3 * s.site_from_vehicle.t[2], mass);
    check_near(s.site_from_vehicle.t[2], -mass * G / 1.3e7, 1e-9);
    check_near(s.site_from_vehicle.t[2], -0.015, 0.001);
    const td_pose before = s.site_from_vehicle;
    step(machine, 10);
    s = read_state(machine);
    for (int i = 0; i < 3; i++) check_near(s.site_from_vehicle.t[i], before.t[i], 1e-8);
    for (int i = 0; i < 4; i++) check_near(s.site_from_vehicle.q[i], before.q[i], 1e-8);

    /* Let go above its rest, it swings 4 Hz: half a period later it is below. */
    s.site_from_vehicle.t[2] += 0.01;
    td_error error = {0};
    check_ok(td_machine_reset(machine, &s, &error), error);
    const double low = before.t[2];
    step(machine, 0.125);
    check_less(read_state(machine).site_from_vehicle.t[2], low);
    step(machine, 10);
    check_near(read_state(machine).site_from_vehicle.t[2], low, 1e-5);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

/* ---- what is conserved ---- */

static td_machine_options lossless(const td_robot *robot)
{
    td_machine_options o = td_machine_options_default(robot);
    memset(o.viscous, 0, sizeof o.viscous);
    memset(o.coulomb, 0, sizeof o.coulomb);
    o.stop_damping = 0;
    o.oil_s = 0;
    o.suspension = 0;
    o.integrator.relative = 1e-12;
    return o;
}

/* Largest drift of energy over the largest kinetic energy met. */
static double drift(td_machine *machine, double duration, int pieces)
{
    const double begun = td_machine_energies(machine).total;
    double most = 0, kinetic = 0;
    for (int i = 0; i < pieces; i++) {
        step(machine, duration / pieces);
        const td_machine_energy e = td_machine_energies(machine);
        most = fmax(most, fabs(e.total - begun));
        kinetic = fmax(kinetic, e.kinetic);
    }
    return most / kinetic;
}

static void test_floating(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = lossless(robot);
    o.base = TD_MACHINE_FLOATING;
    o.hydraulics = false;
    o.gravity[2] = 0;
    td_machine *machine = machine_of(robot, &o);
    td_plant_state s = read_state(machine);
    td_error error = {0};
    const double q[JOINTS] = {0.3, -0.5, 1.6, 0.8}, dq[JOINTS] = {0.3, -0.02, 0.05, 0.1},
                 twist[6] = {0.02, -0.03, -0.1, 0.2, 0.1, -0.05};
    (void)unused;
    memcpy(s.q, q, sizeof q);
    memcpy(s.dq, dq, sizeof dq);
    memcpy(s.twist, twist, sizeof twist);
    check_ok(td_machine_reset(machine, &s, &error), error);
    double p[2][3], h[2][3], most = 0, size = 0, turn = 0;
    td_machine_momentum(p[0], h[0], machine);
    const double lost = drift(machine, 60, 60);
    td_machine_momentum(p[1], h[1], machine);
    for (int i = 0; i < 3; i++) {
        most = fmax(most, fabs(p[1][i] - p[0][i]));
        size = fmax(size, fabs(p[0][i]));
        turn = fmax(turn, fabs(h[1][i] - h[0][i]) / 1e4);
    }
    size_t events = 0;
    td_machine_events(machine, &events);
    printf(
        "floating, 60 s at 1e-12: energy drifts %.1e, momentum %.1e, angular %.1e; %zu stops met or left\n",
        lost, most / size, turn, events);
    check_less(lost, 1e-8);
    check_less(most / size, 1e-8);
    check_less(turn, 1e-8);
    assert_true(events > 0); /* elastic stops are in it */
    td_machine_free(&machine);
    td_robot_free(&robot);
}

/* Gravity, the suspension's springs and the shut-in oil give back what they take. */
static void test_springs(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = lossless(robot);
    td_machine *machine = machine_of(robot, &o);
    td_error error = {0};
    (void)unused;
    put(machine, 0.5, -0.5, 1.6, 0.8);
    td_plant_state s = read_state(machine);
    s.dq[SWING] = 0.01; /* no relief valve opens */
    s.dq[BOOM] = -0.1;
    s.dq[BUCKET] = 0.1;
    s.twist[1] = 0.05;
    s.twist[5] = 0.1;
    check_ok(td_machine_reset(machine, &s, &error), error);
    const double lost = drift(machine, 5, 20);
    printf("springs, 5 s at 1e-12: energy drifts %.1e\n", lost);
    check_less(lost, 1e-8);
    td_machine_free(&machine);

    /* The fixed base: a pendulum of three, from rest. */
    o.base = TD_MACHINE_FIXED;
    o.hydraulics = false;
    machine = machine_of(robot, &o);
    put(machine, 0, -0.6, 1.6, 0.8);
    const double fixed = drift(machine, 10, 40);
    printf("fixed base, 10 s at 1e-12: energy drifts %.1e\n", fixed);
    check_less(fixed, 1e-8);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

/* ---- hydraulics ---- */

static void test_flow(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    o.base = TD_MACHINE_FIXED;
    o.oil_n_m = 1e10; /* the oil's own motion is not looked at */
    td_machine *machine = machine_of(robot, &o);
    const double bore = 2 * PI / 4 * 0.120 * 0.120, ring = bore - 2 * PI / 4 * 0.085 * 0.085;
    (void)unused;
    for (int up = 0; up < 2; up++) {
        const double flow = 2e-3, area = up ? bore : ring; /* raising pushes, and the angle falls */
        double x[2], lever[2];
        put(machine, 0, -0.4, 1.6, 0.5);
        command(machine, TD_COMMAND_FLOW, 0, up ? -flow : flow, 0, 0);
        step(machine, 2);
        td_plant_state s = read_state(machine);
        assert_true(td_cylinder_length(x, lever, robot, robot->cylinder, s.q[BOOM]));
        const double speed = up ? flow / area : -flow / area;
        check_near(s.dq[BOOM], speed / lever[0], 2e-3 * fabs(speed / lever[0]));
        check_near(s.flow[BOOM], up ? -flow : flow, 1e-9);
        step(machine, 1);
        s = read_state(machine);
        assert_true(td_cylinder_length(x + 1, lever + 1, robot, robot->cylinder, s.q[BOOM]));
        /* 100 kN more or less on 1e10 N/m are 0.01 mm. */
        check_near(x[1] - x[0], speed, 2e-5);
    }
    /* A rate goes through the lever as it stands. */
    put(machine, 0, -0.4, 1.6, 0.5);
    command(machine, TD_COMMAND_RATE, 0.1, 0.1, -0.1, 0.2);
    step(machine, 2);
    const td_plant_state s = read_state(machine);
    const double want[JOINTS] = {0.1, 0.1, -0.1, 0.2};
    /* The four-bar's lever changes while the valve lags. */
    for (int k = 0; k < JOINTS; k++)
        check_near(s.dq[k], want[k], (k == BUCKET ? 5e-3 : 2e-3) * fabs(want[k]));
    td_machine_free(&machine);
    td_robot_free(&robot);
}

static void test_force(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    td_machine *machine = machine_of(robot, &o);
    (void)unused;
    put(machine, 0, -0.6, 1.6, 0.5);
    const td_plant_state rest = read_state(machine);
    /* Three tenths more than gravity asks for lift the boom; the lag is the valve's. */
    command(machine, TD_COMMAND_FORCE, 0, 1.3 * rest.force[BOOM], rest.force[ARM], rest.force[BUCKET]);
    step(machine, o.valve_s);
    td_plant_state s = read_state(machine);
    check_near(s.force[BOOM], rest.force[BOOM] * (1.3 - 0.3 * exp(-1)), 1e-4 * fabs(rest.force[BOOM]));
    step(machine, 0.5);
    s = read_state(machine);
    check_near(s.force[BOOM], 1.3 * rest.force[BOOM], 1e-4 * fabs(rest.force[BOOM]));
    check_less(s.q[BOOM], rest.q[BOOM] - 0.005);
    check_near(s.pressure[BOOM] * 2 * PI / 4 * 0.120 * 0.120, s.force[BOOM], 1); /* it pushes */
    td_machine_free(&machine);
    td_robot_free(&robot);
}

static void test_limits(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    td_machine *machine = machine_of(robot, &o);
    const td_cylinder *c = robot->cylinder;
    const double push = c->pressure_pa * 2 * PI / 4 * 0.120 * 0.120;
    double highest = 0, furthest = 0;
    (void)unused;
    check_near(push, 776e3, 1e3);
    put(machine, 0, -0.9, 1.6, 0.5);
    command(machine, TD_COMMAND_FLOW, 0, -c->flow_m3_s, 0, 0);
    for (int i = 0; i < 400; i++) {
        step(machine, 0.01);
        const td_plant_state s = read_state(machine);
        highest = fmax(highest, fabs(s.force[BOOM]));
        furthest = fmax(furthest, robot->joint[BOOM].lower - s.q[BOOM]);
    }
    const td_plant_state s = read_state(machine);
    size_t count = 0;
    const td_machine_event *event = td_machine_events(machine, &count);
    printf("against the stop: %.1f of %.1f kN, %.2f mrad past it, %zu events\n", 1e-3 * highest, 1e-3 * push,
           1e3 * furthest, count);
    check_less(highest, push * (1 + 1e-9));
    check_less(0.97 * push, fabs(s.force[BOOM]));
    check_less(furthest, 3e-3);
    assert_true(s.at_stop[BOOM] && !s.at_stop[ARM]);
    assert_true(count > 0 && event[0].joint == BOOM && !event[0].upper && event[0].met);

    /* All three at their full flow share the pumps; a motor has its own. */
    put(machine, 0, -0.3, 1.6, 0.8);
    command(machine, TD_COMMAND_FLOW, 0.3, -7.07e-3, -7.07e-3, -7.07e-3);
    step(machine, 0.5);
    const td_plant_state shared = read_state(machine);
    for (int k = BOOM; k < JOINTS; k++) check_near(shared.flow[k], -7.07e-3 / 3, 1e-6);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

/* ---- refusals ---- */

static void test_refusals(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    td_machine *machine = machine_of(robot, &o), *none = NULL;
    td_error error = {0};
    td_plant_state s = read_state(machine);
    (void)unused;
    s.q[BOOM] = -1.3;
    check_fails(td_machine_reset(machine, &s, &error), TD_ERROR_ARGUMENT, error,
                "'boom' at -1.3 starts beyond");
    s.q[BOOM] = NAN;
    check_fails(td_machine_reset(machine, &s, &error), TD_ERROR_ARGUMENT, error, "position of joint 'boom'");
    s.q[BOOM] = -0.5;
    s.dq[ARM] = INFINITY;
    check_fails(td_machine_reset(machine, &s, &error), TD_ERROR_ARGUMENT, error, "rate of joint 'arm'");
    s.dq[ARM] = 0;
    s.twist[3] = NAN;
    check_fails(td_machine_reset(machine, &s, &error), TD_ERROR_ARGUMENT, error, "its base");
    s.twist[3] = 0;
    s.force[BUCKET] = 1e6;
    check_fails(td_machine_reset(machine, &s, &error), TD_ERROR_ARGUMENT, error,
                "'bucket' starts with a force");

    td_plant_command c = {.kind = TD_COMMAND_FLOW, .value = {0, 0, 0.01, 0}};
    check_fails(td_machine_command(machine, &c, NULL, &error), TD_ERROR_ARGUMENT, error,
                "joint 'arm': a flow of");
    c = (td_plant_command){.kind = TD_COMMAND_RATE, .value = {0, -0.5, 0, 0}};
    check_fails(td_machine_command(machine, &c, NULL, &error), TD_ERROR_ARGUMENT, error, "limit of -0.45");
    c = (td_plant_command){.kind = TD_COMMAND_FORCE, .value = {1e5, 0, 0, 0}};
    check_fails(td_machine_command(machine, &c, NULL, &error), TD_ERROR_ARGUMENT, error,
                "a torque of 100000");
    c.value[0] = NAN;
    check_fails(td_machine_command(machine, &c, NULL, &error), TD_ERROR_ARGUMENT, error, "no number");
    check_fails(td_machine_step(machine, -1, &error), TD_ERROR_ARGUMENT, error, "-1 s");

    o.oil_n_m = NAN;
    check_fails(td_machine_new(&none, robot, &o, NULL, &error), TD_ERROR_ARGUMENT, error, "oil's stiffness");
    o = td_machine_options_default(robot);
    o.coulomb[ARM] = -1;
    check_fails(td_machine_new(&none, robot, &o, NULL, &error), TD_ERROR_ARGUMENT, error, "of joint 'arm'");
    o = td_machine_options_default(robot);
    robot->suspension_n_m[1] = 0;
    check_fails(td_machine_new(&none, robot, &o, NULL, &error), TD_ERROR_ARGUMENT, error, "pitch");
    assert_null(none);
    /* What was refused has changed nothing. */
    const double z = read_state(machine).site_from_vehicle.t[2];
    step(machine, 1);
    check_near(read_state(machine).site_from_vehicle.t[2], z, 1e-6);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

static void test_mass(void **unused)
{
    td_robot *robot = zx200();
    td_machine *machine = machine_of(robot, NULL);
    td_error error = {0};
    (void)unused;
    td_machine *weak = NULL;
    td_robot light = *robot;
    light.link[light.joint[BUCKET].link].mass_kg = 0;
    memset(light.link[light.joint[BUCKET].link].inertia, 0, sizeof light.link[0].inertia);
    check_fails(td_machine_new(&weak, &light, NULL, NULL, &error), TD_ERROR_DATA, error,
                "link 'bucket' and what it carries have no inertia about joint 'bucket'");
    assert_null(weak);
    robot->cylinder[0].pressure_pa = 5e6;
    check_ok(td_machine_new(&weak, robot, NULL, NULL, &error), error);
    check_fails(td_machine_settle(weak, &error), TD_ERROR_DATA, error, "'boom' cannot be held");
    td_machine_free(&weak);
    td_machine_free(&machine);
    td_robot_free(&robot);
}

/* ---- its Jacobian ---- */

/* Against central differences of the rate, column by column, as a share of the column's largest entry in
 * units in which the states are of size 1. */
static double jacobian_apart(td_machine *machine, const double *y, double t)
{
    const td_ode *ode = td_machine_ode(machine);
    const size_t n = ode->size;
    double *j = calloc(n * n, sizeof *j), *at = calloc(4 * n, sizeof *at), worst = 0;
    double *dy = at + n, *ahead = at + 2 * n, *behind = at + 3 * n;
    assert_true(j && at && ode->rate(dy, t, y, ode->user) && ode->jacobian(j, t, y, dy, ode->user));
    for (size_t c = 0; c < n; c++) {
        double largest = 0, most = 0;
        const double width = 1e-6 * fmax(1e-1, fabs(y[c]));
        memcpy(at, y, n * sizeof *y);
        at[c] = y[c] + width;
        assert_true(ode->rate(ahead, t, at, ode->user));
        at[c] = y[c] - width;
        assert_true(ode->rate(behind, t, at, ode->user));
        for (size_t i = 0; i < n; i++) {
            const double scale = i >= n - 8 && i < n - 4 ? 1e8 : 1; /* forces */
            const double difference = (ahead[i] - behind[i]) / (2 * width);
            most = fmax(most, fabs(difference - j[i * n + c]) / scale);
            largest = fmax(largest, fabs(difference) / scale);
        }
        worst = fmax(worst, largest > 0 ? most / largest : most);
    }
    free(j);
    free(at);
    return worst;
}

/* The bucket's tip 2 mm deep in a plane aslant, moving. */
static void press_tip(td_machine *machine, const td_robot *robot)
{
    const td_plant_state s = read_state(machine);
    td_machine_contact c = td_machine_contact_default();
    td_pose link[TD_ROBOT_MAX_LINKS];
    double tip[3], force[3];
    td_error error = {0};
    c.link = td_robot_find_link(robot, "bucket_tip");
    c.point_m[0] = 0.1;
    c.normal[0] = 0.3;
    c.normal[1] = -0.2;
    td_robot_forward(link, robot, s.q);
    td_pose_transform(tip, link + c.link, c.point_m);
    td_pose_transform(c.plane_m, &s.site_from_vehicle, tip);
    c.plane_m[2] += 2e-3 * sqrt(1.13); /* above the tip, along the normal: 2 mm */
    check_ok(td_machine_touch(machine, &c, &error), error);
    check_near(td_machine_contact_force(force, machine), -2e-3, 1e-9);
}

static void test_jacobian(void **unused)
{
    td_robot *robot = zx200();
    (void)unused;
    for (int kind = 0; kind < 15; kind++) {
        td_machine_options o = td_machine_options_default(robot);
        o.base = (td_machine_base)(kind % 3);
        o.coriolis = kind != 3;
        o.hydraulics = kind != 4;
        td_machine *machine = machine_of(robot, &o);
        td_plant_state s = read_state(machine);
        td_error error = {0};
        const double q[JOINTS] = {0.5, -0.4, 1.3, 0.6};
        const double xi[6] = {0.02, -0.03, 0.05, 0.01, -0.02, -0.015};
        const td_pose moved = td_pose_exp(xi);
        s.site_from_vehicle = td_pose_compose(&moved, &s.site_from_vehicle);
        memcpy(s.q, q, sizeof q);
        for (int k = 0; k < JOINTS; k++) s.dq[k] = 0.1 - 0.07 * k, s.force[k] = -2e4 * (k + 1);
        s.force[BOOM] = kind == 6 ? -7.6e5 : s.force[BOOM]; /* its relief valve is open */
        for (int i = 0; i < 6; i++) s.twist[i] = 0.05 * i - 0.1;
        check_ok(td_machine_reset(machine, &s, &error), error);
        if (kind != 4)
            command(machine,
                    kind == 5   ? TD_COMMAND_FORCE
                    : kind == 7 ? TD_COMMAND_FLOW
                                : TD_COMMAND_RATE,
                    0.1, kind == 7 ? 1e-3 : 0.1, kind == 7 ? 1e-3 : -0.05, kind == 7 ? -1e-3 : 0.05);
        if (kind >= 12) press_tip(machine, robot);
        double y[64];
        memcpy(y, td_machine_values(machine), td_machine_size(machine) * sizeof *y);
        const size_t n = td_machine_size(machine), at = o.base == TD_MACHINE_FIXED ? 0 : 7;
        for (size_t k = 0; k < JOINTS; k++) y[n - JOINTS + k] = 0.03 * (double)k - 0.02;
        if (kind == 8) y[at + ARM] = 0.594 - 1e-3; /* past a stop */
        if (at) y[0] *= 1.1;                       /* the quaternion need not be of length 1 */
        check_less(jacobian_apart(machine, y, 0), 1e-5);
        td_machine_free(&machine);
    }
    td_robot_free(&robot);
}

/* ---- the same again ---- */

/* 3 s of a ramp up, a hold and a ramp down, in `pieces` steps each. */
static td_plant_state manoeuvre(const td_robot *robot, const td_machine_options *o, int pieces,
                                td_integrator_counters *counters)
{
    static const double rate[JOINTS] = {0.2, -0.1, 0.2, 0.3};
    td_machine *machine = machine_of(robot, o);
    td_error error = {0};
    put(machine, 0, -0.6, 1.6, 0.5);
    for (int phase = 0; phase < 3; phase++) {
        td_plant_command c = {.kind = TD_COMMAND_RATE};
        double slope[JOINTS] = {0};
        for (int k = 0; k < JOINTS; k++) {
            c.value[k] = phase ? rate[k] : 0;
            slope[k] = phase == 1 ? 0 : phase ? -rate[k] : rate[k];
        }
        check_ok(td_machine_command(machine, &c, slope, &error), error);
        for (int i = 0; i < pieces; i++) step(machine, 1.0 / pieces);
    }
    const td_plant_state s = read_state(machine);
    if (counters) *counters = td_machine_count(machine);
    td_machine_free(&machine);
    return s;
}

static double apart(const td_plant_state *a, const td_plant_state *b)
{
    double most = 0;
    for (int k = 0; k < JOINTS; k++) most = fmax(most, fabs(a->q[k] - b->q[k]));
    for (int i = 0; i < 3; i++)
        most = fmax(most, fabs(a->site_from_vehicle.t[i] - b->site_from_vehicle.t[i]));
    return most;
}

static void test_same_again(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    td_integrator_counters counters;
    (void)unused;
    const td_plant_state once = manoeuvre(robot, &o, 1, &counters), again = manoeuvre(robot, &o, 1, NULL),
                         often = manoeuvre(robot, &o, 64, NULL); /* 1/64 s adds up exactly */
    assert_memory_equal(&once, &again, sizeof once);
    check_near(apart(&once, &often), 0, 0);
    assert_true(counters.rates > 0 && counters.steps > 0);
    o.integrator.relative /= 2;
    const td_plant_state finer = manoeuvre(robot, &o, 1, NULL);
    o.integrator.relative = 1e-10;
    const td_plant_state finest = manoeuvre(robot, &o, 1, NULL);
    printf("1e-6 against half of it: %.1e, against 1e-10: %.1e rad or m\n", apart(&once, &finer),
           apart(&once, &finest));
    check_less(apart(&once, &finer), 3e-6);
    check_less(apart(&once, &finest), 3e-6);
    for (int method = TD_INTEGRATOR_ADAMS; method <= TD_INTEGRATOR_BDF; method++) {
        o = td_machine_options_default(robot);
        o.integrator.method = (td_integrator_method)method;
        const td_plant_state other = manoeuvre(robot, &o, 1, NULL);
        check_less(apart(&other, &finest), 3e-6);
    }
    td_robot_free(&robot);
}

/* A robot that the build has no code for: a microgram more makes it another. */
static void test_other_robot(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    o.integrator.relative = 1e-9;
    (void)unused;
    const td_plant_state built_in = manoeuvre(robot, &o, 1, NULL);
    robot->link[robot->joint[BUCKET].link].mass_kg += 1e-9;
    const td_plant_state evaluated = manoeuvre(robot, &o, 1, NULL);
    printf("without generated code: %.1e rad or m apart\n", apart(&built_in, &evaluated));
    check_less(apart(&built_in, &evaluated), 1e-8);
    td_robot_free(&robot);
}

/* Through core/plant.h it is the same machine; Coriolis terms can be left out. */
static void test_plant(void **unused)
{
    td_robot *robot = zx200();
    td_machine_options o = td_machine_options_default(robot);
    td_error error = {0};
    td_plant_state end[2], begin;
    (void)unused;
    for (int coriolis = 0; coriolis < 2; coriolis++) {
        o.coriolis = coriolis;
        td_machine *machine = machine_of(robot, &o);
        put(machine, 0, -0.6, 1.6, 0.5);
        td_plant plant = td_machine_plant(machine);
        const td_plant_command c = {.kind = TD_COMMAND_RATE, .value = {0.8, 0, 0, 0.5}};
        check_ok(plant.state(plant.self, &begin, &error), error);
        check_ok(plant.reset(plant.self, &begin, &error), error);
        check_ok(plant.command(plant.self, &c, &error), error);
        for (int i = 0; i < 20; i++) check_ok(plant.step(plant.self, 0.05, &error), error);
        check_ok(plant.state(plant.self, &end[coriolis], &error), error);
        check_near(end[coriolis].time_s, 1, 1e-12);
        assert_string_equal(plant.robot->joint[ARM].name, "arm");
        char name[TD_NAME_SIZE + 16];
        td_machine_state_name(name, machine, 7 + ARM);
        assert_string_equal(name, "arm angle");
        td_machine_state_name(name, machine, td_machine_size(machine) - 1);
        assert_string_equal(name, "bucket valve");
        plant.free(plant.self);
    }
    const double difference = apart(end, end + 1);
    printf("Coriolis left out: %.1e rad or m after 1 s\n", difference);
    check_less(1e-8, difference);
    check_less(difference, 1e-2);
    td_robot_free(&robot);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_statics),    cmocka_unit_test(test_sag),
        cmocka_unit_test(test_floating),   cmocka_unit_test(test_springs),
        cmocka_unit_test(test_flow),       cmocka_unit_test(test_force),
        cmocka_unit_test(test_limits),     cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_mass),       cmocka_unit_test(test_jacobian),
        cmocka_unit_test(test_same_again), cmocka_unit_test(test_other_robot),
        cmocka_unit_test(test_plant),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
