/* Proves: the end of each standard problem within 10 tolerances, at 1e-4, 1e-6 and 1e-8; exact solutions of
 * linear ones; events at their exact times, in order, also two in a step; switching to BDF and back as the
 * stiffness comes and goes; the same bits however the time is cut into pieces; what cannot be integrated is
 * refused, naming where. Reference: closed forms, and the solutions published with the test set (Mazzia and
 * Magherini 2008: HIRES, Oregonator, van der Pol at mu = 1000). Tolerances: 10 times that asked for; events
 * 1e-7 s, set by the interpolation between steps. Blind to: speed (tests/bench), systems of more than 8
 * states. */
#include "tests/check.h"
#include "tests/sim/problems.h"

static void solve(double *end, td_integrator_counters *count, const problem *p, double relative,
                  td_integrator_method method)
{
    double absolute[8];
    td_error error = {0};
    td_integrator *g = NULL;
    int event;
    for (size_t i = 0; i < 8; i++) absolute[i] = relative * p->absolute;
    td_integrator_options o = td_integrator_options_default();
    o.relative = relative;
    o.absolute = absolute;
    o.method = method;
    check_ok(td_integrator_new(&g, &p->ode, 0, p->y0, &o, &error), error);
    check_ok(td_integrator_advance(g, p->t_end, &event, NULL, &error), error);
    assert_int_equal(event, -1);
    check_near(td_integrator_time(g), p->t_end, 0);
    memcpy(end, td_integrator_state(g), p->ode.size * sizeof *end);
    if (count) *count = td_integrator_count(g);
    td_integrator_free(&g);
}

static void check_end(const problem *p, const double *truth)
{
    static const double relative[3] = {1e-4, 1e-6, 1e-8};
    for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m += 2) {
            double end[8];
            td_integrator_counters c;
            solve(end, &c, p, relative[k], (td_integrator_method)m);
            double most = 0;
            for (size_t i = 0; i < p->ode.size; i++)
                most = fmax(most, fabs(end[i] - truth[i]) / (relative[k] * (fabs(truth[i]) + p->absolute)));
            printf("%-12s %g, tolerance %g, %s: error %.2f tolerances, %ld rates, %ld Jacobians, %ld steps\n",
                   p->name, p->parameter, relative[k], m ? "BDF" : "auto", most, c.rates, c.jacobians,
                   c.steps);
            check_less(most, 10);
        }
}

static void test_published(void **state)
{
    static const double hires_end[8] = {0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4,
                                        0.1175651343283149e-2, 0.2386356198831331e-2, 0.6238968252742796e-2,
                                        0.2849998395185769e-2, 0.2850001604814231e-2};
    static const double oregonator_end[3] = {0.1000814870318523e1, 0.1228178521549917e4,
                                             0.1320554942846706e3};
    static const double van_der_pol_end[2] = {0.1706167732170469e1, -0.8928097010248125e-3};
    problem p;
    (void)state;
    hires(&p);
    check_end(&p, hires_end);
    oregonator(&p);
    check_end(&p, oregonator_end);
    van_der_pol(&p, 1000);
    check_end(&p, van_der_pol_end);
}

/* Mass is kept by the equations; a method that integrates it exactly keeps it to rounding. */
static void test_robertson(void **state)
{
    problem p;
    double end[8];
    (void)state;
    robertson(&p);
    solve(end, NULL, &p, 1e-6, TD_INTEGRATOR_AUTO);
    check_near(end[0] + end[1] + end[2], 1, 1e-12);
    /* Late, y1 y3 1e4 y2 = 0.04 y1 to the size of y2. */
    check_near(end[1] / (0.04 * end[0] / (1e4 * end[2])), 1, 1e-3);
}

typedef struct stiffness {
    double begin, end, rate;
} stiffness;
/* Where it is easy, the steps that accuracy allows lie far within the reach of Adams' stability. */
static bool tracking_rate(double *d, double t, const double *y, void *user)
{
    const stiffness *s = user;
    double k = t > s->begin && t < s->end ? s->rate : 0.1;
    d[0] = -k * (y[0] - cos(t)) - sin(t);
    return true;
}

static void test_switches(void **state)
{
    stiffness s = {10, 40, 1e5};
    td_ode ode = {.size = 1, .rate = tracking_rate, .user = &s};
    td_integrator_options o = td_integrator_options_default();
    td_integrator *g = NULL;
    td_error error = {0};
    double y = 1;
    int event;
    (void)state;
    check_ok(td_integrator_new(&g, &ode, 0, &y, &o, &error), error);
    check_ok(td_integrator_advance(g, 9, &event, NULL, &error), error);
    assert_int_equal(td_integrator_count(g).method, TD_INTEGRATOR_ADAMS);
    check_ok(td_integrator_advance(g, 30, &event, NULL, &error), error);
    assert_int_equal(td_integrator_count(g).method, TD_INTEGRATOR_BDF);
    check_ok(td_integrator_advance(g, 150, &event, NULL, &error), error);
    assert_int_equal(td_integrator_count(g).method, TD_INTEGRATOR_ADAMS);
    td_integrator_counters c = td_integrator_count(g);
    assert_int_equal(c.to_bdf, 1);
    assert_int_equal(c.to_adams, 1);
    assert_true(c.time_in_bdf_s > 25 && c.time_in_bdf_s < 90);
    check_near(td_integrator_state(g)[0], cos(150), 1e-5);
    td_integrator_free(&g);
}

/* A ball: height, velocity. Events: the ground, and the top of its way. */
static bool ball_rate(double *d, double t, const double *y, void *user)
{
    (void)t, (void)user;
    d[0] = y[1];
    d[1] = -9.81;
    return true;
}
static void ball_events(double *g, double t, const double *y, void *user)
{
    (void)t, (void)user;
    g[0] = y[0];
    g[1] = y[1];
}

/* And a tenth of a millisecond after the top. */
static void three_events(double *g, double t, const double *y, void *user)
{
    ball_events(g, t, y, user);
    g[2] = y[1] + 1e-3;
}

static void test_events(void **state)
{
    td_ode ode = {.size = 2, .rate = ball_rate, .event_count = 2, .events = ball_events};
    td_integrator_options o = td_integrator_options_default();
    td_integrator *g = NULL;
    td_error error = {0};
    double y[2] = {1, 0.5}, speed = sqrt(0.25 + 2 * 9.81), t = 0;
    int event, direction;
    (void)state;
    check_ok(td_integrator_new(&g, &ode, 0, y, &o, &error), error);
    check_ok(td_integrator_advance(g, 10, &event, &direction, &error), error);
    assert_int_equal(event, 1);
    assert_int_equal(direction, -1);
    check_near(td_integrator_time(g), 0.5 / 9.81, 1e-7);
    for (int bounce = 0; bounce < 5; bounce++) {
        check_ok(td_integrator_advance(g, 10, &event, &direction, &error), error);
        assert_int_equal(event, 0);
        assert_int_equal(direction, -1);
        t = td_integrator_time(g);
        check_near(t, (0.5 + speed) / 9.81 + bounce * 2 * speed / 9.81, 1e-6);
        double after[2] = {0, -td_integrator_state(g)[1]};
        check_near(after[1], speed, 1e-6);
        check_ok(td_integrator_restart(g, t, after, &error), error);
        check_ok(td_integrator_advance(g, 10, &event, &direction, &error), error);
        assert_int_equal(event, 1);
        check_near(td_integrator_time(g), t + speed / 9.81, 1e-6);
    }
    assert_int_equal(td_integrator_count(g).events, 11);
    td_integrator_free(&g);
}

/* Without a restart both events of one long step are told, in order, and reading between them works. */
static void test_two_events_in_a_step(void **state)
{
    td_ode ode = {.size = 2, .rate = ball_rate, .event_count = 3, .events = three_events};
    td_integrator_options o = td_integrator_options_default();
    td_integrator *g = NULL;
    td_error error = {0};
    double y[2] = {1e-3, 0.1};
    int event;
    (void)state;
    o.first_step_s = 1; /* a parabola is integrated exactly by order two: later steps are long */
    check_ok(td_integrator_new(&g, &ode, 0, y, &o, &error), error);
    check_ok(td_integrator_advance(g, 0.005, &event, NULL, &error), error);
    assert_int_equal(event, -1);
    check_near(td_integrator_state(g)[1], 0.1 - 9.81 * 0.005, 1e-9);
    check_ok(td_integrator_advance(g, 1, &event, NULL, &error), error);
    assert_int_equal(event, 1);
    double top = td_integrator_time(g);
    check_ok(td_integrator_advance(g, top + 5e-5, &event, NULL, &error), error);
    assert_int_equal(event, -1);
    check_ok(td_integrator_advance(g, top + 2e-4, &event, NULL, &error), error);
    assert_int_equal(event, 2);
    check_near(td_integrator_time(g), top + 1e-3 / 9.81, 1e-9);
    check_ok(td_integrator_advance(g, 1, &event, NULL, &error), error);
    assert_int_equal(event, 0);
    check_near(td_integrator_time(g), (0.1 + sqrt(0.01 + 2 * 9.81 * 1e-3)) / 9.81, 1e-7);
    check_ok(td_integrator_advance(g, 1, &event, NULL, &error), error);
    assert_int_equal(event, -1);
    td_integrator_free(&g);
}

/* A sign that is rounding, and one that is no number: CVODE's own search for roots does not return from
 * either. */
static void noise_events(double *g, double t, const double *y, void *user)
{
    (void)user;
    g[0] = sin(1e12 * t) * 1e-16;
    g[1] = t > 0.1 ? NAN : y[0];
}

static void test_events_of_noise(void **state)
{
    td_ode ode = {.size = 2, .rate = ball_rate, .event_count = 2, .events = noise_events};
    td_integrator *g = NULL;
    td_error error = {0};
    double y[2] = {1, 0};
    int event, told = 0;
    (void)state;
    check_ok(td_integrator_new(&g, &ode, 0, y, NULL, &error), error);
    do {
        check_ok(td_integrator_advance(g, 0.4, &event, NULL, &error), error);
        told += event >= 0;
    } while (event >= 0);
    assert_true(told > 0 && told <= 3 * td_integrator_count(g).steps);
    check_near(td_integrator_state(g)[0], 1 - 9.81 / 2 * 0.16, 1e-6);
    td_integrator_free(&g);
}

static void test_pieces(void **state)
{
    problem p;
    double whole[8];
    td_error error = {0};
    td_integrator *g = NULL;
    int event;
    (void)state;
    oregonator(&p);
    solve(whole, NULL, &p, 1e-6, TD_INTEGRATOR_AUTO);
    double absolute[3] = {1e-8, 1e-8, 1e-8};
    td_integrator_options o = td_integrator_options_default();
    o.absolute = absolute;
    check_ok(td_integrator_new(&g, &p.ode, 0, p.y0, &o, &error), error);
    for (int k = 1; k <= 7200; k++)
        check_ok(td_integrator_advance(g, p.t_end * k / 7200, &event, NULL, &error), error);
    assert_memory_equal(td_integrator_state(g), whole, 3 * sizeof *whole);
    td_integrator_free(&g);
}

static bool counted_rate(double *d, double t, const double *y, void *user)
{
    ++*(long *)user;
    return hires_rate(d, t, y, NULL);
}

/* Without a Jacobian it is made by differences; every call of the rate is counted, theirs too. */
static void test_differences(void **state)
{
    problem p;
    double given[8], made[8];
    td_integrator_counters c[2];
    (void)state;
    hires(&p);
    solve(given, &c[0], &p, 1e-6, TD_INTEGRATOR_BDF);
    long called = 0;
    p.ode.jacobian = NULL;
    p.ode.rate = counted_rate;
    p.ode.user = &called;
    solve(made, &c[1], &p, 1e-6, TD_INTEGRATOR_BDF);
    for (int i = 0; i < 8; i++) check_near(made[i], given[i], 1e-5 * (fabs(given[i]) + 1e-4));
    assert_true(c[1].jacobians > 0);
    assert_int_equal(c[1].rates, called);
}

static bool blow_up(double *d, double t, const double *y, void *user)
{
    (void)t, (void)user;
    d[0] = y[0] * y[0];
    return true;
}
static bool no_rate(double *d, double t, const double *y, void *user)
{
    (void)y, (void)user;
    d[0] = 1;
    return t < 0.5;
}

static void test_refusals(void **state)
{
    td_ode ode = {.size = 1, .rate = blow_up};
    td_integrator_options o = td_integrator_options_default();
    td_integrator *g = NULL;
    td_error error = {0};
    double y = 1, bad = NAN;
    int event;
    (void)state;
    check_fails(td_integrator_new(&g, &ode, 0, &bad, &o, &error), TD_ERROR_DATA, error,
                "state 0 is no number");
    assert_null(g);
    o.relative = 1;
    check_fails(td_integrator_new(&g, &ode, 0, &y, &o, &error), TD_ERROR_ARGUMENT, error, "tolerance 1");
    o = td_integrator_options_default();
    check_ok(td_integrator_new(&g, &ode, 0, &y, &o, &error), error);
    check_fails(td_integrator_advance(g, -1, &event, NULL, &error), TD_ERROR_ARGUMENT, error, "cannot go");
    td_status status = td_integrator_advance(g, 2, &event, NULL, &error);
    assert_int_equal(status, TD_ERROR_DATA);
    assert_non_null(strstr(error.message, "stopped at t = "));
    check_near(atof(strstr(error.message, "t = ") + 4), 1, 1e-3);
    td_integrator_free(&g);
    ode.rate = no_rate;
    check_ok(td_integrator_new(&g, &ode, 0, &y, &o, &error), error);
    status = td_integrator_advance(g, 2, &event, NULL, &error);
    assert_int_equal(status, TD_ERROR_DATA);
    td_integrator_free(&g);
    ode.rate = blow_up;
    o.max_steps = 5;
    check_ok(td_integrator_new(&g, &ode, 0, &y, &o, &error), error);
    check_fails(td_integrator_advance(g, 0.9, &event, NULL, &error), TD_ERROR_DATA, error,
                "more than 5 steps");
    td_integrator_free(&g);
    td_integrator_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_published),
                                       cmocka_unit_test(test_robertson),
                                       cmocka_unit_test(test_switches),
                                       cmocka_unit_test(test_events),
                                       cmocka_unit_test(test_two_events_in_a_step),
                                       cmocka_unit_test(test_events_of_noise),
                                       cmocka_unit_test(test_pieces),
                                       cmocka_unit_test(test_differences),
                                       cmocka_unit_test(test_refusals)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
