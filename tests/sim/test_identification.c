/* Identification and excitation, sim/identification and sim/excitation.
 *
 * Exactness: forces from td_dynamics_inverse (checked against KDL in test_dynamics) of a robot whose
 * inertias differ from the prior's, at random states, give back that robot's base parameters to 1e-8 of their
 * size: the regressor, its grouping into base parameters and the levers, over random robots with prismatic,
 * branching and fixed links, too. Statistics: logs simulated by sim/machine, with masses, centres and
 * frictions drawn anew for each, its base held and on its suspension, white noise on all that is measured:
 * parameters said to be told are within 3 sigma of the truth in at least 97 % (of normal errors 99.7 % are),
 * and the ratio of errors to sigmas is within the two-sided 99.9 % bound for the count of logs (its
 * parameters are correlated, so a log counts as one draw of its mean square, whose spread is measured).
 * TELEDIMOS_FULL=1: 200 logs of each base. One joint moves: what it cannot tell is named. The proposed motion
 * keeps its limits and tells more than the paper's manoeuvre, by sigma and condition. Refusals by their
 * words.
 *
 * Blind to: forces with errors other than white noise, friction of another shape than the machine's. */
#include "tests/check.h"

#include "core/linalg.h"
#include "sim/excitation.h"
#include "sim/identification.h"
#include "sim/machine.h"
#include "tests/sim/dynamics_robots.h"

enum { JOINTS = 4, MOST = 512 };

static td_robot *zx200(void)
{
    td_robot *robot = NULL;
    td_error error = {0};
    check_ok(td_robot_read(&robot, ZX200, &error), error);
    return robot;
}

/* ---- logs ---- */

typedef struct record {
    size_t count;
    double *time, *q, *dq, *ddq, *force, *base;
} record;

static record new_record(size_t count, int joints)
{
    const size_t values = count * (size_t)joints;
    record r = {.count = count};
    r.time = calloc(count + 4 * values + 6 * count, sizeof *r.time);
    assert_non_null(r.time);
    r.q = r.time + count, r.dq = r.q + values, r.ddq = r.dq + values, r.force = r.ddq + values;
    r.base = r.force + values;
    return r;
}

static td_motion_log log_of(const record *r, bool base)
{
    return (td_motion_log){.count = r->count,
                           .time_s = r->time,
                           .position = r->q,
                           .rate = r->dq,
                           .force = r->force,
                           .base = base ? r->base : NULL};
}

/* Another robot of the same joints: masses to 30 %, centres of mass to 10 cm. */
static void change(td_robot *robot, td_random *random)
{
    for (int i = 0; i < robot->link_count; i++) {
        td_robot_link *link = robot->link + i;
        const double by = 0.7 + 0.6 * td_random_uniform(random);
        link->mass_kg *= by;
        for (int k = 0; k < 9; k++) link->inertia[k] *= by;
        for (int k = 0; k < 3 && link->mass_kg > 0; k++) link->com_m[k] += 0.1 * td_random_normal(random);
    }
}

static void keep(record *r, size_t i, const td_plant_state *s)
{
    double m[9];
    td_pose_rotation(m, &s->site_from_vehicle);
    r->time[i] = s->time_s;
    for (int k = 0; k < JOINTS; k++) {
        r->q[i * JOINTS + (size_t)k] = s->q[k];
        r->dq[i * JOINTS + (size_t)k] = s->dq[k];
        r->force[i * JOINTS + (size_t)k] = s->force[k];
    }
    memcpy(r->base + 6 * i, s->site_from_vehicle.t, 3 * sizeof *r->base);
    r->base[6 * i + 3] = atan2(m[7], m[8]);
    r->base[6 * i + 4] = atan2(-m[6], hypot(m[7], m[8]));
    r->base[6 * i + 5] = atan2(m[3], m[0]);
}

/* The machine moved along a motion, read every 20 ms. */
static record simulated(const td_robot *robot, const td_machine_options *options, const td_excitation *e)
{
    const double dt = 0.02;
    td_machine *machine = NULL;
    td_error error = {0};
    td_plant_state s;
    record r = new_record((size_t)(e->duration_s / dt + 0.5) + 1, JOINTS);
    check_ok(td_machine_new(&machine, robot, options, NULL, &error), error);
    td_machine_state(machine, &s);
    memcpy(s.q, e->start, JOINTS * sizeof *s.q);
    check_ok(td_machine_reset(machine, &s, &error), error);
    check_ok(td_machine_settle(machine, &error), error);
    for (size_t i = 0; i < r.count; i++) {
        td_plant_command c = {.kind = TD_COMMAND_RATE};
        double next[JOINTS], slope[JOINTS];
        td_machine_state(machine, &s);
        keep(&r, i, &s);
        td_excitation_at(NULL, c.value, NULL, e, dt * (double)i);
        td_excitation_at(NULL, next, NULL, e, dt * (double)(i + 1));
        for (int k = 0; k < JOINTS; k++) slope[k] = (next[k] - c.value[k]) / dt;
        check_ok(td_machine_command(machine, &c, slope, &error), error);
        check_ok(td_machine_step(machine, dt, &error), error);
    }
    td_machine_free(&machine);
    return r;
}

static void add_noise(record *r, td_random *random)
{
    for (size_t i = 0; i < r->count * JOINTS; i++) {
        r->q[i] += 5e-4 * td_random_normal(random);
        r->dq[i] += 2e-3 * td_random_normal(random);
        r->force[i] += (i % JOINTS == 0 ? 500 : 2000) * td_random_normal(random);
    }
    for (size_t i = 0; i < 6 * r->count; i++)
        r->base[i] += (i % 6 < 3 ? 3e-4 : 2e-4) * td_random_normal(random);
}

static td_identification *identify(const td_motion_log *log, const td_robot *robot,
                                   const td_identification_options *options)
{
    td_identification *id = NULL;
    td_error error = {0};
    check_ok(td_identify(&id, log, robot, options, &error), error);
    return id;
}

/* ---- without noise ---- */

static void exact_once(const td_robot *robot, uint64_t seed, bool cylinders)
{
    td_random random = td_random_seed(seed, 5);
    td_robot *truth = malloc(sizeof *truth);
    assert_non_null(truth);
    *truth = *robot;
    change(truth, &random);
    td_identification_options o = td_identification_options_default(robot);
    const int n = robot->joint_count;
    double viscous[TD_ROBOT_MAX_JOINTS], coulomb[TD_ROBOT_MAX_JOINTS], right[MOST];
    for (int k = 0; k < n; k++) viscous[k] = 50 * (1 + td_random_uniform(&random)), coulomb[k] = 20 + k;
    o.site_from_vehicle = td_pose_exp((const double[6]){0.1, -0.2, 0.3, 1, 2, 3});
    td_dynamics *dynamics = NULL;
    td_error error = {0};
    check_ok(td_dynamics_new(&dynamics, truth, &error), error);
    record r = new_record(400, n);
    for (size_t i = 0; i < r.count; i++) {
        double nu[TD_DYNAMICS_MAX] = {0}, a[TD_DYNAMICS_MAX] = {0}, f[TD_DYNAMICS_MAX], gravity[3];
        const td_pose back = td_pose_inverse(&o.site_from_vehicle);
        td_pose_rotate(gravity, &back, o.gravity);
        r.time[i] = 0.01 * (double)i;
        double *q = r.q + i * (size_t)n;
        for (int k = 0; k < n; k++) {
            const td_robot_joint *j = robot->joint + k;
            q[k] = cylinders && isfinite(j->lower)
                       ? j->lower + (j->upper - j->lower) * (0.01 + 0.98 * td_random_uniform(&random))
                       : 2 * spread(&random);
            nu[6 + k] = r.dq[i * (size_t)n + (size_t)k] = spread(&random);
            a[6 + k] = r.ddq[i * (size_t)n + (size_t)k] = spread(&random);
        }
        td_dynamics_inverse(f, dynamics, q, nu, a, gravity, true);
        for (int k = 0; k < n; k++) {
            double lever = 1;
            for (int c = 0; c < robot->cylinder_count; c++)
                if (robot->cylinder[c].joint == k)
                    td_cylinder_length(NULL, &lever, robot, robot->cylinder + c, q[k]);
            r.force[i * (size_t)n + (size_t)k] =
                (f[6 + k] + viscous[k] * nu[6 + k] + coulomb[k] * tanh(nu[6 + k] / o.slip)) / fabs(lever);
        }
    }
    td_motion_log log = log_of(&r, false);
    log.acceleration = r.ddq;
    td_identification *id = identify(&log, robot, &o);
    assert_true(id->count <= MOST);
    check_ok(td_base_parameters_of(right, robot, false, truth, viscous, coulomb, &o, &error), error);
    for (int a = 0; a < id->count; a++) {
        if (fabs(id->parameter[a].value - right[a]) > 1e-8 * id->parameter[a].size)
            print_message("%s\n", id->parameter[a].means);
        check_near(id->parameter[a].value, right[a], 1e-8 * id->parameter[a].size);
    }
    check_less(id->condition, 1e5);
    td_identification_free(&id);
    td_dynamics_free(&dynamics);
    free(r.time);
    free(truth);
}

static void test_exact(void **unused)
{
    (void)unused;
    td_robot *robot = zx200();
    exact_once(robot, 1, true);
    td_robot_free(&robot);
    for (uint64_t seed = 1; seed <= 6; seed++) {
        td_robot *other =
            random_robot(seed, (robot_kind){.joints = 5, .prismatic = 0.3, .branch = 0.3, .fixed = 0.2});
        for (int k = 0; k < other->joint_count; k++) {
            td_robot_joint *j = other->joint + k;
            j->lower = -INFINITY, j->upper = j->speed = j->acceleration = j->effort = INFINITY;
        }
        exact_once(other, seed, false);
        free(other);
    }
}

/* ---- with noise ---- */

typedef struct tally {
    size_t told, within, logs, parameters;
    double square, square_of_squares; /* of each log's mean square error in sigmas */
} tally;

static void noisy_log(tally *t, const td_robot *robot, bool suspended, uint64_t seed)
{
    td_random random = td_random_seed(seed, 8 + suspended);
    td_robot *truth = malloc(sizeof *truth);
    td_error error = {0};
    td_excitation e = {0};
    double right[MOST], sum = 0;
    size_t told = 0;
    assert_non_null(truth);
    *truth = *robot;
    change(truth, &random);
    td_excitation_options motion = td_excitation_options_default(robot);
    motion.seed = seed, motion.steps = 20, motion.lowest_m = -INFINITY;
    check_ok(td_excitation_propose(&e, robot, NULL, &motion, NULL, &error), error);
    td_machine_options machine = td_machine_options_default(robot);
    machine.base = suspended ? TD_MACHINE_SUSPENDED : TD_MACHINE_FIXED;
    machine.integrator.relative = 1e-6;
    for (int k = 0; k < JOINTS; k++) {
        machine.viscous[k] *= 0.5 + td_random_uniform(&random);
        machine.coulomb[k] *= 0.5 + td_random_uniform(&random);
    }
    record r = simulated(truth, &machine, &e);
    add_noise(&r, &random);
    const td_motion_log log = log_of(&r, suspended);
    td_identification *id = identify(&log, robot, NULL);
    check_ok(
        td_base_parameters_of(right, robot, suspended, truth, machine.viscous, machine.coulomb, NULL, &error),
        error);
    for (int a = 0; a < id->count; a++) {
        const td_identified *p = id->parameter + a;
        const double z = (p->value - right[a]) / p->sigma;
        if (!p->told) continue;
        told++;
        t->within += fabs(z) <= 3;
        sum += z * z;
    }
    sum /= (double)told;
    t->told += told;
    t->parameters += (size_t)id->count;
    t->logs++;
    t->square += sum;
    t->square_of_squares += sum * sum;
    check_near(id->misfit, 1, 0.1);
    td_identification_free(&id);
    free(r.time);
    free(truth);
}

static void test_noise(void **unused)
{
    const char *full = getenv("TELEDIMOS_FULL");
    const size_t logs = full && strcmp(full, "1") == 0 ? 200 : 2;
    td_robot *robot = zx200();
    (void)unused;
    for (int suspended = 0; suspended < 2; suspended++) {
        tally t = {0};
        for (size_t i = 0; i < logs; i++) noisy_log(&t, robot, suspended, 100 + i);
        const double mean = t.square / (double)t.logs,
                     spread_of = sqrt(fmax(t.square_of_squares / (double)t.logs - mean * mean, 0.05)),
                     bound = 3.29 * spread_of / sqrt((double)t.logs);
        print_message(
            "%s: %zu of %zu told parameters of %zu logs within 3 sigma (%.2f %%), %.1f of %.1f told, "
            "error over sigma %.3f\n",
            suspended ? "suspended" : "held", t.within, t.told, t.logs,
            100 * (double)t.within / (double)t.told, (double)t.told / (double)t.logs,
            (double)t.parameters / (double)t.logs, sqrt(mean));
        assert_true((double)t.within >= 0.97 * (double)t.told);
        assert_true((double)t.told >= 0.6 * (double)t.parameters);
        check_near(mean, 1, bound);
    }
    td_robot_free(&robot);
}

/* ---- what is not told ---- */

static const td_identified *find(const td_identification *id, const char *name)
{
    for (int a = 0; a < id->count; a++)
        if (strcmp(id->parameter[a].name, name) == 0) return id->parameter + a;
    fail_msg("no parameter %s", name);
    return NULL;
}

static bool never(const td_identification *id, const char *name)
{
    for (int i = 0; i < id->never_count; i++)
        if (strcmp(id->never[i], name) == 0) return true;
    return false;
}

static td_identification *of_motion(const td_robot *robot, const td_excitation *e)
{
    td_random random = td_random_seed(3, 3);
    td_machine_options machine = td_machine_options_default(robot);
    machine.base = TD_MACHINE_FIXED;
    record r = simulated(robot, &machine, e);
    add_noise(&r, &random);
    const td_motion_log log = log_of(&r, false);
    td_identification *id = identify(&log, robot, NULL);
    free(r.time);
    return id;
}

static void test_one_joint(void **unused)
{
    td_robot *robot = zx200();
    td_excitation e = {.duration_s = 12, .joints = JOINTS, .start = {0, -0.4, 1.4, 0.2}};
    (void)unused;
    e.sine[3][0] = 0.4, e.sine[3][2] = 0.3;
    td_identification *id = of_motion(robot, &e);
    static const char *const told[] = {"bucket_mass_x", "bucket_mass_z", "bucket_viscous", "bucket_coulomb"};
    static const char *const silent[] = {"boom_viscous", "swing_coulomb", "boom_mass_x", "arm_mass_x",
                                         "arm_inertia_yy"};
    for (size_t i = 0; i < sizeof told / sizeof *told; i++) assert_true(find(id, told[i])->told);
    for (size_t i = 0; i < sizeof silent / sizeof *silent; i++) {
        const td_identified *p = find(id, silent[i]);
        assert_false(p->told);
        check_near(p->value, p->prior, 3 * p->sigma);
        check_near(p->sigma, 10 * p->size, 4 * p->size);
    }
    assert_string_equal(find(id, "boom_mass_x")->means,
                        "mass x of boom + 5.648 mass of arm + 5.648 mass of bucket");
    assert_string_equal(find(id, "boom_mass_x")->unit, "kg m");
    assert_true(never(id, "undercarriage_mass") && never(id, "upper_mass") && !never(id, "bucket_mass"));
    assert_true(id->weak_count > 3 && isinf(id->condition));
    assert_int_equal(id->joint[1].used, 0);
    td_identification_free(&id);
    td_robot_free(&robot);
}

/* ---- a motion that tells more ---- */

static void check_limits(const td_excitation *e, const td_robot *robot)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    for (int i = 0; i <= 2000; i++) {
        double q[JOINTS], rate[JOINTS], acceleration[JOINTS];
        td_excitation_at(q, rate, acceleration, e, e->duration_s * i / 2000);
        assert_true(td_robot_within_limits(robot, q, NULL));
        for (int k = 0; k < JOINTS; k++) {
            check_less(fabs(rate[k]), 0.72 * robot->joint[k].speed);
            check_less(fabs(acceleration[k]), 0.75 * robot->joint[k].acceleration);
            if (i == 0 || i == 2000) check_near(rate[k], 0, 1e-9);
            if (i == 2000) check_near(q[k], e->start[k], 1e-9);
        }
        td_robot_forward(at, robot, q);
        for (int l = 1; l < robot->link_count; l++) check_less(0.45, at[l].t[2]);
    }
}

/* Rows of the paper's manoeuvre are a trapezoid; here its first harmonic, as fast. */
static void test_proposal(void **unused)
{
    td_robot *robot = zx200();
    td_error error = {0};
    td_excitation proposed = {0}, again = {0};
    td_excitation plain = {.duration_s = 20, .joints = JOINTS, .start = {0, -0.4, 1.4, 0.4}};
    static const double fastest[JOINTS] = {0.2, -0.1, 0.15, 0.25};
    (void)unused;
    for (int k = 0; k < JOINTS; k++) plain.sine[k][0] = fastest[k];
    td_excitation_options motion = td_excitation_options_default(robot);
    motion.steps = 200;
    check_ok(td_excitation_propose(&proposed, robot, NULL, &motion, NULL, &error), error);
    check_ok(td_excitation_propose(&again, robot, NULL, &motion, NULL, &error), error);
    assert_memory_equal(&proposed, &again, sizeof proposed);
    check_limits(&proposed, robot);
    td_identification *before = of_motion(robot, &plain), *after = of_motion(robot, &proposed);
    double ratio = 0, widest[2] = {0};
    for (int a = 0; a < after->count; a++) {
        ratio += log(before->parameter[a].sigma / after->parameter[a].sigma) / after->count;
        widest[0] = fmax(widest[0], before->parameter[a].sigma / before->parameter[a].size);
        widest[1] = fmax(widest[1], after->parameter[a].sigma / after->parameter[a].size);
    }
    print_message(
        "sigmas fall to one in %.1f (geometric mean), the widest from %.2f to %.2f of its size, the "
        "condition from %.0f to %.0f\n",
        exp(ratio), widest[0], widest[1], before->condition, after->condition);
    assert_true(exp(ratio) > 3);
    check_less(widest[1], widest[0] / 3);
    check_less(after->condition, before->condition / 3);
    td_identification_free(&before);
    td_identification_free(&after);
    td_robot_free(&robot);
}

/* ---- links ---- */

static void test_links(void **unused)
{
    td_robot *robot = zx200();
    td_error error = {0};
    td_excitation e = {0};
    (void)unused;
    td_excitation_options motion = td_excitation_options_default(robot);
    motion.steps = 20;
    check_ok(td_excitation_propose(&e, robot, NULL, &motion, NULL, &error), error);
    td_identification *id = of_motion(robot, &e);
    assert_int_equal(id->link_count, 5);
    for (int i = 0; i < id->link_count; i++) {
        const double *p = id->link[i].parameter, half = (p[4] + p[7] + p[9]) / 2;
        const double j[16] = {half - p[4], -p[5], -p[6],       p[1], -p[5], half - p[7], -p[8], p[2],
                              -p[6],       -p[8], half - p[9], p[3], p[1],  p[2],        p[3],  p[0]};
        double value[4];
        check_ok(td_eigen_symmetric(value, NULL, j, 4, &error), error);
        check_less(0, value[0]);
        check_near(p[0], robot->link[id->link[i].link].mass_kg, 3 * id->link[i].sigma[0]);
    }
    /* What is identified stays so. */
    const double *boom = id->link[2].parameter, *arm = id->link[3].parameter, *bucket = id->link[4].parameter;
    const td_identified *p = find(id, "boom_mass_x");
    check_near(boom[1] + 5.648 * (arm[0] + bucket[0]), p->value, 2 * p->sigma);
    td_identification_free(&id);
    td_robot_free(&robot);
}

/* ---- refusals ---- */

static void test_bad(void **unused)
{
    td_robot *robot = zx200();
    td_error e = {0};
    td_identification *id = NULL;
    td_excitation x = {.duration_s = 4, .joints = JOINTS, .start = {0, -0.4, 1.4, 0.4}};
    td_machine_options machine = td_machine_options_default(robot);
    (void)unused;
    x.sine[2][0] = 0.2;
    machine.base = TD_MACHINE_FIXED;
    record r = simulated(robot, &machine, &x);
    td_motion_log log = log_of(&r, false), bad = log;
    bad.count = 40;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "40 samples are too few");
    bad = log;
    r.q[50 * JOINTS + 1] = NAN;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "sample 51: the position of boom");
    r.q[50 * JOINTS + 1] = -3;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e,
                "sample 51: boom at -3 is beyond its stops");
    r.q[50 * JOINTS + 1] = -0.4;
    r.time[30] = r.time[29];
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "sample 31: times must rise");
    for (size_t i = 30; i < r.count; i++) r.time[i] += 1;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "a gap of");
    for (size_t i = 30; i < r.count; i++) r.time[i] = 0.02 * (double)i;
    bad.count = 61;
    for (size_t i = 0; i < 61; i++) r.time[i] = 0.001 * (double)i;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "too short");
    for (size_t i = 0; i < 61; i++) r.time[i] = 0.02 * (double)i;
    double *forces = calloc(r.count * JOINTS, sizeof *forces);
    bad = log, bad.force = forces;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_DATA, e, "forces are all 0");
    bad = log, bad.acceleration = r.ddq, bad.base = r.base;
    check_fails(td_identify(&id, &bad, robot, NULL, &e), TD_ERROR_ARGUMENT, e, "stands still");
    for (size_t i = 0; i < r.count * JOINTS; i++) r.q[i] = x.start[i % JOINTS], r.dq[i] = 0;
    check_fails(td_identify(&id, &log, robot, NULL, &e), TD_ERROR_DATA, e, "a motion must be in it");
    td_identification_options o = td_identification_options_default(robot);
    o.slip = 0;
    check_fails(td_identify(&id, &log, robot, &o, &e), TD_ERROR_ARGUMENT, e, "slip");
    td_excitation_options m = td_excitation_options_default(robot);
    m.share = 2;
    check_fails(td_excitation_propose(&x, robot, NULL, &m, NULL, &e), TD_ERROR_ARGUMENT, e, "share");
    m.share = 0.7, m.lowest_m = 50, m.steps = 5;
    check_fails(td_excitation_propose(&x, robot, NULL, &m, NULL, &e), TD_ERROR_DATA, e, "50 m above");
    assert_null(id);
    free(forces);
    free(r.time);
    td_robot_free(&robot);
}

int main(void)
{
    td_linalg_single_thread();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_exact),     cmocka_unit_test(test_noise),
                                       cmocka_unit_test(test_one_joint), cmocka_unit_test(test_proposal),
                                       cmocka_unit_test(test_links),     cmocka_unit_test(test_bad)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
